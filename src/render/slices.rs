//! Draws slices: the polygons of [`SlicePolygons`], one after the other, composited by the blend
//! unit (\[DDM06\] section 4).
//!
//! Back to front, each polygon is blended "over" what is there; the surfaces behind the volume are
//! there first. Front to back, each is blended "under" it, and between groups of slices the pixels
//! that have become opaque get depth 0: the depth test rejects everything behind them before it is
//! shaded (Krueger and Westermann 2003). Projections are accumulated in any order, as maximum or
//! sum; a second pass applies the transfer function.

use super::Renderer;
use super::context::{Context, lock};
use super::draw::{Canvas, Draw, PendingSubmissions};
use super::pipelines::{color_target, gathered_layout};
use super::refine::Samples;
use super::target::{Corner, MASK, PROJECTION_FORMAT, RenderTexture};
use super::variant::{Variant, overrides};
use super::work::ResourceKind;
use crate::Result;
use crate::gpu::shaders::Program;
use crate::gpu::wait;
use crate::prepare::Prepared;
use crate::prepare::slices::SlicePolygons;
use crate::scene::SliceOrder;
use crate::transfer::Blend;
use std::ops::Range;

/// Approximate number of samples per submission of slices.
const SAMPLES_PER_BATCH: u64 = 1 << 24;
/// Slices between two passes that mask opaque pixels, at least.
const SLICES_PER_MASK: u32 = 32;

/// The triangles of slabs, and each slab's range of corners in the order in which they are drawn.
fn triangles(slices: &SlicePolygons, order: SliceOrder) -> (Vec<Corner>, Vec<Range<u32>>) {
    let (mut corners, mut slabs) = (Vec::new(), Vec::with_capacity(slices.slabs.len()));
    let mut push = |n: usize| {
        let slab = &slices.slabs[n];
        let start = corners.len() as u32;
        for range in &slices.polygons[slab.polygons.start as usize..slab.polygons.end as usize] {
            let polygon = &slices.corners[range.start as usize..range.end as usize];
            let fan = (2..polygon.len()).flat_map(|n| [polygon[0], polygon[n - 1], polygon[n]]);
            corners.extend(fan.map(|p| [p.x, p.y, p.z, slab.first as f32]));
        }
        slabs.push(start..corners.len() as u32);
    };
    match order {
        SliceOrder::FrontToBack => (0..slices.slabs.len()).for_each(&mut push),
        SliceOrder::BackToFront => (0..slices.slabs.len()).rev().for_each(&mut push),
    }
    (corners, slabs)
}

impl Context {
    fn gathered_group(&self, view: &wgpu::TextureView) -> wgpu::BindGroup {
        let layout = gathered_layout(&self.device.device);
        self.cached_bind_group("gathered", &layout, vec![(1, view.clone())], &[])
    }
}

impl Context {
    /// The pipeline that draws one surface in slices, compiled on first use.
    fn slice_surface_pipeline(&self, variant: Variant) -> wgpu::RenderPipeline {
        lock(&self.pipelines)
            .entry(variant)
            .or_insert_with(|| self.compiled_slice_surface(variant))
            .clone()
    }

