//! `incise map`: makes, converts, inverts and checks displacement maps and fields.

use super::arguments;
use super::progress::TerminalProgress;
use crate::deform::file_kinds::FILE_KINDS;
use crate::deform::quality::{CheckedField, FieldQuality};
use crate::deform::transform::{Transform, TransformContext, TransformStep, VectorField};
use crate::deform::{PlacedMap, Storage, compose, invert, saved};
use crate::export::protect;
use crate::files::path_text::text_of;
use crate::files::{OutputFile, check_distinct};
use crate::math::Bounds;
use crate::picture::encode_png;
use crate::prepare::{Assets, Deformed};
use crate::scene::Scene;
use crate::volume::load::{self, ReadOptions};
use crate::volume::save::{self, Content, Format};
use crate::{Error, Result, Watch};
use clap::{Args, Subcommand};
use glam::Vec3;
use serde_json::json;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Options as typed.
#[derive(Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct MapArguments {
    #[command(subcommand)]
    action: Option<MapAction>,
    /// A kind with its parameters (as in --deform), or a file: a map, a field or a transform.
    #[arg(required = true, value_name = "KIND|FILE")]
    what: Option<OsString>,
    /// The file to write. A kind as .nrrd keeps its mask (a displacement map); other endings hold
    /// the displacement alone.
    #[arg(short, long, required = true, value_name = "OUT")]
    output: Option<PathBuf>,
    /// Reference volume; needed for default boxes, label surfaces and FSL files.
    #[arg(long, value_name = "FILE")]
    volume: Option<PathBuf>,
    /// Write the inverse.
    #[arg(long)]
    invert: bool,
    /// Points along the longest axis.
    #[arg(long)]
    resolution: Option<usize>,
    /// How the file's vectors are meant: lps, ras, fsl or fsl-absolute.
    #[arg(long)]
    convention: Option<String>,
    /// No notices.
    #[arg(short, long)]
    quiet: bool,
}

#[derive(Subcommand)]
enum MapAction {
    /// Check a field for folds, large displacements, border values and invertibility.
    Check(CheckArguments),
}

#[derive(Args)]
struct CheckArguments {
    /// A displacement map, a field or a transform.
    file: PathBuf,
    /// Reference volume, if one is needed.
    #[arg(long, value_name = "FILE")]
    volume: Option<PathBuf>,
    /// How the file's vectors are meant: lps, ras, fsl or fsl-absolute.
    #[arg(long)]
    convention: Option<String>,
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
    /// Leave out the inversion, which takes the longest.
    #[arg(long)]
    no_inverse: bool,
    /// Write each point's displacement and Jacobian determinant (det J) as CSV.
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Write slices of det J through the worst point, folds in red.
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
}

/// The box for maps if no volume is named: 200 mm around the origin.
const NOMINAL_BOX: Bounds = Bounds {
    min: Vec3::splat(-100.0),
    max: Vec3::splat(100.0),
};

/// Runs the command.
pub fn run(arguments: &MapArguments) -> Result<()> {
    if let Some(MapAction::Check(check)) = &arguments.action {
        return run_check(check);
    }
    let (Some(input), Some(path)) = (arguments.what.as_deref().map(Path::new), &arguments.output) else {
        return Err(Error::value("map", "needs a kind or a file, and --output"));
    };
    let format = Format::of(path)?;
    let what = text_of(input);
    protect(
        "--output",
        path,
        arguments.volume.as_deref().into_iter().chain([input]),
    )?;
    if let Some(n) = arguments.resolution.filter(|n| !(8..=512).contains(n)) {
        return Err(Error::value(
            "--resolution",
            format!("{n} is outside 8 to 512 points"),
        ));
    }
    let output = OutputFile::create(path)?;
    let bar = TerminalProgress::new(arguments.quiet);
    let note = |text: String| {
        if !arguments.quiet {
            super::print_to_stderr(text);
        }
    };
    let name = what.split(':').next().unwrap_or_default();
    let is_kind = !input.exists()
        && (crate::deform::kinds::kind(name).is_ok() || FILE_KINDS.iter().any(|k| k.name == name));
    let placed = if is_kind {
        let made = map_of_kind(&what, path, arguments, &note)?;
        if arguments.invert {
            inverse_of_map(&made, &note)?
        } else {
            made
        }
    } else {
        if !input.exists() && !what.contains(['/', '.']) {
            // Neither a kind nor a file: the error lists the kinds.
            crate::deform::kinds::kind(name)?;
        }
        from_file(input, arguments, &bar, &note)?
    };
    bar.finish();
    if placed.cylinder.is_some() {
        note(ROUND_AN_AXIS.into());
    }
    let cut = placed.map.bounds(Vec3::ZERO, Vec3::ONE).min[3] < 0.5;
    let keeps_mask = format == Format::Nrrd && (is_kind || cut);
    let bytes = if keeps_mask {
        saved::encode(&placed)?
    } else {
        if cut {
            note(
                "the map contains cuts, which a field cannot represent; write .nrrd to keep the mask".into(),
            );
        }
        encode_field(&placed, format)?
    };
    output.finish(&bytes)
}

