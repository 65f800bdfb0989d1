//! What the device takes over of preparing a scene: maps sampled from their formulas, with bounds on boxes of their texels, and the cells of the
//! empty-space grid by those bounds.
//!
//! *Theory*: the shaders `sample`, `encode`, `bounds` and `classify` state what `src/deform/kinds`, `src/deform/map.rs`, `src/math/pyramid.rs` and
//! `src/prepare/macrocells.rs` state. A map stays on the device: of its texels the CPU gets to know their scale and what all of them lie within, which the
//! deformed scene's box and the grid's place depend on; and of the grid what each cell shows. Where something asks a map for more (a picker, the CPU
//! renderer), it is sampled there too.

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

    fn map(&self, recipe: MapDefinition, watch: &Watch) -> Result<Arc<DisplacementMap>> {
        let Some(formula) = recipe.formula().filter(|_| self.context.strategy.prepare && self.context.samples(&recipe)) else {
            return DisplacementMap::of_watched(&recipe, watch).map(Arc::new);
        };
        let made = checked(&self.context.device.device, || self.context.sampled_map(&recipe, &formula))?;
        let map = Arc::new(DisplacementMap::from_device(recipe, made.scale, made.whole));
        self.scene.maps.cache_map(&self.context, &map, made);
        Ok(map)
    }

    fn needs_texels(&self) -> bool {
        !self.context.strategy.prepare
    }

    fn classify(&self, cells: &CellGrid, contents: &VisibilityCriteria, volume: &VoxelGrid) -> Result<Option<Vec<CellState>>> {
        if !self.context.strategy.prepare {
            return Ok(None);
        }
        checked(&self.context.device.device, || self.scene.values.classified(&self.context, &self.scene.maps, cells, contents, volume))
    }
}
