//! The CPU renderer: the truth for tests, and the backend wherever there is no GPU.
//!
//! *Theory*: both modes are one march along each pixel's ray. Ray casting puts samples at t = (i + 1/2) Δ from the eye; a
//! view-aligned slice lies at depth (i + 1/2) Δ, so a ray meets it at t = (i + 1/2) Δ / cos θ, θ being the angle to the view direction. On a
//! CPU slices are therefore rays with the step Δ / cos θ, and need no polygons; compositing front to back instead of back to front gives
//! the same colour and can stop early. Samples are anchored at the eye, not at the box, so that a different box (a map more or less,
//! skipping on or off) samples the same points.
//!
//! Per sample, cheapest question first: macrocell, mask and source point, value, opacity; only what is visible pays for a gradient,
//! a Jacobian and light ([`shading`]). Pixels are independent and rows are the unit of work, so the number of threads changes nothing.
//!
//! `shaders/raycast.wgsl` and `shaders/lib` say the same in the same words.

pub mod pick;
pub mod section;
pub mod shading;
pub mod surface;

use crate::deform::cut::Kept;
use crate::scene::{Mode, Picture, Prepared, RenderStats, Rendered, Stages};
use crate::transfer::Blend;
use crate::volume::{GridVoxels, Sampler, Voxel};
use crate::{Result, Watch};
use glam::Vec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A ray whose remaining transmittance is below this is finished: less than half an 8-bit step can follow.
const OPAQUE: f32 = 1.0 / 512.0;

/// Renders a prepared scene. `progress` is told the share that is done, from several threads.
pub fn render(scene: &Prepared, progress: &(dyn Fn(f32) + Sync)) -> Rendered {
    render_rows(scene, &Watch::telling(progress))
}

/// As [`render`], until it is told to stop, which it does within a row.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn render_until(scene: &Prepared, watch: &Watch) -> Result<Rendered> {
    let rendered = render_rows(scene, watch);
    watch.check()?;
    Ok(rendered)
}

/// Rows after a stop stay empty.
fn render_rows(scene: &Prepared, watch: &Watch) -> Rendered {
    let mut stages = Stages::default();
    let (picture, stats) = stages.time("render", || match &scene.grid.voxels {
        GridVoxels::U8(v) => rows(scene, &Sampler::new(scene.grid, v), watch),
        GridVoxels::U16(v) => rows(scene, &Sampler::new(scene.grid, v), watch),
        GridVoxels::I16(v) => rows(scene, &Sampler::new(scene.grid, v), watch),
        GridVoxels::F32(v) => rows(scene, &Sampler::new(scene.grid, v), watch),
    });
    Rendered { picture: picture.reduced(scene.settings.antialias), stats: Some(stats), stages, notices: Vec::new() }
}

fn rows<T: Voxel>(scene: &Prepared, sampler: &Sampler<T>, watch: &Watch) -> (Picture, RenderStats) {
    let [width, height] = scene.frame.size;
    let mut pixels = vec![[0.0f32; 4]; width as usize * height as usize];
    let done = AtomicUsize::new(0);
    let stats = pixels
        .par_chunks_mut(width as usize)
        .enumerate()
        .map(|(y, row)| {
            let mut stats = RenderStats::default();
            if watch.stopped() {
                return stats;
            }
            for (x, pixel) in row.iter_mut().enumerate() {
                let u = (x as f32 + 0.5) / width as f32 * 2.0 - 1.0;
                let v = 1.0 - (y as f32 + 0.5) / height as f32 * 2.0;
                let (origin, direction) = scene.frame.view.ray(u, v);
                let behind = surface::nearest(scene, origin, direction, &mut stats.samples_taken);
                let until = behind.map_or(f32::INFINITY, |hit| hit.t);
                *pixel = march(scene, sampler, origin, direction, until, &mut stats);
                if let Some(hit) = behind {
                    let [r, g, b, a] = *pixel;
                    *pixel = (Vec3::new(r, g, b) + hit.color * (1.0 - a)).extend(1.0).to_array();
                }
            }
            (watch.progress)((done.fetch_add(1, Ordering::Relaxed) + 1) as f32 / height as f32);
            stats
        })
        .reduce(RenderStats::default, |a, b| RenderStats {
            samples_taken: a.samples_taken + b.samples_taken,
            samples_skipped: a.samples_skipped + b.samples_skipped,
            samples_terminated: a.samples_terminated + b.samples_terminated,
        });
    (Picture { width, height, pixels }, stats)
}

/// What is at a point of the deformed scene.
#[derive(Clone, Copy)]
struct Look {
    /// Where it came from, voxels.
    in_voxel: Vec3,
    /// Normalised value; only meaningful where matter is present.
    value: f32,
    /// Neither cut away, nor outside the volume, nor in a hole.
    present: bool,
    /// Smallest mask on the way: strictly between 0 and 1 near a cut.
    alpha: f32,
}

