//! The volume as a texture: in its stored type, reduced if it does not fit on the device, with its
//! voxels' colours in a separate texture.
//!
//! A volume beyond the device's limits is reduced by integer factors, each texel being the mean of
//! a block of voxels, and the user is notified. The full volume stays on the CPU, whose renderer
//! shows every voxel.

use super::context::Context;
use super::work::ResourceKind;
use crate::Result;
use crate::gpu::wait;
use crate::math::flat;
use crate::prepare::Prepared;
use crate::volume::{Colors, VoxelGrid, VoxelGridValues};
use half::f16;
use rayon::prelude::*;
use wgpu::{Features, TextureFormat};

/// Maximum size of a gradient volume on a GPU with dedicated memory, whose size cannot be queried:
/// a picture must not fail because of an optional resource.
const MAX_GRADIENT_BYTES: u64 = 512 << 20;
/// Number of bytes copied at once.
const PIECE: usize = 16 << 20;

/// A volume on the GPU.
pub(super) struct VolumeTexture {
    /// Identity of the voxels: `_voxels` keeps the pointer alive.
    identity: (usize, bool),
    _voxels: VoxelGridValues,
    pub view: wgpu::TextureView,
    pub colors: Option<wgpu::TextureView>,
    /// Central differences of stored values, as fractions of 32767.
    pub gradients: Option<wgpu::TextureView>,
    pub scale: f32,
    pub offset: f32,
    /// Number of voxels spanned by the texture.
    pub texture_span_voxels: [f32; 3],
    /// A notice for the user.
    pub notice: Option<String>,
}

impl VolumeTexture {
    /// Gradient of the normalised value per voxel, per texel unit of the gradient volume; 0 if
    /// there is none.
    pub fn gradient_scale(&self, scene: &Prepared) -> f32 {
        if self.gradients.is_some() {
            0.5 * f32::from(i16::MAX) * scene.volume().grid.scale
        } else {
            0.0
        }
    }
}

impl VoxelGridValues {
    /// The address of the voxels, unique as long as they are retained.
    pub(super) fn identity(&self) -> usize {
        match self {
            Self::U8(v) => v.as_ptr() as usize,
            Self::U16(v) => v.as_ptr() as usize,
            Self::I16(v) => v.as_ptr() as usize,
            Self::F32(v) => v.as_ptr() as usize,
        }
    }
}

/// The factors by which a grid must be reduced along each axis to fit: integers, the longest axes
/// first.
fn factors(size: [usize; 3], bytes_per_voxel: u64, max_voxels: usize, max_bytes: u64) -> [usize; 3] {
    let mut factors = size.map(|n| n.div_ceil(max_voxels.max(1)));
    loop {
        let bytes = (0..3)
            .map(|a| size[a].div_ceil(factors[a]) as u64)
            .product::<u64>()
            * bytes_per_voxel;
        if bytes <= max_bytes {
            return factors;
        }
        // The axis with the most remaining texels.
        let axis = (0..3).max_by_key(|&a| size[a].div_ceil(factors[a])).unwrap_or(0);
        if size[axis].div_ceil(factors[axis]) == 1 {
            return factors;
        }
        factors[axis] += 1;
    }
}

impl Context {
    fn volume_format(&self, grid: &VoxelGrid) -> TextureFormat {
        let features = self.device.device.features();
        let (unorm16, float32) = (
            features.contains(Features::TEXTURE_FORMAT_16BIT_NORM),
            features.contains(Features::FLOAT32_FILTERABLE),
        );
        // Software drivers filter 8-bit textures in 8-bit arithmetic with visible steps: they get
        // 16 bits.
        match &grid.voxels {
            VoxelGridValues::U8(_) if !(self.device.is_software() && unorm16) => TextureFormat::R8Unorm,
            VoxelGridValues::F32(_) if float32 => TextureFormat::R32Float,
            VoxelGridValues::F32(_) => TextureFormat::R16Float,
            _ if unorm16 => TextureFormat::R16Unorm,
            _ => TextureFormat::R16Float,
        }
    }

