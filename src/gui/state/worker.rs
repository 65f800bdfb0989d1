//! Background rendering: the interface submits jobs and continues.
//!
//! One thread renders, the most urgent job first. A newer job replaces a waiting one of the same
//! target and cancels a running one, except for coarse pictures and slices: those finish, so that a
//! drag keeps receiving pictures. A second thread picks the point under the pointer, so that
//! picking never waits for a picture. Coarse pictures and slices leave one core to the interface.

mod pool;
mod probe;

pub use pool::quiet_pool;
pub use probe::{ProbePurpose, ProbeRequest, ProbeResult, Prober};

use super::log::LogLevel;
use super::slice_paint::{self, Overlay, SliceStyle};
use crate::cpu::section::{self, Section, SectionPlane};
use crate::engine::{Backend, DeviceInfo, Engine, EngineOptions, Quality, RenderRequest, ScenePicture};
use crate::picture::{Picture, RenderStats};
use crate::prepare::measure::Quantity;
use crate::prepare::{Assets, Deformed};
use crate::scene::measure::Measure;
use crate::scene::{Scene, ViewFrame};
use crate::{Error, Result, Watch};
use eframe::egui::{self, ColorImage};
use glam::Vec3;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// The target of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum JobTarget {
    /// The 3D view during interaction.
    Coarse,
    /// The 3D view at rest.
    Fine,
    /// A slice: axial, coronal, sagittal; from 3 on, the same of the source.
    Slice(usize),
    /// A side of the comparison.
    Compare(usize),
    /// A preset's thumbnail.
    Preset(usize),
    /// A kind's thumbnail.
    Kind(usize),
    /// The values of the measurements.
    Measures,
}

impl JobTarget {
    /// Lower values run first.
    fn urgency(self) -> u8 {
        match self {
            Self::Coarse => 0,
            Self::Slice(_) => 1,
            Self::Fine => 2,
            Self::Compare(_) => 3,
            Self::Measures => 4,
            Self::Preset(_) => 5,
            Self::Kind(_) => 6,
        }
    }

    /// Whether a newer or more urgent job cancels it while it runs.
    fn stops(self) -> bool {
        !matches!(self, Self::Coarse | Self::Slice(_))
    }
}

/// The work of a job.
pub enum JobKind {
    /// A picture of the scene.
    Picture {
        /// Count samples.
        counting: bool,
        /// Also return the floating-point picture.
        with_pixels: bool,
        /// Its quality.
        quality: Quality,
    },
    /// A slice.
    Slice(SectionPlane, SliceStyle),
    /// The values of the measurements.
    Measures(Vec<Measure>),
}

/// A job.
pub struct Job {
    /// Its target.
    pub target: JobTarget,
    /// Number, returned with the result.
    pub serial: u64,
    /// The scene.
    pub scene: Arc<Scene>,
    /// Its assets.
    pub assets: Arc<Assets>,
    /// The work.
    pub what: JobKind,
}

/// A measurement with its values, and the displayed positions of its points.
#[derive(Clone)]
pub struct MeasureResult {
    /// The measurement.
    pub measure: Measure,
    /// Its values, or why there are none.
    pub quantities: Result<Vec<Quantity>, String>,
    /// Its points in the deformed scene.
    pub seen: Vec<Option<Vec3>>,
}

/// A slice with the data for later queries.
pub struct SlicePicture {
    /// Pixels.
    pub image: ColorImage,
    /// Its plane.
    pub plane: SectionPlane,
    /// The sampled section.
    pub section: Section,
    /// Its style.
    pub style: SliceStyle,
    /// The deformation with which it was made; none for the source or without deformations.
    deformed: Option<Deformed>,
}

impl SlicePicture {
    /// The source position of a point on it, mm.
    pub fn source(&self, point: Vec3) -> Vec3 {
        self.deformed
            .as_ref()
            .map_or(point, |d| d.stack.source_and_alpha(point).0)
    }
}

/// A rendered picture.
pub struct RenderedView {
    /// Pixels over the scene's background.
    pub image: ColorImage,
    /// The floating-point picture, if requested.
    pub picture: Option<Picture>,
    /// Sample counts.
    pub stats: Option<RenderStats>,
    /// Time by stage, ms.
    pub stages: Vec<(String, f64)>,
    /// Notices.
    pub notices: Vec<String>,
    /// Why the picture is empty, if it is.
    pub blank: Option<String>,
    /// The device that rendered it.
    pub device: DeviceInfo,
    /// Its sampling distance, voxels.
    pub step: f32,
    /// Its camera.
    pub frame: ViewFrame,
    /// For a picture of the 3D view: the scene's measurements that have points, by index.
    pub measured: Vec<Option<MeasureResult>>,
}

