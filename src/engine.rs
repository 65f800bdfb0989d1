//! The one place where pictures get a backend: a GPU where there is one that will do, else the CPU; a lost GPU is opened once more, and then the
//! CPU takes over.
//!
//! *How to call it*: [`Engine::auto`] and [`Engine::render_scene`] for a picture of a scene. Who renders many pictures of one scene loads its assets
//! into an [`AssetCache`] and asks for each with [`Engine::picture`]; who times the steps calls [`Engine::prepare`] and [`Engine::render`].
//!
//! ```no_run
//! # fn main() -> incise::Result<()> {
//! use incise::{Engine, Scene};
//! let scene = Scene::of_volume("phantom:head-ct");
//! let rendered = Engine::auto().render_scene(&scene)?;
//! # let _ = rendered;
//! # Ok(())
//! # }
//! ```

use crate::picture::{Rendered, StageTimes};
use crate::prepare::{AssetKey, Assets, LoadOptions, PrepareOptions, Prepared};
#[cfg(feature = "gpu")]
use crate::render::Renderer;
use crate::scene::Scene;
use crate::{Error, Result, Watch, cpu};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::borrow::Cow;
use std::sync::Arc;

/// Where pictures are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// A hardware GPU if there is one, else the CPU.
    #[default]
    Auto,
    /// Any GPU (software adapters included); an error if there is none.
    Gpu,
    /// The CPU.
    Cpu,
}

/// How an [`Engine`] is opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EngineOptions {
    /// Where pictures are computed.
    pub backend: Backend,
    /// A GPU that is missing, fails or cannot hold a scene is an error, rather than a reason to use the CPU.
    pub strict: bool,
    /// Pictures report how long the GPU drew, by its own clock.
    pub time_passes: bool,
}

/// How good a picture is wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Quality {
    /// As the scene says.
    #[default]
    Full,
    /// For a view that moves: this many pixels of the view along each axis become one, steps are doubled where that is more than 1.5, and nothing is
    /// antialiased.
    Draft {
        /// Pixels of the view per pixel of the picture, along each axis.
        scale: f32,
    },
}

impl Quality {
    /// The scene as it is rendered.
    fn of(self, scene: &Scene) -> Cow<'_, Scene> {
        let Self::Draft { scale } = self else { return Cow::Borrowed(scene) };
        let mut draft = scene.clone();
        draft.render.size = draft.render.size.map(|n| ((n as f32 / scale) as u32).max(16));
        draft.render.step = (draft.render.step * if scale > 1.5 { 2.0 } else { 1.0 }).min(100.0);
        draft.render.antialias = 1;
        Cow::Owned(draft)
    }
}

/// What is wanted of one picture.
#[derive(Clone, Copy)]
pub struct RenderRequest<'a> {
    /// How good it is to be.
    pub quality: Quality,
    /// Whether a GPU counts its samples, which costs a little; the CPU always does.
    pub count_samples: bool,
    /// Receives the share that is done, and says when to stop.
    pub watch: Watch<'a>,
}

impl Default for RenderRequest<'_> {
    fn default() -> Self {
        Self { quality: Quality::Full, count_samples: false, watch: Watch::NONE }
    }
}

/// What computed a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceInfo {
    /// Whether it is a GPU, a software one included.
    pub is_gpu: bool,
    /// Whether it is a GPU that a processor emulates.
    pub is_software: bool,
    /// Its name, for people.
    pub name: String,
    /// Details of a GPU, for reports.
    pub details: Value,
}

impl DeviceInfo {
    fn cpu() -> Self {
        Self { is_gpu: false, is_software: false, name: format!("CPU, {} threads", rayon::current_num_threads()), details: Value::Null }
    }

    /// `gpu` or `cpu`.
    pub fn backend(&self) -> &'static str {
        if self.is_gpu { "gpu" } else { "cpu" }
    }
}

/// A picture with the prepared scene that it shows.
pub struct ScenePicture<'a> {
    /// The scene as it was rendered.
    pub prepared: Prepared<'a>,
    /// The picture.
    pub rendered: Rendered,
    /// What computed it.
    pub device: DeviceInfo,
}

/// The assets of the scene that was rendered last, and of its volume if the next one shows the same.
#[derive(Default)]
pub struct AssetCache(Option<(AssetKey, Arc<Assets>)>);

impl AssetCache {
    /// The assets of a scene: those that are there if nothing of it needs loading.
    ///
    /// # Errors
    /// What the readers report; [`Error::Cancelled`].
    pub fn load(&mut self, scene: &Scene, options: &LoadOptions) -> Result<Arc<Assets>> {
        let key = AssetKey::of(scene);
        if let Some((_, assets)) = self.0.as_ref().filter(|(of, _)| *of == key) {
            return Ok(assets.clone());
        }
        let previous = self.0.as_ref().map(|(_, assets)| &**assets);
        let assets = Arc::new(Assets::load_with(scene, &LoadOptions { previous: previous.or(options.previous), ..*options })?);
        self.0 = Some((key, assets.clone()));
        Ok(assets)
    }
}

