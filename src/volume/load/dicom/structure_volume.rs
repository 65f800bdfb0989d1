//! The volume of a structure set: its structures as labels on the grid of the image on which they
//! are drawn, or on a grid of their own where there is no such image.

use super::super::ReadOptions;
use super::super::image::{Image, Meaning};
use super::super::source::usable;
use super::dataset::header;
use super::frame::Frame;
use super::object::Object;
use super::placement::{SlicePlacement, placement};
use super::rasterise::{LabelMap, doubled_area, label_map};
use super::scan::scan;
use super::series::{DicomSeries, described, series};
use super::structures::{Structure, StructureSet, named, structures};
use super::volume::check_objects;
use crate::panic_guard::catch_panic;
use crate::volume::{Label, SliceDisplacement};
use crate::{Error, Result, Watch};
use glam::{DAffine3, DMat3, DVec3};
use serde_json::json;
use std::collections::HashSet;
use std::path::Path;

/// Pixels of a grid made from the contours: 1 mm, or finer, so that this many fit along the
/// contours' longest side.
const OWN_PIXELS: f64 = 128.0;
/// Smallest voxel of such a grid, and its largest number of voxels along an axis and altogether.
const MIN_OWN_MM: f64 = 1e-3;
const MAX_OWN_EXTENT: f64 = 2048.0;
const MAX_OWN_VOXELS: f64 = (1u64 << 24) as f64;

/// The grid of an image.
struct ImageGrid {
    size: [usize; 3],
    world_from_voxel: DAffine3,
    /// Position of every slice, in slices of the even grid, if they are not even.
    at: Option<Vec<f64>>,
    misplaced: Option<SliceDisplacement>,
    /// The series that it comes from.
    uid: String,
}

/// A structure set as a label map. `objects` and `all` are what was found in the same place.
///
/// # Errors
/// A structure set without closed contours, or one that cannot be read; not enough memory.
pub fn structure_volume(
    path: &Path,
    object: &Object,
    (objects, all): (&[Object], &[DicomSeries]),
    choice: &ReadOptions,
    watch: &Watch,
    warnings: &mut Vec<String>,
) -> Result<Image> {
    let named_file = if path.is_dir() { object.source.path() } else { path };
    let damaged = || Error::file(named_file, "is a damaged DICOM file; copy or export it again");
    let (_, data) = catch_panic(|| header(&object.source)).ok_or_else(damaged)??;
    let mut set = structures(&data.elements).map_err(|e| Error::file(named_file, e))?;
    warnings.append(&mut set.notes);
    let mut grid = image_grid(path, &set, objects, all, choice, warnings)?;
    if grid.is_none() && path.is_file() {
        // The image lies beside the structure set.
        let folder = path
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        match scan(
            folder,
            &Watch {
                progress: &|_| (),
                ..*watch
            },
        ) {
            Ok(found) => {
                let all = series(&found.objects);
                grid = image_grid(folder, &set, &found.objects, &all, choice, warnings)?;
            }
            Err(Error::Cancelled) => return Err(Error::Cancelled),
            // A folder that cannot be searched contains no image.
            Err(_) => {}
        }
    }
    let grid = match grid {
        Some(grid) => grid,
        None => own_grid(&set, warnings),
    };
    let beyond = beyond(&set.structures, &grid);
    if !beyond.is_empty() {
        warnings.push(format!(
            "contours of {} lie partly outside of the image; what is outside is left out",
            named(&beyond)
        ));
    }
    if let Some(at) = &grid.at {
        straighten(&mut set.structures, &grid.world_from_voxel, at);
    }
    let map = label_map(path, &set.structures, grid.size, &grid.world_from_voxel, watch)?;
    warn(&map, &set.structures, warnings);
    let mut image = Image::new("DICOM", map.values, grid.size, grid.world_from_voxel);
    image.misplaced = grid.misplaced;
    if !grid.uid.is_empty() {
        image.details.push(("image_series", json!(grid.uid)));
    }
    let counts: serde_json::Map<String, serde_json::Value> = set
        .structures
        .iter()
        .zip(&map.voxels)
        .map(|(s, [_, shown])| (s.number.to_string(), json!(shown)))
        .collect();
    image.details.push(("label_voxels", json!(counts)));
    image.meaning = Meaning::Labels(
        set.structures
            .into_iter()
            .map(|s| Label {
                value: s.number,
                name: s.name,
                color: s.color,
            })
            .collect(),
    );
    Ok(image)
}

