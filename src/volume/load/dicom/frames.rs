//! The frames of an object, each with its geometry, and the storage of their pixels.

use super::element::{item, number, vector};
use crate::volume::Rescale;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use glam::DVec3;

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
        if self.allocated == 1 {
            self.values().div_ceil(8)
        } else {
            self.values() * usize::from(self.allocated / 8)
        }
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

/// Where the attributes of one frame are found: its own functional groups, the shared ones, the
/// detector, and the object.
struct FrameAttributes<'a> {
    own: Option<&'a InMemDicomObject>,
    shared: Option<&'a InMemDicomObject>,
    detector: Option<&'a InMemDicomObject>,
    object: &'a InMemDicomObject,
}

impl<'a> FrameAttributes<'a> {
    /// The frame's own group, else the shared one.
    fn group(&self, tag: Tag) -> Option<&'a InMemDicomObject> {
        self.own
            .and_then(|o| item(o, tag))
            .or_else(|| self.shared.and_then(|s| item(s, tag)))
    }

    /// The frame's own group, else the shared one, else the object itself.
    fn group_or_object(&self, tag: Tag) -> &'a InMemDicomObject {
        self.group(tag).unwrap_or(self.object)
    }

    /// The numbers of an attribute in a group or the object; if it is missing there, in the
    /// detector.
    fn stated<const N: usize>(&self, tag: Tag, attribute: Tag) -> Option<[f64; N]> {
        let group = self.group_or_object(tag);
        let holder = group.get(attribute).is_some().then_some(group).or(self.detector);
        holder.and_then(|s| vector::<N>(s, attribute))
    }

    /// Directions of increasing column and row.
    fn orientation(&self) -> Option<[DVec3; 2]> {
        let v = self.stated::<6>(tags::PLANE_ORIENTATION_SEQUENCE, tags::IMAGE_ORIENTATION_PATIENT)?;
        Some([
            DVec3::new(v[0], v[1], v[2]).normalize_or_zero(),
            DVec3::new(v[3], v[4], v[5]).normalize_or_zero(),
        ])
    }

    /// Centre of the first pixel, mm.
    fn position(&self) -> Option<DVec3> {
        self.stated::<3>(tags::PLANE_POSITION_SEQUENCE, tags::IMAGE_POSITION_PATIENT)
            .map(DVec3::from_array)
    }

    /// Distance between columns and between rows, mm; 0 if not stated.
    fn spacing(&self) -> [f64; 2] {
        let measures = self.group_or_object(tags::PIXEL_MEASURES_SEQUENCE);
        let spacing = [
            tags::PIXEL_SPACING,
            tags::IMAGER_PIXEL_SPACING,
            tags::NOMINAL_SCANNED_PIXEL_SPACING,
        ]
        .into_iter()
        .find_map(|tag| vector::<2>(measures, tag).or_else(|| vector::<2>(self.object, tag)))
        .filter(|s| s.iter().all(|v| *v > 0.0));
        // Stored as the distance between rows, then between columns.
        spacing.map_or([0.0; 2], |[rows, columns]| [columns, rows])
    }

    /// The rescale; none if the slope is not stated or 0.
    fn rescale(&self) -> Option<Rescale> {
        let transform = self.group_or_object(tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE);
        let slope = number(transform, tags::RESCALE_SLOPE).filter(|s| *s != 0.0)?;
        let intercept = number(transform, tags::RESCALE_INTERCEPT).unwrap_or(0.0);
        Some(Rescale { slope, intercept })
    }

    /// Sort keys of frame `n` among frames at the same position, most significant first.
    fn order(&self, n: usize) -> [f64; 5] {
        let (set, content) = (self.object, self.group(tags::FRAME_CONTENT_SEQUENCE));
        [
            content
                .and_then(|c| number(c, tags::TEMPORAL_POSITION_INDEX))
                .or_else(|| number(set, tags::TEMPORAL_POSITION_IDENTIFIER)),
            number(set, tags::ACQUISITION_NUMBER),
            number(set, tags::ECHO_TIME),
            number(set, tags::TRIGGER_TIME),
            number(set, tags::INSTANCE_NUMBER).map(|i| i + n as f64 * 1e-6),
        ]
        .map(|v| v.unwrap_or(0.0))
    }

    /// Segment of a frame in a segmentation.
    fn segment(&self) -> u16 {
        let segment = self
            .group(tags::SEGMENT_IDENTIFICATION_SEQUENCE)
            .and_then(|s| number(s, tags::REFERENCED_SEGMENT_NUMBER));
        segment.map_or(1, |s| s as u16)
    }
}

/// Planes of an object, each with its geometry.
pub fn frames(
    set: &InMemDicomObject,
    format: &PixelFormat,
    segmentation: bool,
    most: u64,
) -> Result<Vec<Frame>, String> {
    let count = number(set, tags::NUMBER_OF_FRAMES).unwrap_or(1.0);
    if !(1.0..=(MAX_FRAMES as u64).min(most) as f64).contains(&count) {
        return Err(format!(
            "declares {count} frames, which it cannot hold: it is truncated or its header is damaged; copy or export it again"
        ));
    }
    let count = count as usize;
    let shared = item(set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
    let per_frame = set
        .get(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE)
        .and_then(|e| e.items())
        .unwrap_or(&[]);
    // For consecutive frames, its sign gives the direction (PS3.3 C.8.4.15).
    let slice_spacing = [tags::SPACING_BETWEEN_SLICES, tags::SLICE_THICKNESS]
        .into_iter()
        .filter_map(|t| number(set, t))
        .find(|s| *s != 0.0)
        .unwrap_or(1.0);
    let detector = item(set, tags::DETECTOR_INFORMATION_SEQUENCE);
    let mut frames = Vec::with_capacity(count.min(4096));
    for n in 0..count {
        let own = per_frame.get(n);
        let attributes = FrameAttributes {
            own,
            shared,
            detector,
            object: set,
        };
        let orientation = attributes.orientation();
        let [along, down] = orientation.unwrap_or([DVec3::X, DVec3::Y]);
        if along.cross(down).length() < 1e-3 {
            return Err(
                "has an invalid image orientation (row and column directions); its header is damaged".into(),
            );
        }
        let mut position = attributes.position();
        let stated = [position.is_some(), orientation.is_some()];
        if count > 1 && own.is_none() {
            // Frames without positions are consecutive.
            position = Some(
                position.unwrap_or(DVec3::ZERO)
                    + along.cross(down).normalize_or_zero() * (slice_spacing * n as f64),
            );
        }
        frames.push(Frame {
            object: 0,
            number: n,
            position,
            stated,
            along: [along, down],
            spacing: attributes.spacing(),
            rescale: attributes
                .rescale()
                .filter(|_| format.samples == 1 && !segmentation)
                .unwrap_or(Rescale::NONE),
            segment: attributes.segment(),
            order: attributes.order(n),
        });
    }
    Ok(frames)
}
