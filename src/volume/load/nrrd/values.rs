//! The values of an NRRD file: raw, gzip, bzip2, text or hex, in one data file or many.

use super::super::super::StoredValues;
use super::super::ScalarType;
use super::super::source::{
    BZIP2_LIMIT, ConcatenatedFiles, DEFLATE_LIMIT, OpenPiece, ValueReader, buffered, check_end, check_held,
    open_file, read_error, skip,
};
use super::super::text;
use super::header::required;
use crate::{Error, Result, Watch};
use bzip2::read::MultiBzDecoder;
use flate2::read::MultiGzDecoder;
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// The encoding of the values.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Raw,
    Gzip,
    Bzip2,
    Text,
    Hex,
}

/// How to read the values.
pub(super) struct Data<'a> {
    path: &'a Path,
    scalar: ScalarType,
    swap: bool,
    encoding: Encoding,
    line_skip: u64,
    byte_skip: i64,
    /// Number of values of all times.
    whole: usize,
    watch: &'a Watch<'a>,
}

impl<'a> Data<'a> {
    /// How `whole` values are stored, from the header.
    pub fn new(
        path: &'a Path,
        fields: &HashMap<String, String>,
        scalar: ScalarType,
        whole: usize,
        watch: &'a Watch<'a>,
    ) -> Result<Self> {
        let fail = |problem: String| Error::file(path, problem);
        let get = |name: &str| fields.get(name).map(String::as_str);
        let encoding = match required(path, fields, "encoding")?
            .trim()
            .to_ascii_lowercase()
            .as_str()
        {
            "raw" => Encoding::Raw,
            "gzip" | "gz" => Encoding::Gzip,
            "bzip2" | "bz2" => Encoding::Bzip2,
            "ascii" | "text" | "txt" => Encoding::Text,
            "hex" => Encoding::Hex,
            other => {
                return Err(fail(format!(
                    "is encoded as \"{other}\", which cannot be read; save it as raw or gzip"
                )));
            }
        };
        let swap = scalar.bytes() > 1
            && match required(path, fields, "endian").map(str::trim) {
                Ok("little") => cfg!(target_endian = "big"),
                Ok("big") => cfg!(target_endian = "little"),
                Ok(other) => {
                    return Err(fail(format!(
                        "has the byte order \"{other}\"; it must be little or big"
                    )));
                }
                Err(e) if encoding != Encoding::Text => return Err(e),
                Err(_) => false,
            };
        let number = |names: [&str; 2]| {
            let text = get(names[0]).or(get(names[1]));
            text.map_or(Ok(0i64), |t| t.trim().parse())
                .map_err(|_| fail(format!("has a {} that is not a number", names[0])))
        };
        let (line_skip, byte_skip) = (
            number(["line skip", "lineskip"])?,
            number(["byte skip", "byteskip"])?,
        );
        if line_skip < 0 || byte_skip < -1 {
            return Err(fail(
                "skips a negative number of lines or bytes; its header is damaged".into(),
            ));
        }
        Ok(Self {
            path,
            scalar,
            swap,
            encoding,
            line_skip: line_skip as u64,
            byte_skip,
            whole,
            watch,
        })
    }

    /// Reads `[ahead, count]`: skips values and reads values, from the reader's position.
    pub fn read(
        &self,
        path: &Path,
        mut reader: BufReader<File>,
        file_bytes: u64,
        [ahead, count]: [usize; 2],
        more: bool,
    ) -> Result<StoredValues> {
        let size = self.scalar.bytes() as u64;
        let (before, bytes) = (ahead as u64 * size, count as u64 * size);
        skip_lines(path, &mut reader, self.line_skip)?;
        let byte_skip = self.byte_skip.max(0) as u64;
        match self.encoding {
            Encoding::Raw => {
                check_held(path, before.saturating_add(bytes), file_bytes)?;
                if self.byte_skip < 0 {
                    // Located at the file's end.
                    let all = self.whole as u64 * size;
                    check_held(path, all, file_bytes)?;
                    reader
                        .seek(SeekFrom::End(-(all as i64)))
                        .map_err(|e| read_error(path, e))?;
                }
                skip(path, &mut reader, byte_skip.saturating_add(before))?;
                self.source(path, reader, count).read_as(self.scalar)
            }
            Encoding::Gzip | Encoding::Bzip2 => {
                let limit = if self.encoding == Encoding::Gzip {
                    DEFLATE_LIMIT
                } else {
                    BZIP2_LIMIT
                };
                check_held(
                    path,
                    before.saturating_add(bytes),
                    file_bytes.saturating_mul(limit),
                )?;
                let mut decoder: Box<dyn Read + Send> = if self.encoding == Encoding::Gzip {
                    Box::new(MultiGzDecoder::new(reader))
                } else {
                    Box::new(MultiBzDecoder::new(reader))
                };
                skip(path, &mut decoder, byte_skip.saturating_add(before))?;
                let mut source = self.source(path, decoder, count);
                let voxels = source.read_as(self.scalar)?;
                if !more {
                    check_end(path, source.reader)?;
                }
                Ok(voxels)
            }
            Encoding::Text => {
                skip(path, &mut reader, byte_skip)?;
                // A value and its separator take at least two bytes.
                check_held(
                    path,
                    (ahead as u64 + count as u64).saturating_mul(2).saturating_sub(1),
                    file_bytes,
                )?;
                text::values(path, reader, [ahead, count], self.scalar, self.watch)
            }
            Encoding::Hex => {
                skip(path, &mut reader, byte_skip)?;
                check_held(path, before.saturating_add(bytes).saturating_mul(2), file_bytes)?;
                let mut hex = Hex { reader };
                skip(path, &mut hex, before)?;
                self.source(path, hex, count).read_as(self.scalar)
            }
        }
    }

