//! The contents of a scene file as plain data. The command line overrides it, and tests build it
//! directly.
//!
//! A [`Scene`] names volumes, meshes and fields by path and never holds voxels, threads or devices.
//! [`crate::prepare`] resolves it for rendering.

mod antialias;
mod camera;
pub mod command;
pub mod example;
pub mod file;
mod keys;
pub mod kinds;
mod light;
mod limits;
pub mod measure;
mod migrate;
mod paths;
pub mod placement;
mod settings;
pub mod surface;

pub use antialias::Antialias;
pub use camera::{Camera, Projection, View, ViewFrame};
pub use light::{LIGHT_PRESETS, Light, LightPreset, LightQuality};
pub use placement::{DefaultPlacement, VisibleObject};

use crate::deform::{Arguments, Storage};
use crate::files::path_text::path_of;
use crate::transfer::{SuitablePreset, TransferSettings, suitable_preset};
use crate::volume::load::ReadOptions;
use crate::volume::{GradientFilter, Volume, phantom};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The version of the scene format.
pub const FORMAT_VERSION: u32 = 2;

/// A scene file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Version of the format: 2; a scene of version 1 is read with that version's defaults.
    pub incise: u32,
    /// The volume that is shown, if one is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub volume: Option<VolumeSource>,
    /// Surfaces that are shown, with the volume or without one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mesh: Vec<surface::MeshSource>,
    /// Appearance and sampling of surfaces.
    #[serde(default, skip_serializing_if = "is_default")]
    pub surface: surface::SurfaceSettings,
    /// Transfer function: colour and opacity.
    #[serde(default, skip_serializing_if = "is_default")]
    pub transfer: TransferSettings,
    /// Deformations, first applied first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub deformation: Vec<Deformation>,
    /// Measurements.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub measure: Vec<measure::Measure>,
    /// The camera.
    #[serde(default)]
    pub camera: Camera,
    /// Lighting.
    #[serde(default)]
    pub light: Light,
    /// Rendering settings.
    #[serde(default)]
    pub render: RenderSettings,
    /// Folder that relative paths start from.
    #[serde(skip)]
    pub folder: PathBuf,
}

fn is_default_slab(slab: &u32) -> bool {
    *slab == 1
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// The `[volume]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct VolumeSource {
    /// A file or folder, relative to the scene file, `phantom:NAME[:size=N][:sampling=function]`, or
    /// `function:EXPRESSION`, a function of x, y and z in millimetres.
    pub path: String,
    /// Which part of the file to load, and what the file does not state itself.
    #[serde(flatten)]
    pub choice: ReadOptions,
    /// A label map of the same patient, relative to the scene file; used to name and colour regions
    /// on slices.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub labels: Option<String>,
    /// A mesh; only the volume inside it is shown. If it has holes, its winding number decides what
    /// is inside.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inside: Option<InsideMesh>,
}

/// The `[volume.inside]` section: a closed mesh that holds the volume (\[RVD01\] section 2). It is
/// the scene's first cut.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InsideMesh {
    /// The mesh file, relative to the scene file.
    pub path: String,
    /// Placement of the mesh.
    #[serde(flatten)]
    pub place: surface::MeshPlace,
    /// Shows the volume outside of it instead.
    #[serde(default, skip_serializing_if = "is_default")]
    pub invert: bool,
    /// Forward deformers, in order; the volume moves with the mesh.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub deformer: Vec<surface::DeformerSource>,
}

/// One length for all axes, or one each.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Size {
    /// The same along x, y, z.
    Cube(f32),
    /// Along x, y, z.
    Box([f32; 3]),
}

impl Size {
    /// Extent along x, y, z.
    pub fn xyz(self) -> glam::Vec3 {
        match self {
            Self::Cube(s) => glam::Vec3::splat(s),
            Self::Box(s) => s.into(),
        }
    }
}

/// One `[[deformation]]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Deformation {
    /// Name of the kind: peel, pull, twist, ...
    pub kind: String,
    /// A user-defined name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Set to false to disable this deformation.
    #[serde(default = "yes", skip_serializing_if = "Clone::clone")]
    pub enabled: bool,
    /// Where its box lies if its centre or size is left out: on the visible surface, or in the
    /// middle of the volume.
    #[serde(default, skip_serializing_if = "is_default")]
    pub placement: DefaultPlacement,
    /// Centre of its box, mm; by default as `placement` says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub center: Option<[f32; 3]>,
    /// Size of its box, mm; by default as `placement` says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<Size>,
    /// Rotation about x, then y, then z, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotate: Option<[f32; 3]>,
    /// Instead of centre, size and rotation: rows of the affine transform from the unit cube to
    /// world mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub matrix: Option<[[f32; 4]; 3]>,
    /// Progress from none (0) to full (1, the default).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<f32>,
    /// Adds its displacement to that of the deformation before it, instead of being applied after
    /// it.
    #[serde(default, skip_serializing_if = "is_default")]
    pub add: bool,
    /// Texel format of the map; f16 by default, f32 for fields from files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub storage: Option<Storage>,
    /// Texels along the map's longest axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resolution: Option<usize>,
    /// The kind's own parameters and settings, by name.
    #[serde(flatten)]
    pub parameters: Arguments,
}

