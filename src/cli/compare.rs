//! `incise compare`: slices, rays and surfaces of one scene, on the CPU and a GPU, as a folder with
//! a report page.

use super::arguments;
use super::common::{Common, ModeName, check_given};
use super::progress::TerminalProgress;
use crate::compare::lab::{self, Plan, REFERENCE_STEP};
use crate::compare::plot::number;
use crate::compare::{RendererOptions, Report, write_files};
use crate::export::protect;
use crate::files::{OutputFile, check_distinct};
use crate::prepare::{Assets, IdleSetting, Prepared, idle_settings};
use crate::scene::{BlendFormat, JacobianSource, MapFiltering, Mode, Scene, SliceOrder, View};
use crate::{Error, Result};
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};

/// Where pictures are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CompareBackends {
    /// The CPU and, if available, a GPU (software adapters included).
    Auto,
    /// A GPU (software adapters included); an error if there is none. References are still rendered
    /// on the CPU.
    Gpu,
    /// The CPU.
    Cpu,
}

/// The order of slices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SliceOrderName {
    BackToFront,
    FrontToBack,
}

impl From<SliceOrderName> for SliceOrder {
    fn from(name: SliceOrderName) -> Self {
        match name {
            SliceOrderName::BackToFront => Self::BackToFront,
            SliceOrderName::FrontToBack => Self::FrontToBack,
        }
    }
}

/// The number format of blending.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum BlendFormatName {
    Float32,
    Float16,
}

impl From<BlendFormatName> for BlendFormat {
    fn from(name: BlendFormatName) -> Self {
        match name {
            BlendFormatName::Float32 => Self::Float32,
            BlendFormatName::Float16 => Self::Float16,
        }
    }
}

/// The source of Jacobians.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum JacobianName {
    Differences,
    Stored,
}

impl From<JacobianName> for JacobianSource {
    fn from(name: JacobianName) -> Self {
        match name {
            JacobianName::Differences => Self::Differences,
            JacobianName::Stored => Self::Stored,
        }
    }
}

/// The filter of maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum MapFilterName {
    Shader,
    Hardware,
}

impl From<MapFilterName> for MapFiltering {
    fn from(name: MapFilterName) -> Self {
        match name {
            MapFilterName::Shader => Self::Shader,
            MapFilterName::Hardware => Self::Hardware,
        }
    }
}

/// Options as typed.
#[derive(Args)]
#[command(after_long_help = "\
Every combination of --modes, --steps, --sizes and --cameras is rendered on every backend and timed. Each picture is measured against a
reference, rays on the CPU at a step of 1/16 voxel (surfaces against surfaces); over two steps or more, the report says what each renderer
costs at equal error. The protocol follows Meissner et al., Volume Visualization 2000: same optical model, same view, same
transfer function.

DIR gets every picture, difference pictures, report.json, runs.csv, pairs.csv and index.html, a page that holds all of it. Files of these
names are replaced; the page is written last.

    incise compare scan.nii.gz -o lab
    incise compare scene.toml -o lab --steps 0.5,1,2 --sizes 256x256,512x512 --cameras 'anterior;40,20'
    incise compare model.stl -o lab --deform wedge:angle=70 --backend cpu --repeat 9")]
