//! The comparison lab: renders one scene with every renderer, over steps, sizes and cameras,
//! against references with a much finer step.
//!
//! *Theory*: the protocol of Meissner, Huang, Bartz, Mueller and Crawfis (Volume Visualization
//! 2000): same optical model, same view, same transfer function; pictures side by side with their
//! cost. Additions, and the reasons for them:
//! - *Error*: their pictures were judged by eye. Here each is measured against a **reference**:
//!   rays on the CPU at a step of 1/16 voxel (surface mode, which shows different content than the
//!   volume modes, against surfaces at that step). Errors below the error of the reference itself
//!   are meaningless, so a reference must be at least twice as fine as the finest run. If the error
//!   is proportional to the step, the reference's is 1/16 of that of a run at step 1; gaps thinner
//!   than a step, which only fine steps resolve, increase it.
//! - *Speed at equal error*: any renderer can be made faster by a coarser step, so each is rated by
//!   its time at a common error ([`super::curves`]).
//! - *Time* is the median of repetitions. On a GPU a first picture, which uploads the volume and
//!   compiles shaders, is rendered without timing. Curves show the time after the scene was
//!   prepared, because preparation is the same for all renderers. Data that is cached between
//!   pictures (maps, empty space, tables) is cached here too; the time to build it the first time
//!   is reported once.
//!
//! *How to call it*: a [`Plan`], [`Assets`] loaded for [`Plan::loading`], [`open_gpu`] for a GPU,
//! then [`run`].

use super::metrics::difference;
use super::report::{Protocol, Report};
use super::run::{Run, Times, mode_name, owned, run as timed_run};
use crate::engine::{Backend, Engine, EngineOptions, RenderRequest};
use crate::picture::{MAX_PICTURE_EDGE, MAX_PIXELS};
use crate::prepare::{Assets, Prepared};
use crate::scene::{Camera, Mode, Scene};
use crate::{Error, Result, Watch};
use std::collections::BTreeSet;

/// Step of references, voxels.
pub const REFERENCE_STEP: f32 = 1.0 / 16.0;
/// Steps that a scene can have, voxels.
const STEPS: std::ops::RangeInclusive<f32> = 0.01..=100.0;
/// Most repetitions of a run.
const MAX_REPETITIONS: usize = 1000;
/// Most pixels of all pictures together: each takes 16 bytes, and they stay in memory until the
/// report is written.
const MAX_TOTAL_PIXELS: u64 = 1 << 28;
/// Relative work of a repetition on a GPU, compared to the CPU, for progress.
const GPU_SHARE: f32 = 0.2;

/// The plan of a comparison: every combination of modes, steps, sizes and cameras on every backend.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The scene; the fields below override its own settings.
    pub scene: Scene,
    /// Modes.
    pub modes: Vec<Mode>,
    /// Steps, voxels (of the smallest spacing).
    pub steps: Vec<f32>,
    /// Sizes of pictures, pixels.
    pub sizes: Vec<[u32; 2]>,
    /// Cameras.
    pub cameras: Vec<Camera>,
    /// How often each run is timed.
    pub repeat: usize,
    /// Step of the references, voxels; `None` for no references.
    pub reference: Option<f32>,
    /// Whether runs are rendered on the CPU; references always are.
    pub on_cpu: bool,
    /// Whether a run that the GPU cannot render is an error; otherwise it is skipped with a notice.
    pub gpu_is_required: bool,
}

/// The modes that apply to a scene.
pub fn modes_of(scene: &Scene) -> Vec<Mode> {
    let volume = scene.volume.is_some().then_some([Mode::Slice, Mode::Raycast]);
    let has_surface = scene.mesh.iter().any(|m| !m.hidden) || scene.surface.iso.is_some() || scene.render.mode == Mode::Surface;
    volume.into_iter().flatten().chain(has_surface.then_some(Mode::Surface)).collect()
}

impl Plan {
    /// A plan with the scene's own step, size and camera, on the CPU.
    pub fn of(scene: Scene) -> Self {
        Self {
            modes: modes_of(&scene),
            steps: vec![scene.render.step],
            sizes: vec![scene.render.size],
            cameras: vec![scene.camera.clone()],
            repeat: 3,
            reference: Some(REFERENCE_STEP),
            on_cpu: true,
            gpu_is_required: false,
            scene,
        }
    }

    /// The scene for which the assets must be loaded: all modes share them, and the camera.
    pub fn loading(&self) -> Scene {
        let mut scene = self.scene.clone();
        if self.modes.contains(&Mode::Surface) {
            scene.render.mode = Mode::Surface;
        }
        scene
    }

