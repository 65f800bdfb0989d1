//! Reading NIfTI-1 files built byte by byte.

use glam::DVec3;
use incise::volume::{Rescale, Volume, load};
use std::io::Write;
use std::path::{Path, PathBuf};

/// A header and voxels that can be modified and written.
pub struct File {
    pub bytes: Vec<u8>,
    big: bool,
}

impl File {
    pub fn new(size: [i16; 3], datatype: i16, bits: i16, big: bool) -> Self {
        let mut file = Self {
            bytes: vec![0; 352],
            big,
        };
        file.i32(0, 348);
        file.i16(40, 3);
        for (n, d) in size.into_iter().enumerate() {
            file.i16(42 + 2 * n, d);
        }
        for n in 3..7 {
            file.i16(42 + 2 * n, 1);
        }
        file.i16(70, datatype);
        file.i16(72, bits);
        for n in 0..4 {
            file.f32(76 + 4 * n, 1.0);
        }
        file.f32(108, 352.0);
        file.bytes[344..348].copy_from_slice(b"n+1\0");
        file
    }
    pub fn i16(&mut self, at: usize, v: i16) {
        self.put(at, &v.to_be_bytes());
    }
    fn i32(&mut self, at: usize, v: i32) {
        self.put(at, &v.to_be_bytes());
    }
    pub fn f32(&mut self, at: usize, v: f32) {
        self.put(at, &v.to_be_bytes());
    }
    /// Writes bytes given in big-endian order, reversed if the file is little-endian.
    fn put(&mut self, at: usize, bytes: &[u8]) {
        let mut bytes = bytes.to_vec();
        if !self.big {
            bytes.reverse();
        }
        self.bytes[at..at + bytes.len()].copy_from_slice(&bytes);
    }
    pub fn voxels<const N: usize>(&mut self, values: impl Iterator<Item = [u8; N]>) {
        for v in values {
            let at = self.bytes.len();
            self.bytes.resize(at + N, 0);
            self.put(at, &v);
        }
    }
    pub fn write(&self, folder: &Path, name: &str) -> PathBuf {
        let path = folder.join(name);
        if name.ends_with(".gz") {
            let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
            encoder.write_all(&self.bytes).unwrap();
            std::fs::write(&path, encoder.finish().unwrap()).unwrap();
        } else {
            std::fs::write(&path, &self.bytes).unwrap();
        }
        path
    }
}

pub fn read(path: &Path) -> incise::Result<Volume> {
    load::volume(path, &load::ReadOptions::default(), &incise::Watch::NONE)
}

/// A small u8 file with values 0..24.
pub fn small() -> File {
    let mut f = File::new([2, 3, 4], 2, 8, false);
    f.voxels((0..24u8).map(|v| [v]));
    f
}

pub fn every_type_and_byte_order() {
    let folder = tempfile::tempdir().unwrap();
    macro_rules! check {
        ($($t:ty, $code:literal, $name:literal);*) => {$(
            for big in [false, true] {
                for name in ["a.nii", "a.nii.gz"] {
                    let mut f = File::new([2, 3, 4], $code, 8 * size_of::<$t>() as i16, big);
                    f.voxels((0..24u8).map(|v| (v as $t * 5 as $t).to_be_bytes()));
                    let v = read(&f.write(folder.path(), name)).unwrap();
                    assert_eq!((v.size, v.voxels.type_name()), ([2, 3, 4], $name));
                    for n in 0..24 {
                        assert_eq!(v.voxels.get(n), 5.0 * n as f64, "{} big {big}", $name);
                    }
                    assert_eq!(v.value(1, 2, 3), 115.0);
                }
            }
        )*};
    }
    check!(u8, 2, "u8"; i8, 256, "i8"; i16, 4, "i16"; u16, 512, "u16"; i32, 8, "i32"; u32, 768, "u32"; f32, 16, "f32"; i64, 1024, "i64"; u64, 1280, "u64"; f64, 64, "f64");
}

