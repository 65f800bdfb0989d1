//! RLE pictures of 32 bits, which the registry's decoder does not read.
//!
//! Source: DICOM PS3.5 G (segments of most significant bytes first, PackBits).

/// The bytes of a picture of `values` samples of `width` bytes, least significant first, colours
/// interleaved.
///
/// # Errors
/// Segments that do not hold the picture; a phrase.
pub fn decode(compressed: &[u8], values: usize, samples: usize, width: usize) -> Result<Vec<u8>, String> {
    let word = |at: usize| {
        let bytes = compressed.get(4 * at..4 * at + 4)?;
        Some(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]) as usize)
    };
    let count = word(0).unwrap_or(0);
    if count != samples * width {
        return Err(format!("{count} segments instead of {}", samples * width));
    }
    let pixels = values / samples.max(1);
    let mut out = vec![0u8; values * width];
    for segment in 0..count {
        let start = word(segment + 1).unwrap_or(usize::MAX);
        let end = if segment + 1 < count {
            word(segment + 2)
        } else {
            None
        };
        let end = end.unwrap_or(compressed.len()).min(compressed.len());
        let bytes = compressed
            .get(start..end)
            .ok_or("a segment lies outside of the picture")?;
        let plane = unpacked(bytes, pixels).ok_or("a segment ends too early")?;
        let (sample, byte) = (segment / width, width - 1 - segment % width);
        for (n, value) in plane.into_iter().enumerate() {
            out[(n * samples + sample) * width + byte] = value;
        }
    }
    Ok(out)
}

/// The first `count` bytes of a PackBits stream.
fn unpacked(mut packed: &[u8], count: usize) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(count.min(packed.len().saturating_mul(64)));
    while out.len() < count {
        let (head, rest) = packed.split_first()?;
        packed = rest;
        match *head as i8 {
            n @ 0.. => {
                let run = packed.get(..n as usize + 1)?;
                out.extend_from_slice(run);
                packed = &packed[run.len()..];
            }
            -128 => {}
            n => {
                let (value, rest) = packed.split_first()?;
                out.resize(out.len() + n.unsigned_abs() as usize + 1, *value);
                packed = rest;
            }
        }
    }
    out.truncate(count);
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_are_joined() {
        // Two pixels, 0x01020304 and 0x01020305.
        let planes: [&[u8]; 4] = [&[0xff, 1], &[0xff, 2], &[0xff, 3], &[1, 4, 5]];
        let mut packed: Vec<u8> = Vec::new();
        let mut at = 64u32;
        for word in 0..16u32 {
            let value = match word {
                0 => 4,
                1..=4 => {
                    let start = at;
                    at += planes[word as usize - 1].len() as u32;
                    start
                }
                _ => 0,
            };
            packed.extend(value.to_le_bytes());
        }
        packed.extend(planes.concat());
        assert_eq!(decode(&packed, 2, 1, 4), Ok(vec![4, 3, 2, 1, 5, 3, 2, 1]));
        assert!(decode(&packed[..packed.len() - 1], 2, 1, 4).is_err());
        assert!(decode(&packed[..60], 2, 1, 4).is_err());
        assert!(decode(&packed, 1 << 40, 1, 2).is_err());
    }
}
