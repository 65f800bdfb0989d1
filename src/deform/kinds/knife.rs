//! Knife incision with retraction: a straight cut along y from above, with its lips drawn apart
//! along x.
//!
//! The half opening o(y, z) is a lens along the cut, widest in the middle, growing from zero at the
//! cut's floor to `opening`/2 at the box's upper part. The range from the plane x = 0 to the box's
//! side is compressed linearly into the remaining width: x = X (|x'| - o)/(X - o).

use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, GapResolution, Kind,
    Parameter,
};
use glam::Vec3;

pub(super) const KIND: Kind = Kind {
    name: "knife",
    about: "an incision along the box's y axis, held open",
    parameters: &[
        Parameter::mm(
            "length",
            BoxLength::OfY(0.8),
            [BoxLength::OfY(0.02), BoxLength::OfY(0.95)],
            "of the cut",
        ),
        Parameter::mm(
            "depth",
            BoxLength::OfZ(0.6),
            [BoxLength::OfZ(0.02), BoxLength::OfZ(0.95)],
            "depth of the incision below the box's upper face",
        ),
        Parameter::mm(
            "opening",
            BoxLength::OfX(0.25),
            [BoxLength::Fixed(0.0), BoxLength::OfX(0.7)],
            "width of the opening at its widest point",
        ),
    ],
    size: DefaultSize::Share([0.5, 0.6, 0.4]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 96,
    nonzero_faces: [false, false, false, false, false, true],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        let half = c.half();
        Box::new(Knife {
            half_length: c.value("length") / 2.0,
            depth: c.value("depth"),
            half_opening: c.value("opening") * c.progress / 2.0,
            half_x: half.x,
            top: half.z,
            gaps: c.gaps(),
        })
    }),
};

struct Knife {
    half_length: f32,
    depth: f32,
    half_opening: f32,
    half_x: f32,
    top: f32,
    gaps: GapResolution,
}

impl Knife {
    fn opening(&self, y: f32, z: f32) -> f32 {
        let along = (1.0 - (y / self.half_length).powi(2)).max(0.0);
        let above_floor = ((z - self.top) / self.depth + 1.0).clamp(0.0, 1.0);
        // A rounded floor: the lips part quickly, then become nearly vertical.
        self.half_opening * along * (1.0 - (1.0 - above_floor).powi(2)).max(0.0).sqrt() * above_floor.min(1.0)
    }
}

impl Field for Knife {
    fn backward(&self, q: Vec3) -> Backward {
        let open = self.opening(q.y, q.z);
        let x = q.x.abs();
        let source_x = if x >= self.half_x {
            x
        } else {
            self.half_x * (x - open).max(0.0) / (self.half_x - open)
        };
        Backward {
            source: Vec3::new(source_x.copysign(q.x), q.y, q.z),
            cut_distance_mm: self.gaps.distance(x - open, open),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        let open = self.opening(q.y, q.z);
        let x = q.x.abs();
        let to = if x >= self.half_x {
            x
        } else {
            open + x * (self.half_x - open) / self.half_x
        };
        Some(Vec3::new(to.copysign(q.x), q.y, q.z))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::Knife,
            &[
                self.half_length,
                self.depth,
                self.half_opening,
                self.half_x,
                self.top,
                self.gaps.ramp_mm,
                self.gaps.texel_mm,
            ],
        ))
    }
}
