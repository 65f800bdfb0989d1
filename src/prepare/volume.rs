//! One volume of a prepared scene: its samples, its colours, and where nothing of it is visible.

use super::PrepareOptions;
use super::assets::Assets;
use super::deformed::Deformed;
use super::macrocells::{Macrocells, VisibilityCriteria};
use super::sampled::SampledVolume;
use super::spacing::{SampleSpacing, cut_margin_mm};
use crate::math::{Bounds, to_f32};
use crate::scene::{CutFaces, Mode, Scene, VolumeFilter};
use crate::transfer::{Blend, OWN_COLORS, TransferFunction, TransferTable};
use crate::volume::{Colors, Volume, VoxelGrid};
use crate::{Error, Result};
use glam::{Affine3A, Vec3};
use std::sync::Arc;

/// The mean error of single values above which the transfer function is pre-integrated. Below it
/// the difference is hardly seen, and edges are more exact without.
const MAX_SINGLE_VALUE_ERROR: f32 = 0.02;

/// A volume shown by a scene, or the empty one of a scene without any.
pub struct VolumeObject<'a> {
    /// The voxels to sample.
    pub grid: &'a VoxelGrid,
    /// The same with the data derived from it.
    pub(super) sampled: &'a SampledVolume,
    /// The voxels' own colours, which replace those of the table.
    pub colors: Option<&'a Colors>,
    /// World to voxel.
    pub voxel_from_world: Affine3A,
    /// Extent of the grid, voxels.
    pub grid_size: Vec3,
    /// Baked transfer function.
    pub table: TransferTable,
    /// How samples blend.
    pub blend: Blend,
    /// Normalised value of the iso-surface shown instead of the volume, if there is one.
    pub iso: Option<f32>,
    /// Normalised values shown as black and white on grey cut faces.
    pub grey_window: [f32; 2],
    /// Empty space.
    pub macrocells: Arc<Macrocells>,
    /// Whether colour and opacity are those of segments between samples.
    pub(super) preintegrated: bool,
    /// Whether the scene has a volume; without one, this one is empty.
    pub(super) is_present: bool,
    /// The smallest and largest value, data units.
    pub(super) value_range: [f64; 2],
    /// Whether no voxel is a finite number.
    pub(super) has_no_values: bool,
}

/// How the values of a volume are mapped to colours.
pub(super) struct Classifier<'a> {
    sampled: &'a SampledVolume,
    colors: Option<&'a Colors>,
    function: TransferFunction,
    table: TransferTable,
}

impl<'a> Classifier<'a> {
    /// The scene's transfer function over its volume.
    ///
    /// # Errors
    /// Any invalid setting, by name.
    pub fn new(scene: &Scene, assets: &'a Assets) -> Result<Self> {
        let (volume, transfer) = (&assets.volume, &scene.transfer);
        let fallback = scene.default_preset(volume);
        let function = transfer.resolve(volume, fallback)?;
        // Labels in their colours, unless a curve over the labels themselves is set.
        let plain = transfer.points.is_empty()
            && transfer.window.is_none()
            && transfer.level.is_none()
            && function.blend == Blend::Composite;
        let by_label = plain
            && transfer.preset.as_deref().unwrap_or(fallback) == "labels"
            && scene.render.iso.is_none()
            && scene.render.cut_faces == CutFaces::Lit;
        if let Some(sampled) = by_label
            .then(|| assets.sampled_labels(scene.render.filter))
            .flatten()
        {
            let function = function.of_presence(scene.render.filter == VolumeFilter::Cubic);
            let table = TransferTable::new(&function, [0.0, 1.0]);
            return Ok(Self {
                sampled,
                colors: sampled.grid.colors.as_ref(),
                function,
                table,
            });
        }
        let table = TransferTable::new(&function, volume.range);
        let own = transfer
            .own_colors
            .unwrap_or(transfer.preset.as_deref().is_none_or(|p| p == OWN_COLORS));
        let sampled = assets.sampled();
        Ok(Self {
            sampled,
            colors: sampled.grid.colors.as_ref().filter(|_| own),
            function,
            table,
        })
    }
}

impl<'a> VolumeObject<'a> {
    /// The scene's volume as mapped by its classifier, with its empty space under a deformation.
    ///
    /// # Errors
    /// A geometry that is not invertible; any error of the accelerator.
    pub(super) fn new(
        classifier: Classifier<'a>,
        scene: &Scene,
        assets: &Assets,
        deformed: &Deformed,
        spacing: &SampleSpacing,
        options: &PrepareOptions,
    ) -> Result<Self> {
        let volume: &Volume = &assets.volume;
        let span = (volume.range[1] - volume.range[0]).max(f64::MIN_POSITIVE);
        let normalised = |v: f64| ((v - volume.range[0]) / span) as f32;
        let Classifier {
            sampled,
            colors,
            function,
            table,
        } = classifier;
        let voxel_from_world = to_f32(&volume.world_from_voxel.inverse());
        if !voxel_from_world.is_finite() {
            return Err(Error::value(
                "volume",
                "its voxel axes are singular; the file's geometry cannot be used",
            ));
        }
        let mut object = Self {
            grid: &sampled.grid,
            sampled,
            colors,
            voxel_from_world,
            grid_size: Vec3::from(sampled.grid.size.map(|n| n as f32)),
            table,
            blend: function.blend,
            iso: scene.render.iso.map(normalised),
            grey_window: volume
                .window(scene.transfer.window, scene.transfer.level)
                .map(normalised),
            macrocells: Arc::new(Macrocells::solid(Bounds::EMPTY)),
            preintegrated: false,
            is_present: assets.has_volume,
            value_range: volume.range,
            has_no_values: volume.non_finite == volume.voxels.len(),
        };
        if scene.render.mode != Mode::Surface && assets.has_volume {
            object.preintegrated = object.is_preintegrated(scene, volume, spacing, options.is_draft);
            let bounds = deformed.stack.deformed_bounds(&volume.bounds_in_world());
            object.macrocells = object.empty_space(scene, deformed, bounds, spacing, options)?;
        }
        Ok(object)
    }

