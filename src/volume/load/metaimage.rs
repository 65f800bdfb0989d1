//! MetaImage, `.mha`, or `.mhd` with its data in one or many separate files; raw, zlib or text,
//! scalar or with several channels.
//!
//! *Geometry*: `Offset` and `TransformMatrix` (three consecutive numbers are the direction of one
//! axis) in LPS, as written by ITK. Source: the MetaIO format (ITK, MetaImage documentation).

use super::ScalarType;
use super::image::Image;
use super::nrrd::numbered;
use super::source::{
    DEFLATE_LIMIT, ValueReader, buffered, check_held, count, divided, read_error, sibling_file, skip, usable,
};
use super::{ReadOptions, StoredValues};
use crate::{Error, Result, Watch};
use flate2::bufread::{MultiGzDecoder, ZlibDecoder};
use glam::{DAffine3, DMat3, DVec3};
use serde_json::json;
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// Maximum number of listed data files.
const MAX_FILES: usize = 100_000;
/// Maximum header length, bytes.
const MAX_HEADER_BYTES: u64 = 1 << 20;

/// Reads an image.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let (mut reader, file_bytes) = buffered(path)?;
    let header = Header::read(path, &mut reader)?;
    let sizes = header.sizes()?;
    let mut warnings = Vec::new();
    let frames = sizes.get(3).copied().unwrap_or(1);
    let time = choice.time_of(frames)?;
    if frames > 1 && choice.time.is_none() {
        warnings.push(format!(
            "holds {frames} volumes; the first is used (--time chooses another)"
        ));
    }
    let size: [usize; 3] = std::array::from_fn(|a| sizes.get(a).copied().unwrap_or(1));
    let components = header.components()?;
    let scalar = header.scalar()?;
    let stored = count(path, &[size[0], size[1], size[2], components], scalar)?;
    let whole = count(path, &[stored, frames], scalar)?;
    let world_from_voxel = header.geometry(sizes.len(), choice, &mut warnings)?;
    let data = header.need("elementdatafile")?;
    let local = data.eq_ignore_ascii_case("local");
    let values = ValueLayout {
        path,
        scalar,
        count: stored,
        frames,
        time,
        swap: scalar.bytes() > 1 && header.big_endian() != cfg!(target_endian = "big"),
        text: header
            .get(&["binarydata"])
            .is_some_and(|t| t.eq_ignore_ascii_case("false")),
        compressed: header.yes(&["compresseddata"]),
        local,
        header_size: header.header_size()?,
        watch,
    };
    let pieces = if local {
        None
    } else {
        data_files(path, data, &mut reader)?
    };
    let voxels = if let Some(files) = pieces {
        values.read_files(&files)?
    } else if local {
        values.read_file(path, reader, file_bytes, values.part(), whole)?
    } else {
        let other = sibling_file(path, data.trim())?;
        let (reader, file_bytes) = buffered(&other)?;
        values.read_file(&other, reader, file_bytes, values.part(), whole)?
    };
    let mut image = Image::new("MetaImage", voxels, size, world_from_voxel);
    (image.components, image.frame, image.warnings) = (components, Some(DMat3::IDENTITY), warnings);
    if frames > 1 {
        image.details.push(("time_points", json!(frames)));
    }
    Ok(image)
}

/// The header's fields, with names in lower case.
struct Header<'a> {
    path: &'a Path,
    fields: HashMap<String, String>,
}

impl<'a> Header<'a> {
    /// Reads `name = value` lines up to the one that gives the location of the data.
    fn read(path: &'a Path, reader: &mut impl BufRead) -> Result<Self> {
        let mut fields = HashMap::new();
        let mut reader = reader.take(MAX_HEADER_BYTES);
        let mut line = Vec::new();
        loop {
            line.clear();
            let read = reader
                .read_until(b'\n', &mut line)
                .map_err(|e| read_error(path, e))?;
            let text = String::from_utf8_lossy(&line);
            let Some((name, value)) = text.split_once('=') else {
                if read > 0 && text.trim().is_empty() {
                    continue;
                }
                return Err(Error::file(
                    path,
                    "is not a MetaImage (its header has a line without \"=\", or ends before ElementDataFile)",
                ));
            };
            let name = name.trim().to_ascii_lowercase();
            let last = name == "elementdatafile";
            fields.insert(name, value.trim().to_owned());
            if last {
                return Ok(Self { path, fields });
            }
        }
    }

