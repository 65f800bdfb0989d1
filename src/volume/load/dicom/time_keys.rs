//! The attributes that tell frames at one place apart: time, echo, diffusion weighting, phase and
//! the like.
//!
//! Source: DICOM PS3.3 C.7.6.16 (functional groups, dimension index), C.8.4.8 (vectors of nuclear
//! medicine), C.8.13 (enhanced MR).

use super::attributes::FrameAttributes;
use super::element::{item, numbers, private_number, private_numbers, text, vector};
use super::frame::{Digest, KeyValue};
use dicom_core::Tag;
use dicom_core::value::{PrimitiveValue, Value};
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use std::hash::{DefaultHasher, Hash, Hasher};

/// An attribute by which frames are told apart.
pub struct TimeKey {
    /// As shown to users.
    pub name: &'static str,
    /// Whether it runs on within one volume, so that its order tells volumes apart, if not its
    /// values.
    pub runs_on: bool,
    /// Whether its numbers count from an arbitrary zero, so that only differences are shown.
    pub relative: bool,
    /// Whether its values have no natural order.
    pub is_unordered: bool,
    /// Whether volumes that differ in it are apart even if their planes do not coincide. Parts of
    /// one volume may differ in their times and acquisition numbers.
    pub parts_volumes: bool,
    /// Whether it says nothing about what differs.
    pub is_guess: bool,
    read: fn(&FrameAttributes) -> Option<KeyValue>,
}

pub const ACQUISITION_NUMBER: &str = "acquisition number";
pub const ACQUISITION_TIME: &str = "acquisition time (s)";
pub const INSTANCE_NUMBER: &str = "instance number";

