//! The command line: parses arguments into a scene, then runs one command, each in its own file.

mod arguments;
mod bake;
mod common;
mod compare;
mod gallery;
mod info;
mod map;
mod progress;
mod render;
mod sdf;

use crate::scene::file::schema;
use crate::{Error, Result, files};
use clap::{Parser, Subcommand};
use std::io::Write;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

/// The command-line arguments.
#[derive(Parser)]
#[command(name = "incise", version, about, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    /// A scene, a volume or a mesh to open in the workstation.
    file: Option<std::path::PathBuf>,
    /// Allow input files to refer to files outside their own folders (detached headers, glTF), and
    /// follow symbolic links that lead out of an input folder.
    #[arg(long, global = true)]
    allow_outside: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Render one picture of a scene, a volume or a phantom.
    Render(Box<render::RenderArguments>),
    /// Compare slicing, ray casting and surfaces on CPU and GPU; write pictures, times, errors and
    /// a report page.
    Compare(Box<compare::CompareArguments>),
    /// Resample the deformed volume, or the composed displacement field, into a file or DICOM.
    Bake(Box<bake::BakeArguments>),
    /// Make, convert, invert or check a displacement map or field.
    Map(Box<map::MapArguments>),
    /// Render every kind of deformation as a page of pictures.
    Gallery(gallery::GalleryArguments),
    /// Write the signed distance field of a mesh.
    Sdf(sdf::SdfArguments),
    /// Describe a file: size, type, spacing, orientation.
    Info(Box<info::InfoArguments>),
    /// Print the JSON schema of scene files.
    Schema,
    /// List presets, kinds of deformation with their parameters, looks of surfaces, lights,
    /// deformers of meshes, and phantoms.
    List,
}

/// Whether the workstation was opened.
static WINDOW: AtomicBool = AtomicBool::new(false);

/// The outcome of the command line.
pub enum CommandOutcome {
    /// The command is done, with this exit code.
    Done(ExitCode),
    /// The workstation is to be opened, with or without a file.
    Workstation(Option<std::path::PathBuf>),
}

/// Runs the program. Exit code 0: done; 1: failed, with one message; 2: wrong usage.
pub fn main() -> CommandOutcome {
    files::unfinished::remove_on_signals();
    crate::panic_guard::on_panic(|line| {
        print_to_stderr(line);
        // The window can continue without the failed part; a command cannot.
        if !WINDOW.load(Ordering::Relaxed) {
            files::unfinished::remove_all();
            std::process::exit(1);
        }
    });
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => error.exit(),
        // Help or version was requested.
        Err(wanted) => return CommandOutcome::Done(finish(print(wanted.render().to_string().trim_end()))),
    };
    if cli.allow_outside {
        files::reference::allow_outside();
    }
    let result = match cli.command {
        Some(Command::Render(arguments)) => render::run(&arguments),
        Some(Command::Compare(arguments)) => compare::run(&arguments),
        Some(Command::Bake(arguments)) => bake::run(&arguments),
        Some(Command::Map(arguments)) => map::run(&arguments),
        Some(Command::Gallery(arguments)) => gallery::run(&arguments),
        Some(Command::Sdf(arguments)) => sdf::run(&arguments),
        Some(Command::Info(arguments)) => info::run(&arguments),
        Some(Command::Schema) => print(&format!("{:#}", schema())),
        Some(Command::List) => print(&info::catalogue()),
        None => {
            if let Some(word) = cli
                .file
                .as_ref()
                .and_then(|f| f.to_str())
                .filter(|w| !w.contains(['.', '/', '\\', ':']) && !std::path::Path::new(w).exists())
            {
                let commands = [
                    "render", "compare", "bake", "map", "gallery", "sdf", "info", "schema", "list",
                ];
                print_to_stderr(format_args!(
                    "there is no command and no file \"{word}\"; {}",
                    crate::error::suggestion(word, commands)
                ));
                return CommandOutcome::Done(ExitCode::from(2));
            }
            WINDOW.store(true, Ordering::Relaxed);
            return CommandOutcome::Workstation(cli.file);
        }
    };
    CommandOutcome::Done(finish(result))
}

/// The exit code of a result; an error is printed.
pub fn finish(result: Result<()>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let remedy = if matches!(error, Error::GpuLimit(_)) {
                "; use --backend cpu"
            } else {
                ""
            };
            print_to_stderr(format_args!("{}{remedy}", error.printable()));
            ExitCode::FAILURE
        }
    }
}

/// Writes a line to standard output.
///
/// # Errors
/// A full device. A reader that has gone away is not an error.
fn print(text: &str) -> Result<()> {
    files::standard_output().finish(format!("{text}\n").as_bytes())
}

/// Writes a line to standard error, without control characters: text of a file must not move a
/// terminal's cursor. A closed or full standard error is ignored: the failure cannot be reported
/// anywhere.
pub fn print_to_stderr(text: impl std::fmt::Display) {
    let line = text
        .to_string()
        .replace(|c: char| c.is_control() && c != '\n', " ");
    let _nowhere = writeln!(std::io::stderr(), "incise: {line}");
}
