//! Readers against other programs, against each other, and against damage. What peers read is in `fixtures/readers`, made by `make.py` there.

use glam::{DAffine3, DMat3, DVec3};
use incise::volume::load::{self, ReadOptions};
use incise::volume::save::{Content, Format, Writer};
use incise::volume::{GridGeometry, Rescale, Volume};
use incise::{Error, Watch};
use serde_json::Value;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

pub fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/readers")
}

fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !path.exists() {
        println!("{name} is not here: it was not checked");
    }
    path.exists().then_some(path)
}

fn json(name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(fixtures().join(name)).unwrap()).unwrap()
}

pub fn read(path: &Path, choice: &ReadOptions) -> incise::Result<Volume> {
    load::volume(path, choice, &Watch::NONE)
}

fn incise(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_incise")).args(arguments).env_remove("DISPLAY").output().unwrap()
}

fn vector(v: &Value) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|n| v[n].as_f64().unwrap()))
}

/// Largest difference of two affines over a grid's corners, mm.
fn apart(a: &DAffine3, b: &DAffine3, size: [usize; 3]) -> f64 {
    let corner = |n: usize| DVec3::from_array(std::array::from_fn(|c| if n >> c & 1 == 1 { (size[c] - 1) as f64 } else { 0.0 }));
    (0..8).map(|n| (a.transform_point3(corner(n)) - b.transform_point3(corner(n))).length()).fold(0.0, f64::max)
}