fn yes() -> bool {
    true
}

impl Deformation {
    /// A deformation of a kind with all its defaults.
    pub fn new(kind: impl Into<String>) -> Self {
        Self {
            kind: kind.into(),
            name: None,
            enabled: true,
            placement: DefaultPlacement::default(),
            center: None,
            size: None,
            rotate: None,
            matrix: None,
            progress: None,
            add: false,
            storage: None,
            resolution: None,
            parameters: Arguments::default(),
        }
    }
}

/// How the volume is sampled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The volume by view-aligned slices.
    Slice,
    /// The volume by rays, front to back.
    #[default]
    Raycast,
    /// Surfaces alone: by rays through distance fields, formulas and depth maps, or as triangles.
    Surface,
}

/// Which normals light the volume: the steps of \[DDM06\] figure 4.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Normals {
    /// Unshaded.
    None,
    /// Gradients of the undeformed volume, as they are.
    Source,
    /// Gradients transformed with the deformation.
    Transformed,
    /// Transformed gradients, blended into the cut's own normal near cuts.
    #[default]
    Blended,
}

/// How the faces of cuts look.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum CutFaces {
    /// Coloured by the transfer function and shaded.
    #[default]
    Lit,
    /// The scan's grey values by window and level, opaque and unshaded, as on a slice; black is
    /// left transparent.
    Grey,
}

/// How an iso-surface is lit (\[RVD01\] section 3.3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum IsoLight {
    /// By the gradient, transformed with the deformation.
    #[default]
    Gradient,
    /// By the directional derivative of the deformed volume towards the light: no gradient,
    /// Jacobian or highlight.
    Derivative,
}

/// The order in which slices are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SliceOrder {
    /// Each slice over those behind it (\[DDM06\] section 4).
    #[default]
    BackToFront,
    /// Each slice under those in front of it; pixels that have become opaque are left out.
    FrontToBack,
}

/// The number format in which slices are blended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum BlendFormat {
    /// 32 bits.
    #[default]
    Float32,
    /// 16 bits: half the memory traffic, but hundreds of thin slices add up their rounding.
    Float16,
}

/// How the Jacobian of a displacement map is found at a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum JacobianSource {
    /// By central differences of the map at the sample.
    #[default]
    Differences,
    /// From derivatives stored for each texel: fewer samples, four times the memory.
    Stored,
}

/// How a volume is interpolated between voxels where it is shaded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum VolumeFilter {
    /// Trilinear, with differences as gradients.
    Linear,
    /// Colours and normals by cubic B-splines with analytic gradients: smooth, at up to twice the
    /// cost. What is visible is found by trilinear samples. The boundaries of a label map are
    /// smoothed, and no colours are mixed between two labels.
    #[default]
    Cubic,
}

/// How displacement maps are interpolated between texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum MapFiltering {
    /// In the shader, with weights of 24 bits.
    Shader,
    /// By filtering hardware, whose weights have 8 bits; the CPU rounds its weights likewise.
    Hardware,
}

