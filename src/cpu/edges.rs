//! The length of ray that a sample represents, where rays enter material, and layers thinner than a
//! step.
//!
//! *Theory*: between two samples of similar density each represents half of the step. Where their
//! densities differ by more than [`EDGE_RATIO`] (at a surface, at a cut, at the volume's own faces),
//! the thinner one represents the step up to where the density crosses their mean, found by
//! bisection, and the denser one the rest of the step's optical depth. The sum over a ray is then
//! the trapezoidal rule, refined by the samples of the bisection where the density changes fast,
//! wherever the samples fall. Without this, edges show the sampling as rings, combs and stairs.
//!
//! A sample in front of which the density falls below half of its own is shaded where the ray enters
//! the material, not wherever the sample lies within the step: at the mean depth to which one sees
//! into what the sample represents. At a cut only the material is that of this depth; the light is
//! that of the face.
//!
//! Two thin samples may have a dense layer between them that is thinner than a step: the end of
//! material that is cut obliquely, or that ends at the volume's face. Where a cut or a face passes
//! between the two, [`THIN_LAYER_SAMPLES`] samples search for it.
//!
//! Samples of pre-integrated segments represent the segment in front of them. Its length changes only
//! at cuts: what is cut away does not count, and what lies between the last sample and a cut is added.
//!
//! `shaders/lib/edges.wgsl` computes the same, by one loop around one sample: every sample that a
//! shader takes at another place in its text is compiled once more.

use super::packet::{PacketSampler, SamplePacket};
use crate::math::lanes::*;
use std::f32::consts::{LN_2, LOG2_E};

/// Ratio of the densities of two samples below which the step between them is bisected.
pub(super) const EDGE_RATIO: f32 = 0.65;
/// Bisections of the step in which the density crosses a mean.
pub(super) const EDGE_STEPS: u32 = 4;
/// Samples that search a step for a layer thinner than it.
pub(super) const THIN_LAYER_SAMPLES: usize = LANES;
/// Optical depth of half a step from which on nothing behind it can be seen: 1/512 passes.
pub(super) const OPAQUE_DEPTH: f32 = 9.0;

/// The samples one step in front of eight samples, or behind them.
#[derive(Clone, Copy)]
pub(super) struct Neighbours<S: Simd> {
    /// Optical depths; 0 where nothing is visible.
    pub(super) depth: f32x8<S>,
    pub(super) value: f32x8<S>,
    pub(super) present: mask32x8<S>,
    /// Which have been sampled; the others lie where nothing is visible.
    pub(super) sampled: mask32x8<S>,
}

impl<S: Simd> Neighbours<S> {
    /// Neighbours that lie where nothing is visible.
    #[inline(always)]
    pub(super) fn invisible(simd: S) -> Self {
        let zero = f32x8::splat(simd, 0.0);
        let none = zero.simd_lt(zero);
        Self {
            depth: zero,
            value: zero,
            present: none,
            sampled: none,
        }
    }

