//! The bytes of a DICOM object: its transfer syntax, and its elements one by one. Lengths are
//! checked before anything is parsed into memory.

use super::super::source::DEFLATE_LIMIT;
use super::location::{Bytes, ObjectLocation, ReadSeek};
use crate::files::input;
use crate::{Error, Result};
use dicom_core::header::HasLength;
use dicom_dictionary_std::tags;
use dicom_encoding::transfer_syntax::TransferSyntaxIndex;
use dicom_object::{DicomCollector, InMemDicomObject};
use dicom_parser::dataset::LazyDataToken;
use dicom_parser::dataset::lazy_read::LazyDataSetReader;
use dicom_parser::{DynStatefulDecoder, StatefulDecode};
use dicom_transfer_syntax_registry::TransferSyntaxRegistry;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};

/// Little endian: implicit VR, explicit VR, and deflated explicit VR.
const IMPLICIT: &str = "1.2.840.10008.1.2";
const EXPLICIT: &str = "1.2.840.10008.1.2.1";
pub const DEFLATED: &str = "1.2.840.10008.1.2.1.99";
/// Number of bytes of a deflated object within which its header must end.
const MAX_HEADER_BYTES: u64 = 64 << 20;
/// Maximum size of the meta information, bytes.
const MAX_META_BYTES: u64 = 1 << 20;
/// Maximum nesting depth of sequences.
const MAX_NESTED_SEQUENCES: usize = 64;

/// Whether these are the first bytes of a DICOM file.
pub fn is_dicom(start: &[u8]) -> bool {
    start.len() >= 132 && &start[128..132] == b"DICM" || start.starts_with(b"DICM") || bare_dataset(start)
}

/// A data set without preamble and meta information, as written by older programs: it starts with
/// group 0008 in little endian.
fn bare_dataset(start: &[u8]) -> bool {
    if start.len() < 16 || start[..2] != [8, 0] || start[3] != 0 {
        return false;
    }
    let explicit = start[4..6].iter().all(u8::is_ascii_uppercase);
    let length = u32::from_le_bytes([start[4], start[5], start[6], start[7]]);
    explicit || (start[2] <= 0x18 && length <= 64)
}

/// An object at the start of its data set.
pub struct Opened {
    reader: Bytes,
    /// Transfer syntax of the data set, and of the whole object.
    dataset: String,
    syntax: String,
}

/// The elements of a data set one by one, without their values.
pub type Tokens = LazyDataSetReader<DynStatefulDecoder<Bytes>>;

impl Opened {
    /// The elements of the data set, and where its bytes end; positions count in the object's
    /// bytes.
    pub fn tokens(mut self) -> std::io::Result<(Tokens, u64)> {
        let invalid = |e: String| std::io::Error::new(std::io::ErrorKind::InvalidData, e);
        let start = self.reader.stream_position()?;
        let end = self.reader.seek(SeekFrom::End(0))?;
        self.reader.seek(SeekFrom::Start(start))?;
        let syntax = TransferSyntaxRegistry
            .get(&self.dataset)
            .ok_or_else(|| invalid("an unknown transfer syntax".into()))?;
        let tokens =
            LazyDataSetReader::new_with_ts(self.reader, syntax).map_err(|e| invalid(one_line(&e)))?;
        Ok((tokens, end))
    }

    fn collector(self) -> DicomCollector<Bytes> {
        DicomCollector::new_with_ts(self.reader, self.dataset)
    }
}

/// Skips a value, if it is complete.
fn pass(decoder: &mut DynStatefulDecoder<Bytes>, length: u32, end: u64) -> Result<(), String> {
    if u64::from(length) > end.saturating_sub(decoder.position()) {
        return Err(format!("an element of {length} bytes goes beyond its end"));
    }
    decoder.skip_bytes(length).map_err(|e| one_line(&e))
}

