//! GIfTI surfaces (`.gii`): XML with one array of points and one of triangles, by quick-xml, base64
//! and flate2; arrays may lie in another file. RAS, as in the whole NIfTI family: x and y are
//! negated on reading. Points in a space of their own are moved to the scanner's if the file has
//! the matrix. Source: GIFTI Surface Data Format, version 1.0.

use super::MeshFileContents;
use crate::Error;
use crate::files::{input, reference};
use base64::Engine;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use quick_xml::events::Event;
use std::io::Read;
use std::path::Path;

/// Maximum number of bytes of one array: a compressed file can expand a thousandfold.
const MAX_BYTES: u64 = 2 << 30;

/// Spaces of a NIfTI image, as GIfTI names them.
const SCANNER: &str = "NIFTI_XFORM_SCANNER_ANAT";

#[derive(Default)]
struct GiftiArray {
    intent: String,
    data_type: String,
    encoding: String,
    big_endian: bool,
    column_major: bool,
    dims: [u64; 2],
    data: String,
    /// File with the values, and the place of the first one.
    external: Option<String>,
    offset: u64,
    /// Transforms to other spaces.
    spaces: Vec<Space>,
}

/// A transform from the array's own space to another one.
#[derive(Default)]
struct Space {
    from: String,
    to: String,
    numbers: String,
}

pub fn read(bytes: &[u8], path: Option<&Path>) -> Result<MeshFileContents, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "is not text")?;
    let mut points: Option<Vec<Vec3>> = None;
    let mut triangles: Option<Vec<[u32; 3]>> = None;
    let (mut warnings, mut sets) = (Vec::new(), 0);
    for array in arrays(text)? {
        match array.intent.as_str() {
            "NIFTI_INTENT_POINTSET" => {
                sets += 1;
                if sets == 1 {
                    points = Some(array.points(path, &mut warnings)?);
                }
            }
            "NIFTI_INTENT_TRIANGLE" if triangles.is_none() => {
                let index = |v: &f64| {
                    if *v >= 0.0 && *v < 4e9 {
                        Ok(*v as u32)
                    } else {
                        Err(format!("has a triangle with the invalid vertex index {v}"))
                    }
                };
                let values: Vec<u32> = array.values(path)?.iter().map(index).collect::<Result<_, _>>()?;
                triangles = Some(values.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect());
            }
            _ => {}
        }
    }
    if sets > 1 {
        warnings.push(format!("holds {sets} sets of points; the first is used"));
    }
    match (points, triangles) {
        (Some(positions), Some(triangles)) => Ok(MeshFileContents {
            positions,
            triangles,
            warnings,
            ..MeshFileContents::default()
        }),
        (Some(_), None) => Err("holds points but no triangles; give the surface file".into()),
        (None, Some(_)) => Err("holds triangles but no points; give the file that holds both".into()),
        (None, None) => Err("holds no surface: neither points nor triangles".into()),
    }
}

fn arrays(text: &str) -> Result<Vec<GiftiArray>, String> {
    let broken = |e: &dyn std::fmt::Display| format!("is not readable XML: {e}");
    let mut reader = quick_xml::Reader::from_str(text);
    let mut all = Vec::new();
    let mut current: Option<GiftiArray> = None;
    let mut inside = String::new();
    loop {
        match reader.read_event().map_err(|e| broken(&e))? {
            Event::Start(tag) => {
                inside = tag.name().as_ref().to_owned();
                if inside == "DataArray" {
                    let mut array = GiftiArray::default();
                    for attribute in tag.attributes() {
                        let attribute = attribute.map_err(|e| broken(&e))?;
                        let value = attribute.value.into_owned();
                        match attribute.key.as_ref() {
                            "Intent" => array.intent = value,
                            "DataType" => array.data_type = value,
                            "Encoding" => array.encoding = value,
                            "ExternalFileName" if !value.is_empty() => array.external = Some(value),
                            "ExternalFileOffset" => array.offset = value.trim().parse().unwrap_or(0),
                            "Endian" => array.big_endian = value == "BigEndian",
                            "ArrayIndexingOrder" => array.column_major = value == "ColumnMajorOrder",
                            "Dim0" => {
                                array.dims[0] = value.parse().map_err(|_| "has an array without a size")?
                            }
                            "Dim1" => {
                                array.dims[1] = value.parse().map_err(|_| "has an array without a size")?
                            }
                            _ => {}
                        }
                    }
                    current = Some(array);
                } else if let (Some(array), "CoordinateSystemTransformMatrix") =
                    (&mut current, inside.as_str())
                {
                    array.spaces.push(Space::default());
                }
            }
            Event::Text(content) => {
                if let Some(array) = &mut current {
                    array.text(&inside, &content.into_inner());
                }
            }
            Event::CData(content) => {
                if let Some(array) = &mut current {
                    array.text(&inside, &content.into_inner());
                }
            }
            Event::End(tag) => {
                if tag.name().as_ref() == "DataArray" {
                    all.extend(current.take());
                }
                inside.clear();
            }
            Event::Eof => return Ok(all),
            _ => {}
        }
    }
}

