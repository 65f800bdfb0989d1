//! Comparing renderers of one scene: pictures, differences, times, as one report.
//!
//! *Theory*: the protocol of Meissner, Huang, Bartz, Mueller, Crawfis, "A Practical Evaluation of Popular Volume Rendering Algorithms",
//! Volume Visualization 2000: algorithms can be compared only where they are given the same optical model, the same view and the same
//! transfer function, and their pictures are put side by side with what they cost. Here all runs of a report are one scene; they differ in
//! mode, backend or step. Their opacities are corrected to the same length, so that a different step shows the error of sampling alone.
//! Beyond the paper's pictures and times there are numbers for how far pictures are apart ([`Difference`]).
//!
//! *How to call it*: a [`Run`] for every renderer ([`run_on_cpu`], or made from what another renderer gave), [`Report::new`],
//! [`Report::write`].

mod metrics;
mod report;

pub use metrics::{Difference, difference, difference_picture};
pub use report::{Pair, Report, Run};

use crate::scene::{Assets, Prepared, Scene};
use crate::{Result, Watch, cpu};
use std::time::Instant;

/// Renders a scene on the CPU, as one run of a report. Loading the assets is not part of its time, preparing the scene is.
///
/// # Errors
/// Any setting that cannot be used, by name; [`Error::Cancelled`](crate::Error::Cancelled).
pub fn run_on_cpu(scene: &Scene, assets: &Assets, name: &str, watch: &Watch) -> Result<Run> {
    watch.check()?;
    let start = Instant::now();
    let prepared = Prepared::new(scene, assets)?;
    let rendered = cpu::render_until(&prepared, watch)?;
    let milliseconds = start.elapsed().as_secs_f64() * 1e3;
    let stages = prepared.stages.0.iter().chain(&rendered.stages.0).map(|&(stage, ms)| (stage.to_owned(), ms)).collect();
    Ok(Run {
        name: name.to_owned(),
        picture: rendered.picture,
        milliseconds,
        stages,
        stats: rendered.stats,
        backend: "cpu".to_owned(),
        step: scene.render.step,
    })
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

    /// Without perspective a ray meets slices at its own samples.
    #[test]
    fn slices_are_rays_where_rays_are_parallel() {
        let assets = Assets::load(&scene(Mode::Slice), &|_, _| ()).unwrap();
        let run = |mode, name| run_on_cpu(&scene(mode), &assets, name, &Watch::NOBODY).unwrap();
        let (slice, raycast) = (run(Mode::Slice, "slice"), run(Mode::Raycast, "raycast"));
        assert!(slice.picture.pixels.iter().any(|p| p[3] > 0.1), "the scene shows nothing");
        assert!(slice.milliseconds > 0.0 && slice.stages.iter().any(|s| s.0 == "render") && slice.stats.is_some());
        let report = Report::new("ball", "", [0.0, 0.0, 0.0, 1.0], vec![slice, raycast]).unwrap();
        assert!(report.pairs.len() == 1 && report.pairs[0].difference.mean < 0.1, "{:?}", report.pairs);
    }

    #[test]
    fn it_stops_when_told() {
        let assets = Assets::load(&scene(Mode::Slice), &|_, _| ()).unwrap();
        let watch = Watch { progress: &|_| (), cancel: &AtomicBool::new(true) };
        assert!(matches!(run_on_cpu(&scene(Mode::Slice), &assets, "slice", &watch), Err(Error::Cancelled)));
    }
}
