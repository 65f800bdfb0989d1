//! `incise render`: one picture.

use super::arguments;
use super::progress::Progress;
use crate::deform::health::Examined;
use crate::export::{Output, png, protect, same_file};
use crate::scene::surface::CutModel;
use crate::scene::{Assets, Camera, InsideMesh, Mode, Picture, Prepared, Projection, RenderStats, Rendered, Scene, Stages, View};
use crate::{Error, Result, cpu};
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

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ModeName {
    /// The volume by slices.
    Slice,
    /// The volume by rays.
    Raycast,
    /// The surface of a signed distance field.
    Surface,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CutModelName {
    /// Nothing: a thin shell.
    Hollow,
    /// Matter.
    Solid,
    /// A thick skin around nothing.
    Thick,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ProjectionName {
    Perspective,
    Orthographic,
}

/// Options as typed.
#[derive(Args)]
pub struct Arguments {
    /// A scene (.toml), a volume (DICOM file, folder or zip, .nii.gz, .nrrd, .mha, .vti, .tif and so on), a mesh (.stl, .obj, .ply, .off, .gltf, .glb, .gii) or phantom:NAME[:size=N].
    input: PathBuf,
    #[command(flatten)]
    volume: arguments::VolumeArguments,
    /// The picture to write (.png).
    #[arg(short, long, value_name = "OUT.png")]
    output: PathBuf,
    /// Where to compute.
    #[arg(long, value_enum, default_value = "auto")]
    backend: Backend,
    /// The volume by slices or by rays, or surfaces.
    #[arg(long, value_enum)]
    mode: Option<ModeName>,
    /// Size of the picture.
    #[arg(long, value_name = "WxH", value_parser = arguments::picture_size)]
    size: Option<[u32; 2]>,
    /// Sampling distance in voxels (of the smallest spacing).
    #[arg(long)]
    step: Option<f32>,
    /// Average this many by this many samples into each pixel (1 to 4).
    #[arg(long, value_name = "N")]
    antialias: Option<u32>,
    /// anterior, posterior, left, right, superior, inferior or AZ,EL in degrees.
    #[arg(long, allow_hyphen_values = true, value_parser = |t: &str| t.parse::<View>())]
    camera: Option<View>,
    /// 1 shows the whole volume.
    #[arg(long)]
    zoom: Option<f32>,
    /// Kind of camera.
    #[arg(long, value_enum)]
    projection: Option<ProjectionName>,
    /// Transfer function by name (see incise list).
    #[arg(long)]
    preset: Option<String>,
    /// Width of the value range that the transfer function spans.
    #[arg(long)]
    window: Option<f64>,
    /// Middle of that range.
    #[arg(long, allow_hyphen_values = true)]
    level: Option<f64>,
    /// A deformation, applied after those of the scene; repeatable, in order.
    #[arg(long, value_name = "KIND[:name=value,...]")]
    deform: Vec<String>,
    /// Compose all deformations into one map that is this exact, mm.
    #[arg(long, value_name = "MM")]
    precompose: Option<f32>,
    /// Value of the volume whose surface is shown (mode surface; data units).
    #[arg(long, value_name = "VALUE", allow_hyphen_values = true)]
    iso: Option<f64>,
    /// Look of surfaces by name (see incise list).
    #[arg(long, value_name = "NAME")]
    look: Option<String>,
    /// What lies under a surface where it is cut.
    #[arg(long, value_enum)]
    cut_model: Option<CutModelName>,
    /// A closed mesh: the volume is shown inside of it.
    #[arg(long, value_name = "MESH")]
    inside: Option<String>,
    /// R,G,B[,A] (0..1 or 0..255), #rrggbb or transparent.
    #[arg(long, value_parser = arguments::background)]
    background: Option<[f32; 4]>,
    /// Write a JSON report of what was done to a file, or to standard output (-).
    #[arg(long, value_name = "FILE|-")]
    stats: Option<PathBuf>,
    /// The same report on standard output.
    #[arg(long)]
    json: bool,
    /// Threads of the CPU renderer; all cores by default.
    #[arg(long)]
    threads: Option<usize>,
    /// No notices, no progress.
    #[arg(short, long)]
    quiet: bool,
    /// Say what was done.
    #[arg(short, long)]
    verbose: bool,
}

impl Arguments {
    /// The scene that the input names, with the options laid over it.
    fn scene(&self) -> Result<Scene> {
        let mut scene = Scene::of_input(&self.input)?;
        self.volume.apply(&mut scene)?;
        let render = &mut scene.render;
        match self.mode {
            Some(ModeName::Slice) => render.mode = Mode::Slice,
            Some(ModeName::Raycast) => render.mode = Mode::Raycast,
            Some(ModeName::Surface) => render.mode = Mode::Surface,
            None => {}
        }
        render.size = self.size.unwrap_or(render.size);
        render.step = self.step.unwrap_or(render.step);
        render.antialias = self.antialias.unwrap_or(render.antialias);
        render.background = self.background.unwrap_or(render.background);
        let camera = &mut scene.camera;
        if let Some(view) = self.camera {
            // Another direction, not the scene's framing of its own.
            *camera = Camera { view, projection: camera.projection, field_of_view: camera.field_of_view, ..Camera::default() };
        }
        camera.zoom = self.zoom.unwrap_or(camera.zoom);
        match self.projection {
            Some(ProjectionName::Perspective) => camera.projection = Projection::Perspective,
            Some(ProjectionName::Orthographic) => camera.projection = Projection::Orthographic,
            None => {}
        }
        let transfer = &mut scene.transfer;
        if let Some(preset) = &self.preset {
            transfer.preset = Some(preset.clone());
            transfer.points.clear();
        }
        transfer.window = self.window.or(transfer.window);
        transfer.level = self.level.or(transfer.level);
        scene.render.precompose = self.precompose.or(scene.render.precompose);
        scene.surface.iso = self.iso.or(scene.surface.iso);
        for appearance in scene.mesh.iter_mut().map(|m| &mut m.appearance).chain([&mut scene.surface.appearance]) {
            if let Some(look) = &self.look {
                (appearance.look, appearance.color, appearance.inside_color, appearance.cut_color) = (Some(look.clone()), None, None, None);
            }
            appearance.model = match self.cut_model {
                Some(CutModelName::Hollow) => Some(CutModel::Hollow),
                Some(CutModelName::Solid) => Some(CutModel::Solid),
                Some(CutModelName::Thick) => Some(CutModel::Thick),
                None => appearance.model,
            };
        }
        if let Some(mesh) = &self.inside {
            let volume = scene.volume.as_mut().ok_or_else(|| Error::value("--inside", "needs a volume to show inside of the mesh"))?;
            // As typed, from where it was typed; a scene's own paths start at the scene.
            let path = std::path::absolute(mesh).map_err(|e| Error::io(Path::new(mesh), "reading", e))?;
            volume.inside = Some(InsideMesh { path: path.to_string_lossy().into_owned(), ..InsideMesh::default() });
        }
        for text in &self.deform {
            scene.deformation.push(arguments::deformation(text)?);
        }
        Ok(scene)
    }
}

/// Renders and writes the picture.
pub fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    if arguments.output.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() != Some("png") {
        return Err(Error::value(format!("--output {}", arguments.output.display()), "pictures are written as PNG; give a name that ends in .png"));
    }
    let scene = arguments.scene()?;
    protect_inputs(arguments, &scene)?;
    let output = Output::create(&arguments.output)?;
    let stats_file = arguments.stats.as_deref().filter(|p| *p != Path::new("-")).map(Output::create).transpose()?;
    if let Some(threads) = arguments.threads {
        if !(1..=1024).contains(&threads) {
            return Err(Error::value("--threads", format!("{threads} is outside 1 to 1024")));
        }
        // The pool exists once per process; this is the first use.
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().map_err(|e| Error::value("--threads", e.to_string()))?;
    }
    let bar = Progress::new(arguments.quiet);
    let assets = Assets::load(&scene, &|what, share| bar.set(what, share))?;
    if !arguments.quiet {
        for warning in &assets.volume.warnings {
            eprintln!("incise: {}: {warning}", scene.volume_name());
        }
    }
    let mut gpu = Gpu::open(arguments)?;
    let prepared = gpu.prepare(&scene, &assets)?;
    if !arguments.quiet {
        for notice in assets.library.notices() {
            eprintln!("incise: {notice}");
        }
    }
    let wants_stats = arguments.stats.is_some() || arguments.json;
    let done = render_on(arguments, gpu, &prepared, wants_stats, &bar)?;
    bar.finish();
    if !arguments.quiet {
        for notice in &done.rendered.notices {
            eprintln!("incise: {notice}");
        }
    }
    let mut stages = assets.stages.clone();
    stages.0.extend(prepared.stages.0.iter().copied());
    stages.0.extend(done.rendered.stages.0.iter().copied());
    let bytes = stages.time("encode", || png(&done.rendered.picture, scene.render.background))?;
    stages.time("write", || output.finish(&bytes))?;
    let total = start.elapsed().as_secs_f64() * 1e3;
    if wants_stats {
        let report = report(&done, &prepared, &stages, total, arguments.backend);
        let text = format!("{report:#}");
        if arguments.json || arguments.stats.as_deref() == Some(Path::new("-")) {
            super::print(&text);
        }
        if let Some(file) = stats_file {
            file.finish(text.as_bytes())?;
        }
    }
    if arguments.verbose {
        eprintln!("incise: {} on {} in {total:.0} ms", arguments.output.display(), done.adapter);
    }
    Ok(())
}

/// Nothing is ever written to a file that is read, nor two things to one file.
fn protect_inputs(arguments: &Arguments, scene: &Scene) -> Result<()> {
    let read = scene.files();
    let written = [Some(("--output", &arguments.output)), arguments.stats.as_ref().map(|s| ("--stats", s))];
    for (option, path) in written.into_iter().flatten() {
        protect(option, path, read.iter().map(PathBuf::as_path).chain([arguments.input.as_path()]))?;
    }
    if arguments.stats.as_ref().is_some_and(|s| same_file(s, &arguments.output)) {
        return Err(Error::value("--stats", "names the same file as --output; choose another name"));
    }
    Ok(())
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

    /// The scene resolved; what has to be composed is composed on the device, if there is one.
    fn prepare<'a>(&mut self, scene: &Scene, assets: &'a Assets) -> Result<Prepared<'a>> {
        match &self.renderer {
            Some(renderer) => Prepared::composed_by(scene, assets, &|stack, points| renderer.evaluate(stack, points)),
            None => Prepared::new(scene, assets),
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
            if !arguments.quiet {
                eprintln!("incise: {error}; rendering on the CPU");
            }
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

    fn prepare<'a>(&mut self, scene: &Scene, assets: &'a Assets) -> Result<Prepared<'a>> {
        Prepared::new(scene, assets)
    }
}

