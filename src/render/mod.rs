//! Renders a scene on a GPU: view-aligned slices (\[DDM06\] section 4) or rays, on one library of WGSL functions.
//!
//! *Theory*: the shaders in `shaders/` state what `src/cpu` states, function by function. Slices are polygons of plane and proxy box,
//! rasterised back to front and blended by the hardware into a 16-bit float target, premultiplied. Projections (MIP and its kin) blend by
//! maximum or sum, in 32 bits, and pass through the transfer function in a second pass. A composite of very many faint slices (a step of
//! a twentieth of a voxel, say) loses what is below the 16-bit target's resolution; rays, which sum in 32 bits, do not.
//!
//! *How to call it*: a [`Renderer`] owns a device and keeps what outlives a picture: pipelines by variant, the volume's texture as long as
//! the same volume is rendered. Uniforms, maps and tables are per picture.
//!
//! Large pictures are drawn in bands and many slices in batches, each its own submission: a driver that watches for hung commands must
//! not take a long one for it.

mod evaluate;
mod slices;
mod surfaces;
pub mod uniforms;
mod volume;

use crate::deform::cut::MAX_CUTS;
use crate::deform::{DisplacementMap, MAX_MAPS, Stack, Storage};
use crate::gpu::shaders::Program;
use crate::gpu::{Device, checked, read_buffer, read_rgba16f, wait};
use crate::scene::{IsoLight, Mode, Normals, Picture, Prepared, RenderStats, Rendered, Stages};
use crate::transfer::{Blend, GRADIENT_ENTRIES, TABLE_ENTRIES};
use crate::volume::GradientFilter;
use crate::{Error, Result, Watch};
use std::collections::HashMap;
use surfaces::Layer;
use uniforms::{CutShapeUniform, FrameUniform, PlacedMapUniform};
use volume::VolumeTexture;
use wgpu::util::DeviceExt;
use wgpu::{Features, TextureFormat};

/// Pixels per submission of rays.
const PIXELS_PER_BAND: u32 = 1 << 16;
/// Fragments per submission of slices, about.
const FRAGMENTS_PER_BATCH: u64 = 1 << 24;
/// What projections by slices are gathered in: sums of hundreds of samples need more than 16 bits.
const GATHERED: TextureFormat = TextureFormat::Rgba32Float;
/// Counters of `shaders/lib/count.wgsl`.
const COUNTERS: usize = 3 * 1024;

/// What makes a different pipeline.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct Variant {
    program: Program,
    counting: bool,
    maps: usize,
    normals: Normals,
    blend: u32,
    gradient: GradientFilter,
    cuts: usize,
    grey_faces: bool,
    iso: u32,
    behind: bool,
    colors: bool,
}

/// A device with what it has compiled and uploaded.
pub struct Renderer {
    device: Device,
    shared_layout: wgpu::BindGroupLayout,
    sampler: wgpu::Sampler,
    pipelines: HashMap<Variant, wgpu::RenderPipeline>,
    volume: Option<VolumeTexture>,
    /// Smaller limits on the volume than the device's: voxels along an axis, and bytes.
    most: Option<(usize, u64)>,
}

/// What the shaders' shared functions read, uploaded.
struct Shared {
    frame: wgpu::Buffer,
    placed: wgpu::Buffer,
    shapes: wgpu::Buffer,
    table: wgpu::TextureView,
    cells: wgpu::TextureView,
    maps: Vec<wgpu::TextureView>,
    nothing: Layer,
}

/// One picture being drawn.
#[derive(Clone, Copy)]
struct Draw<'a> {
    scene: &'a Prepared<'a>,
    bindings: &'a wgpu::BindGroup,
    behind: Option<&'a Layer>,
    counter: Option<&'a Counter>,
    target: &'a wgpu::Texture,
    watch: &'a Watch<'a>,
}

