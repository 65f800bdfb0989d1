//! Procedural volumes: closed-form test bodies, the objects of \[DDM06\]'s figures, and a head in
//! Hounsfield units.
//!
//! Every phantom is a function of a point in millimetres ([`function`](super::function)), evaluated
//! at the voxel centres of a grid centred on the world's origin with its axes along L, P, S, or
//! wherever a sample is taken. Surfaces are smooth ramps of the
//! signed distance, two voxels wide, as in a scan. Materials that touch are neighbours on the value
//! scale, so that the ramp between them does not pass through a third one's values (hence the
//! tomato's air is 255 and the piggy bank's 128).

mod bodies;

use super::function::{Expression, Graph, Point, Value};
use super::{Rescale, StoredValues, Volume, Voxels};
use crate::{Error, Result, error::suggestion};
use glam::{DAffine3, DMat3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// The definition of a phantom.
struct Phantom {
    name: &'static str,
    about: &'static str,
    /// Edge of the default grid, voxels.
    size: usize,
    /// Name of the matching transfer function preset.
    preset: &'static str,
    stored: Stored,
    body: for<'g> fn(Point<'g>, f32) -> Value<'g>,
}

/// The type in which a phantom's voxels are stored.
#[derive(Clone, Copy, PartialEq)]
enum Stored {
    Bytes,
    Hounsfield,
    Float,
    Labels,
}

/// Edge of the cube that a phantom fills, mm.
const EXTENT_MM: f32 = 160.0;

const PHANTOMS: &[Phantom] = &[
    Phantom {
        name: "ball",
        about: "a uniform ball of radius 60 mm",
        size: 128,
        preset: "phantom-solid",
        stored: Stored::Float,
        body: bodies::ball,
    },
    Phantom {
        name: "shell",
        about: "a hollow ball, radius 60 mm, wall 8 mm",
        size: 128,
        preset: "phantom-solid",
        stored: Stored::Float,
        body: bodies::shell,
    },
    Phantom {
        name: "checker",
        about: "16 mm checkerboard with two values, filling the volume",
        size: 128,
        preset: "checker",
        stored: Stored::Bytes,
        body: bodies::checker,
    },
    Phantom {
        name: "piggy-bank",
        about: "a thick-walled piggy bank with coins inside",
        size: 192,
        preset: "piggy-bank",
        stored: Stored::Bytes,
        body: bodies::piggy_bank,
    },
    Phantom {
        name: "tomato",
        about: "a tomato: skin, flesh, seeds in chambers",
        size: 192,
        preset: "tomato",
        stored: Stored::Bytes,
        body: bodies::tomato,
    },
    Phantom {
        name: "teddy",
        about: "a teddy bear: cloth, stuffing, a seam",
        size: 192,
        preset: "teddy",
        stored: Stored::Bytes,
        body: bodies::teddy,
    },
    Phantom {
        name: "octants",
        about: "a ball of radius 60 mm in eight labels, one per octant",
        size: 128,
        preset: "octants",
        stored: Stored::Labels,
        body: bodies::octants,
    },
    Phantom {
        name: "head-ct",
        about: "a head in Hounsfield units: skin, skull, brain, air",
        size: 192,
        preset: "ct-bone",
        stored: Stored::Hounsfield,
        body: bodies::head_ct,
    },
];

/// Names and descriptions of all phantoms.
pub fn list() -> impl Iterator<Item = (&'static str, &'static str)> {
    PHANTOMS.iter().map(|p| (p.name, p.about))
}

fn find(name: &str) -> Result<&'static Phantom> {
    PHANTOMS.iter().find(|p| p.name == name).ok_or_else(|| {
        Error::value(
            format!("phantom:{name}"),
            format!(
                "there is no such phantom; {}",
                suggestion(name, PHANTOMS.iter().map(|p| p.name))
            ),
        )
    })
}

/// The preset that suits a phantom best, for `NAME[:...]`.
pub fn preset(spec: &str) -> Option<&'static str> {
    find(spec.split(':').next()?).ok().map(|p| p.preset)
}

