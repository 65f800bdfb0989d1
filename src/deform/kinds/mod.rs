//! The kinds of deformation, one file for each or for a few with a common formula.
//!
//! A kind is a formula (some also read points, labels or files) in its own *local* space:
//! millimetres from the centre of its cube, along the cube's axes. From the resolved parameters it
//! makes a [`Field`]. This maps a deformed point to its source and its distance to the nearest cut,
//! and a source point to its deformed position. [`Kind::map`] samples the field into a
//! [`DisplacementMap`].
//!
//! *Contract* (tested by `tests/contract.rs` for every kind): progress 0 is the identity; Jacobians
//! agree with central differences; forward then backward is the identity; D vanishes on every face
//! that the kind does not list in `nonzero_faces`; D is continuous; unusual input gives finite
//! values.

mod bend;
mod book;
pub mod brush;
mod bulge;
mod elastic;
mod explode;
mod explode_labels;
mod feature;
mod knife;
mod lasso;
mod lattice;
mod modifiers;
mod outline;
mod peel;
mod points;
mod pull;
mod removal;
mod retractor;
mod seam;
mod settings;
mod slab;
mod spline_pull;
mod taper;
mod twist;
mod wave;

pub use super::field::{Backward, Field};
pub use modifiers::{COMMON_SETTINGS, fade_mm, vary_everywhere};
pub use settings::{Setting, SettingFormat};

use super::cut::CutShapeKind;
use super::mapping::Cylinder;
use super::{Argument, Arguments, DisplacementMap, Formula, FormulaKind, Library, MapDefinition, Storage};
use crate::error::suggestion;
use crate::math::Bounds;
use crate::{Error, Result};
use glam::{Affine3A, Vec3};

/// A parameter's unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Millimetres.
    Mm,
    /// Degrees.
    Degrees,
    /// A pure number.
    None,
}

/// A length that may depend on the size of the deformation's box.
#[derive(Clone, Copy, Debug)]
pub enum BoxLength {
    /// A length in mm, whatever the box.
    Fixed(f32),
    /// A fraction of the box along x.
    OfX(f32),
    /// A fraction of the box along y.
    OfY(f32),
    /// A fraction of the box along z.
    OfZ(f32),
    /// A fraction of the box's smaller extent across its z axis.
    OfRadius(f32),
}

impl std::fmt::Display for BoxLength {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Fixed(v) => write!(f, "{v}"),
            Self::OfX(s) => write!(f, "{s} × size along x"),
            Self::OfY(s) => write!(f, "{s} × size along y"),
            Self::OfZ(s) => write!(f, "{s} × size along z"),
            Self::OfRadius(s) => write!(f, "{s} × radius"),
        }
    }
}

impl BoxLength {
    /// The length for a box of the given extents, mm.
    pub fn resolve(self, size_mm: Vec3) -> f32 {
        match self {
            Self::Fixed(v) => v,
            Self::OfX(s) => s * size_mm.x,
            Self::OfY(s) => s * size_mm.y,
            Self::OfZ(s) => s * size_mm.z,
            Self::OfRadius(s) => s * size_mm.x.min(size_mm.y) / 2.0,
        }
    }
}

/// A named parameter.
pub struct Parameter {
    /// Name as typed.
    pub name: &'static str,
    /// Its unit.
    pub unit: Unit,
    /// Default value.
    pub default: BoxLength,
    /// Smallest allowed value.
    pub min: BoxLength,
    /// Largest allowed value.
    pub max: BoxLength,
    /// One line for lists.
    pub about: &'static str,
}

impl Parameter {
    /// A length, mm.
    const fn mm(
        name: &'static str,
        default: BoxLength,
        [min, max]: [BoxLength; 2],
        about: &'static str,
    ) -> Self {
        Self {
            name,
            unit: Unit::Mm,
            default,
            min,
            max,
            about,
        }
    }

    /// An angle, degrees.
    const fn degrees(name: &'static str, default: f32, [min, max]: [f32; 2], about: &'static str) -> Self {
        Self {
            name,
            unit: Unit::Degrees,
            default: BoxLength::Fixed(default),
            min: BoxLength::Fixed(min),
            max: BoxLength::Fixed(max),
            about,
        }
    }

