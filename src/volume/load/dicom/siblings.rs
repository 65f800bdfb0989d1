//! Whether a single file belongs to a series whose other files lie beside it.

use super::location::ObjectLocation;
use super::object::{Object, object};
use super::scan::looks_like_dicom;
use super::series::DicomSeries;
use std::path::{Path, PathBuf};

/// Maximum number of files beside the named one that are examined.
const MAX_EXAMINED: usize = 32;

/// The warning if other files of the series of a single file lie in its folder.
pub fn warning(path: &Path, objects: &[Object], series: &DicomSeries) -> Option<String> {
    let [only] = objects else { return None };
    let slices: usize = series.times.iter().map(Vec::len).sum();
    if path.is_dir() || slices == 0 || only.series.is_empty() {
        return None;
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    let entries = std::fs::read_dir(folder.unwrap_or(Path::new("."))).ok()?;
    let is_other = |e: &std::fs::DirEntry| {
        e.file_type().is_ok_and(|t| t.is_file()) && Some(e.file_name().as_os_str()) != path.file_name()
    };
    let mut others: Vec<_> = entries.flatten().filter(is_other).map(|e| e.path()).collect();
    others.sort();
    let belongs = |other: PathBuf| {
        let source = ObjectLocation::File(other);
        looks_like_dicom(&source)
            && matches!(object(source), Ok(Some(other)) if other.series == only.series && other.instance != only.instance)
    };
    others.into_iter().take(MAX_EXAMINED).any(belongs).then(|| {
        "is one slice of a series whose other files lie in its folder; name the folder to see all of them"
            .into()
    })
}
