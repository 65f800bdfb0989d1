//! A scene resolved for rendering: its files are loaded ([`Assets`]), its deformations become a
//! stack of maps ([`Deformed`]), and its objects get the data that every backend needs, above all
//! empty space ([`Prepared`]).
//!
//! Expensive results are cached in the assets under their inputs, hence preparing the next picture
//! of an edited scene costs only what the edit changed. A device takes over what it does better
//! than the CPU as an [`Accelerator`].

mod accelerator;
mod assets;
mod blank;
mod coarse_rays;
mod deformed;
mod idle;
pub mod inside;
mod light_volume;
mod lighting;
mod macrocells;
mod map_assets;
pub mod measure;
mod mesh_settings;
mod object_cache;
pub mod objects;
pub mod placement;
mod prepared;
mod resolve;
mod sampled;
pub mod slices;
mod spacing;
pub mod stack;
mod stack_inputs;
pub mod surface_cells;
mod tears;
mod unseen;
mod visibility;
mod volume;

pub use accelerator::{Accelerator, CpuOnly};
pub use assets::{AssetKey, Assets, LoadOptions};
pub use deformed::Deformed;
pub use idle::{IdleSetting, idle_settings};
pub use light_volume::{LightVolume, ReferenceRays};
pub use macrocells::{CellGrid, CellState, Macrocells, VisibilityCriteria};
pub use prepared::{Frame, Prepared};
pub use spacing::SampleSpacing;
pub use stack_inputs::StackInputs;
pub use tears::Tear;
pub use unseen::unseen_deformations;
pub use volume::VolumeObject;

use crate::Watch;
use crate::deform::PlacedMap;
use crate::scene::{Light, LightQuality, RenderSettings, Scene, VolumeFilter};

/// Options for preparing a scene; by default everything on the CPU, without additional maps or
/// cancellation.
#[derive(Clone, Copy)]
pub struct PrepareOptions<'a> {
    /// The device that takes over some work.
    pub accelerator: &'a dyn Accelerator,
    /// Maps that do not come from a kind, applied after the scene's own.
    pub more_maps: &'a [PlacedMap],
    /// Whether the picture is a draft: volumes are interpolated linearly, whatever the scene says,
    /// and pre-integrated only if it says so. Labels keep the boundaries of the scene's filter.
    pub is_draft: bool,
    /// Receives the completed fraction, and can cancel.
    pub watch: Watch<'a>,
}

impl Default for PrepareOptions<'_> {
    fn default() -> Self {
        Self {
            accelerator: &CpuOnly,
            more_maps: &[],
            is_draft: false,
            watch: Watch::NONE,
        }
    }
}

impl<'a> PrepareOptions<'a> {
    /// With a device that takes over some work.
    pub fn on(accelerator: &'a dyn Accelerator) -> Self {
        Self {
            accelerator,
            ..Self::default()
        }
    }

    /// With additional maps after the scene's own.
    pub fn with_maps(more_maps: &'a [PlacedMap]) -> Self {
        Self {
            more_maps,
            ..Self::default()
        }
    }

    /// The scene's settings for the picture.
    fn settings(&self, scene: &Scene) -> RenderSettings {
        let mut settings = scene.render.clone();
        if self.is_draft {
            settings.filter = VolumeFilter::Linear;
        }
        settings
    }

    /// The scene's light for the picture.
    fn light(&self, scene: &Scene) -> Light {
        let mut light = scene.light.clone();
        if self.is_draft {
            light.quality = LightQuality::Fast;
        }
        light
    }

    /// The same, for a draft or a full picture.
    #[must_use]
    pub fn as_draft(self, is_draft: bool) -> Self {
        Self { is_draft, ..self }
    }

    /// The same, with progress and cancellation.
    #[must_use]
    pub fn watched(self, watch: &Watch<'a>) -> Self {
        Self {
            watch: *watch,
            ..self
        }
    }
}
