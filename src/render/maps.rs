//! Displacement maps on the device, by identity: each in its own texture, and those of a scene in
//! atlases.

use super::atlas::{Atlas, AtlasEntry, AtlasSlot, TexelBox};
use super::context::{Context, extent, lock};
use super::sample_map::{MapBounds, SampledMap};
use super::target::RenderTexture;
use super::uniforms::{PLACED_MAPS, PlacedMapUniform};
use super::work::ResourceKind;
use crate::deform::{DisplacementMap, MAX_MAPS, PlacedMap, Stack, Storage};
use crate::{Error, Result};
use std::sync::{Arc, Mutex};
use wgpu::{Features, TextureFormat, TextureUsages};

/// Maximum number of cached maps, and of their bytes. A stack in use is never evicted.
const MAX_CACHED_MAPS: usize = 32;
const MAX_CACHED_MAP_BYTES: usize = 256 << 20;

/// A displacement map on the GPU. The map itself is retained, so that its address is not reused.
struct CachedMap {
    map: Arc<DisplacementMap>,
    texture: wgpu::Texture,
    /// Computed on first use.
    bounds: Option<MapBounds>,
}

/// Displacement maps on the device.
#[derive(Default)]
pub(super) struct MapCache {
    /// The most recently used last.
    maps: Mutex<Vec<CachedMap>>,
    /// The half- and single-precision atlases, which shaders read.
    atlases: Mutex<[Atlas; 2]>,
}

/// What an atlas holds of a map: its texels, and its stored slopes.
fn textures_of(placed: &PlacedMap) -> impl Iterator<Item = &Arc<DisplacementMap>> {
    std::iter::once(&placed.map).chain(&placed.filter.slopes)
}

/// Bytes of a texture's texels.
fn bytes_of(texture: &wgpu::Texture) -> usize {
    let size = texture.size();
    let texels = size.width as usize * size.height as usize * size.depth_or_array_layers as usize;
    texels * texture.format().block_copy_size(None).unwrap_or(0) as usize
}

impl Context {
    /// The atlas for a map, and its format.
    pub(super) fn format_of(&self, map: &DisplacementMap) -> (bool, TextureFormat) {
        // A format that cannot be filtered cannot be bound to a filtering sampler.
        let single = map.storage != Storage::F16
            && self
                .device
                .device
                .features()
                .contains(Features::FLOAT32_FILTERABLE);
        (
            single,
            if single {
                TextureFormat::Rgba32Float
            } else {
                TextureFormat::Rgba16Float
            },
        )
    }
}

impl MapCache {
    fn upload_map(&self, context: &Context, map: &DisplacementMap) -> Result<wgpu::Texture> {
        let (single, format) = context.format_of(map);
        let usage = TextureUsages::COPY_DST | TextureUsages::COPY_SRC;
        let texture = context.texture_3d_for("displacement map", map.size, format, usage)?;
        context.write_layers(
            &texture,
            0,
            &map.encode_as(if single { Storage::F32 } else { Storage::F16 }),
            map.size,
        );
        Ok(texture)
    }

    /// A map by its identity, in its own texture: the source for the bounds on its texels and for
    /// the atlases.
    pub(super) fn map(&self, context: &Context, map: &Arc<DisplacementMap>) -> Result<wgpu::Texture> {
        let mut cached = lock(&self.maps);
        if let Some(at) = cached.iter().position(|k| Arc::ptr_eq(&k.map, map)) {
            let entry = cached.remove(at);
            let texture = entry.texture.clone();
            cached.push(entry);
            return Ok(texture);
        }
        context.tally.count(ResourceKind::Map);
        let made = map
            .definition()
            .filter(|_| context.strategy.prepare)
            .and_then(|r| Some((r, r.formula()?)));
        let (texture, bounds) = match made {
            // Made by another renderer, or evicted.
            Some((definition, formula)) => context
                .sampled_map(definition, &formula)
                .map(|made| (made.texture, Some(made.bounds)))?,
            None => (self.upload_map(context, map)?, None),
        };
        cached.push(CachedMap {
            map: map.clone(),
            texture: texture.clone(),
            bounds,
        });
        Ok(texture)
    }

