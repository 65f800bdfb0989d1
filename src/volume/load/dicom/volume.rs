//! The volume of a sorted set of frames.

use super::super::image::{Image, Meaning};
use super::super::source::usable;
use super::super::{ReadOptions, Voxels};
use super::frame::Frame;
use super::object::Object;
use super::pixels::{check_held, check_syntax};
use super::placement::{SlicePlacement, length, placement};
use super::segments::SegmentLabels;
use super::series::{normal, same_place};
use super::values::DecodeJob;
use crate::volume::{Rescale, SliceDisplacement};
use crate::{Error, Result, Watch};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// The first frame of each slice, and the slice index of each frame; several frames of a
/// segmentation share a slice.
fn slices(frames: &[Frame], segmentation: bool) -> (Vec<&Frame>, Vec<usize>) {
    if !segmentation {
        return (frames.iter().collect(), (0..frames.len()).collect());
    }
    let unit = normal(&frames[0]);
    let at = |f: &Frame| f.position.map(|p| p.dot(unit));
    let places: Vec<f64> = frames.iter().filter_map(at).collect();
    let tolerance = same_place(&places);
    let mut slices: Vec<&Frame> = Vec::new();
    let mut slot: Vec<usize> = Vec::with_capacity(frames.len());
    for frame in frames {
        let same = |f: &&&Frame| {
            at(f)
                .zip(at(frame))
                .is_some_and(|(a, b)| (a - b).abs() <= tolerance)
        };
        if slices.last().filter(same).is_none() {
            slices.push(frame);
        }
        slot.push(slices.len() - 1);
    }
    (slices, slot)
}

/// The displacement of slices from the even grid on which they are shown, if there is any.
fn displacement(placement: &SlicePlacement, components: usize, resampled: bool) -> Option<SliceDisplacement> {
    let [along, aside] = placement.deviation_mm;
    let along = if resampled { 0.0 } else { along };
    let by_mm = along.max(aside);
    (by_mm > 0.0).then_some(SliceDisplacement {
        by_mm,
        resampling_helps: along > 0.0 && components == 1,
    })
}

/// The volume of a sorted set of frames.
pub fn volume(
    path: &Path,
    objects: &[Object],
    frames: &[Frame],
    choice: &ReadOptions,
    watch: &Watch,
    warnings: &mut Vec<String>,
) -> Result<Image> {
    let object = &objects[frames[0].object];
    check_objects(path, objects, frames)?;
    let (slices, mut slot) = slices(frames, object.segmentation);
    let placement = placement(&slices, object, choice.resample, warnings);
    let format = &object.format;
    let mut depth = slices.len();
    if object.segmentation && placement.even {
        slot.iter_mut()
            .for_each(|s| *s = placement.at[*s].round() as usize);
        depth = slot.last().map_or(1, |s| s + 1);
    }
    let [columns, rows] = object.plane();
    let size = [columns, rows, depth];
    if !usable(&placement.world_from_voxel) {
        return Err(Error::file(
            path,
            "states positions or spacings that cannot be used; its header is damaged",
        ));
    }
    let total = size
        .iter()
        .product::<usize>()
        .checked_mul(usize::from(format.samples))
        .ok_or_else(|| Error::file(path, "is larger than can be addressed"))?;
    let segments = SegmentLabels::of(objects, frames);
    warnings.extend(segments.warning());
    let job = DecodeJob {
        path,
        objects,
        frames,
        slot: &slot,
        segments: &segments,
        total,
        watch,
        unread: Mutex::default(),
    };
    let (voxels, components) = job.values(warnings)?;
    let has_one_scale = job.has_one_scale();
    warn_of_unread(
        &job.unread.into_inner().unwrap_or_else(PoisonError::into_inner),
        &slices,
        warnings,
    );
    let all: BTreeSet<&String> = frames.iter().flat_map(|f| &objects[f.object].warnings).collect();
    warnings.extend(all.into_iter().cloned());
    let mut image = Image::new("DICOM", voxels, size, placement.world_from_voxel);
    image.components = components;
    image.rescale = if has_one_scale && components == 1 {
        frames[0].rescale
    } else {
        Rescale::NONE
    };
    image.inverted = object.inverted;
    if image.inverted {
        warnings.push(format!(
            "is meant to be shown inverted, with high values dark ({}); its values are read as stored",
            if format.photometric == "MONOCHROME1" {
                "MONOCHROME1"
            } else {
                "presentation shape INVERSE"
            }
        ));
    }
    image.padding = object.padding.filter(|_| components == 1 && has_one_scale);
    if object.segmentation {
        image.meaning = Meaning::Labels(segments.labels);
    } else if components > 1 {
        image.meaning = Meaning::Color;
    }
    if !placement.even {
        image.details.push(("slice_positions_mm", positions(&slices)));
        if choice.resample {
            evened(path, &mut image, &placement, warnings)?;
        }
    }
    image.misplaced = displacement(&placement, components, choice.resample);
    Ok(image)
}

