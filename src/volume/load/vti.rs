//! VTK image data in XML, `.vti`: values inline or appended, as text, base64 or raw, plain or in
//! compressed blocks; one piece or several.
//!
//! *Geometry*: `Origin`, `Spacing` and `Direction` (columns are the axes) in LPS, as left by
//! programs that read medical images into VTK. Source: VTK file formats (VTK User's Guide;
//! vtkXMLDataParser).

mod decoding;
mod document;

use super::super::StoredValues;
use super::ReadOptions;
use super::ScalarType;
use super::image::{Image, Meaning};
use super::source::{
    DEFLATE_LIMIT, ValueReader, buffered, check_held, count, read_error, usable, with_scalar, zeroed,
};
use crate::{Error, Result, Watch};
use decoding::{Base64, Blocks, Compression};
use document::{ArrayLocation, VtiArray, VtiDocument, VtiPiece, document};
use glam::{DAffine3, DMat3, DVec3};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Maximum size of a block, bytes.
const MAX_BLOCK_BYTES: u64 = 1 << 28;

/// Reads an image.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    choice.time_of(1)?;
    let (reader, file_bytes) = buffered(path)?;
    let document = document(path, reader)?;
    let first = document
        .pieces
        .first()
        .ok_or_else(|| fail("holds no piece of an image".into()))?;
    let (on_cells, wanted) = chosen(first).ok_or_else(|| fail("holds no array of values".into()))?;
    let size = grid_size(&document.whole, on_cells)
        .ok_or_else(|| fail(format!("has the empty extent {:?}", document.whole)))?;
    let scalar = wanted.scalar.ok_or_else(|| {
        fail(format!(
            "has the type {}, which is not supported",
            wanted.type_name
        ))
    })?;
    let components = wanted.components;
    let total = count(path, &[size[0], size[1], size[2], components], scalar)?;
    let most = if document.packing == Compression::None {
        file_bytes
    } else {
        file_bytes.saturating_mul(7 * DEFLATE_LIMIT)
    };
    if !matches!(wanted.place, ArrayLocation::Text(_)) {
        check_held(path, (total * scalar.bytes()) as u64, most)?;
    } else {
        check_held(
            path,
            (total as u64).saturating_mul(2).saturating_sub(1),
            file_bytes,
        )?;
    }
    let values = Values {
        path,
        document: &document,
        scalar,
        file_bytes,
        watch,
    };
    let voxels = if let [piece] = &document.pieces[..]
        && piece.extent == document.whole
    {
        values.read(wanted, total)?
    } else {
        values.read_pieces(wanted, on_cells, size)?
    };
    let world_from_voxel = world_from_voxel(&document, on_cells);
    if !usable(&world_from_voxel) {
        return Err(fail("has singular axes; its geometry cannot be used".into()));
    }
    let mut image = Image::new("VTK XML image data", voxels, size, world_from_voxel);
    (image.components, image.frame) = (components, Some(DMat3::IDENTITY));
    if first.active[1].as_deref() == Some(wanted.name.as_str()) && components == 3 {
        image.meaning = Meaning::Vectors;
    }
    if !document.directed {
        image.warnings.push(
            "does not state its patient orientation; left, posterior, superior axes are assumed".into(),
        );
    }
    image
        .warnings
        .extend(choice.spacing_notice([document.spacing.is_some(); 3]));
    let others: Vec<&str> = first
        .points
        .iter()
        .chain(&first.cells)
        .map(|a| a.name.as_str())
        .filter(|n| *n != wanted.name)
        .collect();
    if !others.is_empty() {
        image.warnings.push(format!(
            "also holds the arrays {}; \"{}\" is used",
            others.join(", "),
            wanted.name
        ));
    }
    Ok(image)
}

/// The text before the next tag.
struct UpToTag(BufReader<File>);

impl Read for UpToTag {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let text = self.fill_buf()?;
        let count = text.len().min(bytes.len());
        bytes[..count].copy_from_slice(&text[..count]);
        self.consume(count);
        Ok(count)
    }
}

