//! Twist about the box's z axis: zero at the lower face, the full angle at the upper one, fading
//! towards the rim.
//!
//! Height and radius are preserved, hence the inverse is exactly the twist by the opposite angle
//! (not the negated displacement that \[DS07\] prints), and volume is preserved: det J = 1.

use super::{
    Backward, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, Kind, NO_CUT_DISTANCE_MM, Parameter,
    window,
};
use glam::{Vec2, Vec3, Vec3Swizzles};

pub(super) const KIND: Kind = Kind {
    name: "twist",
    about: "rotates the upper end of the box relative to the lower end",
    parameters: &[
        Parameter::degrees("angle", 60.0, [-720.0, 720.0], "rotation of the upper face"),
        Parameter::number(
            "falloff",
            0.25,
            [0.02, 1.0],
            "fraction of the radius over which the rotation fades",
        ),
    ],
    size: DefaultSize::Share([1.5, 1.5, 1.1]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 96,
    nonzero_faces: [false, false, false, false, false, true],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        Box::new(Twist {
            angle: (c.value("angle") * c.progress).to_radians(),
            falloff: c.value("falloff"),
            size_z: c.size_mm.z,
            radius: c.half().x.min(c.half().y),
        })
    }),
};

struct Twist {
    angle: f32,
    falloff: f32,
    size_z: f32,
    radius: f32,
}

impl Twist {
    fn turned(&self, q: Vec3, sense: f32) -> Vec3 {
        let height = (q.z / self.size_z + 0.5).clamp(0.0, 1.0);
        let turn = sense * self.angle * height * window(q.xy().length(), self.radius, self.falloff);
        Vec2::from_angle(turn).rotate(q.xy()).extend(q.z)
    }
}

impl Field for Twist {
    fn backward(&self, q: Vec3) -> Backward {
        Backward {
            source: self.turned(q, -1.0),
            cut_distance_mm: NO_CUT_DISTANCE_MM,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        Some(self.turned(q, 1.0))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::Twist,
            &[self.angle, self.falloff, self.size_z, self.radius],
        ))
    }
}
