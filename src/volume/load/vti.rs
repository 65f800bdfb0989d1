//! VTK image data in XML, `.vti`: values inline or appended, as text, base64 or raw, plain or in
//! compressed blocks; one piece or several.
//!
//! *Geometry*: `Origin`, `Spacing` and `Direction` (columns are the axes) in LPS, as left by
//! programs that read medical images into VTK. Source: VTK file formats (VTK User's Guide;
//! vtkXMLDataParser).

use super::super::StoredValues;
use super::ReadOptions;
use super::ScalarType;
use super::image::{Image, Meaning};
use super::source::{DEFLATE_LIMIT, ValueReader, buffered, check_held, count, read_error, usable, with_scalar, zeroed};
use crate::{Error, Result, Watch};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::read::ZlibDecoder;
use glam::{DAffine3, DMat3, DVec3};
use quick_xml::events::{BytesStart, Event};
use rayon::prelude::*;
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Number of compressed blocks unpacked at once.
const BLOCKS_AT_ONCE: usize = 256;
/// Maximum size of a block, bytes.
const MAX_BLOCK_BYTES: u64 = 1 << 28;
/// Maximum length of a tag, bytes.
const MAX_TAG_BYTES: usize = 1 << 20;

/// The location of an array's values.
#[derive(Clone, Debug)]
struct VtiArray {
    name: String,
    scalar: Option<ScalarType>,
    type_name: String,
    components: usize,
    place: ArrayLocation,
}

#[derive(Clone, Copy, Debug)]
enum ArrayLocation {
    /// Text, from this byte of the file.
    Text(u64),
    /// Base64, from this byte of the file.
    Base64(u64),
    /// An offset in the appended data.
    Appended(u64),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Compression {
    None,
    Zlib,
    Lz4,
    Lzma,
}

#[derive(Default, Debug)]
struct VtiPiece {
    extent: [i64; 6],
    points: Vec<VtiArray>,
    cells: Vec<VtiArray>,
    active: [Option<String>; 2],
}

struct VtiDocument {
    whole: [i64; 6],
    origin: DVec3,
    spacing: DVec3,
    direction: DMat3,
    directed: bool,
    big_endian: bool,
    wide: bool,
    packing: Compression,
    pieces: Vec<VtiPiece>,
    /// First byte of the appended data, and whether it is base64.
    appended: Option<(u64, bool)>,
}

/// Reads an image.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    choice.time_of(1)?;
    let (reader, file_bytes) = buffered(path)?;
    let document = document(path, reader)?;
    let first = document.pieces.first().ok_or_else(|| fail("holds no piece of an image".into()))?;
    let (on_cells, wanted) = chosen(first).ok_or_else(|| fail("holds no array of values".into()))?;
    let extent = |e: &[i64; 6]| -> Option<[usize; 3]> {
        let mut size = [0usize; 3];
        for a in 0..3 {
            let n = e[2 * a + 1].checked_sub(e[2 * a])?.checked_add(i64::from(!on_cells))?;
            size[a] = usize::try_from(n).ok().filter(|n| *n > 0)?;
        }
        Some(size)
    };
    let size = extent(&document.whole).ok_or_else(|| fail(format!("has the empty extent {:?}", document.whole)))?;
    let scalar = wanted.scalar.ok_or_else(|| fail(format!("has the type {}, which is not supported", wanted.type_name)))?;
    let components = wanted.components;
    let total = count(path, &[size[0], size[1], size[2], components], scalar)?;
    let most = if document.packing == Compression::None { file_bytes } else { file_bytes.saturating_mul(7 * DEFLATE_LIMIT) };
    if !matches!(wanted.place, ArrayLocation::Text(_)) {
        check_held(path, (total * scalar.bytes()) as u64, most)?;
    } else {
        check_held(path, (total as u64).saturating_mul(2).saturating_sub(1), file_bytes)?;
    }
    let values = Values { path, document: &document, scalar, file_bytes, watch };
    let voxels = if let [piece] = &document.pieces[..]
        && piece.extent == document.whole
    {
        values.read(wanted, total)?
    } else {
        let mut parts = Vec::new();
        let mut covered = 0usize;
        for piece in &document.pieces {
            let part = extent(&piece.extent).ok_or_else(|| fail(format!("has a piece with the empty extent {:?}", piece.extent)))?;
            let start: Option<[usize; 3]> = (0..3)
                .map(|a| {
                    usize::try_from(piece.extent[2 * a].checked_sub(document.whole[2 * a])?)
                        .ok()
                        .filter(|s| s.checked_add(part[a]).is_some_and(|end| end <= size[a]))
                })
                .collect::<Option<Vec<_>>>()
                .and_then(|v| v.try_into().ok());
            let start = start.ok_or_else(|| fail("has a piece outside of the image's extent".into()))?;
            let array = if on_cells { &piece.cells } else { &piece.points }.iter().find(|a| a.name == wanted.name);
            let array = array.filter(|a| a.scalar == Some(scalar) && a.components == components);
            let array = array.ok_or_else(|| fail(format!("has a piece without the array \"{}\"", wanted.name)))?;
            let n = count(path, &[part[0], part[1], part[2], components], scalar)?;
            covered = covered.saturating_add(n);
            // Pieces share their outermost points; more overlap is not a division of one image.
            if covered > total.saturating_mul(8) {
                return Err(fail("has overlapping pieces".into()));
            }
            parts.push((start, part, values.read(array, n)?));
        }
        joined(path, size, components, scalar, &parts)?
    };
    let corner = DVec3::from_array(std::array::from_fn(|a| document.whole[2 * a] as f64 + if on_cells { 0.5 } else { 0.0 }));
    let linear = document.direction * DMat3::from_diagonal(document.spacing);
    let world_from_voxel = DAffine3 { matrix3: linear, translation: document.origin + linear * corner };
    if !usable(&world_from_voxel) {
        return Err(fail("has singular axes; its geometry cannot be used".into()));
    }
    let mut image = Image::new("VTK XML image data", voxels, size, world_from_voxel);
    (image.components, image.frame) = (components, Some(DMat3::IDENTITY));
    if first.active[1].as_deref() == Some(wanted.name.as_str()) && components == 3 {
        image.meaning = Meaning::Vectors;
    }
    if !document.directed {
        image.warnings.push("does not state its patient orientation; left, posterior, superior axes are assumed".into());
    }
    let others: Vec<&str> = first.points.iter().chain(&first.cells).map(|a| a.name.as_str()).filter(|n| *n != wanted.name).collect();
    if !others.is_empty() {
        image.warnings.push(format!("also holds the arrays {}; \"{}\" is used", others.join(", "), wanted.name));
    }
    Ok(image)
}

