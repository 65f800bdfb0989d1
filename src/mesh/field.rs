//! The signed distance field of a mesh, and of an iso-value of a scan: millimetres, positive
//! inside.
//!
//! *Distance*: exact, by a bounding volume hierarchy, in a narrow band around the surface (and
//! everywhere if requested). From there the closest points are propagated between neighbours in
//! eight sweeps (Danielsson 1980; Zhao 2005 for the order), each point taking the nearest of its
//! neighbours' closest points. The result is never below the true distance.
//!
//! *Sign*: inside is where the generalised winding number is above 1/2. It is harmonic away from
//! the surface and changes slowly there; blocks of the grid that the surface does not reach are
//! therefore decided by few of their points, and the others are subdivided down to single points. A
//! mesh with inconsistently oriented triangles is first oriented ([`Mesh::oriented`]).
//!
//! *An iso-value*: the volume's own interpolation locates the surface on each grid edge that it
//! crosses; those points, with the tangent planes through them, seed the same sweeps. The sign is
//! that of the value.

mod iso;
mod lattice;
mod sweep;

pub use iso::of_iso_value;
pub use lattice::{FieldSettings, MARGIN, MAX_POINTS, cell_of};

use super::{Mesh, Topology, TriangleBvh};
use crate::Watch;
use crate::math::DistanceGrid;
use crate::math::arrays::shaped;
use glam::{Mat3, Vec3};
use lattice::{BAND, FieldLattice};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};
use sweep::sweep;

/// Edge of the blocks that are decided as a whole, points.
const BLOCK: usize = 16;
/// A winding number this close to 1/2 is not certain.
const DOUBT: f32 = 0.2;

/// A field and its statistics.
pub struct MeshField {
    /// The distances.
    pub grid: DistanceGrid,
    /// The connectivity of the mesh as read.
    pub topology: Topology,
    /// Number of triangles flipped for a consistent orientation.
    pub turned: usize,
    /// Number of points at which the winding number was computed.
    pub windings: usize,
    /// Fraction of these within a quarter of 1/2, where inside and outside are ambiguous.
    pub doubtful: f64,
    /// Fraction of the grid's points that are inside.
    pub inside: f64,
    /// | |∇f| - 1 | in the band: its mean and its 99th percentile.
    pub eikonal: [f64; 2],
}

impl MeshField {
    /// The signed distance field of a mesh.
    ///
    /// # Errors
    /// A box without any part of the mesh, a grid that is too large, or a cancellation; as a
    /// sentence.
    pub fn new(mesh: &Mesh, settings: &FieldSettings, watch: &Watch) -> Result<Self, String> {
        let topology = mesh.topology();
        let bounds = mesh.bounds();
        let lattice = FieldLattice::over(&bounds, settings)?;
        let turned_mesh;
        let (mesh, turned) = if topology.flipped_edges > 0 || topology.volume < 0.0 {
            let (m, n) = mesh.clone().oriented();
            turned_mesh = m;
            (&turned_mesh, n)
        } else {
            (mesh, 0)
        };
        let tree = TriangleBvh::new(mesh);
        // The nearest point of a region may lie outside it, where no sweep originates.
        let exact = settings.exact || settings.region.is_some();
        let (mut distance, mut nearest) = band(&tree, &lattice, exact, watch)?;
        if !exact {
            sweep(
                &mut distance,
                &mut nearest,
                lattice.size,
                lattice.origin,
                Mat3::from_diagonal(Vec3::splat(lattice.cell)),
            );
        }
        drop(nearest);
        let counts = if settings.parity {
            parity(&tree, &lattice, &mut distance);
            [0; 2]
        } else {
            signs(&tree, &lattice, topology.watertight, &mut distance, watch)?
        };
        let inside = distance.par_iter().filter(|d| **d > 0.0).count() as f64 / distance.len() as f64;
        let eikonal = eikonal(&distance, &lattice);
        (watch.progress)(1.0);
        let grid = DistanceGrid::new(shaped(lattice.size, distance), lattice.world_from_grid());
        Ok(Self {
            grid,
            topology,
            turned,
            windings: counts[0],
            doubtful: counts[1] as f64 / counts[0].max(1) as f64,
            inside,
            eikonal,
        })
    }
}

const CANCELLED: &str = "was cancelled";