    fn compiled_slice_surface(&self, variant: Variant) -> wgpu::RenderPipeline {
        self.tally.count(ResourceKind::Pipeline);
        let device = &self.device.device;
        let module = self.shader_module(&variant);
        let constants = overrides(&variant);
        let options = wgpu::PipelineCompilationOptions {
            constants: &constants,
            ..Default::default()
        };
        let layout = self.object_pipeline_layout(&variant);
        let back_to_front = variant.order == SliceOrder::BackToFront;
        let corner = wgpu::VertexBufferLayout {
            array_stride: size_of::<Corner>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &wgpu::vertex_attr_array![0 => Float32x4],
        };
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("surfaces in slices"),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: options.clone(),
                buffers: &[Some(corner)],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(wgpu::DepthStencilState {
                format: MASK,
                depth_write_enabled: Some(back_to_front),
                depth_compare: Some(if back_to_front {
                    wgpu::CompareFunction::LessEqual
                } else {
                    wgpu::CompareFunction::Less
                }),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some(if back_to_front {
                    "fragment"
                } else {
                    "fragment_under"
                }),
                compilation_options: options,
                targets: &[Some(color_target(&variant))],
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

impl Renderer {
    /// The bindings of the surfaces that slices sample.
    fn sliced_surface_groups(&mut self, scene: &Prepared) -> Result<Vec<wgpu::BindGroup>> {
        let mut groups = Vec::new();
        for (n, object) in scene.surfaces.objects.iter().enumerate() {
            if scene.is_sliced(object) {
                groups.push(
                    self.scene
                        .surfaces
                        .bind_object(&self.context, n, scene, object)?
                        .0,
                );
            }
        }
        Ok(groups)
    }

    /// Draws slabs of slices in the scene's order.
    pub(super) fn draw_slices(&mut self, draw: &Draw) -> Result<()> {
        let scene = draw.scene;
        let [width, height] = scene.frame.size;
        let composite = scene.volume().blend == Blend::Composite;
        let projection_values = (!composite).then(|| {
            self.targets
                .target(&self.context, "gathered", width, height, PROJECTION_FORMAT)
        });
        let masks = composite || matches!(draw.samples, Samples::Masked(..));
        let mask = masks.then(|| {
            self.targets
                .target(&self.context, "opaque pixels", width, height, MASK)
        });
        let slices = scene.slice_polygons();
        let (corners, slabs) = triangles(&slices, scene.slice_order());
        let vertices = self
            .targets
            .slice_vertices(&self.context, bytemuck::cast_slice(&corners));
        let targets = SliceTargets {
            color: projection_values.as_ref().map_or(&draw.target.view, |t| &t.view),
            mask: mask.as_ref().map(|m| &m.view),
            vertices: &vertices,
        };
        let empty = match scene.volume().blend {
            Blend::Composite | Blend::Average => wgpu::Color::TRANSPARENT,
            // Below every value; green stays 0 where nothing is drawn.
            Blend::Mip | Blend::Minip => wgpu::Color {
                r: -1e4,
                ..wgpu::Color::TRANSPARENT
            },
        };
        let surfaces = self.sliced_surface_groups(scene)?;
        let mut pending = PendingSubmissions::default();
        let mut encoder = self.context.encoder();
        targets
            .canvas(wgpu::LoadOp::Clear(empty), wgpu::LoadOp::Clear(1.0))
            .pass(draw.clock, &mut encoder, |_| {});
        if let (Samples::Masked(_, again), Some(mask)) = (draw.samples, &mask) {
            self.mask_pixels(draw, again, mask, &mut encoder);
        }
        let back_to_front = scene.slice_order() == SliceOrder::BackToFront;
        if composite && back_to_front {
            self.draw_surfaces_behind_slices(draw, &targets, &mut encoder);
        }
        self.context
            .draw_slabs(draw, &targets, &slabs, &surfaces, &mut encoder, &mut pending)?;
        if composite && !back_to_front {
            self.draw_surfaces_behind_slices(draw, &targets, &mut encoder);
        }
        if !composite {
            let group = self.context.gathered_group(targets.color);
            Canvas::of(&draw.target.view, wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT)).pass(
                draw.clock,
                &mut encoder,
                |pass| {
                    pass.set_pipeline(
                        &self
                            .context
                            .pipeline(draw.variant(&self.context, Program::Resolve)),
                    );
                    pass.set_bind_group(0, draw.bindings, &[]);
                    pass.set_bind_group(1, &group, &[]);
                    pass.draw(0..3, 0..1);
                },
            );
        }
        self.context.submit(encoder, 1.0, &mut pending, draw.watch)?;
        wait(&self.context.device.device)
    }

    /// Gives all pixels that are not sampled again depth 0.
    fn mask_pixels(
        &self,
        draw: &Draw,
        again: &RenderTexture,
        mask: &RenderTexture,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        let group = self.context.gathered_group(&again.view);
        Canvas {
            color: None,
            depth: Some((&mask.view, wgpu::LoadOp::Load)),
        }
        .pass(draw.clock, encoder, |pass| {
            pass.set_pipeline(&self.context.pipeline(draw.variant(&self.context, Program::Mask)));
            pass.set_bind_group(0, draw.bindings, &[]);
            pass.set_bind_group(1, &group, &[]);
            pass.draw(0..3, 0..1);
        });
    }

    /// Draws the surfaces behind the volume, if there are any.
    fn draw_surfaces_behind_slices(
        &self,
        draw: &Draw,
        targets: &SliceTargets,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        if draw.behind.is_none() {
            return;
        }
        Canvas::of(targets.color, wgpu::LoadOp::Load).pass(draw.clock, encoder, |pass| {
            pass.set_pipeline(
                &self
                    .context
                    .pipeline(draw.variant(&self.context, Program::SurfacesBehind)),
            );
            pass.set_bind_group(0, draw.bindings, &[]);
            pass.draw(0..3, 0..1);
        });
    }
}

/// The textures that slices are drawn into, and the corners of their polygons.
struct SliceTargets<'a> {
    /// The picture, or the values of a projection.
    color: &'a wgpu::TextureView,
    /// Depth 0 at pixels that need no more samples; none if all do.
    mask: Option<&'a wgpu::TextureView>,
    vertices: &'a wgpu::Buffer,
}

impl<'a> SliceTargets<'a> {
    /// The attachments of a pass that draws slices.
    fn canvas(&self, color: wgpu::LoadOp<wgpu::Color>, depth: wgpu::LoadOp<f32>) -> Canvas<'a> {
        Canvas {
            color: Some((self.color, color)),
            depth: self.mask.map(|view| (view, depth)),
        }
    }
}

impl Context {
    /// Records slabs in order and submits all batches except the last. From front to back, pixels
    /// that have become opaque are masked between groups of slabs.
    fn draw_slabs(
        &self,
        draw: &Draw,
        targets: &SliceTargets,
        slabs: &[Range<u32>],
        surfaces: &[wgpu::BindGroup],
        encoder: &mut wgpu::CommandEncoder,
        pending: &mut PendingSubmissions,
    ) -> Result<()> {
        let scene = draw.scene;
        let [width, height] = scene.frame.size;
        let masked = targets
            .mask
            .filter(|_| scene.ends_early() && scene.is_composite())
            .map(|_| self.gathered_group(&draw.target.view));
        let pipeline = &self.pipeline(draw.variant(self, Program::Slice));
        let canvas = targets.canvas(wgpu::LoadOp::Load, wgpu::LoadOp::Load);
        let slices_per_slab = scene.slices_per_slab();
        let samples_per_slab = u64::from(width) * u64::from(height) * u64::from(slices_per_slab);
        // Volume and surfaces take turns, slice by slice.
        let slabs_at_once = if surfaces.is_empty() {
            SLICES_PER_MASK.div_ceil(slices_per_slab) as usize
        } else {
            1
        };
        let back_to_front = scene.slice_order() == SliceOrder::BackToFront;
        let shows_volume = scene.shows_volume() && !scene.frame.proxy.is_empty();
        let of_surfaces = (!surfaces.is_empty())
            .then(|| self.slice_surface_pipeline(draw.variant(self, Program::SliceSurface)));
        let mut samples = 0;
        let mut groups = slabs
            .chunks(slabs_at_once)
            .map(|p| (p.len() as u64, p[0].start..p[p.len() - 1].end))
            .enumerate()
            .peekable();
        while let Some((n, (count, corners))) = groups.next() {
            canvas.pass(draw.clock, encoder, |pass| {
                pass.set_vertex_buffer(0, targets.vertices.slice(..));
                let of_volume = |pass: &mut wgpu::RenderPass| {
                    if shows_volume {
                        pass.set_pipeline(pipeline);
                        draw.bind(pass);
                        pass.draw(corners.clone(), 0..1);
                    }
                };
                // A hit lies in front of its slice.
                if back_to_front {
                    of_volume(pass);
                }
                if let Some(pipeline) = &of_surfaces {
                    pass.set_pipeline(pipeline);
                    draw.bind(pass);
                    for surface in surfaces {
                        pass.set_bind_group(2, surface, &[]);
                        pass.draw(corners.clone(), 0..1);
                    }
                }
                if !back_to_front {
                    of_volume(pass);
                }
            });
            // Only where the next slabs are.
            if let (Some(masked), Some((_, (_, next)))) = (&masked, groups.peek()) {
                Canvas {
                    color: None,
                    depth: canvas.depth,
                }
                .pass(draw.clock, encoder, |pass| {
                    pass.set_pipeline(&self.pipeline(draw.variant(self, Program::Opaque)));
                    pass.set_bind_group(0, draw.bindings, &[]);
                    pass.set_bind_group(1, masked, &[]);
                    pass.set_vertex_buffer(0, targets.vertices.slice(..));
                    pass.draw(next.clone(), 0..1);
                });
            }
            samples += samples_per_slab * count;
            if samples >= SAMPLES_PER_BATCH {
                let share = ((n + 1) * slabs_at_once).min(slabs.len()) as f32 / slabs.len() as f32;
                self.submit(
                    std::mem::replace(encoder, self.encoder()),
                    share,
                    pending,
                    draw.watch,
                )?;
                samples = 0;
            }
        }
        Ok(())
    }
}
