//! A min/max pyramid over a grid of `C` channels: bounds on any trilinear sample taken inside a box
//! of grid indices.
//!
//! A trilinear sample lies between the values it interpolates, hence the minimum and maximum over
//! those grid points bound it. Level 0 has one node per `2^shift` grid cells and covers the grid
//! points on both ends of those cells; each level above halves the one below.

/// Bounds of the values inside boxes of a grid.
pub struct MinMaxPyramid<const C: usize> {
    /// Extent of the grid, points.
    size: [usize; 3],
    /// log2 of the grid cells per node at level 0.
    shift: u32,
    levels: Vec<PyramidLevel<C>>,
}

struct PyramidLevel<const C: usize> {
    size: [usize; 3],
    nodes: Vec<ChannelRange<C>>,
}

/// Smallest and largest value per channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelRange<const C: usize> {
    /// Smallest.
    pub min: [f32; C],
    /// Largest.
    pub max: [f32; C],
}

impl<const C: usize> ChannelRange<C> {
    /// The empty range.
    pub const EMPTY: Self = Self {
        min: [f32::INFINITY; C],
        max: [f32::NEG_INFINITY; C],
    };

    /// Widens to include `value`.
    #[inline(always)]
    pub fn insert(&mut self, value: [f32; C]) {
        self.merge(&Self {
            min: value,
            max: value,
        });
    }

    /// Widens to include another range.
    #[inline(always)]
    pub fn merge(&mut self, other: &Self) {
        for c in 0..C {
            self.min[c] = self.min[c].min(other.min[c]);
            self.max[c] = self.max[c].max(other.max[c]);
        }
    }
}

/// Number of the finest nodes along an axis of `n` grid points.
fn nodes_along(n: usize, shift: u32) -> usize {
    n.saturating_sub(1).div_ceil(1 << shift).max(1)
}

impl<const C: usize> MinMaxPyramid<C> {
    /// Builds the pyramid of a grid of `size` points from their values `value(i, j, k)`, with
    /// `2^shift` cells per finest node.
    pub fn new(size: [usize; 3], shift: u32, value: impl Fn(usize, usize, usize) -> [f32; C] + Sync) -> Self {
        Self::from_runs(size, shift, |first, last, j, k| {
            let mut range = ChannelRange::EMPTY;
            (first..=last).for_each(|i| range.insert(value(i, j, k)));
            range
        })
    }

    /// As [`Self::new`], from the ranges of runs along the first axis: `run(first, last, j, k)`,
    /// both ends included.
    pub fn from_runs(
        size: [usize; 3],
        shift: u32,
        run: impl Fn(usize, usize, usize, usize) -> ChannelRange<C> + Sync,
    ) -> Self {
        use rayon::prelude::*;
        let edge = 1usize << shift;
        let level_size = size.map(|n| nodes_along(n, shift));
        let [nx, ny, _] = level_size;
        let mut nodes = vec![ChannelRange::EMPTY; level_size.iter().product()];
        nodes
            .par_chunks_mut(nx * ny)
            .enumerate()
            .for_each(|(layer, nodes)| {
                for k in layer * edge..=((layer + 1) * edge).min(size[2] - 1) {
                    for j in 0..size[1] {
                        // A row on the face between two nodes belongs to both.
                        let upper = (j / edge).min(ny - 1);
                        let shared = j % edge == 0 && j > 0 && upper * edge == j;
                        for (i, at) in (0..nx).map(|i| (i * edge, upper * nx + i)) {
                            let range = run(i, (i + edge).min(size[0] - 1), j, k);
                            nodes[at].merge(&range);
                            if shared {
                                nodes[at - nx].merge(&range);
                            }
                        }
                    }
                }
            });
        Self::above(size, shift, level_size, nodes)
    }

    /// As [`Self::new`], from the ranges of the finest nodes, row by row: `row` is given the first
    /// and the last grid point of each node of a row.
    pub fn from_rows(
        size: [usize; 3],
        shift: u32,
        row: impl Fn(&[[[usize; 3]; 2]]) -> Vec<ChannelRange<C>> + Sync,
    ) -> Self {
        use rayon::prelude::*;
        let level_size = size.map(|n| nodes_along(n, shift));
        let [nx, ny, nz] = level_size;
        let nodes = (0..ny * nz)
            .into_par_iter()
            .flat_map_iter(|at| {
                let boxes: Vec<[[usize; 3]; 2]> = (0..nx)
                    .map(|i| {
                        let node = [i, at % ny, at / ny];
                        let first = node.map(|n| n << shift);
                        let last = std::array::from_fn(|a| ((node[a] + 1) << shift).min(size[a] - 1));
                        [first, last]
                    })
                    .collect();
                row(&boxes)
            })
            .collect();
        Self::above(size, shift, level_size, nodes)
    }