pub struct CompareArguments {
    #[command(flatten)]
    common: Common,
    /// The folder to write; made if it does not exist.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Where to compute.
    #[arg(long, value_enum, default_value = "auto")]
    backend: CompareBackends,
    /// Modes to compare; by default slice and raycast if there is a volume, and surface if the
    /// scene has a surface.
    #[arg(
        long,
        value_enum,
        value_name = "MODE,...",
        value_delimiter = ',',
        conflicts_with = "mode"
    )]
    modes: Vec<ModeName>,
    /// Slices composited inside one fragment, e.g. 1,8,32 (mode slice).
    #[arg(long, value_name = "N,...", value_delimiter = ',', conflicts_with = "slab")]
    slabs: Vec<u32>,
    /// Orders in which slices are drawn (mode slice).
    #[arg(long, value_enum, value_name = "ORDER,...", value_delimiter = ',')]
    slice_orders: Vec<SliceOrderName>,
    /// Number formats in which slices are blended (mode slice).
    #[arg(long, value_enum, value_name = "FORMAT,...", value_delimiter = ',')]
    blend_formats: Vec<BlendFormatName>,
    /// How the Jacobians of displacement maps are found.
    #[arg(long, value_enum, value_name = "SOURCE,...", value_delimiter = ',')]
    jacobians: Vec<JacobianName>,
    /// How displacement maps are interpolated: by the shader, or by hardware with weights of 8 bits.
    #[arg(long, value_enum, value_name = "FILTER,...", value_delimiter = ',')]
    map_filters: Vec<MapFilterName>,
    /// Sampling distances in voxels, e.g. 0.5,1,2.
    #[arg(long, value_name = "STEP,...", value_delimiter = ',', conflicts_with = "step")]
    steps: Vec<f32>,
    /// Sizes of pictures, e.g. 256x256,512x512.
    #[arg(long, value_name = "WxH,...", value_delimiter = ',', value_parser = arguments::picture_size, conflicts_with = "size")]
    sizes: Vec<[u32; 2]>,
    /// Cameras, e.g. 'anterior;left;40,20': names and pairs AZ,EL with ; or , between them, or the
    /// option repeated.
    #[arg(long, value_name = "CAMERA;...", allow_hyphen_values = true, value_parser = cameras, conflicts_with = "camera")]
    cameras: Vec<CameraList>,
    /// Number of timed renderings per run; the median is reported.
    #[arg(long, value_name = "N", default_value_t = 3)]
    repeat: usize,
    /// Step of the references, voxels; at most half of the finest step.
    #[arg(long, value_name = "STEP", default_value_t = REFERENCE_STEP)]
    reference: f32,
    /// Skip the references; no errors are reported, but the run is much faster.
    #[arg(long, conflicts_with = "reference")]
    no_reference: bool,
}

/// Several view directions in one argument.
#[derive(Clone, Debug, PartialEq)]
struct CameraList(Vec<View>);

/// Names, and pairs of numbers. A comma after a number continues a pair; any other comma separates
/// two cameras.
fn cameras(text: &str) -> Result<CameraList, String> {
    let mut views = Vec::new();
    for part in text.split(';') {
        let mut words = part.split(',');
        while let Some(word) = words.next() {
            let is_number = word.trim().parse::<f32>().is_ok();
            let view = match is_number.then(|| words.next()) {
                Some(Some(elevation)) => format!("{word},{elevation}"),
                _ => word.trim().to_owned(),
            };
            views.push(view.parse()?);
        }
    }
    Ok(CameraList(views))
}

/// The list without duplicates.
fn once<T: PartialEq + Clone>(list: &[T]) -> Vec<T> {
    let mut unique: Vec<T> = Vec::new();
    for item in list {
        if !unique.contains(item) {
            unique.push(item.clone());
        }
    }
    unique
}

impl CompareArguments {
    /// The plan: the scene with the settings to vary.
    fn plan(&self) -> Result<Plan> {
        let scene = self.common.scene()?;
        self.common.check_fixed_antialias()?;
        let mut plan = Plan::of(scene);
        if let Some(mode) = self.common.mode {
            plan.modes = vec![mode.into()];
        }
        if !self.modes.is_empty() {
            plan.modes = self.modes.iter().copied().map(Mode::from).collect();
        }
        plan.options = self.options(RendererOptions::of(&plan.scene));
        if !self.steps.is_empty() {
            plan.steps = once(&self.steps);
        }
        if !self.sizes.is_empty() {
            plan.sizes = once(&self.sizes);
        }
        if !self.cameras.is_empty() {
            let views: Vec<View> = self.cameras.iter().flat_map(|c| c.0.iter().copied()).collect();
            plan.cameras = once(&views)
                .into_iter()
                .map(|view| self.common.camera_from_view(view, &plan.scene.camera))
                .collect();
        }
        plan.repeat = self.repeat;
        plan.reference = (!self.no_reference).then_some(self.reference);
        plan.on_cpu = self.backend != CompareBackends::Gpu;
        plan.gpu_is_required = self.backend == CompareBackends::Gpu;
        Ok(plan)
    }

