//! Groups the frames of DICOM objects into series by their common attributes, sorts them by
//! position, and divides them into volumes of one time.
//!
//! Orientations, spacings and positions are compared with tolerances relative to what is compared,
//! in any unit from nanometres to metres.

use super::frame::Frame;
use super::object::Object;
use super::pixels::same_pixels;
use super::times::{Certainty, Division, TimePoints, divide};
use crate::volume::load::slices::natural;
use crate::{Error, Result};
use glam::DVec3;
use std::cmp::Ordering;
use std::collections::{BTreeMap, HashMap};

/// Directions that differ by less than this, as a fraction of a unit vector, are equal.
const SAME_DIRECTION: f64 = 2e-3;
/// Pixel spacings that differ by less than this fraction are equal.
const SAME_SPACING: f64 = 1e-3;
/// Positions that differ by less than this fraction of the usual distance between slices are equal.
const SAME_PLACE: f64 = 0.01;
/// Positions that belong together differ by less than this fraction of the distance between others.
const JITTER: f64 = 1e-3;
/// Maximum number of positions named in one message.
pub const MAX_NAMED_POSITIONS: usize = 8;

/// The frames of one volume, or of one for each time.
pub struct DicomSeries {
    /// Its first object.
    pub object: usize,
    /// By time, each sorted along the normal.
    pub times: Vec<Vec<Frame>>,
    /// How the times are told apart.
    pub by: TimePoints,
    /// Number of omitted frames that share a position with another one.
    pub duplicates: usize,
    /// Number of omitted frames that do not state their position, unlike the others.
    pub unplaced: usize,
    /// How far frames at the same position could be told apart.
    pub certainty: Certainty,
}

impl DicomSeries {
    /// Frames of one time.
    fn of_one(object: usize, frames: Vec<Frame>) -> Self {
        Self {
            object,
            times: vec![frames],
            by: TimePoints::default(),
            duplicates: 0,
            unplaced: 0,
            certainty: Certainty::Certain,
        }
    }
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

/// Modality, number and patient of a series; objects may lack them.
type SeriesNames<'a> = HashMap<&'a str, (&'a str, Option<i64>, &'a str)>;

/// What the frames of a series have in common, exactly.
fn common(object: &Object, names: &SeriesNames) -> String {
    let f = &object.format;
    let (series, segmentation) = (&object.series, object.segmentation);
    let usual = names.get(series.as_str()).copied().unwrap_or_default();
    let number = object.series_number.or(usual.1).unwrap_or(0);
    let modality = match object.modality.as_str() {
        "" => usual.0,
        stated => stated,
    };
    let [columns, rows] = object.plane();
    let patient = match object.patient[1].as_str() {
        "" => usual.2,
        stated => stated,
    };
    let film = if object.film { &object.instance } else { "" };
    format!(
        "{series} {patient} {number} {modality} {segmentation} {rows} {columns} {} {} {} {film}",
        f.samples, f.photometric, object.localizer
    )
}

/// The modality, number and patient that objects of each series state.
fn names(objects: &[Object]) -> SeriesNames<'_> {
    let mut names = SeriesNames::new();
    for object in objects {
        let entry = names.entry(&object.series).or_default();
        if entry.0.is_empty() {
            entry.0 = &object.modality;
        }
        entry.1 = entry.1.or(object.series_number);
        if entry.2.is_empty() {
            entry.2 = &object.patient[1];
        }
    }
    names
}

/// Whether two frames have the same orientation and spacing.
fn is_like(a: &Frame, b: &Frame) -> bool {
    let directions = (0..2).all(|n| (a.along[n] - b.along[n]).length() < SAME_DIRECTION);
    let spacings =
        (0..2).all(|n| (a.spacing[n] - b.spacing[n]).abs() <= SAME_SPACING * a.spacing[n].max(b.spacing[n]));
    directions && spacings
}

/// Groups frames by their common attributes, the largest series first. Structure sets follow, each
/// as a series without frames.
pub fn series(objects: &[Object]) -> Vec<DicomSeries> {
    let names = names(objects);
    let mut groups: BTreeMap<String, Vec<Vec<Frame>>> = BTreeMap::new();
    for object in objects {
        let groups = groups.entry(common(object, &names)).or_default();
        for frame in &object.frames {
            match groups.iter_mut().rev().find(|g| is_like(&g[0], frame)) {
                Some(group) => group.push(frame.clone()),
                None => groups.push(vec![frame.clone()]),
            }
        }
    }
    let mut all: Vec<DicomSeries> = groups
        .into_values()
        .flatten()
        .map(|frames| sorted(frames, objects))
        .collect();
    let voxels = |s: &DicomSeries| {
        let [columns, rows] = objects[s.object].plane();
        places(&s.times[0]).len() * rows * columns
    };
    // Ties keep the order of the groups, which is reproducible.
    all.sort_by_cached_key(|s| std::cmp::Reverse(voxels(s)));
    let structure_sets = (0..objects.len()).filter(|o| objects[*o].is_structure_set());
    all.extend(structure_sets.map(|object| DicomSeries::of_one(object, Vec::new())));
    all
}

