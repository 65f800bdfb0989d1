//! TIFF and BigTIFF: pages are slices, or slices, channels and times if OME-XML or ImageJ metadata
//! declare them.
//!
//! Source: OME-TIFF specification 6 (PhysicalSize, DimensionOrder); ImageJ's own description
//! (`images=`, `slices=`, `spacing=`, `unit=`). ImageJ files of more than 4 GiB have a single
//! directory, followed by all slices.

mod description;
mod pages;

pub(super) use description::mm_of;
pub(super) use pages::first_page;

use super::ReadOptions;
use super::image::Image;
use crate::panic_guard::catch_panic;
use crate::{Error, Result, Watch};
use description::described;
use glam::{DAffine3, DVec3};
use pages::{Dimensions, Pages, decoder};
use serde_json::json;
use std::path::Path;

/// Whether a file has the extension of a TIFF.
pub fn is_tiff(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff"))
}

/// The spacing stated by a file, mm along x, y, z.
pub(super) fn spacing(path: &Path) -> Option<[Option<f64>; 3]> {
    catch_panic(|| {
        decoder(path)
            .ok()
            .map(|(mut pages, bytes)| described(&mut pages, bytes).spacing)
    })?
}

/// Reads all pages.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let ended = || Error::file(path, "its pages are damaged; copy or export it again");
    catch_panic(|| read_unguarded(path, choice, watch)).ok_or_else(ended)?
}

/// Reads all pages; [`read`] turns a panic of the decoder into an error.
fn read_unguarded(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let (mut decoder, file_bytes) = decoder(path)?;
    let metadata = described(&mut decoder, file_bytes);
    let mut pages = Pages {
        path,
        decoder,
        file_bytes,
        watch,
    };
    let mut warnings = Vec::new();
    if metadata.imagej && !metadata.has_unit && metadata.spacing.iter().any(Option::is_some) {
        warnings.push("states its spacing without a unit; mm is assumed".into());
    }
    let total = pages.count()?;
    let [slices, channels, times] = metadata.extents_of(total, &mut warnings);
    let time = choice.time_of(times)?;
    if times > 1 && choice.time.is_none() {
        warnings.push(format!(
            "holds {times} volumes; the first is used (--time chooses another)"
        ));
    }
    let dimensions = Dimensions {
        extents: [slices, channels, times],
        order: metadata.order,
        time,
    };
    let pixels = if total == 1 && slices * channels * times > 1 {
        pages.read_contiguous(&dimensions)?
    } else {
        pages.read_each(&dimensions, &mut warnings)?
    };
    let spacing = metadata.spacing.map(|s| s.filter(|s| s.is_finite() && *s > 0.0));
    if choice.spacing.is_none() && spacing.iter().any(Option::is_none) {
        warnings.push("does not state voxel spacing in every direction; 1 mm is assumed where it is missing (use --spacing to set it)".into());
    }
    let world_from_voxel = DAffine3::from_scale(DVec3::from(spacing.map(|s| s.unwrap_or(1.0))));
    let mut image = Image::new(metadata.format(), pixels.voxels, pixels.size, world_from_voxel);
    (image.components, image.layout, image.warnings) = (pixels.components, pixels.layout, warnings);
    image.meaning = metadata.meaning(channels, pixels.components);
    if times > 1 {
        image.details.push(("time_points", json!(times)));
    }
    Ok(image)
}
