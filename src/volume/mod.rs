//! Volumes: typed voxels as stored, their geometry in world millimetres (LPS), range and histogram;
//! colours and labels; samples and gradients; phantoms; reading ([`load`]) and writing ([`save`]).
//!
//! Renderers never see the stored type: they use a [`VoxelGrid`], which shares the voxels of the
//! types that both the CPU and a GPU sample natively (u8, i16, u16, f32) and converts the rest
//! once. A sample is *normalised*: 0 at the lowest finite value of the volume, 1 at the highest. A
//! NaN or infinite voxel is empty and normalises below 0 (see [`VoxelGrid`]).

mod colors;
mod cubic;
mod foreground;
pub mod function;
mod gradient;
mod grid;
mod label_map;
mod lanes;
pub mod load;
pub mod pages;
pub mod phantom;
mod sampler;
pub mod save;
mod smooth_labels;
mod voxels;

pub use colors::{Colors, Label, straight};
pub use foreground::Foreground;
pub use gradient::{GradientFilter, GradientVolume};
pub use grid::{HOLE, Voxel, VoxelGrid, VoxelGridValues};
pub use sampler::VolumeSampler;
pub use smooth_labels::smooth_mask;
pub use voxels::{StoredValues, TypedArray, Voxels};

use crate::{Error, Result};
use glam::{DAffine3, DMat3, DVec3};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// A scalar volume.
#[derive(Clone, Debug)]
pub struct Volume {
    /// Stored values, of shape (k, j, i).
    pub voxels: Voxels,
    /// Voxels along i, j, k.
    pub size: [usize; 3],
    /// Value in data units = slope · stored + intercept.
    pub rescale: Rescale,
    /// Voxel indices (centres at integers) to world millimetres, LPS.
    pub world_from_voxel: DAffine3,
    /// Smallest and largest finite value in data units; `[0, 1]` if there is none.
    pub range: [f64; 2],
    /// Number of NaN and infinite voxels.
    pub non_finite: usize,
    /// Smallest and largest stored value that mean "no value" (DICOM's pixel padding), if any.
    pub padding: Option<[f64; 2]>,
    /// Number of such voxels.
    pub padded: usize,
    /// Whether high values are dark (DICOM's MONOCHROME1).
    pub inverted: bool,
    /// The function of world millimetres that samples are taken from instead of from the voxels,
    /// which it agrees with at their centres.
    pub function: Option<Arc<function::Expression>>,
    /// The voxels' own colours, if they have any; then `voxels` are their luminance or opacity.
    pub colors: Option<Colors>,
    /// Values per voxel in the file.
    pub components: usize,
    /// Type of the values in the file.
    pub source_type: &'static str,
    /// Format of the file.
    pub format: &'static str,
    /// The displacement of slices from their scanned positions.
    pub misplaced: Option<SliceDisplacement>,
    /// Whether the source declares the volume a label map.
    pub declared_labels: bool,
    /// The source's descriptions of single labels.
    pub label_table: Vec<Label>,
    /// Further information from the source.
    pub details: Vec<(&'static str, serde_json::Value)>,
    /// Irregularities of the source, one sentence each.
    pub warnings: Vec<String>,
    /// Cached statistics of the voxels.
    statistics: VolumeStatistics,
}

/// Slices of a scan that are shown at other positions than scanned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SliceDisplacement {
    /// Largest displacement, mm.
    pub by_mm: f64,
    /// Whether interpolating them onto an even grid (`resample`) corrects it.
    pub resampling_helps: bool,
}

/// Statistics that need a pass over all voxels, cached once computed: a live view requests them for
/// every frame. A copy computes them again, because its voxels may change first.
#[derive(Debug, Default)]
struct VolumeStatistics {
    histograms: Mutex<Vec<Arc<Histogram>>>,
    labels: OnceLock<Option<usize>>,
    foreground: OnceLock<Option<Foreground>>,
}

impl Clone for VolumeStatistics {
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// The extent of an image: size and geometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridGeometry {
    /// Voxels along i, j, k.
    pub size: [usize; 3],
    /// Voxel indices to world millimetres, LPS.
    pub world_from_voxel: DAffine3,
}

/// The linear map from stored to data values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rescale {
    /// Data units per stored unit; never 0.
    pub slope: f64,
    /// Data value of stored 0.
    pub intercept: f64,
}

impl Rescale {
    /// Stored values are data values.
    pub const NONE: Self = Self {
        slope: 1.0,
        intercept: 0.0,
    };
}

