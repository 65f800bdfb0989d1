//! Robustness of the readers: files that are not images, truncated or altered files, and files that
//! request excessive memory.

use crate::readers::{fixtures, read};
use incise::volume::load::ReadOptions;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// Files that are not images.
fn damaged(folder: &Path) -> Vec<(PathBuf, &'static str)> {
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let zip = |bytes: &[u8], level: u32| {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::new(level));
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    };
    let phantom = |name: &str| std::fs::read(fixtures().join("phantom").join(name)).unwrap();
    let mut all = Vec::new();
    for ending in [
        "nii", "nii.gz", "hdr", "nrrd", "nhdr", "mha", "mhd", "vti", "vtk", "tif", "png", "jpg", "npy",
        "dcm", "zip", "raw", "img",
    ] {
        all.push((file(&format!("empty.{ending}"), b""), "is empty"));
        all.push((
            file(
                &format!("text.{ending}"),
                b"This is a text and no scan at all.\n".repeat(40).as_slice(),
            ),
            "",
        ));
    }
    // Valid content under wrong extensions.
    for (name, wrong) in [
        ("itk.nii", "a.nrrd"),
        ("itk.nrrd", "b.nii"),
        ("itk.mha", "c.vti"),
        ("vtk-ascii.vtk", "d.mha"),
        ("lzw.tif", "e.png"),
        ("c.npy", "f.tif"),
        ("dicom-explicit/0-1.dcm", "g.nii.gz"),
        ("dicom.zip", "h.dcm"),
        ("vtk-appended-zlib-64-raw.vti", "i.npy"),
        ("pngs/8.png", "j.vtk"),
    ] {
        all.push((file(wrong, &phantom(name)), "does not match its extension"));
    }
    // Gzip that unpacks to far more than its header states, or states more than it can hold.
    let mut bomb = phantom("itk.nii");
    bomb.resize(200 << 20, 0);
    let packed = zip(&bomb, 9);
    all.push((file("twenty-bytes.nii.gz", &packed[..20]), "ends too early"));
    let mut declares = phantom("itk.nii");
    for n in 0..3 {
        declares[42 + 2 * n..44 + 2 * n].copy_from_slice(&3000i16.to_le_bytes());
    }
    all.push((
        file("declares.nii.gz", &zip(&declares, 9)),
        "more than the file can hold",
    ));
    all.push((file("declares.nii", &declares), "more than the file can hold"));
    // Zip members that are not DICOM; folders of texts; links in a loop.
    file("texts/a.txt", b"text");
    file("texts/b/readme.md", b"# text");
    all.push((folder.join("texts"), "holds no image"));
    std::fs::create_dir_all(folder.join("loop/inner")).unwrap();
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(folder.join("loop"), folder.join("loop/inner/again")).unwrap();
        std::os::unix::fs::symlink(folder.join("nowhere"), folder.join("loop/dangling")).unwrap();
    }
    all.push((folder.join("loop"), "holds no image"));
    file(
        "bad.zarr/.zattrs",
        br#"{"multiscales":[{"axes":["z","y","x"],"datasets":[{"path":"0"}]}]}"#,
    );
    file("bad.zarr/0/.zarray", br#"{"zarr_format":2,"shape":[100000,100000,100000],"chunks":[100000,100000,1000],"dtype":"<u2","compressor":null,"fill_value":0,"order":"C","filters":null}"#);
    all.push((folder.join("bad.zarr"), "more than the file can hold"));
    file(
        "outside.zarr/.zattrs",
        br#"{"multiscales":[{"axes":["z","y","x"],"datasets":[{"path":"../../etc"}]}]}"#,
    );
    all.push((folder.join("outside.zarr"), "outside the store"));
    file("vti.vti", br#"<VTKFile type="ImageData" compressor="vtkZLibDataCompressor"><ImageData WholeExtent="0 99999 0 99999 0 9"><Piece Extent="0 99999 0 99999 0 9"><PointData><DataArray type="Float64" Name="a" format="binary">AAAA</DataArray></PointData></Piece></ImageData></VTKFile>"#);
    all.push((folder.join("vti.vti"), "more than the file can hold"));
    all.push((PathBuf::from("/dev/null"), ""));
    all
}

/// One run of `info` on a file and its outcome. It must end quickly, with one line, and with little
/// memory.
fn tried(path: &Path, memory_kib: usize) -> Result<(), String> {
    let start = Instant::now();
    // A limit on the address space bounds memory in any case.
    let script = format!("ulimit -v {memory_kib}; exec \"$0\" info \"$1\"");
    let output = Command::new("sh")
        .arg("-c")
        .arg(script)
        .arg(env!("CARGO_BIN_EXE_incise"))
        .arg(path)
        .env("RAYON_NUM_THREADS", "2")
        .output()
        .unwrap();
    let (took, text) = (
        start.elapsed(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    );
    assert!(took < Duration::from_secs(2), "{}: {took:?}", path.display());
    match output.status.code() {
        Some(0) => Ok(()),
        Some(1) => {
            assert!(
                text.starts_with("incise: ") && text.trim_end().lines().count() == 1,
                "{}: {text}",
                path.display()
            );
            Err(text)
        }
        other => panic!("{}: {other:?} {text}", path.display()),
    }
}

/// Damaged files: each is reported in one line within two seconds and little memory, or still
/// opens.
pub fn damaged_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let memory = 600 << 10;
    let (mut count, mut named) = (0, 0);
    for (path, expected) in damaged(folder.path()) {
        let error = tried(&path, memory).expect_err(&path.to_string_lossy());
        assert!(
            error.contains(expected) && error.contains(path.file_stem().unwrap().to_str().unwrap()),
            "{}: {error}",
            path.display()
        );
        (count, named) = (count + 1, named + 1);
    }
    // Regression files that crash a reader without the corresponding checks.
    for entry in std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bad"))
        .into_iter()
        .flatten()
        .flatten()
    {
        let error = tried(&entry.path(), memory).expect_err(&entry.path().to_string_lossy());
        println!("{}", error.trim());
        (count, named) = (count + 1, named + 1);
    }
    let mut random = Random(7);
    for name in SEEDS {
        let path = fixtures().join("phantom").join(name);
        let whole = std::fs::read(&path).unwrap();
        let target = folder.path().join(Path::new(name).file_name().unwrap());
        for n in 0..100 {
            let mut bytes = whole.clone();
            if n < 50 {
                bytes.truncate(random.below(whole.len()));
            } else {
                bytes[random.below(whole.len().min(4096))] ^= 1 << random.below(8);
            }
            std::fs::write(&target, bytes).unwrap();
            named += usize::from(tried(&target, memory).is_err());
            count += 1;
        }
        std::fs::remove_file(&target).unwrap();
    }
    println!(
        "{count} damaged files tried, {named} named, {} of those with one byte changed or cut behind their values still open",
        count - named
    );
}

/// A small deterministic generator (xorshift64*).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }
    fn below(&mut self, n: usize) -> usize {
        (self.next() >> 11) as usize % n.max(1)
    }
}

