//! Transfer syntaxes: their names, and how much they can pack.

use super::super::source::DEFLATE_LIMIT;
use dicom_encoding::transfer_syntax::TransferSyntaxIndex;
use dicom_transfer_syntax_registry::TransferSyntaxRegistry;

/// JPEG in its kinds: baseline, extended, lossless.
pub const JPEG: [&str; 6] = [
    "1.2.840.10008.1.2.4.50",
    "1.2.840.10008.1.2.4.51",
    "1.2.840.10008.1.2.4.53",
    "1.2.840.10008.1.2.4.55",
    "1.2.840.10008.1.2.4.57",
    "1.2.840.10008.1.2.4.70",
];
/// JPEG 2000, lossless only and not, and its multi-component kinds.
pub const JPEG_2000: [&str; 4] = ["1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.91", "1.2.840.10008.1.2.4.92", "1.2.840.10008.1.2.4.93"];
/// Bytes of a frame up to which a picture of one colour is believed, whatever it was packed to.
const SMALL_FRAME: usize = 64 << 20;

/// The most that pixels can have been packed by in a transfer syntax, in frames of some bytes.
pub fn max_compression_ratio(syntax: &str, frame_bytes: usize) -> u64 {
    match syntax {
        "1.2.840.10008.1.2" | "1.2.840.10008.1.2.1" | "1.2.840.10008.1.2.2" => 1,
        "1.2.840.10008.1.2.1.99" => DEFLATE_LIMIT,
        // A run of 128 takes two bytes.
        "1.2.840.10008.1.2.5" => 64,
        _ if frame_bytes <= SMALL_FRAME => 20_000,
        _ => 1000,
    }
}

/// A transfer syntax by name, for messages and `info`.
pub fn syntax_name(uid: &str) -> String {
    match TransferSyntaxRegistry.get(uid) {
        Some(syntax) => format!("{} ({uid})", syntax.name()),
        None => uid.to_owned(),
    }
}
