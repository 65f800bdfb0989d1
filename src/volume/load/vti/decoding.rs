//! Decoding of VTK's values: base64 text and compressed blocks.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::read::ZlibDecoder;
use rayon::prelude::*;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};

/// Number of compressed blocks unpacked at once.
const BLOCKS_AT_ONCE: usize = 256;

/// How the blocks of values are compressed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Compression {
    None,
    Zlib,
    Lz4,
    Lzma,
}

/// Blocks, unpacked many at a time.
pub(super) struct Blocks<R> {
    reader: R,
    packed: std::vec::IntoIter<u64>,
    size: usize,
    packing: Compression,
    ready: Vec<Vec<u8>>,
    /// The next block, and the next byte in it.
    at: [usize; 2],
}

impl<R: Read> Blocks<R> {
    /// Blocks of `size` unpacked bytes; `packed` holds the compressed length of each, bytes.
    pub fn new(reader: R, packed: Vec<u64>, size: usize, packing: Compression) -> Self {
        Self {
            reader,
            packed: packed.into_iter(),
            size,
            packing,
            ready: Vec::new(),
            at: [0, 0],
        }
    }
}

impl<R: Read> Read for Blocks<R> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        while self.ready.get(self.at[0]).is_none_or(|b| b.len() <= self.at[1]) {
            if self.at[0] + 1 < self.ready.len() {
                self.at = [self.at[0] + 1, 0];
                continue;
            }
            let at_once = ((1 << 24) / self.size.max(1)).clamp(1, BLOCKS_AT_ONCE);
            let mut packed = Vec::new();
            for length in self.packed.by_ref().take(at_once) {
                let mut block = Vec::new();
                if (&mut self.reader).take(length).read_to_end(&mut block)? as u64 != length {
                    return Err(std::io::ErrorKind::UnexpectedEof.into());
                }
                packed.push(block);
            }
            if packed.is_empty() {
                return Ok(0);
            }
            let (size, packing) = (self.size, self.packing);
            self.ready = packed
                .into_par_iter()
                .map(|block| unpack(&block, size, packing))
                .collect::<std::io::Result<_>>()?;
            self.at = [0, 0];
        }
        let block = &self.ready[self.at[0]][self.at[1]..];
        let n = block.len().min(bytes.len());
        bytes[..n].copy_from_slice(&block[..n]);
        self.at[1] += n;
        Ok(n)
    }
}

fn unpack(block: &[u8], size: usize, packing: Compression) -> std::io::Result<Vec<u8>> {
    let mut out = Vec::new();
    match packing {
        Compression::None => out.extend_from_slice(block),
        Compression::Zlib => {
            ZlibDecoder::new(block).take(size as u64).read_to_end(&mut out)?;
        }
        Compression::Lz4 => {
            // LZ4's compression ratio is at most 255.
            out.resize(size.min(block.len().saturating_mul(255)), 0);
            let n = lz4_flex::block::decompress_into(block, &mut out)
                .map_err(|e| std::io::Error::new(std::io::ErrorKind::InvalidData, e.to_string()))?;
            out.truncate(n);
        }
        Compression::Lzma => {
            lzma_rust2::XzReader::new(block, false)
                .take(size as u64)
                .read_to_end(&mut out)?;
        }
    }
    Ok(out)
}

/// Decodes base64, parts of which may have been encoded and padded separately. Ends at the first
/// character that is not base64.
pub(super) struct Base64 {
    reader: BufReader<File>,
    ready: Vec<u8>,
    at: usize,
}

impl Base64 {
    pub fn new(reader: BufReader<File>) -> Self {
        Self {
            reader,
            ready: Vec::new(),
            at: 0,
        }
    }

    fn more(&mut self) -> std::io::Result<()> {
        const GROUPS: usize = 1 << 16;
        let mut text = Vec::with_capacity(GROUPS);
        'fill: while text.len() < GROUPS {
            let bytes = self.reader.fill_buf()?;
            if bytes.is_empty() {
                break;
            }
            let mut used = 0;
            let mut end = false;
            for &b in bytes {
                match b {
                    b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'+' | b'/' | b'=' => text.push(b),
                    b if b.is_ascii_whitespace() => {}
                    _ => {
                        end = true;
                        break;
                    }
                }
                used += 1;
                // A padded group ends the part that can be decoded at once.
                let padded = b == b'=' && text.len().is_multiple_of(4);
                if padded || text.len() == GROUPS {
                    end = padded;
                    break;
                }
            }
            self.reader.consume(used);
            if end {
                break 'fill;
            }
        }
        text.truncate(text.len() / 4 * 4);
        self.ready = STANDARD
            .decode(&text)
            .map_err(|e| std::io::Error::new(std::io::ErrorKind::InvalidData, e.to_string()))?;
        self.at = 0;
        Ok(())
    }
}

impl Read for Base64 {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        if self.at == self.ready.len() {
            self.more()?;
        }
        let n = (self.ready.len() - self.at).min(bytes.len());
        bytes[..n].copy_from_slice(&self.ready[self.at..self.at + n]);
        self.at += n;
        Ok(n)
    }
}
