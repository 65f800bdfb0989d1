//! The files of a scene, loaded once and shared by any number of pictures.

use super::inside::InsideCache;
use super::light_volume::LightVolumeCache;
use super::object_cache::ObjectCache;
use super::sampled::SampledVolume;
use crate::deform::Library;
use crate::math::Bounds;
use crate::picture::StageTimes;
use crate::scene::surface::{Appearance, MeshSource};
use crate::scene::{Mode, Scene, VolumeFilter, VolumeSource};
use crate::volume::load::ReadOptions;
use crate::volume::{Volume, VoxelGrid, load};
use crate::{Error, Result, Watch};
use glam::Vec3;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

/// Options for loading assets; by default without progress, cancellation or reuse.
#[derive(Clone, Copy, Default)]
pub struct LoadOptions<'a> {
    /// Receives the current stage (reading, distances) and the completed fraction of it.
    pub progress: Option<&'a (dyn Fn(&'static str, f32) + Sync)>,
    /// Loading stops with [`Error::Cancelled`] once this is set.
    pub cancel: Option<&'a AtomicBool>,
    /// Assets of another scene: their volume is reused if it comes from the same file with the same
    /// options.
    pub previous: Option<&'a Assets>,
}

/// The parts of a scene that require reloading when they change.
#[derive(Clone, Debug, PartialEq)]
pub struct AssetKey {
    volume: Option<VolumeSource>,
    meshes: Vec<MeshSource>,
    iso: Option<Option<f64>>,
    folder: PathBuf,
}

impl AssetKey {
    /// The key of a scene.
    pub fn of(scene: &Scene) -> Self {
        let mut meshes = scene.mesh.clone();
        for mesh in &mut meshes {
            // Its appearance requires no loading.
            mesh.appearance = Appearance::default();
            mesh.name = None;
            mesh.hidden = false;
        }
        Self {
            volume: scene.volume.clone(),
            meshes,
            iso: (scene.render.mode == Mode::Surface).then_some(scene.surface.iso),
            folder: scene.folder.clone(),
        }
    }
}

/// The files of a scene, loaded once and shared by any number of pictures.
pub struct Assets {
    /// The volume; an empty one if the scene has none.
    pub volume: Arc<Volume>,
    /// Its sampled form.
    sampled: Arc<SampledVolume>,
    /// The file and options from which the volume was loaded.
    source: Option<(PathBuf, ReadOptions)>,
    /// The separate label map of the scene, if it has one.
    pub separate_labels: Option<Arc<Volume>>,
    /// A label map as colours, voxel by voxel and with smooth boundaries, made when first shown.
    sampled_labels: [OnceLock<Option<SampledVolume>>; 2],
    /// Additional inputs of deformations.
    pub library: Arc<Library>,
    /// Meshes and distance fields.
    pub(super) objects: ObjectCache,
    /// Maps and proxies derived from the mesh that encloses the volume.
    pub(super) inside_meshes: InsideCache,
    pub(super) light_volumes: LightVolumeCache,
    /// Whether the scene has a volume; without one, `volume` is empty.
    pub has_volume: bool,
    /// The box around all meshes, mm; empty without any.
    pub mesh_box: Bounds,
    /// Loading times.
    pub stages: StageTimes,
}

impl Assets {
    /// Loads the files of a scene.
    ///
    /// # Errors
    /// Errors of the readers.
    pub fn load(scene: &Scene) -> Result<Self> {
        Self::load_with(scene, &LoadOptions::default())
    }

    /// As [`Self::load`], for a caller that may cancel, wants progress, or reuses loaded assets.
    ///
    /// # Errors
    /// As [`Self::load`]; [`Error::Cancelled`].
    pub fn load_with(scene: &Scene, options: &LoadOptions) -> Result<Self> {
        scene.check_limits()?;
        let never = AtomicBool::new(false);
        let cancel = options.cancel.unwrap_or(&never);
        let report = |stage, share| options.progress.map_or((), |progress| progress(stage, share));
        let source = scene
            .volume_path()
            .zip(scene.volume.as_ref().map(|v| v.choice.clone()));
        // The same file may be given relative to another folder.
        let place = |s: &Option<(PathBuf, ReadOptions)>| {
            s.as_ref()
                .map(|(path, choice)| (std::path::absolute(path).ok(), choice.clone()))
        };
        let same_volume = options
            .previous
            .filter(|b| b.has_volume && source.is_some() && place(&b.source) == place(&source));
        let mut assets = match (same_volume, &source) {
            (Some(previous), _) => Self::with_volume_of(previous, scene.folder.clone()),
            (None, Some((path, choice))) => {
                let reading = |share: f32| report("reading", share);
                let mut stages = StageTimes::default();
                let volume = stages.time("load", || {
                    load::volume(
                        path,
                        choice,
                        &Watch {
                            progress: &reading,
                            cancel,
                        },
                    )
                })?;
                Self::in_folder(volume, scene.folder.clone(), stages)
            }
            (None, None) => Self::without_volume(scene.folder.clone()),
        };
        assets.source = source;
        let mut stages = std::mem::take(&mut assets.stages);
        if let Some(path) = scene.volume.as_ref().and_then(|v| v.labels.as_ref()) {
            assets.separate_labels = Some(stages.time("labels", || assets.library.load_label_map(path))?);
        }
        if !scene.mesh.is_empty() || scene.render.mode == Mode::Surface {
            assets.mesh_box = stages.time("meshes", || {
                assets
                    .objects
                    .load(scene, &assets.library, &assets.volume, &|share| {
                        report("computing", share)
                    })
            })?;
        }
        if !assets.has_volume {
            let empty = Volume::empty_over(&assets.mesh_box);
            assets.sampled = Arc::new(SampledVolume::new(VoxelGrid::new(&empty)));
            assets.volume = Arc::new(empty);
        }
        assets.stages = stages;
        Ok(assets)
    }

