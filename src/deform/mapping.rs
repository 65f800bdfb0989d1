//! Cylindrical coordinate mapping (\[DS07\] section 3.2): a map is wrapped around the z axis of its box.
//!
//! *Theory* ([`crate::model`], "Displacement maps"): with x' = M⁻¹ p', the point is looked up at
//! u = C(x') = (fract(θ / 2π), height, r / ρ) and comes from C⁻¹(u + D(u)). θ = atan2(x, y) about the
//! axis through the centre of the box, circles are round in millimetres even in an oblong box, and ρ
//! is half the shorter of the box's extents along x and y. A displacement along the map's x turns
//! about the axis, one along y moves along it, one along z moves away from it; a flat slab becomes a
//! shell, a straight incision a round one.
//!
//! *Difference from the paper*: it converts coordinates in the shader alone. Here the mapping is part
//! of the placement, evaluated at every sample by every renderer, with its Jacobian and with bounds
//! for empty space.

use super::{DisplacementMap, MapFilter, Placement};
use crate::math::Bounds;
use glam::{Mat3, Vec2, Vec3, Vec3Swizzles, Vec4Swizzles};
use std::f32::consts::TAU;

/// A cylinder in the box of a placement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    /// Edge lengths of the box, mm.
    pub box_mm: Vec3,
    /// ρ, mm.
    pub radius_mm: f32,
    /// The smallest radius at which a derivative is taken, mm: half a texel.
    pub min_radius_mm: f32,
    /// From millimetres along the axes of the box to world millimetres, and back.
    pub world_from_local: Mat3,
    /// The inverse.
    pub local_from_world: Mat3,
}

/// A point of the box in polar coordinates.
#[derive(Clone, Copy)]
struct Polar {
    /// From the axis, mm.
    radius_mm: f32,
    /// Unit vector away from the axis, (sin θ, cos θ).
    away: Vec2,
    /// Map coordinates.
    u: Vec3,
}

impl Cylinder {
    /// The cylinder in a box for a map with some texels from the axis outwards.
    pub fn new(placement: &Placement, texels: usize) -> Self {
        let box_mm = placement.size_mm();
        let radius_mm = 0.5 * box_mm.x.min(box_mm.y);
        Self {
            box_mm,
            radius_mm,
            min_radius_mm: 0.5 * radius_mm / (texels.max(2) - 1) as f32,
            world_from_local: Mat3::from(placement.world_from_map.matrix3)
                * Mat3::from_diagonal(box_mm.recip()),
            local_from_world: Mat3::from_diagonal(box_mm) * Mat3::from(placement.map_from_world.matrix3),
        }
    }

    /// Millimetres from the centre of the box, along its axes, from the unit cube.
    fn local(&self, x: Vec3) -> Vec3 {
        (x - 0.5) * self.box_mm
    }

    fn polar(&self, x: Vec3) -> Polar {
        let q = self.local(x);
        let radius_mm = q.xy().length();
        let away = if radius_mm > 0.0 {
            q.xy() / radius_mm
        } else {
            Vec2::Y
        };
        Polar {
            radius_mm,
            away,
            u: Vec3::new(turn_of(away), x.z, radius_mm / self.radius_mm),
        }
    }

    /// Map coordinates of a point of the unit cube.
    pub fn map_from_cube(&self, x: Vec3) -> Vec3 {
        self.polar(x).u
    }

    /// The point of the unit cube at map coordinates.
    pub fn cube_from_map(&self, u: Vec3) -> Vec3 {
        let (sin, cos) = (u.x * TAU).sin_cos();
        let across = Vec2::new(sin, cos) * (u.z.max(0.0) * self.radius_mm);
        0.5 + across.extend((u.y - 0.5) * self.box_mm.z) / self.box_mm
    }

    /// Whether map coordinates lie in the map.
    pub fn holds(u: Vec3) -> bool {
        (0.0..=1.0).contains(&u.y) && u.z <= 1.0
    }

    /// Displacement along the axes of the box, mm, of a point that the map displaces by D.
    fn moved(&self, polar: &Polar, d: Vec3) -> Vec3 {
        if d == Vec3::ZERO {
            // Free of the rounding of the conversion.
            return Vec3::ZERO;
        }
        let (sin, cos) = (d.x * TAU).sin_cos();
        let turned = turned(polar.away, sin, cos);
        let radius_mm = (polar.radius_mm + d.z * self.radius_mm).max(0.0);
        let across = turned * radius_mm - polar.away * polar.radius_mm;
        across.extend(d.y * self.box_mm.z)
    }

    /// Displacement along the axes of the box, mm, of the point at map coordinates that is displaced
    /// by D.
    pub fn displaced(&self, u: Vec3, d: Vec3) -> Vec3 {
        let (sin, cos) = (u.x * TAU).sin_cos();
        let polar = Polar {
            radius_mm: u.z * self.radius_mm,
            away: Vec2::new(sin, cos),
            u,
        };
        self.moved(&polar, d)
    }

