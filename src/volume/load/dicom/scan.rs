//! The DICOM objects in a file, a folder or a zip, and the content of their headers: one [`Frame`]
//! for every plane of pixels.

use super::dataset::{DEFLATED, header, is_dicom};
use super::element::{item, number, numbers, text, vector, whole_number};
use super::frames::{Frame, PixelFormat, frames};
use super::location::{ObjectLocation, files_in, members};
use super::structures::{is_structure_set, label_of};
use super::syntax::max_compression_ratio;
use crate::panic_guard::catch_panic;
use crate::volume::Label;
use crate::{ByteProgress, Error, Result, Watch};
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use rayon::prelude::*;
use std::collections::HashSet;
use std::io::Read;
use std::path::Path;

/// Segmentation storage, and the newer class whose pixels are labels.
const SEGMENTATION: [&str; 2] = ["1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7"];

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

impl Object {
    /// Whether it is a structure set: it has contours instead of frames.
    pub fn is_structure_set(&self) -> bool {
        self.frames.is_empty()
    }
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

/// The objects in a file, in a folder and all its subfolders, or in a zip.
pub fn scan(path: &Path, watch: &Watch) -> Result<ScanResult> {
    let (sources, notes) = if path.is_dir() {
        files_in(path, watch)?
    } else {
        (
            members(path, watch)?.unwrap_or_else(|| vec![ObjectLocation::File(path.to_owned())]),
            Vec::new(),
        )
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
    let mut found = ScanResult {
        objects: Vec::new(),
        others: 0,
        damaged: 0,
        complaint: None,
        notes,
    };
    let mut seen = HashSet::new();
    for result in read {
        match result {
            // Copies of the same object, under whatever names, count once.
            Ok(Some(object)) if !object.instance.is_empty() && !seen.insert(object.instance.clone()) => {
                found.others += 1
            }
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
    source
        .open(132)
        .is_ok_and(|reader| reader.take(132).read_to_end(&mut start).is_ok())
        && is_dicom(&start)
}

/// An object's header; none if it contains neither pixels nor contours.
fn object(source: ObjectLocation) -> Result<Option<Object>> {
    let path = source.path().to_owned();
    let ended = || Error::file(&path, "is a damaged DICOM file; copy or export it again");
    catch_panic(|| -> Result<Option<Object>> {
        let (syntax, dataset) = header(&source)?;
        object_of(source.clone(), syntax, &dataset)
    })
    .ok_or_else(ended)?
}

/// The storage of an object's pixels; none if it has no pixels.
fn pixel_format(set: &InMemDicomObject) -> Option<PixelFormat> {
    let whole = |tag: Tag| whole_number(set, tag);
    let (rows, columns) = (whole(tags::ROWS)?, whole(tags::COLUMNS)?);
    let allocated = whole(tags::BITS_ALLOCATED).unwrap_or(16);
    let stored = whole(tags::BITS_STORED).unwrap_or(allocated);
    Some(PixelFormat {
        rows,
        columns,
        samples: whole(tags::SAMPLES_PER_PIXEL).unwrap_or(1),
        allocated,
        stored,
        high_bit: whole(tags::HIGH_BIT).unwrap_or(stored.saturating_sub(1)),
        signed: whole(tags::PIXEL_REPRESENTATION) == Some(1),
        float: set.get(tags::FLOAT_PIXEL_DATA).is_some() || set.get(tags::DOUBLE_FLOAT_PIXEL_DATA).is_some(),
        photometric: text(set, tags::PHOTOMETRIC_INTERPRETATION),
        planar: whole(tags::PLANAR_CONFIGURATION) == Some(1),
    })
}

/// Rejects picture sizes and bit depths that cannot be read.
fn check_format(format: &PixelFormat) -> Result<(), String> {
    let PixelFormat {
        rows,
        columns,
        samples,
        allocated,
        stored,
        high_bit,
        ..
    } = *format;
    if rows == 0 || columns == 0 {
        return Err(format!(
            "declares a picture of {columns} x {rows} pixels; its header is damaged"
        ));
    }
    if !matches!(samples, 1 | 3 | 4)
        || !matches!(allocated, 1 | 8 | 16 | 32 | 64)
        || allocated == 64 && !format.float
    {
        return Err(format!(
            "stores {samples} samples of {allocated} bits per pixel, which cannot be read"
        ));
    }
    if stored == 0 || stored > allocated || high_bit >= allocated || high_bit + 1 < stored {
        return Err(format!(
            "has {stored} bits stored of {allocated} allocated with high bit {high_bit}; its header is damaged"
        ));
    }
    Ok(())
}

/// Maximum number of frames that the object's bytes can contain.
fn max_frames(source: &ObjectLocation, syntax: &str, format: &PixelFormat) -> u64 {
    let ratio = max_compression_ratio(syntax, format.frame_bytes());
    let most = if ratio <= max_compression_ratio(DEFLATED, 0) && format.allocated > 1 {
        source.bytes().saturating_mul(ratio) / format.frame_bytes() as u64
    } else {
        // A compressed frame has a header of eight bytes; single bits are not padded.
        source.bytes().saturating_mul(8)
            / if format.allocated == 1 {
                format.values() as u64
            } else {
                64
            }
    };
    most.max(1)
}

/// Smallest and largest stored value that mean "no value".
fn padding(set: &InMemDicomObject, format: &PixelFormat) -> Option<[f64; 2]> {
    let value = number(set, tags::PIXEL_PADDING_VALUE)?;
    let limit = number(set, tags::PIXEL_PADDING_RANGE_LIMIT).unwrap_or(value);
    // The value may have been read with the other pixel representation.
    let signed = |v: f64| {
        if format.signed && v > 32_767.0 && format.allocated == 16 {
            v - 65_536.0
        } else {
            v
        }
    };
    let (a, b) = (signed(value), signed(limit));
    Some([a.min(b), a.max(b)])
}

/// Distance between slices, mm, if the object states it.
fn slice_spacing(set: &InMemDicomObject) -> Option<f64> {
    let shared = item(set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
    let measures = shared
        .and_then(|s| item(s, tags::PIXEL_MEASURES_SEQUENCE))
        .unwrap_or(set);
    let spacing =
        number(measures, tags::SPACING_BETWEEN_SLICES).or_else(|| number(measures, tags::SLICE_THICKNESS));
    spacing.map(f64::abs).filter(|s| *s > 0.0)
}

/// What the pixels of a segmentation mean, given its SOP class.
fn segments_as(set: &InMemDicomObject, class: &str) -> SegmentsAs {
    match text(set, tags::SEGMENTATION_TYPE).as_str() {
        "LABELMAP" => SegmentsAs::Labels,
        _ if class == SEGMENTATION[1] => SegmentsAs::Labels,
        "FRACTIONAL" => SegmentsAs::Shares(whole_number(set, tags::MAXIMUM_FRACTIONAL_VALUE).unwrap_or(255)),
        _ => SegmentsAs::Shares(1),
    }
}

/// The object that a header describes; none if it has neither pixels nor contours.
fn object_of(source: ObjectLocation, syntax: String, set: &InMemDicomObject) -> Result<Option<Object>> {
    let Some(format) = pixel_format(set) else {
        return Ok(is_structure_set(set).then(|| structure_set(source, syntax, set)));
    };
    let fail = |problem: String| Error::file(source.path(), problem);
    check_format(&format).map_err(fail)?;
    let class = text(set, tags::SOP_CLASS_UID);
    let segmentation = SEGMENTATION.contains(&class.as_str()) || text(set, tags::MODALITY) == "SEG";
    let frames = frames(set, &format, segmentation, max_frames(&source, &syntax, &format)).map_err(fail)?;
    Ok(Some(Object {
        instance: text(set, tags::SOP_INSTANCE_UID),
        segments_as: segments_as(set, &class),
        series: text(set, tags::SERIES_INSTANCE_UID),
        series_number: number(set, tags::SERIES_NUMBER).map(|n| n as i64),
        description: text(set, tags::SERIES_DESCRIPTION),
        modality: text(set, tags::MODALITY),
        patient: [text(set, tags::PATIENT_NAME), text(set, tags::PATIENT_ID)],
        padding: padding(set, &format).filter(|_| !segmentation),
        slice_spacing: slice_spacing(set),
        segmentation,
        segments: if segmentation { segments(set) } else { Vec::new() },
        palette: if format.photometric == "PALETTE COLOR" {
            palette(set)
        } else {
            None
        },
        frames,
        format,
        syntax,
        source,
    }))
}

/// A structure set, which has no frames.
fn structure_set(source: ObjectLocation, syntax: String, set: &InMemDicomObject) -> Object {
    Object {
        instance: text(set, tags::SOP_INSTANCE_UID),
        segments_as: SegmentsAs::Labels,
        series: text(set, tags::SERIES_INSTANCE_UID),
        series_number: number(set, tags::SERIES_NUMBER).map(|n| n as i64),
        description: label_of(set),
        modality: "RTSTRUCT".into(),
        patient: [text(set, tags::PATIENT_NAME), text(set, tags::PATIENT_ID)],
        padding: None,
        slice_spacing: None,
        segmentation: false,
        segments: Vec::new(),
        palette: None,
        frames: Vec::new(),
        format: PixelFormat {
            rows: 0,
            columns: 0,
            samples: 1,
            allocated: 16,
            stored: 16,
            high_bit: 15,
            signed: false,
            float: false,
            photometric: String::new(),
            planar: false,
        },
        syntax,
        source,
    }
}

/// Names and colours of segments.
fn segments(set: &InMemDicomObject) -> Vec<Label> {
    let items = set
        .get(tags::SEGMENT_SEQUENCE)
        .and_then(|e| e.items())
        .unwrap_or(&[]);
    items
        .iter()
        .filter_map(|segment| {
            let value = number(segment, tags::SEGMENT_NUMBER)? as u32;
            let lab = vector::<3>(segment, tags::RECOMMENDED_DISPLAY_CIE_LAB_VALUE);
            Some(Label {
                value,
                name: text(segment, tags::SEGMENT_LABEL),
                color: lab.map(rgb_of_lab),
            })
        })
        .collect()
}

/// sRGB of a colour in DICOM's 16-bit CIELab (white point D50). Source: DICOM PS3.3 C.10.7.1.1,
/// PS3.15 B.
fn rgb_of_lab([l, a, b]: [f64; 3]) -> [u8; 3] {
    let (l, a, b) = (
        l / 65_535.0 * 100.0,
        a / 65_535.0 * 255.0 - 128.0,
        b / 65_535.0 * 255.0 - 128.0,
    );
    let fy = (l + 16.0) / 116.0;
    let inverse = |t: f64| {
        if t > 6.0 / 29.0 {
            t * t * t
        } else {
            3.0 * (6.0f64 / 29.0).powi(2) * (t - 4.0 / 29.0)
        }
    };
    let (x, y, z) = (
        0.9642 * inverse(fy + a / 500.0),
        inverse(fy),
        0.8249 * inverse(fy - b / 200.0),
    );
    // D50 to linear sRGB (Bradford).
    let linear = [
        3.133_856 * x - 1.616_867 * y - 0.490_615 * z,
        -0.978_768 * x + 1.916_142 * y + 0.033_454 * z,
        0.071_945 * x - 0.228_991 * y + 1.405_243 * z,
    ];
    linear.map(|v| {
        let v = v.clamp(0.0, 1.0);
        let encoded = if v <= 0.003_130_8 {
            12.92 * v
        } else {
            1.055 * v.powf(1.0 / 2.4) - 0.055
        };
        (encoded * 255.0 + 0.5) as u8
    })
}

/// Colour tables of a palette, 8 bits each.
fn palette(set: &InMemDicomObject) -> Option<[(i64, Vec<u8>); 3]> {
    let channel = |descriptor: Tag, values: Tag| -> Option<(i64, Vec<u8>)> {
        let d = numbers(set, descriptor)?;
        let [entries, first, bits] = *d.get(..3)? else {
            return None;
        };
        let bytes = set.get(values)?.to_bytes().ok()?;
        let table: Vec<u8> = if bits > 8.0 {
            bytes.chunks_exact(2).map(|b| b[1]).collect()
        } else {
            bytes.to_vec()
        };
        let entries = if entries == 0.0 { 65_536 } else { entries as usize };
        (!table.is_empty()).then(|| (first as i64, table.into_iter().take(entries).collect()))
    };
    Some([
        channel(
            tags::RED_PALETTE_COLOR_LOOKUP_TABLE_DESCRIPTOR,
            tags::RED_PALETTE_COLOR_LOOKUP_TABLE_DATA,
        )?,
        channel(
            tags::GREEN_PALETTE_COLOR_LOOKUP_TABLE_DESCRIPTOR,
            tags::GREEN_PALETTE_COLOR_LOOKUP_TABLE_DATA,
        )?,
        channel(
            tags::BLUE_PALETTE_COLOR_LOOKUP_TABLE_DESCRIPTOR,
            tags::BLUE_PALETTE_COLOR_LOOKUP_TABLE_DATA,
        )?,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_of_segments() {
        // Grey of half lightness, and the most saturated red of sRGB (L 54.3, a 80.8, b 69.9 for
        // D50).
        let coded = |l: f64, a: f64, b: f64| {
            [
                l / 100.0 * 65_535.0,
                (a + 128.0) / 255.0 * 65_535.0,
                (b + 128.0) / 255.0 * 65_535.0,
            ]
        };
        let [r, g, b] = rgb_of_lab(coded(50.0, 0.0, 0.0));
        assert!(
            r.abs_diff(119) <= 1 && g.abs_diff(119) <= 1 && b.abs_diff(119) <= 1,
            "{r} {g} {b}"
        );
        let [r, g, b] = rgb_of_lab(coded(54.29, 80.81, 69.89));
        assert!(r > 252 && g < 8 && b < 8, "{r} {g} {b}");
    }
}
