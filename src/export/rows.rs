//! Rows of a baked volume of small integers by trilinear interpolation, eight voxels at once.
//!
//! A source position is a whole voxel plus a fraction: the deformed point is in fixed point, the
//! displacement of the walk in single precision. Undisplaced points keep their value to the bit.

use crate::deform::StackAndCuts;
use crate::math::cells::{Strides, flat, mix_rows};
use crate::math::lanes::*;
use crate::volume::Voxel;
use glam::{DAffine3, DVec3, Mat3};

/// One row to bake.
#[derive(Clone, Copy)]
pub(super) struct BakeRows<'a> {
    /// Extent of the source; at least two voxels along every axis.
    pub size: [usize; 3],
    pub deformation: StackAndCuts<'a>,
    /// World to voxels of the source.
    pub voxel_from_world: &'a DAffine3,
    /// World position of the first voxel, and from each to the next, mm.
    pub first: DVec3,
    pub step: DVec3,
    /// Number of voxels in the row.
    pub count: usize,
    /// Whether values are rounded.
    pub whole: bool,
}

/// A row with the stored voxels.
pub(super) struct BakeRow<'a, T> {
    /// Stored voxels of the source.
    pub voxels: &'a [T],
    pub rows: BakeRows<'a>,
}

/// Positions of eight voxels along an axis of the source, in 2^-32 voxels: fixed point, so that
/// repeated addition accumulates no error.
struct FixedPointPositions {
    at: [i64; LANES],
    eight: i64,
}

impl FixedPointPositions {
    #[inline(always)]
    fn new(start: f64, step: f64) -> Self {
        let fixed = |v: f64| (v * 4_294_967_296.0).round() as i64;
        let mut at = [0; LANES];
        for (n, at) in at.iter_mut().enumerate() {
            *at = fixed(start + step * n as f64);
        }
        Self {
            at,
            eight: fixed(step * LANES as f64),
        }
    }

    /// For an axis of `n` voxels: the lower voxel and the fraction of each position after
    /// displacement by `moved`, and whether it lies inside the axis (the outermost voxels extend
    /// half a voxel outwards). Advances to the next eight.
    #[inline(always)]
    fn next<S: Simd>(&mut self, simd: S, moved: f32x8<S>, n: usize) -> (i32x8<S>, f32x8<S>, mask32x8<S>) {
        let (mut whole, mut share) = ([0; LANES], [0; LANES]);
        for n in 0..LANES {
            (whole[n], share[n]) = ((self.at[n] >> 32) as i32, (self.at[n] as u32 >> 8) as i32);
            self.at[n] = self.at[n].wrapping_add(self.eight);
        }
        let share = i32x8::load_array(simd, share).to_float::<f32x8<S>>() * (1.0 / 16_777_216.0) + moved;
        let more = share.floor();
        let (whole, share) = (
            i32x8::load_array(simd, whole) + more.to_int::<i32x8<S>>(),
            share - more,
        );
        let last = n as i32 - 1;
        let inside = (whole.simd_ge(0) | (whole.simd_eq(-1) & share.simd_ge(0.5)))
            & (whole.simd_lt(last) | (whole.simd_eq(last) & share.simd_le(0.5)));
        let below = whole.simd_lt(0).select(f32x8::splat(simd, 0.0), share);
        let share = whole.simd_ge(last).select(f32x8::splat(simd, 1.0), below);
        (whole.max(0).min(last - 1), share, inside)
    }
}

impl<T: Voxel> SimdKernel for BakeRow<'_, T> {
    /// Interpolated stored values; NaN outside the volume and in cuts.
    type Output = Vec<f32>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Vec<f32> {
        let Self { voxels, rows } = self;
        let ([nx, ny, nz], strides) = (rows.size, Strides::of(rows.size));
        let everyone = mask32x8::splat(simd, true);
        let linear = rows.voxel_from_world.matrix3;
        let voxels_per_mm: Mat3 = linear.as_mat3();
        let (start, along) = (
            rows.voxel_from_world.transform_point3(rows.first),
            linear * rows.step,
        );
        let nothing = f32x8::splat(simd, f32::NAN);
        let (mut along_x, mut along_y, mut along_z) = (
            FixedPointPositions::new(start.x, along.x),
            FixedPointPositions::new(start.y, along.y),
            FixedPointPositions::new(start.z, along.z),
        );
        let (origin, step) = (
            Vec3x8::splat(simd, rows.first.as_vec3()),
            Vec3x8::splat(simd, rows.step.as_vec3()),
        );
        let line = rows
            .deformation
            .stack
            .line(rows.first.as_vec3(), rows.step.as_vec3());
        let mut number = [0.0; LANES];
        for (n, number) in number.iter_mut().enumerate() {
            *number = n as f32;
        }
        let mut number = f32x8::load_array(simd, number);
        let mut values = Vec::with_capacity(rows.count + LANES);
        for _ in 0..rows.count.div_ceil(LANES) {
            let deformed = origin + step * number;
            number += 8.0;
            let walk =
                rows.deformation
                    .stack
                    .source_and_alpha_on_line(simd, deformed, everyone, line.as_ref());
            let moved = (walk.source - deformed).mapped(&voxels_per_mm);
            let (i, x, inside_x) = along_x.next(simd, moved.x, nx);
            let (j, y, inside_y) = along_y.next(simd, moved.y, ny);
            let (k, z, inside_z) = along_z.next(simd, moved.z, nz);
            let mut seen = walk.alpha.simd_ge(0.5) & inside_x & inside_y & inside_z;
            if !rows.deformation.cuts.is_empty() {
                for n in lanes_of(seen.to_bitmask()) {
                    seen.set(
                        n,
                        rows.deformation.cuts.signed_distance_mm(deformed.lane(n)) >= 0.0,
                    );
                }
            }
            let near = flat(i, j, k, rows.size);
            let value = mix_rows(T::cells(simd, voxels, &near, strides), Vec3x8 { x, y, z });
            let value = if rows.whole {
                (value + f32x8::splat(simd, 0.5).copysign(value)).trunc()
            } else {
                value
            };
            values.extend_from_slice(seen.select(value, nothing).as_slice());
        }
        values.truncate(rows.count);
        values
    }
}
