//! Timing by the GPU's own clock: each pass of a picture writes its start and end.

use super::context::Context;
use super::work::{ResourceKind, WorkCounters};
use crate::Result;
use crate::gpu::read_buffer;
use std::sync::atomic::{AtomicU32, Ordering};
use wgpu::{BufferUsages, Features};

/// Maximum number of timed passes per picture.
const MAX_TIMED_PASSES: u32 = 1024;

/// Timestamps of one picture's passes.
pub(super) struct PassTimer {
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    back: wgpu::Buffer,
    passes: AtomicU32,
}

impl PassTimer {
    /// None if the device does not support timestamps.
    pub fn new(device: &wgpu::Device, tally: &WorkCounters) -> Option<Self> {
        if !device.features().contains(Features::TIMESTAMP_QUERY) {
            return None;
        }
        let buffer = |label, usage| {
            tally.count(ResourceKind::Buffer);
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: u64::from(MAX_TIMED_PASSES) * 16,
                usage,
                mapped_at_creation: false,
            })
        };
        Some(Self {
            set: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("passes"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MAX_TIMED_PASSES,
            }),
            resolved: buffer("timestamps", BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC),
            back: buffer(
                "timestamps, to read",
                BufferUsages::MAP_READ | BufferUsages::COPY_DST,
            ),
            passes: AtomicU32::new(0),
        })
    }

    /// Starts a picture.
    pub fn restart(&self) {
        self.passes.store(0, Ordering::Relaxed);
    }

    /// The timestamp writes of the next render pass; none if there are too many passes.
    pub fn next(&self) -> Option<wgpu::RenderPassTimestampWrites<'_>> {
        self.next_pass()
            .map(|[beginning, end]| wgpu::RenderPassTimestampWrites {
                query_set: &self.set,
                beginning_of_pass_write_index: Some(beginning),
                end_of_pass_write_index: Some(end),
            })
    }

    /// The same for a compute pass.
    pub fn next_computing(&self) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        self.next_pass()
            .map(|[beginning, end]| wgpu::ComputePassTimestampWrites {
                query_set: &self.set,
                beginning_of_pass_write_index: Some(beginning),
                end_of_pass_write_index: Some(end),
            })
    }

    fn next_pass(&self) -> Option<[u32; 2]> {
        let pass = self.passes.fetch_add(1, Ordering::Relaxed);
        (pass < MAX_TIMED_PASSES).then_some([2 * pass, 2 * pass + 1])
    }

    /// Total time of all passes since the restart, milliseconds; none if there were too many, or no
    /// passes.
    pub fn milliseconds(&self, context: &Context) -> Result<Option<f64>> {
        let passes = self.passes.load(Ordering::Relaxed);
        if !(1..=MAX_TIMED_PASSES).contains(&passes) {
            return Ok(None);
        }
        let (device, queue) = (&context.device.device, &context.device.queue);
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.resolve_query_set(&self.set, 0..2 * passes, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.back, 0, self.back.size());
        queue.submit([encoder.finish()]);
        let stamps: Vec<u64> = bytemuck::pod_collect_to_vec(&read_buffer(device, &self.back)?);
        let ticks: u64 = stamps
            .chunks_exact(2)
            .take(passes as usize)
            .map(|pass| pass[1].saturating_sub(pass[0]))
            .sum();
        Ok(Some(
            ticks as f64 * f64::from(queue.get_timestamp_period()) * 1e-6,
        ))
    }
}
