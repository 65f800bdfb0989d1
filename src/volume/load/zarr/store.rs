//! Where a Zarr store is: a folder, or a zip, whose members are read when they are needed. Within a
//! zip, paths continue that of the file: `a.zarr.zip/0/.zarray`.
//!
//! Source: the Zarr zip store: keys are the names of members, stored or deflated.

use super::super::source::{DEFLATE_LIMIT, open_file};
use crate::files::{input, inputs, reference};
use crate::{Error, Result};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use zarrs::array::Array;
use zarrs::filesystem::FilesystemStore;
use zarrs::storage::byte_range::ByteRangeIterator;
use zarrs::storage::{Bytes, MaybeBytesIterator, ReadableStorageTraits, StorageError, StoreKey};

/// Maximum size of a metadata file, bytes.
const MAX_METADATA_BYTES: u64 = 16 << 20;
/// Names of files of metadata.
const METADATA: [&str; 4] = [".zattrs", ".zgroup", ".zarray", "zarr.json"];

/// An array in a folder or a zip.
pub(super) type StoredArray = Array<dyn ReadableStorageTraits>;

/// A folder or a zip.
pub(super) enum Store {
    Folder,
    Zip(Arc<ZipMembers>),
}

impl Store {
    /// Opens what is at a path; also returns the path of its root group or array.
    pub fn open(path: &Path) -> Result<(Self, PathBuf)> {
        if path.is_dir() {
            return Ok((Self::Folder, path.to_owned()));
        }
        let members = ZipMembers::open(path)?;
        // A zip may hold the folder rather than its content.
        let is_root = |name: &str| {
            METADATA
                .iter()
                .any(|m| members.names.contains(&format!("{name}{m}")))
        };
        let mut tops = members
            .names
            .iter()
            .filter_map(|n| n.split_once('/').map(|(top, _)| top));
        let first = tops.next().unwrap_or("").to_owned();
        let is_wrapped = !is_root("") && tops.all(|t| t == first) && is_root(&format!("{first}/"));
        let root = if is_wrapped {
            path.join(first)
        } else {
            path.to_owned()
        };
        Ok((Self::Zip(Arc::new(members)), root))
    }

    /// The JSON of a file; null if there is no file.
    pub fn json(&self, path: &Path) -> Result<Value> {
        let bytes = match self {
            Self::Folder if !path.exists() => return Ok(Value::Null),
            Self::Folder => input::bytes(path, MAX_METADATA_BYTES, "metadata")?,
            Self::Zip(members) => match members.key(path) {
                Some(key) if members.names.contains(&key) => members.bytes(&key, MAX_METADATA_BYTES)?,
                _ => return Ok(Value::Null),
            },
        };
        serde_json::from_slice(&bytes).map_err(|e| {
            Error::file(
                path,
                format!("is not readable JSON ({e}); it is truncated or damaged"),
            )
        })
    }

    /// Whether there is a file.
    pub fn is_file(&self, path: &Path) -> bool {
        match self {
            Self::Folder => path.is_file(),
            Self::Zip(members) => members.key(path).is_some_and(|key| members.names.contains(&key)),
        }
    }

    /// Whether there is a folder.
    pub fn is_dir(&self, path: &Path) -> bool {
        match self {
            Self::Folder => path.is_dir(),
            Self::Zip(members) => members.below(path).next().is_some(),
        }
    }

    /// Whether a folder is a group or an array.
    pub fn is_node(&self, folder: &Path) -> bool {
        METADATA.iter().any(|n| self.is_file(&folder.join(n)))
    }

    /// The folders in a folder of the store at `root`.
    pub fn folders(&self, root: &Path, folder: &Path) -> Result<Vec<PathBuf>> {
        let mut found: Vec<PathBuf> = match self {
            Self::Folder => std::fs::read_dir(folder)
                .map_err(|e| Error::io(folder, "reading", e))?
                .flatten()
                .map(|e| e.path())
                .filter(|p| p.is_dir() && !reference::is_link_out(root, p))
                .collect(),
            Self::Zip(members) => members
                .below(folder)
                .filter_map(|rest| Some(folder.join(rest.split_once('/')?.0)))
                .collect(),
        };
        found.sort();
        found.dedup();
        Ok(found)
    }

