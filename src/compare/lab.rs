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

pub use super::plan::{Plan, REFERENCE_STEP, modes_of};

use super::metrics::difference;
use super::report::{Protocol, Report};
use super::run::{Run, Times, mode_name, owned, run as timed_run};
use crate::engine::{Backend, Engine, EngineOptions, RenderRequest};
use crate::prepare::{Assets, Prepared};
use crate::scene::{Mode, RenderSettings, Scene};
use crate::{Error, Result, Watch};
use std::collections::BTreeSet;

/// Relative work of a repetition on a GPU, compared to the CPU, for progress.
const GPU_SHARE: f32 = 0.2;

/// Opens a GPU to compare, software ones included, which also reports its own timings.
///
/// # Errors
/// There is no GPU, or it cannot be opened.
pub fn open_gpu() -> Result<Engine> {
    Engine::open(EngineOptions {
        backend: Backend::Gpu,
        strict: true,
        time_passes: true,
    })
}

/// Renders all runs of a plan and compares them. `progress` receives the current stage and the
/// fraction of all work done.
///
/// # Errors
/// As [`Plan::check`]; any setting that cannot be used, by name; GPU errors, if the GPU is
/// required.
pub fn run(
    plan: &Plan,
    assets: &Assets,
    gpu: Option<Engine>,
    title: &str,
    progress: &(dyn Fn(&'static str, f32) + Sync),
) -> Result<Report> {
    plan.check(usize::from(plan.on_cpu) + usize::from(gpu.is_some()))?;
    let progress = SweepProgress {
        progress,
        done: 0.0,
        all: work(plan, gpu.is_some()),
    };
    let gpu_name = gpu.as_ref().map(gpu_name);
    let first_preparation = first_preparation(plan, assets)?;
    let mut sweep = Sweep {
        plan,
        assets,
        gpu,
        progress,
        notices: Vec::new(),
        runs: Vec::new(),
    };
    for camera in &plan.cameras {
        for &size in &plan.sizes {
            let first = sweep.runs.len();
            for &mode in &plan.modes {
                for options in plan.options_in(mode) {
                    for &step in &plan.steps {
                        let mut scene = plan.at(mode, step, size, camera);
                        options.apply(&mut scene);
                        sweep.time_backends(&scene)?;
                    }
                }
            }
            if let Some(step) = plan.reference {
                for mode in [Mode::Raycast, Mode::Surface] {
                    sweep.measure_errors(first, &plan.at(mode, step, size, camera))?;
                }
            }
        }
    }
    let Sweep {
        mut notices, runs, ..
    } = sweep;
    let mut seen = BTreeSet::new();
    notices.retain(|n| seen.insert(n.clone()));
    let pairs = pairs_of(&runs);
    let mut report = Report::of_pairs(
        title,
        plan.scene.to_toml()?,
        plan.scene.render.background,
        runs,
        pairs,
    )?;
    report.protocol = Some(Protocol {
        cpu: format!(
            "{}, {} threads",
            std::env::consts::ARCH,
            rayon::current_num_threads()
        ),
        gpu: gpu_name,
        repeat: plan.repeat,
        reference_step: plan.reference,
        first_preparation,
        notices,
    });
    Ok(report)
}

/// A comparison in progress: its inputs, and the runs so far.
struct Sweep<'a> {
    plan: &'a Plan,
    assets: &'a Assets,
    gpu: Option<Engine>,
    progress: SweepProgress<'a>,
    notices: Vec<String>,
    runs: Vec<Run>,
}

impl Sweep<'_> {
    /// Times a scene on each backend and adds the runs. If the GPU cannot render it, that is an
    /// error if the plan requires the GPU, otherwise a notice.
    fn time_backends(&mut self, scene: &Scene) -> Result<()> {
        let plan = self.plan;
        let mode = mode_name(scene.render.mode);
        let repetition = area(scene.render.size) / scene.render.step;
        // Gradients, which a live view computes for its second picture, are computed outside the
        // timing.
        Prepared::new(scene, self.assets)?.make_gradients();
        if plan.on_cpu {
            let part = self.progress.part(mode, repetition * plan.repeat as f32);
            let measured = on_cpu(plan, scene, self.assets, &part)?;
            self.progress.done = part.end;
            self.add(measured);
        }
        if let Some(gpu) = &mut self.gpu {
            let part = self
                .progress
                .part(mode, GPU_SHARE * repetition * (plan.repeat + 2) as f32);
            let measured = on_gpu(plan, scene, self.assets, gpu, &part);
            self.progress.done = part.end;
            match measured {
                Ok(measured) => self.add(measured),
                Err(error) if plan.gpu_is_required => return Err(error),
                Err(error) => self.notices.push(format!(
                    "{} is left out: {error}",
                    plan.name(&format!("{mode} gpu"), scene, true)
                )),
            }
        }
        Ok(())
    }

    /// Adds a run, with its notices.
    fn add(&mut self, run: Run) {
        self.notices.extend(run.notices.iter().cloned());
        self.runs.push(run);
    }

    /// Renders a reference, and sets the error of every run from index `first` on that shows the
    /// same content (volume or surface). Renders no reference if there are no such runs.
    fn measure_errors(&mut self, first: usize, scene: &Scene) -> Result<()> {
        let RenderSettings { mode, step, size, .. } = scene.render;
        let is_measured = |run: &Run| !run.is_reference && run.shown.surface == (mode == Mode::Surface);
        let measured: Vec<usize> = (first..self.runs.len())
            .filter(|n| is_measured(&self.runs[*n]))
            .collect();
        if measured.is_empty() {
            return Ok(());
        }
        let part = self.progress.part("reference", area(size) / step);
        let name = self
            .plan
            .name(&format!("{} reference", mode_name(mode)), scene, false);
        Prepared::new(scene, self.assets)?;
        let share = |share: f32| part.report(share);
        let request = RenderRequest {
            watch: Watch::reporting(&share),
            ..RenderRequest::default()
        };
        let reference = Run {
            is_reference: true,
            ..timed_run(&mut Engine::cpu(), scene, self.assets, &name, &request)?
        };
        self.progress.done = part.end;
        for n in measured {
            self.runs[n].error = Some(difference(&self.runs[n].picture, &reference.picture)?);
        }
        self.runs.push(reference);
        Ok(())
    }
}

