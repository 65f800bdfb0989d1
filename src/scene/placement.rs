//! Where a deformation lies if its numbers are left out: on what is seen.
//!
//! [`VisibleObject`] is what a camera sees of a scene ([`crate::prepare::placement`] finds it). A
//! kind has a `Template`: on the surface in the middle of the view, with the box's z along the
//! surface's normal, or about the whole object, on the side that faces the viewer. Lengths are
//! shares of the object's extent in the picture; depths are a few per cent of it, on a head the
//! scalp and the skull. A number that the user states is kept.
//!
//! Scenes of version 1 put every box about the middle of the volume; `placement = "volume"` still
//! does.

use super::{Deformation, Size};
use crate::deform::kinds::{DefaultSize, Kind};
use crate::math::{Bounds, normalize_or};
use glam::{EulerRot, Mat3, Quat, Vec2, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where the box of a deformation lies whose centre or size is left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum DefaultPlacement {
    /// On the visible surface in the middle of the view, with a size relative to the visible
    /// object.
    #[default]
    Visible,
    /// About the centre of the volume, along its axes, with a size relative to the volume.
    Volume,
}

/// What a camera sees of a scene.
#[derive(Clone, Debug)]
pub struct VisibleObject {
    /// The box around everything that can be seen from any side, mm.
    pub bounds: Bounds,
    /// Extent of what the picture shows, across and up, mm.
    pub span_mm: Vec2,
    /// The point of the surface in the middle of the view.
    pub point: Vec3,
    /// Points all over the part of the surface that the picture shows.
    pub surface: Vec<Vec3>,
    /// The volume's value at the surface, data units; none if no volume is seen.
    pub value: Option<f32>,
    /// Unit vector towards the viewer.
    pub viewer: Vec3,
    /// Unit vectors to the right and up in the picture.
    pub right: Vec3,
    /// See `right`.
    pub up: Vec3,
}

/// How a kind lies if its numbers are left out. Lengths are shares of [`VisibleObject::extent_mm`].
#[derive(Clone, Copy, Debug, PartialEq)]
enum Template {
    /// On the surface, z along its normal.
    Surface {
        /// Which of the box's axes is horizontal in the picture.
        horizontal: Horizontal,
        /// Extents along the horizontal and across it.
        share: [f32; 2],
        /// How far the box reaches below the point and above it. An upper face on which the
        /// displacement does not vanish lies above everything within the box.
        below: f32,
        above: f32,
    },
    /// A flap of the surface, whose hinge is horizontal: extents along the hinge and across it.
    Flap([f32; 2]),
    /// About the whole object, along the world's axes.
    Around,
    /// The same, z along the axis that is nearest to the picture's vertical.
    Upright,
    /// The same, z along the axis that is nearest to the viewer, y nearest to the vertical.
    Facing,
    /// The octant of the object that faces the viewer.
    Corner,
    /// A wedge about the axis nearest to the vertical; it opens towards the viewer.
    Wedge,
    /// A plane across the axis nearest to the viewer, which removes the nearer part.
    Plane,
    /// A cone that opens towards the viewer from below the surface.
    Cone,
    /// About the surface's point, along axes that turn with the view.
    View(f32),
}

/// An axis of a box.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Horizontal {
    X,
    Y,
}

