//! A folder of output files. It is filled under a temporary name next to its destination and
//! renamed at the end, so that it is there completely or not at all. A folder that holds anything
//! is refused: files of an earlier run would mix with the new ones.

use super::inputs;
use super::unfinished::PartFolder;
use crate::{Error, Result};
use std::fs::OpenOptions;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// A folder to be written. The destination is checked before the work starts; nothing is created
/// there until the work is done.
pub struct OutputFolder {
    /// The path as given.
    path: PathBuf,
    /// The folder to be made or filled, with links resolved.
    target: PathBuf,
    part: PartFolder,
}

/// Whether an output path names a folder: an existing one, one with a separator at its end, or a
/// name without extension that does not exist.
pub fn names_folder(path: &Path) -> bool {
    let separator = path
        .as_os_str()
        .as_encoded_bytes()
        .last()
        .is_some_and(|b| *b == b'/' || cfg!(windows) && *b == b'\\');
    match path.metadata() {
        Ok(there) => there.is_dir(),
        Err(_) => separator || path.extension().is_none() && path != Path::new("-"),
    }
}

impl OutputFolder {
    /// Checks that a folder can be written: it does not exist yet, or is empty.
    ///
    /// # Errors
    /// A file of that name, or a folder that is not empty, or is or lies in an input; a folder
    /// around it that does not exist or cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let writing = |e| Error::io(path, "writing", e);
        // Without a separator at its end.
        let mut target: PathBuf = path.components().collect();
        if target.is_dir() {
            target = target.canonicalize().map_err(writing)?;
            let mut entries = std::fs::read_dir(&target).map_err(|e| Error::io(path, "reading", e))?;
            if entries.next().is_some() {
                return Err(Error::file(
                    path,
                    "is a folder that is not empty; name a new one for the slices",
                ));
            }
        } else if target.symlink_metadata().is_ok() {
            return Err(Error::file(
                path,
                "is a file; choose a new folder for the slices, or a file name with an extension",
            ));
        }
        if let Some(read) = inputs::name_of(&target) {
            let problem = format!(
                "is part of {}, an input of this run; choose another folder",
                read.display()
            );
            return Err(Error::file(path, problem));
        }
        let beside = target
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        if !beside.is_dir() {
            let problem = format!(
                "the folder {} does not exist; create it, or choose another one",
                beside.display()
            );
            return Err(Error::file(path, problem));
        }
        let part = PartFolder::in_folder(beside).map_err(writing)?;
        Ok(Self {
            path: path.to_owned(),
            target,
            part,
        })
    }

    /// The path as given, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Adds a file.
    ///
    /// # Errors
    /// A full disk.
    pub fn write(&self, name: &str, content: &[u8]) -> Result<()> {
        std::fs::write(self.part.path().join(name), content)
            .map_err(|e| Error::io(&self.path.join(name), "writing", e))
    }

    /// Replaces bytes of a file that was added: each at its offset from the start.
    ///
    /// # Errors
    /// No such file, a full disk.
    pub fn replace_bytes<'a>(
        &self,
        name: &str,
        replacements: impl IntoIterator<Item = (u64, &'a [u8])>,
    ) -> Result<()> {
        let writing = |e| Error::io(&self.path.join(name), "writing", e);
        let mut file = OpenOptions::new()
            .write(true)
            .open(self.part.path().join(name))
            .map_err(writing)?;
        for (offset, bytes) in replacements {
            file.seek(SeekFrom::Start(offset))
                .and_then(|_| file.write_all(bytes))
                .map_err(writing)?;
        }
        Ok(())
    }

    /// Moves the folder into place.
    ///
    /// # Errors
    /// A destination that something was written into meanwhile.
    pub fn finish(self) -> Result<()> {
        self.part
            .persist(&self.target)
            .map_err(|e| Error::io(&self.path, "writing", e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .unwrap_or_else(|e| panic!("{e}"))
            .flatten()
            .map(|e| e.file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_folder_is_there_completely_or_not_at_all() {
        let around = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let path = around.path().join("out/");
        let folder = OutputFolder::create(&path).unwrap_or_else(|e| panic!("{e}"));
        folder.write("a", b"0123").unwrap_or_else(|e| panic!("{e}"));
        drop(folder);
        assert_eq!(names(around.path()), [""; 0]);
        let folder = OutputFolder::create(&path).unwrap_or_else(|e| panic!("{e}"));
        folder
            .write("a", b"0123")
            .and_then(|()| folder.replace_bytes("a", [(1, &b"xy"[..])]))
            .and_then(|()| folder.finish())
            .unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(names(around.path()), ["out"]);
        for (name, is_folder) in [
            ("out", true),
            ("out/a", false),
            ("new", true),
            ("new.nii/", true),
            ("new.nii", false),
        ] {
            assert_eq!(names_folder(&around.path().join(name)), is_folder, "{name}");
        }
        assert!(!names_folder(Path::new("-")) && !names_folder(Path::new("/dev/null")));
        assert_eq!(std::fs::read(path.join("a")).ok().as_deref(), Some(&b"0xy3"[..]));
        // It is not filled a second time.
        assert!(OutputFolder::create(&path).is_err_and(|e| e.to_string().contains("not empty")));
        assert!(OutputFolder::create(&path.join("a")).is_err_and(|e| e.to_string().contains("is a file")));
        assert!(OutputFolder::create(&around.path().join("no/such")).is_err());
        let empty = around.path().join("empty");
        std::fs::create_dir(&empty).unwrap_or_else(|e| panic!("{e}"));
        OutputFolder::create(&empty)
            .and_then(|f| f.write("b", b"").and_then(|()| f.finish()))
            .unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(names(&empty), ["b"]);
    }
}
