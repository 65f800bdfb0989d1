//! Surfaces on a GPU: triangles rasterised with their forward deformers in the vertex shader, fields by a ray per pixel, all into one
//! layer of colour and distance that a volume is then drawn in front of.
//!
//! Each object is a pass of its own, with its own field bound, and the device's depth test between them: the bindings of a shader do not limit
//! their number.
//! An object in two stages has its triangles drawn into a layer beside, which its rays read and blend with.

use super::cache::SceneBindings;
use super::constants::wgsl_constants;
use super::object::{CachedObject, Corners, MeshCorner};
use super::pass_timer::PassTimer;
use super::target::{Layer, RenderTexture};
use super::uniforms::{DeformerUniform, PlacedSolidUniform, SurfaceObjectUniform};
use super::work::ResourceKind;
use super::{Counter, Renderer, Variant, extent, overrides};
use crate::gpu::shaders::Program;
use crate::math::flat;
use crate::mesh::Implicit;
use crate::mesh::deformer::MAX_DEFORMERS;
use crate::mesh::formula::MAX_SOLIDS;
use crate::prepare::Prepared;
use crate::prepare::objects::{Stage, SurfaceObject, Triangles};
use crate::prepare::surface_cells::{SolidIdentity, SurfaceCells};
use crate::{Result, Watch};
use half::f16;
use rayon::prelude::*;
use std::sync::Arc;
use wgpu::TextureFormat;

/// Depth of a layer: the test between objects.
const DEPTH: TextureFormat = TextureFormat::Depth32Float;
/// No surface; as in `shaders/bindings.wgsl`.
const FAR_AWAY: f64 = 1e30;
/// Bytes of fields that are kept while none is drawn.
const MAX_CACHED_FIELD_BYTES: u64 = 256 << 20;
/// Rows of a picture per submission of rays.
const ROWS_AT_ONCE: u32 = 128;

