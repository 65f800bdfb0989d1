//! Removal of a box, sphere, cylinder, wedge, half-space or, locked to the view, a sphere or a
//! cone: mask only, no displacement.
//!
//! The map's cube is larger than the shape (`cube_scale`), so that the cut lies inside the map;
//! that of the half-space spans the scene at any angle. The distances are those of `deform::cut`,
//! which replaces the map where no later deformation moves anything. `progress` grows the shape
//! from nothing (for the half-space: moves the plane down from the box's top).

use super::{
    Backward, DefaultSize, Field, FieldBuilder, FieldContext, Formula, FormulaKind, Kind, NO_CUT_DISTANCE_MM,
    Parameter,
};
use crate::deform::cut::{CutShape, CutShapeKind};
use glam::{Affine3A, Vec3};

struct Removal {
    /// None at progress 0.
    shape: Option<CutShape>,
}

impl Removal {
    fn field(shape: CutShapeKind, c: &FieldContext) -> Box<dyn Field> {
        let shape = (c.progress > 0.0).then(|| {
            let (half, half_angle) = shape_of(shape, c.values, c.progress, c.size_mm);
            CutShape {
                shape,
                local_from_world: Affine3A::IDENTITY,
                half,
                half_angle,
                inverted: false,
                joins_previous: false,
                intersects: false,
            }
        });
        Box::new(Self { shape })
    }
}

impl Field for Removal {
    fn backward(&self, q: Vec3) -> Backward {
        Backward {
            source: q,
            cut_distance_mm: self.shape.map_or(NO_CUT_DISTANCE_MM, |s| s.signed_distance_mm(q)),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        self.shape
            .is_none_or(|s| s.signed_distance_mm(q) >= 0.0)
            .then_some(q)
    }

    fn formula(&self) -> Option<Formula> {
        // A shape at progress 0 removes nothing.
        let numbers = self.shape.map_or([-1.0, 0.0, 0.0, 0.0, 0.0], |s| {
            [s.shape as u32 as f32, s.half.x, s.half.y, s.half.z, s.half_angle]
        });
        Some(Formula::new(FormulaKind::Removal, &numbers))
    }
}

const fn removal(
    name: &'static str,
    about: &'static str,
    shape: CutShapeKind,
    build: fn(&FieldContext) -> Box<dyn Field>,
) -> Kind {
    Kind {
        name,
        about,
        parameters: &[],
        size: DefaultSize::Share([0.5; 3]),
        cube_scale: 1.25,
        varies: [true; 3],
        resolution: 96,
        nonzero_faces: [false; 6],
        locked_to_view: false,
        shape: Some(shape),
        build: FieldBuilder::Formula(build),
    }
}

pub(super) const BOX: Kind = removal("box", "removes a box", CutShapeKind::Box, |c| {
    Removal::field(CutShapeKind::Box, c)
});

pub(super) const SPHERE: Kind = removal(
    "sphere",
    "removes a sphere (an ellipsoid if the box is not a cube)",
    CutShapeKind::Ellipsoid,
    |c| Removal::field(CutShapeKind::Ellipsoid, c),
);

pub(super) const CYLINDER: Kind = removal(
    "cylinder",
    "removes a cylinder along the box's z axis",
    CutShapeKind::Cylinder,
    |c| Removal::field(CutShapeKind::Cylinder, c),
);

const fn angle(default: f32, min: f32, max: f32, about: &'static str) -> Parameter {
    Parameter::degrees("angle", default, [min, max], about)
}

pub(super) const WEDGE: Kind = Kind {
    parameters: &[angle(
        90.0,
        1.0,
        359.0,
        "angle of the wedge about the box's z axis, centred on +x",
    )],
    ..removal(
        "wedge",
        "removes a wedge about the box's z axis",
        CutShapeKind::Wedge,
        |c| Removal::field(CutShapeKind::Wedge, c),
    )
};

pub(super) const HALF_SPACE: Kind = Kind {
    size: DefaultSize::Across(2.2),
    cube_scale: 1.0,
    varies: [false, false, true],
    resolution: 512,
    ..removal(
        "half-space",
        "removes everything above the plane through the box's centre, perpendicular to its z axis",
        CutShapeKind::HalfSpace,
        |c| Removal::field(CutShapeKind::HalfSpace, c),
    )
};

pub(super) const VIEW_SPHERE: Kind = Kind {
    name: "view-sphere",
    about: "removes a sphere that stays aligned with the camera",
    locked_to_view: true,
    ..SPHERE
};

pub(super) const VIEW_CONE: Kind = Kind {
    locked_to_view: true,
    parameters: &[angle(40.0, 5.0, 150.0, "opening angle of the cone")],
    // From the centre of the scene to beyond its edge.
    size: DefaultSize::Across(1.1),
    cube_scale: 1.0,
    nonzero_faces: [true; 6],
    ..removal(
        "view-cone",
        "removes a cone that opens from the box's centre towards the viewer",
        CutShapeKind::Cone,
        |c| Removal::field(CutShapeKind::Cone, c),
    )
};

/// The shape that a kind removes, its lengths (mm) and half its angle (radians) at a progress above
/// 0.
pub(super) fn shape_of(shape: CutShapeKind, values: &[f32], progress: f32, size_mm: Vec3) -> (Vec3, f32) {
    let half = size_mm / 2.0;
    let half_angle = values.first().map_or(0.0, |a| (a * progress).to_radians() / 2.0);
    let radius = half.x.min(half.y);
    match shape {
        CutShapeKind::HalfSpace => (Vec3::new(0.0, 0.0, half.z * (1.0 - progress)), 0.0),
        CutShapeKind::Box | CutShapeKind::Ellipsoid => ((half * progress).max(Vec3::splat(1e-3)), 0.0),
        CutShapeKind::Cylinder => (Vec3::new(radius * progress, 0.0, half.z), 0.0),
        CutShapeKind::Wedge => (Vec3::new(radius, 0.0, half.z), half_angle),
        CutShapeKind::Cone => (Vec3::ZERO, half_angle),
    }
}
