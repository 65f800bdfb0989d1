//! Reading volumes. One file per format.

mod nifti;

use super::{Volume, phantom};
use crate::{Error, Result};
use std::path::Path;

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
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, "opening", e))?;
    if metadata.is_dir() {
        return Err(Error::file(path, "is a folder; name a NIfTI file (.nii, .nii.gz), a scene (.toml) or a phantom (phantom:NAME)"));
    }
    let name = path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if name.ends_with(".nii") || name.ends_with(".nii.gz") {
        return nifti::read(path, progress);
    }
    Err(Error::file(path, "is of a format that cannot be read; NIfTI-1 files (.nii, .nii.gz) can"))
}
