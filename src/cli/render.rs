//! `incise render`: one picture.

use super::common::{Common, check_patient, warnings};
use super::progress::TerminalProgress;
use crate::deform::quality::CheckedField;
use crate::engine::{Backend, DeviceInfo, Engine, EngineOptions, RenderRequest};
use crate::export::dicom::{self, is_dicom_name};
use crate::export::protect;
use crate::files::{OutputFile, check_distinct, memory};
use crate::picture::{Picture, RenderStats, Rendered, StageTimes};
use crate::prepare::{Prepared, idle_settings, unseen_deformations};
use crate::scene::{MapFiltering, Scene};
use crate::volume::load::Origin;
use crate::{Error, Result, Watch};
use clap::Args;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Options as typed.
#[derive(Args)]
pub struct RenderArguments {
    #[command(flatten)]
    common: Common,
    /// The picture to write: .png, or .dcm for a DICOM secondary capture; - for PNG on standard
    /// output.
    #[arg(short, long, value_name = "OUT.png")]
    output: PathBuf,
    /// Copy the patient and study attributes of the volume's DICOM series into a .dcm picture;
    /// without this option, nothing about the patient is written.
    #[arg(long)]
    patient: bool,
    /// Where to compute.
    #[arg(long, value_enum, default_value = "auto")]
    backend: Backend,
}

/// Renders and writes the picture.
pub fn run(arguments: &RenderArguments) -> Result<()> {
    let start = Instant::now();
    let common = &arguments.common;
    let scene = common.scene()?;
    check_dicom(arguments, &scene)?;
    let (output, stats_file) = outputs(arguments, &scene)?;
    common.use_threads()?;
    let bar = TerminalProgress::new(common.quiet);
    let assets = common.load(&scene, &bar)?;
    let scene = common.placed(scene, &assets)?;
    let origin = if arguments.patient {
        dicom::origin(&scene, &assets.volume, &Watch::NONE)?
    } else {
        None
    };
    check_patient(arguments.patient, origin.as_ref(), &scene)?;
    output.check()?;
    if let Some(file) = &stats_file {
        file.check()?;
    }
    let strict = arguments.backend == Backend::Gpu;
    let mut engine = Engine::open(EngineOptions {
        backend: arguments.backend,
        strict,
        ..EngineOptions::default()
    })?;
    let preparing = |share| bar.set("preparing", share);
    let mut prepared = engine.prepare(&scene, &assets, &Watch::reporting(&preparing))?;
    common.check_effects(&idle_settings(&prepared, &scene))?;
    if !scene.deformation.is_empty() {
        let unseen = unseen_deformations(&scene, &assets, &prepared)?;
        prepared.notices.extend(unseen);
    }
    common.report(assets.library.notices());
    let needs_stats = common.stats.is_some() || common.json;
    let rendering = |share| bar.set("rendering", share);
    let request = RenderRequest {
        count_samples: needs_stats,
        watch: Watch::reporting(&rendering),
        ..RenderRequest::default()
    };
    let (rendered, device) = engine.render(&prepared, &request)?;
    bar.finish();
    common.report(
        engine
            .fallback()
            .map(|error| format!("{error}; rendering on the CPU")),
    );
    common.report(&rendered.notices);
    let mut stages = assets.stages.clone();
    stages.0.extend(prepared.stages.0.iter().copied());
    stages.0.extend(rendered.stages.0.iter().copied());
    let bytes = stages.time("encode", || {
        encoded(arguments, &scene, origin.as_ref(), &rendered.picture)
    })?;
    stages.time("write", || output.finish(&bytes))?;
    let total = start.elapsed().as_secs_f64() * 1e3;
    if needs_stats {
        let notices = [
            warnings(&scene, &assets),
            assets.library.notices(),
            rendered.notices.clone(),
        ]
        .concat();
        let mut report = report(
            &rendered,
            &device,
            &prepared,
            &stages,
            &notices,
            total,
            arguments.backend,
        );
        report["filter"] = json!(engine.filter());
        report["map_filter"] = json!(match prepared.settings.map_filter {
            Some(MapFiltering::Hardware) => "trilinear, 8-bit weights",
            Some(MapFiltering::Shader) => "trilinear, 24-bit weights or more",
            None => engine.filter(),
        });
        common.write_stats(&format!("{report:#}"), stats_file)?;
    }
    if common.verbose {
        super::print_to_stderr(format_args!(
            "{} on {} in {total:.0} ms",
            arguments.output.display(),
            device.name
        ));
    }
    Ok(())
}

