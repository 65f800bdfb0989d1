//! Handles on a deformation in the 3D view: to move, rotate and scale its box, and one handle per
//! parameter.
//!
//! A handle is a point on a path in the box's local millimetres; dragging it finds the point of the
//! path nearest to the ray through the pointer, and that point's value. A grabbed handle thus stays
//! under the pointer in any view.

mod draw;
mod paths;
mod placement;
mod points;

pub use paths::{HandlePath, path_of, progress_path};
pub use placement::BoxPlacement;
pub use points::{control_points, set_point};

use super::projector::Projector;
use super::state::tool::{angles_of, tidy};
use crate::deform::kinds::{self, DefaultSize, Kind, Unit};
use crate::math::Bounds;
use crate::scene::{Deformation, Size};
use eframe::egui::{Pos2, vec2};
use glam::{Mat3, Vec3};

/// Segments of a ring.
const RING: usize = 48;
/// A handle can be grabbed within this distance, points.
const REACH: f32 = 11.0;

/// The set of handles shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// One per parameter, and the centre.
    #[default]
    Shape,
    /// The centre and three arrows.
    Move,
    /// Three rings.
    Rotate,
    /// Six faces.
    Scale,
}

/// A handle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Handle {
    /// The centre, moved in the view plane.
    Center,
    /// The centre, moved along an axis of the box.
    Axis(usize),
    /// Rotation about an axis of the box.
    Ring(usize),
    /// A face: axis, and end.
    Face(usize, bool),
    /// Progress.
    Progress,
    /// A parameter of the kind.
    Parameter(usize),
    /// A control point.
    Point(usize),
}

/// A drag in progress.
#[derive(Clone, Debug)]
pub struct Drag {
    /// The dragged handle.
    pub handle: Handle,
    /// The deformation at the start.
    start: Deformation,
    place: BoxPlacement,
    /// Screen offset from the handle's point to where it was grabbed.
    offset: eframe::egui::Vec2,
    /// Angle at which a ring was grabbed, radians.
    angle: f32,
}

/// The handles of one deformation in one view.
pub struct Gizmo<'a> {
    /// The view.
    pub projector: Projector,
    /// The kind.
    pub kind: &'static Kind,
    /// The deformation.
    pub deformation: &'a Deformation,
    /// The scene's box.
    pub scene_box: Bounds,
    /// The set of handles.
    pub mode: Mode,
}

/// A kind's parameter: its value in a deformation, its range, and its default.
pub fn parameter(d: &Deformation, kind: &Kind, n: usize, size: Vec3) -> (f32, [f32; 2], f32) {
    let p = &kind.parameters[n];
    let [default, min, max] = [p.default, p.min, p.max].map(|a| a.resolve(size));
    let value = d.parameters.number(p.name).ok().flatten().unwrap_or(default);
    (value, [min, max], default)
}

