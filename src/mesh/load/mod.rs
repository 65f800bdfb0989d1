//! Mesh files: one module per format. Formats that a library reads well are left to that library.

mod gifti;
mod gltf;
mod obj;
mod off;
mod ply;
mod stl;

use super::Mesh;
use crate::files::input;
use crate::{Error, Result};
use glam::Vec3;
use std::path::Path;

/// Extensions of mesh files; any of them may be followed by `.gz`.
pub const ENDINGS: [&str; 7] = ["stl", "obj", "ply", "off", "gltf", "glb", "gii"];

/// Maximum size of a file, bytes; files are read as a whole.
const MAX_BYTES: u64 = 4 << 30;
/// Maximum number of triangles: indices have 32 bits, and distances to more would take hours.
const MAX_TRIANGLES: usize = 200_000_000;

/// The content of a file.
#[derive(Default)]
struct MeshFileContents {
    positions: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    warnings: Vec<String>,
    /// Number of unusable faces.
    unusable: usize,
}

impl MeshFileContents {
    /// A face with any number of corners, as a triangle fan.
    fn face(&mut self, corners: &[u32]) {
        if corners.len() < 3 {
            self.unusable += 1;
            return;
        }
        for n in 1..corners.len() - 1 {
            self.triangles.push([corners[0], corners[n], corners[n + 1]]);
        }
    }
}

/// Whether a path has the extension of a mesh file.
pub fn is_mesh(path: &Path) -> bool {
    ending(path).is_some()
}

fn ending(path: &Path) -> Option<&'static str> {
    let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    ENDINGS
        .into_iter()
        .find(|e| name.strip_suffix(e).is_some_and(|stem| stem.ends_with('.')))
}

/// Reads a mesh.
///
/// # Errors
/// A file that cannot be read or contains no triangle; the message names it and the problem.
pub fn mesh(path: &Path) -> Result<Mesh> {
    let ending = ending(path).ok_or_else(|| {
        Error::file(
            path,
            format!(
                "does not have a mesh file extension; known extensions: {}",
                ENDINGS.join(", ")
            ),
        )
    })?;
    let bytes = input::unzipped_bytes(path, MAX_BYTES, "mesh")?;
    parse(&bytes, ending, Some(path)).map_err(|problem| Error::file(path, problem))
}

/// Reads a mesh from memory; `path` is the file that it comes from, and files that it references
/// are looked up in the same folder.
///
/// # Errors
/// The problem, in a sentence without the file's name.
pub fn parse(bytes: &[u8], ending: &str, path: Option<&Path>) -> Result<Mesh, String> {
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return Err("is empty".into());
    }
    let mut listing = match ending {
        "stl" => stl::read(bytes),
        "obj" => obj::read(bytes),
        "ply" => ply::read(bytes),
        "off" => off::read(bytes),
        "gltf" | "glb" => gltf::read(bytes, path),
        _ => gifti::read(bytes),
    }?;
    if listing.unusable > 0 {
        listing.warnings.push(format!(
            "{} faces with fewer than three corners were left out",
            listing.unusable
        ));
    }
    if listing.triangles.len() > MAX_TRIANGLES {
        return Err(format!(
            "has {} triangles; at most {MAX_TRIANGLES} are read",
            listing.triangles.len()
        ));
    }
    let count = listing.positions.len();
    if let Some(bad) = listing.triangles.iter().flatten().find(|&&v| v as usize >= count) {
        return Err(format!(
            "has a face that names vertex {bad} (counted from 0), but only {count} vertices"
        ));
    }
    let mesh = Mesh::new(listing.positions, listing.triangles, listing.warnings);
    if mesh.triangles.is_empty() {
        return Err(match mesh.degenerate {
            0 => "holds no triangle".into(),
            n => format!("contains no triangle with a nonzero area ({n} degenerate)"),
        });
    }
    Ok(mesh)
}
