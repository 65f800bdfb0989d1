//! What of a volume is the object, and what the air, jar or gel around it.
//!
//! *Theory*: along a line of voxels through the whole volume, the largest value belongs to the
//! object if the line meets it, and to its surroundings else. The largest values of all lines along
//! an axis are the volume's silhouette as a picture. Its grey values fall into two or three classes
//! that are far better balanced than the voxels' own (a tooth fills 5 % of its volume but a quarter
//! of its silhouette), and Otsu's thresholds (Otsu 1979) separate them reliably. The first
//! threshold behind which the silhouette is no longer a box (a block of noise, a jar, a tissue
//! holder) separates the object. What the lines beside it reach is the level of the noise.
//!
//! Where the surroundings are bright (light microscopy), all of this holds for the smallest values.

use super::Volume;
use rayon::prelude::*;

/// Samples along each axis, at most.
const SAMPLES: usize = 96;
/// Bins of a histogram of silhouettes.
const BINS: usize = 64;
/// A silhouette that covers more than this of its own box is a box.
const BOX_COVERAGE: f64 = 0.97;
/// A row or column of a silhouette that holds less than this of the fullest one holds specks.
const SPECKS: f64 = 0.1;
/// A silhouette that covers less than this of the volume's is nothing.
const MIN_COVERAGE: f64 = 0.004;
/// Share of the volume's faces that must be bright for surroundings to be bright.
const BRIGHT_FACES: f64 = 0.9;
/// Percentile of the lines beside the object that is their noise level: a few more lines graze the
/// object.
const NOISE_PERCENTILE: f64 = 0.85;
/// Where the object begins, between the noise level and the threshold of silhouettes.
const OBJECT_START: f64 = 0.35;
/// Share of the object's voxels below its highest value.
const ROBUST: f64 = 0.998;

/// The object of a volume. Values are in data units; those of a dark object in bright surroundings
/// run downwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foreground {
    /// Median of the surroundings.
    pub background: f64,
    /// Where the object begins: beyond the noise of its surroundings.
    pub threshold: f64,
    /// The value that all but a few voxels of the object lie before.
    pub extreme: f64,
}

impl Foreground {
    /// Whether the object is darker than its surroundings.
    pub fn is_dark(&self) -> bool {
        self.extreme < self.background
    }
}

/// Some of a volume's voxels, on a grid.
struct Samples {
    size: [usize; 3],
    /// i fastest; NaN where there is no value.
    values: Vec<f64>,
}

impl Samples {
    fn new(volume: &Volume) -> Self {
        let step = volume.size.map(|n| n.div_ceil(SAMPLES));
        let size: [usize; 3] = std::array::from_fn(|a| volume.size[a].div_ceil(step[a]));
        let at = |n: usize, a: usize| (n * step[a] + step[a] / 2).min(volume.size[a] - 1);
        let values = (0..size.iter().product())
            .into_par_iter()
            .map(|n: usize| {
                let [i, j, k] = [n % size[0], n / size[0] % size[1], n / size[0] / size[1]];
                let stored = volume.voxels.at([at(i, 0), at(j, 1), at(k, 2)]);
                if stored.is_finite() && !volume.is_padding(stored) {
                    stored * volume.rescale.slope + volume.rescale.intercept
                } else {
                    f64::NAN
                }
            })
            .collect();
        Self { size, values }
    }

    fn negated(&self) -> Self {
        Self {
            size: self.size,
            values: self.values.iter().map(|v| -v).collect(),
        }
    }

    fn finite(&self) -> impl Iterator<Item = f64> + Clone {
        self.values.iter().copied().filter(|v| v.is_finite())
    }

    /// The values on the six faces.
    fn faces(&self) -> Vec<f64> {
        let [x, y, z] = self.size;
        let on_face = |n: &usize| {
            let [i, j, k] = [n % x, n / x % y, n / x / y];
            i == 0 || j == 0 || k == 0 || i + 1 == x || j + 1 == y || k + 1 == z
        };
        (0..self.values.len())
            .filter(on_face)
            .map(|n| self.values[n])
            .filter(|v| v.is_finite())
            .collect()
    }

    /// The largest value of each line along an axis, as a picture with its width.
    fn silhouette(&self, axis: usize) -> (Vec<f64>, usize) {
        let [u, v] = [[1, 2], [0, 2], [0, 1]][axis];
        let stride = [1, self.size[0], self.size[0] * self.size[1]];
        let line = |n: usize| {
            let start = n % self.size[u] * stride[u] + n / self.size[u] * stride[v];
            (0..self.size[axis])
                .map(|m| self.values[start + m * stride[axis]])
                .fold(f64::NEG_INFINITY, f64::max)
        };
        ((0..self.size[u] * self.size[v]).map(line).collect(), self.size[u])
    }
}

/// Counts of values in equal bins between their extremes.
struct Bins {
    low: f64,
    width: f64,
    counts: [f64; BINS],
}

