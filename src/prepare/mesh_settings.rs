//! The settings of meshes in numeric form: placement, deformers, solids.

use crate::deform::Placement;
use crate::error::suggestion;
use crate::math::Bounds;
use crate::mesh::deformer::{Deformer, DeformerKind, LATTICE, MAX_DEFORMERS};
use crate::mesh::formula::{CsgOperation, Formula, MAX_SOLIDS, PlacedSolid, Solid};
use crate::scene::Size;
use crate::scene::surface::{DeformerSource, MeshPlace, ShapeSource};
use crate::{Error, Result};
use glam::{Affine3A, Mat3, Vec3};

/// The transform from a mesh file's coordinates to the world.
pub fn placement(bounds: &Bounds, place: &MeshPlace) -> Result<Affine3A> {
    let MeshPlace {
        center,
        size,
        rotate,
        matrix,
    } = *place;
    if let Some(rows) = matrix {
        if center.is_some() || size.is_some() || rotate.is_some() {
            return Err(Error::value(
                "matrix",
                "already says where the mesh goes; leave out center, size and rotate",
            ));
        }
        let column = |c: usize| Vec3::new(rows[0][c], rows[1][c], rows[2][c]);
        let m = Affine3A::from_mat3_translation(Mat3::from_cols(column(0), column(1), column(2)), column(3));
        let usable = m.is_finite() && Mat3::from(m.matrix3).determinant() != 0.0;
        return if usable {
            Ok(m)
        } else {
            Err(Error::value("matrix", "is singular or not finite"))
        };
    }
    let scale = match size {
        Some(s) if s.is_finite() && s > 0.0 => s / bounds.size().max_element(),
        Some(s) => return Err(Error::value("size", format!("{s} is not a length"))),
        None => 1.0,
    };
    let turn = rotation(rotate)?;
    let center = center.map_or(bounds.center(), Vec3::from);
    if !center.is_finite() {
        return Err(Error::value("center", "must be finite"));
    }
    Ok(Affine3A::from_translation(center)
        * Affine3A::from_mat3(turn)
        * Affine3A::from_scale(Vec3::splat(scale))
        * Affine3A::from_translation(-bounds.center()))
}

/// About x, then y, then z, as for deformations.
fn rotation(degrees: Option<[f32; 3]>) -> Result<Mat3> {
    let Some(d) = degrees else {
        return Ok(Mat3::IDENTITY);
    };
    let placement = Placement::new(Vec3::ZERO, Vec3::ONE, Vec3::from(d))?;
    Ok(Mat3::from(placement.world_from_map.matrix3))
}

/// The deformers of a mesh with the given bounds.
pub fn deformers(sources: &[DeformerSource], bounds: &Bounds) -> Result<Vec<Deformer>> {
    if sources.len() > MAX_DEFORMERS {
        return Err(Error::value(
            "deformer",
            format!("a mesh has at most {MAX_DEFORMERS}"),
        ));
    }
    sources.iter().map(|d| deformer(d, bounds)).collect()
}

/// The kinds of deformers, with the names of their parameters.
const DEFORMER_KINDS: [(&str, &[&str]); 7] = [
    ("twist", &["angle"]),
    ("bend", &["angle"]),
    ("taper", &["factor"]),
    ("shear", &["amount"]),
    ("bulge", &["amount", "width"]),
    ("wave", &["amplitude", "length", "phase"]),
    ("lattice", &[]),
];

/// Checks the kind, the parameters and the progress of a deformer; returns the kind.
fn checked_kind(d: &DeformerSource) -> Result<&'static str> {
    let Some(&(kind, valid_names)) = DEFORMER_KINDS.iter().find(|k| k.0 == d.kind) else {
        return Err(Error::value(
            format!("deformer \"{}\"", d.kind),
            format!(
                "there is no such deformer; {}",
                suggestion(&d.kind, DEFORMER_KINDS.iter().map(|k| k.0))
            ),
        ));
    };
    if let Some(name) = d.numbers.keys().find(|n| !valid_names.contains(&n.as_str())) {
        return Err(Error::value(
            format!("{kind}: {name}"),
            format!(
                "there is no such parameter; {}",
                suggestion(name, valid_names.iter().copied())
            ),
        ));
    }
    if let Some((name, value)) = d.numbers.iter().find(|(_, v)| !v.is_finite()) {
        return Err(Error::value(
            format!("{kind}: {name}"),
            format!("{value} is not finite"),
        ));
    }
    let progress = d.progress.unwrap_or(1.0);
    if !(0.0..=1.0).contains(&progress) {
        return Err(Error::value(
            format!("{kind}: progress"),
            format!("{progress} is outside 0 to 1"),
        ));
    }
    Ok(kind)
}

/// Resolves a deformer; its box defaults to that of the mesh.
fn deformer(d: &DeformerSource, bounds: &Bounds) -> Result<Deformer> {
    let kind = checked_kind(d)?;
    // A flat mesh also needs a box with a volume.
    let own = bounds.size().max(Vec3::splat(0.01 * bounds.size().max_element()));
    let size = d.size.map_or(own, Size::xyz);
    let placement = Placement::new(
        d.center.map_or(bounds.center(), Vec3::from),
        size,
        d.rotate.map_or(Vec3::ZERO, Vec3::from),
    );
    let placement = placement.map_err(|e| e.within(kind))?;
    let half = size * 0.5;
    let local_from_world =
        Affine3A::from_scale(size) * Affine3A::from_translation(Vec3::splat(-0.5)) * placement.map_from_world;
    Ok(Deformer {
        deform: deformer_kind(d, kind, size)?,
        local_from_world,
        half,
    })
}

