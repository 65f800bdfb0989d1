//! Empty-space skipping under deformation: a coarse grid over the deformed scene that marks where
//! nothing is visible.
//!
//! *Theory*: [`crate::model`], "Empty space". A cell's box is carried backwards through the stack
//! with interval arithmetic. The result bounds the source points, hence the values (from the
//! volume's min/max pyramid), hence the opacity (from the transfer function's range maximum). Every
//! bound is conservative: skipping changes no picture.
//!
//! Cells store the chessboard distance to the nearest occupied cell rather than one bit: from an
//! empty cell at distance d, a ray leaves the whole block of empty cells around it in one step.
//!
//! Samples that read a step back (those near cuts; all of them where segments or grey faces are
//! shown) make a cell occupied by anything that far away; other cells are occupied by their own
//! contents alone. Occupied cells also record whether any cut except the volume's own faces can
//! affect them ([`CUT_FREE`]): in most cells none can, and no sample there evaluates cuts.

pub use super::visibility::{BoxVisibility, MacrocellKey, VisibilityCriteria};

use crate::math::Bounds;
use crate::math::lanes::*;
use glam::{UVec3, Vec3};
use rayon::prelude::*;
use std::sync::OnceLock;

/// Maximum number of cells along an axis.
const MAX_CELLS: f32 = 64.0;

/// Cells along the edge of the blocks tested first.
const BLOCK: u32 = 8;

/// An occupied cell for whose samples no mask varies and no shape is near: the only cuts that can
/// affect them are the volume's own faces.
pub const CUT_FREE: u8 = 255;

/// The grid.
pub struct Macrocells {
    /// Lower corner, mm.
    pub origin: Vec3,
    /// Edge of a cell along each axis, mm.
    pub cell_mm: Vec3,
    /// Cells along each axis.
    pub size: UVec3,
    /// Chessboard distance to the nearest occupied cell, x fastest; 0 is occupied, and so is 255
    /// (`CUT_FREE`).
    pub distance: Vec<u8>,
    /// The box of the occupied cells, mm; empty if there is none.
    pub occupied: Bounds,
    /// See [`Self::blocks`].
    blocks: OnceLock<Vec<u8>>,
    cells_per_mm: Vec3,
}

/// See [`Macrocells::blocks`].
const CUT_FREE_FLAG: u8 = 128;

/// The layout of a cell grid over the deformed scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellGrid {
    /// The box that the cells fill, mm.
    pub bounds: Bounds,
    /// Cells along each axis.
    pub size: UVec3,
    /// Edge of a cell along each axis, mm.
    pub cell_mm: Vec3,
    /// Margin by which a cell is enlarged, mm: a sample on its face may be assigned to either side.
    pub margin_mm: f32,
}

/// The state of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellState {
    /// Nothing is visible.
    Empty,
    /// Something may be visible.
    Occupied,
    /// Something may be visible, and no cut except the volume's own faces can affect it.
    CutFree,
}

impl CellGrid {
    /// Cells of about `edge` mm.
    pub fn new(bounds: Bounds, edge: f32) -> Self {
        let extent = bounds.size();
        let size = (extent / edge).ceil().max(Vec3::ONE);
        let cell_mm = extent / size;
        Self {
            bounds,
            size: size.as_uvec3(),
            cell_mm,
            margin_mm: 1e-3 * cell_mm.max_element(),
        }
    }

    /// Cells for a volume with voxels of `voxel_mm`: at least a few voxels large, and limited in
    /// number.
    pub fn over(bounds: Bounds, voxel_mm: f32) -> Self {
        Self::new(
            bounds,
            (bounds.size().max_element() / MAX_CELLS).max(3.0 * voxel_mm),
        )
    }

    /// The box between two corners of cells, with the margin.
    fn between(&self, low: UVec3, high: UVec3) -> Bounds {
        let corner = |c: UVec3| self.bounds.min + c.as_vec3() * self.cell_mm;
        Bounds::new(corner(low), corner(high)).grown(self.margin_mm)
    }
}

impl Macrocells {
    /// One occupied cell over everything, which skips nothing.
    pub fn solid(bounds: Bounds) -> Self {
        Self::of_distances(bounds.min, bounds.size(), UVec3::ONE, vec![0], bounds)
    }