/// Renders prepared scenes on the backend that was chosen for it.
pub struct Engine {
    options: EngineOptions,
    #[cfg(feature = "gpu")]
    gpu: Option<Renderer>,
    /// Why the CPU computes although a GPU was to.
    fallback: Option<Error>,
    /// Time that opening the GPU took, until a picture has reported it.
    setup: StageTimes,
    warnings: Vec<String>,
}

impl Engine {
    /// A hardware GPU if there is one, else the CPU.
    pub fn auto() -> Self {
        let mut engine = Self::closed(EngineOptions::default());
        engine.fallback = engine.open_gpu().err();
        engine
    }

    /// The CPU.
    pub fn cpu() -> Self {
        Self::closed(EngineOptions { backend: Backend::Cpu, ..EngineOptions::default() })
    }

    /// As the options say.
    ///
    /// # Errors
    /// [`Error::Gpu`] if a GPU is required (`strict`) and there is none that will do.
    pub fn open(options: EngineOptions) -> Result<Self> {
        let mut engine = Self::closed(options);
        match engine.open_gpu() {
            Err(error) if options.strict => return Err(error),
            opened => engine.fallback = opened.err(),
        }
        Ok(engine)
    }

    fn closed(options: EngineOptions) -> Self {
        Self {
            options,
            #[cfg(feature = "gpu")]
            gpu: None,
            fallback: None,
            setup: StageTimes::default(),
            warnings: Vec::new(),
        }
    }

    /// The backend that was asked for.
    pub fn backend(&self) -> Backend {
        self.options.backend
    }

    /// What computes pictures now.
    pub fn device(&self) -> DeviceInfo {
        #[cfg(feature = "gpu")]
        if let Some(renderer) = &self.gpu {
            return gpu_info(renderer);
        }
        DeviceInfo::cpu()
    }

    /// Bytes of the volume's textures that are on a GPU: values with colours, and gradients; none where the CPU computes.
    pub fn gpu_volume_bytes(&self) -> Option<[u64; 2]> {
        #[cfg(feature = "gpu")]
        return self.gpu.as_ref().map(Renderer::volume_bytes);
        #[cfg(not(feature = "gpu"))]
        None
    }

    /// Why the CPU computes although the options allow a GPU.
    pub fn fallback(&self) -> Option<&Error> {
        self.fallback.as_ref()
    }

    /// What happened to the GPU since the last call, one sentence each.
    pub fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    /// A picture of a scene. What it names is loaded for this picture alone.
    ///
    /// # Errors
    /// What the readers report; any setting that cannot be used, by name.
    pub fn render_scene(&mut self, scene: &Scene) -> Result<Rendered> {
        let assets = Assets::load(scene)?;
        Ok(self.picture(scene, &assets, &RenderRequest::default())?.rendered)
    }

    /// A picture of a scene whose assets are loaded.
    ///
    /// # Errors
    /// Any setting that cannot be used, by name; [`Error::Cancelled`]; what a GPU reports, if the options are strict.
    pub fn picture<'a>(&mut self, scene: &Scene, assets: &'a Assets, request: &RenderRequest) -> Result<ScenePicture<'a>> {
        let scene = request.quality.of(scene);
        let on_gpu = self.picture_on_gpu(&scene, assets, request)?;
        let over_limit = match on_gpu {
            Attempt::Done(picture) => return Ok(*picture),
            Attempt::Cpu(reason) => reason,
        };
        request.watch.check()?;
        let prepared = Prepared::with(&scene, assets, &PrepareOptions::default().watched(&request.watch))?;
        let mut rendered = cpu::render_watched(&prepared, &request.watch)?;
        rendered.notices.extend(over_limit);
        Ok(ScenePicture { prepared, rendered, device: DeviceInfo::cpu() })
    }

    /// A scene resolved by the device that will render it.
    ///
    /// # Errors
    /// As [`Self::picture`].
    pub fn prepare<'a>(&mut self, scene: &Scene, assets: &'a Assets, watch: &Watch) -> Result<Prepared<'a>> {
        #[cfg(feature = "gpu")]
        if let Some(renderer) = &self.gpu {
            match Prepared::with(scene, assets, &PrepareOptions::on(renderer).watched(watch)) {
                Err(error @ (Error::Gpu(_) | Error::GpuLimit(_))) if !self.options.strict => {
                    (self.gpu, self.fallback) = (None, Some(error));
                }
                prepared => return prepared,
            }
        }
        Prepared::with(scene, assets, &PrepareOptions::default().watched(watch))
    }

    /// A picture of a prepared scene. A GPU that fails is not opened again: what it prepared is lost with it, and the CPU renders.
    ///
    /// # Errors
    /// [`Error::Cancelled`]; what a GPU reports, if the options are strict.
    pub fn render(&mut self, prepared: &Prepared, request: &RenderRequest) -> Result<(Rendered, DeviceInfo)> {
        #[cfg(feature = "gpu")]
        if let Some(renderer) = &mut self.gpu {
            let info = gpu_info(renderer);
            match renderer.render(prepared, request.count_samples, &request.watch) {
                Ok(mut rendered) => {
                    rendered.stages.0.splice(0..0, std::mem::take(&mut self.setup).0);
                    return Ok((rendered, info));
                }
                Err(error @ (Error::Gpu(_) | Error::GpuLimit(_))) if !self.options.strict => {
                    (self.gpu, self.fallback) = (None, Some(error));
                }
                Err(error) => return Err(error),
            }
        }
        Ok((cpu::render_watched(prepared, &request.watch)?, DeviceInfo::cpu()))
    }
}

