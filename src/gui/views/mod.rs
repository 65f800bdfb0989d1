//! The pictures: the 3D view and the slices, with what is drawn and grabbed on them.

pub mod cube;
pub mod shown;
pub mod slice_paint;
pub mod slices;
pub mod volume3d;

pub use volume3d::draw_points as draw_points_of;

use super::theme::ON_CANVAS;
use crate::scene::{Projection, ViewFrame};
use eframe::egui::{Align2, Color32, FontId, Painter, Pos2, Rect, Stroke, pos2, vec2};
use glam::Vec3;

/// The camera of a view and its place on the screen.
#[derive(Clone, Copy, Debug)]
pub struct Projector {
    /// The camera.
    pub frame: ViewFrame,
    /// Where the picture is, points.
    pub rect: Rect,
}

impl Projector {
    /// Picture coordinates in -1..1 (v upwards) of a world point and its depth, mm; none behind the eye.
    pub fn uv(&self, world: Vec3) -> Option<(f32, f32, f32)> {
        let d = world - self.frame.eye;
        let depth = d.dot(self.frame.forward);
        if depth <= 1e-3 {
            return None;
        }
        let scale = match self.frame.projection {
            Projection::Perspective => depth,
            Projection::Orthographic => 1.0,
        };
        let u = d.dot(self.frame.right) / self.frame.right.length_squared() / scale;
        let v = d.dot(self.frame.up) / self.frame.up.length_squared() / scale;
        (u.is_finite() && v.is_finite()).then_some((u, v, depth))
    }

    /// Where a world point is on the screen.
    pub fn screen(&self, world: Vec3) -> Option<Pos2> {
        let (u, v, _) = self.uv(world)?;
        let at = self.rect.center() + vec2(u * self.rect.width() / 2.0, -v * self.rect.height() / 2.0);
        (at.x.abs() < 1e5 && at.y.abs() < 1e5).then_some(at)
    }

    /// Picture coordinates of a place on the screen.
    pub fn at(&self, pos: Pos2) -> [f32; 2] {
        let d = pos - self.rect.center();
        [2.0 * d.x / self.rect.width().max(1.0), -2.0 * d.y / self.rect.height().max(1.0)]
    }

    /// The ray through a place on the screen: origin and unit direction.
    pub fn ray(&self, pos: Pos2) -> (Vec3, Vec3) {
        let [u, v] = self.at(pos);
        self.frame.ray(u, v)
    }

    /// Length of a point of the screen at the depth of a world point, mm.
    pub fn mm_per_point(&self, world: Vec3) -> f32 {
        let scale = match self.frame.projection {
            Projection::Perspective => (world - self.frame.eye).dot(self.frame.forward).max(1e-3),
            Projection::Orthographic => 1.0,
        };
        2.0 * self.frame.up.length() * scale / self.rect.height().max(1.0)
    }

    /// Where the ray through a place on the screen meets a plane.
    pub fn on_plane(&self, pos: Pos2, point: Vec3, normal: Vec3) -> Option<Vec3> {
        let (origin, direction) = self.ray(pos);
        let facing = direction.dot(normal);
        if facing.abs() < 1e-4 {
            return None;
        }
        let t = (point - origin).dot(normal) / facing;
        (t.is_finite() && (t > 0.0 || self.frame.projection == Projection::Orthographic)).then(|| origin + direction * t)
    }

    /// How far along a line (mm) the point nearest to the ray through a place on the screen lies.
    pub fn along_line(&self, pos: Pos2, point: Vec3, direction: Vec3) -> Option<f32> {
        let (origin, ray) = self.ray(pos);
        let line = direction.normalize_or_zero();
        let (w, b) = (point - origin, line.dot(ray));
        let denominator = 1.0 - b * b;
        if denominator < 1e-4 {
            return None;
        }
        Some((b * ray.dot(w) - line.dot(w)) / denominator)
    }
}

/// The letters of the directions of a unit vector in the patient, the strongest first: `L`, `LA`.
pub fn letters(direction: Vec3) -> String {
    let names = [('L', 'R'), ('P', 'A'), ('S', 'I')];
    let mut axes: Vec<usize> = (0..3).filter(|&a| direction[a].abs() > 0.35).collect();
    axes.sort_by(|&a, &b| direction[b].abs().total_cmp(&direction[a].abs()));
    axes.iter().take(2).map(|&a| if direction[a] > 0.0 { names[a].0 } else { names[a].1 }).collect()
}

