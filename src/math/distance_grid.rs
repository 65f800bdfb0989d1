//! A signed distance on a grid of points, as sampled by renderers and deformations: millimetres,
//! positive inside ([`crate::model`], "Surfaces").

use super::arrays::{flat, size};
use super::trilinear;
use glam::{Affine3A, Mat3, Vec3};
use ndarray::Array3;

/// Signed distances at the points of a grid.
#[derive(Clone, Debug)]
pub struct DistanceGrid {
    /// Points along i, j, k.
    pub size: [usize; 3],
    /// Distances, mm, of shape (k, j, i).
    pub distance_mm: Array3<f32>,
    /// Grid indices to world mm.
    pub world_from_grid: Affine3A,
    /// The inverse.
    pub grid_from_world: Affine3A,
}

impl DistanceGrid {
    /// A grid of distances; `world_from_grid` must be invertible.
    pub fn new(distance_mm: Array3<f32>, world_from_grid: Affine3A) -> Self {
        let distance_mm = distance_mm.as_standard_layout().into_owned();
        Self {
            size: size(&distance_mm),
            distance_mm,
            world_from_grid,
            grid_from_world: world_from_grid.inverse(),
        }
    }

    /// Signed distance at a world point, mm. Outside the grid it is bounded by the value at the
    /// nearest grid point and the distance from it: the grid is convex, hence nothing in it is
    /// nearer than the hypotenuse of the two.
    pub fn sample(&self, world: Vec3) -> f32 {
        let p = self.grid_from_world.transform_point3(world);
        let top = Vec3::from(self.size.map(|n| (n - 1) as f32));
        let nearest = p.clamp(Vec3::ZERO, top);
        let beyond = if nearest == p {
            0.0
        } else {
            Mat3::from(self.world_from_grid.matrix3)
                .mul_vec3(p - nearest)
                .length()
        };
        let f = trilinear(flat(&self.distance_mm), self.size, p);
        if beyond > 0.0 {
            if f < 0.0 { -f.hypot(beyond) } else { f - beyond }
        } else {
            f
        }
    }

    /// Gradient at a world point by central differences over `step_mm`: approximately a unit vector
    /// into the region.
    pub fn gradient(&self, world: Vec3, step_mm: f32) -> Vec3 {
        let d =
            |e: Vec3| (self.sample(world + e * step_mm) - self.sample(world - e * step_mm)) / (2.0 * step_mm);
        Vec3::new(d(Vec3::X), d(Vec3::Y), d(Vec3::Z))
    }

    /// Closes the solid at the faces of the grid, where the scan cuts it off.
    pub fn closed_at_faces(mut self) -> Self {
        let per_mm = Mat3::from(self.grid_from_world.matrix3).transpose();
        // Distance between two planes of points, mm: the axes of an oblique grid are not
        // perpendicular.
        let between = [per_mm.x_axis, per_mm.y_axis, per_mm.z_axis].map(|row| row.length().recip());
        let size = self.size;
        for ((k, j, i), d) in self.distance_mm.indexed_iter_mut() {
            let at = [i, j, k];
            // One or two slices have no interior between their faces.
            let to_face = (0..3)
                .filter(|a| size[*a] > 2)
                .map(|a| at[a].min(size[a] - 1 - at[a]) as f32 * between[a])
                .fold(f32::INFINITY, f32::min);
            *d = d.min(to_face);
        }
        self
    }

    /// Smallest distance between neighbouring points, mm.
    pub fn spacing_mm(&self) -> f32 {
        let m = self.world_from_grid.matrix3;
        m.x_axis.length().min(m.y_axis.length()).min(m.z_axis.length())
    }
}
