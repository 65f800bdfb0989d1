//! Output. A file is written completely or not at all: it is written next to its destination and
//! renamed into place. A link is followed and its target replaced; mode and owner are preserved; a
//! file that is write-protected, or was read in this run, is refused. Pipes, sockets and devices
//! are not replaced: they are opened and written to.

use super::inputs;
use super::unfinished::PartFile;
use crate::{Error, Result};
use std::fs::{Metadata, OpenOptions};
use std::io::{ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};

/// Longest chain of links that is followed.
const MAX_LINKS: usize = 40;

/// A file to be written. The destination is checked before the work starts, so that an output that
/// cannot be written is reported at once; nothing is created there until the work is done.
pub struct OutputFile {
    /// The path as given.
    path: PathBuf,
    destination: Destination,
    /// Whether it may replace a file that was read: the program's own files, and a document being
    /// saved.
    replaces_read: bool,
}

enum Destination {
    /// A file, with links resolved.
    File(PathBuf),
    /// A pipe, a device, or an open file under one of the system's names for it: opened and written
    /// to.
    Stream,
    #[cfg(unix)]
    Socket,
    StandardOutput,
    StandardError,
}

/// Standard output: `-` and the system's names for it.
pub fn standard_output() -> OutputFile {
    OutputFile {
        path: PathBuf::from("standard output"),
        destination: Destination::StandardOutput,
        replaces_read: false,
    }
}

/// Checks that two outputs are not the same file.
///
/// # Errors
/// They are the same; the error names the second's option.
pub fn check_distinct(first: &Path, option: &str, second: &Path) -> Result<()> {
    let same = match (inputs::FileId::of(first), inputs::FileId::of(second)) {
        // A stream can take both, one after the other.
        (Some(a), Some(b)) => a == b && std::fs::metadata(first).is_ok_and(|m| m.is_file()),
        // Neither exists yet: compare the targets of their links.
        (None, None) => {
            matches!((target(first), target(second)), (Ok(a), Ok(b)) if absolute(&a) == absolute(&b))
        }
        _ => false,
    };
    if same {
        Err(Error::value(
            format!("{option} {}", second.display()),
            "names the same file as another output; choose another name",
        ))
    } else {
        Ok(())
    }
}

/// The absolute path of a file that need not exist, with the links of its folder resolved.
fn absolute(path: &Path) -> PathBuf {
    let folder = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    let folder = folder
        .canonicalize()
        .or_else(|_| std::path::absolute(folder))
        .unwrap_or_else(|_| folder.to_owned());
    path.file_name().map_or(folder.clone(), |name| folder.join(name))
}

/// The target of a path after following links, whether or not it exists.
fn target(path: &Path) -> Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..MAX_LINKS {
        let Ok(next) = std::fs::read_link(&path) else {
            return Ok(path);
        };
        path = path.parent().unwrap_or(Path::new("")).join(next);
    }
    Err(Error::file(
        &path,
        "is a link that leads back to itself; choose another name",
    ))
}

/// Whether a path is, or links to, one of the system's names for an open file of the process
/// (`/dev/fd/3`, `/proc/self/fd/3`): a link to a file that need not have a name of its own.
fn names_an_open_file(path: &Path) -> bool {
    let mut path = path.to_owned();
    for _ in 0..MAX_LINKS {
        let folder = path
            .parent()
            .and_then(|f| f.canonicalize().ok())
            .unwrap_or_default();
        if folder.ends_with("fd") && (folder.starts_with("/proc") || folder.starts_with("/dev")) {
            return cfg!(unix);
        }
        let Ok(next) = std::fs::read_link(&path) else {
            break;
        };
        path = folder.join(next);
    }
    false
}

/// Checks that an existing file may be replaced.
///
/// # Errors
/// It is write-protected.
fn check_replaceable(path: &Path, there: &Metadata) -> Result<()> {
    if there.permissions().readonly() {
        Err(Error::file(
            path,
            "is read-only; choose another name, or make it writable",
        ))
    } else {
        Ok(())
    }
}

impl OutputFile {
    /// Checks that `path` can be written.
    ///
    /// # Errors
    /// A folder that does not exist or cannot be written; a path that is a folder, is
    /// write-protected, or was read in this run.
    pub fn create(path: &Path) -> Result<Self> {
        Self::tried(path, false)
    }

    /// As [`Self::create`] for a file that is both read and written: a document being saved again,
    /// settings.
    ///
    /// # Errors
    /// As [`Self::create`], except that the file may be an input.
    pub fn replacing(path: &Path) -> Result<Self> {
        Self::tried(path, true)
    }

