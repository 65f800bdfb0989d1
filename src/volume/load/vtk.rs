//! VTK's legacy format, `.vtk`: structured points as text or in binary (most significant byte
//! first).
//!
//! *Geometry*: origin and spacing along the axes, taken as LPS; the format has no directions.
//! Source: VTK file formats, "Simple legacy formats".

use super::ReadOptions;
use super::ScalarType;
use super::image::{Image, Meaning};
use super::source::{ValueReader, buffered, check_held, count, read_error, usable};
use crate::{Error, Result, Watch};
use glam::{DAffine3, DMat3, DVec3};
use std::io::{BufRead, Read};
use std::path::Path;

/// Maximum length of a header line, bytes.
const MAX_LINE_BYTES: u64 = 1 << 16;
/// Maximum number of header lines.
const MAX_HEADER_LINES: usize = 10_000;

/// Reads an image.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    choice.time_of(1)?;
    let (mut reader, file_bytes) = buffered(path)?;
    let (header, array) = header(path, &mut reader)?;
    let size = header
        .size
        .ok_or_else(|| fail("has no readable DIMENSIONS".into()))?;
    let ValueArray {
        scalar,
        components,
        meaning,
    } = array.ok_or_else(|| fail("holds no values: it is truncated or has no scalars".into()))?;
    if !(1..=1024).contains(&components) {
        return Err(fail(format!(
            "has {components} values per voxel; its header is damaged"
        )));
    }
    let size = if header.on_cells {
        size.map(|n| n.saturating_sub(1).max(1))
    } else {
        size
    };
    let total = count(path, &[size[0], size[1], size[2], components], scalar)?;
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
    let spacing = header.spacing;
    let first = header.origin
        + if header.on_cells {
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
    (image.components, image.meaning, image.frame) = (components, meaning, Some(DMat3::IDENTITY));
    image
        .warnings
        .push("cannot state its patient orientation; left, posterior, superior axes are assumed".into());
    Ok(image)
}

/// The header up to the first array of values.
struct Header {
    /// Whether values are binary rather than text.
    binary: bool,
    /// Number of points along the axes, if given.
    size: Option<[usize; 3]>,
    spacing: DVec3,
    origin: DVec3,
    /// Whether values belong to the cells between the points.
    on_cells: bool,
}

/// The first array of values.
struct ValueArray {
    scalar: ScalarType,
    components: usize,
    meaning: Meaning,
}

/// The header and the first array, if there is one; leaves the reader at the array's values.
fn header(path: &Path, reader: &mut impl BufRead) -> Result<(Header, Option<ValueArray>)> {
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
        spacing: DVec3::ONE,
        origin: DVec3::ZERO,
        on_cells: false,
    };
    for _ in 0..MAX_HEADER_LINES {
        let Some(text) = line(path, reader)? else { break };
        header.apply(&text).map_err(fail)?;
        let array = value_array(path, reader, &header, &text)?;
        if array.is_some() {
            return Ok((header, array));
        }
    }
    Ok((header, None))
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
                    "holds {kind}; structured points can be read as a volume{remedy}"
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
            Some("SPACING" | "ASPECT_RATIO") => self.spacing = vector()?,
            Some("ORIGIN") => self.origin = vector()?,
            Some("POINT_DATA") => self.on_cells = false,
            Some("CELL_DATA") => self.on_cells = true,
            _ => {}
        }
        Ok(())
    }
}

/// The array that a line declares, if any; leaves the reader at its values.
fn value_array(
    path: &Path,
    reader: &mut impl BufRead,
    header: &Header,
    text: &str,
) -> Result<Option<ValueArray>> {
    let fail = |problem: String| Error::file(path, problem);
    let words: Vec<&str> = text.split_whitespace().collect();
    let number = |n: usize| words.get(n).and_then(|w| w.parse::<usize>().ok());
    let (scalar, components, meaning) = match words.first().map(|w| w.to_ascii_uppercase()).as_deref() {
        Some("SCALARS") => {
            let scalar = scalar_type(words.get(2).unwrap_or(&"")).map_err(fail)?;
            // The following table is named, and may be missing.
            let table = line(path, reader)?.unwrap_or_default();
            if !table.to_ascii_uppercase().starts_with("LOOKUP_TABLE") {
                return Err(fail(
                    "has scalars without a lookup table; its header is damaged".into(),
                ));
            }
            (scalar, number(3).unwrap_or(1), Meaning::Unstated)
        }
        Some("COLOR_SCALARS") => {
            let components =
                number(2).ok_or_else(|| fail(format!("has \"{text}\", which cannot be read")))?;
            (
                if header.binary {
                    ScalarType::U8
                } else {
                    ScalarType::F32
                },
                components,
                Meaning::Color,
            )
        }
        Some("VECTORS" | "NORMALS") => (
            scalar_type(words.get(2).unwrap_or(&"")).map_err(fail)?,
            3,
            Meaning::Vectors,
        ),
        Some(word @ ("TENSORS" | "TENSORS6" | "TEXTURE_COORDINATES")) => {
            return Err(fail(format!(
                "holds {word}, which cannot be shown; scalars, vectors and colours can"
            )));
        }
        // Fields before the points belong to the whole data set.
        Some("FIELD") if header.size.is_some() => {
            let next = line(path, reader)?.unwrap_or_default();
            let words: Vec<&str> = next.split_whitespace().collect();
            let [_, components, _, kind, ..] = words[..] else {
                return Err(fail(format!("has the field \"{next}\", which cannot be read")));
            };
            let components = components
                .parse::<usize>()
                .map_err(|_| fail(format!("has the field \"{next}\", which cannot be read")))?;
            (scalar_type(kind).map_err(fail)?, components, Meaning::Unstated)
        }
        _ => return Ok(None),
    };
    Ok(Some(ValueArray {
        scalar,
        components,
        meaning,
    }))
}

fn scalar_type(name: &str) -> Result<ScalarType, String> {
    Ok(match name.to_ascii_lowercase().as_str() {
        "unsigned_char" => ScalarType::U8,
        "char" | "signed_char" => ScalarType::I8,
        "unsigned_short" => ScalarType::U16,
        "short" => ScalarType::I16,
        "unsigned_int" => ScalarType::U32,
        "int" => ScalarType::I32,
        "unsigned_long" | "unsigned_long_long" | "vtktypeuint64" => ScalarType::U64,
        "long" | "long_long" | "vtktypeint64" | "vtkidtype" => ScalarType::I64,
        "float" => ScalarType::F32,
        "double" => ScalarType::F64,
        _ => return Err(format!("has the type \"{name}\", which is not supported")),
    })
}
