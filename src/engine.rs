//! Selects the backend that renders: a GPU if a suitable one exists, else the CPU. A lost GPU is
//! reopened once, after which the CPU takes over.
//!
//! *How to call it*: [`Engine::auto`] and [`Engine::render_scene`] for one picture of a scene. To
//! render many pictures of a scene, load its assets into an [`AssetCache`] and call
//! [`Engine::picture`]; to time the steps separately, call [`Engine::prepare`] and
//! [`Engine::render`].
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

use crate::picture::Rendered;
#[cfg(feature = "gpu")]
use crate::picture::StageTimes;
use crate::prepare::{AssetKey, Assets, LoadOptions, PrepareOptions, Prepared};
#[cfg(feature = "gpu")]
use crate::render::Renderer;
use crate::scene::{Antialias, Mode, Scene, SliceOrder};
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
    /// Makes a GPU that is missing, fails or cannot hold a scene an error instead of falling back
    /// to the CPU.
    pub strict: bool,
    /// Pictures report how long the GPU took to draw, by its own clock.
    pub time_passes: bool,
}

/// Slices composited inside one fragment while a view moves.
pub const DRAFT_SLAB: u32 = 32;

/// The requested quality of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Quality {
    /// As the scene specifies.
    #[default]
    Full,
    /// For a moving view: `scale` pixels of the view along each axis become one pixel of the
    /// picture, the step is doubled if `scale` exceeds 1.5, antialiasing is off, interpolation is
    /// linear, and slices are drawn in slabs from front to back.
    Draft {
        /// Pixels of the view per pixel of the picture, along each axis.
        scale: f32,
    },
}

impl Quality {
    /// The scene as rendered at this quality.
    fn of(self, scene: &Scene) -> Cow<'_, Scene> {
        let Self::Draft { scale } = self else {
            return Cow::Borrowed(scene);
        };
        let mut draft = scene.clone();
        draft.render.size = draft.render.size.map(|n| ((n as f32 / scale) as u32).max(16));
        draft.render.step = (draft.render.step * if scale > 1.5 { 2.0 } else { 1.0 }).min(100.0);
        draft.render.antialias = Antialias::OFF;
        if draft.render.mode == Mode::Slice {
            draft.render.slab = draft.render.slab.max(DRAFT_SLAB);
            draft.render.slice_order = SliceOrder::FrontToBack;
        }
        Cow::Owned(draft)
    }
}

/// What one picture should contain.
#[derive(Clone, Copy)]
pub struct RenderRequest<'a> {
    /// Its quality.
    pub quality: Quality,
    /// Whether a GPU counts its samples, at a small cost; the CPU always does.
    pub count_samples: bool,
    /// Receives the fraction of work done, and can cancel it.
    pub watch: Watch<'a>,
}

impl Default for RenderRequest<'_> {
    fn default() -> Self {
        Self {
            quality: Quality::Full,
            count_samples: false,
            watch: Watch::NONE,
        }
    }
}

impl<'a> RenderRequest<'a> {
    /// How the scene is prepared for it.
    fn options(&self, options: PrepareOptions<'a>) -> PrepareOptions<'a> {
        options
            .as_draft(self.quality != Quality::Full)
            .watched(&self.watch)
    }
}

/// The device that computed a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceInfo {
    /// Whether it is a GPU, including a software one.
    pub is_gpu: bool,
    /// Whether it is a software GPU, emulated by the processor.
    pub is_software: bool,
    /// Its name, for display.
    pub name: String,
    /// Details of a GPU, for reports.
    pub details: Value,
}

impl DeviceInfo {
    fn cpu() -> Self {
        Self {
            is_gpu: false,
            is_software: false,
            name: format!("CPU, {} threads", rayon::current_num_threads()),
            details: Value::Null,
        }
    }

    /// `gpu` or `cpu`.
    pub fn backend(&self) -> &'static str {
        if self.is_gpu { "gpu" } else { "cpu" }
    }
}

/// A picture with the prepared scene it shows.
pub struct ScenePicture<'a> {
    /// The scene as rendered.
    pub prepared: Prepared<'a>,
    /// The picture.
    pub rendered: Rendered,
    /// What computed it.
    pub device: DeviceInfo,
}

/// The assets of the most recently rendered scene. Its volume is reused if the next scene shows the
/// same one.
#[derive(Default)]
pub struct AssetCache(Option<(AssetKey, Arc<Assets>)>);

