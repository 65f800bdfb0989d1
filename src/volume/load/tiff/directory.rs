//! The directories of a TIFF or BigTIFF: the tags of each page, and their values.
//!
//! Source: TIFF 6.0 section 2; the BigTIFF design of libtiff (offsets of 8 bytes, magic number 43).

use super::super::source::{GZIPPED, first_bytes, open_file, read_error};
use crate::{Error, Result};
use std::collections::HashSet;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Numbers of tags: TIFF 6.0 appendix A and, from 32768 on, private ones.
pub(super) mod tag {
    pub const NEW_SUBFILE_TYPE: u16 = 254;
    pub const SUBFILE_TYPE: u16 = 255;
    pub const WIDTH: u16 = 256;
    pub const HEIGHT: u16 = 257;
    pub const BITS: u16 = 258;
    pub const COMPRESSION: u16 = 259;
    pub const PHOTOMETRIC: u16 = 262;
    pub const FILL_ORDER: u16 = 266;
    pub const DESCRIPTION: u16 = 270;
    pub const STRIP_OFFSETS: u16 = 273;
    pub const ORIENTATION: u16 = 274;
    pub const SAMPLES: u16 = 277;
    pub const ROWS_PER_STRIP: u16 = 278;
    pub const STRIP_BYTES: u16 = 279;
    pub const X_RESOLUTION: u16 = 282;
    pub const Y_RESOLUTION: u16 = 283;
    pub const PLANAR: u16 = 284;
    pub const FAX_OPTIONS: u16 = 292;
    pub const RESOLUTION_UNIT: u16 = 296;
    pub const PREDICTOR: u16 = 317;
    pub const COLOR_MAP: u16 = 320;
    pub const TILE_WIDTH: u16 = 322;
    pub const TILE_HEIGHT: u16 = 323;
    pub const TILE_OFFSETS: u16 = 324;
    pub const TILE_BYTES: u16 = 325;
    pub const INK_SET: u16 = 332;
    pub const EXTRA_SAMPLES: u16 = 338;
    pub const SAMPLE_FORMAT: u16 = 339;
    pub const JPEG_TABLES: u16 = 347;
    /// Slices of a page, and of a tile.
    pub const IMAGE_DEPTH: u16 = 32997;
    pub const TILE_DEPTH: u16 = 32998;
    pub const YCBCR_COEFFICIENTS: u16 = 529;
    pub const YCBCR_SUBSAMPLING: u16 = 530;
    pub const REFERENCE_BLACK_WHITE: u16 = 532;
    /// MetaMorph's UIC2Tag: one entry for each plane of a stack.
    pub const STK_PLANES: u16 = 33629;
    /// Zeiss' CZ_LSMINFO.
    pub const LSM: u16 = 34412;

    /// The tags that are used; others are not retained.
    pub const USED: [u16; 36] = [
        NEW_SUBFILE_TYPE,
        SUBFILE_TYPE,
        WIDTH,
        HEIGHT,
        BITS,
        COMPRESSION,
        PHOTOMETRIC,
        FILL_ORDER,
        DESCRIPTION,
        STRIP_OFFSETS,
        ORIENTATION,
        SAMPLES,
        ROWS_PER_STRIP,
        STRIP_BYTES,
        X_RESOLUTION,
        Y_RESOLUTION,
        PLANAR,
        FAX_OPTIONS,
        RESOLUTION_UNIT,
        PREDICTOR,
        COLOR_MAP,
        TILE_WIDTH,
        TILE_HEIGHT,
        TILE_OFFSETS,
        TILE_BYTES,
        INK_SET,
        EXTRA_SAMPLES,
        SAMPLE_FORMAT,
        JPEG_TABLES,
        IMAGE_DEPTH,
        TILE_DEPTH,
        YCBCR_COEFFICIENTS,
        YCBCR_SUBSAMPLING,
        REFERENCE_BLACK_WHITE,
        STK_PLANES,
        LSM,
    ];
}

/// Maximum number of pages in a file.
pub(super) const MAX_PAGES: usize = 1 << 20;

/// One tag of a directory.
struct Entry {
    tag: u16,
    kind: u16,
    count: u64,
    /// Its value, or the offset of its value.
    field: [u8; 8],
}

/// The tags of one page.
pub(super) struct Directory {
    entries: Vec<Entry>,
}

impl Directory {
    fn entry(&self, tag: u16) -> Option<&Entry> {
        self.entries.iter().find(|e| e.tag == tag)
    }