    /// A pure number.
    const fn number(name: &'static str, default: f32, [min, max]: [f32; 2], about: &'static str) -> Self {
        Self {
            name,
            unit: Unit::None,
            default: BoxLength::Fixed(default),
            min: BoxLength::Fixed(min),
            max: BoxLength::Fixed(max),
            about,
        }
    }
}

/// Default size of the box.
#[derive(Clone, Copy, Debug)]
pub enum DefaultSize {
    /// Fractions of the scene's extent along the world's axes.
    Share([f32; 3]),
    /// A cube whose edge is this fraction of the scene's diagonal: for cuts that must span the
    /// scene at any angle.
    Across(f32),
}

/// A kind of deformation.
pub struct Kind {
    /// Name as typed.
    pub name: &'static str,
    /// One line for lists.
    pub about: &'static str,
    /// Its parameters, in the order of [`Kind::values`]; `build` reads them by name (removals: the
    /// first one).
    pub parameters: &'static [Parameter],
    /// Default size.
    pub size: DefaultSize,
    /// Ratio of the map's cube to the box that the user sizes; a cut along the box's faces must lie
    /// inside the map.
    pub cube_scale: f32,
    /// Local axes along which the map varies; the others need a single texel.
    pub varies: [bool; 3],
    /// Default number of texels along the longest axis.
    pub resolution: usize,
    /// Faces (-x, +x, -y, +y, -z, +z) on which D does not vanish: there the box should end in empty
    /// space.
    pub nonzero_faces: [bool; 6],
    /// The box turns with the camera: x right, y up, z towards the viewer.
    pub locked_to_view: bool,
    /// The shape it removes, if the kind only removes and the shape is analytic.
    pub shape: Option<CutShapeKind>,
    /// The builder of its field.
    pub build: FieldBuilder,
}

/// How a kind's field is built.
#[derive(Clone, Copy)]
pub enum FieldBuilder {
    /// A formula of the kind's numbers.
    Formula(fn(&FieldContext) -> Box<dyn Field>),
    /// A builder that also needs non-numeric settings: files, points, labels.
    Sourced {
        /// The settings.
        settings: &'static [Setting],
        /// Settings that demonstrate the kind in a box with the given bounds (mm, world).
        example: fn(&Bounds) -> Vec<(&'static str, Argument)>,
        /// Builds the field.
        build: fn(&FieldContext, &FieldInputs) -> Result<Box<dyn Field>>,
    },
}

/// The input of a kind's builder.
pub struct FieldContext<'a> {
    parameters: &'static [Parameter],
    values: &'a [f32],
    /// 0 to 1.
    pub progress: f32,
    /// Extent of the box, mm.
    pub size_mm: Vec3,
    /// Ratio of the map's cube to the box.
    pub cube_scale: f32,
    /// Texels of the map along the axes; one where it does not vary.
    pub grid: [usize; 3],
    /// Largest texel edge along the axes that vary, mm.
    pub texel_mm: f32,
    /// Half width of the mask's ramp, mm.
    pub ramp_mm: f32,
}

/// Additional input of sourced kinds.
pub struct FieldInputs<'a> {
    /// The given settings.
    pub settings: &'a Arguments,
    /// From the box's local millimetres to world millimetres.
    pub world_from_local: Affine3A,
    /// The cylinder that the map is wrapped around, if it is.
    pub cylinder: Option<RoundMap>,
    /// Files and volumes.
    pub library: &'a Library,
}

/// A map wrapped around an axis of its box in the world.
#[derive(Clone, Copy, Debug)]
pub struct RoundMap {
    /// The cylinder.
    pub cylinder: Cylinder,
    /// From the unit cube to world millimetres.
    pub world_from_cube: Affine3A,
}

impl RoundMap {
    /// World millimetres of map coordinates.
    fn world_from_map(&self, u: Vec3) -> Vec3 {
        self.world_from_cube
            .transform_point3(self.cylinder.cube_from_map(u))
    }
}

impl FieldContext<'_> {
    /// The value of one of the kind's parameters; NaN if it has none of that name.
    fn value(&self, name: &str) -> f32 {
        self.parameters
            .iter()
            .zip(self.values)
            .find(|(p, _)| p.name == name)
            .map_or(f32::NAN, |(_, v)| *v)
    }

    fn half(&self) -> Vec3 {
        self.size_mm / 2.0
    }

    fn gaps(&self) -> GapResolution {
        GapResolution {
            ramp_mm: self.ramp_mm,
            texel_mm: self.texel_mm,
        }
    }
}

