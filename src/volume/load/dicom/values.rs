//! The values of a volume: its frames decoded into one array.

use super::super::source::zeroed;
use super::super::{ScalarType, StoredValues};
use super::frame::{Frame, PixelFormat};
use super::object::{Object, SegmentsAs};
use super::palette::Palette;
use super::pixels::{self, Pixel, Pixels, decode};
use super::segments::SegmentLabels;
use super::syntax::{BIG_ENDIAN, DEFLATED, EXPLICIT, GE_BIG_ENDIAN_PIXELS, IMPLICIT};
use crate::{ByteProgress, Error, Result, Watch};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Compressed syntaxes whose decoders return colours as stored: RLE, lossless JPEG, JPEG-LS.
const AS_STORED: [&str; 5] = [
    "1.2.840.10008.1.2.5",
    "1.2.840.10008.1.2.4.57",
    "1.2.840.10008.1.2.4.70",
    "1.2.840.10008.1.2.4.80",
    "1.2.840.10008.1.2.4.81",
];

/// Frames to decode into one array.
pub struct DecodeJob<'a> {
    pub path: &'a Path,
    pub objects: &'a [Object],
    pub frames: &'a [Frame],
    /// Slice of each frame of a segmentation, and its labels.
    pub slot: &'a [usize],
    pub segments: &'a SegmentLabels,
    /// Number of values in the whole volume.
    pub total: usize,
    pub watch: &'a Watch<'a>,
    /// Slices that could not be read, and why.
    pub unread: Mutex<Vec<(usize, String)>>,
}

