//! Label maps: volumes whose values are the numbers of regions. A volume is a label map if the file
//! or the user declares it; without a declaration this is guessed from the distribution of the
//! values.

use super::{Rescale, Volume, Voxels};
use std::collections::HashSet;

/// Largest relative deviation of a scaled value from the integer it represents.
const ROUNDING: f64 = 1e-6;

/// Values that cannot be labels.
#[derive(Clone, Copy, Default)]
struct Misfits {
    /// The smallest value that is negative or too large.
    out_of_range: Option<f64>,
    /// The smallest value that is not an integer.
    fraction: Option<f64>,
    /// Number of non-finite values, which count as unlabelled.
    not_finite: usize,
}

impl Misfits {
    fn note(mut self, value: f64) -> Self {
        let lower = |a: Option<f64>| Some(a.map_or(value, |a| a.min(value)));
        if !value.is_finite() {
            self.not_finite += 1;
        } else if (value - value.round()).abs() > ROUNDING * value.abs().max(1.0) {
            self.fraction = lower(self.fraction);
        } else if !(-0.5..=f64::from(u32::MAX)).contains(&value) {
            self.out_of_range = lower(self.out_of_range);
        }
        self
    }

    fn and(self, other: Self) -> Self {
        let lower = |a: Option<f64>, b: Option<f64>| a.into_iter().chain(b).reduce(f64::min);
        Self {
            out_of_range: lower(self.out_of_range, other.out_of_range),
            fraction: lower(self.fraction, other.fraction),
            not_finite: self.not_finite + other.not_finite,
        }
    }
}

impl Volume {
    /// The volume as a label map, as declared: its values as integers; 0 and non-finite values are
    /// unlabelled.
    ///
    /// # Errors
    /// Colours, or a value that is not a non-negative integer; a sentence that names it.
    pub fn into_label_map(mut self) -> Result<Self, String> {
        if self.colors.is_some() {
            return Err("is not a label map: it contains colours, not labels".into());
        }
        let Rescale { slope, intercept } = self.rescale;
        let value = move |stored: f64| stored * slope + intercept;
        let padding = self.padding;
        let is_padding = |stored: f64| padding.is_some_and(|[low, high]| (low..=high).contains(&stored));
        let misfits = self.voxels.fold(
            Misfits::default,
            |found, stored| {
                if is_padding(stored) {
                    found
                } else {
                    found.note(value(stored))
                }
            },
            Misfits::and,
        );
        if let Some(v) = misfits.fraction {
            return Err(format!(
                "is not a label map: it contains the value {v}, but labels are whole numbers"
            ));
        }
        if let Some(v) = misfits.out_of_range {
            return Err(format!(
                "is not a label map: it contains the value {v}, but labels are whole numbers from 0 to {}",
                u32::MAX
            ));
        }
        if misfits.not_finite > 0 {
            self.warnings.push(format!(
                "{} voxels are not finite numbers; they are treated as unlabelled",
                misfits.not_finite
            ));
        }
        if !self.voxels.is_integer() || self.rescale != Rescale::NONE || padding.is_some() {
            let label = |stored: f64| {
                if is_padding(stored) || !stored.is_finite() {
                    0.0
                } else {
                    value(stored).round()
                }
            };
            let labels: Voxels = match self.range[1] {
                v if v <= 255.0 => self.voxels.map(|s| label(s) as u8).into(),
                v if v <= 65_535.0 => self.voxels.map(|s| label(s) as u16).into(),
                _ => self.voxels.map(|s| label(s) as u32).into(),
            };
            let plain = Self::new(labels, Rescale::NONE, self.world_from_voxel);
            let (voxels, range) = (plain.voxels, plain.range);
            (
                self.voxels,
                self.range,
                self.rescale,
                self.padding,
                self.padded,
                self.non_finite,
            ) = (voxels, range, Rescale::NONE, None, 0, 0);
        }
        self.declared_labels = true;
        self.statistics = super::VolumeStatistics::default();
        Ok(self)
    }

    /// The number of distinct labels other than 0, if this is a label map: an unscaled integer
    /// volume without negative values that is declared to be one, or that looks like one (at most
    /// 1000 labels, or 255 if any of them exceeds 1000; at least 90 % of all voxels, and 75 % of
    /// those with a label, equal their neighbour along i).
    pub fn labels(&self) -> Option<usize> {
        *self.statistics.labels.get_or_init(|| self.count_labels())
    }

