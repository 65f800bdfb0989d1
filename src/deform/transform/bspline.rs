//! ITK's B-spline transform: a displacement made of B-splines of order 1 to 3, mostly cubic ones,
//! on a coarse grid of coefficients (Rueckert et al. 1999).

use crate::volume::GridGeometry;
use glam::{DAffine3, DVec3, Vec3};

/// Coefficients on their grid. As in ITK, nothing moves where the coefficients around a point
/// (4x4x4 for cubic splines) are incomplete.
pub struct BSplineGrid {
    /// The grid of the coefficients.
    pub grid: GridGeometry,
    /// Displacement coefficients, LPS mm, i fastest.
    pub coefficients: Vec<Vec3>,
    /// Order of the splines, 1 to 3.
    pub order: usize,
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

/// B-spline weights of the `order + 1` coefficients around a point; `t` is its distance from the
/// first one.
fn weights(order: usize, t: f64) -> [f64; 4] {
    match order {
        1 => [1.0 - t, t, 0.0, 0.0],
        2 => {
            let u = t - 1.0;
            [
                0.5 * (0.5 - u).powi(2),
                0.75 - u * u,
                0.5 * (0.5 + u).powi(2),
                0.0,
            ]
        }
        _ => cubic_weights(t - 1.0),
    }
}

impl BSplineGrid {
    /// Coefficients on a grid, one per point, of splines of an order from 1 to 3.
    pub fn new(grid: GridGeometry, coefficients: Vec<Vec3>, order: usize) -> Self {
        assert_eq!(
            coefficients.len(),
            grid.size.iter().product::<usize>(),
            "coefficient count and size disagree"
        );
        Self {
            grid,
            coefficients,
            order: order.clamp(1, 3),
            voxel_from_world: grid.world_from_voxel.inverse(),
        }
    }

    /// The source of a deformed point.
    pub fn source_from_deformed(&self, p: DVec3) -> DVec3 {
        let v = self.voxel_from_world.transform_point3(p);
        let [nx, ny, nz] = self.grid.size;
        // Half the order lies on either side of a point.
        let (order, margin) = (self.order, (self.order as f64 - 1.0) / 2.0);
        let top = DVec3::new(nx as f64, ny as f64, nz as f64) - 1.0 - margin;
        // Points on the region's faces stay inside despite the rounding of the transform.
        if v.cmplt(DVec3::splat(margin - 1e-9)).any() || v.cmpgt(top + 1e-9).any() {
            return p;
        }
        let last = DVec3::new(nx as f64, ny as f64, nz as f64) - 1.0 - order as f64;
        let first = (v - margin).floor().min(last).max(DVec3::ZERO);
        let f = v - first;
        let [wx, wy, wz] = [f.x, f.y, f.z].map(|t| weights(order, t));
        let (i, j, k) = (first.x as usize, first.y as usize, first.z as usize);
        let mut sum = DVec3::ZERO;
        for (c, wz) in wz.iter().enumerate().take(order + 1) {
            for (b, wy) in wy.iter().enumerate().take(order + 1) {
                let row = ((k + c) * ny + j + b) * nx + i;
                for (coefficient, wx) in self.coefficients[row..=row + order].iter().zip(&wx) {
                    sum += coefficient.as_dvec3() * (wx * wy * wz);
                }
            }
        }
        p + sum
    }

    /// A grid fine enough to sample the splines, over the region where all their coefficients
    /// exist.
    pub fn fine_grid(&self) -> GridGeometry {
        let spans = self.grid.size.map(|n| n.saturating_sub(self.order).max(1));
        let refine = spans.map(|n| (192.0 / n as f64).clamp(4.0, 32.0).floor());
        let scale = DVec3::from_array(refine.map(f64::recip));
        let margin = (self.order as f64 - 1.0) / 2.0;
        GridGeometry {
            size: std::array::from_fn(|a| spans[a] * refine[a] as usize + 1),
            world_from_voxel: self.grid.world_from_voxel
                * DAffine3::from_translation(DVec3::splat(margin))
                * DAffine3::from_scale(scale),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_of_every_order_reproduce_lines() {
        for order in 1..4 {
            let margin = (order as f64 - 1.0) / 2.0;
            for n in 0..=10 {
                let t = margin + f64::from(n) / 10.0;
                let w = weights(order, t);
                let at: f64 = w.iter().enumerate().map(|(k, w)| w * k as f64).sum();
                assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{order} {t}");
                assert!((at - t).abs() < 1e-12, "{order} {t}: {at}");
            }
        }
    }
}