/// Notice for a map wrapped around an axis.
const ROUND_AN_AXIS: &str = "a saved map cannot store a cylindrical mapping, so the map is resampled onto a Cartesian grid; to keep its texels, save it without mapping and set mapping=cylindrical where you use it";

/// The map of the deformation `what`, a kind with its parameters. Fails if `path`, the output, is
/// one of the input files.
fn map_of_kind(
    what: &str,
    path: &Path,
    arguments: &MapArguments,
    note: &impl Fn(String),
) -> Result<PlacedMap> {
    let mut scene = match &arguments.volume {
        Some(v) => Scene::of_input(v)?,
        None => Scene::of_volume("phantom:ball:size=8"),
    };
    scene.deformation = vec![arguments::deformation(what)?];
    protect("--output", path, scene.files().iter().map(PathBuf::as_path))?;
    if scene.deformation[0].resolution.is_none() && arguments.resolution.is_some() {
        scene.deformation[0].resolution = arguments.resolution;
    }
    let assets = Assets::load(&scene)?;
    let stack = Deformed::exact(&scene, &assets, false, &Watch::NONE)?.stack;
    assets.library.notices().into_iter().for_each(note);
    // A chain of transforms is several maps, but a file holds one.
    match stack.maps() {
        [one] => Ok(one.clone()),
        _ => {
            let resolution = compose::Resolution::Within(0.05);
            let composed = compose::stack(
                &stack,
                &assets.volume.bounds_in_world(),
                resolution,
                Storage::F32,
                &compose::evaluate,
            )?
            .ok_or_else(|| Error::value(what, "yields no map; choose another kind or file"))?;
            if !composed.within {
                note(format!(
                    "{what}: the transforms were composed into one map; its error is up to {:.2} mm (99th percentile: {:.2} mm)",
                    composed.worst_mm, composed.p99_mm
                ));
            }
            Ok(composed.placed)
        }
    }
}

fn encode_field(placed: &PlacedMap, format: Format) -> Result<Vec<u8>> {
    let field = CheckedField::of_map(placed).field;
    let values: Vec<f32> = field.vectors.iter().flat_map(|v| v.to_array()).collect();
    save::encode(format, &field.grid, Content::Field, &values)
}

fn inverse_of_map(placed: &PlacedMap, note: &impl Fn(String)) -> Result<PlacedMap> {
    let grid = compose::grid_of(&placed.placement, placed.map.size);
    let inverse = invert::function(
        &|p| p + (placed.backward(p.as_vec3()).0 - p.as_vec3()).as_dvec3(),
        &grid,
    );
    report(&inverse.report, note);
    inverse.placed(Storage::F32, 1.0)
}

fn report(r: &invert::InversionReport, note: &impl Fn(String)) {
    note(format!(
        "inverted {} points; residual mean {:.4}, 95th percentile {:.4}, 99th percentile {:.4}, largest {:.4} mm; {} points have no source",
        r.points, r.mean_mm, r.p95_mm, r.p99_mm, r.max_mm, r.not_found
    ));
}

