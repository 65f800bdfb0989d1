//! Adaptive antialiasing: draws the additional samples of pixels that need them, by rays or by
//! slices as the picture itself. [`AdaptiveSamples`] decides which these are.
//!
//! The samples of one pixel share a packet, so that eight lanes sample nearly the same places.
//! Pixels of one tile are drawn by one task.

use super::found::FetchPolicy;
use super::packet::PacketSampler;
use super::slices::Slicer;
use super::{Positions, RenderStats};
use crate::Watch;
use crate::math::lanes::*;
use crate::picture::Picture;
use crate::picture::antialias::AdaptiveSamples;
use rayon::prelude::*;

/// Edges of a tile, pixels.
const TILE: [u32; 2] = [32, 8];

/// A picture of one sample per pixel with the additional samples.
pub(super) fn refined(
    sampler: &PacketSampler,
    slicer: Option<&Slicer>,
    picture: Picture,
    mut stats: RenderStats,
    watch: &Watch,
) -> (Picture, RenderStats) {
    let width = picture.width;
    let mut samples = AdaptiveSamples::new(picture, sampler.scene.settings.background);
    while !samples.pixels().is_empty() && !watch.is_cancelled() {
        let (pixels, offsets) = (samples.pixels(), samples.offsets());
        let tile = |k: &usize| {
            let n = pixels[*k];
            (n / width / TILE[1], n % width / TILE[0])
        };
        let mut by_tile: Vec<usize> = (0..pixels.len()).collect();
        by_tile.sort_by_key(tile);
        let drawn: Vec<_> = by_tile
            .chunk_by(|a, b| tile(a) == tile(b))
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|of_tile| {
                let positions = of_tile.iter().flat_map(|&k| {
                    let center = [pixels[k] % width, pixels[k] / width].map(|n| n as f32 + 0.5);
                    offsets.iter().map(move |o| [center[0] + o[0], center[1] + o[1]])
                });
                let list = SampleList {
                    sampler,
                    slicer,
                    positions: positions.collect(),
                };
                let (colors, stats) = if watch.is_cancelled() {
                    (vec![[0.0; 4]; list.positions.len()], RenderStats::default())
                } else {
                    with_simd(list)
                };
                (of_tile, colors, stats)
            })
            .collect();
        let mut colors = vec![[0.0; 4]; pixels.len() * offsets.len()];
        for (of_tile, of_samples, of_stats) in drawn {
            for (&k, own) in of_tile.iter().zip(of_samples.chunks_exact(offsets.len())) {
                colors[k * offsets.len()..][..offsets.len()].copy_from_slice(own);
            }
            stats = stats.plus(of_stats);
        }
        samples.add(&colors);
    }
    (samples.finish(), stats)
}

/// Samples at some positions of the picture that lie close together.
struct SampleList<'a> {
    sampler: &'a PacketSampler<'a>,
    slicer: Option<&'a Slicer<'a>>,
    positions: Vec<[f32; 2]>,
}

impl SimdKernel for SampleList<'_> {
    type Output = (Vec<[f32; 4]>, RenderStats);

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Self::Output {
        let mut stats = RenderStats::default();
        let mut colors = Vec::with_capacity(self.positions.len());
        let packets = self.positions.chunks(LANES);
        match self.slicer {
            Some(slicer) => {
                let places = packets.map(|list| Positions::of_list(simd, list)).collect();
                let drawn = slicer.draw(simd, places, &mut stats);
                colors.extend(drawn.into_iter().flatten().take(self.positions.len()));
            }
            None => {
                let mut fetch_policy = FetchPolicy::default();
                for list in packets {
                    let place = Positions::of_list(simd, list);
                    let drawn = self.sampler.trace(simd, &place, &mut stats, &mut fetch_policy);
                    colors.extend(&drawn[..list.len()]);
                }
            }
        }
        (colors, stats)
    }
}
