//! Quality of a deformation: folds, magnitude, behaviour at its border. Computed on the grid on
//! which it is stored.

use super::PlacedMap;
use super::compose::grid_of;
use super::invert::{self, InversionReport};
use super::transform::VectorField;
use crate::math::flat;
use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;
use serde::Serialize;

/// The statistics of a field.
#[derive(Clone, Debug, Serialize)]
pub struct FieldQuality {
    /// Points of the grid.
    pub points: usize,
    /// Points that are cut away, percent; the figures below leave them out.
    pub cut_percent: f64,
    /// Smallest det J of d source / d deformed: below 1 the volume expands.
    pub det_min: f64,
    /// Mean det J.
    pub det_mean: f64,
    /// Largest det J.
    pub det_max: f64,
    /// Points with det J <= 0, percent: there the field folds.
    pub folds_percent: f64,
    /// Largest displacement, mm.
    pub largest_mm: f64,
    /// Mean displacement, mm.
    pub mean_mm: f64,
    /// Largest displacement on the grid's faces, mm: nothing moves outside them, hence a large
    /// value means a tear there.
    pub border_mm: f64,
    /// Accuracy of the field's inverse, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inverse: Option<InversionReport>,
}

/// A field with its mask, as input of the statistics.
pub struct CheckedField {
    /// The displacement.
    pub field: VectorField,
    /// Whether the point is retained by the mask.
    pub is_valid: Vec<bool>,
    /// det J per point.
    pub determinants: Vec<f32>,
}

impl CheckedField {
    /// The field of a map.
    pub fn of_map(placed: &PlacedMap) -> Self {
        let placed = &placed.on_regular_grid();
        let size = placed.map.size;
        let linear = Mat3::from(placed.placement.world_from_map.matrix3);
        let step = Vec3::from(size.map(|n| 1.0 / n.saturating_sub(1).max(1) as f32));
        let texels: Vec<(Vec3, bool)> = (0..size.iter().product::<usize>())
            .into_par_iter()
            .map(|n| {
                let at = Vec3::new(
                    (n % size[0]) as f32,
                    (n / size[0] % size[1]) as f32,
                    (n / (size[0] * size[1])) as f32,
                );
                let t = placed.map.sample(at * step);
                (linear * t.displacement, t.alpha >= 0.5)
            })
            .collect();
        let (vectors, is_valid): (Vec<Vec3>, Vec<bool>) = texels.into_iter().unzip();
        Self::new(
            VectorField::new(grid_of(&placed.placement, size), vectors),
            is_valid,
        )
    }

    /// A field and its mask.
    pub fn new(field: VectorField, is_valid: Vec<bool>) -> Self {
        let [nx, ny, _] = field.grid.size;
        let determinants = (0..is_valid.len())
            .into_par_iter()
            .map(|n| field.jacobian(n % nx, n / nx % ny, n / (nx * ny)).determinant() as f32)
            .collect();
        Self {
            field,
            is_valid,
            determinants,
        }
    }

    /// The statistics.
    pub fn health(&self, with_inverse: bool) -> FieldQuality {
        let size = self.field.grid.size;
        let points = self.is_valid.len();
        let valid = (0..points).filter(|&n| self.is_valid[n]);
        let (mut count, mut folds) = (0usize, 0usize);
        let (mut low, mut high, mut sum) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
        let (mut largest, mut mean, mut border) = (0.0f64, 0.0, 0.0f64);
        for n in valid {
            let det = f64::from(self.determinants[n]);
            let length = f64::from(flat(&self.field.vectors)[n].length());
            let at = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
            count += 1;
            folds += usize::from(det <= 0.0);
            (low, high, sum) = (low.min(det), high.max(det), sum + det);
            (largest, mean) = (largest.max(length), mean + length);
            if (0..3).any(|a| size[a] > 1 && (at[a] == 0 || at[a] + 1 == size[a])) {
                border = border.max(length);
            }
        }
        let of = |v: f64| if count > 0 { v / count as f64 } else { 0.0 };
        FieldQuality {
            points,
            cut_percent: 100.0 * (points - count) as f64 / points.max(1) as f64,
            det_min: if count > 0 { low } else { 1.0 },
            det_mean: if count > 0 { of(sum) } else { 1.0 },
            det_max: if count > 0 { high } else { 1.0 },
            folds_percent: 100.0 * of(folds as f64),
            largest_mm: largest,
            mean_mm: of(mean),
            border_mm: border,
            inverse: with_inverse.then(|| invert::field(&self.field).report),
        }
    }

