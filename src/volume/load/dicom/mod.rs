//! DICOM: the series in a file, a folder or a zip, sorted into volumes.
//!
//! Frames belong together by series, orientation, size and spacing. They are sorted by their
//! position along the slice normal, never by instance number. Every frame has its own geometry and
//! rescale. A gantry tilt is a shear of the voxel axes. Uneven spacing and missing slices are
//! reported with their positions, and resampled only on request.
//!
//! Source: DICOM PS3.3 C.7.6.2 (image plane), C.7.6.16 (functional groups), C.8.20 (segmentation).

mod location;
mod pixels;
mod scan;
mod syntax;

pub use scan::is_dicom;

use super::image::{Image, Meaning};
use super::source::{usable, zeroed};
use super::{ReadOptions, StoredValues, Voxels};
use crate::volume::{Rescale, SliceDisplacement};
use crate::{ByteProgress, Error, Result, Watch};
use glam::{DAffine3, DMat3, DVec3};
use pixels::{Pixel, check_syntax, decode};
use rayon::prelude::*;
use scan::{Frame, Object, PixelFormat, SegmentsAs, scan};
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use syntax::{max_compression_ratio, syntax_name};

/// Steps that differ by more than this, in mm or as a fraction of the step, are uneven.
const UNEVEN: [f64; 2] = [0.01, 0.01];
/// Frames closer than this are at the same position, mm.
const SAME_PLACE: f64 = 1e-3;
/// Maximum number of slices of a segmentation with omitted empty slices.
const MAX_EMPTY_SLICES: f64 = 10_000.0;
/// Maximum number of positions named in one message.
const MAX_NAMED_POSITIONS: usize = 8;
/// Compressed syntaxes whose decoders return colours as stored: RLE, lossless JPEG, JPEG-LS.
const AS_STORED: [&str; 5] =
    ["1.2.840.10008.1.2.5", "1.2.840.10008.1.2.4.57", "1.2.840.10008.1.2.4.70", "1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2.4.81"];
/// Maximum factor by which resampling may increase the number of slices.
const MAX_RESAMPLING_FACTOR: f64 = 16.0;

/// The frames of one volume, or of one for each time.
struct DicomSeries {
    /// Its first object.
    object: usize,
    /// By time, each sorted along the normal.
    times: Vec<Vec<Frame>>,
    /// Number of omitted frames that share a position with another one.
    duplicates: usize,
}

/// The description of a series, as shown by `info`.
#[derive(Clone, Debug, serde::Serialize)]
pub struct SeriesInfo {
    /// Its index, from 1, the largest series first.
    pub number: usize,
    /// The series number assigned by the scanner.
    pub series_number: Option<i64>,
    /// Description.
    pub description: String,
    /// Modality: CT, MR, ...
    pub modality: String,
    /// Voxels along i, j, k.
    pub size: [usize; 3],
    /// Number of time points.
    pub time_points: usize,
    /// Series instance UID.
    pub uid: String,
    /// Name and ID of the patient; only if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patient: Option<[String; 2]>,
}

/// Every series in a file, a folder or a zip, the largest first. `patient`: with the patient's name
/// and ID.
///
/// # Errors
/// Nothing that is DICOM and contains pixels.
pub fn list(path: &Path, patient: bool, watch: &Watch) -> Result<Vec<SeriesInfo>> {
    let found = scan(path, watch)?;
    let all = series(&found.objects);
    if all.is_empty() {
        return Err(nothing(path, found));
    }
    Ok(all.iter().enumerate().map(|(n, s)| info(n, s, &found.objects, patient)).collect())
}

fn info(n: usize, series: &DicomSeries, objects: &[Object], patient: bool) -> SeriesInfo {
    let object = &objects[series.object];
    SeriesInfo {
        number: n + 1,
        series_number: object.series_number,
        description: object.description.clone(),
        modality: object.modality.clone(),
        size: [usize::from(object.format.columns), usize::from(object.format.rows), places(&series.times[0]).len()],
        time_points: series.times.len(),
        uid: object.series.clone(),
        patient: patient.then(|| object.patient.clone()),
    }
}

