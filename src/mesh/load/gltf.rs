//! glTF 2 (`.gltf`, `.glb`), by the gltf library: the triangles of every mesh, placed by its nodes.
//! glTF uses metres and a y-up frame; illustrated models have no scale of their own, hence numbers
//! are taken as millimetres and axes are unchanged.

use super::MeshFileContents;
use crate::Error;
use crate::files::{input, reference};
use crate::panic_guard::catch_panic;
use base64::Engine;
use glam::{Mat4, Vec3};
use gltf::mesh::Mode;
use serde_json::Value;
use std::path::Path;

/// Maximum depth of the node tree: a file can list a node as its own child.
const DEEPEST: usize = 64;

/// Maximum number of node visits: a file can list a node as the child of many.
const MAX_NODE_VISITS: usize = 1_000_000;

pub fn read(bytes: &[u8], path: Option<&Path>) -> Result<MeshFileContents, String> {
    sound(bytes)?;
    // The library is not hardened against malicious files: panics not prevented above are caught
    // here.
    catch_panic(|| read_sound(bytes, path))
        .unwrap_or_else(|| Err("is not a valid glTF: its content is inconsistent; export it again".into()))
}

/// Checks the assumptions of the library: accessor counts, index types, sizes, encodings.
fn sound(bytes: &[u8]) -> Result<(), String> {
    let json = if bytes.starts_with(b"glTF") {
        gltf::Glb::from_slice(bytes)
            .map_err(|e| format!("is not a readable glTF: {e}"))?
            .json
            .into_owned()
    } else {
        bytes.to_vec()
    };
    let root: Value = serde_json::from_slice(&json).map_err(|e| format!("is not a readable glTF: {e}"))?;
    let list = |of: &Value, name: &str| {
        of.get(name)
            .and_then(Value::as_array)
            .cloned()
            .unwrap_or_default()
    };
    let accessors = list(&root, "accessors");
    let held: u64 = list(&root, "buffers")
        .iter()
        .filter_map(|b| b.get("byteLength").and_then(Value::as_u64))
        .fold(0, u64::saturating_add);
    if accessors
        .iter()
        .any(|a| a.get("count").and_then(Value::as_u64).is_none_or(|n| n > held))
    {
        return Err("declares more elements than its buffers hold".into());
    }
    for primitive in list(&root, "meshes").iter().flat_map(|m| list(m, "primitives")) {
        let attributes = primitive
            .get("attributes")
            .and_then(Value::as_object)
            .map(|a| a.values().cloned().collect::<Vec<_>>())
            .unwrap_or_default();
        let indices = primitive.get("indices").cloned();
        for index in attributes.iter().chain(&indices) {
            if index.as_u64().and_then(|n| accessors.get(n as usize)).is_none() {
                return Err("names an accessor that is not there".into());
            }
        }
        let of_indices = indices
            .and_then(|n| n.as_u64())
            .and_then(|n| accessors.get(n as usize)?.get("componentType")?.as_u64());
        if of_indices.is_some_and(|t| !matches!(t, 5121 | 5123 | 5125)) {
            return Err("has indices that are not unsigned integers".into());
        }
    }
    Ok(())
}

/// A file name without percent escapes (%41); none if it is not UTF-8.
fn unescaped(uri: &str) -> Option<String> {
    let mut bytes = uri.bytes();
    let mut plain = Vec::new();
    while let Some(b) = bytes.next() {
        let digit = |b: Option<u8>| b.and_then(|b| (b as char).to_digit(16)).map(|d| d as u8);
        match (b, b == b'%') {
            (_, true) => match (digit(bytes.next()), digit(bytes.next())) {
                (Some(high), Some(low)) => plain.push(16 * high + low),
                _ => return None,
            },
            (b, false) => plain.push(b),
        }
    }
    String::from_utf8(plain).ok()
}