    /// An error about the file.
    fn fail(&self, problem: String) -> Error {
        Error::file(self.path, problem)
    }

    /// The first of these fields that exists.
    fn get(&self, names: &[&str]) -> Option<&str> {
        names.iter().find_map(|n| self.fields.get(*n)).map(String::as_str)
    }

    /// A required field.
    fn need(&self, name: &str) -> Result<&str> {
        self.get(&[name]).ok_or_else(|| {
            self.fail(format!(
                "has no \"{name}\" in its header; it is not a MetaImage, or it is damaged"
            ))
        })
    }

    /// Whether the first of these fields that exists is true.
    fn yes(&self, names: &[&str]) -> bool {
        self.get(names)
            .is_some_and(|t| t.eq_ignore_ascii_case("true") || t == "1")
    }

    /// At least `n` numbers from the first of these fields that exists.
    fn numbers(&self, names: &[&str], n: usize) -> Result<Option<Vec<f64>>> {
        let Some(text) = self.get(names) else {
            return Ok(None);
        };
        let numbers: Option<Vec<f64>> = text
            .split_whitespace()
            .map(|w| w.parse::<f64>().ok().filter(|v| v.is_finite()))
            .collect();
        match numbers.filter(|v| v.len() >= n) {
            None => Err(self.fail(format!("has the invalid value \"{text}\" for {}", names[0]))),
            numbers => Ok(numbers),
        }
    }

    /// Extents of the 1 to 4 axes, time last.
    fn sizes(&self) -> Result<Vec<usize>> {
        let text = self.need("dimsize")?;
        let sizes: Vec<usize> = text
            .split_whitespace()
            .map(|w| w.parse::<usize>().ok().filter(|&n| n > 0))
            .collect::<Option<_>>()
            .ok_or_else(|| {
                self.fail(format!(
                    "has the size \"{text}\", which is not a list of positive numbers"
                ))
            })?;
        if let Some(rank) = self.get(&["ndims"])
            && rank.parse() != Ok(sizes.len())
        {
            return Err(self.fail(format!(
                "declares {rank} axes (NDims) and the sizes \"{text}\" (DimSize); its header is damaged"
            )));
        }
        if !(1..=4).contains(&sizes.len()) {
            return Err(self.fail(format!(
                "has {} axes; images of 1 to 3 spatial axes, with or without a time axis, can be read",
                sizes.len()
            )));
        }
        Ok(sizes)
    }

    /// Values per voxel.
    fn components(&self) -> Result<usize> {
        let Some(text) = self.get(&["elementnumberofchannels"]) else {
            return Ok(1);
        };
        let components = text.parse::<usize>().ok().filter(|c| (1..=1024).contains(c));
        components.ok_or_else(|| self.fail(format!("has the invalid channel count \"{text}\"")))
    }

    /// Type of a value.
    fn scalar(&self) -> Result<ScalarType> {
        let name = self.need("elementtype")?;
        scalar_type(name)
            .ok_or_else(|| self.fail(format!("has the element type \"{name}\", which is not supported")))
    }

