//! A transfer function tabulated for sampling.
//!
//! The entries span the curve's own domain, not the data's: between two control points a linear
//! curve is exact, and only the entry around a kink deviates, by at most 1/4096 of the domain. A
//! curve over a 16-bit range thus has one entry per 16 values, and one over a 400 HU window ten
//! entries per Hounsfield unit. A range-maximum table over the optical depth gives the highest
//! opacity within a range of values, for empty-space skipping.

use super::TransferFunction;
use crate::math::cells::columns;
use crate::math::lanes::*;

/// Entries over the curve's domain.
pub const TABLE_ENTRIES: usize = 4096;
/// Entries over the gradient magnitudes.
pub const GRADIENT_ENTRIES: usize = 256;
/// Half the interval over which the sign of the opacity's slope is taken, table coordinates.
const SLOPE_STEP: f32 = 0.02;
/// A relative decrease of opacity smaller than this counts as level, since rounding can cause it.
const LEVEL: f32 = 1.0 - 1e-5;
/// Opacity 1 would be an infinite optical depth; instead, 2^-16 of the light passes.
const MAX_DEPTH: f32 = 16.0;

/// Colour (not premultiplied) and optical depth by table coordinate, which runs from 0 to 1 over
/// the curve's domain.
pub struct TransferTable {
    /// Red, green, blue and τ = -log₂(1 - opacity) per Δ₀.
    pub entries: Vec<[f32; 4]>,
    /// Factor on τ by gradient magnitude; empty for none.
    pub gradient: Vec<f32>,
    /// Gradient magnitude of the last entry of `gradient`, in normalised values per mm.
    pub gradient_top: f32,
    /// Table coordinate = `scale` · normalised value + `offset`.
    pub scale: f32,
    /// See `scale`.
    pub offset: f32,
    /// τ of each entry, with the last one repeated. The length is a compile-time constant.
    depths: Box<[f32; TABLE_ENTRIES + 1]>,
    /// `maxima[l][i]` = highest τ in entries `i .. i + 2^l`.
    maxima: Vec<Vec<f32>>,
    /// Number of transparent entries before the i-th.
    transparent: Vec<u32>,
}

impl TransferTable {
    /// Bakes a function for values normalised over `range` (data units).
    pub fn new(function: &TransferFunction, range: [f64; 2]) -> Self {
        let [mut low, mut high] = function.domain();
        let span = if range[1] > range[0] {
            range[1] - range[0]
        } else {
            1.0
        };
        if high - low < 1e-6 * span {
            // A step function: the domain becomes one entry wide around it.
            let middle = (low + high) / 2.0;
            (low, high) = (middle - 5e-7 * span, middle + 5e-7 * span);
        }
        let p = &function.points;
        let entries: Vec<[f32; 4]> = (0..TABLE_ENTRIES)
            .map(|n| {
                let value = low + (high - low) * n as f64 / (TABLE_ENTRIES - 1) as f64;
                let above = p.partition_point(|q| q.value <= value);
                let (a, b) = (&p[above.saturating_sub(1)], &p[above.min(p.len() - 1)]);
                let t = if b.value > a.value {
                    ((value - a.value) / (b.value - a.value)) as f32
                } else {
                    0.0
                };
                let mix = |x: f32, y: f32| x + (y - x) * t;
                let opacity = mix(a.opacity, b.opacity);
                let depth = (-(1.0 - opacity).log2()).clamp(0.0, MAX_DEPTH);
                [
                    mix(a.color[0], b.color[0]),
                    mix(a.color[1], b.color[1]),
                    mix(a.color[2], b.color[2]),
                    depth,
                ]
            })
            .collect();
        let g = &function.gradient_opacity;
        let top = g.last().map_or(1.0, |q| q.magnitude.max(1e-12));
        let gradient = if g.is_empty() {
            Vec::new()
        } else {
            (0..GRADIENT_ENTRIES)
                .map(|n| {
                    let m = top * n as f64 / (GRADIENT_ENTRIES - 1) as f64;
                    let above = g.partition_point(|q| q.magnitude <= m);
                    let (a, b) = (&g[above.saturating_sub(1)], &g[above.min(g.len() - 1)]);
                    let t = if b.magnitude > a.magnitude {
                        ((m - a.magnitude) / (b.magnitude - a.magnitude)).clamp(0.0, 1.0) as f32
                    } else {
                        0.0
                    };
                    a.factor + (b.factor - a.factor) * t
                })
                .collect()
        };
        let mut transparent = vec![0];
        transparent.extend(entries.iter().scan(0, |sum, e| {
            *sum += u32::from(e[3] <= 0.0);
            Some(*sum)
        }));
        let mut depths = Box::new([0.0; TABLE_ENTRIES + 1]);
        for (n, depth) in depths.iter_mut().enumerate() {
            *depth = entries[n.min(TABLE_ENTRIES - 1)][3];
        }
        let mut maxima = vec![entries.iter().map(|e| e[3]).collect::<Vec<f32>>()];
        while 2 << (maxima.len() - 1) <= TABLE_ENTRIES {
            let half = 1 << (maxima.len() - 1);
            let last = &maxima[maxima.len() - 1];
            let next = (0..last.len() - half)
                .map(|i| last[i].max(last[i + half]))
                .collect();
            maxima.push(next);
        }
        Self {
            entries,
            gradient,
            gradient_top: (top / span) as f32,
            scale: (span / (high - low)) as f32,
            offset: ((range[0] - low) / (high - low)) as f32,
            depths,
            maxima,
            transparent,
        }
    }

