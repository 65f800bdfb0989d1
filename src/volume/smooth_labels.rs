//! Smooth boundaries of label maps: the margin by which each voxel has its label.
//!
//! A label is where its smoothed indicator exceeds those of all others: the 1/2 between two. Here
//! an indicator is 1 in the label's voxels and -1 elsewhere. Each round low-passes it by 2S - S²,
//! where S are passes of 1-2-1 along every axis, and puts every voxel back on its own side, at least
//! by the smallest margin. The surface between two labels thus loses the steps of the voxels, plates
//! and rods of one voxel keep their thickness, and no surface crosses the centre of a voxel: nothing
//! disappears (the bound of Whitaker, "Reducing aliasing artifacts in iso-surfaces of binary
//! volumes", 2000, and the filter of Taubin, "A signal processing approach to fair surface design",
//! 1995).
//!
//! One number per voxel suffices for any number of labels: its own label's margin over all others.
//! Between voxels, the label with the largest sum of interpolated margins is shown
//! ([`Colors::sample`](super::Colors::sample)).

use super::voxels::with_values;
use super::{TypedArray, Voxels};
use crate::math::flat;
use rayon::prelude::*;

/// Number of rounds, and of passes of the filter S: a slanted plane keeps steps of 0.1 voxels at most
/// (root mean square).
const ROUNDS: usize = 4;
const PASSES: usize = 2;
/// The margin of a voxel that is surrounded by its own label.
const SURE: i8 = 127;
/// The least margin where a label is only one voxel thick.
const THIN: i8 = 64;
/// The presence of a voxel that is as much inside as outside.
pub const HALF_PRESENT: f32 = 127.0;

/// The margin of each labelled voxel over other labels, 1 to 127. Voxels without a label do not
/// count, and have 0.
pub fn label_margins(labels: &Voxels) -> Vec<u8> {
    let margins = with_values!(labels, v => margins(flat(v), labels.size(), between_labels));
    margins.into_iter().map(i8::unsigned_abs).collect()
}

/// How surely each voxel has any label: 0 (surely none) to 254 (surely one), with the surface at
/// [`HALF_PRESENT`].
pub fn presence(labels: &Voxels) -> Vec<u8> {
    let is_labelled = labels.map(|label| label >= 1.0);
    smooth_mask(flat(&is_labelled), labels.size())
        .into_iter()
        .map(|margin| (i16::from(margin) + i16::from(SURE)) as u8)
        .collect()
}

/// The smoothed indicator of a mask of a size along i, j, k: 1 to 127 inside, -127 to -1 outside.
pub fn smooth_mask(mask: &[bool], size: [usize; 3]) -> Vec<i8> {
    let mut margins = margins(mask, size, |own, other| if own == other { 1 } else { -1 });
    margins
        .par_iter_mut()
        .zip(mask)
        .filter(|(_, inside)| !**inside)
        .for_each(|(margin, _)| *margin = -*margin);
    margins
}

/// How the indicator of a voxel's label changes with another voxel; 0 if either has no label.
fn between_labels<T: Default + PartialEq>(own: T, other: T) -> i32 {
    let none = T::default();
    if own == none || other == none {
        0
    } else if own == other {
        1
    } else {
        -1
    }
}

