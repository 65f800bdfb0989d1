//! ITK's B-spline transform: a displacement made of cubic B-splines on a coarse grid of
//! coefficients (Rueckert et al. 1999).

use crate::volume::GridGeometry;
use glam::{DAffine3, DVec3, Vec3};

/// Coefficients on their grid. As in ITK, nothing moves where the 4x4x4 coefficients around a point
/// are incomplete.
pub struct BSplineGrid {
    /// The grid of the coefficients.
    pub grid: GridGeometry,
    /// Displacement coefficients, LPS mm, i fastest.
    pub coefficients: Vec<Vec3>,
    voxel_from_world: DAffine3,
}

/// Cubic B-spline weights of the four coefficients around a point at fraction `t` after the second
/// one.
pub(crate) fn cubic_weights(t: f64) -> [f64; 4] {
    let u = 1.0 - t;
    [
        u * u * u / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
        t * t * t / 6.0,
    ]
}

impl BSplineGrid {
    /// Coefficients on a grid; one per point.
    pub fn new(grid: GridGeometry, coefficients: Vec<Vec3>) -> Self {
        assert_eq!(
            coefficients.len(),
            grid.size.iter().product::<usize>(),
            "coefficient count and size disagree"
        );
        Self {
            grid,
            coefficients,
            voxel_from_world: grid.world_from_voxel.inverse(),
        }
    }

    /// The source of a deformed point.
    pub fn source_from_deformed(&self, p: DVec3) -> DVec3 {
        let v = self.voxel_from_world.transform_point3(p);
        let [nx, ny, nz] = self.grid.size;
        let top = DVec3::new(nx as f64 - 2.0, ny as f64 - 2.0, nz as f64 - 2.0);
        // Points on the region's faces stay inside despite the rounding of the transform.
        if v.cmplt(DVec3::splat(1.0 - 1e-9)).any() || v.cmpgt(top + 1e-9).any() {
            return p;
        }
        let first = v.floor().min(top - 1.0).max(DVec3::ONE);
        let f = v - first;
        let (wx, wy, wz) = (cubic_weights(f.x), cubic_weights(f.y), cubic_weights(f.z));
        let (i, j, k) = (first.x as usize - 1, first.y as usize - 1, first.z as usize - 1);
        let mut sum = DVec3::ZERO;
        for (c, wz) in wz.iter().enumerate() {
            for (b, wy) in wy.iter().enumerate() {
                let row = ((k + c) * ny + j + b) * nx + i;
                for (coefficient, wx) in self.coefficients[row..row + 4].iter().zip(&wx) {
                    sum += coefficient.as_dvec3() * (wx * wy * wz);
                }
            }
        }
        p + sum
    }

    /// A grid fine enough to sample the splines, over the region where all their coefficients
    /// exist.
    pub fn fine_grid(&self) -> GridGeometry {
        let spans = self.grid.size.map(|n| n.saturating_sub(3).max(1));
        let refine = spans.map(|n| (192.0 / n as f64).clamp(4.0, 32.0).floor());
        let scale = DVec3::from_array(refine.map(f64::recip));
        GridGeometry {
            size: std::array::from_fn(|a| spans[a] * refine[a] as usize + 1),
            world_from_voxel: self.grid.world_from_voxel
                * DAffine3::from_translation(DVec3::ONE)
                * DAffine3::from_scale(scale),
        }
    }
}