    /// Checks that all of the plan can be carried out; `backends` is the number of backends. Errors
    /// name the options of `incise compare`.
    ///
    /// # Errors
    /// Empty lists, settings out of range, a reference no finer than the runs it judges, more
    /// pictures than fit into memory.
    pub fn check(&self, backends: usize) -> Result<()> {
        let empty = [("--modes", self.modes.is_empty()), ("--steps", self.steps.is_empty()), ("--sizes", self.sizes.is_empty())];
        let empty = empty.into_iter().chain([("--cameras", self.cameras.is_empty()), ("--backend", backends == 0)]);
        if let Some((option, _)) = empty.into_iter().find(|e| e.1) {
            return Err(Error::value(option, "leaves nothing to compare; name at least one"));
        }
        if let Some(mode) = self.modes.iter().find(|m| **m != Mode::Surface && self.scene.volume.is_none()) {
            return Err(Error::value(format!("--modes {}", mode_name(*mode)), "shows a volume, and the scene has none; use --modes surface"));
        }
        if let Some(step) = self.steps.iter().find(|s| !STEPS.contains(*s)) {
            return Err(Error::value("--steps", format!("{step} is outside {} to {} voxels", STEPS.start(), STEPS.end())));
        }
        if let Some([w, h]) = self.sizes.iter().find(|s| s.iter().any(|n| !(1..=MAX_PICTURE_EDGE).contains(n))) {
            return Err(Error::value("--sizes", format!("{w}x{h} is out of range; each edge must be 1 to {MAX_PICTURE_EDGE} pixels")));
        }
        let antialias = self.scene.render.antialias.clamp(1, 4);
        let too_large = |[w, h]: &&[u32; 2]| {
            let [w, h] = [w.saturating_mul(antialias), h.saturating_mul(antialias)];
            w.max(h) > MAX_PICTURE_EDGE || u64::from(w) * u64::from(h) > MAX_PIXELS
        };
        if let Some([w, h]) = self.sizes.iter().find(too_large) {
            let sampled =
                if antialias > 1 { format!(", and {antialias} by {antialias} samples a pixel (--antialias) count as pixels") } else { String::new() };
            return Err(Error::value(
                "--sizes",
                format!("{w}x{h} cannot be made; an edge is at most {MAX_PICTURE_EDGE} pixels, a picture {MAX_PIXELS}{sampled}"),
            ));
        }
        if !(1..=MAX_REPETITIONS).contains(&self.repeat) {
            return Err(Error::value("--repeat", format!("{} is outside 1 to {MAX_REPETITIONS}", self.repeat)));
        }
        if let Some(reference) = self.reference {
            let finest = self.steps.iter().copied().fold(f32::INFINITY, f32::min);
            if !STEPS.contains(&reference) {
                return Err(Error::value("--reference", format!("{reference} is outside {} to {} voxels", STEPS.start(), STEPS.end())));
            }
            if reference > 0.5 * finest {
                return Err(Error::value(
                    "--reference",
                    format!(
                        "a reference step of {reference} is too coarse for a step of {finest}; use {} or less, coarser --steps, or --no-reference",
                        0.5 * finest
                    ),
                ));
            }
        }
        let kinds = BTreeSet::from_iter(self.modes.iter().map(|m| *m == Mode::Surface)).len();
        let pictures = (self.modes.len() * self.steps.len() * backends + if self.reference.is_some() { kinds } else { 0 }) * self.cameras.len();
        let pixels = self.sizes.iter().map(|[w, h]| u64::from(*w) * u64::from(*h)).sum::<u64>().saturating_mul(pictures as u64);
        if pixels > MAX_TOTAL_PIXELS {
            return Err(Error::value(
                "--sizes",
                format!(
                    "{} pictures have {pixels} pixels together, of {MAX_TOTAL_PIXELS} that are kept at once; compare less in one go",
                    pictures * self.sizes.len()
                ),
            ));
        }
        Ok(())
    }

    /// One scene of the sweep.
    fn at(&self, mode: Mode, step: f32, size: [u32; 2], camera: &Camera) -> Scene {
        let mut scene = Scene { camera: camera.clone(), ..self.scene.clone() };
        (scene.render.mode, scene.render.step, scene.render.size) = (mode, step, size);
        scene
    }

