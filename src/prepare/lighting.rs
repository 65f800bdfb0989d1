//! The light volume of a prepared scene.

use super::assets::Assets;
use super::light_volume::{Casters, SurfaceCaster, VolumeCaster};
use super::objects::Stage;
use super::prepared::Prepared;

impl Prepared<'_> {
    /// Computes the light volume, if the light casts shadows or is dimmed, and anything is lit.
    pub(super) fn add_light_volume(&mut self, assets: &Assets, is_draft: bool) {
        if !self.is_lit() && self.surfaces.objects.is_empty() {
            return;
        }
        let mut stages = std::mem::take(&mut self.stages);
        let to_light = self.frame.to_light;
        let cache = &assets.light_volumes;
        self.light_volume = cache.of(&self.casters(), &self.light, to_light, is_draft, &mut stages);
        self.stages = stages;
    }

    fn casters(&self) -> Casters<'_> {
        let volume = self.volume();
        let is_seen = volume.is_present && self.is_composite() && !volume.macrocells.occupied.is_empty();
        let surfaces = self.surfaces.objects.iter().map(|object| SurfaceCaster {
            implicit: object
                .implicit
                .as_ref()
                .filter(|_| object.stage != Stage::Triangles),
            triangles: object.triangles.as_ref().filter(|_| object.stage != Stage::Rays),
            cells: &object.cells,
            model: object.look.model,
            thickness_mm: object.thickness_mm,
            rigid: object.rigid,
        });
        Casters {
            stack: &self.stack,
            cuts: &self.cuts,
            volume: is_seen.then_some(VolumeCaster {
                grid: volume.grid,
                voxel_from_world: &volume.voxel_from_world,
                grid_size: volume.grid_size,
                table: &volume.table,
                iso: volume.iso,
                macrocells: &volume.macrocells,
            }),
            surfaces: surfaces.collect(),
            reference_mm: self.frame.spacing.reference_mm,
        }
    }
}
