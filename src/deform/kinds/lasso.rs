//! Lasso: removes everything inside a closed outline extruded along the box's z axis. When drawn in
//! the view, this axis is the direction of view.
//!
//! The distance to the outline is exact (to the nearest edge; inside by the even-odd rule). With an
//! eye at a finite distance the outline widens with its distance from the eye, as in the picture's
//! perspective.

use super::outline::Outline;
use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, FieldContext, FieldInputs, Kind, Parameter,
    Setting, SettingFormat,
};
use crate::deform::Argument;
use crate::math::Bounds;
use crate::{Error, Result};
use glam::{Vec2, Vec3, Vec3Swizzles};

pub(super) const KIND: Kind = Kind {
    name: "lasso",
    about: "removes everything inside a closed outline, along the view direction",
    parameters: &[Parameter::mm(
        "eye",
        BoxLength::Fixed(0.0),
        [BoxLength::Fixed(0.0), BoxLength::Fixed(1e5)],
        "distance of the eye from the box's centre for an outline drawn in perspective; 0 for orthographic",
    )],
    size: DefaultSize::Across(1.05),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 160,
    nonzero_faces: [true; 6],
    locked_to_view: true,
    shape: None,
    build: FieldBuilder::Sourced {
        settings: &[
            Setting {
                name: "points",
                form: SettingFormat::Rows(2),
                about: "x,y of the outline in the box's plane through its centre, mm (x right, y up in the view)",
            },
            Setting {
                name: "invert",
                form: SettingFormat::Flag,
                about: "true removes what lies around the outline instead",
            },
        ],
        example,
        build,
    },
};

/// A rounded triangle over a part of the box.
fn example(bounds: &Bounds) -> Vec<(&'static str, Argument)> {
    let r = 0.22 * bounds.size().min_element();
    let outline = (0..36).flat_map(|n| {
        let a = n as f32 * std::f32::consts::TAU / 36.0;
        let v = Vec2::from_angle(a) * r * (1.0 + 0.25 * (3.0 * a).cos());
        [v.x + r * 0.5, v.y + r * 0.5]
    });
    vec![("points", Argument::Numbers(outline.collect()))]
}

fn build(c: &FieldContext, inputs: &FieldInputs) -> Result<Box<dyn Field>> {
    let numbers = inputs
        .settings
        .numbers("points")?
        .ok_or_else(|| Error::value("points", "are missing; give the outline's x,y in mm"))?;
    if numbers.len() % 2 != 0 {
        return Err(Error::value(
            "points",
            format!(
                "has {} numbers; each point of the outline needs two (x,y)",
                numbers.len()
            ),
        ));
    }
    let mut outline: Vec<Vec2> = numbers.chunks_exact(2).map(|p| Vec2::new(p[0], p[1])).collect();
    outline.dedup_by(|a, b| a.distance(*b) < 1e-4);
    while outline.len() > 1 && outline[0].distance(outline[outline.len() - 1]) < 1e-4 {
        outline.pop();
    }
    if outline.len() < 3 {
        return Err(Error::value(
            "points",
            format!(
                "an outline of {} points encloses nothing; it needs 3",
                outline.len()
            ),
        ));
    }
    let outline = Outline::new(outline);
    if let Some((a, b)) = outline.crossing() {
        return Err(Error::value(
            "points",
            format!(
                "the outline crosses itself: its edges {} and {} meet",
                a + 1,
                b + 1
            ),
        ));
    }
    let side = if inputs.settings.flag("invert")? {
        -1.0
    } else {
        1.0
    };
    Ok(Box::new(LassoCut {
        outline,
        eye: c.value("eye"),
        side,
        progress: c.progress,
        reach: c.size_mm.length(),
    }))
}

/// Factor by which an outline widens at a height `z` towards the viewer, for an eye at this
/// distance (0: parallel).
pub(super) fn widening(eye: f32, z: f32) -> f32 {
    if eye > 0.0 {
        ((eye - z) / eye).max(1e-3)
    } else {
        1.0
    }
}

struct LassoCut {
    outline: Outline,
    eye: f32,
    /// 1: the outside is retained; -1: the inside is.
    side: f32,
    progress: f32,
    reach: f32,
}

impl LassoCut {
    /// Signed distance to the removed region, positive where the volume is retained.
    fn distance(&self, q: Vec3) -> f32 {
        if self.progress <= 0.0 {
            return super::NO_CUT_DISTANCE_MM;
        }
        let widening = widening(self.eye, q.z);
        let side = self.side * self.outline.signed_distance(q.xy() / widening) * widening;
        // Progress cuts in from the viewer's side.
        let front = self.reach * (0.5 - self.progress) - q.z;
        if self.progress < 1.0 {
            side.max(front)
        } else {
            side
        }
    }
}

impl Field for LassoCut {
    fn backward(&self, q: Vec3) -> Backward {
        Backward {
            source: q,
            cut_distance_mm: self.distance(q),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        (self.distance(q) >= 0.0).then_some(q)
    }
}
