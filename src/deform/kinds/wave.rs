//! Waves: the volume rises and falls along z with the distance from the box's axis (\[GG42\]'s
//! radial wave as a volume map) or with x (planar).
//!
//! The displacement fades to zero at the box's faces; along z the fade makes the map z' = z + a(r)
//! w(z'), whose inverse is a monotone equation in one unknown.

use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, FieldContext, Formula, FormulaKind, Kind,
    NO_CUT_DISTANCE_MM, Parameter, solve_rising, window,
};
use glam::{Vec3, Vec3Swizzles};

/// Fraction of the half height over which the displacement fades at both ends.
const FADE_Z: f32 = 0.5;
/// Fraction of the radius over which it fades at the rim.
const FADE_R: f32 = 0.3;

const PARAMETERS: &[Parameter] = &[
    Parameter::mm(
        "amplitude",
        BoxLength::OfZ(0.05),
        [BoxLength::OfZ(-0.15), BoxLength::OfZ(0.15)],
        "maximum displacement",
    ),
    Parameter::mm(
        "wavelength",
        BoxLength::OfRadius(0.5),
        [BoxLength::OfRadius(0.1), BoxLength::OfRadius(10.0)],
        "distance from crest to crest",
    ),
    Parameter::degrees("phase", 0.0, [-360.0, 360.0], "phase on the axis"),
];

fn wave(c: &FieldContext, radial: bool) -> Box<dyn Field> {
    Box::new(Wave {
        amplitude: c.value("amplitude") * c.progress,
        wave_number: std::f32::consts::TAU / c.value("wavelength"),
        phase: c.value("phase").to_radians(),
        half: c.half(),
        radial,
    })
}

pub(super) const RADIAL: Kind = Kind {
    name: "wave",
    about: "a circular wave that displaces along the box's z axis",
    parameters: PARAMETERS,
    size: DefaultSize::Share([1.1, 1.1, 1.3]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 96,
    nonzero_faces: [false; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| wave(c, true)),
};

pub(super) const PLANAR: Kind = Kind {
    name: "planar-wave",
    about: "a plane wave that travels along the box's x axis and displaces along z",
    build: FieldBuilder::Formula(|c| wave(c, false)),
    ..RADIAL
};

struct Wave {
    amplitude: f32,
    wave_number: f32,
    phase: f32,
    half: Vec3,
    /// Depends on the distance from the axis, else on x.
    radial: bool,
}

impl Wave {
    fn rise(&self, q: Vec3) -> f32 {
        let (along, fade) = if self.radial {
            let r = q.xy().length();
            (r, window(r, self.half.x.min(self.half.y), FADE_R))
        } else {
            (
                q.x,
                window(q.x, self.half.x, FADE_R) * window(q.y, self.half.y, FADE_R),
            )
        };
        self.amplitude * (self.wave_number * along + self.phase).sin() * fade
    }

    fn source_z(&self, rise: f32, z: f32) -> f32 {
        z - rise * window(z, self.half.z, FADE_Z)
    }
}

impl Field for Wave {
    fn backward(&self, q: Vec3) -> Backward {
        Backward {
            source: Vec3::new(q.x, q.y, self.source_z(self.rise(q), q.z)),
            cut_distance_mm: NO_CUT_DISTANCE_MM,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        // The fade's steepest slope is 1.5/(half_z/2); the amplitude's range keeps 1 - rise·slope
        // positive.
        let rise = self.rise(q);
        let reach = rise.abs() + 1.0;
        Some(Vec3::new(
            q.x,
            q.y,
            solve_rising(q.z, q.z - reach, q.z + reach, |z| self.source_z(rise, z)),
        ))
    }

    fn formula(&self) -> Option<Formula> {
        let Vec3 { x, y, z } = self.half;
        let radial = f32::from(u8::from(self.radial));
        Some(Formula::new(
            FormulaKind::Wave,
            &[self.amplitude, self.wave_number, self.phase, x, y, z, radial],
        ))
    }
}
