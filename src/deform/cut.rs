//! Cuts as analytic shapes instead of masks: planes, boxes, ellipsoids, cylinders, wedges and
//! cones, in groups.
//!
//! A removal that no later deformation moves is evaluated as a formula at every sample instead of
//! being sampled into a map. Masks, which earlier deformations need, are only as sharp as their
//! texels.
//!
//! Every shape has a signed distance of Lipschitz constant 1 (positive where the volume is
//! retained), exact for all but the ellipsoid. Combinations by minimum and maximum preserve this
//! bound, by which cells and steps that no surface crosses are recognised.

use crate::math::Bounds;
use glam::{Affine3A, Vec2, Vec3, Vec3Swizzles};

/// The most shapes evaluated as formulas; the remaining ones become masks.
pub const MAX_CUTS: usize = 8;

/// The removed region, in the shape's local millimetres about its centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum CutShapeKind {
    /// Above z = `half.z`.
    HalfSpace = 0,
    /// Within `half`.
    Box = 1,
    /// Within the ellipsoid of the semi-axes `half`.
    Ellipsoid = 2,
    /// Within `half.x` of the z axis and `half.z` of its middle.
    Cylinder = 3,
    /// Within an angle about +x, `half.x` of the z axis and `half.z` of its middle.
    Wedge = 4,
    /// Within an angle about +z.
    Cone = 5,
}

/// A shape with its placement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutShape {
    /// The kind of shape.
    pub shape: CutShapeKind,
    /// World to the shape's local millimetres: a rigid motion.
    pub local_from_world: Affine3A,
    /// Its lengths, mm.
    pub half: Vec3,
    /// Half the opening angle, radians.
    pub half_angle: f32,
    /// Removes the outside instead.
    pub inverted: bool,
    /// Belongs to the group of the previous shape.
    pub joins_previous: bool,
    /// Within its group, only the intersection of the shapes is removed, instead of the union.
    pub intersects: bool,
}

impl CutShape {
    /// Signed distance to the removed region, mm, positive where the volume is retained.
    #[inline(always)]
    pub fn signed_distance_mm(&self, world: Vec3) -> f32 {
        let q = self.local_from_world.transform_point3(world);
        let outside = match self.shape {
            CutShapeKind::HalfSpace => self.half.z - q.z,
            CutShapeKind::Box => {
                let d = q.abs() - self.half;
                d.max(Vec3::ZERO).length() + d.max_element().min(0.0)
            }
            // A lower bound of the distance, exact for a sphere.
            CutShapeKind::Ellipsoid => ((q / self.half).length() - 1.0) * self.half.min_element(),
            CutShapeKind::Cylinder => {
                let d = Vec2::new(q.xy().length() - self.half.x, q.z.abs() - self.half.z);
                d.max(Vec2::ZERO).length() + d.max_element().min(0.0)
            }
            CutShapeKind::Wedge => {
                let r = q.xy().length();
                let beyond = q.y.abs().atan2(q.x) - self.half_angle;
                // Distance to the nearer side plane; at more than a right angle from it, to the
                // edge.
                let side = if beyond.abs() < std::f32::consts::FRAC_PI_2 {
                    r * beyond.sin()
                } else {
                    r * beyond.signum()
                };
                side.max(r - self.half.x).max(q.z.abs() - self.half.z)
            }
            CutShapeKind::Cone => {
                let v = Vec2::new(q.z, q.xy().length());
                let axis = Vec2::from_angle(self.half_angle);
                if v.dot(axis) > 0.0 {
                    axis.perp_dot(v)
                } else {
                    v.length()
                }
            }
        };
        if self.inverted { -outside } else { outside }
    }
}

/// Shapes in groups; the union of the groups is removed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CutShapes {
    primitives: Vec<CutShape>,
}

impl CutShapes {
    /// Combines shapes; those of a group are consecutive.
    pub fn new(mut primitives: Vec<CutShape>) -> Self {
        assert!(primitives.len() <= MAX_CUTS, "more shapes than a pass evaluates");
        if let Some(first) = primitives.first_mut() {
            first.joins_previous = false;
        }
        Self { primitives }
    }

    /// The shapes.
    pub fn primitives(&self) -> &[CutShape] {
        &self.primitives
    }

