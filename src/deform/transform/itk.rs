//! ITK's transform files: text (`.tfm`, `.txt`), MATLAB level 4 (`.mat`, as ANTs writes affines)
//! and, as a feature, HDF5 (`.h5`).
//!
//! A composite's transforms are applied last first (itk::CompositeTransform); here the last one in
//! the file is the first step.

use super::{BSplineGrid, Transform, TransformStep, VectorField};
use crate::volume::GridGeometry;
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use std::path::Path;

/// One transform of a file: type, parameters, fixed parameters.
struct ItkTransform {
    kind: String,
    parameters: Vec<f64>,
    fixed: Vec<f64>,
}

impl ItkTransform {
    /// The name of the type, and its precision and dimensions.
    fn name_and_dimensions(&self) -> (&str, &str) {
        self.kind.split_once('_').unwrap_or((&self.kind, ""))
    }

    /// Fails unless there are exactly `n` parameters and at least `fixed` fixed parameters.
    fn require(&self, path: &Path, n: usize, fixed: usize) -> Result<()> {
        let (p, f) = (&self.parameters, &self.fixed);
        if p.len() == n && f.len() >= fixed {
            Ok(())
        } else {
            let (name, _) = self.name_and_dimensions();
            Err(Error::file(
                path,
                format!(
                    "has a {name} with {} parameters and {} fixed ones; it needs {n} and {fixed}",
                    p.len(),
                    f.len()
                ),
            ))
        }
    }
}

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
    let steps = own
        .into_iter()
        .rev()
        .map(|e| step(path, e))
        .collect::<Result<Vec<_>>>()?;
    Ok(Transform { steps, warnings })
}

fn vec3(v: &[f64]) -> DVec3 {
    DVec3::new(v[0], v[1], v[2])
}

/// A matrix given row by row.
fn rows(v: &[f64]) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(v[0], v[3], v[6]),
        DVec3::new(v[1], v[4], v[7]),
        DVec3::new(v[2], v[5], v[8]),
    )
}

/// x -> m (x - center) + translation + center.
fn about(m: DMat3, center: DVec3, translation: DVec3) -> DAffine3 {
    DAffine3 {
        matrix3: m,
        translation: translation + center - m * center,
    }
}

/// Size, origin, spacing and direction from ITK's fixed parameters of grids.
fn grid(path: &Path, fixed: &[f64]) -> Result<GridGeometry> {
    let bad = || {
        Error::file(
            path,
            "has a grid whose fixed parameters cannot be used; it is damaged",
        )
    };
    if fixed.len() < 18 || fixed.iter().any(|v| !v.is_finite()) {
        return Err(bad());
    }
    let size = [fixed[0], fixed[1], fixed[2]];
    if size
        .iter()
        .any(|&n| !(1.0..=4096.0).contains(&n) || n.fract() != 0.0)
    {
        return Err(bad());
    }
    let matrix3 = rows(&fixed[9..18]) * DMat3::from_diagonal(vec3(&fixed[6..9]));
    if matrix3.determinant().abs() < 1e-12 {
        return Err(bad());
    }
    Ok(GridGeometry {
        size: size.map(|n| n as usize),
        world_from_voxel: DAffine3 {
            matrix3,
            translation: vec3(&fixed[3..6]),
        },
    })
}

/// The step that an entry of a file describes.
fn step(path: &Path, entry: &ItkTransform) -> Result<TransformStep> {
    let (name, dimensions) = entry.name_and_dimensions();
    if !dimensions.is_empty() && !dimensions.ends_with("_3_3") && !dimensions.ends_with("_3") {
        return Err(Error::file(
            path,
            format!("holds a {}, which is not three-dimensional", entry.kind),
        ));
    }
    match name {
        "BSplineTransform" => bspline(path, entry).map(TransformStep::BSpline),
        "DisplacementFieldTransform" => displacement_field(path, entry).map(TransformStep::Field),
        _ => affine(path, entry).map(TransformStep::Affine),
    }
}