impl Draw<'_> {
    fn variant(&self, program: Program) -> Variant {
        Renderer::variant(self.scene, program, self.counter.is_some())
    }

    /// Binds the scene, and the counters if samples are counted.
    fn bind(&self, pass: &mut wgpu::RenderPass) {
        pass.set_bind_group(0, self.bindings, &[]);
        if let Some(counter) = self.counter {
            pass.set_bind_group(1, &counter.group, &[]);
        }
    }
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
        Self { device, shared_layout, sampler, pipelines: HashMap::new(), volume: None, most: None }
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Renders a prepared scene; `counting` keeps sample counts, which costs a little. `progress` is told the share that is done.
    ///
    /// # Errors
    /// A volume or picture that the device cannot hold; whatever the device reports.
    pub fn render(&mut self, scene: &Prepared, counting: bool, progress: &(dyn Fn(f32) + Sync)) -> Result<Rendered> {
        self.render_until(scene, counting, &Watch::telling(progress))
    }

    /// As [`Self::render`], until it is told to stop, which it does between two submissions.
    ///
    /// # Errors
    /// As [`Self::render`]; [`Error::Cancelled`].
    pub fn render_until(&mut self, scene: &Prepared, counting: bool, watch: &Watch) -> Result<Rendered> {
        let device = self.device.device.clone();
        checked(&device, || self.render_unchecked(scene, counting, watch))
    }

    fn render_unchecked(&mut self, scene: &Prepared, counting: bool, watch: &Watch) -> Result<Rendered> {
        let mut stages = Stages::default();
        let [width, height] = scene.frame.size;
        let limits = self.device.device.limits();
        if width.max(height) > limits.max_texture_dimension_2d {
            return Err(Error::Gpu(format!(
                "this device makes pictures up to {} pixels wide or high; use --backend cpu",
                limits.max_texture_dimension_2d
            )));
        }
        if scene.settings.mode == Mode::Slice
            && scene.blend != Blend::Composite
            && !self.device.device.features().contains(Features::FLOAT32_BLENDABLE)
        {
            return Err(Error::Gpu(
                "this device cannot blend 32-bit values, which projections by slices need; use --mode raycast or --backend cpu".into(),
            ));
        }
        let shows_volume = scene.settings.mode != Mode::Surface && !scene.frame.proxy.is_empty();
        if !shows_volume && scene.surfaces.objects.is_empty() {
            let pixels = vec![[0.0; 4]; width as usize * height as usize];
            return Ok(Rendered {
                picture: Picture { width, height, pixels }.reduced(scene.settings.antialias),
                stats: Some(RenderStats::default()),
                stages,
                notices: Vec::new(),
            });
        }
        stages.time("upload", || -> Result<()> {
            self.upload_volume(scene.grid, scene.colors)?;
            wait(&self.device.device)
        })?;
        let notices: Vec<String> = self.volume.as_ref().and_then(|v| v.notice.clone()).filter(|_| shows_volume).into_iter().collect();
        let shared = stages.time("bind", || self.shared(scene))?;
        let counter = counting.then(|| Counter::new(&self.device.device));
        let behind = if scene.surfaces.objects.is_empty() {
            None
        } else {
            Some(stages.time("surfaces drawn", || self.draw_surfaces(scene, &shared, counter.as_ref(), watch))?)
        };
        if let (false, Some(layer)) = (shows_volume, &behind) {
            let pixels = stages.time("readback", || read_rgba16f(&self.device.device, &self.device.queue, &layer.color))?;
            let stats = counter.map(|c| c.read(&self.device)).transpose()?;
            return Ok(Rendered { picture: Picture { width, height, pixels }.reduced(scene.settings.antialias), stats, stages, notices });
        }
        let bindings = self.group(&shared, behind.as_ref());
        let target = self.target(width, height, TextureFormat::Rgba16Float);
        stages.time("pipelines", || self.compile(scene, counting));
        let draw = Draw { scene, bindings: &bindings, behind: behind.as_ref(), counter: counter.as_ref(), target: &target, watch };
        stages.time("draw", || match scene.settings.mode {
            Mode::Raycast => self.draw_rays(&draw),
            Mode::Slice => self.draw_slices(&draw),
            Mode::Surface => Ok(()),
        })?;
        let pixels = stages.time("readback", || read_rgba16f(&self.device.device, &self.device.queue, &target))?;
        let stats = counter.map(|c| c.read(&self.device)).transpose()?;
        Ok(Rendered { picture: Picture { width, height, pixels }.reduced(scene.settings.antialias), stats, stages, notices })
    }

    fn variant(scene: &Prepared, program: Program, counting: bool) -> Variant {
        Variant {
            program,
            counting: counting && program != Program::Resolve,
            maps: scene.stack.maps().len(),
            normals: if scene.is_lit() { scene.settings.normals } else { Normals::None },
            blend: match scene.blend {
                Blend::Composite => 0,
                Blend::Mip => 1,
                Blend::Minip => 2,
                Blend::Average => 3,
            },
            gradient: scene.gradient_filter(),
            cuts: scene.cuts.primitives().len(),
            grey_faces: scene.grey_faces(),
            iso: match (scene.iso, scene.settings.iso_light) {
                _ if scene.blend != Blend::Composite => 0,
                (None, _) => 0,
                (Some(_), IsoLight::Gradient) => 1,
                (Some(_), IsoLight::Derivative) => 2,
            },
            colors: scene.colors.is_some(),
            behind: matches!(program, Program::Raycast | Program::Slice | Program::Resolve) && !scene.surfaces.objects.is_empty(),
        }
    }

    fn compile(&mut self, scene: &Prepared, counting: bool) {
        let programs: &[Program] = match (scene.settings.mode, scene.blend) {
            (Mode::Surface, _) => &[],
            (Mode::Raycast, _) => &[Program::Raycast],
            (Mode::Slice, Blend::Composite) => &[Program::Slice],
            (Mode::Slice, _) => &[Program::Slice, Program::Resolve],
        };
        for &program in programs {
            let variant = Self::variant(scene, program, counting);
            if !self.pipelines.contains_key(&variant) {
                let pipeline = self.pipeline(variant);
                self.pipelines.insert(variant, pipeline);
            }
        }
    }

    fn pipeline(&self, variant: Variant) -> wgpu::RenderPipeline {
        let device = &self.device.device;
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(&format!("{:?}", variant.program)),
            source: wgpu::ShaderSource::Wgsl(variant.program.source(variant.counting).into()),
        });
        let constants = overrides(&variant);
        let options = wgpu::PipelineCompilationOptions { constants: &constants, ..Default::default() };
        let over = wgpu::BlendState::PREMULTIPLIED_ALPHA_BLENDING;
        let gather = |operation| {
            let component = wgpu::BlendComponent { src_factor: wgpu::BlendFactor::One, dst_factor: wgpu::BlendFactor::One, operation };
            wgpu::BlendState { color: component, alpha: component }
        };
        let (format, blend) = match (variant.program, variant.blend) {
            (Program::Slice, 0) => (TextureFormat::Rgba16Float, Some(over)),
            (Program::Slice, 3) => (GATHERED, Some(gather(wgpu::BlendOperation::Add))),
            (Program::Slice, _) => (GATHERED, Some(gather(wgpu::BlendOperation::Max))),
            _ => (TextureFormat::Rgba16Float, None),
        };
        let own_layout = match variant.program {
            Program::Resolve => Some(gathered_layout(device)),
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
                buffers: if variant.program == Program::Slice { &buffers } else { &[] },
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: options,
                targets: &[Some(wgpu::ColorTargetState { format, blend, write_mask: wgpu::ColorWrites::ALL })],
            }),
            multiview_mask: None,
            cache: None,
        })
    }

    fn target(&self, width: u32, height: u32, format: TextureFormat) -> wgpu::Texture {
        self.device.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("picture"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                | wgpu::TextureUsages::COPY_SRC
                | wgpu::TextureUsages::COPY_DST
                | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        })
    }

    fn draw_rays(&self, draw: &Draw) -> Result<()> {
        let Draw { scene, target, watch, .. } = *draw;
        let [width, height] = scene.frame.size;
        let pipeline = &self.pipelines[&draw.variant(Program::Raycast)];
        let view = target.create_view(&wgpu::TextureViewDescriptor::default());
        let rows = (PIXELS_PER_BAND / width).clamp(1, height);
        for top in (0..height).step_by(rows as usize) {
            let load = if top == 0 { wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT) } else { wgpu::LoadOp::Load };
            self.pass(&view, load, |pass| {
                pass.set_scissor_rect(0, top, width, rows.min(height - top));
                pass.set_pipeline(pipeline);
                draw.bind(pass);
                pass.draw(0..3, 0..1);
            });
            wait(&self.device.device)?;
            (watch.progress)((top + rows).min(height) as f32 / height as f32);
            watch.check()?;
        }
        Ok(())
    }

    fn draw_slices(&self, draw: &Draw) -> Result<()> {
        let Draw { scene, target, watch, .. } = *draw;
        let device = &self.device.device;
        let [width, height] = scene.frame.size;
        let composite = scene.blend == Blend::Composite;
        let pipeline = &self.pipelines[&draw.variant(Program::Slice)];
        let gathered = (!composite).then(|| self.target(width, height, GATHERED));
        let canvas = gathered.as_ref().unwrap_or(target).create_view(&wgpu::TextureViewDescriptor::default());
        let empty = match scene.blend {
            Blend::Composite | Blend::Average => wgpu::Color::TRANSPARENT,
            // Below every value; green stays 0 where nothing was drawn.
            Blend::Mip | Blend::Minip => wgpu::Color { r: -1e4, ..wgpu::Color::TRANSPARENT },
        };
        let corners = slices::slices(&scene.frame, &scene.macrocells, scene.proxy_mesh.as_deref());
        let batches = batches(&corners, u64::from(width) * u64::from(height));
        self.pass(&canvas, wgpu::LoadOp::Clear(empty), |_| {});
        if let (true, Some(layer)) = (composite, draw.behind) {
            // Slices are blended over what lies behind them.
            let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            encoder.copy_texture_to_texture(layer.color.as_image_copy(), target.as_image_copy(), target.size());
            self.device.queue.submit([encoder.finish()]);
        }
        if !corners.is_empty() {
            let vertices = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("slices"),
                contents: bytemuck::cast_slice(&corners),
                usage: wgpu::BufferUsages::VERTEX,
            });
            for range in batches {
                let end = range.end;
                self.pass(&canvas, wgpu::LoadOp::Load, |pass| {
                    pass.set_pipeline(pipeline);
                    draw.bind(pass);
                    pass.set_vertex_buffer(0, vertices.slice(..));
                    pass.draw(range, 0..1);
                });
                wait(device)?;
                (watch.progress)(end as f32 / corners.len() as f32);
                watch.check()?;
            }
        }
        if composite {
            return Ok(());
        }
        let resolve = &self.pipelines[&draw.variant(Program::Resolve)];
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &gathered_layout(device),
            entries: &[wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&canvas) }],
        });
        let view = target.create_view(&wgpu::TextureViewDescriptor::default());
        self.pass(&view, wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT), |pass| {
            pass.set_pipeline(resolve);
            pass.set_bind_group(0, draw.bindings, &[]);
            pass.set_bind_group(1, &group, &[]);
            pass.draw(0..3, 0..1);
        });
        wait(device)
    }

    /// One pass in one submission.
    fn pass(&self, view: &wgpu::TextureView, load: wgpu::LoadOp<wgpu::Color>, record: impl FnOnce(&mut wgpu::RenderPass)) {
        let mut encoder = self.device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: None,
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
                })],
                depth_stencil_attachment: None,
                timestamp_writes: None,
                occlusion_query_set: None,
                multiview_mask: None,
            });
            record(&mut pass);
        }
        self.device.queue.submit([encoder.finish()]);
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

    fn upload_map(&self, map: &DisplacementMap) -> Result<wgpu::TextureView> {
        let format = match map.storage {
            Storage::F16 => TextureFormat::Rgba16Float,
            Storage::Snorm16 if self.device.device.features().contains(Features::TEXTURE_FORMAT_16BIT_NORM) => TextureFormat::Rgba16Snorm,
            Storage::Snorm16 => TextureFormat::Rgba16Float,
            Storage::Snorm8 => TextureFormat::Rgba8Snorm,
            Storage::F32 if self.device.device.features().contains(Features::FLOAT32_FILTERABLE) => TextureFormat::Rgba32Float,
            Storage::F32 => TextureFormat::Rgba16Float,
        };
        let texture = self.texture_3d("displacement map", map.size, format)?;
        let storage = if format == TextureFormat::Rgba16Float { Storage::F16 } else { map.storage };
        self.write_layers(&texture, 0, &map.encode_as(storage), map.size);
        Ok(texture.create_view(&wgpu::TextureViewDescriptor::default()))
    }

    /// A stack's maps; the bindings that it leaves free get the identity.
    fn upload_maps(&self, stack: &Stack) -> Result<Vec<wgpu::TextureView>> {
        let unused = DisplacementMap::identity([1; 3]);
        (0..MAX_MAPS).map(|k| self.upload_map(stack.maps().get(k).map_or(&unused, |m| &m.map))).collect()
    }

    /// Uploads everything that the shared shader functions read.
    fn shared(&self, scene: &Prepared) -> Result<Shared> {
        let device = &self.device.device;
        let volume = self.volume.as_ref().ok_or_else(|| Error::Gpu("no volume was uploaded".into()))?;
        let frame = FrameUniform::new(scene, volume.scale, volume.offset, volume.spanned);
        let mut placed = [bytemuck::Zeroable::zeroed(); MAX_MAPS];
        for (uniform, map) in placed.iter_mut().zip(scene.stack.maps()) {
            *uniform = PlacedMapUniform::new(map);
        }
        let uniform = |bytes: &[u8]| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents: bytes, usage: wgpu::BufferUsages::UNIFORM })
        };
        let mut shapes = [bytemuck::Zeroable::zeroed(); MAX_CUTS];
        for (shape, cut) in shapes.iter_mut().zip(scene.cuts.primitives()) {
            *shape = CutShapeUniform::new(cut);
        }
        let cells = {
            let size = scene.macrocells.size.to_array().map(|n| n as usize);
            let texture = self.texture_3d("macrocells", size, TextureFormat::R8Uint)?;
            self.write_layers(&texture, 0, &scene.macrocells.distance, size);
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        Ok(Shared {
            frame: uniform(bytemuck::bytes_of(&frame)),
            placed: uniform(bytemuck::cast_slice::<PlacedMapUniform, u8>(&placed)),
            shapes: uniform(bytemuck::cast_slice::<CutShapeUniform, u8>(&shapes)),
            table: self.upload_table(scene),
            cells,
            maps: self.upload_maps(&scene.stack)?,
            nothing: self.layer(1, 1),
        })
    }

    /// The shared bindings, with what lies behind.
    fn group(&self, shared: &Shared, behind: Option<&Layer>) -> wgpu::BindGroup {
        let texture = |binding: u32, view| wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) };
        let buffer = |binding: u32, buffer: &'_ wgpu::Buffer| (binding, buffer.clone());
        let buffers = [buffer(0, &shared.frame), buffer(1, &shared.placed), buffer(14, &shared.shapes)];
        let volume = self.volume.as_ref().map_or(&shared.maps[0], |v| &v.view);
        let colors = self.volume.as_ref().and_then(|v| v.colors.as_ref()).unwrap_or(&shared.maps[0]);
        let [color, distance] = behind.unwrap_or(&shared.nothing).views();
        let mut entries = vec![
            texture(2, volume),
            wgpu::BindGroupEntry { binding: 3, resource: wgpu::BindingResource::Sampler(&self.sampler) },
            texture(4, &shared.table),
            texture(5, &shared.cells),
            texture(15, color),
            texture(16, distance),
            texture(17, colors),
        ];
        entries.extend(buffers.iter().map(|(binding, b)| wgpu::BindGroupEntry { binding: *binding, resource: b.as_entire_binding() }));
        entries.extend(shared.maps.iter().enumerate().map(|(k, view)| texture(6 + k as u32, view)));
        self.device.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some("scene"), layout: &self.shared_layout, entries: &entries })
    }

    /// The shared bindings of a scene with nothing behind.
    fn bind(&self, scene: &Prepared) -> Result<wgpu::BindGroup> {
        Ok(self.group(&self.shared(scene)?, None))
    }

    /// Row 0: colour and optical depth; row 1: gradient factors.
    fn upload_table(&self, scene: &Prepared) -> wgpu::TextureView {
        let mut texels = scene.table.entries.clone();
        texels.resize(2 * TABLE_ENTRIES, [0.0; 4]);
        for (n, factor) in scene.table.gradient.iter().take(GRADIENT_ENTRIES).enumerate() {
            texels[TABLE_ENTRIES + n][0] = *factor;
        }
        let descriptor = wgpu::TextureDescriptor {
            label: Some("transfer function"),
            size: wgpu::Extent3d { width: TABLE_ENTRIES as u32, height: 2, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: TextureFormat::Rgba32Float,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        };
        let texture = self.device.device.create_texture_with_data(
            &self.device.queue,
            &descriptor,
            wgpu::util::TextureDataOrder::LayerMajor,
            bytemuck::cast_slice(&texels),
        );
        texture.create_view(&wgpu::TextureViewDescriptor::default())
    }
}