impl AssetCache {
    /// The assets of a scene; nothing is loaded if the cached ones still apply.
    ///
    /// # Errors
    /// Errors from the readers; [`Error::Cancelled`].
    pub fn load(&mut self, scene: &Scene, options: &LoadOptions) -> Result<Arc<Assets>> {
        let key = AssetKey::of(scene);
        if let Some((_, assets)) = self.0.as_ref().filter(|(of, _)| *of == key) {
            return Ok(assets.clone());
        }
        let previous = self.0.as_ref().map(|(_, assets)| &**assets);
        let assets = Arc::new(Assets::load_with(
            scene,
            &LoadOptions {
                previous: previous.or(options.previous),
                ..*options
            },
        )?);
        self.0 = Some((key, assets.clone()));
        Ok(assets)
    }
}

/// Renders prepared scenes on the selected backend.
pub struct Engine {
    options: EngineOptions,
    #[cfg(feature = "gpu")]
    gpu: Option<Renderer>,
    /// Why the CPU computes although a GPU was requested or preferred.
    fallback: Option<Error>,
    /// Time taken to open the GPU, until a picture has reported it.
    #[cfg(feature = "gpu")]
    setup: StageTimes,
    warnings: Vec<String>,
}

impl Engine {
    /// A hardware GPU if there is one, else the CPU.
    pub fn auto() -> Self {
        let mut engine = Self::closed(EngineOptions::default());
        engine.fallback = pollster::block_on(engine.open_gpu()).err();
        engine
    }

    /// The CPU.
    pub fn cpu() -> Self {
        Self::closed(EngineOptions {
            backend: Backend::Cpu,
            ..EngineOptions::default()
        })
    }

    /// Opens the backend that the options request.
    ///
    /// # Errors
    /// [`Error::Gpu`] if a GPU is required (`strict`) and no suitable one exists.
    pub fn open(options: EngineOptions) -> Result<Self> {
        pollster::block_on(Self::open_async(options))
    }

    /// Like [`Self::open`], but does not block the thread while the driver responds. Rendering
    /// still blocks until the picture has been read back.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub async fn open_async(options: EngineOptions) -> Result<Self> {
        let mut engine = Self::closed(options);
        match engine.open_gpu().await {
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
            #[cfg(feature = "gpu")]
            setup: StageTimes::default(),
            warnings: Vec::new(),
        }
    }

    /// The requested backend.
    pub fn backend(&self) -> Backend {
        self.options.backend
    }

    /// The device that currently computes pictures.
    pub fn device(&self) -> DeviceInfo {
        #[cfg(feature = "gpu")]
        if let Some(renderer) = &self.gpu {
            return gpu_info(renderer);
        }
        DeviceInfo::cpu()
    }

    /// Bytes of the volume's textures on the GPU: values with colours, and gradients; none if the
    /// CPU computes.
    pub fn gpu_volume_bytes(&self) -> Option<[u64; 2]> {
        #[cfg(feature = "gpu")]
        return self.gpu.as_ref().map(Renderer::volume_bytes);
        #[cfg(not(feature = "gpu"))]
        None
    }

    /// How voxels are interpolated, for reports.
    pub fn filter(&self) -> &'static str {
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &self.gpu {
            return gpu.filter();
        }
        "trilinear, 32-bit weights"
    }

    /// Why the CPU computes although the options allow a GPU.
    pub fn fallback(&self) -> Option<&Error> {
        self.fallback.as_ref()
    }

    /// What happened to the GPU since the last call, one sentence each.
    pub fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    /// Renders a scene. Its files are loaded for this picture alone.
    ///
    /// # Errors
    /// Errors from the readers; any setting that cannot be used, by name.
    pub fn render_scene(&mut self, scene: &Scene) -> Result<Rendered> {
        let assets = Assets::load(scene)?;
        Ok(self.picture(scene, &assets, &RenderRequest::default())?.rendered)
    }

    /// Renders a scene whose assets are loaded.
    ///
    /// # Errors
    /// Any setting that cannot be used, by name; [`Error::Cancelled`]; GPU errors, if the options
    /// are strict.
    pub fn picture<'a>(
        &mut self,
        scene: &Scene,
        assets: &'a Assets,
        request: &RenderRequest,
    ) -> Result<ScenePicture<'a>> {
        let scene = request.quality.of(scene);
        let on_gpu = self.picture_on_gpu(&scene, assets, request)?;
        let over_limit = match on_gpu {
            Attempt::Done(picture) => return Ok(*picture),
            Attempt::Cpu(reason) => reason,
        };
        request.watch.check()?;
        let options = request.options(PrepareOptions::default());
        let prepared = Prepared::with(&scene, assets, &options)?;
        let mut rendered = cpu::render_watched(&prepared, &request.watch)?;
        rendered.notices.extend(over_limit);
        Ok(ScenePicture {
            prepared,
            rendered,
            device: DeviceInfo::cpu(),
        })
    }

    /// Resolves a scene on the device that will render it.
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

    /// Renders a prepared scene. A GPU that fails is not reopened: the scene prepared on it is lost
    /// with it, and the CPU renders instead.
    ///
    /// # Errors
    /// [`Error::Cancelled`]; GPU errors, if the options are strict.
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

