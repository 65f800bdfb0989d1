//! One page: how its directory says that pixels are stored, and their values.
//!
//! Samples of 1 to 64 bits are read, most significant bit first, as the next larger integer or
//! float. Values stay as stored, as in tifffile and SimpleITK:
//! - WhiteIsZero does not turn values round; as with DICOM's MONOCHROME1, the image is marked as
//!   inverted, and slices are shown so;
//! - of a page with a colour table the indices are read: ImageJ stores one with any image that has
//!   a lookup table, and label masks are stored so, hence the indices are the measurements;
//! - the tag Orientation does not move pixels.
//!
//! A notice states each. Source: TIFF 6.0; Technical Note 3.

use super::super::super::StoredValues;
use super::super::ScalarType;
use super::super::planes::ImageSlice;
use super::super::source::{RawScalar, check_held, with_scalar, zeroed};
use super::codec::{Chunk, Compression};
use super::color;
use super::directory::{Directory, TiffReader, tag};
use super::samples::{Predictor, RowFormat, SampleKind};
use crate::{Error, Result};
use ndarray::Axis;
use std::path::Path;

/// Maximum compression ratio of pages.
pub(super) const MAX_COMPRESSION_RATIO: u64 = 3000;
/// Unpacked size of a page that is always accepted, however small the file.
const ALWAYS_BELIEVED: u64 = 16 << 20;
/// Maximum number of samples per pixel.
const MAX_SAMPLES: u64 = 4096;

/// What the samples of a pixel mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Photometric {
    WhiteIsZero,
    Grey,
    Rgb,
    Palette,
    Cmyk,
    YCbCr,
    ColorFilter,
}

impl Photometric {
    fn of(number: Option<u64>) -> Result<Self, String> {
        let name = match number {
            Some(0) => return Ok(Self::WhiteIsZero),
            // Files without the tag exist; the values are read as they are.
            None | Some(1 | 4 | 34892) => return Ok(Self::Grey),
            Some(2) => return Ok(Self::Rgb),
            Some(3) => return Ok(Self::Palette),
            Some(5) => return Ok(Self::Cmyk),
            Some(6) => return Ok(Self::YCbCr),
            Some(32803) => return Ok(Self::ColorFilter),
            Some(8) => "CIE L*a*b*",
            Some(9) => "ICC L*a*b*",
            Some(10) => "ITU L*a*b*",
            Some(32844 | 32845) => "LogLuv",
            Some(other) => return Err(format!("the photometric interpretation {other}")),
        };
        Err(name.to_owned())
    }
}

/// How a page is stored.
pub(super) struct PageFormat {
    /// Pixels along x and y.
    pub size: [usize; 2],
    /// Samples per pixel, extra ones included.
    pub samples: usize,
    pub photometric: Photometric,
    /// Meaning of the extra samples: 0 unspecified, 1 and 2 opacity.
    pub extra: Vec<u64>,
    pub compression: Compression,
    row: RowFormat,
    /// Whether each sample has strips or tiles of its own.
    planar: bool,
    /// Whether the lowest bit of a byte comes first.
    reversed: bool,
    /// Pixels of a strip or tile along x and y.
    chunk: [usize; 2],
    tiled: bool,
}

