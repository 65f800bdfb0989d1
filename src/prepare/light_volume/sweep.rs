//! Mean transmittance at every node of a grid, over parallel directions.
//!
//! *Theory*: the slices across a direction's longest axis are met by every line of that direction
//! once. Columns are the lines through the nodes of one slice; their optical depth is summed from
//! slice to slice, hence the depth between any two points of a column is one difference, whatever
//! their distance: all of a direction costs the same with a short reach as with an infinite one.
//! The columns lie at the same fractions between all nodes of a slice, so that neighbours share
//! their weights and lie in neighbouring lanes. Depths are interpolated once on the way to the
//! columns and transmittances once on the way back, and nothing is interpolated twice: unlike a
//! buffer that is swept through the slices, shadows do not blur with distance.
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
/// Empty columns on both sides of a row.
const PADDING: usize = 2 * LANES;
/// The most partial sums in memory.
const MAX_PARTS: usize = 12;

/// The axes in the order (along a row, across the rows, across the slices), by the last of them.
const ORDER: [[usize; 3]; 3] = [[1, 2, 0], [0, 2, 1], [0, 1, 2]];

impl DepthGrid {
    /// Mean transmittance from each node over directions (cells, of any length).
    pub fn mean_transmittance(&self, directions: &[Vec3], reach: Reach) -> Vec<f32> {
        let parts = rayon::current_num_threads().min(MAX_PARTS);
        let chunk = directions.len().div_ceil(parts).max(1);
        let mut tasks: Vec<(usize, Vec<Vec3>)> = Vec::new();
        for axis in 0..3 {
            let of_axis = directions.iter().filter(|d| d.abs().max_position() == axis);
            let of_axis: Vec<Vec3> = of_axis.copied().collect();
            tasks.extend(of_axis.chunks(chunk).map(|c| (axis, c.to_vec())));
        }
        let sliced: [Option<SlicedDepths>; 3] = std::array::from_fn(|axis| {
            let is_used = tasks.iter().any(|(a, _)| *a == axis);
            is_used.then(|| SlicedDepths::of(self, axis))
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
                let [nodes, rows, _] = ORDER[*axis].map(|n| self.size[n]);
                let stride = nodes.next_multiple_of(LANES);
                for (j, row) in slice.chunks_mut(nx).enumerate() {
                    let (start, step) = match axis {
                        0 => (k * stride + j, rows * stride),
                        1 => ((j * rows + k) * stride, 1),
                        _ => ((k * rows + j) * stride, 1),
                    };
                    for (to, sum) in row.iter_mut().zip(sums[start..].iter().step_by(step)) {
                        *to += sum;
                    }
                }
            }
            slice.iter_mut().for_each(|v| *v *= factor);
        });
        mean
    }
}

/// A grid as slices across one of its axes.
struct SlicedDepths {
    axis: usize,
    /// Nodes along a row, rows of a slice, slices.
    size: [usize; 3],
    /// Whole lanes that hold a row.
    stride: usize,
    depth: Vec<f32>,
}

impl SlicedDepths {
    fn of(grid: &DepthGrid, axis: usize) -> Self {
        let [nodes, rows, slices] = ORDER[axis].map(|n| grid.size[n]);
        let [nx, ny, _] = grid.size;
        let [along, across, on] = ORDER[axis].map(|n| [1, nx, nx * ny][n]);
        let stride = nodes.next_multiple_of(LANES);
        let mut depth = vec![0.0; stride * rows * slices];
        depth.par_chunks_mut(stride).enumerate().for_each(|(n, row)| {
            let start = n % rows * across + n / rows * on;
            for (to, from) in row[..nodes].iter_mut().zip(grid.depth[start..].iter().step_by(along)) {
                *to = *from;
            }
        });
        Self {
            axis,
            size: [nodes, rows, slices],
            stride,
            depth,
        }
    }

