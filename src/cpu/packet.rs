//! Eight rays, four across and two down, marched together.
//!
//! *Theory*: neighbouring rays ask the same questions at nearly the same places, so eight of them share every instruction: one lane each
//! ([`crate::math::lanes`]). As in `shaders/lib/composite.wgsl` there are two loops: lanes look until each has found something to shade or is
//! through (or, in haze, until half of them have), then those that have found something shade together. A ray thus waits for its neighbours,
//! never for their shading.
//!
//! Most samples are *plain*: farther from every cut than anything that a cut does to light, or, beside a face of the volume's own box, than what it
//! does to anything but normals. What lanes do for those is what [`shading`] does for one sample, less what is known to change nothing. The
//! others, beside a cut, are handed to [`shading`] one by one; there are few, since a cut is a surface.
//!
//! *What is not computed*: a sample's neighbour in front of it has mostly been looked at just before, so whether the ray enters matter here is
//! known without a look; the distance to the shapes of cuts changes no faster than the point moves, so that between two evaluations it is
//! bounded; the Jacobian is the identity outside all maps.

use super::shading::{self, CUT_LOOKBACK_SHARE, CUT_LOOKBACK_STEPS, ENTRY_STEPS, ISOTROPIC_DIFFUSE, MAX_CUT_LOOKBACK, SURFACE_GRADIENT};
use super::{IntensityProjection, MIN_TRANSMITTANCE, shading::VisibleSample};
use crate::math::lanes::*;
use crate::picture::RenderStats;
use crate::prepare::Prepared;
use crate::scene::{Mode, Normals};
use crate::transfer::{Blend, Preintegrated};
use crate::volume::{VolumeSampler, Voxel};
use glam::{Mat3, Vec3};

/// Eight rays.
#[derive(Clone, Copy)]
pub struct RayPacket<S: Simd> {
    /// Starts.
    pub origin: Vec3x8<S>,
    /// Unit directions.
    pub direction: Vec3x8<S>,
    /// Where something opaque ends them, mm; negative for a ray that is not wanted.
    pub until: f32x8<S>,
}

/// How many steps before a sample its texels are asked into the cache: by one they would come too late.
const PREFETCH_STEPS: f32 = 2.0;

/// How many of the looks of the packets so far found something to shade. Where few do, differences are fetched for those alone, not beside every value.
/// The picture is the same either way.
#[derive(Clone, Copy, Debug, Default)]
pub struct FetchPolicy {
    lookups: u32,
    shaded_lookups: u32,
}

impl FetchPolicy {
    /// Whether differences are worth fetching beside values: a value alone costs about half of what it costs with them.
    fn fetches_gradients(self) -> bool {
        self.shaded_lookups * 3 >= self.lookups
    }
}

/// What is at eight points of the deformed scene; see [`super::SceneSample`].
#[derive(Clone, Copy)]
struct SamplePacket<S: Simd> {
    in_voxel: Vec3x8<S>,
    value: f32x8<S>,
    present: mask32x8<S>,
    alpha: f32x8<S>,
    /// Optical depth per reference length; 0 where nothing is present.
    depth: f32x8<S>,
    /// The value in front, where the segment between the two is what is seen.
    front: f32x8<S>,
    /// Inside the cube of any map.
    inside: mask32x8<S>,
    /// In a clear macrocell.
    cut_free: mask32x8<S>,
    /// Differences of stored values and colours by the transfer function, where those were fetched too.
    differences: Vec3x8<S>,
    color: Vec3x8<S>,
    /// Whether they were.
    with_gradients: bool,
}

/// A pixel's shift of its samples, in steps, -1/2 .. 1/2: a hash by multiplication and shifts, the same integers as in
/// `shaders/lib/composite.wgsl`.
pub fn pixel_shift(x: u32, y: u32) -> f32 {
    let mut h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77);
    h = (h ^ (h >> 16)).wrapping_mul(0x7FEB_352D);
    h = (h ^ (h >> 15)).wrapping_mul(0x846C_A68B);
    h ^= h >> 16;
    (h >> 8) as f32 / 16_777_216.0 - 0.5
}

