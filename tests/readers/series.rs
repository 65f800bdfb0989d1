//! Folders of DICOM series: geometry, choice of a series, missing slices.

use super::{apart, fixtures, read, shared};
use glam::DVec3;
use incise::volume::load::ReadOptions;
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// Unpacks one of the shared series.
fn series(name: &str) -> Option<tempfile::TempDir> {
    let archive = shared(&format!("dicom/dcm_qa_ct_{name}_28slices.tar.xz"))?;
    let folder = tempfile::tempdir().unwrap();
    let done = Command::new("tar")
        .arg("xJf")
        .arg(&archive)
        .arg("-C")
        .arg(folder.path())
        .status();
    if !done.is_ok_and(|s| s.success()) {
        println!("tar and xz are not here: {name} was not checked");
        return None;
    }
    Some(folder)
}

/// A head with a tilted gantry and uneven steps, a phantom with even ones.
pub fn real_series_have_their_geometry() {
    let Some(head) = series("GE_head_tilt") else {
        return;
    };
    let v = read(head.path(), &ReadOptions::default()).unwrap();
    assert_eq!((v.size, v.voxels.type_name()), ([512, 512, 28], "i16"));
    assert!((v.tilt_degrees() - 18.5).abs() < 0.01, "{}", v.tilt_degrees());
    assert!(v.world_from_voxel.matrix3.determinant() > 0.0 && v.orientation() == "LPS");
    let uneven = v
        .warnings
        .iter()
        .find(|w| w.contains("slice spacing varies"))
        .unwrap();
    assert!(
        uneven.contains("1.08 to 7.00") && uneven.contains("misplaces slices by up to"),
        "{uneven}"
    );
    assert!(
        v.misplaced
            .is_some_and(|m| m.resampling_helps && (m.by_mm - 21.61).abs() < 0.01),
        "{:?}",
        v.misplaced
    );
    // The slice positions are known: the first and last slices of the volume are at the reported
    // positions.
    let report: Value =
        serde_json::from_slice(&super::incise(&["info", "--json", head.path().to_str().unwrap()]).stdout)
            .unwrap();
    let at: Vec<f64> = report["slice_positions_mm"]
        .as_array()
        .unwrap()
        .iter()
        .map(|p| p.as_f64().unwrap())
        .collect();
    assert_eq!(at.len(), 28);
    assert!((report["tilt_degrees"].as_f64().unwrap() - 18.5).abs() < 0.01);
    let even = read(
        head.path(),
        &ReadOptions {
            resample: true,
            ..ReadOptions::default()
        },
    )
    .unwrap();
    let normal = v
        .world_from_voxel
        .matrix3
        .x_axis
        .cross(v.world_from_voxel.matrix3.y_axis)
        .normalize();
    let step = even.world_from_voxel.matrix3.z_axis.dot(normal);
    // The report rounds to a tenth of a micrometre.
    assert!((step * (even.size[2] - 1) as f64 - (at[27] - at[0])).abs() < 1e-3 && even.size[2] > 28);
    assert!(
        even.misplaced.is_none()
            && !even
                .warnings
                .iter()
                .any(|w| w.contains("misplaces") || w.contains("offset by")),
        "{:?}",
        even.warnings
    );
    // A slice that lies on the even grid is unchanged.
    for k in [0usize, 27] {
        let to = if k == 0 { 0 } else { even.size[2] - 1 };
        assert!((0..512).step_by(7).all(|j| {
            (0..512)
                .step_by(7)
                .all(|i| even.value(i, j, to) == v.value(i, j, k))
        }));
    }
    let between = (0..even.size[2])
        .find(|&k| (k as f64 * step + at[0] - 0.5 * (at[13] + at[14])).abs() < 0.3 * step)
        .unwrap();
    let share = (between as f64 * step + at[0] - at[13]) / (at[14] - at[13]);
    for (i, j) in [(256, 256), (200, 300), (310, 222)] {
        let want = v.value(i, j, 13) * (1.0 - share) + v.value(i, j, 14) * share;
        assert!((even.value(i, j, between) - want).abs() <= 0.5 + 1e-6, "{i} {j}");
    }
    let Some(phantom) = series("Philips_phantom") else {
        return;
    };
    let v = read(phantom.path(), &ReadOptions::default()).unwrap();
    assert!(
        (v.spacing_mm() - DVec3::new(0.451171875, 0.451171875, 5.0))
            .abs()
            .max_element()
            < 1e-4
            && v.tilt_degrees() < 0.01
    );
    assert!(v.warnings.is_empty(), "{:?}", v.warnings);
    println!(
        "tilt 18.5 degrees kept as a shear; 28 uneven slices are {} even ones when asked",
        even.size[2]
    );
}