    fn count_labels(&self) -> Option<usize> {
        let whole = self.colors.is_none()
            && self.padding.is_none()
            && self.rescale == Rescale::NONE
            && self.voxels.is_integer();
        if !whole || self.range[0] < 0.0 || self.range[1] > f64::from(u32::MAX) {
            return None;
        }
        if self.declared_labels {
            return Some(self.distinct().len());
        }
        if self.range[1] > 65_535.0 {
            return None;
        }
        let [inside, like_neighbour] = self.inside_and_like_their_neighbour();
        let piecewise_constant =
            inside > 0 && like_neighbour as f64 >= 0.75 * inside as f64 && self.flat_share() >= 0.9;
        if !piecewise_constant {
            return None;
        }
        let distinct = self.distinct().len();
        (distinct <= 1000 && (self.range[1] <= 1000.0 || distinct <= 255)).then_some(distinct)
    }

    /// The labels that occur, without 0.
    fn distinct(&self) -> HashSet<u32> {
        let mut seen = self.voxels.fold(
            HashSet::new,
            |mut seen, v| {
                seen.insert(v as u32);
                seen
            },
            |a, b| {
                let (mut large, small) = if a.len() >= b.len() { (a, b) } else { (b, a) };
                large.extend(small);
                large
            },
        );
        seen.remove(&0);
        seen
    }

    /// Voxels with a label, and those of them that equal their predecessor along i.
    fn inside_and_like_their_neighbour(&self) -> [usize; 2] {
        let of_row = |[mut inside, mut like]: [usize; 2], row: &mut dyn Iterator<Item = f64>| {
            let mut last = f64::NAN;
            for v in row {
                inside += usize::from(v != 0.0);
                like += usize::from(v != 0.0 && v == last);
                last = v;
            }
            [inside, like]
        };
        self.voxels
            .fold_rows([0; 2], of_row, |a, b| [a[0] + b[0], a[1] + b[1]])
    }

    /// Fraction of voxels that equal their successor along i.
    fn flat_share(&self) -> f64 {
        let of_row = |equal: usize, row: &mut dyn Iterator<Item = f64>| {
            let mut last = row.next();
            equal + row.filter(|v| last.replace(*v) == Some(*v)).count()
        };
        let equal = self.voxels.fold_rows(0, of_row, |a, b| a + b);
        let [nx, ny, nz] = self.size;
        equal as f64 / (nx.saturating_sub(1) * ny * nz).max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::StoredValues;
    use glam::DAffine3;

    fn volume(values: StoredValues, rescale: Rescale) -> Volume {
        let voxels = Voxels::new([values.len(), 1, 1], values);
        Volume::new(voxels, rescale, DAffine3::IDENTITY)
    }

    #[test]
    fn what_is_said_to_be_a_label_map_is_one() {
        // Two thousand labels of one voxel each: this does not look like a label map.
        let many: Vec<u16> = (0..2000).collect();
        let guessed = volume(many.clone().into(), Rescale::NONE);
        assert_eq!(guessed.labels(), None);
        assert_eq!(guessed.into_label_map().map(|v| v.labels()), Ok(Some(1999)));
        let large = volume(vec![0u32, 4_000_000_000, 7].into(), Rescale::NONE).into_label_map();
        assert_eq!(large.map(|v| v.labels()), Ok(Some(2)));
        let floats = volume(vec![0.0f32, 300.0, f32::NAN, 300.0].into(), Rescale::NONE).into_label_map();
        let floats = floats.unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(
            (floats.labels(), floats.voxels.type_name(), floats.warnings.len()),
            (Some(1), "u16", 1)
        );
        let scaled = volume(
            vec![0i16, 10, 20].into(),
            Rescale {
                slope: 0.1,
                intercept: 0.0,
            },
        )
        .into_label_map();
        assert_eq!(scaled.map(|v| (v.labels(), v.range)), Ok((Some(2), [0.0, 2.0])));
    }

    #[test]
    fn what_is_none_is_refused_with_the_value_that_is_none() {
        let problem = |v: Volume| v.into_label_map().err().unwrap_or_default();
        assert!(problem(volume(vec![0.0f32, 1.5].into(), Rescale::NONE)).contains("the value 1.5"));
        assert!(problem(volume(vec![0i16, -3].into(), Rescale::NONE)).contains("the value -3"));
    }
}
