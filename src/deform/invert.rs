//! Numeric inversion of forward deformations: for every point y, the x with F(x) = y.
//!
//! *Method*: fixed point x <- x - λ (F(x) - y), which needs no derivative and converges where the
//! displacement's Lipschitz constant is below 1 (Chen et al. 2008, "A simple fixed-point approach
//! to invert a deformation field"); λ is halved whenever the residual grows. Where it stalls,
//! Newton's method finishes, with a Jacobian by differences and a halving line search. Each point
//! starts from its neighbour's solution. Points of a row depend on each other, rows do not: the
//! result does not depend on the number of threads. A field on its own grid is first inverted by
//! Newton's method, eight points at once.
//!
//! Points that do not converge, or converge where det J <= 0, lie in a fold: no single source
//! exists there. Their mask is 0.

use super::compose::{placement_of, sampled_grid};
use super::transform::{Transform, TransformStep, VectorField};
use super::{PlacedMap, Storage};
use crate::Result;
use crate::math::Bounds;
use crate::math::cells::{Cells, mix_with_slopes};
use crate::math::flat;
use crate::math::lanes::*;
use crate::volume::GridGeometry;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;

/// A point counts as found when its residual is below this fraction of a voxel.
const TOLERANCE_VOXELS: f64 = 1e-4;
const FIXED_POINT_STEPS: u32 = 20;
const NEWTON_STEPS: u32 = 12;

/// The solution for one point.
#[derive(Clone, Copy, Debug)]
pub struct Solution {
    /// x.
    pub source: DVec3,
    /// |F(x) - y|, in the unit of the points.
    pub residual: f64,
    /// det dF/dx at x.
    pub determinant: f64,
    /// Whether the residual is within the tolerance and the map is not folded there.
    pub found: bool,
}

/// dF/dx by central differences over `h`.
fn jacobian(forward: &impl Fn(DVec3) -> DVec3, x: DVec3, h: f64) -> DMat3 {
    let column = |e: DVec3| (forward(x + e * h) - forward(x - e * h)) / (2.0 * h);
    DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z))
}

/// Solves F(x) = y from a first guess; `h` is the step of differences, `tolerance` the residual to
/// reach.
pub fn point(forward: &impl Fn(DVec3) -> DVec3, y: DVec3, guess: DVec3, h: f64, tolerance: f64) -> Solution {
    let mut x = guess;
    let mut error = forward(x) - y;
    let mut residual = error.length();
    let mut damping = 1.0;
    for _ in 0..FIXED_POINT_STEPS {
        if residual <= tolerance {
            break;
        }
        let next = x - error * damping;
        let next_error = forward(next) - y;
        let next_residual = next_error.length();
        if next_residual < residual {
            // Slow progress is left to Newton's method.
            let slow = next_residual > 0.7 * residual;
            (x, error, residual) = (next, next_error, next_residual);
            if slow {
                break;
            }
        } else {
            damping *= 0.5;
            if damping < 0.2 {
                break;
            }
        }
    }
    for _ in 0..NEWTON_STEPS {
        if residual <= tolerance {
            break;
        }
        let j = jacobian(forward, x, h);
        if j.determinant().abs() < 1e-9 {
            break;
        }
        let step = j.inverse() * error;
        let mut share = 1.0;
        let mut better = false;
        for _ in 0..6 {
            let next = x - step * share;
            let next_error = forward(next) - y;
            let next_residual = next_error.length();
            if next_residual < residual {
                (x, error, residual) = (next, next_error, next_residual);
                better = true;
                break;
            }
            share *= 0.5;
        }
        if !better {
            break;
        }
    }
    let determinant = jacobian(forward, x, h).determinant();
    Solution {
        source: x,
        residual,
        determinant,
        found: residual <= tolerance && determinant > 0.0,
    }
}

/// The accuracy of an inverse.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct InversionReport {
    /// Points of the grid.
    pub points: usize,
    /// Points without a source: in folds, or outside the field.
    pub not_found: usize,
    /// Mean residual of the points found, mm.
    pub mean_mm: f64,
    /// 95th percentile, mm.
    pub p95_mm: f64,
    /// 99th percentile, mm.
    pub p99_mm: f64,
    /// Largest, mm.
    pub max_mm: f64,
}

/// An inverse on a grid.
pub struct Inverse {
    /// Source minus deformed point.
    pub field: VectorField,
    /// Whether the point has a source.
    pub found: Vec<bool>,
    /// Its accuracy.
    pub report: InversionReport,
}

