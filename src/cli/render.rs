//! `incise render`: one picture.

use super::common::{Common, warnings};
use super::progress::Progress;
use crate::compare::peak_memory_bytes;
use crate::deform::health::Examined;
use crate::export::{png, protect};
use crate::files::{Output, check_distinct};
use crate::scene::{Assets, Picture, Prepared, RenderStats, Rendered, Scene, Stages, Unaided};
use crate::{Error, Result, Watch, cpu};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Where the picture is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Backend {
    /// A hardware GPU if there is one, else the CPU.
    Auto,
    /// A GPU, a software one included; an error if there is none.
    Gpu,
    /// The CPU.
    Cpu,
}

/// Options as typed.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    common: Common,
    /// The picture to write (.png); - for standard output.
    #[arg(short, long, value_name = "OUT.png")]
    output: PathBuf,
    /// Where to compute.
    #[arg(long, value_enum, default_value = "auto")]
    backend: Backend,
}

/// Renders and writes the picture.
pub fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    let common = &arguments.common;
    let scene = common.scene()?;
    let (output, stats_file) = outputs(arguments, &scene)?;
    common.use_threads()?;
    let bar = Progress::new(common.quiet);
    let assets = common.load(&scene, &bar)?;
    output.check()?;
    if let Some(file) = &stats_file {
        file.check()?;
    }
    let mut gpu = Gpu::open(arguments)?;
    let preparing = |share| bar.set("preparing", share);
    let prepared = gpu.prepare(&scene, &assets, arguments.backend, &Watch::telling(&preparing))?;
    common.tell(assets.library.notices());
    let wants_stats = common.stats.is_some() || common.json;
    let done = render_on(arguments, gpu, &prepared, wants_stats, &bar)?;
    bar.finish();
    common.tell(&done.rendered.notices);
    let mut stages = assets.stages.clone();
    stages.0.extend(prepared.stages.0.iter().copied());
    stages.0.extend(done.rendered.stages.0.iter().copied());
    let bytes = stages.time("encode", || png(&done.rendered.picture, scene.render.background))?;
    stages.time("write", || output.finish(&bytes))?;
    let total = start.elapsed().as_secs_f64() * 1e3;
    if wants_stats {
        let notices = [warnings(&scene, &assets), assets.library.notices(), done.rendered.notices.clone()].concat();
        let report = report(&done, &prepared, &stages, &notices, total, arguments.backend);
        common.write_stats(&format!("{report:#}"), stats_file)?;
    }
    if common.verbose {
        super::tell(format_args!("{} on {} in {total:.0} ms", arguments.output.display(), done.adapter));
    }
    Ok(())
}

/// Where the picture and the report go: never to a file that is read, nor both to one file.
fn outputs(arguments: &Arguments, scene: &Scene) -> Result<(Output, Option<Output>)> {
    let (picture, common) = (&arguments.output, &arguments.common);
    let read = scene.files();
    let written = [Some(("--output", picture)), common.stats.as_ref().map(|s| ("--stats", s))];
    for (option, path) in written.into_iter().flatten().filter(|(_, path)| *path != Path::new("-")) {
        protect(option, path, read.iter().map(PathBuf::as_path).chain([common.input.as_path()]))?;
    }
    if let Some(stats) = common.stats.as_ref().filter(|s| *s != Path::new("-")) {
        check_distinct(picture, "--stats", stats)?;
    }
    let output = Output::create_or_standard(picture)?;
    let is_png = || picture.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
    if output.is_file() && !is_png() {
        return Err(Error::value(format!("--output {}", picture.display()), "pictures are written as PNG; give a name that ends in .png"));
    }
    let stats = common.stats_file()?;
    if output.is_standard_output() && (common.reports_to_standard_output() || stats.as_ref().is_some_and(Output::is_standard_output)) {
        return Err(Error::value("--stats, --json", "the picture and the report cannot both go to standard output; write one of them to a file"));
    }
    Ok((output, stats))
}

/// A picture and where it was made.
struct Done {
    rendered: Rendered,
    backend: &'static str,
    adapter: String,
    details: Value,
}

fn on_cpu(prepared: &Prepared, bar: &Progress) -> Done {
    let rendered = cpu::render(prepared, &|share| bar.set("rendering", share));
    Done { rendered, backend: "cpu", adapter: format!("CPU, {} threads", rayon::current_num_threads()), details: Value::Null }
}

/// The GPU, if one is to be used.
#[cfg(feature = "gpu")]
struct Gpu {
    renderer: Option<crate::render::Renderer>,
    setup: Stages,
    /// Why `auto` has none.
    refusal: Option<Error>,
}