    /// The assets of a scene that consists of a volume in memory.
    pub fn of_volume(volume: Volume) -> Self {
        Self::in_folder(volume, PathBuf::new(), StageTimes::default())
    }

    fn in_folder(volume: Volume, folder: PathBuf, mut stages: StageTimes) -> Self {
        let grid = stages.time("grid", || VoxelGrid::new(&volume));
        let sampled = Arc::new(stages.time("bricks", || SampledVolume::new(grid)));
        let volume = Arc::new(volume);
        let library = Arc::new(Library::new(volume.clone(), folder));
        Self {
            stages,
            ..Self::over(volume, sampled, library, true)
        }
    }

    /// Assets of a scene without a volume: an empty one is sampled.
    fn without_volume(folder: PathBuf) -> Self {
        let volume = Volume::empty_over(&Bounds::UNIT);
        let sampled = Arc::new(SampledVolume::new(VoxelGrid::new(&volume)));
        Self::over(
            Arc::new(volume),
            sampled,
            Arc::new(Library::without_volume(folder)),
            false,
        )
    }

    /// The volume of other assets, with the inputs of its deformations if these are relative to the
    /// same folder.
    fn with_volume_of(previous: &Self, folder: PathBuf) -> Self {
        let same_folder = previous.library.folder() == folder;
        let library = if same_folder {
            previous.library.clone()
        } else {
            Arc::new(Library::new(previous.volume.clone(), folder))
        };
        Self::over(previous.volume.clone(), previous.sampled.clone(), library, true)
    }

    fn over(
        volume: Arc<Volume>,
        sampled: Arc<SampledVolume>,
        library: Arc<Library>,
        has_volume: bool,
    ) -> Self {
        Self {
            volume,
            sampled,
            source: None,
            separate_labels: None,
            sampled_labels: [OnceLock::new(), OnceLock::new()],
            library,
            objects: ObjectCache::default(),
            inside_meshes: InsideCache::default(),
            light_volumes: LightVolumeCache::default(),
            has_volume,
            mesh_box: Bounds::EMPTY,
            stages: StageTimes::default(),
        }
    }

    /// The box around the volume and all meshes, mm.
    pub fn scene_box(&self) -> Bounds {
        if self.has_volume {
            return self.volume.bounds_in_world().union(&self.mesh_box);
        }
        // A flat mesh also needs a box with a volume.
        let size = self.mesh_box.size();
        let more = (Vec3::splat(0.01 * size.max_element()) - size).max(Vec3::ZERO) * 0.5;
        Bounds::new(self.mesh_box.min - more, self.mesh_box.max + more)
    }

    /// The label map: the scene's separate one, or the volume itself if it is one.
    ///
    /// # Errors
    /// [`Error::Value`] if there is neither.
    pub fn label_map(&self) -> Result<&Arc<Volume>> {
        match &self.separate_labels {
            Some(map) => Ok(map),
            None if self.has_volume && self.volume.labels().is_some() => Ok(&self.volume),
            None => Err(Error::value(
                "volume.labels",
                "there is no label map; set volume.labels, or add one in the workstation",
            )),
        }
    }

    /// The volume's voxels in their sampled form.
    pub fn grid(&self) -> &VoxelGrid {
        &self.sampled.grid
    }

    /// The volume's voxels with the data derived from them.
    pub(super) fn sampled(&self) -> &SampledVolume {
        &self.sampled
    }

    /// The grid of a label map shown as colours, with smooth boundaries if it is interpolated by
    /// splines; none if the volume is not a label map.
    pub(super) fn sampled_labels(&self, filter: VolumeFilter) -> Option<&SampledVolume> {
        let smooth = filter == VolumeFilter::Cubic;
        self.sampled_labels[usize::from(smooth)]
            .get_or_init(|| VoxelGrid::of_labels(&self.volume, smooth).map(SampledVolume::new))
            .as_ref()
    }
}
