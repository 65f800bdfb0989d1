//! Comparing renderers of one scene: pictures, differences, errors, times, as one report.
//!
//! *Theory*: the protocol of Meissner, Huang, Bartz, Mueller, Crawfis, "A Practical Evaluation of Popular Volume Rendering Algorithms",
//! Volume Visualization 2000: algorithms can be compared only where they are given the same optical model, the same view and the same
//! transfer function, and their pictures are put side by side with what they cost. Here all runs of a report are one scene; they differ in
//! mode, backend, step, size or camera. Their opacities are corrected to the same length, so that a different step shows the error of
//! sampling alone (above one voxel the blend of normals at cuts widens with the step, too). Beyond the paper's pictures and times there are numbers for how far pictures are apart ([`Difference`]), errors against a
//! reference of a much finer step, and what a renderer costs where all are equally wrong ([`lab`]).
//!
//! *How to call it*: [`lab::Plan`] and [`lab::run`] for all of it; or a [`Run`] for every renderer ([`run`]) and [`Report::new`]. Then [`Report::write`].

pub mod lab;
mod metrics;
mod page;
pub mod plot;
mod report;

pub use metrics::{Difference, difference, difference_picture};
pub use report::{Pair, Protocol, Report, Run, Shown, write_files};

use crate::engine::{Engine, RenderRequest};
use crate::picture::{Rendered, Stages};
use crate::prepare::{Assets, Prepared};
use crate::scene::Scene;
use crate::volume::{Colors, GridVoxels};
use crate::{Result, Watch};
use std::time::Instant;

/// Milliseconds that something took, once or repeatedly.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Times {
    /// The one in the middle; of an even number the lower of the two.
    pub median: f64,
    /// The least.
    pub min: f64,
    /// The greatest.
    pub max: f64,
}

impl Times {
    /// Of any number of measurements; all 0 of none.
    pub fn of(milliseconds: &[f64]) -> Self {
        let mut sorted = milliseconds.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at = |n: usize| sorted.get(n).copied().unwrap_or(0.0);
        let last = sorted.len().saturating_sub(1);
        Self { median: at(last / 2), min: at(0), max: at(last) }
    }
}

/// Bytes that a picture needs, in the process that made it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// The volume's values and colours as they are sampled, by this renderer.
    pub volume_bytes: u64,
    /// The gradients of all voxels, where the renderer keeps them.
    pub gradient_bytes: u64,
    /// All displacement maps, as a GPU holds them.
    pub map_bytes: u64,
    /// Distance fields of surfaces, as a GPU holds them.
    pub surface_bytes: u64,
    /// The largest resident size of the process up to the end of the run, where the system tells.
    pub peak_bytes: Option<u64>,
}

impl Memory {
    /// What a scene holds that was prepared and rendered on the CPU; without a volume if it has none of its own.
    pub fn of(scene: &Prepared, has_volume: bool) -> Self {
        let volume = match &scene.volume().grid.voxels {
            GridVoxels::U8(v) => size_of_val(v.as_slice()),
            GridVoxels::U16(v) => size_of_val(v.as_slice()),
            GridVoxels::I16(v) => size_of_val(v.as_slice()),
            GridVoxels::F32(v) => size_of_val(v.as_slice()),
        };
        let colors = scene.volume().colors.map_or(0, Colors::size_in_bytes);
        Self {
            volume_bytes: if has_volume { (volume + colors) as u64 } else { 0 },
            gradient_bytes: scene.gradients().map_or(0, |g| size_of_val(&*g.texels) as u64),
            map_bytes: scene.stack.all_maps().map(|m| m.map.stored_bytes() as u64).sum(),
            surface_bytes: scene.surfaces.objects.iter().filter_map(|o| o.implicit.as_ref()).map(|i| i.gpu_bytes() as u64).sum(),
            peak_bytes: peak_memory_bytes(),
        }
    }
}

/// The process's largest resident size, where the system tells (Linux).
pub fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib * 1024)
}

/// Stages with names of their own.
fn owned(stages: &[&Stages]) -> Vec<(String, f64)> {
    stages.iter().flat_map(|s| &s.0).map(|&(stage, ms)| (stage.to_owned(), ms)).collect()
}

