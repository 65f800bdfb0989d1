//! Pixels of DICOM objects: from their transfer syntax to typed values, each frame separately and
//! many at once.
//!
//! JPEG and JPEG 2000 are decoded here rather than by the registry's adapters, which accept an
//! image of another size than declared. For JPEG 2000 they also need OpenJPEG, in C or translated
//! from it, whereas `hayro-jpeg2000` is safe Rust. RLE and (as an option) JPEG-LS are left to the
//! registry.

use super::super::source::{RawScalar, read_error};
use super::dataset::{one_line, open, whole};
use super::frames::{Frame, PixelFormat};
use super::scan::Object;
use super::syntax::{JPEG, JPEG_2000, max_compression_ratio, syntax_name};
use crate::panic_guard::catch_panic;
use crate::{Error, Result};
use dicom_core::header::HasLength;
use dicom_core::{Length, Tag};
use dicom_dictionary_std::tags;
use dicom_encoding::adapters::{PixelDataObject, RawPixelData};
use dicom_encoding::transfer_syntax::{Codec, Endianness, TransferSyntaxIndex};
use dicom_parser::StatefulDecode;
use dicom_parser::dataset::LazyDataToken;
use dicom_transfer_syntax_registry::TransferSyntaxRegistry;
use jpeg_decoder::{ColorTransform, PixelFormat as JpegFormat};
use std::borrow::Cow;
use std::io::ErrorKind;
use std::path::Path;

/// The pixel bytes of an object.
pub enum Pixels {
    /// Uncompressed, and whether the most significant byte comes first.
    Native(Vec<u8>, bool),
    /// Compressed, frame by frame.
    Packed(Vec<Vec<u8>>),
}

/// Rejects transfer syntaxes that cannot be decoded, by name.
pub fn check_syntax(object: &Object) -> Result<()> {
    let uid = object.syntax.as_str();
    let name = syntax_name(uid);
    let fail = |problem: String| Error::file(object.source.path(), problem);
    let native = matches!(
        TransferSyntaxRegistry.get(uid).map(|s| s.codec()),
        Some(Codec::None | Codec::Dataset(_))
    );
    if object.format.allocated == 1 && !native {
        return Err(fail(format!(
            "holds packed single bits ({name}), which cannot be decoded; convert it to Explicit VR Little Endian"
        )));
    }
    if JPEG.contains(&uid) || JPEG_2000.contains(&uid) {
        return Ok(());
    }
    match TransferSyntaxRegistry.get(uid).map(|s| s.codec()) {
        None => Err(fail(format!(
            "is in the transfer syntax {name}, which is not known; convert it to Explicit VR Little Endian"
        ))),
        Some(Codec::None | Codec::Dataset(_) | Codec::EncapsulatedPixelData(Some(_), _)) => Ok(()),
        Some(_) if name.contains("JPEG-LS") => Err(fail(format!(
            "is in the transfer syntax {name}, which this build cannot decode; build it with the feature jpeg-ls, or convert the file to Explicit VR Little Endian"
        ))),
        Some(_) => Err(fail(format!(
            "is in the transfer syntax {name}, which cannot be decoded; convert it to Explicit VR Little Endian"
        ))),
    }
}

/// Whether the pixels of an object are compressed.
fn is_compressed(object: &Object) -> bool {
    let uid = object.syntax.as_str();
    JPEG.contains(&uid)
        || JPEG_2000.contains(&uid)
        || matches!(
            TransferSyntaxRegistry.get(uid).map(|s| s.codec()),
            Some(Codec::EncapsulatedPixelData(..))
        )
}

/// The pixel data element of an object.
#[derive(Default)]
struct PixelElement {
    /// Offsets of compressed frames; none before the first item has been read.
    table: Option<Vec<u32>>,
    /// The bytes in order; a single fragment if they are uncompressed.
    fragments: Vec<Vec<u8>>,
}

impl PixelElement {
    /// Adds the value of an item: the first one holds the offsets of frames.
    fn add(&mut self, bytes: Vec<u8>) {
        match self.table {
            None => {
                self.table = Some(
                    bytes
                        .chunks_exact(4)
                        .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                        .collect(),
                )
            }
            Some(_) => self.fragments.push(bytes),
        }
    }
}

