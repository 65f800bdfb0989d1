//! wgpu without knowledge of volumes: opening a device, the table of shaders, uploading and reading
//! back.

mod device;
mod readback;
pub mod shaders;

pub use device::{AdapterPreference, Device};
pub use readback::{read_buffer, read_picture, read_r32f, texture_bytes};

use crate::{Error, Result};

/// Runs GPU work and converts errors reported by wgpu (validation, memory) to ours.
///
/// # Errors
/// The first error reported by wgpu, or the work's own.
pub fn checked<T>(device: &wgpu::Device, work: impl FnOnce() -> Result<T>) -> Result<T> {
    let memory = device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
    let validation = device.push_error_scope(wgpu::ErrorFilter::Validation);
    let internal = device.push_error_scope(wgpu::ErrorFilter::Internal);
    let result = work();
    let problems = [
        pollster::block_on(internal.pop()),
        pollster::block_on(validation.pop()),
        pollster::block_on(memory.pop()),
    ];
    match problems.into_iter().flatten().next() {
        Some(problem) => Err(Error::Gpu(problem.to_string())),
        None => result,
    }
}

/// Waits until everything submitted is done.
///
/// # Errors
/// A lost device.
pub fn wait(device: &wgpu::Device) -> Result<()> {
    device
        .poll(wgpu::PollType::wait_indefinitely())
        .map_err(|e| Error::Gpu(format!("the device stopped answering: {e}")))?;
    Ok(())
}

/// Waits until one submission, and all before it, are done; later ones may still be running.
///
/// # Errors
/// A lost device.
pub fn wait_for(device: &wgpu::Device, submission: wgpu::SubmissionIndex) -> Result<()> {
    let wanted = wgpu::PollType::Wait {
        submission_index: Some(submission),
        timeout: None,
    };
    device
        .poll(wanted)
        .map_err(|e| Error::Gpu(format!("the device stopped answering: {e}")))?;
    Ok(())
}
