//! A scene resolved for rendering, and the picture that comes out: the same types for every backend.

use super::accelerator::{Accelerator, Unaided};
use super::deformations::{self, Composition, Making};
use super::inside::{self, KeptInsides};
use super::objects::{Objects, Surfaces};
use super::sampled::Sampled;
use super::{CutFaces, Light, Macrocells, Mode, Normals, RenderSettings, Scene, ViewFrame, macrocells::Contents};
use crate::deform::cut::Cuts;
use crate::deform::{Library, PlacedMap, Stack, Storage};
use crate::files::memory;
use crate::math::lanes::*;
use crate::math::{Bounds, normalize_or, to_f32};
use crate::mesh::Mesh;
use crate::transfer::{Blend, OWN_COLORS, Table, default_preset};
use crate::volume::load::Choice;
use crate::volume::{Colors, GradientFilter, GradientVolume, Grid, Volume, load, phantom};
use crate::{Error, Result, Watch};
use glam::{Affine3A, DVec3, Vec3};
use rayon::prelude::*;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

/// Largest edge of a picture, pixels.
pub const MAX_PICTURE_EDGE: u32 = 16_384;
/// Most samples of a picture: its pixels, each as often as it is antialiased. Their floating-point form takes 16 bytes each.
pub const MAX_PIXELS: u64 = 1 << 28;
/// A cut's normal takes over within one sample of the cut and has faded out after this many.
const BLEND_SAMPLES: f32 = 2.5;