impl PageFormat {
    /// From a directory.
    ///
    /// # Errors
    /// A damaged directory, or a property that is not supported, by its name.
    pub fn of(file: &mut TiffReader, directory: &Directory) -> Result<Self> {
        let integer = |file: &mut TiffReader, t: u16| file.integer(directory, t);
        let (width, height) = (integer(file, tag::WIDTH)?, integer(file, tag::HEIGHT)?);
        let size = match (width, height) {
            (Some(w @ 1..=0xffff_ffff), Some(h @ 1..=0xffff_ffff)) => [w as usize, h as usize],
            _ => return Err(file.error("has a page without a width and a height; it is damaged")),
        };
        for (tag, name) in [(tag::IMAGE_DEPTH, "ImageDepth"), (tag::TILE_DEPTH, "TileDepth")] {
            if let Some(depth) = integer(file, tag)?.filter(|depth| *depth > 1) {
                return Err(file.error(format!(
                    "stores {depth} slices in a page ({name}), which cannot be read; save every slice as a page"
                )));
            }
        }
        let samples = integer(file, tag::SAMPLES)?.unwrap_or(1);
        if !(1..=MAX_SAMPLES).contains(&samples) {
            return Err(file.error(format!(
                "has {samples} samples per pixel; 1 to {MAX_SAMPLES} can be read"
            )));
        }
        let planar = integer(file, tag::PLANAR)? == Some(2) && samples > 1;
        let fax_options = integer(file, tag::FAX_OPTIONS)?.unwrap_or(0);
        let number = integer(file, tag::COMPRESSION)?.unwrap_or(1);
        let compression = Compression::of(number, fax_options).map_err(|name| {
            file.error(format!(
                "is compressed with {name}, which cannot be read; save it with deflate or without compression"
            ))
        })?;
        let photometric = Photometric::of(integer(file, tag::PHOTOMETRIC)?).map_err(|name| {
            file.error(format!(
                "stores colours as {name}, which cannot be read; convert it to grey or RGB"
            ))
        })?;
        let mut row = row_format(file, directory, if planar { 1 } else { samples as usize })?;
        if compression == Compression::Jpeg2000 {
            if row.kind == SampleKind::Float {
                return Err(file.error("declares JPEG 2000 pixels as floating-point numbers; it is damaged"));
            }
            // The decoder returns whole bytes, whatever the number of bits.
            row.bits = row.bits.next_power_of_two().max(8);
        }
        let tiled = directory.has(tag::TILE_OFFSETS) || directory.has(tag::TILE_WIDTH);
        let chunk = if tiled {
            let of = |n: Option<u64>| n.filter(|n| (1..=1 << 20).contains(n)).map(|n| n as usize);
            let (w, h) = (integer(file, tag::TILE_WIDTH)?, integer(file, tag::TILE_HEIGHT)?);
            let (Some(w), Some(h)) = (of(w), of(h)) else {
                return Err(file.error("has tiles without a plausible size; it is damaged"));
            };
            [w, h]
        } else {
            let rows = integer(file, tag::ROWS_PER_STRIP)?.unwrap_or(u64::MAX);
            [size[0], rows.clamp(1, size[1] as u64) as usize]
        };
        let format = Self {
            size,
            samples: samples as usize,
            photometric,
            extra: file.integers(directory, tag::EXTRA_SAMPLES)?.unwrap_or_default(),
            compression,
            row,
            planar,
            reversed: integer(file, tag::FILL_ORDER)? == Some(2),
            chunk,
            tiled,
        };
        format.check().map_err(|problem| file.error(problem))?;
        if format.photometric == Photometric::YCbCr && !format.compression.is_picture() {
            color::check_subsampling(file, directory)?;
        }
        Ok(format)
    }

    /// Rejects combinations that are not supported.
    fn check(&self) -> Result<(), String> {
        let RowFormat { bits, predictor, .. } = self.row;
        if matches!(self.compression, Compression::Fax(_)) && bits * self.row.samples as u32 != 1 {
            return Err("is compressed as a fax but has more than one bit per pixel; it is damaged".into());
        }
        if self.compression == Compression::Jpeg && bits != 8 {
            return Err(format!(
                "is compressed with JPEG of {bits} bits, which cannot be read; save it with deflate or without compression"
            ));
        }
        let fits = match predictor {
            Predictor::None => true,
            Predictor::Horizontal => matches!(bits, 8 | 16 | 32 | 64),
            Predictor::FloatingPoint => self.row.kind == SampleKind::Float,
        };
        if !fits {
            return Err(format!(
                "has the predictor {} on {} of {bits} bits, which cannot be read; save it without a predictor",
                if predictor == Predictor::Horizontal { 2 } else { 3 },
                if self.row.kind == SampleKind::Float {
                    "floats"
                } else {
                    "integers"
                },
            ));
        }
        Ok(())
    }

