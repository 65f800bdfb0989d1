//! Adaptive antialiasing: which pixels are sampled again, and where.
//!
//! *Theory*: one sample at the centre of each pixel shows where a picture varies. A pixel that
//! differs visibly from the mean of the two pixels beside it, or of the two above and below it,
//! gets [`FIRST_OFFSETS`] more samples (even shading, whose second difference is small, does not);
//! if these disagree among themselves, [`FURTHER_OFFSETS`] as well. All other pixels retain their
//! one sample. Differences are those that a viewer sees: of colours over the background, and of
//! opacity where that is transparent. Where two surfaces at different depths have one colour, a
//! mixture of both has it too; hence depth and identity are not compared.
//!
//! *How to call it*: start with a picture of one sample per pixel, sample
//! [`pixels`](AdaptiveSamples::pixels) at the [`offsets`](AdaptiveSamples::offsets) of each round,
//! [`add`](AdaptiveSamples::add) the results, and [`finish`](AdaptiveSamples::finish). Every
//! renderer shares this part, and only this part.

use super::Picture;
use rayon::prelude::*;

/// A second difference, of 1, from which a pixel is sampled again.
const PIXEL_DIFFERENCE: f32 = 24.0 / 255.0;
/// A difference between the samples of a pixel from which it gets all further ones.
const SAMPLE_DIFFERENCE: f32 = 64.0 / 255.0;

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

    /// The pixels at which the picture is neither even nor an even slope.
    fn pixels_unlike_neighbors(&self) -> Vec<u32> {
        let (width, height) = (self.picture.width as usize, self.picture.height as usize);
        let shown: Vec<[f32; 4]> = self
            .picture
            .pixels
            .par_iter()
            .map(|p| self.displayed(*p))
            .collect();
        let differs = |n: usize, a: usize, b: usize| {
            (0..4).any(|c| (shown[a][c] + shown[b][c] - 2.0 * shown[n][c]).abs() > PIXEL_DIFFERENCE)
        };
        let is_unlike = |n: &usize| {
            let (x, y) = (n % width, n / width);
            let (left, right) = (n - usize::from(x > 0), n + usize::from(x + 1 < width));
            let up = if y > 0 { n - width } else { *n };
            let down = if y + 1 < height { n + width } else { *n };
            differs(*n, left, right) || differs(*n, up, down)
        };
        (0..width * height)
            .into_par_iter()
            .filter(is_unlike)
            .map(|n| n as u32)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BACKGROUND: [f32; 4] = [0.1, 0.1, 0.1, 1.0];

    /// A picture whose samples are given by a function of the position.
    fn refined(size: u32, color: impl Fn(f32, f32) -> [f32; 4]) -> (Picture, Picture, Vec<usize>) {
        let center = |n: u32| ((n % size) as f32 + 0.5, (n / size) as f32 + 0.5);
        let plain = Picture {
            width: size,
            height: size,
            pixels: (0..size * size)
                .map(|n| color(center(n).0, center(n).1))
                .collect(),
        };
        let mut samples = AdaptiveSamples::new(plain.clone(), BACKGROUND);
        let mut counts = Vec::new();
        while !samples.pixels().is_empty() {
            let offsets = samples.offsets();
            let colors: Vec<_> = samples
                .pixels()
                .iter()
                .flat_map(|&n| offsets.iter().map(move |o| (center(n), o)))
                .map(|((x, y), [dx, dy])| color(x + dx, y + dy))
                .collect();
            counts.push(samples.pixels().len());
            samples.add(&colors);
        }
        (plain, samples.finish(), counts)
    }

    #[test]
    fn every_cell_of_a_pixel_has_one_sample() {
        let mut cells = [0; 16];
        let (mut rows, mut columns) = ([0; 16], [0; 16]);
        for [x, y] in FIRST_OFFSETS.into_iter().chain(FURTHER_OFFSETS) {
            let part = |v: f32, n: f32| ((v + 0.5) * n) as usize;
            cells[part(y, 4.0) * 4 + part(x, 4.0)] += 1;
            rows[part(y, 16.0)] += 1;
            columns[part(x, 16.0)] += 1;
        }
        assert_eq!((cells, rows, columns), ([1; 16], [1; 16], [1; 16]));
        let sum = FIRST_OFFSETS
            .into_iter()
            .fold([0.0; 2], |s, o| [s[0] + o[0], s[1] + o[1]]);
        assert!(sum.iter().all(|s: &f32| s.abs() < 1e-6), "{sum:?}");
    }

    /// The coverage of pixels by a half plane, exact by its signed distance for edges that are
    /// nearly vertical.
    #[test]
    fn an_edge_is_covered_within_a_sixteenth() {
        let slope = 0.07;
        let edge = |y: f32| 11.3 + slope * y;
        let (plain, picture, counts) = refined(32, |x, y| {
            if x < edge(y) {
                [0.9, 0.8, 0.7, 1.0]
            } else {
                [0.0; 4]
            }
        });
        // Two pixels of each row, of which one holds the edge.
        assert_eq!(counts[0], 64);
        assert!((20..=64).contains(&counts[1]), "{counts:?}");
        for y in 0..32u32 {
            for x in 0..32u32 {
                let share = (edge(y as f32 + 0.5) - x as f32).clamp(0.0, 1.0);
                let n = (y * 32 + x) as usize;
                let error = (picture.pixels[n][3] - share).abs();
                assert!(error <= 1.0 / 16.0 + slope, "{x} {y}: {error}");
                if share == 0.0 || share == 1.0 {
                    assert_eq!(picture.pixels[n], plain.pixels[n]);
                }
            }
        }
    }

    #[test]
    fn even_shading_is_sampled_once() {
        let (plain, picture, counts) = refined(24, |x, y| {
            let v = 0.02 * x + 0.01 * y;
            [v, v, v, 1.0]
        });
        assert!(counts.is_empty(), "{counts:?}");
        assert_eq!(picture, plain);
    }
}
