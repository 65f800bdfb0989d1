//! One renderer's picture of a scene with its cost: the unit of a comparison.

use super::method::Method;
use super::metrics::Difference;
use crate::engine::{Engine, RenderRequest};
use crate::files::memory;
use crate::math::flat;
use crate::picture::{Picture, RenderStats, Rendered, StageTimes};
use crate::prepare::{Assets, Prepared};
use crate::scene::{Mode, Scene};
use crate::volume::{Colors, VoxelGridValues};
use crate::{Result, Watch};
use std::time::Instant;

/// Milliseconds of one or more measurements.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Times {
    /// The median; of an even number, the lower of the two.
    pub median: f64,
    /// The least.
    pub min: f64,
    /// The greatest.
    pub max: f64,
}

impl Times {
    /// Of any number of measurements; all 0 if there are none.
    pub fn of(milliseconds: &[f64]) -> Self {
        let mut sorted = milliseconds.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at = |n: usize| sorted.get(n).copied().unwrap_or(0.0);
        let last = sorted.len().saturating_sub(1);
        Self {
            median: at(last / 2),
            min: at(0),
            max: at(last),
        }
    }
}

/// Memory used for a picture, in the process that rendered it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// The volume's values and colours as this renderer samples them.
    pub volume_bytes: u64,
    /// The gradients of all voxels, if the renderer stores them.
    pub gradient_bytes: u64,
    /// All displacement maps, as a GPU holds them.
    pub map_bytes: u64,
    /// Distance fields of surfaces, as a GPU holds them.
    pub surface_bytes: u64,
    /// The peak resident size of the process up to the end of the run, where the system reports it.
    pub peak_bytes: Option<u64>,
}

impl Memory {
    /// Memory of a scene that was prepared and rendered on the CPU; without the volume if the scene
    /// has none of its own.
    pub fn of(scene: &Prepared, has_volume: bool) -> Self {
        let volume = match &scene.volume().grid.voxels {
            VoxelGridValues::U8(v) => size_of_val(flat(v)),
            VoxelGridValues::U16(v) => size_of_val(flat(v)),
            VoxelGridValues::I16(v) => size_of_val(flat(v)),
            VoxelGridValues::F32(v) => size_of_val(flat(v)),
        };
        let colors = scene.volume().colors.map_or(0, Colors::size_in_bytes);
        Self {
            volume_bytes: if has_volume { (volume + colors) as u64 } else { 0 },
            gradient_bytes: scene.gradients().map_or(0, |g| size_of_val(&*g.texels) as u64),
            map_bytes: scene.stack.all_maps().map(|m| m.stored_bytes() as u64).sum(),
            surface_bytes: scene
                .surfaces
                .objects
                .iter()
                .filter_map(|o| o.implicit.as_ref())
                .map(|i| i.gpu_bytes() as u64)
                .sum(),
            peak_bytes: memory::peak_bytes(),
        }
    }
}

/// Stages with owned names.
pub(super) fn owned(stages: &[&StageTimes]) -> Vec<(String, f64)> {
    stages
        .iter()
        .flat_map(|s| &s.0)
        .map(|&(stage, ms)| (stage.to_owned(), ms))
        .collect()
}

/// The content and size of a picture: only pictures with the same key can be compared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ViewKey {
    /// The view direction, as written in a scene file.
    pub camera: String,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Whether it shows surfaces alone, which is different content than the volume.
    pub surface: bool,
}

impl ViewKey {
    /// The key of a scene's picture.
    pub fn of(scene: &Scene) -> Self {
        Self {
            camera: scene.camera.view.into(),
            size: scene.render.size,
            surface: scene.render.mode == Mode::Surface || scene.volume.is_none(),
        }
    }
}

impl Run {
    /// Its renderer: two runs of one renderer differ in their step, size or camera only.
    pub(super) fn renderer(&self) -> (Mode, &str, &str) {
        (self.mode, &self.backend, &self.method.variant)
    }
}

/// A renderer's name: mode, backend, and the options of slices that are not the default.
pub(super) fn renderer_name((mode, backend, variant): (Mode, &str, &str)) -> String {
    let gap = if variant.is_empty() { "" } else { " " };
    format!("{} {backend}{gap}{variant}", mode_name(mode))
}

impl std::fmt::Display for ViewKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let what = if self.surface { "surfaces" } else { "volume" };
        write!(
            f,
            "{what}, view {}, {} × {} pixels",
            self.camera, self.size[0], self.size[1]
        )
    }
}

/// One renderer's picture of the scene with its cost.
#[derive(Clone, Debug)]
pub struct Run {
    /// Its name in the report, e.g. `slice cpu`; no two runs of a report have the same name.
    pub name: String,
    /// The picture, premultiplied, without background.
    pub picture: Picture,
    /// Content and size of the picture.
    pub shown: ViewKey,
    /// How the scene was sampled.
    pub mode: Mode,
    /// The backend: `cpu` or `gpu`.
    pub backend: String,
    /// How it was made.
    pub method: Method,
    /// Distance between samples in voxels (of the smallest spacing).
    pub step: f32,
    /// From the loaded scene to the picture.
    pub milliseconds: Times,
    /// The part after the scene was prepared, which differs between renderers.
    pub rendering: Times,
    /// How often it was timed.
    pub repetitions: usize,
    /// Time of an untimed first picture, milliseconds, if there was one.
    pub warm_up: Option<f64>,
    /// Parts of the median time by name, milliseconds, in order.
    pub stages: Vec<(String, f64)>,
    /// Sample counts, if available.
    pub stats: Option<RenderStats>,
    /// Memory used.
    pub memory: Memory,
    /// The difference from its reference, if there is one.
    pub error: Option<Difference>,
    /// Whether it is a reference for other runs.
    pub is_reference: bool,
    /// Notices for the user, one sentence each.
    pub notices: Vec<String>,
}

