//! How much of the light reaches a sample: from the light volume or, as a reference, by rays.
//!
//! `shaders/lib/light.wgsl` computes the same from the light volume.

use super::{sample_scene, surface};
use crate::math::lanes::*;
use crate::math::light::LightShares;
use crate::math::normalize_or;
use crate::prepare::{Prepared, ReferenceRays};
use crate::volume::VolumeSampler;
use glam::{Mat3, Vec3};

/// The optical depth per reference length of something opaque.
pub(super) const SOLID_DEPTH: f32 = 16.0;
/// Optical depth (powers of 1/2) after which nothing passes.
const MAX_DEPTH: f32 = 12.0;

/// The normal on the side that the eye sees, where light casts shadows: light that falls on the
/// other side is not seen.
pub(super) fn facing_the_eye(scene: &Prepared, normal: Vec3, direction: Vec3) -> Vec3 {
    if scene.light_volume.is_some() && normal.dot(direction) > 0.0 {
        return -normal;
    }
    normal
}

/// The shares of the light that reach a sample seen along `direction`. `depth` is its optical depth
/// per reference length: what is opaque up to where its light is read is a surface, even if the
/// gradient does not show it.
pub(super) fn light_shares(
    scene: &Prepared,
    sampler: &VolumeSampler,
    (normal, confidence): (Vec3, f32),
    depth: f32,
    at: Vec3,
    direction: Vec3,
) -> LightShares<f32> {
    let Some(volume) = &scene.light_volume else {
        return LightShares::ALL;
    };
    let out = normal * confidence - direction * (1.0 - confidence);
    let in_front = at + normalize_or(out, -direction) * volume.offset_mm();
    let per_offset = volume.offset_mm() / scene.frame.spacing.reference_mm;
    let confidence = confidence.max(1.0 - (-depth * per_offset).exp2());
    let [key, open] = match &volume.rays {
        None => volume.sample(in_front),
        Some(rays) => by_rays(scene, sampler, rays, in_front),
    };
    LightShares {
        key,
        sky: (open * (1.0 + confidence)).min(1.0),
    }
}

/// Eight samples that light falls on.
#[derive(Clone, Copy)]
pub(super) struct LitSamples<S: Simd> {
    pub(super) normal: Vec3x8<S>,
    pub(super) confidence: f32x8<S>,
    /// Optical depths per reference length.
    pub(super) depth: f32x8<S>,
    /// Positions in the deformed scene, and the directions in which they are seen.
    pub(super) at: Vec3x8<S>,
    pub(super) direction: Vec3x8<S>,
}

/// [`light_shares`] of eight samples, of which only those in `lanes` are needed.
#[inline(always)]
pub(super) fn light_shares_lanes<S: Simd>(
    simd: S,
    scene: &Prepared,
    sampler: &VolumeSampler,
    samples: &LitSamples<S>,
    lanes: u64,
) -> LightShares<f32x8<S>> {
    let one = f32x8::splat(simd, 1.0);
    let Some(volume) = &scene.light_volume else {
        return LightShares { key: one, sky: one };
    };
    let out = samples.normal * samples.confidence - samples.direction * (one - samples.confidence);
    let in_front = samples.at + out.normalized() * f32x8::splat(simd, volume.offset_mm());
    let per_offset = volume.offset_mm() / scene.frame.spacing.reference_mm;
    let confidence = samples.confidence.max(one - exp2(samples.depth * -per_offset));
    let [mut key, mut open] = [one, one];
    match &volume.rays {
        None => [key, open] = volume.sample_lanes(simd, in_front),
        Some(rays) => {
            for n in lanes_of(lanes) {
                [key[n], open[n]] = by_rays(scene, sampler, rays, in_front.lane(n));
            }
        }
    }
    LightShares {
        key,
        sky: (open * (confidence + 1.0)).min(1.0),
    }
}

/// S and `V_raw` at a point by rays through the scene itself.
#[inline(never)]
fn by_rays(scene: &Prepared, sampler: &VolumeSampler, rays: &ReferenceRays, at: Vec3) -> [f32; 2] {
    let mean = |directions: &[Vec3], reach_mm: f32| -> f32 {
        let sum: f32 = directions
            .iter()
            .map(|&direction| transmittance(scene, sampler, at, direction, reach_mm))
            .sum();
        if directions.is_empty() {
            1.0
        } else {
            sum / directions.len() as f32
        }
    };
    [
        mean(&rays.toward_light, f32::INFINITY),
        mean(&rays.around, rays.reach_mm),
    ]
}

/// Transmittance along a ray through the deformed scene: of its volume, at the distance of the
/// picture's samples, and of its surfaces.
fn transmittance(
    scene: &Prepared,
    sampler: &VolumeSampler,
    origin: Vec3,
    direction: Vec3,
    reach_mm: f32,
) -> f32 {
    if !scene.surfaces.objects.is_empty()
        && surface::nearest_side(scene, origin, direction).is_some_and(|(t, _)| t < reach_mm)
    {
        return 0.0;
    }
    if !scene.is_composite() {
        return 1.0;
    }
    let volume = scene.volume();
    let Some((near, far)) = volume.macrocells.occupied.intersect_ray(origin, direction) else {
        return 1.0;
    };
    let (step, inverse) = (scene.frame.spacing.step_mm, direction.recip());
    let (mut t, end) = (near.max(0.0) + 0.5 * step, far.min(reach_mm));
    let mut depth = 0.0;
    while t < end && depth < MAX_DEPTH {
        let p = origin + direction * t;
        if let Some(exit) = volume.macrocells.empty_until(p, origin, inverse) {
            t += ((exit - t) / step).ceil().max(1.0) * step;
            continue;
        }
        let at = sample_scene(scene, sampler, p);
        if at.present {
            let of_step = match volume.iso {
                Some(iso) if at.value >= iso => MAX_DEPTH,
                Some(_) => 0.0,
                None => {
                    let depth = volume.table.lookup(at.value)[3];
                    let factor = if depth > 0.0 && scene.uses_gradient_opacity() {
                        let per_voxel = sampler.gradient(at.in_voxel, scene.gradient_filter());
                        let gradient = Mat3::from(volume.voxel_from_world.matrix3).transpose() * per_voxel;
                        volume.table.gradient_factor(gradient.length())
                    } else {
                        1.0
                    };
                    depth * factor * step / scene.frame.spacing.reference_mm
                }
            };
            depth += of_step;
        }
        t += step;
    }
    (-depth).exp2()
}
