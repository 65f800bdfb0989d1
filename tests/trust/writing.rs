//! Every writer with every kind of destination, standard output, interrupted writes.

use super::{HANGS, WRITERS, Writer, command, incise, inputs, node, stderr, words};
use rustix::fs::FileType;
use std::ffi::OsString;
use std::io::Read;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Output;
use std::time::{Duration, Instant};

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

/// The permission bits of a file.
fn mode_of(path: &Path) -> u32 {
    std::fs::metadata(path).unwrap().mode() & 0o7777
}

/// A writer in a folder with its inputs, and the folder `places` for its destinations.
struct WriterRun<'a> {
    writer: &'a Writer,
    folder: &'a Path,
}

impl WriterRun<'_> {
    /// A destination with the writer's extension.
    fn place(&self, name: &str) -> PathBuf {
        self.folder
            .join("places")
            .join(format!("{name}.{}", self.writer.ending))
    }

    /// The writer's command-line arguments, with a destination in place of `OUT`.
    fn arguments(&self, path: &Path) -> Vec<OsString> {
        self.writer
            .words
            .split_whitespace()
            .map(|w| if w == "OUT" { path.into() } else { w.into() })
            .collect()
    }

    /// Runs the writer with a destination.
    fn run(&self, path: &Path) -> Output {
        incise(self.folder, &self.arguments(path))
    }

    /// Checks that a destination is accepted.
    fn succeeds(&self, path: &Path) {
        let output = self.run(path);
        assert!(
            output.status.success(),
            "{:?}: {}",
            self.arguments(path),
            stderr(&output)
        );
    }

    /// Checks that a destination is refused with exactly one line that contains a word, and that no
    /// file changes.
    fn refused(&self, path: &Path, word: &str) {
        let before = tree(self.folder);
        let output = self.run(path);
        let arguments = self.arguments(path);
        assert_eq!(
            output.status.code(),
            Some(1),
            "{arguments:?}: {}",
            stderr(&output)
        );
        let message = stderr(&output);
        assert!(
            message.contains(word) && message.trim_end().lines().filter(|l| l.contains(word)).count() == 1,
            "{arguments:?}: {message}"
        );
        let after = tree(self.folder);
        // A report may be complete before writing its statistics fails.
        let report = self.folder.join("report");
        let changed: Vec<_> = before
            .iter()
            .filter(|b| !after.contains(b) && !b.0.starts_with(&report))
            .map(|b| &b.0)
            .collect();
        assert!(changed.is_empty(), "{arguments:?} changed {changed:?}");
    }

    /// Checks that a file has the writer's complete content.
    fn complete(&self, path: &Path) {
        assert!(
            is_complete(&std::fs::read(path).unwrap(), self.writer.ending),
            "{}: {}",
            self.writer.words,
            path.display()
        );
    }

    /// A new file has the same mode as any program's new file.
    fn check_new_file(&self) {
        self.succeeds(&self.place("new"));
        self.complete(&self.place("new"));
    }

    /// A replaced file keeps its mode and owner.
    fn check_mode_and_owner(&self) {
        for bits in [0o600, 0o640, 0o755] {
            let path = self.place(&format!("mode-{bits:o}"));
            std::fs::write(&path, "old").unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(bits)).unwrap();
            // Only root can change the owner.
            let given = std::os::unix::fs::chown(&path, Some(1234), Some(4321)).is_ok();
            self.succeeds(&path);
            self.complete(&path);
            assert_eq!(mode_of(&path), bits, "{}", self.writer.words);
            let owner = std::fs::metadata(&path).map(|m| (m.uid(), m.gid())).unwrap();
            assert!(
                !given || owner == (1234, 4321),
                "{}: {owner:?}",
                self.writer.words
            );
        }
    }

    /// A file is written, then replaced, through `/proc/self/cwd`.
    #[cfg(target_os = "linux")]
    fn check_system_name(&self) {
        for _ in 0..2 {
            let name = format!("twice.{}", self.writer.ending);
            self.succeeds(&Path::new("/proc/self/cwd/places").join(name));
            self.complete(&self.place("twice"));
        }
    }

    /// A write-protected file is left unchanged, also for root.
    fn check_protected_file(&self) {
        let protected = self.place("protected");
        std::fs::write(&protected, "old").unwrap();
        std::fs::set_permissions(&protected, std::fs::Permissions::from_mode(0o444)).unwrap();
        self.refused(&protected, "read-only");
        let link = self.place("link-to-protected");
        symlink(&protected, &link).unwrap();
        self.refused(&link, "read-only");
    }

    /// Through a link its target is replaced, and the link stays; a dangling link creates its
    /// target.
    fn check_links(&self) {
        std::fs::create_dir(self.folder.join("elsewhere")).unwrap();
        for (name, exists) in [("link", true), ("dangling", false)] {
            let (link, target) = (
                self.place(name),
                self.folder
                    .join("elsewhere")
                    .join(format!("{name}.{}", self.writer.ending)),
            );
            if exists {
                std::fs::write(&target, "old").unwrap();
            }
            symlink(Path::new("../elsewhere").join(target.file_name().unwrap()), &link).unwrap();
            self.succeeds(&link);
            assert!(link.is_symlink(), "{}", self.writer.words);
            self.complete(&target);
        }
    }

    /// A pipe receives the whole content and is not replaced.
    fn check_pipes(&self) {
        let pipe = self.place("pipe");
        assert!(node(&pipe, FileType::Fifo, (0, 0)));
        let from = pipe.clone();
        let reading = std::thread::spawn(move || std::fs::read(from).unwrap());
        self.succeeds(&pipe);
        assert!(
            is_complete(&reading.join().unwrap(), self.writer.ending),
            "{}",
            self.writer.words
        );
        assert!(
            std::fs::symlink_metadata(&pipe).unwrap().file_type().is_fifo(),
            "{}",
            self.writer.words
        );
        let piped = self.place("link-to-pipe");
        symlink(&pipe, &piped).unwrap();
        let from = pipe.clone();
        let reading = std::thread::spawn(move || std::fs::read(from).unwrap());
        self.succeeds(&piped);
        assert!(
            is_complete(&reading.join().unwrap(), self.writer.ending) && piped.is_symlink(),
            "{}",
            self.writer.words
        );
    }

    /// A device receives the whole content and is not replaced.
    fn check_devices(&self) {
        let (null, full) = (self.place("null"), self.place("full"));
        // Only root can create devices.
        if node(&null, FileType::CharacterDevice, (1, 3)) && node(&full, FileType::CharacterDevice, (1, 7)) {
            let before = std::fs::symlink_metadata(&null).unwrap().rdev();
            self.succeeds(&null);
            self.refused(&full, "No space left");
            for device in [&null, &full] {
                assert!(
                    std::fs::symlink_metadata(device)
                        .unwrap()
                        .file_type()
                        .is_char_device(),
                    "{}",
                    self.writer.words
                );
            }
            assert_eq!(std::fs::symlink_metadata(&null).unwrap().rdev(), before);
        }
    }

    /// A socket receives the whole content and is not replaced.
    fn check_socket(&self) {
        let socket = self.place("socket");
        let listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let reading = std::thread::spawn(move || {
            let mut content = Vec::new();
            listener.accept().unwrap().0.read_to_end(&mut content).unwrap();
            content
        });
        self.succeeds(&socket);
        assert!(
            is_complete(&reading.join().unwrap(), self.writer.ending),
            "{}",
            self.writer.words
        );
        assert!(
            std::fs::symlink_metadata(&socket)
                .unwrap()
                .file_type()
                .is_socket(),
            "{}",
            self.writer.words
        );
    }

    /// No input is overwritten, under any name.
    fn check_inputs(&self) {
        for input in self.writer.reads {
            let endings = input.ends_with(self.writer.ending)
                || self.writer.words.contains("--stats OUT")
                || self.writer.words.contains("--csv OUT");
            if endings {
                self.refused(&self.folder.join(input), "input");
                // Through a path that uses the system's names for open files.
                #[cfg(target_os = "linux")]
                self.refused(&Path::new("/proc/self/cwd").join(input), "input");
            }
            let (link, hard) = (self.place("link-to-input"), self.place("hard-link-to-input"));
            symlink(self.folder.join(input), &link).unwrap();
            self.refused(&link, "input");
            std::fs::hard_link(self.folder.join(input), &hard).unwrap();
            self.refused(&hard, "input");
            std::fs::remove_file(link).unwrap();
            std::fs::remove_file(hard).unwrap();
        }
    }
}