/// Distance of a plane from the object's middle, towards the viewer, as a share of its extent.
const PLANE: f32 = 0.2;
/// Depth of a cut below the lowest part of a flap's surface: scalp and skull of a head.
const FLAP_DEPTH: f32 = 0.026;
/// Largest relief of a flap's surface; a flap with more is made smaller.
const FLAP_RELIEF: f32 = 0.07;
/// A smaller flap, relative to the full one.
const SMALLER_FLAP: f32 = 0.8;
/// Largest thickness of a flap.
const MAX_FLAP_DEPTH: f32 = 0.15;
/// Thickness of the layer below a surface that follow it.
const LAYER_DEPTH: f32 = 0.045;
/// Depth of a cone's tip below the surface.
const CONE_DEPTH: f32 = 0.6;
/// Movement of a surface that is pushed out.
const OFFSET: f32 = 0.06;
/// Depth of an incision, as a fraction of its box's height.
const INCISION_DEPTH: f32 = 0.85;
/// A flap's thickness and outer radius, as fractions of its box's height ([`crate::deform`]).
const FLAP_HEIGHTS: [f32; 2] = [0.35, 0.43];
/// The layer's lower side, and the margins at the ends and sides of a flap, as fractions of its box.
const FLAP_FLOOR: f32 = 0.1;
const FLAP_MARGIN: f32 = 0.06;

/// The template of a kind; none for kinds whose settings state positions in the world: their box
/// is their domain.
fn template(kind: &Kind) -> Option<Template> {
    use Horizontal::{X, Y};
    let on = |horizontal, share, below, above| Template::Surface {
        horizontal,
        share,
        below,
        above,
    };
    Some(match kind.name {
        "pull" => on(Y, [0.8, 0.8], 0.25, 0.4),
        "spline-pull" => on(Y, [0.85, 0.85], 0.4, 0.6),
        "wave" | "planar-wave" => on(X, [0.85, 0.85], 0.35, 0.35),
        "bulge" => on(Y, [0.9, 0.9], 0.65, 0.25),
        "peel" => Template::Flap([0.54, 0.45]),
        "seam" => on(X, [0.95, 0.8], 0.4, 0.15),
        "knife" => on(Y, [0.95, 0.85], 0.22, 0.03),
        "retractor" => on(X, [1.0, 0.7], 0.2, 0.03),
        "sphere" => on(X, [0.5, 0.5], 0.25, 0.25),
        "cylinder" => on(X, [0.45, 0.45], 0.5, 0.2),
        "strip" => on(Y, [0.65, 0.55], 0.3, 0.2),
        "lift" => on(Y, [0.9, 0.8], 0.35, 0.4),
        "offset" => on(Y, [1.0, 1.0], 0.45, 0.5),
        "surface-peel" => on(Y, [0.6, 0.5], 0.3, 0.3),
        "elastic" => on(X, [0.6, 0.6], 0.45, 0.15),
        "slab" => Template::Upright,
        "book" => Template::Facing,
        "box" => Template::Corner,
        "wedge" => Template::Wedge,
        "half-space" => Template::Plane,
        "view-sphere" => Template::View(0.5),
        "view-cone" => Template::Cone,
        "twist" | "bend" | "taper" | "shear" | "explode" | "lattice" => Template::Around,
        _ => return None,
    })
}

/// Rotation angles about x, then y, then z, degrees, of the matrix `m`.
pub fn angles_of(m: Mat3) -> Vec3 {
    let (z, y, x) = Quat::from_mat3(&m).to_euler(EulerRot::ZYX);
    Vec3::new(x.to_degrees(), y.to_degrees(), z.to_degrees())
}

/// The matrix of rotations about x, then y, then z, degrees.
pub fn matrix_of(degrees: Vec3) -> Mat3 {
    let r = degrees * (std::f32::consts::PI / 180.0);
    Mat3::from_rotation_z(r.z) * Mat3::from_rotation_y(r.y) * Mat3::from_rotation_x(r.x)
}

/// Rounded to a precision that suffices for a length in mm or an angle.
pub fn tidy(v: Vec3) -> [f32; 3] {
    v.to_array().map(|x| (x * 100.0).round() / 100.0 + 0.0)
}

/// A length of 0.1 mm or more, rounded.
fn tidy_length(mm: f32) -> f32 {
    tidy(Vec3::splat(mm))[0]
}