/// The message where there are no pixels.
fn nothing(path: &Path, found: scan::ScanResult) -> Error {
    match found.complaint {
        Some(complaint) => complaint,
        None if path.is_dir() => Error::file(
            path,
            std::iter::once(format!(
                "holds no image that can be read ({} files were looked at); name a file, or a folder of DICOM files or pictures",
                found.others
            ))
            .chain(found.notes)
            .collect::<Vec<_>>()
            .join("; "),
        ),
        None if found.others > 0 && path.extension().is_some_and(|e| e.eq_ignore_ascii_case("zip")) => {
            Error::file(path, "is a zip archive without a DICOM image; unpack it and name the file you want")
        }
        None => Error::file(path, "is a DICOM object without pixel data; name one that has pixel data"),
    }
}

/// Whether a folder or zip contains any DICOM image.
///
/// # Errors
/// [`Error::Cancelled`].
pub fn any(path: &Path, watch: &Watch) -> Result<bool> {
    let found = scan(path, watch)?;
    Ok(!found.objects.is_empty() || found.complaint.is_some())
}

/// Reads one series.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    // Scanning headers counts as a tenth of the time.
    let scanning = |share: f32| (watch.progress)(0.1 * share);
    let found = scan(path, &Watch { progress: &scanning, cancel: watch.cancel })?;
    let all = series(&found.objects);
    if all.is_empty() {
        return Err(nothing(path, found));
    }
    let index = match &choice.series {
        None => 0,
        Some(wanted) => chosen(wanted, &all, &found.objects)?,
    };
    let series = &all[index];
    let mut warnings = Vec::new();
    if all.len() > 1 && choice.series.is_none() {
        warnings.push(format!(
            "holds {} series; the largest is used ({}); --series chooses another, and info lists them",
            all.len(),
            named(series, &found.objects)
        ));
    }
    warnings.extend(found.notes.iter().cloned());
    if found.damaged > 0 {
        let first = found.complaint.as_ref().map(ToString::to_string).unwrap_or_default();
        warnings.push(format!("{} damaged files are left out ({first})", found.damaged));
    }
    if series.duplicates > 0 {
        warnings.push(format!("{} slices at the same position as another were skipped", series.duplicates));
    }
    let time = choice.time_of(series.times.len())?;
    if series.times.len() > 1 && choice.time.is_none() {
        warnings.push(format!("holds {} volumes at the same place; the first is used (--time chooses another)", series.times.len()));
    }
    let reading = |share: f32| (watch.progress)(0.1 + 0.9 * share);
    let watch = Watch { progress: &reading, cancel: watch.cancel };
    let mut image = volume(path, &found.objects, &series.times[time], choice, &watch, &mut warnings)?;
    let object = &found.objects[series.object];
    image.details.extend([
        ("modality", json!(object.modality)),
        ("series", json!({ "number": index + 1, "of": all.len(), "uid": object.series, "description": object.description })),
        ("transfer_syntax", json!(syntax_name(&object.syntax))),
    ]);
    if series.times.len() > 1 {
        image.details.push(("time_points", json!(series.times.len())));
    }
    image.warnings = warnings;
    Ok(image)
}

fn named(series: &DicomSeries, objects: &[Object]) -> String {
    let object = &objects[series.object];
    let number = object.series_number.map_or_else(|| "(unnumbered)".to_owned(), |n| n.to_string());
    let description = if object.description.is_empty() { String::new() } else { format!(" \"{}\"", object.description) };
    format!("{} series {number}{description}, {} slices", object.modality, places(&series.times[0]).len())
}