    /// A name that distinguishes a run from all others: mode and backend, and the settings that the
    /// plan varies.
    fn name(&self, head: &str, scene: &Scene, names_step: bool) -> String {
        let mut name = head.to_owned();
        if names_step && self.steps.len() > 1 {
            name += &format!(" step {}", scene.render.step);
        }
        if self.sizes.len() > 1 {
            name += &format!(" {}x{}", scene.render.size[0], scene.render.size[1]);
        }
        if self.cameras.len() > 1 {
            name += &format!(" {}", String::from(scene.camera.view));
        }
        name
    }
}

/// Opens a GPU to compare, software ones included, which also reports its own timings.
///
/// # Errors
/// There is no GPU, or it cannot be opened.
pub fn open_gpu() -> Result<Engine> {
    Engine::open(EngineOptions { backend: Backend::Gpu, strict: true, time_passes: true })
}

/// Renders all runs of a plan and compares them. `progress` receives the current stage and the
/// fraction of all work done.
///
/// # Errors
/// As [`Plan::check`]; any setting that cannot be used, by name; GPU errors, if the GPU is
/// required.
pub fn run(plan: &Plan, assets: &Assets, mut gpu: Option<Engine>, title: &str, progress: &(dyn Fn(&'static str, f32) + Sync)) -> Result<Report> {
    plan.check(usize::from(plan.on_cpu) + usize::from(gpu.is_some()))?;
    let mut progress = SweepProgress { progress, done: 0.0, all: work(plan, gpu.is_some()) };
    let mut notices = Vec::new();
    let mut runs: Vec<Run> = Vec::new();
    let first_preparation = first_preparation(plan, assets)?;
    for camera in &plan.cameras {
        for &size in &plan.sizes {
            let first = runs.len();
            for &mode in &plan.modes {
                for &step in &plan.steps {
                    let scene = plan.at(mode, step, size, camera);
                    let repetition = area(size) / step;
                    // Gradients, which a live view computes for its second picture, are computed
                    // outside the timing.
                    Prepared::new(&scene, assets)?.make_gradients();
                    if plan.on_cpu {
                        let part = progress.part(mode_name(mode), repetition * plan.repeat as f32);
                        let measured = on_cpu(plan, &scene, assets, &part)?;
                        progress.done = part.end;
                        notices.extend(measured.notices.iter().cloned());
                        runs.push(measured);
                    }
                    if let Some(gpu) = &mut gpu {
                        let part = progress.part(mode_name(mode), GPU_SHARE * repetition * (plan.repeat + 2) as f32);
                        let measured = on_gpu(plan, &scene, assets, gpu, &part);
                        progress.done = part.end;
                        match measured {
                            Ok(measured) => {
                                notices.extend(measured.notices.iter().cloned());
                                runs.push(measured);
                            }
                            Err(error) if plan.gpu_is_required => return Err(error),
                            Err(error) => {
                                notices.push(format!("{} is left out: {error}", plan.name(&format!("{} gpu", mode_name(mode)), &scene, true)))
                            }
                        }
                    }
                }
            }
            if let Some(step) = plan.reference {
                for surface in [false, true] {
                    let judged: Vec<usize> = (first..runs.len()).filter(|n| !runs[*n].is_reference && runs[*n].shown.surface == surface).collect();
                    if judged.is_empty() {
                        continue;
                    }
                    let mode = if surface { Mode::Surface } else { Mode::Raycast };
                    let scene = plan.at(mode, step, size, camera);
                    let part = progress.part("reference", area(size) / step);
                    let name = plan.name(&format!("{} reference", mode_name(mode)), &scene, false);
                    Prepared::new(&scene, assets)?;
                    let share = |share: f32| part.report(share);
                    let request = RenderRequest { watch: Watch::reporting(&share), ..RenderRequest::default() };
                    let reference = Run { is_reference: true, ..timed_run(&mut Engine::cpu(), &scene, assets, &name, &request)? };
                    progress.done = part.end;
                    for n in judged {
                        runs[n].error = Some(difference(&runs[n].picture, &reference.picture)?);
                    }
                    runs.push(reference);
                }
            }
        }
    }
    let mut seen = BTreeSet::new();
    notices.retain(|n| seen.insert(n.clone()));
    let pairs = pairs_of(&runs);
    let mut report = Report::of_pairs(title, plan.scene.to_toml()?, plan.scene.render.background, runs, pairs)?;
    report.protocol = Some(Protocol {
        cpu: format!("{}, {} threads", std::env::consts::ARCH, rayon::current_num_threads()),
        gpu: gpu.as_ref().map(gpu_name),
        repeat: plan.repeat,
        reference_step: plan.reference,
        first_preparation,
        notices,
    });
    Ok(report)
}

/// Stages of preparing a plan's modes with empty caches.
fn first_preparation(plan: &Plan, assets: &Assets) -> Result<Vec<(String, f64)>> {
    let mut stages: Vec<(String, f64)> = Vec::new();
    for &mode in &plan.modes {
        let prepared = Prepared::new(&plan.at(mode, plan.steps[0], plan.sizes[0], &plan.cameras[0]), assets)?;
        for (name, milliseconds) in owned(&[&prepared.stages]) {
            match stages.iter_mut().find(|s| s.0 == name) {
                Some(stage) => stage.1 += milliseconds,
                None => stages.push((name, milliseconds)),
            }
        }
    }
    Ok(stages)
}

/// Progress of the whole comparison.
struct SweepProgress<'a> {
    progress: &'a (dyn Fn(&'static str, f32) + Sync),
    done: f32,
    all: f32,
}