/// Renders a scene, as one run of a report. Loading the assets is not part of its time, preparing the scene is.
///
/// # Errors
/// As [`Engine::picture`].
pub fn run(engine: &mut Engine, scene: &Scene, assets: &Assets, name: &str, request: &RenderRequest) -> Result<Run> {
    request.watch.check()?;
    let start = Instant::now();
    let prepared = engine.prepare(scene, assets, &Watch { progress: &|_| (), ..request.watch })?;
    let before = start.elapsed().as_secs_f64() * 1e3;
    let (rendered, device) = engine.render(&prepared, request)?;
    let all = start.elapsed().as_secs_f64() * 1e3;
    let mut run = Run { name: name.to_owned(), backend: device.backend().to_owned(), ..once(scene, &prepared, rendered, [before, all]) };
    if let Some([volume, gradients]) = engine.gpu_volume_bytes() {
        run.memory.volume_bytes = if scene.volume.is_some() { volume } else { 0 };
        run.memory.gradient_bytes = gradients;
    }
    Ok(run)
}

/// One timed picture, nameless: the times from the start to the prepared scene, and to the picture.
fn once(scene: &Scene, prepared: &Prepared, rendered: Rendered, [before, all]: [f64; 2]) -> Run {
    Run {
        name: String::new(),
        shown: Shown::of(scene),
        mode: scene.render.mode,
        backend: String::new(),
        step: scene.render.step,
        milliseconds: Times::of(&[all]),
        rendering: Times::of(&[all - before]),
        repetitions: 1,
        warm_up: None,
        stages: owned(&[&prepared.stages, &rendered.stages]),
        stats: rendered.stats,
        memory: Memory::of(prepared, scene.volume.is_some()),
        error: None,
        is_reference: false,
        notices: rendered.notices,
        picture: rendered.picture,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::scene::{Mode, Projection};
    use std::sync::atomic::AtomicBool;

    fn scene(mode: Mode) -> Scene {
        let mut scene = Scene::of_volume("phantom:ball:size=12");
        scene.render.size = [24, 20];
        scene.render.mode = mode;
        scene.camera.projection = Projection::Orthographic;
        scene
    }

    #[test]
    fn the_middle_is_one_of_them() {
        let times = |v: &[f64]| {
            let t = Times::of(v);
            [t.median, t.min, t.max]
        };
        assert_eq!(times(&[7.0, 1.0, 3.0]), [3.0, 1.0, 7.0]);
        assert_eq!((times(&[7.0, 3.0]), times(&[2.0]), times(&[])), ([3.0, 3.0, 7.0], [2.0; 3], [0.0; 3]));
    }

    /// Without perspective a ray meets slices at its own samples.
    #[test]
    fn slices_are_rays_where_rays_are_parallel() {
        let assets = Assets::load(&scene(Mode::Slice)).unwrap();
        let run = |mode, name| super::run(&mut Engine::cpu(), &scene(mode), &assets, name, &RenderRequest::default()).unwrap();
        let (slice, raycast) = (run(Mode::Slice, "slice"), run(Mode::Raycast, "raycast"));
        assert!(slice.picture.pixels.iter().any(|p| p[3] > 0.1), "the scene shows nothing");
        assert!(slice.milliseconds.median > 0.0 && slice.stages.iter().any(|s| s.0 == "render") && slice.stats.is_some());
        let report = Report::new("ball", "", [0.0, 0.0, 0.0, 1.0], vec![slice, raycast]).unwrap();
        assert!(report.pairs.len() == 1 && report.pairs[0].difference.mean < 0.1, "{:?}", report.pairs);
    }

    #[test]
    fn it_stops_when_told() {
        let assets = Assets::load(&scene(Mode::Slice)).unwrap();
        let watch = Watch { progress: &|_| (), cancel: &AtomicBool::new(true) };
        let request = RenderRequest { watch, ..RenderRequest::default() };
        assert!(matches!(run(&mut Engine::cpu(), &scene(Mode::Slice), &assets, "slice", &request), Err(Error::Cancelled)));
    }
}