/// The range, of at most a given width, that holds most of some numbers in order; an end without
/// many of them is left out.
fn densest(sorted: &[f32], width: f32) -> [f32; 2] {
    let (margin, n) = (sorted.len() / 50, sorted.len());
    let inner = &sorted[margin..n - margin];
    let ranges = inner.iter().enumerate().map(|(first, low)| {
        let count = inner[first..].partition_point(|v| *v <= low + width);
        (count, [*low, inner[first + count - 1]])
    });
    ranges
        .max_by_key(|(count, _)| *count)
        .map_or([0.0; 2], |(_, range)| range)
}

/// Where a box lies: its axes as columns, its centre and its extents, mm.
#[derive(Clone, Copy, Debug)]
struct BoxLayout {
    turn: Mat3,
    center: Vec3,
    size: Vec3,
}

impl VisibleObject {
    /// The shorter side of what the picture shows of the object, mm: the unit of templates.
    pub fn extent_mm(&self) -> f32 {
        let least = self.bounds.size().max_element() * 0.01;
        self.span_mm.min_element().max(least).max(1e-3)
    }

    /// An object of which only a box is known, as seen from the front.
    pub fn of_box(bounds: &Bounds) -> Self {
        let (size, viewer) = (bounds.size(), Vec3::NEG_Y);
        Self {
            bounds: *bounds,
            span_mm: Vec2::new(size.x, size.z),
            point: bounds.center() + viewer * (0.5 * size.y),
            surface: Vec::new(),
            value: None,
            viewer,
            right: Vec3::X,
            up: Vec3::Z,
        }
    }

    /// The same object with another point in the middle.
    #[must_use]
    pub fn about(&self, point: Vec3) -> Self {
        Self {
            point,
            ..self.clone()
        }
    }

    /// The unit normal at the point: of the plane that fits the surface within a radius best, so
    /// that a fold or noise does not turn it.
    pub fn normal(&self, radius_mm: f32) -> Vec3 {
        // z = a + b x + c y towards the viewer; the normal equations of weighted least squares.
        let (mut m, mut r) = (Mat3::ZERO, Vec3::ZERO);
        for p in &self.surface {
            let d = *p - self.point;
            let near = 1.0 - d.length_squared() / (radius_mm * radius_mm);
            if near <= 0.0 {
                continue;
            }
            let row = Vec3::new(1.0, d.dot(self.right), d.dot(self.up));
            let weighted = row * (near * near);
            m += Mat3::from_cols(weighted * row.x, weighted * row.y, weighted * row.z);
            r += weighted * d.dot(self.viewer);
        }
        // In units of the radius the determinant of a well-spread neighbourhood is about 1.
        let scale = m.x_axis.x.powi(3) * radius_mm.powi(4);
        if !(m.determinant() > 1e-4 * scale && scale > 0.0) {
            return self.viewer;
        }
        let plane = m.inverse() * r;
        normalize_or(
            self.viewer - self.right * plane.y - self.up * plane.z,
            self.viewer,
        )
    }

    /// The axes of the surface's tangent plane and its normal: horizontal in the picture, upwards,
    /// outwards.
    fn tangent_axes(&self, normal: Vec3) -> [Vec3; 3] {
        let across = self.right - normal * self.right.dot(normal);
        let across = normalize_or(across, normal.any_orthonormal_vector());
        [across, normal.cross(across), normal]
    }

    /// Heights of the surface along the box's z within a rectangle about a point, mm, in order.
    fn heights(&self, turn: &Mat3, point: Vec3, half: Vec2) -> Vec<f32> {
        let from_world = turn.transpose();
        let reach = 0.25 * self.extent_mm();
        let mut heights: Vec<f32> = self
            .surface
            .iter()
            .map(|p| from_world * (*p - point))
            .filter(|q| q.x.abs() <= half.x && q.y.abs() <= half.y && q.z.abs() <= reach)
            .map(|q| q.z)
            .collect();
        heights.push(0.0);
        heights.sort_by(f32::total_cmp);
        heights
    }

