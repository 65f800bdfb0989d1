//! Resolves a scene against its assets. Deformations whose numbers are left out are placed first.

use super::PrepareOptions;
use super::assets::Assets;
use super::deformed::Deformed;
use super::idle::{IdleSetting, ineffective_settings};
use super::placement::placed;
use super::prepared::{Frame, Prepared};
use super::spacing::{SampleSpacing, blend_mm};
use super::tears;
use super::volume::{Classifier, VolumeObject};
use crate::deform::kinds;
use crate::math::normalize_or;
use crate::picture::StageTimes;
use crate::scene::{Deformation, Light, Scene, ViewFrame};
use crate::{Result, Watch};
use glam::Vec3;

/// A displacement on the face of a map's box that is not seen, voxels.
const TEAR_TOLERANCE: f32 = 0.5;

impl Deformed {
    /// The deformation of a scene as used in its pictures.
    ///
    /// # Errors
    /// Any invalid setting, by name.
    pub fn new(scene: &Scene, assets: &Assets) -> Result<Self> {
        Self::watched(scene, assets, &Watch::NONE)
    }

    /// As [`Self::new`], for a caller that may cancel.
    ///
    /// # Errors
    /// As [`Self::new`]; [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn watched(scene: &Scene, assets: &Assets, watch: &Watch) -> Result<Self> {
        scene.check()?;
        let scene = &*placed(scene, assets)?;
        let view = scene.camera.frame(&assets.scene_box(), scene.render.size)?;
        Self::in_view(scene, assets, &view, &PrepareOptions::default().watched(watch))
    }

    /// The exact deformation, as used for baking: every map in single precision, none composed; the
    /// last cuts as shapes if requested.
    ///
    /// # Errors
    /// As [`Self::watched`].
    pub fn exact(scene: &Scene, assets: &Assets, exact_cuts: bool, watch: &Watch) -> Result<Self> {
        scene.check_limits()?;
        Self::exact_of_placed(&*placed(scene, assets)?, assets, exact_cuts, watch)
    }
}

impl<'a> Prepared<'a> {
    /// Resolves a scene.
    ///
    /// # Errors
    /// Any invalid setting, by name.
    pub fn new(scene: &Scene, assets: &'a Assets) -> Result<Self> {
        Self::with(scene, assets, &PrepareOptions::default())
    }

    /// As [`Self::new`], with an accelerator, additional maps, or cancellation.
    ///
    /// # Errors
    /// As [`Self::new`]; any error of the accelerator;
    /// [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn with(scene: &Scene, assets: &'a Assets, options: &PrepareOptions) -> Result<Self> {
        scene.check()?;
        let mut stages = StageTimes::default();
        let scene = &*stages.time("placement", || placed(scene, assets))?;
        let settings = options.settings(scene);
        let classifier = stages.time("transfer", || Classifier::new(scene, assets))?;
        let scene_box = assets.scene_box();
        let mut view = scene.camera.frame(&scene_box, settings.size)?;
        let reference_mm = assets.volume.spacing_mm().min_element() as f32;
        let mut spacing = SampleSpacing {
            step_mm: settings.step * reference_mm,
            reference_mm,
            blend_mm: blend_mm(settings.step, reference_mm),
        };
        let deformed = stages.time("maps", || -> Result<_> {
            let deformed = Deformed::in_view(scene, assets, &view, options)?;
            if options.accelerator.needs_texels() {
                deformed.stack.fetch_texels();
            }
            Ok(deformed)
        })?;
        view.step_back_from(&deformed.stack.deformed_bounds(&scene_box), spacing.step_mm);
        let surfaces = stages.time("surfaces", || {
            assets.surfaces(scene, &deformed.stack, &deformed.cuts)
        })?;
        // Without a volume the step is that of the finest surface.
        let finest = surfaces.finest_cell_mm();
        if !assets.has_volume && finest.is_finite() {
            (spacing.reference_mm, spacing.step_mm) = (finest, settings.step * finest);
        }
        let volume = stages.time("macrocells", || {
            VolumeObject::new(classifier, scene, assets, &deformed, &spacing, options)
        })?;
        let tears = stages.time("tears", || {
            let is_visible_source = |source: Vec3| {
                volume.shows(source) || surfaces.objects.iter().any(|o| !o.rigid && o.contains(source))
            };
            let can_fade = |name: &str| {
                let of_name = |d: &&Deformation| d.name.as_deref().unwrap_or(&d.kind) == name;
                // A chain of transforms becomes several maps, which have no common faces.
                let is_chain = |d: &Deformation| {
                    d.kind == "field" && deformed.names.iter().filter(|n| *n == name).count() > 1
                };
                scene.deformation.iter().find(of_name).is_some_and(|d| {
                    kinds::kind(&d.kind).map_or(!is_chain(d), |kind| {
                        kind.parameters.iter().all(|p| p.name != "fade")
                    })
                })
            };
            tears::tears(
                &deformed,
                &scene_box,
                TEAR_TOLERANCE * reference_mm,
                is_visible_source,
                can_fade,
            )
        });
        let light = options.light(scene);
        let to_light = to_light(&light, &view);
        let Deformed {
            stack,
            cuts,
            composition,
            proxy_mesh,
            ..
        } = deformed;
        let frame = Frame {
            view,
            size: settings.size.map(|n| n * settings.antialias.grid()),
            spacing,
            proxy: volume.macrocells.occupied,
            to_light,
        };
        let mut prepared = Self {
            volumes: vec![volume],
            surfaces,
            stack,
            cuts,
            proxy_mesh,
            composition,
            frame,
            light,
            light_volume: None,
            settings,
            density: scene.transfer.density,
            notices: composition
                .and_then(|c| c.notice())
                .into_iter()
                .chain(tears::notices(&tears))
                .collect(),
            tears,
            stages,
        };
        prepared.add_light_volume(assets, options.is_draft);
        let idle = ineffective_settings(&prepared, scene);
        prepared.notices.extend(idle.iter().map(IdleSetting::notice));
        Ok(prepared)
    }
}

/// The unit vector towards a light, world.
fn to_light(light: &Light, view: &ViewFrame) -> Vec3 {
    let d = light.toward();
    let to_light = if light.follows_camera {
        normalize_or(view.right, Vec3::X) * d.x + normalize_or(view.up, Vec3::Z) * d.y - view.forward * d.z
    } else {
        d
    };
    normalize_or(to_light, -view.forward)
}
