//! Directions spread evenly over a sphere, or over the disc of a light.

use glam::Vec3;
use std::f32::consts::PI;

/// The angle between neighbours of a spiral of evenly spread points, radians (Vogel 1979).
const GOLDEN_ANGLE: f32 = 2.399_963_2;

/// `count` axes whose two directions are spread evenly over the sphere: equal areas along a spiral
/// over one hemisphere.
pub(super) fn axes(count: usize) -> Vec<Vec3> {
    let along = |n: usize| {
        let height = (n as f32 + 0.5) / count as f32;
        let radius = (1.0 - height * height).sqrt();
        let angle = n as f32 * GOLDEN_ANGLE;
        Vec3::new(radius * angle.cos(), radius * angle.sin(), height)
    };
    (0..count).map(along).collect()
}

/// Directions towards a light that looks like a disc of the given angular radius: `count` of them,
/// or one if it has none.
pub(super) fn toward_disc(center: Vec3, radius_deg: f32, count: usize) -> Vec<Vec3> {
    if radius_deg <= 0.0 {
        return vec![center];
    }
    let (u, v) = center.any_orthonormal_pair();
    let radius = (radius_deg / 180.0 * PI).tan();
    let point = |n: usize| {
        let away = radius * ((n as f32 + 0.5) / count as f32).sqrt();
        let angle = n as f32 * GOLDEN_ANGLE;
        (center + u * (away * angle.cos()) + v * (away * angle.sin())).normalize()
    };
    (0..count).map(point).collect()
}
