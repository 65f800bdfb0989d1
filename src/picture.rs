//! Pictures as every renderer returns them, with their cost: time by stage and samples.

pub mod antialias;

use crate::files::OutputFile;
use crate::math::lanes::*;
use crate::{Error, Result};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use rayon::prelude::*;
use std::path::Path;
use std::time::Instant;

/// Largest edge of a picture, pixels.
pub const MAX_PICTURE_EDGE: u32 = 16_384;
/// Most samples of a picture: pixels times samples per pixel. Each takes 16 bytes in floating
/// point.
pub const MAX_PIXELS: u64 = 1 << 28;
/// An alpha below this changes no byte of the output.
const UNSEEN: f32 = 0.5 / 255.0;

/// Time spent by stage, milliseconds, in order.
#[derive(Clone, Debug, Default)]
pub struct StageTimes(pub Vec<(&'static str, f64)>);

impl StageTimes {
    /// Runs a stage and records how long it took.
    pub fn time<T>(&mut self, name: &'static str, stage: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = stage();
        self.0.push((name, start.elapsed().as_secs_f64() * 1e3));
        result
    }

    /// Splits a part off the last stage, if that has this name, as a stage of its own.
    pub fn divide(&mut self, name: &str, part: &'static str, milliseconds: f64) {
        if let Some((last, all)) = self.0.last_mut()
            && *last == name
        {
            *all = (*all - milliseconds).max(0.0);
            self.0.push((part, milliseconds));
        }
    }
}

/// A picture: premultiplied RGBA without background, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Premultiplied red, green, blue, alpha.
    pub pixels: Vec<[f32; 4]>,
}

/// Sample counts of a renderer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderStats {
    /// Samples at which the deformation and the volume were evaluated.
    pub samples_taken: u64,
    /// Samples inside the box of visible content that were skipped because their cell is empty.
    pub samples_skipped: u64,
    /// Samples omitted because the ray was already opaque.
    pub samples_terminated: u64,
}

impl RenderStats {
    /// The counts of both.
    pub fn plus(self, other: Self) -> Self {
        Self {
            samples_taken: self.samples_taken + other.samples_taken,
            samples_skipped: self.samples_skipped + other.samples_skipped,
            samples_terminated: self.samples_terminated + other.samples_terminated,
        }
    }
}

/// A picture with its cost.
pub struct Rendered {
    /// The picture.
    pub picture: Picture,
    /// Sample counts; a GPU counts only on request.
    pub stats: Option<RenderStats>,
    /// Time by stage.
    pub stages: StageTimes,
    /// Notices for the user, one sentence each.
    pub notices: Vec<String>,
    /// Why the picture is empty, if it is; also one of the notices.
    pub blank: Option<String>,
}

impl Picture {
    /// Whether the picture shows nothing.
    pub fn is_blank(&self) -> bool {
        !self.pixels.iter().any(|p| p[3] >= UNSEEN)
    }

    /// The picture with blocks of n by n pixels averaged.
    pub fn reduced(self, n: u32) -> Self {
        if n <= 1 {
            return self;
        }
        let (width, height, row) = (self.width / n, self.height / n, self.width as usize);
        let average = |index: u32| -> [f32; 4] {
            let (x, y) = ((index % width * n) as usize, (index / width * n) as usize);
            let all = (0..n as usize).flat_map(|j| &self.pixels[(y + j) * row + x..][..n as usize]);
            all.fold([0.0; 4], |sum: [f32; 4], p| {
                std::array::from_fn(|c| sum[c] + p[c] / (n * n) as f32)
            })
        };
        Self {
            width,
            height,
            pixels: (0..width * height).map(average).collect(),
        }
    }

    /// The picture over a background as PNG: 8 bits per channel, RGB if the background is opaque,
    /// else RGBA (not premultiplied).
    ///
    /// # Errors
    /// Errors from the encoder.
    pub fn png(&self, background: [f32; 4]) -> Result<Vec<u8>> {
        let mut rgba = self.over(background);
        let color = if background[3] >= 1.0 {
            rgba = rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
            ExtendedColorType::Rgb8
        } else {
            ExtendedColorType::Rgba8
        };
        encode_png(&rgba, [self.width, self.height], color)
    }

    /// Writes [`Self::png`] to a file. An existing file is replaced as a whole or not at all.
    ///
    /// # Errors
    /// Errors from the encoder; a file that cannot be written.
    pub fn save_png(&self, path: impl AsRef<Path>, background: [f32; 4]) -> Result<()> {
        OutputFile::create(path.as_ref())?.finish(&self.png(background)?)
    }

    /// The picture over a background (red, green, blue, alpha, not premultiplied), as 8-bit RGBA,
    /// not premultiplied.
    pub fn over(&self, background: [f32; 4]) -> Vec<u8> {
        let [r, g, b, back_alpha] = background;
        let behind = [r * back_alpha, g * back_alpha, b * back_alpha, back_alpha];
        let mut bytes = vec![[0; 4]; self.pixels.len()];
        bytes
            .par_chunks_mut(1 << 14)
            .zip(self.pixels.par_chunks(1 << 14))
            .for_each(|(bytes, pixels)| {
                with_simd(Over {
                    behind,
                    pixels,
                    bytes,
                })
            });
        bytes.into_flattened()
    }
}

/// Encodes rows of 8-bit colours as PNG.
///
/// # Errors
/// Errors from the encoder.
pub fn encode_png(bytes: &[u8], [width, height]: [u32; 2], color: ExtendedColorType) -> Result<Vec<u8>> {
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(bytes, width, height, color)
        .map_err(|e| Error::value("output", format!("could not be encoded as PNG: {e}")))?;
    Ok(png)
}

/// Pixels over a background, both premultiplied, as bytes that are not.
struct Over<'a> {
    behind: [f32; 4],
    pixels: &'a [[f32; 4]],
    bytes: &'a mut [[u8; 4]],
}

impl SimdKernel for Over<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let behind = f32x4::load_array(simd, self.behind);
        for (byte, pixel) in self.bytes.iter_mut().zip(self.pixels) {
            let all = behind * (1.0 - pixel[3]) + f32x4::load_array(simd, *pixel);
            let alpha = all[3].max(1e-6);
            let share = (all / f32x4::load_array(simd, [alpha, alpha, alpha, 1.0]))
                .max(0.0)
                .min(1.0);
            let [r, g, b, a] = (share * 255.0 + 0.5).to_int::<i32x4<S>>().to_array();
            *byte = [r as u8, g as u8, b as u8, a as u8];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn background_shows_where_the_picture_does_not() {
        let picture = Picture {
            width: 2,
            height: 1,
            pixels: vec![[0.5, 0.0, 0.0, 0.5], [0.0; 4]],
        };
        assert_eq!(
            picture.over([0.0, 0.0, 1.0, 1.0]),
            [128, 0, 128, 255, 0, 0, 255, 255]
        );
        assert_eq!(picture.over([0.0; 4]), [255, 0, 0, 128, 0, 0, 0, 0]);
    }
}