    /// As [`Self::create`], with `-` for standard output.
    ///
    /// # Errors
    /// As [`Self::create`]; standard output that is a terminal, where binary data is useless.
    pub fn create_or_standard(path: &Path) -> Result<Self> {
        if path != Path::new("-") {
            return Self::create(path);
        }
        if std::io::stdout().is_terminal() {
            return Err(Error::value(
                "-",
                "standard output is a terminal; redirect it to a file or a pipe, or name an output file",
            ));
        }
        Ok(standard_output())
    }

    fn tried(path: &Path, replaces_read: bool) -> Result<Self> {
        let writing = |e| Error::io(path, "writing", e);
        let of = |destination| {
            Ok(Self {
                path: path.to_owned(),
                destination,
                replaces_read,
            })
        };
        match path.to_str() {
            Some("/dev/stdout" | "/dev/fd/1" | "/proc/self/fd/1") if cfg!(unix) => {
                return of(Destination::StandardOutput);
            }
            Some("/dev/stderr" | "/dev/fd/2" | "/proc/self/fd/2") if cfg!(unix) => {
                return of(Destination::StandardError);
            }
            _ => {}
        }
        let output = match std::fs::metadata(path) {
            Ok(there) if there.is_dir() => return Err(Error::file(path, "is a folder; name a file in it")),
            Ok(there) if !there.is_file() || names_an_open_file(path) => {
                check_may_be_written(path)?;
                return of(stream(&there));
            }
            Ok(there) => {
                check_replaceable(path, &there)?;
                // Opened without changes, to check with the system whether it may be written.
                OpenOptions::new().write(true).open(path).map_err(writing)?;
                of(Destination::File(target(path)?))?
            }
            Err(e) if e.kind() == ErrorKind::NotFound => of(Destination::File(target(path)?))?,
            Err(e) => return Err(writing(e)),
        };
        output.check()?;
        output.part()?;
        Ok(output)
    }

    /// Checks again that the file is not an input: more inputs are known once they have been
    /// loaded.
    ///
    /// # Errors
    /// It is a file that was read in this run.
    pub fn check(&self) -> Result<()> {
        let target = match &self.destination {
            Destination::File(target) => target,
            // Written as a stream, but still a regular file.
            Destination::Stream if std::fs::metadata(&self.path).is_ok_and(|m| m.is_file()) => &self.path,
            _ => return Ok(()),
        };
        match inputs::name_of(target).filter(|_| !self.replaces_read) {
            None => Ok(()),
            Some(read) if read == self.path => Err(Error::file(
                &self.path,
                "is an input of this run, and inputs are never overwritten; choose another name",
            )),
            Some(read) => {
                let problem = format!(
                    "is, or is part of, {}, an input of this run, and inputs are never overwritten; choose another name",
                    read.display()
                );
                Err(Error::file(&self.path, problem))
            }
        }
    }

    /// Whether it is a regular file, rather than a stream.
    pub fn is_file(&self) -> bool {
        matches!(self.destination, Destination::File(_))
    }

    /// Whether it is standard output: `-`, or one of the system's own names for it.
    pub fn is_standard_output(&self) -> bool {
        matches!(self.destination, Destination::StandardOutput)
    }

    /// A new file next to the destination.
    fn part(&self) -> Result<Option<PartFile>> {
        let Destination::File(target) = &self.destination else {
            return Ok(None);
        };
        let folder = target
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        if !folder.is_dir() {
            return Err(Error::file(
                &self.path,
                format!(
                    "the folder {} does not exist; create it, or choose another one",
                    folder.display()
                ),
            ));
        }
        PartFile::in_folder(folder)
            .map(Some)
            .map_err(|e| Error::io(&self.path, "writing", e))
    }

    /// Writes the content and moves the file into place.
    ///
    /// # Errors
    /// A full disk, a destination that cannot be replaced.
    pub fn finish(self, content: &[u8]) -> Result<()> {
        let path = self.path.clone();
        self.finish_with(|file| {
            file.write_all(content)
                .map_err(|e| Error::io(&path, "writing", e))
        })
    }

