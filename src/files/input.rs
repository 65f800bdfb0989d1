//! Input: every reader opens its files here. Only regular files are opened; each is registered as
//! read ([`super::inputs`]), and memory use is bounded by what the file can plausibly hold.

use super::{inputs, memory};
use crate::{Error, Result};
use flate2::read::MultiGzDecoder;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read};
use std::path::Path;

/// Deflate cannot compress data by more than this factor: a header that declares more is wrong.
pub const DEFLATE_LIMIT: u64 = 1040;
/// Largest compression ratio accepted for texts and meshes. Tables of numbers shrink to a tenth,
/// those of a regular grid to a hundredth.
const TEXT_RATIO: u64 = 100;
/// Unpacked size that is always accepted, however small the file.
const ALWAYS_BELIEVED: u64 = 64 << 20;
/// Largest scene, in bytes.
pub const MAX_SCENE_BYTES: u64 = 64 << 20;
/// Bytes read at once.
const BUFFER: usize = 1 << 18;

/// Opens a regular file; also returns its length.
///
/// # Errors
/// A file that does not exist or may not be read; a folder, pipe, socket or device.
pub fn open(path: &Path) -> Result<(File, u64)> {
    let failed = |e| Error::io(path, "opening", e);
    // Checked before opening: opening a pipe waits for its writer, and opening a device can have
    // any effect.
    let metadata = std::fs::metadata(path).map_err(failed)?;
    ordinary(path, &metadata)?;
    let mut options = std::fs::OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    {
        // Does not block if a pipe has taken the file's place since the check.
        use std::os::unix::fs::OpenOptionsExt;
        options.custom_flags(rustix::fs::OFlags::NONBLOCK.bits() as i32);
    }
    let file = options.open(path).map_err(failed)?;
    let metadata = file.metadata().map_err(failed)?;
    ordinary(path, &metadata)?;
    inputs::register(path, &metadata);
    Ok((file, metadata.len()))
}

fn ordinary(path: &Path, metadata: &std::fs::Metadata) -> Result<()> {
    match metadata.file_type() {
        t if t.is_file() => Ok(()),
        t if t.is_dir() => Err(Error::file(path, "is a folder; name a file in it")),
        _ => Err(Error::file(
            path,
            "is not a regular file (it is a pipe, a socket or a device); save its content to a file and name that",
        )),
    }
}

/// A buffered file and its length.
///
/// # Errors
/// As [`open`].
pub fn buffered(path: &Path) -> Result<(BufReader<File>, u64)> {
    let (file, bytes) = open(path)?;
    Ok((BufReader::with_capacity(BUFFER, file), bytes))
}

/// A reader of a file's bytes, decompressed if they start as a gzip stream does; and an upper bound
/// on their number.
///
/// # Errors
/// As [`open`]; a file of less than two bytes.
pub fn unzipped(path: &Path) -> Result<(Box<dyn Read + Send>, u64)> {
    let (mut reader, file_bytes) = buffered(path)?;
    let mut magic = [0u8; 2];
    reader.read_exact(&mut magic).map_err(|e| read_error(path, e))?;
    let start = std::io::Cursor::new(magic);
    if magic == [0x1f, 0x8b] {
        Ok((
            Box::new(BufReader::with_capacity(
                BUFFER,
                MultiGzDecoder::new(start.chain(reader)),
            )),
            file_bytes.saturating_mul(DEFLATE_LIMIT),
        ))
    } else {
        Ok((Box::new(start.chain(reader)), file_bytes))
    }
}

/// A read error as a message about the file.
pub fn read_error(path: &Path, e: std::io::Error) -> Error {
    match e.kind() {
        ErrorKind::UnexpectedEof => Error::file(
            path,
            "ends too early: the file is truncated; copy or download it again",
        ),
        ErrorKind::InvalidInput | ErrorKind::InvalidData | ErrorKind::Other => Error::file(
            path,
            format!("its compressed stream is damaged ({e}); copy or download it again"),
        ),
        ErrorKind::OutOfMemory => {
            Error::file(path, "needs more memory than is available; close other programs")
        }
        _ => Error::io(path, "reading", e),
    }
}

