//! An object: the content of its header, with one [`Frame`] for every plane of pixels.

use super::dataset::header;
use super::element::{item, number, numbers, text, vector, whole_number};
use super::elements::{DataSet, PixelElement};
use super::frame::{Frame, PixelFormat};
use super::frames::{frames, picture_count};
use super::increments::{Increments, SliceDistance};
use super::location::ObjectLocation;
use super::mosaic::Mosaic;
use super::palette::{Palette, palette};
use super::structures::{is_structure_set, label_of};
use super::syntax::{DEFLATED, GE_BIG_ENDIAN_PIXELS, max_compression_ratio};
use crate::panic_guard::catch_panic;
use crate::volume::Label;
use crate::{Error, Result};
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;

/// Segmentation storage, and the newer class whose pixels are labels.
const SEGMENTATION: [&str; 2] = ["1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7"];

/// Cosine of the angle between rows and columns up to which they are perpendicular.
const SKEWED: f64 = 1e-3;

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
    /// What is irregular about it, one sentence each.
    pub warnings: Vec<String>,
    /// If it is part of a concatenation: its UID, the part's number, and their total.
    pub concatenation: Option<(String, u32, u32)>,
    /// Number of pictures in the object.
    pub pictures: usize,
    /// Where its pixels are.
    pub pixels: PixelElement,
    /// Pixels along a row and a column of a slice, if a picture holds several slices.
    pub tile: Option<[usize; 2]>,
    pub padding: Option<[f64; 2]>,
    pub slice_distance: SliceDistance,
    /// Whether it is an overview for planning.
    pub localizer: bool,
    /// Whether its frames are a film, which belongs to no other object.
    pub film: bool,
    /// Frame of reference; may be empty.
    pub reference: String,
    /// Units of its values; may be empty.
    pub units: String,
    /// Centre and width of the window in which to show it.
    pub window: Option<[f64; 2]>,
    /// A table of data values by stored value: the first stored value mapped, and the entries.
    pub value_table: Option<(f64, Vec<f64>)>,
    /// Whether high values are to be shown dark.
    pub inverted: bool,
    pub segmentation: bool,
    pub segments_as: SegmentsAs,
    pub segments: Vec<Label>,
    pub frames: Vec<Frame>,
    pub palette: Option<Palette>,
}

impl Object {
    /// Whether it is a structure set: it has contours instead of frames.
    pub fn is_structure_set(&self) -> bool {
        self.frames.is_empty()
    }

    /// Pixels along a row and a column of a slice.
    pub fn plane(&self) -> [usize; 2] {
        let picture = [usize::from(self.format.columns), usize::from(self.format.rows)];
        self.tile.unwrap_or(picture)
    }

    /// Number of values in a slice.
    pub fn plane_values(&self) -> usize {
        let [columns, rows] = self.plane();
        columns * rows * usize::from(self.format.samples)
    }
}

