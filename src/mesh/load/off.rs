//! OFF (Geomview's object file format), text: a keyword, the counts of vertices, faces and edges,
//! the vertices, the faces. Our own reader: no maintained library exists. The keyword, its blank
//! before the counts (the files of ModelNet40 lack it) and the count of edges may be missing;
//! normals, colours and texture coordinates after the positions are not read. Source: Geomview
//! manual, "OFF".

use super::MeshFileContents;
use glam::Vec3;

pub fn read(bytes: &[u8]) -> Result<MeshFileContents, String> {
    let text = String::from_utf8_lossy(bytes);
    let mut lines = text
        .lines()
        .map(|l| l.split('#').next().unwrap_or("").trim())
        .filter(|l| !l.is_empty());
    let first = lines.next().unwrap_or("");
    let (kind, mut rest) = keyword(first)?;
    if rest.to_ascii_uppercase().starts_with("BINARY") {
        return Err("is a binary OFF; save it as text, or as .ply or .stl".into());
    }
    let mut next = || lines.next().unwrap_or("");
    if kind.contains('n') {
        let dimension = if rest.is_empty() { next() } else { rest };
        if dimension != "3" {
            return Err(format!(
                "has the dimension \"{dimension}\"; only OFF with three coordinates can be read"
            ));
        }
        rest = "";
    }
    let counts = if rest.is_empty() { next() } else { rest };
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
    let homogeneous = kind.contains('4');
    for n in 0..vertices {
        let line = lines
            .next()
            .ok_or_else(|| format!("ends after {n} of {vertices} vertices"))?;
        listing.positions.push(vertex(line, homogeneous).ok_or_else(|| {
            let numbers = if homogeneous { "four" } else { "three" };
            format!("vertex {n} is \"{line}\", not {numbers} numbers")
        })?);
    }
    for n in 0..faces {
        let line = lines
            .next()
            .ok_or_else(|| format!("ends after {n} of {faces} faces"))?;
        let corners = face(line).map_err(|problem| format!("face {n} is \"{line}\"{problem}"))?;
        listing.face(&corners);
    }
    Ok(listing)
}

/// The letters before "OFF", and the rest of the line. A file may begin with the counts.
fn keyword(line: &str) -> Result<(&str, &str), String> {
    let line = line.trim_start_matches('\u{feff}');
    if let Some(at) = line.find("OFF").or_else(|| line.find("off"))
        && line[..at].chars().all(|c| "STCN4n".contains(c))
    {
        return Ok((&line[..at], line[at + 3..].trim()));
    }
    let counts = line.split_ascii_whitespace().all(|w| w.parse::<u64>().is_ok());
    if counts && !line.is_empty() {
        return Ok(("", line));
    }
    Err("does not begin with OFF".into())
}

/// The position of a vertex; a fourth coordinate divides the others.
fn vertex(line: &str, homogeneous: bool) -> Option<Vec3> {
    let mut numbers = line.split_ascii_whitespace().map(|w| w.parse::<f32>().ok());
    let mut number = || numbers.next().flatten();
    let p = Vec3::new(number()?, number()?, number()?);
    Some(if homogeneous { p / number()? } else { p })
}

/// The corners of a face: their number, then their vertices; colours may follow.
fn face(line: &str) -> Result<Vec<u32>, String> {
    let mut words = line.split_ascii_whitespace().map(|w| w.parse::<i64>().ok());
    let corners = words.next().flatten().ok_or(", not a count and indices")?;
    let indices: Vec<u32> = words
        .take(corners.clamp(0, 1 << 20) as usize)
        .map_while(|w| w.and_then(|v| u32::try_from(v).ok()))
        .collect();
    if indices.len() as i64 != corners {
        return Err(format!(
            ": it declares {corners} corners and names {}",
            indices.len()
        ));
    }
    Ok(indices)
}