    /// The axes of the world, the one nearest to `z` last and, among the others, the one nearest to
    /// `second` at index `n` (0: x, 1: y); right-handed.
    fn world_axes(z: Vec3, n: usize, second: Vec3) -> Mat3 {
        let nearest = |v: Vec3, not: Option<Vec3>| {
            let axes = Vec3::AXES.into_iter().filter(|a| Some(*a) != not);
            let best = axes.max_by(|a, b| v.dot(*a).abs().total_cmp(&v.dot(*b).abs()));
            best.unwrap_or(Vec3::Z)
        };
        let signed = |axis: Vec3, v: Vec3| if v.dot(axis) < 0.0 { -axis } else { axis };
        let along = nearest(z, None);
        let other = nearest(second, Some(along));
        let (z, other) = (signed(along, z), signed(other, second));
        match n {
            0 => Mat3::from_cols(other, z.cross(other), z),
            _ => Mat3::from_cols(other.cross(z), other, z),
        }
    }

    /// Extents of the object along the axes of a box, mm.
    fn extents_along(&self, turn: &Mat3) -> Vec3 {
        let size = self.bounds.size();
        Vec3::from([turn.x_axis, turn.y_axis, turn.z_axis].map(|a| a.abs().dot(size)))
    }

    /// A box about the whole object with the kind's default extents along given axes.
    fn around(&self, kind: &Kind, turn: Mat3) -> BoxLayout {
        let half = self.extents_along(&turn) / 2.0;
        BoxLayout {
            turn,
            center: self.bounds.center(),
            size: kind.default_size(&Bounds::new(-half, half)),
        }
    }

    /// The sign of each of the world's axes in the octant that faces the viewer. Across the view it
    /// is the one with the most surface; the upper right one if they are alike.
    fn facing_octant(&self) -> Vec3 {
        let center = self.bounds.center();
        let octant = |n: usize| Vec3::from([0, 1, 2].map(|a| if n >> a & 1 == 0 { 1.0 } else { -1.0 }));
        let faces = |signs: &Vec3| {
            let away = (0..3).any(|a| self.viewer[a].abs() > 0.25 && self.viewer[a] * signs[a] < 0.0);
            !away
        };
        let weight = |signs: &Vec3| {
            let count = self
                .surface
                .iter()
                .filter(|p| ((**p - center) * *signs).cmpge(Vec3::ZERO).all());
            let higher = if self.up.dot(*signs) > 0.0 { 1.5 } else { 1.0 };
            let righter = if self.right.dot(*signs) > 0.0 { 1.2 } else { 1.0 };
            (1 + count.count()) as f32 * higher * righter
        };
        let facing = (0..8).map(octant).filter(faces);
        facing
            .max_by(|a, b| weight(a).total_cmp(&weight(b)))
            .unwrap_or(Vec3::ONE)
    }