/// A whole file of at most `most` bytes; `what` names its purpose in the error for a larger file.
///
/// # Errors
/// As [`open`]; a larger file.
pub fn bytes(path: &Path, most: u64, what: &str) -> Result<Vec<u8>> {
    let (file, length) = open(path)?;
    if length > most {
        return Err(Error::file(
            path,
            format!("is {length} bytes long, too large for a {what} (at most {most} bytes)"),
        ));
    }
    read_all(path, file, length, most, what)
}

/// A whole file, decompressed if it starts as a gzip stream does.
///
/// # Errors
/// As [`bytes`]; a stream that unpacks to more than a hundred times its size, as no legitimate file
/// of this kind does.
pub fn unzipped_bytes(path: &Path, most: u64, what: &str) -> Result<Vec<u8>> {
    let packed = bytes(path, most, what)?;
    if !packed.starts_with(&[0x1f, 0x8b]) {
        return Ok(packed);
    }
    let most = most.min(
        (packed.len() as u64)
            .saturating_mul(TEXT_RATIO)
            .max(ALWAYS_BELIEVED),
    );
    read_all(path, MultiGzDecoder::new(&packed[..]), 0, most, what)
}

fn read_all(path: &Path, reader: impl Read, expected: u64, most: u64, what: &str) -> Result<Vec<u8>> {
    let mut all = memory::reserve(path, expected as usize)?;
    grow(path, &mut all, reader, most.saturating_add(1))?;
    if all.len() as u64 > most {
        return Err(Error::file(
            path,
            format!(
                "unpacks to more than {most} bytes, too much for a {what} of its size; it is damaged or malicious"
            ),
        ));
    }
    Ok(all)
}

/// The first bytes of a stream that belongs to `path`: at most `most`, and no more than fit into
/// memory.
///
/// # Errors
/// A stream that is damaged or does not fit into memory.
pub fn start_of(path: &Path, reader: impl Read, most: u64) -> Result<Vec<u8>> {
    let mut start = Vec::new();
    grow(path, &mut start, reader, most)?;
    Ok(start)
}

/// Reads in pieces that grow with the bytes already read, so that each piece is checked against the
/// available memory.
fn grow(path: &Path, all: &mut Vec<u8>, reader: impl Read, most: u64) -> Result<()> {
    let mut reader = reader.take(most);
    let mut piece = 1u64 << 24;
    loop {
        let read = reader
            .by_ref()
            .take(piece)
            .read_to_end(all)
            .map_err(|e| read_error(path, e))?;
        if (read as u64) < piece {
            return Ok(());
        }
        piece = all.len() as u64;
        memory::check(path, 2 * piece)?;
    }
}

/// A whole text file of at most `most` bytes.
///
/// # Errors
/// As [`bytes`]; bytes that are not UTF-8.
pub fn text(path: &Path, most: u64, what: &str) -> Result<String> {
    String::from_utf8(bytes(path, most, what)?)
        .map_err(|_| Error::file(path, format!("is not text in UTF-8, so it is not a {what}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn what_grows_beyond_belief_is_refused() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let path = folder.path().join("bomb.obj.gz");
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        for _ in 0..300 {
            encoder
                .write_all(&[b'#'; 1 << 20])
                .unwrap_or_else(|e| panic!("{e}"));
        }
        let packed = encoder.finish().unwrap_or_else(|e| panic!("{e}"));
        assert!(packed.len() < 1 << 20);
        std::fs::write(&path, packed).unwrap_or_else(|e| panic!("{e}"));
        let error = unzipped_bytes(&path, 4 << 30, "mesh")
            .err()
            .map(|e| e.to_string())
            .unwrap_or_default();
        assert!(error.contains("unpacks to more than"), "{error}");
        assert!(
            bytes(&path, 10, "list")
                .err()
                .is_some_and(|e| e.to_string().contains("too large for a list"))
        );
        assert!(
            text(&path, 1 << 20, "list")
                .err()
                .is_some_and(|e| e.to_string().contains("not text"))
        );
        assert!(
            bytes(folder.path(), 10, "list")
                .err()
                .is_some_and(|e| e.to_string().contains("is a folder"))
        );
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn devices_are_refused_under_every_name() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let link = folder.path().join("zero.toml");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap_or_else(|e| panic!("{e}"));
        for path in [&link, Path::new("/dev/zero")] {
            assert!(
                open(path)
                    .err()
                    .is_some_and(|e| e.to_string().contains("not a regular file"))
            );
        }
    }
}
