//! Submissions: bands of rays, slabs of slices. Two are in flight at a time, so that the device
//! does not wait for the next one to be recorded.

use super::Renderer;
use super::context::{Context, lock};
use super::counter::Counter;
use super::pass_timer::PassTimer;
use super::pipelines::gathered_layout;
use super::slices::{self, SLICES_PER_SLAB};
use super::target::{Layer, MASK, PROJECTION_FORMAT, RenderTexture};
use super::variant::{Variant, overrides};
use crate::gpu::shaders::Program;
use crate::gpu::{wait, wait_for};
use crate::prepare::Prepared;
use crate::transfer::Blend;
use crate::{Result, Watch};
use std::collections::VecDeque;
use std::ops::Range;
use wgpu::{BufferUsages, TextureFormat};

/// Pixels per submission of rays: on hardware, and on a software driver, whose shorter bands allow
/// cancellation.
const PIXELS_PER_BAND: [u32; 2] = [1 << 18, 1 << 16];
/// Rays per workgroup along each axis, as in `shaders/raycast_compute.wgsl`.
const RAYS_ACROSS: u32 = 8;
/// Approximate number of samples per submission of slices.
const SAMPLES_PER_BATCH: u64 = 1 << 24;

/// One picture being drawn.
#[derive(Clone, Copy)]
pub(super) struct Draw<'a> {
    pub scene: &'a Prepared<'a>,
    pub bindings: &'a wgpu::BindGroup,
    pub behind: Option<&'a Layer>,
    pub counter: Option<&'a Counter>,
    pub target: &'a RenderTexture,
    pub watch: &'a Watch<'a>,
    /// The timer of the passes, if they are timed.
    pub clock: Option<&'a PassTimer>,
}

impl Draw<'_> {
    fn variant(&self, context: &Context, program: Program) -> Variant {
        context.variant(self.scene, program, self.counter.is_some())
    }

    /// Binds the scene, and the counters if samples are counted.
    fn bind(&self, pass: &mut wgpu::RenderPass) {
        pass.set_bind_group(0, self.bindings, &[]);
        if let Some(counter) = self.counter {
            pass.set_bind_group(1, &counter.group, &[]);
        }
    }
}

/// Attachments of a pass.
struct Canvas<'a> {
    color: Option<(&'a wgpu::TextureView, wgpu::LoadOp<wgpu::Color>)>,
    depth: Option<(&'a wgpu::TextureView, wgpu::LoadOp<f32>)>,
}

impl<'a> Canvas<'a> {
    fn of(color: &'a wgpu::TextureView, load: wgpu::LoadOp<wgpu::Color>) -> Self {
        Self {
            color: Some((color, load)),
            depth: None,
        }
    }

    fn pass(
        &self,
        clock: Option<&PassTimer>,
        encoder: &mut wgpu::CommandEncoder,
        record: impl FnOnce(&mut wgpu::RenderPass),
    ) {
        let color = self.color.map(|(view, load)| wgpu::RenderPassColorAttachment {
            view,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations {
                load,
                store: wgpu::StoreOp::Store,
            },
        });
        let depth = self
            .depth
            .map(|(view, load)| wgpu::RenderPassDepthStencilAttachment {
                view,
                depth_ops: Some(wgpu::Operations {
                    load,
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: None,
            color_attachments: if color.is_some() {
                std::slice::from_ref(&color)
            } else {
                &[]
            },
            depth_stencil_attachment: depth,
            timestamp_writes: clock.and_then(PassTimer::next),
            occlusion_query_set: None,
            multiview_mask: None,
        });
        record(&mut pass);
    }
}

/// The row uniform and the output binding of compute rays.
struct Bands {
    first_row: wgpu::Buffer,
    group: wgpu::BindGroup,
}

/// Submissions in flight, the oldest first.
#[derive(Default)]
struct PendingSubmissions(VecDeque<(wgpu::SubmissionIndex, f32)>);

impl Context {
    /// Submits; waits for the previous submission, reports its progress, and checks for
    /// cancellation.
    fn submit(
        &self,
        encoder: wgpu::CommandEncoder,
        share: f32,
        pending: &mut PendingSubmissions,
        watch: &Watch,
    ) -> Result<()> {
        pending
            .0
            .push_back((self.device.queue.submit([encoder.finish()]), share));
        if pending.0.len() > 1
            && let Some((index, share)) = pending.0.pop_front()
        {
            wait_for(&self.device.device, index)?;
            (watch.progress)(share);
        }
        watch.check()
    }

    fn bands_layout(device: &wgpu::Device, counting: bool) -> wgpu::BindGroupLayout {
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty,
            count: None,
        };
        let mut entries = vec![
            entry(
                1,
                wgpu::BindingType::StorageTexture {
                    access: wgpu::StorageTextureAccess::WriteOnly,
                    format: TextureFormat::Rgba16Float,
                    view_dimension: wgpu::TextureViewDimension::D2,
                },
            ),
            entry(
                2,
                wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
            ),
        ];
        entries.extend(counting.then_some(Counter::ENTRY));
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("rays"),
            entries: &entries,
        })
    }

    pub(super) fn ray_pipeline(&self, variant: Variant) -> wgpu::ComputePipeline {
        let make = || {
            let own = Self::bands_layout(&self.device.device, variant.counting);
            self.compute_pipeline(
                variant.program,
                variant.counting,
                [&self.shared_layout, &own],
                &overrides(&variant),
            )
        };
        lock(&self.ray_pipelines)
            .entry(variant)
            .or_insert_with(make)
            .clone()
    }

    fn gathered_group(&self, view: &wgpu::TextureView) -> wgpu::BindGroup {
        let layout = gathered_layout(&self.device.device);
        self.cached_bind_group("gathered", &layout, vec![(1, view.clone())], &[])
    }
}

