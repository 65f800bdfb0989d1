//! Bounds on the rate of change of the deformation: on |J v| for unit v over boxes of the deformed
//! scene, for Jacobian steps and sphere tracing ([`crate::model`], "Empty space").
//!
//! Within a cell of a map's grid, each column of J lies in the hull of the differences along four
//! edges. With M their mean, |J| ≤ |M| + the Frobenius norm of the largest deviations; |M| is the
//! root of the largest eigenvalue of MᵀM, approached from above. The stack's bound is the product
//! of the maps' bounds, each over the box to which the later maps can carry the deformed box.

use super::{PlacedMap, Stack};
use crate::math::cells::columns;
use crate::math::lanes::*;
use crate::math::{Bounds, MinMaxPyramid};
use glam::{Mat3, Vec3, Vec4};
use rayon::prelude::*;

/// Bounds for every map of a stack.
pub struct LipschitzBounds<'a> {
    stack: &'a Stack,
    /// None for a map that only cuts.
    of_maps: Vec<Option<MinMaxPyramid<1>>>,
}

/// The largest singular value of a matrix: the root of the largest eigenvalue of MᵀM (Smith 1961,
/// in closed form).
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
        let texels = self.map.texels();
        let (world_from_map, map_from_world) = (self.placement.world_from_map, self.placement.map_from_world);
        // In axes aligned with the map, in which most deformations act: a rotation of both spaces
        // changes no norm.
        let world_from_map = Mat3::from(world_from_map.matrix3);
        let x = world_from_map.x_axis.normalize_or(Vec3::X);
        let y = world_from_map
            .y_axis
            .reject_from_normalized(x)
            .normalize_or(x.any_orthonormal_vector());
        let turned = Mat3::from_cols(x, y, x.cross(y));
        let (linear, inverse) = (
            turned.transpose() * world_from_map * self.map.scale,
            Mat3::from(map_from_world.matrix3) * turned,
        );
        let shared = MapConstants {
            linear,
            inverse,
            norm_of_inverse: spectral_norm(inverse),
            per_unit: Vec3::from(cells.map(|n| n as f32)),
        };
        let mut bounds = vec![0.0; cells.iter().product()];
        bounds
            .par_chunks_mut(cells[0])
            .enumerate()
            .for_each(|(n, bounds)| {
                let (j, k) = (n % cells[1], n / cells[1]);
                // A flat axis uses the same texel on both sides.
                let (up, on) = ((j + 1).min(size[1] - 1), (k + 1).min(size[2] - 1));
                let row = |j: usize, k: usize| &texels[(k * size[1] + j) * size[0]..][..size[0]];
                with_simd(CellRow {
                    rows: [row(j, k), row(up, k), row(j, on), row(up, on)],
                    shared: &shared,
                    bounds,
                });
            });
        MinMaxPyramid::new(cells, 1, |i, j, k| [bounds[(k * cells[1] + j) * cells[0] + i]])
    }
}

/// What all rows of a map share.
struct MapConstants {
    /// From stored displacements to mm, in the map's axes.
    linear: Mat3,
    /// From mm to map units, and its norm.
    inverse: Mat3,
    norm_of_inverse: f32,
    /// Cells per map unit.
    per_unit: Vec3,
}

/// A row of a map's cells: the four rows of texels around it (along y, then z), and a bound for
/// each cell.
struct CellRow<'a> {
    rows: [&'a [Vec4]; 4],
    shared: &'a MapConstants,
    bounds: &'a mut [f32],
}

impl SimdKernel for CellRow<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::needless_range_loop, reason = "lanes have numbers")]
    fn run<S: Simd>(self, simd: S) {
        let Self {
            rows: [a, b, c, d],
            shared,
            bounds,
        } = self;
        let mut first = 0;
        while first < bounds.len() {
            let bound = bound_of_eight(simd, [a, b, c, d], first, shared);
            let many = LANES.min(bounds.len() - first);
            for n in 0..many {
                bounds[first + n] = bound[n];
            }
            first += LANES;
        }
    }
}

/// Displacements in mm at eight texels of a row; beyond its end the last texel is repeated.
#[inline(always)]
fn displacements<S: Simd>(simd: S, row: &[Vec4], first: usize, linear: &Mat3) -> Vec3x8<S> {
    let mut texels = [[0.0; 4]; LANES];
    for n in 0..LANES {
        texels[n] = row[(first + n).min(row.len() - 1)].to_array();
    }
    let [x, y, z, _] = columns(simd, &texels);
    Vec3x8 { x, y, z }.mapped(linear)
}

