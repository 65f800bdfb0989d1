//! A grid, and what is derived from its voxels alone and kept between pictures.

use crate::math::MinMaxPyramid;
use crate::math::pyramid::Range;
use crate::volume::{GradientVolume, Grid, GridVoxels, Voxel};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

/// A grid ready for rendering.
pub struct Sampled {
    /// The voxels.
    pub grid: Grid,
    /// Bounds of their normalised values.
    pub bounds: MinMaxPyramid<1>,
    gradients: OnceLock<Option<GradientVolume>>,
    asked_before: AtomicBool,
}

impl Sampled {
    /// Derives what every picture needs.
    pub fn new(grid: Grid) -> Self {
        let bounds = bounds_of(&grid);
        Self { grid, bounds, gradients: OnceLock::new(), asked_before: AtomicBool::new(false) }
    }

    /// The gradients of all voxels, if there is a volume of them: it is made when a second picture asks, since one picture alone costs less
    /// without. What is lit by it is the same to the bit.
    pub fn gradients(&self) -> Option<&GradientVolume> {
        if !self.asked_before.swap(true, Ordering::Relaxed) {
            return None;
        }
        self.gradients.get_or_init(|| GradientVolume::new(&self.grid)).as_ref()
    }
}

/// Bounds of the values of a grid.
fn bounds_of(grid: &Grid) -> MinMaxPyramid<1> {
    match &grid.voxels {
        GridVoxels::U8(v) => bounds_of_voxels(grid, v),
        GridVoxels::U16(v) => bounds_of_voxels(grid, v),
        GridVoxels::I16(v) => bounds_of_voxels(grid, v),
        GridVoxels::F32(v) => bounds_of_voxels(grid, v),
    }
}

fn bounds_of_voxels<T: Voxel>(grid: &Grid, voxels: &[T]) -> MinMaxPyramid<1> {
    let [nx, ny, _] = grid.size;
    MinMaxPyramid::from_runs(grid.size, 2, |first, last, j, k| {
        let row = (k * ny + j) * nx;
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for v in &voxels[row + first..=row + last] {
            let v = v.to_f32();
            (low, high) = (low.min(v), high.max(v));
        }
        let (a, b) = (low * grid.scale + grid.offset, high * grid.scale + grid.offset);
        // A negative slope turns the range around.
        Range { min: [a.min(b)], max: [a.max(b)] }
    })
}
