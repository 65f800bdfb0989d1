//! A bounding volume hierarchy over the triangles of a mesh: nearest points, rays, and the
//! generalised winding number.
//!
//! *Theory*: the winding number of a point is the sum of the triangles' solid angles over 4π
//! (Jacobson et al. 2013). Far from a group of triangles the sum is that of a dipole and its first
//! derivative at the group's centre (Barill et al. 2018, equations 13 and 14); "far" is [`FAR`]
//! times the group's radius.

use super::Mesh;
use crate::math::Bounds;
use glam::{Mat3, Vec3};

/// Maximum number of triangles in a leaf.
const LEAF: usize = 4;
/// Distance beyond which a group's winding number is approximated, in its radii.
const FAR: f32 = 2.3;
/// Margin of triangles beyond their edges, in barycentric coordinates, for first-hit rays: a ray
/// through an edge hits at least one of its two triangles.
const SLACK: f32 = 1e-6;
/// Deepest path: a median split halves its triangles.
const STACK: usize = 64;

struct BvhNode {
    bounds: Bounds,
    /// Index of the first triangle of a leaf, or of the second child (the first one follows its
    /// parent).
    start: u32,
    /// Number of triangles in a leaf; 0 in an inner node.
    count: u32,
    dipole: Dipole,
}

/// The far-field approximation of a group of triangles.
#[derive(Clone, Copy)]
struct Dipole {
    /// Area-weighted centre.
    middle: Vec3,
    /// Largest distance of a corner from the centre.
    radius: f32,
    /// Sum of area times normal.
    area: Vec3,
    /// Sum of area times (centroid - centre) ⊗ normal.
    moment: Mat3,
}

/// Triangles sorted by position.
pub struct TriangleBvh {
    nodes: Vec<BvhNode>,
    corners: Vec<[Vec3; 3]>,
    /// Index of each triangle in the mesh.
    index: Vec<u32>,
}

/// The nearest point of a mesh.
#[derive(Clone, Copy, Debug)]
pub struct Nearest {
    /// Squared distance.
    pub squared: f32,
    /// The point.
    pub point: Vec3,
    /// Its triangle, by its index in the tree; for [`TriangleBvh::nearest_from`].
    pub slot: u32,
}

/// A ray's hit on a mesh.
#[derive(Clone, Copy, Debug)]
pub struct MeshHit {
    /// Parameter along the ray.
    pub t: f32,
    /// Triangle in the mesh.
    pub triangle: u32,
    /// Weights of its second and third corner.
    pub barycentric: [f32; 2],
    /// Whether the ray comes from the side that the triangle faces.
    pub front: bool,
}

impl TriangleBvh {
    /// Builds the hierarchy of a mesh.
    pub fn new(mesh: &Mesh) -> Self {
        let mut order: Vec<(Vec3, u32)> = (0..mesh.triangles.len())
            .map(|t| (mesh.corners(t).iter().sum::<Vec3>() / 3.0, t as u32))
            .collect();
        let mut tree = Self {
            nodes: Vec::with_capacity(2 * order.len() / LEAF + 1),
            corners: Vec::new(),
            index: Vec::new(),
        };
        if !order.is_empty() {
            tree.build(mesh, &mut order);
        }
        tree
    }

