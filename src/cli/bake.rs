//! `incise bake`: writes the deformed volume, resampled, to a file or as DICOM, or the composed
//! displacement.

use super::arguments;
use super::common::check_patient;
use super::progress::TerminalProgress;
use crate::export::dicom::{self, DicomContent};
use crate::export::{bake, protect, protect_folder};
use crate::files::path_text::text_of;
use crate::files::{OutputFile, OutputFolder, names_folder};
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

impl InterpolationName {
    fn interpolation(self) -> bake::Interpolation {
        match self {
            Self::Nearest => bake::Interpolation::Nearest,
            Self::Linear => bake::Interpolation::Linear,
            Self::Cubic => bake::Interpolation::Cubic,
        }
    }
}

/// Options as typed.
#[derive(Args)]
pub struct BakeArguments {
    /// A scene (.toml), a volume or phantom:NAME[:size=N].
    input: PathBuf,
    #[command(flatten)]
    volume: arguments::VolumeArguments,
    /// The file to write: .nii.gz, .nii, .nrrd, .mha or .vti; or DICOM: a new folder (a name
    /// without extension) for a series of slices, .dcm for the segmentation of a label map.
    #[arg(short, long, value_name = "OUT.nii.gz|FOLDER")]
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
    /// Fill value outside the deformed volume and in cuts; by default the volume's lowest value, or
    /// for DICOM output the pixel padding value.
    #[arg(long, allow_hyphen_values = true)]
    fill: Option<f64>,
    /// Copy the patient and study attributes of the source into DICOM output, and reference the
    /// source; without this option, nothing about the patient is written.
    #[arg(long)]
    patient: bool,
    /// No notices, no progress.
    #[arg(short, long)]
    quiet: bool,
}

/// Where the result goes.
enum Output {
    /// A file.
    File(Format, OutputFile),
    /// A DICOM series.
    Series(OutputFolder),
    /// A DICOM segmentation.
    Segmentation(OutputFile),
}

impl Output {
    /// The output for the arguments, checked; inputs are protected.
    fn of(arguments: &BakeArguments, scene: &Scene) -> Result<Self> {
        let path = &arguments.output;
        let files = scene.files();
        let read = || {
            files
                .iter()
                .map(PathBuf::as_path)
                .chain([arguments.input.as_path()])
        };
        let is_folder = names_folder(path);
        if arguments.field && (is_folder || dicom::is_dicom_name(path)) {
            return Err(Error::value(
                format!("--output {}", path.display()),
                "DICOM slices cannot hold a displacement field; name a file that ends in .nii.gz, .nrrd, .mha or .vti",
            ));
        }
        if is_folder {
            protect_folder("--output", path, read())?;
            return OutputFolder::create(path).map(Self::Series);
        }
        if dicom::is_dicom_name(path) {
            if arguments.interpolation.is_some() || arguments.fill.is_some() {
                return Err(Error::value(
                    "--interpolation, --fill",
                    "do not apply to a DICOM segmentation: labels are not interpolated, and outside there is no label",
                ));
            }
            protect("--output", path, read().collect::<Vec<_>>())?;
            return OutputFile::create(path).map(Self::Segmentation);
        }
        if arguments.patient {
            return Err(Error::value(
                "--patient",
                "applies to DICOM output: a folder, or a .dcm file; this output has another format",
            ));
        }
        let format = Format::of(path)?;
        protect("--output", path, read().collect::<Vec<_>>())?;
        Ok(Self::File(format, OutputFile::create(path)?))
    }
}

/// Bakes and writes.
pub fn run(arguments: &BakeArguments) -> Result<()> {
    let mut scene = Scene::of_input(&arguments.input)?;
    arguments.volume.apply(&mut scene)?;
    for text in &arguments.deform {
        scene
            .deformation
            .push(arguments::deformation(&text_of(Path::new(text)))?);
    }
    let output = Output::of(arguments, &scene)?;
    if arguments.fill.is_some_and(|f| !f.is_finite()) {
        return Err(Error::value("--fill", "must be a finite number"));
    }
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
    if let Output::File(_, file) | Output::Segmentation(file) = &output {
        file.check()?;
    }
    let volume = &assets.volume;
    if volume.function.is_some() && arguments.interpolation.is_some() {
        return Err(Error::value(
            "--interpolation",
            "has no effect on a function, which is evaluated at every voxel; remove it, or add sampling=voxels to the volume",
        ));
    }
    let preparing = |share| bar.set("preparing", share);
    let deformed = Deformed::exact(&scene, &assets, true, &Watch::reporting(&preparing))?;
    let deformation = deformed.stack_and_cuts();
    let report = |notices: Vec<String>| {
        if !arguments.quiet {
            notices.into_iter().for_each(super::print_to_stderr);
        }
    };
    report(notices(arguments, &scene, &assets));
    let grid = if arguments.enlarge {
        bake::enlarged(volume, deformation.stack)
    } else {
        volume.geometry()
    };
    let progress = |share| bar.set("baking", share);
    let options = bake::BakeOptions {
        interpolation: arguments.interpolation.map(InterpolationName::interpolation),
        fill: arguments.fill,
        progress: Some(&progress),
    };
    let origin = match output {
        Output::File(..) => None,
        _ => dicom::origin(&scene, volume, &Watch::NONE)?,
    };
    check_patient(arguments.patient, origin.as_ref(), &scene)?;
    let derivation = |content| dicom::derivation(&scene, content, origin.as_ref(), arguments.patient);
    let mut written_notices = Vec::new();
    match output {
        Output::Series(folder) => {
            let derivation = derivation(DicomContent::Volume);
            written_notices = bake::dicom_series(volume, &deformation, &grid, folder, &derivation, &options)?;
        }
        Output::Segmentation(file) => {
            let derivation = derivation(DicomContent::Labels);
            let (bytes, notices) =
                bake::dicom_segmentation(volume, &deformation, &grid, &derivation, &progress)?;
            file.finish(&bytes)?;
            written_notices = notices;
        }
        Output::File(format, file) => file.finish_with(|out| {
            written_notices.extend(format.notice(&grid));
            if !arguments.field {
                return bake::volume(volume, &deformation, &grid, format, out, &options);
            }
            let cut = bake::field(&deformation, &grid, format, out, &progress)?;
            if cut > 0 {
                written_notices.push(format!(
                    "{cut} points of the field lie in cuts, which a displacement field cannot represent; they were filled by extrapolation"
                ));
            }
            Ok(())
        })?,
    }
    bar.finish();
    report(written_notices);
    Ok(())
}

/// Notices before baking: of the readers, and about what is not written.
fn notices(arguments: &BakeArguments, scene: &Scene, assets: &Assets) -> Vec<String> {
    let volume = &assets.volume;
    let mut all: Vec<String> = volume
        .warnings_with_options()
        .iter()
        .map(|w| format!("{}: {w}", scene.volume_name()))
        .chain(assets.library.notices())
        .collect();
    if volume.colors.is_some() && !arguments.field {
        all.push(format!(
            "{}: colours are not baked; brightness is written instead (use --channel to choose one channel)",
            scene.volume_name()
        ));
    }
    if volume.labels().is_some() && names_folder(&arguments.output) {
        all.push(format!(
            "{}: the label map is written as slices of numbers; name a .dcm file for a segmentation with names and colours",
            scene.volume_name()
        ));
    }
    all
}
