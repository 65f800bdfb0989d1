//! Mean transmittance at every node of a grid, over parallel directions.
//!
//! *Theory*: the slices across a direction's longest axis are met by every line of that direction
//! once. Columns are the lines through the nodes of one slice; their optical depth is summed from
//! slice to slice, hence the depth between any two points of a column is one difference, whatever
//! their distance: all of a direction costs the same with a short reach as with an infinite one.
//! The columns lie at the same fractions between all nodes of a slice, so that neighbours share
//! their weights and lie in neighbouring lanes. Depths are interpolated once on the way to the
//! columns and transmittances once on the way back: unlike a buffer that is swept through the
//! slices, shadows do not blur with distance.
//!
//! Only nodes near which light is read are computed ([`DepthGrid::read_nodes`]).
//!
//! Transmittances are summed as whole numbers of 1/[`UNITS`], which floating point adds exactly:
//! the result does not depend on the number of threads.

use crate::math::lanes::*;
use glam::Vec3;
use rayon::prelude::*;

/// Optical depths at the nodes of a grid, x fastest. Its outermost nodes are empty.
pub(super) struct DepthGrid {
    /// Nodes along each axis.
    pub size: [usize; 3],
    /// The first node, mm.
    pub origin: Vec3,
    /// Distance between nodes, mm.
    pub cell_mm: f32,
    /// Optical depth of the distance between nodes (powers of 1/2).
    pub depth: Vec<f32>,
    /// The nodes near which light is read.
    pub read: Vec<bool>,
}

/// How far along its direction a transmittance reaches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Reach {
    /// Cells, along the direction and against it.
    BothWays(f32),
    /// To the end of the grid.
    Infinite,
}

/// Resolution of a transmittance.
const UNITS: f32 = 1024.0;
/// Cells around material in which light is read: in front of it, at the nodes around such a point, and
/// farther out by those that are padded.
const READ_AROUND: usize = 4;
/// Cells into what is opaque after which nothing is seen.
const SEEN_INTO: usize = 2;
/// Empty columns on both sides of a row.
const PADDING: usize = 2 * LANES;
/// The most partial sums in memory.
const MAX_PARTS: usize = 12;

/// The axes in the order (along a row, across the rows, across the slices), by the last of them.
const ORDER: [[usize; 3]; 3] = [[1, 2, 0], [0, 2, 1], [0, 1, 2]];

impl DepthGrid {
    /// Mean transmittance from each node over directions (cells, of any length): if these reach to the
    /// end of the grid, everywhere, otherwise where light is read, and 1 elsewhere.
    pub fn mean_transmittance(&self, directions: &[Vec3], reach: Reach) -> Vec<f32> {
        let parts = rayon::current_num_threads().min(MAX_PARTS);
        let chunk = directions.len().div_ceil(2 * parts).max(1);
        let mut tasks: Vec<(usize, Vec<Vec3>)> = Vec::new();
        for axis in 0..3 {
            let of_axis = directions.iter().filter(|d| d.abs().max_position() == axis);
            let of_axis: Vec<Vec3> = of_axis.copied().collect();
            tasks.extend(of_axis.chunks(chunk).map(|c| (axis, c.to_vec())));
        }
        let sliced: [Option<SlicedDepths>; 3] = std::array::from_fn(|axis| {
            let is_used = tasks.iter().any(|(a, _)| *a == axis);
            is_used.then(|| SlicedDepths::of(self, axis, reach == Reach::Infinite))
        });
        let sums: Vec<(usize, Vec<f32>)> = tasks
            .par_iter()
            .filter_map(|(axis, directions)| {
                let depths = sliced[*axis].as_ref()?;
                let mut sums = vec![0.0; depths.depth.len()];
                for &direction in directions {
                    with_simd(Sweep {
                        depths,
                        direction,
                        reach,
                        sums: &mut sums,
                    });
                }
                Some((*axis, sums))
            })
            .collect();
        let senses = if reach == Reach::Infinite { 1 } else { 2 };
        let factor = (UNITS * (senses * directions.len()).max(1) as f32).recip();
        let [nx, ny, nz] = self.size;
        let mut mean = vec![0.0; nx * ny * nz];
        mean.par_chunks_mut(nx * ny).enumerate().for_each(|(k, slice)| {
            for (axis, sums) in &sums {
                let [nodes, rows, slices] = ORDER[*axis].map(|n| self.size[n]);
                let stride = nodes.next_multiple_of(LANES);
                // Along the stored rows, which a slice of this grid has across if the axis is x.
                let lines = if *axis == 0 { slices } else { ny };
                for line in 0..lines {
                    let (row, to, step) = match axis {
                        0 => (line * rows + k, line, nx),
                        1 => (line * rows + k, line * nx, 1),
                        _ => (k * rows + line, line * nx, 1),
                    };
                    let sums = &sums[row * stride..][..nodes];
                    for (to, sum) in slice[to..].iter_mut().step_by(step).zip(sums) {
                        *to += sum;
                    }
                }
            }
            for (to, is_read) in slice.iter_mut().zip(&self.read[k * nx * ny..]) {
                *to = if *is_read || reach == Reach::Infinite {
                    *to * factor
                } else {
                    1.0
                };
            }
        });
        mean
    }

