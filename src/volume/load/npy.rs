//! NumPy arrays, `.npy`, versions 1 to 3, and archives of them, `.npz`, that hold one array of at
//! least two axes.
//!
//! The contiguous axis becomes i: the last one of an array in C order (`volume[z, y, x]`, as in
//! image libraries), the first one in Fortran order (`volume[x, y, z]`, as in nibabel). Three or
//! four u8 along the contiguous one of four or five axes are colours, and along the last of four axes
//! in Fortran order, in which NumPy holds colours in either order. Of four other axes the
//! slowest is time, of five the two slowest are time and channel (`volume[t, c, z, y, x]`, as in
//! OME). Booleans are read as 0 and 1, floats of 16 bits as 32. Source: numpy.lib.format.

use super::ReadOptions;
use super::ScalarType;
use super::StoredValues;
use super::image::{Image, Layout, Meaning};
use super::source::{DEFLATE_LIMIT, ValueReader, check_held, count, open, open_file, read_error, skip};
use crate::panic_guard::catch_panic;
use crate::{Error, Result, Watch};
use glam::DAffine3;
use half::f16;
use serde_json::json;
use std::io::{BufReader, Read};
use std::path::Path;

/// Maximum header length, bytes.
const MAX_HEADER_BYTES: usize = 1 << 16;

/// The content of a header.
struct Header {
    scalar: ScalarType,
    /// Whether values are floats of 16 bits, which `scalar` does not know: their bits are u16.
    is_half: bool,
    /// Whether the byte order differs from the machine's.
    swap: bool,
    /// Extents of the axes, the contiguous axis first.
    extents: Vec<usize>,
    /// Whether the contiguous axis is the first one of the array.
    fortran: bool,
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
        let stated = entry("descr").ok_or_else(unclear)?;
        if stated.starts_with('[') {
            return Err("stores structures of several fields; save one field as an array of its own".into());
        }
        let descr = stated
            .strip_prefix('\'')
            .and_then(|t| t.split_once('\''))
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
            // Python 2 wrote long integers with an L.
            .map(|w| w.trim_end_matches('L').parse().ok())
            .collect::<Option<_>>()
            .ok_or_else(unclear)?;
        let (order, kind) = descr.split_at_checked(1).ok_or_else(unclear)?;
        let scalar = match kind {
            "b1" | "u1" => ScalarType::U8,
            "i1" => ScalarType::I8,
            "u2" | "f2" => ScalarType::U16,
            "i2" => ScalarType::I16,
            "u4" => ScalarType::U32,
            "i4" => ScalarType::I32,
            "u8" => ScalarType::U64,
            "i8" => ScalarType::I64,
            "f4" => ScalarType::F32,
            "f8" => ScalarType::F64,
            _ => return Err(refused(descr)),
        };
        if extents.contains(&0) {
            return Err(format!("holds no values: its shape is ({shape})"));
        }
        let swap = scalar.bytes() > 1 && (order == ">") != cfg!(target_endian = "big");
        if !fortran {
            extents.reverse();
        }
        Ok(Self {
            scalar,
            is_half: kind == "f2",
            swap,
            extents,
            fortran,
        })
    }
}

/// The message about a type that cannot be read.
fn refused(descr: &str) -> String {
    let meaning = match descr.trim_start_matches(['<', '>', '|', '=']).as_bytes() {
        [b'O', ..] => " (Python objects, as a pickle)",
        [b'c', ..] => " (complex numbers)",
        [b'S' | b'U', ..] => " (texts)",
        [b'M' | b'm', ..] => " (dates or durations)",
        [b'V', ..] => " (structures or raw bytes)",
        [b'f', ..] => " (floats of more than 64 bits)",
        _ => "",
    };
    format!("stores \"{descr}\"{meaning}, which cannot be rendered; convert it to a real scalar type")
}

/// Which axes are what: the contiguous one first.
#[derive(Debug, PartialEq)]
struct ArrayAxes {
    /// Values of a colour, stored together.
    colors: usize,
    /// Whether the channels are those of colours.
    is_color: bool,
    size: [usize; 3],
    channels: usize,
    times: usize,
}

