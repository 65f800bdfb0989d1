//! Non-numeric inputs of deformations: the scene's volume, label maps, distance fields, fields from
//! files. Each is loaded once and cached as long as the scene's assets exist.

use super::compose::PrecomposeError;
use super::distance::{RegionSource, of_region};
use super::transform::{Transform, TransformContext};
use super::{Arguments, DisplacementMap, PrecomposedMap, Stack};
use crate::files::path_text::path_of;
use crate::math::{Bounds, DistanceGrid};
use crate::volume::load::{self, ReadOptions};
use crate::volume::phantom::is_procedural;
use crate::volume::{GridGeometry, Volume};
use crate::{Error, Result, Watch};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Loaded inputs by name.
#[derive(Default)]
pub struct Library {
    volume: Option<Arc<Volume>>,
    folder: PathBuf,
    volumes: Mutex<HashMap<PathBuf, Arc<Volume>>>,
    label_maps: Mutex<HashMap<PathBuf, Arc<Volume>>>,
    distances: Mutex<HashMap<String, Arc<DistanceGrid>>>,
    transforms: Mutex<HashMap<String, Arc<Transform>>>,
    /// The precomposed map of the last composed stack.
    precomposed: Mutex<Option<(PrecomposedKey, Precomposition)>>,
    /// Sampled maps by key, the most recently used last.
    maps: Mutex<Vec<(String, Arc<DisplacementMap>)>>,
    notices: Mutex<Vec<String>>,
}

/// The key of a precomposed map: the stack, the scene's box, the bound.
type PrecomposedKey = (Stack, Bounds, f32);

/// A precomposed map, if there is one, and its accuracy.
type Precomposition = (Option<PrecomposedMap>, PrecomposeError);

/// Maximum number of cached sampled maps, and of their bytes.
const MAX_CACHED_MAPS: usize = 32;
const MAX_CACHED_MAP_BYTES: usize = 160 << 20;

