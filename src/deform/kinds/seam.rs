//! Seam opening: the volume is split along the plane x = 0 from above, and its halves swing open
//! about a hinge line along y (\[DDM06\] fig 7).
//!
//! In the polar coordinates (r, β) about the hinge, β from +z, the opening by φ to each side maps β
//! in [0, β_e] to [φ, β_e] linearly: the halves swing aside and are compressed towards β_e, below
//! which nothing moves. φ fades with the radius and towards the ends of the seam; r and y are
//! preserved, hence the inverse is exact.

use super::{
    Backward, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, GapResolution, Kind, Parameter, window,
};
use crate::math::smoothstep;
use glam::{Vec2, Vec3};

/// Angle from +z below which nothing moves, if the box is high enough, radians.
const LAST_ANGLE: f32 = 1.9;
/// Height of the hinge above the lower face, as a fraction of the box.
const HINGE: f32 = 0.15;
/// Fraction of the radius within which the opening does not fade.
const RIGID: f32 = 0.75;

pub(super) const KIND: Kind = Kind {
    name: "seam",
    about: "splits along a seam (the box's y axis) and swings the halves open",
    parameters: &[Parameter::degrees(
        "angle",
        40.0,
        [0.0, 75.0],
        "swing of each half",
    )],
    size: DefaultSize::Share([0.9, 0.7, 0.6]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 96,
    nonzero_faces: [false; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        let half = c.half();
        let radius = half.x.min((1.0 - HINGE) * c.size_mm.z);
        // The swinging part must not reach below the box's lower face.
        let to_floor = (HINGE * c.size_mm.z / radius).min(1.0);
        Box::new(Seam {
            last_angle: LAST_ANGLE.min((-to_floor).acos()),
            angle: (c.value("angle") * c.progress).to_radians(),
            half_y: half.y,
            hinge_z: -half.z + HINGE * c.size_mm.z,
            radius,
            gaps: c.gaps(),
        })
    }),
};

struct Seam {
    /// Angle from +z below which nothing moves, radians.
    last_angle: f32,
    angle: f32,
    half_y: f32,
    hinge_z: f32,
    radius: f32,
    gaps: GapResolution,
}

impl Seam {
    /// Opening to each side at a radius and a position along the seam, radians.
    fn opening(&self, r: f32, y: f32) -> f32 {
        self.angle * (1.0 - smoothstep(RIGID * self.radius, self.radius, r)) * window(y, self.half_y, 0.8)
    }

    fn at_angle(&self, q: Vec3, r: f32, signed: f32) -> Vec3 {
        let v = Vec2::new(r * signed.sin(), r * signed.cos());
        Vec3::new(v.x, q.y, v.y + self.hinge_z)
    }
}

impl Field for Seam {
    fn backward(&self, q: Vec3) -> Backward {
        let v = Vec2::new(q.x, q.z - self.hinge_z);
        let r = v.length();
        let beta = v.x.abs().atan2(v.y);
        let open = self.opening(r, q.y);
        let source_beta = if beta >= self.last_angle {
            beta
        } else {
            self.last_angle * (beta - open).max(0.0) / (self.last_angle - open)
        };
        Backward {
            source: self.at_angle(q, r, source_beta.copysign(v.x)),
            cut_distance_mm: self.gaps.distance(r * (beta - open), r * open),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        let v = Vec2::new(q.x, q.z - self.hinge_z);
        let r = v.length();
        let beta = v.x.abs().atan2(v.y);
        let open = self.opening(r, q.y);
        let to = if beta >= self.last_angle {
            beta
        } else {
            open + beta * (self.last_angle - open) / self.last_angle
        };
        Some(self.at_angle(q, r, to.copysign(v.x)))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::Seam,
            &[
                self.last_angle,
                self.angle,
                self.half_y,
                self.hinge_z,
                self.radius,
                self.gaps.ramp_mm,
                self.gaps.texel_mm,
            ],
        ))
    }
}
