//! Depth maps as implicit solids (\[DS07\] section 6.1): much less memory than a distance field,
//! for solids without hidden concavities.
//!
//! A map over one face of the mesh's box holds, for each of its points, the depth of the surface
//! below the face. With d the depth of a point and H the map's, f = d - H is positive below the
//! surface. A cube of six maps is f = ρ min |f_i|, ρ = 1 where all six are positive. (The paper
//! writes f = H - d, which is negative inside by its own sign convention.) A concavity that no face
//! sees is filled. f is not a distance: its slope is unbounded where H jumps, hence rays take even
//! steps through it and skip nothing.

use super::TriangleBvh;
use crate::math::Bounds;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// The faces of a box on which a map can lie, in the order of a cube's maps.
pub const FACES: [&str; 6] = ["-x", "+x", "-y", "+y", "-z", "+z"];

/// One map, or the six of a cube.
#[derive(Clone, Debug)]
pub struct DepthMaps {
    /// The box on whose faces they lie, mm.
    pub bounds: Bounds,
    /// Texels along each edge of a map.
    pub size: usize,
    /// Face of each map, as an index into [`FACES`].
    pub faces: Vec<u32>,
    /// Depth below the face, mm, map after map, with the lower of the other two axes fastest; the
    /// box's whole depth where there is no surface.
    pub depth_mm: Vec<f32>,
}

impl DepthMaps {
    /// Renders depth maps of a mesh from the given faces.
    pub fn new(tree: &TriangleBvh, bounds: Bounds, size: usize, faces: &[u32]) -> Self {
        let depth_mm = faces
            .iter()
            .flat_map(|&face| {
                let (axis, inward) = axis_of(face);
                let [u, v] = others(axis);
                let extent = bounds.size();
                let mut direction = Vec3::ZERO;
                direction[axis] = inward;
                (0..size * size)
                    .into_par_iter()
                    .map(|n| {
                        let mut origin = if inward > 0.0 { bounds.min } else { bounds.max };
                        origin[u] = bounds.min[u] + (n % size) as f32 / (size - 1) as f32 * extent[u];
                        origin[v] = bounds.min[v] + (n / size) as f32 / (size - 1) as f32 * extent[v];
                        tree.ray(origin, direction, 0.0, extent[axis], |_| true)
                            .map_or(extent[axis], |h| h.t)
                    })
                    .collect::<Vec<f32>>()
            })
            .collect();
        Self {
            bounds,
            size,
            faces: faces.to_vec(),
            depth_mm,
        }
    }

    /// f of map number n at a world point.
    fn height(&self, n: usize, world: Vec3) -> f32 {
        let (axis, inward) = axis_of(self.faces[n]);
        let [u, v] = others(axis);
        let x = (world - self.bounds.min) / self.bounds.size();
        let depth = if inward > 0.0 {
            world[axis] - self.bounds.min[axis]
        } else {
            self.bounds.max[axis] - world[axis]
        };
        depth - self.fetch(n, Vec2::new(x[u], x[v]))
    }

    /// Depth by bilinear interpolation at a position in 0..1.
    fn fetch(&self, n: usize, at: Vec2) -> f32 {
        let top = (self.size - 1) as f32;
        let p = (at * top).clamp(Vec2::ZERO, Vec2::splat(top));
        let (i, j) = (
            (p.x as usize).min(self.size - 2),
            (p.y as usize).min(self.size - 2),
        );
        let (fx, fy) = (p.x - i as f32, p.y - j as f32);
        let h = |i: usize, j: usize| self.depth_mm[(n * self.size + j) * self.size + i];
        let row = |j: usize| h(i, j) + (h(i + 1, j) - h(i, j)) * fx;
        row(j) + (row(j + 1) - row(j)) * fy
    }

    /// f at a world point, positive inside.
    pub fn value(&self, world: Vec3) -> f32 {
        let x = (world - self.bounds.min) / self.bounds.size();
        let beyond = (self.bounds.min - world)
            .max(world - self.bounds.max)
            .max_element();
        if beyond > 0.0 || !x.is_finite() {
            return -beyond.max(1e-3);
        }
        let (mut least, mut inside) = (f32::INFINITY, true);
        for n in 0..self.faces.len() {
            let f = self.height(n, world);
            least = least.min(f.abs());
            inside &= f > 0.0;
        }
        if inside { least } else { -least }
    }

    /// Bytes of the maps, in single precision.
    pub fn bytes(&self) -> usize {
        4 * self.depth_mm.len()
    }
}

/// Axis of a face and the sign of its map's viewing direction.
fn axis_of(face: u32) -> (usize, f32) {
    (face as usize / 2, if face.is_multiple_of(2) { 1.0 } else { -1.0 })
}

/// The other two axes, in order.
fn others(axis: usize) -> [usize; 2] {
    [[1, 2], [0, 2], [0, 1]][axis.min(2)]
}

#[cfg(test)]
mod tests {
    use super::super::shapes::sphere;
    use super::*;

    #[test]
    fn a_cube_of_maps_sees_a_ball_and_one_map_its_near_side() {
        let mesh = sphere(10.0, 48);
        let (tree, bounds) = (TriangleBvh::new(&mesh), mesh.bounds().grown(2.0));
        let cube = DepthMaps::new(&tree, bounds, 129, &[0, 1, 2, 3, 4, 5]);
        for p in [
            Vec3::new(3.0, 2.0, 1.0),
            Vec3::new(0.0, 9.0, 0.0),
            Vec3::new(-5.0, 5.0, -5.0),
        ] {
            assert!(
                cube.value(p) > 0.0 && cube.value(p.normalize() * 10.5) < 0.0,
                "{p}"
            );
        }
        // On an axis f is the distance itself.
        let along = cube.value(Vec3::new(7.0, 0.0, 0.0));
        assert!(
            (along - 3.0).abs() < 0.05,
            "{along}, by face {:?}",
            (0..6)
                .map(|n| cube.height(n, Vec3::new(7.0, 0.0, 0.0)))
                .collect::<Vec<_>>()
        );
        let front = DepthMaps::new(&tree, bounds, 129, &[4]);
        assert!(
            front.value(Vec3::new(0.0, 0.0, -10.5)) < 0.0 && front.value(Vec3::new(0.0, 0.0, 10.5)) > 0.0
        );
        assert_eq!((cube.bytes(), front.bytes()), (6 * 129 * 129 * 4, 129 * 129 * 4));
    }
}
