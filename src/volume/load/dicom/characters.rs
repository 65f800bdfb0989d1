//! Text in the character sets of DICOM, with and without code extensions.
//!
//! Source: DICOM PS3.3 C.12.1.1.2 (defined terms and escape sequences), PS3.5 6.1.2.5 (where the
//! initial character set is restored).

use dicom_core::VR;
use encoding_rs::{
    EUC_JP, EUC_KR, Encoding, GB18030, ISO_8859_2, ISO_8859_3, ISO_8859_4, ISO_8859_5, ISO_8859_6,
    ISO_8859_7, ISO_8859_8, ISO_8859_15, SHIFT_JIS, UTF_8, WINDOWS_874, WINDOWS_1252, WINDOWS_1254,
};
use std::borrow::Cow;

const ESCAPE: u8 = 0x1b;

/// A set of characters, and how its bytes become those of an [`Encoding`].
#[derive(Clone, Copy, PartialEq)]
enum Set {
    /// Bytes as they are.
    Plain(&'static Encoding),
    /// JIS X 0208: two bytes, with the high bits clear.
    Jis0208,
    /// JIS X 0212: two bytes, with the high bits clear.
    Jis0212,
}

/// The character set of a data set: the initial one, which applies to text without escapes.
#[derive(Clone)]
pub struct CharacterSet {
    /// None if it is not stated, or not known.
    initial: Option<Set>,
    /// Whether escape sequences switch to other sets.
    extended: bool,
}

impl Default for CharacterSet {
    fn default() -> Self {
        Self {
            initial: None,
            extended: true,
        }
    }
}

impl CharacterSet {
    /// From the values of Specific Character Set.
    pub fn of(names: &[String]) -> Self {
        let initial = names.first().and_then(|n| named(n));
        // Encodings of several bytes may contain the escape byte's neighbours, but no escapes.
        let whole = matches!(initial, Some(Set::Plain(e)) if e == UTF_8 || e == GB18030);
        Self {
            initial,
            extended: !whole || names.len() > 1,
        }
    }

    /// Text of a value.
    pub fn decode(&self, bytes: &[u8], vr: VR) -> String {
        if !self.extended || !bytes.contains(&ESCAPE) {
            return plain(self.initial, bytes);
        }
        let mut text = String::with_capacity(bytes.len());
        let (mut set, mut run, mut at) = (self.initial, 0, 0);
        while at < bytes.len() {
            let rest = &bytes[at..];
            if rest[0] == ESCAPE
                && let Some((next, length)) = escape(&rest[1..])
            {
                text += &plain(set, &bytes[run..at]);
                set = next;
                at += 1 + length;
                run = at;
                continue;
            }
            // In a set of two bytes, the bytes of a character are no delimiters.
            let double = matches!(set, Some(Set::Jis0208 | Set::Jis0212)) && rest[0] > 0x20;
            let delimiter = match rest[0] {
                b'\n' | b'\r' | b'\t' | 0x0c => true,
                b'\\' => !double && !matches!(vr, VR::ST | VR::LT | VR::UT),
                b'^' | b'=' => !double && vr == VR::PN,
                _ => false,
            };
            if delimiter {
                text += &plain(set, &bytes[run..at]);
                set = self.initial;
                run = at;
            }
            at += if double { 2 } else { 1 };
        }
        text + &plain(set, &bytes[run.min(bytes.len())..])
    }
}

/// The set with a defined term.
fn named(term: &str) -> Option<Set> {
    // Its number, however the rest of it is spelt.
    let number = term
        .trim()
        .rsplit_once("IR")
        .map_or(term, |(_, number)| number)
        .trim_matches(['_', ' ', '-']);
    Some(Set::Plain(match number {
        "6" => return None,
        "13" => SHIFT_JIS,
        "87" => return Some(Set::Jis0208),
        "159" => return Some(Set::Jis0212),
        "100" => WINDOWS_1252,
        "101" => ISO_8859_2,
        "109" => ISO_8859_3,
        "110" => ISO_8859_4,
        "126" => ISO_8859_7,
        "127" => ISO_8859_6,
        "138" => ISO_8859_8,
        "144" => ISO_8859_5,
        "148" => WINDOWS_1254,
        "149" => EUC_KR,
        "166" => WINDOWS_874,
        "192" => UTF_8,
        "203" => ISO_8859_15,
        "58" | "GB18030" | "GBK" | "GB2312" => GB18030,
        _ => return None,
    }))
}

/// The set that an escape sequence selects, given the bytes after the escape, and their number.
fn escape(rest: &[u8]) -> Option<(Option<Set>, usize)> {
    let plain = |encoding| Some(Set::Plain(encoding));
    Some(match rest {
        [b'(', b'B', ..] => (None, 2),
        [b'(', b'J', ..] | [b')', b'I', ..] => (plain(SHIFT_JIS), 2),
        [b'-', b'A', ..] => (plain(WINDOWS_1252), 2),
        [b'-', b'B', ..] => (plain(ISO_8859_2), 2),
        [b'-', b'C', ..] => (plain(ISO_8859_3), 2),
        [b'-', b'D', ..] => (plain(ISO_8859_4), 2),
        [b'-', b'L', ..] => (plain(ISO_8859_5), 2),
        [b'-', b'G', ..] => (plain(ISO_8859_6), 2),
        [b'-', b'F', ..] => (plain(ISO_8859_7), 2),
        [b'-', b'H', ..] => (plain(ISO_8859_8), 2),
        [b'-', b'M', ..] => (plain(WINDOWS_1254), 2),
        [b'-', b'T', ..] => (plain(WINDOWS_874), 2),
        [b'-', b'b', ..] => (plain(ISO_8859_15), 2),
        [b'$', b'B', ..] => (Some(Set::Jis0208), 2),
        [b'$', b'(', b'D', ..] => (Some(Set::Jis0212), 3),
        [b'$', b')', b'C', ..] => (plain(EUC_KR), 3),
        [b'$', b')', b'A', ..] => (plain(GB18030), 3),
        _ => return None,
    })
}

/// Text without escapes. Without a stated set, text beyond ASCII is UTF-8 if it can be, else Latin
/// 1.
fn plain(set: Option<Set>, bytes: &[u8]) -> String {
    let decoded = |encoding: &'static Encoding, bytes: &[u8]| {
        encoding.decode_without_bom_handling(bytes).0.into_owned()
    };
    match set {
        None => match std::str::from_utf8(bytes) {
            Ok(text) => text.to_owned(),
            Err(_) => decoded(WINDOWS_1252, bytes),
        },
        // Romaji differs from ASCII in two characters, which are shown as ASCII.
        Some(Set::Plain(encoding)) => decoded(encoding, bytes),
        Some(Set::Jis0208) => decoded(EUC_JP, &high(bytes, false)),
        Some(Set::Jis0212) => decoded(EUC_JP, &high(bytes, true)),
    }
}

