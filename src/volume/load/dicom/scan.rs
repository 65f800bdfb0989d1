//! The DICOM objects in a file, a folder or a zip, and the content of their headers: one [`Frame`]
//! for every plane of pixels.

use super::super::source::DEFLATE_LIMIT;
use super::location::{Bytes, ObjectLocation, ReadSeek, files_in, members};
use super::syntax::max_compression_ratio;
use crate::files::input;
use crate::panic_guard::catch_panic;
use crate::volume::{Label, Rescale};
use crate::{ByteProgress, Error, Result, Watch};
use dicom_core::Tag;
use dicom_core::header::HasLength;
use dicom_dictionary_std::tags;
use dicom_encoding::transfer_syntax::TransferSyntaxIndex;
use dicom_object::{DicomCollector, InMemDicomObject};
use dicom_parser::dataset::LazyDataToken;
use dicom_parser::dataset::lazy_read::LazyDataSetReader;
use dicom_parser::{DynStatefulDecoder, StatefulDecode};
use dicom_transfer_syntax_registry::TransferSyntaxRegistry;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashSet;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

/// Little endian: implicit VR, explicit VR, and deflated explicit VR.
const IMPLICIT: &str = "1.2.840.10008.1.2";
const EXPLICIT: &str = "1.2.840.10008.1.2.1";
const DEFLATED: &str = "1.2.840.10008.1.2.1.99";
/// Segmentation storage, and the newer class whose pixels are labels.
const SEGMENTATION: [&str; 2] = ["1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7"];
/// Number of bytes of a deflated object within which its header must end.
const MAX_HEADER_BYTES: u64 = 64 << 20;
/// Maximum size of the meta information, bytes.
const MAX_META_BYTES: u64 = 1 << 20;
/// Maximum nesting depth of sequences.
const MAX_NESTED_SEQUENCES: usize = 64;
/// Maximum number of frames in one object.
const MAX_FRAMES: usize = 1 << 20;

/// The storage of pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelFormat {
    pub rows: u16,
    pub columns: u16,
    pub samples: u16,
    pub allocated: u16,
    pub stored: u16,
    pub high_bit: u16,
    pub signed: bool,
    /// Floating-point pixels of 32 or 64 bits.
    pub float: bool,
    pub photometric: String,
    pub planar: bool,
}

impl PixelFormat {
    /// Number of values in a frame.
    pub fn values(&self) -> usize {
        usize::from(self.rows) * usize::from(self.columns) * usize::from(self.samples)
    }

    /// Bytes of an uncompressed frame; for 1-bit pixels, rounded up.
    pub fn frame_bytes(&self) -> usize {
        if self.allocated == 1 { self.values().div_ceil(8) } else { self.values() * usize::from(self.allocated / 8) }
    }
}

/// A plane of pixels.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Its object, and its index among the object's frames.
    pub object: usize,
    pub number: usize,
    /// Centre of the first pixel, mm; none if the object does not state it.
    pub position: Option<DVec3>,
    /// Whether the object states the frame's position, and its orientation.
    pub stated: [bool; 2],
    /// Directions of increasing column and row.
    pub along: [DVec3; 2],
    /// Distance between columns and between rows, mm.
    pub spacing: [f64; 2],
    pub rescale: Rescale,
    /// Segment of a frame in a segmentation.
    pub segment: u16,
    /// Keys that distinguish frames at the same position, in order.
    pub order: [f64; 5],
}

/// The meaning of a segmentation's pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SegmentsAs {
    /// Labels.
    Labels,
    /// Fractions of the frame's segment, relative to this maximum.
    Shares(u16),
}

/// The content of an object's header.
pub struct Object {
    pub source: ObjectLocation,
    pub syntax: String,
    pub instance: String,
    pub series: String,
    pub series_number: Option<i64>,
    pub description: String,
    pub modality: String,
    pub patient: [String; 2],
    pub format: PixelFormat,
    pub padding: Option<[f64; 2]>,
    /// Distance between slices, if the object states it.
    pub slice_spacing: Option<f64>,
    pub segmentation: bool,
    pub segments_as: SegmentsAs,
    pub segments: Vec<Label>,
    pub frames: Vec<Frame>,
    /// Red, green, blue tables of a palette: first value mapped, and entries.
    pub palette: Option<[(i64, Vec<u8>); 3]>,
}

