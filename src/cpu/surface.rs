//! Traces rays through surfaces: signed distance fields under deformation, and triangles where nothing
//! deforms them (\[DS07\]; [`crate::model`], "Surfaces").
//!
//! *Theory*: a ray passes through the deformed scene. Every sample is carried back through the
//! stack; the first sign change of the source's field is a hit, refined by bisection. The mask
//! decides whether the hit counts. On a hollow surface a hit in a cut is ignored. In a solid one
//! the ray then searches for the surface of the cut itself, where f is positive behind it. A thick
//! skin is the solid of f̂ = τ - f where f > τ/2 (\[DS07\] eq 7).
//!
//! *Differences from the paper*:
//! - Both sign changes within a step, the surface's and the cut's, are found and taken in their
//!   order along the ray. The edge between them is sharp however long the step.
//! - *Jacobian* steps are those of eq 4, δt = δs / |J v| at the sample, within [δs/8, 8 δs].
//!   *Jacobian-bound* steps divide by a bound on |J v| over the ray's current cell
//!   (`deform::lipschitz`) instead: a narrow pull between two samples is not stepped over.
//! - *Sphere* steps: a distance of |f| divided by the same bound contains no surface. Where a step
//!   is longer than that, both of its ends tell whether the surface may lie between them, and
//!   samples are added until it cannot: no thin part is stepped over, however long the step. Inside
//!   a cut, where the next hit is the cut's own surface, steps are even.
//! - Empty cells are skipped: those emptied by a mask (\[DS07\] 6.2, with the distance to the
//!   nearest non-empty cell in place of a distance field of the cut), and those that the field
//!   itself shows to be far from its surface.
//!
//! Triangles outside the deformations' boxes are also intersected by rays: at a pixel's centre this
//! equals rasterisation.
//!
//! `shaders/surface.wgsl` and `shaders/lib/surface.wgsl` compute the same.

use crate::deform::{Jet, NearestCut};
use crate::math::normalize_or;
use crate::mesh::MeshHit;
use crate::prepare::Prepared;
use crate::prepare::objects::{Stage, SurfaceObject, Triangles};
use crate::scene::surface::{CutModel, Steps};
use glam::{Mat3, Vec3};

/// Bisections of a step.
const BISECTION_STEPS: u32 = 14;
/// Sphere steps are at least this fraction of an even step.
const MIN_SPHERE_STEP: f32 = 0.25;
/// Near the surface, threshold steps are this fraction of an even step.
const THRESHOLD_STEP: f32 = 0.25;
/// Jacobian steps are at most this many even steps, and at least the reciprocal.
const MAX_JACOBIAN_STEP: f32 = 8.0;
/// Between two samples of one sign a surface is searched for down to this fraction of a cell.
const MIN_BLIND_STEP: f32 = 1.0 / 64.0;
/// Interpolated fields are slightly steeper than distances.
const SLOPE_MARGIN: f32 = 1.1;
/// A ray advances by at least this fraction of its length, and beyond a cell by this fraction of
/// the cell; otherwise rounding could stop it at a cell border. Together they are less than the
/// margin of a cell ([`crate::prepare::CellGrid`]).
const MIN_ADVANCE: f32 = 1e-6;
const MIN_CELL_ADVANCE: f32 = 2e-4;
/// Steps are at least this fraction of the diagonal of the object's box, however steep the
/// deformation: finer than any picture needs.
const MIN_STEP: f32 = 1.0 / 65_536.0;
/// Most samples along one ray: more than `MIN_STEP` allows, so that a ray ends whatever rounding
/// does.
const MAX_SAMPLES: u32 = 100_000;

/// Which surface was hit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HitSide {
    /// The outside.
    Outside,
    /// The inside of a shell.
    Inside,
    /// The face of a cut.
    Cut,
}

/// A sample along a ray.
#[derive(Clone, Copy)]
pub(super) struct SurfaceSample {
    t: f32,
    /// f, or f̂ of a thick skin; positive inside.
    f: f32,
    /// Positive in a cut.
    cut: f32,
}

impl SurfaceSample {
    /// No sample: before every piece of a ray.
    const NONE: Self = Self {
        t: f32::INFINITY,
        f: -1.0,
        cut: -1.0,
    };
}