/// What all packets of a picture share.
pub struct RayMarcher<'a, T> {
    scene: &'a Prepared<'a>,
    sampler: &'a VolumeSampler<'a, T>,
    /// Voxels along each axis nearer to the volume's faces than which those matter.
    face_margin_voxels: Vec3,
    /// The same wherever the deformation has brought the faces.
    deformed_face_margin_voxels: Vec3,
    /// The same for cuts, mm.
    margin_mm: f32,
    /// A covector per voxel to one per mm.
    world_from_covector: Mat3,
    /// Whether samples are asked for more than depth and colour.
    composite: bool,
    grey_faces: bool,
    lit: bool,
    gradient_opacity: bool,
    /// The exponent of highlights, if it is whole.
    integer_shininess: Option<u32>,
    /// By the values at both ends of a step, if those are what is seen.
    preintegrated: Option<Preintegrated>,
}

/// Index of the first sample at or after `t`, for eight rays.
#[inline(always)]
fn first_sample_after<S: Simd>(t: f32x8<S>, step: f32x8<S>) -> f32x8<S> {
    (t / step - 0.5).ceil().max(0.0)
}

/// A colour under light where there is a surface, under even light where there is none.
#[inline(always)]
fn lit<S: Simd>(color: f32x8<S>, even: f32, diffuse: f32x8<S>, highlight: f32x8<S>, confidence: f32x8<S>) -> f32x8<S> {
    let (dull, lit) = (color * even, color.mul_add(diffuse, highlight));
    (lit - dull).mul_add(confidence, dull).max(0.0).min(1.0)
}

#[inline(always)]
fn count<S: Simd>(mask: mask32x8<S>) -> u64 {
    u64::from(mask.to_bitmask().count_ones())
}

#[inline(always)]
fn sum<S: Simd>(v: f32x8<S>) -> u64 {
    v.as_slice().iter().sum::<f32>() as u64
}

impl<'a, T: Voxel> RayMarcher<'a, T> {
    /// Prepares what does not depend on the ray.
    pub fn new(scene: &'a Prepared, sampler: &'a VolumeSampler<'a, T>) -> Self {
        let world_from_covector = Mat3::from(scene.volume().voxel_from_world.matrix3).transpose();
        Self {
            scene,
            sampler,
            face_margin_voxels: scene.face_margin_voxels(),
            deformed_face_margin_voxels: scene.deformed_face_margin_voxels(),
            margin_mm: scene.cut_margin_mm(),
            world_from_covector,
            composite: scene.volume().blend == Blend::Composite,
            grey_faces: scene.grey_faces(),
            lit: scene.is_lit(),
            gradient_opacity: scene.uses_gradient_opacity(),
            integer_shininess: Some(scene.light.shininess).filter(|s| s.fract() == 0.0 && (0.0..=1024.0).contains(s)).map(|s| s as u32),
            preintegrated: scene
                .preintegrated()
                .then(|| Preintegrated::new(&scene.volume().table, scene.frame.steps.step_mm / scene.frame.steps.reference_mm)),
        }
    }

    /// Colour and optical depth of the segment between two values.
    fn segment(&self, table: &Preintegrated, front: f32, back: f32) -> [f32; 4] {
        let place = |value: f32| value * self.scene.volume().table.scale + self.scene.volume().table.offset;
        table.lookup(place(front), place(back))
    }

    /// Looks at eight points, of which those in `lanes` are wanted; `with_gradients` for differences and colours too. Cuts that are shapes are not asked.
    #[inline(always)]
    fn sample_points<S: Simd>(&self, simd: S, p: Vec3x8<S>, lanes: mask32x8<S>, with_gradients: bool) -> SamplePacket<S> {
        let walk = self.scene.stack.source_and_alpha_lanes(simd, p, lanes);
        let in_voxel = walk.source.transformed(&self.scene.volume().voxel_from_world);
        let top = self.scene.volume().grid_size - 0.5;
        let mut present =
            lanes & walk.alpha.simd_ge(0.5) & within(in_voxel.x, -0.5, top.x) & within(in_voxel.y, -0.5, top.y) & within(in_voxel.z, -0.5, top.z);
        let none = Vec3x8::splat(simd, Vec3::ZERO);
        let (value, differences) =
            if with_gradients { self.sampler.sample_with_differences(simd, in_voxel) } else { (self.sampler.sample_lanes(simd, in_voxel), none) };
        if self.scene.volume().grid.has_holes {
            present &= value.simd_ge(-1e-4);
        }
        let table = &self.scene.volume().table;
        let (color, depth) = if with_gradients { table.lookup_lanes(simd, value) } else { (none, table.depth_lanes(simd, value)) };
        let depth = present.select(depth, f32x8::splat(simd, 0.0));
        SamplePacket {
            in_voxel,
            value,
            present,
            alpha: walk.alpha,
            depth,
            front: value,
            inside: walk.inside,
            cut_free: lanes & !lanes,
            differences,
            color,
            with_gradients,
        }
    }

