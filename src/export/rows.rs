//! Rows of a baked volume of small integers by trilinear interpolation, eight voxels at once.
//!
//! A position in the source is a whole voxel and a share of one: the deformed point's own, in double precision, and the walk's displacement, in
//! single precision. What does not move keeps its value to the bit.

use super::bake::Deformation;
use crate::math::cells::mix_rows;
use crate::math::lanes::*;
use crate::volume::Voxel;
use glam::{DAffine3, DVec3, Mat3, Vec3};

/// A row to bake.
pub(super) struct Row<'a, T> {
    /// Stored voxels of the source.
    pub voxels: &'a [T],
    /// Extent of the source; at least two voxels along every axis.
    pub size: [usize; 3],
    pub deformation: Deformation<'a>,
    /// World to voxels of the source.
    pub voxel_from_world: &'a DAffine3,
    /// World position of the row's first voxel, and from each to the next, mm.
    pub first: DVec3,
    pub step: DVec3,
    /// Voxels of the row.
    pub count: usize,
}

/// Whole voxels and shares along an axis of eight positions: `at` voxels and `moved` more.
#[inline(always)]
fn split<S: Simd>(simd: S, at: [f64; LANES], moved: f32x8<S>) -> (i32x8<S>, f32x8<S>) {
    let (mut whole, mut share) = ([0; LANES], [0.0; LANES]);
    for n in 0..LANES {
        let floor = at[n].floor();
        (whole[n], share[n]) = (floor as i32, (at[n] - floor) as f32);
    }
    let share = f32x8::load_array(simd, share) + moved;
    let more = share.floor();
    (i32x8::load_array(simd, whole) + more.to_int::<i32x8<S>>(), share - more)
}

/// Lower voxels and shares of cells along an axis of `n` voxels, and which positions lie inside it: the outermost voxels reach half a voxel out.
#[inline(always)]
fn cell<S: Simd>((whole, share): (i32x8<S>, f32x8<S>), n: usize) -> (i32x8<S>, f32x8<S>, mask32x8<S>) {
    let last = n as i32 - 1;
    let inside = (whole.simd_ge(0) | (whole.simd_eq(-1) & share.simd_ge(0.5))) & (whole.simd_lt(last) | (whole.simd_eq(last) & share.simd_le(0.5)));
    let (zero, one) = (share * 0.0, share * 0.0 + 1.0);
    let share = whole.simd_lt(0).select(zero, whole.simd_ge(last).select(one, share));
    (whole.max(0).min(last - 1), share, inside)
}

impl<T: Voxel> OverSimd for Row<'_, T> {
    /// Stored values, between voxels' too; NaN where nothing is.
    type Output = Vec<f32>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Vec<f32> {
        let [nx, ny, nz] = self.size;
        let everyone = mask32x8::splat(simd, true);
        let linear = self.voxel_from_world.matrix3;
        let voxels_per_mm: Mat3 = linear.as_mat3();
        let (start, along) = (self.voxel_from_world.transform_point3(self.first), linear * self.step);
        let nothing = f32x8::splat(simd, f32::NAN);
        let mut values = Vec::with_capacity(self.count + LANES);
        for first in (0..self.count).step_by(LANES) {
            let mut points = [Vec3::ZERO; LANES];
            let (mut x, mut y, mut z) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
            for n in 0..LANES {
                let i = (first + n) as f64;
                points[n] = (self.first + self.step * i).as_vec3();
                (x[n], y[n], z[n]) = (start.x + along.x * i, start.y + along.y * i, start.z + along.z * i);
            }
            let deformed = Vec3x8::from_lanes(simd, &points);
            let walk = self.deformation.stack.walk_lanes(simd, deformed, everyone);
            let moved = (walk.source - deformed).mapped(&voxels_per_mm);
            let (i, x, inside_x) = cell(split(simd, x, moved.x), nx);
            let (j, y, inside_y) = cell(split(simd, y, moved.y), ny);
            let (k, z, inside_z) = cell(split(simd, z, moved.z), nz);
            let mut seen = walk.alpha.simd_ge(0.5) & inside_x & inside_y & inside_z;
            if !self.deformation.cuts.is_empty() {
                for n in lanes_of(seen.to_bitmask()) {
                    seen.set(n, self.deformation.cuts.kept(points[n]) >= 0.0);
                }
            }
            let mut rows = [[0; LANES]; 4];
            for n in 0..LANES {
                let at = (k[n] as usize * ny + j[n] as usize) * nx + i[n] as usize;
                (rows[0][n], rows[1][n], rows[2][n], rows[3][n]) = (at, at + nx, at + nx * ny, at + nx * ny + nx);
            }
            let rows = [
                T::pairs(simd, self.voxels, &rows[0]),
                T::pairs(simd, self.voxels, &rows[1]),
                T::pairs(simd, self.voxels, &rows[2]),
                T::pairs(simd, self.voxels, &rows[3]),
            ];
            values.extend_from_slice(seen.select(mix_rows(rows, Vec3x8 { x, y, z }), nothing).as_slice());
        }
        values.truncate(self.count);
        values
    }
}