impl Renderer {
    /// Draws one ray per pixel, band by band.
    pub(super) fn draw_rays(&mut self, draw: &Draw) -> Result<()> {
        let [width, height] = draw.scene.frame.size;
        let program = self.context.strategy.rays();
        let variant = draw.variant(&self.context, program);
        let bands = (program == Program::RaycastCompute).then(|| self.bands(draw));
        let pixels = PIXELS_PER_BAND[usize::from(self.context.device.is_software())];
        // Whole workgroups: the next band must not repeat, and count, part of this one.
        let rows = (pixels / width).clamp(1, height).next_multiple_of(RAYS_ACROSS);
        let mut pending = PendingSubmissions::default();
        for top in (0..height).step_by(rows as usize) {
            let count = rows.min(height - top);
            let mut encoder = self.context.encoder();
            if let Some(bands) = &bands {
                // Written after the previous submission and before the one that reads it.
                self.context.device.queue.write_buffer(
                    &bands.first_row,
                    0,
                    bytemuck::bytes_of(&[top, 0, 0, 0]),
                );
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                    label: Some("rays"),
                    timestamp_writes: draw.clock.and_then(PassTimer::next_computing),
                });
                pass.set_pipeline(&self.context.ray_pipeline(variant));
                pass.set_bind_group(0, draw.bindings, &[]);
                pass.set_bind_group(1, &bands.group, &[]);
                pass.dispatch_workgroups(width.div_ceil(RAYS_ACROSS), count.div_ceil(RAYS_ACROSS), 1);
            } else {
                let load = if top == 0 {
                    wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT)
                } else {
                    wgpu::LoadOp::Load
                };
                Canvas::of(&draw.target.view, load).pass(draw.clock, &mut encoder, |pass| {
                    pass.set_scissor_rect(0, top, width, count);
                    pass.set_pipeline(&self.context.pipeline(variant));
                    draw.bind(pass);
                    pass.draw(0..3, 0..1);
                });
            }
            self.context.submit(
                encoder,
                (top + count) as f32 / height as f32,
                &mut pending,
                draw.watch,
            )?;
        }
        wait(&self.context.device.device)
    }

    /// The additional bindings of compute rays.
    fn bands(&mut self, draw: &Draw) -> Bands {
        let first_row =
            self.context
                .scratch_of("first row", 16, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        let layout = Context::bands_layout(&self.context.device.device, draw.counter.is_some());
        let mut others = vec![(2, first_row.as_entire_binding())];
        others.extend(draw.counter.map(|c| (0, c.buffer.as_entire_binding())));
        let purpose = if draw.counter.is_some() {
            "rays, counted"
        } else {
            "rays"
        };
        let group =
            self.context
                .cached_bind_group(purpose, &layout, vec![(1, draw.target.view.clone())], &others);
        Bands { first_row, group }
    }

    /// Draws slabs of slices front to back: each is blended under the existing content, and is not
    /// drawn where that is opaque. Projections are accumulated instead, in any order.
    pub(super) fn draw_slices(&mut self, draw: &Draw) -> Result<()> {
        let scene = draw.scene;
        let [width, height] = scene.frame.size;
        let composite = scene.volume().blend == Blend::Composite;
        let projection_values = (!composite).then(|| {
            self.targets
                .target(&self.context, "gathered", width, height, PROJECTION_FORMAT)
        });
        let mask = composite.then(|| {
            self.targets
                .target(&self.context, "opaque pixels", width, height, MASK)
        });
        let polygons = slices::slabs(
            &scene.frame,
            &scene.volume().macrocells,
            scene.proxy_mesh.as_deref(),
        );
        let vertices = self
            .targets
            .slice_vertices(&self.context, bytemuck::cast_slice(&polygons.corners));
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
        let mut pending = PendingSubmissions::default();
        let mut encoder = self.context.encoder();
        targets
            .canvas(wgpu::LoadOp::Clear(empty), wgpu::LoadOp::Clear(1.0))
            .pass(draw.clock, &mut encoder, |_| {});
        self.context
            .draw_slabs(draw, &targets, &polygons.slabs, &mut encoder, &mut pending)?;
        if composite {
            if draw.behind.is_some() {
                Canvas::of(targets.color, wgpu::LoadOp::Load).pass(draw.clock, &mut encoder, |pass| {
                    pass.set_pipeline(
                        &self
                            .context
                            .pipeline(draw.variant(&self.context, Program::SurfacesBehind)),
                    );
                    pass.set_bind_group(0, draw.bindings, &[]);
                    pass.draw(0..3, 0..1);
                });
            }
        } else {
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
}

/// The textures that slabs of slices are drawn into, and the corners of their polygons.
struct SliceTargets<'a> {
    /// The picture, or the values of a projection.
    color: &'a wgpu::TextureView,
    /// Depth 0 at opaque pixels; none for projections.
    mask: Option<&'a wgpu::TextureView>,
    vertices: &'a wgpu::Buffer,
}

impl<'a> SliceTargets<'a> {
    /// The attachments of a pass that draws slabs.
    fn canvas(&self, color: wgpu::LoadOp<wgpu::Color>, depth: wgpu::LoadOp<f32>) -> Canvas<'a> {
        Canvas {
            color: Some((self.color, color)),
            depth: self.mask.map(|view| (view, depth)),
        }
    }
}

