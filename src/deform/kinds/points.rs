//! Control points: given points move to given points, with smooth interpolation between them
//! (`deform::points`).

use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, FieldContext, FieldInputs, Kind,
    NO_CUT_DISTANCE_MM, Parameter, Setting, SettingFormat, forward_numerically, window,
};
use crate::deform::Argument;
use crate::deform::points::{Interpolant, Method, PointPair, read_pairs, read_points};
use crate::math::Bounds;
use crate::{Error, Result};
use glam::{DVec3, Vec3};

pub(super) const KIND: Kind = Kind {
    name: "points",
    about: "moves landmarks to target points and interpolates smoothly between them",
    parameters: &[
        Parameter::number(
            "fade",
            0.0,
            [0.0, 1.0],
            "fraction of the distance to the box's faces over which the displacement fades",
        ),
        Parameter::mm(
            "width",
            BoxLength::Fixed(0.0),
            [BoxLength::Fixed(0.0), BoxLength::Fixed(10_000.0)],
            "width of the Gaussians; 0 uses the spacing of the points",
        ),
    ],
    size: DefaultSize::Share([1.4; 3]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 64,
    nonzero_faces: [true; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Sourced {
        settings: &[
            Setting {
                name: "pairs",
                form: SettingFormat::RowsOrFile(6),
                about: "source x,y,z and target x,y,z in mm for each pair; or a .csv file with six columns",
            },
            Setting {
                name: "from",
                form: SettingFormat::File,
                about: "file of the points (.mrk.json, .fcsv, .csv), in the order of to",
            },
            Setting {
                name: "to",
                form: SettingFormat::File,
                about: "file of the target points",
            },
            Setting {
                name: "method",
                form: SettingFormat::Choice(&["tps", "rbf", "idw"]),
                about: "tps (thin-plate spline), rbf (Gaussian) or idw (inverse distance weighting)",
            },
        ],
        example,
        build,
    },
};

/// The corners stay in place and the centre rises.
fn example(bounds: &Bounds) -> Vec<(&'static str, Argument)> {
    let (center, size) = (bounds.center(), bounds.size());
    let mut pairs = Vec::new();
    for corner in bounds.corners() {
        let p = center + (corner - center) * 0.9;
        pairs.extend([p.to_array(), p.to_array()]);
    }
    pairs.extend([
        center.to_array(),
        (center + size * Vec3::new(0.06, 0.0, 0.16)).to_array(),
    ]);
    vec![("pairs", Argument::Numbers(pairs.concat()))]
}

fn pairs(inputs: &FieldInputs) -> Result<Vec<PointPair>> {
    let settings = inputs.settings;
    match (
        settings.0.get("pairs"),
        settings.text("from")?,
        settings.text("to")?,
    ) {
        (Some(Argument::Text(path)), None, None) => read_pairs(&inputs.library.path(path)),
        (Some(_), None, None) => {
            let v = settings.numbers("pairs")?.unwrap_or_default();
            if v.len() % 6 != 0 {
                return Err(Error::value(
                    "pairs",
                    format!(
                        "has {} numbers; each pair needs six: source x,y,z and target x,y,z",
                        v.len()
                    ),
                ));
            }
            let at = |c: &[f32]| DVec3::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2]));
            Ok(v.chunks_exact(6)
                .map(|c| PointPair {
                    from: at(c),
                    to: at(&c[3..]),
                })
                .collect())
        }
        (None, Some(from), Some(to)) => {
            let (a, b) = (
                read_points(&inputs.library.path(from))?,
                read_points(&inputs.library.path(to))?,
            );
            if a.len() != b.len() {
                return Err(Error::value(
                    "from, to",
                    format!(
                        "hold {} and {} points; they are matched in order, so there must be as many",
                        a.len(),
                        b.len()
                    ),
                ));
            }
            Ok(a.into_iter()
                .zip(b)
                .map(|(from, to)| PointPair { from, to })
                .collect())
        }
        _ => Err(Error::value(
            "pairs",
            "are missing; give pairs=..., or from=FILE and to=FILE",
        )),
    }
}

fn build(c: &FieldContext, inputs: &FieldInputs) -> Result<Box<dyn Field>> {
    let method = match inputs.settings.choice("method", &["tps", "rbf", "idw"])? {
        "tps" => Method::ThinPlate,
        "rbf" => Method::Gaussian,
        _ => Method::InverseDistance,
    };
    // In the box's local millimetres.
    let local_from_world = inputs.world_from_local.inverse();
    let local = |p: DVec3| local_from_world.transform_point3(p.as_vec3()).as_dvec3();
    let own: Vec<PointPair> = pairs(inputs)?
        .into_iter()
        .map(|p| PointPair {
            from: local(p.from),
            to: local(p.to),
        })
        .collect();
    let width = (c.value("width") > 0.0).then(|| f64::from(c.value("width")));
    let (interpolant, notice) = Interpolant::new(&own, method, width)?;
    if let Some(notice) = notice {
        inputs.library.notice(format!("points: {notice}"));
    }
    Ok(Box::new(Points {
        interpolant,
        strength: c.progress,
        fade: c.value("fade"),
        half: c.half(),
    }))
}

struct Points {
    interpolant: Interpolant,
    strength: f32,
    fade: f32,
    half: Vec3,
}

impl Field for Points {
    fn backward(&self, q: Vec3) -> Backward {
        let mut d = self.interpolant.displacement(q.as_dvec3()).as_vec3() * self.strength;
        if self.fade > 0.0 {
            d *= (0..3)
                .map(|a| window(q[a], self.half[a], self.fade))
                .product::<f32>();
        }
        Backward {
            source: q + d,
            cut_distance_mm: NO_CUT_DISTANCE_MM,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        forward_numerically(self, q)
    }
}
