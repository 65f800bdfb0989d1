//! What the shaders read besides textures: `shaders/types/frame.wgsl` in Rust. A test compares names, offsets and sizes.

use crate::deform::PlacedMap;
use crate::deform::cut::Primitive;
use crate::scene::{Prepared, Projection};
use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, Mat3, Mat4, Vec3};

/// `Frame` of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[allow(missing_docs, reason = "documented in shaders/types/frame.wgsl")]
pub struct FrameUniform {
    pub clip_from_world: [f32; 16],
    pub voxel_from_world: [f32; 16],
    pub eye: [f32; 3],
    pub perspective: f32,
    pub forward: [f32; 3],
    pub step_mm: f32,
    pub right: [f32; 3],
    pub reference_mm: f32,
    pub up: [f32; 3],
    pub blend_near_mm: f32,
    pub to_light: [f32; 3],
    pub blend_far_mm: f32,
    pub proxy_min: [f32; 3],
    pub ambient: f32,
    pub proxy_max: [f32; 3],
    pub diffuse: f32,
    pub grid_size: [f32; 3],
    pub specular: f32,
    pub cells_origin: [f32; 3],
    pub shininess: f32,
    pub cell_mm: [f32; 3],
    pub value_scale: f32,
    pub cells: [u32; 3],
    pub value_offset: f32,
    pub picture: [f32; 2],
    pub table_scale: f32,
    pub table_offset: f32,
    pub gradient_top: f32,
    pub two_sided: u32,
    pub has_holes: u32,
    pub early_termination: u32,
    pub grey_low: f32,
    pub grey_high: f32,
    pub iso: f32,
    pub padding: f32,
}

/// `CutShape` of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[allow(missing_docs, reason = "documented in shaders/types/frame.wgsl")]
pub struct CutShapeUniform {
    pub local_from_world: [f32; 16],
    pub half: [f32; 3],
    pub shape: u32,
    pub half_angle: f32,
    pub sense: f32,
    pub joined: u32,
    pub and_group: u32,
}

impl CutShapeUniform {
    /// One cut.
    pub fn new(p: &Primitive) -> Self {
        Self {
            local_from_world: affine(&p.local_from_world),
            half: p.half.into(),
            shape: p.shape as u32,
            half_angle: p.half_angle,
            sense: if p.inverted { -1.0 } else { 1.0 },
            joined: u32::from(p.joined),
            and_group: u32::from(p.and),
        }
    }
}

/// `PlacedMap` of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[allow(missing_docs, reason = "documented in shaders/types/frame.wgsl")]
pub struct PlacedMapUniform {
    pub map_from_world: [f32; 16],
    pub world_from_stored: [f32; 16],
    pub size: [f32; 3],
    pub added: f32,
    pub reach: [f32; 3],
    pub padding: f32,
}

fn affine(m: &Affine3A) -> [f32; 16] {
    Mat4::from(*m).to_cols_array()
}

impl FrameUniform {
    /// The constants of a scene; texels become normalised values by `value_scale` and `value_offset`.
    pub fn new(scene: &Prepared, value_scale: f32, value_offset: f32) -> Self {
        let frame = &scene.frame;
        let light = &scene.light;
        let cells = &scene.macrocells;
        Self {
            clip_from_world: frame.view.clip_from_world().to_cols_array(),
            voxel_from_world: affine(&frame.voxel_from_world),
            eye: frame.view.eye.into(),
            perspective: if frame.view.projection == Projection::Perspective { 1.0 } else { 0.0 },
            forward: frame.view.forward.into(),
            step_mm: frame.step_mm,
            right: frame.view.right.into(),
            reference_mm: frame.reference_mm,
            up: frame.view.up.into(),
            blend_near_mm: frame.blend_mm[0],
            to_light: frame.to_light.into(),
            blend_far_mm: frame.blend_mm[1],
            proxy_min: frame.proxy.min.into(),
            ambient: light.ambient,
            proxy_max: frame.proxy.max.into(),
            diffuse: light.diffuse,
            grid_size: frame.grid_size.into(),
            specular: light.specular,
            cells_origin: cells.origin.into(),
            shininess: light.shininess,
            cell_mm: cells.cell_mm.into(),
            value_scale,
            cells: cells.size.to_array(),
            value_offset,
            picture: [frame.size[0] as f32, frame.size[1] as f32],
            table_scale: scene.table.scale,
            table_offset: scene.table.offset,
            gradient_top: if scene.uses_gradient_opacity() { scene.table.gradient_top } else { 0.0 },
            two_sided: u32::from(light.two_sided),
            has_holes: u32::from(scene.grid.has_holes),
            early_termination: u32::from(scene.settings.early_termination),
            grey_low: scene.grey_window[0],
            grey_high: scene.grey_window[1],
            iso: scene.iso.unwrap_or(0.0),
            padding: 0.0,
        }
    }
}

impl PlacedMapUniform {
    /// One map of the stack.
    pub fn new(placed: &PlacedMap) -> Self {
        let world_from_stored = Mat3::from(placed.placement.world_from_map.matrix3) * placed.map.scale;
        Self {
            map_from_world: affine(&placed.placement.map_from_world),
            world_from_stored: Mat4::from_mat3(world_from_stored).to_cols_array(),
            size: Vec3::from(placed.map.size.map(|n| n as f32)).into(),
            added: if placed.added { 1.0 } else { 0.0 },
            reach: placed.reach.into(),
            padding: 0.0,
        }
    }
}
