//! RT Structure Sets: named structures, each outlined by contours in patient coordinates.
//!
//! Source: DICOM PS3.3 C.8.8.5 (structure set), C.8.8.6 (ROI contour), C.8.8.8 (observations).

use super::element::{item, numbers, text};
use dicom_core::{Tag, VR};
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use glam::DVec3;
use std::collections::{HashMap, HashSet};

/// RT Structure Set storage.
const STRUCTURE_SET: &str = "1.2.840.10008.5.1.4.1.1.481.3";
/// Maximum number of structures; an atlas of the body has some hundred.
const MAX_STRUCTURES: usize = 4096;
/// Maximum number of names in one message.
const MAX_NAMES: usize = 8;
/// Largest coordinate of a contour, mm.
const MAX_COORDINATE_MM: f64 = 1e6;

/// A structure and its closed contours.
#[derive(Clone, Debug, Default)]
pub struct Structure {
    /// Its label, from 1.
    pub number: u32,
    /// Its name; may be empty.
    pub name: String,
    /// Red, green, blue.
    pub color: Option<[u8; 3]>,
    /// Corners of each closed contour, mm, LPS; at least three.
    pub contours: Vec<Vec<DVec3>>,
}

/// The content of a structure set.
#[derive(Debug, Default)]
pub struct StructureSet {
    /// Structures with closed contours, in the order of their numbers.
    pub structures: Vec<Structure>,
    /// SOP instance UIDs of the images on which the contours are drawn.
    pub images: HashSet<String>,
    /// Series instance UIDs of these images.
    pub series: HashSet<String>,
    /// UIDs of their frames of reference.
    pub frames_of_reference: HashSet<String>,
    /// What was left out, one sentence each.
    pub notes: Vec<String>,
}

/// Whether a data set is a structure set.
pub fn is_structure_set(set: &InMemDicomObject) -> bool {
    text(set, tags::SOP_CLASS_UID) == STRUCTURE_SET
        || text(set, tags::MODALITY) == "RTSTRUCT" && set.get(tags::ROI_CONTOUR_SEQUENCE).is_some()
}

/// The name of a structure set: its label, else its name, else the description of its series.
pub fn label_of(set: &InMemDicomObject) -> String {
    [
        tags::STRUCTURE_SET_LABEL,
        tags::STRUCTURE_SET_NAME,
        tags::SERIES_DESCRIPTION,
    ]
    .into_iter()
    .map(|tag| text(set, tag))
    .find(|t| !t.is_empty())
    .unwrap_or_default()
}

/// The items of a sequence.
fn items(set: &InMemDicomObject, tag: Tag) -> &[InMemDicomObject] {
    set.get(tag).and_then(|e| e.items()).unwrap_or(&[])
}

/// An integer; none if it is missing or negative.
fn index(set: &InMemDicomObject, tag: Tag) -> Option<u32> {
    let value = *numbers(set, tag)?.first()?;
    (0.0..=f64::from(u32::MAX))
        .contains(&value)
        .then_some(value as u32)
}

/// What was found among a structure's contours beside closed ones.
#[derive(Default)]
struct LeftOut {
    /// Structures with points or open contours, by name.
    open: Vec<String>,
    points: usize,
    lines: usize,
    /// Contours of fewer than three points, or whose coordinates cannot be used.
    damaged: usize,
    /// Contours that a structure contains twice.
    repeated: usize,
    /// Structures without any contour, by name.
    empty: Vec<String>,
}

