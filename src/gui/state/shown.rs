//! What is on the screen, as opposed to what the scene has become since.

use super::worker::MeasureResult;
use crate::gui::projector::Projector;
use crate::prepare::Assets;
use crate::scene::{Scene, ViewFrame};
use eframe::egui::{Rect, TextureHandle, vec2};
use std::sync::Arc;
use std::time::Instant;

/// A picture may be behind the scene for this long before it is veiled, seconds.
const PATIENCE: f32 = 0.4;
/// The veil thickens over this time, seconds.
const THICKENING: f32 = 0.6;

/// What a view is to show.
#[derive(Clone)]
pub struct PictureRequest {
    /// The scene, at the view's size.
    pub scene: Arc<Scene>,
    /// What it shows.
    pub assets: Arc<Assets>,
    /// Without its deformations, for comparison.
    pub undeformed: bool,
}

impl PictureRequest {
    /// Whether a picture of one is a picture of the other.
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.assets, &other.assets) && (Arc::ptr_eq(&self.scene, &other.scene) || self.scene == other.scene)
    }
}

/// A picture of the 3D view, with what it is a picture of.
pub struct DisplayedPicture {
    /// Its pixels.
    pub texture: TextureHandle,
    /// What it shows.
    pub of: PictureRequest,
    /// Its camera.
    pub frame: ViewFrame,
    /// Measurements of its scene that have points, by their place in the list.
    pub measured: Vec<Option<MeasureResult>>,
    /// The job it came from.
    pub serial: u64,
}

impl DisplayedPicture {
    /// Where it lies in a view: all of it, unless it was made for another shape; it is never stretched.
    pub fn place(&self, view: Rect, size: [u32; 2]) -> Rect {
        let own = self.of.scene.render.size;
        if own == size {
            return view;
        }
        let own = vec2(own[0] as f32, own[1] as f32);
        Rect::from_center_size(view.center(), own * (view.width() / own.x).min(view.height() / own.y))
    }

    /// Its camera on the screen.
    pub fn projector(&self, view: Rect, size: [u32; 2]) -> Projector {
        Projector { frame: self.frame, rect: self.place(view, size) }
    }
}

/// How far a view's picture is behind what it should show.
#[derive(Clone, Debug, Default)]
pub struct OutdatedNotice {
    pub(in crate::gui) since: Option<Instant>,
    /// Why there is no picture of what should be shown.
    pub failure: Option<String>,
}

impl OutdatedNotice {
    /// The picture is of what should be shown, or is not.
    pub fn note(&mut self, current: bool) {
        if current {
            *self = Self::default();
        } else {
            self.since.get_or_insert_with(Instant::now);
        }
    }

    /// Another picture has arrived.
    pub fn restart(&mut self) {
        self.since = None;
    }

    /// How thick the veil is, 0 to 1.
    pub(in crate::gui) fn thickness(&self) -> f32 {
        if self.failure.is_some() {
            return 1.0;
        }
        self.since.map_or(0.0, |since| ((since.elapsed().as_secs_f32() - PATIENCE) / THICKENING).clamp(0.0, 1.0))
    }

    /// What is said over the picture, if anything: `there` says whether there is one.
    pub fn words(&self, there: bool) -> Option<String> {
        match (&self.failure, there) {
            (Some(problem), true) => Some(format!("This picture is out of date. The scene cannot be shown as it is now:\n{problem}")),
            (Some(problem), false) => Some(format!("The scene cannot be shown:\n{problem}")),
            (None, true) if self.thickness() > 0.0 => Some("Out of date; rendering…".to_owned()),
            (None, _) => None,
        }
    }
}
