//! Paths as text and back. Scenes and options hold text, file systems hold bytes: a byte that is
//! not UTF-8 becomes a character of Unicode's private use area (U+F780 to U+F7FF, as in MirBSD and
//! others) and is converted back to that byte, so that every file can be named, opened and saved.

use std::path::{Path, PathBuf};

#[cfg(unix)]
const PRIVATE: u32 = 0xF700;

/// A path as text.
pub fn text_of(path: &Path) -> String {
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        let mut text = String::new();
        for chunk in path.as_os_str().as_bytes().utf8_chunks() {
            text.push_str(chunk.valid());
            text.extend(
                chunk
                    .invalid()
                    .iter()
                    .filter_map(|b| char::from_u32(PRIVATE + u32::from(*b))),
            );
        }
        text
    }
    #[cfg(not(unix))]
    path.to_string_lossy().into_owned()
}

/// The path that a text represents.
pub fn path_of(text: &str) -> PathBuf {
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStringExt;
        let private = |c: char| (PRIVATE + 0x80..=PRIVATE + 0xFF).contains(&u32::from(c));
        if !text.contains(private) {
            return PathBuf::from(text);
        }
        let mut bytes = Vec::with_capacity(text.len());
        for c in text.chars() {
            if private(c) {
                bytes.push((u32::from(c) - PRIVATE) as u8);
            } else {
                bytes.extend_from_slice(c.encode_utf8(&mut [0; 4]).as_bytes());
            }
        }
        PathBuf::from(std::ffi::OsString::from_vec(bytes))
    }
    #[cfg(not(unix))]
    PathBuf::from(text)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    #[test]
    fn every_name_comes_back() {
        for bytes in [
            &b"plain.nii"[..],
            "größe.nii".as_bytes(),
            b"caf\xe9 \xff.nii",
            b"\xc3",
            b"a/\x80\x81/b",
        ] {
            let path = Path::new(OsStr::from_bytes(bytes));
            assert_eq!(path_of(&text_of(path)), path);
        }
    }
}
