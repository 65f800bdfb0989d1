//! Retractor: an incision along x held open to an ellipse.
//!
//! In the elliptic coordinates of the cut's two ends, x = f cosh μ cos ν and y = f sinh μ sin ν,
//! the cut is μ = 0 and every ellipse around it is one value of μ. The range from μ = 0 to the
//! largest ellipse that fits the box is compressed linearly into μ0 up to that ellipse: the lips
//! stay smooth, the ends do not tear, and the inverse is exact. The opening narrows with depth to
//! zero at the cut's floor.

use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, GapResolution, Kind,
    NO_CUT_DISTANCE_MM, Parameter,
};
use crate::math::smoothstep;
use glam::{Vec2, Vec3};

pub(super) const KIND: Kind = Kind {
    name: "retractor",
    about: "an incision along the box's x axis held open to an ellipse",
    parameters: &[
        Parameter::mm(
            "length",
            BoxLength::OfX(0.5),
            [BoxLength::OfX(0.05), BoxLength::OfX(0.8)],
            "of the incision",
        ),
        Parameter::mm(
            "opening",
            BoxLength::OfY(0.35),
            [BoxLength::Fixed(0.0), BoxLength::OfY(0.7)],
            "width of the opening at its widest point",
        ),
        Parameter::mm(
            "depth",
            BoxLength::OfZ(0.6),
            [BoxLength::OfZ(0.05), BoxLength::OfZ(0.95)],
            "depth of the incision below the box's upper face",
        ),
    ],
    size: DefaultSize::Share([0.6, 0.6, 0.4]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 96,
    nonzero_faces: [false, false, false, false, false, true],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        let half = c.half();
        let focus = c.value("length") / 2.0;
        // The outermost ellipse stays inside the box.
        let last = (0.96 * half.x / focus)
            .acosh()
            .min((0.96 * half.y / focus).asinh());
        let open = (c.value("opening") * c.progress / 2.0 / focus)
            .asinh()
            .min(0.75 * last);
        Box::new(Retractor {
            focus,
            last,
            open,
            depth: c.value("depth"),
            top: half.z,
            gaps: c.gaps(),
        })
    }),
};

struct Retractor {
    /// Half the distance between the cut's ends.
    focus: f32,
    /// μ beyond which nothing moves.
    last: f32,
    /// μ of the opening at the upper face.
    open: f32,
    depth: f32,
    top: f32,
    gaps: GapResolution,
}

impl Retractor {
    fn opening(&self, z: f32) -> f32 {
        self.open * smoothstep(0.0, 1.0, (z - self.top) / self.depth + 1.0)
    }

    /// μ and ν of a point: arcosh of (x + iy) / f.
    fn elliptic(&self, q: Vec3) -> Vec2 {
        let (x, y) = (q.x / self.focus, q.y / self.focus);
        // sinh² μ = (b + √(b² + 4y²)) / 2 with b = x² + y² - 1; the equivalent other form keeps its
        // precision where b is negative.
        let b = x * x + y * y - 1.0;
        let root = (b * b + 4.0 * y * y).sqrt();
        let sinh = if b < 0.0 {
            (2.0 * y * y / (root - b)).sqrt()
        } else {
            (0.5 * (b + root)).sqrt()
        };
        let mu = sinh.asinh();
        // The angle from both coordinates; on the cut itself only x determines it.
        let nu = if sinh > 1e-6 {
            (y.abs() / sinh).atan2(x / mu.cosh())
        } else {
            x.clamp(-1.0, 1.0).acos()
        };
        Vec2::new(mu, nu.copysign(y))
    }

    fn cartesian(&self, mu: f32, nu: f32, z: f32) -> Vec3 {
        Vec3::new(
            self.focus * mu.cosh() * nu.cos(),
            self.focus * mu.sinh() * nu.sin(),
            z,
        )
    }
}

impl Field for Retractor {
    fn backward(&self, q: Vec3) -> Backward {
        let open = self.opening(q.z);
        if open <= 1e-5 {
            return Backward {
                source: q,
                cut_distance_mm: NO_CUT_DISTANCE_MM,
            };
        }
        let e = self.elliptic(q);
        // Length of a unit of μ at this point, for the distance to the lip.
        let scale = self.focus * (e.x.sinh().powi(2) + e.y.sin().powi(2)).sqrt().max(0.05);
        let cut_distance_mm = self.gaps.distance((e.x - open) * scale, self.focus * open.sinh());
        if e.x >= self.last {
            return Backward {
                source: q,
                cut_distance_mm,
            };
        }
        let mu = ((e.x - open) * self.last / (self.last - open)).max(0.0);
        Backward {
            source: self.cartesian(mu, e.y, q.z),
            cut_distance_mm,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        let open = self.opening(q.z);
        let e = self.elliptic(q);
        if open <= 1e-5 || e.x >= self.last {
            return Some(q);
        }
        Some(self.cartesian(open + e.x * (self.last - open) / self.last, e.y, q.z))
    }

    fn formula(&self) -> Option<Formula> {
        Some(Formula::new(
            FormulaKind::Retractor,
            &[
                self.focus,
                self.last,
                self.open,
                self.depth,
                self.top,
                self.gaps.ramp_mm,
                self.gaps.texel_mm,
            ],
        ))
    }
}