    /// The nearest of the volume's faces outside of all maps: distances, mm, and normals out of the volume.
    #[inline(always)]
    fn nearest_face<S: Simd>(&self, simd: S, in_voxel: Vec3x8<S>) -> (f32x8<S>, Vec3x8<S>) {
        let none = (f32x8::splat(simd, f32::INFINITY), Vec3x8::splat(simd, Vec3::ZERO));
        let nearest = self.nearer_face(simd, in_voxel.x, 0, none);
        let nearest = self.nearer_face(simd, in_voxel.y, 1, nearest);
        self.nearer_face(simd, in_voxel.z, 2, nearest)
    }

    /// Which points are farther from the volume's faces than some voxels along each axis.
    #[inline(always)]
    fn far_from_faces<S: Simd>(&self, p: Vec3x8<S>, voxels: Vec3x8<S>) -> mask32x8<S> {
        let top = self.scene.volume().grid_size - 0.5;
        let above = p.x.simd_gt(voxels.x - 0.5) & p.y.simd_gt(voxels.y - 0.5) & p.z.simd_gt(voxels.z - 0.5);
        above & p.x.simd_lt(-voxels.x + top.x) & p.y.simd_lt(-voxels.y + top.y) & p.z.simd_lt(-voxels.z + top.z)
    }

    /// The nearer of some faces and the two across an axis.
    #[inline(always)]
    fn nearer_face<S: Simd>(&self, simd: S, x: f32x8<S>, axis: usize, (nearest, normal): (f32x8<S>, Vec3x8<S>)) -> (f32x8<S>, Vec3x8<S>) {
        let (low, high) = (x + 0.5, -x + (self.scene.volume().grid_size[axis] - 0.5));
        let covector = self.world_from_covector.col(axis);
        let (inside, slope) = (low.min(high), covector.length());
        let nearer = inside.simd_lt(nearest * slope);
        let outward = Vec3x8::splat(simd, covector / -slope);
        (nearer.select(inside / slope, nearest), Vec3x8::select(nearer, Vec3x8::select(low.simd_lt(high), outward, -outward), normal))
    }

