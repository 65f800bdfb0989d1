//! Proxy geometry: the polygons in which view-aligned planes cut the proxy box, or a mesh (\[RVD01\] section 2.4).

use crate::mesh::Mesh;
use crate::mesh::contour::{Planes, sections};
use crate::scene::{Frame, Macrocells};
use glam::{Vec2, Vec3};

/// A triangle corner: position in world mm and the slice's depth along the view direction.
pub type Corner = [f32; 4];

/// The triangles of all slices that can show anything, back to front; each slice's range in the list is contiguous.
///
/// Slices lie at depths (i + 1/2) Δ from the eye, so that they do not move when the box changes. A slice that meets no occupied cell is
/// left out.
pub fn slices(frame: &Frame, cells: &Macrocells, mesh: Option<&Mesh>) -> Vec<Corner> {
    let view = &frame.view;
    let depth = |p: Vec3| (p - view.eye).dot(view.forward);
    let corners = frame.proxy.corners();
    let (near, far) = corners.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(n, f), &c| (n.min(depth(c)), f.max(depth(c))));
    if near > far {
        return Vec::new();
    }
    let first = (near / frame.step_mm - 0.5).ceil().max(0.0) as i64;
    let last = (far / frame.step_mm - 0.5).floor() as i64;
    let shown = occupied_depths(frame, cells);
    let mut triangles = Vec::new();
    if let Some(mesh) = mesh {
        let planes = Planes::across(view.forward);
        let depths: Vec<f32> = (first..=last).map(|i| (i as f32 + 0.5) * frame.step_mm).collect();
        let offsets: Vec<f32> = depths.iter().map(|d| d + view.eye.dot(view.forward)).collect();
        for (section, at) in sections(mesh, &planes, &offsets).iter().zip(&depths).rev() {
            triangles.extend(section.iter().flatten().map(|p| [p.x, p.y, p.z, *at]));
        }
        return triangles;
    }
    for i in (first..=last).rev() {
        let at = (i as f32 + 0.5) * frame.step_mm;
        if !shown.is_empty() && !shown.get((i - first) as usize).copied().unwrap_or(true) {
            continue;
        }
        let polygon = cross_section(&corners, &corners.map(|c| depth(c) - at), view.right, view.up);
        for n in 2..polygon.len() {
            for p in [polygon[0], polygon[n - 1], polygon[n]] {
                triangles.push([p.x, p.y, p.z, at]);
            }
        }
    }
    triangles
}

/// For each slice from the nearest on: whether any occupied cell reaches it.
fn occupied_depths(frame: &Frame, cells: &Macrocells) -> Vec<bool> {
    let view = &frame.view;
    let depth = |p: Vec3| (p - view.eye).dot(view.forward);
    let near = frame.proxy.corners().iter().map(|&c| depth(c)).fold(f32::INFINITY, f32::min);
    let first = (near / frame.step_mm - 0.5).ceil().max(0.0) as i64;
    let reach = cells.cell_mm.dot(view.forward.abs()) / 2.0;
    let mut shown = Vec::new();
    for (index, _) in cells.distance.iter().enumerate().filter(|(_, d)| **d == 0) {
        let index = index as u32;
        let cell =
            Vec3::new((index % cells.size.x) as f32, (index / cells.size.x % cells.size.y) as f32, (index / cells.size.x / cells.size.y) as f32);
        let middle = depth(cells.origin + (cell + 0.5) * cells.cell_mm);
        let low = (((middle - reach) / frame.step_mm - 0.5).floor() as i64 - first).max(0) as usize;
        let high = (((middle + reach) / frame.step_mm - 0.5).ceil() as i64 - first).max(0) as usize;
        if shown.len() <= high {
            shown.resize(high + 1, false);
        }
        shown[low..=high].fill(true);
    }
    shown
}

/// The convex polygon in which the plane of signed distances `side` cuts the box of `corners`, in order around its centre.
fn cross_section(corners: &[Vec3; 8], side: &[f32; 8], right: Vec3, up: Vec3) -> Vec<Vec3> {
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
    let center = points.iter().sum::<Vec3>() / points.len().max(1) as f32;
    let angle = |p: &Vec3| {
        let d = *p - center;
        Vec2::new(d.dot(right.normalize_or_zero()), d.dot(up.normalize_or_zero())).to_angle()
    };
    points.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Bounds;
    use crate::scene::Camera;

    /// The slices of a box, times their distance, have the volume of the box.
    #[test]
    fn polygons_cover_the_box() {
        let bounds = Bounds::new(Vec3::new(-30.0, -20.0, -25.0), Vec3::new(30.0, 25.0, 40.0));
        for view in ["anterior", "30,20", "130,-65"] {
            let camera = Camera { view: view.parse().unwrap_or_else(|e| panic!("{e}")), ..Camera::default() };
            let frame = Frame {
                view: camera.frame(&bounds, [64, 64]).unwrap_or_else(|e| panic!("{e}")),
                size: [64, 64],
                step_mm: 0.25,
                reference_mm: 1.0,
                voxel_from_world: glam::Affine3A::IDENTITY,
                grid_size: Vec3::ONE,
                proxy: bounds,
                to_light: Vec3::X,
                blend_mm: [1.0, 2.5],
            };
            let triangles = slices(&frame, &Macrocells::solid(bounds), None);
            let of_mesh = slices(&frame, &Macrocells::solid(bounds), Some(&crate::mesh::shapes::sphere(20.0, 64)));
            let area_of = |corners: &[Corner]| -> f32 {
                corners
                    .chunks_exact(3)
                    .map(|t| {
                        let p = |n: usize| Vec3::from_slice(&t[n][..3]);
                        (p(1) - p(0)).cross(p(2) - p(0)).length() / 2.0
                    })
                    .sum()
            };
            let area = area_of(&triangles);
            let volume = bounds.size().element_product();
            assert!((area * 0.25 / volume - 1.0).abs() < 2e-3, "{view}: {area}");
            assert!(triangles.windows(2).chain(of_mesh.windows(2)).all(|w| w[0][3] >= w[1][3]), "back to front");
            let ball = 4.0 / 3.0 * std::f32::consts::PI * 8000.0;
            assert!((area_of(&of_mesh) * 0.25 / ball - 1.0).abs() < 5e-3, "{view}");
        }
    }
}
