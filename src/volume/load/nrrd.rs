//! NRRD, attached (`.nrrd`) or detached (`.nhdr`, in one data file or many), raw, gzip, bzip2, text
//! or hex; up to three spatial axes, one of components and one of time, in any order.
//!
//! *Geometry*: `space directions` and `space origin` in the space given by the file, converted to
//! LPS; else `spacings` (or `axis mins` and `axis maxs`) and `axis mins`. Vectors are given in that
//! space, unless a `measurement frame` is given. Source: the NRRD format definition (Kindlmann,
//! teem 1.11).

mod geometry;
mod header;
mod values;

use super::super::StoredValues;
use super::super::colors::Label;
use super::ReadOptions;
use super::ScalarType;
use super::image::{Image, Layout, Meaning};
use super::source::{buffered, count, sibling_file};
use crate::{Error, Result, Watch};
use geometry::geometry;
use header::{LIST_KEY, header, required, words};
use ndarray::{Axis, IxDyn};
use serde_json::json;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use values::Data;
pub(super) use values::last_bytes;

/// Maximum number of data files of a detached header.
const MAX_FILES: usize = 100_000;
/// Key that identifies this program's displacement maps.
const MAP_KEY: &str = "incise";

/// The role of each axis.
struct Axes {
    sizes: Vec<usize>,
    spatial: Vec<usize>,
    components: Option<usize>,
    time: Option<usize>,
}

/// Reads an image.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let (mut reader, file_bytes) = buffered(path)?;
    let fields = header(path, &mut reader)?;
    let (axes, scalar) = axes_and_type(path, &fields)?;
    let total = count(path, &axes.sizes, scalar)?;
    let mut warnings = Vec::new();
    let (world_from_voxel, frame) = geometry(&fields, &axes.spatial, axes.sizes.len(), &mut warnings)
        .map_err(|problem| Error::file(path, problem))?;
    let data = Data::new(path, &fields, scalar, total, watch)?;

    // If the time axis is the slowest, other times are skipped while reading; otherwise they are
    // removed afterwards.
    let frames = axes.time.map_or(1, |t| axes.sizes[t]);
    let time = choice.time_of(frames)?;
    let slowest = axes.time.is_some_and(|t| t + 1 == axes.sizes.len());
    let (stored, ahead) = if slowest {
        (total / frames, total / frames * time)
    } else {
        (total, 0)
    };
    let voxels = match data_files(path, &fields, &axes)? {
        None => data.read(
            path,
            reader,
            file_bytes,
            [ahead, stored],
            slowest && time + 1 < frames,
        )?,
        Some(files) if files.len() == 1 => {
            let (reader, file_bytes) = buffered(&files[0])?;
            data.read(
                &files[0],
                reader,
                file_bytes,
                [ahead, stored],
                slowest && time + 1 < frames,
            )?
        }
        Some(files) => data.read_pieces(files, total, [ahead, stored])?,
    };
    let (voxels, components, layout) = arranged(voxels, &axes, if slowest { None } else { Some(time) });
    let size: [usize; 3] = std::array::from_fn(|a| axes.spatial.get(a).map_or(1, |&s| axes.sizes[s]));
    let mut image = Image::new("NRRD", voxels, size, world_from_voxel);
    (image.components, image.layout, image.frame) = (components, layout, Some(frame));
    image.displacement = fields.get(MAP_KEY).map(String::as_str) == Some("displacement map 1");
    image.meaning = meaning(&fields, &axes);
    if frames > 1 {
        if choice.time.is_none() {
            warnings.push(format!(
                "holds {frames} volumes; the first is used (--time chooses another)"
            ));
        }
        image.details.push(("time_points", json!(frames)));
    }
    image.warnings = warnings;
    Ok(image)
}

/// Files with the values, if the header is detached: one, a list, or a pattern with numbers.
fn data_files(path: &Path, fields: &HashMap<String, String>, axes: &Axes) -> Result<Option<Vec<PathBuf>>> {
    let Some(named) = fields.get("data file").or(fields.get("datafile")) else {
        return Ok(None);
    };
    let fail = |problem: String| Error::file(path, problem);
    let of = |names: Vec<String>| {
        if names.is_empty() || names.len() > MAX_FILES {
            return Err(fail(format!(
                "names {} data files; 1 to {MAX_FILES} can be read",
                names.len()
            )));
        }
        names
            .iter()
            .map(|n| sibling_file(path, n.trim()))
            .collect::<Result<Vec<_>>>()
            .map(Some)
    };
    let words: Vec<&str> = named.split_whitespace().collect();
    if words.first() == Some(&"LIST") {
        if words
            .get(1)
            .and_then(|w| w.parse::<usize>().ok())
            .is_some_and(|n| n + 1 < axes.sizes.len())
        {
            return Err(fail(
                "has data files of less than a slice each; join them into one".into(),
            ));
        }
        return of(fields
            .get(LIST_KEY)
            .map_or(Vec::new(), |l| l.lines().map(str::to_owned).collect()));
    }
    if let [pattern, first, last, step, ..] = words[..]
        && pattern.contains('%')
    {
        let numbers = [first, last, step].map(|w| w.parse::<i64>().ok());
        let [Some(first), Some(last), Some(step)] = numbers else {
            return Err(fail(format!(
                "has an invalid pattern of data files: \"{named}\"; it must be PATTERN FIRST LAST STEP"
            )));
        };
        return of(numbered(pattern, first, last, step).map_err(fail)?);
    }
    of(vec![named.clone()])
}