    /// The box of a kind, with the numbers that are stated.
    fn layout(&self, kind: &Kind, template: Template, stated: &Deformation) -> BoxLayout {
        let (extent, box_size) = (self.extent_mm(), self.bounds.size());
        let center = self.bounds.center();
        let own_turn = stated.rotate.map(|r| matrix_of(r.into()));
        match template {
            Template::Surface {
                horizontal,
                share,
                below,
                above,
            } => {
                let half = Vec2::from(share) * extent / 2.0;
                let [across, up, normal] = self.tangent_axes(self.normal(half.max_element()));
                let (turn, size) = match horizontal {
                    Horizontal::X => (Mat3::from_cols(across, up, normal), half * 2.0),
                    Horizontal::Y => (self.hinged(across, up, normal), Vec2::new(half.y, half.x) * 2.0),
                };
                let turn = own_turn.unwrap_or(turn);
                let mut above = above * extent;
                if kind.nonzero_faces[5] {
                    let heights = self.heights(&turn, self.point, size / 2.0);
                    above += heights.last().copied().unwrap_or_default();
                }
                let below = below * extent;
                let size = stated.size.map_or(size.extend(above + below), Size::xyz);
                let height = 0.5 * size.z * (above - below) / (above + below);
                BoxLayout {
                    turn,
                    center: self.point + turn.z_axis * height,
                    size,
                }
            }
            Template::Flap(share) => self.flap(share, stated),
            Template::Around => self.around(kind, Mat3::IDENTITY),
            Template::Upright => self.around(kind, Self::world_axes(self.up, 0, self.right)),
            Template::Facing => self.around(kind, Self::world_axes(self.viewer, 1, self.up)),
            Template::Corner => BoxLayout {
                turn: Mat3::IDENTITY,
                center: center + self.facing_octant() * box_size * 0.275,
                size: box_size * 0.55,
            },
            Template::Wedge => {
                let axes = Self::world_axes(self.up, 0, self.right);
                let extents = self.extents_along(&axes);
                let towards = self.viewer - axes.z_axis * self.viewer.dot(axes.z_axis);
                let x = normalize_or(towards, axes.x_axis);
                let across = 1.1 * extents.x.hypot(extents.y);
                BoxLayout {
                    turn: Mat3::from_cols(x, axes.z_axis.cross(x), axes.z_axis),
                    center,
                    size: Vec3::new(across, across, 1.1 * extents.z),
                }
            }
            Template::Plane => {
                let axes = Self::world_axes(self.viewer, 1, self.up);
                let shift = PLANE * self.extents_along(&axes).z;
                BoxLayout {
                    turn: axes,
                    center: center + axes.z_axis * shift,
                    size: box_size,
                }
            }
            Template::Cone => BoxLayout {
                turn: Mat3::IDENTITY,
                center: self.point - self.viewer * (CONE_DEPTH * extent),
                size: box_size,
            },
            Template::View(share) => BoxLayout {
                turn: Mat3::IDENTITY,
                center: self.point,
                size: Vec3::splat(share * extent),
            },
        }
    }

    /// Axes with y along the horizontal and x, towards which a flap is opened, on the side that the
    /// viewer sees from: a flap is rolled towards -x and would hide what lies behind it. Upwards if
    /// the surface faces the viewer: a flap hangs down.
    fn hinged(&self, across: Vec3, up: Vec3, normal: Vec3) -> Mat3 {
        if self.viewer.dot(up) < -0.4 {
            Mat3::from_cols(-up, across, normal)
        } else {
            Mat3::from_cols(up, -across, normal)
        }
    }

    /// A flap: thick enough for the relief of the surface and a cut below it, small enough that
    /// this is little.
    fn flap(&self, share: [f32; 2], stated: &Deformation) -> BoxLayout {
        let extent = self.extent_mm();
        let mut half = Vec2::new(share[1], share[0]) * extent / 2.0;
        let [across, up, normal] = self.tangent_axes(self.normal(half.max_element()));
        let own_turn = stated.rotate.map(|r| matrix_of(r.into()));
        let turn = own_turn.unwrap_or_else(|| self.hinged(across, up, normal));
        let relief = |half| {
            let heights = self.heights(&turn, self.point, half);
            densest(&heights, (MAX_FLAP_DEPTH - FLAP_DEPTH) * extent)
        };
        let mut range = relief(half);
        if range[1] - range[0] > FLAP_RELIEF * extent {
            // A dome is flatter in a smaller flap; a rough surface is not.
            let smaller = relief(half * SMALLER_FLAP);
            if smaller[1] - smaller[0] < 0.85 * (range[1] - range[0]) {
                (half, range) = (half * SMALLER_FLAP, smaller);
            }
        }
        let [low, high] = range;
        let number = |name: &str| stated.parameters.number(name).ok().flatten();
        let depth = high - low + FLAP_DEPTH * extent;
        let height = number("depth").unwrap_or(depth) / FLAP_HEIGHTS[0];
        let radius = number("radius").unwrap_or(FLAP_HEIGHTS[1] * height);
        let inner = 1.0 - 2.0 * FLAP_MARGIN;
        let size = Vec3::new((2.0 * half.x + radius) / inner, 2.0 * half.y / inner, height);
        let size = stated.size.map_or(size, Size::xyz);
        // The roll lies behind the hinge, so the opening is in the front part of the box.
        let opening = (0.5 - FLAP_MARGIN) * size.x - half.x.min(0.25 * size.x);
        // With a stated size the kind's own default thickness applies.
        let share = number("depth").map_or(
            if stated.size.is_some() {
                0.25
            } else {
                FLAP_HEIGHTS[0]
            },
            |depth| depth / size.z,
        );
        let top = (FLAP_FLOOR + share - 0.5) * size.z;
        BoxLayout {
            turn,
            center: self.point + turn * Vec3::new(-opening, 0.0, high - top),
            size,
        }
    }
}

