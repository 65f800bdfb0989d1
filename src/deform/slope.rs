//! How fast the deformation can change: bounds on |J v| for unit v over boxes of the deformed scene, for Jacobian steps and sphere tracing
//! (`model.md` section 9).
//!
//! Within a cell of a map's grid each column of J lies in the hull of the differences along four edges. With M their mean, |J| ≤ |M| + the
//! Frobenius norm of the largest deviations; |M| is the root of the largest eigenvalue of MᵀM. The product of the maps' bounds, each
//! over the box that the later maps can carry the deformed box to, bounds the stack's.

use super::{PlacedMap, Stack};
use crate::math::{Bounds, MinMaxPyramid};
use glam::{Mat3, Vec3, Vec4Swizzles};

/// Bounds for every map of a stack.
pub struct Slopes<'a> {
    stack: &'a Stack,
    /// None for a map that only cuts.
    of_maps: Vec<Option<MinMaxPyramid<1>>>,
}

/// The largest singular value of a matrix: the root of the largest eigenvalue of MᵀM (Smith 1961, in closed form).
pub fn spectral_norm(m: Mat3) -> f32 {
    let a = m.transpose() * m;
    let (xy, xz, yz) = (a.y_axis.x, a.z_axis.x, a.z_axis.y);
    let off = xy * xy + xz * xz + yz * yz;
    let mean = (a.x_axis.x + a.y_axis.y + a.z_axis.z) / 3.0;
    let (dx, dy, dz) = (a.x_axis.x - mean, a.y_axis.y - mean, a.z_axis.z - mean);
    let p = ((dx * dx + dy * dy + dz * dz + 2.0 * off) / 6.0).sqrt();
    if p < 1e-12 {
        return mean.max(0.0).sqrt();
    }
    let r = ((a - Mat3::from_diagonal(Vec3::splat(mean))).determinant() / (2.0 * p * p * p)).clamp(-1.0, 1.0);
    (mean + 2.0 * p * (r.acos() / 3.0).cos()).max(0.0).sqrt()
}

impl PlacedMap {
    /// Bounds on |J_G| per cell of the map's grid.
    fn slopes(&self) -> MinMaxPyramid<1> {
        let size = self.map.size;
        let cells = size.map(|n| n.max(2) - 1);
        let (world_from_map, map_from_world) = (self.placement.world_from_map, self.placement.map_from_world);
        let (linear, inverse) = (Mat3::from(world_from_map.matrix3) * self.map.scale, Mat3::from(map_from_world.matrix3));
        let texel = |c: [usize; 3]| self.map.texel(std::array::from_fn(|a| c[a].min(size[a] - 1))).xyz();
        MinMaxPyramid::new(cells, 1, |i, j, k| {
            let at = [i, j, k];
            let mut mean = [Vec3::ZERO; 3];
            let mut deviation = 0.0f32;
            for axis in 0..3 {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let differences: [Vec3; 4] = std::array::from_fn(|n| {
                    let mut low = at;
                    low[u] += n & 1;
                    low[v] += n >> 1;
                    let mut high = low;
                    high[axis] += 1;
                    // Along map space in world mm.
                    linear * (texel(high) - texel(low)) * (size[axis].max(2) - 1) as f32
                });
                mean[axis] = differences.iter().sum::<Vec3>() / 4.0;
                deviation += differences.iter().map(|d| (*d - mean[axis]).length_squared()).fold(0.0, f32::max);
            }
            let m = Mat3::IDENTITY + Mat3::from_cols(mean[0], mean[1], mean[2]) * inverse;
            [spectral_norm(m) + deviation.sqrt() * spectral_norm(inverse)]
        })
    }
}

impl<'a> Slopes<'a> {
    /// Prepares the bounds of a stack.
    pub fn new(stack: &'a Stack) -> Self {
        Self { stack, of_maps: stack.maps().iter().map(|m| m.map.moves_matter().then(|| m.slopes())).collect() }
    }

