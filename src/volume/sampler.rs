//! Trilinear samples of a grid, or those of a function, and their gradients, one at a time;
//! [`super::lanes`] computes eight at once.

use super::function::VolumeFunction;
use super::{GradientFilter, GradientVolume, Voxel, VoxelGrid, VoxelGridValues};
use crate::math::flat;
use glam::{Vec3, Vec4};

/// The voxels of a grid, i fastest.
#[derive(Clone, Copy)]
pub(super) enum VoxelSlice<'a> {
    U8(&'a [u8]),
    U16(&'a [u16]),
    I16(&'a [i16]),
    F32(&'a [f32]),
}

/// One expression for the voxels of each type: a branch that every sample of a picture takes alike.
/// Renderers are compiled once for all types.
macro_rules! with_voxels {
    ($voxels:expr, $v:ident => $body:expr) => {
        match $voxels {
            VoxelSlice::U8($v) => $body,
            VoxelSlice::U16($v) => $body,
            VoxelSlice::I16($v) => $body,
            VoxelSlice::F32($v) => $body,
        }
    };
}
pub(super) use with_voxels;

impl<'a> VoxelSlice<'a> {
    fn of(values: &'a VoxelGridValues) -> Self {
        match values {
            VoxelGridValues::U8(v) => Self::U8(flat(v)),
            VoxelGridValues::U16(v) => Self::U16(flat(v)),
            VoxelGridValues::I16(v) => Self::I16(flat(v)),
            VoxelGridValues::F32(v) => Self::F32(flat(v)),
        }
    }

    fn len(&self) -> usize {
        with_voxels!(self, v => v.len())
    }
}

/// Sampling of one grid: trilinear, or by the grid's function.
pub struct VolumeSampler<'a> {
    pub(super) voxels: VoxelSlice<'a>,
    pub(super) size: [usize; 3],
    /// Largest sample coordinate per axis, voxels.
    pub(super) top: Vec3,
    pub(super) scale: f32,
    pub(super) offset: f32,
    /// Texels of a gradient volume.
    pub(super) texels: Option<&'a [[i16; 4]]>,
    /// The function that samples are taken from instead of from the voxels.
    pub(super) function: Option<&'a VolumeFunction>,
}

impl<'a> VolumeSampler<'a> {
    /// A sampler over the voxels of a grid.
    pub fn new(grid: &'a VoxelGrid) -> Self {
        let voxels = VoxelSlice::of(&grid.voxels);
        assert_eq!(voxels.len(), grid.size.iter().product::<usize>());
        let top = Vec3::from(grid.size.map(|n| (n - 1) as f32));
        Self {
            voxels,
            size: grid.size,
            top,
            scale: grid.scale,
            offset: grid.offset,
            texels: None,
            function: grid.function.as_deref(),
        }
    }

    /// The sampler with a gradient volume of the same grid, which supplies differences with eight
    /// samples at once; the results are the same bit for bit.
    pub fn with_gradients(self, gradients: Option<&'a GradientVolume>) -> Self {
        Self {
            texels: gradients
                .map(|g| &*g.texels)
                .filter(|texels| texels.len() == self.voxels.len()),
            ..self
        }
    }

    /// Whether samples come with differences.
    #[inline(always)]
    pub fn has_gradients(&self) -> bool {
        self.texels.is_some() && self.size.iter().all(|&n| n >= 4)
    }

    /// Normalised value at a position in voxels, clamped to the outermost voxel centres like a
    /// texture unless it is that of a function.
    pub fn sample(&self, point_in_voxel: Vec3) -> f32 {
        if let Some(function) = self.function {
            let [value] = function.values(&[point_in_voxel]);
            return value;
        }
        let p = point_in_voxel.clamp(Vec3::ZERO, self.top);
        // p is not negative: truncation equals floor.
        let (i, j, k) = (p.x as usize, p.y as usize, p.z as usize);
        let f = p - Vec3::new(i as f32, j as f32, k as f32);
        let [nx, ny, nz] = self.size;
        let di = usize::from(i + 1 < nx);
        let dj = if j + 1 < ny { nx } else { 0 };
        let dk = if k + 1 < nz { nx * ny } else { 0 };
        let base = (k * ny + j) * nx + i;
        let [low, high] = with_voxels!(self.voxels, v => {
            let at = |offset: usize| v[base + offset].to_f32();
            [
                Vec4::new(at(0), at(dj), at(dk), at(dj + dk)),
                Vec4::new(at(di), at(di + dj), at(di + dk), at(di + dj + dk)),
            ]
        });
        let x = low + (high - low) * f.x;
        let y0 = x.x + (x.y - x.x) * f.y;
        let y1 = x.z + (x.w - x.z) * f.y;
        (y0 + (y1 - y0) * f.z) * self.scale + self.offset
    }
}

impl VolumeSampler<'_> {
    /// Gradient of the normalised value per voxel along i, j, k.
    #[inline(always)]
    pub fn gradient(&self, p: Vec3, filter: GradientFilter) -> Vec3 {
        match filter {
            GradientFilter::Central => {
                Vec3::new(
                    self.sample(p + Vec3::X) - self.sample(p - Vec3::X),
                    self.sample(p + Vec3::Y) - self.sample(p - Vec3::Y),
                    self.sample(p + Vec3::Z) - self.sample(p - Vec3::Z),
                ) * 0.5
            }
            GradientFilter::Sobel => self.sobel(p),
        }
    }

    /// At a voxel, the mean of two samples half a voxel to either side is (f(-1) + 2 f(0) + f(1)) /
    /// 4.
    #[inline(never)]
    fn sobel(&self, p: Vec3) -> Vec3 {
        let mut g = Vec3::ZERO;
        for a in [-0.5, 0.5] {
            for b in [-0.5, 0.5] {
                let x = Vec3::new(0.0, a, b);
                let y = Vec3::new(a, 0.0, b);
                let z = Vec3::new(a, b, 0.0);
                g += Vec3::new(
                    self.sample(p + x + Vec3::X) - self.sample(p + x - Vec3::X),
                    self.sample(p + y + Vec3::Y) - self.sample(p + y - Vec3::Y),
                    self.sample(p + z + Vec3::Z) - self.sample(p + z - Vec3::Z),
                );
            }
        }
        g * 0.125
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{Rescale, Volume, Voxels};
    use glam::DAffine3;

    #[test]
    fn samples_beside_a_hole_are_holes_or_honest() {
        let volume = Volume::new(
            Voxels::new([3, 1, 1], vec![1.0f32, f32::NAN, 3.0]),
            Rescale::NONE,
            DAffine3::IDENTITY,
        );
        let grid = VoxelGrid::new(&volume);
        let s = VolumeSampler::new(&grid);
        assert!(grid.has_holes);
        assert!(s.sample(Vec3::new(1.0, 0.0, 0.0)) < 0.0);
        assert!(s.sample(Vec3::new(0.1, 0.0, 0.0)) < 0.0);
        assert_eq!(s.sample(Vec3::new(2.0, 0.0, 0.0)), 1.0);
    }

    #[test]
    fn linear_functions_are_sampled_exactly() {
        let voxels: Vec<f32> = (0..60)
            .map(|n| (n % 3) as f32 + 10.0 * (n / 3 % 4) as f32 - 4.0 * (n / 12) as f32)
            .collect();
        let volume = Volume::new(Voxels::new([3, 4, 5], voxels), Rescale::NONE, DAffine3::IDENTITY);
        let grid = VoxelGrid::new(&volume);
        let s = VolumeSampler::new(&grid);
        let p = Vec3::new(1.25, 2.5, 3.125);
        let want = (p.x + 10.0 * p.y - 4.0 * p.z + 16.0) / 48.0;
        assert!((s.sample(p) - want).abs() < 1e-6);
    }
}
