//! The frames of an object, each with its geometry.

use super::attributes::FrameAttributes;
use super::element::{item, number};
use super::frame::{Digest, Frame, PixelFormat};
use super::increments::Increments;
use super::mosaic::Mosaic;
use super::time_keys::{keys_of, other_attributes, own_attributes};
use crate::volume::Rescale;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use glam::DVec3;
use std::sync::Arc;

/// Maximum number of frames in one object.
const MAX_FRAMES: usize = 1 << 20;

/// Number of pictures in an object; 0 and a missing number mean one.
pub fn picture_count(set: &InMemDicomObject, most: u64) -> Result<usize, String> {
    let count = number(set, tags::NUMBER_OF_FRAMES).unwrap_or(1.0);
    let count = if count == 0.0 { 1.0 } else { count };
    if !(1.0..=(MAX_FRAMES as u64).min(most) as f64).contains(&count) {
        return Err(format!(
            "declares {count} frames, which it cannot hold: it is truncated or its header is damaged; copy or export it again"
        ));
    }
    Ok(count as usize)
}

/// Planes of an object with `count` pictures, each with its geometry.
pub fn frames(
    set: &InMemDicomObject,
    format: &PixelFormat,
    segmentation: bool,
    count: usize,
    increments: &Increments,
    mosaic: Option<&Mosaic>,
) -> Result<Vec<Frame>, String> {
    let shared = item(set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
    let per_frame = set
        .get(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE)
        .and_then(|e| e.items())
        .unwrap_or(&[]);
    let detectors = set
        .get(tags::DETECTOR_INFORMATION_SEQUENCE)
        .and_then(|e| e.items())
        .unwrap_or(&[]);
    let others: Arc<[(Tag, Digest)]> = other_attributes(set).into();
    let mut frames = Vec::with_capacity(count.min(4096));
    for n in 0..count {
        let own = per_frame.get(n);
        let attributes = FrameAttributes {
            own,
            shared,
            detector: increments.detector(n).and_then(|d| detectors.get(d)),
            object: set,
            number: n,
            count,
            frame_time: increments.time(n),
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
        let mut placed = position.is_some() && mosaic.is_none();
        if count > 1 && !attributes.has_own_position() {
            placed = increments.are_stated();
            let normal = along.cross(down).normalize_or_zero();
            position = Some(increments.place(n, position.unwrap_or(DVec3::ZERO), normal));
        }
        let (spacing, at_detector) = attributes.spacing();
        let frame = Frame {
            object: 0,
            number: n,
            tile: None,
            position,
            stated,
            placed,
            location: number(set, tags::SLICE_LOCATION).filter(|_| count == 1),
            along: [along, down],
            spacing,
            at_detector,
            aspect: attributes.aspect(),
            rescale: attributes
                .rescale()
                .filter(|_| format.samples == 1 && !segmentation)
                .unwrap_or(Rescale::NONE),
            segment: attributes.segment(),
            keys: keys_of(&attributes),
            others: others.clone(),
            own_others: own.map(own_attributes).unwrap_or_default(),
            instance: number(set, tags::INSTANCE_NUMBER),
        };
        match mosaic {
            Some(mosaic) => frames.extend(mosaic.frames(&frame)),
            None => frames.push(frame),
        }
    }
    Ok(frames)
}
