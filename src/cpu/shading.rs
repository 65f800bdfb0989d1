//! Lighting of one visible sample: normals under deformation and at cuts.
//!
//! *Theory*: with J = d source / d deformed, a gradient of the deformed scene is Jᵀ times the
//! source's (\[DDM06\] eq 6 and 10). Near a cut the normal is blended into the cut's own (\[DDM06\]
//! eq 7).
//!
//! *Differences from the paper*:
//! - The blend runs over the distance to the cut, not over the mask's value, hence it does not
//!   depend on a map's resolution. Within one sample (the first one a ray finds behind a cut) or
//!   one voxel, whichever is longer, the cut's normal is used alone; beyond 2.5 of them it is not
//!   used.
//! - A ray that enters material through the volume's own surface next to a cut shows that surface:
//!   its normal is not blended. The cut is visible only where the ray comes out of it and, from the
//!   cut's face onwards along the ray, the material is at least half as dense as at the sample
//!   (`cut_in_front`). Without this every cut has a dark rim, and a cut behind a thin layer shows
//!   through it, the more so the finer the step.
//! - The faces of the volume's own box are cuts too: material cut off at a scan's edge is lit as at
//!   any other cut.
//! - What a sample represents of its ray, and where the ray enters material, is found first
//!   (`edges.rs`); a sample just behind a surface is shaded where the ray enters it.
//! - The transfer function defines the outside of a surface: where opacity falls. (Only one-sided
//!   light needs this.)
//! - In uniform regions the gradient is noise. Its weight fades with its magnitude, and samples
//!   without a normal are lit evenly.
//!
//! `shaders/lib/shading.wgsl` computes the same.

use super::SceneSample;
use super::light::{SOLID_DEPTH, facing_the_eye, light_shares};
use crate::deform::{Jet, NearestCut};
use crate::math::{normalize_or, smoothstep};
use crate::prepare::Prepared;
use crate::scene::{IsoLight, Normals};
use crate::volume::VolumeSampler;
use glam::{Mat3, Vec3};

/// A sample's lit colour, and the factor on its optical depth.
pub struct Shaded {
    /// Red, green, blue, not premultiplied.
    pub color: Vec3,
    /// The gradient opacity.
    pub depth_factor: f32,
}

/// The normal of a sample and its reliability.
#[derive(Clone, Copy, Debug)]
pub struct Normal {
    /// Unit vector pointing out of the material.
    pub normal: Vec3,
    /// 0 where there is no surface, 1 where there is one.
    pub confidence: f32,
}

/// Change of the table coordinate per Δ₀ below which a gradient is noise, and above which it is a
/// surface.
pub(super) const SURFACE_GRADIENT: [f32; 2] = [0.004, 0.04];
/// Fraction of the diffuse light that a sample without a normal receives.
pub(super) const ISOTROPIC_DIFFUSE: f32 = 0.6;

/// A visible sample before lighting.
#[derive(Clone, Copy, Debug)]
pub struct VisibleSample {
    /// Position in the deformed scene, mm.
    pub deformed: Vec3,
    /// Source position, voxels.
    pub in_voxel: Vec3,
    /// Colour from the transfer function.
    pub color: Vec3,
    /// Optical depth per reference length.
    pub depth: f32,
    /// Normalised value.
    pub value: f32,
    /// Gradient per voxel, if it came with the value.
    pub gradient: Option<Vec3>,
}

/// Shades a visible sample, seen along `direction`. `entered`: if the ray enters material there,
/// whether it does through a cut (or the volume's face), as opposed to out of thinner material.
pub(super) fn shade(
    scene: &Prepared,
    sampler: &VolumeSampler,
    sample: &VisibleSample,
    entered: Option<bool>,
    direction: Vec3,
) -> Shaded {
    let jet = jet(scene, sample.deformed);
    let near = || nearer_cut_shape(scene, nearest_cut(scene, &jet, sample.in_voxel), sample.deformed);
    let cut = match entered {
        Some(false) => NearestCut::NONE,
        Some(true) => near(),
        None => cut_in_front(scene, sampler, sample, near(), direction),
    };
    shade_point(scene, sampler, sample, &jet, &cut, direction)
}