/// Exact distances and nearest points near the surface, or everywhere; infinite elsewhere.
fn band(
    tree: &TriangleBvh,
    lattice: &FieldLattice,
    exact: bool,
    watch: &Watch,
) -> Result<(Vec<f32>, Vec<Vec3>), String> {
    const EDGE: usize = 8;
    let [nx, ny, nz] = lattice.size;
    let reach = BAND * lattice.cell;
    let mut distance = vec![f32::INFINITY; lattice.len()];
    let mut nearest = vec![Vec3::NAN; if exact { 0 } else { lattice.len() }];
    // Where no points are needed, empty slices take their place.
    let slab = nx * ny * EDGE;
    let mut points: Vec<&mut [Vec3]> = if exact {
        (0..nz.div_ceil(EDGE)).map(|_| &mut [][..]).collect()
    } else {
        nearest.chunks_mut(slab).collect()
    };
    let done = AtomicUsize::new(0);
    let slabs = points.len();
    distance
        .par_chunks_mut(slab)
        .zip(points.par_iter_mut())
        .enumerate()
        .for_each(|(s, (distance, points))| {
            let k0 = s * EDGE;
            let layers = distance.len() / (nx * ny);
            for j0 in (0..ny).step_by(EDGE) {
                if watch.is_cancelled() {
                    return;
                }
                for i0 in (0..nx).step_by(EDGE) {
                    let (i1, j1, k1) = ((i0 + EDGE).min(nx), (j0 + EDGE).min(ny), k0 + layers);
                    let (low, high) = (lattice.point(i0, j0, k0), lattice.point(i1 - 1, j1 - 1, k1 - 1));
                    let middle = (low + high) * 0.5;
                    let limit = if exact {
                        f32::INFINITY
                    } else {
                        reach + middle.distance(high)
                    };
                    let Some(mut last) = tree.nearest(middle, limit * 1.001) else {
                        continue;
                    };
                    for k in k0..k1 {
                        for j in j0..j1 {
                            for i in i0..i1 {
                                let p = lattice.point(i, j, k);
                                let found = if exact {
                                    tree.nearest_from(p, last.slot)
                                } else {
                                    tree.nearest_within(p, last.slot, reach)
                                };
                                let Some(found) = found else { continue };
                                last = found;
                                let n = ((k - k0) * ny + j) * nx + i;
                                distance[n] = found.squared.sqrt();
                                if !exact {
                                    points[n] = found.point;
                                }
                            }
                        }
                    }
                }
            }
            (watch.progress)(0.6 * (done.fetch_add(1, Ordering::Relaxed) + 1) as f32 / slabs as f32);
        });
    if watch.is_cancelled() {
        Err(CANCELLED.into())
    } else {
        Ok((distance, nearest))
    }
}

