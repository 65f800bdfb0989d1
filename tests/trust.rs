//! Safety of user files: no input is overwritten, no file blocks the program, no read is unbounded.
//! Every writer is tested with every kind of destination, every reader with every kind of file that
//! is not regular. Device nodes are created in a scratch folder; no device of the machine is named.
#![cfg(unix)]

use crate::nifti::small;
use rustix::fs::{CWD, FileType, Mode, makedev, mknodat};
use std::ffi::OsString;
use std::io::Read;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Far longer than any of these runs takes; a run of this length is considered hung.
const HANGS: Duration = Duration::from_secs(60);

fn command(folder: &Path, arguments: &[OsString]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_incise"));
    command.current_dir(folder).args(arguments).env_remove("DISPLAY").stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Runs the program; a hung run is killed and reported.
fn incise(folder: &Path, arguments: &[OsString]) -> Output {
    let mut child = command(folder, arguments).spawn().unwrap();
    let (mut out, mut err) = (child.stdout.take().unwrap(), child.stderr.take().unwrap());
    let reading = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        out.read_to_end(&mut bytes).unwrap();
        bytes
    });
    let complaining = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        err.read_to_end(&mut bytes).unwrap();
        bytes
    });
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if start.elapsed() > HANGS {
            child.kill().unwrap();
            child.wait().unwrap();
            panic!("{arguments:?} hangs");
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    Output { status, stdout: reading.join().unwrap(), stderr: complaining.join().unwrap() }
}

fn words(text: &str) -> Vec<OsString> {
    text.split_whitespace().map(OsString::from).collect()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A command that writes a file with an extension, `OUT` in its words, and the files that it reads.
struct Writer {
    words: &'static str,
    ending: &'static str,
    reads: &'static [&'static str],
}

const WRITERS: &[Writer] = &[
    Writer { words: "render small.nii -o OUT --backend cpu --size 16x16 -q", ending: "png", reads: &["small.nii"] },
    Writer {
        words: "render detached.nhdr -o picture.png --stats OUT --backend cpu --size 16x16 -q",
        ending: "raw",
        reads: &["detached.nhdr", "values.raw"],
    },
    Writer { words: "compare small.nii -o report --stats OUT --backend cpu --size 16x16 -q --no-reference", ending: "json", reads: &["small.nii"] },
    Writer { words: "bake pair.hdr -o OUT --deform twist", ending: "nii", reads: &["pair.hdr", "pair.img"] },
    Writer { words: "bake detached.mhd -o OUT --deform twist", ending: "mha", reads: &["detached.mhd", "values.raw"] },
    Writer { words: "bake listed.nhdr -o OUT --deform twist", ending: "nrrd", reads: &["listed.nhdr", "slice-1.raw", "slice-2.raw"] },
    Writer { words: "bake sized.raw -o OUT", ending: "vti", reads: &["sized.raw", "sized.raw.toml"] },
    Writer { words: "bake array.zarr -o OUT", ending: "nii.gz", reads: &["array.zarr/.zarray", "array.zarr/0.0.0"] },
    Writer { words: "map twist -o OUT --volume small.nii", ending: "nrrd", reads: &["small.nii"] },
    Writer { words: "map check affine.tfm --csv OUT --no-inverse", ending: "csv", reads: &["affine.tfm"] },
    Writer { words: "map check affine.tfm --picture OUT --no-inverse", ending: "png", reads: &["affine.tfm"] },
    Writer { words: "sdf box.obj -o OUT --resolution 8", ending: "nrrd", reads: &["box.obj"] },
];

const BOX: &str =
    "v 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\nv 0 0 9\nv 9 0 9\nv 9 9 9\nv 0 9 9\nf 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