    fn of_distances(origin: Vec3, cell_mm: Vec3, size: UVec3, distance: Vec<u8>, occupied: Bounds) -> Self {
        Self {
            origin,
            cell_mm,
            size,
            distance,
            occupied,
            blocks: OnceLock::new(),
            cells_per_mm: cell_mm.recip(),
        }
    }

    /// The form read by renderers: as `distance`, but for cut-free cells `CUT_FREE_FLAG` (128) plus
    /// their chessboard distance to the nearest cell that is not cut-free. Computed on first use.
    #[inline(always)]
    pub fn blocks(&self) -> &[u8] {
        match self.blocks.get() {
            Some(blocks) => blocks,
            None => self.find_blocks(),
        }
    }

    #[cold]
    fn find_blocks(&self) -> &[u8] {
        self.blocks.get_or_init(|| {
            let other: Vec<bool> = self.distance.iter().map(|d| *d != CUT_FREE).collect();
            let blocks = self.distance.iter().zip(chessboard_distance(&other, self.size));
            blocks
                .map(|(&d, inside)| {
                    if d == CUT_FREE {
                        CUT_FREE_FLAG + inside.min(CUT_FREE_FLAG - 1)
                    } else {
                        d.min(CUT_FREE_FLAG - 1)
                    }
                })
                .collect()
        })
    }

    /// Classifies a grid over `bounds`, the box of the deformed scene. Content that a sample reads
    /// further back counts at the position of the sample.
    pub fn new(bounds: Bounds, voxel_mm: f32, contents: &VisibilityCriteria) -> Self {
        contents.stack.fetch_texels();
        Self::classified(
            CellGrid::over(bounds, voxel_mm),
            |b| contents.visibility(b),
            |b| contents.near_cuts(b),
        )
    }

    /// The cells of a grid; occupied are those whose box shows anything, and cut-free are those of
    /// them that are not `near_cuts`.
    ///
    /// Blocks of cells are tested before their cells: a block that shows nothing, or something
    /// everywhere, is not subdivided.
    pub fn classified(
        grid: CellGrid,
        visibility: impl Fn(&Bounds) -> BoxVisibility + Sync,
        near_cuts: impl Fn(&Bounds) -> bool + Sync,
    ) -> Self {
        let size = grid.size;
        let blocks = UVec3::from(size.to_array().map(|n| n.div_ceil(BLOCK)));
        let between = |low: UVec3, high: UVec3| grid.between(low, high);
        let found: Vec<[Vec<UVec3>; 2]> = (0..blocks.element_product())
            .into_par_iter()
            .map(|index| {
                let low = UVec3::new(
                    index % blocks.x,
                    index / blocks.x % blocks.y,
                    index / blocks.x / blocks.y,
                ) * BLOCK;
                let high = size.min(low + BLOCK);
                let (mut cells, mut near) = (Vec::new(), Vec::new());
                occupied_cells(
                    &|low, high| visibility(&between(low, high)),
                    low,
                    high,
                    &mut cells,
                );
                if !cells.is_empty() {
                    occupied_cells(
                        &|low, high| {
                            if near_cuts(&between(low, high)) {
                                BoxVisibility::MaybeVisible
                            } else {
                                BoxVisibility::Invisible
                            }
                        },
                        low,
                        high,
                        &mut near,
                    );
                }
                [cells, near]
            })
            .collect();
        let mut flags = vec![CellState::Empty; size.element_product() as usize];
        let index = |cell: UVec3| ((cell.z * size.y + cell.y) * size.x + cell.x) as usize;
        for &cell in found.iter().flat_map(|[cells, _]| cells) {
            flags[index(cell)] = CellState::CutFree;
        }
        for &cell in found.iter().flat_map(|[_, near]| near) {
            let at = &mut flags[index(cell)];
            *at = if *at == CellState::CutFree {
                CellState::Occupied
            } else {
                *at
            };
        }
        Self::of_flags(&grid, &flags)
    }

