//! The `[[mesh]]` and `[surface]` sections: surfaces and their appearance.

use super::Size;
use crate::error::suggestion;
use crate::mesh::deformer::NormalMethod;
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Interior of a surface where it is cut (\[DS07\] section 5.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum CutModel {
    /// Empty: a thin shell whose inside is visible.
    Hollow,
    /// Filled: cuts expose a face.
    #[default]
    Solid,
    /// A shell of finite thickness, empty inside.
    Thick,
}

/// Step length along a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Steps {
    /// Always the same.
    Uniform,
    /// Finer near the surface (Hadwiger et al. 2005).
    Threshold,
    /// Uniform in the undeformed scene: scaled by the Jacobian at each sample (\[DS07\] eq 4).
    Jacobian,
    /// As `jacobian`, but scaled by a bound on the Jacobian between samples, so that no narrow part
    /// is missed.
    JacobianBound,
    /// Sphere tracing: as far as the distance field and the deformation's Lipschitz bound allow
    /// (Hart 1996, in deformed space).
    #[default]
    Sphere,
}

/// How a `[[mesh]]` is represented.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Representation {
    /// A signed distance field.
    Field,
    /// One depth map, from `face`.
    DepthMap,
    /// Six depth maps.
    DepthMapCube,
    /// Triangles as they are: moved by deformers, never cut.
    Triangles,
}

/// Appearance of a surface; unset values come from the look, the `[surface]` section, or the
/// defaults.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Appearance {
    /// A preset by name: clay, skin, bone, apple, marble, jade, gold, muscle, porcelain.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub look: Option<String>,
    /// Colour of the outside, red, green, blue in 0..1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<[f32; 3]>,
    /// Colour of the inside of a hollow or thick surface.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inside_color: Option<[f32; 3]>,
    /// Colour of the faces of cuts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cut_color: Option<[f32; 3]>,
    /// Interior where the surface is cut.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<CutModel>,
    /// Thickness of a thick surface, mm; a fortieth of its size by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thickness: Option<f32>,
}

/// The `[surface]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct SurfaceSettings {
    /// Iso-value shown by the mode "surface" if the scene has no mesh; chosen from the histogram by
    /// default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iso: Option<f64>,
    /// Default appearance of surfaces.
    #[serde(flatten)]
    pub appearance: Appearance,
    /// How rays step.
    pub steps: Steps,
    /// Distance from the surface, in cells, within which threshold steps are finer.
    pub threshold: f32,
    /// Skip space emptied by cuts.
    pub cut_skipping: bool,
    /// Rasterise triangles outside all deformation boxes and cast rays only through the boxes
    /// (\[DS07\] section 3).
    pub two_stage: bool,
    /// Width of the seam in which the two are blended, cells.
    pub seam: f32,
    /// Points of a distance field along its longest axis.
    pub resolution: usize,
}

impl Default for SurfaceSettings {
    fn default() -> Self {
        Self {
            iso: None,
            appearance: Appearance::default(),
            steps: Steps::Sphere,
            threshold: 2.0,
            cut_skipping: true,
            two_stage: false,
            seam: 2.0,
            resolution: 128,
        }
    }
}

/// One solid of a `shape`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ShapeSource {
    /// sphere, box, torus, cylinder or gyroid.
    pub kind: String,
    /// union, intersect or subtract.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub join: Option<String>,
    /// Centre, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub center: Option<[f32; 3]>,
    /// Turn about x, then y, then z, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotate: Option<[f32; 3]>,
    /// Edge lengths of a box, or of the box that a gyroid fills, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<Size>,
    /// Radius of a sphere or cylinder, or major radius of a torus, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius: Option<f32>,
    /// Minor radius of a torus, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tube: Option<f32>,
    /// Length of a cylinder, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length: Option<f32>,
    /// Period of a gyroid, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub period: Option<f32>,
    /// Thickness of a gyroid's wall, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall: Option<f32>,
}

