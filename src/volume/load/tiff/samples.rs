//! From the bytes of a strip or tile to values: byte order, predictors, and samples of any number
//! of bits.
//!
//! Source: TIFF 6.0 sections 14 (horizontal differencing) and 19 (sample formats); TIFF Technical
//! Note 3 (floating-point predictor; floats of 16 and 24 bits as in its table).

use half::f16;

/// The kind of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SampleKind {
    Unsigned,
    Signed,
    Float,
}

/// The predictors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Predictor {
    None,
    Horizontal,
    FloatingPoint,
}

/// How the samples of a row are stored.
#[derive(Clone, Copy, Debug)]
pub(super) struct RowFormat {
    pub kind: SampleKind,
    pub bits: u32,
    /// Samples of a pixel that are stored together.
    pub samples: usize,
    pub predictor: Predictor,
    pub big_endian: bool,
}

impl RowFormat {
    /// Bytes of a row of pixels.
    pub fn row_bytes(&self, pixels: usize) -> Option<usize> {
        pixels
            .checked_mul(self.samples)?
            .checked_mul(self.bits as usize)
            .map(|bits| bits.div_ceil(8))
    }

    /// Whether samples are whole bytes of a type of this machine.
    pub fn is_native(&self) -> bool {
        matches!(self.bits, 8 | 16 | 32 | 64) && !(self.kind == SampleKind::Float && self.bits == 16)
    }

    /// Undoes predictor and byte order of a row, in place.
    pub fn restore(&self, row: &mut [u8]) {
        let width = self.bits as usize / 8;
        if !self.bits.is_multiple_of(8) {
            return;
        }
        match self.predictor {
            Predictor::FloatingPoint => self.restore_floats(row, width),
            _ if self.big_endian != cfg!(target_endian = "big") && matches!(width, 2 | 4 | 8) => {
                row.chunks_exact_mut(width).for_each(<[u8]>::reverse);
            }
            // Floats of three bytes are converted from big-endian bytes.
            _ if width == 3 && !self.big_endian && self.kind == SampleKind::Float => {
                row.chunks_exact_mut(width).for_each(<[u8]>::reverse);
            }
            _ => {}
        }
        if self.predictor == Predictor::Horizontal {
            match width {
                1 => add_left(
                    row,
                    self.samples,
                    u8::from_ne_bytes,
                    u8::to_ne_bytes,
                    u8::wrapping_add,
                ),
                2 => add_left(
                    row,
                    self.samples,
                    u16::from_ne_bytes,
                    u16::to_ne_bytes,
                    u16::wrapping_add,
                ),
                4 => add_left(
                    row,
                    self.samples,
                    u32::from_ne_bytes,
                    u32::to_ne_bytes,
                    u32::wrapping_add,
                ),
                _ => add_left(
                    row,
                    self.samples,
                    u64::from_ne_bytes,
                    u64::to_ne_bytes,
                    u64::wrapping_add,
                ),
            }
        }
    }

    /// The floating-point predictor: differences of bytes, the most significant ones of all samples
    /// first.
    fn restore_floats(&self, row: &mut [u8], width: usize) {
        for n in self.samples..row.len() {
            row[n] = row[n].wrapping_add(row[n - self.samples]);
        }
        let bytes = row.to_vec();
        let count = row.len() / width.max(1);
        for (n, value) in row.chunks_exact_mut(width).enumerate() {
            for (b, byte) in value.iter_mut().enumerate() {
                *byte = bytes[b * count + n];
            }
            if width != 3 && cfg!(target_endian = "little") {
                value.reverse();
            }
        }
    }

    /// The samples of a restored row that are not native, as numbers: at most 53 bits.
    pub fn numbers<'a>(&'a self, row: &'a [u8]) -> impl Iterator<Item = f64> + 'a {
        let bits = self.bits as usize;
        let count = row.len() * 8 / bits.max(1);
        (0..count).map(move |n| {
            if self.kind == SampleKind::Float {
                return if bits == 16 {
                    f64::from(f16::from_ne_bytes([row[2 * n], row[2 * n + 1]]))
                } else {
                    float_24(&row[3 * n..3 * n + 3])
                };
            }
            let value = bits_at(row, n * bits, bits);
            if self.kind == SampleKind::Signed && value >> (bits - 1) & 1 == 1 {
                value as f64 - (1u64 << bits) as f64
            } else {
                value as f64
            }
        })
    }
}

/// Unsigned number in some bits of a row, the most significant first.
fn bits_at(row: &[u8], at: usize, bits: usize) -> u64 {
    let (mut value, mut from, end) = (0u64, at, at + bits);
    while from < end {
        let (byte, offset) = (u64::from(row[from / 8]), from % 8);
        let take = (8 - offset).min(end - from);
        let part = byte >> (8 - offset - take) & ((1 << take) - 1);
        value = value << take | part;
        from += take;
    }
    value
}

/// A float of 1 sign, 7 exponent and 16 mantissa bits.
fn float_24(bytes: &[u8]) -> f64 {
    let sign = if bytes[0] & 0x80 == 0 { 1.0 } else { -1.0 };
    let exponent = i32::from(bytes[0] & 0x7f);
    let fraction = f64::from(u16::from_be_bytes([bytes[1], bytes[2]])) / 65_536.0;
    sign * match (exponent, fraction) {
        (0, f) => f * 2f64.powi(-62),
        (127, 0.0) => f64::INFINITY,
        (127, _) => f64::NAN,
        (e, f) => (1.0 + f) * 2f64.powi(e - 63),
    }
}

/// Adds to every value of a row the one `samples` values before.
fn add_left<const N: usize, T: Copy>(
    row: &mut [u8],
    samples: usize,
    from: fn([u8; N]) -> T,
    to: fn(T) -> [u8; N],
    add: fn(T, T) -> T,
) {
    let value = |row: &[u8], n: usize| -> T {
        let mut bytes = [0u8; N];
        bytes.copy_from_slice(&row[n * N..(n + 1) * N]);
        from(bytes)
    };
    for n in samples..row.len() / N {
        let sum = add(value(row, n), value(row, n - samples));
        row[n * N..(n + 1) * N].copy_from_slice(&to(sum));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_of_twelve_bits() {
        let format = RowFormat {
            kind: SampleKind::Unsigned,
            bits: 12,
            samples: 1,
            predictor: Predictor::None,
            big_endian: false,
        };
        let row = [0xab, 0xc1, 0x23];
        assert_eq!(
            format.numbers(&row).collect::<Vec<_>>(),
            [f64::from(0xabc), f64::from(0x123)]
        );
        let signed = RowFormat {
            kind: SampleKind::Signed,
            ..format
        };
        assert_eq!(signed.numbers(&row).next(), Some(f64::from(0xabc - 0x1000)));
    }

    #[test]
    fn small_floats() {
        assert_eq!(float_24(&[0x3f, 0, 0]), 1.0);
        assert_eq!(float_24(&[0xc0, 0x80, 0]), -3.0);
        assert_eq!(float_24(&[0, 0, 0]), 0.0);
    }
}