    /// The cells of a grid from their states, x fastest.
    pub fn of_flags(grid: &CellGrid, flags: &[CellState]) -> Self {
        let CellGrid {
            bounds,
            size,
            cell_mm,
            ..
        } = *grid;
        let occupied: Vec<bool> = flags.iter().map(|f| *f != CellState::Empty).collect();
        let mut all: Option<(UVec3, UVec3)> = None;
        for (n, row) in occupied.chunks(size.x as usize).enumerate() {
            if let (Some(first), Some(last)) = (row.iter().position(|o| *o), row.iter().rposition(|o| *o)) {
                let (y, z) = (n as u32 % size.y, n as u32 / size.y);
                let (first, last) = (UVec3::new(first as u32, y, z), UVec3::new(last as u32, y, z));
                all = Some(all.map_or((first, last), |(low, high)| (low.min(first), high.max(last))));
            }
        }
        let mut distance = chessboard_distance(&occupied, size);
        distance
            .iter_mut()
            .zip(flags)
            .filter(|(_, f)| **f == CellState::CutFree)
            .for_each(|(d, _)| *d = CUT_FREE);
        let of_cells = |(low, high): (UVec3, UVec3)| {
            Bounds::new(
                bounds.min + low.as_vec3() * cell_mm,
                bounds.min + high.as_vec3() * cell_mm + cell_mm,
            )
        };
        Self::of_distances(
            bounds.min,
            cell_mm,
            size,
            distance,
            all.map_or(Bounds::EMPTY, of_cells),
        )
    }

    /// Whether a cell, by its flat index, may show anything.
    pub fn is_occupied(&self, index: usize) -> bool {
        matches!(self.distance[index], 0 | CUT_FREE)
    }

    /// The box of a cell by its flat index.
    pub fn cell_box(&self, index: usize) -> Bounds {
        cell_box(
            &Bounds::new(self.origin, self.origin),
            self.size,
            self.cell_mm,
            index as u32,
        )
    }

    /// Flat index of the cell at a point; the nearest cell for a point outside the grid.
    #[inline(always)]
    pub fn index(&self, p: Vec3) -> usize {
        let c = ((p - self.origin) / self.cell_mm)
            .floor()
            .clamp(Vec3::ZERO, (self.size - 1).as_vec3())
            .as_uvec3();
        ((c.z * self.size.y + c.y) * self.size.x + c.x) as usize
    }

    /// The parameter at which a ray at `p` leaves its cell, whether or not that is empty.
    pub fn leaves_cell(&self, p: Vec3, origin: Vec3, inverse_direction: Vec3) -> f32 {
        let cell = ((p - self.origin) / self.cell_mm)
            .floor()
            .clamp(Vec3::ZERO, (self.size - 1).as_vec3());
        let a = (self.origin + cell * self.cell_mm - origin) * inverse_direction;
        let b = (self.origin + (cell + 1.0) * self.cell_mm - origin) * inverse_direction;
        farther(a, b, inverse_direction).min_element()
    }

    /// How far a ray at `p` can skip: none in an occupied cell, else the parameter at which it
    /// leaves the empty block around it.
    ///
    /// `inverse_direction` is 1/d for the ray `origin + t d`.
    #[inline(always)]
    pub fn empty_until(&self, p: Vec3, origin: Vec3, inverse_direction: Vec3) -> Option<f32> {
        let last = (self.size - 1).as_vec3();
        let cell = ((p - self.origin) / self.cell_mm).floor().clamp(Vec3::ZERO, last);
        let c = cell.as_uvec3();
        let index = ((c.z * self.size.y + c.y) * self.size.x + c.x) as usize;
        if self.is_occupied(index) {
            return None;
        }
        let reach = f32::from(self.distance[index]);
        let low = self.origin + (cell - (reach - 1.0)) * self.cell_mm;
        let high = self.origin + (cell + reach) * self.cell_mm;
        let a = (low - origin) * inverse_direction;
        let b = (high - origin) * inverse_direction;
        Some(farther(a, b, inverse_direction).min_element())
    }
}

/// A ray with a larger reciprocal along an axis runs along that axis's planes: within a block of at
/// most 127 cells it moves across them by less than the margin of a cell.
const MAX_RECIPROCAL: f32 = 1e6;

/// The farther of a ray's parameters at two planes of each axis; a ray along a plane never leaves
/// through it.
#[inline(always)]
fn farther(a: Vec3, b: Vec3, inverse_direction: Vec3) -> Vec3 {
    let crosses = inverse_direction.abs().cmple(Vec3::splat(MAX_RECIPROCAL));
    Vec3::select(crosses, a.max(b), Vec3::INFINITY)
}

