//! Gradients of the scalar field, in voxel space. [`crate::cpu`] and the shaders transform them to
//! world millimetres with the inverse transpose of the voxel axes, which is correct on anisotropic
//! and oblique grids.
//!
//! Both filters are sums of trilinear samples, hence the CPU and the shaders state them alike. A
//! central difference of trilinear samples one voxel apart equals the trilinear interpolation of
//! the central differences at the voxels: these may be stored ([`GradientVolume`]); where they do
//! not fit into memory they are computed when needed.

use super::pages::MappedArray;
use super::{VoxelGrid, VoxelGridValues};
use crate::files::memory::available_bytes;
use crate::math::flat;
use crate::math::lanes::*;
use ndarray::ArcArray3;
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
    /// The same, smoothed by [1 2 1]/4 across the other two axes (Sobel): 24 samples, for noisy
    /// volumes.
    Sobel,
}

/// Maximum size of a [`GradientVolume`] in bytes, and its maximum part of the free memory, as a
/// divisor.
const MAX_BYTES: usize = 1 << 30;
const OF_FREE_MEMORY: usize = 4;

/// The central differences of a volume of integers at all voxels, stored with their values: each
/// sample gathers from 8 voxels instead of 32. Exact: 16 bits represent every difference.
pub struct GradientVolume {
    /// For each voxel, i fastest: its stored value, and f(+1) - f(-1) along i, j, k; at the grid's
    /// faces f(0) replaces the value outside.
    pub texels: MappedArray<[i16; 4]>,
}

impl GradientVolume {
    /// Computes the differences; none for floating-point voxels, for integers that do not fit into
    /// signed 16 bits or whose range needs more than 15, for a function, and where more than 1 GiB or a quarter of
    /// the free memory would be needed.
    pub fn new(grid: &VoxelGrid) -> Option<Self> {
        let bytes = grid
            .size
            .iter()
            .product::<usize>()
            .saturating_mul(size_of::<[i16; 4]>());
        if bytes > available_bytes().map_or(MAX_BYTES, |free| MAX_BYTES.min(free as usize / OF_FREE_MEMORY)) {
            return None;
        }
        if grid.function.is_some() {
            return None;
        }
        match &grid.voxels {
            VoxelGridValues::U8(v) => Self::of(v),
            VoxelGridValues::U16(v) => (span(flat(v))?.1 <= i16::MAX as u16).then(|| Self::of(v))?,
            VoxelGridValues::I16(v) => span(flat(v))
                .is_some_and(|(low, high)| high.checked_sub(low).is_some())
                .then(|| Self::of(v))?,
            VoxelGridValues::F32(_) => None,
        }
    }

    fn of<T: FitsI16>(voxels: &ArcArray3<T>) -> Option<Self> {
        let (nz, ny, nx) = voxels.dim();
        let voxels = flat(voxels);
        let mut texels = MappedArray::zeroed(voxels.len())?;
        texels.par_chunks_mut(nx).enumerate().for_each(|(row, out)| {
            let (j, k) = (row % ny, row / ny);
            let of = |j: usize, k: usize| &voxels[(k * ny + j) * nx..][..nx];
            let (own, below, above) = (of(j, k), of(j.saturating_sub(1), k), of((j + 1).min(ny - 1), k));
            let (front, behind) = (of(j, k.saturating_sub(1)), of(j, (k + 1).min(nz - 1)));
            with_simd(GradientRow {
                own,
                below,
                above,
                front,
                behind,
                out,
            });
        });
        Some(Self { texels })
    }
}

/// Integers that fit into signed 16 bits.
trait FitsI16: Copy + Sync {
    fn short(self) -> i16;
}

impl FitsI16 for u8 {
    #[inline(always)]
    fn short(self) -> i16 {
        i16::from(self)
    }
}

impl FitsI16 for u16 {
    #[inline(always)]
    fn short(self) -> i16 {
        self as i16
    }
}

impl FitsI16 for i16 {
    #[inline(always)]
    fn short(self) -> i16 {
        self
    }
}

/// A row of voxels, the rows around it, and its texels.
struct GradientRow<'a, T> {
    own: &'a [T],
    below: &'a [T],
    above: &'a [T],
    front: &'a [T],
    behind: &'a [T],
    out: &'a mut [[i16; 4]],
}

