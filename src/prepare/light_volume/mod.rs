//! The light volume: how much of the key light and of the sky reaches each point of the deformed
//! scene ([`crate::model`], "Light").
//!
//! *Theory*: volumes, surfaces and triangles are sampled into one grid of optical depths over the
//! deformed scene, after its maps and cuts: a flap casts its shadow where it is now. From each node
//! the mean transmittance is found towards the light's disc (the shadow S) and, within a short
//! reach, over the whole sphere (the occlusion `V_raw`; local occlusion, Hernell, Ljung and
//! Ynnerman 2010). A flat surface hides half of the sphere, which must not darken it:
//! V = min(1, (1 + c) `V_raw`) with the surface confidence c of a sample.
//!
//! Depths are interpolated, hence a surface reaches up to a cell beyond itself. The light on it is
//! read [`OFFSET_CELLS`] in front of it, and the nodes next to it take the light from farther out
//! ([`padding`]).
//!
//! *How to call it*: [`LightVolumeCache::of`]; each part is kept until its inputs change. Depths
//! depend on the scene, the occlusion on them and its reach, the shadow on them and the light's
//! direction.

mod casters;
mod depth;
mod directions;
mod padding;
mod sweep;

pub use casters::{Casters, SurfaceCaster, VolumeCaster};

use super::Macrocells;
use super::object_cache::Triangles;
use super::surface_cells::SurfaceCells;
use crate::math::Bounds;
use crate::math::cells::{Cells, mix_texels};
use crate::math::lanes::*;
use crate::picture::StageTimes;
use crate::scene::{Light, LightQuality};
use glam::Vec3;
use rayon::prelude::*;
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use sweep::{DepthGrid, Reach};

/// How far in front of a surface its light is read, cells.
const OFFSET_CELLS: f32 = 1.5;
/// Axes of the directions over which occlusion is averaged: two directions each.
const OCCLUSION_AXES: usize = 64;
/// These axes.
static AXES: LazyLock<Vec<Vec3>> = LazyLock::new(|| directions::axes(OCCLUSION_AXES));
/// Directions over which the disc of a light is averaged.
const DISC_DIRECTIONS: usize = 16;
/// Rays of a reference: as many as its directions.
const REFERENCE_RAYS: usize = 256;
/// The reach of the occlusion where the scene does not state it: a share of the longest edge.
const OCCLUSION_SHARE: f32 = 0.15;
/// Cells along the longest edge of what is visible, in a picture and in a draft.
const CELLS: [f32; 2] = [128.0, 64.0];
/// What a texel stores for all light.
const FULL: f32 = 32767.0;
/// Number of grids that stay cached: a picture's and its draft's, for two views.
const MAX_CACHED: usize = 4;

/// The share of the light that reaches each point.
pub struct LightVolume {
    /// Nodes along each axis.
    pub size: [usize; 3],
    /// The first node, mm.
    pub origin: Vec3,
    /// Distance between nodes, mm.
    pub cell_mm: f32,
    /// S and `V_raw`, as shares of 32767; x fastest.
    texels: Vec<[i16; 4]>,
    /// Rays that measure the same at a point, if the light is of that quality.
    pub rays: Option<ReferenceRays>,
}

/// The rays of a reference: many at each point.
pub struct ReferenceRays {
    /// Towards the light's disc; none without shadows.
    pub toward_light: Vec<Vec3>,
    /// Over the whole sphere; none without occlusion.
    pub around: Vec<Vec3>,
    /// How far those over the sphere reach, mm.
    pub reach_mm: f32,
}

impl LightVolume {
    /// How far in front of a surface its light is read, mm.
    pub fn offset_mm(&self) -> f32 {
        OFFSET_CELLS * self.cell_mm
    }

    /// The box that texels at the nodes fill, mm.
    pub fn texture_box(&self) -> Bounds {
        let size = Vec3::from(self.size.map(|n| n as f32)) * self.cell_mm;
        let min = self.origin - 0.5 * self.cell_mm;
        Bounds::new(min, min + size)
    }

