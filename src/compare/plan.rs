//! The plan of a comparison: modes, steps, sizes, cameras and the step of the references; and
//! checks that it can be carried out.

use super::method::RendererOptions;
use super::run::mode_name;
use crate::picture::{MAX_PICTURE_EDGE, MAX_PIXELS};
use crate::scene::{Antialias, Camera, Mode, Scene};
use crate::{Error, Result};
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

/// The plan of a comparison: every combination of modes, steps, sizes and cameras on every backend.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The scene; the fields below override its own settings.
    pub scene: Scene,
    /// Modes.
    pub modes: Vec<Mode>,
    /// Options, each of which is a renderer of its own in every mode in which it acts.
    pub options: Vec<RendererOptions>,
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

/// The modes that apply to a scene. Slices show surfaces, too.
pub fn modes_of(scene: &Scene) -> Vec<Mode> {
    let has_volume = scene.volume.is_some();
    let has_surface = scene.mesh.iter().any(|m| !m.hidden)
        || scene.surface.iso.is_some()
        || scene.render.mode == Mode::Surface;
    let modes = [
        (has_volume || has_surface, Mode::Slice),
        (has_volume, Mode::Raycast),
        (has_surface, Mode::Surface),
    ];
    modes
        .into_iter()
        .filter_map(|(applies, mode)| applies.then_some(mode))
        .collect()
}