/// The outcome of a request on the GPU.
#[cfg_attr(
    not(feature = "gpu"),
    allow(dead_code, reason = "without a GPU every picture is the CPU's")
)]
enum Attempt<'a> {
    Done(Box<ScenePicture<'a>>),
    /// The CPU has to render this picture, for the reason given in its notices, if any.
    Cpu(Option<String>),
}

#[cfg(feature = "gpu")]
fn gpu_info(renderer: &Renderer) -> DeviceInfo {
    DeviceInfo {
        is_gpu: true,
        is_software: renderer.device().is_software(),
        name: renderer.device().info(),
        details: renderer.device().report(),
    }
}

#[cfg(feature = "gpu")]
impl Engine {
    async fn open_gpu(&mut self) -> Result<()> {
        use crate::gpu::{AdapterPreference, Device};
        let want = match self.options.backend {
            Backend::Cpu => return Ok(()),
            Backend::Auto => AdapterPreference::Hardware,
            Backend::Gpu => AdapterPreference::Any,
        };
        let start = std::time::Instant::now();
        let device = Device::open_async(want).await?;
        self.setup
            .0
            .push(("gpu setup", start.elapsed().as_secs_f64() * 1e3));
        let mut renderer = Renderer::new(device);
        renderer.time_passes(self.options.time_passes);
        self.gpu = Some(renderer);
        Ok(())
    }

    /// Frees what the GPU holds of the last scene, if one is open.
    pub fn forget_scene(&mut self) {
        #[cfg(feature = "gpu")]
        if let Some(renderer) = &mut self.gpu {
            renderer.forget_scene();
        }
    }

    /// Gives up the GPU as if its driver had failed: the next picture finds the device lost. If
    /// none is open, tries to open one.
    pub fn lose_device(&mut self) {
        match &self.gpu {
            Some(renderer) => renderer.device().device.destroy(),
            None => self.fallback = pollster::block_on(self.open_gpu()).err(),
        }
    }

    fn picture_on_gpu<'a>(
        &mut self,
        scene: &Scene,
        assets: &'a Assets,
        request: &RenderRequest,
    ) -> Result<Attempt<'a>> {
        for reopen in [true, false] {
            let Some(renderer) = &mut self.gpu else { break };
            let attempt = if renderer.device().is_lost() {
                Err(Error::Gpu("the device was lost".into()))
            } else {
                let attempt = || -> Result<_> {
                    let options = request.options(PrepareOptions::on(renderer));
                    let prepared = Prepared::with(scene, assets, &options)?;
                    let rendered = renderer.render(&prepared, request.count_samples, &request.watch)?;
                    Ok((prepared, rendered))
                };
                // If the device is lost in the middle of a picture, the first call to notice may be
                // one that cannot report it.
                std::panic::catch_unwind(std::panic::AssertUnwindSafe(attempt))
                    .unwrap_or_else(|_| Err(Error::Gpu("the driver failed".into())))
            };
            match attempt {
                Ok((prepared, mut rendered)) => {
                    rendered.stages.0.splice(0..0, std::mem::take(&mut self.setup).0);
                    return Ok(Attempt::Done(Box::new(ScenePicture {
                        prepared,
                        rendered,
                        device: gpu_info(renderer),
                    })));
                }
                Err(Error::Gpu(problem)) if !self.options.strict => {
                    self.gpu = None;
                    let outcome = match reopen.then(|| pollster::block_on(self.open_gpu())) {
                        Some(Ok(())) => "incise reconnected",
                        _ => "pictures are now rendered on the CPU",
                    };
                    self.warnings
                        .push(format!("the GPU stopped responding ({problem}); {outcome}"));
                    self.fallback = self.gpu.is_none().then_some(Error::Gpu(problem));
                }
                // The GPU may be able to render the next scene.
                Err(error @ Error::GpuLimit(_)) if !self.options.strict => {
                    return Ok(Attempt::Cpu(Some(format!(
                        "this picture was rendered on the CPU ({error})"
                    ))));
                }
                Err(error) => return Err(error),
            }
        }
        Ok(Attempt::Cpu(None))
    }
}

#[cfg(not(feature = "gpu"))]
impl Engine {
    async fn open_gpu(&mut self) -> Result<()> {
        match self.options.backend {
            Backend::Gpu => Err(Error::Gpu(
                "this build has no GPU renderer; use --backend cpu, or build with the feature `gpu`".into(),
            )),
            Backend::Auto | Backend::Cpu => Ok(()),
        }
    }

    fn picture_on_gpu<'a>(
        &mut self,
        _scene: &Scene,
        _assets: &'a Assets,
        _request: &RenderRequest,
    ) -> Result<Attempt<'a>> {
        Ok(Attempt::Cpu(None))
    }
}