impl Deformation {
    /// Whether its box depends on what is visible: a kind with a template, whose centre or size is
    /// left out.
    pub(crate) fn follows_view(&self, kind: &Kind) -> bool {
        let has_size = self.size.is_some() || matches!(kind.size, DefaultSize::Across(_));
        self.placement == DefaultPlacement::Visible
            && self.matrix.is_none()
            && !(self.center.is_some() && has_size)
            && template(kind).is_some()
            // Grabbed points and moved control points are stated in the world or in the box.
            && !(matches!(kind.name, "elastic" | "lattice"))
    }

    /// States the numbers of the box that are left out, for what is visible. A stated centre leaves
    /// the box along the world's axes; without one the box lies where the kind's template puts it.
    pub fn place(&mut self, kind: &Kind, object: &VisibleObject) {
        let Some(template) = template(kind) else {
            return;
        };
        let across = matches!(kind.size, DefaultSize::Across(_));
        if self.center.is_some() {
            let size = kind.default_size(&object.bounds);
            if !across {
                self.size.get_or_insert(Size::Box(tidy(size)));
            }
            return;
        }
        let BoxLayout { turn, center, size } = object.layout(kind, template, self);
        self.center = Some(tidy(center));
        if self.rotate.is_none() && turn != Mat3::IDENTITY {
            self.rotate = Some(tidy(angles_of(turn)));
        }
        if !across && self.size.is_none() {
            self.size = Some(Size::Box(tidy(size).map(|mm| mm.max(0.01))));
            self.place_lengths(kind, object, size);
        }
    }