    /// Marks the nodes near which light is read: around material, as far as it is seen.
    pub fn read_nodes(size: [usize; 3], depth: &[f32], opaque: f32) -> Vec<bool> {
        let filled: Vec<bool> = depth.iter().map(|d| *d > 0.0).collect();
        let thin: Vec<bool> = depth.iter().map(|d| *d < opaque).collect();
        let (near, seen) = rayon::join(
            || spread(size, filled, READ_AROUND),
            || spread(size, thin, SEEN_INTO),
        );
        near.iter().zip(&seen).map(|(a, b)| *a && *b).collect()
    }
}

/// The nodes at most `reach` nodes along each axis from a marked one.
fn spread([nx, ny, nz]: [usize; 3], marked: Vec<bool>, reach: usize) -> Vec<bool> {
    let layer = nx * ny;
    // By offsets of whole lines, so that neighbours are or-ed in bulk.
    let along = |from: &[bool], stride: usize, period: usize, count: usize| {
        let mut to = from.to_vec();
        to.par_chunks_mut(period)
            .zip(from.par_chunks(period))
            .for_each(|(to, from)| {
                for n in 1..=reach.min(count - 1) {
                    let shift = n * stride;
                    to[shift..]
                        .iter_mut()
                        .zip(from)
                        .for_each(|(to, from)| *to |= *from);
                    to.iter_mut()
                        .zip(&from[shift..])
                        .for_each(|(to, from)| *to |= *from);
                }
            });
        to
    };
    let x = along(&marked, 1, nx, nx);
    let y = along(&x, nx, layer, ny);
    along(&y, layer, layer * nz, nz)
}

/// A grid as slices across one of its axes.
struct SlicedDepths {
    axis: usize,
    /// Nodes along a row, rows of a slice, slices.
    size: [usize; 3],
    /// Whole lanes that hold a row.
    stride: usize,
    depth: Vec<f32>,
    /// Rows that hold anything.
    filled: Vec<bool>,
    /// Lanes near any of which light is read.
    read: Vec<bool>,
}

