//! Filled contours: the sections of a closed mesh by planes (\[RVD01\] section 2.4).
//!
//! *Method*: a triangle that a plane crosses has exactly two crossed edges (a vertex on the plane
//! counts as above it). The crossings of a closed mesh therefore link up into closed loops by the
//! identity of their edges, without comparing coordinates. The loops of one plane, any number of
//! them, concave and nested, are filled together by lyon's sweep-line tessellator with the even-odd
//! rule: the area inside an outer contour and outside an inner one. The paper's tessellator
//! (OpenGL's utility library) makes trapezoids by the same rule. A stencil buffer would need no
//! contours, but two passes over the mesh for every slice and an attachment that the slices' target
//! does not have. Contours are made once per view, and their triangles are vertices like those of
//! any slice.
//!
//! Instead of using an active edge list, triangles are first sorted into the planes that they
//! cross: the planes are then independent and processed on all cores.

use super::Mesh;
use glam::{Vec2, Vec3};
use lyon_tessellation::math::point;
use lyon_tessellation::path::Path;
use lyon_tessellation::{BuffersBuilder, FillOptions, FillRule, FillTessellator, FillVertex, VertexBuffers};
use rayon::prelude::*;
use std::collections::HashMap;

/// The crossing of the edge between two vertices, by their indices.
type EdgeKey = (u32, u32);

/// A family of parallel planes: p · normal = offset.
#[derive(Clone, Copy, Debug)]
pub struct Planes {
    /// Unit normal.
    pub normal: Vec3,
    /// Two unit vectors in the planes.
    pub across: [Vec3; 2],
}

impl Planes {
    /// The planes perpendicular to a direction.
    pub fn across(normal: Vec3) -> Self {
        let (u, v) = normal.any_orthonormal_pair();
        Self {
            normal,
            across: [u, v],
        }
    }

    fn flat(&self, p: Vec3) -> Vec2 {
        Vec2::new(p.dot(self.across[0]), p.dot(self.across[1]))
    }
}

/// Triangles that fill the mesh's sections by planes at the given increasing offsets, plane by
/// plane.
pub fn sections(mesh: &Mesh, planes: &Planes, offsets: &[f32]) -> Vec<Vec<[Vec3; 3]>> {
    let height: Vec<f32> = mesh.positions.iter().map(|p| p.dot(planes.normal)).collect();
    // The triangles crossed by each plane.
    let mut crossed: Vec<Vec<u32>> = vec![Vec::new(); offsets.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let h = triangle.map(|v| height[v as usize]);
        let (low, high) = (h[0].min(h[1]).min(h[2]), h[0].max(h[1]).max(h[2]));
        let first = offsets.partition_point(|o| *o <= low);
        let last = offsets.partition_point(|o| *o <= high);
        crossed[first..last].iter_mut().for_each(|c| c.push(t as u32));
    }
    offsets
        .par_iter()
        .zip(&crossed)
        .map(|(&offset, triangles)| {
            let loops = loops(mesh, &height, offset, triangles);
            fill(
                &loops
                    .iter()
                    .map(|l| l.iter().map(|p| planes.flat(*p)).collect())
                    .collect::<Vec<Vec<Vec2>>>(),
            )
            .into_iter()
            .map(|t| t.map(|q| planes.across[0] * q.x + planes.across[1] * q.y + planes.normal * offset))
            .collect()
        })
        .collect()
}

/// The closed loops of a plane's section through some triangles.
fn loops(mesh: &Mesh, height: &[f32], offset: f32, triangles: &[u32]) -> Vec<Vec<Vec3>> {
    let above = |v: u32| height[v as usize] >= offset;
    let place = |(a, b): EdgeKey| {
        let (ha, hb) = (height[a as usize], height[b as usize]);
        mesh.positions[a as usize].lerp(
            mesh.positions[b as usize],
            ((offset - ha) / (hb - ha)).clamp(0.0, 1.0),
        )
    };
    // From the edge where the contour enters a triangle to the one where it leaves: a consistent
    // direction around the mesh's inside.
    let mut next: HashMap<EdgeKey, Vec<EdgeKey>> = HashMap::with_capacity(triangles.len());
    for &t in triangles {
        let v = mesh.triangles[t as usize];
        let (mut enter, mut leave) = (None, None);
        for c in 0..3 {
            let (a, b) = (v[c], v[(c + 1) % 3]);
            match (above(a), above(b)) {
                (false, true) => enter = Some((a.min(b), a.max(b))),
                (true, false) => leave = Some((a.min(b), a.max(b))),
                _ => {}
            }
        }
        if let (Some(enter), Some(leave)) = (enter, leave) {
            next.entry(enter).or_default().push(leave);
        }
    }
    let mut all = Vec::new();
    let mut starts: Vec<EdgeKey> = next.keys().copied().collect();
    starts.sort_unstable();
    for start in starts {
        let mut here = start;
        let mut points = Vec::new();
        while let Some(to) = next.get_mut(&here).and_then(Vec::pop) {
            points.push(place(here));
            here = to;
            if here == start {
                break;
            }
        }
        if points.len() >= 3 {
            all.push(points);
        }
    }
    all
}