/// Text on a picture, with a dark rim so that it can be read on anything.
pub fn text(painter: &Painter, at: Pos2, align: Align2, text: impl ToString, size: f32, color: Color32) -> Rect {
    let font = FontId::proportional(size);
    let text = text.to_string();
    let rim = Color32::from_black_alpha(200);
    for d in [vec2(-1.0, 0.0), vec2(1.0, 0.0), vec2(0.0, -1.0), vec2(0.0, 1.0)] {
        painter.text(at + d, align, &text, font.clone(), rim);
    }
    painter.text(at, align, &text, font, color)
}

/// The letters at the four edges of a picture whose right and upward directions are given.
pub fn edge_letters(painter: &Painter, rect: Rect, right: Vec3, up: Vec3) {
    let inset = 8.0;
    for (at, align, direction) in [
        (pos2(rect.right() - inset, rect.center().y), Align2::RIGHT_CENTER, right),
        (pos2(rect.left() + inset, rect.center().y), Align2::LEFT_CENTER, -right),
        (pos2(rect.center().x, rect.top() + inset), Align2::CENTER_TOP, up),
        (pos2(rect.center().x, rect.bottom() - inset), Align2::CENTER_BOTTOM, -up),
    ] {
        text(painter, at, align, letters(direction), 14.0, ON_CANVAS);
    }
}

/// A bar of a round length in the lower right corner.
pub fn scale_bar(painter: &Painter, rect: Rect, mm_per_point: f32) {
    let longest = mm_per_point * rect.width() * 0.28;
    if !(longest.is_finite() && longest > 1e-3) {
        return;
    }
    let decade = 10f32.powf(longest.log10().floor());
    let mm = [5.0, 2.0, 1.0].into_iter().map(|f| f * decade).find(|mm| *mm <= longest).unwrap_or(decade);
    let length = mm / mm_per_point;
    let (x, y) = (rect.right() - 14.0, rect.bottom() - 14.0);
    for (color, width) in [(Color32::from_black_alpha(200), 4.0), (ON_CANVAS, 2.0)] {
        let stroke = Stroke::new(width, color);
        painter.line_segment([pos2(x - length, y), pos2(x, y)], stroke);
        painter.line_segment([pos2(x - length, y - 4.0), pos2(x - length, y + 4.0)], stroke);
        painter.line_segment([pos2(x, y - 4.0), pos2(x, y + 4.0)], stroke);
    }
    text(painter, pos2(x - length / 2.0, y - 6.0), Align2::CENTER_BOTTOM, format!("{mm} mm"), 13.0, ON_CANVAS);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Bounds;
    use crate::scene::Camera;

    fn projectors() -> Vec<Projector> {
        let bounds = Bounds::new(Vec3::splat(-50.0), Vec3::splat(50.0));
        [Projection::Perspective, Projection::Orthographic]
            .map(|projection| {
                let camera = Camera { view: "30,20".parse().unwrap(), projection, ..Camera::default() };
                Projector { frame: camera.frame(&bounds, [400, 200]).unwrap(), rect: Rect::from_min_size(pos2(10.0, 20.0), vec2(400.0, 200.0)) }
            })
            .into()
    }

    #[test]
    fn a_point_lies_on_the_ray_through_its_place_on_the_screen() {
        for p in projectors() {
            let world = Vec3::new(12.0, -7.0, 20.0);
            let (origin, direction) = p.ray(p.screen(world).unwrap());
            let away = (world - origin).cross(direction).length();
            assert!(away < 1e-2, "{away}");
            let at = p.on_plane(p.screen(world).unwrap(), world, p.frame.forward).unwrap();
            assert!((at - world).length() < 2e-2);
            let t = p.along_line(p.screen(world + Vec3::X * 9.0).unwrap(), world, Vec3::X * 3.0).unwrap();
            assert!((t - 9.0).abs() < 2e-2, "{t}");
        }
    }

    /// Two points a millimetre apart across the view are as far apart on the screen as it says.
    #[test]
    fn the_scale_is_that_of_the_screen() {
        for p in projectors() {
            let world = Vec3::new(5.0, 5.0, 5.0);
            let across = world + p.frame.up.normalize() * 10.0;
            let points = p.screen(world).unwrap().distance(p.screen(across).unwrap());
            assert!((points * p.mm_per_point(world) / 10.0 - 1.0).abs() < 0.01);
        }
    }

    #[test]
    fn letters_say_where() {
        assert_eq!(letters(Vec3::X), "L");
        assert_eq!(letters(Vec3::NEG_Y), "A");
        assert_eq!(letters(Vec3::new(0.5, 0.0, -0.86)), "IL");
    }
}
