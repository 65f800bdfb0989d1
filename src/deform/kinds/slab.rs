//! Slab separation: the volume is cut across z into slabs of equal thickness that spread apart
//! periodically (\[DDM06\] fig 6).
//!
//! The slabs keep their shape. In a gap, D continues from the slab below to the one above without a
//! jump (both end at the same source plane); the map is continuous, and only the mask marks the
//! gaps. Everything beyond the last gap moves with it: the box should enclose the object, with room
//! for the spread.

use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, GapResolution, Kind,
    Parameter,
};
use glam::Vec3;

pub(super) const KIND: Kind = Kind {
    name: "slab",
    about: "cuts the box into slabs perpendicular to its z axis and spreads them apart",
    parameters: &[
        Parameter::mm(
            "thickness",
            BoxLength::OfZ(0.12),
            [BoxLength::OfZ(0.01), BoxLength::OfZ(1.0)],
            "thickness of each slab",
        ),
        Parameter::mm(
            "gap",
            BoxLength::OfZ(0.05),
            [BoxLength::Fixed(0.0), BoxLength::OfZ(1.0)],
            "distance between two slabs",
        ),
        Parameter::number(
            "anchor",
            0.5,
            [0.0, 1.0],
            "height that stays in place: 0 the lower face, 1 the upper",
        ),
    ],
    size: DefaultSize::Share([1.05, 1.05, 1.6]),
    cube_scale: 1.0,
    varies: [false, false, true],
    resolution: 512,
    nonzero_faces: [true; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        Box::new(Slab {
            thickness: c.value("thickness"),
            gap: c.value("gap") * c.progress,
            fixed_z: (c.value("anchor") - 0.5) * c.size_mm.z,
            gaps: c.gaps(),
        })
    }),
};

struct Slab {
    thickness: f32,
    gap: f32,
    fixed_z: f32,
    gaps: GapResolution,
}

impl Field for Slab {
    fn backward(&self, q: Vec3) -> Backward {
        let (t, g) = (self.thickness, self.gap);
        // The anchor is in the middle of a slab; gaps alternate above and below it.
        let z = q.z - self.fixed_z + t / 2.0;
        let n = (z / (t + g)).floor();
        let within = z - n * (t + g);
        let source_z = n * t + within.min(t) - t / 2.0 + self.fixed_z;
        // Positive in a slab: distance to the nearer of its two gaps; negative in a gap.
        let cut = if within <= t {
            within.min(t - within)
        } else {
            -(within - t).min(t + g - within)
        };
        Backward {
            source: Vec3::new(q.x, q.y, source_z),
            cut_distance_mm: self.gaps.distance(cut, g / 2.0),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        let z = q.z - self.fixed_z + self.thickness / 2.0;
        let n = (z / self.thickness).floor();
        Some(Vec3::new(q.x, q.y, q.z + n * self.gap))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::Slab,
            &[
                self.thickness,
                self.gap,
                self.fixed_z,
                self.gaps.ramp_mm,
                self.gaps.texel_mm,
            ],
        ))
    }
}
