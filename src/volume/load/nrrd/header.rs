//! The header of an NRRD file: its fields, and the words and vectors in them.

use super::super::source::read_error;
use crate::{Error, Result};
use glam::DVec3;
use std::collections::HashMap;
use std::io::{BufRead, Read};
use std::path::Path;

/// Maximum header length, bytes: a file without an empty line is not NRRD.
const MAX_HEADER_BYTES: u64 = 1 << 20;
/// Key of the lines after `data file: LIST`.
pub(super) const LIST_KEY: &str = "\n";

/// The fields of the header, with names in lower case; leaves the reader after the empty line that
/// ends the header.
pub(super) fn header(path: &Path, reader: &mut impl BufRead) -> Result<HashMap<String, String>> {
    let mut fields = HashMap::new();
    let mut reader = reader.take(MAX_HEADER_BYTES);
    let mut line = Vec::new();
    let (mut first, mut list) = (true, false);
    loop {
        line.clear();
        let read = reader
            .read_until(b'\n', &mut line)
            .map_err(|e| read_error(path, e))?;
        let text = String::from_utf8_lossy(&line);
        let text = text.trim_end_matches(['\n', '\r']);
        if first {
            if !text.starts_with("NRRD000") {
                return Err(Error::file(
                    path,
                    "is not an NRRD file (it does not start with NRRD000)",
                ));
            }
            first = false;
            continue;
        }
        if text.is_empty() {
            if read == 0 && !fields.contains_key("data file") && !fields.contains_key("datafile") {
                return Err(Error::file(
                    path,
                    "ends within its header: the file is truncated; copy or download it again",
                ));
            }
            return Ok(fields);
        }
        if list {
            let files = fields.entry(LIST_KEY.to_owned()).or_default();
            files.push_str(text);
            files.push('\n');
            continue;
        }
        if text.starts_with('#') {
            continue;
        }
        if let Some((name, value)) = text.split_once(":=").or_else(|| text.split_once(": ")) {
            let name = name.trim().to_ascii_lowercase();
            // Nothing else follows a list of files.
            list = matches!(name.as_str(), "data file" | "datafile") && value.trim().starts_with("LIST");
            fields.insert(name, value.trim().to_owned());
        }
    }
}

/// A field's value; an error if it is missing.
pub(super) fn required<'a>(path: &Path, fields: &'a HashMap<String, String>, name: &str) -> Result<&'a str> {
    let missing = || {
        Error::file(
            path,
            format!("has no field \"{name}\" in its header; it is damaged"),
        )
    };
    fields.get(name).map(String::as_str).ok_or_else(missing)
}

/// A vector of two or three components, `(a,b,c)`.
pub(super) fn vector(text: &str) -> Option<DVec3> {
    let inner = text.trim().strip_prefix('(')?.strip_suffix(')')?;
    let v: Vec<f64> = inner.split(',').map_while(|c| c.trim().parse().ok()).collect();
    match v[..] {
        [x, y, z] => Some(DVec3::new(x, y, z)),
        [x, y] => Some(DVec3::new(x, y, 0.0)),
        _ => None,
    }
}

/// Splits `(a,b,c) (d, e, f) none` into words.
pub(super) fn words(text: &str) -> Vec<String> {
    let mut out = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        let end = if rest.starts_with('(') {
            rest.find(')').map_or(rest.len(), |e| e + 1)
        } else {
            rest.find(char::is_whitespace).unwrap_or(rest.len())
        };
        out.push(rest[..end].to_owned());
        rest = rest[end..].trim_start();
    }
    out
}