/// The series with a given number, UID or part of a description.
fn chosen(wanted: &str, all: &[DicomSeries], objects: &[Object]) -> Result<usize> {
    let valid_names =
        || all.iter().enumerate().take(MAX_NAMED_POSITIONS).map(|(n, s)| format!("{}: {}", n + 1, named(s, objects))).collect::<Vec<_>>().join("; ");
    if let Ok(n) = wanted.parse::<usize>() {
        return if (1..=all.len()).contains(&n) {
            Ok(n - 1)
        } else {
            Err(Error::value("series", format!("{n} is out of range; there are {} series: {}", all.len(), valid_names())))
        };
    }
    let fits = |s: &DicomSeries| objects[s.object].series == wanted || objects[s.object].description.to_lowercase().contains(&wanted.to_lowercase());
    all.iter()
        .position(fits)
        .ok_or_else(|| Error::value("series", format!("\"{wanted}\" matches none of the {} series: {}", all.len(), valid_names())))
}

/// Unit normal of a frame's plane.
fn normal(frame: &Frame) -> DVec3 {
    frame.along[0].cross(frame.along[1]).normalize_or(DVec3::Z)
}

/// Groups frames by their common attributes, the largest series first.
fn series(objects: &[Object]) -> Vec<DicomSeries> {
    let mut groups: HashMap<String, Vec<Frame>> = HashMap::new();
    for object in objects {
        let f = &object.format;
        let what = format!(
            "{} {} {} {} {} {} {} {} {}",
            object.series, object.modality, object.segmentation, f.rows, f.columns, f.samples, f.allocated, f.signed, f.photometric
        );
        for frame in &object.frames {
            let rounded = |v: f64| (v * 1e3).round() as i64;
            let [a, b] = frame.along.map(|d| d.to_array().map(rounded));
            let key = format!("{what} {a:?} {b:?} {:?}", frame.spacing.map(rounded));
            groups.entry(key).or_default().push(frame.clone());
        }
    }
    let mut all: Vec<(String, DicomSeries)> = groups.into_iter().map(|(key, frames)| (key, sorted(frames, objects))).collect();
    let voxels = |s: &DicomSeries| {
        let f = &objects[s.object].format;
        places(&s.times[0]).len() * usize::from(f.rows) * usize::from(f.columns)
    };
    // Ties are broken by name for a reproducible order.
    all.sort_by(|a, b| voxels(&b.1).cmp(&voxels(&a.1)).then_with(|| a.0.cmp(&b.0)));
    all.into_iter().map(|(_, s)| s).collect()
}

/// Distinct positions along the normal, sorted.
fn places(frames: &[Frame]) -> Vec<f64> {
    let mut at: Vec<f64> = frames.iter().map(|f| f.position.map_or(0.0, |p| p.dot(normal(f)))).collect();
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
        let order = a.order.iter().zip(&b.order).map(|(a, b)| a.total_cmp(b)).find(|o| o.is_ne()).unwrap_or(std::cmp::Ordering::Equal);
        order.then_with(|| objects[a.object].source.path().cmp(objects[b.object].source.path())).then_with(|| a.number.cmp(&b.number))
    };
    let placed = frames.iter().all(|f| f.position.is_some());
    if !placed {
        // By instance number, for want of better information.
        frames.sort_by(|a, b| a.order[4].total_cmp(&b.order[4]).then_with(|| by_order(a, b)));
        return DicomSeries { object, times: vec![frames], duplicates: 0 };
    }
    let at = |f: &Frame| f.position.map_or(0.0, |p| p.dot(normal(f)));
    frames.sort_by(|a, b| at(a).total_cmp(&at(b)).then_with(|| by_order(a, b)));
    if objects[object].segmentation {
        // Segments share positions.
        return DicomSeries { object, times: vec![frames], duplicates: 0 };
    }
    let mut stacks: Vec<Vec<Frame>> = Vec::new();
    for frame in frames {
        match stacks.last_mut().filter(|s| s.first().is_some_and(|f| (at(f) - at(&frame)).abs() < SAME_PLACE)) {
            Some(stack) => stack.push(frame),
            None => stacks.push(vec![frame]),
        }
    }
    stacks.iter_mut().for_each(|s| s.sort_by(by_order));
    let often = stacks.iter().map(Vec::len).min().unwrap_or(1);
    let even = stacks.iter().all(|s| s.len() == often);
    let times = if even { often } else { 1 };
    let duplicates = stacks.iter().map(|s| s.len() - times).sum();
    let times = (0..times).map(|t| stacks.iter().map(|s| s[t].clone()).collect()).collect();
    DicomSeries { object, times, duplicates }
}

