//! The CPU renderer: the reference for tests, and the backend where there is no GPU.
//!
//! *Theory*: two renderers of volumes share what a sample is (`packet`, `packet_shading`, `found`,
//! [`shading`]) and nothing else. *Rays* ([`march`]) put samples at t = (i + 1/2) Δ from the eye
//! and composite them front to back. *Slices* (`slices`) rasterise the polygons in which the
//! planes at depths (i + 1/2) Δ cut the volume's box, and composite them back to front. Surfaces
//! are found first, by [`surface`]. Samples are anchored at the eye, not at the box; a different
//! box (one map more or less, skipping on or off) samples the same points.
//!
//! Each sample evaluates the cheapest test first: macrocell, mask and source point, value, opacity.
//! Only visible samples need a gradient, a Jacobian (where there is a normal or a cut is near) and
//! lighting ([`shading`]). From the second picture of a volume on, where most samples are visible,
//! gradients are read with the values ([`GradientVolume`](crate::volume::GradientVolume), on huge
//! pages). Eight neighbouring rays share every instruction ([`march`], and `packet`,
//! `packet_shading` for their samples).
//!
//! Threads steal strips of rows from each other, starting at the middle of the picture, so that all
//! threads finish together. Pixels are independent, hence the result does not depend on the number
//! of threads. Packets go down columns of 8 or 16 rows; each finds the voxels of the previous one
//! in the cache. Pixels whose rays miss everything visible are skipped.
//!
//! Tried without gain: AVX-512; bounds of blocks of two voxels; bisecting surface entries by three
//! independent samples instead of two dependent ones (the cost is work, not latency). Measurements
//! are in `benches/HISTORY.md`; `benches/growth.rs` prints how many trilinear samples a machine can
//! fetch. Where the only adapter is a software one, `--backend auto` selects this renderer, which
//! is faster there.
//!
//! `shaders/lib` contains the same arithmetic under the same names.

mod edges;
mod found;
mod light;
pub mod march;
mod outline;
mod packet;
mod packet_shading;
pub mod pick;
mod refine;
pub mod section;
pub mod shading;
mod slices;
pub mod surface;
pub mod surface_shading;

use crate::math::lanes::*;
use crate::picture::{Picture, RenderStats, Rendered, StageTimes};
use crate::prepare::Prepared;
use crate::scene::{Antialias, Mode};
use crate::transfer::Blend;
use crate::volume::VolumeSampler;
use crate::{Result, Watch};
use found::{FetchPolicy, pixel_shift};
use glam::Vec3;
use march::RayPacket;
use packet::PacketSampler;
use rayon::prelude::*;
use slices::{SliceStrip, Slicer};
use std::sync::atomic::{AtomicUsize, Ordering};

/// A ray ends when its remaining transmittance falls below this: less than half an 8-bit step can
/// follow.
const MIN_TRANSMITTANCE: f32 = 1.0 / 512.0;

/// Rows per task, in whole packets: where there are enough tasks to keep all threads busy to the
/// end, and where there are not.
const STRIP_ROWS: [usize; 2] = [16, 8];
/// Tasks per thread that are enough.
const STRIPS_PER_THREAD: usize = 4;

/// Renders a prepared scene.
pub fn render(scene: &Prepared) -> Rendered {
    let (picture, stats, stages) = render_rows(scene, &Watch::NONE);
    scene.rendered(picture, Some(stats), stages, Vec::new())
}

/// As [`render`], for a caller that may cancel: checks for cancellation before each strip of rows,
/// and reports progress from several threads.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn render_watched(scene: &Prepared, watch: &Watch) -> Result<Rendered> {
    let (picture, stats, stages) = render_rows(scene, watch);
    watch.check()?;
    Ok(scene.rendered(picture, Some(stats), stages, Vec::new()))
}

