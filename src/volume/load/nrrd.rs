//! NRRD, attached (`.nrrd`) or detached (`.nhdr`, in one data file or many), raw, gzip, bzip2, text
//! or hex; up to three spatial axes, one of components and one of time, in any order.
//!
//! *Geometry*: `space directions` and `space origin` in the space given by the file, converted to
//! LPS; else `spacings` (or `axis mins` and `axis maxs`) and `axis mins`. Vectors are given in that
//! space, unless a `measurement frame` is given. Source: the NRRD format definition (Kindlmann,
//! teem 1.11).

use super::super::StoredValues;
use super::super::colors::Label;
use super::ReadOptions;
use super::ScalarType;
use super::image::{Image, Layout, Meaning};
use super::source::{
    BZIP2_LIMIT, ConcatenatedFiles, DEFLATE_LIMIT, OpenPiece, ValueReader, buffered, check_end, check_held, count, open_file, read_error,
    sibling_file, skip, usable,
};
use crate::{Error, Result, Watch};
use bzip2::read::MultiBzDecoder;
use flate2::read::MultiGzDecoder;
use glam::{DAffine3, DMat3, DVec3};
use ndarray::{Axis, IxDyn};
use serde_json::json;
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Maximum header length, bytes: a file without an empty line is not NRRD.
const MAX_HEADER_BYTES: u64 = 1 << 20;
/// Maximum number of data files of a detached header.
const MAX_FILES: usize = 100_000;
/// Key that identifies this program's displacement maps.
const MAP_KEY: &str = "incise";

/// The encoding of the values.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Raw,
    Gzip,
    Bzip2,
    Text,
    Hex,
}

/// The role of each axis.
struct Axes {
    sizes: Vec<usize>,
    spatial: Vec<usize>,
    components: Option<usize>,
    time: Option<usize>,
}