/// Gives the distances, positive on input, their sign; returns how many winding numbers were
/// computed and how many were ambiguous.
fn signs(
    tree: &TriangleBvh,
    lattice: &FieldLattice,
    watertight: bool,
    distance: &mut [f32],
    watch: &Watch,
) -> Result<[usize; 2], String> {
    let [nx, ny, _] = lattice.size;
    let done = AtomicUsize::new(0);
    let slabs = lattice.size[2].div_ceil(BLOCK);
    let counts = distance
        .par_chunks_mut(nx * ny * BLOCK)
        .enumerate()
        .map(|(s, slab)| {
            let mut signs = Signs {
                tree,
                lattice,
                watertight,
                k0: s * BLOCK,
                counts: [0; 2],
            };
            let layers = slab.len() / (nx * ny);
            for j in (0..ny).step_by(BLOCK) {
                for i in (0..nx).step_by(BLOCK) {
                    if !watch.is_cancelled() {
                        signs.decide(
                            slab,
                            [i, j, s * BLOCK],
                            [(i + BLOCK).min(nx), (j + BLOCK).min(ny), s * BLOCK + layers],
                        );
                    }
                }
            }
            (watch.progress)(0.6 + 0.4 * (done.fetch_add(1, Ordering::Relaxed) + 1) as f32 / slabs as f32);
            signs.counts
        })
        .reduce(|| [0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
    if watch.is_cancelled() {
        Err(CANCELLED.into())
    } else {
        Ok(counts)
    }
}

/// Gives the distances their sign by counting crossings along each row.
fn parity(tree: &TriangleBvh, lattice: &FieldLattice, distance: &mut [f32]) {
    let [nx, ny, _] = lattice.size;
    distance.par_chunks_mut(nx).enumerate().for_each(|(row, values)| {
        // Slightly offset: a line through an edge or a vertex meets two triangles there, or none.
        let aside = Vec3::new(-1.0, 0.0103, 0.0171) * lattice.cell;
        let origin = lattice.point(0, row % ny, row / ny) + aside;
        let mut crossings: Vec<(f32, bool)> = tree
            .crossings(origin, Vec3::X, 0.0, f32::INFINITY)
            .iter()
            .map(|h| (h.t, h.front))
            .collect();
        crossings.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Both triangles of an edge that were hit count as one wall.
        crossings.dedup_by(|b, a| b.1 == a.1 && b.0 - a.0 <= 1e-4 * lattice.cell);
        for (i, d) in values.iter_mut().enumerate() {
            let before = crossings.partition_point(|c| c.0 <= (i + 1) as f32 * lattice.cell);
            *d = if before % 2 == 1 { d.abs() } else { -d.abs() };
        }
    });
}

struct Signs<'a> {
    tree: &'a TriangleBvh,
    lattice: &'a FieldLattice,
    watertight: bool,
    /// First layer of the slab.
    k0: usize,
    counts: [usize; 2],
}

impl Signs<'_> {
    fn at(&self, [i, j, k]: [usize; 3]) -> usize {
        ((k - self.k0) * self.lattice.size[1] + j) * self.lattice.size[0] + i
    }

    fn winding(&mut self, [i, j, k]: [usize; 3]) -> f32 {
        let w = self.tree.winding(self.lattice.point(i, j, k));
        self.counts[0] += 1;
        self.counts[1] += usize::from((w - 0.5).abs() < 0.25);
        w
    }

    /// Decides the signs of the points low..high.
    fn decide(&mut self, slab: &mut [f32], low: [usize; 3], high: [usize; 3]) {
        let edges: [usize; 3] = std::array::from_fn(|a| high[a] - low[a]);
        let middle: [usize; 3] = std::array::from_fn(|a| low[a] + edges[a] / 2);
        let single = edges == [1; 3];
        let away = Vec3::from(std::array::from_fn(|a| {
            (middle[a] - low[a]).max(high[a] - 1 - middle[a]) as f32
        }))
        .length()
            * self.lattice.cell;
        // Swept distances are slightly above the true ones.
        let free = single || slab[self.at(middle)].abs() * 0.97 - 0.5 * self.lattice.cell > away;
        if free {
            let w = self.winding(middle);
            let inside = w > 0.5;
            let agreed = single
                || self.watertight
                || ((w - 0.5).abs() > DOUBT
                    && (0..8).all(|c| {
                        let corner =
                            std::array::from_fn(|a| if c >> a & 1 == 0 { low[a] } else { high[a] - 1 });
                        let w = self.winding(corner);
                        (w > 0.5) == inside && (w - 0.5).abs() > DOUBT
                    }));
            if agreed {
                for k in low[2]..high[2] {
                    for j in low[1]..high[1] {
                        let row = self.at([low[0], j, k]);
                        for d in &mut slab[row..row + edges[0]] {
                            *d = if inside { d.abs() } else { -d.abs() };
                        }
                    }
                }
                return;
            }
        }
        for part in 0..8 {
            let (mut a, mut b) = (low, high);
            let mut empty = false;
            for axis in 0..3 {
                let split = low[axis] + edges[axis].div_ceil(2);
                if part >> axis & 1 == 0 {
                    b[axis] = split;
                } else {
                    a[axis] = split;
                }
                empty |= a[axis] >= b[axis];
            }
            if !empty {
                self.decide(slab, a, b);
            }
        }
    }
}

/// Mean and 99th percentile of | |∇f| - 1 | at points in the band whose neighbours are all on their
/// side of the surface.
fn eikonal(distance: &[f32], lattice: &FieldLattice) -> [f64; 2] {
    let [nx, ny, nz] = lattice.size;
    if nx < 3 || ny < 3 || nz < 3 {
        return [0.0; 2];
    }
    let mut off: Vec<f32> = (1..nz - 1)
        .into_par_iter()
        .flat_map_iter(|k| (1..ny - 1).flat_map(move |j| (1..nx - 1).map(move |i| (k * ny + j) * nx + i)))
        .filter(|&n| distance[n].abs() < BAND * lattice.cell)
        .map(|n| {
            let d = |m: usize| (distance[n + m] - distance[n - m]) / (2.0 * lattice.cell);
            (Vec3::new(d(1), d(nx), d(nx * ny)).length() - 1.0).abs()
        })
        .collect();
    if off.is_empty() {
        return [0.0; 2];
    }
    let mean = off.iter().map(|v| f64::from(*v)).sum::<f64>() / off.len() as f64;
    let at = (off.len() * 99 / 100).min(off.len() - 1);
    off.select_nth_unstable_by(at, f32::total_cmp);
    [mean, f64::from(off[at])]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_can_be_cancelled() {
        let mesh = Mesh::new(
            vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
            vec![],
        );
        let cancel = std::sync::atomic::AtomicBool::new(true);
        let result = MeshField::new(
            &mesh,
            &FieldSettings::default(),
            &Watch {
                progress: &|_| (),
                cancel: &cancel,
            },
        );
        assert_eq!(result.err().as_deref(), Some(CANCELLED));
    }
}
