//! The geometry of an NRRD file: the grid and the axes of its vectors, in LPS.

use super::super::ReadOptions;
use super::super::source::usable;
use super::header::{vector, words};
use glam::{DAffine3, DMat3, DVec3};
use std::collections::HashMap;

/// World from voxel, and world (LPS) from the axes of the vectors.
pub(super) fn geometry(
    fields: &HashMap<String, String>,
    spatial: &[usize],
    axes: usize,
    choice: &ReadOptions,
    warnings: &mut Vec<String>,
) -> Result<(DAffine3, DMat3), String> {
    let lps_from_space = lps_from_space(fields, warnings);
    let in_space = fields.contains_key("space") || fields.contains_key("space dimension");
    let grid = match fields.get("space directions") {
        Some(directions) => AxisSteps {
            linear: oriented_axes(directions, spatial)?,
            origin: None,
            stated: [0, 1, 2].map(|n| n < spatial.len()),
        },
        None => {
            if in_space {
                warnings.push(
                    "has a space but no space directions; axes aligned with the space are assumed".into(),
                );
            }
            axis_steps(fields, spatial, axes, warnings)?
        }
    };
    warnings.extend(choice.spacing_notice(grid.stated));
    let origin = match fields.get("space origin") {
        None => None,
        Some(text) => {
            let stated = vector(text).ok_or("has a space origin that cannot be read")?;
            // Only numbers throughout, or none, are valid.
            if !stated.is_finite() && !stated.is_nan_mask().all() {
                return Err(format!(
                    "has the space origin {text}, which is not finite; correct it"
                ));
            }
            Some(stated).filter(|o| o.is_finite())
        }
    };
    let origin = origin.or(grid.origin);
    if origin.is_none() && (in_space || fields.contains_key("space directions")) {
        warnings.push("has no space origin; its first voxel is placed at the origin".into());
    }
    let affine = DAffine3 {
        matrix3: lps_from_space * grid.linear,
        translation: lps_from_space * origin.unwrap_or(DVec3::ZERO),
    };
    if !usable(&affine) {
        return Err("has singular space directions; its geometry cannot be used".into());
    }
    Ok((affine, lps_from_space * measurement_frame(fields)?))
}

/// The steps between voxels, mm.
struct AxisSteps {
    linear: DMat3,
    /// The position of the first voxel, if stated.
    origin: Option<DVec3>,
    /// Whether the length of each step is stated.
    stated: [bool; 3],
}

/// World (LPS, mm) from the space of the file, given by `space` and `space units`.
fn lps_from_space(fields: &HashMap<String, String>, warnings: &mut Vec<String>) -> DMat3 {
    let space = fields.get("space").map(|s| s.to_ascii_lowercase());
    let signs = match space.as_deref() {
        Some("left-posterior-superior" | "lps" | "left-posterior-superior-time" | "lpst") => DVec3::ONE,
        Some("right-anterior-superior" | "ras" | "right-anterior-superior-time" | "rast") => {
            DVec3::new(-1.0, -1.0, 1.0)
        }
        Some("left-anterior-superior" | "las" | "left-anterior-superior-time" | "last") => {
            DVec3::new(1.0, -1.0, 1.0)
        }
        Some(other) => {
            warnings.push(format!(
                "its space \"{other}\" is not a patient space; left, posterior, superior axes are assumed"
            ));
            DVec3::ONE
        }
        None => {
            warnings.push("has no orientation; left, posterior, superior axes are assumed".into());
            DVec3::ONE
        }
    };
    let units = fields.get("space units").map(|u| {
        words(u)
            .iter()
            .map(|w| mm_of(w.trim_matches('"')))
            .collect::<Vec<_>>()
    });
    warnings.extend(unit_notice(fields.get("space units"), [0, 1, 2]));
    let mm = DVec3::from_array(std::array::from_fn(|a| {
        units
            .as_ref()
            .and_then(|u| u.get(a).copied().flatten())
            .unwrap_or(1.0)
    }));
    DMat3::from_diagonal(signs * mm)
}

/// The columns of `space directions` for the spatial axes.
fn oriented_axes(directions: &str, spatial: &[usize]) -> Result<DMat3, String> {
    let mut linear = DMat3::IDENTITY;
    let all = words(directions);
    for (n, &axis) in spatial.iter().enumerate() {
        *linear.col_mut(n) = all
            .get(axis)
            .and_then(|w| vector(w))
            .ok_or_else(|| format!("has the space directions \"{directions}\", which cannot be read"))?;
    }
    // A plane or line in space: the missing directions are perpendicular to it.
    match spatial.len() {
        2 => linear.z_axis = linear.x_axis.cross(linear.y_axis).normalize_or(DVec3::Z),
        1 => {
            let (y, z) = linear.x_axis.normalize_or(DVec3::X).any_orthonormal_pair();
            (linear.y_axis, linear.z_axis) = (y, z);
        }
        _ => {}
    }
    Ok(linear)
}