/// Creates the files that the writers read.
fn inputs(folder: &Path) {
    let write = |name: &str, content: &[u8]| {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, content).unwrap();
    };
    small().write(folder, "small.nii");
    let values: Vec<u8> = (0..8 * 8 * 8u32).map(|n| (n * 37 % 251) as u8).collect();
    write("values.raw", &values);
    write("slice-1.raw", &values[..256]);
    write("slice-2.raw", &values[256..]);
    write("sized.raw", &values);
    write("sized.raw.toml", b"size = [8, 8, 8]\ntype = \"u8\"\n");
    let nrrd = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 8 8 8\nencoding: raw\n";
    write("detached.nhdr", format!("{nrrd}data file: values.raw\n\n").as_bytes());
    write("listed.nhdr", format!("{nrrd}data file: LIST\nslice-1.raw\nslice-2.raw\n").as_bytes());
    write("detached.mhd", b"ObjectType = Image\nNDims = 3\nDimSize = 8 8 8\nElementType = MET_UCHAR\nElementDataFile = values.raw\n");
    // A pair is a NIfTI whose header and values are in two files.
    let whole = std::fs::read(folder.join("small.nii")).unwrap();
    let mut header = whole[..348].to_vec();
    header[344..348].copy_from_slice(b"ni1\0");
    // The values start at offset 0 of their own file.
    header[108..112].fill(0);
    write("pair.hdr", &header);
    write("pair.img", &whole[352..]);
    write(
        "array.zarr/.zarray",
        br#"{"zarr_format":2,"shape":[8,8,8],"chunks":[8,8,8],"dtype":"|u1","compressor":null,"fill_value":0,"order":"C","filters":null}"#,
    );
    write("array.zarr/0.0.0", &values);
    write("affine.tfm", b"#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\nParameters: 1 0 0 0 1 0 0 0 1 2 0 0\nFixedParameters: 0 0 0\n");
    write("box.obj", BOX.as_bytes());
}

fn tree(folder: &Path) -> Vec<(PathBuf, Option<Vec<u8>>)> {
    let mut all: Vec<_> = walkdir::WalkDir::new(folder)
        .into_iter()
        .flatten()
        .map(|e| {
            let content = e.file_type().is_file().then(|| std::fs::read(e.path()).unwrap());
            (e.into_path(), content)
        })
        .collect();
    all.sort();
    all
}

fn node(path: &Path, kind: FileType, device: (u32, u32)) -> bool {
    mknodat(CWD, path, kind, Mode::from_raw_mode(0o666), makedev(device.0, device.1)).is_ok()
}

/// Whether a writer's content is complete; contents with times differ from run to run.
fn is_complete(content: &[u8], ending: &str) -> bool {
    match ending {
        "png" => content.starts_with(b"\x89PNG") && content.ends_with(b"IEND\xaeB`\x82"),
        "raw" | "json" => serde_json::from_slice::<serde_json::Value>(content).is_ok(),
        "csv" => content.starts_with(b"i,") || content.contains(&b','),
        "nrrd" => content.starts_with(b"NRRD000"),
        "vti" => content.starts_with(b"<?xml") && content.trim_ascii_end().ends_with(b"</VTKFile>"),
        "nii.gz" => content.starts_with(&[0x1f, 0x8b]),
        _ => content.len() > 300,
    }
}

