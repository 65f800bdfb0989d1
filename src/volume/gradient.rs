//! Gradients of the scalar field, in voxel space; [`crate::cpu`] and the shaders turn them into world millimetres with the inverse
//! transpose of the voxel axes, which is what makes them right on anisotropic and oblique grids.
//!
//! Both filters are sums of trilinear samples, so the CPU and the shaders state them alike and need no gradient volume. A central
//! difference of trilinear samples one voxel apart equals the trilinear interpolation of the central differences at the voxels.

use super::{Sampler, Voxel};
use glam::Vec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How gradients are estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GradientFilter {
    /// (f(x+1) - f(x-1)) / 2 along each axis: 6 samples.
    #[default]
    Central,
    /// The same, smoothed by [1 2 1]/4 across the other two axes (Sobel): 24 samples, for noisy volumes.
    Sobel,
}

impl<T: Voxel> Sampler<'_, T> {
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

    /// At a voxel, the mean of two samples half a voxel to either side is (f(-1) + 2 f(0) + f(1)) / 4.
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
    use super::super::{Grid, GridVoxels, Rescale, Volume};
    use super::*;
    use glam::DAffine3;

    #[test]
    fn both_filters_are_exact_on_a_linear_field() {
        let voxels: Vec<f32> = (0..125).map(|n| (n % 5) as f32 * 2.0 + (n / 5 % 5) as f32 - 3.0 * (n / 25) as f32).collect();
        let volume = Volume::new(voxels.into(), [5, 5, 5], Rescale::NONE, DAffine3::IDENTITY);
        let grid = Grid::new(&volume);
        let GridVoxels::F32(v) = &grid.voxels else { panic!() };
        let s = Sampler::new(&grid, v);
        let want = Vec3::new(2.0, 1.0, -3.0) / 24.0;
        for filter in [GradientFilter::Central, GradientFilter::Sobel] {
            let got = s.gradient(Vec3::new(2.2, 1.9, 2.0), filter);
            assert!(got.abs_diff_eq(want, 1e-6), "{filter:?} {got}");
        }
    }
}