impl SlicedDepths {
    /// Across an axis; `all`: light is read everywhere.
    fn of(grid: &DepthGrid, axis: usize, all: bool) -> Self {
        let [nodes, rows, slices] = ORDER[axis].map(|n| grid.size[n]);
        let [nx, ny, _] = grid.size;
        let [along, across, on] = ORDER[axis].map(|n| [1, nx, nx * ny][n]);
        let stride = nodes.next_multiple_of(LANES);
        let lanes = stride / LANES;
        let mut depth = vec![0.0; stride * rows * slices];
        let mut filled = vec![false; rows * slices];
        let mut read = vec![all; lanes * rows * slices];
        // Several slices at once: neighbours across them share lines of the cache.
        depth
            .par_chunks_mut(stride * rows * LANES)
            .zip(filled.par_chunks_mut(rows * LANES))
            .zip(read.par_chunks_mut(lanes * rows * LANES))
            .enumerate()
            .for_each(|(n, ((depth, filled), read))| {
                for row in 0..rows {
                    for slice in 0..filled.len() / rows {
                        let start = row * across + (n * LANES + slice) * on;
                        let number = slice * rows + row;
                        let from = grid.depth[start..].iter().zip(&grid.read[start..]).step_by(along);
                        let to = depth[number * stride..][..nodes].iter_mut().enumerate();
                        for ((i, to), (depth, is_read)) in to.zip(from) {
                            *to = *depth;
                            filled[number] |= *depth > 0.0;
                            read[number * lanes + i / LANES] |= *is_read;
                        }
                    }
                }
            });
        Self {
            axis,
            size: [nodes, rows, slices],
            stride,
            depth,
            filled,
            read,
        }
    }

    /// The number of a row.
    #[inline(always)]
    fn row(&self, slice: usize, row: isize) -> usize {
        slice * self.size[1] + row as usize
    }
}

/// Where the columns of a direction meet the slices, along one axis of these.
#[derive(Clone, Copy)]
struct Shift {
    /// Nodes per slice.
    slope: f32,
    /// Columns before the first node of the first slice.
    before: f32,
    /// Number of columns.
    columns: usize,
}

impl Shift {
    fn new(slope: f32, nodes: usize, slices: usize) -> Self {
        let way = slope * (slices - 1) as f32;
        Self {
            slope,
            before: way.max(0.0).ceil(),
            columns: nodes + way.abs().ceil() as usize + 2,
        }
    }

    /// The node before column 0 in a slice, and how far that is beyond the node.
    #[inline(always)]
    fn at(self, slice: usize) -> (isize, f32) {
        let place = self.slope * slice as f32 - self.before;
        let node = place.floor();
        (node as isize, place - node)
    }
}

/// Adds the transmittances of one direction to `sums`.
struct Sweep<'a> {
    depths: &'a SlicedDepths,
    direction: Vec3,
    reach: Reach,
    sums: &'a mut [f32],
}

impl SimdKernel for Sweep<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self {
            depths,
            direction,
            reach,
            sums,
        } = self;
        let [nodes, rows, slices] = depths.size;
        let [across, along, on] = ORDER[depths.axis].map(|n| direction[n]);
        let (across, along) = (
            Shift::new(across / on, nodes, slices),
            Shift::new(along / on, rows, slices),
        );
        let width = 2 * PADDING + across.columns.next_multiple_of(LANES);
        let mut columns = Columns {
            width,
            length: direction.length() / on.abs(),
            toward_last: on > 0.0,
            rows: std::array::from_fn(|_| ColumnRow {
                depth: vec![0.0; width * slices],
                passed: vec![0.0; width * slices],
                slices: [0, 0],
            }),
            nodes: vec![0.0; depths.stride + 2 * PADDING],
            here: vec![0.0; width],
            before: vec![0.0; width],
            wanted: vec![false; width / LANES],
        };
        for row in 0..along.columns as isize {
            // The slices in which the columns lie on the grid.
            let on_grid = |k: &usize| (-1..rows as isize).contains(&(row + along.at(*k).0));
            let Some(first) = (0..slices).find(on_grid) else {
                continue;
            };
            let last = (first..slices).take_while(on_grid).last().unwrap_or(first);
            columns.rows.swap(0, 1);
            columns.rows[1].slices = [first, last];
            columns.before.fill(0.0);
            for k in first..=last {
                let (node, part) = along.at(k);
                columns.add_slice(simd, depths, k, (row + node, part), across.at(k));
            }
            for k in first..=last {
                let (node, part) = along.at(k);
                let start = first_column(across.at(k).0);
                columns.transmit(simd, depths, reach, k, row + node, start);
                // The nodes between these columns and those of the row before.
                let at = row + node;
                if (0..rows as isize).contains(&at) {
                    let parts = [1.0 - across.at(k).1, 1.0 - part];
                    columns.add_nodes(simd, depths, (k, at), start, parts, sums);
                }
            }
        }
    }
}

