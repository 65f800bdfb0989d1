//! Triangulation of polygons with any number of corners, convex or not, by ear clipping (Meisters
//! 1975) in the plane of the Newell normal.
//!
//! Convex polygons become fans, as in other programs. Corners on a straight edge stay corners of
//! triangles with an area, so that no gap opens towards the neighbouring face. Corners that occur
//! twice (the bridge to a hole) are allowed. A polygon that crosses itself in its plane has no
//! triangulation; it becomes triangles between its corners that may overlap.

use glam::{DVec2, DVec3, Vec3};

/// Maximum number of corners of a polygon that is not convex; the time grows with its square.
pub(super) const MAX_CORNERS: usize = 2000;

/// Appends the triangles of a polygon. Returns false if it has too many corners and was divided as
/// a fan.
pub(super) fn triangulate(positions: &[Vec3], corners: &[u32], triangles: &mut Vec<[u32; 3]>) -> bool {
    if corners.len() < 3 {
        return true;
    }
    let points = in_plane(positions, corners);
    let fan = points.as_deref().is_none_or(is_convex);
    match points {
        Some(points) if !fan && corners.len() <= MAX_CORNERS => clip_ears(&points, corners, triangles),
        _ => {
            for n in 1..corners.len() - 1 {
                triangles.push([corners[0], corners[n], corners[n + 1]]);
            }
        }
    }
    fan || corners.len() <= MAX_CORNERS
}

/// The corners in the plane of the polygon, counter-clockwise; none without a plane.
fn in_plane(positions: &[Vec3], corners: &[u32]) -> Option<Vec<DVec2>> {
    let at = |n: usize| positions[corners[n % corners.len()] as usize].as_dvec3();
    let origin = at(0);
    // Newell's normal (Sutherland et al. 1974): the sum over the edges, for any polygon.
    let normal: DVec3 = (0..corners.len())
        .map(|n| (at(n) - origin).cross(at(n + 1) - origin))
        .sum();
    let length = normal.length();
    if !length.is_finite() || length == 0.0 {
        return None;
    }
    let (u, v) = (normal / length).any_orthonormal_pair();
    let points = (0..corners.len()).map(|n| {
        let p = at(n) - origin;
        DVec2::new(p.dot(u), p.dot(v))
    });
    Some(points.collect())
}

/// Whether a polygon is strictly convex: it turns left at every corner, once around in total.
fn is_convex(points: &[DVec2]) -> bool {
    let n = points.len();
    let edge = |k: usize| points[(k + 1) % n] - points[k % n];
    let left = (0..n).all(|k| edge(k).perp_dot(edge(k + 1)) > 0.0);
    let turns = (0..n)
        .filter(|&k| edge(k).x < 0.0 && edge(k + 1).x >= 0.0)
        .count();
    n <= 3 || left && turns <= 1
}

/// How strictly an ear is chosen.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Strictness {
    /// With an area, and without other corners in it or on its edges.
    Clean,
    /// With an area, and without other corners inside.
    Touching,
    /// Any corner.
    Any,
}

/// Cuts triangles of three successive corners off until three are left.
fn clip_ears(points: &[DVec2], corners: &[u32], triangles: &mut Vec<[u32; 3]>) {
    let mut left: Vec<usize> = (0..corners.len()).collect();
    // Corners are tried in turn, so that the triangles do not all meet in one of them.
    let mut start = 0;
    while left.len() > 3 {
        let n = left.len();
        let blocking = blocking_corners(points, &left);
        let ear = |how: Strictness| {
            (0..n)
                .map(|k| (start + k) % n)
                .find(|&k| is_ear(points, &left, &blocking, k, how))
        };
        let at = ear(Strictness::Clean)
            .or_else(|| ear(Strictness::Touching))
            .or_else(|| ear(Strictness::Any))
            .unwrap_or(0);
        triangles.push([left[(at + n - 1) % n], left[at], left[(at + 1) % n]].map(|k| corners[k]));
        left.remove(at);
        start = at % left.len();
    }
    if let [a, b, c] = left[..] {
        triangles.push([a, b, c].map(|k| corners[k]));
    }
}

/// The corners at which the polygon does not turn left: only they can lie in an ear.
fn blocking_corners(points: &[DVec2], left: &[usize]) -> Vec<usize> {
    let n = left.len();
    (0..n)
        .filter(|&k| {
            let [a, b, c] = [left[(k + n - 1) % n], left[k], left[(k + 1) % n]].map(|k| points[k]);
            (b - a).perp_dot(c - b) <= 0.0
        })
        .map(|k| left[k])
        .collect()
}