#[cfg(not(feature = "gpu"))]
fn render_on(_arguments: &Arguments, _gpu: Gpu, prepared: &Prepared, _wants_stats: bool, bar: &Progress) -> Result<Done> {
    Ok(on_cpu(prepared, bar))
}

fn report(done: &Done, prepared: &Prepared, stages: &Stages, total: f64, asked: Backend) -> Value {
    let Picture { width, height, .. } = done.rendered.picture;
    let stage_entries: serde_json::Map<String, Value> = stages.0.iter().map(|(name, ms)| ((*name).to_owned(), json!(ms))).collect();
    let samples = done.rendered.stats.map(|RenderStats { samples_taken, samples_skipped, samples_terminated }| {
        json!({ "taken": samples_taken, "skipped": samples_skipped, "terminated": samples_terminated })
    });
    let maps: Vec<Value> = prepared
        .stack
        .maps()
        .iter()
        .map(|m| json!({ "size": m.map.size, "storage": m.map.storage, "bytes": m.map.gpu_bytes(), "health": Examined::of_map(m).health(false) }))
        .collect();
    let composition = prepared.composition.map(|c| json!({ "maps": c.maps, "worst_mm": c.worst_mm, "p99_mm": c.p99_mm }));
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
        "maps": maps,
        "composition": composition,
        "macrocells": prepared.macrocells.size.to_array(),
        "milliseconds": stage_entries,
        "total_milliseconds": total,
        "peak_memory_bytes": peak_memory_bytes(),
    })
}

/// The process's largest resident size, where the system tells.
fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib * 1024)
}
