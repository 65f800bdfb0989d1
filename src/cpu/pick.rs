//! What one pixel shows: the point of the deformed scene, its source, the value there, and the
//! surface normal.
//!
//! The ray is followed as in the renderer until it has lost three tenths of its light: this is the
//! first surface a viewer would point at, rather than the first semi-transparent region in front of
//! it.

use super::{SceneSample, first_sample_after, sample_scene, shading, surface};
use crate::math::normalize_or;
use crate::prepare::Prepared;
use crate::scene::Mode;
use crate::volume::VolumeSampler;
use glam::Vec3;

/// Fraction of a ray's light that is lost at the picked point.
const MIN_PICK_OPACITY: f32 = 0.3;

/// A picked point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pick {
    /// The point of the deformed scene, world mm.
    pub deformed: Vec3,
    /// Its source point, world mm.
    pub source: Vec3,
    /// The volume's value there, data units; none on a mesh outside the volume.
    pub value: Option<f64>,
    /// Unit normal in the deformed scene, towards the viewer.
    pub normal: Vec3,
}

/// What is visible at picture coordinates in -1..1 (v upwards); `range` is the volume's value
/// range, data units. None where nothing is visible.
pub fn at(scene: &Prepared, range: [f64; 2], u: f32, v: f32) -> Option<Pick> {
    let (origin, direction) = scene.frame.view.ray(u, v);
    let sampler = VolumeSampler::new(scene.volume().grid);
    along(scene, &sampler, range, origin, direction)
}

fn along(
    scene: &Prepared,
    sampler: &VolumeSampler,
    range: [f64; 2],
    origin: Vec3,
    direction: Vec3,
) -> Option<Pick> {
    let mesh = surface::nearest_side(scene, origin, direction);
    let until = mesh.map_or(f32::INFINITY, |(t, _)| t);
    let in_data = |value: f32| range[0] + f64::from(value) * (range[1] - range[0]);
    if scene.settings.mode != Mode::Surface
        && let Some((deformed, at)) = first_visible_sample(scene, sampler, origin, direction, until)
    {
        let jet = shading::jet(scene, deformed);
        let gradient =
            shading::world_from_voxel_covector(scene, sampler.gradient(at.in_voxel, scene.gradient_filter()));
        let cut = shading::nearer_cut_shape(scene, shading::nearest_cut(scene, &jet, at.in_voxel), deformed);
        let own = shading::shaded_normal(scene, &jet.d_source_d_deformed, gradient, &cut, direction).normal;
        let normal = normalize_or(own, -direction);
        let normal = if normal.dot(direction) > 0.0 {
            -normal
        } else {
            normal
        };
        return Some(Pick {
            deformed,
            source: jet.source,
            value: Some(in_data(at.value)),
            normal,
        });
    }
    let (t, normal) = mesh?;
    let deformed = origin + direction * t;
    let at = sample_scene(scene, sampler, deformed);
    let source = scene.stack.source_and_alpha(deformed).0;
    let normal = if normal.dot(direction) > 0.0 {
        -normal
    } else {
        normal
    };
    Some(Pick {
        deformed,
        source,
        value: at.present.then(|| in_data(at.value)),
        normal: normalize_or(normal, -direction),
    })
}

/// The first sample along a ray at which enough light is lost.
fn first_visible_sample(
    scene: &Prepared,
    sampler: &VolumeSampler,
    origin: Vec3,
    direction: Vec3,
    until: f32,
) -> Option<(Vec3, SceneSample)> {
    let frame = &scene.frame;
    let (near, far) = frame.proxy.intersect_ray(origin, direction)?;
    // Half the renderer's step: the point should lie on the surface, not up to a step behind it.
    let step = 0.5 * frame.spacing.step_mm;
    let (mut i, end) = (
        first_sample_after(near, step),
        first_sample_after(far.min(until), step),
    );
    let inverse_direction = direction.recip();
    let mut transmittance = 1.0f32;
    while i < end {
        let deformed = origin + direction * ((i as f32 + 0.5) * step);
        if let Some(t) = scene
            .volume()
            .macrocells
            .empty_until(deformed, origin, inverse_direction)
        {
            i = first_sample_after(t, step).max(i + 1).min(end);
            continue;
        }
        i += 1;
        let at = sample_scene(scene, sampler, deformed);
        if !at.present {
            continue;
        }
        if let Some(iso) = scene.volume().iso {
            if at.value >= iso {
                return Some((deformed, at));
            }
            continue;
        }
        let depth = scene.volume().table.lookup(at.value)[3];
        transmittance *= (-depth * step / frame.spacing.reference_mm).exp2();
        if 1.0 - transmittance >= MIN_PICK_OPACITY {
            return Some((deformed, at));
        }
    }
    None
}