/// Gaps that the map can resolve: one that narrows below a texel closes, and a closed gap is far
/// from any cut.
#[derive(Clone, Copy)]
struct GapResolution {
    ramp_mm: f32,
    texel_mm: f32,
}

impl GapResolution {
    /// Signed distance to a gap, mm, from the signed distance to its wall and its half width.
    fn distance(&self, to_wall: f32, half_width: f32) -> f32 {
        to_wall + 2.0 * self.ramp_mm * (1.0 - half_width / self.texel_mm).clamp(0.0, 1.0)
    }
}

/// Distance where there is no cut.
const NO_CUT_DISTANCE_MM: f32 = 1e6;

/// Settings of analytic removals.
pub const CUT_SETTINGS: &[Setting] = &[
    Setting {
        name: "invert",
        form: SettingFormat::Flag,
        about: "true removes what is outside instead",
    },
    Setting {
        name: "group",
        form: SettingFormat::Words,
        about: "name of a group; cuts in a group are combined",
    },
    Setting {
        name: "combine",
        form: SettingFormat::Choice(&["or", "and"]),
        about: "or: removes what any cut of the group removes; and: only what all of them remove",
    },
];

const KINDS: &[&Kind] = &[
    &pull::KIND,
    &spline_pull::KIND,
    &wave::RADIAL,
    &wave::PLANAR,
    &twist::KIND,
    &bend::KIND,
    &taper::TAPER,
    &taper::SHEAR,
    &bulge::KIND,
    &peel::KIND,
    &slab::KIND,
    &explode::KIND,
    &seam::KIND,
    &book::KIND,
    &knife::KIND,
    &retractor::KIND,
    &removal::BOX,
    &removal::SPHERE,
    &removal::CYLINDER,
    &removal::WEDGE,
    &removal::HALF_SPACE,
    &removal::VIEW_SPHERE,
    &removal::VIEW_CONE,
    &lasso::KIND,
    &lattice::KIND,
    &points::KIND,
    &elastic::KIND,
    &feature::STRIP,
    &feature::LIFT,
    &feature::OFFSET,
    &feature::PEEL,
    &explode_labels::KIND,
    &brush::KIND,
];

/// All kinds.
pub fn list() -> impl Iterator<Item = &'static Kind> {
    KINDS.iter().copied()
}

/// The kind with a given name.
///
/// # Errors
/// An unknown name (the message names the closest known one).
pub fn kind(name: &str) -> Result<&'static Kind> {
    list().find(|k| k.name == name).ok_or_else(|| {
        Error::value(
            format!("deformation \"{name}\""),
            format!(
                "there is no such kind; {}",
                suggestion(name, list().map(|k| k.name))
            ),
        )
    })
}

/// Resolution and format of a map.
#[derive(Clone, Copy, Debug)]
pub struct Sampling {
    /// Texels along the longest axis; the kind's default if none.
    pub resolution: Option<usize>,
    /// Texel format.
    pub storage: Storage,
    /// Minimum half width of the mask's ramp, mm: a few voxels, so that shading has room to blend.
    pub min_ramp_mm: f32,
}

impl Kind {
    /// Whether the map depends only on its numbers and its size, not on the position of the box or
    /// the content there.
    pub fn is_the_same_anywhere(&self, settings: &Arguments) -> bool {
        matches!(self.build, FieldBuilder::Formula(_)) && !settings.0.contains_key("spare")
    }

    /// The default size of the box in a scene with the given bounds, mm.
    pub fn default_size(&self, scene: &Bounds) -> Vec3 {
        match self.size {
            DefaultSize::Share(s) => scene.size() * Vec3::from(s),
            DefaultSize::Across(s) => Vec3::splat(scene.size().length() * s),
        }
    }

