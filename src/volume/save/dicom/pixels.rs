//! How the values of a volume become 16-bit pixels.
//!
//! Whole numbers within 16 bits keep their stored values, slope and intercept. Others are spread
//! over 16 bits, with the slope stated. Voxels outside the deformed volume and in cuts get the
//! value below the lowest, declared as pixel padding (PS3.3 C.7.5.1.1.2): viewers that do not know
//! it show the darkest grey, and no voxel that was measured is declared empty.

use super::numbers::as_written;
use crate::volume::{Rescale, Volume};

/// Steps of a volume spread over unsigned pixels, of which 0 is padding, and over the positive
/// signed ones.
const UNSIGNED_STEPS: f64 = 65_534.0;
const SIGNED_STEPS: f64 = 32_767.0;

/// The 16-bit pixels for a volume.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelEncoding {
    /// Whether pixels are signed.
    pub signed: bool,
    /// From pixels to data values, as a reader gets it.
    pub rescale: Rescale,
    /// From the volume's stored values to pixels.
    pub pixel_from_stored: Rescale,
    /// The pixel outside the volume and in cuts.
    pub fill: f64,
    /// Lowest and highest pixel that mean "no value".
    pub padding: Option<[f64; 2]>,
    /// Lowest and highest pixel of a value.
    pub limits: [f64; 2],
    /// Whether values are rounded to the slope.
    pub rounds: bool,
}

/// Lowest and highest pixel.
fn pixel_range(signed: bool) -> [f64; 2] {
    if signed {
        [f64::from(i16::MIN), f64::from(i16::MAX)]
    } else {
        [0.0, f64::from(u16::MAX)]
    }
}

/// Whether both ends of a range lie in another.
fn within([low, high]: [f64; 2], outer: [f64; 2]) -> bool {
    low >= outer[0] && high <= outer[1]
}

impl PixelEncoding {
    /// The encoding of a volume. `fill`: the data value outside it and in cuts, which is not
    /// padding; by default the volume's padding, else one below its lowest value. `keeps_zero`:
    /// pixel 0 means 0, as in PET, whose intercept is 0 (PS3.3 C.8.9.4.1.2).
    pub fn of(volume: &Volume, fill: Option<f64>, keeps_zero: bool) -> Self {
        let Rescale { slope, intercept } = volume.rescale;
        let stored = |value: f64| (value - intercept) / slope;
        let [a, b] = volume.range.map(stored);
        let range = [a.min(b), a.max(b)];
        let whole = volume.voxels.is_integer()
            || volume.voxels.fold(
                || true,
                |all, v| all && (v.fract() == 0.0 || !v.is_finite()),
                |a, b| a && b,
            );
        let exact = whole && (!keeps_zero || as_written(intercept) == 0.0);
        if exact && let Some(encoding) = Self::unchanged(volume, range.map(f64::round), fill.map(stored)) {
            return encoding;
        }
        Self::spread(volume, fill, keeps_zero)
    }