/// The indicator of every voxel's own label after smoothing: 1 to [`SURE`], or 0 where a voxel does
/// not agree with itself. `agreement`: 1 for a voxel of the same label, -1 for one of another, 0 for
/// one that does not count.
fn margins<T: Copy + PartialEq + Send + Sync>(
    labels: &[T],
    size: [usize; 3],
    agreement: impl Fn(T, T) -> i32 + Sync,
) -> Vec<i8> {
    let start = |label: T| agreement(label, label) as i8 * SURE;
    let low_pass = |field: &[i8]| {
        (1..PASSES).fold(filtered(labels, field, size, &agreement), |field, _| {
            filtered(labels, &field, size, &agreement)
        })
    };
    let mut field: Vec<i8> = labels.par_iter().map(|&label| start(label)).collect();
    for _ in 0..ROUNDS {
        let once = low_pass(&field);
        let twice = low_pass(&once);
        field
            .par_iter_mut()
            .enumerate()
            .zip(once.par_iter().zip(&twice))
            .filter(|((n, _), _)| start(labels[*n]) > 0)
            .for_each(|((n, to), (once, twice))| {
                let sharp = (2 * i16::from(*once) - i16::from(*twice)).clamp(1, i16::from(SURE)) as i8;
                *to = if sharp < THIN && is_thin(labels, size, n) {
                    THIN
                } else {
                    sharp
                };
            });
    }
    field
}

/// Whether none of the eight blocks of 2 x 2 x 2 voxels around a voxel has one label.
fn is_thin<T: Copy + PartialEq>(labels: &[T], size: [usize; 3], index: usize) -> bool {
    let [nx, ny, _] = size;
    let at = [index % nx, index / nx % ny, index / (nx * ny)];
    (0..8usize).all(|block| {
        (1..8usize).any(|corner| {
            // The voxel itself, or the next one before or after it along each axis.
            let voxel = [0, 1, 2].map(|a| match (corner >> a & 1, block >> a & 1) {
                (0, _) => at[a],
                (_, 0) => at[a].saturating_sub(1),
                _ => (at[a] + 1).min(size[a] - 1),
            });
            labels[(voxel[2] * ny + voxel[1]) * nx + voxel[0]] != labels[index]
        })
    })
}

/// Weights of the filter along each axis; those of a voxel's surroundings sum to 64.
const WEIGHTS: [i32; 3] = [1, 2, 1];

