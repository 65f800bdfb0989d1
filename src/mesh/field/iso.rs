//! The distance to the surface where a scan has a given value.

use super::lattice::{BAND, MAX_POINTS};
use super::sweep::sweep;
use crate::math::arrays::shaped;
use crate::math::{DistanceGrid, normalize_or, to_f32, trilinear};
use crate::volume::Volume;
use glam::{Affine3A, Mat3, Vec3};
use rayon::prelude::*;

/// Number of times that the foot of a point slides along an interpolated surface.
const SLIDES: usize = 3;

/// Values minus the iso-value on a grid of voxels.
struct IsoValues {
    values: Vec<f32>,
    size: [usize; 3],
    /// Steps of the index along the axes.
    strides: [usize; 3],
    world_from_grid: Affine3A,
    /// `world_from_grid` without its translation.
    linear: Mat3,
    /// The inverse of `linear`.
    grid_from_linear: Mat3,
    /// From a gradient per voxel to one per mm, along the world axes.
    per_mm: Mat3,
}

impl IsoValues {
    /// The values of every voxel, or of every second or fourth of a very large volume. Values that
    /// are not finite count as below the iso-value.
    fn of(volume: &Volume, iso: f64) -> Self {
        let mut stride = 1;
        while volume.size.iter().map(|n| n.div_ceil(stride)).product::<usize>() > MAX_POINTS / 8 {
            stride *= 2;
        }
        let size = volume.size.map(|n| n.div_ceil(stride));
        let [nx, ny, nz] = size;
        let world_from_grid =
            to_f32(&volume.world_from_voxel) * Affine3A::from_scale(Vec3::splat(stride as f32));
        let linear = Mat3::from(world_from_grid.matrix3);
        let grid_from_linear = linear.inverse();
        let above = |i: usize, j: usize, k: usize| {
            let v = (volume.value(i * stride, j * stride, k * stride) - iso) as f32;
            if v.is_finite() { v } else { -1.0 }
        };
        let values: Vec<f32> = (0..nx * ny * nz)
            .into_par_iter()
            .map(|n| above(n % nx, n / nx % ny, n / (nx * ny)))
            .collect();
        Self {
            values,
            size,
            strides: [1, nx, nx * ny],
            world_from_grid,
            linear,
            grid_from_linear,
            per_mm: grid_from_linear.transpose(),
        }
    }

    /// Whether the values lie on both sides of the iso-value.
    fn has_surface(&self) -> bool {
        self.values.iter().any(|v| *v < 0.0) && self.values.iter().any(|v| *v >= 0.0)
    }

    /// The grid coordinates of point `n`.
    fn coordinates(&self, n: usize) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        [n % nx, n / nx % ny, n / (nx * ny)]
    }

    /// The gradient at point `n`, whose grid coordinates are `at`, per mm.
    fn gradient(&self, n: usize, at: [usize; 3]) -> Vec3 {
        let d: [f32; 3] = std::array::from_fn(|a| {
            let before = if at[a] > 0 { n - self.strides[a] } else { n };
            let after = if at[a] + 1 < self.size[a] {
                n + self.strides[a]
            } else {
                n
            };
            (self.values[after] - self.values[before]) / ((after - before) / self.strides[a]).max(1) as f32
        });
        self.per_mm * Vec3::from(d)
    }

    /// Distance from point `n` to the surface, and the foot, by the tangent plane at the nearest
    /// crossing of the surface with the point's grid edges. Infinite if it crosses none of them.
    fn nearest_crossing(&self, n: usize) -> (f32, Vec3) {
        let Self {
            values,
            size,
            strides,
            ..
        } = self;
        let at = self.coordinates(n);
        let here = self.linear * Vec3::from(at.map(|c| c as f32));
        let inside = values[n] >= 0.0;
        let mut best = (f32::INFINITY, Vec3::NAN);
        let mut own = None;
        for a in 0..3 {
            for m in [
                (at[a] > 0).then(|| n - strides[a]),
                (at[a] + 1 < size[a]).then(|| n + strides[a]),
            ]
            .into_iter()
            .flatten()
            {
                if (values[m] >= 0.0) == inside {
                    continue;
                }
                let along = values[n] / (values[n] - values[m]);
                let there = self.coordinates(m);
                let crossing = self.linear
                    * Vec3::from(std::array::from_fn(|c| {
                        at[c] as f32 + (there[c] as f32 - at[c] as f32) * along
                    }));
                let near = *own.get_or_insert_with(|| self.gradient(n, at));
                let normal = normalize_or(near + (self.gradient(m, there) - near) * along, Vec3::ZERO);
                let foot = here + normal * (crossing - here).dot(normal);
                // The plane approximates the surface well within about a cell around the crossing,
                // no farther.
                let reach = (crossing - here).length();
                let foot = if normal == Vec3::ZERO || foot.distance(crossing) > reach {
                    crossing
                } else {
                    foot
                };
                let d = foot.distance(here);
                if d < best.0 {
                    best = (d, foot);
                }
            }
        }
        best
    }

    /// The interpolated value at a position relative to the grid's first point, mm.
    fn value_at(&self, x: Vec3) -> f32 {
        trilinear(&self.values, self.size, self.grid_from_linear * x)
    }

    /// The gradient of the interpolated value there, per mm.
    fn gradient_at(&self, x: Vec3) -> Vec3 {
        let g = self.grid_from_linear * x;
        self.per_mm
            * Vec3::from(Vec3::AXES.map(|e| {
                trilinear(&self.values, self.size, g + e * 0.5)
                    - trilinear(&self.values, self.size, g - e * 0.5)
            }))
    }

    /// The distance of point `n` to the interpolated surface: from `foot`, slides along the surface
    /// to the nearest point. None if the gradient vanishes on the way.
    fn distance_by_sliding(&self, n: usize, foot: Vec3) -> Option<f32> {
        let here = self.linear * Vec3::from(self.coordinates(n).map(|c| c as f32));
        let mut x = foot;
        for _ in 0..SLIDES {
            let g = self.gradient_at(x);
            let steep = g.length_squared();
            if steep < 1e-20 {
                return None;
            }
            let along = here - x;
            x += along - g * (along.dot(g) / steep);
            let g = self.gradient_at(x);
            x -= g * (self.value_at(x) / g.length_squared().max(1e-20));
        }
        Some(x.distance(here))
    }
}

