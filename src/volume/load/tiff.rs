//! TIFF and BigTIFF: pages are slices, or slices, channels and times if OME-XML or ImageJ metadata
//! declare them.
//!
//! Source: OME-TIFF specification 6 (PhysicalSize, DimensionOrder); ImageJ's own description
//! (`images=`, `slices=`, `spacing=`, `unit=`). ImageJ files of more than 4 GiB have a single
//! directory, followed by all slices.

use super::ScalarType;
use super::image::{Channel, Image, Layout, Meaning};
use super::planes::{ImageSlice, ImageStack};
use super::source::{ValueReader, check_held, count, open_file, skip};
use super::{ReadOptions, StoredValues};
use crate::panic_guard::catch_panic;
use crate::{ByteProgress, Error, Result, Watch};
use glam::{DAffine3, DVec3};
use ndarray::Ix3;
use quick_xml::events::Event;
use serde_json::json;
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

/// Whether a file has the extension of a TIFF.
pub fn is_tiff(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff"))
}

/// A description of the pages.
#[derive(Debug, Default, PartialEq)]
struct Description {
    /// Slices, channels, times.
    extents: Option<[usize; 3]>,
    /// Which of slices (0), channels (1) and times (2) varies fastest, then next.
    order: [usize; 3],
    /// mm, along x, y, z.
    spacing: [Option<f64>; 3],
    colors: Vec<Option<[u8; 3]>>,
    imagej: bool,
    has_unit: bool,
    ome: bool,
}

type TiffDecoder = Decoder<BufReader<File>>;

fn damaged(path: &Path) -> impl Fn(tiff::TiffError) -> Error + '_ {
    move |e| {
        Error::file(
            path,
            format!("is not a readable TIFF ({e}); copy or export it again"),
        )
    }
}

fn decoder(path: &Path) -> Result<(TiffDecoder, u64)> {
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
pub(super) fn first_page(path: &Path) -> Result<ImageSlice> {
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

/// The description in the first page, which applies to all.
fn described(pages: &mut TiffDecoder, file_bytes: u64) -> Description {
    // The decoder writes to the terminal if a description is longer than the file.
    let described = pages
        .image_ifd()
        .find_entry(Tag::ImageDescription)
        .is_some_and(|e| e.count() <= file_bytes);
    let text = described
        .then(|| pages.find_tag(Tag::ImageDescription))
        .and_then(Result::ok)
        .flatten()
        .and_then(|v| v.into_string().ok())
        .unwrap_or_default();
    let mut metadata = if text.contains("<OME") {
        ome(&text)
    } else {
        imagej(&text)
    };
    let resolution = |pages: &mut TiffDecoder, tag| -> Option<f64> {
        let per_unit = match pages.find_tag(tag).ok()?? {
            tiff::decoder::ifd::Value::Rational(a, b) => f64::from(a) / f64::from(b),
            other => f64::from(other.into_f32().ok()?),
        };
        (per_unit.is_finite() && per_unit > 0.0).then(|| 1.0 / per_unit)
    };
    if metadata.imagej {
        let unit = unit_of_imagej(&text);
        metadata.has_unit = unit.is_some();
        let mm = unit.unwrap_or(1.0);
        // In the unit given by the description; the tag's own unit is "none".
        metadata.spacing[0] = resolution(pages, Tag::XResolution).map(|s| s * mm);
        metadata.spacing[1] = resolution(pages, Tag::YResolution).map(|s| s * mm);
        metadata.spacing[2] = metadata.spacing[2].map(|s| s * mm);
    }
    metadata
}

/// The spacing stated by a file, mm along x, y, z.
pub(super) fn spacing(path: &Path) -> Option<[Option<f64>; 3]> {
    catch_panic(|| {
        decoder(path)
            .ok()
            .map(|(mut pages, bytes)| described(&mut pages, bytes).spacing)
    })?
}

/// Reads all pages.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let ended = || Error::file(path, "its pages are damaged; copy or export it again");
    catch_panic(|| read_unguarded(path, choice, watch)).ok_or_else(ended)?
}

/// Reads all pages; [`read`] turns a panic of the decoder into an error.
fn read_unguarded(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let (mut decoder, file_bytes) = decoder(path)?;
    let metadata = described(&mut decoder, file_bytes);
    let mut pages = Pages {
        path,
        decoder,
        file_bytes,
        watch,
    };
    let mut warnings = Vec::new();
    if metadata.imagej && !metadata.has_unit && metadata.spacing.iter().any(Option::is_some) {
        warnings.push("states its spacing without a unit; mm is assumed".into());
    }
    let total = pages.count()?;
    let [slices, channels, times] = metadata.extents_of(total, &mut warnings);
    let time = choice.time_of(times)?;
    if times > 1 && choice.time.is_none() {
        warnings.push(format!(
            "holds {times} volumes; the first is used (--time chooses another)"
        ));
    }
    let dimensions = Dimensions {
        extents: [slices, channels, times],
        order: metadata.order,
        time,
    };
    let pixels = if total == 1 && slices * channels * times > 1 {
        pages.read_contiguous(&dimensions)?
    } else {
        pages.read_each(&dimensions, &mut warnings)?
    };
    let spacing = metadata.spacing.map(|s| s.filter(|s| s.is_finite() && *s > 0.0));
    if choice.spacing.is_none() && spacing.iter().any(Option::is_none) {
        warnings.push("does not state voxel spacing in every direction; 1 mm is assumed where it is missing (use --spacing to set it)".into());
    }
    let world_from_voxel = DAffine3::from_scale(DVec3::from(spacing.map(|s| s.unwrap_or(1.0))));
    let mut image = Image::new(metadata.format(), pixels.voxels, pixels.size, world_from_voxel);
    (image.components, image.layout, image.warnings) = (pixels.components, pixels.layout, warnings);
    image.meaning = metadata.meaning(channels, pixels.components);
    if times > 1 {
        image.details.push(("time_points", json!(times)));
    }
    Ok(image)
}

impl Description {
    /// Slices, channels and times of `total` pages: the declared ones if they fit, else slices
    /// only.
    fn extents_of(&self, total: usize, warnings: &mut Vec<String>) -> [usize; 3] {
        match self.extents {
            Some(e)
                if e.iter().try_fold(1usize, |n, &d| n.checked_mul(d)) == Some(total)
                    || (self.imagej && total == 1) =>
            {
                e
            }
            Some(e) => {
                warnings.push(format!(
                    "contains {total} pages, not the {} x {} x {} it declares; they are read as slices",
                    e[0], e[1], e[2]
                ));
                [total, 1, 1]
            }
            None => [total, 1, 1],
        }
    }

    /// Name of the format.
    fn format(&self) -> &'static str {
        if self.ome {
            "OME-TIFF"
        } else if self.imagej {
            "ImageJ TIFF"
        } else {
            "TIFF"
        }
    }

    /// The meaning of the values with these channels and components.
    fn meaning(&self, channels: usize, components: usize) -> Meaning {
        if channels > 1 {
            let color = |c: usize| {
                self.colors
                    .get(c)
                    .copied()
                    .flatten()
                    .unwrap_or(super::super::colors::CHANNELS[c % 4])
            };
            Meaning::Channels(
                (0..channels)
                    .map(|c| Channel {
                        color: color(c),
                        window: None,
                    })
                    .collect(),
            )
        } else if components > 2 {
            Meaning::Color
        } else {
            Meaning::Unstated
        }
    }
}