impl Gizmo<'_> {
    fn place(&self) -> BoxPlacement {
        BoxPlacement::of(self.deformation, self.kind, &self.scene_box)
    }

    /// Whether the box has a size of its own.
    fn has_size(&self) -> bool {
        !matches!(self.kind.size, DefaultSize::Across(_))
    }

    /// Length of the arrows, mm: constant on the screen at any zoom.
    fn arm(&self) -> f32 {
        let place = self.place();
        70.0 * self.projector.mm_per_point(place.center)
    }

    /// All handles of the mode with their positions, mm.
    pub fn handles(&self) -> Vec<(Handle, Vec3)> {
        let place = self.place();
        if self.deformation.matrix.is_some() {
            return Vec::new();
        }
        let mut all = vec![(Handle::Center, place.center)];
        match self.mode {
            Mode::Shape => {
                let progress = self.deformation.progress.unwrap_or(1.0);
                all.push((
                    Handle::Progress,
                    place.world(progress_path(self.kind.name).at(progress, [0.0, 1.0], place.size)),
                ));
                for n in 0..self.kind.parameters.len() {
                    let (value, range, _) = parameter(self.deformation, self.kind, n, place.size);
                    all.push((
                        Handle::Parameter(n),
                        place.world(path_of(self.kind, n).at(value, range, place.size)),
                    ));
                }
                all.extend(
                    control_points(self.deformation, &place)
                        .into_iter()
                        .enumerate()
                        .map(|(n, p)| (Handle::Point(n), p)),
                );
            }
            Mode::Move => {
                all.extend((0..3).map(|a| (Handle::Axis(a), place.center + place.turn.col(a) * self.arm())))
            }
            Mode::Rotate => all.extend((0..3).map(|a| (Handle::Ring(a), place.center))),
            Mode::Scale if self.has_size() => {
                for axis in 0..3 {
                    for (high, sign) in [(false, -0.5), (true, 0.5)] {
                        let mut at = Vec3::ZERO;
                        at[axis] = sign * place.size[axis];
                        all.push((Handle::Face(axis, high), place.world(at)));
                    }
                }
            }
            Mode::Scale => {}
        }
        all
    }

    fn ring(&self, axis: usize) -> Vec<Pos2> {
        let place = self.place();
        let (u, v) = (place.turn.col((axis + 1) % 3), place.turn.col((axis + 2) % 3));
        let radius = self.arm();
        (0..=RING)
            .filter_map(|n| {
                let (s, c) = (n as f32 / RING as f32 * std::f32::consts::TAU).sin_cos();
                self.projector.screen(place.center + (u * c + v * s) * radius)
            })
            .collect()
    }

    /// The handle under the pointer.
    pub fn under(&self, pointer: Pos2) -> Option<Handle> {
        let mut best: Option<(f32, Handle)> = None;
        for (handle, at) in self.handles() {
            let distance = match handle {
                Handle::Ring(axis) => {
                    self.ring(axis)
                        .iter()
                        .map(|p| p.distance(pointer))
                        .fold(f32::INFINITY, f32::min)
                        + 2.0
                }
                // The centre gives way to handles on top of it.
                Handle::Center => {
                    self.projector
                        .screen(at)
                        .map_or(f32::INFINITY, |p| p.distance(pointer))
                        + 2.0
                }
                _ => self
                    .projector
                    .screen(at)
                    .map_or(f32::INFINITY, |p| p.distance(pointer)),
            };
            if distance <= REACH && best.is_none_or(|(b, _)| distance < b) {
                best = Some((distance, handle));
            }
        }
        best.map(|b| b.1)
    }

    /// Begins a drag.
    pub fn grab(&self, handle: Handle, pointer: Pos2) -> Drag {
        let place = self.place();
        let at = self
            .handles()
            .into_iter()
            .find(|(h, _)| *h == handle)
            .map_or(place.center, |(_, p)| p);
        let offset = self.projector.screen(at).map_or(vec2(0.0, 0.0), |p| pointer - p);
        let angle = match handle {
            Handle::Ring(axis) => self.angle(axis, pointer, &place).unwrap_or(0.0),
            _ => 0.0,
        };
        Drag {
            handle,
            start: self.deformation.clone(),
            place,
            offset,
            angle,
        }
    }

    /// The angle of the pointer about an axis of the box, radians.
    fn angle(&self, axis: usize, pointer: Pos2, place: &BoxPlacement) -> Option<f32> {
        let normal = place.turn.col(axis);
        let d = self.projector.on_plane(pointer, place.center, normal)? - place.center;
        let (u, v) = (place.turn.col((axis + 1) % 3), place.turn.col((axis + 2) % 3));
        Some(d.dot(v).atan2(d.dot(u)))
    }

    /// The deformation with the dragged handle under the pointer.
    pub fn dragged(&self, drag: &Drag, pointer: Pos2) -> Option<Deformation> {
        let mut d = drag.start.clone();
        let place = drag.place;
        let pos = pointer - drag.offset;
        match drag.handle {
            Handle::Center => {
                d.center = Some(tidy(self.projector.on_plane(
                    pos,
                    place.center,
                    self.projector.frame.forward,
                )?))
            }
            Handle::Axis(axis) => {
                let direction = place.turn.col(axis);
                let t = self.projector.along_line(pos, place.center, direction)? - self.arm();
                d.center = Some(tidy(place.center + direction * t));
            }
            Handle::Ring(axis) => {
                let turned = self.angle(axis, pointer, &place)? - drag.angle;
                let about = Mat3::from_axis_angle(place.turn.col(axis).normalize_or(Vec3::Z), turned);
                d.rotate = Some(tidy(angles_of(about * place.turn)));
            }
            Handle::Face(axis, high) => {
                let sign = if high { 1.0 } else { -1.0 };
                let outward = place.turn.col(axis) * sign;
                let far = place.center - outward * (place.size[axis] / 2.0);
                let length = self.projector.along_line(pos, far, outward)?.max(1.0);
                let mut size = place.size;
                size[axis] = length;
                d.size = Some(Size::Box(tidy(size)));
                // The opposite face stays in place.
                d.center = Some(tidy(far + outward * (length / 2.0)));
            }
            Handle::Progress => {
                let value = self.on_path(&progress_path(self.kind.name), [0.0, 1.0], pos, &place)?;
                d.progress = Some((value * 200.0).round() / 200.0);
            }
            Handle::Parameter(n) => {
                let (_, range, _) = parameter(&d, self.kind, n, place.size);
                let value = self.on_path(&path_of(self.kind, n), range, pos, &place)?;
                let rounded = (value * 10.0).round() / 10.0;
                let value = if self.kind.parameters[n].unit == Unit::None {
                    value
                } else {
                    rounded.max(range[0]).min(range[1])
                };
                d.parameters.insert(self.kind.parameters[n].name, value);
            }
            Handle::Point(n) => {
                let at = *control_points(&drag.start, &place).get(n)?;
                let to = self.projector.on_plane(pos, at, self.projector.frame.forward)?;
                set_point(&mut d, &place, n, to);
            }
        }
        Some(d)
    }

    /// The value at the path's point nearest to the pointer on the screen.
    fn on_path(
        &self,
        path: &HandlePath,
        [min, max]: [f32; 2],
        pos: Pos2,
        place: &BoxPlacement,
    ) -> Option<f32> {
        let distance = |value: f32| {
            let at = place.world(path.at(value, [min, max], place.size));
            self.projector
                .screen(at)
                .map_or(f32::INFINITY, |p| p.distance_sq(pos))
        };
        // A coarse search, then refinement around the best: a path may curve back on itself on the
        // screen.
        const STEPS: i32 = 64;
        let (mut low, mut high) = (min, max);
        let mut best = f32::NAN;
        for _ in 0..4 {
            let value = |n: i32| low + (high - low) * n as f32 / STEPS as f32;
            let n = (0..=STEPS).min_by(|a, b| distance(value(*a)).total_cmp(&distance(value(*b))))?;
            best = value(n);
            (low, high) = (value((n - 1).max(0)), value((n + 1).min(STEPS)));
        }
        best.is_finite().then_some(best.max(min).min(max))
    }

    /// The text shown while a handle is hovered or dragged.
    pub fn words(&self, handle: Handle) -> String {
        let place = self.place();
        let three = |v: Vec3, unit: &str| format!("{:.1}, {:.1}, {:.1} {unit}", v.x, v.y, v.z);
        match handle {
            Handle::Center | Handle::Axis(_) => format!("centre {}", three(place.center, "mm")),
            Handle::Ring(_) => format!("rotation {}", three(angles_of(place.turn), "°")),
            Handle::Face(axis, _) => format!(
                "{} {:.1} mm",
                ["width", "length", "height"][axis],
                place.size[axis]
            ),
            Handle::Progress => format!(
                "progress {:.0} %",
                100.0 * self.deformation.progress.unwrap_or(1.0)
            ),
            Handle::Parameter(n) => {
                let p = &self.kind.parameters[n];
                let (value, ..) = parameter(self.deformation, self.kind, n, place.size);
                match p.unit {
                    Unit::Mm => format!("{} {value:.1} mm", p.name),
                    Unit::Degrees => format!("{} {value:.0}°", p.name),
                    Unit::None => format!("{} {value:.2}", p.name),
                }
            }
            Handle::Point(n) => format!("point {}", n + 1),
        }
    }
}

