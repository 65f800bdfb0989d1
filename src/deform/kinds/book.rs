//! Book-open: the volume is split along the plane x = 0, and its halves swing open as rigid covers
//! about a spine along y.
//!
//! In the polar coordinates (r, β) about the spine, β from +z to either side, β in [0, 90°] goes to
//! [φ, 90° + φ] rigidly, and the part behind the spine, [90°, 180°], is compressed into the
//! remaining range. Radius and y are preserved; the inverse is exact. Unlike in `seam` nothing
//! fades: the box should enclose the object with room for the covers.

use super::{
    Backward, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, GapResolution, Kind, Parameter,
};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, PI};

pub(super) const KIND: Kind = Kind {
    name: "book",
    about: "splits along the plane x = 0 and opens the halves like a book, spine below",
    parameters: &[
        Parameter::degrees("angle", 40.0, [0.0, 85.0], "swing of each half"),
        Parameter::number(
            "spine",
            0.3,
            [0.0, 0.9],
            "height of the spine in the box: 0 the lower face, 1 the upper",
        ),
    ],
    size: DefaultSize::Share([2.0, 1.1, 1.5]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 128,
    nonzero_faces: [true; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        Box::new(Book {
            angle: (c.value("angle") * c.progress).to_radians(),
            spine_z: (c.value("spine") - 0.5) * c.size_mm.z,
            gaps: c.gaps(),
        })
    }),
};

struct Book {
    angle: f32,
    spine_z: f32,
    gaps: GapResolution,
}

impl Book {
    fn at_angle(&self, q: Vec3, r: f32, signed: f32) -> Vec3 {
        Vec3::new(r * signed.sin(), q.y, r * signed.cos() + self.spine_z)
    }
}

impl Field for Book {
    fn backward(&self, q: Vec3) -> Backward {
        let v = Vec2::new(q.x, q.z - self.spine_z);
        let r = v.length();
        let beta = v.x.abs().atan2(v.y);
        let rigid_end = FRAC_PI_2 + self.angle;
        let source = if beta <= rigid_end {
            (beta - self.angle).max(0.0)
        } else {
            FRAC_PI_2 + (beta - rigid_end) * FRAC_PI_2 / (PI - rigid_end)
        };
        let open = r * self.angle.sin();
        let beyond = beta - self.angle;
        let cut = if beyond.abs() < FRAC_PI_2 {
            r * beyond.sin()
        } else {
            r * beyond.signum()
        };
        Backward {
            source: self.at_angle(q, r, source.copysign(v.x)),
            cut_distance_mm: self.gaps.distance(cut, open),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        let v = Vec2::new(q.x, q.z - self.spine_z);
        let r = v.length();
        let beta = v.x.abs().atan2(v.y);
        let rigid_end = FRAC_PI_2 + self.angle;
        let to = if beta <= FRAC_PI_2 {
            beta + self.angle
        } else {
            rigid_end + (beta - FRAC_PI_2) * (PI - rigid_end) / FRAC_PI_2
        };
        Some(self.at_angle(q, r, to.copysign(v.x)))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::Book,
            &[self.angle, self.spine_z, self.gaps.ramp_mm, self.gaps.texel_mm],
        ))
    }
}
