//! Where the box of a deformation lies in the world.

use crate::deform::kinds::Kind;
use crate::gui::state::tool::matrix_of;
use crate::math::Bounds;
use crate::scene::{Deformation, Size};
use glam::{Mat3, Vec3};

/// The placement of a deformation's box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxPlacement {
    /// Its centre, mm.
    pub center: Vec3,
    /// Its extents, mm.
    pub size: Vec3,
    /// Its axes, as columns.
    pub turn: Mat3,
}

impl BoxPlacement {
    /// The placement of a deformation, in a scene with the given box.
    pub fn of(d: &Deformation, kind: &Kind, scene_box: &Bounds) -> Self {
        // A size from a file may be invalid; the error is reported elsewhere.
        let size = d.size.map_or_else(|| kind.default_size(scene_box), Size::xyz);
        let size = if size.is_finite() {
            size.abs().max(Vec3::splat(1e-3))
        } else {
            Vec3::ONE
        };
        Self {
            center: d.center.map_or_else(|| scene_box.center(), Vec3::from),
            size,
            turn: d.rotate.map_or(Mat3::IDENTITY, |r| matrix_of(r.into())),
        }
    }

    /// World point of a point in the box's local millimetres.
    pub fn world(&self, local: Vec3) -> Vec3 {
        self.center + self.turn * local
    }

    /// The inverse of [`Self::world`].
    pub fn local(&self, world: Vec3) -> Vec3 {
        self.turn.transpose() * (world - self.center)
    }

    /// The bounds of the box in the world.
    pub fn bounds(&self) -> Bounds {
        let half = (self.turn.x_axis.abs() * self.size.x
            + self.turn.y_axis.abs() * self.size.y
            + self.turn.z_axis.abs() * self.size.z)
            / 2.0;
        Bounds::new(self.center - half, self.center + half)
    }
}