/// The placement of a volume's slices.
struct SlicePlacement {
    world_from_voxel: DAffine3,
    /// Position of every slice, in slices from the first one; integers if they are even.
    at: Vec<f64>,
    even: bool,
    /// Largest deviation of a slice from the even grid, along the normal and perpendicular to it,
    /// mm.
    off_mm: [f64; 2],
}

fn placement(frames: &[&Frame], object: &Object, resample: bool, warnings: &mut Vec<String>) -> SlicePlacement {
    let (first, last) = (frames[0], frames[frames.len() - 1]);
    let n = frames.len();
    let [columns, rows] = first.spacing;
    if columns == 0.0 {
        warnings.push("does not state its pixel spacing; 1 mm is assumed (use --spacing to set it)".into());
    }
    let (columns, rows) = (if columns > 0.0 { columns } else { 1.0 }, if rows > 0.0 { rows } else { 1.0 });
    let unit = normal(first);
    let stated = object.slice_spacing.unwrap_or(1.0);
    let start = first.position.unwrap_or(DVec3::ZERO);
    if !first.stated[1] && first.stated[0] {
        warnings.push("does not state its image orientation; its axes are assumed to be left and posterior".into());
    }
    if !first.stated[0] {
        warnings.push(
            "does not state its slice positions; slices are ordered by instance number, and their axes are assumed to be left, posterior, superior"
                .into(),
        );
    }
    let step = match (first.position, last.position) {
        (Some(a), Some(b)) if n > 1 && (b - a).dot(unit).abs() > SAME_PLACE => (b - a) / (n - 1) as f64,
        _ => unit * stated,
    };
    // Writers of segmentations omit empty slices.
    let mut step = step;
    if object.segmentation && n > 1 {
        let at: Vec<f64> = frames.iter().filter_map(|f| f.position).map(|p| (p - start).dot(unit)).collect();
        let least = at.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
        let count = at.last().map_or(0.0, |last| last / least);
        let whole = |a: &f64| (a / least - (a / least).round()).abs() < 0.05;
        if at.len() == n && least > SAME_PLACE && count < MAX_EMPTY_SLICES && at.iter().all(whole) {
            step = step * (n - 1) as f64 / count.round();
        }
    }
    let along: Vec<f64> = frames.iter().enumerate().map(|(k, f)| f.position.map_or(k as f64, |p| (p - start).dot(unit) / step.dot(unit))).collect();
    let gaps: Vec<f64> = along.windows(2).map(|w| (w[1] - w[0]) * step.dot(unit)).collect();
    let mm = step.dot(unit);
    let off_grid = |a: &f64| (a - a.round()).abs() * mm > UNEVEN[0].max(0.05 * mm);
    let uneven = if object.segmentation { along.iter().any(off_grid) } else { gaps.iter().any(|g| (g - mm).abs() > UNEVEN[0].max(UNEVEN[1] * mm)) };
    let off = along.iter().enumerate().map(|(k, a)| (a - k as f64).abs() * mm).fold(0.0, f64::max);
    if uneven {
        let mut by_size = gaps.clone();
        by_size.sort_by(f64::total_cmp);
        let usual = by_size[by_size.len() / 2];
        let place = |k: usize| format!("{:.2}", frames[k].position.map_or(0.0, |p| p.dot(unit)));
        // Gaps of an integer number of steps are missing slices, if all other gaps are even.
        let missing: Vec<usize> = (0..gaps.len()).filter(|&k| gaps[k] > 1.5 * usual).collect();
        let whole = |g: f64| (g / usual - (g / usual).round()).abs() < 0.05;
        let list = |ks: &[usize]| {
            let some: Vec<String> = ks.iter().take(MAX_NAMED_POSITIONS).map(|&k| format!("{} to {}", place(k), place(k + 1))).collect();
            if ks.len() > MAX_NAMED_POSITIONS { format!("{} and {} more", some.join(", "), ks.len() - MAX_NAMED_POSITIONS) } else { some.join(", ") }
        };
        if !missing.is_empty() && gaps.iter().all(|g| whole(*g)) {
            let count: f64 = missing.iter().map(|&k| (gaps[k] / usual).round() - 1.0).sum();
            warnings.push(format!(
                "{count} {} missing at {} mm along the normal (spacing {usual:.2} mm){}",
                if count == 1.0 { "slice is" } else { "slices are" },
                list(&missing),
                if resample { "" } else { "; the slices that are there are spread evenly over the gap" }
            ));
        } else {
            let odd: Vec<usize> = (0..gaps.len()).filter(|&k| (gaps[k] - usual).abs() > UNEVEN[0].max(UNEVEN[1] * usual)).collect();
            let instead = format!("; the mean spacing of {mm:.2} mm is used, which misplaces slices by up to {off:.2} mm");
            warnings.push(format!(
                "slice spacing varies from {:.2} to {:.2} mm (it differs from the usual {usual:.2} mm at {} mm along the normal){}",
                by_size[0],
                by_size[by_size.len() - 1],
                list(&odd),
                if resample { "" } else { &instead }
            ));
        }
    }
    // Slices that do not lie on one line.
    let aside = frames.iter().zip(&along).filter_map(|(f, a)| Some((f.position? - start - step * *a).length())).fold(0.0, f64::max);
    let is_aside = aside > 0.5 * columns.min(rows);
    if is_aside {
        warnings.push(format!("its slices are not aligned along one axis; they are offset by up to {aside:.2} mm"));
    }
    let matrix3 = DMat3::from_cols(first.along[0] * columns, first.along[1] * rows, step);
    let off_mm = [if uneven { off } else { 0.0 }, if is_aside { aside } else { 0.0 }];
    SlicePlacement { world_from_voxel: DAffine3 { matrix3, translation: start }, at: along, even: !uneven, off_mm }
}

