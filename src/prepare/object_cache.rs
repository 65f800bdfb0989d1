//! The sources of a scene's surfaces, loaded and computed once: meshes, their triangles after
//! deformers, distance fields, depth maps.

use super::mesh_settings::{deformers, formula, placement};
use super::surface_cells::SurfaceCellsCache;
use crate::deform::Library;
use crate::deform::distance::{RegionSource, of_region};
use crate::math::flat;
use crate::math::{Bounds, DistanceGrid};
use crate::mesh::deformer::{apply_all, deform_vertex};
use crate::mesh::depth_map::{DepthMaps, FACES};
use crate::mesh::field::{FieldSettings, MeshField, of_iso_value};
use crate::mesh::{Implicit, Mesh, TriangleBvh, load};
use crate::scene::surface::{MeshSource, Representation, SurfaceSettings};
use crate::scene::{Mode, Scene};
use crate::volume::Volume;
use crate::{Error, Result, Watch};
use glam::{Affine3A, Vec3};
use ndarray::Array3;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Maximum number of objects in a scene.
const MAX_OBJECTS: usize = 64;
/// A mesh ready for rays: after its deformers, with normals and a hierarchy; and its undeformed
/// corners for a vertex shader.
pub struct Triangles {
    /// The mesh after its deformers.
    pub mesh: Mesh,
    /// Its normals, per corner.
    pub normals: Vec<[Vec3; 3]>,
    /// Its bounding volume hierarchy.
    pub tree: TriangleBvh,
    /// Before its deformers: positions and normals, per corner.
    pub undeformed: Vec<[(Vec3, Vec3); 3]>,
}

/// Number of triangles at which tessellation stops.
const MAX_TESSELLATED_TRIANGLES: usize = 4_000_000;

/// Bytes of unused fields that stay cached: dragging an iso-value leaves one field per value.
const MAX_CACHED_FIELD_BYTES: usize = 512 << 20;

/// Computed fields by their inputs, the most recently used last.
#[derive(Default)]
struct FieldCache(Vec<(String, Arc<DistanceGrid>)>);

impl FieldCache {
    fn get(&mut self, key: &str) -> Option<Arc<DistanceGrid>> {
        let at = self.0.iter().position(|(of, _)| of == key)?;
        self.0[at..].rotate_left(1);
        self.0.last().map(|(_, field)| field.clone())
    }

    /// Caches a field, and evicts the least recently used ones above the limit.
    fn insert(&mut self, key: String, field: Arc<DistanceGrid>, max_bytes: usize) {
        self.0.retain(|(of, _)| *of != key);
        self.0.push((key, field));
        let bytes_of = |field: &DistanceGrid| size_of_val(flat(&field.distance_mm));
        let mut bytes: usize = self.0.iter().map(|(_, field)| bytes_of(field)).sum();
        self.0.retain(|(_, field)| {
            let goes = bytes > max_bytes && Arc::strong_count(field) == 1;
            bytes -= if goes { bytes_of(field) } else { 0 };
            !goes
        });
    }
}

/// Loaded meshes and computed fields, cached as long as a scene's assets exist; fields up to a
/// limit.
#[derive(Default)]
pub struct ObjectCache {
    meshes: Mutex<HashMap<String, Arc<Mesh>>>,
    fields: Mutex<FieldCache>,
    triangles: Mutex<HashMap<String, Arc<Triangles>>>,
    depths: Mutex<HashMap<String, Arc<DepthMaps>>>,
    pub cells: SurfaceCellsCache,
}

fn lock<T>(m: &Mutex<T>) -> MutexGuard<'_, T> {
    // Entries are only added as a whole.
    m.lock().unwrap_or_else(PoisonError::into_inner)
}

impl ObjectCache {
    /// Loads the meshes of a scene and computes their fields; returns the box around them.
    ///
    /// # Errors
    /// Files that cannot be read, or invalid settings.
    pub fn load(
        &self,
        scene: &Scene,
        library: &Library,
        volume: &Volume,
        progress: &(dyn Fn(f32) + Sync),
    ) -> Result<Bounds> {
        scene.surface.check()?;
        if scene.mesh.len() > MAX_OBJECTS {
            return Err(Error::value("mesh", format!("a scene has at most {MAX_OBJECTS}")));
        }
        let watch = Watch::reporting(progress);
        let mut all = Bounds::EMPTY;
        for (n, source) in shown_surfaces(scene, volume).iter().enumerate() {
            let bounds = || -> Result<Bounds> {
                source.check()?;
                if source.path.is_some() {
                    let bounds = self.triangles(library, source)?.mesh.bounds();
                    // A partial field is computed once the deformations are known.
                    if source.representation() != Representation::Triangles && !scene.surface.two_stage {
                        self.implicit(library, source, &scene.surface, None, &watch)?;
                    }
                    return Ok(bounds);
                }
                Ok(self
                    .implicit(library, source, &scene.surface, None, &watch)?
                    .bounds())
            };
            all = all.union(&bounds().map_err(|e| e.within(&source.label(n)))?);
        }
        Ok(all)
    }

