//! DICOM that is written: our reader gets back what was written, nothing about a patient is there
//! unless requested, and the same input gives the same bytes. `faults/check_dicom_out.py`
//! checks the same output with pydicom, highdicom and SimpleITK.

use crate::readers::{apart, incise};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use incise::Watch;
use incise::deform::cut::CutShapes;
use incise::deform::{Stack, StackAndCuts};
use incise::export::bake::{self, BakeOptions};
use incise::files::OutputFolder;
use incise::volume::load::{self, ReadOptions};
use incise::volume::save::dicom::Derivation;
use incise::volume::{Label, Rescale, StoredValues, Volume, Voxels};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Output;

fn succeeds(arguments: &[&str]) -> Output {
    let output = incise(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", message(&output));
    output
}

/// Renders a small picture on the CPU.
fn renders(input: &str, size: &str, more: &[&str], output: &Path) {
    let arguments = [
        "render",
        input,
        "--size",
        size,
        "--backend",
        "cpu",
        "-o",
        text(output),
    ];
    succeeds(&[&arguments[..], more].concat());
}

fn message(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn read(path: &Path) -> Volume {
    load::volume(path, &ReadOptions::default(), &Watch::NONE).unwrap_or_else(|e| panic!("{e}"))
}

/// A DICOM series with the patient Never^Shown and the ID SECRET-ID.
fn series_of_a_patient() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/readers/phantom/dicom-explicit")
}

/// The files of a folder by name.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    std::fs::read_dir(folder)
        .unwrap()
        .flatten()
        .map(|e| {
            let name = e.file_name().to_string_lossy().into_owned();
            (name, std::fs::read(e.path()).unwrap())
        })
        .collect()
}

fn holds(bytes: &[u8], text: &str) -> bool {
    bytes.windows(text.len()).any(|w| w == text.as_bytes())
}

/// A grid that is oblique, tilted (slices are not along their normal) and has three spacings.
fn oblique_and_tilted(handedness: f64) -> DAffine3 {
    let rotation = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::ZYX, 0.3, -0.7, 1.1));
    let tilted = rotation
        * DMat3::from_cols(
            DVec3::new(0.488_281_25, 0.0, 0.0),
            DVec3::new(0.0, 0.7, 0.0),
            DVec3::new(0.123_456_789, -0.45, 2.3 * handedness),
        );
    DAffine3 {
        matrix3: tilted,
        translation: DVec3::new(-123.456_789_012_3, 87.654_321, -1_234.567_890_123),
    }
}

fn volume(
    values: impl Into<StoredValues>,
    rescale: Rescale,
    padding: Option<[f64; 2]>,
    to_world: DAffine3,
) -> Volume {
    Volume::with_padding(Voxels::new([5, 4, 3], values), rescale, to_world, padding)
}

/// Writes a volume without deformation, and reads it back; with the notices.
fn written(folder: &Path, volume: &Volume) -> (Volume, Vec<String>) {
    let (stack, cuts) = (Stack::default(), CutShapes::default());
    let deformation = StackAndCuts {
        stack: &stack,
        cuts: &cuts,
    };
    let derivation = Derivation {
        description: "Nothing was done".into(),
        series_description: "Test".into(),
        origin: None,
        patient: false,
    };
    let notices = OutputFolder::create(folder)
        .and_then(|folder| {
            bake::dicom_series(
                volume,
                &deformation,
                &volume.geometry(),
                folder,
                &derivation,
                &BakeOptions::default(),
            )
        })
        .unwrap_or_else(|e| panic!("{e}"));
    (read(folder), notices)
}

