//! GIfTI surfaces (`.gii`): XML with one array of points and one of triangles, by quick-xml, base64
//! and flate2. RAS, as in the whole NIfTI family: x and y are negated on reading.

use super::MeshFileContents;
use base64::Engine;
use glam::Vec3;
use quick_xml::events::Event;
use std::io::Read;

/// Maximum number of bytes of one array: a compressed file can expand a thousandfold.
const MAX_BYTES: u64 = 2 << 30;

#[derive(Default)]
struct GiftiArray {
    intent: String,
    data_type: String,
    encoding: String,
    big_endian: bool,
    column_major: bool,
    dims: [u64; 2],
    data: String,
}

pub fn read(bytes: &[u8]) -> Result<MeshFileContents, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "is not text")?;
    let mut points: Option<Vec<Vec3>> = None;
    let mut triangles: Option<Vec<[u32; 3]>> = None;
    for array in arrays(text)? {
        match array.intent.as_str() {
            "NIFTI_INTENT_POINTSET" => {
                let values: Vec<f64> = array.values()?;
                // In the data's own space; the file's matrices lead from there to templates.
                let lps = |v: &[f64]| Vec3::new(-v[0] as f32, -v[1] as f32, v[2] as f32);
                points = Some(values.chunks_exact(3).map(lps).collect());
            }
            "NIFTI_INTENT_TRIANGLE" => {
                let index = |v: &f64| {
                    if *v >= 0.0 && *v < 4e9 {
                        Ok(*v as u32)
                    } else {
                        Err(format!("has a triangle with the invalid vertex index {v}"))
                    }
                };
                let values: Vec<u32> = array.values()?.iter().map(index).collect::<Result<_, _>>()?;
                triangles = Some(values.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect());
            }
            _ => {}
        }
    }
    match (points, triangles) {
        (Some(positions), Some(triangles)) => Ok(MeshFileContents {
            positions,
            triangles,
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
                }
            }
            Event::Text(content) => {
                let content = content.into_inner();
                if let (Some(array), "Data") = (&mut current, inside.as_str()) {
                    array.data.push_str(&content);
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
    /// The values, row by row.
    fn values(&self) -> Result<Vec<f64>, String> {
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
            let packed: Vec<u8> = self.data.bytes().filter(|b| !b.is_ascii_whitespace()).collect();
            let mut bytes = base64::engine::general_purpose::STANDARD
                .decode(packed)
                .map_err(|e| format!("has broken base64: {e}"))?;
            match self.encoding.as_str() {
                "Base64Binary" => {}
                "GZipBase64Binary" => {
                    let mut plain = Vec::new();
                    let most = count as u64 * 8 + 1;
                    flate2::read::ZlibDecoder::new(&bytes[..])
                        .take(most)
                        .read_to_end(&mut plain)
                        .map_err(|e| format!("has an array that cannot be decompressed: {e}"))?;
                    bytes = plain;
                }
                other => return Err(format!("stores its arrays as {other}, which is not supported")),
            }
            let four = |b: &[u8]| {
                let b = [b[0], b[1], b[2], b[3]];
                if self.big_endian {
                    u32::from_be_bytes(b)
                } else {
                    u32::from_le_bytes(b)
                }
            };
            match self.data_type.as_str() {
                "NIFTI_TYPE_FLOAT32" => bytes
                    .chunks_exact(4)
                    .map(|b| f64::from(f32::from_bits(four(b))))
                    .collect(),
                "NIFTI_TYPE_INT32" => bytes.chunks_exact(4).map(|b| f64::from(four(b) as i32)).collect(),
                "NIFTI_TYPE_UINT32" => bytes.chunks_exact(4).map(|b| f64::from(four(b))).collect(),
                other => {
                    return Err(format!(
                        "has an array of {other}; points are FLOAT32, triangles INT32"
                    ));
                }
            }
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
}
