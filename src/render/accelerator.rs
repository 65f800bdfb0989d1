//! Scene preparation on the device: maps sampled from their formulas, bounds on boxes of their
//! texels, and the cells of the empty-space grid classified by these bounds.
//!
//! *Theory*: the shaders `sample`, `encode`, `bounds` and `classify` are counterparts of
//! `src/deform/kinds`, `src/deform/map.rs`, `src/math/pyramid.rs` and `src/prepare/macrocells.rs`.
//! A map stays on the device. The CPU reads back only the scale and the range of its texels, which
//! determine the deformed scene's box and the grid's placement, and the state of each cell of the
//! grid. Where more is needed (by a picker or the CPU renderer), the map is also sampled on the
//! CPU.

use super::Renderer;
use crate::deform::compose::SourcesAndAlphas;
use crate::deform::{DisplacementMap, MapDefinition, Stack};
use crate::gpu::checked;
use crate::prepare::{Accelerator, CellGrid, CellState, VisibilityCriteria};
use crate::volume::VoxelGrid;
use crate::{Result, Watch};
use glam::Vec3;
use std::sync::Arc;

impl Accelerator for Renderer {
    fn evaluate(&self, stack: &Stack, points: &[Vec3]) -> Result<SourcesAndAlphas> {
        self.scene.maps.evaluate_stack(&self.context, stack, points)
    }

    fn map(&self, definition: MapDefinition, watch: &Watch) -> Result<Arc<DisplacementMap>> {
        let Some(formula) = definition
            .formula()
            .filter(|_| self.context.strategy.prepare && self.context.samples(&definition))
        else {
            return DisplacementMap::of_watched(&definition, watch).map(Arc::new);
        };
        let made = checked(&self.context.device.device, || {
            self.context.sampled_map(&definition, &formula)
        })?;
        let map = Arc::new(DisplacementMap::from_device(definition, made.scale, made.whole));
        self.scene.maps.cache_map(&self.context, &map, made);
        Ok(map)
    }

    fn needs_texels(&self) -> bool {
        !self.context.strategy.prepare
    }

    fn classify(
        &self,
        cells: &CellGrid,
        contents: &VisibilityCriteria,
        volume: &VoxelGrid,
    ) -> Result<Option<Vec<CellState>>> {
        if !self.context.strategy.prepare {
            return Ok(None);
        }
        checked(&self.context.device.device, || {
            self.scene
                .values
                .classified(&self.context, &self.scene.maps, cells, contents, volume)
        })
    }
}