/// Writers against destinations.
pub fn every_writer_into_every_place() {
    for writer in WRITERS {
        let folder = tempfile::tempdir().unwrap();
        let f = folder.path();
        inputs(f);
        let places = f.join("places");
        std::fs::create_dir(&places).unwrap();
        let place = |name: &str| places.join(format!("{name}.{}", writer.ending));
        let at =
            |path: &Path| -> Vec<OsString> { writer.words.split_whitespace().map(|w| if w == "OUT" { path.into() } else { w.into() }).collect() };
        let run = |path: &Path| incise(f, &at(path));
        let succeeds = |path: &Path| {
            let output = run(path);
            assert!(output.status.success(), "{:?}: {}", at(path), stderr(&output));
            output
        };
        let refused = |path: &Path, word: &str| {
            let before = tree(f);
            let output = run(path);
            assert_eq!(output.status.code(), Some(1), "{:?}: {}", at(path), stderr(&output));
            let message = stderr(&output);
            assert!(message.contains(word) && message.trim_end().lines().filter(|l| l.contains(word)).count() == 1, "{:?}: {message}", at(path));
            let after = tree(f);
            // A report may be complete before writing its statistics fails.
            let changed: Vec<_> = before.iter().filter(|b| !after.contains(b) && !b.0.starts_with(f.join("report"))).map(|b| &b.0).collect();
            assert!(changed.is_empty(), "{:?} changed {changed:?}", at(path));
        };
        let complete = |path: &Path| assert!(is_complete(&std::fs::read(path).unwrap(), writer.ending), "{}: {}", writer.words, path.display());
        let mode = |path: &Path| std::fs::metadata(path).unwrap().mode() & 0o7777;

        // A new file has the same mode as any program's new file.
        succeeds(&place("new"));
        complete(&place("new"));

        // A replaced file keeps its mode and owner.
        for bits in [0o600, 0o640, 0o755] {
            let path = place(&format!("mode-{bits:o}"));
            std::fs::write(&path, "old").unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(bits)).unwrap();
            // Only root can change the owner.
            let given = std::os::unix::fs::chown(&path, Some(1234), Some(4321)).is_ok();
            succeeds(&path);
            complete(&path);
            assert_eq!(mode(&path), bits, "{}", writer.words);
            let owner = std::fs::metadata(&path).map(|m| (m.uid(), m.gid())).unwrap();
            assert!(!given || owner == (1234, 4321), "{}: {owner:?}", writer.words);
        }

        #[cfg(target_os = "linux")]
        for _ in 0..2 {
            let name = format!("twice.{}", writer.ending);
            succeeds(&Path::new("/proc/self/cwd/places").join(name));
            complete(&place("twice"));
        }

        // A write-protected file is left unchanged, also for root.
        let protected = place("protected");
        std::fs::write(&protected, "old").unwrap();
        std::fs::set_permissions(&protected, std::fs::Permissions::from_mode(0o444)).unwrap();
        refused(&protected, "read-only");
        let link = place("link-to-protected");
        symlink(&protected, &link).unwrap();
        refused(&link, "read-only");

        // Through a link its target is replaced, and the link stays; a dangling link creates its
        // target.
        std::fs::create_dir(f.join("elsewhere")).unwrap();
        for (name, exists) in [("link", true), ("dangling", false)] {
            let (link, target) = (place(name), f.join("elsewhere").join(format!("{name}.{}", writer.ending)));
            if exists {
                std::fs::write(&target, "old").unwrap();
            }
            symlink(Path::new("../elsewhere").join(target.file_name().unwrap()), &link).unwrap();
            succeeds(&link);
            assert!(link.is_symlink(), "{}", writer.words);
            complete(&target);
        }

        // A pipe or device receives the whole content and is not replaced.
        let pipe = place("pipe");
        assert!(node(&pipe, FileType::Fifo, (0, 0)));
        let from = pipe.clone();
        let reading = std::thread::spawn(move || std::fs::read(from).unwrap());
        succeeds(&pipe);
        assert!(is_complete(&reading.join().unwrap(), writer.ending), "{}", writer.words);
        assert!(std::fs::symlink_metadata(&pipe).unwrap().file_type().is_fifo(), "{}", writer.words);
        let piped = place("link-to-pipe");
        symlink(&pipe, &piped).unwrap();
        let from = pipe.clone();
        let reading = std::thread::spawn(move || std::fs::read(from).unwrap());
        succeeds(&piped);
        assert!(is_complete(&reading.join().unwrap(), writer.ending) && piped.is_symlink(), "{}", writer.words);
        let (null, full) = (place("null"), place("full"));
        // Only root can create devices.
        if node(&null, FileType::CharacterDevice, (1, 3)) && node(&full, FileType::CharacterDevice, (1, 7)) {
            let before = std::fs::symlink_metadata(&null).unwrap().rdev();
            succeeds(&null);
            refused(&full, "No space left");
            for device in [&null, &full] {
                assert!(std::fs::symlink_metadata(device).unwrap().file_type().is_char_device(), "{}", writer.words);
            }
            assert_eq!(std::fs::symlink_metadata(&null).unwrap().rdev(), before);
        }
        let socket = place("socket");
        let listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let reading = std::thread::spawn(move || {
            let mut content = Vec::new();
            listener.accept().unwrap().0.read_to_end(&mut content).unwrap();
            content
        });
        succeeds(&socket);
        assert!(is_complete(&reading.join().unwrap(), writer.ending), "{}", writer.words);
        assert!(std::fs::symlink_metadata(&socket).unwrap().file_type().is_socket(), "{}", writer.words);

        // No input is overwritten, under any name.
        for input in writer.reads {
            let endings = input.ends_with(writer.ending) || writer.words.contains("--stats OUT") || writer.words.contains("--csv OUT");
            if endings {
                refused(&f.join(input), "input");
                // Through a path that uses the system's names for open files.
                #[cfg(target_os = "linux")]
                refused(&Path::new("/proc/self/cwd").join(input), "input");
            }
            let (link, hard) = (place("link-to-input"), place("hard-link-to-input"));
            symlink(f.join(input), &link).unwrap();
            refused(&link, "input");
            std::fs::hard_link(f.join(input), &hard).unwrap();
            refused(&hard, "input");
            std::fs::remove_file(link).unwrap();
            std::fs::remove_file(hard).unwrap();
        }
        assert!(!tree(f).iter().any(|(path, _)| path.to_string_lossy().ends_with(".part")), "{} left something", writer.words);
    }
}

