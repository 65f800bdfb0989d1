//! VTK's legacy format, `.vtk`: structured points as text or in binary (most significant byte
//! first).
//!
//! Of several arrays one is shown, as in the notice about the others: scalars before vectors, values
//! of points before those of cells.
//!
//! *Geometry*: origin and spacing along the axes, taken as LPS; the format has no directions.
//! Source: VTK file formats, "Simple legacy formats".

use super::ReadOptions;
use super::ScalarType;
use super::image::{Image, Meaning};
use super::source::{ValueReader, buffered, check_held, count, read_error, usable};
use crate::{Error, Result, Watch};
use glam::{DAffine3, DMat3, DVec3};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Maximum length of a header line, bytes.
const MAX_LINE_BYTES: u64 = 1 << 16;
/// Types of fields that are not images.
const UNREADABLE_TYPES: [&str; 4] = ["bit", "string", "unicode_string", "variant"];
/// Maximum number of arrays that are looked at, and of those that a notice names.
const MAX_ARRAYS: usize = 1000;
const MAX_NAMED: usize = 8;
/// Maximum number of lines that are not values.
const MAX_HEADER_LINES: usize = 10_000;

/// Reads an image.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    choice.time_of(1)?;
    let (mut reader, file_bytes) = buffered(path)?;
    let (header, arrays) = header_and_arrays(path, &mut reader, watch)?;
    let points = header
        .size
        .ok_or_else(|| fail("has no readable DIMENSIONS".into()))?;
    let array = chosen(&arrays).ok_or_else(|| match arrays.first() {
        Some(other) => fail(format!(
            "holds {}, which cannot be shown; scalars, vectors and colours can",
            other.keyword
        )),
        None => fail("holds no values: it is truncated or has no scalars".into()),
    })?;
    let scalar = scalar_type(&array.type_name, header.binary).map_err(fail)?;
    let components = array.components;
    if !(1..=1024).contains(&components) {
        return Err(fail(format!(
            "has {components} values per voxel; its header is damaged"
        )));
    }
    let size = grid_size(points, array.on_cells);
    let total = count(path, &[size[0], size[1], size[2], components], scalar)?;
    reader
        .seek(SeekFrom::Start(array.at))
        .map_err(|e| read_error(path, e))?;
    let voxels = if header.binary {
        check_held(path, (total * scalar.bytes()) as u64, file_bytes)?;
        ValueReader {
            path,
            reader,
            swap: scalar.bytes() > 1 && cfg!(target_endian = "little"),
            count: total,
            watch,
        }
        .read_as(scalar)?
    } else {
        check_held(
            path,
            (total as u64).saturating_mul(2).saturating_sub(1),
            file_bytes,
        )?;
        super::text::values(path, reader, [0, total], scalar, watch)?
    };
    let spacing = header.spacing.unwrap_or(DVec3::ONE);
    let first = header.origin
        + if array.on_cells {
            spacing * 0.5
        } else {
            DVec3::ZERO
        };
    let world_from_voxel = DAffine3 {
        matrix3: DMat3::from_diagonal(spacing),
        translation: first,
    };
    if !usable(&world_from_voxel) {
        return Err(fail(
            "has a spacing of zero, or numbers that are not finite; its geometry cannot be used".into(),
        ));
    }
    let mut image = Image::new("legacy VTK", voxels, size, world_from_voxel);
    (image.components, image.frame) = (components, Some(DMat3::IDENTITY));
    image.meaning = array.meaning().unwrap_or(Meaning::Unstated);
    image
        .warnings
        .push("cannot state its patient orientation; left, posterior, superior axes are assumed".into());
    image
        .warnings
        .extend(choice.spacing_notice([header.spacing.is_some(); 3]));
    image.warnings.extend(left_out(&arrays, array));
    Ok(image)
}

/// The header up to the first array of values.
struct Header {
    /// Whether values are binary rather than text.
    binary: bool,
    /// Number of points along the axes, if given.
    size: Option<[usize; 3]>,
    /// Distance between points, if given.
    spacing: Option<DVec3>,
    origin: DVec3,
    /// Whether the following values belong to the cells between the points.
    on_cells: bool,
}