/// The column before the first node of a slice in which column 0 follows the node `first_node`, among
/// the columns of a row with its empty ones.
fn first_column(first_node: isize) -> usize {
    (PADDING as isize - first_node - 1) as usize
}

/// Two rows of columns, the second one being walked.
struct Columns {
    /// Columns of a row, empty ones on both sides included.
    width: usize,
    /// Of a column between two slices, cells.
    length: f32,
    /// Whether the light lies beyond the last slice.
    toward_last: bool,
    rows: [ColumnRow; 2],
    /// A row of nodes, with empty ones on both sides; and the columns' densities in this slice and
    /// in the one before.
    nodes: Vec<f32>,
    here: Vec<f32>,
    before: Vec<f32>,
    /// Lanes of columns whose transmittances are read.
    wanted: Vec<bool>,
}

/// A row of columns, slice by slice.
struct ColumnRow {
    /// Optical depths from the first slice.
    depth: Vec<f32>,
    /// Transmittances.
    passed: Vec<f32>,
    /// The first and the last slice in which they lie on the grid.
    slices: [usize; 2],
}

impl Columns {
    /// Continues the columns to slice `k`, where they lie `part` beyond the nodes' row `row`, and
    /// column 0 lies `beyond` the node `first_node`.
    #[inline(always)]
    fn add_slice<S: Simd>(
        &mut self,
        simd: S,
        depths: &SlicedDepths,
        k: usize,
        (row, part): (isize, f32),
        (first_node, beyond): (isize, f32),
    ) {
        let rows = depths.size[1] as isize;
        let inside = |n: isize| (0..rows).contains(&n) && depths.filled[depths.row(k, n)];
        self.here.fill(0.0);
        if inside(row) || inside(row + 1) {
            let of_row = |n: isize| {
                let start = depths.row(k, n.clamp(0, rows - 1)) * depths.stride;
                &depths.depth[start..start + depths.stride]
            };
            let (a, b) = (of_row(row), of_row(row + 1));
            let weight = [
                if row >= 0 { 1.0 - part } else { 0.0 },
                if row + 1 < rows { part } else { 0.0 },
            ];
            let target = &mut self.nodes[PADDING..PADDING + depths.stride];
            let mut n = 0;
            while n < target.len() {
                let low = load(simd, a, n) * weight[0];
                let mixed = load(simd, b, n).mul_add(weight[1], low);
                mixed.store_slice(&mut target[n..n + LANES]);
                n += LANES;
            }
            // Whole lanes from the column before the first node on.
            let mut column = first_column(first_node) / LANES * LANES;
            let mut node = (column as isize + first_node) as usize;
            let end = (column + depths.stride + PADDING).min(self.width);
            while column < end {
                let mixed = mix(simd, &self.nodes, node, beyond);
                mixed.store_slice(&mut self.here[column..column + LANES]);
                (column, node) = (column + LANES, node + LANES);
            }
        }
        let (width, row) = (self.width, &mut self.rows[1]);
        let (done, rest) = row.depth.split_at_mut(k * width);
        let depth = &mut rest[..width];
        if k == row.slices[0] {
            depth.fill(0.0);
        } else {
            // The trapezoidal rule.
            let half = 0.5 * self.length;
            let previous = &done[(k - 1) * width..];
            let mut n = 0;
            while n < width {
                let both = load(simd, &self.before, n) + load(simd, &self.here, n);
                let sum = both.mul_add(half, load(simd, previous, n));
                sum.store_slice(&mut depth[n..n + LANES]);
                n += LANES;
            }
        }
        std::mem::swap(&mut self.here, &mut self.before);
    }