    /// The volume along eight rays: premultiplied colours.
    #[inline(always)]
    pub fn march<S: Simd>(&self, simd: S, rays: RayPacket<S>, stats: &mut RenderStats, fetch_policy: &mut FetchPolicy) -> [[f32; 4]; LANES] {
        let scene = self.scene;
        let frame = &scene.frame;
        let zero = f32x8::splat(simd, 0.0);
        let RayPacket { origin, direction, until } = rays;
        let one = f32x8::splat(simd, 1.0);
        let inverse_direction = Vec3x8 { x: one / direction.x, y: one / direction.y, z: one / direction.z };
        let step = match scene.settings.mode {
            Mode::Raycast | Mode::Surface => f32x8::splat(simd, frame.steps.step_mm),
            Mode::Slice => f32x8::splat(simd, frame.steps.step_mm) / direction.dot(Vec3x8::splat(simd, frame.view.forward)),
        };
        let length = step * frame.steps.reference_mm.recip();
        let (near, far) = frame.proxy.intersect_rays(simd, origin, inverse_direction);
        let mut i = first_sample_after(near, step);
        let end = first_sample_after(far.min(until), step);
        let mut live = near.simd_le(far) & until.simd_ge(0.0) & i.simd_lt(end);
        if live.all_false() {
            return [[0.0; 4]; LANES];
        }
        let half = (Vec3x8::splat(simd, frame.to_light) - direction).normalized();
        let mut color = Vec3x8::splat(simd, Vec3::ZERO);
        let mut transmittance = one;
        let mut projection = IntensityProjection::new(simd, scene.volume().blend);
        // The last sample that was looked at: its number, whether it stood for its whole step, and what it showed.
        let (mut last, mut last_depth, mut last_value) = (f32x8::splat(simd, -2.0), zero, zero);
        let mut last_present = i.simd_lt(-1.0);
        // Where the distance from the shapes of cuts was last evaluated, and what it was.
        let (mut cut_distance_t, mut cut_distance_mm) = (f32x8::splat(simd, f32::NEG_INFINITY), f32x8::splat(simd, -1.0));
        let none = last_present;
        // Which rays are in clear macrocells, and until where.
        let never = f32x8::splat(simd, f32::NEG_INFINITY);
        let (mut cut_free, mut cut_free_until) = (none, never);
        let (mut skipped, mut terminated) = (zero, zero);
        let with_gradients = self.sampler.has_gradients() && fetch_policy.fetches_gradients();
        let ahead = direction.mapped(&Mat3::from(scene.volume().voxel_from_world.matrix3)) * (step * PREFETCH_STEPS);
        while live.any_true() {
            let (mut searching, mut found) = (live, none);
            let mut at = SamplePacket {
                in_voxel: origin,
                value: zero,
                present: none,
                alpha: one,
                depth: zero,
                front: zero,
                inside: none,
                cut_free: none,
                differences: origin,
                color: origin,
                with_gradients,
            };
            let (mut sampled, mut before) = (origin, origin);
            let (mut share, mut near_shape) = (one, none);
            let (mut previous_sampled, mut previous_present, mut previous_depth) = (none, none, zero);
            while searching.any_true() {
                // Lanes in empty cells move on until every one has something to look at: a look costs as much for one lane as for eight.
                let (mut middle, mut p);
                loop {
                    middle = (i + 0.5) * step;
                    p = origin + direction * middle;
                    if (searching & !middle.simd_lt(cut_free_until)).all_false() {
                        break;
                    }
                    let (empty, in_cut_free, exit) = scene.volume().macrocells.blocks_lanes(simd, p, origin, inverse_direction);
                    cut_free = in_cut_free;
                    cut_free_until = cut_free.select(exit, never);
                    let empty = empty & searching;
                    if empty.all_false() {
                        break;
                    }
                    let next = first_sample_after(exit, step).max(i + 1.0).min(end);
                    skipped += empty.select(next - i, zero);
                    i = empty.select(next, i);
                    searching &= i.simd_lt(end);
                }
                let here = searching;
                if here.all_false() {
                    break;
                }
                stats.samples_taken += count(here);
                let number = i;
                i = here.select(i + 1.0, i);
                searching &= i.simd_lt(end);
                let (mut part, mut near_cut) = (one, none);
                let mut active_lanes = here;
                if !scene.cuts.is_empty() {
                    // The distance is known to within the way since: evaluate it only where that does not decide.
                    let certain_mm = cut_distance_mm.abs() - (middle - cut_distance_t).abs();
                    let unsure = here & !certain_mm.simd_gt(step * 0.5);
                    for n in lanes_of(unsure.to_bitmask()) {
                        let (o, d, t) = (origin.lane(n), direction.lane(n), middle[n]);
                        cut_distance_t[n] = t;
                        cut_distance_mm[n] = scene.cuts.signed_distance_mm(o + d * t);
                        if cut_distance_mm[n].abs() <= 0.5 * step[n] {
                            let kept = scene.cuts.retained_part(o, d, t, step[n]);
                            part[n] = kept.share;
                            p.set(n, o + d * kept.at);
                        }
                    }
                    let certain_mm = cut_distance_mm.abs() - (middle - cut_distance_t).abs();
                    let whole = certain_mm.simd_gt(step * 0.5);
                    part = (whole & cut_distance_mm.simd_lt(0.0)).select(zero, part);
                    active_lanes &= part.simd_gt(0.0);
                    near_cut = active_lanes & !(certain_mm.simd_gt(self.margin_mm) & cut_distance_mm.simd_gt(0.0));
                    // Asked again where the bound leaves it open: what a sample is must not depend on where the ray was asked before.
                    for n in lanes_of(near_cut.to_bitmask()) {
                        (cut_distance_t[n], cut_distance_mm[n]) =
                            (middle[n], scene.cuts.signed_distance_mm(origin.lane(n) + direction.lane(n) * middle[n]));
                        near_cut.set(n, cut_distance_mm[n] <= self.margin_mm);
                    }
                    if active_lanes.all_false() {
                        last = here.select(f32x8::splat(simd, -2.0), last);
                        continue;
                    }
                }
                fetch_policy.lookups += 1;
                let mut look = self.sample_points(simd, p, active_lanes, with_gradients);
                if with_gradients {
                    self.sampler.prefetch(look.in_voxel + ahead);
                }
                if !self.composite {
                    projection.insert(look.value, look.present);
                    continue;
                }
                let (mut depth, last_sampled) = (look.depth, active_lanes & last.simd_eq(number - 1.0) & part.simd_eq(1.0));
                // The same point, to the bit, whether or not it was looked at.
                let previous = Vec3x8::select(part.simd_eq(1.0), origin + direction * ((number - 0.5) * step), p - direction * step);
                if let Some(table) = &self.preintegrated {
                    let with_front = last_sampled & last_present;
                    look.front = with_front.select(last_value, look.value);
                    let unknown = active_lanes & look.present & !last_sampled;
                    if unknown.any_true() {
                        let earlier = self.sample_points(simd, previous, unknown, false);
                        look.front = earlier.present.select(earlier.value, look.front);
                    }
                    for n in lanes_of((active_lanes & look.present).to_bitmask()) {
                        depth[n] = self.segment(table, look.front[n], look.value[n])[3];
                    }
                }
                let mut hit = active_lanes
                    & match scene.volume().iso {
                        Some(iso) => look.present & look.value.simd_ge(iso),
                        None => depth.simd_gt(0.0) | (look.alpha.simd_gt(0.0) & look.alpha.simd_lt(1.0)),
                    };
                if self.grey_faces {
                    hit |= active_lanes & look.present & (look.alpha.simd_lt(1.0) | near_cut);
                }
                if found.all_false() {
                    // Nothing is to be kept of other lanes. One by one: the whole would be copied by a call, around which all registers are saved.
                    (at.in_voxel, at.value, at.differences, at.color) = (look.in_voxel, look.value, look.differences, look.color);
                    (at.depth, at.front, at.alpha) = (depth, look.front, look.alpha);
                    (at.present, at.inside, at.cut_free) = (look.present, look.inside, cut_free);
                    (sampled, before, share) = (p, previous, part);
                    (near_shape, found) = (hit & near_cut, hit);
                    (previous_sampled, previous_present, previous_depth) = (hit & last_sampled, hit & last_present, last_depth);
                    searching &= !hit;
                } else if hit.any_true() {
                    at = SamplePacket {
                        in_voxel: Vec3x8::select(hit, look.in_voxel, at.in_voxel),
                        value: hit.select(look.value, at.value),
                        present: (hit & look.present) | (at.present & !hit),
                        alpha: hit.select(look.alpha, at.alpha),
                        depth: hit.select(depth, at.depth),
                        front: hit.select(look.front, at.front),
                        inside: (hit & look.inside) | (at.inside & !hit),
                        cut_free: (hit & cut_free) | (at.cut_free & !hit),
                        differences: Vec3x8::select(hit, look.differences, at.differences),
                        color: Vec3x8::select(hit, look.color, at.color),
                        with_gradients,
                    };
                    sampled = Vec3x8::select(hit, p, sampled);
                    before = Vec3x8::select(hit, previous, before);
                    share = hit.select(part, share);
                    near_shape |= hit & near_cut;
                    previous_sampled |= hit & last_sampled;
                    previous_present |= hit & last_present;
                    previous_depth = hit.select(last_depth, previous_depth);
                    found |= hit;
                    searching &= !hit;
                }
                last = here.select((active_lanes & part.simd_eq(1.0)).select(number, f32x8::splat(simd, -2.0)), last);
                last_present = (here & look.present) | (last_present & !here);
                last_depth = here.select(look.depth, last_depth);
                last_value = here.select(look.value, last_value);
                // The others are not waited for where they mostly have something to shade, too: a look for a few lanes costs as much as one for all.
                if with_gradients && count(found) >= LANES as u64 / 2 {
                    break;
                }
            }
            if found.all_false() {
                break;
            }
            let mut visible = found & at.depth.simd_gt(0.0);
            let mut opaque = none;
            let (mut rgb, mut depth) = (color, zero);
            // What is no plain sample, one by one.
            let mut scalar_lanes = near_shape & found;
            if self.grey_faces || scene.volume().iso.is_some() {
                scalar_lanes = found;
            } else {
                // Farther than a step from the volume's faces those change the normal alone, unless there are holes.
                let near_cut = found & !at.inside & !self.far_from_faces(at.in_voxel, Vec3x8::splat(simd, self.face_margin_voxels));
                if near_cut.any_true() {
                    let near = if scene.volume().grid.has_holes { f32x8::splat(simd, self.margin_mm) } else { step * 1.1 };
                    scalar_lanes |= near_cut & self.nearest_face(simd, at.in_voxel).0.simd_lt(near);
                }
                // Matter that ends between the sample in front and this one, which both show nothing: only one of the two is present then.
                let both = (previous_present & at.present) | !(previous_present | at.present);
                scalar_lanes |= found & !visible & !(previous_sampled & (both | previous_depth.simd_gt(0.0)));
            }
            let packet_lanes = visible & !scalar_lanes;
            if packet_lanes.any_true() {
                let front = PreviousSamples { before, sampled: previous_sampled, present: previous_present, depth: previous_depth };
                fetch_policy.shaded_lookups += 1;
                let (shaded, factor, cut) = self.shade(simd, &at, sampled, ShadingRays { direction, half, step }, packet_lanes, &front);
                rgb = shaded;
                depth = at.depth * factor * share;
                scalar_lanes |= cut;
            }
            if (scalar_lanes & found).any_true() {
                for n in lanes_of((scalar_lanes & found).to_bitmask()) {
                    let of_sample = self.shade_scalar(at.lane(n), at.front[n], sampled.lane(n), direction.lane(n), step[n]);
                    match of_sample {
                        ScalarSample::Nothing => visible.set(n, false),
                        ScalarSample::Opaque(c) => {
                            opaque.set(n, true);
                            rgb.set(n, c);
                            depth[n] = f32::INFINITY;
                            visible.set(n, true);
                        }
                        ScalarSample::Visible(c, tau) => {
                            visible.set(n, true);
                            rgb.set(n, c);
                            depth[n] = tau * share[n];
                        }
                    }
                }
            }
            let pass = opaque.select(zero, exp2(-(depth * length)));
            let weight = visible.select(transmittance * (one - pass), zero);
            color = color + Vec3x8::select(visible, rgb, color) * weight;
            transmittance = visible.select(transmittance * pass, transmittance);
            let mut through = opaque;
            if scene.settings.early_termination {
                through |= visible & transmittance.simd_lt(MIN_TRANSMITTANCE);
            }
            let through = through & live;
            terminated += through.select((end - i).max(0.0), zero);
            live &= !through & i.simd_lt(end);
        }
        stats.samples_skipped += sum(skipped);
        stats.samples_terminated += sum(terminated);
        let mut colors = [[0.0; 4]; LANES];
        for (n, color_of) in colors.iter_mut().enumerate() {
            *color_of = if self.composite { [color.x[n], color.y[n], color.z[n], 1.0 - transmittance[n]] } else { projection.color(scene, n) };
        }
        colors
    }