    /// Whether it has a tag.
    pub fn has(&self, tag: u16) -> bool {
        self.entry(tag).is_some()
    }

    /// Number of values of a tag.
    pub fn count(&self, tag: u16) -> u64 {
        self.entry(tag).map_or(0, |e| e.count)
    }
}

/// Bytes of one value of a type; 0 for an unknown type.
fn bytes_of(kind: u16) -> u64 {
    match kind {
        1 | 2 | 6 | 7 => 1,
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16 | 17 | 18 => 8,
        _ => 0,
    }
}

/// An open file.
pub(super) struct TiffReader {
    pub path: PathBuf,
    reader: BufReader<File>,
    /// Its length.
    pub bytes: u64,
    pub big_endian: bool,
    /// Whether it is a BigTIFF.
    wide: bool,
}

impl TiffReader {
    /// Whether a file starts as a TIFF or BigTIFF does.
    pub fn is_tiff(path: &Path) -> Result<bool> {
        let start = first_bytes(path, 4)?;
        Ok([b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"]
            .iter()
            .any(|magic| start == **magic))
    }

    /// Opens a file and reads its directories.
    ///
    /// # Errors
    /// A file that is no TIFF; a directory that goes beyond its end.
    pub fn open(path: &Path) -> Result<(Self, Vec<Directory>)> {
        let (file, bytes) = open_file(path)?;
        let mut reader = BufReader::new(file);
        let mut start = [0u8; 8];
        reader.read_exact(&mut start).map_err(|e| read_error(path, e))?;
        let big_endian = match &start[..2] {
            b"II" => false,
            b"MM" => true,
            [0x1f, 0x8b] => return Err(Error::file(path, GZIPPED)),
            _ => return Err(Error::file(path, "is not a TIFF; copy or export it again")),
        };
        let mut file = Self {
            path: path.to_owned(),
            reader,
            bytes,
            big_endian,
            wide: false,
        };
        let first = match file.number_in(&start[2..4]) {
            42 => file.number_in(&start[4..8]),
            43 => {
                file.wide = true;
                let offset = file.piece(8, 8)?;
                file.number_in(&offset)
            }
            other => {
                return Err(Error::file(
                    path,
                    format!("has the version {other}, but a TIFF has 42 and a BigTIFF 43; it is damaged"),
                ));
            }
        };
        let directories = file.directories(first)?;
        Ok((file, directories))
    }

    /// Follows the chain of directories.
    fn directories(&mut self, first: u64) -> Result<Vec<Directory>> {
        let (mut found, mut seen, mut next, mut used) = (Vec::new(), HashSet::new(), first, 0u64);
        while next != 0 && found.len() < MAX_PAGES {
            if !seen.insert(next) {
                return Err(self.error("has directories that form a loop; it is damaged"));
            }
            let (directory, following, bytes) = self.directory(next)?;
            used = used.saturating_add(bytes);
            if used > self.bytes {
                return Err(self.error("has directories that overlap; it is damaged"));
            }
            found.push(directory);
            next = following;
        }
        if found.is_empty() {
            return Err(self.error("holds no page; it was not written to its end"));
        }
        Ok(found)
    }

    /// The directory at an offset, the offset of the next one, and its length in bytes.
    fn directory(&mut self, at: u64) -> Result<(Directory, u64, u64)> {
        let (count_bytes, entry_bytes, offset_bytes) = if self.wide { (8, 20, 8) } else { (2, 12, 4) };
        let count = self.piece(at, count_bytes)?;
        let count = self.number_in(&count);
        let length = count
            .checked_mul(entry_bytes)
            .and_then(|n| n.checked_add(offset_bytes))
            .filter(|n| *n <= self.bytes)
            .ok_or_else(|| self.error("has a directory longer than the file; it is truncated or damaged"))?;
        let all = self.piece(at.saturating_add(count_bytes), length)?;
        let (entries, next) = all.split_at((length - offset_bytes) as usize);
        let entries = entries
            .chunks_exact(entry_bytes as usize)
            .filter_map(|bytes| {
                let tag = self.number_in(&bytes[..2]) as u16;
                let (count, value) = bytes[4..].split_at(if self.wide { 8 } else { 4 });
                let mut field = [0u8; 8];
                field[..value.len()].copy_from_slice(value);
                tag::USED.contains(&tag).then(|| Entry {
                    tag,
                    kind: self.number_in(&bytes[2..4]) as u16,
                    count: self.number_in(count),
                    field,
                })
            })
            .collect();
        Ok((Directory { entries }, self.number_in(next), length + count_bytes))
    }

    /// An error about this file.
    pub fn error(&self, problem: impl Into<String>) -> Error {
        Error::file(&self.path, problem)
    }

    /// An unsigned number of up to 8 bytes.
    pub fn number_in(&self, bytes: &[u8]) -> u64 {
        let add = |n: u64, b: &u8| n << 8 | u64::from(*b);
        if self.big_endian {
            bytes.iter().fold(0, add)
        } else {
            bytes.iter().rev().fold(0, add)
        }
    }

    /// Bytes at an offset.
    ///
    /// # Errors
    /// They go beyond the end of the file.
    pub fn piece(&mut self, at: u64, length: u64) -> Result<Vec<u8>> {
        if at.checked_add(length).is_none_or(|end| end > self.bytes) {
            return Err(read_error(&self.path, ErrorKind::UnexpectedEof.into()));
        }
        let mut bytes = vec![0u8; length as usize];
        self.reader
            .seek(SeekFrom::Start(at))
            .and_then(|_| self.reader.read_exact(&mut bytes))
            .map_err(|e| read_error(&self.path, e))?;
        Ok(bytes)
    }

    /// The bytes of a tag's values, and their type; none without the tag.
    fn values(&mut self, directory: &Directory, tag: u16) -> Result<Option<(Vec<u8>, u16)>> {
        let Some(entry) = directory.entry(tag) else {
            return Ok(None);
        };
        let length = entry
            .count
            .checked_mul(bytes_of(entry.kind))
            .filter(|n| *n <= self.bytes)
            .ok_or_else(|| {
                self.error(format!(
                    "has {} values of tag {tag}, more than the file can hold; it is damaged",
                    entry.count
                ))
            })?;
        let inline = if self.wide { 8 } else { 4 };
        let bytes = if length <= inline {
            entry.field[..length as usize].to_vec()
        } else {
            let at = self.number_in(&entry.field[..inline as usize]);
            self.piece(at, length)?
        };
        Ok(Some((bytes, entry.kind)))
    }

    /// The values of a tag of integers; none without the tag.
    pub fn integers(&mut self, directory: &Directory, tag: u16) -> Result<Option<Vec<u64>>> {
        let Some((bytes, kind)) = self.values(directory, tag)? else {
            return Ok(None);
        };
        match bytes_of(kind) {
            size @ 1.. if !matches!(kind, 5 | 10 | 11 | 12) => Ok(Some(
                bytes
                    .chunks_exact(size as usize)
                    .map(|b| self.number_in(b))
                    .collect(),
            )),
            _ => Err(self.error(format!("has a tag {tag} that is not an integer; it is damaged"))),
        }
    }

    /// The first value of a tag of integers.
    pub fn integer(&mut self, directory: &Directory, tag: u16) -> Result<Option<u64>> {
        Ok(self
            .integers(directory, tag)?
            .and_then(|values| values.first().copied()))
    }

    /// The values of a tag of numbers.
    pub fn reals(&mut self, directory: &Directory, tag: u16) -> Result<Option<Vec<f64>>> {
        let Some((bytes, kind)) = self.values(directory, tag)? else {
            return Ok(None);
        };
        let size = bytes_of(kind).max(1) as usize;
        let real = |b: &[u8]| match kind {
            5 => self.number_in(&b[..4]) as f64 / self.number_in(&b[4..]) as f64,
            11 => f64::from(f32::from_bits(self.number_in(b) as u32)),
            12 => f64::from_bits(self.number_in(b)),
            _ => self.number_in(b) as f64,
        };
        Ok(Some(bytes.chunks_exact(size).map(real).collect()))
    }

    /// The bytes of a tag.
    pub fn bytes_of_tag(&mut self, directory: &Directory, tag: u16) -> Result<Option<Vec<u8>>> {
        Ok(self.values(directory, tag)?.map(|(bytes, _)| bytes))
    }

    /// The text of a tag, without its end; empty without the tag.
    pub fn text(&mut self, directory: &Directory, tag: u16) -> Result<String> {
        let bytes = self.bytes_of_tag(directory, tag)?.unwrap_or_default();
        let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
        // ImageJ writes Latin-1.
        Ok(match std::str::from_utf8(&bytes[..end]) {
            Ok(text) => text.to_owned(),
            Err(_) => bytes[..end].iter().map(|b| char::from(*b)).collect(),
        })
    }
}