    /// The pyramid above its finest level.
    fn above(size: [usize; 3], shift: u32, level_size: [usize; 3], nodes: Vec<ChannelRange<C>>) -> Self {
        let mut levels = vec![PyramidLevel {
            size: level_size,
            nodes,
        }];
        while let Some(last) = levels.last().filter(|l| l.size != [1; 3]) {
            let above = last.size.map(|n| n.div_ceil(2));
            let mut nodes = vec![ChannelRange::EMPTY; above[0] * above[1] * above[2]];
            for k in 0..last.size[2] {
                for j in 0..last.size[1] {
                    for i in 0..last.size[0] {
                        let parent = (k / 2 * above[1] + j / 2) * above[0] + i / 2;
                        nodes[parent].merge(&last.nodes[(k * last.size[1] + j) * last.size[0] + i]);
                    }
                }
            }
            levels.push(PyramidLevel { size: above, nodes });
        }
        Self { size, shift, levels }
    }

    /// Bounds on every trilinear sample with grid coordinates inside `[low, high]`; coordinates
    /// outside the grid are clamped to it, as samples are.
    pub fn query(&self, low: glam::Vec3, high: glam::Vec3) -> ChannelRange<C> {
        let mut first = [0usize; 3];
        let mut last = [0usize; 3];
        for axis in 0..3 {
            let top = self.size[axis].saturating_sub(2) as f32;
            // A sample at x interpolates floor(x) and floor(x) + 1: cell floor(x).
            first[axis] = low[axis].floor().clamp(0.0, top) as usize >> self.shift;
            last[axis] = high[axis].floor().clamp(0.0, top) as usize >> self.shift;
        }
        let widest = (0..3).map(|a| last[a] - first[a]).max().unwrap_or(0);
        // The level at which at most three nodes per axis are touched.
        let mut level = 0usize;
        while (widest >> level) > 1 && level + 1 < self.levels.len() {
            level += 1;
        }
        let l = &self.levels[level];
        let mut range = ChannelRange::EMPTY;
        for k in first[2] >> level..=(last[2] >> level).min(l.size[2] - 1) {
            for j in first[1] >> level..=(last[1] >> level).min(l.size[1] - 1) {
                for i in first[0] >> level..=(last[0] >> level).min(l.size[0] - 1) {
                    range.merge(&l.nodes[(k * l.size[1] + j) * l.size[0] + i]);
                }
            }
        }
        range
    }

    /// Extent of the grid, points, and log2 of the grid cells per node at level 0.
    pub fn grid(&self) -> ([usize; 3], u32) {
        (self.size, self.shift)
    }

    /// For each level, the finest first: nodes along each axis, and the nodes themselves, x
    /// fastest.
    pub fn levels(&self) -> impl Iterator<Item = ([usize; 3], &[ChannelRange<C>])> {
        self.levels.iter().map(|l| (l.size, &*l.nodes))
    }

    /// The range of the whole grid.
    pub fn whole(&self) -> ChannelRange<C> {
        self.levels
            .last()
            .and_then(|l| l.nodes.first())
            .copied()
            .unwrap_or(ChannelRange::EMPTY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use proptest::prelude::*;

    proptest! {
        /// Every grid point that a sample in the box can touch is inside the reported range, which
        /// is not always the whole range.
        #[test]
        fn bounds_hold(nx in 1usize..20, ny in 1usize..20, nz in 1usize..20, shift in 0u32..3,
                       a in prop::array::uniform3(-2.0f32..22.0), extent in prop::array::uniform3(0.0f32..9.0)) {
            let value = |i: usize, j: usize, k: usize| ((i * 7919 + j * 104_729 + k * 1_299_709) % 1009) as f32;
            let pyramid = MinMaxPyramid::<1>::new([nx, ny, nz], shift, |i, j, k| [value(i, j, k)]);
            let low = Vec3::from(a);
            let high = low + Vec3::from(extent);
            let range = pyramid.query(low, high);
            let touched = |x0: f32, x1: f32, n: usize| {
                let top = (n - 1) as f32;
                (x0.clamp(0.0, top).floor() as usize)..=(x1.clamp(0.0, top).ceil() as usize)
            };
            for k in touched(low.z, high.z, nz) { for j in touched(low.y, high.y, ny) { for i in touched(low.x, high.x, nx) {
                let v = value(i, j, k);
                prop_assert!(range.min[0] <= v && v <= range.max[0]);
            }}}
        }
    }

    #[test]
    fn bounds_are_local() {
        let pyramid = MinMaxPyramid::<1>::new([33, 33, 33], 1, |i, _, _| [i as f32]);
        let range = pyramid.query(Vec3::new(8.0, 0.0, 0.0), Vec3::new(9.0, 1.0, 1.0));
        assert!(range.min[0] >= 4.0 && range.max[0] <= 14.0, "{range:?}");
    }
}
