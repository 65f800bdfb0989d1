//! Empty space under deformation: a coarse grid over the deformed scene that says where nothing can be seen.
//!
//! *Theory*: `model.md` section 9. A cell's box is carried backwards through the stack with interval arithmetic; the result bounds
//! the source points, hence the values (from the volume's min/max pyramid), hence the opacity (from the transfer function's range
//! maximum). Every bound is conservative, so skipping changes no picture.
//!
//! Cells hold the chessboard distance to the nearest occupied cell rather than one bit: an empty cell at distance d lets a ray leave
//! the whole block of empty cells around it in one step.

use crate::deform::Stack;
use crate::deform::cut::Cuts;
use crate::math::{Bounds, MinMaxPyramid};
use crate::transfer::{Blend, Table};
use glam::{Affine3A, UVec3, Vec3};
use rayon::prelude::*;

/// Most cells along an axis.
const MOST_CELLS: f32 = 64.0;

/// The grid.
pub struct Macrocells {
    /// Lower corner, mm.
    pub origin: Vec3,
    /// Edge of a cell along each axis, mm.
    pub cell_mm: Vec3,
    /// Cells along each axis.
    pub size: UVec3,
    /// Chessboard distance to the nearest occupied cell, x fastest; 0 is occupied.
    pub distance: Vec<u8>,
    /// The box of the occupied cells, mm; empty if there is none.
    pub occupied: Bounds,
}

/// What decides whether a cell shows anything.
pub struct Contents<'a> {
    /// The deformation.
    pub stack: &'a Stack,
    /// The cuts after it.
    pub cuts: &'a Cuts,
    /// Normalised value of the surface that is shown instead of the volume.
    pub iso: Option<f32>,
    /// Whether the faces of cuts show whatever they cut.
    pub grey_faces: bool,
    /// World to voxel.
    pub voxel_from_world: &'a Affine3A,
    /// Extent of the volume in voxels: its box is -1/2 .. n - 1/2.
    pub voxel_box: Bounds,
    /// Normalised values.
    pub pyramid: &'a MinMaxPyramid<1>,
    /// Opacity by value.
    pub table: &'a Table,
    /// Composite pictures need opacity; projections need any matter.
    pub blend: Blend,
}

impl Contents<'_> {
    /// Whether anything can be seen in a box of the deformed scene.
    fn visible(&self, deformed: &Bounds) -> bool {
        let [least_kept, most_kept] = self.cuts.bounds(deformed);
        if most_kept < 0.0 {
            return false;
        }
        let (source, [least_alpha, most_alpha]) = self.stack.source_and_mask_bounds(deformed);
        if most_alpha < 0.5 {
            return false;
        }
        let in_voxel = source.transformed(self.voxel_from_world).grown(0.01).intersection(&self.voxel_box);
        if in_voxel.is_empty() {
            return false;
        }
        if self.blend != Blend::Composite || (self.grey_faces && (least_kept < 0.0 || least_alpha < 0.5)) {
            return true;
        }
        let values = self.pyramid.query(in_voxel.min, in_voxel.max);
        if let Some(iso) = self.iso {
            return values.max[0] >= iso;
        }
        self.table.max_depth(values.min[0], values.max[0]) > 0.0
    }
}

impl Macrocells {
    /// One occupied cell over everything: skips nothing.
    pub fn solid(bounds: Bounds) -> Self {
        Self { origin: bounds.min, cell_mm: bounds.size(), size: UVec3::ONE, distance: vec![0], occupied: bounds }
    }

    /// Classifies a grid over `bounds`, the box of the deformed scene.
    ///
    /// A sample within `reach_mm` of what can be seen counts as seeing it: beside a cut, samples look back one step.
    pub fn new(bounds: Bounds, voxel_mm: f32, reach_mm: f32, contents: &Contents) -> Self {
        let edge = (bounds.size().max_element() / MOST_CELLS).max(3.0 * voxel_mm);
        Self::classified(bounds, edge, reach_mm, |b| contents.visible(b))
    }

    /// A grid of cells of about `edge` mm, those occupied in whose box, grown by `reach_mm`, anything is visible.
    pub fn classified(bounds: Bounds, edge: f32, reach_mm: f32, visible: impl Fn(&Bounds) -> bool + Sync) -> Self {
        let extent = bounds.size();
        let size = (extent / edge).ceil().max(Vec3::ONE);
        let cell_mm = extent / size;
        let size = size.as_uvec3();
        // A sample that lies on a cell's face may be counted to either side.
        let margin = 1e-3 * cell_mm.max_element() + reach_mm;
        let occupied: Vec<bool> =
            (0..size.element_product()).into_par_iter().map(|index| visible(&cell_box(&bounds, size, cell_mm, index).grown(margin))).collect();
        let mut all = Bounds::EMPTY;
        for (index, _) in occupied.iter().enumerate().filter(|(_, o)| **o) {
            all = all.union(&cell_box(&bounds, size, cell_mm, index as u32));
        }
        Self { origin: bounds.min, cell_mm, size, distance: chessboard_distance(&occupied, size), occupied: all }
    }