/// The mean of four differences, and the largest squared deviation from it.
#[inline(always)]
fn spread<S: Simd>(
    a: Vec3x8<S>,
    b: Vec3x8<S>,
    c: Vec3x8<S>,
    d: Vec3x8<S>,
    per_unit: f32,
) -> (Vec3x8<S>, f32x8<S>) {
    let token = a.x.token();
    let mean = (a + b + c + d) * f32x8::splat(token, 0.25);
    let (a, b, c, d) = (a - mean, b - mean, c - mean, d - mean);
    let most = a.dot(a).max(b.dot(b)).max(c.dot(c).max(d.dot(d)));
    (mean * f32x8::splat(token, per_unit), most * (per_unit * per_unit))
}

/// The largest eigenvalue of positive semidefinite symmetric matrices, from above. The start is the
/// largest sum of a row's absolute values (Gershgorin 1931). From there Newton's method on the
/// characteristic polynomial decreases towards the eigenvalue and never passes it, because the
/// polynomial is increasing and convex there.
#[inline(always)]
fn largest_eigenvalue<S: Simd>([a, b, c]: [f32x8<S>; 3], [ab, ac, bc]: [f32x8<S>; 3]) -> f32x8<S> {
    let of_rows = (a + ab.abs() + ac.abs())
        .max(b + ab.abs() + bc.abs())
        .max(c + ac.abs() + bc.abs());
    let trace = a + b + c;
    let minors = a * b - ab * ab + (a * c - ac * ac) + (b * c - bc * bc);
    let determinant = a * (b * c - bc * bc) - ab * (ab * c - bc * ac) + ac * (ab * bc - b * ac);
    let mut largest = of_rows;
    for _ in 0..2 {
        let value = ((largest - trace) * largest + minors) * largest - determinant;
        let slope = (largest * 3.0 - trace * 2.0) * largest + minors;
        // Near a multiple root both vanish, and little can be gained.
        let usable = slope.simd_gt(trace * trace * 0.002) & value.simd_gt(0.0);
        largest = usable.select(largest - value / slope, largest);
    }
    largest
}

/// A column of I + M A⁻¹, from M's columns and one of A⁻¹.
#[inline(always)]
fn column<S: Simd>(unit: Vec3, [x, y, z]: [Vec3x8<S>; 3], v: Vec3) -> Vec3x8<S> {
    let token = x.x.token();
    let (p, q, r) = (
        f32x8::splat(token, v.x),
        f32x8::splat(token, v.y),
        f32x8::splat(token, v.z),
    );
    Vec3x8::splat(token, unit) + x * p + y * q + z * r
}

/// Bounds on |J_G| in eight cells of a row: |M| by [`largest_eigenvalue`], plus the contribution of
/// the deviations.
#[inline(always)]
fn bound_of_eight<S: Simd>(
    simd: S,
    [a, b, c, d]: [&[Vec4]; 4],
    first: usize,
    shared: &MapConstants,
) -> f32x8<S> {
    let MapConstants {
        linear,
        inverse,
        norm_of_inverse,
        per_unit,
    } = shared;
    let (a0, a1) = (
        displacements(simd, a, first, linear),
        displacements(simd, a, first + 1, linear),
    );
    let (b0, b1) = (
        displacements(simd, b, first, linear),
        displacements(simd, b, first + 1, linear),
    );
    let (c0, c1) = (
        displacements(simd, c, first, linear),
        displacements(simd, c, first + 1, linear),
    );
    let (d0, d1) = (
        displacements(simd, d, first, linear),
        displacements(simd, d, first + 1, linear),
    );
    let (x, of_x) = spread(a1 - a0, b1 - b0, c1 - c0, d1 - d0, per_unit.x);
    let (y, of_y) = spread(b0 - a0, b1 - a1, d0 - c0, d1 - c1, per_unit.y);
    let (z, of_z) = spread(c0 - a0, c1 - a1, d0 - b0, d1 - b1, per_unit.z);
    let p = column(Vec3::X, [x, y, z], inverse.x_axis);
    let q = column(Vec3::Y, [x, y, z], inverse.y_axis);
    let r = column(Vec3::Z, [x, y, z], inverse.z_axis);
    let largest = largest_eigenvalue([p.dot(p), q.dot(q), r.dot(r)], [p.dot(q), p.dot(r), q.dot(r)]);
    largest.sqrt() + (of_x + of_y + of_z).sqrt() * *norm_of_inverse
}

impl<'a> LipschitzBounds<'a> {
    /// Prepares the bounds of a stack.
    pub fn new(stack: &'a Stack) -> Self {
        Self {
            stack,
            of_maps: stack
                .maps()
                .iter()
                .map(|m| (m.map.has_displacement() && m.cylinder.is_none()).then(|| m.slopes()))
                .collect(),
        }
    }

