//! Clips, baked volumes and baked fields as files.

pub mod bake;
pub mod clip;
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
        .any(|r| r.is_dir() && inside(r) && load::is_part_of(r, output))
    {
        return Err(Error::value(
            named(),
            "would become one of the files of an input folder; choose another folder",
        ));
    }
    Ok(())
}