/// Pairs of bytes of 7 bits in the form of EUC-JP.
fn high(bytes: &[u8], third: bool) -> Cow<'_, [u8]> {
    let mut out = Vec::with_capacity(bytes.len() * 3 / 2);
    let mut rest = bytes;
    while let [a, tail @ ..] = rest {
        match tail {
            [b, tail @ ..] if (0x21..=0x7e).contains(a) && (0x21..=0x7e).contains(b) => {
                if third {
                    out.push(0x8f);
                }
                out.extend([a | 0x80, b | 0x80]);
                rest = tail;
            }
            _ => {
                out.push(*a);
                rest = tail;
            }
        }
    }
    out.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(names: &[&str], bytes: &[u8], vr: VR) -> String {
        let names: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
        CharacterSet::of(&names).decode(bytes, vr)
    }

    /// The examples of DICOM PS3.5 H.3, I.2, J.3 and K.2.
    #[test]
    fn names_of_the_standard() {
        let yamada = b"Yamada^Tarou=\x1b$B;3ED\x1b(B^\x1b$BB@O:\x1b(B=\x1b$B$d$^$@\x1b(B^\x1b$B$?$m$&\x1b(B";
        assert_eq!(
            decoded(&["", "ISO 2022 IR 87"], yamada, VR::PN),
            "Yamada^Tarou=山田^太郎=やまだ^たろう"
        );
        let katakana = b"\xd4\xcf\xc0\xde^\xc0\xdb\xb3=\x1b$B;3ED\x1b(J^\x1b$BB@O:\x1b(J";
        assert_eq!(
            decoded(&["ISO 2022 IR 13", "ISO 2022 IR 87"], katakana, VR::PN),
            "ﾔﾏﾀﾞ^ﾀﾛｳ=山田^太郎"
        );
        let hong =
            b"Hong^Gildong=\x1b$)C\xfb\xf3^\x1b$)C\xd1\xce\xd4\xd7=\x1b$)C\xc8\xab^\x1b$)C\xb1\xe6\xb5\xbf";
        assert_eq!(
            decoded(&["", "ISO 2022 IR 149"], hong, VR::PN),
            "Hong^Gildong=洪^吉洞=홍^길동"
        );
        let wang = b"Wang^XiaoDong=\xcd\xf5^\xd0\xa1\xb6\xab=";
        assert_eq!(decoded(&["GB18030"], wang, VR::PN), "Wang^XiaoDong=王^小东=");
    }

    #[test]
    fn text_without_a_stated_set() {
        assert_eq!(decoded(&[], b"Sch\xe4del", VR::LO), "Schädel");
        assert_eq!(decoded(&[], "Schädel".as_bytes(), VR::LO), "Schädel");
        assert_eq!(decoded(&["ISO_IR 144"], b"\xbb\xee", VR::LO), "Лю");
        assert_eq!(
            decoded(&["ISO 2022 IR 6", "ISO 2022 IR 87"], b"\x1b$BF,It\x1b(B", VR::LO),
            "頭部"
        );
    }
}