/// The array to show: the active scalars, else the active vectors, else the first; point data
/// before cell data.
fn chosen(piece: &VtiPiece) -> Option<(bool, &VtiArray)> {
    for (cells, arrays) in [(false, &piece.points), (true, &piece.cells)] {
        let active = piece.active.iter().flatten().find_map(|name| arrays.iter().find(|a| a.name == *name));
        if let Some(array) = active.or(arrays.first()) {
            return Some((cells, array));
        }
    }
    None
}

/// Pieces combined into one grid.
fn joined(
    path: &Path,
    size: [usize; 3],
    components: usize,
    scalar: ScalarType,
    parts: &[([usize; 3], [usize; 3], StoredValues)],
) -> Result<StoredValues> {
    with_scalar!(scalar, T => {
        let mut all: Vec<T> = zeroed(path, size.iter().product::<usize>() * components)?;
        for (start, part, voxels) in parts {
            let run = part[0] * components;
            for row in 0..part[1] * part[2] {
                let (j, k) = (row % part[1] + start[1], row / part[1] + start[2]);
                let to = ((k * size[1] + j) * size[0] + start[0]) * components;
                for (n, v) in all[to..to + run].iter_mut().enumerate() {
                    *v = voxels.get(row * run + n) as T;
                }
            }
        }
        Ok(all.into())
    })
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
            return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, "a tag or text longer than 1 MiB"));
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
    tag.attributes().with_checks(false).flatten().map(|a| (a.key.as_ref().to_owned(), a.value.into_owned())).collect()
}

