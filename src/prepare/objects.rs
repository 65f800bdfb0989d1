//! Surfaces resolved for rendering: every `[[mesh]]`, and the volume's own surface if the mode
//! requires it, as an implicit solid, as triangles, or both.

use super::assets::Assets;
use super::mesh_settings::deformers;
pub use super::object_cache::Triangles;
use super::object_cache::shown_surfaces;
use super::surface_cells::{SurfaceCells, SurfaceCellsInputs};
use crate::deform::Stack;
use crate::deform::cut::CutShapes;
use crate::deform::lipschitz::LipschitzBounds;
use crate::math::Bounds;
use crate::mesh::Implicit;
use crate::mesh::deformer::{Deformer, NormalMethod};
use crate::mesh::field::{MARGIN, cell_of};
use crate::scene::surface::{CutModel, Look, MeshSource, Representation, Steps, SurfaceSettings};
use crate::scene::{Mode, Scene};
use crate::{Result, Watch};
use glam::Vec3;
use std::sync::{Arc, OnceLock};

/// How an object is rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stage {
    /// Rays through its field.
    Rays,
    /// Triangles outside the deformations' boxes, rays within, blended over a seam of this width,
    /// mm.
    Both(f32),
    /// Triangles alone.
    Triangles,
}

/// One surface.
pub struct SurfaceObject {
    /// Its name in messages.
    pub name: String,
    /// Its appearance.
    pub look: Look,
    /// Thickness of a thick surface, mm; 0 for others.
    pub thickness_mm: f32,
    /// The implicit function sampled by rays.
    pub implicit: Option<Implicit>,
    /// Its triangles, if they are drawn.
    pub triangles: Option<Arc<Triangles>>,
    /// How it is rendered.
    pub stage: Stage,
    /// Whether the scene's deformations do not apply to it.
    pub rigid: bool,
    /// Forward deformers, for the vertex shader.
    pub deformers: Vec<Deformer>,
    /// How these transform normals.
    pub normals: NormalMethod,
    /// Resolution of f, mm.
    pub cell_mm: f32,
    /// Length of an even step, mm.
    pub step_mm: f32,
    /// Empty space.
    pub cells: Arc<SurfaceCells>,
}

impl SurfaceObject {
    /// Whether a point of the undeformed scene lies inside.
    pub(super) fn contains(&self, source: Vec3) -> bool {
        self.implicit.as_ref().is_some_and(|i| i.value(source) > 0.0)
    }
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

impl Surfaces {
    /// The finest resolution of an object, mm; infinite if there is none.
    pub(super) fn finest_cell_mm(&self) -> f32 {
        let cells = self.objects.iter().map(|o| o.cell_mm);
        cells.fold(f32::INFINITY, f32::min)
    }
}

impl Assets {
    /// Resolves a scene's surfaces.
    ///
    /// # Errors
    /// Files that cannot be read, or invalid settings.
    pub(super) fn surfaces(&self, scene: &Scene, stack: &Stack, cuts: &CutShapes) -> Result<Surfaces> {
        let general = &scene.surface;
        general.check()?;
        let shown = shown_surfaces(scene, &self.volume);
        let slopes = OnceLock::new();
        let objects = shown.iter().enumerate().map(|(n, source)| {
            let object = || -> Result<SurfaceObject> {
                source.check()?;
                self.object(scene, source, n, stack, cuts, &slopes)
            };
            object().map_err(|e| e.within(&source.label(n)))
        });
        Ok(Surfaces {
            objects: objects.collect::<Result<_>>()?,
            steps: general.steps,
            threshold: general.threshold,
        })
    }

    /// Resolves surface `n` of a scene. `slopes` holds the stack's Lipschitz bounds, computed on
    /// first use.
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
        // Slices sample surfaces everywhere.
        let both = has_two_stages(source, general, look.model) && scene.render.mode != Mode::Slice;
        let triangles = if only_triangles || both {
            Some(self.objects.triangles(&self.library, source)?)
        } else {
            None
        };
        let in_boxes = triangles.as_ref().filter(|_| both && cuts.is_empty());
        let region = in_boxes.map(|t| field_region(&t.mesh.bounds(), source, general, stack));
        let nothing_to_cast = both && (untouched || region.is_some_and(|r| r.is_empty()));
        let implicit = if only_triangles || nothing_to_cast {
            None
        } else {
            Some(
                self.objects
                    .implicit(&self.library, source, general, region, &Watch::NONE)?,
            )
        };
        let bounds = match (&implicit, &triangles) {
            (Some(i), _) => i.bounds(),
            (None, Some(t)) => t.mesh.bounds(),
            (None, None) => Bounds::EMPTY,
        };
        let cell_mm = implicit
            .as_ref()
            .map_or(bounds.size().max_element() / 128.0, Implicit::cell_mm);
        let thickness_mm = if look.model == CutModel::Thick {
            look.thickness.unwrap_or(bounds.size().max_element() / 40.0)
        } else {
            0.0
        };
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
        let deformers = if triangles.is_some() {
            deformers(
                &source.deformer,
                &self.objects.placed(&self.library, source)?.bounds(),
            )?
        } else {
            Vec::new()
        };
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

/// Whether a surface is drawn in two stages: as triangles outside the deformations' boxes, by ray
/// casting inside.
fn has_two_stages(source: &MeshSource, general: &SurfaceSettings, model: CutModel) -> bool {
    // The inner wall of a thick skin is not part of the triangles: such a surface is rendered
    // entirely by rays.
    general.two_stage
        && source.path.is_some()
        && source.representation() == Representation::Field
        && model != CutModel::Thick
}

/// The part of a mesh's box in which two-stage rendering needs the field, mm: the source region of
/// the deformations' boxes.
fn field_region(mesh: &Bounds, source: &MeshSource, general: &SurfaceSettings, stack: &Stack) -> Bounds {
    let cell = cell_of(mesh, source.resolution.unwrap_or(general.resolution));
    let part = stack
        .maps()
        .iter()
        .map(|m| stack.source_bounds(&m.bounds_in_world()).0)
        .fold(Bounds::EMPTY, |a, b| a.union(&b));
    part.grown((4.0 + general.seam) * cell)
        .intersection(&mesh.grown(0.99 * MARGIN * cell))
}