/// The series on which a structure set is drawn: the one with most of the images to which it
/// refers, the series to which it refers, or the largest in its frame of reference. And whether
/// it refers to it.
fn image_series<'a>(
    set: &StructureSet,
    objects: &[Object],
    all: &'a [DicomSeries],
) -> Option<(&'a DicomSeries, bool)> {
    let is_image = |s: &&DicomSeries| {
        let frames = &s.times[0];
        !frames.is_empty() && frames.iter().all(|f| f.position.is_some())
    };
    let images = |s: &DicomSeries| {
        let own: HashSet<usize> = s.times.iter().flatten().map(|f| f.object).collect();
        own.into_iter()
            .filter(|o| set.images.contains(&objects[*o].instance))
            .count()
    };
    // Among equals, the first, which is the largest.
    let most = all.iter().filter(is_image).rev().max_by_key(|s| images(s));
    if let Some(found) = most.filter(|s| images(s) > 0) {
        return Some((found, true));
    }
    let is_referred_to = |s: &&DicomSeries| set.series.contains(&objects[s.object].series);
    if let Some(found) = all.iter().filter(is_image).find(is_referred_to) {
        return Some((found, true));
    }
    let shares_frame = |s: &&DicomSeries| {
        let object = &objects[s.object];
        !object.segmentation && set.frames_of_reference.contains(&object.reference)
    };
    all.iter()
        .filter(is_image)
        .find(shares_frame)
        .map(|found| (found, false))
}

/// The grid of the image on which a structure set is drawn, if it is there.
fn image_grid(
    path: &Path,
    set: &StructureSet,
    objects: &[Object],
    all: &[DicomSeries],
    choice: &ReadOptions,
    warnings: &mut Vec<String>,
) -> Result<Option<ImageGrid>> {
    let Some((found, is_referred_to)) = image_series(set, objects, all) else {
        return Ok(None);
    };
    let object = &objects[found.object];
    let frames = &found.times[0];
    check_objects(path, objects, frames)?;
    if !is_referred_to {
        warnings.push(format!(
            "refers to images that are not there; its structures are shown on another series with the same frame of reference ({})",
            described(found, objects)
        ));
    }
    let refs: Vec<&Frame> = frames.iter().collect();
    let mut notes = Vec::new();
    let placed = placement(&refs, object, choice.resample, &mut notes);
    let resampled_count = placed.resampled_count();
    let SlicePlacement {
        mut world_from_voxel,
        at,
        even,
        deviation_mm: [along, aside],
    } = placed;
    warnings.extend(notes.into_iter().map(|n| format!("images it is drawn on: {n}")));
    if !usable(&world_from_voxel) {
        return Ok(None);
    }
    let [columns, rows] = object.plane();
    let mut size = [columns, rows, refs.len()];
    let is_resampled = choice.resample && !even && at.len() > 1;
    if is_resampled {
        size[2] = resampled_count;
        world_from_voxel.matrix3.z_axis *= (at.len() - 1) as f64 / (size[2] - 1) as f64;
    }
    let along = if is_resampled { 0.0 } else { along };
    let by_mm = along.max(aside);
    Ok(Some(ImageGrid {
        size,
        world_from_voxel,
        at: (!even && !is_resampled).then_some(at),
        misplaced: (by_mm > 0.0).then_some(SliceDisplacement {
            by_mm,
            resampling_helps: along > 0.0,
        }),
        uid: object.series.clone(),
    }))
}

/// Names of structures with contours that lie partly outside of a grid's voxels.
fn beyond(structures: &[Structure], grid: &ImageGrid) -> Vec<String> {
    let voxel_from_world = grid.world_from_voxel.inverse();
    let size = DVec3::from(grid.size.map(|n| n as f64));
    let is_outside = |p: &DVec3| {
        let voxel = voxel_from_world.transform_point3(*p);
        voxel.cmplt(DVec3::splat(-0.75)).any() || voxel.cmpgt(size - 0.25).any()
    };
    let lies_beyond = |s: &&Structure| s.contours.iter().flatten().any(is_outside);
    structures
        .iter()
        .filter(lies_beyond)
        .map(|s| s.name.clone())
        .collect()
}

/// Moves contours along with the slices of an image that are not even: from their positions to
/// those at which they are shown.
fn straighten(structures: &mut [Structure], world_from_voxel: &DAffine3, at: &[f64]) {
    let voxel_from_world = world_from_voxel.inverse();
    let index = |z: f64| {
        let n = at.partition_point(|a| *a <= z).clamp(1, at.len() - 1);
        let (before, after) = (at[n - 1], at[n]);
        (n - 1) as f64 + (z - before) / (after - before)
    };
    if at.len() < 2 || at.windows(2).any(|w| w[1] <= w[0]) {
        return;
    }
    for corner in structures.iter_mut().flat_map(|s| &mut s.contours).flatten() {
        let mut voxel = voxel_from_world.transform_point3(*corner);
        voxel.z = index(voxel.z);
        *corner = world_from_voxel.transform_point3(voxel);
    }
}

