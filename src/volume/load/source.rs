//! Bytes of files, and their conversion to typed values: nothing is allocated that the file cannot
//! fill, and nothing is held twice.

use super::super::StoredValues;
use super::ScalarType;
pub(super) use crate::files::input::{
    DEFLATE_LIMIT, buffered, open as open_file, read_error, unzipped as open,
};
pub(super) use crate::files::memory::reserve as reserved;
pub(super) use crate::files::reference::sibling_file;
use crate::{ByteProgress, Error, Result, Watch};
use glam::DAffine3;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read};
use std::path::{Path, PathBuf};

/// Maximum compression ratio of bzip2: 900 kB of one byte take 46 bytes.
pub(super) const BZIP2_LIMIT: u64 = 25_000;
/// The problem with a compressed file of a format that is read only as it is.
pub(super) const GZIPPED: &str = "is compressed with gzip; unpack it and name the unpacked file";
/// Number of bytes after the values of a compressed stream that are read to check its end.
const MAX_TRAILING_BYTES: u64 = 1 << 24;

/// The first bytes of a file, uncompressed: at most `most`.
pub(super) fn first_bytes(path: &Path, most: u64) -> Result<Vec<u8>> {
    let (reader, _) = open(path)?;
    let mut bytes = Vec::new();
    // Errors of the decompression are left to the reader.
    let _end = reader.take(most).read_to_end(&mut bytes);
    Ok(bytes)
}

/// Number of values in an image, if it can be addressed.
pub(super) fn count(path: &Path, extents: &[usize], scalar: ScalarType) -> Result<usize> {
    extents
        .iter()
        .try_fold(1usize, |n, &d| n.checked_mul(d))
        .filter(|n| n.checked_mul(scalar.bytes()).is_some_and(|b| b < isize::MAX as usize))
        .ok_or_else(|| {
            let size = extents.iter().map(usize::to_string).collect::<Vec<_>>().join(" x ");
            Error::file(path, format!("declares {size} values, more than can be addressed: its header is damaged; copy or download it again"))
        })
}

/// Rejects values that the file cannot contain.
pub(super) fn check_held(path: &Path, bytes: u64, max_bytes: u64) -> Result<()> {
    if bytes > max_bytes {
        return Err(Error::file(
            path,
            format!(
                "declares {bytes} bytes of values, more than the file can hold: it is truncated or its header is damaged; copy or download it again"
            ),
        ));
    }
    Ok(())
}

/// Whether a grid's geometry is usable: finite, with axes of a plausible length, no two of them
/// parallel. Voxels may have any size.
pub(super) fn usable(world_from_voxel: &DAffine3) -> bool {
    let m = world_from_voxel.matrix3;
    let lengths = [m.x_axis, m.y_axis, m.z_axis].map(|c| c.length());
    world_from_voxel.is_finite()
        && world_from_voxel.translation.length() < 1e12
        && lengths.iter().all(|l| (1e-12..1e12).contains(l))
        && m.determinant().abs() > 1e-9 * lengths.iter().product::<f64>()
}

/// Skips bytes.
pub(super) fn skip(path: &Path, reader: &mut impl Read, bytes: u64) -> Result<()> {
    let passed =
        std::io::copy(&mut reader.take(bytes), &mut std::io::sink()).map_err(|e| read_error(path, e))?;
    if passed < bytes {
        Err(read_error(path, ErrorKind::UnexpectedEof.into()))
    } else {
        Ok(())
    }
}

/// Reads the bytes after the values, to check a gzip stream up to its checksum. Other bytes after
/// the stream are harmless.
pub(super) fn check_end(path: &Path, reader: impl Read) -> Result<()> {
    match std::io::copy(&mut reader.take(MAX_TRAILING_BYTES), &mut std::io::sink()) {
        Err(e)
            if e.kind() == ErrorKind::UnexpectedEof
                || e.to_string().contains("checksum")
                || e.to_string().contains("corrupt gzip") =>
        {
            Err(read_error(path, e))
        }
        _ => Ok(()),
    }
}

/// A scalar whose bytes can be read directly from a file.
pub(super) trait RawScalar: bytemuck::Pod + Default + Send + Sync {
    fn swap(self) -> Self;
}
macro_rules! stored {
    ($($t:ty),*) => {$(impl RawScalar for $t {
        #[inline(always)]
        fn swap(self) -> Self {
            Self::from_ne_bytes({ let mut b = self.to_ne_bytes(); b.reverse(); b })
        }
    })*};
}
stored!(u8, i8, u16, i16, u32, i32, u64, i64, f32, f64);

