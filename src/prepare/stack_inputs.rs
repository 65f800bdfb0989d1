//! What a stack of maps is made from, besides the scene's deformations.

use super::accelerator::Accelerator;
use crate::Watch;
use crate::deform::{Library, Storage};
use crate::math::Bounds;
use crate::scene::ViewFrame;

/// The name of the maps that hold a volume inside a mesh.
pub(super) const INSIDE: &str = "volume.inside";

/// The inputs of a stack of maps in addition to the scene's deformations.
#[derive(Clone, Copy)]
pub struct StackInputs<'a> {
    /// Files and volumes.
    pub library: &'a Library,
    /// The undeformed scene's box, mm.
    pub scene_box: Bounds,
    /// Minimum half width of the mask's ramp, mm.
    pub min_ramp_mm: f32,
    /// The camera, for deformations locked to the view.
    pub view: &'a ViewFrame,
    /// Overrides every storage format.
    pub storage: Option<Storage>,
    /// Whether removals that no later deformation moves stay analytic shapes.
    pub exact_cuts: bool,
    /// Samples maps.
    pub accelerator: &'a dyn Accelerator,
    /// Receives progress, and can cancel.
    pub watch: &'a Watch<'a>,
}
