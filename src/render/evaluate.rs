//! Evaluates the shaders' functions at many points: numbers for tests, and stacks composed on the
//! device.

use super::Renderer;
use super::context::{Context, UNIFORM, layout_entries};
use super::maps::MapCache;
use super::uniforms::{CutShapeUniform, PlacedMapUniform};
use super::variant::overrides;
use crate::deform::compose::SourcesAndAlphas;
use crate::deform::cut::{CutShapes, MAX_CUTS};
use crate::deform::{MAX_MAPS, Stack};
use crate::gpu::shaders::Program;
use crate::gpu::{checked, read_buffer};
use crate::prepare::Prepared;
use crate::{Error, Result};
use glam::Vec3;
use wgpu::util::DeviceExt;

/// Points per submission: their results stay below the storage size that every device supports.
const POINTS_AT_ONCE: usize = 1 << 20;

impl Context {
    pub(super) fn stack_layout(&self) -> wgpu::BindGroupLayout {
        let stages = wgpu::ShaderStages::COMPUTE;
        let entry = layout_entries(stages);
        let mut entries = vec![
            entry(1, UNIFORM),
            entry(14, UNIFORM),
            entry(3, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
        ];
        let texture = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: true },
            view_dimension: wgpu::TextureViewDimension::D3,
            multisampled: false,
        };
        entries.extend([6, 7].map(|n| entry(n, texture)));
        self.device
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("stack"),
                entries: &entries,
            })
    }

    pub(super) fn points_layout(&self) -> wgpu::BindGroupLayout {
        let storage = |binding, read_only| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Storage { read_only },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        };
        self.device
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: None,
                entries: &[storage(0, true), storage(1, false)],
            })
    }

    /// Runs a program with one invocation per point; `T` is its output per point.
    fn compute<T: bytemuck::AnyBitPattern + bytemuck::NoUninit>(
        &self,
        pipeline: &wgpu::ComputePipeline,
        bindings: &wgpu::BindGroup,
        points: &[[f32; 3]],
    ) -> Result<Vec<T>> {
        let device = &self.device.device;
        let mut results = Vec::with_capacity(points.len());
        for part in points.chunks(POINTS_AT_ONCE) {
            let padded: Vec<[f32; 4]> = part.iter().map(|p| [p[0], p[1], p[2], 0.0]).collect();
            let input = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: None,
                contents: bytemuck::cast_slice(&padded),
                usage: wgpu::BufferUsages::STORAGE,
            });
            let size = (part.len() * size_of::<T>()) as u64;
            let buffer = |usage| {
                device.create_buffer(&wgpu::BufferDescriptor {
                    label: None,
                    size,
                    usage,
                    mapped_at_creation: false,
                })
            };
            let output = buffer(wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
            let back = buffer(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &self.points_layout(),
                entries: &[
                    wgpu::BindGroupEntry {
                        binding: 0,
                        resource: input.as_entire_binding(),
                    },
                    wgpu::BindGroupEntry {
                        binding: 1,
                        resource: output.as_entire_binding(),
                    },
                ],
            });
            let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, bindings, &[]);
                pass.set_bind_group(1, &group, &[]);
                pass.dispatch_workgroups((part.len() as u32).div_ceil(64), 1, 1);
            }
            encoder.copy_buffer_to_buffer(&output, 0, &back, 0, size);
            self.device.queue.submit([encoder.finish()]);
            results.extend(bytemuck::pod_collect_to_vec::<u8, T>(&read_buffer(
                device, &back,
            )?));
        }
        Ok(results)
    }
}

