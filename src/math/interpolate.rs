//! Trilinear interpolation on a grid of points, clamped to its faces.

use std::ops::{Add, Mul, Sub};

/// The value at grid coordinates `p` (points at integers, first axis fastest), clamped to the grid.
#[inline(always)]
pub fn trilinear<T: Copy + Add<Output = T> + Sub<Output = T> + Mul<f32, Output = T>>(
    values: &[T],
    size: [usize; 3],
    p: glam::Vec3,
) -> T {
    let [nx, ny, nz] = size;
    let top = glam::Vec3::new((nx - 1) as f32, (ny - 1) as f32, (nz - 1) as f32);
    let p = p.clamp(glam::Vec3::ZERO, top);
    // p is not negative: truncation equals floor.
    let (i, j, k) = (p.x as usize, p.y as usize, p.z as usize);
    let f = p - glam::Vec3::new(i as f32, j as f32, k as f32);
    let di = usize::from(i + 1 < nx);
    let dj = if j + 1 < ny { nx } else { 0 };
    let dk = if k + 1 < nz { nx * ny } else { 0 };
    let base = (k * ny + j) * nx + i;
    let mix = |a: T, b: T, t: f32| a + (b - a) * t;
    // In the order of `cells::mix_texels`, so that eight points at once give the same bits.
    let face = |at: usize| {
        mix(
            mix(values[at], values[at + dj], f.y),
            mix(values[at + dk], values[at + dk + dj], f.y),
            f.z,
        )
    };
    mix(face(base), face(base + di), f.x)
}
