//! Every reader with every kind of file, references to files elsewhere, file names that are not
//! text.

use super::{HANGS, READERS, incise, inputs, node, stderr, words};
use rustix::fs::FileType;
use std::ffi::OsString;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Runs a line of bash in a folder, with the program as `$0`; a hung run is killed and reported.
fn run_by_shell(folder: &Path, line: &str) -> Output {
    let start = Instant::now();
    let mut shell = Command::new("bash");
    shell
        .current_dir(folder)
        .args(["-c", line, env!("CARGO_BIN_EXE_incise")])
        .env_remove("DISPLAY")
        .stdin(Stdio::null());
    let mut child = shell
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > HANGS {
            child.kill().unwrap();
            panic!("{line} hangs");
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    child.wait_with_output().unwrap()
}

/// Readers against files that are not regular.
pub fn every_reader_of_every_kind_of_file() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    inputs(f);
    std::fs::write(
        f.join("labelled.toml"),
        "incise = 1\n[volume]\npath = \"small.nii\"\nlabels = \"IN\"\n",
    )
    .unwrap();
    std::fs::write(f.join("sidecar.raw"), [0; 512]).unwrap();
    symlink("IN", f.join("sidecar.raw.toml")).unwrap();
    let bomb = {
        // Twenty megabytes of it would unpack to twenty gigabytes; a tenth suffices.
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        for _ in 0..2000 {
            std::io::Write::write_all(&mut encoder, &[b' '; 1 << 20]).unwrap();
        }
        encoder.finish().unwrap()
    };
    let zero = f.join("zero");
    let has_devices = node(&zero, FileType::CharacterDevice, (1, 5));
    if !has_devices {
        symlink("/dev/zero", &zero).unwrap();
    }
    assert!(node(&f.join("pipe"), FileType::Fifo, (0, 0)));
    std::fs::create_dir(f.join("folder")).unwrap();
    std::fs::write(f.join("bomb"), &bomb).unwrap();
    std::fs::File::create(f.join("huge"))
        .unwrap()
        .set_len(1 << 40)
        .unwrap();
    std::os::unix::net::UnixListener::bind(f.join("socket")).unwrap();
    let mut tried = 0;
    for (kind, word) in [
        ("zero", "not a regular file"),
        ("pipe", "not a regular file"),
        ("socket", "not a regular file"),
        ("folder", ""),
        ("bomb", ""),
        ("huge", ""),
        ("nowhere", ""),
    ] {
        for reader in READERS {
            for ending in reader.endings {
                let name = if *ending == "IN" {
                    "IN".to_owned()
                } else {
                    format!("in-{kind}.{ending}")
                };
                let path = f.join(&name);
                if !path.is_symlink() {
                    symlink(kind, &path).unwrap();
                }
                // A limit on the address space bounds memory in any case.
                let line = format!(
                    "ulimit -v 4000000; exec \"$0\" {} --backend cpu",
                    reader.words.replace("IN", &name)
                );
                let line = if reader.words.starts_with("render") {
                    line
                } else {
                    line.replace(" --backend cpu", "")
                };
                let output = run_by_shell(f, &line);
                let message = stderr(&output);
                assert_eq!(output.status.code(), Some(1), "{line}: {message}");
                // Errors of a scene file have their own wording.
                assert!(
                    message.contains(word)
                        && message.trim().lines().count() == 1
                        && !message.contains("panicked"),
                    "{line}: {message}"
                );
                let named = message.contains(name.split('.').next().unwrap())
                    || message.contains("sidecar.raw")
                    || matches!(kind, "nowhere" | "folder");
                assert!(named, "{line}: {message}");
                tried += 1;
                if *ending == "IN" {
                    std::fs::remove_file(&path).unwrap();
                }
            }
        }
    }
    assert!(tried > 300, "{tried}");
}

/// A reference to a file outside the folder is not followed, unless this is allowed.
pub fn files_do_not_reach_outside() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    inputs(f);
    let inner = f.join("inner");
    std::fs::create_dir(&inner).unwrap();
    let nrrd = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 8 8 8\nencoding: raw\n";
    let outside = f.join("values.raw");
    let name = outside.display();
    let mhd = "ObjectType = Image\nNDims = 3\nDimSize = 8 8 8\nElementType = MET_UCHAR\nElementDataFile = ";
    let gltf = |uri: &str| {
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"buffers":[{{"uri":"{uri}","byteLength":36}}],"bufferViews":[{{"buffer":0,"byteLength":36}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,1]}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}]}}"#
        )
    };
    let corners: Vec<u8> = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    std::fs::write(f.join("corners.bin"), &corners).unwrap();
    symlink("../values.raw", inner.join("link.raw")).unwrap();
    symlink("../pair.img", inner.join("pair.img")).unwrap();
    std::fs::copy(f.join("pair.hdr"), inner.join("pair.hdr")).unwrap();
    std::fs::create_dir(inner.join("array.zarr")).unwrap();
    std::fs::copy(f.join("array.zarr/.zarray"), inner.join("array.zarr/.zarray")).unwrap();
    symlink("../../array.zarr/0.0.0", inner.join("array.zarr/0.0.0")).unwrap();
    std::fs::write(inner.join("sized.raw"), [0; 512]).unwrap();
    symlink("../sized.raw.toml", inner.join("sized.raw.toml")).unwrap();
    let files = [
        ("up.nhdr", format!("{nrrd}data file: ../values.raw\n\n")),
        ("absolute.nhdr", format!("{nrrd}data file: {name}\n\n")),
        (
            "list.nhdr",
            format!("{nrrd}data file: LIST\n../slice-1.raw\n../slice-2.raw\n"),
        ),
        (
            "pattern.nhdr",
            format!("{nrrd}data file: ../slice-%d.raw 1 2 1\n\n"),
        ),
        ("link.nhdr", format!("{nrrd}data file: link.raw\n\n")),
        ("up.mhd", format!("{mhd}../values.raw\n")),
        ("list.mhd", format!("{mhd}LIST\n../slice-1.raw\n../slice-2.raw\n")),
        ("up.gltf", gltf("../corners.bin")),
        ("escaped.gltf", gltf("%2e%2e/corners.bin")),
        (
            "absolute.gltf",
            gltf(&f.join("corners.bin").display().to_string()),
        ),
    ];
    for (name, content) in &files {
        std::fs::write(inner.join(name), content).unwrap();
    }
    for name in files
        .iter()
        .map(|f| f.0)
        .chain(["pair.hdr", "array.zarr", "sized.raw"])
    {
        let output = incise(&inner, &words(&format!("info {name}")));
        assert!(
            output.status.code() == Some(1) && stderr(&output).contains("--allow-outside"),
            "{name}: {}",
            stderr(&output)
        );
        let output = incise(&inner, &words(&format!("info {name} --allow-outside")));
        assert!(output.status.success(), "{name}: {}", stderr(&output));
    }
    // A URL is not a file.
    std::fs::write(inner.join("address.gltf"), gltf("file:///etc/passwd")).unwrap();
    assert_eq!(
        incise(&inner, &words("info address.gltf --allow-outside"))
            .status
            .code(),
        Some(1)
    );
    check_links_in_folders(f);
}

