//! The pull of \[RVD01\] section 3.2: a displacement along z that is a tensor product of quadratic
//! B-splines over the box.
//!
//! Across z, the splines' support is the box. Along z the peak lies a third of the way up: the
//! lower side is a spline whose support ends at the lower face, and the upper side has twice that
//! support, like elastic material squeezed ahead of the pull. The product vanishes on all six
//! faces. Up to a sixth of the box's height the inverse along z is one monotone equation; a larger
//! displacement folds the lower side, as in the paper's pull of a jaw out of a head: the tissue there
//! is shown twice.

use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, Kind, NO_CUT_DISTANCE_MM,
    Parameter, solve_rising,
};
use glam::Vec3;

pub(super) const KIND: Kind = Kind {
    name: "spline-pull",
    about: "pulls tissue up along the box's z axis, compressing the tissue above",
    parameters: &[Parameter::mm(
        "amount",
        BoxLength::OfZ(0.14),
        [BoxLength::OfZ(-0.3), BoxLength::OfZ(0.5)],
        "displacement at the peak; beyond a sixth of the box's height the tissue below the peak is shown twice",
    )],
    size: DefaultSize::Share([0.6; 3]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 64,
    nonzero_faces: [false; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        Box::new(SplinePull {
            amount: c.value("amount") * c.progress,
            half: c.half(),
        })
    }),
};

/// A uniform quadratic B-spline scaled to the support (-1, 1) and a peak of 1.
fn spline(x: f32) -> f32 {
    let t = 1.5 * x.abs();
    if t < 0.5 {
        (0.75 - t * t) / 0.75
    } else if t < 1.5 {
        0.5 * (1.5 - t).powi(2) / 0.75
    } else {
        0.0
    }
}

struct SplinePull {
    amount: f32,
    half: Vec3,
}

impl SplinePull {
    fn across(&self, q: Vec3) -> f32 {
        self.amount * spline(q.x / self.half.x) * spline(q.y / self.half.y)
    }

    fn source_z(&self, across: f32, z: f32) -> f32 {
        let third = 2.0 * self.half.z / 3.0;
        let from_peak = z + self.half.z - third;
        z - across * spline(from_peak / if from_peak < 0.0 { third } else { 2.0 * third })
    }
}

impl Field for SplinePull {
    fn backward(&self, q: Vec3) -> Backward {
        Backward {
            source: Vec3::new(q.x, q.y, self.source_z(self.across(q), q.z)),
            cut_distance_mm: NO_CUT_DISTANCE_MM,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        let across = self.across(q);
        let reach = across.abs() + 1.0;
        Some(Vec3::new(
            q.x,
            q.y,
            solve_rising(q.z, q.z - reach, q.z + reach, |z| self.source_z(across, z)),
        ))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::SplinePull,
            &[self.amount, self.half.x, self.half.y, self.half.z],
        ))
    }
}