/// Rejects, before anything is allocated, volumes most of whose objects cannot be decoded or cannot
/// contain their pixels.
pub fn check_objects(path: &Path, objects: &[Object], frames: &[Frame]) -> Result<()> {
    let all: BTreeSet<usize> = frames.iter().map(|f| f.object).collect();
    let mut failed = Vec::new();
    for object in all.iter().map(|o| &objects[*o]) {
        failed.extend(check_syntax(object).and_then(|()| check_held(object)).err());
    }
    if !failed.is_empty() && (2 * failed.len() >= all.len() || objects[frames[0].object].segmentation) {
        return Err(match failed.swap_remove(0) {
            Error::File { problem, .. } if all.len() == 1 => Error::file(path, problem),
            other => other,
        });
    }
    Ok(())
}

/// Warns of slices that could not be read.
fn warn_of_unread(unread: &[(usize, String)], slices: &[&Frame], warnings: &mut Vec<String>) {
    let Some((first, problem)) = unread.first() else {
        return;
    };
    let at = slices
        .get(*first)
        .and_then(|f| Some(f.position?.dot(normal(f))))
        .map_or(String::new(), |mm| {
            let first = if unread.len() == 1 { "" } else { "the first " };
            format!(", {first}at {} mm along the normal", length(mm))
        });
    warnings.push(match unread.len() {
        1 => format!("1 slice is missing because it cannot be read{at}; its place is left empty ({problem})"),
        n => format!(
            "{n} slices are missing because they cannot be read{at}; their places are left empty ({problem})"
        ),
    });
}

/// Positions of slices along their normal, mm, for `info`.
fn positions(slices: &[&Frame]) -> Value {
    json!(
        slices
            .iter()
            .map(|f| f.position.map(|p| (p.dot(normal(f)) * 1e4).round() / 1e4))
            .collect::<Vec<_>>()
    )
}

/// Interpolates unevenly spaced slices onto an even grid of the usual step.
fn evened(
    path: &Path,
    image: &mut Image,
    placement: &SlicePlacement,
    warnings: &mut Vec<String>,
) -> Result<()> {
    if image.components > 1 {
        return Err(Error::file(
            path,
            "is a colour image; its slices cannot be resampled",
        ));
    }
    let at = &placement.at;
    let count = placement.resampled_count();
    let step = (at.len() - 1) as f64 / (count - 1) as f64;
    let (labels, padding) = (matches!(image.meaning, Meaning::Labels(_)), image.padding);
    // Two slices, and the position between them.
    let between: Vec<(usize, f64)> = (0..count)
        .map(|k| {
            let position = k as f64 * step;
            let above = at.partition_point(|a| *a <= position).clamp(1, at.len() - 1);
            (
                above - 1,
                ((position - at[above - 1]) / (at[above] - at[above - 1])).clamp(0.0, 1.0),
            )
        })
        .collect();
    let nothing = |v: f64| padding.is_some_and(|[low, high]| (low..=high).contains(&v));
    // Labels are not interpolated, nor are padding and values.
    let voxels = Voxels::new(image.size, image.voxels.clone())
        .interpolated_layers(&between, |a, b| labels || nothing(a) || nothing(b));
    image.voxels = voxels.reshaped(count * image.size[0] * image.size[1]);
    image.size[2] = count;
    image.world_from_voxel.matrix3.z_axis *= step;
    warnings.push(format!(
        "its {} slices were interpolated to {count}, {:.2} mm apart",
        at.len(),
        image.world_from_voxel.matrix3.z_axis.length()
    ));
    Ok(())
}