    /// Takes some lanes from others.
    #[inline(always)]
    pub(super) fn insert(&mut self, lanes: mask32x8<S>, new: &Self) {
        self.depth = lanes.select(new.depth, self.depth);
        self.value = lanes.select(new.value, self.value);
        self.present = (lanes & new.present) | (self.present & !lanes);
        self.sampled = (lanes & new.sampled) | (self.sampled & !lanes);
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

/// Samples that have something to shade.
#[derive(Clone, Copy)]
pub(super) struct FoundSamples<S: Simd> {
    /// Rays that have found one.
    pub(super) lanes: mask32x8<S>,
    pub(super) sample: SamplePacket<S>,
    /// Their positions in the deformed scene.
    pub(super) deformed: Vec3x8<S>,
    /// Which are near a cut shape.
    pub(super) near_cut: mask32x8<S>,
    pub(super) previous: Neighbours<S>,
    pub(super) next: Neighbours<S>,
    /// Which have something opaque between them and the next sample.
    pub(super) hidden: mask32x8<S>,
    /// Which stand for a thin layer in front of them, if there is one.
    pub(super) thin: mask32x8<S>,
    /// Distances to the neighbours, mm.
    pub(super) spacing: f32x8<S>,
    /// Thicknesses of thin layers from the sample on, mm, and the densities around them.
    pub(super) layer: f32x8<S>,
    pub(super) floor: f32x8<S>,
}

/// Samples to store in [`FoundSamples`], with their neighbours.
pub(super) struct NewSamples<'a, S: Simd> {
    pub(super) sample: &'a SamplePacket<S>,
    pub(super) deformed: Vec3x8<S>,
    pub(super) near_cut: mask32x8<S>,
    pub(super) previous: Neighbours<S>,
    pub(super) next: Neighbours<S>,
}

impl<S: Simd> FoundSamples<S> {
    /// No sample yet; `anywhere` fills the lanes that have none.
    #[inline(always)]
    pub(super) fn nothing(simd: S, anywhere: Vec3x8<S>, spacing: f32x8<S>, with_gradients: bool) -> Self {
        let zero = f32x8::splat(simd, 0.0);
        let none = zero.simd_lt(zero);
        Self {
            lanes: none,
            sample: SamplePacket::absent(simd, anywhere, with_gradients),
            deformed: anywhere,
            near_cut: none,
            previous: Neighbours::invisible(simd),
            next: Neighbours::invisible(simd),
            hidden: none,
            thin: none,
            spacing,
            layer: zero,
            floor: zero,
        }
    }

    /// Stores the samples of some lanes.
    #[inline(always)]
    pub(super) fn insert(&mut self, hit: mask32x8<S>, new: &NewSamples<S>) {
        self.sample.insert(hit, new.sample);
        self.deformed = Vec3x8::select(hit, new.deformed, self.deformed);
        self.near_cut = (hit & new.near_cut) | (self.near_cut & !hit);
        self.previous.insert(hit, &new.previous);
        self.next.insert(hit, &new.next);
        self.lanes |= hit;
    }