pub fn rescale_is_sanitised() {
    let folder = tempfile::tempdir().unwrap();
    for (slope, intercept, want, warns) in [
        (
            0.5,
            -10.0,
            Rescale {
                slope: 0.5,
                intercept: -10.0,
            },
            false,
        ),
        (0.0, 5.0, Rescale::NONE, false),
        (f32::NAN, 0.0, Rescale::NONE, true),
        (1.0, f32::INFINITY, Rescale::NONE, true),
        (
            0.01,
            0.0,
            Rescale {
                slope: f64::from(0.01f32),
                intercept: 0.0,
            },
            false,
        ),
    ] {
        let mut f = small();
        f.f32(112, slope);
        f.f32(116, intercept);
        let v = read(&f.write(folder.path(), "a.nii")).unwrap();
        assert_eq!(v.rescale, want);
        assert_eq!(v.warnings.iter().any(|w| w.contains("slope")), warns);
        assert!((v.range[1] - (23.0 * want.slope + want.intercept)).abs() < 1e-9);
    }
}

pub fn sform_qform_and_spacing() {
    let folder = tempfile::tempdir().unwrap();
    let corner = |f: &File| {
        let v = read(&f.write(folder.path(), "a.nii")).unwrap();
        (
            v.world_from_voxel.transform_point3(DVec3::new(1.0, 2.0, 3.0)),
            v.orientation(),
            v.spacing_mm(),
        )
    };
    // Neither qform nor sform: RAS with the spacing.
    let mut f = small();
    f.f32(80, 2.0);
    f.f32(84, 3.0);
    f.f32(88, 4.0);
    assert_eq!(
        corner(&f),
        (
            DVec3::new(-2.0, -6.0, 12.0),
            "RAS".into(),
            DVec3::new(2.0, 3.0, 4.0)
        )
    );
    // qform: 90 degrees about z (b = c = 0, d = sin 45), offsets; then with the third axis flipped.
    f.i16(252, 1);
    f.f32(264, std::f32::consts::FRAC_1_SQRT_2);
    f.f32(268, 10.0);
    f.f32(272, 20.0);
    f.f32(276, 30.0);
    let (p, letters, _) = corner(&f);
    assert!(
        p.abs_diff_eq(DVec3::new(-(10.0 - 6.0), -(20.0 + 2.0), 42.0), 1e-5),
        "{p}"
    );
    assert_eq!(letters, "ALS");
    f.f32(76, -1.0);
    assert!((corner(&f).0.z - 18.0).abs() < 1e-5);
    // A quaternion longer than 1 must not break the reader.
    f.f32(256, 1.0);
    assert!(corner(&f).0.is_finite());
    // The sform takes precedence; a singular one is ignored with a warning.
    f.i16(254, 2);
    for (n, v) in [0.0, 0.0, -4.0, 7.0, 2.0, 0.0, 0.0, 8.0, 0.0, 3.0, 0.0, 9.0]
        .into_iter()
        .enumerate()
    {
        f.f32(280 + 4 * n, v);
    }
    let (p, letters, spacing) = corner(&f);
    assert!(
        p.abs_diff_eq(DVec3::new(-(-12.0 + 7.0), -(2.0 + 8.0), 15.0), 1e-5),
        "{p}"
    );
    assert_eq!((letters.as_str(), spacing), ("ASL", DVec3::new(2.0, 3.0, 4.0)));
    f.f32(280 + 8, 0.0);
    let v = read(&f.write(folder.path(), "b.nii")).unwrap();
    assert!(v.warnings.iter().any(|w| w.contains("sform")), "{:?}", v.warnings);
    // An invalid spacing; metres.
    let mut f = small();
    f.f32(80, f32::NAN);
    f.f32(84, 0.0);
    f.f32(88, -2.0);
    f.bytes[123] = 1;
    let (_, _, spacing) = corner(&f);
    assert_eq!(spacing, DVec3::new(1000.0, 1000.0, 2000.0));
}