/// Stages of preparing a plan's modes with empty caches.
fn first_preparation(plan: &Plan, assets: &Assets) -> Result<Vec<(String, f64)>> {
    let mut stages: Vec<(String, f64)> = Vec::new();
    for &mode in &plan.modes {
        let prepared = Prepared::new(
            &plan.at(mode, plan.steps[0], plan.sizes[0], &plan.cameras[0]),
            assets,
        )?;
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
        ProgressPart {
            progress: self.progress,
            what,
            start: self.done,
            end: self.done + work,
            all: self.all,
        }
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
        (self.progress)(
            self.what,
            ((self.start + share * (self.end - self.start)) / self.all).clamp(0.0, 1.0),
        );
    }
}

fn area([width, height]: [u32; 2]) -> f32 {
    width as f32 * height as f32
}

/// Approximate work of a plan, in samples.
fn work(plan: &Plan, gpu: bool) -> f32 {
    let per_pixel: f32 = plan.steps.iter().map(|s| 1.0 / s).sum();
    let repetitions = if plan.on_cpu { plan.repeat as f32 } else { 0.0 }
        + if gpu {
            GPU_SHARE * (plan.repeat + 2) as f32
        } else {
            0.0
        };
    let kinds = BTreeSet::from_iter(
        plan.modes
            .iter()
            .map(|m| *m == Mode::Surface || plan.scene.volume.is_none()),
    )
    .len();
    let references = plan.reference.map_or(0.0, |s| kinds as f32 / s);
    let pixels: f32 = plan.sizes.iter().copied().map(area).sum();
    (pixels
        * plan.cameras.len() as f32
        * (plan.renderer_count() as f32 * per_pixel * repetitions + references))
        .max(f32::MIN_POSITIVE)
}

