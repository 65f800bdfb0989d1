//! What the device takes over of preparing a scene: maps sampled from their formulas, with bounds on boxes of their texels, and the cells of the
//! empty-space grid by those bounds.
//!
//! *Theory*: the shaders `sample`, `encode`, `bounds` and `classify` state what `src/deform/kinds`, `src/deform/map.rs`, `src/math/pyramid.rs` and
//! `src/prepare/macrocells.rs` state. A map stays on the device: of its texels the CPU gets to know their scale and what all of them lie within, which the
//! deformed scene's box and the grid's place depend on; and of the grid what each cell shows. Where something asks a map for more (a picker, the CPU
//! renderer), it is sampled there too.

use super::Renderer;
use super::uniforms::{ClassificationUniform, LevelUniform, MAP_LEVELS, MapDefinitionUniform, NodeBounds, VALUE_LEVELS};
use crate::deform::compose::SourcesAndAlphas;
use crate::deform::{DisplacementMap, Formula, MAX_MAPS, MapDefinition, Stack, Storage, TexelRange};
use crate::gpu::shaders::Program;
use crate::gpu::{checked, read_buffer};
use crate::math::pyramid::ChannelRange;
use crate::prepare::{Accelerator, CellGrid, CellState, VisibilityCriteria};
use crate::transfer::TABLE_ENTRIES;
use crate::volume::{VoxelGrid, VoxelGridValues};
use crate::{Error, Result, Watch};
use glam::Vec3;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use wgpu::{BufferUsages, TextureFormat};

/// Invocations of a workgroup along each axis, as in the shaders.
const GROUP: u32 = 4;
/// Cells of a map's grid along the edge of a finest box, as in `shaders/bounds.wgsl`.
const CELLS_PER_NODE: usize = 4;
/// Bytes of samples that are kept room for: those of a map of 128^3 points, and some more.
const MAX_CACHED_SAMPLE_BYTES: u64 = 64 << 20;
/// Distance between uniforms that are chosen by an offset.
const STRIDE: u64 = 256;

impl NodeBounds {
    fn extent(&self) -> TexelRange {
        let nine = |columns: &[[f32; 4]; 3]| std::array::from_fn(|n| columns[n / 3][n % 3]);
        TexelRange {
            texels: ChannelRange { min: self.low, max: self.high },
            slopes: ChannelRange { min: nine(&self.slope_low), max: nine(&self.slope_high) },
        }
    }
}

/// Bounds on boxes of a map's texels, on the device.
#[derive(Clone)]
pub(super) struct MapBounds {
    nodes: wgpu::Buffer,
    /// Nodes along each axis, and the number of the first, of each level, the finest first.
    levels: Vec<[u32; 4]>,
}

impl MapBounds {
    /// What they take on the device.
    pub(super) fn bytes(&self) -> usize {
        self.nodes.size() as usize
    }
}

/// A map that was made here.
pub(super) struct SampledMap {
    pub texture: wgpu::Texture,
    pub bounds: MapBounds,
    scale: f32,
    whole: TexelRange,
}

/// Bounds on the values of a volume, on the device.
struct ValueBounds {
    /// Keeps the address that it is found by.
    voxels: VoxelGridValues,
    nodes: wgpu::Buffer,
    levels: Vec<[u32; 4]>,
}

/// What is kept for the next map and the next grid.
#[derive(Default)]
pub(super) struct PrepareCache {
    maps: OnceLock<MapPipelines>,
    /// By the numbers of maps and of shapes, and by who mixes texels.
    cells: Mutex<HashMap<(usize, usize, bool), wgpu::ComputePipeline>>,
    values: Mutex<Option<ValueBounds>>,
}

/// A pipeline with the layout of what it binds.
struct ComputeStep {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

struct MapPipelines {
    sample: ComputeStep,
    encode: ComputeStep,
    /// The layout of both.
    leaves: ComputeStep,
    halve: wgpu::ComputePipeline,
}

fn storage(read_only: bool) -> wgpu::BindingType {
    wgpu::BindingType::Buffer { ty: wgpu::BufferBindingType::Storage { read_only }, has_dynamic_offset: false, min_binding_size: None }
}

fn uniform(has_dynamic_offset: bool) -> wgpu::BindingType {
    // What is chosen by an offset must know how much it is.
    let size = std::num::NonZeroU64::new(size_of::<LevelUniform>() as u64).filter(|_| has_dynamic_offset);
    wgpu::BindingType::Buffer { ty: wgpu::BufferBindingType::Uniform, has_dynamic_offset, min_binding_size: size }
}

fn groups(size: [u32; 3]) -> [u32; 3] {
    size.map(|n| n.div_ceil(GROUP))
}

/// Levels of boxes over a grid of texels, and how many there are in all.
fn levels_of(size: [usize; 3]) -> (Vec<[u32; 4]>, u32) {
    let mut nodes = size.map(|n| n.saturating_sub(1).div_ceil(CELLS_PER_NODE).max(1) as u32);
    let (mut levels, mut first) = (Vec::new(), 0);
    loop {
        levels.push([nodes[0], nodes[1], nodes[2], first]);
        first += nodes.iter().product::<u32>();
        if nodes == [1; 3] {
            return (levels, first);
        }
        nodes = nodes.map(|n| n.div_ceil(2));
    }
}

impl Renderer {
    fn layout_of(&self, label: &str, types: &[wgpu::BindingType]) -> wgpu::BindGroupLayout {
        let entry = |(n, ty): (usize, &wgpu::BindingType)| wgpu::BindGroupLayoutEntry {
            binding: n as u32,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: *ty,
            count: None,
        };
        let entries: Vec<_> = types.iter().enumerate().map(entry).collect();
        self.device.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
    }

