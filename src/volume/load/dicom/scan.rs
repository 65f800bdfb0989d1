//! The DICOM objects in a file, a folder or a zip.

use super::dataset::{START, is_dicom};
use super::frame::Frame;
use super::location::{ObjectLocation, files_in, members};
use super::object::{Object, object};
use super::pixels::same_pixels;
use crate::{ByteProgress, Error, Result, Watch};
use rayon::prelude::*;
use std::collections::HashMap;
use std::io::Read;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// The result of a scan.
pub struct ScanResult {
    pub objects: Vec<Object>,
    /// Number of files that are DICOM without pixels, or not DICOM.
    pub others: usize,
    /// Number of unreadable DICOM files, and the first one's error.
    pub damaged: usize,
    pub complaint: Option<Error>,
    /// Notes about omitted parts of a folder.
    pub notes: Vec<String>,
}

/// The objects in a file, in a folder and all its subfolders, or in a zip.
pub fn scan(path: &Path, watch: &Watch) -> Result<ScanResult> {
    let (sources, notes) = if path.is_dir() {
        files_in(path, watch)?
    } else {
        (
            members(path, watch)?.unwrap_or_else(|| vec![ObjectLocation::File(path.to_owned())]),
            Vec::new(),
        )
    };
    let single = !path.is_dir() && sources.len() == 1;
    let empty = Mutex::new(Vec::new());
    let meter = ByteProgress::new(watch, sources.len() as u64);
    let read: Vec<Result<Option<Object>>> = sources
        .into_par_iter()
        .map(|source| {
            meter.add(1)?;
            if !single && !looks_like_dicom(&source) {
                if is_named_dicom(&source) {
                    let mut empty = empty.lock().unwrap_or_else(PoisonError::into_inner);
                    empty.push(source.path().to_owned());
                }
                return Ok(None);
            }
            object(source)
        })
        .collect();
    let mut found = ScanResult {
        objects: Vec::new(),
        others: 0,
        damaged: 0,
        complaint: None,
        notes,
    };
    let mut by_instance: HashMap<String, Vec<usize>> = HashMap::new();
    let mut same_name = 0usize;
    for result in read {
        match result {
            Ok(Some(mut object)) => {
                let index = found.objects.len();
                if !object.instance.is_empty() {
                    let named = by_instance.entry(object.instance.clone()).or_default();
                    if named.iter().any(|n| is_copy(&found.objects[*n], &object)) {
                        found.others += 1;
                        continue;
                    }
                    same_name += usize::from(!named.is_empty());
                    named.push(index);
                }
                object.frames.iter_mut().for_each(|f| f.object = index);
                found.objects.push(object);
            }
            Ok(None) => found.others += 1,
            Err(Error::Cancelled) => return Err(Error::Cancelled),
            Err(error) => {
                found.damaged += 1;
                found.complaint.get_or_insert(error);
            }
        }
    }
    let mut empty = empty.into_inner().unwrap_or_else(PoisonError::into_inner);
    empty.sort();
    if let Some(first) = empty.first().filter(|_| !found.objects.is_empty()) {
        let name = first.file_name().unwrap_or_default().to_string_lossy();
        found.notes.push(match empty.len() {
            1 => format!("{name} is empty or is not DICOM despite its name; it is left out"),
            n => format!("{n} files ({name} and others) are empty or are not DICOM despite their names; they are left out"),
        });
    }
    if same_name > 0 {
        found.notes.push(format!(
            "{same_name} files share the SOP instance UID of another file but differ from it in position, time or pixels; all are read"
        ));
    }
    Ok(found)
}

/// Whether a file that holds no DICOM should: it is empty, or has the extension.
fn is_named_dicom(source: &ObjectLocation) -> bool {
    let extension = source.path().extension().unwrap_or_default();
    source.bytes() == 0
        || ["dcm", "dicom", "ima"]
            .iter()
            .any(|e| extension.eq_ignore_ascii_case(e))
}

/// Whether two objects of one name are copies, under whatever file names: the same places and
/// times, and the same pixels.
fn is_copy(a: &Object, b: &Object) -> bool {
    let like = |(a, b): (&Frame, &Frame)| a.position == b.position && a.along == b.along && a.keys == b.keys;
    a.series == b.series
        && a.frames.len() == b.frames.len()
        && a.frames.iter().zip(&b.frames).all(like)
        && (a.is_structure_set() || same_pixels(a, b))
}

/// Whether a file starts as DICOM does.
pub fn looks_like_dicom(source: &ObjectLocation) -> bool {
    let mut start = Vec::new();
    source
        .open(START as u64)
        .is_ok_and(|reader| reader.take(START as u64).read_to_end(&mut start).is_ok())
        && is_dicom(&start)
}