/// Several series in one folder: listed, the largest loaded by default, another one selectable; no
/// patient name unless requested.
pub fn series_are_listed_and_chosen() {
    let folder = fixtures().join("phantom/dicom-mixed");
    let path = folder.to_str().unwrap();
    let output = super::incise(&["info", "--json", path]);
    let text =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(!text.contains("Never") && !text.contains("SECRET"), "{text}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["all_series"].as_array().unwrap().len(), 2);
    assert_eq!(report["all_series"][1]["size"], serde_json::json!([7, 6, 3]));
    assert!(
        report["warnings"][0]
            .as_str()
            .unwrap()
            .contains("holds 2 series; the largest is used")
    );
    assert!(
        String::from_utf8_lossy(&super::incise(&["info", "--json", "--patient", path]).stdout)
            .contains("Never^Shown")
    );
    for (wanted, slices) in [
        ("2", 3),
        ("series 3", 3),
        ("SERIES 2", 5),
        ("1.2.826.0.1.3680043.10.543.7.3", 3),
    ] {
        let v = read(
            &folder,
            &ReadOptions {
                series: Some(wanted.into()),
                ..ReadOptions::default()
            },
        )
        .unwrap();
        assert_eq!(v.size[2], slices, "{wanted}");
    }
    for wanted in ["3", "0", "nothing"] {
        let e = read(
            &folder,
            &ReadOptions {
                series: Some(wanted.into()),
                ..ReadOptions::default()
            },
        )
        .unwrap_err()
        .to_string();
        assert!(
            e.starts_with("series: ") && e.contains("series 2") && e.contains("series 3"),
            "{e}"
        );
    }
    let out = tempfile::tempdir().unwrap();
    let picture = out.path().join("a.png");
    let output = super::incise(&[
        "render",
        path,
        "-o",
        picture.to_str().unwrap(),
        "--backend",
        "cpu",
        "--size",
        "8x8",
    ]);
    assert!(
        output.status.success() && String::from_utf8_lossy(&output.stderr).contains("the largest is used")
    );
    check_missing_slice(out.path());
}

/// Checks in a folder without series that a missing slice is reported with its position, and
/// interpolated on request.
fn check_missing_slice(folder: &Path) {
    for n in 0..5 {
        let name = format!("{n}-1.dcm");
        std::fs::copy(
            fixtures().join("phantom/dicom-explicit").join(&name),
            folder.join(&name),
        )
        .unwrap();
    }
    let whole = read(folder, &ReadOptions::default()).unwrap();
    // In name order the third of the five files is slice 4; this removes slice 2.
    std::fs::remove_file(folder.join("1-1.dcm")).unwrap();
    let less = read(folder, &ReadOptions::default()).unwrap();
    assert_eq!(less.size[2], 4);
    assert!(
        less.warnings.iter().any(|w| w.contains("1 slice is missing at")),
        "{:?}",
        less.warnings
    );
    let filled = read(
        folder,
        &ReadOptions {
            resample: true,
            ..ReadOptions::default()
        },
    )
    .unwrap();
    assert_eq!(filled.size, whole.size);
    assert!(apart(&filled.world_from_voxel, &whole.world_from_voxel, whole.size) < 1e-6);
    // A DICOMDIR, which lists a folder.
    std::fs::write(folder.join("DICOMDIR"), b"").unwrap();
    assert_eq!(
        read(&folder.join("DICOMDIR"), &ReadOptions::default())
            .unwrap()
            .size[2],
        4
    );
}
