//! Reading volumes and vector images. One file per format.

mod image;
mod metaimage;
mod nifti;
mod nrrd;

pub use image::{Image, Layout, ScalarType};

use super::{Volume, phantom};
use crate::{Error, Result};
use std::path::Path;

/// Endings of the files that can be read, for messages.
pub const FORMATS: &str = "NIfTI-1 (.nii, .nii.gz), NRRD (.nrrd, .nhdr) and MetaImage (.mha, .mhd)";

/// Reads a volume from a file, or makes the phantom that `phantom:NAME[:size=N]` names.
///
/// `progress` is told bytes read and bytes in all.
///
/// # Errors
/// A missing or unreadable file, a format that is not known, a damaged file: each named with what to do.
pub fn volume(path: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<Volume> {
    if let Some(spec) = path.to_str().and_then(|p| p.strip_prefix("phantom:")) {
        return phantom::from_spec(spec);
    }
    image(path, progress)?.into_volume(path)
}

/// Reads an image of one or several components.
///
/// # Errors
/// As [`volume`].
pub fn image(path: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<Image> {
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, "opening", e))?;
    if metadata.is_dir() {
        return Err(Error::file(path, "is a folder; name an image file, a scene (.toml) or a phantom (phantom:NAME)"));
    }
    let name = path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let ends = |endings: &[&str]| endings.iter().any(|e| name.ends_with(e));
    if ends(&[".nii", ".nii.gz"]) {
        nifti::read(path, progress)
    } else if ends(&[".nrrd", ".nhdr"]) {
        nrrd::read(path, progress)
    } else if ends(&[".mha", ".mhd"]) {
        metaimage::read(path, progress)
    } else {
        Err(Error::file(path, format!("is of a format that cannot be read; {FORMATS} can")))
    }
}
