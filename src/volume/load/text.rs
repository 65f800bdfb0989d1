//! Values written as text, separated by white space.

use super::super::StoredValues;
use super::ScalarType;
use super::source::{read_error, reserved, with_scalar};
use crate::{ByteProgress, Error, Result, Watch};
use std::io::BufRead;
use std::path::Path;
use std::str::FromStr;

/// Maximum length of a number, bytes.
const LONGEST: usize = 400;

/// Skips `ahead` values and reads `count` of them.
pub(super) fn values(
    path: &Path,
    reader: impl BufRead,
    [ahead, count]: [usize; 2],
    scalar: ScalarType,
    watch: &Watch,
) -> Result<StoredValues> {
    with_scalar!(scalar, T => typed::<T>(path, reader, ahead, count, watch, &|v| v as T).map(Into::into))
}

fn typed<T: FromStr>(
    path: &Path,
    mut reader: impl BufRead,
    ahead: usize,
    count: usize,
    watch: &Watch,
    cast: &dyn Fn(f64) -> T,
) -> Result<Vec<T>> {
    let mut values: Vec<T> = reserved(path, count)?;
    let meter = ByteProgress::new(watch, count as u64);
    let (mut passed, mut word) = (0usize, Vec::with_capacity(32));
    let truncated = |have: usize| {
        Error::file(
            path,
            format!("contains {have} of {count} values: it is truncated or not text"),
        )
    };
    loop {
        let bytes = reader.fill_buf().map_err(|e| read_error(path, e))?;
        let (used, end) = (bytes.len(), bytes.is_empty());
        let before = values.len();
        for &byte in bytes.iter().chain(if end { Some(&b' ') } else { None }) {
            if !byte.is_ascii_whitespace() && byte != b',' {
                word.push(byte);
                if word.len() > LONGEST {
                    return Err(truncated(values.len()));
                }
                continue;
            }
            if word.is_empty() || values.len() == count {
                word.clear();
                continue;
            }
            // Integers may be written with a decimal point.
            let text = std::str::from_utf8(&word).ok();
            let value = text
                .and_then(|t| t.parse::<T>().ok().or_else(|| t.parse::<f64>().ok().map(cast)))
                .ok_or_else(|| truncated(values.len()))?;
            word.clear();
            if passed < ahead {
                passed += 1;
            } else {
                values.push(value);
            }
        }
        meter.add((values.len() - before) as u64)?;
        reader.consume(used);
        if values.len() == count {
            return Ok(values);
        }
        if end {
            return Err(truncated(values.len()));
        }
    }
}
