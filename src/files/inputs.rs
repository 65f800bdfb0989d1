//! The inputs of this run: files by device and inode, so that a file is recognised under any other
//! name, link or mount; and folders that are read as a whole.
//!
//! The record belongs to the process, as open files do: readers need not pass it around and cannot
//! forget to update it.

use std::collections::HashMap;
use std::fs::Metadata;
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

/// The identity of a file, independent of its name.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct FileId {
    #[cfg(unix)]
    device_and_inode: (u64, u64),
    #[cfg(not(unix))]
    path: PathBuf,
    /// An inode is reused when its file is deleted; the new file has a later creation time.
    born: Option<SystemTime>,
}

impl FileId {
    /// The file that a path leads to; none if it does not exist.
    pub fn of(path: &Path) -> Option<Self> {
        Self::with(path, &std::fs::metadata(path).ok()?)
    }

    #[cfg(unix)]
    fn with(_path: &Path, metadata: &Metadata) -> Option<Self> {
        use std::os::unix::fs::MetadataExt;
        Some(Self {
            device_and_inode: (metadata.dev(), metadata.ino()),
            born: metadata.created().ok(),
        })
    }

    #[cfg(not(unix))]
    fn with(path: &Path, metadata: &Metadata) -> Option<Self> {
        Some(Self {
            path: path.canonicalize().ok()?,
            born: metadata.created().ok(),
        })
    }
}

static READ: LazyLock<Mutex<HashMap<FileId, PathBuf>>> = LazyLock::new(Mutex::default);

fn read() -> MutexGuard<'static, HashMap<FileId, PathBuf>> {
    // Entries are only ever added and removed as a whole.
    READ.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Registers a file as read.
pub fn register(path: &Path, metadata: &Metadata) {
    if let Some(id) = FileId::with(path, metadata) {
        read().entry(id).or_insert_with(|| path.to_owned());
    }
}

/// Registers a file, or everything in a folder, that a third-party library is about to read.
pub fn note_path(path: &Path) {
    if let Ok(metadata) = std::fs::metadata(path) {
        register(path, &metadata);
    }
}

/// The name under which the file at `path` was read, or the folder containing it that was read as a
/// whole; none if neither applies.
pub fn name_of(path: &Path) -> Option<PathBuf> {
    let registered = read();
    if registered.is_empty() {
        return None;
    }
    let file = FileId::of(path).and_then(|id| registered.get(&id).cloned());
    if file.is_some() {
        return file;
    }
    // For a file that does not exist yet, its folder is checked.
    let absolute = path.canonicalize().or_else(|_| {
        let parent = path
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        parent
            .canonicalize()
            .map(|p| p.join(path.file_name().unwrap_or_default()))
    });
    let absolute = absolute.ok()?;
    absolute
        .ancestors()
        .skip(1)
        .find_map(|folder| FileId::of(folder).and_then(|id| registered.get(&id).cloned()))
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
        // Another file in the same place is a different file.
        std::fs::rename(at("b"), at("a")).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(name_of(&at("a")), None);
    }
}
