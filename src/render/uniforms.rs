//! Inputs of the shaders other than textures: `shaders/types/frame.wgsl` in Rust. A test compares
//! names, offsets and sizes.

use super::constants::{ImplicitKind, MeshDeformerKind, SolidKind};
use crate::deform::cut::CutShape;
use crate::deform::{MAX_FORMULA_NUMBERS, MAX_MAPS, PlacedMap};
use crate::mesh::Implicit;
use crate::mesh::deformer::{Deformer, DeformerKind};
use crate::mesh::formula::{PlacedSolid, Solid};
use crate::prepare::objects::{Stage, SurfaceObject};
use crate::prepare::{CellGrid, Prepared, VisibilityCriteria};
use crate::scene::Projection;
use crate::scene::surface::{CutModel, Steps};
use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, Mat3, Mat4, Vec3};

/// Number of levels of boxes of a map in `shaders/classify.wgsl`.
pub(super) const MAP_LEVELS: usize = 8;
/// Number of levels of boxes of the volume there.
pub(super) const VALUE_LEVELS: usize = 12;

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
    pub jitter: u32,
    pub texture_size: [f32; 3],
    pub gradient_scale: f32,
    pub face: [f32; 3],
    pub stored_offset: f32,
    pub per_texture_size: [f32; 3],
    pub thin_depth: f32,
    pub sample_offset: [f32; 2],
    pub more_padding: [f32; 2],
    pub key_color: [f32; 3],
    pub key_padding: f32,
    pub sky_color: [f32; 3],
    pub sky_padding: f32,
    pub light_origin: [f32; 3],
    pub light_offset_mm: f32,
    pub light_per_size: [f32; 3],
    pub light_padding: f32,
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
    pub joins_previous: u32,
    pub intersects_group: u32,
}

impl CutShapeUniform {
    /// One cut.
    pub fn new(p: &CutShape) -> Self {
        Self {
            local_from_world: affine(&p.local_from_world),
            half: p.half.into(),
            shape: p.shape as u32,
            half_angle: p.half_angle,
            sense: if p.inverted { -1.0 } else { 1.0 },
            joins_previous: u32::from(p.joins_previous),
            intersects_group: u32::from(p.intersects),
        }
    }
}

/// Number of placements that a pass binds: those of its maps, and of a precomposed map.
pub const PLACED_MAPS: usize = MAX_MAPS + 1;

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
    pub scale: f32,
    pub origin: [f32; 3],
    pub single: f32,
    pub per_atlas: [f32; 3],
    pub radius_mm: f32,
    pub box_mm: [f32; 3],
    pub min_radius_mm: f32,
    pub slopes_origin: [f32; 3],
    pub slopes_scale: f32,
}

fn affine(m: &Affine3A) -> [f32; 16] {
    Mat4::from(*m).to_cols_array()
}

