//! What DICOM output states of a scene: the series that its volume comes from, and what was done.

use crate::picture::Picture;
use crate::scene::{Mode, Scene};
use crate::volume::Volume;
use crate::volume::load::Origin;
use crate::volume::save::dicom::{Derivation, secondary_capture};
use crate::{Result, Watch};
use std::path::Path;

/// What written DICOM shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DicomContent {
    /// A picture of the scene.
    Picture,
    /// The deformed volume.
    Volume,
    /// The deformed label map.
    Labels,
}

/// Whether a path names a DICOM file, by its extension.
pub fn is_dicom_name(path: &Path) -> bool {
    path.extension()
        .and_then(|e| e.to_str())
        .is_some_and(|e| ["dcm", "dicom"].iter().any(|d| e.eq_ignore_ascii_case(d)))
}

/// The DICOM series that a scene's volume was read from; none if it is no DICOM.
///
/// # Errors
/// A file that cannot be read any more; [`Error::Cancelled`](crate::Error::Cancelled).
pub fn origin(scene: &Scene, volume: &Volume, watch: &Watch) -> Result<Option<Origin>> {
    match (scene.volume_path(), &scene.volume) {
        (Some(path), Some(source)) if volume.format == "DICOM" => Origin::of(&path, &source.choice, watch),
        _ => Ok(None),
    }
}

/// A picture over the scene's background as a DICOM secondary capture: the bytes of its file.
///
/// # Errors
/// A picture larger than DICOM can hold; a sentence.
pub fn picture(
    scene: &Scene,
    picture: &Picture,
    origin: Option<&Origin>,
    patient: bool,
) -> Result<Vec<u8>, String> {
    let derivation = derivation(scene, DicomContent::Picture, origin, patient);
    let rgb = picture
        .over(scene.render.background)
        .chunks_exact(4)
        .flat_map(|p| [p[0], p[1], p[2]])
        .collect();
    secondary_capture(rgb, [picture.width, picture.height], &derivation)
}

/// The derivation of an object with this content. Names of files are left out: they may name a
/// patient.
pub fn derivation<'a>(
    scene: &Scene,
    content: DicomContent,
    origin: Option<&'a Origin>,
    patient: bool,
) -> Derivation<'a> {
    let kinds: Vec<&str> = scene
        .deformation
        .iter()
        .filter(|d| d.enabled)
        .map(|d| d.kind.as_str())
        .collect();
    let done = match (content, scene.render.mode) {
        (DicomContent::Volume | DicomContent::Labels, _) => "Resampled",
        (DicomContent::Picture, Mode::Surface) => "Surface rendering",
        (DicomContent::Picture, _) => "Volume rendering",
    };
    let by = format!("{done} by incise {}", env!("CARGO_PKG_VERSION"));
    let description = if kinds.is_empty() {
        by
    } else {
        format!("{by} after deformation: {}", kinds.join(", "))
    };
    let name = match content {
        DicomContent::Picture => "Rendering",
        DicomContent::Volume => "Deformed volume",
        DicomContent::Labels => "Deformed labels",
    };
    Derivation {
        description,
        series_description: name.to_owned(),
        origin,
        patient,
    }
}
