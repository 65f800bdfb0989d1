//! [`super::shading`] for eight samples at once, and for those that must be shaded one by one.

use super::SceneSample;
use super::edges::{FoundSamples, SampleExtents, ShadingRays, SurfaceEntries};
use super::light::{LitSamples, light_shares_lanes};
use super::packet::{PacketSampler, SamplePacket};
use super::shading::{
    self, CUT_LOOKBACK_SHARE, CUT_LOOKBACK_STEPS, ISOTROPIC_DIFFUSE, MAX_CUT_LOOKBACK, SURFACE_GRADIENT,
    VisibleSample,
};
use crate::math::lanes::*;
use crate::scene::Normals;
use glam::Vec3;

/// A colour lit by its normal where there is a surface, and evenly where there is none.
#[inline(always)]
fn lit<S: Simd>(
    color: f32x8<S>,
    even: f32x8<S>,
    diffuse: f32x8<S>,
    highlight: f32x8<S>,
    confidence: f32x8<S>,
) -> f32x8<S> {
    let (dull, lit) = (color * even, color.mul_add(diffuse, highlight));
    (lit - dull).mul_add(confidence, dull).max(0.0).min(1.0)
}

impl PacketSampler<'_> {
    /// A sample that is not plain.
    #[inline(never)]
    pub(super) fn shade_scalar(&self, input: &ScalarInput, direction: Vec3) -> ScalarSample {
        let (scene, sampler) = (self.scene, self.sampler);
        let ScalarInput {
            at,
            depth,
            deformed,
            spacing,
            ..
        } = *input;
        if at.present
            && self.grey_faces
            && let Some(grey) = shading::grey_face(scene, sampler, &at, deformed, direction, spacing)
        {
            return ScalarSample::Opaque(Vec3::splat(grey));
        }
        if let Some(iso) = scene.volume().iso {
            if at.present && at.value >= iso {
                return ScalarSample::Opaque(shading::iso_surface(
                    scene, sampler, iso, deformed, direction, spacing,
                ));
            }
            return ScalarSample::Nothing;
        }
        if depth <= 0.0 {
            return ScalarSample::Nothing;
        }
        let (entry_deformed, in_voxel, value) = input.entry;
        let [r, g, b, _] = match &self.preintegrated {
            // The colour is that of the whole segment.
            Some(table) if input.segment => self.segment(table, input.front, at.value),
            _ => scene.volume().table.lookup(value),
        };
        let sample = VisibleSample {
            deformed: entry_deformed,
            in_voxel,
            color: Vec3::new(r, g, b),
            depth,
            value,
            gradient: input.gradient,
        };
        let shaded = shading::shade(scene, sampler, &sample, input.entered, direction);
        ScalarSample::Visible(shaded.color, shaded.depth_factor)
    }

    /// Lighting of eight visible samples: colours, factors on their depths, and which of `lanes`
    /// turn out to lie next to a cut, where these results do not hold.
    #[inline(always)]
    pub(super) fn shade<S: Simd>(
        &self,
        simd: S,
        found: &FoundSamples<S>,
        rays: ShadingRays<S>,
        lanes: mask32x8<S>,
        extents: &SampleExtents<S>,
    ) -> (Vec3x8<S>, f32x8<S>, mask32x8<S>) {
        let scene = self.scene;
        let one = f32x8::splat(simd, 1.0);
        let (at, sampled) = (&found.sample, found.deformed);
        let (entry, entered) = (extents.entry, extents.entered);
        let bits = lanes.to_bitmask();
        let color = self.unlit_color(simd, at, &entry, entered, bits);
        let (mut gradient, mut magnitude, mut factor) = (Vec3x8::splat(simd, Vec3::ZERO), one, one);
        if self.lit || self.gradient_opacity {
            gradient = match extents.gradient {
                Some(per_voxel) => per_voxel.mapped(&self.world_from_covector),
                None => self.world_gradient(simd, at, &entry, entered, bits),
            };
            magnitude = gradient.length();
        }
        if self.gradient_opacity {
            for n in lanes_of(bits) {
                factor[n] = scene.volume().table.gradient_factor(magnitude[n]);
            }
        }
        let per_reference = magnitude * (scene.volume().table.scale.abs() * scene.frame.spacing.reference_mm);
        let confidence = smoothstep(SURFACE_GRADIENT[0], SURFACE_GRADIENT[1], per_reference);
        let in_a_map = lanes & (at.inside | entry.inside);
        let (jacobian_columns, cut) = self.jacobians_and_cuts(simd, at, &entry, in_a_map, confidence);
        if !self.lit {
            return (color, factor, cut);
        }
        let mut inward = self.inward_gradient(&entry, gradient, bits);
        if in_a_map.any_true() && matches!(scene.settings.normals, Normals::Transformed | Normals::Blended) {
            inward = Vec3x8 {
                x: jacobian_columns[0].dot(inward),
                y: jacobian_columns[1].dot(inward),
                z: jacobian_columns[2].dot(inward),
            };
        }
        let mut normal = -inward.normalized();
        if scene.is_lit_on_both_sides() {
            let away = normal.dot(rays.direction).simd_gt(0.0);
            normal = Vec3x8::select(away, -normal, normal);
        }
        // A sample entered through the volume's own surface shows that surface.
        let near_cut = lanes
            & !in_a_map
            & !entered
            & !self.far_from_faces(at.in_voxel, Vec3x8::splat(simd, self.face_margin_voxels));
        let (normal, confidence) =
            self.blended_at_faces(simd, at, sampled, rays.direction, near_cut, (normal, confidence));
        let samples = LitSamples {
            normal,
            confidence,
            depth: at.depth,
            at: entry.deformed,
            direction: rays.direction,
        };
        let lit = self.light(simd, samples, rays.half, color, bits);
        (lit, factor, cut)
    }

    /// The colours of eight entries before lighting: from the transfer function, from the segments
    /// in front of them, or the volume's own.
    #[inline(always)]
    fn unlit_color<S: Simd>(
        &self,
        simd: S,
        at: &SamplePacket<S>,
        entry: &SurfaceEntries<S>,
        entered: mask32x8<S>,
        bits: u64,
    ) -> Vec3x8<S> {
        let scene = self.scene;
        let mut color = match &self.preintegrated {
            None if at.with_gradients && !self.cubic && !entered.any_true() => at.color,
            None => scene.volume().table.color_lanes(simd, entry.value),
            Some(table) => {
                let mut color = Vec3x8::splat(simd, Vec3::ZERO);
                for n in lanes_of(bits) {
                    let [r, g, b, _] = self.segment(table, at.front[n], at.value[n]);
                    color.set(n, Vec3::new(r, g, b));
                }
                color
            }
        };
        if let Some(colors) = scene.volume().colors {
            for n in lanes_of(bits) {
                color.set(n, colors.sample(scene.volume().grid.size, entry.in_voxel.lane(n)));
            }
        }
        color
    }

    /// The source's gradients at eight entries, per mm.
    #[inline(always)]
    fn world_gradient<S: Simd>(
        &self,
        simd: S,
        at: &SamplePacket<S>,
        entry: &SurfaceEntries<S>,
        entered: mask32x8<S>,
        bits: u64,
    ) -> Vec3x8<S> {
        let per_voxel = if at.with_gradients {
            let mut differences = at.differences;
            if entered.any_true() {
                let there = self.sampler.sample_with_differences(simd, entry.in_voxel).1;
                differences = Vec3x8::select(entered, there, differences);
            }
            self.sampler.gradient_of(simd, entry.in_voxel, differences, bits)
        } else {
            self.sampler
                .gradient_lanes(simd, entry.in_voxel, self.scene.gradient_filter(), bits)
        };
        per_voxel.mapped(&self.world_from_covector)
    }

    /// The columns of the deformation's Jacobian at eight entries where they are needed, and which
    /// of those in a map lie next to a cut.
    #[inline(always)]
    fn jacobians_and_cuts<S: Simd>(
        &self,
        simd: S,
        at: &SamplePacket<S>,
        entry: &SurfaceEntries<S>,
        in_a_map: mask32x8<S>,
        confidence: f32x8<S>,
    ) -> ([Vec3x8<S>; 3], mask32x8<S>) {
        let scene = self.scene;
        let mut cut = in_a_map & !in_a_map;
        let mut jacobian_columns = [
            Vec3x8::splat(simd, Vec3::X),
            Vec3x8::splat(simd, Vec3::Y),
            Vec3x8::splat(simd, Vec3::Z),
        ];
        // Far from every cut the deformation affects only samples that have a normal.
        let mut active_lanes = in_a_map
            & !(at.cut_free
                & self.far_from_faces(
                    entry.in_voxel,
                    Vec3x8::splat(simd, self.deformed_face_margin_voxels),
                ));
        if self.lit {
            active_lanes |= in_a_map & confidence.simd_gt(0.0);
        }
        if active_lanes.any_true() {
            let jets = scene.stack.jets_lanes(simd, entry.deformed, active_lanes);
            jacobian_columns = jets.columns;
            // The distance to a face of the volume's box is at least its distance in the source
            // over the norm of J: usually enough to skip the exact test.
            let [x, y, z] = jets.columns;
            let norm = (x.dot(x) + y.dot(y) + z.dot(z)).sqrt();
            let far = self.far_from_faces(
                entry.in_voxel,
                Vec3x8::splat(simd, self.face_margin_voxels) * norm,
            );
            cut |= active_lanes & jets.cut_distance_mm.simd_lt(self.margin_mm);
            for n in lanes_of((active_lanes & !far).to_bitmask()) {
                let jet = scene.stack.jet(entry.deformed.lane(n));
                let nearest = shading::nearest_cut(scene, &jet, entry.in_voxel.lane(n));
                cut.set(n, nearest.distance_mm < self.margin_mm);
                (0..3).for_each(|a| jacobian_columns[a].set(n, jet.d_source_d_deformed.col(a)));
            }
        }
        (jacobian_columns, cut)
    }

    /// Gradients oriented into the material, needed only for one-sided light.
    #[inline(always)]
    fn inward_gradient<S: Simd>(
        &self,
        entry: &SurfaceEntries<S>,
        gradient: Vec3x8<S>,
        bits: u64,
    ) -> Vec3x8<S> {
        let scene = self.scene;
        let mut inward = gradient;
        if !scene.is_lit_on_both_sides() {
            for n in lanes_of(bits) {
                if scene.volume().table.opacity_slope_sign(entry.value[n]) < 0.0 {
                    inward.set(n, -inward.lane(n));
                }
            }
        }
        inward
    }

    /// Normals and their confidence, blended with those of the volume's faces where rays come out
    /// of a nearby face.
    #[inline(always)]
    fn blended_at_faces<S: Simd>(
        &self,
        simd: S,
        at: &SamplePacket<S>,
        sampled: Vec3x8<S>,
        direction: Vec3x8<S>,
        near_cut: mask32x8<S>,
        (normal, confidence): (Vec3x8<S>, f32x8<S>),
    ) -> (Vec3x8<S>, f32x8<S>) {
        let scene = self.scene;
        if scene.settings.normals != Normals::Blended || !near_cut.any_true() {
            return (normal, confidence);
        }
        let (distance, outward) = self.nearest_face(simd, at.in_voxel);
        let own = smoothstep(
            scene.frame.spacing.blend_mm[0],
            scene.frame.spacing.blend_mm[1],
            distance,
        );
        let facing = -outward.dot(direction);
        let near_cut = near_cut & own.simd_lt(1.0) & facing.simd_gt(0.0);
        if !near_cut.any_true() {
            return (normal, confidence);
        }
        let way =
            (distance * CUT_LOOKBACK_SHARE / facing).min(MAX_CUT_LOOKBACK * scene.frame.spacing.blend_mm[1]);
        let near_cut = self.cut_in_front(simd, at, sampled, direction, way, near_cut);
        let of_face = f32x8::splat(simd, 1.0) - own;
        let blended = (normal * (own * confidence) + outward * of_face).normalized();
        (
            Vec3x8::select(near_cut, blended, normal),
            near_cut.select((own * confidence).max(of_face), confidence),
        )
    }

    /// Which samples of `near_cut` have come out of the cut without passing another surface since;
    /// as `cut_in_front` in [`shading`].
    #[inline(always)]
    fn cut_in_front<S: Simd>(
        &self,
        simd: S,
        at: &SamplePacket<S>,
        sampled: Vec3x8<S>,
        direction: Vec3x8<S>,
        mut way: f32x8<S>,
        mut near_cut: mask32x8<S>,
    ) -> mask32x8<S> {
        let mut undecided = near_cut;
        for _ in 0..CUT_LOOKBACK_STEPS {
            let point = sampled - direction * way;
            let near_shape = if self.scene.cuts.is_empty() {
                near_cut & !near_cut
            } else {
                undecided
            };
            let back = self.sample_points_apart(simd, &point, &undecided, &near_shape);
            near_cut &= !(undecided & back.present) | back.depth.simd_ge(at.depth * 0.5);
            undecided &= !back.present;
            if !undecided.any_true() {
                break;
            }
            way *= 0.5;
        }
        near_cut
    }

    /// The light on eight samples; even where they have no normal.
    #[inline(always)]
    fn light<S: Simd>(
        &self,
        simd: S,
        mut samples: LitSamples<S>,
        half: Vec3x8<S>,
        color: Vec3x8<S>,
        lanes: u64,
    ) -> Vec3x8<S> {
        let scene = self.scene;
        if scene.light_volume.is_some() {
            // Light on the other side is not seen; as in `facing_the_eye`.
            let away = samples.normal.dot(samples.direction).simd_gt(0.0);
            samples.normal = Vec3x8::select(away, -samples.normal, samples.normal);
        }
        let shares = light_shares_lanes(simd, scene, self.sampler, &samples, lanes);
        let (normal, confidence) = (samples.normal, samples.confidence);
        let light = scene.light.blinn_phong();
        let to_light = Vec3x8::splat(simd, scene.frame.to_light);
        let even = light.even(ISOTROPIC_DIFFUSE, shares);
        let (factors, highlight) = light.shine(normal.dot(to_light), normal.dot(half), shares);
        let [r, g, b] = light.highlight_color;
        Vec3x8 {
            x: lit(color.x, even[0], factors[0], highlight * r, confidence),
            y: lit(color.y, even[1], factors[1], highlight * g, confidence),
            z: lit(color.z, even[2], factors[2], highlight * b, confidence),
        }
    }
}

/// A sample to be shaded by itself.
pub(super) struct ScalarInput {
    pub(super) at: SceneSample,
    /// Its optical depth; 0 if it is invisible.
    pub(super) depth: f32,
    /// The value at its segment's front end, and whether it represents a pre-integrated segment.
    pub(super) front: f32,
    pub(super) segment: bool,
    /// Its position in the deformed scene.
    pub(super) deformed: Vec3,
    /// Where it is shaded: the position in the deformed scene, the source position in voxels, and
    /// the value.
    pub(super) entry: (Vec3, Vec3, f32),
    /// If the ray enters material there, whether it does through a cut.
    pub(super) entered: Option<bool>,
    /// The gradient per voxel there, if it came with the value.
    pub(super) gradient: Option<Vec3>,
    /// Distance to the neighbouring samples, mm.
    pub(super) spacing: f32,
}

/// The result of shading a sample next to a cut.
pub(super) enum ScalarSample {
    Nothing,
    /// A surface that hides everything behind it.
    Opaque(Vec3),
    /// Its colour, and a factor on its optical depth.
    Visible(Vec3, f32),
}
