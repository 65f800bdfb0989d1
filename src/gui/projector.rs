//! Projection between a view's world space and the screen.

use crate::scene::{Projection, ViewFrame};
use eframe::egui::{Pos2, Rect, vec2};
use glam::Vec3;

/// The camera of a view and its rectangle on the screen.
#[derive(Clone, Copy, Debug)]
pub struct Projector {
    /// The camera.
    pub frame: ViewFrame,
    /// Rectangle of the picture, points.
    pub rect: Rect,
}

impl Projector {
    /// Picture coordinates in -1..1 (v upwards) of a world point and its depth, mm; none behind the
    /// eye.
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

    /// The screen position of a world point.
    pub fn screen(&self, world: Vec3) -> Option<Pos2> {
        let (u, v, _) = self.uv(world)?;
        let at = self.rect.center() + vec2(u * self.rect.width() / 2.0, -v * self.rect.height() / 2.0);
        (at.x.abs() < 1e5 && at.y.abs() < 1e5).then_some(at)
    }

    /// Picture coordinates of a screen position.
    pub fn at(&self, pos: Pos2) -> [f32; 2] {
        let d = pos - self.rect.center();
        [
            2.0 * d.x / self.rect.width().max(1.0),
            -2.0 * d.y / self.rect.height().max(1.0),
        ]
    }

    /// The ray through a screen position: origin and unit direction.
    pub fn ray(&self, pos: Pos2) -> (Vec3, Vec3) {
        let [u, v] = self.at(pos);
        self.frame.ray(u, v)
    }

    /// Length of one screen point at the depth of a world point, mm.
    pub fn mm_per_point(&self, world: Vec3) -> f32 {
        let scale = match self.frame.projection {
            Projection::Perspective => (world - self.frame.eye).dot(self.frame.forward).max(1e-3),
            Projection::Orthographic => 1.0,
        };
        2.0 * self.frame.up.length() * scale / self.rect.height().max(1.0)
    }

    /// The intersection of the ray through a screen position with a plane.
    pub fn on_plane(&self, pos: Pos2, point: Vec3, normal: Vec3) -> Option<Vec3> {
        let (origin, direction) = self.ray(pos);
        let facing = direction.dot(normal);
        if facing.abs() < 1e-4 {
            return None;
        }
        let t = (point - origin).dot(normal) / facing;
        (t.is_finite() && (t > 0.0 || self.frame.projection == Projection::Orthographic))
            .then(|| origin + direction * t)
    }

    /// Position along a line (mm) of the point nearest to the ray through a screen position.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Bounds;
    use crate::scene::Camera;
    use eframe::egui::pos2;

    fn projectors() -> Vec<Projector> {
        let bounds = Bounds::new(Vec3::splat(-50.0), Vec3::splat(50.0));
        [Projection::Perspective, Projection::Orthographic]
            .map(|projection| {
                let camera = Camera {
                    view: "30,20".parse().unwrap(),
                    projection,
                    ..Camera::default()
                };
                Projector {
                    frame: camera.frame(&bounds, [400, 200]).unwrap(),
                    rect: Rect::from_min_size(pos2(10.0, 20.0), vec2(400.0, 200.0)),
                }
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
            let at = p
                .on_plane(p.screen(world).unwrap(), world, p.frame.forward)
                .unwrap();
            assert!((at - world).length() < 2e-2);
            let t = p
                .along_line(p.screen(world + Vec3::X * 9.0).unwrap(), world, Vec3::X * 3.0)
                .unwrap();
            assert!((t - 9.0).abs() < 2e-2, "{t}");
        }
    }

    /// Two points 10 mm apart across the view have the screen distance that the scale gives.
    #[test]
    fn the_scale_is_that_of_the_screen() {
        for p in projectors() {
            let world = Vec3::new(5.0, 5.0, 5.0);
            let across = world + p.frame.up.normalize() * 10.0;
            let points = p.screen(world).unwrap().distance(p.screen(across).unwrap());
            assert!((points * p.mm_per_point(world) / 10.0 - 1.0).abs() < 0.01);
        }
    }
}