impl GiftiArray {
    /// Adds the text inside a tag.
    fn text(&mut self, tag: &str, text: &str) {
        let space = self.spaces.last_mut();
        match (tag, space) {
            ("Data", _) => self.data.push_str(text),
            ("DataSpace", Some(space)) => space.from.push_str(text.trim()),
            ("TransformedSpace", Some(space)) => space.to.push_str(text.trim()),
            ("MatrixData", Some(space)) => space.numbers.push_str(text),
            _ => {}
        }
    }

    /// The points in LPS. They are in the array's own space; if that is not the scanner's but a
    /// matrix leads there, it is applied. Matrices to templates are not.
    fn points(&self, path: Option<&Path>, warnings: &mut Vec<String>) -> Result<Vec<Vec3>, String> {
        let to_scanner = self.spaces.iter().find(|s| s.to == SCANNER && s.from != SCANNER);
        let scanner_from_own = to_scanner.map_or(Ok(DAffine3::IDENTITY), Space::matrix)?;
        if scanner_from_own != DAffine3::IDENTITY {
            warnings.push("was moved to scanner coordinates by the matrix in the file".into());
        }
        let values = self.values(path)?;
        let lps = |v: &[f64]| {
            let p = scanner_from_own.transform_point3(DVec3::new(v[0], v[1], v[2]));
            Vec3::new(-p.x as f32, -p.y as f32, p.z as f32)
        };
        Ok(values.chunks_exact(3).map(lps).collect())
    }

    /// The values, row by row.
    fn values(&self, path: Option<&Path>) -> Result<Vec<f64>, String> {
        let [rows, columns] = self.dims;
        let count = rows
            .checked_mul(columns)
            .filter(|n| *n <= MAX_BYTES / 4)
            .ok_or("declares an array too large to be read")? as usize;
        if columns != 3 {
            return Err(format!(
                "has an array of {rows} x {columns}; points and triangles have three columns"
            ));
        }
        let values = if self.encoding == "ASCII" {
            self.data
                .split_ascii_whitespace()
                .map(|w| {
                    w.parse::<f64>()
                        .map_err(|_| format!("has \"{w}\" where a number should be"))
                })
                .collect::<Result<Vec<_>, _>>()?
        } else {
            self.numbers(&self.bytes(path, count)?)?
        };
        if values.len() != count {
            return Err(format!(
                "has an array of {} values that declares {count}",
                values.len()
            ));
        }
        if self.column_major {
            let rows = rows as usize;
            return Ok((0..count).map(|n| values[n % 3 * rows + n / 3]).collect());
        }
        Ok(values)
    }

