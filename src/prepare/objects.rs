//! Surfaces resolved for rendering: every `[[mesh]]`, and the volume's own surface where the mode asks for it, as an implicit solid, as
//! triangles, or both.

use super::Assets;
use super::surface_cells::{SurfaceCells, SurfaceCellsCache, SurfaceCellsInputs};
use crate::Watch;
use crate::deform::cut::CutShapes;
use crate::deform::distance::{RegionSource, of_region};
use crate::deform::lipschitz::LipschitzBounds;
use crate::deform::{Placement, Stack};
use crate::error::suggestion;
use crate::math::{Bounds, DistanceGrid};
use crate::mesh::deformer::{Deformer, DeformerKind, LATTICE, MAX_DEFORMERS, NormalMethod, apply_all, deform_vertex};
use crate::mesh::depth_map::{DepthMaps, FACES};
use crate::mesh::field::{FieldSettings, MARGIN, MeshField, cell_of, of_iso_value};
use crate::mesh::formula::{CsgOperation, Formula, MAX_SOLIDS, PlacedSolid, Solid};
use crate::mesh::{Implicit, Mesh, TriangleBvh, load};
use crate::scene::surface::{CutModel, DeformerSource, Look, MeshPlace, MeshSource, Representation, ShapeSource, Steps, SurfaceSettings};
use crate::scene::{Mode, Scene, Size};
use crate::{Error, Result};
use glam::{Affine3A, Mat3, Vec3};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

/// Triangles that tessellation stops at.
const MAX_TESSELLATED_TRIANGLES: usize = 4_000_000;
/// Most objects of a scene.
const MAX_OBJECTS: usize = 64;

/// Bytes of fields that are kept though nothing shows them: a hand that drags an iso-value leaves one for each.
const MAX_CACHED_FIELD_BYTES: usize = 512 << 20;

/// Computed fields by what decides them, the most recently used last.
#[derive(Default)]
struct FieldCache(Vec<(String, Arc<DistanceGrid>)>);

impl FieldCache {
    fn get(&mut self, key: &str) -> Option<Arc<DistanceGrid>> {
        let at = self.0.iter().position(|(of, _)| of == key)?;
        self.0[at..].rotate_left(1);
        self.0.last().map(|(_, field)| field.clone())
    }

    /// Keeps a field, and lets go of those that were used longest ago where they are too many.
    fn insert(&mut self, key: String, field: Arc<DistanceGrid>, max_bytes: usize) {
        self.0.retain(|(of, _)| *of != key);
        self.0.push((key, field));
        let bytes_of = |field: &DistanceGrid| size_of_val(&*field.distance_mm);
        let mut bytes: usize = self.0.iter().map(|(_, field)| bytes_of(field)).sum();
        self.0.retain(|(_, field)| {
            let goes = bytes > max_bytes && Arc::strong_count(field) == 1;
            bytes -= if goes { bytes_of(field) } else { 0 };
            !goes
        });
    }
}

/// Loaded meshes and computed fields, kept as long as a scene's assets are; fields as far as there is room.
#[derive(Default)]
pub struct ObjectCache {
    meshes: Mutex<HashMap<String, Arc<Mesh>>>,
    fields: Mutex<FieldCache>,
    triangles: Mutex<HashMap<String, Arc<Triangles>>>,
    depths: Mutex<HashMap<String, Arc<DepthMaps>>>,
    cells: SurfaceCellsCache,
}

fn lock<T>(m: &Mutex<T>) -> MutexGuard<'_, T> {
    // Entries are only ever added whole.
    m.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A mesh ready for rays: after its deformers, with normals and a tree; and as it was before them, for a vertex shader.
pub struct Triangles {
    /// The mesh after its deformers.
    pub mesh: Mesh,
    /// Its normals, per corner.
    pub normals: Vec<[Vec3; 3]>,
    /// Its triangles by place.
    pub tree: TriangleBvh,
    /// Before its deformers: positions and normals, per corner.
    pub undeformed: Vec<[(Vec3, Vec3); 3]>,
}

