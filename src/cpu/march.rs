//! Marches packets of eight rays, four across and two down.
//!
//! *Theory*: neighbouring rays sample nearly the same places, hence eight of them share every
//! instruction, one lane each ([`crate::math::lanes`]). As in `shaders/lib/composite.wgsl` there
//! are two loops. The lanes sample until each has found something to shade or has ended (in
//! semi-transparent regions, until half of them have); then those that have found something shade
//! together. A ray waits while its neighbours sample, never while they shade.
//!
//! Most samples are *plain*: they are farther from every cut than the distance at which a cut
//! affects lighting. Near a face of the volume's own box, they are farther than the distance at
//! which the face affects anything but normals. For these the lanes compute what [`super::shading`]
//! computes for one sample, without the parts known to have no effect. The remaining samples, next
//! to a cut, are passed to it one by one; there are few, since a cut is a surface.
//!
//! *Work avoided*: the point in front of a sample has usually just been sampled, hence it is known
//! without another sample whether the ray enters the material here. The distance to the cut shapes
//! changes no faster than the point moves, hence it is bounded between two evaluations. The
//! Jacobian is the identity outside all maps.

use super::found::{FetchPolicy, FoundSamples, ShadedSamples};
use super::packet::PacketSampler;
use super::packet_shading::{PreviousSamples, ShadingRays};
use super::{IntensityProjection, MIN_TRANSMITTANCE};
use crate::math::lanes::*;
use crate::picture::RenderStats;
use glam::{Mat3, Vec3};

/// A packet of eight rays.
#[derive(Clone, Copy)]
pub struct RayPacket<S: Simd> {
    /// Origins.
    pub origin: Vec3x8<S>,
    /// Unit directions.
    pub direction: Vec3x8<S>,
    /// Distance at which something opaque ends them, mm; negative for an unused ray.
    pub until: f32x8<S>,
}

/// How many steps ahead of a sample its texels are prefetched: one step would be too late.
const PREFETCH_STEPS: f32 = 2.0;

/// Index of the first sample at or after `t`, for eight rays.
#[inline(always)]
fn first_sample_after<S: Simd>(t: f32x8<S>, step: f32x8<S>) -> f32x8<S> {
    (t / step - 0.5).ceil().max(0.0)
}

#[inline(always)]
fn count<S: Simd>(mask: mask32x8<S>) -> u64 {
    u64::from(mask.to_bitmask().count_ones())
}

#[inline(always)]
fn sum<S: Simd>(v: f32x8<S>) -> u64 {
    v.as_slice().iter().sum::<f32>() as u64
}