/// One `[[mesh.deformer]]`: a forward deformer (\[GG42\]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DeformerSource {
    /// twist, bend, taper, shear, bulge, wave or lattice.
    pub kind: String,
    /// Centre of its box, mm; the mesh's by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub center: Option<[f32; 3]>,
    /// Extent of its box, mm; the mesh's by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<Size>,
    /// Rotation about x, then y, then z, degrees; the deformer's axis is z.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotate: Option<[f32; 3]>,
    /// Progress from none (0) to full (1).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<f32>,
    /// Offsets of a lattice's control points: index along x, y, z (0 to 3), then the offset in mm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<[f32; 6]>,
    /// Its numbers: angle (twist, bend; degrees over the box), factor (taper), amount (shear,
    /// bulge), width (bulge, mm), amplitude (wave, mm), length (wave, mm), phase (wave, degrees).
    #[serde(flatten)]
    pub numbers: BTreeMap<String, f32>,
}

/// Placement of a mesh from a file, for `[[mesh]]` and `[volume.inside]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MeshPlace {
    /// Centre of the mesh, mm; unchanged by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub center: Option<[f32; 3]>,
    /// Longest edge of its bounding box, mm; unchanged by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<f32>,
    /// Turn about x, then y, then z, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotate: Option<[f32; 3]>,
    /// Instead of centre, size and rotation: rows of the affine transform from the file's
    /// coordinates to world mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub matrix: Option<[[f32; 4]; 3]>,
}

/// One `[[mesh]]`: from a file, a value or label of a volume, or formulas.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MeshSource {
    /// A mesh file, relative to the scene file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<String>,
    /// Instead of a file: the iso-surface of a volume at this value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iso: Option<f64>,
    /// Instead of a file: the surface of these labels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub label: Vec<usize>,
    /// The volume of the value or labels; the scene's by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub volume: Option<String>,
    /// Instead of a file: implicit solids, combined in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shape: Vec<ShapeSource>,
    /// A user-defined name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Set to true to hide this surface.
    #[serde(default, skip_serializing_if = "super::is_default")]
    pub hidden: bool,
    /// Placement.
    #[serde(flatten)]
    pub place: MeshPlace,
    /// What it becomes: a field by default, triangles if it has deformers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub representation: Option<Representation>,
    /// Face of its box that a depth map lies on: -x, +x, -y, +y, -z or +z.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub face: Option<String>,
    /// Points of its field along the longest axis, or of a depth map along each edge.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resolution: Option<usize>,
    /// Compute exact distances everywhere, not only in the narrow band.
    #[serde(default, skip_serializing_if = "super::is_default")]
    pub exact: bool,
    /// Appearance.
    #[serde(flatten)]
    pub appearance: Appearance,
    /// Set to true to exclude it from the scene's deformations.
    #[serde(default, skip_serializing_if = "super::is_default")]
    pub rigid: bool,
    /// Forward deformers, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub deformer: Vec<DeformerSource>,
    /// How deformers transform normals.
    #[serde(default, skip_serializing_if = "super::is_default")]
    pub normals: NormalMethod,
    /// Tessellation tolerance: subdivide triangles that deformers bend by more than this, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tessellate: Option<f32>,
}

/// Names of the looks.
pub fn look_names() -> impl Iterator<Item = &'static str> {
    LOOKS.iter().map(|l| l.0)
}

/// A resolved appearance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Colour of the outside.
    pub color: [f32; 3],
    /// Colour of the inside.
    pub inside: [f32; 3],
    /// Colour of the faces of cuts.
    pub cut: [f32; 3],
    /// Strength and exponent of the specular highlight.
    pub highlight: [f32; 2],
    /// Interior where the surface is cut.
    pub model: CutModel,
    /// Thickness, mm, of a thick surface.
    pub thickness: Option<f32>,
}

/// The forward deformers: name, effect, parameters.
pub const DEFORMERS: [(&str, &str, &str); 7] = [
    ("twist", "turns about z over the box's height", "angle (degrees)"),
    (
        "bend",
        "bends z towards x over the box's height",
        "angle (degrees)",
    ),
    ("taper", "scales x and y towards the upper end", "factor"),
    ("shear", "shifts x in proportion to z", "amount (mm per mm)"),
    ("bulge", "swells x and y around the middle", "amount, width (mm)"),
    (
        "wave",
        "circular waves around z",
        "amplitude (mm), length (mm), phase (degrees)",
    ),
    (
        "lattice",
        "free-form deformation by 4x4x4 control points",
        "points = [[i, j, k, x, y, z], ...] (mm)",
    ),
];

