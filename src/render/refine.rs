//! Adaptive antialiasing: draws the additional samples of pixels that need them.
//! [`AdaptiveSamples`] decides which these are.
//!
//! Rays, and surfaces by rays, are independent of each other: their samples are listed by position
//! and drawn densely, as if they were the pixels of another picture. Slices and triangles are
//! rasterised: all pixels are drawn once for every offset. Triangles are then copied to the listed
//! samples; in slices, a mask leaves out the pixels that are not sampled again.

use super::target::{Layer, RenderTexture};
use super::{PictureInputs, Renderer};
use crate::gpu::{read_picture, texture_bytes};
use crate::picture::antialias::AdaptiveSamples;
use crate::picture::{Picture, StageTimes};
use crate::{Result, Watch};
use wgpu::TextureFormat;

/// Listed samples are drawn into textures of multiples of this many rows: of few sizes, so that
/// the next picture finds them in the cache.
const LIST_ROWS: u32 = 64;

/// The samples that a pass draws.
#[derive(Clone, Copy)]
pub(super) enum Samples<'a> {
    /// One in each pixel of a picture of this size.
    Pixels([u32; 2]),
    /// Samples listed by position.
    Listed(&'a SampleList),
    /// One in some pixels of a picture of this size, whose mask has depth 0 elsewhere.
    Masked([u32; 2], &'a RenderTexture),
}

/// Samples by position, in rows; those of each offset start a new row.
pub(super) struct SampleList {
    pub positions: wgpu::TextureView,
    /// Of the textures that they are drawn into.
    texture_size: [u32; 2],
    /// Rows of each offset.
    rows: u32,
    /// Of the samples from their pixels' centres, pixels.
    pub offsets: Vec<[f32; 2]>,
    /// Of the picture.
    pub picture_size: [u32; 2],
}

impl SampleList {
    /// The rows of one offset, first and past the last.
    pub(super) fn rows_of(&self, offset: usize) -> [u32; 2] {
        let first = offset as u32 * self.rows;
        [first, first + self.rows]
    }
}

impl Samples<'_> {
    /// Size of the textures that they are drawn into.
    pub(super) fn texture_size(&self) -> [u32; 2] {
        match self {
            Self::Pixels(size) | Self::Masked(size, _) => *size,
            Self::Listed(list) => list.texture_size,
        }
    }

    /// The part of them that is drawn.
    pub(super) fn drawn_size(&self) -> [u32; 2] {
        match self {
            Self::Pixels(size) | Self::Masked(size, _) => *size,
            Self::Listed(list) => [list.texture_size[0], list.rows * list.offsets.len() as u32],
        }
    }

    pub(super) fn is_listed(&self) -> bool {
        matches!(self, Self::Listed(_))
    }

    /// Names of a layer's textures, so that pictures and lists do not evict each other.
    pub(super) fn layer_names(&self, [picture, list]: [[&'static str; 3]; 2]) -> [&'static str; 3] {
        if self.is_listed() { list } else { picture }
    }
}

impl Renderer {
    /// A picture of one sample per pixel with the additional samples.
    pub(super) fn refined(
        &mut self,
        inputs: &PictureInputs,
        picture: Picture,
        shows_volume: bool,
    ) -> Result<Picture> {
        // One stage of the picture, however many passes it takes.
        let stages = &mut StageTimes::default();
        let watch = Watch {
            progress: &|_| (),
            ..*inputs.watch
        };
        let inputs = &PictureInputs {
            watch: &watch,
            ..*inputs
        };
        let mut samples = AdaptiveSamples::new(picture, inputs.scene.settings.background);
        while !samples.pixels().is_empty() {
            let colors = if shows_volume && inputs.scene.has_slices() {
                self.samples_by_offset(inputs, &samples, stages)?
            } else {
                self.listed_samples(inputs, &samples, shows_volume, stages)?
            };
            samples.add(&colors);
        }
        Ok(samples.finish())
    }

    /// Colours of the samples, those of each pixel together, drawn as a list.
    fn listed_samples(
        &mut self,
        inputs: &PictureInputs,
        samples: &AdaptiveSamples,
        shows_volume: bool,
        stages: &mut StageTimes,
    ) -> Result<Vec<[f32; 4]>> {
        let (pixels, offsets) = (samples.pixels(), samples.offsets());
        let picture_size = inputs.scene.frame.size;
        let width = picture_size[0];
        let rows = (pixels.len() as u32).div_ceil(width);
        let most_rows = self.context.device.device.limits().max_texture_dimension_2d;
        let at_once = (most_rows / LIST_ROWS * LIST_ROWS / rows).max(1) as usize;
        let mut colors = vec![[0.0; 4]; pixels.len() * offsets.len()];
        for (group, first) in offsets.chunks(at_once).zip((0..).step_by(at_once)) {
            let height = (rows * group.len() as u32)
                .next_multiple_of(LIST_ROWS)
                .min(most_rows);
            let mut positions = vec![[0.0f32; 2]; (width * height) as usize];
            let of_offset = (width * rows) as usize;
            for (offset, row) in group.iter().zip(positions.chunks_mut(of_offset)) {
                for (n, position) in row.iter_mut().enumerate() {
                    // The rest of the last row repeats the last pixel.
                    let pixel = pixels[n.min(pixels.len() - 1)];
                    let center = [pixel % width, pixel / width].map(|n| n as f32 + 0.5);
                    *position = [center[0] + offset[0], center[1] + offset[1]];
                }
            }
            let list = SampleList {
                positions: self.positions_texture(&positions, [width, height]),
                texture_size: [width, height],
                rows,
                offsets: group.to_vec(),
                picture_size,
            };
            let shared = inputs.shared.with_positions(&list.positions);
            let listed = PictureInputs {
                shared: &shared,
                samples: Samples::Listed(&list),
                ..*inputs
            };
            let drawn = self.draw_samples(&listed, shows_volume, stages)?;
            for (o, of_offset) in drawn.chunks(of_offset).take(group.len()).enumerate() {
                for (n, color) in of_offset[..pixels.len()].iter().enumerate() {
                    colors[n * offsets.len() + first + o] = *color;
                }
            }
        }
        Ok(colors)
    }

    fn positions_texture(&mut self, positions: &[[f32; 2]], [width, height]: [u32; 2]) -> wgpu::TextureView {
        let target = self.targets.target(
            &self.context,
            "sample positions",
            width,
            height,
            TextureFormat::Rg32Float,
        );
        let size = [width as usize, height as usize, 1];
        self.context
            .write_layers(&target.texture, 0, bytemuck::cast_slice(positions), size);
        target.view
    }

    /// Colours of the samples, those of each pixel together, drawn one offset after the other.
    fn samples_by_offset(
        &mut self,
        inputs: &PictureInputs,
        samples: &AdaptiveSamples,
        stages: &mut StageTimes,
    ) -> Result<Vec<[f32; 4]>> {
        let (pixels, offsets) = (samples.pixels(), samples.offsets());
        let size @ [width, height] = inputs.scene.frame.size;
        let mut again = vec![0.0f32; (width * height) as usize];
        for &pixel in pixels {
            again[pixel as usize] = 1.0;
        }
        let mask = self.targets.target(
            &self.context,
            "pixels sampled again",
            width,
            height,
            TextureFormat::R32Float,
        );
        let layer = [width as usize, height as usize, 1];
        self.context
            .write_layers(&mask.texture, 0, bytemuck::cast_slice(&again), layer);
        let mut colors = vec![[0.0; 4]; pixels.len() * offsets.len()];
        for (o, offset) in offsets.iter().enumerate() {
            inputs.shared.move_samples(&self.context, *offset);
            let masked = PictureInputs {
                samples: Samples::Masked(size, &mask),
                ..*inputs
            };
            let drawn = self.draw_samples(&masked, true, stages)?;
            for (n, &pixel) in pixels.iter().enumerate() {
                colors[n * offsets.len() + o] = drawn[pixel as usize];
            }
        }
        inputs.shared.move_samples(&self.context, [0.0; 2]);
        Ok(colors)
    }

    /// Draws and reads back samples: surfaces, and the volume in front of them.
    pub(super) fn draw_samples(
        &mut self,
        inputs: &PictureInputs,
        shows_volume: bool,
        stages: &mut StageTimes,
    ) -> Result<Vec<[f32; 4]>> {
        let behind = self.draw_surfaces_behind(inputs, stages)?;
        let target = match (shows_volume, behind) {
            (false, Some(Layer { color, .. })) => color,
            (_, behind) => self.draw_volume(inputs, behind.as_ref(), stages)?,
        };
        stages.time("readback", || {
            let buffer = self.targets.readback(&self.context, texture_bytes(&target));
            read_picture(
                &self.context.device.device,
                &self.context.device.queue,
                &target,
                &buffer,
            )
        })
    }
}
