//! Bilevel images compressed as by a fax machine: CCITT modified Huffman (TIFF compression 2),
//! Group 3 in one and two dimensions (3) and Group 4 (4).
//!
//! Source: ITU-T T.4 and T.6; TIFF 6.0 sections 10 and 11. The code tables are those of the crate
//! `fax`; its own loops expect line ends that TIFFs may lack, and decode no two-dimensional Group
//! 3.

use fax::maps::{Mode, black, mode, white};
use fax::{BitReader, ByteReader};
use std::convert::Infallible;

/// The variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FaxKind {
    /// Lines of whole bytes without line ends.
    Huffman,
    /// Group 3; whether lines may refer to the one before.
    Group3 {
        two_dimensional: bool,
    },
    Group4,
}

/// Decodes `rows` lines to one bit per pixel, 1 for black, each line in whole bytes. Lines after
/// the end of the data are white.
///
/// # Errors
/// A line that cannot be decoded.
pub(super) fn decode(kind: FaxKind, bytes: &[u8], width: usize, rows: usize) -> Result<Vec<u8>, String> {
    let columns = u16::try_from(width).map_err(|_| "its lines are longer than 65535 pixels".to_owned())?;
    // The code tables look ahead.
    let source = bytes.iter().copied().chain([0u8; 4]).map(Ok::<u8, Infallible>);
    let mut reader = ByteReader::new(source).map_err(|_| "no data".to_owned())?;
    let row_bytes = width.div_ceil(8);
    let mut out = vec![0u8; row_bytes * rows];
    let mut line: Vec<u16> = Vec::new();
    for row in out.chunks_exact_mut(row_bytes.max(1)) {
        let decoded = match kind {
            FaxKind::Huffman => {
                let decoded = runs(&mut reader, columns);
                let rest = reader.bits_to_byte_boundary();
                let _end = reader.consume(rest);
                decoded
            }
            FaxKind::Group3 { two_dimensional } => {
                if end_of_line(&mut reader) == LineEnd::EndOfData {
                    break;
                }
                let one_dimensional = !two_dimensional || bit(&mut reader) == 1;
                if one_dimensional {
                    runs(&mut reader, columns)
                } else {
                    two_dimensional_line(&mut reader, &line, columns)
                }
            }
            FaxKind::Group4 => two_dimensional_line(&mut reader, &line, columns),
        };
        match decoded {
            Some(changes) => line = changes,
            None if at_end(&mut reader, kind) => break,
            None => return Err("a line is damaged".into()),
        }
        for pair in line.chunks(2) {
            let end = pair.get(1).copied().unwrap_or(columns).min(columns);
            for x in usize::from(pair[0])..usize::from(end) {
                row[x / 8] |= 0x80 >> (x % 8);
            }
        }
    }
    Ok(out)
}

/// What stands before a line of Group 3.
#[derive(PartialEq, Eq)]
enum LineEnd {
    Line,
    EndOfData,
}

/// The next bit; 0 at the end.
fn bit(reader: &mut impl BitReader) -> u16 {
    let next = reader.peek(1).unwrap_or(0);
    let _end = reader.consume(1);
    next
}

/// Skips the end of the line before, with its fill bits, if there is one.
fn end_of_line(reader: &mut impl BitReader) -> LineEnd {
    if reader.peek(11) != Some(0) {
        return if reader.peek(1).is_none() {
            LineEnd::EndOfData
        } else {
            LineEnd::Line
        };
    }
    loop {
        match reader.peek(1) {
            None => return LineEnd::EndOfData,
            Some(0) => {
                let _end = reader.consume(1);
            }
            Some(_) => {
                let _end = reader.consume(1);
                // Several line ends in sequence are the end of the page.
                return if reader.peek(11) == Some(0) {
                    LineEnd::EndOfData
                } else {
                    LineEnd::Line
                };
            }
        }
    }
}

/// Whether only the end mark or nothing is left.
fn at_end(reader: &mut impl BitReader, kind: FaxKind) -> bool {
    kind == FaxKind::Group4
        && (reader.peek(16).is_none() || reader.peek(11) == Some(0) || reader.peek(11) == Some(1))
}

/// One run of white or black.
fn run(reader: &mut impl BitReader, is_black: bool) -> Option<u16> {
    let mut sum = 0u16;
    loop {
        let part = if is_black {
            black::decode(reader)?
        } else {
            white::decode(reader)?
        };
        sum = sum.checked_add(part)?;
        if part < 64 {
            return Some(sum);
        }
    }
}

/// A line of runs, as the positions at which the colour changes, white first.
fn runs(reader: &mut impl BitReader, width: u16) -> Option<Vec<u16>> {
    let (mut changes, mut at, mut is_black) = (Vec::new(), 0u16, false);
    while at < width {
        at = at.checked_add(run(reader, is_black)?)?;
        changes.push(at.min(width));
        is_black = !is_black;
    }
    Some(changes)
}

/// A line that refers to the one before.
fn two_dimensional_line(reader: &mut impl BitReader, above: &[u16], width: u16) -> Option<Vec<u16>> {
    let (mut changes, mut at, mut is_black, mut is_start) = (Vec::new(), 0u16, false, true);
    while at < width {
        // The next change above, right of `at`, to the colour opposite to the present one.
        let parity = usize::from(is_black);
        let first = (parity..above.len())
            .step_by(2)
            .find(|n| above[*n] > at || is_start && above[*n] == 0);
        let b1 = first.map_or(width, |n| above[n]);
        let b2 = first.and_then(|n| above.get(n + 1)).copied().unwrap_or(width);
        match mode::decode(reader)? {
            Mode::Pass => at = b2,
            Mode::Vertical(by) => {
                let to = u16::try_from(i32::from(b1) + i32::from(by)).ok()?.min(width);
                if to < at {
                    return None;
                }
                at = to;
                changes.push(at);
                is_black = !is_black;
            }
            Mode::Horizontal => {
                for color in [is_black, !is_black] {
                    at = at.checked_add(run(reader, color)?)?.min(width);
                    changes.push(at);
                }
            }
            Mode::Extension | Mode::EOF => return None,
        }
        is_start = false;
    }
    Some(changes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn group_4_lines_refer_to_the_line_above() {
        // Horizontal mode, three white, two black; vertical 0, twice; then the end mark.
        let mut bits = String::from("001") + "1000" + "11";
        bits += "1";
        bits += "111";
        bits += "000000000001000000000001";
        while !bits.len().is_multiple_of(8) {
            bits.push('0');
        }
        let bytes: Vec<u8> = (0..bits.len() / 8)
            .map(|n| u8::from_str_radix(&bits[8 * n..8 * n + 8], 2).unwrap_or(0))
            .collect();
        assert_eq!(
            decode(FaxKind::Group4, &bytes, 8, 3),
            Ok(vec![0b0001_1000, 0b0001_1000, 0])
        );
    }

    #[test]
    fn damaged_data_end_in_a_message() {
        for kind in [
            FaxKind::Huffman,
            FaxKind::Group3 {
                two_dimensional: true,
            },
            FaxKind::Group4,
        ] {
            for seed in 0..200u32 {
                let bytes: Vec<u8> = (0..40)
                    .map(|n| (seed.wrapping_mul(37) ^ (n * n * 71)) as u8)
                    .collect();
                let _any = decode(kind, &bytes, 100, 20);
            }
        }
    }
}