    /// The bytes of `count` values that are not text.
    fn bytes(&self, path: Option<&Path>, count: usize) -> Result<Vec<u8>, String> {
        if self.encoding == "ExternalFileBinary" {
            return self.external_bytes(path, count);
        }
        let packed: Vec<u8> = self.data.bytes().filter(|b| !b.is_ascii_whitespace()).collect();
        let bytes = base64::engine::general_purpose::STANDARD
            .decode(packed)
            .map_err(|e| format!("has broken base64: {e}"))?;
        match self.encoding.as_str() {
            "Base64Binary" => Ok(bytes),
            "GZipBase64Binary" => {
                let mut plain = Vec::new();
                let most = count as u64 * 8 + 1;
                flate2::read::ZlibDecoder::new(&bytes[..])
                    .take(most)
                    .read_to_end(&mut plain)
                    .map_err(|e| format!("has an array that cannot be decompressed: {e}"))?;
                Ok(plain)
            }
            other => Err(format!("stores its arrays as {other}, which is not supported")),
        }
    }

    /// The bytes of an array in another file.
    fn external_bytes(&self, path: Option<&Path>, count: usize) -> Result<Vec<u8>, String> {
        let name = self
            .external
            .as_deref()
            .ok_or("has an array in another file and does not name it")?;
        let path = path.ok_or_else(|| format!("refers to the file {name}, which cannot be located"))?;
        let file = reference::sibling_file(path, name);
        let bytes = file.and_then(|file| input::bytes(&file, super::MAX_BYTES, "array of a GIfTI"));
        // Both messages name the mesh's file.
        let bytes = bytes.map_err(|e| match e {
            Error::File { path: of, problem } if of == path => problem,
            other => format!("refers to a file that cannot be read: {other}"),
        })?;
        let end = (self.offset as usize).saturating_add(count.saturating_mul(self.value_bytes()?));
        bytes
            .get(self.offset as usize..end)
            .map(<[u8]>::to_vec)
            .ok_or_else(|| {
                format!(
                    "refers to bytes {} to {end} of {name}, which has {} bytes; copy it again",
                    self.offset,
                    bytes.len()
                )
            })
    }

    /// Bytes of one value.
    fn value_bytes(&self) -> Result<usize, String> {
        Ok(match self.data_type.as_str() {
            "NIFTI_TYPE_INT8" | "NIFTI_TYPE_UINT8" => 1,
            "NIFTI_TYPE_INT16" | "NIFTI_TYPE_UINT16" => 2,
            "NIFTI_TYPE_FLOAT32" | "NIFTI_TYPE_INT32" | "NIFTI_TYPE_UINT32" => 4,
            "NIFTI_TYPE_FLOAT64" | "NIFTI_TYPE_INT64" | "NIFTI_TYPE_UINT64" => 8,
            other => return Err(format!("has an array of {other}, which is not supported")),
        })
    }

    /// Numbers of the array's type and byte order.
    fn numbers(&self, bytes: &[u8]) -> Result<Vec<f64>, String> {
        let width = self.value_bytes()?;
        let number = |chunk: &[u8]| {
            let mut b = [0u8; 8];
            b[..width].copy_from_slice(chunk);
            if self.big_endian {
                b[..width].reverse();
            }
            let bits = u64::from_le_bytes(b);
            match self.data_type.as_str() {
                "NIFTI_TYPE_INT8" => f64::from(bits as i8),
                "NIFTI_TYPE_INT16" => f64::from(bits as i16),
                "NIFTI_TYPE_INT32" => f64::from(bits as i32),
                "NIFTI_TYPE_INT64" => bits as i64 as f64,
                "NIFTI_TYPE_FLOAT32" => f64::from(f32::from_bits(bits as u32)),
                "NIFTI_TYPE_FLOAT64" => f64::from_bits(bits),
                _ => bits as f64,
            }
        };
        Ok(bytes.chunks_exact(width).map(number).collect())
    }
}

impl Space {
    fn matrix(&self) -> Result<DAffine3, String> {
        let m: Option<Vec<f64>> = self
            .numbers
            .split_ascii_whitespace()
            .map(|w| w.parse().ok().filter(|v: &f64| v.is_finite()))
            .collect();
        let m = m.filter(|m| m.len() == 16);
        let m = m.ok_or("has a matrix to scanner coordinates that is not 4 x 4 numbers")?;
        let column = |c: usize| DVec3::new(m[c], m[4 + c], m[8 + c]);
        Ok(DAffine3 {
            matrix3: DMat3::from_cols(column(0), column(1), column(2)),
            translation: column(3),
        })
    }
}