/// The keys, the most telling first.
pub static KEYS: [TimeKey; 38] = [
    key("dimension index", dimension_index),
    key("temporal position", |a| {
        first(&[
            a.in_group(tags::FRAME_CONTENT_SEQUENCE, tags::TEMPORAL_POSITION_INDEX),
            a.number(tags::TEMPORAL_POSITION_IDENTIFIER),
        ])
    }),
    key("time slot", |a| a.in_vector(tags::TIME_SLOT_VECTOR)),
    key("heartbeat interval", |a| a.in_vector(tags::RR_INTERVAL_VECTOR)),
    key("time slice", |a| {
        a.in_vector(tags::TIME_SLICE_VECTOR).or_else(|| {
            // Images of a dynamic PET count slices, then times (PS3.3 C.8.9.4.1.9).
            let (index, slices) = (a.number(tags::IMAGE_INDEX)?, a.number(tags::NUMBER_OF_SLICES)?);
            let times = a.number(tags::NUMBER_OF_TIME_SLICES)?;
            (slices >= 1.0 && times > 1.0).then(|| KeyValue::Number(((index - 1.0) / slices).floor() + 1.0))
        })
    }),
    key("phase", |a| a.in_vector(tags::PHASE_VECTOR)),
    key("energy window", |a| a.in_vector(tags::ENERGY_WINDOW_VECTOR)),
    key("detector", |a| a.in_vector(tags::DETECTOR_VECTOR)),
    key("angular view", |a| {
        first(&[
            a.vector_entry(tags::ANGULAR_VIEW_VECTOR),
            a.vector_entry(tags::ROTATION_VECTOR),
        ])
    }),
    key("frame time (ms)", |a| a.frame_time.map(KeyValue::Number)),
    key("echo", |a| {
        first(&[
            a.in_group(tags::MR_ECHO_SEQUENCE, tags::EFFECTIVE_ECHO_TIME),
            a.number(tags::ECHO_TIME),
            a.number(tags::ECHO_NUMBERS),
        ])
    }),
    key("echo number", |a| first(&[a.number(tags::ECHO_NUMBERS)])),
    key("b-value (s/mm²)", b_value),
    unordered("diffusion direction", diffusion_direction),
    key("inversion time (ms)", |a| {
        first(&[
            a.in_group(tags::MR_MODIFIER_SEQUENCE, tags::INVERSION_TIMES),
            a.number(tags::INVERSION_TIME),
        ])
    }),
    key("flip angle (degrees)", |a| {
        first(&[
            a.in_group(tags::MR_TIMING_AND_RELATED_PARAMETERS_SEQUENCE, tags::FLIP_ANGLE),
            a.number(tags::FLIP_ANGLE),
        ])
    }),
    key("repetition time (ms)", |a| {
        first(&[
            a.in_group(
                tags::MR_TIMING_AND_RELATED_PARAMETERS_SEQUENCE,
                tags::REPETITION_TIME,
            ),
            a.number(tags::REPETITION_TIME),
        ])
    }),
    key("slice thickness (mm)", |a| {
        first(&[
            a.in_group(tags::PIXEL_MEASURES_SEQUENCE, tags::SLICE_THICKNESS),
            a.number(tags::SLICE_THICKNESS),
        ])
    }),
    key("tube voltage (kV)", |a| first(&[a.number(tags::KVP)])),
    key("cardiac phase (%)", |a| {
        first(&[
            a.in_group(
                tags::CARDIAC_SYNCHRONIZATION_SEQUENCE,
                tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE,
            ),
            a.number(tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE),
        ])
    }),
    key("respiratory phase (%)", |a| {
        first(&[
            a.in_group(
                tags::RESPIRATORY_SYNCHRONIZATION_SEQUENCE,
                tags::NOMINAL_PERCENTAGE_OF_RESPIRATORY_PHASE,
            ),
            a.number(tags::NOMINAL_PERCENTAGE_OF_RESPIRATORY_PHASE),
        ])
    }),
    running("trigger time (ms)", |a| {
        first(&[
            a.in_group(
                tags::CARDIAC_SYNCHRONIZATION_SEQUENCE,
                tags::NOMINAL_CARDIAC_TRIGGER_DELAY_TIME,
            ),
            a.number(tags::TRIGGER_TIME),
            a.number(tags::NOMINAL_CARDIAC_TRIGGER_DELAY_TIME),
        ])
    }),
    running("frame reference time (ms)", |a| {
        first(&[a.number(tags::FRAME_REFERENCE_TIME)])
    }),
    key("image type", image_type),
    TimeKey {
        parts_volumes: false,
        ..key(ACQUISITION_NUMBER, |a| {
            first(&[
                a.in_group(tags::FRAME_CONTENT_SEQUENCE, tags::FRAME_ACQUISITION_NUMBER),
                a.number(tags::ACQUISITION_NUMBER),
            ])
        })
    },
    clocked(ACQUISITION_TIME, acquisition_time),
    clocked("content time (s)", |a| {
        clock(a.object, tags::CONTENT_DATE, tags::CONTENT_TIME).map(KeyValue::Number)
    }),
    key("sequence name", |a| {
        some_text(text(a.object, tags::SEQUENCE_NAME))
    }),
    key("scan options", |a| some_text(text(a.object, tags::SCAN_OPTIONS))),
    key("contrast agent", |a| {
        some_text(text(a.object, tags::CONTRAST_BOLUS_AGENT))
    }),
    key("kernel", |a| some_text(text(a.object, tags::CONVOLUTION_KERNEL))),
    key("units", |a| some_text(text(a.object, tags::UNITS))),
    key("comment", |a| some_text(text(a.object, tags::IMAGE_COMMENTS))),
    key("series description", |a| {
        some_text(text(a.object, tags::SERIES_DESCRIPTION))
    }),
    unordered("image", |a| {
        // An image of several frames is a volume, unless it is part of one.
        let uid = text(a.object, tags::CONCATENATION_UID);
        let uid = if uid.is_empty() {
            text(a.object, tags::SOP_INSTANCE_UID)
        } else {
            uid
        };
        some_text(uid).filter(|_| a.count > 1)
    }),
    unordered("study", |a| some_text(text(a.object, tags::STUDY_INSTANCE_UID))),
    unordered("frame of reference", |a| {
        some_text(text(a.object, tags::FRAME_OF_REFERENCE_UID))
    }),
    TimeKey {
        parts_volumes: false,
        is_guess: true,
        ..running(INSTANCE_NUMBER, |a| {
            let instance = a.number(tags::INSTANCE_NUMBER)?;
            Some(KeyValue::Number(instance))
        })
    },
];