impl FrameUniform {
    /// The constants of a scene; `value_scale` and `value_offset` map texels to normalised values,
    /// and `gradient_scale` maps them to gradients; the texels span `texture_size` voxels.
    pub fn new(
        scene: &Prepared,
        [value_scale, value_offset, gradient_scale]: [f32; 3],
        texture_size: [f32; 3],
    ) -> Self {
        let frame = &scene.frame;
        let light = &scene.light;
        let cells = &scene.volume().macrocells;
        let light_volume = scene.light_volume.as_ref();
        let lit_box = light_volume.map(|v| v.texture_box());
        Self {
            clip_from_world: frame.view.clip_from_world().to_cols_array(),
            voxel_from_world: affine(&scene.volume().voxel_from_world),
            eye: frame.view.eye.into(),
            perspective: if frame.view.projection == Projection::Perspective {
                1.0
            } else {
                0.0
            },
            forward: frame.view.forward.into(),
            step_mm: frame.spacing.step_mm,
            right: frame.view.right.into(),
            reference_mm: frame.spacing.reference_mm,
            up: frame.view.up.into(),
            blend_near_mm: frame.spacing.blend_mm[0],
            to_light: frame.to_light.into(),
            blend_far_mm: frame.spacing.blend_mm[1],
            proxy_min: frame.proxy.min.into(),
            ambient: light.ambient,
            proxy_max: frame.proxy.max.into(),
            diffuse: light.diffuse,
            grid_size: scene.volume().grid_size.into(),
            specular: light.specular,
            cells_origin: cells.origin.into(),
            shininess: light.shininess,
            cell_mm: cells.cell_mm.into(),
            value_scale,
            cells: cells.size.to_array(),
            value_offset,
            picture: [frame.size[0] as f32, frame.size[1] as f32],
            table_scale: scene.volume().table.scale,
            table_offset: scene.volume().table.offset,
            gradient_top: if scene.uses_gradient_opacity() {
                scene.volume().table.gradient_top
            } else {
                0.0
            },
            two_sided: u32::from(scene.is_lit_on_both_sides()),
            has_holes: u32::from(scene.volume().grid.has_holes),
            early_termination: u32::from(scene.ends_early()),
            grey_low: scene.volume().grey_window[0],
            grey_high: scene.volume().grey_window[1],
            iso: scene.volume().iso.unwrap_or(0.0),
            jitter: u32::from(scene.settings.jitter),
            texture_size,
            gradient_scale,
            face: scene.deformed_face_margin_voxels().into(),
            stored_offset: scene.volume().grid.offset,
            per_texture_size: texture_size.map(f32::recip),
            thin_depth: scene.thin_depth(),
            sample_offset: [0.0; 2],
            more_padding: [0.0; 2],
            key_color: light.key_color,
            key_padding: 0.0,
            sky_color: light.sky_color,
            sky_padding: 0.0,
            light_origin: lit_box.map_or([0.0; 3], |b| b.min.into()),
            light_offset_mm: light_volume.map_or(0.0, |v| v.offset_mm()),
            light_per_size: lit_box.map_or([1.0; 3], |b| b.size().recip().into()),
            light_padding: 0.0,
        }
    }

    /// The same for samples at an offset from the centre of each pixel, pixels.
    pub(super) fn with_offset(mut self, offset: [f32; 2]) -> Self {
        self.sample_offset = offset;
        // What lies at the offset moves to the centre.
        let [x, y] = [
            -2.0 * offset[0] / self.picture[0],
            2.0 * offset[1] / self.picture[1],
        ];
        let moved = Mat4::from_translation(Vec3::new(x, y, 0.0));
        self.clip_from_world = (moved * Mat4::from_cols_array(&self.clip_from_world)).to_cols_array();
        self
    }
}

impl PlacedMapUniform {
    /// One map of the stack, whose texels start at `origin`, and whose stored slopes, if there are
    /// any, at `slopes_origin`, in an atlas of half or `single`
    /// precision with `atlas` texels.
    pub fn new(
        placed: &PlacedMap,
        origin: [u32; 3],
        slopes_origin: [u32; 3],
        single: bool,
        atlas: [u32; 3],
    ) -> Self {
        let world_from_stored = Mat3::from(placed.placement.world_from_map.matrix3) * placed.map.scale;
        Self {
            map_from_world: affine(&placed.placement.map_from_world),
            world_from_stored: Mat4::from_mat3(world_from_stored).to_cols_array(),
            size: Vec3::from(placed.map.size.map(|n| n as f32)).into(),
            added: if placed.added { 1.0 } else { 0.0 },
            reach: placed.reach.into(),
            scale: placed.map.scale,
            origin: origin.map(|n| n as f32),
            single: f32::from(u8::from(single)),
            per_atlas: atlas.map(|n| (n as f32).recip()),
            radius_mm: placed.cylinder.map_or(0.0, |c| c.radius_mm),
            box_mm: placed.placement.size_mm().into(),
            min_radius_mm: placed.cylinder.map_or(0.0, |c| c.min_radius_mm),
            slopes_origin: slopes_origin.map(|n| n as f32),
            slopes_scale: placed
                .filter
                .slopes
                .as_ref()
                .map_or(0.0, |slopes| slopes.scale / placed.map.scale),
        }
    }
}