/// Reads the pixel data element of an object; `most` limits the unpacked size of a deflated one.
fn pixel_element(object: &Object, most: u64, compressed: bool) -> Result<PixelElement> {
    let path = object.source.path();
    let damaged = |e: String| damaged(path, &e);
    let (mut tokens, end) = open(&object.source, most)?
        .tokens()
        .map_err(|e| damaged(e.to_string()))?;
    let (mut element, mut in_pixels) = (PixelElement::default(), false);
    let mut depth = 0usize;
    while let Some(token) = tokens.advance() {
        // Data after the pixels may be truncated.
        let token = match token {
            Ok(token) => token,
            Err(_) if !element.fragments.is_empty() && !compressed => break,
            Err(e) => return Err(damaged(one_line(&e))),
        };
        let here = |len: u32, at: u64| {
            if u64::from(len) > end.saturating_sub(at) {
                Err(read_error(path, ErrorKind::UnexpectedEof.into()))
            } else {
                Ok(())
            }
        };
        match token {
            // Pixels in a sequence belong to an icon.
            LazyDataToken::PixelSequenceStart if depth == 0 => in_pixels = true,
            LazyDataToken::SequenceStart { .. } | LazyDataToken::PixelSequenceStart => depth += 1,
            LazyDataToken::SequenceEnd if in_pixels => break,
            LazyDataToken::SequenceEnd => depth = depth.saturating_sub(1),
            LazyDataToken::LazyValue { header, decoder } => {
                let len = header.length().0;
                here(len, decoder.position())?;
                if header.tag == tags::PIXEL_DATA && depth == 0 {
                    let mut bytes = Vec::new();
                    decoder
                        .read_to_vec(len, &mut bytes)
                        .map_err(|e| damaged(one_line(&e)))?;
                    element.fragments.push(bytes);
                    break;
                }
                decoder.skip_bytes(len).map_err(|e| damaged(one_line(&e)))?;
            }
            LazyDataToken::LazyItemValue { len, decoder } => {
                here(len, decoder.position())?;
                if !in_pixels {
                    decoder.skip_bytes(len).map_err(|e| damaged(one_line(&e)))?;
                    continue;
                }
                let mut bytes = Vec::new();
                decoder
                    .read_to_vec(len, &mut bytes)
                    .map_err(|e| damaged(one_line(&e)))?;
                element.add(bytes);
            }
            // An item without a value.
            LazyDataToken::ItemStart { len: Length(0) } if in_pixels => element.add(Vec::new()),
            _ => {}
        }
    }
    Ok(element)
}

fn damaged(path: &Path, problem: &str) -> Error {
    Error::file(
        path,
        format!("its pixels cannot be read ({problem}); copy or export it again"),
    )
}

/// Reads the pixels of an object.
pub fn read(object: &Object) -> Result<Pixels> {
    let path = object.source.path();
    let ended = || damaged(path, "the file is damaged");
    let frames = object.frames.len();
    let native_bytes = if object.format.allocated == 1 {
        (object.format.values() * frames).div_ceil(8)
    } else {
        object.format.frame_bytes() * frames
    };
    if object.format.float {
        let whole = catch_panic(|| whole(&object.source)).ok_or_else(ended)??;
        let element = |tag: Tag| {
            whole
                .get(tag)
                .and_then(|e| e.to_bytes().ok().map(Cow::into_owned))
        };
        let bytes = element(tags::FLOAT_PIXEL_DATA)
            .or_else(|| element(tags::DOUBLE_FLOAT_PIXEL_DATA))
            .ok_or_else(ended)?;
        return native(path, bytes, native_bytes, cfg!(target_endian = "big"));
    }
    let compressed = is_compressed(object);
    // A deflated object is unpacked up to the end of its pixels.
    let most = (native_bytes as u64).saturating_add(64 << 20);
    let PixelElement { table, mut fragments } =
        catch_panic(|| pixel_element(object, most, compressed)).ok_or_else(ended)??;
    if !compressed {
        let big = TransferSyntaxRegistry
            .get(&object.syntax)
            .is_some_and(|s| s.endianness() == Endianness::Big);
        let bytes = if fragments.is_empty() {
            Vec::new()
        } else {
            fragments.swap_remove(0)
        };
        return native(path, bytes, native_bytes, big);
    }
    let assembled = frames_of(&table.unwrap_or_default(), fragments, frames);
    Ok(Pixels::Packed(assembled.ok_or_else(|| {
        damaged(path, &format!("its fragments do not form {frames} frames"))
    })?))
}

fn native(path: &Path, bytes: Vec<u8>, needed: usize, big: bool) -> Result<Pixels> {
    if bytes.is_empty() {
        return Err(Error::file(
            path,
            "holds no pixels: it is truncated, or only a header; copy or export it again",
        ));
    }
    if bytes.len() < needed {
        return Err(read_error(path, ErrorKind::UnexpectedEof.into()));
    }
    Ok(Pixels::Native(bytes, big))
}