pub fn an_oblique_tilted_grid_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let values: Vec<i16> = (0..60).map(|n| n * 71 - 1024).collect();
    for handedness in [1.0, -1.0] {
        let to_world = oblique_and_tilted(handedness);
        let v = volume(values.clone(), Rescale::NONE, None, to_world);
        let (back, notices) = written(&folder.path().join(format!("out{handedness}")), &v);
        assert!(
            notices.is_empty() && back.warnings.is_empty(),
            "{notices:?} {:?}",
            back.warnings
        );
        assert_eq!((back.size, back.voxels.type_name()), (v.size, "i16"));
        // Readers sort slices along the normal: those of a left-handed grid are reversed.
        let expected = if handedness > 0.0 {
            to_world
        } else {
            to_world
                * DAffine3 {
                    matrix3: DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)),
                    translation: DVec3::new(0.0, 0.0, 2.0),
                }
        };
        let off = apart(&back.world_from_voxel, &expected, v.size);
        assert!(off < 1e-6, "{off} mm off");
        for (n, value) in values.iter().enumerate() {
            let [i, j, k] = [n % 5, n / 5 % 4, n / 20];
            let k = if handedness > 0.0 { k } else { 2 - k };
            assert_eq!(back.value(i, j, k), f64::from(*value));
        }
        println!("geometry off by {off:.1e} mm");
    }
}

pub fn values_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let scaled = |slope: f64, intercept: f64| Rescale { slope, intercept };
    let signed: Vec<i16> = (0..60).map(|n| n * 31 - 900).collect();
    let unsigned: Vec<u16> = (0..60).map(|n| n * 1000 + 17).collect();
    let bytes: Vec<u8> = (0..60).map(|n| n * 4).collect();
    let large: Vec<i32> = (0..60).map(|n| 1_000_000 + 13 * n).collect();
    let whole: Vec<f32> = (0..60).map(|n| (n * n) as f32 - 100.0).collect();
    let padded: Vec<i16> = (0..60).map(|n| if n % 7 == 0 { -2000 } else { n }).collect();
    let all: Vec<(StoredValues, Rescale, Option<[f64; 2]>)> = vec![
        (signed.clone().into(), Rescale::NONE, None),
        (signed.into(), scaled(0.125, -3.5), None),
        (unsigned.clone().into(), scaled(1.0, -1024.0), None),
        (unsigned.into(), scaled(-2.0, 7.0), None),
        (bytes.into(), Rescale::NONE, None),
        (large.into(), scaled(0.5, 0.0), None),
        (whole.into(), Rescale::NONE, None),
        (padded.into(), Rescale::NONE, Some([-2000.0; 2])),
    ];
    for (n, (values, rescale, padding)) in all.into_iter().enumerate() {
        let v = volume(values, rescale, padding, oblique_and_tilted(1.0));
        let (back, notices) = written(&folder.path().join(format!("exact{n}")), &v);
        assert!(notices.is_empty(), "{n}: {notices:?}");
        assert_eq!((back.range, back.padded), (v.range, v.padded), "{n}");
        let ([i, j, k], mut checked) = (v.size, 0);
        for (i, j, k) in (0..i * j * k).map(|n| (n % i, n / i % j, n / i / j)) {
            assert_eq!(back.value(i, j, k), v.value(i, j, k), "{n} at {i} {j} {k}");
            checked += 1;
        }
        assert_eq!(checked, 60);
    }
    // Fractions are rounded, and the notice states by how much.
    let fractions: Vec<f32> = (0..60).map(|n| (n as f32 * 0.37).sin() * 1e-3).collect();
    let v = volume(fractions, Rescale::NONE, None, DAffine3::IDENTITY);
    let (back, notices) = written(&folder.path().join("fractions"), &v);
    let step = (v.range[1] - v.range[0]) / 65_534.0;
    let off = (0..60)
        .map(|n| (back.value(n % 5, n / 5 % 4, n / 20) - v.value(n % 5, n / 5 % 4, n / 20)).abs())
        .fold(0.0, f64::max);
    assert!(off <= 0.5001 * step, "{off} {step}");
    assert!(
        notices.len() == 1 && notices[0].contains("rounded to steps of 3."),
        "{notices:?}"
    );
    // Voxels without a value are padding.
    let holes: Vec<f64> = (0..60)
        .map(|n| if n == 7 { f64::NAN } else { n as f64 / 3.0 })
        .collect();
    let (back, _) = written(
        &folder.path().join("holes"),
        &volume(holes, Rescale::NONE, None, DAffine3::IDENTITY),
    );
    assert_eq!(
        (back.padded, back.is_padding(back.voxels.at([2, 1, 0]))),
        (1, true)
    );
}