/// Checks that links in a folder to files inside it are followed, and that others are counted.
fn check_links_in_folders(folder: &Path) {
    let series = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/readers/phantom/dicom-explicit");
    let (one, other) = (folder.join("one"), folder.join("other"));
    for made in [&one, &other] {
        std::fs::create_dir(made).unwrap();
    }
    for (n, file) in walkdir::WalkDir::new(&series)
        .into_iter()
        .flatten()
        .filter(|e| e.file_type().is_file())
        .enumerate()
    {
        std::fs::copy(
            file.path(),
            if n < 3 { &one } else { &other }.join(file.file_name()),
        )
        .unwrap();
    }
    for (target, link) in [
        ("../other", "others"),
        ("/", "everything"),
        ("../other/3-1.dcm", "another.dcm"),
        ("0-1.dcm", "first-again.dcm"),
        (".", "itself"),
    ] {
        symlink(target, one.join(link)).unwrap();
    }
    let slices = |more: &str| {
        let output = incise(folder, &words(&format!("info one --json {more}")));
        assert!(output.status.success(), "{}", stderr(&output));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        (
            report["size"][2].as_u64().unwrap(),
            report["warnings"].to_string(),
        )
    };
    let (count, warnings) = slices("");
    assert!(
        count == 3 && warnings.contains("3 links") && warnings.contains("not followed"),
        "{count} {warnings}"
    );
    std::fs::remove_file(one.join("everything")).unwrap();
    let (count, warnings) = slices("--allow-outside");
    assert!(
        count == 5 && !warnings.contains("not followed"),
        "{count} {warnings}"
    );
}

/// Any file name that the system allows can be read and written.
pub fn names_that_are_no_text() {
    use std::os::unix::ffi::OsStrExt;
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    inputs(f);
    let odd = |ending: &str| {
        std::ffi::OsStr::from_bytes(&[b"caf\xe9 \xff\x1b[2J.", ending.as_bytes()].concat()).to_owned()
    };
    let copied = |from: &str, ending: &str| std::fs::copy(f.join(from), f.join(odd(ending))).unwrap();
    copied("small.nii", "nii");
    copied("box.obj", "obj");
    std::fs::write(
        f.join(odd("toml")),
        "incise = 1\n[volume]\npath = \"small.nii\"\n",
    )
    .unwrap();
    let cases: [(&str, &str, &str); 7] = [
        ("render IN -o OUT --backend cpu --size 16x16 -q", "nii", "png"),
        ("render IN -o OUT --backend cpu --size 16x16 -q", "toml", "png"),
        (
            "render IN -o OUT --backend cpu --size 16x16 -q --mode surface",
            "obj",
            "png",
        ),
        (
            "render small.nii -o OUT --backend cpu --size 16x16 -q --inside IN",
            "obj",
            "png",
        ),
        ("bake IN -o OUT", "nii", "nrrd"),
        ("sdf IN -o OUT --resolution 8", "obj", "nrrd"),
        ("map IN -o OUT", "nrrd", "mha"),
    ];
    for (line, from, to) in cases {
        if from == "nrrd" {
            assert!(incise(f, &words("map twist -o map.nrrd")).status.success());
            copied("map.nrrd", "nrrd");
        }
        let named = |w: &str| match w {
            "IN" => odd(from),
            "OUT" => odd(to),
            other => other.into(),
        };
        let arguments: Vec<OsString> = line.split_whitespace().map(named).collect();
        let _before = std::fs::remove_file(f.join(odd(to)));
        let output = incise(f, &arguments);
        assert!(
            output.status.success() && f.join(odd(to)).is_file(),
            "{line}: {}",
            stderr(&output)
        );
    }
    // Also in a deformation's setting; the message shows the name in printable form.
    let mut setting = OsString::from("field:path=");
    setting.push(odd("nii"));
    let arguments = [
        words("render small.nii -q -o out.png --backend cpu --deform"),
        vec![setting],
    ]
    .concat();
    let output = incise(f, &arguments);
    assert!(
        output.status.code() == Some(1) && !stderr(&output).trim().contains(char::is_control),
        "{:?}",
        stderr(&output)
    );
}
