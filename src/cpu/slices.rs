//! Slices on the CPU: a rasteriser of the polygons in which view-aligned planes cut the proxy
//! geometry ([`SlicePolygons`]), and the composition of their fragments back to front ("over",
//! premultiplied; \[DDM06\] section 4).
//!
//! *Theory*: a slice is parallel to the picture plane, so interpolation over its polygon is affine
//! in pixel coordinates: the fragment of pixel (u, v) at depth z lies at
//! eye + z (forward + u right + v up), or at eye + z forward + u right + v up without perspective.
//! A fragment stands for the path Δ / cos θ between slices along its pixel's ray, θ being the angle
//! between that ray and the slices' normal (opacity correction).
//!
//! *Method*: the picture is drawn in tiles small enough for the cache; a tile passes through all
//! slices before the next one starts. A polygon covers the pixels whose centres it contains; a
//! centre on an edge that two triangles share belongs to one of them, as on a GPU. Nothing of a ray
//! is stored between two slices but the colour composited so far: each fragment is sampled and
//! shaded on its own. This renderer shares with [`super::march`] what a sample is and represents, and
//! nothing else; in an orthographic view, where both take the same samples, they must agree to rounding.
//!
//! Options, as on the GPU: slabs of several slices composited before they are blended; front to
//! back with an end at opaque pixels; blending in 16 bits.
//!
//! `shaders/slice.wgsl` contains what one fragment does; the rasteriser is the GPU's own.

use super::edges::{FoundSamples, Neighbours, NewSamples, ShadingRays};
use super::found::FetchPolicy;
use super::outline::{Edge, Outline};
use super::packet::{PacketSampler, SamplePacket};
use super::{IntensityProjection, MIN_TRANSMITTANCE, Positions, Strip, surface_shading};
use crate::math::Bounds;
use crate::math::lanes::*;
use crate::picture::RenderStats;
use crate::prepare::slices::{Slab, SlicePolygons};
use crate::scene::{BlendFormat, Projection, SliceOrder};
use glam::{Vec2, Vec3};
use half::f16;
use half::slice::HalfFloatSliceExt;

/// Columns of a tile; its rows are those of a strip.
const TILE_COLUMNS: usize = 32;

/// What all tiles of a picture share.
pub(super) struct Slicer<'a> {
    sampler: &'a PacketSampler<'a>,
    slices: SlicePolygons,
    /// Whether slices sample surfaces, and a volume.
    has_surfaces: bool,
    has_volume: bool,
    /// The polygons on the picture, in the order of `slices.polygons`.
    outlines: Vec<Outline>,
}

impl<'a> Slicer<'a> {
    pub(super) fn new(sampler: &'a PacketSampler<'a>) -> Self {
        let scene = sampler.scene;
        let frame = &scene.frame;
        let slices = scene.slice_polygons();
        let size = Vec2::new(frame.size[0] as f32, frame.size[1] as f32);
        let outlines = slices
            .polygons
            .iter()
            .map(|range| {
                let corners = &slices.corners[range.start as usize..range.end as usize];
                Outline::new(&frame.view, size, corners)
            })
            .collect();
        Self {
            sampler,
            slices,
            has_surfaces: scene.sliced_surfaces().next().is_some(),
            has_volume: scene.shows_volume(),
            outlines,
        }
    }
}

/// A strip drawn by slices.
pub(super) struct SliceStrip<'a> {
    pub(super) slicer: &'a Slicer<'a>,
    pub(super) strip: Strip<'a>,
}

/// Eight positions on the picture, and what has been composited there.
struct PixelPacket<S: Simd> {
    place: Positions<S>,
    /// Positions at depth z are origin + z across.
    origin: Vec3x8<S>,
    across: Vec3x8<S>,
    /// The pixels' rays, and the paths between slices along them.
    rays: ShadingRays<S>,
    /// Those paths in reference lengths.
    length: f32x8<S>,
    /// Distance by which samples are moved along the rays, mm.
    shift: f32x8<S>,
    /// Depth at which something opaque hides the slices, mm; negative outside the picture.
    until: f32x8<S>,
    /// Colours of surfaces behind the volume.
    behind: [Option<Vec3>; LANES],
    /// Premultiplied.
    color: Vec3x8<S>,
    alpha: f32x8<S>,
    projection: IntensityProjection<S>,
}

