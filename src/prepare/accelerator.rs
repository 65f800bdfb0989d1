//! What of preparing a scene a device may take over: sampling maps, finding empty space, evaluating stacks that are composed.

use super::macrocells::{CellGrid, CellState, VisibilityCriteria};
use crate::deform::compose::{self, SourcesAndAlphas};
use crate::deform::{DisplacementMap, MapDefinition, Stack};
use crate::volume::VoxelGrid;
use crate::{Result, Watch};
use glam::Vec3;
use std::sync::Arc;

/// A device that takes over what it does well; what it leaves is done by the CPU.
pub trait Accelerator {
    /// Source and smallest mask of points under a stack, through every map whatever the masks say: what [`compose`] samples.
    ///
    /// # Errors
    /// Whatever the device reports.
    fn evaluate(&self, stack: &Stack, points: &[Vec3]) -> Result<SourcesAndAlphas> {
        compose::evaluate(stack, points)
    }

    /// The map of a definition.
    ///
    /// # Errors
    /// Whatever the device reports; [`crate::Error::Cancelled`].
    fn map(&self, recipe: MapDefinition, watch: &Watch) -> Result<Arc<DisplacementMap>> {
        DisplacementMap::of_watched(&recipe, watch).map(Arc::new)
    }

    /// Whether texels are wanted here, also of maps that a device has made before.
    fn needs_texels(&self) -> bool {
        true
    }

    /// What each cell of a grid over the deformed scene shows of a volume, x fastest; none if the CPU is to find out.
    ///
    /// # Errors
    /// Whatever the device reports.
    fn classify(&self, cells: &CellGrid, contents: &VisibilityCriteria, volume: &VoxelGrid) -> Result<Option<Vec<CellState>>> {
        let _ = (cells, contents, volume);
        Ok(None)
    }
}

/// No device: the CPU does all.
pub struct CpuOnly;

impl Accelerator for CpuOnly {}
