//! STL, text and binary. Our own reader: real files declare wrong counts, start binary data with
//! "solid" or leave out lines, and the library's reader rejects all of these. Normals are computed
//! from the triangles; those in the file are often wrong.

use super::MeshFileContents;
use glam::Vec3;

const HEADER: usize = 84;
const RECORD: usize = 50;
/// Bytes in which a text file has no zero, but a binary one does.
const TEXT_START: usize = 1024;

pub fn read(bytes: &[u8]) -> Result<MeshFileContents, String> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let declared = bytes
        .get(80..HEADER)
        .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    // The length is the most reliable criterion: many binary files begin with "solid" too.
    if declared.is_some_and(|n| bytes.len() == HEADER + n * RECORD) {
        return Ok(binary(bytes));
    }
    let is_text = bytes
        .trim_ascii_start()
        .get(..5)
        .is_some_and(|w| w.eq_ignore_ascii_case(b"solid"))
        && !bytes[..bytes.len().min(TEXT_START)].contains(&0)
        && bytes.windows(6).any(|w| w.eq_ignore_ascii_case(b"vertex"));
    if is_text {
        return text(&String::from_utf8_lossy(bytes));
    }
    let (Some(declared), true) = (declared, bytes.len() >= HEADER + RECORD) else {
        return Err(
            "is neither a text STL (no \"solid\" with vertices) nor long enough for a binary one".into(),
        );
    };
    let mut listing = binary(bytes);
    let room = (bytes.len() - HEADER) / RECORD;
    listing.warnings.push(if declared == room {
        format!(
            "has {} bytes after its triangles, which were left out",
            bytes.len() - HEADER - room * RECORD
        )
    } else {
        format!("declares {declared} triangles but holds {room}; all it holds were read")
    });
    Ok(listing)
}

fn binary(bytes: &[u8]) -> MeshFileContents {
    let mut listing = MeshFileContents::default();
    for record in bytes[HEADER..].chunks_exact(RECORD) {
        let first = listing.positions.len() as u32;
        let value = |n: usize| {
            f32::from_le_bytes([
                record[4 * n],
                record[4 * n + 1],
                record[4 * n + 2],
                record[4 * n + 3],
            ])
        };
        // The numbers after the normal.
        listing
            .positions
            .extend((1..4).map(|v| Vec3::new(value(3 * v), value(3 * v + 1), value(3 * v + 2))));
        listing.triangles.push([first, first + 1, first + 2]);
    }
    listing
}

fn text(text: &str) -> Result<MeshFileContents, String> {
    let mut listing = MeshFileContents::default();
    let mut face: Vec<u32> = Vec::new();
    let (mut polygons, mut ended) = (0, false);
    for (n, line) in text.lines().enumerate() {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let is = |at: usize, word: &str| words.get(at).is_some_and(|w| w.eq_ignore_ascii_case(word));
        let mut at = 0;
        while at < words.len() {
            match words[at].to_ascii_lowercase().as_str() {
                "vertex" => {
                    let number = |k: usize| words.get(at + k).and_then(|w| w.parse::<f32>().ok());
                    let (Some(x), Some(y), Some(z)) = (number(1), number(2), number(3)) else {
                        return Err(format!("line {}: a vertex needs three numbers", n + 1));
                    };
                    face.push(listing.positions.len() as u32);
                    listing.positions.push(Vec3::new(x, y, z));
                    at += 3;
                }
                // An unclosed loop ends with its facet, or where the next one begins.
                word @ ("endloop" | "endfacet" | "facet" | "endsolid" | "solid") => {
                    if !face.is_empty() {
                        polygons += usize::from(face.len() > 3);
                        listing.face(&face);
                        face.clear();
                    }
                    if matches!(word, "solid" | "endsolid") {
                        ended = word == "endsolid";
                        // A name of any words follows, up to the next statement.
                        while at + 1 < words.len()
                            && !(is(at + 1, "facet") && is(at + 2, "normal") && words.len() > at + 6)
                            && !is(at + 1, "solid")
                        {
                            at += 1;
                        }
                    }
                }
                _ => {}
            }
            at += 1;
        }
    }
    if !face.is_empty() {
        listing.face(&face);
    }
    if polygons > 0 {
        listing.warnings.push(format!(
            "{polygons} faces with more than three corners were divided"
        ));
    }
    if !ended {
        listing
            .warnings
            .push("ends without \"endsolid\"; it may be truncated".into());
    }
    Ok(listing)
}
