//! The bytes of a DICOM object: where its data set starts, its transfer syntax, and its header.

use super::super::source::DEFLATE_LIMIT;
use super::elements::{DataSet, Encoding, data_set};
use super::location::{Bytes, ObjectLocation, ReadSeek};
use super::syntax::{BIG_ENDIAN, DEFLATED, EXPLICIT, GE_BIG_ENDIAN_PIXELS, IMPLICIT};
use crate::files::input;
use crate::{Error, Result};
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};

/// Number of bytes of a deflated object within which its header must end.
const MAX_HEADER_BYTES: u64 = 64 << 20;
/// Maximum size of the meta information, bytes.
const MAX_META_BYTES: u64 = 1 << 20;
/// Number of bytes by which an object is recognised.
pub const START: usize = 1024;
/// Maximum length of the first value of a data set without meta information, bytes.
const MAX_FIRST_VALUE: usize = 1 << 10;

/// Whether these are the first bytes of a DICOM file.
pub fn is_dicom(start: &[u8]) -> bool {
    meta_offset(start).is_some() || bare_dataset(start)
}

/// Offset of the meta information: after the preamble and `DICM`, or without them.
fn meta_offset(start: &[u8]) -> Option<u64> {
    let group_2 = |at: usize| {
        start
            .get(at..at + 6)
            .is_some_and(|b| b[..2] == [2, 0] && b[3] == 0 && b[4..].iter().all(u8::is_ascii_uppercase))
    };
    match () {
        () if start.get(128..132) == Some(b"DICM") => Some(132),
        () if start.starts_with(b"DICM") => Some(4),
        () if group_2(0) => Some(0),
        () if group_2(128) => Some(128),
        () => None,
    }
}

/// A data set without preamble and meta information, as written by older programs: it starts with
/// group 0008, or with the group length of a command, group 0000.
fn bare_dataset(start: &[u8]) -> bool {
    if start.len() < 16 {
        return false;
    }
    if start[..4] == [0; 4] {
        let is_length = start[4..8] == [4, 0, 0, 0] || start[4..8] == *b"UL\x04\0";
        return is_length && start[12..14] == [0, 0];
    }
    let vr = start[4..6].iter().all(u8::is_ascii_uppercase);
    if start[..2] == [0, 8] {
        return vr;
    }
    if start[..2] != [8, 0] {
        return false;
    }
    let length = u32::from_le_bytes([start[4], start[5], start[6], start[7]]) as usize;
    let binary = start[3] == 0 && start[2] <= 1;
    let text = |value: &[u8]| {
        value
            .iter()
            .all(|b| *b == 0 || *b == 0x1b || !b.is_ascii_control())
    };
    let value = &start[8..start.len().min(8 + length.min(MAX_FIRST_VALUE))];
    vr || length <= MAX_FIRST_VALUE && length.is_multiple_of(2) && (binary && length == 4 || text(value))
}

/// An object at the start of its data set.
pub struct Opened {
    pub reader: Bytes,
    /// How the transfer syntax says that elements are encoded.
    declared: Encoding,
    pub syntax: String,
}

/// Opens an object; `most` limits the unpacked size of a deflated one.
pub fn open(source: &ObjectLocation, most: u64) -> Result<Opened> {
    let path = source.path();
    let io = |e: std::io::Error| Error::io(path, "reading", e);
    let mut start = Vec::new();
    source
        .open(START as u64)?
        .take(START as u64)
        .read_to_end(&mut start)
        .map_err(io)?;
    if !is_dicom(&start) {
        return Err(Error::file(path, "is not a DICOM file"));
    }
    let Some(offset) = meta_offset(&start) else {
        // The elements show their encoding.
        let explicit = start[4..6].iter().all(u8::is_ascii_uppercase);
        let syntax = match (start[1], explicit) {
            (8, _) => BIG_ENDIAN,
            (_, true) => EXPLICIT,
            (_, false) => IMPLICIT,
        };
        return Ok(Opened {
            reader: source.open(most)?,
            declared: encoding(syntax),
            syntax: syntax.to_owned(),
        });
    };
    let mut reader = source.open(most)?;
    reader.seek(SeekFrom::Start(offset)).map_err(io)?;
    let damaged = || {
        Error::file(
            path,
            "is not a readable DICOM file (its first elements are damaged or end too early); copy or export it again",
        )
    };
    let (syntax, length) = meta(&mut reader).ok_or_else(damaged)?;
    reader.seek(SeekFrom::Start(offset + length)).map_err(io)?;
    if syntax == DEFLATED && !starts_with_group_8(&mut reader).map_err(io)? {
        skip_zlib_header(&mut reader).map_err(io)?;
        let limit = most.min(source.bytes().saturating_mul(DEFLATE_LIMIT));
        let bytes = input::start_of(path, flate2::read::DeflateDecoder::new(reader), limit)?;
        let unpacked: Box<dyn ReadSeek> = Box::new(Cursor::new(bytes));
        reader = BufReader::new(unpacked);
    }
    Ok(Opened {
        reader,
        declared: encoding(&syntax),
        syntax,
    })
}

