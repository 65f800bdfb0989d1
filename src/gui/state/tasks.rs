//! Background tasks.

use super::Workstation;
use crate::Result;
use eframe::egui::Context;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::Receiver;

/// Runs on the workstation when the task is done.
pub type Finish = Box<dyn FnOnce(&mut Workstation, &Context) + Send>;

/// A background task.
pub struct Task {
    /// Its name for display.
    pub name: String,
    pub(in crate::gui) progress: Arc<AtomicU32>,
    pub(in crate::gui) cancel: Arc<AtomicBool>,
    pub(in crate::gui) result: Receiver<Result<Finish>>,
}

impl Task {
    /// The fraction done.
    pub fn progress(&self) -> f32 {
        self.progress.load(Ordering::Relaxed) as f32 / 1000.0
    }

    /// Cancels the task.
    pub fn cancel(&self) {
        self.cancel.store(true, Ordering::Relaxed);
    }
}
