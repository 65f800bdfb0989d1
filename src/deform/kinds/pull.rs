//! Gaussian pull, \[DDM06\] eq 8: D = (0, 0, -z exp(-((x-1/2)² + (y-1/2)²)/σ²)) with z measured
//! from the box's lower face.
//!
//! The paper's amplitude (the whole box on the axis) maps the axis to one point; here it is the
//! length `amount` of the pull at the upper face. The pull is invertible while `amount` is less
//! than the height of the box. σ is a length.

use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, Kind, NO_CUT_DISTANCE_MM,
    Parameter,
};
use glam::{Vec3, Vec3Swizzles};

pub(super) const KIND: Kind = Kind {
    name: "pull",
    about: "pulls tissue out along the box's z axis as a Gaussian bump",
    parameters: &[
        Parameter::mm(
            "amount",
            BoxLength::OfZ(0.5),
            [BoxLength::OfZ(-1.0), BoxLength::OfZ(1.0)],
            "displacement at the upper face, on the axis",
        ),
        Parameter::mm(
            "sigma",
            BoxLength::OfRadius(0.4),
            [BoxLength::OfRadius(0.05), BoxLength::OfRadius(0.4)],
            "width of the Gaussian",
        ),
    ],
    size: DefaultSize::Share([0.6; 3]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 64,
    nonzero_faces: [false, false, false, false, false, true],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        let [amount, sigma] = [c.value("amount"), c.value("sigma")];
        Box::new(Pull {
            half_z: c.half().z,
            strength: amount * c.progress / c.size_mm.z,
            sigma,
        })
    }),
};

struct Pull {
    half_z: f32,
    /// Pull at the upper face as a fraction of the box's height.
    strength: f32,
    sigma: f32,
}

impl Pull {
    fn factor(&self, q: Vec3) -> f32 {
        1.0 - self.strength * (-q.xy().length_squared() / (self.sigma * self.sigma)).exp()
    }
}

impl Field for Pull {
    fn backward(&self, q: Vec3) -> Backward {
        Backward {
            source: Vec3::new(q.x, q.y, (q.z + self.half_z) * self.factor(q) - self.half_z),
            cut_distance_mm: NO_CUT_DISTANCE_MM,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        let factor = self.factor(q);
        (factor > 1e-4).then(|| Vec3::new(q.x, q.y, (q.z + self.half_z) / factor - self.half_z))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::Pull,
            &[self.half_z, self.strength, self.sigma],
        ))
    }
}
