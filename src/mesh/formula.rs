//! Solids given by formulas, and their union, intersection and difference: signed distances,
//! positive inside, mm.
//!
//! Spheres, boxes, tori and cylinders have exact distances (Quilez, "Distance functions"). A gyroid
//! and combinations are lower bounds that never exceed the true distance, which is sufficient for
//! sphere tracing.
//!
//! `shaders/lib/formula.wgsl` computes the same.

use crate::math::Bounds;
use glam::{Affine3A, Vec2, Vec3};

/// Maximum number of solids of one object.
pub const MAX_SOLIDS: usize = 16;

/// A solid about its own centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Solid {
    /// A ball: radius.
    Sphere(f32),
    /// A box: half its edges.
    Box(Vec3),
    /// A ring about z: its radius and the tube's.
    Torus(f32, f32),
    /// A cylinder along z: radius and half its length.
    Cylinder(f32, f32),
    /// Walls about a gyroid, inside a box: period, thickness of the wall, half the box's edges.
    Gyroid(f32, f32, Vec3),
}

/// How a solid combines with the previous ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CsgOperation {
    /// Inside any of them.
    #[default]
    Union,
    /// Inside all of them.
    Intersect,
    /// Inside the previous ones and outside this one.
    Subtract,
}

/// A solid with its placement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedSolid {
    /// The solid.
    pub solid: Solid,
    /// How it combines with the previous ones.
    pub join: CsgOperation,
    /// World to the solid's local millimetres; rigid.
    pub local_from_world: Affine3A,
}

/// The largest slope of sin x cos y + sin y cos z + sin z cos x is below this.
const GYROID_SLOPE: f32 = 1.75;

fn to_box(p: Vec3, half: Vec3) -> f32 {
    let d = p.abs() - half;
    d.max(Vec3::ZERO).length() + d.max_element().min(0.0)
}

impl Solid {
    /// Signed distance at a point in local space, mm, positive inside.
    pub fn distance(&self, p: Vec3) -> f32 {
        match *self {
            Self::Sphere(radius) => radius - p.length(),
            Self::Box(half) => -to_box(p, half),
            Self::Torus(ring, tube) => tube - Vec2::new(p.truncate().length() - ring, p.z).length(),
            Self::Cylinder(radius, half) => {
                let d = Vec2::new(p.truncate().length() - radius, p.z.abs() - half);
                -(d.max(Vec2::ZERO).length() + d.max_element().min(0.0))
            }
            Self::Gyroid(period, wall, half) => {
                let k = std::f32::consts::TAU / period;
                let q = p * k;
                let g = q.x.sin() * q.y.cos() + q.y.sin() * q.z.cos() + q.z.sin() * q.x.cos();
                (0.5 * wall - g.abs() / (GYROID_SLOPE * k)).min(-to_box(p, half))
            }
        }
    }

    /// Half its bounding box in local space.
    pub fn half(&self) -> Vec3 {
        match *self {
            Self::Sphere(r) => Vec3::splat(r),
            Self::Box(half) | Self::Gyroid(_, _, half) => half,
            Self::Torus(ring, tube) => Vec3::new(ring + tube, ring + tube, tube),
            Self::Cylinder(radius, half) => Vec3::new(radius, radius, half),
        }
    }

    /// Its smallest feature, mm, which determines the sampling.
    pub fn feature(&self) -> f32 {
        match *self {
            Self::Torus(_, tube) => tube,
            Self::Gyroid(period, wall, _) => (0.25 * period).min(2.0 * wall),
            _ => self.half().min_element(),
        }
    }
}

/// Solids combined in order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Formula(pub Vec<PlacedSolid>);

impl Formula {
    /// Signed distance at a world point, mm, positive inside.
    pub fn distance(&self, world: Vec3) -> f32 {
        let mut all = f32::NEG_INFINITY;
        for s in &self.0 {
            let d = s.solid.distance(s.local_from_world.transform_point3(world));
            all = match s.join {
                CsgOperation::Union => all.max(d),
                CsgOperation::Intersect => all.min(d),
                CsgOperation::Subtract => all.min(-d),
            };
        }
        all
    }

    /// A bounding box: that of the first solid if nothing is left.
    pub fn bounds(&self) -> Bounds {
        let (mut all, mut first) = (Bounds::EMPTY, None);
        for s in &self.0 {
            let half = s.solid.half();
            let b = Bounds::new(-half, half).transformed(&s.local_from_world.inverse());
            first.get_or_insert(b);
            all = match s.join {
                CsgOperation::Union => all.union(&b),
                CsgOperation::Intersect => all.intersection(&b),
                CsgOperation::Subtract => all,
            };
        }
        if all.is_empty() || all.size().min_element() <= 0.0 {
            first.unwrap_or(all)
        } else {
            all
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn solids() -> [Solid; 5] {
        [
            Solid::Sphere(10.0),
            Solid::Box(Vec3::new(8.0, 12.0, 5.0)),
            Solid::Torus(9.0, 3.0),
            Solid::Cylinder(6.0, 9.0),
            Solid::Gyroid(8.0, 1.5, Vec3::splat(12.0)),
        ]
    }

    proptest! {
        /// No formula changes faster than a distance, hence spheres of that radius contain no
        /// surface.
        #[test]
        fn slopes_are_at_most_one(p in prop::array::uniform3(-15.0f32..15.0), q in prop::array::uniform3(-15.0f32..15.0)) {
            let (p, q) = (Vec3::from(p), Vec3::from(q));
            for s in solids() {
                prop_assert!((s.distance(p) - s.distance(q)).abs() <= p.distance(q) * 1.0001 + 1e-4, "{:?}", s);
                if s.distance(p) > 0.0 {
                    prop_assert!(p.abs().cmple(s.half() + 1e-4).all());
                }
            }
        }
    }

    #[test]
    fn solids_join() {
        let place = |solid, join, x: f32| PlacedSolid {
            solid,
            join,
            local_from_world: Affine3A::from_translation(Vec3::X * -x),
        };
        let f = Formula(vec![
            place(Solid::Sphere(10.0), CsgOperation::Union, 0.0),
            place(Solid::Sphere(10.0), CsgOperation::Union, 30.0),
            place(Solid::Box(Vec3::splat(5.0)), CsgOperation::Subtract, 0.0),
        ]);
        assert_eq!(f.distance(Vec3::ZERO), -5.0);
        assert_eq!(f.distance(Vec3::X * 30.0), 10.0);
        assert_eq!(f.distance(Vec3::X * 8.0), 2.0);
        assert_eq!(
            f.bounds(),
            Bounds::new(Vec3::splat(-10.0), Vec3::new(40.0, 10.0, 10.0))
        );
    }
}
