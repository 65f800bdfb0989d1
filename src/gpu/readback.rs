//! Bringing results back to the CPU.

use super::wait;
use crate::{Error, Result};
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

/// Rows of a texture copy are padded to this many bytes.
const ROW_ALIGNMENT: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;

/// Maps a buffer and passes its content on.
fn mapped<T>(
    device: &wgpu::Device,
    buffer: &wgpu::Buffer,
    use_bytes: impl FnOnce(&[u8]) -> Result<T>,
) -> Result<T> {
    let (send, receive) = std::sync::mpsc::channel();
    buffer.map_async(wgpu::MapMode::Read, .., move |result| {
        // The receiver lives until the end of this function.
        let _sent = send.send(result);
    });
    wait(device)?;
    let mapped = receive.recv().map_err(|e| Error::Gpu(e.to_string()))?;
    mapped.map_err(|e| Error::Gpu(format!("reading back failed: {e}")))?;
    let view = buffer
        .get_mapped_range(..)
        .map_err(|e| Error::Gpu(format!("reading back failed: {e}")))?;
    let result = use_bytes(&view);
    drop(view);
    buffer.unmap();
    result
}

/// The content of a buffer that can be mapped for reading.
///
/// # Errors
/// A lost device.
pub fn read_buffer(device: &wgpu::Device, buffer: &wgpu::Buffer) -> Result<Vec<u8>> {
    mapped(device, buffer, |bytes| Ok(bytes.to_vec()))
}

/// An Rgba16Float or Rgba32Float texture as rows of pixels, through a mappable buffer of
/// [`texture_bytes`].
///
/// # Errors
/// A lost device.
pub fn read_picture(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    texture: &wgpu::Texture,
    through: &wgpu::Buffer,
) -> Result<Vec<[f32; 4]>> {
    let row_texels = texture.width() as usize;
    let mut pixels = vec![[0.0f32; 4]; row_texels * texture.height() as usize];
    copy(device, queue, texture, through);
    mapped(device, through, |bytes| {
        if texture.format() == wgpu::TextureFormat::Rgba32Float {
            let padded = row_bytes(texture) as usize;
            for (row, bytes) in pixels.chunks_mut(row_texels).zip(bytes.chunks_exact(padded)) {
                bytemuck::cast_slice_mut(row).copy_from_slice(&bytes[..16 * row_texels]);
            }
            return Ok(());
        }
        let halves: &[f16] =
            bytemuck::try_cast_slice(bytes).map_err(|e| Error::Gpu(format!("reading back failed: {e}")))?;
        let padded = row_bytes(texture) as usize / 2;
        pixels
            .par_chunks_mut(row_texels)
            .zip(halves.par_chunks_exact(padded))
            .for_each(|(row, halves)| {
                halves[..4 * row_texels].convert_to_f32_slice(row.as_flattened_mut());
            });
        Ok(())
    })?;
    Ok(pixels)
}

/// An R32Float texture as rows of pixels, through a buffer as for [`read_picture`].
///
/// # Errors
/// A lost device.
pub fn read_r32f(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    texture: &wgpu::Texture,
    through: &wgpu::Buffer,
) -> Result<Vec<f32>> {
    copy(device, queue, texture, through);
    mapped(device, through, |bytes| {
        let texels: &[f32] =
            bytemuck::try_cast_slice(bytes).map_err(|e| Error::Gpu(format!("reading back failed: {e}")))?;
        // The buffer may be larger than this picture.
        let rows = texels
            .chunks_exact(row_bytes(texture) as usize / 4)
            .take(texture.height() as usize);
        Ok(rows
            .flat_map(|row| &row[..texture.width() as usize])
            .copied()
            .collect())
    })
}

fn row_bytes(texture: &wgpu::Texture) -> u32 {
    (texture.width() * texture.format().block_copy_size(None).unwrap_or(16)).next_multiple_of(ROW_ALIGNMENT)
}

/// Bytes of a 2D texture copied to a buffer, with padded rows.
pub fn texture_bytes(texture: &wgpu::Texture) -> u64 {
    u64::from(row_bytes(texture)) * u64::from(texture.height())
}

fn copy(device: &wgpu::Device, queue: &wgpu::Queue, texture: &wgpu::Texture, buffer: &wgpu::Buffer) {
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(row_bytes(texture)),
                rows_per_image: Some(texture.height()),
            },
        },
        texture.size(),
    );
    queue.submit([encoder.finish()]);
}