    /// Stores samples that may have a thin layer in front of them.
    #[inline(always)]
    pub(super) fn insert_layers(&mut self, thin: mask32x8<S>, new: &NewSamples<S>) {
        if thin.any_true() {
            self.insert(thin, new);
            self.thin |= thin;
        }
    }
}

/// Where eight rays enter the material, else the samples themselves.
#[derive(Clone, Copy)]
pub(super) struct SurfaceEntries<S: Simd> {
    pub(super) deformed: Vec3x8<S>,
    pub(super) in_voxel: Vec3x8<S>,
    pub(super) value: f32x8<S>,
    pub(super) inside: mask32x8<S>,
}

impl<S: Simd> SurfaceEntries<S> {
    /// Some lanes of one, the others of another.
    #[inline(always)]
    fn select(lanes: mask32x8<S>, yes: &Self, no: &Self) -> Self {
        Self {
            deformed: Vec3x8::select(lanes, yes.deformed, no.deformed),
            in_voxel: Vec3x8::select(lanes, yes.in_voxel, no.in_voxel),
            value: lanes.select(yes.value, no.value),
            inside: (lanes & yes.inside) | (no.inside & !lanes),
        }
    }
}

/// The mean depth to which one sees into a uniform stretch of an optical depth (powers of e), as a
/// share of its length: 1/2 if it is thin, near 0 if it is opaque.
#[inline(always)]
fn mean_depth_seen<S: Simd>(optical_depth: f32x8<S>) -> f32x8<S> {
    let thin = optical_depth * (-1.0 / 12.0) + 0.5;
    let passed = exp2(optical_depth.min(60.0) * LOG2_E) - 1.0;
    let thick = (passed - optical_depth) / (optical_depth * passed);
    optical_depth.simd_lt(0.1).select(thin, thick)
}

/// What eight samples represent, and where they are shaded.
pub(super) struct SampleExtents<S: Simd> {
    /// Optical depths of what they represent, over a step of their own density.
    pub(super) share: f32x8<S>,
    pub(super) entry: SurfaceEntries<S>,
    /// Gradients per voxel there, if they come with the values.
    pub(super) gradient: Option<Vec3x8<S>>,
    /// Which rays enter material in front of their sample.
    pub(super) entered: mask32x8<S>,
    /// Which of them come out of a cut or into the volume, as opposed to out of thinner material.
    pub(super) through_cut: mask32x8<S>,
}

/// A stretch of eight rays at whose ends the density lies on different sides of a threshold.
struct Bracket<S: Simd> {
    /// The near ends.
    start: SurfaceEntries<S>,
    /// Unit directions to the far ends.
    direction: Vec3x8<S>,
    /// The densities at the near ends, and at the far ends, and which of these are present.
    depth: f32x8<S>,
    far_depth: f32x8<S>,
    far_present: mask32x8<S>,
    /// Lengths, mm.
    width: f32x8<S>,
    /// The thresholds.
    enough: f32x8<S>,
    /// Which are denser at the near end.
    dense_here: mask32x8<S>,
    /// Which are wanted.
    lanes: mask32x8<S>,
    /// Which may cross a cut shape.
    near_shape: mask32x8<S>,
}

/// Where a density crosses a threshold.
struct Crossing<S: Simd> {
    /// Distances from the near ends, mm.
    distance: f32x8<S>,
    /// Integrals of the density over the stretch, mm times density.
    integral: f32x8<S>,
    /// The last points found on the near side, and their densities.
    last: SurfaceEntries<S>,
    last_depth: f32x8<S>,
    /// Which of the first points on the far side are present, and which of them were found within
    /// the stretch.
    far_present: mask32x8<S>,
    far_found: mask32x8<S>,
}

/// Whether the steps between samples of these densities are bisected.
#[inline(always)]
fn differs<S: Simd>(depth: f32x8<S>, other: f32x8<S>) -> mask32x8<S> {
    depth.min(other).simd_lt(depth.max(other) * EDGE_RATIO)
}

/// Where a mask cuts away, but not wholly.
#[inline(always)]
fn within_mask<S: Simd>(alpha: f32x8<S>) -> mask32x8<S> {
    alpha.simd_gt(0.0) & alpha.simd_lt(0.5)
}

impl<S: Simd> Bracket<S> {
    /// The length of the stretch, mm, that samples at its near end represent, by their own density.
    /// The thinner neighbour represents what lies on its side of the crossing, and the denser one
    /// the rest of the optical depth.
    #[inline(always)]
    fn of_sample(&self, found: &Crossing<S>) -> f32x8<S> {
        let of_neighbour = self.far_depth * (self.width - found.distance);
        let rest = (found.integral - of_neighbour).max(0.0) / self.depth;
        let rest = self.depth.simd_gt(1e-20).select(rest, found.distance);
        self.dense_here.select(rest, found.distance)
    }
}

impl PacketSampler<'_> {
    /// As [`Self::sample_points`] without gradients, cut shapes included; not inlined: one copy for
    /// all samples that are taken seldom, where a copy each would double the size of the program.
    #[inline(never)]
    pub(super) fn sample_points_apart<S: Simd>(
        &self,
        simd: S,
        p: &Vec3x8<S>,
        lanes: &mask32x8<S>,
        near_shape: &mask32x8<S>,
    ) -> SamplePacket<S> {
        simd.vectorize(
            #[inline(always)]
            || {
                let mut sample = self.sample_points(simd, *p, *lanes, false);
                for n in lanes_of((*lanes & *near_shape).to_bitmask()) {
                    if self.scene.cuts.signed_distance_mm(p.lane(n)) < 0.0 {
                        sample.present.set(n, false);
                        sample.depth[n] = 0.0;
                        sample.alpha[n] = 0.0;
                    }
                }
                sample
            },
        )
    }

