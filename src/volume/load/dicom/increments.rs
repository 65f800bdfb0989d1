//! What distinguishes consecutive frames of an object without functional groups: their place, their
//! time, or the entries of vectors.
//!
//! Source: DICOM PS3.3 C.7.6.6 (frame increment pointer), C.7.6.5 (cine), C.8.4.8 and C.8.4.15
//! (nuclear medicine), C.8.8.3.2 (grid frame offsets of a dose).

use super::element::{number, numbers, text};
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use glam::DVec3;

/// Storage classes of films: ultrasound, X-ray, endoscopy.
const FILMS: [&str; 10] = [
    "1.2.840.10008.5.1.4.1.1.3",
    "1.2.840.10008.5.1.4.1.1.3.1",
    "1.2.840.10008.5.1.4.1.1.12.1",
    "1.2.840.10008.5.1.4.1.1.12.1.1",
    "1.2.840.10008.5.1.4.1.1.12.2",
    "1.2.840.10008.5.1.4.1.1.12.2.1",
    "1.2.840.10008.5.1.4.1.1.77.1.1.1",
    "1.2.840.10008.5.1.4.1.1.77.1.2.1",
    "1.2.840.10008.5.1.4.1.1.77.1.4.1",
    "1.2.840.10008.5.1.4.1.1.77.1.5.4",
];

/// The distance between consecutive slices, as far as an object states it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SliceDistance {
    /// Stated, mm.
    Stated(f64),
    /// Only the thickness of slices is stated, mm.
    Thickness(f64),
    Unstated,
}

impl SliceDistance {
    /// From the pixel measures of an object, or the object itself. The sign is that of the
    /// direction.
    pub fn of(measures: &InMemDicomObject) -> Self {
        let stated = |tag: Tag| number(measures, tag).filter(|s| *s != 0.0);
        match (
            stated(tags::SPACING_BETWEEN_SLICES),
            stated(tags::SLICE_THICKNESS),
        ) {
            (Some(distance), _) => Self::Stated(distance),
            (None, Some(thickness)) => Self::Thickness(thickness),
            (None, None) => Self::Unstated,
        }
    }

    /// The distance to use, mm, positive.
    pub fn mm(self) -> f64 {
        match self {
            Self::Stated(mm) | Self::Thickness(mm) => mm.abs(),
            Self::Unstated => 1.0,
        }
    }
}

/// The increments of an object's frames.
pub struct Increments {
    /// Offset of each frame along the normal, mm.
    offsets: Vec<f64>,
    /// Whether the offsets are stated one by one.
    stated: bool,
    /// Time of each frame since the first one, ms.
    times: Vec<f64>,
    /// Detector of each frame, from 0.
    detectors: Vec<usize>,
}

impl Increments {
    /// The increments of `count` frames at this distance, unless other attributes place them.
    pub fn of(set: &InMemDicomObject, count: usize, distance: SliceDistance) -> Self {
        let vector = |tag: Tag| numbers(set, tag).filter(|v| v.len() == count);
        let detectors = vector(tags::DETECTOR_VECTOR)
            .map(|v| v.iter().map(|d| (*d - 1.0).max(0.0) as usize).collect())
            .unwrap_or_else(|| vec![0; count]);
        // The sign gives the direction (PS3.3 C.8.4.15).
        let step = match distance {
            SliceDistance::Stated(mm) => mm,
            other => other.mm(),
        };
        let mut times = Vec::new();
        let mut stated = false;
        let offsets = if let Some(offsets) = vector(tags::GRID_FRAME_OFFSET_VECTOR) {
            // Relative to the first frame, or positions of it and the others.
            stated = true;
            offsets.iter().map(|o| o - offsets[0]).collect()
        } else if let Some(slices) = vector(tags::SLICE_VECTOR) {
            slices.iter().map(|s| (s - 1.0) * step).collect()
        } else if let Some(locations) = vector(tags::SLICE_LOCATION_VECTOR) {
            stated = true;
            locations.iter().map(|l| l - locations[0]).collect()
        } else if has_vectors(set, count) {
            vec![0.0; count]
        } else if let Some(frame_times) = frame_times(set, count) {
            times = frame_times;
            vec![0.0; count]
        } else {
            (0..count).map(|n| n as f64 * step).collect()
        };
        Self {
            offsets,
            stated,
            times,
            detectors,
        }
    }

    /// Whether the places of frames are stated one by one.
    pub fn are_stated(&self) -> bool {
        self.stated
    }

    /// Detector of a frame.
    pub fn detector(&self, n: usize) -> Option<usize> {
        self.detectors.get(n).copied()
    }

    /// Time of a frame since the first one, ms, if consecutive frames differ in time.
    pub fn time(&self, n: usize) -> Option<f64> {
        self.times.get(n).copied()
    }

    /// Position of a frame, given that of the first one and the normal.
    pub fn place(&self, n: usize, first: DVec3, normal: DVec3) -> DVec3 {
        first + normal * self.offsets.get(n).copied().unwrap_or(0.0)
    }
}

/// Whether an object of nuclear medicine has vectors, but none of slices.
fn has_vectors(set: &InMemDicomObject, count: usize) -> bool {
    [
        tags::TIME_SLOT_VECTOR,
        tags::TIME_SLICE_VECTOR,
        tags::PHASE_VECTOR,
        tags::ANGULAR_VIEW_VECTOR,
        tags::ROTATION_VECTOR,
        tags::RR_INTERVAL_VECTOR,
        tags::ENERGY_WINDOW_VECTOR,
        tags::DETECTOR_VECTOR,
    ]
    .into_iter()
    .any(|tag| numbers(set, tag).is_some_and(|v| v.len() == count && v.iter().any(|e| *e != v[0])))
}

/// Times of frames since the first one, ms, if the object is a film: its frame increment pointer
/// names times, or its storage class is one of films. Frames without a stated interval count from 0.
fn frame_times(set: &InMemDicomObject, count: usize) -> Option<Vec<f64>> {
    let pointers: Vec<Tag> = match set.get(tags::FRAME_INCREMENT_POINTER).map(|e| e.value()) {
        Some(dicom_core::value::Value::Primitive(dicom_core::value::PrimitiveValue::Tags(tags))) => {
            tags.to_vec()
        }
        _ => Vec::new(),
    };
    let by_time = pointers
        .iter()
        .any(|t| [tags::FRAME_TIME, tags::FRAME_TIME_VECTOR].contains(t));
    let class = text(set, tags::SOP_CLASS_UID);
    let film = FILMS.contains(&class.as_str()) || text(set, tags::MODALITY) == "US";
    // An object that places its frames is a volume.
    let places = set.get(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE).is_some()
        || set.get(tags::SPACING_BETWEEN_SLICES).is_some();
    if !by_time && (!film || places || !pointers.is_empty()) {
        return None;
    }
    if let Some(steps) = numbers(set, tags::FRAME_TIME_VECTOR).filter(|v| v.len() == count) {
        let mut time = 0.0;
        return Some(
            steps
                .iter()
                .enumerate()
                .map(|(n, step)| {
                    time += if n == 0 { 0.0 } else { *step };
                    time
                })
                .collect(),
        );
    }
    let step = number(set, tags::FRAME_TIME)
        .or_else(|| {
            let rate =
                number(set, tags::CINE_RATE).or_else(|| number(set, tags::RECOMMENDED_DISPLAY_FRAME_RATE))?;
            (rate > 0.0).then(|| 1000.0 / rate)
        })
        .filter(|s| *s > 0.0)
        .unwrap_or(1.0);
    Some((0..count).map(|n| n as f64 * step).collect())
}