/// The volume of a sorted set of frames.
fn volume(path: &Path, objects: &[Object], frames: &[Frame], choice: &ReadOptions, watch: &Watch, warnings: &mut Vec<String>) -> Result<Image> {
    let object = &objects[frames[0].object];
    for o in frames.iter().map(|f| f.object).collect::<std::collections::BTreeSet<_>>() {
        check_syntax(&objects[o])?;
    }
    // One frame per slice; for a segmentation, the slice of each frame.
    let mut slices: Vec<&Frame> = Vec::new();
    let mut slot: Vec<usize> = Vec::with_capacity(frames.len());
    for frame in frames {
        let same =
            |f: &&&Frame| object.segmentation && f.position.zip(frame.position).is_some_and(|(a, b)| (a - b).dot(normal(f)).abs() < SAME_PLACE);
        if slices.last().filter(same).is_none() {
            slices.push(frame);
        }
        slot.push(slices.len() - 1);
    }
    let placement = placement(&slices, object, choice.resample, warnings);
    let format = &object.format;
    let mut depth = slices.len();
    if object.segmentation && placement.even {
        slot.iter_mut().for_each(|s| *s = placement.at[*s].round() as usize);
        depth = slot.last().map_or(1, |s| s + 1);
    }
    let size = [usize::from(format.columns), usize::from(format.rows), depth];
    if !usable(&placement.world_from_voxel) {
        return Err(Error::file(path, "states positions or spacings that cannot be used; its header is damaged"));
    }
    let samples = usize::from(format.samples);
    let total = size.iter().product::<usize>().checked_mul(samples).ok_or_else(|| Error::file(path, "is larger than can be addressed"))?;
    check_pixels(path, objects, frames)?;
    let one_rescale = frames.iter().all(|f| f.rescale == frames[0].rescale);
    let job = DecodeJob { path, objects, frames, slot: &slot, total, watch };
    let mut rescale = if one_rescale { frames[0].rescale } else { Rescale::NONE };
    let palette = format.photometric == "PALETTE COLOR";
    let (voxels, components): (StoredValues, usize) = if object.segmentation {
        (job.labels(warnings)?, 1)
    } else if samples == 1 && !palette {
        let voxels = match (format.float, format.allocated, format.signed) {
            _ if !one_rescale => {
                warnings.push("its slices have different rescale slopes or intercepts; values are stored as 32-bit floats".into());
                job.scaled()?
            }
            (true, 32, _) => job.stored::<f32>()?.into(),
            (true, _, _) => job.stored::<f64>()?.into(),
            (_, 1 | 8, false) => job.stored::<u8>()?.into(),
            (_, 8, true) => job.stored::<i8>()?.into(),
            (_, 16, false) => job.stored::<u16>()?.into(),
            (_, 16, true) => job.stored::<i16>()?.into(),
            (_, _, false) => job.stored::<u32>()?.into(),
            (_, _, true) => job.stored::<i32>()?.into(),
        };
        (voxels, 1)
    } else {
        rescale = Rescale::NONE;
        (job.colors()?.into(), 3)
    };
    let mut image = Image::new("DICOM", voxels, size, placement.world_from_voxel);
    (image.components, image.rescale) = (components, rescale);
    image.inverted = format.photometric == "MONOCHROME1";
    image.padding = object.padding.filter(|_| components == 1 && one_rescale);
    if object.segmentation {
        image.meaning = Meaning::Labels(object.segments.clone());
    } else if components > 1 {
        image.meaning = Meaning::Color;
    }
    if !placement.even {
        image.details.push(("slice_positions_mm", positions(&slices)));
        if choice.resample {
            evened(path, &mut image, &placement, warnings)?;
        }
    }
    let [along, aside] = placement.off_mm;
    let along = if choice.resample { 0.0 } else { along };
    if along.max(aside) > 0.0 {
        image.misplaced = Some(SliceDisplacement { by_mm: along.max(aside), resampling_helps: along > 0.0 && components == 1 });
    }
    Ok(image)
}

