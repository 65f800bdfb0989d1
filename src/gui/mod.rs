//! The workstation: an interactive window on a scene.
//!
//! *Design*: the interface only edits a [`Scene`](crate::scene::Scene) and requests pictures of it.
//! A worker thread renders ([`worker`](state::worker)), another picks the point under the pointer,
//! and loading and exports have their own threads; no frame of the interface waits for any of them.
//! Undo covers the scene without its camera, one step per gesture ([`history`](state::history)).
//! Automatic saves for recovery after a crash are written every minute and before risky steps
//! ([`session`](state::session)).
//!
//! *Modules*: [`state`] holds the state of the window ([`Workstation`]); it
//! depends on no panel and no view. [`app`] starts it and draws each frame. [`views`] are the
//! pictures, [`gizmos`] the handles on them, [`panels`] everything else: they read the state and
//! return requests ([`request`](state::request)), which `requests` carries out.
//! [`action`](state::action) lists all actions, `edit` performs them; `camera` moves the camera,
//! `pictures` asks the worker for pictures and values, [`files`] opens and saves, `exports` exports
//! in the background ([`tasks`]). [`projector`] maps points to the screen, [`theme`] defines the
//! appearance, `text` the formatting of words and numbers.

pub mod app;
mod camera;
mod comparison;
mod edit;
mod exports;
pub mod files;
pub mod gizmos;
mod keys;
pub mod panels;
mod pictures;
pub mod projector;
mod requests;
pub mod state;
pub mod tasks;
mod text;
pub mod theme;
mod thumbnails;
pub mod views;

pub use state::{Options, Workstation};

use crate::{Error, Result};
use eframe::egui;
use std::path::PathBuf;

/// Opens the workstation, with or without a file, and returns when its window is closed.
///
/// # Errors
/// No window can be opened: there is no display, or no graphics driver.
pub fn open(file: Option<PathBuf>) -> Result<()> {
    let viewport = egui::ViewportBuilder::default()
        .with_title("incise")
        .with_app_id("incise")
        .with_inner_size([1280.0, 800.0])
        .with_min_inner_size([800.0, 560.0])
        .with_drag_and_drop(true);
    let options = eframe::NativeOptions {
        viewport,
        ..Default::default()
    };
    let run = eframe::run_native(
        "incise",
        options,
        Box::new(move |creation| {
            let options = Options {
                file,
                folder: std::env::var_os("INCISE_HOME").map(PathBuf::from),
                backend: None,
            };
            Ok(Box::new(Workstation::new(&creation.egui_ctx, options)))
        }),
    );
    run.map_err(|e| {
        let why = match e {
            eframe::Error::Winit(_) | eframe::Error::WinitEventLoop(_) => {
                "no display is available".to_owned()
            }
            other => other.to_string(),
        };
        Error::value(
            "workstation",
            format!("no window could be opened ({why}); pictures are rendered without one by: incise render"),
        )
    })
}