    /// Voxel indices to world millimetres for an image with `rank` axes.
    fn geometry(&self, rank: usize, choice: &ReadOptions, warnings: &mut Vec<String>) -> Result<DAffine3> {
        let spacing = self.numbers(&["elementspacing", "elementsize"], rank)?;
        let origin = self.numbers(&["offset", "position", "origin"], rank)?;
        let matrix = self.numbers(&["transformmatrix", "rotation", "orientation"], rank * rank)?;
        if let Some(s) = spacing.iter().flatten().take(rank.min(3)).find(|s| **s <= 0.0) {
            if *s == 0.0 {
                return Err(self.fail("has a spacing of 0 between voxels; correct ElementSpacing".into()));
            }
            warnings.push(format!(
                "has the negative spacing {s}; its absolute value is used"
            ));
        }
        let stated = |axis| spacing.is_some() && axis < rank;
        warnings.extend(choice.spacing_notice([0, 1, 2].map(stated)));
        if let Some(unit) = self.get(&["distanceunits"])
            && !matches!(unit.to_ascii_lowercase().as_str(), "mm" | "?" | "")
        {
            warnings.push(format!(
                "states its distances in {unit} (DistanceUnits), which ITK ignores; they are read as mm"
            ));
        }
        // ITK writes both and reads the matrix alone.
        if let (Some(letters), None) = (self.get(&["anatomicalorientation"]), &matrix)
            && !matches!(letters, "RAI" | "???")
        {
            warnings.push(format!(
                "names the orientation {letters} and has no TransformMatrix; left, posterior, superior axes are assumed"
            ));
        }
        let mut linear = DMat3::IDENTITY;
        for a in 0..rank.min(3) {
            let direction = matrix.as_ref().map_or(DVec3::AXES[a], |m| {
                DVec3::from_array(std::array::from_fn(
                    |c| if c < rank { m[a * rank + c] } else { 0.0 },
                ))
            });
            *linear.col_mut(a) = direction * spacing.as_ref().map_or(1.0, |s| s[a].abs());
        }
        let translation = origin.map_or(DVec3::ZERO, |o| {
            DVec3::from_array(std::array::from_fn(|c| if c < rank { o[c] } else { 0.0 }))
        });
        let world_from_voxel = DAffine3 {
            matrix3: linear,
            translation,
        };
        if !usable(&world_from_voxel) {
            return Err(self.fail("has a singular TransformMatrix; its geometry cannot be used".into()));
        }
        Ok(world_from_voxel)
    }

    /// Whether the most significant byte comes first.
    fn big_endian(&self) -> bool {
        self.yes(&["binarydatabyteordermsb", "elementbyteordermsb"])
    }

    /// Bytes before the values in a data file; -1 means that the values are at the file's end.
    fn header_size(&self) -> Result<i64> {
        let text = self.get(&["headersize"]).unwrap_or("0");
        let size = text.parse().ok().filter(|n| *n >= -1);
        size.ok_or_else(|| {
            self.fail(format!(
                "has the HeaderSize \"{text}\", which is neither -1 nor a number of bytes"
            ))
        })
    }
}

/// The storage of the values, and which of them to read.
struct ValueLayout<'a> {
    /// The image's own file.
    path: &'a Path,
    scalar: ScalarType,
    /// Values of one volume.
    count: usize,
    /// Number of volumes in time, and the one to read.
    frames: usize,
    time: usize,
    swap: bool,
    text: bool,
    compressed: bool,
    /// Whether the values follow the header.
    local: bool,
    header_size: i64,
    watch: &'a Watch<'a>,
}