/// The result of a job.
pub enum JobOutput {
    /// A picture.
    Picture(Box<RenderedView>),
    /// A slice.
    Slice(Box<SlicePicture>),
    /// Measurements.
    Measures(Vec<MeasureResult>),
}

/// A job that is done.
pub struct FinishedJob {
    /// Its target.
    pub target: JobTarget,
    /// Its number.
    pub serial: u64,
    /// The result.
    pub outcome: Result<JobOutput>,
    /// Time taken, ms.
    pub ms: f64,
}

struct Running {
    target: JobTarget,
    cancel: Arc<AtomicBool>,
    /// Dropped while running, so it is not queued again.
    dropped: bool,
}

#[derive(Default)]
struct Queue {
    jobs: Vec<Job>,
    running: Option<Running>,
    closed: bool,
    backend: Backend,
    /// The device must be given up before the next picture.
    lose_device: bool,
    /// The device must free the last scene before the next job.
    forget_scene: bool,
}

#[derive(Default)]
struct WorkerState {
    queue: Mutex<Queue>,
    wake: Condvar,
    /// Fraction of the running job that is done, in thousandths.
    progress: AtomicU32,
}

fn lock<T>(m: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic cannot leave the data inconsistent: jobs are only added or taken as a whole.
    m.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The thread that renders.
pub struct Worker {
    shared: Arc<WorkerState>,
    done: Receiver<FinishedJob>,
    messages: Receiver<(LogLevel, String)>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Worker {
    /// Starts the thread.
    pub fn new(ctx: &egui::Context, backend: Backend) -> Self {
        let shared = Arc::new(WorkerState::default());
        lock(&shared.queue).backend = backend;
        let (send, done) = channel();
        let (message_sender, messages) = channel();
        let (own, ctx) = (shared.clone(), ctx.clone());
        let thread = std::thread::Builder::new()
            .name("renderer".into())
            .spawn(move || run(&own, &send, &message_sender, &ctx))
            .ok();
        Self {
            shared,
            done,
            messages,
            thread,
        }
    }

    /// Submits a job; a waiting job of the same target is dropped.
    pub fn submit(&self, job: Job) {
        let mut queue = lock(&self.shared.queue);
        let target = job.target;
        if let Some(running) = &queue.running {
            let more_urgent = target.urgency() < running.target.urgency();
            let newer = running.target == target
                || (target == JobTarget::Coarse && running.target == JobTarget::Fine);
            if running.target.stops() && (more_urgent || newer) {
                running.cancel.store(true, Ordering::Relaxed);
            }
        }
        queue.jobs.retain(|j| j.target != target);
        queue.jobs.push(job);
        self.shared.wake.notify_one();
    }

    /// Drops waiting jobs of the targets, and cancels a running one.
    pub fn drop_jobs(&self, which: impl Fn(JobTarget) -> bool) {
        let mut queue = lock(&self.shared.queue);
        queue.jobs.retain(|j| !which(j.target));
        if let Some(running) = queue.running.as_mut().filter(|r| which(r.target)) {
            running.cancel.store(true, Ordering::Relaxed);
            running.dropped = true;
        }
    }

    /// The next finished job, if any.
    pub fn poll(&self) -> Option<FinishedJob> {
        self.done.try_recv().ok()
    }

    /// The next message, if any.
    pub fn poll_message(&self) -> Option<(LogLevel, String)> {
        self.messages.try_recv().ok()
    }

    /// The running job's target, and the fraction done.
    pub fn progress(&self) -> Option<(JobTarget, f32)> {
        let target = lock(&self.shared.queue).running.as_ref().map(|r| r.target)?;
        Some((
            target,
            self.shared.progress.load(Ordering::Relaxed) as f32 / 1000.0,
        ))
    }

    /// Whether no job is running or waiting.
    pub fn is_idle(&self) -> bool {
        let queue = lock(&self.shared.queue);
        queue.running.is_none() && queue.jobs.is_empty() && !queue.forget_scene
    }

    /// Selects the backend for subsequent pictures.
    pub fn set_backend(&self, backend: Backend) {
        lock(&self.shared.queue).backend = backend;
    }

    /// Drops all jobs and cancels the running one; the device frees what it holds of their scene.
    pub fn forget_scene(&self) {
        self.drop_jobs(|_| true);
        lock(&self.shared.queue).forget_scene = true;
        self.shared.wake.notify_one();
    }

    /// Gives up the GPU: the next picture finds its device lost, and reopens it.
    pub fn lose_device(&self) {
        lock(&self.shared.queue).lose_device = true;
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        {
            let mut queue = lock(&self.shared.queue);
            queue.closed = true;
            queue.jobs.clear();
            if let Some(running) = &queue.running {
                running.cancel.store(true, Ordering::Relaxed);
            }
        }
        self.shared.wake.notify_all();
        if let Some(thread) = self.thread.take() {
            // If the thread panicked while rendering, the panic is not propagated.
            let _ended = thread.join();
        }
    }
}

/// A job taken from the queue, and how to carry it out.
struct StartedJob {
    job: Job,
    cancel: Arc<AtomicBool>,
    backend: Backend,
    /// Whether to give up the device first.
    lose_device: bool,
}

/// Waits for a job and takes the most urgent one; none once the queue is closed. Before it waits or
/// takes one, `forget_scene` is called if it was requested.
fn next_job(shared: &WorkerState, mut forget_scene: impl FnMut()) -> Option<StartedJob> {
    let mut queue = lock(&shared.queue);
    loop {
        if queue.closed {
            return None;
        }
        if queue.forget_scene {
            drop(queue);
            forget_scene();
            queue = lock(&shared.queue);
            queue.forget_scene = false;
            continue;
        }
        if let Some(n) = (0..queue.jobs.len()).min_by_key(|n| queue.jobs[*n].target.urgency()) {
            let job = queue.jobs.remove(n);
            let cancel = Arc::new(AtomicBool::new(false));
            queue.running = Some(Running {
                target: job.target,
                cancel: cancel.clone(),
                dropped: false,
            });
            let lose_device = std::mem::take(&mut queue.lose_device);
            return Some(StartedJob {
                job,
                cancel,
                backend: queue.backend,
                lose_device,
            });
        }
        queue = shared.wake.wait(queue).unwrap_or_else(PoisonError::into_inner);
    }
}

/// Carries out jobs until the queue is closed.
fn run(
    shared: &WorkerState,
    send: &Sender<FinishedJob>,
    log: &Sender<(LogLevel, String)>,
    ctx: &egui::Context,
) {
    let pool = quiet_pool();
    let mut renderer = Renderer {
        engine: None,
        log: log.clone(),
    };
    while let Some(StartedJob {
        job,
        cancel,
        backend,
        lose_device,
    }) = next_job(shared, || {
        if let Some(engine) = &mut renderer.engine {
            engine.forget_scene();
        }
    }) {
        shared.progress.store(0, Ordering::Relaxed);
        if let (true, Ok(engine)) = (lose_device, renderer.engine(backend)) {
            engine.lose_device();
        }
        let start = Instant::now();
        let report = |share: f32| {
            let now = (share * 1000.0) as u32;
            let before = shared.progress.swap(now, Ordering::Relaxed);
            if now / 50 != before / 50 && job.target.stops() {
                ctx.request_repaint();
            }
        };
        let watch = Watch {
            progress: &report,
            cancel: &cancel,
        };
        let quiet = !matches!(job.target, JobTarget::Fine | JobTarget::Compare(_));
        let mut work = || renderer.work(&job, backend, &watch);
        // A panic in one picture is reported, and the next one is rendered.
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| match &pool {
            Some(pool) if quiet => pool.install(work),
            _ => work(),
        }))
        .unwrap_or_else(|_| {
            Err(Error::value(
                "rendering",
                "failed because of an internal error; the scene is intact",
            ))
        });
        let mut queue = lock(&shared.queue);
        let dropped = queue.running.take().is_some_and(|r| r.dropped);
        let stopped = dropped || matches!(outcome, Err(Error::Cancelled));
        if stopped
            && !dropped
            && !queue.closed
            && !queue.jobs.iter().any(|j| j.target == job.target)
            && !matches!(job.target, JobTarget::Fine)
        {
            // The job was cancelled only in favour of a more urgent one, so it is queued again.
            queue.jobs.push(job);
            continue;
        }
        drop(queue);
        if !stopped {
            let done = FinishedJob {
                target: job.target,
                serial: job.serial,
                outcome,
                ms: start.elapsed().as_secs_f64() * 1e3,
            };
            if send.send(done).is_err() {
                return;
            }
        }
        ctx.request_repaint();
    }
}