impl<T: FitsI16> SimdKernel for GradientRow<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self {
            own,
            below,
            above,
            front,
            behind,
            out,
        } = self;
        let last = own.len() - 1;
        let mut i = 0;
        while i <= last {
            // Eight voxels with a neighbour on each side.
            if i > 0 && i + LANES <= last {
                let before_and_after = &own[i - 1..][..LANES + 2];
                let (a, before, after) = (
                    eight(simd, &before_and_after[1..]),
                    eight(simd, before_and_after),
                    eight(simd, &before_and_after[2..]),
                );
                let (b, c) = (
                    after - before,
                    eight(simd, &above[i..]) - eight(simd, &below[i..]),
                );
                let d = eight(simd, &behind[i..]) - eight(simd, &front[i..]);
                let low = [words(simd.zip_low_i16x8(a, b)), words(simd.zip_low_i16x8(c, d))];
                let high = [words(simd.zip_high_i16x8(a, b)), words(simd.zip_high_i16x8(c, d))];
                let [p, q] = [
                    simd.zip_low_i32x4(low[0], low[1]),
                    simd.zip_high_i32x4(low[0], low[1]),
                ];
                let [r, s] = [
                    simd.zip_low_i32x4(high[0], high[1]),
                    simd.zip_high_i32x4(high[0], high[1]),
                ];
                for (to, two) in out[i..i + LANES]
                    .as_flattened_mut()
                    .as_chunks_mut()
                    .0
                    .iter_mut()
                    .zip([p, q, r, s])
                {
                    *to = two.bitcast::<i16x8<S>>().to_array();
                }
                i += LANES;
                continue;
            }
            let across = own[(i + 1).min(last)].short() - own[i.saturating_sub(1)].short();
            out[i] = [
                own[i].short(),
                across,
                above[i].short() - below[i].short(),
                behind[i].short() - front[i].short(),
            ];
            i += 1;
        }
    }
}

#[inline(always)]
fn eight<S: Simd, T: FitsI16>(simd: S, voxels: &[T]) -> i16x8<S> {
    let voxels = &voxels[..LANES];
    let mut shorts = [0; LANES];
    for n in 0..LANES {
        shorts[n] = voxels[n].short();
    }
    i16x8::load_array(simd, shorts)
}

#[inline(always)]
fn words<S: Simd>(shorts: i16x8<S>) -> i32x4<S> {
    shorts.bitcast()
}

