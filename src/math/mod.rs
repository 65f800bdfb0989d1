//! Boxes, interpolation, min/max pyramids, distance transforms, light, and SIMD lanes.

pub mod arrays;
pub mod bounds;
pub mod cells;
pub mod distance;
mod distance_grid;
pub mod interpolate;
pub mod lanes;
pub mod light;
pub mod pyramid;
mod redistance;

pub use arrays::flat;
pub use bounds::Bounds;
pub use distance_grid::DistanceGrid;
pub use interpolate::trilinear;
pub use pyramid::MinMaxPyramid;
pub use redistance::redistance;

use glam::{Affine3A, DAffine3, Vec3};

/// The single-precision copy of a transform, as used by renderers.
pub fn to_f32(transform: &DAffine3) -> Affine3A {
    Affine3A::from_mat3_translation(transform.matrix3.as_mat3(), transform.translation.as_vec3())
}

/// `v / |v|`, or `fallback` where `v` has no direction (zero, NaN or infinite).
#[inline(always)]
pub fn normalize_or(v: Vec3, fallback: Vec3) -> Vec3 {
    let length_squared = v.length_squared();
    if length_squared > 1e-30 && length_squared < f32::INFINITY {
        v * length_squared.sqrt().recip()
    } else {
        fallback
    }
}

/// Hermite interpolation between `edge0` and `edge1`, as in WGSL.
#[inline(always)]
pub fn smoothstep(edge0: f32, edge1: f32, x: f32) -> f32 {
    let t = ((x - edge0) / (edge1 - edge0)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
