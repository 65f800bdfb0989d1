//! The DICOM series from which a volume was read, for objects that are derived from it.

use super::dataset::header;
use super::element::text;
use super::scan::scan;
use super::series::{chosen, series};
use crate::volume::load::ReadOptions;
use crate::{Result, Watch};
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use glam::DVec3;
use std::path::Path;

/// A series, and the objects of the volume that was read from it.
pub struct Origin {
    /// Storage class of its objects.
    pub class: String,
    /// Its UID.
    pub series: String,
    /// The elements of its first object before the pixel data.
    pub header: InMemDicomObject,
    /// Its objects in the order of their slices.
    pub instances: Vec<OriginInstance>,
}

/// An object of a series.
#[derive(Clone, Debug)]
pub struct OriginInstance {
    /// Its UID.
    pub uid: String,
    /// Centre of the first pixel of its only frame, LPS mm; none if it has several frames, or does
    /// not state it.
    pub position: Option<DVec3>,
}

impl Origin {
    /// The series that the reader reads from a file, a folder, a zip or a DICOMDIR; none if there
    /// is none.
    ///
    /// # Errors
    /// A file that cannot be read; [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn of(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Option<Self>> {
        let is_directory = path
            .file_name()
            .is_some_and(|n| n.eq_ignore_ascii_case("DICOMDIR"));
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
        let path = if is_directory && !path.is_dir() {
            folder.unwrap_or(Path::new("."))
        } else {
            path
        };
        let found = scan(path, watch)?;
        let all = series(&found.objects);
        if all.is_empty() {
            return Ok(None);
        }
        let index = match &choice.series {
            None => 0,
            Some(wanted) => chosen(wanted, &all, &found.objects)?,
        };
        let series = &all[index];
        let frames = &series.times[choice.time_of(series.times.len())?];
        let mut instances: Vec<OriginInstance> = Vec::new();
        for frame in frames {
            let object = &found.objects[frame.object];
            if instances.last().is_none_or(|last| last.uid != object.instance) && !object.instance.is_empty()
            {
                instances.push(OriginInstance {
                    uid: object.instance.clone(),
                    position: frame.position.filter(|_| object.frames.len() == 1),
                });
            }
        }
        // The frames of one object need not be consecutive.
        let mut seen = std::collections::HashSet::new();
        instances.retain(|i| seen.insert(i.uid.clone()));
        let first = &found.objects[series.object];
        let header = header(&first.source)?.1.elements;
        Ok(Some(Self {
            class: text(&header, tags::SOP_CLASS_UID),
            series: first.series.clone(),
            header,
            instances,
        }))
    }

    /// The text of an element of the first object; empty if it has none.
    pub fn text(&self, tag: dicom_core::Tag) -> String {
        text(&self.header, tag)
    }
}
