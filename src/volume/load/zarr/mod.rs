//! OME-Zarr 0.1 to 0.5, a folder or a zip of it: one resolution of a multiscale image, with its
//! channels in their colours, or labels with their names and colours. The axes may be stored in any
//! order. A Zarr array without metadata about its axes is read as (t, c, z, y, x), as many as it
//! has; names that it states itself (xarray, Zarr 3) are used.
//!
//! Source: the OME-NGFF specifications 0.1 to 0.5, "multiscales", "coordinateTransformations",
//! "omero", "image-label".

mod array;
mod axes;
mod store;

use super::image::{Channel, Image, Layout, Meaning};
use super::source::{count, reserved, with_scalar};
use super::{ReadOptions, StoredValues};
use crate::panic_guard::catch_panic;
use crate::volume::colors::Label;
use crate::{ByteProgress, Error, Result, Watch};
use array::{ArrayLayout, StoredType};
use axes::{AxisPositions, placement};
use glam::{DAffine3, DMat3, DVec3};
use half::f16;
use ndarray::Ix4;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use store::{Store, StoredArray};
use zarrs::array::{ArraySubset, FromArrayBytes};

/// Whether a folder is a Zarr group or array.
pub fn is_zarr(folder: &Path) -> bool {
    store::is_zarr(folder)
}

/// Whether a zip holds a Zarr store.
pub fn is_zipped(path: &Path) -> bool {
    catch_panic(|| store::is_zipped(path)).unwrap_or(false)
}

/// Attributes of a group, in either version of Zarr.
fn attributes(store: &Store, folder: &Path) -> Result<Value> {
    let three = store.json(&folder.join("zarr.json"))?;
    if !three.is_null() {
        let own = &three["attributes"];
        return Ok(if own["ome"].is_object() {
            own["ome"].clone()
        } else {
            own.clone()
        });
    }
    store.json(&folder.join(".zattrs"))
}

/// Reads an image.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let ended = || Error::file(path, "its chunks are damaged; copy it again");
    catch_panic(|| read_unguarded(path, choice, watch)).ok_or_else(ended)?
}

/// Reads an image; [`read`] turns a panic of the decoder into an error.
fn read_unguarded(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    let mut warnings = Vec::new();
    let group = ImageGroup::open(path, &mut warnings)?;
    let level = choice.level.unwrap_or(0);
    let array_folder = group.resolution_folder(path, level)?;
    let layout = ArrayLayout::of(&group.store, &array_folder)?;
    let rank = layout.shape.len();
    let names = layout.dimension_names.clone();
    let axes = AxisPositions::of(group.multiscale(), names, rank, &mut warnings).map_err(&fail)?;
    let (channels, times) = (layout.extent(axes.channel), layout.extent(axes.time));
    let time = choice.time_of(times)?;
    if times > 1 && choice.time.is_none() {
        warnings.push(format!(
            "holds {times} volumes; the first is used (--time chooses another)"
        ));
    }
    for (axis, name) in axes.other_axes().filter(|(n, _)| layout.shape[*n] > 1) {
        warnings.push(format!(
            "has an axis \"{name}\" of {} entries; the first is read",
            layout.shape[axis]
        ));
    }
    // A selected channel is read alone.
    let one = ReadOptions::index("channel", choice.channel, channels)?;
    if one.is_none() && channels > 4 {
        return Err(fail(format!(
            "contains {channels} channels, which cannot be shown together; choose one with --channel (1 to {channels})"
        )));
    }
    let chosen: Vec<usize> = one.map_or_else(|| (0..channels).collect(), |c| vec![c]);
    let size = axes.space().map(|axis| layout.extent(axis));
    let voxels = Selection {
        path,
        layout: &layout,
        axes: &axes,
        size,
        channels: &chosen,
        time,
        store: &group.store,
        watch,
    }
    .read(&array_folder)?;
    let dataset = group.datasets.get(level).unwrap_or(&Value::Null);
    let (scale, translation) = placement(group.multiscale(), dataset, rank).map_err(&fail)?;
    if scale.is_none() {
        warnings.retain(|w| !w.starts_with("states its spacing"));
    }
    if scale.is_none() && choice.spacing.is_none() {
        warnings.push("does not state its voxel spacing; 1 mm is assumed (use --spacing to set it)".into());
    }
    if scale.is_some() && axes.z.is_none() && choice.spacing.is_none() {
        warnings.push("has no axis z; a thickness of 1 mm is assumed (use --spacing to set it)".into());
    }
    let linear = DMat3::from_diagonal(scale.map_or(DVec3::ONE, |scale| axes.in_mm(&scale, 1.0)));
    let world_from_voxel = DAffine3 {
        matrix3: linear,
        translation: translation.map_or(DVec3::ZERO, |t| axes.in_mm(&t, 0.0)),
    };
    if !super::source::usable(&world_from_voxel) {
        return Err(fail(
            "has a scale of zero, or one that is not finite; its geometry cannot be used".into(),
        ));
    }
    let mut image = Image::new(group.format(), voxels, size, world_from_voxel);
    (image.components, image.layout, image.meaning) = (chosen.len(), Layout::Planar, group.meaning(&chosen));
    image.channel_taken = one.is_some();
    image.details.push(("levels", json!(group.datasets.len().max(1))));
    if channels > 1 {
        image.details.push(("channels", json!(channels)));
    }
    let names = group.channel_names();
    if !names.is_empty() {
        image.details.push(("channel_names", json!(names)));
    }
    if times > 1 {
        image.details.push(("time_points", json!(times)));
    }
    image.warnings = warnings;
    Ok(image)
}