/// The engine, and the channel for its messages.
struct Renderer {
    engine: Option<Engine>,
    log: Sender<(LogLevel, String)>,
}

impl Renderer {
    /// The engine of a backend; reopened if the backend changes.
    fn engine(&mut self, backend: Backend) -> Result<&mut Engine> {
        if self
            .engine
            .as_ref()
            .is_none_or(|engine| engine.backend() != backend)
        {
            let engine = Engine::open(EngineOptions {
                backend,
                ..EngineOptions::default()
            })?;
            if let (Backend::Gpu, Some(error)) = (backend, engine.fallback()) {
                self.warn(format!("{error}; pictures are rendered on the CPU"));
            }
            self.engine = Some(engine);
        }
        self.engine
            .as_mut()
            .ok_or_else(|| Error::Gpu("no renderer could be opened".into()))
    }

    fn warn(&self, text: String) {
        // There is no receiver once the window has closed.
        let _gone = self.log.send((LogLevel::Warning, text));
    }

    fn work(&mut self, job: &Job, backend: Backend, watch: &Watch) -> Result<JobOutput> {
        match &job.what {
            JobKind::Picture {
                counting,
                with_pixels,
                quality,
            } => {
                let request = RenderRequest {
                    quality: *quality,
                    count_samples: *counting,
                    watch: *watch,
                };
                let engine = self.engine(backend)?;
                let picture = engine.picture(&job.scene, &job.assets, &request);
                let warnings = engine.take_warnings();
                warnings.into_iter().for_each(|text| self.warn(text));
                let mut picture = shown(picture?, *with_pixels);
                if matches!(job.target, JobTarget::Coarse | JobTarget::Fine) {
                    picture.measured = measured_points(job, watch)?;
                }
                Ok(JobOutput::Picture(Box::new(picture)))
            }
            JobKind::Slice(plane, style) => {
                slice(job, *plane, *style, watch).map(|s| JobOutput::Slice(Box::new(s)))
            }
            JobKind::Measures(measures) => measured(job, measures, watch).map(JobOutput::Measures),
        }
    }
}

