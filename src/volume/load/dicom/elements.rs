//! The elements of a data set, read tolerantly: what the bytes say is believed before what the
//! transfer syntax says.
//!
//! `dicom-object` holds the result, but its parser refuses a whole file for data sets that
//! contradict their transfer syntax and for elements of VR UN that hold sequences, which scanners
//! and archives write. Every length is checked against the object's end before its value is read.
//!
//! Source: DICOM PS3.5 6.2.2 (UN: items in implicit VR, little endian), 7.1 and 7.5.

use super::characters::CharacterSet;
use super::location::Bytes;
use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry};
use dicom_core::value::{C, DataSetSequence, PrimitiveValue, Value};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::{StandardDataDictionary, tags};
use dicom_object::InMemDicomObject;
use std::io::{Read, Seek};
use std::str::FromStr;

/// Maximum nesting depth of sequences.
const MAX_NESTED_SEQUENCES: usize = 64;
/// Binary values longer than this are not kept, bytes: none of them is used.
const MAX_BINARY_BYTES: u32 = 4 << 20;
/// The length that means "up to a delimiter".
const UNDEFINED: u32 = u32::MAX;
const ITEM: Tag = Tag(0xfffe, 0xe000);
const ITEM_END: Tag = Tag(0xfffe, 0xe00d);
const SEQUENCE_END: Tag = Tag(0xfffe, 0xe0dd);
/// The elements that may hold the pixels of an object.
const PIXELS: [Tag; 3] = [
    tags::PIXEL_DATA,
    tags::FLOAT_PIXEL_DATA,
    tags::DOUBLE_FLOAT_PIXEL_DATA,
];

/// How elements are encoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoding {
    pub explicit: bool,
    pub big_endian: bool,
}

impl Encoding {
    pub const IMPLICIT: Self = Self {
        explicit: false,
        big_endian: false,
    };

    /// The encoding in which the first element of a data set is plausible; by default the declared
    /// one. `rest`: number of bytes after the header.
    fn seen(self, head: [u8; 8], rest: u64) -> Self {
        // Data sets and items start with one of the lowest groups.
        let big_endian = match (head[0], head[1]) {
            (0, 1..=0x28) => true,
            (1..=0x28, 0) => false,
            _ => self.big_endian,
        };
        let length = [head[4], head[5], head[6], head[7]];
        let length = if big_endian {
            u32::from_be_bytes(length)
        } else {
            u32::from_le_bytes(length)
        };
        let implicit_fits = length == UNDEFINED || u64::from(length) <= rest;
        Self {
            explicit: known_vr(&head[4..6]).is_some() || self.explicit && !implicit_fits,
            big_endian,
        }
    }
}

/// The pixel data element of an object.
#[derive(Clone, Copy, Debug)]
pub struct PixelElement {
    /// Offset of its value in the object's bytes.
    pub offset: u64,
    /// Length of its value, bytes; none if it consists of items.
    pub length: Option<u32>,
    /// Whether the most significant byte of its values comes first.
    pub big_endian: bool,
}

/// The elements of a data set before its pixels, and where these are.
pub struct DataSet {
    pub elements: InMemDicomObject,
    pub pixels: Option<PixelElement>,
}

/// Reads the elements of a data set, from the reader's position up to the pixels or the end.
pub fn data_set(reader: &mut Bytes, declared: Encoding) -> Result<DataSet, String> {
    let io = |e: std::io::Error| e.to_string();
    let position = reader.stream_position().map_err(io)?;
    let end = reader.seek(std::io::SeekFrom::End(0)).map_err(io)?;
    reader.seek(std::io::SeekFrom::Start(position)).map_err(io)?;
    let mut parser = Parser {
        reader,
        position,
        pixels: None,
    };
    let (elements, _) = parser.elements(declared, end, 0, &CharacterSet::default())?;
    Ok(DataSet {
        elements,
        pixels: parser.pixels,
    })
}

/// A value representation by its two letters.
fn known_vr(letters: &[u8]) -> Option<VR> {
    std::str::from_utf8(letters)
        .ok()
        .filter(|t| t.bytes().all(|b| b.is_ascii_uppercase()))
        .and_then(|t| VR::from_str(t).ok())
}

/// Whether a VR has a length of 32 bits in explicit encoding.
fn is_long(vr: VR) -> bool {
    use VR::*;
    matches!(vr, OB | OD | OF | OL | OV | OW | SQ | SV | UC | UN | UR | UT | UV)
}