    /// Which samples show something, apart from the grey faces of cuts.
    #[inline(always)]
    pub(super) fn is_visible<S: Simd>(&self, sample: &SamplePacket<S>) -> mask32x8<S> {
        match self.scene.volume().iso {
            Some(iso) => sample.present & sample.value.simd_ge(iso),
            None => sample.depth.simd_gt(0.0),
        }
    }

    /// Samples neighbours; also returns their masks.
    #[inline(always)]
    pub(super) fn neighbours<S: Simd>(
        &self,
        simd: S,
        p: Vec3x8<S>,
        lanes: mask32x8<S>,
        near_shape: mask32x8<S>,
    ) -> (Neighbours<S>, f32x8<S>) {
        let at = self.sample_points_apart(simd, &p, &lanes, &near_shape);
        let neighbours = Neighbours {
            depth: lanes.select(at.depth, f32x8::splat(simd, 0.0)),
            value: at.value,
            present: at.present,
            sampled: lanes,
        };
        (neighbours, at.alpha)
    }

    /// Whether a cut or a face of the volume passes between samples and the previous ones, and both
    /// of them are so thin that a layer thinner than a step may lie between them. `own_depth`: the
    /// densities of the samples themselves.
    #[inline(always)]
    pub(super) fn may_hide_a_layer<S: Simd>(
        &self,
        sample: &SamplePacket<S>,
        own_depth: f32x8<S>,
        previous: &Neighbours<S>,
        previous_alpha: f32x8<S>,
    ) -> mask32x8<S> {
        let thin = match self.scene.volume().iso {
            Some(iso) => {
                !(previous.present & previous.value.simd_ge(iso) | sample.present & sample.value.simd_ge(iso))
            }
            None => own_depth.max(previous.depth).simd_lt(self.thin_depth),
        };
        let one_present = previous.present ^ sample.present;
        let none_present = !(previous.present | sample.present);
        let masked = within_mask(previous_alpha) & within_mask(sample.alpha);
        previous.sampled & thin & (one_present | (none_present & masked))
    }

    /// Which samples have a mask's edge, a cut shape or a face of the volume near.
    #[inline(always)]
    pub(super) fn near_edge<S: Simd>(
        &self,
        sample: &SamplePacket<S>,
        near_shape: mask32x8<S>,
    ) -> mask32x8<S> {
        let at_mask = sample.alpha.simd_gt(0.0) & sample.alpha.simd_lt(1.0);
        let top = self.scene.volume().grid_size - 0.5;
        let margin = self.deformed_face_margin_voxels;
        let at = sample.in_voxel;
        let reached = within(at.x, -0.5 - margin.x, top.x + margin.x)
            & within(at.y, -0.5 - margin.y, top.y + margin.y)
            & within(at.z, -0.5 - margin.z, top.z + margin.z);
        let inner = within(at.x, margin.x - 0.5, top.x - margin.x)
            & within(at.y, margin.y - 0.5, top.y - margin.y)
            & within(at.z, margin.z - 0.5, top.z - margin.z);
        // What a shape removes has no source position.
        at_mask | near_shape | (sample.alpha.simd_gt(0.0) & reached & !inner)
    }

    /// Searches the steps in front of some of the samples found for a layer more than twice as dense
    /// as the sample and the previous one (of an iso-surface: for a visible one). Where there is one, it replaces the sample, and the
    /// points around it the neighbours; else nothing is found.
    #[inline(never)]
    pub(super) fn find_thin_layers<S: Simd>(
        &self,
        simd: S,
        rays: &ShadingRays<S>,
        found: &mut FoundSamples<S>,
    ) {
        simd.vectorize(
            #[inline(always)]
            || {
                for n in lanes_of(found.thin.to_bitmask()) {
                    self.find_thin_layer(simd, rays, found, n);
                }
            },
        );
    }

