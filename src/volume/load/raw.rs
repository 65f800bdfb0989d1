//! Files that contain only values. Their layout is given by the caller, by a separate file
//! (`NAME.raw.toml`, with the keys of [`RawLayout`]), or by the file name
//! (`skull_256x256x256_uint8.raw`, as in collections of volumes). They may be gzipped.

use super::ScalarType;
use super::image::{Image, Layout};
use super::read_options::{RawLayout, ReadOptions};
use super::source::{ValueReader, check_held, count, open, skip, usable};
use crate::files::input::{MAX_SCENE_BYTES, text};
use crate::files::reference::is_link_out;
use crate::{Error, Result, Watch};
use glam::{DAffine3, DMat3, DVec3};
use std::path::Path;

/// Reads an image.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    let layout = match &choice.raw {
        Some(layout) => layout.clone(),
        None => match layout_file(path)? {
            Some(layout) => layout,
            None => of_name(path).ok_or_else(|| {
                fail("is raw data of unknown layout; describe it with --raw, e.g. --raw 256x256x128:u16, or in a file of the same name that ends in .toml".into())
            })?,
        },
    };
    let direction = DMat3::from_cols_array_2d(&layout.direction).transpose();
    let linear = direction * DMat3::from_diagonal(DVec3::from(layout.spacing_mm.unwrap_or([1.0; 3])));
    let world_from_voxel = DAffine3 {
        matrix3: linear,
        translation: DVec3::from(layout.origin_mm),
    };
    if !usable(&world_from_voxel) {
        return Err(fail("has a degenerate spacing or direction in its layout".into()));
    }
    if layout.size.contains(&0) || !(1..=1024).contains(&layout.components) {
        return Err(fail(format!(
            "has {:?} voxels of {} values in its layout; each must be at least 1",
            layout.size, layout.components
        )));
    }
    let [i, j, k] = layout.size;
    let total = count(path, &[i, j, k, layout.components], layout.scalar)?;
    let bytes = (total * layout.scalar.bytes()) as u64;
    let (mut reader, max_bytes) = open(path)?;
    check_held(path, bytes.saturating_add(layout.skip), max_bytes)?;
    skip(path, &mut reader, layout.skip)?;
    let swap = layout.scalar.bytes() > 1 && layout.big_endian != cfg!(target_endian = "big");
    let voxels = ValueReader {
        path,
        reader,
        swap,
        count: total,
        watch,
    }
    .read_as(layout.scalar)?;
    let length = std::fs::metadata(path).map_or(0, |m| m.len());
    let mut image = Image::new("raw", voxels, layout.size, world_from_voxel);
    (image.components, image.layout) = (layout.components, Layout::Interleaved);
    if layout.spacing_mm.or(choice.spacing).is_none() {
        image
            .warnings
            .push("does not state its voxel spacing; 1 mm is assumed (use --spacing to set it)".into());
    }
    if max_bytes == length && length > bytes + layout.skip {
        image.warnings.push(format!(
            "contains {} bytes more than its layout describes; check the size and type",
            length - bytes - layout.skip
        ));
    }
    Ok(image)
}

/// The layout in the separate file.
fn layout_file(path: &Path) -> Result<Option<RawLayout>> {
    let mut name = path.as_os_str().to_owned();
    name.push(".toml");
    let sidecar = Path::new(&name);
    if !sidecar.exists() {
        return Ok(None);
    }
    if is_link_out(
        path.parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new(".")),
        sidecar,
    ) {
        return Err(Error::file(
            sidecar,
            "is a symbolic link to a file outside its folder; copy it, or use --allow-outside",
        ));
    }
    let text = text(sidecar, MAX_SCENE_BYTES, "layout of raw values")?;
    toml::from_str(&text).map(Some).map_err(|e| {
        Error::file(
            sidecar,
            format!("does not describe a raw layout: {}", e.message()),
        )
    })
}

/// The layout in a file name: three numbers joined by `x`, and a type.
fn of_name(path: &Path) -> Option<RawLayout> {
    let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
    let words: Vec<&str> = name.split(['_', '.', '-', ' ']).collect();
    let size = words.iter().find_map(|w| {
        let size: Vec<usize> = w
            .split('x')
            .map(|n| n.parse().ok().filter(|n| *n > 0))
            .collect::<Option<_>>()?;
        <[usize; 3]>::try_from(size).ok()
    })?;
    let scalar = words.iter().find_map(|w| ScalarType::named(w))?;
    Some(RawLayout::new(size, scalar))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_tell() {
        let layout = of_name(Path::new("/x/skull_256x200x256_uint8.raw")).map(|l| (l.size, l.scalar));
        assert_eq!(layout, Some(([256, 200, 256], ScalarType::U8)));
        assert_eq!(of_name(Path::new("head.raw")), None);
        assert_eq!(of_name(Path::new("head_0x2x3_uint8.raw")), None);
    }
}
