//! The 3D view.

use super::shown::{DisplayedPicture, OutdatedNotice, PictureRequest};
use super::worker::{JobTarget, RenderedView};
use crate::engine::DeviceInfo;
use crate::gui::gizmos::Mode as GizmoMode;
use crate::gui::projector::Projector;
use crate::scene::Deformation;
use eframe::egui::{self, Pos2, Rect};
use std::time::Instant;

/// Target time of a coarse picture, ms.
pub(in crate::gui) const COARSE_MS: f64 = 70.0;
/// State of the 3D view.
pub struct View3d {
    /// Its last rectangle, points.
    pub rect: Rect,
    pub(in crate::gui) picture: Option<DisplayedPicture>,
    /// The last request.
    pub(in crate::gui) requested: Option<PictureRequest>,
    /// The requests of pending jobs.
    pub(in crate::gui) open: Vec<(u64, PictureRequest)>,
    pub(in crate::gui) delay: OutdatedNotice,
    pub(in crate::gui) changed_at: Instant,
    pub(in crate::gui) coarse_open: bool,
    pub(in crate::gui) fine_serial: Option<u64>,
    /// Whether a fine picture of the last request has arrived.
    pub is_fine: bool,
    /// Pixels of the view per pixel of a coarse picture.
    pub(in crate::gui) scale: f32,
    pub(in crate::gui) fine_ms: f64,
    /// Facts about the last picture, for the status bar.
    pub facts: Facts,
    /// The set of handles.
    pub gizmo: GizmoMode,
    /// The outline being drawn, points.
    pub lasso: Vec<Pos2>,
    /// The projector of the picture on which it is drawn.
    pub(in crate::gui) lasso_on: Option<Projector>,
    /// The deformation as left by the last drag of a handle.
    pub(in crate::gui) dragged: Option<Deformation>,
    pub(in crate::gui) hover_requested: Option<([f32; 2], u64)>,
    pub(in crate::gui) pixels_per_point: f32,
    /// Number of pictures that have arrived.
    pub pictures: u64,
}

/// Facts about the last picture.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// Time, ms.
    pub ms: f64,
    /// The device that rendered it.
    pub device: Option<DeviceInfo>,
    /// Its size, pixels.
    pub size: [usize; 2],
    /// Whether it is a draft, for a moving view.
    pub is_draft: bool,
    /// Sampling distance, voxels.
    pub step: f32,
    /// Notices for the user, one sentence each.
    pub notices: Vec<String>,
    /// Why the picture is empty, if it is.
    pub blank: Option<String>,
}

impl Default for View3d {
    fn default() -> Self {
        Self {
            rect: Rect::ZERO,
            picture: None,
            requested: None,
            open: Vec::new(),
            delay: OutdatedNotice::default(),
            changed_at: Instant::now(),
            coarse_open: false,
            fine_serial: None,
            is_fine: false,
            scale: 3.0,
            fine_ms: f64::INFINITY,
            facts: Facts::default(),
            gizmo: GizmoMode::Shape,
            lasso: Vec::new(),
            lasso_on: None,
            dragged: None,
            hover_requested: None,
            pixels_per_point: 1.0,
            pictures: 0,
        }
    }
}

impl View3d {
    /// The projector for the displayed picture's camera.
    pub fn projector(&self) -> Option<Projector> {
        Some(self.picture()?.projector(self.rect, self.size()))
    }

    /// Discards the requests, so that pictures are requested again.
    pub fn forget(&mut self) {
        self.requested = None;
        self.is_fine = false;
        self.coarse_open = false;
        self.fine_serial = None;
        self.fine_ms = f64::INFINITY;
    }

    /// The view's size in pixels.
    pub fn size(&self) -> [u32; 2] {
        let size = self.rect.size() * self.pixels_per_point;
        [(size.x as u32).clamp(16, 8192), (size.y as u32).clamp(16, 8192)]
    }

    /// Clears the view: its picture shows another scene.
    pub fn clear(&mut self) {
        self.forget();
        self.picture = None;
        self.open.clear();
        self.delay = OutdatedNotice::default();
        self.facts = Facts::default();
    }

    /// The displayed picture.
    pub fn picture(&self) -> Option<&DisplayedPicture> {
        self.picture.as_ref()
    }

    /// Whether the displayed picture matches the last request.
    pub fn is_current(&self) -> bool {
        self.picture
            .as_ref()
            .zip(self.requested.as_ref())
            .is_some_and(|(p, a)| p.of.is(a))
    }

    /// Why the scene cannot be shown as it is.
    pub fn failure(&self) -> Option<&str> {
        self.delay.failure.as_deref()
    }

    /// Takes the request of a job; requests of older jobs are dropped.
    pub(in crate::gui) fn take_request(&mut self, serial: u64) -> Option<PictureRequest> {
        let found = self
            .open
            .iter()
            .position(|(n, _)| *n == serial)
            .map(|at| self.open.remove(at).1);
        self.open.retain(|(n, _)| *n > serial);
        found
    }

    /// Stores a picture that has arrived.
    pub fn arrived(
        &mut self,
        ctx: &egui::Context,
        target: JobTarget,
        serial: u64,
        ms: f64,
        shown: RenderedView,
    ) {
        let of = self.take_request(serial);
        if target == JobTarget::Coarse {
            self.coarse_open = false;
            let wanted = self.scale * ((ms / COARSE_MS) as f32).sqrt().clamp(0.6, 1.7);
            self.scale = wanted.clamp(1.0, 8.0);
            if self.is_fine {
                // A fine picture has already arrived.
                return;
            }
        } else {
            if self.fine_serial != Some(serial) {
                return;
            }
            self.is_fine = true;
            self.fine_ms = ms;
        }
        // Without a matching request, it belongs to a scene that has been closed.
        let Some(of) = of else { return };
        self.pictures += 1;
        self.facts = Facts {
            ms,
            device: Some(shown.device),
            size: shown.image.size,
            is_draft: target == JobTarget::Coarse,
            step: shown.step,
            notices: shown.notices,
            blank: shown.blank,
        };
        let options = egui::TextureOptions::LINEAR;
        let texture = match self.picture.take() {
            Some(mut before) => {
                before.texture.set(shown.image, options);
                before.texture
            }
            None => ctx.load_texture("3D", shown.image, options),
        };
        self.picture = Some(DisplayedPicture {
            texture,
            of,
            frame: shown.frame,
            measured: shown.measured,
            serial,
        });
        self.delay.restart();
        let current = self.is_current();
        self.delay.note(current);
    }

    /// Handles a failed job of this view.
    pub fn failed(&mut self, target: JobTarget, serial: u64, problem: &str) {
        if target == JobTarget::Coarse {
            self.coarse_open = false;
        }
        let of = self.take_request(serial);
        if of
            .zip(self.requested.as_ref())
            .is_some_and(|(of, requested)| of.is(requested))
        {
            self.delay.failure = Some(problem.to_owned());
        }
    }
}