/// An object's header; none if it contains neither pixels nor contours.
pub fn object(source: ObjectLocation) -> Result<Option<Object>> {
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

/// The distance between slices that the object states.
fn slice_distance(set: &InMemDicomObject) -> SliceDistance {
    let shared = item(set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
    let own = set
        .get(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE)
        .and_then(|e| e.items())
        .and_then(|items| items.first());
    let measures = [own, shared]
        .into_iter()
        .flatten()
        .find_map(|s| item(s, tags::PIXEL_MEASURES_SEQUENCE));
    SliceDistance::of(measures.unwrap_or(set))
}

/// Centre and width of the first window of the object, or of its first frame.
fn window(set: &InMemDicomObject) -> Option<[f64; 2]> {
    let groups = [
        tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE,
        tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE,
    ];
    let in_groups = groups
        .into_iter()
        .find_map(|tag| item(item(set, tag)?, tags::FRAME_VOILUT_SEQUENCE));
    let holder = in_groups.unwrap_or(set);
    Some([
        number(holder, tags::WINDOW_CENTER)?,
        number(holder, tags::WINDOW_WIDTH)?,
    ])
}

/// The modality look-up table: the first stored value mapped, and the entries (PS3.3 C.11.1.1).
fn value_table(table: &InMemDicomObject, signed: bool) -> Option<(f64, Vec<f64>)> {
    let [count, first, bits] = vector::<3>(table, tags::LUT_DESCRIPTOR)?;
    let first = if signed && first > 32_767.0 {
        first - 65_536.0
    } else {
        first
    };
    let data = table.get(tags::LUT_DATA)?.value();
    let entries = match (numbers(table, tags::LUT_DATA), data.to_bytes()) {
        // Entries of 8 bits may be packed in words.
        (_, Ok(bytes)) if bits <= 8.0 && (bytes.len() as f64) < 2.0 * count => {
            bytes.iter().map(|b| f64::from(*b)).collect()
        }
        (Some(words), _) => words,
        _ => return None,
    };
    (!entries.is_empty()).then_some((first, entries))
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
fn object_of(source: ObjectLocation, syntax: String, data: &DataSet) -> Result<Option<Object>> {
    let set = &data.elements;
    let fail = |problem: String| Error::file(source.path(), problem);
    let Some(format) = pixel_format(set) else {
        if is_structure_set(set) {
            return Ok(Some(structure_set(source, syntax, set)));
        }
        return if is_cut_off(set) {
            Err(fail(
                "is a damaged DICOM file (it ends within its header); copy or export it again".into(),
            ))
        } else {
            Ok(None)
        };
    };
    let Some(pixels) = data.pixels else {
        return Err(fail(
            "holds no pixels: it is truncated, or only a header; copy or export it again".into(),
        ));
    };
    check_format(&format).map_err(fail)?;
    let class = text(set, tags::SOP_CLASS_UID);
    let segmentation = SEGMENTATION.contains(&class.as_str()) || text(set, tags::MODALITY) == "SEG";
    if format.samples != 1 && (segmentation || format.photometric == "PALETTE COLOR") {
        return Err(fail(format!(
            "has {} samples per pixel where one is needed; export it again",
            format.samples
        )));
    }
    let pictures = picture_count(set, max_frames(&source, &syntax, &format)).map_err(fail)?;
    let mut warnings = irregularities(set, &format, &pixels, pictures, &syntax);
    let mosaic = Mosaic::of(set, &format)
        .unwrap_or_else(|warning| {
            warnings.push(warning);
            None
        })
        .filter(|_| !segmentation);
    let distance = slice_distance(set);
    let increments = Increments::of(set, pictures, distance);
    let frames = frames(set, &format, segmentation, pictures, &increments, mosaic.as_ref()).map_err(fail)?;
    Ok(Some(Object {
        instance: text(set, tags::SOP_INSTANCE_UID),
        segments_as: segments_as(set, &class),
        series: text(set, tags::SERIES_INSTANCE_UID),
        series_number: number(set, tags::SERIES_NUMBER).map(|n| n as i64),
        description: text(set, tags::SERIES_DESCRIPTION),
        modality: text(set, tags::MODALITY),
        patient: [text(set, tags::PATIENT_NAME), text(set, tags::PATIENT_ID)],
        padding: padding(set, &format).filter(|_| !segmentation),
        warnings,
        concatenation: concatenation(set),
        pictures,
        pixels: PixelElement {
            big_endian: pixels.big_endian || syntax == GE_BIG_ENDIAN_PIXELS,
            ..pixels
        },
        tile: mosaic.map(|m| m.tile),
        slice_distance: distance,
        localizer: set
            .get(tags::IMAGE_TYPE)
            .and_then(|e| {
                e.value()
                    .to_multi_str()
                    .ok()
                    .map(|w| w.iter().any(|w| w == "LOCALIZER"))
            })
            .unwrap_or(false),
        film: increments.time(1).is_some(),
        reference: text(set, tags::FRAME_OF_REFERENCE_UID),
        units: [tags::DOSE_UNITS, tags::UNITS, tags::RESCALE_TYPE]
            .into_iter()
            .map(|tag| text(set, tag))
            .find(|t| !t.is_empty())
            .unwrap_or_default(),
        window: window(set),
        value_table: item(set, tags::MODALITY_LUT_SEQUENCE)
            .filter(|_| format.samples == 1 && !segmentation)
            .and_then(|table| value_table(table, format.signed)),
        inverted: format.photometric == "MONOCHROME1"
            || format.photometric == "MONOCHROME2" && text(set, tags::PRESENTATION_LUT_SHAPE) == "INVERSE",
        segmentation,
        segments: if segmentation { segments(set) } else { Vec::new() },
        palette: if format.photometric == "PALETTE COLOR" {
            palette(set, format.signed)
        } else {
            None
        },
        frames,
        format,
        syntax,
        source,
    }))
}

/// Storage classes of images, without the common beginning, and that.
const IMAGES: [&str; 14] = [
    "1", "1.1", "2", "2.1", "3.1", "4", "4.1", "7", "12.1", "20", "66.4", "128", "130", "481.2",
];
const STORAGE: &str = "1.2.840.10008.5.1.4.1.1.";

/// Whether a data set without a picture size ends too early: it is that of an image, or states
/// nothing at all.
fn is_cut_off(set: &InMemDicomObject) -> bool {
    let class = text(set, tags::SOP_CLASS_UID);
    match class.strip_prefix(STORAGE) {
        Some(kind) => IMAGES.contains(&kind),
        None => class.is_empty() && set.iter().count() < 4,
    }
}

/// UID, number and total of the part that an object is of a concatenation.
fn concatenation(set: &InMemDicomObject) -> Option<(String, u32, u32)> {
    let uid = text(set, tags::CONCATENATION_UID);
    let whole = |tag: Tag| number(set, tag).map(|n| n as u32);
    let total = whole(tags::IN_CONCATENATION_TOTAL_NUMBER)?;
    (!uid.is_empty()).then_some((uid, whole(tags::IN_CONCATENATION_NUMBER)?, total))
}

/// What an object states that is odd, and what is made of it.
fn irregularities(
    set: &InMemDicomObject,
    format: &PixelFormat,
    pixels: &PixelElement,
    pictures: usize,
    syntax: &str,
) -> Vec<String> {
    let mut found = Vec::new();
    let groups = set
        .get(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE)
        .and_then(|e| e.items())
        .map_or(0, <[_]>::len);
    let is_native = max_compression_ratio(syntax, 0) == 1;
    let held = pixels
        .length
        .filter(|_| is_native && format.allocated > 1)
        .map_or(0, |length| length as usize / format.frame_bytes().max(1));
    if held.max(groups) > pictures {
        found.push(format!(
            "declares {pictures} frames but holds {}; the others are left out",
            held.max(groups)
        ));
    }
    let slope = text(set, tags::RESCALE_SLOPE);
    if !slope.is_empty() && number(set, tags::RESCALE_SLOPE).is_none_or(|s| s == 0.0) {
        found.push(format!(
            "its rescale slope \"{slope}\" cannot be used; 1 is used instead"
        ));
    }
    if text(set, tags::MODALITY) == "RTDOSE" && number(set, tags::DOSE_GRID_SCALING).is_none() {
        found.push("does not state the scaling of its dose; its values are as stored".into());
    }
    if let Some([a, b, c, d, e, f]) = vector::<6>(set, tags::IMAGE_ORIENTATION_PATIENT)
        && (a * d + b * e + c * f).abs() > SKEWED
    {
        found.push("states rows and columns that are not perpendicular; its slices are sheared".into());
    }
    found
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
        warnings: Vec::new(),
        concatenation: None,
        pictures: 0,
        pixels: PixelElement {
            offset: 0,
            length: Some(0),
            big_endian: false,
        },
        tile: None,
        padding: None,
        slice_distance: SliceDistance::Unstated,
        localizer: false,
        film: false,
        reference: String::new(),
        units: String::new(),
        window: None,
        value_table: None,
        inverted: false,
        segmentation: false,
        segments: Vec::new(),
        palette: None,
        frames: Vec::new(),
        format: PixelFormat::default(),
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
            let value = u32::from(whole_number(segment, tags::SEGMENT_NUMBER)?);
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