    fn build(&mut self, mesh: &Mesh, order: &mut [(Vec3, u32)]) -> usize {
        let here = self.nodes.len();
        let bounds = order
            .iter()
            .flat_map(|o| mesh.corners(o.1 as usize))
            .fold(Bounds::EMPTY, |b, p| Bounds::new(b.min.min(p), b.max.max(p)));
        let dipole = Dipole::of(order.iter().map(|o| mesh.corners(o.1 as usize)));
        let leaf = order.len() <= LEAF;
        self.nodes.push(BvhNode {
            bounds,
            start: self.corners.len() as u32,
            count: if leaf { order.len() as u32 } else { 0 },
            dipole,
        });
        if leaf {
            for (_, t) in order.iter() {
                self.corners.push(mesh.corners(*t as usize));
                self.index.push(*t);
            }
            return here;
        }
        let (low, high) = order
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), o| {
                (l.min(o.0), h.max(o.0))
            });
        let extent = high - low;
        let axis = if extent.x >= extent.y && extent.x >= extent.z {
            0
        } else {
            1 + usize::from(extent.z > extent.y)
        };
        let middle = order.len() / 2;
        order.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]));
        let (first, second) = order.split_at_mut(middle);
        self.build(mesh, first);
        let second = self.build(mesh, second);
        self.nodes[here].start = second as u32;
        here
    }

    /// The nearest point of the mesh within `reach` of p.
    pub fn nearest(&self, p: Vec3, reach: f32) -> Option<Nearest> {
        self.search(
            p,
            Nearest {
                squared: reach * reach,
                point: p,
                slot: u32::MAX,
            },
        )
    }

    /// As [`Self::nearest`], starting from the nearest triangle of a neighbouring point.
    pub fn nearest_from(&self, p: Vec3, guess: u32) -> Option<Nearest> {
        let point = nearest_on_triangle(p, &self.corners[guess as usize]);
        self.search(
            p,
            Nearest {
                squared: p.distance_squared(point),
                point,
                slot: guess,
            },
        )
    }

    /// As [`Self::nearest_from`], but none if the mesh is farther than `reach`.
    pub fn nearest_within(&self, p: Vec3, guess: u32, reach: f32) -> Option<Nearest> {
        let point = nearest_on_triangle(p, &self.corners[guess as usize]);
        let squared = p.distance_squared(point);
        if squared < reach * reach {
            return self.search(
                p,
                Nearest {
                    squared,
                    point,
                    slot: guess,
                },
            );
        }
        self.nearest(p, reach)
    }

    fn search(&self, p: Vec3, mut best: Nearest) -> Option<Nearest> {
        let away = |n: u32| {
            let b = &self.nodes[n as usize].bounds;
            (b.min - p).max(p - b.max).max(Vec3::ZERO).length_squared()
        };
        let mut stack = [(0u32, 0.0f32); STACK];
        let mut height = usize::from(!self.nodes.is_empty());
        while height > 0 {
            height -= 1;
            let (n, squared) = stack[height];
            if squared >= best.squared {
                continue;
            }
            let node = &self.nodes[n as usize];
            if node.count > 0 {
                for slot in node.start..node.start + node.count {
                    let point = nearest_on_triangle(p, &self.corners[slot as usize]);
                    let squared = p.distance_squared(point);
                    if squared < best.squared {
                        best = Nearest { squared, point, slot };
                    }
                }
                continue;
            }
            let (a, b) = (n + 1, node.start);
            let (da, db) = (away(a), away(b));
            // The nearer child is visited first: it is on top of the stack.
            let [far, near] = if da < db {
                [(b, db), (a, da)]
            } else {
                [(a, da), (b, db)]
            };
            if far.1 < best.squared {
                stack[height] = far;
                height += 1;
            }
            if near.1 < best.squared {
                stack[height] = near;
                height += 1;
            }
        }
        (best.slot != u32::MAX).then_some(best)
    }

    /// The winding number of a point: 1 inside a closed mesh that faces outwards, 0 outside, in
    /// between where there are holes.
    pub fn winding(&self, p: Vec3) -> f32 {
        let mut stack = [0u32; STACK];
        let mut height = usize::from(!self.nodes.is_empty());
        let mut sum = 0.0f32;
        while height > 0 {
            height -= 1;
            let n = stack[height];
            let node = &self.nodes[n as usize];
            let d = &node.dipole;
            let away = d.middle - p;
            let squared = away.length_squared();
            if squared > (FAR * d.radius) * (FAR * d.radius) {
                sum += d.solid_angle(away, squared);
            } else if node.count > 0 {
                for slot in node.start..node.start + node.count {
                    sum += solid_angle(p, &self.corners[slot as usize]);
                }
            } else {
                stack[height] = n + 1;
                stack[height + 1] = node.start;
                height += 2;
            }
        }
        sum / (4.0 * std::f32::consts::PI)
    }

    /// The first triangle along a ray, between two parameters, that `accept` accepts.
    pub fn ray(
        &self,
        origin: Vec3,
        direction: Vec3,
        near: f32,
        far: f32,
        accept: impl Fn(&MeshHit) -> bool,
    ) -> Option<MeshHit> {
        let mut best: Option<MeshHit> = None;
        self.all_along(origin, direction, near, far, SLACK, |hit, limit| {
            if accept(&hit) {
                *limit = hit.t;
                best = Some(hit);
            }
        });
        best
    }

    /// All triangles along a ray between two parameters, unordered.
    pub fn crossings(&self, origin: Vec3, direction: Vec3, near: f32, far: f32) -> Vec<MeshHit> {
        let mut all = Vec::new();
        self.all_along(origin, direction, near, far, 0.0, |hit, _| all.push(hit));
        all
    }

    fn all_along(
        &self,
        origin: Vec3,
        direction: Vec3,
        near: f32,
        mut far: f32,
        slack: f32,
        mut found: impl FnMut(MeshHit, &mut f32),
    ) {
        // Finite: infinity times the zero of a ray in a box's face would be NaN.
        let inverse = direction.recip().clamp(Vec3::splat(-1e30), Vec3::splat(1e30));
        let enters = |n: u32, far: f32| {
            let b = &self.nodes[n as usize].bounds;
            let (a, c) = ((b.min - origin) * inverse, (b.max - origin) * inverse);
            let (mut low, mut high) = (near, far);
            for axis in 0..3 {
                low = low.max(a[axis].min(c[axis]));
                high = high.min(a[axis].max(c[axis]));
            }
            // Rounding must not lose a triangle in the face of a flat box.
            (low <= high * 1.000_001 + 1e-6).then_some(low)
        };
        let mut stack = [0u32; STACK];
        let mut height = 0;
        if !self.nodes.is_empty() && enters(0, far).is_some() {
            height = 1;
        }
        while height > 0 {
            height -= 1;
            let n = stack[height];
            let node = &self.nodes[n as usize];
            if node.count > 0 {
                for slot in node.start..node.start + node.count {
                    if let Some((t, u, v, front)) =
                        meet(origin, direction, &self.corners[slot as usize], slack)
                        && t >= near
                        && t <= far
                    {
                        found(
                            MeshHit {
                                t,
                                triangle: self.index[slot as usize],
                                barycentric: [u, v],
                                front,
                            },
                            &mut far,
                        );
                    }
                }
                continue;
            }
            let (a, b) = (n + 1, node.start);
            match (enters(a, far), enters(b, far)) {
                (Some(ta), Some(tb)) => {
                    let (first, second) = if ta <= tb { (a, b) } else { (b, a) };
                    stack[height] = second;
                    stack[height + 1] = first;
                    height += 2;
                }
                (Some(_), None) => (stack[height], height) = (a, height + 1),
                (None, Some(_)) => (stack[height], height) = (b, height + 1),
                (None, None) => {}
            }
        }
    }
}