    /// Type of the values.
    pub fn scalar(&self) -> ScalarType {
        use ScalarType as S;
        match (self.row.kind, self.row.bits) {
            (SampleKind::Float, 64) => S::F64,
            (SampleKind::Float, _) => S::F32,
            (SampleKind::Unsigned, 0..=8) => S::U8,
            (SampleKind::Unsigned, 9..=16) => S::U16,
            (SampleKind::Unsigned, 17..=32) => S::U32,
            (SampleKind::Unsigned, _) => S::U64,
            (SampleKind::Signed, 0..=8) => S::I8,
            (SampleKind::Signed, 9..=16) => S::I16,
            (SampleKind::Signed, 17..=32) => S::I32,
            (SampleKind::Signed, _) => S::I64,
        }
    }

    /// Bytes of a strip or tile of some rows.
    fn chunk_bytes(&self, rows: usize) -> Option<usize> {
        self.row.row_bytes(self.chunk[0])?.checked_mul(rows)
    }

    /// Bytes of the stored pixels before compression.
    pub fn stored_bytes(&self) -> u64 {
        let row = self.row.row_bytes(self.size[0]).unwrap_or(usize::MAX) as u64;
        let planes = if self.planar { self.samples as u64 } else { 1 };
        row.saturating_mul(self.size[1] as u64).saturating_mul(planes)
    }

    /// Rejects a page, of which there are `count`, that the file cannot contain.
    pub fn check_held(&self, file: &TiffReader, count: u64) -> Result<()> {
        let most = if self.compression == Compression::None && !self.tiled {
            // Pages may share their pixels.
            file.bytes
                .saturating_mul(if count > 1 { MAX_COMPRESSION_RATIO } else { 1 })
        } else {
            file.bytes
                .saturating_mul(MAX_COMPRESSION_RATIO)
                .max(ALWAYS_BELIEVED)
        };
        check_held(&file.path, self.stored_bytes().saturating_mul(count), most)
    }

    /// Number of colour samples, before the extra ones.
    fn color_samples(&self) -> usize {
        match self.photometric {
            Photometric::Rgb | Photometric::YCbCr => 3,
            Photometric::Cmyk => 4,
            _ => 1,
        }
    }

    /// Whether the samples are red, green, blue and perhaps opacity.
    pub fn is_color(&self) -> bool {
        matches!(
            self.photometric,
            Photometric::Rgb | Photometric::YCbCr | Photometric::Cmyk
        ) && (3..=4).contains(&self.retained())
    }

    /// Samples that are retained: the colours, an opacity beside them, and further channels; not an
    /// opacity beside grey values, and no unexplained fourth sample of a colour.
    pub fn retained(&self) -> usize {
        let (colors, extra) = (
            self.color_samples(),
            self.samples.saturating_sub(self.color_samples()),
        );
        let is_opacity = matches!(self.extra.first(), Some(1 | 2));
        match (self.photometric, extra) {
            (Photometric::Cmyk, _) => 3,
            (Photometric::YCbCr, _) => 3,
            (Photometric::Rgb, 1) if !is_opacity => colors,
            (Photometric::Grey | Photometric::WhiteIsZero | Photometric::Palette, 1) if is_opacity => colors,
            _ => self.samples,
        }
    }

    /// Reads the values of a page whose strips or tiles begin `shift` bytes after the stated
    /// places.
    pub fn read(&self, file: &mut TiffReader, directory: &Directory, shift: u64) -> Result<ImageSlice> {
        self.check_held(file, 1)?;
        if self.samples < self.color_samples() {
            return Err(file.error("has fewer samples than its colours need; it is damaged"));
        }
        let chunks = Chunks::of(self, file, directory, shift)?;
        let values: StoredValues = with_scalar!(self.scalar(), T => {
            chunks.read::<T>(file, &|v| v as T)?.into()
        });
        let values = self.converted(file, directory, values)?;
        Ok(ImageSlice {
            size: self.size,
            components: self.retained(),
            values,
        })
    }