impl InversionReport {
    /// The statistics of the residuals, without those of points not found.
    fn of(residuals: &[f32], found: &[bool]) -> Self {
        let mut found_residuals: Vec<f32> = residuals
            .iter()
            .zip(found)
            .filter(|(_, f)| **f)
            .map(|(r, _)| *r)
            .collect();
        let mut report = Self {
            points: residuals.len(),
            not_found: residuals.len() - found_residuals.len(),
            ..Self::default()
        };
        if found_residuals.is_empty() {
            return report;
        }
        report.mean_mm =
            found_residuals.iter().map(|r| f64::from(*r)).sum::<f64>() / found_residuals.len() as f64;
        let rank = |share: f64| ((found_residuals.len() - 1) as f64 * share).round() as usize;
        let [p95, p99] = [rank(0.95), rank(0.99)];
        // Percentiles without a full sort: each is searched for among the values above the previous
        // one.
        let (_, at_p95, above) = found_residuals.select_nth_unstable_by(p95, f32::total_cmp);
        report.p95_mm = f64::from(*at_p95);
        report.p99_mm = match p99 - p95 {
            0 => report.p95_mm,
            n => f64::from(*above.select_nth_unstable_by(n - 1, f32::total_cmp).1),
        };
        report.max_mm = above
            .iter()
            .fold(report.p95_mm, |most, r| most.max(f64::from(*r)));
        report
    }
}

impl Inverse {
    /// The inverse as a map in the world; points without a source are cut away.
    ///
    /// # Errors
    /// A placement that is not invertible.
    pub fn placed(&self, storage: Storage, strength: f32) -> Result<PlacedMap> {
        let placement = placement_of(&self.field.grid)?;
        let mut placed = sampled_grid(&self.field, Some(&self.found), &placement, storage, strength);
        // As in the field that was inverted: up to the faces of its outermost voxels.
        placed.reach = Vec3::from(
            self.field
                .grid
                .size
                .map(|n| if n > 1 { 0.5 / (n - 1) as f32 } else { 0.0 }),
        );
        Ok(placed)
    }
}

/// Inverts a forward function on a grid.
pub fn function(forward: &(impl Fn(DVec3) -> DVec3 + Sync), grid: &GridGeometry) -> Inverse {
    by_rows(grid, |row, to| InversionRow::new(forward, grid, row).fill(to))
}

/// Inverts a field on its own grid. Outside its grid the field is extended by its values on the
/// faces, so that the faces have an inverse.
pub fn field(field: &VectorField) -> Inverse {
    let forward = |x: DVec3| x + field.at_voxel(field.voxel_from_world(x)).as_dvec3();
    by_rows(&field.grid, |row, mut to| {
        if field.grid.size.iter().all(|&n| n >= 2) {
            with_simd(Newton {
                field,
                row,
                to: to.reborrow(),
            });
        }
        InversionRow::new(&forward, &field.grid, row).fill(to);
    })
}

/// Output of a row of points.
struct InverseRow<'a> {
    /// Source minus deformed point, mm.
    displacements: &'a mut [Vec3],
    /// |F(x) - y|, mm.
    residuals: &'a mut [f32],
    found: &'a mut [bool],
}

impl InverseRow<'_> {
    fn reborrow(&mut self) -> InverseRow<'_> {
        InverseRow {
            displacements: self.displacements,
            residuals: self.residuals,
            found: self.found,
        }
    }

    fn set(&mut self, n: usize, displacement: Vec3, residual: f32, found: bool) {
        (self.displacements[n], self.residuals[n], self.found[n]) = (displacement, residual, found);
    }
}

/// Calls `row` with the index of each row of a grid and its output; no point is found at first.
fn by_rows(grid: &GridGeometry, row: impl Fn(usize, InverseRow) + Sync) -> Inverse {
    let points = grid.size.iter().product();
    let mut displacements = bytemuck::zeroed_vec(points);
    let (mut residuals, mut found) = (vec![0.0; points], vec![false; points]);
    let nx = grid.size[0].max(1);
    displacements
        .par_chunks_mut(nx)
        .zip(residuals.par_chunks_mut(nx))
        .zip(found.par_chunks_mut(nx))
        .enumerate()
        .for_each(|(n, ((displacements, residuals), found))| {
            row(
                n,
                InverseRow {
                    displacements,
                    residuals,
                    found,
                },
            )
        });
    let report = InversionReport::of(&residuals, &found);
    Inverse {
        field: VectorField::new(*grid, displacements),
        found,
        report,
    }
}

