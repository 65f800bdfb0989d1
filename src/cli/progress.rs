//! Progress bars on stderr, if it is a terminal, for work that takes longer than a second.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// A progress bar on a terminal, shown after one second.
pub struct TerminalProgress {
    bar: Option<ProgressBar>,
    start: Instant,
}

impl TerminalProgress {
    /// A new bar; invisible if quiet.
    pub fn new(quiet: bool) -> Self {
        let bar = (!quiet && std::io::stderr().is_terminal()).then(|| {
            let bar = ProgressBar::hidden();
            if let Ok(style) = ProgressStyle::with_template("{msg:10} {bar:40} {percent:>3} %") {
                bar.set_style(style);
            }
            bar.set_length(1000);
            bar
        });
        Self {
            bar,
            start: Instant::now(),
        }
    }

    /// Sets the current stage and the fraction done.
    pub fn set(&self, what: &'static str, share: f32) {
        let Some(bar) = &self.bar else { return };
        if self.start.elapsed() > Duration::from_secs(1) {
            if bar.is_hidden() {
                bar.set_draw_target(indicatif::ProgressDrawTarget::stderr());
            }
            bar.set_message(what);
            bar.set_position((share * 1000.0) as u64);
        }
    }

    /// Removes the bar.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