    /// Colour and optical depth of a normalised value; a hole has none.
    #[inline(always)]
    pub fn lookup(&self, value: f32) -> [f32; 4] {
        let x = self.position(value);
        let i = (x as usize).min(TABLE_ENTRIES - 2);
        let t = x - i as f32;
        let (a, b) = (&self.entries[i], &self.entries[i + 1]);
        // Written out rather than with `array::from_fn`, which may not be inlined here.
        [
            a[0] + (b[0] - a[0]) * t,
            a[1] + (b[1] - a[1]) * t,
            a[2] + (b[2] - a[2]) * t,
            a[3] + (b[3] - a[3]) * t,
        ]
    }

    /// Index of the table entry below each of eight values, and the interpolation weight towards
    /// the next one.
    #[inline(always)]
    fn places<S: Simd>(&self, value: f32x8<S>) -> ([usize; LANES], f32x8<S>) {
        let x = value.mul_add(self.scale, self.offset).max(0.0).min(1.0) * (TABLE_ENTRIES - 1) as f32;
        let entry = x.to_int::<i32x8<S>>().max(0).min(TABLE_ENTRIES as i32 - 2);
        let mut places = [0; LANES];
        for n in 0..LANES {
            // The mask changes no index; it removes the bounds checks.
            places[n] = entry[n] as usize & (TABLE_ENTRIES - 1);
        }
        (places, x - entry.to_float::<f32x8<S>>())
    }

    /// Optical depths of eight normalised values.
    #[inline(always)]
    pub fn depth_lanes<S: Simd>(&self, simd: S, value: f32x8<S>) -> f32x8<S> {
        let (entry, t) = self.places(value);
        let depths = &*self.depths;
        let (mut pairs, mut at) = ([[0.0; 4]; LANES / 2], 0);
        while at < LANES {
            let (i, j) = (entry[at], entry[at + 1]);
            pairs[at / 2] = [depths[i], depths[i + 1], depths[j], depths[j + 1]];
            at += 2;
        }
        let [p, q, r, s] = pairs;
        let (p, q, r, s) = (
            f32x4::load_array(simd, p),
            f32x4::load_array(simd, q),
            f32x4::load_array(simd, r),
            f32x4::load_array(simd, s),
        );
        let a = simd.combine_f32x4(simd.unzip_low_f32x4(p, q), simd.unzip_low_f32x4(r, s));
        let b = simd.combine_f32x4(simd.unzip_high_f32x4(p, q), simd.unzip_high_f32x4(r, s));
        (b - a).mul_add(t, a)
    }

    /// Colours of eight normalised values.
    #[inline(always)]
    pub fn color_lanes<S: Simd>(&self, simd: S, value: f32x8<S>) -> Vec3x8<S> {
        self.lookup_lanes(simd, value).0
    }

    /// Colours and optical depths of eight normalised values.
    #[inline(always)]
    pub fn lookup_lanes<S: Simd>(&self, simd: S, value: f32x8<S>) -> (Vec3x8<S>, f32x8<S>) {
        let (entry, t) = self.places(value);
        let mut mixed = [[0.0; 4]; LANES];
        for n in 0..LANES {
            let pair = &self.entries[entry[n]..][..2];
            let (a, b) = (f32x4::load_array(simd, pair[0]), f32x4::load_array(simd, pair[1]));
            mixed[n] = *(b - a).mul_add(f32x4::splat(simd, t[n]), a);
        }
        let [x, y, z, depth] = columns(simd, &mixed);
        (Vec3x8 { x, y, z }, depth)
    }

