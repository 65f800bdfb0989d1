//! The difference of two pictures of one size, as numbers and as a picture.
//!
//! *Theory*: pixels are compared as stored, premultiplied and without a background, so that a wrong
//! alpha counts even if it is invisible over the current background. Mean, maximum and PSNR measure
//! how far values are apart; SSIM (Wang, Bovik, Sheikh, Simoncelli, "Image Quality Assessment: From
//! Error Visibility to Structural Similarity", IEEE TIP 13(4), 2004) measures whether edges and
//! textures are in place. The difference from that paper: its window is cut off at the border of
//! the picture and the mean is taken over the rest; here pixels beyond the border repeat it, so
//! that every pixel counts.

use crate::picture::Picture;
use crate::{Error, Result};
use rayon::prelude::*;
use serde::{Serialize, Serializer};

/// Radius of the SSIM window, pixels.
const RADIUS: usize = 5;
/// Standard deviation of the window, pixels.
const SIGMA: f64 = 1.5;
/// (K1 L)² and (K2 L)² with K1 = 0.01, K2 = 0.03, L = 1.
const STABILISERS: [f64; 2] = [0.01 * 0.01, 0.03 * 0.03];
/// Weights of red, green and blue (Rec. 601): pictures are not in linear light.
const LUMINANCE: [f32; 3] = [0.299, 0.587, 0.114];

/// Colours of differences, evenly spaced: each is brighter than the one before, and none requires
/// telling red from green.
const RAMP: [[f32; 3]; 4] = [
    [0.0, 0.0, 0.0],
    [0.24, 0.16, 0.62],
    [0.93, 0.52, 0.13],
    [1.0, 0.97, 0.76],
];

/// The difference between two pictures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Mean over all four channels of all pixels, 0..255.
    pub mean: f64,
    /// Largest of any channel of any pixel, 0..255.
    pub max: f64,
    /// Peak signal-to-noise ratio over all four channels, dB; infinite if the pictures are equal
    /// (`null` in JSON).
    #[serde(serialize_with = "finite")]
    pub psnr_db: f64,
    /// Mean structural similarity of the luminance over black, 1 for equal pictures.
    pub ssim: f64,
}

impl Difference {
    /// Root mean square over all four channels of all pixels, 0..255: the PSNR as a distance.
    pub fn rms(&self) -> f64 {
        255.0 * 10f64.powf(-self.psnr_db / 20.0)
    }
}

/// Serialises infinity as `null`, since JSON lacks it.
fn finite<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    value.is_finite().then_some(*value).serialize(serializer)
}

/// Compares two pictures; values are clamped to 0..1 first.
///
/// # Errors
/// Pictures of different sizes, without pixels, or with values that are not numbers.
pub fn difference(a: &Picture, b: &Picture) -> Result<Difference> {
    check(a, b)?;
    let (mut sum, mut squares, mut max) = (0.0, 0.0, 0.0f64);
    for (p, q) in a.pixels.iter().zip(&b.pixels) {
        for d in channel_differences(p, q).map(f64::from) {
            sum += d;
            squares += d * d;
            max = max.max(d);
        }
    }
    let count = 4.0 * a.pixels.len() as f64;
    let psnr_db = if squares > 0.0 {
        -10.0 * (squares / count).log10()
    } else {
        f64::INFINITY
    };
    Ok(Difference {
        mean: 255.0 * sum / count,
        max: 255.0 * max,
        psnr_db,
        ssim: ssim(a, b),
    })
}

/// The largest difference of any channel, per pixel and times `amplify`, as an opaque colour: black
/// without a difference, then blue-violet, orange, and pale yellow from 1 on.
///
/// # Errors
/// As [`difference`]; an amplification that is not positive.
pub fn difference_picture(a: &Picture, b: &Picture, amplify: f32) -> Result<Picture> {
    check(a, b)?;
    if !(amplify.is_finite() && amplify > 0.0) {
        return Err(Error::value(
            "amplify",
            format!("{amplify} is not a valid amplification; it must be positive"),
        ));
    }
    let shown = |(p, q): (&[f32; 4], &[f32; 4])| {
        ramp(channel_differences(p, q).into_iter().fold(0.0, f32::max) * amplify)
    };
    Ok(Picture {
        width: a.width,
        height: a.height,
        pixels: a.pixels.iter().zip(&b.pixels).map(shown).collect(),
    })
}

fn check(a: &Picture, b: &Picture) -> Result<()> {
    if (a.width, a.height) != (b.width, b.height) {
        let problem = format!(
            "one has {} x {} pixels, the other {} x {}; make both of one size",
            a.width, a.height, b.width, b.height
        );
        return Err(Error::value("pictures", problem));
    }
    for picture in [a, b] {
        if picture.pixels.is_empty()
            || picture.pixels.len() != picture.width as usize * picture.height as usize
        {
            return Err(Error::value(
                "pictures",
                "one has no pixels, or not as many as its size says; there is nothing to compare",
            ));
        }
        if picture.pixels.iter().flatten().any(|v| v.is_nan()) {
            return Err(Error::value(
                "pictures",
                "one has values that are not numbers (NaN); it cannot be compared",
            ));
        }
    }
    Ok(())
}

