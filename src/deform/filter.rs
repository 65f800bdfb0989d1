//! How a map is interpolated and differentiated at a sample.
//!
//! *Theory*: \[DDM06\] sections 4.3.1 and 4.3.2 take J_D by differences at each sample, or store B =
//! (I + J_D)ᵀ for each texel. Central differences over one texel, interpolated between texels, are
//! the central differences of the interpolated map: inside a map both are one function, and only
//! the rounding of what is stored distinguishes them. At the faces, where a difference has one side,
//! they differ by less than the second difference. Differences need six samples, stored slopes
//! three.

use super::{DisplacementMap, Storage};
use crate::math::cells::Vec4x8;
use crate::math::lanes::*;
use glam::{Mat3, Vec3, Vec4, Vec4Swizzles};
use rayon::prelude::*;
use std::sync::Arc;

/// Steps per texel of the weights of filtering hardware, which have 8 bits.
const WEIGHTS_PER_TEXEL: f32 = 256.0;

/// How a map is interpolated and differentiated.
#[derive(Clone, Default)]
pub struct MapFilter {
    /// Interpolates with weights of 8 bits, as filtering hardware does.
    pub has_short_weights: bool,
    /// J_D and the mask's gradient for each texel; by differences if there are none.
    pub slopes: Option<Arc<DisplacementMap>>,
}

impl PartialEq for MapFilter {
    /// Stored slopes follow from the map: only whether there are any counts.
    fn eq(&self, other: &Self) -> bool {
        self.has_short_weights == other.has_short_weights && self.slopes.is_some() == other.slopes.is_some()
    }
}

/// J_D and the mask's gradient at the texels of a map, as a map with three blocks along z: the
/// derivatives along x, along y and along z, each (∂D, ∂alpha). `wraps`: the last grid plane along x
/// is the first one.
fn stored_slopes(map: &DisplacementMap, wraps: bool) -> DisplacementMap {
    let [nx, ny, nz] = map.size;
    let slopes: Vec<Vec4> = (0..nx * ny * nz * 3)
        .into_par_iter()
        .map(|n| {
            let (axis, at) = (n / (nx * ny * nz), n % (nx * ny * nz));
            let x = DisplacementMap::grid_point(map.size, at);
            let (columns, slope) = if wraps {
                wrapped_derivatives(map, x, |x| map.fetch(x))
            } else {
                map.derivatives(x)
            };
            columns.col(axis).extend(slope[axis])
        })
        .collect();
    // The gradient of the mask exceeds the range of normalised integers.
    let storage = match map.storage {
        Storage::F16 => Storage::F16,
        _ => Storage::F32,
    };
    DisplacementMap::from_values([nx, ny, 3 * nz], storage, slopes, &[])
}

impl DisplacementMap {
    /// Whether slopes for each texel are made.
    pub(super) fn has_slopes(&self) -> bool {
        self.slopes.iter().any(|slopes| slopes.get().is_some())
    }

    /// J_D and the mask's gradient for each texel, made on first use.
    pub(super) fn slopes(&self, wraps: bool) -> Arc<Self> {
        let made = &self.slopes[usize::from(wraps)];
        if let Some(slopes) = made.get() {
            return slopes.clone();
        }
        // Outside the lock, as the texels themselves, which are needed first: parallel work may run
        // another task on this thread that needs the same slopes.
        self.fetch_texels();
        let slopes = Arc::new(stored_slopes(self, wraps));
        made.get_or_init(|| slopes).clone()
    }
}

impl MapFilter {
    /// The point at which a filter with these weights evaluates a map exactly.
    #[inline(always)]
    fn rounded(&self, map: &DisplacementMap, x: Vec3) -> Vec3 {
        if !self.has_short_weights {
            return x;
        }
        let per_unit = Vec3::from(map.size.map(|n| (n.max(2) - 1) as f32)) * WEIGHTS_PER_TEXEL;
        (x * per_unit).round() / per_unit
    }

    #[inline(always)]
    fn rounded_lanes<S: Simd>(&self, simd: S, map: &DisplacementMap, x: Vec3x8<S>) -> Vec3x8<S> {
        if !self.has_short_weights {
            return x;
        }
        let points: [Vec3; LANES] = std::array::from_fn(|n| self.rounded(map, x.lane(n)));
        Vec3x8::from_lanes(simd, &points)
    }

    /// [`DisplacementMap::fetch`] with this filter.
    #[inline(always)]
    pub fn fetch(&self, map: &DisplacementMap, x: Vec3) -> Vec4 {
        map.fetch(self.rounded(map, x))
    }

    /// [`DisplacementMap::fetch_lanes`] with this filter.
    #[inline(always)]
    pub fn fetch_lanes<S: Simd>(
        &self,
        simd: S,
        map: &DisplacementMap,
        x: Vec3x8<S>,
    ) -> (Vec3x8<S>, f32x8<S>) {
        map.fetch_lanes(simd, self.rounded_lanes(simd, map, x))
    }