    /// A sample that is not plain.
    #[inline(never)]
    fn shade_scalar(&self, (at, depth): (super::SceneSample, f32), front: f32, sampled: Vec3, direction: Vec3, step: f32) -> ScalarSample {
        let (scene, sampler) = (self.scene, self.sampler);
        if at.present
            && self.grey_faces
            && let Some(grey) = shading::grey_face(scene, sampler, &at, sampled, direction, step)
        {
            return ScalarSample::Opaque(Vec3::splat(grey));
        }
        if let Some(iso) = scene.volume().iso {
            if at.present && at.value >= iso {
                return ScalarSample::Opaque(shading::iso_surface(scene, sampler, iso, sampled, direction, step));
            }
            return ScalarSample::Nothing;
        }
        if depth > 0.0 {
            let [r, g, b, depth] = match &self.preintegrated {
                Some(table) => self.segment(table, front, at.value),
                None => scene.volume().table.lookup(at.value),
            };
            let sample = VisibleSample { deformed: sampled, in_voxel: at.in_voxel, color: Vec3::new(r, g, b), depth, value: at.value };
            let shaded = shading::shade(scene, sampler, &sample, direction, step);
            return ScalarSample::Visible(shaded.color, depth * shaded.depth_factor);
        }
        if at.alpha > 0.0
            && at.alpha < 1.0
            && let Some((depth, shaded)) = shading::thin_layer_at_cut(scene, sampler, sampled, at.present, direction, step)
        {
            return ScalarSample::Visible(shaded.color, depth * shaded.depth_factor);
        }
        ScalarSample::Nothing
    }