/// Rows after a cancellation stay empty.
fn render_rows(scene: &Prepared, watch: &Watch) -> (Picture, RenderStats, StageTimes) {
    let mut stages = StageTimes::default();
    scene.stack.fetch_texels();
    let gradients = stages.time("gradients", || scene.gradients_for_picture());
    let sampler = VolumeSampler::new(scene.volume().grid).with_gradients(gradients);
    let (picture, stats) = stages.time("render", || rows(scene, &sampler, watch));
    (picture.reduced(scene.settings.antialias.grid()), stats, stages)
}

/// Some whole rows of a picture.
struct Strip<'a> {
    /// The first row.
    top: usize,
    /// Columns and rows where anything may be visible, first and past the last; the other pixels
    /// stay empty.
    columns: [usize; 2],
    lines: [usize; 2],
    pixels: &'a mut [[f32; 4]],
}

/// Draws a picture by strips of rows, on all threads.
fn rows(scene: &Prepared, sampler: &VolumeSampler, watch: &Watch) -> (Picture, RenderStats) {
    let [width, height] = scene.frame.size;
    let mut pixels = vec![[0.0f32; 4]; width as usize * height as usize];
    let done = AtomicUsize::new(0);
    let strip_rows = STRIP_ROWS
        [usize::from((height as usize) < STRIP_ROWS[0] * STRIPS_PER_THREAD * rayon::current_num_threads())];
    let sampler = PacketSampler::new(scene, sampler);
    let slicer = (scene.settings.mode == Mode::Slice).then(|| Slicer::new(&sampler));
    let [columns, lines] = if scene.surfaces.objects.is_empty() {
        scene.frame.view.pixels_of(&scene.frame.proxy, scene.frame.size)
    } else {
        [[0, width as usize], [0, height as usize]]
    };
    let mut strips: Vec<_> = pixels
        .chunks_mut(width as usize * strip_rows)
        .enumerate()
        .collect();
    // From the middle outwards: expensive strips start first, and the threads end together on cheap
    // ones.
    strips.sort_by_key(|&(n, _)| (2 * n * strip_rows + strip_rows).abs_diff(lines[0] + lines[1]));
    let stats = strips
        .into_iter()
        .par_bridge()
        .map(|(n, pixels)| {
            if watch.is_cancelled() {
                return RenderStats::default();
            }
            let strip = Strip {
                top: n * strip_rows,
                columns,
                lines,
                pixels,
            };
            let stats = match &slicer {
                Some(slicer) => with_simd(SliceStrip { slicer, strip }),
                None => with_simd(RayStrip {
                    sampler: &sampler,
                    strip,
                }),
            };
            let rows = done.fetch_add(strip_rows, Ordering::Relaxed) + strip_rows;
            (watch.progress)((rows as f32 / height as f32).min(1.0));
            stats
        })
        .reduce(RenderStats::default, RenderStats::plus);
    let picture = Picture {
        width,
        height,
        pixels,
    };
    match scene.settings.antialias {
        Antialias::Adaptive => refine::refined(&sampler, slicer.as_ref(), picture, stats, watch),
        Antialias::Grid(_) => (picture, stats),
    }
}

/// A strip drawn by rays.
struct RayStrip<'a> {
    sampler: &'a PacketSampler<'a>,
    strip: Strip<'a>,
}

impl SimdKernel for RayStrip<'_> {
    type Output = RenderStats;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> RenderStats {
        let Self { sampler, strip } = self;
        let width = sampler.scene.frame.size[0] as usize;
        let (mut stats, mut fetch_policy) = (RenderStats::default(), FetchPolicy::default());
        let rows = strip.pixels.len() / width;
        let seen = |y: &usize| strip.top + y + 1 >= strip.lines[0] && strip.top + y < strip.lines[1];
        // Columns of packets: each packet finds in the cache what the one above it has fetched.
        let columns = (strip.columns[0] / 4 * 4..strip.columns[1]).step_by(4);
        for (y, x) in columns.flat_map(|x| (0..rows).step_by(2).filter(seen).map(move |y| (y, x))) {
            let place = Positions::block(simd, x, strip.top + y, [width, strip.top + rows]);
            let colors = sampler.trace(simd, &place, &mut stats, &mut fetch_policy);
            for n in (0..LANES).filter(|n| place.wanted[*n]) {
                strip.pixels[(y + n / 4) * width + x + n % 4] = colors[n];
            }
        }
        stats
    }
}

