//! Colour tables: plain or segmented, with entries of 8 or 16 bits.
//!
//! Source: DICOM PS3.3 C.7.6.3.1.5 and C.7.6.3.1.6 (descriptor and data), C.7.9.2 (segments).

use super::element::numbers;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;

/// The tables of red, green and blue, 8 bits each: the first value mapped, and the entries.
pub type Palette = [(i64, Vec<u8>); 3];

/// Descriptor, data and segmented data of each colour.
const CHANNELS: [[Tag; 3]; 3] = [
    [
        tags::RED_PALETTE_COLOR_LOOKUP_TABLE_DESCRIPTOR,
        tags::RED_PALETTE_COLOR_LOOKUP_TABLE_DATA,
        tags::SEGMENTED_RED_PALETTE_COLOR_LOOKUP_TABLE_DATA,
    ],
    [
        tags::GREEN_PALETTE_COLOR_LOOKUP_TABLE_DESCRIPTOR,
        tags::GREEN_PALETTE_COLOR_LOOKUP_TABLE_DATA,
        tags::SEGMENTED_GREEN_PALETTE_COLOR_LOOKUP_TABLE_DATA,
    ],
    [
        tags::BLUE_PALETTE_COLOR_LOOKUP_TABLE_DESCRIPTOR,
        tags::BLUE_PALETTE_COLOR_LOOKUP_TABLE_DATA,
        tags::SEGMENTED_BLUE_PALETTE_COLOR_LOOKUP_TABLE_DATA,
    ],
];

/// The palette of an object; `signed`: whether its pixels are.
pub fn palette(set: &InMemDicomObject, signed: bool) -> Option<Palette> {
    let [r, g, b] = CHANNELS.map(|tags| channel(set, tags, signed));
    Some([r?, g?, b?])
}

fn channel(
    set: &InMemDicomObject,
    [descriptor, plain, segmented]: [Tag; 3],
    signed: bool,
) -> Option<(i64, Vec<u8>)> {
    let d = numbers(set, descriptor)?;
    let [entries, first, bits] = *d.get(..3)? else {
        return None;
    };
    let entries = if entries == 0.0 {
        65_536
    } else {
        (entries.abs() as usize).clamp(1, 65_536)
    };
    // The descriptor may have been read as unsigned.
    let first = if signed && first > 32_767.0 {
        first - 65_536.0
    } else {
        first
    };
    let words = |tag: Tag| -> Option<Vec<u8>> { Some(set.get(tag)?.value().to_bytes().ok()?.into_owned()) };
    let values: Vec<u16> = match (words(plain).filter(|b| !b.is_empty()), words(segmented)) {
        // Entries of 8 bits may each take a word.
        (Some(bytes), _) if bits <= 8.0 && bytes.len() < 2 * entries => {
            bytes.iter().map(|b| u16::from(*b)).collect()
        }
        (Some(bytes), _) => of_words(&bytes),
        (None, Some(bytes)) if bits <= 8.0 => {
            let bytes: Vec<u16> = bytes.iter().map(|b| u16::from(*b)).collect();
            expanded(&bytes, entries, 1)
        }
        (None, Some(bytes)) => expanded(&of_words(&bytes), entries, 2),
        (None, None) => return None,
    };
    let highest = values.iter().copied().max()?;
    // Some writers declare 16 bits for values of 8.
    let byte = |v: u16| {
        if bits > 8.0 && highest > 255 {
            (v >> 8) as u8
        } else {
            v.min(255) as u8
        }
    };
    Some((first as i64, values.into_iter().take(entries).map(byte).collect()))
}

fn of_words(bytes: &[u8]) -> Vec<u16> {
    bytes
        .chunks_exact(2)
        .map(|b| u16::from_ne_bytes([b[0], b[1]]))
        .collect()
}

/// The entries of a segmented table, at most `entries`; `width` is the number of bytes of an item.
fn expanded(data: &[u16], entries: usize, width: usize) -> Vec<u16> {
    let mut out = Vec::new();
    // Indirect segments repeat earlier ones; each is followed once.
    run(data, 0, data.len(), entries, width, true, &mut out);
    out.truncate(entries);
    out
}

/// Appends up to `count` segments from an offset on.
fn run(
    data: &[u16],
    start: usize,
    count: usize,
    entries: usize,
    width: usize,
    indirect: bool,
    out: &mut Vec<u16>,
) {
    let mut at = start;
    for _ in 0..count {
        let (Some(&kind), Some(&length)) = (data.get(at), data.get(at + 1)) else {
            return;
        };
        let length = usize::from(length);
        if length == 0 {
            return;
        }
        match kind {
            0 => {
                let end = (at + 2 + length).min(data.len());
                out.extend(&data[at + 2..end]);
                at = end;
            }
            1 => {
                let (Some(&to), Some(&from)) = (data.get(at + 2), out.last()) else {
                    return;
                };
                let (from, to) = (f64::from(from), f64::from(to));
                out.extend(
                    (1..=length).map(|n| (from + (to - from) * n as f64 / length as f64).round() as u16),
                );
                at += 3;
            }
            2 if indirect => {
                // An offset in bytes, low word first.
                let part = |n: usize| data.get(at + 2 + n).map(|v| usize::from(*v));
                let offset = if width == 2 {
                    part(0).zip(part(1)).map(|(low, high)| (low | high << 16) / 2)
                } else {
                    (0..4).try_fold(0usize, |sum, n| Some(sum | part(n)? << (8 * n)))
                };
                let Some(offset) = offset else { return };
                run(data, offset, length, entries, width, false, out);
                at += if width == 2 { 4 } else { 6 };
            }
            _ => return,
        }
        if out.len() >= entries {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_of_the_standard() {
        // Discrete, linear, and an indirect repetition of both.
        let data = [0, 2, 10, 20, 1, 2, 40, 2, 2, 0, 0];
        assert_eq!(expanded(&data, 8, 2), [10, 20, 30, 40, 10, 20, 30, 40]);
        // A linear segment without an entry before it, and one that is cut off.
        assert_eq!(expanded(&[1, 2, 40], 8, 2), Vec::<u16>::new());
        assert_eq!(expanded(&[0, 9, 1], 8, 2), [1]);
    }
}