/// The structures of a data set, and the images they are drawn on.
///
/// # Errors
/// No closed contour, or more structures than labels; a sentence.
pub fn structures(set: &InMemDicomObject) -> Result<StructureSet, String> {
    let mut names: HashMap<u32, String> = HashMap::new();
    let mut order: Vec<u32> = Vec::new();
    let mut is_unique = true;
    for roi in items(set, tags::STRUCTURE_SET_ROI_SEQUENCE) {
        let Some(number) = index(roi, tags::ROI_NUMBER) else {
            continue;
        };
        is_unique &= names.insert(number, text(roi, tags::ROI_NAME)).is_none();
        order.push(number);
    }
    let mut found = StructureSet::default();
    let mut left_out = LeftOut::default();
    let mut with_contours = HashSet::new();
    for roi in items(set, tags::ROI_CONTOUR_SEQUENCE) {
        let number = index(roi, tags::REFERENCED_ROI_NUMBER);
        let name = number.and_then(|n| names.get(&n)).cloned().unwrap_or_default();
        is_unique &= number.is_some_and(|n| with_contours.insert(n));
        let contours = closed_contours(roi, &name, &mut found.images, &mut left_out);
        if !contours.is_empty() {
            found.structures.push(Structure {
                number: number.unwrap_or(0),
                name,
                color: color(roi),
                contours,
            });
        }
    }
    for number in order.iter().filter(|n| !with_contours.contains(n)) {
        left_out.empty.extend(names.get(number).cloned());
    }
    references(set, &mut found);
    left_out.note(&mut found.notes);
    if found.structures.is_empty() {
        let notes = found.notes.join("; ");
        return Err(format!(
            "is a structure set without closed contours, so that there is nothing to show{}{notes}",
            if notes.is_empty() { "" } else { ": " }
        ));
    }
    if found.structures.len() > MAX_STRUCTURES {
        return Err(format!(
            "holds {} structures; at most {MAX_STRUCTURES} can be shown together",
            found.structures.len()
        ));
    }
    // Label 0 means no structure, and a label has 16 bits.
    if is_unique && found.structures.iter().all(|s| (1..=65_535).contains(&s.number)) {
        found.structures.sort_by_key(|s| s.number);
    } else {
        found.notes.push(
            "its ROI numbers are not distinct numbers from 1 to 65535; its structures are numbered from 1 in the order of the file"
                .into(),
        );
        (1..).zip(&mut found.structures).for_each(|(n, s)| s.number = n);
    }
    Ok(found)
}

/// The closed contours of a structure, each once. Adds the images that they refer to.
fn closed_contours(
    roi: &InMemDicomObject,
    name: &str,
    images: &mut HashSet<String>,
    left_out: &mut LeftOut,
) -> Vec<Vec<DVec3>> {
    let (mut contours, mut seen) = (Vec::new(), HashSet::new());
    let before = left_out.points + left_out.lines;
    let all = items(roi, tags::CONTOUR_SEQUENCE);
    for contour in all {
        for image in items(contour, tags::CONTOUR_IMAGE_SEQUENCE) {
            images.insert(text(image, tags::REFERENCED_SOP_INSTANCE_UID));
        }
        let kind = text(contour, tags::CONTOUR_GEOMETRIC_TYPE).to_ascii_uppercase();
        match kind.as_str() {
            "POINT" => left_out.points += 1,
            "OPEN_PLANAR" | "OPEN_NONPLANAR" | "OPENPLANAR" | "OPENNONPLANAR" => left_out.lines += 1,
            // A contour without a type is closed, if it has an area.
            _ => match corners(contour) {
                Some(corners) => {
                    let bits: Vec<[u64; 3]> =
                        corners.iter().map(|c| c.to_array().map(f64::to_bits)).collect();
                    if kind.ends_with("XOR") || seen.insert(bits) {
                        contours.push(corners);
                    } else {
                        left_out.repeated += 1;
                    }
                }
                None => left_out.damaged += 1,
            },
        }
    }
    if left_out.points + left_out.lines > before {
        left_out.open.push(name.to_owned());
    }
    if all.is_empty() {
        left_out.empty.push(name.to_owned());
    }
    contours
}

/// The corners of a contour; none if there are fewer than three, or a coordinate cannot be used.
fn corners(contour: &InMemDicomObject) -> Option<Vec<DVec3>> {
    let element = contour.get(tags::CONTOUR_DATA)?;
    // Explicit lengths of text have 16 bits: longer contours are stored with an unknown type.
    let values = if matches!(element.vr(), VR::UN | VR::OB | VR::OW) {
        coordinates(&String::from_utf8_lossy(&element.to_bytes().ok()?))?
    } else {
        let parts = element.to_multi_str().ok()?;
        let mut values = Vec::with_capacity(parts.len());
        for part in parts.iter() {
            values.extend(coordinates(part)?);
        }
        values
    };
    let (triples, rest) = values.as_chunks::<3>();
    (rest.is_empty() && triples.len() >= 3).then(|| triples.iter().copied().map(DVec3::from_array).collect())
}