/// The steps between voxels from `spacings`, else from `axis mins` and `axis maxs`, else from
/// `thicknesses`, and the first voxel's position from `axis mins`. Without `centerings` the latter
/// are edges of voxels, as teem assumes (nrrdDefaultCenter).
fn axis_steps(
    fields: &HashMap<String, String>,
    spatial: &[usize],
    axes: usize,
    warnings: &mut Vec<String>,
) -> Result<AxisSteps, String> {
    let numbers = |name: &str| -> Vec<f64> {
        fields.get(name).map_or(Vec::new(), |t| {
            t.split_whitespace()
                .map(|w| w.parse().unwrap_or(f64::NAN))
                .collect()
        })
    };
    let finite = |list: &[f64], axis: usize| list.get(axis).copied().filter(|v| v.is_finite());
    let (mins, maxs, sizes) = (numbers("axis mins"), numbers("axis maxs"), numbers("sizes"));
    let (spacings, thicknesses) = (numbers("spacings"), numbers("thicknesses"));
    if let Some(text) = fields.get("spacings")
        && spacings.len() != axes
    {
        return Err(format!("has the spacings \"{text}\" for {axes} axes"));
    }
    let mut steps = AxisSteps {
        linear: DMat3::IDENTITY,
        origin: spatial
            .iter()
            .any(|&axis| finite(&mins, axis).is_some())
            .then_some(DVec3::ZERO),
        stated: [false; 3],
    };
    let mut is_centering_assumed = false;
    for (n, &axis) in spatial.iter().enumerate() {
        let centering = fields
            .get("centerings")
            .and_then(|c| c.split_whitespace().nth(axis));
        let is_cell = centering != Some("node");
        let (min, max) = (finite(&mins, axis), finite(&maxs, axis));
        let of_extent = || {
            let steps = finite(&sizes, axis)? - if is_cell { 0.0 } else { 1.0 };
            let length = max? - min?;
            (steps >= 1.0 && length != 0.0).then_some(length / steps)
        };
        let of_thickness = || finite(&thicknesses, axis).filter(|t| *t > 0.0);
        let spacing = finite(&spacings, axis).filter(|s| *s != 0.0).or_else(of_extent);
        if let (None, Some(thickness)) = (spacing, of_thickness()) {
            warnings.push(format!(
                "states no spacing along {} but a thickness of {thickness}, which is used",
                ["i", "j", "k"][n]
            ));
        }
        let spacing = spacing.or_else(of_thickness);
        let unit = unit_mm(fields, axis);
        *steps.linear.col_mut(n) *= spacing.map_or(1.0, |s| s * unit);
        steps.stated[n] = spacing.is_some();
        if let (Some(origin), Some(min)) = (&mut steps.origin, min) {
            origin[n] = min * unit
                + if is_cell {
                    0.5 * steps.linear.col(n)[n]
                } else {
                    0.0
                };
            is_centering_assumed |= !matches!(centering, Some("cell" | "node"));
        }
    }
    if is_centering_assumed {
        warnings.push("does not state whether its axis mins are centres or edges of voxels (centerings); edges are assumed, as in teem".into());
    }
    warnings.extend(unit_notice(fields.get("units"), spatial.iter().copied()));
    Ok(steps)
}

/// A notice about a unit, of these axes or coordinates, that is no length.
fn unit_notice(units: Option<&String>, axes: impl IntoIterator<Item = usize>) -> Option<String> {
    let units = words(units?);
    let unit = axes
        .into_iter()
        .filter_map(|axis| units.get(axis))
        .map(|unit| unit.trim_matches('"'))
        .find(|unit| !matches!(*unit, "" | "???" | "none") && mm_of(unit).is_none())?;
    Some(format!(
        "states its spacing in \"{unit}\", which is not a length; mm is assumed"
    ))
}

/// The axes of vector values in the space of the file, from `measurement frame`.
fn measurement_frame(fields: &HashMap<String, String>) -> Result<DMat3, String> {
    match fields.get("measurement frame") {
        Some(text) => {
            let columns: Vec<DVec3> = words(text).iter().filter_map(|w| vector(w)).collect();
            let [x, y, z] = columns[..] else {
                return Err(format!(
                    "has the measurement frame \"{text}\", which cannot be read"
                ));
            };
            Ok(DMat3::from_cols(x, y, z))
        }
        None => Ok(DMat3::IDENTITY),
    }
}

/// Millimetres per unit along an axis, from `units`; 1 if it is not a unit of length.
fn unit_mm(fields: &HashMap<String, String>, axis: usize) -> f64 {
    fields
        .get("units")
        .and_then(|u| mm_of(words(u).get(axis)?.trim_matches('"')))
        .unwrap_or(1.0)
}

/// Millimetres per unit of length; none if it is not a unit of length.
fn mm_of(unit: &str) -> Option<f64> {
    Some(match unit.to_ascii_lowercase().as_str() {
        "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => 1.0,
        "um" | "µm" | "μm" | "micron" | "microns" | "micrometer" | "micrometers" | "micrometre"
        | "micrometres" => 1e-3,
        "nm" | "nanometer" | "nanometers" | "nanometre" | "nanometres" => 1e-6,
        "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" => 10.0,
        "m" | "meter" | "meters" | "metre" | "metres" => 1000.0,
        _ => return None,
    })
}