    #[inline(always)]
    fn find_thin_layer<S: Simd>(
        &self,
        simd: S,
        rays: &ShadingRays<S>,
        found: &mut FoundSamples<S>,
        n: usize,
    ) {
        let (direction, step) = (rays.direction.lane(n), rays.step[n]);
        let start = found.deformed.lane(n) - direction * step;
        let spacing = step / THIN_LAYER_SAMPLES as f32;
        let along = f32x8::load_array(simd, std::array::from_fn(|k| (k as f32 + 0.5) * spacing));
        let p = Vec3x8::splat(simd, start) + Vec3x8::splat(simd, direction) * along;
        let all = along.simd_gt(0.0);
        let near_shape = if self.scene.cuts.is_empty() { !all } else { all };
        let samples = self.sample_points_apart(simd, &p, &all, &near_shape);
        let floor = found.sample.depth[n].max(found.previous.depth[n]);
        let dense = match self.scene.volume().iso {
            Some(_) => self.is_visible(&samples),
            None => samples.depth.simd_gt(2.0 * floor),
        };
        let visible = dense.to_bitmask();
        if visible == 0 {
            found.lanes.set(n, false);
            return;
        }
        let first = visible.trailing_zeros() as usize;
        let last = first + (visible >> first).trailing_ones() as usize - 1;
        let present = |k: usize| samples.present.test(k);
        let before = if first > 0 {
            present(first - 1)
        } else {
            found.previous.present.test(n)
        };
        let after = if last + 1 < LANES {
            present(last + 1)
        } else {
            found.sample.present.test(n)
        };
        let at = &mut found.sample;
        at.in_voxel.set(n, samples.in_voxel.lane(first));
        (at.value[n], at.front[n], at.depth[n], at.alpha[n]) = (
            samples.value[first],
            samples.value[first],
            samples.depth[first],
            samples.alpha[first],
        );
        at.present.set(n, true);
        at.inside.set(n, samples.inside.test(first));
        found.deformed.set(n, p.lane(first));
        found.spacing[n] = spacing;
        found.layer[n] = (last - first) as f32 * spacing;
        // The samples around it represent the rest.
        found.floor[n] = floor;
        for (neighbour, present) in [(&mut found.previous, before), (&mut found.next, after)] {
            neighbour.depth[n] = floor;
            neighbour.present.set(n, present);
            neighbour.sampled.set(n, true);
        }
    }

    /// What visible samples represent, and where their rays enter material.
    #[inline(always)]
    pub(super) fn extents<S: Simd>(
        &self,
        simd: S,
        rays: &ShadingRays<S>,
        found: &FoundSamples<S>,
        visible: mask32x8<S>,
    ) -> SampleExtents<S> {
        let FoundSamples {
            sample,
            deformed,
            previous,
            next,
            spacing,
            ..
        } = found;
        let own = SurfaceEntries {
            deformed: *deformed,
            in_voxel: sample.in_voxel,
            value: sample.value,
            inside: sample.inside,
        };
        let none = visible & !visible;
        let depth = sample.depth;
        // Samples of pre-integrated segments represent what is in front of them.
        let segment = if self.preintegrated.is_some() {
            !found.thin
        } else {
            none
        };
        let zero = f32x8::splat(simd, 0.0);
        let half = *spacing * 0.5;
        let mut extents = SampleExtents {
            share: zero,
            entry: own,
            gradient: None,
            entered: none,
            through_cut: none,
        };
        let (mut before, mut behind) = (segment.select(*spacing, half), segment.select(zero, half));
        extents.entered = visible & previous.depth.simd_lt(depth * 0.5);
        let crossed = extents.entered | (visible & differs(depth, previous.depth) & !segment);
        if crossed.any_true() {
            before = self.front_edge(simd, rays, found, (crossed, segment), before, &mut extents);
        }
        let crossed = visible
            & !found.hidden
            & self.sees_behind(sample, rays.step)
            & ((!segment & differs(depth, next.depth)) | (segment & next.sampled & !next.present));
        if crossed.any_true() {
            let bracket = Bracket {
                start: SurfaceEntries {
                    deformed: *deformed + rays.direction * found.layer,
                    ..own
                },
                direction: rays.direction,
                width: *spacing,
                depth,
                far_depth: next.depth,
                far_present: next.present,
                enough: (depth + next.depth) * 0.5,
                dense_here: next.depth.simd_lt(depth) | segment,
                lanes: crossed,
                near_shape: found.near_cut,
            };
            let back = self.crossing(simd, &bracket);
            behind = crossed.select(bracket.of_sample(&back), behind);
        }
        let length = before + found.layer + behind;
        extents.share = length / rays.step;
        if extents.entered.any_true() {
            self.move_to_mean_depth(simd, rays, found, length, &mut extents);
        }
        extents
    }

