//! incise's side of `run.py`: answers each JSON object, one per line on standard input, with one on
//! standard output.
//!
//! Data that is reused between pictures (volumes, fields, the device) is loaded once and cached, as
//! in the peer programs. `ms` is the time of the work alone, measured here, without the pipe. A
//! request that cannot be met is answered with its `error`.
#![allow(missing_docs, reason = "a benchmark has no callers")]

use anyhow::{Context as _, Result, bail};
use incise::Watch;
use incise::cpu;
use incise::deform::transform::{Transform, TransformContext, TransformStep, VectorField};
use incise::deform::{StackAndCuts, invert};
use incise::export::bake;
use incise::picture::{Rendered, StageTimes};
use incise::prepare::{Assets, Deformed, PrepareOptions, Prepared};
use incise::scene::Scene;
use incise::volume::GradientVolume;
use incise::volume::save::Format;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::collections::HashMap;
use std::fs;
use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The requests.
#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
enum Request {
    /// The machine and the build of the program.
    About,
    /// Reads a volume and stores it under a name.
    Load { name: String, path: String },
    /// Reads a displacement field and stores it under a name.
    LoadField { name: String, path: PathBuf },
    /// Discards a volume.
    Forget { name: String },
    /// Renders a changed scene to a picture in memory, 8 bits per channel. `volume` names a loaded
    /// volume, which replaces the scene's. The picture's bytes (RGBA) are written to `picture`.
    Render {
        volume: String,
        backend: Backend,
        scene: String,
        picture: Option<PathBuf>,
    },
    /// Bakes the deformed volume on the grid of its source, as a file's bytes in memory, which are
    /// written to `output`.
    Bake {
        volume: String,
        scene: String,
        output: Option<PathBuf>,
    },
    /// The gradients of a volume at all voxels, as stored values.
    Gradient { volume: String },
    /// Inverts a field on its own grid. The inverse is written to `output`: three f32 per point.
    Invert { field: String, output: Option<PathBuf> },
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Backend {
    Cpu,
    Gpu,
}

/// The GPU renderer, opened on first use.
#[cfg(feature = "gpu")]
#[derive(Default)]
struct Gpu(Option<incise::render::Renderer>);

#[cfg(feature = "gpu")]
impl Gpu {
    fn renderer(&mut self) -> Result<&mut incise::render::Renderer> {
        use incise::gpu::{AdapterPreference, Device};
        if self.0.is_none() {
            self.0 = Some(incise::render::Renderer::new(Device::open(
                AdapterPreference::Any,
            )?));
        }
        self.0.as_mut().context("there is no renderer")
    }

    fn about(&mut self) -> Value {
        self.renderer().map_or(Value::Null, |r| r.device().report())
    }

    fn prepare<'a>(&mut self, scene: &Scene, assets: &'a Assets) -> Result<Prepared<'a>> {
        let renderer = self.renderer()?;
        Ok(Prepared::with(scene, assets, &PrepareOptions::on(renderer))?)
    }

    fn render(&mut self, prepared: &Prepared) -> Result<Rendered> {
        Ok(self.renderer()?.render(prepared, false, &Watch::NONE)?)
    }
}

/// No GPU.
#[cfg(not(feature = "gpu"))]
#[derive(Default)]
struct Gpu;

#[cfg(not(feature = "gpu"))]
impl Gpu {
    fn about(&mut self) -> Value {
        Value::Null
    }

    fn prepare<'a>(&mut self, _scene: &Scene, _assets: &'a Assets) -> Result<Prepared<'a>> {
        bail!("this build has no GPU renderer")
    }

    fn render(&mut self, _prepared: &Prepared) -> Result<Rendered> {
        bail!("this build has no GPU renderer")
    }
}

#[derive(Default)]
struct Worker {
    volumes: HashMap<String, Assets>,
    fields: HashMap<String, VectorField>,
    gpu: Gpu,
}

impl Worker {
    fn answer(&mut self, request: Request) -> Result<Value> {
        match request {
            Request::About => {
                let program = env!("CARGO_BIN_EXE_incise");
                Ok(
                    json!({ "program": program, "threads": rayon::current_num_threads(), "gpu": self.gpu.about() }),
                )
            }
            Request::Load { name, path } => {
                let start = Instant::now();
                let assets = Assets::load(&Scene::of_volume(path))?;
                let answer = json!({ "ms": ms(start), "stages": stages(&[&assets.stages]), "size": assets.volume.size });
                self.volumes.insert(name, assets);
                Ok(answer)
            }
            Request::LoadField { name, path } => {
                let field = load_field(&path)?;
                let answer = json!({ "size": field.grid.size });
                self.fields.insert(name, field);
                Ok(answer)
            }
            Request::Forget { name } => Ok(json!({ "forgotten": self.volumes.remove(&name).is_some() })),
            Request::Render {
                volume,
                backend,
                scene,
                picture,
            } => self.render(&volume, &backend, &scene, picture.as_deref()),
            Request::Bake {
                volume,
                scene,
                output,
            } => self.bake(&volume, &scene, output.as_deref()),
            Request::Gradient { volume } => {
                let assets = find(&self.volumes, &volume)?;
                let start = Instant::now();
                let gradients = GradientVolume::new(assets.grid())
                    .context("no gradient volume is made of these voxels")?;
                Ok(json!({ "ms": ms(start), "vectors": gradients.texels.len() }))
            }
            Request::Invert { field, output } => self.invert(&field, output.as_deref()),
        }
    }