impl ArrayAxes {
    /// From the extents, the contiguous axis first.
    fn of(mut extents: Vec<usize>, scalar: ScalarType, fortran: bool) -> Result<Self, String> {
        let stated = extents.len();
        // Whatever the order in memory, the last axis of an array holds colours.
        if let ([i, j, k, colors @ 3..=4], true, ScalarType::U8) = (&extents[..], fortran, scalar) {
            return Ok(Self {
                colors: 1,
                is_color: true,
                size: [*i, *j, *k],
                channels: *colors,
                times: 1,
            });
        }
        let mut colors = 1;
        if matches!(extents.len(), 4 | 5) && scalar == ScalarType::U8 && (3..=4).contains(&extents[0]) {
            colors = extents.remove(0);
        }
        while extents.len() > 5 && extents.last() == Some(&1) {
            extents.pop();
        }
        if !(1..=5).contains(&extents.len()) {
            return Err(format!(
                "has {stated} axes; arrays of 1 to 3 axes, with one of time and one of channels, can be read"
            ));
        }
        let extent = |a: usize| extents.get(a).copied().unwrap_or(1);
        let (channels, times) = if extents.len() == 5 {
            (extent(3), extent(4))
        } else {
            (1, extent(3))
        };
        Ok(Self {
            colors,
            is_color: false,
            size: [extent(0), extent(1), extent(2)],
            channels,
            times,
        })
    }
}

/// Reads an array.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let (mut reader, most) = open(path)?;
    let header = Header::read(path, &mut reader)?;
    read_values(path, header, reader, most, choice, watch)
}

/// Reads the only array of an archive that has at least two axes.
pub fn read_archive(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let damaged = || Error::file(path, "is a damaged zip; copy or download it again");
    catch_panic(|| read_archive_unguarded(path, choice, watch)).ok_or_else(damaged)?
}

/// Reads an archive; [`read_archive`] turns a panic of the decoder into an error.
fn read_archive_unguarded(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    let (file, file_bytes) = open_file(path)?;
    let mut archive = zip::ZipArchive::new(BufReader::new(file))
        .map_err(|e| fail(format!("is not a readable zip ({e}); copy or download it again")))?;
    let names: Vec<String> = archive
        .file_names()
        .filter_map(|n| n.ok().map(|n| n.into_owned()))
        .collect();
    let mut arrays = Vec::new();
    let mut refusal = None;
    for name in names.iter().filter(|n| n.ends_with(".npy")) {
        let mut member = archive
            .by_name(name)
            .map_err(|e| fail(format!("holds {name}, which cannot be read ({e})")))?;
        match Header::read(path, &mut member) {
            Ok(header) if header.extents.len() > 1 => arrays.push(name.clone()),
            Ok(_) => {}
            Err(e) => refusal = Some(e),
        }
    }
    arrays.sort();
    let name = match (&arrays[..], refusal) {
        ([only], _) => only,
        ([], Some(refusal)) => return Err(refusal),
        ([], None) => return Err(fail("holds no array of two or more axes".into())),
        (several, _) => {
            let list: Vec<&str> = several
                .iter()
                .take(8)
                .map(|n| n.trim_end_matches(".npy"))
                .collect();
            return Err(fail(format!(
                "holds {} arrays ({}); save the one to show as .npy",
                several.len(),
                list.join(", ")
            )));
        }
    };
    let mut member = archive
        .by_name(name)
        .map_err(|e| fail(format!("holds {name}, which cannot be read ({e})")))?;
    let header = Header::read(path, &mut member)?;
    let most = file_bytes.saturating_mul(DEFLATE_LIMIT);
    let mut image = read_values(path, header, member, most, choice, watch)?;
    let others = names.len() - 1;
    if others > 0 {
        image.warnings.push(format!(
            "holds {others} arrays besides {}, which are not read",
            name.trim_end_matches(".npy")
        ));
    }
    Ok(image)
}

