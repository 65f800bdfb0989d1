//! The displayed picture, as opposed to the current state of the scene.

use super::worker::MeasureResult;
use crate::gui::projector::Projector;
use crate::prepare::Assets;
use crate::scene::{Scene, ViewFrame};
use eframe::egui::{Rect, TextureHandle, vec2};
use std::sync::Arc;
use std::time::Instant;

/// A picture may be out of date for this long before it is dimmed, seconds.
const PATIENCE: f32 = 0.4;
/// The dimming increases over this time, seconds.
const THICKENING: f32 = 0.6;

/// The content requested for a view.
#[derive(Clone)]
pub struct PictureRequest {
    /// The scene, at the view's size.
    pub scene: Arc<Scene>,
    /// Its assets.
    pub assets: Arc<Assets>,
    /// Without its deformations, for comparison.
    pub undeformed: bool,
}

impl PictureRequest {
    /// Whether both requests give the same picture.
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.assets, &other.assets)
            && (Arc::ptr_eq(&self.scene, &other.scene) || self.scene == other.scene)
    }
}

/// A picture of the 3D view, with the request it shows.
pub struct DisplayedPicture {
    /// Its pixels.
    pub texture: TextureHandle,
    /// The request it shows.
    pub of: PictureRequest,
    /// Its camera.
    pub frame: ViewFrame,
    /// The measurements of its scene that have points, by index.
    pub measured: Vec<Option<MeasureResult>>,
    /// Number of the job that rendered it.
    pub serial: u64,
}

impl DisplayedPicture {
    /// Its rectangle in a view: the whole view, unless it was rendered for another aspect ratio; it
    /// is never stretched.
    pub fn place(&self, view: Rect, size: [u32; 2]) -> Rect {
        let own = self.of.scene.render.size;
        if own == size {
            return view;
        }
        let own = vec2(own[0] as f32, own[1] as f32);
        Rect::from_center_size(
            view.center(),
            own * (view.width() / own.x).min(view.height() / own.y),
        )
    }

    /// The projector of its camera.
    pub fn projector(&self, view: Rect, size: [u32; 2]) -> Projector {
        Projector {
            frame: self.frame,
            rect: self.place(view, size),
        }
    }
}

/// How long a view's picture has been out of date.
#[derive(Clone, Debug, Default)]
pub struct OutdatedNotice {
    pub(in crate::gui) since: Option<Instant>,
    /// Why the requested content has no picture.
    pub failure: Option<String>,
}

impl OutdatedNotice {
    /// Records whether the picture is up to date.
    pub fn note(&mut self, current: bool) {
        if current {
            *self = Self::default();
        } else {
            self.since.get_or_insert_with(Instant::now);
        }
    }

    /// Restarts the delay when a new picture arrives.
    pub fn restart(&mut self) {
        self.since = None;
    }

    /// Strength of the dimming, 0 to 1.
    pub(in crate::gui) fn thickness(&self) -> f32 {
        if self.failure.is_some() {
            return 1.0;
        }
        self.since.map_or(0.0, |since| {
            ((since.elapsed().as_secs_f32() - PATIENCE) / THICKENING).clamp(0.0, 1.0)
        })
    }

    /// The text over the picture, if any; `there` states whether there is a picture.
    pub fn words(&self, there: bool) -> Option<String> {
        match (&self.failure, there) {
            (Some(problem), true) => Some(format!(
                "This picture is out of date. The scene cannot be shown as it is now:\n{problem}"
            )),
            (Some(problem), false) => Some(format!("The scene cannot be shown:\n{problem}")),
            (None, true) if self.thickness() > 0.0 => Some("Out of date; rendering…".to_owned()),
            (None, _) => None,
        }
    }
}
