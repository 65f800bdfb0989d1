//! What rays and slices show of surfaces: lit hits, triangles and rays joined into one picture.

use super::light::{SOLID_DEPTH, light_shares};
use super::surface::{
    HitSide, changes, depth_in_boxes, first_event, is_undeformed, normal, sample, trace, triangle_normal,
};
use crate::math::light::BlinnPhong;
use crate::math::{Bounds, normalize_or, smoothstep};
use crate::mesh::MeshHit;
use crate::prepare::Prepared;
use crate::prepare::objects::{Stage, SurfaceObject, Triangles};
use crate::volume::VolumeSampler;
use glam::Vec3;

/// A ray's hit on the surfaces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceHit {
    /// Distance along the ray, mm.
    pub t: f32,
    /// Lit colour.
    pub color: Vec3,
}

/// The nearest surface along a ray; counts the samples taken in `samples`.
pub fn nearest(scene: &Prepared, origin: Vec3, direction: Vec3, samples: &mut u64) -> Option<SurfaceHit> {
    let mut best: Option<SurfaceHit> = None;
    // Slices sample the others themselves.
    let objects = scene.surfaces.objects.iter();
    for object in objects.filter(|object| !scene.is_sliced(object)) {
        if let Some(hit) = object_hit(scene, object, origin, direction, samples)
            && best.is_none_or(|b| hit.t < b.t)
        {
            best = Some(hit);
        }
    }
    best
}

/// What a slice shows of the surfaces: the nearest hit on the part of a ray, `step` long, that ends
/// at `t`, where the slice lies.
pub fn nearest_in_slice(
    scene: &Prepared,
    origin: Vec3,
    direction: Vec3,
    t: f32,
    step: f32,
    samples: &mut u64,
) -> Option<SurfaceHit> {
    let mut best: Option<SurfaceHit> = None;
    for object in scene.sliced_surfaces() {
        // Nothing is seen behind the eye.
        let ends = [(t - step).max(0.0), t];
        let [a, b] = ends.map(|t| origin + direction * t);
        let part = Bounds::new(a.min(b), a.max(b));
        if object.cells.grid.is_empty_block(&part) {
            continue;
        }
        *samples += 2;
        let [a, b] = ends.map(|t| sample(scene, object, origin, direction, t));
        let hit = changes(object, &a, &b).then(|| first_event(scene, object, origin, direction, a, b));
        if let Some((t, side)) = hit.flatten()
            && best.is_none_or(|best| t < best.t)
        {
            best = Some(shade_field(scene, object, origin, direction, t, side));
        }
    }
    best
}

fn object_hit(
    scene: &Prepared,
    object: &SurfaceObject,
    origin: Vec3,
    direction: Vec3,
    samples: &mut u64,
) -> Option<SurfaceHit> {
    let mut by_field = || {
        trace(scene, object, origin, direction, samples)
            .map(|(t, side)| shade_field(scene, object, origin, direction, t, side))
    };
    match (object.stage, &object.triangles) {
        (Stage::Rays, _) | (_, None) => by_field(),
        (Stage::Triangles, Some(triangles)) => {
            let hit = triangles
                .tree
                .ray(origin, direction, 0.0, f32::INFINITY, |_| true)?;
            Some(shade_triangle(
                scene,
                object,
                triangles,
                &hit,
                [origin, direction],
            ))
        }
        (Stage::Both(seam), Some(triangles)) => {
            let hit = triangles.tree.ray(origin, direction, 0.0, f32::INFINITY, |h| {
                is_undeformed(scene, object, origin + direction * h.t, seam)
            });
            let drawn = hit.map(|h| shade_triangle(scene, object, triangles, &h, [origin, direction]));
            blend_seam(scene, object, drawn, by_field(), origin, direction, seam)
        }
    }
}

/// Joins triangle and ray hits: the nearer one, or, where both show one surface within the seam, a
/// blend of their colours.
fn blend_seam(
    scene: &Prepared,
    object: &SurfaceObject,
    drawn: Option<SurfaceHit>,
    cast: Option<SurfaceHit>,
    origin: Vec3,
    direction: Vec3,
    seam: f32,
) -> Option<SurfaceHit> {
    let (Some(d), Some(c)) = (drawn, cast) else {
        return drawn.or(cast);
    };
    if (d.t - c.t).abs() > 2.0 * object.cell_mm {
        return Some(if d.t < c.t { d } else { c });
    }
    let weight = smoothstep(
        0.0,
        seam,
        depth_in_boxes(scene, object, origin + direction * d.t, seam),
    );
    Some(SurfaceHit {
        t: d.t + (c.t - d.t) * weight,
        color: d.color.lerp(c.color, weight),
    })
}

fn shade_field(
    scene: &Prepared,
    object: &SurfaceObject,
    origin: Vec3,
    direction: Vec3,
    t: f32,
    side: HitSide,
) -> SurfaceHit {
    let normal = normal(scene, object, origin + direction * t, side);
    let color = Vec3::from(match side {
        HitSide::Outside => object.look.color,
        HitSide::Inside => object.look.inside,
        HitSide::Cut => object.look.cut,
    });
    SurfaceHit {
        t,
        color: light(scene, object, normal, origin + direction * t, direction, color),
    }
}

fn shade_triangle(
    scene: &Prepared,
    object: &SurfaceObject,
    triangles: &Triangles,
    hit: &MeshHit,
    [origin, direction]: [Vec3; 2],
) -> SurfaceHit {
    let normal = triangle_normal(triangles, hit);
    let color = Vec3::from(if hit.front {
        object.look.color
    } else {
        object.look.inside
    });
    let toward_eye = if hit.front { normal } else { -normal };
    let at = origin + direction * hit.t;
    SurfaceHit {
        t: hit.t,
        color: light(scene, object, toward_eye, at, direction, color),
    }
}

/// Blinn-Phong under the scene's light with the object's highlight. A normal that points slightly
/// away from the eye (an interpolated one at a silhouette) is bent back to the silhouette.
fn light(
    scene: &Prepared,
    object: &SurfaceObject,
    normal: Vec3,
    at: Vec3,
    direction: Vec3,
    color: Vec3,
) -> Vec3 {
    let away = normal.dot(direction).max(0.0);
    let normal = normalize_or(normal - direction * away, -direction);
    let to_light = scene.frame.to_light;
    let half = normalize_or(to_light - direction, to_light);
    let [specular, shininess] = object.look.highlight;
    let light = BlinnPhong {
        specular,
        shininess,
        ..scene.light.blinn_phong()
    };
    let shares = light_shares(
        scene,
        &VolumeSampler::new(scene.volume().grid),
        (normal, 1.0),
        SOLID_DEPTH,
        at,
        direction,
    );
    let lit = light.lit(color, normal.dot(to_light), normal.dot(half), shares);
    lit.clamp(Vec3::ZERO, Vec3::ONE)
}
