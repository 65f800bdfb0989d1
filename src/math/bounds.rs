//! Axis-aligned boxes.

use super::lanes::*;
use glam::{Affine3A, Vec3, Vec3A};

/// An axis-aligned box; empty where a minimum exceeds a maximum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lower corner.
    pub min: Vec3,
    /// Upper corner.
    pub max: Vec3,
}

impl Bounds {
    /// The empty box.
    pub const EMPTY: Self = Self {
        min: Vec3::INFINITY,
        max: Vec3::NEG_INFINITY,
    };
    /// The unit cube, map space's domain.
    pub const UNIT: Self = Self {
        min: Vec3::ZERO,
        max: Vec3::ONE,
    };

    /// The box between two corners.
    pub fn new(min: Vec3, max: Vec3) -> Self {
        Self { min, max }
    }

    /// Whether nothing is inside.
    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    /// The eight corners.
    pub fn corners(&self) -> [Vec3; 8] {
        std::array::from_fn(|i| {
            Vec3::new(
                if i & 1 == 0 { self.min.x } else { self.max.x },
                if i & 2 == 0 { self.min.y } else { self.max.y },
                if i & 4 == 0 { self.min.z } else { self.max.z },
            )
        })
    }

    /// Edge lengths.
    pub fn size(&self) -> Vec3 {
        self.max - self.min
    }

    /// The middle.
    pub fn center(&self) -> Vec3 {
        (self.min + self.max) * 0.5
    }

    /// The smallest box around both.
    pub fn union(&self, other: &Self) -> Self {
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    /// The overlap of both (possibly empty).
    pub fn intersection(&self, other: &Self) -> Self {
        Self {
            min: self.min.max(other.min),
            max: self.max.min(other.max),
        }
    }

    /// Grown by `margin` on every side.
    pub fn grown(&self, margin: f32) -> Self {
        Self {
            min: self.min - margin,
            max: self.max + margin,
        }
    }

    /// Whether `other` lies entirely inside.
    pub fn contains(&self, other: &Self) -> bool {
        self.min.cmple(other.min).all() && self.max.cmpge(other.max).all()
    }

    /// The box around the image of this box under an affine transform (Arvo 1990: centre and
    /// absolute extents).
    pub fn transformed(&self, transform: &Affine3A) -> Self {
        let center = transform.transform_point3a(Vec3A::from(self.center()));
        let half = Vec3A::from(self.size() * 0.5);
        let m = transform.matrix3;
        let extent = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
        Self {
            min: (center - extent).into(),
            max: (center + extent).into(),
        }
    }

    /// The parameters at which `origin + t * direction` enters and leaves the box, if it meets it.
    ///
    /// `direction` may have zero components.
    #[inline(always)]
    pub fn intersect_ray(&self, origin: Vec3, direction: Vec3) -> Option<(f32, f32)> {
        if self.is_empty() {
            return None;
        }
        let inverse = direction.recip();
        let a = (self.min - origin) * inverse;
        let b = (self.max - origin) * inverse;
        // 0 * inf is NaN for a ray in a face's plane; min and max drop it, and such a ray misses or
        // grazes.
        let (mut near, mut far) = (f32::NEG_INFINITY, f32::INFINITY);
        for axis in 0..3 {
            near = near.max(a[axis].min(b[axis]));
            far = far.min(a[axis].max(b[axis]));
        }
        (near <= far).then_some((near, far))
    }

    /// Where eight rays `origin + t d` enter and leave the box, from 1/d. A ray misses if it leaves
    /// before it enters; every ray misses an empty box.
    #[inline(always)]
    pub fn intersect_rays<S: Simd>(
        &self,
        simd: S,
        origin: Vec3x8<S>,
        inverse: Vec3x8<S>,
    ) -> (f32x8<S>, f32x8<S>) {
        let (least, most) = (
            f32x8::splat(simd, f32::NEG_INFINITY),
            f32x8::splat(simd, f32::INFINITY),
        );
        if self.is_empty() {
            return (most, least);
        }
        let (near_x, far_x) = between(simd, [self.min.x, self.max.x], origin.x, inverse.x);
        let (near_y, far_y) = between(simd, [self.min.y, self.max.y], origin.y, inverse.y);
        let (near_z, far_z) = between(simd, [self.min.z, self.max.z], origin.z, inverse.z);
        let near = least.max_precise(near_x).max_precise(near_y).max_precise(near_z);
        (
            near,
            most.min_precise(far_x).min_precise(far_y).min_precise(far_z),
        )
    }
}

/// Where rays enter and leave the slab between two coordinates along an axis.
#[inline(always)]
fn between<S: Simd>(
    simd: S,
    [low, high]: [f32; 2],
    origin: f32x8<S>,
    inverse: f32x8<S>,
) -> (f32x8<S>, f32x8<S>) {
    let (a, b) = (
        (f32x8::splat(simd, low) - origin) * inverse,
        (f32x8::splat(simd, high) - origin) * inverse,
    );
    // Minima and maxima that drop NaN.
    (a.min_precise(b), a.max_precise(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ray_meets_box_where_it_should() {
        let unit = Bounds::UNIT;
        assert_eq!(
            unit.intersect_ray(Vec3::new(-1.0, 0.5, 0.5), Vec3::X),
            Some((1.0, 2.0))
        );
        assert_eq!(unit.intersect_ray(Vec3::new(-1.0, 1.5, 0.5), Vec3::X), None);
        // A scene that shows nothing made a ray loop forever.
        assert_eq!(Bounds::EMPTY.intersect_ray(Vec3::ZERO, Vec3::X), None);
    }

    #[test]
    fn transformed_box_holds_the_transformed_corners() {
        let t = Affine3A::from_rotation_z(0.7) * Affine3A::from_scale(Vec3::new(1.0, -2.0, 3.0));
        let b = Bounds::UNIT.transformed(&t).grown(1e-5);
        for c in Bounds::UNIT.corners() {
            let p = t.transform_point3(c);
            assert!(b.contains(&Bounds::new(p, p)));
        }
    }
}