/// One phantom as SimpleITK, nibabel, pynrrd, VTK, tifffile, Pillow, NumPy, Zarr and pydicom write it.
pub fn one_phantom_in_every_format() {
    let phantom_json = json("phantom.json");
    let size: [usize; 3] = std::array::from_fn(|n| phantom_json["size"][n].as_u64().unwrap() as usize);
    let values: Vec<f64> = phantom_json["values"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let spacing = vector(&phantom_json["spacing_mm"]);
    let rows: [DVec3; 3] = std::array::from_fn(|r| vector(&phantom_json["direction"][r]));
    let direction = DMat3::from_cols(rows[0], rows[1], rows[2]).transpose();
    let whole = DAffine3 { matrix3: direction * DMat3::from_diagonal(spacing), translation: vector(&phantom_json["origin_mm"]) };
    let files = phantom_json["files"].as_object().unwrap();
    for (name, file) in files {
        let choice = ReadOptions { time: file["time"].as_u64().map(|t| t as usize), ..ReadOptions::default() };
        let v = read(&fixtures().join("phantom").join(name), &choice).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(v.size, size, "{name}");
        let (added, modulo) = (file["added"].as_f64().unwrap_or(0.0), file["modulo"].as_f64().unwrap_or(0.0));
        let (slope, intercept) = (file["rescale"][0].as_f64().unwrap_or(1.0), file["rescale"][1].as_f64().unwrap_or(0.0));
        for (n, value) in values.iter().enumerate() {
            let stored = value + added;
            let want = if modulo > 0.0 { stored.rem_euclid(modulo) } else { stored } * slope + intercept;
            let (i, j, k) = (n % size[0], n / size[0] % size[1], n / size[0] / size[1]);
            assert_eq!(v.value(i, j, k), want, "{name} at {i} {j} {k}");
        }
        let kept = file["type"].as_str().unwrap_or("i16");
        assert_eq!(v.voxels.type_name(), kept, "{name}");
        let want = match file["states"].as_str().unwrap() {
            "all" => whole,
            "axes" => DAffine3 { matrix3: DMat3::from_diagonal(spacing), ..whole },
            "spacing" => DAffine3::from_scale(spacing),
            _ => DAffine3::IDENTITY,
        };
        let off = apart(&v.world_from_voxel, &want, size);
        assert!(off < 1e-4, "{name}: {off} mm off");
        assert_eq!(
            v.warnings.iter().any(|w| w.contains("1 mm is assumed")),
            file["states"] == "nothing" && !name.ends_with(".raw"),
            "{name}: {:?}",
            v.warnings
        );
    }
    println!("{} files of one phantom are equal, geometry to 1e-4 mm where the format states it", files.len());
}

/// The stored bytes of a volume or image, least significant first.
fn crc<D: ndarray::Dimension>(voxels: &incise::volume::TypedArray<D>) -> u32 {
    use incise::math::flat;
    use incise::volume::TypedArray as V;
    let mut crc = flate2::Crc::new();
    macro_rules! sum {
        ($($variant:ident),*) => {
            match voxels {
                $(V::$variant(v) => flat(v).chunks(4096).for_each(|c| crc.update(&c.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>())),)*
            }
        };
    }
    sum!(U8, I8, U16, I16, U32, I32, U64, I64, F32, F64);
    crc.sum()
}

/// Scans as nibabel, SimpleITK, VTK and pydicom read them: lossless ones bit for bit.
pub fn scans_are_what_peers_read() {
    let Some(folder) = shared("dicom") else { return };
    let folder = folder.parent().unwrap().to_owned();
    let expected = json("expected.json");
    let (mut exact, mut lossy) = (0, 0);
    for (name, want) in expected.as_object().unwrap() {
        let image = match load::image(&folder.join(name), &ReadOptions::default(), &Watch::NONE) {
            Ok(image) => image,
            Err(e) => {
                // What cannot be decoded is named: JPEG-LS without its feature, and lossy JPEG of 12 bits.
                let text = e.to_string();
                let jpeg_ls = text.contains("JPEG-LS") && text.contains("feature jpeg-ls") && !cfg!(feature = "jpeg-ls");
                assert!(jpeg_ls || text.contains("12-bit lossy JPEG"), "{text}");
                continue;
            }
        };
        assert_eq!(serde_json::json!(image.size), want["size"], "{name}");
        assert_eq!((image.rescale.slope, image.rescale.intercept), (want["slope"].as_f64().unwrap(), want["intercept"].as_f64().unwrap()), "{name}");
        if want["affine"].is_array() {
            let row = |r: usize| -> [f64; 4] { std::array::from_fn(|c| want["affine"][r][c].as_f64().unwrap()) };
            let [x, y, z] = [row(0), row(1), row(2)];
            let column = |c: usize| DVec3::new(x[c], y[c], z[c]);
            let affine = DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) };
            let off = apart(&image.world_from_voxel, &affine, image.size);
            assert!(off < 1e-4, "{name}: {off} mm off");
        }
        if want["lossy"].is_string() {
            lossy += 1;
            for sample in want["samples"].as_array().unwrap() {
                let (n, value) = (sample[0].as_u64().unwrap() as usize, sample[1].as_f64().unwrap());
                // Decoders may round an inverse cosine or wavelet transform differently.
                assert!((image.voxels.get(n) - value).abs() <= 2.0, "{name} at {n}: {} for {value}", image.voxels.get(n));
            }
            continue;
        }
        exact += 1;
        assert_eq!(image.voxels.type_name(), want["type"].as_str().unwrap(), "{name}");
        assert_eq!(u64::from(crc(&image.voxels)), want["crc32"].as_u64().unwrap(), "{name}");
    }
    println!("{exact} files equal bit for bit, {lossy} lossy ones within 2 of the stored values");
    assert!(exact >= 30 && lossy >= 2, "{exact} {lossy}");
    // One thorax twice: the same voxels; the VTI cannot say that two of its axes are turned.
    let [mha, vti] = ["ct/LIDC2_thorax.mha", "ct/LIDC2_thorax.vti"].map(|n| read(&folder.join(n), &ReadOptions::default()).unwrap());
    assert_eq!(crc(&mha.voxels), crc(&vti.voxels));
    assert!((mha.spacing_mm() - vti.spacing_mm()).abs().max_element() < 1e-9);
    assert!(vti.warnings.iter().any(|w| w.contains("does not state its patient orientation")) && mha.warnings.is_empty());
    // Every file of these folders opens or was named above.
    for sub in ["ct", "mri", "labels", "rgb", "dicom/ct_all_syntaxes", "dicom/misc"] {
        for entry in std::fs::read_dir(folder.join(sub)).unwrap().flatten() {
            if let Err(e) = read(&entry.path(), &ReadOptions::default()) {
                let text = e.to_string();
                assert!(text.contains("JPEG-LS") || text.contains("12-bit lossy JPEG"), "{text}");
                println!("refused: {}", text.replace(&*folder.to_string_lossy(), ""));
            }
        }
    }
}