    /// [`DisplacementMap::derivatives`] with this filter.
    #[inline(always)]
    pub fn derivatives(&self, map: &DisplacementMap, x: Vec3) -> (Mat3, Vec3) {
        let x = self.rounded(map, x);
        match &self.slopes {
            Some(slopes) => interpolated(slopes, x),
            None => map.derivatives(x),
        }
    }

    /// As [`Self::derivatives`], where the last grid plane along x is the first one.
    pub fn wrapped_derivatives(&self, map: &DisplacementMap, x: Vec3) -> (Mat3, Vec3) {
        match &self.slopes {
            Some(slopes) => interpolated(slopes, self.rounded(map, x)),
            None => wrapped_derivatives(map, x, |x| self.fetch(map, x)),
        }
    }

    /// [`DisplacementMap::derivatives_lanes`] with this filter.
    #[inline(always)]
    pub fn derivatives_lanes<S: Simd>(
        &self,
        simd: S,
        map: &DisplacementMap,
        x: Vec3x8<S>,
        lanes: mask32x8<S>,
    ) -> (Vec4x8<S>, [Vec4x8<S>; 3]) {
        let x = self.rounded_lanes(simd, map, x);
        let Some(slopes) = &self.slopes else {
            return map.derivatives_lanes(simd, x, lanes);
        };
        // Per stored unit of D, as differences of what is stored.
        let scale = slopes.scale / map.scale;
        // Beyond the cube, where a map may reach, the outermost texels of the same block.
        let z = x.z.max(0.0).min(1.0);
        let along = |axis: usize| {
            let at = Vec3x8 {
                z: in_block(slopes, axis, z),
                ..x
            };
            let (d, alpha) = slopes.fetch_lanes(simd, at);
            [d.x * scale, d.y * scale, d.z * scale, alpha]
        };
        let (d, alpha) = map.fetch_lanes(simd, x);
        ([d.x, d.y, d.z, alpha], [along(0), along(1), along(2)])
    }
}

/// The z coordinate of a point in one of the three blocks of stored slopes.
#[inline(always)]
fn in_block<T: std::ops::Mul<f32, Output = T> + std::ops::Add<f32, Output = T>>(
    slopes: &DisplacementMap,
    axis: usize,
    z: T,
) -> T {
    let texels = slopes.size[2] / 3;
    let per_texel = 1.0 / (slopes.size[2] - 1) as f32;
    z * ((texels - 1) as f32 * per_texel) + (axis * texels) as f32 * per_texel
}

/// Stored slopes between texels: J_D and the mask's gradient.
fn interpolated(slopes: &DisplacementMap, x: Vec3) -> (Mat3, Vec3) {
    let x = x.clamp(Vec3::ZERO, Vec3::ONE);
    let [a, b, c] = [0, 1, 2].map(|axis| slopes.fetch(Vec3::new(x.x, x.y, in_block(slopes, axis, x.z))));
    (
        Mat3::from_cols(a.xyz(), b.xyz(), c.xyz()) * slopes.scale,
        Vec3::new(a.w, b.w, c.w),
    )
}

