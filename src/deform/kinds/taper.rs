//! Taper and shear: linear in x and y, depending on the height above the box's lower face (Barr
//! 1984; \[GG42\]). Both inverses are exact.

use super::{
    Backward, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, Kind, NO_CUT_DISTANCE_MM, Parameter,
};
use glam::Vec3;

pub(super) const TAPER: Kind = Kind {
    name: "taper",
    about: "narrows or widens the box towards its upper face",
    parameters: &[Parameter::number(
        "factor",
        0.5,
        [0.1, 4.0],
        "width of the upper face relative to the original (1 = unchanged)",
    )],
    size: DefaultSize::Share([1.1, 1.1, 1.05]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 64,
    nonzero_faces: [true, true, true, true, false, true],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        Box::new(Taper {
            growth: (c.value("factor") - 1.0) * c.progress,
            height: c.size_mm.z,
        })
    }),
};

struct Taper {
    growth: f32,
    height: f32,
}

impl Taper {
    fn scale(&self, z: f32) -> f32 {
        1.0 + self.growth * (z / self.height + 0.5).clamp(0.0, 1.0)
    }
}

impl Field for Taper {
    fn backward(&self, q: Vec3) -> Backward {
        let s = self.scale(q.z);
        Backward {
            source: Vec3::new(q.x / s, q.y / s, q.z),
            cut_distance_mm: NO_CUT_DISTANCE_MM,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        let s = self.scale(q.z);
        Some(Vec3::new(q.x * s, q.y * s, q.z))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(FormulaKind::Taper, &[self.growth, self.height]))
    }
}

pub(super) const SHEAR: Kind = Kind {
    name: "shear",
    about: "slides the box's upper face along x and y, the lower one staying in place",
    parameters: &[
        Parameter::degrees("angle", 25.0, [-75.0, 75.0], "tilt of the box's edges along x"),
        Parameter::degrees("angle-y", 0.0, [-75.0, 75.0], "tilt of the box's edges along y"),
    ],
    size: DefaultSize::Share([1.6, 1.2, 1.05]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 48,
    nonzero_faces: [true, true, true, true, false, true],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        let slope = |name: &str| c.value(name).to_radians().tan() * c.progress;
        Box::new(Shear {
            slope: Vec3::new(slope("angle"), slope("angle-y"), 0.0),
            half_z: c.half().z,
        })
    }),
};

struct Shear {
    slope: Vec3,
    half_z: f32,
}

impl Field for Shear {
    fn backward(&self, q: Vec3) -> Backward {
        Backward {
            source: q - self.slope * (q.z + self.half_z),
            cut_distance_mm: NO_CUT_DISTANCE_MM,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        Some(q + self.slope * (q.z + self.half_z))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::Shear,
            &[self.slope.x, self.slope.y, self.half_z],
        ))
    }
}
