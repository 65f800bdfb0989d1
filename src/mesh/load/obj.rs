//! Wavefront OBJ: its vertices and faces. Our own reader: only the shape matters, so that an
//! invalid line about materials, or a name in another encoding, is no reason to reject a file; and
//! polygons must keep their corners to be divided correctly. Source: Wavefront, "Object Files
//! (.obj)", 1995.

use super::MeshFileContents;
use glam::Vec3;

/// Statements of curves and surfaces that are not made of polygons.
const FREE_FORM: [&str; 3] = ["curv", "curv2", "surf"];

pub fn read(bytes: &[u8]) -> Result<MeshFileContents, String> {
    let mut listing = MeshFileContents::default();
    let mut face = Vec::new();
    let mut free_form = 0;
    // Files of classic Mac OS end their lines with carriage returns alone.
    let end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    let mut continued = String::new();
    for (n, line) in bytes.split(|b| *b == end).enumerate() {
        let line = String::from_utf8_lossy(line);
        let line = line.split('#').next().unwrap_or("").trim();
        if let Some(start) = line.strip_suffix('\\') {
            continued.push_str(start);
            continued.push(' ');
            continue;
        }
        let joined = if continued.is_empty() {
            line
        } else {
            continued.push_str(line);
            &continued
        };
        let mut words = joined.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                // A weight or a colour may follow.
                let mut number = || words.next().and_then(|w| w.parse::<f32>().ok());
                let (Some(x), Some(y), Some(z)) = (number(), number(), number()) else {
                    return Err(format!(
                        "has \"{joined}\" in line {}; a vertex needs three numbers",
                        n + 1
                    ));
                };
                listing.positions.push(Vec3::new(x, y, z));
            }
            // "fo" is its name in old files.
            Some("f" | "fo") => {
                face.clear();
                for word in words {
                    face.push(corner(word, listing.positions.len()).map_err(|problem| {
                        format!("has \"{word}\" in a face in line {}; {problem}", n + 1)
                    })?);
                }
                listing.face(&face);
            }
            Some(word) if FREE_FORM.contains(&word) => free_form += 1,
            _ => {}
        }
        continued.clear();
    }
    if free_form > 0 {
        listing.warnings.push(format!(
            "holds {free_form} free-form curves or surfaces, which were left out; only polygons are read"
        ));
    }
    Ok(listing)
}

/// The vertex of a face's corner, `v`, `v/vt`, `v//vn` or `v/vt/vn`, counted from 1, or from the
/// last one if negative.
fn corner(word: &str, vertices: usize) -> Result<u32, String> {
    let number = word.split('/').next().unwrap_or("").parse::<i64>().ok();
    let index = match number {
        Some(0) => return Err("vertices are counted from 1".into()),
        Some(n) if n > 0 => n - 1,
        Some(n) => vertices as i64 + n,
        None => return Err("it is not a vertex number".into()),
    };
    u32::try_from(index)
        .map_err(|_| format!("it refers to a vertex that does not exist ({vertices} precede it)"))
}
