//! Pictures, baked volumes and fields as files.

pub mod bake;
pub mod clip;
mod rows;

use crate::files::inputs::FileId;
use crate::picture::Picture;
use crate::volume::load;
use crate::{Error, Result};
use std::path::Path;

/// Nothing is ever written to a file that is read: the first check, by names, before anything is. What is found to be read later is refused by
/// [`crate::files::Output`] itself.
///
/// # Errors
/// The output is one of the files that are read, or would be one of a folder of slices that is.
pub fn protect<'a>(option: &str, output: &Path, read: impl IntoIterator<Item = &'a Path> + Clone) -> Result<()> {
    let named = || format!("{option} {}", output.display());
    let id = FileId::of(output);
    if id.is_some() && output.is_file() && read.clone().into_iter().any(|r| FileId::of(r) == id) {
        return Err(Error::value(named(), "is also an input; choose another name"));
    }
    let folder = output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).canonicalize();
    let inside = |read: &Path| matches!((&folder, read.canonicalize()), (Ok(output), Ok(read)) if output.starts_with(&read));
    if read.into_iter().any(|r| r.is_dir() && inside(r) && load::is_part_of(r, output)) {
        return Err(Error::value(named(), "would become one of the files of an input folder; choose another folder"));
    }
    Ok(())
}

/// 8-bit RGB as PNG.
///
/// # Errors
/// The encoder's.
pub fn png_rgb(width: usize, height: usize, rgb: &[u8]) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    image::ImageEncoder::write_image(
        image::codecs::png::PngEncoder::new(&mut bytes),
        rgb,
        width as u32,
        height as u32,
        image::ExtendedColorType::Rgb8,
    )
    .map_err(|e| Error::value("output", format!("could not be encoded as PNG: {e}")))?;
    Ok(bytes)
}

/// A picture over a background as PNG: 8 bits per channel, RGB if the background is opaque, else RGBA (not premultiplied).
///
/// # Errors
/// The encoder's.
pub fn png(picture: &Picture, background: [f32; 4]) -> Result<Vec<u8>> {
    let mut rgba = picture.over(background);
    let color = if background[3] >= 1.0 {
        rgba = rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        image::ExtendedColorType::Rgb8
    } else {
        image::ExtendedColorType::Rgba8
    };
    let mut bytes = Vec::new();
    image::ImageEncoder::write_image(image::codecs::png::PngEncoder::new(&mut bytes), &rgba, picture.width, picture.height, color)
        .map_err(|e| Error::value("output", format!("could not be encoded as PNG: {e}")))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn background_shows_where_the_picture_does_not() {
        let picture = Picture { width: 2, height: 1, pixels: vec![[0.5, 0.0, 0.0, 0.5], [0.0; 4]] };
        assert_eq!(picture.over([0.0, 0.0, 1.0, 1.0]), [128, 0, 128, 255, 0, 0, 255, 255]);
        assert_eq!(picture.over([0.0; 4]), [255, 0, 0, 128, 0, 0, 0, 0]);
    }
}