/// The transform in a file, and the box of the volume to which it applies.
fn load_transform(
    path: &Path,
    volume: Option<&Path>,
    convention: Option<&str>,
) -> Result<(Transform, Bounds)> {
    let volume = volume
        .map(|v| load::volume(v, &ReadOptions::default(), &Watch::NONE))
        .transpose()?;
    let grid = volume.as_ref().map(|v| v.geometry());
    let transform = Transform::load(
        path,
        &TransformContext {
            moving: grid,
            reference: grid,
            convention,
        },
    )?;
    let bounds = volume.map_or_else(
        || {
            transform.grid().map_or(NOMINAL_BOX, |g| {
                Bounds::UNIT.transformed(
                    &compose::placement_of(&g).map_or(glam::Affine3A::IDENTITY, |p| p.world_from_map),
                )
            })
        },
        |v| v.bounds_in_world(),
    );
    Ok((transform, bounds))
}

fn from_file(
    input: &Path,
    arguments: &MapArguments,
    bar: &TerminalProgress,
    note: &impl Fn(String),
) -> Result<PlacedMap> {
    if let Some(map) = saved_map(input)? {
        return if arguments.invert {
            inverse_of_map(&map, note)
        } else {
            Ok(map)
        };
    }
    // FSL files need the volume only if the transform is not along the axes; others ignore it.
    let (transform, bounds) = load_transform(
        input,
        arguments.volume.as_deref(),
        arguments.convention.as_deref(),
    )?;
    transform.warnings.iter().cloned().for_each(note);
    bar.set("working", 0.5);
    if !arguments.invert {
        return one_map(&transform, &bounds, arguments.resolution);
    }
    if let Some(inverse) = transform.affine_inverse() {
        return Ok(compose::transform(&inverse, &bounds, 1.0, arguments.resolution, Storage::F32)?.placed);
    }
    let inverse = invert::transform(&transform, &bounds, arguments.resolution)?;
    report(&inverse.report, note);
    inverse.placed(Storage::F32, 1.0)
}

/// A transform as one map; a single field keeps its grid.
fn one_map(transform: &Transform, bounds: &Bounds, resolution: Option<usize>) -> Result<PlacedMap> {
    let mut maps = compose::transform_maps(transform, bounds, 1.0, resolution, Storage::F32)?;
    match (maps.pop(), maps.is_empty()) {
        (Some(one), true) => Ok(one),
        _ => Ok(compose::transform(transform, bounds, 1.0, resolution, Storage::F32)?.placed),
    }
}

/// The map in a file if this program wrote it.
fn saved_map(path: &Path) -> Result<Option<PlacedMap>> {
    let name = path.to_string_lossy().to_ascii_lowercase();
    if !name.ends_with(".nrrd") && !name.ends_with(".nhdr") {
        return Ok(None);
    }
    if load::image(path, &ReadOptions::default(), &Watch::NONE)?.displacement {
        saved::read(path, Storage::F32, 1.0).map(Some)
    } else {
        Ok(None)
    }
}

/// Runs `map check`.
fn run_check(arguments: &CheckArguments) -> Result<()> {
    let path = &arguments.file;
    let CheckOutputs {
        csv,
        picture,
        to_standard_output,
    } = CheckOutputs::open(arguments)?;
    let (examined, warnings) = field_to_check(arguments)?;
    let health = examined.health(!arguments.no_inverse);
    if let Some(file) = csv {
        file.finish(examined.csv().as_bytes())?;
    }
    if let Some(file) = picture {
        let (width, height, rgb) = examined.picture();
        file.finish(&encode_png(
            &rgb,
            [width as u32, height as u32],
            image::ExtendedColorType::Rgb8,
        )?)?;
    }
    let grid = examined.field.grid;
    let report = json!({ "file": path.display().to_string(), "size": grid.size, "health": health, "warnings": warnings });
    if arguments.json {
        return super::print(&format!("{report:#}"));
    }
    let out = report_as_text(path, grid.size, &health, &warnings);
    if to_standard_output == 0 {
        return super::print(out.trim_end());
    }
    super::print_to_stderr(out.trim_end());
    Ok(())
}

/// The output files of a check.
struct CheckOutputs {
    csv: Option<OutputFile>,
    picture: Option<OutputFile>,
    /// How many of them go to standard output.
    to_standard_output: usize,
}

