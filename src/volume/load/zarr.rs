//! OME-Zarr 0.4 and 0.5 (and the older 0.1 to 0.3), a folder: one resolution of a multiscale image,
//! with its channels in their colours. A Zarr array without metadata about its axes is read as (z,
//! y, x).
//!
//! Source: the OME-NGFF specification 0.4 and 0.5, "multiscales", "coordinateTransformations",
//! "omero".

use super::ScalarType;
use super::image::{Channel, Image, Layout, Meaning};
use super::source::{count, reserved, with_scalar};
use super::tiff::mm_of;
use super::{ReadOptions, StoredValues};
use crate::files::{input, inputs, reference};
use crate::panic_guard::catch_panic;
use crate::{ByteProgress, Error, Result, Watch};
use glam::{DAffine3, DMat3, DVec3};
use serde_json::{Value, json};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use zarrs::array::Array;
use zarrs::array::ArraySubset;
use zarrs::filesystem::FilesystemStore;

/// Maximum compression ratio of chunks, also assumed for arrays whose empty chunks were omitted.
const MAX_COMPRESSION_RATIO: u64 = 5000;
const ALWAYS_BELIEVED: u64 = 64 << 20;
/// Maximum number of omitted empty chunks.
const MAX_MISSING_CHUNKS: u64 = 100_000;
/// Maximum size of a metadata file, bytes.
const MAX_METADATA_BYTES: u64 = 16 << 20;

/// Whether a folder is a Zarr group or array.
pub fn is_zarr(folder: &Path) -> bool {
    [".zattrs", ".zgroup", ".zarray", "zarr.json"]
        .iter()
        .any(|n| folder.join(n).is_file())
}

/// The JSON of a file; null if there is no file.
fn metadata(path: &Path) -> Result<Value> {
    if !path.exists() {
        return Ok(Value::Null);
    }
    let bytes = input::bytes(path, MAX_METADATA_BYTES, "metadata")?;
    serde_json::from_slice(&bytes).map_err(|e| {
        Error::file(
            path,
            format!("is not readable JSON ({e}); it is truncated or damaged"),
        )
    })
}

/// Attributes of a group, in either version of Zarr.
fn attributes(folder: &Path) -> Result<Value> {
    let three = metadata(&folder.join("zarr.json"))?;
    if !three.is_null() {
        let own = &three["attributes"];
        return Ok(if own["ome"].is_object() {
            own["ome"].clone()
        } else {
            own.clone()
        });
    }
    metadata(&folder.join(".zattrs"))
}

/// Reads an image.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let ended = || Error::file(path, "its chunks are damaged; copy it again");
    catch_panic(|| read_unguarded(path, choice, watch)).ok_or_else(ended)?
}