/// The shortest distance between neighbouring voxels, mm.
fn voxel_mm(grid: &GridGeometry) -> f64 {
    let m = grid.world_from_voxel.matrix3;
    m.x_axis.length().min(m.y_axis.length()).min(m.z_axis.length())
}

/// The points of a grid along a row, each solved from its neighbour's solution.
struct InversionRow<'a, F> {
    forward: &'a F,
    grid: &'a GridGeometry,
    row: usize,
    /// That of the neighbour.
    displacement: DVec3,
    voxel_mm: f64,
}

impl<'a, F: Fn(DVec3) -> DVec3> InversionRow<'a, F> {
    fn new(forward: &'a F, grid: &'a GridGeometry, row: usize) -> Self {
        Self {
            forward,
            grid,
            row,
            displacement: DVec3::ZERO,
            voxel_mm: voxel_mm(grid),
        }
    }

    /// Solves the points that are not found yet.
    fn fill(mut self, mut to: InverseRow) {
        for n in 0..to.found.len() {
            if to.found[n] {
                self.displacement = to.displacements[n].as_dvec3();
            } else {
                let s = self.solve(n);
                // Where no source is found, the neighbour's displacement keeps D continuous.
                to.set(n, self.displacement.as_vec3(), s.residual as f32, s.found);
            }
        }
    }

    fn solve(&mut self, n: usize) -> Solution {
        let ny = self.grid.size[1];
        let y = self.grid.world_from_voxel.transform_point3(DVec3::new(
            n as f64,
            (self.row % ny) as f64,
            (self.row / ny) as f64,
        ));
        let (h, tolerance) = (0.25 * self.voxel_mm, TOLERANCE_VOXELS * self.voxel_mm);
        let mut s = point(self.forward, y, y + self.displacement, h, tolerance);
        if !s.found {
            // The neighbour may lie on the other side of a fold.
            let again = point(self.forward, y, y, h, tolerance);
            if again.found || again.residual < s.residual {
                s = again;
            }
        }
        if s.found {
            self.displacement = s.source - y;
        }
        s
    }
}

/// Newton's method in single precision for a row of a field's grid, eight points at once, with the
/// field's own derivatives. Points that do not converge, lie outside the grid or come near a fold
/// are left to [`point`].
struct Newton<'a> {
    field: &'a VectorField,
    row: usize,
    to: InverseRow<'a>,
}

/// Steps of [`Newton`]: it converges quadratically within a cell.
const LANE_STEPS: usize = 8;
/// Compression of a neighbourhood's volume below which a point counts as near a fold.
const NEAR_FOLD: f32 = 0.05;

impl SimdKernel for Newton<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        let [nx, ny, nz] = self.field.grid.size;
        let world_from_voxel = self.field.grid.world_from_voxel.matrix3.as_mat3();
        let [mx, my, mz] = world_from_voxel.to_cols_array_2d().map(Vec3::from);
        let (mx, my, mz) = (
            Vec3x8::splat(simd, mx),
            Vec3x8::splat(simd, my),
            Vec3x8::splat(simd, mz),
        );
        let least = NEAR_FOLD * world_from_voxel.determinant().abs();
        let sense = world_from_voxel.determinant().signum();
        let tolerance = (TOLERANCE_VOXELS * voxel_mm(&self.field.grid)) as f32;
        let (y, z) = (
            f32x8::splat(simd, (self.row % ny) as f32),
            f32x8::splat(simd, (self.row / ny) as f32),
        );
        // Offset from the point to its source, voxels.
        let mut way = Vec3x8::splat(simd, Vec3::ZERO);
        for first in (0..nx).step_by(LANES) {
            let mut x = [0.0; LANES];
            for (n, x) in x.iter_mut().enumerate() {
                *x = (first + n) as f32;
            }
            let here = Vec3x8 {
                x: f32x8::load_array(simd, x),
                y,
                z,
            };
            let mut settled = here.x.simd_lt(-1.0);
            let mut residual = here.x;
            for _ in 0..LANE_STEPS {
                let p = here + way;
                let cells = Cells::of(p, self.field.grid.size, 0);
                let (u, [ux, uy, uz]) =
                    mix_with_slopes(simd, flat(&self.field.vectors), self.field.grid.size, &cells);
                let error = way.mapped(&world_from_voxel) + u;
                residual = error.length();
                let (a, b, c) = (mx + ux, my + uy, mz + uz);
                let bc = b.cross(c);
                let determinant = a.dot(bc);
                let whole = (determinant * sense).simd_gt(least)
                    & within(p.x, 0.0, (nx - 1) as f32)
                    & within(p.y, 0.0, (ny - 1) as f32)
                    & within(p.z, 0.0, (nz - 1) as f32);
                settled = whole & residual.simd_le(tolerance);
                let going = whole & !settled;
                if going.all_false() {
                    break;
                }
                let step = Vec3x8 {
                    x: error.dot(bc),
                    y: a.dot(error.cross(c)),
                    z: a.dot(b.cross(error)),
                };
                let step = step * (f32x8::splat(simd, 1.0) / determinant);
                way = Vec3x8::select(going, way - step, way);
            }
            let displacement = way.mapped(&world_from_voxel);
            for n in lanes_of(settled.to_bitmask()).filter(|n| first + n < nx) {
                self.to.set(first + n, displacement.lane(n), residual[n], true);
            }
            // A good guess for the next eight; zero where no source was found.
            way = Vec3x8::select(settled, way, Vec3x8::splat(simd, Vec3::ZERO));
        }
    }
}

