//! Groups the frames of DICOM objects into series by their common attributes, sorts them by
//! position, and divides them into time points.

use super::frames::Frame;
use super::scan::Object;
use crate::{Error, Result};
use glam::DVec3;
use std::collections::HashMap;

/// Frames closer than this are at the same position, mm.
pub const SAME_PLACE: f64 = 1e-3;
/// Maximum number of positions named in one message.
pub const MAX_NAMED_POSITIONS: usize = 8;

/// The frames of one volume, or of one for each time.
pub struct DicomSeries {
    /// Its first object.
    pub object: usize,
    /// By time, each sorted along the normal.
    pub times: Vec<Vec<Frame>>,
    /// Number of omitted frames that share a position with another one.
    pub duplicates: usize,
}

/// Describes a series in messages: its modality, number, description and number of slices.
pub fn described(series: &DicomSeries, objects: &[Object]) -> String {
    let object = &objects[series.object];
    let number = object
        .series_number
        .map_or_else(|| "(unnumbered)".to_owned(), |n| n.to_string());
    let description = if object.description.is_empty() {
        String::new()
    } else {
        format!(" \"{}\"", object.description)
    };
    if object.is_structure_set() {
        return format!("{} series {number}{description}", object.modality);
    }
    format!(
        "{} series {number}{description}, {} slices",
        object.modality,
        places(&series.times[0]).len()
    )
}

/// The series with a given number, UID, part of a description, or modality.
pub fn chosen(wanted: &str, all: &[DicomSeries], objects: &[Object]) -> Result<usize> {
    let valid_names = || {
        all.iter()
            .enumerate()
            .take(MAX_NAMED_POSITIONS)
            .map(|(n, s)| format!("{}: {}", n + 1, described(s, objects)))
            .collect::<Vec<_>>()
            .join("; ")
    };
    if let Ok(n) = wanted.parse::<usize>() {
        return if (1..=all.len()).contains(&n) {
            Ok(n - 1)
        } else {
            Err(Error::value(
                "series",
                format!(
                    "{n} is out of range; there are {} series: {}",
                    all.len(),
                    valid_names()
                ),
            ))
        };
    }
    let fits = |s: &DicomSeries| {
        objects[s.object].series == wanted
            || objects[s.object]
                .description
                .to_lowercase()
                .contains(&wanted.to_lowercase())
    };
    let has_modality = |s: &DicomSeries| objects[s.object].modality.eq_ignore_ascii_case(wanted);
    let found = all.iter().position(fits);
    found
        .or_else(|| all.iter().position(has_modality))
        .ok_or_else(|| {
            Error::value(
                "series",
                format!(
                    "\"{wanted}\" matches none of the {} series: {}",
                    all.len(),
                    valid_names()
                ),
            )
        })
}

/// Unit normal of a frame's plane.
pub fn normal(frame: &Frame) -> DVec3 {
    frame.along[0].cross(frame.along[1]).normalize_or(DVec3::Z)
}

/// Groups frames by their common attributes, the largest series first. Structure sets follow, each
/// as a series without frames.
pub fn series(objects: &[Object]) -> Vec<DicomSeries> {
    let mut groups: HashMap<String, Vec<Frame>> = HashMap::new();
    for object in objects {
        let f = &object.format;
        let what = format!(
            "{} {} {} {} {} {} {} {} {}",
            object.series,
            object.modality,
            object.segmentation,
            f.rows,
            f.columns,
            f.samples,
            f.allocated,
            f.signed,
            f.photometric
        );
        for frame in &object.frames {
            let rounded = |v: f64| (v * 1e3).round() as i64;
            let [a, b] = frame.along.map(|d| d.to_array().map(rounded));
            let key = format!("{what} {a:?} {b:?} {:?}", frame.spacing.map(rounded));
            groups.entry(key).or_default().push(frame.clone());
        }
    }
    let mut all: Vec<(String, DicomSeries)> = groups
        .into_iter()
        .map(|(key, frames)| (key, sorted(frames, objects)))
        .collect();
    let structure_sets = objects.iter().enumerate().filter(|(_, o)| o.is_structure_set());
    all.extend(structure_sets.map(|(object, o)| {
        let series = DicomSeries {
            object,
            times: vec![Vec::new()],
            duplicates: 0,
        };
        (format!("{} {}", o.series, o.instance), series)
    }));
    let voxels = |s: &DicomSeries| {
        let f = &objects[s.object].format;
        places(&s.times[0]).len() * usize::from(f.rows) * usize::from(f.columns)
    };
    // Ties are broken by name for a reproducible order.
    all.sort_by(|a, b| voxels(&b.1).cmp(&voxels(&a.1)).then_with(|| a.0.cmp(&b.0)));
    all.into_iter().map(|(_, s)| s).collect()
}

/// Distinct positions along the normal, sorted.
pub fn places(frames: &[Frame]) -> Vec<f64> {
    let mut at: Vec<f64> = frames
        .iter()
        .map(|f| f.position.map_or(0.0, |p| p.dot(normal(f))))
        .collect();
    if frames.iter().any(|f| f.position.is_none()) {
        return (0..frames.len()).map(|n| n as f64).collect();
    }
    at.sort_by(f64::total_cmp);
    at.dedup_by(|a, b| (*a - *b).abs() < SAME_PLACE);
    at
}

/// A group of frames sorted along its normal, divided into time points if every position occurs
/// equally often.
fn sorted(mut frames: Vec<Frame>, objects: &[Object]) -> DicomSeries {
    let object = frames.first().map_or(0, |f| f.object);
    let by_order = |a: &Frame, b: &Frame| {
        let order = a
            .order
            .iter()
            .zip(&b.order)
            .map(|(a, b)| a.total_cmp(b))
            .find(|o| o.is_ne())
            .unwrap_or(std::cmp::Ordering::Equal);
        order
            .then_with(|| {
                objects[a.object]
                    .source
                    .path()
                    .cmp(objects[b.object].source.path())
            })
            .then_with(|| a.number.cmp(&b.number))
    };
    let placed = frames.iter().all(|f| f.position.is_some());
    if !placed {
        // By instance number, for want of better information.
        frames.sort_by(|a, b| a.order[4].total_cmp(&b.order[4]).then_with(|| by_order(a, b)));
        return DicomSeries {
            object,
            times: vec![frames],
            duplicates: 0,
        };
    }
    let at = |f: &Frame| f.position.map_or(0.0, |p| p.dot(normal(f)));
    frames.sort_by(|a, b| at(a).total_cmp(&at(b)).then_with(|| by_order(a, b)));
    if objects[object].segmentation {
        // Segments share positions.
        return DicomSeries {
            object,
            times: vec![frames],
            duplicates: 0,
        };
    }
    let mut stacks: Vec<Vec<Frame>> = Vec::new();
    for frame in frames {
        match stacks
            .last_mut()
            .filter(|s| s.first().is_some_and(|f| (at(f) - at(&frame)).abs() < SAME_PLACE))
        {
            Some(stack) => stack.push(frame),
            None => stacks.push(vec![frame]),
        }
    }
    stacks.iter_mut().for_each(|s| s.sort_by(by_order));
    let often = stacks.iter().map(Vec::len).min().unwrap_or(1);
    let even = stacks.iter().all(|s| s.len() == often);
    let times = if even { often } else { 1 };
    let duplicates = stacks.iter().map(|s| s.len() - times).sum();
    let times = (0..times)
        .map(|t| stacks.iter().map(|s| s[t].clone()).collect())
        .collect();
    DicomSeries {
        object,
        times,
        duplicates,
    }
}
