//! NRRD, attached (`.nrrd`) or detached (`.nhdr`), raw, gzip or text, scalar or with components along one axis.
//!
//! *Geometry*: `space directions` and `space origin` in the space that the file names, turned to LPS; else `spacings`. Vectors are stated in
//! that space, unless a `measurement frame` says otherwise. Source: the NRRD format definition (Kindlmann, teem 1.11).

use super::super::Rescale;
use super::image::{DEFLATE_LIMIT, Image, Layout, ScalarType, Source, read_error};
use crate::{Error, Result};
use flate2::read::MultiGzDecoder;
use glam::{DAffine3, DMat3, DVec3};
use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Longest header that is read: a file without an empty line is no NRRD.
const MOST_HEADER: u64 = 1 << 20;
/// Key of this program's displacement maps.
const MAP_KEY: &str = "incise";

/// Reads an image.
pub fn read(path: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    let file = std::fs::File::open(path).map_err(|e| Error::io(path, "opening", e))?;
    let mut file_bytes = file.metadata().map_err(|e| Error::io(path, "reading", e))?.len();
    let mut reader = BufReader::with_capacity(1 << 18, file);
    let fields = header(path, &mut reader)?;
    let get = |name: &str| fields.get(name).map(String::as_str);
    let need = |name: &str| get(name).ok_or_else(|| fail(format!("has no field \"{name}\" in its header; it is damaged")));
    let whole = |text: &str| text.split_whitespace().map(|w| w.parse::<usize>().ok().filter(|&n| n > 0)).collect::<Option<Vec<_>>>();
    let sizes =
        whole(need("sizes")?).ok_or_else(|| fail(format!("has the sizes \"{}\", which are no positive numbers", get("sizes").unwrap_or(""))))?;
    if need("dimension")?.trim().parse() != Ok(sizes.len()) || !(1..=4).contains(&sizes.len()) {
        return Err(fail(format!("has {} axes; images of 1 to 3, and one axis of components, can be read", sizes.len())));
    }
    let scalar =
        scalar_type(need("type")?).ok_or_else(|| fail(format!("stores \"{}\", which is no type that can be read", get("type").unwrap_or(""))))?;
    let component_axis = component_axis(&fields, sizes.len()).map_err(&fail)?;
    let (components, layout) = match component_axis {
        None => (1, Layout::Interleaved),
        Some(0) => (sizes[0], Layout::Interleaved),
        Some(a) if a + 1 == sizes.len() => (sizes[a], Layout::Planar),
        Some(a) => return Err(fail(format!("has its components along axis {}, between spatial ones; permute it", a + 1))),
    };
    let spatial: Vec<usize> = (0..sizes.len()).filter(|a| Some(*a) != component_axis).collect();
    if spatial.len() > 3 {
        return Err(fail("has four spatial axes; a single time is needed".into()));
    }
    let size: [usize; 3] = std::array::from_fn(|a| spatial.get(a).map_or(1, |&s| sizes[s]));
    let count =
        sizes.iter().try_fold(1usize, |n, &d| n.checked_mul(d)).filter(|n| n.checked_mul(scalar.bytes()).is_some_and(|b| b < isize::MAX as usize));
    let count = count.ok_or_else(|| fail("declares more values than can be addressed; its header is damaged".into()))?;
    let mut warnings = Vec::new();
    let (world_from_voxel, frame) = geometry(&fields, &spatial, sizes.len(), &mut warnings).map_err(&fail)?;
    // Detached data lie in another file.
    let data = get("data file").or(get("datafile"));
    if let Some(name) = data {
        if name.contains('%') || name.starts_with("LIST") {
            return Err(fail("has its data in several files, which cannot be read; join them into one".into()));
        }
        let other = path.parent().unwrap_or(Path::new("")).join(name);
        let file = std::fs::File::open(&other).map_err(|e| Error::io(&other, "opening", e))?;
        file_bytes = file.metadata().map_err(|e| Error::io(&other, "reading", e))?.len();
        reader = BufReader::with_capacity(1 << 18, file);
    }
    let skip =
        get("byte skip").or(get("byteskip")).map_or(Ok(0i64), |t| t.trim().parse()).map_err(|_| fail("has a byte skip that is no number".into()))?;
    if get("line skip").or(get("lineskip")).is_some_and(|t| t.trim() != "0") {
        return Err(fail("asks to skip lines, which cannot be read; save it without".into()));
    }
    let swap = scalar.bytes() > 1
        && match need("endian").map(str::trim) {
            Ok("little") => cfg!(target_endian = "big"),
            Ok("big") => cfg!(target_endian = "little"),
            Ok(other) => return Err(fail(format!("has the byte order \"{other}\"; little or big is meant"))),
            Err(e) if !matches!(get("encoding"), Some("ascii" | "text" | "txt")) => return Err(e),
            Err(_) => false,
        };
    let bytes = (count * scalar.bytes()) as u64;
    let voxels = match need("encoding")?.trim() {
        "raw" => {
            if bytes > file_bytes {
                return Err(fail(format!("declares {bytes} bytes of values, more than the file holds: it is truncated or its header is damaged")));
            }
            if skip < 0 {
                // From the file's end.
                reader.seek(SeekFrom::End(-(bytes as i64))).map_err(|e| read_error(path, e))?;
            } else {
                std::io::copy(&mut (&mut reader).take(skip as u64), &mut std::io::sink()).map_err(|e| read_error(path, e))?;
            }
            Source { path, reader, swap, count, progress }.read_as(scalar)?
        }
        "gzip" | "gz" => {
            if bytes / DEFLATE_LIMIT > file_bytes {
                return Err(fail(format!("declares {bytes} bytes of values, more than the file can hold: it is truncated or its header is damaged")));
            }
            let mut decoder = MultiGzDecoder::new(reader);
            std::io::copy(&mut (&mut decoder).take(skip.max(0) as u64), &mut std::io::sink()).map_err(|e| read_error(path, e))?;
            Source { path, reader: decoder, swap, count, progress }.read_as(scalar)?
        }
        "ascii" | "text" | "txt" => {
            let mut text = String::new();
            reader.take((count as u64).saturating_mul(64).saturating_add(1024)).read_to_string(&mut text).map_err(|e| read_error(path, e))?;
            let values: Vec<f64> = text.split_ascii_whitespace().take(count).map_while(|w| w.parse().ok()).collect();
            if values.len() < count {
                return Err(fail(format!("holds {} values of {count}: it is truncated or no text", values.len())));
            }
            values.into()
        }
        other => return Err(fail(format!("is encoded as \"{other}\", which cannot be read; save it as raw or gzip"))),
    };
    Ok(Image {
        voxels,
        size,
        components,
        layout,
        rescale: Rescale::NONE,
        world_from_voxel,
        intent: 0,
        frame: Some(frame),
        displacement: get(MAP_KEY) == Some("displacement map 1"),
        warnings,
    })
}