/// Counts of the finite values in equal bins over the volume's range.
#[derive(Clone, Debug)]
pub struct Histogram {
    /// Data value at the lower edge of the first bin.
    pub low: f64,
    /// Data value at the upper edge of the last bin.
    pub high: f64,
    /// Voxels per bin.
    pub counts: Vec<u64>,
}

/// Value of water in Hounsfield units that were shifted to be positive.
const SHIFTED_ZERO: f64 = 1024.0;
/// Values of air in such units, at most.
const SHIFTED_AIR: f64 = 120.0;
/// Their largest value: 12 bits, and metal.
const MAX_SHIFTED: f64 = 5000.0;

impl Volume {
    /// A volume of the given voxels ([`Voxels`], or an [`Array3`](ndarray::Array3) of shape (k, j,
    /// i)); finds their range.
    pub fn new(voxels: impl Into<Voxels>, rescale: Rescale, world_from_voxel: DAffine3) -> Self {
        Self::with_padding(voxels.into(), rescale, world_from_voxel, None)
    }

    /// Wraps voxels of which a range of stored values means "no value".
    pub fn with_padding(
        voxels: Voxels,
        rescale: Rescale,
        world_from_voxel: DAffine3,
        padding: Option<[f64; 2]>,
    ) -> Self {
        let size = voxels.size();
        let (stored, [non_finite, padded]) = voxels.finite_range(padding);
        let range = match stored {
            Some([a, b]) => {
                let (a, b) = (
                    a * rescale.slope + rescale.intercept,
                    b * rescale.slope + rescale.intercept,
                );
                [a.min(b), a.max(b)]
            }
            None => [0.0, 1.0],
        };
        let source_type = voxels.type_name();
        Self {
            voxels,
            size,
            rescale,
            world_from_voxel,
            range,
            non_finite,
            padding: padding.filter(|_| padded > 0),
            padded,
            inverted: false,
            function: None,
            colors: None,
            components: 1,
            source_type,
            format: "none",
            declared_labels: false,
            label_table: Vec::new(),
            details: Vec::new(),
            misplaced: None,
            warnings: Vec::new(),
            statistics: VolumeStatistics::default(),
        }
    }

    /// Whether a stored value means "no value".
    pub fn is_padding(&self, stored: f64) -> bool {
        self.padding
            .is_some_and(|[low, high]| (low..=high).contains(&stored))
    }

    /// Sets the distances between voxel centres, mm; the first voxel and the directions are
    /// unchanged.
    ///
    /// # Errors
    /// A distance that is not positive.
    pub fn set_spacing(&mut self, spacing_mm: [f64; 3]) -> Result<()> {
        if !spacing_mm
            .iter()
            .all(|s| s.is_finite() && (1e-9..1e9).contains(s))
        {
            return Err(Error::value(
                "spacing",
                format!("{spacing_mm:?} are not three positive distances in mm"),
            ));
        }
        let direction = self.direction();
        self.world_from_voxel.matrix3 = direction * DMat3::from_diagonal(DVec3::from_array(spacing_mm));
        Ok(())
    }

    /// An empty volume over a box, 128 voxels along its longest edge, from which a scene of meshes
    /// takes its lengths.
    pub fn empty_over(bounds: &crate::math::Bounds) -> Self {
        let extent = if bounds.is_empty() {
            glam::Vec3::ONE
        } else {
            bounds.size().max(glam::Vec3::splat(f32::MIN_POSITIVE))
        };
        let spacing = extent.max_element() / 128.0;
        let size = (extent / spacing)
            .ceil()
            .max(glam::Vec3::ONE)
            .to_array()
            .map(|n| n as usize);
        let middle = if bounds.is_empty() {
            glam::Vec3::ZERO
        } else {
            bounds.center()
        };
        let first = middle - glam::Vec3::from(size.map(|n| (n - 1) as f32)) * (0.5 * spacing);
        let world_from_voxel = DAffine3::from_translation(first.as_dvec3())
            * DAffine3::from_scale(DVec3::splat(f64::from(spacing)));
        Self::new(
            Voxels::new(size, vec![0u8; size.iter().product()]),
            Rescale::NONE,
            world_from_voxel,
        )
    }

    /// The volume's size and geometry.
    pub fn geometry(&self) -> GridGeometry {
        GridGeometry {
            size: self.size,
            world_from_voxel: self.world_from_voxel,
        }
    }

    /// Data value of the voxel (i, j, k).
    pub fn value(&self, i: usize, j: usize, k: usize) -> f64 {
        self.voxels.at([i, j, k]) * self.rescale.slope + self.rescale.intercept
    }

