//! The workstation: a window on a scene.
//!
//! *How it is made*: the interface only ever edits a [`Scene`](crate::scene::Scene) and asks for pictures of it. A worker thread renders
//! ([`worker`](state::worker)), another one answers what lies under the pointer, loading and exports have threads of their own; no frame of the
//! interface waits for any of them. What is undone is the scene without its camera, one step for every gesture ([`history`](state::history)).
//! What must survive a crash is written every minute and before risky steps ([`session`](state::session)).
//!
//! *Where things are*: [`state`] is what the window remembers; it names no panel and no view, those extend its [`Workstation`]. [`app`] starts it
//! and draws each frame. [`action`](state::action) lists everything that can be done, `edit` does it. [`views`] are the pictures, [`gizmos`] the
//! handles on them, [`panels`] everything beside them; [`projector`] places points on the screen. [`files`] opens and saves. `exports` exports, in
//! the background ([`tasks`]). [`theme`] says how it looks, `text` how words and numbers are written.

pub mod app;
mod edit;
mod exports;
pub mod files;
pub mod gizmos;
pub mod panels;
pub mod projector;
pub mod state;
pub mod tasks;
mod text;
pub mod theme;
pub mod views;

pub use state::{Options, Workstation};

use crate::{Error, Result};
use eframe::egui;
use std::path::PathBuf;

/// Opens the workstation, with a file or without one, until its window is closed.
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
    let options = eframe::NativeOptions { viewport, ..Default::default() };
    let run = eframe::run_native(
        "incise",
        options,
        Box::new(move |creation| {
            let options = Options { file, folder: std::env::var_os("INCISE_HOME").map(PathBuf::from), backend: None };
            Ok(Box::new(Workstation::new(&creation.egui_ctx, options)))
        }),
    );
    run.map_err(|e| {
        let why = match e {
            eframe::Error::Winit(_) | eframe::Error::WinitEventLoop(_) => "no display is available".to_owned(),
            other => other.to_string(),
        };
        Error::value("workstation", format!("no window could be opened ({why}); pictures are rendered without one by: incise render"))
    })
}