/// Renders a scene as one run of a report. The time excludes loading the assets but includes
/// preparing the scene.
///
/// # Errors
/// As [`Engine::picture`].
pub fn run(
    engine: &mut Engine,
    scene: &Scene,
    assets: &Assets,
    name: &str,
    request: &RenderRequest,
) -> Result<Run> {
    request.watch.check()?;
    let start = Instant::now();
    let prepared = engine.prepare(
        scene,
        assets,
        &Watch {
            progress: &|_| (),
            ..request.watch
        },
    )?;
    let before = start.elapsed().as_secs_f64() * 1e3;
    let (rendered, device) = engine.render(&prepared, request)?;
    let all = start.elapsed().as_secs_f64() * 1e3;
    let mut run = Run {
        name: name.to_owned(),
        backend: device.backend().to_owned(),
        method: Method::of(scene, &prepared, engine.filter()),
        ..once(scene, &prepared, rendered, [before, all])
    };
    if let Some([volume, gradients]) = engine.gpu_volume_bytes() {
        run.memory.volume_bytes = if scene.volume.is_some() { volume } else { 0 };
        run.memory.gradient_bytes = gradients;
    }
    Ok(run)
}

/// One timed picture without a name: the times from the start to the prepared scene, and to the
/// picture.
fn once(scene: &Scene, prepared: &Prepared, rendered: Rendered, [before, all]: [f64; 2]) -> Run {
    Run {
        name: String::new(),
        shown: ViewKey::of(scene),
        mode: scene.render.mode,
        backend: String::new(),
        method: Method::default(),
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

/// The name of a mode on the command line.
pub(super) fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Slice => "slice",
        Mode::Raycast => "raycast",
        Mode::Surface => "surface",
    }
}

/// Samples taken, skipped and terminated, if counted.
pub(super) fn samples(run: &Run) -> [Option<u64>; 3] {
    run.stats.map_or([None; 3], |s| {
        [s.samples_taken, s.samples_skipped, s.samples_terminated].map(Some)
    })
}

/// Total time of all stages of a name; none if there is no such stage.
pub(super) fn stage_milliseconds(run: &Run, stage: &str) -> Option<f64> {
    let mut times = run
        .stages
        .iter()
        .filter(|(name, _)| name == stage)
        .map(|(_, ms)| ms)
        .peekable();
    times.peek()?;
    Some(times.sum())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::Error;
    use crate::compare::{Difference, Report};
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
        assert_eq!(
            (times(&[7.0, 3.0]), times(&[2.0]), times(&[])),
            ([3.0, 3.0, 7.0], [2.0; 3], [0.0; 3])
        );
    }

    /// Without perspective a ray meets the slices at its own sample positions.
    #[test]
    fn slices_are_rays_where_rays_are_parallel() {
        let assets = Assets::load(&scene(Mode::Slice)).unwrap();
        let render = |mode, name| {
            super::run(
                &mut Engine::cpu(),
                &scene(mode),
                &assets,
                name,
                &RenderRequest::default(),
            )
            .unwrap()
        };
        let (slice, raycast) = (render(Mode::Slice, "slice"), render(Mode::Raycast, "raycast"));
        assert!(
            slice.picture.pixels.iter().any(|p| p[3] > 0.1),
            "the scene shows nothing"
        );
        assert!(
            slice.milliseconds.median > 0.0
                && slice.stages.iter().any(|s| s.0 == "render")
                && slice.stats.is_some()
        );
        let report = Report::new("ball", "", [0.0, 0.0, 0.0, 1.0], vec![slice, raycast]).unwrap();
        assert!(
            report.pairs.len() == 1 && report.pairs[0].difference.mean < 0.1,
            "{:?}",
            report.pairs
        );
    }

    #[test]
    fn it_stops_when_told() {
        let assets = Assets::load(&scene(Mode::Slice)).unwrap();
        let watch = Watch {
            progress: &|_| (),
            cancel: &AtomicBool::new(true),
        };
        let request = RenderRequest {
            watch,
            ..RenderRequest::default()
        };
        assert!(matches!(
            super::run(
                &mut Engine::cpu(),
                &scene(Mode::Slice),
                &assets,
                "slice",
                &request
            ),
            Err(Error::Cancelled)
        ));
    }

    /// A run of one pixel.
    pub fn run(name: &str, mode: Mode, backend: &str, step: f32, error: f64, ms: f64) -> Run {
        let d = |rms: f64| Difference {
            mean: 0.5 * rms,
            max: 9.0,
            psnr_db: 20.0 * (255.0 / rms).log10(),
            ssim: 0.9,
        };
        Run {
            name: name.to_owned(),
            picture: Picture {
                width: 1,
                height: 1,
                pixels: vec![[0.5; 4]],
            },
            shown: ViewKey {
                camera: "anterior".to_owned(),
                size: [1, 1],
                surface: mode == Mode::Surface,
            },
            mode,
            backend: backend.to_owned(),
            method: Default::default(),
            step,
            milliseconds: Times::of(&[2.0 * ms]),
            rendering: Times::of(&[ms]),
            repetitions: 1,
            warm_up: None,
            stages: Vec::new(),
            stats: None,
            memory: Memory::default(),
            error: (error > 0.0).then(|| d(error)),
            is_reference: error == 0.0,
            notices: Vec::new(),
        }
    }
}