    /// An image of det J through the worst point: one slice across each axis, side by side, RGB.
    /// Blue: below 1 (expanded), white: 1, green: above 1 (compressed), red: folded, black: cut
    /// away.
    pub fn picture(&self) -> (usize, usize, Vec<u8>) {
        let size = self.field.grid.size;
        let worst = (0..self.is_valid.len())
            .filter(|&n| self.is_valid[n])
            .min_by(|&a, &b| self.determinants[a].total_cmp(&self.determinants[b]))
            .unwrap_or(self.is_valid.len() / 2);
        let at = [
            worst % size[0],
            worst / size[0] % size[1],
            worst / (size[0] * size[1]),
        ];
        let panels = [(0, 1, 2), (0, 2, 1), (1, 2, 0)];
        let scale = (256 / size.iter().max().copied().unwrap_or(1)).max(1);
        let (width, height) = (
            panels.iter().map(|p| size[p.0] * scale).sum::<usize>() + 8,
            panels.iter().map(|p| size[p.1] * scale).max().unwrap_or(1),
        );
        let mut rgb = vec![255u8; width * height * 3];
        let mut left = 0;
        for (across, up, fixed) in panels {
            for y in 0..size[up] * scale {
                for x in 0..size[across] * scale {
                    let mut c = [0; 3];
                    (c[across], c[up], c[fixed]) = (x / scale, y / scale, at[fixed]);
                    let n = (c[2] * size[1] + c[1]) * size[0] + c[0];
                    let color = color(self.determinants[n], self.is_valid[n]);
                    let row = size[up] * scale - 1 - y;
                    let to = (row * width + left + x) * 3;
                    rgb[to..to + 3].copy_from_slice(&color);
                }
            }
            left += size[across] * scale + 4;
        }
        (width, height, rgb)
    }

    /// One line per point: i, j, k, position and displacement in mm, det J, validity.
    pub fn csv(&self) -> String {
        use std::fmt::Write as _;
        let size = self.field.grid.size;
        let mut out = String::from("i,j,k,x_mm,y_mm,z_mm,dx_mm,dy_mm,dz_mm,det_j,seen\n");
        for n in 0..self.is_valid.len() {
            let [i, j, k] = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
            let p = self
                .field
                .grid
                .world_from_voxel
                .transform_point3(DVec3::new(i as f64, j as f64, k as f64));
            let d = flat(&self.field.vectors)[n];
            let _infallible = writeln!(
                out,
                "{i},{j},{k},{:.4},{:.4},{:.4},{:.5},{:.5},{:.5},{:.5},{}",
                p.x,
                p.y,
                p.z,
                d.x,
                d.y,
                d.z,
                self.determinants[n],
                u8::from(self.is_valid[n])
            );
        }
        out
    }
}

fn color(det: f32, is_valid: bool) -> [u8; 3] {
    if !is_valid {
        return [0; 3];
    }
    if det <= 0.0 {
        return [214, 40, 40];
    }
    // Linear in the logarithm; full colour at a factor of four.
    let t = (det.log2() / 2.0).clamp(-1.0, 1.0);
    let fade = |c: [f32; 3]| c.map(|c| (255.0 + (c - 255.0) * t.abs()) as u8);
    if t < 0.0 {
        fade([40.0, 90.0, 200.0])
    } else {
        fade([30.0, 140.0, 70.0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::GridGeometry;
    use glam::{DAffine3, DMat3};

    fn field(f: impl Fn(DVec3) -> DVec3 + Sync) -> CheckedField {
        let grid = GridGeometry {
            size: [17; 3],
            world_from_voxel: DAffine3 {
                matrix3: DMat3::from_diagonal(DVec3::splat(2.0)),
                translation: DVec3::splat(-16.0),
            },
        };
        CheckedField::new(VectorField::sampled(grid, f), vec![true; 17 * 17 * 17])
    }

    #[test]
    fn linear_fields_have_their_determinant() {
        let h = field(|p| p * DVec3::new(2.0, 0.5, 1.5)).health(false);
        assert!((h.det_min - 1.5).abs() < 1e-3 && (h.det_max - 1.5).abs() < 1e-3 && h.folds_percent == 0.0);
        assert!(
            (h.largest_mm - (16.0f64.powi(2) + 8.0f64.powi(2) * 2.0).sqrt()).abs() < 1e-3
                && h.border_mm == h.largest_mm
        );
    }

    #[test]
    fn a_mirrored_half_is_a_fold() {
        // |x| + x keeps one half and turns nothing over; -|x| folds the upper half back.
        let h = field(|p| DVec3::new(-p.x.abs(), p.y, p.z)).health(true);
        assert!((40.0..60.0).contains(&h.folds_percent), "{h:?}");
        assert!(h.inverse.is_some_and(|i| i.points == 17 * 17 * 17));
        let (w, height, rgb) = field(|p| p).picture();
        assert_eq!(rgb.len(), w * height * 3);
    }
}
