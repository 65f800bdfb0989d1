//! Places deformations whose numbers are left out on what is seen.
//!
//! Coarse rays from the scene's camera find the visible surface; rays along two axes find the box
//! of the whole object. [`crate::scene::placement`] has the rules. The numbers are chosen once,
//! from the scene's own camera: a view that turns afterwards must start from the placed scene, so
//! that nothing slides.

use super::PrepareOptions;
use super::assets::Assets;
use super::coarse_rays::CoarseRays;
use super::prepared::Prepared;
use crate::Result;
use crate::deform::kinds;
use crate::math::{Bounds, normalize_or};
use crate::scene::{Antialias, DefaultPlacement, Deformation, Mode, RenderSettings, Scene, VisibleObject};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::borrow::Cow;

/// Rays along the longer edge of the picture.
const RAYS: u32 = 64;
/// Rays along each edge of the box, for the outline of the object.
const OUTLINE_RAYS: usize = 48;
/// Radius of the middle of the view, as a share of the object's extent in it.
const MIDDLE: f32 = 0.15;

/// The scene with the numbers of every deformation that leaves them out; the scene itself if there
/// is none. Where nothing is visible, they are placed about the middle of the volume.
///
/// # Errors
/// Any invalid setting, by name.
pub fn placed<'s>(scene: &'s Scene, assets: &Assets) -> Result<Cow<'s, Scene>> {
    let follows = |d: &Deformation| kinds::kind(&d.kind).is_ok_and(|kind| d.follows_view(kind));
    if !scene.deformation.iter().any(follows) {
        return Ok(Cow::Borrowed(scene));
    }
    let object = visible_object(scene, assets)?;
    let mut placed = scene.clone();
    for deformation in placed.deformation.iter_mut().filter(|d| follows(d)) {
        match &object {
            Some(object) => deformation.place(kinds::kind(&deformation.kind)?, object),
            None => deformation.placement = DefaultPlacement::Volume,
        }
    }
    Ok(Cow::Owned(placed))
}

/// What the scene's camera sees of it without its deformations; none if it sees nothing.
///
/// # Errors
/// Any invalid setting, by name.
pub fn visible_object(scene: &Scene, assets: &Assets) -> Result<Option<VisibleObject>> {
    let mut bare = scene.clone();
    bare.deformation.clear();
    let [width, height] = scene.render.size.map(|n| n.max(1));
    let longer = width.max(height);
    // How pictures are sampled must not move anything: only what is shown counts.
    bare.render = RenderSettings {
        size: [width, height].map(|n| (RAYS * n).div_ceil(longer).max(1)),
        antialias: Antialias::OFF,
        mode: match scene.render.mode {
            Mode::Surface => Mode::Surface,
            Mode::Slice | Mode::Raycast => Mode::Raycast,
        },
        iso: scene.render.iso,
        ..RenderSettings::default()
    };
    let prepared = Prepared::with(&bare, assets, &PrepareOptions::default())?;
    let rays = CoarseRays::new(&prepared);
    Ok(seen(&prepared, &rays))
}

/// A visible point and its place in the picture, -1..1.
#[derive(Clone, Copy)]
struct SeenPoint {
    at: Vec2,
    point: Vec3,
}

/// What the rays of the picture and those along two axes find.
fn seen(prepared: &Prepared, rays: &CoarseRays) -> Option<VisibleObject> {
    let view = &prepared.frame.view;
    let [width, height] = prepared.frame.size;
    let cast = |at: Vec2| {
        let (origin, direction) = view.ray(at.x, at.y);
        let point = rays.first_hit(origin, direction)?;
        Some(SeenPoint { at, point })
    };
    let pixels = (0..width * height).into_par_iter().map(|n| {
        let pixel = Vec2::new((n % width) as f32, (n / width) as f32) + 0.5;
        let at = pixel / Vec2::new(width as f32, height as f32) * 2.0 - 1.0;
        Vec2::new(at.x, -at.y)
    });
    let mut hits: Vec<SeenPoint> = pixels.filter_map(cast).collect();
    hits.extend(cast(Vec2::ZERO));
    let viewer = -view.forward;
    let (right, up) = (normalize_or(view.right, Vec3::X), normalize_or(view.up, Vec3::Z));
    let [across, along] = [right, up].map(|axis| middle_range(&hits, axis));
    let point = middle(&hits, viewer, Vec2::new(across, along))?;
    Some(VisibleObject {
        bounds: outline(rays),
        span_mm: Vec2::new(across, along),
        point,
        surface: hits.iter().map(|hit| hit.point).collect(),
        value: surface_value(prepared, &hits, viewer),
        viewer,
        right,
        up,
    })
}