    /// A bound on the distance between two source points per millimetre between their deformed
    /// points, over a box of the deformed scene.
    pub fn bound(&self, deformed: &Bounds) -> f32 {
        let (mut b, mut at) = (*deformed, *deformed);
        let (mut whole, mut here, mut together) = (1.0f32, 1.0f32, true);
        for (map, slopes) in self.stack.maps().iter().zip(&self.of_maps).rev() {
            let (own, moved) = match slopes {
                Some(slopes) => map.lipschitz_over(&at, slopes),
                None if map.cylinder.is_some() => (
                    map.cylinder_slope_bound(&at.transformed(&map.placement.map_from_world)),
                    map.displacement_bounds(&at),
                ),
                None => (1.0, Bounds::new(Vec3::ZERO, Vec3::ZERO)),
            };
            // A map evaluated at the same point as the one added to it contributes only its
            // displacement, J - I.
            whole = if together {
                own * here
            } else {
                whole + (own + 1.0) * here
            };
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
    /// The bound over a box, and a box around the displacements there.
    fn lipschitz_over(&self, b: &Bounds, slopes: &MinMaxPyramid<1>) -> (f32, Bounds) {
        let moved = self.displacement_bounds(b);
        let inside = b
            .transformed(&self.placement.map_from_world)
            .grown(1e-4)
            .intersection(&Bounds::new(-self.reach, Vec3::ONE + self.reach));
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
        let placement = Placement::new(center, Vec3::new(60.0, 40.0, 50.0), Vec3::new(20.0, 40.0, -10.0))
            .unwrap_or_else(|e| panic!("{e}"));
        PlacedMap::new(
            Arc::new(DisplacementMap::from_fn([17, 19, 15], Storage::F16, f)),
            placement,
        )
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
            let slopes = LipschitzBounds::new(&stack);
            let low = Vec3::from(corner);
            let (p, q) = (low + Vec3::from(a) * edge, low + Vec3::from(b) * edge);
            let bound = slopes.bound(&Bounds::new(low, low + edge));
            let apart = stack.source_and_alpha_unclipped(p).0.distance(stack.source_and_alpha_unclipped(q).0);
            prop_assert!(apart <= bound * p.distance(q) * 1.001 + 1e-3, "{} apart, {} x {}", apart, bound, p.distance(q));
        }
    }

    /// For linear maps the bound is the norm, up to the error left by two steps of Newton's method.
    #[test]
    fn bounds_of_linear_maps() {
        for size in [[2, 3, 11], [9, 17, 4], [18, 1, 2]] {
            let bound = |f: fn(Vec3) -> Vec3| {
                let map = DisplacementMap::from_fn(size, Storage::F32, |x| TexelSample {
                    displacement: f(x - 0.5),
                    alpha: 1.0,
                });
                let placement = Placement::new(Vec3::X, Vec3::splat(40.0), Vec3::new(20.0, 40.0, -10.0))
                    .unwrap_or_else(|e| panic!("{e}"));
                let stack = Stack::new(vec![PlacedMap::new(Arc::new(map), placement)]);
                LipschitzBounds::new(&stack).bound(&Bounds::new(Vec3::splat(-4.0), Vec3::splat(4.0)))
            };
            let stretched = bound(|x| Vec3::new(0.75 * x.x, 0.0, 0.5 * x.z));
            assert!((stretched - 1.75).abs() < 1e-5, "{size:?}: {stretched}");
            let shrunk = bound(|x| -0.5 * x);
            assert!((shrunk - 1.0).abs() < 1e-5, "{size:?}: {shrunk}");
            let (sheared, golden) = (bound(|x| Vec3::new(x.z, 0.0, 0.0)), 0.5 + 1.25f32.sqrt());
            assert!(
                sheared >= golden - 1e-5 && sheared < 1.005 * golden,
                "{size:?}: {sheared}"
            );
            let turned = bound(|x| Mat3::from_rotation_y(0.4) * x - x);
            assert!((turned - 1.0).abs() < 1e-4, "{size:?}: {turned}");
        }
    }

    #[test]
    fn norms_of_known_matrices() {
        assert!((spectral_norm(Mat3::from_rotation_x(0.7)) - 1.0).abs() < 1e-6);
        assert!((spectral_norm(Mat3::from_diagonal(Vec3::new(0.5, -3.0, 1.0))) - 3.0).abs() < 1e-5);
        assert!(
            (spectral_norm(Mat3::from_cols(Vec3::X, Vec3::X * 2.0, Vec3::ZERO)) - 5.0f32.sqrt()).abs() < 1e-5
        );
    }
}
