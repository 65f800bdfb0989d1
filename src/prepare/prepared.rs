//! A scene resolved for rendering: the input of every backend.

use super::light_volume::LightVolume;
use super::objects::Surfaces;
use super::spacing::{SampleSpacing, cut_margin_mm};
use super::stack::Composition;
use super::tears::Tear;
use super::volume::VolumeObject;
use crate::deform::Stack;
use crate::deform::cut::CutShapes;
use crate::math::Bounds;
use crate::mesh::Mesh;
use crate::picture::StageTimes;
use crate::scene::{CutFaces, Light, Mode, Normals, RenderSettings, SliceOrder, ViewFrame, VolumeFilter};
use crate::transfer::Blend;
use crate::volume::{GradientFilter, GradientVolume};
use glam::Vec3;
use std::sync::Arc;

/// Share of the greatest optical depth below which a sample is thin.
const THIN_SHARE: f32 = 0.125;

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
    /// How much of it reaches each point; none if nothing casts shadows.
    pub light_volume: Option<Arc<LightVolume>>,
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
    /// The first volume.
    #[inline(always)]
    pub fn volume(&self) -> &VolumeObject<'a> {
        &self.volumes[0]
    }

    /// Whether pixels end where they have become opaque: rays, and slices from front to back.
    pub fn ends_early(&self) -> bool {
        let in_order = self.settings.mode != Mode::Slice || self.slice_order() == SliceOrder::FrontToBack;
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

    /// Whether surfaces are lit on the side that is seen: as stated, and always where light casts
    /// shadows, since light on the other side is not seen.
    pub fn is_lit_on_both_sides(&self) -> bool {
        self.light.two_sided || self.light_volume.is_some()
    }

    /// Whether cut faces are painted with the scan's grey value.
    pub fn grey_faces(&self) -> bool {
        self.settings.cut_faces == CutFaces::Grey
            && self.volume().blend == Blend::Composite
            && (!self.cuts.is_empty() || !self.stack.is_empty())
    }

    /// Whether colour and opacity are those of segments between samples.
    pub fn preintegrated(&self) -> bool {
        self.volume().preintegrated
    }

    /// A small part of the greatest optical depth that the volume shows anywhere: between samples
    /// that are thinner than this, at a cut, there may be a much denser layer.
    pub fn thin_depth(&self) -> f32 {
        THIN_SHARE * self.volume().table.max_depth(0.0, 1.0)
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

    /// Whether visible samples are interpolated by cubic splines.
    pub fn is_cubic(&self) -> bool {
        self.settings.filter == VolumeFilter::Cubic
            && self.volume().blend == Blend::Composite
            && self.volume().grid.function.is_none()
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
        (self.is_lit() || self.uses_gradient_opacity())
            && !self.is_cubic()
            && self.gradient_filter() == GradientFilter::Central
    }

    /// The gradient filter.
    pub fn gradient_filter(&self) -> GradientFilter {
        self.settings.gradient
    }
}
