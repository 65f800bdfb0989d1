//! MetaImage, `.mha` or `.mhd` with its data beside it, raw or zlib, scalar or with several channels.
//!
//! *Geometry*: `Offset` and `TransformMatrix` (three consecutive numbers are one axis' direction) in LPS, as ITK writes them.
//! Source: the MetaIO format (ITK, MetaImage documentation).

use super::super::Rescale;
use super::image::{DEFLATE_LIMIT, Image, Layout, ScalarType, Source, read_error};
use crate::{Error, Result};
use flate2::read::ZlibDecoder;
use glam::{DAffine3, DMat3, DVec3};
use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Longest header that is read.
const MOST_HEADER: u64 = 1 << 20;

/// Reads an image.
pub fn read(path: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    let file = std::fs::File::open(path).map_err(|e| Error::io(path, "opening", e))?;
    let mut file_bytes = file.metadata().map_err(|e| Error::io(path, "reading", e))?.len();
    let mut reader = BufReader::with_capacity(1 << 18, file);
    let fields = header(path, &mut reader)?;
    let get = |names: &[&str]| names.iter().find_map(|n| fields.get(*n)).map(String::as_str);
    let numbers = |text: &str| text.split_whitespace().map(|w| w.parse::<f64>().ok().filter(|v| v.is_finite())).collect::<Option<Vec<f64>>>();
    let need = |name: &str| get(&[name]).ok_or_else(|| fail(format!("has no \"{name}\" in its header; it is no MetaImage, or damaged")));
    let size_text = need("dimsize")?;
    let sizes: Vec<usize> = size_text
        .split_whitespace()
        .map(|w| w.parse::<usize>().ok().filter(|&n| n > 0))
        .collect::<Option<_>>()
        .ok_or_else(|| fail(format!("has the size \"{size_text}\", which is no list of positive numbers")))?;
    if !(1..=4).contains(&sizes.len()) {
        return Err(fail(format!("has {} axes; images of 1 to 3 can be read", sizes.len())));
    }
    let mut warnings = Vec::new();
    if sizes.len() == 4 && sizes[3] > 1 {
        warnings.push(format!("holds {} volumes; the first is used", sizes[3]));
    }
    let size: [usize; 3] = std::array::from_fn(|a| sizes.get(a).copied().unwrap_or(1));
    let components = match get(&["elementnumberofchannels"]) {
        Some(t) => t.parse::<usize>().ok().filter(|c| (1..=1024).contains(c)).ok_or_else(|| fail(format!("has \"{t}\" channels")))?,
        None => 1,
    };
    let type_name = need("elementtype")?;
    let scalar = scalar_type(type_name).ok_or_else(|| fail(format!("stores \"{type_name}\", which is no type that can be read")))?;
    let count = size.iter().chain([&components]).try_fold(1usize, |n, &d| n.checked_mul(d));
    let count = count
        .filter(|n| n.checked_mul(scalar.bytes()).is_some_and(|b| b < isize::MAX as usize))
        .ok_or_else(|| fail("declares more values than can be addressed; its header is damaged".into()))?;
    let list = |names: &[&str], n: usize| {
        get(names).map(|t| numbers(t).filter(|v| v.len() >= n).ok_or_else(|| fail(format!("has \"{t}\" for {}", names[0])))).transpose()
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
    if !(world_from_voxel.is_finite() && linear.determinant().abs() > 1e-12) {
        return Err(fail("has singular axes; its geometry cannot be used".into()));
    }
    let data = need("elementdatafile")?;
    if data.eq_ignore_ascii_case("list") || data.contains('%') {
        return Err(fail("has its data in several files, which cannot be read; save it in one".into()));
    }
    if !data.eq_ignore_ascii_case("local") {
        let other = path.parent().unwrap_or(Path::new("")).join(data);
        let file = std::fs::File::open(&other).map_err(|e| Error::io(&other, "opening", e))?;
        file_bytes = file.metadata().map_err(|e| Error::io(&other, "reading", e))?.len();
        reader = BufReader::with_capacity(1 << 18, file);
    }
    let yes = |names: &[&str]| get(names).is_some_and(|t| t.eq_ignore_ascii_case("true") || t == "1");
    if get(&["binarydata"]).is_some_and(|t| t.eq_ignore_ascii_case("false")) {
        return Err(fail("stores its values as text, which cannot be read; save it in binary".into()));
    }
    let big = yes(&["binarydatabyteordermsb", "elementbyteordermsb"]);
    let swap = scalar.bytes() > 1 && big != cfg!(target_endian = "big");
    let bytes = (count * scalar.bytes()) as u64;
    let compressed = yes(&["compresseddata"]);
    if bytes / if compressed { DEFLATE_LIMIT } else { 1 } > file_bytes {
        return Err(fail(format!("declares {bytes} bytes of values, more than the file can hold: it is truncated or its header is damaged")));
    }
    let voxels = if compressed {
        Source { path, reader: ZlibDecoder::new(reader), swap, count, progress }.read_as(scalar)?
    } else {
        // -1 counts from the file's end.
        let skip = match get(&["headersize"]).map_or(Ok(0i64), str::parse) {
            Ok(-1) => file_bytes.saturating_sub(bytes),
            Ok(n) if n >= 0 && !data.eq_ignore_ascii_case("local") => n as u64,
            _ => 0,
        };
        if !data.eq_ignore_ascii_case("local") {
            std::io::copy(&mut (&mut reader).take(skip), &mut std::io::sink()).map_err(|e| read_error(path, e))?;
        }
        Source { path, reader, swap, count, progress }.read_as(scalar)?
    };
    Ok(Image {
        voxels,
        size,
        components,
        layout: Layout::Interleaved,
        rescale: Rescale::NONE,
        world_from_voxel,
        intent: 0,
        frame: Some(DMat3::IDENTITY),
        displacement: false,
        warnings,
    })
}

/// `name = value` lines, names in lower case, up to the one that says where the data are.
fn header(path: &Path, reader: &mut impl BufRead) -> Result<HashMap<String, String>> {
    let mut fields = HashMap::new();
    let mut reader = reader.take(MOST_HEADER);
    let mut line = Vec::new();
    loop {
        line.clear();
        let read = reader.read_until(b'\n', &mut line).map_err(|e| read_error(path, e))?;
        let text = String::from_utf8_lossy(&line);
        let Some((name, value)) = text.split_once('=') else {
            if read > 0 && text.trim().is_empty() {
                continue;
            }
            return Err(Error::file(path, "is no MetaImage (its header has a line without \"=\", or ends before ElementDataFile)"));
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
