//! Maps sampled from their formulas on the device, and bounds on boxes of their texels.

use super::context::{ComputeStep, Context, MapPipelines};
use super::uniforms::{LevelUniform, MapDefinitionUniform, NodeBounds};
use crate::Result;
use crate::deform::{Formula, MapDefinition, Storage, TexelRange};
use crate::gpu::read_buffer;
use crate::gpu::shaders::Program;
use crate::math::pyramid::ChannelRange;
use wgpu::{BufferUsages, TextureFormat};

/// Invocations per workgroup along each axis, as in the shaders.
const GROUP: u32 = 4;
/// Cells of a map's grid along the edge of a finest box, as in `shaders/bounds.wgsl`.
const CELLS_PER_NODE: usize = 4;
/// Largest sample buffer that stays cached, bytes: enough for a map of 128^3 points, and some more.
const MAX_CACHED_SAMPLE_BYTES: u64 = 64 << 20;
/// Alignment of uniforms with a dynamic offset.
const STRIDE: u64 = 256;

impl NodeBounds {
    fn extent(&self) -> TexelRange {
        let nine = |columns: &[[f32; 4]; 3]| std::array::from_fn(|n| columns[n / 3][n % 3]);
        TexelRange {
            texels: ChannelRange {
                min: self.low,
                max: self.high,
            },
            slopes: ChannelRange {
                min: nine(&self.slope_low),
                max: nine(&self.slope_high),
            },
        }
    }
}

/// Bounds on boxes of a map's texels, on the device.
#[derive(Clone)]
pub(super) struct MapBounds {
    pub(super) nodes: wgpu::Buffer,
    /// For each level, the finest first: nodes along each axis, and the index of the first node.
    pub(super) levels: Vec<[u32; 4]>,
}

impl MapBounds {
    /// Their size on the device, bytes.
    pub(super) fn bytes(&self) -> usize {
        self.nodes.size() as usize
    }
}

/// A map sampled on the device.
pub(super) struct SampledMap {
    pub texture: wgpu::Texture,
    pub bounds: MapBounds,
    pub(super) scale: f32,
    pub(super) whole: TexelRange,
}

pub(super) fn storage(read_only: bool) -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Storage { read_only },
        has_dynamic_offset: false,
        min_binding_size: None,
    }
}

pub(super) fn uniform(has_dynamic_offset: bool) -> wgpu::BindingType {
    // A binding with a dynamic offset needs an explicit size.
    let size = std::num::NonZeroU64::new(size_of::<LevelUniform>() as u64).filter(|_| has_dynamic_offset);
    wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset,
        min_binding_size: size,
    }
}

pub(super) fn groups(size: [u32; 3]) -> [u32; 3] {
    size.map(|n| n.div_ceil(GROUP))
}

/// Levels of boxes over a grid of texels, and the total number of boxes.
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

impl Context {
    fn step(&self, program: Program, entry: &str, types: &[wgpu::BindingType]) -> ComputeStep {
        let layout = self.layout_of(entry, types);
        ComputeStep {
            pipeline: self.compute_pipeline_at(program, entry, false, &[&layout], &[]),
            layout,
        }
    }

