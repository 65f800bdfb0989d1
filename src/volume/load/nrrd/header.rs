//! The header of an NRRD file: its fields, its keys, and the words and vectors in them.

use super::super::source::read_error;
use crate::{Error, Result};
use glam::DVec3;
use std::collections::HashMap;
use std::io::{BufRead, Read};
use std::path::Path;

/// Maximum header length, bytes: a file without an empty line is not NRRD.
const MAX_HEADER_BYTES: u64 = 1 << 20;
/// The newest version of the format.
const NEWEST_VERSION: u32 = 5;

/// The fields of the format; each may be written without its blanks.
const FIELDS: [&str; 30] = [
    "content",
    "number",
    "type",
    "block size",
    "dimension",
    "space",
    "space dimension",
    "sizes",
    "spacings",
    "thicknesses",
    "axis mins",
    "axis maxs",
    "space directions",
    "centerings",
    "kinds",
    "labels",
    "units",
    "min",
    "max",
    "old min",
    "old max",
    "endian",
    "encoding",
    "line skip",
    "byte skip",
    "sample units",
    "space units",
    "space origin",
    "measurement frame",
    "data file",
];

/// What a header states.
#[derive(Default)]
pub(super) struct Header {
    /// Fields (`field: value`) by their names in lower case, as written in the format definition.
    pub fields: HashMap<String, String>,
    /// Keys (`key:=value`) by their names in lower case, with escapes resolved.
    pub keys: HashMap<String, String>,
    /// The lines after `data file: LIST`.
    pub list: Vec<String>,
    /// Irregularities, one sentence each.
    pub warnings: Vec<String>,
}

/// Reads the header; leaves the reader after the empty line that ends it.
pub(super) fn header(path: &Path, reader: &mut impl BufRead) -> Result<Header> {
    let fail = |problem: String| Error::file(path, problem);
    let mut header = Header::default();
    let mut reader = reader.take(MAX_HEADER_BYTES);
    let mut line = Vec::new();
    let (mut first, mut list) = (true, false);
    loop {
        line.clear();
        let read = reader
            .read_until(b'\n', &mut line)
            .map_err(|e| read_error(path, e))?;
        let text = String::from_utf8_lossy(&line);
        let text = text.trim_end();
        if first {
            header.check_version(text).map_err(fail)?;
            first = false;
            continue;
        }
        if text.is_empty() {
            if read == 0 && !header.fields.contains_key("data file") {
                return Err(fail(if reader.limit() == 0 {
                    format!("has a header of more than {MAX_HEADER_BYTES} bytes: no empty line ends it")
                } else {
                    "ends within its header: the file is truncated; copy or download it again".into()
                }));
            }
            return Ok(header);
        }
        if list {
            header.list.push(text.trim().to_owned());
        } else if !text.starts_with('#') {
            header.line(text).map_err(fail)?;
            // Nothing else follows a list of files.
            list = header
                .fields
                .get("data file")
                .is_some_and(|f| f.starts_with("LIST"));
        }
    }
}

impl Header {
    /// Checks the first line, `NRRD0004`; `NRRD00.01` is the oldest version.
    fn check_version(&mut self, text: &str) -> Result<(), String> {
        let version = text.strip_prefix("NRRD").map(|v| v.replace('.', ""));
        let Some(version) = version.and_then(|v| v.trim().parse::<u32>().ok()) else {
            return Err("is not an NRRD file (it does not start with NRRD000)".into());
        };
        if version > NEWEST_VERSION {
            self.warnings.push(format!(
                "is of version {version} of NRRD; it is read as version {NEWEST_VERSION}, the newest known one"
            ));
        }
        Ok(())
    }

