//! A volume inside a closed mesh (\[RVD01\] sections 2 and 3.1): the mesh bounds the visible part
//! of the volume and deforms it with itself.
//!
//! *Method*: the mesh's signed distance becomes the mask of the stack's first map. Every mode and
//! backend then cuts the volume along it and lights the cut as any other, whatever deforms both
//! later. Inside is where a line has crossed the mesh an odd number of times: between nested walls,
//! however they are oriented. Where nothing else deforms the scene, slices are sections of the mesh
//! itself instead of a box, as filled contours ([`crate::mesh::contour`]): concave, with holes,
//! several in a slice.
//!
//! *Differences from the paper*: the paper deforms the mesh's vertices and interpolates texture
//! coordinates over the contours' triangles, which makes the inside depend on the view (its figure
//! 5). Here the inverse of the deformers is found numerically on a grid and is the stack's second
//! map: vertices and inside follow one function from every side.

use super::mesh_settings::{deformers, placement};
use crate::Watch;
use crate::deform::{DisplacementMap, Library, PlacedMap, Placement, Storage, TexelSample, invert};
use crate::math::{Bounds, DistanceGrid};
use crate::mesh::deformer::{Deformer, apply_all};
use crate::mesh::field::{FieldSettings, MeshField};
use crate::mesh::{Mesh, load};
use crate::scene::{InsideMesh, Scene};
use crate::volume::GridGeometry;
use crate::{Error, Result};
use glam::{DAffine3, DVec3, Vec3};
use std::sync::{Arc, Mutex, PoisonError};

/// Maximum number of texels of the mask along its longest axis.
const MASK: f32 = 192.0;
/// Points of the deformers' inverse along its longest axis.
const INVERSE: f32 = 80.0;

/// Maximum number of triangles of the subdivided deformed mesh.
const MAX_TRIANGLES: usize = 1_000_000;

/// The maps and proxy of a volume inside a mesh.
pub struct InsideMeshMaps {
    /// The mask, and the deformers' inverse if there are any; applied before everything else.
    pub maps: Vec<PlacedMap>,
    /// The deformed mesh, if slices may be cut from it.
    pub proxy: Option<Arc<Mesh>>,
}

/// The maps of volumes inside meshes, cached by their inputs, the most recently used last:
/// distances and inverses are slow to compute and do not depend on the camera.
#[derive(Default)]
pub struct InsideCache(Mutex<Vec<(InsideMeshKey, Arc<InsideMeshMaps>)>>);

/// The inputs of an [`InsideMeshMaps`]: the settings, the scene's box, the smallest ramp.
type InsideMeshKey = (InsideMesh, Bounds, f32);

/// One for the coarse picture while something moves, and one for the full picture.
const MAX_CACHED_INSIDES: usize = 2;