    fn render(
        &mut self,
        volume: &str,
        backend: &Backend,
        scene: &str,
        picture: Option<&Path>,
    ) -> Result<Value> {
        let scene = parse(scene)?;
        let assets = find(&self.volumes, volume)?;
        let start = Instant::now();
        let (prepared, rendered) = match backend {
            Backend::Cpu => {
                let prepared = Prepared::new(&scene, assets)?;
                let rendered = cpu::render(&prepared);
                (prepared, rendered)
            }
            Backend::Gpu => {
                let prepared = self.gpu.prepare(&scene, assets)?;
                let rendered = self.gpu.render(&prepared)?;
                (prepared, rendered)
            }
        };
        let mut last = StageTimes::default();
        let bytes = last.time("8 bits", || rendered.picture.over(scene.render.background));
        let ms = ms(start);
        write(picture, &bytes)?;
        Ok(json!({ "ms": ms, "stages": stages(&[&prepared.stages, &rendered.stages, &last]) }))
    }

    fn bake(&mut self, volume: &str, scene: &str, output: Option<&Path>) -> Result<Value> {
        let scene = parse(scene)?;
        let assets = find(&self.volumes, volume)?;
        let volume = &assets.volume;
        let start = Instant::now();
        let mut bytes = Vec::with_capacity(volume.size.iter().product::<usize>() * 4);
        let Deformed { stack, cuts, .. } = Deformed::exact(&scene, assets, true, &Watch::NONE)?;
        let deformation = StackAndCuts {
            stack: &stack,
            cuts: &cuts,
        };
        let (grid, fill) = (volume.geometry(), volume.range[0]);
        let options = bake::BakeOptions {
            interpolation: Some(bake::Interpolation::Linear),
            fill: Some(fill),
            progress: None,
        };
        bake::volume(volume, &deformation, &grid, Format::Nifti, &mut bytes, &options)?;
        let ms = ms(start);
        write(output, &bytes)?;
        Ok(json!({ "ms": ms }))
    }

    fn invert(&mut self, field: &str, output: Option<&Path>) -> Result<Value> {
        let field = find(&self.fields, field)?;
        let start = Instant::now();
        let inverse = invert::field(field);
        let ms = ms(start);
        let bytes: Vec<u8> = inverse
            .field
            .vectors
            .iter()
            .flat_map(|v| v.to_array())
            .flat_map(f32::to_le_bytes)
            .collect();
        write(output, &bytes)?;
        Ok(json!({ "ms": ms, "report": inverse.report }))
    }
}

fn ms(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

fn parse(scene: &str) -> Result<Scene> {
    Scene::from_toml(scene).map_err(anyhow::Error::msg)
}

fn find<'a, T>(all: &'a HashMap<String, T>, name: &str) -> Result<&'a T> {
    all.get(name)
        .with_context(|| format!("\"{name}\" was not loaded"))
}

fn load_field(path: &Path) -> Result<VectorField> {
    let transform = Transform::load(
        path,
        &TransformContext {
            moving: None,
            reference: None,
            convention: None,
        },
    )?;
    match <[TransformStep; 1]>::try_from(transform.steps) {
        Ok([TransformStep::Field(field)]) => Ok(field),
        _ => bail!("{} is not one displacement field", path.display()),
    }
}

fn write(path: Option<&Path>, bytes: &[u8]) -> Result<()> {
    path.map_or(Ok(()), |p| {
        fs::write(p, bytes).with_context(|| format!("{} cannot be written", p.display()))
    })
}

fn stages(all: &[&StageTimes]) -> Map<String, Value> {
    all.iter()
        .flat_map(|s| &s.0)
        .map(|(name, ms)| ((*name).to_owned(), json!(ms)))
        .collect()
}

fn main() -> Result<()> {
    let mut worker = Worker::default();
    for line in std::io::stdin().lock().lines() {
        let request = serde_json::from_str(&line?).map_err(anyhow::Error::from);
        let answer = request
            .and_then(|r| worker.answer(r))
            .unwrap_or_else(|e| json!({ "error": format!("{e:#}") }));
        let mut out = std::io::stdout().lock();
        writeln!(out, "{answer}")?;
        out.flush()?;
    }
    Ok(())
}
