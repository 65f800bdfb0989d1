//! Gradients of the scalar field, in voxel space; [`crate::cpu`] and the shaders turn them into world millimetres with the inverse
//! transpose of the voxel axes, which is what makes them right on anisotropic and oblique grids.
//!
//! Both filters are sums of trilinear samples, so the CPU and the shaders state them alike and need no gradient volume. A central
//! difference of trilinear samples one voxel apart equals the trilinear interpolation of the central differences at the voxels.

use super::{Grid, GridVoxels, Sampler, Voxel};
use glam::Vec3;
use rayon::prelude::*;
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

/// Gradients of the normalised values at all voxels, per voxel along i, j, k, i fastest: central differences, one-sided over half the way at
/// the faces, as [`Sampler::gradient`] gives them there.
pub fn gradient_volume(grid: &Grid) -> Vec<[f32; 3]> {
    match &grid.voxels {
        GridVoxels::U8(v) => gradients(grid, v),
        GridVoxels::U16(v) => gradients(grid, v),
        GridVoxels::I16(v) => gradients(grid, v),
        GridVoxels::F32(v) => gradients(grid, v),
    }
}

fn gradients<T: Voxel>(grid: &Grid, voxels: &[T]) -> Vec<[f32; 3]> {
    let [nx, ny, nz] = grid.size;
    let mut all = vec![[0.0; 3]; voxels.len()];
    let half = 0.5 * grid.scale;
    all.par_chunks_mut(nx.max(1)).enumerate().for_each(|(row, out)| {
        let (j, k) = (row % ny, row / ny);
        let of = |j: usize, k: usize| &voxels[(k * ny + j) * nx..][..nx];
        let (own, below, above) = (of(j, k), of(j.saturating_sub(1), k), of((j + 1).min(ny - 1), k));
        let (front, behind) = (of(j, k.saturating_sub(1)), of(j, (k + 1).min(nz - 1)));
        let last = nx - 1;
        let mut at = |i: usize, before: usize, after: usize| {
            out[i] = [own[after].to_f32() - own[before].to_f32(), above[i].to_f32() - below[i].to_f32(), behind[i].to_f32() - front[i].to_f32()]
                .map(|d| d * half);
        };
        at(0, 0, 1.min(last));
        (1..last).for_each(|i| at(i, i - 1, i + 1));
        if last > 0 {
            at(last, last - 1, last);
        }
    });
    all
}

#[cfg(test)]
mod tests {
    use super::super::{Rescale, Volume};
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

    /// At every voxel, the faces and axes of one voxel among them, the volume of gradients is what the sampler gives, eight at once or one.
    #[test]
    fn gradients_at_voxels_are_the_samplers() {
        use crate::math::lanes::*;
        struct Lanes<'a>(&'a Sampler<'a, u16>, [Vec3; LANES]);
        impl OverSimd for Lanes<'_> {
            type Output = ([f32; LANES], [Vec3; LANES]);
            #[inline(always)]
            fn run<S: Simd>(self, simd: S) -> Self::Output {
                let p = Vec3x8::from_lanes(simd, &self.1);
                let g = self.0.gradient_lanes(simd, p, GradientFilter::Central, 255);
                (self.0.sample_lanes(simd, p).to_array(), std::array::from_fn(|n| g.lane(n)))
            }
        }
        for size in [[5, 4, 6], [1, 4, 3], [2, 2, 2], [7, 1, 1], [4, 9, 4]] {
            let voxels: Vec<u16> = (0..size.iter().product::<usize>()).map(|n| (n * n * 7919 % 65_521) as u16).collect();
            let grid = Grid::new(&Volume::new(voxels.into(), size, Rescale::NONE, DAffine3::IDENTITY));
            let GridVoxels::U16(v) = &grid.voxels else { panic!() };
            let s = Sampler::new(&grid, v);
            let at = |n: usize| Vec3::new((n % size[0]) as f32, (n / size[0] % size[1]) as f32, (n / (size[0] * size[1])) as f32);
            for (n, got) in gradient_volume(&grid).iter().enumerate() {
                let want = s.gradient(at(n), GradientFilter::Central);
                assert!(Vec3::from(*got).abs_diff_eq(want, 1e-6), "{size:?} {n}: {got:?} for {want}");
                // Between voxels, and beyond the faces.
                let points = std::array::from_fn(|lane| at(n) + Vec3::new(0.31, -0.47, 0.83) * (lane as f32 - 3.0) * 0.7);
                let (values, gradients) = with_simd(Lanes(&s, points));
                for (lane, p) in points.into_iter().enumerate() {
                    let want = s.gradient(p, GradientFilter::Central);
                    assert!(
                        (values[lane] - s.sample(p)).abs() < 2e-6 && gradients[lane].abs_diff_eq(want, 4e-6),
                        "{size:?} {p}: {} for {want}",
                        gradients[lane]
                    );
                }
            }
        }
    }
}
