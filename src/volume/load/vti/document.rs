//! The tags of a `.vti` file: the image's geometry, its pieces and their arrays.

use super::super::ScalarType;
use super::super::source::read_error;
use super::decoding::Compression;
use crate::{Error, Result};
use glam::{DMat3, DVec3};
use quick_xml::events::{BytesStart, Event};
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Maximum length of a tag, bytes.
const MAX_TAG_BYTES: usize = 1 << 20;

/// An array: its type and the location of its values.
#[derive(Clone, Debug)]
pub(super) struct VtiArray {
    pub name: String,
    pub scalar: Option<ScalarType>,
    pub type_name: String,
    pub components: usize,
    pub place: ArrayLocation,
}

/// The location of an array's values.
#[derive(Clone, Copy, Debug)]
pub(super) enum ArrayLocation {
    /// Text, from this byte of the file.
    Text(u64),
    /// Base64, from this byte of the file.
    Base64(u64),
    /// An offset in the appended data.
    Appended(u64),
}

/// A piece of the image.
#[derive(Default, Debug)]
pub(super) struct VtiPiece {
    pub extent: [i64; 6],
    pub points: Vec<VtiArray>,
    pub cells: Vec<VtiArray>,
    /// Names of the active scalars and vectors.
    pub active: [Option<String>; 2],
}

/// The content of a file's tags.
pub(super) struct VtiDocument {
    pub whole: [i64; 6],
    pub origin: DVec3,
    /// Distance between points, if stated.
    pub spacing: Option<DVec3>,
    pub direction: DMat3,
    pub directed: bool,
    pub big_endian: bool,
    pub wide: bool,
    pub packing: Compression,
    pub pieces: Vec<VtiPiece>,
    /// First byte of the appended data, and whether it is base64.
    pub appended: Option<(u64, bool)>,
}

/// A reader that tracks its position and the length of the current tag or text, which the parser
/// holds as a whole.
struct Counting {
    inner: BufReader<File>,
    at: u64,
    of_event: usize,
}

impl Read for Counting {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let read = self.inner.read(bytes)?;
        self.at += read as u64;
        Ok(read)
    }
}

impl BufRead for Counting {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        if self.of_event > MAX_TAG_BYTES {
            return Err(std::io::Error::new(
                std::io::ErrorKind::InvalidData,
                "a tag or text longer than 1 MiB",
            ));
        }
        self.inner.fill_buf()
    }
    fn consume(&mut self, amount: usize) {
        self.at += amount as u64;
        self.of_event += amount;
        self.inner.consume(amount);
    }
}

impl Counting {
    /// Skips everything before a given byte.
    fn pass_to(&mut self, wanted: u8) -> std::io::Result<()> {
        loop {
            let bytes = self.inner.fill_buf()?;
            if bytes.is_empty() {
                return Ok(());
            }
            let found = bytes.iter().position(|b| *b == wanted);
            let passed = found.unwrap_or(bytes.len());
            self.inner.consume(passed);
            self.at += passed as u64;
            if found.is_some() {
                return Ok(());
            }
        }
    }
}

fn attributes(tag: &BytesStart) -> HashMap<String, String> {
    tag.attributes()
        .with_checks(false)
        .flatten()
        .map(|a| (a.key.as_ref().to_owned(), a.value.into_owned()))
        .collect()
}

fn numbers<T: std::str::FromStr, const N: usize>(text: Option<&String>) -> Option<[T; N]> {
    let all: Vec<T> = text?.split_whitespace().map_while(|w| w.parse().ok()).collect();
    all.try_into().ok()
}

/// The content of a file's tags, up to the appended data.
pub(super) fn document(path: &Path, reader: BufReader<File>) -> Result<VtiDocument> {
    let fail = |problem: String| Error::file(path, problem);
    let mut xml = quick_xml::Reader::from_reader(Counting {
        inner: reader,
        at: 0,
        of_event: 0,
    });
    xml.config_mut().check_end_names = false;
    let mut parser = DocumentParser::new(path);
    let mut buffer = Vec::new();
    loop {
        buffer.clear();
        xml.get_mut().of_event = 0;
        let event = xml
            .read_event_into(&mut buffer)
            .map_err(|e| fail(format!("is not readable XML ({e}); it is truncated or damaged")))?;
        let (tag, empty) = match &event {
            Event::Start(tag) => (tag, false),
            Event::Empty(tag) => (tag, true),
            Event::End(tag) => {
                if matches!(tag.name().as_ref(), "PointData" | "CellData") {
                    parser.section = None;
                }
                continue;
            }
            Event::Eof => break,
            _ => continue,
        };
        if tag.len() > MAX_TAG_BYTES {
            return Err(fail("has a tag of a megabyte; it is damaged".into()));
        }
        let given = attributes(tag);
        match tag.name().as_ref() {
            "VTKFile" => parser.vtk_file(&given)?,
            "ImageData" if parser.is_image => parser.image_data(&given)?,
            "Piece" if parser.is_image => parser.piece(&given),
            name @ ("PointData" | "CellData") => {
                parser.enter_section((!empty).then_some(usize::from(name == "CellData")), &given)
            }
            "DataArray" | "Array" => {
                // Values are skipped.
                parser.data_array(&given, xml.get_ref().at)?;
                if !empty {
                    xml.get_mut().pass_to(b'<').map_err(|e| read_error(path, e))?;
                }
            }
            "AppendedData" => {
                let base64 = given.get("encoding").is_some_and(|e| e == "base64");
                let reader = xml.get_mut();
                reader.pass_to(b'_').map_err(|e| read_error(path, e))?;
                parser.document.appended = Some((reader.at + 1, base64));
                break;
            }
            _ => {}
        }
    }
    if !parser.is_image {
        return Err(fail("is not a VTK file: it has no VTKFile element".into()));
    }
    Ok(parser.document)
}

