//! What a renderer keeps from picture to picture: uniform buffers, the table's and the macrocells' textures, displacement maps by identity,
//! targets by size, and the bind groups of all of these. A picture rewrites what has changed and makes what is not there.

use super::atlas::Atlas;
use super::object::CachedObject;
use super::prepare::{MapBounds, SampledMap};
use super::target::{Layer, RenderTexture};
use super::uniforms::{CutShapeUniform, FrameUniform, PLACED_MAPS, PlacedMapUniform};
use super::work::{ResourceKind, WorkCounters};
use super::{Renderer, extent};
use crate::deform::cut::MAX_CUTS;
use crate::deform::{DisplacementMap, MAX_MAPS, Stack, Storage};
use crate::prepare::Prepared;
use crate::transfer::{GRADIENT_ENTRIES, PREINTEGRATED_SIZE, Preintegrated, TABLE_ENTRIES, TransferTable};
use crate::{Error, Result};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use wgpu::{BufferUsages, TextureFormat, TextureUsages};

/// Maps that are kept at most, and their bytes. A stack in use is kept whole.
const MAX_CACHED_MAPS: usize = 32;
const MAX_CACHED_MAP_BYTES: usize = 256 << 20;
/// Targets of one purpose that are kept: a live view changes between a coarse and a fine picture.
const MAX_CACHED_SIZES: usize = 2;
/// Bind groups that are kept: with nothing behind, with each layer of surfaces, and those of targets.
const MAX_CACHED_BIND_GROUPS: usize = 8;

/// A displacement map on the GPU. The map itself is kept, so that nothing else can take its address.
struct CachedMap {
    map: Arc<DisplacementMap>,
    texture: wgpu::Texture,
    /// Once something has asked for them.
    bounds: Option<MapBounds>,
}

/// What the shaders' shared functions read, with the content that was last written.
#[derive(Default)]
pub(super) struct SceneCache {
    uniforms: Option<[wgpu::Buffer; 3]>,
    table: Option<(RenderTexture, Vec<[f32; 4]>)>,
    cells: Option<(RenderTexture, Vec<u8>)>,
    /// Made for a curve and a step.
    preintegrated: Option<(RenderTexture, Vec<[f32; 4]>, f32)>,
    nothing_preintegrated: Option<RenderTexture>,
    /// The most recently used last.
    maps: Mutex<Vec<CachedMap>>,
    /// What shaders read of them: of half and of single precision.
    atlases: Mutex<[Atlas; 2]>,
    /// By purpose, the most recently used last.
    targets: Vec<(&'static str, RenderTexture)>,
    groups: Vec<Group>,
    /// By purpose: what is written for every use and grows.
    scratch: Mutex<Vec<(&'static str, wgpu::Buffer)>>,
    /// Surfaces, by their place in the scene.
    pub(super) objects: Vec<Option<CachedObject>>,
    readback: Option<wgpu::Buffer>,
    vertices: Option<wgpu::Buffer>,
}

/// A bind group with its purpose and the views that it binds.
struct Group {
    purpose: &'static str,
    views: Vec<wgpu::TextureView>,
    group: wgpu::BindGroup,
}

/// What a picture binds: handles of what is kept.
pub(super) struct SceneBindings {
    uniforms: [wgpu::Buffer; 3],
    table: wgpu::TextureView,
    cells: wgpu::TextureView,
    preintegrated: wgpu::TextureView,
    /// The atlases of half and of single precision.
    maps: [wgpu::TextureView; 2],
    nothing: Layer,
}

fn lock<T>(m: &Mutex<T>) -> MutexGuard<'_, T> {
    // Entries are only ever added whole.
    m.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Bytes of a texture's texels.
fn bytes_of(texture: &wgpu::Texture) -> usize {
    let size = texture.size();
    let texels = size.width as usize * size.height as usize * size.depth_or_array_layers as usize;
    texels * texture.format().block_copy_size(None).unwrap_or(0) as usize
}

impl SceneCache {
    /// The atlases of maps.
    pub(super) fn atlases(&self) -> MutexGuard<'_, [Atlas; 2]> {
        lock(&self.atlases)
    }

    /// Bind groups hold what they bind: those of textures that are replaced must go, or the textures stay.
    pub(super) fn forget_groups(&mut self) {
        self.groups.clear();
    }
}

impl Renderer {
    /// A buffer, counted.
    pub(super) fn buffer(&self, label: &str, size: u64, usage: BufferUsages) -> wgpu::Buffer {
        self.tally.count(ResourceKind::Buffer);
        self.device.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
    }