    /// The mesh of a file placed in the world, before its deformers.
    pub fn placed(&self, library: &Library, source: &MeshSource) -> Result<Arc<Mesh>> {
        let path = source.path.as_deref().unwrap_or_default();
        let key = format!("{path} {:?}", source.place);
        if let Some(mesh) = lock(&self.meshes).get(&key) {
            return Ok(mesh.clone());
        }
        let mesh = load::mesh(&library.path(path))?;
        for warning in &mesh.warnings {
            library.notice(format!("{path}: {warning}"));
        }
        let placement = placement(&mesh.bounds(), &source.place)?;
        let mesh = Arc::new(mesh.transformed(&placement));
        lock(&self.meshes).insert(key, mesh.clone());
        Ok(mesh)
    }

    /// A mesh with its deformers applied, ready for rays.
    pub fn triangles(&self, library: &Library, source: &MeshSource) -> Result<Arc<Triangles>> {
        let key = format!("{} {:?}", source.mesh_key(), source.normals);
        if let Some(t) = lock(&self.triangles).get(&key) {
            return Ok(t.clone());
        }
        let placed = self.placed(library, source)?;
        let deformers = deformers(&source.deformer, &placed.bounds())?;
        let mut mesh = (*placed).clone();
        if let (Some(tolerance), false) = (source.tessellate, deformers.is_empty()) {
            let (finer, reached) = mesh.tessellated(
                |p| apply_all(&deformers, p).0,
                tolerance,
                MAX_TESSELLATED_TRIANGLES,
            );
            if !reached {
                library.notice(format!(
                    "{}: tessellation stopped at {} triangles before reaching the tolerance of {tolerance} mm",
                    source.label(0),
                    finer.triangles.len()
                ));
            }
            mesh = finer;
        }
        let normals = mesh.corner_normals();
        let undeformed: Vec<[(Vec3, Vec3); 3]> = normals
            .iter()
            .enumerate()
            .map(|(t, n)| {
                let p = mesh.corners(t);
                std::array::from_fn(|c| (p[c], n[c]))
            })
            .collect();
        let normals = if deformers.is_empty() {
            normals
        } else {
            let turned = undeformed
                .iter()
                .map(|t| t.map(|(p, n)| deform_vertex(&deformers, p, n, source.normals).1))
                .collect();
            mesh.positions
                .iter_mut()
                .for_each(|p| *p = apply_all(&deformers, *p).0);
            turned
        };
        let t = Arc::new(Triangles {
            tree: TriangleBvh::new(&mesh),
            mesh,
            normals,
            undeformed,
        });
        lock(&self.triangles).insert(key, t.clone());
        Ok(t)
    }

    /// The implicit function of a source, restricted to `region` if one is given.
    pub fn implicit(
        &self,
        library: &Library,
        source: &MeshSource,
        general: &SurfaceSettings,
        region: Option<Bounds>,
        watch: &Watch,
    ) -> Result<Implicit> {
        let resolution = source.resolution.unwrap_or(general.resolution);
        if !source.shape.is_empty() {
            return formula(&source.shape).map(Implicit::Formula);
        }
        if source.path.is_none() {
            return self.of_volume(library, source).map(Implicit::Grid);
        }
        let triangles = self.triangles(library, source)?;
        match source.representation() {
            Representation::DepthMap | Representation::DepthMapCube => {
                let key = format!(
                    "{} {:?} {:?} {resolution}",
                    source.mesh_key(),
                    source.representation,
                    source.face
                );
                if let Some(d) = lock(&self.depths).get(&key) {
                    return Ok(Implicit::Depth(d.clone()));
                }
                let faces: Vec<u32> = if source.representation == Some(Representation::DepthMapCube) {
                    (0..6).collect()
                } else {
                    let name = source.face.as_deref().unwrap_or("-y");
                    let face = FACES.iter().position(|f| *f == name);
                    vec![face.ok_or_else(|| {
                        Error::value(
                            format!("face \"{name}\""),
                            format!("there is no such face; known: {}", FACES.join(", ")),
                        )
                    })? as u32]
                };
                let bounds = triangles.mesh.bounds();
                let margin = 0.02 * bounds.size().max_element();
                let maps = Arc::new(DepthMaps::new(
                    &triangles.tree,
                    bounds.grown(margin),
                    resolution,
                    &faces,
                ));
                let full = 2 * resolution.pow(3);
                library.notice(format!(
                    "{}: depth maps of {} bytes, where a field of {resolution}³ takes {full}",
                    source.label(0),
                    maps.bytes()
                ));
                lock(&self.depths).insert(key, maps.clone());
                Ok(Implicit::Depth(maps))
            }
            _ => {
                let key = format!("{} {resolution} {} {region:?}", source.mesh_key(), source.exact);
                if let Some(f) = lock(&self.fields).get(&key) {
                    return Ok(Implicit::Grid(f));
                }
                let settings = FieldSettings {
                    resolution,
                    region,
                    exact: source.exact,
                    ..FieldSettings::default()
                };
                let path = library.path(source.path.as_deref().unwrap_or_default());
                let field = MeshField::new(&triangles.mesh, &settings, watch)
                    .map_err(|problem| Error::file(&path, problem))?;
                let t = &field.topology;
                if !t.watertight {
                    library.notice(format!(
                        "{}: not watertight ({} open edges); its inside is where the winding number is above 1/2, doubtful at {:.1} % of the points near the surface",
                        source.label(0), t.open_edges, 100.0 * field.doubtful
                    ));
                }
                let grid = Arc::new(field.grid);
                lock(&self.fields).insert(key, grid.clone(), MAX_CACHED_FIELD_BYTES);
                Ok(Implicit::Grid(grid))
            }
        }
    }

