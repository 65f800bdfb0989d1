//! Surfaces on a GPU: triangles rasterised with their forward deformers in the vertex shader, and
//! fields by one ray per pixel, all into one layer of colour and distance, in front of which a
//! volume is drawn.
//!
//! Each object is a separate pass with its own field bound, with the device's depth test between
//! them: shader bindings do not limit the number of objects. An object in two stages has its
//! triangles drawn into a separate layer, which its rays read and blend with.

use super::context::{Context, lock};
use super::counter::Counter;
use super::object::{Corners, MeshCorner};
use super::pass_timer::PassTimer;
use super::refine::Samples;
use super::target::{DEPTH, Layer};
use super::variant::{Variant, overrides};
use super::work::ResourceKind;
use super::{PictureInputs, Renderer};
use crate::gpu::shaders::Program;
use crate::prepare::Prepared;
use crate::prepare::objects::Stage;
use crate::{Result, Watch};
use wgpu::TextureFormat;

/// Distance of a pixel without a surface; as in `shaders/bindings.wgsl`.
const FAR_AWAY: f64 = 1e30;

/// Rows of a picture per submission of rays.
const ROWS_AT_ONCE: u32 = 128;

impl Context {
    fn clear(&self, layer: &Layer, clock: Option<&PassTimer>) {
        self.surface_pass(layer, clock, true, |_| {});
    }

    fn surface_pass(
        &self,
        layer: &Layer,
        clock: Option<&PassTimer>,
        clear: bool,
        record: impl FnOnce(&mut wgpu::RenderPass),
    ) {
        let color = |view, value| {
            Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: if clear {
                        wgpu::LoadOp::Clear(value)
                    } else {
                        wgpu::LoadOp::Load
                    },
                    store: wgpu::StoreOp::Store,
                },
            })
        };
        let mut encoder = self
            .device
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("surfaces"),
                color_attachments: &[
                    color(&layer.color_view, wgpu::Color::TRANSPARENT),
                    color(
                        &layer.distance_view,
                        wgpu::Color {
                            r: FAR_AWAY,
                            ..wgpu::Color::TRANSPARENT
                        },
                    ),
                ],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &layer.depth_view,
                    depth_ops: Some(wgpu::Operations {
                        load: if clear {
                            wgpu::LoadOp::Clear(1.0)
                        } else {
                            wgpu::LoadOp::Load
                        },
                        store: wgpu::StoreOp::Store,
                    }),
                    stencil_ops: None,
                }),
                timestamp_writes: clock.and_then(PassTimer::next),
                occlusion_query_set: None,
                multiview_mask: None,
            });
            record(&mut pass);
        }
        self.device.queue.submit([encoder.finish()]);
    }

    /// The pipeline of a variant, compiled on first use.
    fn surface_pipeline(&self, variant: Variant) -> wgpu::RenderPipeline {
        lock(&self.pipelines)
            .entry(variant)
            .or_insert_with(|| self.compiled_surface(variant))
            .clone()
    }

    /// The layout of the pipelines that draw one object.
    pub(super) fn object_pipeline_layout(&self, variant: &Variant) -> wgpu::PipelineLayout {
        let device = &self.device.device;
        let counts = variant.counting.then(|| Counter::layout(device));
        device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[
                Some(&self.shared_layout),
                counts.as_ref(),
                Some(&self.object_layout()),
            ],
            immediate_size: 0,
        })
    }

    fn compiled_surface(&self, variant: Variant) -> wgpu::RenderPipeline {
        self.tally.count(ResourceKind::Pipeline);
        let device = &self.device.device;
        let module = self.shader_module(&variant);
        let constants = overrides(&variant);
        let options = wgpu::PipelineCompilationOptions {
            constants: &constants,
            ..Default::default()
        };
        let layout = self.object_pipeline_layout(&variant);
        let corner = wgpu::VertexBufferLayout {
            array_stride: size_of::<MeshCorner>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3],
        };
        let buffers = [Some(corner)];
        let target = |format| {
            Some(wgpu::ColorTargetState {
                format,
                blend: None,
                write_mask: wgpu::ColorWrites::ALL,
            })
        };
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(&format!("{:?}", variant.program)),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: options.clone(),
                buffers: if variant.program == Program::Mesh {
                    &buffers
                } else {
                    &[]
                },
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
                targets: &[
                    target(TextureFormat::Rgba16Float),
                    target(TextureFormat::R32Float),
                ],
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