/// Writers against destinations.
pub fn every_writer_into_every_place() {
    for writer in WRITERS {
        let folder = tempfile::tempdir().unwrap();
        let f = folder.path();
        inputs(f);
        std::fs::create_dir(f.join("places")).unwrap();
        let run = WriterRun { writer, folder: f };
        run.check_new_file();
        run.check_mode_and_owner();
        #[cfg(target_os = "linux")]
        run.check_system_name();
        run.check_protected_file();
        run.check_links();
        run.check_pipes();
        run.check_devices();
        run.check_socket();
        run.check_inputs();
        assert!(
            !tree(f)
                .iter()
                .any(|(path, _)| path.to_string_lossy().ends_with(".part")),
            "{} left something",
            writer.words
        );
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
        assert!(
            output.status.success() && is_complete(&output.stdout, "png"),
            "{name}: {}",
            stderr(&output)
        );
    }
    let output = incise(f, &words(&format!("{render} picture.png --stats /dev/stdout")));
    assert!(
        output.status.success() && is_complete(&output.stdout, "json"),
        "{}",
        stderr(&output)
    );
    for more in ["--stats -", "--json", "--stats /dev/stdout"] {
        let output = incise(f, &words(&format!("{render} - {more}")));
        assert!(
            output.status.code() == Some(1) && stderr(&output).contains("standard output"),
            "{}",
            stderr(&output)
        );
    }
    for (a, b) in [
        ("one.png", "one.png"),
        ("one.png", "./one.png"),
        ("one.png", "link.png"),
    ] {
        let link = f.join("link.png");
        if !link.is_symlink() {
            symlink("one.png", link).unwrap();
        }
        let output = incise(f, &words(&format!("{render} {a} --stats {b}")));
        assert!(
            output.status.code() == Some(1) && stderr(&output).contains("same file"),
            "{}",
            stderr(&output)
        );
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
            output.status.code() == Some(1)
                && message.contains("standard output")
                && message.lines().count() == 1,
            "{line}: {:?} {message}",
            output.status
        );
        let mut child = command(f, &words(line)).spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert!(
            output.status.success() && output.stderr.is_empty(),
            "{line}: {}",
            stderr(&output)
        );
        // Messages that cannot be printed are dropped, since the failure cannot be reported
        // anywhere.
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        assert!(
            command(f, &words(line))
                .stderr(full)
                .output()
                .unwrap()
                .status
                .success(),
            "{line}"
        );
    }
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    assert_eq!(
        command(f, &words("info nowhere.nii"))
            .stderr(full)
            .status()
            .unwrap()
            .code(),
        Some(1)
    );
}