    /// 1 where opacity rises with the value, -1 where it falls: the side of a surface on which the
    /// material lies.
    pub fn opacity_slope_sign(&self, value: f32) -> f32 {
        let step = SLOPE_STEP / self.scale;
        if self.lookup(value + step)[3] < LEVEL * self.lookup(value - step)[3] {
            -1.0
        } else {
            1.0
        }
    }

    /// Factor on the optical depth at a gradient magnitude (normalised values per mm).
    #[inline(always)]
    pub fn gradient_factor(&self, magnitude: f32) -> f32 {
        if self.gradient.is_empty() {
            return 1.0;
        }
        let x = (magnitude / self.gradient_top).clamp(0.0, 1.0) * (GRADIENT_ENTRIES - 1) as f32;
        let i = (x as usize).min(GRADIENT_ENTRIES - 2);
        let (a, b) = (self.gradient[i], self.gradient[i + 1]);
        a + (b - a) * (x - i as f32)
    }

    /// The position of a normalised value among the entries.
    #[inline(always)]
    pub(super) fn position(&self, value: f32) -> f32 {
        (value * self.scale + self.offset).clamp(0.0, 1.0) * (TABLE_ENTRIES - 1) as f32
    }

    /// The first and last entry that normalised values in `[low, high]` interpolate.
    fn entries_over(&self, low: f32, high: f32) -> (usize, usize) {
        let (a, b) = (
            self.position(low.min(high)).floor() as usize,
            self.position(high.max(low)).ceil() as usize,
        );
        (a.min(b), b.min(TABLE_ENTRIES - 1))
    }

    /// Whether every normalised value in `[low, high]` is visible.
    pub fn is_visible_throughout(&self, low: f32, high: f32) -> bool {
        let (a, b) = self.entries_over(low, high);
        self.transparent[b + 1] == self.transparent[a]
    }

    /// The highest optical depth that any normalised value in `[low, high]` can have.
    pub fn max_depth(&self, low: f32, high: f32) -> f32 {
        let (a, b) = self.entries_over(low, high);
        let level = (b - a + 1).ilog2() as usize;
        self.maxima[level][a].max(self.maxima[level][b + 1 - (1 << level)])
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Blend, ControlPoint};
    use super::*;
    use proptest::prelude::*;

    fn function(points: &[(f64, f32)]) -> TransferFunction {
        let points = points
            .iter()
            .map(|&(value, opacity)| ControlPoint {
                value,
                color: [0.2, 0.4, opacity],
                opacity,
            })
            .collect();
        TransferFunction {
            points,
            gradient_opacity: Vec::new(),
            blend: Blend::Composite,
        }
    }

    #[test]
    fn opacity_comes_back_out() {
        let t = TransferTable::new(
            &function(&[(-100.0, 0.0), (100.0, 0.8), (300.0, 0.1)]),
            [-1000.0, 3000.0],
        );
        for (value, want) in [
            (-500.0, 0.0),
            (0.0, 0.4),
            (100.0, 0.8),
            (200.0, 0.45),
            (2000.0, 0.1),
        ] {
            let [r, _, b, depth] = t.lookup((value + 1000.0) / 4000.0);
            assert!((1.0 - (-depth).exp2() - want).abs() < 2e-3, "{value}: {depth}");
            assert!((b - want).abs() < 2e-3 && r == 0.2);
        }
    }

    #[test]
    fn steps_and_single_points_are_allowed() {
        let t = TransferTable::new(&function(&[(5.0, 0.0), (5.0, 1.0)]), [0.0, 10.0]);
        assert_eq!(t.lookup(0.49)[3], 0.0);
        assert_eq!(t.lookup(0.51)[3], MAX_DEPTH);
        assert_eq!(
            TransferTable::new(&function(&[(5.0, 0.5)]), [0.0, 10.0]).lookup(0.1)[3],
            1.0
        );
    }

    proptest! {
        #[test]
        fn maximum_bounds_every_lookup(a in -0.5f32..1.5, width in 0.0f32..1.0, at in 0.0f32..1.0) {
            let t = TransferTable::new(&function(&[(0.0, 0.0), (2.0, 0.9), (3.0, 0.0), (7.0, 0.0), (7.0, 0.6), (10.0, 0.2)]), [0.0, 10.0]);
            prop_assert!(t.lookup(a + width * at)[3] <= t.max_depth(a, a + width) + 1e-6);
        }
    }

    #[test]
    fn maximum_of_an_empty_range_is_nothing() {
        let t = TransferTable::new(&function(&[(0.0, 0.0), (4.0, 0.0), (5.0, 1.0)]), [0.0, 10.0]);
        assert_eq!(t.max_depth(0.0, 0.39), 0.0);
        assert!(t.max_depth(0.0, 0.6) > 10.0);
    }
}
