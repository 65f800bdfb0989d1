//! The sampled form of a volume: a grid of u8, i16, u16 or f32 and the scale to normalised values.
//!
//! Normalised: 0 = lowest finite value, 1 = highest. NaN and infinite voxels become [`HOLE`]. Every
//! finite voxel is at least 0, hence an interpolated sample below 0 touches a hole and is not
//! present. A hole thus extends one voxel into its neighbours, except for the last ten-thousandth
//! of a voxel, in which values between theirs and 0 remain.

use super::function::VolumeFunction;
use super::smooth_labels::{HALF_PRESENT, presence};
use super::{Colors, Rescale, Volume, Voxels};
use crate::math::arrays::shaped;
use crate::math::cells::Strides;
use crate::math::lanes::{LANES, Simd, f32x8};
use glam::Vec3;
use ndarray::{ArcArray3, Array3, Axis, Zip};
use std::sync::Arc;

/// The normalised value of an empty voxel.
pub const HOLE: f32 = -1e4;
/// Padding below the lowest value by this fraction of the range is a hole without conversion.
const PADDING_BELOW: f64 = 1e-3;

/// Typed voxels of shape (k, j, i) in standard layout, shared with the [`Volume`] where the type
/// allows.
#[derive(Clone, Debug)]
#[allow(missing_docs, reason = "the variants are the Rust types")]
pub enum VoxelGridValues {
    U8(ArcArray3<u8>),
    U16(ArcArray3<u16>),
    I16(ArcArray3<i16>),
    F32(ArcArray3<f32>),
}

/// A grid ready for rendering.
#[derive(Clone, Debug)]
pub struct VoxelGrid {
    /// The voxels.
    pub voxels: VoxelGridValues,
    /// Extent along i, j, k.
    pub size: [usize; 3],
    /// Normalised value = `scale` · voxel + `offset`.
    pub scale: f32,
    /// See `scale`.
    pub offset: f32,
    /// Whether any voxel is a [`HOLE`], or lies below 0 as one does.
    pub has_holes: bool,
    /// The voxels' own colours, if they have any.
    pub colors: Option<Colors>,
    /// The function that samples are taken from instead of from the voxels.
    pub function: Option<Arc<VolumeFunction>>,
}

/// A scalar type that the CPU samples directly.
pub trait Voxel: Copy + Send + Sync + 'static {
    /// The value as f32, exact for all four types.
    fn to_f32(self) -> f32;

    /// The rows of eight cells, given by their lowest corners, in the order of
    /// [`mix_rows`](crate::math::cells::mix_rows).
    fn cells<S: Simd>(
        simd: S,
        voxels: &[Self],
        base: &[usize; LANES],
        strides: Strides,
    ) -> [[f32x8<S>; 2]; 4];

    /// The rows of and around eight cells, given by their lowest corners; every cell must have a
    /// voxel on every side.
    fn around<S: Simd>(simd: S, voxels: &[Self], base: &[usize; LANES], strides: Strides) -> Neighborhood<S>;
}

/// Voxels of and around eight cells, with the rows in the order of
/// [`mix_rows`](crate::math::cells::mix_rows).
pub struct Neighborhood<S: Simd> {
    /// The cells' rows, from one voxel before the cell to one after it.
    pub rows: [[f32x8<S>; 4]; 4],
    /// Along the second axis, the rows below and above the near face, and those of the far face.
    pub neighbors_y: [[f32x8<S>; 2]; 4],
    /// Along the third axis, the low and the high row in front of the cell, and those behind it.
    pub neighbors_z: [[f32x8<S>; 2]; 4],
}

