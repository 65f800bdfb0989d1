//! The device resources of a surface.

use super::context::{Context, UNIFORM, extent, layout_entries};
use super::target::RenderTexture;
use super::uniforms::{DeformerUniform, PlacedSolidUniform, SurfaceObjectUniform};
use super::work::ResourceKind;
use crate::Result;
use crate::math::flat;
use crate::mesh::Implicit;
use crate::mesh::deformer::MAX_DEFORMERS;
use crate::mesh::formula::MAX_SOLIDS;
use crate::prepare::Prepared;
use crate::prepare::objects::{SurfaceObject, Triangles};
use crate::prepare::surface_cells::{SolidIdentity, SurfaceCells};
use half::f16;
use rayon::prelude::*;
use std::sync::Arc;
use wgpu::TextureFormat;

/// The device resources of an object, by its index in the scene.
pub(super) struct CachedObject {
    /// Uniforms of the object, its solids and its deformers.
    pub(super) uniforms: [wgpu::Buffer; 3],
    /// The content of the field's texture; none for formulas.
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

/// Bytes of fields that stay cached while no surface is drawn.
const MAX_CACHED_FIELD_BYTES: u64 = 256 << 20;

/// Surfaces, by their index in the scene.
#[derive(Default)]
pub(super) struct SurfaceCache {
    pub(super) objects: Vec<Option<CachedObject>>,
}

impl SurfaceCache {
    /// Field, empty space, formulas, deformers and triangles of one object: cached resources are
    /// reused, and changed ones are written.
    pub(super) fn bind_object(
        &mut self,
        context: &Context,
        n: usize,
        scene: &Prepared,
        object: &SurfaceObject,
    ) -> Result<(wgpu::BindGroup, Option<Corners>)> {
        if self.objects.len() <= n {
            self.objects.resize_with(n + 1, || None);
        }
        let before = self.objects[n].take();
        let own = SurfaceObjectUniform::new(scene, object);
        let mut solids: [PlacedSolidUniform; MAX_SOLIDS] = [bytemuck::Zeroable::zeroed(); MAX_SOLIDS];
        if let Some(Implicit::Formula(f)) = &object.implicit {
            solids
                .iter_mut()
                .zip(&f.0)
                .for_each(|(u, s)| *u = PlacedSolidUniform::new(s));
        }
        let mut deformers: [DeformerUniform; MAX_DEFORMERS] = [bytemuck::Zeroable::zeroed(); MAX_DEFORMERS];
        deformers
            .iter_mut()
            .zip(&object.deformers)
            .for_each(|(u, d)| *u = DeformerUniform::new(d));
        let contents: [&[u8]; 3] = [
            bytemuck::bytes_of(&own),
            bytemuck::cast_slice(&solids),
            bytemuck::cast_slice(&deformers),
        ];
        let uniforms = match &before {
            Some(cached) => {
                cached
                    .uniforms
                    .iter()
                    .zip(contents)
                    .for_each(|(buffer, bytes)| context.device.queue.write_buffer(buffer, 0, bytes));
                cached.uniforms.clone()
            }
            None => contents.map(|bytes| context.buffer_of("object", bytes, wgpu::BufferUsages::UNIFORM)),
        };
        let implicit = object
            .implicit
            .as_ref()
            .filter(|i| !matches!(i, Implicit::Formula(_)));
        let sampled = implicit.map(SolidIdentity::from);
        let field = match &before {
            Some(cached) if cached.sampled == sampled => cached.field.clone(),
            _ => context.upload_field(implicit)?,
        };
        let cells = match &before {
            Some(cached) if Arc::ptr_eq(&cached.of_cells, &object.cells) => cached.cells.clone(),
            _ => context.upload_cells(&object.cells, before.as_ref().map(|cached| &cached.cells))?,
        };
        let corners = object.triangles.as_ref().map(|t| {
            match before.as_ref().and_then(|cached| cached.corners.as_ref()) {
                Some(corners) if Arc::ptr_eq(&corners.of, t) => corners.clone(),
                _ => context.upload_corners(t),
            }
        });
        let group = match &before {
            Some(cached) if (&cached.field, &cached.cells) == (&field, &cells) => cached.group.clone(),
            _ => context.bind_group(
                "object",
                &context.object_layout(),
                &[
                    wgpu::BindGroupEntry {
                        binding: 0,
                        resource: uniforms[0].as_entire_binding(),
                    },
                    wgpu::BindGroupEntry {
                        binding: 1,
                        resource: wgpu::BindingResource::TextureView(&field.view),
                    },
                    wgpu::BindGroupEntry {
                        binding: 2,
                        resource: wgpu::BindingResource::TextureView(&cells.view),
                    },
                    wgpu::BindGroupEntry {
                        binding: 3,
                        resource: uniforms[1].as_entire_binding(),
                    },
                    wgpu::BindGroupEntry {
                        binding: 4,
                        resource: uniforms[2].as_entire_binding(),
                    },
                ],
            ),
        };
        let bound = (group.clone(), corners.clone());
        self.objects[n] = Some(CachedObject {
            uniforms,
            sampled,
            field,
            of_cells: object.cells.clone(),
            cells,
            corners,
            group,
        });
        Ok(bound)
    }

