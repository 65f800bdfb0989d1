//! Resources that a renderer caches between pictures: uniform buffers, the textures of the table
//! and the macrocells, displacement maps by identity, targets by size, and the bind groups of all
//! of these. A picture rewrites what has changed and creates what is missing.

use super::classify::ValueBoundsCache;
use super::context::{Context, extent};
use super::maps::MapCache;
use super::object::SurfaceCache;
use super::target::{Layer, RenderTexture};
use super::uniforms::{CutShapeUniform, FrameUniform, PlacedMapUniform};
use super::volume::VolumeCache;
use super::work::ResourceKind;
use crate::deform::cut::MAX_CUTS;
use crate::prepare::{LightVolume, Prepared};
use crate::transfer::{GRADIENT_ENTRIES, PREINTEGRATED_SIZE, Preintegrated, TABLE_ENTRIES, TransferTable};
use crate::{Error, Result};
use std::sync::Arc;
use wgpu::{BufferUsages, TextureFormat, TextureUsages};

/// The inputs of the shaders' shared functions, with the content last written.
#[derive(Default)]
pub(super) struct SceneCache {
    uniforms: Option<[wgpu::Buffer; 3]>,
    table: Option<(RenderTexture, Vec<[f32; 4]>)>,
    cells: Option<(RenderTexture, Vec<u8>)>,
    /// Made for one transfer function and step.
    preintegrated: Option<(RenderTexture, Vec<[f32; 4]>, f32)>,
    nothing_preintegrated: Option<RenderTexture>,
    light_volume: Option<(RenderTexture, Arc<LightVolume>)>,
    pub volume: VolumeCache,
    pub maps: MapCache,
    pub surfaces: SurfaceCache,
    pub values: ValueBoundsCache,
}

/// The bindings of a picture: handles of cached resources.
#[derive(Clone)]
pub(super) struct SceneBindings {
    uniforms: [wgpu::Buffer; 3],
    frame: FrameUniform,
    table: wgpu::TextureView,
    cells: wgpu::TextureView,
    preintegrated: wgpu::TextureView,
    /// Anything if the scene has no light volume.
    light_volume: wgpu::TextureView,
    /// The half- and single-precision atlases.
    maps: [wgpu::TextureView; 2],
    nothing: Layer,
    /// Positions of listed samples; anything if there are none.
    positions: wgpu::TextureView,
}

impl SceneBindings {
    /// The same bindings with positions of listed samples.
    pub(super) fn with_positions(&self, positions: &wgpu::TextureView) -> Self {
        Self {
            positions: positions.clone(),
            ..self.clone()
        }
    }

    /// Moves the samples of all later passes to an offset from the centre of each pixel, pixels.
    pub(super) fn move_samples(&self, context: &Context, offset: [f32; 2]) {
        let frame = self.frame.with_offset(offset);
        context
            .device
            .queue
            .write_buffer(&self.uniforms[0], 0, bytemuck::bytes_of(&frame));
    }
}