impl Renderer {
    /// A layer of a purpose: its colour, distance and depth by name. Its content is what it was.
    pub(super) fn layer(&mut self, purpose: [&'static str; 3], width: u32, height: u32) -> Layer {
        let color = self.target(purpose[0], width, height, TextureFormat::Rgba16Float);
        let distance = self.target(purpose[1], width, height, TextureFormat::R32Float);
        let depth = self.target(purpose[2], width, height, DEPTH);
        Layer { color: color.texture, color_view: color.view, distance: distance.texture, distance_view: distance.view, depth_view: depth.view }
    }

    /// Draws all surfaces of a scene.
    pub(super) fn draw_surfaces(&mut self, scene: &Prepared, shared: &SceneBindings, counter: Option<&Counter>, watch: &Watch) -> Result<Layer> {
        let [width, height] = scene.frame.size;
        let layer = self.layer(["surfaces: colour", "surfaces: distance", "surfaces: depth"], width, height);
        self.clear(&layer);
        let count = scene.surfaces.objects.len();
        for (n, object) in scene.surfaces.objects.iter().enumerate() {
            let (group, corners) = self.bind_object(n, scene, object)?;
            let nothing_behind = self.group(shared, None);
            match (object.stage, &corners) {
                (Stage::Triangles, Some(corners)) => self.draw_mesh(scene, &layer, &nothing_behind, &group, corners)?,
                (Stage::Both(_), Some(corners)) => {
                    let drawn = self.layer(["triangles: colour", "triangles: distance", "triangles: depth"], width, height);
                    self.clear(&drawn);
                    self.draw_mesh(scene, &drawn, &nothing_behind, &group, corners)?;
                    let behind = self.group(shared, Some(&drawn));
                    self.cast(scene, &layer, &behind, &group, counter)?;
                }
                _ => self.cast(scene, &layer, &nothing_behind, &group, counter)?,
            }
            (watch.progress)((n + 1) as f32 / count as f32);
            watch.check()?;
        }
        self.cache.objects.truncate(count);
        Ok(layer)
    }

    fn clear(&self, layer: &Layer) {
        self.surface_pass(layer, true, |_| {});
    }

    fn surface_pass(&self, layer: &Layer, clear: bool, record: impl FnOnce(&mut wgpu::RenderPass)) {
        let color = |view, value| {
            Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: if clear { wgpu::LoadOp::Clear(value) } else { wgpu::LoadOp::Load }, store: wgpu::StoreOp::Store },
            })
        };
        let mut encoder = self.device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("surfaces"),
                color_attachments: &[
                    color(&layer.color_view, wgpu::Color::TRANSPARENT),
                    color(&layer.distance_view, wgpu::Color { r: FAR_AWAY, ..wgpu::Color::TRANSPARENT }),
                ],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &layer.depth_view,
                    depth_ops: Some(wgpu::Operations {
                        load: if clear { wgpu::LoadOp::Clear(1.0) } else { wgpu::LoadOp::Load },
                        store: wgpu::StoreOp::Store,
                    }),
                    stencil_ops: None,
                }),
                timestamp_writes: self.clock.as_deref().and_then(PassTimer::next),
                occlusion_query_set: None,
                multiview_mask: None,
            });
            record(&mut pass);
        }
        self.device.queue.submit([encoder.finish()]);
    }

    fn draw_mesh(&mut self, scene: &Prepared, layer: &Layer, shared: &wgpu::BindGroup, group: &wgpu::BindGroup, corners: &Corners) -> Result<()> {
        let variant = self.variant(scene, Program::Mesh, false);
        self.compile_surface(variant);
        let pipeline = &self.pipelines[&variant];
        self.surface_pass(layer, false, |pass| {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, shared, &[]);
            pass.set_bind_group(2, group, &[]);
            pass.set_vertex_buffer(0, corners.buffer.slice(..));
            pass.draw(0..corners.count, 0..1);
        });
        crate::gpu::wait(&self.device.device)
    }

    fn cast(&mut self, scene: &Prepared, layer: &Layer, shared: &wgpu::BindGroup, group: &wgpu::BindGroup, counter: Option<&Counter>) -> Result<()> {
        let variant = self.variant(scene, Program::Surface, counter.is_some());
        self.compile_surface(variant);
        let pipeline = &self.pipelines[&variant];
        let [width, height] = scene.frame.size;
        for top in (0..height).step_by(ROWS_AT_ONCE as usize) {
            self.surface_pass(layer, false, |pass| {
                pass.set_scissor_rect(0, top, width, ROWS_AT_ONCE.min(height - top));
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, shared, &[]);
                if let Some(counter) = counter {
                    pass.set_bind_group(1, &counter.group, &[]);
                }
                pass.set_bind_group(2, group, &[]);
                pass.draw(0..3, 0..1);
            });
            crate::gpu::wait(&self.device.device)?;
        }
        Ok(())
    }

    fn object_layout(&self) -> wgpu::BindGroupLayout {
        let visibility = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry { binding, visibility, ty, count: None };
        let uniform = wgpu::BindingType::Buffer { ty: wgpu::BufferBindingType::Uniform, has_dynamic_offset: false, min_binding_size: None };
        let texture = |filterable| wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable },
            view_dimension: wgpu::TextureViewDimension::D3,
            multisampled: false,
        };
        self.device.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("object"),
            entries: &[entry(0, uniform), entry(1, texture(true)), entry(2, texture(false)), entry(3, uniform), entry(4, uniform)],
        })
    }

    /// Field, empty space, formulas, deformers and triangles of one object: what the device has of it is kept, and what has changed is written.
    fn bind_object(&mut self, n: usize, scene: &Prepared, object: &SurfaceObject) -> Result<(wgpu::BindGroup, Option<Corners>)> {
        if self.cache.objects.len() <= n {
            self.cache.objects.resize_with(n + 1, || None);
        }
        let before = self.cache.objects[n].take();
        let own = SurfaceObjectUniform::new(scene, object);
        let mut solids: [PlacedSolidUniform; MAX_SOLIDS] = [bytemuck::Zeroable::zeroed(); MAX_SOLIDS];
        if let Some(Implicit::Formula(f)) = &object.implicit {
            solids.iter_mut().zip(&f.0).for_each(|(u, s)| *u = PlacedSolidUniform::new(s));
        }
        let mut deformers: [DeformerUniform; MAX_DEFORMERS] = [bytemuck::Zeroable::zeroed(); MAX_DEFORMERS];
        deformers.iter_mut().zip(&object.deformers).for_each(|(u, d)| *u = DeformerUniform::new(d));
        let contents: [&[u8]; 3] = [bytemuck::bytes_of(&own), bytemuck::cast_slice(&solids), bytemuck::cast_slice(&deformers)];
        let uniforms = match &before {
            Some(cached) => {
                cached.uniforms.iter().zip(contents).for_each(|(buffer, bytes)| self.device.queue.write_buffer(buffer, 0, bytes));
                cached.uniforms.clone()
            }
            None => contents.map(|bytes| self.buffer_of("object", bytes, wgpu::BufferUsages::UNIFORM)),
        };
        let implicit = object.implicit.as_ref().filter(|i| !matches!(i, Implicit::Formula(_)));
        let sampled = implicit.map(SolidIdentity::from);
        let field = match &before {
            Some(cached) if cached.sampled == sampled => cached.field.clone(),
            _ => self.upload_field(implicit)?,
        };
        let cells = match &before {
            Some(cached) if Arc::ptr_eq(&cached.of_cells, &object.cells) => cached.cells.clone(),
            _ => self.upload_cells(&object.cells, before.as_ref().map(|cached| &cached.cells))?,
        };
        let corners = object.triangles.as_ref().map(|t| match before.as_ref().and_then(|cached| cached.corners.as_ref()) {
            Some(corners) if Arc::ptr_eq(&corners.of, t) => corners.clone(),
            _ => self.upload_corners(t),
        });
        let group = match &before {
            Some(cached) if (&cached.field, &cached.cells) == (&field, &cells) => cached.group.clone(),
            _ => self.bind_group(
                "object",
                &self.object_layout(),
                &[
                    wgpu::BindGroupEntry { binding: 0, resource: uniforms[0].as_entire_binding() },
                    wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&field.view) },
                    wgpu::BindGroupEntry { binding: 2, resource: wgpu::BindingResource::TextureView(&cells.view) },
                    wgpu::BindGroupEntry { binding: 3, resource: uniforms[1].as_entire_binding() },
                    wgpu::BindGroupEntry { binding: 4, resource: uniforms[2].as_entire_binding() },
                ],
            ),
        };
        let bound = (group.clone(), corners.clone());
        self.cache.objects[n] = Some(CachedObject { uniforms, sampled, field, of_cells: object.cells.clone(), cells, corners, group });
        Ok(bound)
    }

    /// Lets go of large fields where no surface is drawn; small ones wait for the next picture that shows them.
    pub(super) fn forget_large_fields(&mut self) {
        let bytes: u64 = self.cache.objects.iter().flatten().map(|cached| crate::gpu::texture_bytes(&cached.field.texture)).sum();
        if bytes > MAX_CACHED_FIELD_BYTES {
            self.cache.objects.clear();
        }
    }

    /// Triangles as the vertex shader takes them.
    fn upload_corners(&self, triangles: &Arc<Triangles>) -> Corners {
        let corners: Vec<MeshCorner> = triangles.undeformed.iter().flatten().map(|(p, n)| [p.to_array(), n.to_array()]).collect();
        let buffer = self.buffer_of("triangles", bytemuck::cast_slice(&corners), wgpu::BufferUsages::VERTEX);
        Corners { of: triangles.clone(), buffer, count: corners.len() as u32 }
    }

    /// The cells around an object, into the texture that there is if they fit.
    fn upload_cells(&self, cells: &SurfaceCells, before: Option<&RenderTexture>) -> Result<RenderTexture> {
        let size = cells.grid.size.to_array().map(|n| n as usize);
        let target = match before {
            Some(target) if target.texture.size() == extent(size) => target.clone(),
            _ => RenderTexture::new(self.texture_3d("cells of a surface", size, TextureFormat::Rg32Float)?),
        };
        self.tally.count(ResourceKind::Cells);
        let texels: Vec<[f32; 2]> = cells.grid.distance.iter().zip(&cells.slope).map(|(d, s)| [f32::from(*d), *s]).collect();
        self.write_layers(&target.texture, 0, bytemuck::cast_slice(&texels), size);
        Ok(target)
    }

    /// A field in half precision, whose steps are finest where it matters, at the surface.
    fn upload_field(&self, implicit: Option<&Implicit>) -> Result<RenderTexture> {
        let (size, values): ([usize; 3], &[f32]) = match implicit {
            Some(Implicit::Grid(g)) => (g.size, flat(&g.distance_mm)),
            Some(Implicit::Depth(d)) => ([d.size, d.size, d.faces.len()], &d.depth_mm),
            _ => ([1; 3], &[0.0]),
        };
        // Depths are compared with each other: they have no place where they are small.
        let format = match implicit {
            Some(Implicit::Depth(_)) if self.device.device.features().contains(wgpu::Features::FLOAT32_FILTERABLE) => TextureFormat::R32Float,
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
                let halves: Vec<u16> = part.par_iter().map(|v| f16::from_f32(v.clamp(-60000.0, 60000.0)).to_bits()).collect();
                self.write_layers(&texture, first, bytemuck::cast_slice(&halves), size);
            }
        }
        debug_assert_eq!(texture.size(), extent(size));
        Ok(RenderTexture::new(texture))
    }

    fn compile_surface(&mut self, variant: Variant) {
        if self.pipelines.contains_key(&variant) {
            return;
        }
        self.tally.count(ResourceKind::Pipeline);
        let device = &self.device.device;
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(&format!("{:?}", variant.program)),
            source: wgpu::ShaderSource::Wgsl(variant.program.source(wgsl_constants(), variant.counting).into()),
        });
        let constants = overrides(&variant);
        let options = wgpu::PipelineCompilationOptions { constants: &constants, ..Default::default() };
        let counts = variant.counting.then(|| Counter::layout(device));
        let object = self.object_layout();
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(&self.shared_layout), counts.as_ref(), Some(&object)],
            immediate_size: 0,
        });
        let corner = wgpu::VertexBufferLayout {
            array_stride: size_of::<MeshCorner>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3],
        };
        let buffers = [Some(corner)];
        let target = |format| Some(wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::ALL });
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(&format!("{:?}", variant.program)),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: options.clone(),
                buffers: if variant.program == Program::Mesh { &buffers } else { &[] },
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::Less),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: options,
                targets: &[target(TextureFormat::Rgba16Float), target(TextureFormat::R32Float)],
            }),
            multiview_mask: None,
            cache: None,
        });
        self.pipelines.insert(variant, pipeline);
    }

    /// Distance along each pixel's ray to the nearest surface, mm; infinite where there is none. For tests and picking.
    ///
    /// # Errors
    /// Whatever the device reports.
    pub fn surface_distances(&mut self, scene: &Prepared) -> Result<Vec<f32>> {
        let device = self.device.device.clone();
        crate::gpu::checked(&device, || {
            self.upload_volume(scene.volume().grid, scene.volume().colors)?;
            let shared = self.shared(scene)?;
            let layer = self.draw_surfaces(scene, &shared, None, &Watch::NONE)?;
            let distances = {
                let buffer = self.readback(crate::gpu::texture_bytes(&layer.distance));
                crate::gpu::read_r32f(&self.device.device, &self.device.queue, &layer.distance, &buffer)?
            };
            Ok(distances.into_iter().map(|t| if f64::from(t) < 0.99 * FAR_AWAY { t } else { f32::INFINITY }).collect())
        })
    }
}
