//! Colours that are not stored as red, green and blue.
//!
//! Source: TIFF 6.0 sections 16 (CMYK), 20 (ReferenceBlackWhite) and 21 (YCbCr).

use super::directory::{Directory, TiffReader, tag};
use crate::Result;

/// Whether the colour table is a ramp from black to white, so that its indices are grey values.
pub(super) fn is_grey_ramp(file: &mut TiffReader, directory: &Directory) -> Result<bool> {
    let Some(table) = file.integers(directory, tag::COLOR_MAP)? else {
        return Ok(false);
    };
    let count = table.len() / 3;
    let is_grey = |n: usize| {
        let [r, g, b] = [0, 1, 2].map(|c| table[c * count + n]);
        let expected = (n * 65_535) as f64 / (count - 1) as f64;
        r == g && g == b && (r as f64 - expected).abs() < 300.0
    };
    Ok(count > 1 && (0..count).all(is_grey))
}

/// Red, green and blue of cyan, magenta, yellow and black inks, without a colour profile.
pub(super) fn of_cmyk(values: &[u8], samples: usize) -> Vec<u8> {
    values
        .chunks_exact(samples.max(4))
        .flat_map(|inks| {
            let light = |ink: u8| ((255 - u32::from(ink)) * (255 - u32::from(inks[3])) + 127) / 255;
            [inks[0], inks[1], inks[2]].map(|ink| light(ink) as u8)
        })
        .collect()
}

/// Rejects colour differences of lower resolution, which are read only from JPEG.
pub(super) fn check_subsampling(file: &mut TiffReader, directory: &Directory) -> Result<()> {
    let stated = file.integers(directory, tag::YCBCR_SUBSAMPLING)?;
    match stated.as_deref() {
        Some([1, 1]) => Ok(()),
        _ => Err(file.error(
            "stores subsampled YCbCr without JPEG compression, which cannot be read; convert it to RGB",
        )),
    }
}

/// How luminance and colour differences are coded.
pub(super) struct YCbCr {
    /// Share of red, green and blue in luminance.
    luma: [f64; 3],
    /// Code of black and white of each sample.
    reference: [[f64; 2]; 3],
}

impl YCbCr {
    /// From a directory; by default as in TIFF 6.0.
    pub fn of(file: &mut TiffReader, directory: &Directory) -> Result<Self> {
        let three = |values: Option<Vec<f64>>| -> Option<[f64; 3]> { values?.try_into().ok() };
        let luma = three(file.reals(directory, tag::YCBCR_COEFFICIENTS)?)
            .filter(|l| l.iter().all(|v| v.is_finite()) && l[1] > 0.0)
            .unwrap_or([0.299, 0.587, 0.114]);
        let reference: Option<[f64; 6]> = file
            .reals(directory, tag::REFERENCE_BLACK_WHITE)?
            .and_then(|values| values.try_into().ok());
        let [a, b, c, d, e, f] = reference.unwrap_or([0.0, 255.0, 128.0, 255.0, 128.0, 255.0]);
        Ok(Self {
            luma,
            reference: [[a, b], [c, d], [e, f]],
        })
    }

    /// Red, green and blue.
    pub fn to_rgb(&self, values: &[u8], samples: usize) -> Vec<u8> {
        let [red, green, blue] = self.luma;
        let range = [255.0, 127.0, 127.0];
        values
            .chunks_exact(samples.max(3))
            .flat_map(|pixel| {
                let [y, cb, cr] = [0, 1, 2].map(|n| {
                    let [black, white] = self.reference[n];
                    (f64::from(pixel[n]) - black) * range[n] / (white - black)
                });
                let r = cr * (2.0 - 2.0 * red) + y;
                let b = cb * (2.0 - 2.0 * blue) + y;
                let g = (y - blue * b - red * r) / green;
                [r, g, b].map(|v| (v + 0.5).clamp(0.0, 255.0) as u8)
            })
            .collect()
    }
}
