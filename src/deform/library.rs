//! What deformations read besides their numbers: the scene's volume, label maps, distance fields, fields from files. Each is loaded once
//! and kept as long as the scene's assets are.

use super::compose::PrecomposeError;
use super::distance::{RegionSource, of_region};
use super::transform::{Transform, TransformContext};
use super::{Arguments, DisplacementMap, PrecomposedMap, Stack};
use crate::files::path_text::path_of;
use crate::math::{Bounds, DistanceGrid};
use crate::volume::load::{self, ReadOptions};
use crate::volume::{GridGeometry, Volume};
use crate::{Error, Result, Watch};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Loaded things by name.
#[derive(Default)]
pub struct Library {
    volume: Option<Arc<Volume>>,
    folder: PathBuf,
    volumes: Mutex<HashMap<PathBuf, Arc<Volume>>>,
    label_maps: Mutex<HashMap<PathBuf, Arc<Volume>>>,
    distances: Mutex<HashMap<String, Arc<DistanceGrid>>>,
    transforms: Mutex<HashMap<String, Arc<Transform>>>,
    /// The map that stands for the last stack that was composed.
    precomposed: Mutex<Option<(PrecomposedKey, Precomposition)>>,
    /// Sampled maps by what they were made of, the most recently used last.
    maps: Mutex<Vec<(String, Arc<DisplacementMap>)>>,
    notices: Mutex<Vec<String>>,
}

/// What a precomposed map is made for: the stack, the scene's box, the bound.
type PrecomposedKey = (Stack, Bounds, f32);

/// A precomposed map, if there is one, and how exact it is.
type Precomposition = (Option<PrecomposedMap>, PrecomposeError);

/// Sampled maps that are kept at most, and their bytes.
const MAX_CACHED_MAPS: usize = 32;
const MAX_CACHED_MAP_BYTES: usize = 160 << 20;