    fn write_voxels(&self, texture: &wgpu::Texture, grid: &VoxelGrid, format: TextureFormat) -> Result<()> {
        let normalise = |v: f32| f16::from_f32(v * grid.scale + grid.offset).to_bits();
        self.in_pieces(texture, grid.size, |range| match (&grid.voxels, format) {
            (VoxelGridValues::U8(v), TextureFormat::R8Unorm) => flat(v)[range].to_vec(),
            (VoxelGridValues::U8(v), TextureFormat::R16Unorm) => {
                to_bytes(&flat(v)[range], |v| u16::from(v) * 257)
            }
            (VoxelGridValues::U16(v), TextureFormat::R16Unorm) => to_bytes(&flat(v)[range], |v| v),
            (VoxelGridValues::I16(v), TextureFormat::R16Unorm) => {
                to_bytes(&flat(v)[range], |v| (i32::from(v) + 32768) as u16)
            }
            (VoxelGridValues::F32(v), TextureFormat::R32Float) => {
                bytemuck::cast_slice(&flat(v)[range]).to_vec()
            }
            (VoxelGridValues::U8(v), _) => to_bytes(&flat(v)[range], |v| normalise(f32::from(v))),
            (VoxelGridValues::U16(v), _) => to_bytes(&flat(v)[range], |v| normalise(f32::from(v))),
            (VoxelGridValues::I16(v), _) => to_bytes(&flat(v)[range], |v| normalise(f32::from(v))),
            (VoxelGridValues::F32(v), _) => to_bytes(&flat(v)[range], normalise),
        })
    }

    /// Uploads the voxels' own colours, multiplied by their weights for correct hardware filtering.
    fn upload_colors(
        &self,
        colors: &Colors,
        size: [usize; 3],
        factors: [usize; 3],
    ) -> Result<wgpu::TextureView> {
        let software = self.device.is_software()
            && self
                .device
                .device
                .features()
                .contains(Features::TEXTURE_FORMAT_16BIT_NORM);
        let format = if software {
            TextureFormat::Rgba16Unorm
        } else {
            TextureFormat::Rgba8Unorm
        };
        let shown: [usize; 3] = std::array::from_fn(|a| size[a].div_ceil(factors[a]));
        let texture = self.texture_3d("colours", shown, format)?;
        self.in_pieces(&texture, shown, |range| {
            let texels = if factors == [1; 3] {
                colors.rgba8(range)
            } else {
                colors.reduced(size, factors, range)
            };
            if software {
                to_bytes(texels.as_flattened(), |v| u16::from(v) * 257)
            } else {
                texels.into_flattened()
            }
        })?;
        Ok(texture.create_view(&wgpu::TextureViewDescriptor::default()))
    }

    /// Writes whole layers at once: `bytes` of a range of voxels.
    fn in_pieces(
        &self,
        texture: &wgpu::Texture,
        size: [usize; 3],
        bytes: impl Fn(std::ops::Range<usize>) -> Vec<u8>,
    ) -> Result<()> {
        let layer = size[0] * size[1];
        let layers_at_once = (PIECE / (layer * 4).max(1)).max(1);
        for (n, first) in (0..size[2]).step_by(layers_at_once).enumerate() {
            let range = first * layer..(first + layers_at_once).min(size[2]) * layer;
            self.write_layers(texture, first, &bytes(range), size);
            if n % 4 == 3 {
                // Staging memory is freed only when a submission is done.
                self.device.queue.submit([]);
                wait(&self.device.device)?;
            }
        }
        Ok(())
    }
}

/// The volume on the device.
#[derive(Default)]
pub(super) struct VolumeCache {
    pub texture: Option<VolumeTexture>,
    /// Limits below the device's: voxels along an axis, and bytes.
    limits: Option<(usize, u64)>,
}

impl VolumeCache {
    /// Limits volumes below the device's limits: voxels along an axis, and bytes of a texture.
    /// Larger volumes are reduced.
    pub fn limit(&mut self, max_voxels: usize, max_bytes: u64) {
        self.limits = Some((max_voxels, max_bytes));
        self.texture = None;
    }

    /// A cache with the same limits that holds nothing.
    pub fn emptied(&self) -> Self {
        Self {
            texture: None,
            limits: self.limits,
        }
    }