/// The variant of a program for the samples of a picture.
fn listed(inputs: &PictureInputs, variant: Variant) -> Variant {
    Variant {
        listed: inputs.samples.is_listed(),
        ..variant
    }
}

impl Renderer {
    /// Draws all surfaces of a scene.
    pub(super) fn draw_surfaces(&mut self, inputs: &PictureInputs) -> Result<Layer> {
        let PictureInputs {
            scene,
            shared,
            watch,
            samples,
            ..
        } = *inputs;
        let layer = self.surface_layer(
            &samples,
            [
                ["surfaces: colour", "surfaces: distance", "surfaces: depth"],
                ["samples: colour", "samples: distance", "samples: depth"],
            ],
        );
        self.context.clear(&layer, self.clock.as_deref());
        let count = scene.surfaces.objects.len();
        for (n, object) in scene.surfaces.objects.iter().enumerate() {
            let (group, corners) = self.scene.surfaces.bind_object(&self.context, n, scene, object)?;
            if scene.is_sliced(object) {
                // Slices sample it themselves.
                continue;
            }
            let nothing_behind = self.scene.group(&self.context, shared, None);
            match (object.stage, &corners) {
                (Stage::Triangles, Some(corners)) => self.draw_mesh(inputs, &layer, &group, corners)?,
                (Stage::Both(_), Some(corners)) => {
                    let drawn = self.surface_layer(
                        &samples,
                        [
                            ["triangles: colour", "triangles: distance", "triangles: depth"],
                            [
                                "sampled triangles: colour",
                                "sampled triangles: distance",
                                "sampled triangles: depth",
                            ],
                        ],
                    );
                    self.context.clear(&drawn, self.clock.as_deref());
                    self.draw_mesh(inputs, &drawn, &group, corners)?;
                    let behind = self.scene.group(&self.context, shared, Some(&drawn));
                    self.cast(inputs, &layer, &behind, &group)?;
                }
                _ => self.cast(inputs, &layer, &nothing_behind, &group)?,
            }
            (watch.progress)((n + 1) as f32 / count as f32);
            watch.check()?;
        }
        self.scene.surfaces.objects.truncate(count);
        Ok(layer)
    }

