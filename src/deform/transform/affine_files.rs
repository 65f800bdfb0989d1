//! Affine matrices of FreeSurfer, AFNI and FSL. `mod.rs` has the table of directions and spaces.

use super::{Transform, TransformContext, world_from_fsl};
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DVec3};
use std::path::Path;

const LPS_FROM_RAS: DMat3 = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));

/// Recognises the format by name, then by content.
pub(super) fn read(path: &Path, name: &str, text: &str, context: &TransformContext) -> Result<Transform> {
    if name.ends_with(".lta") || text.lines().any(|l| l.trim_start().starts_with("nxforms")) {
        return lta(path, text);
    }
    let words: Option<Vec<f64>> = text
        .lines()
        .filter(|l| !l.trim_start().starts_with('#'))
        .flat_map(str::split_whitespace)
        .map(|w| w.parse::<f64>().ok().filter(|v| v.is_finite()))
        .take(4096)
        .collect();
    match words.as_deref() {
        Some(v) if v.len() == 12 => {
            let m = DMat3::from_cols(
                DVec3::new(v[0], v[4], v[8]),
                DVec3::new(v[1], v[5], v[9]),
                DVec3::new(v[2], v[6], v[10]),
            );
            invertible(
                path,
                DAffine3 {
                    matrix3: m,
                    translation: DVec3::new(v[3], v[7], v[11]),
                },
            )
            .map(Transform::affine)
        }
        Some(v) if v.len() == 16 && v[12..] == [0.0, 0.0, 0.0, 1.0] => fsl(path, v, context),
        Some(v) if v.len() > 12 && v.len() % 12 == 0 => Err(Error::file(
            path,
            format!(
                "contains {} matrices, one per time point; save the one you need to its own file",
                v.len() / 12
            ),
        )),
        _ => Err(Error::file(
            path,
            "is not a readable transform; supported: ITK (.tfm, .mat), FSL, FreeSurfer (.lta), AFNI (.1D) and vector images",
        )),
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
fn fsl(path: &Path, v: &[f64], context: &TransformContext) -> Result<Transform> {
    let m = DMat3::from_cols(
        DVec3::new(v[0], v[4], v[8]),
        DVec3::new(v[1], v[5], v[9]),
        DVec3::new(v[2], v[6], v[10]),
    );
    let reference_from_moving = invertible(
        path,
        DAffine3 {
            matrix3: m,
            translation: DVec3::new(v[3], v[7], v[11]),
        },
    )?;
    let (Some(moving), Some(reference)) = (context.moving, context.reference) else {
        return Err(Error::file(
            path,
            "is an FSL matrix, which cannot be interpreted without its images; name them with moving=FILE and reference=FILE",
        ));
    };
    let source_from_deformed =
        world_from_fsl(&moving) * reference_from_moving.inverse() * world_from_fsl(&reference).inverse();
    Ok(Transform::affine(source_from_deformed))
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
            let numbers: Vec<f64> = value.split_whitespace().map_while(|w| w.parse().ok()).collect();
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
            let numbers: Vec<f64> = line.split_whitespace().map_while(|w| w.parse().ok()).collect();
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
        other => {
            return Err(fail(format!(
                "is of type {other:?}; 0 (voxel to voxel) and 1 (RAS to RAS) can be read"
            )));
        }
    };
    let flip = DAffine3::from_mat3(LPS_FROM_RAS);
    Ok(Transform::affine(
        flip * invertible(path, dst_from_src)?.inverse() * flip,
    ))
}
