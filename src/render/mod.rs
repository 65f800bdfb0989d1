//! Renders a scene on a GPU: view-aligned slices (\[DDM06\] section 4), rays, surfaces and triangles, on one library of WGSL functions.
//!
//! *Theory*: the shaders in `shaders/lib` have the arithmetic of `src/cpu`, function by function. Slices are drawn in slabs of 32: a polygon covers
//! 32 planes' sections of the proxy box, a fragment composites their samples in 32 bits, and the hardware blends slabs front to back, under
//! what is there, into a 16-bit float target, premultiplied. Between slabs the pixels that have become opaque get depth 0, and the depth test
//! rejects what would be drawn behind them before it is shaded (Krueger and Westermann 2003). Slices of a mesh are drawn one by one. Projections
//! (MIP and its kin) blend by maximum or sum, in 32 bits, and pass through the transfer function in a second pass.
//!
//! *How to call it*: a [`Renderer`] owns a device and keeps what outlives a picture: pipelines by variant, the volume's texture as
//! long as the same volume is rendered, displacement maps by identity, tables, macrocells, targets, buffers and bind groups. What a picture adds
//! to it is counted ([`Renderer::work`]), and a test (`tests/editing.rs`) holds it to this table:
//!
//! | edit | uploads besides uniforms | made anew |
//! |---|---|---|
//! | nothing, light, camera | none (slicing: its polygons) | nothing |
//! | a surface's look, a solid's place | a solid's cells | nothing |
//! | a surface's mesh, value or labels | its field or triangles, its cells | textures, a bind group |
//! | a placement | macrocells, surfaces' cells | nothing; their texture if the deformed box needs more or fewer cells |
//! | a map's parameter | that map, macrocells, surfaces' cells | the map's texture, a bind group |
//! | transfer function | table, macrocells | nothing |
//! | volume | the volume, and what depends on it | its texture, a bind group |
//! | none: the second picture of a volume | its gradients, if it is lit by them | their texture, bind groups |
//! | size of the picture | none | targets, for the first time; two sizes are kept |
//!
//! What suits one device does not suit another: whether rays are fragments or invocations, who mixes texels, and who prepares scenes is a [`Strategy`].
//! Where the device does ([`Accelerator`](crate::prepare::Accelerator)), a map of a formula is not uploaded but sampled there, and empty space is found there by
//! bounds that are made there: the next picture of an edited map comes several times as fast as with map and cells from the CPU (`benches/HISTORY.md`).
//! What a device keeps for that is counted as well.
//!
//! The gradient volume takes the place of six fetches at each sample that is lit by one; without room for it, or a format that holds it, those are
//! made. It holds values too: behind a visible sample, where the next one is likely to be visible as well, nothing else is fetched. On request passes are timed by the GPU's own clock ([`Renderer::time_passes`]).
//!
//! Large pictures are drawn in bands and many slabs in batches, each its own submission: a driver that watches for hung commands must
//! not take a long one for it. The next submission is recorded while one is under way.

mod atlas;
mod cache;
pub mod constants;
mod draw;
mod evaluate;
mod object;
mod pass_timer;
mod prepare;
mod slices;
mod strategy;
mod surfaces;
mod target;
pub mod uniforms;
mod volume;
mod work;

pub use strategy::Strategy;
pub use work::Work;

use crate::gpu::shaders::Program;
use crate::gpu::{Device, checked, read_buffer, read_rgba16f, texture_bytes, wait};
use crate::picture::{Picture, RenderStats, Rendered, StageTimes};
use crate::prepare::Prepared;
use crate::scene::{IsoLight, Mode, Normals};
use crate::transfer::Blend;
use crate::volume::GradientFilter;
use crate::{Error, Result, Watch};
use cache::SceneCache;
use constants::wgsl_constants;
use draw::Draw;
use pass_timer::PassTimer;
use std::collections::HashMap;
use std::sync::Arc;
use volume::VolumeTexture;
use wgpu::{BufferUsages, Features, TextureFormat};
use work::{ResourceKind, WorkCounters};

/// What projections by slices are gathered in: sums of hundreds of samples need more than 16 bits.
const PROJECTION_FORMAT: TextureFormat = TextureFormat::Rgba32Float;
/// Counters of `shaders/lib/count.wgsl`.
const COUNTERS: usize = 3 * 1024;