    /// A layer for samples, by its names for pictures and for lists.
    fn surface_layer(&mut self, samples: &Samples, names: [[&'static str; 3]; 2]) -> Layer {
        let [width, height] = samples.texture_size();
        self.targets
            .layer(&self.context, samples.layer_names(names), width, height)
    }

    /// Draws triangles into a layer: in all pixels, or for listed samples in all pixels of a layer
    /// of its own for each offset, from which they are gathered.
    fn draw_mesh(
        &mut self,
        inputs: &PictureInputs,
        layer: &Layer,
        group: &wgpu::BindGroup,
        corners: &Corners,
    ) -> Result<()> {
        let Samples::Listed(list) = inputs.samples else {
            return self.draw_triangles(inputs, layer, group, corners);
        };
        let pixels = self.surface_layer(
            &Samples::Pixels(list.picture_size),
            [["moved: colour", "moved: distance", "moved: depth"]; 2],
        );
        let behind = self.scene.group(&self.context, inputs.shared, Some(&pixels));
        let pipeline = self.context.surface_pipeline(listed(
            inputs,
            self.context.variant(inputs.scene, Program::Gather, false),
        ));
        for (n, offset) in list.offsets.iter().enumerate() {
            self.context.clear(&pixels, self.clock.as_deref());
            inputs.shared.move_samples(&self.context, *offset);
            self.draw_triangles(inputs, &pixels, group, corners)?;
            let [first, end] = list.rows_of(n);
            self.context
                .surface_pass(layer, self.clock.as_deref(), false, |pass| {
                    pass.set_scissor_rect(0, first, list.picture_size[0], end - first);
                    pass.set_pipeline(&pipeline);
                    pass.set_bind_group(0, &behind, &[]);
                    pass.set_bind_group(2, group, &[]);
                    pass.draw(0..3, 0..1);
                });
        }
        inputs.shared.move_samples(&self.context, [0.0; 2]);
        Ok(())
    }

    fn draw_triangles(
        &mut self,
        inputs: &PictureInputs,
        layer: &Layer,
        group: &wgpu::BindGroup,
        corners: &Corners,
    ) -> Result<()> {
        let shared = self.scene.group(&self.context, inputs.shared, None);
        let variant = self.context.variant(inputs.scene, Program::Mesh, false);
        let pipeline = &self.context.surface_pipeline(variant);
        self.context
            .surface_pass(layer, self.clock.as_deref(), false, |pass| {
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, &shared, &[]);
                pass.set_bind_group(2, group, &[]);
                pass.set_vertex_buffer(0, corners.buffer.slice(..));
                pass.draw(0..corners.count, 0..1);
            });
        crate::gpu::wait(&self.context.device.device)
    }

    fn cast(
        &mut self,
        inputs: &PictureInputs,
        layer: &Layer,
        shared: &wgpu::BindGroup,
        group: &wgpu::BindGroup,
    ) -> Result<()> {
        let counter = inputs.counter;
        let variant = self
            .context
            .variant(inputs.scene, Program::Surface, counter.is_some());
        let pipeline = &self.context.surface_pipeline(listed(inputs, variant));
        let [width, height] = inputs.samples.drawn_size();
        for top in (0..height).step_by(ROWS_AT_ONCE as usize) {
            self.context
                .surface_pass(layer, self.clock.as_deref(), false, |pass| {
                    pass.set_scissor_rect(0, top, width, ROWS_AT_ONCE.min(height - top));
                    pass.set_pipeline(pipeline);
                    pass.set_bind_group(0, shared, &[]);
                    if let Some(counter) = counter {
                        pass.set_bind_group(1, &counter.group, &[]);
                    }
                    pass.set_bind_group(2, group, &[]);
                    pass.draw(0..3, 0..1);
                });
            crate::gpu::wait(&self.context.device.device)?;
        }
        Ok(())
    }

    /// Distance along each pixel's ray to the nearest surface, mm; infinite where there is none.
    /// For tests and picking.
    ///
    /// # Errors
    /// Any error of the device.
    pub fn surface_distances(&mut self, scene: &Prepared) -> Result<Vec<f32>> {
        let device = self.context.device.device.clone();
        crate::gpu::checked(&device, || {
            self.scene
                .volume
                .upload(&self.context, scene.volume().grid, scene.volume().colors)?;
            let shared = self.shared(scene)?;
            let layer = self.draw_surfaces(&PictureInputs {
                scene,
                shared: &shared,
                counter: None,
                watch: &Watch::NONE,
                samples: Samples::Pixels(scene.frame.size),
            })?;
            let distances = {
                let buffer = self
                    .targets
                    .readback(&self.context, crate::gpu::texture_bytes(&layer.distance));
                crate::gpu::read_r32f(
                    &self.context.device.device,
                    &self.context.device.queue,
                    &layer.distance,
                    &buffer,
                )?
            };
            Ok(distances
                .into_iter()
                .map(|t| {
                    if f64::from(t) < 0.99 * FAR_AWAY {
                        t
                    } else {
                        f32::INFINITY
                    }
                })
                .collect())
        })
    }
}
