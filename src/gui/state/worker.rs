//! Rendering in the background: the interface asks and goes on.
//!
//! One thread renders, the most urgent job first; a newer job of the same target takes the place of one that waits, and stops one that runs if it
//! is of full quality (a coarse one is let finish: it is what keeps a drag moving). A second thread answers what lies under the pointer, so
//! that it never waits for a picture. Coarse pictures and slices leave one core to the interface.

use super::log::LogLevel;
use super::slice_paint::{self, Overlay, SliceStyle};
use crate::cpu::pick::{self, Pick};
use crate::cpu::section::{self, Section, SectionPlane};
use crate::engine::{Backend, DeviceInfo, Engine, EngineOptions, Quality, RenderRequest, ScenePicture};
use crate::picture::{Picture, RenderStats};
use crate::prepare::measure::Quantity;
use crate::prepare::{Assets, Deformed, Prepared};
use crate::scene::measure::Measure;
use crate::scene::{Scene, ViewFrame};
use crate::{Error, Result, Watch};
use eframe::egui::{self, ColorImage};
use glam::Vec3;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// What a picture is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum JobTarget {
    /// The 3D view while it moves.
    Coarse,
    /// The 3D view at rest.
    Fine,
    /// A slice: axial, coronal, sagittal; from 3 on the same of the source.
    Slice(usize),
    /// A side of the comparison.
    Compare(usize),
    /// A preset's thumbnail.
    Preset(usize),
    /// A kind's thumbnail.
    Kind(usize),
    /// Numbers of the measurements.
    Measures,
}

impl JobTarget {
    /// Lower goes first.
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

    /// Whether a newer job stops it while it runs.
    fn stops(self) -> bool {
        !matches!(self, Self::Coarse | Self::Slice(_))
    }
}

/// What to do.
pub enum JobKind {
    /// A picture of the scene.
    Picture {
        /// Count samples.
        counting: bool,
        /// Give back the picture's own numbers.
        with_pixels: bool,
        /// How good it is to be.
        quality: Quality,
    },
    /// A slice.
    Slice(SectionPlane, SliceStyle),
    /// The measurements.
    Measures(Vec<Measure>),
}

/// A job.
pub struct Job {
    /// What it is for.
    pub target: JobTarget,
    /// Told back with the result.
    pub serial: u64,
    /// The scene.
    pub scene: Arc<Scene>,
    /// Its assets.
    pub assets: Arc<Assets>,
    /// What to do.
    pub what: JobKind,
}

/// A measurement with what it comes to, and where its points are seen.
#[derive(Clone)]
pub struct MeasureResult {
    /// The measurement.
    pub measure: Measure,
    /// Numbers, or why there are none.
    pub quantities: Result<Vec<Quantity>, String>,
    /// Its points in the deformed scene.
    pub seen: Vec<Option<Vec3>>,
}

/// A slice with everything that is asked of it afterwards.
pub struct SlicePicture {
    /// Pixels.
    pub image: ColorImage,
    /// Its plane.
    pub plane: SectionPlane,
    /// What was found.
    pub section: Section,
    /// How it is shown.
    pub style: SliceStyle,
    /// The deformation it was made with; none of the source, or if there is none.
    deformed: Option<Deformed>,
}

impl SlicePicture {
    /// Where the matter at a point of it came from, mm.
    pub fn source(&self, point: Vec3) -> Vec3 {
        self.deformed.as_ref().map_or(point, |d| d.stack.source_and_alpha(point).0)
    }
}

/// A rendered picture.
pub struct RenderedView {
    /// Pixels over the scene's background.
    pub image: ColorImage,
    /// The picture's own numbers, if they were asked for.
    pub picture: Option<Picture>,
    /// Counts.
    pub stats: Option<RenderStats>,
    /// Time by stage, ms.
    pub stages: Vec<(String, f64)>,
    /// Notices.
    pub notices: Vec<String>,
    /// Why nothing is to be seen, if nothing is.
    pub blank: Option<String>,
    /// What computed it.
    pub device: DeviceInfo,
    /// Its sampling distance, voxels.
    pub step: f32,
    /// The camera it was made with.
    pub frame: ViewFrame,
    /// Of a picture of the 3D view: the scene's measurements that have points, by their place in the list.
    pub measured: Vec<Option<MeasureResult>>,
}

/// What came out.
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
    /// What it was for.
    pub target: JobTarget,
    /// The job's own number.
    pub serial: u64,
    /// The result.
    pub outcome: Result<JobOutput>,
    /// How long it took.
    pub ms: f64,
}

