//! Adaptive antialiasing: which pixels are sampled again, and where.
//!
//! *Theory*: one sample at the centre of each pixel shows where a picture varies. A pixel that
//! differs visibly from a neighbour gets [`FIRST_OFFSETS`] more samples; if these disagree among
//! themselves, [`FURTHER_OFFSETS`] as well. All other pixels retain their one sample. Differences
//! are those that a viewer sees: of 8-bit colours over the background.
//!
//! *How to call it*: start with a picture of one sample per pixel, sample
//! [`pixels`](AdaptiveSamples::pixels) at the [`offsets`](AdaptiveSamples::offsets) of each round,
//! [`add`](AdaptiveSamples::add) the results, and [`finish`](AdaptiveSamples::finish). Every
//! renderer shares this part, and only this part.

use super::Picture;
use rayon::prelude::*;

/// A difference between neighbouring pixels from which both are sampled again, of 1.
const NEIGHBOR_DIFFERENCE: f32 = 8.0 / 255.0;
/// A difference between the samples of a pixel from which it gets all further ones.
const SAMPLE_DIFFERENCE: f32 = 16.0 / 255.0;

/// Position of a sample of a canonical arrangement (Chiu, Shirley, Wang 1994, "Multi-jittered
/// sampling"): cell (i, j) of 4 by 4, no two of the 16 in the same sixteenth of a row or column.
const fn cell(i: u8, j: u8) -> [f32; 2] {
    [
        (i as f32 + (j as f32 + 0.5) / 4.0) / 4.0 - 0.5,
        (j as f32 + (i as f32 + 0.5) / 4.0) / 4.0 - 0.5,
    ]
}

/// Offsets of the samples of the first round from a pixel's centre, pixels: one in each column and
/// row of cells.
pub const FIRST_OFFSETS: [[f32; 2]; 4] = [cell(1, 0), cell(3, 1), cell(0, 2), cell(2, 3)];

/// Offsets of the samples of the second round: the other cells.
pub const FURTHER_OFFSETS: [[f32; 2]; 12] = [
    cell(0, 0),
    cell(2, 0),
    cell(3, 0),
    cell(0, 1),
    cell(1, 1),
    cell(2, 1),
    cell(1, 2),
    cell(2, 2),
    cell(3, 2),
    cell(0, 3),
    cell(1, 3),
    cell(3, 3),
];

/// The samples of a picture's pixels.
pub struct AdaptiveSamples {
    picture: Picture,
    background: [f32; 4],
    round: usize,
    /// Pixels that are sampled in this round, ascending.
    pixels: Vec<u32>,
    /// Of each of them, the sums of all samples but the first.
    sums: Vec<[f32; 4]>,
    /// The smallest and the largest displayed colour of all its samples.
    ranges: Vec<[[f32; 4]; 2]>,
}

impl AdaptiveSamples {
    /// Starts with one sample at the centre of each pixel, shown over a background (not
    /// premultiplied).
    pub fn new(picture: Picture, background: [f32; 4]) -> Self {
        let mut samples = Self {
            picture,
            background,
            round: 0,
            pixels: Vec::new(),
            sums: Vec::new(),
            ranges: Vec::new(),
        };
        samples.pixels = samples.pixels_unlike_neighbors();
        samples.sums = vec![[0.0; 4]; samples.pixels.len()];
        samples.ranges = samples
            .pixels
            .iter()
            .map(|&n| [samples.displayed(samples.picture.pixels[n as usize]); 2])
            .collect();
        samples
    }

    /// The pixels to be sampled in this round, by index, ascending.
    pub fn pixels(&self) -> &[u32] {
        &self.pixels
    }

    /// Where in each of them, relative to its centre, pixels.
    pub fn offsets(&self) -> &'static [[f32; 2]] {
        match self.round {
            0 => &FIRST_OFFSETS,
            1 => &FURTHER_OFFSETS,
            _ => &[],
        }
    }

    /// Adds the samples of this round, those of each pixel together, and starts the next one.
    pub fn add(&mut self, samples: &[[f32; 4]]) {
        let per_pixel = self.offsets().len();
        let mut again = Vec::new();
        for (k, own) in samples.chunks_exact(per_pixel).enumerate() {
            for sample in own {
                let shown = self.displayed(*sample);
                let [low, high] = &mut self.ranges[k];
                for c in 0..4 {
                    self.sums[k][c] += sample[c];
                    low[c] = low[c].min(shown[c]);
                    high[c] = high[c].max(shown[c]);
                }
            }
            let n = self.pixels[k] as usize;
            let differ = (0..4).any(|c| self.ranges[k][1][c] - self.ranges[k][0][c] > SAMPLE_DIFFERENCE);
            if self.round == 0 && differ {
                again.push(k);
                continue;
            }
            // The sample at the centre only decides where the 16 others are needed: with them it
            // would weigh its neighbourhood twice.
            let first = if self.round == 0 {
                self.picture.pixels[n]
            } else {
                [0.0; 4]
            };
            let count = if self.round == 0 {
                FIRST_OFFSETS.len() + 1
            } else {
                FIRST_OFFSETS.len() + FURTHER_OFFSETS.len()
            };
            self.picture.pixels[n] = std::array::from_fn(|c| (self.sums[k][c] + first[c]) / count as f32);
        }
        self.round += 1;
        self.pixels = again.iter().map(|&k| self.pixels[k]).collect();
        self.sums = again.iter().map(|&k| self.sums[k]).collect();
        self.ranges = again.iter().map(|&k| self.ranges[k]).collect();
    }

    /// The picture.
    pub fn finish(self) -> Picture {
        self.picture
    }

    /// A premultiplied colour as displayed, and its opacity.
    fn displayed(&self, [r, g, b, a]: [f32; 4]) -> [f32; 4] {
        let [back_r, back_g, back_b, back_a] = self.background;
        let behind = (1.0 - a) * back_a;
        [
            r + behind * back_r,
            g + behind * back_g,
            b + behind * back_b,
            a + behind,
        ]
    }

    /// The pixels that differ from one of their eight neighbours.
    fn pixels_unlike_neighbors(&self) -> Vec<u32> {
        let (width, height) = (self.picture.width as usize, self.picture.height as usize);
        let shown: Vec<[f32; 4]> = self
            .picture
            .pixels
            .par_iter()
            .map(|p| self.displayed(*p))
            .collect();
        let unlike =
            |a: usize, b: usize| (0..4).any(|c| (shown[a][c] - shown[b][c]).abs() > NEIGHBOR_DIFFERENCE);
        (0..height)
            .into_par_iter()
            .flat_map_iter(|y| {
                let rows = y.saturating_sub(1)..(y + 2).min(height);
                (0..width).filter_map(move |x| {
                    let mut around = rows
                        .clone()
                        .flat_map(|v| (x.saturating_sub(1)..(x + 2).min(width)).map(move |u| v * width + u));
                    let n = y * width + x;
                    around.any(|m| unlike(n, m)).then_some(n as u32)
                })
            })
            .collect()
    }
}