fn lock<T>(m: &Mutex<T>) -> MutexGuard<'_, T> {
    // Entries are only added as a whole; a panic elsewhere leaves them valid.
    m.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Library {
    /// The library of a scene that shows `volume`; relative paths start at `folder`.
    pub fn new(volume: Arc<Volume>, folder: PathBuf) -> Self {
        Self {
            volume: Some(volume),
            folder,
            ..Self::default()
        }
    }

    /// The library of a scene without a volume.
    pub fn without_volume(folder: PathBuf) -> Self {
        Self {
            folder,
            ..Self::default()
        }
    }

    /// The folder at which relative paths start.
    pub fn folder(&self) -> &std::path::Path {
        &self.folder
    }

    /// The scene's volume.
    ///
    /// # Errors
    /// The scene has none.
    pub fn volume(&self) -> Result<&Arc<Volume>> {
        self.volume
            .as_ref()
            .ok_or_else(|| Error::value("volume", "this deformation follows a volume, and there is none"))
    }

    /// Records a notice for the user, once.
    pub fn notice(&self, text: String) {
        let mut notices = lock(&self.notices);
        if !notices.contains(&text) {
            notices.push(text);
        }
    }

    /// The notices recorded so far.
    pub fn notices(&self) -> Vec<String> {
        lock(&self.notices).clone()
    }

    /// A path resolved for this process.
    pub fn path(&self, path: &str) -> PathBuf {
        if is_procedural(path) {
            PathBuf::from(path)
        } else {
            self.folder.join(path_of(path))
        }
    }

    /// A volume by path.
    ///
    /// # Errors
    /// Errors of the readers.
    pub fn load_volume(&self, path: &str) -> Result<Arc<Volume>> {
        let path = self.path(path);
        if let Some(volume) = lock(&self.volumes).get(&path) {
            return Ok(volume.clone());
        }
        let volume = Arc::new(load::volume(&path, &ReadOptions::default(), &Watch::NONE)?);
        lock(&self.volumes).insert(path, volume.clone());
        Ok(volume)
    }

    /// A label map by path; the volume is treated as one whatever its type.
    ///
    /// # Errors
    /// Errors of the readers; values that are not labels.
    pub fn load_label_map(&self, path: &str) -> Result<Arc<Volume>> {
        let path = self.path(path);
        if let Some(map) = lock(&self.label_maps).get(&path) {
            return Ok(map.clone());
        }
        let volume = load::volume(&path, &ReadOptions::default(), &Watch::NONE)?;
        let map = Arc::new(
            volume
                .into_label_map()
                .map_err(|problem| Error::file(&path, problem))?,
        );
        self.note_distance("the label map", &path, &map);
        lock(&self.label_maps).insert(path, map.clone());
        Ok(map)
    }

    /// Records a notice if a file that should overlap the volume does not: it has no effect.
    pub(crate) fn note_distance(&self, what: &str, path: &Path, other: &Volume) {
        let Some(volume) = &self.volume else { return };
        let (own, other) = (volume.bounds_in_world(), other.bounds_in_world());
        let gap = (other.min - own.max)
            .max(own.min - other.max)
            .max(glam::Vec3::ZERO)
            .length();
        if gap > 0.0 {
            let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
            self.notice(format!(
                "{what} {name} lies {gap:.0} mm outside the volume and has no effect; check that both belong to the same patient and frame of reference"
            ));
        }
    }

    /// The transform named by the settings: `path` (one file, or several, passed in order from the
    /// deformed to the source point), `moving` and `reference` (images that FSL's files need; by
    /// default the scene's volume for matrices), `convention`.
    ///
    /// # Errors
    /// Errors of the readers; no path.
    pub fn transform(&self, settings: &Arguments) -> Result<Arc<Transform>> {
        let paths = settings
            .texts("path")?
            .ok_or_else(|| Error::value("path", "is missing; name a file"))?;
        let key = format!("{:?}", settings.0);
        if let Some(transform) = lock(&self.transforms).get(&key) {
            return Ok(transform.clone());
        }
        let grid_of = |name: &str| -> Result<Option<GridGeometry>> {
            Ok(match settings.text(name)? {
                Some(path) => Some(self.load_volume(path)?.geometry()),
                None => None,
            })
        };
        let (moving, reference) = (grid_of("moving")?, grid_of("reference")?);
        let own = self.volume.as_deref().map(Volume::geometry);
        let mut whole: Option<Transform> = None;
        let single = paths.len() == 1;
        for path in paths {
            let path = self.path(&path);
            let ending = path
                .extension()
                .map(|e| e.to_string_lossy().to_ascii_lowercase())
                .unwrap_or_default();
            let matrix = !matches!(ending.as_str(), "gz" | "nii" | "nrrd" | "nhdr" | "mha" | "mhd");
            let convention = settings.text("convention")?;
            let context = if matrix {
                TransformContext {
                    moving: moving.or(own),
                    reference: reference.or(own),
                    // In a chain the setting is about the vectors.
                    convention: convention.filter(|_| single),
                }
            } else {
                TransformContext {
                    moving,
                    reference,
                    convention,
                }
            };
            let one = Transform::load(&path, &context)?;
            whole = Some(match whole {
                Some(before) => before.then(one),
                None => one,
            });
        }
        let transform = Arc::new(whole.ok_or_else(|| Error::value("path", "is missing; name a file"))?);
        lock(&self.transforms).insert(key, transform.clone());
        Ok(transform)
    }

    /// The volume with the labels: the file named by the setting `labels`, or the scene's volume.
    ///
    /// # Errors
    /// Errors of the readers; a setting of the wrong type.
    pub fn labels(&self, settings: &Arguments) -> Result<Arc<Volume>> {
        match settings.text("labels")? {
            Some(path) => self.load_label_map(path),
            None => self.volume().cloned(),
        }
    }

    /// The distance field of the labels given by a setting.
    ///
    /// # Errors
    /// No voxel has any of the labels (the message names the existing ones).
    pub fn label_distance(
        &self,
        settings: &Arguments,
        setting: &str,
        wanted: &[usize],
    ) -> Result<Arc<DistanceGrid>> {
        let volume = self.labels(settings)?;
        let file = settings.text("labels")?;
        let key = format!("{file:?} {wanted:?}");
        let whose = if file.is_some() {
            "the label map"
        } else {
            "the volume (used as the label map, since labels=FILE is not set)"
        };
        self.distance(key, || {
            of_region(&volume, &RegionSource::Labels(wanted), true).ok_or_else(|| {
                Error::value(
                    setting,
                    format!(
                        "{wanted:?}: no voxel has this label; {whose} contains {}",
                        some_labels(&volume)
                    ),
                )
            })
        })
    }

    /// The distance field of the region given by the settings: `label` (of `labels`), `mask`,
    /// `iso`, or else the scan's body.
    ///
    /// # Errors
    /// A region without voxels, files that cannot be read, more than one way of giving the region.
    pub fn region(&self, settings: &Arguments) -> Result<Arc<DistanceGrid>> {
        let label = settings.whole("label")?;
        let mask = settings.text("mask")?;
        let iso = settings.number("iso")?;
        match (label, mask, iso) {
            (Some(label), None, None) => self.label_distance(settings, "label", &label),
            (None, Some(path), None) => {
                let volume = self.load_volume(path)?;
                self.note_distance("the mask", &self.path(path), &volume);
                self.distance(format!("mask {path}"), || {
                    of_region(&volume, &RegionSource::Mask, true).ok_or_else(|| {
                        Error::value(
                            "mask",
                            format!("{path} has no surface: it is all inside or all outside"),
                        )
                    })
                })
            }
            (None, None, iso) => {
                let volume = self.volume()?;
                let iso = iso.map_or_else(|| volume.body_threshold(), f64::from);
                self.distance(format!("iso {iso}"), || {
                    of_region(volume, &RegionSource::Body(iso), true).ok_or_else(|| {
                        let [low, high] = volume.range;
                        Error::value(
                            "iso",
                            format!(
                                "the volume has no surface at {iso}; its values range from {low} to {high}"
                            ),
                        )
                    })
                })
            }
            _ => Err(Error::value("label, mask, iso", "give only one of them")),
        }
    }

    /// The map for a key, made unless it is among those used most recently. (A live view requests
    /// the same maps for every frame.)
    ///
    /// # Errors
    /// Errors of making it.
    pub fn map(
        &self,
        key: String,
        make: impl FnOnce() -> Result<Arc<DisplacementMap>>,
    ) -> Result<Arc<DisplacementMap>> {
        {
            let mut cached = lock(&self.maps);
            if let Some(at) = cached.iter().position(|(k, _)| *k == key) {
                let entry = cached.remove(at);
                let map = entry.1.clone();
                cached.push(entry);
                return Ok(map);
            }
        }
        let made = make()?;
        let mut cached = lock(&self.maps);
        cached.push((key, made.clone()));
        // Four numbers for each texel, and three times as many for its slopes.
        let bytes = |map: &DisplacementMap| {
            map.size.iter().product::<usize>() * if map.has_slopes() { 64 } else { 16 }
        };
        let mut all: usize = cached.iter().map(|(_, map)| bytes(map)).sum();
        while cached.len() > 1 && (all > MAX_CACHED_MAP_BYTES || cached.len() > MAX_CACHED_MAPS) {
            all -= bytes(&cached.remove(0).1);
        }
        Ok(made)
    }

    /// The precomposed map of a stack, made unless it is the last one made.
    ///
    /// # Errors
    /// Errors of making it.
    pub fn precomposed(
        &self,
        stack: &Stack,
        scene_box: &Bounds,
        bound_mm: f32,
        make: impl FnOnce() -> Result<Precomposition>,
    ) -> Result<Precomposition> {
        let key = (stack.clone(), *scene_box, bound_mm);
        if let Some((_, cached)) = lock(&self.precomposed).as_ref().filter(|(k, _)| *k == key) {
            return Ok(cached.clone());
        }
        let made = make()?;
        *lock(&self.precomposed) = Some((key, made.clone()));
        Ok(made)
    }

    fn distance(
        &self,
        key: String,
        make: impl FnOnce() -> Result<DistanceGrid>,
    ) -> Result<Arc<DistanceGrid>> {
        if let Some(field) = lock(&self.distances).get(&key) {
            return Ok(field.clone());
        }
        let field = Arc::new(make()?);
        lock(&self.distances).insert(key, field.clone());
        Ok(field)
    }
}

/// A list of a map's labels as text, limited in length.
fn some_labels(volume: &Volume) -> String {
    let mut seen = std::collections::BTreeSet::new();
    for n in 0..volume.voxels.len() {
        let v = volume.voxels.get(n) * volume.rescale.slope + volume.rescale.intercept;
        if v > 0.0 && v.fract() == 0.0 && v <= f64::from(u32::MAX) {
            seen.insert(v as u32);
        }
    }
    let some: Vec<String> = seen.iter().take(12).map(u32::to_string).collect();
    match (seen.len(), seen.last()) {
        (0, _) | (_, None) => "none (it is not a label map)".into(),
        (n, Some(last)) if n > 12 => format!("{} ... {last}", some.join(", ")),
        _ => some.join(", "),
    }
}
