//! Affine matrices of FreeSurfer, AFNI, FSL, MRtrix and MINC. `mod.rs` has the table of directions
//! and spaces.

use super::numbers::{number, numbers};
use super::{SUPPORTED, Transform, TransformContext, world_from_fsl};
use crate::volume::GridGeometry;
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DVec3};
use std::path::Path;

const LPS_FROM_RAS: DMat3 = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));

/// Maximum number of numbers in a file of matrices.
const MAX_NUMBERS: usize = 1 << 16;

/// Recognises the format by name, then by content.
pub(super) fn read(path: &Path, name: &str, text: &str, context: &TransformContext) -> Result<Transform> {
    if name.ends_with(".lta") || text.lines().any(|l| l.trim_start().starts_with("nxforms")) {
        return lta(path, text);
    }
    if text.starts_with("MNI Transform File") {
        return mni(path, text);
    }
    if name.ends_with(".dat") {
        return register_dat(path, text, context);
    }
    let numbers = numbers(text, MAX_NUMBERS);
    let last_row = |v: &[f64]| v[12..] == [0.0, 0.0, 0.0, 1.0];
    match numbers.as_deref() {
        Some(v) if v.len() == 12 || v.len() == 16 && last_row(v) => {
            let m = invertible(path, matrix(v))?;
            // MRtrix, NiftyReg and greedy write a matrix of scanner coordinates as FSL writes its
            // own.
            let by_mrtrix = text
                .lines()
                .any(|l| l.starts_with('#') && (l.contains("mrtrix") || l.contains("command_history")));
            let flip = DAffine3::from_mat3(LPS_FROM_RAS);
            match context.convention {
                Some("ras") => Ok(Transform::affine(flip * m * flip)),
                Some("lps") => Ok(Transform::affine(m)),
                Some("fsl") => fsl(path, m, context),
                Some(other) if other != "fsl-absolute" => Err(Error::value(
                    "convention",
                    format!("\"{other}\" is not a known convention for a matrix; use lps, ras or fsl"),
                )),
                _ if by_mrtrix => Ok(Transform::affine(flip * m * flip)),
                _ if v.len() == 12 => Ok(Transform::affine(m)),
                _ => fsl(path, m, context),
            }
        }
        Some(v) if v.len() == 16 => Err(Error::file(
            path,
            "holds a 4 x 4 matrix whose last row is not 0 0 0 1; it is not an affine transform",
        )),
        Some(v) if v.len() > 12 && v.len() % 12 == 0 => Err(Error::file(
            path,
            format!(
                "contains {} matrices, one per time point; save the one you need to its own file",
                v.len() / 12
            ),
        )),
        Some(v) => Err(Error::file(
            path,
            format!(
                "holds {} numbers; a matrix has 12 (AFNI) or 16 (FSL, MRtrix)",
                v.len()
            ),
        )),
        None => Err(Error::file(
            path,
            format!("is not a readable transform; supported: {SUPPORTED}"),
        )),
    }
}

/// Three rows of four numbers.
fn matrix(v: &[f64]) -> DAffine3 {
    DAffine3 {
        matrix3: DMat3::from_cols(
            DVec3::new(v[0], v[4], v[8]),
            DVec3::new(v[1], v[5], v[9]),
            DVec3::new(v[2], v[6], v[10]),
        ),
        translation: DVec3::new(v[3], v[7], v[11]),
    }
}

fn invertible(path: &Path, m: DAffine3) -> Result<DAffine3> {
    if m.is_finite() && m.matrix3.determinant().abs() > 1e-9 {
        Ok(m)
    } else {
        Err(Error::file(path, "holds a singular matrix"))
    }
}

/// FLIRT's matrix: reference millimetres from moving millimetres.
fn fsl(path: &Path, reference_from_moving: DAffine3, context: &TransformContext) -> Result<Transform> {
    let (Some(moving), Some(reference)) = (context.moving, context.reference) else {
        return Err(Error::file(
            path,
            "is an FSL matrix, which cannot be interpreted without its images; name them with moving=FILE and reference=FILE (for a matrix of scanner coordinates, as MRtrix, NiftyReg and greedy write, set convention=ras)",
        ));
    };
    let source_from_deformed =
        world_from_fsl(&moving) * reference_from_moving.inverse() * world_from_fsl(&reference).inverse();
    Ok(Transform::affine(source_from_deformed))
}