fn channel_differences(p: &[f32; 4], q: &[f32; 4]) -> [f32; 4] {
    std::array::from_fn(|c| (p[c].clamp(0.0, 1.0) - q[c].clamp(0.0, 1.0)).abs())
}

/// The colour of a difference; from 1 on, the last colour.
fn ramp(difference: f32) -> [f32; 4] {
    let last = RAMP.len() - 1;
    let at = difference.clamp(0.0, 1.0) * last as f32;
    let below = (at as usize).min(last - 1);
    let share = at - below as f32;
    let [from, to] = [RAMP[below], RAMP[below + 1]];
    let [r, g, b] = std::array::from_fn(|c| (1.0 - share) * from[c] + share * to[c]);
    [r, g, b, 1.0]
}

/// Luminance over black, which premultiplied colour already is.
fn luminance(picture: &Picture) -> Vec<f32> {
    picture
        .pixels
        .iter()
        .map(|p| {
            LUMINANCE
                .iter()
                .zip(p)
                .map(|(weight, v)| weight * v.clamp(0.0, 1.0))
                .sum::<f32>()
        })
        .collect()
}

/// The Gaussian window of SSIM along one axis; its weights sum to 1.
fn window() -> [f64; 2 * RADIUS + 1] {
    let weights: [f64; 2 * RADIUS + 1] = std::array::from_fn(|k| {
        let distance = k as f64 - RADIUS as f64;
        (-0.5 * (distance / SIGMA).powi(2)).exp()
    });
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

/// Mean SSIM of two pictures of one size. The window is separable: rows under it are summed for
/// each row, then columns for each pixel, so that only the luminances need memory of the picture's
/// size.
fn ssim(a: &Picture, b: &Picture) -> f64 {
    let (width, height) = (a.width as usize, a.height as usize);
    let (a, b) = (luminance(a), luminance(b));
    let window = window();
    let rows: Vec<f64> = (0..height)
        .into_par_iter()
        .map(|y| {
            let mut columns = vec![[0.0; 5]; width];
            for (k, weight) in window.iter().enumerate() {
                let start = (y + k).saturating_sub(RADIUS).min(height - 1) * width;
                for (column, (&p, &q)) in columns
                    .iter_mut()
                    .zip(a[start..][..width].iter().zip(&b[start..][..width]))
                {
                    let (p, q) = (f64::from(p), f64::from(q));
                    add(column, *weight, &[p, q, p * p, q * q, p * q]);
                }
            }
            let similarity_at = |x: usize| {
                let mut moments = [0.0; 5];
                for (k, weight) in window.iter().enumerate() {
                    add(
                        &mut moments,
                        *weight,
                        &columns[(x + k).saturating_sub(RADIUS).min(width - 1)],
                    );
                }
                similarity(moments)
            };
            (0..width).map(similarity_at).sum::<f64>()
        })
        .collect();
    // Summed in order, so that the result does not depend on the number of threads.
    rows.iter().sum::<f64>() / (width * height) as f64
}

fn add(sums: &mut [f64; 5], weight: f64, values: &[f64; 5]) {
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += weight * value;
    }
}

