//! Render targets.

use super::context::Context;
use super::counter::{COUNTERS, Counter};
use wgpu::{BufferUsages, TextureFormat, TextureUsages};

/// Format in which projections by slices are accumulated: sums of hundreds of samples need more
/// than 16 bits.
pub(super) const PROJECTION_FORMAT: TextureFormat = TextureFormat::Rgba32Float;
/// Depth format of a layer, for the test between objects.
pub(super) const DEPTH: TextureFormat = TextureFormat::Depth32Float;
/// Depth format of the mask of opaque pixels.
pub(super) const MASK: TextureFormat = TextureFormat::Depth32Float;

/// A corner of a slice's triangle: position in world mm, and the index of the slab's nearest slice.
pub(super) type Corner = [f32; 4];

/// A texture with its view.
#[derive(Clone, PartialEq)]
pub(super) struct RenderTexture {
    pub texture: wgpu::Texture,
    pub view: wgpu::TextureView,
}

impl RenderTexture {
    pub(super) fn new(texture: wgpu::Texture) -> Self {
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        Self { texture, view }
    }
}

/// The targets of surfaces.
#[derive(Clone)]
pub(super) struct Layer {
    /// Colour, premultiplied.
    pub color: wgpu::Texture,
    pub(super) color_view: wgpu::TextureView,
    /// Distance along each pixel's ray, mm.
    pub distance: wgpu::Texture,
    pub(super) distance_view: wgpu::TextureView,
    pub(super) depth_view: wgpu::TextureView,
}

impl Layer {
    pub(super) fn views(&self) -> [&wgpu::TextureView; 2] {
        [&self.color_view, &self.distance_view]
    }
}

/// Number of cached targets per purpose: a live view alternates between a coarse and a fine
/// picture.
const MAX_CACHED_SIZES: usize = 2;

/// Resources of picture sizes, and buffers that grow with them.
#[derive(Default)]
pub(super) struct Targets {
    /// By purpose, the most recently used last.
    targets: Vec<(&'static str, RenderTexture)>,
    readback: Option<wgpu::Buffer>,
    vertices: Option<wgpu::Buffer>,
    counter: Option<Counter>,
}

impl Targets {
    /// A 2D texture to draw into and to read, cached by purpose, size and format. Its content is
    /// unchanged.
    pub(super) fn target(
        &mut self,
        context: &Context,
        purpose: &'static str,
        width: u32,
        height: u32,
        format: TextureFormat,
    ) -> RenderTexture {
        let fits = |t: &RenderTexture| {
            (t.texture.width(), t.texture.height(), t.texture.format()) == (width, height, format)
        };
        let targets = &mut self.targets;
        if let Some(at) = targets.iter().position(|(p, t)| *p == purpose && fits(t)) {
            let found = targets.remove(at);
            let target = found.1.clone();
            targets.push(found);
            return target;
        }
        let mut same = targets
            .iter()
            .enumerate()
            .filter(|(_, (p, _))| *p == purpose)
            .map(|(n, _)| n);
        if let (Some(oldest), others) = (same.next(), same.count())
            && others + 1 >= MAX_CACHED_SIZES
        {
            targets.remove(oldest);
            context.forget_groups();
        }
        let storable = format == TextureFormat::Rgba16Float && context.device.computes();
        let target = RenderTexture::new(context.texture(&wgpu::TextureDescriptor {
            label: Some(purpose),
            size: wgpu::Extent3d {
                width,
                height,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: TextureUsages::RENDER_ATTACHMENT
                | TextureUsages::COPY_SRC
                | TextureUsages::COPY_DST
                | TextureUsages::TEXTURE_BINDING
                | if storable {
                    TextureUsages::STORAGE_BINDING
                } else {
                    TextureUsages::empty()
                },
            view_formats: &[],
        }));
        self.targets.push((purpose, target.clone()));
        target
    }

    /// A readback buffer, cached until a picture is larger.
    pub(super) fn readback(&mut self, context: &Context, size: u64) -> wgpu::Buffer {
        match &self.readback {
            Some(buffer) if buffer.size() >= size => buffer.clone(),
            _ => {
                let buffer =
                    context.buffer("readback", size, BufferUsages::COPY_DST | BufferUsages::MAP_READ);
                self.readback.insert(buffer).clone()
            }
        }
    }

    /// Corners of slices, in a growing buffer.
    pub(super) fn slice_vertices(&mut self, context: &Context, contents: &[u8]) -> wgpu::Buffer {
        match &self.vertices {
            Some(buffer) if buffer.size() >= contents.len() as u64 => {
                context.device.queue.write_buffer(buffer, 0, contents);
                buffer.clone()
            }
            _ => {
                let size = (contents.len() as u64).next_power_of_two().max(1 << 14);
                let buffer = context.buffer("slices", size, BufferUsages::VERTEX | BufferUsages::COPY_DST);
                context.device.queue.write_buffer(&buffer, 0, contents);
                self.vertices.insert(buffer).clone()
            }
        }
    }

    /// The counters, reset to zero.
    pub(super) fn fresh_counter(&mut self, context: &Context) -> Counter {
        if let Some(counter) = &self.counter {
            context
                .device
                .queue
                .write_buffer(&counter.buffer, 0, &[0; COUNTERS * 4]);
            return counter.clone();
        }
        let counter = Counter::new(context);
        self.counter.insert(counter).clone()
    }

    /// A layer for a purpose: its colour, distance and depth by name. Its content is unchanged.
    pub(super) fn layer(
        &mut self,
        context: &Context,
        purpose: [&'static str; 3],
        width: u32,
        height: u32,
    ) -> Layer {
        let color = self.target(context, purpose[0], width, height, TextureFormat::Rgba16Float);
        let distance = self.target(context, purpose[1], width, height, TextureFormat::R32Float);
        let depth = self.target(context, purpose[2], width, height, DEPTH);
        Layer {
            color: color.texture,
            color_view: color.view,
            distance: distance.texture,
            distance_view: distance.view,
            depth_view: depth.view,
        }
    }
}