/// Unpacks one of the shared series.
fn series(name: &str) -> Option<tempfile::TempDir> {
    let archive = shared(&format!("dicom/dcm_qa_ct_{name}_28slices.tar.xz"))?;
    let folder = tempfile::tempdir().unwrap();
    let done = Command::new("tar").arg("xJf").arg(&archive).arg("-C").arg(folder.path()).status();
    if !done.is_ok_and(|s| s.success()) {
        println!("tar and xz are not here: {name} was not checked");
        return None;
    }
    Some(folder)
}

/// A head with a tilted gantry and uneven steps, a phantom with even ones.
pub fn real_series_have_their_geometry() {
    let Some(head) = series("GE_head_tilt") else { return };
    let v = read(head.path(), &ReadOptions::default()).unwrap();
    assert_eq!((v.size, v.voxels.type_name()), ([512, 512, 28], "i16"));
    assert!((v.tilt_degrees() - 18.5).abs() < 0.01, "{}", v.tilt_degrees());
    assert!(v.world_from_voxel.matrix3.determinant() > 0.0 && v.orientation() == "LPS");
    let uneven = v.warnings.iter().find(|w| w.contains("slice spacing varies")).unwrap();
    assert!(uneven.contains("1.08 to 7.00") && uneven.contains("misplaces slices by up to"), "{uneven}");
    assert!(v.misplaced.is_some_and(|m| m.resampling_helps && (m.by_mm - 21.61).abs() < 0.01), "{:?}", v.misplaced);
    // Where each slice lies is known: the first and last of the volume are at their places.
    let report: Value = serde_json::from_slice(&incise(&["info", "--json", head.path().to_str().unwrap()]).stdout).unwrap();
    let at: Vec<f64> = report["slice_positions_mm"].as_array().unwrap().iter().map(|p| p.as_f64().unwrap()).collect();
    assert_eq!(at.len(), 28);
    assert!((report["tilt_degrees"].as_f64().unwrap() - 18.5).abs() < 0.01);
    let even = read(head.path(), &ReadOptions { resample: true, ..ReadOptions::default() }).unwrap();
    let normal = v.world_from_voxel.matrix3.x_axis.cross(v.world_from_voxel.matrix3.y_axis).normalize();
    let step = even.world_from_voxel.matrix3.z_axis.dot(normal);
    // The report rounds to a tenth of a micrometre.
    assert!((step * (even.size[2] - 1) as f64 - (at[27] - at[0])).abs() < 1e-3 && even.size[2] > 28);
    assert!(even.misplaced.is_none() && !even.warnings.iter().any(|w| w.contains("misplaces") || w.contains("offset by")), "{:?}", even.warnings);
    // A slice that lies on the even grid is kept as it was.
    for k in [0usize, 27] {
        let to = if k == 0 { 0 } else { even.size[2] - 1 };
        assert!((0..512).step_by(7).all(|j| (0..512).step_by(7).all(|i| even.value(i, j, to) == v.value(i, j, k))));
    }
    let between = (0..even.size[2]).find(|&k| (k as f64 * step + at[0] - 0.5 * (at[13] + at[14])).abs() < 0.3 * step).unwrap();
    let share = (between as f64 * step + at[0] - at[13]) / (at[14] - at[13]);
    for (i, j) in [(256, 256), (200, 300), (310, 222)] {
        let want = v.value(i, j, 13) * (1.0 - share) + v.value(i, j, 14) * share;
        assert!((even.value(i, j, between) - want).abs() <= 0.5 + 1e-6, "{i} {j}");
    }
    let Some(phantom) = series("Philips_phantom") else { return };
    let v = read(phantom.path(), &ReadOptions::default()).unwrap();
    assert!((v.spacing_mm() - DVec3::new(0.451171875, 0.451171875, 5.0)).abs().max_element() < 1e-4 && v.tilt_degrees() < 0.01);
    assert!(v.warnings.is_empty(), "{:?}", v.warnings);
    println!("tilt 18.5 degrees kept as a shear; 28 uneven slices are {} even ones when asked", even.size[2]);
}