/// Whether a data set that is declared to be deflated is not.
fn starts_with_group_8(reader: &mut Bytes) -> std::io::Result<bool> {
    use std::io::BufRead;
    Ok(reader.fill_buf()?.starts_with(&[8, 0]))
}

/// Skips the header of zlib, which some writers put before a deflated data set. Source: RFC 1950 2.2.
fn skip_zlib_header(reader: &mut Bytes) -> std::io::Result<()> {
    use std::io::BufRead;
    if let [0x78, flags, ..] = reader.fill_buf()?
        && (0x7800 + u16::from(*flags)).is_multiple_of(31)
    {
        reader.consume(2);
    }
    Ok(())
}

/// How a transfer syntax encodes elements; compressed ones are explicit.
fn encoding(syntax: &str) -> Encoding {
    Encoding {
        explicit: syntax != IMPLICIT && syntax != GE_BIG_ENDIAN_PIXELS,
        big_endian: syntax == BIG_ENDIAN,
    }
}

/// The transfer syntax in the meta information (group 0002, always explicit little endian), and its
/// length. Its elements are followed one by one, whatever group length is stated. Parsed by hand,
/// because `dicom-object` rejects files for faults in irrelevant elements, such as an overlong
/// title.
fn meta(reader: &mut impl Read) -> Option<(String, u64)> {
    let (mut syntax, mut at) = (String::new(), 0u64);
    while at < MAX_META_BYTES {
        let mut head = [0u8; 8];
        if reader.read_exact(&mut head).is_err() {
            break;
        }
        if head[..2] != [2, 0] {
            break;
        }
        let vr = &head[4..6];
        let (head_bytes, length) = if !vr.iter().all(u8::is_ascii_uppercase) {
            (8, u32::from_le_bytes([head[4], head[5], head[6], head[7]]))
        } else if matches!(
            vr,
            b"OB" | b"OW" | b"OF" | b"OD" | b"OL" | b"SQ" | b"UN" | b"UT" | b"UC" | b"UR"
        ) {
            let mut long = [0u8; 4];
            reader.read_exact(&mut long).ok()?;
            (12, u32::from_le_bytes(long))
        } else {
            (8, u32::from(u16::from_le_bytes([head[6], head[7]])))
        };
        if u64::from(length) > MAX_META_BYTES {
            return None;
        }
        let mut value = Vec::new();
        reader
            .by_ref()
            .take(u64::from(length))
            .read_to_end(&mut value)
            .ok()?;
        if value.len() as u64 != u64::from(length) {
            return None;
        }
        if head[2..4] == [0x10, 0] {
            syntax = String::from_utf8_lossy(&value)
                .trim_matches(['\0', ' '])
                .to_owned();
        }
        at += head_bytes + u64::from(length);
    }
    // Files without a transfer syntax use the default one.
    Some((
        if syntax.is_empty() {
            IMPLICIT.to_owned()
        } else {
            syntax
        },
        at,
    ))
}

/// The transfer syntax of an object, and its elements before the pixel data.
pub fn header(source: &ObjectLocation) -> Result<(String, DataSet)> {
    let mut opened = open(source, MAX_HEADER_BYTES)?;
    let set = data_set(&mut opened.reader, opened.declared).map_err(|problem| {
        Error::file(
            source.path(),
            format!("is a damaged DICOM file ({problem}); copy or export it again"),
        )
    })?;
    Ok((opened.syntax, set))
}

/// An error message without the line breaks of nested errors.
pub fn one_line(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        text = inner.to_string();
        cause = inner.source();
    }
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