impl VoxelGrid {
    /// The grid of a volume. Shares the voxels of u8, i16, u16 and ordinary f32 volumes; i8 becomes
    /// i16, everything else normalised f32.
    pub fn new(volume: &Volume) -> Self {
        let Rescale { slope, intercept } = volume.rescale;
        let [low, high] = volume.range;
        let span = if high > low { high - low } else { 1.0 };
        let normalise = |stored: f64| {
            let present = stored.is_finite() && !volume.is_padding(stored);
            if present {
                ((stored * slope + intercept - low) / span) as f32
            } else {
                HOLE
            }
        };
        // Padding well below every value acts as a hole unchanged; any other is converted to one.
        let padding_below = volume.padding.is_some_and(|p| {
            p.iter()
                .all(|stored| stored * slope + intercept < low - PADDING_BELOW * span)
        });
        let has_holes = volume.non_finite > 0 || volume.padded > 0;
        let colors = volume.colors.clone();
        let function = volume.function.as_ref().map(|expression| {
            Arc::new(VolumeFunction {
                expression: expression.as_ref().clone(),
                world_from_voxel: crate::math::to_f32(&volume.world_from_voxel),
                scale: (1.0 / span) as f32,
                offset: (-low / span) as f32,
            })
        });
        let direct = |voxels| {
            let (scale, offset) = ((slope / span) as f32, ((intercept - low) / span) as f32);
            // An f32 volume of extreme magnitude has no usable single-precision scale: it is
            // normalised like an f64 volume.
            let has_holes = padding_below;
            (scale.is_normal() && offset.abs() < 1e6).then(|| Self {
                voxels,
                size: volume.size,
                scale,
                offset,
                has_holes,
                colors: colors.clone(),
                function: function.clone(),
            })
        };
        let shared = match &volume.voxels {
            _ if volume.padded > 0 && !padding_below => None,
            Voxels::U8(v) => direct(VoxelGridValues::U8(v.clone())),
            Voxels::U16(v) => direct(VoxelGridValues::U16(v.clone())),
            Voxels::I16(v) => direct(VoxelGridValues::I16(v.clone())),
            Voxels::F32(v) if volume.non_finite == 0 => direct(VoxelGridValues::F32(v.clone())),
            Voxels::I8(v) => direct(VoxelGridValues::I16(v.mapv(i16::from).into_shared())),
            _ => None,
        };
        shared.unwrap_or_else(|| Self {
            voxels: VoxelGridValues::F32(volume.voxels.map(normalise).into_shared()),
            size: volume.size,
            scale: 1.0,
            offset: 0.0,
            has_holes,
            colors,
            function,
        })
    }

    /// The grid of a label map: 1 where there is a label and 0 where there is none, in the labels'
    /// colours. A sample between two labels is then as present as either, rather than a third label
    /// numbered in between. `smooth`: the value changes gradually near the surface, where it is
    /// 1/2, and each sample has the colour of one label. None if the volume is not a label map.
    pub fn of_labels(volume: &Volume, smooth: bool) -> Option<Self> {
        volume.labels()?;
        let colors = Colors::of_labels(
            volume.voxels.clone(),
            volume.range[1] as usize,
            &volume.label_table,
        );
        let (voxels, scale, colors) = if smooth {
            let presence = shaped(volume.size, presence(&volume.voxels));
            (presence, 0.5 / HALF_PRESENT, colors.with_smooth_boundaries())
        } else {
            (volume.voxels.map(|label| u8::from(label >= 1.0)), 1.0, colors)
        };
        Some(Self {
            voxels: VoxelGridValues::U8(voxels.into_shared()),
            size: volume.size,
            scale,
            offset: 0.0,
            has_holes: false,
            colors: Some(colors),
            function: None,
        })
    }

    /// The grid with blocks of voxels averaged, the last ones of an axis being smaller; a block
    /// that contains only holes is a hole. Colours are omitted: see [`Colors::reduced`].
    pub fn reduced(&self, factors: [usize; 3]) -> Self {
        let size: [usize; 3] = std::array::from_fn(|a| self.size[a].div_ceil(factors[a]));
        let hole = |v: f32| v * self.scale + self.offset <= 0.5 * HOLE;
        let voxels = match &self.voxels {
            VoxelGridValues::U8(v) => VoxelGridValues::U8(means(v, factors, |_| false, |m| m.round() as u8)),
            VoxelGridValues::U16(v) => {
                VoxelGridValues::U16(means(v, factors, |_| false, |m| m.round() as u16))
            }
            VoxelGridValues::I16(v) => {
                VoxelGridValues::I16(means(v, factors, |_| false, |m| m.round() as i16))
            }
            VoxelGridValues::F32(v) => {
                VoxelGridValues::F32(means(v, factors, hole, |m| if m.is_nan() { HOLE } else { m }))
            }
        };
        Self {
            voxels,
            size,
            scale: self.scale,
            offset: self.offset,
            has_holes: self.has_holes,
            colors: None,
            function: self.function.clone(),
        }
    }