    /// Reads `field: value` or `key:=value`. Key names may contain colons.
    fn line(&mut self, text: &str) -> Result<(), String> {
        let Some((name, value)) = text.split_once(':') else {
            return Ok(());
        };
        if !value.starts_with('=')
            && let Some(field) = canonical(name)
        {
            let value = value.trim().to_owned();
            if let Some(other) = self.fields.insert(field.to_owned(), value.clone())
                && other != value
            {
                return Err(format!(
                    "states the field \"{field}\" twice, as \"{other}\" and as \"{value}\"; remove one of the two lines"
                ));
            }
            return Ok(());
        }
        if let Some((key, value)) = text.split_once(":=") {
            self.keys
                .insert(unescaped(key).trim().to_ascii_lowercase(), unescaped(value));
        }
        Ok(())
    }

    /// A field's value.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.fields.get(name).map(String::as_str)
    }
}

/// The name of a field as in the format definition; none if there is no such field.
fn canonical(name: &str) -> Option<&'static str> {
    let plain = |text: &str| text.replace([' ', '\t'], "").to_ascii_lowercase();
    let name = match plain(name).as_str() {
        "centers" => "centerings".to_owned(),
        other => other.to_owned(),
    };
    FIELDS.into_iter().find(|field| plain(field) == name)
}

/// The text of a key or its value: `\n` is a line break and `\\` a backslash.
fn unescaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut characters = text.chars().peekable();
    while let Some(c) = characters.next() {
        let escaped = match (c, characters.peek()) {
            ('\\', Some('n')) => Some('\n'),
            ('\\', Some('\\')) => Some('\\'),
            _ => None,
        };
        out.push(escaped.unwrap_or(c));
        if escaped.is_some() {
            characters.next();
        }
    }
    out
}

/// A field's value; an error if it is missing.
pub(super) fn required<'a>(path: &Path, header: &'a Header, name: &str) -> Result<&'a str> {
    header.get(name).ok_or_else(|| {
        Error::file(
            path,
            format!("has no field \"{name}\" in its header; it is damaged"),
        )
    })
}

/// A vector of two to four components, `(a,b,c)`; a fourth one, of time, is left out.
pub(super) fn vector(text: &str) -> Option<DVec3> {
    let inner = text.trim().strip_prefix('(')?.strip_suffix(')')?;
    let v: Vec<f64> = inner
        .split(',')
        .map(|c| c.trim().parse().ok())
        .collect::<Option<_>>()?;
    match v[..] {
        [x, y, z] | [x, y, z, _] => Some(DVec3::new(x, y, z)),
        [x, y] => Some(DVec3::new(x, y, 0.0)),
        _ => None,
    }
}

/// Splits `(a,b,c) (d, e, f) none "a unit"` into words; quotes belong to their word.
pub(super) fn words(text: &str) -> Vec<String> {
    let mut out = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        let closed = |by: char| rest[1..].find(by).map_or(rest.len(), |e| e + 2);
        let end = if rest.starts_with('(') {
            closed(')')
        } else if rest.starts_with('"') {
            closed('"')
        } else {
            rest.find(char::is_whitespace).unwrap_or(rest.len())
        };
        out.push(rest[..end].to_owned());
        rest = rest[end..].trim_start();
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_and_keys() {
        let text = "NRRD0005\r\n# a comment\r\nsizes:5 6 4\r\naxismins: 0 0 0\r\ncontent: a:=b\r\nspace units: \"m m\" \"mm\"\r\na: b:=c\\nd\\\\n\r\n\r\nx";
        let header = header(Path::new("a.nrrd"), &mut text.as_bytes()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(header.get("sizes"), Some("5 6 4"));
        assert_eq!(header.get("axis mins"), Some("0 0 0"));
        assert_eq!(header.get("content"), Some("a:=b"));
        assert_eq!(header.keys.get("a: b").map(String::as_str), Some("c\nd\\n"));
        assert_eq!(words(header.get("space units").unwrap_or_default()).len(), 2);
    }

    #[test]
    fn a_field_stated_twice_is_refused() {
        let text = "NRRD0005\nsizes: 5 6 4\nsizes: 6 5 4\n\n";
        let error = header(Path::new("a.nrrd"), &mut text.as_bytes()).err();
        assert!(error.is_some_and(|e| e.to_string().contains("\"sizes\" twice")));
    }
}