/// A folder with a multiscale image, or with an array without metadata.
struct ImageGroup {
    store: Store,
    folder: PathBuf,
    attributes: Value,
    /// Resolutions, full resolution first; empty for an array without metadata.
    datasets: Vec<Value>,
}

impl ImageGroup {
    /// Reads the attributes; converted files have their first image one level down.
    fn open(path: &Path, warnings: &mut Vec<String>) -> Result<Self> {
        let (store, root) = Store::open(path)?;
        let mut folder = root.clone();
        let mut own = attributes(&store, &folder)?;
        if !own["multiscales"].is_array() && own.get("bioformats2raw.layout").is_some() {
            let images = (0..)
                .take_while(|n| store.is_node(&root.join(n.to_string())))
                .count();
            if images > 1 {
                warnings.push(format!(
                    "holds {images} images; the first is read (name one of the folders 0 to {} to see another)",
                    images - 1
                ));
            }
            folder = folder.join("0");
            own = attributes(&store, &folder)?;
        }
        if let Some(images) = own["well"]["images"].as_array() {
            let names: Vec<&str> = images.iter().filter_map(|i| i["path"].as_str()).take(8).collect();
            return Err(Error::file(
                path,
                format!(
                    "is a well of {} images; name one of the folders inside of it ({})",
                    images.len(),
                    names.join(", ")
                ),
            ));
        }
        if own["plate"].is_object() || own["well"].is_object() {
            return Err(Error::file(
                path,
                "is a plate of many images; name one of them (a folder such as A/1/0 inside)",
            ));
        }
        let images = own["multiscales"].as_array().map_or(0, Vec::len);
        if images > 1 {
            warnings.push(format!("holds {images} multiscale images; the first is read"));
        }
        let datasets = own["multiscales"][0]["datasets"]
            .as_array()
            .cloned()
            .unwrap_or_default();
        if datasets.is_empty() && !is_array(&store, &folder)? {
            folder = single_array(&store, path, &folder)?;
            own = attributes(&store, &folder)?;
        }
        Ok(Self {
            store,
            folder,
            attributes: own,
            datasets,
        })
    }

    /// The first multiscale image; null if there is none.
    fn multiscale(&self) -> &Value {
        &self.attributes["multiscales"][0]
    }

    /// The folder of a resolution's array.
    fn resolution_folder(&self, path: &Path, level: usize) -> Result<PathBuf> {
        let fail = |problem: String| Error::file(path, problem);
        if self.datasets.is_empty() {
            if level > 0 {
                return Err(Error::value(
                    "level",
                    format!("{level} is out of range; the array has a single resolution, 0"),
                ));
            }
            return Ok(self.folder.clone());
        }
        let dataset = self.datasets.get(level).ok_or_else(|| {
            Error::value(
                "level",
                format!(
                    "{level} is out of range; there are {} resolutions, counted from 0 (full)",
                    self.datasets.len()
                ),
            )
        })?;
        let name = dataset["path"]
            .as_str()
            .ok_or_else(|| fail("has a resolution without a path; its metadata are damaged".into()))?;
        if Path::new(name)
            .components()
            .any(|c| !matches!(c, std::path::Component::Normal(_)))
        {
            return Err(fail(format!(
                "names \"{name}\", which is outside the store; its metadata are damaged"
            )));
        }
        let folder = self.folder.join(name);
        if self.store.is_dir(&folder) {
            Ok(folder)
        } else {
            Err(fail(format!(
                "lacks the folder {name}, which its metadata name as resolution {level}; copy it again as a whole"
            )))
        }
    }