    /// Evicts the least recently used maps above the limits.
    fn forget_maps(&self, in_use: &Stack) {
        let mut cached = lock(&self.maps);
        let cached_bytes =
            |k: &CachedMap| bytes_of(&k.texture) + k.bounds.as_ref().map_or(0, MapBounds::bytes);
        let mut bytes: usize = cached.iter().map(cached_bytes).sum();
        let mut count = cached.len();
        cached.retain(|k| {
            let goes = (bytes > MAX_CACHED_MAP_BYTES || count > MAX_CACHED_MAPS)
                && !in_use
                    .all_maps()
                    .flat_map(textures_of)
                    .any(|map| Arc::ptr_eq(map, &k.map));
            if goes {
                bytes -= cached_bytes(k);
                count -= 1;
            }
            !goes
        });
    }

    /// Number of maps on the device.
    pub fn count(&self) -> usize {
        lock(&self.maps).len()
    }

    /// Caches a map made on the device.
    pub(super) fn cache_map(&self, context: &Context, map: &Arc<DisplacementMap>, made: SampledMap) {
        context.tally.count(ResourceKind::Map);
        lock(&self.maps).push(CachedMap {
            map: map.clone(),
            texture: made.texture,
            bounds: Some(made.bounds),
        });
    }

    /// Bounds on boxes of the texels of a cached map.
    pub(super) fn bounds_of(&self, context: &Context, map: &Arc<DisplacementMap>) -> Result<MapBounds> {
        // An atlas may hold a map whose own texture was evicted.
        self.map(context, map)?;
        let mut cached = lock(&self.maps);
        let found = cached
            .iter_mut()
            .find(|k| Arc::ptr_eq(&k.map, map))
            .ok_or_else(|| Error::Gpu("a displacement map was evicted while it was in use".into()))?;
        match &found.bounds {
            Some(bounds) => Ok(bounds.clone()),
            None => {
                let view = found.texture.create_view(&wgpu::TextureViewDescriptor::default());
                Ok(found.bounds.insert(context.bound_texels(map.size, &view)).clone())
            }
        }
    }

    /// The atlases with a stack's maps, the uniforms of each map, and whether a texture was
    /// replaced.
    ///
    /// # Errors
    /// More maps than a pass evaluates, or than fit on the device.
    pub(super) fn upload_maps(
        &self,
        context: &Context,
        stack: &Stack,
    ) -> Result<([wgpu::TextureView; 2], [PlacedMapUniform; PLACED_MAPS], bool)> {
        let count = stack.maps().len();
        if count > MAX_MAPS {
            return Err(Error::GpuLimit(format!(
                "the scene has {count} deformations, but the GPU renderer supports at most {MAX_MAPS}"
            )));
        }
        let (views, places, replaced) = self.place_maps(context, stack)?;
        self.forget_maps(stack);
        let sizes = [&views[0], &views[1]].map(|v| v.texture().size());
        let mut uniforms = [bytemuck::Zeroable::zeroed(); PLACED_MAPS];
        for ((uniform, map), place) in uniforms.iter_mut().zip(stack.all_maps()).zip(places) {
            let size = sizes[usize::from(place.single)];
            *uniform = PlacedMapUniform::new(
                map,
                place.origin,
                place.slopes_origin,
                place.single,
                [size.width, size.height, size.depth_or_array_layers],
            );
        }
        Ok((views, uniforms, replaced))
    }

    /// Places the maps of a stack in their atlases; returns both textures, the place of each map,
    /// and whether a texture was replaced.
    pub(super) fn place_maps(
        &self,
        context: &Context,
        stack: &Stack,
    ) -> Result<([wgpu::TextureView; 2], Vec<AtlasSlot>, bool)> {
        let all: Vec<&PlacedMap> = stack.all_maps().collect();
        let mut atlases = lock(&self.atlases);
        let mut places = vec![AtlasSlot::default(); all.len()];
        let (mut views, mut replaced) = (Vec::with_capacity(2), false);
        for (atlas, single) in atlases.iter_mut().zip([false, true]) {
            let of_atlas = |n: &usize| context.format_of(&all[*n].map).0 == single;
            let members: Vec<usize> = (0..all.len()).filter(of_atlas).collect();
            let mut maps: Vec<Arc<DisplacementMap>> = Vec::new();
            for n in &members {
                for map in textures_of(all[*n]) {
                    if !maps.iter().any(|m| Arc::ptr_eq(m, map)) {
                        maps.push(map.clone());
                    }
                }
            }
            let format = if single {
                TextureFormat::Rgba32Float
            } else {
                TextureFormat::Rgba16Float
            };
            replaced |= self.fill(context, atlas, &maps, format)?;
            for n in members {
                let origin_of = |map: &Arc<DisplacementMap>| {
                    let entry = atlas.find(map).map(|e| atlas.entries[e].region.origin);
                    entry.unwrap_or_default()
                };
                places[n] = AtlasSlot {
                    origin: origin_of(&all[n].map),
                    slopes_origin: all[n].filter.slopes.as_ref().map(origin_of).unwrap_or_default(),
                    single,
                };
            }
            views.push(self.view_of(context, atlas, format)?);
        }
        let [half, single] = <[wgpu::TextureView; 2]>::try_from(views)
            .map_err(|_| Error::Gpu("an atlas is missing".into()))?;
        Ok(([half, single], places, replaced))
    }

