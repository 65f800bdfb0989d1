//! A volume inside a closed mesh (\[RVD01\] sections 2 and 3.1): the mesh says where the volume is shown, and carries it along when it is
//! deformed.
//!
//! *Method*: the mesh's signed distance becomes the mask of the stack's first map, so that every mode and backend cuts the volume along it
//! and lights the cut as any other, whatever deforms both later. Inside is where a line has crossed the mesh an odd number of times: between
//! nested walls, however they are oriented. Where nothing else deforms the scene, slices are not the sections of a box but those of the
//! mesh itself, filled contours ([`crate::mesh::contour`]): concave, with holes, several in a slice.
//!
//! *What we changed against the paper*: it deforms the mesh's vertices and interpolates texture coordinates over the contours' triangles, so
//! that the inside depends on the view (its figure 5). Here the deformers' inverse is found numerically on a grid and is the stack's
//! second map: vertices and inside follow one function from every side.

use super::mesh_settings::{deformers, placement};
use crate::Watch;
use crate::deform::{DisplacementMap, Library, PlacedMap, Placement, Storage, TexelSample, invert};
use crate::math::Bounds;
use crate::mesh::deformer::{Deformer, apply_all};
use crate::mesh::field::{FieldSettings, MeshField};
use crate::mesh::{Mesh, load};
use crate::scene::{InsideMesh, Scene};
use crate::volume::GridGeometry;
use crate::{Error, Result};
use glam::{DAffine3, DVec3, Vec3};
use std::sync::{Arc, Mutex, PoisonError};

/// Texels of the mask along its longest axis, at most.
const MASK: f32 = 192.0;
/// Points of the deformers' inverse along its longest axis.
const INVERSE: f32 = 80.0;

/// Triangles that the deformed mesh is divided into, at most.
const MAX_TRIANGLES: usize = 1_000_000;

/// What a mesh makes of the volume inside it.
pub struct InsideMeshMaps {
    /// The mask, and the deformers' inverse if there are any; to be applied before everything else.
    pub maps: Vec<PlacedMap>,
    /// The mesh where it is seen, if slices may be cut from it.
    pub proxy: Option<Arc<Mesh>>,
}

/// What meshes make of the volume inside them, cached by its inputs, the most recently used last: distances and inverses are slow to compute, and no camera
/// changes them.
#[derive(Default)]
pub struct InsideCache(Mutex<Vec<(InsideMeshKey, Arc<InsideMeshMaps>)>>);

/// What an [`InsideMeshMaps`] was made of: the settings, the scene's box, the least ramp.
type InsideMeshKey = (InsideMesh, Bounds, f32);

/// A coarse picture while something moves, and the full one after it.
const MAX_CACHED_INSIDES: usize = 2;

/// What the mesh that holds the scene's volume makes of it, if there is one.
///
/// # Errors
/// As [`resolve`].
pub fn of_scene(scene: &Scene, cache: &InsideCache, library: &Library, scene_box: &Bounds, min_ramp_mm: f32) -> Result<Option<Arc<InsideMeshMaps>>> {
    let Some(mesh) = scene.volume.as_ref().and_then(|v| v.inside.as_ref()) else { return Ok(None) };
    let key = (mesh.clone(), *scene_box, min_ramp_mm);
    let lock = || cache.0.lock().unwrap_or_else(PoisonError::into_inner);
    let cached = {
        let mut entries = lock();
        // To the end: it is the one used last.
        let at = entries.iter().position(|k| k.0 == key);
        at.and_then(|n| {
            entries[n..].rotate_left(1);
            entries.last().map(|k| k.1.clone())
        })
    };
    if cached.is_some() {
        return Ok(cached);
    }
    let inside = Arc::new(resolve(library, mesh, scene_box, min_ramp_mm)?);
    let mut entries = lock();
    if entries.len() >= MAX_CACHED_INSIDES {
        entries.remove(0);
    }
    entries.push((key, inside.clone()));
    Ok(Some(inside))
}

