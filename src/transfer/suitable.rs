//! The preset that suits a volume, and why: by what its voxels are (colours, labels), what its
//! source states (DICOM's modality), its values, and its name.

use super::{OWN_COLORS, RelativeTo};
use crate::volume::Volume;

/// A preset chosen for a volume.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SuitablePreset {
    /// Its name.
    pub name: &'static str,
    /// Why it was chosen, as part of a sentence.
    pub reason: String,
}

/// Share of the voxels beyond which a CT scan is shown by its bone, and the value above which a
/// voxel is bone, Hounsfield units.
const BONE_SHARE: f64 = 0.002;
const BONE: f64 = 250.0;

/// The preset that suits a volume of a name (its path) if none is set.
pub fn suitable_preset(volume: &Volume, name: &str, relative_to: RelativeTo) -> SuitablePreset {
    let chosen = |name, reason: &str| SuitablePreset {
        name,
        reason: reason.to_owned(),
    };
    if volume.colors.is_some() {
        return chosen(OWN_COLORS, "the voxels have colours");
    }
    if volume.labels().is_some() {
        return chosen("labels", "the values are labels");
    }
    if relative_to == RelativeTo::Range {
        return if volume.hounsfield_zero() == Some(0.0) {
            chosen("ct-bone", "the values are Hounsfield units")
        } else {
            chosen("mr-default", "the values have no absolute scale")
        };
    }
    if let Some(zero) = volume.hounsfield_zero() {
        let [low, high] = volume.range;
        let units = if zero == 0.0 {
            format!("the values {low:.0} to {high:.0} are Hounsfield units")
        } else {
            format!("the values {low:.0} to {high:.0} are Hounsfield units shifted by {zero:.0}")
        };
        let bins = volume.histogram(1024);
        let first = (zero + BONE - low) / (high - low) * bins.counts.len() as f64;
        let bone: u64 = bins.counts.iter().skip(first.max(0.0) as usize).sum();
        let (name, content) = if bone as f64 >= BONE_SHARE * volume.voxels.len() as f64 {
            ("ct-bone", "include bone")
        } else {
            ("ct-soft-tissue", "include hardly any bone")
        };
        return SuitablePreset {
            name,
            reason: format!("{units} and {content}"),
        };
    }
    if let Some(modality @ ("PT" | "NM")) = volume.modality() {
        return chosen("pet-hot", &format!("the DICOM modality is {modality}"));
    }
    let file = std::path::Path::new(name)
        .file_name()
        .map(|n| n.to_string_lossy().to_lowercase());
    let words: Vec<&str> = file
        .as_deref()
        .unwrap_or_default()
        .split(|c: char| !c.is_alphanumeric())
        .collect();
    let named = |wanted: &[&str]| words.iter().any(|w| wanted.contains(w));
    if named(&["pet", "suv", "suvbw", "fdg"]) {
        return chosen("pet-hot", "the file name indicates PET");
    }
    if named(&["tof", "mra", "angio", "angiography"]) {
        return chosen("mr-angio", "the file name indicates angiography");
    }
    let around = match volume.foreground() {
        None => "all of them are the same".into(),
        Some(f) if f.is_dark() => format!(
            "the object lies below {}, its background above",
            short(f.threshold)
        ),
        Some(f) => format!("the background ends at {}", short(f.threshold)),
    };
    SuitablePreset {
        name: "mr-default",
        reason: format!("the values have no absolute scale; {around}"),
    }
}

/// A data value with three significant digits or more.
fn short(value: f64) -> String {
    let decimals = (2.0 - value.abs().max(1e-9).log10().floor()).clamp(0.0, 12.0);
    format!("{value:.*}", decimals as usize)
}