    /// The texture of an atlas; a single texel if it is empty.
    fn view_of(
        &self,
        context: &Context,
        atlas: &mut Atlas,
        format: TextureFormat,
    ) -> Result<wgpu::TextureView> {
        if let Some(target) = &atlas.target {
            return Ok(target.view.clone());
        }
        let filterable = format == TextureFormat::Rgba16Float
            || context
                .device
                .device
                .features()
                .contains(Features::FLOAT32_FILTERABLE);
        let format = if filterable {
            format
        } else {
            TextureFormat::Rgba16Float
        };
        let target = RenderTexture::new(context.texture_3d("no displacement maps", [1; 3], format)?);
        Ok(atlas.target.insert(target).view.clone())
    }

    /// Ensures that maps are in an atlas; returns whether its texture was replaced.
    fn fill(
        &self,
        context: &Context,
        atlas: &mut Atlas,
        maps: &[Arc<DisplacementMap>],
        format: TextureFormat,
    ) -> Result<bool> {
        let missing: Vec<&Arc<DisplacementMap>> = maps.iter().filter(|m| atlas.find(m).is_none()).collect();
        // The most recently used are moved to the end.
        for map in maps {
            if let Some(n) = atlas.find(map) {
                let entry = atlas.entries.remove(n);
                atlas.entries.push(entry);
            }
        }
        if missing.is_empty() {
            return Ok(false);
        }
        let mut found = Vec::new();
        for map in &missing {
            match atlas.place(map, maps) {
                Some(region) => found.push(((*map).clone(), region)),
                None => return self.rebuild(context, atlas, maps, format),
            }
        }
        self.copy_into(context, atlas, found)?;
        Ok(false)
    }

    /// Creates a new texture for these maps alone.
    fn rebuild(
        &self,
        context: &Context,
        atlas: &mut Atlas,
        maps: &[Arc<DisplacementMap>],
        format: TextureFormat,
    ) -> Result<bool> {
        let most = context.device.device.limits().max_texture_dimension_3d;
        let (packing, regions) = Atlas::packed(maps, most).ok_or_else(|| {
            Error::GpuLimit(format!(
                "the scene's {} displacement maps do not fit into a texture of this GPU (at most {most} texels per axis)",
                maps.len()
            ))
        })?;
        let usage = TextureUsages::COPY_DST;
        let texture = context.texture_3d_for(
            "displacement maps",
            packing.size.map(|n| n as usize),
            format,
            usage,
        )?;
        *atlas = Atlas {
            target: Some(RenderTexture::new(texture)),
            packing,
            entries: Vec::new(),
        };
        self.copy_into(context, atlas, maps.iter().cloned().zip(regions).collect())?;
        Ok(true)
    }

    fn copy_into(
        &self,
        context: &Context,
        atlas: &mut Atlas,
        found: Vec<(Arc<DisplacementMap>, TexelBox)>,
    ) -> Result<()> {
        let Some(target) = atlas.target.clone() else {
            return Ok(());
        };
        let mut encoder = context
            .device
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for (map, region) in &found {
            let texture = self.map(context, map)?;
            let [x, y, z] = region.origin;
            let mut to = target.texture.as_image_copy();
            to.origin = wgpu::Origin3d { x, y, z };
            encoder.copy_texture_to_texture(texture.as_image_copy(), to, extent(map.size));
        }
        context.device.queue.submit([encoder.finish()]);
        atlas
            .entries
            .extend(found.into_iter().map(|(map, region)| AtlasEntry { map, region }));
        Ok(())
    }
}