    /// Checks that every option given has an effect in one of the modes.
    fn check_effects(&self, idle: &[IdleSetting]) -> Result<()> {
        self.common.check_effects(idle)?;
        let given = [
            (!self.slabs.is_empty(), "--slabs", "render.slab"),
            (
                !self.slice_orders.is_empty(),
                "--slice-orders",
                "render.slice_order",
            ),
            (
                !self.blend_formats.is_empty(),
                "--blend-formats",
                "render.blend_format",
            ),
            (!self.jacobians.is_empty(), "--jacobians", "render.jacobian"),
            (!self.map_filters.is_empty(), "--map-filters", "render.map_filter"),
        ];
        check_given(given, idle)
    }

    /// Every combination of the options; those not given are the scene's.
    fn options(&self, own: RendererOptions) -> Vec<RendererOptions> {
        let mut all = vec![own];
        let vary =
            |all: &mut Vec<RendererOptions>, count: usize, set: &dyn Fn(&mut RendererOptions, usize)| {
                if count > 0 {
                    *all = (0..count)
                        .flat_map(|n| all.iter().map(move |one| (n, *one)))
                        .map(|(n, mut one)| {
                            set(&mut one, n);
                            one
                        })
                        .collect();
                }
            };
        vary(&mut all, self.slabs.len(), &|one, n| one.slab = self.slabs[n]);
        vary(&mut all, self.slice_orders.len(), &|one, n| {
            one.order = self.slice_orders[n].into();
        });
        vary(&mut all, self.blend_formats.len(), &|one, n| {
            one.format = self.blend_formats[n].into();
        });
        vary(&mut all, self.jacobians.len(), &|one, n| {
            one.jacobian = self.jacobians[n].into();
        });
        vary(&mut all, self.map_filters.len(), &|one, n| {
            one.map_filter = Some(self.map_filters[n].into());
        });
        all
    }

    /// Checks that the folder can be written or created, and that no file of it is an input.
    /// Creates nothing.
    fn check_output(&self, scene: &Scene) -> Result<()> {
        let folder = &self.output;
        if folder.exists() && !folder.is_dir() {
            return Err(Error::file(folder, "is a file; --output names a folder"));
        }
        let is_there = |p: &&Path| p.as_os_str().is_empty() || p.exists();
        let nearest = folder.ancestors().find(is_there).unwrap_or(Path::new("."));
        if !nearest.as_os_str().is_empty() && !nearest.is_dir() {
            return Err(Error::file(
                nearest,
                "is a file; --output names a folder below it",
            ));
        }
        let names = [
            "index.html",
            "report.json",
            "runs.csv",
            "pairs.csv",
            "picture.png",
        ];
        if folder.is_dir() {
            names
                .iter()
                .try_for_each(|name| OutputFile::create(&folder.join(name)).map(|_tried| ()))?;
        } else {
            // The folder does not exist yet: check that files can be created in its nearest
            // existing ancestor.
            OutputFile::create(&nearest.join(".incise"))?;
        }
        self.protect(scene, names.into_iter())
    }

    /// Checks that no output is an input, and that no two outputs are the same file.
    fn protect<'a>(&self, scene: &Scene, names: impl Iterator<Item = &'a str> + Clone) -> Result<()> {
        let read = scene.files();
        let read = || {
            read.iter()
                .map(PathBuf::as_path)
                .chain([self.common.input.as_path()])
        };
        if let Some(stats) = self.common.stats.as_ref().filter(|p| *p != Path::new("-")) {
            protect("--stats", stats, read().collect::<Vec<_>>())?;
            names
                .clone()
                .try_for_each(|name| check_distinct(&self.output.join(name), "--stats", stats))?;
        }
        let paths: Vec<&Path> = read().collect();
        names
            .into_iter()
            .try_for_each(|name| protect("--output", &self.output.join(name), paths.iter().copied()))
    }
}

