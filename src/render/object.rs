//! What a device has of a surface.

use super::target::RenderTexture;
use crate::prepare::objects::Triangles;
use crate::prepare::surface_cells::{SolidIdentity, SurfaceCells};
use std::sync::Arc;

/// What the device has of an object, by its place in the scene.
pub(super) struct CachedObject {
    /// The object's own, its solids and its deformers.
    pub(super) uniforms: [wgpu::Buffer; 3],
    /// What the field's texture holds; none of formulas.
    pub(super) sampled: Option<SolidIdentity>,
    pub(super) field: RenderTexture,
    pub(super) of_cells: Arc<SurfaceCells>,
    pub(super) cells: RenderTexture,
    pub(super) corners: Option<Corners>,
    pub(super) group: wgpu::BindGroup,
}

/// A corner of a triangle: position and normal.
pub(super) type MeshCorner = [[f32; 3]; 2];

/// Triangles on the device.
#[derive(Clone)]
pub(super) struct Corners {
    pub(super) of: Arc<Triangles>,
    pub(super) buffer: wgpu::Buffer,
    pub(super) count: u32,
}