    /// Pixels that are the stored values, at most shifted; none if 16 bits cannot hold them.
    fn unchanged(volume: &Volume, range: [f64; 2], fill: Option<f64>) -> Option<Self> {
        let Rescale { slope, intercept } = volume.rescale;
        let fill = fill.map(f64::round);
        let mut all = range;
        for v in volume.padding.into_iter().flatten().chain(fill) {
            all = [all[0].min(v), all[1].max(v)];
        }
        let is_label_map = volume.labels().is_some();
        let below = f64::from(u8::from(
            volume.padding.is_none() && fill.is_none() && !is_label_map,
        ));
        let with_padding = [all[0] - below, all[1]];
        let unsigned_first = volume.voxels.type_name().starts_with('u');
        let signs = [!unsigned_first, unsigned_first];
        let held = |values: [f64; 2]| {
            signs
                .into_iter()
                .find(|signed| within(values, pixel_range(*signed)))
        };
        let (signed, shift, padded) = match (held(with_padding), held(all)) {
            (Some(signed), _) => (signed, 0.0, true),
            // Whole numbers of a narrow range, at a distance from 0.
            (None, _) if within([0.0, with_padding[1] - with_padding[0]], pixel_range(false)) => {
                (false, -with_padding[0], true)
            }
            (None, Some(signed)) => (signed, 0.0, false),
            (None, None) => return None,
        };
        let rescale = Rescale {
            slope: as_written(slope),
            intercept: as_written(intercept - shift * slope),
        };
        let own = fill.or(volume.padding.map(|p| p[0]));
        let lowest = if padded { with_padding[0] } else { all[0] };
        let new_padding = (padded && below > 0.0).then_some([lowest + shift; 2]);
        Some(Self {
            signed,
            rescale,
            pixel_from_stored: Rescale {
                slope: 1.0,
                intercept: shift,
            },
            fill: own.unwrap_or(lowest) + shift,
            padding: volume.padding.map(|p| p.map(|v| v + shift)).or(new_padding),
            limits: range.map(|v| v + shift),
            rounds: false,
        })
    }

    /// Values spread over 16 bits.
    fn spread(volume: &Volume, fill: Option<f64>, keeps_zero: bool) -> Self {
        let [mut low, mut high] = volume.range;
        if let Some(fill) = fill {
            (low, high) = (low.min(fill), high.max(fill));
        }
        let positive = |slope: f64| {
            if slope > 0.0 && slope.is_finite() {
                slope
            } else {
                1.0
            }
        };
        // Halves, because the difference of two finite numbers may be infinite.
        let steps = if keeps_zero { SIGNED_STEPS } else { UNSIGNED_STEPS };
        let span = if keeps_zero {
            low.abs().max(high.abs())
        } else {
            (0.5 * high - 0.5 * low) * 2.0
        };
        let slope = as_written(positive(span / steps));
        let intercept = if keeps_zero { 0.0 } else { as_written(low - slope) };
        let pixel = |value: f64| {
            let [least, most] = pixel_range(keeps_zero);
            ((value - intercept) / slope).round().clamp(least, most)
        };
        let empty = if keeps_zero { f64::from(i16::MIN) } else { 0.0 };
        Self {
            signed: keeps_zero,
            rescale: Rescale { slope, intercept },
            pixel_from_stored: Rescale {
                slope: volume.rescale.slope / slope,
                intercept: (volume.rescale.intercept - intercept) / slope,
            },
            fill: fill.map_or(empty, pixel),
            padding: Some([empty; 2]),
            limits: volume.range.map(pixel),
            rounds: true,
        }
    }