    /// A buffer with its content, counted.
    pub(super) fn buffer_of(&self, label: &str, contents: &[u8], usage: BufferUsages) -> wgpu::Buffer {
        let buffer = self.buffer(label, (contents.len() as u64).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT), usage | BufferUsages::COPY_DST);
        self.device.queue.write_buffer(&buffer, 0, contents);
        buffer
    }

    /// A bind group, counted.
    pub(super) fn bind_group(&self, label: &str, layout: &wgpu::BindGroupLayout, entries: &[wgpu::BindGroupEntry]) -> wgpu::BindGroup {
        self.tally.count(ResourceKind::BindGroup);
        self.device.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries })
    }

    /// A texture, counted.
    pub(super) fn texture(&self, descriptor: &wgpu::TextureDescriptor) -> wgpu::Texture {
        self.tally.count(ResourceKind::Texture);
        self.device.device.create_texture(descriptor)
    }

    /// A 2D texture to draw into and to read, kept by purpose, size and format. Its content is what it was.
    pub(super) fn target(&mut self, purpose: &'static str, width: u32, height: u32, format: TextureFormat) -> RenderTexture {
        let fits = |t: &RenderTexture| (t.texture.width(), t.texture.height(), t.texture.format()) == (width, height, format);
        let targets = &mut self.cache.targets;
        if let Some(at) = targets.iter().position(|(p, t)| *p == purpose && fits(t)) {
            let found = targets.remove(at);
            let target = found.1.clone();
            targets.push(found);
            return target;
        }
        let mut same = targets.iter().enumerate().filter(|(_, (p, _))| *p == purpose).map(|(n, _)| n);
        if let (Some(oldest), others) = (same.next(), same.count())
            && others + 1 >= MAX_CACHED_SIZES
        {
            targets.remove(oldest);
            self.cache.forget_groups();
        }
        let storable = format == TextureFormat::Rgba16Float && self.device.computes();
        let target = RenderTexture::new(self.texture(&wgpu::TextureDescriptor {
            label: Some(purpose),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: TextureUsages::RENDER_ATTACHMENT
                | TextureUsages::COPY_SRC
                | TextureUsages::COPY_DST
                | TextureUsages::TEXTURE_BINDING
                | if storable { TextureUsages::STORAGE_BINDING } else { TextureUsages::empty() },
            view_formats: &[],
        }));
        self.cache.targets.push((purpose, target.clone()));
        target
    }

    /// A buffer to read a picture back through, kept until a picture is larger.
    pub(super) fn readback(&mut self, size: u64) -> wgpu::Buffer {
        match &self.cache.readback {
            Some(buffer) if buffer.size() >= size => buffer.clone(),
            _ => {
                let buffer = self.buffer("readback", size, BufferUsages::COPY_DST | BufferUsages::MAP_READ);
                self.cache.readback.insert(buffer).clone()
            }
        }
    }

    /// Corners of slices, in a buffer that grows.
    pub(super) fn slice_vertices(&mut self, contents: &[u8]) -> wgpu::Buffer {
        match &self.cache.vertices {
            Some(buffer) if buffer.size() >= contents.len() as u64 => {
                self.device.queue.write_buffer(buffer, 0, contents);
                buffer.clone()
            }
            _ => {
                let size = (contents.len() as u64).next_power_of_two().max(1 << 14);
                let buffer = self.buffer("slices", size, BufferUsages::VERTEX | BufferUsages::COPY_DST);
                self.device.queue.write_buffer(&buffer, 0, contents);
                self.cache.vertices.insert(buffer).clone()
            }
        }
    }

    fn upload_map(&self, map: &DisplacementMap) -> Result<wgpu::Texture> {
        let (single, format) = self.format_of(map);
        let usage = TextureUsages::COPY_DST | TextureUsages::COPY_SRC;
        let texture = self.texture_3d_for("displacement map", map.size, format, usage)?;
        self.write_layers(&texture, 0, &map.encode_as(if single { Storage::F32 } else { Storage::F16 }), map.size);
        Ok(texture)
    }

    /// A map by its identity, in a texture of its own: what bounds on its texels are found from, and what goes into an atlas.
    pub(super) fn map(&self, map: &Arc<DisplacementMap>) -> Result<wgpu::Texture> {
        let mut cached = lock(&self.cache.maps);
        if let Some(at) = cached.iter().position(|k| Arc::ptr_eq(&k.map, map)) {
            let entry = cached.remove(at);
            let texture = entry.texture.clone();
            cached.push(entry);
            return Ok(texture);
        }
        self.tally.count(ResourceKind::Map);
        let made = map.recipe().filter(|_| self.strategy.prepare).and_then(|r| Some((r, r.formula()?)));
        let (texture, bounds) = match made {
            // Made by a renderer that is gone, or let go of.
            Some((recipe, formula)) => self.sampled_map(recipe, &formula).map(|made| (made.texture, Some(made.bounds)))?,
            None => (self.upload_map(map)?, None),
        };
        cached.push(CachedMap { map: map.clone(), texture: texture.clone(), bounds });
        Ok(texture)
    }

    /// Lets go of the maps that were used longest ago, beyond what is kept.
    fn forget_maps(&self, in_use: &Stack) {
        let mut cached = lock(&self.cache.maps);
        let cached_bytes = |k: &CachedMap| bytes_of(&k.texture) + k.bounds.as_ref().map_or(0, MapBounds::bytes);
        let mut bytes: usize = cached.iter().map(cached_bytes).sum();
        let mut count = cached.len();
        cached.retain(|k| {
            let goes = (bytes > MAX_CACHED_MAP_BYTES || count > MAX_CACHED_MAPS) && !in_use.all_maps().any(|m| Arc::ptr_eq(&m.map, &k.map));
            if goes {
                bytes -= cached_bytes(k);
                count -= 1;
            }
            !goes
        });
    }

    /// Maps on the device now.
    pub fn cached_map_count(&self) -> usize {
        lock(&self.cache.maps).len()
    }

    /// Keeps a map that was made here.
    pub(super) fn cache_map(&self, map: &Arc<DisplacementMap>, made: SampledMap) {
        self.tally.count(ResourceKind::Map);
        lock(&self.cache.maps).push(CachedMap { map: map.clone(), texture: made.texture, bounds: Some(made.bounds) });
    }

    /// Bounds on boxes of the texels of a map that is kept.
    pub(super) fn bounds_of(&self, map: &Arc<DisplacementMap>) -> Result<MapBounds> {
        let mut cached = lock(&self.cache.maps);
        let found = cached.iter_mut().find(|k| Arc::ptr_eq(&k.map, map)).ok_or_else(|| Error::Gpu("a map was let go of".into()))?;
        match &found.bounds {
            Some(bounds) => Ok(bounds.clone()),
            None => {
                let view = found.texture.create_view(&wgpu::TextureViewDescriptor::default());
                Ok(found.bounds.insert(self.bound_texels(map.size, &view)).clone())
            }
        }
    }

    /// A buffer of a purpose with its content, kept and overwritten at the next use.
    pub(super) fn scratch(&self, purpose: &'static str, contents: &[u8], usage: BufferUsages) -> wgpu::Buffer {
        let buffer = self.scratch_of(purpose, contents.len() as u64, usage | BufferUsages::COPY_DST);
        self.device.queue.write_buffer(&buffer, 0, contents);
        buffer
    }

    /// A buffer of a purpose and at least a size, kept; its content is what it was.
    pub(super) fn scratch_of(&self, purpose: &'static str, size: u64, usage: BufferUsages) -> wgpu::Buffer {
        let mut cached = lock(&self.cache.scratch);
        if let Some((_, buffer)) = cached.iter().find(|(p, b)| *p == purpose && b.size() >= size) {
            return buffer.clone();
        }
        cached.retain(|(p, _)| *p != purpose);
        let buffer = self.buffer(purpose, size.next_multiple_of(16), usage);
        cached.push((purpose, buffer.clone()));
        buffer
    }

    /// The atlases with a stack's maps in them, what shaders need to know of each, and whether a texture was replaced.
    ///
    /// # Errors
    /// More maps than a pass evaluates, or than the device holds.
    pub(super) fn upload_maps(&self, stack: &Stack) -> Result<([wgpu::TextureView; 2], [PlacedMapUniform; PLACED_MAPS], bool)> {
        let count = stack.maps().len();
        if count > MAX_MAPS {
            return Err(Error::GpuLimit(format!("the scene has {count} deformations, but the GPU renderer supports at most {MAX_MAPS}")));
        }
        let (views, places, replaced) = self.place_maps(stack)?;
        self.forget_maps(stack);
        let sizes = [&views[0], &views[1]].map(|v| v.texture().size());
        let mut uniforms = [bytemuck::Zeroable::zeroed(); PLACED_MAPS];
        for ((uniform, map), place) in uniforms.iter_mut().zip(stack.all_maps()).zip(places) {
            let size = sizes[usize::from(place.single)];
            *uniform = PlacedMapUniform::new(map, place.origin, place.single, [size.width, size.height, size.depth_or_array_layers]);
        }
        Ok((views, uniforms, replaced))
    }

    /// Uploads what of the shared shader functions' inputs has changed.
    pub(super) fn shared(&mut self, scene: &Prepared) -> Result<SceneBindings> {
        let volume = self.volume.as_ref().ok_or_else(|| Error::Gpu("no volume was uploaded".into()))?;
        let frame = FrameUniform::new(scene, [volume.scale, volume.offset, volume.gradient_scale(scene)], volume.texture_span_voxels);
        let (maps, placed, replaced) = self.upload_maps(&scene.stack)?;
        if replaced {
            self.cache.forget_groups();
        }
        let mut shapes = [bytemuck::Zeroable::zeroed(); MAX_CUTS];
        for (shape, cut) in shapes.iter_mut().zip(scene.cuts.primitives()) {
            *shape = CutShapeUniform::new(cut);
        }
        let contents: [&[u8]; 3] =
            [bytemuck::bytes_of(&frame), bytemuck::cast_slice::<PlacedMapUniform, u8>(&placed), bytemuck::cast_slice::<CutShapeUniform, u8>(&shapes)];
        let uniforms = match &self.cache.uniforms {
            Some(buffers) => {
                buffers.iter().zip(contents).for_each(|(buffer, bytes)| self.device.queue.write_buffer(buffer, 0, bytes));
                buffers.clone()
            }
            None => {
                let buffers = contents.map(|bytes| self.buffer_of("uniforms", bytes, BufferUsages::UNIFORM));
                self.cache.uniforms.insert(buffers).clone()
            }
        };
        let nothing = self.layer(["nothing: colour", "nothing: distance", "nothing: depth"], 1, 1);
        let (table, cells, preintegrated) = (self.table(&scene.volume().table), self.cells(scene)?, self.preintegrated(scene));
        Ok(SceneBindings { uniforms, table, cells, preintegrated, maps, nothing })
    }

    /// The macrocells' texture.
    fn cells(&mut self, scene: &Prepared) -> Result<wgpu::TextureView> {
        let (size, blocks) = (scene.volume().macrocells.size.to_array().map(|n| n as usize), scene.volume().macrocells.blocks());
        let target = match self.cache.cells.take() {
            Some((target, written)) if target.texture.size() == extent(size) => {
                if written == blocks {
                    let view = target.view.clone();
                    self.cache.cells = Some((target, written));
                    return Ok(view);
                }
                target
            }
            _ => {
                self.cache.forget_groups();
                RenderTexture::new(self.texture_3d("macrocells", size, TextureFormat::R8Uint)?)
            }
        };
        self.tally.count(ResourceKind::Cells);
        self.write_layers(&target.texture, 0, blocks, size);
        let view = target.view.clone();
        self.cache.cells = Some((target, blocks.to_vec()));
        Ok(view)
    }

    /// Row 0: colour and optical depth; row 1: gradient factors; row 2: the optical depth's integral from the first entry.
    fn table(&mut self, table: &TransferTable) -> wgpu::TextureView {
        let mut texels = table.entries.clone();
        texels.resize(3 * TABLE_ENTRIES, [0.0; 4]);
        let mut sum = 0.0;
        for n in 1..TABLE_ENTRIES {
            sum += 0.5 * (f64::from(texels[n - 1][3]) + f64::from(texels[n][3]));
            texels[2 * TABLE_ENTRIES + n][0] = sum as f32;
        }
        for (n, factor) in table.gradient.iter().take(GRADIENT_ENTRIES).enumerate() {
            texels[TABLE_ENTRIES + n][0] = *factor;
        }
        let target = match self.cache.table.take() {
            Some((target, written)) if written == texels => {
                let view = target.view.clone();
                self.cache.table = Some((target, written));
                return view;
            }
            Some((target, _)) => target,
            None => RenderTexture::new(self.texture(&wgpu::TextureDescriptor {
                label: Some("transfer function"),
                size: wgpu::Extent3d { width: TABLE_ENTRIES as u32, height: 3, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: TextureFormat::Rgba32Float,
                usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
                view_formats: &[],
            })),
        };
        self.tally.count(ResourceKind::TransferTable);
        self.device.queue.write_texture(
            target.texture.as_image_copy(),
            bytemuck::cast_slice(&texels),
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(TABLE_ENTRIES as u32 * 16), rows_per_image: Some(3) },
            target.texture.size(),
        );
        let view = target.view.clone();
        self.cache.table = Some((target, texels));
        view
    }

    /// The table of segments, if the scene wants one.
    fn preintegrated(&mut self, scene: &Prepared) -> wgpu::TextureView {
        let table_of = |renderer: &Self, edge: usize| {
            RenderTexture::new(renderer.texture(&wgpu::TextureDescriptor {
                label: Some("pre-integrated transfer function"),
                size: wgpu::Extent3d { width: edge as u32, height: edge as u32, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: TextureFormat::Rgba16Float,
                usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
                view_formats: &[],
            }))
        };
        if !scene.preintegrated() {
            if let Some(target) = &self.cache.nothing_preintegrated {
                return target.view.clone();
            }
            let target = table_of(self, 1);
            return self.cache.nothing_preintegrated.insert(target).view.clone();
        }
        let length = scene.frame.spacing.step_mm / scene.frame.spacing.reference_mm;
        let target = match self.cache.preintegrated.take() {
            Some((target, entries, of)) if of == length && entries == scene.volume().table.entries => {
                let view = target.view.clone();
                self.cache.preintegrated = Some((target, entries, of));
                return view;
            }
            Some((target, ..)) => target,
            None => table_of(self, PREINTEGRATED_SIZE),
        };
        let made = Preintegrated::new(&scene.volume().table, length);
        let halves: Vec<u16> = made.entries.as_flattened().iter().map(|v| half::f16::from_f32(*v).to_bits()).collect();
        self.tally.count(ResourceKind::TransferTable);
        self.device.queue.write_texture(
            target.texture.as_image_copy(),
            bytemuck::cast_slice(&halves),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(PREINTEGRATED_SIZE as u32 * 8),
                rows_per_image: Some(PREINTEGRATED_SIZE as u32),
            },
            target.texture.size(),
        );
        let view = target.view.clone();
        self.cache.preintegrated = Some((target, scene.volume().table.entries.clone(), length));
        view
    }

    /// The shared bindings, with what lies behind.
    pub(super) fn group(&mut self, shared: &SceneBindings, behind: Option<&Layer>) -> wgpu::BindGroup {
        let volume = self.volume.as_ref().map_or(&shared.maps[0], |v| &v.view);
        let colors = self.volume.as_ref().and_then(|v| v.colors.as_ref()).unwrap_or(&shared.maps[0]);
        let gradients = self.volume.as_ref().and_then(|v| v.gradients.as_ref()).unwrap_or(&shared.maps[0]);
        let [color, distance] = behind.unwrap_or(&shared.nothing).views();
        // By number of binding.
        let mut views = vec![(2, volume.clone()), (4, shared.table.clone()), (5, shared.cells.clone())];
        views.extend([
            (15, color.clone()),
            (16, distance.clone()),
            (17, colors.clone()),
            (18, shared.preintegrated.clone()),
            (19, gradients.clone()),
        ]);
        views.extend(shared.maps.iter().enumerate().map(|(k, view)| (6 + k as u32, view.clone())));
        let sampler = (3, wgpu::BindingResource::Sampler(&self.sampler));
        let buffers = [0, 1, 14].into_iter().zip(&shared.uniforms).map(|(n, b)| (n, b.as_entire_binding()));
        let others: Vec<_> = std::iter::once(sampler).chain(buffers).collect();
        Self::group_of(&mut self.cache.groups, &self.tally, &self.device.device, "scene", &self.shared_layout, views, &others)
    }

    /// A bind group by its purpose and the views that it binds, by number of binding; what else it binds stays the same.
    pub(super) fn cached_bind_group(
        &mut self,
        purpose: &'static str,
        layout: &wgpu::BindGroupLayout,
        views: Vec<(u32, wgpu::TextureView)>,
        others: &[(u32, wgpu::BindingResource)],
    ) -> wgpu::BindGroup {
        Self::group_of(&mut self.cache.groups, &self.tally, &self.device.device, purpose, layout, views, others)
    }

    fn group_of(
        groups: &mut Vec<Group>,
        tally: &WorkCounters,
        device: &wgpu::Device,
        purpose: &'static str,
        layout: &wgpu::BindGroupLayout,
        views: Vec<(u32, wgpu::TextureView)>,
        others: &[(u32, wgpu::BindingResource)],
    ) -> wgpu::BindGroup {
        let key: Vec<wgpu::TextureView> = views.iter().map(|(_, view)| view.clone()).collect();
        if let Some(found) = groups.iter().find(|g| g.purpose == purpose && g.views == key) {
            return found.group.clone();
        }
        let of_views = views.iter().map(|(n, view)| (*n, wgpu::BindingResource::TextureView(view)));
        let entries: Vec<_> = of_views.chain(others.iter().cloned()).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
        tally.count(ResourceKind::BindGroup);
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(purpose), layout, entries: &entries });
        if groups.len() >= MAX_CACHED_BIND_GROUPS {
            groups.remove(0);
        }
        groups.push(Group { purpose, views: key, group: group.clone() });
        group
    }

    /// The shared bindings of a scene with nothing behind.
    pub(super) fn bind(&mut self, scene: &Prepared) -> Result<wgpu::BindGroup> {
        let shared = self.shared(scene)?;
        Ok(self.group(&shared, None))
    }
}