/// An array of values, from the line that declares it.
#[derive(Debug)]
struct ValueArray {
    /// The word that declares it, in upper case.
    keyword: String,
    name: String,
    type_name: String,
    components: usize,
    /// Whether the values belong to the cells between the points.
    on_cells: bool,
    /// The first byte of the values.
    at: u64,
}

impl ValueArray {
    /// The meaning of the values; none if they cannot be shown.
    fn meaning(&self) -> Option<Meaning> {
        Some(match self.keyword.as_str() {
            "SCALARS" | "FIELD" => Meaning::Unstated,
            "COLOR_SCALARS" => Meaning::Color,
            "VECTORS" | "NORMALS" => Meaning::Vectors,
            _ => return None,
        })
    }
}

/// The array to show: scalars, else colours, vectors, normals or fields; the first of a kind, point
/// data before cell data.
fn chosen(arrays: &[ValueArray]) -> Option<&ValueArray> {
    let rank = |a: &ValueArray| {
        let kinds = ["SCALARS", "COLOR_SCALARS", "VECTORS", "NORMALS", "FIELD"];
        (a.on_cells, kinds.iter().position(|k| *k == a.keyword))
    };
    arrays
        .iter()
        .filter(|a| a.meaning().is_some())
        .min_by_key(|a| rank(a))
}

/// A notice about the arrays that are not shown.
fn left_out(arrays: &[ValueArray], shown: &ValueArray) -> Option<String> {
    let others: Vec<String> = arrays
        .iter()
        .filter(|a| a.at != shown.at)
        .take(MAX_NAMED)
        .map(|a| {
            let cells = if a.on_cells { " of cells" } else { "" };
            format!("{} ({}{cells})", a.name, a.keyword)
        })
        .collect();
    (!others.is_empty()).then(|| {
        let more = if arrays.len() - 1 > MAX_NAMED {
            " and others"
        } else {
            ""
        };
        format!(
            "also holds the arrays {}{more}; \"{}\" ({}) is used",
            others.join(", "),
            shown.name,
            shown.keyword
        )
    })
}

/// Number of values along the axes, from the number of points.
fn grid_size(points: [usize; 3], on_cells: bool) -> [usize; 3] {
    if on_cells {
        points.map(|n| n.saturating_sub(1).max(1))
    } else {
        points
    }
}

/// The header, and the arrays that the file declares.
fn header_and_arrays(
    path: &Path,
    reader: &mut BufReader<File>,
    watch: &Watch,
) -> Result<(Header, Vec<ValueArray>)> {
    let fail = |problem: String| Error::file(path, problem);
    if !line(path, reader)?.is_some_and(|l| l.starts_with("# vtk DataFile")) {
        return Err(fail(
            "is not a VTK file (it does not start with \"# vtk DataFile\")".into(),
        ));
    }
    let _title = line(path, reader)?;
    let binary = match line(path, reader)?
        .unwrap_or_default()
        .to_ascii_uppercase()
        .as_str()
    {
        "BINARY" => true,
        "ASCII" => false,
        other => {
            return Err(fail(format!(
                "is written as \"{other}\"; it must be ASCII or BINARY"
            )));
        }
    };
    let mut header = Header {
        binary,
        size: None,
        spacing: None,
        origin: DVec3::ZERO,
        on_cells: false,
    };
    let (mut arrays, mut lines) = (Vec::new(), 0usize);
    while let Some(text) = line(path, reader)? {
        lines += 1;
        // The values of text arrays are passed over as lines.
        if lines > MAX_HEADER_LINES && (binary || arrays.is_empty()) || arrays.len() >= MAX_ARRAYS {
            break;
        }
        watch.check()?;
        let applied = header.apply(&text);
        if arrays.is_empty() {
            applied.map_err(fail)?;
        }
        let from = arrays.len();
        match declared(path, reader, &header, &text, &mut arrays) {
            // What follows the first array is only looked through.
            Err(e) if from == 0 => return Err(e),
            Err(_) | Ok(false) => break,
            Ok(true) => {}
        }
    }
    Ok((header, arrays))
}

/// A line without surrounding white space; none at the end of the file.
fn line(path: &Path, reader: &mut impl BufRead) -> Result<Option<String>> {
    let mut bytes = Vec::new();
    let read = reader
        .take(MAX_LINE_BYTES)
        .read_until(b'\n', &mut bytes)
        .map_err(|e| read_error(path, e))?;
    Ok((read > 0).then(|| String::from_utf8_lossy(&bytes).trim().to_owned()))
}