/// Merges repetitions of a run: the median repetition, with the spread of all.
fn merged(mut all: Vec<Run>) -> Result<Run> {
    let times = Times::of(&all.iter().map(|r| r.milliseconds.median).collect::<Vec<_>>());
    let rendering = Times::of(&all.iter().map(|r| r.rendering.median).collect::<Vec<_>>());
    let repetitions = all.len();
    all.sort_by(|a, b| a.milliseconds.median.total_cmp(&b.milliseconds.median));
    let middle = all.into_iter().nth(repetitions.saturating_sub(1) / 2);
    let middle = middle.ok_or_else(|| Error::value("--repeat", "0 is outside 1 to 1000"))?;
    Ok(Run {
        milliseconds: times,
        rendering,
        repetitions,
        ..middle
    })
}

fn on_cpu(plan: &Plan, scene: &Scene, assets: &Assets, part: &ProgressPart) -> Result<Run> {
    let name = plan.name(&format!("{} cpu", mode_name(scene.render.mode)), scene, true);
    let once = |n: usize| {
        let share = |share: f32| part.report((n as f32 + share) / plan.repeat as f32);
        timed_run(
            &mut Engine::cpu(),
            scene,
            assets,
            &name,
            &RenderRequest {
                watch: Watch::reporting(&share),
                ..RenderRequest::default()
            },
        )
    };
    merged((0..plan.repeat).map(once).collect::<Result<_>>()?)
}

fn on_gpu(plan: &Plan, scene: &Scene, assets: &Assets, gpu: &mut Engine, part: &ProgressPart) -> Result<Run> {
    let name = plan.name(&format!("{} gpu", mode_name(scene.render.mode)), scene, true);
    let pictures = plan.repeat + 2;
    let mut once = |n: usize, count_samples: bool| {
        let share = |share: f32| part.report((n as f32 + share) / pictures as f32);
        timed_run(
            gpu,
            scene,
            assets,
            &name,
            &RenderRequest {
                count_samples,
                watch: Watch::reporting(&share),
                ..RenderRequest::default()
            },
        )
    };
    let first = once(0, false)?;
    let timed = (0..plan.repeat)
        .map(|n| once(n + 1, false))
        .collect::<Result<_>>()?;
    let counted = once(pictures - 1, true)?;
    Ok(Run {
        warm_up: Some(first.milliseconds.median),
        stats: counted.stats,
        ..merged(timed)?
    })
}

/// A GPU's name, for display.
fn gpu_name(gpu: &Engine) -> String {
    let device = gpu.device();
    let soft = if device.is_software {
        ", a software adapter: its times are a processor's"
    } else {
        ""
    };
    format!("{}{soft}", device.name)
}

/// Pairs of runs whose difference is meaningful, by index: among runs of the same view, different
/// renderers at one step, and each run with its reference. Two steps of one renderer are compared
/// through the reference.
pub fn pairs_of(runs: &[Run]) -> Vec<[usize; 2]> {
    let all = (0..runs.len()).flat_map(|a| (a + 1..runs.len()).map(move |b| [a, b]));
    let is_informative = |[a, b]: &[usize; 2]| {
        let (a, b) = (&runs[*a], &runs[*b]);
        let renderers = a.step == b.step && a.renderer() != b.renderer();
        a.shown == b.shown
            && if a.is_reference || b.is_reference {
                a.is_reference != b.is_reference
            } else {
                renderers
            }
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
            Run {
                shown: ViewKey {
                    camera: "left".into(),
                    size: [1, 1],
                    surface: false,
                },
                ..run("f", Mode::Raycast, "cpu", 1.0, 1.0, 1.0)
            },
        ];
        assert_eq!(
            pairs_of(&runs),
            [[0, 2], [0, 3], [0, 5], [1, 5], [2, 3], [2, 5], [3, 5]]
        );
    }
}
