//! The numbers of Rust enums as WGSL constants, generated from the enums themselves.

use crate::deform::FormulaKind;
use crate::deform::cut::CutShapeKind;
use crate::mesh::deformer::NormalMethod;
use crate::mesh::formula::CsgOperation;
use crate::scene::surface::Steps;
use crate::scene::{IsoLight, Normals, VolumeFilter};
use crate::transfer::Blend;
use crate::volume::{Colors, GradientFilter};
use std::sync::LazyLock;

macro_rules! constants {
    ($($prefix:literal $kind:ident { $($variant:ident),* $(,)? })*) => {
        &[$($((concat!($prefix, "_"), stringify!($variant), $kind::$variant as u32)),*),*]
    };
}

/// The variants of enums: prefix, name in Rust, number.
const VARIANTS: &[(&str, &str, u32)] = constants! {
    "NORMALS" Normals { None, Source, Transformed, Blended }
    "BLEND" Blend { Composite, Mip, Minip, Average }
    "FILTER" VolumeFilter { Linear, Cubic }
    "GRADIENT" GradientFilter { Central, Sobel }
    "SHAPE" CutShapeKind { HalfSpace, Box, Ellipsoid, Cylinder, Wedge, Cone }
    "FORMULA" FormulaKind {
        Pull, SplinePull, Wave, Twist, Bend, Taper, Shear, Bulge, Peel, Slab, Explode, Seam, Book, Knife, Retractor, Removal,
    }
    "STEPS" Steps { Uniform, Threshold, Jacobian, JacobianBound, Sphere }
    "JOIN" CsgOperation { Union, Intersect, Subtract }
    "NORMAL_METHOD" NormalMethod { InverseTranspose, Tangent, Numeric }
};

/// The source of a surface.
#[derive(Clone, Copy)]
pub enum ImplicitKind {
    /// A grid of distances.
    Grid,
    /// Solids.
    Formula,
    /// Depth maps.
    Depth,
}

/// The solids of a formula.
#[derive(Clone, Copy)]
pub enum SolidKind {
    /// See [`crate::mesh::formula::Solid`].
    Sphere,
    /// A box.
    Box,
    /// A torus about z.
    Torus,
    /// A cylinder along z.
    Cylinder,
    /// A gyroid within a box.
    Gyroid,
}

/// The deformers of a mesh.
#[derive(Clone, Copy)]
pub enum MeshDeformerKind {
    /// See [`crate::mesh::deformer::DeformerKind`].
    Twist,
    /// A bend.
    Bend,
    /// A taper.
    Taper,
    /// A shear.
    Shear,
    /// A bulge.
    Bulge,
    /// A radial wave.
    Wave,
    /// Free-form deformation.
    Lattice,
}

/// The colour of a sample between voxels that have colours of their own.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub enum OwnColors {
    /// They have none.
    None,
    /// Interpolated.
    Mixed,
    /// That of one label: see [`Colors::has_margins`].
    Elected,
}

impl OwnColors {
    /// How the colours of a volume are sampled.
    pub fn of(colors: Option<&Colors>) -> Self {
        match colors {
            None => Self::None,
            Some(colors) if colors.has_margins() => Self::Elected,
            Some(_) => Self::Mixed,
        }
    }
}

/// The same for enums specific to the GPU.
const GPU_ENUMS: &[(&str, &str, u32)] = constants! {
    "COLORS" OwnColors { None, Mixed, Elected }
    "IMPLICIT" ImplicitKind { Grid, Formula, Depth }
    "SOLID" SolidKind { Sphere, Box, Torus, Cylinder, Gyroid }
    "DEFORMER" MeshDeformerKind { Twist, Bend, Taper, Shear, Bulge, Wave, Lattice }
};

/// How an iso-surface is shown: not at all, or lit in one of the ways of [`IsoLight`].
pub fn iso(light: Option<IsoLight>) -> u32 {
    light.map_or(0, |light| 1 + light as u32)
}

/// `CamelCase` as `CAMEL_CASE`.
fn upper(name: &str) -> String {
    let mut all = String::new();
    for (n, c) in name.chars().enumerate() {
        if n > 0 && c.is_uppercase() {
            all.push('_');
        }
        all.extend(c.to_uppercase());
    }
    all
}

/// The constants of all shaders, as WGSL.
pub fn wgsl_constants() -> &'static str {
    static TEXT: LazyLock<String> = LazyLock::new(|| {
        let variants = VARIANTS
            .iter()
            .chain(GPU_ENUMS)
            .map(|&(prefix, name, number)| (format!("{prefix}{}", upper(name)), number));
        let iso = [
            ("ISO_NONE", None),
            ("ISO_GRADIENT", Some(IsoLight::Gradient)),
            ("ISO_DERIVATIVE", Some(IsoLight::Derivative)),
        ];
        let iso = iso.map(|(name, light)| (name.to_owned(), self::iso(light)));
        variants
            .chain(iso)
            .map(|(name, number)| format!("const {name}: u32 = {number}u;\n"))
            .collect()
    });
    &TEXT
}