/// FreeSurfer's `register.dat`: moving from target coordinates, both of tkregister: millimetres
/// from the middle of the grid along right, anterior and superior, whatever the grid's axes are.
fn register_dat(path: &Path, text: &str, context: &TransformContext) -> Result<Transform> {
    // A name, two voxel sizes and an intensity, the matrix, and a word.
    let rows: Vec<Vec<f64>> = text
        .lines()
        .map(|l| l.split_whitespace().map_while(number).collect::<Vec<_>>())
        .filter(|row| row.len() == 4)
        .collect();
    let (4, Some(v)) = (rows.len(), Some(rows.concat())) else {
        return Err(Error::file(
            path,
            "has no 4 x 4 matrix; it is not a FreeSurfer register.dat, or it is damaged",
        ));
    };
    let (Some(moving), Some(reference)) = (context.moving, context.reference) else {
        return Err(Error::file(
            path,
            "is a FreeSurfer register.dat, which cannot be interpreted without its images; name them with moving=FILE and reference=FILE",
        ));
    };
    let moving_from_target = invertible(path, matrix(&v))?;
    Ok(Transform::affine(
        world_from_tkregister(&moving) * moving_from_target * world_from_tkregister(&reference).inverse(),
    ))
}

/// World from tkregister's coordinates (FreeSurfer, `MRIxfmCRS2XYZtkreg`).
fn world_from_tkregister(grid: &GridGeometry) -> DAffine3 {
    let m = grid.world_from_voxel.matrix3;
    let spacing = DVec3::new(m.x_axis.length(), m.y_axis.length(), m.z_axis.length());
    let half = DVec3::from_array(grid.size.map(|n| n as f64)) * spacing / 2.0;
    let tkregister_from_voxel = DAffine3 {
        matrix3: DMat3::from_cols(
            DVec3::new(-spacing.x, 0.0, 0.0),
            DVec3::new(0.0, 0.0, -spacing.y),
            DVec3::new(0.0, spacing.z, 0.0),
        ),
        translation: DVec3::new(half.x, -half.z, half.y),
    };
    grid.world_from_voxel * tkregister_from_voxel.inverse()
}

/// MNI's transform file (`.xfm` of MINC and FreeSurfer): linear transforms of RAS millimetres, from
/// the source volume to the target, one after the other. ITK writes its own matrices into this
/// format, in LPS and from fixed to moving.
fn mni(path: &Path, text: &str) -> Result<Transform> {
    let fail = |problem: String| Error::file(path, problem);
    let by_itk = text.lines().any(|l| l.trim_start().starts_with("%ITK"));
    let body: String = text
        .lines()
        .skip(1)
        .filter(|l| !l.trim_start().starts_with('%'))
        .flat_map(|l| [l, "\n"])
        .collect();
    let (mut whole, mut found, mut inverted) = (DAffine3::IDENTITY, false, false);
    for statement in body.split(';') {
        let Some((name, value)) = statement.split_once('=') else {
            continue;
        };
        match (name.trim(), value.trim()) {
            ("Transform_Type", "Linear") => inverted = false,
            ("Transform_Type", kind) => {
                return Err(fail(format!(
                    "holds a MINC {kind}, which cannot be read; convert it to a displacement field in NIfTI"
                )));
            }
            ("Invert_Flag", flag) => inverted = flag.eq_ignore_ascii_case("true"),
            ("Linear_Transform", values) => {
                let v = numbers(values, 12).filter(|v| v.len() == 12);
                let v = v.ok_or_else(|| fail("has a Linear_Transform that is not 3 x 4 numbers".into()))?;
                let m = invertible(path, matrix(&v))?;
                whole = if inverted { m.inverse() } else { m } * whole;
                found = true;
            }
            _ => {}
        }
    }
    if !found {
        return Err(fail("holds no Linear_Transform; it is damaged".into()));
    }
    if by_itk {
        return Ok(Transform::affine(whole));
    }
    let flip = DAffine3::from_mat3(LPS_FROM_RAS);
    Ok(Transform::affine(flip * whole.inverse() * flip))
}