/// Calls a generic function with the Rust type of a [`ScalarType`].
macro_rules! with_scalar {
    ($scalar:expr, $t:ident => $body:expr) => {
        match $scalar {
            $crate::volume::load::ScalarType::U8 => {
                type $t = u8;
                $body
            }
            $crate::volume::load::ScalarType::I8 => {
                type $t = i8;
                $body
            }
            $crate::volume::load::ScalarType::U16 => {
                type $t = u16;
                $body
            }
            $crate::volume::load::ScalarType::I16 => {
                type $t = i16;
                $body
            }
            $crate::volume::load::ScalarType::U32 => {
                type $t = u32;
                $body
            }
            $crate::volume::load::ScalarType::I32 => {
                type $t = i32;
                $body
            }
            $crate::volume::load::ScalarType::U64 => {
                type $t = u64;
                $body
            }
            $crate::volume::load::ScalarType::I64 => {
                type $t = i64;
                $body
            }
            $crate::volume::load::ScalarType::F32 => {
                type $t = f32;
                $body
            }
            $crate::volume::load::ScalarType::F64 => {
                type $t = f64;
                $body
            }
        }
    };
}
pub(super) use with_scalar;

/// Converts bytes to typed values.
pub(super) struct ValueReader<'a, R> {
    pub path: &'a Path,
    pub reader: R,
    pub swap: bool,
    pub count: usize,
    pub watch: &'a Watch<'a>,
}

impl<R: Read> ValueReader<'_, R> {
    /// Reads values of a type known at run time.
    pub fn read_as(&mut self, scalar: ScalarType) -> Result<StoredValues> {
        with_scalar!(scalar, T => self.read::<T>().map(Into::into))
    }

    /// Reads piecewise into the final array.
    fn read<T: RawScalar>(&mut self) -> Result<Vec<T>> {
        const PIECE: usize = 1 << 20;
        let mut values: Vec<T> = reserved(self.path, self.count)?;
        let meter = ByteProgress::new(self.watch, (self.count * size_of::<T>()) as u64);
        while values.len() < self.count {
            let from = values.len();
            values.resize((from + PIECE).min(self.count), T::default());
            let piece = &mut values[from..];
            self.reader
                .read_exact(bytemuck::cast_slice_mut(piece))
                .map_err(|e| read_error(self.path, e))?;
            if self.swap {
                piece.iter_mut().for_each(|v| *v = v.swap());
            }
            meter.add(size_of_val(piece) as u64)?;
        }
        Ok(values)
    }
}

/// An array of `count` zeros.
pub(super) fn zeroed<T: RawScalar>(path: &Path, count: usize) -> Result<Vec<T>> {
    reserved::<T>(path, count)?;
    // Fresh zero pages, not written to.
    Ok(vec![T::default(); count])
}

/// Reads `[ahead, count]` of `total` values that are divided evenly among several files: skips values
/// and reads values. `read` takes a file, its reader and length, what to skip and read of its
/// values, and their number.
pub(super) fn divided(
    path: &Path,
    files: &[PathBuf],
    total: usize,
    [ahead, count]: [usize; 2],
    watch: &Watch,
    read: impl Fn(&Path, BufReader<File>, u64, [usize; 2], usize) -> Result<StoredValues>,
) -> Result<StoredValues> {
    if !total.is_multiple_of(files.len()) {
        return Err(Error::file(
            path,
            format!(
                "names {} data files, which cannot hold equal parts of its {total} values",
                files.len()
            ),
        ));
    }
    let piece = total / files.len();
    let mut all: Option<StoredValues> = None;
    for (n, file) in files.iter().enumerate() {
        // The part of the wanted values that this file holds.
        let first = ahead.max(n * piece);
        let end = (ahead + count).min((n + 1) * piece);
        if first >= end {
            continue;
        }
        let (reader, file_bytes) = buffered(file)?;
        let values = read(file, reader, file_bytes, [first - n * piece, end - first], piece)?;
        match &mut all {
            None => all = Some(values),
            Some(all) => {
                all.append(&values);
            }
        }
        watch.check()?;
    }
    all.ok_or_else(|| Error::file(path, "names no data file with the values to read"))
}