    /// A bind group of resources by their order.
    fn bind_in_order(&self, label: &str, layout: &wgpu::BindGroupLayout, resources: &[wgpu::BindingResource]) -> wgpu::BindGroup {
        let entries: Vec<_> = resources.iter().enumerate().map(|(n, r)| wgpu::BindGroupEntry { binding: n as u32, resource: r.clone() }).collect();
        self.bind_group(label, layout, &entries)
    }

    fn step(&self, program: Program, entry: &str, types: &[wgpu::BindingType]) -> ComputeStep {
        let layout = self.layout_of(entry, types);
        ComputeStep { pipeline: self.compute_pipeline_at(program, entry, false, &[&layout], &[]), layout }
    }

    fn map_pipelines(&self) -> &MapPipelines {
        self.prepare_cache.maps.get_or_init(|| {
            let texels = wgpu::BindingType::StorageTexture {
                access: wgpu::StorageTextureAccess::WriteOnly,
                format: TextureFormat::Rgba16Float,
                view_dimension: wgpu::TextureViewDimension::D3,
            };
            let map = wgpu::BindingType::Texture {
                sample_type: wgpu::TextureSampleType::Float { filterable: false },
                view_dimension: wgpu::TextureViewDimension::D3,
                multisampled: false,
            };
            let leaves = self.step(Program::Bounds, "leaves", &[uniform(true), storage(false), map]);
            MapPipelines {
                sample: self.step(Program::Sample, "sample", &[uniform(false), storage(false), storage(false)]),
                encode: self.step(Program::Encode, "encode", &[uniform(false), storage(true), storage(true), texels]),
                halve: self.compute_pipeline_at(Program::Bounds, "halve", false, &[&leaves.layout], &[]),
                leaves,
            }
        })
    }

    /// Records what bounds the boxes of a map's texels.
    fn record_bounds(&self, pass: &mut wgpu::ComputePass, size: [usize; 3], view: &wgpu::TextureView) -> MapBounds {
        let pipelines = self.map_pipelines();
        let (levels, count) = levels_of(size);
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        let nodes = self.buffer("bounds of a map", u64::from(count) * size_of::<NodeBounds>() as u64, usage);
        let mut uniforms = vec![0; levels.len() * STRIDE as usize];
        for (n, &[x, y, z, first]) in levels.iter().enumerate() {
            let [bx, by, bz, below_first] = levels[n.saturating_sub(1)];
            let level = LevelUniform { size: [x, y, z], first, below_size: [bx, by, bz], below_first };
            uniforms[n * STRIDE as usize..][..size_of::<LevelUniform>()].copy_from_slice(bytemuck::bytes_of(&level));
        }
        let uniforms = self.scratch("levels", &uniforms, BufferUsages::UNIFORM);
        let of_level = wgpu::BufferBinding { buffer: &uniforms, offset: 0, size: std::num::NonZeroU64::new(size_of::<LevelUniform>() as u64) };
        let resources = [wgpu::BindingResource::Buffer(of_level), nodes.as_entire_binding(), wgpu::BindingResource::TextureView(view)];
        let group = self.bind_in_order("bounds of a map", &pipelines.leaves.layout, &resources);
        for (n, &[x, y, z, _]) in levels.iter().enumerate() {
            pass.set_pipeline(if n == 0 { &pipelines.leaves.pipeline } else { &pipelines.halve });
            pass.set_bind_group(0, &group, &[n as u32 * STRIDE as u32]);
            let [x, y, z] = groups([x, y, z]);
            pass.dispatch_workgroups(x, y, z);
        }
        MapBounds { nodes, levels }
    }

    /// Bounds on boxes of the texels of a map that the CPU has made.
    pub(super) fn bound_texels(&self, size: [usize; 3], view: &wgpu::TextureView) -> MapBounds {
        let mut encoder = self.device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let bounds = {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            self.record_bounds(&mut pass, size, view)
        };
        self.device.queue.submit([encoder.finish()]);
        bounds
    }