/// As [`DisplacementMap::derivatives`] from samples by `fetch`, with differences that wrap along x.
fn wrapped_derivatives(map: &DisplacementMap, u: Vec3, fetch: impl Fn(Vec3) -> Vec4) -> (Mat3, Vec3) {
    let mut columns = [Vec3::ZERO; 3];
    let mut slope = Vec3::ZERO;
    for axis in 0..3 {
        if map.size[axis] == 1 {
            continue;
        }
        let step = 1.0 / (map.size[axis] - 1) as f32;
        let (mut low, mut high) = (u, u);
        let width;
        if axis == 0 {
            (low.x, high.x) = ((u.x - step).rem_euclid(1.0), (u.x + step).rem_euclid(1.0));
            width = 2.0 * step;
        } else {
            low[axis] = (u[axis] - step).clamp(0.0, 1.0 - step);
            high[axis] = (u[axis] + step).clamp(step, 1.0);
            width = high[axis] - low[axis];
        }
        let d: Vec4 = (fetch(high) - fetch(low)) / width;
        columns[axis] = d.xyz() * map.scale;
        slope[axis] = d.w;
    }
    (Mat3::from_cols(columns[0], columns[1], columns[2]), slope)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::TexelSample;

    /// A smooth map with a mask.
    fn map(storage: Storage) -> DisplacementMap {
        DisplacementMap::from_fn([17, 13, 21], storage, |x| TexelSample {
            displacement: Vec3::new(
                (3.0 * x.y).sin() * 0.1,
                x.x * x.z * 0.2,
                (2.0 * x.x + x.z).cos() * 0.1,
            ),
            alpha: (0.5 + 2.0 * (x.x - 0.4) + x.y * x.z).clamp(0.0, 1.0),
        })
    }

    fn points() -> impl Iterator<Item = Vec3> {
        (0..2000).map(|n| {
            Vec3::new(
                (n as f32 * 0.618_034).fract(),
                (n as f32 * 0.754_877_7).fract(),
                (n as f32 * 0.569_840_3).fract(),
            )
        })
    }

    /// Inside a map stored slopes are the differences, up to the rounding of what is stored.
    #[test]
    fn stored_slopes_are_differences() {
        for (storage, bound) in [(Storage::F32, 2e-4), (Storage::F16, 5e-3)] {
            let map = map(storage);
            let filter = MapFilter {
                slopes: Some(Arc::new(stored_slopes(&map, false))),
                ..MapFilter::default()
            };
            let texel = 1.0 / Vec3::from(map.size.map(|n| (n - 1) as f32));
            let mut worst = 0.0f32;
            for x in points().map(|x| texel + x * (1.0 - 2.0 * texel)) {
                let ((j, slope), (want, want_slope)) = (filter.derivatives(&map, x), map.derivatives(x));
                for c in 0..3 {
                    worst = worst.max((j.col(c) - want.col(c)).length());
                }
                worst = worst.max((slope - want_slope).length());
            }
            assert!(worst < bound, "{storage:?}: {worst}");
        }
    }

    /// Beyond the cube, where a map of a file reaches, eight points at once give the slopes of the
    /// outermost texels, as single points do.
    #[test]
    fn slopes_beyond_the_cube_are_those_of_its_faces() {
        struct Check<'a>(&'a DisplacementMap, &'a MapFilter);
        impl SimdKernel for Check<'_> {
            type Output = ();
            fn run<S: Simd>(self, simd: S) {
                let Self(map, filter) = self;
                let all: Vec<Vec3> = points().map(|x| 1.1 * x - 0.05).collect();
                for eight in all.chunks_exact(LANES) {
                    let x = Vec3x8::from_lanes(simd, &std::array::from_fn(|n| eight[n]));
                    let everywhere = mask32x8::splat(simd, true);
                    let (_, slopes) = filter.derivatives_lanes(simd, map, x, everywhere);
                    for (n, x) in eight.iter().enumerate() {
                        let (_, slope) = filter.derivatives(map, *x);
                        for axis in 0..3 {
                            assert!((slopes[axis][3][n] - slope[axis]).abs() < 1e-3, "{x}");
                        }
                    }
                }
            }
        }
        let map = map(Storage::F32);
        let filter = MapFilter {
            slopes: Some(Arc::new(stored_slopes(&map, false))),
            ..MapFilter::default()
        };
        with_simd(Check(&map, &filter));
    }

    /// Eight points at once give the same values.
    #[test]
    fn lanes_are_points() {
        struct Check<'a>(&'a DisplacementMap, &'a MapFilter);
        impl SimdKernel for Check<'_> {
            type Output = ();
            fn run<S: Simd>(self, simd: S) {
                let Self(map, filter) = self;
                let all: Vec<Vec3> = points().collect();
                for eight in all.chunks_exact(LANES) {
                    let x = Vec3x8::from_lanes(simd, &std::array::from_fn(|n| eight[n]));
                    let everywhere = mask32x8::splat(simd, true);
                    let (value, slopes) = filter.derivatives_lanes(simd, map, x, everywhere);
                    for (n, x) in eight.iter().enumerate() {
                        let (j, slope) = filter.derivatives(map, *x);
                        let own = filter.fetch(map, *x);
                        assert!((value[0][n] - own.x).abs() < 1e-5 && (value[3][n] - own.w).abs() < 1e-5);
                        for axis in 0..3 {
                            let column =
                                Vec3::new(slopes[axis][0][n], slopes[axis][1][n], slopes[axis][2][n]);
                            assert!((column * map.scale - j.col(axis)).length() < 1e-3, "{x}");
                            assert!((slopes[axis][3][n] - slope[axis]).abs() < 1e-3, "{x}");
                        }
                    }
                }
            }
        }
        let map = map(Storage::F32);
        for has_short_weights in [false, true] {
            for slopes in [None, Some(Arc::new(stored_slopes(&map, false)))] {
                let filter = MapFilter {
                    has_short_weights,
                    slopes,
                };
                with_simd(Check(&map, &filter));
            }
        }
    }

    /// Weights of 8 bits move a sample by at most half of 1/256 of a texel.
    #[test]
    fn short_weights_are_close() {
        let map = map(Storage::F32);
        let filter = MapFilter {
            has_short_weights: true,
            slopes: None,
        };
        let (mut worst, mut differ) = (0.0f32, 0);
        for x in points() {
            let off = (filter.fetch(&map, x) - map.fetch(x)).length() * map.scale;
            worst = worst.max(off);
            differ += usize::from(off > 0.0);
        }
        // |dD| below 0.4 per unit and |dalpha| below 3: 1/512 texel along three axes.
        assert!(
            worst < 3.0 * 3.0 / 512.0 / 12.0 && differ > 1500,
            "{worst} {differ}"
        );
    }
}