    /// Transmittances from slice `k` in the columns around the nodes of two rows, `node` and the one
    /// after it, near which light is read. `start`: the column before the first node.
    #[inline(always)]
    fn transmit<S: Simd>(
        &mut self,
        simd: S,
        depths: &SlicedDepths,
        reach: Reach,
        k: usize,
        node: isize,
        start: usize,
    ) {
        self.wanted.fill(false);
        let lanes = depths.stride / LANES;
        for row in [node, node + 1] {
            if (0..depths.size[1] as isize).contains(&row) {
                let read = &depths.read[depths.row(k, row) * lanes..][..lanes];
                for n in (0..lanes).filter(|n| read[*n]) {
                    // The columns of eight nodes, and the one after them.
                    let column = start + n * LANES;
                    self.wanted[column / LANES] = true;
                    self.wanted[(column + LANES) / LANES] = true;
                }
            }
        }
        let (width, row) = (self.width, &mut self.rows[1]);
        let [first, last] = row.slices;
        let of_slice = |n: usize| &row.depth[n * width..(n + 1) * width];
        let target = &mut row.passed[k * width..(k + 1) * width];
        let here = of_slice(k);
        let steps = if let Reach::BothWays(cells) = reach {
            cells / self.length
        } else {
            0.0
        };
        let (whole, part) = (steps as usize, steps.fract());
        // Beyond the grid there is nothing.
        let ahead = [whole, whole + 1].map(|n| of_slice((k + n).min(last)));
        let behind = [whole, whole + 1].map(|n| of_slice(k.saturating_sub(n).max(first)));
        let end = of_slice(if self.toward_last { last } else { first });
        for n in (0..self.wanted.len()).filter(|n| self.wanted[*n]) {
            let n = n * LANES;
            let depth = load(simd, here, n);
            let passed = match reach {
                Reach::Infinite => exp2(-(depth - load(simd, end, n)).abs()),
                Reach::BothWays(_) => {
                    let (a, b) = (load(simd, ahead[0], n), load(simd, ahead[1], n));
                    let (c, d) = (load(simd, behind[0], n), load(simd, behind[1], n));
                    let ahead = (b - a).mul_add(part, a) - depth;
                    let behind = depth - (d - c).mul_add(part, c);
                    exp2(-ahead) + exp2(-behind)
                }
            };
            passed.store_slice(&mut target[n..n + LANES]);
        }
    }

    /// Adds the transmittances at the nodes of a row, which lie parts of the way from columns to the
    /// next ones, the first one being `start`, and from the first row of columns to the second.
    #[inline(always)]
    fn add_nodes<S: Simd>(
        &self,
        simd: S,
        depths: &SlicedDepths,
        (k, row): (usize, isize),
        start: usize,
        part: [f32; 2],
        sums: &mut [f32],
    ) {
        let number = depths.row(k, row);
        let lanes = depths.stride / LANES;
        let read = &depths.read[number * lanes..][..lanes];
        let sums = &mut sums[number * depths.stride..][..depths.stride];
        let [before, here] = &self.rows;
        for n in (0..lanes).filter(|n| read[*n]) {
            let (n, column) = (n * LANES, k * self.width + start + n * LANES);
            let low = mix(simd, &before.passed, column, part[0]);
            let high = mix(simd, &here.passed, column, part[0]);
            let units = ((high - low).mul_add(part[1], low) * UNITS).round_ties_even();
            let sum = load(simd, sums, n) + units;
            sum.store_slice(&mut sums[n..n + LANES]);
        }
    }
}

/// Eight numbers.
#[inline(always)]
fn load<S: Simd>(simd: S, from: &[f32], n: usize) -> f32x8<S> {
    f32x8::from_slice(simd, &from[n..n + LANES])
}

/// Eight numbers a part of the way from eight numbers to the ones after them.
#[inline(always)]
fn mix<S: Simd>(simd: S, from: &[f32], n: usize, part: f32) -> f32x8<S> {
    let a = load(simd, from, n);
    (load(simd, from, n + 1) - a).mul_add(part, a)
}