/// The phantom given by `NAME[:size=N][:spacing=AxBxC][:sampling=voxels|function]`: N voxels along
/// each edge of a 160 mm cube, or as many as result from the spacing in millimetres.
///
/// # Errors
/// An unknown name or option, a size outside 2 to 1024, or a spacing that results in fewer than 2
/// or more than 1024 voxels; labels by their function.
pub fn from_spec(spec: &str) -> Result<Volume> {
    let mut parts = spec.split(':');
    let phantom = find(parts.next().unwrap_or_default())?;
    let options = ProceduralOptions::parse(&format!("phantom:{spec}"), parts, phantom.size)?;
    let mut volume = generate(phantom.name, options.size, options.spacing_mm)?;
    if options.by_function.unwrap_or(false) {
        if phantom.stored == Stored::Labels {
            return Err(Error::value(
                format!("phantom:{spec}"),
                "a label map cannot be sampled as a function; remove sampling=function",
            ));
        }
        volume.function = Some(Arc::new(expression(phantom, options.spacing_mm)));
    }
    Ok(volume)
}

/// The volume given by `EXPRESSION[:size=N][:spacing=AxBxC][:sampling=voxels|function]`: a function
/// of x, y and z in millimetres (see [`function`](super::function)) over a cube of 160 mm about the
/// origin, evaluated wherever a sample is taken. The grid of N voxels along each edge (128 by
/// default) serves what needs voxels: the histogram, the range of values, and surfaces of a value.
///
/// # Errors
/// An expression that cannot be parsed, and options as for [`from_spec`].
pub fn from_function(spec: &str) -> Result<Volume> {
    let mut parts = spec.split(':');
    let text = parts.next().unwrap_or_default();
    let expression =
        super::function::parse(text).map_err(|problem| Error::value(format!("function:{text}"), problem))?;
    let options = ProceduralOptions::parse(&format!("function:{spec}"), parts, 128)?;
    let values = sampled(&expression, options.size, options.spacing_mm);
    let mut volume = Volume::new(
        Voxels::new(options.size, values),
        Rescale::NONE,
        placed(options.size, options.spacing_mm),
    );
    let span = (volume.range[1] - volume.range[0]) as f32;
    if span > 0.0 && !span.recip().is_normal() {
        return Err(Error::value(
            format!("function:{text}"),
            "its values differ by too little to be told apart; multiply them",
        ));
    }
    if options.by_function.unwrap_or(true) {
        volume.function = Some(Arc::new(expression));
    }
    Ok(volume)
}

/// Whether a path names a phantom or a function rather than a file.
pub fn is_procedural(path: &str) -> bool {
    path.starts_with("phantom:") || path.starts_with("function:")
}

/// The volume of a path that [`is_procedural`]; none of any other path.
///
/// # Errors
/// Those of [`from_spec`] and [`from_function`].
pub fn from_path(path: &str) -> Result<Option<Volume>> {
    if let Some(spec) = path.strip_prefix("phantom:") {
        return from_spec(spec).map(Some);
    }
    path.strip_prefix("function:").map(from_function).transpose()
}

/// The options that follow a phantom's name or a function.
struct ProceduralOptions {
    size: [usize; 3],
    spacing_mm: Vec3,
    /// Whether samples are taken from the function rather than from voxels, if that is stated.
    by_function: Option<bool>,
}

impl ProceduralOptions {
    fn parse<'a>(spec: &str, options: impl Iterator<Item = &'a str>, size: usize) -> Result<Self> {
        let mut parsed = Self {
            size: [size; 3],
            spacing_mm: Vec3::splat(EXTENT_MM / size as f32),
            by_function: None,
        };
        for option in options {
            let bad = |problem: &str| Error::value(spec, format!("{option}: {problem}"));
            match option.split_once('=') {
                Some(("size", n)) => {
                    let n: usize = n.parse().map_err(|_| bad("the size is a number of voxels"))?;
                    parsed.size = [n; 3];
                    parsed.spacing_mm = Vec3::splat(EXTENT_MM / n as f32);
                }
                Some(("spacing", s)) => {
                    let parts: Vec<f32> = s
                        .split('x')
                        .map_while(|v| v.parse().ok())
                        .filter(|v: &f32| v.is_finite() && *v > 0.0)
                        .collect();
                    let [x, y, z] = parts[..] else {
                        return Err(bad("the spacing is three lengths in mm, e.g. spacing=1x1x5"));
                    };
                    parsed.spacing_mm = Vec3::new(x, y, z);
                    parsed.size = [x, y, z].map(|s| (EXTENT_MM / s).round() as usize);
                }
                Some(("sampling", "voxels")) => parsed.by_function = Some(false),
                Some(("sampling", "function")) => parsed.by_function = Some(true),
                Some(("sampling", _)) => return Err(bad("the sampling is voxels or function")),
                _ => {
                    return Err(bad(
                        "known options are size=N, spacing=AxBxC and sampling=voxels or function",
                    ));
                }
            }
            if parsed.size.iter().any(|n| !(2..=1024).contains(n)) {
                return Err(bad("the grid must have 2 to 1024 voxels along each axis"));
            }
        }
        Ok(parsed)
    }
}

