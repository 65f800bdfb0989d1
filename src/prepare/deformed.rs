//! A scene's deformation alone, as used for pictures and for baking.

use super::accelerator::{Accelerator, CpuOnly};
use super::assets::Assets;
use super::spacing::blend_mm;
use super::stack::{self, Composition, NamedStack};
use super::stack_inputs::StackInputs;
use super::{PrepareOptions, inside};
use crate::deform::cut::CutShapes;
use crate::deform::{Stack, StackAndCuts, Storage, invert};
use crate::math::Bounds;
use crate::mesh::Mesh;
use crate::scene::{JacobianSource, MapFiltering, Scene, ViewFrame};
use crate::{Result, Watch};
use glam::{DVec3, Vec3};
use std::sync::Arc;

/// A scene's deformation alone.
pub struct Deformed {
    /// Maps, in order of application.
    pub stack: Stack,
    /// The deformation that each map belongs to, by its name or kind.
    pub names: Vec<String>,
    /// Cuts after all maps.
    pub cuts: CutShapes,
    /// The error of composing maps into one, if any were composed.
    pub composition: Option<Composition>,
    /// The mesh from which slices are cut, instead of a box.
    pub proxy_mesh: Option<Arc<Mesh>>,
}

impl Deformed {
    /// The deformation of a placed scene as used in its pictures from a view.
    pub(super) fn in_view(
        scene: &Scene,
        assets: &Assets,
        view: &ViewFrame,
        options: &PrepareOptions,
    ) -> Result<Self> {
        let settings = &scene.render;
        let reference_mm = assets.volume.spacing_mm().min_element() as f32;
        let min_ramp_mm = 1.2 * blend_mm(settings.step, reference_mm)[1];
        let inputs = StackInputs {
            min_ramp_mm,
            exact_cuts: settings.exact_cuts,
            ..Self::inputs(assets, view, options.accelerator, &options.watch)
        };
        let undeformed = options.more_maps.is_empty() && !scene.deformation.iter().any(|d| d.enabled);
        let (inside, proxy_mesh) = match inside::of_scene(
            scene,
            &assets.inside_meshes,
            &assets.library,
            &inputs.scene_box,
            min_ramp_mm,
        )? {
            Some(inside) => (inside.maps.clone(), inside.proxy.clone().filter(|_| undeformed)),
            None => (Vec::new(), None),
        };
        let NamedStack { stack, names, cuts } =
            stack::stack(&scene.deformation, &inputs, inside, options.more_maps.to_vec())?;
        let (stack, composition) = stack::composed(stack, &inputs, settings.precompose)?;
        let stack = stack.filtered(
            settings.map_filter == Some(MapFiltering::Hardware),
            settings.jacobian == JacobianSource::Stored,
        );
        Ok(Self {
            stack,
            names,
            cuts,
            composition,
            proxy_mesh,
        })
    }

    /// The exact deformation of a placed scene.
    pub(super) fn exact_of_placed(
        scene: &Scene,
        assets: &Assets,
        exact_cuts: bool,
        watch: &Watch,
    ) -> Result<Self> {
        let view = scene.camera.frame(&assets.scene_box(), scene.render.size)?;
        let min_ramp_mm = 1.5 * assets.volume.spacing_mm().min_element() as f32;
        let inputs = StackInputs {
            min_ramp_mm,
            storage: Some(Storage::F32),
            exact_cuts,
            ..Self::inputs(assets, &view, &CpuOnly, watch)
        };
        let inside = inside::of_scene(
            scene,
            &assets.inside_meshes,
            &assets.library,
            &inputs.scene_box,
            min_ramp_mm,
        )?
        .map_or_else(Vec::new, |i| i.maps.clone());
        let NamedStack { stack, names, cuts } =
            stack::stack(&scene.deformation, &inputs, inside, Vec::new())?;
        Ok(Self {
            stack,
            names,
            cuts,
            composition: None,
            proxy_mesh: None,
        })
    }

    fn inputs<'a>(
        assets: &'a Assets,
        view: &'a ViewFrame,
        accelerator: &'a dyn Accelerator,
        watch: &'a Watch<'a>,
    ) -> StackInputs<'a> {
        let scene_box: Bounds = assets.scene_box();
        StackInputs {
            library: &assets.library,
            scene_box,
            min_ramp_mm: 0.0,
            view,
            storage: None,
            exact_cuts: true,
            accelerator,
            watch,
        }
    }

    /// Its maps and cuts.
    pub fn stack_and_cuts(&self) -> StackAndCuts<'_> {
        StackAndCuts {
            stack: &self.stack,
            cuts: &self.cuts,
        }
    }

    /// The deformed position of a source point, mm; none if it is cut away or not found.
    pub fn forward(&self, source: Vec3) -> Option<Vec3> {
        let y = source.as_dvec3();
        let backward = |p: DVec3| self.stack.source_and_alpha_unclipped(p.as_vec3()).0.as_dvec3();
        let solution = invert::point(&backward, y, y + (y - backward(y)), 0.05, 5e-3);
        let deformed = solution.source.as_vec3();
        (solution.found && self.stack_and_cuts().source(deformed).is_some()).then_some(deformed)
    }
}
