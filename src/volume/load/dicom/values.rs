//! The values of a volume: its frames decoded into one array.

use super::super::StoredValues;
use super::super::source::zeroed;
use super::frames::{Frame, PixelFormat};
use super::pixels::{self, Pixel, decode};
use super::scan::{Object, SegmentsAs};
use crate::{ByteProgress, Error, Result, Watch};
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

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
    /// Slice of each frame of a segmentation.
    pub slot: &'a [usize],
    /// Number of values in the whole volume.
    pub total: usize,
    pub watch: &'a Watch<'a>,
}

impl DecodeJob<'_> {
    /// The first frame's object.
    fn object(&self) -> &Object {
        &self.objects[self.frames[0].object]
    }

    fn format(&self) -> &PixelFormat {
        &self.object().format
    }

    /// Whether all frames have the same rescale slope and intercept.
    pub fn has_one_rescale(&self) -> bool {
        self.frames.iter().all(|f| f.rescale == self.frames[0].rescale)
    }

    /// All values, and their number per voxel: labels, scalars, or red, green and blue.
    pub fn values(&self, warnings: &mut Vec<String>) -> Result<(StoredValues, usize)> {
        let format = self.format();
        if self.object().segmentation {
            return Ok((self.labels(warnings)?, 1));
        }
        if format.samples != 1 || format.photometric == "PALETTE COLOR" {
            return Ok((self.colors()?.into(), 3));
        }
        let values: StoredValues = match (format.float, format.allocated, format.signed) {
            _ if !self.has_one_rescale() => {
                warnings.push("its slices have different rescale slopes or intercepts; values are stored as 32-bit floats".into());
                self.scaled()?
            }
            (true, 32, _) => self.stored::<f32>()?.into(),
            (true, _, _) => self.stored::<f64>()?.into(),
            (_, 1 | 8, false) => self.stored::<u8>()?.into(),
            (_, 8, true) => self.stored::<i8>()?.into(),
            (_, 16, false) => self.stored::<u16>()?.into(),
            (_, 16, true) => self.stored::<i16>()?.into(),
            (_, _, false) => self.stored::<u32>()?.into(),
            (_, _, true) => self.stored::<i32>()?.into(),
        };
        Ok((values, 1))
    }

    /// Decodes every frame into its slice.
    fn run<T: Pixel>(&self, convert: &(dyn Fn(&Frame, T) -> T + Sync)) -> Result<Vec<T>> {
        let mut values: Vec<T> = zeroed(self.path, self.total)?;
        let plane = self.format().values();
        let meter = ByteProgress::new(self.watch, (self.frames.len() * plane * size_of::<T>()) as u64);
        // The frames and output of each object.
        let mut jobs: HashMap<usize, Vec<(&Frame, &mut [T])>> = HashMap::new();
        for (frame, out) in self.frames.iter().zip(values.chunks_mut(plane)) {
            jobs.entry(frame.object).or_default().push((frame, out));
        }
        jobs.into_iter()
            .collect::<Vec<_>>()
            .into_par_iter()
            .try_for_each(|(index, frames)| -> Result<()> {
                let object = &self.objects[index];
                let pixels = pixels::read(object)?;
                frames.into_par_iter().try_for_each(|(frame, out)| {
                    decode(object, &pixels, frame, out, &|v| convert(frame, v))?;
                    meter.add(size_of_val(out) as u64)
                })
            })?;
        Ok(values)
    }

    fn stored<T: Pixel>(&self) -> Result<Vec<T>> {
        self.run::<T>(&|_, v| v)
    }

    /// Data values, where frames have different rescales.
    fn scaled(&self) -> Result<StoredValues> {
        let value = |frame: &Frame, v: f32| {
            let nothing = self.objects[frame.object]
                .padding
                .is_some_and(|[low, high]| (low..=high).contains(&f64::from(v)));
            if nothing {
                f32::NAN
            } else {
                (f64::from(v) * frame.rescale.slope + frame.rescale.intercept) as f32
            }
        };
        Ok(self.run::<f32>(&value)?.into())
    }

    /// Red, green and blue with 8 bits each.
    fn colors(&self) -> Result<Vec<u8>> {
        let format = self.format();
        let object = self.object();
        if format.photometric == "PALETTE COLOR" {
            let tables = object.palette.as_ref().ok_or_else(|| {
                Error::file(
                    self.path,
                    "uses palette colour but contains no palette; export it again",
                )
            })?;
            let indices = self.run::<u16>(&|_, v| v)?;
            return Ok(indices
                .into_par_iter()
                .flat_map_iter(|v| {
                    tables.iter().map(move |(first, table)| {
                        table[(i64::from(v) - first).clamp(0, table.len() as i64 - 1) as usize]
                    })
                })
                .collect());
        }
        if format.samples != 3 || format.allocated != 8 {
            let (samples, bits) = (format.samples, format.allocated);
            return Err(Error::file(
                self.path,
                format!(
                    "has {samples} samples of {bits} bits per pixel; only 3 samples of 8 bits are supported"
                ),
            ));
        }
        if format.photometric.starts_with("YBR_FULL_422") && self.uncompressed() {
            return Err(Error::file(
                self.path,
                "uses uncompressed chroma-subsampled colour (YBR_FULL_422); convert it to RGB",
            ));
        }
        let mut values = self.run::<u8>(&|_, v| v)?;
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

    fn uncompressed(&self) -> bool {
        matches!(
            self.object().syntax.as_str(),
            "1.2.840.10008.1.2" | "1.2.840.10008.1.2.1" | "1.2.840.10008.1.2.2" | "1.2.840.10008.1.2.1.99"
        )
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
                decode(object, &pixels, frame, &mut values, &|v| v)?;
                let out = &mut labels[self.slot[n] * plane..][..plane];
                for (label, &value) in out.iter_mut().zip(&values) {
                    // Pixels are labels themselves, or fractions of the frame's segment, with a
                    // threshold of one half.
                    match object.segments_as {
                        SegmentsAs::Labels => *label = value,
                        SegmentsAs::Shares(whole)
                            if value > 0 && 2 * u32::from(value) >= u32::from(whole) =>
                        {
                            overlaps += usize::from(*label != 0 && *label != frame.segment);
                            *label = frame.segment;
                        }
                        SegmentsAs::Shares(_) => {}
                    }
                }
                meter.add(plane as u64)?;
            }
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