/// One pass of the filter over the indicator of every voxel's own label.
fn filtered<T: Copy + PartialEq + Send + Sync>(
    labels: &[T],
    field: &[i8],
    size: [usize; 3],
    agreement: &(impl Fn(T, T) -> i32 + Sync),
) -> Vec<i8> {
    let [nx, ny, nz] = size;
    let mut out = field.to_vec();
    out.par_chunks_mut(nx.max(1))
        .enumerate()
        .for_each_init(Vec::new, |even, (row, to)| {
            let (j, k) = (row % ny, row / ny);
            let beside = |at: usize, n: usize, offset: usize| (at + offset).saturating_sub(1).min(n - 1);
            let rows: [usize; 9] =
                std::array::from_fn(|n| (beside(k, nz, n / 3) * ny + beside(j, ny, n % 3)) * nx);
            let (own, own_field) = (&labels[row * nx..][..nx], &field[row * nx..][..nx]);
            // Positions whose nine voxels across the row are alike.
            even.clear();
            even.extend(own.iter().map(|_| true));
            for at in rows {
                let (other, other_field) = (&labels[at..][..nx], &field[at..][..nx]);
                for (n, e) in even.iter_mut().enumerate() {
                    *e &= (own[n] == other[n]) & (own_field[n] == other_field[n]);
                }
            }
            for i in 0..nx {
                let columns = [i.saturating_sub(1), i, (i + 1).min(nx - 1)];
                let alike = |&c: &usize| even[c] && own[c] == own[i] && own_field[c] == own_field[i];
                if columns.iter().all(alike) {
                    continue;
                }
                let mut sum = 0;
                for (n, at) in rows.iter().enumerate() {
                    let across = WEIGHTS[n / 3] * WEIGHTS[n % 3];
                    for (c, along) in columns.iter().zip(WEIGHTS) {
                        let share = agreement(own[i], labels[at + c]) * i32::from(field[at + c]);
                        sum += across * along * share;
                    }
                }
                to[i] = ((sum + 32) >> 6) as i8;
            }
        });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const N: usize = 32;

    fn labelled(label: impl Fn([f32; 3]) -> u8) -> Voxels {
        let voxels: Vec<u8> = (0..N * N * N)
            .map(|n| label([n % N, n / N % N, n / (N * N)].map(|c| c as f32)))
            .collect();
        Voxels::new([N; 3], voxels)
    }

    /// Where the presence along a row of voxels falls through 1/2.
    fn end_of_row(presence: &[u8], j: usize, k: usize) -> f32 {
        let row = &presence[(k * N + j) * N..][..N];
        let last = row.iter().rposition(|&p| f32::from(p) > HALF_PRESENT).unwrap();
        let [a, b] = [row[last], row[last + 1]].map(f32::from);
        last as f32 + (a - HALF_PRESENT) / (a - b)
    }

    /// A slanted plane, whose voxels form steps: the surface deviates from the plane by less than
    /// half of what the voxels' own faces do.
    #[test]
    fn steps_are_flattened() {
        for slope in [0.2, 0.35, 0.5, 0.8] {
            let end = |j: usize, k: usize| 6.3 + slope * j as f32 + 0.17 * k as f32;
            let voxels = labelled(|[x, y, z]| u8::from(x < end(y as usize, z as usize)));
            let smooth = presence(&voxels);
            let (mut ours, mut steps) = (0.0, 0.0);
            for (j, k) in (4..20).flat_map(|j| (4..20).map(move |k| (j, k))) {
                let at = end(j, k);
                ours += (end_of_row(&smooth, j, k) - at).powi(2);
                // The last voxel inside ends half a voxel beyond its centre.
                steps += (at.ceil() - 0.5 - at).powi(2);
            }
            let rms = |sum: f32| (sum / 256.0f32).sqrt();
            assert!(
                rms(ours) < 0.5 * rms(steps),
                "{slope}: {} of {}",
                rms(ours),
                rms(steps)
            );
        }
    }

    /// Every voxel keeps its side, and a plate of two voxels its thickness within a third of a voxel.
    #[test]
    fn nothing_disappears() {
        let plate = labelled(|[x, y, z]| match [x, y, z].map(|c| c as usize) {
            [4, ..] => 4,
            [10 | 11, ..] => 1,
            [20, 5, _] => 2,
            [25, 25, 25] => 3,
            _ => 0,
        });
        let smooth = presence(&plate);
        let margins = label_margins(&plate);
        for (n, (p, m)) in smooth.iter().zip(&margins).enumerate() {
            let labelled = plate.get(n) > 0.0;
            assert_eq!(f32::from(*p) > HALF_PRESENT, labelled, "{n}");
            assert_eq!(*m > 0, labelled, "{n}");
            // What is one voxel thick stays as thick.
            assert!(plate.get(n) != 4.0 || *m >= 64, "{n}: {m}");
        }
        let end = end_of_row(&smooth, 16, 16);
        assert!((11.34..11.5).contains(&end), "{end}");
    }

    /// Two labels meet in a smooth surface of their own, which what is unlabelled does not shift.
    #[test]
    fn labels_meet_half_way() {
        let voxels = labelled(|[x, y, z]| match (y < 16.0, x < 4.0 + 0.5 * z) {
            (true, left) => 1 + u8::from(left),
            (false, _) => 0,
        });
        let margins = label_margins(&voxels);
        let signed = |i: usize, j: usize, k: usize| {
            let at = (k * N + j) * N + i;
            f32::from(margins[at]) * if voxels.get(at) == 2.0 { 1.0 } else { -1.0 }
        };
        for j in [4, 15] {
            for k in 6..26 {
                let at = 4.0 + 0.5 * k as f32;
                // The row at which label 2 ends.
                let last = (0..N - 1).rfind(|&i| signed(i, j, k) > 0.0).unwrap();
                let (a, b) = (signed(last, j, k), signed(last + 1, j, k));
                let end = last as f32 + a / (a - b);
                // Voxel centres that lie on the plane belong to label 1.
                assert!((end - (at - 0.25)).abs() < 0.2, "{j} {k}: {end} {at}");
            }
        }
    }
}
