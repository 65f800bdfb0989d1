//! Samples of a grid by cubic B-splines: the value and its analytic gradient.
//!
//! *Theory*: the weights of the four voxels along an axis, and their derivatives, are those of the
//! uniform cubic B-spline (Sigg and Hadwiger, "Fast third-order texture filtering", GPU Gems 2,
//! 2005). The spline approximates: it smooths by about a voxel, which reduces the steps of
//! slices and noise, and its gradient is continuous, where that of trilinear interpolation jumps at
//! every voxel. A linear function is reproduced exactly.
//!
//! Voxels without data do not count: the weights of the others are scaled to a sum of 1.
//!
//! `sample_cubic` in `shaders/lib/volume.wgsl` computes the same.

use super::Voxel;
use super::sampler::{VolumeSampler, VoxelSlice, with_voxels};
use glam::{Vec3, Vec4};

/// Weights of the voxels at -1, 0, 1, 2 around a position `f` in 0..1, and their derivatives.
fn weights(f: f32) -> (Vec4, Vec4) {
    let g = 1.0 - f;
    let value = Vec4::new(
        g * g * g,
        4.0 - 3.0 * f * f * (2.0 - f),
        4.0 - 3.0 * g * g * (2.0 - g),
        f * f * f,
    ) / 6.0;
    let slope = Vec4::new(-g * g, f * (3.0 * f - 4.0), g * (4.0 - 3.0 * g), f * f) / 2.0;
    (value, slope)
}