/// Standard output takes a picture, also under the system's names for it.
pub fn standard_output_takes_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    inputs(f);
    let render = "render small.nii --backend cpu --size 16x16 -q -o";
    for name in ["-", "/dev/stdout"] {
        let output = incise(f, &words(&format!("{render} {name}")));
        assert!(output.status.success() && is_complete(&output.stdout, "png"), "{name}: {}", stderr(&output));
    }
    let output = incise(f, &words(&format!("{render} picture.png --stats /dev/stdout")));
    assert!(output.status.success() && is_complete(&output.stdout, "json"), "{}", stderr(&output));
    for more in ["--stats -", "--json", "--stats /dev/stdout"] {
        let output = incise(f, &words(&format!("{render} - {more}")));
        assert!(output.status.code() == Some(1) && stderr(&output).contains("standard output"), "{}", stderr(&output));
    }
    for (a, b) in [("one.png", "one.png"), ("one.png", "./one.png"), ("one.png", "link.png")] {
        let link = f.join("link.png");
        if !link.is_symlink() {
            symlink("one.png", link).unwrap();
        }
        let output = incise(f, &words(&format!("{render} {a} --stats {b}")));
        assert!(output.status.code() == Some(1) && stderr(&output).contains("same file"), "{}", stderr(&output));
    }
}

/// A full device is an error wherever output is printed; a closed reader is not.
pub fn what_cannot_be_printed_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    inputs(f);
    for line in [
        "info small.nii",
        "info small.nii --json",
        "info box.obj --json",
        "schema",
        "list",
        "--help",
        "render --help",
        "--version",
        "sdf box.obj -o field.nrrd --resolution 8 --json",
        "map check affine.tfm --json --no-inverse",
        "map check affine.tfm --no-inverse",
        "render small.nii -o a.png --backend cpu --size 16x16 -q --stats -",
        "render small.nii -o a.png --backend cpu --size 16x16 -q --json",
        "render small.nii -o - --backend cpu --size 16x16 -q",
        "compare small.nii -o report --backend cpu --size 16x16 -q --no-reference --json",
    ] {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let output = command(f, &words(line)).stdout(full).output().unwrap();
        let message = stderr(&output);
        assert!(
            output.status.code() == Some(1) && message.contains("standard output") && message.lines().count() == 1,
            "{line}: {:?} {message}",
            output.status
        );
        let mut child = command(f, &words(line)).spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success() && output.stderr.is_empty(), "{line}: {}", stderr(&output));
        // Messages that cannot be printed are dropped, since the failure cannot be reported
        // anywhere.
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        assert!(command(f, &words(line)).stderr(full).output().unwrap().status.success(), "{line}");
    }
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    assert_eq!(command(f, &words("info nowhere.nii")).stderr(full).status().unwrap().code(), Some(1));
}

