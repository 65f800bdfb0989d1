//! Classification of the cells of the empty-space grid on the device.

use super::context::Context;
use super::maps::MapCache;
use super::sample_map::{MapBounds, groups, storage};
use super::uniforms::{ClassificationUniform, MAP_LEVELS, NodeBounds, VALUE_LEVELS};
use crate::deform::{MAX_MAPS, Stack};
use crate::gpu::read_buffer;
use crate::gpu::shaders::Program;
use crate::prepare::{CellGrid, CellState, VisibilityCriteria};
use crate::transfer::{TABLE_ENTRIES, TransferTable};
use crate::volume::{VoxelGrid, VoxelGridValues};
use crate::{Error, Result};
use std::sync::{Mutex, PoisonError};
use wgpu::BufferUsages;

/// Bounds on the values of a volume, on the device.
struct ValueBounds {
    /// Retained, so that the address used as key is not reused.
    voxels: VoxelGridValues,
    nodes: wgpu::Buffer,
    levels: Vec<[u32; 4]>,
}

/// Bounds on the values of the last classified volume.
#[derive(Default)]
pub(super) struct ValueBoundsCache(Mutex<Option<ValueBounds>>);

impl ValueBoundsCache {
    /// The nodes of a volume's bounds, and their levels.
    fn value_bounds(
        &self,
        context: &Context,
        contents: &VisibilityCriteria,
        volume: &VoxelGrid,
    ) -> (wgpu::Buffer, Vec<[u32; 4]>) {
        let mut cached = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = cached
            .as_ref()
            .filter(|v| v.voxels.identity() == volume.voxels.identity())
        {
            return (found.nodes.clone(), found.levels.clone());
        }
        let (mut levels, mut nodes) = (Vec::new(), Vec::new());
        for (size, of_level) in contents.value_pyramid.levels() {
            let [x, y, z] = size.map(|n| n as u32);
            levels.push([x, y, z, nodes.len() as u32]);
            nodes.extend(of_level.iter().map(|r| [r.min[0], r.max[0]]));
        }
        let buffer = context.buffer_of(
            "bounds of the volume",
            bytemuck::cast_slice(&nodes),
            BufferUsages::STORAGE,
        );
        *cached = Some(ValueBounds {
            voxels: volume.voxels.clone(),
            nodes: buffer.clone(),
            levels: levels.clone(),
        });
        (buffer, levels)
    }

    /// The states of the cells of a grid, x fastest; `None` if the scene has more maps or pyramid
    /// levels than the shader supports.
    pub(super) fn classified(
        &self,
        context: &Context,
        maps: &MapCache,
        cells: &CellGrid,
        contents: &VisibilityCriteria,
        volume: &VoxelGrid,
    ) -> Result<Option<Vec<CellState>>> {
        let stack = contents.stack;
        let (values, value_levels) = self.value_bounds(context, contents, volume);
        if stack.maps().len() > MAX_MAPS || value_levels.len() > VALUE_LEVELS {
            return Ok(None);
        }
        let stack_group = maps.bind_stack(context, stack, contents.cuts)?;
        let bounds = stack
            .maps()
            .iter()
            .map(|m| maps.bounds_of(context, &m.map))
            .collect::<Result<Vec<_>>>()?;
        if bounds.iter().any(|b| b.levels.len() > MAP_LEVELS) {
            return Ok(None);
        }
        let mut uniform = ClassificationUniform::new(cells, contents, &value_levels);
        let mut encoder = context
            .device
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let map_nodes = joined_map_bounds(context, &mut encoder, stack, &bounds, &mut uniform);
        let uniform = context.scratch(
            "classification",
            bytemuck::bytes_of(&uniform),
            BufferUsages::UNIFORM,
        );
        let visible = context.scratch(
            "visible entries",
            bytemuck::cast_slice(&visible_entry_sums(contents.table)),
            BufferUsages::STORAGE,
        );
        let bytes = u64::from(cells.size.element_product()) * 4;
        let flags = context.scratch_of("flags", bytes, BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let back = context.scratch_of(
            "flags, to read",
            bytes,
            BufferUsages::MAP_READ | BufferUsages::COPY_DST,
        );
        let layout = context.layout_of(
            "classification",
            &[
                super::sample_map::uniform(false),
                storage(true),
                storage(true),
                storage(true),
                storage(false),
            ],
        );
        let resources = [&uniform, &values, &map_nodes, &visible, &flags].map(|b| b.as_entire_binding());
        let group = context.bind_in_order("classification", &layout, &resources);
        let pipeline = classification_pipeline(context, contents, &layout);
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &stack_group, &[]);
            pass.set_bind_group(1, &group, &[]);
            let [x, y, z] = groups(cells.size.to_array());
            pass.dispatch_workgroups(x, y, z);
        }
        encoder.copy_buffer_to_buffer(&flags, 0, &back, 0, bytes);
        context.device.queue.submit([encoder.finish()]);
        read_states(context, &back, cells.size.element_product() as usize).map(Some)
    }
}