pub fn no_patient_without_the_option() {
    let folder = tempfile::tempdir().unwrap();
    let source = series_of_a_patient();
    let at = |name: &str| folder.path().join(name);
    let first = files(&source).into_values().next().unwrap();
    assert!(holds(&first, "Never^Shown") && holds(&first, "SECRET-ID"));
    // Every UID of the source except those of the standard.
    let uids: Vec<String> = first
        .split(|b| !b.is_ascii_digit() && *b != b'.')
        .map(|w| String::from_utf8_lossy(w).into_owned())
        .filter(|w| w.matches('.').count() > 3 && !w.starts_with("1.2.840.10008."))
        .collect();
    assert!(uids.len() > 2, "{uids:?}");
    succeeds(&["bake", text(&source), "-o", text(&at("plain"))]);
    renders(text(&source), "16x16", &[], &at("plain.dcm"));
    let mut plain = files(&at("plain"));
    assert_eq!(plain.len(), files(&source).len());
    plain.insert("picture".into(), std::fs::read(at("plain.dcm")).unwrap());
    for (name, bytes) in &plain {
        for identity in ["Never", "SECRET", text(&source)]
            .into_iter()
            .chain(uids.iter().map(String::as_str))
        {
            assert!(!holds(bytes, identity), "{name} holds {identity}");
        }
    }
    succeeds(&["bake", text(&source), "--patient", "-o", text(&at("named"))]);
    renders(text(&source), "16x16", &["--patient"], &at("named.dcm"));
    let mut named = files(&at("named"));
    named.insert("picture".into(), std::fs::read(at("named.dcm")).unwrap());
    for (name, bytes) in &named {
        assert!(holds(bytes, "Never^Shown") && holds(bytes, "SECRET-ID"), "{name}");
    }
    // The program that reads it does not show the name either.
    let shown = succeeds(&["info", text(&at("named"))]);
    assert!(!holds(&shown.stdout, "Never"));
    for (option, input) in [("bake", "phantom:ball:size=8"), ("render", "phantom:ball:size=8")] {
        let output = incise(&[option, input, "--patient", "-o", text(&at("none.dcm"))]);
        assert!(!output.status.success() && !at("none.dcm").exists(), "{option}");
    }
}

pub fn the_same_input_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let bake = |name: &str, angle: &str| {
        let twist = format!("twist:angle={angle}");
        succeeds(&[
            "bake",
            "phantom:ball:size=16",
            "--deform",
            &twist,
            "-o",
            text(&at(name)),
        ]);
        files(&at(name))
    };
    let (a, b, c) = (bake("a", "40"), bake("b", "40"), bake("c", "41"));
    assert_eq!(a.len(), 16);
    assert!(a == b, "the same input gave other bytes");
    // No UID of one series occurs in another, and no two slices share their own.
    let uids = |files: &BTreeMap<String, Vec<u8>>| -> BTreeMap<String, usize> {
        let mut found = BTreeMap::new();
        for bytes in files.values() {
            let own: std::collections::BTreeSet<String> = bytes[..bytes.len() - 512]
                .windows(44)
                .filter(|w| w.starts_with(b"2.25.") && w[5..].iter().all(u8::is_ascii_digit))
                .map(|w| String::from_utf8_lossy(w).into_owned())
                .collect();
            for uid in own {
                *found.entry(uid).or_default() += 1;
            }
        }
        found
    };
    let (of_a, of_c) = (uids(&a), uids(&c));
    assert_eq!(of_a.values().filter(|n| **n == 1).count(), 16, "{of_a:?}");
    assert_eq!(of_a.values().filter(|n| **n == 16).count(), 3, "{of_a:?}");
    assert!(of_a.keys().all(|uid| !of_c.contains_key(uid)));
    let render = |name: &str| {
        renders("phantom:ball:size=16", "20x10", &[], &at(name));
        std::fs::read(at(name)).unwrap()
    };
    assert!(render("a.dcm") == render("b.dcm"));
}

