//! Sources of DICOM objects and their bytes: a file, the files of a folder, or the members of a
//! zip.

use super::super::source::{DEFLATE_LIMIT, open_file};
use crate::files::{input, reference};
use crate::panic_guard::catch_panic;
use crate::{Error, Result, Watch};
use std::collections::HashSet;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use zip::ZipArchive;

/// Maximum number of files and folders examined.
const MAX_FILES: usize = 1 << 20;
/// Maximum folder depth.
const MAX_FOLDER_DEPTH: usize = 32;

/// The location of an object's bytes.
#[derive(Clone)]
pub enum ObjectLocation {
    File(PathBuf),
    /// A member of a zip: its name, its index, and its declared length.
    Member {
        name: PathBuf,
        archive: ZipArchive<ReopenableFile>,
        index: usize,
        bytes: u64,
    },
}

/// A file that each clone opens separately on first read.
pub struct ReopenableFile {
    path: PathBuf,
    file: Option<BufReader<File>>,
}

impl Clone for ReopenableFile {
    fn clone(&self) -> Self {
        Self {
            path: self.path.clone(),
            file: None,
        }
    }
}

impl ReopenableFile {
    fn file(&mut self) -> std::io::Result<&mut BufReader<File>> {
        if self.file.is_none() {
            let (file, _) = open_file(&self.path).map_err(|e| std::io::Error::other(e.to_string()))?;
            self.file = Some(BufReader::new(file));
        }
        self.file
            .as_mut()
            .ok_or_else(|| std::io::ErrorKind::NotFound.into())
    }
}

impl Read for ReopenableFile {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        self.file()?.read(bytes)
    }
}

impl Seek for ReopenableFile {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.file()?.seek(to)
    }
}

/// A reader of an object.
pub trait ReadSeek: Read + Seek + Send {}
impl<T: Read + Seek + Send> ReadSeek for T {}
/// An object's bytes.
pub type Bytes = BufReader<Box<dyn ReadSeek>>;

impl ObjectLocation {
    /// Its name for messages.
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) | Self::Member { name: path, .. } => path,
        }
    }

    /// Its bytes from the start; of a zip member, at most `most` bytes are unpacked.
    pub fn open(&self, most: u64) -> Result<Bytes> {
        let reader: Box<dyn ReadSeek> = match self {
            Self::File(path) => Box::new(open_file(path)?.0),
            Self::Member {
                name, archive, index, ..
            } => {
                let damaged = |e: String| {
                    Error::file(
                        name,
                        format!("cannot be unpacked ({e}); copy or download the zip again"),
                    )
                };
                let mut archive = archive.clone();
                let member = archive.by_index(*index).map_err(|e| damaged(e.to_string()))?;
                let unpacked = input::start_of(name, member, most).map_err(|e| match e {
                    Error::File { .. } => e,
                    other => damaged(other.to_string()),
                });
                Box::new(Cursor::new(unpacked?))
            }
        };
        Ok(BufReader::with_capacity(1 << 16, reader))
    }

    /// The stored size of the object, bytes.
    pub fn bytes(&self) -> u64 {
        match self {
            Self::File(path) => std::fs::metadata(path).map_or(0, |m| m.len()),
            Self::Member { bytes, .. } => *bytes,
        }
    }
}

/// All files in a folder and its subfolders, each once however many links lead to it, and notes
/// about what was omitted. Links are followed inside the folder only: a target elsewhere may be
/// another patient.
pub fn files_in(folder: &Path, watch: &Watch) -> Result<(Vec<ObjectLocation>, Vec<String>)> {
    let follow = reference::outside_is_allowed();
    let root = folder
        .canonicalize()
        .map_err(|e| Error::io(folder, "reading", e))?;
    let (mut files, mut seen) = (Vec::new(), HashSet::new());
    let (mut left_out, mut too_deep) = (Vec::new(), 0usize);
    for entry in walkdir::WalkDir::new(folder)
        .follow_links(follow)
        .max_depth(MAX_FOLDER_DEPTH)
        .sort_by_file_name()
    {
        watch.check()?;
        // Link loops and unreadable entries are skipped.
        let Ok(entry) = entry else { continue };
        too_deep += usize::from(entry.depth() == MAX_FOLDER_DEPTH && entry.file_type().is_dir());
        let hidden = entry.depth() > 0 && entry.file_name().to_string_lossy().starts_with('.');
        if hidden
            || entry.file_name() == "DICOMDIR"
            || !(entry.file_type().is_file() || entry.path_is_symlink())
        {
            continue;
        }
        let mut own = entry.path().to_owned();
        if entry.path_is_symlink() {
            // Broken links are skipped as well.
            let Ok(target) = entry.path().canonicalize() else {
                continue;
            };
            if !follow && !target.starts_with(&root) {
                left_out.push(entry.into_path());
                continue;
            }
            if !target.is_file() {
                continue;
            }
            own = target;
        }
        if seen.insert(own) {
            files.push(ObjectLocation::File(entry.into_path()));
        }
        if files.len() > MAX_FILES {
            return Err(Error::file(
                folder,
                format!("holds more than {MAX_FILES} files; name the folder of one study"),
            ));
        }
    }
    let mut notes: Vec<String> = reference::links_left_out(&left_out).into_iter().collect();
    if too_deep > 0 {
        notes.push(format!("{too_deep} folders more than {MAX_FOLDER_DEPTH} levels down were not searched; name the folder that is meant"));
    }
    Ok((files, notes))
}

/// The members of a zip; none if the file is not a zip. They are unpacked one at a time, when read.
pub fn members(path: &Path, watch: &Watch) -> Result<Option<Vec<ObjectLocation>>> {
    let (mut file, length) = open_file(path)?;
    let mut magic = [0u8; 4];
    if file.read_exact(&mut magic).is_err() || &magic != b"PK\x03\x04" {
        return Ok(None);
    }
    let damaged = |e: String| {
        Error::file(
            path,
            format!("is a zip that cannot be read ({e}); copy or download it again"),
        )
    };
    let reader = ReopenableFile {
        path: path.to_owned(),
        file: None,
    };
    let mut archive = catch_panic(|| ZipArchive::new(reader))
        .ok_or_else(|| damaged("it is damaged".into()))?
        .map_err(|e| damaged(e.to_string()))?;
    let mut members = Vec::new();
    for index in 0..archive.len().min(MAX_FILES) {
        watch.check()?;
        let member = archive.by_index(index).map_err(|e| damaged(e.to_string()))?;
        let name = member.name().map_err(|e| damaged(e.to_string()))?.into_owned();
        let base = name.rsplit('/').next().unwrap_or("");
        if member.is_dir() || base.starts_with('.') || base == "DICOMDIR" {
            continue;
        }
        // Its declared length is limited to what the zip can contain.
        let bytes = member.size().min(length.saturating_mul(DEFLATE_LIMIT));
        drop(member);
        members.push(ObjectLocation::Member {
            name: path.join(name),
            archive: archive.clone(),
            index,
            bytes,
        });
    }
    Ok(Some(members))
}
