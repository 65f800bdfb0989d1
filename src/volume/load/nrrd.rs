//! NRRD, attached (`.nrrd`) or detached (`.nhdr`, in one data file or many), raw, gzip, bzip2, text
//! or hex; up to three spatial axes, one of components and one of time, in any order.
//!
//! *Geometry*: `space directions` and `space origin` in the space given by the file, converted to
//! LPS; else `spacings` (or `axis mins` and `axis maxs`, or `thicknesses`) and `axis mins`. Vectors are given in that
//! space, unless a `measurement frame` is given. Source: the NRRD format definition (Kindlmann,
//! teem 1.11).

mod geometry;
mod header;
mod segmentation;
mod values;

use super::super::StoredValues;
use super::ReadOptions;
use super::ScalarType;
use super::image::{Image, Layout, Meaning};
use super::source::{buffered, count, sibling_file};
use crate::{Error, Result, Watch};
use geometry::geometry;
use glam::DVec3;
use header::{Header, header, required, vector, words};
use ndarray::{Axis, IxDyn};
use serde_json::json;
use std::path::{Path, PathBuf};
use values::Data;

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
    let mut header = header(path, &mut reader)?;
    let segments = segmentation::segments(&header);
    let (axes, scalar) = axes_and_type(path, &header, !segments.is_empty())?;
    let kind = components_kind(&header, &axes);
    check_kind(path, kind.as_deref(), choice)?;
    let total = count(path, &axes.sizes, scalar)?;
    let mut warnings = std::mem::take(&mut header.warnings);
    let (world_from_voxel, frame) = geometry(
        &header.fields,
        &axes.spatial,
        axes.sizes.len(),
        choice,
        &mut warnings,
    )
    .map_err(|problem| Error::file(path, problem))?;
    let data = Data::new(path, &header, scalar, watch)?;

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
    let voxels = match data_files(path, &header, &axes)? {
        None => data.read(path, reader, file_bytes, [ahead, stored], total)?,
        Some(files) if files.len() == 1 => {
            let (reader, file_bytes) = buffered(&files[0])?;
            data.read(&files[0], reader, file_bytes, [ahead, stored], total)?
        }
        Some(files) => data.read_pieces(&files, total, [ahead, stored])?,
    };
    let (voxels, components, layout) = arranged(voxels, &axes, if slowest { None } else { Some(time) });
    let size: [usize; 3] = std::array::from_fn(|a| axes.spatial.get(a).map_or(1, |&s| axes.sizes[s]));
    let mut image = Image::new("NRRD", voxels, size, world_from_voxel);
    (image.components, image.layout, image.frame) = (components, layout, Some(frame));
    image.displacement = header.keys.get(MAP_KEY).map(String::as_str) == Some("displacement map 1");
    image.meaning = meaning(kind.as_deref());
    if kind.as_deref() == Some("complex") && choice.channel.is_none() {
        warnings.push(
            "holds complex numbers; their real part is channel 1 and their imaginary part channel 2".into(),
        );
    }
    if frames > 1 {
        if choice.time.is_none() {
            warnings.push(format!(
                "holds {frames} volumes; the first is used (--time chooses another)"
            ));
        }
        image.details.push(("time_points", json!(frames)));
    }
    image.warnings = warnings;
    if !segments.is_empty() {
        segmentation::apply(path, &mut image, segments, choice)?;
    }
    Ok(image)
}

/// Files with the values, if the header is detached: one, a list, or a pattern with numbers.
fn data_files(path: &Path, header: &Header, axes: &Axes) -> Result<Option<Vec<PathBuf>>> {
    let Some(named) = header.get("data file") else {
        return Ok(None);
    };
    let fail = |problem: String| Error::file(path, problem);
    let words: Vec<&str> = named.split_whitespace().collect();
    let (names, piece_axes) = match words[..] {
        ["LIST", ref rest @ ..] => (header.list.clone(), rest.first().copied()),
        [pattern, first, last, step, ref rest @ ..] if pattern.contains('%') => {
            let numbers = [first, last, step].map(|w| w.parse::<i64>().ok());
            let [Some(first), Some(last), Some(step)] = numbers else {
                return Err(fail(format!(
                    "has an invalid pattern of data files: \"{named}\"; it must be PATTERN FIRST LAST STEP"
                )));
            };
            (
                numbered(pattern, first, last, step).map_err(fail)?,
                rest.first().copied(),
            )
        }
        _ => (vec![named.to_owned()], None),
    };
    if names.is_empty() || names.len() > MAX_FILES {
        return Err(fail(format!(
            "names {} data files; 1 to {MAX_FILES} can be read",
            names.len()
        )));
    }
    if let Some(word) = piece_axes {
        check_pieces(word, names.len(), &axes.sizes).map_err(fail)?;
    }
    names
        .iter()
        .map(|n| sibling_file(path, n.trim()))
        .collect::<Result<Vec<_>>>()
        .map(Some)
}