/// Time spent by stage, milliseconds, in order.
#[derive(Clone, Debug, Default)]
pub struct Stages(pub Vec<(&'static str, f64)>);

impl Stages {
    /// Runs a stage and notes how long it took.
    pub fn time<T>(&mut self, name: &'static str, stage: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = stage();
        self.0.push((name, start.elapsed().as_secs_f64() * 1e3));
        result
    }

    /// Makes a part of the last stage, if that has this name, a stage of its own.
    pub fn divide(&mut self, name: &str, part: &'static str, milliseconds: f64) {
        if let Some((last, all)) = self.0.last_mut()
            && *last == name
        {
            *all = (*all - milliseconds).max(0.0);
            self.0.push((part, milliseconds));
        }
    }
}

/// What a scene refers to, loaded once and shared by any number of pictures.
pub struct Assets {
    /// The volume.
    pub volume: Arc<Volume>,
    /// Its sampled form.
    plain: Arc<Sampled>,
    /// What the volume was loaded from.
    source: Option<(PathBuf, Choice)>,
    /// The label map that goes with the volume, if the scene names one.
    pub label_map: Option<Arc<Volume>>,
    /// A label map as colours, made when it is first shown so.
    labels: OnceLock<Option<Sampled>>,
    /// What deformations read besides.
    pub library: Arc<Library>,
    /// Meshes and distance fields.
    pub objects: Objects,
    /// What a mesh that holds the volume makes of it.
    pub(super) insides: KeptInsides,
    /// Whether there is a volume, or an empty one stands in its place.
    pub has_volume: bool,
    /// The box around all meshes, mm; empty without any.
    pub mesh_box: Bounds,
    /// Time that loading took.
    pub stages: Stages,
}

impl Assets {
    /// Loads what a scene names.
    ///
    /// # Errors
    /// What the readers report.
    pub fn load(scene: &Scene, progress: &(dyn Fn(&'static str, f32) + Sync)) -> Result<Self> {
        Self::load_until(scene, progress, &AtomicBool::new(false))
    }

    /// As [`Self::load`], until `cancel` is set.
    ///
    /// # Errors
    /// As [`Self::load`]; [`Error::Cancelled`].
    pub fn load_until(scene: &Scene, progress: &(dyn Fn(&'static str, f32) + Sync), cancel: &AtomicBool) -> Result<Self> {
        Self::load_after(None, scene, progress, cancel)
    }

    /// As [`Self::load_until`], taking over the volume of a scene that was loaded before, if it is the same.
    ///
    /// # Errors
    /// As [`Self::load_until`].
    pub fn load_after(before: Option<&Self>, scene: &Scene, progress: &(dyn Fn(&'static str, f32) + Sync), cancel: &AtomicBool) -> Result<Self> {
        scene.check_limits()?;
        let mut stages = Stages::default();
        let source = scene.volume_path().zip(scene.volume.as_ref().map(|v| v.choice.clone()));
        // The same file may be named from another folder.
        let place = |s: &Option<(PathBuf, Choice)>| s.as_ref().map(|(path, choice)| (std::path::absolute(path).ok(), choice.clone()));
        let same = before.filter(|b| b.has_volume && source.is_some() && place(&b.source) == place(&source));
        let mut assets = match (scene.volume_path(), &scene.volume) {
            _ if same.is_some() => Self::again(same, scene),
            (Some(path), Some(source)) => {
                let reading = |share: f32| progress("reading", share);
                let watch = Watch { progress: &reading, cancel };
                let volume = stages.time("load", || load::volume(&path, &source.choice, &watch))?;
                Self::in_folder(volume, scene.folder.clone(), stages)
            }
            _ => Self::without_volume(scene.folder.clone()),
        };
        assets.source = source;
        let mut stages = std::mem::take(&mut assets.stages);
        if let Some(path) = scene.volume.as_ref().and_then(|v| v.labels.as_ref()) {
            assets.label_map = Some(stages.time("labels", || assets.library.load_label_map(path))?);
        }
        if !scene.mesh.is_empty() || scene.render.mode == Mode::Surface {
            assets.mesh_box = stages.time("meshes", || assets.load_objects(scene, &|share| progress("distances", share)))?;
        }
        if !assets.has_volume {
            let empty = Volume::empty_over(&assets.mesh_box);
            assets.plain = Arc::new(Sampled::new(Grid::new(&empty)));
            assets.volume = Arc::new(empty);
        }
        assets.stages = stages;
        Ok(assets)
    }

    /// The box around the volume and all meshes, mm.
    pub fn scene_box(&self) -> Bounds {
        if self.has_volume {
            return self.volume.bounds_in_world().union(&self.mesh_box);
        }
        // A flat sheet has a box all the same.
        let size = self.mesh_box.size();
        let more = (Vec3::splat(0.01 * size.max_element()) - size).max(Vec3::ZERO) * 0.5;
        Bounds::new(self.mesh_box.min - more, self.mesh_box.max + more)
    }

    /// The label map: the one that the scene names, or the volume itself if it is one.
    ///
    /// # Errors
    /// There is none.
    pub fn label_map(&self) -> Result<&Arc<Volume>> {
        if let Some(map) = &self.label_map {
            return Ok(map);
        }
        if self.has_volume && self.as_labels().is_some() {
            return Ok(&self.volume);
        }
        Err(Error::value("volume.labels", "there is no label map; open one over the volume"))
    }

    /// The volume's sampled form.
    pub fn grid(&self) -> &Grid {
        &self.plain.grid
    }

    /// The grid that the label map shows as colours; none if the volume is no label map.
    fn as_labels(&self) -> Option<&Sampled> {
        self.labels.get_or_init(|| Grid::of_labels(&self.volume).map(Sampled::new)).as_ref()
    }

    /// The assets of a volume that is already in memory.
    pub fn of_volume(volume: Volume, stages: Stages) -> Self {
        Self::in_folder(volume, std::path::PathBuf::new(), stages)
    }

    /// An empty volume stands where there is none.
    /// The volume of assets that are there already, and what was read for its deformations.
    fn again(before: Option<&Self>, scene: &Scene) -> Self {
        let Some(b) = before else { return Self::without_volume(scene.folder.clone()) };
        Self {
            volume: b.volume.clone(),
            plain: b.plain.clone(),
            source: b.source.clone(),
            label_map: None,
            labels: OnceLock::new(),
            library: if b.library.folder() == scene.folder {
                b.library.clone()
            } else {
                Arc::new(Library::new(b.volume.clone(), scene.folder.clone()))
            },
            objects: Objects::default(),
            insides: KeptInsides::default(),
            has_volume: true,
            mesh_box: Bounds::EMPTY,
            stages: Stages::default(),
        }
    }

    fn without_volume(folder: std::path::PathBuf) -> Self {
        let mut assets = Self::in_folder(Volume::empty_over(&Bounds::UNIT), folder.clone(), Stages::default());
        assets.library = Arc::new(Library::without_volume(folder));
        assets.has_volume = false;
        assets
    }

    fn in_folder(volume: Volume, folder: std::path::PathBuf, mut stages: Stages) -> Self {
        let grid = stages.time("grid", || Grid::new(&volume));
        let plain = stages.time("bricks", || Sampled::new(grid));
        let volume = Arc::new(volume);
        let library = Arc::new(Library::new(volume.clone(), folder));
        Self {
            library,
            volume,
            plain: Arc::new(plain),
            source: None,
            label_map: None,
            labels: OnceLock::new(),
            objects: Objects::default(),
            insides: KeptInsides::default(),
            has_volume: true,
            mesh_box: Bounds::EMPTY,
            stages,
        }
    }
}

/// The constants of one picture.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Camera.
    pub view: ViewFrame,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Distance between slices, or between samples along a ray, mm.
    pub step_mm: f32,
    /// Δ₀, the length that opacities are stated for: the smallest voxel spacing, mm.
    pub reference_mm: f32,
    /// World to voxel.
    pub voxel_from_world: Affine3A,
    /// Extent of the volume, voxels.
    pub grid_size: Vec3,
    /// The part of the deformed scene that can show anything, mm.
    pub proxy: Bounds,
    /// Unit vector towards the light, world.
    pub to_light: Vec3,
    /// Distances from a cut at which its normal stops to rule alone, and to matter at all, mm.
    pub blend_mm: [f32; 2],
}

/// A scene's deformation alone.
pub struct Deformed {
    /// Maps, in order of application.
    pub stack: Stack,
    /// Cuts that come after every map.
    pub cuts: Cuts,
    /// What composing maps into one has cost in exactness, if any were.
    pub composition: Option<Composition>,
    /// The mesh that slices are cut from instead of a box.
    pub proxy_mesh: Option<Arc<Mesh>>,
}

impl Deformed {
    /// The deformation of a scene, as its pictures have it.
    ///
    /// # Errors
    /// Any setting that cannot be used, by name.
    pub fn new(scene: &Scene, assets: &Assets) -> Result<Self> {
        Self::until(scene, assets, &Watch::NOBODY)
    }

    /// As [`Self::new`], until it is told to stop.
    ///
    /// # Errors
    /// As [`Self::new`]; [`Error::Cancelled`].
    pub fn until(scene: &Scene, assets: &Assets, watch: &Watch) -> Result<Self> {
        scene.check_limits()?;
        check_settings(&scene.render, &scene.light)?;
        let view = scene.camera.frame(&assets.scene_box(), scene.render.size)?;
        Self::with(scene, assets, &view, Vec::new(), &Unaided, watch)
    }

    fn with(scene: &Scene, assets: &Assets, view: &ViewFrame, more: Vec<PlacedMap>, device: &dyn Accelerator, watch: &Watch) -> Result<Self> {
        let settings = &scene.render;
        let scene_box = assets.scene_box();
        let reference_mm = assets.volume.spacing_mm().min_element() as f32;
        let making = Making {
            library: &assets.library,
            scene_box,
            least_ramp_mm: 1.2 * blend_mm(settings.step, reference_mm)[1],
            view,
            storage: None,
            exact_cuts: settings.exact_cuts,
            device,
            watch,
        };
        let undeformed = more.is_empty() && !scene.deformation.iter().any(|d| d.enabled);
        let (inside, proxy_mesh) = match inside::of_scene(scene, assets, &scene_box, making.least_ramp_mm)? {
            Some(inside) => (inside.maps.clone(), inside.proxy.clone().filter(|_| undeformed)),
            None => (Vec::new(), None),
        };
        let (stack, cuts) = deformations::stack(&scene.deformation, &making, inside, more)?;
        let (stack, composition) = deformations::composed(stack, &making, settings.precompose)?;
        Ok(Self { stack, cuts, composition, proxy_mesh })
    }

    /// The exact deformation: every map in single precision, none composed; its last cuts as shapes if asked for. What is baked.
    ///
    /// # Errors
    /// Any setting that cannot be used, by name.
    pub fn exact(scene: &Scene, assets: &Assets, exact_cuts: bool) -> Result<Self> {
        Self::exact_until(scene, assets, exact_cuts, &Watch::NOBODY)
    }

    /// As [`Self::exact`], until it is told to stop.
    ///
    /// # Errors
    /// As [`Self::exact`]; [`Error::Cancelled`].
    pub fn exact_until(scene: &Scene, assets: &Assets, exact_cuts: bool, watch: &Watch) -> Result<Self> {
        scene.check_limits()?;
        let scene_box = assets.scene_box();
        let view = scene.camera.frame(&scene_box, scene.render.size)?;
        let least_ramp_mm = 1.5 * assets.volume.spacing_mm().min_element() as f32;
        let (library, device) = (&assets.library, &Unaided);
        let making = Making { library, scene_box, least_ramp_mm, view: &view, storage: Some(Storage::F32), exact_cuts, device, watch };
        let inside = inside::of_scene(scene, assets, &scene_box, least_ramp_mm)?.map_or_else(Vec::new, |i| i.maps.clone());
        let (stack, cuts) = deformations::stack(&scene.deformation, &making, inside, Vec::new())?;
        Ok(Self { stack, cuts, composition: None, proxy_mesh: None })
    }

    /// Where a point of the source is seen in the deformed scene, mm; none if it is cut away or no such point is found.
    pub fn forward(&self, source: Vec3) -> Option<Vec3> {
        let y = source.as_dvec3();
        let backward = |p: DVec3| self.stack.walk_through(p.as_vec3()).0.as_dvec3();
        let solution = crate::deform::invert::point(&backward, y, y + (y - backward(y)), 0.05, 5e-3);
        let deformed = solution.source.as_vec3();
        (solution.found && self.stack.walk(deformed).1 >= 0.5 && self.cuts.kept(deformed) >= 0.0).then_some(deformed)
    }
}

/// Distance from a cut beyond which it changes nothing about a sample, mm; `slant` is how many times its step a sample's path may be.
fn cut_margin_mm(blend_mm: [f32; 2], step_mm: f32, slant: f32) -> f32 {
    blend_mm[1] + 2.2 * step_mm * slant
}

/// Distances from a cut at which its normal stops to rule alone, and to matter at all, mm.
fn blend_mm(step: f32, reference_mm: f32) -> [f32; 2] {
    let sample_mm = (step * reference_mm).max(reference_mm);
    [sample_mm, BLEND_SAMPLES * sample_mm]
}

/// A scene resolved against its assets.
pub struct Prepared<'a> {
    /// What is sampled.
    pub grid: &'a Grid,
    /// The same with what is derived from it.
    shown: &'a Sampled,
    /// The voxels' own colours, which take the place of the table's.
    pub colors: Option<&'a Colors>,
    /// Baked transfer function.
    pub table: Table,
    /// How samples blend.
    pub blend: Blend,
    /// The deformation.
    pub stack: Stack,
    /// Cuts that come after every map.
    pub cuts: Cuts,
    /// Normalised value of the surface that is shown instead of the volume, if one is.
    pub iso: Option<f32>,
    /// Normalised values that are black and white on grey faces of cuts.
    pub grey_window: [f32; 2],
    /// Surfaces that are shown with the volume, or alone.
    pub surfaces: Surfaces,
    /// The mesh that slices are cut from instead of a box.
    pub proxy_mesh: Option<Arc<Mesh>>,
    /// What composing maps into one has cost in exactness, if any were.
    pub composition: Option<Composition>,
    /// Constants.
    pub frame: Frame,
    /// Light.
    pub light: Light,
    /// Settings as the scene has them.
    pub settings: RenderSettings,
    /// Whether there is a volume, or an empty one stands in its place.
    pub(super) has_volume: bool,
    /// The volume's lowest and highest value, data units.
    pub(super) value_range: [f64; 2],
    /// No voxel is a finite number.
    pub(super) no_values: bool,
    /// The factor on the opacities, if the scene states one.
    pub(super) density: Option<f64>,
    /// Empty space.
    pub macrocells: Arc<Macrocells>,
    /// What a user should know of how it was resolved, one sentence each.
    pub notices: Vec<String>,
    /// Time that preparing took.
    pub stages: Stages,
}

impl<'a> Prepared<'a> {
    /// Resolves a scene.
    ///
    /// # Errors
    /// Any setting that cannot be used, by name.
    pub fn new(scene: &Scene, assets: &'a Assets) -> Result<Self> {
        Self::with_maps(scene, assets, Vec::new())
    }

    /// As [`Self::new`] by a device that takes over what it does well.
    ///
    /// # Errors
    /// As [`Self::new`]; whatever the device reports.
    pub fn on(device: &dyn Accelerator, scene: &Scene, assets: &'a Assets) -> Result<Self> {
        Self::with(scene, assets, Vec::new(), device, &Watch::NOBODY)
    }

    /// As [`Self::on`], telling how far the work is, until it is told to stop.
    ///
    /// # Errors
    /// As [`Self::on`]; [`Error::Cancelled`].
    pub fn until(device: &dyn Accelerator, scene: &Scene, assets: &'a Assets, watch: &Watch) -> Result<Self> {
        Self::with(scene, assets, Vec::new(), device, watch)
    }

    /// Resolves a scene and applies further maps, made by other means than a kind, after its own.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_maps(scene: &Scene, assets: &'a Assets, more: Vec<PlacedMap>) -> Result<Self> {
        Self::with(scene, assets, more, &Unaided, &Watch::NOBODY)
    }

    fn with(scene: &Scene, assets: &'a Assets, more: Vec<PlacedMap>, device: &dyn Accelerator, watch: &Watch) -> Result<Self> {
        let mut stages = Stages::default();
        let settings = scene.render.clone();
        scene.check_limits()?;
        check_settings(&settings, &scene.light)?;
        let volume = &assets.volume;
        let fallback = scene
            .volume_name()
            .strip_prefix("phantom:")
            .and_then(phantom::preset)
            .unwrap_or_else(|| if scene.transfer.preset.is_none() && scene.transfer.points.is_empty() { default_preset(volume) } else { "grey" });
        let (shown, colors, function, table) = stages.time("transfer", || -> Result<_> {
            let transfer = &scene.transfer;
            let function = transfer.resolve(volume, fallback)?;
            // Labels in their colours, unless a curve over the labels themselves is wanted.
            let plain = transfer.points.is_empty() && transfer.window.is_none() && transfer.level.is_none() && function.blend == Blend::Composite;
            let by_label =
                plain && transfer.preset.as_deref().unwrap_or(fallback) == "labels" && settings.iso.is_none() && settings.cut_faces == CutFaces::Lit;
            if let Some(labels) = by_label.then(|| assets.as_labels()).flatten() {
                let function = function.of_presence();
                let table = Table::new(&function, [0.0, 1.0]);
                return Ok((labels, labels.grid.colors.as_ref(), function, table));
            }
            let table = Table::new(&function, volume.range);
            let own = transfer.own_colors.unwrap_or(transfer.preset.as_deref().is_none_or(|p| p == OWN_COLORS));
            Ok((&*assets.plain, assets.plain.grid.colors.as_ref().filter(|_| own), function, table))
        })?;
        let scene_box = assets.scene_box();
        let mut view = scene.camera.frame(&scene_box, settings.size)?;
        let reference_mm = volume.spacing_mm().min_element() as f32;
        let step_mm = settings.step * reference_mm;
        let blend_mm = blend_mm(settings.step, reference_mm);
        let Deformed { stack, cuts, composition, proxy_mesh } = stages.time("maps", || -> Result<_> {
            let deformed = Deformed::with(scene, assets, &view, more, device, watch)?;
            if device.wants_texels() {
                deformed.stack.fetch_texels();
            }
            Ok(deformed)
        })?;
        let span = (volume.range[1] - volume.range[0]).max(f64::MIN_POSITIVE);
        let normalised = |v: f64| ((v - volume.range[0]) / span) as f32;
        let iso = settings.iso.map(normalised);
        let grey_window = volume.window(scene.transfer.window, scene.transfer.level).map(normalised);
        let grid_size = Vec3::from(shown.grid.size.map(|n| n as f32));
        let voxel_from_world = to_f32(&volume.world_from_voxel.inverse());
        if !voxel_from_world.is_finite() {
            return Err(Error::value("volume", "its voxel axes are singular; the file's geometry cannot be used"));
        }
        let deformed = stack.deformed_bounds(&scene_box);
        view.step_back_from(&deformed, step_mm);
        let surfaces = stages.time("surfaces", || assets.surfaces(scene, &stack, &cuts))?;
        let deformed = stack.deformed_bounds(&volume.bounds_in_world());
        let macrocells = stages.time("macrocells", || {
            if settings.mode == Mode::Surface || !assets.has_volume {
                return Ok(Macrocells::solid(Bounds::EMPTY).into());
            }
            if !settings.empty_space_skipping {
                return Ok(Macrocells::solid(deformed).into());
            }
            let slant = scene.camera.slant(settings.size);
            let step_back_mm = 1.01 * step_mm * slant;
            let grey_faces = settings.cut_faces == CutFaces::Grey;
            let contents = Contents {
                stack: &stack,
                cuts: &cuts,
                iso,
                grey_faces,
                looks_back_mm: if iso.is_some() || grey_faces || settings.preintegrated { step_back_mm } else { 0.0 },
                beside_cuts_mm: step_back_mm,
                cut_margin_mm: cut_margin_mm(blend_mm, step_mm, slant),
                voxel_from_world: &voxel_from_world,
                voxel_box: Bounds::new(Vec3::splat(-0.5), grid_size - 0.5),
                pyramid: &shown.bounds,
                table: &table,
                blend: function.blend,
            };
            // What looks back a step may lie beyond the box of the scene itself.
            shown.macrocells(deformed.grown(contents.reach_mm()), reference_mm, &contents, device)
        })?;
        let light = scene.light.clone();
        let d = Vec3::from(light.direction);
        let to_light = if light.follows_camera {
            normalize_or(view.right, Vec3::X) * d.x + normalize_or(view.up, Vec3::Z) * d.y - view.forward * d.z
        } else {
            d
        };
        let frame = Frame {
            view,
            size: settings.size.map(|n| n * settings.antialias),
            step_mm,
            reference_mm,
            voxel_from_world,
            grid_size,
            proxy: macrocells.occupied,
            to_light: normalize_or(to_light, -view.forward),
            blend_mm,
        };
        Ok(Self {
            grid: &shown.grid,
            shown,
            colors,
            table,
            blend: function.blend,
            stack,
            cuts,
            iso,
            grey_window,
            composition,
            surfaces,
            proxy_mesh,
            frame,
            light,
            settings,
            has_volume: assets.has_volume,
            value_range: volume.range,
            no_values: volume.non_finite == volume.voxels.len(),
            density: scene.transfer.density,
            notices: composition.and_then(|c| c.notice()).into_iter().collect(),
            macrocells,
            stages,
        })
    }

    /// Whether samples are lit.
    pub fn is_lit(&self) -> bool {
        self.settings.normals != Normals::None && self.blend == Blend::Composite
    }

    /// Whether the faces of cuts are painted with the scan's grey value.
    pub fn grey_faces(&self) -> bool {
        self.settings.cut_faces == CutFaces::Grey && self.blend == Blend::Composite && (!self.cuts.is_empty() || !self.stack.is_empty())
    }

    /// Whether colour and opacity are those of segments between samples.
    pub fn preintegrated(&self) -> bool {
        self.settings.preintegrated && self.blend == Blend::Composite && self.iso.is_none()
    }

    /// Whether the gradient is needed before the opacity.
    pub fn uses_gradient_opacity(&self) -> bool {
        !self.table.gradient.is_empty() && self.blend == Blend::Composite
    }

    /// Distance from a cut beyond which it changes nothing about a sample, mm.
    pub fn cut_margin_mm(&self) -> f32 {
        // Slices are met at a slant: their step along a ray is longer than their distance.
        let slant = match self.settings.mode {
            Mode::Slice => self.frame.view.longest_slant(),
            _ => 1.0,
        };
        cut_margin_mm(self.frame.blend_mm, self.frame.step_mm, slant)
    }

    /// The same for the volume's faces, in voxels along each axis.
    pub fn voxels_beside_faces(&self) -> Vec3 {
        let world_from_covector = glam::Mat3::from(self.frame.voxel_from_world.matrix3).transpose();
        Vec3::from([0, 1, 2].map(|a| self.cut_margin_mm() * (world_from_covector * Vec3::AXES[a]).length()))
    }

    /// The same wherever the deformation has brought the faces.
    pub fn voxels_beside_deformed_faces(&self) -> Vec3 {
        self.voxels_beside_faces() * self.stack.steepest()
    }

    /// The gradients of all voxels, if they are wanted and kept.
    pub fn gradients(&self) -> Option<&'a GradientVolume> {
        let wanted = (self.is_lit() || self.uses_gradient_opacity()) && self.gradient_filter() == GradientFilter::Central;
        wanted.then(|| self.shown.gradients()).flatten()
    }

    /// The gradients of all voxels, if they have been made.
    pub fn kept_gradients(&self) -> Option<&'a GradientVolume> {
        self.shown.kept_gradients()
    }

    /// Makes the gradients of all voxels now, if they are wanted, rather than for the second picture.
    pub fn keep_gradients(&self) {
        // Asked twice, they are.
        self.gradients();
        self.gradients();
    }

    /// The gradient filter.
    pub fn gradient_filter(&self) -> GradientFilter {
        self.settings.gradient
    }
}

/// Checks the size of a picture, alone and with its antialiasing, and the memory that it takes.
fn check_size(settings: &RenderSettings) -> Result<()> {
    let [width, height] = settings.size;
    if !settings.size.iter().all(|n| (1..=MAX_PICTURE_EDGE).contains(n)) {
        let problem = format!("a picture of {width} x {height} pixels cannot be made; each edge is 1 to {MAX_PICTURE_EDGE}");
        return Err(Error::value("size", problem));
    }
    let n = settings.antialias;
    if !(1..=4).contains(&n) {
        return Err(Error::value("antialias", format!("{n} is outside 1 to 4")));
    }
    let samples = u64::from(width) * u64::from(height) * u64::from(n * n);
    if width.max(height) * n > MAX_PICTURE_EDGE || samples > MAX_PIXELS {
        let problem = format!(
            "{width} x {height} with antialias {n} needs {} x {} samples, which is too many ({MAX_PICTURE_EDGE} along an edge and {MAX_PIXELS} in all are possible); reduce size or antialias",
            width * n,
            height * n
        );
        return Err(Error::value("size", problem));
    }
    // Pixels as they are computed, and as bytes before and after they are packed.
    let bytes = 16 * samples + 12 * u64::from(width) * u64::from(height);
    match memory::available_bytes() {
        Some(available) if bytes > available => {
            let mib = |b: u64| b >> 20;
            Err(Error::value(
                "size",
                format!(
                    "{width} x {height} needs {} MiB of memory, but only {} MiB are available; make the picture smaller",
                    mib(bytes),
                    mib(available)
                ),
            ))
        }
        _ => Ok(()),
    }
}

/// Bounds on the error of a map that stands for several, mm.
const PRECOMPOSE_MM: std::ops::RangeInclusive<f32> = 0.001..=100.0;

fn check_settings(settings: &RenderSettings, light: &Light) -> Result<()> {
    check_size(settings)?;
    if !(settings.step.is_finite() && (0.01..=100.0).contains(&settings.step)) {
        return Err(Error::value("step", format!("{} is outside 0.01 to 100 voxels", settings.step)));
    }
    if settings.iso.is_some_and(|v| !v.is_finite()) {
        return Err(Error::value("iso", "must be a finite value"));
    }
    if settings.precompose.is_some_and(|mm| !PRECOMPOSE_MM.contains(&mm)) {
        let [least, most] = [PRECOMPOSE_MM.start(), PRECOMPOSE_MM.end()];
        return Err(Error::value("precompose", format!("is an error bound in mm, from {least} to {most}")));
    }
    if !settings.background.iter().all(|c| (0.0..=1.0).contains(c)) {
        return Err(Error::value("background", "its components must lie within 0..1"));
    }
    let unit = [("ambient", light.ambient), ("diffuse", light.diffuse), ("specular", light.specular)];
    for (name, value) in unit {
        if !(0.0..=1.0).contains(&value) {
            return Err(Error::value(format!("light.{name}"), format!("{value} is outside 0 to 1")));
        }
    }
    if !(1.0..=10_000.0).contains(&light.shininess) {
        return Err(Error::value("light.shininess", format!("{} is outside 1 to 10000", light.shininess)));
    }
    let direction = DVec3::from(light.direction.map(f64::from));
    if !(direction.is_finite() && direction.length() > 1e-6) {
        return Err(Error::value("light.direction", "must be a direction: finite and not zero"));
    }
    Ok(())
}

/// A picture: premultiplied RGBA without background, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Premultiplied red, green, blue, alpha.
    pub pixels: Vec<[f32; 4]>,
}

/// Counts that a renderer keeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderStats {
    /// Samples for which the deformation and the volume were looked up.
    pub samples_taken: u64,
    /// Samples inside the box of what can be seen left out because their cell is empty.
    pub samples_skipped: u64,
    /// Samples left out because nothing behind an opaque ray can be seen.
    pub samples_terminated: u64,
}

/// A picture with what it cost.
pub struct Rendered {
    /// The picture.
    pub picture: Picture,
    /// Counts; a GPU keeps them only when asked.
    pub stats: Option<RenderStats>,
    /// Time by stage.
    pub stages: Stages,
    /// What a user should be told, one sentence each.
    pub notices: Vec<String>,
    /// Why nothing is to be seen, if nothing is; one of the notices.
    pub blank: Option<String>,
}

impl Picture {
    /// The picture with blocks of n by n pixels averaged.
    pub fn reduced(self, n: u32) -> Self {
        if n <= 1 {
            return self;
        }
        let (width, height, row) = (self.width / n, self.height / n, self.width as usize);
        let average = |index: u32| -> [f32; 4] {
            let (x, y) = ((index % width * n) as usize, (index / width * n) as usize);
            let all = (0..n as usize).flat_map(|j| &self.pixels[(y + j) * row + x..][..n as usize]);
            all.fold([0.0; 4], |sum: [f32; 4], p| std::array::from_fn(|c| sum[c] + p[c] / (n * n) as f32))
        };
        Self { width, height, pixels: (0..width * height).map(average).collect() }
    }

    /// The picture over a background (red, green, blue, alpha, not premultiplied), as 8-bit RGBA, not premultiplied.
    pub fn over(&self, background: [f32; 4]) -> Vec<u8> {
        let [r, g, b, back_alpha] = background;
        let behind = [r * back_alpha, g * back_alpha, b * back_alpha, back_alpha];
        let mut bytes = vec![[0; 4]; self.pixels.len()];
        bytes.par_chunks_mut(1 << 14).zip(self.pixels.par_chunks(1 << 14)).for_each(|(bytes, pixels)| with_simd(Over { behind, pixels, bytes }));
        bytes.into_flattened()
    }
}

/// Pixels over what is behind them, premultiplied both, as bytes that are not.
struct Over<'a> {
    behind: [f32; 4],
    pixels: &'a [[f32; 4]],
    bytes: &'a mut [[u8; 4]],
}

impl OverSimd for Over<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let behind = f32x4::load_array(simd, self.behind);
        for (byte, pixel) in self.bytes.iter_mut().zip(self.pixels) {
            let all = behind * (1.0 - pixel[3]) + f32x4::load_array(simd, *pixel);
            let alpha = all[3].max(1e-6);
            let share = (all / f32x4::load_array(simd, [alpha, alpha, alpha, 1.0])).max(0.0).min(1.0);
            let [r, g, b, a] = (share * 255.0 + 0.5).to_int::<i32x4<S>>().to_array();
            *byte = [r as u8, g as u8, b as u8, a as u8];
        }
    }
}