/// Whether this process, and thus each of its children, was started with a signal ignored; unknown
/// counts as no.
fn is_ignored(signal: rustix::process::Signal) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|l| u64::from_str_radix(l.strip_prefix("SigIgn:")?.trim(), 16).ok());
    ignored.is_some_and(|set| set >> (signal.as_raw() - 1) & 1 == 1)
}

/// Partial files of an interrupted run are removed; those of a killed run are removed by the next
/// run.
pub fn nothing_unfinished_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let left = || -> Vec<String> {
        let names = std::fs::read_dir(f).unwrap().flatten().map(|e| e.file_name().to_string_lossy().into_owned());
        names.filter(|n| n.ends_with(".part")).collect()
    };
    // Long enough to be interrupted: the volume is written slice by slice.
    let bake = words("bake phantom:checker:size=400 -o out.nii --deform twist --interpolation cubic -q");
    for signal in [rustix::process::Signal::INT, rustix::process::Signal::TERM, rustix::process::Signal::HUP, rustix::process::Signal::KILL] {
        // Under `nohup`, for example, the signal stays ignored.
        if is_ignored(signal) {
            continue;
        }
        let mut child = command(f, &bake).spawn().unwrap();
        let start = Instant::now();
        let mut grown = false;
        while !grown {
            assert!(start.elapsed() < HANGS && child.try_wait().unwrap().is_none(), "nothing was written");
            std::thread::sleep(Duration::from_millis(1));
            grown = left().iter().any(|n| std::fs::metadata(f.join(n)).is_ok_and(|m| m.len() > 0));
        }
        rustix::process::kill_process(rustix::process::Pid::from_child(&child), signal).unwrap();
        let status = child.wait().unwrap();
        assert_eq!(std::os::unix::process::ExitStatusExt::signal(&status), Some(signal.as_raw()), "{status}");
        assert!(!f.join("out.nii").exists());
        assert_eq!(left().is_empty(), signal != rustix::process::Signal::KILL, "{signal:?}: {:?}", left());
    }
    // A recent partial file is not removed yet: it may belong to a running process.
    let next = words("render phantom:ball -o a.png --backend cpu --size 16x16 -q");
    assert!(incise(f, &next).status.success() && left().len() == 1);
    let long_ago = std::time::SystemTime::now() - Duration::from_secs(600);
    std::fs::File::options().write(true).open(f.join(&left()[0])).unwrap().set_modified(long_ago).unwrap();
    assert!(incise(f, &next).status.success() && left().is_empty(), "{:?}", left());
}

/// A command that reads `IN`, a file with any of these extensions.
struct Reader {
    words: &'static str,
    endings: &'static [&'static str],
}