    /// States the depths that follow from the size of the box or of the object.
    fn place_lengths(&mut self, kind: &Kind, object: &VisibleObject, size: Vec3) {
        let mut state = |name: &str, mm: f32| {
            if !self.parameters.0.contains_key(name) {
                self.parameters.insert(name, tidy_length(mm));
            }
        };
        match kind.name {
            "peel" => {
                let [depth, radius] = FLAP_HEIGHTS;
                state("depth", depth * size.z);
                state("radius", radius * size.z);
            }
            "knife" | "retractor" => state("depth", INCISION_DEPTH * size.z),
            "strip" | "lift" | "surface-peel" => state("depth", LAYER_DEPTH * object.extent_mm()),
            "offset" => state("amount", OFFSET * object.extent_mm()),
            _ => {}
        }
        let follows_surface = matches!(kind.name, "strip" | "lift" | "surface-peel" | "offset");
        let states_surface = ["label", "mask", "iso"]
            .iter()
            .any(|name| self.parameters.0.contains_key(*name));
        if let Some(value) = object.value.filter(|_| follows_surface && !states_surface) {
            self.parameters.insert("iso", value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::kinds;

    #[test]
    fn angles_and_matrices_are_inverse() {
        for degrees in [
            Vec3::new(10.0, 20.0, 30.0),
            Vec3::new(-80.0, 45.0, 170.0),
            Vec3::ZERO,
        ] {
            let m = matrix_of(degrees);
            assert!(matrix_of(angles_of(m)).abs_diff_eq(m, 1e-5), "{degrees}");
        }
    }

    /// A ball of radius 80 mm as seen from a direction.
    fn ball(viewer: Vec3) -> VisibleObject {
        let right = viewer.any_orthonormal_vector();
        let up = viewer.cross(right);
        let grid = (0..4096).map(|n| Vec2::new((n % 64) as f32, (n / 64) as f32) / 31.5 - 1.0);
        let on_ball = |p: Vec2| {
            let depth = 1.0 - p.length_squared();
            (depth > 0.0).then(|| 80.0 * (right * p.x + up * p.y + viewer * depth.sqrt()))
        };
        VisibleObject {
            bounds: Bounds::new(Vec3::splat(-80.0), Vec3::splat(80.0)),
            span_mm: Vec2::splat(160.0),
            point: viewer * 80.0,
            surface: grid.filter_map(on_ball).collect(),
            value: None,
            viewer,
            right,
            up,
        }
    }

    #[test]
    fn templates_lie_on_the_surface() {
        for viewer in [Vec3::X, Vec3::Y, Vec3::NEG_Z, Vec3::new(0.6, -0.48, 0.64)] {
            let object = ball(viewer);
            for kind in kinds::list().filter(|k| template(k).is_some()) {
                let mut d = Deformation::new(kind.name);
                assert!(!d.follows_view(kind) == matches!(kind.name, "elastic" | "lattice"));
                d.place(kind, &object);
                assert!(!d.follows_view(kind), "{}: all its numbers are stated", kind.name);
                let turn = matrix_of(d.rotate.map_or(Vec3::ZERO, Vec3::from));
                if matches!(template(kind), Some(Template::Surface { .. } | Template::Flap(_))) {
                    assert!(
                        (turn * Vec3::Z).abs_diff_eq(viewer, 0.02),
                        "{} {viewer}",
                        kind.name
                    );
                    let local = turn.transpose() * (object.point - Vec3::from(d.center.unwrap()));
                    let half = d.size.unwrap().xyz() / 2.0;
                    assert!(local.abs().cmple(half).all(), "{} {viewer} {local}", kind.name);
                }
            }
        }
    }

    /// A flap's hinge is horizontal and below; the layer is scalp and skull, a tenth of a head at
    /// most.
    #[test]
    fn a_flap_is_thin() {
        let viewer = Vec3::NEG_Y;
        let object = ball(viewer);
        let kind = kinds::kind("peel").unwrap();
        let mut d = Deformation::new("peel");
        d.place(kind, &object);
        let turn = matrix_of(d.rotate.unwrap().into());
        assert!((turn * Vec3::X).abs_diff_eq(object.up, 0.02), "{turn}");
        let depth = d.parameters.number("depth").unwrap().unwrap();
        assert!((6.0..16.0).contains(&depth), "{depth}");
    }

    #[test]
    fn stated_numbers_are_kept() {
        let object = ball(Vec3::NEG_Y);
        let kind = kinds::kind("peel").unwrap();
        let mut d = Deformation::new("peel");
        d.center = Some([1.0, 2.0, 3.0]);
        d.parameters.insert("depth", 4.0);
        d.place(kind, &object);
        assert_eq!((d.center, d.rotate), (Some([1.0, 2.0, 3.0]), None));
        assert_eq!(d.parameters.number("depth").ok().flatten(), Some(4.0));
        let mut d = Deformation::new("peel");
        (d.size, d.rotate) = (Some(Size::Cube(30.0)), Some([0.0, 10.0, 0.0]));
        d.parameters.insert("depth", 4.0);
        d.place(kind, &object);
        assert_eq!(
            (d.size, d.rotate),
            (Some(Size::Cube(30.0)), Some([0.0, 10.0, 0.0]))
        );
        assert_eq!(d.parameters.number("depth").ok().flatten(), Some(4.0));
        assert!(d.center.is_some());
    }
}
