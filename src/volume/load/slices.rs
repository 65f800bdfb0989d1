//! Image slices: a folder of TIFF, PNG or JPEG files in the order of the numbers in their names, or
//! one image as a single slice.
//!
//! Images contain no reliable spacing: voxels of 1 mm are assumed unless the caller gives a
//! spacing.

use super::super::StoredValues;
use super::image::{Image, Layout, Meaning};
use super::planes::{ImageSlice, ImageStack};
use super::source::{check_held, open_file};
use super::{ReadOptions, tiff};
use crate::files::reference::{is_link_out, links_left_out};
use crate::panic_guard::catch_panic;
use crate::{ByteProgress, Error, Result, Watch};
use glam::{DAffine3, DVec3};
use rayon::prelude::*;
use std::cmp::Ordering;
use std::path::{Path, PathBuf};

/// Extensions of images.
pub const ENDINGS: [&str; 5] = ["tif", "tiff", "png", "jpg", "jpeg"];
/// Maximum compression ratio of an image: deflate's limit, and a plausible one for a
/// single-coloured JPEG.
const MAX_COMPRESSION_RATIO: u64 = 3000;
/// Number of images decoded at once.
const AT_ONCE: usize = 16;

/// The images of a folder, in order. Links out of it are not followed: see [`links_out`].
pub fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "reading", e))?;
    let mut found: Vec<PathBuf> = entries
        .flatten()
        .map(|e| e.path())
        .filter(|p| {
            is_picture(p)
                && p.is_file()
                && !p
                    .file_name()
                    .is_some_and(|n| n.to_string_lossy().starts_with('.'))
        })
        .filter(|p| !is_link_out(folder, p))
        .collect();
    found.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(found)
}

/// The images of a folder that are links out of it.
fn links_out(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|e| e.path());
    entries
        .filter(|p| is_picture(p) && is_link_out(folder, p))
        .collect()
}

/// Whether a name has an image's extension.
pub fn is_picture(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| ENDINGS.iter().any(|p| e.eq_ignore_ascii_case(p)))
}

/// Natural order: numbers in names compare as numbers.
pub fn natural(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a.as_bytes(), b.as_bytes());
    let digits = |s: &[u8]| s.iter().take_while(|c| c.is_ascii_digit()).count();
    loop {
        let (da, db) = (digits(a), digits(b));
        if da > 0 && db > 0 {
            let strip = |s: &[u8], d: usize| s[..d].iter().position(|c| *c != b'0').unwrap_or(d - 1);
            let (na, nb) = (&a[strip(a, da)..da], &b[strip(b, db)..db]);
            let order = na.len().cmp(&nb.len()).then_with(|| na.cmp(nb));
            if order != Ordering::Equal {
                return order;
            }
            (a, b) = (&a[da..], &b[db..]);
            continue;
        }
        match (a.split_first(), b.split_first()) {
            (Some((x, rest_a)), Some((y, rest_b))) => {
                let order = x.to_ascii_lowercase().cmp(&y.to_ascii_lowercase());
                if order != Ordering::Equal {
                    return order;
                }
                (a, b) = (rest_a, rest_b);
            }
            (None, None) => return Ordering::Equal,
            (None, _) => return Ordering::Less,
            (_, None) => return Ordering::Greater,
        }
    }
}

/// Reads the images of a folder as one volume.
pub fn read_folder(folder: &Path, files: &[PathBuf], choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    if let [file] = files {
        return if tiff::is_tiff(file) {
            tiff::read(file, choice, watch)
        } else {
            read(file, choice, watch)
        };
    }
    choice.time_of(1)?;
    let meter = ByteProgress::new(watch, files.len() as u64);
    let mut stack = ImageStack::default();
    let mut odd = Vec::new();
    for batch in files.chunks(AT_ONCE) {
        let planes: Vec<Result<ImageSlice>> = batch
            .par_iter()
            .map(|file| {
                if tiff::is_tiff(file) {
                    tiff::first_page(file)
                } else {
                    plane(file)
                }
            })
            .collect();
        for (file, plane) in batch.iter().zip(planes) {
            if !stack.push(plane?, files.len()) {
                odd.push(
                    file.file_name()
                        .map(|n| n.to_string_lossy().into_owned())
                        .unwrap_or_default(),
                );
            }
            meter.add(1)?;
        }
    }
    // The spacing in the first TIFF applies to all.
    let stated_spacing = files
        .first()
        .filter(|f| tiff::is_tiff(f))
        .and_then(|f| tiff::spacing(f))
        .unwrap_or_default();
    let mut image = image_of(folder, "pictures", stack, choice, stated_spacing)?;
    image.warnings.extend(links_left_out(&links_out(folder)));
    if let Some(first) = odd.first() {
        image.warnings.push(format!(
            "{} pictures ({first} and others) differ in size or type from the first and were skipped",
            odd.len()
        ));
    }
    Ok(image)
}

