//! PLY, text and binary, by the ply-rs-bw library, which allocates no more than it reads.

use super::MeshFileContents;
use glam::Vec3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{PropertyAccess, PropertyAccessResult};

/// A vertex or a face, depending on the element.
#[derive(Default)]
struct Element {
    point: [f64; 3],
    corners: Vec<i64>,
}

impl Element {
    fn coordinate(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        match name {
            "x" => self.point[0] = value,
            "y" => self.point[1] = value,
            "z" => self.point[2] = value,
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }

    fn list<T: Copy + Into<i64>>(&mut self, name: &str, values: &[T]) -> PropertyAccessResult {
        if !matches!(name, "vertex_indices" | "vertex_index") {
            return PropertyAccessResult::Ignored;
        }
        self.corners = values.iter().map(|v| (*v).into()).collect();
        PropertyAccessResult::Set
    }
}

macro_rules! scalars {
    ($($method:ident: $t:ty),*) => {$(
        fn $method(&mut self, name: &str, value: $t) -> PropertyAccessResult {
            self.coordinate(name, f64::from(value))
        }
    )*};
}

macro_rules! lists {
    ($($method:ident: $t:ty),*) => {$(
        fn $method(&mut self, name: &str, value: Vec<$t>) -> PropertyAccessResult {
            self.list(name, &value)
        }
    )*};
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Self::default()
    }

    scalars!(set_char: i8, set_uchar: u8, set_short: i16, set_ushort: u16, set_int: i32, set_uint: u32, set_float: f32, set_double: f64);
    lists!(set_list_char: i8, set_list_uchar: u8, set_list_short: i16, set_list_ushort: u16, set_list_int: i32, set_list_uint: u32);
}

pub fn read(bytes: &[u8]) -> Result<MeshFileContents, String> {
    let parser = Parser::<Element>::new();
    let mut reader = Reader::new(std::io::Cursor::new(bytes));
    let broken = |e: &dyn std::fmt::Display| format!("is not a readable PLY: {e}");
    let header = parser.read_header(&mut reader).map_err(|e| broken(&e))?;
    let mut listing = MeshFileContents::default();
    for (name, element) in &header.elements {
        // An element takes at least one byte.
        if element.count > bytes.len() {
            return Err(format!(
                "declares {} elements \"{name}\", more than a file of {} bytes can hold",
                element.count,
                bytes.len()
            ));
        }
        let read = parser
            .read_payload_for_element(&mut reader, element, &header)
            .map_err(|e| broken(&e))?;
        match name.as_str() {
            "vertex" => {
                listing.positions = read
                    .iter()
                    .map(|v| Vec3::from(v.point.map(|c| c as f32)))
                    .collect()
            }
            "face" => {
                for face in read {
                    let corners: Result<Vec<u32>, _> =
                        face.corners.iter().map(|&c| u32::try_from(c)).collect();
                    listing.face(&corners.map_err(|_| "has a face with a negative vertex number")?);
                }
            }
            _ => {}
        }
    }
    Ok(listing)
}