/// Which renderer an object passes through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stage {
    /// Rays through its field.
    Rays,
    /// Triangles outside the deformations' boxes, rays within, blended over a seam of this width, mm.
    Both(f32),
    /// Triangles alone.
    Triangles,
}

/// One surface.
pub struct SurfaceObject {
    /// Its name in messages.
    pub name: String,
    /// How it looks.
    pub look: Look,
    /// Thickness of a thick one, mm; 0 of others.
    pub thickness_mm: f32,
    /// What rays sample.
    pub implicit: Option<Implicit>,
    /// Its triangles, where they are drawn.
    pub triangles: Option<Arc<Triangles>>,
    /// Which renderer it passes through.
    pub stage: Stage,
    /// The scene's deformations pass it by.
    pub rigid: bool,
    /// Forward deformers, for the vertex shader.
    pub deformers: Vec<Deformer>,
    /// How they carry normals.
    pub normals: NormalMethod,
    /// What f is resolved to, mm.
    pub cell_mm: f32,
    /// Length of an even step, mm.
    pub step_mm: f32,
    /// Empty space.
    pub cells: Arc<SurfaceCells>,
}

/// All surfaces of a scene.
#[derive(Default)]
pub struct Surfaces {
    /// The objects.
    pub objects: Vec<SurfaceObject>,
    /// How rays step.
    pub steps: Steps,
    /// Distance from the surface within which threshold steps are finer, cells.
    pub threshold: f32,
}

/// From a mesh file's coordinates to the world.
pub(super) fn placement(bounds: &Bounds, place: &MeshPlace) -> Result<Affine3A> {
    let MeshPlace { center, size, rotate, matrix } = *place;
    if let Some(rows) = matrix {
        if center.is_some() || size.is_some() || rotate.is_some() {
            return Err(Error::value("matrix", "already says where the mesh goes; leave out center, size and rotate"));
        }
        let column = |c: usize| Vec3::new(rows[0][c], rows[1][c], rows[2][c]);
        let m = Affine3A::from_mat3_translation(Mat3::from_cols(column(0), column(1), column(2)), column(3));
        let usable = m.is_finite() && Mat3::from(m.matrix3).determinant() != 0.0;
        return if usable { Ok(m) } else { Err(Error::value("matrix", "is singular or not finite")) };
    }
    let scale = match size {
        Some(s) if s.is_finite() && s > 0.0 => s / bounds.size().max_element(),
        Some(s) => return Err(Error::value("size", format!("{s} is not a length"))),
        None => 1.0,
    };
    let turn = rotation(rotate)?;
    let center = center.map_or(bounds.center(), Vec3::from);
    if !center.is_finite() {
        return Err(Error::value("center", "must be finite"));
    }
    Ok(Affine3A::from_translation(center)
        * Affine3A::from_mat3(turn)
        * Affine3A::from_scale(Vec3::splat(scale))
        * Affine3A::from_translation(-bounds.center()))
}

/// About x, then y, then z, as deformations turn.
fn rotation(degrees: Option<[f32; 3]>) -> Result<Mat3> {
    let Some(d) = degrees else { return Ok(Mat3::IDENTITY) };
    let placement = Placement::new(Vec3::ZERO, Vec3::ONE, Vec3::from(d))?;
    Ok(Mat3::from(placement.world_from_map.matrix3))
}

impl ObjectCache {
    /// A mesh file where it lies in the world, before its deformers.
    fn placed(&self, assets: &Assets, source: &MeshSource) -> Result<Arc<Mesh>> {
        let path = source.path.as_deref().unwrap_or_default();
        let key = format!("{path} {:?}", source.place);
        if let Some(mesh) = lock(&self.meshes).get(&key) {
            return Ok(mesh.clone());
        }
        let mesh = load::mesh(&assets.library.path(path))?;
        for warning in &mesh.warnings {
            assets.library.notice(format!("{path}: {warning}"));
        }
        let placement = placement(&mesh.bounds(), &source.place)?;
        let mesh = Arc::new(mesh.transformed(&placement));
        lock(&self.meshes).insert(key, mesh.clone());
        Ok(mesh)
    }