fn numbers<T: std::str::FromStr, const N: usize>(text: Option<&String>) -> Option<[T; N]> {
    let all: Vec<T> = text?.split_whitespace().map_while(|w| w.parse().ok()).collect();
    all.try_into().ok()
}

/// The content of a file's tags, up to the appended data.
fn document(path: &Path, reader: BufReader<File>) -> Result<VtiDocument> {
    let fail = |problem: String| Error::file(path, problem);
    let mut xml = quick_xml::Reader::from_reader(Counting { inner: reader, at: 0, of_event: 0 });
    xml.config_mut().check_end_names = false;
    let mut parser = DocumentParser::new(path);
    let mut buffer = Vec::new();
    loop {
        buffer.clear();
        xml.get_mut().of_event = 0;
        let event = xml.read_event_into(&mut buffer).map_err(|e| fail(format!("is not readable XML ({e}); it is truncated or damaged")))?;
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
            name @ ("PointData" | "CellData") => parser.enter_section((!empty).then_some(usize::from(name == "CellData")), &given),
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
            spacing: DVec3::ONE,
            direction: DMat3::IDENTITY,
            directed: false,
            big_endian: false,
            wide: false,
            packing: Compression::None,
            pieces: Vec::new(),
            appended: None,
        };
        Self { path, document, section: None, is_image: false }
    }

    /// An error about the file.
    fn fail(&self, problem: String) -> Error {
        Error::file(self.path, problem)
    }

    /// `VTKFile`: type of data, byte order, compression.
    fn vtk_file(&mut self, given: &HashMap<String, String>) -> Result<()> {
        let kind = given.get("type").map_or("", String::as_str);
        if kind != "ImageData" {
            return Err(self.fail(format!("is a VTK file of type \"{kind}\"; image data (.vti) can be read as a volume")));
        }
        self.is_image = true;
        self.document.big_endian = given.get("byte_order").is_some_and(|b| b == "BigEndian");
        self.document.wide = given.get("header_type").is_some_and(|t| t == "UInt64");
        self.document.packing = match given.get("compressor").map_or("", String::as_str) {
            "" => Compression::None,
            "vtkZLibDataCompressor" => Compression::Zlib,
            "vtkLZ4DataCompressor" => Compression::Lz4,
            "vtkLZMADataCompressor" => Compression::Lzma,
            other => return Err(self.fail(format!("is compressed by {other}, which cannot be read; save it with zlib"))),
        };
        Ok(())
    }

    /// `ImageData`: extent and geometry of the whole image.
    fn image_data(&mut self, given: &HashMap<String, String>) -> Result<()> {
        self.document.whole = numbers(given.get("WholeExtent")).ok_or_else(|| self.fail("has no readable WholeExtent".into()))?;
        let vector = |name: &str, otherwise: DVec3| match given.get(name) {
            None => Ok(otherwise),
            some => numbers::<f64, 3>(some).map(DVec3::from_array).ok_or_else(|| self.fail(format!("has a {name} that is not three numbers"))),
        };
        let (origin, spacing) = (vector("Origin", DVec3::ZERO)?, vector("Spacing", DVec3::ONE)?);
        (self.document.origin, self.document.spacing) = (origin, spacing);
        if given.contains_key("Direction") {
            let rows: [f64; 9] = numbers(given.get("Direction")).ok_or_else(|| self.fail("has a Direction that is not nine numbers".into()))?;
            self.document.direction = DMat3::from_cols_array(&rows).transpose();
            self.document.directed = true;
        }
        Ok(())
    }

    /// `Piece`: its extent; by default that of the whole.
    fn piece(&mut self, given: &HashMap<String, String>) {
        let extent = numbers(given.get("Extent")).unwrap_or(self.document.whole);
        self.document.pieces.push(VtiPiece { extent, ..VtiPiece::default() });
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
        let Some(section) = self.section else { return Ok(()) };
        let place = match given.get("format").map_or("ascii", String::as_str) {
            "ascii" => ArrayLocation::Text(at),
            "binary" => ArrayLocation::Base64(at),
            "appended" => ArrayLocation::Appended(given.get("offset").and_then(|o| o.parse().ok()).unwrap_or(0)),
            other => return Err(self.fail(format!("has an array in the format \"{other}\", which cannot be read"))),
        };
        let type_name = given.get("type").cloned().unwrap_or_default();
        let components = given.get("NumberOfComponents").map_or(Some(1), |n| n.parse().ok()).filter(|n| (1..=1024).contains(n));
        let array = VtiArray {
            name: given.get("Name").cloned().unwrap_or_default(),
            scalar: ScalarType::named(&type_name),
            type_name,
            components: components.ok_or_else(|| self.fail("has an array with an impossible number of components".into()))?,
            place,
        };
        if let Some(piece) = self.document.pieces.last_mut() {
            if section == 0 { &mut piece.points } else { &mut piece.cells }.push(array);
        }
        Ok(())
    }
}