impl Bins {
    /// None if all values are the same.
    fn new(values: impl Iterator<Item = f64> + Clone) -> Option<Self> {
        let finite = values.filter(|v| v.is_finite());
        let (low, high) = finite
            .clone()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
                (a.min(v), b.max(v))
            });
        let width = (high - low) / BINS as f64;
        if width.is_nan() || width <= 0.0 {
            return None;
        }
        let mut counts = [0.0; BINS];
        for v in finite {
            counts[(((v - low) / width) as usize).min(BINS - 1)] += 1.0;
        }
        Some(Self { low, width, counts })
    }

    /// Otsu's thresholds for two and for three classes: one, then two values.
    fn thresholds(&self) -> [f64; 3] {
        let mut sums = [[0.0; 2]; BINS + 1];
        for (n, count) in self.counts.iter().enumerate() {
            sums[n + 1] = [sums[n][0] + count, sums[n][1] + count * (n as f64 + 0.5)];
        }
        // A class's contribution to the variance between classes.
        let spread = |from: usize, to: usize| {
            let [count, sum] = [0, 1].map(|c| sums[to][c] - sums[from][c]);
            if count > 0.0 { sum * sum / count } else { 0.0 }
        };
        let (mut two, mut three) = ((0, 0.0), ([0; 2], 0.0));
        for a in 1..BINS {
            let of_two = spread(0, a) + spread(a, BINS);
            if of_two > two.1 {
                two = (a, of_two);
            }
            for b in a + 1..BINS {
                let of_three = spread(0, a) + spread(a, b) + spread(b, BINS);
                if of_three > three.1 {
                    three = ([a, b], of_three);
                }
            }
        }
        [two.0, three.0[0], three.0[1]].map(|n| self.low + n as f64 * self.width)
    }
}

/// The share of a silhouette above a threshold in the whole picture, and in its own box. Rows and
/// columns that hold little more than specks of noise do not belong to the box.
fn coverage((values, width): &(Vec<f64>, usize), threshold: f64) -> [f64; 2] {
    let height = values.len() / width;
    let (mut of_rows, mut of_columns) = (vec![0usize; height], vec![0usize; *width]);
    let covered = || (0..values.len()).filter(|n| values[*n] > threshold);
    for n in covered() {
        of_rows[n / width] += 1;
        of_columns[n % width] += 1;
    }
    let extent = |counts: &[usize]| {
        let most = counts.iter().copied().max().unwrap_or(0);
        let holds = |count: &usize| *count > 0 && *count as f64 >= SPECKS * most as f64;
        let first = counts.iter().position(&holds);
        let last = counts.iter().rposition(holds);
        first.zip(last)
    };
    let (Some((top, bottom)), Some((left, right))) = (extent(&of_rows), extent(&of_columns)) else {
        return [0.0; 2];
    };
    let in_box = |n: &usize| (top..=bottom).contains(&(n / width)) && (left..=right).contains(&(n % width));
    let own = (bottom + 1 - top) * (right + 1 - left);
    [
        covered().count() as f64 / values.len() as f64,
        covered().filter(in_box).count() as f64 / own as f64,
    ]
}

/// The value below which a fraction of some values lie.
fn percentile(mut values: Vec<f64>, fraction: f64) -> Option<f64> {
    values.retain(|v| v.is_finite());
    let n = ((values.len() as f64 * fraction) as usize).min(values.len().checked_sub(1)?);
    Some(*values.select_nth_unstable_by(n, f64::total_cmp).1)
}

/// The object of a volume; none if all its values are the same.
pub(super) fn foreground(volume: &Volume) -> Option<Foreground> {
    let samples = Samples::new(volume);
    let [split, ..] = Bins::new(samples.finite())?.thresholds();
    let faces = samples.faces();
    let bright = faces.iter().filter(|v| **v > split).count() as f64;
    if volume.inverted || bright >= BRIGHT_FACES * faces.len() as f64 {
        // What fills all faces and is no background is the object itself.
        let dark = bright_object(&samples.negated(), -split).filter(|dark| volume.inverted || !dark.is_box);
        if let Some(dark) = dark {
            return Some(dark.foreground(-1.0));
        }
    }
    Some(bright_object(&samples, split)?.foreground(1.0))
}

/// A bright object in dark surroundings.
struct BrightObject {
    background: f64,
    threshold: f64,
    extreme: f64,
    /// No threshold shows anything but a box.
    is_box: bool,
}

impl BrightObject {
    /// The object in data units, of which its values are `sign` times.
    fn foreground(&self, sign: f64) -> Foreground {
        Foreground {
            background: sign * self.background,
            threshold: sign * self.threshold,
            extreme: sign * self.extreme,
        }
    }
}

/// The object in dark surroundings; `split` divides the voxels into two classes.
fn bright_object(samples: &Samples, split: f64) -> Option<BrightObject> {
    let silhouettes = [0, 1, 2].map(|axis| samples.silhouette(axis));
    let mut candidates = vec![split];
    for (values, _) in &silhouettes {
        candidates.extend(
            Bins::new(values.iter().copied())
                .iter()
                .flat_map(Bins::thresholds),
        );
    }
    candidates.sort_by(f64::total_cmp);
    let shows_an_object = |threshold: &f64| {
        let of_axes = silhouettes.each_ref().map(|s| coverage(s, *threshold));
        of_axes.iter().all(|[all, _]| *all >= MIN_COVERAGE)
            && of_axes.iter().filter(|[_, own]| *own > BOX_COVERAGE).count() < 2
    };
    let object = candidates.into_iter().find(shows_an_object);
    let threshold = object.unwrap_or(split);
    let lines = silhouettes.iter().flat_map(|(values, _)| values.iter().copied());
    let beside: Vec<f64> = lines.filter(|v| *v <= threshold).collect();
    let noise = percentile(beside, NOISE_PERCENTILE)
        .or_else(|| {
            percentile(
                samples.finite().filter(|v| *v <= threshold).collect(),
                NOISE_PERCENTILE,
            )
        })
        .unwrap_or(threshold);
    let start = noise + OBJECT_START * (threshold - noise);
    let background = percentile(samples.finite().filter(|v| *v <= start).collect(), 0.5)?;
    let extreme = percentile(samples.finite().filter(|v| *v > start).collect(), ROBUST)?;
    (extreme > start && start > background).then_some(BrightObject {
        background,
        threshold: start,
        extreme,
        is_box: object.is_none(),
    })
}