    /// S and `V_raw` at eight points.
    #[inline(always)]
    pub fn sample_lanes<S: Simd>(&self, simd: S, p: Vec3x8<S>) -> [f32x8<S>; 2] {
        let in_cells = (p - Vec3x8::splat(simd, self.origin)) * f32x8::splat(simd, self.cell_mm.recip());
        let [shadow, open, _, _] =
            mix_texels(simd, &self.texels, self.size, &Cells::of(in_cells, self.size, 0));
        [shadow * FULL.recip(), open * FULL.recip()]
    }

    /// S and `V_raw` at a point.
    pub fn sample(&self, p: Vec3) -> [f32; 2] {
        let [shadow, open] = with_simd(OnePoint { volume: self, p });
        [shadow, open]
    }

    /// S and `V_raw` at all nodes, as fractions.
    pub fn nodes(&self) -> impl Iterator<Item = [f32; 2]> + '_ {
        self.texels
            .iter()
            .map(|t| [f32::from(t[0]) / FULL, f32::from(t[1]) / FULL])
    }
}

/// One point among the lanes.
struct OnePoint<'a> {
    volume: &'a LightVolume,
    p: Vec3,
}

impl SimdKernel for OnePoint<'_> {
    type Output = [f32; 2];

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> [f32; 2] {
        let [shadow, open] = self.volume.sample_lanes(simd, Vec3x8::splat(simd, self.p));
        [shadow[0], open[0]]
    }
}

/// The part of a scene that casts shadows: equal keys have equal depths.
#[derive(Clone)]
struct DepthKey {
    /// Known by the address of what was derived from the same inputs, which this keeps alive.
    macrocells: Option<Arc<Macrocells>>,
    surfaces: Vec<(Arc<SurfaceCells>, Option<Arc<Triangles>>)>,
    bounds: Bounds,
    cells: f32,
    gradient: Vec<f32>,
}

impl PartialEq for DepthKey {
    fn eq(&self, other: &Self) -> bool {
        fn same<T>(a: Option<&Arc<T>>, b: Option<&Arc<T>>) -> bool {
            a.map(Arc::as_ptr) == b.map(Arc::as_ptr)
        }
        let mut surfaces = self.surfaces.iter().zip(&other.surfaces);
        same(self.macrocells.as_ref(), other.macrocells.as_ref())
            && self.surfaces.len() == other.surfaces.len()
            && surfaces.all(|(a, b)| Arc::ptr_eq(&a.0, &b.0) && same(a.1.as_ref(), b.1.as_ref()))
            && (self.bounds, self.cells) == (other.bounds, other.cells)
            && self.gradient == other.gradient
    }
}

/// What has been computed of a scene.
#[derive(Clone)]
struct Entry {
    key: DepthKey,
    depths: Arc<DepthGrid>,
    /// Mean transmittances, and the directions and reach that they are of.
    shadow: Option<(Vec<Vec3>, Arc<Vec<f32>>)>,
    occlusion: Option<(f32, Arc<Vec<f32>>)>,
    combined: Option<(LightQuality, Arc<LightVolume>)>,
}

/// Light volumes, the most recently used last.
#[derive(Default)]
pub struct LightVolumeCache(Mutex<Vec<Entry>>);