/// `SurfaceObject` of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[allow(missing_docs, reason = "documented in shaders/types/surface.wgsl")]
pub struct SurfaceObjectUniform {
    pub grid_from_world: [f32; 16],
    pub world_from_grid: [f32; 16],
    pub size: [f32; 3],
    pub kind: u32,
    pub cells_origin: [f32; 3],
    pub resolution_mm: f32,
    pub cell_mm: [f32; 3],
    pub step_mm: f32,
    pub cells: [u32; 3],
    pub thickness_mm: f32,
    pub occupied_min: [f32; 3],
    pub solid: u32,
    pub occupied_max: [f32; 3],
    pub steps: u32,
    pub color: [f32; 3],
    pub highlight: f32,
    pub inside: [f32; 3],
    pub shininess: f32,
    pub cut: [f32; 3],
    pub threshold_mm: f32,
    pub low: [f32; 3],
    pub solids: u32,
    pub high: [f32; 3],
    pub face: u32,
    pub seam_mm: f32,
    pub rigid: u32,
    pub both: u32,
    pub deformers: u32,
    pub normal_method: u32,
    pub vertex_offset_mm: f32,
    pub padding: [f32; 2],
}

impl SurfaceObjectUniform {
    /// One object.
    pub fn new(scene: &Prepared, object: &SurfaceObject) -> Self {
        let grid = &object.cells.grid;
        let mut u = Self {
            size: [1.0; 3],
            cells_origin: grid.origin.into(),
            resolution_mm: object.cell_mm,
            cell_mm: grid.cell_mm.into(),
            step_mm: object.step_mm,
            cells: grid.size.to_array(),
            thickness_mm: object.thickness_mm,
            // An empty box has infinite corners, which must not enter shader arithmetic.
            occupied_min: if grid.occupied.is_empty() {
                [1.0; 3]
            } else {
                grid.occupied.min.into()
            },
            solid: u32::from(object.look.model != CutModel::Hollow),
            occupied_max: if grid.occupied.is_empty() {
                [-1.0; 3]
            } else {
                grid.occupied.max.into()
            },
            steps: match scene.surfaces.steps {
                Steps::Uniform => 0,
                Steps::Threshold => 1,
                Steps::Jacobian => 2,
                Steps::JacobianBound => 3,
                Steps::Sphere => 4,
            },
            color: object.look.color,
            highlight: object.look.highlight[0],
            inside: object.look.inside,
            shininess: object.look.highlight[1],
            cut: object.look.cut,
            threshold_mm: scene.surfaces.threshold * object.cell_mm,
            seam_mm: if let Stage::Both(seam) = object.stage {
                seam
            } else {
                0.0
            },
            rigid: u32::from(object.rigid),
            both: u32::from(matches!(object.stage, Stage::Both(_))),
            deformers: object.deformers.len() as u32,
            normal_method: object.normals as u32,
            vertex_offset_mm: crate::mesh::deformer::vertex_offset_mm(&object.deformers),
            ..Self::zeroed()
        };
        match &object.implicit {
            Some(Implicit::Grid(g)) => {
                u.grid_from_world = affine(&g.grid_from_world);
                u.world_from_grid = affine(&g.world_from_grid);
                u.size = g.size.map(|n| n as f32);
            }
            Some(Implicit::Formula(f)) => {
                (u.kind, u.solids) = (ImplicitKind::Formula as u32, f.0.len() as u32)
            }
            Some(Implicit::Depth(d)) => {
                (u.kind, u.face) = (ImplicitKind::Depth as u32, d.faces[0]);
                u.size = [d.size, d.size, d.faces.len()].map(|n| n as f32);
                (u.low, u.high) = (d.bounds.min.into(), d.bounds.max.into());
            }
            None => {}
        }
        u
    }
}