impl VolumeSampler<'_> {
    /// Normalised value at a position in voxels, and its gradient per voxel along i, j, k, by the
    /// 64 voxels around it; outside the grid its outermost voxels repeat.
    pub fn sample_cubic(&self, p: Vec3) -> (f32, Vec3) {
        let base = p.floor();
        let f = p - base;
        let [x, y, z] = f.to_array().map(weights);
        let index = |axis: usize, n: usize| {
            (base[axis] as i64 + n as i64 - 1).clamp(0, self.size[axis] as i64 - 1) as usize
        };
        let [columns, rows, planes] = [0, 1, 2].map(|axis| [0, 1, 2, 3].map(|n| index(axis, n)));
        let mut sum = Vec4::ZERO;
        // The weights of the voxels that have data.
        let mut counted = Vec4::ZERO;
        with_voxels!(self.voxels, v => {
            for (c, &k) in planes.iter().enumerate() {
                for (b, &j) in rows.iter().enumerate() {
                    let row = (k * self.size[1] + j) * self.size[0];
                    let raw = Vec4::from(columns.map(|i| v[row + i].to_f32()));
                    let values = raw * self.scale + self.offset;
                    let data = Vec4::from(values.to_array().map(|v| if v < -1e-4 { 0.0 } else { 1.0 }));
                    let values = values * data;
                    let (value, slope) = (values.dot(x.0), values.dot(x.1));
                    let (ones, ones_slope) = (data.dot(x.0), data.dot(x.1));
                    let of = |value: f32, slope: f32| {
                        Vec4::new(
                            slope * y.0[b] * z.0[c],
                            value * y.1[b] * z.0[c],
                            value * y.0[b] * z.1[c],
                            value * y.0[b] * z.0[c],
                        )
                    };
                    sum += of(value, slope);
                    counted += of(ones, ones_slope);
                }
            }
        });
        if counted.w < 1e-6 {
            return (self.sample(p), Vec3::ZERO);
        }
        let value = sum.w / counted.w;
        (value, (sum.truncate() - counted.truncate() * value) / counted.w)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{GradientFilter, Rescale, Volume, VoxelGrid, Voxels};
    use glam::DAffine3;

    fn grid(value: impl Fn(Vec3) -> f32) -> VoxelGrid {
        let size = [9, 8, 7];
        let voxels: Vec<f32> = (0..504)
            .map(|n| value(Vec3::new((n % 9) as f32, (n / 9 % 8) as f32, (n / 72) as f32)))
            .collect();
        let volume = Volume::new(Voxels::new(size, voxels), Rescale::NONE, DAffine3::IDENTITY);
        VoxelGrid::new(&volume)
    }

    #[test]
    fn weights_sum_to_one_and_slopes_are_their_derivatives() {
        for n in 0..=10 {
            let f = n as f32 / 10.0;
            let (w, d) = weights(f);
            assert!(
                (w.element_sum() - 1.0).abs() < 1e-6 && d.element_sum().abs() < 1e-6,
                "{f}"
            );
            let h = 1e-2;
            let difference = (weights(f + h).0 - weights(f - h).0) / (2.0 * h);
            assert!(difference.abs_diff_eq(d, 1e-3), "{f}: {difference} {d}");
        }
    }

    #[test]
    fn linear_functions_are_reproduced_with_their_gradients() {
        let grid = grid(|p| 1.0 + 2.0 * p.x + 3.0 * p.y - p.z);
        let (s, span) = (VolumeSampler::new(&grid), 2.0 * 8.0 + 3.0 * 7.0 + 6.0);
        let p = Vec3::new(3.3, 2.6, 4.1);
        let (value, gradient) = s.sample_cubic(p);
        assert!((value - s.sample(p)).abs() < 1e-5, "{value}");
        assert!(
            gradient.abs_diff_eq(Vec3::new(2.0, 3.0, -1.0) / span, 1e-5),
            "{gradient}"
        );
    }

    #[test]
    fn gradients_are_the_derivatives_of_values() {
        let grid = grid(|p| (p.x * 0.9).sin() + (p.y * 1.1 + p.z).cos());
        let s = VolumeSampler::new(&grid);
        for p in [
            Vec3::new(3.1, 2.2, 4.4),
            Vec3::new(0.2, 6.9, -0.3),
            Vec3::new(8.3, 0.0, 5.5),
        ] {
            let h = 0.02;
            let slope = |e: Vec3| (s.sample_cubic(p + e * h).0 - s.sample_cubic(p - e * h).0) / (2.0 * h);
            let want = Vec3::new(slope(Vec3::X), slope(Vec3::Y), slope(Vec3::Z));
            let got = s.sample_cubic(p).1;
            assert!(got.abs_diff_eq(want, 2e-3), "{p}: {got} {want}");
        }
    }

    #[test]
    fn voxels_without_data_do_not_count() {
        let whole = grid(|p| 1.0 + p.x);
        let holed = grid(|p| if p.y < 3.0 { f32::NAN } else { 1.0 + p.x });
        let p = Vec3::new(4.4, 4.2, 3.0);
        let (value, gradient) = VolumeSampler::new(&holed).sample_cubic(p);
        let (want, slope) = VolumeSampler::new(&whole).sample_cubic(p);
        assert!(holed.has_holes && (value - want).abs() < 1e-5, "{value} {want}");
        assert!(gradient.abs_diff_eq(slope, 1e-5), "{gradient} {slope}");
    }

    /// A ball's normals, which trilinear differences turn by degrees.
    #[test]
    fn normals_of_a_ball_are_smooth() {
        let size = [40usize; 3];
        let center = Vec3::new(19.4, 19.7, 19.1);
        let at = |n: usize| Vec3::new((n % 40) as f32, (n / 40 % 40) as f32, (n / 1600) as f32);
        let voxels: Vec<f32> = (0..64_000)
            .map(|n| 12.0 - (at(n) - center).length())
            .map(|d| d.clamp(-3.0, 3.0))
            .collect();
        let grid = VoxelGrid::new(&Volume::new(
            Voxels::new(size, voxels),
            Rescale::NONE,
            DAffine3::IDENTITY,
        ));
        let s = VolumeSampler::new(&grid);
        let worst = |normal: &dyn Fn(Vec3) -> Vec3| {
            (0..400)
                .map(|n| {
                    let z = 1.0 - (n as f32 + 0.5) / 200.0;
                    let (r, a) = ((1.0 - z * z).sqrt(), n as f32 * 2.399_963);
                    let out = Vec3::new(r * a.cos(), r * a.sin(), z);
                    normal(center + out * 12.0)
                        .normalize()
                        .dot(-out)
                        .clamp(-1.0, 1.0)
                        .acos()
                        .to_degrees()
                })
                .fold(0.0f32, f32::max)
        };
        let cubic = worst(&|p| s.sample_cubic(p).1);
        let linear = worst(&|p| s.gradient(p, GradientFilter::Central));
        println!(
            "normals of a ball: within {cubic:.3} degrees by cubic splines, {linear:.3} by central differences"
        );
        assert!(cubic < 0.3 && cubic < linear, "{cubic} {linear}");
    }
}