/// Checks the number of data files if each holds the first `word` axes: one file for every index of
/// the other axes. Files of all axes divide the slowest one.
fn check_pieces(word: &str, files: usize, sizes: &[usize]) -> Result<(), String> {
    let axes = word
        .parse::<usize>()
        .ok()
        .filter(|n| (1..=sizes.len()).contains(n));
    let axes = axes.ok_or_else(|| {
        format!(
            "has data files of \"{word}\" axes each; it must be a number from 1 to {}",
            sizes.len()
        )
    })?;
    let needed = sizes[axes..].iter().try_fold(1usize, |n, &d| n.checked_mul(d));
    if axes < sizes.len() && needed != Some(files) {
        return Err(format!(
            "names {files} data files of {axes} axes each; its sizes need {}",
            needed.unwrap_or(usize::MAX)
        ));
    }
    Ok(())
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

/// The kind of the axis of components, in lower case; none without such an axis or a kind.
fn components_kind(header: &Header, axes: &Axes) -> Option<String> {
    let kind = header.get("kinds")?.split_whitespace().nth(axes.components?)?;
    Some(kind.to_ascii_lowercase())
}

/// Refuses kinds whose values cannot be shown together, unless one of them is chosen.
fn check_kind(path: &Path, kind: Option<&str>, choice: &ReadOptions) -> Result<()> {
    match kind {
        Some(kind) if kind.ends_with("-matrix") && choice.channel.is_none() => Err(Error::file(
            path,
            format!(
                "holds matrices (of the kind \"{kind}\"), which cannot be shown; choose one of their numbers with --channel"
            ),
        )),
        Some(kind @ ("hsv-color" | "xyz-color")) if choice.channel.is_none() => Err(Error::file(
            path,
            format!(
                "holds colours of the kind \"{kind}\"; only RGB-color and RGBA-color can be shown; convert it or choose a channel with --channel"
            ),
        )),
        _ => Ok(()),
    }
}

/// The meaning of the values, from the kind of the component axis.
fn meaning(kind: Option<&str>) -> Meaning {
    match kind {
        Some("rgb-color" | "rgba-color" | "3-color" | "4-color") => Meaning::Color,
        Some("vector" | "covariant-vector" | "normal" | "3-vector" | "3-gradient" | "3-normal") => {
            Meaning::Vectors
        }
        Some("quaternion" | "complex") => Meaning::Channels(Vec::new()),
        _ => Meaning::Unstated,
    }
}

/// The axes and the type of the values, from the header.
fn axes_and_type(path: &Path, header: &Header, segmented: bool) -> Result<(Axes, ScalarType)> {
    let fail = |problem: String| Error::file(path, problem);
    let need = |name: &str| required(path, header, name);
    let text = need("sizes")?;
    let sizes = text
        .split_whitespace()
        .map(|w| w.parse::<usize>().ok().filter(|&n| n > 0))
        .collect::<Option<Vec<_>>>()
        .ok_or_else(|| {
            fail(format!(
                "has the sizes \"{text}\", which are not positive numbers"
            ))
        })?;
    let dimension = need("dimension")?;
    if dimension.parse() != Ok(sizes.len()) {
        return Err(fail(format!(
            "has the dimension \"{dimension}\" and {} sizes; its header is damaged",
            sizes.len()
        )));
    }
    if !(1..=5).contains(&sizes.len()) {
        return Err(fail(format!(
            "has {} axes; images of 1 to 3, one axis of components and one of time can be read",
            sizes.len()
        )));
    }
    let name = need("type")?;
    if name.eq_ignore_ascii_case("block") {
        return Err(fail(
            "has the type \"block\", opaque blocks of bytes that are not numbers; they cannot be shown"
                .into(),
        ));
    }
    let scalar =
        scalar_type(name).ok_or_else(|| fail(format!("has the type \"{name}\", which is not supported")))?;
    Ok((axes(header, sizes, segmented).map_err(fail)?, scalar))
}

fn scalar_type(name: &str) -> Option<ScalarType> {
    Some(match name.to_ascii_lowercase().as_str() {
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => ScalarType::U8,
        "signed char" | "char" | "int8" | "int8_t" => ScalarType::I8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => ScalarType::I16,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => ScalarType::U16,
        "int" | "signed int" | "int32" | "int32_t" => ScalarType::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => ScalarType::U32,
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "signed long long int"
        | "int64"
        | "int64_t" => ScalarType::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => {
            ScalarType::U64
        }
        "float" => ScalarType::F32,
        "double" => ScalarType::F64,
        _ => return None,
    })
}

/// The role of each axis: from kinds, from missing directions, else the first three are spatial. A
/// list is time, or components if it is short; in a segmentation it holds the layers.
fn axes(header: &Header, sizes: Vec<usize>, segmented: bool) -> Result<Axes, String> {
    let kinds: Vec<String> = header.get("kinds").map_or(Vec::new(), |k| {
        k.split_whitespace().map(str::to_ascii_lowercase).collect()
    });
    let directions: Vec<Option<DVec3>> = header
        .get("space directions")
        .map_or(Vec::new(), |d| words(d).iter().map(|w| vector(w)).collect());
    let direction_words = header.get("space directions").map_or(Vec::new(), words);
    let map = header.keys.contains_key(MAP_KEY);
    let (mut components, mut time, mut spatial) = (None, None, Vec::new());
    for (axis, &size) in sizes.iter().enumerate() {
        let kind = kinds.get(axis).map_or("???", String::as_str);
        let direction = directions.get(axis).copied().flatten();
        let none = direction_words
            .get(axis)
            .is_some_and(|d| d.eq_ignore_ascii_case("none"))
            || direction.is_some_and(|d| d.is_nan_mask().all());
        // The step of a time axis has no part in space: (0,0,0,t).
        let in_time = direction == Some(DVec3::ZERO)
            && direction_words
                .get(axis)
                .is_some_and(|d| d.matches(',').count() == 3);
        let is_time = kind == "time" || (kind == "list" && !map && !segmented && size > 4) || in_time;
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
