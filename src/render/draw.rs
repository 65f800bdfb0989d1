//! Submissions, and bands of rays. Two are in flight at a time, so that the device
//! does not wait for the next one to be recorded.

use super::Renderer;
use super::context::{Context, lock};
use super::counter::Counter;
use super::pass_timer::PassTimer;
use super::refine::Samples;
use super::target::{Layer, RenderTexture};
use super::variant::{Variant, overrides};
use crate::gpu::shaders::Program;
use crate::gpu::{wait, wait_for};
use crate::prepare::Prepared;
use crate::{Result, Watch};
use std::collections::VecDeque;
use wgpu::{BufferUsages, TextureFormat};

/// Pixels per submission of rays: on hardware, and on a software driver, whose shorter bands allow
/// cancellation.
const PIXELS_PER_BAND: [u32; 2] = [1 << 18, 1 << 16];
/// Rays per workgroup along each axis, as in `shaders/raycast_compute.wgsl`.
const RAYS_ACROSS: u32 = 8;
/// One picture being drawn.
#[derive(Clone, Copy)]
pub(super) struct Draw<'a> {
    pub scene: &'a Prepared<'a>,
    pub bindings: &'a wgpu::BindGroup,
    pub behind: Option<&'a Layer>,
    pub counter: Option<&'a Counter>,
    pub target: &'a RenderTexture,
    pub samples: Samples<'a>,
    pub watch: &'a Watch<'a>,
    /// The timer of the passes, if they are timed.
    pub clock: Option<&'a PassTimer>,
}

impl Draw<'_> {
    pub(super) fn variant(&self, context: &Context, program: Program) -> Variant {
        let rays = matches!(program, Program::Raycast | Program::RaycastCompute);
        Variant {
            listed: rays && self.samples.is_listed(),
            masked: program == Program::Slice && matches!(self.samples, Samples::Masked(..)),
            ..context.variant(self.scene, program, self.counter.is_some())
        }
    }

    /// Binds the scene, and the counters if samples are counted.
    pub(super) fn bind(&self, pass: &mut wgpu::RenderPass) {
        pass.set_bind_group(0, self.bindings, &[]);
        if let Some(counter) = self.counter {
            pass.set_bind_group(1, &counter.group, &[]);
        }
    }
}

/// Attachments of a pass.
pub(super) struct Canvas<'a> {
    pub color: Option<(&'a wgpu::TextureView, wgpu::LoadOp<wgpu::Color>)>,
    pub depth: Option<(&'a wgpu::TextureView, wgpu::LoadOp<f32>)>,
}

impl<'a> Canvas<'a> {
    pub(super) fn of(color: &'a wgpu::TextureView, load: wgpu::LoadOp<wgpu::Color>) -> Self {
        Self {
            color: Some((color, load)),
            depth: None,
        }
    }

    pub(super) fn pass(
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
pub(super) struct PendingSubmissions(VecDeque<(wgpu::SubmissionIndex, f32)>);

impl Context {
    /// Submits; waits for the previous submission, reports its progress, and checks for
    /// cancellation.
    pub(super) fn submit(
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
            self.compute_pipeline_of(
                &self.shader_module(&variant),
                "main",
                &[&self.shared_layout, &own],
                &overrides(&variant),
            )
        };
        lock(&self.ray_pipelines)
            .entry(variant)
            .or_insert_with(make)
            .clone()
    }
}

impl Renderer {
    /// Draws one ray per pixel, band by band.
    pub(super) fn draw_rays(&mut self, draw: &Draw) -> Result<()> {
        let [width, height] = draw.samples.drawn_size();
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
}
