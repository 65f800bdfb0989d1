//! Numeric inversion of forward deformations: for every point y, the x with F(x) = y.
//!
//! *Method*: fixed point x <- x - λ (F(x) - y), which needs no derivative and converges where the displacement's Lipschitz constant is below 1
//! (Chen et al. 2008, "A simple fixed-point approach to invert a deformation field"); λ is halved whenever the residual grows. Where
//! it stalls, Newton's method with a Jacobian from differences and a halving line search finishes. Each point starts from its
//! neighbour's solution. Points of a row depend on each other, rows do not: the number of threads changes nothing.
//!
//! What does not converge, or converges where det J <= 0, lies in a fold: no single source exists there. Its mask is 0.

use super::compose::{placement_of, sampled_grid};
use super::transform::{Step, Transform, VectorField};
use super::{PlacedMap, Storage};
use crate::Result;
use crate::math::Bounds;
use crate::volume::GridGeometry;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;

/// A point counts as found when the residual is below this share of a voxel.
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

/// Solves F(x) = y from a first guess; `h` is the step of differences, `tolerance` the residual that suffices.
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
            // Slow progress is Newton's to finish.
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
    Solution { source: x, residual, determinant, found: residual <= tolerance && determinant > 0.0 }
}

/// How well an inverse fits.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Report {
    /// Points of the grid.
    pub points: usize,
    /// Points without a source: folds, and what lies beyond the field.
    pub not_found: usize,
    /// Residual of the points that were found: mean, mm.
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
    /// How well it fits.
    pub report: Report,
}

impl Report {
    /// The statistics of residuals, of which those not found are left out.
    fn of(residuals: &[f64], found: &[bool]) -> Self {
        let mut kept: Vec<f64> = residuals.iter().zip(found).filter(|(_, f)| **f).map(|(r, _)| *r).collect();
        let not_found = residuals.len() - kept.len();
        if kept.is_empty() {
            return Self { points: residuals.len(), not_found, ..Self::default() };
        }
        kept.par_sort_unstable_by(f64::total_cmp);
        let at = |share: f64| kept[((kept.len() - 1) as f64 * share).round() as usize];
        let mean_mm = kept.iter().sum::<f64>() / kept.len() as f64;
        Self { points: residuals.len(), not_found, mean_mm, p95_mm: at(0.95), p99_mm: at(0.99), max_mm: at(1.0) }
    }
}

impl Inverse {
    /// The inverse as a map in the world; what has no source is cut away.
    ///
    /// # Errors
    /// A placement that cannot be used.
    pub fn placed(&self, storage: Storage, strength: f32) -> Result<PlacedMap> {
        let placement = placement_of(&self.field.grid)?;
        let mut placed = sampled_grid(&self.field, Some(&self.found), &placement, storage, strength);
        // As the field that was inverted, to the faces of its outermost voxels.
        placed.reach = Vec3::from(self.field.grid.size.map(|n| if n > 1 { 0.5 / (n - 1) as f32 } else { 0.0 }));
        Ok(placed)
    }
}

/// Inverts a forward function on a grid.
pub fn function(forward: &(impl Fn(DVec3) -> DVec3 + Sync), grid: &GridGeometry) -> Inverse {
    let [nx, ny, nz] = grid.size;
    let m = grid.world_from_voxel.matrix3;
    let voxel_mm = m.x_axis.length().min(m.y_axis.length()).min(m.z_axis.length());
    let tolerance = TOLERANCE_VOXELS * voxel_mm;
    let solutions: Vec<(Vec3, f64, bool)> = (0..ny * nz)
        .into_par_iter()
        .flat_map_iter(|row| {
            let mut displacement = DVec3::ZERO;
            (0..nx).map(move |i| {
                let y = grid.world_from_voxel.transform_point3(DVec3::new(i as f64, (row % ny) as f64, (row / ny) as f64));
                let mut s = point(forward, y, y + displacement, 0.25 * voxel_mm, tolerance);
                if !s.found {
                    // The neighbour may lie on the other side of a fold.
                    let again = point(forward, y, y, 0.25 * voxel_mm, tolerance);
                    if again.found || again.residual < s.residual {
                        s = again;
                    }
                }
                if s.found {
                    displacement = s.source - y;
                }
                // Where nothing was found, the neighbour's displacement keeps D continuous.
                let d = if s.found { s.source - y } else { displacement };
                (d.as_vec3(), s.residual, s.found)
            })
        })
        .collect();
    let found: Vec<bool> = solutions.iter().map(|s| s.2).collect();
    let residuals: Vec<f64> = solutions.iter().map(|s| s.1).collect();
    let report = Report::of(&residuals, &found);
    Inverse { field: VectorField::new(*grid, solutions.into_iter().map(|s| s.0).collect()), found, report }
}

