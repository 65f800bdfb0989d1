//! Pre-integrated transfer functions (Engel, Kraus, Ertl 2001): colour and optical depth of a ray
//! segment by the values at its ends.
//!
//! *Theory*: the value is assumed to vary linearly from the front sample to the back sample. The
//! segment's optical depth is then the mean of τ between the two values, and its colour the mean of
//! the curve's colours, each weighted by its contribution to the opacity and by the transmittance
//! of the part of the segment in front of it. A feature of the curve that lies between two samples
//! is thus captured, where a table of single values steps over it.
//!
//! *What is different*: the colour is stored without its opacity, and the depth per reference
//! length, as in [`TransferTable`], so that light, own colours and gradient opacity apply to a
//! segment as they do to a sample. The weights inside a segment are those of the step for which the
//! table is built; the opacity is correct for any step.
//!
//! A segment's depth comes from the curve's integral at its ends, not from the table of segments,
//! which is coarser than the curve: interpolated between table entries, a transparent value would
//! take on opacity from its neighbours, and air is often such a value.
//!
//! *How to call it*: [`Preintegrated::new`] with the length of a step; rebuild it when the curve or
//! the step changes. Integrals over the curve's own entries make it exact for τ, and a segment's
//! colour is the sum of at most [`PARTS`] parts.

use super::{TABLE_ENTRIES, TransferTable};
use rayon::prelude::*;

/// Values along each side of the table: 1 MiB in single precision.
pub const PREINTEGRATED_SIZE: usize = 256;
/// Parts of a segment within which colour and depth are assumed to be uniformly mixed.
const PARTS: usize = 16;

/// Colour (not premultiplied) and optical depth per reference length, by the table coordinates of a
/// segment's front and back.
pub struct Preintegrated {
    /// Red, green, blue and mean τ; the back value varies fastest.
    pub entries: Vec<[f32; 4]>,
    /// τ of the curve's entries, and its integral from the first entry to each.
    pub depths: Vec<[f32; 2]>,
}

/// Integrals from the curve's start: of τ, of τ times colour, and of colour.
pub(super) struct Integrals(Vec<[f64; 7]>);

impl Integrals {
    pub(super) fn new(table: &TransferTable) -> Self {
        let at = |e: &[f32; 4]| {
            let [r, g, b, depth] = e.map(f64::from);
            [depth, depth * r, depth * g, depth * b, r, g, b]
        };
        let mut sums = vec![[0.0; 7]];
        let mut last = [0.0; 7];
        for pair in table.entries.windows(2) {
            let (a, b) = (at(&pair[0]), at(&pair[1]));
            // The curve is linear between entries; a product of two linear functions is a parabola,
            // which Simpson's rule integrates exactly.
            let middle = at(&std::array::from_fn(|c| (pair[0][c] + pair[1][c]) / 2.0));
            last = std::array::from_fn(|c| last[c] + (a[c] + 4.0 * middle[c] + b[c]) / 6.0);
            sums.push(last);
        }
        Self(sums)
    }

    /// The integral up to a position, entries.
    fn up_to(&self, x: f64) -> [f64; 7] {
        let i = (x.max(0.0) as usize).min(self.0.len().saturating_sub(2));
        let t = x - i as f64;
        std::array::from_fn(|c| self.0[i][c] + (self.0[i + 1][c] - self.0[i][c]) * t)
    }

    /// Means between two positions, entries.
    fn mean(&self, a: f64, b: f64) -> [f64; 7] {
        let (low, high) = (a.min(b), a.max(b));
        let width = (high - low).max(1e-3);
        // For a single position, a short interval around it.
        let low = if high - low < 1e-3 {
            (low - width / 2.0).clamp(0.0, (TABLE_ENTRIES - 1) as f64 - width)
        } else {
            low
        };
        let (from, to) = (self.up_to(low), self.up_to(low + width));
        std::array::from_fn(|c| (to[c] - from[c]) / width)
    }
}

