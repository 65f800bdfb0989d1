//! Image slices: a folder of TIFF, PNG or JPEG files in the order of the numbers in their names, or
//! one image as a single slice.
//!
//! Images contain no reliable spacing (the resolution of a PNG is that of printing): voxels of 1 mm
//! are assumed unless the caller gives a spacing. Values are those of the file: opacity beside grey
//! values is left out, pixels are not turned by an EXIF orientation, and each is said in a notice.
//! A PNG's colour table is resolved, because PNG has no other meaning for indices (ISO 15948,
//! 11.2.3); grey ones become grey values.

use super::super::StoredValues;
use super::image::{Image, Layout, Meaning};
use super::planes::{ImageSlice, ImageStack, StatedSlice};
use super::source::{GZIPPED, check_held, open_file};
use super::{ReadOptions, tiff};
use crate::files::reference::{is_link_out, links_left_out};
use crate::panic_guard::catch_panic;
use crate::{ByteProgress, Error, Result, Watch};
use glam::{DAffine3, DVec3};
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder};
use rayon::prelude::*;
use std::cmp::Ordering;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

/// Extensions of images.
pub const ENDINGS: [&str; 5] = ["tif", "tiff", "png", "jpg", "jpeg"];
/// Maximum compression ratio of an image: deflate's limit, and a plausible one for a
/// single-coloured JPEG.
const MAX_COMPRESSION_RATIO: u64 = 3000;
/// The notice about a colour table.
const TABLE_NOTICE: &str = "has a colour table; its colours are read, not the indices";
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
    if files
        .first()
        .is_some_and(|f| tiff::is_tiff(f) && tiff::is_part_of_image(f))
    {
        return tiff::read(&files[0], choice, watch);
    }
    choice.time_of(1)?;
    let meter = ByteProgress::new(watch, files.len() as u64);
    let mut pictures = Pictures::default();
    for batch in files.chunks(AT_ONCE) {
        let planes: Vec<Result<StatedSlice>> = batch
            .par_iter()
            .map(|file| {
                if tiff::is_tiff(file) {
                    tiff::single_page(file)
                } else {
                    plane(file)
                }
            })
            .collect();
        for (file, plane) in batch.iter().zip(planes) {
            pictures.push(plane?, file, files.len());
            meter.add(1)?;
        }
    }
    let mut image = pictures.finish(folder, "pictures", choice)?;
    image.warnings.extend(links_left_out(&links_out(folder)));
    Ok(image)
}

/// Reads one image as a volume of one slice.
pub fn read(path: &Path, choice: &ReadOptions, _watch: &Watch) -> Result<Image> {
    choice.time_of(1)?;
    let mut pictures = Pictures::default();
    pictures.push(plane(path)?, path, 1);
    pictures.finish(path, "picture", choice)
}

/// Images that become one volume.
#[derive(Default)]
struct Pictures {
    stack: ImageStack,
    is_color: bool,
    is_inverted: bool,
    /// Spacing in the first one, which applies to all.
    spacing: [Option<f64>; 3],
    notices: Vec<String>,
    /// Names of those that differ from the first.
    different: Vec<String>,
}

impl Pictures {
    fn push(&mut self, plane: StatedSlice, file: &Path, of: usize) {
        let is_first = self.stack.count == 0;
        if !self.stack.push(plane.slice, of) {
            self.different.push(
                file.file_name()
                    .map(|n| n.to_string_lossy().into_owned())
                    .unwrap_or_default(),
            );
            return;
        }
        if is_first {
            (self.is_color, self.is_inverted, self.spacing) =
                (plane.is_color, plane.is_inverted, plane.spacing);
        }
        for notice in plane.notices {
            if !self.notices.contains(&notice) {
                self.notices.push(notice);
            }
        }
    }