/// The signed permutations of three axes.
fn orientations() -> Vec<DMat3> {
    let mut all = Vec::new();
    for [a, b, c] in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
        for signs in 0..8 {
            let axis = |n: usize, bit: usize| DVec3::AXES[n] * if signs >> bit & 1 == 1 { -1.0 } else { 1.0 };
            all.push(DMat3::from_cols(axis(a, 0), axis(b, 1), axis(c, 2)));
        }
    }
    all
}

/// A value that every point of the world has, whole and within 16 bits.
fn world_value(p: DVec3) -> i16 {
    (p.x * 2.0 + p.y * 11.0 - p.z * 37.0).round() as i16
}

/// A grid of one box of the world in some orientation, and its values.
fn oriented(direction: &DMat3) -> (GridGeometry, Vec<i16>) {
    let (low, spacing, extent) = (DVec3::new(-12.0, 31.0, 8.0), DVec3::new(1.5, 2.0, 3.0), [5usize, 6, 7]);
    let axis = |n: usize| (0..3).find(|&w| direction.col(n)[w] != 0.0).unwrap();
    let size: [usize; 3] = std::array::from_fn(|n| extent[axis(n)]);
    let mut origin = low;
    let mut linear = DMat3::ZERO;
    for n in 0..3 {
        let world = axis(n);
        *linear.col_mut(n) = direction.col(n) * spacing[world];
        if direction.col(n)[world] < 0.0 {
            origin[world] += spacing[world] * (extent[world] - 1) as f64;
        }
    }
    let grid = GridGeometry { size, world_from_voxel: DAffine3 { matrix3: linear, translation: origin } };
    let value = |n: usize| {
        let p = DVec3::new((n % size[0]) as f64, (n / size[0] % size[1]) as f64, (n / size[0] / size[1]) as f64);
        world_value(grid.world_from_voxel.transform_point3(p))
    };
    let values = (0..size.iter().product()).map(value).collect();
    (grid, values)
}

/// Whether a volume has the world's values at the world's places.
fn is_the_world(v: &Volume, what: &str) {
    assert_eq!(v.voxels.len(), 5 * 6 * 7, "{what}");
    for n in 0..v.voxels.len() {
        let (i, j, k) = (n % v.size[0], n / v.size[0] % v.size[1], n / v.size[0] / v.size[1]);
        let p = v.world_from_voxel.transform_point3(DVec3::new(i as f64, j as f64, k as f64));
        let want = p.x * 2.0 + p.y * 11.0 - p.z * 37.0;
        assert!((v.value(i, j, k) - want).abs() < 1e-3, "{what} at {p}: {} for {want}", v.value(i, j, k));
    }
}

/// 48 orientations of one phantom in every format that states them are the same world; DICOM, whose slices make right-handed stacks, in 24.
pub fn orientations_are_one_world() {
    let folder = tempfile::tempdir().unwrap();
    let mut count = 0;
    for (n, direction) in orientations().iter().enumerate() {
        let (grid, values) = oriented(direction);
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let content = Content::Scalar(load::ScalarType::I16, Rescale::NONE);
        for ending in ["nii", "nii.gz", "nrrd", "mha", "vti"] {
            let path = folder.path().join(format!("{n}.{ending}"));
            let mut writer = Writer::new(std::fs::File::create(&path).unwrap(), Format::of(&path).unwrap(), &grid, content).unwrap();
            writer.push(&bytes).unwrap();
            writer.finish().unwrap().flush().unwrap();
            let v = read(&path, &ReadOptions::default()).unwrap();
            assert!(apart(&v.world_from_voxel, &grid.world_from_voxel, grid.size) < 1e-6 * 50.0, "{ending} {n}");
            is_the_world(&v, &format!("{ending}, orientation {n}"));
            let letters = v.orientation();
            for (axis, letter) in letters.chars().enumerate() {
                let positive = "LPS".contains(letter);
                let world = "LRPASI".find(letter).unwrap() / 2;
                assert_eq!(direction.col(axis)[world], if positive { 1.0 } else { -1.0 }, "{letters}");
            }
            count += 1;
        }
        if direction.determinant() > 0.0 {
            let series = folder.path().join(format!("dicom{n}"));
            dicom::write(&series, &grid, &values);
            let v = read(&series, &ReadOptions::default()).unwrap();
            let off = apart(&v.world_from_voxel, &grid.world_from_voxel, grid.size);
            assert!(off < 1e-6, "DICOM {n}: {off} mm off: {:?} {:?}", v.world_from_voxel, grid.world_from_voxel);
            is_the_world(&v, &format!("DICOM, orientation {n}"));
            count += 1;
        }
    }
    println!("{count} files are one world");
    assert_eq!(count, 5 * 48 + 24);
}

