//! Values of single elements of a data set.

use dicom_core::Tag;
use dicom_object::InMemDicomObject;

/// The text of an element, without padding and control characters.
pub fn text(set: &InMemDicomObject, tag: Tag) -> String {
    set.get(tag)
        .and_then(|e| e.to_str().ok())
        .map(|t| t.replace(char::is_control, " ").trim().to_owned())
        .unwrap_or_default()
}

/// Numbers of an element; none if it has none, or any cannot be parsed.
pub fn numbers(set: &InMemDicomObject, tag: Tag) -> Option<Vec<f64>> {
    set.get(tag)?
        .to_multi_float64()
        .ok()
        .filter(|v| !v.is_empty() && v.iter().all(|n| n.is_finite()))
}

/// The first number of an element.
pub fn number(set: &InMemDicomObject, tag: Tag) -> Option<f64> {
    numbers(set, tag)?.first().copied()
}

/// The first `N` numbers of an element.
pub fn vector<const N: usize>(set: &InMemDicomObject, tag: Tag) -> Option<[f64; N]> {
    numbers(set, tag)?.get(..N)?.try_into().ok()
}

/// The first item of a sequence.
pub fn item(set: &InMemDicomObject, tag: Tag) -> Option<&InMemDicomObject> {
    set.get(tag)?.items()?.first()
}

/// The first number of an element as an unsigned 16-bit integer; none if it is out of range.
pub fn whole_number(set: &InMemDicomObject, tag: Tag) -> Option<u16> {
    number(set, tag)
        .filter(|n| (0.0..=65_535.0).contains(n))
        .map(|n| n as u16)
}

/// The numbers of a private attribute, by its creator.
pub fn private_numbers(set: &InMemDicomObject, group: u16, creator: &str, element: u16) -> Option<Vec<f64>> {
    let is_creator = |tag: Tag| tag.0 == group && (0x10..0x100).contains(&tag.1);
    let block = set
        .iter()
        .map(|e| e.header().tag)
        .find(|tag| is_creator(*tag) && text(set, *tag).starts_with(creator))?
        .1;
    numbers(set, Tag(group, block << 8 | element))
}

/// The first number of a private attribute, by its creator.
pub fn private_number(set: &InMemDicomObject, group: u16, creator: &str, element: u16) -> Option<f64> {
    private_numbers(set, group, creator, element)?.first().copied()
}