/// The distribution of pages over slices, channels and times, and the time to read.
struct Dimensions {
    /// Slices, channels, times.
    extents: [usize; 3],
    /// Which of these varies fastest, then next.
    order: [usize; 3],
    time: usize,
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
struct Pixels {
    voxels: StoredValues,
    size: [usize; 3],
    components: usize,
    layout: Layout,
}

/// A file whose pages are being read.
struct Pages<'a> {
    path: &'a Path,
    decoder: TiffDecoder,
    file_bytes: u64,
    watch: &'a Watch<'a>,
}

impl Pages<'_> {
    /// Number of pages; leaves the decoder at the first one.
    fn count(&mut self) -> Result<usize> {
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
    fn read_each(&mut self, dimensions: &Dimensions, warnings: &mut Vec<String>) -> Result<Pixels> {
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
    fn read_contiguous(&mut self, dimensions: &Dimensions) -> Result<Pixels> {
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

/// ImageJ's description: `name=value` lines.
fn imagej(text: &str) -> Description {
    let mut metadata = Description {
        order: [1, 0, 2],
        ..Description::default()
    };
    if !text.starts_with("ImageJ=") {
        return metadata;
    }
    metadata.imagej = true;
    let get = |name: &str| {
        text.lines()
            .find_map(|l| l.strip_prefix(name)?.strip_prefix('=').map(str::trim))
    };
    let whole = |name: &str| get(name).and_then(|v| v.parse::<usize>().ok()).filter(|n| *n > 0);
    let images = whole("images").unwrap_or(1);
    let (channels, times) = (whole("channels").unwrap_or(1), whole("frames").unwrap_or(1));
    let slices = whole("slices").or_else(|| {
        images
            .checked_div(channels.saturating_mul(times))
            .filter(|n| *n > 0)
    });
    metadata.extents = slices.map(|s| [s, channels, times]);
    metadata.spacing[2] = get("spacing").and_then(|v| v.parse().ok()).map(f64::abs);
    metadata
}

/// Millimetres per unit of ImageJ's description; none for pixels.
fn unit_of_imagej(text: &str) -> Option<f64> {
    let unit = text
        .lines()
        .find_map(|l| l.strip_prefix("unit="))
        .map(str::trim)
        .unwrap_or("");
    mm_of(if unit == "\\u00B5m" { "um" } else { unit })
}

/// Millimetres per unit of length.
pub(super) fn mm_of(unit: &str) -> Option<f64> {
    Some(match unit.to_lowercase().as_str() {
        "m" | "meter" | "metre" => 1000.0,
        "cm" | "centimeter" | "centimetre" => 10.0,
        "mm" | "millimeter" | "millimetre" => 1.0,
        "um" | "µm" | "μm" | "micron" | "microns" | "micrometer" | "micrometre" => 1e-3,
        "nm" | "nanometer" | "nanometre" => 1e-6,
        "angstrom" | "å" => 1e-7,
        "inch" | "in" => 25.4,
        _ => return None,
    })
}

/// The first image of OME-XML.
fn ome(text: &str) -> Description {
    let mut metadata = Description {
        ome: true,
        ..Description::default()
    };
    let mut xml = quick_xml::Reader::from_str(text.trim_end_matches('\0'));
    xml.config_mut().check_end_names = false;
    let mut seen = false;
    loop {
        let event = match xml.read_event() {
            Ok(Event::Start(tag) | Event::Empty(tag)) => tag,
            Ok(Event::End(tag)) if tag.local_name().as_ref() == "Pixels" => break,
            Ok(Event::Eof) | Err(_) => break,
            Ok(_) => continue,
        };
        let get = |name: &str| {
            event
                .attributes()
                .flatten()
                .find(|a| a.key.as_ref() == name)
                .map(|a| a.value.into_owned())
        };
        match event.local_name().as_ref() {
            "Pixels" if !seen => {
                seen = true;
                let extent = |name: &str| get(name).and_then(|v| v.parse::<usize>().ok()).filter(|n| *n > 0);
                metadata.extents = extent("SizeZ")
                    .zip(extent("SizeC"))
                    .zip(extent("SizeT"))
                    .map(|((z, c), t)| [z, c, t]);
                let order = get("DimensionOrder").unwrap_or_else(|| "XYZCT".into());
                let axes: Vec<usize> = order.chars().filter_map(|c| "ZCT".find(c)).collect();
                metadata.order = axes
                    .try_into()
                    .ok()
                    .filter(|[a, b, c]: &[usize; 3]| a != b && b != c && a != c)
                    .unwrap_or([0, 1, 2]);
                for (n, axis) in ["X", "Y", "Z"].into_iter().enumerate() {
                    let unit = get(&format!("PhysicalSize{axis}Unit")).map_or(Some(1e-3), |u| mm_of(&u));
                    metadata.spacing[n] = get(&format!("PhysicalSize{axis}"))
                        .and_then(|v| v.parse::<f64>().ok())
                        .zip(unit)
                        .map(|(v, mm)| v * mm);
                }
            }
            "Channel" => {
                // Red, green, blue, alpha as one signed number.
                let color = get("Color")
                    .and_then(|v| v.parse::<i32>().ok())
                    .map(|v| v.to_be_bytes());
                metadata
                    .colors
                    .push(color.map(|[r, g, b, _]| [r, g, b]).filter(|c| *c != [255; 3]));
                // A channel may have several samples, which are then stored together in a page.
                if get("SamplesPerPixel")
                    .and_then(|v| v.parse::<usize>().ok())
                    .is_some_and(|n| n > 1)
                    && let Some(extents) = &mut metadata.extents
                {
                    extents[1] = 1;
                }
            }
            _ => {}
        }
    }
    metadata
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptions() {
        let metadata =
            imagej("ImageJ=1.53t\nimages=12\nchannels=2\nslices=3\nframes=2\nunit=micron\nspacing=2.5\n");
        assert_eq!(
            (metadata.extents, metadata.spacing[2], metadata.order),
            (Some([3, 2, 2]), Some(2.5), [1, 0, 2])
        );
        assert_eq!(unit_of_imagej("unit=\\u00B5m\n"), Some(1e-3));
        let metadata = ome(
            r#"<?xml version="1.0"?><OME xmlns="x"><Image><Pixels DimensionOrder="XYCZT" SizeX="4" SizeY="5" SizeZ="6" SizeC="2" SizeT="1"
            PhysicalSizeX="0.5" PhysicalSizeY="0.5" PhysicalSizeZ="2" PhysicalSizeZUnit="mm"><Channel Color="-16776961"/><Channel/></Pixels></Image></OME>"#,
        );
        assert_eq!((metadata.extents, metadata.order), (Some([6, 2, 1]), [1, 0, 2]));
        assert_eq!(metadata.spacing, [Some(0.0005), Some(0.0005), Some(2.0)]);
        assert_eq!(metadata.colors, [Some([255, 0, 0]), None]);
    }
}