impl ValueLayout<'_> {
    /// Values before the volume to read, and values of the volume.
    fn part(&self) -> [usize; 2] {
        [self.count * self.time, self.count]
    }

    /// Reads the binary values at the reader's position.
    fn read_binary(&self, path: &Path, reader: impl Read, count: usize) -> Result<StoredValues> {
        ValueReader {
            path,
            reader,
            swap: self.swap,
            count,
            watch: self.watch,
        }
        .read_as(self.scalar)
    }

    /// Reads values divided evenly among several files.
    fn read_files(&self, files: &[PathBuf]) -> Result<StoredValues> {
        let total = self.count.checked_mul(self.frames).ok_or_else(|| {
            Error::file(
                self.path,
                "declares more values than can be addressed; its header is damaged",
            )
        })?;
        let read = |file: &Path, reader, file_bytes, part, piece| {
            self.read_file(file, reader, file_bytes, part, piece)
        };
        divided(self.path, files, total, self.part(), self.watch, read)
    }

    /// Reads `count` values after `ahead` others from one file of `whole` values: the image's own,
    /// with the reader after the header, or a separate one.
    fn read_file(
        &self,
        file: &Path,
        mut reader: BufReader<File>,
        file_bytes: u64,
        [ahead, count]: [usize; 2],
        whole: usize,
    ) -> Result<StoredValues> {
        let size = self.scalar.bytes() as u64;
        let end = (ahead as u64 + count as u64).saturating_mul(size);
        if self.header_size >= 0 {
            // In the image's own file, the header size counts from the start of the file.
            if self.local && self.header_size > 0 {
                reader = buffered(file)?.0;
            }
            skip(file, &mut reader, self.header_size.unsigned_abs())?;
        } else if !self.text && !self.compressed {
            let bytes = (whole as u64).saturating_mul(size);
            check_held(file, bytes, file_bytes)?;
            reader = buffered(file)?.0;
            skip(file, &mut reader, file_bytes - bytes)?;
        }
        if self.text {
            // A value and its separator take at least two bytes.
            check_held(file, (end / size).saturating_mul(2).saturating_sub(1), file_bytes)?;
            return super::text::values(file, reader, [ahead, count], self.scalar, self.watch);
        }
        let before = (ahead as u64).saturating_mul(size);
        if self.compressed {
            check_held(file, end, file_bytes.saturating_mul(DEFLATE_LIMIT))?;
            let mut decoder: Box<dyn Read> = if reader.fill_buf().is_ok_and(|b| b.starts_with(&[0x1f, 0x8b]))
            {
                Box::new(MultiGzDecoder::new(reader))
            } else {
                Box::new(ZlibDecoder::new(reader))
            };
            skip(file, &mut decoder, before)?;
            return self.read_binary(file, decoder, count);
        }
        check_held(file, end, file_bytes)?;
        skip(file, &mut reader, before)?;
        self.read_binary(file, reader, count)
    }
}

/// The data files if there are several: a list of names after the header, or a pattern with
/// numbers.
fn data_files(path: &Path, data: &str, reader: &mut impl BufRead) -> Result<Option<Vec<PathBuf>>> {
    let fail = |problem: String| Error::file(path, problem);
    let words: Vec<&str> = data.split_whitespace().collect();
    let names = if words.first().is_some_and(|w| w.eq_ignore_ascii_case("list")) {
        let mut text = String::new();
        reader
            .take(MAX_HEADER_BYTES)
            .read_to_string(&mut text)
            .map_err(|_| fail("has a list of data files that is not text in UTF-8".into()))?;
        text.lines()
            .map(str::trim)
            .filter(|l| !l.is_empty())
            .map(str::to_owned)
            .collect()
    } else if let [pattern, first, last, rest @ ..] = &words[..]
        && pattern.contains('%')
    {
        let step = rest.first().map_or(Ok(1), |w| w.parse());
        let (Ok(first), Ok(last), Ok(step)) = (first.parse(), last.parse(), step) else {
            return Err(fail(format!(
                "has an invalid pattern of data files: \"{data}\"; it must be PATTERN FIRST LAST STEP"
            )));
        };
        numbered(pattern, first, last, step).map_err(fail)?
    } else {
        return Ok(None);
    };
    if names.is_empty() || names.len() > MAX_FILES {
        return Err(fail(format!(
            "names {} data files; 1 to {MAX_FILES} can be read",
            names.len()
        )));
    }
    names
        .iter()
        .map(|n: &String| sibling_file(path, n.trim()))
        .collect::<Result<Vec<_>>>()
        .map(Some)
}

/// The scalar type with a MetaIO name.
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
