//! PLY, text and binary in either byte order: the positions of the element "vertex", and the faces
//! ("face", or "tristrips" as in the files of the Stanford repository). Our own reader: the numbers
//! of a text file are separated by any white space, which the library reads by lines; and strips
//! are wanted. Source: Turk, "The PLY Polygon File Format", 1994.

use super::MeshFileContents;
use glam::Vec3;

/// Names of the list of a face's corners.
const CORNERS: [&str; 2] = ["vertex_indices", "vertex_index"];

/// Type of a number.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn named(name: &str) -> Result<Self, String> {
        Ok(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return Err(format!("has a property of the unknown type \"{name}\"")),
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value of little-endian bytes, as many as [`Self::bytes`].
    fn value(self, b: [u8; 8]) -> f64 {
        let four = [b[0], b[1], b[2], b[3]];
        match self {
            Self::I8 => f64::from(b[0] as i8),
            Self::U8 => f64::from(b[0]),
            Self::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            Self::I32 => f64::from(i32::from_le_bytes(four)),
            Self::U32 => f64::from(u32::from_le_bytes(four)),
            Self::F32 => f64::from(f32::from_le_bytes(four)),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

/// A number, or a list of them after its length.
struct Property {
    name: String,
    count: Option<Number>,
    number: Number,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Form {
    Text,
    LittleEndian,
    BigEndian,
}

pub fn read(bytes: &[u8]) -> Result<MeshFileContents, String> {
    let (form, elements, body) = header(bytes)?;
    let mut numbers = Numbers { form, rest: body };
    let mut listing = MeshFileContents::default();
    for element in &elements {
        // An element of any size takes at least one byte.
        if element.count > bytes.len() {
            return Err(format!(
                "declares {} elements \"{}\", more than a file of {} bytes can hold",
                element.count,
                element.name,
                bytes.len()
            ));
        }
        for n in 0..element.count {
            numbers
                .element(element, &mut listing)
                .map_err(|problem| format!("{problem} ({} {n} of {})", element.name, element.count))?;
        }
    }
    Ok(listing)
}

/// The form of the data, the elements, and the bytes after the header.
fn header(bytes: &[u8]) -> Result<(Form, Vec<Element>, &[u8]), String> {
    let (mut form, mut elements, mut rest) = (None, Vec::<Element>::new(), bytes);
    let mut first = true;
    loop {
        // Old files end their lines with a carriage return alone.
        let end = rest.iter().position(|b| matches!(b, b'\n' | b'\r'));
        let end = end.ok_or("is not a PLY file, or ends within its header (no \"end_header\")")?;
        let line = String::from_utf8_lossy(&rest[..end]);
        let crlf = rest[end] == b'\r' && rest.get(end + 1) == Some(&b'\n');
        rest = &rest[end + 1 + usize::from(crlf)..];
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        if first && words != ["ply"] {
            return Err("is not a PLY file (it does not begin with \"ply\")".into());
        }
        first = false;
        match words[..] {
            ["end_header"] => break,
            ["format", name, version] => {
                if version != "1.0" {
                    return Err(format!("is a PLY of version {version}; 1.0 can be read"));
                }
                form = Some(match name {
                    "ascii" => Form::Text,
                    "binary_little_endian" => Form::LittleEndian,
                    "binary_big_endian" => Form::BigEndian,
                    _ => return Err(format!("is a PLY in the unknown format \"{name}\"")),
                });
            }
            ["element", name, count] => elements.push(Element {
                name: name.to_owned(),
                count: count.parse().map_err(|_| {
                    format!("declares \"{count}\" elements \"{name}\", which is not a number")
                })?,
                properties: Vec::new(),
            }),
            ["property", ref property @ ..] => {
                let property = self::property(property, &line)?;
                elements
                    .last_mut()
                    .ok_or("has a property before any element in its header")?
                    .properties
                    .push(property);
            }
            // Comments, obj_info.
            _ => {}
        }
    }
    let form = form.ok_or("does not state the format of its data; it cannot be read as PLY")?;
    Ok((form, elements, rest))
}

fn property(words: &[&str], line: &str) -> Result<Property, String> {
    let (count, number, name) = match *words {
        ["list", count, number, name] => (Some(Number::named(count)?), number, name),
        [number, name] => (None, number, name),
        _ => {
            return Err(format!(
                "has the property \"{}\", which cannot be read",
                line.trim()
            ));
        }
    };
    Ok(Property {
        name: name.to_owned(),
        count,
        number: Number::named(number)?,
    })
}

/// The numbers after the header.
struct Numbers<'a> {
    form: Form,
    rest: &'a [u8],
}

impl Numbers<'_> {
    fn next(&mut self, number: Number) -> Result<f64, String> {
        let short = "ends too early: it is truncated; copy or export it again";
        if self.form == Form::Text {
            self.rest = self.rest.trim_ascii_start();
            let end = self.rest.iter().position(u8::is_ascii_whitespace);
            let (word, rest) = self.rest.split_at(end.unwrap_or(self.rest.len()));
            self.rest = rest;
            if word.is_empty() {
                return Err(short.into());
            }
            let word = String::from_utf8_lossy(word);
            return word
                .parse()
                .map_err(|_| format!("has \"{}\" where a number should be", word.escape_default()));
        }
        let (bytes, rest) = self.rest.split_at_checked(number.bytes()).ok_or(short)?;
        self.rest = rest;
        let mut all = [0; 8];
        all[..bytes.len()].copy_from_slice(bytes);
        if self.form == Form::BigEndian {
            all[..bytes.len()].reverse();
        }
        Ok(number.value(all))
    }

    /// Reads one element and adds what it is to the mesh.
    fn element(&mut self, element: &Element, listing: &mut MeshFileContents) -> Result<(), String> {
        let mut point = [0.0; 3];
        let mut corners = Vec::new();
        for property in &element.properties {
            let Some(count) = property.count else {
                let value = self.next(property.number)?;
                if let Some(axis) = ["x", "y", "z"].iter().position(|a| *a == property.name) {
                    point[axis] = value;
                }
                continue;
            };
            let count = self.next(count)?;
            // Every number takes a byte.
            if !(0.0..=self.rest.len() as f64).contains(&count) || count.fract() != 0.0 {
                return Err(format!(
                    "declares a list of {count} numbers, which it cannot hold"
                ));
            }
            let wanted = CORNERS.contains(&property.name.as_str());
            for _ in 0..count as usize {
                let value = self.next(property.number)?;
                if wanted {
                    corners.push(value);
                }
            }
        }
        match element.name.as_str() {
            "vertex" => listing.positions.push(Vec3::from(point.map(|c| c as f32))),
            "face" => {
                let face: Vec<u32> = corners.into_iter().map(vertex).collect::<Result<_, _>>()?;
                listing.face(&face);
            }
            "tristrips" => strips(&corners, listing)?,
            _ => {}
        }
        Ok(())
    }
}

fn vertex(number: f64) -> Result<u32, String> {
    if (0.0..=f64::from(u32::MAX)).contains(&number) && number.fract() == 0.0 {
        Ok(number as u32)
    } else {
        Err(format!(
            "has a face with the vertex number {number}; it must be a whole number that is not negative"
        ))
    }
}

/// Strips of triangles, separated by -1; every second triangle is turned.
fn strips(corners: &[f64], listing: &mut MeshFileContents) -> Result<(), String> {
    for strip in corners.split(|c| *c < 0.0) {
        let strip: Vec<u32> = strip.iter().map(|c| vertex(*c)).collect::<Result<_, _>>()?;
        for (n, t) in strip.windows(3).enumerate() {
            // Repeated corners join strips.
            if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
                let turned = n % 2 == 1;
                listing.triangles.push(if turned {
                    [t[1], t[0], t[2]]
                } else {
                    [t[0], t[1], t[2]]
                });
            }
        }
    }
    Ok(())
}