impl DecodeJob<'_> {
    /// The first frame's object.
    fn object(&self) -> &Object {
        &self.objects[self.frames[0].object]
    }

    fn format(&self) -> &PixelFormat {
        &self.object().format
    }

    /// Whether the same stored value means the same in all frames.
    pub fn has_one_scale(&self) -> bool {
        let padding = self.object().padding;
        self.frames.iter().all(|f| {
            let object = &self.objects[f.object];
            f.rescale == self.frames[0].rescale && object.padding == padding && object.value_table.is_none()
        })
    }

    /// All values, and their number per voxel: labels, scalars, or red, green and blue.
    pub fn values(&self, warnings: &mut Vec<String>) -> Result<(StoredValues, usize)> {
        let format = self.format();
        if self.object().segmentation {
            return Ok((self.labels(warnings)?, 1));
        }
        if format.samples != 1 || format.photometric == "PALETTE COLOR" {
            return Ok((self.colors(warnings)?.into(), 3));
        }
        if !self.has_one_scale() {
            warnings.push(if self.object().value_table.is_some() {
                "has a modality lookup table, which is applied; values are stored as 32-bit floats".into()
            } else {
                "its slices have different rescale slopes, intercepts or padding values; values are stored as 32-bit floats".into()
            });
            return Ok((self.scaled()?, 1));
        }
        let values: StoredValues = match self.scalar() {
            ScalarType::F32 => self.stored::<f32>()?.into(),
            ScalarType::U8 => self.stored::<u8>()?.into(),
            ScalarType::I8 => self.stored::<i8>()?.into(),
            ScalarType::U16 => self.stored::<u16>()?.into(),
            ScalarType::I16 => self.stored::<i16>()?.into(),
            ScalarType::U32 => self.stored::<u32>()?.into(),
            ScalarType::I32 => self.stored::<i32>()?.into(),
            _ => self.stored::<f64>()?.into(),
        };
        Ok((values, 1))
    }

    /// The type that holds the stored values of all frames, whose objects may differ.
    fn scalar(&self) -> ScalarType {
        let mut formats: Vec<&PixelFormat> = Vec::new();
        for frame in self.frames {
            let format = &self.objects[frame.object].format;
            if !formats.contains(&format) {
                formats.push(format);
            }
        }
        let first = formats[0];
        let like = |f: &&PixelFormat| {
            (f.allocated, f.signed, f.float) == (first.allocated, first.signed, first.float)
        };
        if formats.iter().all(like) {
            return match (first.float, first.allocated, first.signed) {
                (true, 32, _) => ScalarType::F32,
                (true, _, _) => ScalarType::F64,
                (_, 1 | 8, false) => ScalarType::U8,
                (_, 8, true) => ScalarType::I8,
                (_, 16, false) => ScalarType::U16,
                (_, 16, true) => ScalarType::I16,
                (_, _, false) => ScalarType::U32,
                (_, _, true) => ScalarType::I32,
            };
        }
        if formats.iter().any(|f| f.float) {
            return ScalarType::F64;
        }
        let bits = |signed: bool| {
            let of = formats.iter().filter(|f| f.signed == signed);
            of.map(|f| f.stored).max().unwrap_or(0)
        };
        match (bits(true), bits(false)) {
            (0, 0..=8) => ScalarType::U8,
            (0, 9..=16) => ScalarType::U16,
            (0, _) => ScalarType::U32,
            // An unsigned value needs one more bit beside signed ones.
            (a, b) => match a.max(b + 1) {
                0..=8 => ScalarType::I8,
                9..=16 => ScalarType::I16,
                17..=32 => ScalarType::I32,
                _ => ScalarType::F64,
            },
        }
    }

    /// Decodes every frame into its slice. Slices that cannot be read are filled with the lowest
    /// value, as long as most can be read.
    fn run<T: Pixel>(&self, convert: &(dyn Fn(&Frame, T) -> T + Sync)) -> Result<Vec<T>> {
        let mut values: Vec<T> = zeroed(self.path, self.total)?;
        let plane = self.object().plane_values();
        let meter = ByteProgress::new(self.watch, (self.frames.len() * plane * size_of::<T>()) as u64);
        // The frames and output of each object.
        let mut jobs: BTreeMap<usize, Vec<(&Frame, &mut [T])>> = BTreeMap::new();
        for (frame, out) in self.frames.iter().zip(values.chunks_mut(plane)) {
            jobs.entry(frame.object).or_default().push((frame, out));
        }
        let count = jobs.len();
        let mut failed: Vec<(usize, Error)> = jobs
            .into_par_iter()
            .map(
                |(index, frames)| match decode_object(&self.objects[index], frames, convert, &meter) {
                    Ok(()) => Ok(None),
                    Err(Error::Cancelled) => Err(Error::Cancelled),
                    Err(error) => Ok(Some((index, error))),
                },
            )
            .collect::<Result<Vec<_>>>()?
            .into_iter()
            .flatten()
            .collect();
        if 2 * failed.len() >= count && !failed.is_empty() {
            return Err(failed.swap_remove(0).1);
        }
        if !failed.is_empty() {
            self.fill(&mut values, plane, &failed);
        }
        Ok(values)
    }

    /// Fills the slices of objects that could not be read.
    fn fill<T: Pixel>(&self, values: &mut [T], plane: usize, failed: &[(usize, Error)]) {
        let failure = |frame: &Frame| failed.iter().find(|(index, _)| *index == frame.object);
        let good = self
            .frames
            .iter()
            .zip(values.chunks(plane))
            .filter(|(f, _)| failure(f).is_none());
        let lowest = good
            .flat_map(|(_, slice)| slice.iter().copied())
            .fold(None, |least: Option<T>, v| {
                Some(least.map_or(v, |l| if v < l { v } else { l }))
            })
            .unwrap_or_default();
        let fill = self.object().padding.map_or(lowest, |[low, _]| T::of_float(low));
        let mut unread = self.unread.lock().unwrap_or_else(PoisonError::into_inner);
        for (n, (frame, slice)) in self.frames.iter().zip(values.chunks_mut(plane)).enumerate() {
            if let Some((_, error)) = failure(frame) {
                slice.fill(fill);
                unread.push((n, error.to_string()));
            }
        }
    }

    fn stored<T: Pixel>(&self) -> Result<Vec<T>> {
        self.run::<T>(&|_, v| v)
    }

    /// Data values, where frames have different scales.
    fn scaled(&self) -> Result<StoredValues> {
        let value = |frame: &Frame, v: f32| {
            let object = &self.objects[frame.object];
            let nothing = object
                .padding
                .is_some_and(|[low, high]| (low..=high).contains(&f64::from(v)));
            if nothing {
                f32::NAN
            } else if let Some((first, entries)) = &object.value_table {
                // Values beyond the table take its first or last entry.
                let entry = (f64::from(v) - first).clamp(0.0, entries.len() as f64 - 1.0);
                entries[entry as usize] as f32
            } else {
                (f64::from(v) * frame.rescale.slope + frame.rescale.intercept) as f32
            }
        };
        Ok(self.run::<f32>(&value)?.into())
    }

    /// Red, green and blue with 8 bits each.
    fn colors(&self, warnings: &mut Vec<String>) -> Result<Vec<u8>> {
        let format = self.format();
        let object = self.object();
        if format.photometric == "PALETTE COLOR" {
            return self.palette_colors();
        }
        let (samples, bits) = (format.samples, format.allocated);
        if samples != 3 || !matches!(bits, 8 | 16) {
            return Err(Error::file(
                self.path,
                format!(
                    "has {samples} samples of {bits} bits per pixel; only 3 samples of 8 or 16 bits are supported"
                ),
            ));
        }
        let mut values = if bits == 8 {
            self.run::<u8>(&|_, v| v)?
        } else {
            let wide = self.run::<u16>(&|_, v| v)?;
            let shift = format.stored.saturating_sub(8);
            wide.into_par_iter()
                .map(|v| (v >> shift).min(255) as u8)
                .collect()
        };
        if let Some(held) = pixels::contradicting_color(object) {
            warnings.push(format!(
                "is labelled {} but its JPEG data declare {held}; its colours are read as {held}",
                format.photometric
            ));
        }
        // Decoders of JPEG and JPEG 2000 return RGB.
        if format.photometric.starts_with("YBR_FULL")
            && (self.uncompressed() || AS_STORED.contains(&object.syntax.as_str()))
        {
            values.par_chunks_exact_mut(3).for_each(|v| {
                let [y, b, r] = [f32::from(v[0]), f32::from(v[1]) - 128.0, f32::from(v[2]) - 128.0];
                let rgb = [y + 1.402 * r, y - 0.344_136 * b - 0.714_136 * r, y + 1.772 * b];
                v.copy_from_slice(&rgb.map(|c| (c + 0.5).clamp(0.0, 255.0) as u8));
            });
        }
        Ok(values)
    }

    /// Colours from the palette of each frame's object.
    fn palette_colors(&self) -> Result<Vec<u8>> {
        let tables: Vec<&Palette> = self
            .frames
            .iter()
            .map(|frame| {
                let object = &self.objects[frame.object];
                object.palette.as_ref().ok_or_else(|| {
                    Error::file(
                        object.source.path(),
                        "uses palette colour but contains no palette; export it again",
                    )
                })
            })
            .collect::<Result<_>>()?;
        let indices = self.run::<i32>(&|_, v| v)?;
        let mut colors = vec![0u8; 3 * indices.len()];
        let plane = self.object().plane_values();
        colors
            .par_chunks_mut(3 * plane)
            .zip(indices.par_chunks(plane))
            .zip(tables)
            .for_each(|((out, indices), tables)| {
                for (color, index) in out.chunks_exact_mut(3).zip(indices) {
                    for (byte, (first, table)) in color.iter_mut().zip(tables) {
                        *byte = table[i64::from(*index)
                            .saturating_sub(*first)
                            .clamp(0, table.len() as i64 - 1) as usize];
                    }
                }
            });
        Ok(colors)
    }

    fn uncompressed(&self) -> bool {
        [IMPLICIT, EXPLICIT, BIG_ENDIAN, DEFLATED, GE_BIG_ENDIAN_PIXELS]
            .contains(&self.object().syntax.as_str())
    }

    /// Segments as labels; where several overlap, the last one wins.
    fn labels(&self, warnings: &mut Vec<String>) -> Result<StoredValues> {
        let format = self.format();
        let plane = format.values();
        let mut labels: Vec<u16> = zeroed(self.path, self.total)?;
        let mut by_object: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (n, frame) in self.frames.iter().enumerate() {
            by_object.entry(frame.object).or_default().push(n);
        }
        let meter = ByteProgress::new(self.watch, (self.frames.len() * plane) as u64);
        let mut overlaps = 0usize;
        for (index, frames) in by_object {
            let object = &self.objects[index];
            let pixels = pixels::read(object)?;
            let mut values: Vec<u16> = zeroed(self.path, plane)?;
            for n in frames {
                let frame = &self.frames[n];
                decode(object, &pixels, frame.number, &mut values, &|v| v)?;
                let segment = self.segments.number(index, frame.segment);
                let out = &mut labels[self.slot[n] * plane..][..plane];
                for (label, &value) in out.iter_mut().zip(&values) {
                    // Pixels are labels themselves, or fractions of the frame's segment, with a
                    // threshold of one half.
                    match object.segments_as {
                        SegmentsAs::Labels => *label = self.segments.number(index, value),
                        SegmentsAs::Shares(whole)
                            if value > 0 && 2 * u32::from(value) >= u32::from(whole) =>
                        {
                            overlaps += usize::from(*label != 0 && *label != segment);
                            *label = segment;
                        }
                        SegmentsAs::Shares(_) => {}
                    }
                }
                meter.add(plane as u64)?;
            }
        }
        if matches!(self.object().segments_as, SegmentsAs::Shares(whole) if whole > 1) {
            warnings.push(
                "holds fractions of its segments; voxels of at least one half are shown as labels".into(),
            );
        }
        if overlaps > 0 {
            warnings.push(format!(
                "its segments overlap in {overlaps} voxels; the last segment is used there"
            ));
        }
        Ok(if labels.iter().all(|l| *l < 256) {
            labels.into_iter().map(|l| l as u8).collect::<Vec<u8>>().into()
        } else {
            labels.into()
        })
    }
}