/// Reads the values after a header, of which there can be at most `most` bytes.
fn read_values(
    path: &Path,
    header: Header,
    mut reader: impl Read,
    most: u64,
    choice: &ReadOptions,
    watch: &Watch,
) -> Result<Image> {
    let Header {
        scalar,
        is_half,
        swap,
        extents,
        fortran,
    } = header;
    let rank = extents.len();
    let axes = ArrayAxes::of(extents, scalar, fortran).map_err(|problem| Error::file(path, problem))?;
    let time = choice.time_of(axes.times)?;
    let [i, j, k] = axes.size;
    let total = count(path, &[i, j, k, axes.colors, axes.channels], scalar)?;
    let bytes = (total * scalar.bytes()) as u64;
    let ahead = bytes.saturating_mul(time as u64);
    check_held(path, bytes.saturating_add(ahead), most)?;
    skip(path, &mut reader, ahead)?;
    let mut voxels = ValueReader {
        path,
        reader,
        swap,
        count: total,
        watch,
    }
    .read_as(scalar)?;
    if let (true, StoredValues::U16(bits)) = (is_half, &voxels) {
        let values: Vec<f32> = bits.iter().map(|b| f16::from_bits(*b).to_f32()).collect();
        voxels = values.into();
    }
    let mut image = Image::new("NumPy", voxels, axes.size, DAffine3::IDENTITY);
    image.components = axes.colors * axes.channels;
    image.layout = if axes.channels > 1 {
        Layout::Planar
    } else {
        Layout::Interleaved
    };
    if axes.is_color {
        image.meaning = Meaning::Color;
    } else if axes.channels > 1 {
        image.meaning = Meaning::Channels(Vec::new());
    }
    if fortran && rank > 1 {
        let taken = if axes.is_color {
            "its first axis is taken as i and its last one as colours"
        } else if axes.colors > 1 {
            "its first axis is taken as colours and its second one as i"
        } else {
            "its first axis is taken as i"
        };
        image.warnings.push(format!("is in Fortran order; {taken}"));
    }
    image.warnings.extend(choice.spacing_notice([false; 3]));
    if axes.times > 1 {
        if choice.time.is_none() {
            image.warnings.push(format!(
                "holds {} volumes; the first is used (--time chooses another)",
                axes.times
            ));
        }
        image.details.push(("time_points", json!(axes.times)));
    }
    Ok(image)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers() {
        let header = Header::parse("{'descr': '>f2', 'fortran_order': False, 'shape': (2, 3), }");
        let Ok(header) = header else { panic!("no header") };
        assert!(header.is_half && header.swap);
        assert_eq!(header.extents, [3, 2]);
        for (text, word) in [
            (
                "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (2,), }",
                "fields",
            ),
            (
                "{'descr': '|O', 'fortran_order': False, 'shape': (2,), }",
                "pickle",
            ),
            (
                "{'descr': '<c8', 'fortran_order': False, 'shape': (2,), }",
                "complex",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 0), }",
                "(2, 0)",
            ),
        ] {
            assert!(Header::parse(text).is_err_and(|e| e.contains(word)), "{text}");
        }
    }

    #[test]
    fn axes() {
        let of = |extents: &[usize]| ArrayAxes::of(extents.to_vec(), ScalarType::U8, false);
        assert_eq!(of(&[3, 5, 6, 7]).map(|a| (a.colors, a.size)), Ok((3, [5, 6, 7])));
        assert_eq!(of(&[3, 7, 6, 5, 2]).map(|a| (a.colors, a.times)), Ok((3, 2)));
        assert_eq!(of(&[7, 6, 5, 2]).map(|a| (a.times, a.channels)), Ok((2, 1)));
        assert_eq!(of(&[7, 6, 5, 3, 2]).map(|a| (a.times, a.channels)), Ok((2, 3)));
        assert!(of(&[]).is_err());
        // Fortran order, `volume[x, y, z, color]`.
        let axes = ArrayAxes::of(vec![4, 10, 12, 3], ScalarType::U8, true);
        let axes = axes.map(|a| (a.size, a.channels, a.is_color));
        assert_eq!(axes, Ok(([4, 10, 12], 3, true)));
    }
}
