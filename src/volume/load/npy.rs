//! NumPy arrays, `.npy`, versions 1 to 3.
//!
//! The contiguous axis becomes i: the last one of an array in C order (`volume[z, y, x]`, as in
//! image libraries), the first one in Fortran order (`volume[x, y, z]`, as in nibabel). Three or
//! four u8 along the contiguous one of four axes are colours. Source: numpy.lib.format.

use super::ReadOptions;
use super::ScalarType;
use super::image::{Image, Layout};
use super::source::{ValueReader, buffered, check_held, count, read_error, skip};
use crate::{Error, Result, Watch};
use glam::DAffine3;
use serde_json::json;
use std::io::Read;
use std::path::Path;

/// Maximum header length, bytes.
const MAX_HEADER_BYTES: usize = 1 << 16;

/// The content of a header.
struct Header {
    scalar: ScalarType,
    /// Whether the byte order differs from the machine's.
    swap: bool,
    /// Extents of the axes, the contiguous axis first.
    extents: Vec<usize>,
}

impl Header {
    /// Reads a header up to the first value.
    fn read(path: &Path, reader: &mut impl Read) -> Result<Self> {
        let fail = |problem: String| Error::file(path, problem);
        let mut start = [0u8; 8];
        reader.read_exact(&mut start).map_err(|e| read_error(path, e))?;
        if &start[..6] != b"\x93NUMPY" || !(1..=3).contains(&start[6]) {
            return Err(fail("is not a NumPy array (.npy, version 1 to 3)".into()));
        }
        let mut length = [0u8; 4];
        let width = if start[6] == 1 { 2 } else { 4 };
        reader
            .read_exact(&mut length[..width])
            .map_err(|e| read_error(path, e))?;
        let length = u32::from_le_bytes(length) as usize;
        if length > MAX_HEADER_BYTES {
            return Err(fail(format!("has a header of {length} bytes; it is damaged")));
        }
        let mut text = vec![0u8; length];
        reader.read_exact(&mut text).map_err(|e| read_error(path, e))?;
        Self::parse(&String::from_utf8_lossy(&text)).map_err(fail)
    }

    /// Parses the text of a header, a Python dictionary.
    fn parse(text: &str) -> Result<Self, String> {
        let entry = |name: &str| {
            text.split_once(&format!("'{name}'"))
                .and_then(|(_, rest)| Some(rest.split_once(':')?.1.trim()))
        };
        let unclear = || "has a header that cannot be read; it is damaged".to_owned();
        let descr = entry("descr")
            .and_then(|t| t.strip_prefix('\'')?.split_once('\''))
            .ok_or_else(unclear)?
            .0;
        let fortran = entry("fortran_order").ok_or_else(unclear)?.starts_with("True");
        let shape = entry("shape")
            .and_then(|t| t.strip_prefix('(')?.split_once(')'))
            .ok_or_else(unclear)?
            .0;
        let mut extents: Vec<usize> = shape
            .split(',')
            .map(str::trim)
            .filter(|w| !w.is_empty())
            .map(|w| w.parse().ok().filter(|n| *n > 0))
            .collect::<Option<_>>()
            .ok_or_else(unclear)?;
        let (order, kind) = descr.split_at_checked(1).ok_or_else(unclear)?;
        let scalar = match kind {
            "b1" | "u1" => ScalarType::U8,
            "i1" => ScalarType::I8,
            "u2" => ScalarType::U16,
            "i2" => ScalarType::I16,
            "u4" => ScalarType::U32,
            "i4" => ScalarType::I32,
            "u8" => ScalarType::U64,
            "i8" => ScalarType::I64,
            "f4" => ScalarType::F32,
            "f8" => ScalarType::F64,
            _ => {
                return Err(format!(
                    "stores \"{descr}\", which cannot be rendered; convert it to a real scalar type"
                ));
            }
        };
        let swap = scalar.bytes() > 1 && (order == ">") != cfg!(target_endian = "big");
        if !fortran {
            extents.reverse();
        }
        Ok(Self {
            scalar,
            swap,
            extents,
        })
    }
}

/// Reads an array.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let (mut reader, file_bytes) = buffered(path)?;
    let Header {
        scalar,
        swap,
        mut extents,
    } = Header::read(path, &mut reader)?;
    let colors = extents.len() == 4 && scalar == ScalarType::U8 && (3..=4).contains(&extents[0]);
    let components = if colors { extents.remove(0) } else { 1 };
    if !(1..=4).contains(&extents.len()) {
        return Err(Error::file(
            path,
            format!(
                "has {} axes; arrays of 1 to 3, and one of time, can be read",
                extents.len()
            ),
        ));
    }
    let size: [usize; 3] = std::array::from_fn(|a| extents.get(a).copied().unwrap_or(1));
    let frames = extents.get(3).copied().unwrap_or(1);
    let time = choice.time_of(frames)?;
    let total = count(path, &[size[0], size[1], size[2], components], scalar)?;
    let bytes = (total * scalar.bytes()) as u64;
    let ahead = bytes.saturating_mul(time as u64);
    check_held(path, bytes.saturating_add(ahead), file_bytes)?;
    skip(path, &mut reader, ahead)?;
    let voxels = ValueReader {
        path,
        reader,
        swap,
        count: total,
        watch,
    }
    .read_as(scalar)?;
    let mut image = Image::new("NumPy", voxels, size, DAffine3::IDENTITY);
    (image.components, image.layout) = (components, Layout::Interleaved);
    if choice.spacing.is_none() {
        image
            .warnings
            .push("does not state its voxel spacing; 1 mm is assumed (use --spacing to set it)".into());
    }
    if frames > 1 {
        if choice.time.is_none() {
            image.warnings.push(format!(
                "holds {frames} volumes; the first is used (--time chooses another)"
            ));
        }
        image.details.push(("time_points", json!(frames)));
    }
    Ok(image)
}