pub fn damaged_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let error = |f: &File, name: &str| read(&f.write(folder.path(), name)).unwrap_err().to_string();
    let changed = |at: usize, v: i16| {
        let mut f = small();
        f.i16(at, v);
        f
    };
    let mut cut = small();
    cut.bytes.truncate(360);
    assert!(error(&cut, "cut.nii").contains("truncated"));
    cut.bytes.truncate(200);
    assert!(error(&cut, "header.nii").contains("truncated"));
    for (at, value, what) in [
        (40, 0, "0 dimensions"),
        (40, 9, "9 dimensions"),
        (42, -3, "-3 voxels"),
        (44, 0, "0 voxels"),
        // Three bytes per voxel, but the file holds only one.
        (70, 128, "more than the file can hold"),
        (70, 32, "complex"),
        (70, 77, "unknown type 77"),
        // The header of NIfTI-2 is longer than this file.
        (0, 540, "truncated"),
    ] {
        let message = error(&changed(at, value), "bad.nii");
        assert!(message.contains(what) && message.contains("bad.nii"), "{message}");
    }
    // The magic number counts, not the size of the header.
    let odd = read(&changed(0, 11).write(folder.path(), "odd.nii")).unwrap();
    assert!(
        odd.warnings.iter().any(|w| w.contains("header size of 11")),
        "{:?}",
        odd.warnings
    );
    let mut unmarked = changed(0, 11);
    unmarked.bytes[344..348].copy_from_slice(b"none");
    assert!(error(&unmarked, "unmarked.nii").contains("not a NIfTI file"));
    let mut huge = small();
    for n in 0..3 {
        huge.i16(42 + 2 * n, 32767);
    }
    assert!(error(&huge, "huge.nii").contains("more than the file can hold"));
    assert!(error(&huge, "huge.nii.gz").contains("more than the file can hold"));
    let mut overflow = small();
    overflow.i16(70, 64);
    overflow.i16(40, 7);
    for n in 0..7 {
        overflow.i16(42 + 2 * n, 32767);
    }
    assert!(error(&overflow, "overflow.nii").contains("overflow.nii"));
    // A gzip stream cut anywhere, and one with a flipped byte.
    let mut f = File::new([16, 16, 16], 4, 16, false);
    f.voxels((0..4096u32).map(|v| ((v.wrapping_mul(2_654_435_761) >> 16) as i16).to_be_bytes()));
    let whole = std::fs::read(f.write(folder.path(), "whole.nii.gz")).unwrap();
    for end in [
        1,
        5,
        20,
        whole.len() / 2,
        whole.len() - 40,
        whole.len() - 8,
        whole.len() - 1,
    ] {
        let path = folder.path().join("short.nii.gz");
        std::fs::write(&path, &whole[..end]).unwrap();
        let message = read(&path).unwrap_err().to_string();
        assert!(
            message.contains("truncated") || message.contains("damaged"),
            "{message}"
        );
    }
    let mut flipped = whole.clone();
    let at = flipped.len() - 6;
    flipped[at] ^= 1;
    let path = folder.path().join("flipped.nii.gz");
    std::fs::write(&path, &flipped).unwrap();
    assert!(read(&path).unwrap_err().to_string().contains("damaged"));
    // Trailing zeros after the stream, as some tools write.
    std::fs::write(&path, [&whole[..], &[0; 512]].concat()).unwrap();
    assert!(read(&path).is_ok());
    assert!(
        read(&folder.path().join("none.nii"))
            .unwrap_err()
            .to_string()
            .contains("none.nii")
    );
    assert!(read(folder.path()).unwrap_err().to_string().contains("folder"));
}

pub fn the_first_of_a_series_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let mut f = small();
    f.i16(40, 4);
    f.i16(48, 5);
    f.voxels((0..96u8).map(|v| [v]));
    let v = read(&f.write(folder.path(), "series.nii")).unwrap();
    assert_eq!(v.size, [2, 3, 4]);
    assert!(v.warnings.iter().any(|w| w.contains("5 volumes")));
    let mut f = small();
    f.i16(40, 5);
    f.i16(50, 3);
    f.voxels((0..72u8).map(|v| [v]));
    let v = read(&f.write(folder.path(), "vector.nii")).unwrap();
    assert_eq!((v.components, v.size), (3, [2, 3, 4]));
}

pub fn the_bundled_head() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("volumes");
    let head = read(&folder.join("colin27-head-t1.nii.gz")).unwrap();
    assert_eq!(
        (head.size, head.voxels.type_name(), head.orientation()),
        ([181, 217, 181], "u8", "RAS".into())
    );
    assert_eq!(head.labels(), None);
    let labels = read(&folder.join("colin27-aal-labels.nii.gz")).unwrap();
    assert_eq!((labels.size, labels.labels()), (head.size, Some(116)));
    assert_eq!(labels.world_from_voxel, head.world_from_voxel);
}
