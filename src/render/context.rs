//! Resources independent of what is drawn: layouts, pipelines by variant, buffers overwritten at
//! every use, and the bind groups of resources that outlive a picture.

use super::constants::wgsl_constants;
use super::strategy::Strategy;
use super::variant::Variant;
use super::work::{ResourceKind, WorkCounters};
use crate::gpu::Device;
use crate::gpu::shaders::Program;
use crate::{Error, Result};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use wgpu::{BufferUsages, TextureFormat};

/// Maximum number of cached bind groups: without a layer behind, with each layer of surfaces, and
/// those of targets.
const MAX_CACHED_BIND_GROUPS: usize = 8;

/// A device with the resources that do not depend on a scene.
pub(super) struct Context {
    pub device: Device,
    pub shared_layout: wgpu::BindGroupLayout,
    pub sampler: wgpu::Sampler,
    pub strategy: Strategy,
    pub tally: WorkCounters,
    pub pipelines: Mutex<HashMap<Variant, wgpu::RenderPipeline>>,
    pub ray_pipelines: Mutex<HashMap<Variant, wgpu::ComputePipeline>>,
    pub map_pipelines: OnceLock<MapPipelines>,
    /// By the numbers of maps and shapes, and by whether the shader interpolates texels.
    pub classify_pipelines: Mutex<HashMap<(usize, usize, bool), wgpu::ComputePipeline>>,
    groups: Mutex<Vec<CachedBindGroup>>,
    /// The texts of volumes' functions, under the numbers by which pipelines name them.
    pub functions: Mutex<HashMap<u64, Arc<str>>>,
    /// By purpose: buffers that are rewritten for every use and grow.
    scratch: Mutex<Vec<(&'static str, wgpu::Buffer)>>,
}

/// A bind group with its purpose and the views that it binds.
struct CachedBindGroup {
    purpose: &'static str,
    views: Vec<wgpu::TextureView>,
    group: wgpu::BindGroup,
}

/// Entries of a cache are only added as a whole, hence a poisoned lock is safe to use.
pub(super) fn lock<T>(m: &Mutex<T>) -> MutexGuard<'_, T> {
    m.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A pipeline with its bind group layout.
pub(super) struct ComputeStep {
    pub pipeline: wgpu::ComputePipeline,
    pub layout: wgpu::BindGroupLayout,
}

/// The pipelines that sample maps and bound their texels.
pub(super) struct MapPipelines {
    pub sample: ComputeStep,
    pub encode: ComputeStep,
    /// The layout of `leaves` and `halve`.
    pub leaves: ComputeStep,
    pub halve: wgpu::ComputePipeline,
}

impl Context {
    /// The context of an open device.
    pub fn new(device: Device) -> Self {
        let sampler = device.device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("linear, clamped"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        Self {
            strategy: Strategy::of(&device),
            shared_layout: shared_layout(&device.device),
            device,
            sampler,
            tally: WorkCounters::default(),
            pipelines: Mutex::default(),
            ray_pipelines: Mutex::default(),
            map_pipelines: OnceLock::new(),
            classify_pipelines: Mutex::default(),
            groups: Mutex::default(),
            functions: Mutex::default(),
            scratch: Mutex::default(),
        }
    }

    /// Creates a counted buffer.
    pub(super) fn buffer(&self, label: &str, size: u64, usage: BufferUsages) -> wgpu::Buffer {
        self.tally.count(ResourceKind::Buffer);
        self.device.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    /// Creates a counted buffer with content.
    pub(super) fn buffer_of(&self, label: &str, contents: &[u8], usage: BufferUsages) -> wgpu::Buffer {
        let buffer = self.buffer(
            label,
            (contents.len() as u64).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT),
            usage | BufferUsages::COPY_DST,
        );
        self.device.queue.write_buffer(&buffer, 0, contents);
        buffer
    }

    /// Creates a counted bind group.
    pub(super) fn bind_group(
        &self,
        label: &str,
        layout: &wgpu::BindGroupLayout,
        entries: &[wgpu::BindGroupEntry],
    ) -> wgpu::BindGroup {
        self.tally.count(ResourceKind::BindGroup);
        self.device.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(label),
            layout,
            entries,
        })
    }

    /// Creates a counted texture.
    pub(super) fn texture(&self, descriptor: &wgpu::TextureDescriptor) -> wgpu::Texture {
        self.tally.count(ResourceKind::Texture);
        self.device.device.create_texture(descriptor)
    }

    /// A cached buffer for a purpose, with new content; overwritten at the next use.
    pub(super) fn scratch(
        &self,
        purpose: &'static str,
        contents: &[u8],
        usage: BufferUsages,
    ) -> wgpu::Buffer {
        let buffer = self.scratch_of(purpose, contents.len() as u64, usage | BufferUsages::COPY_DST);
        self.device.queue.write_buffer(&buffer, 0, contents);
        buffer
    }

