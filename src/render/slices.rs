//! Proxy geometry: polygons that cover the sections of view-aligned planes with the proxy box,
//! several planes at a time, or with a mesh (\[RVD01\] section 2.4).

use crate::mesh::Mesh;
use crate::mesh::contour::{Planes, sections};
use crate::prepare::{Frame, Macrocells};
use crate::scene::Projection;
use glam::{Vec2, Vec3};
use std::ops::Range;

/// Slices composited by one fragment before blending: enough that the setup of a fragment does not
/// dominate.
pub const SLICES_PER_SLAB: i64 = 32;

/// A triangle corner: position in world mm, and the index of the slab's nearest slice.
pub type Corner = [f32; 4];

/// Polygons of slabs, as triangles.
#[derive(Default)]
pub struct Polygons {
    /// Corners of all triangles.
    pub corners: Vec<Corner>,
    /// Each slab's range of `corners`, front to back.
    pub slabs: Vec<Range<u32>>,
}

impl Polygons {
    fn push(&mut self, triangles: impl Iterator<Item = Vec3>, slice: i64) {
        let start = self.corners.len() as u32;
        self.corners
            .extend(triangles.map(|p| [p.x, p.y, p.z, slice as f32]));
        let end = self.corners.len() as u32;
        if end > start {
            self.slabs.push(start..end);
        }
    }
}

/// Polygons that cover the slices that can show anything, front to back: for a box, slabs of
/// [`SLICES_PER_SLAB`] slices; for a mesh, single slices.
///
/// Slices lie at depths (i + 1/2) Δ from the eye, hence they do not move when the box changes;
/// slabs start at multiples of their size. A slab is omitted if none of its slices meets an
/// occupied cell.
pub fn slabs(frame: &Frame, cells: &Macrocells, mesh: Option<&Mesh>) -> Polygons {
    let view = &frame.view;
    let depth = |p: Vec3| (p - view.eye).dot(view.forward);
    let corners = frame.proxy.corners();
    let (near, far) = corners
        .iter()
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(n, f), &c| {
            (n.min(depth(c)), f.max(depth(c)))
        });
    let mut polygons = Polygons::default();
    if near > far {
        return polygons;
    }
    let first = (near / frame.spacing.step_mm - 0.5).ceil().max(0.0) as i64;
    let last = (far / frame.spacing.step_mm - 0.5).floor() as i64;
    if let Some(mesh) = mesh {
        let planes = Planes::across(view.forward);
        let offsets: Vec<f32> = (first..=last)
            .map(|i| (i as f32 + 0.5) * frame.spacing.step_mm + view.eye.dot(view.forward))
            .collect();
        for (section, i) in sections(mesh, &planes, &offsets).iter().zip(first..) {
            polygons.push(section.iter().flatten().copied(), i);
        }
        return polygons;
    }
    let shown = occupied_depths(frame, cells);
    // Shifted samples may belong to the cells of the neighbouring slices.
    let is_shown = |i: i64| shown.is_empty() || shown.get((i - first) as usize).copied().unwrap_or(true);
    for slab in first.div_euclid(SLICES_PER_SLAB)..=last.div_euclid(SLICES_PER_SLAB) {
        let start = slab * SLICES_PER_SLAB;
        let (low, high) = (start.max(first), (start + SLICES_PER_SLAB - 1).min(last));
        if !((low - 1).max(first)..=high + 1).any(is_shown) {
            continue;
        }
        // Half a step more for shifted samples, and a margin so that rounding omits no slice.
        let depths = [
            (low as f32 - 0.05).max(0.01) * frame.spacing.step_mm,
            (high as f32 + 1.05) * frame.spacing.step_mm,
        ];
        let outline = silhouette(frame, &corners, depths);
        let fan = (2..outline.len()).flat_map(|n| [outline[0], outline[n - 1], outline[n]]);
        polygons.push(fan, start);
    }
    polygons
}