    /// Samples a formula into a map.
    pub(super) fn sampled_map(&self, recipe: &MapDefinition, formula: &Formula) -> Result<SampledMap> {
        let pipelines = self.map_pipelines();
        let size = recipe.size.map(|n| n as u32);
        let points = recipe.size.iter().product::<usize>() as u64;
        let usage = wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_SRC;
        let texture = self.texture_3d_for("displacement map", recipe.size, TextureFormat::Rgba16Float, usage)?;
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let own = MapDefinitionUniform {
            cube_mm: recipe.cube_mm.into(),
            ramp_mm: recipe.ramp_mm,
            size,
            kind: formula.kind as u32,
            numbers: formula.numbers,
        };
        let own = self.scratch("recipe", bytemuck::bytes_of(&own), BufferUsages::UNIFORM);
        let edge = self.scratch("size of a map", bytemuck::bytes_of(&[size[0], size[1], size[2], 0]), BufferUsages::UNIFORM);
        let samples = if points * 16 <= MAX_CACHED_SAMPLE_BYTES {
            self.scratch_of("samples", points * 16, BufferUsages::STORAGE)
        } else {
            self.buffer("samples", points * 16, BufferUsages::STORAGE)
        };
        let largest = self.scratch("largest displacement", &[0; 16], BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let (own, edge, all, most) = (own.as_entire_binding(), edge.as_entire_binding(), samples.as_entire_binding(), largest.as_entire_binding());
        let sampling = self.bind_in_order("sampling", &pipelines.sample.layout, &[own, all.clone(), most.clone()]);
        let texels = wgpu::BindingResource::TextureView(&view);
        let encoding = self.bind_in_order("encoding", &pipelines.encode.layout, &[edge, all, most, texels]);
        let mut encoder = self.device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let bounds = {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            let [x, y, z] = groups(size);
            for (step, group) in [(&pipelines.sample, &sampling), (&pipelines.encode, &encoding)] {
                pass.set_pipeline(&step.pipeline);
                pass.set_bind_group(0, group, &[]);
                pass.dispatch_workgroups(x, y, z);
            }
            self.record_bounds(&mut pass, recipe.size, &view)
        };
        let node = size_of::<NodeBounds>() as u64;
        let back = self.scratch_of("a map's extent, to read", node + 16, BufferUsages::MAP_READ | BufferUsages::COPY_DST);
        encoder.copy_buffer_to_buffer(&bounds.nodes, bounds.nodes.size() - node, &back, 0, node);
        encoder.copy_buffer_to_buffer(&largest, 0, &back, node, 4);
        self.device.queue.submit([encoder.finish()]);
        let bytes = read_buffer(&self.device.device, &back)?;
        let whole = bytemuck::pod_read_unaligned::<NodeBounds>(&bytes[..node as usize]).extent();
        let scale: f32 = bytemuck::pod_read_unaligned(&bytes[node as usize..][..4]);
        Ok(SampledMap { texture, bounds, scale: if scale > 0.0 { scale } else { 1.0 }, whole })
    }

    /// Whether the device can hold what sampling a map needs.
    fn samples(&self, recipe: &MapDefinition) -> bool {
        let limits = self.device.device.limits();
        let bytes = recipe.size.iter().product::<usize>() as u64 * 16;
        recipe.storage == Storage::F16 && bytes <= limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// The nodes of a volume's bounds, and their levels.
    fn value_bounds(&self, contents: &VisibilityCriteria, volume: &VoxelGrid) -> (wgpu::Buffer, Vec<[u32; 4]>) {
        let mut cached = self.prepare_cache.values.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = cached.as_ref().filter(|v| v.voxels.identity() == volume.voxels.identity()) {
            return (found.nodes.clone(), found.levels.clone());
        }
        let (mut levels, mut nodes) = (Vec::new(), Vec::new());
        for (size, of_level) in contents.value_pyramid.levels() {
            let [x, y, z] = size.map(|n| n as u32);
            levels.push([x, y, z, nodes.len() as u32]);
            nodes.extend(of_level.iter().map(|r| [r.min[0], r.max[0]]));
        }
        let buffer = self.buffer_of("bounds of the volume", bytemuck::cast_slice(&nodes), BufferUsages::STORAGE);
        *cached = Some(ValueBounds { voxels: volume.voxels.clone(), nodes: buffer.clone(), levels: levels.clone() });
        (buffer, levels)
    }

    fn classified(&self, cells: &CellGrid, contents: &VisibilityCriteria, volume: &VoxelGrid) -> Result<Option<Vec<CellState>>> {
        let stack = contents.stack;
        let (values, value_levels) = self.value_bounds(contents, volume);
        if stack.maps().len() > MAX_MAPS || value_levels.len() > VALUE_LEVELS {
            return Ok(None);
        }
        let stack_group = self.bind_stack(stack, contents.cuts)?;
        let bounds = stack.maps().iter().map(|m| self.bounds_of(&m.map)).collect::<Result<Vec<_>>>()?;
        if bounds.iter().any(|b| b.levels.len() > MAP_LEVELS) {
            return Ok(None);
        }
        let mut uniform = ClassificationUniform::new(cells, contents, &value_levels);
        let mut encoder = self.device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let all: u64 = bounds.iter().map(|b| b.nodes.size()).sum();
        let map_nodes =
            self.scratch_of("bounds of all maps", all.max(size_of::<NodeBounds>() as u64), BufferUsages::STORAGE | BufferUsages::COPY_DST);
        let mut at = 0;
        for (k, b) in bounds.iter().enumerate() {
            uniform.set_map(k, &b.levels, (at / size_of::<NodeBounds>() as u64) as u32, stack.maps()[k].map.has_cuts());
            encoder.copy_buffer_to_buffer(&b.nodes, 0, &map_nodes, at, b.nodes.size());
            at += b.nodes.size();
        }
        let mut visible = Vec::with_capacity(TABLE_ENTRIES + 1);
        visible.push(0u32);
        for entry in contents.table.entries.iter().take(TABLE_ENTRIES) {
            visible.push(visible[visible.len() - 1] + u32::from(entry[3] > 0.0));
        }
        let uniform = self.scratch("classification", bytemuck::bytes_of(&uniform), BufferUsages::UNIFORM);
        let visible = self.scratch("visible entries", bytemuck::cast_slice(&visible), BufferUsages::STORAGE);
        let bytes = u64::from(cells.size.element_product()) * 4;
        let flags = self.scratch_of("flags", bytes, BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let back = self.scratch_of("flags, to read", bytes, BufferUsages::MAP_READ | BufferUsages::COPY_DST);
        let layout = self.layout_of("classification", &[self::uniform(false), storage(true), storage(true), storage(true), storage(false)]);
        let resources = [&uniform, &values, &map_nodes, &visible, &flags].map(|b| b.as_entire_binding());
        let group = self.bind_in_order("classification", &layout, &resources);
        let key = (stack.maps().len(), contents.cuts.primitives().len(), self.strategy.exact_filter);
        let pipeline = {
            let mut cached = self.prepare_cache.cells.lock().unwrap_or_else(PoisonError::into_inner);
            let make = || {
                let constants = [("MAPS", key.0 as f64), ("CUTS", key.1 as f64), ("EXACT", f64::from(u8::from(key.2)))];
                self.compute_pipeline_at(Program::Classify, "classify", false, &[&self.stack_layout(), &layout], &constants)
            };
            cached.entry(key).or_insert_with(make).clone()
        };
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &stack_group, &[]);
            pass.set_bind_group(1, &group, &[]);
            let [x, y, z] = groups(cells.size.to_array());
            pass.dispatch_workgroups(x, y, z);
        }
        encoder.copy_buffer_to_buffer(&flags, 0, &back, 0, bytes);
        self.device.queue.submit([encoder.finish()]);
        let read = read_buffer(&self.device.device, &back)?;
        let numbers: &[u32] = bytemuck::try_cast_slice(&read).map_err(|e| Error::Gpu(format!("reading back failed: {e}")))?;
        let flag = |n: &u32| match n {
            0 => CellState::Empty,
            1 => CellState::Occupied,
            _ => CellState::CutFree,
        };
        Ok(Some(numbers.iter().take(cells.size.element_product() as usize).map(flag).collect()))
    }
}

impl Accelerator for Renderer {
    fn evaluate(&self, stack: &Stack, points: &[Vec3]) -> Result<SourcesAndAlphas> {
        self.evaluate_stack(stack, points)
    }

    fn map(&self, recipe: MapDefinition, watch: &Watch) -> Result<Arc<DisplacementMap>> {
        let Some(formula) = recipe.formula().filter(|_| self.strategy.prepare && self.samples(&recipe)) else {
            return DisplacementMap::of_watched(&recipe, watch).map(Arc::new);
        };
        let made = checked(&self.device.device, || self.sampled_map(&recipe, &formula))?;
        let map = Arc::new(DisplacementMap::from_device(recipe, made.scale, made.whole));
        self.cache_map(&map, made);
        Ok(map)
    }

    fn needs_texels(&self) -> bool {
        !self.strategy.prepare
    }

    fn classify(&self, cells: &CellGrid, contents: &VisibilityCriteria, volume: &VoxelGrid) -> Result<Option<Vec<CellState>>> {
        if !self.strategy.prepare {
            return Ok(None);
        }
        checked(&self.device.device, || self.classified(cells, contents, volume))
    }
}