/// Decodes the frames of one object.
fn decode_object<T: Pixel>(
    object: &Object,
    frames: Vec<(&Frame, &mut [T])>,
    convert: &(dyn Fn(&Frame, T) -> T + Sync),
    meter: &ByteProgress,
) -> Result<()> {
    pixels::check_syntax(object)?;
    pixels::check_held(object)?;
    let pixels = pixels::read(object)?;
    if object.tile.is_some() {
        return decode_tiles(object, &pixels, frames, convert, meter);
    }
    frames.into_par_iter().try_for_each(|(frame, out)| {
        decode(object, &pixels, frame.number, out, &|v| convert(frame, v))?;
        meter.add(size_of_val(out) as u64)
    })
}

/// Decodes the slices that are tiles of one picture.
fn decode_tiles<T: Pixel>(
    object: &Object,
    pixels: &Pixels,
    frames: Vec<(&Frame, &mut [T])>,
    convert: &(dyn Fn(&Frame, T) -> T + Sync),
    meter: &ByteProgress,
) -> Result<()> {
    let [columns, _] = object.plane();
    let across = usize::from(object.format.columns);
    let mut picture: Vec<T> = zeroed(object.source.path(), object.format.values())?;
    let mut decoded = None;
    for (frame, out) in frames {
        if decoded != Some(frame.number) {
            decode(object, pixels, frame.number, &mut picture, &|v| v)?;
            decoded = Some(frame.number);
        }
        let [left, top] = frame.tile.unwrap_or([0, 0]);
        for (row, line) in out.chunks_exact_mut(columns).enumerate() {
            let start = (top + row) * across + left;
            for (value, stored) in line.iter_mut().zip(&picture[start..start + columns]) {
                *value = convert(frame, *stored);
            }
        }
        meter.add(size_of_val(out) as u64)?;
    }
    Ok(())
}
