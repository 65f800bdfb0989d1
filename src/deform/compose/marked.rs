//! Precomposes a stack into one map, and marks the cells in which the map is not accurate enough.

use super::comparison::{Comparison, LAST_PROBES, MIN_GAIN, OF_BOUND, spread, worst_and_p99};
use super::grid::{Evaluate, MAX_SEARCH_TEXELS, cubes, finest, grid_for, grid_samples};
use crate::deform::{DisplacementMap, PlacedMap, Placement, PrecomposedMap, Stack, Storage, TexelSample};
use crate::math::Bounds;
use crate::{Result, Watch};
use glam::{Mat3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Texels along the longest axis of a precomposed map; the next size is tried where one marks too
/// many cells.
const PRECOMPOSED_TEXELS: [usize; 4] = [48, 80, 128, 192];
/// Points compared in the cells of one such map.
const CELL_PROBES: usize = 1_000_000;
/// Fraction of the space that may be marked: below it a finer map does not pay.
const FEW_MARKED: f32 = 0.12;
/// Fraction of the maps' work that a precomposed map must save, and fraction of the space that may
/// be marked however many maps there are.
const MIN_SAVED: f32 = 0.2;
const MAX_MARKED: f32 = 0.6;
/// Number of points per cell at which Jacobians are compared, and the largest allowed difference of
/// their components: normals turn by about as much, radians.
const SLOPE_PROBES: usize = 2;
const MAX_SLOPE_ERROR: f32 = 0.05;
/// Points after which a map that is far too coarse is rejected.
const SOME_CELLS: usize = 10_000;
/// Rounds of the final comparison, each of which marks the points it finds.
const LAST_ROUNDS: usize = 4;

/// The accuracy of a precomposed map.
#[derive(Clone, Copy, Debug)]
pub struct PrecomposeError {
    /// Largest error found inside the volume, mm.
    pub worst_mm: f32,
    /// 99th percentile of the error, mm.
    pub p99_mm: f32,
    /// Fraction of the occupied space in which the maps themselves are walked.
    pub fallback_share: f32,
}

/// One map that replaces a stack within `bound_mm` everywhere inside the volume, and marks where it
/// cannot: cells that a tear or a cut runs through, or in which the stack bends more than the grid
/// resolves. None, with the fraction that would have to be marked, where that saves too little.
///
/// # Errors
/// A placement that is not invertible; any error of the device; [`crate::Error::Cancelled`].
pub fn precompose(
    stack: &Stack,
    scene_box: &Bounds,
    bound_mm: f32,
    evaluate: Evaluate,
    watch: &Watch,
) -> Result<(Option<PrecomposedMap>, PrecomposeError)> {
    let mut precompose_error = PrecomposeError {
        worst_mm: 0.0,
        p99_mm: 0.0,
        fallback_share: 1.0,
    };
    let Some(bounds) = cubes(stack) else {
        return Ok((None, precompose_error));
    };
    let placement = Placement::new(bounds.center(), bounds.size(), Vec3::ZERO)?;
    let size_mm = placement.size_mm();
    let finest = finest(size_mm, MAX_SEARCH_TEXELS);
    let exact = |p: &Vec3| stack.source_and_alpha_unclipped(*p);
    let comparison = Comparison {
        exact: &exact,
        scene_box,
    };
    // Every sample costs one map; a sample in a marked cell also costs all the others.
    let max_marked = (1.0 - MIN_SAVED - 1.0 / stack.maps().len() as f32).min(MAX_MARKED);
    let mut best: Option<MarkedGrid> = None;
    for texels in PRECOMPOSED_TEXELS.map(|n| n.min(finest)) {
        watch.check()?;
        if best.as_ref().is_some_and(|b| b.size == grid_for(size_mm, texels)) {
            break;
        }
        let mut grid = MarkedGrid::new(stack, &placement, grid_for(size_mm, texels), bound_mm, evaluate)?;
        // Far too coarse: not worth testing every cell.
        let about = grid.bad_share_of_some(&comparison, bound_mm);
        if about > max_marked {
            precompose_error.fallback_share = precompose_error.fallback_share.min(about);
            continue;
        }
        grid.find_bad_cells(&comparison, stack, bound_mm, watch)?;
        let gained = best.as_ref().is_none_or(|b| grid.share() < MIN_GAIN * b.share());
        if gained {
            best = Some(grid);
        }
        let share = best.as_ref().map_or(1.0, MarkedGrid::share);
        if share <= FEW_MARKED || !gained && share <= max_marked {
            break;
        }
    }
    let Some(mut grid) = best else {
        return Ok((None, precompose_error));
    };
    // A final comparison at many other points; the cells of those with too large an error are
    // marked as well.
    for _ in 0..LAST_ROUNDS {
        watch.check()?;
        precompose_error.fallback_share = grid.share();
        if precompose_error.fallback_share > max_marked {
            return Ok((None, precompose_error));
        }
        let precomposed = PrecomposedMap {
            map: grid.marked_map(),
            bound_mm,
        };
        let with = Stack::new(stack.maps().to_vec()).with_precomposed(precomposed.clone());
        let h = 0.25 * grid.texel_mm();
        let errors = comparison.errors(&|p| with.source_and_alpha(*p), &bounds, LAST_PROBES, h);
        let beyond: Vec<Vec3> = errors
            .iter()
            .filter(|(e, _)| *e > bound_mm)
            .map(|(_, p)| *p)
            .collect();
        if beyond.is_empty() {
            (precompose_error.worst_mm, precompose_error.p99_mm) =
                worst_and_p99(errors.into_iter().map(|(e, _)| e).collect());
            return Ok((Some(precomposed), precompose_error));
        }
        grid.mark_around(&beyond);
    }
    Ok((None, precompose_error))
}

/// Whether two Jacobians lead to visibly different lighting.
fn differs(a: &Mat3, b: &Mat3) -> bool {
    (*a - *b)
        .to_cols_array()
        .iter()
        .any(|v| v.abs() > MAX_SLOPE_ERROR)
}

/// A composite under construction: samples, and the cells between them that are not accurate
/// enough.
struct MarkedGrid {
    size: [usize; 3],
    placement: Placement,
    storage: Storage,
    samples: Vec<TexelSample>,
    bad: Vec<bool>,
    /// Cells in which some point is present.
    occupied: Vec<bool>,
}

impl MarkedGrid {
    fn new(
        stack: &Stack,
        placement: &Placement,
        size: [usize; 3],
        bound_mm: f32,
        evaluate: Evaluate,
    ) -> Result<Self> {
        let samples = grid_samples(placement, size, &|points| evaluate(stack, points))?;
        // The rounding of half precision must be negligible.
        let largest = samples
            .par_iter()
            .map(|s| s.displacement.abs().max_element())
            .reduce(|| 0.0, f32::max);
        let rounding = largest * placement.size_mm().max_element() / 2048.0;
        let storage = if rounding > 0.2 * bound_mm {
            Storage::F32
        } else {
            Storage::F16
        };
        let cells = Self::cells_of(size).iter().product();
        Ok(Self {
            size,
            placement: *placement,
            storage,
            samples,
            bad: vec![false; cells],
            occupied: vec![false; cells],
        })
    }

    fn cells_of(size: [usize; 3]) -> [usize; 3] {
        size.map(|n| n.saturating_sub(1).max(1))
    }

    fn texel_mm(&self) -> f32 {
        (self.placement.size_mm() / Vec3::from(Self::cells_of(self.size).map(|n| n as f32))).max_element()
    }

    /// Fraction of the occupied cells that are bad.
    fn share(&self) -> f32 {
        let (bad, occupied) = self
            .bad
            .iter()
            .zip(&self.occupied)
            .fold((0usize, 0usize), |(bad, occupied), (b, s)| {
                (bad + usize::from(*b && *s), occupied + usize::from(*s))
            });
        bad as f32 / occupied.max(1) as f32
    }

    fn placed(&self) -> PlacedMap {
        let map = DisplacementMap::from_samples(self.size, self.storage, self.samples.clone());
        PlacedMap::new(Arc::new(map), self.placement)
    }

    /// Fraction of bad cells, estimated from some of the occupied ones.
    fn bad_share_of_some(&self, comparison: &Comparison, bound_mm: f32) -> f32 {
        let placed = self.placed();
        let errors = comparison.errors(
            &|p| placed.backward(*p),
            &placed.bounds_in_world(),
            SOME_CELLS,
            0.25 * self.texel_mm(),
        );
        errors.iter().filter(|(e, _)| *e > OF_BOUND * bound_mm).count() as f32 / errors.len().max(1) as f32
    }

    /// Finds the cells in which the composite is not accurate enough, and their neighbours: a tear
    /// may graze a cell without meeting a point that is compared.
    fn find_bad_cells(
        &mut self,
        comparison: &Comparison,
        stack: &Stack,
        bound_mm: f32,
        watch: &Watch,
    ) -> Result<()> {
        let placed = self.placed();
        let cells = Self::cells_of(self.size);
        let edge = Vec3::from(cells.map(|n| 1.0 / n as f32));
        let each = (CELL_PROBES / self.bad.len()).clamp(2, 12);
        let h = 0.25 * self.texel_mm();
        let of_cell = |n: usize| -> (bool, bool) {
            let low = Vec3::new(
                (n % cells[0]) as f32,
                (n / cells[0] % cells[1]) as f32,
                (n / (cells[0] * cells[1])) as f32,
            );
            let (mut bad, mut occupied) = (false, false);
            for k in 0..each {
                let p = self
                    .placement
                    .world_from_map
                    .transform_point3((low + spread(n * each + k)) * edge);
                if let Some(error) = comparison.error(&|p| placed.backward(*p), p, h) {
                    occupied = true;
                    bad |= error > OF_BOUND * bound_mm;
                    // A kink affects lighting long before it visibly affects positions.
                    bad = bad
                        || k < SLOPE_PROBES
                            && placed
                                .derivatives(p)
                                .is_some_and(|(j, _)| differs(&j, &stack.jet(p).d_source_d_deformed));
                }
            }
            (bad, occupied)
        };
        let found: Vec<(bool, bool)> = (0..self.bad.len())
            .into_par_iter()
            .with_min_len(256)
            .map(|n| {
                if watch.is_cancelled() {
                    (false, false)
                } else {
                    of_cell(n)
                }
            })
            .collect();
        watch.check()?;
        self.occupied = found.iter().map(|f| f.1).collect();
        self.bad = self.grown(&found.iter().map(|f| f.0).collect::<Vec<_>>());
        Ok(())
    }

    /// The cells and their neighbours.
    fn grown(&self, of: &[bool]) -> Vec<bool> {
        let cells = Self::cells_of(self.size);
        let strides = [1, cells[0], cells[0] * cells[1]];
        let mut grown = of.to_vec();
        for axis in 0..3 {
            let before = grown.clone();
            grown.par_iter_mut().enumerate().for_each(|(n, bad)| {
                let at = n / strides[axis] % cells[axis];
                *bad |=
                    at > 0 && before[n - strides[axis]] || at + 1 < cells[axis] && before[n + strides[axis]];
            });
        }
        grown
    }

    fn mark_around(&mut self, points: &[Vec3]) {
        let cells = Self::cells_of(self.size);
        let mut found = vec![false; self.bad.len()];
        for p in points {
            let x = self.placement.map_from_world.transform_point3(*p);
            let at: [usize; 3] =
                std::array::from_fn(|a| ((x[a] * cells[a] as f32) as usize).min(cells[a] - 1));
            found[(at[2] * cells[1] + at[1]) * cells[0] + at[0]] = true;
        }
        let grown = self.grown(&found);
        self.bad
            .iter_mut()
            .zip(grown)
            .for_each(|(bad, more)| *bad |= more);
    }

    /// The map with the texels at the corners of bad cells marked.
    fn marked_map(&self) -> PlacedMap {
        let cells = Self::cells_of(self.size);
        let mut marked = vec![false; self.samples.len()];
        for (n, _) in self.bad.iter().enumerate().filter(|(_, bad)| **bad) {
            let at = [n % cells[0], n / cells[0] % cells[1], n / (cells[0] * cells[1])];
            for corner in 0..8usize {
                let c: [usize; 3] =
                    std::array::from_fn(|a| (at[a] + (corner >> a & 1)).min(self.size[a] - 1));
                marked[(c[2] * self.size[1] + c[1]) * self.size[0] + c[0]] = true;
            }
        }
        let map =
            DisplacementMap::from_marked_samples(self.size, self.storage, self.samples.clone(), &marked);
        PlacedMap::new(Arc::new(map), self.placement)
    }
}
