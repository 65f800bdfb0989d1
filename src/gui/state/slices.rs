//! The slice views.

use super::shown::OutdatedNotice;
use super::slice_paint::{Overlay, SliceStyle};
use super::worker::SlicePicture;
use crate::cpu::section::SectionPlane;
use crate::prepare::Assets;
use crate::scene::Scene;
use eframe::egui::{self, Rect};
use glam::Vec3;
use std::sync::Arc;

/// Which anatomy slices show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Space {
    /// The deformed scene.
    #[default]
    Deformed,
    /// The volume as it was.
    Source,
    /// Both, their crosshairs on the same matter.
    Linked,
}

/// What a slice view was asked for.
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

/// One of the three, deformed or source.
#[derive(Default)]
pub(in crate::gui) struct Pane {
    pub(in crate::gui) rect: Option<Rect>,
    pub(in crate::gui) texture: Option<egui::TextureHandle>,
    /// What is shown, and what it was asked for.
    pub(in crate::gui) picture: Option<(SlicePicture, SliceRequest)>,
    pub(in crate::gui) requested: Option<SliceRequest>,
    /// What jobs that are not done yet were asked for.
    pub(in crate::gui) open: Vec<(u64, SliceRequest)>,
    pub(in crate::gui) delay: OutdatedNotice,
}

impl Pane {
    pub(in crate::gui) fn take_request(&mut self, serial: u64) -> Option<SliceRequest> {
        let found = self.open.iter().position(|(n, _)| *n == serial).map(|at| self.open.remove(at).1);
        self.open.retain(|(n, _)| *n > serial);
        found
    }

    pub(in crate::gui) fn is_current(&self) -> bool {
        self.picture.as_ref().zip(self.requested.as_ref()).is_some_and(|((_, of), requested)| of.is(requested))
    }
}

/// The three slice views.
pub struct Slices {
    /// The crosshair in the deformed scene, mm.
    pub cursor: Option<Vec3>,
    /// Magnification beyond fitting.
    pub zoom: f32,
    /// Shift of each view, mm along its right and down.
    pub(in crate::gui) pan: [egui::Vec2; 3],
    /// What is shown over them.
    pub overlay: Overlay,
    /// Which anatomy.
    pub space: Space,
    pub(in crate::gui) panes: [Pane; 6],
    /// The scene without what slices do not depend on.
    pub(in crate::gui) scene: Option<Arc<Scene>>,
    /// Turns of the wheel that are no whole slice yet, points.
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
    /// Forgets a scene.
    pub fn forget(&mut self) {
        *self = Self { overlay: self.overlay, space: self.space, ..Self::default() };
    }

    /// Takes a slice that has arrived.
    pub fn arrived(&mut self, ctx: &egui::Context, n: usize, serial: u64, picture: SlicePicture) {
        let Some(pane) = self.panes.get_mut(n) else { return };
        // Of a scene that is gone.
        let Some(of) = pane.take_request(serial) else { return };
        let options = egui::TextureOptions::LINEAR;
        let image = picture.image.clone();
        match &mut pane.texture {
            Some(texture) => texture.set(image, options),
            None => pane.texture = Some(ctx.load_texture(format!("slice {n}"), image, options)),
        }
        pane.picture = Some((picture, of));
        pane.delay.restart();
    }

    /// A slice could not be made.
    pub fn failed(&mut self, n: usize, serial: u64, problem: &str) {
        let Some(pane) = self.panes.get_mut(n) else { return };
        let of = pane.take_request(serial);
        if of.zip(pane.requested.as_ref()).is_some_and(|(of, requested)| of.is(requested)) {
            pane.delay.failure = Some(problem.to_owned());
        }
    }

    /// Whether every shown slice has its picture.
    pub fn are_there(&self) -> bool {
        self.panes.iter().filter(|p| p.rect.is_some()).all(|p| p.picture.is_some())
    }

    /// Where the matter at a point of a deformed slice came from; none off the slice that is shown.
    pub(in crate::gui) fn source_of(&self, n: usize, world: Vec3) -> Option<Vec3> {
        let picture = self.picture(n)?;
        let (x, y, away) = picture.plane.pixel(world);
        let [width, height] = picture.plane.size;
        let inside = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32 && away.abs() < 2.0 * picture.plane.mm_per_pixel.max(0.5);
        inside.then(|| picture.source(world))
    }

    /// The crosshair in the source, from whichever slice shows it.
    pub fn source_cursor(&self) -> Option<Vec3> {
        let cursor = self.cursor?;
        (0..3).find_map(|n| self.source_of(n, cursor))
    }

    /// What a view shows: axial, coronal, sagittal; from 3 on the same of the source.
    pub fn picture(&self, n: usize) -> Option<&SlicePicture> {
        self.panes.get(n)?.picture.as_ref().map(|(picture, _)| picture)
    }
}
