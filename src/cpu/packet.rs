//! Samples eight points of the deformed scene at once, and computes their distances to the volume's
//! faces.

use super::SceneSample;
use crate::math::lanes::*;
use crate::prepare::Prepared;
use crate::transfer::{Blend, Preintegrated};
use crate::volume::VolumeSampler;
use glam::{Mat3, Vec3};

/// The samples at eight points of the deformed scene; see [`super::SceneSample`].
#[derive(Clone, Copy)]
pub(super) struct SamplePacket<S: Simd> {
    pub(super) in_voxel: Vec3x8<S>,
    pub(super) value: f32x8<S>,
    pub(super) present: mask32x8<S>,
    pub(super) alpha: f32x8<S>,
    /// Optical depth per reference length; 0 where nothing is present.
    pub(super) depth: f32x8<S>,
    /// The value at the segment's front end, if segments are pre-integrated.
    pub(super) front: f32x8<S>,
    /// Which lie inside the cube of any map.
    pub(super) inside: mask32x8<S>,
    /// Which lie in a macrocell that no cut affects.
    pub(super) cut_free: mask32x8<S>,
    /// Differences of stored values, and colours by the transfer function, if they were fetched.
    pub(super) differences: Vec3x8<S>,
    pub(super) color: Vec3x8<S>,
    /// Whether they were fetched.
    pub(super) with_gradients: bool,
}

/// Samples packets of points of one picture.
pub struct PacketSampler<'a> {
    pub(super) scene: &'a Prepared<'a>,
    pub(super) sampler: &'a VolumeSampler<'a>,
    /// Distance from the volume's faces, in voxels along each axis, within which these have an
    /// effect.
    pub(super) face_margin_voxels: Vec3,
    /// The same under any deformation of the faces.
    pub(super) deformed_face_margin_voxels: Vec3,
    /// The same for cuts, mm.
    pub(super) margin_mm: f32,
    /// See [`Prepared::thin_depth`].
    pub(super) thin_depth: f32,
    /// Transforms a covector per voxel to one per mm.
    pub(super) world_from_covector: Mat3,
    /// Whether samples are composited; projections need only values.
    pub(super) composite: bool,
    pub(super) grey_faces: bool,
    pub(super) lit: bool,
    pub(super) gradient_opacity: bool,
    /// Whether visible samples are interpolated by cubic splines.
    pub(super) cubic: bool,
    /// The table indexed by the values at both ends of a step, if pre-integrated.
    pub(super) preintegrated: Option<Preintegrated>,
}

impl<'a> PacketSampler<'a> {
    /// Computes everything that does not depend on the ray.
    pub fn new(scene: &'a Prepared, sampler: &'a VolumeSampler<'a>) -> Self {
        let world_from_covector = Mat3::from(scene.volume().voxel_from_world.matrix3).transpose();
        Self {
            scene,
            sampler,
            face_margin_voxels: scene.face_margin_voxels(),
            deformed_face_margin_voxels: scene.deformed_face_margin_voxels(),
            margin_mm: scene.cut_margin_mm(),
            thin_depth: scene.thin_depth(),
            world_from_covector,
            composite: scene.volume().blend == Blend::Composite,
            grey_faces: scene.grey_faces(),
            lit: scene.is_lit(),
            gradient_opacity: scene.uses_gradient_opacity(),
            cubic: scene.is_cubic(),
            preintegrated: scene.preintegrated().then(|| {
                Preintegrated::new(
                    &scene.volume().table,
                    scene.frame.spacing.step_mm / scene.frame.spacing.reference_mm,
                )
            }),
        }
    }

    /// Colour and optical depth of the segment between two values.
    pub(super) fn segment(&self, table: &Preintegrated, front: f32, back: f32) -> [f32; 4] {
        let place = |value: f32| value * self.scene.volume().table.scale + self.scene.volume().table.offset;
        table.lookup(place(front), place(back))
    }

