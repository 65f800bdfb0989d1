//! A picture as a secondary capture (PS3.3 A.8.1).

use super::attributes::{Derivation, StorageClass, image};
use dicom_core::VR;
use dicom_dictionary_std::tags;

/// The bytes of a DICOM file with a picture: 8 bits of red, green and blue, rows from the top.
///
/// # Errors
/// A picture of more than 65,535 pixels along an edge, or of another size than its bytes.
pub fn secondary_capture(
    rgb: Vec<u8>,
    [width, height]: [u32; 2],
    derivation: &Derivation,
) -> Result<Vec<u8>, String> {
    let (Ok(columns), Ok(rows)) = (u16::try_from(width), u16::try_from(height)) else {
        return Err(format!(
            "a DICOM picture has at most 65535 pixels along an edge, not {width} x {height}"
        ));
    };
    if rgb.len() as u64 != 3 * u64::from(width) * u64::from(height) {
        return Err(format!("{} bytes are not {width} x {height} pixels", rgb.len()));
    }
    let mut set = image(StorageClass::SecondaryCapture, derivation);
    set.text(tags::INSTANCE_NUMBER, VR::IS, "1");
    set.present(&[(tags::PATIENT_ORIENTATION, VR::CS)]);
    set.code(
        tags::DERIVATION_CODE_SEQUENCE,
        "113074",
        "DCM",
        "Volume rendering",
    );
    set.whole(tags::SAMPLES_PER_PIXEL, 3);
    set.text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "RGB");
    set.whole(tags::PLANAR_CONFIGURATION, 0);
    set.whole(tags::ROWS, rows);
    set.whole(tags::COLUMNS, columns);
    set.whole(tags::BITS_ALLOCATED, 8);
    set.whole(tags::BITS_STORED, 8);
    set.whole(tags::HIGH_BIT, 7);
    set.whole(tags::PIXEL_REPRESENTATION, 0);
    let pixel_bytes = rgb.len();
    set.bytes(tags::PIXEL_DATA, VR::OB, rgb);
    set.single_file(pixel_bytes)
}