    /// Moves the points at which rays enter material to the mean depth to which one sees into it; at
    /// a cut only the material, not the light.
    #[inline(always)]
    fn move_to_mean_depth<S: Simd>(
        &self,
        simd: S,
        rays: &ShadingRays<S>,
        found: &FoundSamples<S>,
        length: f32x8<S>,
        extents: &mut SampleExtents<S>,
    ) {
        let per_mm = LN_2 / self.scene.frame.spacing.reference_mm;
        let reach = length * mean_depth_seen(found.sample.depth * length * per_mm);
        let point = extents.entry.deformed + rays.direction * reach;
        let there = self.sample_points_apart(simd, &point, &extents.entered, &found.near_cut);
        let seen = SurfaceEntries {
            deformed: Vec3x8::select(extents.through_cut, extents.entry.deformed, point),
            in_voxel: there.in_voxel,
            value: there.value,
            inside: extents.entry.inside & there.inside,
        };
        let lanes = extents.entered & there.present;
        extents.entry = SurfaceEntries::select(lanes, &seen, &extents.entry);
    }

    /// Where the density changes in front of samples: the lengths in front of them, mm, and in
    /// `extents` where rays enter material, and through what.
    ///
    /// What lies directly behind a cut is the face of the cut, if it is at least half as dense as
    /// the material half a voxel farther on; else the ray enters a surface of the material's own
    /// behind the cut. Neither depends on where the samples fall.
    #[inline(always)]
    fn front_edge<S: Simd>(
        &self,
        simd: S,
        rays: &ShadingRays<S>,
        found: &FoundSamples<S>,
        (crossed, segment): (mask32x8<S>, mask32x8<S>),
        mut before: f32x8<S>,
        extents: &mut SampleExtents<S>,
    ) -> f32x8<S> {
        let (previous, depth, entered) = (&found.previous, found.sample.depth, extents.entered);
        let own = extents.entry;
        let from_cut = entered & previous.sampled & !previous.present;
        let mut bracket = Bracket {
            start: own,
            depth,
            far_depth: previous.depth,
            far_present: previous.present,
            direction: -rays.direction,
            width: found.spacing,
            enough: from_cut.select(f32x8::splat(simd, -1.0), (depth + previous.depth) * 0.5),
            dense_here: previous.depth.simd_lt(depth),
            lanes: crossed,
            near_shape: found.near_cut,
        };
        let front = self.crossing(simd, &bracket);
        let of_sample = bracket.of_sample(&front);
        before = (crossed & !(segment & previous.present)).select(of_sample, before);
        extents.entry = SurfaceEntries::select(entered, &front.last, &own);
        extents.through_cut = entered & !front.far_present;
        let unknown = entered & !front.far_found & !previous.sampled;
        if unknown.any_true() {
            let point = own.deformed - rays.direction * found.spacing;
            let there = self.sample_points_apart(simd, &point, &unknown, &found.near_cut);
            extents.through_cut &= !(unknown & there.present);
        }
        if from_cut.any_true() {
            let half_voxel = f32x8::splat(simd, 0.5 * self.scene.frame.spacing.reference_mm);
            let point = extents.entry.deformed + rays.direction * half_voxel;
            let inside = self.sample_points_apart(simd, &point, &from_cut, &found.near_cut);
            let behind = from_cut & front.last_depth.simd_lt(inside.depth * 0.5);
            if behind.any_true() {
                extents.through_cut &= !behind;
                bracket.width = (own.deformed - extents.entry.deformed).dot(rays.direction);
                bracket.enough = depth * 0.5;
                (bracket.far_depth, bracket.far_present) = (front.last_depth, behind);
                bracket.lanes = behind;
                let surface = self.crossing(simd, &bracket);
                extents.entry = SurfaceEntries::select(behind, &surface.last, &extents.entry);
            }
        }
        before
    }