    /// Evicts large fields if no surface is drawn; small ones stay cached.
    pub(super) fn forget_large_fields(&mut self) {
        let bytes: u64 = self
            .objects
            .iter()
            .flatten()
            .map(|cached| crate::gpu::texture_bytes(&cached.field.texture))
            .sum();
        if bytes > MAX_CACHED_FIELD_BYTES {
            self.objects.clear();
        }
    }
}

impl Context {
    pub(super) fn object_layout(&self) -> wgpu::BindGroupLayout {
        let visibility = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let entry = layout_entries(visibility);
        let texture = |filterable| wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable },
            view_dimension: wgpu::TextureViewDimension::D3,
            multisampled: false,
        };
        self.device
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("object"),
                entries: &[
                    entry(0, UNIFORM),
                    entry(1, texture(true)),
                    entry(2, texture(false)),
                    entry(3, UNIFORM),
                    entry(4, UNIFORM),
                ],
            })
    }

    /// Uploads triangles in the layout of the vertex shader.
    fn upload_corners(&self, triangles: &Arc<Triangles>) -> Corners {
        let corners: Vec<MeshCorner> = triangles
            .undeformed
            .iter()
            .flatten()
            .map(|(p, n)| [p.to_array(), n.to_array()])
            .collect();
        let buffer = self.buffer_of(
            "triangles",
            bytemuck::cast_slice(&corners),
            wgpu::BufferUsages::VERTEX,
        );
        Corners {
            of: triangles.clone(),
            buffer,
            count: corners.len() as u32,
        }
    }

    /// Uploads the cells around an object, into the existing texture if they fit.
    fn upload_cells(&self, cells: &SurfaceCells, before: Option<&RenderTexture>) -> Result<RenderTexture> {
        let size = cells.grid.size.to_array().map(|n| n as usize);
        let target = match before {
            Some(target) if target.texture.size() == extent(size) => target.clone(),
            _ => RenderTexture::new(self.texture_3d("cells of a surface", size, TextureFormat::Rg32Float)?),
        };
        self.tally.count(ResourceKind::Cells);
        let texels: Vec<[f32; 2]> = cells
            .grid
            .distance
            .iter()
            .zip(&cells.slope)
            .map(|(d, s)| [f32::from(*d), *s])
            .collect();
        self.write_layers(&target.texture, 0, bytemuck::cast_slice(&texels), size);
        Ok(target)
    }

    /// Uploads a field in half precision, which is finest near 0, that is, at the surface.
    fn upload_field(&self, implicit: Option<&Implicit>) -> Result<RenderTexture> {
        let (size, values): ([usize; 3], &[f32]) = match implicit {
            Some(Implicit::Grid(g)) => (g.size, flat(&g.distance_mm)),
            Some(Implicit::Depth(d)) => ([d.size, d.size, d.faces.len()], &d.depth_mm),
            _ => ([1; 3], &[0.0]),
        };
        // Depths are compared with each other, hence need uniform precision.
        let format = match implicit {
            Some(Implicit::Depth(_))
                if self
                    .device
                    .device
                    .features()
                    .contains(wgpu::Features::FLOAT32_FILTERABLE) =>
            {
                TextureFormat::R32Float
            }
            _ => TextureFormat::R16Float,
        };
        let texture = self.texture_3d("distance field", size, format)?;
        if implicit.is_some() {
            self.tally.count(ResourceKind::Field);
        }
        let layer = size[0] * size[1];
        let layers_at_once = ((16 << 20) / (layer * 4)).max(1);
        for first in (0..size[2]).step_by(layers_at_once) {
            let part = &values[first * layer..(first + layers_at_once).min(size[2]) * layer];
            if format == TextureFormat::R32Float {
                self.write_layers(&texture, first, bytemuck::cast_slice(part), size);
            } else {
                let halves: Vec<u16> = part
                    .par_iter()
                    .map(|v| f16::from_f32(v.clamp(-60000.0, 60000.0)).to_bits())
                    .collect();
                self.write_layers(&texture, first, bytemuck::cast_slice(&halves), size);
            }
        }
        debug_assert_eq!(texture.size(), extent(size));
        Ok(RenderTexture::new(texture))
    }
}