/// Inverts a transform: on its own grid if it is a single field, else over the box that the scene
/// is carried to, with `resolution` points along the longest axis (by default at the spacing of its
/// finest grid).
///
/// # Errors
/// A box that is not invertible as a placement.
pub fn transform(transform: &Transform, scene_box: &Bounds, resolution: Option<usize>) -> Result<Inverse> {
    if let ([TransformStep::Field(f)], None) = (&transform.steps[..], resolution) {
        return Ok(field(f));
    }
    let mut bounds = *scene_box;
    for step in &transform.steps {
        bounds = match step {
            TransformStep::Affine(m) => bounds.transformed(&crate::math::to_f32(m)),
            TransformStep::Field(v) => {
                bounds.grown(v.vectors.par_iter().map(|d| d.length()).reduce(|| 0.0, f32::max))
            }
            TransformStep::BSpline(b) => {
                bounds.grown(b.coefficients.iter().map(|d| d.length()).fold(0.0, f32::max))
            }
        };
    }
    let bounds = bounds.union(scene_box);
    let bounds = bounds.grown(0.02 * bounds.size().max_element());
    let longest = f64::from(bounds.size().max_element());
    let spacing = transform.grid().map_or(longest / 64.0, |g| {
        let m = g.world_from_voxel.matrix3;
        m.x_axis.length().min(m.y_axis.length()).min(m.z_axis.length())
    });
    let points = resolution
        .unwrap_or((longest / spacing) as usize + 1)
        .clamp(8, 256);
    let step = longest / (points - 1) as f64;
    let grid = GridGeometry {
        size: bounds
            .size()
            .to_array()
            .map(|s| (f64::from(s) / step).ceil() as usize + 1),
        world_from_voxel: DAffine3 {
            matrix3: DMat3::from_diagonal(DVec3::splat(step)),
            translation: bounds.min.as_dvec3(),
        },
    };
    Ok(function(&|x| transform.source_from_deformed(x), &grid))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(n: usize) -> GridGeometry {
        GridGeometry {
            size: [n; 3],
            world_from_voxel: DAffine3 {
                matrix3: DMat3::from_diagonal(DVec3::splat(80.0 / (n - 1) as f64)),
                translation: DVec3::splat(-40.0),
            },
        }
    }

    /// A twist of up to 90 degrees, whose inverse is the opposite twist.
    fn twist(p: DVec3, sense: f64) -> DVec3 {
        let r = p.x.hypot(p.y);
        let turn = sense * 1.5 * (1.0 - (r / 40.0).min(1.0)).powi(2) * (p.z / 80.0 + 0.5).clamp(0.0, 1.0);
        let (s, c) = turn.sin_cos();
        DVec3::new(c * p.x - s * p.y, s * p.x + c * p.y, p.z)
    }

    #[test]
    fn a_twist_is_undone() {
        let inverse = function(&|p| twist(p, 1.0), &grid(33));
        assert_eq!(inverse.report.not_found, 0, "{:?}", inverse.report);
        for n in (0..33 * 33 * 33).step_by(97) {
            let y = inverse.field.grid.world_from_voxel.transform_point3(DVec3::new(
                (n % 33) as f64,
                (n / 33 % 33) as f64,
                (n / 1089) as f64,
            ));
            let x = y + flat(&inverse.field.vectors)[n].as_dvec3();
            assert!(x.distance(twist(y, -1.0)) < 0.01, "{y}");
        }
    }

    /// Eight points at once and one by one, on a grid that is neither cubic nor axis-aligned: the
    /// same inverse, and few points left to the slow path.
    #[test]
    fn lanes_invert_alike() {
        let axes = DMat3::from_cols(
            DVec3::new(1.3, 0.2, 0.0),
            DVec3::new(-0.3, 1.1, 0.1),
            DVec3::new(0.1, 0.0, 2.0),
        );
        let size = [29, 23, 19];
        let grid = GridGeometry {
            size,
            world_from_voxel: DAffine3 {
                matrix3: axes,
                translation: DVec3::new(-20.0, 5.0, 7.0),
            },
        };
        let wave = |n: usize| {
            let [x, y, z] = [n % 29, n / 29 % 23, n / 667].map(|i| i as f32);
            let window = (x / 28.0 * std::f32::consts::PI).sin()
                * (y / 22.0 * std::f32::consts::PI).sin()
                * (z / 18.0 * std::f32::consts::PI).sin();
            Vec3::new((0.3 * y).sin(), (0.2 * z).cos(), (0.25 * x).sin()) * (2.5 * window)
        };
        let field = VectorField::new(grid, (0..29 * 23 * 19).map(wave).collect());
        let forward = |x: DVec3| x + field.at_voxel(field.voxel_from_world(x)).as_dvec3();
        let (fast, slow) = (super::field(&field), function(&forward, &grid));
        assert_eq!(fast.found, slow.found);
        assert!(
            fast.report.not_found == 0 && fast.report.max_mm <= TOLERANCE_VOXELS * voxel_mm(&grid),
            "{:?}",
            fast.report
        );
        for (n, (a, b)) in fast.field.vectors.iter().zip(&slow.field.vectors).enumerate() {
            assert!(a.distance(*b) < 5e-4, "{n}: {a} for {b}");
            let y = grid.world_from_voxel.transform_point3(DVec3::new(
                (n % 29) as f64,
                (n / 29 % 23) as f64,
                (n / 667) as f64,
            ));
            assert!(
                forward(y + a.as_dvec3()).distance(y) < 1.5 * TOLERANCE_VOXELS * voxel_mm(&grid),
                "{n}"
            );
        }
        let by_lanes = by_rows(&grid, |row, to| {
            with_simd(Newton {
                field: &field,
                row,
                to,
            })
        });
        assert!(
            10 * by_lanes.report.not_found < field.vectors.len(),
            "{:?}",
            by_lanes.report
        );
    }

    /// Percentiles equal those of the sorted residuals, of few points and of many; points not found
    /// are only counted.
    #[test]
    fn ranks_are_those_of_the_sorted() {
        for points in [1, 2, 20, 101, 5003] {
            let residuals: Vec<f32> = (0..points).map(|n| (n * 7919 % 5003) as f32).collect();
            let found: Vec<bool> = (0..points).map(|n| n % 7 != 3).collect();
            let mut found_residuals: Vec<f32> = residuals
                .iter()
                .zip(&found)
                .filter(|(_, f)| **f)
                .map(|(r, _)| *r)
                .collect();
            found_residuals.sort_unstable_by(f32::total_cmp);
            let at = |share: f64| {
                f64::from(found_residuals[((found_residuals.len() - 1) as f64 * share).round() as usize])
            };
            let report = InversionReport::of(&residuals, &found);
            assert_eq!(
                [report.p95_mm, report.p99_mm, report.max_mm],
                [at(0.95), at(0.99), at(1.0)],
                "{points}"
            );
            assert_eq!(
                (report.points, report.not_found),
                (points, points - found_residuals.len())
            );
        }
        assert_eq!(
            InversionReport::of(&[1.0], &[false]),
            InversionReport {
                points: 1,
                not_found: 1,
                ..InversionReport::default()
            }
        );
    }

    #[test]
    fn folds_are_not_found() {
        // Turned inside out along x: every point is folded.
        let inverse = function(&|p: DVec3| DVec3::new(-p.x, p.y, p.z), &grid(9));
        assert_eq!(inverse.report.not_found, inverse.report.points);
        let placed = inverse
            .placed(Storage::F16, 1.0)
            .unwrap_or_else(|e| panic!("{e}"));
        assert!(placed.backward(Vec3::new(3.0, 2.0, 1.0)).1 < 0.5);
    }
}
