//! Clips, baked volumes and baked fields as files, and DICOM objects of a scene.

pub mod bake;
pub mod clip;
pub mod dicom;
mod rows;

use crate::files::inputs::FileId;
use crate::volume::load;
use crate::{Error, Result};
use std::path::Path;

/// Checks that the output is not an input, by name, before anything is written. Files found to be
/// inputs only later are refused by [`OutputFile`](crate::files::OutputFile) itself.
///
/// # Errors
/// The output is one of the inputs, or would become one of the slices of an input folder.
pub fn protect<'a>(
    option: &str,
    output: &Path,
    read: impl IntoIterator<Item = &'a Path> + Clone,
) -> Result<()> {
    let named = || format!("{option} {}", output.display());
    let id = FileId::of(output);
    if id.is_some() && output.is_file() && read.clone().into_iter().any(|r| FileId::of(r) == id) {
        return Err(Error::value(named(), "is also an input; choose another name"));
    }
    let folder = output
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
        .canonicalize();
    let inside = |read: &Path| matches!((&folder, read.canonicalize()), (Ok(output), Ok(read)) if output.starts_with(&read));
    if read
        .into_iter()
        .any(|r| r.is_dir() && inside(r) && (dicom::is_dicom_name(output) || load::is_part_of(r, output)))
    {
        return Err(Error::value(
            named(),
            "would become one of the files of an input folder; choose another folder",
        ));
    }
    Ok(())
}

/// Checks that a folder of DICOM files to be written does not lie in a folder that is read: it
/// would be read with it the next time.
///
/// # Errors
/// It lies in an input folder, or is one.
pub fn protect_folder<'a>(
    option: &str,
    output: &Path,
    read: impl IntoIterator<Item = &'a Path>,
) -> Result<()> {
    let output_path: std::path::PathBuf = output.components().collect();
    let around = output_path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    // The folder itself, or the one in which it will be.
    let place = output_path.canonicalize().or_else(|_| around.canonicalize());
    let lies_in =
        |r: &Path| matches!((&place, r.canonicalize()), (Ok(place), Ok(r)) if place.starts_with(&r));
    if read.into_iter().any(|r| r.is_dir() && lies_in(r)) {
        return Err(Error::value(
            format!("{option} {}", output.display()),
            "lies in an input folder, and would be read with it the next time; choose another folder",
        ));
    }
    Ok(())
}
