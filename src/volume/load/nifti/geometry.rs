//! The geometry of a NIfTI or Analyze file, in LPS.

use super::super::ReadOptions;
use super::super::source;
use super::header::{Header, Version};
use glam::{DAffine3, DMat3, DQuat, DVec3};

/// World (LPS, mm) from voxel; `size` is the number of voxels along the axes.
pub(super) fn geometry(header: &mut Header, size: [usize; 3], choice: &ReadOptions) -> DAffine3 {
    let units = if header.version == Version::Two {
        header.field::<4>(500)[0]
    } else {
        header.bytes[123]
    };
    let mm = match units & 7 {
        1 => 1000.0,
        3 => 0.001,
        _ => 1.0,
    };
    let (spacing, notices) = spacing(header);
    // A picture's thickness may not be stated, whatever its matrix holds.
    let rank = header.integer(40, 16, 8);
    let stated = [0, 1, 2].map(|axis| {
        let length = header.pixdim(axis + 1);
        (axis as i64) < rank || length.is_finite() && length != 0.0
    });
    header.warnings.extend(choice.spacing_notice(stated));
    let lps_from_ras = DAffine3::from_scale(DVec3::new(-1.0, -1.0, 1.0) * mm);
    if header.version == Version::Analyze {
        header.warnings.extend(notices);
        return analyze(header, spacing, size);
    }
    let usable =
        |t: &DAffine3| t.is_finite() && t.matrix3.determinant().abs() > 1e-12 * spacing.element_product();
    let (sform, qform) = (sform(header), qform(header, spacing));
    let stated = sform.is_some() || qform.is_some();
    let (usable_sform, usable_qform) = (sform.filter(&usable), qform.filter(&usable));
    if sform.is_some() && usable_sform.is_none() {
        header
            .warnings
            .push("its sform is singular or not finite and is ignored".into());
    }
    if let (Some(s), Some(q)) = (usable_sform, usable_qform) {
        compare(header, &s, &q, size);
    } else if usable_sform.is_none() {
        header.warnings.extend(notices);
    }
    let ras_from_voxel = usable_sform.or(usable_qform).unwrap_or_else(|| {
        let why = if stated {
            "no usable orientation"
        } else {
            "no orientation"
        };
        header
            .warnings
            .push(format!("has {why}: right, anterior, superior axes are assumed"));
        DAffine3::from_scale(spacing)
    });
    let world_from_voxel = lps_from_ras * ras_from_voxel;
    if source::usable(&world_from_voxel) {
        return world_from_voxel;
    }
    header
        .warnings
        .push("has an unusable geometry; 1 mm voxels along right, anterior, superior are assumed".into());
    DAffine3::from_scale(DVec3::new(-1.0, -1.0, 1.0))
}

/// The distances between voxels, and notices about those that are not usable.
fn spacing(header: &Header) -> (DVec3, Vec<String>) {
    let rank = header.integer(40, 16, 8);
    let (mut spacing, mut notices) = (DVec3::ONE, Vec::new());
    for axis in 0..3 {
        let s = header.pixdim(axis + 1);
        if s.is_finite() && s != 0.0 {
            spacing[axis] = s.abs();
        } else if (axis as i64) < rank {
            notices.push(format!(
                "its spacing along axis {} is {s}; 1 mm is used",
                axis + 1
            ));
        }
    }
    (spacing, notices)
}

/// Analyze states neither left and right nor a position; SPM writes the voxel at the origin,
/// counted from 1, in the field `originator`, and takes the image's centre without it. The same
/// voxels count as plausible as in nibabel.
fn analyze(header: &mut Header, spacing: DVec3, size: [usize; 3]) -> DAffine3 {
    header.warnings.push("is in Analyze format, which does not state left and right; its first axis is assumed to run from right to left".into());
    let ras_from_centered = DAffine3::from_scale(spacing * DVec3::new(-1.0, 1.0, 1.0));
    let lps_from_ras = DAffine3::from_scale(DVec3::new(-1.0, -1.0, 1.0));
    let origin = [0, 1, 2].map(|n| i64::from(i16::from_le_bytes(header.field(253 + 2 * n))));
    let plausible = origin
        .iter()
        .zip(size)
        .all(|(&o, n)| o > -(n as i64) && o < 2 * n as i64);
    let first = if origin != [0; 3] && plausible {
        DVec3::from_array(origin.map(|o| 1.0 - o as f64))
    } else {
        header
            .warnings
            .push("states no position; the centre of the image is placed at the origin, as in SPM".into());
        DVec3::from_array(size.map(|n| (1.0 - n as f64) / 2.0))
    };
    lps_from_ras * ras_from_centered * DAffine3::from_translation(first)
}

/// RAS from voxel by "METHOD 3".
fn sform(header: &Header) -> Option<DAffine3> {
    if header.integer(254, 348, 4) <= 0 {
        return None;
    }
    let row = |n: usize| [0, 1, 2, 3].map(|c| header.number(280, 400, 4 * n + c));
    let r = [row(0), row(1), row(2)];
    let column = |c: usize| DVec3::new(r[0][c], r[1][c], r[2][c]);
    Some(DAffine3 {
        matrix3: DMat3::from_cols(column(0), column(1), column(2)),
        translation: column(3),
    })
}

/// RAS from voxel by "METHOD 2".
fn qform(header: &mut Header, spacing: DVec3) -> Option<DAffine3> {
    if header.integer(252, 344, 4) <= 0 {
        return None;
    }
    let quaternion = |n: usize| header.number(256, 352, n);
    let (b, c, d) = (quaternion(0), quaternion(1), quaternion(2));
    let translation = DVec3::new(quaternion(3), quaternion(4), quaternion(5));
    let squares = b * b + c * c + d * d;
    let a = (1.0 - squares).max(0.0).sqrt();
    let rotation = DMat3::from_quat(DQuat::from_xyzw(b, c, d, a).normalize());
    let handedness = if header.pixdim(0) < 0.0 { -1.0 } else { 1.0 };
    if squares > 1.0 + 1e-5 {
        header.warnings.push(format!(
            "its qform has a quaternion of length {:.4}, which is not a rotation; it is normalised",
            squares.sqrt()
        ));
    }
    Some(DAffine3 {
        matrix3: rotation * DMat3::from_diagonal(spacing * DVec3::new(1.0, 1.0, handedness)),
        translation,
    })
}

/// Adds a notice if sform and qform place any voxel more than half a voxel apart.
fn compare(header: &mut Header, sform: &DAffine3, qform: &DAffine3, size: [usize; 3]) {
    let last = DVec3::from_array(size.map(|n| n as f64 - 1.0));
    let apart = (0..8)
        .map(|n| {
            let corner = DVec3::from_array(std::array::from_fn(|a| last[a] * f64::from(n >> a & 1)));
            sform
                .transform_point3(corner)
                .distance(qform.transform_point3(corner))
        })
        .fold(0.0, f64::max);
    let m = sform.matrix3;
    let half = 0.5
        * [m.x_axis, m.y_axis, m.z_axis]
            .map(|c| c.length())
            .into_iter()
            .fold(f64::MAX, f64::min);
    if apart > half {
        header.warnings.push(format!(
            "its sform and qform place voxels up to {apart:.1} units apart; the sform is used"
        ));
    }
}