/// Reads one image as a volume of one slice.
pub fn read(path: &Path, choice: &ReadOptions, _watch: &Watch) -> Result<Image> {
    choice.time_of(1)?;
    let mut stack = ImageStack::default();
    stack.push(plane(path)?, 1);
    image_of(path, "picture", stack, choice, [None; 3])
}

fn image_of(
    path: &Path,
    format: &'static str,
    stack: ImageStack,
    choice: &ReadOptions,
    spacing: [Option<f64>; 3],
) -> Result<Image> {
    let (size, components) = ([stack.size[0], stack.size[1], stack.count], stack.components);
    let voxels = stack
        .finish()
        .ok_or_else(|| Error::file(path, "holds no picture"))?;
    let mut image = Image::new(
        format,
        voxels,
        size,
        DAffine3::from_scale(DVec3::from(spacing.map(|s| s.unwrap_or(1.0)))),
    );
    (image.components, image.layout) = (components, Layout::Interleaved);
    if components > 2 {
        image.meaning = Meaning::Color;
    }
    if choice.spacing.is_none() && spacing.iter().any(Option::is_none) {
        image.warnings.push("pictures do not state voxel spacing in every direction; 1 mm is assumed (use --spacing to set it)".into());
    }
    Ok(image)
}

/// Decodes an image.
fn plane(path: &Path) -> Result<ImageSlice> {
    let damaged = |e: String| {
        Error::file(
            path,
            format!("is not a readable picture ({e}); copy or export it again"),
        )
    };
    let (file, bytes) = open_file(path)?;
    let mut reader = image::ImageReader::new(std::io::BufReader::new(file))
        .with_guessed_format()
        .map_err(|e| Error::io(path, "reading", e))?;
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(
        bytes
            .saturating_mul(MAX_COMPRESSION_RATIO)
            .saturating_add(1 << 20),
    );
    reader.limits(limits);
    let decoded = catch_panic(|| reader.decode())
        .ok_or_else(|| damaged("its pixels are damaged".into()))?
        .map_err(|e| damaged(e.to_string()))?;
    let size = [decoded.width() as usize, decoded.height() as usize];
    check_held(
        path,
        (size[0] * size[1]) as u64,
        bytes.saturating_mul(MAX_COMPRESSION_RATIO),
    )?;
    use image::DynamicImage as D;
    let (values, components): (StoredValues, usize) = match decoded {
        D::ImageLuma8(i) => (i.into_raw().into(), 1),
        D::ImageLuma16(i) => (i.into_raw().into(), 1),
        // Transparent pixels are black.
        D::ImageLumaA8(i) => (
            i.pixels()
                .map(|p| (u16::from(p.0[0]) * u16::from(p.0[1]) / 255) as u8)
                .collect::<Vec<_>>()
                .into(),
            1,
        ),
        D::ImageRgb8(i) => (i.into_raw().into(), 3),
        D::ImageRgba8(i) => (i.into_raw().into(), 4),
        D::ImageRgb16(i) => (i.into_raw().into(), 3),
        D::ImageRgba16(i) => (i.into_raw().into(), 4),
        other => (other.into_rgba8().into_raw().into(), 4),
    };
    Ok(ImageSlice {
        size,
        components,
        values,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let mut names = [
            "s10.png", "s9.png", "S1.png", "s010.png", "a.png", "s2b.png", "s2.png",
        ];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(
            names,
            [
                "a.png", "S1.png", "s2.png", "s2b.png", "s9.png", "s10.png", "s010.png"
            ]
        );
    }
}