/// A grid around the contours: slices in the planes of most of them.
fn own_grid(set: &StructureSet, warnings: &mut Vec<String>) -> ImageGrid {
    let contours = || set.structures.iter().flat_map(|s| &s.contours);
    let largest = contours()
        .map(|c| doubled_area(c))
        .max_by(|a, b| a.length().total_cmp(&b.length()))
        .unwrap_or(DVec3::Z);
    let directions = directions(largest);
    let local = |p: &DVec3| directions.transpose() * *p;
    let (mut low, mut high) = (DVec3::splat(f64::INFINITY), DVec3::splat(f64::NEG_INFINITY));
    for p in contours().flatten().map(local) {
        (low, high) = (low.min(p), high.max(p));
    }
    let extent = high - low;
    let mut gaps: Vec<f64> = Vec::new();
    for structure in &set.structures {
        let mut planes: Vec<f64> = structure
            .contours
            .iter()
            .map(|c| c.iter().map(|p| local(p).z).sum::<f64>() / c.len() as f64)
            .collect();
        planes.sort_by(f64::total_cmp);
        gaps.extend(planes.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > 0.01));
    }
    gaps.sort_by(f64::total_cmp);
    let plane_mm = gaps.get(gaps.len().saturating_sub(1) / 2).copied();
    let pixel = (extent.x.max(extent.y) / OWN_PIXELS).clamp(MIN_OWN_MM, 1.0);
    let mut spacing = DVec3::new(pixel, pixel, plane_mm.unwrap_or(pixel).max(MIN_OWN_MM));
    // Voxels grow where there would be too many.
    spacing = spacing.max(extent / MAX_OWN_EXTENT);
    let count = |spacing: DVec3| (extent / spacing + 1e-6).floor() + DVec3::new(4.0, 4.0, 1.0);
    while count(spacing).element_product() > MAX_OWN_VOXELS {
        spacing *= 1.25;
    }
    // One pixel more around the contours.
    let origin = low - spacing * DVec3::new(1.0, 1.0, 0.0);
    let size = count(spacing).to_array().map(|n| n as usize);
    warnings.push(format!(
        "its images are not beside it; its structures are shown on a grid of {} x {} x {} voxels of {} x {} x {} mm made for them (put the images in the same folder, or open the folder of both with --series)",
        size[0],
        size[1],
        size[2],
        short(spacing.x),
        short(spacing.y),
        short(spacing.z)
    ));
    ImageGrid {
        size,
        world_from_voxel: DAffine3 {
            matrix3: directions * DMat3::from_diagonal(spacing),
            translation: directions * origin,
        },
        at: None,
        misplaced: None,
        uid: String::new(),
    }
}

/// Axes of a grid whose slices have a given normal: as close to left, posterior and superior as
/// possible.
fn directions(normal: DVec3) -> DMat3 {
    let normal = normal.normalize_or(DVec3::Z);
    let main = normal.abs().max_element();
    // Exactly along an axis, if it is that but for rounding.
    let snapped = DVec3::from_array(normal.to_array().map(|v| if v.abs() < 1e-4 { 0.0 } else { v }));
    let normal = snapped.normalize_or(DVec3::Z);
    let (normal, along) = if normal.z.abs() == main || normal.z.abs() > 0.9 {
        (normal * normal.z.signum(), DVec3::X)
    } else if normal.y.abs() >= normal.x.abs() {
        (normal * normal.y.signum(), DVec3::X)
    } else {
        (normal * normal.x.signum(), DVec3::Y)
    };
    let x = (along - normal * along.dot(normal)).normalize_or(DVec3::X);
    DMat3::from_cols(x, normal.cross(x), normal)
}

/// A number with few digits.
fn short(v: f64) -> String {
    let text = format!("{v:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// What a label map does not show.
fn warn(map: &LabelMap, structures: &[Structure], warnings: &mut Vec<String>) {
    let names = |of: &dyn Fn(&[usize; 2]) -> bool| -> Vec<String> {
        structures
            .iter()
            .zip(&map.voxels)
            .filter(|(_, v)| of(v))
            .map(|(s, _)| s.name.clone())
            .collect()
    };
    let numbered = |of: &[usize]| -> Vec<String> { of.iter().map(|n| structures[*n].name.clone()).collect() };
    if map.overlaps > 0 {
        warnings.push(format!(
            "its structures overlap in {} voxels; the smaller structure is used there",
            map.overlaps
        ));
    }
    let empty = names(&|[all, _]| *all == 0);
    if !empty.is_empty() {
        warnings.push(format!(
            "nothing is shown of {}: no voxel centre lies inside (outside the image, or between voxel centres)",
            named(&empty)
        ));
    }
    let hidden = names(&|[all, shown]| *all > 0 && *shown == 0);
    if !hidden.is_empty() {
        warnings.push(format!(
            "nothing is shown of {}: other structures cover it",
            named(&hidden)
        ));
    }
    if !map.interpolated.is_empty() {
        warnings.push(format!(
            "has no contours on some slices within {}; they are interpolated from the contours before and after",
            named(&numbered(&map.interpolated))
        ));
    }
    if !map.gaps.is_empty() {
        warnings.push(format!(
            "has slices without contours within {}; they are left empty",
            named(&numbered(&map.gaps))
        ));
    }
    if !map.left_out.is_empty() {
        warnings.push(format!(
            "contours of {} are drawn in too many directions; some are left out",
            named(&numbered(&map.left_out))
        ));
    }
}