/// The maps of the mesh that encloses the scene's volume, if there is one.
///
/// # Errors
/// As [`resolve`].
pub fn of_scene(
    scene: &Scene,
    cache: &InsideCache,
    library: &Library,
    scene_box: &Bounds,
    min_ramp_mm: f32,
) -> Result<Option<Arc<InsideMeshMaps>>> {
    let Some(mesh) = scene.volume.as_ref().and_then(|v| v.inside.as_ref()) else {
        return Ok(None);
    };
    let key = (mesh.clone(), *scene_box, min_ramp_mm);
    let lock = || cache.0.lock().unwrap_or_else(PoisonError::into_inner);
    let cached = {
        let mut entries = lock();
        // Moved to the end as the most recently used.
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

/// Resolves the mesh that encloses a volume.
///
/// # Errors
/// A mesh that cannot be read or encloses nothing, or an invalid placement or deformer.
pub fn resolve(
    library: &Library,
    inside: &InsideMesh,
    scene_box: &Bounds,
    min_ramp_mm: f32,
) -> Result<InsideMeshMaps> {
    let named = |e: Error| e.within("volume.inside");
    let path = library.path(&inside.path);
    let mesh = load::mesh(&path)?;
    let placed = placement(&mesh.bounds(), &inside.place).map_err(named)?;
    let mesh = mesh.transformed(&placed);
    let topology = mesh.topology();
    // Contours need triangles that face outwards.
    let mesh = if topology.flipped_edges > 0 {
        mesh.oriented().0
    } else {
        mesh
    };
    let deformers = deformers(&inside.deformer, &mesh.bounds()).map_err(named)?;
    let field = field_of(&path, &mesh, topology.watertight, scene_box)?;
    if !topology.watertight {
        library.notice(format!(
            "{}: not closed ({} open edges, {} with more than two triangles); its inside is where the winding number is above 1/2, doubtful at {:.1} % of the points near the surface",
            inside.path,
            topology.open_edges,
            topology.non_manifold_edges,
            100.0 * field.doubtful
        ));
    }
    let mut maps = vec![mask(&field.grid, &mesh, scene_box, min_ramp_mm, inside.invert)?];
    let mut moved = mesh.clone();
    if !deformers.is_empty() {
        // The edges of a large triangle stay straight, unlike the volume inside.
        moved = moved
            .tessellated(
                |p| apply_all(&deformers, p).0,
                1e-4 * mesh.bounds().size().length(),
                MAX_TRIANGLES,
            )
            .0;
        moved
            .positions
            .iter_mut()
            .for_each(|p| *p = apply_all(&deformers, *p).0);
        let (map, missing) = inverse(&deformers, &mesh.bounds().union(&moved.bounds()))?;
        if missing > 0.01 {
            library.notice(format!(
                "volume.inside: the deformers fold; {:.0} % of the space about the mesh has no source and is cut away",
                100.0 * missing
            ));
        }
        maps.push(map);
    }
    Ok(InsideMeshMaps {
        maps,
        // Sections of a mesh with holes are not closed.
        proxy: (!inside.invert && topology.watertight).then(|| Arc::new(moved)),
    })
}

/// The box of scene and mesh, and the edge of a texel of the mask over it.
fn mask_box(mesh: &Mesh, scene_box: &Bounds) -> (Bounds, f32) {
    let all = scene_box.union(&mesh.bounds());
    let texel = all.size().max_element() / MASK;
    (all.grown(texel), texel)
}

/// The mesh's signed distance. Nested walls of a closed mesh count by parity; the inside of a mesh
/// with holes is where the generalised winding number is above 1/2.
fn field_of(path: &std::path::Path, mesh: &Mesh, is_closed: bool, scene_box: &Bounds) -> Result<MeshField> {
    let settings = FieldSettings {
        cell_mm: Some(mask_box(mesh, scene_box).1),
        parity: is_closed,
        ..FieldSettings::default()
    };
    let field =
        MeshField::new(mesh, &settings, &Watch::NONE).map_err(|problem| Error::file(path, problem))?;
    if !is_closed && field.inside == 0.0 {
        let problem = "encloses nothing: its winding number is nowhere above 1/2; close it, or turn its triangles outwards";
        return Err(Error::file(path, problem));
    }
    Ok(field)
}

/// The mesh's distance as a mask over the boxes of the scene and the mesh.
fn mask(
    field: &DistanceGrid,
    mesh: &Mesh,
    scene_box: &Bounds,
    min_ramp_mm: f32,
    invert: bool,
) -> Result<PlacedMap> {
    let (all, texel) = mask_box(mesh, scene_box);
    let size = (all.size() / texel).ceil().to_array().map(|n| n as usize + 1);
    let ramp = min_ramp_mm.max(2.0 * texel);
    let sense = if invert { -1.0 } else { 1.0 };
    let map = DisplacementMap::from_fn(size, Storage::F16, |x| TexelSample {
        displacement: Vec3::ZERO,
        alpha: (0.5 + sense * field.sample(all.min + x * all.size()) / (2.0 * ramp)).clamp(0.0, 1.0),
    });
    Ok(PlacedMap::new(
        Arc::new(map),
        Placement::new(all.center(), all.size(), Vec3::ZERO)?,
    ))
}

/// The inverse of a chain of deformers over a box, and the fraction of its points without a source.
fn inverse(deformers: &[Deformer], over: &Bounds) -> Result<(PlacedMap, f64)> {
    let step = over.size().max_element() / INVERSE;
    let over = over.grown(2.0 * step);
    let size = (over.size() / step).ceil().to_array().map(|n| n as usize + 1);
    let spacing = over.size() / Vec3::from(size.map(|n| (n - 1) as f32));
    let world_from_voxel =
        DAffine3::from_translation(over.min.as_dvec3()) * DAffine3::from_scale(spacing.as_dvec3());
    let forward = |p: DVec3| apply_all(deformers, p.as_vec3()).0.as_dvec3();
    let inverse = invert::function(
        &forward,
        &GridGeometry {
            size,
            world_from_voxel,
        },
    );
    let missing = inverse.report.not_found as f64 / inverse.report.points.max(1) as f64;
    Ok((inverse.placed(Storage::F32, 1.0)?, missing))
}