/// What a GPU made of a request.
enum Attempt<'a> {
    Done(Box<ScenePicture<'a>>),
    /// The CPU has to render this picture, for a reason that its notices state if there is one.
    Cpu(Option<String>),
}

#[cfg(feature = "gpu")]
fn gpu_info(renderer: &Renderer) -> DeviceInfo {
    DeviceInfo { is_gpu: true, is_software: renderer.device().is_software(), name: renderer.device().info(), details: renderer.device().report() }
}

#[cfg(feature = "gpu")]
impl Engine {
    fn open_gpu(&mut self) -> Result<()> {
        use crate::gpu::{AdapterPreference, Device};
        let want = match self.options.backend {
            Backend::Cpu => return Ok(()),
            Backend::Auto => AdapterPreference::Hardware,
            Backend::Gpu => AdapterPreference::Any,
        };
        let device = self.setup.time("gpu setup", || Device::open(want))?;
        let mut renderer = Renderer::new(device);
        renderer.time_passes(self.options.time_passes);
        self.gpu = Some(renderer);
        Ok(())
    }

    /// Gives up the GPU, as if its driver had failed: the next picture finds the device lost. Where none is open, one is tried.
    pub fn lose_device(&mut self) {
        match &self.gpu {
            Some(renderer) => renderer.device().device.destroy(),
            None => self.fallback = self.open_gpu().err(),
        }
    }

    fn picture_on_gpu<'a>(&mut self, scene: &Scene, assets: &'a Assets, request: &RenderRequest) -> Result<Attempt<'a>> {
        for reopen in [true, false] {
            let Some(renderer) = &mut self.gpu else { break };
            let attempt = if renderer.device().is_lost() {
                Err(Error::Gpu("the device was lost".into()))
            } else {
                let attempt = || -> Result<_> {
                    let prepared = Prepared::with(scene, assets, &PrepareOptions::on(renderer).watched(&request.watch))?;
                    let rendered = renderer.render(&prepared, request.count_samples, &request.watch)?;
                    Ok((prepared, rendered))
                };
                // Lost in the middle of a picture, a device may be found out by a call that cannot report it.
                std::panic::catch_unwind(std::panic::AssertUnwindSafe(attempt)).unwrap_or_else(|_| Err(Error::Gpu("the driver failed".into())))
            };
            match attempt {
                Ok((prepared, mut rendered)) => {
                    rendered.stages.0.splice(0..0, std::mem::take(&mut self.setup).0);
                    return Ok(Attempt::Done(Box::new(ScenePicture { prepared, rendered, device: gpu_info(renderer) })));
                }
                Err(Error::Gpu(problem)) if !self.options.strict => {
                    self.gpu = None;
                    let outcome = match reopen.then(|| self.open_gpu()) {
                        Some(Ok(())) => "incise reconnected",
                        _ => "pictures are now rendered on the CPU",
                    };
                    self.warnings.push(format!("the GPU stopped responding ({problem}); {outcome}"));
                    self.fallback = self.gpu.is_none().then(|| Error::Gpu(problem));
                }
                // The next scene may be one for it again.
                Err(error @ Error::GpuLimit(_)) if !self.options.strict => {
                    return Ok(Attempt::Cpu(Some(format!("this picture was rendered on the CPU ({error})"))));
                }
                Err(error) => return Err(error),
            }
        }
        Ok(Attempt::Cpu(None))
    }
}

#[cfg(not(feature = "gpu"))]
impl Engine {
    fn open_gpu(&mut self) -> Result<()> {
        match self.options.backend {
            Backend::Gpu => Err(Error::Gpu("this build has no GPU renderer; use --backend cpu, or build with the feature `gpu`".into())),
            Backend::Auto | Backend::Cpu => Ok(()),
        }
    }

    fn picture_on_gpu<'a>(&mut self, _scene: &Scene, _assets: &'a Assets, _request: &RenderRequest) -> Result<Attempt<'a>> {
        Ok(Attempt::Cpu(None))
    }
}
