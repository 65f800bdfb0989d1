//! A grid, and data derived from its voxels and cached between pictures.

use super::accelerator::Accelerator;
use super::macrocells::{CellGrid, MacrocellKey, Macrocells, VisibilityCriteria};
use crate::Result;
use crate::math::flat;
use crate::math::pyramid::ChannelRange;
use crate::math::{Bounds, MinMaxPyramid};
use crate::transfer::{TransferTable, single_value_error};
use crate::volume::function::{Interval, VolumeFunction};
use crate::volume::{GradientVolume, Voxel, VoxelGrid, VoxelGridValues};
use glam::Vec3;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// A grid ready for rendering.
pub struct SampledVolume {
    /// The voxels.
    pub grid: VoxelGrid,
    /// Bounds of their normalised values.
    pub bounds: MinMaxPyramid<1>,
    gradients: OnceLock<Option<GradientVolume>>,
    value_steps: OnceLock<Vec<[f32; 2]>>,
    step_error: Mutex<Option<StepError>>,
    /// Number of pictures that could use the gradients.
    pictures: AtomicUsize,
    /// The most recently used last.
    macrocells: Mutex<Vec<(MacrocellKey, Arc<Macrocells>)>>,
}

/// Number of voxels at which it is measured how fast values change.
const MAX_VALUE_STEPS: usize = 1 << 17;
/// The fractional part of the golden section.
const GOLDEN_SECTION: f64 = 0.618_033_988_749_895;

/// The last error of single values, and what it is of.
struct StepError {
    entries: Vec<[f32; 4]>,
    /// Scale and offset of the table, and the length of a step.
    scale: [f32; 3],
    error: f32,
}

/// Number of cached macrocell grids: a window shows one scene in several views.
const MAX_CACHED_MACROCELLS: usize = 4;

impl SampledVolume {
    /// Derives the data that every picture needs.
    pub fn new(grid: VoxelGrid) -> Self {
        let bounds = value_pyramid_of(&grid);
        Self {
            grid,
            bounds,
            gradients: OnceLock::new(),
            value_steps: OnceLock::new(),
            step_error: Mutex::default(),
            pictures: AtomicUsize::new(0),
            macrocells: Mutex::default(),
        }
    }

    /// [`Macrocells::new`], or a cached grid of the same inputs: empty space does not depend on the
    /// camera or the light.
    ///
    /// # Errors
    /// Any error of a device that computes them.
    pub fn macrocells(
        &self,
        bounds: Bounds,
        voxel_mm: f32,
        contents: &VisibilityCriteria,
        device: &dyn Accelerator,
    ) -> Result<Arc<Macrocells>> {
        let inputs = MacrocellKey::of(bounds, voxel_mm, contents);
        // Entries are only added as a whole.
        let lock = || self.macrocells.lock().unwrap_or_else(PoisonError::into_inner);
        let found = {
            let mut entries = lock();
            entries.iter().position(|(of, _)| *of == inputs).map(|at| {
                let entry = entries.remove(at);
                let cells = entry.1.clone();
                entries.push(entry);
                cells
            })
        };
        if let Some(cells) = found {
            return Ok(cells);
        }
        let grid = CellGrid::over(bounds, voxel_mm);
        let cells = Arc::new(match device.classify(&grid, contents, &self.grid)? {
            Some(flags) => Macrocells::of_flags(&grid, &flags),
            None => Macrocells::new(bounds, voxel_mm, contents),
        });
        let mut entries = lock();
        if entries.len() == MAX_CACHED_MACROCELLS {
            entries.remove(0);
        }
        entries.push((inputs, cells.clone()));
        Ok(cells)
    }

    /// Normalised values at both ends of steps along the axes, at voxels spread over the grid: how
    /// fast the values change. `step`: voxels along each axis per reference length, a property of
    /// the grid.
    pub fn value_steps(&self, step: Vec3) -> &[[f32; 2]] {
        self.value_steps.get_or_init(|| {
            let [nx, ny, nz] = self.grid.size;
            let count = nx * ny * nz;
            let at = |n: usize| {
                // Multiples of the golden section are spread evenly, along rows as well.
                let part = (n as f64 * GOLDEN_SECTION).fract();
                let index = ((part * count as f64) as usize).min(count - 1);
                [index % nx, index / nx % ny, index / (nx * ny)]
            };
            let along = |at: [usize; 3], axis: usize| {
                let mut next = at;
                next[axis] += 1;
                let [a, b] = [at, next].map(|[i, j, k]| self.grid.value(i, j, k));
                (!self.grid.has_holes || a.min(b) >= -1e-4).then(|| [a, a + (b - a) * step[axis]])
            };
            (0..MAX_VALUE_STEPS.min(count))
                .map(|n| (at(n), n % 3))
                .filter(|(at, axis)| at[*axis] + 1 < self.grid.size[*axis])
                .filter_map(|(at, axis)| along(at, axis))
                .collect()
        })
    }

