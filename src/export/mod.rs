//! Pictures, baked volumes and fields to files. A file appears whole or not at all: written beside its destination, then renamed.

pub mod bake;
pub mod clip;
mod rows;

use crate::scene::Picture;
use crate::volume::load;
use crate::{Error, Result};
use std::io::Write;
use std::path::{Path, PathBuf};

/// A file that will be made. Its place is tried before the work starts, so that an output that cannot be written is known at once; nothing
/// lies there while the work goes on.
pub struct Output {
    path: PathBuf,
}

impl Output {
    /// Tries the place of `path`.
    ///
    /// # Errors
    /// A folder that does not exist or cannot be written, a path that is a folder.
    pub fn create(path: &Path) -> Result<Self> {
        if path.is_dir() {
            return Err(Error::file(path, "is a folder; name a file in it"));
        }
        beside(path)?;
        Ok(Self { path: path.to_owned() })
    }

    /// Writes the content and puts the file in its place.
    ///
    /// # Errors
    /// A full disk, a destination that cannot be replaced.
    pub fn finish(self, content: &[u8]) -> Result<()> {
        let path = self.path.clone();
        self.finish_with(|file| file.write_all(content).map_err(|e| Error::io(&path, "writing", e)))
    }

    /// As [`Self::finish`], the content being written piece by piece.
    ///
    /// # Errors
    /// As [`Self::finish`], and what `write` reports.
    pub fn finish_with(self, write: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
        let path = self.path;
        let mut buffered = std::io::BufWriter::with_capacity(1 << 20, beside(&path)?);
        write(&mut buffered)?;
        let file = buffered.into_inner().map_err(|e| Error::io(&path, "writing", e.into_error()))?;
        file.as_file().sync_all().map_err(|e| Error::io(&path, "writing", e))?;
        file.persist(&path).map_err(|e| Error::io(&path, "writing", e.error))?;
        Ok(())
    }
}

/// Whether two paths name one file.
pub fn same_file(a: &Path, b: &Path) -> bool {
    a == b || matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// Nothing is ever written to a file that is read.
///
/// # Errors
/// The output is one of the files that are read.
pub fn protect<'a>(option: &str, output: &Path, read: impl IntoIterator<Item = &'a Path> + Clone) -> Result<()> {
    if read.clone().into_iter().any(|r| same_file(output, r)) {
        return Err(Error::value(format!("{option} {}", output.display()), "is a file that is read; choose another name"));
    }
    let inside =
        |folder: &Path| match (output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).canonicalize(), folder.canonicalize())
        {
            (Ok(output), Ok(folder)) => output.starts_with(folder),
            _ => false,
        };
    if read.clone().into_iter().any(|r| r.is_dir() && inside(r) && load::is_part_of(r, output)) {
        return Err(Error::value(
            format!("{option} {}", output.display()),
            "would be one of the files of a folder that is read; choose another folder",
        ));
    }
    Ok(())
}

/// A temporary file in the folder of `path`.
fn beside(path: &Path) -> Result<tempfile::NamedTempFile> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        return Err(Error::file(path, format!("there is no folder {}; make it, or choose another place", folder.display())));
    }
    let mut builder = tempfile::Builder::new();
    builder.prefix(".incise-").suffix(".part");
    #[cfg(unix)]
    {
        // As any program's new file, less the umask.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder).map_err(|e| Error::io(path, "writing", e))
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

    #[test]
    fn no_partial_file_is_left() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let path = folder.path().join("a.png");
        drop(Output::create(&path));
        assert_eq!(std::fs::read_dir(folder.path()).map(Iterator::count).ok(), Some(0));
        Output::create(&path).and_then(|o| o.finish(b"x")).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(std::fs::read(&path).ok().as_deref(), Some(&b"x"[..]));
        assert!(Output::create(&folder.path().join("no/such/a.png")).is_err());
        assert!(Output::create(folder.path()).is_err());
    }
}