struct Running {
    target: JobTarget,
    cancel: Arc<AtomicBool>,
    /// Not to be taken up again.
    dropped: bool,
}

#[derive(Default)]
struct Queue {
    jobs: Vec<Job>,
    running: Option<Running>,
    closed: bool,
    backend: Backend,
    /// The device is to be given up before the next picture.
    lose: bool,
}

#[derive(Default)]
struct WorkerState {
    queue: Mutex<Queue>,
    wake: Condvar,
    /// Share of the running job that is done, in thousandths.
    progress: AtomicU32,
}

fn lock<T>(m: &Mutex<T>) -> MutexGuard<'_, T> {
    // Jobs are only ever added or taken whole.
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
    /// Starts it.
    pub fn new(ctx: &egui::Context, backend: Backend) -> Self {
        let shared = Arc::new(WorkerState::default());
        lock(&shared.queue).backend = backend;
        let (send, done) = channel();
        let (message_sender, messages) = channel();
        let (own, ctx) = (shared.clone(), ctx.clone());
        let thread = std::thread::Builder::new().name("renderer".into()).spawn(move || run(&own, &send, &message_sender, &ctx)).ok();
        Self { shared, done, messages, thread }
    }

    /// Asks for something; a job of the same target that still waits is dropped.
    pub fn submit(&self, job: Job) {
        let mut queue = lock(&self.shared.queue);
        let target = job.target;
        if let Some(running) = &queue.running {
            let more_urgent = target.urgency() < running.target.urgency();
            let newer = running.target == target || (target == JobTarget::Coarse && running.target == JobTarget::Fine);
            if running.target.stops() && (more_urgent || newer) {
                running.cancel.store(true, Ordering::Relaxed);
            }
        }
        queue.jobs.retain(|j| j.target != target);
        queue.jobs.push(job);
        self.shared.wake.notify_one();
    }

    /// Drops what waits, and stops what runs, of the targets.
    pub fn drop_jobs(&self, which: impl Fn(JobTarget) -> bool) {
        let mut queue = lock(&self.shared.queue);
        queue.jobs.retain(|j| !which(j.target));
        if let Some(running) = queue.running.as_mut().filter(|r| which(r.target)) {
            running.cancel.store(true, Ordering::Relaxed);
            running.dropped = true;
        }
    }

    /// What is done by now.
    pub fn poll(&self) -> Option<FinishedJob> {
        self.done.try_recv().ok()
    }

    /// What it has to say.
    pub fn poll_message(&self) -> Option<(LogLevel, String)> {
        self.messages.try_recv().ok()
    }

    /// The running job's target, and the share that is done.
    pub fn progress(&self) -> Option<(JobTarget, f32)> {
        let target = lock(&self.shared.queue).running.as_ref().map(|r| r.target)?;
        Some((target, self.shared.progress.load(Ordering::Relaxed) as f32 / 1000.0))
    }

    /// Whether nothing runs or waits.
    pub fn is_idle(&self) -> bool {
        let queue = lock(&self.shared.queue);
        queue.running.is_none() && queue.jobs.is_empty()
    }

    /// Chooses where pictures are computed from now on.
    pub fn set_backend(&self, backend: Backend) {
        lock(&self.shared.queue).backend = backend;
    }

    /// Gives up the GPU: the next picture finds its device lost, and opens it anew.
    pub fn lose_device(&self) {
        lock(&self.shared.queue).lose = true;
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
            // A panic in it was a bug of a picture, and is no reason for another one here.
            let _ended = thread.join();
        }
    }
}

/// Threads for what must not disturb the interface: all cores but one.
pub fn quiet_pool() -> Option<rayon::ThreadPool> {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    rayon::ThreadPoolBuilder::new().num_threads(cores.saturating_sub(1).max(1)).build().ok()
}