fn lock<T>(m: &Mutex<T>) -> MutexGuard<'_, T> {
    // Entries are only ever added whole; a panic elsewhere leaves them good.
    m.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Library {
    /// The library of a scene that shows `volume`; relative paths start from `folder`.
    pub fn new(volume: Arc<Volume>, folder: PathBuf) -> Self {
        Self { volume: Some(volume), folder, ..Self::default() }
    }

    /// The library of a scene without a volume.
    pub fn without_volume(folder: PathBuf) -> Self {
        Self { folder, ..Self::default() }
    }

    /// The folder that relative paths start from.
    pub fn folder(&self) -> &std::path::Path {
        &self.folder
    }

    /// The scene's volume.
    ///
    /// # Errors
    /// There is none.
    pub fn volume(&self) -> Result<&Arc<Volume>> {
        self.volume.as_ref().ok_or_else(|| Error::value("volume", "this deformation follows a volume, and there is none"))
    }

    /// Notes what a user should be told, once.
    pub fn notice(&self, text: String) {
        let mut notices = lock(&self.notices);
        if !notices.contains(&text) {
            notices.push(text);
        }
    }

    /// What was noted so far.
    pub fn notices(&self) -> Vec<String> {
        lock(&self.notices).clone()
    }

    /// A path as this process finds it.
    pub fn path(&self, path: &str) -> PathBuf {
        if path.starts_with("phantom:") { PathBuf::from(path) } else { self.folder.join(path_of(path)) }
    }

    /// A volume by path.
    ///
    /// # Errors
    /// What the readers report.
    pub fn load_volume(&self, path: &str) -> Result<Arc<Volume>> {
        let path = self.path(path);
        if let Some(volume) = lock(&self.volumes).get(&path) {
            return Ok(volume.clone());
        }
        let volume = Arc::new(load::volume(&path, &ReadOptions::default(), &Watch::NONE)?);
        lock(&self.volumes).insert(path, volume.clone());
        Ok(volume)
    }

    /// A label map by path: whatever the volume there looks like, it is said to be one.
    ///
    /// # Errors
    /// What the readers report; values that are no labels.
    pub fn load_label_map(&self, path: &str) -> Result<Arc<Volume>> {
        let path = self.path(path);
        if let Some(map) = lock(&self.label_maps).get(&path) {
            return Ok(map.clone());
        }
        let volume = load::volume(&path, &ReadOptions::default(), &Watch::NONE)?;
        let map = Arc::new(volume.into_label_map().map_err(|problem| Error::file(&path, problem))?);
        self.note_distance("the label map", &path, &map);
        lock(&self.label_maps).insert(path, map.clone());
        Ok(map)
    }

    /// Notes that what should lie over the volume lies beside it: it will do nothing.
    pub(crate) fn note_distance(&self, what: &str, path: &Path, other: &Volume) {
        let Some(volume) = &self.volume else { return };
        let (own, other) = (volume.bounds_in_world(), other.bounds_in_world());
        let gap = (other.min - own.max).max(own.min - other.max).max(glam::Vec3::ZERO).length();
        if gap > 0.0 {
            let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
            self.notice(format!(
                "{what} {name} lies {gap:.0} mm outside the volume and has no effect; check that both belong to the same patient and frame of reference"
            ));
        }
    }

    /// The transform that the settings name: `path` (one file, or several that are gone through in order from the deformed to the source
    /// point), `moving` and `reference` (images that FSL's files need; by default the scene's volume for matrices), `convention`.
    ///
    /// # Errors
    /// What the readers report; no path.
    pub fn transform(&self, settings: &Arguments) -> Result<Arc<Transform>> {
        let paths = settings.texts("path")?.ok_or_else(|| Error::value("path", "is missing; name a file"))?;
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
        for path in paths {
            let path = self.path(&path);
            let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
            let matrix = !matches!(ending.as_str(), "gz" | "nii" | "nrrd" | "nhdr" | "mha" | "mhd");
            let context = if matrix {
                TransformContext { moving: moving.or(own), reference: reference.or(own), convention: None }
            } else {
                TransformContext { moving, reference, convention: settings.text("convention")? }
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

    /// The volume that holds the labels: the file that the setting `labels` names, or the scene's volume.
    ///
    /// # Errors
    /// What the readers report; a setting of the wrong form.
    pub fn labels(&self, settings: &Arguments) -> Result<Arc<Volume>> {
        match settings.text("labels")? {
            Some(path) => self.load_label_map(path),
            None => self.volume().cloned(),
        }
    }

    /// The distance field of the labels that a setting names.
    ///
    /// # Errors
    /// No voxel has any of the labels (the ones that exist are named).
    pub fn label_distance(&self, settings: &Arguments, setting: &str, wanted: &[usize]) -> Result<Arc<DistanceGrid>> {
        let volume = self.labels(settings)?;
        let file = settings.text("labels")?;
        let key = format!("{file:?} {wanted:?}");
        let whose = if file.is_some() { "the label map" } else { "the volume (used as the label map, since labels=FILE is not set)" };
        self.distance(key, || {
            of_region(&volume, &RegionSource::Labels(wanted), true)
                .ok_or_else(|| Error::value(setting, format!("{wanted:?}: no voxel has this label; {whose} contains {}", some_labels(&volume))))
        })
    }

    /// The distance field of the region that the settings name: `label` (of `labels`), `mask`, `iso`, or else the scan's body.
    ///
    /// # Errors
    /// A region without voxels, files that cannot be read, more than one way of naming the region.
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
                    of_region(&volume, &RegionSource::Mask, true)
                        .ok_or_else(|| Error::value("mask", format!("{path} has no surface: it is all inside or all outside")))
                })
            }
            (None, None, iso) => {
                let volume = self.volume()?;
                let iso = iso.map_or_else(|| volume.body_threshold(), f64::from);
                self.distance(format!("iso {iso}"), || {
                    of_region(volume, &RegionSource::Body(iso), true).ok_or_else(|| {
                        let [low, high] = volume.range;
                        Error::value("iso", format!("the volume has no surface at {iso}; its values range from {low} to {high}"))
                    })
                })
            }
            _ => Err(Error::value("label, mask, iso", "give only one of them")),
        }
    }

    /// The map made of what `key` says; made anew unless it is among the last ones used. (A live view asks for the same maps at every
    /// turn of its camera.)
    ///
    /// # Errors
    /// Those of making it.
    pub fn map(&self, key: String, make: impl FnOnce() -> Result<Arc<DisplacementMap>>) -> Result<Arc<DisplacementMap>> {
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
        let bytes = |map: &DisplacementMap| map.size.iter().product::<usize>() * 16;
        let mut all: usize = cached.iter().map(|(_, map)| bytes(map)).sum();
        while cached.len() > 1 && (all > MAX_CACHED_MAP_BYTES || cached.len() > MAX_CACHED_MAPS) {
            all -= bytes(&cached.remove(0).1);
        }
        Ok(made)
    }

    /// The map that stands for a stack; made anew unless it is the last one that was.
    ///
    /// # Errors
    /// Those of making it.
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

    fn distance(&self, key: String, make: impl FnOnce() -> Result<DistanceGrid>) -> Result<Arc<DistanceGrid>> {
        if let Some(field) = lock(&self.distances).get(&key) {
            return Ok(field.clone());
        }
        let field = Arc::new(make()?);
        lock(&self.distances).insert(key, field.clone());
        Ok(field)
    }
}

/// The labels of a map in words, not too many.
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
