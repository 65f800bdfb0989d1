//! Bringing results back to the CPU.

use super::wait;
use crate::{Error, Result};
use half::f16;

/// Rows of a texture copy are padded to this many bytes.
const ROW_ALIGNMENT: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;

/// The content of a buffer that can be mapped for reading.
///
/// # Errors
/// A lost device.
pub fn read_buffer(device: &wgpu::Device, buffer: &wgpu::Buffer) -> Result<Vec<u8>> {
    let (send, receive) = std::sync::mpsc::channel();
    buffer.map_async(wgpu::MapMode::Read, .., move |result| {
        // The receiver lives until the end of this function.
        let _sent = send.send(result);
    });
    wait(device)?;
    let mapped = receive.recv().map_err(|e| Error::Gpu(e.to_string()))?;
    mapped.map_err(|e| Error::Gpu(format!("reading back failed: {e}")))?;
    let view = buffer.get_mapped_range(..).map_err(|e| Error::Gpu(format!("reading back failed: {e}")))?;
    let bytes = view.to_vec();
    drop(view);
    buffer.unmap();
    Ok(bytes)
}

/// An Rgba16Float texture as rows of pixels.
///
/// # Errors
/// A lost device.
pub fn read_rgba16f(device: &wgpu::Device, queue: &wgpu::Queue, texture: &wgpu::Texture) -> Result<Vec<[f32; 4]>> {
    let bytes = read_texture(device, queue, texture, 8)?;
    Ok(bytes.chunks_exact(8).map(|p| std::array::from_fn(|c| f16::from_le_bytes([p[2 * c], p[2 * c + 1]]).to_f32())).collect())
}

/// An R32Float texture as rows of pixels.
///
/// # Errors
/// A lost device.
pub fn read_r32f(device: &wgpu::Device, queue: &wgpu::Queue, texture: &wgpu::Texture) -> Result<Vec<f32>> {
    let bytes = read_texture(device, queue, texture, 4)?;
    Ok(bytes.chunks_exact(4).map(|p| f32::from_le_bytes([p[0], p[1], p[2], p[3]])).collect())
}

/// The texels of a 2D texture, without the padding of its rows.
fn read_texture(device: &wgpu::Device, queue: &wgpu::Queue, texture: &wgpu::Texture, texel: u32) -> Result<Vec<u8>> {
    let (width, height) = (texture.width(), texture.height());
    let row_bytes = (width * texel).next_multiple_of(ROW_ALIGNMENT);
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("readback"),
        size: u64::from(row_bytes) * u64::from(height),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row_bytes), rows_per_image: Some(height) },
        },
        texture.size(),
    );
    queue.submit([encoder.finish()]);
    let bytes = read_buffer(device, &buffer)?;
    Ok(bytes.chunks_exact(row_bytes as usize).flat_map(|row| &row[..(width * texel) as usize]).copied().collect())
}