/// `PlacedSolid` of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[allow(missing_docs, reason = "documented in shaders/types/surface.wgsl")]
pub struct PlacedSolidUniform {
    pub local_from_world: [f32; 16],
    pub numbers: [f32; 4],
    pub solid: u32,
    pub join: u32,
    pub period: f32,
    pub wall: f32,
}

impl PlacedSolidUniform {
    /// One solid.
    pub fn new(s: &PlacedSolid) -> Self {
        let (solid, numbers, period, wall) = match s.solid {
            Solid::Sphere(r) => (SolidKind::Sphere, [r, 0.0, 0.0, 0.0], 0.0, 0.0),
            Solid::Box(half) => (SolidKind::Box, half.extend(0.0).to_array(), 0.0, 0.0),
            Solid::Torus(ring, tube) => (SolidKind::Torus, [ring, tube, 0.0, 0.0], 0.0, 0.0),
            Solid::Cylinder(radius, half) => (SolidKind::Cylinder, [radius, half, 0.0, 0.0], 0.0, 0.0),
            Solid::Gyroid(period, wall, half) => {
                (SolidKind::Gyroid, half.extend(0.0).to_array(), period, wall)
            }
        };
        let (solid, join) = (solid as u32, s.join as u32);
        Self {
            local_from_world: affine(&s.local_from_world),
            numbers,
            solid,
            join,
            period,
            wall,
        }
    }
}

/// `Deformer` of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[allow(missing_docs, reason = "documented in shaders/types/surface.wgsl")]
pub struct DeformerUniform {
    pub local_from_world: [f32; 16],
    pub numbers: [f32; 4],
    pub half: [f32; 3],
    pub kind: u32,
    pub offsets: [[f32; 4]; 64],
}

impl DeformerUniform {
    /// One deformer.
    pub fn new(d: &Deformer) -> Self {
        let mut u = Self {
            local_from_world: affine(&d.local_from_world),
            half: d.half.into(),
            ..Self::zeroed()
        };
        let three = |a: f32, b: f32, c: f32| [a, b, c, 0.0];
        let (kind, numbers) = match &d.deform {
            DeformerKind::Twist(rate) => (MeshDeformerKind::Twist, three(*rate, 0.0, 0.0)),
            DeformerKind::Bend(rate) => (MeshDeformerKind::Bend, three(*rate, 0.0, 0.0)),
            DeformerKind::Taper(factor) => (MeshDeformerKind::Taper, three(*factor, 0.0, 0.0)),
            DeformerKind::Shear(share) => (MeshDeformerKind::Shear, three(*share, 0.0, 0.0)),
            DeformerKind::Bulge(amount, width) => (MeshDeformerKind::Bulge, three(*amount, *width, 0.0)),
            DeformerKind::Wave(amplitude, frequency, phase) => {
                (MeshDeformerKind::Wave, three(*amplitude, *frequency, *phase))
            }
            DeformerKind::Lattice(offsets) => {
                u.offsets
                    .iter_mut()
                    .zip(offsets.iter())
                    .for_each(|(u, o)| *u = o.extend(0.0).to_array());
                (MeshDeformerKind::Lattice, [0.0; 4])
            }
        };
        (u.kind, u.numbers) = (kind as u32, numbers);
        u
    }
}

/// `NodeBounds` of `shaders/types/bounds.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[allow(missing_docs, reason = "documented in the shader")]
pub struct NodeBounds {
    pub low: [f32; 4],
    pub high: [f32; 4],
    pub slope_low: [[f32; 4]; 3],
    pub slope_high: [[f32; 4]; 3],
}

