//! A deformation as a whole: the maps, and the cuts after them.

use super::Stack;
use super::cut::CutShapes;
use glam::Vec3;

/// The maps of a deformation and the cuts after them.
#[derive(Clone, Copy)]
pub struct StackAndCuts<'a> {
    /// The maps.
    pub stack: &'a Stack,
    /// The cuts after the maps.
    pub cuts: &'a CutShapes,
}

impl StackAndCuts<'_> {
    /// Whether it moves nothing and cuts nothing.
    pub fn is_empty(&self) -> bool {
        self.stack.is_empty() && self.cuts.is_empty()
    }

    /// The source of a point of the deformed scene, mm; none where it is cut away.
    pub fn source(&self, deformed: Vec3) -> Option<Vec3> {
        if self.cuts.signed_distance_mm(deformed) < 0.0 {
            return None;
        }
        let (source, alpha) = self.stack.source_and_alpha(deformed);
        (alpha >= 0.5).then_some(source)
    }
}