const READERS: &[Reader] = &[
    Reader {
        words: "info IN",
        endings: &["nii", "nii.gz", "hdr", "img", "nrrd", "nhdr", "mha", "mhd", "vti", "vtk", "tif", "png", "jpg", "npy", "dcm", "zip", "unknown"],
    },
    Reader { words: "info IN --raw 5000x5000x5000:u8", endings: &["raw", "raw.gz"] },
    Reader { words: "info IN", endings: &["stl", "obj", "obj.gz", "ply", "off", "gltf", "glb", "gii", "gii.gz"] },
    Reader { words: "render IN -o out.png", endings: &["toml"] },
    Reader { words: "info IN", endings: &["toml"] },
    Reader { words: "map IN -o out.nii.gz", endings: &["tfm", "mat", "lta", "1D", "txt", "nii.gz"] },
    Reader { words: "map check IN", endings: &["tfm", "nrrd"] },
    Reader { words: "sdf IN -o out.nrrd", endings: &["stl"] },
    Reader { words: "render small.nii -q -o out.png --inside IN", endings: &["obj"] },
    Reader { words: "render small.nii -q -o out.png --deform points:pairs=IN", endings: &["csv", "mrk.json", "fcsv"] },
    Reader { words: "render small.nii -q -o out.png --deform field:path=IN", endings: &["nii", "tfm"] },
    Reader { words: "render small.nii -q -o out.png --deform map:path=IN", endings: &["nrrd"] },
    Reader { words: "render small.nii -q -o out.png --deform twist:spare=1,labels=IN", endings: &["nii.gz"] },
    Reader { words: "render small.nii -q -o out.png --deform lift:mask=IN", endings: &["nii"] },
    Reader { words: "render labelled.toml -q -o out.png", endings: &["IN"] },
    Reader { words: "render sidecar.raw -q -o out.png", endings: &["IN"] },
];

/// Readers against files that are not regular.
pub fn every_reader_of_every_kind_of_file() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    inputs(f);
    std::fs::write(f.join("labelled.toml"), "incise = 1\n[volume]\npath = \"small.nii\"\nlabels = \"IN\"\n").unwrap();
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
    std::fs::File::create(f.join("huge")).unwrap().set_len(1 << 40).unwrap();
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
                let name = if *ending == "IN" { "IN".to_owned() } else { format!("in-{kind}.{ending}") };
                let path = f.join(&name);
                if !path.is_symlink() {
                    symlink(kind, &path).unwrap();
                }
                // A limit on the address space bounds memory in any case.
                let line = format!("ulimit -v 4000000; exec \"$0\" {} --backend cpu", reader.words.replace("IN", &name));
                let line = if reader.words.starts_with("render") { line } else { line.replace(" --backend cpu", "") };
                let start = Instant::now();
                let mut shell = Command::new("bash");
                shell.current_dir(f).args(["-c", &line, env!("CARGO_BIN_EXE_incise")]).env_remove("DISPLAY").stdin(Stdio::null());
                let mut child = shell.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
                while child.try_wait().unwrap().is_none() {
                    if start.elapsed() > HANGS {
                        child.kill().unwrap();
                        panic!("{line} hangs");
                    }
                    std::thread::sleep(Duration::from_millis(2));
                }
                let output = child.wait_with_output().unwrap();
                let message = stderr(&output);
                assert_eq!(output.status.code(), Some(1), "{line}: {message}");
                // Errors of a scene file have their own wording.
                assert!(message.contains(word) && message.trim().lines().count() == 1 && !message.contains("panicked"), "{line}: {message}");
                let named =
                    message.contains(name.split('.').next().unwrap()) || message.contains("sidecar.raw") || matches!(kind, "nowhere" | "folder");
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
    let corners: Vec<u8> = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
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
        ("list.nhdr", format!("{nrrd}data file: LIST\n../slice-1.raw\n../slice-2.raw\n")),
        ("pattern.nhdr", format!("{nrrd}data file: ../slice-%d.raw 1 2 1\n\n")),
        ("link.nhdr", format!("{nrrd}data file: link.raw\n\n")),
        ("up.mhd", format!("{mhd}../values.raw\n")),
        ("list.mhd", format!("{mhd}LIST\n../slice-1.raw\n../slice-2.raw\n")),
        ("up.gltf", gltf("../corners.bin")),
        ("escaped.gltf", gltf("%2e%2e/corners.bin")),
        ("absolute.gltf", gltf(&f.join("corners.bin").display().to_string())),
    ];
    for (name, content) in &files {
        std::fs::write(inner.join(name), content).unwrap();
    }
    for name in files.iter().map(|f| f.0).chain(["pair.hdr", "array.zarr", "sized.raw"]) {
        let output = incise(&inner, &words(&format!("info {name}")));
        assert!(output.status.code() == Some(1) && stderr(&output).contains("--allow-outside"), "{name}: {}", stderr(&output));
        let output = incise(&inner, &words(&format!("info {name} --allow-outside")));
        assert!(output.status.success(), "{name}: {}", stderr(&output));
    }
    // A URL is not a file.
    std::fs::write(inner.join("address.gltf"), gltf("file:///etc/passwd")).unwrap();
    assert_eq!(incise(&inner, &words("info address.gltf --allow-outside")).status.code(), Some(1));

    // Folders: links to files inside them are followed, others are counted.
    let series = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/readers/phantom/dicom-explicit");
    let (one, other) = (f.join("one"), f.join("other"));
    for folder in [&one, &other] {
        std::fs::create_dir(folder).unwrap();
    }
    for (n, file) in walkdir::WalkDir::new(&series).into_iter().flatten().filter(|e| e.file_type().is_file()).enumerate() {
        std::fs::copy(file.path(), if n < 3 { &one } else { &other }.join(file.file_name())).unwrap();
    }
    for (target, link) in
        [("../other", "others"), ("/", "everything"), ("../other/3-1.dcm", "another.dcm"), ("0-1.dcm", "first-again.dcm"), (".", "itself")]
    {
        symlink(target, one.join(link)).unwrap();
    }
    let slices = |more: &str| {
        let output = incise(f, &words(&format!("info one --json {more}")));
        assert!(output.status.success(), "{}", stderr(&output));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        (report["size"][2].as_u64().unwrap(), report["warnings"].to_string())
    };
    let (count, warnings) = slices("");
    assert!(count == 3 && warnings.contains("3 links") && warnings.contains("not followed"), "{count} {warnings}");
    std::fs::remove_file(one.join("everything")).unwrap();
    let (count, warnings) = slices("--allow-outside");
    assert!(count == 5 && !warnings.contains("not followed"), "{count} {warnings}");
}