    /// Light on eight visible samples: colours, factors on their depths, and which of `lanes` turn out to lie beside a cut, so that what is said
    /// of them does not hold.
    #[inline(always)]
    fn shade<S: Simd>(
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
        let (bits, mut cut) = (lanes.to_bitmask(), lanes & !lanes);
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
        let (mut gradient, mut magnitude, mut factor) = (Vec3x8::splat(simd, Vec3::ZERO), one, one);
        if self.lit || self.gradient_opacity {
            let per_voxel = if at.with_gradients {
                let mut differences = at.differences;
                if entered.any_true() {
                    let there = self.sampler.sample_with_differences(simd, entry.in_voxel).1;
                    differences = Vec3x8::select(entered, there, differences);
                }
                self.sampler.gradient_of(simd, entry.in_voxel, differences, bits)
            } else {
                self.sampler.gradient_lanes(simd, entry.in_voxel, scene.gradient_filter(), bits)
            };
            gradient = per_voxel.mapped(&self.world_from_covector);
            magnitude = gradient.length();
        }
        if self.gradient_opacity {
            for n in lanes_of(bits) {
                factor[n] = scene.volume().table.gradient_factor(magnitude[n]);
            }
        }
        let per_reference = magnitude * (scene.volume().table.scale.abs() * scene.frame.steps.reference_mm);
        let mut confidence = smoothstep(SURFACE_GRADIENT[0], SURFACE_GRADIENT[1], per_reference);
        let in_a_map = lanes & (at.inside | entry.inside);
        let mut jacobian_columns = [Vec3x8::splat(simd, Vec3::X), Vec3x8::splat(simd, Vec3::Y), Vec3x8::splat(simd, Vec3::Z)];
        // Far from every cut, the deformation matters to what has a normal only.
        let mut active_lanes = in_a_map & !(at.cut_free & self.far_from_faces(entry.in_voxel, Vec3x8::splat(simd, self.deformed_face_margin_voxels)));
        if self.lit {
            active_lanes |= in_a_map & confidence.simd_gt(0.0);
        }
        if active_lanes.any_true() {
            let jets = scene.stack.jets_lanes(simd, entry.deformed, active_lanes);
            jacobian_columns = jets.columns;
            // No face of the volume's box is nearer than its distance in the source over the norm of J: mostly far enough to ask no further.
            let [x, y, z] = jets.columns;
            let norm = (x.dot(x) + y.dot(y) + z.dot(z)).sqrt();
            let far = self.far_from_faces(entry.in_voxel, Vec3x8::splat(simd, self.face_margin_voxels) * norm);
            cut |= active_lanes & jets.cut_distance_mm.simd_lt(self.margin_mm);
            for n in lanes_of((active_lanes & !far).to_bitmask()) {
                let jet = scene.stack.jet(entry.deformed.lane(n));
                let nearest = shading::nearest_cut(scene, &jet, entry.in_voxel.lane(n));
                cut.set(n, nearest.distance_mm < self.margin_mm);
                (0..3).for_each(|a| jacobian_columns[a].set(n, jet.d_source_d_deformed.col(a)));
            }
        }
        if !self.lit {
            return (color, factor, cut);
        }
        let mut inward = gradient;
        if !scene.light.two_sided {
            for n in lanes_of(bits) {
                if scene.volume().table.opacity_slope_sign(entry.value[n]) < 0.0 {
                    inward.set(n, -inward.lane(n));
                }
            }
        }
        if in_a_map.any_true() && matches!(scene.settings.normals, Normals::Transformed | Normals::Blended) {
            inward = Vec3x8 { x: jacobian_columns[0].dot(inward), y: jacobian_columns[1].dot(inward), z: jacobian_columns[2].dot(inward) };
        }
        let mut normal = -inward.normalized();
        if scene.light.two_sided {
            let away = normal.dot(rays.direction).simd_gt(0.0);
            normal = Vec3x8::select(away, -normal, normal);
        }
        // What entered through a surface of the volume's own shows that surface.
        let near_cut = lanes & !in_a_map & !entered & !self.far_from_faces(at.in_voxel, Vec3x8::splat(simd, self.face_margin_voxels));
        if scene.settings.normals == Normals::Blended && near_cut.any_true() {
            let (distance, outward) = self.nearest_face(simd, at.in_voxel);
            let own = smoothstep(scene.frame.steps.blend_mm[0], scene.frame.steps.blend_mm[1], distance);
            let facing = -outward.dot(rays.direction);
            let mut near_cut = near_cut & own.simd_lt(1.0) & facing.simd_gt(0.0);
            if near_cut.any_true() {
                // As shading::cut_in_front.
                let mut way = (distance * CUT_LOOKBACK_SHARE / facing).min(MAX_CUT_LOOKBACK * scene.frame.steps.blend_mm[1]);
                let mut undecided = near_cut;
                for _ in 0..CUT_LOOKBACK_STEPS {
                    let back = self.sample_points(simd, sampled - rays.direction * way, undecided, false);
                    near_cut &= !(undecided & back.present) | back.depth.simd_ge(at.depth * 0.5);
                    undecided &= !back.present;
                    if !undecided.any_true() {
                        break;
                    }
                    way *= 0.5;
                }
                let of_face = one - own;
                let blended = (normal * (own * confidence) + outward * of_face).normalized();
                normal = Vec3x8::select(near_cut, blended, normal);
                confidence = near_cut.select((own * confidence).max(of_face), confidence);
            }
        }
        (self.light(simd, normal, confidence, rays.half, color), factor, cut)
    }