    /// What a user should know about the pixels: how far written values are off; none if they are
    /// the volume's own.
    pub fn notice(&self) -> Option<String> {
        let step = self.rescale.slope.abs();
        self.rounds.then(|| {
            format!(
                "DICOM stores 16 bits per voxel; values are rounded to steps of {step:.3e}, at most {:.1e} off",
                0.5 * step
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{StoredValues, Voxels};
    use glam::DAffine3;

    fn volume(
        values: impl Into<StoredValues>,
        slope: f64,
        intercept: f64,
        padding: Option<[f64; 2]>,
    ) -> Volume {
        let values = values.into();
        let voxels = Voxels::new([values.len(), 1, 1], values);
        Volume::with_padding(voxels, Rescale { slope, intercept }, DAffine3::IDENTITY, padding)
    }

    /// The pixel of a stored value, and its data value as read.
    fn through(encoding: &PixelEncoding, stored: f64) -> (f64, f64) {
        let Rescale { slope, intercept } = encoding.pixel_from_stored;
        let pixel = (stored * slope + intercept).round();
        (pixel, pixel * encoding.rescale.slope + encoding.rescale.intercept)
    }

    #[test]
    fn whole_numbers_keep_their_values() {
        for (v, signed, padding, fill) in [
            (
                volume(vec![-1000i16, 3000], 1.0, 0.0, None),
                true,
                -1001.0,
                -1001.0,
            ),
            (volume(vec![5u16, 60_000], 1.0, -1024.0, None), false, 4.0, 4.0),
            // One below 0 needs a sign.
            (volume(vec![0u8, 255], 1.0, 0.0, None), true, -1.0, -1.0),
            (
                volume(vec![-2000i16, -1000, 3000], 1.0, 0.0, Some([-2000.0; 2])),
                true,
                -2000.0,
                -2000.0,
            ),
            (
                volume(vec![7.0f32, 9.0, f32::NAN], 1.0, 0.0, None),
                true,
                6.0,
                6.0,
            ),
            // Shifted.
            (volume(vec![100_000i32, 120_000], 2.0, 1.0, None), false, 0.0, 0.0),
        ] {
            let encoding = PixelEncoding::of(&v, None, false);
            assert_eq!(
                (encoding.signed, encoding.rounds),
                (signed, false),
                "{encoding:?}"
            );
            assert_eq!(
                (encoding.padding, encoding.fill),
                (Some([padding; 2]), fill),
                "{encoding:?}"
            );
            for n in 0..v.voxels.len() {
                let stored = v.voxels.get(n);
                let (pixel, value) = through(&encoding, stored);
                if !stored.is_nan() {
                    assert!(within([pixel; 2], pixel_range(signed)));
                    assert_eq!(value, stored * v.rescale.slope + v.rescale.intercept);
                }
            }
        }
        // No room for padding.
        let full = PixelEncoding::of(&volume(vec![0u16, 65_535], 1.0, 0.0, None), None, false);
        assert_eq!((full.signed, full.padding, full.fill), (false, None, 0.0));
        let full = PixelEncoding::of(&volume(vec![-32_768i16, 32_767], 1.0, 0.0, None), None, false);
        assert_eq!((full.signed, full.padding, full.fill), (true, None, -32_768.0));
        let filled = PixelEncoding::of(&volume(vec![0i16, 10], 2.0, 1.0, None), Some(-99.0), false);
        assert_eq!((filled.padding, filled.fill), (None, -50.0));
    }

    #[test]
    fn other_numbers_are_near() {
        for (v, zero) in [
            (volume(vec![0.25f32, -1.75, 1e3, f32::NAN], 1.0, 0.0, None), false),
            (volume(vec![0.25f64, 1e-30, 1e-9], 1.0, 0.0, None), false),
            (volume(vec![0.0f32, 12_345.678], 1.0, 0.0, None), true),
            (volume(vec![0i16, 1000], 0.5, 3.0, None), true),
            (
                volume(vec![-2_000_000_000i32, 2_000_000_000], 1.0, 0.0, None),
                false,
            ),
            (volume(vec![f64::MIN, f64::MAX], 1.0, 0.0, None), false),
            (volume(vec![0.5f32, 0.5], 1.0, 0.0, None), false),
            (volume(vec![f32::NAN], 1.0, 0.0, None), false),
        ] {
            let encoding = PixelEncoding::of(&v, None, zero);
            assert!(!zero || encoding.rescale.intercept == 0.0);
            assert!(
                encoding.rescale.slope > 0.0 && encoding.rescale.slope.is_finite(),
                "{encoding:?}"
            );
            for n in 0..v.voxels.len() {
                let stored = v.voxels.get(n);
                let (pixel, value) = through(&encoding, stored);
                if v.range[1] < 1e300 && stored.is_finite() {
                    let want = stored * v.rescale.slope + v.rescale.intercept;
                    assert!(within([pixel; 2], pixel_range(encoding.signed)), "{pixel}");
                    assert!(encoding.padding != Some([pixel; 2]), "{stored} is padding");
                    assert!(
                        (value - want).abs() <= 0.500_1 * encoding.rescale.slope,
                        "{value} {want}"
                    );
                }
            }
        }
    }
}
