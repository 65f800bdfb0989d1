//! What was read in this run: files by device and inode, so that no other name, link or mount hides that it is the same file; and folders that
//! are read as a whole.
//!
//! The record belongs to the process, as open files do: no reader has to be handed it, and none can forget to fill it in.

use std::collections::HashMap;
use std::fs::Metadata;
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

/// What a file is, whatever it is called.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct FileId {
    #[cfg(unix)]
    device_and_inode: (u64, u64),
    #[cfg(not(unix))]
    path: PathBuf,
    /// An inode is used again when its file is gone; the new file was born later.
    born: Option<SystemTime>,
}

impl FileId {
    /// Of the file that a path leads to; none if there is none.
    pub fn of(path: &Path) -> Option<Self> {
        Self::with(path, &std::fs::metadata(path).ok()?)
    }

    #[cfg(unix)]
    fn with(_path: &Path, metadata: &Metadata) -> Option<Self> {
        use std::os::unix::fs::MetadataExt;
        Some(Self { device_and_inode: (metadata.dev(), metadata.ino()), born: metadata.created().ok() })
    }

    #[cfg(not(unix))]
    fn with(path: &Path, metadata: &Metadata) -> Option<Self> {
        Some(Self { path: path.canonicalize().ok()?, born: metadata.created().ok() })
    }
}

static READ: LazyLock<Mutex<HashMap<FileId, PathBuf>>> = LazyLock::new(Mutex::default);

fn read() -> MutexGuard<'static, HashMap<FileId, PathBuf>> {
    // Entries are only ever added and removed whole.
    READ.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Notes that a file is read.
pub fn register(path: &Path, metadata: &Metadata) {
    if let Some(id) = FileId::with(path, metadata) {
        read().entry(id).or_insert_with(|| path.to_owned());
    }
}

/// Notes that a library of others is about to read a file, or everything in a folder.
pub fn note_path(path: &Path) {
    if let Ok(metadata) = std::fs::metadata(path) {
        register(path, &metadata);
    }
}

/// The name under which a file was read that `path` leads to, or the folder in which it lies that was read as a whole; none if it is neither.
pub fn name_of(path: &Path) -> Option<PathBuf> {
    let registered = read();
    if registered.is_empty() {
        return None;
    }
    let file = FileId::of(path).and_then(|id| registered.get(&id).cloned());
    if file.is_some() {
        return file;
    }
    // Of a file that is not there yet, the folder is.
    let absolute = path.canonicalize().or_else(|_| {
        let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        parent.canonicalize().map(|p| p.join(path.file_name().unwrap_or_default()))
    });
    let absolute = absolute.ok()?;
    absolute.ancestors().skip(1).find_map(|folder| FileId::of(folder).and_then(|id| registered.get(&id).cloned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_known_under_every_name() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let at = |name: &str| folder.path().join(name);
        for name in ["a", "b", "whole/c"] {
            std::fs::create_dir_all(at(name).parent().unwrap_or(Path::new("")))
                .and_then(|()| std::fs::write(at(name), name))
                .unwrap_or_else(|e| panic!("{e}"));
        }
        std::fs::hard_link(at("a"), at("a-too")).unwrap_or_else(|e| panic!("{e}"));
        note_path(&at("a"));
        note_path(&at("whole"));
        for name in ["a", "a-too", "whole/../a", "whole/c", "whole/new"] {
            assert!(name_of(&at(name)).is_some(), "{name}");
        }
        for name in ["b", "new", "no/such/folder"] {
            assert_eq!(name_of(&at(name)), None, "{name}");
        }
        // Another file in its place is another.
        std::fs::rename(at("b"), at("a")).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(name_of(&at("a")), None);
    }
}
