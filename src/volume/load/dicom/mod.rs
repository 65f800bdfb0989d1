//! DICOM: the series in a file, a folder or a zip, sorted into volumes.
//!
//! Frames belong together by series, orientation, size and spacing. They are sorted by their
//! position along the slice normal, never by instance number. Frames at the same position belong to
//! volumes of different times, echoes or phases, told apart by the attributes that differ. Every
//! frame has its own geometry, rescale, padding and palette. A gantry tilt is a shear of the voxel
//! axes. Uneven spacing and missing slices are reported with their positions, and resampled only on
//! request.
//!
//! A structure set has contours instead of frames; it is a series of its own, read as a label map.
//!
//! Source: DICOM PS3.3 C.7.6.2 (image plane), C.7.6.16 (functional groups), C.8.20 (segmentation).

mod attributes;
mod characters;
mod contour_plane;
mod contour_stack;
mod dataset;
mod divider;
mod element;
mod elements;
mod frame;
mod frames;
mod increments;
mod location;
mod mosaic;
mod object;
mod origin;
mod palette;
mod pixels;
mod placement;
mod rasterise;
mod rle;
mod scan;
mod segments;
mod series;
mod siblings;
mod structure_volume;
mod structures;
mod syntax;
mod time_keys;
mod times;
mod values;
mod volume;

pub use dataset::is_dicom;
pub use origin::{Origin, OriginInstance};

use super::ReadOptions;
use super::image::Image;
use crate::{Error, Result, Watch};
use frame::Frame;
use object::Object;
use scan::{ScanResult, scan};
use serde_json::json;
use series::{DicomSeries, MAX_NAMED_POSITIONS, chosen, described, places, series};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use structure_volume::structure_volume;
use syntax::syntax_name;
use times::Certainty;
use volume::volume;

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
    Ok(all
        .iter()
        .enumerate()
        .map(|(n, s)| info(n, s, &found.objects, patient))
        .collect())
}

fn info(n: usize, series: &DicomSeries, objects: &[Object], patient: bool) -> SeriesInfo {
    let object = &objects[series.object];
    let [columns, rows] = object.plane();
    SeriesInfo {
        number: n + 1,
        series_number: object.series_number,
        description: object.description.clone(),
        modality: object.modality.clone(),
        size: [columns, rows, places(&series.times[0]).len()],
        time_points: series.times.len(),
        uid: object.series.clone(),
        patient: patient.then(|| object.patient.clone()),
    }
}

/// The message where there are no pixels.
fn nothing(path: &Path, found: ScanResult) -> Error {
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
    Ok(found.objects.iter().any(|o| !o.is_structure_set()) || found.complaint.is_some())
}

/// Reads one series.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    // Scanning headers counts as a tenth of the time.
    let scanning = |share: f32| (watch.progress)(0.1 * share);
    let found = scan(
        path,
        &Watch {
            progress: &scanning,
            cancel: watch.cancel,
        },
    )?;
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
            described(series, &found.objects)
        ));
    }
    warnings.extend(found.notes.iter().cloned());
    if found.damaged > 0 {
        let first = found
            .complaint
            .as_ref()
            .map(ToString::to_string)
            .unwrap_or_default();
        let files = if found.damaged == 1 {
            "file is"
        } else {
            "files are"
        };
        warnings.push(format!("{} damaged {files} left out ({first})", found.damaged));
    }
    let time = choice.time_of(series.times.len())?;
    warn_of_frames(series, &found.objects, choice, &mut warnings);
    warnings.extend(siblings::warning(path, &found.objects, series));
    let reading = |share: f32| (watch.progress)(0.1 + 0.9 * share);
    let watch = Watch {
        progress: &reading,
        cancel: watch.cancel,
    };
    let object = &found.objects[series.object];
    let mut image = if object.is_structure_set() {
        let others = (found.objects.as_slice(), all.as_slice());
        structure_volume(path, object, others, choice, &watch, &mut warnings)?
    } else {
        let frames = &series.times[time];
        volume(path, &found.objects, frames, choice, &watch, &mut warnings)?
    };
    image.details.extend([
        ("modality", json!(object.modality)),
        ("series", json!({ "number": index + 1, "of": all.len(), "uid": object.series, "description": object.description })),
        ("transfer_syntax", json!(syntax_name(&object.syntax))),
    ]);
    if !object.units.is_empty() {
        image.details.push(("units", json!(object.units)));
    }
    // Windows of slices may differ.
    let frames = &series.times[time];
    let of_frame = |f: &Frame| found.objects[f.object].window;
    if let Some(Some([center, width])) = frames.first().map(of_frame)
        && frames.iter().all(|f| of_frame(f) == Some([center, width]))
    {
        image
            .details
            .push(("window", json!({ "center": center, "width": width })));
    }
    if series.times.len() > 1 {
        image.details.push(("time_points", json!(series.times.len())));
        image
            .details
            .extend(series.by.json().map(|times| ("times", times)));
    }
    image.warnings = warnings;
    Ok(image)
}

