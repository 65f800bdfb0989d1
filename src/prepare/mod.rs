//! A scene resolved for rendering: the files that it names are loaded ([`Assets`]), its deformations become a stack of maps ([`Deformed`]), its
//! objects get what every backend needs of them, empty space above all ([`Prepared`]).
//!
//! What takes long is kept in the assets and found again by what it was made from, so that preparing the next picture of an edited scene costs what
//! the edit changed. What a device does better than the CPU it takes over as an [`Accelerator`].

mod accelerator;
mod assets;
mod blank;
mod deformed;
pub mod inside;
mod macrocells;
pub mod measure;
mod mesh_settings;
mod object_cache;
pub mod objects;
mod prepared;
mod sampled;
mod spacing;
pub mod stack;
pub mod surface_cells;
mod volume;

pub use accelerator::{Accelerator, CpuOnly};
pub use assets::{AssetKey, Assets, LoadOptions};
pub use deformed::Deformed;
pub use macrocells::{CellGrid, CellState, Macrocells, VisibilityCriteria};
pub use prepared::{Frame, Prepared};
pub use spacing::SampleSpacing;
pub use volume::VolumeObject;

use crate::Watch;
use crate::deform::PlacedMap;

/// How a scene is prepared; the default does all on the CPU, adds nothing and never stops.
#[derive(Clone, Copy)]
pub struct PrepareOptions<'a> {
    /// The device that takes over what it does well.
    pub accelerator: &'a dyn Accelerator,
    /// Maps made by other means than a kind, applied after the scene's own.
    pub more_maps: &'a [PlacedMap],
    /// Receives the share that is done, and says when to stop.
    pub watch: Watch<'a>,
}

impl Default for PrepareOptions<'_> {
    fn default() -> Self {
        Self { accelerator: &CpuOnly, more_maps: &[], watch: Watch::NONE }
    }
}

impl<'a> PrepareOptions<'a> {
    /// By a device that takes over what it does well.
    pub fn on(accelerator: &'a dyn Accelerator) -> Self {
        Self { accelerator, ..Self::default() }
    }

    /// With maps after the scene's own.
    pub fn with_maps(more_maps: &'a [PlacedMap]) -> Self {
        Self { more_maps, ..Self::default() }
    }

    /// The same, watched.
    #[must_use]
    pub fn watched(self, watch: &Watch<'a>) -> Self {
        Self { watch: *watch, ..self }
    }
}
