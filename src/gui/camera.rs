//! Moves the camera by drags and actions, and turns a lasso's outline, drawn in its view, into a
//! cut.

use super::projector::Projector;
use super::state::Workstation;
use super::state::log::LogLevel;
use super::state::tool::Tool;
use crate::math::Bounds;
use crate::scene::{Camera, Projection};
use eframe::egui::{Pos2, Rect};
use glam::{Vec2, Vec3};

/// Rotation of the camera per point of a drag, degrees.
const ORBIT: f32 = 0.4;

impl Workstation {
    /// Rotates the camera by a drag.
    pub fn orbit(&mut self, dx: f32, dy: f32) {
        let Some(doc) = &mut self.doc else { return };
        let camera = &mut doc.scene.camera;
        let (sin, cos) = camera.roll.to_radians().sin_cos();
        let (dx, dy) = (dx * cos + dy * sin, dy * cos - dx * sin);
        camera.view.azimuth_deg = wrap(camera.view.azimuth_deg - dx * ORBIT);
        camera.view.elevation_deg = (camera.view.elevation_deg + dy * ORBIT).clamp(-90.0, 90.0);
    }

    /// Pans the camera by a drag in a view: the scene's camera, which the displayed picture may not
    /// match yet.
    pub fn pan(&mut self, dx: f32, dy: f32, rect: Rect) {
        let size = self.view.size();
        let Some(doc) = &mut self.doc else { return };
        let Ok(frame) = doc.scene.camera.frame(&doc.bounds(), size) else {
            return;
        };
        let projector = Projector { frame, rect };
        let bounds = doc.bounds();
        let target = doc
            .scene
            .camera
            .target
            .map_or_else(|| bounds.center(), Vec3::from);
        let mm = projector.mm_per_point(target);
        let f = &projector.frame;
        let moved = target + (f.up.normalize_or_zero() * dy - f.right.normalize_or_zero() * dx) * mm;
        let reach = 4.0 * bounds.size().length();
        if (moved - bounds.center()).length() < reach {
            doc.scene.camera.target = Some(moved.into());
        }
    }

    /// Rolls the camera.
    pub(super) fn roll(&mut self, degrees: f32) {
        if let Some(doc) = &mut self.doc {
            doc.scene.camera.roll = wrap(doc.scene.camera.roll + degrees);
        }
    }

    /// Zooms the camera.
    pub fn zoom(&mut self, factor: f32) {
        if let Some(doc) = &mut self.doc {
            doc.scene.camera.zoom = (doc.scene.camera.zoom * factor).clamp(0.05, 100.0);
        }
    }

    /// Sets a named view direction.
    pub fn look_from(&mut self, view: &str) {
        if let (Some(doc), Ok(view)) = (&mut self.doc, view.parse()) {
            doc.scene.camera.view = view;
            doc.scene.camera.roll = 0.0;
        }
    }

    /// Fits a box into the view.
    pub fn frame_box(&mut self, bounds: &Bounds) {
        let Some(doc) = &mut self.doc else { return };
        let all = doc.bounds().size().length().max(1e-3);
        let camera = &mut doc.scene.camera;
        camera.target = Some(bounds.center().into());
        camera.zoom = (all / bounds.size().length().max(1e-3)).clamp(0.05, 20.0);
    }

    /// Resets the camera, keeping its projection.
    pub fn reset_camera(&mut self) {
        if let Some(doc) = &mut self.doc {
            let camera = &doc.scene.camera;
            doc.scene.camera = Camera {
                projection: camera.projection,
                field_of_view: camera.field_of_view,
                ..Camera::default()
            };
        }
    }

    /// Turns the drawn outline into a cut, or restores the region inside it.
    pub(super) fn finish_lasso(&mut self) {
        let outline = std::mem::take(&mut self.view.lasso);
        let (Some(doc), Some(projector)) = (&self.doc, self.view.lasso_on.take()) else {
            return;
        };
        if outline.len() < 3 || area(&outline) < 25.0 {
            return;
        }
        let frame = projector.frame;
        let middle = doc.bounds().center();
        let (right, up) = (frame.right.normalize_or_zero(), frame.up.normalize_or_zero());
        let points: Vec<Vec2> = outline
            .iter()
            .filter_map(|p| projector.on_plane(*p, middle, frame.forward))
            .map(|p| Vec2::new((p - middle).dot(right), (p - middle).dot(up)))
            .collect();
        let apex = match frame.projection {
            // The apex lies on the view line through the plane's origin, so the origin is moved
            // onto the eye's axis.
            Projection::Perspective => Some((middle - frame.eye).dot(frame.forward)),
            Projection::Orthographic => None,
        };
        let (origin, shift) = match apex {
            Some(depth) => {
                let origin = frame.eye + frame.forward * depth;
                (
                    origin,
                    Vec2::new((middle - origin).dot(right), (middle - origin).dot(up)),
                )
            }
            None => (middle, Vec2::ZERO),
        };
        if points.len() < 3 || apex.is_some_and(|depth| depth <= 1.0) {
            self.report(
                LogLevel::Info,
                "The outline is behind the camera; reset the camera (R) and redraw it",
            );
            return;
        }
        let restore = self.tool == Tool::LassoRestore;
        let points: Vec<Vec2> = points.into_iter().map(|p| p + shift).collect();
        self.lasso(restore, apex.unwrap_or(0.0), origin, right, up, points);
    }
}

/// An angle wrapped to -180 to 180 degrees.
fn wrap(degrees: f32) -> f32 {
    let wrapped = (degrees + 180.0).rem_euclid(360.0) - 180.0;
    if wrapped.is_finite() { wrapped } else { 0.0 }
}

/// Area of an outline, square points.
fn area(outline: &[Pos2]) -> f32 {
    let n = outline.len();
    (0..n)
        .map(|i| (outline[i].x * outline[(i + 1) % n].y) - (outline[(i + 1) % n].x * outline[i].y))
        .sum::<f32>()
        .abs()
        / 2.0
}