fn run(shared: &WorkerState, send: &Sender<FinishedJob>, log: &Sender<(LogLevel, String)>, ctx: &egui::Context) {
    let pool = quiet_pool();
    let mut renderer = Renderer { engine: None, log: log.clone() };
    loop {
        let (job, cancel, backend, lose) = {
            let mut queue = lock(&shared.queue);
            loop {
                if queue.closed {
                    return;
                }
                if let Some(n) = (0..queue.jobs.len()).min_by_key(|n| queue.jobs[*n].target.urgency()) {
                    let job = queue.jobs.remove(n);
                    let cancel = Arc::new(AtomicBool::new(false));
                    queue.running = Some(Running { target: job.target, cancel: cancel.clone(), dropped: false });
                    let lose = std::mem::take(&mut queue.lose);
                    break (job, cancel, queue.backend, lose);
                }
                queue = shared.wake.wait(queue).unwrap_or_else(PoisonError::into_inner);
            }
        };
        shared.progress.store(0, Ordering::Relaxed);
        if let (true, Ok(engine)) = (lose, renderer.engine(backend)) {
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
        let watch = Watch { progress: &report, cancel: &cancel };
        let quiet = !matches!(job.target, JobTarget::Fine | JobTarget::Compare(_));
        let mut work = || renderer.work(&job, backend, &watch);
        // A fault in one picture is told, and the next one is made.
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| match &pool {
            Some(pool) if quiet => pool.install(work),
            _ => work(),
        }))
        .unwrap_or_else(|_| Err(Error::value("rendering", "failed because of an internal error; the scene is intact")));
        let mut queue = lock(&shared.queue);
        let dropped = queue.running.take().is_some_and(|r| r.dropped);
        let stopped = dropped || matches!(outcome, Err(Error::Cancelled));
        if stopped && !dropped && !queue.closed && !queue.jobs.iter().any(|j| j.target == job.target) && !matches!(job.target, JobTarget::Fine) {
            // It only made room for something more urgent.
            queue.jobs.push(job);
            continue;
        }
        drop(queue);
        if !stopped {
            let done = FinishedJob { target: job.target, serial: job.serial, outcome, ms: start.elapsed().as_secs_f64() * 1e3 };
            if send.send(done).is_err() {
                return;
            }
        }
        ctx.request_repaint();
    }
}

/// What computes pictures, and what it has to say.
struct Renderer {
    engine: Option<Engine>,
    log: Sender<(LogLevel, String)>,
}

impl Renderer {
    /// The engine of a backend; another one if another is asked for.
    fn engine(&mut self, backend: Backend) -> Result<&mut Engine> {
        if self.engine.as_ref().is_none_or(|engine| engine.backend() != backend) {
            let engine = Engine::open(EngineOptions { backend, ..EngineOptions::default() })?;
            if let (Backend::Gpu, Some(error)) = (backend, engine.fallback()) {
                self.warn(format!("{error}; pictures are rendered on the CPU"));
            }
            self.engine = Some(engine);
        }
        self.engine.as_mut().ok_or_else(|| Error::Gpu("no renderer could be opened".into()))
    }

    fn warn(&self, text: String) {
        // Nobody listens once the window has closed.
        let _gone = self.log.send((LogLevel::Warning, text));
    }

    fn work(&mut self, job: &Job, backend: Backend, watch: &Watch) -> Result<JobOutput> {
        match &job.what {
            JobKind::Picture { counting, with_pixels, quality } => {
                let request = RenderRequest { quality: *quality, count_samples: *counting, watch: *watch };
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
            JobKind::Slice(plane, style) => slice(job, *plane, *style, watch).map(|s| JobOutput::Slice(Box::new(s))),
            JobKind::Measures(measures) => measured(job, measures, watch).map(JobOutput::Measures),
        }
    }
}

fn shown(picture: ScenePicture, with_pixels: bool) -> RenderedView {
    let ScenePicture { prepared, rendered, device } = picture;
    let picture = rendered.picture;
    let bytes = picture.over(prepared.settings.background);
    let image = ColorImage::from_rgba_unmultiplied([picture.width as usize, picture.height as usize], &bytes);
    let stages = prepared.stages.0.iter().chain(&rendered.stages.0).map(|(name, ms)| ((*name).to_owned(), *ms)).collect();
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
    let deformed = if style.source { None } else { Some(Deformed::watched(&job.scene, assets, watch)?) };
    let maps = deformed.as_ref().map(Deformed::stack_and_cuts);
    let determinants = style.overlay == Overlay::Jacobian;
    let section = section::sample(&assets.volume, assets.grid(), maps, plane, determinants, watch)?;
    let image = slice_paint::paint(&section, assets, style);
    let deformed = deformed.filter(|d| !d.stack.is_empty());
    Ok(SlicePicture { image, plane, section, style, deformed })
}

fn measured(job: &Job, measures: &[Measure], watch: &Watch) -> Result<Vec<MeasureResult>> {
    let deformed = Deformed::watched(&job.scene, &job.assets, watch)?;
    measures.iter().map(|m| watch.check().map(|()| measured_in(m, &job.assets, &deformed))).collect()
}

/// The measurements of a picture that lie in it.
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
        seen: measure.points.iter().map(|p| deformed.forward(Vec3::from(*p))).collect(),
        measure: measure.clone(),
    }
}

