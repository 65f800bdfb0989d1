//! Background tasks: exports, baking, reports. Each has a thread, a progress bar and a button that
//! cancels it.

use super::state::Workstation;
use super::state::log::LogLevel;
use super::state::tasks::{Finish, Task};
use crate::{Error, Result, Watch};
use eframe::egui::Context;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{TryRecvError, channel};

/// A finish that reports a message.
pub fn report_when_done(text: String) -> Finish {
    Box::new(move |app, _| app.report(LogLevel::Info, text))
}

impl Workstation {
    /// Starts a task.
    pub fn start(
        &mut self,
        ctx: &Context,
        name: &str,
        work: impl FnOnce(&Watch) -> Result<Finish> + Send + 'static,
    ) {
        // The scene is saved in case the task crashes the program.
        self.autosave();
        let (progress, cancel) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicBool::new(false)));
        let (send, result) = channel();
        let (shared_progress, stop, ctx) = (progress.clone(), cancel.clone(), ctx.clone());
        let spawned = std::thread::Builder::new().name(name.to_owned()).spawn(move || {
            let report = |share: f32| {
                shared_progress.store((share.clamp(0.0, 1.0) * 1000.0) as u32, Ordering::Relaxed)
            };
            let outcome = work(&Watch {
                progress: &report,
                cancel: &stop,
            });
            let _window_closed = send.send(outcome);
            ctx.request_repaint();
        });
        match spawned {
            Ok(_) => self.tasks.push(Task {
                name: name.to_owned(),
                progress,
                cancel,
                result,
            }),
            Err(e) => self.report(
                LogLevel::Error,
                format!("{name}: no thread could be started: {e}"),
            ),
        }
    }

    /// Waits briefly for cancelled tasks, so that they can remove partial files.
    pub(super) fn end_tasks(&mut self) {
        let start = std::time::Instant::now();
        while !self.tasks.is_empty() && start.elapsed() < std::time::Duration::from_millis(800) {
            self.tasks
                .retain(|t| matches!(t.result.try_recv(), Err(TryRecvError::Empty)));
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        self.tasks.clear();
    }

    /// Runs the finish of completed tasks.
    pub(super) fn poll_tasks(&mut self, ctx: &Context) {
        let mut n = 0;
        while n < self.tasks.len() {
            match self.tasks[n].result.try_recv() {
                Err(TryRecvError::Empty) => n += 1,
                Ok(outcome) => {
                    self.tasks.remove(n);
                    match outcome {
                        Ok(finish) => finish(self, ctx),
                        Err(error) => self.report_error(&error),
                    }
                }
                Err(TryRecvError::Disconnected) => {
                    let task = self.tasks.remove(n);
                    self.report_error(&Error::value(
                        task.name,
                        "failed because of an internal error; the scene is intact",
                    ));
                }
            }
        }
    }
}
