//! Samples a plane through the scene, as for multiplanar reconstructions (axial, coronal,
//! sagittal), deformed as the volume is.
//!
//! One sample per pixel, by the same walk through the maps as a ray's. In addition to the value it
//! reports the state of the map there: the mask, the determinant of the Jacobian (below 0 the field
//! folds, below 1 it stretches the scan), and the source point.

use crate::deform::StackAndCuts;
use crate::math::to_f32;
use crate::volume::{Volume, VolumeSampler, VoxelGrid};
use crate::{Result, Watch};
use glam::{Affine3A, Vec3};
use rayon::prelude::*;

/// A plane of pixels in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SectionPlane {
    /// The point at the centre of the picture, mm.
    pub center: Vec3,
    /// Unit vector pointing right in the picture.
    pub right: Vec3,
    /// Unit vector pointing down in the picture.
    pub down: Vec3,
    /// Edge length of a pixel, mm.
    pub mm_per_pixel: f32,
    /// Width and height, pixels.
    pub size: [u32; 2],
}

impl SectionPlane {
    /// The world point at pixel coordinates (0 at the left or upper edge).
    pub fn point(&self, x: f32, y: f32) -> Vec3 {
        let [width, height] = self.size.map(|n| n as f32);
        self.center + (self.right * (x - width / 2.0) + self.down * (y - height / 2.0)) * self.mm_per_pixel
    }

    /// Pixel coordinates of a world point's projection onto the plane, and its signed distance from
    /// the plane along right x down, mm.
    pub fn pixel(&self, world: Vec3) -> (f32, f32, f32) {
        let d = world - self.center;
        let [width, height] = self.size.map(|n| n as f32);
        (
            d.dot(self.right) / self.mm_per_pixel + width / 2.0,
            d.dot(self.down) / self.mm_per_pixel + height / 2.0,
            d.dot(self.right.cross(self.down)),
        )
    }
}

/// Samples on a plane, row by row from the top.
pub struct Section {
    /// The plane.
    pub plane: SectionPlane,
    /// Data values; NaN where no sample is present.
    pub values: Vec<f32>,
    /// Source point of each sample, mm.
    pub sources: Vec<Vec3>,
    /// The smallest mask along the way: below 1/2 the sample is cut away.
    pub mask: Vec<f32>,
    /// det d source / d deformed; empty unless requested.
    pub determinants: Vec<f32>,
}

/// Samples a plane of the deformed scene, or of the source if no deformation is given.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn sample(
    volume: &Volume,
    grid: &VoxelGrid,
    deformed: Option<StackAndCuts>,
    plane: SectionPlane,
    determinants: bool,
    watch: &Watch,
) -> Result<Section> {
    let request = SectionRequest {
        deformed,
        plane,
        determinants,
    };
    let section = rows(volume, grid, &VolumeSampler::new(grid), &request, watch);
    watch.check()?;
    Ok(section)
}

/// One pixel of a section: value, source, mask, determinant.
type SectionPixel = (f32, Vec3, f32, f32);

/// What a section shows.
struct SectionRequest<'a> {
    /// The deformation; none for the source.
    deformed: Option<StackAndCuts<'a>>,
    plane: SectionPlane,
    /// Whether the determinants of the Jacobian are wanted.
    determinants: bool,
}

fn rows(
    volume: &Volume,
    grid: &VoxelGrid,
    sampler: &VolumeSampler,
    request: &SectionRequest,
    watch: &Watch,
) -> Section {
    let plane = request.plane;
    let [width, height] = plane.size.map(|n| n as usize);
    let voxel_from_world = to_f32(&volume.world_from_voxel.inverse());
    let top = Vec3::from(grid.size.map(|n| n as f32)) - 0.5;
    let span = (volume.range[1] - volume.range[0]) as f32;
    let nothing: SectionPixel = (f32::NAN, Vec3::ZERO, 1.0, 1.0);
    let mut pixels = vec![nothing; width * height];
    pixels
        .par_chunks_mut(width.max(1))
        .enumerate()
        .for_each(|(y, row)| {
            if watch.is_cancelled() {
                return;
            }
            for (x, pixel) in row.iter_mut().enumerate() {
                let p = plane.point(x as f32 + 0.5, y as f32 + 0.5);
                *pixel = at(
                    sampler,
                    &voxel_from_world,
                    top,
                    request.deformed,
                    p,
                    request.determinants,
                );
                pixel.0 = pixel.0 * span + volume.range[0] as f32;
            }
        });
    Section {
        plane,
        values: pixels.iter().map(|p| p.0).collect(),
        sources: pixels.iter().map(|p| p.1).collect(),
        mask: pixels.iter().map(|p| p.2).collect(),
        determinants: if request.determinants {
            pixels.iter().map(|p| p.3).collect()
        } else {
            Vec::new()
        },
    }
}