impl SceneCache {
    /// Uploads the inputs of the shared shader functions that have changed.
    pub(super) fn bindings(
        &mut self,
        context: &Context,
        scene: &Prepared,
        nothing: Layer,
    ) -> Result<SceneBindings> {
        let volume = self
            .volume
            .texture
            .as_ref()
            .ok_or_else(|| Error::Gpu("no volume was uploaded".into()))?;
        let frame = FrameUniform::new(
            scene,
            [volume.scale, volume.offset, volume.gradient_scale(scene)],
            volume.texture_span_voxels,
        );
        let (maps, placed, replaced) = self.maps.upload_maps(context, &scene.stack)?;
        if replaced {
            context.forget_groups();
        }
        let mut shapes = [bytemuck::Zeroable::zeroed(); MAX_CUTS];
        for (shape, cut) in shapes.iter_mut().zip(scene.cuts.primitives()) {
            *shape = CutShapeUniform::new(cut);
        }
        let contents: [&[u8]; 3] = [
            bytemuck::bytes_of(&frame),
            bytemuck::cast_slice::<PlacedMapUniform, u8>(&placed),
            bytemuck::cast_slice::<CutShapeUniform, u8>(&shapes),
        ];
        let uniforms = match &self.uniforms {
            Some(buffers) => {
                buffers
                    .iter()
                    .zip(contents)
                    .for_each(|(buffer, bytes)| context.device.queue.write_buffer(buffer, 0, bytes));
                buffers.clone()
            }
            None => {
                let buffers =
                    contents.map(|bytes| context.buffer_of("uniforms", bytes, BufferUsages::UNIFORM));
                self.uniforms.insert(buffers).clone()
            }
        };
        let (table, cells, preintegrated) = (
            self.table(context, &scene.volume().table),
            self.cells(context, scene)?,
            self.preintegrated(context, scene),
        );
        let light_volume = match &scene.light_volume {
            Some(volume) => Some(self.light_volume(context, volume)?),
            None => None,
        };
        Ok(SceneBindings {
            uniforms,
            frame,
            table,
            cells,
            preintegrated,
            light_volume: light_volume.unwrap_or_else(|| maps[0].clone()),
            maps,
            positions: nothing.distance_view.clone(),
            nothing,
        })
    }

    /// The macrocells' texture.
    fn cells(&mut self, context: &Context, scene: &Prepared) -> Result<wgpu::TextureView> {
        let (size, blocks) = (
            scene.volume().macrocells.size.to_array().map(|n| n as usize),
            scene.volume().macrocells.blocks(),
        );
        let target = match self.cells.take() {
            Some((target, written)) if target.texture.size() == extent(size) => {
                if written == blocks {
                    let view = target.view.clone();
                    self.cells = Some((target, written));
                    return Ok(view);
                }
                target
            }
            _ => {
                context.forget_groups();
                RenderTexture::new(context.texture_3d("macrocells", size, TextureFormat::R8Uint)?)
            }
        };
        context.tally.count(ResourceKind::Cells);
        context.write_layers(&target.texture, 0, blocks, size);
        let view = target.view.clone();
        self.cells = Some((target, blocks.to_vec()));
        Ok(view)
    }

    /// The light volume's texture: S and `V_raw`.
    fn light_volume(&mut self, context: &Context, volume: &Arc<LightVolume>) -> Result<wgpu::TextureView> {
        let target = match self.light_volume.take() {
            Some((target, written)) if Arc::ptr_eq(&written, volume) => {
                let view = target.view.clone();
                self.light_volume = Some((target, written));
                return Ok(view);
            }
            Some((target, written)) if written.size == volume.size => target,
            _ => {
                context.forget_groups();
                RenderTexture::new(context.texture_3d(
                    "light volume",
                    volume.size,
                    TextureFormat::Rg16Float,
                )?)
            }
        };
        let halves: Vec<u16> = volume
            .nodes()
            .flatten()
            .map(|v| half::f16::from_f32(v).to_bits())
            .collect();
        context.tally.count(ResourceKind::LightVolume);
        context.write_layers(&target.texture, 0, bytemuck::cast_slice(&halves), volume.size);
        let view = target.view.clone();
        self.light_volume = Some((target, volume.clone()));
        Ok(view)
    }