/// Renders, compares, writes.
pub fn run(arguments: &CompareArguments) -> Result<()> {
    let common = &arguments.common;
    let mut plan = arguments.plan()?;
    // A GPU may be missing; errors in the options are reported before one is opened.
    plan.check(1)?;
    arguments.check_output(&plan.scene)?;
    let stats_file = common.stats_file()?;
    common.use_threads()?;
    let gpu = match arguments.backend {
        CompareBackends::Cpu => None,
        CompareBackends::Gpu => Some(lab::open_gpu()?),
        CompareBackends::Auto => match lab::open_gpu() {
            Ok(gpu) => Some(gpu),
            Err(error) => {
                common.report([format!("{error}; comparing on the CPU only")]);
                None
            }
        },
    };
    let bar = TerminalProgress::new(common.quiet);
    let assets = common.load(&plan.loading(), &bar)?;
    // Placed once: every camera and mode shows the same deformation.
    plan.scene = common.placed(plan.scene, &assets)?;
    if let Some(file) = &stats_file {
        file.check()?;
    }
    let title = common
        .input
        .file_name()
        .unwrap_or(common.input.as_os_str())
        .to_string_lossy();
    arguments.check_effects(&idle_everywhere(&plan, &assets)?)?;
    let report = lab::run(&plan, &assets, gpu, &title, &|what, share| bar.set(what, share))?;
    bar.finish();
    common.report(assets.library.notices());
    common.report(report.protocol.iter().flat_map(|p| &p.notices));
    let files = report.files()?;
    arguments.protect(&plan.scene, files.iter().map(|f| f.0.as_str()))?;
    write_files(&arguments.output, &files)?;
    if let Some((_, json)) = files.iter().find(|f| f.0 == "report.json") {
        common.write_stats(String::from_utf8_lossy(json).trim_end(), stats_file)?;
    }
    if common.verbose {
        summary(&report);
    }
    Ok(())
}

/// The settings that have no effect in any mode of a plan.
fn idle_everywhere(plan: &Plan, assets: &Assets) -> Result<Vec<IdleSetting>> {
    let mut everywhere: Option<Vec<IdleSetting>> = None;
    for &mode in &plan.modes {
        let mut scene = plan.scene.clone();
        scene.render.mode = mode;
        let idle = idle_settings(&Prepared::new(&scene, assets)?, &scene);
        everywhere = Some(match everywhere {
            None => idle,
            Some(all) => all
                .into_iter()
                .filter(|one| idle.iter().any(|other| other.key == one.key))
                .collect(),
        });
    }
    Ok(everywhere.unwrap_or_default())
}

/// Prints a summary of the results.
fn summary(report: &Report) {
    for run in report.runs.iter().filter(|run| !run.is_reference) {
        let error = run.error.map_or(String::new(), |d| {
            format!(", RMS error {} of 255", number(d.rms()))
        });
        super::print_to_stderr(format_args!(
            "{}: {:.1} ms{error}",
            run.name, run.milliseconds.median
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_names_and_pairs() {
        let views = |text: &str| cameras(text).map(|c| c.0.into_iter().map(String::from).collect::<Vec<_>>());
        assert_eq!(
            views("anterior,left,40,20"),
            Ok(vec!["anterior".into(), "left".into(), "40,20".into()])
        );
        assert_eq!(
            views("anterior; -40, 20 ;left"),
            Ok(vec!["anterior".into(), "-40,20".into(), "left".into()])
        );
        assert_eq!(views("-40,-20,10,5"), Ok(vec!["-40,-20".into(), "10,5".into()]));
        for bad in [
            "",
            "above",
            "40",
            "anterior,40",
            "anterior;;left",
            "40,20,30",
            "nan,3",
            "10,95",
        ] {
            assert!(views(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn repeated_values_count_once() {
        assert_eq!(once(&[2.0, 1.0, 2.0]), [2.0, 1.0]);
    }
}