fn shown(picture: ScenePicture, with_pixels: bool) -> RenderedView {
    let ScenePicture {
        prepared,
        rendered,
        device,
    } = picture;
    let picture = rendered.picture;
    let bytes = picture.over(prepared.settings.background);
    let image = ColorImage::from_rgba_unmultiplied([picture.width as usize, picture.height as usize], &bytes);
    let stages = prepared
        .stages
        .0
        .iter()
        .chain(&rendered.stages.0)
        .map(|(name, ms)| ((*name).to_owned(), *ms))
        .collect();
    RenderedView {
        image,
        picture: with_pixels.then_some(picture),
        stats: rendered.stats,
        stages,
        notices: rendered.notices,
        blank: rendered.blank,
        device,
        step: prepared.settings.step,
        frame: prepared.frame.view,
        measured: Vec::new(),
    }
}

fn slice(job: &Job, plane: SectionPlane, style: SliceStyle, watch: &Watch) -> Result<SlicePicture> {
    let assets = &job.assets;
    let deformed = if style.source {
        None
    } else {
        Some(Deformed::watched(&job.scene, assets, watch)?)
    };
    let maps = deformed.as_ref().map(Deformed::stack_and_cuts);
    let determinants = style.overlay == Overlay::Jacobian;
    let section = section::sample(&assets.volume, assets.grid(), maps, plane, determinants, watch)?;
    let image = slice_paint::paint(&section, assets, style);
    let deformed = deformed.filter(|d| !d.stack.is_empty());
    Ok(SlicePicture {
        image,
        plane,
        section,
        style,
        deformed,
    })
}

fn measured(job: &Job, measures: &[Measure], watch: &Watch) -> Result<Vec<MeasureResult>> {
    let deformed = Deformed::watched(&job.scene, &job.assets, watch)?;
    measures
        .iter()
        .map(|m| watch.check().map(|()| measured_in(m, &job.assets, &deformed)))
        .collect()
}

/// The measurements of a picture that have points.
fn measured_points(job: &Job, watch: &Watch) -> Result<Vec<Option<MeasureResult>>> {
    let measures = &job.scene.measure;
    if measures.iter().all(|m| m.points.is_empty()) {
        return Ok(vec![None; measures.len()]);
    }
    let deformed = Deformed::watched(&job.scene, &job.assets, watch)?;
    let of = |m: &Measure| {
        watch.check()?;
        Ok((!m.points.is_empty()).then(|| measured_in(m, &job.assets, &deformed)))
    };
    measures.iter().map(of).collect()
}

fn measured_in(measure: &Measure, assets: &Assets, deformed: &Deformed) -> MeasureResult {
    MeasureResult {
        quantities: measure.quantities(assets, deformed).map_err(|e| e.to_string()),
        seen: measure
            .points
            .iter()
            .map(|p| deformed.forward(Vec3::from(*p)))
            .collect(),
        measure: measure.clone(),
    }
}