/// Whether this process, and thus each of its children, was started with a signal ignored; unknown
/// counts as no.
fn is_ignored(signal: rustix::process::Signal) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status
        .lines()
        .find_map(|l| u64::from_str_radix(l.strip_prefix("SigIgn:")?.trim(), 16).ok());
    ignored.is_some_and(|set| set >> (signal.as_raw() - 1) & 1 == 1)
}

/// Partial files of an interrupted run are removed; those of a killed run are removed by the next
/// run.
pub fn nothing_unfinished_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let left = || -> Vec<String> {
        let names = std::fs::read_dir(f)
            .unwrap()
            .flatten()
            .map(|e| e.file_name().to_string_lossy().into_owned());
        names.filter(|n| n.ends_with(".part")).collect()
    };
    // Long enough to be interrupted: the volume is written slice by slice.
    let bake = words("bake phantom:checker:size=400 -o out.nii --deform twist --interpolation cubic -q");
    for signal in [
        rustix::process::Signal::INT,
        rustix::process::Signal::TERM,
        rustix::process::Signal::HUP,
        rustix::process::Signal::KILL,
    ] {
        // Under `nohup`, for example, the signal stays ignored.
        if is_ignored(signal) {
            continue;
        }
        let mut child = command(f, &bake).spawn().unwrap();
        let start = Instant::now();
        let mut grown = false;
        while !grown {
            assert!(
                start.elapsed() < HANGS && child.try_wait().unwrap().is_none(),
                "nothing was written"
            );
            std::thread::sleep(Duration::from_millis(1));
            grown = left()
                .iter()
                .any(|n| std::fs::metadata(f.join(n)).is_ok_and(|m| m.len() > 0));
        }
        rustix::process::kill_process(rustix::process::Pid::from_child(&child), signal).unwrap();
        let status = child.wait().unwrap();
        assert_eq!(
            std::os::unix::process::ExitStatusExt::signal(&status),
            Some(signal.as_raw()),
            "{status}"
        );
        assert!(!f.join("out.nii").exists());
        assert_eq!(
            left().is_empty(),
            signal != rustix::process::Signal::KILL,
            "{signal:?}: {:?}",
            left()
        );
    }
    // A recent partial file is not removed yet: it may belong to a running process.
    let next = words("render phantom:ball -o a.png --backend cpu --size 16x16 -q");
    assert!(incise(f, &next).status.success() && left().len() == 1);
    let long_ago = std::time::SystemTime::now() - Duration::from_secs(600);
    std::fs::File::options()
        .write(true)
        .open(f.join(&left()[0]))
        .unwrap()
        .set_modified(long_ago)
        .unwrap();
    assert!(
        incise(f, &next).status.success() && left().is_empty(),
        "{:?}",
        left()
    );
}