/// The result of a scan.
pub struct ScanResult {
    pub objects: Vec<Object>,
    /// Number of files that are DICOM without pixels, or not DICOM.
    pub others: usize,
    /// Number of unreadable DICOM files, and the first one's error.
    pub damaged: usize,
    pub complaint: Option<Error>,
    /// Notes about omitted parts of a folder.
    pub notes: Vec<String>,
}

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

/// The objects in a file, in a folder and all its subfolders, or in a zip.
pub fn scan(path: &Path, watch: &Watch) -> Result<ScanResult> {
    let (sources, notes) = if path.is_dir() {
        files_in(path, watch)?
    } else {
        (members(path, watch)?.unwrap_or_else(|| vec![ObjectLocation::File(path.to_owned())]), Vec::new())
    };
    let single = !path.is_dir() && sources.len() == 1;
    let meter = ByteProgress::new(watch, sources.len() as u64);
    let read: Vec<Result<Option<Object>>> = sources
        .into_par_iter()
        .map(|source| {
            meter.add(1)?;
            if !single && !looks_like_dicom(&source) {
                return Ok(None);
            }
            object(source)
        })
        .collect();
    let mut found = ScanResult { objects: Vec::new(), others: 0, damaged: 0, complaint: None, notes };
    let mut seen = HashSet::new();
    for result in read {
        match result {
            // Copies of the same object, under whatever names, count once.
            Ok(Some(object)) if !object.instance.is_empty() && !seen.insert(object.instance.clone()) => found.others += 1,
            Ok(Some(mut object)) => {
                let index = found.objects.len();
                object.frames.iter_mut().for_each(|f| f.object = index);
                found.objects.push(object);
            }
            Ok(None) => found.others += 1,
            Err(Error::Cancelled) => return Err(Error::Cancelled),
            Err(error) => {
                found.damaged += 1;
                found.complaint.get_or_insert(error);
            }
        }
    }
    Ok(found)
}

fn looks_like_dicom(source: &ObjectLocation) -> bool {
    let mut start = Vec::new();
    source.open(132).is_ok_and(|reader| reader.take(132).read_to_end(&mut start).is_ok()) && is_dicom(&start)
}