    /// The box of a cell by its flat index.
    pub fn cell_box(&self, index: usize) -> Bounds {
        cell_box(&Bounds::new(self.origin, self.origin), self.size, self.cell_mm, index as u32)
    }

    /// Flat index of the cell at a point; the nearest one outside the grid.
    #[inline(always)]
    pub fn index(&self, p: Vec3) -> usize {
        let c = ((p - self.origin) / self.cell_mm).floor().clamp(Vec3::ZERO, (self.size - 1).as_vec3()).as_uvec3();
        ((c.z * self.size.y + c.y) * self.size.x + c.x) as usize
    }

    /// Where a ray at `p` may go on: none in an occupied cell, else the parameter at which it leaves the empty block around it.
    ///
    /// `inverse_direction` is 1/d for the ray `origin + t d`.
    #[inline(always)]
    pub fn empty_until(&self, p: Vec3, origin: Vec3, inverse_direction: Vec3) -> Option<f32> {
        let last = (self.size - 1).as_vec3();
        let cell = ((p - self.origin) / self.cell_mm).floor().clamp(Vec3::ZERO, last);
        let c = cell.as_uvec3();
        let d = self.distance[((c.z * self.size.y + c.y) * self.size.x + c.x) as usize];
        if d == 0 {
            return None;
        }
        let reach = f32::from(d);
        let low = self.origin + (cell - (reach - 1.0)) * self.cell_mm;
        let high = self.origin + (cell + reach) * self.cell_mm;
        let a = (low - origin) * inverse_direction;
        let b = (high - origin) * inverse_direction;
        let far = a.max(b);
        Some(far.x.min(far.y).min(far.z))
    }
}

fn cell_box(bounds: &Bounds, size: UVec3, cell_mm: Vec3, index: u32) -> Bounds {
    let cell = UVec3::new(index % size.x, index / size.x % size.y, index / size.x / size.y).as_vec3();
    let low = bounds.min + cell * cell_mm;
    Bounds::new(low, low + cell_mm)
}

/// Two sweeps over the 13 earlier neighbours, exact for the chessboard metric; saturates at 255.
fn chessboard_distance(occupied: &[bool], size: UVec3) -> Vec<u8> {
    let mut distance: Vec<u8> = occupied.iter().map(|&o| if o { 0 } else { 255 }).collect();
    let (nx, ny, nz) = (size.x as i32, size.y as i32, size.z as i32);
    let at = |x: i32, y: i32, z: i32| ((z * ny + y) * nx + x) as usize;
    let earlier: Vec<(i32, i32, i32)> = (-1..=1).flat_map(|z| (-1..=1).flat_map(move |y| (-1..=1).map(move |x| (x, y, z)))).take(13).collect();
    for sweep in [1, -1] {
        for n in 0..nx * ny * nz {
            let n = if sweep > 0 { n } else { nx * ny * nz - 1 - n };
            let (x, y, z) = (n % nx, n / nx % ny, n / nx / ny);
            let mut best = distance[at(x, y, z)];
            for &(dx, dy, dz) in &earlier {
                let (x, y, z) = (x + sweep * dx, y + sweep * dy, z + sweep * dz);
                if x >= 0 && y >= 0 && z >= 0 && x < nx && y < ny && z < nz {
                    best = best.min(distance[at(x, y, z)].saturating_add(1));
                }
            }
            distance[at(x, y, z)] = best;
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
                    let want = seeds.iter().map(|s| (s.0 - x).abs().max((s.1 - y).abs()).max((s.2 - z).abs())).min();
                    assert_eq!(Some(i32::from(distance[((z * 5 + y) * 7 + x) as usize])), want);
                }
            }
        }
    }

    #[test]
    fn a_step_out_of_an_empty_block_stops_at_the_next_occupied_cell() {
        let mut occupied = vec![false; 10];
        occupied[6] = true;
        let size = UVec3::new(10, 1, 1);
        let cells =
            Macrocells { origin: Vec3::ZERO, cell_mm: Vec3::ONE, size, distance: chessboard_distance(&occupied, size), occupied: Bounds::UNIT };
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
