//! Coarse rays through a scene without deformations: where is its surface? For questions about a
//! scene, not for pictures: nearest voxels, steps of a voxel or more, no colours.

use super::objects::SurfaceObject;
use super::prepared::Prepared;
use crate::deform::StackAndCuts;
use crate::math::Bounds;
use glam::Vec3;

/// Most steps along a diagonal of the scene.
const MAX_STEPS: f32 = 600.0;
/// Part of a ray's light that its surface takes: what a viewer would point at.
const SURFACE_OPACITY: f32 = 0.3;
/// A ray that loses less in all shows nothing.
const MIN_OPACITY: f32 = 0.05;

/// Rays through a scene.
pub(super) struct CoarseRays<'a> {
    scene: &'a Prepared<'a>,
    bounds: Bounds,
    step_mm: f32,
}

/// The box of a surface, before deformations.
pub(super) fn bounds_of(object: &SurfaceObject) -> Bounds {
    match (&object.triangles, &object.implicit) {
        (Some(t), _) => t.mesh.bounds(),
        (None, Some(implicit)) => implicit.bounds(),
        (None, None) => Bounds::EMPTY,
    }
}

impl<'a> CoarseRays<'a> {
    /// Rays through a scene whose deformations, if any, only hide parts of it.
    pub fn new(scene: &'a Prepared<'a>) -> Self {
        let volume = if scene.shows_volume() {
            scene.frame.proxy
        } else {
            Bounds::EMPTY
        };
        let surfaces = scene.surfaces.objects.iter().map(bounds_of);
        let bounds = surfaces.fold(volume, |all, b| all.union(&b));
        Self {
            scene,
            bounds,
            step_mm: step_mm(scene, &bounds),
        }
    }

    /// The box around everything that may be visible, mm.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// The first visible point along a ray of unit direction, mm.
    pub fn first_hit(&self, origin: Vec3, direction: Vec3) -> Option<Vec3> {
        let on_surfaces = self
            .scene
            .surfaces
            .objects
            .iter()
            .filter_map(|object| self.surface_hit(object, origin, direction))
            .fold(f32::INFINITY, f32::min);
        let in_volume = self.volume_hit(origin, direction, on_surfaces);
        let t = in_volume.unwrap_or(on_surfaces);
        t.is_finite().then(|| origin + direction * t)
    }

    /// Where a ray has lost enough of its light in the volume, before a surface.
    fn volume_hit(&self, origin: Vec3, direction: Vec3, until: f32) -> Option<f32> {
        if !self.scene.shows_volume() {
            return None;
        }
        let (near, far) = self.scene.frame.proxy.intersect_ray(origin, direction)?;
        let (volume, far) = (self.scene.volume(), far.min(until));
        let inverse_direction = direction.recip();
        let per_step = self.step_mm / self.scene.frame.spacing.reference_mm;
        let deformation = StackAndCuts {
            stack: &self.scene.stack,
            cuts: &self.scene.cuts,
        };
        let mut t = near + 0.5 * self.step_mm;
        let mut transmittance = 1.0f32;
        // Where half of MIN_OPACITY was lost: the surface of something faint.
        let mut faint = None;
        while t < far {
            let p = origin + direction * t;
            if let Some(end) = volume.macrocells.empty_until(p, origin, inverse_direction) {
                t = end.max(t) + 0.5 * self.step_mm;
                continue;
            }
            if let Some(source) = deformation.source(p) {
                transmittance *= (-volume.depth_at(source) * per_step).exp2();
            }
            if transmittance < 1.0 - 0.5 * MIN_OPACITY {
                faint.get_or_insert(t);
            }
            if transmittance <= 1.0 - SURFACE_OPACITY {
                return Some(t - 0.5 * self.step_mm);
            }
            t += self.step_mm;
        }
        faint.filter(|_| transmittance <= 1.0 - MIN_OPACITY)
    }

    /// The first point of a surface.
    fn surface_hit(&self, object: &SurfaceObject, origin: Vec3, direction: Vec3) -> Option<f32> {
        if let Some(triangles) = &object.triangles {
            let hit = triangles
                .tree
                .ray(origin, direction, 0.0, f32::INFINITY, |_| true);
            return hit.map(|h| h.t);
        }
        let implicit = object.implicit.as_ref()?;
        let (near, far) = implicit.bounds().intersect_ray(origin, direction)?;
        let step = object.cell_mm.max(implicit.bounds().size().length() / MAX_STEPS);
        let mut t = near.max(0.0);
        while t <= far {
            let f = implicit.value(origin + direction * t);
            if f > 0.0 {
                return Some(t);
            }
            // A distance field is at least this far from its surface.
            t += if implicit.is_distance() {
                (-f).max(step)
            } else {
                step
            };
        }
        None
    }
}

/// The step of coarse rays through a box of a scene, mm.
pub(super) fn step_mm(scene: &Prepared, bounds: &Bounds) -> f32 {
    scene
        .frame
        .spacing
        .reference_mm
        .max(bounds.size().length() / MAX_STEPS)
        .max(1e-6)
}
