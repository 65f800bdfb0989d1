//! Siemens mosaics: the slices of a volume as tiles of one picture.
//!
//! The number of slices and their normal are in private attributes: (0019,100A), or the CSA header
//! (0029,1010). Tiles are in rows, as many in each as there are rows. The stated position is that
//! of the picture as if it were a slice; a tile's lies nearer to its centre. Source: Siemens'
//! DICOM conformance statements; the CSA header as described by the dicom2nifti, dcm2niix and
//! NiBabel projects.

use super::element::{number, private_number, text};
use super::frame::{Frame, PixelFormat};
use super::increments::SliceDistance;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use glam::DVec3;

const CREATOR: &str = "SIEMENS CSA HEADER";
/// Maximum number of elements in a CSA header, and of values in an element.
const MAX_ELEMENTS: u32 = 512;
const MAX_VALUES: u32 = 4096;

/// The arrangement of slices in a picture.
pub struct Mosaic {
    slices: usize,
    /// Tiles along a row.
    across: usize,
    /// Pixels of a tile along a row, and along a column.
    pub tile: [usize; 2],
    /// Direction from one slice to the next, if it is stated.
    normal: Option<DVec3>,
    distance: f64,
}

impl Mosaic {
    /// The mosaic that an object holds, if its image type says so.
    ///
    /// # Errors
    /// The number of slices is not stated, or not possible; a sentence that says so.
    pub fn of(set: &InMemDicomObject, format: &PixelFormat) -> Result<Option<Self>, String> {
        let is_mosaic = set
            .get(tags::IMAGE_TYPE)
            .and_then(|e| e.value().to_multi_str().ok())
            .is_some_and(|words| words.iter().any(|w| w.trim() == "MOSAIC"));
        if !is_mosaic || format.samples != 1 {
            return Ok(None);
        }
        let header = csa(set);
        let entry = |name: &str| header.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_slice());
        let slices = private_number(set, 0x0019, "SIEMENS MR HEADER", 0x0a)
            .or_else(|| entry("NumberOfImagesInMosaic")?.first().copied())
            .or_else(|| number(set, Tag(0x0019, 0x100a)))
            .filter(|n| (1.0..=4096.0).contains(n));
        let Some(slices) = slices.map(|n| n as usize) else {
            return Err("is a mosaic that does not state its number of slices; its tiles are shown side by side in one slice (export it as single slices or as enhanced MR to see a volume)".into());
        };
        let across = (slices as f64).sqrt().ceil() as usize;
        let tile = [
            usize::from(format.columns) / across,
            usize::from(format.rows) / across,
        ];
        if tile.contains(&0) {
            return Err(format!(
                "is a mosaic of {slices} slices in {} x {} pixels, so its header is damaged; its tiles are shown side by side in one slice",
                format.columns, format.rows
            ));
        }
        let normal = entry("SliceNormalVector")
            .filter(|v| v.len() >= 3)
            .map(|v| DVec3::new(v[0], v[1], v[2]).normalize_or_zero())
            .filter(|n| n.length() > 0.5);
        Ok(Some(Self {
            slices,
            across,
            tile,
            normal,
            distance: SliceDistance::of(set).mm(),
        }))
    }

    /// The slices in a picture, given it as one frame.
    pub fn frames(&self, picture: &Frame) -> Vec<Frame> {
        let [along, down] = picture.along;
        let normal = along.cross(down).normalize_or(DVec3::Z);
        // Only its sign is needed.
        let step = normal * self.distance * self.normal.map_or(1.0, |n| n.dot(normal).signum());
        let spacing = picture.spacing.map(|s| if s > 0.0 { s } else { 1.0 });
        // Half the difference in size of the picture and a tile.
        let inward = |axis: usize| (self.tile[axis] * (self.across - 1)) as f64 / 2.0 * spacing[axis];
        let first = picture.position.map(|p| p + along * inward(0) + down * inward(1));
        (0..self.slices)
            .map(|n| Frame {
                tile: Some([n % self.across * self.tile[0], n / self.across * self.tile[1]]),
                position: Some(first.unwrap_or(DVec3::ZERO) + step * n as f64),
                ..picture.clone()
            })
            .collect()
    }
}

/// The numbers of the image's CSA header by name.
fn csa(set: &InMemDicomObject) -> Vec<(String, Vec<f64>)> {
    let bytes = (0x10..0x100u16)
        .find(|block| text(set, Tag(0x0029, *block)).starts_with(CREATOR))
        .and_then(|block| set.get(Tag(0x0029, block << 8 | 0x10)))
        .and_then(|e| e.value().to_bytes().ok().map(std::borrow::Cow::into_owned));
    bytes.and_then(|b| csa_entries(&b)).unwrap_or_default()
}

/// The entries of a CSA header, version 2 (`SV10`) or 1, up to the first that is damaged.
fn csa_entries(bytes: &[u8]) -> Option<Vec<(String, Vec<f64>)>> {
    let word = |at: usize| -> Option<u32> {
        Some(u32::from_le_bytes(
            bytes.get(at..at.checked_add(4)?)?.try_into().ok()?,
        ))
    };
    let (two, mut at) = if bytes.starts_with(b"SV10") {
        (true, 8)
    } else {
        (false, 0)
    };
    let count = word(at)?.min(MAX_ELEMENTS);
    at += 8;
    // In version 1, lengths of values count from the number of values of the first element.
    let mut first_count = None;
    let mut entries = Vec::new();
    for _ in 0..count {
        let Some(name) = bytes.get(at..at + 64) else { break };
        let end = name.iter().position(|b| *b == 0).unwrap_or(64);
        let name = String::from_utf8_lossy(&name[..end]).into_owned();
        let Some(values) = word(at + 76) else { break };
        at += 84;
        let base = *first_count.get_or_insert(values);
        let mut numbers = Vec::new();
        for _ in 0..values.min(MAX_VALUES) {
            let Some(stated) = word(at).zip(word(at + 4)) else {
                return Some(entries);
            };
            let length = if two {
                stated.1
            } else {
                stated.0.wrapping_sub(base)
            } as usize;
            at += 16;
            let Some(value) = at.checked_add(length).and_then(|end| bytes.get(at..end)) else {
                return Some(entries);
            };
            let text = String::from_utf8_lossy(value);
            if let Ok(number) = text.trim_matches(['\0', ' ']).trim().parse::<f64>() {
                numbers.push(number);
            }
            at += length.next_multiple_of(4);
        }
        entries.push((name, numbers));
    }
    Some(entries)
}