/// Warns of frames that share positions, and of several frames of reference.
fn warn_of_frames(
    series: &DicomSeries,
    objects: &[Object],
    choice: &ReadOptions,
    warnings: &mut Vec<String>,
) {
    if series.duplicates > 0 {
        warnings.push(match series.duplicates {
            1 => "1 slice at the same position as another was skipped".into(),
            n => format!("{n} slices at the same position as another were skipped"),
        });
    }
    let count = series.times.len();
    if count > 1 && choice.time.is_none() {
        let by = series
            .by
            .described()
            .map_or(String::new(), |by| format!(", told apart by {by}"));
        warnings.push(format!(
            "holds {count} volumes at the same place{by}; the first is used (--time chooses another)"
        ));
    }
    match series.certainty {
        Certainty::Certain => {}
        Certainty::ByInstance => warnings.push(
            "holds slices at the same position that differ only in instance number; they are divided by it, and a volume may mix times or echoes".into(),
        ),
        Certainty::Ambiguous => warnings.push(
            "holds slices at the same position that no attribute tells apart; they are ordered by instance number and file name, and a volume may mix times or echoes".into(),
        ),
    }
    if series.unplaced > 0 {
        warnings.push(match series.unplaced {
            1 => "1 slice does not state its position and is left out".into(),
            n => format!("{n} slices do not state their positions and are left out"),
        });
    }
    let counts: Vec<usize> = series.times.iter().map(Vec::len).collect();
    if counts.iter().any(|c| *c != counts[0]) {
        let some: Vec<String> = counts
            .iter()
            .take(MAX_NAMED_POSITIONS)
            .map(usize::to_string)
            .collect();
        let more = if counts.len() > MAX_NAMED_POSITIONS {
            ", ..."
        } else {
            ""
        };
        warnings.push(format!(
            "its volumes have different numbers of slices: {}{more}",
            some.join(", ")
        ));
    }
    warnings.extend(missing_part(series, objects));
    let references: BTreeSet<&str> = series
        .times
        .iter()
        .flatten()
        .map(|f| objects[f.object].reference.as_str())
        .filter(|r| !r.is_empty())
        .collect();
    if references.len() > 1 {
        warnings.push(format!(
            "has {} frames of reference; the positions of its slices may not belong together",
            references.len()
        ));
    }
}

/// The warning if a part of a concatenation is missing (PS3.3 C.7.6.16.2.2.4).
fn missing_part(series: &DicomSeries, objects: &[Object]) -> Option<String> {
    let mut parts: BTreeMap<&str, (BTreeSet<u32>, u32)> = BTreeMap::new();
    for frame in series.times.iter().flatten() {
        if let Some((uid, number, total)) = &objects[frame.object].concatenation {
            let part = parts.entry(uid).or_insert((BTreeSet::new(), *total));
            part.0.insert(*number);
        }
    }
    let (there, total) = parts
        .into_values()
        .find(|(there, total)| (there.len() as u32) < *total)?;
    Some(format!(
        "holds {} of the {total} parts of one image; the others are missing or in other files",
        there.len()
    ))
}