    /// Name of the format.
    fn format(&self) -> &'static str {
        match self.multiscale()["version"].as_str() {
            _ if self.store.is_file(&self.folder.join("zarr.json")) && !self.datasets.is_empty() => {
                "OME-Zarr 0.5"
            }
            _ if self.datasets.is_empty() => "Zarr",
            Some("0.1") => "OME-Zarr 0.1",
            Some("0.2") => "OME-Zarr 0.2",
            Some("0.3") => "OME-Zarr 0.3",
            _ => "OME-Zarr 0.4",
        }
    }

    /// The names of all channels; empty if none is stated.
    fn channel_names(&self) -> Vec<String> {
        let channels = self.attributes["omero"]["channels"].as_array();
        let names = channels.map_or(&[][..], Vec::as_slice).iter();
        let names: Vec<String> = names
            .map(|c| c["label"].as_str().unwrap_or("").to_owned())
            .collect();
        if names.iter().all(String::is_empty) {
            return Vec::new();
        }
        names
    }

    /// The meaning of the values of these channels.
    fn meaning(&self, channels: &[usize]) -> Meaning {
        if channels.len() > 1 {
            Meaning::Channels(
                channels
                    .iter()
                    .map(|&n| channel_style(&self.attributes["omero"]["channels"][n], n))
                    .collect(),
            )
        } else if self.folder.parent().is_some_and(|p| p.ends_with("labels"))
            || self.attributes["image-label"].is_object()
        {
            Meaning::Labels(labels(&self.attributes["image-label"]))
        } else {
            Meaning::Unstated
        }
    }
}

/// Whether a folder is an array.
fn is_array(store: &Store, folder: &Path) -> Result<bool> {
    let is_three = || Ok(store.json(&folder.join("zarr.json"))?["node_type"] == "array");
    Ok(store.is_file(&folder.join(".zarray")) || is_three()?)
}

/// The only array of at least two axes in a group without images.
fn single_array(store: &Store, path: &Path, folder: &Path) -> Result<PathBuf> {
    let (mut arrays, mut groups) = (Vec::new(), Vec::new());
    let folders = store.folders(path, folder)?;
    for entry in folders.into_iter().filter(|f| store.is_node(f)) {
        match array::rank_of(store, &entry)? {
            Some(0 | 1) => {}
            Some(_) => arrays.push(entry),
            None => groups.push(entry),
        }
    }
    let names = |mut folders: Vec<PathBuf>| {
        folders.sort();
        let names = folders.iter().take(8).filter_map(|p| p.file_name());
        let names: Vec<String> = names.map(|n| n.to_string_lossy().into_owned()).collect();
        names.join(", ")
    };
    let problem = match (arrays.len(), groups.len()) {
        (1, _) => return Ok(arrays.remove(0)),
        (0, 0) => "is a Zarr group without an image (no multiscales); name an image inside of it".into(),
        (0, n) => format!(
            "is a Zarr group of {n} groups without an image of its own (no multiscales); name one of the folders inside of it ({})",
            names(groups)
        ),
        (n, _) => format!(
            "is a Zarr group of {n} arrays without an image (no multiscales); name one of the folders inside of it ({})",
            names(arrays)
        ),
    };
    Err(Error::file(path, problem))
}

/// Names and colours of labels: "image-label", whose properties may have any keys.
fn labels(stated: &Value) -> Vec<Label> {
    let list = |key: &str| stated[key].as_array().cloned().unwrap_or_default();
    let value = |entry: &Value| entry["label-value"].as_u64().and_then(|v| u32::try_from(v).ok());
    let mut all: BTreeMap<u32, Label> = BTreeMap::new();
    let unnamed = |value: u32| Label {
        value,
        name: String::new(),
        color: None,
    };
    for entry in list("colors") {
        let bytes: Option<Vec<u8>> = entry["rgba"]
            .as_array()
            .map(|c| c.iter().filter_map(|v| v.as_u64()?.try_into().ok()).collect());
        if let (Some(v), Some([r, g, b, ..])) = (value(&entry), bytes.as_deref()) {
            all.entry(v).or_insert_with(|| unnamed(v)).color = Some([*r, *g, *b]);
        }
    }
    for entry in list("properties") {
        let name = ["name", "label", "class", "label-name", "acronym", "description"]
            .iter()
            .find_map(|key| entry[*key].as_str());
        if let (Some(v), Some(name)) = (value(&entry), name) {
            name.clone_into(&mut all.entry(v).or_insert_with(|| unnamed(v)).name);
        }
    }
    all.into_values().collect()
}

/// The part of an array to read.
struct Selection<'a> {
    path: &'a Path,
    layout: &'a ArrayLayout,
    axes: &'a AxisPositions,
    /// Voxels along x, y, z.
    size: [usize; 3],
    channels: &'a [usize],
    time: usize,
    store: &'a Store,
    watch: &'a Watch<'a>,
}