    /// Distance between voxel centres along each grid axis, mm.
    pub fn spacing_mm(&self) -> DVec3 {
        let m = self.world_from_voxel.matrix3;
        DVec3::new(m.x_axis.length(), m.y_axis.length(), m.z_axis.length())
    }

    /// Unit vectors of the grid axes in world space, as columns.
    pub fn direction(&self) -> DMat3 {
        let m = self.world_from_voxel.matrix3;
        let s = self.spacing_mm();
        DMat3::from_cols(m.x_axis / s.x, m.y_axis / s.y, m.z_axis / s.z)
    }

    /// The letters of the directions in which i, j, k increase, e.g. `LPS`: each axis by its
    /// largest component, no letter twice.
    pub fn orientation(&self) -> String {
        let direction = self.direction();
        let mut free = [true; 3];
        let mut letters = ['?'; 3];
        // The most clearly aligned axis is assigned first.
        let mut order = [0usize, 1, 2];
        order.sort_by(|&a, &b| {
            direction
                .col(b)
                .abs()
                .max_element()
                .total_cmp(&direction.col(a).abs().max_element())
        });
        for axis in order {
            let column = direction.col(axis);
            let world = (0..3)
                .filter(|&w| free[w])
                .max_by(|&a, &b| column[a].abs().total_cmp(&column[b].abs()))
                .unwrap_or(0);
            free[world] = false;
            letters[axis] = [['L', 'R'], ['P', 'A'], ['S', 'I']][world][usize::from(column[world] < 0.0)];
        }
        letters.iter().collect()
    }

    /// Irregularities of the source, and the option that corrects them, for a command line.
    pub fn warnings_with_options(&self) -> Vec<String> {
        let mends = self.misplaced.is_some_and(|m| m.resampling_helps);
        let option = mends.then(|| "use --resample to interpolate the slices onto a regular grid".to_owned());
        self.warnings.iter().cloned().chain(option).collect()
    }

    /// The angle between the k axis and the normal of the planes of i and j, degrees: a CT gantry's
    /// tilt.
    pub fn tilt_degrees(&self) -> f64 {
        let m = self.world_from_voxel.matrix3;
        let normal = m.x_axis.cross(m.y_axis).normalize_or_zero();
        normal
            .cross(m.z_axis)
            .length()
            .atan2(normal.dot(m.z_axis).abs())
            .to_degrees()
    }

    /// A histogram of the finite values, without padding.
    pub fn histogram(&self, bins: usize) -> Arc<Histogram> {
        let lock = || {
            self.statistics
                .histograms
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
        };
        if let Some(statistics) = lock().iter().find(|h| h.counts.len() == bins) {
            return statistics.clone();
        }
        // Computed outside the lock: a pool thread that waits for its part may run another task
        // that requests a histogram.
        let made = Arc::new(self.count(bins));
        lock().push(made.clone());
        made
    }

    fn count(&self, bins: usize) -> Histogram {
        let [low, high] = self.range;
        let scale = bins as f64 / (high - low).max(f64::MIN_POSITIVE);
        let (slope, intercept) = (self.rescale.slope, self.rescale.intercept);
        let counts = self.voxels.fold(
            || vec![0u64; bins],
            |mut counts, stored| {
                if stored.is_finite() && !self.is_padding(stored) {
                    let bin = ((stored * slope + intercept - low) * scale) as usize;
                    counts[bin.min(bins - 1)] += 1;
                }
                counts
            },
            |mut a, b| {
                a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
                a
            },
        );
        Histogram { low, high, counts }
    }

    /// What of the volume is the object; none if all its values are the same.
    pub fn foreground(&self) -> Option<Foreground> {
        *self
            .statistics
            .foreground
            .get_or_init(|| foreground::foreground(self))
    }

    /// The data value of 0 Hounsfield units, where the values are Hounsfield units: as declared, or
    /// shifted to be positive. Such scans are recognised by their range (air far below water, and
    /// bone), and shifted ones also by the peak of soft tissue 1024 units above air.
    pub fn hounsfield_zero(&self) -> Option<f64> {
        let [low, high] = self.range;
        if low <= -500.0 && high >= 300.0 {
            return Some(0.0);
        }
        if !(low.abs() <= SHIFTED_AIR && (1300.0..=MAX_SHIFTED).contains(&high)) {
            return None;
        }
        let histogram = self.histogram(1024);
        let share = |from: f64, to: f64| {
            let bin = |v: f64| {
                let n = (v - low) / (high - low) * histogram.counts.len() as f64;
                (n.max(0.0) as usize).min(histogram.counts.len())
            };
            histogram.counts[bin(from)..bin(to).max(bin(from))]
                .iter()
                .sum::<u64>() as f64
        };
        let tissue = share(SHIFTED_ZERO - 150.0, SHIFTED_ZERO + 110.0);
        let other = share(SHIFTED_ZERO - 500.0, high + 1.0) - tissue;
        let air = share(low, SHIFTED_AIR);
        (tissue > 4.0 * other && air > 0.02 * self.voxels.len() as f64 && tissue > air * 0.05)
            .then_some(SHIFTED_ZERO)
    }