    /// A mesh with its deformers applied, ready for rays.
    fn triangles(&self, assets: &Assets, source: &MeshSource) -> Result<Arc<Triangles>> {
        let key = format!("{} {:?}", source.mesh_key(), source.normals);
        if let Some(t) = lock(&self.triangles).get(&key) {
            return Ok(t.clone());
        }
        let placed = self.placed(assets, source)?;
        let deformers = deformers(&source.deformer, &placed.bounds())?;
        let mut mesh = (*placed).clone();
        if let (Some(tolerance), false) = (source.tessellate, deformers.is_empty()) {
            let (finer, reached) = mesh.tessellated(|p| apply_all(&deformers, p).0, tolerance, MAX_TESSELLATED_TRIANGLES);
            if !reached {
                assets.library.notice(format!(
                    "{}: tessellation stopped at {} triangles, before {tolerance} mm",
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
            let turned = undeformed.iter().map(|t| t.map(|(p, n)| deform_vertex(&deformers, p, n, source.normals).1)).collect();
            mesh.positions.iter_mut().for_each(|p| *p = apply_all(&deformers, *p).0);
            turned
        };
        let t = Arc::new(Triangles { tree: TriangleBvh::new(&mesh), mesh, normals, undeformed });
        lock(&self.triangles).insert(key, t.clone());
        Ok(t)
    }

    /// What rays sample of a source; only `region` of it, if one is given.
    fn implicit(&self, assets: &Assets, source: &MeshSource, general: &SurfaceSettings, region: Option<Bounds>, watch: &Watch) -> Result<Implicit> {
        let resolution = source.resolution.unwrap_or(general.resolution);
        if !source.shape.is_empty() {
            return formula(&source.shape).map(Implicit::Formula);
        }
        if source.path.is_none() {
            return self.of_volume(assets, source).map(Implicit::Grid);
        }
        let triangles = self.triangles(assets, source)?;
        match source.representation() {
            Representation::DepthMap | Representation::DepthMapCube => {
                let key = format!("{} {:?} {:?} {resolution}", source.mesh_key(), source.representation, source.face);
                if let Some(d) = lock(&self.depths).get(&key) {
                    return Ok(Implicit::Depth(d.clone()));
                }
                let faces: Vec<u32> = if source.representation == Some(Representation::DepthMapCube) {
                    (0..6).collect()
                } else {
                    let name = source.face.as_deref().unwrap_or("-y");
                    let face = FACES.iter().position(|f| *f == name);
                    vec![
                        face.ok_or_else(|| Error::value(format!("face \"{name}\""), format!("there is no such face; known: {}", FACES.join(", "))))?
                            as u32,
                    ]
                };
                let bounds = triangles.mesh.bounds();
                let margin = 0.02 * bounds.size().max_element();
                let maps = Arc::new(DepthMaps::new(&triangles.tree, bounds.grown(margin), resolution, &faces));
                let full = 2 * resolution.pow(3);
                assets.library.notice(format!(
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
                let settings = FieldSettings { resolution, region, exact: source.exact, ..FieldSettings::default() };
                let path = assets.library.path(source.path.as_deref().unwrap_or_default());
                let field = MeshField::new(&triangles.mesh, &settings, watch).map_err(|problem| Error::file(&path, problem))?;
                let t = &field.topology;
                if !t.watertight {
                    assets.library.notice(format!(
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
    fn of_volume(&self, assets: &Assets, source: &MeshSource) -> Result<Arc<DistanceGrid>> {
        let key = format!("{:?} {:?} {:?}", source.volume, source.iso, source.label);
        if let Some(f) = lock(&self.fields).get(&key) {
            return Ok(f);
        }
        let volume = match &source.volume {
            Some(path) => assets.library.load_volume(path)?,
            None => assets
                .library
                .volume()
                .map_err(|_| Error::value("iso, label", "need a volume, and the scene has none; name one with `volume`"))?
                .clone(),
        };
        if let Some(path) = &source.volume {
            assets.library.note_distance("the volume", &assets.library.path(path), &volume);
        }
        let grid = match source.iso {
            Some(iso) => match of_iso_value(&volume, iso) {
                Some(grid) => Ok(grid),
                None => {
                    let [low, high] = volume.range;
                    let problem = format!("{}: the volume has no surface at {iso}; its values range from {low} to {high}", source.label(0));
                    assets.library.notice(problem);
                    return Ok(Arc::new(nothing_within(&volume.bounds_in_world())));
                }
            },
            None => of_region(&volume, &RegionSource::Labels(&source.label), true)
                .ok_or_else(|| Error::value("label", format!("no surface has the labels {:?}: no voxel has them, or all do", source.label))),
        }?;
        let grid = grid.closed_at_faces();
        if !grid.distance_mm.iter().any(|d| *d > 0.0) {
            return Err(Error::value("iso, label", "what they name is too thin to have an inside"));
        }
        let grid = Arc::new(grid);
        lock(&self.fields).insert(key, grid.clone(), MAX_CACHED_FIELD_BYTES);
        Ok(grid)
    }
}

/// The deformers of a mesh that lies in `bounds`.
pub(super) fn deformers(sources: &[DeformerSource], bounds: &Bounds) -> Result<Vec<Deformer>> {
    if sources.len() > MAX_DEFORMERS {
        return Err(Error::value("deformer", format!("a mesh has at most {MAX_DEFORMERS}")));
    }
    sources.iter().map(|d| deformer(d, bounds)).collect()
}

fn deformer(d: &DeformerSource, bounds: &Bounds) -> Result<Deformer> {
    const KINDS: [(&str, &[&str]); 7] = [
        ("twist", &["angle"]),
        ("bend", &["angle"]),
        ("taper", &["factor"]),
        ("shear", &["amount"]),
        ("bulge", &["amount", "width"]),
        ("wave", &["amplitude", "length", "phase"]),
        ("lattice", &[]),
    ];
    let Some((kind, valid_names)) = KINDS.iter().find(|k| k.0 == d.kind) else {
        return Err(Error::value(
            format!("deformer \"{}\"", d.kind),
            format!("there is no such deformer; {}", suggestion(&d.kind, KINDS.iter().map(|k| k.0))),
        ));
    };
    if let Some(name) = d.numbers.keys().find(|n| !valid_names.contains(&n.as_str())) {
        return Err(Error::value(
            format!("{kind}: {name}"),
            format!("there is no such parameter; {}", suggestion(name, valid_names.iter().copied())),
        ));
    }
    if let Some((name, value)) = d.numbers.iter().find(|(_, v)| !v.is_finite()) {
        return Err(Error::value(format!("{kind}: {name}"), format!("{value} is not finite")));
    }
    let progress = d.progress.unwrap_or(1.0);
    if !(0.0..=1.0).contains(&progress) {
        return Err(Error::value(format!("{kind}: progress"), format!("{progress} is outside 0 to 1")));
    }
    // A flat sheet has a box all the same.
    let own = bounds.size().max(Vec3::splat(0.01 * bounds.size().max_element()));
    let size = d.size.map_or(own, Size::xyz);
    let placement = Placement::new(d.center.map_or(bounds.center(), Vec3::from), size, d.rotate.map_or(Vec3::ZERO, Vec3::from));
    let placement = placement.map_err(|e| e.within(kind))?;
    let half = size * 0.5;
    let local_from_world = Affine3A::from_scale(size) * Affine3A::from_translation(Vec3::splat(-0.5)) * placement.map_from_world;
    let number = |name: &str, default: f32| d.numbers.get(name).copied().unwrap_or(default);
    let positive = |name: &str, default: f32| match number(name, default) {
        v if v > 0.0 => Ok(v),
        v => Err(Error::value(format!("{kind}: {name}"), format!("{v} is not positive"))),
    };
    let deform = match *kind {
        "twist" => DeformerKind::Twist(progress * number("angle", 90.0).to_radians() / size.z),
        "bend" => DeformerKind::Bend(progress * number("angle", 60.0).to_radians() / size.z),
        "taper" => DeformerKind::Taper(1.0 + progress * (positive("factor", 0.4)? - 1.0)),
        "shear" => DeformerKind::Shear(progress * number("amount", 0.4)),
        "bulge" => DeformerKind::Bulge(progress * number("amount", 0.4), positive("width", 0.25 * size.z)?),
        "wave" => {
            let length = positive("length", 0.4 * size.x.max(size.y))?;
            DeformerKind::Wave(
                progress * number("amplitude", 0.05 * size.max_element()),
                std::f32::consts::TAU / length,
                number("phase", 0.0).to_radians(),
            )
        }
        _ => {
            let mut offsets = [Vec3::ZERO; LATTICE * LATTICE * LATTICE];
            for p in &d.points {
                let index = [p[0], p[1], p[2]];
                if !index.iter().all(|i| (0.0..LATTICE as f32).contains(i) && i.fract() == 0.0) || !p.iter().all(|v| v.is_finite()) {
                    return Err(Error::value("lattice: points", format!("{p:?} is not three indices from 0 to 3 and an offset")));
                }
                let n = (index[2] as usize * LATTICE + index[1] as usize) * LATTICE + index[0] as usize;
                offsets[n] = Vec3::new(p[3], p[4], p[5]) * progress;
            }
            DeformerKind::Lattice(Box::new(offsets))
        }
    };
    Ok(Deformer { deform, local_from_world, half })
}

fn formula(shapes: &[ShapeSource]) -> Result<Formula> {
    if shapes.len() > MAX_SOLIDS {
        return Err(Error::value("shape", format!("at most {MAX_SOLIDS} solids are joined")));
    }
    let solids = shapes.iter().enumerate().map(|(n, s)| {
        let of = |name: &str| format!("shape {}: {name}", n + 1);
        let length = |name: &str, value: Option<f32>, default: f32| match value.unwrap_or(default) {
            v if v.is_finite() && v > 0.0 => Ok(v),
            v => Err(Error::value(of(name), format!("{v} is not a length"))),
        };
        let size = s.size.map_or(Vec3::splat(100.0), Size::xyz);
        if !(size.is_finite() && size.min_element() > 0.0) {
            return Err(Error::value(of("size"), "must be positive lengths"));
        }
        let solid = match s.kind.as_str() {
            "sphere" => Solid::Sphere(length("radius", s.radius, 50.0)?),
            "box" => Solid::Box(size * 0.5),
            "torus" => Solid::Torus(length("radius", s.radius, 40.0)?, length("tube", s.tube, 12.0)?),
            "cylinder" => Solid::Cylinder(length("radius", s.radius, 30.0)?, 0.5 * length("length", s.length, 100.0)?),
            "gyroid" => Solid::Gyroid(length("period", s.period, 30.0)?, length("wall", s.wall, 3.0)?, size * 0.5),
            other => {
                let valid_names = ["sphere", "box", "torus", "cylinder", "gyroid"];
                return Err(Error::value(of(&format!("kind \"{other}\"")), format!("there is no such solid; {}", suggestion(other, valid_names))));
            }
        };
        let join = match s.join.as_deref() {
            None | Some("union") => CsgOperation::Union,
            Some("intersect") => CsgOperation::Intersect,
            Some("subtract") => CsgOperation::Subtract,
            Some(other) => return Err(Error::value(of(&format!("join \"{other}\"")), "is one of union, intersect, subtract")),
        };
        let world_from_local = Affine3A::from_mat3_translation(rotation(s.rotate)?, s.center.map_or(Vec3::ZERO, Vec3::from));
        if !world_from_local.is_finite() {
            return Err(Error::value(of("center"), "must be finite"));
        }
        Ok(PlacedSolid { solid, join, local_from_world: world_from_local.inverse() })
    });
    solids.collect::<Result<_>>().map(Formula)
}

/// The field of no surface at all.
fn nothing_within(bounds: &Bounds) -> DistanceGrid {
    let size = bounds.size();
    let world_from_grid = Affine3A::from_translation(bounds.min) * Affine3A::from_scale(size);
    DistanceGrid::new([2; 3], vec![-size.length(); 8], world_from_grid)
}

impl Assets {
    /// Loads the meshes that a scene names and computes their fields; the box around them.
    ///
    /// # Errors
    /// Files that cannot be read, settings that cannot be used.
    pub(super) fn load_objects(&self, scene: &Scene, progress: &(dyn Fn(f32) + Sync)) -> Result<Bounds> {
        scene.surface.check()?;
        if scene.mesh.len() > MAX_OBJECTS {
            return Err(Error::value("mesh", format!("a scene has at most {MAX_OBJECTS}")));
        }
        let watch = Watch::reporting(progress);
        let mut all = Bounds::EMPTY;
        for (n, source) in self.shown_surfaces(scene).iter().enumerate() {
            let bounds = || -> Result<Bounds> {
                source.check()?;
                if source.path.is_some() {
                    let bounds = self.objects.triangles(self, source)?.mesh.bounds();
                    // A part is made when the deformations are known.
                    if source.representation() != Representation::Triangles && !scene.surface.two_stage {
                        self.objects.implicit(self, source, &scene.surface, None, &watch)?;
                    }
                    return Ok(bounds);
                }
                Ok(self.objects.implicit(self, source, &scene.surface, None, &watch)?.bounds())
            };
            all = all.union(&bounds().map_err(|e| e.within(&source.label(n)))?);
        }
        Ok(all)
    }

    /// The surfaces that a scene shows: its meshes, and the volume's own where the mode asks for it.
    fn shown_surfaces(&self, scene: &Scene) -> Vec<MeshSource> {
        let numbered = scene.mesh.iter().enumerate().map(|(n, m)| MeshSource { name: Some(m.label(n)), ..m.clone() });
        let mut all: Vec<MeshSource> = numbered.filter(|m| !m.hidden).collect();
        if scene.render.mode == Mode::Surface && scene.volume.is_some() && (scene.mesh.is_empty() || scene.surface.iso.is_some()) {
            let iso = scene.surface.iso.unwrap_or_else(|| self.volume.body_threshold());
            all.push(MeshSource { iso: Some(iso), name: Some("volume".into()), ..MeshSource::default() });
        }
        all
    }

    /// Resolves a scene's surfaces.
    ///
    /// # Errors
    /// As [`Self::load_objects`].
    pub(super) fn surfaces(&self, scene: &Scene, stack: &Stack, cuts: &CutShapes) -> Result<Surfaces> {
        let general = &scene.surface;
        general.check()?;
        let shown = self.shown_surfaces(scene);
        let slopes = OnceLock::new();
        let objects = shown.iter().enumerate().map(|(n, source)| {
            let object = || -> Result<SurfaceObject> {
                source.check()?;
                self.object(scene, source, n, stack, cuts, &slopes)
            };
            object().map_err(|e| e.within(&source.label(n)))
        });
        Ok(Surfaces { objects: objects.collect::<Result<_>>()?, steps: general.steps, threshold: general.threshold })
    }

    fn object<'a>(
        &self,
        scene: &Scene,
        source: &MeshSource,
        n: usize,
        stack: &'a Stack,
        cuts: &'a CutShapes,
        slopes: &'a OnceLock<LipschitzBounds<'a>>,
    ) -> Result<SurfaceObject> {
        let general = &scene.surface;
        let look = source.appearance.resolve(&general.appearance)?;
        let only_triangles = source.representation() == Representation::Triangles;
        let untouched = source.rigid || (stack.is_empty() && cuts.is_empty());
        // The inner wall of a thick skin is no part of the triangles: such a surface is cast whole.
        let both = general.two_stage && source.path.is_some() && source.representation() == Representation::Field && look.model != CutModel::Thick;
        let triangles = if only_triangles || both { Some(self.objects.triangles(self, source)?) } else { None };
        // In two stages only what the boxes' matter comes from is needed as a field.
        let mut region = None;
        if let (true, Some(t)) = (both && cuts.is_empty(), &triangles) {
            let cell = cell_of(&t.mesh.bounds(), source.resolution.unwrap_or(general.resolution));
            let part = stack.maps().iter().map(|m| stack.source_bounds(&m.bounds_in_world()).0).fold(Bounds::EMPTY, |a, b| a.union(&b));
            let part = part.grown((4.0 + general.seam) * cell).intersection(&t.mesh.bounds().grown(0.99 * MARGIN * cell));
            region = Some(part);
        }
        let nothing_to_cast = both && (untouched || region.is_some_and(|r| r.is_empty()));
        let implicit =
            if only_triangles || nothing_to_cast { None } else { Some(self.objects.implicit(self, source, general, region, &Watch::NONE)?) };
        let bounds = match (&implicit, &triangles) {
            (Some(i), _) => i.bounds(),
            (None, Some(t)) => t.mesh.bounds(),
            (None, None) => Bounds::EMPTY,
        };
        let cell_mm = implicit.as_ref().map_or(bounds.size().max_element() / 128.0, Implicit::cell_mm);
        let thickness_mm = if look.model == CutModel::Thick { look.thickness.unwrap_or(bounds.size().max_element() / 40.0) } else { 0.0 };
        let stage = match (&implicit, both) {
            (None, _) => Stage::Triangles,
            (Some(_), true) => Stage::Both(general.seam * cell_mm),
            (Some(_), false) => Stage::Rays,
        };
        let casting = SurfaceCellsInputs {
            implicit: implicit.clone(),
            bounds,
            stack: if source.rigid { None } else { Some(stack) },
            cuts,
            model: look.model,
            thickness_mm,
            skip_cuts: general.cut_skipping,
            boxes_only: matches!(stage, Stage::Both(_)),
            cell_mm,
            skipping: scene.render.empty_space_skipping,
        };
        let cells = self.objects.cells.of(&casting, slopes);
        let deformers = if triangles.is_some() { deformers(&source.deformer, &self.objects.placed(self, source)?.bounds())? } else { Vec::new() };
        Ok(SurfaceObject {
            name: source.label(n),
            look,
            thickness_mm,
            implicit,
            triangles,
            stage,
            rigid: source.rigid,
            deformers,
            normals: source.normals,
            cell_mm,
            step_mm: scene.render.step * cell_mm,
            cells,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fields that nothing shows are let go of beyond what is kept, those that something shows never.
    #[test]
    fn fields_are_kept_as_far_as_there_is_room() {
        let field = || Arc::new(DistanceGrid::new([2; 3], vec![0.0; 8], Affine3A::IDENTITY));
        let (mut entries, shown) = (FieldCache::default(), field());
        entries.insert("shown".into(), shown.clone(), 4 * 32);
        for name in ["a", "b", "c", "d", "e"] {
            entries.insert(name.into(), field(), 4 * 32);
            assert!(entries.get(name).is_some());
        }
        assert!(entries.get("a").is_none() && entries.get("b").is_none() && entries.get("c").is_some(), "{}", entries.0.len());
        assert!(Arc::ptr_eq(&shown, &entries.get("shown").unwrap_or_else(field)));
    }
}
