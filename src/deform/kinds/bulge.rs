//! Bulge: magnifies (or, if negative, shrinks) the region around the box's centre, within the
//! ellipsoid that fits the box.
//!
//! With u the position over the half sizes and ρ = |u|, the source of u is u (1 - a (1 - ρ²)²): the
//! magnification at the centre is 1 / (1 - a). ρ (1 - a (1 - ρ²)²) rises for -1.25 < a < 1, hence
//! along each ray from the centre the inverse is one monotone equation.

use super::{
    Backward, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, Kind, NO_CUT_DISTANCE_MM, Parameter,
    solve_rising,
};
use glam::Vec3;

pub(super) const KIND: Kind = Kind {
    name: "bulge",
    about: "magnifies the middle of the box like a lens",
    parameters: &[Parameter::number(
        "amount",
        0.45,
        [-1.0, 0.9],
        "magnification at the centre is 1 / (1 - amount)",
    )],
    size: DefaultSize::Share([0.8; 3]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 80,
    nonzero_faces: [false; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        Box::new(Bulge {
            amount: c.value("amount") * c.progress,
            half: c.half(),
        })
    }),
};

struct Bulge {
    amount: f32,
    half: Vec3,
}

impl Bulge {
    fn factor(&self, rho: f32) -> f32 {
        1.0 - self.amount * (1.0 - rho * rho).max(0.0).powi(2)
    }
}

impl Field for Bulge {
    fn backward(&self, q: Vec3) -> Backward {
        Backward {
            source: q * self.factor((q / self.half).length()),
            cut_distance_mm: NO_CUT_DISTANCE_MM,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        let rho = (q / self.half).length();
        if !(1e-6..1.0).contains(&rho) {
            return Some(if rho < 1.0 { q / self.factor(0.0) } else { q });
        }
        let to = solve_rising(rho, 0.0, 1.0, |r| r * self.factor(r));
        Some(q * (to / rho))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::Bulge,
            &[self.amount, self.half.x, self.half.y, self.half.z],
        ))
    }
}
