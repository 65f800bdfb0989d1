//! Compressions of strips and tiles.
//!
//! Source: TIFF 6.0 sections 9 to 11, 13; Technical Note 2 (JPEG); numbers from 32768 on as
//! registered with Adobe and used by libtiff and tifffile. A compression that cannot be decoded is
//! refused by its name.

use super::fax::{self, FaxKind};
use flate2::read::ZlibDecoder;
use jpeg_decoder::ColorTransform;
use std::io::Read;
use weezl::BitOrder;

/// The compressions that can be decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    Fax(FaxKind),
    Lzw,
    Jpeg,
    Deflate,
    PackBits,
    Lzma,
    Zstd,
    Jpeg2000,
}

impl Compression {
    /// By the numbers of the tags Compression and T4Options.
    ///
    /// # Errors
    /// The name of a compression that cannot be decoded.
    pub fn of(number: u64, fax_options: u64) -> Result<Self, String> {
        let name = match number {
            1 => return Ok(Self::None),
            2 => return Ok(Self::Fax(FaxKind::Huffman)),
            3 => {
                return Ok(Self::Fax(FaxKind::Group3 {
                    two_dimensional: fax_options & 1 != 0,
                }));
            }
            4 => return Ok(Self::Fax(FaxKind::Group4)),
            5 => return Ok(Self::Lzw),
            7 => return Ok(Self::Jpeg),
            8 | 32946 => return Ok(Self::Deflate),
            32773 => return Ok(Self::PackBits),
            34925 => return Ok(Self::Lzma),
            34926 | 50000 => return Ok(Self::Zstd),
            33004 | 33005 | 34712 => return Ok(Self::Jpeg2000),
            6 => "old-style JPEG (compression 6)",
            9 | 10 | 34661 => "JBIG",
            33003 => "JPEG 2000 in YCbCr (Aperio)",
            32766 => "the NeXT two-bit scheme",
            32771 => "CCITT run lengths in words",
            32809 => "ThunderScan",
            34676 | 34677 => "SGI LogLuv",
            34887 => "LERC",
            34892 => "lossy JPEG of DNG",
            34933 => "PNG",
            22610 | 34934 => "JPEG XR",
            50001 | 34927 => "WebP",
            50002 | 52546 => "JPEG XL",
            65000..=65002 => "EER (electron events)",
            other => return Err(format!("the compression {other}")),
        };
        Err(name.to_owned())
    }

    /// Whether values are whole bytes of decoded pixels, without a predictor.
    pub fn is_picture(self) -> bool {
        matches!(self, Self::Jpeg | Self::Jpeg2000)
    }

    /// Its name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Fax(_) => "CCITT fax",
            Self::Lzw => "LZW",
            Self::Jpeg => "JPEG",
            Self::Deflate => "deflate",
            Self::PackBits => "PackBits",
            Self::Lzma => "LZMA",
            Self::Zstd => "Zstandard",
            Self::Jpeg2000 => "JPEG 2000",
        }
    }
}

/// A strip or tile to decode.
pub(super) struct Chunk<'a> {
    /// Pixels along x and y.
    pub size: [usize; 2],
    /// Values per pixel.
    pub samples: usize,
    pub bits: u32,
    /// Bytes of the decoded values.
    pub length: usize,
    /// Quantisation and Huffman tables that all JPEG chunks share.
    pub jpeg_tables: &'a [u8],
    /// Whether JPEG's colours are YCbCr.
    pub is_ycbcr: bool,
    pub signed: bool,
}