    /// A bound on how far two source points can lie apart per millimetre between their deformed points, over a box of the deformed scene.
    pub fn bound(&self, deformed: &Bounds) -> f32 {
        let (mut b, mut at) = (*deformed, *deformed);
        let (mut whole, mut here, mut together) = (1.0f32, 1.0f32, true);
        for (map, slopes) in self.stack.maps().iter().zip(&self.of_maps).rev() {
            let (own, moved) = slopes.as_ref().map_or((1.0, Bounds::new(Vec3::ZERO, Vec3::ZERO)), |s| map.slope_over(&at, s));
            // A map that follows one added to it sees a point that the walk has left: its displacement alone counts, J - I.
            whole = if together { own * here } else { whole + (own + 1.0) * here };
            b = Bounds::new(b.min + moved.min, b.max + moved.max);
            together = !map.added;
            if together {
                (at, here) = (b, whole);
            }
        }
        whole
    }
}

impl PlacedMap {
    /// The bound over a box, and the box of displacements there.
    fn slope_over(&self, b: &Bounds, slopes: &MinMaxPyramid<1>) -> (f32, Bounds) {
        let moved = self.displacement_bounds(b);
        let inside = b.transformed(&self.placement.map_from_world).grown(1e-4).intersection(&Bounds::new(-self.reach, Vec3::ONE + self.reach));
        if inside.is_empty() {
            return (1.0, moved);
        }
        let top = Vec3::from(self.map.size.map(|n| (n.max(2) - 1) as f32));
        let cell = |x: Vec3| (x * top).floor();
        let own = slopes.query(cell(inside.min), cell(inside.max)).max[0];
        (own.max(1.0), moved)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DisplacementMap, Placement, Storage, TexelSample};
    use super::*;
    use proptest::prelude::*;
    use std::sync::Arc;

    fn placed(center: Vec3, f: impl Fn(Vec3) -> TexelSample + Sync) -> PlacedMap {
        let placement = Placement::new(center, Vec3::new(60.0, 40.0, 50.0), Vec3::new(20.0, 40.0, -10.0)).unwrap_or_else(|e| panic!("{e}"));
        PlacedMap::new(Arc::new(DisplacementMap::from_fn([17, 19, 15], Storage::F16, f)), placement)
    }

    proptest! {
        #[test]
        fn bounds_hold(corner in prop::array::uniform3(-30.0f32..30.0), edge in 0.5f32..10.0, a in prop::array::uniform3(0.0f32..1.0), b in prop::array::uniform3(0.0f32..1.0), added: bool) {
            let bump = |x: Vec3| (x * (Vec3::ONE - x) * 4.0).element_product();
            let mut maps = vec![
                placed(Vec3::ZERO, |x| TexelSample { displacement: 0.2 * bump(x) * Vec3::new((9.0 * x.y).sin(), x.z, -1.0), alpha: 1.0 }),
                placed(Vec3::X * 9.0, |x| TexelSample { displacement: 0.3 * bump(x) * Vec3::new(1.0, (5.0 * x.x).cos(), 0.2), alpha: 1.0 }),
            ];
            maps[1].added = added;
            let stack = Stack::new(maps);
            let slopes = Slopes::new(&stack);
            let low = Vec3::from(corner);
            let (p, q) = (low + Vec3::from(a) * edge, low + Vec3::from(b) * edge);
            let bound = slopes.bound(&Bounds::new(low, low + edge));
            let apart = stack.walk_through(p).0.distance(stack.walk_through(q).0);
            prop_assert!(apart <= bound * p.distance(q) * 1.001 + 1e-3, "{} apart, {} x {}", apart, bound, p.distance(q));
        }
    }

    #[test]
    fn norms_of_known_matrices() {
        assert!((spectral_norm(Mat3::from_rotation_x(0.7)) - 1.0).abs() < 1e-6);
        assert!((spectral_norm(Mat3::from_diagonal(Vec3::new(0.5, -3.0, 1.0))) - 3.0).abs() < 1e-5);
        assert!((spectral_norm(Mat3::from_cols(Vec3::X, Vec3::X * 2.0, Vec3::ZERO)) - 5.0f32.sqrt()).abs() < 1e-5);
    }
}