const fn key(name: &'static str, read: fn(&FrameAttributes) -> Option<KeyValue>) -> TimeKey {
    TimeKey {
        name,
        runs_on: false,
        relative: false,
        is_unordered: false,
        parts_volumes: true,
        is_guess: false,
        read,
    }
}

const fn unordered(name: &'static str, read: fn(&FrameAttributes) -> Option<KeyValue>) -> TimeKey {
    TimeKey {
        is_unordered: true,
        ..key(name, read)
    }
}

const fn running(name: &'static str, read: fn(&FrameAttributes) -> Option<KeyValue>) -> TimeKey {
    TimeKey {
        runs_on: true,
        ..key(name, read)
    }
}

const fn clocked(name: &'static str, read: fn(&FrameAttributes) -> Option<KeyValue>) -> TimeKey {
    TimeKey {
        relative: true,
        parts_volumes: false,
        ..running(name, read)
    }
}

/// The keys of a frame that its object states: their indices in [`KEYS`], ascending, and values.
pub fn keys_of(attributes: &FrameAttributes) -> Vec<(u8, KeyValue)> {
    KEYS.iter()
        .enumerate()
        .filter_map(|(n, key)| Some((n as u8, (key.read)(attributes)?)))
        .collect()
}

fn first(values: &[Option<f64>]) -> Option<KeyValue> {
    values.iter().find_map(|v| *v).map(KeyValue::Number)
}

fn some_text(text: String) -> Option<KeyValue> {
    (!text.is_empty()).then_some(KeyValue::Text(text))
}

/// The indices of a frame along the dimensions other than its place.
fn dimension_index(a: &FrameAttributes) -> Option<KeyValue> {
    let content = a.group(tags::FRAME_CONTENT_SEQUENCE)?;
    let values = numbers(content, tags::DIMENSION_INDEX_VALUES)?;
    let dimensions = a.object.get(tags::DIMENSION_INDEX_SEQUENCE)?.items()?;
    let pointer = |n: usize| -> Option<Tag> {
        dimensions
            .get(n)?
            .get(tags::DIMENSION_INDEX_POINTER)?
            .value()
            .to_tag()
            .ok()
    };
    let of_place = [
        tags::IN_STACK_POSITION_NUMBER,
        tags::IMAGE_POSITION_PATIENT,
        tags::PLANE_POSITION_SEQUENCE,
        tags::IMAGE_POSITION_VOLUME,
        tags::SLICE_LOCATION,
        tags::REFERENCED_SEGMENT_NUMBER,
    ];
    let other: Vec<f64> = values
        .iter()
        .enumerate()
        .filter(|(n, _)| pointer(*n).is_some_and(|tag| !of_place.contains(&tag)))
        .map(|(_, v)| *v)
        .collect();
    (!other.is_empty()).then_some(KeyValue::Numbers(other))
}

/// Diffusion weighting: the standard's attribute, or those of Siemens, GE and Philips.
fn b_value(a: &FrameAttributes) -> Option<KeyValue> {
    let private = |creator: &str, element: u16, group: u16| private_number(a.object, group, creator, element);
    first(&[
        a.in_group(tags::MR_DIFFUSION_SEQUENCE, tags::DIFFUSION_B_VALUE),
        a.number(tags::DIFFUSION_B_VALUE),
        private("SIEMENS MR HEADER", 0x0c, 0x0019),
        // GE adds 10^9 to b-values of multi-shell sequences.
        private("GEMS_PARM_01", 0x39, 0x0043).map(|b| b % 1e9),
        private("Philips Imaging DD 001", 0x03, 0x2001),
    ])
}

/// Direction of the diffusion gradient: the standard's attribute, or those of Siemens, GE and
/// Philips.
fn diffusion_direction(a: &FrameAttributes) -> Option<KeyValue> {
    let grouped = a
        .group(tags::MR_DIFFUSION_SEQUENCE)
        .and_then(|d| item(d, tags::DIFFUSION_GRADIENT_DIRECTION_SEQUENCE))
        .and_then(|d| vector::<3>(d, tags::DIFFUSION_GRADIENT_ORIENTATION))
        .map(|v| v.to_vec());
    let three = |group: u16, creator: &str, elements: [u16; 3]| {
        let all = elements.map(|e| private_number(a.object, group, creator, e));
        all.into_iter().collect::<Option<Vec<f64>>>()
    };
    grouped
        .or_else(|| vector::<3>(a.object, tags::DIFFUSION_GRADIENT_ORIENTATION).map(|v| v.to_vec()))
        .or_else(|| private_numbers(a.object, 0x0019, "SIEMENS MR HEADER", 0x0e))
        .or_else(|| three(0x0019, "GEMS_ACQU_01", [0xbb, 0xbc, 0xbd]))
        .or_else(|| three(0x2005, "Philips MR Imaging DD 001", [0xb0, 0xb1, 0xb2]))
        .map(KeyValue::Numbers)
}