    /// The index of the first node of a row.
    #[inline(always)]
    fn start(&self, slice: usize, row: isize) -> usize {
        (slice * self.size[1] + row as usize) * self.stride
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
            depth: vec![0.0; width * slices],
            nodes: vec![0.0; depths.stride + 2 * PADDING],
            here: vec![0.0; width],
            before: vec![0.0; width],
        };
        let mut passed = [vec![0.0; width * slices], vec![0.0; width * slices]];
        for row in 0..along.columns as isize {
            // The slices in which the columns lie on the grid.
            let on_grid = |k: &usize| (-1..rows as isize).contains(&(row + along.at(*k).0));
            let Some(first) = (0..slices).find(on_grid) else {
                continue;
            };
            let last = (first..slices).take_while(on_grid).last().unwrap_or(first);
            columns.before.fill(0.0);
            for k in first..=last {
                let (node, part) = along.at(k);
                columns.add_slice(simd, depths, (k, k > first), (row + node, part), across.at(k));
            }
            passed.swap(0, 1);
            for k in first..=last {
                let (node, part) = along.at(k);
                let (first_node, beyond) = across.at(k);
                // The column before the first node of the row.
                let start = (PADDING as isize - first_node - 1) as usize;
                let shown = start / LANES * LANES..(start + depths.stride + 2).next_multiple_of(LANES).min(width);
                columns.transmittance(simd, reach, [first, k, last], shown, &mut passed[1]);
                // The nodes between these columns and those of the row before.
                let at = row + node;
                if (0..rows as isize).contains(&at) {
                    let sums = &mut sums[depths.start(k, at)..][..depths.stride];
                    let [before, here] = &passed;
                    let from = k * width + start;
                    add_nodes(simd, sums, [&before[from..], &here[from..]], [1.0 - beyond, 1.0 - part]);
                }
            }
        }
    }
}

/// The columns of one row, slice by slice.
struct Columns {
    /// Columns, empty ones on both sides included.
    width: usize,
    /// Of a column between two slices, cells.
    length: f32,
    /// Whether the light lies beyond the last slice.
    toward_last: bool,
    /// Optical depths from the first slice.
    depth: Vec<f32>,
    /// A row of nodes, with empty ones on both sides; and the columns' densities in this slice and
    /// in the one before.
    nodes: Vec<f32>,
    here: Vec<f32>,
    before: Vec<f32>,
}

impl Columns {
    /// Continues the columns to slice `k`, the first one if there is nothing before it, where they
    /// lie `part` beyond the nodes' row `row`, and column 0 lies `beyond` the node `first_node`.
    #[inline(always)]
    fn add_slice<S: Simd>(
        &mut self,
        simd: S,
        depths: &SlicedDepths,
        (k, continues): (usize, bool),
        (row, part): (isize, f32),
        (first_node, beyond): (isize, f32),
    ) {
        let rows = depths.size[1] as isize;
        let of_row = |n: isize| &depths.depth[depths.start(k, n.clamp(0, rows - 1))..][..depths.stride];
        let weight = [
            if row >= 0 { 1.0 - part } else { 0.0 },
            if row + 1 < rows { part } else { 0.0 },
        ];
        let target = self.nodes[PADDING..][..depths.stride].chunks_exact_mut(LANES);
        let pairs = of_row(row).chunks_exact(LANES).zip(of_row(row + 1).chunks_exact(LANES));
        for (to, (a, b)) in target.zip(pairs) {
            let a = f32x8::from_slice(simd, a) * weight[0];
            f32x8::from_slice(simd, b).mul_add(weight[1], a).store_slice(to);
        }
        self.here.fill(0.0);
        let start = (PADDING as isize - first_node - 1).max(0) as usize / LANES * LANES;
        // The node before column `start`, which holds PADDING columns less.
        let node = (start as isize + first_node) as usize;
        let count = (depths.stride + PADDING).min(self.nodes.len() - 1 - node).min(self.width - start) / LANES * LANES;
        let pairs = self.nodes[node..][..count]
            .chunks_exact(LANES)
            .zip(self.nodes[node + 1..][..count].chunks_exact(LANES));
        for (to, (a, b)) in self.here[start..][..count].chunks_exact_mut(LANES).zip(pairs) {
            mix(simd, a, b, beyond).store_slice(to);
        }
        let (done, rest) = self.depth.split_at_mut(k * self.width);
        let depth = &mut rest[..self.width];
        if continues {
            // The trapezoidal rule.
            let half = 0.5 * self.length;
            let ends = self.before.chunks_exact(LANES).zip(self.here.chunks_exact(LANES));
            let previous = done[(k - 1) * self.width..].chunks_exact(LANES);
            for ((to, from), (a, b)) in depth.chunks_exact_mut(LANES).zip(previous).zip(ends) {
                let both = f32x8::from_slice(simd, a) + f32x8::from_slice(simd, b);
                both.mul_add(half, f32x8::from_slice(simd, from)).store_slice(to);
            }
        } else {
            depth.fill(0.0);
        }
        std::mem::swap(&mut self.here, &mut self.before);
    }

