//! The options that `render` and `compare` share, and the scene that they result in.

use super::arguments;
use super::progress::TerminalProgress;
use crate::files::OutputFile;
use crate::files::path_text::{path_of, text_of};
use crate::prepare::{Assets, IdleSetting, LoadOptions, placement};
use crate::scene::command::deform_argument;
use crate::scene::surface::CutModel;
use crate::scene::{Antialias, Camera, InsideMesh, Mode, Projection, Scene, View, VolumeFilter};
use crate::volume::load::Origin;
use crate::{Error, Result};
use clap::{Args, ValueEnum};
use std::borrow::Cow;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// How the scene is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ModeName {
    /// Volume rendering by view-aligned slices.
    Slice,
    /// Volume rendering by ray casting.
    Raycast,
    /// Surface rendering of signed distance fields.
    Surface,
}

impl From<ModeName> for Mode {
    fn from(name: ModeName) -> Self {
        match name {
            ModeName::Slice => Self::Slice,
            ModeName::Raycast => Self::Raycast,
            ModeName::Surface => Self::Surface,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CutModelName {
    /// Nothing: a thin shell.
    Hollow,
    /// Filled with material.
    Solid,
    /// A shell of finite thickness, empty inside.
    Thick,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ProjectionName {
    Perspective,
    Orthographic,
}

#[derive(Clone, Copy, ValueEnum)]
enum FilterName {
    Linear,
    Cubic,
}

impl From<FilterName> for VolumeFilter {
    fn from(name: FilterName) -> Self {
        match name {
            FilterName::Linear => Self::Linear,
            FilterName::Cubic => Self::Cubic,
        }
    }
}

/// What is shown and how: the options that every command with a picture takes.
#[derive(Args)]
pub struct Common {
    /// A scene (.toml), a volume (DICOM file, folder or zip, .nii.gz, .nrrd, .mha, .vti, .tif and
    /// so on), a mesh (.stl, .obj, .ply, .off, .gltf, .glb, .gii),
    /// phantom:NAME[:size=N] or function:EXPRESSION (see incise list).
    pub input: PathBuf,
    #[command(flatten)]
    volume: arguments::VolumeArguments,
    /// Rendering mode: slices, rays or surfaces.
    #[arg(long, value_enum)]
    pub mode: Option<ModeName>,
    /// Size of the picture.
    #[arg(long, value_name = "WxH", value_parser = arguments::picture_size)]
    pub size: Option<[u32; 2]>,
    /// Sampling distance in voxels (of the smallest spacing).
    #[arg(long)]
    pub step: Option<f32>,
    /// Slices composited inside one fragment (mode slice); 1 draws one polygon per slice.
    #[arg(long, value_name = "N")]
    slab: Option<u32>,
    /// adaptive: more samples where pixels differ from their neighbours. A number: N by N samples
    /// in every pixel (1 to 4).
    #[arg(long, value_name = "adaptive|N")]
    antialias: Option<Antialias>,
    /// Interpolation of the volume where it is shaded: cubic B-splines are smoother and take longer.
    #[arg(long, value_enum)]
    filter: Option<FilterName>,
    /// anterior, posterior, left, right, superior, inferior or AZ,EL in degrees.
    #[arg(long, allow_hyphen_values = true, value_parser = |t: &str| t.parse::<View>())]
    pub camera: Option<View>,
    /// 1 shows the whole volume.
    #[arg(long)]
    zoom: Option<f32>,
    /// Camera projection.
    #[arg(long, value_enum)]
    projection: Option<ProjectionName>,
    /// Transfer function by name (see incise list).
    #[arg(long)]
    preset: Option<String>,
    /// Window width: the range of values that the transfer function spans.
    #[arg(long)]
    window: Option<f64>,
    /// Window level: the centre of that range.
    #[arg(long, allow_hyphen_values = true)]
    level: Option<f64>,
    /// Add a deformation after the scene's own; repeat for more, applied in order. Without center
    /// and size it lies on the visible surface in the middle of the view; -v prints the numbers.
    #[arg(long, value_name = "KIND[:name=value,...]")]
    deform: Vec<OsString>,
    /// Replace all deformations by one precomputed map wherever its error is at most this, mm.
    #[arg(long, value_name = "MM")]
    precompose: Option<f32>,
    /// Value of the volume whose surface is shown (mode surface; data units).
    #[arg(long, value_name = "VALUE", allow_hyphen_values = true)]
    iso: Option<f64>,
    /// Look of surfaces by name (see incise list).
    #[arg(long, value_name = "NAME")]
    look: Option<String>,
    /// Interior of surfaces where they are cut.
    #[arg(long, value_enum)]
    cut_model: Option<CutModelName>,
    /// Show the volume only inside this mesh. If it has holes, its winding number decides what is
    /// inside.
    #[arg(long, value_name = "MESH")]
    inside: Option<PathBuf>,
    /// The light: a preset (see incise list), then settings, or either: azimuth=, elevation= and
    /// radius= of the key light in degrees, key= and sky= for the strength of each (0 to 1), shadow=
    /// and occlusion= (on or off), quality= (fast or reference).
    #[arg(long, value_name = "PRESET|key=value,...")]
    light: Option<String>,
    /// R,G,B[,A] (0..1 or 0..255), #rrggbb or transparent.
    #[arg(long, value_parser = arguments::background)]
    background: Option<[f32; 4]>,
    /// Write rendering statistics as JSON to a file, or to standard output (-).
    #[arg(long, value_name = "FILE|-")]
    pub stats: Option<PathBuf>,
    /// The same report on standard output.
    #[arg(long)]
    pub json: bool,
    /// Threads of the CPU renderer; all cores by default.
    #[arg(long)]
    threads: Option<usize>,
    /// No notices, no progress.
    #[arg(short, long)]
    pub quiet: bool,
    /// Print a summary, and the numbers chosen for deformations that leave them out.
    #[arg(short, long)]
    pub verbose: bool,
}

/// Warnings from the volume's reader.
pub fn warnings(scene: &Scene, assets: &Assets) -> Vec<String> {
    assets
        .volume
        .warnings_with_options()
        .iter()
        .map(|warning| format!("{}: {warning}", shown(scene.volume_name())))
        .collect()
}

/// Checks that there is patient data to copy, if it is to be copied.
///
/// # Errors
/// The volume does not come from DICOM.
pub fn check_patient(patient: bool, origin: Option<&Origin>, scene: &Scene) -> Result<()> {
    if patient && origin.is_none() {
        let problem = match scene.volume_name() {
            "" => "there is no volume whose patient data could be copied".to_owned(),
            name => format!("{} is not DICOM; it has no patient data to copy", shown(name)),
        };
        return Err(Error::value("--patient", problem));
    }
    Ok(())
}

/// A name from a scene, made printable.
fn shown(name: &str) -> String {
    path_of(name)
        .to_string_lossy()
        .replace(char::is_control, "\u{fffd}")
}

/// Checks that every option given (whether it is, its name, the setting's key) has an effect.
///
/// # Errors
/// The first option that has none, and why.
pub fn check_given<const N: usize>(given: [(bool, &str, &str); N], idle: &[IdleSetting]) -> Result<()> {
    for (_, option, key) in given.into_iter().filter(|(given, ..)| *given) {
        if let Some(idle) = idle.iter().find(|idle| idle.key == key) {
            return Err(Error::value(
                option,
                format!("has no effect here: {}", idle.reason),
            ));
        }
    }
    Ok(())
}

impl Common {
    /// The scene of the input, with the options applied.
    ///
    /// # Errors
    /// An invalid input, options that contradict it.
    pub fn scene(&self) -> Result<Scene> {
        let mut scene = Scene::of_input(&self.input)?;
        self.volume.apply(&mut scene)?;
        let render = &mut scene.render;
        render.mode = self.mode.map_or(render.mode, Mode::from);
        render.size = self.size.unwrap_or(render.size);
        render.step = self.step.unwrap_or(render.step);
        render.slab = self.slab.unwrap_or(render.slab);
        render.antialias = self.antialias.unwrap_or(render.antialias);
        render.filter = self.filter.map_or(render.filter, VolumeFilter::from);
        render.background = self.background.unwrap_or(render.background);
        let camera = &mut scene.camera;
        if let Some(view) = self.camera {
            *camera = self.camera_from_view(view, camera);
        }
        camera.zoom = self.zoom.unwrap_or(camera.zoom);
        match self.projection {
            Some(ProjectionName::Perspective) => camera.projection = Projection::Perspective,
            Some(ProjectionName::Orthographic) => camera.projection = Projection::Orthographic,
            None => {}
        }
        if let Some(light) = &self.light {
            scene.light.apply(light)?;
        }
        let transfer = &mut scene.transfer;
        if let Some(preset) = &self.preset {
            transfer.preset = Some(preset.clone());
            transfer.points.clear();
        }
        transfer.window = self.window.or(transfer.window);
        transfer.level = self.level.or(transfer.level);
        scene.render.precompose = self.precompose.or(scene.render.precompose);
        scene.surface.iso = self.iso.or(scene.surface.iso);
        for appearance in scene
            .mesh
            .iter_mut()
            .map(|m| &mut m.appearance)
            .chain([&mut scene.surface.appearance])
        {
            if let Some(look) = &self.look {
                (
                    appearance.look,
                    appearance.color,
                    appearance.inside_color,
                    appearance.cut_color,
                ) = (Some(look.clone()), None, None, None);
            }
            appearance.model = match self.cut_model {
                Some(CutModelName::Hollow) => Some(CutModel::Hollow),
                Some(CutModelName::Solid) => Some(CutModel::Solid),
                Some(CutModelName::Thick) => Some(CutModel::Thick),
                None => appearance.model,
            };
        }
        if let Some(mesh) = &self.inside {
            let volume = scene
                .volume
                .as_mut()
                .ok_or_else(|| Error::value("--inside", "needs a volume to show inside of the mesh"))?;
            // An option's path is relative to the current folder; a scene's own paths are relative
            // to the scene.
            let path = std::path::absolute(mesh).map_err(|e| Error::io(mesh, "reading", e))?;
            volume.inside = Some(InsideMesh {
                path: text_of(&path),
                ..InsideMesh::default()
            });
        }
        for text in &self.deform {
            scene
                .deformation
                .push(arguments::deformation(&text_of(Path::new(text)))?);
        }
        Ok(scene)
    }

    /// Checks that a number of samples is given, if antialiasing is: renderers are compared by the
    /// same samples.
    ///
    /// # Errors
    /// Adaptive antialiasing.
    pub fn check_fixed_antialias(&self) -> Result<()> {
        if self.antialias == Some(Antialias::Adaptive) {
            return Err(Error::value(
                "--antialias",
                "compare takes the same samples in every picture; give a number from 1 to 4",
            ));
        }
        Ok(())
    }

    /// Checks that every option given has an effect on the picture.
    ///
    /// # Errors
    /// The first option that has none, and why.
    pub fn check_effects(&self, idle: &[IdleSetting]) -> Result<()> {
        let given = [
            (self.slab.is_some(), "--slab", "render.slab"),
            (self.filter.is_some(), "--filter", "render.filter"),
            (self.light.is_some(), "--light", "light.diffuse"),
            (self.preset.is_some(), "--preset", "transfer.preset"),
            (self.window.is_some(), "--window", "transfer.window"),
            (self.level.is_some(), "--level", "transfer.level"),
            (self.precompose.is_some(), "--precompose", "render.precompose"),
            (self.iso.is_some(), "--iso", "surface.iso"),
            (self.look.is_some(), "--look", "surface.look"),
            (self.cut_model.is_some(), "--cut-model", "surface.model"),
            (self.inside.is_some(), "--inside", "volume.inside"),
        ];
        check_given(given, idle)
    }

    /// A camera in another direction, without the zoom, target and roll of the scene's own camera.
    pub fn camera_from_view(&self, view: View, camera: &Camera) -> Camera {
        let seen = Camera {
            view,
            projection: camera.projection,
            field_of_view: camera.field_of_view,
            ..Camera::default()
        };
        Camera {
            zoom: self.zoom.unwrap_or(seen.zoom),
            ..seen
        }
    }

    /// Sets the requested number of threads.
    ///
    /// # Errors
    /// An invalid number, or threads that the system refuses.
    pub fn use_threads(&self) -> Result<()> {
        let Some(threads) = self.threads else {
            return Ok(());
        };
        if !(1..=1024).contains(&threads) {
            return Err(Error::value(
                "--threads",
                format!("{threads} is outside 1 to 1024"),
            ));
        }
        // The pool can be created once per process; this is its first use.
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global()
            .map_err(|e| Error::value("--threads", e.to_string()))
    }

    /// Loads the scene's assets and prints the warnings of its volume's reader.
    ///
    /// # Errors
    /// Errors from the readers.
    pub fn load(&self, scene: &Scene, bar: &TerminalProgress) -> Result<Assets> {
        let assets = Assets::load_with(
            scene,
            &LoadOptions {
                progress: Some(&|what, share| bar.set(what, share)),
                ..LoadOptions::default()
            },
        )?;
        self.report(warnings(scene, &assets));
        Ok(assets)
    }

    /// The scene with the numbers of every deformation that leaves them out; with -v they are
    /// printed as options.
    ///
    /// # Errors
    /// Any invalid setting, by name.
    pub fn placed(&self, scene: Scene, assets: &Assets) -> Result<Scene> {
        let placed = match placement::placed(&scene, assets)? {
            Cow::Borrowed(_) => return Ok(scene),
            Cow::Owned(placed) => placed,
        };
        let changed = placed
            .deformation
            .iter()
            .zip(&scene.deformation)
            .filter(|(placed, own)| placed != own);
        if self.verbose {
            for (deformation, _) in changed {
                super::print_to_stderr(format_args!("--deform {}", deform_argument(deformation)));
            }
        }
        Ok(placed)
    }

    /// Prints notices to stderr, unless quiet.
    pub fn report<T: std::fmt::Display>(&self, notices: impl IntoIterator<Item = T>) {
        if !self.quiet {
            notices.into_iter().for_each(super::print_to_stderr);
        }
    }

    /// Whether `--stats` or `--json` write to standard output.
    pub fn reports_to_standard_output(&self) -> bool {
        self.json || self.stats.as_deref() == Some(Path::new("-"))
    }

    /// The output file of `--stats`, unless it is standard output.
    ///
    /// # Errors
    /// A destination that cannot be written.
    pub fn stats_file(&self) -> Result<Option<OutputFile>> {
        self.stats
            .as_deref()
            .filter(|p| *p != Path::new("-"))
            .map(OutputFile::create)
            .transpose()
    }

    /// Writes the output of `--stats` and `--json`.
    ///
    /// # Errors
    /// A full disk.
    pub fn write_stats(&self, text: &str, file: Option<OutputFile>) -> Result<()> {
        if self.reports_to_standard_output() {
            super::print(text)?;
        }
        file.map_or(Ok(()), |file| file.finish(text.as_bytes()))
    }
}