/// Walks through a header without storing anything, to check that no element is longer than the
/// rest of its object: the parser used afterwards allocates an element before checking that it is
/// there.
fn check_lengths(opened: Opened) -> Result<(), String> {
    let (mut tokens, end) = opened.tokens().map_err(|e| e.to_string())?;
    let mut depth = 0;
    while let Some(token) = tokens.advance() {
        match token.map_err(|e| one_line(&e))? {
            // Pixels in a sequence belong to an icon.
            LazyDataToken::PixelSequenceStart if depth == 0 => return Ok(()),
            LazyDataToken::LazyValue { header, .. } if header.tag == tags::PIXEL_DATA && depth == 0 => {
                return Ok(());
            }
            LazyDataToken::LazyValue { header, decoder } => pass(decoder, header.length().0, end)?,
            LazyDataToken::LazyItemValue { len, decoder } => pass(decoder, len, end)?,
            // The parser used afterwards descends by recursion.
            LazyDataToken::SequenceStart { .. } | LazyDataToken::PixelSequenceStart
                if depth == MAX_NESTED_SEQUENCES =>
            {
                return Err(format!("its sequences are more than {MAX_NESTED_SEQUENCES} deep"));
            }
            LazyDataToken::SequenceStart { .. } | LazyDataToken::PixelSequenceStart => depth += 1,
            LazyDataToken::SequenceEnd => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    Ok(())
}

/// Opens an object; `most` limits the unpacked size of a deflated one.
pub fn open(source: &ObjectLocation, most: u64) -> Result<Opened> {
    let path = source.path();
    let damaged = |e: String| {
        Error::file(
            path,
            format!("is not a readable DICOM file ({e}); copy or export it again"),
        )
    };
    let io = |e: std::io::Error| Error::io(path, "reading", e);
    let mut start = Vec::new();
    source.open(132)?.take(132).read_to_end(&mut start).map_err(io)?;
    if !is_dicom(&start) {
        return Err(Error::file(path, "is not a DICOM file"));
    }
    let magic = if start.len() >= 132 && &start[128..132] == b"DICM" {
        132
    } else {
        4
    };
    if magic == 4 && bare_dataset(&start) {
        let explicit = start[4..6].iter().all(u8::is_ascii_uppercase);
        let syntax = if explicit { EXPLICIT } else { IMPLICIT };
        return Ok(Opened {
            reader: source.open(most)?,
            dataset: syntax.to_owned(),
            syntax: syntax.to_owned(),
        });
    }
    let mut reader = source.open(most)?;
    reader.seek(SeekFrom::Start(magic)).map_err(io)?;
    let (syntax, length) =
        meta(&mut reader).ok_or_else(|| damaged("its first elements are damaged or end too early".into()))?;
    reader.seek(SeekFrom::Start(magic + length)).map_err(io)?;
    if syntax != DEFLATED {
        // Retired compressed syntaxes use an explicit data set like all others.
        let dataset = TransferSyntaxRegistry.get(&syntax).map_or(EXPLICIT, |s| s.uid());
        return Ok(Opened {
            reader,
            dataset: dataset.to_owned(),
            syntax,
        });
    }
    let limit = most.min(source.bytes().saturating_mul(DEFLATE_LIMIT));
    let bytes = input::start_of(path, flate2::read::DeflateDecoder::new(reader), limit)?;
    let reader: Box<dyn ReadSeek> = Box::new(Cursor::new(bytes));
    Ok(Opened {
        reader: BufReader::new(reader),
        dataset: EXPLICIT.to_owned(),
        syntax,
    })
}

/// The transfer syntax in the meta information (group 0002, always explicit little endian), and its
/// length. Parsed by hand, because `dicom-object` rejects files for faults in irrelevant elements,
/// such as an overlong title.
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

fn damaged(source: &ObjectLocation, problem: &str) -> Error {
    Error::file(
        source.path(),
        format!("is a damaged DICOM file ({problem}); copy or export it again"),
    )
}

/// The transfer syntax of an object, and its elements before the pixel data.
pub fn header(source: &ObjectLocation) -> Result<(String, InMemDicomObject)> {
    check_lengths(open(source, MAX_HEADER_BYTES)?).map_err(|e| damaged(source, &e))?;
    let opened = open(source, MAX_HEADER_BYTES)?;
    let syntax = opened.syntax.clone();
    let mut set = InMemDicomObject::new_empty();
    opened
        .collector()
        .read_dataset_up_to_pixeldata(&mut set)
        .map_err(|e| damaged(source, &one_line(&e)))?;
    Ok((syntax, set))
}

/// A whole data set in memory: for the few objects whose pixels are not in the usual element.
pub fn whole(source: &ObjectLocation) -> Result<InMemDicomObject> {
    check_lengths(open(source, u64::MAX)?).map_err(|e| damaged(source, &e))?;
    let mut set = InMemDicomObject::new_empty();
    open(source, u64::MAX)?
        .collector()
        .read_dataset_to_end(&mut set)
        .map_err(|e| damaged(source, &one_line(&e)))?;
    Ok(set)
}