/// The `[render]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RenderSettings {
    /// Slices, rays or surfaces.
    pub mode: Mode,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Distance between samples in voxels (of the smallest spacing).
    pub step: f32,
    /// Antialiasing: "adaptive", or 1 to 4 samples along each edge of a pixel.
    pub antialias: Antialias,
    /// Background: red, green, blue, alpha in 0..1.
    pub background: [f32; 4],
    /// Which normals shade the volume.
    pub normals: Normals,
    /// How the volume is interpolated where it is shaded.
    pub filter: VolumeFilter,
    /// How gradients are estimated (filter "linear").
    pub gradient: GradientFilter,
    /// Empty-space skipping.
    pub empty_space_skipping: bool,
    /// Early ray termination.
    pub early_termination: bool,
    /// Evaluate cuts at the end of the stack exactly along each ray, instead of as masks.
    pub exact_cuts: bool,
    /// Appearance of cut faces.
    pub cut_faces: CutFaces,
    /// Show the iso-surface at this value (data units) instead of the volume: the first hit along
    /// each ray.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iso: Option<f64>,
    /// How the iso-surface is shaded.
    pub iso_light: IsoLight,
    /// Pre-integrated transfer function: colour and opacity come from the values at both ends of
    /// each step instead of one, so that thin features of the curve stay closed at longer steps.
    /// Unset: where the curve changes much within a step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preintegrated: Option<bool>,
    /// Jitter each pixel's samples along its ray by a fixed pseudo-random part of a step: banding
    /// becomes fine noise.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub jitter: bool,
    /// Slices composited inside one fragment before they are blended, 1 to 64 (mode "slice"). 1
    /// draws one polygon per slice.
    #[serde(skip_serializing_if = "is_default_slab")]
    pub slab: u32,
    /// The order in which slices are drawn (mode "slice").
    #[serde(skip_serializing_if = "is_default")]
    pub slice_order: SliceOrder,
    /// The number format in which slices are blended (mode "slice").
    #[serde(skip_serializing_if = "is_default")]
    pub blend_format: BlendFormat,
    /// How the Jacobians of displacement maps are found.
    pub jacobian: JacobianSource,
    /// How displacement maps are interpolated; by default with weights of at least 24 bits, by
    /// whichever way is faster on the device.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map_filter: Option<MapFiltering>,
    /// Replace all deformations by one precomputed map wherever its error is at most this, mm;
    /// elsewhere, for example along tears, every deformation is evaluated. Rendering time then
    /// hardly depends on their number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precompose: Option<f32>,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            mode: Mode::Raycast,
            size: [512, 512],
            step: 1.0,
            antialias: Antialias::Adaptive,
            background: [0.08, 0.085, 0.1, 1.0],
            normals: Normals::Blended,
            filter: VolumeFilter::Cubic,
            gradient: GradientFilter::Central,
            empty_space_skipping: true,
            early_termination: true,
            exact_cuts: true,
            cut_faces: CutFaces::Lit,
            iso: None,
            iso_light: IsoLight::Gradient,
            preintegrated: None,
            jitter: false,
            slab: 1,
            slice_order: SliceOrder::BackToFront,
            blend_format: BlendFormat::Float32,
            jacobian: JacobianSource::Differences,
            map_filter: None,
            precompose: None,
        }
    }
}

impl Scene {
    /// A scene that shows a volume with all defaults.
    pub fn of_volume(path: impl Into<String>) -> Self {
        Self {
            incise: FORMAT_VERSION,
            volume: Some(VolumeSource {
                path: path.into(),
                choice: ReadOptions::default(),
                labels: None,
                inside: None,
            }),
            mesh: Vec::new(),
            surface: surface::SurfaceSettings::default(),
            transfer: TransferSettings::default(),
            deformation: Vec::new(),
            measure: Vec::new(),
            camera: Camera::default(),
            light: Light::default(),
            render: RenderSettings::default(),
            folder: PathBuf::new(),
        }
    }

    /// A scene that shows a mesh with all defaults.
    pub fn of_mesh(path: impl Into<String>) -> Self {
        let mut scene = Self::of_volume("");
        scene.volume = None;
        scene.mesh.push(surface::MeshSource::of_file(path));
        scene.render.mode = Mode::Surface;
        scene
    }

    /// The volume's name in the scene; empty without a volume.
    pub fn volume_name(&self) -> &str {
        self.volume.as_ref().map_or("", |v| &v.path)
    }

    /// The preset used if the scene names none, and why: the phantom's own; grey if the scene has
    /// its own control points; else the one that suits the volume's values.
    pub fn suitable_preset(&self, volume: &Volume) -> SuitablePreset {
        let name = self.volume_name();
        if let Some(own) = name.strip_prefix("phantom:").and_then(phantom::preset) {
            return SuitablePreset {
                name: own,
                reason: "the phantom has a preset of its own".into(),
            };
        }
        if self.transfer.preset.is_none() && self.transfer.points.is_empty() {
            return suitable_preset(volume, name, self.transfer.relative_to);
        }
        SuitablePreset {
            name: "grey",
            reason: "the scene states its own curve or preset".into(),
        }
    }

    /// The name of [`Self::suitable_preset`].
    pub fn default_preset(&self, volume: &Volume) -> &'static str {
        self.suitable_preset(volume).name
    }

    /// The volume's path resolved against the scene's folder, if there is a volume.
    pub fn volume_path(&self) -> Option<PathBuf> {
        let path = &self.volume.as_ref()?.path;
        Some(if phantom::is_procedural(path) {
            PathBuf::from(path)
        } else {
            self.folder.join(path_of(path))
        })
    }
}