/// Resolves the mesh that holds a volume.
///
/// # Errors
/// A mesh that cannot be read or is not closed, a placement or deformer that cannot be used.
pub fn resolve(library: &Library, inside: &InsideMesh, scene_box: &Bounds, min_ramp_mm: f32) -> Result<InsideMeshMaps> {
    let named = |e: Error| e.within("volume.inside");
    let path = library.path(&inside.path);
    let mesh = load::mesh(&path)?;
    let placed = placement(&mesh.bounds(), &inside.place).map_err(named)?;
    let mesh = mesh.transformed(&placed);
    let topology = mesh.topology();
    if !topology.watertight {
        let problem = format!(
            "is not closed ({} open edges, {} with more than two triangles); the mesh of volume.inside must be closed",
            topology.open_edges, topology.non_manifold_edges
        );
        return Err(Error::file(&path, problem));
    }
    // Contours run around what their triangles face away from.
    let mesh = if topology.flipped_edges > 0 { mesh.oriented().0 } else { mesh };
    let deformers = deformers(&inside.deformer, &mesh.bounds()).map_err(named)?;
    let mut maps = vec![mask(&path, &mesh, scene_box, min_ramp_mm, inside.invert)?];
    let mut moved = mesh.clone();
    if !deformers.is_empty() {
        // A large triangle's edges stay straight, the volume inside does not.
        moved = moved.tessellated(|p| apply_all(&deformers, p).0, 1e-4 * mesh.bounds().size().length(), MAX_TRIANGLES).0;
        moved.positions.iter_mut().for_each(|p| *p = apply_all(&deformers, *p).0);
        let (map, missing) = inverse(&deformers, &mesh.bounds().union(&moved.bounds()))?;
        if missing > 0.01 {
            library.notice(format!(
                "volume.inside: the deformers fold; {:.0} % of the space about the mesh has no source and is cut away",
                100.0 * missing
            ));
        }
        maps.push(map);
    }
    Ok(InsideMeshMaps { maps, proxy: (!inside.invert).then(|| Arc::new(moved)) })
}

/// The mesh's distance as a mask over the scene's box and the mesh's.
fn mask(path: &std::path::Path, mesh: &Mesh, scene_box: &Bounds, min_ramp_mm: f32, invert: bool) -> Result<PlacedMap> {
    let all = scene_box.union(&mesh.bounds());
    let texel = all.size().max_element() / MASK;
    let all = all.grown(texel);
    let settings = FieldSettings { cell_mm: Some(texel), parity: true, ..FieldSettings::default() };
    let field = MeshField::new(mesh, &settings, &Watch::NONE).map_err(|problem| Error::file(path, problem))?.grid;
    let size = (all.size() / texel).ceil().to_array().map(|n| n as usize + 1);
    let ramp = min_ramp_mm.max(2.0 * texel);
    let sense = if invert { -1.0 } else { 1.0 };
    let map = DisplacementMap::from_fn(size, Storage::F16, |x| TexelSample {
        displacement: Vec3::ZERO,
        alpha: (0.5 + sense * field.sample(all.min + x * all.size()) / (2.0 * ramp)).clamp(0.0, 1.0),
    });
    Ok(PlacedMap::new(Arc::new(map), Placement::new(all.center(), all.size(), Vec3::ZERO)?))
}

/// The inverse of a chain of deformers over a box, and the share of its points without a source.
fn inverse(deformers: &[Deformer], over: &Bounds) -> Result<(PlacedMap, f64)> {
    let step = over.size().max_element() / INVERSE;
    let over = over.grown(2.0 * step);
    let size = (over.size() / step).ceil().to_array().map(|n| n as usize + 1);
    let spacing = over.size() / Vec3::from(size.map(|n| (n - 1) as f32));
    let world_from_voxel = DAffine3::from_translation(over.min.as_dvec3()) * DAffine3::from_scale(spacing.as_dvec3());
    let forward = |p: DVec3| apply_all(deformers, p.as_vec3()).0.as_dvec3();
    let inverse = invert::function(&forward, &GridGeometry { size, world_from_voxel });
    let missing = inverse.report.not_found as f64 / inverse.report.points.max(1) as f64;
    Ok((inverse.placed(Storage::F32, 1.0)?, missing))
}
