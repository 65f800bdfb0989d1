//! The pages of a TIFF, as slices.

use super::super::image::Layout;
use super::super::planes::{ImageSlice, ImageStack};
use super::super::source::{ValueReader, check_held, count, open_file, skip};
use super::super::{ScalarType, StoredValues};
use crate::panic_guard::catch_panic;
use crate::{ByteProgress, Error, Result, Watch};
use ndarray::Ix3;
use std::fs::File;
use std::io::{BufReader, Seek, SeekFrom};
use std::path::Path;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

/// Maximum compression ratio of pages.
const MAX_COMPRESSION_RATIO: u64 = 3000;
/// Maximum number of pages in a file.
const MAX_PAGES: usize = 1 << 20;

pub(super) type TiffDecoder = Decoder<BufReader<File>>;

fn damaged(path: &Path) -> impl Fn(tiff::TiffError) -> Error + '_ {
    move |e| {
        Error::file(
            path,
            format!("is not a readable TIFF ({e}); copy or export it again"),
        )
    }
}

pub(super) fn decoder(path: &Path) -> Result<(TiffDecoder, u64)> {
    let (file, bytes) = open_file(path)?;
    let mut limits = Limits::default();
    limits.decoding_buffer_size = usize::try_from(bytes.saturating_mul(MAX_COMPRESSION_RATIO))
        .unwrap_or(usize::MAX)
        .min(1 << 36);
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    limits.ifd_value_size = usize::try_from(bytes).unwrap_or(usize::MAX).min(1 << 28);
    let decoder = Decoder::new(BufReader::new(file))
        .map_err(damaged(path))?
        .with_limits(limits);
    Ok((decoder, bytes))
}

/// The first page only.
pub(in crate::volume::load) fn first_page(path: &Path) -> Result<ImageSlice> {
    let ended = || Error::file(path, "its pixels are damaged; copy or export it again");
    catch_panic(|| {
        let mut pages = decoder(path)?.0;
        if pages.more_images() {
            return Err(Error::file(
                path,
                "has several pages and is one of several files; name one file, or give each a single page",
            ));
        }
        page(path, &mut pages)
    })
    .ok_or_else(ended)?
}

/// The page at the decoder's position.
fn page(path: &Path, decoder: &mut TiffDecoder) -> Result<ImageSlice> {
    let fail = |problem: String| Error::file(path, problem);
    let (width, height) = decoder.dimensions().map_err(damaged(path))?;
    let components = match decoder.colortype().map_err(damaged(path))? {
        ColorType::Gray(_) => 1,
        ColorType::GrayA(_) => 2,
        ColorType::RGB(_) => 3,
        ColorType::RGBA(_) => 4,
        ColorType::Multiband { num_samples, .. } => usize::from(num_samples),
        other => {
            return Err(fail(format!(
                "holds colours as {other:?}; convert it to grey or RGB"
            )));
        }
    };
    if components > 1
        && decoder
            .find_tag_unsigned::<u16>(Tag::PlanarConfiguration)
            .ok()
            .flatten()
            == Some(2)
    {
        return Err(fail(
            "keeps its colours in separate planes; convert it to interleaved ones".into(),
        ));
    }
    let values: StoredValues = match decoder.read_image().map_err(damaged(path))? {
        DecodingResult::U8(v) => v.into(),
        DecodingResult::U16(v) => v.into(),
        DecodingResult::U32(v) => v.into(),
        DecodingResult::U64(v) => v.into(),
        DecodingResult::I8(v) => v.into(),
        DecodingResult::I16(v) => v.into(),
        DecodingResult::I32(v) => v.into(),
        DecodingResult::I64(v) => v.into(),
        DecodingResult::F16(v) => v.into_iter().map(f32::from).collect::<Vec<f32>>().into(),
        DecodingResult::F32(v) => v.into(),
        DecodingResult::F64(v) => v.into(),
    };
    let size = [width as usize, height as usize];
    if values.len() != size[0] * size[1] * components {
        return Err(fail(format!(
            "has a page of {width} x {height} pixels of which {} values were read; it is damaged",
            values.len()
        )));
    }
    Ok(ImageSlice {
        size,
        components,
        values,
    })
}

/// The distribution of pages over slices, channels and times, and the time to read.
pub(super) struct Dimensions {
    /// Slices, channels, times.
    pub extents: [usize; 3],
    /// Which of these varies fastest, then next.
    pub order: [usize; 3],
    pub time: usize,
}

impl Dimensions {
    /// The pages of the time to read, channel after channel.
    fn pages(&self) -> Vec<usize> {
        let [slices, channels, _] = self.extents;
        (0..channels)
            .flat_map(|c| (0..slices).map(move |s| (s, c)))
            .map(|(s, c)| self.page(s, c))
            .collect()
    }

    /// Index of a page.
    fn page(&self, slice: usize, channel: usize) -> usize {
        let (at, extents) = ([slice, channel, self.time], self.extents);
        let [a, b, c] = self.order;
        at[a] + extents[a] * (at[b] + extents[b] * at[c])
    }
}

/// Values of one volume.
pub(super) struct Pixels {
    pub voxels: StoredValues,
    pub size: [usize; 3],
    pub components: usize,
    pub layout: Layout,
}

/// A file whose pages are being read.
pub(super) struct Pages<'a> {
    pub path: &'a Path,
    pub decoder: TiffDecoder,
    pub file_bytes: u64,
    pub watch: &'a Watch<'a>,
}