struct Values<'a> {
    path: &'a Path,
    document: &'a VtiDocument,
    scalar: ScalarType,
    file_bytes: u64,
    watch: &'a Watch<'a>,
}

impl Values<'_> {
    fn read(&self, array: &VtiArray, count: usize) -> Result<StoredValues> {
        let path = self.path;
        let start = |at: u64| -> Result<BufReader<File>> {
            let (mut reader, _) = buffered(path)?;
            reader.seek(SeekFrom::Start(at)).map_err(|e| read_error(path, e))?;
            Ok(reader)
        };
        match array.place {
            ArrayLocation::Text(at) => super::text::values(path, start(at)?, [0, count], self.scalar, self.watch),
            ArrayLocation::Base64(at) => self.unpacked(Base64::new(start(at)?), count),
            ArrayLocation::Appended(offset) => {
                let missing = || Error::file(path, "has no appended data for its values: it is truncated; copy or download it again");
                let (first, base64) = self.document.appended.ok_or_else(missing)?;
                let at = first.checked_add(offset).filter(|at| *at < self.file_bytes).ok_or_else(missing)?;
                if base64 { self.unpacked(Base64::new(start(at)?), count) } else { self.unpacked(start(at)?, count) }
            }
        }
    }

    /// The values after their length header.
    fn unpacked(&self, mut reader: impl Read, count: usize) -> Result<StoredValues> {
        let fail = |problem: String| Error::file(self.path, problem);
        let swap = self.document.big_endian != cfg!(target_endian = "big");
        let bytes = (count * self.scalar.bytes()) as u64;
        let length = |reader: &mut dyn Read| -> Result<u64> {
            let mut raw = [0u8; 8];
            let width = if self.document.wide { 8 } else { 4 };
            reader.read_exact(&mut raw[..width]).map_err(|e| read_error(self.path, e))?;
            if self.document.big_endian {
                raw[..width].reverse();
            }
            Ok(u64::from_le_bytes(raw))
        };
        if self.document.packing == Compression::None {
            let stated = length(&mut reader)?;
            // 32-bit lengths overflow in files of more than 4 GiB.
            if stated < bytes && (self.document.wide || bytes <= u64::from(u32::MAX)) {
                return Err(fail(format!("holds {stated} bytes of values, and {bytes} are needed")));
            }
            return ValueReader { path: self.path, reader, swap, count, watch: self.watch }.read_as(self.scalar);
        }
        let [blocks, size, last] = [length(&mut reader)?, length(&mut reader)?, length(&mut reader)?];
        let whole = blocks
            .checked_mul(size)
            .filter(|_| size <= MAX_BLOCK_BYTES && last <= size)
            .and_then(|n| if last > 0 { Some(n.checked_sub(size)? + last) } else { Some(n) });
        if whole.is_none_or(|n| n < bytes) || blocks > self.file_bytes {
            return Err(fail(format!("has {blocks} blocks of {size} bytes for {bytes} bytes of values; it is damaged")));
        }
        let mut packed = Vec::new();
        for _ in 0..blocks {
            packed.push(length(&mut reader)?);
        }
        if packed.iter().any(|n| *n > self.file_bytes) {
            return Err(fail("has a block that is larger than the file; it is damaged".into()));
        }
        let blocks =
            Blocks { reader, packed: packed.into_iter(), size: size as usize, packing: self.document.packing, ready: Vec::new(), at: [0, 0] };
        ValueReader { path: self.path, reader: blocks, swap, count, watch: self.watch }.read_as(self.scalar)
    }
}

