//! The pictures: the 3D view and the slices, with their overlays and pointer interaction.

pub mod cube;
pub mod shown;
pub mod slices;
pub mod volume3d;

pub use volume3d::draw_points as draw_points_of;

use super::theme::ON_CANVAS;
use eframe::egui::{Align2, Color32, FontId, Painter, Pos2, Rect, Stroke, pos2, vec2};
use glam::Vec3;

/// The letters of a unit direction in patient space, the dominant one first: `L`, `LA`.
pub fn letters(direction: Vec3) -> String {
    let names = [('L', 'R'), ('P', 'A'), ('S', 'I')];
    let mut axes: Vec<usize> = (0..3).filter(|&a| direction[a].abs() > 0.35).collect();
    axes.sort_by(|&a, &b| direction[b].abs().total_cmp(&direction[a].abs()));
    axes.iter()
        .take(2)
        .map(|&a| {
            if direction[a] > 0.0 {
                names[a].0
            } else {
                names[a].1
            }
        })
        .collect()
}

/// Text on a picture, with a dark outline that keeps it readable on any background.
pub fn text(
    painter: &Painter,
    at: Pos2,
    align: Align2,
    text: impl ToString,
    size: f32,
    color: Color32,
) -> Rect {
    let font = FontId::proportional(size);
    let text = text.to_string();
    let rim = Color32::from_black_alpha(200);
    for d in [vec2(-1.0, 0.0), vec2(1.0, 0.0), vec2(0.0, -1.0), vec2(0.0, 1.0)] {
        painter.text(at + d, align, &text, font.clone(), rim);
    }
    painter.text(at, align, &text, font, color)
}

/// The orientation letters at the four edges of a picture, given its right and upward directions.
pub fn edge_letters(painter: &Painter, rect: Rect, right: Vec3, up: Vec3) {
    let inset = 8.0;
    for (at, align, direction) in [
        (
            pos2(rect.right() - inset, rect.center().y),
            Align2::RIGHT_CENTER,
            right,
        ),
        (
            pos2(rect.left() + inset, rect.center().y),
            Align2::LEFT_CENTER,
            -right,
        ),
        (pos2(rect.center().x, rect.top() + inset), Align2::CENTER_TOP, up),
        (
            pos2(rect.center().x, rect.bottom() - inset),
            Align2::CENTER_BOTTOM,
            -up,
        ),
    ] {
        text(painter, at, align, letters(direction), 14.0, ON_CANVAS);
    }
}

/// A scale bar of a round length in the lower right corner.
pub fn scale_bar(painter: &Painter, rect: Rect, mm_per_point: f32) {
    let longest = mm_per_point * rect.width() * 0.28;
    if !(longest.is_finite() && longest > 1e-3) {
        return;
    }
    let decade = 10f32.powf(longest.log10().floor());
    let mm = [5.0, 2.0, 1.0]
        .into_iter()
        .map(|f| f * decade)
        .find(|mm| *mm <= longest)
        .unwrap_or(decade);
    let length = mm / mm_per_point;
    let (x, y) = (rect.right() - 14.0, rect.bottom() - 14.0);
    for (color, width) in [(Color32::from_black_alpha(200), 4.0), (ON_CANVAS, 2.0)] {
        let stroke = Stroke::new(width, color);
        painter.line_segment([pos2(x - length, y), pos2(x, y)], stroke);
        painter.line_segment([pos2(x - length, y - 4.0), pos2(x - length, y + 4.0)], stroke);
        painter.line_segment([pos2(x, y - 4.0), pos2(x, y + 4.0)], stroke);
    }
    text(
        painter,
        pos2(x - length / 2.0, y - 6.0),
        Align2::CENTER_BOTTOM,
        format!("{mm} mm"),
        13.0,
        ON_CANVAS,
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_say_where() {
        assert_eq!(letters(Vec3::X), "L");
        assert_eq!(letters(Vec3::NEG_Y), "A");
        assert_eq!(letters(Vec3::new(0.5, 0.0, -0.86)), "IL");
    }
}
