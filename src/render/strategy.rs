//! The strategy for a device: the same picture can be made in ways whose costs differ between
//! devices.

use crate::gpu::Device;
use crate::gpu::shaders::Program;

/// How a renderer makes its pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strategy {
    /// Shaders interpolate texels. Hardware filters round their weights to 8 bits: positions in a
    /// map of 3 mm texels become steps, and labels and holes bleed into their neighbours. Software
    /// drivers filter formats of 16 and 32 bits in 32 bits.
    pub exact_filter: bool,
    /// Rays are compute invocations instead of fragments. Server GPUs draw fragments on only a
    /// small part of their processors; llvmpipe is faster with fragments.
    pub compute_rays: bool,
    /// The device samples maps from their formulas and finds empty space: an edit waits for no
    /// upload. A software driver is no faster than the CPU, which tests blocks of cells before
    /// single cells.
    pub prepare: bool,
}

impl Strategy {
    /// The strategy that suits a device.
    pub fn of(device: &Device) -> Self {
        let hardware = !device.is_software();
        let computes = hardware && device.computes();
        Self {
            exact_filter: hardware,
            compute_rays: computes,
            prepare: computes,
        }
    }

    pub(super) fn rays(self) -> Program {
        if self.compute_rays {
            Program::RaycastCompute
        } else {
            Program::Raycast
        }
    }
}