/// Blocks, unpacked many at a time.
struct Blocks<R> {
    reader: R,
    packed: std::vec::IntoIter<u64>,
    size: usize,
    packing: Compression,
    ready: Vec<Vec<u8>>,
    /// The next block, and the next byte in it.
    at: [usize; 2],
}

impl<R: Read> Read for Blocks<R> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        while self.ready.get(self.at[0]).is_none_or(|b| b.len() <= self.at[1]) {
            if self.at[0] + 1 < self.ready.len() {
                self.at = [self.at[0] + 1, 0];
                continue;
            }
            let at_once = ((1 << 24) / self.size.max(1)).clamp(1, BLOCKS_AT_ONCE);
            let mut packed = Vec::new();
            for length in self.packed.by_ref().take(at_once) {
                let mut block = Vec::new();
                if (&mut self.reader).take(length).read_to_end(&mut block)? as u64 != length {
                    return Err(std::io::ErrorKind::UnexpectedEof.into());
                }
                packed.push(block);
            }
            if packed.is_empty() {
                return Ok(0);
            }
            let (size, packing) = (self.size, self.packing);
            self.ready = packed.into_par_iter().map(|block| unpack(&block, size, packing)).collect::<std::io::Result<_>>()?;
            self.at = [0, 0];
        }
        let block = &self.ready[self.at[0]][self.at[1]..];
        let n = block.len().min(bytes.len());
        bytes[..n].copy_from_slice(&block[..n]);
        self.at[1] += n;
        Ok(n)
    }
}

fn unpack(block: &[u8], size: usize, packing: Compression) -> std::io::Result<Vec<u8>> {
    let mut out = Vec::new();
    match packing {
        Compression::None => out.extend_from_slice(block),
        Compression::Zlib => {
            ZlibDecoder::new(block).take(size as u64).read_to_end(&mut out)?;
        }
        Compression::Lz4 => {
            // LZ4's compression ratio is at most 255.
            out.resize(size.min(block.len().saturating_mul(255)), 0);
            let n =
                lz4_flex::block::decompress_into(block, &mut out).map_err(|e| std::io::Error::new(std::io::ErrorKind::InvalidData, e.to_string()))?;
            out.truncate(n);
        }
        Compression::Lzma => {
            lzma_rust2::XzReader::new(block, false).take(size as u64).read_to_end(&mut out)?;
        }
    }
    Ok(out)
}

/// Decodes base64, parts of which may have been encoded and padded separately. Ends at the first
/// character that is not base64.
struct Base64 {
    reader: BufReader<File>,
    ready: Vec<u8>,
    at: usize,
}

impl Base64 {
    fn new(reader: BufReader<File>) -> Self {
        Self { reader, ready: Vec::new(), at: 0 }
    }

    fn more(&mut self) -> std::io::Result<()> {
        const GROUPS: usize = 1 << 16;
        let mut text = Vec::with_capacity(GROUPS);
        'fill: while text.len() < GROUPS {
            let bytes = self.reader.fill_buf()?;
            if bytes.is_empty() {
                break;
            }
            let mut used = 0;
            let mut end = false;
            for &b in bytes {
                match b {
                    b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'+' | b'/' | b'=' => text.push(b),
                    b if b.is_ascii_whitespace() => {}
                    _ => {
                        end = true;
                        break;
                    }
                }
                used += 1;
                // A padded group ends the part that can be decoded at once.
                let padded = b == b'=' && text.len().is_multiple_of(4);
                if padded || text.len() == GROUPS {
                    end = padded;
                    break;
                }
            }
            self.reader.consume(used);
            if end {
                break 'fill;
            }
        }
        text.truncate(text.len() / 4 * 4);
        self.ready = STANDARD.decode(&text).map_err(|e| std::io::Error::new(std::io::ErrorKind::InvalidData, e.to_string()))?;
        self.at = 0;
        Ok(())
    }
}

impl Read for Base64 {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        if self.at == self.ready.len() {
            self.more()?;
        }
        let n = (self.ready.len() - self.at).min(bytes.len());
        bytes[..n].copy_from_slice(&self.ready[self.at..self.at + n]);
        self.at += n;
        Ok(n)
    }
}