impl CheckOutputs {
    /// Opens the files. Fails if one of them is an input, if both are the same file, or if more
    /// than one output goes to standard output.
    fn open(arguments: &CheckArguments) -> Result<Self> {
        let read = || {
            arguments
                .volume
                .as_deref()
                .into_iter()
                .chain([arguments.file.as_path()])
        };
        for (option, written) in [("--csv", &arguments.csv), ("--picture", &arguments.picture)] {
            if let Some(written) = written {
                protect(option, written, read())?;
            }
        }
        if let (Some(csv), Some(picture)) = (&arguments.csv, &arguments.picture) {
            check_distinct(csv, "--picture", picture)?;
        }
        let csv = arguments
            .csv
            .as_deref()
            .map(OutputFile::create_or_standard)
            .transpose()?;
        let picture = arguments
            .picture
            .as_deref()
            .map(OutputFile::create_or_standard)
            .transpose()?;
        let to_standard_output = [&csv, &picture]
            .into_iter()
            .flatten()
            .filter(|o| o.is_standard_output())
            .count();
        if to_standard_output + usize::from(arguments.json) > 1 {
            return Err(Error::value(
                "--csv, --picture, --json",
                "only one of them can go to standard output; write the others to files",
            ));
        }
        Ok(Self {
            csv,
            picture,
            to_standard_output,
        })
    }
}

/// The field that a file describes, and the warnings from reading it.
fn field_to_check(arguments: &CheckArguments) -> Result<(CheckedField, Vec<String>)> {
    match saved_map(&arguments.file)? {
        Some(map) => Ok((CheckedField::of_map(&map), Vec::new())),
        None => {
            let (transform, bounds) = load_transform(
                &arguments.file,
                arguments.volume.as_deref(),
                arguments.convention.as_deref(),
            )?;
            let warnings = transform.warnings.clone();
            match <[TransformStep; 1]>::try_from(transform.steps) {
                Ok([TransformStep::Field(field)]) => Ok((whole(field), warnings)),
                Ok(steps) => Ok((
                    sampled(
                        Transform {
                            steps: steps.into(),
                            warnings: Vec::new(),
                        },
                        &bounds,
                    )?,
                    warnings,
                )),
                Err(steps) => Ok((
                    sampled(
                        Transform {
                            steps,
                            warnings: Vec::new(),
                        },
                        &bounds,
                    )?,
                    warnings,
                )),
            }
        }
    }
}

/// The statistics of the field in a file as text, one figure per line.
fn report_as_text(path: &Path, size: [usize; 3], health: &FieldQuality, warnings: &[String]) -> String {
    let mut out = format!(
        "{} on {} x {} x {} points\n",
        path.display(),
        size[0],
        size[1],
        size[2]
    );
    let mut line = |name: &str, text: String| out.push_str(&format!("  {name:<22} {text}\n"));
    line(
        "det J",
        format!(
            "{:.4} to {:.4}, mean {:.4}",
            health.det_min, health.det_max, health.det_mean
        ),
    );
    line(
        "folds (det J <= 0)",
        format!("{:.3} % of the points", health.folds_percent),
    );
    line(
        "displacement",
        format!(
            "largest {:.3} mm, mean {:.3} mm",
            health.largest_mm, health.mean_mm
        ),
    );
    line(
        "at the border",
        format!(
            "up to {:.3} mm{}",
            health.border_mm,
            if health.border_mm > 0.1 {
                "; the displacement jumps to zero there"
            } else {
                ""
            }
        ),
    );
    line("cut away", format!("{:.3} % of the points", health.cut_percent));
    if let Some(r) = &health.inverse {
        line(
            "inverse",
            format!(
                "residual 99th percentile {:.4} mm, largest {:.4} mm; {} points without a source",
                r.p99_mm, r.max_mm, r.not_found
            ),
        );
    }
    for w in warnings {
        line("note", w.clone());
    }
    out
}

/// A field without cut points.
fn whole(field: VectorField) -> CheckedField {
    let seen = vec![true; field.vectors.len()];
    CheckedField::new(field, seen)
}

fn sampled(transform: Transform, bounds: &Bounds) -> Result<CheckedField> {
    Ok(CheckedField::of_map(&one_map(&transform, bounds, None)?))
}
