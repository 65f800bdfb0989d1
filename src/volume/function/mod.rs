//! Volumes given by a function of the position, evaluated wherever a sample is taken rather than
//! interpolated between voxels.
//!
//! A function is an [`Expression`]: a list of elementary operations on x, y, z in world
//! millimetres, recorded by a [`Graph`], or parsed from text ([`parse`]). The same list is
//! evaluated at points, bounded over boxes by interval arithmetic (which finds empty space), and
//! written as WGSL by `crate::render`.
//!
//! Every operation has a value for every number: a division by 0 gives 0, a square root of a
//! negative number 0.

mod evaluate;
mod expression;
mod parse;
mod solids;

pub use evaluate::Interval;
pub use expression::{Binary, Expression, Graph, Operation, Point, Ternary, Unary, Value};
pub use parse::{FUNCTIONS, parse};
pub use solids::{capsule, cover, cuboid, disc, ellipsoid, sphere};

use crate::math::Bounds;
use glam::{Affine3A, Vec3, Vec3A};

/// A function as a renderer samples it: at positions in voxels, with normalised values.
#[derive(Clone, Debug)]
pub struct VolumeFunction {
    /// Value in data units of a point in world millimetres.
    pub expression: Expression,
    /// Voxel indices to world millimetres.
    pub world_from_voxel: Affine3A,
    /// Normalised value = `scale` · value + `offset`.
    pub scale: f32,
    /// See `scale`.
    pub offset: f32,
}

impl VolumeFunction {
    /// Normalised values at positions in voxels.
    pub fn values<const N: usize>(&self, in_voxel: &[Vec3; N]) -> [f32; N] {
        let (mut x, mut y, mut z) = ([0.0; N], [0.0; N], [0.0; N]);
        for (n, p) in in_voxel.iter().enumerate() {
            let p = self.world_from_voxel.transform_point3a(Vec3A::from(*p));
            (x[n], y[n], z[n]) = (p.x, p.y, p.z);
        }
        let mut values = [0.0; N];
        self.expression.evaluate([&x, &y, &z], &mut values);
        values.map(|v| v * self.scale + self.offset)
    }

    /// Bounds on the normalised values in boxes given in voxels.
    pub fn bounds(&self, in_voxel: &[Bounds]) -> Vec<Interval> {
        let boxes: Vec<Bounds> = in_voxel
            .iter()
            .map(|b| b.transformed(&self.world_from_voxel))
            .collect();
        let mut bounds = self.expression.bounds(&boxes);
        for b in &mut bounds {
            let (low, high) = (
                b.low * self.scale + self.offset,
                b.high * self.scale + self.offset,
            );
            // Rounding of single evaluations.
            let slack = 1e-5 * (1.0 + low.abs().max(high.abs()));
            *b = Interval {
                low: low.min(high) - slack,
                high: low.max(high) + slack,
            };
        }
        bounds
    }
}