    /// Fills in defaults and checks ranges of parameters given by name.
    ///
    /// # Errors
    /// A parameter that the kind does not have (the message names the closest one), or a value
    /// outside its range.
    pub fn values<'a>(
        &self,
        given: impl IntoIterator<Item = (&'a str, f32)>,
        size_mm: Vec3,
    ) -> Result<Vec<f32>> {
        let mut values: Vec<f32> = self
            .parameters
            .iter()
            .map(|p| p.default.resolve(size_mm))
            .collect();
        for (name, value) in given {
            let Some(n) = self.parameters.iter().position(|p| p.name == name) else {
                let common = [
                    "placement",
                    "center",
                    "size",
                    "rotate",
                    "progress",
                    "storage",
                    "resolution",
                ];
                let valid_names = self
                    .parameters
                    .iter()
                    .map(|p| p.name)
                    .chain(self.settings().map(|s| s.name))
                    .chain(common);
                return Err(Error::value(
                    format!("{}: {name}", self.name),
                    format!("there is no such parameter; {}", suggestion(name, valid_names)),
                ));
            };
            let p = &self.parameters[n];
            let (min, max) = (p.min.resolve(size_mm), p.max.resolve(size_mm));
            // A fraction of a size rounds; the end of the range itself is allowed.
            let slack = 1e-5 * (max - min);
            if !(min - slack..=max + slack).contains(&value) {
                let unit = match p.unit {
                    Unit::Mm => " mm",
                    Unit::Degrees => " degrees",
                    Unit::None => "",
                };
                return Err(Error::value(
                    format!("{}: {name}", self.name),
                    format!("{value} is outside {min} to {max}{unit}"),
                ));
            }
            values[n] = value;
        }
        Ok(values)
    }

    /// The texels of the map's cube for a box of the given size.
    fn grid(&self, size_mm: Vec3, resolution: Option<usize>) -> [usize; 3] {
        let longest = (0..3)
            .filter(|&a| self.varies[a])
            .map(|a| size_mm[a])
            .fold(0.0, f32::max);
        let texels = resolution.unwrap_or(self.resolution) as f32;
        std::array::from_fn(|a| {
            if self.varies[a] {
                ((texels * size_mm[a] / longest).round() as usize).clamp(8, 512)
            } else {
                1
            }
        })
    }