/// Numbers separated by backslashes.
fn coordinates(text: &str) -> Option<Vec<f64>> {
    let text = text.trim_matches(|c: char| c == '\0' || c.is_whitespace());
    let text = text.strip_suffix('\\').unwrap_or(text);
    let one = |part: &str| {
        let value = part.trim_matches(|c: char| c == '\0' || c.is_whitespace());
        value.parse().ok().filter(|v: &f64| v.abs() <= MAX_COORDINATE_MM)
    };
    text.split('\\').map(one).collect()
}

fn color(roi: &InMemDicomObject) -> Option<[u8; 3]> {
    let values = numbers(roi, tags::ROI_DISPLAY_COLOR)?;
    let values: [f64; 3] = values.get(..3)?.try_into().ok()?;
    Some(values.map(|v| v.clamp(0.0, 255.0) as u8))
}

/// The images, series and frames of reference that a structure set names.
fn references(set: &InMemDicomObject, found: &mut StructureSet) {
    for frame in items(set, tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE) {
        found
            .frames_of_reference
            .insert(text(frame, tags::FRAME_OF_REFERENCE_UID));
        let studies = items(frame, tags::RT_REFERENCED_STUDY_SEQUENCE).iter();
        for series in studies.flat_map(|s| items(s, tags::RT_REFERENCED_SERIES_SEQUENCE)) {
            found.series.insert(text(series, tags::SERIES_INSTANCE_UID));
            for image in items(series, tags::CONTOUR_IMAGE_SEQUENCE) {
                found
                    .images
                    .insert(text(image, tags::REFERENCED_SOP_INSTANCE_UID));
            }
        }
    }
    let roi = item(set, tags::STRUCTURE_SET_ROI_SEQUENCE);
    for uid in [
        roi.map(|r| text(r, tags::REFERENCED_FRAME_OF_REFERENCE_UID)),
        Some(text(set, tags::FRAME_OF_REFERENCE_UID)),
    ] {
        found.frames_of_reference.extend(uid);
    }
    for uids in [
        &mut found.images,
        &mut found.series,
        &mut found.frames_of_reference,
    ] {
        uids.remove("");
    }
}

/// A few names for a message, in quotation marks.
pub fn named(names: &[String]) -> String {
    let some: Vec<String> = names.iter().take(MAX_NAMES).map(|n| format!("\"{n}\"")).collect();
    match names.len().saturating_sub(MAX_NAMES) {
        0 => some.join(", "),
        more => format!("{} and {more} more", some.join(", ")),
    }
}