/// Any file name that the system allows can be read and written.
pub fn names_that_are_no_text() {
    use std::os::unix::ffi::OsStrExt;
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    inputs(f);
    let odd = |ending: &str| std::ffi::OsStr::from_bytes(&[b"caf\xe9 \xff\x1b[2J.", ending.as_bytes()].concat()).to_owned();
    let copied = |from: &str, ending: &str| std::fs::copy(f.join(from), f.join(odd(ending))).unwrap();
    copied("small.nii", "nii");
    copied("box.obj", "obj");
    std::fs::write(f.join(odd("toml")), "incise = 1\n[volume]\npath = \"small.nii\"\n").unwrap();
    let cases: [(&str, &str, &str); 7] = [
        ("render IN -o OUT --backend cpu --size 16x16 -q", "nii", "png"),
        ("render IN -o OUT --backend cpu --size 16x16 -q", "toml", "png"),
        ("render IN -o OUT --backend cpu --size 16x16 -q --mode surface", "obj", "png"),
        ("render small.nii -o OUT --backend cpu --size 16x16 -q --inside IN", "obj", "png"),
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
        assert!(output.status.success() && f.join(odd(to)).is_file(), "{line}: {}", stderr(&output));
    }
    // Also in a deformation's setting; the message shows the name in printable form.
    let mut setting = OsString::from("field:path=");
    setting.push(odd("nii"));
    let arguments = [words("render small.nii -q -o out.png --backend cpu --deform"), vec![setting]].concat();
    let output = incise(f, &arguments);
    assert!(output.status.code() == Some(1) && !stderr(&output).trim().contains(char::is_control), "{:?}", stderr(&output));
}