/// The bounds of all maps of a stack in one buffer. Records the copies, and writes the offset of
/// each map's levels into the uniform.
fn joined_map_bounds(
    context: &Context,
    encoder: &mut wgpu::CommandEncoder,
    stack: &Stack,
    bounds: &[MapBounds],
    uniform: &mut ClassificationUniform,
) -> wgpu::Buffer {
    let all: u64 = bounds.iter().map(|b| b.nodes.size()).sum();
    let map_nodes = context.scratch_of(
        "bounds of all maps",
        all.max(size_of::<NodeBounds>() as u64),
        BufferUsages::STORAGE | BufferUsages::COPY_DST,
    );
    let mut at = 0;
    for (k, b) in bounds.iter().enumerate() {
        uniform.set_map(
            k,
            &b.levels,
            (at / size_of::<NodeBounds>() as u64) as u32,
            stack.maps()[k].map.has_cuts(),
        );
        encoder.copy_buffer_to_buffer(&b.nodes, 0, &map_nodes, at, b.nodes.size());
        at += b.nodes.size();
    }
    map_nodes
}

/// Running count of a table's visible entries: before each entry, and in total.
fn visible_entry_sums(table: &TransferTable) -> Vec<u32> {
    let mut visible = Vec::with_capacity(TABLE_ENTRIES + 1);
    visible.push(0u32);
    for entry in table.entries.iter().take(TABLE_ENTRIES) {
        visible.push(visible[visible.len() - 1] + u32::from(entry[3] > 0.0));
    }
    visible
}

/// The pipeline for the scene's number of maps and of cuts, compiled on first use.
fn classification_pipeline(
    context: &Context,
    contents: &VisibilityCriteria,
    layout: &wgpu::BindGroupLayout,
) -> wgpu::ComputePipeline {
    let key = (
        contents.stack.maps().len(),
        contents.cuts.primitives().len(),
        context.strategy.exact_filter,
    );
    let mut cached = context
        .classify_pipelines
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    let make = || {
        let constants = [
            ("MAPS", key.0 as f64),
            ("CUTS", key.1 as f64),
            ("EXACT", f64::from(u8::from(key.2))),
            ("EXACT_MAPS", f64::from(u8::from(key.2))),
        ];
        context.compute_pipeline_at(
            Program::Classify,
            "classify",
            false,
            &[&context.stack_layout(), layout],
            &constants,
        )
    };
    cached.entry(key).or_insert_with(make).clone()
}

/// Reads the states of `count` cells back.
fn read_states(context: &Context, flags: &wgpu::Buffer, count: usize) -> Result<Vec<CellState>> {
    let read = read_buffer(&context.device.device, flags)?;
    let numbers: &[u32] =
        bytemuck::try_cast_slice(&read).map_err(|e| Error::Gpu(format!("reading back failed: {e}")))?;
    let state = |n: &u32| match n {
        0 => CellState::Empty,
        1 => CellState::Occupied,
        _ => CellState::CutFree,
    };
    Ok(numbers.iter().take(count).map(state).collect())
}