    /// Colours as red, green and blue; without samples that are left out.
    fn converted(
        &self,
        file: &mut TiffReader,
        directory: &Directory,
        values: StoredValues,
    ) -> Result<StoredValues> {
        let pixels = self.size[0] * self.size[1];
        let values = match (self.photometric, &values) {
            (Photometric::Cmyk, StoredValues::U8(v)) => {
                color::of_cmyk(v.as_slice().unwrap_or(&[]), self.samples).into()
            }
            (Photometric::YCbCr, StoredValues::U8(v)) if !self.compression.is_picture() => {
                let space = color::YCbCr::of(file, directory)?;
                space.to_rgb(v.as_slice().unwrap_or(&[]), self.samples).into()
            }
            (Photometric::Cmyk, _) => {
                return Err(file.error("stores CMYK with more than 8 bits per sample; convert it to RGB"));
            }
            (Photometric::YCbCr, _) if !self.compression.is_picture() => {
                return Err(file.error("stores YCbCr with more than 8 bits per sample; convert it to RGB"));
            }
            _ => values,
        };
        let (present, retained) = (values.len() / pixels.max(1), self.retained());
        if present == retained {
            return Ok(values);
        }
        Ok(values
            .reshaped((pixels, present))
            .first_of(Axis(1), retained)
            .reshaped(pixels * retained))
    }

    /// What a user must know about the values.
    pub fn notices(&self, file: &mut TiffReader, directory: &Directory) -> Result<Vec<String>> {
        let mut notices = Vec::new();
        let mut note = |text: &str| notices.push(text.to_owned());
        match self.photometric {
            Photometric::WhiteIsZero => note(
                "stores white as 0 (WhiteIsZero); its values are read as they are, and low values are the bright ones",
            ),
            Photometric::Palette if !color::is_grey_ramp(file, directory)? => {
                note("has a colour table; its indices are read as values, and the colours are not used");
            }
            Photometric::Cmyk => {
                note("stores CMYK; its colours are converted to RGB without a colour profile")
            }
            Photometric::ColorFilter => {
                note("holds raw camera values behind a colour filter array (CFA), which are shown as grey");
            }
            _ => {}
        }
        if self.samples > self.retained() && self.photometric != Photometric::Cmyk {
            note(if matches!(self.extra.first(), Some(1 | 2)) {
                "has an opacity (alpha) channel beside its grey values; it is left out"
            } else {
                "has an extra sample per pixel whose meaning is not stated; it is left out"
            });
        }
        match file.integer(directory, tag::ORIENTATION)? {
            None | Some(1) => {}
            Some(n) => note(&format!(
                "states the orientation {n} ({}); its pixels are shown as they are stored",
                match n {
                    2 => "mirrored left to right",
                    3 => "turned by 180 degrees",
                    4 => "upside down",
                    5..=8 => "rows and columns exchanged",
                    _ => "unknown",
                }
            )),
        }
        Ok(notices)
    }
}

