//! Wavefront OBJ, by the tobj library. Materials and their files are not read.

use super::MeshFileContents;
use glam::Vec3;

pub fn read(bytes: &[u8]) -> Result<MeshFileContents, String> {
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..tobj::LoadOptions::default()
    };
    let no_materials = |_: &std::path::Path| Err(tobj::LoadError::OpenFileFailed);
    // Only the shape matters: an invalid line about materials, or a name or comment in another
    // encoding, is no reason to reject the file.
    let joined = join_continued(bytes);
    let is_shape = |line: &&[u8]| matches!(line.trim_ascii_start().first(), Some(b'v' | b'f'));
    let shape: Vec<u8> = joined
        .split_inclusive(|b| *b == b'\n')
        .filter(is_shape)
        .flatten()
        .copied()
        .collect();
    let (models, _materials) = tobj::load_obj_buf(&mut std::io::Cursor::new(shape), &options, no_materials)
        .map_err(|e| format!("is not a readable OBJ: {e}; a vertex or face line is malformed, or a face refers to a vertex that does not exist"))?;
    let mut listing = MeshFileContents::default();
    for model in models {
        let first = listing.positions.len() as u32;
        listing
            .positions
            .extend(model.mesh.positions.chunks_exact(3).map(Vec3::from_slice));
        listing.triangles.extend(
            model
                .mesh
                .indices
                .chunks_exact(3)
                .map(|t| [t[0] + first, t[1] + first, t[2] + first]),
        );
    }
    Ok(listing)
}

/// Joins lines continued by a backslash, which the library does not support.
fn join_continued(bytes: &[u8]) -> Vec<u8> {
    let mut joined = Vec::with_capacity(bytes.len());
    for line in bytes.split_inclusive(|b| *b == b'\n') {
        match line.trim_ascii_end().strip_suffix(b"\\") {
            Some(start) => {
                joined.extend_from_slice(start);
                joined.push(b' ');
            }
            None => joined.extend_from_slice(line),
        }
    }
    joined
}
