//! Meshes of shapes with closed forms, for comparison in tests and benchmarks.

use super::Mesh;
use glam::Vec3;
use std::f32::consts::{PI, TAU};

/// A sphere of latitude rings, with its vertices on the sphere.
pub fn sphere(radius: f32, rings: usize) -> Mesh {
    surface(2 * rings, rings, |u, v| {
        let (theta, phi) = (v * PI, u * TAU);
        Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()) * radius
    })
}

/// A torus about z.
pub fn torus(ring: f32, tube: f32, n: usize) -> Mesh {
    surface(2 * n, n, |u, v| {
        let (phi, theta) = (u * TAU, -v * TAU);
        let r = ring + tube * theta.cos();
        Vec3::new(r * phi.cos(), r * phi.sin(), tube * theta.sin())
    })
}

/// A box about the origin.
pub fn cuboid(half: Vec3) -> Mesh {
    let corner = |n: u32| {
        Vec3::new(
            if n & 1 == 0 { -half.x } else { half.x },
            if n & 2 == 0 { -half.y } else { half.y },
            if n & 4 == 0 { -half.z } else { half.z },
        )
    };
    let quads = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let triangles = quads
        .iter()
        .flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]])
        .collect();
    Mesh::new((0..8).map(corner).collect(), triangles, vec![])
}

/// A grid of n x m quads over u, v in 0..1; welding closes it.
fn surface(n: usize, m: usize, at: impl Fn(f32, f32) -> Vec3) -> Mesh {
    let positions = (0..=m)
        .flat_map(|j| (0..=n).map(move |i| (i, j)))
        .map(|(i, j)| at((i % n) as f32 / n as f32, j as f32 / m as f32))
        .collect();
    let index = |i: usize, j: usize| (j * (n + 1) + i) as u32;
    let quads = (0..m).flat_map(|j| (0..n).map(move |i| (i, j)));
    let triangles = quads
        .flat_map(|(i, j)| {
            let (a, b, c, d) = (index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1));
            [[a, d, c], [a, c, b]]
        })
        .collect();
    Mesh::new(positions, triangles, vec![])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_closed_and_face_outwards() {
        let volume = |r: f32| f64::from(4.0 / 3.0 * PI * r.powi(3));
        for (mesh, volume) in [
            (sphere(10.0, 64), volume(10.0)),
            (torus(10.0, 3.0, 64), f64::from(2.0 * PI * PI * 10.0 * 9.0)),
            (cuboid(Vec3::new(1.0, 2.0, 3.0)), 48.0),
        ] {
            let t = mesh.topology();
            assert!(
                t.watertight && t.orientation() == "outward" && t.components == 1,
                "{t:?}"
            );
            assert!(
                (t.volume / volume - 1.0).abs() < 5e-3,
                "{} for {volume}",
                t.volume
            );
        }
    }
}