    /// Through which samples anything behind them can be seen: half a step of them is not opaque.
    #[inline(always)]
    pub(super) fn sees_behind<S: Simd>(&self, sample: &SamplePacket<S>, step: f32x8<S>) -> mask32x8<S> {
        let half_step = step * (0.5 / self.scene.frame.spacing.reference_mm);
        let depth = if self.gradient_opacity {
            half_step * 0.0
        } else {
            sample.depth * half_step
        };
        depth.simd_lt(OPAQUE_DEPTH)
    }

    /// Where the density crosses a threshold, by bisection.
    #[inline(never)]
    fn crossing<S: Simd>(&self, simd: S, bracket: &Bracket<S>) -> Crossing<S> {
        simd.vectorize(
            #[inline(always)]
            || {
                let Bracket {
                    start,
                    depth,
                    far_depth,
                    far_present,
                    direction,
                    width,
                    enough,
                    dense_here,
                    lanes,
                    near_shape,
                } = *bracket;
                let none = lanes & !lanes;
                let zero = f32x8::splat(simd, 0.0);
                let (mut near, mut far) = (zero, width);
                let mut crossing = Crossing {
                    distance: zero,
                    integral: zero,
                    last: start,
                    last_depth: depth,
                    far_present,
                    far_found: none,
                };
                let mut far_depth = far_depth;
                // What is denser than both ends is a layer of its own.
                let cap = depth.max(far_depth);
                for _ in 0..EDGE_STEPS {
                    let middle = (near + far) * 0.5;
                    let p = start.deformed + direction * middle;
                    let there = self.sample_points_apart(simd, &p, &lanes, &near_shape);
                    let dense = there.present & there.depth.simd_ge(enough);
                    let on_near_side = !(dense ^ dense_here);
                    // The half without the crossing is integrated by the trapezoidal rule.
                    let other = on_near_side.select(crossing.last_depth, far_depth);
                    crossing.integral += (far - near) * 0.25 * (other.min(cap) + there.depth.min(cap));
                    near = on_near_side.select(middle, near);
                    far = on_near_side.select(far, middle);
                    let near_point = SurfaceEntries {
                        deformed: p,
                        in_voxel: there.in_voxel,
                        value: there.value,
                        inside: there.inside,
                    };
                    crossing.last = SurfaceEntries::select(on_near_side, &near_point, &crossing.last);
                    crossing.last_depth = on_near_side.select(there.depth, crossing.last_depth);
                    crossing.far_present =
                        (crossing.far_present & on_near_side) | (there.present & !on_near_side);
                    crossing.far_found |= !on_near_side;
                    far_depth = on_near_side.select(far_depth, there.depth);
                }
                // Between two points of the material the density is interpolated.
                let drop = crossing.last_depth - far_depth;
                let part = ((crossing.last_depth - enough) / drop).max(0.0).min(1.0);
                let known = crossing.far_present & far.simd_lt(bracket.width) & drop.abs().simd_gt(1e-6);
                let part = known.select(part, f32x8::splat(simd, 0.5));
                let width = far - near;
                crossing.distance = near + width * part;
                // In front of what is not present the density is that of the near end.
                let [last_depth, far_depth] = [crossing.last_depth.min(cap), far_depth.min(cap)];
                let near_end = known.select((last_depth + enough) * 0.5, last_depth);
                let far_end = known.select((far_depth + enough) * 0.5, far_depth);
                crossing.integral += width * (part * near_end + (-part + 1.0) * far_end);
                crossing
            },
        )
    }
}
