//! A signed distance on a grid of points, as renderers and deformations sample it: millimetres, positive inside (`model.md` section 6).

use super::trilinear;
use glam::{Affine3A, Mat3, Vec3};

/// Signed distances at the points of a grid.
#[derive(Clone, Debug)]
pub struct DistanceGrid {
    /// Points along i, j, k.
    pub size: [usize; 3],
    /// Distances, mm, i fastest.
    pub distance_mm: Vec<f32>,
    /// Grid indices to world mm.
    pub world_from_grid: Affine3A,
    /// The inverse.
    pub grid_from_world: Affine3A,
}

impl DistanceGrid {
    /// A grid of distances; `world_from_grid` must be invertible.
    pub fn new(size: [usize; 3], distance_mm: Vec<f32>, world_from_grid: Affine3A) -> Self {
        Self { size, distance_mm, world_from_grid, grid_from_world: world_from_grid.inverse() }
    }

    /// Signed distance at a world point, mm; beyond the grid it falls by the distance from the grid.
    pub fn sample(&self, world: Vec3) -> f32 {
        let p = self.grid_from_world.transform_point3(world);
        let top = Vec3::from(self.size.map(|n| (n - 1) as f32));
        let nearest = p.clamp(Vec3::ZERO, top);
        let beyond = if nearest == p { 0.0 } else { Mat3::from(self.world_from_grid.matrix3).mul_vec3(p - nearest).length() };
        trilinear(&self.distance_mm, self.size, p) - beyond
    }

    /// Gradient at a world point by central differences over `step_mm`: about a unit vector into the region.
    pub fn gradient(&self, world: Vec3, step_mm: f32) -> Vec3 {
        let d = |e: Vec3| (self.sample(world + e * step_mm) - self.sample(world - e * step_mm)) / (2.0 * step_mm);
        Vec3::new(d(Vec3::X), d(Vec3::Y), d(Vec3::Z))
    }

    /// Smallest distance between neighbouring points, mm.
    pub fn spacing_mm(&self) -> f32 {
        let m = self.world_from_grid.matrix3;
        m.x_axis.length().min(m.y_axis.length()).min(m.z_axis.length())
    }
}