impl<'a> SweepProgress<'a> {
    fn part(&self, what: &'static str, work: f32) -> ProgressPart<'a> {
        ProgressPart { progress: self.progress, what, start: self.done, end: self.done + work, all: self.all }
    }
}

/// One part of it.
struct ProgressPart<'a> {
    progress: &'a (dyn Fn(&'static str, f32) + Sync),
    what: &'static str,
    start: f32,
    end: f32,
    all: f32,
}

impl ProgressPart<'_> {
    fn report(&self, share: f32) {
        (self.progress)(self.what, ((self.start + share * (self.end - self.start)) / self.all).clamp(0.0, 1.0));
    }
}

fn area([width, height]: [u32; 2]) -> f32 {
    width as f32 * height as f32
}

/// Approximate work of a plan, in samples.
fn work(plan: &Plan, gpu: bool) -> f32 {
    let per_pixel: f32 = plan.steps.iter().map(|s| 1.0 / s).sum();
    let repetitions = if plan.on_cpu { plan.repeat as f32 } else { 0.0 } + if gpu { GPU_SHARE * (plan.repeat + 2) as f32 } else { 0.0 };
    let kinds = BTreeSet::from_iter(plan.modes.iter().map(|m| *m == Mode::Surface)).len();
    let references = plan.reference.map_or(0.0, |s| kinds as f32 / s);
    let pixels: f32 = plan.sizes.iter().copied().map(area).sum();
    (pixels * plan.cameras.len() as f32 * (plan.modes.len() as f32 * per_pixel * repetitions + references)).max(f32::MIN_POSITIVE)
}

/// Merges repetitions of a run: the median repetition, with the spread of all.
fn merged(mut all: Vec<Run>) -> Result<Run> {
    let times = Times::of(&all.iter().map(|r| r.milliseconds.median).collect::<Vec<_>>());
    let rendering = Times::of(&all.iter().map(|r| r.rendering.median).collect::<Vec<_>>());
    let repetitions = all.len();
    all.sort_by(|a, b| a.milliseconds.median.total_cmp(&b.milliseconds.median));
    let middle = all.into_iter().nth(repetitions.saturating_sub(1) / 2);
    let middle = middle.ok_or_else(|| Error::value("--repeat", "0 is outside 1 to 1000"))?;
    Ok(Run { milliseconds: times, rendering, repetitions, ..middle })
}

fn on_cpu(plan: &Plan, scene: &Scene, assets: &Assets, part: &ProgressPart) -> Result<Run> {
    let name = plan.name(&format!("{} cpu", mode_name(scene.render.mode)), scene, true);
    let once = |n: usize| {
        let share = |share: f32| part.report((n as f32 + share) / plan.repeat as f32);
        timed_run(&mut Engine::cpu(), scene, assets, &name, &RenderRequest { watch: Watch::reporting(&share), ..RenderRequest::default() })
    };
    merged((0..plan.repeat).map(once).collect::<Result<_>>()?)
}

fn on_gpu(plan: &Plan, scene: &Scene, assets: &Assets, gpu: &mut Engine, part: &ProgressPart) -> Result<Run> {
    let name = plan.name(&format!("{} gpu", mode_name(scene.render.mode)), scene, true);
    let pictures = plan.repeat + 2;
    let mut once = |n: usize, count_samples: bool| {
        let share = |share: f32| part.report((n as f32 + share) / pictures as f32);
        timed_run(gpu, scene, assets, &name, &RenderRequest { count_samples, watch: Watch::reporting(&share), ..RenderRequest::default() })
    };
    let first = once(0, false)?;
    let timed = (0..plan.repeat).map(|n| once(n + 1, false)).collect::<Result<_>>()?;
    let counted = once(pictures - 1, true)?;
    Ok(Run { warm_up: Some(first.milliseconds.median), stats: counted.stats, ..merged(timed)? })
}