    /// Reads values divided evenly among many files.
    pub fn read_pieces(
        &self,
        files: Vec<PathBuf>,
        total: usize,
        [ahead, count]: [usize; 2],
    ) -> Result<StoredValues> {
        let fail = |problem: String| Error::file(self.path, problem);
        if !total.is_multiple_of(files.len()) {
            return Err(fail(format!(
                "names {} data files, which cannot hold equal parts of its {total} values",
                files.len()
            )));
        }
        if self.line_skip > 0 || self.byte_skip > 0 || matches!(self.encoding, Encoding::Text | Encoding::Hex)
        {
            return Err(fail("has several data files that are not raw, gzip or bzip2 from their first byte on; join them into one".into()));
        }
        let size = self.scalar.bytes() as u64;
        let piece = (total / files.len()) as u64 * size;
        let mut most = 0u64;
        for file in &files {
            most = most.saturating_add(open_file(file)?.1);
        }
        let (open, limit): (OpenPiece, u64) = match (self.encoding, self.byte_skip) {
            (Encoding::Gzip, _) => (
                |p, _| Ok(Box::new(MultiGzDecoder::new(buffered(p)?.0))),
                DEFLATE_LIMIT,
            ),
            (Encoding::Bzip2, _) => (
                |p, _| Ok(Box::new(MultiBzDecoder::new(buffered(p)?.0))),
                BZIP2_LIMIT,
            ),
            (_, -1) => (last_bytes, 1),
            _ => (|p, _| Ok(Box::new(buffered(p)?.0)), 1),
        };
        check_held(self.path, total as u64 * size, most.saturating_mul(limit))?;
        let mut chain = ConcatenatedFiles::new(files, piece, open);
        skip(self.path, &mut chain, ahead as u64 * size)?;
        self.source(self.path, chain, count).read_as(self.scalar)
    }

    fn source<'b, R: Read>(&'b self, path: &'b Path, reader: R, count: usize) -> ValueReader<'b, R> {
        ValueReader {
            path,
            reader,
            swap: self.swap,
            count,
            watch: self.watch,
        }
    }
}

/// The last `bytes` of a file.
pub(in crate::volume::load) fn last_bytes(path: &Path, bytes: u64) -> Result<Box<dyn Read + Send>> {
    let (mut reader, length) = buffered(path)?;
    check_held(path, bytes, length)?;
    reader
        .seek(SeekFrom::Start(length - bytes))
        .map_err(|e| read_error(path, e))?;
    Ok(Box::new(reader))
}

/// Skips whole lines.
fn skip_lines(path: &Path, reader: &mut impl BufRead, lines: u64) -> Result<()> {
    for _ in 0..lines {
        if reader.skip_until(b'\n').map_err(|e| read_error(path, e))? == 0 {
            return Err(read_error(path, std::io::ErrorKind::UnexpectedEof.into()));
        }
    }
    Ok(())
}

/// Bytes written as two hexadecimal digits each; white space is ignored.
struct Hex<R> {
    reader: BufReader<R>,
}

impl<R: Read> Read for Hex<R> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let mut digit = || -> std::io::Result<Option<u8>> {
            loop {
                let Some(&byte) = self.reader.fill_buf()?.first() else {
                    return Ok(None);
                };
                self.reader.consume(1);
                if !byte.is_ascii_whitespace() {
                    let digit = char::from(byte).to_digit(16).ok_or_else(|| {
                        std::io::Error::new(std::io::ErrorKind::InvalidData, "no hex digit")
                    })?;
                    return Ok(Some(digit as u8));
                }
            }
        };
        let mut done = 0;
        while done < bytes.len() {
            let Some(high) = digit()? else { break };
            let low = digit()?.ok_or(std::io::ErrorKind::UnexpectedEof)?;
            bytes[done] = high << 4 | low;
            done += 1;
        }
        Ok(done)
    }
}