/// Assembles fragments into frames: by the offset table, one per frame, all into one, or each from
/// the start of an image on.
fn frames_of(table: &[u32], fragments: Vec<Vec<u8>>, frames: usize) -> Option<Vec<Vec<u8>>> {
    if fragments.len() == frames {
        return Some(fragments);
    }
    if frames == 1 {
        return Some(vec![fragments.concat()]);
    }
    let mut joined: Vec<Vec<u8>> = Vec::new();
    if table.len() == frames {
        let mut offset = 0u64;
        for fragment in fragments {
            let length = fragment.len() as u64 + 8;
            let goes_on = table
                .get(joined.len())
                .is_none_or(|next| u64::from(*next) > offset);
            match joined.last_mut() {
                Some(last) if goes_on => last.extend(fragment),
                _ => joined.push(fragment),
            }
            offset += length;
        }
    } else {
        for fragment in fragments {
            let starts =
                fragment.starts_with(&[0xff, 0xd8]) || fragment.starts_with(&[0xff, 0x4f, 0xff, 0x51]);
            match joined.last_mut() {
                Some(last) if !starts => last.extend(fragment),
                _ => joined.push(fragment),
            }
        }
    }
    (joined.len() == frames).then_some(joined)
}

/// The sample type of a format when read as stored.
pub trait Pixel: RawScalar {
    /// Whether it is a floating-point type.
    const FLOAT: bool;
    /// The lowest `bits` bits of `raw` as a value, sign-extended if signed.
    fn of_bits(raw: u64, bits: u32, signed: bool) -> Self;
    /// From a floating-point sample.
    fn of_float(value: f64) -> Self;
}

macro_rules! pixel {
    ($($t:ty),*) => {$(
        #[allow(clippy::unnecessary_cast, reason = "some of the types are what is cast to")]
        impl Pixel for $t {
            const FLOAT: bool = (0.5 as $t) as f64 == 0.5;
            #[inline(always)]
            fn of_bits(raw: u64, bits: u32, signed: bool) -> Self {
                let shift = 64 - bits;
                if signed { ((raw << shift) as i64 >> shift) as Self } else { ((raw << shift) >> shift) as Self }
            }
            #[inline(always)]
            fn of_float(value: f64) -> Self {
                value as Self
            }
        }
    )*};
}
pixel!(u8, i8, u16, i16, u32, i32, f32, f64);

/// Writes the samples of one frame, applying `convert` to each stored one. RGB output is always
/// interleaved.
pub fn decode<T: Pixel>(
    object: &Object,
    pixels: &Pixels,
    frame: &Frame,
    out: &mut [T],
    convert: &(dyn Fn(T) -> T + Sync),
) -> Result<()> {
    let format = &object.format;
    let (bytes, big): (Cow<[u8]>, bool) = match pixels {
        Pixels::Native(all, big) if format.allocated == 1 => {
            // Frames of single bits follow each other without padding.
            let first = frame.number * format.values();
            for (n, o) in out.iter_mut().enumerate() {
                let bit = first + n;
                *o = T::of_bits(
                    u64::from(all.get(bit / 8).copied().unwrap_or(0) >> (bit % 8) & 1),
                    1,
                    false,
                );
            }
            let _order = big;
            return Ok(());
        }
        Pixels::Native(all, big) => {
            let length = format.frame_bytes();
            let range = frame.number * length..(frame.number + 1) * length;
            (
                Cow::Borrowed(
                    all.get(range)
                        .ok_or_else(|| read_error(object.source.path(), ErrorKind::UnexpectedEof.into()))?,
                ),
                *big,
            )
        }
        Pixels::Packed(frames) => {
            let compressed = frames.get(frame.number).map_or(&[][..], Vec::as_slice);
            (Cow::Owned(unpacked(object, compressed)?), false)
        }
    };
    let (bits, signed, shift) = (
        u32::from(format.stored),
        format.signed,
        u32::from(format.high_bit + 1 - format.stored),
    );
    let width = usize::from(format.allocated / 8);
    // Uncompressed colour planes; decoders interleave.
    let planes = format.samples > 1 && format.planar && matches!(pixels, Pixels::Native(..));
    let samples = usize::from(format.samples);
    let pixels_in_plane = out.len() / samples;
    let plain =
        width == size_of::<T>() && bits as usize == 8 * width && !planes && !big && T::FLOAT == format.float;
    if plain && cfg!(target_endian = "little") {
        let target: &mut [u8] = bytemuck::cast_slice_mut(out);
        if target.len() != bytes.len() {
            return Err(read_error(object.source.path(), ErrorKind::UnexpectedEof.into()));
        }
        target.copy_from_slice(&bytes);
        out.iter_mut().for_each(|v| *v = convert(*v));
        return Ok(());
    }
    for (n, sample) in bytes.chunks_exact(width).enumerate().take(out.len()) {
        let mut raw = [0u8; 8];
        raw[..width].copy_from_slice(sample);
        if big {
            raw[..width].reverse();
        }
        let raw = u64::from_le_bytes(raw);
        let value = match (format.float, width) {
            (true, 4) => T::of_float(f64::from(f32::from_bits(raw as u32))),
            (true, _) => T::of_float(f64::from_bits(raw)),
            _ => T::of_bits(raw >> shift, bits, signed),
        };
        let to = if planes {
            n % pixels_in_plane * samples + n / pixels_in_plane
        } else {
            n
        };
        out[to] = convert(value);
    }
    Ok(())
}