    /// Grid and context for sampling the kind with these values.
    fn context<'a>(
        &self,
        values: &'a [f32],
        progress: f32,
        size_mm: Vec3,
        sampling: &Sampling,
    ) -> ([usize; 3], FieldContext<'a>) {
        let grid = self.grid(size_mm, sampling.resolution);
        let cube_mm = size_mm * self.cube_scale;
        let texel_mm = (0..3)
            .filter(|&a| grid[a] > 1)
            .map(|a| cube_mm[a] / (grid[a] - 1) as f32)
            .fold(0.0, f32::max);
        let ramp_mm = sampling.min_ramp_mm.max(2.0 * texel_mm);
        (
            grid,
            FieldContext {
                parameters: self.parameters,
                values,
                progress,
                size_mm,
                cube_scale: self.cube_scale,
                grid,
                texel_mm,
                ramp_mm,
            },
        )
    }

    /// The field itself, for tests and tools that need the formula rather than its samples.
    ///
    /// # Errors
    /// An invalid setting, or a file that cannot be read.
    pub fn field(
        &self,
        values: &[f32],
        progress: f32,
        size_mm: Vec3,
        sampling: &Sampling,
        inputs: &FieldInputs,
    ) -> Result<Box<dyn Field>> {
        let (_, context) = self.context(values, progress, size_mm, sampling);
        self.modified(&context, inputs)
    }

    /// The kind's field with the modifiers requested by the settings.
    fn modified(&self, context: &FieldContext, inputs: &FieldInputs) -> Result<Box<dyn Field>> {
        let field = match &self.build {
            FieldBuilder::Formula(build) => build(context),
            FieldBuilder::Sourced { build, .. } => build(context, inputs)?,
        };
        modifiers::apply(field, context, inputs)
    }

    /// Samples the kind into a map over a cube `cube_scale` times the box.
    ///
    /// `values` are those returned by [`Self::values`].
    ///
    /// # Errors
    /// As [`Self::field`].
    pub fn map(
        &self,
        values: &[f32],
        progress: f32,
        size_mm: Vec3,
        sampling: &Sampling,
        inputs: &FieldInputs,
    ) -> Result<DisplacementMap> {
        Ok(DisplacementMap::of(
            &self.definition(values, progress, size_mm, sampling, inputs)?,
        ))
    }

    /// The definition that [`Self::map`] samples.
    ///
    /// # Errors
    /// As [`Self::field`].
    pub fn definition(
        &self,
        values: &[f32],
        progress: f32,
        size_mm: Vec3,
        sampling: &Sampling,
        inputs: &FieldInputs,
    ) -> Result<MapDefinition> {
        let (mut grid, mut context) = self.context(values, progress, size_mm, sampling);
        if modifiers::vary_everywhere(inputs.settings) && self.varies != [true; 3] {
            // Round cuts and spared labels vary along all axes, whatever the kind is.
            let all = Kind {
                varies: [true; 3],
                resolution: self.resolution.min(128),
                ..*self
            };
            (grid, context) = all.context(values, progress, size_mm, sampling);
        }
        let field = self.modified(&context, inputs)?;
        Ok(MapDefinition {
            size: grid,
            storage: sampling.storage,
            cube_mm: size_mm * self.cube_scale,
            ramp_mm: context.ramp_mm,
            field,
        })
    }

    /// The kind's own non-numeric settings.
    pub fn own_settings(&self) -> &'static [Setting] {
        match self.build {
            FieldBuilder::Formula(_) => &[],
            FieldBuilder::Sourced { settings, .. } => settings,
        }
    }

    /// All non-numeric settings: the kind's own and those common to every kind.
    pub fn settings(&self) -> impl Iterator<Item = &'static Setting> {
        let of_cuts: &[Setting] = if self.shape.is_some() { CUT_SETTINGS } else { &[] };
        self.own_settings().iter().chain(of_cuts).chain(COMMON_SETTINGS)
    }

    /// Settings that demonstrate the kind in a box with the given bounds (mm, world).
    pub fn example(&self, bounds: &Bounds) -> Arguments {
        let mut arguments = Arguments::default();
        if let FieldBuilder::Sourced { example, .. } = self.build {
            for (name, value) in example(bounds) {
                arguments.insert(name, value);
            }
        }
        arguments
    }

    /// Separates numbers from settings, fills in defaults and checks ranges.
    ///
    /// # Errors
    /// A name that the kind does not have (the message names the closest one), or a value outside
    /// its range.
    pub fn resolve(&self, arguments: &Arguments, size_mm: Vec3) -> Result<(Vec<f32>, Arguments)> {
        let mut settings = Arguments::default();
        let mut numbers = Vec::new();
        for (name, value) in &arguments.0 {
            if self.settings().any(|s| s.name == name) {
                settings.insert(name.clone(), value.clone());
            } else if let Argument::Number(v) = value {
                numbers.push((name.as_str(), *v));
            } else if self.parameters.iter().any(|p| p.name == name) {
                return Err(Error::value(
                    format!("{}: {name}", self.name),
                    "must be a single number",
                ));
            } else {
                // Rejected below, with the closest name.
                numbers.push((name.as_str(), 0.0));
            }
        }
        Ok((self.values(numbers, size_mm)?, settings))
    }
}

/// The shape that a kind removes, its lengths (mm) and half its angle (radians); none if it is not
/// analytic, or at progress 0.
pub fn shape_of(
    kind: &Kind,
    values: &[f32],
    progress: f32,
    size_mm: Vec3,
) -> Option<(CutShapeKind, Vec3, f32)> {
    let shape = kind.shape.filter(|_| progress > 0.0)?;
    let (half, half_angle) = removal::shape_of(shape, values, progress, size_mm);
    Some((shape, half, half_angle))
}

/// The deformed position of a source point, by inverting the backward map; none where the inversion
/// fails or the point is cut away.
fn forward_numerically(field: &dyn Field, q: Vec3) -> Option<Vec3> {
    let backward = |p: glam::DVec3| field.backward(p.as_vec3()).source.as_dvec3();
    let y = q.as_dvec3();
    let s = super::invert::point(&backward, y, y + (y - backward(y)), 0.05, 5e-4);
    (s.found && field.backward(s.source.as_vec3()).cut_distance_mm >= 0.0).then(|| s.source.as_vec3())
}

/// A smooth window that is 1 in the middle and 0 at ±`half`, falling over the outer fraction
/// `share`.
fn window(x: f32, half: f32, share: f32) -> f32 {
    crate::math::smoothstep(0.0, share, 1.0 - x.abs() / half)
}

/// Solves `g(x) = target` for an increasing function on `[low, high]` by bisection, to single
/// precision.
fn solve_rising(target: f32, low: f32, high: f32, g: impl Fn(f32) -> f32) -> f32 {
    let (mut low, mut high) = (low, high);
    for _ in 0..48 {
        let middle = 0.5 * (low + high);
        if g(middle) < target {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}