/// The picture over the background, as PNG or DICOM.
fn encoded(
    arguments: &RenderArguments,
    scene: &Scene,
    origin: Option<&Origin>,
    picture: &Picture,
) -> Result<Vec<u8>> {
    let background = scene.render.background;
    if !is_dicom_name(&arguments.output) {
        return picture.png(background);
    }
    dicom::picture(scene, picture, origin, arguments.patient).map_err(|e| Error::file(&arguments.output, e))
}

/// Checks what applies to DICOM alone.
fn check_dicom(arguments: &RenderArguments, scene: &Scene) -> Result<()> {
    let is_dicom = is_dicom_name(&arguments.output);
    if arguments.patient && !is_dicom {
        return Err(Error::value(
            "--patient",
            "applies to DICOM output; give a name that ends in .dcm",
        ));
    }
    if is_dicom && scene.render.background[3] < 1.0 {
        return Err(Error::value(
            format!("--output {}", arguments.output.display()),
            "a DICOM picture has no transparency; set an opaque --background, or write .png",
        ));
    }
    Ok(())
}

/// The outputs for the picture and the report: neither may be an input, nor may they be the same
/// file.
fn outputs(arguments: &RenderArguments, scene: &Scene) -> Result<(OutputFile, Option<OutputFile>)> {
    let (picture, common) = (&arguments.output, &arguments.common);
    let read = scene.files();
    let written = [
        Some(("--output", picture)),
        common.stats.as_ref().map(|s| ("--stats", s)),
    ];
    for (option, path) in written
        .into_iter()
        .flatten()
        .filter(|(_, path)| *path != Path::new("-"))
    {
        protect(
            option,
            path,
            read.iter().map(PathBuf::as_path).chain([common.input.as_path()]),
        )?;
    }
    if let Some(stats) = common.stats.as_ref().filter(|s| *s != Path::new("-")) {
        check_distinct(picture, "--stats", stats)?;
    }
    let output = OutputFile::create_or_standard(picture)?;
    let is_picture =
        || is_dicom_name(picture) || picture.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
    if output.is_file() && !is_picture() {
        return Err(Error::value(
            format!("--output {}", picture.display()),
            "pictures are written as PNG or DICOM; give a name that ends in .png or .dcm",
        ));
    }
    let stats = common.stats_file()?;
    if output.is_standard_output()
        && (common.reports_to_standard_output() || stats.as_ref().is_some_and(OutputFile::is_standard_output))
    {
        return Err(Error::value(
            "--stats, --json",
            "the picture and the report cannot both go to standard output; write one of them to a file",
        ));
    }
    Ok((output, stats))
}

fn report(
    rendered: &Rendered,
    device: &DeviceInfo,
    prepared: &Prepared,
    stages: &StageTimes,
    notices: &[String],
    total: f64,
    requested: Backend,
) -> Value {
    let Picture { width, height, .. } = rendered.picture;
    let stage_entries: serde_json::Map<String, Value> = stages
        .0
        .iter()
        .map(|(name, ms)| ((*name).to_owned(), json!(ms)))
        .collect();
    let samples = rendered.stats.map(
        |RenderStats {
             samples_taken,
             samples_skipped,
             samples_terminated,
         }| {
            json!({ "taken": samples_taken, "skipped": samples_skipped, "terminated": samples_terminated })
        },
    );
    let maps: Vec<Value> = prepared
        .stack
        .maps()
        .iter()
        .map(|m| json!({ "size": m.map.size, "storage": m.map.storage, "bytes": m.stored_bytes(), "health": CheckedField::of_map(m).health(false) }))
        .collect();
    let composition = prepared.composition.map(|c| {
        json!({ "bound_mm": c.bound_mm, "maps": c.maps, "composed": c.composed, "worst_mm": c.worst_mm, "p99_mm": c.p99_mm, "share_by_maps": c.fallback_share })
    });
    json!({
        "backend": device.backend(),
        "requested_backend": format!("{requested:?}").to_lowercase(),
        "adapter": device.name,
        "gpu": device.details,
        "mode": prepared.settings.mode,
        "size": [width, height],
        "step_voxels": prepared.settings.step,
        "step_mm": prepared.frame.spacing.step_mm,
        "samples": samples,
        "notices": notices,
        "jacobian": prepared.settings.jacobian,
        "maps": maps,
        "tears": prepared.tears,
        "composition": composition,
        "macrocells": prepared.volume().macrocells.size.to_array(),
        "milliseconds": stage_entries,
        "total_milliseconds": total,
        "peak_memory_bytes": memory::peak_bytes(),
    })
}