    /// As [`Self::finish`], with the content written piece by piece. A closed reader of standard
    /// output ends the output without an error.
    ///
    /// # Errors
    /// As [`Self::finish`], and errors from `write`.
    pub fn finish_with(self, write: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
        self.check()?;
        let writing = |e| Error::io(&self.path, "writing", e);
        match &self.destination {
            Destination::File(target) => {
                let Some(mut part) = self.part()? else {
                    return Ok(());
                };
                buffered(part.file().map_err(writing)?, &self.path, write)?;
                self.finish_part(part, target)
            }
            Destination::Stream => {
                let mut options = OpenOptions::new();
                // An open file named by its descriptor (`>> log`) is shared with its opener, so it
                // is appended to.
                options.write(true).append(names_an_open_file(&self.path));
                buffered(options.open(&self.path).map_err(writing)?, &self.path, write)
            }
            #[cfg(unix)]
            Destination::Socket => buffered(
                std::os::unix::net::UnixStream::connect(&self.path).map_err(writing)?,
                &self.path,
                write,
            ),
            Destination::StandardOutput => match buffered(std::io::stdout().lock(), &self.path, write) {
                Err(Error::Io { source, .. }) if source.kind() == ErrorKind::BrokenPipe => Ok(()),
                done => done,
            },
            Destination::StandardError => buffered(std::io::stderr().lock(), &self.path, write),
        }
    }

    /// As [`Self::finish_with`] for a program that writes a file by its name; anything but a
    /// regular file is refused.
    ///
    /// # Errors
    /// As [`Self::finish_with`]; a pipe, socket or device.
    pub fn finish_by_path(self, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
        self.check()?;
        let Destination::File(target) = &self.destination else {
            return Err(Error::file(
                &self.path,
                "is a pipe, a socket, a device or an open file, and this output needs a file of its own; name one",
            ));
        };
        let Some(part) = self.part()? else { return Ok(()) };
        write(part.path())?;
        self.finish_part(part, target)
    }

    fn finish_part(&self, mut part: PartFile, target: &Path) -> Result<()> {
        let writing = |e| Error::io(&self.path, "writing", e);
        let file = part.file().map_err(writing)?;
        file.sync_all().map_err(writing)?;
        // Another process may have changed it since the check.
        if let Ok(before) = std::fs::symlink_metadata(target) {
            if !before.is_file() {
                return Err(Error::file(
                    &self.path,
                    "was replaced by something other than a file during writing; choose another name",
                ));
            }
            check_replaceable(&self.path, &before)?;
            keep_owner_and_mode(file, &before);
        }
        part.persist(target).map_err(writing)
    }
}

/// Writes through a buffer and flushes it.
fn buffered<W: Write>(to: W, path: &Path, write: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    let mut buffer = std::io::BufWriter::with_capacity(1 << 20, to);
    let written = write(&mut buffer).and_then(|()| buffer.flush().map_err(|e| Error::io(path, "writing", e)));
    if written.is_err() {
        // Discards the rest of the buffer, which dropping would write.
        let _ = buffer.into_parts();
    }
    written
}

fn stream(there: &Metadata) -> Destination {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if there.file_type().is_socket() {
            return Destination::Socket;
        }
    }
    let _ = there;
    Destination::Stream
}

/// Checks the write permission without opening: opening a pipe waits for its reader, and opening a
/// device can have any effect.
fn check_may_be_written(path: &Path) -> Result<()> {
    #[cfg(unix)]
    rustix::fs::access(path, rustix::fs::Access::WRITE_OK)
        .map_err(|e| Error::io(path, "writing", e.into()))?;
    let _ = path;
    Ok(())
}

