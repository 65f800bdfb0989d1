//! OFF (Geomview's object file format), text: `OFF`, the counts of vertices, faces and edges, the
//! vertices, the faces. Our own reader: no maintained library exists.

use super::MeshFileContents;
use glam::Vec3;

pub fn read(bytes: &[u8]) -> Result<MeshFileContents, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "is not text; binary OFF is not supported")?;
    let mut lines = text
        .lines()
        .map(|l| l.split('#').next().unwrap_or("").trim())
        .filter(|l| !l.is_empty());
    let head = lines.next().unwrap_or("");
    let mut head_words = head.split_ascii_whitespace();
    let keyword = head_words.next().unwrap_or("");
    let kind = keyword.strip_suffix("OFF").ok_or("does not begin with OFF")?;
    if kind.contains('4') || kind.contains('n') {
        return Err(format!(
            "is of type {keyword}; only OFF with three coordinates is supported"
        ));
    }
    let rest = head_words.collect::<Vec<_>>().join(" ");
    let counts = if rest.is_empty() {
        lines.next().unwrap_or("")
    } else {
        &rest
    };
    let counts: Vec<u64> = counts
        .split_ascii_whitespace()
        .map_while(|w| w.parse().ok())
        .collect();
    let [vertices, faces, ..] = counts[..] else {
        return Err("does not state the number of its vertices and faces".into());
    };
    // Every vertex and face takes a line of at least two characters: counts that cannot fit are not
    // allocated.
    let room = (bytes.len() / 2) as u64;
    if vertices > room || faces > room {
        return Err(format!(
            "declares {vertices} vertices and {faces} faces, more than a file of {} bytes can hold",
            bytes.len()
        ));
    }
    let mut listing = MeshFileContents::default();
    for n in 0..vertices {
        let line = lines
            .next()
            .ok_or_else(|| format!("ends after {n} of {vertices} vertices"))?;
        let v: Vec<f32> = line
            .split_ascii_whitespace()
            .take(3)
            .map_while(|w| w.parse().ok())
            .collect();
        let [x, y, z] = v[..] else {
            return Err(format!("vertex {n} is \"{line}\", not three numbers"));
        };
        listing.positions.push(Vec3::new(x, y, z));
    }
    for n in 0..faces {
        let line = lines
            .next()
            .ok_or_else(|| format!("ends after {n} of {faces} faces"))?;
        let mut words = line.split_ascii_whitespace().map(|w| w.parse::<i64>().ok());
        let corners = words
            .next()
            .flatten()
            .ok_or_else(|| format!("face {n} is \"{line}\", not a count and indices"))?;
        let indices: Vec<u32> = words
            .take(corners.clamp(0, 1 << 20) as usize)
            .map_while(|w| w.and_then(|v| u32::try_from(v).ok()))
            .collect();
        if indices.len() as i64 != corners {
            return Err(format!(
                "face {n} is \"{line}\": it declares {corners} corners and names {}",
                indices.len()
            ));
        }
        listing.face(&indices);
    }
    Ok(listing)
}
