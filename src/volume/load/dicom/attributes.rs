//! The attributes of a frame, wherever its object states them.

use super::element::{item, number, numbers, vector};
use super::frame::KeyValue;
use crate::volume::Rescale;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use glam::DVec3;

/// Where the attributes of one frame are found: its own functional groups, the shared ones, the
/// detector, and the object.
pub struct FrameAttributes<'a> {
    pub own: Option<&'a InMemDicomObject>,
    pub shared: Option<&'a InMemDicomObject>,
    pub detector: Option<&'a InMemDicomObject>,
    pub object: &'a InMemDicomObject,
    /// Index of the frame, and the number of frames of its object.
    pub number: usize,
    pub count: usize,
    /// Time of the frame since the first one, ms, if consecutive frames differ in time.
    pub frame_time: Option<f64>,
}

impl<'a> FrameAttributes<'a> {
    /// The frame's own group, else the shared one.
    pub fn group(&self, tag: Tag) -> Option<&'a InMemDicomObject> {
        self.own
            .and_then(|o| item(o, tag))
            .or_else(|| self.shared.and_then(|s| item(s, tag)))
    }

    /// The frame's own group, else the shared one, else the object itself.
    fn group_or_object(&self, tag: Tag) -> &'a InMemDicomObject {
        self.group(tag).unwrap_or(self.object)
    }

    /// The first number of an attribute in a group.
    pub fn in_group(&self, group: Tag, attribute: Tag) -> Option<f64> {
        number(self.group(group)?, attribute)
    }

    /// The first number of an attribute of the object.
    pub fn number(&self, attribute: Tag) -> Option<f64> {
        number(self.object, attribute)
    }

    /// The entry of the frame in a vector of the object that has one entry for every frame.
    pub fn vector_entry(&self, vector: Tag) -> Option<f64> {
        numbers(self.object, vector)?.get(self.number).copied()
    }

    /// As [`Self::vector_entry`], as a key.
    pub fn in_vector(&self, vector: Tag) -> Option<KeyValue> {
        self.vector_entry(vector).map(KeyValue::Number)
    }

    /// The numbers of an attribute in a group or the object; if it is missing there, in the
    /// detector.
    fn stated<const N: usize>(&self, tag: Tag, attribute: Tag) -> Option<[f64; N]> {
        [self.group(tag), Some(self.object), self.detector]
            .into_iter()
            .flatten()
            .find_map(|s| vector::<N>(s, attribute))
    }

    /// Directions of increasing column and row.
    pub fn orientation(&self) -> Option<[DVec3; 2]> {
        let v = self
            .stated::<6>(tags::PLANE_ORIENTATION_SEQUENCE, tags::IMAGE_ORIENTATION_PATIENT)
            .or_else(|| {
                let group = self.group(tags::PLANE_ORIENTATION_VOLUME_SEQUENCE)?;
                vector::<6>(group, tags::IMAGE_ORIENTATION_VOLUME)
            })?;
        Some([
            DVec3::new(v[0], v[1], v[2]).normalize_or_zero(),
            DVec3::new(v[3], v[4], v[5]).normalize_or_zero(),
        ])
    }

    /// Centre of the first pixel, mm.
    pub fn position(&self) -> Option<DVec3> {
        self.stated::<3>(tags::PLANE_POSITION_SEQUENCE, tags::IMAGE_POSITION_PATIENT)
            .or_else(|| {
                let group = self.group(tags::PLANE_POSITION_VOLUME_SEQUENCE)?;
                vector::<3>(group, tags::IMAGE_POSITION_VOLUME)
            })
            .map(DVec3::from_array)
    }

    /// Whether the frame has a position of its own.
    pub fn has_own_position(&self) -> bool {
        let has = |group: Tag, attribute: Tag| {
            self.own
                .and_then(|o| item(o, group))
                .is_some_and(|p| vector::<3>(p, attribute).is_some())
        };
        has(tags::PLANE_POSITION_SEQUENCE, tags::IMAGE_POSITION_PATIENT)
            || has(tags::PLANE_POSITION_VOLUME_SEQUENCE, tags::IMAGE_POSITION_VOLUME)
    }

    /// Distance between columns and between rows, mm (0 if not stated), and whether it is that in
    /// the plane of the detector.
    pub fn spacing(&self) -> ([f64; 2], bool) {
        let measures = self.group_or_object(tags::PIXEL_MEASURES_SEQUENCE);
        let stated = |tag: Tag| {
            let spacing = vector::<2>(measures, tag).or_else(|| vector::<2>(self.object, tag));
            // Stored as the distance between rows, then between columns.
            spacing
                .filter(|s| s.iter().all(|v| *v > 0.0))
                .map(|[rows, columns]| [columns, rows])
        };
        let in_patient = stated(tags::PIXEL_SPACING).or_else(|| ultrasound_spacing(self.object));
        if let Some(spacing) = in_patient {
            return (spacing, false);
        }
        let of_detector = stated(tags::IMAGER_PIXEL_SPACING);
        let nominal = stated(tags::NOMINAL_SCANNED_PIXEL_SPACING);
        (of_detector.or(nominal).unwrap_or_default(), of_detector.is_some())
    }

    /// Distance between rows relative to that between columns, where only this is stated.
    pub fn aspect(&self) -> f64 {
        let ratio = vector::<2>(self.object, tags::PIXEL_ASPECT_RATIO);
        ratio
            .filter(|[rows, columns]| *rows > 0.0 && *columns > 0.0)
            .map_or(1.0, |[rows, columns]| rows / columns)
    }

    /// The rescale; none if neither slope nor intercept is stated. A missing slope, or 0, is 1.
    pub fn rescale(&self) -> Option<Rescale> {
        let transform = self.group_or_object(tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE);
        let (slope, intercept) = (
            number(transform, tags::RESCALE_SLOPE),
            number(transform, tags::RESCALE_INTERCEPT),
        );
        if slope.or(intercept).is_none() {
            return number(self.object, tags::DOSE_GRID_SCALING)
                .filter(|s| *s != 0.0)
                .map(|slope| Rescale {
                    slope,
                    intercept: 0.0,
                });
        }
        Some(Rescale {
            slope: slope.filter(|s| *s != 0.0).unwrap_or(1.0),
            intercept: intercept.unwrap_or(0.0),
        })
    }

    /// Segment of a frame in a segmentation.
    pub fn segment(&self) -> u16 {
        let segment = self
            .group(tags::SEGMENT_IDENTIFICATION_SEQUENCE)
            .and_then(|s| number(s, tags::REFERENCED_SEGMENT_NUMBER));
        segment.map_or(1, |s| s as u16)
    }
}

/// Distance between columns and between rows, mm, of an ultrasound image whose regions agree
/// (PS3.3 C.8.5.5: deltas in cm).
fn ultrasound_spacing(set: &InMemDicomObject) -> Option<[f64; 2]> {
    const CENTIMETRES: f64 = 3.0;
    let regions = set.get(tags::SEQUENCE_OF_ULTRASOUND_REGIONS)?.items()?;
    let of = |region: &InMemDicomObject| -> Option<[f64; 2]> {
        let in_cm = [tags::PHYSICAL_UNITS_X_DIRECTION, tags::PHYSICAL_UNITS_Y_DIRECTION]
            .iter()
            .all(|t| number(region, *t) == Some(CENTIMETRES));
        let delta = |tag| number(region, tag).map(|d| 10.0 * d.abs()).filter(|d| *d > 0.0);
        in_cm.then_some([delta(tags::PHYSICAL_DELTA_X)?, delta(tags::PHYSICAL_DELTA_Y)?])
    };
    let all: Vec<[f64; 2]> = regions.iter().filter_map(of).collect();
    let first = *all.first()?;
    all.iter().all(|s| *s == first).then_some(first)
}