    /// The surface of a value or of labels of a volume.
    fn of_volume(&self, library: &Library, source: &MeshSource) -> Result<Arc<DistanceGrid>> {
        let key = format!("{:?} {:?} {:?}", source.volume, source.iso, source.label);
        if let Some(f) = lock(&self.fields).get(&key) {
            return Ok(f);
        }
        let volume = match &source.volume {
            Some(path) => library.load_volume(path)?,
            None => library
                .volume()
                .map_err(|_| {
                    Error::value(
                        "iso, label",
                        "need a volume, and the scene has none; name one with `volume`",
                    )
                })?
                .clone(),
        };
        if let Some(path) = &source.volume {
            library.note_distance("the volume", &library.path(path), &volume);
        }
        if source.iso.is_some() && volume.function.is_some() {
            library.notice(format!(
                "{}: the surface of a value follows the volume's voxels, not its function; more voxels (size=N) make it finer",
                source.label(0)
            ));
        }
        let grid = match source.iso {
            Some(iso) => match of_iso_value(&volume, iso) {
                Some(grid) => Ok(grid),
                None => {
                    let [low, high] = volume.range;
                    let problem = format!(
                        "{}: the volume has no surface at {iso}; its values range from {low} to {high}",
                        source.label(0)
                    );
                    library.notice(problem);
                    return Ok(Arc::new(nothing_within(&volume.bounds_in_world())));
                }
            },
            None => of_region(&volume, &RegionSource::Labels(&source.label), true).ok_or_else(|| {
                Error::value(
                    "label",
                    format!(
                        "no surface has the labels {:?}: no voxel has them, or all do",
                        source.label
                    ),
                )
            }),
        }?;
        let grid = grid.closed_at_faces();
        if !grid.distance_mm.iter().any(|d| *d > 0.0) {
            return Err(Error::value(
                "iso, label",
                "the region is too thin to have an interior",
            ));
        }
        let grid = Arc::new(grid);
        lock(&self.fields).insert(key, grid.clone(), MAX_CACHED_FIELD_BYTES);
        Ok(grid)
    }
}

/// The visible surfaces of a scene: its meshes, and the volume's own if the mode requires it.
pub fn shown_surfaces(scene: &Scene, volume: &Volume) -> Vec<MeshSource> {
    let numbered = scene.mesh.iter().enumerate().map(|(n, m)| MeshSource {
        name: Some(m.label(n)),
        ..m.clone()
    });
    let mut all: Vec<MeshSource> = numbered.filter(|m| !m.hidden).collect();
    if scene.render.mode == Mode::Surface
        && scene.volume.is_some()
        && (scene.mesh.is_empty() || scene.surface.iso.is_some())
    {
        let iso = scene.surface.iso.unwrap_or_else(|| volume.body_threshold());
        all.push(MeshSource {
            iso: Some(iso),
            name: Some("volume".into()),
            ..MeshSource::default()
        });
    }
    all
}

/// The field without any surface.
fn nothing_within(bounds: &Bounds) -> DistanceGrid {
    let size = bounds.size();
    let world_from_grid = Affine3A::from_translation(bounds.min) * Affine3A::from_scale(size);
    DistanceGrid::new(Array3::from_elem((2, 2, 2), -size.length()), world_from_grid)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Unused fields are evicted above the limit; fields in use never are.
    #[test]
    fn fields_are_kept_as_far_as_there_is_room() {
        let field = || Arc::new(DistanceGrid::new(Array3::zeros((2, 2, 2)), Affine3A::IDENTITY));
        let (mut entries, shown) = (FieldCache::default(), field());
        entries.insert("shown".into(), shown.clone(), 4 * 32);
        for name in ["a", "b", "c", "d", "e"] {
            entries.insert(name.into(), field(), 4 * 32);
            assert!(entries.get(name).is_some());
        }
        assert!(
            entries.get("a").is_none() && entries.get("b").is_none() && entries.get("c").is_some(),
            "{}",
            entries.0.len()
        );
        assert!(Arc::ptr_eq(&shown, &entries.get("shown").unwrap_or_else(field)));
    }
}
