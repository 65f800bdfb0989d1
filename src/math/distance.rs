//! Exact Euclidean distance on an anisotropic grid (Felzenszwalb and Huttenlocher 2012, "Distance
//! Transforms of Sampled Functions": along each axis in turn, the lower envelope of parabolas), and
//! connected parts of a mask.

use super::arrays::{flat, shaped, size};
use ndarray::{Array3, Axis, Zip};
use rayon::prelude::*;

/// Squared distance from every grid point to the nearest cell (the box of one spacing around a
/// point) of `set`, in the unit of `spacing` along i, j, k; 0 for the points of the set, infinite
/// if the set is empty.
///
/// A cell is three parabolas per axis, at its point and at its two faces: the squared distance to a
/// box is the sum of the squared distances to its three intervals, hence the axes still separate.
pub fn squared_distance(set: &Array3<bool>, spacing: [f32; 3]) -> Array3<f32> {
    let mut d = set.mapv(|inside| if inside { 0.0 } else { f32::INFINITY });
    for (axis, spacing) in [2, 1, 0].into_iter().zip(spacing) {
        let scratch = || (Envelope::default(), Vec::new());
        Zip::from(d.lanes_mut(Axis(axis))).into_par_iter().for_each_init(
            scratch,
            |(envelope, line), (mut lane,)| {
                line.clear();
                line.extend(lane.iter());
                envelope.transform(line, spacing);
                lane.iter_mut().zip(&*line).for_each(|(to, value)| *to = *value);
            },
        );
    }
    d
}

/// Scratch space for one line.
#[derive(Default)]
struct Envelope {
    /// Grid points whose parabolas form the envelope.
    at: Vec<usize>,
    /// Where each one becomes the lowest.
    from: Vec<f32>,
    input: Vec<f32>,
}

impl Envelope {
    fn transform(&mut self, line: &mut [f32], spacing: f32) {
        self.at.clear();
        self.from.clear();
        self.input.clear();
        // Points at odd indices, the faces between them at even ones.
        for n in 0..=2 * line.len() {
            let value = if n % 2 == 1 {
                line[n / 2]
            } else {
                let before = if n > 0 { line[n / 2 - 1] } else { f32::INFINITY };
                before.min(line.get(n / 2).copied().unwrap_or(f32::INFINITY))
            };
            self.input.push(value);
        }
        let f = &self.input;
        let x = |n: usize| n as f32 * 0.5 * spacing;
        for q in (0..f.len()).filter(|&q| f[q].is_finite()) {
            let mut start = f32::NEG_INFINITY;
            while let (Some(&p), Some(&since)) = (self.at.last(), self.from.last()) {
                let s = ((f[q] + x(q) * x(q)) - (f[p] + x(p) * x(p))) / (2.0 * (x(q) - x(p)));
                if s > since {
                    start = s;
                    break;
                }
                self.at.pop();
                self.from.pop();
            }
            self.at.push(q);
            self.from.push(start);
        }
        if self.at.is_empty() {
            return;
        }
        let mut n = 0;
        for (q, value) in line.iter_mut().enumerate() {
            let here = x(2 * q + 1);
            while n + 1 < self.at.len() && self.from[n + 1] <= here {
                n += 1;
            }
            let p = self.at[n];
            *value = (here - x(p)).powi(2) + f[p];
        }
    }
}

/// Face neighbours of a grid point.
fn neighbours(n: usize, [nx, ny, nz]: [usize; 3]) -> impl Iterator<Item = usize> {
    let (i, j, k) = (n % nx, n / nx % ny, n / (nx * ny));
    [
        (i > 0).then(|| n - 1),
        (i + 1 < nx).then(|| n + 1),
        (j > 0).then(|| n - nx),
        (j + 1 < ny).then(|| n + nx),
        (k > 0).then(|| n - nx * ny),
        (k + 1 < nz).then(|| n + nx * ny),
    ]
    .into_iter()
    .flatten()
}

/// The points of `mask` connected (across faces) to any of `seeds`.
pub fn connected(mask: &Array3<bool>, seeds: impl IntoIterator<Item = [usize; 3]>) -> Array3<bool> {
    let size = size(mask);
    let mask = flat(mask);
    let mut reached = vec![false; mask.len()];
    let mut open: Vec<usize> = Vec::new();
    for [i, j, k] in seeds {
        let s = (k * size[1] + j) * size[0] + i;
        if mask[s] && !reached[s] {
            reached[s] = true;
            open.push(s);
        }
    }
    while let Some(n) = open.pop() {
        for m in neighbours(n, size) {
            if mask[m] && !reached[m] {
                reached[m] = true;
                open.push(m);
            }
        }
    }
    shaped(size, reached)
}

/// The largest connected part of a mask, by one pass that labels all parts.
pub fn largest_part(mask: &Array3<bool>) -> Array3<bool> {
    let size = size(mask);
    let mask = flat(mask);
    let mut part = vec![0u32; mask.len()];
    let (mut last, mut best, mut most) = (0u32, 0u32, 0usize);
    let mut open = Vec::new();
    for seed in 0..mask.len() {
        if !mask[seed] || part[seed] != 0 {
            continue;
        }
        last += 1;
        part[seed] = last;
        open.push(seed);
        let mut count = 0;
        while let Some(n) = open.pop() {
            count += 1;
            for m in neighbours(n, size) {
                if mask[m] && part[m] == 0 {
                    part[m] = last;
                    open.push(m);
                }
            }
        }
        if count > most {
            (best, most) = (last, count);
        }
    }
    shaped(size, part.into_iter().map(|p| p != 0 && p == best).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn distances_are_exact(nx in 1usize..8, ny in 1usize..8, nz in 1usize..8, seed in 0u64..1000, spacing in prop::array::uniform3(0.3f32..5.0)) {
            let n = nx * ny * nz;
            let set: Vec<bool> = (0..n as u64).map(|i| (i * 2_654_435_761 + seed * 40_503).is_multiple_of(7)).collect();
            let got = squared_distance(&shaped([nx, ny, nz], set.clone()), spacing);
            let at = |n: usize| [n % nx, n / nx % ny, n / nx / ny];
            for (a, got) in got.iter().enumerate() {
                let want = (0..n).filter(|&b| set[b]).map(|b| {
                    (0..3).map(|c| (((at(a)[c] as f32 - at(b)[c] as f32).abs() - 0.5).max(0.0) * spacing[c]).powi(2)).sum::<f32>()
                }).fold(f32::INFINITY, f32::min);
                prop_assert!(*got == want || (got - want).abs() < 1e-3 * (1.0 + want), "{} for {}", got, want);
            }
        }
    }

    #[test]
    fn parts_are_found() {
        let row = |text: &str| shaped([9, 1, 1], text.chars().map(|c| c == '#').collect());
        let mask = row("##.#..###");
        assert_eq!(connected(&mask, [[0; 3]]), row("##......."));
        assert_eq!(largest_part(&mask), row("......###"));
        let none = shaped([2, 2, 1], vec![false; 4]);
        assert_eq!(largest_part(&none), none);
    }
}
