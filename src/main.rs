//! The `incise` program.

use incise::cli::{self, CommandOutcome};
use std::process::ExitCode;

fn main() -> ExitCode {
    match cli::main() {
        CommandOutcome::Done(code) => code,
        CommandOutcome::Workstation(file) => workstation(file),
    }
}

#[cfg(feature = "gui")]
fn workstation(file: Option<std::path::PathBuf>) -> ExitCode {
    cli::finish(incise::gui::open(file))
}

#[cfg(not(feature = "gui"))]
fn workstation(file: Option<std::path::PathBuf>) -> ExitCode {
    let what = file.map_or_else(|| "FILE".to_owned(), |f| f.display().to_string());
    cli::print_to_stderr(format_args!(
        "this build has no workstation; render a picture with: incise render {what} -o picture.png (see incise --help)"
    ));
    ExitCode::from(2)
}
