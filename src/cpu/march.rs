//! Marches packets of eight rays, four across and two down.
//!
//! *Theory*: neighbouring rays sample nearly the same places, hence eight of them share every
//! instruction, one lane each ([`crate::math::lanes`]). As in `shaders/lib/composite.wgsl` there
//! are two loops. The lanes sample until each has found something to shade or has ended (in
//! semi-transparent regions, until half of them have); then those that have found something shade
//! together. A ray waits while its neighbours sample, never while they shade.
//!
//! A visible sample is shaded when the next one is known, since what it represents depends on both
//! of its neighbours (`edges.rs`). A neighbour in an empty cell is known to show nothing.
//!
//! Most samples are *plain*: they are farther from every cut than the distance at which a cut
//! affects lighting. Near a face of the volume's own box, they are farther than the distance at
//! which the face affects anything but normals. For these the lanes compute what [`super::shading`]
//! computes for one sample, without the parts known to have no effect. The remaining samples, next
//! to a cut, are passed to it one by one; there are few, since a cut is a surface.
//!
//! *Work avoided*: the distance to the cut shapes changes no faster than the point moves, hence it
//! is bounded between two evaluations. The Jacobian is the identity outside all maps.

use super::edges::{FoundSamples, Neighbours, NewSamples, ShadingRays};
use super::found::{FetchPolicy, ShadedSamples};
use super::packet::{PacketSampler, SamplePacket};
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
        while way.live.any_true() {
            let mut found = self.collect(simd, &rays, &mut way, stats, fetch_policy);
            if found.lanes.all_false() {
                break;
            }
            self.composite_found(simd, &rays, &mut found, &mut way, fetch_policy);
        }
        stats.samples_skipped += sum(way.skipped);
        stats.samples_terminated += sum(way.terminated);
        let March {
            color,
            transmittance,
            projection,
            ..
        } = way;
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
        let mostly_visible = fetch_policy.fetches_gradients();
        let with_gradients = self.sampler.has_gradients() && mostly_visible;
        let rays = MarchRays {
            mostly_visible,
            origin,
            direction,
            inverse_direction,
            half: (Vec3x8::splat(simd, frame.to_light) - direction).normalized(),
            step,
            length: step * frame.spacing.reference_mm.recip(),
            end,
            hidden: until.simd_le((end + 0.5) * step),
            with_gradients,
            ahead: direction.mapped(&Mat3::from(scene.volume().voxel_from_world.matrix3))
                * (step * PREFETCH_STEPS),
            none,
        };
        let march = March {
            number,
            live,
            last: LastSamples {
                number: f32x8::splat(simd, NO_SAMPLE),
                sample: SamplePacket::absent(simd, origin, with_gradients),
                own_depth: zero,
                deformed: origin,
                near_cut: none,
                previous: Neighbours::invisible(simd),
                waiting: none,
                layered: none,
            },
            cut_distance_t: never,
            cut_distance_mm: f32x8::splat(simd, -1.0),
            cut_free: none,
            cut_free_until: never,
            skipped: zero,
            terminated: zero,
            color: Vec3x8::splat(simd, Vec3::ZERO),
            transmittance: f32x8::splat(simd, 1.0),
            projection: IntensityProjection::new(simd, scene.volume().blend),
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

    /// Which of eight samples the cut shapes remove, and which are near a shape.
    #[inline(always)]
    fn cut_by_shapes<S: Simd>(
        &self,
        way: &mut March<S>,
        lanes: mask32x8<S>,
        t: f32x8<S>,
        p: Vec3x8<S>,
    ) -> (mask32x8<S>, mask32x8<S>) {
        // Copies, since indexing by a variable keeps the indexed structure out of registers.
        let (mut evaluated_at, mut distance_mm) = (way.cut_distance_t, way.cut_distance_mm);
        // The distance is bounded by how far the ray has moved since; it is evaluated only where
        // the bound does not decide.
        let certain_mm = distance_mm.abs() - (t - evaluated_at).abs();
        let unsure = lanes & !certain_mm.simd_gt(self.margin_mm);
        for n in lanes_of(unsure.to_bitmask()) {
            evaluated_at[n] = t[n];
            distance_mm[n] = self.scene.cuts.signed_distance_mm(p.lane(n));
        }
        (way.cut_distance_t, way.cut_distance_mm) = (evaluated_at, distance_mm);
        (
            lanes & distance_mm.simd_lt(0.0),
            unsure & distance_mm.abs().simd_le(self.margin_mm),
        )
    }

    /// Samples along the rays until each has found something to shade or has ended, or, where most
    /// samples are visible, until half of them have.
    #[inline(always)]
    fn collect<S: Simd>(
        &self,
        simd: S,
        rays: &MarchRays<S>,
        way: &mut March<S>,
        stats: &mut RenderStats,
        fetch_policy: &mut FetchPolicy,
    ) -> FoundSamples<S> {
        let mut found = FoundSamples::nothing(simd, rays.origin, rays.step, rays.with_gradients);
        let layered = way.live & way.last.layered;
        if layered.any_true() {
            found.insert_layers(layered, &way.last.with_next(Neighbours::invisible(simd)));
            way.last.layered &= !layered;
        }
        let mut searching = way.live & !layered;
        loop {
            let mut here = searching & way.number.simd_lt(rays.end);
            let (t, p) = self.advance_through_empty_space(simd, rays, way, &mut here);
            // Samples whose next one lies in an empty cell, or past the end of the ray.
            let alone = searching & way.last.waiting & !(here & way.number.simd_eq(way.last.number + 1.0));
            if alone.any_true() {
                found.insert(alone, &way.last.with_next(Neighbours::invisible(simd)));
                found.hidden |= alone & rays.hidden & way.last.number.simd_ge(rays.end - 1.0);
                way.last.waiting &= !alone;
            }
            let here = here & !alone;
            if here.all_false() {
                break;
            }
            stats.samples_taken += count(here);
            fetch_policy.lookups += 1;
            self.sample_step(simd, rays, way, (here, t, p), &mut found);
            searching = here & !found.lanes & (way.number.simd_lt(rays.end) | way.last.waiting);
            // Does not wait for the others where they mostly have something to shade too: a sample
            // for a few lanes costs as much as one for all.
            if rays.mostly_visible && count(found.lanes) >= LANES as u64 / 2 {
                break;
            }
        }
        found
    }

    /// Samples one step of some rays. What is found is the samples before, if they wait for these,
    /// and thin layers between the two.
    #[inline(always)]
    fn sample_step<S: Simd>(
        &self,
        simd: S,
        rays: &MarchRays<S>,
        way: &mut March<S>,
        (here, t, p): (mask32x8<S>, f32x8<S>, Vec3x8<S>),
        found: &mut FoundSamples<S>,
    ) {
        let number = way.number;
        way.number = here.select(number + 1.0, number);
        let (mut removed, mut near_cut) = (rays.none, rays.none);
        if !self.scene.cuts.is_empty() {
            (removed, near_cut) = self.cut_by_shapes(way, here, t, p);
        }
        let lanes = here & !removed;
        let mut sample = if lanes.any_true() {
            self.sample_points(simd, p, lanes, rays.with_gradients)
        } else {
            SamplePacket::absent(simd, p, rays.with_gradients)
        };
        let zero = f32x8::splat(simd, 0.0);
        sample.alpha = removed.select(zero, sample.alpha);
        sample.cut_free = way.cut_free;
        if rays.with_gradients {
            self.sampler.prefetch(sample.in_voxel + rays.ahead);
        }
        if !self.composite {
            way.projection.insert(sample.value, sample.present);
            return;
        }
        let last = &way.last;
        let sampled = here & last.number.simd_eq(number - 1.0);
        let mut previous = Neighbours {
            depth: sampled.select(last.own_depth, zero),
            value: last.sample.value,
            present: sampled & last.sample.present,
            sampled,
        };
        // A neighbour's density is its own, not that of the segment in front of it.
        let as_neighbour = Neighbours {
            depth: sample.depth,
            value: sample.value,
            present: sample.present,
            sampled: here,
        };
        // Behind the eye lies what lies before it.
        let first = here & number.simd_lt(0.5);
        previous.insert(first, &as_neighbour);
        let point = rays.origin + rays.direction * ((number - 0.5) * rays.step);
        self.look_up_segments(simd, &mut sample, lanes, near_cut, &mut previous, point);
        let complete = here & last.waiting;
        if complete.any_true() {
            found.insert(complete, &last.with_next(as_neighbour));
        }
        let hit = self.to_be_shaded(&sample, lanes, near_cut);
        let new = NewSamples {
            sample: &sample,
            deformed: p,
            near_cut,
            previous,
            next: as_neighbour,
        };
        let mut layered =
            here & self.may_hide_a_layer(&sample, as_neighbour.depth, &previous, last.sample.alpha);
        if layered.any_true() {
            layered &= self.near_edge(&sample, near_cut);
            found.insert_layers(layered & !complete, &new);
        }
        way.last.layered = (layered & complete) | (way.last.layered & !here);
        way.last.insert(here, number, hit, as_neighbour.depth, &new);
    }

    /// Shades the samples found and composites them behind the accumulated colour; rays that have
    /// become opaque end.
    #[inline(always)]
    fn composite_found<S: Simd>(
        &self,
        simd: S,
        rays: &MarchRays<S>,
        found: &mut FoundSamples<S>,
        way: &mut March<S>,
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
        let weight = visible.select(way.transmittance * (one - pass), zero);
        way.color = way.color + Vec3x8::select(visible, color, way.color) * weight;
        way.transmittance = visible.select(way.transmittance * pass, way.transmittance);
        let mut through = opaque;
        if self.scene.settings.early_termination {
            through |= visible & way.transmittance.simd_lt(MIN_TRANSMITTANCE);
        }
        let through = through & way.live;
        way.terminated += through.select((rays.end - way.number).max(0.0), zero);
        way.last.waiting &= !through;
        way.last.layered &= !through;
        way.live &= !through & (way.number.simd_lt(rays.end) | way.last.waiting | way.last.layered);
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
    /// Which have something opaque in front of the sample after the last one.
    hidden: mask32x8<S>,
    /// Whether many samples are visible.
    mostly_visible: bool,
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
    /// What has been composited so far, front to back, premultiplied; or projected.
    color: Vec3x8<S>,
    transmittance: f32x8<S>,
    projection: IntensityProjection<S>,
}

/// The last sample taken on each ray.
struct LastSamples<S: Simd> {
    /// Its index.
    number: f32x8<S>,
    sample: SamplePacket<S>,
    /// Its own optical depth, as opposed to that of the segment in front of it.
    own_depth: f32x8<S>,
    deformed: Vec3x8<S>,
    near_cut: mask32x8<S>,
    previous: Neighbours<S>,
    /// Which have something to shade as soon as the next sample is known.
    waiting: mask32x8<S>,
    /// Which may have a thin layer in front of them that is not shaded yet.
    layered: mask32x8<S>,
}

impl<S: Simd> LastSamples<S> {
    /// The samples as found, now that the next ones are known.
    #[inline(always)]
    fn with_next(&self, next: Neighbours<S>) -> NewSamples<'_, S> {
        NewSamples {
            sample: &self.sample,
            deformed: self.deformed,
            near_cut: self.near_cut,
            previous: self.previous,
            next,
        }
    }

    /// Replaces the samples of the lanes `here`; those of `hit` have something to shade.
    #[inline(always)]
    fn insert(
        &mut self,
        here: mask32x8<S>,
        number: f32x8<S>,
        hit: mask32x8<S>,
        own_depth: f32x8<S>,
        new: &NewSamples<S>,
    ) {
        self.number = here.select(number, self.number);
        self.own_depth = here.select(own_depth, self.own_depth);
        self.waiting = (hit & here) | (self.waiting & !here);
        if (hit | self.layered).any_true() {
            self.sample.insert(here, new.sample);
            self.deformed = Vec3x8::select(here, new.deformed, self.deformed);
            self.near_cut = (here & new.near_cut) | (self.near_cut & !here);
            self.previous.insert(here, &new.previous);
        } else {
            // Of what shows nothing only this is read again.
            let (to, from) = (&mut self.sample, new.sample);
            to.value = here.select(from.value, to.value);
            to.alpha = here.select(from.alpha, to.alpha);
            to.present = (here & from.present) | (to.present & !here);
        }
    }
}
