//! What casts shadows.

use crate::deform::Stack;
use crate::deform::cut::CutShapes;
use crate::math::Bounds;
use crate::mesh::Implicit;
use crate::prepare::Macrocells;
use crate::prepare::object_cache::Triangles;
use crate::prepare::surface_cells::SurfaceCells;
use crate::scene::surface::CutModel;
use crate::transfer::TransferTable;
use crate::volume::VoxelGrid;
use glam::{Affine3A, Vec3};
use std::sync::Arc;

/// The parts of a scene that cast shadows.
pub struct Casters<'a> {
    pub stack: &'a Stack,
    pub cuts: &'a CutShapes,
    /// The volume, if it is composited and anything of it is visible.
    pub volume: Option<VolumeCaster<'a>>,
    pub surfaces: Vec<SurfaceCaster<'a>>,
    /// The length for which opacities are stated, mm.
    pub reference_mm: f32,
}

/// A volume.
pub struct VolumeCaster<'a> {
    pub grid: &'a VoxelGrid,
    pub voxel_from_world: &'a Affine3A,
    pub grid_size: Vec3,
    pub table: &'a TransferTable,
    /// Normalised value of the iso-surface shown instead of the volume.
    pub iso: Option<f32>,
    pub macrocells: &'a Arc<Macrocells>,
}

/// A surface.
pub struct SurfaceCaster<'a> {
    /// The solid, if any of it is shown by rays.
    pub implicit: Option<&'a Implicit>,
    /// The triangles, if any of them are drawn.
    pub triangles: Option<&'a Arc<Triangles>>,
    pub cells: &'a Arc<SurfaceCells>,
    pub model: CutModel,
    pub thickness_mm: f32,
    /// Whether the scene's deformations do not apply to it.
    pub rigid: bool,
}

impl Casters<'_> {
    /// The box that holds all of them, mm.
    pub(super) fn bounds(&self) -> Bounds {
        let volume = self
            .volume
            .as_ref()
            .map_or(Bounds::EMPTY, |v| v.macrocells.occupied);
        self.surfaces.iter().fold(volume, |all, surface| {
            let triangles = surface.triangles.map_or(Bounds::EMPTY, |t| t.mesh.bounds());
            all.union(&surface.cells.grid.occupied).union(&triangles)
        })
    }
}