/// Files inside OME-Zarr folders.
const FOLDERS: [&str; 6] = [
    "blosc-04.zarr#.zattrs",
    "blosc-04.zarr#0/.zarray",
    "blosc-04.zarr#0/0.0.0.0.0",
    "zstd-05.zarr#0/zarr.json",
    "zstd-05.zarr#zarr.json",
    "sharded-05.zarr#0/c/0/0/0/0/0",
];

/// One file of each format and compression.
const SEEDS: [&str; 46] = [
    "itk.nii",
    "itk.nii.gz",
    "nib2.nii.gz",
    "nrrd-raw.nrrd",
    "itk-gzip.nrrd",
    "nrrd-bzip2.nrrd",
    "nrrd-ascii.nrrd",
    "hex.nrrd",
    "itk.mha",
    "itk-zlib.mha",
    "text.mha",
    "vtk-ascii-none-32.vti",
    "vtk-binary-zlib-64.vti",
    "vtk-appended-lz4-64-raw.vti",
    "vtk-appended-lzma-32.vti",
    "vtk-ascii.vtk",
    "vtk-binary.vtk",
    "lzw.tif",
    "imagej.tif",
    "ome.tif",
    "pngs/8.png",
    "c.npy",
    "dicom-explicit/0-1.dcm",
    "dicom-rle/0-1.dcm",
    "dicom-deflated/0-1.dcm",
    "dicom.zip",
    "../emri_small_jpeg_2k_lossless.dcm",
    "../JPEG-LL.dcm",
    "../emri_small_RLE.dcm",
    "../structures.dcm",
    "../array.npz",
    "../array.zarr.zip",
    "../../../faults/listed/F01a-un-undefined-length/un.dcm",
    "../../../faults/listed/F06-rt-dose/dose.dcm",
    "../../../faults/listed/F07-nrrd-gzip-byte-skip/bs.nrrd",
    "../../../faults/listed/F08-seg-nrrd-layers/x.seg.nrrd",
    "../../../faults/listed/F16-tiff-1-bit/bit_group4.tif",
    "../../../faults/listed/F17-tiff-palette/palij.tif",
    "../../../faults/listed/F22-implicit-under-explicit/wrong-ts.dcm",
    "../../../faults/listed/F23-no-preamble/bare-long-imagetype.dcm",
    "../../../faults/listed/F26-description-escapes/x.dcm",
    "../../../faults/listed/Q01-white-is-zero/miw_i2.tif",
    "../../../faults/listed/Q02-gated-spect/nm.dcm",
    "../../../faults/listed/Q03-mosaic/x.dcm",
    "../../../faults/listed/Q04-ultrasound-clip/x.dcm",
    "../../../faults/listed/Q05-jpeg-labelled-rgb/x.dcm",
];