impl Macrocells {
    /// Cells along an axis, as floats and as indices.
    #[inline(always)]
    fn cells_along<S: Simd>(&self, p: f32x8<S>, axis: usize) -> (f32x8<S>, i32x8<S>) {
        // Positions below the first cell are clamped to it: truncation equals floor.
        let cell = ((p - self.origin[axis]) * self.cells_per_mm[axis])
            .to_int::<i32x8<S>>()
            .max(0)
            .min(self.size[axis] as i32 - 1);
        (cell.to_float(), cell)
    }

    /// Parameters at which rays leave the slabs of `reach` - 1 cells on both sides of their cell.
    #[inline(always)]
    fn leaves<S: Simd>(
        &self,
        cell: f32x8<S>,
        reach: f32x8<S>,
        origin: f32x8<S>,
        inverse: f32x8<S>,
        axis: usize,
    ) -> f32x8<S> {
        // The face towards which a ray heads. A ray along a face of the block multiplies zero by
        // infinity: NaN, which the minimum with the other axes drops.
        let face = (cell + 0.5) + (reach - 0.5).copysign(inverse);
        face.mul_add(self.cell_mm[axis], -origin + self.origin[axis]) * inverse
    }

    /// As [`Self::empty_until`] for eight points: which lie in empty cells, which in cut-free ones,
    /// and where rays leave the block of empty or cut-free cells around them; up to there no
    /// further lookup is needed.
    #[inline(always)]
    pub fn blocks_lanes<S: Simd>(
        &self,
        simd: S,
        p: Vec3x8<S>,
        origin: Vec3x8<S>,
        inverse_direction: Vec3x8<S>,
    ) -> (mask32x8<S>, mask32x8<S>, f32x8<S>) {
        let ((x, i), (y, j), (z, k)) = (
            self.cells_along(p.x, 0),
            self.cells_along(p.y, 1),
            self.cells_along(p.z, 2),
        );
        let size = self.size.as_ivec3();
        let index = (k * size.y + j) * size.x + i;
        let of_cells = self.blocks();
        let mut blocks = [0; LANES];
        for n in 0..LANES {
            blocks[n] = i32::from(of_cells[index[n] as usize]);
        }
        let blocks = i32x8::load_array(simd, blocks);
        let clear = blocks.simd_ge(i32::from(CUT_FREE_FLAG));
        let empty = blocks.simd_gt(0) & !clear;
        let reach = (blocks & i32::from(CUT_FREE_FLAG - 1)).to_float::<f32x8<S>>();
        let x = self.leaves(x, reach, origin.x, inverse_direction.x, 0);
        let y = self.leaves(y, reach, origin.y, inverse_direction.y, 1);
        let z = self.leaves(z, reach, origin.z, inverse_direction.z, 2);
        (empty, clear, x.min_precise(y).min_precise(z))
    }
}

impl Macrocells {
    /// Whether a box lies in one block of empty cells; boxes that do not may be empty, too.
    #[inline(always)]
    pub fn is_empty_block(&self, b: &Bounds) -> bool {
        let last = (self.size - 1).as_vec3();
        let cell = ((b.center() - self.origin) * self.cells_per_mm)
            .floor()
            .clamp(Vec3::ZERO, last);
        let c = cell.as_uvec3();
        let index = ((c.z * self.size.y + c.y) * self.size.x + c.x) as usize;
        if self.is_occupied(index) {
            return false;
        }
        let reach = f32::from(self.distance[index]);
        let low = self.origin + (cell - (reach - 1.0)) * self.cell_mm;
        let high = self.origin + (cell + reach) * self.cell_mm;
        // Nothing is visible outside the grid.
        let beyond = |inside: glam::BVec3, at_end: glam::BVec3| (inside | at_end).all();
        beyond(low.cmple(b.min), cell.cmple(reach - Vec3::ONE))
            && beyond(high.cmpge(b.max), (cell + reach).cmpgt(last))
    }

    /// Which of eight points lie in empty cells, and which in cut-free ones.
    #[inline(always)]
    pub fn states_lanes<S: Simd>(&self, simd: S, p: Vec3x8<S>) -> (mask32x8<S>, mask32x8<S>) {
        let [i, j, k] = [
            self.cells_along(p.x, 0).1,
            self.cells_along(p.y, 1).1,
            self.cells_along(p.z, 2).1,
        ];
        let size = self.size.as_ivec3();
        let index = (k * size.y + j) * size.x + i;
        let mut states = [0; LANES];
        for n in 0..LANES {
            states[n] = i32::from(self.distance[index[n] as usize]);
        }
        let states = i32x8::load_array(simd, states);
        let cut_free = states.simd_eq(i32::from(CUT_FREE));
        (states.simd_gt(0) & !cut_free, cut_free)
    }
}

