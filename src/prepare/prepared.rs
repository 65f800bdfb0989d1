//! A scene resolved for rendering: the input of every backend.

use super::PrepareOptions;
use super::assets::Assets;
use super::deformed::Deformed;
use super::idle::{IdleSetting, stated_in_vain};
use super::objects::{SurfaceObject, Surfaces};
use super::slices::{Proxy, SlicePolygons};
use super::spacing::{SampleSpacing, blend_mm, cut_margin_mm};
use super::stack::Composition;
use super::tears::{self, Tear};
use super::volume::{Classifier, VolumeObject};
use crate::Result;
use crate::deform::Stack;
use crate::deform::cut::CutShapes;
use crate::math::{Bounds, normalize_or};
use crate::mesh::Mesh;
use crate::picture::StageTimes;
use crate::scene::{CutFaces, Light, Mode, Normals, RenderSettings, Scene, SliceOrder, ViewFrame};
use crate::transfer::Blend;
use crate::volume::{GradientFilter, GradientVolume};
use glam::Vec3;
use std::sync::Arc;

/// A displacement on the face of a map's box that is not seen, voxels.
const TEAR_TOLERANCE: f32 = 0.5;

/// The constants of one picture.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Camera.
    pub view: ViewFrame,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Sampling lengths.
    pub spacing: SampleSpacing,
    /// The part of the deformed scene in which anything of its volumes may be visible, mm.
    pub proxy: Bounds,
    /// Unit vector towards the light, world.
    pub to_light: Vec3,
}