impl PacketSampler<'_> {
    /// Marches through the volume along eight rays; returns premultiplied colours.
    #[inline(always)]
    pub fn march<S: Simd>(
        &self,
        simd: S,
        rays: RayPacket<S>,
        stats: &mut RenderStats,
        fetch_policy: &mut FetchPolicy,
    ) -> [[f32; 4]; LANES] {
        let Some((rays, mut way)) = self.begin(simd, rays, fetch_policy) else {
            return [[0.0; 4]; LANES];
        };
        let mut accumulated = Accumulated {
            color: Vec3x8::splat(simd, Vec3::ZERO),
            transmittance: f32x8::splat(simd, 1.0),
            projection: IntensityProjection::new(simd, self.scene.volume().blend),
        };
        while way.live.any_true() {
            let found = self.collect(simd, &rays, &mut way, &mut accumulated, stats, fetch_policy);
            if found.lanes.all_false() {
                break;
            }
            self.composite_found(simd, &rays, &found, &mut way, &mut accumulated, fetch_policy);
        }
        stats.samples_skipped += sum(way.skipped);
        stats.samples_terminated += sum(way.terminated);
        let Accumulated {
            color,
            transmittance,
            projection,
        } = accumulated;
        let mut colors = [[0.0; 4]; LANES];
        for (n, color_of) in colors.iter_mut().enumerate() {
            *color_of = if self.composite {
                [color.x[n], color.y[n], color.z[n], 1.0 - transmittance[n]]
            } else {
                projection.color(self.scene, n)
            };
        }
        colors
    }

    /// Where rays enter and leave the visible region; none if no ray does.
    #[inline(always)]
    fn begin<S: Simd>(
        &self,
        simd: S,
        rays: RayPacket<S>,
        fetch_policy: &FetchPolicy,
    ) -> Option<(MarchRays<S>, March<S>)> {
        let scene = self.scene;
        let frame = &scene.frame;
        let zero = f32x8::splat(simd, 0.0);
        let RayPacket {
            origin,
            direction,
            until,
        } = rays;
        let one = f32x8::splat(simd, 1.0);
        let inverse_direction = Vec3x8 {
            x: one / direction.x,
            y: one / direction.y,
            z: one / direction.z,
        };
        let step = f32x8::splat(simd, frame.spacing.step_mm);
        let (near, far) = frame.proxy.intersect_rays(simd, origin, inverse_direction);
        let number = first_sample_after(near, step);
        let end = first_sample_after(far.min(until), step);
        let live = near.simd_le(far) & until.simd_ge(0.0) & number.simd_lt(end);
        if live.all_false() {
            return None;
        }
        let none = number.simd_lt(-1.0);
        let never = f32x8::splat(simd, f32::NEG_INFINITY);
        let rays = MarchRays {
            origin,
            direction,
            inverse_direction,
            half: (Vec3x8::splat(simd, frame.to_light) - direction).normalized(),
            step,
            length: step * frame.spacing.reference_mm.recip(),
            end,
            with_gradients: self.sampler.has_gradients() && fetch_policy.fetches_gradients(),
            ahead: direction.mapped(&Mat3::from(scene.volume().voxel_from_world.matrix3))
                * (step * PREFETCH_STEPS),
            none,
        };
        let march = March {
            number,
            live,
            last: LastSamples {
                number: f32x8::splat(simd, NO_SAMPLE),
                present: none,
                depth: zero,
                value: zero,
            },
            cut_distance_t: never,
            cut_distance_mm: f32x8::splat(simd, -1.0),
            cut_free: none,
            cut_free_until: never,
            skipped: zero,
            terminated: zero,
        };
        Some((rays, march))
    }

    /// Advances the lanes in empty cells until every lane has something to sample: a sample costs
    /// as much for one lane as for eight. Returns the samples' distances along the rays, mm, and
    /// their positions in the world. Lanes that have left the visible region stop searching.
    #[inline(always)]
    fn advance_through_empty_space<S: Simd>(
        &self,
        simd: S,
        rays: &MarchRays<S>,
        way: &mut March<S>,
        searching: &mut mask32x8<S>,
    ) -> (f32x8<S>, Vec3x8<S>) {
        loop {
            let t = (way.number + 0.5) * rays.step;
            let p = rays.origin + rays.direction * t;
            if (*searching & !t.simd_lt(way.cut_free_until)).all_false() {
                return (t, p);
            }
            let (empty, in_cut_free, exit) =
                self.scene
                    .volume()
                    .macrocells
                    .blocks_lanes(simd, p, rays.origin, rays.inverse_direction);
            way.cut_free = in_cut_free;
            way.cut_free_until = in_cut_free.select(exit, f32x8::splat(simd, f32::NEG_INFINITY));
            let empty = empty & *searching;
            if empty.all_false() {
                return (t, p);
            }
            let next = first_sample_after(exit, rays.step)
                .max(way.number + 1.0)
                .min(rays.end);
            way.skipped += empty.select(next - way.number, f32x8::splat(simd, 0.0));
            way.number = empty.select(next, way.number);
            *searching &= way.number.simd_lt(rays.end);
        }
    }

    /// What the cut shapes leave of the steps of eight samples: which lanes have anything left, the
    /// fraction of their step, and which are near a shape. The samples move to the middle of the
    /// retained part.
    #[inline(always)]
    fn retain<S: Simd>(
        &self,
        simd: S,
        rays: &MarchRays<S>,
        way: &mut March<S>,
        lanes: mask32x8<S>,
        t: f32x8<S>,
        p: &mut Vec3x8<S>,
    ) -> (mask32x8<S>, f32x8<S>, mask32x8<S>) {
        let cuts = &self.scene.cuts;
        let mut share = f32x8::splat(simd, 1.0);
        // Copies, since indexing by a variable keeps the indexed structure out of registers.
        let (mut evaluated_at, mut distance_mm) = (way.cut_distance_t, way.cut_distance_mm);
        // The distance is bounded by how far the ray has moved since; evaluate it only where the
        // bound does not decide.
        let certain_mm = distance_mm.abs() - (t - evaluated_at).abs();
        let unsure = lanes & !certain_mm.simd_gt(rays.step * 0.5);
        for n in lanes_of(unsure.to_bitmask()) {
            let (o, d, t) = (rays.origin.lane(n), rays.direction.lane(n), t[n]);
            evaluated_at[n] = t;
            distance_mm[n] = cuts.signed_distance_mm(o + d * t);
            if distance_mm[n].abs() <= 0.5 * rays.step[n] {
                let retained = cuts.retained_part(o, d, t, rays.step[n]);
                share[n] = retained.share;
                p.set(n, o + d * retained.at);
            }
        }
        let certain_mm = distance_mm.abs() - (t - evaluated_at).abs();
        let whole = certain_mm.simd_gt(rays.step * 0.5);
        share = (whole & distance_mm.simd_lt(0.0)).select(f32x8::splat(simd, 0.0), share);
        let left = lanes & share.simd_gt(0.0);
        let mut near_cut = left & !(certain_mm.simd_gt(self.margin_mm) & distance_mm.simd_gt(0.0));
        // Evaluated again where the bound does not decide: a sample must not depend on where the
        // distance was evaluated before.
        for n in lanes_of(near_cut.to_bitmask()) {
            evaluated_at[n] = t[n];
            distance_mm[n] = cuts.signed_distance_mm(rays.origin.lane(n) + rays.direction.lane(n) * t[n]);
            near_cut.set(n, distance_mm[n] <= self.margin_mm);
        }
        (way.cut_distance_t, way.cut_distance_mm) = (evaluated_at, distance_mm);
        (left, share, near_cut)
    }

    /// Samples along the rays until each has found something to shade or has ended, or, where most
    /// samples are visible, until half of them have.
    #[inline(always)]
    fn collect<S: Simd>(
        &self,
        simd: S,
        rays: &MarchRays<S>,
        way: &mut March<S>,
        accumulated: &mut Accumulated<S>,
        stats: &mut RenderStats,
        fetch_policy: &mut FetchPolicy,
    ) -> FoundSamples<S> {
        let (origin, direction, step) = (rays.origin, rays.direction, rays.step);
        let no_sample = f32x8::splat(simd, NO_SAMPLE);
        let mut found = FoundSamples::nothing(simd, origin, rays.with_gradients);
        let mut searching = way.live;
        while searching.any_true() {
            let (t, mut p) = self.advance_through_empty_space(simd, rays, way, &mut searching);
            let here = searching;
            if here.all_false() {
                break;
            }
            stats.samples_taken += count(here);
            let number = way.number;
            way.number = here.select(number + 1.0, number);
            searching &= way.number.simd_lt(rays.end);
            let (mut lanes, mut share, mut near_cut) = (here, f32x8::splat(simd, 1.0), rays.none);
            if !self.scene.cuts.is_empty() {
                (lanes, share, near_cut) = self.retain(simd, rays, way, here, t, &mut p);
                if lanes.all_false() {
                    way.last.number = here.select(no_sample, way.last.number);
                    continue;
                }
            }
            fetch_policy.lookups += 1;
            let mut sample = self.sample_points(simd, p, lanes, rays.with_gradients);
            sample.cut_free = way.cut_free;
            if rays.with_gradients {
                self.sampler.prefetch(sample.in_voxel + rays.ahead);
            }
            if !self.composite {
                accumulated.projection.insert(sample.value, sample.present);
                continue;
            }
            let whole = share.simd_eq(1.0);
            let previous = PreviousSamples {
                // The same point, bit for bit, whether or not it was sampled.
                point: Vec3x8::select(
                    whole,
                    origin + direction * ((number - 0.5) * step),
                    p - direction * step,
                ),
                sampled: lanes & way.last.number.simd_eq(number - 1.0) & whole,
                present: way.last.present,
                depth: way.last.depth,
            };
            let own_depth = sample.depth;
            self.look_up_segments(simd, &mut sample, lanes, &previous, way.last.value);
            let hit = self.to_be_shaded(&sample, lanes, near_cut);
            found.insert(hit, &sample, p, share, near_cut, &previous);
            searching &= !hit;
            way.last.number = here.select((lanes & whole).select(number, no_sample), way.last.number);
            way.last.present = (here & sample.present) | (way.last.present & !here);
            way.last.depth = here.select(own_depth, way.last.depth);
            way.last.value = here.select(sample.value, way.last.value);
            // Does not wait for the others where they mostly have something to shade too: a sample
            // for a few lanes costs as much as one for all.
            if rays.with_gradients && count(found.lanes) >= LANES as u64 / 2 {
                break;
            }
        }
        found
    }

    /// Shades the samples found and composites them behind the accumulated colour; rays that have
    /// become opaque end.
    #[inline(always)]
    fn composite_found<S: Simd>(
        &self,
        simd: S,
        rays: &MarchRays<S>,
        found: &FoundSamples<S>,
        way: &mut March<S>,
        accumulated: &mut Accumulated<S>,
        fetch_policy: &mut FetchPolicy,
    ) {
        let shading_rays = ShadingRays {
            direction: rays.direction,
            half: rays.half,
            step: rays.step,
        };
        let shaded = self.shade_found(simd, &shading_rays, found, fetch_policy);
        let ShadedSamples {
            color,
            visible,
            opaque,
            ..
        } = shaded;
        let one = f32x8::splat(simd, 1.0);
        let pass = shaded.transmittance(simd, rays.length);
        let zero = f32x8::splat(simd, 0.0);
        let weight = visible.select(accumulated.transmittance * (one - pass), zero);
        accumulated.color = accumulated.color + Vec3x8::select(visible, color, accumulated.color) * weight;
        accumulated.transmittance =
            visible.select(accumulated.transmittance * pass, accumulated.transmittance);
        let mut through = opaque;
        if self.scene.settings.early_termination {
            through |= visible & accumulated.transmittance.simd_lt(MIN_TRANSMITTANCE);
        }
        let through = through & way.live;
        way.terminated += through.select((rays.end - way.number).max(0.0), zero);
        way.live &= !through & way.number.simd_lt(rays.end);
    }
}