    /// Displacement along the axes of the box, mm, and mask at a point of the unit cube; none
    /// outside the cylinder.
    pub fn displacement(&self, map: &DisplacementMap, filter: &MapFilter, x: Vec3) -> Option<(Vec3, f32)> {
        let polar = self.polar(x);
        Self::holds(polar.u).then(|| {
            let t = filter.fetch(map, polar.u);
            (self.moved(&polar, t.xyz() * map.scale), t.w)
        })
    }

    /// d source / d deformed and the mask's gradient, both along the axes of the box and per mm; none
    /// outside the cylinder.
    pub fn derivatives(&self, map: &DisplacementMap, filter: &MapFilter, x: Vec3) -> Option<(Mat3, Vec3)> {
        let polar = self.polar(x);
        if !Self::holds(polar.u) {
            return None;
        }
        let d = filter.fetch(map, polar.u).xyz() * map.scale;
        let (j, slope) = filter.wrapped_derivatives(map, polar.u);
        // Rows of J_C, columns of the Jacobian of C⁻¹.
        let per_turn = (TAU * polar.radius_mm.max(self.min_radius_mm)).recip();
        let d_map_d_local = Mat3::from_cols(
            along(polar.away).extend(0.0) * per_turn,
            Vec3::Z / self.box_mm.z,
            polar.away.extend(0.0) / self.radius_mm,
        )
        .transpose();
        let (sin, cos) = (d.x * TAU).sin_cos();
        let turned = turned(polar.away, sin, cos);
        // The same clamp: a map that moves nothing has the identity.
        let radius_mm = (polar.radius_mm.max(self.min_radius_mm) + d.z * self.radius_mm).max(0.0);
        let d_local_d_map = Mat3::from_cols(
            along(turned).extend(0.0) * (TAU * radius_mm),
            Vec3::Z * self.box_mm.z,
            turned.extend(0.0) * self.radius_mm,
        );
        Some((
            d_local_d_map * (Mat3::IDENTITY + j) * d_map_d_local,
            d_map_d_local.transpose() * slope,
        ))
    }

    /// A box in map coordinates around a box of the unit cube, grown by `texels` texels of a map of
    /// some size; none if it lies outside the cylinder.
    pub fn range(&self, b: &Bounds, size: [usize; 3], texels: f32) -> Option<CylinderRange> {
        let [low, high] = [self.local(b.min), self.local(b.max)];
        let nearest = Vec2::ZERO.clamp(low.xy(), high.xy());
        let farthest = low.xy().abs().max(high.xy().abs());
        let texel = texels / Vec3::from(size.map(|n| (n.max(2) - 1) as f32));
        let radius_mm = [
            (nearest.length() - texel.z * self.radius_mm).max(0.0),
            farthest.length() + texel.z * self.radius_mm,
        ];
        // All turns if the box holds the axis or reaches the half plane θ = 0.
        let holds_seam = low.x <= 0.0 && high.x >= 0.0 && high.y >= 0.0;
        let mut turn = [0.0, 1.0];
        if !holds_seam {
            let corners = [
                low.xy(),
                high.xy(),
                Vec2::new(low.x, high.y),
                Vec2::new(high.x, low.y),
            ];
            let turns = corners.map(turn_of);
            turn = [
                turns.iter().copied().fold(f32::INFINITY, f32::min) - texel.x,
                turns.iter().copied().fold(f32::NEG_INFINITY, f32::max) + texel.x,
            ];
            if turn[0] < 0.0 || turn[1] > 1.0 {
                turn = [0.0, 1.0];
            }
        }
        let height = [b.min.z - texel.y, b.max.z + texel.y];
        let low = Vec3::new(turn[0], height[0].max(0.0), radius_mm[0] / self.radius_mm);
        let high = Vec3::new(
            turn[1],
            height[1].min(1.0),
            (radius_mm[1] / self.radius_mm).min(1.0),
        );
        if low.cmpgt(high).any() {
            return None;
        }
        Some(CylinderRange {
            in_map: Bounds::new(low, high),
            outside: height[0] < 0.0 || height[1] > 1.0 || radius_mm[1] > self.radius_mm,
        })
    }

