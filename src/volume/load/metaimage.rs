//! MetaImage, `.mha` or `.mhd` with its data beside it in one file or many, raw, zlib or text, scalar or with several channels.
//!
//! *Geometry*: `Offset` and `TransformMatrix` (three consecutive numbers are one axis' direction) in LPS, as ITK writes them.
//! Source: the MetaIO format (ITK, MetaImage documentation).

use super::ReadOptions;
use super::ScalarType;
use super::image::Image;
use super::nrrd::{last_bytes, numbered};
use super::source::{
    ConcatenatedFiles, DEFLATE_LIMIT, OpenPiece, ValueReader, buffered, check_held, count, open_file, read_error, sibling_file, skip, usable,
};
use crate::{Error, Result, Watch};
use flate2::read::ZlibDecoder;
use glam::{DAffine3, DMat3, DVec3};
use serde_json::json;
use std::collections::HashMap;
use std::io::{BufRead, Read};
use std::path::{Path, PathBuf};

/// Most data files of a list.
const MAX_FILES: usize = 100_000;
/// Longest header that is read.
const MAX_HEADER_BYTES: u64 = 1 << 20;

/// Reads an image.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    let (mut reader, mut file_bytes) = buffered(path)?;
    let fields = header(path, &mut reader)?;
    let get = |names: &[&str]| names.iter().find_map(|n| fields.get(*n)).map(String::as_str);
    let numbers = |text: &str| text.split_whitespace().map(|w| w.parse::<f64>().ok().filter(|v| v.is_finite())).collect::<Option<Vec<f64>>>();
    let need = |name: &str| get(&[name]).ok_or_else(|| fail(format!("has no \"{name}\" in its header; it is not a MetaImage, or it is damaged")));
    let size_text = need("dimsize")?;
    let sizes: Vec<usize> = size_text
        .split_whitespace()
        .map(|w| w.parse::<usize>().ok().filter(|&n| n > 0))
        .collect::<Option<_>>()
        .ok_or_else(|| fail(format!("has the size \"{size_text}\", which is not a list of positive numbers")))?;
    if !(1..=4).contains(&sizes.len()) {
        return Err(fail(format!("has {} axes; images of 1 to 3 can be read", sizes.len())));
    }
    let mut warnings = Vec::new();
    let frames = sizes.get(3).copied().unwrap_or(1);
    let time = choice.time_of(frames)?;
    if frames > 1 && choice.time.is_none() {
        warnings.push(format!("holds {frames} volumes; the first is used (--time chooses another)"));
    }
    let size: [usize; 3] = std::array::from_fn(|a| sizes.get(a).copied().unwrap_or(1));
    let components = match get(&["elementnumberofchannels"]) {
        Some(t) => {
            t.parse::<usize>().ok().filter(|c| (1..=1024).contains(c)).ok_or_else(|| fail(format!("has the invalid channel count \"{t}\"")))?
        }
        None => 1,
    };
    let type_name = need("elementtype")?;
    let scalar = scalar_type(type_name).ok_or_else(|| fail(format!("has the element type \"{type_name}\", which is not supported")))?;
    let stored = count(path, &[size[0], size[1], size[2], components], scalar)?;
    let list = |names: &[&str], n: usize| {
        get(names)
            .map(|t| numbers(t).filter(|v| v.len() >= n).ok_or_else(|| fail(format!("has the invalid value \"{t}\" for {}", names[0]))))
            .transpose()
    };
    let rank = sizes.len();
    let spacing = list(&["elementspacing", "elementsize"], rank)?;
    let origin = list(&["offset", "position", "origin"], rank)?;
    let matrix = list(&["transformmatrix", "rotation", "orientation"], rank * rank)?;
    let mut linear = DMat3::IDENTITY;
    for a in 0..rank.min(3) {
        let direction =
            matrix.as_ref().map_or(DVec3::AXES[a], |m| DVec3::from_array(std::array::from_fn(|c| if c < rank { m[a * rank + c] } else { 0.0 })));
        *linear.col_mut(a) = direction * spacing.as_ref().map_or(1.0, |s| s[a].abs());
    }
    let translation = origin.map_or(DVec3::ZERO, |o| DVec3::from_array(std::array::from_fn(|c| if c < rank { o[c] } else { 0.0 })));
    let world_from_voxel = DAffine3 { matrix3: linear, translation };
    if !usable(&world_from_voxel) {
        return Err(fail("has singular axes; its geometry cannot be used".into()));
    }
    let data = need("elementdatafile")?;
    let yes = |names: &[&str]| get(names).is_some_and(|t| t.eq_ignore_ascii_case("true") || t == "1");
    let text = get(&["binarydata"]).is_some_and(|t| t.eq_ignore_ascii_case("false"));
    let big = yes(&["binarydatabyteordermsb", "elementbyteordermsb"]);
    let swap = scalar.bytes() > 1 && big != cfg!(target_endian = "big");
    let compressed = yes(&["compresseddata"]);
    let bytes = (stored * scalar.bytes()) as u64;
    let ahead = bytes.saturating_mul(time as u64);
    let local = data.eq_ignore_ascii_case("local");
    let header_size = get(&["headersize"]).map_or(Ok(0i64), str::parse).map_err(|_| fail("has a HeaderSize that is not a number".into()))?;
    let pieces = if local { None } else { data_files(path, data, &mut reader)? };
    let voxels = if let Some(files) = pieces {
        let total = stored.checked_mul(frames).filter(|n| n.is_multiple_of(files.len()) && !text && header_size <= 0);
        let total = total.ok_or_else(|| fail(format!("names {} data files, which cannot hold equal parts of its values", files.len())))?;
        let piece = (total / files.len() * scalar.bytes()) as u64;
        let mut most = 0u64;
        for file in &files {
            most = most.saturating_add(open_file(file)?.1);
        }
        check_held(path, ahead.saturating_add(bytes), most.saturating_mul(if compressed { DEFLATE_LIMIT } else { 1 }))?;
        let open: OpenPiece = match (compressed, header_size) {
            (true, _) => |p, _| Ok(Box::new(ZlibDecoder::new(buffered(p)?.0))),
            (false, -1) => last_bytes,
            _ => |p, _| Ok(Box::new(buffered(p)?.0)),
        };
        let mut chain = ConcatenatedFiles::new(files, piece, open);
        skip(path, &mut chain, ahead)?;
        ValueReader { path, reader: chain, swap, count: stored, watch }.read_as(scalar)?
    } else {
        let other = if local { path.to_owned() } else { sibling_file(path, data.trim())? };
        if !local {
            (reader, file_bytes) = buffered(&other)?;
        }
        if text {
            check_held(&other, (ahead / scalar.bytes() as u64 + stored as u64).saturating_mul(2).saturating_sub(1), file_bytes)?;
            super::text::values(&other, reader, [stored * time, stored], scalar, watch)?
        } else if compressed {
            check_held(&other, ahead.saturating_add(bytes), file_bytes.saturating_mul(DEFLATE_LIMIT))?;
            let mut decoder = ZlibDecoder::new(reader);
            skip(&other, &mut decoder, ahead)?;
            ValueReader { path: &other, reader: decoder, swap, count: stored, watch }.read_as(scalar)?
        } else {
            check_held(&other, ahead.saturating_add(bytes), file_bytes)?;
            // -1 counts from the file's end.
            let before = match header_size {
                -1 => file_bytes.saturating_sub(bytes.saturating_mul(frames as u64)),
                n if n > 0 && !local => n as u64,
                _ => 0,
            };
            if local && header_size == -1 {
                reader = buffered(path)?.0;
            }
            skip(&other, &mut reader, before.saturating_add(ahead))?;
            ValueReader { path: &other, reader, swap, count: stored, watch }.read_as(scalar)?
        }
    };
    let mut image = Image::new("MetaImage", voxels, size, world_from_voxel);
    (image.components, image.frame, image.warnings) = (components, Some(DMat3::IDENTITY), warnings);
    if frames > 1 {
        image.details.push(("time_points", json!(frames)));
    }
    Ok(image)
}