    /// Bytes and number of the files of the array in a folder.
    pub fn held(&self, root: &Path, folder: &Path) -> Result<(u64, u64)> {
        if let Self::Zip(members) = self {
            return Ok((members.bytes, members.below(folder).count() as u64));
        }
        let (mut there, mut files) = (0u64, 0u64);
        for entry in walkdir::WalkDir::new(folder).into_iter().flatten() {
            // The library reads every existing file.
            if reference::is_link_out(root, entry.path()) {
                let links = reference::links_left_out(&[entry.path().to_owned()]).unwrap_or_default();
                return Err(Error::file(root, links));
            }
            let Ok(metadata) = std::fs::metadata(entry.path()) else {
                continue;
            };
            if metadata.is_file() {
                inputs::register(entry.path(), &metadata);
                (there, files) = (there + metadata.len(), files + 1);
            } else if !metadata.is_dir() {
                return Err(Error::file(
                    entry.path(),
                    "is not a regular file (it is a pipe, a socket or a device), so it cannot be a chunk of the array; remove it",
                ));
            }
        }
        Ok((there, files))
    }

    /// The array in a folder of the store at `root`.
    pub fn array(&self, root: &Path, folder: &Path) -> Result<StoredArray> {
        let fail = |problem: String| Error::file(root, problem);
        let (storage, inner): (Arc<dyn ReadableStorageTraits>, String) = match self {
            Self::Folder => {
                // Its metadata and chunks, existing or not.
                inputs::note_path(root);
                if folder.to_str().is_none() {
                    return Err(fail(
                        "has a path that is not UTF-8, which OME-Zarr requires; rename it".into(),
                    ));
                }
                let store =
                    FilesystemStore::new(folder).map_err(|e| fail(format!("cannot be opened ({e})")))?;
                (Arc::new(store), "/".into())
            }
            Self::Zip(members) => {
                let key = members.key(folder).unwrap_or_default();
                (members.clone(), format!("/{key}"))
            }
        };
        let unreadable = |e: String| fail(format!("holds an array that cannot be read ({e})"));
        let three = self.json(&folder.join("zarr.json"))?;
        let completed = completed(three.clone());
        if self.is_file(&folder.join(".zarray")) || completed == three {
            return Array::open(storage, &inner).map_err(|e| unreadable(e.to_string()));
        }
        let metadata = serde_json::from_value(completed).map_err(|e| unreadable(e.to_string()))?;
        Array::new_with_metadata(storage, &inner, metadata).map_err(|e| unreadable(e.to_string()))
    }
}

/// The metadata of an array in which the codecs of numcodecs state what they leave to its defaults.
/// Its zstd is that of Zarr 3.
fn completed(mut metadata: Value) -> Value {
    if let Some(codecs) = metadata.get_mut("codecs") {
        complete(codecs);
    }
    metadata
}

/// Completes a list of codecs, and of codecs within shards.
fn complete(codecs: &mut Value) {
    for codec in codecs.as_array_mut().map_or(&mut [][..], Vec::as_mut_slice) {
        let Some(codec) = codec.as_object_mut() else {
            continue;
        };
        let (defaults, name) = match codec.get("name").and_then(Value::as_str) {
            Some("numcodecs.zlib") => (json!({ "level": 1 }), None),
            Some("numcodecs.bz2") => (json!({ "level": 1 }), None),
            Some("numcodecs.shuffle") => (json!({ "elementsize": 4 }), None),
            Some("numcodecs.zstd") => (json!({ "level": 0, "checksum": false }), Some("zstd")),
            Some("numcodecs.gzip") => (json!({ "level": 1 }), Some("gzip")),
            _ => (json!({}), None),
        };
        if let Some(name) = name {
            codec.insert("name".into(), name.into());
        }
        let Some(defaults) = defaults.as_object().filter(|d| !d.is_empty()) else {
            if let Some(inner) = codec.get_mut("configuration").and_then(|c| c.get_mut("codecs")) {
                complete(inner);
            }
            continue;
        };
        let stated = codec.entry("configuration").or_insert_with(|| json!({}));
        if stated.is_null() {
            *stated = json!({});
        }
        if let Some(stated) = stated.as_object_mut() {
            for (key, value) in defaults {
                stated.entry(key).or_insert_with(|| value.clone());
            }
        }
    }
}