/// The smallest and largest of some integers.
fn span<T: Copy + Ord + Send + Sync>(voxels: &[T]) -> Option<(T, T)> {
    voxels
        .par_chunks(1 << 16)
        .map(|part| {
            part.iter()
                .fold((part[0], part[0]), |(low, high), &x| (low.min(x), high.max(x)))
        })
        .reduce_with(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

#[cfg(test)]
mod tests {
    use super::super::{Rescale, Volume};
    use super::*;
    use crate::volume::{VolumeSampler, Voxel, Voxels};
    use glam::DAffine3;
    use glam::Vec3;
    use ndarray::Array3;

    #[test]
    fn both_filters_are_exact_on_a_linear_field() {
        let voxels: Vec<f32> = (0..125)
            .map(|n| (n % 5) as f32 * 2.0 + (n / 5 % 5) as f32 - 3.0 * (n / 25) as f32)
            .collect();
        let volume = Volume::new(Voxels::new([5; 3], voxels), Rescale::NONE, DAffine3::IDENTITY);
        let grid = VoxelGrid::new(&volume);
        let s = VolumeSampler::new(&grid);
        let want = Vec3::new(2.0, 1.0, -3.0) / 24.0;
        for filter in [GradientFilter::Central, GradientFilter::Sobel] {
            let got = s.gradient(Vec3::new(2.2, 1.9, 2.0), filter);
            assert!(got.abs_diff_eq(want, 1e-6), "{filter:?} {got}");
        }
    }

    /// At every voxel, including the faces and axes of one voxel, the gradient volume equals the
    /// sampler's gradient. Between voxels and outside the faces, eight samples at once equal single
    /// ones, and those with a gradient volume equal those without, bit for bit.
    #[test]
    fn gradients_are_the_samplers() {
        struct GradientKernel<'a>(&'a VolumeSampler<'a>, [Vec3; LANES]);
        impl SimdKernel for GradientKernel<'_> {
            type Output = ([f32; LANES], [Vec3; LANES]);
            #[inline(always)]
            fn run<S: Simd>(self, simd: S) -> Self::Output {
                let p = Vec3x8::from_lanes(simd, &self.1);
                let (value, differences) = self.0.sample_with_differences(simd, p);
                let g = if self.0.has_gradients() {
                    self.0.gradient_of(simd, p, differences, 255)
                } else {
                    self.0.gradient_lanes(simd, p, GradientFilter::Central, 255)
                };
                (value.to_array(), std::array::from_fn(|n| g.lane(n)))
            }
        }
        fn check<T: Voxel>(grid: &VoxelGrid, voxels: &ArcArray3<T>, note: &str) {
            let s = VolumeSampler::new(grid);
            let gradients = GradientVolume::new(grid);
            assert_eq!(gradients.is_none(), note == "none", "{note}");
            let with = VolumeSampler::new(grid).with_gradients(gradients.as_ref());
            let size = grid.size;
            for (n, voxel) in voxels.iter().enumerate() {
                let at = Vec3::new(
                    (n % size[0]) as f32,
                    (n / size[0] % size[1]) as f32,
                    (n / (size[0] * size[1])) as f32,
                );
                if let Some(gradients) = &gradients {
                    let [value, d @ ..] = gradients.texels[n].map(f32::from);
                    assert_eq!(value, voxel.to_f32(), "{note} {size:?} {n}");
                    let (got, want) = (
                        Vec3::from(d) * 0.5 * grid.scale,
                        s.gradient(at, GradientFilter::Central),
                    );
                    assert!(
                        got.abs_diff_eq(want, 1e-6),
                        "{note} {size:?} {n}: {got} for {want}"
                    );
                }
                let points =
                    std::array::from_fn(|lane| at + Vec3::new(0.31, -0.47, 0.83) * (lane as f32 - 3.0) * 0.7);
                let (values, gradients) = with_simd(GradientKernel(&s, points));
                assert_eq!(
                    with_simd(GradientKernel(&with, points)),
                    (values, gradients),
                    "{note} {size:?} {n}"
                );
                for (lane, p) in points.into_iter().enumerate() {
                    let (want, got) = (s.gradient(p, GradientFilter::Central), gradients[lane]);
                    assert!(
                        (values[lane] - s.sample(p)).abs() < 2e-6 && got.abs_diff_eq(want, 4e-6),
                        "{note} {size:?} {p}: {got} for {want}"
                    );
                }
            }
        }
        fn shaped<T: Clone>([i, j, k]: [usize; 3], values: Vec<T>) -> ArcArray3<T> {
            Array3::from_shape_vec((k, j, i), values).unwrap().into_shared()
        }
        for size in [
            [5, 4, 6],
            [1, 4, 3],
            [2, 2, 2],
            [7, 1, 1],
            [4, 9, 4],
            [10, 2, 3],
            [27, 3, 2],
        ] {
            let hashes: Vec<usize> = (0..size.iter().product::<usize>())
                .map(|n| n * n * 7919 % 32_749)
                .collect();
            let grid = |voxels: crate::volume::Voxels| {
                VoxelGrid::new(&Volume::new(voxels, Rescale::NONE, DAffine3::IDENTITY))
            };
            let u8s = shaped(size, hashes.iter().map(|h| *h as u8).collect::<Vec<u8>>());
            check(&grid(u8s.clone().into()), &u8s, "u8");
            let u16s = shaped(size, hashes.iter().map(|h| *h as u16).collect::<Vec<u16>>());
            check(&grid(u16s.clone().into()), &u16s, "u16");
            let i16s = shaped(
                size,
                hashes
                    .iter()
                    .map(|h| (*h as i32 - 20_000) as i16)
                    .collect::<Vec<i16>>(),
            );
            check(&grid(i16s.clone().into()), &i16s, "i16");
            let f32s = shaped(
                size,
                hashes.iter().map(|h| *h as f32 * 0.37).collect::<Vec<f32>>(),
            );
            check(&grid(f32s.clone().into()), &f32s, "none");
            let mut wide: Vec<u16> = hashes.iter().map(|h| 2 * *h as u16).collect();
            (wide[0], wide[1]) = (0, 32_768);
            let wide = shaped(size, wide);
            check(&grid(wide.clone().into()), &wide, "none");
        }
    }
}