/// Mutations aware of header structure: bytes, numbers in text and in binary; pieces moved,
/// duplicated, removed, truncated.
fn mutate(bytes: &mut Vec<u8>, header: usize, random: &mut Random) {
    const ODD: [&[u8]; 14] = [
        b"0",
        b"-1",
        b"99999999999",
        b"1e308",
        b"nan",
        b"",
        b"%",
        b"<",
        b"\n\n",
        b"2147483648",
        b"65535",
        b"4294967295",
        b"18446744073709551615",
        b"/dev/zero",
    ];
    for _ in 0..1 + random.below(3) {
        if bytes.is_empty() {
            return;
        }
        // Headers are mutated most often.
        let at = if random.below(4) == 0 {
            random.below(bytes.len())
        } else {
            random.below(bytes.len().min(header))
        };
        match random.below(9) {
            0 => bytes[at] = random.next() as u8,
            1 => bytes[at] ^= 1 << random.below(8),
            2 => bytes.truncate(at),
            3 | 4 => {
                // A number in text form.
                let start = (at..bytes.len())
                    .find(|&n| bytes[n].is_ascii_digit() || bytes[n] == b'-')
                    .unwrap_or(at);
                let end = (start..bytes.len())
                    .find(|&n| !(bytes[n].is_ascii_digit() || b"-.e".contains(&bytes[n])))
                    .unwrap_or(bytes.len());
                bytes.splice(start..end, ODD[random.below(ODD.len())].iter().copied());
            }
            5 | 6 => {
                // A number in binary form.
                let value = [
                    0,
                    1,
                    u64::MAX,
                    1 << 31,
                    1 << 15,
                    0x7fff_ffff,
                    0xffff_ff00,
                    3,
                    1 << 40,
                ][random.below(9)];
                let width = [1, 2, 4, 8][random.below(4)];
                let raw = if random.below(2) == 0 {
                    value.to_le_bytes()
                } else {
                    value.to_be_bytes()
                };
                let from = if random.below(2) == 0 { 0 } else { 8 - width };
                for (n, b) in raw[from..from + width].iter().enumerate() {
                    if let Some(byte) = bytes.get_mut(at + n) {
                        *byte = *b;
                    }
                }
            }
            7 => {
                let end = (at + 1 + random.below(40)).min(bytes.len());
                let piece = bytes[at..end].to_vec();
                let to = random.below(bytes.len());
                bytes.splice(to..to, piece);
            }
            _ => {
                let end = (at + 1 + random.below(40)).min(bytes.len());
                bytes.drain(at..end);
            }
        }
    }
}

fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().flatten() {
        let to = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_folder(&entry.path(), &to);
        } else {
            std::fs::copy(entry.path(), to).unwrap();
        }
    }
}