/// The kind of a deformation, if it has handles.
pub fn kind_of(d: &Deformation) -> Option<&'static Kind> {
    kinds::kind(&d.kind).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Camera;
    use eframe::egui::{Rect, pos2};

    fn projector(scene_box: &Bounds, view: &str) -> Projector {
        let camera = Camera {
            view: view.parse().unwrap(),
            ..Camera::default()
        };
        Projector {
            frame: camera.frame(scene_box, [600, 500]).unwrap(),
            rect: Rect::from_min_size(pos2(0.0, 0.0), vec2(600.0, 500.0)),
        }
    }

    /// Grabbing any handle of any kind without moving it changes nothing beyond rounding; after a
    /// move, the handle lies under the pointer.
    #[test]
    fn every_handle_follows_the_pointer() {
        let scene_box = Bounds::new(Vec3::splat(-80.0), Vec3::splat(80.0));
        let mut tried = 0;
        for kind in kinds::list() {
            let object = crate::scene::VisibleObject::of_box(&scene_box).about(Vec3::new(20.0, -70.0, 30.0));
            let mut d = super::super::state::tool::dropped(kind, &scene_box, &object);
            d.progress = Some(0.5);
            for mode in [Mode::Shape, Mode::Move, Mode::Rotate, Mode::Scale] {
                let gizmo = Gizmo {
                    projector: projector(&scene_box, "25,15"),
                    kind,
                    deformation: &d,
                    scene_box,
                    mode,
                };
                for (handle, at) in gizmo.handles() {
                    let Some(s) = gizmo.projector.screen(at) else {
                        continue;
                    };
                    let drag = gizmo.grab(handle, s);
                    let to = s + vec2(9.0, -6.0);
                    let Some(moved) = gizmo.dragged(&drag, to) else {
                        continue;
                    };
                    let after = Gizmo {
                        deformation: &moved,
                        ..gizmo
                    };
                    match handle {
                        Handle::Center | Handle::Point(_) => {
                            let now = after.handles().into_iter().find(|(h, _)| *h == handle).unwrap().1;
                            let off = after.projector.screen(now).unwrap().distance(to);
                            assert!(off < 1.0, "{} {handle:?} is {off} points away", kind.name);
                        }
                        Handle::Parameter(n) => {
                            let (value, [min, max], _) =
                                parameter(&moved, kind, n, BoxPlacement::of(&moved, kind, &scene_box).size);
                            assert!(
                                value >= min - 1e-3 && value <= max + 1e-3,
                                "{} {handle:?}: {value} outside {min} to {max}",
                                kind.name
                            );
                        }
                        Handle::Progress => assert!((0.0..=1.0).contains(&moved.progress.unwrap())),
                        Handle::Face(axis, _) => {
                            let (a, b) = (
                                BoxPlacement::of(&d, kind, &scene_box),
                                BoxPlacement::of(&moved, kind, &scene_box),
                            );
                            assert!(b.size[(axis + 1) % 3] == a.size[(axis + 1) % 3]);
                        }
                        Handle::Axis(_) | Handle::Ring(_) => {}
                    }
                    tried += 1;
                }
            }
        }
        assert!(tried > 300, "{tried}");
    }

    /// Dragging a ring by half a turn rotates the box by half a turn about that axis.
    #[test]
    fn rings_turn_about_their_axis() {
        let scene_box = Bounds::new(Vec3::splat(-80.0), Vec3::splat(80.0));
        let kind = kinds::kind("box").unwrap();
        let d = Deformation::new("box");
        let gizmo = Gizmo {
            projector: projector(&scene_box, "superior"),
            kind,
            deformation: &d,
            scene_box,
            mode: Mode::Rotate,
        };
        let center = gizmo.projector.screen(Vec3::ZERO).unwrap();
        let drag = gizmo.grab(Handle::Ring(2), center + vec2(70.0, 0.0));
        let moved = gizmo.dragged(&drag, center + vec2(0.0, -70.0)).unwrap();
        // Superior view, with the front of the patient at the top: right on the screen is -x, up is
        // -y. Counter-clockwise on the screen turns -x towards -y: +90 about z.
        let z = moved.rotate.unwrap()[2];
        assert!((z - 90.0).abs() < 1.0, "{:?}", moved.rotate);
    }
}