impl Header {
    /// Applies a line that states the type of data, the geometry, or whether the arrays that follow
    /// belong to points or cells; ignores other lines.
    fn apply(&mut self, text: &str) -> Result<(), String> {
        let words: Vec<&str> = text.split_whitespace().collect();
        let three = || -> Option<[f64; 3]> {
            words
                .get(1..4)?
                .iter()
                .map(|w| w.parse().ok())
                .collect::<Option<Vec<_>>>()?
                .try_into()
                .ok()
        };
        let vector = || {
            three()
                .map(DVec3::from_array)
                .ok_or_else(|| format!("has \"{text}\", which is not three numbers"))
        };
        match words.first().map(|w| w.to_ascii_uppercase()).as_deref() {
            Some("DATASET")
                if !words
                    .get(1)
                    .is_some_and(|k| k.eq_ignore_ascii_case("STRUCTURED_POINTS")) =>
            {
                let kind = words.get(1).unwrap_or(&"nothing");
                let remedy = if kind.eq_ignore_ascii_case("POLYDATA") {
                    "; save the mesh as .ply, .stl or .obj"
                } else {
                    ""
                };
                return Err(format!(
                    "holds {kind}, which cannot be read as a volume; only structured points can{remedy}"
                ));
            }
            Some("DIMENSIONS") => {
                let points = |w: &[&str]| {
                    w.iter()
                        .map(|n| n.parse::<usize>().ok().filter(|n| *n > 0))
                        .collect::<Option<Vec<_>>>()
                };
                self.size = words.get(1..4).and_then(points).and_then(|s| s.try_into().ok());
            }
            Some("SPACING" | "ASPECT_RATIO") => self.spacing = Some(vector()?),
            Some("ORIGIN") => self.origin = vector()?,
            Some("POINT_DATA") => self.on_cells = false,
            Some("CELL_DATA") => self.on_cells = true,
            _ => {}
        }
        Ok(())
    }
}

/// Adds the arrays that a line declares, if any, and passes over their binary values; false if
/// these cannot be passed over.
fn declared(
    path: &Path,
    reader: &mut BufReader<File>,
    header: &Header,
    text: &str,
    arrays: &mut Vec<ValueArray>,
) -> Result<bool> {
    let fail = |problem: String| Error::file(path, problem);
    let words: Vec<&str> = text.split_whitespace().collect();
    let number = |n: usize| words.get(n).and_then(|w| w.parse::<usize>().ok());
    let keyword = words.first().map_or(String::new(), |w| w.to_ascii_uppercase());
    let unreadable = || fail(format!("has \"{text}\", which cannot be read"));
    let kind = |n: usize| words.get(n).map_or(String::new(), |w| (*w).to_owned());
    let (type_name, components) = match keyword.as_str() {
        "SCALARS" => (kind(2), number(3).unwrap_or(1)),
        "COLOR_SCALARS" => {
            let kind = if header.binary { "unsigned_char" } else { "float" };
            (kind.to_owned(), number(2).ok_or_else(unreadable)?)
        }
        "VECTORS" | "NORMALS" => (kind(2), 3),
        "TENSORS" => (kind(2), 9),
        "TENSORS6" => (kind(2), 6),
        "TEXTURE_COORDINATES" => (kind(3), number(2).ok_or_else(unreadable)?),
        // A table of colours: red, green, blue and opacity.
        "LOOKUP_TABLE" if header.binary => {
            let bytes = number(2).and_then(|n| n.checked_mul(4));
            return Ok(pass(reader, bytes));
        }
        // Its first line is empty, as is the one that ends it.
        "METADATA" => {
            while line(path, reader)?.is_some_and(|l| !l.is_empty()) {}
            return Ok(true);
        }
        "FIELD" => return fields(path, reader, header, number(2).unwrap_or(1), arrays),
        _ => return Ok(true),
    };
    if keyword == "SCALARS" {
        // The following table is named, and may be missing.
        let table = line(path, reader)?.unwrap_or_default();
        if !table.to_ascii_uppercase().starts_with("LOOKUP_TABLE") {
            return Err(fail(
                "has scalars without a lookup table; its header is damaged".into(),
            ));
        }
    }
    let at = reader.stream_position().map_err(|e| read_error(path, e))?;
    let tuples = header
        .size
        .and_then(|points| product(&grid_size(points, header.on_cells)));
    let bytes = tuples.and_then(|n| byte_count(&type_name, n.checked_mul(components)?));
    arrays.push(ValueArray {
        keyword,
        name: kind(1),
        type_name,
        components,
        on_cells: header.on_cells,
        at,
    });
    Ok(!header.binary || pass(reader, bytes))
}