/// The affine transform of an entry of any affine ITK type.
fn affine(path: &Path, entry: &ItkTransform) -> Result<DAffine3> {
    let (p, f) = (&entry.parameters, &entry.fixed);
    let (name, _) = entry.name_and_dimensions();
    let affine = match name {
        "IdentityTransform" => DAffine3::IDENTITY,
        "AffineTransform" | "MatrixOffsetTransformBase" => {
            entry.require(path, 12, 3)?;
            about(rows(p), vec3(f), vec3(&p[9..]))
        }
        "TranslationTransform" => {
            entry.require(path, 3, 0)?;
            DAffine3::from_translation(vec3(p))
        }
        "ScaleTransform" => {
            entry.require(path, 3, 3)?;
            about(DMat3::from_diagonal(vec3(p)), vec3(f), DVec3::ZERO)
        }
        "Euler3DTransform" => {
            entry.require(path, 6, 3)?;
            let [x, y, z] = [
                DMat3::from_rotation_x(p[0]),
                DMat3::from_rotation_y(p[1]),
                DMat3::from_rotation_z(p[2]),
            ];
            // The fourth fixed parameter selects the order ZYX instead of ZXY.
            let rotation = if f.get(3).is_some_and(|&v| v != 0.0) {
                z * y * x
            } else {
                z * x * y
            };
            about(rotation, vec3(f), vec3(&p[3..]))
        }
        "VersorRigid3DTransform" | "Similarity3DTransform" => {
            let similar = name.starts_with("Similarity");
            entry.require(path, if similar { 7 } else { 6 }, 3)?;
            let v = vec3(p);
            let rotation = DMat3::from_quat(DQuat::from_xyzw(
                v.x,
                v.y,
                v.z,
                (1.0 - v.length_squared()).max(0.0).sqrt(),
            ));
            about(
                rotation * if similar { p[6] } else { 1.0 },
                vec3(f),
                vec3(&p[3..]),
            )
        }
        _ => {
            return Err(Error::file(
                path,
                format!(
                    "holds a {}, which cannot be read; save it as an affine or a displacement field",
                    entry.kind
                ),
            ));
        }
    };
    if !(affine.is_finite() && affine.matrix3.determinant().abs() > 1e-9) {
        return Err(Error::file(
            path,
            format!("holds a {name} with a singular matrix"),
        ));
    }
    Ok(affine)
}

/// A grid of cubic B-splines.
fn bspline(path: &Path, entry: &ItkTransform) -> Result<BSplineGrid> {
    let p = &entry.parameters;
    let grid = grid(path, &entry.fixed)?;
    if grid.size.iter().any(|&n| n < 4) {
        return Err(Error::file(
            path,
            format!(
                "has a B-spline grid of {:?} points; cubic splines need 4 along each axis",
                grid.size
            ),
        ));
    }
    let n = grid.size.iter().product::<usize>();
    entry.require(path, 3 * n, 18)?;
    // All x, then all y, then all z.
    let coefficients = (0..n)
        .map(|i| Vec3::new(p[i] as f32, p[n + i] as f32, p[2 * n + i] as f32))
        .collect();
    Ok(BSplineGrid::new(grid, coefficients))
}

/// A displacement field.
fn displacement_field(path: &Path, entry: &ItkTransform) -> Result<VectorField> {
    let grid = grid(path, &entry.fixed)?;
    entry.require(path, 3 * grid.size.iter().product::<usize>(), 18)?;
    let vectors: Vec<Vec3> = entry
        .parameters
        .chunks_exact(3)
        .map(|v| vec3(v).as_vec3())
        .collect();
    if vectors.iter().any(|v| !v.is_finite()) {
        return Err(Error::file(path, "holds vectors that are NaN or infinite"));
    }
    Ok(VectorField::new(grid, vectors))
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
            || !(1..=1 << 20).contains(&rows)
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
        let values = data.chunks_exact(width).map(|b| match *b {
            [a, b, c, d] => f64::from(f32::from_le_bytes([a, b, c, d])),
            [a, b, c, d, e, f, g, h] => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
            _ => f64::NAN,
        });
        matrices.push((name, values.collect()));
        at = start + count * width;
    }
    match &matrices[..] {
        [] => Ok(None),
        [(kind, parameters), (_, fixed)] if parameters.iter().chain(fixed).all(|v| v.is_finite()) => chain(
            path,
            vec![ItkTransform {
                kind: kind.clone(),
                parameters: parameters.clone(),
                fixed: fixed.clone(),
            }],
        )
        .map(Some),
        _ => Err(Error::file(
            path,
            "is a MATLAB file, but not one transform with its fixed parameters",
        )),
    }
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