    /// Row 0: colour and optical depth; row 1: gradient factors; row 2: the optical depth's
    /// integral from the first entry.
    fn table(&mut self, context: &Context, table: &TransferTable) -> wgpu::TextureView {
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
        let target = match self.table.take() {
            Some((target, written)) if written == texels => {
                let view = target.view.clone();
                self.table = Some((target, written));
                return view;
            }
            Some((target, _)) => target,
            None => RenderTexture::new(context.texture(&wgpu::TextureDescriptor {
                label: Some("transfer function"),
                size: wgpu::Extent3d {
                    width: TABLE_ENTRIES as u32,
                    height: 3,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: TextureFormat::Rgba32Float,
                usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
                view_formats: &[],
            })),
        };
        context.tally.count(ResourceKind::TransferTable);
        context.write_layers(
            &target.texture,
            0,
            bytemuck::cast_slice(&texels),
            [TABLE_ENTRIES, 3, 1],
        );
        let view = target.view.clone();
        self.table = Some((target, texels));
        view
    }

    /// The pre-integrated table, if the scene uses one.
    fn preintegrated(&mut self, context: &Context, scene: &Prepared) -> wgpu::TextureView {
        let table_of = |edge: usize| {
            RenderTexture::new(context.texture(&wgpu::TextureDescriptor {
                label: Some("pre-integrated transfer function"),
                size: wgpu::Extent3d {
                    width: edge as u32,
                    height: edge as u32,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: TextureFormat::Rgba16Float,
                usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
                view_formats: &[],
            }))
        };
        if !scene.preintegrated() {
            if let Some(target) = &self.nothing_preintegrated {
                return target.view.clone();
            }
            let target = table_of(1);
            return self.nothing_preintegrated.insert(target).view.clone();
        }
        let length = scene.frame.spacing.step_mm / scene.frame.spacing.reference_mm;
        let target = match self.preintegrated.take() {
            Some((target, entries, of)) if of == length && entries == scene.volume().table.entries => {
                let view = target.view.clone();
                self.preintegrated = Some((target, entries, of));
                return view;
            }
            Some((target, ..)) => target,
            None => table_of(PREINTEGRATED_SIZE),
        };
        let made = Preintegrated::new(&scene.volume().table, length);
        let halves: Vec<u16> = made
            .entries
            .as_flattened()
            .iter()
            .map(|v| half::f16::from_f32(*v).to_bits())
            .collect();
        context.tally.count(ResourceKind::TransferTable);
        context.write_layers(
            &target.texture,
            0,
            bytemuck::cast_slice(&halves),
            [PREINTEGRATED_SIZE, PREINTEGRATED_SIZE, 1],
        );
        let view = target.view.clone();
        self.preintegrated = Some((target, scene.volume().table.entries.clone(), length));
        view
    }

    /// The bind group of the shared bindings and the layer behind.
    pub(super) fn group(
        &mut self,
        context: &Context,
        shared: &SceneBindings,
        behind: Option<&Layer>,
    ) -> wgpu::BindGroup {
        let volume = self.volume.texture.as_ref().map_or(&shared.maps[0], |v| &v.view);
        let colors = self
            .volume
            .texture
            .as_ref()
            .and_then(|v| v.colors.as_ref())
            .unwrap_or(&shared.maps[0]);
        let gradients = self
            .volume
            .texture
            .as_ref()
            .and_then(|v| v.gradients.as_ref())
            .unwrap_or(&shared.maps[0]);
        let [color, distance] = behind.unwrap_or(&shared.nothing).views();
        // By binding number.
        let mut views = vec![
            (2, volume.clone()),
            (4, shared.table.clone()),
            (5, shared.cells.clone()),
        ];
        views.extend([
            (15, color.clone()),
            (16, distance.clone()),
            (17, colors.clone()),
            (18, shared.preintegrated.clone()),
            (19, gradients.clone()),
            (20, shared.positions.clone()),
            (21, shared.light_volume.clone()),
        ]);
        views.extend(
            shared
                .maps
                .iter()
                .enumerate()
                .map(|(k, view)| (6 + k as u32, view.clone())),
        );
        let sampler = (3, wgpu::BindingResource::Sampler(&context.sampler));
        let buffers = [0, 1, 14]
            .into_iter()
            .zip(&shared.uniforms)
            .map(|(n, b)| (n, b.as_entire_binding()));
        let others: Vec<_> = std::iter::once(sampler).chain(buffers).collect();
        context.cached_bind_group("scene", &context.shared_layout, views, &others)
    }
}