/// Equation 13 of the paper from the weighted means of p, q, p², q² and pq.
fn similarity([p, q, pp, qq, pq]: [f64; 5]) -> f64 {
    let [c1, c2] = STABILISERS;
    let (variance_p, variance_q, covariance) = (pp - p * p, qq - q * q, pq - p * q);
    ((2.0 * p * q + c1) * (2.0 * covariance + c2)) / ((p * p + q * q + c1) * (variance_p + variance_q + c2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Picture {
        let pixels = (0..40 * 30).map(|n| {
            let (x, y) = ((n % 40) as f32 / 40.0, (n / 40) as f32 / 30.0);
            let alpha = 0.3 + 0.6 * (9.0 * x).sin().abs();
            [alpha * x, alpha * y, alpha * x * y, alpha]
        });
        Picture {
            width: 40,
            height: 30,
            pixels: pixels.collect(),
        }
    }

    fn uniform(color: [f32; 4]) -> Picture {
        Picture {
            width: 17,
            height: 13,
            pixels: vec![color; 17 * 13],
        }
    }

    #[test]
    fn equal_pictures_are_equal() {
        let d = difference(&sample(), &sample()).unwrap();
        assert_eq!(
            d,
            Difference {
                mean: 0.0,
                max: 0.0,
                psnr_db: f64::INFINITY,
                ssim: 1.0
            }
        );
        assert!(
            difference_picture(&sample(), &sample(), 8.0)
                .unwrap()
                .pixels
                .iter()
                .all(|p| *p == [0.0, 0.0, 0.0, 1.0])
        );
    }

    #[test]
    fn an_offset_has_its_closed_form() {
        let d = difference(&uniform([0.4; 4]), &uniform([0.5; 4])).unwrap();
        assert!(
            (d.mean - 25.5).abs() < 1e-4 && (d.max - 25.5).abs() < 1e-4,
            "{d:?}"
        );
        assert!(
            (d.psnr_db - 20.0).abs() < 1e-4 && (d.rms() - 25.5).abs() < 1e-3,
            "{d:?}"
        );
        assert_eq!(difference(&sample(), &sample()).unwrap().rms(), 0.0);
        let ssim = (2.0 * 0.4 * 0.5 + 1e-4) / (0.16 + 0.25 + 1e-4);
        assert!((d.ssim - ssim).abs() < 1e-6, "{d:?}, not {ssim}");
        let one_channel = difference(&uniform([0.4; 4]), &uniform([0.4, 0.4, 0.4, 0.5])).unwrap();
        assert!(
            (one_channel.mean - 25.5 / 4.0).abs() < 1e-4 && (one_channel.max - 25.5).abs() < 1e-4,
            "{one_channel:?}"
        );
    }

    #[test]
    fn what_must_be_seen_is_seen() {
        let a = sample();
        let mut shifted = a.clone();
        shifted.pixels.rotate_right(1);
        let mut alpha = a.clone();
        alpha.pixels.iter_mut().for_each(|p| p[3] *= 0.97);
        let mut swapped = a.clone();
        swapped.pixels.iter_mut().for_each(|p| p.swap(0, 1));
        let transparent = Picture {
            pixels: vec![[0.0; 4]; a.pixels.len()],
            ..a.clone()
        };
        for (name, b) in [
            ("shift", &shifted),
            ("alpha", &alpha),
            ("channels", &swapped),
            ("transparent", &transparent),
        ] {
            let d = difference(&a, b).unwrap();
            assert!(d.mean > 0.5 && d.max > 1.0 && d.psnr_db < 50.0, "{name}: {d:?}");
            assert_eq!(d, difference(b, &a).unwrap(), "{name} is not symmetric");
            assert!(
                difference_picture(&a, b, 1.0)
                    .unwrap()
                    .pixels
                    .iter()
                    .any(|p| p[2] > 0.0),
                "{name} does not show"
            );
        }
        assert!(
            difference(&a, &shifted).unwrap().ssim < 0.999 && difference(&a, &swapped).unwrap().ssim < 0.999
        );
        // A single pixel differs.
        let mut speck = a.clone();
        speck.pixels[77][1] += 0.1;
        let d = difference(&a, &speck).unwrap();
        assert!(
            d.mean > 0.0 && (d.max - 25.5).abs() < 1e-3 && d.ssim < 1.0,
            "{d:?}"
        );
    }

    #[test]
    fn what_cannot_be_compared_is_an_error() {
        let a = sample();
        let mut nan = a.clone();
        nan.pixels[77][2] = f32::NAN;
        let turned = Picture {
            width: a.height,
            height: a.width,
            ..a.clone()
        };
        let short = Picture {
            pixels: a.pixels[1..].to_vec(),
            ..a.clone()
        };
        let none = Picture {
            width: 0,
            height: 0,
            pixels: Vec::new(),
        };
        for (name, b, c) in [
            ("NaN", &a, &nan),
            ("NaN first", &nan, &a),
            ("size", &a, &turned),
            ("short", &a, &short),
            ("none", &none, &none),
        ] {
            assert!(matches!(difference(b, c), Err(Error::Value { .. })), "{name}");
            assert!(
                matches!(difference_picture(b, c, 1.0), Err(Error::Value { .. })),
                "{name}"
            );
        }
        for amplify in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(difference_picture(&a, &a, amplify).is_err(), "{amplify}");
        }
    }

    #[test]
    fn larger_differences_are_brighter() {
        let brightness = |d: f32| {
            ramp(d)[..3]
                .iter()
                .zip(LUMINANCE)
                .map(|(v, w)| v * w)
                .sum::<f32>()
        };
        assert!((1..=100).all(|n| brightness(n as f32 / 100.0) > brightness((n - 1) as f32 / 100.0)));
        assert_eq!(
            (ramp(0.0), ramp(2.0)),
            ([0.0, 0.0, 0.0, 1.0], [1.0, 0.97, 0.76, 1.0])
        );
    }

    #[test]
    fn infinity_is_null_in_json() {
        let json = serde_json::to_value(difference(&sample(), &sample()).unwrap()).unwrap();
        assert_eq!(
            json,
            serde_json::json!({ "mean": 0.0, "max": 0.0, "psnr_db": null, "ssim": 1.0 })
        );
    }
}