pub fn a_picture_is_that_of_the_png() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // An odd number of bytes is padded.
    for name in ["p.png", "p.dcm"] {
        renders("phantom:teddy:size=16", "33x21", &[], &at(name));
    }
    let png = image::load_from_memory(&std::fs::read(at("p.png")).unwrap())
        .unwrap()
        .into_rgb8();
    let dicom = read(&at("p.dcm"));
    assert_eq!((dicom.size, dicom.components), ([33, 21, 1], 3));
    let colors = dicom.colors.unwrap().rgba8(0..33 * 21);
    for (n, (pixel, rgba)) in png.pixels().zip(&colors).enumerate() {
        assert_eq!(pixel.0, rgba[..3], "pixel {n}");
    }
    let transparent = incise(&[
        "render",
        "phantom:ball:size=8",
        "--background",
        "transparent",
        "-o",
        text(&at("t.dcm")),
    ]);
    assert!(!transparent.status.success() && message(&transparent).contains("no transparency"));
}

pub fn cuts_are_padding() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let whole = read(Path::new("phantom:ball:size=16"));
    succeeds(&[
        "bake",
        "phantom:ball:size=16",
        "--deform",
        "slab",
        "-o",
        text(&at("cut")),
    ]);
    let cut = read(&at("cut"));
    assert!(
        cut.padded > 0 && cut.padded < cut.voxels.len(),
        "{} padded",
        cut.padded
    );
    assert!(
        cut.range[0] >= whole.range[0],
        "{:?} {:?}",
        cut.range,
        whole.range
    );
    // A fill value is a value.
    succeeds(&[
        "bake",
        "phantom:ball:size=16",
        "--deform",
        "slab",
        "--fill",
        "-300",
        "-o",
        text(&at("filled")),
    ]);
    let filled = read(&at("filled"));
    assert_eq!(filled.padded, 0);
    assert!((filled.range[0] + 300.0).abs() < 1e-9, "{:?}", filled.range);
}

pub fn nothing_is_mixed_or_lost() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    succeeds(&["bake", "phantom:ball:size=8", "-o", text(&at("out"))]);
    let before = files(&at("out"));
    std::fs::write(at("file"), "x").unwrap();
    std::fs::create_dir(at("source")).unwrap();
    for (name, bytes) in files(&series_of_a_patient()) {
        std::fs::write(at("source").join(name), bytes).unwrap();
    }
    let source_files = files(&at("source"));
    let refused = |arguments: &[&str], fragment: &str| {
        let output = incise(arguments);
        let error = message(&output);
        assert!(
            !output.status.success() && error.contains(fragment),
            "{arguments:?}: {error}"
        );
        assert_eq!(error.trim().lines().count(), 1, "{error}");
    };
    let ball = "phantom:ball:size=8";
    refused(&["bake", ball, "-o", text(&at("out"))], "not empty");
    refused(&["bake", ball, "-o", text(&at("file/"))], "");
    refused(&["bake", ball, "-o", text(&at("no/such"))], "does not exist");
    refused(
        &["bake", ball, "--field", "-o", text(&at("field"))],
        "displacement field",
    );
    refused(
        &["bake", ball, "--patient", "-o", text(&at("named"))],
        "has no patient data",
    );
    refused(
        &["bake", ball, "--patient", "-o", text(&at("a.nrrd"))],
        "applies to DICOM",
    );
    refused(
        &["render", ball, "--patient", "-o", text(&at("a.png"))],
        "applies to DICOM",
    );
    let source = at("source");
    refused(
        &["bake", text(&source), "-o", text(&at("source/derived"))],
        "input folder",
    );
    refused(
        &["bake", text(&source), "-o", text(&at("source"))],
        "input folder",
    );
    refused(
        &["render", text(&source), "-o", text(&at("source/a.dcm"))],
        "input folder",
    );
    assert!(files(&at("out")) == before && files(&at("source")) == source_files);
    let mut names: Vec<String> = std::fs::read_dir(folder.path())
        .unwrap()
        .flatten()
        .map(|e| e.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names, ["file", "out", "source"]);
    // An empty folder, and a name with a separator, are filled.
    std::fs::create_dir(at("empty.d")).unwrap();
    succeeds(&["bake", ball, "-o", text(&at("empty.d"))]);
    succeeds(&["bake", ball, "-o", text(&at("new.d/"))]);
    assert_eq!((files(&at("empty.d")).len(), files(&at("new.d")).len()), (8, 8));
}