pub mod dicom {
    //! A series written slice by slice, in no order.
    use super::*;
    use dicom_core::value::{DataSetSequence, PrimitiveValue};
    use dicom_core::{DataElement, Tag, VR};
    use dicom_dictionary_std::tags;
    use dicom_object::{FileMetaTableBuilder, InMemDicomObject};

    pub fn write(folder: &Path, grid: &GridGeometry, values: &[i16]) {
        std::fs::create_dir_all(folder).unwrap();
        let m = grid.world_from_voxel.matrix3;
        let [nx, ny, nz] = grid.size;
        for k in 0..nz {
            let texts = |v: &[f64]| {
                v.iter().map(|x| format!("{x:.10}").trim_end_matches('0').trim_end_matches('.').to_owned()).collect::<Vec<_>>().join("\\")
            };
            let (x, y) = (m.x_axis.normalize(), m.y_axis.normalize());
            let position = grid.world_from_voxel.transform_point3(DVec3::new(0.0, 0.0, k as f64));
            let text = |tag: Tag, vr: VR, value: &str| DataElement::new(tag, vr, PrimitiveValue::from(value));
            let short = |tag: Tag, value: u16| DataElement::new(tag, VR::US, PrimitiveValue::from(value));
            let plane = &values[k * nx * ny..(k + 1) * nx * ny];
            // An icon has pixels of its own, before those of the picture.
            let icon = InMemDicomObject::from_element_iter([
                short(tags::ROWS, 1),
                short(tags::COLUMNS, 2),
                DataElement::new(tags::PIXEL_DATA, VR::OB, PrimitiveValue::U8(vec![7u8, 9].into())),
            ]);
            let set = InMemDicomObject::from_element_iter([
                DataElement::new(tags::ICON_IMAGE_SEQUENCE, VR::SQ, DataSetSequence::from(vec![icon])),
                text(tags::SOP_CLASS_UID, VR::UI, "1.2.840.10008.5.1.4.1.1.2"),
                text(tags::SOP_INSTANCE_UID, VR::UI, &format!("1.2.3.{k}")),
                text(tags::MODALITY, VR::CS, "CT"),
                text(tags::SERIES_INSTANCE_UID, VR::UI, "1.2.3"),
                text(tags::INSTANCE_NUMBER, VR::IS, &format!("{}", (k * 3) % nz)),
                text(tags::IMAGE_POSITION_PATIENT, VR::DS, &texts(&position.to_array())),
                text(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, &texts(&[x.x, x.y, x.z, y.x, y.y, y.z])),
                short(tags::SAMPLES_PER_PIXEL, 1),
                text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
                short(tags::ROWS, ny as u16),
                short(tags::COLUMNS, nx as u16),
                text(tags::PIXEL_SPACING, VR::DS, &texts(&[m.y_axis.length(), m.x_axis.length()])),
                short(tags::BITS_ALLOCATED, 16),
                short(tags::BITS_STORED, 16),
                short(tags::HIGH_BIT, 15),
                short(tags::PIXEL_REPRESENTATION, 1),
                DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(plane.iter().map(|v| *v as u16).collect())),
            ]);
            let meta = FileMetaTableBuilder::new().transfer_syntax("1.2.840.10008.1.2.1");
            set.with_meta(meta).unwrap().write_to_file(folder.join(format!("{}.dcm", nz - k))).unwrap();
        }
    }
}