/// The names generated by a pattern such as `slice%03d.raw`.
pub(super) fn numbered(pattern: &str, first: i64, last: i64, step: i64) -> Result<Vec<String>, String> {
    let unclear = || format!("has the invalid file pattern \"{pattern}\"; it must contain one %d or %03d");
    let (before, rest) = pattern.split_once('%').ok_or_else(unclear)?;
    let end = rest.find(|c: char| !c.is_ascii_digit()).ok_or_else(unclear)?;
    let (width, after) = (&rest[..end], &rest[end..]);
    let after = after
        .strip_prefix(['d', 'i', 'u'])
        .filter(|a| !a.contains('%'))
        .ok_or_else(unclear)?;
    let digits = width.parse::<usize>().unwrap_or(0).min(32);
    if last
        .checked_sub(first)
        .and_then(|d| d.checked_div(step))
        .is_none_or(|n| n < 0 || n >= MAX_FILES as i64)
    {
        return Err(format!(
            "numbers its data files from {first} to {last} by {step}, which is not a valid sequence"
        ));
    }
    let zero = width.starts_with('0');
    Ok((0..=(last - first) / step)
        .map(|n| first + n * step)
        .map(|n| {
            if zero {
                format!("{before}{n:0digits$}{after}")
            } else {
                format!("{before}{n:digits$}{after}")
            }
        })
        .collect())
}

/// Values in voxel order: one time selected, components first or last.
fn arranged(voxels: StoredValues, axes: &Axes, time: Option<usize>) -> (StoredValues, usize, Layout) {
    let components = axes.components.map_or(1, |c| axes.sizes[c]);
    let other_axes: Vec<usize> = (0..axes.sizes.len()).filter(|a| Some(*a) != axes.time).collect();
    let place = axes
        .components
        .and_then(|c| other_axes.iter().position(|a| *a == c));
    let layout = if place == Some(0) {
        Layout::Interleaved
    } else {
        Layout::Planar
    };
    let in_order = place.is_none_or(|p| p == 0 || p + 1 == other_axes.len());
    if in_order && (axes.time.is_none() || time.is_none()) {
        return (voxels, components, layout);
    }
    // Slowest first, as arrays are indexed. A slowest time axis was skipped while reading.
    let mut remaining: Vec<usize> = (0..axes.sizes.len())
        .rev()
        .filter(|a| time.is_some() || Some(*a) != axes.time)
        .collect();
    let shape: Vec<usize> = remaining.iter().map(|&a| axes.sizes[a]).collect();
    let mut array = voxels.reshaped(IxDyn(&shape));
    if let Some((axis, t)) = axes.time.zip(time)
        && let Some(place) = remaining.iter().position(|a| *a == axis)
    {
        array = array.at_index(Axis(place), t);
        remaining.remove(place);
    }
    let wanted = axes
        .components
        .into_iter()
        .chain(axes.spatial.iter().rev().copied());
    let order: Vec<usize> = wanted
        .filter_map(|axis| remaining.iter().position(|a| *a == axis))
        .collect();
    let count = array.len();
    (
        array.permuted(IxDyn(&order)).reshaped(count),
        components,
        Layout::Planar,
    )
}