/// The data files where there are several: a list of names after the header, or a pattern with numbers.
fn data_files(path: &Path, data: &str, reader: &mut impl BufRead) -> Result<Option<Vec<PathBuf>>> {
    let fail = |problem: String| Error::file(path, problem);
    let words: Vec<&str> = data.split_whitespace().collect();
    let names = if words.first().is_some_and(|w| w.eq_ignore_ascii_case("list")) {
        let mut text = String::new();
        reader.take(MAX_HEADER_BYTES).read_to_string(&mut text).map_err(|_| fail("has a list of data files that is not text in UTF-8".into()))?;
        text.lines().map(str::trim).filter(|l| !l.is_empty()).map(str::to_owned).collect()
    } else if let [pattern, first, last, rest @ ..] = &words[..]
        && pattern.contains('%')
    {
        let step = rest.first().map_or(Ok(1), |w| w.parse());
        let (Ok(first), Ok(last), Ok(step)) = (first.parse(), last.parse(), step) else {
            return Err(fail(format!("has an invalid pattern of data files: \"{data}\"; it must be PATTERN FIRST LAST STEP")));
        };
        numbered(pattern, first, last, step).map_err(fail)?
    } else {
        return Ok(None);
    };
    if names.is_empty() || names.len() > MAX_FILES {
        return Err(fail(format!("names {} data files; 1 to {MAX_FILES} can be read", names.len())));
    }
    names.iter().map(|n: &String| sibling_file(path, n.trim())).collect::<Result<Vec<_>>>().map(Some)
}

/// `name = value` lines, names in lower case, up to the one that says where the data are.
fn header(path: &Path, reader: &mut impl BufRead) -> Result<HashMap<String, String>> {
    let mut fields = HashMap::new();
    let mut reader = reader.take(MAX_HEADER_BYTES);
    let mut line = Vec::new();
    loop {
        line.clear();
        let read = reader.read_until(b'\n', &mut line).map_err(|e| read_error(path, e))?;
        let text = String::from_utf8_lossy(&line);
        let Some((name, value)) = text.split_once('=') else {
            if read > 0 && text.trim().is_empty() {
                continue;
            }
            return Err(Error::file(path, "is not a MetaImage (its header has a line without \"=\", or ends before ElementDataFile)"));
        };
        let name = name.trim().to_ascii_lowercase();
        let last = name == "elementdatafile";
        fields.insert(name, value.trim().to_owned());
        if last {
            return Ok(fields);
        }
    }
}

fn scalar_type(name: &str) -> Option<ScalarType> {
    let name = name.strip_suffix("_ARRAY").unwrap_or(name);
    Some(match name {
        "MET_UCHAR" => ScalarType::U8,
        "MET_CHAR" => ScalarType::I8,
        "MET_USHORT" => ScalarType::U16,
        "MET_SHORT" => ScalarType::I16,
        // MetaIO's long has 32 bits on every machine.
        "MET_UINT" | "MET_ULONG" => ScalarType::U32,
        "MET_INT" | "MET_LONG" => ScalarType::I32,
        "MET_ULONG_LONG" => ScalarType::U64,
        "MET_LONG_LONG" => ScalarType::I64,
        "MET_FLOAT" => ScalarType::F32,
        "MET_DOUBLE" => ScalarType::F64,
        _ => return None,
    })
}