/// Name, description, and the look.
type LookPreset = (&'static str, &'static str, Look);

const fn look(
    color: [f32; 3],
    inside: [f32; 3],
    cut: [f32; 3],
    highlight: [f32; 2],
    model: CutModel,
) -> Look {
    Look {
        color,
        inside,
        cut,
        highlight,
        model,
        thickness: None,
    }
}

/// The presets.
pub const LOOKS: [LookPreset; 9] = [
    (
        "clay",
        "matt grey-brown, solid",
        look(
            [0.78, 0.70, 0.62],
            [0.55, 0.42, 0.36],
            [0.72, 0.45, 0.35],
            [0.10, 16.0],
            CutModel::Solid,
        ),
    ),
    (
        "skin",
        "skin over red muscle, thick",
        look(
            [0.87, 0.68, 0.57],
            [0.62, 0.25, 0.22],
            [0.75, 0.27, 0.25],
            [0.18, 24.0],
            CutModel::Thick,
        ),
    ),
    (
        "bone",
        "ivory, spongy inside, solid",
        look(
            [0.93, 0.89, 0.78],
            [0.72, 0.58, 0.46],
            [0.84, 0.68, 0.53],
            [0.20, 32.0],
            CutModel::Solid,
        ),
    ),
    (
        "apple",
        "red with pale flesh, solid",
        look(
            [0.78, 0.12, 0.10],
            [0.93, 0.87, 0.64],
            [0.95, 0.91, 0.72],
            [0.35, 40.0],
            CutModel::Solid,
        ),
    ),
    (
        "marble",
        "white, solid",
        look(
            [0.92, 0.92, 0.94],
            [0.60, 0.62, 0.68],
            [0.78, 0.80, 0.86],
            [0.40, 60.0],
            CutModel::Solid,
        ),
    ),
    (
        "jade",
        "green, hollow",
        look(
            [0.35, 0.68, 0.48],
            [0.80, 0.78, 0.50],
            [0.55, 0.80, 0.60],
            [0.35, 40.0],
            CutModel::Hollow,
        ),
    ),
    (
        "gold",
        "metal, hollow, dark inside",
        look(
            [0.90, 0.70, 0.28],
            [0.42, 0.28, 0.14],
            [0.98, 0.84, 0.48],
            [0.60, 50.0],
            CutModel::Hollow,
        ),
    ),
    (
        "muscle",
        "dark red, solid",
        look(
            [0.66, 0.24, 0.21],
            [0.45, 0.12, 0.12],
            [0.80, 0.38, 0.34],
            [0.25, 28.0],
            CutModel::Solid,
        ),
    ),
    (
        "porcelain",
        "blue-white, thick",
        look(
            [0.82, 0.88, 0.96],
            [0.93, 0.90, 0.82],
            [0.62, 0.70, 0.82],
            [0.55, 70.0],
            CutModel::Thick,
        ),
    ),
];

impl Appearance {
    /// The resolved look. A value comes from this appearance, else from `general`, else from the
    /// preset that either names.
    ///
    /// # Errors
    /// A preset that does not exist, a colour outside 0..1, a thickness that is not positive.
    pub fn resolve(&self, general: &Self) -> Result<Look> {
        let name = self.look.as_deref().or(general.look.as_deref()).unwrap_or("clay");
        let preset = LOOKS.iter().find(|l| l.0 == name);
        let mut look = preset
            .ok_or_else(|| {
                Error::value(
                    format!("look \"{name}\""),
                    format!(
                        "there is no such look; {}",
                        suggestion(name, LOOKS.iter().map(|l| l.0))
                    ),
                )
            })?
            .2;
        // A preset of this surface takes precedence over a general colour.
        let own = self.look.is_some();
        let pick = |mine: Option<[f32; 3]>, all: Option<[f32; 3]>| mine.or(if own { None } else { all });
        for (name, value, target) in [
            ("color", pick(self.color, general.color), &mut look.color),
            (
                "inside_color",
                pick(self.inside_color, general.inside_color),
                &mut look.inside,
            ),
            (
                "cut_color",
                pick(self.cut_color, general.cut_color),
                &mut look.cut,
            ),
        ] {
            if let Some(c) = value {
                if !c.iter().all(|v| (0.0..=1.0).contains(v)) {
                    return Err(Error::value(name, "its components must lie within 0..1"));
                }
                *target = c;
            }
        }
        look.model = self
            .model
            .or(if own { None } else { general.model })
            .unwrap_or(look.model);
        look.thickness = self.thickness.or(general.thickness);
        if look.thickness.is_some_and(|t| !(t.is_finite() && t > 0.0)) {
            return Err(Error::value(
                "thickness",
                "must be a positive number of millimetres",
            ));
        }
        Ok(look)
    }
}