/// Resident memory of this process, bytes.
fn resident() -> usize {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    text.lines()
        .find_map(|l| {
            l.strip_prefix("VmRSS:")?
                .trim()
                .strip_suffix(" kB")?
                .trim()
                .parse::<usize>()
                .ok()
        })
        .unwrap_or(0)
        << 10
}

/// Mutated files of every format give an image or one error, never a panic, a hang or excessive
/// memory. INCISE_FUZZ_CASES (per seed), INCISE_FUZZ_SEED and INCISE_FUZZ_ONLY (a part of a seed's
/// name) control longer runs; failing files are saved in the folder that INCISE_FUZZ_KEEP names.
pub fn mutated_files_do_no_harm() {
    let variable = |name: &str| std::env::var(name).ok();
    let cases: usize = variable("INCISE_FUZZ_CASES")
        .and_then(|v| v.parse().ok())
        .unwrap_or(1500);
    let seed: u64 = variable("INCISE_FUZZ_SEED")
        .and_then(|v| v.parse().ok())
        .unwrap_or(1);
    let only = variable("INCISE_FUZZ_ONLY").unwrap_or_default();
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() {
        tempfile::tempdir_in(memory)
    } else {
        tempfile::tempdir()
    }
    .unwrap();
    let keep = variable("INCISE_FUZZ_KEEP").map(PathBuf::from);
    let (mut total, mut opened, mut bad) = (0usize, 0usize, Vec::new());
    for name in SEEDS.iter().chain(&FOLDERS).filter(|n| n.contains(&only)) {
        // For a folder, the file after its `#` is mutated.
        let (image, part) = name.split_once('#').unwrap_or((name, ""));
        let file_name = Path::new(image)
            .file_name()
            .unwrap()
            .to_string_lossy()
            .into_owned();
        let opened_path = folder.path().join(&file_name);
        if !part.is_empty() {
            copy_folder(&fixtures().join("phantom").join(image), &opened_path);
        }
        let target = if part.is_empty() {
            opened_path.clone()
        } else {
            opened_path.join(part)
        };
        let whole = std::fs::read(if part.is_empty() {
            fixtures().join("phantom").join(image)
        } else {
            target.clone()
        })
        .unwrap();
        let mut random = Random(0x9e37_79b9_7f4a_7c15 ^ seed.wrapping_mul(0x1000_0001) ^ whole.len() as u64);
        let (mut worst, start) = (Duration::ZERO, Instant::now());
        for n in 0..cases {
            let mut bytes = whole.clone();
            // A DICOM header is long, and the data that affects decoders follows it.
            mutate(
                &mut bytes,
                if name.ends_with(".dcm") { 8192 } else { 1200 },
                &mut random,
            );
            std::fs::write(&target, &bytes).unwrap();
            let (before, from) = (resident(), Instant::now());
            let result = std::panic::catch_unwind(|| {
                read(&opened_path, &ReadOptions::default()).map(|v| v.voxels.len())
            });
            let (took, grown) = (from.elapsed(), resident().saturating_sub(before));
            worst = worst.max(took);
            opened += usize::from(matches!(result, Ok(Ok(_))));
            let one_line = !matches!(&result, Ok(Err(e)) if e.to_string().contains('\n'));
            if result.is_err() || !one_line || took > Duration::from_secs(2) || grown > 300 << 20 {
                let what = if result.is_err() {
                    "panicked"
                } else if !one_line {
                    "says several lines"
                } else if grown > 300 << 20 {
                    "took memory"
                } else {
                    "took long"
                };
                bad.push(format!("{name} case {n} {what}: {took:?}, {} MiB", grown >> 20));
                if let Some(keep) = &keep {
                    std::fs::write(keep.join(format!("{seed}-{n}-{file_name}")), &bytes).unwrap();
                }
            }
            total += 1;
        }
        println!(
            "{name}: {cases} cases in {:.1} s, the longest {worst:?}",
            start.elapsed().as_secs_f64()
        );
        if part.is_empty() {
            std::fs::remove_file(&target).unwrap()
        } else {
            std::fs::remove_dir_all(&opened_path).unwrap()
        }
    }
    println!(
        "{total} mutated files, {opened} still open, {} do harm",
        bad.len()
    );
    assert!(bad.is_empty(), "{bad:#?}");
}
