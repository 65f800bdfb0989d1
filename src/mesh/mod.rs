//! Triangle meshes and the data derived from them: signed distance fields, depth maps, forward
//! deformers, contours.
//!
//! *Theory*: any triangle mesh, watertight or not, becomes a signed distance field ([`field`];
//! positive inside, millimetres) that the same displacement maps deform and cut as volumes
//! (\[DS07\]). The sign is the generalised winding number (Barill et al. 2018, "Fast Winding
//! Numbers for Soups and Clouds"), which defines an inside even for triangle soups and meshes with
//! holes.
//!
//! Coordinates are world millimetres, LPS. Mesh formats state no orientation, and Slicer writes
//! LPS: coordinates are used unchanged. GIfTI belongs to the NIfTI family and is RAS: its x and y
//! are negated.

mod bvh;
pub mod contour;
pub mod deformer;
pub mod depth_map;
pub mod field;
pub mod formula;
mod implicit;
pub mod load;
pub mod shapes;
pub mod tessellate;
mod topology;

pub use bvh::{MeshHit, Nearest, TriangleBvh};
pub use implicit::Implicit;
pub use topology::Topology;

use crate::math::{Bounds, normalize_or};
use glam::{Affine3A, Mat3, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

/// A triangle mesh.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// World positions, mm.
    pub positions: Vec<Vec3>,
    /// Vertex indices, counter-clockwise when seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Irregularities of the source, one sentence each.
    pub warnings: Vec<String>,
    /// Number of zero-area triangles dropped from the source.
    pub degenerate: usize,
    /// Number of vertices of the source merged with another one.
    pub welded: usize,
}

/// Points closer than this fraction of the mesh's diagonal are one vertex.
const WELD: f32 = 1e-6;
/// Faces that meet at a sharper angle than this have separate normals, degrees.
const CREASE_DEG: f32 = 40.0;

impl Mesh {
    /// A mesh from the content of a file: equal vertices are merged; triangles without area or with
    /// non-finite coordinates are dropped.
    pub fn new(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>, mut warnings: Vec<String>) -> Self {
        let finite = |t: &[u32; 3]| t.iter().all(|&v| positions[v as usize].is_finite());
        let used: Vec<[u32; 3]> = triangles.iter().copied().filter(finite).collect();
        if used.len() < triangles.len() {
            warnings.push(format!(
                "{} triangles with coordinates that are not finite were left out",
                triangles.len() - used.len()
            ));
        }
        let mut bounds = Bounds::EMPTY;
        for p in used.iter().flatten().map(|&v| positions[v as usize]) {
            bounds = bounds.union(&Bounds::new(p, p));
        }
        let cell = (bounds.size().length() * WELD).max(f32::MIN_POSITIVE);
        let mut index_of: HashMap<[i64; 3], u32> = HashMap::new();
        let (mut unique_points, mut renamed) = (Vec::new(), vec![u32::MAX; positions.len()]);
        let mut referenced = 0;
        for &v in used.iter().flatten() {
            if renamed[v as usize] == u32::MAX {
                referenced += 1;
                let p = positions[v as usize];
                let key = ((p - bounds.min) / cell).round().to_array().map(|c| c as i64);
                renamed[v as usize] = *index_of.entry(key).or_insert_with(|| {
                    unique_points.push(p);
                    unique_points.len() as u32 - 1
                });
            }
        }
        let welded = referenced - unique_points.len();
        let all = used.len();
        let triangles: Vec<[u32; 3]> = used
            .into_iter()
            .map(|t| t.map(|v| renamed[v as usize]))
            .filter(|t| {
                let [a, b, c] = t.map(|v| unique_points[v as usize]);
                t[0] != t[1] && t[1] != t[2] && t[2] != t[0] && (b - a).cross(c - a).length_squared() > 0.0
            })
            .collect();
        let degenerate = all - triangles.len();
        Self {
            positions: unique_points,
            triangles,
            warnings,
            degenerate,
            welded,
        }
    }

    /// The corners of a triangle.
    #[inline(always)]
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }

    /// The box around all vertices.
    pub fn bounds(&self) -> Bounds {
        self.positions
            .iter()
            .fold(Bounds::EMPTY, |b, p| b.union(&Bounds::new(*p, *p)))
    }

    /// The signed volume between the triangles and the centre of the mesh's box: positive if they
    /// face outwards. For closed meshes this is their volume, wherever they lie.
    pub fn signed_volume(&self) -> f64 {
        let middle = self.bounds().center();
        (0..self.triangles.len())
            .map(|t| volume_of(self.corners(t).map(|p| p - middle)))
            .sum()
    }

    /// The mesh under an affine transform; a reflection flips its triangles so that they still face
    /// outwards.
    pub fn transformed(mut self, transform: &Affine3A) -> Self {
        self.positions
            .par_iter_mut()
            .for_each(|p| *p = transform.transform_point3(*p));
        if Mat3::from(transform.matrix3).determinant() < 0.0 {
            self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        self
    }

    /// Unit normals of the triangles.
    pub fn face_normals(&self) -> Vec<Vec3> {
        (0..self.triangles.len())
            .into_par_iter()
            .map(|t| {
                let [a, b, c] = self.corners(t);
                normalize_or((b - a).cross(c - a), Vec3::Z)
            })
            .collect()
    }

    /// Normals for smooth shading, one per corner of each triangle: face normals weighted by their
    /// angle at the vertex (Thürmer and Wüthrich 1998), excluding faces beyond a crease.
    pub fn corner_normals(&self) -> Vec<[Vec3; 3]> {
        let faces = self.face_normals();
        // The triangles around each vertex, with their angles there.
        let mut around: Vec<Vec<(u32, f32)>> = vec![Vec::new(); self.positions.len()];
        for (t, triangle) in self.triangles.iter().enumerate() {
            let p = self.corners(t);
            for c in 0..3 {
                let (u, v) = (p[(c + 1) % 3] - p[c], p[(c + 2) % 3] - p[c]);
                around[triangle[c] as usize].push((t as u32, u.cross(v).length().atan2(u.dot(v))));
            }
        }
        let crease = CREASE_DEG.to_radians().cos();
        self.triangles
            .par_iter()
            .enumerate()
            .map(|(t, triangle)| {
                let own = faces[t];
                triangle.map(|v| {
                    let near = around[v as usize]
                        .iter()
                        .filter(|(o, _)| faces[*o as usize].dot(own) >= crease);
                    normalize_or(near.map(|&(o, angle)| faces[o as usize] * angle).sum(), own)
                })
            })
            .collect()
    }

    /// The connectivity of the triangles.
    pub fn topology(&self) -> Topology {
        Topology::of(self)
    }
}

/// Signed volume of the tetrahedron of a triangle and the origin.
fn volume_of([a, b, c]: [Vec3; 3]) -> f64 {
    a.as_dvec3().dot(b.as_dvec3().cross(c.as_dvec3())) / 6.0
}
