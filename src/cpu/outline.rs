//! Convex polygons on a picture, and which pixel centres they contain.

use crate::math::lanes::*;
use crate::scene::{Projection, ViewFrame};
use glam::{Vec2, Vec3};

/// A convex polygon on the picture, pixels.
pub(super) struct Outline {
    pub(super) low: Vec2,
    pub(super) high: Vec2,
    pub(super) edges: Vec<Edge>,
}

/// One edge of a polygon: the inside is where its function is positive.
#[derive(Clone, Copy)]
pub(super) struct Edge {
    /// The end that comes first in the order of coordinates: two polygons that share an edge
    /// compute the same numbers.
    from: Vec2,
    along: Vec2,
    /// 1 or -1: the side of the inside.
    side: f32,
    /// Whether points on the edge belong to the polygon.
    includes_edge: bool,
}

impl Edge {
    /// The edge of a polygon that runs round its inside anticlockwise (y down).
    fn new(a: Vec2, b: Vec2) -> Self {
        let in_order = (a.x, a.y) < (b.x, b.y);
        let (from, to) = if in_order { (a, b) } else { (b, a) };
        let direction = b - a;
        Self {
            from,
            along: to - from,
            side: if in_order { 1.0 } else { -1.0 },
            // One of two polygons with a common edge; their edges run in opposite directions.
            includes_edge: direction.y < 0.0 || (direction.y == 0.0 && direction.x < 0.0),
        }
    }

    pub(super) fn contains(&self, p: Vec2) -> bool {
        let value = self.side * self.along.perp_dot(p - self.from);
        value > 0.0 || (value == 0.0 && self.includes_edge)
    }

    #[inline(always)]
    pub(super) fn contains_lanes<S: Simd>(&self, x: f32x8<S>, y: f32x8<S>) -> mask32x8<S> {
        let value = ((y - self.from.y) * self.along.x - (x - self.from.x) * self.along.y) * self.side;
        if self.includes_edge {
            value.simd_ge(0.0)
        } else {
            value.simd_gt(0.0)
        }
    }
}

impl Outline {
    pub(super) fn new(view: &ViewFrame, size: Vec2, corners: &[Vec3]) -> Self {
        let mut points: Vec<Vec2> = corners.iter().map(|p| pixel_of(view, size, *p)).collect();
        let area: f32 = (0..points.len())
            .map(|n| points[n].perp_dot(points[(n + 1) % points.len()]))
            .sum();
        if area < 0.0 {
            points.reverse();
        }
        Self {
            low: points.iter().copied().fold(Vec2::INFINITY, Vec2::min),
            high: points.iter().copied().fold(Vec2::NEG_INFINITY, Vec2::max),
            edges: (0..points.len())
                .map(|n| (points[n], points[(n + 1) % points.len()]))
                .filter(|(a, b)| a != b)
                .map(|(a, b)| Edge::new(a, b))
                .collect(),
        }
    }
}

/// Where a point in front of the eye appears, pixels from the upper left corner.
fn pixel_of(view: &ViewFrame, size: Vec2, p: Vec3) -> Vec2 {
    let d = p - view.eye;
    let depth = match view.projection {
        Projection::Perspective => d.dot(view.forward),
        Projection::Orthographic => 1.0,
    };
    let at = Vec2::new(
        d.dot(view.right) / view.right.length_squared(),
        -d.dot(view.up) / view.up.length_squared(),
    ) / depth;
    (at + 1.0) * 0.5 * size
}