/// Reads an image; [`read`] turns a panic of the decoder into an error.
fn read_unguarded(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    let group = ImageGroup::open(path)?;
    let level = choice.level.unwrap_or(0);
    let array_folder = group.resolution_folder(path, level)?;
    let layout = ArrayLayout::of(&array_folder)?;
    let axes = AxisPositions::of(group.multiscale(), layout.shape.len()).map_err(&fail)?;
    let (channels, times) = (layout.extent(axes.channel), layout.extent(axes.time));
    let mut warnings = Vec::new();
    let time = choice.time_of(times)?;
    if times > 1 && choice.time.is_none() {
        warnings.push(format!(
            "holds {times} volumes; the first is used (--time chooses another)"
        ));
    }
    if !axes.in_order() {
        return Err(fail(
            "has its axes in another order than time, channel, z, y, x; reorder them".into(),
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
        watch,
    }
    .read(&array_folder)?;
    let (scale, translation) = placement(
        group.multiscale(),
        group.datasets.get(level).unwrap_or(&Value::Null),
        layout.shape.len(),
    )
    .map_err(&fail)?;
    if scale.is_none() && choice.spacing.is_none() {
        warnings.push("does not state its voxel spacing; 1 mm is assumed (use --spacing to set it)".into());
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
    if times > 1 {
        image.details.push(("time_points", json!(times)));
    }
    image.warnings = warnings;
    Ok(image)
}

/// A folder with a multiscale image, or with an array without metadata.
struct ImageGroup {
    folder: PathBuf,
    attributes: Value,
    /// Resolutions, full resolution first; empty for an array without metadata.
    datasets: Vec<Value>,
}

impl ImageGroup {
    /// Reads the attributes; converted files have their first image one level down.
    fn open(path: &Path) -> Result<Self> {
        let mut folder = path.to_owned();
        let mut own = attributes(&folder)?;
        if !own["multiscales"].is_array() && own.get("bioformats2raw.layout").is_some() {
            folder = folder.join("0");
            own = attributes(&folder)?;
        }
        if own["plate"].is_object() || own["well"].is_object() {
            return Err(Error::file(
                path,
                "is a plate of many images; name one of them (a folder such as A/1/0 inside)",
            ));
        }
        let datasets = own["multiscales"][0]["datasets"]
            .as_array()
            .cloned()
            .unwrap_or_default();
        Ok(Self {
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
            if !self.folder.join(".zarray").is_file()
                && metadata(&self.folder.join("zarr.json"))?["node_type"] != "array"
            {
                return Err(fail(
                    "is a Zarr group without an image (no multiscales); name an image inside of it".into(),
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
        Ok(self.folder.join(name))
    }

    /// Name of the format.
    fn format(&self) -> &'static str {
        if self.folder.join("zarr.json").is_file() {
            "OME-Zarr 0.5"
        } else {
            "OME-Zarr 0.4"
        }
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
            Meaning::Labels(Vec::new())
        } else {
            Meaning::Unstated
        }
    }
}

/// The positions of the axes of an array.
struct AxisPositions {
    all: Vec<ZarrAxis>,
    x: usize,
    y: usize,
    z: Option<usize>,
    channel: Option<usize>,
    time: Option<usize>,
}

impl AxisPositions {
    /// Finds the axes of an array of this rank by their names.
    fn of(multiscale: &Value, rank: usize) -> Result<Self, String> {
        let all = axes(multiscale, rank)?;
        let find = |name: &str| all.iter().position(|a| a.name == name);
        let (Some(x), Some(y)) = (find("x"), find("y")) else {
            return Err("has no axes x and y; a volume is needed".into());
        };
        let (z, channel, time) = (find("z"), find("c"), find("t"));
        Ok(Self {
            all,
            x,
            y,
            z,
            channel,
            time,
        })
    }

    /// Whether x, y and z are the last axes, with x varying fastest.
    fn in_order(&self) -> bool {
        let rank = self.all.len();
        self.x + 1 == rank && self.y + 2 == rank && self.z.is_none_or(|z| z + 3 == rank)
    }

    /// Axes x, y, z.
    fn space(&self) -> [Option<usize>; 3] {
        [Some(self.x), Some(self.y), self.z]
    }

    /// From values for every axis, those along x, y, z in mm; `missing` for an axis that does not
    /// exist.
    fn in_mm(&self, values: &[f64], missing: f64) -> DVec3 {
        DVec3::from_array(
            self.space()
                .map(|axis| axis.map_or(missing, |a| values[a] * self.all[a].mm)),
        )
    }
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
    watch: &'a Watch<'a>,
}

impl Selection<'_> {
    /// Reads the values of the array in a folder, channel after channel.
    fn read(&self, folder: &Path) -> Result<StoredValues> {
        let (path, [width, height, depth]) = (self.path, self.size);
        let fail = |problem: String| Error::file(path, problem);
        let total = count(
            path,
            &[width, height, depth, self.channels.len()],
            self.layout.scalar,
        )?;
        self.layout
            .check(path, folder, (total * self.layout.scalar.bytes()) as u64)?;
        let array = self.open(folder)?;
        // Whole layers of chunks at once, so that no chunk is unpacked twice.
        let layer = self
            .axes
            .z
            .map_or(1, |a| self.layout.chunks[a] as usize)
            .clamp(1, depth);
        let voxels: StoredValues = with_scalar!(self.layout.scalar, T => {
            let mut values: Vec<T> = reserved(path, total)?;
            let meter = ByteProgress::new(self.watch, (total * size_of::<T>()) as u64);
            for &channel in self.channels {
                for first in (0..depth).step_by(layer) {
                    let region = self.region(channel, first..(first + layer).min(depth));
                    let part: Vec<T> = array.retrieve_array_subset(&region).map_err(|e| fail(format!("holds a chunk that cannot be read ({e})")))?;
                    values.extend_from_slice(&part);
                    meter.add(size_of_val(&part[..]) as u64)?;
                }
            }
            values.into()
        });
        if voxels.len() != total {
            return Err(fail("holds fewer values than it declares; it is damaged".into()));
        }
        Ok(voxels)
    }

    /// Opens the array in a folder.
    fn open(&self, folder: &Path) -> Result<Array<FilesystemStore>> {
        let fail = |problem: String| Error::file(self.path, problem);
        // Its metadata and chunks, existing or not.
        inputs::note_path(self.path);
        if folder.to_str().is_none() {
            return Err(fail(
                "has a path that is not UTF-8, which OME-Zarr requires; rename it".into(),
            ));
        }
        let store = FilesystemStore::new(folder).map_err(|e| fail(format!("cannot be opened ({e})")))?;
        Array::open(Arc::new(store), "/")
            .map_err(|e| fail(format!("holds an array that cannot be read ({e})")))
    }

    /// Some slices of a channel.
    fn region(&self, channel: usize, slices: Range<usize>) -> ArraySubset {
        let axes = self.axes;
        let ranges: Vec<Range<u64>> = (0..self.layout.shape.len())
            .map(|a| match a {
                a if a == axes.x || a == axes.y => 0..self.layout.shape[a],
                a if Some(a) == axes.z => slices.start as u64..slices.end as u64,
                a if Some(a) == axes.channel => channel as u64..channel as u64 + 1,
                a if Some(a) == axes.time => self.time as u64..self.time as u64 + 1,
                _ => 0..1,
            })
            .collect();
        ArraySubset::new_with_ranges(&ranges)
    }
}

/// A Zarr array's metadata, read before anything is allocated.
struct ArrayLayout {
    shape: Vec<u64>,
    chunks: Vec<u64>,
    scalar: ScalarType,
}

impl ArrayLayout {
    fn of(folder: &Path) -> Result<Self> {
        let fail = |problem: String| Error::file(folder, problem);
        let two = metadata(&folder.join(".zarray"))?;
        let (shape, chunks, kind) = if two.is_null() {
            let three = metadata(&folder.join("zarr.json"))?;
            if three.is_null() {
                return Err(fail(
                    "is not a Zarr array (it contains neither .zarray nor zarr.json)".into(),
                ));
            }
            let chunks = three["chunk_grid"]["configuration"]["chunk_shape"].clone();
            (
                three["shape"].clone(),
                chunks,
                three["data_type"].as_str().unwrap_or("").to_owned(),
            )
        } else {
            let kind = two["dtype"]
                .as_str()
                .unwrap_or("")
                .trim_start_matches(['<', '>', '|']);
            let kind = match kind {
                "u1" | "b1" => "uint8",
                "i1" => "int8",
                "u2" => "uint16",
                "i2" => "int16",
                "u4" => "uint32",
                "i4" => "int32",
                "u8" => "uint64",
                "i8" => "int64",
                "f4" => "float32",
                "f8" => "float64",
                other => other,
            };
            (two["shape"].clone(), two["chunks"].clone(), kind.to_owned())
        };
        let numbers = |v: &Value| {
            v.as_array()?
                .iter()
                .map(|n| n.as_u64().filter(|n| *n > 0))
                .collect::<Option<Vec<u64>>>()
        };
        let (Some(shape), Some(chunks)) = (numbers(&shape), numbers(&chunks)) else {
            return Err(fail(
                "has a shape or chunks that are not positive numbers; its metadata are damaged".into(),
            ));
        };
        if shape.len() != chunks.len() || !(2..=5).contains(&shape.len()) {
            return Err(fail(format!("has {} axes; 2 to 5 can be read", shape.len())));
        }
        let scalar = ScalarType::named(&kind)
            .ok_or_else(|| fail(format!("stores \"{kind}\", which cannot be rendered")))?;
        Ok(Self {
            shape,
            chunks,
            scalar,
        })
    }

    /// Extent of an axis; 1 for an axis that the array does not have.
    fn extent(&self, axis: Option<usize>) -> usize {
        axis.map_or(1, |a| self.shape[a] as usize)
    }

    /// Rejects arrays and chunks that are far larger than the existing files.
    fn check(&self, path: &Path, folder: &Path, bytes: u64) -> Result<()> {
        let (mut there, mut files) = (0u64, 0u64);
        for entry in walkdir::WalkDir::new(folder).into_iter().flatten() {
            // The library reads every existing file.
            if reference::is_link_out(path, entry.path()) {
                let links = reference::links_left_out(&[entry.path().to_owned()]).unwrap_or_default();
                return Err(Error::file(path, links));
            }
            let Ok(metadata) = std::fs::metadata(entry.path()) else {
                continue;
            };
            if metadata.is_file() {
                inputs::register(entry.path(), &metadata);
                (there, files) = (there + metadata.len(), files + 1);
            } else if !metadata.is_dir() {
                return Err(Error::file(
                    entry.path(),
                    "is not a regular file (it is a pipe, a socket or a device), so it cannot be a chunk of the array; remove it",
                ));
            }
        }
        // Each chunk is looked up, whether it exists or not.
        let chunks = self
            .shape
            .iter()
            .zip(&self.chunks)
            .try_fold(1u64, |n, (s, c)| n.checked_mul(s.div_ceil(*c)));
        if chunks.is_none_or(|n| n > MAX_MISSING_CHUNKS.saturating_add(files.saturating_mul(64))) {
            return Err(Error::file(
                path,
                format!(
                    "declares far more chunks than the {files} files in it: its metadata are damaged; copy it again"
                ),
            ));
        }
        let most = there.saturating_mul(MAX_COMPRESSION_RATIO).max(ALWAYS_BELIEVED);
        let chunk = self
            .chunks
            .iter()
            .try_fold(self.scalar.bytes() as u64, |n, &c| n.checked_mul(c));
        super::source::check_held(path, bytes.max(chunk.unwrap_or(u64::MAX)), most)
    }
}

struct ZarrAxis {
    name: String,
    mm: f64,
}

/// Names and units of the axes; in 0.1 and 0.2 they are always t, c, z, y, x.
fn axes(multiscale: &Value, rank: usize) -> Result<Vec<ZarrAxis>, String> {
    let Some(stated) = multiscale["axes"].as_array() else {
        let names: &[&str] = if multiscale.is_null() {
            &["t", "c", "z", "y", "x"][5 - rank.min(5)..]
        } else {
            &["t", "c", "z", "y", "x"]
        };
        return if names.len() == rank {
            Ok(names
                .iter()
                .map(|n| ZarrAxis {
                    name: (*n).to_owned(),
                    mm: 1.0,
                })
                .collect())
        } else {
            Err("does not name its axes; its metadata are damaged".into())
        };
    };
    if stated.len() != rank {
        return Err(format!(
            "names {} axes of an array of {rank}; its metadata are damaged",
            stated.len()
        ));
    }
    Ok(stated
        .iter()
        .map(|a| ZarrAxis {
            name: a
                .as_str()
                .or(a["name"].as_str())
                .unwrap_or("")
                .to_ascii_lowercase(),
            mm: a["unit"].as_str().and_then(mm_of).unwrap_or(1.0),
        })
        .collect())
}

/// Scale and translation per axis: those of the resolution, then those of the whole image.
#[allow(clippy::type_complexity, reason = "two optional lists")]
fn placement(
    multiscale: &Value,
    dataset: &Value,
    rank: usize,
) -> Result<(Option<Vec<f64>>, Option<Vec<f64>>), String> {
    let (mut scale, mut translation): (Option<Vec<f64>>, Option<Vec<f64>>) = (None, None);
    for list in [
        &dataset["coordinateTransformations"],
        &multiscale["coordinateTransformations"],
    ] {
        for step in list.as_array().map_or(&[][..], Vec::as_slice) {
            let kind = step["type"].as_str().unwrap_or("");
            let values: Option<Vec<f64>> = step[kind]
                .as_array()
                .map(|a| a.iter().map(|v| v.as_f64().unwrap_or(f64::NAN)).collect());
            let Some(values) = values.filter(|v| v.len() == rank) else {
                if kind == "identity" {
                    continue;
                }
                return Err(format!("has a transformation \"{kind}\" that cannot be read"));
            };
            match kind {
                "scale" => {
                    let times =
                        |old: &Vec<f64>| old.iter().zip(&values).map(|(a, b)| a * b).collect::<Vec<f64>>();
                    (scale, translation) = (
                        Some(scale.as_ref().map_or(values.clone(), times)),
                        translation.as_ref().map(times),
                    );
                }
                "translation" => {
                    translation = Some(translation.map_or(values.clone(), |old| {
                        old.iter().zip(&values).map(|(a, b)| a + b).collect()
                    }));
                }
                _ => return Err(format!("has a transformation \"{kind}\", which cannot be used")),
            }
        }
    }
    Ok((scale, translation))
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