    /// Uploads the volume to the GPU unless it is already there.
    pub(super) fn upload(
        &mut self,
        context: &Context,
        grid: &VoxelGrid,
        colors: Option<&Colors>,
    ) -> Result<()> {
        let identity = (grid.voxels.identity(), colors.is_some());
        if self.texture.as_ref().is_some_and(|v| v.identity == identity) {
            return Ok(());
        }
        self.texture = None;
        context.forget_groups();
        context.tally.count(ResourceKind::Volume);
        let limits = context.device.device.limits();
        let (max_voxels, max_bytes) = self.limits.unwrap_or((usize::MAX, u64::MAX));
        let max_voxels = max_voxels.min(limits.max_texture_dimension_3d as usize);
        let max_bytes = max_bytes.min(limits.max_buffer_size);
        let format = context.volume_format(grid);
        let texel =
            u64::from(format.block_copy_size(None).unwrap_or(4)).max(if colors.is_some() { 4 } else { 1 });
        let factors = factors(grid.size, texel, max_voxels, max_bytes);
        let reduced = (factors != [1; 3]).then(|| grid.reduced(factors));
        let shown = reduced.as_ref().unwrap_or(grid);
        // A function is sampled itself.
        let notice = reduced.as_ref().filter(|_| grid.function.is_none()).map(|r| {
            let by = |s: [usize; 3]| format!("{} x {} x {}", s[0], s[1], s[2]);
            format!(
                "the volume of {} voxels exceeds this GPU's limits and is downsampled to {}; use --backend cpu for full resolution",
                by(grid.size),
                by(r.size)
            )
        });
        let texture = context.texture_3d("volume", shown.size, format)?;
        context.write_voxels(&texture, shown, format)?;
        let colors = match colors {
            Some(colors) => Some(context.upload_colors(colors, grid.size, factors)?),
            None => None,
        };
        let (scale, offset) = match (&shown.voxels, format) {
            (_, TextureFormat::R16Float) => (1.0, 0.0),
            (VoxelGridValues::U8(_), _) => (255.0 * shown.scale, shown.offset),
            (VoxelGridValues::U16(_), _) => (65535.0 * shown.scale, shown.offset),
            (VoxelGridValues::I16(_), _) => (65535.0 * shown.scale, shown.offset - 32768.0 * shown.scale),
            (VoxelGridValues::F32(_), _) => (shown.scale, shown.offset),
        };
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let texture_span_voxels = std::array::from_fn(|a| (shown.size[a] * factors[a]) as f32);
        self.texture = Some(VolumeTexture {
            identity,
            _voxels: grid.voxels.clone(),
            view,
            colors,
            gradients: None,
            scale,
            offset,
            texture_span_voxels,
            notice,
        });
        Ok(())
    }

    /// Bytes of the volume's textures on the device: values with colours, and gradients.
    pub fn bytes(&self) -> [u64; 2] {
        let bytes = |view: &wgpu::TextureView| {
            let texture = view.texture();
            let texels = u64::from(texture.width())
                * u64::from(texture.height())
                * u64::from(texture.depth_or_array_layers());
            texels * u64::from(texture.format().block_copy_size(None).unwrap_or(0))
        };
        self.texture.as_ref().map_or([0; 2], |v| {
            [
                bytes(&v.view) + v.colors.as_ref().map_or(0, bytes),
                v.gradients.as_ref().map_or(0, bytes),
            ]
        })
    }

    /// Uploads the scene's gradient volume, if there is one, the volume is not reduced, and the
    /// device can filter it.
    pub(super) fn upload_gradients(&mut self, context: &Context, scene: &Prepared) -> Result<()> {
        let size = scene.volume().grid.size;
        let fits = |v: &VolumeTexture| v.gradients.is_none() && v.notice.is_none();
        let limits = context.device.device.limits();
        let bytes = size.iter().map(|&n| n as u64).product::<u64>() * 8;
        if !self.texture.as_ref().is_some_and(fits)
            || !context
                .device
                .device
                .features()
                .contains(Features::TEXTURE_FORMAT_16BIT_NORM)
            || bytes
                > self
                    .limits
                    .map_or(u64::MAX, |(_, bytes)| bytes)
                    .min(limits.max_buffer_size)
            || (bytes > MAX_GRADIENT_BYTES && !context.device.is_software())
        {
            return Ok(());
        }
        let Some(gradients) = scene.gradients_for_picture() else {
            return Ok(());
        };
        let texture = context.texture_3d("gradient volume", size, TextureFormat::Rgba16Snorm)?;
        context.in_pieces(&texture, size, |range| {
            bytemuck::cast_slice(&gradients.texels[range]).to_vec()
        })?;
        context.tally.count(ResourceKind::Volume);
        context.forget_groups();
        if let Some(volume) = &mut self.texture {
            volume.gradients = Some(texture.create_view(&wgpu::TextureViewDescriptor::default()));
        }
        Ok(())
    }
}

fn to_bytes<T: Copy + Send + Sync>(voxels: &[T], convert: impl Fn(T) -> u16 + Sync + Send) -> Vec<u8> {
    let converted: Vec<u16> = voxels.par_iter().map(|&v| convert(v)).collect();
    bytemuck::cast_slice(&converted).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_is_reduced() {
        assert_eq!(factors([2049, 100, 100], 2, 2048, u64::MAX), [2, 1, 1]);
        assert_eq!(factors([256; 3], 2, 2048, 1 << 30), [1; 3]);
        let f = factors([1024; 3], 2, 2048, 256 << 20);
        assert_eq!(f, [2; 3]);
        assert_eq!(factors([5, 1, 1], 4, 2048, 1), [5, 1, 1]);
    }
}