/// What makes a different pipeline.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct Variant {
    program: Program,
    counting: bool,
    maps: usize,
    precomposed: bool,
    normals: Normals,
    blend: Blend,
    gradient: GradientFilter,
    slab: u32,
    preintegrated: bool,
    cuts: usize,
    grey_faces: bool,
    iso: Option<IsoLight>,
    behind: bool,
    colors: bool,
    exact: bool,
}

/// A device with what it has compiled and uploaded.
pub struct Renderer {
    device: Device,
    shared_layout: wgpu::BindGroupLayout,
    sampler: wgpu::Sampler,
    strategy: Strategy,
    pipelines: HashMap<Variant, wgpu::RenderPipeline>,
    ray_pipelines: HashMap<Variant, wgpu::ComputePipeline>,
    volume: Option<VolumeTexture>,
    cache: SceneCache,
    prepare_cache: prepare::PrepareCache,
    counter: Option<Counter>,
    clock: Option<Arc<PassTimer>>,
    tally: WorkCounters,
    /// Smaller limits on the volume than the device's: voxels along an axis, and bytes.
    most: Option<(usize, u64)>,
}

impl Renderer {
    /// A renderer on an open device.
    pub fn new(device: Device) -> Self {
        let sampler = device.device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("linear, clamped"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let shared_layout = shared_layout(&device.device);
        Self {
            strategy: Strategy::of(&device),
            device,
            shared_layout,
            sampler,
            pipelines: HashMap::new(),
            ray_pipelines: HashMap::new(),
            volume: None,
            cache: SceneCache::default(),
            prepare_cache: prepare::PrepareCache::default(),
            counter: None,
            clock: None,
            tally: WorkCounters::default(),
            most: None,
        }
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// How pictures are made.
    pub fn strategy(&self) -> Strategy {
        self.strategy
    }

    /// How the next pictures are made, and how the last ones were; a renderer begins with what suits its device.
    pub fn set_strategy(&mut self, strategy: Strategy) -> Strategy {
        std::mem::replace(&mut self.strategy, strategy)
    }

    /// Whether pictures tell how long the GPU drew, by its own clock, where it has one: as a stage of its own, taken out of the one that draws.
    pub fn time_passes(&mut self, on: bool) {
        self.clock = if on { PassTimer::new(&self.device.device, &self.tally).map(Arc::new) } else { None };
    }

    fn restart_clock(&self) {
        if let Some(clock) = &self.clock {
            clock.restart();
        }
    }

    /// What the GPU drew for since [`Self::restart_clock`], by its own clock, milliseconds.
    fn clocked(&self) -> Result<Option<f64>> {
        self.clock.as_ref().map_or(Ok(None), |clock| clock.milliseconds(self))
    }

    /// What was made and uploaded since the renderer was made.
    pub fn work(&self) -> Work {
        self.tally.work()
    }

    /// Renders a prepared scene; `counting` keeps sample counts, which costs a little. It stops between two submissions.
    ///
    /// # Errors
    /// A volume or picture that the device cannot hold; whatever the device reports; [`Error::Cancelled`].
    pub fn render(&mut self, scene: &Prepared, counting: bool, watch: &Watch) -> Result<Rendered> {
        let device = self.device.device.clone();
        checked(&device, || self.render_unchecked(scene, counting, watch))
    }

    fn render_unchecked(&mut self, scene: &Prepared, counting: bool, watch: &Watch) -> Result<Rendered> {
        let mut stages = StageTimes::default();
        let [width, height] = scene.frame.size;
        let limits = self.device.device.limits();
        if width.max(height) > limits.max_texture_dimension_2d {
            return Err(Error::GpuLimit(format!(
                "this GPU renders pictures of at most {} pixels per edge; use a smaller size",
                limits.max_texture_dimension_2d
            )));
        }
        if scene.settings.mode == Mode::Slice
            && scene.volume().blend != Blend::Composite
            && !self.device.device.features().contains(Features::FLOAT32_BLENDABLE)
        {
            return Err(Error::GpuLimit("this GPU cannot blend 32-bit values, which projections by slices need (mode slice, not raycast)".into()));
        }
        let shows_volume = scene.settings.mode != Mode::Surface && !scene.frame.proxy.is_empty();
        if !shows_volume && scene.surfaces.objects.is_empty() {
            let pixels = vec![[0.0; 4]; width as usize * height as usize];
            let picture = Picture { width, height, pixels }.reduced(scene.settings.antialias);
            return Ok(scene.rendered(picture, Some(RenderStats::default()), stages, Vec::new()));
        }
        stages.time("upload", || -> Result<()> {
            self.upload_volume(scene.volume().grid, scene.volume().colors)?;
            if shows_volume {
                self.upload_gradients(scene)?;
            }
            wait(&self.device.device)
        })?;
        let reduced: Vec<String> = self.volume.as_ref().and_then(|v| v.notice.clone()).filter(|_| shows_volume).into_iter().collect();
        let shared = stages.time("bind", || self.shared(scene))?;
        let counter = counting.then(|| self.fresh_counter());
        let behind = if scene.surfaces.objects.is_empty() {
            self.forget_large_fields();
            None
        } else {
            self.restart_clock();
            let drawn = stages.time("surfaces drawn", || self.draw_surfaces(scene, &shared, counter.as_ref(), watch))?;
            if let Some(drawing) = self.clocked()? {
                stages.divide("surfaces drawn", "surfaces drawn (GPU time)", drawing);
            }
            Some(drawn)
        };
        let target = if let (false, Some(layer)) = (shows_volume, &behind) {
            layer.color.clone()
        } else {
            let bindings = self.group(&shared, behind.as_ref());
            let target = self.target("picture", width, height, TextureFormat::Rgba16Float);
            stages.time("pipelines", || self.compile(scene, counting));
            let clock = self.clock.clone();
            let draw = Draw {
                scene,
                bindings: &bindings,
                behind: behind.as_ref(),
                counter: counter.as_ref(),
                target: &target,
                watch,
                clock: clock.as_deref(),
            };
            self.restart_clock();
            stages.time("draw", || match scene.settings.mode {
                Mode::Raycast => self.draw_rays(&draw),
                Mode::Slice => self.draw_slices(&draw),
                Mode::Surface => Ok(()),
            })?;
            if let Some(drawing) = self.clocked()? {
                stages.divide("draw", "draw (GPU time)", drawing);
            }
            target.texture
        };
        let pixels = stages.time("readback", || {
            let buffer = self.readback(texture_bytes(&target));
            read_rgba16f(&self.device.device, &self.device.queue, &target, &buffer)
        })?;
        let stats = counter.map(|c| c.read(self)).transpose()?;
        let picture = Picture { width, height, pixels }.reduced(scene.settings.antialias);
        Ok(scene.rendered(picture, stats, stages, reduced))
    }

    /// The counters, at zero.
    fn fresh_counter(&mut self) -> Counter {
        if let Some(counter) = &self.counter {
            self.device.queue.write_buffer(&counter.buffer, 0, &[0; COUNTERS * 4]);
            return counter.clone();
        }
        let counter = Counter::new(self);
        self.counter.insert(counter).clone()
    }

    fn variant(&self, scene: &Prepared, program: Program, counting: bool) -> Variant {
        let march = matches!(program, Program::Raycast | Program::RaycastCompute | Program::Slice);
        Variant {
            program,
            exact: self.strategy.exact_filter,
            counting: counting && (march || program == Program::Surface),
            maps: scene.stack.maps().len(),
            precomposed: scene.stack.precomposed().is_some(),
            normals: if scene.is_lit() { scene.settings.normals } else { Normals::None },
            blend: scene.volume().blend,
            gradient: scene.gradient_filter(),
            slab: if program != Program::Slice || scene.proxy_mesh.is_some() { 1 } else { slices::SLICES_PER_SLAB as u32 },
            cuts: scene.cuts.primitives().len(),
            grey_faces: scene.grey_faces(),
            iso: scene.volume().iso.filter(|_| scene.volume().blend == Blend::Composite).map(|_| scene.settings.iso_light),
            colors: scene.volume().colors.is_some(),
            preintegrated: scene.preintegrated() && march,
            behind: (march || matches!(program, Program::Resolve | Program::SurfacesBehind)) && !scene.surfaces.objects.is_empty(),
        }
    }

    fn compile(&mut self, scene: &Prepared, counting: bool) {
        let mut programs = match (scene.settings.mode, scene.volume().blend) {
            (Mode::Surface, _) => vec![],
            (Mode::Raycast, _) => vec![self.strategy.rays()],
            (Mode::Slice, Blend::Composite) => vec![Program::Slice, Program::Opaque],
            (Mode::Slice, _) => vec![Program::Slice, Program::Resolve],
        };
        if scene.settings.mode == Mode::Slice && scene.volume().blend == Blend::Composite && !scene.surfaces.objects.is_empty() {
            programs.push(Program::SurfacesBehind);
        }
        for program in programs {
            let variant = self.variant(scene, program, counting);
            if program == Program::RaycastCompute {
                if !self.ray_pipelines.contains_key(&variant) {
                    let pipeline = self.ray_pipeline(variant);
                    self.ray_pipelines.insert(variant, pipeline);
                }
            } else if !self.pipelines.contains_key(&variant) {
                let pipeline = self.pipeline(variant);
                self.pipelines.insert(variant, pipeline);
            }
        }
    }

    fn pipeline(&self, variant: Variant) -> wgpu::RenderPipeline {
        self.tally.count(ResourceKind::Pipeline);
        let device = &self.device.device;
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(&format!("{:?}", variant.program)),
            source: wgpu::ShaderSource::Wgsl(variant.program.source(wgsl_constants(), variant.counting).into()),
        });
        let constants = overrides(&variant);
        let options = wgpu::PipelineCompilationOptions { constants: &constants, ..Default::default() };
        // Front to back: what comes is seen through what is there.
        let through = wgpu::BlendComponent {
            src_factor: wgpu::BlendFactor::OneMinusDstAlpha,
            dst_factor: wgpu::BlendFactor::One,
            operation: wgpu::BlendOperation::Add,
        };
        let under = wgpu::BlendState { color: through, alpha: through };
        let gather = |operation| {
            let component = wgpu::BlendComponent { src_factor: wgpu::BlendFactor::One, dst_factor: wgpu::BlendFactor::One, operation };
            wgpu::BlendState { color: component, alpha: component }
        };
        let (format, blend) = match (variant.program, variant.blend) {
            (Program::Slice | Program::SurfacesBehind, Blend::Composite) => (TextureFormat::Rgba16Float, Some(under)),
            (Program::Slice, Blend::Average) => (PROJECTION_FORMAT, Some(gather(wgpu::BlendOperation::Add))),
            (Program::Slice, _) => (PROJECTION_FORMAT, Some(gather(wgpu::BlendOperation::Max))),
            _ => (TextureFormat::Rgba16Float, None),
        };
        let masked = matches!((variant.program, variant.blend), (Program::Slice, Blend::Composite) | (Program::Opaque, _));
        let has_corners = matches!(variant.program, Program::Slice | Program::Opaque);
        let color = [Some(wgpu::ColorTargetState { format, blend, write_mask: wgpu::ColorWrites::ALL })];
        let own_layout = match variant.program {
            Program::Resolve | Program::Opaque => Some(gathered_layout(device)),
            _ if variant.counting => Some(Counter::layout(device)),
            _ => None,
        };
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(&self.shared_layout), own_layout.as_ref()],
            immediate_size: 0,
        });
        let corner = wgpu::VertexBufferLayout {
            array_stride: size_of::<slices::Corner>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &wgpu::vertex_attr_array![0 => Float32x4],
        };
        let buffers = [Some(corner)];
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(&format!("{:?}", variant.program)),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: options.clone(),
                buffers: if has_corners { &buffers } else { &[] },
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: masked.then(|| wgpu::DepthStencilState {
                format: draw::MASK,
                depth_write_enabled: Some(variant.program == Program::Opaque),
                depth_compare: Some(wgpu::CompareFunction::Less),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: options,
                targets: if variant.program == Program::Opaque { &[] } else { &color },
            }),
            multiview_mask: None,
            cache: None,
        })
    }

    /// Copies whole layers into a 3D texture.
    pub(super) fn write_layers(&self, texture: &wgpu::Texture, first_layer: usize, bytes: &[u8], size: [usize; 3]) {
        let texel = texture.format().block_copy_size(None).unwrap_or(4) as usize;
        let layers = bytes.len() / (size[0] * size[1] * texel);
        self.device.queue.write_texture(
            wgpu::TexelCopyTextureInfo { origin: wgpu::Origin3d { x: 0, y: 0, z: first_layer as u32 }, ..texture.as_image_copy() },
            bytes,
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some((size[0] * texel) as u32), rows_per_image: Some(size[1] as u32) },
            extent([size[0], size[1], layers]),
        );
    }
}