/// The arrays of a field. Those with another number of values than the image has, as of the whole
/// data set, are passed over.
fn fields(
    path: &Path,
    reader: &mut BufReader<File>,
    header: &Header,
    number: usize,
    arrays: &mut Vec<ValueArray>,
) -> Result<bool> {
    let mut remaining = number;
    while remaining > 0 && arrays.len() < MAX_ARRAYS {
        let Some(text) = line(path, reader)? else {
            return Ok(false);
        };
        let words: Vec<&str> = text.split_whitespace().collect();
        if words.first().is_some_and(|w| w.eq_ignore_ascii_case("METADATA")) {
            while line(path, reader)?.is_some_and(|l| !l.is_empty()) {}
            continue;
        }
        let whole = |w: &str| w.parse::<usize>().ok();
        let (name, components, tuples, kind) = match words[..] {
            [name, components, tuples, kind] => (name, whole(components), whole(tuples), kind),
            // Between arrays: an empty line, or values written as text.
            _ if text.is_empty() || !header.binary => continue,
            _ => {
                return Err(Error::file(
                    path,
                    format!("has the field \"{text}\", which cannot be read"),
                ));
            }
        };
        let is_type = scalar_type(kind, header.binary).is_ok() || UNREADABLE_TYPES.contains(&kind);
        let (Some(components), Some(tuples), true) = (components, tuples, is_type || header.binary) else {
            if header.binary {
                return Err(Error::file(
                    path,
                    format!("has the field \"{text}\", which cannot be read"),
                ));
            }
            continue;
        };
        remaining -= 1;
        let expected = header
            .size
            .and_then(|points| product(&grid_size(points, header.on_cells)));
        let at = reader.stream_position().map_err(|e| read_error(path, e))?;
        if expected == Some(tuples) {
            arrays.push(ValueArray {
                keyword: "FIELD".into(),
                name: name.to_owned(),
                type_name: kind.to_owned(),
                components,
                on_cells: header.on_cells,
                at,
            });
        }
        if header.binary {
            let bytes = tuples
                .checked_mul(components)
                .and_then(|values| byte_count(kind, values));
            if !pass(reader, bytes) {
                return Ok(false);
            }
        }
    }
    Ok(true)
}

fn product(numbers: &[usize]) -> Option<usize> {
    numbers.iter().try_fold(1usize, |n, &d| n.checked_mul(d))
}

/// Bytes of binary values; none for types of an unknown length.
fn byte_count(type_name: &str, values: usize) -> Option<usize> {
    if type_name.eq_ignore_ascii_case("bit") {
        return Some(values.div_ceil(8));
    }
    scalar_type(type_name, true).ok()?.bytes().checked_mul(values)
}

/// Passes over bytes; false if their number is not known, or no file has as many.
fn pass(reader: &mut BufReader<File>, bytes: Option<usize>) -> bool {
    bytes
        .and_then(|n| i64::try_from(n).ok())
        .is_some_and(|n| reader.seek_relative(n).is_ok())
}

/// The type with a name of VTK. Binary values of the type of indices have 32 bits.
fn scalar_type(name: &str, binary: bool) -> Result<ScalarType, String> {
    Ok(match name.to_ascii_lowercase().as_str() {
        "unsigned_char" => ScalarType::U8,
        "char" | "signed_char" => ScalarType::I8,
        "unsigned_short" => ScalarType::U16,
        "short" => ScalarType::I16,
        "unsigned_int" => ScalarType::U32,
        "int" => ScalarType::I32,
        "unsigned_long" | "unsigned_long_long" | "vtktypeuint64" => ScalarType::U64,
        "vtkidtype" if binary => ScalarType::I32,
        "long" | "long_long" | "vtktypeint64" | "vtkidtype" => ScalarType::I64,
        "float" => ScalarType::F32,
        "double" => ScalarType::F64,
        _ => return Err(format!("has the type \"{name}\", which is not supported")),
    })
}