    /// Transmittances from slice `k` of those from `first` to `last` in a range of columns.
    #[inline(always)]
    fn transmittance<S: Simd>(
        &self,
        simd: S,
        reach: Reach,
        [first, k, last]: [usize; 3],
        shown: std::ops::Range<usize>,
        passed: &mut [f32],
    ) {
        let of_slice = |n: usize| self.depth[n * self.width..][shown.clone()].chunks_exact(LANES);
        let target = passed[k * self.width..][shown.clone()].chunks_exact_mut(LANES);
        let here = of_slice(k);
        match reach {
            Reach::Infinite => {
                let end = of_slice(if self.toward_last { last } else { first });
                for (to, (a, b)) in target.zip(here.zip(end)) {
                    let depth = (f32x8::from_slice(simd, a) - f32x8::from_slice(simd, b)).abs();
                    exp2(-depth).store_slice(to);
                }
            }
            Reach::BothWays(cells) => {
                let steps = cells / self.length;
                let (whole, part) = (steps as usize, steps.fract());
                let [a, b] = [whole, whole + 1].map(|n| of_slice((k + n).min(last)));
                let [c, d] = [whole, whole + 1].map(|n| of_slice(k.saturating_sub(n).max(first)));
                for ((to, at), ((a, b), (c, d))) in target.zip(here).zip(a.zip(b).zip(c.zip(d))) {
                    let at = f32x8::from_slice(simd, at);
                    let ahead = mix(simd, a, b, part) - at;
                    let behind = at - mix(simd, c, d, part);
                    (exp2(-ahead) + exp2(-behind)).store_slice(to);
                }
            }
        }
    }
}

/// Eight numbers a part of the way from eight numbers to eight others.
#[inline(always)]
fn mix<S: Simd>(simd: S, a: &[f32], b: &[f32], part: f32) -> f32x8<S> {
    let a = f32x8::from_slice(simd, a);
    (f32x8::from_slice(simd, b) - a).mul_add(part, a)
}

/// Adds the values at nodes between two rows of columns to their sums: each node lies the given
/// parts of the way from the columns at the same index of the first row to those after it, and to
/// the second row.
#[inline(always)]
fn add_nodes<S: Simd>(simd: S, sums: &mut [f32], [before, here]: [&[f32]; 2], part: [f32; 2]) {
    let before = before.chunks_exact(LANES).zip(before[1..].chunks_exact(LANES));
    let here = here.chunks_exact(LANES).zip(here[1..].chunks_exact(LANES));
    for (sum, ((a, b), (c, d))) in sums.chunks_exact_mut(LANES).zip(before.zip(here)) {
        let (low, high) = (mix(simd, a, b, part[0]), mix(simd, c, d, part[0]));
        let units = (high - low).mul_add(part[1], low) * UNITS;
        (f32x8::from_slice(simd, sum) + units.round_ties_even()).store_slice(sum);
    }
}