/// Values of the shaders' `override` constants.
fn overrides(variant: &Variant) -> [(&'static str, f64); 13] {
    [
        ("MAPS", variant.maps as f64),
        ("PRECOMPOSED", f64::from(u8::from(variant.precomposed))),
        ("NORMALS", f64::from(variant.normals as u32)),
        ("BLEND", f64::from(variant.blend as u32)),
        ("GRADIENT", f64::from(variant.gradient as u32)),
        ("SLAB", f64::from(variant.slab)),
        ("PREINTEGRATED", f64::from(u8::from(variant.preintegrated))),
        ("CUTS", variant.cuts as f64),
        ("GREY_FACES", f64::from(u8::from(variant.grey_faces))),
        ("ISO", f64::from(constants::iso(variant.iso))),
        ("COLORS", f64::from(u8::from(variant.colors))),
        ("BEHIND", f64::from(u8::from(variant.behind))),
        ("EXACT", f64::from(u8::from(variant.exact))),
    ]
}

fn extent(size: [usize; 3]) -> wgpu::Extent3d {
    wgpu::Extent3d { width: size[0] as u32, height: size[1] as u32, depth_or_array_layers: size[2] as u32 }
}

fn shared_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let stages = wgpu::ShaderStages::VERTEX_FRAGMENT | wgpu::ShaderStages::COMPUTE;
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry { binding, visibility: stages, ty, count: None };
    let uniform = wgpu::BindingType::Buffer { ty: wgpu::BufferBindingType::Uniform, has_dynamic_offset: false, min_binding_size: None };
    let texture = |sample_type, view_dimension| wgpu::BindingType::Texture { sample_type, view_dimension, multisampled: false };
    let filtered = wgpu::TextureSampleType::Float { filterable: true };
    let mut entries = vec![
        entry(0, uniform),
        entry(1, uniform),
        entry(2, texture(filtered, wgpu::TextureViewDimension::D3)),
        entry(3, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
        entry(4, texture(wgpu::TextureSampleType::Float { filterable: false }, wgpu::TextureViewDimension::D2)),
        entry(5, texture(wgpu::TextureSampleType::Uint, wgpu::TextureViewDimension::D3)),
    ];
    entries.extend([6, 7].map(|n| entry(n, texture(filtered, wgpu::TextureViewDimension::D3))));
    entries.push(entry(14, uniform));
    entries.push(entry(17, texture(filtered, wgpu::TextureViewDimension::D3)));
    entries.push(entry(18, texture(filtered, wgpu::TextureViewDimension::D2)));
    entries.push(entry(19, texture(filtered, wgpu::TextureViewDimension::D3)));
    let unfiltered = wgpu::TextureSampleType::Float { filterable: false };
    entries.extend([15, 16].map(|n| entry(n, texture(unfiltered, wgpu::TextureViewDimension::D2))));
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("scene"), entries: &entries })
}