/// The members of a zip.
pub(super) struct ZipMembers {
    path: PathBuf,
    /// Length of the zip.
    bytes: u64,
    names: BTreeSet<String>,
    archive: Mutex<zip::ZipArchive<BufReader<File>>>,
}

impl ZipMembers {
    fn open(path: &Path) -> Result<Self> {
        let (file, bytes) = open_file(path)?;
        let archive = zip::ZipArchive::new(BufReader::new(file)).map_err(|e| {
            Error::file(
                path,
                format!("is not a readable zip ({e}); copy or download it again"),
            )
        })?;
        let names = archive
            .file_names()
            .flatten()
            .filter(|n| !n.ends_with('/'))
            .map(|n| n.into_owned())
            .collect();
        Ok(Self {
            path: path.to_owned(),
            bytes,
            names,
            archive: Mutex::new(archive),
        })
    }

    /// The name of the member at a path.
    fn key(&self, path: &Path) -> Option<String> {
        let inner = path.strip_prefix(&self.path).ok()?;
        let parts: Option<Vec<&str>> = inner.iter().map(|p| p.to_str()).collect();
        Some(parts?.join("/"))
    }

    /// The names of the members below a folder, from there.
    fn below<'a>(&'a self, folder: &Path) -> impl Iterator<Item = &'a str> {
        let prefix = match self.key(folder) {
            Some(key) if key.is_empty() => String::new(),
            Some(key) => format!("{key}/"),
            // No member has this name.
            None => "/".into(),
        };
        let from = prefix.clone();
        self.names
            .range(from..)
            .map_while(move |name| name.strip_prefix(&prefix))
    }

    /// The content of a member, of at most `most` bytes.
    fn bytes(&self, key: &str, most: u64) -> Result<Vec<u8>> {
        let damaged = |e| Error::file(&self.path, format!("holds {key}, which cannot be read ({e})"));
        let mut archive = self.archive.lock().unwrap_or_else(PoisonError::into_inner);
        let member = archive.by_name(key).map_err(damaged)?;
        let most = most.min(member.compressed_size().saturating_mul(DEFLATE_LIMIT));
        input::start_of(&self.path, member, most)
    }
}

impl ReadableStorageTraits for ZipMembers {
    fn get_partial_many<'a>(
        &'a self,
        key: &StoreKey,
        byte_ranges: ByteRangeIterator<'a>,
    ) -> Result<MaybeBytesIterator<'a>, StorageError> {
        if !self.names.contains(key.as_str()) {
            return Ok(None);
        }
        let all = self
            .bytes(key.as_str(), u64::MAX)
            .map_err(|e| StorageError::Other(e.to_string()))?;
        let all = Bytes::from(all);
        let length = all.len() as u64;
        Ok(Some(Box::new(byte_ranges.map(move |range| {
            let fits = match range {
                zarrs::storage::byte_range::ByteRange::FromStart(from, count) => from
                    .checked_add(count.unwrap_or(0))
                    .is_some_and(|end| end <= length),
                zarrs::storage::byte_range::ByteRange::Suffix(count) => count <= length,
            };
            if fits {
                Ok(all.slice(range.start(length) as usize..range.end(length) as usize))
            } else {
                Err(StorageError::Other(
                    "a chunk is shorter than its index says".into(),
                ))
            }
        }))))
    }

    fn size_key(&self, key: &StoreKey) -> Result<Option<u64>, StorageError> {
        if !self.names.contains(key.as_str()) {
            return Ok(None);
        }
        let mut archive = self.archive.lock().unwrap_or_else(PoisonError::into_inner);
        let member = archive
            .by_name(key.as_str())
            .map_err(|e| StorageError::Other(e.to_string()))?;
        Ok(Some(member.size()))
    }

    fn supports_get_partial(&self) -> bool {
        false
    }
}

/// Whether a zip holds a Zarr store.
pub(super) fn is_zipped(path: &Path) -> bool {
    ZipMembers::open(path).is_ok_and(|members| {
        let last = |name: &String| name.rsplit('/').next().is_some_and(|n| METADATA.contains(&n));
        members.names.iter().any(last)
    })
}

/// Whether a folder is a Zarr group or array.
pub(super) fn is_zarr(folder: &Path) -> bool {
    Store::Folder.is_node(folder)
}