/// How far back towards the face of a cut to sample the material that it cuts, as a fraction of the
/// way: not onto the face itself, because the distance to it is only a first-order estimate.
pub(super) const CUT_LOOKBACK_SHARE: f32 = 0.9;
/// The farthest distance to sample back, in reaches of the blend: along a face that a ray grazes,
/// more distant samples are meaningless.
pub(super) const MAX_CUT_LOOKBACK: f32 = 4.0;
/// How often that distance is halved where it reaches beyond the face.
pub(super) const CUT_LOOKBACK_STEPS: u32 = 4;

/// A cut near a sample inside the material, if the ray came out of it; none if the ray has passed
/// another surface since, or heads towards the cut.
fn cut_in_front(
    scene: &Prepared,
    sampler: &VolumeSampler,
    sample: &VisibleSample,
    cut: NearestCut,
    direction: Vec3,
) -> NearestCut {
    if scene.settings.normals != Normals::Blended || cut.distance_mm >= scene.frame.spacing.blend_mm[1] {
        return cut;
    }
    let facing = -cut.normal.dot(direction);
    if facing <= 0.0 {
        return NearestCut::NONE;
    }
    let mut way = (CUT_LOOKBACK_SHARE * cut.distance_mm.max(0.0) / facing)
        .min(MAX_CUT_LOOKBACK * scene.frame.spacing.blend_mm[1]);
    for _ in 0..CUT_LOOKBACK_STEPS {
        let back = super::sample_scene(scene, sampler, sample.deformed - direction * way);
        if back.present {
            return if scene.volume().table.lookup(back.value)[3] >= 0.5 * sample.depth {
                cut
            } else {
                NearestCut::NONE
            };
        }
        // The sample lies beyond the face, which is less flat than assumed.
        way *= 0.5;
    }
    cut
}

/// The voxels' own colour, if the volume has colours and shows them.
fn own_color(scene: &Prepared, in_voxel: Vec3) -> Option<Vec3> {
    scene
        .volume()
        .colors
        .map(|colors| colors.sample(scene.volume().grid.size, in_voxel))
}

/// Lighting and gradient opacity at a point.
fn shade_point(
    scene: &Prepared,
    sampler: &VolumeSampler,
    sample: &VisibleSample,
    jet: &Jet,
    cut: &NearestCut,
    direction: Vec3,
) -> Shaded {
    let color = own_color(scene, sample.in_voxel).unwrap_or(sample.color);
    if !scene.is_lit() && !scene.uses_gradient_opacity() {
        return Shaded {
            color,
            depth_factor: 1.0,
        };
    }
    let per_voxel = sample
        .gradient
        .unwrap_or_else(|| sampler.gradient(sample.in_voxel, scene.gradient_filter()));
    let gradient_in_source = world_from_voxel_covector(scene, per_voxel);
    let depth_factor = if scene.uses_gradient_opacity() {
        scene.volume().table.gradient_factor(gradient_in_source.length())
    } else {
        1.0
    };
    if !scene.is_lit() {
        return Shaded { color, depth_factor };
    }
    let falling = if scene.is_lit_on_both_sides() {
        1.0
    } else {
        scene.volume().table.opacity_slope_sign(sample.value)
    };
    let normal = shaded_normal(
        scene,
        &jet.d_source_d_deformed,
        gradient_in_source * falling,
        cut,
        direction,
    );
    Shaded {
        color: light(
            scene,
            sampler,
            (normal, sample.depth),
            sample.deformed,
            direction,
            color,
        ),
        depth_factor,
    }
}

/// Source point, Jacobian, nearest cut and mask at a deformed point.
pub(super) fn jet(scene: &Prepared, deformed: Vec3) -> Jet {
    if scene.stack.is_empty() {
        return Jet {
            source: deformed,
            d_source_d_deformed: Mat3::IDENTITY,
            cut: NearestCut::NONE,
            alpha: 1.0,
        };
    }
    scene.stack.jet(deformed)
}

/// Transforms a covector per voxel (a gradient along i, j, k) to one per millimetre of the source.
pub fn world_from_voxel_covector(scene: &Prepared, per_voxel: Vec3) -> Vec3 {
    Mat3::from(scene.volume().voxel_from_world.matrix3).transpose() * per_voxel
}

