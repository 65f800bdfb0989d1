//! What a kind of deformation answers for a point, and the definition of the map that is sampled from it.

use super::formula::Formula;
use super::texel::{Storage, TexelSample};
use glam::Vec3;

/// A kind's answer for one deformed point, in local millimetres.
#[derive(Clone, Copy, Debug)]
pub struct Backward {
    /// Where the matter seen here came from. Continuous everywhere, also where nothing is seen (the pseudo-inverse).
    pub source: Vec3,
    /// Signed distance to the nearest cut, mm, positive where matter is: exact on the cut, at least of the right sign elsewhere.
    pub cut_distance_mm: f32,
}

/// A kind with its parameters filled in.
pub trait Field: Send + Sync {
    /// Where the matter at a deformed point came from.
    fn backward(&self, deformed: Vec3) -> Backward;

    /// Where a source point goes; none if it is removed or another one covers it.
    fn forward(&self, source: Vec3) -> Option<Vec3>;

    /// The same as numbers that a device can sample, where they say all.
    fn formula(&self) -> Option<Formula> {
        None
    }
}

/// What a map is sampled from.
pub struct MapDefinition {
    /// Grid points along x, y, z.
    pub size: [usize; 3],
    /// Texel format.
    pub storage: Storage,
    /// Extent of the map's cube, mm.
    pub cube_mm: Vec3,
    /// Half width of the mask's ramp, mm.
    pub ramp_mm: f32,
    /// The field in the cube's own millimetres from its centre.
    pub field: Box<dyn Field>,
}

impl MapDefinition {
    /// D and alpha at map coordinates.
    pub fn sample(&self, x: Vec3) -> TexelSample {
        let local = (x - 0.5) * self.cube_mm;
        let b = self.field.backward(local);
        TexelSample { displacement: (b.source - local) / self.cube_mm, alpha: (0.5 + 0.5 * b.cut_distance_mm / self.ramp_mm).clamp(0.0, 1.0) }
    }

    /// The formula, if the field is one.
    pub fn formula(&self) -> Option<Formula> {
        self.field.formula()
    }
}