/// Several series in one folder: listed, the largest taken, another one chosen; and no patient's name unless asked for.
pub fn series_are_listed_and_chosen() {
    let folder = fixtures().join("phantom/dicom-mixed");
    let path = folder.to_str().unwrap();
    let output = incise(&["info", "--json", path]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(!text.contains("Never") && !text.contains("SECRET"), "{text}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["all_series"].as_array().unwrap().len(), 2);
    assert_eq!(report["all_series"][1]["size"], serde_json::json!([7, 6, 3]));
    assert!(report["warnings"][0].as_str().unwrap().contains("holds 2 series; the largest is used"));
    assert!(String::from_utf8_lossy(&incise(&["info", "--json", "--patient", path]).stdout).contains("Never^Shown"));
    for (wanted, slices) in [("2", 3), ("series 3", 3), ("SERIES 2", 5), ("1.2.826.0.1.3680043.10.543.7.3", 3)] {
        let v = read(&folder, &ReadOptions { series: Some(wanted.into()), ..ReadOptions::default() }).unwrap();
        assert_eq!(v.size[2], slices, "{wanted}");
    }
    for wanted in ["3", "0", "nothing"] {
        let e = read(&folder, &ReadOptions { series: Some(wanted.into()), ..ReadOptions::default() }).unwrap_err().to_string();
        assert!(e.starts_with("series: ") && e.contains("series 2") && e.contains("series 3"), "{e}");
    }
    let out = tempfile::tempdir().unwrap();
    let picture = out.path().join("a.png");
    let output = incise(&["render", path, "-o", picture.to_str().unwrap(), "--backend", "cpu", "--size", "8x8"]);
    assert!(output.status.success() && String::from_utf8_lossy(&output.stderr).contains("the largest is used"));
    // A slice less: said with its place, and filled in when asked.
    for n in 0..5 {
        let name = format!("{n}-1.dcm");
        std::fs::copy(fixtures().join("phantom/dicom-explicit").join(&name), out.path().join(&name)).unwrap();
    }
    let whole = read(out.path(), &ReadOptions::default()).unwrap();
    // The third file of five in the order of their names is slice 4; slice 2 is another.
    std::fs::remove_file(out.path().join("1-1.dcm")).unwrap();
    let less = read(out.path(), &ReadOptions::default()).unwrap();
    assert_eq!(less.size[2], 4);
    assert!(less.warnings.iter().any(|w| w.contains("1 slice is missing at")), "{:?}", less.warnings);
    let filled = read(out.path(), &ReadOptions { resample: true, ..ReadOptions::default() }).unwrap();
    assert_eq!(filled.size, whole.size);
    assert!(apart(&filled.world_from_voxel, &whole.world_from_voxel, whole.size) < 1e-6);
    // The zip, and the file that lists a folder.
    std::fs::write(out.path().join("DICOMDIR"), b"").unwrap();
    assert_eq!(read(&out.path().join("DICOMDIR"), &ReadOptions::default()).unwrap().size[2], 4);
}

/// Loads stop when told to, tell how far they are, and never go back.
pub fn loads_are_watched() {
    for name in ["itk-gzip.nrrd", "dicom-explicit", "blosc-04.zarr", "pngs", "lzw.tif", "vtk-appended-zlib-64-raw.vti"] {
        let path = fixtures().join("phantom").join(name);
        let seen = Mutex::new(Vec::new());
        let progress = |share: f32| seen.lock().unwrap().push(share);
        load::volume(&path, &ReadOptions::default(), &Watch::reporting(&progress)).unwrap();
        let seen = seen.into_inner().unwrap();
        assert!(!seen.is_empty() && seen.iter().all(|s| (0.0..=1.0).contains(s)) && seen.last().is_some_and(|s| *s > 0.99), "{name}: {seen:?}");
        let cancel = AtomicBool::new(true);
        let result = load::volume(&path, &ReadOptions::default(), &Watch { progress: &|_| (), cancel: &cancel });
        assert!(matches!(result, Err(Error::Cancelled)), "{name}");
    }
}

/// Colours, channels, labels and vectors.
pub fn several_values_per_voxel() {
    let folder = tempfile::tempdir().unwrap();
    let raw = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let layout = |text: &str| ReadOptions { raw: Some(load::RawLayout::parse(text).unwrap()), ..ReadOptions::default() };
    let rgb = raw("rgb.raw", &[255, 0, 0, 0, 255, 0, 0, 0, 0, 255, 255, 255]);
    let v = read(&rgb, &layout("4x1x1:u8:components=3")).unwrap();
    assert_eq!((v.components, [0, 1, 2, 3].map(|n| v.voxels.get(n))), (3, [53.0, 182.0, 0.0, 255.0]));
    assert!(v.colors.is_some());
    let red = ReadOptions { channel: Some(1), ..layout("4x1x1:u8:components=3") };
    let v = read(&rgb, &red).unwrap();
    assert_eq!([0, 1, 2, 3].map(|n| v.voxels.get(n)), [255.0, 0.0, 0.0, 255.0]);
    assert!(v.colors.is_none());
    assert!(read(&rgb, &ReadOptions { channel: Some(4), ..red }).unwrap_err().to_string().contains("channel: 4 is out of range; the file has 3"));
    // Two channels: green and magenta, each over its own range.
    let two = raw("two.raw", &[0, 0, 100, 0, 0, 50, 100, 50]);
    let v = read(&two, &layout("4x1x1:u8:components=2")).unwrap();
    assert_eq!([0, 1, 2, 3].map(|n| v.voxels.get(n)), [0.0, 255.0, 255.0, 255.0]);
    assert_eq!(v.colors.unwrap().rgba8(0..4), [[0, 0, 0, 255], [0, 255, 0, 255], [255, 0, 255, 255], [255, 255, 255, 255]]);
    let five = raw("five.raw", &[0; 5]);
    assert!(read(&five, &layout("1x1x1:u8:components=5")).unwrap_err().to_string().contains("choose one with --channel (1 to 5)"));
    // Labels that a segmentation names and colours.
    let header = "NRRD0004\ntype: uchar\ndimension: 3\nspace: LPS\nsizes: 2 1 1\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nencoding: raw\nendian: little\nSegment0_LabelValue:=7\nSegment0_Name:=liver\nSegment0_Color:=1 0.5 0\n\n";
    let path = raw("a.seg.nrrd", &[header.as_bytes(), &[7, 0]].concat());
    let v = read(&path, &ReadOptions::default()).unwrap();
    assert_eq!((v.labels(), v.label_table[0].name.as_str(), v.label_table[0].color), (Some(1), "liver", Some([255, 128, 0])));
    let liver = fixtures().join("liver.dcm");
    let v = read(&liver, &ReadOptions::default()).unwrap();
    assert_eq!((v.labels(), v.size), (Some(1), [512, 512, 3]));
    assert_eq!(v.label_table[0].name, "Liver");
}

/// A volume of a gigabyte renders on the CPU within four, and loads within little more than itself.
pub fn a_gigabyte_needs_little_more() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("big.raw");
    let edge = 1024u64;
    let file = std::fs::File::create(&path).unwrap();
    file.set_len(edge * edge * edge).unwrap();
    // A block of matter in the middle of a hole in the file.
    {
        use std::io::{Seek, SeekFrom};
        let mut file = &file;
        for k in 480..544 {
            for j in 480..544 {
                file.seek(SeekFrom::Start((k * edge + j) * edge + 480)).unwrap();
                file.write_all(&[200u8; 64]).unwrap();
            }
        }
    }
    let picture = folder.path().join("big.png");
    let output = incise(&[
        "render",
        path.to_str().unwrap(),
        "--raw",
        "1024x1024x1024:u8",
        "-o",
        picture.to_str().unwrap(),
        "--backend",
        "cpu",
        "--size",
        "64x64",
        "--stats",
        "-",
        "--preset",
        "mr-default",
    ]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let peak = report["peak_memory_bytes"].as_f64().unwrap();
    let voxels = (edge * edge * edge) as f64;
    println!("1024^3 u8: peak {:.2} GiB, {:.2} of the voxels", peak / f64::from(1 << 30), peak / voxels);
    assert!(peak < 2.2 * voxels + 200e6 && peak < 4.0 * f64::from(1 << 30));
    let image = image::open(&picture).unwrap().to_rgb8();
    let differs = image.pixels().filter(|p| **p != *image.get_pixel(0, 0)).count();
    assert!((4..800).contains(&differs), "{differs} pixels show the block");
}