impl<S: Simd> PixelPacket<S> {
    /// Whether any of its pixels is not opaque yet.
    #[inline(always)]
    fn is_open(&self) -> bool {
        (self.until.simd_ge(0.0) & !self.alpha.simd_gt(1.0 - MIN_TRANSMITTANCE)).any_true()
    }
}

/// Positions that lie close together.
struct Tile<S: Simd> {
    packets: Vec<PixelPacket<S>>,
    /// Corners of their rectangle, pixels.
    corners: [Vec2; 4],
    /// Lines through the corners: at depth z they are at the first plus z times the second.
    lines: [(Vec3, Vec3); 4],
    /// Distance by which samples may be moved, mm.
    shift_mm: f32,
}

impl<S: Simd> Tile<S> {
    /// The box of the tile's samples between two depths, mm.
    fn bounds(&self, depths: &[f32; 2]) -> Bounds {
        let points = self
            .lines
            .iter()
            .flat_map(|(origin, across)| depths.map(|z| *origin + *across * z));
        points
            .map(|p| Bounds::new(p, p))
            .fold(Bounds::EMPTY, |all, p| all.union(&p))
            .grown(self.shift_mm)
    }
}

/// Colour and transmittance of a fragment of one slab.
struct SlabFragments<S: Simd> {
    color: Vec3x8<S>,
    transmittance: f32x8<S>,
    /// Where it shows anything.
    any: mask32x8<S>,
}

impl SimdKernel for SliceStrip<'_> {
    type Output = RenderStats;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> RenderStats {
        let Self { slicer, strip } = self;
        let width = slicer.sampler.scene.frame.size[0] as usize;
        let rows = strip.pixels.len() / width;
        let mut stats = RenderStats::default();
        let [first, last] = strip.columns;
        let seen = |y: &usize| strip.top + y + 1 >= strip.lines[0] && strip.top + y < strip.lines[1];
        for left in (first / TILE_COLUMNS * TILE_COLUMNS..last).step_by(TILE_COLUMNS) {
            let right = (left + TILE_COLUMNS).min(last);
            let blocks: Vec<_> = (0..rows)
                .step_by(2)
                .filter(seen)
                .flat_map(|y| (left..right).step_by(4).map(move |x| (x, y)))
                .collect();
            if blocks.is_empty() {
                continue;
            }
            let end = [width, strip.top + rows];
            let places = blocks
                .iter()
                .map(|&(x, y)| Positions::block(simd, x, strip.top + y, end))
                .collect();
            for ((x, y), colors) in blocks.iter().zip(slicer.draw(simd, places, &mut stats)) {
                for n in (0..LANES).filter(|n| x + n % 4 < width && y + n / 4 < rows) {
                    strip.pixels[(y + n / 4) * width + x + n % 4] = colors[n];
                }
            }
        }
        stats
    }
}