impl Preintegrated {
    /// Integrates a curve for segments of `length` reference lengths.
    pub fn new(table: &TransferTable, length: f32) -> Self {
        let integrals = Integrals::new(table);
        let position = |n: usize| n as f64 * (TABLE_ENTRIES - 1) as f64 / (PREINTEGRATED_SIZE - 1) as f64;
        let entries = (0..PREINTEGRATED_SIZE * PREINTEGRATED_SIZE)
            .into_par_iter()
            .map(|n| {
                segment(
                    &integrals,
                    position(n / PREINTEGRATED_SIZE),
                    position(n % PREINTEGRATED_SIZE),
                    f64::from(length),
                )
            })
            .collect();
        let depths = table
            .entries
            .iter()
            .zip(&integrals.0)
            .map(|(e, to)| [e[3], to[0] as f32])
            .collect();
        Self { entries, depths }
    }

    /// Mean τ between two table coordinates.
    fn depth(&self, front: f32, back: f32) -> f32 {
        let last = self.depths.len() - 1;
        let [a, b] = [front.min(back), front.max(back)].map(|x| x.clamp(0.0, 1.0) * last as f32);
        // τ and its integral at a position, entries.
        let at = |x: f32| {
            let i = (x as usize).min(last - 1);
            let t = x - i as f32;
            let [[tau, sum], [next, _]] = [self.depths[i], self.depths[i + 1]];
            let here = tau + (next - tau) * t;
            (here, sum, 0.5 * (tau + here) * t)
        };
        if b - a < 1.0 {
            // The difference of the integrals would lose all precision.
            return at(0.5 * (a + b)).0;
        }
        let ((_, low, beyond_low), (_, high, beyond_high)) = (at(a), at(b));
        (((high - low) + (beyond_high - beyond_low)) / (b - a)).max(0.0)
    }

    /// Colour and optical depth of a segment by the table coordinates of its ends; the colour
    /// bilinear.
    pub fn lookup(&self, front: f32, back: f32) -> [f32; 4] {
        let last = PREINTEGRATED_SIZE - 1;
        let split = |x: f32| {
            let x = x.clamp(0.0, 1.0) * last as f32;
            let i = (x as usize).min(last - 1);
            (i, x - i as f32)
        };
        let ((f, tf), (b, tb)) = (split(front), split(back));
        let at = |f: usize, b: usize| self.entries[f * PREINTEGRATED_SIZE + b];
        let (low, high) = ([at(f, b), at(f, b + 1)], [at(f + 1, b), at(f + 1, b + 1)]);
        let mix = |c: usize| {
            let (near, far) = (
                low[0][c] + (low[1][c] - low[0][c]) * tb,
                high[0][c] + (high[1][c] - high[0][c]) * tb,
            );
            near + (far - near) * tf
        };
        [mix(0), mix(1), mix(2), self.depth(front, back)]
    }
}

pub(super) fn segment(integrals: &Integrals, front: f64, back: f64, length: f64) -> [f32; 4] {
    let parts = ((back - front).abs().ceil() as usize).clamp(1, PARTS);
    let whole = integrals.mean(front, back);
    let (mut color, mut weight, mut passed) = ([0.0; 3], 0.0, 1.0);
    for n in 0..parts {
        let at = |n: usize| front + (back - front) * n as f64 / parts as f64;
        let m = integrals.mean(at(n), at(n + 1));
        if m[0] <= 0.0 {
            continue;
        }
        let pass = (-m[0] * length / parts as f64).exp2();
        let adds = passed * (1.0 - pass);
        color = std::array::from_fn(|c| color[c] + adds * m[1 + c] / m[0]);
        weight += adds;
        passed *= pass;
    }
    let [r, g, b] = if weight > 1e-12 {
        color.map(|c| c / weight)
    } else {
        [whole[4], whole[5], whole[6]]
    };
    [r, g, b, whole[0]].map(|v| v as f32)
}

#[cfg(test)]
mod tests {
    use super::super::{Blend, ControlPoint, TransferFunction};
    use super::*;

    fn table(points: &[(f64, [f32; 3], f32)]) -> TransferTable {
        let points = points
            .iter()
            .map(|&(value, color, opacity)| ControlPoint {
                value,
                color,
                opacity,
            })
            .collect();
        TransferTable::new(
            &TransferFunction {
                points,
                gradient_opacity: Vec::new(),
                blend: Blend::Composite,
            },
            [0.0, 1.0],
        )
    }