/// Distance to the nearest surface along a ray, and its normal; without lighting.
pub fn nearest_side(scene: &Prepared, origin: Vec3, direction: Vec3) -> Option<(f32, Vec3)> {
    let mut samples = 0;
    let mut best: Option<(f32, Vec3)> = None;
    for object in &scene.surfaces.objects {
        let mut by_field = || {
            let (t, side) = trace(scene, object, origin, direction, &mut samples)?;
            Some((t, normal(scene, object, origin + direction * t, side)))
        };
        let hit = match (object.stage, &object.triangles) {
            (Stage::Rays, _) | (_, None) => by_field(),
            (Stage::Triangles, Some(triangles)) => triangles
                .tree
                .ray(origin, direction, 0.0, f32::INFINITY, |_| true)
                .map(|h| (h.t, triangle_normal(triangles, &h))),
            (Stage::Both(seam), Some(triangles)) => {
                let drawn = triangles.tree.ray(origin, direction, 0.0, f32::INFINITY, |h| {
                    is_undeformed(scene, object, origin + direction * h.t, seam)
                });
                let drawn = drawn.map(|h| (h.t, triangle_normal(triangles, &h)));
                [drawn, by_field()]
                    .into_iter()
                    .flatten()
                    .min_by(|a, b| a.0.total_cmp(&b.0))
            }
        };
        if let Some(hit) = hit
            && best.is_none_or(|b| hit.0 < b.0)
        {
            best = Some(hit);
        }
    }
    best
}

/// Depth of a point in the deformations' boxes, mm: its largest depth in any box; negative outside
/// all.
pub fn depth_in_boxes(scene: &Prepared, object: &SurfaceObject, p: Vec3, seam: f32) -> f32 {
    if object.rigid {
        return f32::NEG_INFINITY;
    }
    let mut depth = f32::NEG_INFINITY;
    for map in scene.stack.maps() {
        let x = map.placement.map_from_world.transform_point3(p);
        // Distance between opposite faces of the box, along each map axis.
        let rows = Mat3::from(map.placement.map_from_world.matrix3).transpose();
        let size = Vec3::new(rows.x_axis.length(), rows.y_axis.length(), rows.z_axis.length()).recip();
        let inside = (x + map.reach).min(Vec3::ONE + map.reach - x) * size;
        depth = depth.max(inside.min_element());
    }
    // A cut shape has no box; its neighbourhood is used instead.
    if !scene.cuts.is_empty() {
        depth = depth.max(2.0 * seam - scene.cuts.signed_distance_mm(p));
    }
    depth
}

/// Whether the triangles are valid at a point: outside the boxes, or within the seam where nothing
/// moves and nothing is cut.
pub(super) fn is_undeformed(scene: &Prepared, object: &SurfaceObject, p: Vec3, seam: f32) -> bool {
    let depth = depth_in_boxes(scene, object, p, seam);
    if depth <= 0.0 {
        return true;
    }
    if depth >= seam {
        return false;
    }
    let (source, alpha) = scene.stack.source_and_alpha_unclipped(p);
    alpha >= 0.5 && scene.cuts.signed_distance_mm(p) >= 0.0 && source.distance(p) < 0.25 * object.cell_mm
}

/// f of the object's cut model, from the value of its field.
fn apply_cut_model(object: &SurfaceObject, f: f32) -> f32 {
    if object.thickness_mm > 0.0 && f > 0.5 * object.thickness_mm {
        object.thickness_mm - f
    } else {
        f
    }
}

pub(super) fn sample(
    scene: &Prepared,
    object: &SurfaceObject,
    origin: Vec3,
    direction: Vec3,
    t: f32,
) -> SurfaceSample {
    let p = origin + direction * t;
    let Some(implicit) = &object.implicit else {
        return SurfaceSample {
            t,
            f: -1.0,
            cut: -1.0,
        };
    };
    if object.rigid {
        return SurfaceSample {
            t,
            f: apply_cut_model(object, implicit.value(p)),
            cut: -1.0,
        };
    }
    let (source, alpha) = scene.stack.source_and_alpha_unclipped(p);
    SurfaceSample {
        t,
        f: apply_cut_model(object, implicit.value(source)),
        cut: (0.5 - alpha).max(-scene.cuts.signed_distance_mm(p)),
    }
}