/// Type, bits and predictor of the samples.
fn row_format(file: &mut TiffReader, directory: &Directory, samples: usize) -> Result<RowFormat> {
    let bits = file.integers(directory, tag::BITS)?.unwrap_or_else(|| vec![1]);
    let formats = file.integers(directory, tag::SAMPLE_FORMAT)?.unwrap_or_default();
    let first = bits.first().copied().unwrap_or(1);
    if bits.iter().any(|b| *b != first) {
        let list = bits.iter().take(8).map(u64::to_string).collect::<Vec<_>>();
        return Err(file.error(format!(
            "has samples of different depth ({} bits); convert them to a single depth",
            list.join(", ")
        )));
    }
    let format = formats.first().copied().unwrap_or(1);
    if formats.iter().any(|f| *f != format) {
        return Err(file.error("has samples of different types; convert them to a single type"));
    }
    let unsupported = |what: &str| {
        file.error(format!(
            "stores {what} of {first} bits; convert them to a real scalar type"
        ))
    };
    let kind = match (format, first) {
        (3, 16 | 24 | 32 | 64) => SampleKind::Float,
        (3, _) => return Err(unsupported("floats")),
        (2, 1..=53 | 64) => SampleKind::Signed,
        (5, _) => return Err(unsupported("complex integers")),
        (6, _) => return Err(unsupported("complex floats")),
        (_, 1..=53 | 64) => SampleKind::Unsigned,
        _ => return Err(unsupported("integers")),
    };
    let predictor = match file.integer(directory, tag::PREDICTOR)? {
        None | Some(0 | 1) => Predictor::None,
        Some(2) => Predictor::Horizontal,
        Some(3) => Predictor::FloatingPoint,
        Some(other) => {
            return Err(file.error(format!(
                "has the predictor {other}, which cannot be read; save it without a predictor"
            )));
        }
    };
    Ok(RowFormat {
        kind,
        bits: first as u32,
        samples,
        predictor,
        big_endian: file.big_endian,
    })
}

/// Strips or tiles of a page.
struct Chunks<'a> {
    format: &'a PageFormat,
    offsets: Vec<u64>,
    lengths: Vec<u64>,
    jpeg_tables: Vec<u8>,
    shift: u64,
    /// Strips or tiles along x and y.
    grid: [usize; 2],
}

impl<'a> Chunks<'a> {
    fn of(format: &'a PageFormat, file: &mut TiffReader, directory: &Directory, shift: u64) -> Result<Self> {
        let [offsets, lengths] = if format.tiled {
            [tag::TILE_OFFSETS, tag::TILE_BYTES]
        } else {
            [tag::STRIP_OFFSETS, tag::STRIP_BYTES]
        };
        let offsets = file
            .integers(directory, offsets)?
            .ok_or_else(|| file.error("does not say where its pixels are; it is damaged"))?;
        let lengths = file.integers(directory, lengths)?.unwrap_or_default();
        let length = format.chunk_bytes(format.chunk[1]);
        let most = file
            .bytes
            .saturating_mul(MAX_COMPRESSION_RATIO)
            .max(ALWAYS_BELIEVED);
        check_held(&file.path, length.map_or(u64::MAX, |n| n as u64), most)?;
        let grid = [0, 1].map(|a| format.size[a].div_ceil(format.chunk[a]));
        let planes = if format.planar { format.samples } else { 1 };
        let wanted = grid[0].saturating_mul(grid[1]).saturating_mul(planes);
        if offsets.len() < wanted || !lengths.is_empty() && lengths.len() < wanted {
            return Err(file.error(format!(
                "has a page with {} of {wanted} strips or tiles; it is damaged",
                offsets.len().min(lengths.len())
            )));
        }
        Ok(Self {
            format,
            offsets,
            lengths,
            jpeg_tables: file
                .bytes_of_tag(directory, tag::JPEG_TABLES)?
                .unwrap_or_default(),
            shift,
            grid,
        })
    }

