//! Samples that have something to shade, and their shading: what slices and rays share of a sample
//! once it is known to be visible. How samples are found, and in which order they are composited,
//! is up to each renderer ([`super::march`], [`super::slices`]).

use super::edges::{FoundSamples, Neighbours, SampleExtents, ShadingRays};
use super::packet::{PacketSampler, SamplePacket};
use super::packet_shading::{ScalarInput, ScalarSample};
use crate::math::lanes::*;
use glam::Vec3;

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
    /// grey face of a cut.
    #[inline(always)]
    pub(super) fn to_be_shaded<S: Simd>(
        &self,
        sample: &SamplePacket<S>,
        lanes: mask32x8<S>,
        near_cut: mask32x8<S>,
    ) -> mask32x8<S> {
        let mut hit = lanes & self.is_visible(sample);
        if self.grey_faces {
            hit |= lanes & sample.present & (sample.alpha.simd_lt(1.0) | near_cut);
        }
        hit
    }

    /// Depths of the segments between eight samples and the previous ones, where the transfer
    /// function is pre-integrated. Previous samples that are not known are taken, at `point`.
    #[inline(always)]
    pub(super) fn look_up_segments<S: Simd>(
        &self,
        simd: S,
        sample: &mut SamplePacket<S>,
        lanes: mask32x8<S>,
        near_cut: mask32x8<S>,
        previous: &mut Neighbours<S>,
        point: Vec3x8<S>,
    ) {
        let Some(table) = &self.preintegrated else { return };
        let unknown = lanes & sample.present & !previous.sampled;
        if unknown.any_true() {
            previous.insert(unknown, &self.neighbours(simd, point, unknown, near_cut).0);
        }
        sample.front = (previous.sampled & previous.present).select(previous.value, sample.value);
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
        found: &mut FoundSamples<S>,
        fetch_policy: &mut FetchPolicy,
    ) -> ShadedSamples<S> {
        if found.thin.any_true() {
            self.find_thin_layers(simd, rays, found);
        }
        let found = &*found;
        simd.vectorize(
            #[inline(always)]
            || {
                let mut visible = found.lanes & found.sample.depth.simd_gt(0.0);
                // Iso-surfaces are found by a bisection of their own.
                let represented = if self.scene.volume().iso.is_some() {
                    visible & !visible
                } else {
                    visible
                };
                let mut extents = self.extents(simd, rays, found, represented);
                if self.cubic {
                    self.apply_cubic_filter(simd, &mut extents, represented);
                }
                let FoundSamples {
                    lanes,
                    sample,
                    deformed,
                    spacing,
                    ..
                } = found;
                let zero = f32x8::splat(simd, 0.0);
                let mut opaque = *lanes & !*lanes;
                let (mut color, mut depth) = (*deformed, zero);
                let mut scalar_lanes = self.scalar_lanes(simd, *rays, found);
                let packet_lanes = visible & !scalar_lanes;
                if packet_lanes.any_true() {
                    fetch_policy.shaded_lookups += 1;
                    let (shaded, factor, cut) = self.shade(simd, found, *rays, packet_lanes, &extents);
                    color = shaded;
                    depth = (sample.depth - found.floor) * factor * extents.share;
                    scalar_lanes |= cut;
                }
                let scalar_lanes = scalar_lanes & *lanes;
                if scalar_lanes.any_true() {
                    // Copies, since indexing by a variable keeps the indexed structure out of registers.
                    let (sample, deformed, spacing) = (*sample, *deformed, *spacing);
                    let (direction, extents) = (rays.direction, &extents);
                    for n in lanes_of(scalar_lanes.to_bitmask()) {
                        let (at, own_depth) = sample.lane(n);
                        let entry = &extents.entry;
                        let input = ScalarInput {
                            at,
                            depth: own_depth,
                            front: sample.front[n],
                            segment: self.preintegrated.is_some() && !found.thin.test(n),
                            deformed: deformed.lane(n),
                            entry: (entry.deformed.lane(n), entry.in_voxel.lane(n), entry.value[n]),
                            entered: extents.entered.test(n).then(|| extents.through_cut.test(n)),
                            gradient: extents.gradient.as_ref().map(|g| g.lane(n)),
                            spacing: spacing[n],
                        };
                        match self.shade_scalar(&input, direction.lane(n)) {
                            ScalarSample::Nothing => visible.set(n, false),
                            ScalarSample::Opaque(of_face) => {
                                opaque.set(n, true);
                                color.set(n, of_face);
                                visible.set(n, true);
                            }
                            ScalarSample::Visible(of_sample, factor) => {
                                visible.set(n, true);
                                color.set(n, of_sample);
                                depth[n] = (own_depth - found.floor[n]) * factor * extents.share[n];
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

    /// Replaces the values where samples are shaded by those of cubic splines, with their gradients.
    /// Visibility and optical depth are those of trilinear samples.
    #[inline(always)]
    fn apply_cubic_filter<S: Simd>(&self, simd: S, extents: &mut SampleExtents<S>, visible: mask32x8<S>) {
        let mut gradient = Vec3x8::splat(simd, Vec3::ZERO);
        for n in lanes_of(visible.to_bitmask()) {
            let (value, slope) = self.sampler.sample_cubic(extents.entry.in_voxel.lane(n));
            extents.entry.value[n] = value;
            gradient.set(n, slope);
        }
        extents.gradient = Some(gradient);
    }

    /// Which of the samples found are shaded one by one: those near a cut or a face of the volume,
    /// and thin layers there.
    #[inline(always)]
    fn scalar_lanes<S: Simd>(&self, simd: S, rays: ShadingRays<S>, found: &FoundSamples<S>) -> mask32x8<S> {
        let FoundSamples { lanes, sample, .. } = found;
        if self.grey_faces || self.scene.volume().iso.is_some() {
            return *lanes;
        }
        let mut scalar_lanes = (found.near_cut | found.thin) & *lanes;
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
        scalar_lanes
    }
}