/// Why something under the pointer is asked for.
#[derive(Clone, Debug, PartialEq)]
pub enum ProbePurpose {
    /// To tell it in the status bar.
    Hover,
    /// To put it in the middle of the view.
    Center,
    /// A tool was used there.
    Tool,
    /// A point of a brush's stroke; the last one ends it.
    Brush {
        /// The stroke ends here.
        last: bool,
    },
}

/// A question about a point of the 3D view.
pub struct ProbeRequest {
    /// The scene at the view's size.
    pub scene: Arc<Scene>,
    /// Its assets.
    pub assets: Arc<Assets>,
    /// Picture coordinates in -1..1, v upwards.
    pub at: [f32; 2],
    /// What for.
    pub purpose: ProbePurpose,
}

/// The answer.
pub struct ProbeResult {
    /// Where.
    pub at: [f32; 2],
    /// What for.
    pub purpose: ProbePurpose,
    /// What was found.
    pub pick: Result<Option<Pick>>,
    /// The assets that it was found in.
    pub assets: Arc<Assets>,
}

/// The thread that answers what lies under the pointer.
pub struct Prober {
    ask: Option<Sender<ProbeRequest>>,
    answers: Receiver<ProbeResult>,
    thread: Option<std::thread::JoinHandle<()>>,
    /// Questions without an answer yet.
    pub open: usize,
}

impl Prober {
    /// Starts it.
    pub fn new(ctx: &egui::Context) -> Self {
        let (ask, questions) = channel::<ProbeRequest>();
        let (answer, answers) = channel();
        let ctx = ctx.clone();
        let thread = std::thread::Builder::new().name("prober".into()).spawn(move || probe(&questions, &answer, &ctx)).ok();
        Self { ask: Some(ask), answers, thread, open: 0 }
    }

    /// Asks.
    pub fn ask(&mut self, question: ProbeRequest) {
        if self.ask.as_ref().is_some_and(|a| a.send(question).is_ok()) {
            self.open += 1;
        }
    }

    /// What has been answered by now.
    pub fn poll(&mut self) -> Option<ProbeResult> {
        let answer = self.answers.try_recv().ok()?;
        self.open = self.open.saturating_sub(1);
        Some(answer)
    }
}

impl Drop for Prober {
    fn drop(&mut self) {
        self.ask = None;
        if let Some(thread) = self.thread.take() {
            let _ended = thread.join();
        }
    }
}

fn probe(questions: &Receiver<ProbeRequest>, answer: &Sender<ProbeResult>, ctx: &egui::Context) {
    let pool = quiet_pool();
    let mut next: Option<ProbeRequest> = None;
    while let Some(question) = next.take().or_else(|| questions.recv().ok()) {
        let (scene, assets) = (question.scene.clone(), question.assets.clone());
        let prepare = || Prepared::new(&scene, &assets);
        let fault = || Error::value("picking", "failed because of an internal error; the scene is intact");
        let prepared = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| match &pool {
            Some(pool) => pool.install(prepare),
            None => prepare(),
        }))
        .unwrap_or_else(|_| Err(fault()));
        let reply = |question: ProbeRequest, pick: Result<Option<Pick>>| {
            let sent = answer.send(ProbeResult { at: question.at, purpose: question.purpose, pick, assets: question.assets }).is_ok();
            ctx.request_repaint();
            sent
        };
        let prepared = match prepared {
            Ok(prepared) => prepared,
            Err(error) => {
                if !reply(question, Err(error)) {
                    return;
                }
                continue;
            }
        };
        let range = assets.volume.range;
        let mut current = Some(question);
        while let Some(question) = current.take() {
            let [u, v] = question.at;
            let found = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| pick::at(&prepared, range, u, v)));
            if !reply(question, found.map_err(|_| fault())) {
                return;
            }
            match questions.recv() {
                Ok(q) if Arc::ptr_eq(&q.assets, &assets) && (Arc::ptr_eq(&q.scene, &scene) || q.scene == scene) => current = Some(q),
                Ok(q) => next = Some(q),
                Err(_) => return,
            }
        }
    }
}