/// A compressed frame as native bytes, least significant first, colours interleaved.
fn unpacked(object: &Object, compressed: &[u8]) -> Result<Vec<u8>> {
    let format = &object.format;
    let needed = format.frame_bytes();
    let damaged = |e: String| {
        Error::file(
            object.source.path(),
            format!("its pixels cannot be decoded ({e}); copy or export it again"),
        )
    };
    if needed / max_compression_ratio(&object.syntax, needed) as usize > compressed.len() {
        return Err(damaged(format!(
            "{} bytes do not make a picture of {} x {}",
            compressed.len(),
            format.columns,
            format.rows
        )));
    }
    let uid = object.syntax.as_str();
    let decoded = catch_panic(|| {
        if JPEG.contains(&uid) {
            jpeg(format, compressed)
        } else if JPEG_2000.contains(&uid) {
            jpeg_2000(format, compressed)
        } else {
            by_registry(object, compressed)
        }
    });
    let bytes = decoded.unwrap_or_else(|| Err("they are damaged".into())).map_err(|e| match e.contains("SamplePrecision") {
        // The decoder's message about what it does not support.
        true => Error::file(
            object.source.path(),
            format!("holds 12-bit lossy JPEG ({}), which cannot be decoded; convert it to Explicit VR Little Endian", syntax_name(uid)),
        ),
        false => damaged(e),
    })?;
    if bytes.len() != needed {
        return Err(damaged(format!(
            "{} bytes came out and {needed} are needed",
            bytes.len()
        )));
    }
    Ok(bytes)
}

fn jpeg(format: &PixelFormat, compressed: &[u8]) -> Result<Vec<u8>, String> {
    let mut decoder = jpeg_decoder::Decoder::new(compressed);
    if format.samples == 3 {
        // The header takes precedence over the decoder's guess.
        decoder.set_color_transform(if format.photometric.starts_with("YBR") {
            ColorTransform::YCbCr
        } else {
            ColorTransform::RGB
        });
    }
    decoder.set_max_decoding_buffer_size(format.values().saturating_mul(4).saturating_add(1 << 20));
    decoder.read_info().map_err(|e| format!("{e:?}"))?;
    let info = decoder.info().ok_or("no picture")?;
    if (info.width, info.height) != (format.columns, format.rows) {
        return Err(format!(
            "the picture has {} x {} pixels instead of {} x {}",
            info.width, info.height, format.columns, format.rows
        ));
    }
    let values = decoder.decode().map_err(|e| format!("{e:?}"))?;
    let wide = format.allocated == 16;
    match (info.pixel_format, wide) {
        (JpegFormat::L8, false) | (JpegFormat::RGB24, false) => Ok(values),
        (JpegFormat::L8, true) => Ok(values.iter().flat_map(|v| [*v, 0]).collect()),
        (JpegFormat::L16, true) => Ok(values
            .chunks_exact(2)
            .flat_map(|v| u16::from_ne_bytes([v[0], v[1]]).to_le_bytes())
            .collect()),
        (other, _) => Err(format!(
            "the picture holds {other:?} for {} bits per sample",
            format.allocated
        )),
    }
}