impl Context {
    /// Records slabs front to back and submits all batches except the last. Between slabs, masks
    /// pixels that have become opaque.
    fn draw_slabs(
        &self,
        draw: &Draw,
        targets: &SliceTargets,
        slabs: &[Range<u32>],
        encoder: &mut wgpu::CommandEncoder,
        pending: &mut PendingSubmissions,
    ) -> Result<()> {
        let scene = draw.scene;
        let [width, height] = scene.frame.size;
        let seen = targets
            .mask
            .filter(|_| scene.settings.early_termination)
            .map(|_| self.gathered_group(&draw.target.view));
        let pipeline = &self.pipeline(draw.variant(self, Program::Slice));
        let canvas = targets.canvas(wgpu::LoadOp::Load, wgpu::LoadOp::Load);
        let samples_per_slab = u64::from(width)
            * u64::from(height)
            * if scene.proxy_mesh.is_some() {
                1
            } else {
                SLICES_PER_SLAB as u64
            };
        let mut samples = 0;
        // For a mesh, polygons are single slices.
        let slabs_at_once = if scene.proxy_mesh.is_some() {
            SLICES_PER_SLAB as usize
        } else {
            1
        };
        let mut parts = slabs
            .chunks(slabs_at_once)
            .map(|p| (p.len() as u64, p[0].start..p[p.len() - 1].end))
            .enumerate()
            .peekable();
        while let Some((n, (count, corners))) = parts.next() {
            canvas.pass(draw.clock, encoder, |pass| {
                pass.set_pipeline(pipeline);
                draw.bind(pass);
                pass.set_vertex_buffer(0, targets.vertices.slice(..));
                pass.draw(corners, 0..1);
            });
            // Only where the next slabs are.
            if let (Some(seen), Some((_, (_, next)))) = (&seen, parts.peek()) {
                Canvas {
                    color: None,
                    depth: canvas.depth,
                }
                .pass(draw.clock, encoder, |pass| {
                    pass.set_pipeline(&self.pipeline(draw.variant(self, Program::Opaque)));
                    pass.set_bind_group(0, draw.bindings, &[]);
                    pass.set_bind_group(1, seen, &[]);
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