fn positions(slices: &[&Frame]) -> Value {
    json!(slices.iter().map(|f| f.position.map(|p| (p.dot(normal(f)) * 1e4).round() / 1e4)).collect::<Vec<_>>())
}

/// Rejects, before anything is allocated, frames that the files cannot contain.
fn check_pixels(path: &Path, objects: &[Object], frames: &[Frame]) -> Result<()> {
    let mut needed: HashMap<usize, usize> = HashMap::new();
    for frame in frames {
        *needed.entry(frame.object).or_default() += objects[frame.object].format.frame_bytes();
    }
    for (object, bytes) in needed {
        let object = &objects[object];
        let ratio = max_compression_ratio(&object.syntax, object.format.frame_bytes());
        // Single bits are not padded to bytes between frames.
        let bytes = if object.format.allocated == 1 { bytes.saturating_sub(frames.len()) } else { bytes };
        let most = object.source.bytes().saturating_mul(ratio);
        if bytes as u64 > most {
            let named = if path.is_dir() { object.source.path() } else { path };
            return Err(Error::file(named, "declares more pixels than it can hold: it is truncated or damaged; copy or export it again"));
        }
    }
    Ok(())
}

/// Frames to decode into one array.
struct DecodeJob<'a> {
    path: &'a Path,
    objects: &'a [Object],
    frames: &'a [Frame],
    slot: &'a [usize],
    /// Number of values in the whole volume.
    total: usize,
    watch: &'a Watch<'a>,
}

