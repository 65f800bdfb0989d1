//! An image as a file stores it: typed values, one or several per voxel, and geometry. What the readers of all formats return, and
//! how raw bytes become typed values.

use super::super::{Rescale, Volume, Voxels};
use crate::{Error, Result};
use flate2::read::MultiGzDecoder;
use glam::{DAffine3, DMat3};
use rayon::prelude::*;
use std::io::{BufReader, ErrorKind, Read};
use std::path::Path;

/// Deflate cannot shrink data by more than this factor: a header that declares more is wrong.
pub(super) const DEFLATE_LIMIT: u64 = 1040;
/// NIfTI's intent code of label maps.
const INTENT_LABEL: i16 = 1002;

/// How the components of a voxel lie in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// One whole grid per component.
    Planar,
    /// All components of a voxel together.
    Interleaved,
}

/// An image of one or several components.
pub struct Image {
    /// Stored values.
    pub voxels: Voxels,
    /// Voxels along i, j, k.
    pub size: [usize; 3],
    /// Values per voxel.
    pub components: usize,
    /// How they lie.
    pub layout: Layout,
    /// Value = slope · stored + intercept.
    pub rescale: Rescale,
    /// Voxel indices to world millimetres, LPS.
    pub world_from_voxel: DAffine3,
    /// NIfTI's intent code; 0 for other formats.
    pub intent: i16,
    /// World (LPS) from the axes that vectors are stated in, if the format says.
    pub frame: Option<DMat3>,
    /// The file says that it is a displacement map of this program: four components, the last being the mask.
    pub displacement: bool,
    /// What was odd, one sentence each.
    pub warnings: Vec<String>,
}

impl Image {
    /// The image as a scalar volume.
    ///
    /// # Errors
    /// Several components, or a range that cannot be represented.
    pub fn into_volume(self, path: &Path) -> Result<Volume> {
        if self.components != 1 {
            return Err(Error::file(
                path,
                format!("holds {} values per voxel (a vector or displacement field); a scalar volume is needed", self.components),
            ));
        }
        let mut volume = Volume::new(self.voxels, self.size, self.rescale, self.world_from_voxel);
        if !(volume.range[1] - volume.range[0]).is_finite() {
            return Err(Error::file(path, "holds values whose range cannot be represented; rescale it"));
        }
        volume.warnings = self.warnings;
        if volume.non_finite > 0 {
            volume.warnings.push(format!("{} voxels are NaN or infinite and are rendered as empty", volume.non_finite));
        }
        volume.declared_labels = self.intent == INTENT_LABEL;
        Ok(volume)
    }

    /// Component `c` of every voxel, as data values.
    pub fn component(&self, c: usize) -> Vec<f32> {
        let n = self.size.iter().product::<usize>();
        let Rescale { slope, intercept } = self.rescale;
        (0..n)
            .into_par_iter()
            .map(|v| {
                let index = if self.layout == Layout::Planar { c * n + v } else { v * self.components + c };
                (self.voxels.get(index) * slope + intercept) as f32
            })
            .collect()
    }
}

/// The stored types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the variants are the Rust types")]
pub enum ScalarType {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl ScalarType {
    /// Bytes of one value.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }
}

/// A file's bytes, unzipped if it starts as a gzip stream does; its size, and whether it was zipped.
pub(super) fn open(path: &Path) -> Result<(Box<dyn Read>, u64, bool)> {
    let file = std::fs::File::open(path).map_err(|e| Error::io(path, "opening", e))?;
    let file_bytes = file.metadata().map_err(|e| Error::io(path, "reading", e))?.len();
    let mut reader = BufReader::with_capacity(1 << 18, file);
    let mut magic = [0u8; 2];
    reader.read_exact(&mut magic).map_err(|e| read_error(path, e))?;
    let start = std::io::Cursor::new(magic);
    if magic == [0x1f, 0x8b] {
        Ok((Box::new(BufReader::with_capacity(1 << 18, MultiGzDecoder::new(start.chain(reader)))), file_bytes, true))
    } else {
        Ok((Box::new(start.chain(reader)), file_bytes, false))
    }
}

pub(super) fn read_error(path: &Path, e: std::io::Error) -> Error {
    match e.kind() {
        ErrorKind::UnexpectedEof => Error::file(path, "ends too early: the file is truncated; copy or download it again"),
        ErrorKind::InvalidInput | ErrorKind::InvalidData => {
            Error::file(path, format!("its compressed stream is damaged ({e}); copy or download it again"))
        }
        _ => Error::io(path, "reading", e),
    }
}

/// A scalar whose bytes can be read straight from the file.
trait Stored: bytemuck::Pod + Default {
    fn swap(self) -> Self;
}
macro_rules! stored {
    ($($t:ty),*) => {$(impl Stored for $t {
        fn swap(self) -> Self {
            Self::from_ne_bytes({ let mut b = self.to_ne_bytes(); b.reverse(); b })
        }
    })*};
}
stored!(u8, i8, u16, i16, u32, i32, u64, i64, f32, f64);

/// Bytes that become typed values.
pub(super) struct Source<'a, R> {
    pub path: &'a Path,
    pub reader: R,
    pub swap: bool,
    pub count: usize,
    pub progress: &'a mut dyn FnMut(u64, u64),
}

impl<R: Read> Source<'_, R> {
    /// Reads values of a type known only now.
    pub fn read_as(&mut self, scalar: ScalarType) -> Result<Voxels> {
        Ok(match scalar {
            ScalarType::U8 => self.read::<u8>()?.into(),
            ScalarType::I8 => self.read::<i8>()?.into(),
            ScalarType::U16 => self.read::<u16>()?.into(),
            ScalarType::I16 => self.read::<i16>()?.into(),
            ScalarType::U32 => self.read::<u32>()?.into(),
            ScalarType::I32 => self.read::<i32>()?.into(),
            ScalarType::U64 => self.read::<u64>()?.into(),
            ScalarType::I64 => self.read::<i64>()?.into(),
            ScalarType::F32 => self.read::<f32>()?.into(),
            ScalarType::F64 => self.read::<f64>()?.into(),
        })
    }

    /// Reads in pieces into the one array that stays: nothing is held twice.
    fn read<T: Stored>(&mut self) -> Result<Vec<T>> {
        const PIECE: usize = 1 << 20;
        let all = (self.count * size_of::<T>()) as u64;
        let mut values: Vec<T> = Vec::new();
        values.try_reserve_exact(self.count).map_err(|_| Error::file(self.path, format!("needs {} MiB of memory, more than there is", all >> 20)))?;
        while values.len() < self.count {
            let from = values.len();
            values.resize((from + PIECE).min(self.count), T::default());
            let piece = &mut values[from..];
            self.reader.read_exact(bytemuck::cast_slice_mut(piece)).map_err(|e| read_error(self.path, e))?;
            if self.swap {
                piece.iter_mut().for_each(|v| *v = v.swap());
            }
            (self.progress)((values.len() * size_of::<T>()) as u64, all);
        }
        Ok(values)
    }
}