    /// Normalised value at a position in voxels: the function's, or that of the nearest voxel.
    pub fn value_near(&self, in_voxel: Vec3) -> f32 {
        if let Some(function) = &self.function {
            return function.values(&[in_voxel])[0];
        }
        let last = Vec3::from(self.size.map(|n| n as f32)) - 1.0;
        let nearest = in_voxel.round().clamp(Vec3::ZERO, last).as_uvec3();
        self.value(nearest.x as usize, nearest.y as usize, nearest.z as usize)
    }

    /// Normalised value at a voxel.
    pub fn value(&self, i: usize, j: usize, k: usize) -> f32 {
        let stored = match &self.voxels {
            VoxelGridValues::U8(v) => v[[k, j, i]].to_f32(),
            VoxelGridValues::U16(v) => v[[k, j, i]].to_f32(),
            VoxelGridValues::I16(v) => v[[k, j, i]].to_f32(),
            VoxelGridValues::F32(v) => v[[k, j, i]].to_f32(),
        };
        stored * self.scale + self.offset
    }
}

/// Means of blocks; NaN for a block of holes.
fn means<T: Voxel, U: Clone + Default + Send>(
    v: &ArcArray3<T>,
    factors: [usize; 3],
    hole: impl Fn(f32) -> bool + Sync,
    finish: impl Fn(f32) -> U + Sync,
) -> ArcArray3<U> {
    let (nk, nj, ni) = v.dim();
    let mut out = Array3::default((
        nk.div_ceil(factors[2]),
        nj.div_ceil(factors[1]),
        ni.div_ceil(factors[0]),
    ));
    let range = |at: usize, factor: usize, n: usize| at * factor..((at + 1) * factor).min(n);
    Zip::indexed(&mut out).par_for_each(|(k, j, i), to| {
        let layers = v.slice_axis(Axis(0), range(k, factors[2], nk).into());
        let rows = layers.slice_axis(Axis(1), range(j, factors[1], nj).into());
        let block = rows.slice_axis(Axis(2), range(i, factors[0], ni).into());
        let present = block.iter().map(|x| x.to_f32()).filter(|x| !hole(*x));
        let (sum, count) = present.fold((0.0f64, 0u32), |(sum, n), x| (sum + f64::from(x), n + 1));
        *to = finish((sum / f64::from(count)) as f32);
    });
    out.into_shared()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::StoredValues;
    use glam::DAffine3;

    #[test]
    fn every_type_normalises_alike() {
        let values = [3u8, 7, 11, 19, 23, 31, 43, 47];
        let rescale = Rescale {
            slope: 0.5,
            intercept: -2.0,
        };
        let volumes: Vec<StoredValues> = vec![
            values.to_vec().into(),
            values.map(|v| v as i8).to_vec().into(),
            values.map(u16::from).to_vec().into(),
            values.map(i16::from).to_vec().into(),
            values.map(u32::from).to_vec().into(),
            values.map(i32::from).to_vec().into(),
            values.map(u64::from).to_vec().into(),
            values.map(i64::from).to_vec().into(),
            values.map(f32::from).to_vec().into(),
            values.map(f64::from).to_vec().into(),
        ];
        for values_of_type in volumes {
            let name = values_of_type.type_name();
            let grid = VoxelGrid::new(&Volume::new(
                Voxels::new([2; 3], values_of_type),
                rescale,
                DAffine3::IDENTITY,
            ));
            for (n, v) in values.iter().enumerate() {
                let got = grid.value(n % 2, n / 2 % 2, n / 4);
                let want = (f32::from(*v) - 3.0) / 44.0;
                assert!((got - want).abs() < 1e-6, "{name}: {got} for {want}");
            }
        }
    }

    #[test]
    fn blocks_are_averaged() {
        let voxels: Vec<f32> = vec![1.0, 3.0, 5.0, f32::NAN, 7.0, f32::NAN];
        let grid = VoxelGrid::new(&Volume::new(
            Voxels::new([3, 2, 1], voxels),
            Rescale::NONE,
            DAffine3::IDENTITY,
        ))
        .reduced([2, 2, 1]);
        assert_eq!(grid.size, [2, 1, 1]);
        // The means of 1, 3, 7 and of 5 alone, normalised over 1 to 7.
        assert!(
            (grid.value(0, 0, 0) - (11.0 / 3.0 - 1.0) / 6.0).abs() < 1e-6
                && (grid.value(1, 0, 0) - 4.0 / 6.0).abs() < 1e-6
        );
    }
}
