//! Restores signed distances: combined, advected or stretched distances keep their sign but are not
//! distances.
//!
//! Points next to a sign change take their distance from its position on the grid's edges. From
//! there the eikonal equation |∇u| = 1 is solved outwards by sweeps along the eight diagonals (Zhao
//! 2005, "A fast sweeping method for Eikonal equations"), in the box that they can reach.

/// Replaces values at the points of a grid (x fastest) by signed distances to their sign change, in
/// the unit of `spacing` and limited to `far`. Zero counts as positive; where no sign change is
/// within reach the values become ±`far`.
pub fn redistance(values: &mut [f32], size: [usize; 3], spacing: [f32; 3], far: f32) {
    assert!(
        values.len() == size.iter().product::<usize>(),
        "value count and size disagree"
    );
    let stride = [1, size[0], size[0] * size[1]];
    let mut distance = vec![far; values.len()];
    let mut near_surface = vec![false; values.len()];
    let (mut low, mut high) = (size, [0; 3]);
    for k in 0..size[2] {
        for j in 0..size[1] {
            for i in 0..size[0] {
                let at = [i, j, k];
                let n = i + j * stride[1] + k * stride[2];
                let mut steepness = 0.0;
                for a in 0..3 {
                    let before = if at[a] > 0 {
                        crossing(values[n], values[n - stride[a]])
                    } else {
                        f32::INFINITY
                    };
                    let after = if at[a] + 1 < size[a] {
                        crossing(values[n], values[n + stride[a]])
                    } else {
                        f32::INFINITY
                    };
                    steepness += (spacing[a] * before.min(after)).powi(-2);
                }
                if steepness > 0.0 {
                    // The distance to the plane through the crossings.
                    distance[n] = steepness.sqrt().recip().min(far);
                    near_surface[n] = true;
                    low = std::array::from_fn(|a| low[a].min(at[a]));
                    high = std::array::from_fn(|a| high[a].max(at[a]));
                }
            }
        }
    }
    if low[0] <= high[0] {
        let reach = spacing.map(|s| (far / s).ceil() as usize + 1);
        let first: [usize; 3] = std::array::from_fn(|a| low[a].saturating_sub(reach[a]));
        let count: [usize; 3] = std::array::from_fn(|a| (high[a] + reach[a] + 1).min(size[a]) - first[a]);
        for diagonal in 0..8usize {
            let along = |a: usize, step: usize| {
                first[a]
                    + if (diagonal >> a) & 1 == 0 {
                        step
                    } else {
                        count[a] - 1 - step
                    }
            };
            for k in 0..count[2] {
                for j in 0..count[1] {
                    for i in 0..count[0] {
                        let at = [along(0, i), along(1, j), along(2, k)];
                        let n = at[0] + at[1] * stride[1] + at[2] * stride[2];
                        if near_surface[n] {
                            continue;
                        }
                        let nearer: [f32; 3] = std::array::from_fn(|a| {
                            let before = if at[a] > 0 { distance[n - stride[a]] } else { far };
                            let after = if at[a] + 1 < size[a] {
                                distance[n + stride[a]]
                            } else {
                                far
                            };
                            before.min(after)
                        });
                        if nearer.iter().any(|u| *u < distance[n]) {
                            distance[n] = distance[n].min(solved(nearer, spacing));
                        }
                    }
                }
            }
        }
    }
    for (value, d) in values.iter_mut().zip(&distance) {
        *value = if *value < 0.0 { -d } else { *d };
    }
}

/// Position of the sign change on the edge to a neighbour, as a fraction of the edge; infinite if
/// there is none.
fn crossing(own: f32, other: f32) -> f32 {
    if (own < 0.0) == (other < 0.0) {
        f32::INFINITY
    } else {
        own.abs() / (own.abs() + other.abs())
    }
}

/// u with |∇u| = 1 from the lower neighbour along each axis, by Godunov's upwind scheme: the sum of
/// ((u - value) / h)², over the axes on which u is above the neighbour's value, is 1.
fn solved(nearer: [f32; 3], spacing: [f32; 3]) -> f32 {
    let mut sides: [(f32, f32); 3] = std::array::from_fn(|a| (nearer[a], spacing[a]));
    sides.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Relative to the lowest, so that squares keep their precision.
    let base = sides[0].0;
    let (mut a, mut b, mut c) = (0.0, 0.0, -1.0);
    let mut u = f32::INFINITY;
    for (value, h) in sides {
        let value = value - base;
        if value >= u {
            break;
        }
        let w = 1.0 / (h * h);
        a += w;
        b += value * w;
        c += value * value * w;
        u = (b + (b * b - a * c).max(0.0).sqrt()) / a;
    }
    base + u
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    const SIZE: [usize; 3] = [26, 20, 28];
    const SPACING: [f32; 3] = [1.0, 1.3, 0.9];
    const FAR: f32 = 5.0;

    /// Values of a function at the grid's points, and the points.
    fn sampled(f: impl Fn(Vec3) -> f32) -> Vec<(Vec3, f32)> {
        (0..SIZE.iter().product::<usize>())
            .map(|n| {
                let at = [n % SIZE[0], n / SIZE[0] % SIZE[1], n / (SIZE[0] * SIZE[1])];
                let p = Vec3::from(at.map(|i| i as f32)) * Vec3::from(SPACING);
                (p, f(p))
            })
            .collect()
    }

    fn renewed(f: impl Fn(Vec3) -> f32) -> Vec<(Vec3, f32)> {
        let points = sampled(f);
        let mut values: Vec<f32> = points.iter().map(|p| p.1).collect();
        redistance(&mut values, SIZE, SPACING, FAR);
        points.into_iter().map(|p| p.0).zip(values).collect()
    }

    #[test]
    fn a_stretched_sphere_is_a_distance_again() {
        let distance = |p: Vec3| p.distance(Vec3::new(12.2, 12.1, 12.4)) - 6.0;
        for (p, v) in renewed(|p| distance(p) * (2.0 + (0.3 * p.x).sin())) {
            let want = distance(p).clamp(-FAR, FAR);
            assert!(v == 0.0 || (v < 0.0) == (want < 0.0), "{v} for {want} at {p}");
            // A first-order scheme errs by h ln(ρ/R) at ρ from the centre of a sphere of radius R:
            // 0.7 within reach, plus a little at the start.
            assert!((v - want).abs() < 0.8, "{v} for {want} at {p}");
        }
    }

    #[test]
    fn a_plane_is_exact() {
        for (p, v) in renewed(|p| 3.0 * (p.y - 9.7)) {
            assert!((v - (p.y - 9.7).clamp(-FAR, FAR)).abs() < 1e-3, "{v} at {p}");
        }
    }

    #[test]
    fn what_only_touches_zero_has_no_surface() {
        assert!(renewed(|p| (p.x - 12.0).abs()).iter().all(|(_, v)| *v == FAR));
        assert!(renewed(|_| -1.0).iter().all(|(_, v)| *v == -FAR));
    }
}