/// The VR of an attribute whose element does not state it; private attributes as their vendors
/// document them.
fn vr_of(tag: Tag) -> VR {
    match (tag.0, tag.1 & 0xff) {
        (0x0019, 0x0a) if tag.1 >= 0x1000 => VR::US,
        (0x0019, 0x0c) | (0x0043, 0x39) if tag.1 >= 0x1000 => VR::IS,
        (0x0019, 0x0e) if tag.1 >= 0x1000 => VR::FD,
        (0x0019, 0xbb..=0xbd) if tag.1 >= 0x1000 => VR::DS,
        (0x2001, 0x03) | (0x2005, 0xb0..=0xb2) if tag.1 >= 0x1000 => VR::FL,
        (group, _) if group % 2 == 1 && (0x10..0x100).contains(&tag.1) => VR::LO,
        (group, _) if group % 2 == 1 => VR::UN,
        (_, 0) if tag.1 == 0 => VR::UL,
        _ => StandardDataDictionary
            .by_tag(tag)
            .map_or(VR::UN, |entry| entry.vr().relaxed()),
    }
}

/// The header of an element.
struct Header {
    tag: Tag,
    vr: VR,
    length: u32,
}

struct Parser<'a> {
    reader: &'a mut Bytes,
    position: u64,
    pixels: Option<PixelElement>,
}