/// Segments have the labels' order, names and colours, and cover the whole grid.
pub fn label_maps_become_segmentations() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (stack, cuts) = (Stack::default(), CutShapes::default());
    let deformation = StackAndCuts {
        stack: &stack,
        cuts: &cuts,
    };
    let derivation = Derivation {
        description: "Nothing was done".into(),
        series_description: "Labels".into(),
        origin: None,
        patient: false,
    };
    // The first and the last slice are empty; 15 pixels do not fill bytes.
    let grids = [
        (oblique_and_tilted(1.0), vec![1u32, 2, 3]),
        (oblique_and_tilted(1.0), vec![7, 70, 100_000]),
        (DAffine3::IDENTITY, vec![5, 6, 7]),
    ];
    for (n, (to_world, labels)) in grids.into_iter().enumerate() {
        let index = |n: usize| match n / 15 {
            1 => 1 + n % 2,
            3 => 3 * usize::from(n.is_multiple_of(4)),
            _ => 0,
        };
        let values: Vec<u32> = (0..90)
            .map(|n| index(n).checked_sub(1).map_or(0, |l| labels[l]))
            .collect();
        let voxels = Voxels::new([5, 3, 6], values);
        let mut v = Volume::new(voxels, Rescale::NONE, to_world)
            .into_label_map()
            .unwrap();
        v.label_table = vec![Label {
            value: labels[1],
            name: "Große Leber".into(),
            color: Some([200, 30, 77]),
        }];
        let (bytes, notices) =
            bake::dicom_segmentation(&v, &deformation, &v.geometry(), &derivation, &|_| ()).unwrap();
        assert_eq!(notices.len(), usize::from(n > 0), "{notices:?}");
        let path = at(&format!("{n}.dcm"));
        std::fs::write(&path, bytes).unwrap();
        let back = read(&path);
        assert_eq!(
            (back.size, back.labels(), back.declared_labels),
            ([5, 3, 6], Some(3), true)
        );
        assert!(back.warnings.is_empty(), "{:?}", back.warnings);
        let off = apart(&back.world_from_voxel, &to_world, v.size);
        assert!(off < 1e-6, "{off} mm off");
        for voxel in 0..90 {
            assert_eq!(back.voxels.get(voxel), index(voxel) as f64, "{n}: {voxel}");
        }
        let second = back.label_table.iter().find(|l| l.value == 2).unwrap();
        assert_eq!(
            (second.name.as_str(), second.color),
            ("Große Leber", Some([200, 30, 77]))
        );
        let first = back.label_table.iter().find(|l| l.value == 1).unwrap();
        assert_eq!(first.name, format!("Label {}", labels[0]));
    }
    // What is not a label map is refused, and so are options that cannot act.
    let refused = |arguments: &[&str], fragment: &str| {
        let output = incise(arguments);
        assert!(
            !output.status.success() && message(&output).contains(fragment),
            "{}",
            message(&output)
        );
    };
    let source = series_of_a_patient();
    refused(
        &["bake", text(&source), "-o", text(&at("a.dcm"))],
        "not a label map",
    );
    let octants = "phantom:octants:size=8";
    refused(
        &["bake", octants, "--field", "-o", text(&at("a.dcm"))],
        "displacement field",
    );
    refused(
        &["bake", octants, "--fill", "3", "-o", text(&at("a.dcm"))],
        "--fill",
    );
    assert!(!at("a.dcm").exists());
}

pub fn skewed_rows_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let skewed = DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::new(0.3, 1.0, 0.0), DVec3::Z));
    let v = volume(vec![1u8; 60], Rescale::NONE, None, skewed);
    let (stack, cuts) = (Stack::default(), CutShapes::default());
    let deformation = StackAndCuts {
        stack: &stack,
        cuts: &cuts,
    };
    let derivation = Derivation {
        description: String::new(),
        series_description: String::new(),
        origin: None,
        patient: false,
    };
    let path = folder.path().join("out");
    let result = OutputFolder::create(&path).and_then(|f| {
        bake::dicom_series(
            &v,
            &deformation,
            &v.geometry(),
            f,
            &derivation,
            &BakeOptions::default(),
        )
    });
    assert!(result.is_err_and(|e| e.to_string().contains("right angle")));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