impl Chunk<'_> {
    /// Decodes the bytes of a chunk; for JPEG 2000, values are in the byte order of the machine.
    ///
    /// # Errors
    /// The problem with the bytes.
    pub fn decode(&self, compression: Compression, bytes: Vec<u8>) -> Result<Vec<u8>, String> {
        match compression {
            Compression::None => Ok(bytes),
            Compression::Fax(kind) => fax::decode(kind, &bytes, self.size[0], self.size[1]),
            Compression::PackBits => Ok(self.pack_bits(&bytes)),
            Compression::Lzw => self.lzw(&bytes),
            Compression::Deflate => self.all_of(ZlibDecoder::new(&bytes[..])),
            Compression::Lzma => self.all_of(lzma_rust2::XzReader::new(&bytes[..], false)),
            Compression::Zstd => {
                self.all_of(zstd::stream::read::Decoder::new(&bytes[..]).map_err(|e| e.to_string())?)
            }
            Compression::Jpeg => self.jpeg(&bytes),
            Compression::Jpeg2000 => self.jpeg_2000(&bytes),
        }
    }

    /// As many bytes as the values need; a stream may be longer.
    fn all_of(&self, reader: impl Read) -> Result<Vec<u8>, String> {
        let mut out = Vec::new();
        reader
            .take(self.length as u64)
            .read_to_end(&mut out)
            .map_err(|e| e.to_string())?;
        Ok(out)
    }

    fn pack_bits(&self, bytes: &[u8]) -> Vec<u8> {
        let (mut out, mut rest) = (Vec::new(), bytes);
        while let Some((&head, tail)) = rest.split_first() {
            if out.len() >= self.length {
                break;
            }
            rest = tail;
            match head as i8 {
                n @ 0.. => {
                    let count = (n as usize + 1).min(rest.len());
                    out.extend_from_slice(&rest[..count]);
                    rest = &rest[count..];
                }
                -128 => {}
                n => {
                    let Some((&value, tail)) = rest.split_first() else {
                        break;
                    };
                    rest = tail;
                    out.resize(out.len() + usize::from(n.unsigned_abs()) + 1, value);
                }
            }
        }
        out.truncate(self.length);
        out
    }

    fn lzw(&self, bytes: &[u8]) -> Result<Vec<u8>, String> {
        if bytes.len() > 1 && bytes[0] == 0 && bytes[1] & 1 != 0 {
            return Err("it is LZW of a kind older than TIFF 6.0".into());
        }
        let mut decoder = weezl::decode::Decoder::with_tiff_size_switch(BitOrder::Msb, 8);
        let mut out = vec![0u8; self.length];
        let (mut read, mut written) = (0, 0);
        while written < out.len() {
            let step = decoder.decode_bytes(&bytes[read..], &mut out[written..]);
            (read, written) = (read + step.consumed_in, written + step.consumed_out);
            match step.status {
                Ok(weezl::LzwStatus::Ok) if step.consumed_in + step.consumed_out > 0 => {}
                Ok(_) => break,
                Err(e) => return Err(e.to_string()),
            }
        }
        out.truncate(written);
        Ok(out)
    }

    fn jpeg(&self, bytes: &[u8]) -> Result<Vec<u8>, String> {
        // The tables are a stream of their own: its end and the start of the chunk are left out.
        let tables = self.jpeg_tables.strip_suffix(&[0xff, 0xd9]).unwrap_or(&[]);
        let stream = match bytes.strip_prefix(&[0xff, 0xd8]) {
            Some(rest) if !tables.is_empty() => [tables, rest].concat(),
            _ => bytes.to_vec(),
        };
        let mut decoder = jpeg_decoder::Decoder::new(&stream[..]);
        if self.samples == 3 {
            decoder.set_color_transform(if self.is_ycbcr {
                ColorTransform::YCbCr
            } else {
                ColorTransform::RGB
            });
        } else if self.samples == 4 {
            decoder.set_color_transform(ColorTransform::CMYK);
        }
        decoder.set_max_decoding_buffer_size(self.length.saturating_mul(4).saturating_add(1 << 20));
        decoder.read_info().map_err(|e| e.to_string())?;
        let info = decoder.info().ok_or("no picture")?;
        let [width, height] = [info.width, info.height].map(usize::from);
        let pixel_bytes = info.pixel_format.pixel_bytes();
        let wanted = self.samples * (self.bits as usize).div_ceil(8);
        if width != self.size[0] || height < self.size[1] || pixel_bytes != wanted {
            return Err(format!(
                "it is a picture of {width} x {height} pixels of {pixel_bytes} bytes instead of {} x {} of {wanted}",
                self.size[0], self.size[1]
            ));
        }
        let mut values = decoder.decode().map_err(|e| e.to_string())?;
        values.truncate(self.length);
        if self.samples == 4 {
            // The decoder turns inks round.
            values.iter_mut().for_each(|v| *v = !*v);
        }
        Ok(values)
    }

    fn jpeg_2000(&self, bytes: &[u8]) -> Result<Vec<u8>, String> {
        self.check_code_stream(bytes)?;
        let settings = hayro_jpeg2000::DecodeSettings {
            resolve_palette_indices: false,
            ..Default::default()
        };
        let image = hayro_jpeg2000::Image::new(bytes, &settings).map_err(|e| format!("{e:?}"))?;
        if [image.width() as usize, image.height() as usize] != self.size {
            return Err("its headers contradict each other".into());
        }
        let mut context = hayro_jpeg2000::DecoderContext::default();
        let decoded = image.decode(&mut context).map_err(|e| format!("{e:?}"))?;
        let (components, pixels) = (decoded.components(), self.size[0] * self.size[1]);
        if components.len() != self.samples || components.iter().any(|c| c.samples().len() != pixels) {
            return Err(format!(
                "it holds {} components instead of {}",
                components.len(),
                self.samples
            ));
        }
        let width = (self.bits as usize).div_ceil(8).clamp(1, 4);
        let mut out = vec![0u8; pixels * self.samples * width];
        for (c, component) in components.iter().enumerate() {
            // The decoder treats every component as unsigned, and shifts it by half its range.
            let shift = if self.signed {
                f64::from(1u32 << component.bit_depth().clamp(1, 31).saturating_sub(1))
            } else {
                0.0
            };
            for (n, sample) in component.samples().iter().enumerate() {
                let to = (n * self.samples + c) * width;
                let value = (f64::from(*sample) - shift).round() as i64;
                let bytes = value.to_ne_bytes();
                let bytes = if cfg!(target_endian = "big") {
                    &bytes[8 - width..]
                } else {
                    &bytes[..width]
                };
                out[to..to + width].copy_from_slice(bytes);
            }
        }
        Ok(out)
    }

    /// Compares the size in the code stream's first marker with the chunk's: without it nothing is
    /// allocated.
    fn check_code_stream(&self, bytes: &[u8]) -> Result<(), String> {
        let at = bytes
            .windows(4)
            .take(4096)
            .position(|w| w == [0xff, 0x4f, 0xff, 0x51])
            .ok_or("it holds no code stream")?;
        let word = |n: usize| {
            let b = bytes.get(at + n..at + n + 4).ok_or("it holds no code stream")?;
            Ok::<_, &str>(u32::from_be_bytes([b[0], b[1], b[2], b[3]]))
        };
        let size = [
            word(8)?.wrapping_sub(word(16)?) as usize,
            word(12)?.wrapping_sub(word(20)?) as usize,
        ];
        if size == self.size {
            Ok(())
        } else {
            Err(format!(
                "it is a picture of {} x {} pixels instead of {} x {}",
                size[0], size[1], self.size[0], self.size[1]
            ))
        }
    }
}