impl Parser<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut bytes = [0u8; N];
        self.reader.read_exact(&mut bytes).map_err(|e| e.to_string())?;
        self.position += N as u64;
        Ok(bytes)
    }

    fn skip(&mut self, bytes: u64) -> Result<(), String> {
        self.reader
            .seek_relative(bytes as i64)
            .map_err(|e| e.to_string())?;
        self.position += bytes;
        Ok(())
    }

    fn back_to(&mut self, position: u64) -> Result<(), String> {
        self.reader
            .seek_relative(position as i64 - self.position as i64)
            .map_err(|e| e.to_string())?;
        self.position = position;
        Ok(())
    }

    fn value(&mut self, length: u32) -> Result<Vec<u8>, String> {
        let mut bytes = vec![0u8; length as usize];
        self.reader.read_exact(&mut bytes).map_err(|e| e.to_string())?;
        self.position += u64::from(length);
        Ok(bytes)
    }

    /// Reads elements up to `end`, a delimiter, or the pixels of the object; whether the delimiter
    /// ended the enclosing sequence as well.
    fn elements(
        &mut self,
        declared: Encoding,
        end: u64,
        depth: usize,
        inherited: &CharacterSet,
    ) -> Result<(InMemDicomObject, bool), String> {
        let mut set = InMemDicomObject::new_empty();
        let (mut encoding, mut characters) = (declared, inherited.clone());
        let mut first = true;
        while self.position + 8 <= end {
            let head = self.take::<8>()?;
            if head == [0; 8] && depth == 0 {
                // Padding after the last element.
                break;
            }
            if first && head[..4] != [0xfe, 0xff, 0x0d, 0xe0] {
                encoding = encoding.seen(head, end.saturating_sub(self.position));
                first = false;
            }
            let Header { tag, vr, length } = self.header(head, encoding, end)?;
            if tag == ITEM_END || tag == SEQUENCE_END {
                return Ok((set, tag == SEQUENCE_END));
            }
            if depth == 0 && PIXELS.contains(&tag) {
                self.pixels = Some(PixelElement {
                    offset: self.position,
                    length: (length != UNDEFINED).then_some(length),
                    big_endian: encoding.big_endian,
                });
                // Its tag says whether pixels are floating-point.
                set.put(DataElement::new(tag, vr, PrimitiveValue::Empty));
                break;
            }
            if tag.0 == 0xfffe {
                return Err("a data set holds an item outside of a sequence".into());
            }
            if length != UNDEFINED && u64::from(length) > end.saturating_sub(self.position) {
                return Err(format!("an element of {length} bytes goes beyond its end"));
            }
            let value = self.element_value(tag, vr, length, encoding, end, depth, &characters)?;
            if let (tags::SPECIFIC_CHARACTER_SET, Value::Primitive(names)) = (tag, &value) {
                characters = CharacterSet::of(&names.to_multi_str());
            }
            let vr = match &value {
                Value::Sequence(_) => VR::SQ,
                _ if vr == VR::UN => vr_of(tag),
                _ => vr,
            };
            set.put(DataElement::new(tag, vr, value));
        }
        Ok((set, false))
    }

    /// The header that starts with these bytes.
    fn header(&mut self, head: [u8; 8], encoding: Encoding, end: u64) -> Result<Header, String> {
        let word = |a: usize| {
            let b = [head[a], head[a + 1]];
            if encoding.big_endian {
                u16::from_be_bytes(b)
            } else {
                u16::from_le_bytes(b)
            }
        };
        let long = |b: [u8; 4]| {
            if encoding.big_endian {
                u32::from_be_bytes(b)
            } else {
                u32::from_le_bytes(b)
            }
        };
        let tag = Tag(word(0), word(2));
        let implicit_length = long([head[4], head[5], head[6], head[7]]);
        let fits =
            |length: u32| length == UNDEFINED || u64::from(length) <= end.saturating_sub(self.position);
        let implicit = Header {
            tag,
            vr: vr_of(tag),
            length: implicit_length,
        };
        let letters = head[4..6].iter().all(u8::is_ascii_uppercase);
        let vr = known_vr(&head[4..6]);
        // Delimiters and items have no VR.
        if tag.0 == 0xfffe
            || !encoding.explicit && (vr.is_none() || fits(implicit_length))
            || encoding.explicit && !letters && fits(implicit_length)
        {
            return Ok(implicit);
        }
        // Unknown representations have the long form, whose reserved bytes are 0.
        let long_form = vr.map_or(head[6..8] == [0, 0], is_long);
        let length = if long_form && self.position + 4 <= end {
            long(self.take::<4>()?)
        } else {
            u32::from(word(6))
        };
        Ok(Header {
            tag,
            vr: vr.unwrap_or(VR::UN),
            length,
        })
    }

    #[allow(clippy::too_many_arguments, reason = "the state of one element")]
    fn element_value(
        &mut self,
        tag: Tag,
        vr: VR,
        length: u32,
        encoding: Encoding,
        end: u64,
        depth: usize,
        characters: &CharacterSet,
    ) -> Result<Value<InMemDicomObject>, String> {
        let meant = if vr == VR::UN { vr_of(tag) } else { vr };
        let inner = if vr == VR::UN {
            Encoding::IMPLICIT
        } else {
            encoding
        };
        if length == UNDEFINED {
            // Compressed pixels of an icon.
            if matches!(vr, VR::OB | VR::OW) || PIXELS.contains(&tag) {
                self.skip_fragments(end)?;
                return Ok(PrimitiveValue::Empty.into());
            }
            return self.items(inner, end, depth, characters);
        }
        let value_end = self.position + u64::from(length);
        if meant == VR::SQ {
            let items = self.items(inner, value_end, depth, characters)?;
            self.back_to(value_end)?;
            return Ok(items);
        }
        if meant == VR::UN && length >= 8 {
            // A private sequence looks like one.
            let start = self.position;
            let head = self.take::<4>()?;
            self.back_to(start)?;
            if head == [0xfe, 0xff, 0x00, 0xe0] {
                let read = self.items(inner, value_end, depth, characters);
                let at_end = self.position == value_end;
                self.back_to(value_end)?;
                return Ok(read
                    .ok()
                    .filter(|_| at_end)
                    .unwrap_or_else(|| PrimitiveValue::Empty.into()));
            }
        }
        if length > MAX_BINARY_BYTES && matches!(meant, VR::OB | VR::OW | VR::UN | VR::OF | VR::OD | VR::OL) {
            self.skip(u64::from(length))?;
            return Ok(PrimitiveValue::Empty.into());
        }
        let bytes = self.value(length)?;
        Ok(primitive(meant, &bytes, inner.big_endian, characters).into())
    }

    /// The items of a sequence up to `end` or its delimiter.
    fn items(
        &mut self,
        declared: Encoding,
        end: u64,
        depth: usize,
        characters: &CharacterSet,
    ) -> Result<Value<InMemDicomObject>, String> {
        // Items are read by recursion.
        if depth == MAX_NESTED_SEQUENCES {
            return Err(format!("its sequences are more than {MAX_NESTED_SEQUENCES} deep"));
        }
        let mut items: Vec<InMemDicomObject> = Vec::new();
        while self.position + 8 <= end {
            let head = self.take::<8>()?;
            let big_endian = head[..2] == [0xff, 0xfe];
            let (tag, length) = if big_endian {
                (
                    Tag(0xfffe, u16::from_be_bytes([head[2], head[3]])),
                    u32::from_be_bytes([head[4], head[5], head[6], head[7]]),
                )
            } else {
                (
                    Tag(
                        u16::from_le_bytes([head[0], head[1]]),
                        u16::from_le_bytes([head[2], head[3]]),
                    ),
                    u32::from_le_bytes([head[4], head[5], head[6], head[7]]),
                )
            };
            match tag {
                SEQUENCE_END => break,
                ITEM_END => continue,
                ITEM => {}
                _ => return Err("a sequence holds an element outside of its items".into()),
            }
            let encoding = Encoding {
                big_endian,
                ..declared
            };
            if length == UNDEFINED {
                let (item, ended) = self.elements(encoding, end, depth + 1, characters)?;
                items.push(item);
                if ended {
                    break;
                }
                continue;
            }
            let item_end = self.position + u64::from(length);
            if item_end > end {
                return Err(format!("an item of {length} bytes goes beyond its end"));
            }
            let (item, _) = self.elements(encoding, item_end, depth + 1, characters)?;
            self.back_to(item_end)?;
            items.push(item);
        }
        Ok(Value::Sequence(DataSetSequence::from(items)))
    }

    /// Skips the fragments of a compressed value.
    fn skip_fragments(&mut self, end: u64) -> Result<(), String> {
        while self.position + 8 <= end {
            let head = self.take::<8>()?;
            let length = u32::from_le_bytes([head[4], head[5], head[6], head[7]]);
            if head[..4] != [0xfe, 0xff, 0x00, 0xe0] {
                return Ok(());
            }
            if u64::from(length) > end.saturating_sub(self.position) {
                return Err(format!("a fragment of {length} bytes goes beyond its end"));
            }
            self.skip(u64::from(length))?;
        }
        Ok(())
    }
}