impl Slicer<'_> {
    /// The colours of positions that lie close together, premultiplied. One copy for whole pictures
    /// and for single samples.
    #[inline(never)]
    pub(super) fn draw<S: Simd>(
        &self,
        simd: S,
        places: Vec<Positions<S>>,
        stats: &mut RenderStats,
    ) -> Vec<[[f32; 4]; LANES]> {
        simd.vectorize(
            #[inline(always)]
            || {
                let mut tile = self.tile(simd, places, stats);
                self.draw_tile(simd, &mut tile, stats);
                tile.packets.iter().map(|pixels| self.colors(pixels)).collect()
            },
        )
    }

    /// Draws all slices of a tile.
    #[inline(always)]
    fn draw_tile<S: Simd>(&self, simd: S, tile: &mut Tile<S>, stats: &mut RenderStats) {
        let front_to_back = self.sampler.scene.slice_order() == SliceOrder::FrontToBack;
        let mut fetch_policy = FetchPolicy::default();
        let slabs = &self.slices.slabs;
        for n in 0..slabs.len() {
            let slab = if front_to_back {
                &slabs[n]
            } else {
                &slabs[slabs.len() - 1 - n]
            };
            let is_open = self.draw_slab(simd, tile, slab, stats, &mut fetch_policy);
            if !is_open {
                break;
            }
        }
    }

    /// The colours of a packet when all slices have been drawn, premultiplied.
    fn colors<S: Simd>(&self, pixels: &PixelPacket<S>) -> [[f32; 4]; LANES] {
        let scene = self.sampler.scene;
        let drawn_over = self.sampler.composite && scene.slice_order() == SliceOrder::BackToFront;
        std::array::from_fn(|n| {
            let [r, g, b, a] = if self.sampler.composite {
                let color = pixels.color.lane(n);
                [color.x, color.y, color.z, pixels.alpha[n]]
            } else {
                pixels.projection.color(scene, n)
            };
            match pixels.behind[n] {
                Some(color) if !drawn_over => (Vec3::new(r, g, b) + color * (1.0 - a)).extend(1.0).to_array(),
                _ => [r, g, b, a],
            }
        })
    }

    /// A tile before the first slice: surfaces behind the volume are already there.
    #[inline(always)]
    fn tile<S: Simd>(&self, simd: S, places: Vec<Positions<S>>, stats: &mut RenderStats) -> Tile<S> {
        let scene = self.sampler.scene;
        let frame = &scene.frame;
        let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        for place in &places {
            for n in 0..LANES {
                let p = Vec2::new(place.x[n], place.y[n]);
                (low, high) = (low.min(p), high.max(p));
            }
        }
        let corners = [low, Vec2::new(high.x, low.y), high, Vec2::new(low.x, high.y)];
        let [width, height] = frame.size.map(|n| n as f32);
        let lines = corners.map(|p| {
            frame
                .view
                .across(p.x / width * 2.0 - 1.0, 1.0 - p.y / height * 2.0)
        });
        let packets = places
            .into_iter()
            .map(
                #[inline(always)]
                |place| self.pixel_packet(simd, place, stats),
            )
            .collect();
        Tile {
            packets,
            corners,
            lines,
            shift_mm: if scene.settings.jitter {
                0.5 * frame.spacing.step_mm * frame.view.longest_slant()
            } else {
                0.0
            },
        }
    }

    /// A packet before the first slice.
    #[inline(always)]
    fn pixel_packet<S: Simd>(&self, simd: S, place: Positions<S>, stats: &mut RenderStats) -> PixelPacket<S> {
        let scene = self.sampler.scene;
        let frame = &scene.frame;
        let zero = f32x8::splat(simd, 0.0);
        let [u, v] = place.uv(simd, frame.size);
        let (origin, direction) = frame.view.rays(simd, u, v);
        let forward = Vec3x8::splat(simd, frame.view.forward);
        let slant = direction.dot(forward);
        let step = f32x8::splat(simd, frame.spacing.step_mm) / slant;
        let to_picture = Vec3x8::splat(simd, frame.view.right) * u + Vec3x8::splat(simd, frame.view.up) * v;
        let mut pixels = PixelPacket {
            place,
            origin,
            across: match frame.view.projection {
                Projection::Perspective => forward + to_picture,
                Projection::Orthographic => forward,
            },
            rays: ShadingRays {
                direction,
                half: (Vec3x8::splat(simd, frame.to_light) - direction).normalized(),
                step,
            },
            length: step * frame.spacing.reference_mm.recip(),
            shift: zero,
            until: f32x8::splat(simd, f32::INFINITY),
            behind: [None; LANES],
            color: Vec3x8::splat(simd, Vec3::ZERO),
            alpha: zero,
            projection: IntensityProjection::new(simd, scene.volume().blend),
        };
        let drawn_over = self.sampler.composite && scene.slice_order() == SliceOrder::BackToFront;
        let shows_surfaces = scene.has_surfaces_behind();
        for n in 0..LANES {
            if !pixels.place.wanted[n] {
                pixels.until[n] = -1.0;
                continue;
            }
            if scene.settings.jitter {
                pixels.shift[n] = pixels.place.shift(n) * step[n];
            }
            if !shows_surfaces {
                continue;
            }
            let hit =
                surface_shading::nearest(scene, origin.lane(n), direction.lane(n), &mut stats.samples_taken);
            if let Some(hit) = hit {
                pixels.until[n] = (hit.t - pixels.shift[n]) * slant[n];
                pixels.behind[n] = Some(hit.color);
                if drawn_over {
                    pixels.color.set(n, hit.color);
                    pixels.alpha[n] = 1.0;
                }
            }
        }
        pixels
    }

    /// Depths of the first and the last slice of a slab, mm.
    fn depths(&self, slab: &Slab) -> [f32; 2] {
        [0, i64::from(self.slices.slices_per_slab) - 1].map(|n| self.depth_mm(slab.first + n))
    }

    /// Depth of a slice, mm.
    #[inline(always)]
    fn depth_mm(&self, slice: i64) -> f32 {
        (slice as f32 + 0.5) * self.sampler.scene.frame.spacing.step_mm
    }

    /// Draws the polygons of a slab; returns whether any pixel of the tile is not opaque yet.
    #[inline(always)]
    fn draw_slab<S: Simd>(
        &self,
        simd: S,
        tile: &mut Tile<S>,
        slab: &Slab,
        stats: &mut RenderStats,
        fetch_policy: &mut FetchPolicy,
    ) -> bool {
        let scene = self.sampler.scene;
        let settings = &scene.settings;
        let front_to_back = scene.slice_order() == SliceOrder::FrontToBack;
        let ends = scene.ends_early() && self.sampler.composite;
        for polygon in slab.polygons.clone() {
            let outline = &self.outlines[polygon as usize];
            let [low, _, high, _] = tile.corners;
            if outline.high.cmplt(low).any() || outline.low.cmpgt(high).any() {
                continue;
            }
            // Edges that the tile crosses, or lies beyond.
            let crossing = outline
                .edges
                .iter()
                .filter(|e| !tile.corners.iter().all(|c| e.contains(*c)));
            let crossing: Vec<Edge> = crossing.copied().collect();
            let is_empty = scene
                .volume()
                .macrocells
                .is_empty_block(&tile.bounds(&self.depths(slab)));
            for pixels in &mut tile.packets {
                let mut covered = pixels.until.simd_ge(0.0);
                for edge in &crossing {
                    covered &= edge.contains_lanes(pixels.place.x, pixels.place.y);
                }
                if is_empty && !self.has_surfaces {
                    stats.samples_skipped +=
                        u64::from(covered.to_bitmask().count_ones()) * u64::from(self.slices.slices_per_slab);
                    continue;
                }
                if ends {
                    let opaque = pixels.alpha.simd_gt(1.0 - MIN_TRANSMITTANCE);
                    stats.samples_terminated += u64::from((covered & opaque).to_bitmask().count_ones());
                    covered &= !opaque;
                }
                if covered.any_true() {
                    let shows_volume = self.has_volume && !is_empty;
                    let layer = self.fragment(
                        simd,
                        pixels,
                        (covered, shows_volume),
                        slab.first,
                        stats,
                        fetch_policy,
                    );
                    blend(simd, pixels, &layer, settings.blend_format, front_to_back);
                }
            }
        }
        !ends || tile.packets.iter().any(PixelPacket::is_open)
    }

    /// Samples a slice at eight pixels: thin layers in front of the slice, and its samples; none if
    /// neither has anything to shade. Values of projections are added at once.
    #[inline(always)]
    fn fragment_sample<S: Simd>(
        &self,
        simd: S,
        pixels: &mut PixelPacket<S>,
        covered: mask32x8<S>,
        depth_mm: f32,
        stats: &mut RenderStats,
        fetch_policy: &mut FetchPolicy,
    ) -> Option<[FoundSamples<S>; 2]> {
        let scene = self.sampler.scene;
        let rays = pixels.rays;
        let lanes = covered & pixels.until.simd_gt(depth_mm);
        let mut p = pixels.origin + pixels.across * f32x8::splat(simd, depth_mm);
        if scene.settings.jitter {
            p = p + rays.direction * pixels.shift;
        }
        let (empty, cut_free) = scene.volume().macrocells.states_lanes(simd, p);
        stats.samples_skipped += u64::from((lanes & empty).to_bitmask().count_ones());
        let lanes = lanes & !empty;
        if lanes.all_false() {
            return None;
        }
        stats.samples_taken += u64::from(lanes.to_bitmask().count_ones());
        let none = lanes & !lanes;
        let (mut removed, mut near_cut) = (none, none);
        if !scene.cuts.is_empty() {
            (removed, near_cut) = self.cut_by_shapes(lanes, p);
        }
        let left = lanes & !removed;
        let with_gradients = self.sampler.sampler.has_gradients() && fetch_policy.fetches_gradients();
        let mut sample = if left.any_true() {
            fetch_policy.lookups += 1;
            self.sampler.sample_points(simd, p, left, with_gradients)
        } else {
            SamplePacket::absent(simd, p, with_gradients)
        };
        sample.alpha = removed.select(f32x8::splat(simd, 0.0), sample.alpha);
        sample.cut_free = cut_free;
        if !self.sampler.composite {
            pixels.projection.insert(sample.value, sample.present);
            return None;
        }
        let hidden = !pixels.until.simd_gt(depth_mm + scene.frame.spacing.step_mm);
        self.with_neighbours(simd, (lanes, hidden), &rays, sample, p, near_cut)
    }

    /// The samples that have something to shade, with the points one step in front of them and
    /// behind them, since no sample of another slice is known here; and thin layers in front of
    /// them.
    #[inline(always)]
    fn with_neighbours<S: Simd>(
        &self,
        simd: S,
        (lanes, hidden): (mask32x8<S>, mask32x8<S>),
        rays: &ShadingRays<S>,
        mut sample: SamplePacket<S>,
        p: Vec3x8<S>,
        near_cut: mask32x8<S>,
    ) -> Option<[FoundSamples<S>; 2]> {
        let in_front = p - rays.direction * rays.step;
        let own_depth = sample.depth;
        let (mut previous, mut previous_alpha) = (Neighbours::invisible(simd), sample.alpha);
        if self.sampler.preintegrated.is_some() {
            (previous, previous_alpha) = self.sampler.neighbours(simd, in_front, lanes, near_cut);
            self.sampler
                .look_up_segments(simd, &mut sample, lanes, near_cut, &mut previous, in_front);
        }
        let hit = self.sampler.to_be_shaded(&sample, lanes, near_cut);
        let near_edge = lanes & self.sampler.near_edge(&sample, near_cut);
        let wanted = hit | near_edge;
        if wanted.all_false() {
            return None;
        }
        if self.sampler.preintegrated.is_none() {
            (previous, previous_alpha) = self.sampler.neighbours(simd, in_front, wanted, near_cut);
        }
        let mut new = NewSamples {
            sample: &sample,
            deformed: p,
            near_cut,
            previous,
            next: Neighbours::invisible(simd),
        };
        let mut layers = FoundSamples::nothing(simd, p, rays.step, sample.with_gradients);
        let layered = near_edge
            & self
                .sampler
                .may_hide_a_layer(&sample, own_depth, &previous, previous_alpha);
        layers.insert_layers(layered, &new);
        let mut found = FoundSamples::nothing(simd, p, rays.step, sample.with_gradients);
        let followed = hit & !hidden & self.sampler.sees_behind(&sample, rays.step);
        if followed.any_true() {
            let behind = p + rays.direction * rays.step;
            new.next = self.sampler.neighbours(simd, behind, followed, near_cut).0;
        }
        found.insert(hit, &new);
        found.hidden = hit & !followed;
        Some([layers, found])
    }

    /// The fragments of a slab: its slices composited front to back; of the pixels that it covers,
    /// and without the volume where that is known to be empty.
    #[inline(always)]
    fn fragment<S: Simd>(
        &self,
        simd: S,
        pixels: &mut PixelPacket<S>,
        (covered, shows_volume): (mask32x8<S>, bool),
        first: i64,
        stats: &mut RenderStats,
        fetch_policy: &mut FetchPolicy,
    ) -> SlabFragments<S> {
        let mut layer = SlabFragments {
            color: Vec3x8::splat(simd, Vec3::ZERO),
            transmittance: f32x8::splat(simd, 1.0),
            any: covered & !covered,
        };
        for slice in 0..i64::from(self.slices.slices_per_slab) {
            let covered = if self.sampler.scene.ends_early() {
                covered & layer.transmittance.simd_ge(MIN_TRANSMITTANCE)
            } else {
                covered
            };
            let depth_mm = self.depth_mm(first + slice);
            if self.has_surfaces {
                self.add_surfaces(pixels, covered, depth_mm, &mut layer, stats);
            }
            if !shows_volume {
                continue;
            }
            let Some(found) = self.fragment_sample(simd, pixels, covered, depth_mm, stats, fetch_policy)
            else {
                continue;
            };
            for mut found in found {
                if found.lanes.any_true() {
                    self.add_found(simd, pixels, &mut found, &mut layer, fetch_policy);
                }
            }
        }
        layer
    }

    /// Adds the samples found at a slice behind those of the slices in front of it.
    #[inline(always)]
    fn add_found<S: Simd>(
        &self,
        simd: S,
        pixels: &PixelPacket<S>,
        found: &mut FoundSamples<S>,
        layer: &mut SlabFragments<S>,
        fetch_policy: &mut FetchPolicy,
    ) {
        let shaded = self.sampler.shade_found(simd, &pixels.rays, found, fetch_policy);
        let pass = shaded.transmittance(simd, pixels.length);
        let (visible, one) = (shaded.visible, f32x8::splat(simd, 1.0));
        let weight = visible.select(layer.transmittance * (one - pass), f32x8::splat(simd, 0.0));
        layer.color = layer.color + Vec3x8::select(visible, shaded.color, layer.color) * weight;
        layer.transmittance = visible.select(layer.transmittance * pass, layer.transmittance);
        layer.any |= visible;
    }

    /// Adds what a slice shows of surfaces: opaque, and in front of its sample of the volume.
    #[inline(never)]
    fn add_surfaces<S: Simd>(
        &self,
        pixels: &PixelPacket<S>,
        covered: mask32x8<S>,
        depth_mm: f32,
        layer: &mut SlabFragments<S>,
        stats: &mut RenderStats,
    ) {
        let scene = self.sampler.scene;
        // A hit lies between this slice and the one in front of it.
        let lanes = covered & pixels.until.simd_gt(depth_mm - scene.frame.spacing.step_mm);
        for n in lanes_of(lanes.to_bitmask()) {
            let step = pixels.rays.step[n];
            let per_mm = step / scene.frame.spacing.step_mm;
            let t = depth_mm * per_mm + pixels.shift[n];
            let (origin, direction) = (pixels.origin.lane(n), pixels.rays.direction.lane(n));
            let hit = surface_shading::nearest_in_slice(
                scene,
                origin,
                direction,
                t,
                step,
                &mut stats.samples_taken,
            );
            let until = pixels.until[n] * per_mm + pixels.shift[n];
            let Some(hit) = hit.filter(|hit| hit.t < until) else {
                continue;
            };
            layer
                .color
                .set(n, layer.color.lane(n) + hit.color * layer.transmittance[n]);
            layer.transmittance[n] = 0.0;
            layer.any.set(n, true);
        }
    }

    /// Which of eight samples the cut shapes remove, and which are near a shape.
    #[inline(always)]
    fn cut_by_shapes<S: Simd>(&self, lanes: mask32x8<S>, p: Vec3x8<S>) -> (mask32x8<S>, mask32x8<S>) {
        let mut removed = lanes & !lanes;
        let mut near_cut = removed;
        for n in lanes_of(lanes.to_bitmask()) {
            let distance_mm = self.sampler.scene.cuts.signed_distance_mm(p.lane(n));
            removed.set(n, distance_mm < 0.0);
            near_cut.set(n, distance_mm.abs() <= self.sampler.margin_mm);
        }
        (removed, near_cut)
    }
}

