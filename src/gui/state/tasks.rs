//! Work in the background.

use super::Workstation;
use crate::Result;
use eframe::egui::Context;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::Receiver;

/// What to do with the workstation once the work is done.
pub type Finish = Box<dyn FnOnce(&mut Workstation, &Context) + Send>;

/// One piece of work.
pub struct Task {
    /// What it does, in words.
    pub name: String,
    pub(in crate::gui) progress: Arc<AtomicU32>,
    pub(in crate::gui) cancel: Arc<AtomicBool>,
    pub(in crate::gui) result: Receiver<Result<Finish>>,
}

impl Task {
    /// Share that is done.
    pub fn progress(&self) -> f32 {
        self.progress.load(Ordering::Relaxed) as f32 / 1000.0
    }

    /// Tells it to stop.
    pub fn cancel(&self) {
        self.cancel.store(true, Ordering::Relaxed);
    }
}