impl BufRead for UpToTag {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        let bytes = self.0.fill_buf()?;
        let end = bytes.iter().position(|b| *b == b'<').unwrap_or(bytes.len());
        Ok(&bytes[..end])
    }
    fn consume(&mut self, amount: usize) {
        self.0.consume(amount);
    }
}

/// The array to show: the active scalars, else the active vectors, else the first; point data
/// before cell data.
fn chosen(piece: &VtiPiece) -> Option<(bool, &VtiArray)> {
    for (cells, arrays) in [(false, &piece.points), (true, &piece.cells)] {
        let active = piece
            .active
            .iter()
            .flatten()
            .find_map(|name| arrays.iter().find(|a| a.name == *name));
        if let Some(array) = active.or(arrays.first()) {
            return Some((cells, array));
        }
    }
    None
}

/// Number of values along the axes of an extent; none if it is empty or cannot be addressed.
fn grid_size(extent: &[i64; 6], on_cells: bool) -> Option<[usize; 3]> {
    let mut size = [0usize; 3];
    for a in 0..3 {
        let n = extent[2 * a + 1]
            .checked_sub(extent[2 * a])?
            .checked_add(i64::from(!on_cells))?;
        size[a] = usize::try_from(n).ok().filter(|n| *n > 0)?;
    }
    Some(size)
}

/// World from voxel; values of cells lie at the cells' centres.
fn world_from_voxel(document: &VtiDocument, on_cells: bool) -> DAffine3 {
    let corner = DVec3::from_array(std::array::from_fn(|a| {
        document.whole[2 * a] as f64 + if on_cells { 0.5 } else { 0.0 }
    }));
    let linear = document.direction * DMat3::from_diagonal(document.spacing.unwrap_or(DVec3::ONE));
    DAffine3 {
        matrix3: linear,
        translation: document.origin + linear * corner,
    }
}

/// Index in the whole grid of the first voxel of a piece of size `part`; none if the piece is not
/// inside the grid.
fn first_voxel(
    extent: &[i64; 6],
    whole: &[i64; 6],
    part: [usize; 3],
    size: [usize; 3],
) -> Option<[usize; 3]> {
    (0..3)
        .map(|a| {
            usize::try_from(extent[2 * a].checked_sub(whole[2 * a])?)
                .ok()
                .filter(|s| s.checked_add(part[a]).is_some_and(|end| end <= size[a]))
        })
        .collect::<Option<Vec<_>>>()
        .and_then(|v| v.try_into().ok())
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

/// How to read an array's values.
struct Values<'a> {
    path: &'a Path,
    document: &'a VtiDocument,
    scalar: ScalarType,
    file_bytes: u64,
    watch: &'a Watch<'a>,
}