impl Dipole {
    fn of(triangles: impl Iterator<Item = [Vec3; 3]> + Clone) -> Self {
        let (mut middle, mut whole, mut area) = (Vec3::ZERO, 0.0f32, Vec3::ZERO);
        for [a, b, c] in triangles.clone() {
            let n = (b - a).cross(c - a) * 0.5;
            middle += (a + b + c) / 3.0 * n.length();
            whole += n.length();
            area += n;
        }
        let middle = middle / whole.max(f32::MIN_POSITIVE);
        let (mut radius, mut moment) = (0.0f32, Mat3::ZERO);
        for [a, b, c] in triangles {
            let n = (b - a).cross(c - a) * 0.5;
            let r = (a + b + c) / 3.0 - middle;
            moment += Mat3::from_cols(r * n.x, r * n.y, r * n.z);
            radius = radius.max(
                [a, b, c]
                    .map(|p| p.distance(middle))
                    .into_iter()
                    .fold(0.0, f32::max),
            );
        }
        Self {
            middle,
            radius,
            area,
            moment,
        }
    }

    /// Σ of the group's solid angles; `away` leads from the point to the centre.
    #[inline(always)]
    fn solid_angle(&self, away: Vec3, squared: f32) -> f32 {
        let inverse = squared.sqrt().recip();
        let r = away * inverse;
        let trace = self.moment.x_axis.x + self.moment.y_axis.y + self.moment.z_axis.z;
        let second = (trace - 3.0 * r.dot(self.moment * r)) * inverse;
        (self.area.dot(r) + second) * inverse * inverse
    }
}

/// Solid angle of a triangle (van Oosterom and Strackee 1983), positive where its back faces the
/// point.
fn solid_angle(p: Vec3, corners: &[Vec3; 3]) -> f32 {
    let [a, b, c] = corners.map(|v| v - p);
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let above = a.dot(b.cross(c));
    let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * above.atan2(below)
}

