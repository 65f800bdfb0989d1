//! The slice views.

use super::document::Document;
use super::shown::OutdatedNotice;
use super::slice_paint::{Overlay, SliceStyle};
use super::worker::SlicePicture;
use crate::cpu::section::SectionPlane;
use crate::prepare::Assets;
use crate::scene::Scene;
use eframe::egui::{self, Rect};
use glam::Vec3;
use std::sync::Arc;

/// Wheel movement for one slice, points.
const NOTCH: f32 = 40.0;
/// Names, rightward and downward directions: patient left on the right, by radiological convention.
pub const ORIENTATIONS: [(&str, Vec3, Vec3); 3] = [
    ("Axial", Vec3::X, Vec3::Y),
    ("Coronal", Vec3::X, Vec3::NEG_Z),
    ("Sagittal", Vec3::Y, Vec3::NEG_Z),
];

/// The space that slices show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Space {
    /// The deformed scene.
    #[default]
    Deformed,
    /// The undeformed volume.
    Source,
    /// Both, with crosshairs at corresponding points.
    Linked,
}

/// The content requested for a slice view.
#[derive(Clone)]
pub(in crate::gui) struct SliceRequest {
    pub(in crate::gui) scene: Arc<Scene>,
    pub(in crate::gui) assets: Arc<Assets>,
    pub(in crate::gui) plane: SectionPlane,
    pub(in crate::gui) style: SliceStyle,
}

impl SliceRequest {
    pub(in crate::gui) fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.assets, &other.assets)
            && self.plane == other.plane
            && self.style == other.style
            && (Arc::ptr_eq(&self.scene, &other.scene) || self.scene == other.scene)
    }
}

/// One slice view, deformed or source.
#[derive(Default)]
pub(in crate::gui) struct Pane {
    pub(in crate::gui) rect: Option<Rect>,
    pub(in crate::gui) texture: Option<egui::TextureHandle>,
    /// The displayed slice, and the request it shows.
    pub(in crate::gui) picture: Option<(SlicePicture, SliceRequest)>,
    pub(in crate::gui) requested: Option<SliceRequest>,
    /// The requests of pending jobs.
    pub(in crate::gui) open: Vec<(u64, SliceRequest)>,
    pub(in crate::gui) delay: OutdatedNotice,
}

impl Pane {
    pub(in crate::gui) fn take_request(&mut self, serial: u64) -> Option<SliceRequest> {
        let found = self
            .open
            .iter()
            .position(|(n, _)| *n == serial)
            .map(|at| self.open.remove(at).1);
        self.open.retain(|(n, _)| *n > serial);
        found
    }

    pub(in crate::gui) fn is_current(&self) -> bool {
        self.picture
            .as_ref()
            .zip(self.requested.as_ref())
            .is_some_and(|((_, of), requested)| of.is(requested))
    }
}

/// The three slice views.
pub struct Slices {
    /// The crosshair in the deformed scene, mm.
    pub cursor: Option<Vec3>,
    /// Magnification relative to fitting the view.
    pub zoom: f32,
    /// Pan of each view, mm along its right and down.
    pub(in crate::gui) pan: [egui::Vec2; 3],
    /// The overlay.
    pub overlay: Overlay,
    /// The space that is shown.
    pub space: Space,
    pub(in crate::gui) panes: [Pane; 6],
    /// The scene reduced to what slices depend on.
    pub(in crate::gui) scene: Option<Arc<Scene>>,
    /// Wheel movement that does not add up to a whole slice yet, points.
    pub(in crate::gui) wheel: f32,
}

impl Default for Slices {
    fn default() -> Self {
        Self {
            cursor: None,
            zoom: 1.0,
            pan: [egui::Vec2::ZERO; 3],
            overlay: Overlay::None,
            space: Space::Deformed,
            panes: Default::default(),
            scene: None,
            wheel: 0.0,
        }
    }
}

impl Slices {
    /// Scrolls through the slices of a view.
    pub(in crate::gui) fn scroll(&mut self, doc: &Document, n: usize, scroll: f32) {
        let (_, right, down) = ORIENTATIONS[n];
        let normal = right.cross(down).abs();
        // The slice spacing along the volume axis closest to this direction.
        let (directions, spacing) = (doc.assets.volume.direction(), doc.assets.volume.spacing_mm());
        let along = |a: usize| directions.col(a).as_vec3().dot(normal).abs();
        let axis = (0..3).max_by(|a, b| along(*a).total_cmp(&along(*b))).unwrap_or(2);
        let step = spacing[axis] as f32;
        // One notch of the wheel arrives as many small events.
        self.wheel += scroll;
        let steps = (self.wheel / NOTCH).trunc();
        self.wheel -= steps * NOTCH;
        let bounds = doc.bounds();
        if let Some(cursor) = &mut self.cursor {
            *cursor = (*cursor + normal * steps * step).clamp(bounds.min, bounds.max);
        }
    }

    /// Resets the state for another scene.
    pub fn forget(&mut self) {
        *self = Self {
            overlay: self.overlay,
            space: self.space,
            ..Self::default()
        };
    }

    /// Stores a slice that has arrived.
    pub fn arrived(&mut self, ctx: &egui::Context, n: usize, serial: u64, picture: SlicePicture) {
        let Some(pane) = self.panes.get_mut(n) else { return };
        // Without a matching request, it belongs to a scene that has been closed.
        let Some(of) = pane.take_request(serial) else {
            return;
        };
        let options = egui::TextureOptions::LINEAR;
        let image = picture.image.clone();
        match &mut pane.texture {
            Some(texture) => texture.set(image, options),
            None => pane.texture = Some(ctx.load_texture(format!("slice {n}"), image, options)),
        }
        pane.picture = Some((picture, of));
        pane.delay.restart();
    }

    /// Handles a slice that could not be rendered.
    pub fn failed(&mut self, n: usize, serial: u64, problem: &str) {
        let Some(pane) = self.panes.get_mut(n) else { return };
        let of = pane.take_request(serial);
        if of
            .zip(pane.requested.as_ref())
            .is_some_and(|(of, requested)| of.is(requested))
        {
            pane.delay.failure = Some(problem.to_owned());
        }
    }

    /// Whether every visible slice view has a picture.
    pub fn are_there(&self) -> bool {
        self.panes
            .iter()
            .filter(|p| p.rect.is_some())
            .all(|p| p.picture.is_some())
    }

    /// The source point of a point on a deformed slice; none if the point is not on the displayed
    /// slice.
    pub(in crate::gui) fn source_of(&self, n: usize, world: Vec3) -> Option<Vec3> {
        let picture = self.picture(n)?;
        let (x, y, away) = picture.plane.pixel(world);
        let [width, height] = picture.plane.size;
        let inside = x >= 0.0
            && y >= 0.0
            && x < width as f32
            && y < height as f32
            && away.abs() < 2.0 * picture.plane.mm_per_pixel.max(0.5);
        inside.then(|| picture.source(world))
    }

    /// The source point of the crosshair, from any slice that shows it.
    pub fn source_cursor(&self) -> Option<Vec3> {
        let cursor = self.cursor?;
        (0..3).find_map(|n| self.source_of(n, cursor))
    }

    /// The slice of a view: axial, coronal, sagittal; from 3 on, the same of the source.
    pub fn picture(&self, n: usize) -> Option<&SlicePicture> {
        self.panes.get(n)?.picture.as_ref().map(|(picture, _)| picture)
    }
}
