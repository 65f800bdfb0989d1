//! The values of an NRRD file: raw, gzip, bzip2, text or hex, in one data file or many.
//!
//! Lines are skipped in the file as stored, then bytes: of the file, or of what a compressed stream
//! unpacks to. A byte skip of -1 means that the values are the last bytes, -N that N - 1 more
//! follow them (teem, `nrrdByteSkip` and its encodings).

use super::super::super::StoredValues;
use super::super::ScalarType;
use super::super::source::{
    BZIP2_LIMIT, DEFLATE_LIMIT, ValueReader, check_end, check_held, divided, read_error, skip,
};
use super::super::text;
use super::header::{Header, required};
use crate::{Error, Result, Watch};
use bzip2::read::MultiBzDecoder;
use flate2::read::MultiGzDecoder;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Bytes unpacked at once to find the length of a stream.
const COUNTED_AT_ONCE: u64 = 1 << 24;

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
    byte_skip: ByteSkip,
    watch: &'a Watch<'a>,
}

/// Bytes to skip: of the file, or of what a compressed stream unpacks to.
#[derive(Clone, Copy, PartialEq, Eq)]
enum ByteSkip {
    /// Before the values.
    Before(u64),
    /// The values end this far before the end.
    AfterValues(u64),
}

impl<'a> Data<'a> {
    /// How the values are stored, from the header.
    pub fn new(path: &'a Path, header: &Header, scalar: ScalarType, watch: &'a Watch<'a>) -> Result<Self> {
        let fail = |problem: String| Error::file(path, problem);
        let encoding = match required(path, header, "encoding")?.to_ascii_lowercase().as_str() {
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
        let needs_order = scalar.bytes() > 1 && encoding != Encoding::Text;
        let swap = needs_order
            && match required(path, header, "endian")?.to_ascii_lowercase().as_str() {
                "little" => cfg!(target_endian = "big"),
                "big" => cfg!(target_endian = "little"),
                other => {
                    return Err(fail(format!(
                        "has the byte order \"{other}\"; it must be little or big"
                    )));
                }
            };
        let number = |name: &str| {
            let text = header.get(name);
            text.map_or(Ok(0i64), str::parse)
                .map_err(|_| fail(format!("has a {name} that is not a number")))
        };
        let (line_skip, byte_skip) = (number("line skip")?, number("byte skip")?);
        let byte_skip = match byte_skip {
            n if n >= 0 => ByteSkip::Before(n.unsigned_abs()),
            n if !matches!(encoding, Encoding::Text | Encoding::Hex) => {
                ByteSkip::AfterValues(n.unsigned_abs() - 1)
            }
            n => {
                return Err(fail(format!(
                    "has a byte skip of {n}, which is not allowed for values written as text or hex; set it to the number of bytes before the values"
                )));
            }
        };
        Ok(Self {
            path,
            scalar,
            swap,
            encoding,
            line_skip: u64::try_from(line_skip)
                .map_err(|_| fail(format!("skips {line_skip} lines; a line skip is at least 0")))?,
            byte_skip,
            watch,
        })
    }

    /// Reads `[ahead, count]`: skips values and reads values, from the reader's position. `whole`
    /// is the number of values in the file.
    pub fn read(
        &self,
        path: &Path,
        mut reader: BufReader<File>,
        file_bytes: u64,
        [ahead, count]: [usize; 2],
        whole: usize,
    ) -> Result<StoredValues> {
        let size = self.scalar.bytes() as u64;
        let (before, bytes) = (ahead as u64 * size, count as u64 * size);
        skip_lines(path, &mut reader, self.line_skip)?;
        match self.encoding {
            Encoding::Raw => {
                check_held(path, before.saturating_add(bytes), file_bytes)?;
                let skipped = match self.byte_skip {
                    ByteSkip::Before(n) => n,
                    ByteSkip::AfterValues(after) => {
                        let start = file_bytes.checked_sub(self.bytes_to_end(whole, after));
                        let start = start.ok_or_else(|| shorter_than_skip(path, file_bytes))?;
                        reader
                            .seek(SeekFrom::Start(start))
                            .map_err(|e| read_error(path, e))?;
                        0
                    }
                };
                skip(path, &mut reader, skipped.saturating_add(before))?;
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
                let skipped = match self.byte_skip {
                    ByteSkip::Before(n) => n,
                    ByteSkip::AfterValues(after) => self.unpacked_start(path, &mut reader, whole, after)?,
                };
                let mut decoder = self.unpacked(reader);
                skip(path, &mut decoder, skipped.saturating_add(before))?;
                let mut source = self.source(path, decoder, count);
                let voxels = source.read_as(self.scalar)?;
                if ahead + count == whole {
                    check_end(path, source.reader)?;
                }
                Ok(voxels)
            }
            Encoding::Text => {
                self.skip_bytes(path, &mut reader)?;
                // A value and its separator take at least two bytes.
                check_held(
                    path,
                    (ahead as u64 + count as u64).saturating_mul(2).saturating_sub(1),
                    file_bytes,
                )?;
                text::values(path, reader, [ahead, count], self.scalar, self.watch)
            }
            Encoding::Hex => {
                self.skip_bytes(path, &mut reader)?;
                check_held(path, before.saturating_add(bytes).saturating_mul(2), file_bytes)?;
                let mut hex = Hex { reader, stray: None };
                let values = skip(path, &mut hex, before)
                    .and_then(|()| self.source(path, &mut hex, count).read_as(self.scalar));
                match hex.stray {
                    Some(byte) => Err(Error::file(
                        path,
                        format!(
                            "has \"{}\" among its values, which is not a hexadecimal digit; it is damaged",
                            char::from(byte).escape_default()
                        ),
                    )),
                    None => values,
                }
            }
        }
    }

    /// Reads values divided evenly among many files, each with its own skips.
    pub fn read_pieces(&self, files: &[PathBuf], total: usize, part: [usize; 2]) -> Result<StoredValues> {
        let read =
            |file: &Path, reader, file_bytes, part, piece| self.read(file, reader, file_bytes, part, piece);
        divided(self.path, files, total, part, self.watch, read)
    }

    /// Bytes from the first of `whole` values to the end, `after` bytes behind the last one.
    fn bytes_to_end(&self, whole: usize, after: u64) -> u64 {
        (whole as u64)
            .saturating_mul(self.scalar.bytes() as u64)
            .saturating_add(after)
    }

    /// Skips bytes before values that are not compressed.
    fn skip_bytes(&self, path: &Path, reader: &mut BufReader<File>) -> Result<()> {
        match self.byte_skip {
            ByteSkip::Before(n) => skip(path, reader, n),
            ByteSkip::AfterValues(_) => Ok(()),
        }
    }

    /// The stream that the rest of a file unpacks to.
    fn unpacked<'r>(&self, reader: impl BufRead + Send + 'r) -> Box<dyn Read + Send + 'r> {
        if self.encoding == Encoding::Gzip {
            Box::new(MultiGzDecoder::new(reader))
        } else {
            Box::new(MultiBzDecoder::new(reader))
        }
    }

    /// Offset of the values in the unpacked stream where they are located from its end. The stream
    /// is unpacked once to count its bytes; the reader returns to its position.
    fn unpacked_start(
        &self,
        path: &Path,
        reader: &mut BufReader<File>,
        whole: usize,
        after: u64,
    ) -> Result<u64> {
        let failed = |e| read_error(path, e);
        let position = reader.stream_position().map_err(failed)?;
        let mut decoder = self.unpacked(&mut *reader);
        let mut length = 0u64;
        loop {
            let read = std::io::copy(&mut decoder.by_ref().take(COUNTED_AT_ONCE), &mut std::io::sink());
            let read = read.map_err(failed)?;
            if read == 0 {
                break;
            }
            length += read;
            self.watch.check()?;
        }
        drop(decoder);
        reader.seek(SeekFrom::Start(position)).map_err(failed)?;
        length
            .checked_sub(self.bytes_to_end(whole, after))
            .ok_or_else(|| shorter_than_skip(path, length))
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

/// The error for values that lie at the end of too few bytes.
fn shorter_than_skip(path: &Path, bytes: u64) -> Error {
    Error::file(
        path,
        format!(
            "declares more values than the {bytes} bytes that it holds: it is truncated or its header is damaged; copy or download it again"
        ),
    )
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
    /// The first byte that is neither a digit nor white space.
    stray: Option<u8>,
}

impl<R: Read> Hex<R> {
    fn digit(&mut self) -> std::io::Result<Option<u8>> {
        loop {
            let Some(&byte) = self.reader.fill_buf()?.first() else {
                return Ok(None);
            };
            self.reader.consume(1);
            if byte.is_ascii_whitespace() {
                continue;
            }
            let Some(digit) = char::from(byte).to_digit(16) else {
                self.stray = Some(byte);
                return Err(std::io::ErrorKind::InvalidData.into());
            };
            return Ok(Some(digit as u8));
        }
    }
}

impl<R: Read> Read for Hex<R> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let mut done = 0;
        while done < bytes.len() {
            let Some(high) = self.digit()? else { break };
            let low = self.digit()?.ok_or(std::io::ErrorKind::UnexpectedEof)?;
            bytes[done] = high << 4 | low;
            done += 1;
        }
        Ok(done)
    }
}