/// A scene resolved against its assets: its visible objects, their deformation, and the camera.
pub struct Prepared<'a> {
    /// Exactly one volume, an empty one if the scene has none.
    pub volumes: Vec<VolumeObject<'a>>,
    /// Surfaces shown with the volumes, or alone.
    pub surfaces: Surfaces,
    /// The deformation.
    pub stack: Stack,
    /// Cuts after all maps.
    pub cuts: CutShapes,
    /// The mesh from which slices are cut, instead of a box.
    pub proxy_mesh: Option<Arc<Mesh>>,
    /// The error of composing maps into one, if any were composed.
    pub composition: Option<Composition>,
    /// Constants.
    pub frame: Frame,
    /// Light.
    pub light: Light,
    /// The scene's render settings.
    pub settings: RenderSettings,
    /// The factor on the opacities, if the scene sets one.
    pub(super) density: Option<f64>,
    /// Matter torn at faces of deformations' boxes.
    pub tears: Vec<Tear>,
    /// Notices for the user from resolving the scene, one sentence each.
    pub notices: Vec<String>,
    /// Preparation times.
    pub stages: StageTimes,
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
        let settings = scene.render.clone();
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
        let finest = surfaces
            .objects
            .iter()
            .map(|o| o.cell_mm)
            .fold(f32::INFINITY, f32::min);
        if !assets.has_volume && finest.is_finite() {
            (spacing.reference_mm, spacing.step_mm) = (finest, settings.step * finest);
        }
        let volume = stages.time("macrocells", || {
            VolumeObject::new(classifier, scene, assets, &deformed, &spacing, options)
        })?;
        let tears = stages.time("tears", || {
            let is_matter = |source: Vec3| {
                volume.shows(source) || surfaces.objects.iter().any(|o| !o.rigid && o.contains(source))
            };
            tears::tears(&deformed, &scene_box, TEAR_TOLERANCE * reference_mm, is_matter)
        });
        let light = scene.light.clone();
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
            size: settings.size.map(|n| n * settings.antialias),
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
        let idle = stated_in_vain(&prepared, scene);
        prepared.notices.extend(idle.iter().map(IdleSetting::notice));
        Ok(prepared)
    }

    /// The surfaces that slices sample as objects beside the volume: those with a distance field. In
    /// other modes there are none; nor in front of a projection, which has no order.
    pub fn sliced_surfaces(&self) -> impl Iterator<Item = &SurfaceObject> {
        self.surfaces
            .objects
            .iter()
            .filter(|object| self.is_sliced(object))
    }

    /// Whether slices sample a surface.
    pub fn is_sliced(&self, object: &SurfaceObject) -> bool {
        self.settings.mode == Mode::Slice
            && self.volume().blend == Blend::Composite
            && object.implicit.is_some()
    }

    /// Whether there are surfaces that are drawn before the volume, as opaque pixels behind it.
    pub fn has_surfaces_behind(&self) -> bool {
        self.sliced_surfaces().count() < self.surfaces.objects.len()
    }

    /// Whether slices have anything to sample.
    pub fn has_slices(&self) -> bool {
        self.settings.mode == Mode::Slice
            && (self.shows_volume() && !self.frame.proxy.is_empty()
                || self.sliced_surfaces().next().is_some())
    }

    /// The polygons of the slices that can show anything. Slices with surfaces are drawn one by one.
    pub fn slice_polygons(&self) -> SlicePolygons {
        let proxy = Proxy {
            cells: &self.volume().macrocells,
            mesh: self.proxy_mesh.as_deref(),
            others: self
                .sliced_surfaces()
                .map(|object| object.cells.grid.occupied)
                .collect(),
        };
        let shift = if self.settings.jitter { 0.5 } else { 0.0 };
        SlicePolygons::of(&self.frame, &proxy, self.slices_per_slab(), shift)
    }

    /// Slices composited inside one fragment.
    pub fn slices_per_slab(&self) -> u32 {
        if self.sliced_surfaces().next().is_some() {
            1
        } else {
            self.settings.slab
        }
    }

    /// The first volume.
    #[inline(always)]
    pub fn volume(&self) -> &VolumeObject<'a> {
        &self.volumes[0]
    }

    /// Whether pixels end where they have become opaque: rays, and slices from front to back.
    pub fn ends_early(&self) -> bool {
        let in_order =
            self.settings.mode != Mode::Slice || self.settings.slice_order == SliceOrder::FrontToBack;
        self.settings.early_termination && in_order
    }

    /// Whether samples are composited, rather than projected.
    pub fn is_composite(&self) -> bool {
        self.volume().blend == Blend::Composite
    }

    /// Whether samples are lit.
    pub fn is_lit(&self) -> bool {
        self.settings.normals != Normals::None && self.volume().blend == Blend::Composite
    }

    /// Whether cut faces are painted with the scan's grey value.
    pub fn grey_faces(&self) -> bool {
        self.settings.cut_faces == CutFaces::Grey
            && self.volume().blend == Blend::Composite
            && (!self.cuts.is_empty() || !self.stack.is_empty())
    }

    /// Whether colour and opacity are those of segments between samples.
    pub fn preintegrated(&self) -> bool {
        self.settings.preintegrated && self.volume().blend == Blend::Composite && self.volume().iso.is_none()
    }

    /// Whether the gradient is needed before the opacity.
    pub fn uses_gradient_opacity(&self) -> bool {
        !self.volume().table.gradient.is_empty() && self.volume().blend == Blend::Composite
    }

    /// Distance from a cut beyond which it does not affect a sample, mm.
    pub fn cut_margin_mm(&self) -> f32 {
        // Rays meet slices at an angle: their step along a ray is longer than their distance.
        let slant = match self.settings.mode {
            Mode::Slice => self.frame.view.longest_slant(),
            _ => 1.0,
        };
        cut_margin_mm(self.frame.spacing.blend_mm, self.frame.spacing.step_mm, slant)
    }

    /// The same for the volume's faces, in voxels along each axis.
    pub fn face_margin_voxels(&self) -> Vec3 {
        let world_from_covector = glam::Mat3::from(self.volume().voxel_from_world.matrix3).transpose();
        Vec3::from([0, 1, 2].map(|a| self.cut_margin_mm() * (world_from_covector * Vec3::AXES[a]).length()))
    }

    /// The same under any deformation of the faces.
    pub fn deformed_face_margin_voxels(&self) -> Vec3 {
        self.face_margin_voxels() * self.stack.lipschitz_bound()
    }

    /// The gradients of all voxels for one more picture, if it uses them. They are computed for the
    /// second picture of a volume and cached, since a single picture is cheaper without them. The
    /// lighting is the same bit for bit.
    pub fn gradients_for_picture(&self) -> Option<&'a GradientVolume> {
        if !self.uses_gradients() {
            return None;
        }
        let sampled = self.volume().sampled;
        if sampled.count_picture() > 1 {
            sampled.make_gradients()
        } else {
            sampled.gradients()
        }
    }

    /// Computes the gradients of all voxels immediately, if pictures use them, rather than for the
    /// second picture.
    pub fn make_gradients(&self) {
        if self.uses_gradients() {
            self.volume().sampled.make_gradients();
        }
    }

    /// The gradients of all voxels, if they have been computed.
    pub fn gradients(&self) -> Option<&'a GradientVolume> {
        self.volume().sampled.gradients()
    }

    fn uses_gradients(&self) -> bool {
        (self.is_lit() || self.uses_gradient_opacity()) && self.gradient_filter() == GradientFilter::Central
    }

    /// The gradient filter.
    pub fn gradient_filter(&self) -> GradientFilter {
        self.settings.gradient
    }
}

/// The unit vector towards a light, world.
fn to_light(light: &Light, view: &ViewFrame) -> Vec3 {
    let d = Vec3::from(light.direction);
    let to_light = if light.follows_camera {
        normalize_or(view.right, Vec3::X) * d.x + normalize_or(view.up, Vec3::Z) * d.y - view.forward * d.z
    } else {
        d
    };
    normalize_or(to_light, -view.forward)
}