impl MapCache {
    /// A stack's source points and smallest masks.
    ///
    /// # Errors
    /// More maps than a pass binds; any error of the device.
    pub(super) fn evaluate_stack(
        &self,
        context: &Context,
        stack: &Stack,
        points: &[Vec3],
    ) -> Result<SourcesAndAlphas> {
        let device = &context.device.device;
        let mut results = points.iter().map(|p| (*p, 1.0f32)).collect::<Vec<_>>();
        // The last maps act first; a map added to the previous one stays with it.
        let mut end = stack.maps().len();
        while end > 0 {
            let mut first = end.saturating_sub(MAX_MAPS);
            while first > 0 && stack.maps()[first].added && first + 1 < end {
                first += 1;
            }
            if stack.maps()[first].added && first > 0 {
                return Err(Error::GpuLimit(format!(
                    "more than {MAX_MAPS} deformations are added together, which a GPU does not support"
                )));
            }
            let part = Stack::new(stack.maps()[first..end].to_vec());
            let positions: Vec<[f32; 3]> = results.iter().map(|(p, _)| p.to_array()).collect();
            let moved: Vec<[f32; 4]> = checked(device, || {
                let bindings = self.bind_stack(context, &part, &CutShapes::default())?;
                let pipeline = context.compute_pipeline(
                    Program::Compose,
                    false,
                    [&context.stack_layout(), &context.points_layout()],
                    &[
                        ("MAPS", part.maps().len() as f64),
                        ("EXACT", f64::from(u8::from(context.strategy.exact_filter))),
                        ("EXACT_MAPS", f64::from(u8::from(context.strategy.exact_filter))),
                    ],
                );
                context.compute(&pipeline, &bindings, &positions)
            })?;
            for (result, m) in results.iter_mut().zip(moved) {
                *result = (Vec3::new(m[0], m[1], m[2]), result.1.min(m[3]));
            }
            end = first;
        }
        Ok(results)
    }

    /// Binds the maps of a stack and the cut shapes, without a scene.
    pub(super) fn bind_stack(
        &self,
        context: &Context,
        stack: &Stack,
        cuts: &CutShapes,
    ) -> Result<wgpu::BindGroup> {
        let (views, placed, _) = self.upload_maps(context, stack)?;
        let mut shapes = [bytemuck::Zeroable::zeroed(); MAX_CUTS];
        for (shape, cut) in shapes.iter_mut().zip(cuts.primitives()) {
            *shape = CutShapeUniform::new(cut);
        }
        let uniform = context.scratch(
            "placements",
            bytemuck::cast_slice::<PlacedMapUniform, u8>(&placed),
            wgpu::BufferUsages::UNIFORM,
        );
        let shapes = context.scratch(
            "shapes",
            bytemuck::cast_slice::<CutShapeUniform, u8>(&shapes),
            wgpu::BufferUsages::UNIFORM,
        );
        let mut entries = vec![
            wgpu::BindGroupEntry {
                binding: 1,
                resource: uniform.as_entire_binding(),
            },
            wgpu::BindGroupEntry {
                binding: 14,
                resource: shapes.as_entire_binding(),
            },
            wgpu::BindGroupEntry {
                binding: 3,
                resource: wgpu::BindingResource::Sampler(&context.sampler),
            },
        ];
        entries.extend(views.iter().enumerate().map(|(k, view)| wgpu::BindGroupEntry {
            binding: 6 + k as u32,
            resource: wgpu::BindingResource::TextureView(view),
        }));
        Ok(context.bind_group("stack", &context.stack_layout(), &entries))
    }
}

impl Renderer {
    /// Evaluates the shaders' shared functions at points of the deformed scene, with 24 floats each
    /// in the layout of `Probe` in `shaders/probe.wgsl`: numbers to compare with the CPU's.
    ///
    /// # Errors
    /// Any error of the device.
    pub fn probe(&mut self, scene: &Prepared, points: &[[f32; 3]]) -> Result<Vec<[f32; 24]>> {
        let device = self.context.device.device.clone();
        checked(&device, || {
            self.scene
                .volume
                .upload(&self.context, scene.volume().grid, scene.volume().colors)?;
            let bindings = {
                let shared = self.shared(scene)?;
                self.scene.group(&self.context, &shared, None)
            };
            let variant = self.context.variant(scene, Program::Probe, false);
            let function = self.context.function(scene.volume().grid);
            let pipeline = self.context.compute_pipeline_of(
                &self.context.module_of(Program::Probe, false, function),
                "main",
                &[&self.context.shared_layout, &self.context.points_layout()],
                &overrides(&variant),
            );
            self.context.compute(&pipeline, &bindings, points)
        })
    }
}
