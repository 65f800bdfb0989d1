//! [`super::shading`] for eight samples at once, and for those that must be shaded one by one.

use super::SceneSample;
use super::packet::{PacketSampler, SamplePacket};
use super::shading::{
    self, CUT_LOOKBACK_SHARE, CUT_LOOKBACK_STEPS, ENTRY_STEPS, ISOTROPIC_DIFFUSE, MAX_CUT_LOOKBACK,
    SURFACE_GRADIENT, VisibleSample,
};
use crate::math::lanes::*;
use crate::scene::Normals;
use glam::Vec3;

/// A colour lit by its normal where there is a surface, and evenly where there is none.
#[inline(always)]
fn lit<S: Simd>(
    color: f32x8<S>,
    even: f32,
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
    pub(super) fn shade_scalar(
        &self,
        (at, depth): (SceneSample, f32),
        front: f32,
        sampled: Vec3,
        direction: Vec3,
        step: f32,
    ) -> ScalarSample {
        let (scene, sampler) = (self.scene, self.sampler);
        if at.present
            && self.grey_faces
            && let Some(grey) = shading::grey_face(scene, sampler, &at, sampled, direction, step)
        {
            return ScalarSample::Opaque(Vec3::splat(grey));
        }
        if let Some(iso) = scene.volume().iso {
            if at.present && at.value >= iso {
                return ScalarSample::Opaque(shading::iso_surface(
                    scene, sampler, iso, sampled, direction, step,
                ));
            }
            return ScalarSample::Nothing;
        }
        if depth > 0.0 {
            let [r, g, b, depth] = match &self.preintegrated {
                Some(table) => self.segment(table, front, at.value),
                None => scene.volume().table.lookup(at.value),
            };
            let sample = VisibleSample {
                deformed: sampled,
                in_voxel: at.in_voxel,
                color: Vec3::new(r, g, b),
                depth,
                value: at.value,
            };
            let shaded = shading::shade(scene, sampler, &sample, direction, step);
            return ScalarSample::Visible(shaded.color, depth * shaded.depth_factor);
        }
        if at.alpha > 0.0
            && at.alpha < 1.0
            && let Some((depth, shaded)) =
                shading::thin_layer_at_cut(scene, sampler, sampled, at.present, direction, step)
        {
            return ScalarSample::Visible(shaded.color, depth * shaded.depth_factor);
        }
        ScalarSample::Nothing
    }

    /// Lighting of eight visible samples: colours, factors on their depths, and which of `lanes`
    /// turn out to lie next to a cut, where these results do not hold.
    #[inline(always)]
    pub(super) fn shade<S: Simd>(
        &self,
        simd: S,
        at: &SamplePacket<S>,
        sampled: Vec3x8<S>,
        rays: ShadingRays<S>,
        lanes: mask32x8<S>,
        front: &PreviousSamples<S>,
    ) -> (Vec3x8<S>, f32x8<S>, mask32x8<S>) {
        let scene = self.scene;
        let one = f32x8::splat(simd, 1.0);
        let (entry, entered) = self.entry(simd, at, sampled, rays, lanes, front);
        let bits = lanes.to_bitmask();
        let color = self.unlit_color(simd, at, &entry, entered, bits);
        let (mut gradient, mut magnitude, mut factor) = (Vec3x8::splat(simd, Vec3::ZERO), one, one);
        if self.lit || self.gradient_opacity {
            gradient = self.world_gradient(simd, at, &entry, entered, bits);
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
        if scene.light.two_sided {
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
        (
            self.light(simd, normal, confidence, rays.half, color),
            factor,
            cut,
        )
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
            None if at.with_gradients && !entered.any_true() => at.color,
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
        if !scene.light.two_sided {
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
            let back = self.sample_points_apart(simd, &(sampled - direction * way), &undecided);
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
        normal: Vec3x8<S>,
        confidence: f32x8<S>,
        half: Vec3x8<S>,
        color: Vec3x8<S>,
    ) -> Vec3x8<S> {
        let light = &self.scene.light;
        let to_light = Vec3x8::splat(simd, self.scene.frame.to_light);
        let even = light.ambient + ISOTROPIC_DIFFUSE * light.diffuse;
        let (diffuse, highlight) = light.blinn_phong().shine(normal.dot(to_light), normal.dot(half));
        Vec3x8 {
            x: lit(color.x, even, diffuse, highlight, confidence),
            y: lit(color.y, even, diffuse, highlight, confidence),
            z: lit(color.z, even, diffuse, highlight, confidence),
        }
    }

    /// Where rays enter material within their last step, by bisection, else the samples themselves;
    /// and which rays do. See [`shading`].
    #[inline(always)]
    fn entry<S: Simd>(
        &self,
        simd: S,
        at: &SamplePacket<S>,
        sampled: Vec3x8<S>,
        rays: ShadingRays<S>,
        lanes: mask32x8<S>,
        front: &PreviousSamples<S>,
    ) -> (SurfaceEntries<S>, mask32x8<S>) {
        let enough = at.depth * 0.5;
        let mut first = SurfaceEntries {
            deformed: sampled,
            in_voxel: at.in_voxel,
            value: at.value,
            inside: at.inside,
        };
        let mut enters = lanes & front.sampled & !(front.present & front.depth.simd_ge(enough));
        let unknown = lanes & !front.sampled;
        if unknown.any_true() {
            let before = self.sample_points_apart(simd, &front.point, &unknown);
            enters |= unknown & !(before.present & before.depth.simd_ge(enough));
        }
        if enters.any_true() {
            let mut width = rays.step;
            for _ in 0..ENTRY_STEPS {
                width *= 0.5;
                let p = first.deformed - rays.direction * width;
                let midway = self.sample_points(simd, p, enters, false);
                let dense = enters & midway.present & midway.depth.simd_ge(enough);
                first = SurfaceEntries {
                    deformed: Vec3x8::select(dense, p, first.deformed),
                    in_voxel: Vec3x8::select(dense, midway.in_voxel, first.in_voxel),
                    value: dense.select(midway.value, first.value),
                    inside: first.inside | (dense & midway.inside),
                };
            }
        }
        (first, enters)
    }
}

/// Directions of eight rays, half vectors between the light and the eye, and distances between
/// samples, mm.
#[derive(Clone, Copy)]
pub(super) struct ShadingRays<S: Simd> {
    pub(super) direction: Vec3x8<S>,
    pub(super) half: Vec3x8<S>,
    pub(super) step: f32x8<S>,
}

/// The points one step in front of eight samples.
pub(super) struct PreviousSamples<S: Simd> {
    /// Their positions.
    pub(super) point: Vec3x8<S>,
    /// Which of them have been sampled.
    pub(super) sampled: mask32x8<S>,
    pub(super) present: mask32x8<S>,
    pub(super) depth: f32x8<S>,
}

/// Where eight rays enter the material.
#[derive(Clone, Copy)]
struct SurfaceEntries<S: Simd> {
    pub(super) deformed: Vec3x8<S>,
    pub(super) in_voxel: Vec3x8<S>,
    pub(super) value: f32x8<S>,
    pub(super) inside: mask32x8<S>,
}

/// The result of shading a sample next to a cut.
pub(super) enum ScalarSample {
    Nothing,
    /// A surface that hides everything behind it.
    Opaque(Vec3),
    /// Its colour and optical depth per reference length.
    Visible(Vec3, f32),
}
