//! TIFF and BigTIFF: pages are slices, or slices, channels and times if OME-XML, ImageJ, tifffile,
//! Zeiss LSM or MetaMorph STK metadata declare them. An OME-TIFF of several files is read from any
//! of them.
//!
//! The reader is our own down to the strips: a scientific file has values, not colours to show, and
//! the crate `tiff` turns WhiteIsZero round, refuses colour tables, and cannot read samples of 12
//! bits or planes of their own. `page.rs` says what is done with values, `codec.rs` which
//! compressions are read, `description.rs` where geometry comes from.
//!
//! Source: TIFF 6.0; OME-TIFF specification 6 (PhysicalSize, DimensionOrder, TiffData).

mod codec;
mod color;
mod description;
mod directory;
mod fax;
mod metadata;
mod ome;
mod page;
mod pages;
mod samples;

pub(super) use metadata::mm_of;

use super::ReadOptions;
use super::image::Image;
use super::planes::StatedSlice;
use crate::panic_guard::catch_panic;
use crate::{Error, Result, Watch};
use description::described;
use directory::TiffReader;
use glam::{DAffine3, DVec3};
use page::PageFormat;
use pages::{Dimensions, Pages};
use serde_json::json;
use std::path::Path;

/// Whether a file has the extension of a TIFF.
pub fn is_tiff(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff"))
}

/// The only page of a file.
pub(super) fn single_page(path: &Path) -> Result<StatedSlice> {
    let ended = || Error::file(path, "its pixels are damaged; copy or export it again");
    catch_panic(|| {
        let (mut file, directories) = TiffReader::open(path)?;
        let (page, format, slice) = pages::single_page(&mut file, &directories)?;
        let metadata = described(&mut file, &directories)?;
        let mut notices = format.notices(&mut file, &directories[page])?;
        notices.extend(metadata.unused_resolution);
        Ok(StatedSlice {
            slice,
            is_color: format.is_color(),
            is_inverted: format.photometric == page::Photometric::WhiteIsZero,
            spacing: metadata.spacing,
            notices,
        })
    })
    .ok_or_else(ended)?
}

/// Whether a file is one of several that hold one image.
pub(super) fn is_part_of_image(path: &Path) -> bool {
    catch_panic(|| {
        let (mut file, directories) = TiffReader::open(path).ok()?;
        let metadata = described(&mut file, &directories).ok()?;
        Some(pages::spans_files(&metadata))
    })
    .flatten()
    .unwrap_or(false)
}

/// Reads all pages.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let ended = || Error::file(path, "its pages are damaged; copy or export it again");
    catch_panic(|| read_unguarded(path, choice, watch)).ok_or_else(ended)?
}

/// Reads all pages; [`read`] turns a panic of a decoder into an error.
fn read_unguarded(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let (mut file, directories) = TiffReader::open(path)?;
    let mut metadata = described(&mut file, &directories)?;
    let slices = pages::slice_pages(&mut file, &directories, &mut metadata.notices)?;
    let first = slices.first().and_then(|page| directories.get(*page));
    let samples = first.and_then(|directory| PageFormat::of(&mut file, directory).ok());
    let extents = metadata.extents_of(slices.len(), samples.map_or(1, |format| format.samples));
    let [_, channels, times] = extents;
    let time = choice.time_of(times)?;
    if times > 1 && choice.time.is_none() {
        metadata.notices.push(format!(
            "holds {times} volumes; the first is used (--time chooses another)"
        ));
    }
    let dimensions = Dimensions {
        extents,
        order: metadata.order,
    };
    let planes = pages::planes_of(&mut file, &directories, &slices, &dimensions, &mut metadata)?;
    let mut pages = Pages {
        file,
        directories,
        other: None,
        watch,
    };
    let pixels = pages.read(&dimensions, &planes, time, &mut metadata)?;
    let spacing = metadata.spacing.map(|s| s.filter(|s| s.is_finite() && *s > 0.0));
    let mut warnings = std::mem::take(&mut metadata.notices);
    if choice.spacing.is_none() && spacing.iter().any(Option::is_none) {
        warnings.push("does not state voxel spacing in every direction; 1 mm is assumed where it is missing (use --spacing to set it)".into());
        warnings.extend(metadata.unused_resolution.take());
    }
    let world_from_voxel = DAffine3::from_scale(DVec3::from(spacing.map(|s| s.unwrap_or(1.0))));
    let mut image = Image::new(metadata.format(), pixels.voxels, pixels.size, world_from_voxel);
    (image.components, image.layout, image.warnings) = (pixels.components, pixels.layout, warnings);
    image.meaning = metadata.meaning(channels, pixels.components, pixels.is_color);
    if let Some(rescale) = metadata.rescale.filter(|_| image.components == 1) {
        image.rescale = rescale;
    }
    if metadata.channel_names.iter().any(|n| !n.is_empty()) {
        image
            .details
            .push(("channel_names", json!(metadata.channel_names)));
    }
    image.inverted = pixels.is_inverted && image.components == 1;
    if times > 1 {
        image.details.push(("time_points", json!(times)));
    }
    Ok(image)
}