/// Reads an image.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    let (mut reader, file_bytes) = buffered(path)?;
    let fields = header(path, &mut reader)?;
    let get = |name: &str| fields.get(name).map(String::as_str);
    let need = |name: &str| get(name).ok_or_else(|| fail(format!("has no field \"{name}\" in its header; it is damaged")));
    let whole = |text: &str| text.split_whitespace().map(|w| w.parse::<usize>().ok().filter(|&n| n > 0)).collect::<Option<Vec<_>>>();
    let sizes =
        whole(need("sizes")?).ok_or_else(|| fail(format!("has the sizes \"{}\", which are not positive numbers", get("sizes").unwrap_or(""))))?;
    if need("dimension")?.trim().parse() != Ok(sizes.len()) || !(1..=5).contains(&sizes.len()) {
        return Err(fail(format!("has {} axes; images of 1 to 3, one axis of components and one of time can be read", sizes.len())));
    }
    let scalar = scalar_type(need("type")?).ok_or_else(|| fail(format!("has the type \"{}\", which is not supported", get("type").unwrap_or(""))))?;
    let axes = axes(&fields, sizes).map_err(&fail)?;
    let total = count(path, &axes.sizes, scalar)?;
    let mut warnings = Vec::new();
    let (world_from_voxel, frame) = geometry(&fields, &axes.spatial, axes.sizes.len(), &mut warnings).map_err(&fail)?;
    let encoding = match need("encoding")?.trim().to_ascii_lowercase().as_str() {
        "raw" => Encoding::Raw,
        "gzip" | "gz" => Encoding::Gzip,
        "bzip2" | "bz2" => Encoding::Bzip2,
        "ascii" | "text" | "txt" => Encoding::Text,
        "hex" => Encoding::Hex,
        other => return Err(fail(format!("is encoded as \"{other}\", which cannot be read; save it as raw or gzip"))),
    };
    let swap = scalar.bytes() > 1
        && match need("endian").map(str::trim) {
            Ok("little") => cfg!(target_endian = "big"),
            Ok("big") => cfg!(target_endian = "little"),
            Ok(other) => return Err(fail(format!("has the byte order \"{other}\"; it must be little or big"))),
            Err(e) if encoding != Encoding::Text => return Err(e),
            Err(_) => false,
        };
    let number = |names: [&str; 2]| {
        let text = get(names[0]).or(get(names[1]));
        text.map_or(Ok(0i64), |t| t.trim().parse()).map_err(|_| fail(format!("has a {} that is not a number", names[0])))
    };
    let (line_skip, byte_skip) = (number(["line skip", "lineskip"])?, number(["byte skip", "byteskip"])?);
    if line_skip < 0 || byte_skip < -1 {
        return Err(fail("skips a negative number of lines or bytes; its header is damaged".into()));
    }

    // If the time axis is the slowest, other times are skipped while reading; otherwise they are
    // removed afterwards.
    let frames = axes.time.map_or(1, |t| axes.sizes[t]);
    let time = choice.time_of(frames)?;
    let slowest = axes.time.is_some_and(|t| t + 1 == axes.sizes.len());
    let (stored, ahead) = if slowest { (total / frames, total / frames * time) } else { (total, 0) };
    let data = Data { path, scalar, swap, encoding, line_skip: line_skip as u64, byte_skip, whole: total, watch };
    let pieces = data_files(path, &fields, &axes)?;
    let voxels = match pieces {
        None => data.read(path, reader, file_bytes, [ahead, stored], slowest && time + 1 < frames)?,
        Some(files) if files.len() == 1 => {
            let (reader, file_bytes) = buffered(&files[0])?;
            data.read(&files[0], reader, file_bytes, [ahead, stored], slowest && time + 1 < frames)?
        }
        Some(files) => data.read_pieces(files, total, [ahead, stored])?,
    };
    let (voxels, components, layout) = arranged(voxels, &axes, if slowest { None } else { Some(time) });
    let size: [usize; 3] = std::array::from_fn(|a| axes.spatial.get(a).map_or(1, |&s| axes.sizes[s]));
    let mut image = Image::new("NRRD", voxels, size, world_from_voxel);
    (image.components, image.layout, image.frame) = (components, layout, Some(frame));
    image.displacement = get(MAP_KEY) == Some("displacement map 1");
    image.meaning = meaning(&fields, &axes);
    if frames > 1 {
        if choice.time.is_none() {
            warnings.push(format!("holds {frames} volumes; the first is used (--time chooses another)"));
        }
        image.details.push(("time_points", json!(frames)));
    }
    image.warnings = warnings;
    Ok(image)
}

/// How to read the values.
struct Data<'a> {
    path: &'a Path,
    scalar: ScalarType,
    swap: bool,
    encoding: Encoding,
    line_skip: u64,
    byte_skip: i64,
    /// Number of values of all times.
    whole: usize,
    watch: &'a Watch<'a>,
}

