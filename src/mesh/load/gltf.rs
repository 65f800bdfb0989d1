//! glTF 2 (`.gltf`, `.glb`), by the gltf library: the triangles of every mesh, placed by its nodes. glTF is in metres and y-up; an
//! illustrator's model has no scale of its own, so numbers are taken as millimetres and axes as they are.

use super::Listing;
use glam::{Mat4, Vec3};
use gltf::mesh::Mode;
use std::path::Path;

/// Deepest tree of nodes: files can name a node as its own child.
const DEEPEST: usize = 64;

pub fn read(bytes: &[u8], folder: Option<&Path>) -> Result<Listing, String> {
    let broken = |e: gltf::Error| format!("is not a readable glTF: {e}");
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(bytes).map_err(broken)?;
    let buffers = gltf::import_buffers(&document, folder, blob).map_err(broken)?;
    let mut listing = Listing::default();
    let mut skipped = 0;
    let scene = document.default_scene().or_else(|| document.scenes().next()).ok_or("holds no scene")?;
    let mut open: Vec<(gltf::Node, Mat4, usize)> = scene.nodes().map(|n| (n, Mat4::IDENTITY, 0)).collect();
    while let Some((node, world_from_parent, depth)) = open.pop() {
        if depth > DEEPEST {
            return Err("nests its nodes too deeply".into());
        }
        let world_from_node = world_from_parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
            if !matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
                skipped += 1;
                continue;
            }
            let first = listing.positions.len() as u32;
            let reader = primitive.reader(|b| buffers.get(b.index()).map(|d| &d.0[..]));
            let positions = reader.read_positions().ok_or("has a primitive without positions")?;
            listing.positions.extend(positions.map(|p| world_from_node.transform_point3(Vec3::from(p))));
            let count = listing.positions.len() as u32 - first;
            let indices: Vec<u32> = match reader.read_indices() {
                Some(indices) => indices.into_u32().map(|i| i.saturating_add(first)).collect(),
                None => (first..first + count).collect(),
            };
            let mut triangles: Vec<[u32; 3]> = match primitive.mode() {
                Mode::Triangles => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
                Mode::TriangleStrip => {
                    indices.windows(3).enumerate().map(|(n, t)| if n % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] }).collect()
                }
                _ => indices.windows(2).skip(1).map(|t| [indices[0], t[0], t[1]]).collect(),
            };
            if world_from_node.determinant() < 0.0 {
                triangles.iter_mut().for_each(|t| t.swap(1, 2));
            }
            listing.triangles.extend(triangles);
        }
        open.extend(node.children().map(|c| (c, world_from_node, depth + 1)));
    }
    if skipped > 0 {
        listing.warnings.push(format!("{skipped} primitives of points or lines were left out"));
    }
    Ok(listing)
}