/// A document as parsed so far.
struct DocumentParser<'a> {
    path: &'a Path,
    document: VtiDocument,
    /// Whether arrays belong to points (0), to cells (1), or to neither.
    section: Option<usize>,
    is_image: bool,
}

impl<'a> DocumentParser<'a> {
    /// A parser at the start of a file.
    fn new(path: &'a Path) -> Self {
        let document = VtiDocument {
            whole: [0; 6],
            origin: DVec3::ZERO,
            spacing: None,
            direction: DMat3::IDENTITY,
            directed: false,
            big_endian: false,
            wide: false,
            packing: Compression::None,
            pieces: Vec::new(),
            appended: None,
        };
        Self {
            path,
            document,
            section: None,
            is_image: false,
        }
    }

    /// An error about the file.
    fn fail(&self, problem: String) -> Error {
        Error::file(self.path, problem)
    }

    /// `VTKFile`: type of data, byte order, compression.
    fn vtk_file(&mut self, given: &HashMap<String, String>) -> Result<()> {
        let kind = given.get("type").map_or("", String::as_str);
        if kind != "ImageData" {
            return Err(self.fail(format!(
                "is a VTK file of type \"{kind}\"; image data (.vti) can be read as a volume"
            )));
        }
        self.is_image = true;
        self.document.big_endian = given.get("byte_order").is_some_and(|b| b == "BigEndian");
        self.document.wide = given.get("header_type").is_some_and(|t| t == "UInt64");
        self.document.packing = match given.get("compressor").map_or("", String::as_str) {
            "" => Compression::None,
            "vtkZLibDataCompressor" => Compression::Zlib,
            "vtkLZ4DataCompressor" => Compression::Lz4,
            "vtkLZMADataCompressor" => Compression::Lzma,
            other => {
                return Err(self.fail(format!(
                    "is compressed by {other}, which cannot be read; save it with zlib"
                )));
            }
        };
        Ok(())
    }

    /// `ImageData`: extent and geometry of the whole image.
    fn image_data(&mut self, given: &HashMap<String, String>) -> Result<()> {
        self.document.whole = numbers(given.get("WholeExtent"))
            .ok_or_else(|| self.fail("has no readable WholeExtent".into()))?;
        let vector = |name: &str| match given.get(name) {
            None => Ok(None),
            some => numbers::<f64, 3>(some)
                .map(|v| Some(DVec3::from_array(v)))
                .ok_or_else(|| self.fail(format!("has a {name} that is not three numbers"))),
        };
        let (origin, spacing) = (vector("Origin")?, vector("Spacing")?);
        (self.document.origin, self.document.spacing) = (origin.unwrap_or(DVec3::ZERO), spacing);
        if given.contains_key("Direction") {
            let rows: [f64; 9] = numbers(given.get("Direction"))
                .ok_or_else(|| self.fail("has a Direction that is not nine numbers".into()))?;
            self.document.direction = DMat3::from_cols_array(&rows).transpose();
            self.document.directed = true;
        }
        Ok(())
    }

    /// `Piece`: its extent; by default that of the whole.
    fn piece(&mut self, given: &HashMap<String, String>) {
        let extent = numbers(given.get("Extent")).unwrap_or(self.document.whole);
        self.document.pieces.push(VtiPiece {
            extent,
            ..VtiPiece::default()
        });
    }

    /// `PointData` or `CellData`: the section of the following arrays, and which of them are
    /// active.
    fn enter_section(&mut self, section: Option<usize>, given: &HashMap<String, String>) {
        self.section = section;
        if let Some(piece) = self.document.pieces.last_mut()
            && piece.active == [None, None]
        {
            piece.active = [given.get("Scalars").cloned(), given.get("Vectors").cloned()];
        }
    }

    /// `DataArray`, with its text at a byte of the file; arrays of neither points nor cells are
    /// ignored.
    fn data_array(&mut self, given: &HashMap<String, String>, at: u64) -> Result<()> {
        let Some(section) = self.section else {
            return Ok(());
        };
        let place = match given.get("format").map_or("ascii", String::as_str) {
            "ascii" => ArrayLocation::Text(at),
            "binary" => ArrayLocation::Base64(at),
            "appended" => {
                ArrayLocation::Appended(given.get("offset").and_then(|o| o.parse().ok()).unwrap_or(0))
            }
            other => {
                return Err(self.fail(format!(
                    "has an array in the format \"{other}\", which cannot be read"
                )));
            }
        };
        let type_name = given.get("type").cloned().unwrap_or_default();
        let components = given
            .get("NumberOfComponents")
            .map_or(Some(1), |n| n.parse().ok())
            .filter(|n| (1..=1024).contains(n));
        let array = VtiArray {
            name: given.get("Name").cloned().unwrap_or_default(),
            scalar: ScalarType::named(&type_name),
            type_name,
            components: components
                .ok_or_else(|| self.fail("has an array with an impossible number of components".into()))?,
            place,
        };
        if let Some(piece) = self.document.pieces.last_mut() {
            if section == 0 {
                &mut piece.points
            } else {
                &mut piece.cells
            }
            .push(array);
        }
        Ok(())
    }
}