/// Copies owner and mode of the replaced file to the new one. If the process may not change the
/// owner, it tries the group alone.
fn keep_owner_and_mode(file: &std::fs::File, before: &Metadata) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
        let own = file.metadata().ok();
        if own.is_none_or(|o| (o.uid(), o.gid()) != (before.uid(), before.gid())) {
            let _not_allowed = fchown(file, Some(before.uid()), Some(before.gid()))
                .or_else(|_| fchown(file, None, Some(before.gid())));
        }
        let _not_allowed = file.set_permissions(std::fs::Permissions::from_mode(before.mode() & 0o7777));
    }
    #[cfg(not(unix))]
    let _not_allowed = file.set_permissions(before.permissions());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_partial_file_is_left() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let path = folder.path().join("a.png");
        drop(OutputFile::create(&path));
        assert_eq!(
            std::fs::read_dir(folder.path()).map(Iterator::count).ok(),
            Some(0)
        );
        OutputFile::create(&path)
            .and_then(|o| o.finish(b"x"))
            .unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(std::fs::read(&path).ok().as_deref(), Some(&b"x"[..]));
        assert!(OutputFile::create(&folder.path().join("no/such/a.png")).is_err());
        assert!(OutputFile::create(folder.path()).is_err());
        let failing = OutputFile::create(&path).and_then(|o| {
            o.finish_with(|f| {
                f.write_all(b"half")
                    .map_err(|e| Error::io(&path, "", e))
                    .and(Err(Error::Cancelled))
            })
        });
        assert!(failing.is_err());
        assert_eq!(std::fs::read(&path).ok().as_deref(), Some(&b"x"[..]));
        assert_eq!(
            std::fs::read_dir(folder.path()).map(Iterator::count).ok(),
            Some(1)
        );
    }

    #[test]
    fn what_was_read_is_not_replaced_unless_it_is_a_document() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, "x").unwrap_or_else(|e| panic!("{e}"));
        let late = OutputFile::create(&path).unwrap_or_else(|e| panic!("{e}"));
        super::super::input::text(&path, 10, "scene").unwrap_or_else(|e| panic!("{e}"));
        let error_text = |r: Result<()>| r.err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error_text(late.finish(b"y")).contains("is an input"));
        assert!(error_text(OutputFile::create(&path).map(drop)).contains("is an input"));
        assert_eq!(
            error_text(OutputFile::replacing(&path).and_then(|o| o.finish(b"y"))),
            ""
        );
        assert_eq!(std::fs::read(&path).ok().as_deref(), Some(&b"y"[..]));
    }

    /// A file that appears at the destination during writing is not replaced, unless it may be
    /// replaced.
    #[cfg(unix)]
    #[test]
    fn what_appears_meanwhile_is_left() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        type Case = (&'static str, fn(&Path), Option<&'static str>);
        let made: [Case; 4] = [
            (
                "file",
                |p| std::fs::write(p, "old").unwrap_or_else(|e| panic!("{e}")),
                None,
            ),
            (
                "link",
                |p| std::os::unix::fs::symlink("elsewhere", p).unwrap_or_else(|e| panic!("{e}")),
                Some("other than a file"),
            ),
            (
                "folder",
                |p| std::fs::create_dir(p).unwrap_or_else(|e| panic!("{e}")),
                Some("other than a file"),
            ),
            (
                "protected",
                |p| {
                    std::fs::write(p, "old").unwrap_or_else(|e| panic!("{e}"));
                    std::fs::set_permissions(p, std::fs::Permissions::from_mode(0o444))
                        .unwrap_or_else(|e| panic!("{e}"));
                },
                Some("read-only"),
            ),
        ];
        for (name, make, refusal) in made {
            let path = folder.path().join(name);
            let output = OutputFile::create(&path).unwrap_or_else(|e| panic!("{e}"));
            make(&path);
            let before = std::fs::symlink_metadata(&path).map(|m| m.file_type()).ok();
            let error_text = output.finish(b"new").err().map(|e| e.to_string());
            assert_eq!(error_text.is_some(), refusal.is_some(), "{name}: {error_text:?}");
            assert!(
                error_text
                    .unwrap_or_default()
                    .contains(refusal.unwrap_or_default()),
                "{name}"
            );
            assert_eq!(
                std::fs::symlink_metadata(&path).map(|m| m.file_type()).ok(),
                before,
                "{name}"
            );
        }
        assert_eq!(
            std::fs::read(folder.path().join("file")).ok().as_deref(),
            Some(&b"new"[..])
        );
        assert_eq!(
            std::fs::read_dir(folder.path()).map(Iterator::count).ok(),
            Some(4)
        );
    }

    #[cfg(unix)]
    #[test]
    fn two_names_of_one_file() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("a"), "x").unwrap_or_else(|e| panic!("{e}"));
        for (target, link) in [("a", "link"), ("new", "dangling"), ("loop", "loop")] {
            std::os::unix::fs::symlink(target, at(link)).unwrap_or_else(|e| panic!("{e}"));
        }
        for (one, other, same) in [
            ("a", "link", true),
            ("a", "a", true),
            ("new", "dangling", true),
            ("new", "other", false),
            ("a", "other", false),
            ("new", "./new", true),
        ] {
            assert_eq!(
                check_distinct(&at(one), "--stats", &at(other)).is_err(),
                same,
                "{one} {other}"
            );
        }
        assert!(check_distinct(Path::new("/dev/null"), "--stats", Path::new("/dev/null")).is_ok());
        assert!(OutputFile::create(&at("loop")).is_err());
    }
}