/// The outline of the part of a box between two depths, as seen from the eye: a convex polygon at
/// the mean depth.
fn silhouette(frame: &Frame, corners: &[Vec3; 8], depths: [f32; 2]) -> Vec<Vec3> {
    let view = &frame.view;
    let depth = |p: Vec3| (p - view.eye).dot(view.forward);
    let mut points: Vec<Vec3> = corners
        .iter()
        .copied()
        .filter(|&c| (depths[0]..=depths[1]).contains(&depth(c)))
        .collect();
    for at in depths {
        points.extend(crossings(corners, &corners.map(|c| depth(c) - at)));
    }
    let (right, up) = (view.right.normalize_or_zero(), view.up.normalize_or_zero());
    let perspective = view.projection == Projection::Perspective;
    let middle = (depths[0] + depths[1]) / 2.0;
    let scale = |p: Vec3| {
        if perspective {
            middle / depth(p).max(1e-6 * middle)
        } else {
            1.0
        }
    };
    let flat: Vec<Vec2> = points
        .iter()
        .map(|&p| Vec2::new((p - view.eye).dot(right), (p - view.eye).dot(up)) * scale(p))
        .collect();
    let outline = convex_hull(flat);
    let center = outline.iter().sum::<Vec2>() / outline.len().max(1) as f32;
    let size = outline.iter().map(|p| p.distance(center)).fold(0.0, f32::max);
    // Where a ray grazes the box, the fragment decides whether it hits: the polygon must not be
    // smaller.
    let grown = |p: Vec2| p + (p - center).normalize_or_zero() * (1e-4 * size);
    outline
        .into_iter()
        .map(grown)
        .map(|p| view.eye + view.forward * middle + right * p.x + up * p.y)
        .collect()
}

/// Corners of the convex hull in order (Andrew's monotone chain).
fn convex_hull(mut points: Vec<Vec2>) -> Vec<Vec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let chain = |points: &mut dyn Iterator<Item = Vec2>| {
        let mut chain: Vec<Vec2> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..] {
                if (b - a).perp_dot(p - a) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}

/// For each slice, the nearest first: whether any occupied cell reaches it.
fn occupied_depths(frame: &Frame, cells: &Macrocells) -> Vec<bool> {
    let view = &frame.view;
    let depth = |p: Vec3| (p - view.eye).dot(view.forward);
    let near = frame
        .proxy
        .corners()
        .iter()
        .map(|&c| depth(c))
        .fold(f32::INFINITY, f32::min);
    let first = (near / frame.spacing.step_mm - 0.5).ceil().max(0.0) as i64;
    let reach = cells.cell_mm.dot(view.forward.abs()) / 2.0;
    let mut shown = Vec::new();
    for index in (0..cells.distance.len()).filter(|n| cells.is_occupied(*n)) {
        let index = index as u32;
        let cell = Vec3::new(
            (index % cells.size.x) as f32,
            (index / cells.size.x % cells.size.y) as f32,
            (index / cells.size.x / cells.size.y) as f32,
        );
        let middle = depth(cells.origin + (cell + 0.5) * cells.cell_mm);
        let low = (((middle - reach) / frame.spacing.step_mm - 0.5).floor() as i64 - first).max(0) as usize;
        let high = (((middle + reach) / frame.spacing.step_mm - 0.5).ceil() as i64 - first).max(0) as usize;
        if shown.len() <= high {
            shown.resize(high + 1, false);
        }
        shown[low..=high].fill(true);
    }
    shown
}

