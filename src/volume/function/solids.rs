//! Signed distances of simple solids, positive inside, mm, and the smooth step from a distance to a
//! coverage.

use super::expression::{Point, Value};

/// Coverage at signed distance `d` (positive inside): a smooth ramp two voxels wide, similar to the
/// edge response of a scanner, and wide enough for gradients to point straight outwards.
pub fn cover(d: Value<'_>, voxel: f32) -> Value<'_> {
    ((d + voxel) / (2.0 * voxel)).smooth_step()
}

/// A ball.
pub fn sphere<'g>(p: Point<'g>, center: [f32; 3], radius: f32) -> Value<'g> {
    radius - p.minus(center).length()
}

/// First-order distance of an ellipsoid: exact on the surface.
pub fn ellipsoid<'g>(p: Point<'g>, center: [f32; 3], radii: [f32; 3]) -> Value<'g> {
    let reciprocals = radii.map(|r| 1.0 / r);
    let q = p.minus(center).times(reciprocals);
    let k0 = q.length();
    let k1 = q.times(reciprocals).length();
    // At the centre the quotient below has no limit: the distance to the closest point.
    let smallest = radii.into_iter().fold(f32::INFINITY, f32::min);
    k1.less(1e-9).select(smallest, k0 * (1.0 - k0) / k1)
}

/// A ball swept along a segment.
pub fn capsule<'g>(p: Point<'g>, a: [f32; 3], b: [f32; 3], radius: f32) -> Value<'g> {
    let axis: [f32; 3] = std::array::from_fn(|n| b[n] - a[n]);
    let squared: f32 = axis.iter().map(|v| v * v).sum();
    let from_a = p.minus(a);
    let t = (from_a.dot(axis) / squared).max(0.0).min(1.0);
    let closest = Point::new(
        from_a.x - t * axis[0],
        from_a.y - t * axis[1],
        from_a.z - t * axis[2],
    );
    radius - closest.length()
}

/// A coin or a button: a flat cylinder with its axis along the unit vector `axis`.
pub fn disc<'g>(p: Point<'g>, center: [f32; 3], axis: [f32; 3], radius: f32, half_height: f32) -> Value<'g> {
    let q = p.minus(center);
    let along = q.dot(axis);
    let across = Point::new(
        q.x - along * axis[0],
        q.y - along * axis[1],
        q.z - along * axis[2],
    );
    let (a, b) = (across.length() - radius, along.abs() - half_height);
    -(a.max(b).min(0.0) + (a.max(0.0).squared() + b.max(0.0).squared()).sqrt())
}

/// A box.
pub fn cuboid<'g>(p: Point<'g>, center: [f32; 3], half: [f32; 3]) -> Value<'g> {
    let q = p.minus(center);
    let d = Point::new(q.x.abs() - half[0], q.y.abs() - half[1], q.z.abs() - half[2]);
    let outside = Point::new(d.x.max(0.0), d.y.max(0.0), d.z.max(0.0));
    -(d.x.max(d.y).max(d.z).min(0.0) + outside.length())
}
