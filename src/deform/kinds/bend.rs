//! Barr's bend: the box's axis becomes an arc about a line along y, and the lower face stays in
//! place (\[GG42\], \[DS07\] section 4).
//!
//! With the curvature k = angle / height, a point (x, z) at height s above the lower face goes to
//! (1/k - (1/k - x) cos ks, (1/k - x) sin ks). Angle and radius about the centre of the arc give x
//! and s back exactly. Above the upper face the bend continues straight. Material beyond the centre
//! of the arc would pass through itself; it is cut away.

use super::{
    Backward, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, Kind, NO_CUT_DISTANCE_MM, Parameter,
};
use glam::{Vec2, Vec3};

pub(super) const KIND: Kind = Kind {
    name: "bend",
    about: "bends the box's z axis towards its +x, the lower face staying in place",
    parameters: &[Parameter::degrees(
        "angle",
        50.0,
        [-170.0, 170.0],
        "rotation of the upper face",
    )],
    size: DefaultSize::Share([1.8, 1.1, 1.1]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 96,
    nonzero_faces: [true, true, true, true, false, true],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        let angle = (c.value("angle") * c.progress).to_radians();
        Box::new(Bend {
            curvature: angle.abs() / c.size_mm.z,
            sense: angle.signum(),
            half_z: c.half().z,
            height: c.size_mm.z,
        })
    }),
};

struct Bend {
    /// 1/mm, not negative.
    curvature: f32,
    sense: f32,
    half_z: f32,
    height: f32,
}

impl Field for Bend {
    fn backward(&self, q: Vec3) -> Backward {
        if self.curvature < 1e-7 {
            return Backward {
                source: q,
                cut_distance_mm: NO_CUT_DISTANCE_MM,
            };
        }
        let radius = 1.0 / self.curvature;
        let v = Vec2::new(radius - self.sense * q.x, q.z + self.half_z);
        let last = self.height * self.curvature;
        let turn = v.y.atan2(v.x).clamp(0.0, last);
        // The remainder after turning back lies along the axis: zero within the arc, the straight
        // part beyond it.
        let back = Vec2::from_angle(-turn).rotate(v);
        let (x, s) = (radius - back.x, turn * radius + back.y);
        Backward {
            source: Vec3::new(self.sense * x, q.y, s - self.half_z),
            cut_distance_mm: 0.98 * radius - x,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        if self.curvature < 1e-7 {
            return Some(q);
        }
        let radius = 1.0 / self.curvature;
        let (x, s) = (self.sense * q.x, q.z + self.half_z);
        if x > 0.98 * radius || s < 0.0 {
            return None;
        }
        let turn = (s * self.curvature).min(self.height * self.curvature);
        let to = Vec2::from_angle(turn).rotate(Vec2::new(radius - x, s - turn * radius));
        Some(Vec3::new(self.sense * (radius - to.x), q.y, to.y - self.half_z))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::Bend,
            &[self.curvature, self.sense, self.half_z, self.height],
        ))
    }
}
