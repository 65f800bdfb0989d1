//! ITK's transform files: text (`.tfm`, `.txt`), MATLAB level 4 (`.mat`, as ANTs writes affines)
//! and, as a feature, HDF5 (`.h5`).
//!
//! A composite's transforms are applied last first (itk::CompositeTransform); here the last one in
//! the file is the first step.

mod steps;

pub(super) use steps::{ItkTransform, step};

use super::Transform;
use crate::{Error, Result};
use std::path::Path;

/// Reads the text format.
pub(super) fn read_text(path: &Path, text: &str) -> Result<Transform> {
    let mut entries: Vec<ItkTransform> = Vec::new();
    for line in text
        .lines()
        .map(str::trim)
        .filter(|l| !l.is_empty() && !l.starts_with('#'))
    {
        let Some((name, value)) = line.split_once(':') else {
            return Err(Error::file(
                path,
                format!(
                    "has the line \"{}\", which is not valid in an ITK transform",
                    shortened(line)
                ),
            ));
        };
        let numbers = || {
            value
                .split_whitespace()
                .map(|w| w.parse::<f64>().ok().filter(|v| v.is_finite()))
                .collect::<Option<Vec<f64>>>()
                .ok_or_else(|| Error::file(path, format!("has {name} with values that are not numbers")))
        };
        match (name.trim(), entries.last_mut()) {
            ("Transform", _) => entries.push(ItkTransform {
                kind: value.trim().to_owned(),
                parameters: Vec::new(),
                fixed: Vec::new(),
            }),
            ("Parameters", Some(entry)) => entry.parameters = numbers()?,
            ("FixedParameters", Some(entry)) => entry.fixed = numbers()?,
            (_, None) => {
                return Err(Error::file(
                    path,
                    "has parameters before any transform; it is damaged",
                ));
            }
            (other, Some(_)) => {
                return Err(Error::file(
                    path,
                    format!("has the entry \"{other}\", which is not valid in an ITK transform"),
                ));
            }
        }
    }
    chain(path, entries)
}

fn shortened(text: &str) -> String {
    text.chars().take(40).collect()
}

fn chain(path: &Path, entries: Vec<ItkTransform>) -> Result<Transform> {
    if entries.is_empty() {
        return Err(Error::file(path, "holds no transform"));
    }
    let composite = entries[0].kind.starts_with("CompositeTransform");
    let mut warnings = Vec::new();
    let own: Vec<&ItkTransform> = if composite {
        entries.iter().skip(1).collect()
    } else {
        if entries.len() > 1 {
            warnings.push(format!(
                "contains {} transforms that do not form a chain; the first is used",
                entries.len()
            ));
        }
        entries.iter().take(1).collect()
    };
    if own.is_empty() {
        return Err(Error::file(
            path,
            "holds a composite without its transforms (ITK does not write them to .mat); save it as .h5 or .tfm",
        ));
    }
    if own.iter().any(|e| e.is_spline_of_order_0()) {
        warnings.push("holds B-splines of order 0, which ITK applies without moving anything".into());
    }
    warnings.extend(own.iter().filter_map(|e| e.versor_notice()));
    let steps = own
        .into_iter()
        .rev()
        .map(|e| step(path, e))
        .collect::<Result<Vec<_>>>()?;
    Ok(Transform { steps, warnings })
}