/// `MapDefinition` of `shaders/sample.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[allow(missing_docs, reason = "documented in the shader")]
pub struct MapDefinitionUniform {
    pub cube_mm: [f32; 3],
    pub ramp_mm: f32,
    pub size: [u32; 3],
    pub kind: u32,
    pub numbers: [f32; MAX_FORMULA_NUMBERS],
}

/// `Level` of `shaders/bounds.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[allow(missing_docs, reason = "documented in the shader")]
pub struct LevelUniform {
    pub size: [u32; 3],
    pub first: u32,
    pub below_size: [u32; 3],
    pub below_first: u32,
}

/// `Classification` of `shaders/classify.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[allow(missing_docs, reason = "documented in shaders/classify.wgsl")]
pub struct ClassificationUniform {
    pub voxel_from_world: [f32; 16],
    pub origin: [f32; 3],
    pub lookback_mm: f32,
    pub cell_mm: [f32; 3],
    pub cut_lookback_mm: f32,
    pub size: [u32; 3],
    pub cut_margin_mm: f32,
    pub voxel_low: [f32; 3],
    pub margin_mm: f32,
    pub voxel_high: [f32; 3],
    pub iso: f32,
    pub table_scale: f32,
    pub table_offset: f32,
    pub has_iso: u32,
    pub grey_faces: u32,
    pub composite: u32,
    pub stack_has_cuts: u32,
    pub value_shift: u32,
    pub value_levels: u32,
    pub value_size: [u32; 3],
    pub precompose_error_mm: f32,
    pub values: [[u32; 4]; VALUE_LEVELS],
    pub maps: [[u32; 4]; MAX_MAPS],
    pub levels: [[u32; 4]; MAX_MAPS * MAP_LEVELS],
}

impl ClassificationUniform {
    /// A grid and the criteria for its cells; `value_levels` has the nodes along each axis and the
    /// first node of each level of the bounds on values.
    pub fn new(cells: &CellGrid, contents: &VisibilityCriteria, value_levels: &[[u32; 4]]) -> Self {
        let (value_size, value_shift) = contents.value_pyramid.grid();
        let mut values = [[0; 4]; VALUE_LEVELS];
        values
            .iter_mut()
            .zip(value_levels)
            .for_each(|(to, from)| *to = *from);
        Self {
            voxel_from_world: affine(contents.voxel_from_world),
            origin: cells.bounds.min.into(),
            lookback_mm: contents.lookback_mm,
            cell_mm: cells.cell_mm.into(),
            cut_lookback_mm: contents.cut_lookback_mm,
            size: cells.size.into(),
            cut_margin_mm: contents.cut_margin_mm,
            voxel_low: contents.voxel_box.min.into(),
            margin_mm: cells.margin_mm,
            voxel_high: contents.voxel_box.max.into(),
            iso: contents.iso.unwrap_or(0.0),
            table_scale: contents.table.scale,
            table_offset: contents.table.offset,
            has_iso: u32::from(contents.iso.is_some()),
            grey_faces: u32::from(contents.grey_faces),
            composite: u32::from(contents.blend == crate::transfer::Blend::Composite),
            stack_has_cuts: u32::from(contents.stack.has_cuts()),
            value_shift,
            value_levels: value_levels.len() as u32,
            value_size: value_size.map(|n| n as u32),
            precompose_error_mm: contents.stack.precompose_error_mm(),
            values,
            maps: Zeroable::zeroed(),
            levels: Zeroable::zeroed(),
        }
    }

    /// The bounds of map `k`, whose nodes start at `first`.
    pub fn set_map(&mut self, k: usize, levels: &[[u32; 4]], first: u32, cuts: bool) {
        self.maps[k] = [levels.len() as u32, u32::from(cuts), 0, 0];
        for (to, &[x, y, z, at]) in self.levels[k * MAP_LEVELS..][..MAP_LEVELS].iter_mut().zip(levels) {
            *to = [x, y, z, first + at];
        }
    }
}