/// The type of a frame, or of the whole image, and its part of a complex value.
fn image_type(a: &FrameAttributes) -> Option<KeyValue> {
    let of_frame = [
        tags::MR_IMAGE_FRAME_TYPE_SEQUENCE,
        tags::CT_IMAGE_FRAME_TYPE_SEQUENCE,
        tags::PET_FRAME_TYPE_SEQUENCE,
    ]
    .into_iter()
    .find_map(|tag| a.group(tag));
    let joined = |set: &InMemDicomObject, tag: Tag| {
        set.get(tag)
            .and_then(|e| e.value().to_multi_str().ok())
            .map(|words| words.join("\\"))
            .unwrap_or_default()
    };
    let mut kind = of_frame.map(|f| joined(f, tags::FRAME_TYPE)).unwrap_or_default();
    if kind.is_empty() {
        kind = joined(a.object, tags::IMAGE_TYPE);
    }
    let part = text(of_frame.unwrap_or(a.object), tags::COMPLEX_IMAGE_COMPONENT);
    if !part.is_empty() {
        kind = format!("{kind}\\{part}");
    }
    some_text(kind)
}

/// Time of acquisition, seconds.
fn acquisition_time(a: &FrameAttributes) -> Option<KeyValue> {
    let content = a.group(tags::FRAME_CONTENT_SEQUENCE);
    let stamp = |set: &InMemDicomObject, tag: Tag| date_time(&text(set, tag));
    content
        .and_then(|c| {
            stamp(c, tags::FRAME_ACQUISITION_DATE_TIME).or_else(|| stamp(c, tags::FRAME_REFERENCE_DATE_TIME))
        })
        .or_else(|| stamp(a.object, tags::ACQUISITION_DATE_TIME))
        .or_else(|| clock(a.object, tags::ACQUISITION_DATE, tags::ACQUISITION_TIME))
        .map(KeyValue::Number)
}

/// Seconds of a date and a time in separate attributes; the date may be missing.
fn clock(set: &InMemDicomObject, date: Tag, time: Tag) -> Option<f64> {
    let seconds = seconds_of_day(&text(set, time))?;
    Some(days(&text(set, date)).unwrap_or(0.0) * 86_400.0 + seconds)
}

/// Seconds of `YYYYMMDDHHMMSS.FFFFFF`.
fn date_time(stamp: &str) -> Option<f64> {
    let (date, time) = stamp.split_at_checked(8)?;
    let sign = time.find(['+', '-']);
    let (time, zone) = time.split_at(sign.unwrap_or(time.len()));
    // Offset from UTC, `+HHMM`.
    let offset = zone.get(1..).and_then(seconds_of_day).unwrap_or(0.0);
    let offset = if zone.starts_with('-') { -offset } else { offset };
    Some(days(date)? * 86_400.0 + seconds_of_day(time).unwrap_or(0.0) - offset)
}

/// Seconds of `HHMMSS.FFFFFF`, also with colons; minutes and seconds may be missing.
fn seconds_of_day(time: &str) -> Option<f64> {
    let digits = time.trim().replace(':', "");
    let part = |range: std::ops::Range<usize>| digits.get(range).and_then(|t| t.parse::<f64>().ok());
    let hours = part(0..2)?;
    let minutes = part(2..4).unwrap_or(0.0);
    let seconds = digits.get(4..).and_then(|t| t.parse::<f64>().ok()).unwrap_or(0.0);
    Some((hours * 60.0 + minutes) * 60.0 + seconds).filter(|s| s.is_finite())
}

