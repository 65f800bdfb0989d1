//! Removal of a box, sphere, cylinder, wedge, half-space or, locked to the view, a sphere or a cone: mask only, no displacement.
//!
//! The map's cube is larger than the shape (`inflate`), so that the cut lies inside the map; the half-space's is as large as the scene
//! at any angle. `progress` grows the shape from nothing (for the half-space: moves the plane down from the box's top).

use super::{Amount, Backward, Build, Context, DefaultSize, Field, Kind, Parameter, Unit};
use crate::deform::cut::Shape;
use glam::{Vec2, Vec3, Vec3Swizzles};

struct Removal<F> {
    /// Distance from the shape, mm, positive outside it.
    outside: F,
}

impl<F: Fn(Vec3) -> f32 + Send + Sync> Field for Removal<F> {
    fn backward(&self, q: Vec3) -> Backward {
        Backward { source: q, cut_mm: (self.outside)(q) }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        ((self.outside)(q) >= 0.0).then_some(q)
    }
}

/// Distance from an axis-aligned box around the origin.
fn cuboid(q: Vec3, half: Vec3) -> f32 {
    let d = q.abs() - half;
    d.max(Vec3::ZERO).length() + d.max_element().min(0.0)
}

/// The shape at `progress` 0 is gone, not a point: distances move out by the ramp as it vanishes.
fn vanish(c: &Context, distance: f32) -> f32 {
    distance + if c.progress <= 0.0 { 1e6 } else { 0.0 }
}

const fn removal(name: &'static str, about: &'static str, shape: Shape, build: fn(&Context) -> Box<dyn Field>) -> Kind {
    Kind {
        name,
        about,
        parameters: &[],
        progressive: true,
        size: DefaultSize::Share([0.5; 3]),
        inflate: 1.25,
        varies: [true; 3],
        resolution: 96,
        leaks: [false; 6],
        locked_to_view: false,
        shape: Some(shape),
        build: Build::Formula(build),
    }
}

pub(super) const BOX: Kind = removal("box", "removes a box", Shape::Box, |c| {
    let (half, gone) = (c.half() * c.progress, vanish(c, 0.0));
    Box::new(Removal { outside: move |q: Vec3| cuboid(q, half) + gone })
});

pub(super) const SPHERE: Kind = removal("sphere", "removes a sphere (an ellipsoid, in a box of unequal sides)", Shape::Ellipsoid, |c| {
    let (radii, gone) = ((c.half() * c.progress).max(Vec3::splat(1e-3)), vanish(c, 0.0));
    Box::new(Removal {
        outside: move |q: Vec3| {
            let k0 = (q / radii).length();
            let k1 = (q / (radii * radii)).length();
            gone + if k1 < 1e-9 { -radii.min_element() } else { k0 * (k0 - 1.0) / k1 }
        },
    })
});

pub(super) const CYLINDER: Kind = removal("cylinder", "removes a cylinder along the box's z axis", Shape::Cylinder, |c| {
    let (half, gone) = (c.half() * Vec3::new(c.progress, c.progress, 1.0), vanish(c, 0.0));
    let radius = half.x.min(half.y);
    Box::new(Removal {
        outside: move |q: Vec3| {
            let d = Vec2::new(q.xy().length() - radius, q.z.abs() - half.z);
            gone + d.max(Vec2::ZERO).length() + d.max_element().min(0.0)
        },
    })
});

pub(super) const WEDGE: Kind = Kind {
    parameters: &[Parameter {
        name: "angle",
        unit: Unit::Degrees,
        default: Amount::Fixed(90.0),
        min: Amount::Fixed(1.0),
        max: Amount::Fixed(359.0),
        about: "of the wedge, about the box's z axis, centred on +x",
    }],
    ..removal("wedge", "removes a slice of cake about the box's z axis", Shape::Wedge, |c| {
        let (half, gone) = (c.half(), vanish(c, 0.0));
        let half_angle = (c.values[0] * c.progress).to_radians() / 2.0;
        let radius = half.x.min(half.y);
        Box::new(Removal {
            outside: move |q: Vec3| {
                let r = q.xy().length();
                let beyond = q.y.abs().atan2(q.x) - half_angle;
                // Distance to the nearer side plane; from more than a right angle away, to the edge.
                let side = if beyond.abs() < std::f32::consts::FRAC_PI_2 { r * beyond.sin() } else { r * beyond.signum() };
                gone + side.max(r - radius).max(q.z.abs() - half.z)
            },
        })
    })
};

pub(super) const HALF_SPACE: Kind = Kind {
    size: DefaultSize::Across(2.2),
    inflate: 1.0,
    varies: [false, false, true],
    resolution: 512,
    leaks: [false; 6],
    ..removal("half-space", "removes everything above the plane through the box's centre, across its z axis", Shape::HalfSpace, |c| {
        let plane = c.half().z * (1.0 - c.progress);
        let gone = vanish(c, 0.0);
        Box::new(Removal { outside: move |q: Vec3| plane - q.z + gone })
    })
};

pub(super) const VIEW_SPHERE: Kind =
    Kind { name: "view-sphere", about: "removes a sphere whose box turns with the camera", locked_to_view: true, ..SPHERE };

pub(super) const VIEW_CONE: Kind = Kind {
    locked_to_view: true,
    parameters: &[Parameter {
        name: "angle",
        unit: Unit::Degrees,
        default: Amount::Fixed(40.0),
        min: Amount::Fixed(5.0),
        max: Amount::Fixed(150.0),
        about: "between the cone's sides",
    }],
    // From the middle of the scene out to beyond it.
    size: DefaultSize::Across(1.1),
    inflate: 1.0,
    leaks: [true; 6],
    ..removal("view-cone", "removes a cone that opens from the box's centre towards the viewer", Shape::Cone, |c| {
        let half_angle = (c.values[0] * c.progress).to_radians() / 2.0;
        let (axis, gone) = (Vec2::from_angle(half_angle), vanish(c, 0.0));
        Box::new(Removal {
            outside: move |q: Vec3| {
                // In the half plane of radius and height: distance to the side's ray, or to the apex from behind it.
                let v = Vec2::new(q.z, q.xy().length());
                let along = v.dot(axis);
                gone + if along > 0.0 { axis.perp_dot(v) } else { v.length() }
            },
        })
    })
};

/// The shape that a kind removes, its lengths (mm) and half its angle (radians) at a strength above 0.
pub(super) fn shape_of(shape: Shape, values: &[f32], progress: f32, size_mm: Vec3) -> (Vec3, f32) {
    let half = size_mm / 2.0;
    let half_angle = values.first().map_or(0.0, |a| (a * progress).to_radians() / 2.0);
    let radius = half.x.min(half.y);
    match shape {
        Shape::HalfSpace => (Vec3::new(0.0, 0.0, half.z * (1.0 - progress)), 0.0),
        Shape::Box | Shape::Ellipsoid => ((half * progress).max(Vec3::splat(1e-3)), 0.0),
        Shape::Cylinder => (Vec3::new(radius * progress, 0.0, half.z), 0.0),
        Shape::Wedge => (Vec3::new(radius, 0.0, half.z), half_angle),
        Shape::Cone => (Vec3::ZERO, half_angle),
    }
}