impl Plan {
    /// A plan with the scene's own step, size and camera, on the CPU.
    pub fn of(mut scene: Scene) -> Self {
        // Renderers are compared by the same samples: adaptive ones would depend on their pictures.
        if scene.render.antialias == Antialias::Adaptive {
            scene.render.antialias = Antialias::OFF;
        }

        Self {
            modes: modes_of(&scene),
            options: vec![RendererOptions::of(&scene)],
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
        self.check_lists(backends)?;
        self.check_renderers()?;
        if let Some(mode) = self
            .modes
            .iter()
            .find(|m| **m == Mode::Raycast && self.scene.volume.is_none())
        {
            return Err(Error::value(
                format!("--modes {}", mode_name(*mode)),
                "shows a volume, and the scene has none; use --modes slice,surface",
            ));
        }
        if let Some(step) = self.steps.iter().find(|s| !STEPS.contains(*s)) {
            return Err(Error::value(
                "--steps",
                format!("{step} is outside {} to {} voxels", STEPS.start(), STEPS.end()),
            ));
        }
        self.check_sizes()?;
        if !(1..=MAX_REPETITIONS).contains(&self.repeat) {
            return Err(Error::value(
                "--repeat",
                format!("{} is outside 1 to {MAX_REPETITIONS}", self.repeat),
            ));
        }
        if let Some(reference) = self.reference {
            self.check_reference(reference)?;
        }
        self.check_total_pixels(backends)
    }

    /// Checks that the plan has at least one mode, step, size, camera and backend.
    fn check_lists(&self, backends: usize) -> Result<()> {
        let empty = [
            ("--modes", self.modes.is_empty()),
            ("--steps", self.steps.is_empty()),
            ("--sizes", self.sizes.is_empty()),
        ];
        let empty = empty.into_iter().chain([
            ("--cameras", self.cameras.is_empty()),
            ("--backend", backends == 0),
        ]);
        if let Some((option, _)) = empty.into_iter().find(|e| e.1) {
            return Err(Error::value(
                option,
                "leaves nothing to compare; name at least one",
            ));
        }
        Ok(())
    }

    /// Checks that no renderer is compared with itself: each is named once.
    fn check_renderers(&self) -> Result<()> {
        let repeated = (1..self.modes.len()).find(|n| self.modes[..*n].contains(&self.modes[*n]));
        if let Some(n) = repeated {
            return Err(Error::value(
                format!("--modes {}", mode_name(self.modes[n])),
                "is listed twice; remove one",
            ));
        }
        if (1..self.options.len()).any(|n| self.options[..n].contains(&self.options[n])) {
            return Err(Error::value(
                "--slabs, --slice-orders, --blend-formats, --jacobians, --map-filters",
                "list the same renderer twice; remove the repeated value",
            ));
        }
        Ok(())
    }

    /// Checks that each size, with its samples per pixel, can be rendered.
    fn check_sizes(&self) -> Result<()> {
        if let Some([w, h]) = self
            .sizes
            .iter()
            .find(|s| s.iter().any(|n| !(1..=MAX_PICTURE_EDGE).contains(n)))
        {
            return Err(Error::value(
                "--sizes",
                format!("{w}x{h} is out of range; each edge must be 1 to {MAX_PICTURE_EDGE} pixels"),
            ));
        }
        let antialias = self.scene.render.antialias.grid().clamp(1, Antialias::MAX_GRID);
        let too_large = |[w, h]: &&[u32; 2]| {
            let [w, h] = [w.saturating_mul(antialias), h.saturating_mul(antialias)];
            w.max(h) > MAX_PICTURE_EDGE || u64::from(w) * u64::from(h) > MAX_PIXELS
        };
        if let Some([w, h]) = self.sizes.iter().find(too_large) {
            let sampled = if antialias > 1 {
                format!(", and {antialias} by {antialias} samples a pixel (--antialias) count as pixels")
            } else {
                String::new()
            };
            return Err(Error::value(
                "--sizes",
                format!(
                    "{w}x{h} cannot be made; an edge is at most {MAX_PICTURE_EDGE} pixels, a picture {MAX_PIXELS}{sampled}"
                ),
            ));
        }
        Ok(())
    }

    /// Checks that a reference step is in range and at most half the finest step.
    fn check_reference(&self, reference: f32) -> Result<()> {
        let finest = self.steps.iter().copied().fold(f32::INFINITY, f32::min);
        if !STEPS.contains(&reference) {
            return Err(Error::value(
                "--reference",
                format!(
                    "{reference} is outside {} to {} voxels",
                    STEPS.start(),
                    STEPS.end()
                ),
            ));
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
        Ok(())
    }

    /// Checks that all pictures together have at most [`MAX_TOTAL_PIXELS`].
    fn check_total_pixels(&self, backends: usize) -> Result<()> {
        let kinds = BTreeSet::from_iter(
            self.modes
                .iter()
                .map(|m| *m == Mode::Surface || self.scene.volume.is_none()),
        )
        .len();
        let pictures = (self.renderer_count() * self.steps.len() * backends
            + if self.reference.is_some() { kinds } else { 0 })
            * self.cameras.len();
        let pixels = self
            .sizes
            .iter()
            .map(|[w, h]| u64::from(*w) * u64::from(*h))
            .sum::<u64>()
            .saturating_mul(pictures as u64);
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
    pub(super) fn at(&self, mode: Mode, step: f32, size: [u32; 2], camera: &Camera) -> Scene {
        let mut scene = Scene {
            camera: camera.clone(),
            ..self.scene.clone()
        };
        (scene.render.mode, scene.render.step, scene.render.size) = (mode, step, size);
        scene
    }

    /// The different options in a mode.
    pub(super) fn options_in(&self, mode: Mode) -> Vec<RendererOptions> {
        let mut scene = self.scene.clone();
        scene.render.mode = mode;
        let mut all: Vec<RendererOptions> = Vec::new();
        for options in self.options.iter().map(|options| options.acting(&scene)) {
            if !all.contains(&options) {
                all.push(options);
            }
        }
        all
    }

    /// Number of renderers on one backend.
    pub(super) fn renderer_count(&self) -> usize {
        self.modes.iter().map(|&mode| self.options_in(mode).len()).sum()
    }

    /// A name that distinguishes a run from all others: mode and backend, and the settings that the
    /// plan varies.
    pub(super) fn name(&self, head: &str, scene: &Scene, names_step: bool) -> String {
        let mut name = head.to_owned();
        if self.options.len() > 1 {
            let label = RendererOptions::of(scene).label(scene.render.mode);
            name += if label.is_empty() { "" } else { " " };
            name += &label;
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_that_cannot_be_are_named() {
        let good = || Plan {
            steps: vec![0.5, 1.0],
            ..Plan::of(Scene::of_volume("phantom:ball:size=12"))
        };
        assert!(good().check(1).is_ok() && good().check(2).is_ok());
        assert_eq!(good().modes, [Mode::Slice, Mode::Raycast]);
        assert_eq!(
            Plan::of(Scene::of_mesh("a.stl")).modes,
            [Mode::Slice, Mode::Surface]
        );
        let cases: [(&str, Plan); 10] = [
            (
                "--modes",
                Plan {
                    modes: Vec::new(),
                    ..good()
                },
            ),
            (
                "--modes raycast",
                Plan {
                    modes: vec![Mode::Raycast],
                    ..Plan::of(Scene::of_mesh("a.stl"))
                },
            ),
            (
                "--steps",
                Plan {
                    steps: vec![f32::NAN],
                    ..good()
                },
            ),
            (
                "--steps",
                Plan {
                    steps: vec![0.001],
                    ..good()
                },
            ),
            (
                "--sizes",
                Plan {
                    sizes: vec![[0, 5]],
                    ..good()
                },
            ),
            (
                "--sizes",
                Plan {
                    sizes: vec![[9000, 9000]],
                    ..good()
                },
            ),
            (
                "--cameras",
                Plan {
                    cameras: Vec::new(),
                    ..good()
                },
            ),
            ("--repeat", Plan { repeat: 0, ..good() }),
            (
                "--reference",
                Plan {
                    reference: Some(0.4),
                    ..good()
                },
            ),
            (
                "--reference",
                Plan {
                    reference: Some(f32::NAN),
                    ..good()
                },
            ),
        ];
        for (option, plan) in cases {
            let message = plan.check(1).unwrap_err().to_string();
            assert!(message.starts_with(option), "{message}");
        }
        assert!(good().check(0).is_err());
        // Names state only the settings that vary.
        let plan = Plan {
            sizes: vec![[8, 6], [16, 12]],
            ..good()
        };
        let scene = plan.at(Mode::Slice, 0.5, [8, 6], &plan.cameras[0]);
        assert_eq!(plan.name("slice cpu", &scene, true), "slice cpu step 0.5 8x6");
        assert_eq!(
            Plan::of(scene.clone()).name("slice cpu", &scene, true),
            "slice cpu"
        );
    }
}