    #[test]
    fn a_uniform_curve_is_itself() {
        let t = Preintegrated::new(
            &table(&[(0.0, [0.2, 0.4, 0.6], 0.5), (1.0, [0.2, 0.4, 0.6], 0.5)]),
            1.0,
        );
        for (front, back) in [(0.0, 0.0), (0.1, 0.9), (0.77, 0.3), (1.0, 1.0)] {
            let e = t.lookup(front, back);
            assert!(
                e.iter()
                    .zip([0.2, 0.4, 0.6, 1.0])
                    .all(|(a, b)| (a - b).abs() < 1e-4),
                "{front} {back}: {e:?}"
            );
        }
    }

    /// Linear opacity and linear colour at uniform opacity match their closed forms.
    #[test]
    fn linear_curves_are_their_closed_forms() {
        let t = Preintegrated::new(&table(&[(0.0, [0.5; 3], 0.0), (1.0, [0.5; 3], 0.8)]), 1.0);
        let integral = |o: f64| ((1.0 - o) * (1.0 - o).ln() + o) / std::f64::consts::LN_2;
        for (front, back) in [(0.1, 0.9), (0.9, 0.1), (0.25, 0.5), (0.0, 1.0)] {
            let (a, b) = (0.8 * f64::from(front), 0.8 * f64::from(back));
            let want = (integral(b) - integral(a)) / (b - a);
            let depth = f64::from(t.lookup(front, back)[3]);
            assert!(
                (depth - want).abs() < 1e-3 * want.max(0.1),
                "{front} {back}: {depth}, {want}"
            );
        }
        for length in [0.5f32, 2.0, 8.0] {
            let t = Preintegrated::new(
                &table(&[(0.0, [0.0, 1.0, 0.5], 0.5), (1.0, [1.0, 0.0, 0.5], 0.5)]),
                length,
            );
            let a = f64::from(length) * std::f64::consts::LN_2;
            let share = 1.0 / a - (-a).exp() / (1.0 - (-a).exp());
            for (front, back) in [(0.0f32, 1.0f32), (1.0, 0.0), (0.3, 0.8)] {
                let want = f64::from(front) + f64::from(back - front) * share;
                let [r, g, b, _] = t.lookup(front, back).map(f64::from);
                assert!(
                    (r - want).abs() < 4e-3 && (g + r - 1.0).abs() < 1e-4 && (b - 0.5).abs() < 1e-4,
                    "{length} {front} {back}: {r}, {want}"
                );
            }
        }
    }

    /// Values where the curve is transparent stay transparent, however close the curve rises; and
    /// the depth is the curve's mean.
    #[test]
    fn nothing_is_shown_beside_what_the_curve_shows() {
        let curve = table(&[
            (0.0, [1.0; 3], 0.0),
            (0.041, [1.0; 3], 0.0),
            (0.042, [1.0; 3], 0.9),
            (1.0, [1.0; 3], 0.3),
        ]);
        let t = Preintegrated::new(&curve, 1.0);
        for (front, back) in [(0.04, 0.04), (0.0405, 0.038), (0.0, 0.0405)] {
            assert_eq!(t.lookup(front, back)[3], 0.0, "{front} {back}");
        }
        for (front, back) in [(0.2f32, 0.7f32), (0.9, 0.0), (0.05, 0.0501), (0.3, 0.3)] {
            let parts = 20_000;
            let mean = (0..parts)
                .map(|n| f64::from(curve.lookup(front + (back - front) * (n as f32 + 0.5) / parts as f32)[3]))
                .sum::<f64>()
                / f64::from(parts);
            assert!(
                (f64::from(t.lookup(front, back)[3]) - mean).abs() < 2e-3 * mean.max(0.1),
                "{front} {back}: {mean}"
            );
        }
    }

    /// A peak between two samples that are both transparent is visible.
    #[test]
    fn a_peak_between_samples_is_seen() {
        let curve = table(&[
            (0.0, [1.0; 3], 0.0),
            (0.45, [1.0; 3], 0.0),
            (0.5, [1.0; 3], 0.9),
            (0.55, [1.0; 3], 0.0),
            (1.0, [1.0; 3], 0.0),
        ]);
        assert!(curve.lookup(0.3)[3] == 0.0 && curve.lookup(0.7)[3] == 0.0);
        let t = Preintegrated::new(&curve, 1.0);
        assert!(t.lookup(0.3, 0.7)[3] > 0.1 && t.lookup(0.2, 0.4)[3] < 1e-6);
    }
}