impl MeshSource {
    /// A mesh file with all defaults.
    pub fn of_file(path: impl Into<String>) -> Self {
        Self {
            path: Some(path.into()),
            ..Self::default()
        }
    }

    /// A name for messages.
    pub(crate) fn label(&self, n: usize) -> String {
        self.name
            .clone()
            .or_else(|| self.path.clone())
            .unwrap_or_else(|| format!("mesh {}", n + 1))
    }

    pub(crate) fn representation(&self) -> Representation {
        self.representation.unwrap_or(if self.deformer.is_empty() {
            Representation::Field
        } else {
            Representation::Triangles
        })
    }

    /// Key of everything that determines the mesh after its deformers.
    pub(crate) fn mesh_key(&self) -> String {
        format!(
            "{:?} {:?} {:?} {:?}",
            self.path, self.place, self.deformer, self.tessellate
        )
    }

    pub(crate) fn check(&self) -> Result<()> {
        let sources = usize::from(self.path.is_some())
            + usize::from(self.iso.is_some())
            + usize::from(!self.label.is_empty())
            + usize::from(!self.shape.is_empty());
        if sources != 1 {
            return Err(Error::value(
                "path, iso, label, shape",
                "give exactly one of these for a mesh",
            ));
        }
        if self.path.is_none() {
            let only_files = [
                ("center, size, rotate, matrix", self.place != MeshPlace::default()),
                ("deformer", !self.deformer.is_empty()),
                (
                    "representation",
                    !matches!(self.representation, None | Some(Representation::Field)),
                ),
                ("tessellate", self.tessellate.is_some()),
                ("resolution", self.resolution.is_some()),
                ("exact", self.exact),
                ("face", self.face.is_some()),
                ("normals", self.normals != NormalMethod::default()),
            ];
            if let Some((name, _)) = only_files.iter().find(|f| f.1) {
                return Err(Error::value(*name, "is of meshes from files only; leave it out"));
            }
        }
        if self.path.is_some() && self.volume.is_some() {
            return Err(Error::value(
                "volume",
                "applies only to meshes from an iso-value or labels; leave it out",
            ));
        }
        if self.resolution.is_some_and(|n| !(16..=1024).contains(&n)) {
            return Err(Error::value("resolution", "is outside 16 to 1024 points"));
        }
        if self.tessellate.is_some_and(|t| !(t.is_finite() && t > 0.0)) {
            return Err(Error::value(
                "tessellate",
                "must be a positive number of millimetres",
            ));
        }
        Ok(())
    }
}

impl SurfaceSettings {
    /// Checks the settings of all surfaces.
    ///
    /// # Errors
    /// The first invalid setting, by name.
    pub(crate) fn check(&self) -> Result<()> {
        self.appearance
            .resolve(&Appearance::default())
            .map_err(|e| e.within("surface"))?;
        if !(self.threshold.is_finite() && self.threshold >= 0.0) {
            return Err(Error::value(
                "surface.threshold",
                "is a number of cells; it must not be negative",
            ));
        }
        if !(self.seam.is_finite() && self.seam > 0.0) {
            return Err(Error::value(
                "surface.seam",
                "is a number of cells; it must be positive",
            ));
        }
        if !(16..=1024).contains(&self.resolution) {
            return Err(Error::value(
                "surface.resolution",
                format!("{} is outside 16 to 1024 points", self.resolution),
            ));
        }
        Ok(())
    }
}