    /// [`single_value_error`] for steps of `length` reference lengths. The last one is kept: it does
    /// not depend on the camera. `step`: as for [`Self::value_steps`].
    pub fn single_value_error(&self, table: &TransferTable, step: Vec3, length: f32) -> f32 {
        let scale = [table.scale, table.offset, length];
        let mut last = self.step_error.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(of) = last.as_ref()
            && of.scale == scale
            && of.entries == table.entries
        {
            return of.error;
        }
        let steps = self.value_steps(step).iter();
        let error = single_value_error(table, steps.map(|&[a, b]| [a, a + (b - a) * length]), length);
        *last = Some(StepError {
            entries: table.entries.clone(),
            scale,
            error,
        });
        error
    }

    /// Counts one more picture that could use the gradients; returns the count.
    pub fn count_picture(&self) -> usize {
        self.pictures.fetch_add(1, Ordering::Relaxed) + 1
    }

    /// Computes the gradients of all voxels, unless they exist or do not fit into memory.
    pub fn make_gradients(&self) -> Option<&GradientVolume> {
        self.gradients
            .get_or_init(|| GradientVolume::new(&self.grid))
            .as_ref()
    }

    /// The gradients of all voxels, if they have been computed.
    pub fn gradients(&self) -> Option<&GradientVolume> {
        self.gradients.get()?.as_ref()
    }
}

/// log2 of the voxels' distances per finest node of their bounds.
const VALUE_PYRAMID_SHIFT: u32 = 2;

/// Bounds of the values of a grid.
fn value_pyramid_of(grid: &VoxelGrid) -> MinMaxPyramid<1> {
    if let Some(function) = &grid.function {
        return value_pyramid_of_function(grid, function);
    }
    match &grid.voxels {
        VoxelGridValues::U8(v) => value_pyramid_of_voxels(grid, flat(v)),
        VoxelGridValues::U16(v) => value_pyramid_of_voxels(grid, flat(v)),
        VoxelGridValues::I16(v) => value_pyramid_of_voxels(grid, flat(v)),
        VoxelGridValues::F32(v) => value_pyramid_of_voxels(grid, flat(v)),
    }
}

/// Bounds of a function: unlike samples of voxels, its values follow from no values nearby.
fn value_pyramid_of_function(grid: &VoxelGrid, function: &VolumeFunction) -> MinMaxPyramid<1> {
    MinMaxPyramid::from_rows(grid.size, VALUE_PYRAMID_SHIFT, |boxes| {
        let in_voxel: Vec<Bounds> = boxes
            .iter()
            .map(|[first, last]| {
                // The outermost nodes also hold the half voxel beyond the outermost centres.
                let low = first.map(|n| if n == 0 { -0.5 } else { n as f32 });
                let high = std::array::from_fn(|a| {
                    last[a] as f32 + if last[a] + 1 == grid.size[a] { 0.5 } else { 0.0 }
                });
                Bounds::new(Vec3::from(low), Vec3::from_array(high))
            })
            .collect();
        let range = |i: Interval| ChannelRange {
            min: [i.low],
            max: [i.high],
        };
        function.bounds(&in_voxel).into_iter().map(range).collect()
    })
}

fn value_pyramid_of_voxels<T: Voxel>(grid: &VoxelGrid, voxels: &[T]) -> MinMaxPyramid<1> {
    let [nx, ny, _] = grid.size;
    MinMaxPyramid::from_runs(grid.size, VALUE_PYRAMID_SHIFT, |first, last, j, k| {
        let row = (k * ny + j) * nx;
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for v in &voxels[row + first..=row + last] {
            let v = v.to_f32();
            (low, high) = (low.min(v), high.max(v));
        }
        let (a, b) = (low * grid.scale + grid.offset, high * grid.scale + grid.offset);
        // A negative slope reverses the range.
        ChannelRange {
            min: [a.min(b)],
            max: [a.max(b)],
        }
    })
}
