//! Renders a scene on a GPU: view-aligned slices (\[DDM06\] section 4), rays, surfaces and
//! triangles, on one library of WGSL functions.
//!
//! *Theory*: the shaders in `shaders/lib` contain the arithmetic of `src/cpu`, function by
//! function. A slice is one polygon, the section of the proxy geometry by a plane; slices are drawn
//! back to front and composited "over" by the blend unit, premultiplied, in 32 bits. Options are
//! slabs of several slices composited inside a fragment, front to back with an early end, and 16
//! bits (`slices`).
//!
//! *How to call it*: a [`Renderer`] holds resources by lifetime: `context` those of the device
//! (pipelines, layouts, bind groups), `cache` those of a scene (the volume's texture, displacement
//! maps by identity, tables, macrocells, surfaces), `target` those of a picture size; `draw` draws
//! one picture. The additional work of a picture is counted ([`Renderer::work`]), and a test
//! (`tests/editing.rs`) checks it against this table:
//!
//! | edit | uploads besides uniforms | created |
//! |---|---|---|
//! | nothing, light, camera | none (slicing: its polygons) | nothing |
//! | a surface's look, a solid's placement | a solid's cells | nothing |
//! | a surface's mesh, value or labels | its field or triangles, its cells | textures, a bind group |
//! | a placement | macrocells, surfaces' cells | nothing; their texture if the deformed box needs more or fewer cells |
//! | a map's parameter | that map, macrocells, surfaces' cells | the map's texture, a bind group |
//! | transfer function | table, macrocells | nothing |
//! | volume | the volume, and what depends on it | its texture, a bind group |
//! | none: the second picture of a volume | its gradients, if they are used for lighting | their texture, bind groups |
//! | size of the picture | none | targets, for the first time; two sizes are cached |
//!
//! Devices differ in the fastest method: a [`Strategy`] selects whether rays are fragments or
//! compute invocations, whether shaders interpolate texels, and whether the device prepares scenes.
//! If it does ([`Accelerator`](crate::prepare::Accelerator)), a map given by a formula is sampled
//! on the device instead of uploaded, and empty space is found there from bounds computed there:
//! the next picture of an edited map is several times as fast as with map and cells from the CPU
//! (`benches/HISTORY.md`). Resources cached for this purpose are counted as well.
//!
//! The gradient volume replaces six fetches per lit sample; if it does not fit, or no format can
//! hold it, these are made instead. It contains values too: after a visible sample, when the next
//! one is likely to be visible as well, nothing else is fetched. On request passes are timed by the
//! GPU's own clock ([`Renderer::time_passes`]).
//!
//! Large pictures are drawn in bands and many slabs in batches, each in its own submission: a
//! driver that detects hung commands must not mistake a long one for a hang. The next submission is
//! recorded while one is running.

mod accelerator;
mod atlas;
mod cache;
mod classify;
pub mod constants;
mod context;
mod counter;
mod draw;
mod evaluate;
mod function;
mod maps;
mod object;
mod pass_timer;
mod pipelines;
mod refine;
mod sample_map;
mod slices;
mod strategy;
mod surfaces;
mod target;
pub mod uniforms;
mod variant;
mod volume;
mod work;

pub use strategy::Strategy;
pub use work::Work;

use crate::gpu::{Device, checked, wait};
use crate::picture::{Picture, RenderStats, Rendered, StageTimes};
use crate::prepare::Prepared;
use crate::scene::{Antialias, LightQuality, Mode};
use crate::transfer::Blend;
use crate::{Error, Result, Watch};
use cache::{SceneBindings, SceneCache};
use context::Context;
use counter::Counter;
use draw::Draw;
use pass_timer::PassTimer;
use refine::Samples;
use std::sync::Arc;
use target::{Layer, Targets};
use wgpu::Features;

/// Renders on one device.
pub struct Renderer {
    /// Resources of the device.
    context: Context,
    /// Resources of a scene.
    scene: SceneCache,
    /// Resources of picture sizes.
    targets: Targets,
    clock: Option<Arc<PassTimer>>,
}

impl Renderer {
    /// A renderer on an open device.
    pub fn new(device: Device) -> Self {
        Self {
            context: Context::new(device),
            scene: SceneCache::default(),
            targets: Targets::default(),
            clock: None,
        }
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.context.device
    }

    /// The current strategy.
    pub fn strategy(&self) -> Strategy {
        self.context.strategy
    }