/// The occupied cells from `low` to `high` (exclusive), from the visibility of boxes between
/// corners of cells.
fn occupied_cells(
    visibility: &impl Fn(UVec3, UVec3) -> BoxVisibility,
    low: UVec3,
    high: UVec3,
    cells: &mut Vec<UVec3>,
) {
    let extent = high - low;
    match visibility(low, high) {
        BoxVisibility::Invisible => {}
        BoxVisibility::MaybeVisible if extent.max_element() > 1 => {
            let middle = low + UVec3::from(extent.to_array().map(|n| n.div_ceil(2)));
            for octant in 0..8u32 {
                let upper = UVec3::new(octant & 1, octant >> 1 & 1, octant >> 2);
                let (from, to) = (low + upper * (middle - low), middle + upper * (high - middle));
                if from.cmplt(to).all() {
                    occupied_cells(visibility, from, to, cells);
                }
            }
        }
        _ => {
            for z in low.z..high.z {
                for y in low.y..high.y {
                    cells.extend((low.x..high.x).map(|x| UVec3::new(x, y, z)));
                }
            }
        }
    }
}

fn cell_box(bounds: &Bounds, size: UVec3, cell_mm: Vec3, index: u32) -> Bounds {
    let cell = UVec3::new(index % size.x, index / size.x % size.y, index / size.x / size.y).as_vec3();
    let low = bounds.min + cell * cell_mm;
    Bounds::new(low, low + cell_mm)
}