/// `name = numbers` lines.
type Fields = Vec<(String, Vec<f64>)>;

/// FreeSurfer's linear transform array, `LINEAR_VOX_TO_VOX` or `LINEAR_RAS_TO_RAS`.
fn lta(path: &Path, text: &str) -> Result<Transform> {
    let fail = |problem: String| Error::file(path, problem);
    let mut kind = None;
    let mut rows: Vec<[f64; 4]> = Vec::new();
    let mut volumes: [Option<Fields>; 2] = [None, None];
    let mut current: Option<usize> = None;
    for line in text.lines() {
        let line = line.split('#').next().unwrap_or("").trim();
        if line.starts_with("src volume") {
            current = Some(0);
            volumes[0] = Some(Vec::new());
        } else if line.starts_with("dst volume") {
            current = Some(1);
            volumes[1] = Some(Vec::new());
        } else if let Some((name, value)) = line.split_once('=') {
            let numbers: Vec<f64> = value.split_whitespace().map_while(number).collect();
            match (name.trim(), current) {
                ("type", _) => kind = numbers.first().map(|v| *v as i64),
                ("nxforms", _) if numbers.first().is_some_and(|n| *n != 1.0) => {
                    return Err(fail(format!(
                        "contains {} transforms; save the one you need to its own file",
                        numbers[0]
                    )));
                }
                (name, Some(n)) => volumes[n]
                    .get_or_insert_default()
                    .push((name.to_owned(), numbers)),
                _ => {}
            }
        } else if current.is_none() {
            let numbers: Vec<f64> = line.split_whitespace().map_while(number).collect();
            if let [a, b, c, d] = numbers[..] {
                rows.push([a, b, c, d]);
            }
        }
    }
    let [r0, r1, r2, _] = rows[..] else {
        return Err(fail(
            "has no 4 x 4 matrix; it is not a FreeSurfer transform, or it is damaged".into(),
        ));
    };
    let m = DAffine3 {
        matrix3: DMat3::from_cols(
            DVec3::new(r0[0], r1[0], r2[0]),
            DVec3::new(r0[1], r1[1], r2[1]),
            DVec3::new(r0[2], r1[2], r2[2]),
        ),
        translation: DVec3::new(r0[3], r1[3], r2[3]),
    };
    let ras_from_voxel = |n: usize| -> Result<DAffine3> {
        let fields = volumes[n]
            .as_ref()
            .ok_or_else(|| fail("is in voxels and does not describe its volumes".into()))?;
        let get = |name: &str| {
            let found = fields
                .iter()
                .find(|(n, v)| n == name && v.len() >= 3)
                .map(|(_, v)| DVec3::new(v[0], v[1], v[2]));
            found.ok_or_else(|| fail(format!("describes a volume without \"{name}\"")))
        };
        let spacing = get("voxelsize")?;
        let linear = DMat3::from_cols(
            get("xras")? * spacing.x,
            get("yras")? * spacing.y,
            get("zras")? * spacing.z,
        );
        // cras is the position of the voxel (n/2, n/2, n/2).
        Ok(DAffine3 {
            matrix3: linear,
            translation: get("cras")? - linear * (get("volume")? / 2.0),
        })
    };
    let dst_from_src = match kind {
        Some(1) => m,
        Some(0) => ras_from_voxel(1)? * m * ras_from_voxel(0)?.inverse(),
        Some(2) => {
            return Err(fail(
                "is of type 2 (physical voxel coordinates), which cannot be read; convert it with lta_convert --outlta to RAS"
                    .into(),
            ));
        }
        Some(other) => {
            return Err(fail(format!(
                "is of type {other}; only types 0 (voxel to voxel) and 1 (RAS to RAS) can be read; convert it with lta_convert"
            )));
        }
        None => return Err(fail("does not state its type; it is damaged".into())),
    };
    let flip = DAffine3::from_mat3(LPS_FROM_RAS);
    Ok(Transform::affine(
        flip * invertible(path, dst_from_src)?.inverse() * flip,
    ))
}
