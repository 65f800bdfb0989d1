//! Drawing of the handles.

use super::paths::{HandlePath, path_of, progress_path};
use super::placement::BoxPlacement;
use super::points::origin_of;
use super::{Gizmo, Handle, parameter};
use crate::gui::theme::{AXES, ON_CANVAS, SELECTED};
use crate::gui::views::text;
use eframe::egui::{Align2, Color32, Painter, Pos2, Rect, Shape, Stroke, StrokeKind, pos2, vec2};
use glam::Vec3;

impl Gizmo<'_> {
    /// Draws the box and handles; `hot` is hovered or dragged.
    pub fn draw(&self, painter: &Painter, hot: Option<Handle>) {
        let place = self.place();
        if self.deformation.matrix.is_some() {
            return;
        }
        if self.has_size() {
            self.draw_box(painter, &place);
        }
        for (handle, at) in self.handles() {
            let is_hot = hot == Some(handle);
            self.draw_guide(painter, &place, handle, at, is_hot);
            if matches!(handle, Handle::Ring(_)) {
                continue;
            }
            let Some(s) = self.projector.screen(at) else {
                continue;
            };
            draw_marker(painter, handle, s, is_hot);
            if is_hot {
                text(
                    painter,
                    pos2(s.x + 12.0, s.y - 10.0),
                    Align2::LEFT_BOTTOM,
                    self.words(handle),
                    13.5,
                    Color32::WHITE,
                );
            }
        }
    }

    /// Draws a handle's guide: the ring or path that it moves along, or the line from its origin.
    fn draw_guide(&self, painter: &Painter, place: &BoxPlacement, handle: Handle, at: Vec3, is_hot: bool) {
        let rim = Stroke::new(3.5, Color32::from_black_alpha(170));
        let line = |from: Vec3, to: Vec3, color: Color32, width: f32| {
            if let (Some(a), Some(b)) = (self.projector.screen(from), self.projector.screen(to)) {
                painter.line_segment([a, b], rim);
                painter.line_segment([a, b], Stroke::new(width, color));
            }
        };
        match handle {
            Handle::Ring(axis) => {
                let points = self.ring(axis);
                painter.add(Shape::line(points.clone(), rim));
                painter.add(Shape::line(
                    points,
                    Stroke::new(if is_hot { 3.0 } else { 2.0 }, highlighted(AXES[axis], is_hot)),
                ));
            }
            Handle::Axis(axis) => line(place.center, at, highlighted(AXES[axis], is_hot), 2.5),
            Handle::Parameter(n) => {
                let path = path_of(self.kind, n);
                let (value, range, _) = parameter(self.deformation, self.kind, n, place.size);
                self.draw_path(painter, &path, [range[0], value], range, place);
            }
            Handle::Progress => {
                let path = progress_path(self.kind.name);
                self.draw_path(painter, &path, [0.0, 1.0], [0.0, 1.0], place);
            }
            Handle::Point(n) => {
                if let Some(origin) = origin_of(self.deformation, n) {
                    line(origin, at, ON_CANVAS, 1.5);
                    if let Some(o) = self.projector.screen(origin) {
                        painter.circle_stroke(o, 4.0, Stroke::new(1.5, ON_CANVAS));
                    }
                }
            }
            Handle::Center | Handle::Face(..) => {}
        }
    }

    fn draw_box(&self, painter: &Painter, place: &BoxPlacement) {
        let corner = |n: usize| {
            let s = Vec3::new((n & 1) as f32, (n >> 1 & 1) as f32, (n >> 2 & 1) as f32) - 0.5;
            self.projector.screen(place.world(s * place.size))
        };
        for a in 0..8usize {
            for bit in [1, 2, 4] {
                if a & bit == 0
                    && let (Some(p), Some(q)) = (corner(a), corner(a | bit))
                {
                    painter.line_segment([p, q], Stroke::new(2.5, Color32::from_black_alpha(90)));
                    painter.line_segment([p, q], Stroke::new(1.0, SELECTED.gamma_multiply(0.75)));
                }
            }
        }
    }

    fn draw_path(
        &self,
        painter: &Painter,
        path: &HandlePath,
        [from, to]: [f32; 2],
        range: [f32; 2],
        place: &BoxPlacement,
    ) {
        let points: Vec<Pos2> = (0..=24)
            .filter_map(|n| {
                self.projector.screen(place.world(path.at(
                    from + (to - from) * n as f32 / 24.0,
                    range,
                    place.size,
                )))
            })
            .collect();
        painter.add(Shape::line(
            points.clone(),
            Stroke::new(3.0, Color32::from_black_alpha(120)),
        ));
        painter.add(Shape::line(
            points,
            Stroke::new(1.2, ON_CANVAS.gamma_multiply(0.8)),
        ));
    }
}

/// The colour of a handle: white while it is hovered or dragged.
fn highlighted(base: Color32, is_hot: bool) -> Color32 {
    if is_hot { Color32::WHITE } else { base }
}

/// Draws the mark of a handle at its screen position.
fn draw_marker(painter: &Painter, handle: Handle, s: Pos2, is_hot: bool) {
    let radius = if is_hot { 7.0 } else { 5.5 };
    let dark = Stroke::new(2.0, Color32::from_black_alpha(220));
    match handle {
        Handle::Center => {
            painter.circle(s, radius, highlighted(SELECTED, is_hot), dark);
        }
        Handle::Face(axis, _) | Handle::Axis(axis) => {
            let square = Rect::from_center_size(s, vec2(2.0, 2.0) * (radius - 0.5));
            painter.rect(
                square,
                1.0,
                highlighted(AXES[axis], is_hot),
                dark,
                StrokeKind::Outside,
            );
        }
        Handle::Progress => {
            let r = radius + 1.5;
            let diamond = vec![
                s + vec2(0.0, -r),
                s + vec2(r, 0.0),
                s + vec2(0.0, r),
                s + vec2(-r, 0.0),
            ];
            painter.add(Shape::convex_polygon(
                diamond,
                highlighted(Color32::from_rgb(255, 190, 90), is_hot),
                dark,
            ));
        }
        _ => {
            painter.circle(s, radius, highlighted(ON_CANVAS, is_hot), dark);
        }
    }
}