fn at(
    sampler: &VolumeSampler,
    voxel_from_world: &Affine3A,
    top: Vec3,
    deformed: Option<StackAndCuts>,
    p: Vec3,
    determinants: bool,
) -> SectionPixel {
    let (source, mask, determinant) = match deformed {
        None => (p, 1.0, 1.0),
        Some(d) => {
            let (source, alpha) = d.stack.source_and_alpha(p);
            let determinant = if determinants && !d.stack.is_empty() {
                d.stack.jet(p).d_source_d_deformed.determinant()
            } else {
                1.0
            };
            (
                source,
                if d.cuts.signed_distance_mm(p) < 0.0 {
                    0.0
                } else {
                    alpha
                },
                determinant,
            )
        }
    };
    let in_voxel = voxel_from_world.transform_point3(source);
    if mask < 0.5 || in_voxel.cmplt(Vec3::splat(-0.5)).any() || in_voxel.cmpgt(top).any() {
        return (f32::NAN, source, mask, determinant);
    }
    let value = sampler.sample(in_voxel);
    (
        if value >= -1e-4 { value } else { f32::NAN },
        source,
        mask,
        determinant,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prepare::{Assets, Prepared};
    use crate::scene::Scene;

    fn head() -> (Scene, Assets) {
        let scene = Scene::of_volume("phantom:ball:size=24");
        let assets = Assets::load(&scene).unwrap();
        (scene, assets)
    }

    fn plane(assets: &Assets) -> SectionPlane {
        let b = assets.volume.bounds_in_world();
        SectionPlane {
            center: b.center(),
            right: Vec3::X,
            down: Vec3::Y,
            mm_per_pixel: b.size().x / 24.0,
            size: [24, 24],
        }
    }

    #[test]
    fn pixels_and_points_are_inverse() {
        let (_, assets) = head();
        let plane = plane(&assets);
        let (x, y, away) = plane.pixel(plane.point(3.25, 17.5) + Vec3::Z * 4.0);
        assert!(
            (x - 3.25).abs() < 1e-4 && (y - 17.5).abs() < 1e-4 && (away - 4.0).abs() < 1e-4,
            "{x} {y} {away}"
        );
    }

    #[test]
    fn the_undeformed_section_is_the_volumes_own_values() {
        let (_, assets) = head();
        let mut plane = plane(&assets);
        // Through the centres of the voxels of one layer.
        let voxel = assets
            .volume
            .world_from_voxel
            .transform_point3(glam::DVec3::new(0.0, 0.0, 11.0))
            .as_vec3();
        plane.center.z = voxel.z;
        let section = sample(&assets.volume, assets.grid(), None, plane, false, &Watch::NONE).unwrap();
        for (n, value) in section.values.iter().enumerate() {
            let expected = assets.volume.value(n % 24, n / 24, 11) as f32;
            assert!((value - expected).abs() < 1e-3, "{n}: {value} {expected}");
        }
    }

    #[test]
    fn a_cut_leaves_nothing_and_a_source_section_everything() {
        let (mut scene, assets) = head();
        let mut cut = crate::scene::Deformation::new("box");
        cut.size = Some(crate::scene::Size::Cube(1e4));
        scene.deformation.push(cut);
        let prepared = Prepared::new(&scene, &assets).unwrap();
        let deformed = StackAndCuts {
            stack: &prepared.stack,
            cuts: &prepared.cuts,
        };
        let cut = sample(
            &assets.volume,
            assets.grid(),
            Some(deformed),
            plane(&assets),
            true,
            &Watch::NONE,
        )
        .unwrap();
        assert!(cut.values.iter().all(|v| v.is_nan()) && cut.mask.iter().all(|m| *m < 0.5));
        let source = sample(
            &assets.volume,
            assets.grid(),
            None,
            plane(&assets),
            false,
            &Watch::NONE,
        )
        .unwrap();
        assert!(source.values.iter().all(|v| v.is_finite()));
    }
}