/// The point of a triangle nearest to p (Ericson 2005, section 5.1.5).
pub fn nearest_on_triangle(p: Vec3, &[a, b, c]: &[Vec3; 3]) -> Vec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let inverse = 1.0 / (va + vb + vc);
    a + ab * (vb * inverse) + ac * (vc * inverse)
}

/// Parameter, weights of the second and third corner, and side, where a ray meets a triangle
/// (Möller and Trumbore 1997).
#[inline(always)]
fn meet(origin: Vec3, direction: Vec3, &[a, b, c]: &[Vec3; 3], slack: f32) -> Option<(f32, f32, f32, bool)> {
    let (ab, ac) = (b - a, c - a);
    let q = direction.cross(ac);
    let determinant = ab.dot(q);
    if determinant == 0.0 {
        return None;
    }
    let inverse = 1.0 / determinant;
    let s = origin - a;
    let u = s.dot(q) * inverse;
    let r = s.cross(ab);
    let v = direction.dot(r) * inverse;
    (u >= -slack && v >= -slack && u + v <= 1.0 + slack)
        .then(|| (ac.dot(r) * inverse, u, v, determinant > 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn soup(seed: [f32; 3], n: usize) -> Mesh {
        // Small triangles scattered by irrational steps.
        let at = |k: usize| {
            Vec3::from([0.754_877, 0.569_84, 0.438_579].map(|s: f32| (k as f32 * s + seed[0]).fract())) * 10.0
        };
        let positions = (0..3 * n)
            .map(|k| at(k / 3) + (at(k * 7 + 1) - 5.0) * 0.1 * (1.0 + seed[1]))
            .collect();
        Mesh::new(
            positions,
            (0..n as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
            vec![],
        )
    }

    proptest! {
        #[test]
        fn the_tree_finds_what_a_search_of_all_finds(p in prop::array::uniform3(-5.0f32..15.0), q in prop::array::uniform3(-1.0f32..1.0), seed in prop::array::uniform3(0.0f32..1.0)) {
            let mesh = soup(seed, 90);
            let tree = TriangleBvh::new(&mesh);
            let p = Vec3::from(p);
            let all = (0..mesh.triangles.len()).map(|t| mesh.corners(t));
            let want = all.clone().map(|c| nearest_on_triangle(p, &c).distance(p)).fold(f32::INFINITY, f32::min);
            let got = tree.nearest(p, f32::INFINITY).map_or(f32::INFINITY, |n| n.squared.sqrt());
            prop_assert!((got - want).abs() <= 1e-5 * (1.0 + want));
            prop_assert!(tree.nearest(p, want * 0.99).is_none());
            let exact = all.clone().map(|c| solid_angle(p, &c)).sum::<f32>() / (4.0 * std::f32::consts::PI);
            prop_assert!((tree.winding(p) - exact).abs() < 0.02, "{} for {}", tree.winding(p), exact);
            let direction = (Vec3::from(q) + Vec3::splat(0.01)).normalize();
            let first = all.filter_map(|c| meet(p, direction, &c, SLACK)).map(|h| h.0).filter(|t| *t >= 0.0).fold(f32::INFINITY, f32::min);
            let hit = tree.ray(p, direction, 0.0, f32::INFINITY, |_| true).map_or(f32::INFINITY, |h| h.t);
            prop_assert!(hit == first || (hit - first).abs() < 1e-4);
        }

        /// The nearest point of a triangle is no farther away than any other of its points.
        #[test]
        fn nearest_points_are_nearest(v in prop::array::uniform9(-2.0f32..2.0), p in prop::array::uniform3(-3.0f32..3.0), w in prop::array::uniform2(0.0f32..1.0)) {
            let corner = |n: usize| Vec3::new(v[n], v[n + 1], v[n + 2]);
            let (c, p) = ([corner(0), corner(3), corner(6)], Vec3::from(p));
            let (a, b) = if w[0] + w[1] > 1.0 { (1.0 - w[0], 1.0 - w[1]) } else { (w[0], w[1]) };
            let other = c[0] + (c[1] - c[0]) * a + (c[2] - c[0]) * b;
            prop_assert!(nearest_on_triangle(p, &c).distance(p) <= other.distance(p) + 1e-4);
        }
    }
}