/// Follows a ray to the first hit of an object: its distance and side.
///
/// The ray is walked in pieces that depend on nothing but the ray and the object's grid of cells:
/// intervals of equal length from the eye, or single cells. Only pieces that touch an occupied cell
/// are walked, each from end to end. Hence the samples there are the same, bit for bit, whatever
/// is skipped around them, and a sign change at the border of an empty cell is never lost.
pub fn trace(
    scene: &Prepared,
    object: &SurfaceObject,
    origin: Vec3,
    direction: Vec3,
    samples: &mut u64,
) -> Option<(f32, HitSide)> {
    let grid = &object.cells.grid;
    let (near, far) = grid.occupied.intersect_ray(origin, direction)?;
    let inverse = direction.recip();
    let steps = scene.surfaces.steps;
    // Length of an interval from the eye; 0 where pieces are cells.
    let interval = match steps {
        Steps::Uniform | Steps::Threshold => object.step_mm,
        Steps::Jacobian => MAX_JACOBIAN_STEP * object.step_mm,
        Steps::JacobianBound | Steps::Sphere => 0.0,
    };
    let finest = MIN_STEP * (grid.size.as_vec3() * grid.cell_mm).length();
    let advanced = |t: f32| t + MIN_CELL_ADVANCE * grid.cell_mm.min_element() + MIN_ADVANCE * t;
    let mut walked_to = near.max(0.0);
    let mut next_interval = 0.0f32;
    let mut before = SurfaceSample::NONE;
    let (mut stop, mut slope, mut longest_blind) = (f32::NEG_INFINITY, 1.0f32, f32::INFINITY);
    let mut count = 0;
    let hit = loop {
        if count >= MAX_SAMPLES {
            break None;
        }
        if before.t >= stop {
            // The next piece that touches an occupied cell.
            if walked_to >= far {
                break None;
            }
            let p = origin + direction * walked_to;
            if let Some(exit) = grid.empty_until(p, origin, inverse) {
                walked_to = advanced(exit.max(walked_to));
                continue;
            }
            let begin;
            if interval > 0.0 {
                // Samples lie at (n + 1/2) δs, as those of volumes.
                let number = (walked_to / interval + 0.5).floor().max(next_interval);
                next_interval = number + 1.0;
                // Nothing is seen behind the eye.
                begin = ((number - 0.5) * interval).max(0.0);
                stop = (number + 0.5) * interval;
            } else {
                slope = object.cells.slope[grid.index(p)].max(1e-3);
                (begin, stop) = (
                    walked_to,
                    advanced(grid.leaves_cell(p, origin, inverse).max(walked_to)),
                );
            }
            walked_to = stop;
            if before.t != begin {
                before = sample(scene, object, origin, direction, begin);
                count += 1;
            }
            longest_blind = f32::INFINITY;
        }
        let least = finest.max(MIN_ADVANCE * before.t);
        let length = step_length(scene, object, &before, origin, direction, slope)
            .min(longest_blind)
            .max(least);
        let here = sample(scene, object, origin, direction, (before.t + length).min(stop));
        count += 1;
        if changes(object, &before, &here) {
            if let Some(hit) = first_event(scene, object, origin, direction, before, here) {
                break Some(hit);
            }
        } else if steps == Steps::Sphere && may_hide_a_surface(object, &before, &here, slope) {
            // Two sign changes may hide between the samples: look between them. (Twice the least
            // length, since lengths are rounded.)
            let blind = here.t - before.t;
            if blind > 2.0 * least.max(MIN_BLIND_STEP * object.cell_mm / slope.max(1.0)) {
                longest_blind = 0.5 * blind;
                continue;
            }
        }
        longest_blind = f32::INFINITY;
        before = here;
    };
    *samples += u64::from(count);
    hit
}

/// Whether the surface, or the surface of a cut that shows, lies between two samples.
pub(super) fn changes(object: &SurfaceObject, a: &SurfaceSample, b: &SurfaceSample) -> bool {
    (a.f > 0.0) != (b.f > 0.0) || (object.look.model != CutModel::Hollow && a.cut > 0.0 && b.cut <= 0.0)
}

/// Whether f may be zero between two samples of one sign, given a bound on its slope.
fn may_hide_a_surface(object: &SurfaceObject, a: &SurfaceSample, b: &SurfaceSample, slope: f32) -> bool {
    let is_distance = object
        .implicit
        .as_ref()
        .is_some_and(crate::mesh::Implicit::is_distance);
    is_distance && a.f.abs() + b.f.abs() < SLOPE_MARGIN * slope * (b.t - a.t)
}

/// Distance to the next sample; `slope` bounds |J v| in the cell.
fn step_length(
    scene: &Prepared,
    object: &SurfaceObject,
    here: &SurfaceSample,
    origin: Vec3,
    direction: Vec3,
    slope: f32,
) -> f32 {
    let even = object.step_mm;
    let is_distance = object
        .implicit
        .as_ref()
        .is_some_and(crate::mesh::Implicit::is_distance);
    match scene.surfaces.steps {
        Steps::Uniform => even,
        Steps::Threshold => {
            even * if here.f.abs() < scene.surfaces.threshold * object.cell_mm {
                THRESHOLD_STEP
            } else {
                1.0
            }
        }
        Steps::Jacobian => {
            let stretch = if object.rigid || scene.stack.is_empty() {
                1.0
            } else {
                let jet = scene.stack.jet(origin + direction * here.t);
                (jet.d_source_d_deformed * direction).length()
            };
            even / stretch.clamp(MAX_JACOBIAN_STEP.recip(), MAX_JACOBIAN_STEP)
        }
        Steps::JacobianBound => even / slope,
        Steps::Sphere if !is_distance => even,
        Steps::Sphere => {
            let shortest = MIN_SPHERE_STEP * even / slope.max(1.0);
            // In a cut the next hit may be the cut itself.
            let in_cut = here.cut > 0.0 && here.f > 0.0 && object.look.model != CutModel::Hollow;
            if in_cut {
                even.min(even / slope).max(shortest)
            } else {
                (0.9 * here.f.abs() / slope).max(shortest)
            }
        }
    }
}