/// Chessboard distance of each cell to the nearest occupied one, at most 254: two passes over the
/// rows, forwards and backwards, each taking the smallest of the neighbours already visited plus
/// one (Rosenfeld and Pfaltz 1968: exact for this metric).
fn chessboard_distance(occupied: &[bool], size: UVec3) -> Vec<u8> {
    const FAR: u8 = CUT_FREE - 1;
    let [nx, ny, nz] = size.to_array().map(|n| n as usize);
    let mut distance: Vec<u8> = occupied.iter().map(|&o| if o { 0 } else { FAR }).collect();
    // The minimum of the rows around one, padded by a cell at both ends.
    let mut least = vec![FAR; nx + 2];
    for backwards in [false, true] {
        for n in 0..ny * nz {
            let n = if backwards { ny * nz - 1 - n } else { n };
            let (j, k) = ((n % ny) as isize, (n / ny) as isize);
            let before = if backwards { 1 } else { -1 };
            least.fill(FAR);
            for (j, k) in [
                (j + before, k),
                (j - 1, k + before),
                (j, k + before),
                (j + 1, k + before),
            ] {
                if (0..ny as isize).contains(&j) && (0..nz as isize).contains(&k) {
                    let row = &distance[(k as usize * ny + j as usize) * nx..][..nx];
                    least[1..=nx]
                        .iter_mut()
                        .zip(row)
                        .for_each(|(l, d)| *l = (*l).min(*d));
                }
            }
            let row = &mut distance[n * nx..][..nx];
            for ((d, l), (m, r)) in row.iter_mut().zip(&least).zip(least[1..].iter().zip(&least[2..])) {
                *d = (*d).min((*l).min(*m).min(*r).saturating_add(1));
            }
            let mut last = FAR;
            let along = |d: &mut u8| {
                last = (*d).min(last.saturating_add(1));
                *d = last;
            };
            if backwards {
                row.iter_mut().rev().for_each(along)
            } else {
                row.iter_mut().for_each(along)
            }
        }
    }
    distance
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_chessboard_distances() {
        let size = UVec3::new(7, 5, 6);
        let mut occupied = vec![false; 210];
        let seeds = [(1i32, 3i32, 4i32), (6, 0, 0)];
        for (x, y, z) in seeds {
            occupied[((z * 5 + y) * 7 + x) as usize] = true;
        }
        let distance = chessboard_distance(&occupied, size);
        for z in 0..6i32 {
            for y in 0..5i32 {
                for x in 0..7i32 {
                    let want = seeds
                        .iter()
                        .map(|s| (s.0 - x).abs().max((s.1 - y).abs()).max((s.2 - z).abs()))
                        .min();
                    assert_eq!(Some(i32::from(distance[((z * 5 + y) * 7 + x) as usize])), want);
                }
            }
        }
    }

    /// For empty cells, eight points get the same results as single points; for cut-free cells,
    /// every point up to the reported exit lies in a cut-free cell.
    #[test]
    fn blocks_are_those_of_cells() {
        struct BlocksKernel<'a>(&'a Macrocells, [Vec3; LANES], [Vec3; LANES]);
        impl SimdKernel for BlocksKernel<'_> {
            type Output = [(bool, bool, f32); LANES];
            #[inline(always)]
            fn run<S: Simd>(self, simd: S) -> Self::Output {
                let (origin, direction) = (
                    Vec3x8::from_lanes(simd, &self.1),
                    Vec3x8::from_lanes(simd, &self.2),
                );
                let one = f32x8::splat(simd, 1.0);
                let inverse = Vec3x8 {
                    x: one / direction.x,
                    y: one / direction.y,
                    z: one / direction.z,
                };
                let (empty, clear, exit) = self.0.blocks_lanes(simd, origin, origin, inverse);
                std::array::from_fn(|n| (empty.test(n), clear.test(n), exit[n]))
            }
        }
        let bounds = Bounds::new(Vec3::new(-3.0, 1.0, 2.0), Vec3::new(37.0, 31.0, 34.0));
        let ball = |b: &Bounds, radius: f32| (b.center() - bounds.center()).length() < radius;
        let visibility = |b: &Bounds| {
            if b.size().max_element() > 3.0 || ball(b, 13.0) {
                BoxVisibility::MaybeVisible
            } else {
                BoxVisibility::Invisible
            }
        };
        let cells = Macrocells::classified(CellGrid::new(bounds, 2.0), visibility, |b| {
            b.size().max_element() > 3.0 || !ball(b, 10.0)
        });
        let clear_at = |p: Vec3| cells.distance[cells.index(p)] == CUT_FREE;
        let (mut empties, mut clears, mut others, mut longest) = (0, 0, 0, 0.0f32);
        for n in 0..600 {
            let at = |m: usize| {
                bounds.min
                    + bounds.size()
                        * Vec3::from([7919, 104_729, 1_299_709].map(|p| (m * p % 10_007) as f32 / 10_007.0))
            };
            let points: [Vec3; LANES] = std::array::from_fn(|lane| at(n * 8 + lane + 1));
            let directions = std::array::from_fn(|lane| (at(n * 8 + lane + 77) - points[lane]).normalize());
            for (lane, (empty, clear, exit)) in with_simd(BlocksKernel(&cells, points, directions))
                .into_iter()
                .enumerate()
            {
                let (p, d) = (points[lane], directions[lane]);
                let single = cells.empty_until(p, p, d.recip());
                assert_eq!((empty, clear), (single.is_some(), clear_at(p)), "{p}");
                if let Some(single) = single {
                    assert!((exit - single).abs() < 1e-4, "{p} {d}: {exit} for {single}");
                    empties += 1;
                } else if clear {
                    assert!(
                        (1..20).all(|part| clear_at(p + d * (exit * part as f32 / 20.0))),
                        "{p} {d} {exit}"
                    );
                    longest = longest.max(exit);
                    clears += 1;
                } else {
                    others += 1;
                }
            }
        }
        assert!(
            empties > 500 && clears > 200 && others > 200 && longest > 5.0,
            "{empties} {clears} {others} {longest}"
        );
    }

    #[test]
    fn a_step_out_of_an_empty_block_stops_at_the_next_occupied_cell() {
        let mut occupied = vec![false; 10];
        occupied[6] = true;
        let size = UVec3::new(10, 1, 1);
        let cells = Macrocells::of_distances(
            Vec3::ZERO,
            Vec3::ONE,
            size,
            chessboard_distance(&occupied, size),
            Bounds::UNIT,
        );
        let origin = Vec3::new(-1.0, 0.5, 0.5);
        let mut t = 1.5;
        let mut jumps = 0;
        while let Some(next) = cells.empty_until(origin + Vec3::X * t, origin, Vec3::X.recip()) {
            assert!(next > t && next <= 7.0);
            t = next + 1e-3;
            jumps += 1;
        }
        assert!(t >= 7.0 && jumps <= 3, "{t} after {jumps}");
    }
}