    fn finish(self, path: &Path, format: &'static str, choice: &ReadOptions) -> Result<Image> {
        let stack = self.stack;
        let (size, components) = ([stack.size[0], stack.size[1], stack.count], stack.components);
        let voxels = stack
            .finish()
            .ok_or_else(|| Error::file(path, "holds no picture"))?;
        let spacing = self.spacing.map(|s| s.filter(|s| s.is_finite() && *s > 0.0));
        let mut image = Image::new(
            format,
            voxels,
            size,
            DAffine3::from_scale(DVec3::from(spacing.map(|s| s.unwrap_or(1.0)))),
        );
        (image.components, image.layout) = (components, Layout::Interleaved);
        if self.is_color && components > 2 {
            image.meaning = Meaning::Color;
        }
        image.inverted = self.is_inverted && components == 1;
        image.warnings = self.notices;
        if choice.spacing.is_none() && spacing.iter().any(Option::is_none) {
            image.warnings.push("pictures do not state voxel spacing in every direction; 1 mm is assumed (use --spacing to set it)".into());
        }
        if let Some(first) = self.different.first() {
            image.warnings.push(format!(
                "{} pictures ({first} and others) differ in size or type from the first and were skipped",
                self.different.len()
            ));
        }
        Ok(image)
    }
}

/// Decodes an image.
fn plane(path: &Path) -> Result<StatedSlice> {
    let damaged = |e: String| {
        Error::file(
            path,
            format!("is not a readable picture ({e}); copy or export it again"),
        )
    };
    let (mut file, bytes) = open_file(path)?;
    let start = start_of(&mut file).map_err(|e| Error::io(path, "reading", e))?;
    if start.starts_with(&[0x1f, 0x8b]) {
        return Err(Error::file(path, GZIPPED));
    }
    let is_cmyk = if start.starts_with(&[0xff, 0xd8]) {
        let inks = jpeg_components(&mut file).map_err(|e| Error::io(path, "reading", e))?;
        inks.map_err(|kind| {
            Error::file(
                path,
                format!("is {kind}, which cannot be read; convert it to PNG or TIFF"),
            )
        })? == 4
    } else {
        false
    };
    // The colour type in the header of a PNG: 3 for indices.
    let has_table = start.starts_with(b"\x89PNG") && start.get(25) == Some(&3);
    let mut reader = image::ImageReader::new(std::io::BufReader::new(file))
        .with_guessed_format()
        .map_err(|e| Error::io(path, "reading", e))?;
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(
        bytes
            .saturating_mul(MAX_COMPRESSION_RATIO)
            .saturating_add(1 << 20),
    );
    reader.limits(limits.clone());
    let decode = || -> image::ImageResult<(DynamicImage, Orientation)> {
        let mut decoder = reader.into_decoder()?;
        limits.reserve(decoder.total_bytes())?;
        let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
        Ok((DynamicImage::from_decoder(decoder)?, orientation))
    };
    let (decoded, orientation) = catch_panic(decode)
        .ok_or_else(|| damaged("its pixels are damaged".into()))?
        .map_err(|e| damaged(e.to_string()))?;
    let size = [decoded.width() as usize, decoded.height() as usize];
    check_held(
        path,
        (size[0] * size[1]) as u64,
        bytes.saturating_mul(MAX_COMPRESSION_RATIO),
    )?;
    let mut notices = Vec::new();
    if is_cmyk {
        notices.push("stores CMYK; its colours are converted to RGB without a colour profile".into());
    }
    let (values, components) = values_of(decoded, has_table, &mut notices);
    if orientation != Orientation::NoTransforms {
        notices.push(format!(
            "states the orientation {} (EXIF); its pixels are shown as they are stored",
            orientation.to_exif()
        ));
    }
    Ok(StatedSlice {
        slice: ImageSlice {
            size,
            components,
            values,
        },
        is_color: components > 2,
        is_inverted: false,
        spacing: [None; 3],
        notices,
    })
}