/// The distance to the surface where a volume has a given value, positive where it is higher, on
/// the volume's own grid (on every second or fourth voxel of a very large one). None if there is no
/// such surface.
pub fn of_iso_value(volume: &Volume, iso: f64) -> Option<DistanceGrid> {
    let field = IsoValues::of(volume, iso);
    if !field.has_surface() {
        return None;
    }
    let seeds: Vec<(f32, Vec3)> = (0..field.values.len())
        .into_par_iter()
        .map(|n| field.nearest_crossing(n))
        .collect();
    let (mut distance, mut nearest): (Vec<f32>, Vec<Vec3>) = seeds.into_iter().unzip();
    let linear = field.linear;
    sweep(&mut distance, &mut nearest, field.size, Vec3::ZERO, linear);
    // Feet are a cell apart; near the surface each one slides to the foot of its own point on the
    // interpolated values.
    let reach = BAND
        * linear
            .x_axis
            .length()
            .max(linear.y_axis.length())
            .max(linear.z_axis.length());
    distance
        .par_iter_mut()
        .zip(&nearest)
        .enumerate()
        .filter(|(_, (d, _))| **d < reach)
        .for_each(|(n, (d, foot))| {
            // A slide that diverged is discarded.
            if let Some(found) = field.distance_by_sliding(n, *foot)
                && found.is_finite()
                && found < *d * 1.5 + 1e-3
            {
                *d = found;
            }
        });
    distance.par_iter_mut().zip(&field.values).for_each(|(d, v)| {
        if *v < 0.0 {
            *d = -*d;
        }
    });
    Some(DistanceGrid::new(
        shaped(field.size, distance),
        field.world_from_grid,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{Rescale, Volume};
    use glam::{DAffine3, DVec3};

    #[test]
    fn an_iso_value_of_a_smooth_ball_is_a_sphere() {
        let world_from_voxel =
            DAffine3::from_rotation_y(0.3) * DAffine3::from_scale(DVec3::new(1.0, 1.2, 0.9));
        let size = [50usize, 44, 56];
        let middle = world_from_voxel.transform_point3(DVec3::new(25.0, 22.0, 28.0));
        let voxels: Vec<f32> = (0..size.iter().product::<usize>())
            .map(|n| {
                let v = DVec3::new((n % 50) as f64, (n / 50 % 44) as f64, (n / 2200) as f64);
                (100.0 - world_from_voxel.transform_point3(v).distance(middle)) as f32
            })
            .collect();
        let volume = Volume::new(
            crate::volume::Voxels::new(size, voxels),
            Rescale::NONE,
            world_from_voxel,
        );
        let field = of_iso_value(&volume, 85.0).unwrap_or_else(|| panic!());
        let (mut worst_near, mut worst) = (0.0f32, 0.0f32);
        for (n, d) in field.distance_mm.iter().enumerate() {
            let v = Vec3::new((n % 50) as f32, (n / 50 % 44) as f32, (n / 2200) as f32);
            let want = 15.0
                - field
                    .world_from_grid
                    .transform_point3(v)
                    .distance(middle.as_vec3());
            // The medial point of a ball is in no band.
            worst = worst.max((d - want).abs());
            if want.abs() < 2.0 {
                worst_near = worst_near.max((d - want).abs());
            }
        }
        // Swept distances exceed the true distance by less than half a cell.
        assert!(
            worst_near < 0.05 && worst < 0.45,
            "{worst_near} near the surface, {worst} at worst"
        );
        assert!(of_iso_value(&volume, 1e9).is_none());
    }
}