impl Pages<'_> {
    /// Number of pages; leaves the decoder at the first one.
    pub fn count(&mut self) -> Result<usize> {
        let mut more = 0;
        // Follows the directories without reading their pixels.
        while self.decoder.more_images() && more < MAX_PAGES {
            self.decoder.next_image().map_err(damaged(self.path))?;
            more += 1;
        }
        self.decoder.seek_to_image(0).map_err(damaged(self.path))?;
        Ok(1 + more)
    }

    /// Reads slices and channels with one page each.
    pub fn read_each(&mut self, dimensions: &Dimensions, warnings: &mut Vec<String>) -> Result<Pixels> {
        let path = self.path;
        let fail = |problem: &str| Error::file(path, problem);
        let channels = dimensions.extents[1];
        let (stack, left_out) = self.stacked(&dimensions.pages())?;
        if left_out > 0 && channels > 1 {
            return Err(fail(
                "has channels with different page sizes; export it with a single size",
            ));
        }
        if left_out > 0 {
            warnings.push(format!(
                "{left_out} pages differ in size or type from the first and were skipped"
            ));
        }
        let (size, samples, count) = (stack.size, stack.components, stack.count);
        if samples > 1 && channels > 1 {
            return Err(fail("holds both channels and colours; split them"));
        }
        let voxels = stack.finish().ok_or_else(|| fail("holds no page"))?;
        let layout = if samples > 1 {
            Layout::Interleaved
        } else {
            Layout::Planar
        };
        Ok(Pixels {
            voxels,
            size: [size[0], size[1], count / channels],
            components: samples * channels,
            layout,
        })
    }

    /// Pages combined into one array, and the number of omitted pages that differ from the first
    /// one.
    fn stacked(&mut self, wanted: &[usize]) -> Result<(ImageStack, usize)> {
        let path = self.path;
        let mut stack = ImageStack::default();
        let meter = ByteProgress::new(self.watch, wanted.len() as u64);
        let mut left_out = 0usize;
        for &index in wanted {
            self.decoder.seek_to_image(index).map_err(damaged(path))?;
            let (width, height) = self.decoder.dimensions().map_err(damaged(path))?;
            if stack.count == 0 {
                check_held(
                    path,
                    (u64::from(width) * u64::from(height)).saturating_mul(wanted.len() as u64),
                    self.file_bytes.saturating_mul(MAX_COMPRESSION_RATIO),
                )?;
            } else if (width, height) != (stack.size[0] as u32, stack.size[1] as u32) {
                left_out += 1;
                continue;
            }
            left_out += usize::from(!stack.push(page(path, &mut self.decoder)?, wanted.len()));
            meter.add(1)?;
        }
        Ok((stack, left_out))
    }

    /// Consecutive slices after a single directory, as in large files of ImageJ.
    pub fn read_contiguous(&mut self, dimensions: &Dimensions) -> Result<Pixels> {
        let path = self.path;
        let [slices, channels, _] = dimensions.extents;
        let (width, height) = self.decoder.dimensions().map_err(damaged(path))?;
        let (scalar, first) = self.contiguous_values(dimensions)?;
        let big = self.decoder.byte_order() == tiff::tags::ByteOrder::BigEndian;
        // Channels vary fastest.
        let one_time = count(path, &[width as usize, height as usize, slices, channels], scalar)?;
        let bytes = (one_time * scalar.bytes()) as u64;
        let ahead = bytes.saturating_mul(dimensions.time as u64);
        check_held(
            path,
            first.saturating_add(ahead).saturating_add(bytes),
            self.file_bytes,
        )?;
        let mut reader = BufReader::new(open_file(path)?.0);
        reader
            .seek(SeekFrom::Start(first))
            .map_err(|e| Error::io(path, "reading", e))?;
        skip(path, &mut reader, ahead)?;
        let swap = big != cfg!(target_endian = "big");
        let voxels = ValueReader {
            path,
            reader,
            swap,
            count: one_time,
            watch: self.watch,
        }
        .read_as(scalar)?;
        let (width, height) = (width as usize, height as usize);
        let voxels = if channels == 1 {
            voxels
        } else {
            // From slices of channels to channels of slices.
            voxels
                .reshaped((slices, channels, width * height))
                .permuted(Ix3(1, 0, 2))
                .reshaped(one_time)
        };
        Ok(Pixels {
            voxels,
            size: [width, height, slices],
            components: channels,
            layout: Layout::Planar,
        })
    }

    /// Type of the values after a single directory, and the offset of the first one.
    fn contiguous_values(&mut self, dimensions: &Dimensions) -> Result<(ScalarType, u64)> {
        let path = self.path;
        let fail = |problem: &str| Error::file(path, problem);
        let [_, channels, times] = dimensions.extents;
        let color = self.decoder.colortype().map_err(damaged(path))?;
        let scalar = match (
            color,
            self.decoder
                .find_tag_unsigned::<u16>(Tag::SampleFormat)
                .ok()
                .flatten(),
        ) {
            (ColorType::Gray(8), _) => ScalarType::U8,
            (ColorType::Gray(16), Some(2)) => ScalarType::I16,
            (ColorType::Gray(16), _) => ScalarType::U16,
            (ColorType::Gray(32), Some(3)) => ScalarType::F32,
            (ColorType::Gray(32), _) => ScalarType::U32,
            _ => {
                return Err(fail(
                    "has slices behind a single directory that are not grey; export it again",
                ));
            }
        };
        if self
            .decoder
            .find_tag_unsigned::<u16>(Tag::Compression)
            .ok()
            .flatten()
            .is_some_and(|c| c != 1)
            || channels > 1 && times > 1
        {
            return Err(fail(
                "has packed slices behind a single directory; export it again",
            ));
        }
        let first = self
            .decoder
            .find_tag_unsigned_vec::<u64>(Tag::StripOffsets)
            .ok()
            .flatten()
            .and_then(|o| o.first().copied());
        Ok((
            scalar,
            first.ok_or_else(|| fail("does not say where its pixels are"))?,
        ))
    }
}
