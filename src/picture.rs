//! Pictures as every renderer returns them, with what they cost: time by stage and samples.

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
/// Most samples of a picture: its pixels, each as often as it is antialiased. Their floating-point form takes 16 bytes each.
pub const MAX_PIXELS: u64 = 1 << 28;
/// An alpha below this changes no byte of a picture.
const UNSEEN: f32 = 0.5 / 255.0;

/// Time spent by stage, milliseconds, in order.
#[derive(Clone, Debug, Default)]
pub struct StageTimes(pub Vec<(&'static str, f64)>);

impl StageTimes {
    /// Runs a stage and notes how long it took.
    pub fn time<T>(&mut self, name: &'static str, stage: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = stage();
        self.0.push((name, start.elapsed().as_secs_f64() * 1e3));
        result
    }

    /// Makes a part of the last stage, if that has this name, a stage of its own.
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

/// Counts that a renderer keeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderStats {
    /// Samples for which the deformation and the volume were looked up.
    pub samples_taken: u64,
    /// Samples inside the box of what can be seen left out because their cell is empty.
    pub samples_skipped: u64,
    /// Samples left out because nothing behind an opaque ray can be seen.
    pub samples_terminated: u64,
}

/// A picture with what it cost.
pub struct Rendered {
    /// The picture.
    pub picture: Picture,
    /// Counts; a GPU keeps them only when asked.
    pub stats: Option<RenderStats>,
    /// Time by stage.
    pub stages: StageTimes,
    /// What a user should be told, one sentence each.
    pub notices: Vec<String>,
    /// Why nothing is to be seen, if nothing is; one of the notices.
    pub blank: Option<String>,
}

impl Picture {
    /// Whether it is as if nothing had been rendered.
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
            all.fold([0.0; 4], |sum: [f32; 4], p| std::array::from_fn(|c| sum[c] + p[c] / (n * n) as f32))
        };
        Self { width, height, pixels: (0..width * height).map(average).collect() }
    }

    /// The picture over a background as PNG: 8 bits per channel, RGB if the background is opaque, else RGBA (not premultiplied).
    ///
    /// # Errors
    /// The encoder's.
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

    /// Writes [`Self::png`] to a file; one that is there is replaced by the whole of it, or not at all.
    ///
    /// # Errors
    /// The encoder's; a file that cannot be written.
    pub fn save_png(&self, path: impl AsRef<Path>, background: [f32; 4]) -> Result<()> {
        OutputFile::create(path.as_ref())?.finish(&self.png(background)?)
    }

    /// The picture over a background (red, green, blue, alpha, not premultiplied), as 8-bit RGBA, not premultiplied.
    pub fn over(&self, background: [f32; 4]) -> Vec<u8> {
        let [r, g, b, back_alpha] = background;
        let behind = [r * back_alpha, g * back_alpha, b * back_alpha, back_alpha];
        let mut bytes = vec![[0; 4]; self.pixels.len()];
        bytes.par_chunks_mut(1 << 14).zip(self.pixels.par_chunks(1 << 14)).for_each(|(bytes, pixels)| with_simd(Over { behind, pixels, bytes }));
        bytes.into_flattened()
    }
}

/// Rows of 8-bit colours as PNG.
///
/// # Errors
/// The encoder's.
pub fn encode_png(bytes: &[u8], [width, height]: [u32; 2], color: ExtendedColorType) -> Result<Vec<u8>> {
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(bytes, width, height, color)
        .map_err(|e| Error::value("output", format!("could not be encoded as PNG: {e}")))?;
    Ok(png)
}

/// Pixels over what is behind them, premultiplied both, as bytes that are not.
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
            let share = (all / f32x4::load_array(simd, [alpha, alpha, alpha, 1.0])).max(0.0).min(1.0);
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
        let picture = Picture { width: 2, height: 1, pixels: vec![[0.5, 0.0, 0.0, 0.5], [0.0; 4]] };
        assert_eq!(picture.over([0.0, 0.0, 1.0, 1.0]), [128, 0, 128, 255, 0, 0, 255, 255]);
        assert_eq!(picture.over([0.0; 4]), [255, 0, 0, 128, 0, 0, 0, 0]);
    }
}