    /// A cached buffer for a purpose, of at least a given size; its content is unchanged.
    pub(super) fn scratch_of(&self, purpose: &'static str, size: u64, usage: BufferUsages) -> wgpu::Buffer {
        let mut cached = lock(&self.scratch);
        if let Some((_, buffer)) = cached.iter().find(|(p, b)| *p == purpose && b.size() >= size) {
            return buffer.clone();
        }
        cached.retain(|(p, _)| *p != purpose);
        let buffer = self.buffer(purpose, size.next_multiple_of(16), usage);
        cached.push((purpose, buffer.clone()));
        buffer
    }

    /// A cached bind group, by its purpose and the views that it binds (by binding number); its
    /// other resources must stay the same.
    pub(super) fn cached_bind_group(
        &self,
        purpose: &'static str,
        layout: &wgpu::BindGroupLayout,
        views: Vec<(u32, wgpu::TextureView)>,
        others: &[(u32, wgpu::BindingResource)],
    ) -> wgpu::BindGroup {
        let key: Vec<wgpu::TextureView> = views.iter().map(|(_, view)| view.clone()).collect();
        let mut groups = lock(&self.groups);
        if let Some(found) = groups.iter().find(|g| g.purpose == purpose && g.views == key) {
            return found.group.clone();
        }
        let of_views = views
            .iter()
            .map(|(n, view)| (*n, wgpu::BindingResource::TextureView(view)));
        let entries: Vec<_> = of_views
            .chain(others.iter().cloned())
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        self.tally.count(ResourceKind::BindGroup);
        let group = self.device.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(purpose),
            layout,
            entries: &entries,
        });
        if groups.len() >= MAX_CACHED_BIND_GROUPS {
            groups.remove(0);
        }
        groups.push(CachedBindGroup {
            purpose,
            views: key,
            group: group.clone(),
        });
        group
    }

    /// An empty 3D texture.
    pub(super) fn texture_3d(
        &self,
        label: &str,
        size: [usize; 3],
        format: TextureFormat,
    ) -> Result<wgpu::Texture> {
        self.texture_3d_for(label, size, format, wgpu::TextureUsages::COPY_DST)
    }

    /// The same with a given usage.
    pub(super) fn texture_3d_for(
        &self,
        label: &str,
        size: [usize; 3],
        format: TextureFormat,
        usage: wgpu::TextureUsages,
    ) -> Result<wgpu::Texture> {
        let most = self.device.device.limits().max_texture_dimension_3d as usize;
        if size.iter().any(|&n| n > most) {
            return Err(Error::GpuLimit(format!(
                "the {label} of {} x {} x {} exceeds this GPU's {most} per axis",
                size[0], size[1], size[2]
            )));
        }
        Ok(self.texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: extent(size),
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D3,
            format,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | usage,
            view_formats: &[],
        }))
    }

    pub(super) fn encoder(&self) -> wgpu::CommandEncoder {
        self.device
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// A pipeline for the entry point `main` of a program, with its layouts.
    pub(super) fn compute_pipeline(
        &self,
        program: Program,
        counting: bool,
        layouts: [&wgpu::BindGroupLayout; 2],
        constants: &[(&str, f64)],
    ) -> wgpu::ComputePipeline {
        self.compute_pipeline_at(program, "main", counting, &layouts, constants)
    }

    /// A pipeline for one of a program's entry points.
    pub(super) fn compute_pipeline_at(
        &self,
        program: Program,
        entry: &str,
        counting: bool,
        layouts: &[&wgpu::BindGroupLayout],
        constants: &[(&str, f64)],
    ) -> wgpu::ComputePipeline {
        self.compute_pipeline_of(
            &self.module_of(program, counting, None),
            entry,
            layouts,
            constants,
        )
    }

    /// The shader of a program, with a volume's function by its number.
    pub(super) fn module_of(
        &self,
        program: Program,
        counting: bool,
        function: Option<u64>,
    ) -> wgpu::ShaderModule {
        let function = function.and_then(|number| lock(&self.functions).get(&number).cloned());
        let text = program.source(wgsl_constants(), counting, function.as_deref());
        self.device
            .device
            .create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(&format!("{program:?}")),
                source: wgpu::ShaderSource::Wgsl(text.into()),
            })
    }

    /// A pipeline for one of a shader's entry points.
    pub(super) fn compute_pipeline_of(
        &self,
        module: &wgpu::ShaderModule,
        entry: &str,
        layouts: &[&wgpu::BindGroupLayout],
        constants: &[(&str, f64)],
    ) -> wgpu::ComputePipeline {
        self.tally.count(ResourceKind::Pipeline);
        let device = &self.device.device;
        let layouts: Vec<_> = layouts.iter().copied().map(Some).collect();
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &layouts,
            immediate_size: 0,
        });
        device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry),
            layout: Some(&layout),
            module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants,
                ..Default::default()
            },
            cache: None,
        })
    }

    pub(super) fn layout_of(&self, label: &str, types: &[wgpu::BindingType]) -> wgpu::BindGroupLayout {
        let entry = |(n, ty): (usize, &wgpu::BindingType)| wgpu::BindGroupLayoutEntry {
            binding: n as u32,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: *ty,
            count: None,
        };
        let entries: Vec<_> = types.iter().enumerate().map(entry).collect();
        self.device
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(label),
                entries: &entries,
            })
    }

    /// A bind group of resources in order.
    pub(super) fn bind_in_order(
        &self,
        label: &str,
        layout: &wgpu::BindGroupLayout,
        resources: &[wgpu::BindingResource],
    ) -> wgpu::BindGroup {
        let entries: Vec<_> = resources
            .iter()
            .enumerate()
            .map(|(n, r)| wgpu::BindGroupEntry {
                binding: n as u32,
                resource: r.clone(),
            })
            .collect();
        self.bind_group(label, layout, &entries)
    }

    /// Copies whole layers into a 3D texture, or the only one into a 2D texture.
    pub(super) fn write_layers(
        &self,
        texture: &wgpu::Texture,
        first_layer: usize,
        bytes: &[u8],
        size: [usize; 3],
    ) {
        let texel = texture.format().block_copy_size(None).unwrap_or(4) as usize;
        let layers = bytes.len() / (size[0] * size[1] * texel);
        self.device.queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                origin: wgpu::Origin3d {
                    x: 0,
                    y: 0,
                    z: first_layer as u32,
                },
                ..texture.as_image_copy()
            },
            bytes,
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some((size[0] * texel) as u32),
                rows_per_image: Some(size[1] as u32),
            },
            extent([size[0], size[1], layers]),
        );
    }

    /// Drops the cached bind groups: they would keep replaced textures alive.
    pub(super) fn forget_groups(&self) {
        lock(&self.groups).clear();
    }
}