/// The fields of the header, names in lower case; the reader is left after the empty line that ends it.
fn header(path: &Path, reader: &mut impl BufRead) -> Result<HashMap<String, String>> {
    let mut fields = HashMap::new();
    let mut reader = reader.take(MOST_HEADER);
    let mut line = Vec::new();
    let mut first = true;
    loop {
        line.clear();
        let read = reader.read_until(b'\n', &mut line).map_err(|e| read_error(path, e))?;
        let text = String::from_utf8_lossy(&line);
        let text = text.trim_end_matches(['\n', '\r']);
        if first {
            if !text.starts_with("NRRD000") {
                return Err(Error::file(path, "is no NRRD file (it does not start with NRRD000)"));
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
        if text.starts_with('#') {
            continue;
        }
        if let Some((name, value)) = text.split_once(":=").or_else(|| text.split_once(": ")) {
            fields.insert(name.trim().to_ascii_lowercase(), value.trim().to_owned());
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

/// The axis of components: not spatial by its kind, or without a direction in space.
fn component_axis(fields: &HashMap<String, String>, axes: usize) -> Result<Option<usize>, String> {
    let by_kind: Vec<usize> = fields.get("kinds").map_or(Vec::new(), |kinds| {
        let spatial = |k: &str| matches!(k, "domain" | "space" | "???" | "none");
        kinds.split_whitespace().enumerate().filter(|(_, k)| !spatial(k)).map(|(a, _)| a).collect()
    });
    let by_direction: Vec<usize> =
        fields.get("space directions").map_or(Vec::new(), |d| words(d).iter().enumerate().filter(|(_, d)| *d == "none").map(|(a, _)| a).collect());
    let found = if by_direction.is_empty() { by_kind } else { by_direction };
    match found[..] {
        [] if axes == 4 => Err("has four axes and does not say which holds the components (kinds, or \"none\" in space directions)".into()),
        [] => Ok(None),
        [a] => Ok(Some(a)),
        _ => Err("has several axes that are not spatial; one of components can be read".into()),
    }
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

/// `(a,b,c) (d, e, f) none` into its words.
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

/// World from voxel, and world (LPS) from the axes of vectors.
fn geometry(fields: &HashMap<String, String>, spatial: &[usize], axes: usize, warnings: &mut Vec<String>) -> Result<(DAffine3, DMat3), String> {
    let space = fields.get("space").map(|s| s.to_ascii_lowercase());
    let lps_from_space = match space.as_deref() {
        Some("left-posterior-superior" | "lps" | "left-posterior-superior-time" | "lpst") => DVec3::ONE,
        Some("right-anterior-superior" | "ras" | "right-anterior-superior-time" | "rast") => DVec3::new(-1.0, -1.0, 1.0),
        Some("left-anterior-superior" | "las" | "left-anterior-superior-time" | "last") => DVec3::new(1.0, -1.0, 1.0),
        Some("3d-right-handed" | "scanner-xyz") => DVec3::ONE,
        Some(other) => {
            warnings.push(format!("its space \"{other}\" is no patient space; axes are taken as left, posterior, superior"));
            DVec3::ONE
        }
        None => {
            if !fields.contains_key("space dimension") {
                warnings.push("has no orientation: axes are taken as left, posterior, superior".into());
            }
            DVec3::ONE
        }
    };
    let lps_from_space = DMat3::from_diagonal(lps_from_space);
    let mut linear = DMat3::IDENTITY;
    if let Some(directions) = fields.get("space directions") {
        let all = words(directions);
        for (n, &axis) in spatial.iter().enumerate() {
            *linear.col_mut(n) =
                all.get(axis).and_then(|w| vector(w)).ok_or_else(|| format!("has the space directions \"{directions}\", which cannot be read"))?;
        }
    } else if let Some(spacings) = fields.get("spacings") {
        let all: Vec<f64> = spacings.split_whitespace().map(|w| w.parse().unwrap_or(f64::NAN)).collect();
        if all.len() != axes {
            return Err(format!("has the spacings \"{spacings}\" for {axes} axes"));
        }
        for (n, &axis) in spatial.iter().enumerate() {
            if all[axis].is_finite() && all[axis] != 0.0 {
                *linear.col_mut(n) *= all[axis];
            }
        }
    }
    let origin = fields.get("space origin").map_or(Some(DVec3::ZERO), |o| vector(o)).ok_or("has a space origin that cannot be read")?;
    let affine = DAffine3 { matrix3: lps_from_space * linear, translation: lps_from_space * origin };
    if !(affine.is_finite() && affine.matrix3.determinant().abs() > 1e-12) {
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