/// A value from its bytes.
fn primitive(vr: VR, bytes: &[u8], big_endian: bool, characters: &CharacterSet) -> PrimitiveValue {
    macro_rules! numbers {
        ($variant:ident, $t:ty) => {
            PrimitiveValue::$variant(
                bytes
                    .chunks_exact(size_of::<$t>())
                    .map(|c| {
                        let mut b = [0u8; size_of::<$t>()];
                        b.copy_from_slice(c);
                        if big_endian {
                            <$t>::from_be_bytes(b)
                        } else {
                            <$t>::from_le_bytes(b)
                        }
                    })
                    .collect::<C<$t>>(),
            )
        };
    }
    match vr {
        _ if bytes.is_empty() => PrimitiveValue::Empty,
        VR::US | VR::OW => numbers!(U16, u16),
        VR::SS => numbers!(I16, i16),
        VR::UL | VR::OL => numbers!(U32, u32),
        VR::SL => numbers!(I32, i32),
        VR::UV | VR::OV => numbers!(U64, u64),
        VR::SV => numbers!(I64, i64),
        VR::FL | VR::OF => numbers!(F32, f32),
        VR::FD | VR::OD => numbers!(F64, f64),
        VR::AT => PrimitiveValue::Tags(
            bytes
                .chunks_exact(4)
                .map(|c| {
                    let word = |a: usize| match big_endian {
                        true => u16::from_be_bytes([c[a], c[a + 1]]),
                        false => u16::from_le_bytes([c[a], c[a + 1]]),
                    };
                    Tag(word(0), word(2))
                })
                .collect(),
        ),
        VR::OB | VR::UN | VR::SQ => PrimitiveValue::U8(C::from_slice(bytes)),
        VR::ST | VR::LT | VR::UT => PrimitiveValue::Str(characters.decode(bytes, vr)),
        VR::UR => PrimitiveValue::Str(String::from_utf8_lossy(bytes).into_owned()),
        VR::SH | VR::LO | VR::UC | VR::PN => PrimitiveValue::Strs(values(&characters.decode(bytes, vr))),
        _ => PrimitiveValue::Strs(values(&String::from_utf8_lossy(bytes))),
    }
}

/// The values of a text, without padding.
fn values(text: &str) -> C<String> {
    text.trim_end_matches(['\0', ' '])
        .split('\\')
        .map(|v| v.trim_matches(['\0', ' ']).to_owned())
        .collect()
}
