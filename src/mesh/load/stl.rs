//! STL, text and binary. Our own reader: real files declare wrong counts, start binary data with
//! "solid" or leave out lines, and the library's reader rejects all of these. Normals are computed
//! from the triangles; those in the file are often wrong.

use super::MeshFileContents;
use glam::Vec3;

const HEADER: usize = 84;
const RECORD: usize = 50;

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
    listing.warnings.push(format!(
        "declares {declared} triangles and has room for {}; those were read",
        (bytes.len() - HEADER) / RECORD
    ));
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
        let mut words = line.split_ascii_whitespace();
        match words.next().map(str::to_ascii_lowercase).as_deref() {
            Some("vertex") => {
                let mut coordinate = || words.next().and_then(|w| w.parse::<f32>().ok());
                let (Some(x), Some(y), Some(z)) = (coordinate(), coordinate(), coordinate()) else {
                    return Err(format!("line {}: a vertex needs three numbers", n + 1));
                };
                face.push(listing.positions.len() as u32);
                listing.positions.push(Vec3::new(x, y, z));
            }
            // An unclosed loop ends with its facet, or where the next one begins.
            Some("endloop" | "endfacet" | "facet" | "endsolid") if !face.is_empty() => {
                polygons += usize::from(face.len() > 3);
                listing.face(&face);
                face.clear();
                ended = line.trim_start().to_ascii_lowercase().starts_with("endsolid");
            }
            Some("endsolid") => ended = true,
            Some("solid") => ended = false,
            _ => {}
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
