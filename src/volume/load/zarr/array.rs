//! A Zarr array's metadata: shape, chunks, type and codecs, checked before anything is read or
//! allocated.
//!
//! Source: Zarr specifications 2 and 3; the codecs of numcodecs. A type or codec that cannot be
//! read is refused by its name.

use super::super::ScalarType;
use super::super::source::check_held;
use super::store::Store;
use crate::{Error, Result};
use serde_json::Value;
use std::path::Path;

/// Maximum compression ratio of chunks, also assumed for arrays whose empty chunks were omitted.
const MAX_COMPRESSION_RATIO: u64 = 5000;
const ALWAYS_BELIEVED: u64 = 64 << 20;
/// Maximum number of omitted empty chunks.
const MAX_MISSING_CHUNKS: u64 = 100_000;
/// Codecs and filters that can be read, without the prefix that numcodecs has in Zarr 3.
const CODECS: [&str; 17] = [
    "bitround",
    "blosc",
    "bytes",
    "bz2",
    "crc32c",
    "endian",
    "fixedscaleoffset",
    "fletcher32",
    "gzip",
    "packbits",
    "reshape",
    "sharding_indexed",
    "shuffle",
    "squeeze",
    "transpose",
    "zlib",
    "zstd",
];

/// The stored types that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StoredType {
    Scalar(ScalarType),
    /// Read as 0 and 1.
    Bool,
    /// A float of 16 bits, read as one of 32.
    Half,
}

impl StoredType {
    /// Type of the values that are read.
    pub fn scalar(self) -> ScalarType {
        match self {
            Self::Scalar(scalar) => scalar,
            Self::Bool => ScalarType::U8,
            Self::Half => ScalarType::F32,
        }
    }

    /// By the metadata of Zarr 2 or 3.
    fn of(stated: &Value) -> Result<Self, String> {
        let refused = |what: String| {
            Err(format!(
                "stores {what}, which cannot be rendered; convert it to a real scalar type"
            ))
        };
        let name = match stated {
            Value::String(name) => name.as_str(),
            Value::Array(_) => return refused("structures of several fields".into()),
            other => match other["name"].as_str() {
                Some("structured" | "struct") => return refused("structures of several fields".into()),
                Some(name) => name,
                None => return refused("values of an unknown type".into()),
            },
        };
        let plain = name.trim_start_matches(['<', '>', '|']);
        Ok(match plain {
            "b1" | "bool" => Self::Bool,
            "f2" | "float16" => Self::Half,
            "u1" => Self::Scalar(ScalarType::U8),
            "i1" => Self::Scalar(ScalarType::I8),
            "u2" => Self::Scalar(ScalarType::U16),
            "i2" => Self::Scalar(ScalarType::I16),
            "u4" => Self::Scalar(ScalarType::U32),
            "i4" => Self::Scalar(ScalarType::I32),
            "u8" => Self::Scalar(ScalarType::U64),
            "i8" => Self::Scalar(ScalarType::I64),
            "f4" => Self::Scalar(ScalarType::F32),
            "f8" => Self::Scalar(ScalarType::F64),
            _ => match ScalarType::named(plain) {
                Some(scalar) => Self::Scalar(scalar),
                None => {
                    let meaning = match plain.as_bytes() {
                        [b'c', ..] => " (complex numbers)",
                        [b'S' | b'U' | b'O', ..] => " (texts or objects)",
                        [b'M' | b'm', ..] => " (dates or durations)",
                        b"string" | b"fixed_length_utf32" | b"null_terminated_bytes" => " (texts)",
                        b"numpy.datetime64" | b"numpy.timedelta64" => " (dates or durations)",
                        _ => "",
                    };
                    return refused(format!("\"{name}\"{meaning}"));
                }
            },
        })
    }
}

/// A Zarr array's metadata.
pub(super) struct ArrayLayout {
    pub shape: Vec<u64>,
    pub chunks: Vec<u64>,
    pub stored: StoredType,
    /// Names of the axes, if the array states them itself.
    pub dimension_names: Option<Vec<String>>,
}

