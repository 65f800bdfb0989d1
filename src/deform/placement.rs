//! The position of a map's unit cube in the world: an affine transform, usually from a centre, a
//! size and a rotation.

use crate::{Error, Result};
use glam::{Affine3A, EulerRot, Mat3, Quat, Vec3};

/// `world_from_map`: a map's unit cube to millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Unit cube to world, mm.
    pub world_from_map: Affine3A,
    /// Its inverse.
    pub map_from_world: Affine3A,
}

impl Placement {
    /// A cube of `size_mm` around `center_mm`, turned by `rotate_deg` about x, then y, then z
    /// (world axes through the centre).
    ///
    /// # Errors
    /// A size that is not positive, values that are not finite.
    pub fn new(center_mm: Vec3, size_mm: Vec3, rotate_deg: Vec3) -> Result<Self> {
        if !(size_mm.is_finite() && size_mm.cmpgt(Vec3::splat(1e-3)).all()) {
            return Err(Error::value(
                "size",
                format!("{size_mm} mm is a singular placement; every length must be positive"),
            ));
        }
        if !(center_mm.is_finite() && rotate_deg.is_finite()) {
            return Err(Error::value("center, rotate", "must be finite"));
        }
        let r = rotate_deg * std::f32::consts::PI / 180.0;
        let rotation = Mat3::from_quat(Quat::from_euler(EulerRot::ZYX, r.z, r.y, r.x));
        let linear = rotation * Mat3::from_diagonal(size_mm);
        Self::from_affine(Affine3A::from_mat3_translation(
            linear,
            center_mm - linear * Vec3::splat(0.5),
        ))
    }

    /// Any affine placement, shears and mirrors included.
    ///
    /// # Errors
    /// A singular or non-finite transform.
    pub fn from_affine(world_from_map: Affine3A) -> Result<Self> {
        let m = Mat3::from(world_from_map.matrix3);
        let volume = m.determinant();
        let lengths = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
        if !(world_from_map.is_finite() && volume.abs() > 1e-6 * lengths && volume.abs() > 1e-9) {
            return Err(Error::value(
                "matrix",
                "is a singular placement; its three axes must span a volume",
            ));
        }
        let map_from_world = world_from_map.inverse();
        if !map_from_world.is_finite() {
            return Err(Error::value(
                "matrix",
                "is a singular placement; its three axes must span a volume",
            ));
        }
        Ok(Self {
            world_from_map,
            map_from_world,
        })
    }

    /// Edge lengths of the cube, mm.
    pub fn size_mm(&self) -> Vec3 {
        let m = self.world_from_map.matrix3;
        Vec3::new(m.x_axis.length(), m.y_axis.length(), m.z_axis.length())
    }

    /// The same placement with the cube scaled about its centre.
    pub fn scaled(&self, factor: Vec3) -> Result<Self> {
        let m = Mat3::from(self.world_from_map.matrix3) * Mat3::from_diagonal(factor);
        let center = self.world_from_map.transform_point3(Vec3::splat(0.5));
        Self::from_affine(Affine3A::from_mat3_translation(m, center - m * Vec3::splat(0.5)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centre_and_size_come_back() {
        let p = Placement::new(
            Vec3::new(1.0, 2.0, 3.0),
            Vec3::new(10.0, 20.0, 30.0),
            Vec3::new(30.0, -40.0, 80.0),
        )
        .unwrap_or_else(|e| panic!("{e}"));
        assert!(
            p.world_from_map
                .transform_point3(Vec3::splat(0.5))
                .abs_diff_eq(Vec3::new(1.0, 2.0, 3.0), 1e-4)
        );
        assert!(p.size_mm().abs_diff_eq(Vec3::new(10.0, 20.0, 30.0), 1e-4));
        let q = p
            .map_from_world
            .transform_point3(p.world_from_map.transform_point3(Vec3::new(0.2, 0.7, 0.9)));
        assert!(q.abs_diff_eq(Vec3::new(0.2, 0.7, 0.9), 1e-5));
    }

    #[test]
    fn singular_placements_are_refused() {
        assert!(Placement::new(Vec3::ZERO, Vec3::new(1.0, 0.0, 1.0), Vec3::ZERO).is_err());
        assert!(
            Placement::from_affine(Affine3A::from_mat3(Mat3::from_cols(Vec3::X, Vec3::X, Vec3::Y))).is_err()
        );
        assert!(Placement::from_affine(Affine3A::from_scale(Vec3::NAN)).is_err());
    }
}