/// The bytes of a buffer: those after the header of a .glb, those of a data URI, or those of a file
/// in the same folder.
fn buffer(buffer: &gltf::Buffer, blob: &mut Option<Vec<u8>>, path: Option<&Path>) -> Result<Vec<u8>, String> {
    let mut bytes = match buffer.source() {
        gltf::buffer::Source::Bin => blob
            .take()
            .ok_or("refers to a binary chunk that is missing; export it again")?,
        gltf::buffer::Source::Uri(uri) => match (uri.strip_prefix("data:"), path) {
            (Some(data), _) => {
                let encoded = data
                    .split_once(";base64,")
                    .ok_or("holds data in an encoding other than base64")?
                    .1;
                base64::engine::general_purpose::STANDARD
                    .decode(encoded)
                    .map_err(|e| format!("has data that is not base64 ({e})"))?
            }
            (None, Some(path)) if !uri.contains("://") => {
                let file = reference::sibling_file(
                    path,
                    &unescaped(uri).ok_or("refers to a buffer file whose percent-encoded name is invalid")?,
                );
                let read = file.and_then(|file| input::bytes(&file, super::MAX_BYTES, "buffer of a glTF"));
                // Both messages name the mesh's file.
                read.map_err(|e| match e {
                    Error::File { path: of, problem } if of == path => problem,
                    other => format!("refers to a buffer that cannot be read: {other}"),
                })?
            }
            _ => {
                return Err(format!(
                    "refers to the buffer {uri}, which is not a file next to it"
                ));
            }
        },
    };
    if bytes.len() < buffer.length() {
        return Err(format!(
            "declares a buffer of {} bytes that has only {}; copy or export it again",
            buffer.length(),
            bytes.len()
        ));
    }
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    Ok(bytes)
}

fn read_sound(bytes: &[u8], path: Option<&Path>) -> Result<MeshFileContents, String> {
    let broken = |e: gltf::Error| format!("is not a readable glTF: {e}");
    let gltf::Gltf { document, mut blob } = gltf::Gltf::from_slice(bytes).map_err(broken)?;
    let buffers = document
        .buffers()
        .map(|b| buffer(&b, &mut blob, path))
        .collect::<Result<Vec<_>, _>>()?;
    let mut listing = MeshFileContents::default();
    let mut skipped = 0;
    let scene = document
        .default_scene()
        .or_else(|| document.scenes().next())
        .ok_or("holds no scene")?;
    let mut open: Vec<(gltf::Node, Mat4, usize)> = scene.nodes().map(|n| (n, Mat4::IDENTITY, 0)).collect();
    let mut visits = 0;
    while let Some((node, world_from_parent, depth)) = open.pop() {
        visits += 1;
        if visits > MAX_NODE_VISITS || listing.triangles.len() > super::MAX_TRIANGLES {
            return Err("repeats its meshes too often".into());
        }
        if depth > DEEPEST {
            return Err("nests its nodes too deeply".into());
        }
        let world_from_node = world_from_parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
            if !matches!(
                primitive.mode(),
                Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan
            ) {
                skipped += 1;
                continue;
            }
            let first = listing.positions.len() as u32;
            let reader = primitive.reader(|b| buffers.get(b.index()).map(Vec::as_slice));
            let positions = reader
                .read_positions()
                .ok_or("has a primitive without positions")?;
            listing
                .positions
                .extend(positions.map(|p| world_from_node.transform_point3(Vec3::from(p))));
            let count = listing.positions.len() as u32 - first;
            let indices: Vec<u32> = match reader.read_indices() {
                Some(indices) => indices.into_u32().map(|i| i.saturating_add(first)).collect(),
                None => (first..first + count).collect(),
            };
            let mut triangles: Vec<[u32; 3]> = match primitive.mode() {
                Mode::Triangles => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
                Mode::TriangleStrip => indices
                    .windows(3)
                    .enumerate()
                    .map(|(n, t)| {
                        if n % 2 == 0 {
                            [t[0], t[1], t[2]]
                        } else {
                            [t[1], t[0], t[2]]
                        }
                    })
                    .collect(),
                _ => indices
                    .windows(2)
                    .skip(1)
                    .map(|t| [indices[0], t[0], t[1]])
                    .collect(),
            };
            if world_from_node.determinant() < 0.0 {
                triangles.iter_mut().for_each(|t| t.swap(1, 2));
            }
            listing.triangles.extend(triangles);
        }
        open.extend(node.children().map(|c| (c, world_from_node, depth + 1)));
    }
    if skipped > 0 {
        listing
            .warnings
            .push(format!("{skipped} primitives of points or lines were left out"));
    }
    Ok(listing)
}
