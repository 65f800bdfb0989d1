//! Directions spread evenly over a sphere, or over the disc of a light.

use glam::{EulerRot, Quat, Vec3};
use std::f32::consts::PI;

/// The angle between neighbours of a spiral of evenly spread points, radians (Vogel 1979).
const GOLDEN_ANGLE: f32 = 2.399_963_2;

/// Rounds in which axes are moved apart.
const ROUNDS: i32 = 200;

/// Angles about x, y and z by which axes are turned, radians: none of the symmetries of the spiral then
/// lies along an axis of a scan, where most planes and hollows do. Of 1500, those with which 64 axes
/// measure corners, slots and cones along the axes best (within 4.3 %).
const TURN: [f32; 3] = [1.4, 0.1, 1.4];

/// `count` axes whose two directions are spread evenly over the sphere: equal areas along a spiral
/// over one hemisphere, then moved apart as charges are, and turned.
pub(super) fn axes(count: usize) -> Vec<Vec3> {
    let along = |n: usize| {
        let height = (n as f32 + 0.5) / count as f32;
        let radius = (1.0 - height * height).sqrt();
        let angle = n as f32 * GOLDEN_ANGLE;
        Vec3::new(radius * angle.cos(), radius * angle.sin(), height)
    };
    let mut all: Vec<Vec3> = (0..count).map(along).collect();
    for round in 0..ROUNDS {
        let step = 1.5 * 0.99f32.powi(round) / (count as f32).powf(1.5);
        let moved = all.iter().enumerate().map(|(n, &axis)| {
            let others = all.iter().enumerate().filter(|(m, _)| *m != n);
            let force: Vec3 = others
                .flat_map(|(_, &other)| [axis - other, axis + other])
                .map(|away| away / away.length().powi(3))
                .sum();
            (axis + force.reject_from_normalized(axis) * step).normalize()
        });
        all = moved.collect();
    }
    let turn = Quat::from_euler(EulerRot::XYZ, TURN[0], TURN[1], TURN[2]);
    all.into_iter().map(|axis| (turn * axis).normalize()).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_spread_evenly() {
        let all = axes(48);
        let nearest = |n: usize, axis: &Vec3| {
            let others = all.iter().enumerate().filter(|(m, _)| *m != n);
            others
                .map(|(_, other)| axis.dot(*other).abs().min(1.0).acos())
                .fold(f32::INFINITY, f32::min)
        };
        // 96 circles that cover 70 % of the sphere; of the spiral alone they cover 25 %.
        let want = 2.0 * (1.0 - 2.0 * 0.7 / 96.0f32).acos();
        for (n, axis) in all.iter().enumerate() {
            let apart = nearest(n, axis);
            assert!(axis.is_normalized() && apart > want, "{n}: {apart} of {want}");
        }
    }

    #[test]
    fn a_disc_is_as_large_as_its_light() {
        let center = Vec3::new(1.0, 2.0, -0.5).normalize();
        let all = toward_disc(center, 8.0, 64);
        let angle = |d: &Vec3| d.angle_between(center).to_degrees();
        let most = all.iter().map(angle).fold(0.0, f32::max);
        assert!(most < 8.0 && most > 7.8, "{most}");
        let mean: Vec3 = all.iter().sum::<Vec3>() / 64.0;
        assert!(mean.angle_between(center).to_degrees() < 0.3, "{mean}");
        assert_eq!(toward_disc(center, 0.0, 64), [center]);
    }
}
