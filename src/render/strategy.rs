//! What suits a device: the same picture can be made in ways that differ in cost from device to device.

use crate::gpu::Device;
use crate::gpu::shaders::Program;

/// How a renderer makes its pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strategy {
    /// Texels are mixed by the shaders. Hardware filters round their weights to 8 bits: positions in a map of 3 mm texels come out in steps, labels and
    /// holes get a share of their neighbours'. Software drivers filter formats of 16 and 32 bits in 32 bits.
    pub exact_filter: bool,
    /// Rays are invocations of a compute shader, not fragments. Server GPUs draw fragments on a small part of their processors; llvmpipe is
    /// faster at fragments.
    pub compute_rays: bool,
    /// Maps are sampled from their formulas, and empty space is found, by the device: an edit waits for no upload. A software driver is no faster than
    /// the CPU, which asks blocks of cells before their cells.
    pub prepare: bool,
}

impl Strategy {
    /// What suits a device.
    pub fn of(device: &Device) -> Self {
        let hardware = !device.is_software();
        let computes = hardware && device.computes();
        Self { exact_filter: hardware, compute_rays: computes, prepare: computes }
    }

    pub(super) fn rays(self) -> Program {
        if self.compute_rays { Program::RaycastCompute } else { Program::Raycast }
    }
}
