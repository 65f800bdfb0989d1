//! Mesh files: one module per format. Formats that a library reads well are left to that library.

mod gifti;
mod gltf;
mod obj;
mod off;
mod ply;
mod polygon;
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
    /// Corners of the faces with more than three, one face after the other.
    corners: Vec<u32>,
    /// The end of each of these faces in `corners`.
    face_ends: Vec<usize>,
    warnings: Vec<String>,
    /// Number of unusable faces.
    unusable: usize,
}

impl MeshFileContents {
    /// A face with any number of corners.
    fn face(&mut self, corners: &[u32]) {
        match *corners {
            [] | [_] | [_, _] => self.unusable += 1,
            [a, b, c] => self.triangles.push([a, b, c]),
            _ => {
                self.corners.extend_from_slice(corners);
                self.face_ends.push(self.corners.len());
            }
        }
    }

    /// Divides faces with more than three corners into triangles; their vertices exist.
    fn divide_faces(&mut self) {
        let (mut start, mut fans) = (0, 0);
        for &end in &self.face_ends {
            let face = &self.corners[start..end];
            fans += usize::from(!polygon::triangulate(&self.positions, face, &mut self.triangles));
            start = end;
        }
        if fans > 0 {
            self.warnings.push(format!(
                "{fans} faces that are not convex have more than {} corners and were triangulated as if they were convex; triangulate them in a modelling program",
                polygon::MAX_CORNERS
            ));
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
        _ => gifti::read(bytes, path),
    }?;
    if listing.unusable > 0 {
        listing.warnings.push(format!(
            "{} faces with fewer than three corners were left out",
            listing.unusable
        ));
    }
    let triangles = listing.triangles.len() + listing.corners.len() - 2 * listing.face_ends.len();
    if triangles > MAX_TRIANGLES {
        return Err(format!(
            "has {triangles} triangles; at most {MAX_TRIANGLES} are read"
        ));
    }
    let count = listing.positions.len();
    let mut named = listing.triangles.iter().flatten().chain(&listing.corners);
    if let Some(bad) = named.find(|&&v| v as usize >= count) {
        return Err(format!(
            "has a face that names vertex {bad} (counted from 0), but only {count} vertices"
        ));
    }
    listing.divide_faces();
    let mesh = Mesh::new(listing.positions, listing.triangles, listing.warnings);
    if mesh.triangles.is_empty() {
        return Err(match mesh.degenerate {
            0 => "holds no triangle".into(),
            n => format!("contains no triangle with a nonzero area ({n} degenerate)"),
        });
    }
    Ok(mesh)
}