/// The nearest of the cuts by masks and the six faces of the volume's box.
pub fn nearest_cut(scene: &Prepared, jet: &Jet, in_voxel: Vec3) -> NearestCut {
    let low = in_voxel + 0.5;
    let high = scene.volume().grid_size - 0.5 - in_voxel;
    let mut cut = jet.cut;
    for axis in 0..3 {
        let (inside, inward) = if low[axis] < high[axis] {
            (low[axis], 1.0)
        } else {
            (high[axis], -1.0)
        };
        let per_mm = world_from_voxel_covector(scene, Vec3::AXES[axis] * inward);
        cut = cut.nearer_of(inside, jet.d_source_d_deformed.transpose() * per_mm);
    }
    cut
}

/// The nearer of a cut and the surface of the analytic cut shapes.
pub fn nearer_cut_shape(scene: &Prepared, cut: NearestCut, deformed: Vec3) -> NearestCut {
    let distance_mm = scene.cuts.signed_distance_mm(deformed);
    // Beyond the reach of the blend it has no effect.
    if distance_mm > scene.frame.spacing.blend_mm[1] {
        cut
    } else {
        cut.nearer_of(
            distance_mm,
            scene
                .cuts
                .gradient(deformed, 0.05 * scene.frame.spacing.reference_mm),
        )
    }
}

/// Bisections of the step in which a ray meets the face of a cut, or a surface.
const FACE_STEPS: u32 = 10;

/// Whether a point of the deformed scene is cut away.
fn is_cut(scene: &Prepared, deformed: Vec3) -> bool {
    scene.cuts.signed_distance_mm(deformed) < 0.0 || scene.stack.source_and_alpha(deformed).1 < 0.5
}

/// The scan's grey value, by window and level, on the cut face that the ray came out of within the
/// last step, if there is one.
pub(super) fn grey_face(
    scene: &Prepared,
    sampler: &VolumeSampler,
    at: &SceneSample,
    deformed: Vec3,
    direction: Vec3,
    step_mm: f32,
) -> Option<f32> {
    let near = at.alpha < 1.0 || scene.cuts.signed_distance_mm(deformed) < 1.5 * step_mm;
    if !near || !is_cut(scene, deformed - direction * step_mm) {
        return None;
    }
    let (mut inside, mut outside) = (deformed, deformed - direction * step_mm);
    for _ in 0..FACE_STEPS {
        let middle = (inside + outside) * 0.5;
        if is_cut(scene, middle) {
            outside = middle
        } else {
            inside = middle
        }
    }
    // The ray may have left the volume's box between the cut and here.
    let face = super::sample_scene(scene, sampler, inside);
    let [low, high] = scene.volume().grey_window;
    // What is black in the window (the air around a body) is not painted.
    (face.present && face.value > low).then(|| ((face.value - low) / (high - low).max(1e-6)).clamp(0.0, 1.0))
}

/// Cosine of the angle between an iso-surface's normal and the light: the derivative of the
/// deformed volume towards the light divided by the gradient's magnitude, by differences of
/// samples. Needs neither the source's gradient nor the Jacobian.
fn light_cosine_by_derivative(scene: &Prepared, sampler: &VolumeSampler, at: Vec3) -> f32 {
    let h = scene.frame.spacing.reference_mm;
    let value = |p: Vec3| {
        let at = super::sample_scene(scene, sampler, p);
        if at.present { at.value } else { 0.0 }
    };
    let to_light = scene.frame.to_light;
    let (u, v) = to_light.any_orthonormal_pair();
    // Values decrease outwards, that is, towards a light that the surface faces.
    let [l, u, v] = [to_light, u, v].map(|e| value(at - e * h) - value(at + e * h));
    let facing = l / (l * l + u * u + v * v).sqrt().max(1e-6);
    if scene.is_lit_on_both_sides() {
        facing.abs()
    } else {
        facing.max(0.0)
    }
}