/// The meaning of the values: from the kind of the component axis, or from 3D Slicer's segment
/// fields.
fn meaning(fields: &HashMap<String, String>, axes: &Axes) -> Meaning {
    let segments = fields
        .keys()
        .filter_map(|k| k.strip_prefix("segment")?.strip_suffix("_labelvalue"))
        .filter(|n| n.parse::<u32>().is_ok());
    let mut labels: Vec<Label> = segments
        .filter_map(|n| {
            let get = |key: &str| fields.get(&format!("segment{n}_{key}"));
            let value = get("labelvalue")?.trim().parse().ok()?;
            let shares: Vec<f32> = get("color").map_or(Vec::new(), |c| {
                c.split_whitespace().map_while(|w| w.parse().ok()).collect()
            });
            let color = <[f32; 3]>::try_from(shares)
                .ok()
                .map(|c| c.map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
            Some(Label {
                value,
                name: get("name").cloned().unwrap_or_default(),
                color,
            })
        })
        .collect();
    if !labels.is_empty() {
        labels.sort_by_key(|l| l.value);
        return Meaning::Labels(labels);
    }
    let kind = axes.components.and_then(|c| {
        fields
            .get("kinds")?
            .split_whitespace()
            .nth(c)
            .map(str::to_ascii_lowercase)
    });
    match kind.as_deref() {
        Some("rgb-color" | "rgba-color" | "3-color" | "4-color") => Meaning::Color,
        Some("vector" | "covariant-vector" | "normal" | "3-vector" | "3-gradient" | "3-normal") => {
            Meaning::Vectors
        }
        _ => Meaning::Unstated,
    }
}

/// The axes and the type of the values, from the header.
fn axes_and_type(path: &Path, fields: &HashMap<String, String>) -> Result<(Axes, ScalarType)> {
    let fail = |problem: String| Error::file(path, problem);
    let get = |name: &str| fields.get(name).map(String::as_str);
    let need = |name: &str| required(path, fields, name);
    let whole = |text: &str| {
        text.split_whitespace()
            .map(|w| w.parse::<usize>().ok().filter(|&n| n > 0))
            .collect::<Option<Vec<_>>>()
    };
    let sizes = whole(need("sizes")?).ok_or_else(|| {
        fail(format!(
            "has the sizes \"{}\", which are not positive numbers",
            get("sizes").unwrap_or("")
        ))
    })?;
    if need("dimension")?.trim().parse() != Ok(sizes.len()) || !(1..=5).contains(&sizes.len()) {
        return Err(fail(format!(
            "has {} axes; images of 1 to 3, one axis of components and one of time can be read",
            sizes.len()
        )));
    }
    let scalar = scalar_type(need("type")?).ok_or_else(|| {
        fail(format!(
            "has the type \"{}\", which is not supported",
            get("type").unwrap_or("")
        ))
    })?;
    Ok((axes(fields, sizes).map_err(fail)?, scalar))
}

fn scalar_type(name: &str) -> Option<ScalarType> {
    Some(match name.trim() {
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => ScalarType::U8,
        "signed char" | "int8" | "int8_t" => ScalarType::I8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => ScalarType::I16,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => ScalarType::U16,
        "int" | "signed int" | "int32" | "int32_t" => ScalarType::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => ScalarType::U32,
        "longlong" | "long long" | "long long int" | "signed long long" | "int64" | "int64_t" => {
            ScalarType::I64
        }
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => {
            ScalarType::U64
        }
        "float" => ScalarType::F32,
        "double" => ScalarType::F64,
        _ => return None,
    })
}

/// The role of each axis: from kinds, from missing directions, else the first three are spatial.
fn axes(fields: &HashMap<String, String>, sizes: Vec<usize>) -> Result<Axes, String> {
    let kinds: Vec<String> = fields.get("kinds").map_or(Vec::new(), |k| {
        k.split_whitespace().map(str::to_ascii_lowercase).collect()
    });
    let directions = fields.get("space directions").map_or(Vec::new(), |d| words(d));
    let map = fields.contains_key(MAP_KEY);
    let (mut components, mut time, mut spatial) = (None, None, Vec::new());
    for (axis, &size) in sizes.iter().enumerate() {
        let kind = kinds.get(axis).map_or("???", String::as_str);
        let none = directions.get(axis).is_some_and(|d| d == "none");
        let is_time = kind == "time" || (kind == "list" && !map && size > 4);
        if is_time && time.is_none() {
            time = Some(axis);
        } else if (none || !matches!(kind, "domain" | "space" | "???" | "none")) && !is_time {
            if components.replace(axis).is_some() {
                return Err("has several axes of components; one can be read".into());
            }
        } else {
            spatial.push(axis);
        }
    }
    // Four axes without any information: a small one holds components, else the last one is time.
    if spatial.len() > 3 {
        let rest = spatial.split_off(3);
        match (rest[..].first(), components, time) {
            (Some(_), None, _) if sizes[spatial[0]] <= 4 && rest.len() == 1 => {
                return Err("has four axes and does not say which holds the components (kinds, or \"none\" in space directions)".into());
            }
            (Some(&axis), _, None) if rest.len() == 1 => time = Some(axis),
            _ => return Err("has more than three spatial axes and one of time".into()),
        }
    }
    if spatial.is_empty() {
        return Err("has no spatial axis; its kinds are damaged".into());
    }
    Ok(Axes {
        sizes,
        spatial,
        components,
        time,
    })
}
