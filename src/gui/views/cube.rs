//! The orientation cube: shows the orientation of the patient; a click on a face selects that view.

use super::text;
use crate::gui::projector::Projector;
use crate::gui::theme::ON_CANVAS;
use eframe::egui::{Align2, Color32, Painter, Pos2, Rect, Shape, Stroke, Vec2, pos2, vec2};
use glam::Vec3;

const EDGE: f32 = 21.0;
/// Face: outward normal in patient space, letter, named view.
const FACES: [(Vec3, &str, &str); 6] = [
    (Vec3::X, "L", "left"),
    (Vec3::NEG_X, "R", "right"),
    (Vec3::Y, "P", "posterior"),
    (Vec3::NEG_Y, "A", "anterior"),
    (Vec3::Z, "S", "superior"),
    (Vec3::NEG_Z, "I", "inferior"),
];

/// Draws the cube into the upper right corner; returns the named view whose face is under the
/// pointer.
pub fn draw(
    painter: &Painter,
    rect: Rect,
    projector: &Projector,
    pointer: Option<Pos2>,
) -> Option<&'static str> {
    let middle = pos2(rect.right() - 46.0, rect.top() + 46.0);
    let frame = &projector.frame;
    let (right, up) = (frame.right.normalize_or_zero(), frame.up.normalize_or_zero());
    let flat = |v: Vec3| -> Vec2 { vec2(v.dot(right), -v.dot(up)) * EDGE };
    let mut hit = None;
    for (normal, letter, view) in FACES {
        let facing = -normal.dot(frame.forward);
        if facing < 0.02 {
            continue;
        }
        let (a, b) = normal.any_orthonormal_pair();
        // Axis-aligned corners: cyclic pairs of unit axes.
        let corners: Vec<Pos2> = [a + b, b - a, -a - b, a - b]
            .iter()
            .map(|c| middle + flat(normal + *c))
            .collect();
        let over = pointer.is_some_and(|p| inside(&corners, p));
        if over {
            hit = Some(view);
        }
        let shade = (52.0 + 70.0 * facing) as u8;
        let fill = if over {
            Color32::from_rgb(52, 110, 165)
        } else {
            Color32::from_rgba_unmultiplied(shade, shade, shade + 4, 225)
        };
        painter.add(Shape::convex_polygon(
            corners,
            fill,
            Stroke::new(1.0, Color32::from_gray(150)),
        ));
        if facing > 0.25 {
            text(
                painter,
                middle + flat(normal),
                Align2::CENTER_CENTER,
                letter,
                13.0,
                ON_CANVAS,
            );
        }
    }
    hit
}

/// Whether a point lies inside a convex polygon.
fn inside(corners: &[Pos2], p: Pos2) -> bool {
    let side = |n: usize| {
        let (a, b) = (corners[n], corners[(n + 1) % corners.len()]);
        (b - a).x * (p - a).y - (b - a).y * (p - a).x
    };
    let (low, high) = (0..corners.len())
        .map(side)
        .fold((f32::MAX, f32::MIN), |(l, h), s| (l.min(s), h.max(s)));
    low >= 0.0 || high <= 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_inside_a_square() {
        let square = [pos2(0.0, 0.0), pos2(2.0, 0.0), pos2(2.0, 2.0), pos2(0.0, 2.0)];
        assert!(inside(&square, pos2(1.0, 1.5)) && !inside(&square, pos2(2.5, 1.0)));
    }
}