impl LightVolumeCache {
    /// The light volume of what casts shadows under a light, if that is asked for and there is
    /// anything.
    pub(super) fn of(
        &self,
        casters: &Casters,
        light: &Light,
        to_light: Vec3,
        is_draft: bool,
        stages: &mut StageTimes,
    ) -> Option<Arc<LightVolume>> {
        let bounds = casters.bounds();
        if !(light.shadow || light.occlusion) || bounds.is_empty() {
            return None;
        }
        let cells = CELLS[usize::from(is_draft)];
        let of_surface = |surface: &SurfaceCaster| (surface.cells.clone(), surface.triangles.cloned());
        let volume = casters.volume.as_ref();
        let key = DepthKey {
            macrocells: volume.map(|v| v.macrocells.clone()),
            surfaces: casters.surfaces.iter().map(of_surface).collect(),
            bounds,
            cells,
            gradient: volume.map_or(Vec::new(), |v| v.table.gradient.clone()),
        };
        // Entries are only replaced as a whole.
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let found = {
            let mut entries = lock();
            let at = entries.iter().position(|e| e.key == key);
            at.map(|at| entries.remove(at))
        };
        let mut entry = found.unwrap_or_else(|| Entry {
            depths: Arc::new(stages.time("light depths", || depth::sampled(casters, &bounds, cells))),
            key,
            shadow: None,
            occlusion: None,
            combined: None,
        });
        let volume = entry.light_volume(light, to_light, bounds.size().max_element(), stages);
        let mut entries = lock();
        if entries.len() == MAX_CACHED {
            entries.remove(0);
        }
        entries.push(entry);
        Some(volume)
    }
}

impl Entry {
    /// The light volume under a light; `longest_mm` is the longest edge of what casts shadows.
    fn light_volume(
        &mut self,
        light: &Light,
        to_light: Vec3,
        longest_mm: f32,
        stages: &mut StageTimes,
    ) -> Arc<LightVolume> {
        let depths = self.depths.clone();
        let directions = if light.shadow {
            directions::toward_disc(to_light, light.radius, DISC_DIRECTIONS)
        } else {
            Vec::new()
        };
        let reach_mm = if light.occlusion {
            light.occlusion_mm.unwrap_or(OCCLUSION_SHARE * longest_mm)
        } else {
            0.0
        };
        if self.shadow.as_ref().is_none_or(|(of, _)| *of != directions) {
            let all = if directions.is_empty() {
                Vec::new()
            } else {
                stages.time("shadows", || {
                    depths.mean_transmittance(&directions, Reach::Infinite)
                })
            };
            self.shadow = Some((directions, Arc::new(all)));
            self.combined = None;
        }
        if self.occlusion.as_ref().is_none_or(|(of, _)| *of != reach_mm) {
            let all = if reach_mm > 0.0 {
                let reach = Reach::BothWays(reach_mm / depths.cell_mm);
                stages.time("occlusion", || depths.mean_transmittance(&AXES, reach))
            } else {
                Vec::new()
            };
            self.occlusion = Some((reach_mm, Arc::new(all)));
            self.combined = None;
        }
        let [shadow, open] = [
            &self.shadow.as_ref().map(|s| &s.1),
            &self.occlusion.as_ref().map(|o| &o.1),
        ]
        .map(|all| all.map_or(&[][..], |all| &all[..]));
        let combine = || {
            let stored = |all: &[f32], n: usize| all.get(n).map_or(FULL, |v| (v * FULL).round()) as i16;
            let texels: Vec<[i16; 4]> = (0..depths.depth.len())
                .into_par_iter()
                .map(|n| [stored(shadow, n), stored(open, n), 0, 0])
                .collect();
            let rays = (light.quality == LightQuality::Reference).then(|| {
                let toward_light = if light.shadow {
                    directions::toward_disc(to_light, light.radius, REFERENCE_RAYS)
                } else {
                    Vec::new()
                };
                let around = if light.occlusion {
                    directions::axes(REFERENCE_RAYS / 2)
                } else {
                    Vec::new()
                };
                ReferenceRays {
                    toward_light,
                    around: around.iter().flat_map(|&d| [d, -d]).collect(),
                    reach_mm,
                }
            });
            Arc::new(LightVolume {
                rays,
                size: depths.size,
                origin: depths.origin,
                cell_mm: depths.cell_mm,
                texels: padding::padded(&depths, &texels),
            })
        };
        let combined = match self.combined.take() {
            Some((quality, combined)) if quality == light.quality => combined,
            _ => stages.time("light", combine),
        };
        self.combined = Some((light.quality, combined.clone()));
        combined
    }
}
