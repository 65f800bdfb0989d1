//! The sweeps that carry closest points from the surface to the rest of a field.

use glam::{Mat3, Vec3};

/// Propagates nearest points to neighbours in the eight orders of three axes.
pub(super) fn sweep(
    distance: &mut [f32],
    nearest: &mut [Vec3],
    size: [usize; 3],
    origin: Vec3,
    world_from_index: Mat3,
) {
    let [nx, ny, nz] = size;
    let (dj, dk) = (nx as isize, (nx * ny) as isize);
    for order in 0..8 {
        let (fi, fj, fk) = (order & 1 == 0, order & 2 == 0, order & 4 == 0);
        let neighbours = [
            if fi { -1 } else { 1 },
            if fj { -dj } else { dj },
            if fk { -dk } else { dk },
        ];
        for k in 0..nz {
            let k = if fk { k } else { nz - 1 - k };
            for j in 0..ny {
                let j = if fj { j } else { ny - 1 - j };
                let has = [
                    false,
                    if fj { j > 0 } else { j + 1 < ny },
                    if fk { k > 0 } else { k + 1 < nz },
                ];
                for i in 0..nx {
                    let i = if fi { i } else { nx - 1 - i };
                    let has = [if fi { i > 0 } else { i + 1 < nx }, has[1], has[2]];
                    let n = (k * ny + j) * nx + i;
                    let here = origin + world_from_index * Vec3::new(i as f32, j as f32, k as f32);
                    for (step, has) in neighbours.into_iter().zip(has) {
                        if !has {
                            continue;
                        }
                        let m = (n as isize + step) as usize;
                        // A neighbour that is no nearer to the surface than this point has nothing
                        // better to offer.
                        if distance[m] < distance[n] {
                            let d = here.distance(nearest[m]);
                            if d < distance[n] {
                                distance[n] = d;
                                nearest[n] = nearest[m];
                            }
                        }
                    }
                }
            }
        }
    }
}