impl Data<'_> {
    /// Reads `[ahead, count]`: skips values and reads values, from the reader's position.
    fn read(&self, path: &Path, mut reader: BufReader<File>, file_bytes: u64, [ahead, count]: [usize; 2], more: bool) -> Result<StoredValues> {
        let size = self.scalar.bytes() as u64;
        let (before, bytes) = (ahead as u64 * size, count as u64 * size);
        skip_lines(path, &mut reader, self.line_skip)?;
        let byte_skip = self.byte_skip.max(0) as u64;
        match self.encoding {
            Encoding::Raw => {
                check_held(path, before.saturating_add(bytes), file_bytes)?;
                if self.byte_skip < 0 {
                    // Located at the file's end.
                    let all = self.whole as u64 * size;
                    check_held(path, all, file_bytes)?;
                    reader.seek(SeekFrom::End(-(all as i64))).map_err(|e| read_error(path, e))?;
                }
                skip(path, &mut reader, byte_skip.saturating_add(before))?;
                self.source(path, reader, count).read_as(self.scalar)
            }
            Encoding::Gzip | Encoding::Bzip2 => {
                let limit = if self.encoding == Encoding::Gzip { DEFLATE_LIMIT } else { BZIP2_LIMIT };
                check_held(path, before.saturating_add(bytes), file_bytes.saturating_mul(limit))?;
                let mut decoder: Box<dyn Read + Send> =
                    if self.encoding == Encoding::Gzip { Box::new(MultiGzDecoder::new(reader)) } else { Box::new(MultiBzDecoder::new(reader)) };
                skip(path, &mut decoder, byte_skip.saturating_add(before))?;
                let mut source = self.source(path, decoder, count);
                let voxels = source.read_as(self.scalar)?;
                if !more {
                    check_end(path, source.reader)?;
                }
                Ok(voxels)
            }
            Encoding::Text => {
                skip(path, &mut reader, byte_skip)?;
                // A value and its separator take at least two bytes.
                check_held(path, (ahead as u64 + count as u64).saturating_mul(2).saturating_sub(1), file_bytes)?;
                super::text::values(path, reader, [ahead, count], self.scalar, self.watch)
            }
            Encoding::Hex => {
                skip(path, &mut reader, byte_skip)?;
                check_held(path, before.saturating_add(bytes).saturating_mul(2), file_bytes)?;
                let mut hex = Hex { reader };
                skip(path, &mut hex, before)?;
                self.source(path, hex, count).read_as(self.scalar)
            }
        }
    }

    /// Reads values divided evenly among many files.
    fn read_pieces(&self, files: Vec<PathBuf>, total: usize, [ahead, count]: [usize; 2]) -> Result<StoredValues> {
        let fail = |problem: String| Error::file(self.path, problem);
        if !total.is_multiple_of(files.len()) {
            return Err(fail(format!("names {} data files, which cannot hold equal parts of its {total} values", files.len())));
        }
        if self.line_skip > 0 || self.byte_skip > 0 || matches!(self.encoding, Encoding::Text | Encoding::Hex) {
            return Err(fail("has several data files that are not raw, gzip or bzip2 from their first byte on; join them into one".into()));
        }
        let size = self.scalar.bytes() as u64;
        let piece = (total / files.len()) as u64 * size;
        let mut most = 0u64;
        for file in &files {
            most = most.saturating_add(open_file(file)?.1);
        }
        let (open, limit): (OpenPiece, u64) = match (self.encoding, self.byte_skip) {
            (Encoding::Gzip, _) => (|p, _| Ok(Box::new(MultiGzDecoder::new(buffered(p)?.0))), DEFLATE_LIMIT),
            (Encoding::Bzip2, _) => (|p, _| Ok(Box::new(MultiBzDecoder::new(buffered(p)?.0))), BZIP2_LIMIT),
            (_, -1) => (last_bytes, 1),
            _ => (|p, _| Ok(Box::new(buffered(p)?.0)), 1),
        };
        check_held(self.path, total as u64 * size, most.saturating_mul(limit))?;
        let mut chain = ConcatenatedFiles::new(files, piece, open);
        skip(self.path, &mut chain, ahead as u64 * size)?;
        self.source(self.path, chain, count).read_as(self.scalar)
    }

    fn source<'b, R: Read>(&'b self, path: &'b Path, reader: R, count: usize) -> ValueReader<'b, R> {
        ValueReader { path, reader, swap: self.swap, count, watch: self.watch }
    }
}

/// The last `bytes` of a file.
pub(super) fn last_bytes(path: &Path, bytes: u64) -> Result<Box<dyn Read + Send>> {
    let (mut reader, length) = buffered(path)?;
    check_held(path, bytes, length)?;
    reader.seek(SeekFrom::Start(length - bytes)).map_err(|e| read_error(path, e))?;
    Ok(Box::new(reader))
}

/// Skips whole lines.
fn skip_lines(path: &Path, reader: &mut impl BufRead, lines: u64) -> Result<()> {
    for _ in 0..lines {
        if reader.skip_until(b'\n').map_err(|e| read_error(path, e))? == 0 {
            return Err(read_error(path, std::io::ErrorKind::UnexpectedEof.into()));
        }
    }
    Ok(())
}

/// Bytes written as two hexadecimal digits each; white space is ignored.
struct Hex<R> {
    reader: BufReader<R>,
}