    fn map_pipelines(&self) -> &MapPipelines {
        self.map_pipelines.get_or_init(|| {
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
                sample: self.step(
                    Program::Sample,
                    "sample",
                    &[uniform(false), storage(false), storage(false)],
                ),
                encode: self.step(
                    Program::Encode,
                    "encode",
                    &[uniform(false), storage(true), storage(true), texels],
                ),
                halve: self.compute_pipeline_at(Program::Bounds, "halve", false, &[&leaves.layout], &[]),
                leaves,
            }
        })
    }

    /// Records the computation of bounds on boxes of a map's texels.
    fn record_bounds(
        &self,
        pass: &mut wgpu::ComputePass,
        size: [usize; 3],
        view: &wgpu::TextureView,
    ) -> MapBounds {
        let pipelines = self.map_pipelines();
        let (levels, count) = levels_of(size);
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        let nodes = self.buffer(
            "bounds of a map",
            u64::from(count) * size_of::<NodeBounds>() as u64,
            usage,
        );
        let mut uniforms = vec![0; levels.len() * STRIDE as usize];
        for (n, &[x, y, z, first]) in levels.iter().enumerate() {
            let [bx, by, bz, below_first] = levels[n.saturating_sub(1)];
            let level = LevelUniform {
                size: [x, y, z],
                first,
                below_size: [bx, by, bz],
                below_first,
            };
            uniforms[n * STRIDE as usize..][..size_of::<LevelUniform>()]
                .copy_from_slice(bytemuck::bytes_of(&level));
        }
        let uniforms = self.scratch("levels", &uniforms, BufferUsages::UNIFORM);
        let of_level = wgpu::BufferBinding {
            buffer: &uniforms,
            offset: 0,
            size: std::num::NonZeroU64::new(size_of::<LevelUniform>() as u64),
        };
        let resources = [
            wgpu::BindingResource::Buffer(of_level),
            nodes.as_entire_binding(),
            wgpu::BindingResource::TextureView(view),
        ];
        let group = self.bind_in_order("bounds of a map", &pipelines.leaves.layout, &resources);
        for (n, &[x, y, z, _]) in levels.iter().enumerate() {
            pass.set_pipeline(if n == 0 {
                &pipelines.leaves.pipeline
            } else {
                &pipelines.halve
            });
            pass.set_bind_group(0, &group, &[n as u32 * STRIDE as u32]);
            let [x, y, z] = groups([x, y, z]);
            pass.dispatch_workgroups(x, y, z);
        }
        MapBounds { nodes, levels }
    }

    /// Bounds on boxes of the texels of a map made by the CPU.
    pub(super) fn bound_texels(&self, size: [usize; 3], view: &wgpu::TextureView) -> MapBounds {
        let mut encoder = self
            .device
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let bounds = {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            self.record_bounds(&mut pass, size, view)
        };
        self.device.queue.submit([encoder.finish()]);
        bounds
    }

    /// Samples a formula into a map.
    pub(super) fn sampled_map(&self, definition: &MapDefinition, formula: &Formula) -> Result<SampledMap> {
        let pipelines = self.map_pipelines();
        let size = definition.size.map(|n| n as u32);
        let points = definition.size.iter().product::<usize>() as u64;
        let usage = wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_SRC;
        let texture = self.texture_3d_for(
            "displacement map",
            definition.size,
            TextureFormat::Rgba16Float,
            usage,
        )?;
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let own = MapDefinitionUniform {
            cube_mm: definition.cube_mm.into(),
            ramp_mm: definition.ramp_mm,
            size,
            kind: formula.kind as u32,
            numbers: formula.numbers,
        };
        let own = self.scratch("definition", bytemuck::bytes_of(&own), BufferUsages::UNIFORM);
        let edge = self.scratch(
            "size of a map",
            bytemuck::bytes_of(&[size[0], size[1], size[2], 0]),
            BufferUsages::UNIFORM,
        );
        let samples = if points * 16 <= MAX_CACHED_SAMPLE_BYTES {
            self.scratch_of("samples", points * 16, BufferUsages::STORAGE)
        } else {
            self.buffer("samples", points * 16, BufferUsages::STORAGE)
        };
        let largest = self.scratch(
            "largest displacement",
            &[0; 16],
            BufferUsages::STORAGE | BufferUsages::COPY_SRC,
        );
        let (own, edge, all, most) = (
            own.as_entire_binding(),
            edge.as_entire_binding(),
            samples.as_entire_binding(),
            largest.as_entire_binding(),
        );
        let sampling = self.bind_in_order(
            "sampling",
            &pipelines.sample.layout,
            &[own, all.clone(), most.clone()],
        );
        let texels = wgpu::BindingResource::TextureView(&view);
        let encoding = self.bind_in_order("encoding", &pipelines.encode.layout, &[edge, all, most, texels]);
        let mut encoder = self
            .device
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let bounds = {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            let [x, y, z] = groups(size);
            for (step, group) in [(&pipelines.sample, &sampling), (&pipelines.encode, &encoding)] {
                pass.set_pipeline(&step.pipeline);
                pass.set_bind_group(0, group, &[]);
                pass.dispatch_workgroups(x, y, z);
            }
            self.record_bounds(&mut pass, definition.size, &view)
        };
        let node = size_of::<NodeBounds>() as u64;
        let back = self.scratch_of(
            "a map's extent, to read",
            node + 16,
            BufferUsages::MAP_READ | BufferUsages::COPY_DST,
        );
        encoder.copy_buffer_to_buffer(&bounds.nodes, bounds.nodes.size() - node, &back, 0, node);
        encoder.copy_buffer_to_buffer(&largest, 0, &back, node, 4);
        self.device.queue.submit([encoder.finish()]);
        let bytes = read_buffer(&self.device.device, &back)?;
        let whole = bytemuck::pod_read_unaligned::<NodeBounds>(&bytes[..node as usize]).extent();
        let scale: f32 = bytemuck::pod_read_unaligned(&bytes[node as usize..][..4]);
        Ok(SampledMap {
            texture,
            bounds,
            scale: if scale > 0.0 { scale } else { 1.0 },
            whole,
        })
    }

    /// Whether sampling a map fits on the device.
    pub(super) fn samples(&self, definition: &MapDefinition) -> bool {
        let limits = self.device.device.limits();
        let bytes = definition.size.iter().product::<usize>() as u64 * 16;
        definition.storage == Storage::F16
            && bytes <= limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }
}