/// Days of `YYYYMMDD`, from the same day for all dates (Gregorian calendar).
fn days(date: &str) -> Option<f64> {
    let digits = date.trim().replace('.', "");
    let part = |range: std::ops::Range<usize>| digits.get(range).and_then(|t| t.parse::<i64>().ok());
    let (year, month, day) = (part(0..4)?, part(4..6)?, part(6..8)?);
    // Years start in March, so that a leap day is the last.
    let (year, month) = if month < 3 {
        (year - 1, month + 9)
    } else {
        (year, month - 3)
    };
    Some((365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day) as f64)
}

/// Attributes that differ from frame to frame of one volume, or say nothing about it.
const OF_ONE_FRAME: [Tag; 22] = [
    tags::SOP_INSTANCE_UID,
    tags::INSTANCE_CREATION_DATE,
    tags::INSTANCE_CREATION_TIME,
    tags::INSTANCE_NUMBER,
    tags::ACQUISITION_NUMBER,
    tags::IMAGE_POSITION_PATIENT,
    tags::IMAGE_ORIENTATION_PATIENT,
    tags::SLICE_LOCATION,
    tags::TABLE_POSITION,
    tags::IMAGE_INDEX,
    tags::SMALLEST_IMAGE_PIXEL_VALUE,
    tags::LARGEST_IMAGE_PIXEL_VALUE,
    tags::SMALLEST_PIXEL_VALUE_IN_SERIES,
    tags::LARGEST_PIXEL_VALUE_IN_SERIES,
    tags::PIXEL_PADDING_VALUE,
    tags::WINDOW_CENTER,
    tags::WINDOW_WIDTH,
    tags::RESCALE_SLOPE,
    tags::RESCALE_INTERCEPT,
    tags::IN_STACK_POSITION_NUMBER,
    tags::DIMENSION_INDEX_VALUES,
    tags::PIXEL_DATA,
];
/// Longer values are not compared, bytes.
const MAX_COMPARED_BYTES: usize = 256;

/// Digests of the single values of a data set, by tag.
pub fn other_attributes(set: &InMemDicomObject) -> Vec<(Tag, Digest)> {
    set.iter()
        .filter(|e| !OF_ONE_FRAME.contains(&e.header().tag))
        .filter_map(|e| {
            let Value::Primitive(value) = e.value() else {
                return None;
            };
            let bytes = value.to_bytes();
            let mut hasher = DefaultHasher::new();
            bytes.hash(&mut hasher);
            let order = match value {
                PrimitiveValue::Str(text) => first_number(text),
                PrimitiveValue::Strs(texts) => texts.first().map_or(0.0, |t| first_number(t)),
                numbers => numbers.to_float64().unwrap_or(0.0),
            };
            let digest = Digest {
                hash: hasher.finish(),
                order,
            };
            (bytes.len() <= MAX_COMPARED_BYTES).then(|| (e.header().tag, digest))
        })
        .collect()
}

/// The first number in a text; 0 if there is none.
fn first_number(text: &str) -> f64 {
    let start = text.find(|c: char| c.is_ascii_digit()).unwrap_or(text.len());
    let rest = &text[start..];
    let end = rest
        .find(|c: char| !(c.is_ascii_digit() || c == '.'))
        .unwrap_or(rest.len());
    rest[..end].parse().unwrap_or(0.0)
}

/// As [`other_attributes`], of the functional groups of one frame.
pub fn own_attributes(groups: &InMemDicomObject) -> Vec<(Tag, Digest)> {
    groups
        .iter()
        .filter_map(|e| e.items()?.first())
        .flat_map(other_attributes)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_day_and_dates() {
        assert_eq!(seconds_of_day("101112.5"), Some(36_672.5));
        assert_eq!(seconds_of_day("10:11:12"), Some(36_672.0));
        assert_eq!(seconds_of_day("10"), Some(36_000.0));
        assert_eq!(seconds_of_day(""), None);
        let between = |a: &str, b: &str| days(b).zip(days(a)).map(|(b, a)| b - a);
        assert_eq!(between("20240228", "20240301"), Some(2.0));
        assert_eq!(between("20231231", "20240101"), Some(1.0));
        assert_eq!(
            date_time("20240101000001.25+0100")
                .zip(date_time("20231231225959+0000"))
                .map(|(b, a)| b - a),
            Some(2.25)
        );
    }
}
