//! The connectivity of a mesh: components, open edges, orientation.

use super::{Mesh, volume_of};

/// Counts over a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Topology {
    /// Number of parts that share no vertex.
    pub components: usize,
    /// Edges with one triangle: the boundaries of holes.
    pub open_edges: usize,
    /// Edges with more than two triangles.
    pub non_manifold_edges: usize,
    /// Edges whose two triangles face opposite ways.
    pub flipped_edges: usize,
    /// Whether every edge has exactly two triangles.
    pub watertight: bool,
    /// Signed volume in the unit of the coordinates cubed; meaningful if watertight.
    pub volume: f64,
}

/// An edge and one of its triangles.
struct Edge {
    low: u32,
    high: u32,
    /// Whether the triangle runs from low to high.
    upwards: bool,
    triangle: u32,
}

fn sorted_edges(mesh: &Mesh) -> Vec<Edge> {
    use rayon::slice::ParallelSliceMut;
    let mut edges: Vec<Edge> = mesh
        .triangles
        .iter()
        .enumerate()
        .flat_map(|(n, t)| {
            (0..3).map(move |c| {
                let (a, b) = (t[c], t[(c + 1) % 3]);
                Edge {
                    low: a.min(b),
                    high: a.max(b),
                    upwards: a < b,
                    triangle: n as u32,
                }
            })
        })
        .collect();
    edges.par_sort_unstable_by_key(|e| (e.low, e.high, e.triangle));
    edges
}

/// Disjoint sets (union-find).
struct Sets(Vec<u32>);

impl Sets {
    fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    fn find(&mut self, mut a: u32) -> u32 {
        while self.0[a as usize] != a {
            self.0[a as usize] = self.0[self.0[a as usize] as usize];
            a = self.0[a as usize];
        }
        a
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

impl Topology {
    pub(super) fn of(mesh: &Mesh) -> Self {
        let edges = sorted_edges(mesh);
        let (mut open, mut crowded, mut flipped) = (0, 0, 0);
        for same in edges.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high)) {
            match same {
                [_] => open += 1,
                [a, b] => flipped += usize::from(a.upwards == b.upwards),
                _ => crowded += 1,
            }
        }
        let mut sets = Sets::new(mesh.positions.len());
        for t in &mesh.triangles {
            sets.join(t[0], t[1]);
            sets.join(t[0], t[2]);
        }
        let mut roots: Vec<u32> = mesh.triangles.iter().map(|t| sets.find(t[0])).collect();
        roots.sort_unstable();
        roots.dedup();
        Self {
            components: roots.len(),
            open_edges: open,
            non_manifold_edges: crowded,
            flipped_edges: flipped,
            watertight: open == 0 && crowded == 0 && !mesh.triangles.is_empty(),
            volume: mesh.signed_volume(),
        }
    }

    /// outward, inward, inconsistent or open.
    pub fn orientation(&self) -> &'static str {
        match self {
            t if t.flipped_edges > 0 => "inconsistent",
            t if !t.watertight => "open",
            t if t.volume < 0.0 => "inward",
            _ => "outward",
        }
    }
}

impl Mesh {
    /// The mesh with consistently oriented triangles. In every patch of triangles connected across
    /// edges of two, contradicting triangles are flipped; a patch that had contradictions is then
    /// flipped if it encloses a negative volume about its own centre. If the whole mesh encloses a
    /// negative volume, all of it is flipped. Also returns the number of flipped triangles.
    ///
    /// Consistent patches keep their orientation: an inner wall correctly faces inwards.
    pub fn oriented(mut self) -> (Self, usize) {
        let edges = sorted_edges(&self);
        let mut neighbours: Vec<Vec<(u32, bool)>> = vec![Vec::new(); self.triangles.len()];
        for same in edges.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high)) {
            if let [a, b] = same {
                let agree = a.upwards != b.upwards;
                neighbours[a.triangle as usize].push((b.triangle, agree));
                neighbours[b.triangle as usize].push((a.triangle, agree));
            }
        }
        let mut turn = vec![false; self.triangles.len()];
        let mut seen = vec![false; self.triangles.len()];
        for seed in 0..self.triangles.len() {
            if seen[seed] {
                continue;
            }
            seen[seed] = true;
            let mut patch = vec![seed];
            let mut next = 0;
            let mut contradicted = false;
            while let Some(&t) = patch.get(next) {
                next += 1;
                for &(o, agree) in &neighbours[t] {
                    contradicted |= !agree;
                    if !seen[o as usize] {
                        seen[o as usize] = true;
                        turn[o as usize] = turn[t] == agree;
                        patch.push(o as usize);
                    }
                }
            }
            if contradicted {
                let middle =
                    patch.iter().map(|&t| self.corners(t)[0]).sum::<glam::Vec3>() / patch.len() as f32;
                let volume: f64 = patch
                    .iter()
                    .map(|&t| {
                        volume_of(self.corners(t).map(|p| p - middle)) * if turn[t] { -1.0 } else { 1.0 }
                    })
                    .sum();
                if volume < 0.0 {
                    patch.iter().for_each(|&t| turn[t] = !turn[t]);
                }
            }
        }
        let apply = |mesh: &mut Self, turn: &dyn Fn(usize) -> bool| {
            mesh.triangles
                .iter_mut()
                .enumerate()
                .filter(|(t, _)| turn(*t))
                .for_each(|(_, t)| t.swap(1, 2));
        };
        apply(&mut self, &|t| turn[t]);
        if self.signed_volume() < 0.0 {
            apply(&mut self, &|_| true);
            turn.iter_mut().for_each(|t| *t = !*t);
        }
        let turned = turn.iter().filter(|t| **t).count();
        (self, turned)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn tetrahedron() -> Mesh {
        let p = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        Mesh::new(p, vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], vec![])
    }

    #[test]
    fn a_tetrahedron_is_closed_and_faces_outwards() {
        let t = tetrahedron().topology();
        assert_eq!(
            (
                t.components,
                t.open_edges,
                t.flipped_edges,
                t.watertight,
                t.orientation()
            ),
            (1, 0, 0, true, "outward")
        );
        assert!((t.volume - 1.0 / 6.0).abs() < 1e-7);
    }

    #[test]
    fn turned_and_missing_triangles_are_noticed_and_turned_back() {
        let mut mesh = tetrahedron();
        mesh.triangles[2].swap(0, 1);
        assert_eq!(mesh.topology().orientation(), "inconsistent");
        let (mesh, turned) = mesh.oriented();
        assert_eq!((turned, mesh.topology().orientation()), (1, "outward"));
        let mut inward = tetrahedron();
        inward.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert_eq!(inward.topology().orientation(), "inward");
        assert_eq!(inward.oriented().1, 4);
        let mut open = tetrahedron();
        open.triangles.pop();
        assert_eq!(
            (open.topology().open_edges, open.topology().orientation()),
            (3, "open")
        );
    }

    #[test]
    fn vertices_are_welded_and_empty_triangles_dropped() {
        let p = vec![
            Vec3::ZERO,
            Vec3::X,
            Vec3::Y,
            Vec3::X,
            Vec3::Y,
            Vec3::ONE,
            Vec3::X * 0.5,
        ];
        let mesh = Mesh::new(p, vec![[0, 1, 2], [3, 5, 4], [0, 6, 1], [1, 3, 5]], vec![]);
        assert_eq!(
            (
                mesh.positions.len(),
                mesh.triangles.len(),
                mesh.welded,
                mesh.degenerate
            ),
            (5, 2, 2, 2)
        );
        assert_eq!(mesh.topology().components, 1);
    }
}
