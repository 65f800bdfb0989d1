//! Deformations that change nothing in view, for a notice with the remedy.
//!
//! Rays compare the scene with and without a deformation: does a sample that can be seen come from
//! elsewhere, or appear, or vanish? Coarse rays find most changes after a few samples. Only if they
//! find none does a finer set of rays follow, so that a thin incision counts as a change.

use super::PrepareOptions;
use super::assets::Assets;
use super::coarse_rays::{bounds_of, step_mm};
use super::deformed::Deformed;
use super::prepared::Prepared;
use crate::Result;
use crate::deform::kinds;
use crate::math::Bounds;
use crate::scene::{Deformation, Scene};
use glam::Vec3;
use rayon::prelude::*;

/// Rays along each edge of the picture, coarse and fine.
const RAYS: [usize; 2] = [48, 224];
/// Points along each edge of the scene's box.
const POINTS: usize = 40;
/// Light below which the rest of a ray is not seen.
const MIN_TRANSMITTANCE: f32 = 0.02;
/// Optical depth per voxel below which a sample is not seen.
const MIN_DEPTH: f32 = 0.002;
/// Movement that is not seen, voxels.
const TOLERANCE: f32 = 0.25;

/// One sentence for every deformation of a scene without which its picture would be the same.
///
/// # Errors
/// Any invalid setting, by name.
pub fn unseen_deformations(scene: &Scene, assets: &Assets, prepared: &Prepared) -> Result<Vec<String>> {
    let mut exact = scene.clone();
    exact.render.precompose = None;
    let deformed = |scene: &Scene| -> Result<Deformed> {
        let view = scene.camera.frame(&assets.scene_box(), scene.render.size)?;
        let deformed = Deformed::in_view(scene, assets, &view, &PrepareOptions::default())?;
        deformed.stack.fetch_texels();
        Ok(deformed)
    };
    let enabled = scene.deformation.iter().enumerate().filter(|(_, d)| d.enabled);
    let mut notices = Vec::new();
    for (n, deformation) in enabled {
        let mut other = exact.clone();
        other.deformation[n].enabled = false;
        // A group or a sum may be incomplete without it.
        let Ok(without) = deformed(&other) else { continue };
        let pair = DeformedPair::new(prepared, [deformed(&exact)?, without], &assets.scene_box());
        if RAYS.into_iter().any(|rays| pair.differs_in_view(rays)) {
            continue;
        }
        let name = deformation.name.as_deref().unwrap_or(&deformation.kind);
        notices.push(format!(
            "deformation {} ({name}) changes nothing that can be seen: {}",
            n + 1,
            reason(deformation, pair.differs_anywhere())
        ));
    }
    Ok(notices)
}

/// Why a deformation changes nothing in view, and the remedy.
fn reason(deformation: &Deformation, changes_hidden: bool) -> String {
    if deformation.progress == Some(0.0) {
        return "its progress is 0; raise it".into();
    }
    let is_placed = kinds::kind(&deformation.kind).is_ok();
    let remedy = match (changes_hidden, is_placed) {
        (_, false) => "check its file, or move it with center",
        (true, true) => {
            "move or enlarge its box, or leave out center and size to place it on the visible surface"
        }
        (false, true) => {
            "move its box, raise its lengths, or leave out center and size to place it on the visible surface"
        }
    };
    let problem = if changes_hidden {
        "it acts only behind the visible surface or outside the picture"
    } else {
        "it neither moves nor cuts anything that is visible"
    };
    format!("{problem}; {remedy}")
}

/// A scene with a deformation and without it.
struct DeformedPair<'a> {
    scene: &'a Prepared<'a>,
    both: [Deformed; 2],
    bounds: Bounds,
    step_mm: f32,
}