/// The volume's value at its visible surface, data units: halfway between the values in front of it
/// and behind it.
fn surface_value(prepared: &Prepared, hits: &[SeenPoint], viewer: Vec3) -> Option<f32> {
    if !prepared.shows_volume() {
        return None;
    }
    let volume = prepared.volume();
    let median = |steps: f32| {
        let shift = viewer * (steps * prepared.frame.spacing.reference_mm);
        let at = |hit: &SeenPoint| volume.value_at(hit.point + shift);
        let mut values: Vec<f32> = hits.iter().filter_map(at).collect();
        values.sort_by(f32::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let value = f64::from(0.5 * (median(1.5)? + median(-1.5)?));
    let [low, high] = volume.value_range;
    Some((low + value * (high - low)) as f32)
}

/// The extent of points along an axis, without one per cent at both ends, mm.
fn middle_range(hits: &[SeenPoint], axis: Vec3) -> f32 {
    let mut along: Vec<f32> = hits.iter().map(|hit| hit.point.dot(axis)).collect();
    along.sort_by(f32::total_cmp);
    match along.len() {
        0 => 0.0,
        n => along[n - 1 - n / 100] - along[n / 100],
    }
}

/// The visible point in the middle of the view: the nearest to the middle among those that do not
/// lie deep in a gap, compared with their surroundings.
fn middle(hits: &[SeenPoint], viewer: Vec3, span_mm: Vec2) -> Option<Vec3> {
    let center = hits
        .iter()
        .min_by(|a, b| a.at.length_squared().total_cmp(&b.at.length_squared()))?;
    let extent = span_mm.min_element();
    let away = |hit: &SeenPoint| {
        let d = hit.point - center.point;
        (d - viewer * d.dot(viewer)).length()
    };
    let mut depths: Vec<f32> = hits
        .iter()
        .filter(|hit| away(hit) <= MIDDLE * extent)
        .map(|hit| -hit.point.dot(viewer))
        .collect();
    depths.sort_by(f32::total_cmp);
    let limit = depths.get(depths.len() / 2)? + 0.03 * extent;
    hits.iter()
        .filter(|hit| -hit.point.dot(viewer) <= limit)
        .min_by(|a, b| a.at.length_squared().total_cmp(&b.at.length_squared()))
        .map(|hit| hit.point)
}

/// The box around everything that rays along y and along z hit, to the width of a ray; single rays
/// do not count.
fn outline(rays: &CoarseRays) -> Bounds {
    let all = rays.bounds();
    let (n, size) = (OUTLINE_RAYS, all.size());
    let outline_along = |axis: usize| {
        let [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
        let corner = |i: usize, j: usize, shift: f32| {
            let mut p = all.min;
            p[a] += size[a] * (i as f32 + shift) / n as f32;
            p[b] += size[b] * (j as f32 + shift) / n as f32;
            p
        };
        let hits: Vec<bool> = (0..n * n)
            .into_par_iter()
            .map(|ray| {
                let mut origin = corner(ray % n, ray / n, 0.5);
                origin[axis] -= 0.01 * size[axis] + 1e-3;
                rays.first_hit(origin, Vec3::AXES[axis]).is_some()
            })
            .collect();
        let is_hit = |i: usize, j: usize| i < n && j < n && hits[j * n + i];
        let mut found = Bounds::EMPTY;
        for (i, j) in (0..n).flat_map(|j| (0..n).map(move |i| (i, j))) {
            let neighbours = [
                (i + 1, j),
                (i.wrapping_sub(1), j),
                (i, j + 1),
                (i, j.wrapping_sub(1)),
            ];
            if is_hit(i, j) && neighbours.into_iter().any(|(i, j)| is_hit(i, j)) {
                found = found.union(&Bounds::new(corner(i, j, 0.0), corner(i, j, 1.0)));
            }
        }
        found
    };
    let (front, top) = (outline_along(1), outline_along(2));
    // A direction that meets nothing, such as a plane seen edge-on, says nothing.
    let or_all = |found: &Bounds, axis: usize| {
        let of = if found.is_empty() { &all } else { found };
        (of.min[axis], of.max[axis])
    };
    // x is seen from both sides, z from the front, y from above.
    let ranges = [or_all(&front, 0), or_all(&top, 1), or_all(&front, 2)];
    let other = or_all(&top, 0);
    Bounds::new(
        Vec3::new(ranges[0].0.min(other.0), ranges[1].0, ranges[2].0),
        Vec3::new(ranges[0].1.max(other.1), ranges[1].1, ranges[2].1),
    )
}
