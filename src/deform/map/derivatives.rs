//! Derivatives of a map's displacement and mask, from differences between texels.

use super::DisplacementMap;
use crate::math::cells::{Cells, Vec4x8, mix_with_differences};
use crate::math::lanes::*;
use glam::{Mat3, Vec3, Vec4, Vec4Swizzles};

impl DisplacementMap {
    /// At eight points, of which only those in `lanes` are needed, stored (D / scale, alpha) and
    /// its derivatives along the three map axes, as [`Self::derivatives`].
    #[inline(always)]
    pub fn derivatives_lanes<S: Simd>(
        &self,
        simd: S,
        x: Vec3x8<S>,
        lanes: mask32x8<S>,
    ) -> (Vec4x8<S>, [Vec4x8<S>; 3]) {
        let zero = f32x8::splat(simd, 0.0);
        let (mut value, mut slopes) = ([zero; 4], [[zero; 4]; 3]);
        let mut near_face = lanes;
        if self.size[0] >= 4 && self.size[1] >= 4 && self.size[2] >= 4 {
            let top = self.top();
            let p = Vec3x8 {
                x: x.x * top.x,
                y: x.y * top.y,
                z: x.z * top.z,
            };
            near_face = lanes
                & !(within(p.x, 1.0, top.x - 1.0)
                    & within(p.y, 1.0, top.y - 1.0)
                    & within(p.z, 1.0, top.z - 1.0));
            let [inside, dx, dy, dz] =
                mix_with_differences(simd, self.texels(), self.size, &Cells::of(p, self.size, 1));
            // Over two texels.
            (value, slopes) = (
                inside,
                [
                    scaled(dx, 0.5 * top.x),
                    scaled(dy, 0.5 * top.y),
                    scaled(dz, 0.5 * top.z),
                ],
            );
        }
        if near_face.any_true() {
            // A texel is missing on one side.
            value = selected(near_face, self.fetch_fours(simd, x), value);
            for (axis, slope) in slopes.iter_mut().enumerate() {
                *slope = selected(near_face, self.slope_at_faces(simd, x, axis), *slope);
            }
        }
        (value, slopes)
    }

    /// The method of [`Self::derivatives`] near the cube's faces: differences over one texel to
    /// each side, as far as there is one.
    #[inline(always)]
    fn slope_at_faces<S: Simd>(&self, simd: S, x: Vec3x8<S>, axis: usize) -> Vec4x8<S> {
        if self.size[axis] == 1 {
            return [f32x8::splat(simd, 0.0); 4];
        }
        let step = 1.0 / (self.size[axis] - 1) as f32;
        let (mut low, mut high) = (x, x);
        let (from, below, above) = match axis {
            0 => (x.x, &mut low.x, &mut high.x),
            1 => (x.y, &mut low.y, &mut high.y),
            _ => (x.z, &mut low.z, &mut high.z),
        };
        *below = (from - step).max(0.0).min(1.0 - step);
        *above = (from + step).max(step).min(1.0);
        let width = *above - *below;
        let ([a, b, c, d], [e, f, g, h]) = (self.fetch_fours(simd, low), self.fetch_fours(simd, high));
        [(e - a) / width, (f - b) / width, (g - c) / width, (h - d) / width]
    }

    /// J_D (column a = ∂D/∂x_a) and the mask's gradient, both in map space, by differences over one
    /// texel to each side (shortened at the cube's faces; beyond them, evaluated at the face).
    pub fn derivatives(&self, x: Vec3) -> (Mat3, Vec3) {
        if let Some(derivatives) = self.derivatives_inside(x) {
            return derivatives;
        }
        let mut columns = [Vec3::ZERO; 3];
        let mut slope = Vec3::ZERO;
        for axis in 0..3 {
            if self.size[axis] == 1 {
                continue;
            }
            let step = 1.0 / (self.size[axis] - 1) as f32;
            let (mut low, mut high) = (x, x);
            low[axis] = (x[axis] - step).clamp(0.0, 1.0 - step);
            high[axis] = (x[axis] + step).clamp(step, 1.0);
            let d = (self.fetch(high) - self.fetch(low)) / (high[axis] - low[axis]);
            columns[axis] = d.xyz() * self.scale;
            slope[axis] = d.w;
        }
        (Mat3::from_cols(columns[0], columns[1], columns[2]), slope)
    }

    /// As [`Self::derivatives`] where there is a texel on each side: the differences are taken
    /// between texels and interpolated with the point's fraction, from 32 texels instead of the 48
    /// of six samples.
    #[inline(always)]
    fn derivatives_inside(&self, x: Vec3) -> Option<(Mat3, Vec3)> {
        let [nx, ny, nz] = self.size;
        let top = self.top();
        let p = x * top;
        if !(p.cmpge(Vec3::ONE).all() && p.cmple(top - 1.0).all()) {
            return None;
        }
        // At most the cell whose far neighbours are the last texels; an axis of fewer than four
        // texels has no such cell.
        let cell = |p: f32, n: usize| (p as usize).min(n.saturating_sub(3)).max(1);
        let (i, j, k) = (cell(p.x, nx), cell(p.y, ny), cell(p.z, nz));
        if nx < 4 || ny < 4 || nz < 4 {
            return None;
        }
        let f = p - Vec3::new(i as f32, j as f32, k as f32);
        let mix = |a: Vec4, b: Vec4, t: f32| a + (b - a) * t;
        let slope = |row: [Vec4; 4], t: f32| mix(row[2] - row[0], row[3] - row[1], t);
        let texels = self.texels();
        let row = |j: usize, k: usize| -> &[Vec4] { &texels[(k * ny + j) * nx + i - 1..][..4] };
        let along = |row: &[Vec4]| mix(row[1], row[2], f.x);
        let four = |row: &[Vec4]| slope([row[0], row[1], row[2], row[3]], f.x);
        let [a, b, c, d] = [row(j, k), row(j + 1, k), row(j, k + 1), row(j + 1, k + 1)];
        let dx = mix(mix(four(a), four(b), f.y), mix(four(c), four(d), f.y), f.z);
        let [a, b, c, d] = [along(a), along(b), along(c), along(d)];
        let dy = mix(
            slope([along(row(j - 1, k)), a, b, along(row(j + 2, k))], f.y),
            slope([along(row(j - 1, k + 1)), c, d, along(row(j + 2, k + 1))], f.y),
            f.z,
        );
        let dz = mix(
            slope([along(row(j, k - 1)), a, c, along(row(j, k + 2))], f.z),
            slope([along(row(j + 1, k - 1)), b, d, along(row(j + 1, k + 2))], f.z),
            f.y,
        );
        // Over two texels.
        let [dx, dy, dz] = [dx * (0.5 * top.x), dy * (0.5 * top.y), dz * (0.5 * top.z)];
        Some((
            Mat3::from_cols(dx.xyz(), dy.xyz(), dz.xyz()) * self.scale,
            Vec3::new(dx.w, dy.w, dz.w),
        ))
    }
}

#[inline(always)]
fn selected<S: Simd>(mask: mask32x8<S>, [a, b, c, d]: Vec4x8<S>, [e, f, g, h]: Vec4x8<S>) -> Vec4x8<S> {
    [
        mask.select(a, e),
        mask.select(b, f),
        mask.select(c, g),
        mask.select(d, h),
    ]
}

#[inline(always)]
fn scaled<S: Simd>([a, b, c, d]: Vec4x8<S>, by: f32) -> Vec4x8<S> {
    [a * by, b * by, c * by, d * by]
}