/// Values of the shaders' `override` constants.
fn overrides(variant: &Variant) -> [(&'static str, f64); 9] {
    let normals = match variant.normals {
        Normals::None => 0.0,
        Normals::Source => 1.0,
        Normals::Transformed => 2.0,
        Normals::Blended => 3.0,
    };
    let gradient = if variant.gradient == GradientFilter::Sobel { 1.0 } else { 0.0 };
    [
        ("MAPS", variant.maps as f64),
        ("NORMALS", normals),
        ("BLEND", f64::from(variant.blend)),
        ("GRADIENT", gradient),
        ("CUTS", variant.cuts as f64),
        ("GREY_FACES", f64::from(u8::from(variant.grey_faces))),
        ("ISO", f64::from(variant.iso)),
        ("COLORS", f64::from(u8::from(variant.colors))),
        ("BEHIND", f64::from(u8::from(variant.behind))),
    ]
}

fn extent(size: [usize; 3]) -> wgpu::Extent3d {
    wgpu::Extent3d { width: size[0] as u32, height: size[1] as u32, depth_or_array_layers: size[2] as u32 }
}

/// Vertex ranges of whole slices, about [`FRAGMENTS_PER_BATCH`] pixels each if every slice filled the picture.
fn batches(corners: &[slices::Corner], pixels: u64) -> Vec<std::ops::Range<u32>> {
    let slices_per_batch = (FRAGMENTS_PER_BATCH / pixels.max(1)).max(1);
    let mut ranges = Vec::new();
    let (mut start, mut count) = (0u32, 0u64);
    for n in 0..corners.len() {
        let ends_slice = n + 1 == corners.len() || corners[n + 1][3] != corners[n][3];
        if ends_slice {
            count += 1;
            if count == slices_per_batch || n + 1 == corners.len() {
                ranges.push(start..n as u32 + 1);
                (start, count) = (n as u32 + 1, 0);
            }
        }
    }
    ranges
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
    entries.extend((0..MAX_MAPS as u32).map(|k| entry(6 + k, texture(filtered, wgpu::TextureViewDimension::D3))));
    entries.push(entry(14, uniform));
    entries.push(entry(17, texture(filtered, wgpu::TextureViewDimension::D3)));
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
struct Counter {
    buffer: wgpu::Buffer,
    group: wgpu::BindGroup,
}

impl Counter {
    fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("counts"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::FRAGMENT,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Storage { read_only: false },
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            }],
        })
    }

    fn new(device: &wgpu::Device) -> Self {
        let buffer = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("counts"),
            contents: &[0; COUNTERS * 4],
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
        });
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("counts"),
            layout: &Self::layout(device),
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() }],
        });
        Self { buffer, group }
    }

    fn read(&self, device: &Device) -> Result<RenderStats> {
        let back = device.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: self.buffer.size(),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&self.buffer, 0, &back, 0, self.buffer.size());
        device.queue.submit([encoder.finish()]);
        let counts: Vec<u32> = bytemuck::pod_collect_to_vec(&read_buffer(&device.device, &back)?);
        let sum = |n: usize| counts.iter().skip(n).step_by(3).map(|&c| u64::from(c)).sum();
        Ok(RenderStats { samples_taken: sum(0), samples_skipped: sum(1), samples_terminated: sum(2) })
    }
}