/// Inverts a field on its own grid. Beyond its grid the field goes on as at its faces, so that the faces have an inverse.
pub fn field(field: &VectorField) -> Inverse {
    function(&|x: DVec3| x + field.at_voxel(field.voxel_from_world(x)).as_dvec3(), &field.grid)
}

/// Inverts a transform: on its own grid if it is a single field, else over the box that it carries the scene to, at `resolution` points along the
/// longest axis (as fine as its finest grid by default).
///
/// # Errors
/// A box that cannot be placed.
pub fn transform(transform: &Transform, scene_box: &Bounds, resolution: Option<usize>) -> Result<Inverse> {
    if let ([Step::Field(f)], None) = (&transform.steps[..], resolution) {
        return Ok(field(f));
    }
    let mut bounds = *scene_box;
    for step in &transform.steps {
        bounds = match step {
            Step::Affine(m) => bounds.transformed(&crate::math::to_f32(m)),
            Step::Field(v) => bounds.grown(v.vectors.par_iter().map(|d| d.length()).reduce(|| 0.0, f32::max)),
            Step::BSpline(b) => bounds.grown(b.coefficients.iter().map(|d| d.length()).fold(0.0, f32::max)),
        };
    }
    let bounds = bounds.union(scene_box);
    let bounds = bounds.grown(0.02 * bounds.size().max_element());
    let longest = f64::from(bounds.size().max_element());
    let spacing = transform.grid().map_or(longest / 64.0, |g| {
        let m = g.world_from_voxel.matrix3;
        m.x_axis.length().min(m.y_axis.length()).min(m.z_axis.length())
    });
    let points = resolution.unwrap_or((longest / spacing) as usize + 1).clamp(8, 256);
    let step = longest / (points - 1) as f64;
    let grid = GridGeometry {
        size: bounds.size().to_array().map(|s| (f64::from(s) / step).ceil() as usize + 1),
        world_from_voxel: DAffine3 { matrix3: DMat3::from_diagonal(DVec3::splat(step)), translation: bounds.min.as_dvec3() },
    };
    Ok(function(&|x| transform.source_from_deformed(x), &grid))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(n: usize) -> GridGeometry {
        GridGeometry {
            size: [n; 3],
            world_from_voxel: DAffine3 { matrix3: DMat3::from_diagonal(DVec3::splat(80.0 / (n - 1) as f64)), translation: DVec3::splat(-40.0) },
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
            let y = inverse.field.grid.world_from_voxel.transform_point3(DVec3::new((n % 33) as f64, (n / 33 % 33) as f64, (n / 1089) as f64));
            let x = y + inverse.field.vectors[n].as_dvec3();
            assert!(x.distance(twist(y, -1.0)) < 0.01, "{y}");
        }
    }

    #[test]
    fn folds_are_not_found() {
        // Turned inside out along x: every point is folded.
        let inverse = function(&|p: DVec3| DVec3::new(-p.x, p.y, p.z), &grid(9));
        assert_eq!(inverse.report.not_found, inverse.report.points);
        let placed = inverse.placed(Storage::F16, 1.0).unwrap_or_else(|e| panic!("{e}"));
        assert!(placed.backward(Vec3::new(3.0, 2.0, 1.0)).1 < 0.5);
    }
}