    /// A box around the displacements along the axes of the box, mm, of points in a range whose
    /// D lies between two bounds.
    pub fn displacement_box(&self, range: &CylinderRange, low: Vec3, high: Vec3) -> Bounds {
        let (u, tau) = (&range.in_map, TAU);
        let radius = [u.min.z * self.radius_mm, u.max.z * self.radius_mm];
        // e(θ + Δ) r' - e(θ) r = e(θ + Δ) (r' - r) + r (e(θ + Δ) - e(θ)), and the last difference is
        // 2 sin(Δ / 2) along the circle at θ + Δ / 2.
        let outward = vectors(
            [(low.z * self.radius_mm).max(-radius[1]), high.z * self.radius_mm],
            [(u.min.x + low.x) * tau, (u.max.x + high.x) * tau],
        );
        let half = [low.x * 0.5 * tau, high.x * 0.5 * tau];
        // sin φ = cos(φ - π/2).
        let quarter = 0.25 * tau;
        let reach = cosine_range([half[0] - quarter, half[1] - quarter]).map(|sine| 2.0 * sine);
        let lengths = [
            (reach[0] * radius[0]).min(reach[0] * radius[1]),
            (reach[1] * radius[0]).max(reach[1] * radius[1]),
        ];
        // Along the circle: a quarter turn after the direction away.
        let around = vectors(
            lengths,
            [
                u.min.x * tau + half[0] + quarter,
                u.max.x * tau + half[1] + quarter,
            ],
        );
        Bounds::new(
            (outward[0] + around[0]).extend(low.y * self.box_mm.z),
            (outward[1] + around[1]).extend(high.y * self.box_mm.z),
        )
    }

    /// A bound on |d source / d deformed| along the axes of the box, for points in a range: from
    /// bounds on D and on the columns of its Jacobian.
    pub fn slope_bound(
        &self,
        range: &CylinderRange,
        low: Vec3,
        high: Vec3,
        columns: [(Vec3, Vec3); 3],
    ) -> f32 {
        let radius =
            [range.in_map.min.z, range.in_map.max.z].map(|z| (z * self.radius_mm).max(self.min_radius_mm));
        let moved = [
            radius[0] + low.z * self.radius_mm,
            radius[1] + high.z * self.radius_mm,
        ];
        // Lengths per map unit, at the source at most and at the deformed point at least.
        let source = Vec3::new(TAU * moved[1].max(0.0), self.box_mm.z, self.radius_mm);
        let deformed = Vec3::new(TAU * radius[0], self.box_mm.z, self.radius_mm);
        let stretched = (radius[0] + high.z * self.radius_mm) / radius[0];
        let own = stretched.max(moved[1].max(0.0) / radius[1]).max(1.0);
        let squares: f32 = (0..3)
            .map(|axis| {
                let (low, high) = columns[axis];
                (low.abs().max(high.abs()) * source / deformed[axis]).length_squared()
            })
            .sum();
        own + squares.sqrt()
    }
}

/// A box in a cylinder's map coordinates.
#[derive(Clone, Copy, Debug)]
pub struct CylinderRange {
    /// Turn, height and radius, in 0..1.
    pub in_map: Bounds,
    /// Whether some points lie outside the cylinder.
    pub outside: bool,
}

/// θ / 2π in 0..1, from a vector away from the axis.
fn turn_of(away: Vec2) -> f32 {
    let turn = away.x.atan2(away.y) / TAU;
    if turn < 0.0 {
        (turn + 1.0).min(1.0 - f32::EPSILON)
    } else {
        turn
    }
}

/// The direction in which θ grows.
fn along(away: Vec2) -> Vec2 {
    Vec2::new(away.y, -away.x)
}

/// A direction turned further by an angle.
fn turned(away: Vec2, sin: f32, cos: f32) -> Vec2 {
    Vec2::new(away.x * cos + away.y * sin, away.y * cos - away.x * sin)
}

/// The least and the greatest cosine of a range of angles: those of its ends, and ±1 where a
/// multiple of π lies between.
fn cosine_range([from, to]: [f32; 2]) -> [f32; 2] {
    let (mut least, mut most) = (from.cos().min(to.cos()), from.cos().max(to.cos()));
    if (to / TAU).floor() > (from / TAU).floor() || to - from >= TAU {
        most = 1.0;
    }
    if ((to - 0.5 * TAU) / TAU).floor() > ((from - 0.5 * TAU) / TAU).floor() || to - from >= TAU {
        least = -1.0;
    }
    [least, most]
}

/// A box around the vectors a (sin φ, cos φ) for lengths a and angles φ in ranges.
fn vectors(lengths: [f32; 2], angles: [f32; 2]) -> [Vec2; 2] {
    // sin φ = cos(φ - π/2).
    let [x, y] = [
        cosine_range(angles.map(|angle| angle - 0.25 * TAU)),
        cosine_range(angles),
    ];
    let product = |r: [f32; 2]| {
        let all = [
            lengths[0] * r[0],
            lengths[0] * r[1],
            lengths[1] * r[0],
            lengths[1] * r[1],
        ];
        [
            all.iter().copied().fold(f32::INFINITY, f32::min),
            all.iter().copied().fold(f32::NEG_INFINITY, f32::max),
        ]
    };
    let (x, y) = (product(x), product(y));
    [Vec2::new(x[0], y[0]), Vec2::new(x[1], y[1])]
}