/// Where the plane of signed distances `side` crosses the edges of the box of `corners`.
fn crossings(corners: &[Vec3; 8], side: &[f32; 8]) -> Vec<Vec3> {
    let mut points = Vec::with_capacity(6);
    for a in 0..8usize {
        for axis in 0..3 {
            let b = a | (1 << axis);
            if a == b || (side[a] < 0.0) == (side[b] < 0.0) {
                continue;
            }
            let t = side[a] / (side[a] - side[b]);
            points.push(corners[a] + (corners[b] - corners[a]) * t);
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Bounds;
    use crate::scene::Camera;

    fn frame(view: &str, projection: Projection, bounds: Bounds) -> Frame {
        let camera = Camera {
            view: view.parse().unwrap_or_else(|e| panic!("{e}")),
            projection,
            ..Camera::default()
        };
        Frame {
            view: camera.frame(&bounds, [64, 64]).unwrap_or_else(|e| panic!("{e}")),
            size: [64, 64],
            spacing: crate::prepare::SampleSpacing {
                step_mm: 0.25,
                reference_mm: 1.0,
                blend_mm: [1.0, 2.5],
            },
            proxy: bounds,
            to_light: Vec3::X,
        }
    }

    /// Every ray that meets a slice inside the box passes through its slab's polygon, and polygons
    /// are only slightly larger.
    #[test]
    fn polygons_cover_the_box() {
        let bounds = Bounds::new(Vec3::new(-30.0, -20.0, -25.0), Vec3::new(30.0, 25.0, 40.0));
        for (view, projection) in [
            ("anterior", Projection::Perspective),
            ("30,20", Projection::Perspective),
            ("130,-65", Projection::Orthographic),
        ] {
            let frame = frame(view, projection, bounds);
            let polygons = slabs(&frame, &Macrocells::solid(bounds), None);
            assert!(
                polygons.corners.windows(2).all(|w| w[0][3] <= w[1][3]),
                "front to back"
            );
            let (mut met, mut missed, mut covered) = (0, 0, 0);
            for slab in &polygons.slabs {
                let corners = &polygons.corners[slab.start as usize..slab.end as usize];
                let at = |n: usize| Vec3::from_slice(&corners[n][..3]);
                let outline: Vec<Vec3> = std::iter::once(at(0))
                    .chain((0..corners.len() / 3).flat_map(|t| [at(3 * t + 1), at(3 * t + 2)]))
                    .collect();
                for pixel in 0..64 * 64 {
                    let (u, v) = (
                        (pixel % 64) as f32 / 32.0 - 63.0 / 64.0,
                        (pixel / 64) as f32 / 32.0 - 63.0 / 64.0,
                    );
                    let (origin, direction) = frame.view.ray(u, v);
                    let slant = direction.dot(frame.view.forward);
                    let p = origin + direction * ((at(0) - frame.view.eye).dot(frame.view.forward) / slant);
                    let across = |n: usize| {
                        (outline[(n + 1) % outline.len()] - outline[n])
                            .cross(p - outline[n])
                            .dot(frame.view.forward)
                    };
                    let sides: Vec<bool> = (0..outline.len())
                        .map(across)
                        .filter(|a| a.abs() > 1e-3)
                        .map(|a| a > 0.0)
                        .collect();
                    let inside = sides.windows(2).all(|w| w[0] == w[1]);
                    let first = corners[0][3];
                    let meets = (0..SLICES_PER_SLAB).any(|i| {
                        let q =
                            origin + direction * ((first + i as f32 + 0.5) * frame.spacing.step_mm / slant);
                        q.cmpge(bounds.min).all() && q.cmple(bounds.max).all()
                    });
                    met += usize::from(meets);
                    covered += usize::from(inside);
                    missed += usize::from(meets && !inside);
                }
            }
            assert!(
                met > 10_000 && missed == 0 && covered as f32 <= 1.1 * met as f32,
                "{view}: {met} met, {missed} missed, {covered} covered"
            );
        }
    }

    /// The slices of a ball, times their distance, have the volume of the ball.
    #[test]
    fn polygons_fill_a_mesh() {
        let bounds = Bounds::new(Vec3::new(-30.0, -20.0, -25.0), Vec3::new(30.0, 25.0, 40.0));
        for view in ["anterior", "30,20", "130,-65"] {
            let frame = frame(view, Projection::Perspective, bounds);
            let of_mesh = slabs(
                &frame,
                &Macrocells::solid(bounds),
                Some(&crate::mesh::shapes::sphere(20.0, 64)),
            );
            let area: f32 = of_mesh
                .corners
                .chunks_exact(3)
                .map(|t| {
                    let p = |n: usize| Vec3::from_slice(&t[n][..3]);
                    (p(1) - p(0)).cross(p(2) - p(0)).length() / 2.0
                })
                .sum();
            assert!(
                of_mesh.corners.windows(2).all(|w| w[0][3] <= w[1][3]),
                "front to back"
            );
            let ball = 4.0 / 3.0 * std::f32::consts::PI * 8000.0;
            assert!((area * 0.25 / ball - 1.0).abs() < 5e-3, "{view}");
        }
    }
}