/// A phantom's function, with surfaces as wide as the voxels of a spacing demand.
fn expression(phantom: &Phantom, spacing_mm: Vec3) -> Expression {
    let graph = Graph::default();
    graph.finish((phantom.body)(graph.point(), spacing_mm.min_element()))
}

/// Voxel indices to the world of a grid that is centred on the origin.
fn placed(size: [usize; 3], spacing_mm: Vec3) -> DAffine3 {
    let origin = -0.5 * spacing_mm * (Vec3::from(size.map(|n| n as f32)) - 1.0);
    DAffine3 {
        matrix3: DMat3::from_diagonal(spacing_mm.as_dvec3()),
        translation: origin.as_dvec3(),
    }
}

/// The values of a function at the voxel centres of such a grid.
fn sampled(expression: &Expression, size: [usize; 3], spacing_mm: Vec3) -> Vec<f32> {
    let at = crate::math::to_f32(&placed(size, spacing_mm));
    let row_x: Vec<f32> = (0..size[0])
        .map(|i| at.translation.x + spacing_mm.x * i as f32)
        .collect();
    (0..size[1] * size[2])
        .into_par_iter()
        .flat_map_iter(|row| {
            let y = at.translation.y + spacing_mm.y * (row % size[1]) as f32;
            let z = at.translation.z + spacing_mm.z * (row / size[1]) as f32;
            let mut values = vec![0.0; size[0]];
            expression.evaluate([&row_x, &vec![y; size[0]], &vec![z; size[0]]], &mut values);
            values
        })
        .collect()
}

/// A phantom sampled on a grid of any size and spacing (mm), centred on the origin.
///
/// # Errors
/// An unknown name.
pub fn generate(name: &str, size: [usize; 3], spacing_mm: Vec3) -> Result<Volume> {
    let phantom = find(name)?;
    let values = sampled(&expression(phantom, spacing_mm), size, spacing_mm);
    let bytes = |values: Vec<f32>| -> StoredValues {
        values
            .into_iter()
            .map(|v| v.round().clamp(0.0, 255.0) as u8)
            .collect::<Vec<_>>()
            .into()
    };
    let values: StoredValues = match phantom.stored {
        Stored::Float => values.into(),
        Stored::Bytes | Stored::Labels => bytes(values),
        Stored::Hounsfield => values
            .into_iter()
            .map(|v| v.round() as i16)
            .collect::<Vec<_>>()
            .into(),
    };
    let mut volume = Volume::new(Voxels::new(size, values), Rescale::NONE, placed(size, spacing_mm));
    volume.declared_labels = phantom.stored == Stored::Labels;
    Ok(volume)
}

/// Radius of `ball` and outer radius of `shell`, mm.
pub const BALL_RADIUS_MM: f32 = 60.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_phantom_has_content_at_any_size() {
        for p in PHANTOMS {
            let v =
                generate(p.name, [24, 20, 28], Vec3::new(6.0, 8.0, 5.5)).unwrap_or_else(|e| panic!("{e}"));
            assert!(
                v.range[1] > v.range[0] && v.non_finite == 0,
                "{} {:?}",
                p.name,
                v.range
            );
        }
    }

    #[test]
    fn ball_has_the_volume_of_a_ball() {
        let v = generate("ball", [80; 3], Vec3::splat(2.0)).unwrap_or_else(|e| panic!("{e}"));
        let sum: f64 = (0..v.voxels.len()).map(|n| v.voxels.get(n)).sum::<f64>() * 8.0;
        let want = 4.0 / 3.0 * std::f64::consts::PI * f64::from(BALL_RADIUS_MM).powi(3);
        assert!((sum / want - 1.0).abs() < 1e-3, "{sum} for {want}");
    }

    #[test]
    fn specifications_are_checked() {
        assert!(from_spec("ball:size=16").is_ok());
        for bad in [
            "bal",
            "ball:size=0",
            "ball:size=x",
            "ball:size=5000",
            "ball:spacing=1x1",
            "ball:spacing=1x1x0",
            "ball:colour=3",
        ] {
            assert!(from_spec(bad).is_err(), "{bad}");
        }
        assert!(from_spec("pigy-bank").is_err_and(|e| e.to_string().contains("piggy-bank")));
    }
}