/// The first bytes of a file, up to a PNG's colour type; leaves it at its start.
fn start_of(file: &mut File) -> std::io::Result<Vec<u8>> {
    let mut start = Vec::new();
    file.by_ref().take(26).read_to_end(&mut start)?;
    file.rewind()?;
    Ok(start)
}

/// Number of components in the frame header of a JPEG, 0 if it has none within its first MiB;
/// leaves the file at its start. The kind of a JPEG that cannot be decoded is the inner error.
fn jpeg_components(file: &mut File) -> std::io::Result<Result<u8, &'static str>> {
    let mut start = Vec::new();
    file.by_ref().take(1 << 20).read_to_end(&mut start)?;
    file.rewind()?;
    let mut at = 2;
    while let Some(&[0xff, marker, high, low]) = start.get(at..at + 4) {
        if marker == 0xff {
            at += 1;
            continue;
        }
        // Frame headers, apart from the tables of Huffman and arithmetic coding among them.
        if matches!(marker, 0xc0..=0xcf | 0xf7) && !matches!(marker, 0xc4 | 0xc8 | 0xcc) {
            let (depth, components) = (start.get(at + 4), start.get(at + 9).copied().unwrap_or(0));
            return Ok(match marker {
                0xf7 => Err("a JPEG-LS picture"),
                0xc3 => Err("a lossless JPEG (process 14)"),
                0xc5..=0xc7 | 0xcd..=0xcf => Err("a hierarchical JPEG"),
                0xc9..=0xcb => Err("a JPEG with arithmetic coding"),
                _ if depth == Some(&12) => Err("a JPEG of 12 bits per sample"),
                _ => Ok(components),
            });
        }
        at += 2 + usize::from(u16::from_be_bytes([high, low]));
    }
    Ok(Ok(0))
}

/// Values of a decoded image, and their number per pixel.
fn values_of(decoded: DynamicImage, has_table: bool, notices: &mut Vec<String>) -> (StoredValues, usize) {
    use DynamicImage as D;
    let mut note_opacity = |is_used: bool| {
        if is_used {
            notices.push("has an opacity (alpha) channel beside its grey values; it is left out".into());
        }
    };
    if has_table {
        return colors_of_table(&decoded, notices);
    }
    match decoded {
        D::ImageLuma8(i) => (i.into_raw().into(), 1),
        D::ImageLuma16(i) => (i.into_raw().into(), 1),
        D::ImageLumaA8(i) => {
            note_opacity(i.pixels().any(|p| p.0[1] != u8::MAX));
            (i.pixels().map(|p| p.0[0]).collect::<Vec<_>>().into(), 1)
        }
        D::ImageLumaA16(i) => {
            note_opacity(i.pixels().any(|p| p.0[1] != u16::MAX));
            (i.pixels().map(|p| p.0[0]).collect::<Vec<_>>().into(), 1)
        }
        D::ImageRgb8(i) => (i.into_raw().into(), 3),
        D::ImageRgba8(i) => (i.into_raw().into(), 4),
        D::ImageRgb16(i) => (i.into_raw().into(), 3),
        D::ImageRgba16(i) => (i.into_raw().into(), 4),
        other => (other.into_rgba8().into_raw().into(), 4),
    }
}

/// The colours of an image with a colour table; one value per pixel if all are grey and opaque.
fn colors_of_table(decoded: &DynamicImage, notices: &mut Vec<String>) -> (StoredValues, usize) {
    let colors = decoded.to_rgba8();
    if colors.pixels().all(|p| p.0[3] == u8::MAX) {
        if colors.pixels().all(|p| p.0[0] == p.0[1] && p.0[1] == p.0[2]) {
            return (colors.pixels().map(|p| p.0[0]).collect::<Vec<_>>().into(), 1);
        }
        notices.push(TABLE_NOTICE.into());
        return (decoded.to_rgb8().into_raw().into(), 3);
    }
    notices.push(TABLE_NOTICE.into());
    (colors.into_raw().into(), 4)
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
