//! Sample counts: many counters of each kind, so that invocations rarely contend for one.

use super::context::Context;
use crate::Result;
use crate::gpu::read_buffer;
use crate::picture::RenderStats;
use wgpu::BufferUsages;

/// Number of counters in `shaders/lib/count.wgsl`.
pub(super) const COUNTERS: usize = 3 * 1024;

/// The sample counters.
#[derive(Clone)]
pub(super) struct Counter {
    pub(super) buffer: wgpu::Buffer,
    pub(super) back: wgpu::Buffer,
    pub(super) group: wgpu::BindGroup,
}

impl Counter {
    pub(super) const ENTRY: wgpu::BindGroupLayoutEntry = wgpu::BindGroupLayoutEntry {
        binding: 0,
        visibility: wgpu::ShaderStages::FRAGMENT.union(wgpu::ShaderStages::COMPUTE),
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Storage { read_only: false },
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    };

    pub(super) fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("counts"),
            entries: &[Self::ENTRY],
        })
    }

    pub(super) fn new(context: &Context) -> Self {
        let buffer = context.buffer_of(
            "counts",
            &[0; COUNTERS * 4],
            BufferUsages::STORAGE | BufferUsages::COPY_SRC,
        );
        let back = context.buffer(
            "counts, to read",
            buffer.size(),
            BufferUsages::MAP_READ | BufferUsages::COPY_DST,
        );
        let entry = wgpu::BindGroupEntry {
            binding: 0,
            resource: buffer.as_entire_binding(),
        };
        let group = context.bind_group("counts", &Self::layout(&context.device.device), &[entry]);
        Self { buffer, back, group }
    }

    pub(super) fn read(&self, context: &Context) -> Result<RenderStats> {
        let device = &context.device;
        let mut encoder = device
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&self.buffer, 0, &self.back, 0, self.buffer.size());
        device.queue.submit([encoder.finish()]);
        let counts: Vec<u32> = bytemuck::pod_collect_to_vec(&read_buffer(&device.device, &self.back)?);
        let sum = |n: usize| counts.iter().skip(n).step_by(3).map(|&c| u64::from(c)).sum();
        Ok(RenderStats {
            samples_taken: sum(0),
            samples_skipped: sum(1),
            samples_terminated: sum(2),
        })
    }
}