impl Values<'_> {
    /// Reads `count` values of an array.
    fn read(&self, array: &VtiArray, count: usize) -> Result<StoredValues> {
        let path = self.path;
        let start = |at: u64| -> Result<BufReader<File>> {
            let (mut reader, _) = buffered(path)?;
            reader
                .seek(SeekFrom::Start(at))
                .map_err(|e| read_error(path, e))?;
            Ok(reader)
        };
        match array.place {
            ArrayLocation::Text(at) => {
                // The text ends with the tag that follows it.
                super::text::values(path, UpToTag(start(at)?), [0, count], self.scalar, self.watch)
            }
            ArrayLocation::Base64(at) => self.unpacked(Base64::new(start(at)?), count),
            ArrayLocation::Appended(offset) => {
                let missing = || {
                    Error::file(
                        path,
                        "has no appended data for its values: it is truncated; copy or download it again",
                    )
                };
                let (first, base64) = self.document.appended.ok_or_else(missing)?;
                let at = first
                    .checked_add(offset)
                    .filter(|at| *at < self.file_bytes)
                    .ok_or_else(missing)?;
                if base64 {
                    self.unpacked(Base64::new(start(at)?), count)
                } else {
                    self.unpacked(start(at)?, count)
                }
            }
        }
    }

    /// Reads the array of every piece and combines them into a grid of `size`.
    fn read_pieces(&self, wanted: &VtiArray, on_cells: bool, size: [usize; 3]) -> Result<StoredValues> {
        let fail = |problem: String| Error::file(self.path, problem);
        let (whole, components) = (&self.document.whole, wanted.components);
        let total = size.iter().product::<usize>() * components;
        let mut parts = Vec::new();
        let mut covered = 0usize;
        for piece in &self.document.pieces {
            let part = grid_size(&piece.extent, on_cells)
                .ok_or_else(|| fail(format!("has a piece with the empty extent {:?}", piece.extent)))?;
            let start = first_voxel(&piece.extent, whole, part, size)
                .ok_or_else(|| fail("has a piece outside of the image's extent".into()))?;
            let array = if on_cells { &piece.cells } else { &piece.points }
                .iter()
                .find(|a| a.name == wanted.name);
            let array = array.filter(|a| a.scalar == Some(self.scalar) && a.components == components);
            let array =
                array.ok_or_else(|| fail(format!("has a piece without the array \"{}\"", wanted.name)))?;
            let n = count(self.path, &[part[0], part[1], part[2], components], self.scalar)?;
            covered = covered.saturating_add(n);
            // Pieces share their outermost points; more overlap is not a division of one image.
            if covered > total.saturating_mul(8) {
                return Err(fail("has overlapping pieces".into()));
            }
            parts.push((start, part, self.read(array, n)?));
        }
        joined(self.path, size, components, self.scalar, &parts)
    }

    /// The values after their length header.
    fn unpacked(&self, mut reader: impl Read, count: usize) -> Result<StoredValues> {
        let fail = |problem: String| Error::file(self.path, problem);
        let swap = self.document.big_endian != cfg!(target_endian = "big");
        let bytes = (count * self.scalar.bytes()) as u64;
        let length = |reader: &mut dyn Read| -> Result<u64> {
            let mut raw = [0u8; 8];
            let width = if self.document.wide { 8 } else { 4 };
            reader
                .read_exact(&mut raw[..width])
                .map_err(|e| read_error(self.path, e))?;
            if self.document.big_endian {
                raw[..width].reverse();
            }
            Ok(u64::from_le_bytes(raw))
        };
        if self.document.packing == Compression::None {
            let stated = length(&mut reader)?;
            // 32-bit lengths overflow in files of more than 4 GiB.
            if stated < bytes && (self.document.wide || bytes <= u64::from(u32::MAX)) {
                return Err(fail(format!(
                    "holds {stated} bytes of values, and {bytes} are needed"
                )));
            }
            return ValueReader {
                path: self.path,
                reader,
                swap,
                count,
                watch: self.watch,
            }
            .read_as(self.scalar);
        }
        let [blocks, size, last] = [length(&mut reader)?, length(&mut reader)?, length(&mut reader)?];
        let whole = blocks
            .checked_mul(size)
            .filter(|_| size <= MAX_BLOCK_BYTES && last <= size)
            .and_then(|n| {
                if last > 0 {
                    Some(n.checked_sub(size)? + last)
                } else {
                    Some(n)
                }
            });
        if whole.is_none_or(|n| n < bytes) || blocks > self.file_bytes {
            return Err(fail(format!(
                "has {blocks} blocks of {size} bytes for {bytes} bytes of values; it is damaged"
            )));
        }
        let mut packed = Vec::new();
        for _ in 0..blocks {
            packed.push(length(&mut reader)?);
        }
        if packed.iter().any(|n| *n > self.file_bytes) {
            return Err(fail(
                "has a block that is larger than the file; it is damaged".into(),
            ));
        }
        let blocks = Blocks::new(reader, packed, size as usize, self.document.packing);
        ValueReader {
            path: self.path,
            reader: blocks,
            swap,
            count,
            watch: self.watch,
        }
        .read_as(self.scalar)
    }
}