    /// Blinn-Phong under one directional light.
    #[inline(always)]
    fn light<S: Simd>(&self, simd: S, normal: Vec3x8<S>, confidence: f32x8<S>, half: Vec3x8<S>, color: Vec3x8<S>) -> Vec3x8<S> {
        let light = &self.scene.light;
        let to_light = Vec3x8::splat(simd, self.scene.frame.to_light);
        let zero = f32x8::splat(simd, 0.0);
        let even = light.ambient + ISOTROPIC_DIFFUSE * light.diffuse;
        let facing = normal.dot(to_light);
        let diffuse = facing.max(0.0).mul_add(light.diffuse, light.ambient);
        let mut highlight = zero;
        if light.specular > 0.0 {
            let cosine = normal.dot(half);
            let shines = facing.simd_gt(0.0) & cosine.simd_gt(1e-6);
            if shines.any_true() {
                let power = match self.integer_shininess {
                    Some(n) => powi(cosine, n),
                    None => exp2(log2(cosine.max(1e-6)) * light.shininess),
                };
                highlight = shines.select(power * light.specular, zero);
            }
        }
        Vec3x8 {
            x: lit(color.x, even, diffuse, highlight, confidence),
            y: lit(color.y, even, diffuse, highlight, confidence),
            z: lit(color.z, even, diffuse, highlight, confidence),
        }
    }