impl LeftOut {
    fn note(&self, notes: &mut Vec<String>) {
        let count = |n: usize, one: &str, many: &str| format!("{n} {}", if n == 1 { one } else { many });
        if !self.open.is_empty() {
            let kinds: Vec<String> = [
                (self.points, "point", "points"),
                (self.lines, "open contour", "open contours"),
            ]
            .into_iter()
            .filter(|(n, ..)| *n > 0)
            .map(|(n, one, many)| count(n, one, many))
            .collect();
            notes.push(format!(
                "contains {} ({}), which have no inside and are not shown",
                kinds.join(" and "),
                named(&self.open)
            ));
        }
        if self.damaged > 0 {
            notes.push(format!(
                "contains {} with fewer than three points or damaged coordinates, left out",
                count(self.damaged, "contour", "contours")
            ));
        }
        if self.repeated > 0 {
            notes.push(format!(
                "contains {} twice; they are used once",
                count(self.repeated, "contour", "contours")
            ));
        }
        if !self.empty.is_empty() {
            notes.push(format!(
                "declares {} without contours: {}",
                count(self.empty.len(), "structure", "structures"),
                named(&self.empty)
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dicom_core::value::DataSetSequence;
    use dicom_core::{DataElement, PrimitiveValue};

    fn sequence(items: Vec<InMemDicomObject>) -> DataSetSequence<InMemDicomObject> {
        DataSetSequence::from(items)
    }

    fn contour(kind: &str, data: PrimitiveValue, vr: VR) -> InMemDicomObject {
        let mut set = InMemDicomObject::new_empty();
        set.put(DataElement::new(tags::CONTOUR_GEOMETRIC_TYPE, VR::CS, kind));
        set.put(DataElement::new(tags::CONTOUR_DATA, vr, data));
        set
    }

    fn structure_set(rois: Vec<(&str, &str, Vec<InMemDicomObject>)>) -> InMemDicomObject {
        let (mut names, mut contours) = (Vec::new(), Vec::new());
        for (number, name, of) in rois {
            let mut roi = InMemDicomObject::new_empty();
            roi.put(DataElement::new(tags::ROI_NUMBER, VR::IS, number));
            roi.put(DataElement::new(tags::ROI_NAME, VR::LO, name));
            names.push(roi);
            let mut roi = InMemDicomObject::new_empty();
            roi.put(DataElement::new(tags::REFERENCED_ROI_NUMBER, VR::IS, number));
            let color = ["255", "128", "0"].map(String::from);
            let color = PrimitiveValue::Strs(color.as_slice().into());
            roi.put(DataElement::new(tags::ROI_DISPLAY_COLOR, VR::IS, color));
            roi.put(DataElement::new(tags::CONTOUR_SEQUENCE, VR::SQ, sequence(of)));
            contours.push(roi);
        }
        let mut set = InMemDicomObject::new_empty();
        set.put(DataElement::new(
            tags::STRUCTURE_SET_ROI_SEQUENCE,
            VR::SQ,
            sequence(names),
        ));
        set.put(DataElement::new(
            tags::ROI_CONTOUR_SEQUENCE,
            VR::SQ,
            sequence(contours),
        ));
        set
    }

    const SQUARE: &str = "0\\0\\5\\9\\0\\5\\9\\9\\5\\0\\9\\5";

    #[test]
    fn contours_of_every_kind() {
        let bytes = PrimitiveValue::from(format!("{SQUARE} ").into_bytes());
        let set = structure_set(vec![
            (
                "7",
                "body",
                vec![
                    contour("CLOSED_PLANAR", SQUARE.into(), VR::DS),
                    contour("CLOSED_PLANAR", SQUARE.into(), VR::DS),
                    contour("CLOSEDPLANAR_XOR", "1\\1\\5\\2\\1\\5\\2\\2\\5".into(), VR::DS),
                    contour("CLOSED_PLANAR", bytes, VR::UN),
                    contour("CLOSED_PLANAR", "1\\1\\5\\2\\1\\5\\2\\2".into(), VR::DS),
                    contour("CLOSED_PLANAR", "1\\1\\5\\2\\1\\5".into(), VR::DS),
                    contour("CLOSED_PLANAR", "1\\1\\NaN\\2\\1\\5\\2\\2\\5".into(), VR::DS),
                    contour("CLOSED_PLANAR", "1\\1\\5\\2\\1e30\\5\\2\\2\\5".into(), VR::DS),
                    contour("OPEN_PLANAR", SQUARE.into(), VR::DS),
                ],
            ),
            ("3", "isocentre", vec![contour("POINT", "1\\2\\3".into(), VR::DS)]),
            ("2", "later", vec![]),
            ("5", "heart", vec![contour("", SQUARE.into(), VR::DS)]),
        ]);
        let found = structures(&set).unwrap_or_else(|e| panic!("{e}"));
        let named: Vec<(u32, &str, usize)> = found
            .structures
            .iter()
            .map(|s| (s.number, s.name.as_str(), s.contours.len()))
            .collect();
        assert_eq!(named, [(5, "heart", 1), (7, "body", 2)]);
        assert_eq!(found.structures[0].color, Some([255, 128, 0]));
        assert_eq!(found.structures[1].contours[0][1], DVec3::new(9.0, 0.0, 5.0));
        let notes = found.notes.join("\n");
        for fragment in [
            "1 point and 1 open contour (\"body\", \"isocentre\")",
            "4 contours with fewer than three points",
            "2 contours twice",
            "1 structure without contours: \"later\"",
        ] {
            assert!(notes.contains(fragment), "{fragment}: {notes}");
        }
    }

    #[test]
    fn numbers_that_cannot_be_labels_are_replaced() {
        let square = || vec![contour("CLOSED_PLANAR", SQUARE.into(), VR::DS)];
        for numbers in [["0", "1"], ["4", "4"], ["70000", "1"]] {
            let set = structure_set(vec![(numbers[0], "a", square()), (numbers[1], "b", square())]);
            let found = structures(&set).unwrap_or_else(|e| panic!("{e}"));
            let labels: Vec<u32> = found.structures.iter().map(|s| s.number).collect();
            assert_eq!((labels, found.notes.len()), (vec![1, 2], 1), "{numbers:?}");
        }
        assert!(structures(&structure_set(vec![])).is_err());
    }
}
