//! Samples that have something to shade, and their shading: what slices and rays share of a sample
//! once it is known to be visible. How samples are found, and in which order they are composited,
//! is up to each renderer ([`super::march`], [`super::slices`]).

use super::packet::{PacketSampler, SamplePacket};
use super::packet_shading::{PreviousSamples, ScalarSample, ShadingRays};
use crate::math::lanes::*;

/// Counts how many samples of the packets so far found something to shade. Where few did, gradients
/// are fetched only for those rather than with every value. The picture does not depend on it.
#[derive(Clone, Copy, Debug, Default)]
pub struct FetchPolicy {
    pub(super) lookups: u32,
    pub(super) shaded_lookups: u32,
}

impl FetchPolicy {
    /// Whether it pays to fetch gradients with values: a value alone costs about half as much.
    pub(super) fn fetches_gradients(self) -> bool {
        self.shaded_lookups * 3 >= self.lookups
    }
}

/// A pixel's shift of its samples, in steps, -1/2 .. 1/2: a hash by multiplications and shifts,
/// with the same integers as in `shaders/lib/found.wgsl`.
pub(super) fn pixel_shift(x: u32, y: u32) -> f32 {
    let mut h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77);
    h = (h ^ (h >> 16)).wrapping_mul(0x7FEB_352D);
    h = (h ^ (h >> 15)).wrapping_mul(0x846C_A68B);
    h ^= h >> 16;
    (h >> 8) as f32 / 16_777_216.0 - 0.5
}

/// Samples that have something to shade.
pub(super) struct FoundSamples<S: Simd> {
    /// Rays that have found one.
    pub(super) lanes: mask32x8<S>,
    pub(super) sample: SamplePacket<S>,
    /// Their positions in the deformed scene.
    pub(super) deformed: Vec3x8<S>,
    /// The fraction of their step that they represent.
    pub(super) share: f32x8<S>,
    /// Which are near a cut shape.
    pub(super) near_cut: mask32x8<S>,
    pub(super) previous: PreviousSamples<S>,
}

impl<S: Simd> FoundSamples<S> {
    /// No sample yet; `anywhere` fills the lanes that have none.
    #[inline(always)]
    pub(super) fn nothing(simd: S, anywhere: Vec3x8<S>, with_gradients: bool) -> Self {
        let (zero, one) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 1.0));
        let none = zero.simd_gt(one);
        let sample = SamplePacket {
            in_voxel: anywhere,
            value: zero,
            present: none,
            alpha: one,
            depth: zero,
            front: zero,
            inside: none,
            cut_free: none,
            differences: anywhere,
            color: anywhere,
            with_gradients,
        };
        let previous = PreviousSamples {
            point: anywhere,
            sampled: none,
            present: none,
            depth: zero,
        };
        Self {
            lanes: none,
            sample,
            deformed: anywhere,
            share: one,
            near_cut: none,
            previous,
        }
    }

    /// Stores the samples of some lanes.
    #[inline(always)]
    pub(super) fn insert(
        &mut self,
        hit: mask32x8<S>,
        new: &SamplePacket<S>,
        deformed: Vec3x8<S>,
        share: f32x8<S>,
        near_cut: mask32x8<S>,
        previous: &PreviousSamples<S>,
    ) {
        let at = &mut self.sample;
        if self.lanes.all_false() {
            // Other lanes need no preservation. Fields are assigned one by one: a call that copies
            // the whole would save all registers around it.
            (at.in_voxel, at.value, at.differences, at.color) =
                (new.in_voxel, new.value, new.differences, new.color);
            (at.depth, at.front, at.alpha) = (new.depth, new.front, new.alpha);
            (at.present, at.inside, at.cut_free) = (new.present, new.inside, new.cut_free);
            (self.deformed, self.share, self.near_cut, self.lanes) = (deformed, share, hit & near_cut, hit);
            self.previous.point = previous.point;
            self.previous.sampled = hit & previous.sampled;
            self.previous.present = hit & previous.present;
            self.previous.depth = previous.depth;
        } else if hit.any_true() {
            at.in_voxel = Vec3x8::select(hit, new.in_voxel, at.in_voxel);
            at.value = hit.select(new.value, at.value);
            at.present = (hit & new.present) | (at.present & !hit);
            at.alpha = hit.select(new.alpha, at.alpha);
            at.depth = hit.select(new.depth, at.depth);
            at.front = hit.select(new.front, at.front);
            at.inside = (hit & new.inside) | (at.inside & !hit);
            at.cut_free = (hit & new.cut_free) | (at.cut_free & !hit);
            at.differences = Vec3x8::select(hit, new.differences, at.differences);
            at.color = Vec3x8::select(hit, new.color, at.color);
            self.deformed = Vec3x8::select(hit, deformed, self.deformed);
            self.share = hit.select(share, self.share);
            self.near_cut |= hit & near_cut;
            self.previous.point = Vec3x8::select(hit, previous.point, self.previous.point);
            self.previous.sampled |= hit & previous.sampled;
            self.previous.present |= hit & previous.present;
            self.previous.depth = hit.select(previous.depth, self.previous.depth);
            self.lanes |= hit;
        }
    }
}