    /// All values, the samples of a pixel together.
    fn read<T: RawScalar>(&self, file: &mut TiffReader, convert: &dyn Fn(f64) -> T) -> Result<Vec<T>> {
        let format = self.format;
        let (size, stored) = (format.size, format.row.samples);
        let planes = if format.planar { format.samples } else { 1 };
        let total = size[0]
            .checked_mul(size[1])
            .and_then(|n| n.checked_mul(format.samples))
            .ok_or_else(|| file.error("has a page that is too large; it is damaged"))?;
        let mut values: Vec<T> = zeroed(&file.path, total)?;
        let mut row_values: Vec<T> = vec![T::default(); format.chunk[0] * stored];
        for plane in 0..planes {
            for y in 0..self.grid[1] {
                for x in 0..self.grid[0] {
                    let index = (plane * self.grid[1] + y) * self.grid[0] + x;
                    let corner = [x * format.chunk[0], y * format.chunk[1]];
                    let rows = format.chunk[1].min(size[1] - corner[1]);
                    let columns = format.chunk[0].min(size[0] - corner[0]);
                    let Some(mut bytes) = self.chunk(file, index, rows)? else {
                        continue;
                    };
                    let row_bytes = bytes.len() / if format.tiled { format.chunk[1] } else { rows };
                    for (r, row) in bytes.chunks_exact_mut(row_bytes).take(rows).enumerate() {
                        format.restored(row, &mut row_values, convert);
                        let first = (corner[1] + r) * size[0] + corner[0];
                        if planes == 1 {
                            values[first * stored..(first + columns) * stored]
                                .copy_from_slice(&row_values[..columns * stored]);
                        } else {
                            for (c, value) in row_values[..columns].iter().enumerate() {
                                values[(first + c) * planes + plane] = *value;
                            }
                        }
                    }
                }
            }
        }
        Ok(values)
    }

    /// The unpacked bytes of a strip or tile of `rows` rows within the page; none for one that was
    /// left out because it is empty.
    fn chunk(&self, file: &mut TiffReader, index: usize, rows: usize) -> Result<Option<Vec<u8>>> {
        let format = self.format;
        let rows = if format.tiled { format.chunk[1] } else { rows };
        let damaged = |path: &Path, problem: &str| {
            let name = format.compression.name();
            Error::file(
                path,
                format!(
                    "has a strip or tile that cannot be unpacked ({name}: {problem}); copy or export it again"
                ),
            )
        };
        let length = format
            .chunk_bytes(rows)
            .ok_or_else(|| damaged(&file.path, "it is too large"))?;
        let offset = self.offsets[index];
        let stated = self.lengths.get(index).copied();
        if offset == 0 && stated.unwrap_or(0) == 0 {
            return Ok(None);
        }
        let offset = offset.saturating_add(self.shift);
        // Uncompressed strips have their size in any case; some writers state another.
        let bytes = match (format.compression, stated) {
            (Compression::None, _) => length as u64,
            (_, Some(n @ 1..)) => n,
            _ => file.bytes.saturating_sub(offset),
        };
        let mut packed = file.piece(offset, bytes)?;
        if format.reversed && !format.compression.is_picture() {
            packed.iter_mut().for_each(|b| *b = b.reverse_bits());
        }
        let chunk = Chunk {
            size: [format.chunk[0], rows],
            samples: format.row.samples,
            bits: format.row.bits,
            length,
            jpeg_tables: &self.jpeg_tables,
            is_ycbcr: format.photometric == Photometric::YCbCr,
            signed: format.row.kind == SampleKind::Signed,
        };
        let unpacked = chunk
            .decode(format.compression, packed)
            .map_err(|problem| damaged(&file.path, &problem))?;
        if unpacked.len() < length {
            let problem = format!("{} of {length} bytes", unpacked.len());
            return Err(damaged(&file.path, &problem));
        }
        Ok(Some(unpacked))
    }
}

impl PageFormat {
    /// The values of a row of a strip or tile.
    fn restored<T: RawScalar>(&self, row: &mut [u8], values: &mut [T], convert: &dyn Fn(f64) -> T) {
        if self.compression != Compression::Jpeg2000 {
            self.row.restore(row);
        }
        if self.row.is_native() {
            let target: &mut [u8] = bytemuck::cast_slice_mut(values);
            let length = target.len().min(row.len());
            target[..length].copy_from_slice(&row[..length]);
        } else {
            for (value, number) in values.iter_mut().zip(self.row.numbers(row)) {
                *value = convert(number);
            }
        }
    }
}
