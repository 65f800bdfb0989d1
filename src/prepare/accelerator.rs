//! The parts of scene preparation that a device may take over: sampling maps, finding empty space,
//! evaluating stacks to compose.

use super::macrocells::{CellGrid, CellState, VisibilityCriteria};
use crate::deform::compose::{self, SourcesAndAlphas};
use crate::deform::{DisplacementMap, MapDefinition, Stack};
use crate::volume::VoxelGrid;
use crate::{Result, Watch};
use glam::Vec3;
use std::sync::Arc;

/// A device that takes over some work; the CPU does the rest.
pub trait Accelerator {
    /// Source and smallest mask of points under a stack, through every map whatever the masks are:
    /// the input of [`compose`].
    ///
    /// # Errors
    /// Any error of the device.
    fn evaluate(&self, stack: &Stack, points: &[Vec3]) -> Result<SourcesAndAlphas> {
        compose::evaluate(stack, points)
    }

    /// The map of a definition.
    ///
    /// # Errors
    /// Any error of the device; [`crate::Error::Cancelled`].
    fn map(&self, definition: MapDefinition, watch: &Watch) -> Result<Arc<DisplacementMap>> {
        DisplacementMap::of_watched(&definition, watch).map(Arc::new)
    }

    /// Whether texels are needed on the CPU, even those of maps made by a device.
    fn needs_texels(&self) -> bool {
        true
    }

    /// The state of each cell of a grid over the deformed scene for a volume, x fastest; none if
    /// the CPU has to classify.
    ///
    /// # Errors
    /// Any error of the device.
    fn classify(
        &self,
        cells: &CellGrid,
        contents: &VisibilityCriteria,
        volume: &VoxelGrid,
    ) -> Result<Option<Vec<CellState>>> {
        let _ = (cells, contents, volume);
        Ok(None)
    }
}

/// No device: the CPU does everything.
pub struct CpuOnly;

impl Accelerator for CpuOnly {}