/// The kind of a deformer with its resolved parameters, for a box of this size.
fn deformer_kind(d: &DeformerSource, kind: &str, size: Vec3) -> Result<DeformerKind> {
    let progress = d.progress.unwrap_or(1.0);
    let number = |name: &str, default: f32| d.numbers.get(name).copied().unwrap_or(default);
    let positive = |name: &str, default: f32| match number(name, default) {
        v if v > 0.0 => Ok(v),
        v => Err(Error::value(
            format!("{kind}: {name}"),
            format!("{v} is not positive"),
        )),
    };
    Ok(match kind {
        "twist" => DeformerKind::Twist(progress * number("angle", 90.0).to_radians() / size.z),
        "bend" => DeformerKind::Bend(progress * number("angle", 60.0).to_radians() / size.z),
        "taper" => DeformerKind::Taper(1.0 + progress * (positive("factor", 0.4)? - 1.0)),
        "shear" => DeformerKind::Shear(progress * number("amount", 0.4)),
        "bulge" => DeformerKind::Bulge(
            progress * number("amount", 0.4),
            positive("width", 0.25 * size.z)?,
        ),
        "wave" => {
            let length = positive("length", 0.4 * size.x.max(size.y))?;
            DeformerKind::Wave(
                progress * number("amplitude", 0.05 * size.max_element()),
                std::f32::consts::TAU / length,
                number("phase", 0.0).to_radians(),
            )
        }
        _ => DeformerKind::Lattice(Box::new(lattice_offsets(&d.points, progress)?)),
    })
}

/// The offsets of a lattice's control points, mm; x fastest.
fn lattice_offsets(points: &[[f32; 6]], progress: f32) -> Result<[Vec3; LATTICE * LATTICE * LATTICE]> {
    let mut offsets = [Vec3::ZERO; LATTICE * LATTICE * LATTICE];
    for p in points {
        let index = [p[0], p[1], p[2]];
        if !index
            .iter()
            .all(|i| (0.0..LATTICE as f32).contains(i) && i.fract() == 0.0)
            || !p.iter().all(|v| v.is_finite())
        {
            return Err(Error::value(
                "lattice: points",
                format!("{p:?} is not three indices from 0 to 3 and an offset"),
            ));
        }
        let n = (index[2] as usize * LATTICE + index[1] as usize) * LATTICE + index[0] as usize;
        offsets[n] = Vec3::new(p[3], p[4], p[5]) * progress;
    }
    Ok(offsets)
}

pub fn formula(shapes: &[ShapeSource]) -> Result<Formula> {
    if shapes.len() > MAX_SOLIDS {
        return Err(Error::value(
            "shape",
            format!("at most {MAX_SOLIDS} solids are joined"),
        ));
    }
    let solids = shapes.iter().enumerate().map(|(n, s)| {
        let of = |name: &str| format!("shape {}: {name}", n + 1);
        let length = |name: &str, value: Option<f32>, default: f32| match value.unwrap_or(default) {
            v if v.is_finite() && v > 0.0 => Ok(v),
            v => Err(Error::value(of(name), format!("{v} is not a length"))),
        };
        let size = s.size.map_or(Vec3::splat(100.0), Size::xyz);
        if !(size.is_finite() && size.min_element() > 0.0) {
            return Err(Error::value(of("size"), "must be positive lengths"));
        }
        let solid = match s.kind.as_str() {
            "sphere" => Solid::Sphere(length("radius", s.radius, 50.0)?),
            "box" => Solid::Box(size * 0.5),
            "torus" => Solid::Torus(length("radius", s.radius, 40.0)?, length("tube", s.tube, 12.0)?),
            "cylinder" => Solid::Cylinder(
                length("radius", s.radius, 30.0)?,
                0.5 * length("length", s.length, 100.0)?,
            ),
            "gyroid" => Solid::Gyroid(
                length("period", s.period, 30.0)?,
                length("wall", s.wall, 3.0)?,
                size * 0.5,
            ),
            other => {
                let valid_names = ["sphere", "box", "torus", "cylinder", "gyroid"];
                return Err(Error::value(
                    of(&format!("kind \"{other}\"")),
                    format!("there is no such solid; {}", suggestion(other, valid_names)),
                ));
            }
        };
        let join = match s.join.as_deref() {
            None | Some("union") => CsgOperation::Union,
            Some("intersect") => CsgOperation::Intersect,
            Some("subtract") => CsgOperation::Subtract,
            Some(other) => {
                return Err(Error::value(
                    of(&format!("join \"{other}\"")),
                    "is one of union, intersect, subtract",
                ));
            }
        };
        let world_from_local =
            Affine3A::from_mat3_translation(rotation(s.rotate)?, s.center.map_or(Vec3::ZERO, Vec3::from));
        if !world_from_local.is_finite() {
            return Err(Error::value(of("center"), "must be finite"));
        }
        Ok(PlacedSolid {
            solid,
            join,
            local_from_world: world_from_local.inverse(),
        })
    });
    solids.collect::<Result<_>>().map(Formula)
}
