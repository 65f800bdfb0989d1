//! Refines triangles where a deformer bends them: an edge is halved if its point at a quarter, a
//! half or three quarters is displaced from the straight line between the deformed ends.
//!
//! Whether an edge is halved depends on the edge alone; hence both its triangles agree and no gap
//! opens (Velho and Zorin's conforming refinement by edges).

use super::Mesh;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// Rounds of halving: the edges that a round creates inside a triangle may be as long as the
/// triangle.
const ROUNDS: usize = 20;

impl Mesh {
    /// Refines the mesh until no tested point of an edge, moved by `deform`, is farther than
    /// `tolerance_mm` from the edge, up to `most` triangles. Also returns whether the tolerance was
    /// reached.
    pub fn tessellated(
        mut self,
        deform: impl Fn(Vec3) -> Vec3 + Sync,
        tolerance_mm: f32,
        most: usize,
    ) -> (Self, bool) {
        for _ in 0..ROUNDS {
            let mut edges: Vec<(u32, u32)> = self
                .triangles
                .iter()
                .flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])])
                .map(|(a, b)| (a.min(b), a.max(b)))
                .collect();
            edges.par_sort_unstable();
            edges.dedup();
            let positions = &self.positions;
            let moved: Vec<Vec3> = positions.par_iter().map(|p| deform(*p)).collect();
            let coarse: Vec<(u32, u32)> = edges
                .into_par_iter()
                .filter(|&(a, b)| {
                    let (a, b) = (a as usize, b as usize);
                    // A full turn does not move the midpoint.
                    [0.25, 0.5, 0.75].iter().any(|&t| {
                        deform(positions[a].lerp(positions[b], t)).distance(moved[a].lerp(moved[b], t))
                            > tolerance_mm
                    })
                })
                .collect();
            if coarse.is_empty() {
                return (self, true);
            }
            if self.triangles.len() + 2 * coarse.len() > most {
                return (self, false);
            }
            let mut middle: HashMap<(u32, u32), u32> = HashMap::with_capacity(coarse.len());
            for (a, b) in coarse {
                middle.insert((a, b), self.positions.len() as u32);
                self.positions
                    .push((self.positions[a as usize] + self.positions[b as usize]) * 0.5);
            }
            let halved = |a: u32, b: u32| middle.get(&(a.min(b), a.max(b))).copied();
            self.triangles = self
                .triangles
                .iter()
                .flat_map(|&[a, b, c]| match (halved(a, b), halved(b, c), halved(c, a)) {
                    (None, None, None) => vec![[a, b, c]],
                    (Some(m), None, None) => vec![[a, m, c], [m, b, c]],
                    (None, Some(m), None) => vec![[b, m, a], [m, c, a]],
                    (None, None, Some(m)) => vec![[c, m, b], [m, a, b]],
                    (Some(m), Some(n), None) => vec![[m, b, n], [a, m, n], [a, n, c]],
                    (None, Some(m), Some(n)) => vec![[m, c, n], [b, m, n], [b, n, a]],
                    (Some(n), None, Some(m)) => vec![[m, a, n], [c, m, n], [c, n, b]],
                    (Some(m), Some(n), Some(o)) => vec![[a, m, o], [m, b, n], [o, n, c], [m, n, o]],
                })
                .collect();
        }
        (self, false)
    }
}

#[cfg(test)]
mod tests {
    use super::super::shapes;
    use super::*;

    #[test]
    fn a_coarse_box_twists_smoothly_and_stays_closed() {
        let twist = |p: Vec3| {
            let (s, c) = (p.z * 0.1).sin_cos();
            Vec3::new(c * p.x - s * p.y, s * p.x + c * p.y, p.z)
        };
        let (mesh, reached) = shapes::cuboid(Vec3::new(5.0, 5.0, 15.0)).tessellated(twist, 0.05, 100_000);
        assert!(reached && mesh.triangles.len() > 100, "{}", mesh.triangles.len());
        let t = mesh.topology();
        assert!(t.watertight && t.orientation() == "outward", "{t:?}");
        assert!((t.volume - 3000.0).abs() < 0.1);
        let (_, reached) = shapes::cuboid(Vec3::new(5.0, 5.0, 15.0)).tessellated(twist, 0.05, 50);
        assert!(!reached);
    }
}