    /// Whether nothing is cut.
    pub fn is_empty(&self) -> bool {
        self.primitives.is_empty()
    }

    /// Signed distance to the removed region, mm, positive where the volume is retained; infinite
    /// if nothing is cut.
    #[inline(always)]
    pub fn signed_distance_mm(&self, world: Vec3) -> f32 {
        let (mut all, mut group) = (f32::INFINITY, f32::INFINITY);
        for p in &self.primitives {
            let d = p.signed_distance_mm(world);
            if !p.joins_previous {
                all = all.min(group);
                group = d;
            } else if p.intersects {
                group = group.max(d);
            } else {
                group = group.min(d);
            }
        }
        all.min(group)
    }

    /// Gradient of [`Self::signed_distance_mm`] by central differences over `h` mm.
    pub fn gradient(&self, world: Vec3, h: f32) -> Vec3 {
        let d = |e: Vec3| self.signed_distance_mm(world + e * h) - self.signed_distance_mm(world - e * h);
        Vec3::new(d(Vec3::X), d(Vec3::Y), d(Vec3::Z)) / (2.0 * h)
    }

    /// Smallest and largest value that [`Self::signed_distance_mm`] can have in a box.
    pub fn bounds(&self, b: &Bounds) -> [f32; 2] {
        if self.is_empty() {
            return [f32::INFINITY; 2];
        }
        let (middle, radius) = (self.signed_distance_mm(b.center()), b.size().length() / 2.0);
        [middle - radius, middle + radius]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn shape(shape: CutShapeKind) -> CutShape {
        let turn = Affine3A::from_rotation_x(0.4)
            * Affine3A::from_rotation_z(-0.7)
            * Affine3A::from_translation(Vec3::new(3.0, -2.0, 5.0));
        CutShape {
            shape,
            local_from_world: turn,
            half: Vec3::new(20.0, 14.0, 17.0),
            half_angle: 0.6,
            inverted: false,
            joins_previous: false,
            intersects: false,
        }
    }

    const SHAPES: [CutShapeKind; 6] = [
        CutShapeKind::HalfSpace,
        CutShapeKind::Box,
        CutShapeKind::Ellipsoid,
        CutShapeKind::Cylinder,
        CutShapeKind::Wedge,
        CutShapeKind::Cone,
    ];

    proptest! {
        /// The distance never changes faster than the point moves.
        #[test]
        fn distances_have_the_bound(n in 0usize..6, p in prop::array::uniform3(-50.0f32..50.0), d in prop::array::uniform3(-3.0f32..3.0)) {
            let s = shape(SHAPES[n]);
            let (p, d) = (Vec3::from(p), Vec3::from(d));
            prop_assert!((s.signed_distance_mm(p + d) - s.signed_distance_mm(p)).abs() <= d.length() * 1.001 + 1e-4);
        }
    }

    #[test]
    fn groups_combine() {
        let plane = |normal: Vec3| CutShape {
            local_from_world: Affine3A::from_quat(glam::Quat::from_rotation_arc(normal, Vec3::Z)),
            half: Vec3::ZERO,
            ..shape(CutShapeKind::HalfSpace)
        };
        let (top, side) = (plane(Vec3::Z), plane(Vec3::X));
        let or = CutShapes::new(vec![top, side]);
        let intersects = CutShapes::new(vec![
            top,
            CutShape {
                joins_previous: true,
                intersects: true,
                ..side
            },
        ]);
        // The top as well as the side, against the edge between them alone.
        for (x, z, in_or, in_and) in [
            (-1.0, -1.0, true, true),
            (1.0, -1.0, false, true),
            (-1.0, 1.0, false, true),
            (1.0, 1.0, false, false),
        ] {
            let p = Vec3::new(x, 0.0, z);
            assert_eq!(
                (
                    or.signed_distance_mm(p) > 0.0,
                    intersects.signed_distance_mm(p) > 0.0
                ),
                (in_or, in_and),
                "{p}"
            );
        }
        let inverted = CutShapes::new(vec![CutShape {
            inverted: true,
            ..top
        }]);
        assert!(inverted.signed_distance_mm(Vec3::Z) > 0.0 && inverted.signed_distance_mm(-Vec3::Z) < 0.0);
    }
}