fn gathered_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("gathered"),
        entries: &[wgpu::BindGroupLayoutEntry {
            binding: 1,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty: wgpu::BindingType::Texture {
                sample_type: wgpu::TextureSampleType::Float { filterable: false },
                view_dimension: wgpu::TextureViewDimension::D2,
                multisampled: false,
            },
            count: None,
        }],
    })
}

/// The sample counters.
#[derive(Clone)]
struct Counter {
    buffer: wgpu::Buffer,
    back: wgpu::Buffer,
    group: wgpu::BindGroup,
}

impl Counter {
    const ENTRY: wgpu::BindGroupLayoutEntry = wgpu::BindGroupLayoutEntry {
        binding: 0,
        visibility: wgpu::ShaderStages::FRAGMENT.union(wgpu::ShaderStages::COMPUTE),
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Storage { read_only: false },
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    };

    fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("counts"), entries: &[Self::ENTRY] })
    }

    fn new(renderer: &Renderer) -> Self {
        let buffer = renderer.buffer_of("counts", &[0; COUNTERS * 4], BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let back = renderer.buffer("counts, to read", buffer.size(), BufferUsages::MAP_READ | BufferUsages::COPY_DST);
        let entry = wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() };
        let group = renderer.bind_group("counts", &Self::layout(&renderer.device.device), &[entry]);
        Self { buffer, back, group }
    }

    fn read(&self, renderer: &Renderer) -> Result<RenderStats> {
        let device = &renderer.device;
        let mut encoder = device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&self.buffer, 0, &self.back, 0, self.buffer.size());
        device.queue.submit([encoder.finish()]);
        let counts: Vec<u32> = bytemuck::pod_collect_to_vec(&read_buffer(&device.device, &self.back)?);
        let sum = |n: usize| counts.iter().skip(n).step_by(3).map(|&c| u64::from(c)).sum();
        Ok(RenderStats { samples_taken: sum(0), samples_skipped: sum(1), samples_terminated: sum(2) })
    }
}
