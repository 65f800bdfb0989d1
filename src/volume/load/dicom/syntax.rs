//! Transfer syntaxes: their names, and their maximum compression.

use super::super::source::DEFLATE_LIMIT;
use dicom_encoding::transfer_syntax::TransferSyntaxIndex;
use dicom_transfer_syntax_registry::TransferSyntaxRegistry;

/// Little endian: implicit VR, explicit VR, and deflated explicit VR.
pub const IMPLICIT: &str = "1.2.840.10008.1.2";
pub const EXPLICIT: &str = "1.2.840.10008.1.2.1";
pub const DEFLATED: &str = "1.2.840.10008.1.2.1.99";
/// Explicit VR big endian.
pub const BIG_ENDIAN: &str = "1.2.840.10008.1.2.2";
/// RLE lossless.
pub const RLE: &str = "1.2.840.10008.1.2.5";
/// GE's private syntax: implicit VR little endian, but pixels in big endian.
pub const GE_BIG_ENDIAN_PIXELS: &str = "1.2.840.113619.5.2";
/// The JPEG syntaxes: four lossy ones (baseline, extended, spectral selection, progressive), then
/// two lossless ones.
pub const JPEG: [&str; 6] = [
    "1.2.840.10008.1.2.4.50",
    "1.2.840.10008.1.2.4.51",
    "1.2.840.10008.1.2.4.53",
    "1.2.840.10008.1.2.4.55",
    "1.2.840.10008.1.2.4.57",
    "1.2.840.10008.1.2.4.70",
];
/// JPEG 2000, lossless only and general, and the multi-component syntaxes.
pub const JPEG_2000: [&str; 4] = [
    "1.2.840.10008.1.2.4.90",
    "1.2.840.10008.1.2.4.91",
    "1.2.840.10008.1.2.4.92",
    "1.2.840.10008.1.2.4.93",
];
/// JPEG-LS, lossless and near-lossless.
pub const JPEG_LS: [&str; 2] = ["1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2.4.81"];
/// Size of a frame up to which a single-coloured image is accepted at any compression ratio, bytes.
const SMALL_FRAME: usize = 64 << 20;

/// The maximum compression ratio of pixels in a transfer syntax, for frames of a given size.
pub fn max_compression_ratio(syntax: &str, frame_bytes: usize) -> u64 {
    match syntax {
        IMPLICIT | EXPLICIT | BIG_ENDIAN | GE_BIG_ENDIAN_PIXELS => 1,
        DEFLATED => DEFLATE_LIMIT,
        // A run of 128 takes two bytes.
        RLE => 64,
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