    /// The modality that the source states (CT, MR, PT, ...), if it does.
    pub fn modality(&self) -> Option<&str> {
        let stated = self.details.iter().find(|(name, _)| *name == "modality");
        stated.and_then(|(_, value)| value.as_str())
    }

    /// A value between the surroundings of a scanned body and the body itself: -300 for Hounsfield
    /// units (with a lowest value near air's), else an eighth of the way from the lowest value to
    /// the robust maximum.
    pub fn body_threshold(&self) -> f64 {
        let [low, high] = self.range;
        if low <= -900.0 && high >= 200.0 {
            return -300.0;
        }
        let top = self.histogram(2048).percentile(0.99, true);
        low + 0.125 * (top - low)
    }

    /// Values that a grey picture shows as black and white: from a window's width and level where
    /// given; else -160 to 240 for Hounsfield units, and from a 25th of the way to the robust
    /// maximum up to it otherwise (the surroundings of a body are black).
    pub fn window(&self, width: Option<f64>, level: Option<f64>) -> [f64; 2] {
        let [low, high] = self.range;
        let own = if low <= -900.0 && high >= 200.0 {
            [-160.0, 240.0]
        } else {
            {
                let top = self.histogram(2048).percentile(0.995, true);
                [low + 0.04 * (top - low), top]
            }
        };
        let width = width.unwrap_or(own[1] - own[0]);
        let level = level.unwrap_or(0.5 * (own[0] + own[1]));
        [level - 0.5 * width, level + 0.5 * width]
    }

    /// The box of the grid's cells (half a voxel around the outermost centres), in world
    /// millimetres.
    pub fn bounds_in_world(&self) -> crate::math::Bounds {
        let s = self.size.map(|n| n as f32);
        crate::math::Bounds::new(glam::Vec3::splat(-0.5), glam::Vec3::from(s) - 0.5)
            .transformed(&crate::math::to_f32(&self.world_from_voxel))
    }
}

impl Histogram {
    /// The data value below which `fraction` of the counted voxels lie; `skip_lowest` excludes the
    /// first bin (air).
    pub fn percentile(&self, fraction: f64, skip_lowest: bool) -> f64 {
        let counts = &self.counts[usize::from(skip_lowest)..];
        let total: u64 = counts.iter().sum();
        if total == 0 {
            return self.high;
        }
        let target = fraction * total as f64;
        let width = (self.high - self.low) / self.counts.len() as f64;
        let mut below = 0.0;
        for (bin, &count) in counts.iter().enumerate() {
            if below + count as f64 >= target && count > 0 {
                let within = (target - below) / count as f64;
                return self.low + (bin as f64 + usize::from(skip_lowest) as f64 + within) * width;
            }
            below += count as f64;
        }
        self.high
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volume(direction: DMat3) -> Volume {
        Volume::new(
            Voxels::new([2; 3], (0..8u8).collect::<Vec<_>>()),
            Rescale::NONE,
            DAffine3::from_mat3(direction),
        )
    }

    #[test]
    fn orientation_letters() {
        assert_eq!(volume(DMat3::IDENTITY).orientation(), "LPS");
        assert_eq!(
            volume(DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0))).orientation(),
            "RAS"
        );
        assert_eq!(
            volume(DMat3::from_cols(DVec3::Y * 2.0, DVec3::NEG_Z, DVec3::X)).orientation(),
            "PIL"
        );
    }

    #[test]
    fn histogram_and_percentiles() {
        let v = volume(DMat3::IDENTITY);
        let h = v.histogram(8);
        assert_eq!(h.counts, [1; 8]);
        assert!((h.percentile(0.5, false) - 3.5).abs() < 1e-9);
    }

    #[test]
    fn non_finite_voxels_are_counted_and_leave_the_range_alone() {
        let v = Volume::new(
            Voxels::new([4, 1, 1], vec![f32::NAN, 1.0, f32::INFINITY, -2.0]),
            Rescale::NONE,
            DAffine3::IDENTITY,
        );
        assert_eq!((v.non_finite, v.range), (2, [-2.0, 1.0]));
    }
}