impl ArrayLayout {
    /// Reads the metadata of the array in a folder.
    ///
    /// # Errors
    /// No array, damaged metadata, or a type or codec that cannot be read.
    pub fn of(store: &Store, folder: &Path) -> Result<Self> {
        let fail = |problem: String| Error::file(folder, problem);
        let two = store.json(&folder.join(".zarray"))?;
        let names = |v: &Value| {
            v.as_array()?
                .iter()
                .map(|n| n.as_str().map(str::to_owned))
                .collect::<Option<Vec<String>>>()
        };
        let (stated, chunks, kind, dimension_names) = if two.is_null() {
            let three = store.json(&folder.join("zarr.json"))?;
            if three.is_null() {
                return Err(fail(
                    "is not a Zarr array (it contains neither .zarray nor zarr.json)".into(),
                ));
            }
            if let Some(name) = three["chunk_grid"]["name"].as_str().filter(|n| *n != "regular") {
                return Err(fail(format!(
                    "has a chunk grid \"{name}\", which cannot be read; save it with chunks of one size"
                )));
            }
            let chunks = three["chunk_grid"]["configuration"]["chunk_shape"].clone();
            StoredType::of(&three["data_type"])
                .and_then(|_| check_codecs(&three["codecs"]))
                .map_err(fail)?;
            let dimension_names = names(&three["dimension_names"]);
            (
                three["shape"].clone(),
                chunks,
                three["data_type"].clone(),
                dimension_names,
            )
        } else {
            let compressor = Value::Array(vec![two["compressor"].clone()]);
            StoredType::of(&two["dtype"])
                .and_then(|_| check_codecs(&two["filters"]))
                .and_then(|()| check_codecs(&compressor))
                .map_err(fail)?;
            let attributes = store.json(&folder.join(".zattrs"))?;
            let dimension_names = names(&attributes["_ARRAY_DIMENSIONS"]);
            (
                two["shape"].clone(),
                two["chunks"].clone(),
                two["dtype"].clone(),
                dimension_names,
            )
        };
        let numbers = |v: &Value| {
            v.as_array()?
                .iter()
                .map(Value::as_u64)
                .collect::<Option<Vec<u64>>>()
        };
        let (Some(shape), Some(chunks)) = (numbers(&stated), numbers(&chunks)) else {
            return Err(fail(
                "has a shape or chunks that are not numbers; its metadata are damaged".into(),
            ));
        };
        if shape.contains(&0) {
            return Err(fail(format!("holds no values: its shape is {stated}")));
        }
        if shape.len() != chunks.len() || chunks.contains(&0) {
            return Err(fail(
                "has chunks that do not fit its shape; its metadata are damaged".into(),
            ));
        }
        if !(2..=5).contains(&shape.len()) {
            return Err(fail(format!("has {} axes; 2 to 5 can be read", shape.len())));
        }
        Ok(Self {
            shape,
            chunks,
            stored: StoredType::of(&kind).map_err(fail)?,
            dimension_names,
        })
    }

    /// Extent of an axis; 1 for an axis that the array does not have.
    pub fn extent(&self, axis: Option<usize>) -> usize {
        axis.map_or(1, |a| self.shape[a] as usize)
    }

    /// Rejects arrays and chunks that are far larger than the existing files.
    pub fn check(&self, store: &Store, path: &Path, folder: &Path, bytes: u64) -> Result<()> {
        let (there, files) = store.held(path, folder)?;
        // Each chunk is looked up, whether it exists or not.
        let chunks = self
            .shape
            .iter()
            .zip(&self.chunks)
            .try_fold(1u64, |n, (s, c)| n.checked_mul(s.div_ceil(*c)));
        if chunks.is_none_or(|n| n > MAX_MISSING_CHUNKS.saturating_add(files.saturating_mul(64))) {
            return Err(Error::file(
                path,
                format!(
                    "declares far more chunks than the {files} files in it: its metadata are damaged; copy it again"
                ),
            ));
        }
        let most = there.saturating_mul(MAX_COMPRESSION_RATIO).max(ALWAYS_BELIEVED);
        let value_bytes = self.stored.scalar().bytes() as u64;
        let chunk = self.chunks.iter().try_fold(value_bytes, |n, &c| n.checked_mul(c));
        check_held(path, bytes.max(chunk.unwrap_or(u64::MAX)), most)
    }
}

/// Number of axes of the array in a folder; none if it is no array.
pub(super) fn rank_of(store: &Store, folder: &Path) -> Result<Option<usize>> {
    let two = store.json(&folder.join(".zarray"))?;
    let stated = if two.is_null() {
        store.json(&folder.join("zarr.json"))?
    } else {
        two
    };
    Ok(stated["shape"].as_array().map(Vec::len))
}

/// Rejects a list of codecs, and of codecs within shards, that holds one that cannot be read.
fn check_codecs(list: &Value) -> Result<(), String> {
    for codec in list.as_array().map_or(&[][..], Vec::as_slice) {
        // A codec may be named alone.
        let name = codec.as_str().or(codec["name"].as_str()).or(codec["id"].as_str());
        let Some(name) = name else { continue };
        let plain = name.strip_prefix("numcodecs.").unwrap_or(name);
        if !CODECS.contains(&plain) {
            return Err(format!(
                "is stored with the codec or filter \"{name}\", which cannot be read; save it with blosc, zstd or gzip and without filters"
            ));
        }
        let inner = &codec["configuration"];
        check_codecs(&inner["codecs"]).and_then(|()| check_codecs(&inner["index_codecs"]))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn types_and_codecs_are_named() {
        assert_eq!(StoredType::of(&json!("|b1")), Ok(StoredType::Bool));
        assert_eq!(StoredType::of(&json!("<f2")), Ok(StoredType::Half));
        assert_eq!(
            StoredType::of(&json!(">u2")),
            Ok(StoredType::Scalar(ScalarType::U16))
        );
        for (stated, word) in [
            (json!("<c8"), "complex"),
            (json!("<U4"), "texts"),
            (json!([["a", "<f4"]]), "fields"),
            (json!({"name": "numpy.datetime64"}), "numpy.datetime64"),
        ] {
            assert!(
                StoredType::of(&stated).is_err_and(|e| e.contains(word)),
                "{stated}"
            );
        }
        let sharded = json!([{"name": "sharding_indexed", "configuration": {"codecs": [{"name": "bytes"}, {"name": "lz9"}]}}]);
        assert!(check_codecs(&sharded).is_err_and(|e| e.contains("lz9")));
        assert_eq!(check_codecs(&json!([null, {"id": "zlib"}])), Ok(()));
    }
}