    /// Samples eight points, of which only those in `lanes` are needed; `with_gradients` also
    /// fetches differences and colours. Does not evaluate analytic cut shapes.
    #[inline(always)]
    pub(super) fn sample_points<S: Simd>(
        &self,
        simd: S,
        p: Vec3x8<S>,
        lanes: mask32x8<S>,
        with_gradients: bool,
    ) -> SamplePacket<S> {
        let walk = self.scene.stack.source_and_alpha_lanes(simd, p, lanes);
        let in_voxel = walk.source.transformed(&self.scene.volume().voxel_from_world);
        let top = self.scene.volume().grid_size - 0.5;
        let mut present = lanes
            & walk.alpha.simd_ge(0.5)
            & within(in_voxel.x, -0.5, top.x)
            & within(in_voxel.y, -0.5, top.y)
            & within(in_voxel.z, -0.5, top.z);
        let none = Vec3x8::splat(simd, Vec3::ZERO);
        let (value, differences) = if with_gradients {
            self.sampler.sample_with_differences(simd, in_voxel)
        } else {
            (self.sampler.sample_lanes(simd, in_voxel), none)
        };
        if self.scene.volume().grid.has_holes {
            present &= value.simd_ge(-1e-4);
        }
        let table = &self.scene.volume().table;
        let (color, depth) = if with_gradients {
            table.lookup_lanes(simd, value)
        } else {
            (none, table.depth_lanes(simd, value))
        };
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

    /// The nearest of the volume's faces outside all maps: distances, mm, and normals out of the
    /// volume.
    #[inline(always)]
    pub(super) fn nearest_face<S: Simd>(&self, simd: S, in_voxel: Vec3x8<S>) -> (f32x8<S>, Vec3x8<S>) {
        let none = (f32x8::splat(simd, f32::INFINITY), Vec3x8::splat(simd, Vec3::ZERO));
        let nearest = self.nearer_face(simd, in_voxel.x, 0, none);
        let nearest = self.nearer_face(simd, in_voxel.y, 1, nearest);
        self.nearer_face(simd, in_voxel.z, 2, nearest)
    }

    /// Which points are farther from the volume's faces than the given voxels along each axis.
    #[inline(always)]
    pub(super) fn far_from_faces<S: Simd>(&self, p: Vec3x8<S>, voxels: Vec3x8<S>) -> mask32x8<S> {
        let top = self.scene.volume().grid_size - 0.5;
        let above = p.x.simd_gt(voxels.x - 0.5) & p.y.simd_gt(voxels.y - 0.5) & p.z.simd_gt(voxels.z - 0.5);
        above
            & p.x.simd_lt(-voxels.x + top.x)
            & p.y.simd_lt(-voxels.y + top.y)
            & p.z.simd_lt(-voxels.z + top.z)
    }

    /// The nearer of the given faces and the two across an axis.
    #[inline(always)]
    pub(super) fn nearer_face<S: Simd>(
        &self,
        simd: S,
        x: f32x8<S>,
        axis: usize,
        (nearest, normal): (f32x8<S>, Vec3x8<S>),
    ) -> (f32x8<S>, Vec3x8<S>) {
        let (low, high) = (x + 0.5, -x + (self.scene.volume().grid_size[axis] - 0.5));
        let covector = self.world_from_covector.col(axis);
        let (inside, slope) = (low.min(high), covector.length());
        let nearer = inside.simd_lt(nearest * slope);
        let outward = Vec3x8::splat(simd, covector / -slope);
        (
            nearer.select(inside / slope, nearest),
            Vec3x8::select(
                nearer,
                Vec3x8::select(low.simd_lt(high), outward, -outward),
                normal,
            ),
        )
    }
}

impl<S: Simd> SamplePacket<S> {
    /// Nothing present; `anywhere` fills the positions.
    #[inline(always)]
    pub(super) fn absent(simd: S, anywhere: Vec3x8<S>, with_gradients: bool) -> Self {
        let zero = f32x8::splat(simd, 0.0);
        let none = zero.simd_lt(zero);
        Self {
            in_voxel: anywhere,
            value: zero,
            present: none,
            alpha: zero,
            depth: zero,
            front: zero,
            inside: none,
            cut_free: none,
            differences: anywhere,
            color: anywhere,
            with_gradients,
        }
    }

    /// Takes some lanes from another packet.
    #[inline(always)]
    pub(super) fn insert(&mut self, lanes: mask32x8<S>, new: &Self) {
        self.in_voxel = Vec3x8::select(lanes, new.in_voxel, self.in_voxel);
        self.value = lanes.select(new.value, self.value);
        self.present = (lanes & new.present) | (self.present & !lanes);
        self.alpha = lanes.select(new.alpha, self.alpha);
        self.depth = lanes.select(new.depth, self.depth);
        self.front = lanes.select(new.front, self.front);
        self.inside = (lanes & new.inside) | (self.inside & !lanes);
        self.cut_free = (lanes & new.cut_free) | (self.cut_free & !lanes);
        if self.with_gradients {
            self.differences = Vec3x8::select(lanes, new.differences, self.differences);
            self.color = Vec3x8::select(lanes, new.color, self.color);
        }
    }

    /// The sample of one lane, and its optical depth.
    #[inline(always)]
    pub(super) fn lane(&self, n: usize) -> (SceneSample, f32) {
        let sample = SceneSample {
            in_voxel: self.in_voxel.lane(n),
            value: self.value[n],
            present: self.present.test(n),
            alpha: self.alpha[n],
        };
        (sample, self.depth[n])
    }
}