#[cfg(feature = "gpu")]
impl Gpu {
    fn open(arguments: &Arguments) -> Result<Self> {
        use crate::gpu::{Device, Want};
        let want = match arguments.backend {
            Backend::Cpu => return Ok(Self { renderer: None, setup: Stages::default(), refusal: None }),
            Backend::Auto => Want::Hardware,
            Backend::Gpu => Want::Any,
        };
        let mut setup = Stages::default();
        match setup.time("gpu setup", || Device::open(want)) {
            Ok(device) => Ok(Self { renderer: Some(crate::render::Renderer::new(device)), setup, refusal: None }),
            Err(error) if arguments.backend == Backend::Auto => Ok(Self { renderer: None, setup, refusal: Some(error) }),
            Err(error) => Err(error),
        }
    }

    /// The scene resolved, by the device if there is one; where none was asked for, a device that fails is done without.
    fn prepare<'a>(&mut self, scene: &Scene, assets: &'a Assets, backend: Backend, watch: &Watch) -> Result<Prepared<'a>> {
        let Some(renderer) = &self.renderer else {
            return Prepared::until(&Unaided, scene, assets, watch);
        };
        match Prepared::until(renderer, scene, assets, watch) {
            Err(error @ (Error::Gpu(_) | Error::GpuLimit(_))) if backend == Backend::Auto => {
                (self.renderer, self.refusal) = (None, Some(error));
                Prepared::until(&Unaided, scene, assets, watch)
            }
            prepared => prepared,
        }
    }
}

#[cfg(feature = "gpu")]
fn render_on(arguments: &Arguments, gpu: Gpu, prepared: &Prepared, wants_stats: bool, bar: &Progress) -> Result<Done> {
    let attempt = match (gpu.renderer, gpu.refusal) {
        (None, None) => return Ok(on_cpu(prepared, bar)),
        (None, Some(error)) => Err(error),
        (Some(mut renderer), _) => {
            let (info, details) = (renderer.device().info(), renderer.device().report());
            renderer.render(prepared, wants_stats, &|share| bar.set("rendering", share)).map(|mut rendered| {
                rendered.stages.0.splice(0..0, gpu.setup.0);
                Done { rendered, backend: "gpu", adapter: info, details }
            })
        }
    };
    match attempt {
        Err(error) if arguments.backend == Backend::Auto => {
            arguments.common.tell([format!("{error}; rendering on the CPU")]);
            Ok(on_cpu(prepared, bar))
        }
        other => other,
    }
}

/// No GPU.
#[cfg(not(feature = "gpu"))]
struct Gpu;

#[cfg(not(feature = "gpu"))]
impl Gpu {
    fn open(arguments: &Arguments) -> Result<Self> {
        if arguments.backend == Backend::Gpu {
            return Err(Error::Gpu("this build has no GPU renderer; use --backend cpu, or build with the feature `gpu`".into()));
        }
        Ok(Self)
    }

    fn prepare<'a>(&mut self, scene: &Scene, assets: &'a Assets, _backend: Backend, watch: &Watch) -> Result<Prepared<'a>> {
        Prepared::until(&Unaided, scene, assets, watch)
    }
}

#[cfg(not(feature = "gpu"))]
fn render_on(_arguments: &Arguments, _gpu: Gpu, prepared: &Prepared, _wants_stats: bool, bar: &Progress) -> Result<Done> {
    Ok(on_cpu(prepared, bar))
}

fn report(done: &Done, prepared: &Prepared, stages: &Stages, notices: &[String], total: f64, asked: Backend) -> Value {
    let Picture { width, height, .. } = done.rendered.picture;
    let stage_entries: serde_json::Map<String, Value> = stages.0.iter().map(|(name, ms)| ((*name).to_owned(), json!(ms))).collect();
    let samples = done.rendered.stats.map(|RenderStats { samples_taken, samples_skipped, samples_terminated }| {
        json!({ "taken": samples_taken, "skipped": samples_skipped, "terminated": samples_terminated })
    });
    let maps: Vec<Value> = prepared
        .stack
        .maps()
        .iter()
        .map(|m| json!({ "size": m.map.size, "storage": m.map.storage, "bytes": m.map.stored_bytes(), "health": Examined::of_map(m).health(false) }))
        .collect();
    let composition = prepared.composition.map(|c| {
        json!({ "bound_mm": c.bound_mm, "maps": c.maps, "composed": c.composed, "worst_mm": c.worst_mm, "p99_mm": c.p99_mm, "share_by_maps": c.by_maps })
    });
    json!({
        "backend": done.backend,
        "requested_backend": format!("{asked:?}").to_lowercase(),
        "adapter": done.adapter,
        "gpu": done.details,
        "mode": prepared.settings.mode,
        "size": [width, height],
        "step_voxels": prepared.settings.step,
        "step_mm": prepared.frame.step_mm,
        "samples": samples,
        "notices": notices,
        "maps": maps,
        "composition": composition,
        "macrocells": prepared.macrocells.size.to_array(),
        "milliseconds": stage_entries,
        "total_milliseconds": total,
        "peak_memory_bytes": peak_memory_bytes(),
    })
}