impl<'a> DeformedPair<'a> {
    fn new(scene: &'a Prepared<'a>, both: [Deformed; 2], scene_box: &Bounds) -> Self {
        let of_one = |d: &Deformed| d.stack.deformed_bounds(scene_box);
        let bounds = of_one(&both[0]).union(&of_one(&both[1]));
        let step_mm = step_mm(scene, &bounds);
        Self {
            scene,
            both,
            bounds,
            step_mm,
        }
    }

    /// What the two show at a point of the deformed scene: optical depths per voxel, and whether
    /// they differ visibly.
    fn at(&self, p: Vec3) -> ([f32; 2], bool) {
        let volume = self.scene.volume();
        let sources = [0, 1].map(|n| self.both[n].stack_and_cuts().source(p));
        let depth = |source: Vec3| {
            let is_solid = |o: &super::objects::SurfaceObject| !o.rigid && o.contains(source);
            if self.scene.surfaces.objects.iter().any(is_solid) {
                f32::INFINITY
            } else if self.scene.shows_volume() {
                volume.depth_at(source)
            } else {
                0.0
            }
        };
        let depths = match sources {
            [Some(a), Some(b)] if a == b => [depth(a); 2],
            _ => sources.map(|s| s.map_or(0.0, depth)),
        };
        let shown = depths.map(|d| d > MIN_DEPTH);
        let moved = match sources {
            [Some(a), Some(b)] => a.distance(b) > TOLERANCE * self.scene.frame.spacing.reference_mm,
            _ => false,
        };
        (depths, shown[0] != shown[1] || shown[0] && moved)
    }

    /// Whether the two differ along any of the picture's rays.
    fn differs_in_view(&self, rays: usize) -> bool {
        // Rays start in the middle, where a change is most likely.
        let mut all: Vec<usize> = (0..rays * rays).collect();
        let from_middle = |n: &usize| {
            let [x, y] = [n % rays, n / rays].map(|i| (2 * i + 1).abs_diff(rays));
            x.max(y)
        };
        all.sort_by_key(from_middle);
        all.into_par_iter().any(|n| {
            let [u, v] = [n % rays, n / rays].map(|i| (2 * i + 1) as f32 / rays as f32 - 1.0);
            self.differs_along(u, v)
        })
    }

    fn differs_along(&self, u: f32, v: f32) -> bool {
        let (origin, direction) = self.scene.frame.view.ray(u, v);
        let Some((near, far)) = self.bounds.intersect_ray(origin, direction) else {
            return false;
        };
        // Surfaces that are not deformed, or not there, end the ray.
        let until = self
            .scene
            .surfaces
            .objects
            .iter()
            .filter(|o| o.rigid || o.implicit.is_none())
            .filter_map(|o| {
                let triangles = o.triangles.as_ref()?;
                triangles
                    .tree
                    .ray(origin, direction, 0.0, f32::INFINITY, |_| true)
            })
            .map(|hit| hit.t)
            .fold(far, f32::min);
        let per_step = self.step_mm / self.scene.frame.spacing.reference_mm;
        let mut t = near + 0.5 * self.step_mm;
        let mut transmittance = 1.0f32;
        while t < until && transmittance > MIN_TRANSMITTANCE {
            let (depths, differs) = self.at(origin + direction * t);
            if differs {
                return true;
            }
            transmittance *= (-depths[0] * per_step).exp2();
            t += self.step_mm;
        }
        false
    }

    /// Whether the two differ at any point of a grid over the scene.
    fn differs_anywhere(&self) -> bool {
        let surfaces = self.scene.surfaces.objects.iter().map(bounds_of);
        let all = surfaces.fold(self.bounds, |all, b| all.union(&b));
        (0..POINTS * POINTS * POINTS).into_par_iter().any(|n| {
            let at = [n % POINTS, n / POINTS % POINTS, n / POINTS / POINTS];
            let share = Vec3::from(at.map(|i| (i as f32 + 0.5) / POINTS as f32));
            self.at(all.min + all.size() * share).1
        })
    }
}