fn jpeg_2000(format: &PixelFormat, compressed: &[u8]) -> Result<Vec<u8>, String> {
    // The size is in the marker after the start of the code stream; without it nothing is
    // allocated.
    let at = compressed
        .windows(4)
        .take(4096)
        .position(|w| w == [0xff, 0x4f, 0xff, 0x51])
        .ok_or("no code stream")?;
    let word = |n: usize| {
        compressed
            .get(at + n..at + n + 4)
            .map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]))
            .ok_or("no code stream")
    };
    let (width, height) = (
        word(8)?.wrapping_sub(word(16)?),
        word(12)?.wrapping_sub(word(20)?),
    );
    if (width, height) != (u32::from(format.columns), u32::from(format.rows)) {
        return Err(format!(
            "the picture has {width} x {height} pixels instead of {} x {}",
            format.columns, format.rows
        ));
    }
    let components = compressed
        .get(at + 40..at + 42)
        .map(|b| u16::from_be_bytes([b[0], b[1]]))
        .ok_or("no code stream")?;
    if !(format.samples..=4).contains(&components) {
        return Err(format!(
            "the picture has {components} components instead of {}",
            format.samples
        ));
    }
    let settings = hayro_jpeg2000::DecodeSettings {
        resolve_palette_indices: false,
        ..Default::default()
    };
    let image = hayro_jpeg2000::Image::new(compressed, &settings).map_err(|e| format!("{e:?}"))?;
    if (image.width(), image.height()) != (width, height) {
        return Err("its headers contradict each other".into());
    }
    let mut context = hayro_jpeg2000::DecoderContext::default();
    let decoded = image.decode(&mut context).map_err(|e| format!("{e:?}"))?;
    let samples = usize::from(format.samples);
    let components = decoded.components();
    let pixels = usize::from(format.rows) * usize::from(format.columns);
    if components.len() < samples
        || components
            .iter()
            .take(samples)
            .any(|c| c.samples().len() != pixels)
    {
        return Err("its components differ in size from the image".into());
    }
    let width = usize::from(format.allocated / 8).clamp(1, 4);
    let mut bytes = vec![0u8; pixels * samples * width];
    for (c, component) in components.iter().take(samples).enumerate() {
        // The decoder treats every component as unsigned, and shifts it by half its range.
        let signed = compressed.get(at + 42 + 3 * c).is_some_and(|s| s & 0x80 != 0);
        let shift = if signed {
            (1u32 << component.bit_depth().clamp(1, 31).saturating_sub(1)) as f32
        } else {
            0.0
        };
        for (n, sample) in component.samples().iter().enumerate() {
            let to = (n * samples + c) * width;
            // Single precision, in which integers of 24 bits are exact.
            bytes[to..to + width].copy_from_slice(&((sample - shift).round() as i32).to_le_bytes()[..width]);
        }
    }
    Ok(bytes)
}

/// One compressed frame in the form expected by the registry's decoders.
struct OneFrame<'a> {
    object: &'a Object,
    compressed: &'a [u8],
}

impl PixelDataObject for OneFrame<'_> {
    fn transfer_syntax_uid(&self) -> &str {
        &self.object.syntax
    }
    fn rows(&self) -> Option<u16> {
        Some(self.object.format.rows)
    }
    fn cols(&self) -> Option<u16> {
        Some(self.object.format.columns)
    }
    fn samples_per_pixel(&self) -> Option<u16> {
        Some(self.object.format.samples)
    }
    fn bits_allocated(&self) -> Option<u16> {
        Some(self.object.format.allocated)
    }
    fn bits_stored(&self) -> Option<u16> {
        Some(self.object.format.stored)
    }
    fn photometric_interpretation(&self) -> Option<&str> {
        Some(&self.object.format.photometric)
    }
    fn number_of_frames(&self) -> Option<u32> {
        Some(1)
    }
    fn number_of_fragments(&self) -> Option<u32> {
        Some(1)
    }
    fn fragment(&self, fragment: usize) -> Option<Cow<'_, [u8]>> {
        (fragment == 0).then_some(Cow::Borrowed(self.compressed))
    }
    fn offset_table(&self) -> Option<Cow<'_, [u32]>> {
        None
    }
    fn raw_pixel_data(&self) -> Option<RawPixelData> {
        Some(RawPixelData {
            fragments: vec![self.compressed.to_vec()].into(),
            offset_table: Vec::new().into(),
        })
    }
}

fn by_registry(object: &Object, compressed: &[u8]) -> Result<Vec<u8>, String> {
    let Some(Codec::EncapsulatedPixelData(Some(decoder), _)) =
        TransferSyntaxRegistry.get(&object.syntax).map(|s| s.codec())
    else {
        return Err("its transfer syntax is not known".into());
    };
    let mut bytes = Vec::new();
    decoder
        .decode_frame(&OneFrame { object, compressed }, 0, &mut bytes)
        .map_err(|e| one_line(&e))?;
    Ok(bytes)
}
