//! Progress reports of long-running work, and its cancellation.

use crate::{Error, Result};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Receives the progress of some work, and can cancel it.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Receives the fraction of work done; called from several threads.
    pub progress: &'a (dyn Fn(f32) + Sync),
    /// Set to true to cancel.
    pub cancel: &'a AtomicBool,
}

/// Never set.
static NEVER_CANCELLED: AtomicBool = AtomicBool::new(false);

impl Watch<'static> {
    /// Discards progress and never cancels.
    pub const NONE: Self = Self {
        progress: &|_| (),
        cancel: &NEVER_CANCELLED,
    };
}

impl<'a> Watch<'a> {
    /// Reports to `progress` and never cancels.
    pub fn reporting(progress: &'a (dyn Fn(f32) + Sync)) -> Self {
        Self {
            progress,
            cancel: &NEVER_CANCELLED,
        }
    }

    /// Whether the work has been cancelled.
    pub fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// An error if the work has been cancelled.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn check(&self) -> Result<()> {
        if self.is_cancelled() {
            Err(Error::Cancelled)
        } else {
            Ok(())
        }
    }
}

/// Counts bytes towards a known total, from any thread.
pub struct ByteProgress<'a> {
    watch: &'a Watch<'a>,
    done: AtomicU64,
    all: u64,
}

impl<'a> ByteProgress<'a> {
    /// Starts at zero of `all` bytes.
    pub fn new(watch: &'a Watch<'a>, all: u64) -> Self {
        Self {
            watch,
            done: AtomicU64::new(0),
            all: all.max(1),
        }
    }

    /// Counts more bytes.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn add(&self, bytes: u64) -> Result<()> {
        let done = self.done.fetch_add(bytes, Ordering::Relaxed) + bytes;
        (self.watch.progress)((done as f64 / self.all as f64).min(1.0) as f32);
        self.watch.check()
    }
}