fn is_ear(points: &[DVec2], left: &[usize], blocking: &[usize], at: usize, how: Strictness) -> bool {
    if how == Strictness::Any {
        return true;
    }
    let n = left.len();
    let triangle = [left[(at + n - 1) % n], left[at], left[(at + 1) % n]];
    let [a, b, c] = triangle.map(|k| points[k]);
    let sides = |p: DVec2| {
        [
            (b - a).perp_dot(p - a),
            (c - b).perp_dot(p - b),
            (a - c).perp_dot(p - c),
        ]
    };
    (b - a).perp_dot(c - a) > 0.0
        && !blocking.iter().filter(|k| !triangle.contains(k)).any(|&k| {
            let p = points[k];
            // A corner that occurs twice does not block itself.
            p != a
                && p != b
                && p != c
                && match how {
                    Strictness::Clean => sides(p).iter().all(|s| *s >= 0.0),
                    _ => sides(p).iter().all(|s| *s > 0.0),
                }
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Triangles of a polygon in the plane z = 0, and their areas (negative: clockwise).
    fn areas(points: &[[f32; 2]]) -> Vec<f32> {
        let positions: Vec<Vec3> = points.iter().map(|p| Vec3::new(p[0], p[1], 0.0)).collect();
        let corners: Vec<u32> = (0..positions.len() as u32).collect();
        let mut triangles = Vec::new();
        assert!(triangulate(&positions, &corners, &mut triangles));
        assert_eq!(triangles.len(), points.len() - 2);
        triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|k| positions[k as usize]);
                (b - a).cross(c - a).z / 2.0
            })
            .collect()
    }

    #[test]
    fn concave_polygons_are_covered_once() {
        let l = [
            [0.0, 0.0],
            [3.0, 0.0],
            [3.0, 1.0],
            [1.0, 1.0],
            [1.0, 3.0],
            [0.0, 3.0],
        ];
        for turn in 0..6 {
            let mut turned = l;
            turned.rotate_left(turn);
            let areas = areas(&turned);
            assert!(areas.iter().all(|a| *a > 0.0), "{areas:?}");
            assert!((areas.iter().sum::<f32>() - 5.0).abs() < 1e-5);
        }
        // A comb of 21 teeth.
        let mut comb = vec![[0.0, -1.0], [42.0, -1.0]];
        comb.extend(
            (0..=42)
                .rev()
                .map(|n| [n as f32, if n % 2 == 0 { 0.0 } else { 5.0 }]),
        );
        let sum: f32 = areas(&comb).iter().map(|a| a.abs()).sum();
        assert!((sum - (42.0 + 105.0)).abs() < 1e-3, "{sum}");
    }

    #[test]
    fn corners_on_edges_stay_corners_of_triangles_with_an_area() {
        let square = [
            [0.0, 0.0],
            [1.0, 0.0],
            [2.0, 0.0],
            [2.0, 1.0],
            [2.0, 2.0],
            [1.0, 2.0],
            [0.0, 2.0],
            [0.0, 1.0],
        ];
        let areas = areas(&square);
        assert!(areas.iter().all(|a| *a > 0.0), "{areas:?}");
        assert!((areas.iter().sum::<f32>() - 4.0).abs() < 1e-6);
    }

    #[test]
    fn a_hole_by_a_bridge_stays_open() {
        let ring = [
            [0.0, 0.0],
            [4.0, 0.0],
            [4.0, 4.0],
            [0.0, 4.0],
            [0.0, 0.0],
            [1.0, 1.0],
            [1.0, 3.0],
            [3.0, 3.0],
            [3.0, 1.0],
            [1.0, 1.0],
        ];
        let areas = areas(&ring);
        assert!(areas.iter().all(|a| *a >= 0.0), "{areas:?}");
        assert!((areas.iter().sum::<f32>() - 12.0).abs() < 1e-5, "{areas:?}");
    }

    #[test]
    fn odd_polygons_end() {
        for points in [
            vec![[0.0, 0.0]; 7],
            vec![[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]],
            vec![[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]],
            vec![[f32::NAN, 0.0], [1.0, 0.0], [2.0, 5.0], [3.0, 0.0]],
        ] {
            areas(&points);
        }
    }
}