/// The first hit between two samples, if there is one.
pub(super) fn first_event(
    scene: &Prepared,
    object: &SurfaceObject,
    origin: Vec3,
    direction: Vec3,
    a: SurfaceSample,
    b: SurfaceSample,
) -> Option<(f32, HitSide)> {
    let at = |t: f32| sample(scene, object, origin, direction, t);
    let solid = object.look.model != CutModel::Hollow;
    let surface = ((a.f > 0.0) != (b.f > 0.0)).then(|| bisect(a, b, |s| s.f > 0.0, &at));
    let face = (solid && a.cut > 0.0 && b.cut <= 0.0).then(|| bisect(a, b, |s| s.cut > 0.0, &at));
    let surface_hit = surface.and_then(|(before, after)| {
        let entering = before.f <= 0.0;
        // A shell shows both its sides, a solid only the surfaces that a ray enters.
        if after.cut.max(before.cut) > 0.0 || (solid && !entering) {
            return None;
        }
        let inner = object.thickness_mm > 0.0
            && source_value(scene, object, origin + direction * after.t) > 0.5 * object.thickness_mm;
        Some((
            after.t,
            if entering && !inner {
                HitSide::Outside
            } else {
                HitSide::Inside
            },
        ))
    });
    let face_hit = face
        .filter(|(_, after)| after.f > 0.0)
        .map(|(_, after)| (after.t, HitSide::Cut));
    match (surface_hit, face_hit) {
        (Some(s), Some(f)) => Some(if s.0 <= f.0 { s } else { f }),
        (s, f) => s.or(f),
    }
}

/// The original f at a point of the deformed scene.
fn source_value(scene: &Prepared, object: &SurfaceObject, p: Vec3) -> f32 {
    let source = if object.rigid {
        p
    } else {
        scene.stack.source_and_alpha_unclipped(p).0
    };
    object.implicit.as_ref().map_or(-1.0, |i| i.value(source))
}

/// Narrows a sign change between two samples; returns the samples on its two sides.
fn bisect(
    mut a: SurfaceSample,
    mut b: SurfaceSample,
    is: impl Fn(&SurfaceSample) -> bool,
    at: &impl Fn(f32) -> SurfaceSample,
) -> (SurfaceSample, SurfaceSample) {
    let first = is(&a);
    for _ in 0..BISECTION_STEPS {
        let middle = at(0.5 * (a.t + b.t));
        if is(&middle) == first {
            a = middle
        } else {
            b = middle
        }
    }
    (a, b)
}

/// Unit normal of a hit, pointing out of the material.
pub fn normal(scene: &Prepared, object: &SurfaceObject, p: Vec3, side: HitSide) -> Vec3 {
    let jet = if object.rigid || scene.stack.is_empty() {
        Jet {
            source: p,
            d_source_d_deformed: Mat3::IDENTITY,
            cut: NearestCut::NONE,
            alpha: 1.0,
        }
    } else {
        scene.stack.jet(p)
    };
    if side == HitSide::Cut {
        let mut cut = jet.cut;
        let distance_mm = scene.cuts.signed_distance_mm(p);
        if distance_mm < object.step_mm {
            cut = cut.nearer_of(distance_mm.abs(), scene.cuts.gradient(p, 0.05 * object.cell_mm));
        }
        return cut.normal;
    }
    let gradient = object
        .implicit
        .as_ref()
        .map_or(Vec3::ZERO, |i| i.gradient(jet.source, object.cell_mm));
    let outward = normalize_or(-(jet.d_source_d_deformed.transpose() * gradient), Vec3::ZERO);
    if side == HitSide::Inside {
        -outward
    } else {
        outward
    }
}

/// The interpolated normal at a ray's hit on a triangle.
pub(super) fn triangle_normal(triangles: &Triangles, hit: &MeshHit) -> Vec3 {
    let [a, b, c] = triangles.normals[hit.triangle as usize];
    let [u, v] = hit.barycentric;
    normalize_or(a * (1.0 - u - v) + b * u + c * v, a)
}
