//! References from one file to another. A header may name the file that holds its values, but must
//! not make the program read files elsewhere on the machine: input files are untrusted. In folders
//! that are read as a whole, the same rule applies to links.

use crate::{Error, Result};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether files may refer to files outside their folders.
static OUTSIDE: AtomicBool = AtomicBool::new(false);

/// Allows files to refer to files outside their own folders, for the rest of this run:
/// `--allow-outside`.
pub fn allow_outside() {
    OUTSIDE.store(true, Ordering::Relaxed);
}

/// Whether files may refer to files outside their own folders.
pub fn outside_is_allowed() -> bool {
    OUTSIDE.load(Ordering::Relaxed)
}

/// The file that `from` refers to as `name`: in the folder of `from`, or below it.
///
/// # Errors
/// A name that leads out of that folder, by itself or by a link, unless this is allowed.
pub fn sibling_file(from: &Path, name: &str) -> Result<PathBuf> {
    let folder = from
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    file_in_folder(from, folder, name)
}

/// As [`sibling_file`], in a folder other than that of `from`.
///
/// # Errors
/// As [`sibling_file`].
pub fn file_in_folder(from: &Path, folder: &Path, name: &str) -> Result<PathBuf> {
    let file = if folder == Path::new(".") {
        PathBuf::from(name)
    } else {
        folder.join(name)
    };
    if !outside_is_allowed() && (climbs(Path::new(name)) || leads_out(folder, &file)) {
        let problem = format!(
            "refers to the file {name}, which is outside its folder; move that file into the folder, or use --allow-outside"
        );
        return Err(Error::file(from, problem));
    }
    Ok(file)
}

/// Whether a name leads out of the folder in which it starts.
fn climbs(name: &Path) -> bool {
    let mut depth = 0i32;
    name.components().any(|part| {
        match part {
            Component::Normal(_) => depth += 1,
            Component::ParentDir => depth -= 1,
            Component::CurDir => {}
            Component::RootDir | Component::Prefix(_) => return true,
        }
        depth < 0
    })
}

/// Whether links lead from a folder to a file outside it. A file that does not exist leads nowhere.
pub fn leads_out(folder: &Path, file: &Path) -> bool {
    matches!((folder.canonicalize(), file.canonicalize()), (Ok(folder), Ok(file)) if !file.starts_with(&folder))
}

/// Whether an entry of a folder that is read as a whole is a link to a file outside it, which is
/// not followed.
pub fn is_link_out(folder: &Path, entry: &Path) -> bool {
    !outside_is_allowed() && entry.is_symlink() && leads_out(folder, entry)
}

/// The notice about links that were not followed; none if there are none.
pub fn links_left_out(links: &[PathBuf]) -> Option<String> {
    let first = links.first()?;
    let name = first.file_name().unwrap_or(first.as_os_str()).to_string_lossy();
    Some(match links.len() {
        1 => format!(
            "the link {name} leads out of this folder and was not followed; use --allow-outside to follow it"
        ),
        n => format!(
            "{n} links ({name} and others) lead out of this folder and were not followed; use --allow-outside to follow them"
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_leave_their_folder() {
        for name in ["../a", "a/../../b", "/etc/passwd", "a/b/../../../c"] {
            assert!(sibling_file(Path::new("/x/head.nhdr"), name).is_err(), "{name}");
        }
        for name in ["a", "a/b.raw", "./a", "a/../b", "..a", "a/.."] {
            assert!(sibling_file(Path::new("/x/head.nhdr"), name).is_ok(), "{name}");
        }
        assert_eq!(
            sibling_file(Path::new("head.nhdr"), "a.raw").ok(),
            Some(PathBuf::from("a.raw"))
        );
    }

    #[cfg(unix)]
    #[test]
    fn links_that_leave_their_folder() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("own"))
            .and_then(|()| std::fs::write(at("elsewhere"), "x"))
            .unwrap_or_else(|e| panic!("{e}"));
        std::fs::write(at("own/data"), "x").unwrap_or_else(|e| panic!("{e}"));
        for (target, link) in [("../elsewhere", "own/out"), ("data", "own/in")] {
            std::os::unix::fs::symlink(target, at(link)).unwrap_or_else(|e| panic!("{e}"));
        }
        assert!(
            sibling_file(&at("own/head.nhdr"), "out").is_err()
                && sibling_file(&at("own/head.nhdr"), "in").is_ok()
        );
        assert!(
            is_link_out(&at("own"), &at("own/out"))
                && !is_link_out(&at("own"), &at("own/in"))
                && !is_link_out(&at("own"), &at("own/data"))
        );
    }
}
