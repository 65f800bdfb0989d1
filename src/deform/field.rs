//! The value of a kind of deformation at a point, and the definition of the map sampled from it.

use super::formula::Formula;
use super::texel::{Storage, TexelSample};
use glam::Vec3;

/// The value of a kind at one deformed point, in local millimetres.
#[derive(Clone, Copy, Debug)]
pub struct Backward {
    /// The source point. Continuous everywhere, also where nothing is visible (the pseudo-inverse).
    pub source: Vec3,
    /// Signed distance to the nearest cut, mm, positive where the volume is retained: exact on the
    /// cut, and of the correct sign elsewhere.
    pub cut_distance_mm: f32,
}

/// A kind with its parameters resolved.
pub trait Field: Send + Sync {
    /// Source and cut distance of a deformed point.
    fn backward(&self, deformed: Vec3) -> Backward;

    /// Where a source point is moved to; none if it is removed or covered by another one.
    fn forward(&self, source: Vec3) -> Option<Vec3>;

    /// The field as numbers that a device can evaluate, if these describe it completely.
    fn formula(&self) -> Option<Formula> {
        None
    }
}

/// The definition from which a map is sampled.
pub struct MapDefinition {
    /// Grid points along x, y, z.
    pub size: [usize; 3],
    /// Texel format.
    pub storage: Storage,
    /// Extent of the map's cube, mm.
    pub cube_mm: Vec3,
    /// Half width of the mask's ramp, mm.
    pub ramp_mm: f32,
    /// The field in the cube's local millimetres about its centre.
    pub field: Box<dyn Field>,
}

impl MapDefinition {
    /// D and alpha at map coordinates.
    pub fn sample(&self, x: Vec3) -> TexelSample {
        let local = (x - 0.5) * self.cube_mm;
        let b = self.field.backward(local);
        TexelSample {
            displacement: (b.source - local) / self.cube_mm,
            alpha: (0.5 + 0.5 * b.cut_distance_mm / self.ramp_mm).clamp(0.0, 1.0),
        }
    }

    /// The formula, if the field is one.
    pub fn formula(&self) -> Option<Formula> {
        self.field.formula()
    }
}