/// An object at the start of its data set.
pub struct Opened {
    reader: Bytes,
    /// Transfer syntax of the data set, and of the whole object.
    dataset: String,
    pub syntax: String,
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
        let syntax = TransferSyntaxRegistry.get(&self.dataset).ok_or_else(|| invalid("an unknown transfer syntax".into()))?;
        let tokens = LazyDataSetReader::new_with_ts(self.reader, syntax).map_err(|e| invalid(one_line(&e)))?;
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
            LazyDataToken::LazyValue { header, .. } if header.tag == tags::PIXEL_DATA && depth == 0 => return Ok(()),
            LazyDataToken::LazyValue { header, decoder } => pass(decoder, header.length().0, end)?,
            LazyDataToken::LazyItemValue { len, decoder } => pass(decoder, len, end)?,
            // The parser used afterwards descends by recursion.
            LazyDataToken::SequenceStart { .. } | LazyDataToken::PixelSequenceStart if depth == MAX_NESTED_SEQUENCES => {
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
    let damaged = |e: String| Error::file(path, format!("is not a readable DICOM file ({e}); copy or export it again"));
    let io = |e: std::io::Error| Error::io(path, "reading", e);
    let mut start = Vec::new();
    source.open(132)?.take(132).read_to_end(&mut start).map_err(io)?;
    if !is_dicom(&start) {
        return Err(Error::file(path, "is not a DICOM file"));
    }
    let magic = if start.len() >= 132 && &start[128..132] == b"DICM" { 132 } else { 4 };
    if magic == 4 && bare_dataset(&start) {
        let explicit = start[4..6].iter().all(u8::is_ascii_uppercase);
        let syntax = if explicit { EXPLICIT } else { IMPLICIT };
        return Ok(Opened { reader: source.open(most)?, dataset: syntax.to_owned(), syntax: syntax.to_owned() });
    }
    let mut reader = source.open(most)?;
    reader.seek(SeekFrom::Start(magic)).map_err(io)?;
    let (syntax, length) = meta(&mut reader).ok_or_else(|| damaged("its first elements are damaged or end too early".into()))?;
    reader.seek(SeekFrom::Start(magic + length)).map_err(io)?;
    if syntax != DEFLATED {
        // Retired compressed syntaxes use an explicit data set like all others.
        let dataset = TransferSyntaxRegistry.get(&syntax).map_or(EXPLICIT, |s| s.uid());
        return Ok(Opened { reader, dataset: dataset.to_owned(), syntax });
    }
    let limit = most.min(source.bytes().saturating_mul(DEFLATE_LIMIT));
    let bytes = input::start_of(path, flate2::read::DeflateDecoder::new(reader), limit)?;
    let reader: Box<dyn ReadSeek> = Box::new(Cursor::new(bytes));
    Ok(Opened { reader: BufReader::new(reader), dataset: EXPLICIT.to_owned(), syntax })
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
        } else if matches!(vr, b"OB" | b"OW" | b"OF" | b"OD" | b"OL" | b"SQ" | b"UN" | b"UT" | b"UC" | b"UR") {
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
        reader.by_ref().take(u64::from(length)).read_to_end(&mut value).ok()?;
        if value.len() as u64 != u64::from(length) {
            return None;
        }
        if head[2..4] == [0x10, 0] {
            syntax = String::from_utf8_lossy(&value).trim_matches(['\0', ' ']).to_owned();
        }
        at += head_bytes + u64::from(length);
    }
    // Files without a transfer syntax use the default one.
    Some((if syntax.is_empty() { IMPLICIT.to_owned() } else { syntax }, at))
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

/// An object's header; none if it contains no pixels.
fn object(source: ObjectLocation) -> Result<Option<Object>> {
    let path = source.path().to_owned();
    let ended = || Error::file(&path, "is a damaged DICOM file; copy or export it again");
    catch_panic(|| -> Result<Option<Object>> {
        let damaged = |e: String| Error::file(source.path(), format!("is a damaged DICOM file ({e}); copy or export it again"));
        check_lengths(open(&source, MAX_HEADER_BYTES)?).map_err(damaged)?;
        let opened = open(&source, MAX_HEADER_BYTES)?;
        let syntax = opened.syntax.clone();
        let mut dataset = InMemDicomObject::new_empty();
        opened.collector().read_dataset_up_to_pixeldata(&mut dataset).map_err(|e| damaged(one_line(&e)))?;
        described(source.clone(), syntax, &dataset)
    })
    .ok_or_else(ended)?
}

/// The text of an element, without padding.
fn text(set: &InMemDicomObject, tag: Tag) -> String {
    set.get(tag).and_then(|e| e.to_str().ok()).map(|t| t.trim_matches(['\0', ' ']).trim().to_owned()).unwrap_or_default()
}

/// Numbers of an element; none if it has none, or any cannot be parsed.
fn numbers(set: &InMemDicomObject, tag: Tag) -> Option<Vec<f64>> {
    set.get(tag)?.to_multi_float64().ok().filter(|v| !v.is_empty() && v.iter().all(|n| n.is_finite()))
}

fn number(set: &InMemDicomObject, tag: Tag) -> Option<f64> {
    numbers(set, tag)?.first().copied()
}

fn vector<const N: usize>(set: &InMemDicomObject, tag: Tag) -> Option<[f64; N]> {
    numbers(set, tag)?.get(..N)?.try_into().ok()
}

/// The first item of a sequence.
fn item(set: &InMemDicomObject, tag: Tag) -> Option<&InMemDicomObject> {
    set.get(tag)?.items()?.first()
}

fn described(source: ObjectLocation, syntax: String, set: &InMemDicomObject) -> Result<Option<Object>> {
    let whole = |tag: Tag| number(set, tag).filter(|n| (0.0..=65_535.0).contains(n)).map(|n| n as u16);
    let (Some(rows), Some(columns)) = (whole(tags::ROWS), whole(tags::COLUMNS)) else { return Ok(None) };
    let fail = |problem: String| Error::file(source.path(), problem);
    let float = set.get(tags::FLOAT_PIXEL_DATA).is_some() || set.get(tags::DOUBLE_FLOAT_PIXEL_DATA).is_some();
    let allocated = whole(tags::BITS_ALLOCATED).unwrap_or(16);
    let stored = whole(tags::BITS_STORED).unwrap_or(allocated);
    let format = PixelFormat {
        rows,
        columns,
        samples: whole(tags::SAMPLES_PER_PIXEL).unwrap_or(1),
        allocated,
        stored,
        high_bit: whole(tags::HIGH_BIT).unwrap_or(stored.saturating_sub(1)),
        signed: whole(tags::PIXEL_REPRESENTATION) == Some(1),
        float,
        photometric: text(set, tags::PHOTOMETRIC_INTERPRETATION),
        planar: whole(tags::PLANAR_CONFIGURATION) == Some(1),
    };
    if rows == 0 || columns == 0 {
        return Err(fail(format!("declares a picture of {columns} x {rows} pixels; its header is damaged")));
    }
    if !matches!(format.samples, 1 | 3 | 4) || !matches!(allocated, 1 | 8 | 16 | 32 | 64) || allocated == 64 && !float {
        return Err(fail(format!("stores {} samples of {allocated} bits per pixel, which cannot be read", format.samples)));
    }
    if stored == 0 || stored > allocated || format.high_bit >= allocated || format.high_bit + 1 < stored {
        return Err(fail(format!("has {stored} bits stored of {allocated} allocated with high bit {}; its header is damaged", format.high_bit)));
    }
    let class = text(set, tags::SOP_CLASS_UID);
    let segmentation = SEGMENTATION.contains(&class.as_str()) || text(set, tags::MODALITY) == "SEG";
    // The number of frames is limited to what the object's bytes can contain.
    let ratio = max_compression_ratio(&syntax, format.frame_bytes());
    let most = if ratio <= max_compression_ratio(DEFLATED, 0) && allocated > 1 {
        source.bytes().saturating_mul(ratio) / format.frame_bytes() as u64
    } else {
        // A compressed frame has a header of eight bytes; single bits are not padded.
        source.bytes().saturating_mul(8) / if allocated == 1 { format.values() as u64 } else { 64 }
    };
    let frames = frames(set, &format, segmentation, most.max(1)).map_err(fail)?;
    let padding = number(set, tags::PIXEL_PADDING_VALUE).map(|value| {
        let limit = number(set, tags::PIXEL_PADDING_RANGE_LIMIT).unwrap_or(value);
        // The value may have been read with the other pixel representation.
        let signed = |v: f64| if format.signed && v > 32_767.0 && allocated == 16 { v - 65_536.0 } else { v };
        let (a, b) = (signed(value), signed(limit));
        [a.min(b), a.max(b)]
    });
    let shared = item(set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
    let measures = shared.and_then(|s| item(s, tags::PIXEL_MEASURES_SEQUENCE)).unwrap_or(set);
    let slice_spacing = number(measures, tags::SPACING_BETWEEN_SLICES).or_else(|| number(measures, tags::SLICE_THICKNESS));
    Ok(Some(Object {
        instance: text(set, tags::SOP_INSTANCE_UID),
        segments_as: match text(set, tags::SEGMENTATION_TYPE).as_str() {
            "LABELMAP" => SegmentsAs::Labels,
            _ if class == SEGMENTATION[1] => SegmentsAs::Labels,
            "FRACTIONAL" => SegmentsAs::Shares(whole(tags::MAXIMUM_FRACTIONAL_VALUE).unwrap_or(255)),
            _ => SegmentsAs::Shares(1),
        },
        series: text(set, tags::SERIES_INSTANCE_UID),
        series_number: number(set, tags::SERIES_NUMBER).map(|n| n as i64),
        description: text(set, tags::SERIES_DESCRIPTION),
        modality: text(set, tags::MODALITY),
        patient: [text(set, tags::PATIENT_NAME), text(set, tags::PATIENT_ID)],
        padding: padding.filter(|_| !segmentation),
        slice_spacing: slice_spacing.map(f64::abs).filter(|s| *s > 0.0),
        segmentation,
        segments: if segmentation { segments(set) } else { Vec::new() },
        palette: if format.photometric == "PALETTE COLOR" { palette(set) } else { None },
        frames,
        format,
        syntax,
        source,
    }))
}

/// Planes of an object, each with its geometry.
fn frames(set: &InMemDicomObject, format: &PixelFormat, segmentation: bool, most: u64) -> Result<Vec<Frame>, String> {
    let count = number(set, tags::NUMBER_OF_FRAMES).unwrap_or(1.0);
    if !(1.0..=(MAX_FRAMES as u64).min(most) as f64).contains(&count) {
        return Err(format!("declares {count} frames, which it cannot hold: it is truncated or its header is damaged; copy or export it again"));
    }
    let count = count as usize;
    let shared = item(set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
    let per_frame = set.get(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE).and_then(|e| e.items()).unwrap_or(&[]);
    // For consecutive frames, its sign gives the direction (PS3.3 C.8.4.15).
    let slice_spacing =
        [tags::SPACING_BETWEEN_SLICES, tags::SLICE_THICKNESS].into_iter().filter_map(|t| number(set, t)).find(|s| *s != 0.0).unwrap_or(1.0);
    let detector = item(set, tags::DETECTOR_INFORMATION_SEQUENCE);
    let mut frames = Vec::with_capacity(count.min(4096));
    for n in 0..count {
        let own = per_frame.get(n);
        // The frame's own group, else the shared one, else the object itself.
        let group = |tag: Tag| own.and_then(|o| item(o, tag)).or_else(|| shared.and_then(|s| item(s, tag)));
        let from = |tag: Tag, attribute: Tag| group(tag).unwrap_or(set).get(attribute).is_some().then(|| group(tag).unwrap_or(set));
        let orientation = from(tags::PLANE_ORIENTATION_SEQUENCE, tags::IMAGE_ORIENTATION_PATIENT)
            .or(detector)
            .and_then(|s| vector::<6>(s, tags::IMAGE_ORIENTATION_PATIENT));
        let [along, down] = match orientation {
            Some(v) => [DVec3::new(v[0], v[1], v[2]).normalize_or_zero(), DVec3::new(v[3], v[4], v[5]).normalize_or_zero()],
            None => [DVec3::X, DVec3::Y],
        };
        if along.cross(down).length() < 1e-3 {
            return Err("has an invalid image orientation (row and column directions); its header is damaged".into());
        }
        let mut position = from(tags::PLANE_POSITION_SEQUENCE, tags::IMAGE_POSITION_PATIENT)
            .or(detector)
            .and_then(|s| vector::<3>(s, tags::IMAGE_POSITION_PATIENT))
            .map(DVec3::from_array);
        let stated = [position.is_some(), orientation.is_some()];
        if count > 1 && own.is_none() {
            // Frames without positions are consecutive.
            position = Some(position.unwrap_or(DVec3::ZERO) + along.cross(down).normalize_or_zero() * (slice_spacing * n as f64));
        }
        let measures = group(tags::PIXEL_MEASURES_SEQUENCE).unwrap_or(set);
        let spacing = [tags::PIXEL_SPACING, tags::IMAGER_PIXEL_SPACING, tags::NOMINAL_SCANNED_PIXEL_SPACING]
            .into_iter()
            .find_map(|tag| vector::<2>(measures, tag).or_else(|| vector::<2>(set, tag)))
            .filter(|s| s.iter().all(|v| *v > 0.0));
        let transform = group(tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE).unwrap_or(set);
        let slope = number(transform, tags::RESCALE_SLOPE).filter(|s| *s != 0.0);
        let intercept = number(transform, tags::RESCALE_INTERCEPT).unwrap_or(0.0);
        let rescale = match slope {
            Some(slope) if format.samples == 1 && !segmentation => Rescale { slope, intercept },
            _ => Rescale::NONE,
        };
        let content = group(tags::FRAME_CONTENT_SEQUENCE);
        let order = [
            content.and_then(|c| number(c, tags::TEMPORAL_POSITION_INDEX)).or_else(|| number(set, tags::TEMPORAL_POSITION_IDENTIFIER)),
            number(set, tags::ACQUISITION_NUMBER),
            number(set, tags::ECHO_TIME),
            number(set, tags::TRIGGER_TIME),
            number(set, tags::INSTANCE_NUMBER).map(|i| i + n as f64 * 1e-6),
        ]
        .map(|v| v.unwrap_or(0.0));
        let segment = group(tags::SEGMENT_IDENTIFICATION_SEQUENCE).and_then(|s| number(s, tags::REFERENCED_SEGMENT_NUMBER));
        frames.push(Frame {
            object: 0,
            number: n,
            position,
            stated,
            along: [along, down],
            // Stored as the distance between rows, then between columns.
            spacing: spacing.map_or([0.0; 2], |[rows, columns]| [columns, rows]),
            rescale,
            segment: segment.map_or(1, |s| s as u16),
            order,
        });
    }
    Ok(frames)
}

/// Names and colours of segments.
fn segments(set: &InMemDicomObject) -> Vec<Label> {
    let items = set.get(tags::SEGMENT_SEQUENCE).and_then(|e| e.items()).unwrap_or(&[]);
    items
        .iter()
        .filter_map(|segment| {
            let value = number(segment, tags::SEGMENT_NUMBER)? as u32;
            let lab = vector::<3>(segment, tags::RECOMMENDED_DISPLAY_CIE_LAB_VALUE);
            Some(Label { value, name: text(segment, tags::SEGMENT_LABEL), color: lab.map(rgb_of_lab) })
        })
        .collect()
}

/// sRGB of a colour in DICOM's 16-bit CIELab (white point D50). Source: DICOM PS3.3 C.10.7.1.1,
/// PS3.15 B.
fn rgb_of_lab([l, a, b]: [f64; 3]) -> [u8; 3] {
    let (l, a, b) = (l / 65_535.0 * 100.0, a / 65_535.0 * 255.0 - 128.0, b / 65_535.0 * 255.0 - 128.0);
    let fy = (l + 16.0) / 116.0;
    let inverse = |t: f64| if t > 6.0 / 29.0 { t * t * t } else { 3.0 * (6.0f64 / 29.0).powi(2) * (t - 4.0 / 29.0) };
    let (x, y, z) = (0.9642 * inverse(fy + a / 500.0), inverse(fy), 0.8249 * inverse(fy - b / 200.0));
    // D50 to linear sRGB (Bradford).
    let linear = [
        3.133_856 * x - 1.616_867 * y - 0.490_615 * z,
        -0.978_768 * x + 1.916_142 * y + 0.033_454 * z,
        0.071_945 * x - 0.228_991 * y + 1.405_243 * z,
    ];
    linear.map(|v| {
        let v = v.clamp(0.0, 1.0);
        let encoded = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
        (encoded * 255.0 + 0.5) as u8
    })
}

/// Colour tables of a palette, 8 bits each.
fn palette(set: &InMemDicomObject) -> Option<[(i64, Vec<u8>); 3]> {
    let channel = |descriptor: Tag, values: Tag| -> Option<(i64, Vec<u8>)> {
        let d = numbers(set, descriptor)?;
        let [entries, first, bits] = *d.get(..3)? else { return None };
        let bytes = set.get(values)?.to_bytes().ok()?;
        let table: Vec<u8> = if bits > 8.0 { bytes.chunks_exact(2).map(|b| b[1]).collect() } else { bytes.to_vec() };
        let entries = if entries == 0.0 { 65_536 } else { entries as usize };
        (!table.is_empty()).then(|| (first as i64, table.into_iter().take(entries).collect()))
    };
    Some([
        channel(tags::RED_PALETTE_COLOR_LOOKUP_TABLE_DESCRIPTOR, tags::RED_PALETTE_COLOR_LOOKUP_TABLE_DATA)?,
        channel(tags::GREEN_PALETTE_COLOR_LOOKUP_TABLE_DESCRIPTOR, tags::GREEN_PALETTE_COLOR_LOOKUP_TABLE_DATA)?,
        channel(tags::BLUE_PALETTE_COLOR_LOOKUP_TABLE_DESCRIPTOR, tags::BLUE_PALETTE_COLOR_LOOKUP_TABLE_DATA)?,
    ])
}

/// A whole data set in memory: for the few objects whose pixels are not in the usual element.
pub fn whole(source: &ObjectLocation) -> Result<InMemDicomObject> {
    let damaged = |e: String| Error::file(source.path(), format!("is a damaged DICOM file ({e}); copy or export it again"));
    check_lengths(open(source, u64::MAX)?).map_err(damaged)?;
    let mut set = InMemDicomObject::new_empty();
    open(source, u64::MAX)?.collector().read_dataset_to_end(&mut set).map_err(|e| damaged(one_line(&e)))?;
    Ok(set)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_of_segments() {
        // Grey of half lightness, and the most saturated red of sRGB (L 54.3, a 80.8, b 69.9 for
        // D50).
        let coded = |l: f64, a: f64, b: f64| [l / 100.0 * 65_535.0, (a + 128.0) / 255.0 * 65_535.0, (b + 128.0) / 255.0 * 65_535.0];
        let [r, g, b] = rgb_of_lab(coded(50.0, 0.0, 0.0));
        assert!(r.abs_diff(119) <= 1 && g.abs_diff(119) <= 1 && b.abs_diff(119) <= 1, "{r} {g} {b}");
        let [r, g, b] = rgb_of_lab(coded(54.29, 80.81, 69.89));
        assert!(r > 252 && g < 8 && b < 8, "{r} {g} {b}");
    }
}
