//! Pixels of DICOM objects: from their transfer syntax to typed values, each frame separately and
//! many at once.
//!
//! JPEG and JPEG 2000 are decoded here rather than by the registry's adapters, which accept an
//! image of another size than declared. For JPEG 2000 they also need OpenJPEG, in C or translated
//! from it, whereas `hayro-jpeg2000` is safe Rust. RLE and (as an option) JPEG-LS are left to the
//! registry.

use super::super::source::{RawScalar, read_error};
use super::dataset::{one_line, open};
use super::frame::PixelFormat;
use super::location::Bytes;
use super::object::Object;
use super::rle;
use super::syntax::{
    GE_BIG_ENDIAN_PIXELS, JPEG, JPEG_2000, JPEG_LS, RLE, max_compression_ratio, syntax_name,
};
use crate::panic_guard::catch_panic;
use crate::{Error, Result};
use dicom_encoding::adapters::{PixelDataObject, RawPixelData};
use dicom_encoding::transfer_syntax::{Codec, TransferSyntaxIndex};
use dicom_transfer_syntax_registry::TransferSyntaxRegistry;
use jpeg_decoder::{ColorTransform, PixelFormat as JpegFormat};
use std::borrow::Cow;
use std::io::{ErrorKind, Read, Seek, SeekFrom};
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
    let native = uid == GE_BIG_ENDIAN_PIXELS
        || matches!(
            TransferSyntaxRegistry.get(uid).map(|s| s.codec()),
            Some(Codec::None | Codec::Dataset(_))
        );
    if object.format.allocated == 1 && !native {
        return Err(fail(format!(
            "holds packed single bits ({name}), which cannot be decoded; convert it to Explicit VR Little Endian"
        )));
    }
    if uid == GE_BIG_ENDIAN_PIXELS || JPEG.contains(&uid) || JPEG_2000.contains(&uid) {
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

/// The fragments of a compressed pixel data element, in order; the first one holds the offsets of
/// frames.
fn fragments(reader: &mut Bytes, end: u64, path: &Path) -> Result<Vec<Vec<u8>>> {
    let io = |e: std::io::Error| read_error(path, e);
    let mut position = reader.stream_position().map_err(io)?;
    let mut found = Vec::new();
    loop {
        let mut head = [0u8; 8];
        reader.read_exact(&mut head).map_err(io)?;
        position += 8;
        if head[..4] != [0xfe, 0xff, 0x00, 0xe0] {
            // The delimiter; without it, everything before is complete as well.
            return Ok(found);
        }
        let length = u64::from(u32::from_le_bytes([head[4], head[5], head[6], head[7]]));
        if length > end.saturating_sub(position) {
            return Err(io(ErrorKind::UnexpectedEof.into()));
        }
        found.push(bytes_of(reader, length).map_err(io)?);
        position += length;
        if position >= end {
            return Ok(found);
        }
    }
}

/// The next bytes.
fn bytes_of(reader: &mut Bytes, length: u64) -> std::io::Result<Vec<u8>> {
    let mut bytes = vec![0u8; length as usize];
    reader.read_exact(&mut bytes)?;
    Ok(bytes)
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
    catch_panic(|| read_unguarded(object)).ok_or_else(ended)?
}

/// Reads the pixels of an object; [`read`] turns a panic into an error.
fn read_unguarded(object: &Object) -> Result<Pixels> {
    let path = object.source.path();
    let io = |e: std::io::Error| read_error(path, e);
    let pictures = object.pictures;
    let native_bytes = if object.format.allocated == 1 {
        (object.format.values() * pictures).div_ceil(8)
    } else {
        object.format.frame_bytes() * pictures
    };
    // A deflated object is unpacked up to the end of its pixels.
    let most = (native_bytes as u64).saturating_add(64 << 20);
    let element = object.pixels;
    let mut reader = open(&object.source, most)?.reader;
    let end = reader.seek(SeekFrom::End(0)).map_err(io)?;
    reader.seek(SeekFrom::Start(element.offset)).map_err(io)?;
    let compressed = is_compressed(object);
    let Some(length) = element.length else {
        let mut fragments = fragments(&mut reader, end, path)?;
        if fragments.is_empty() {
            return Err(no_pixels(path));
        }
        let table: Vec<u32> = fragments
            .remove(0)
            .chunks_exact(4)
            .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        let assembled = frames_of(&table, fragments, pictures);
        return Ok(Pixels::Packed(assembled.ok_or_else(|| {
            damaged(path, &format!("its fragments do not form {pictures} frames"))
        })?));
    };
    let length = u64::from(length);
    if let Some(bytes) = subsampled(object, &mut reader, length).map_err(io)? {
        return Ok(Pixels::Native(bytes, false));
    }
    if compressed && length < native_bytes as u64 {
        return Err(damaged(
            path,
            &format!(
                "they are not in the form that the transfer syntax {} requires",
                syntax_name(&object.syntax)
            ),
        ));
    }
    if length == 0 {
        return Err(no_pixels(path));
    }
    if length < native_bytes as u64 || (native_bytes as u64) > end.saturating_sub(element.offset) {
        return Err(io(ErrorKind::UnexpectedEof.into()));
    }
    let bytes = bytes_of(&mut reader, native_bytes as u64).map_err(io)?;
    Ok(Pixels::Native(bytes, element.big_endian))
}

/// Uncompressed colours whose two chroma values are shared by pairs of pixels, with chroma for every
/// pixel; none if they are stored in full, whatever the header says.
fn subsampled(object: &Object, reader: &mut Bytes, length: u64) -> std::io::Result<Option<Vec<u8>>> {
    let format = &object.format;
    let whole = (format.frame_bytes() * object.pictures) as u64;
    if format.photometric != "YBR_FULL_422"
        || (format.samples, format.allocated) != (3, 8)
        || !format.columns.is_multiple_of(2)
        || !(2 * whole / 3..whole).contains(&length)
    {
        return Ok(None);
    }
    let pairs = bytes_of(reader, 2 * whole / 3)?;
    let full = pairs
        .chunks_exact(4)
        .flat_map(|p| [p[0], p[2], p[3], p[1], p[2], p[3]]);
    Ok(Some(full.collect()))
}

/// Rejects, before anything is read, pixels that the object cannot contain.
pub fn check_held(object: &Object) -> Result<()> {
    let ratio = max_compression_ratio(&object.syntax, object.format.frame_bytes());
    let bytes = object.format.frame_bytes() * object.pictures;
    // Single bits are not padded to bytes between frames.
    let padding = if object.format.allocated == 1 {
        object.pictures
    } else {
        0
    };
    // Subsampled colours take two thirds.
    let most = object.source.bytes().saturating_mul(ratio);
    if (bytes.saturating_sub(padding) as u64) / 3 * 2 > most {
        return Err(Error::file(
            object.source.path(),
            "declares more pixels than it can hold: it is truncated or damaged; copy or export it again",
        ));
    }
    Ok(())
}

/// Whether two objects have the same pixels, as stored.
pub fn same_pixels(a: &Object, b: &Object) -> bool {
    let stored = |o: &Object| match read(o) {
        Ok(Pixels::Native(bytes, big)) => Some((vec![bytes], big)),
        Ok(Pixels::Packed(frames)) => Some((frames, false)),
        Err(_) => None,
    };
    a.format == b.format
        && a.source.bytes().abs_diff(b.source.bytes()) < 1 << 16
        && stored(a).is_some_and(|a| Some(a) == stored(b))
}

fn no_pixels(path: &Path) -> Error {
    Error::file(
        path,
        "holds no pixels: it is truncated, or only a header; copy or export it again",
    )
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
pub trait Pixel: RawScalar + PartialOrd {
    /// Whether it is a floating-point type.
    const FLOAT: bool;
    /// The lowest `bits` bits of `raw` as a value, sign-extended if signed.
    fn of_bits(raw: u64, bits: u32, signed: bool) -> Self;
    /// From a floating-point number.
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

/// Writes the samples of one picture, applying `convert` to each stored one. RGB output is always
/// interleaved.
pub fn decode<T: Pixel>(
    object: &Object,
    pixels: &Pixels,
    picture: usize,
    out: &mut [T],
    convert: &(dyn Fn(T) -> T + Sync),
) -> Result<()> {
    let format = &object.format;
    let (bytes, big): (Cow<[u8]>, bool) = match pixels {
        Pixels::Native(all, big) if format.allocated == 1 => {
            // Frames of single bits follow each other without padding.
            let first = picture * format.values();
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
            let range = picture * length..(picture + 1) * length;
            (
                Cow::Borrowed(
                    all.get(range)
                        .ok_or_else(|| read_error(object.source.path(), ErrorKind::UnexpectedEof.into()))?,
                ),
                *big,
            )
        }
        Pixels::Packed(frames) => {
            let compressed = frames.get(picture).map_or(&[][..], Vec::as_slice);
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
        // What the picture is, whatever the transfer syntax says.
        let is_jpeg = compressed.starts_with(&[0xff, 0xd8, 0xff]) && !JPEG_LS.contains(&uid);
        let is_jpeg_2000 = compressed.starts_with(&[0xff, 0x4f, 0xff, 0x51]);
        if is_jpeg || JPEG.contains(&uid) && !is_jpeg_2000 {
            jpeg(format, compressed)
        } else if is_jpeg_2000 || JPEG_2000.contains(&uid) {
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

/// Whether a JPEG picture declares YCbCr (true) or RGB: by its JFIF or Adobe marker, by the names of
/// its components, or by chroma of a lower resolution.
fn declared_color(compressed: &[u8]) -> Option<bool> {
    let mut at = 2;
    loop {
        let (marker, length) = (
            compressed.get(at..at + 2)?,
            usize::from(u16::from_be_bytes(
                compressed.get(at + 2..at + 4)?.try_into().ok()?,
            )),
        );
        let value = compressed.get(at + 4..at + 2 + length)?;
        match marker {
            [0xff, 0xee] if value.starts_with(b"Adobe") => return value.get(11).map(|t| *t == 1),
            [0xff, 0xe0] if value.starts_with(b"JFIF") => return Some(true),
            [0xff, 0xc0..=0xc2] if value.get(5) == Some(&3) => {
                let components: Vec<&[u8]> = value[6..].chunks_exact(3).collect();
                let [a, b, c] = components[..] else { return None };
                return match [a[0], b[0], c[0]] {
                    [b'R', b'G', b'B'] => Some(false),
                    _ if a[1] != b[1] || b[1] != c[1] => Some(true),
                    _ => None,
                };
            }
            [0xff, 0xda] => return None,
            [0xff, _] => at += 2 + length,
            _ => return None,
        }
    }
}

/// The colour space that an object's first JPEG picture declares, if the header contradicts it.
pub fn contradicting_color(object: &Object) -> Option<&'static str> {
    // Lossless pictures hold what the header says.
    if !JPEG[..4].contains(&object.syntax.as_str()) {
        return None;
    }
    let Ok(Pixels::Packed(pictures)) = read(object) else {
        return None;
    };
    let ycbcr = declared_color(pictures.first()?)?;
    let labelled = object.format.photometric.starts_with("YBR");
    (ycbcr != labelled).then_some(if ycbcr { "YCbCr" } else { "RGB" })
}

fn jpeg(format: &PixelFormat, compressed: &[u8]) -> Result<Vec<u8>, String> {
    // Some writers omit the marker of the end.
    let mut decoder = jpeg_decoder::Decoder::new(compressed.chain(&[0xff, 0xd9][..]));
    if format.samples == 3 {
        // What the picture itself declares takes precedence over the header, and this over the
        // decoder's guess.
        let ycbcr = declared_color(compressed).unwrap_or(format.photometric.starts_with("YBR"));
        decoder.set_color_transform(if ycbcr {
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
    let format = &object.format;
    if object.syntax == RLE && format.allocated > 16 {
        return rle::decode(
            compressed,
            format.values(),
            usize::from(format.samples),
            usize::from(format.allocated / 8),
        );
    }
    let Some(Codec::EncapsulatedPixelData(Some(decoder), _)) =
        TransferSyntaxRegistry.get(&object.syntax).map(|s| s.codec())
    else {
        return Err(format!(
            "they are compressed in a form that the transfer syntax {} does not have",
            syntax_name(&object.syntax)
        ));
    };
    let mut bytes = Vec::new();
    decoder
        .decode_frame(&OneFrame { object, compressed }, 0, &mut bytes)
        .map_err(|e| one_line(&e))?;
    Ok(bytes)
}