    /// Where rays that enter matter within their last step do, by bisection, else the samples themselves; and which rays do. See [`shading`].
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
        let mut first = SurfaceEntries { deformed: sampled, in_voxel: at.in_voxel, value: at.value, inside: at.inside };
        let mut enters = lanes & front.sampled & !(front.present & front.depth.simd_ge(enough));
        let unknown = lanes & !front.sampled;
        if unknown.any_true() {
            let before = self.sample_points(simd, front.before, unknown, false);
            enters |= unknown & !(before.present & before.depth.simd_ge(enough));
        }
        if enters.any_true() {
            let mut width = rays.step;
            for _ in 0..ENTRY_STEPS {
                width *= 0.5;
                let p = first.deformed - rays.direction * width;
                let look = self.sample_points(simd, p, enters, false);
                let dense = enters & look.present & look.depth.simd_ge(enough);
                first = SurfaceEntries {
                    deformed: Vec3x8::select(dense, p, first.deformed),
                    in_voxel: Vec3x8::select(dense, look.in_voxel, first.in_voxel),
                    value: dense.select(look.value, first.value),
                    inside: first.inside | (dense & look.inside),
                };
            }
        }
        (first, enters)
    }
}

/// Of eight rays, their directions, the vectors half-way between the light and the eye, and the distances of their samples, mm.
#[derive(Clone, Copy)]
struct ShadingRays<S: Simd> {
    direction: Vec3x8<S>,
    half: Vec3x8<S>,
    step: f32x8<S>,
}

/// What is known of the samples in front of eight.
struct PreviousSamples<S: Simd> {
    /// Where they lie.
    before: Vec3x8<S>,
    /// Which of them have been looked at.
    sampled: mask32x8<S>,
    present: mask32x8<S>,
    depth: f32x8<S>,
}

/// Where eight rays enter matter.
#[derive(Clone, Copy)]
struct SurfaceEntries<S: Simd> {
    deformed: Vec3x8<S>,
    in_voxel: Vec3x8<S>,
    value: f32x8<S>,
    inside: mask32x8<S>,
}

/// What a sample beside a cut shows.
enum ScalarSample {
    Nothing,
    /// A surface that hides everything behind it.
    Opaque(Vec3),
    /// Its colour and optical depth per reference length.
    Visible(Vec3, f32),
}

impl<S: Simd> SamplePacket<S> {
    /// What a lane saw, and its optical depth.
    #[inline(always)]
    fn lane(&self, n: usize) -> (super::SceneSample, f32) {
        let look = super::SceneSample { in_voxel: self.in_voxel.lane(n), value: self.value[n], present: self.present.test(n), alpha: self.alpha[n] };
        (look, self.depth[n])
    }
}