/// Index that stands for no sample.
const NO_SAMPLE: f32 = -2.0;

/// Constants of eight rays.
struct MarchRays<S: Simd> {
    origin: Vec3x8<S>,
    direction: Vec3x8<S>,
    inverse_direction: Vec3x8<S>,
    /// Half vectors between the light and the eye.
    half: Vec3x8<S>,
    /// Distance between samples, mm.
    step: f32x8<S>,
    /// The same in reference lengths.
    length: f32x8<S>,
    /// Index after the last sample.
    end: f32x8<S>,
    /// Whether gradients are fetched together with values.
    with_gradients: bool,
    /// Offset from a sample to the point to prefetch, voxels.
    ahead: Vec3x8<S>,
    /// No lane.
    none: mask32x8<S>,
}

/// State of eight rays.
struct March<S: Simd> {
    /// Index of the next sample.
    number: f32x8<S>,
    /// Rays that have not ended.
    live: mask32x8<S>,
    last: LastSamples<S>,
    /// Where the distance to the cut shapes was last evaluated, mm, and its value there.
    cut_distance_t: f32x8<S>,
    cut_distance_mm: f32x8<S>,
    /// Which rays are in macrocells without cuts, and up to which distance.
    cut_free: mask32x8<S>,
    cut_free_until: f32x8<S>,
    /// Numbers of samples skipped.
    skipped: f32x8<S>,
    terminated: f32x8<S>,
}

/// The last sample taken on each ray.
struct LastSamples<S: Simd> {
    /// Its index, if it represents its whole step.
    number: f32x8<S>,
    present: mask32x8<S>,
    depth: f32x8<S>,
    value: f32x8<S>,
}

/// The accumulated colour of eight rays, front to back.
struct Accumulated<S: Simd> {
    /// Premultiplied.
    color: Vec3x8<S>,
    transmittance: f32x8<S>,
    projection: IntensityProjection<S>,
}