/// Eight positions on the picture.
struct Positions<S: Simd> {
    /// Pixels from the left and from the top.
    x: f32x8<S>,
    y: f32x8<S>,
    /// Which of them are drawn.
    wanted: [bool; LANES],
}

impl<S: Simd> Positions<S> {
    /// The centres of four by two pixels from (x, y) on; those inside of `end` are drawn.
    #[inline(always)]
    fn block(simd: S, x: usize, y: usize, end: [usize; 2]) -> Self {
        let across = f32x8::load_array(simd, [0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5]);
        let down = f32x8::load_array(simd, [0.5, 0.5, 0.5, 0.5, 1.5, 1.5, 1.5, 1.5]);
        Self {
            x: across + x as f32,
            y: down + y as f32,
            wanted: std::array::from_fn(|n| x + n % 4 < end[0] && y + n / 4 < end[1]),
        }
    }

    /// The first eight of some positions; the rest of a shorter list is not drawn.
    #[inline(always)]
    fn of_list(simd: S, list: &[[f32; 2]]) -> Self {
        let of_lane = |n: usize, axis: usize| list[n.min(list.len() - 1)][axis];
        Self {
            x: f32x8::load_array(simd, std::array::from_fn(|n| of_lane(n, 0))),
            y: f32x8::load_array(simd, std::array::from_fn(|n| of_lane(n, 1))),
            wanted: std::array::from_fn(|n| n < list.len()),
        }
    }

    /// A pixel's shift of its samples along its ray, steps.
    fn shift(&self, lane: usize) -> f32 {
        pixel_shift(self.x[lane] as u32, self.y[lane] as u32)
    }

    /// Coordinates in the picture, -1 to 1, upwards.
    #[inline(always)]
    fn uv(&self, simd: S, [width, height]: [u32; 2]) -> [f32x8<S>; 2] {
        let one = f32x8::splat(simd, 1.0);
        [
            self.x / width as f32 * 2.0 - 1.0,
            one - self.y / height as f32 * 2.0,
        ]
    }
}

impl PacketSampler<'_> {
    /// The colours of eight positions by rays, premultiplied. One copy for whole pictures and for
    /// single samples.
    #[inline(never)]
    fn trace<S: Simd>(
        &self,
        simd: S,
        place: &Positions<S>,
        stats: &mut RenderStats,
        fetch_policy: &mut FetchPolicy,
    ) -> [[f32; 4]; LANES] {
        simd.vectorize(
            #[inline(always)]
            || {
                let scene = self.scene;
                let frame = &scene.frame;
                let [u, v] = place.uv(simd, frame.size);
                let (origin, direction) = frame.view.rays(simd, u, v);
                let mut rays = RayPacket {
                    origin,
                    direction,
                    until: f32x8::splat(simd, f32::INFINITY),
                };
                let mut behind = [None; LANES];
                if !scene.surfaces.objects.is_empty() {
                    for n in (0..LANES).filter(|n| place.wanted[*n]) {
                        behind[n] = surface_shading::nearest(
                            scene,
                            origin.lane(n),
                            direction.lane(n),
                            &mut stats.samples_taken,
                        );
                        rays.until[n] = behind[n].as_ref().map_or(f32::INFINITY, |hit| hit.t);
                    }
                }
                if scene.settings.jitter {
                    for n in 0..LANES {
                        // Samples are shifted by moving the origin of the ray.
                        let shift = place.shift(n) * frame.spacing.step_mm;
                        rays.origin.set(n, origin.lane(n) + direction.lane(n) * shift);
                        rays.until[n] = (rays.until[n] - shift).max(0.0);
                    }
                }
                for n in (0..LANES).filter(|n| !place.wanted[*n]) {
                    rays.until[n] = -1.0;
                }
                let mut colors = self.march(simd, rays, stats, fetch_policy);
                for (color, hit) in colors.iter_mut().zip(behind) {
                    if let Some(hit) = hit {
                        let [r, g, b, a] = *color;
                        *color = (Vec3::new(r, g, b) + hit.color * (1.0 - a))
                            .extend(1.0)
                            .to_array();
                    }
                }
                colors
            },
        )
    }
}