impl Selection<'_> {
    /// Reads the values of the array in a folder, channel after channel.
    fn read(&self, folder: &Path) -> Result<StoredValues> {
        let (path, [width, height, depth]) = (self.path, self.size);
        let scalar = self.layout.stored.scalar();
        let total = count(path, &[width, height, depth, self.channels.len()], scalar)?;
        let bytes = (total * scalar.bytes()) as u64;
        self.layout.check(self.store, path, folder, bytes)?;
        let array = self.store.array(path, folder)?;
        let voxels: StoredValues = match self.layout.stored {
            StoredType::Scalar(scalar) => with_scalar!(scalar, T => {
                self.values::<T, T>(&array, total, |v| v)?.into()
            }),
            StoredType::Bool => self.values::<bool, u8>(&array, total, u8::from)?.into(),
            StoredType::Half => self.values::<f16, f32>(&array, total, f16::to_f32)?.into(),
        };
        if voxels.len() != total {
            return Err(Error::file(
                path,
                "holds fewer values than it declares; it is damaged",
            ));
        }
        Ok(self.in_order(voxels))
    }

    /// Values in the order of storage, channel after channel.
    fn values<S: Copy, T>(
        &self,
        array: &StoredArray,
        total: usize,
        convert: impl Fn(S) -> T,
    ) -> Result<Vec<T>>
    where
        Vec<S>: FromArrayBytes,
    {
        let Some(&(slowest, _)) = self.axes.stored_order().first() else {
            return Ok(Vec::new());
        };
        // Whole layers of chunks at once, so that no chunk is unpacked twice.
        let extent = self.layout.extent(Some(slowest));
        let layer = (self.layout.chunks[slowest] as usize).clamp(1, extent);
        let mut values: Vec<T> = reserved(self.path, total)?;
        let meter = ByteProgress::new(self.watch, (total * size_of::<T>()) as u64);
        for &channel in self.channels {
            for first in (0..extent).step_by(layer) {
                let region = self.region(channel, slowest, first..(first + layer).min(extent));
                let part: Vec<S> = array.retrieve_array_subset(&region).map_err(|e| {
                    Error::file(self.path, format!("holds a chunk that cannot be read ({e})"))
                })?;
                let bytes = (part.len() * size_of::<T>()) as u64;
                values.extend(part.into_iter().map(&convert));
                meter.add(bytes)?;
            }
        }
        Ok(values)
    }

    /// Values with x fastest, then y, z and channels.
    fn in_order(&self, values: StoredValues) -> StoredValues {
        let mut stored = self.axes.stored_order();
        if self.axes.z.is_none() {
            stored.insert(0, (usize::MAX, 0));
        }
        let places = [0, 1, 2].map(|n| stored[n].1);
        if places == [0, 1, 2] {
            return values;
        }
        let (total, [x, y, z]) = (values.len(), self.size);
        let extents = places.map(|place| [z, y, x][place]);
        let source = |place: usize| 1 + places.iter().position(|p| *p == place).unwrap_or(place);
        values
            .reshaped((self.channels.len(), extents[0], extents[1], extents[2]))
            .permuted(Ix4(0, source(0), source(1), source(2)))
            .reshaped(total)
    }

    /// Some layers, along the slowest axis of space, of a channel.
    fn region(&self, channel: usize, slowest: usize, layers: Range<usize>) -> ArraySubset {
        let axes = self.axes;
        let ranges: Vec<Range<u64>> = (0..self.layout.shape.len())
            .map(|a| match a {
                a if a == slowest => layers.start as u64..layers.end as u64,
                a if axes.space().contains(&Some(a)) => 0..self.layout.shape[a],
                a if Some(a) == axes.channel => channel as u64..channel as u64 + 1,
                a if Some(a) == axes.time => self.time as u64..self.time as u64 + 1,
                _ => 0..1,
            })
            .collect();
        ArraySubset::new_with_ranges(&ranges)
    }
}

/// Colour and window of a channel.
fn channel_style(attributes_json: &Value, n: usize) -> Channel {
    let color = attributes_json["color"]
        .as_str()
        .filter(|t| t.len() == 6)
        .and_then(|t| u32::from_str_radix(t, 16).ok());
    let [_, r, g, b] = color.unwrap_or(0).to_be_bytes();
    let window = attributes_json["window"]["start"]
        .as_f64()
        .zip(attributes_json["window"]["end"].as_f64())
        .filter(|(a, b)| a < b);
    Channel {
        color: if color.is_some() {
            [r, g, b]
        } else {
            super::super::colors::CHANNELS[n % 4]
        },
        window: window.map(|(a, b)| [a, b]),
    }
}
