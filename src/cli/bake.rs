//! `incise bake`: writes the deformed volume, resampled, or the composed displacement, to a file.

use super::arguments;
use super::progress::TerminalProgress;
use crate::export::{bake, protect};
use crate::files::OutputFile;
use crate::files::path_text::text_of;
use crate::prepare::{Assets, Deformed, LoadOptions};
use crate::scene::Scene;
use crate::volume::save::Format;
use crate::{Error, Result, Watch};
use clap::{Args, ValueEnum};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum InterpolationName {
    Nearest,
    Linear,
    Cubic,
}

/// Options as typed.
#[derive(Args)]
pub struct BakeArguments {
    /// A scene (.toml), a volume or phantom:NAME[:size=N].
    input: PathBuf,
    #[command(flatten)]
    volume: arguments::VolumeArguments,
    /// The file to write: .nii.gz, .nii, .nrrd, .mha or .vti.
    #[arg(short, long, value_name = "OUT.nii.gz")]
    output: PathBuf,
    /// Add a deformation after the scene's own; repeat for more, applied in order.
    #[arg(long, value_name = "KIND[:name=value,...]")]
    deform: Vec<OsString>,
    /// Write the composed displacement (source minus deformed point, mm, LPS) instead of the
    /// volume.
    #[arg(long)]
    field: bool,
    /// Interpolation between voxels: nearest by default for label maps, otherwise linear.
    #[arg(long, value_enum)]
    interpolation: Option<InterpolationName>,
    /// Enlarge the grid so that the deformed volume is not clipped; by default, the input's grid is
    /// used.
    #[arg(long)]
    enlarge: bool,
    /// Fill value outside the deformed volume and in cuts; the volume's lowest value by default.
    #[arg(long, allow_hyphen_values = true)]
    fill: Option<f64>,
    /// No notices, no progress.
    #[arg(short, long)]
    quiet: bool,
}

/// Bakes and writes.
pub fn run(arguments: &BakeArguments) -> Result<()> {
    let format = Format::of(&arguments.output)?;
    let mut scene = Scene::of_input(&arguments.input)?;
    arguments.volume.apply(&mut scene)?;
    for text in &arguments.deform {
        scene
            .deformation
            .push(arguments::deformation(&text_of(Path::new(text)))?);
    }
    let read = scene.files();
    protect(
        "--output",
        &arguments.output,
        read.iter()
            .map(PathBuf::as_path)
            .chain([arguments.input.as_path()]),
    )?;
    if arguments.fill.is_some_and(|f| !f.is_finite()) {
        return Err(Error::value("--fill", "must be a finite number"));
    }
    let output = OutputFile::create(&arguments.output)?;
    let bar = TerminalProgress::new(arguments.quiet);
    if scene.volume.is_none() {
        return Err(Error::file(
            &arguments.input,
            "has no volume to bake; its meshes are rendered, not baked",
        ));
    }
    let assets = Assets::load_with(
        &scene,
        &LoadOptions {
            progress: Some(&|what, share| bar.set(what, share)),
            ..LoadOptions::default()
        },
    )?;
    output.check()?;
    let volume = &assets.volume;
    let preparing = |share| bar.set("preparing", share);
    let deformed = Deformed::exact(&scene, &assets, true, &Watch::reporting(&preparing))?;
    let deformation = deformed.stack_and_cuts();
    if !arguments.quiet {
        for note in volume
            .warnings_with_options()
            .iter()
            .map(|w| format!("{}: {w}", scene.volume_name()))
            .chain(assets.library.notices())
        {
            super::print_to_stderr(note);
        }
    }
    if volume.colors.is_some() && !arguments.field && !arguments.quiet {
        super::print_to_stderr(format_args!(
            "{}: colours are not baked; brightness is written instead (use --channel to choose one channel)",
            scene.volume_name()
        ));
    }
    let grid = if arguments.enlarge {
        bake::enlarged(volume, deformation.stack)
    } else {
        volume.geometry()
    };
    let interpolation = arguments.interpolation.map(|name| match name {
        InterpolationName::Nearest => bake::Interpolation::Nearest,
        InterpolationName::Linear => bake::Interpolation::Linear,
        InterpolationName::Cubic => bake::Interpolation::Cubic,
    });
    let mut cut = 0;
    output.finish_with(|out| {
        let progress = |share| bar.set("baking", share);
        if arguments.field {
            cut = bake::field(&deformation, &grid, format, out, &progress)?;
            Ok(())
        } else {
            let options = bake::BakeOptions {
                interpolation,
                fill: arguments.fill,
                progress: Some(&progress),
            };
            bake::volume(volume, &deformation, &grid, format, out, &options)
        }
    })?;
    bar.finish();
    if cut > 0 && !arguments.quiet {
        super::print_to_stderr(format_args!(
            "{cut} points of the field lie in cuts, which a displacement field cannot represent; they were filled by extrapolation"
        ));
    }
    Ok(())
}