    /// How voxels are interpolated, for reports.
    pub fn filter(&self) -> &'static str {
        match (
            self.context.strategy.exact_filter,
            self.context.device.is_software(),
        ) {
            (true, _) => "trilinear, in the shader, 24-bit weights",
            (false, true) => "trilinear, by a software driver, 32-bit weights",
            (false, false) => "trilinear, by the hardware, 8-bit weights",
        }
    }

    /// Sets the strategy of the next pictures and returns the previous one; a renderer starts with
    /// the one that suits its device.
    pub fn set_strategy(&mut self, strategy: Strategy) -> Strategy {
        std::mem::replace(&mut self.context.strategy, strategy)
    }

    /// Whether pictures report the GPU's drawing time by its own clock, where it has one: as a
    /// separate stage, subtracted from the drawing stage.
    pub fn time_passes(&mut self, on: bool) {
        self.clock = if on {
            PassTimer::new(&self.context.device.device, &self.context.tally).map(Arc::new)
        } else {
            None
        };
    }

    /// Limits volumes below the device's limits: voxels along an axis, and bytes of a texture.
    /// Larger volumes are reduced.
    pub fn limit_volume(&mut self, max_voxels: usize, max_bytes: u64) {
        self.scene.volume.limit(max_voxels, max_bytes);
        self.context.forget_groups();
    }

    /// Frees what the device holds of the last scene. The pipelines stay.
    pub fn forget_scene(&mut self) {
        let volume = self.scene.volume.emptied();
        self.scene = SceneCache::default();
        self.scene.volume = volume;
        self.targets = Targets::default();
        self.context.forget_groups();
        // A device that fails here fails at the next picture as well, which reports it.
        let _freed = wait(&self.context.device.device);
    }

    /// Bytes of the volume's textures on the device: values with colours, and gradients.
    pub fn volume_bytes(&self) -> [u64; 2] {
        self.scene.volume.bytes()
    }

    /// Number of displacement maps on the device.
    pub fn cached_map_count(&self) -> usize {
        self.scene.maps.count()
    }

    /// Writes the changed inputs of a scene, and returns the bindings of its picture.
    fn shared(&mut self, scene: &Prepared) -> Result<SceneBindings> {
        let nothing = self.targets.layer(
            &self.context,
            ["nothing: colour", "nothing: distance", "nothing: depth"],
            1,
            1,
        );
        self.scene.bindings(&self.context, scene, nothing)
    }

    fn restart_clock(&self) {
        if let Some(clock) = &self.clock {
            clock.restart();
        }
    }

    /// The GPU's drawing time since [`Self::restart_clock`], by its own clock, milliseconds.
    fn clocked(&self) -> Result<Option<f64>> {
        self.clock
            .as_ref()
            .map_or(Ok(None), |clock| clock.milliseconds(&self.context))
    }

    /// The work done since the renderer was created.
    pub fn work(&self) -> Work {
        self.context.tally.work()
    }

    /// Renders a prepared scene; `counting` counts samples, at a small cost. Cancellation is
    /// checked between submissions.
    ///
    /// # Errors
    /// A volume or picture that does not fit on the device; any error of the device;
    /// [`Error::Cancelled`].
    pub fn render(&mut self, scene: &Prepared, counting: bool, watch: &Watch) -> Result<Rendered> {
        let device = self.context.device.device.clone();
        checked(&device, || self.render_unchecked(scene, counting, watch))
    }

    fn render_unchecked(&mut self, scene: &Prepared, counting: bool, watch: &Watch) -> Result<Rendered> {
        let mut stages = StageTimes::default();
        let [width, height] = scene.frame.size;
        self.check_limits(scene)?;
        let shows_volume =
            scene.settings.mode != Mode::Surface && !scene.frame.proxy.is_empty() || scene.has_slices();
        if !shows_volume && scene.surfaces.objects.is_empty() {
            let pixels = vec![[0.0; 4]; width as usize * height as usize];
            let picture = Picture {
                width,
                height,
                pixels,
            }
            .reduced(scene.settings.antialias.grid());
            return Ok(scene.rendered(picture, Some(RenderStats::default()), stages, Vec::new()));
        }
        stages.time("upload", || -> Result<()> {
            self.scene
                .volume
                .upload(&self.context, scene.volume().grid, scene.volume().colors)?;
            if shows_volume {
                self.scene.volume.upload_gradients(&self.context, scene)?;
            }
            wait(&self.context.device.device)
        })?;
        let reduced: Vec<String> = self
            .scene
            .volume
            .texture
            .as_ref()
            .and_then(|v| v.notice.clone())
            .filter(|_| shows_volume)
            .into_iter()
            .collect();
        let mut notices = reduced;
        if shows_volume && !self.context.can_blend(scene) {
            notices.push("this GPU cannot blend 32-bit values; slices are blended in 16 bits".into());
        }
        let shared = stages.time("bind", || self.shared(scene))?;
        let counter = counting.then(|| self.targets.fresh_counter(&self.context));
        let inputs = PictureInputs {
            scene,
            shared: &shared,
            counter: counter.as_ref(),
            watch,
            samples: Samples::Pixels(scene.frame.size),
        };
        let pixels = self.draw_samples(&inputs, shows_volume, &mut stages)?;
        let mut picture = Picture {
            width,
            height,
            pixels,
        };
        if scene.settings.antialias == Antialias::Adaptive {
            picture = stages.time("antialiasing", || self.refined(&inputs, picture, shows_volume))?;
        }
        let picture = picture.reduced(scene.settings.antialias.grid());
        let stats = counter.map(|c| c.read(&self.context)).transpose()?;
        Ok(scene.rendered(picture, stats, stages, notices))
    }

    /// Checks that the device can render a scene.
    fn check_limits(&self, scene: &Prepared) -> Result<()> {
        let [width, height] = scene.frame.size;
        let limits = self.context.device.device.limits();
        if width.max(height) > limits.max_texture_dimension_2d {
            return Err(Error::GpuLimit(format!(
                "this GPU renders pictures of at most {} pixels per edge; use a smaller size",
                limits.max_texture_dimension_2d
            )));
        }
        if scene.light_volume.is_some() && scene.light.quality == LightQuality::Reference {
            return Err(Error::GpuLimit(
                "only the CPU casts the rays of light.quality = \"reference\"".into(),
            ));
        }
        if scene.settings.mode == Mode::Slice
            && scene.volume().blend != Blend::Composite
            && !self
                .context
                .device
                .device
                .features()
                .contains(Features::FLOAT32_BLENDABLE)
        {
            return Err(Error::GpuLimit("this GPU cannot blend 32-bit values, which projections by slices need (mode slice, not raycast)".into()));
        }
        Ok(())
    }

    /// Draws the surfaces of a scene, if it has any, into the layer behind its volume.
    fn draw_surfaces_behind(
        &mut self,
        inputs: &PictureInputs,
        stages: &mut StageTimes,
    ) -> Result<Option<Layer>> {
        if inputs.scene.surfaces.objects.is_empty() {
            self.scene.surfaces.forget_large_fields();
            return Ok(None);
        }
        if !inputs.scene.has_surfaces_behind() {
            return Ok(None);
        }
        self.restart_clock();
        let drawn = stages.time("surfaces drawn", || self.draw_surfaces(inputs))?;
        if let Some(drawing) = self.clocked()? {
            stages.divide("surfaces drawn", "surfaces drawn (GPU time)", drawing);
        }
        Ok(Some(drawn))
    }

    /// Draws the volume of a scene in front of a layer of surfaces, and returns the picture.
    fn draw_volume(
        &mut self,
        inputs: &PictureInputs,
        behind: Option<&Layer>,
        stages: &mut StageTimes,
    ) -> Result<wgpu::Texture> {
        let PictureInputs {
            scene,
            shared,
            counter,
            watch,
            samples,
        } = *inputs;
        let [width, height] = samples.texture_size();
        let bindings = self.scene.group(&self.context, shared, behind);
        let target = self.targets.target(
            &self.context,
            if samples.is_listed() { "samples" } else { "picture" },
            width,
            height,
            self.context.picture_format(scene),
        );
        stages.time("pipelines", || self.context.compile(scene, counter.is_some()));
        let clock = self.clock.clone();
        let draw = Draw {
            scene,
            bindings: &bindings,
            behind,
            counter,
            target: &target,
            samples,
            watch,
            clock: clock.as_deref(),
        };
        self.restart_clock();
        stages.time("draw", || match scene.settings.mode {
            Mode::Raycast => self.draw_rays(&draw),
            Mode::Slice => self.draw_slices(&draw),
            Mode::Surface => Ok(()),
        })?;
        if let Some(drawing) = self.clocked()? {
            stages.divide("draw", "draw (GPU time)", drawing);
        }
        Ok(target.texture)
    }
}

/// The inputs of one picture.
#[derive(Clone, Copy)]
struct PictureInputs<'a> {
    scene: &'a Prepared<'a>,
    shared: &'a SceneBindings,
    /// Counts samples; none if they are not counted.
    counter: Option<&'a Counter>,
    watch: &'a Watch<'a>,
    samples: Samples<'a>,
}