impl<R: Read> Read for Hex<R> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let mut digit = || -> std::io::Result<Option<u8>> {
            loop {
                let Some(&byte) = self.reader.fill_buf()?.first() else { return Ok(None) };
                self.reader.consume(1);
                if !byte.is_ascii_whitespace() {
                    let digit = char::from(byte).to_digit(16).ok_or_else(|| std::io::Error::new(std::io::ErrorKind::InvalidData, "no hex digit"))?;
                    return Ok(Some(digit as u8));
                }
            }
        };
        let mut done = 0;
        while done < bytes.len() {
            let Some(high) = digit()? else { break };
            let low = digit()?.ok_or(std::io::ErrorKind::UnexpectedEof)?;
            bytes[done] = high << 4 | low;
            done += 1;
        }
        Ok(done)
    }
}

/// Files with the values, if the header is detached: one, a list, or a pattern with numbers.
fn data_files(path: &Path, fields: &HashMap<String, String>, axes: &Axes) -> Result<Option<Vec<PathBuf>>> {
    let Some(named) = fields.get("data file").or(fields.get("datafile")) else { return Ok(None) };
    let fail = |problem: String| Error::file(path, problem);
    let of = |names: Vec<String>| {
        if names.is_empty() || names.len() > MAX_FILES {
            return Err(fail(format!("names {} data files; 1 to {MAX_FILES} can be read", names.len())));
        }
        names.iter().map(|n| sibling_file(path, n.trim())).collect::<Result<Vec<_>>>().map(Some)
    };
    let words: Vec<&str> = named.split_whitespace().collect();
    if words.first() == Some(&"LIST") {
        if words.get(1).and_then(|w| w.parse::<usize>().ok()).is_some_and(|n| n + 1 < axes.sizes.len()) {
            return Err(fail("has data files of less than a slice each; join them into one".into()));
        }
        return of(fields.get(LIST_KEY).map_or(Vec::new(), |l| l.lines().map(str::to_owned).collect()));
    }
    if let [pattern, first, last, step, ..] = words[..]
        && pattern.contains('%')
    {
        let numbers = [first, last, step].map(|w| w.parse::<i64>().ok());
        let [Some(first), Some(last), Some(step)] = numbers else {
            return Err(fail(format!("has an invalid pattern of data files: \"{named}\"; it must be PATTERN FIRST LAST STEP")));
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
    let after = after.strip_prefix(['d', 'i', 'u']).filter(|a| !a.contains('%')).ok_or_else(unclear)?;
    let digits = width.parse::<usize>().unwrap_or(0).min(32);
    if last.checked_sub(first).and_then(|d| d.checked_div(step)).is_none_or(|n| n < 0 || n >= MAX_FILES as i64) {
        return Err(format!("numbers its data files from {first} to {last} by {step}, which is not a valid sequence"));
    }
    let zero = width.starts_with('0');
    Ok((0..=(last - first) / step)
        .map(|n| first + n * step)
        .map(|n| if zero { format!("{before}{n:0digits$}{after}") } else { format!("{before}{n:digits$}{after}") })
        .collect())
}

/// Values in voxel order: one time selected, components first or last.
fn arranged(voxels: StoredValues, axes: &Axes, time: Option<usize>) -> (StoredValues, usize, Layout) {
    let components = axes.components.map_or(1, |c| axes.sizes[c]);
    let other_axes: Vec<usize> = (0..axes.sizes.len()).filter(|a| Some(*a) != axes.time).collect();
    let place = axes.components.and_then(|c| other_axes.iter().position(|a| *a == c));
    let layout = if place == Some(0) { Layout::Interleaved } else { Layout::Planar };
    let in_order = place.is_none_or(|p| p == 0 || p + 1 == other_axes.len());
    if in_order && (axes.time.is_none() || time.is_none()) {
        return (voxels, components, layout);
    }
    // Slowest first, as arrays are indexed. A slowest time axis was skipped while reading.
    let mut remaining: Vec<usize> = (0..axes.sizes.len()).rev().filter(|a| time.is_some() || Some(*a) != axes.time).collect();
    let shape: Vec<usize> = remaining.iter().map(|&a| axes.sizes[a]).collect();
    let mut array = voxels.reshaped(IxDyn(&shape));
    if let Some((axis, t)) = axes.time.zip(time)
        && let Some(place) = remaining.iter().position(|a| *a == axis)
    {
        array = array.at_index(Axis(place), t);
        remaining.remove(place);
    }
    let wanted = axes.components.into_iter().chain(axes.spatial.iter().rev().copied());
    let order: Vec<usize> = wanted.filter_map(|axis| remaining.iter().position(|a| *a == axis)).collect();
    let count = array.len();
    (array.permuted(IxDyn(&order)).reshaped(count), components, Layout::Planar)
}

/// The meaning of the values: from the kind of the component axis, or from 3D Slicer's segment
/// fields.
fn meaning(fields: &HashMap<String, String>, axes: &Axes) -> Meaning {
    let segments = fields.keys().filter_map(|k| k.strip_prefix("segment")?.strip_suffix("_labelvalue")).filter(|n| n.parse::<u32>().is_ok());
    let mut labels: Vec<Label> = segments
        .filter_map(|n| {
            let get = |key: &str| fields.get(&format!("segment{n}_{key}"));
            let value = get("labelvalue")?.trim().parse().ok()?;
            let shares: Vec<f32> = get("color").map_or(Vec::new(), |c| c.split_whitespace().map_while(|w| w.parse().ok()).collect());
            let color = <[f32; 3]>::try_from(shares).ok().map(|c| c.map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
            Some(Label { value, name: get("name").cloned().unwrap_or_default(), color })
        })
        .collect();
    if !labels.is_empty() {
        labels.sort_by_key(|l| l.value);
        return Meaning::Labels(labels);
    }
    let kind = axes.components.and_then(|c| fields.get("kinds")?.split_whitespace().nth(c).map(str::to_ascii_lowercase));
    match kind.as_deref() {
        Some("rgb-color" | "rgba-color" | "3-color" | "4-color") => Meaning::Color,
        Some("vector" | "covariant-vector" | "normal" | "3-vector" | "3-gradient" | "3-normal") => Meaning::Vectors,
        _ => Meaning::Unstated,
    }
}

/// Key of the lines after `data file: LIST`.
const LIST_KEY: &str = "\n";

/// The fields of the header, with names in lower case; leaves the reader after the empty line that
/// ends the header.
fn header(path: &Path, reader: &mut impl BufRead) -> Result<HashMap<String, String>> {
    let mut fields = HashMap::new();
    let mut reader = reader.take(MAX_HEADER_BYTES);
    let mut line = Vec::new();
    let (mut first, mut list) = (true, false);
    loop {
        line.clear();
        let read = reader.read_until(b'\n', &mut line).map_err(|e| read_error(path, e))?;
        let text = String::from_utf8_lossy(&line);
        let text = text.trim_end_matches(['\n', '\r']);
        if first {
            if !text.starts_with("NRRD000") {
                return Err(Error::file(path, "is not an NRRD file (it does not start with NRRD000)"));
            }
            first = false;
            continue;
        }
        if text.is_empty() {
            if read == 0 && !fields.contains_key("data file") && !fields.contains_key("datafile") {
                return Err(Error::file(path, "ends within its header: the file is truncated; copy or download it again"));
            }
            return Ok(fields);
        }
        if list {
            let files = fields.entry(LIST_KEY.to_owned()).or_default();
            files.push_str(text);
            files.push('\n');
            continue;
        }
        if text.starts_with('#') {
            continue;
        }
        if let Some((name, value)) = text.split_once(":=").or_else(|| text.split_once(": ")) {
            let name = name.trim().to_ascii_lowercase();
            // Nothing else follows a list of files.
            list = matches!(name.as_str(), "data file" | "datafile") && value.trim().starts_with("LIST");
            fields.insert(name, value.trim().to_owned());
        }
    }
}

fn scalar_type(name: &str) -> Option<ScalarType> {
    Some(match name.trim() {
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => ScalarType::U8,
        "signed char" | "int8" | "int8_t" => ScalarType::I8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => ScalarType::I16,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => ScalarType::U16,
        "int" | "signed int" | "int32" | "int32_t" => ScalarType::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => ScalarType::U32,
        "longlong" | "long long" | "long long int" | "signed long long" | "int64" | "int64_t" => ScalarType::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => ScalarType::U64,
        "float" => ScalarType::F32,
        "double" => ScalarType::F64,
        _ => return None,
    })
}

/// The role of each axis: from kinds, from missing directions, else the first three are spatial.
fn axes(fields: &HashMap<String, String>, sizes: Vec<usize>) -> Result<Axes, String> {
    let kinds: Vec<String> = fields.get("kinds").map_or(Vec::new(), |k| k.split_whitespace().map(str::to_ascii_lowercase).collect());
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
    Ok(Axes { sizes, spatial, components, time })
}

fn vector(text: &str) -> Option<DVec3> {
    let inner = text.trim().strip_prefix('(')?.strip_suffix(')')?;
    let v: Vec<f64> = inner.split(',').map_while(|c| c.trim().parse().ok()).collect();
    match v[..] {
        [x, y, z] => Some(DVec3::new(x, y, z)),
        [x, y] => Some(DVec3::new(x, y, 0.0)),
        _ => None,
    }
}

/// Splits `(a,b,c) (d, e, f) none` into words.
fn words(text: &str) -> Vec<String> {
    let mut out = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        let end =
            if rest.starts_with('(') { rest.find(')').map_or(rest.len(), |e| e + 1) } else { rest.find(char::is_whitespace).unwrap_or(rest.len()) };
        out.push(rest[..end].to_owned());
        rest = rest[end..].trim_start();
    }
    out
}

/// World from voxel, and world (LPS) from the axes of the vectors.
fn geometry(fields: &HashMap<String, String>, spatial: &[usize], axes: usize, warnings: &mut Vec<String>) -> Result<(DAffine3, DMat3), String> {
    let space = fields.get("space").map(|s| s.to_ascii_lowercase());
    let lps_from_space = match space.as_deref() {
        Some("left-posterior-superior" | "lps" | "left-posterior-superior-time" | "lpst") => DVec3::ONE,
        Some("right-anterior-superior" | "ras" | "right-anterior-superior-time" | "rast") => DVec3::new(-1.0, -1.0, 1.0),
        Some("left-anterior-superior" | "las" | "left-anterior-superior-time" | "last") => DVec3::new(1.0, -1.0, 1.0),
        Some("3d-right-handed" | "scanner-xyz") => DVec3::ONE,
        Some(other) => {
            warnings.push(format!("its space \"{other}\" is not a patient space; left, posterior, superior axes are assumed"));
            DVec3::ONE
        }
        None => {
            if !fields.contains_key("space dimension") {
                warnings.push("has no orientation; left, posterior, superior axes are assumed".into());
            }
            DVec3::ONE
        }
    };
    let units = fields.get("space units").map(|u| u.split_whitespace().map(|w| mm_of(w.trim_matches('"'))).collect::<Vec<_>>());
    let mm = DVec3::from_array(std::array::from_fn(|a| units.as_ref().and_then(|u| u.get(a).copied().flatten()).unwrap_or(1.0)));
    let lps_from_space = DMat3::from_diagonal(lps_from_space * mm);
    let mut linear = DMat3::IDENTITY;
    if let Some(directions) = fields.get("space directions") {
        let all = words(directions);
        for (n, &axis) in spatial.iter().enumerate() {
            *linear.col_mut(n) =
                all.get(axis).and_then(|w| vector(w)).ok_or_else(|| format!("has the space directions \"{directions}\", which cannot be read"))?;
        }
        // A plane or line in space: the missing directions are perpendicular to it.
        match spatial.len() {
            2 => linear.z_axis = linear.x_axis.cross(linear.y_axis).normalize_or(DVec3::Z),
            1 => {
                let (y, z) = linear.x_axis.normalize_or(DVec3::X).any_orthonormal_pair();
                (linear.y_axis, linear.z_axis) = (y, z);
            }
            _ => {}
        }
    }
    let mut origin = DVec3::ZERO;
    if !fields.contains_key("space directions") {
        let numbers = |name: &str| fields.get(name).map(|t| t.split_whitespace().map(|w| w.parse().unwrap_or(f64::NAN)).collect::<Vec<f64>>());
        let unit = |axis: usize| fields.get("units").and_then(|u| mm_of(words(u).get(axis)?.trim_matches('"'))).unwrap_or(1.0);
        let cell = |axis: usize| fields.get("centers").or(fields.get("centerings")).is_some_and(|c| c.split_whitespace().nth(axis) == Some("cell"));
        let (mins, maxs, sizes) = (numbers("axis mins"), numbers("axis maxs"), numbers("sizes").unwrap_or_default());
        for (n, &axis) in spatial.iter().enumerate() {
            let min = mins.as_ref().and_then(|m| m.get(axis)).copied().filter(|v| v.is_finite());
            let max = maxs.as_ref().and_then(|m| m.get(axis)).copied().filter(|v| v.is_finite());
            if let (Some(min), Some(max), Some(&size)) = (min, max, sizes.get(axis))
                && !fields.contains_key("spacings")
            {
                let steps = if cell(axis) { size } else { size - 1.0 };
                if steps >= 1.0 && max != min {
                    *linear.col_mut(n) *= (max - min) / steps * unit(axis);
                }
            }
            let shift = if cell(axis) { 0.5 } else { 0.0 };
            let spacing = numbers("spacings").and_then(|s| s.get(axis).copied()).filter(|s| s.is_finite()).unwrap_or(linear.col(n)[n] / unit(axis));
            origin[n] = min.map_or(0.0, |m| (m + shift * spacing) * unit(axis));
        }
    }
    if !fields.contains_key("space directions")
        && let Some(spacings) = fields.get("spacings")
    {
        let all: Vec<f64> = spacings.split_whitespace().map(|w| w.parse().unwrap_or(f64::NAN)).collect();
        if all.len() != axes {
            return Err(format!("has the spacings \"{spacings}\" for {axes} axes"));
        }
        for (n, &axis) in spatial.iter().enumerate() {
            if all[axis].is_finite() && all[axis] != 0.0 {
                let unit = fields.get("units").and_then(|u| mm_of(words(u).get(axis)?.trim_matches('"'))).unwrap_or(1.0);
                *linear.col_mut(n) *= all[axis] * unit;
            }
        }
    }
    let origin = fields.get("space origin").map_or(Some(origin), |o| vector(o)).ok_or("has a space origin that cannot be read")?;
    let affine = DAffine3 { matrix3: lps_from_space * linear, translation: lps_from_space * origin };
    if !usable(&affine) {
        return Err("has singular space directions; its geometry cannot be used".into());
    }
    let frame = match fields.get("measurement frame") {
        Some(text) => {
            let columns: Vec<DVec3> = words(text).iter().filter_map(|w| vector(w)).collect();
            let [x, y, z] = columns[..] else { return Err(format!("has the measurement frame \"{text}\", which cannot be read")) };
            DMat3::from_cols(x, y, z)
        }
        None => DMat3::IDENTITY,
    };
    Ok((affine, lps_from_space * frame))
}

/// Millimetres per unit of length; none if it is not a unit of length.
fn mm_of(unit: &str) -> Option<f64> {
    Some(match unit.to_ascii_lowercase().as_str() {
        "mm" | "millimeter" | "millimeters" | "millimetre" => 1.0,
        "um" | "µm" | "μm" | "micron" | "microns" | "micrometer" | "micrometers" => 1e-3,
        "nm" | "nanometer" | "nanometers" => 1e-6,
        "cm" | "centimeter" | "centimeters" => 10.0,
        "m" | "meter" | "meters" => 1000.0,
        _ => return None,
    })
}