/// Eight samples after lighting.
pub(super) struct ShadedSamples<S: Simd> {
    /// Lit colours, not premultiplied.
    pub(super) color: Vec3x8<S>,
    /// Optical depths per reference length, including the fraction of the step.
    pub(super) depth: f32x8<S>,
    /// Which show anything.
    pub(super) visible: mask32x8<S>,
    /// Which hide everything behind them.
    pub(super) opaque: mask32x8<S>,
}

impl<S: Simd> ShadedSamples<S> {
    /// The transmittance of each sample over `length` reference lengths: the opacity correction.
    #[inline(always)]
    pub(super) fn transmittance(&self, simd: S, length: f32x8<S>) -> f32x8<S> {
        self.opaque
            .select(f32x8::splat(simd, 0.0), exp2(-(self.depth * length)))
    }
}

impl PacketSampler<'_> {
    /// Which samples have something to shade: those that are visible, and those that may lie at the
    /// face of a cut.
    #[inline(always)]
    pub(super) fn to_be_shaded<S: Simd>(
        &self,
        sample: &SamplePacket<S>,
        lanes: mask32x8<S>,
        near_cut: mask32x8<S>,
    ) -> mask32x8<S> {
        let mut hit = lanes
            & match self.scene.volume().iso {
                Some(iso) => sample.present & sample.value.simd_ge(iso),
                None => sample.depth.simd_gt(0.0) | (sample.alpha.simd_gt(0.0) & sample.alpha.simd_lt(1.0)),
            };
        if self.grey_faces {
            hit |= lanes & sample.present & (sample.alpha.simd_lt(1.0) | near_cut);
        }
        hit
    }

    /// Depths of the segments between eight samples and the previous ones, where the transfer
    /// function is pre-integrated.
    #[inline(always)]
    pub(super) fn look_up_segments<S: Simd>(
        &self,
        simd: S,
        sample: &mut SamplePacket<S>,
        lanes: mask32x8<S>,
        previous: &PreviousSamples<S>,
        last_value: f32x8<S>,
    ) {
        let Some(table) = &self.preintegrated else { return };
        sample.front = (previous.sampled & previous.present).select(last_value, sample.value);
        let unknown = lanes & sample.present & !previous.sampled;
        if unknown.any_true() {
            let earlier = self.sample_points_apart(simd, &previous.point, &unknown);
            sample.front = earlier.present.select(earlier.value, sample.front);
        }
        for n in lanes_of((lanes & sample.present).to_bitmask()) {
            sample.depth[n] = self.segment(table, sample.front[n], sample.value[n])[3];
        }
    }

    /// Shades the samples found. Not inlined: one copy for slices and rays, and functions small
    /// enough for the compiler.
    #[inline(never)]
    pub(super) fn shade_found<S: Simd>(
        &self,
        simd: S,
        rays: &ShadingRays<S>,
        found: &FoundSamples<S>,
        fetch_policy: &mut FetchPolicy,
    ) -> ShadedSamples<S> {
        simd.vectorize(
            #[inline(always)]
            || {
                let FoundSamples {
                    lanes,
                    sample,
                    deformed,
                    share,
                    ..
                } = found;
                let zero = f32x8::splat(simd, 0.0);
                let mut visible = *lanes & sample.depth.simd_gt(0.0);
                let mut opaque = *lanes & !*lanes;
                let (mut color, mut depth) = (*deformed, zero);
                let mut scalar_lanes = self.scalar_lanes(simd, *rays, found, visible);
                let packet_lanes = visible & !scalar_lanes;
                if packet_lanes.any_true() {
                    fetch_policy.shaded_lookups += 1;
                    let (shaded, factor, cut) =
                        self.shade(simd, sample, *deformed, *rays, packet_lanes, &found.previous);
                    color = shaded;
                    depth = sample.depth * factor * *share;
                    scalar_lanes |= cut;
                }
                let scalar_lanes = scalar_lanes & *lanes;
                if scalar_lanes.any_true() {
                    // Copies, since indexing by a variable keeps the indexed structure out of registers.
                    let (sample, deformed, share) = (found.sample, found.deformed, found.share);
                    let (direction, step) = (rays.direction, rays.step);
                    for n in lanes_of(scalar_lanes.to_bitmask()) {
                        let (lane, front) = (sample.lane(n), sample.front[n]);
                        match self.shade_scalar(lane, front, deformed.lane(n), direction.lane(n), step[n]) {
                            ScalarSample::Nothing => visible.set(n, false),
                            ScalarSample::Opaque(of_face) => {
                                opaque.set(n, true);
                                color.set(n, of_face);
                                visible.set(n, true);
                            }
                            ScalarSample::Visible(of_sample, depth_of_sample) => {
                                visible.set(n, true);
                                color.set(n, of_sample);
                                depth[n] = depth_of_sample * share[n];
                            }
                        }
                    }
                }
                ShadedSamples {
                    color,
                    depth,
                    visible,
                    opaque,
                }
            },
        )
    }

    /// Which of the samples found are shaded one by one: those near a cut, and those at which
    /// material ends.
    #[inline(always)]
    fn scalar_lanes<S: Simd>(
        &self,
        simd: S,
        rays: ShadingRays<S>,
        found: &FoundSamples<S>,
        visible: mask32x8<S>,
    ) -> mask32x8<S> {
        let FoundSamples {
            lanes,
            sample,
            previous,
            ..
        } = found;
        if self.grey_faces || self.scene.volume().iso.is_some() {
            return *lanes;
        }
        let mut scalar_lanes = found.near_cut & *lanes;
        // Faces of the volume farther than a step away change only the normal, unless there are
        // holes.
        let near_face = *lanes
            & !sample.inside
            & !self.far_from_faces(sample.in_voxel, Vec3x8::splat(simd, self.face_margin_voxels));
        if near_face.any_true() {
            let near = if self.scene.volume().grid.has_holes {
                f32x8::splat(simd, self.margin_mm)
            } else {
                rays.step * 1.1
            };
            scalar_lanes |= near_face & self.nearest_face(simd, sample.in_voxel).0.simd_lt(near);
        }
        // Material that ends between the previous sample and this one, both invisible: only one of
        // the two is present then.
        let both = (previous.present & sample.present) | !(previous.present | sample.present);
        scalar_lanes | (*lanes & !visible & !(previous.sampled & (both | previous.depth.simd_gt(0.0))))
    }
}