/// Colour of the surface where the volume has the value `iso`, crossed within the step before
/// `deformed` (\[RVD01\] section 3.3).
pub(super) fn iso_surface(
    scene: &Prepared,
    sampler: &VolumeSampler,
    iso: f32,
    deformed: Vec3,
    direction: Vec3,
    step_mm: f32,
) -> Vec3 {
    let inside_at = |p: Vec3| {
        let at = super::sample_scene(scene, sampler, p);
        (at, at.present && at.value >= iso)
    };
    let (mut inside, mut outside) = (deformed, deformed - direction * step_mm);
    let mut through_cut = false;
    let (before, already) = inside_at(outside);
    if !already {
        through_cut = !before.present;
        for _ in 0..FACE_STEPS {
            let middle = (inside + outside) * 0.5;
            match inside_at(middle) {
                (_, true) => inside = middle,
                (at, false) => (outside, through_cut) = (middle, !at.present),
            }
        }
    }
    let hit = super::sample_scene(scene, sampler, inside);
    let [r, g, b, _] = scene
        .volume()
        .table
        .lookup(if through_cut { hit.value } else { iso });
    let color = own_color(scene, hit.in_voxel).unwrap_or(Vec3::new(r, g, b));
    if !scene.is_lit() {
        return color;
    }
    let jet = jet(scene, inside);
    let cut = if through_cut {
        nearer_cut_shape(scene, nearest_cut(scene, &jet, hit.in_voxel), inside)
    } else {
        NearestCut::NONE
    };
    let per_voxel = if scene.is_cubic() {
        sampler.sample_cubic(hit.in_voxel).1
    } else {
        sampler.gradient(hit.in_voxel, scene.gradient_filter())
    };
    let gradient = world_from_voxel_covector(scene, per_voxel);
    if !through_cut && scene.settings.iso_light == IsoLight::Derivative {
        let facing = light_cosine_by_derivative(scene, sampler, inside);
        let shares = light_shares(scene, sampler, (-direction, 0.0), SOLID_DEPTH, inside, direction);
        let factors = Vec3::from(scene.light.blinn_phong().even(facing, shares));
        return (color * factors).clamp(Vec3::ZERO, Vec3::ONE);
    }
    let normal = shaded_normal(scene, &jet.d_source_d_deformed, gradient, &cut, direction);
    light(scene, sampler, (normal, SOLID_DEPTH), inside, direction, color)
}

/// The normal of \[DDM06\] eq 7 in the deformed scene, from a source gradient per mm that points
/// into the material.
pub fn shaded_normal(
    scene: &Prepared,
    d_source_d_deformed: &Mat3,
    gradient_in_source: Vec3,
    cut: &NearestCut,
    direction: Vec3,
) -> Normal {
    let gradient = match scene.settings.normals {
        Normals::Source | Normals::None => gradient_in_source,
        Normals::Transformed | Normals::Blended => d_source_d_deformed.transpose() * gradient_in_source,
    };
    let per_reference =
        gradient_in_source.length() * scene.volume().table.scale.abs() * scene.frame.spacing.reference_mm;
    let mut confidence = smoothstep(SURFACE_GRADIENT[0], SURFACE_GRADIENT[1], per_reference);
    // Out of the material: down the gradient, which the caller has oriented to where opacity rises.
    let mut normal = normalize_or(-gradient, Vec3::ZERO);
    if scene.is_lit_on_both_sides() && normal.dot(direction) > 0.0 {
        normal = -normal;
    }
    if scene.settings.normals == Normals::Blended {
        let [near, far] = scene.frame.spacing.blend_mm;
        let own = smoothstep(near, far, cut.distance_mm);
        normal = normalize_or(normal * (own * confidence) + cut.normal * (1.0 - own), cut.normal);
        confidence = (own * confidence).max(1.0 - own);
    }
    Normal { normal, confidence }
}

/// The light on a sample of some optical depth at a point of the deformed scene; even where it has no
/// normal.
fn light(
    scene: &Prepared,
    sampler: &VolumeSampler,
    (n, depth): (Normal, f32),
    at: Vec3,
    direction: Vec3,
    color: Vec3,
) -> Vec3 {
    let normal = facing_the_eye(scene, n.normal, direction);
    let shares = light_shares(scene, sampler, (normal, n.confidence), depth, at, direction);
    let light = scene.light.blinn_phong();
    let to_light = scene.frame.to_light;
    let even = Vec3::from(light.even(ISOTROPIC_DIFFUSE, shares));
    let half = normalize_or(to_light - direction, to_light);
    let lit = light.lit(color, normal.dot(to_light), normal.dot(half), shares);
    (color * even + (lit - color * even) * n.confidence).clamp(Vec3::ZERO, Vec3::ONE)
}