/// Position of a frame along its normal, mm.
fn along_normal(frame: &Frame, unit: DVec3) -> f64 {
    frame.position.map_or(0.0, |p| p.dot(unit))
}

/// The distance, mm, below which sorted positions along a normal are the same.
pub fn same_place(sorted: &[f64]) -> f64 {
    let (Some(first), Some(last)) = (sorted.first(), sorted.last()) else {
        return 0.0;
    };
    // Decimal digits of positions end here.
    let least = 1e-11 * first.abs().max(last.abs()) + 1e-9 * (last - first);
    let mut gaps: Vec<f64> = sorted
        .windows(2)
        .map(|w| w[1] - w[0])
        .filter(|g| *g > least)
        .collect();
    gaps.sort_by(f64::total_cmp);
    let Some(&usual) = gaps.get(gaps.len() / 2) else {
        return least;
    };
    // The gap at which half of the distance is covered by larger ones.
    let mut covered = 0.0;
    let large = gaps
        .iter()
        .rev()
        .find(|g| {
            covered += **g;
            covered >= 0.5 * (last - first)
        })
        .copied()
        .unwrap_or(usual);
    let strict = (SAME_PLACE * usual).max(least);
    if usual > JITTER * large {
        return strict;
    }
    // Mostly tiny gaps: repeated positions that scatter, if they come in groups of one size.
    let tolerant = (SAME_PLACE * large).max(least);
    let sizes = group_sizes(sorted, tolerant);
    let most = sizes.iter().copied().max().unwrap_or(0);
    let full = sizes.iter().filter(|s| **s == most).count();
    if most > 1 && sizes.len() > 1 && 2 * full >= sizes.len() {
        tolerant
    } else {
        strict
    }
}

/// Numbers of consecutive positions that differ by less than a tolerance.
fn group_sizes(sorted: &[f64], tolerance: f64) -> Vec<usize> {
    let mut sizes = vec![1];
    for pair in sorted.windows(2) {
        if pair[1] - pair[0] <= tolerance {
            *sizes.last_mut().unwrap_or(&mut 0) += 1;
        } else {
            sizes.push(1);
        }
    }
    sizes
}

/// Distinct positions along the normal, sorted.
pub fn places(frames: &[Frame]) -> Vec<f64> {
    if frames.is_empty() || frames.iter().any(|f| f.position.is_none()) {
        return (0..frames.len()).map(|n| n as f64).collect();
    }
    let unit = normal(&frames[0]);
    let mut at: Vec<f64> = frames.iter().map(|f| along_normal(f, unit)).collect();
    at.sort_by(f64::total_cmp);
    let tolerance = same_place(&at);
    at.dedup_by(|a, b| (*a - *b).abs() <= tolerance);
    at
}

/// A group of frames sorted along its normal, divided into volumes.
fn sorted(mut frames: Vec<Frame>, objects: &[Object]) -> DicomSeries {
    let object = frames.first().map_or(0, |f| f.object);
    let one = |frames: Vec<Frame>| DicomSeries::of_one(object, frames);
    // A few slices without a position among others that state it cannot be placed.
    let all = frames.len();
    if frames.iter().filter(|f| f.position.is_none()).count() * 2 < all {
        frames.retain(|f| f.position.is_some());
    }
    let unplaced = all - frames.len();
    let object = frames.first().map_or(object, |f| f.object);
    if frames.iter().any(|f| f.position.is_none()) {
        sort_unplaced(&mut frames, objects);
        return one(frames);
    }
    let unit = normal(&frames[0]);
    frames.sort_by(|a, b| {
        along_normal(a, unit)
            .total_cmp(&along_normal(b, unit))
            .then_with(|| by_name(a, b, objects))
    });
    if objects[object].segmentation {
        // Segments share positions.
        return one(frames);
    }
    let at: Vec<f64> = frames.iter().map(|f| along_normal(f, unit)).collect();
    let tolerance = same_place(&at);
    let mut stack = vec![0; frames.len()];
    for n in 1..frames.len() {
        stack[n] = stack[n - 1] + usize::from(at[n] - at[n - 1] > tolerance);
    }
    let division = divide(&frames, &stack, &at);
    let division = without_copies(division, &frames, &stack, objects);
    let mut times: Vec<Vec<Frame>> = division
        .volumes
        .iter()
        .map(|v| v.iter().map(|n| frames[*n].clone()).collect())
        .collect();
    let distance = |f: &Frame| along_normal(f, unit);
    times
        .iter_mut()
        .for_each(|t| t.sort_by(|a, b| distance(a).total_cmp(&distance(b))));
    DicomSeries {
        object,
        times,
        by: division.by,
        duplicates: division.duplicates.len(),
        unplaced,
        certainty: division.certainty,
    }
}