impl DecodeJob<'_> {
    fn format(&self) -> &PixelFormat {
        &self.objects[self.frames[0].object].format
    }

    /// Decodes every frame into its slice.
    fn run<T: Pixel>(&self, convert: &(dyn Fn(&Frame, T) -> T + Sync)) -> Result<Vec<T>> {
        let mut values: Vec<T> = zeroed(self.path, self.total)?;
        let plane = self.format().values();
        let meter = ByteProgress::new(self.watch, (self.frames.len() * plane * size_of::<T>()) as u64);
        // The frames and output of each object.
        let mut jobs: HashMap<usize, Vec<(&Frame, &mut [T])>> = HashMap::new();
        for (frame, out) in self.frames.iter().zip(values.chunks_mut(plane)) {
            jobs.entry(frame.object).or_default().push((frame, out));
        }
        jobs.into_iter().collect::<Vec<_>>().into_par_iter().try_for_each(|(index, frames)| -> Result<()> {
            let object = &self.objects[index];
            let pixels = pixels::read(object)?;
            frames.into_par_iter().try_for_each(|(frame, out)| {
                decode(object, &pixels, frame, out, &|v| convert(frame, v))?;
                meter.add(size_of_val(out) as u64)
            })
        })?;
        Ok(values)
    }

    fn stored<T: Pixel>(&self) -> Result<Vec<T>> {
        self.run::<T>(&|_, v| v)
    }

    /// Data values, where frames have different rescales.
    fn scaled(&self) -> Result<StoredValues> {
        let value = |frame: &Frame, v: f32| {
            let nothing = self.objects[frame.object].padding.is_some_and(|[low, high]| (low..=high).contains(&f64::from(v)));
            if nothing { f32::NAN } else { (f64::from(v) * frame.rescale.slope + frame.rescale.intercept) as f32 }
        };
        Ok(self.run::<f32>(&value)?.into())
    }

    /// Red, green and blue with 8 bits each.
    fn colors(&self) -> Result<Vec<u8>> {
        let format = self.format();
        let object = &self.objects[self.frames[0].object];
        if format.photometric == "PALETTE COLOR" {
            let tables =
                object.palette.as_ref().ok_or_else(|| Error::file(self.path, "uses palette colour but contains no palette; export it again"))?;
            let indices = self.run::<u16>(&|_, v| v)?;
            return Ok(indices
                .into_par_iter()
                .flat_map_iter(|v| tables.iter().map(move |(first, table)| table[(i64::from(v) - first).clamp(0, table.len() as i64 - 1) as usize]))
                .collect());
        }
        if format.samples != 3 || format.allocated != 8 {
            let (samples, bits) = (format.samples, format.allocated);
            return Err(Error::file(self.path, format!("has {samples} samples of {bits} bits per pixel; only 3 samples of 8 bits are supported")));
        }
        if format.photometric.starts_with("YBR_FULL_422") && self.uncompressed() {
            return Err(Error::file(self.path, "uses uncompressed chroma-subsampled colour (YBR_FULL_422); convert it to RGB"));
        }
        let mut values = self.run::<u8>(&|_, v| v)?;
        // Decoders of JPEG and JPEG 2000 return RGB.
        if format.photometric.starts_with("YBR_FULL") && (self.uncompressed() || AS_STORED.contains(&object.syntax.as_str())) {
            values.par_chunks_exact_mut(3).for_each(|v| {
                let [y, b, r] = [f32::from(v[0]), f32::from(v[1]) - 128.0, f32::from(v[2]) - 128.0];
                let rgb = [y + 1.402 * r, y - 0.344_136 * b - 0.714_136 * r, y + 1.772 * b];
                v.copy_from_slice(&rgb.map(|c| (c + 0.5).clamp(0.0, 255.0) as u8));
            });
        }
        Ok(values)
    }

    fn uncompressed(&self) -> bool {
        matches!(
            self.objects[self.frames[0].object].syntax.as_str(),
            "1.2.840.10008.1.2" | "1.2.840.10008.1.2.1" | "1.2.840.10008.1.2.2" | "1.2.840.10008.1.2.1.99"
        )
    }

    /// Segments as labels; where several overlap, the last one wins.
    fn labels(&self, warnings: &mut Vec<String>) -> Result<StoredValues> {
        let format = self.format();
        let plane = format.values();
        let mut labels: Vec<u16> = zeroed(self.path, self.total)?;
        let mut by_object: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (n, frame) in self.frames.iter().enumerate() {
            by_object.entry(frame.object).or_default().push(n);
        }
        let meter = ByteProgress::new(self.watch, (self.frames.len() * plane) as u64);
        let mut overlaps = 0usize;
        for (index, frames) in by_object {
            let object = &self.objects[index];
            let pixels = pixels::read(object)?;
            let mut values: Vec<u16> = zeroed(self.path, plane)?;
            for n in frames {
                let frame = &self.frames[n];
                decode(object, &pixels, frame, &mut values, &|v| v)?;
                let out = &mut labels[self.slot[n] * plane..][..plane];
                for (label, &value) in out.iter_mut().zip(&values) {
                    // Pixels are labels themselves, or fractions of the frame's segment, with a
                    // threshold of one half.
                    match object.segments_as {
                        SegmentsAs::Labels => *label = value,
                        SegmentsAs::Shares(whole) if value > 0 && 2 * u32::from(value) >= u32::from(whole) => {
                            overlaps += usize::from(*label != 0 && *label != frame.segment);
                            *label = frame.segment;
                        }
                        SegmentsAs::Shares(_) => {}
                    }
                }
                meter.add(plane as u64)?;
            }
        }
        if overlaps > 0 {
            warnings.push(format!("its segments overlap in {overlaps} voxels; the last segment is used there"));
        }
        Ok(if labels.iter().all(|l| *l < 256) { labels.into_iter().map(|l| l as u8).collect::<Vec<u8>>().into() } else { labels.into() })
    }
}