/// Looks at a point of the deformed scene.
#[inline(always)]
fn look<T: Voxel>(scene: &Prepared, sampler: &Sampler<T>, deformed: Vec3) -> Look {
    if scene.cuts.kept(deformed) < 0.0 {
        return Look { in_voxel: Vec3::ZERO, value: 0.0, present: false, alpha: 0.0 };
    }
    let (source, alpha) = scene.stack.walk(deformed);
    let in_voxel = scene.frame.voxel_from_world.transform_point3(source);
    if alpha < 0.5 || in_voxel.cmplt(Vec3::splat(-0.5)).any() || in_voxel.cmpgt(scene.frame.grid_size - 0.5).any() {
        return Look { in_voxel, value: 0.0, present: false, alpha };
    }
    let value = sampler.sample(in_voxel);
    Look { in_voxel, value, present: !scene.grid.has_holes || value >= -1e-4, alpha }
}

/// Index of the first sample at or after `t`.
fn first_sample_after(t: f32, step: f32) -> i32 {
    (t / step - 0.5).ceil().max(0.0) as i32
}

/// The volume along one ray as far as `until`: premultiplied colour.
fn march<T: Voxel>(scene: &Prepared, sampler: &Sampler<T>, origin: Vec3, direction: Vec3, until: f32, stats: &mut RenderStats) -> [f32; 4] {
    let frame = &scene.frame;
    let Some((near, far)) = frame.proxy.intersect_ray(origin, direction) else { return [0.0; 4] };
    let step = match scene.settings.mode {
        Mode::Raycast | Mode::Surface => frame.step_mm,
        Mode::Slice => frame.step_mm / direction.dot(frame.view.forward),
    };
    let (mut i, end) = (first_sample_after(near, step), first_sample_after(far.min(until), step));
    let length = step / frame.reference_mm;
    let inverse_direction = direction.recip();
    let mut projection = Projection::new(scene.blend);
    let mut color = Vec3::ZERO;
    let mut transmittance = 1.0f32;
    while i < end {
        let deformed = origin + direction * ((i as f32 + 0.5) * step);
        if let Some(t) = scene.macrocells.empty_until(deformed, origin, inverse_direction) {
            let next = first_sample_after(t, step).max(i + 1).min(end);
            stats.samples_skipped += (next - i) as u64;
            i = next;
            continue;
        }
        let kept = if scene.cuts.is_empty() {
            Kept { at: (i as f32 + 0.5) * step, share: 1.0 }
        } else {
            scene.cuts.kept_part(origin, direction, (i as f32 + 0.5) * step, step)
        };
        i += 1;
        stats.samples_taken += 1;
        if kept.share <= 0.0 {
            continue;
        }
        let deformed = origin + direction * kept.at;
        let at = look(scene, sampler, deformed);
        if scene.blend != Blend::Composite {
            if at.present {
                projection.insert(at.value);
            }
            continue;
        }
        if at.present
            && scene.grey_faces()
            && let Some(grey) = shading::grey_face(scene, sampler, &at, deformed, direction, step)
        {
            color += Vec3::splat(grey * transmittance);
            transmittance = 0.0;
            stats.samples_terminated += (end - i).max(0) as u64;
            break;
        }
        if let Some(iso) = scene.iso {
            if at.present && at.value >= iso {
                color = shading::iso_surface(scene, sampler, iso, deformed, direction, step) * transmittance + color;
                transmittance = 0.0;
                stats.samples_terminated += (end - i).max(0) as u64;
                break;
            }
            continue;
        }
        let (depth, shaded) = match shading::visible(scene, &at, deformed) {
            Some(sample) => (sample.depth, shading::shade(scene, sampler, &sample, direction, step)),
            None if at.alpha > 0.0 && at.alpha < 1.0 => match shading::sliver(scene, sampler, deformed, at.present, direction, step) {
                Some((depth, shaded)) => (depth, shaded),
                None => continue,
            },
            None => continue,
        };
        let pass = (-depth * shaded.depth_factor * kept.share * length).exp2();
        color += shaded.color * (transmittance * (1.0 - pass));
        transmittance *= pass;
        if transmittance < OPAQUE && scene.settings.early_termination {
            stats.samples_terminated += (end - i).max(0) as u64;
            break;
        }
    }
    if scene.blend == Blend::Composite {
        return color.extend(1.0 - transmittance).to_array();
    }
    projection.color(scene)
}

/// The samples of a projection along one ray.
struct Projection {
    blend: Blend,
    value: f32,
    count: u32,
}

impl Projection {
    fn new(blend: Blend) -> Self {
        let value = match blend {
            Blend::Minip => f32::INFINITY,
            Blend::Mip => f32::NEG_INFINITY,
            _ => 0.0,
        };
        Self { blend, value, count: 0 }
    }

    fn insert(&mut self, value: f32) {
        self.count += 1;
        self.value = match self.blend {
            Blend::Mip => self.value.max(value),
            Blend::Minip => self.value.min(value),
            _ => self.value + value,
        };
    }

    /// The projected value through the transfer function, premultiplied; nothing where the ray met nothing.
    fn color(&self, scene: &Prepared) -> [f32; 4] {
        if self.count == 0 {
            return [0.0; 4];
        }
        let value = if self.blend == Blend::Average { self.value / self.count as f32 } else { self.value };
        let [r, g, b, depth] = scene.table.lookup(value);
        let alpha = 1.0 - (-depth).exp2();
        [r * alpha, g * alpha, b * alpha, alpha]
    }
}