/// Reads a MATLAB level 4 file, if it is one: ANTs' `0GenericAffine.mat`.
pub(super) fn read_matlab(path: &Path, bytes: &[u8]) -> Result<Option<Transform>> {
    let mut at = 0;
    let mut matrices: Vec<(String, Vec<f64>)> = Vec::new();
    while bytes.len() >= at + 20 {
        let word = |n: usize| {
            i32::from_le_bytes([
                bytes[at + 4 * n],
                bytes[at + 4 * n + 1],
                bytes[at + 4 * n + 2],
                bytes[at + 4 * n + 3],
            ])
        };
        let (kind, rows, columns, imaginary, name_length) = (word(0), word(1), word(2), word(3), word(4));
        // Type: little endian, full matrix of doubles (0) or floats (10).
        if !matches!(kind, 0 | 10)
            || imaginary != 0
            || !(1..=64).contains(&name_length)
            || rows < 0
            || !(1..=16).contains(&columns)
        {
            return if matrices.is_empty() {
                Ok(None)
            } else {
                Err(Error::file(
                    path,
                    "is a MATLAB file that contains more than a transform",
                ))
            };
        }
        let width = if kind == 0 { 8 } else { 4 };
        let (start, count) = (at + 20 + name_length as usize, rows as usize * columns as usize);
        let Some(data) = bytes.get(start..start + count * width) else {
            return Err(Error::file(
                path,
                "ends too early: the file is truncated; copy or download it again",
            ));
        };
        let name = String::from_utf8_lossy(&bytes[at + 20..start])
            .trim_end_matches('\0')
            .to_owned();
        if matrices.is_empty() && (name.is_empty() || !name.chars().all(|c| c.is_ascii_graphic())) {
            return Ok(None);
        }
        let values = data.chunks_exact(width).map(|b| match *b {
            [a, b, c, d] => f64::from(f32::from_le_bytes([a, b, c, d])),
            [a, b, c, d, e, f, g, h] => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
            _ => f64::NAN,
        });
        matrices.push((name, values.collect()));
        at = start + count * width;
    }
    if matrices.is_empty() {
        return Ok(None);
    }
    // Each transform is a matrix named by its type, and its fixed parameters.
    let mut entries = Vec::new();
    for pair in matrices.chunks(2) {
        let [(kind, parameters), (_, fixed)] = pair else {
            return Err(Error::file(
                path,
                "is a MATLAB file, but not of transforms with their fixed parameters",
            ));
        };
        if parameters.iter().chain(fixed).any(|v| !v.is_finite()) {
            return Err(Error::file(
                path,
                format!("has a {kind} with parameters that are not finite"),
            ));
        }
        entries.push(ItkTransform {
            kind: kind.clone(),
            parameters: parameters.clone(),
            fixed: fixed.clone(),
        });
    }
    chain(path, entries).map(Some)
}

/// Reads an HDF5 transform, composite or single.
#[cfg(feature = "hdf5")]
pub(super) fn read_hdf5(path: &Path) -> Result<Transform> {
    let fail = |what: &str, e: String| Error::file(path, format!("{what} could not be read: {e}"));
    // Checks that it is a regular file, and records it as an input.
    crate::files::input::open(path)?;
    let file = hdf5_pure::File::open(path).map_err(|e| fail("the file", e.to_string()))?;
    let mut entries = Vec::new();
    for n in 0.. {
        let set = |name: &str| file.dataset(&format!("TransformGroup/{n}/{name}"));
        let Ok(kind) = set("TransformType") else { break };
        let kind = kind
            .read_string()
            .map_err(|e| fail("a transform's type", e.to_string()))?
            .into_iter()
            .next()
            .unwrap_or_default();
        let numbers = |names: [&str; 2]| -> Result<Vec<f64>> {
            let Some(data) = names.iter().find_map(|name| set(name).ok()) else {
                return Ok(Vec::new());
            };
            let dtype = data.dtype().map_err(|e| fail(names[0], e.to_string()))?;
            if dtype == hdf5_pure::DType::F32 {
                Ok(data
                    .read_f32()
                    .map_err(|e| fail(names[0], e.to_string()))?
                    .into_iter()
                    .map(f64::from)
                    .collect())
            } else {
                data.read_f64().map_err(|e| fail(names[0], e.to_string()))
            }
        };
        // Older versions of ITK misspell "Tranform".
        let parameters = numbers(["TransformParameters", "TranformParameters"])?;
        let fixed = numbers(["TransformFixedParameters", "TranformFixedParameters"])?;
        entries.push(ItkTransform {
            kind: kind.trim_end_matches('\0').to_owned(),
            parameters,
            fixed,
        });
    }
    chain(path, entries)
}
