//! The geometry of an NRRD file: the grid and the axes of its vectors, in LPS.

use super::super::source::usable;
use super::header::{vector, words};
use glam::{DAffine3, DMat3, DVec3};
use std::collections::HashMap;

/// World from voxel, and world (LPS) from the axes of the vectors.
pub(super) fn geometry(
    fields: &HashMap<String, String>,
    spatial: &[usize],
    axes: usize,
    warnings: &mut Vec<String>,
) -> Result<(DAffine3, DMat3), String> {
    let lps_from_space = lps_from_space(fields, warnings);
    let (linear, origin) = match fields.get("space directions") {
        Some(directions) => (oriented_axes(directions, spatial)?, DVec3::ZERO),
        None => {
            let (mut linear, origin) = axis_vectors_and_origin(fields, spatial);
            scale_by_spacings(&mut linear, fields, spatial, axes)?;
            (linear, origin)
        }
    };
    let origin = fields
        .get("space origin")
        .map_or(Some(origin), |o| vector(o))
        .ok_or("has a space origin that cannot be read")?;
    let affine = DAffine3 {
        matrix3: lps_from_space * linear,
        translation: lps_from_space * origin,
    };
    if !usable(&affine) {
        return Err("has singular space directions; its geometry cannot be used".into());
    }
    Ok((affine, lps_from_space * measurement_frame(fields)?))
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
        Some("3d-right-handed" | "scanner-xyz" | "3d-right-handed-time" | "scanner-xyz-time") => DVec3::ONE,
        Some(other) => {
            warnings.push(format!(
                "its space \"{other}\" is not a patient space; left, posterior, superior axes are assumed"
            ));
            DVec3::ONE
        }
        None => {
            if !fields.contains_key("space dimension") {
                warnings.push("has no orientation; left, posterior, superior axes are assumed".into());
            }
            DVec3::ONE
        }
    };
    let units = fields.get("space units").map(|u| {
        words(u)
            .iter()
            .map(|w| mm_of(w.trim_matches('"')))
            .collect::<Vec<_>>()
    });
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

/// The steps between voxels from `axis mins` and `axis maxs` (1 without them or with `spacings`),
/// and the first voxel's position from `axis mins`, mm.
fn axis_vectors_and_origin(fields: &HashMap<String, String>, spatial: &[usize]) -> (DMat3, DVec3) {
    let (mut linear, mut origin) = (DMat3::IDENTITY, DVec3::ZERO);
    let numbers = |name: &str| {
        fields.get(name).map(|t| {
            t.split_whitespace()
                .map(|w| w.parse().unwrap_or(f64::NAN))
                .collect::<Vec<f64>>()
        })
    };
    let unit = |axis: usize| unit_mm(fields, axis);
    let cell = |axis: usize| {
        fields
            .get("centerings")
            .is_some_and(|c| c.split_whitespace().nth(axis) == Some("cell"))
    };
    let (mins, maxs, sizes) = (
        numbers("axis mins"),
        numbers("axis maxs"),
        numbers("sizes").unwrap_or_default(),
    );
    for (n, &axis) in spatial.iter().enumerate() {
        let min = mins
            .as_ref()
            .and_then(|m| m.get(axis))
            .copied()
            .filter(|v| v.is_finite());
        let max = maxs
            .as_ref()
            .and_then(|m| m.get(axis))
            .copied()
            .filter(|v| v.is_finite());
        if let (Some(min), Some(max), Some(&size)) = (min, max, sizes.get(axis))
            && !fields.contains_key("spacings")
        {
            let steps = if cell(axis) { size } else { size - 1.0 };
            if steps >= 1.0 && max != min {
                *linear.col_mut(n) *= (max - min) / steps * unit(axis);
            }
        }
        let shift = if cell(axis) { 0.5 } else { 0.0 };
        let spacing = numbers("spacings")
            .and_then(|s| s.get(axis).copied())
            .filter(|s| s.is_finite())
            .unwrap_or(linear.col(n)[n] / unit(axis));
        origin[n] = min.map_or(0.0, |m| (m + shift * spacing) * unit(axis));
    }
    (linear, origin)
}

/// Multiplies the axes by `spacings`, if given, converted to mm.
fn scale_by_spacings(
    linear: &mut DMat3,
    fields: &HashMap<String, String>,
    spatial: &[usize],
    axes: usize,
) -> Result<(), String> {
    let Some(spacings) = fields.get("spacings") else {
        return Ok(());
    };
    let all: Vec<f64> = spacings
        .split_whitespace()
        .map(|w| w.parse().unwrap_or(f64::NAN))
        .collect();
    if all.len() != axes {
        return Err(format!("has the spacings \"{spacings}\" for {axes} axes"));
    }
    for (n, &axis) in spatial.iter().enumerate() {
        if all[axis].is_finite() && all[axis] != 0.0 {
            *linear.col_mut(n) *= all[axis] * unit_mm(fields, axis);
        }
    }
    Ok(())
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