/// A GPU's name, for display.
fn gpu_name(gpu: &Engine) -> String {
    let device = gpu.device();
    let soft = if device.is_software { ", a software adapter: its times are a processor's" } else { "" };
    format!("{}{soft}", device.name)
}

/// Pairs of runs whose difference is meaningful, by index: among runs of the same view, different
/// renderers at one step, and each run with its reference. Two steps of one renderer are compared
/// through the reference.
pub fn pairs_of(runs: &[Run]) -> Vec<[usize; 2]> {
    let all = (0..runs.len()).flat_map(|a| (a + 1..runs.len()).map(move |b| [a, b]));
    let is_informative = |[a, b]: &[usize; 2]| {
        let (a, b) = (&runs[*a], &runs[*b]);
        let renderers = a.step == b.step && (a.mode, &a.backend) != (b.mode, &b.backend);
        a.shown == b.shown && if a.is_reference || b.is_reference { a.is_reference != b.is_reference } else { renderers }
    };
    all.filter(is_informative).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::run::ViewKey;
    use crate::compare::run::tests::run;

    #[test]
    fn only_telling_pairs_are_compared() {
        let runs = [
            run("a", Mode::Slice, "cpu", 1.0, 1.0, 1.0),
            run("b", Mode::Slice, "cpu", 2.0, 1.0, 1.0),
            run("c", Mode::Raycast, "cpu", 1.0, 1.0, 1.0),
            run("d", Mode::Slice, "gpu", 1.0, 1.0, 1.0),
            run("e", Mode::Surface, "cpu", 1.0, 1.0, 1.0),
            run("r", Mode::Raycast, "cpu", 0.0625, 0.0, 1.0),
            Run { shown: ViewKey { camera: "left".into(), size: [1, 1], surface: false }, ..run("f", Mode::Raycast, "cpu", 1.0, 1.0, 1.0) },
        ];
        assert_eq!(pairs_of(&runs), [[0, 2], [0, 3], [0, 5], [1, 5], [2, 3], [2, 5], [3, 5]]);
    }

    #[test]
    fn plans_that_cannot_be_are_named() {
        let good = || Plan { steps: vec![0.5, 1.0], ..Plan::of(Scene::of_volume("phantom:ball:size=12")) };
        assert!(good().check(1).is_ok() && good().check(2).is_ok());
        assert_eq!(good().modes, [Mode::Slice, Mode::Raycast]);
        assert_eq!(Plan::of(Scene::of_mesh("a.stl")).modes, [Mode::Surface]);
        let cases: [(&str, Plan); 10] = [
            ("--modes", Plan { modes: Vec::new(), ..good() }),
            ("--modes slice", Plan { modes: vec![Mode::Slice], ..Plan::of(Scene::of_mesh("a.stl")) }),
            ("--steps", Plan { steps: vec![f32::NAN], ..good() }),
            ("--steps", Plan { steps: vec![0.001], ..good() }),
            ("--sizes", Plan { sizes: vec![[0, 5]], ..good() }),
            ("--sizes", Plan { sizes: vec![[9000, 9000]], ..good() }),
            ("--cameras", Plan { cameras: Vec::new(), ..good() }),
            ("--repeat", Plan { repeat: 0, ..good() }),
            ("--reference", Plan { reference: Some(0.4), ..good() }),
            ("--reference", Plan { reference: Some(f32::NAN), ..good() }),
        ];
        for (option, plan) in cases {
            let message = plan.check(1).unwrap_err().to_string();
            assert!(message.starts_with(option), "{message}");
        }
        assert!(good().check(0).is_err());
        // Names state only the settings that vary.
        let plan = Plan { sizes: vec![[8, 6], [16, 12]], ..good() };
        let scene = plan.at(Mode::Slice, 0.5, [8, 6], &plan.cameras[0]);
        assert_eq!(plan.name("slice cpu", &scene, true), "slice cpu step 0.5 8x6");
        assert_eq!(Plan::of(scene.clone()).name("slice cpu", &scene, true), "slice cpu");
    }
}