/// Interpolates unevenly spaced slices onto an even grid of the usual step.
fn evened(path: &Path, image: &mut Image, placement: &SlicePlacement, warnings: &mut Vec<String>) -> Result<()> {
    if image.components > 1 {
        return Err(Error::file(path, "is a colour image; its slices cannot be resampled"));
    }
    let at = &placement.at;
    let mut gaps: Vec<f64> = at.windows(2).map(|w| w[1] - w[0]).collect();
    gaps.sort_by(f64::total_cmp);
    let step = gaps[gaps.len() / 2].max((at.len() - 1) as f64 / (MAX_RESAMPLING_FACTOR * at.len() as f64));
    let count = ((at.len() - 1) as f64 / step).round() as usize + 1;
    let step = (at.len() - 1) as f64 / (count - 1) as f64;
    let (labels, padding) = (matches!(image.meaning, Meaning::Labels(_)), image.padding);
    // Two slices, and the position between them.
    let between: Vec<(usize, f64)> = (0..count)
        .map(|k| {
            let position = k as f64 * step;
            let above = at.partition_point(|a| *a <= position).clamp(1, at.len() - 1);
            (above - 1, ((position - at[above - 1]) / (at[above] - at[above - 1])).clamp(0.0, 1.0))
        })
        .collect();
    let nothing = |v: f64| padding.is_some_and(|[low, high]| (low..=high).contains(&v));
    // Labels are not interpolated, nor are padding and values.
    let voxels = Voxels::new(image.size, image.voxels.clone()).interpolated_layers(&between, |a, b| labels || nothing(a) || nothing(b));
    image.voxels = voxels.reshaped(count * image.size[0] * image.size[1]);
    image.size[2] = count;
    image.world_from_voxel.matrix3.z_axis *= step;
    warnings.push(format!("its {} slices were interpolated to {count}, {:.2} mm apart", at.len(), image.world_from_voxel.matrix3.z_axis.length()));
    Ok(())
}