/// Blends a layer over the pixels, or under them (front to back).
#[inline(always)]
fn blend<S: Simd>(
    simd: S,
    pixels: &mut PixelPacket<S>,
    layer: &SlabFragments<S>,
    format: BlendFormat,
    front_to_back: bool,
) {
    if layer.any.all_false() {
        return;
    }
    let one = f32x8::splat(simd, 1.0);
    let alpha = one - layer.transmittance;
    let (color, total) = if front_to_back {
        let through = one - pixels.alpha;
        (
            pixels.color + layer.color * through,
            pixels.alpha + alpha * through,
        )
    } else {
        (
            layer.color + pixels.color * layer.transmittance,
            alpha + pixels.alpha * layer.transmittance,
        )
    };
    let (color, total) = match format {
        BlendFormat::Float32 => (color, total),
        BlendFormat::Float16 => (
            Vec3x8 {
                x: rounded(simd, color.x),
                y: rounded(simd, color.y),
                z: rounded(simd, color.z),
            },
            rounded(simd, total),
        ),
    };
    pixels.color = Vec3x8::select(layer.any, color, pixels.color);
    pixels.alpha = layer.any.select(total, pixels.alpha);
}

/// Rounded to 16 bits.
#[inline(always)]
fn rounded<S: Simd>(simd: S, v: f32x8<S>) -> f32x8<S> {
    let (mut halves, mut back) = ([f16::ZERO; LANES], [0.0f32; LANES]);
    halves.convert_from_f32_slice(v.as_slice());
    halves.convert_to_f32_slice(&mut back);
    f32x8::load_array(simd, back)
}