/// The sample at a point of the deformed scene.
#[derive(Clone, Copy)]
struct SceneSample {
    /// Source position, voxels.
    in_voxel: Vec3,
    /// Normalised value; only meaningful if `present`.
    value: f32,
    /// Not cut away, not outside the volume, not in a hole.
    present: bool,
    /// Smallest mask along the way: strictly between 0 and 1 near a cut.
    alpha: f32,
}

/// Samples a point of the deformed scene.
#[inline(always)]
fn sample_scene(scene: &Prepared, sampler: &VolumeSampler, deformed: Vec3) -> SceneSample {
    if scene.cuts.signed_distance_mm(deformed) < 0.0 {
        return SceneSample {
            in_voxel: Vec3::ZERO,
            value: 0.0,
            present: false,
            alpha: 0.0,
        };
    }
    let (source, alpha) = scene.stack.source_and_alpha(deformed);
    let in_voxel = scene.volume().voxel_from_world.transform_point3(source);
    if alpha < 0.5
        || in_voxel.cmplt(Vec3::splat(-0.5)).any()
        || in_voxel.cmpgt(scene.volume().grid_size - 0.5).any()
    {
        return SceneSample {
            in_voxel,
            value: 0.0,
            present: false,
            alpha,
        };
    }
    let value = sampler.sample(in_voxel);
    SceneSample {
        in_voxel,
        value,
        present: !scene.volume().grid.has_holes || value >= -1e-4,
        alpha,
    }
}

/// Index of the first sample at or after `t`.
fn first_sample_after(t: f32, step: f32) -> i32 {
    (t / step - 0.5).ceil().max(0.0) as i32
}

/// The samples of a projection along eight rays.
struct IntensityProjection<S: Simd> {
    blend: Blend,
    value: f32x8<S>,
    count: f32x8<S>,
}

impl<S: Simd> IntensityProjection<S> {
    #[inline(always)]
    fn new(simd: S, blend: Blend) -> Self {
        let value = match blend {
            Blend::Minip => f32::INFINITY,
            Blend::Mip => f32::NEG_INFINITY,
            _ => 0.0,
        };
        Self {
            blend,
            value: f32x8::splat(simd, value),
            count: f32x8::splat(simd, 0.0),
        }
    }

    /// Adds the values of the rays whose sample is present.
    #[inline(always)]
    fn insert(&mut self, value: f32x8<S>, present: mask32x8<S>) {
        self.count = present.select(self.count + 1.0, self.count);
        let with = match self.blend {
            Blend::Mip => self.value.max(value),
            Blend::Minip => self.value.min(value),
            _ => self.value + value,
        };
        self.value = present.select(with, self.value);
    }

    /// The projected value of a ray through the transfer function, premultiplied; transparent where
    /// no sample was present.
    fn color(&self, scene: &Prepared, lane: usize) -> [f32; 4] {
        let (value, count) = (self.value[lane], self.count[lane]);
        if count == 0.0 {
            return [0.0; 4];
        }
        let value = if self.blend == Blend::Average {
            value / count
        } else {
            value
        };
        let [r, g, b, depth] = scene.volume().table.lookup(value);
        let alpha = 1.0 - (-depth).exp2();
        [r * alpha, g * alpha, b * alpha, alpha]
    }
}