/// Triangles that fill loops by the even-odd rule.
fn fill(loops: &[Vec<Vec2>]) -> Vec<[Vec2; 3]> {
    let mut low = Vec2::INFINITY;
    let mut high = Vec2::NEG_INFINITY;
    for p in loops.iter().flatten() {
        (low, high) = (low.min(*p), high.max(*p));
    }
    // lyon uses its own fixed-point format: everything fits at a scale of a thousand units.
    let scale = 1000.0 / (high - low).max_element().max(f32::MIN_POSITIVE);
    let mut path = Path::builder();
    for l in loops {
        let to = |p: Vec2| point((p.x - low.x) * scale, (p.y - low.y) * scale);
        path.begin(to(l[0]));
        l[1..].iter().for_each(|p| {
            path.line_to(to(*p));
        });
        path.end(true);
    }
    let mut buffers: VertexBuffers<Vec2, u32> = VertexBuffers::new();
    let options = FillOptions::tolerance(0.01).with_fill_rule(FillRule::EvenOdd);
    let mut output = BuffersBuilder::new(&mut buffers, |v: FillVertex| {
        Vec2::new(v.position().x, v.position().y) / scale + low
    });
    // A degenerate section has no area to fill.
    if loops.is_empty()
        || FillTessellator::new()
            .tessellate_path(&path.build(), &options, &mut output)
            .is_err()
    {
        return Vec::new();
    }
    buffers
        .indices
        .chunks_exact(3)
        .map(|t| [0, 1, 2].map(|c| buffers.vertices[t[c] as usize]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::shapes;
    use super::*;
    use glam::Affine3A;
    use std::f32::consts::PI;

    fn area(triangles: &[[Vec3; 3]]) -> f32 {
        triangles
            .iter()
            .map(|[a, b, c]| (*b - *a).cross(*c - *a).length() / 2.0)
            .sum()
    }

    /// Concave, with a hole: a torus lying and standing. Several nested contours in a plane: a ball
    /// in a ball in a ball.
    #[test]
    fn sections_have_the_area_of_the_closed_form() {
        let torus = shapes::torus(10.0, 3.0, 96);
        let lying = sections(&torus, &Planes::across(Vec3::Z), &[-1.0, 0.0, 4.0]);
        let ring = |z: f32| {
            let w = (9.0 - z * z).sqrt();
            PI * ((10.0 + w).powi(2) - (10.0 - w).powi(2))
        };
        assert!(
            (area(&lying[0]) / ring(1.0) - 1.0).abs() < 3e-3
                && (area(&lying[1]) / ring(0.0) - 1.0).abs() < 3e-3
                && lying[2].is_empty()
        );
        let standing = sections(&torus, &Planes::across(Vec3::X), &[0.0]);
        assert!((area(&standing[0]) / (2.0 * PI * 9.0) - 1.0).abs() < 3e-3);
        let mut nested = shapes::sphere(10.0, 64);
        for r in [7.0, 4.0] {
            let inner = shapes::sphere(r, 64);
            let first = nested.positions.len() as u32;
            nested.positions.extend(&inner.positions);
            nested
                .triangles
                .extend(inner.triangles.iter().map(|t| t.map(|v| v + first)));
        }
        let nested = nested.transformed(&Affine3A::from_rotation_x(0.3));
        let cut = sections(&nested, &Planes::across(Vec3::Y), &[0.0]);
        assert!((area(&cut[0]) / (PI * (100.0 - 49.0 + 16.0)) - 1.0).abs() < 3e-3);
    }
}