/// Where no attribute tells frames apart, those with the same pixels are copies.
fn without_copies(mut division: Division, frames: &[Frame], stack: &[usize], objects: &[Object]) -> Division {
    if division.certainty != Certainty::Ambiguous {
        return division;
    }
    let mut known: HashMap<usize, Vec<usize>> = HashMap::new();
    let mut volumes = Vec::new();
    for volume in &division.volumes {
        let mut own = Vec::new();
        for n in volume {
            let seen = known.entry(stack[*n]).or_default();
            let same = |m: &usize| {
                let (a, b) = (&frames[*n], &frames[*m]);
                a.number == b.number
                    && a.tile == b.tile
                    && same_pixels(&objects[a.object], &objects[b.object])
            };
            if seen.iter().any(same) {
                division.duplicates.push(*n);
            } else {
                seen.push(*n);
                own.push(*n);
            }
        }
        if !own.is_empty() {
            volumes.push(own);
        }
    }
    let largest = volumes.iter().map(Vec::len).max().unwrap_or(0);
    let (volumes, few): (Vec<_>, Vec<_>) = volumes.into_iter().partition(|v| 2 * v.len() >= largest);
    division.duplicates.extend(few.concat());
    if volumes.len() < 2 {
        division.certainty = Certainty::Certain;
    }
    if volumes.len() != division.volumes.len() {
        division.by = TimePoints::default();
    }
    division.volumes = volumes;
    division
}

/// The order of names, in which numbers count as numbers, and of frames in an object.
fn by_name(a: &Frame, b: &Frame, objects: &[Object]) -> Ordering {
    let name = |f: &Frame| objects[f.object].source.path().to_string_lossy();
    natural(&name(a), &name(b)).then_with(|| a.number.cmp(&b.number))
}

/// Sorts frames without positions: by slice location, if every frame states another one, else by
/// instance number, else by name.
fn sort_unplaced(frames: &mut [Frame], objects: &[Object]) {
    if has_locations(frames) {
        frames.sort_by(|a, b| {
            let of = |f: &Frame| f.location.unwrap_or(0.0);
            of(a).total_cmp(&of(b))
        });
        return;
    }
    let instances = frames.iter().any(|f| f.instance != frames[0].instance);
    frames.sort_by(|a, b| {
        let of = |f: &Frame| f.instance.unwrap_or(0.0);
        let order = if instances {
            of(a).total_cmp(&of(b))
        } else {
            Ordering::Equal
        };
        order.then_with(|| by_name(a, b, objects))
    });
}

/// Whether every frame states a slice location of its own.
pub fn has_locations(frames: &[Frame]) -> bool {
    let mut at: Vec<f64> = frames.iter().filter_map(|f| f.location).collect();
    at.sort_by(f64::total_cmp);
    let tolerance = same_place(&at);
    at.len() == frames.len() && at.len() > 1 && at.windows(2).all(|w| w[1] - w[0] > tolerance)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions in any unit, repeated exactly, with scatter, or not at all.
    #[test]
    fn positions_are_compared_relative_to_their_distances() {
        let count = |mut at: Vec<f64>| {
            at.sort_by(f64::total_cmp);
            group_sizes(&at, same_place(&at)).len()
        };
        for unit in [1e-7, 5e-4, 1.0, 3e3] {
            let even = |n: usize, times: usize, scatter: f64| -> Vec<f64> {
                (0..n * times)
                    .map(|m| unit * ((m / times) as f64 + scatter * (m % times) as f64 - 7.3))
                    .collect()
            };
            assert_eq!(count(even(12, 1, 0.0)), 12, "{unit}");
            assert_eq!(count(even(12, 3, 0.0)), 12, "{unit}");
            assert_eq!(count(even(12, 2, 1e-4)), 12, "{unit}");
            assert_eq!(count(even(12, 3, 1e-4)), 12, "{unit}");
            // Two blocks of slices far apart.
            let mut blocks = even(50, 1, 0.0);
            blocks.extend(even(50, 1, 0.0).iter().map(|a| a + 400.0 * unit));
            assert_eq!(count(blocks), 100, "{unit}");
        }
        assert_eq!(count(vec![3.0]), 1);
        assert_eq!(count(vec![3.0, 3.0]), 1);
    }
}