    /// Whether the transfer function is pre-integrated: as the scene says or, if it does not say,
    /// where single values would be too wrong. The numbers of labels have nothing between them, and
    /// drafts are to be fast.
    fn is_preintegrated(
        &self,
        scene: &Scene,
        volume: &Volume,
        spacing: &SampleSpacing,
        is_draft: bool,
    ) -> bool {
        if self.blend != Blend::Composite || self.iso.is_some() {
            return false;
        }
        scene.render.preintegrated.unwrap_or_else(|| {
            if is_draft || volume.labels().is_some() {
                return false;
            }
            let reference = f64::from(spacing.reference_mm);
            let step = (reference / volume.spacing_mm()).as_vec3();
            let error = self
                .sampled
                .single_value_error(&self.table, step, scene.render.step);
            error > MAX_SINGLE_VALUE_ERROR
        })
    }

    /// Whether anything is shown at a point of the undeformed scene.
    pub(super) fn shows(&self, source: Vec3) -> bool {
        self.value_at(source).is_some_and(|value| match self.iso {
            Some(iso) => value >= iso,
            None => self.table.lookup(value)[3] > 0.0,
        })
    }

    /// The value of the voxel nearest to a point of the undeformed scene; none outside the volume
    /// and in its holes.
    pub(super) fn value_at(&self, source: Vec3) -> Option<f32> {
        let p = self.voxel_from_world.transform_point3(source);
        if !self.is_present || p.cmplt(Vec3::splat(-0.5)).any() || p.cmpgt(self.grid_size - 0.5).any() {
            return None;
        }
        let value = self.grid.value_near(p);
        let is_hole = self.grid.has_holes && value < -1e-4;
        (!is_hole).then_some(value)
    }

    /// The optical depth of a voxel's length at a point of the undeformed scene (powers of 1/2);
    /// infinite within an iso-surface and, in a projection, where the window is bright.
    pub(super) fn depth_at(&self, source: Vec3) -> f32 {
        let Some(value) = self.value_at(source) else {
            return 0.0;
        };
        let opaque = |is_opaque: bool| if is_opaque { f32::INFINITY } else { 0.0 };
        let level = 0.5 * (self.grey_window[0] + self.grey_window[1]);
        match (self.iso, self.blend) {
            (Some(iso), _) => opaque(value >= iso),
            (None, Blend::Composite) => self.table.lookup(value)[3],
            (None, Blend::Minip) => opaque(value <= level),
            (None, _) => opaque(value >= level),
        }
    }

    /// Where nothing of the volume is visible in its deformed box.
    fn empty_space(
        &self,
        scene: &Scene,
        deformed: &Deformed,
        bounds: Bounds,
        spacing: &SampleSpacing,
        options: &PrepareOptions,
    ) -> Result<Arc<Macrocells>> {
        let settings = &scene.render;
        // Slices meet rays at an angle; samples of rays are a step apart.
        let slant = if settings.mode == Mode::Slice {
            scene.camera.slant(settings.size)
        } else {
            1.0
        };
        let step_back_mm = 1.01 * spacing.step_mm * slant;
        if !settings.empty_space_skipping {
            return Ok(Macrocells::solid(bounds.grown(step_back_mm)).into());
        }
        let grey_faces = settings.cut_faces == CutFaces::Grey;
        let contents = VisibilityCriteria {
            stack: &deformed.stack,
            cuts: &deformed.cuts,
            iso: self.iso,
            grey_faces,
            lookback_mm: if self.iso.is_some() || grey_faces || self.preintegrated {
                step_back_mm
            } else {
                0.0
            },
            cut_lookback_mm: step_back_mm,
            cut_margin_mm: cut_margin_mm(spacing.blend_mm, spacing.step_mm, slant),
            voxel_from_world: &self.voxel_from_world,
            voxel_box: Bounds::new(Vec3::splat(-0.5), self.grid_size - 0.5),
            value_pyramid: &self.sampled.bounds,
            table: &self.table,
            blend: self.blend,
        };
        // Samples that read a step back may lie outside the box of the scene itself.
        self.sampled.macrocells(
            bounds.grown(contents.reach_mm()),
            spacing.reference_mm,
            &contents,
            options.accelerator,
        )
    }
}