pub(super) fn extent(size: [usize; 3]) -> wgpu::Extent3d {
    wgpu::Extent3d {
        width: size[0] as u32,
        height: size[1] as u32,
        depth_or_array_layers: size[2] as u32,
    }
}

/// A binding of a uniform buffer.
pub(super) const UNIFORM: wgpu::BindingType = wgpu::BindingType::Buffer {
    ty: wgpu::BufferBindingType::Uniform,
    has_dynamic_offset: false,
    min_binding_size: None,
};

/// Makes entries of a layout that these stages of a program see.
pub(super) fn layout_entries(
    visibility: wgpu::ShaderStages,
) -> impl Fn(u32, wgpu::BindingType) -> wgpu::BindGroupLayoutEntry {
    move |binding, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty,
        count: None,
    }
}

fn shared_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let stages = wgpu::ShaderStages::VERTEX_FRAGMENT | wgpu::ShaderStages::COMPUTE;
    let entry = layout_entries(stages);
    let texture = |sample_type, view_dimension| wgpu::BindingType::Texture {
        sample_type,
        view_dimension,
        multisampled: false,
    };
    let filtered = wgpu::TextureSampleType::Float { filterable: true };
    let mut entries = vec![
        entry(0, UNIFORM),
        entry(1, UNIFORM),
        entry(2, texture(filtered, wgpu::TextureViewDimension::D3)),
        entry(3, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
        entry(
            4,
            texture(
                wgpu::TextureSampleType::Float { filterable: false },
                wgpu::TextureViewDimension::D2,
            ),
        ),
        entry(
            5,
            texture(wgpu::TextureSampleType::Uint, wgpu::TextureViewDimension::D3),
        ),
    ];
    entries.extend([6, 7].map(|n| entry(n, texture(filtered, wgpu::TextureViewDimension::D3))));
    entries.push(entry(14, UNIFORM));
    entries.push(entry(17, texture(filtered, wgpu::TextureViewDimension::D3)));
    entries.push(entry(18, texture(filtered, wgpu::TextureViewDimension::D2)));
    entries.extend([19, 21].map(|n| entry(n, texture(filtered, wgpu::TextureViewDimension::D3))));
    let unfiltered = wgpu::TextureSampleType::Float { filterable: false };
    entries.extend([15, 16, 20].map(|n| entry(n, texture(unfiltered, wgpu::TextureViewDimension::D2))));
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("scene"),
        entries: &entries,
    })
}
