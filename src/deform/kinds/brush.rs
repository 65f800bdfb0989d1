//! Brush: an editor's strokes (`deform::stroke`). Lines push, smooth, cut and restore the volume;
//! outlines cut out, or restore, what lies behind and in front of them.
//!
//! The strokes act one after the other on D and on C, the signed distance to the cuts, at the grid
//! points of the map. A push is a chain of small steps. With s(p) = strength · w(|p - b| / radius)
//! · (b - a), the step from a to b makes
//!
//! ```text
//!   D'(p) = D(p - s(p)) - s(p)        C'(p) = C(p - s(p))
//! ```
//!
//! so that cuts move with the material. With w(t) = (1 - t²)² and steps of a quarter of the radius,
//! |∇w · (b - a)| stays below 1: every step, and hence the whole, is invertible. (Brushes of image
//! editors do the same in a plane, with one step per dab; a long one folds.)
//!
//! Restoring over the same cut leaves C = 0 on the cut's surface, and pushing stretches C. Both are
//! converted back to distances at the end (`math::redistance`); otherwise shading would treat them
//! as cuts.
//!
//! `progress` weakens the pushes, so that every intermediate state is invertible as well. It
//! narrows the cuts; restoring strokes always act in full.

use super::outline::Outline;
use super::{
    Backward, DefaultSize, Field, FieldBuilder, FieldContext, FieldInputs, GapResolution, Kind, NO_CUT_DISTANCE_MM, Setting, SettingFormat,
    forward_numerically, lasso,
};
use crate::deform::{Argument, Arguments};
use crate::math::{Bounds, redistance, smoothstep, trilinear};
use crate::{Error, Result};
use glam::{Affine3A, Vec2, Vec3, Vec3Swizzles, Vec4};
use rayon::prelude::*;
use std::ops::Range;

pub use crate::deform::stroke::{Lasso, Stroke, StrokeTool, parse};

const MAX_STROKES: usize = 4096;
const MAX_POINTS: usize = 200_000;
/// Longest step of a push, as a fraction of the brush's radius.
const STEP: f32 = 0.25;
/// Number of grid points that justify a thread.
const WORTH_A_THREAD: usize = 8192;
/// Maximum number of points of a silhouette along an axis.
const MAX_OUTLINE_POINTS: usize = 512;

pub(super) const KIND: Kind = Kind {
    name: "brush",
    about: "painted with brush strokes (push, smooth, cut, restore) and lasso outlines",
    parameters: &[],
    // Room for outward pushes.
    size: DefaultSize::Share([1.2; 3]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 64,
    nonzero_faces: [false; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Sourced {
        settings: &[Setting {
            name: "strokes",
            form: SettingFormat::Words,
            about: "one text each: push, smooth, cut or restore with RADIUS STRENGTH x y z ..., lasso-cut or lasso-restore with EYE, a point, \
                    right, up and x y ...; mm",
        }],
        example,
        build,
    },
};

/// Draws out and smooths a bump, and cuts a groove next to it.
fn example(bounds: &Bounds) -> Vec<(&'static str, Argument)> {
    let (center, size) = (bounds.center(), bounds.size());
    let thickness = size.min_element();
    let line = |tool: StrokeTool, radius: f32, strength: f32, points: &[[f32; 3]]| {
        let points = points.iter().map(|p| center + size * Vec3::from_array(*p)).collect();
        Stroke::Line { tool, radius_mm: radius * thickness, strength, points }.to_string()
    };
    let strokes = vec![
        line(StrokeTool::Push, 0.22, 1.0, &[[0.0, -0.16, 0.12], [0.02, -0.24, 0.18], [0.06, -0.3, 0.24]]),
        line(StrokeTool::Cut, 0.08, 1.0, &[[0.22, -0.28, -0.1], [0.3, -0.2, 0.08], [0.26, -0.1, 0.24]]),
        line(StrokeTool::Smooth, 0.24, 0.5, &[[0.06, -0.3, 0.24]]),
    ];
    vec![("strokes", Argument::Texts(strokes))]
}

fn build(c: &FieldContext, inputs: &FieldInputs) -> Result<Box<dyn Field>> {
    let strokes = strokes(inputs.settings)?;
    if strokes.is_empty() || c.progress <= 0.0 {
        return Ok(Box::new(Brush { painting: None }));
    }
    let thin = |s: &&Stroke| matches!(s, Stroke::Line { radius_mm, .. } if *radius_mm < c.texel_mm);
    let too_thin = strokes.iter().filter(thin).count();
    if too_thin > 0 {
        inputs.library.notice(format!(
            "brush: {too_thin} of {} strokes have a radius below the map's {:.2} mm and may not show; give a higher resolution or a smaller box",
            strokes.len(),
            c.texel_mm
        ));
    }
    let mut painting = Painting::new(c, inputs.world_from_local);
    for stroke in &strokes {
        painting.apply(stroke, c.progress);
    }
    painting.renew();
    Ok(Box::new(Brush { painting: Some(painting) }))
}

fn strokes(settings: &Arguments) -> Result<Vec<Stroke>> {
    let texts = settings.texts("strokes")?.unwrap_or_default();
    if texts.len() > MAX_STROKES {
        return Err(Error::value("strokes", format!("are {}; at most {MAX_STROKES} can be given: divide them among several brushes", texts.len())));
    }
    let read = |(n, text): (usize, &String)| parse(text).map_err(|problem| Error::value("strokes", format!("stroke {}: {problem}", n + 1)));
    let strokes = texts.iter().enumerate().map(read).collect::<Result<Vec<_>>>()?;
    let points: usize = strokes.iter().map(Stroke::points).sum();
    if points > MAX_POINTS {
        return Err(Error::value("strokes", format!("have {points} points; at most {MAX_POINTS} can be given: divide them among several brushes")));
    }
    Ok(strokes)
}

/// The points of a grid over the box, including its faces, in the box's local millimetres.
#[derive(Clone, Copy)]
struct BrushGrid {
    size: [usize; 3],
    half: Vec3,
    spacing: Vec3,
}

impl BrushGrid {
    fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        (k * self.size[1] + j) * self.size[0] + i
    }

    fn position(&self, at: [usize; 3]) -> Vec3 {
        Vec3::from(at.map(|i| i as f32)) * self.spacing - self.half
    }

    /// Indices of the points within `reach` of the box spanned by two points.
    fn around(&self, a: Vec3, b: Vec3, reach: f32) -> [Range<usize>; 3] {
        let low = ((a.min(b) - reach + self.half) / self.spacing).ceil();
        let high = ((a.max(b) + reach + self.half) / self.spacing).floor() + 1.0;
        // The cast converts negative values to 0.
        std::array::from_fn(|x| (low[x] as usize).min(self.size[x])..(high[x] as usize).min(self.size[x]))
    }
}

/// D and C at the points of the grid after the strokes applied so far.
struct Painting {
    grid: BrushGrid,
    world_from_local: Affine3A,
    local_from_world: Affine3A,
    texel_mm: f32,
    gaps: GapResolution,
    /// Largest |C| that is stored: two texels beyond the mask's ramp, where the mask is constant.
    far: f32,
    /// (D, C), mm.
    texels: Vec<Vec4>,
    /// Whether any stroke has cut.
    has_cuts: bool,
    /// Whether C may no longer be a distance.
    worn: bool,
}

/// One position of a brush along its path, and the step that led to it.
#[derive(Clone, Copy)]
struct Dab {
    place: Vec3,
    step: Vec3,
}

impl Painting {
    fn new(c: &FieldContext, world_from_local: Affine3A) -> Self {
        let spacing = c.size_mm / Vec3::from(c.grid.map(|n| n.max(2) as f32 - 1.0));
        let far = c.ramp_mm + 2.0 * c.texel_mm;
        Self {
            grid: BrushGrid { size: c.grid, half: c.half(), spacing },
            world_from_local,
            local_from_world: world_from_local.inverse(),
            texel_mm: c.texel_mm,
            gaps: c.gaps(),
            far,
            texels: vec![Vec4::new(0.0, 0.0, 0.0, far); c.grid.iter().product()],
            has_cuts: false,
            worn: false,
        }
    }

    fn apply(&mut self, stroke: &Stroke, progress: f32) {
        match stroke {
            Stroke::Line { tool, radius_mm, strength, points } => {
                let line: Vec<Vec3> = points.iter().map(|p| self.local_from_world.transform_point3(*p)).collect();
                match tool {
                    StrokeTool::Push => self.push(&line, *radius_mm, strength * progress),
                    StrokeTool::Smooth => self.smooth(&line, *radius_mm, *strength),
                    StrokeTool::Cut => self.tube(&line, radius_mm * progress, false),
                    StrokeTool::Restore => self.tube(&line, *radius_mm, true),
                }
            }
            Stroke::Lasso(lasso) => self.lasso(lasso, progress),
        }
    }

    /// (D, C) at a point of the box.
    fn sample(&self, p: Vec3) -> Vec4 {
        trilinear(&self.texels, self.grid.size, (p + self.grid.half) / self.grid.spacing)
    }

    fn push(&mut self, line: &[Vec3], radius: f32, strength: f32) {
        if radius < 0.5 * self.texel_mm {
            return;
        }
        // Towards the box's faces the push fades, no more steeply than at the brush's rim where
        // there is room.
        let half = self.grid.half;
        let fade = (0.5 * half).min(Vec3::splat(radius));
        let longest = STEP * fade.min_element();
        for dab in dabs(&thinned(line, 0.5 * longest), longest, half + radius).filter(|d| d.step != Vec3::ZERO) {
            let way = dab.step * strength;
            self.repaint(dab.place, radius, |painting, _, p, weight| {
                let window: f32 = (0..3).map(|a| smoothstep(0.0, fade[a], half[a] - p[a].abs())).product();
                let s = way * (weight * window);
                let before = painting.sample(p - s);
                (before.truncate() - s).extend(before.w)
            });
        }
        self.worn |= self.has_cuts;
    }

    fn smooth(&mut self, line: &[Vec3], radius: f32, strength: f32) {
        if radius < 0.5 * self.texel_mm {
            return;
        }
        let longest = STEP * radius;
        for dab in dabs(&thinned(line, 0.5 * longest), longest, self.grid.half + radius) {
            self.repaint(dab.place, radius, |painting, at, _, weight| {
                let grid = &painting.grid;
                let own = painting.texels[grid.index(at)];
                if (0..3).any(|a| at[a] == 0 || at[a] + 1 == grid.size[a]) {
                    // D stays zero on the box's faces.
                    return own;
                }
                let mut sum = Vec3::ZERO;
                for n in 0..27 {
                    sum += painting.texels[grid.index([at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1])].truncate();
                }
                own.truncate().lerp(sum / 27.0, strength * weight).extend(own.w)
            });
        }
    }

    /// Updates the grid points around a position; each new value may depend on all the old ones.
    /// The weight falls from 1 at the position to 0 at `radius`.
    fn repaint(&mut self, place: Vec3, radius: f32, fresh: impl Fn(&Self, [usize; 3], Vec3, f32) -> Vec4 + Sync) {
        let [xs, ys, zs] = self.grid.around(place, place, radius);
        let painting = &*self;
        let plane = |k: usize| {
            let mut changed = Vec::new();
            for j in ys.clone() {
                for i in xs.clone() {
                    let p = painting.grid.position([i, j, k]);
                    let inside = 1.0 - p.distance_squared(place) / (radius * radius);
                    if inside > 0.0 {
                        changed.push((painting.grid.index([i, j, k]), fresh(painting, [i, j, k], p, inside * inside)));
                    }
                }
            }
            changed
        };
        let least = WORTH_A_THREAD / (xs.len() * ys.len()).max(1) + 1;
        let planes: Vec<Vec<(usize, Vec4)>> =
            if zs.len() <= least { zs.map(plane).collect() } else { zs.into_par_iter().with_min_len(least).map(plane).collect() };
        for (n, texel) in planes.into_iter().flatten() {
            self.texels[n] = texel;
        }
    }

    /// Cuts away, or restores, everything within `radius` of a line.
    fn tube(&mut self, line: &[Vec3], radius: f32, restores: bool) {
        let line = thinned(line, 0.25 * self.texel_mm);
        let ends: Vec<(Vec3, Vec3)> = if let [p] = line[..] { vec![(p, p)] } else { line.windows(2).map(|w| (w[0], w[1])).collect() };
        let (grid, gaps, far) = (self.grid, self.gaps, self.far);
        let segments: Vec<(Vec3, Vec3, [Range<usize>; 3])> = ends
            .into_iter()
            .map(|(a, b)| (a, b, grid.around(a, b, radius + far)))
            .filter(|(_, _, range)| range.iter().all(|r| !r.is_empty()))
            .collect();
        self.texels.par_chunks_mut(grid.size[0] * grid.size[1]).enumerate().for_each(|(k, plane)| {
            for (a, b, [xs, ys, _]) in segments.iter().filter(|s| s.2[2].contains(&k)) {
                for j in ys.clone() {
                    for i in xs.clone() {
                        let outside = to_segment(grid.position([i, j, k]), *a, *b) - radius;
                        let outside = if restores { outside } else { gaps.distance(outside, radius) };
                        carve(&mut plane[j * grid.size[0] + i], outside, restores, far);
                    }
                }
            }
        });
        self.carved(restores);
    }

    /// Cuts away, or restores, everything behind and in front of an outline.
    fn lasso(&mut self, lasso: &Lasso, progress: f32) {
        let outline_from_local = lasso.world_from_outline().inverse() * self.world_from_local;
        let eye = lasso.eye_mm;
        // The projection of a point onto the outline's plane, and the widening of the outline at
        // its depth.
        let seen = |p: Vec3| {
            let q = outline_from_local.transform_point3(p);
            let widening = lasso::widening(eye, q.z);
            (q.xy() / widening, widening)
        };
        let (grid, gaps, far) = (self.grid, self.gaps, self.far);
        let corners = Bounds::new(-grid.half, grid.half).corners().map(seen);
        let widest = corners.iter().map(|c| c.1).fold(0.0, f32::max);
        let narrowest = corners.iter().map(|c| c.1).fold(f32::INFINITY, f32::min);
        let step = 0.5 * self.texel_mm / widest;
        let mut outline = lasso.outline.clone();
        outline.dedup_by(|a, b| a.distance(*b) < 0.25 * step);
        if outline.len() < 3 {
            return;
        }
        let (mut low, mut high) = box_of(outline.iter().copied(), far / narrowest.max(0.05) + 2.0 * step);
        if narrowest > 0.01 {
            // The whole box lies in front of the eye: nothing outside its silhouette has an effect.
            let (first, last) = box_of(corners.iter().map(|c| c.0), step);
            (low, high) = (low.max(first), high.min(last));
        }
        if !low.cmplt(high).all() {
            return;
        }
        let silhouette = Silhouette::new(&outline, low, high, step);
        let depth = silhouette.values.iter().fold(0.0f32, |d, v| d.max(-v));
        self.texels.par_chunks_mut(grid.size[0] * grid.size[1]).enumerate().for_each(|(k, plane)| {
            for (n, texel) in plane.iter_mut().enumerate() {
                let (at, widening) = seen(grid.position([n % grid.size[0], n / grid.size[0], k]));
                let Some(outside) = silhouette.sample(at) else { continue };
                let outside = if lasso.restores {
                    outside * widening
                } else {
                    gaps.distance((outside + depth * (1.0 - progress)) * widening, depth * progress * widening)
                };
                carve(texel, outside, lasso.restores, far);
            }
        });
        self.carved(lasso.restores);
    }

    fn carved(&mut self, restores: bool) {
        if restores {
            self.worn |= self.has_cuts;
        } else {
            self.has_cuts = true;
        }
    }

    /// Converts C back to a distance.
    fn renew(&mut self) {
        if self.worn {
            let mut c: Vec<f32> = self.texels.iter().map(|t| t.w).collect();
            redistance(&mut c, self.grid.size, self.grid.spacing.to_array(), self.far);
            self.texels.iter_mut().zip(&c).for_each(|(t, c)| t.w = *c);
        }
    }
}

/// Removes a shape from the retained part, or adds it, given the distance to the shape (positive
/// outside).
fn carve(texel: &mut Vec4, outside: f32, restores: bool, far: f32) {
    let c = if restores { texel.w.max(-outside) } else { texel.w.min(outside) };
    texel.w = c.clamp(-far, far);
}

/// Distance to a segment, which may be a point.
fn to_segment(p: Vec3, a: Vec3, b: Vec3) -> f32 {
    let (ab, ap) = (b - a, p - a);
    let length_squared = ab.length_squared();
    let t = if length_squared > 0.0 { (ap.dot(ab) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
    ap.distance(ab * t)
}

/// A line without points closer together than `least`; its end points remain.
fn thinned(line: &[Vec3], least: f32) -> Vec<Vec3> {
    let mut decimated = line.to_vec();
    decimated.dedup_by(|next, before| next.distance(*before) < least);
    if let (Some(last), Some(end)) = (decimated.last().copied(), line.last().copied())
        && last != end
    {
        decimated.push(end);
    }
    decimated
}

/// A brush's positions along a line: its first point, then steps of at most `longest`, limited to
/// ±`room`.
fn dabs(line: &[Vec3], longest: f32, room: Vec3) -> impl Iterator<Item = Dab> {
    let first = line.first().map(|p| Dab { place: *p, step: Vec3::ZERO });
    let further = line.windows(2).flat_map(move |w| {
        let (a, b) = (w[0], w[1]);
        let count = (a.distance(b) / longest).ceil().max(1.0);
        let step = (b - a) / count;
        let (enters, leaves) = share_within(a, b, room);
        ((enters * count) as u32..(leaves * count).ceil() as u32).map(move |n| Dab { place: a + step * (n + 1) as f32, step })
    });
    first.into_iter().chain(further)
}

/// The fractions of the segment from a to b at which it enters and leaves ±`room`; both 0 if it
/// misses.
fn share_within(a: Vec3, b: Vec3, room: Vec3) -> (f32, f32) {
    let (mut enters, mut leaves) = (0.0f32, 1.0f32);
    for axis in 0..3 {
        let (from, way, end) = (a[axis], b[axis] - a[axis], room[axis]);
        if way != 0.0 {
            let (t, u) = ((-end - from) / way, (end - from) / way);
            (enters, leaves) = (enters.max(t.min(u)), leaves.min(t.max(u)));
        } else if from.abs() > end {
            return (0.0, 0.0);
        }
    }
    if enters <= leaves { (enters, leaves) } else { (0.0, 0.0) }
}

/// The bounding rectangle of points, enlarged by `margin`.
fn box_of(points: impl Iterator<Item = Vec2>, margin: f32) -> (Vec2, Vec2) {
    let (low, high) = points.fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    (low - margin, high + margin)
}

/// Distances to an outline on a grid of its plane: the outline may have thousands of points, and
/// the box millions.
struct Silhouette {
    low: Vec2,
    step: f32,
    size: [usize; 2],
    /// Positive outside.
    values: Vec<f32>,
}

impl Silhouette {
    fn new(outline: &[Vec2], low: Vec2, high: Vec2, step: f32) -> Self {
        let extent = high - low;
        let step = step.max(extent.max_element() / (MAX_OUTLINE_POINTS - 1) as f32);
        let size = extent.to_array().map(|e| (e / step).ceil() as usize + 1);
        let place = |n: usize| low + Vec2::new((n % size[0]) as f32, (n / size[0]) as f32) * step;
        let outline = Outline::new(outline.to_vec());
        let values = (0..size[0] * size[1]).into_par_iter().with_min_len(64).map(|n| outline.signed_distance(place(n))).collect();
        Self { low, step, size, values }
    }

    /// The distance at a point; none outside the grid.
    fn sample(&self, at: Vec2) -> Option<f32> {
        let p = (at - self.low) / self.step;
        let top = Vec2::new((self.size[0] - 1) as f32, (self.size[1] - 1) as f32);
        let inside = p.cmpge(Vec2::ZERO).all() && p.cmple(top).all();
        inside.then(|| trilinear(&self.values, [self.size[0], self.size[1], 1], p.extend(0.0)))
    }
}

struct Brush {
    /// None while nothing is painted.
    painting: Option<Painting>,
}

impl Field for Brush {
    fn backward(&self, q: Vec3) -> Backward {
        let Some(painting) = &self.painting else { return Backward { source: q, cut_distance_mm: NO_CUT_DISTANCE_MM } };
        let t = painting.sample(q);
        Backward { source: q + t.truncate(), cut_distance_mm: if t.w < 0.999 * painting.far { t.w } else { NO_CUT_DISTANCE_MM } }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        if self.painting.is_some() { forward_numerically(self, q) } else { Some(q) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Sampling;
    use super::*;
    use crate::deform::{Library, Storage};
    use glam::Mat3;
    use std::path::PathBuf;

    const SIZE: Vec3 = Vec3::splat(80.0);

    fn field_in(strokes: &[&str], progress: f32, world_from_local: Affine3A) -> Result<Box<dyn Field>> {
        let library = Library::without_volume(PathBuf::new());
        let mut settings = Arguments::default();
        settings.insert("strokes", Argument::Texts(strokes.iter().map(|s| (*s).to_owned()).collect()));
        let sampling = Sampling { resolution: None, storage: Storage::F16, min_ramp_mm: 3.0 };
        KIND.field(&[], progress, SIZE, &sampling, &FieldInputs { settings: &settings, world_from_local, library: &library })
    }

    fn field(strokes: &[&str]) -> Box<dyn Field> {
        field_in(strokes, 1.0, Affine3A::IDENTITY).unwrap()
    }

    /// Points spread evenly over the box.
    fn points() -> impl Iterator<Item = Vec3> {
        (0..6000).map(|i| {
            let share = [0.819_172_5, 0.671_043_6, 0.549_700_5].map(|a: f64| (0.5 + a * f64::from(i)).fract() as f32 - 0.5);
            Vec3::from(share) * SIZE
        })
    }

    fn largest(field: &dyn Field) -> f32 {
        points().map(|p| field.backward(p).source.distance(p)).fold(0.0, f32::max)
    }

    fn cut(field: &dyn Field, x: f32, y: f32, z: f32) -> f32 {
        field.backward(Vec3::new(x, y, z)).cut_distance_mm
    }

    /// Smallest det J over the box, by central differences over half a texel.
    fn min_determinant(field: &dyn Field) -> f32 {
        let h = 0.6;
        let column = |p: Vec3, e: Vec3| (field.backward(p + e * h).source - field.backward(p - e * h).source) / (2.0 * h);
        points().map(|p| Mat3::from_cols(column(p, Vec3::X), column(p, Vec3::Y), column(p, Vec3::Z)).determinant()).fold(f32::INFINITY, f32::min)
    }

    #[test]
    fn a_push_carries_matter_along() {
        let field = field(&["push 15 1 -10 0 0 0 0 0 10 0 0"]);
        let start = Vec3::new(-10.0, 0.0, 0.0);
        let at_end = field.backward(Vec3::new(10.0, 0.0, 0.0)).source;
        assert!(at_end.distance(start) < 3.0, "{at_end}");
        let ahead = field.backward(Vec3::new(12.0, 0.0, 0.0)).source;
        assert!(ahead.distance(start) < 6.0 && ahead.x > at_end.x, "{ahead}");
        assert!(largest(field.as_ref()) <= 20.01, "moved further than the stroke is long");
        let beside = Vec3::new(5.0, 17.5, 0.0);
        assert_eq!(field.backward(beside).source, beside);
    }

    #[test]
    fn pushes_do_not_fold() {
        for stroke in [
            "push 15 1 -10 0 0 0 0 0 10 0 0",
            // Back and forth, around a corner, out through a face, and a brush as large as the box.
            "push 12 1 -10 0 0 15 0 0 -10 3 0 -10 20 5",
            "push 20 1 0 0 0 60 10 5",
            "push 100 1 -10 0 0 20 5 0",
        ] {
            for progress in [0.4, 1.0] {
                let field = field_in(&[stroke], progress, Affine3A::IDENTITY).unwrap();
                assert!(largest(field.as_ref()) > 2.0, "{stroke} moves nothing");
                let det = min_determinant(field.as_ref());
                assert!(det > 0.0, "{stroke} at {progress}: {det}");
                for p in points() {
                    let on_face = Vec3::new(40.0, p.y, p.z);
                    assert!(field.backward(on_face).source.distance(on_face) < 1e-3, "{stroke} moves {on_face}");
                }
            }
        }
    }

    #[test]
    fn cuts_travel_with_their_matter() {
        let field = field(&["cut 5 1 -10 0 0", "push 18 1 -10 0 0 10 0 0"]);
        assert!(cut(field.as_ref(), 10.0, 0.0, 0.0) < -1.0);
        assert!(cut(field.as_ref(), -10.0, 0.0, 0.0) > 0.0, "what lies behind has filled the hole");
    }

    #[test]
    fn a_tube_is_cut_where_it_says() {
        let field = field(&["cut 6 1 -10 0 0 10 0 0 10 10 0"]);
        for p in points() {
            let corner = Vec3::new(10.0, 0.0, 0.0);
            let want = to_segment(p, -corner, corner).min(to_segment(p, corner, corner + 10.0 * Vec3::Y)) - 6.0;
            let got = field.backward(p).cut_distance_mm;
            if want.abs() < 2.0 {
                assert!((got - want).abs() < 0.35, "{got} for {want} at {p}");
            } else {
                assert_eq!(got < 0.0, want < 0.0, "{got} for {want} at {p}");
            }
        }
        let halfway = field_in(&["cut 6 1 -10 0 0 10 0 0"], 0.5, Affine3A::IDENTITY).unwrap();
        assert!(cut(halfway.as_ref(), 0.0, 2.0, 0.0) < 0.0 && cut(halfway.as_ref(), 0.0, 4.0, 0.0) > 0.0);
    }

    #[test]
    fn what_is_put_back_leaves_no_trace() {
        for strokes in [["cut 8 1 -10 3 0 12 0 5", "restore 8 1 -10 3 0 12 0 5"], ["cut 8 1 -10 3 0 12 0 5", "restore 20 1 -10 3 0 12 0 5"]] {
            let field = field(&strokes);
            for p in points() {
                let cut = field.backward(p).cut_distance_mm;
                assert!(cut == NO_CUT_DISTANCE_MM, "{strokes:?}: {cut} at {p}");
            }
        }
        let in_part = field(&["cut 10 1 -15 0 0 15 0 0", "restore 5 1 0 0 0"]);
        let at = |x| cut(in_part.as_ref(), x, 0.0, 0.0);
        // At the centre of a small ball, first-order sweeps are too low: by h ln(R/h), 1.7 mm here.
        assert!((3.0..5.5).contains(&at(0.0)) && at(4.0) > 0.0 && at(6.0) < 0.0 && at(10.0) < -3.0, "{} {} {}", at(0.0), at(6.0), at(10.0));
    }

    #[test]
    fn outlines_are_cut_and_put_back() {
        let square = "0 0 5 1 0 0 0 1 0 -10 -10 10 -10 10 10 -10 10";
        let parallel = field(&[&format!("lasso-cut 0 {square}")]);
        for z in [-38.0, 0.0, 38.0] {
            assert!(cut(parallel.as_ref(), 0.0, 0.0, z) < 0.0 && cut(parallel.as_ref(), 9.0, 9.0, z) < 0.0, "{z}");
            assert!((cut(parallel.as_ref(), 12.0, 0.0, z) - 2.0).abs() < 0.3, "{z}");
            assert_eq!(cut(parallel.as_ref(), 25.0, 0.0, z), NO_CUT_DISTANCE_MM, "{z}");
        }
        // The eye is on the side of +z: the outline is wider behind its plane.
        let conical = field(&["lasso-cut 100 0 0 0 1 0 0 0 1 0 -10 -10 10 -10 10 10 -10 10"]);
        for (x, z, want) in [(12.0, -30.0, -1.0), (14.0, -30.0, 1.0), (8.0, 30.0, 1.0), (6.0, 30.0, -1.0)] {
            assert!((cut(conical.as_ref(), x, 0.0, z) - want).abs() < 0.3, "{x} {z}: {}", cut(conical.as_ref(), x, 0.0, z));
        }
        let back = field(&[&format!("lasso-cut 0 {square}"), &format!("lasso-restore 0 {square}")]);
        assert!(points().all(|p| back.backward(p).cut_distance_mm == NO_CUT_DISTANCE_MM));
        // Half applied, it is narrower.
        let halfway = field_in(&[&format!("lasso-cut 0 {square}")], 0.5, Affine3A::IDENTITY).unwrap();
        assert!(cut(halfway.as_ref(), 4.0, 0.0, 0.0) < 0.0 && cut(halfway.as_ref(), 6.0, 0.0, 0.0) > 0.0);
    }

    #[test]
    fn smoothing_evens_out() {
        let pushed = field(&["push 12 1 -8 0 0 8 0 0"]);
        let smoothed = field(&["push 12 1 -8 0 0 8 0 0", "smooth 20 1 -8 0 0 8 0 0"]);
        let (before, after) = (largest(pushed.as_ref()), largest(smoothed.as_ref()));
        assert!(after < 0.9 * before, "{before} {after}");
        assert!(min_determinant(smoothed.as_ref()) > 0.0);
    }

    #[test]
    fn nothing_is_done_without_strokes_or_strength() {
        let strokes = ["push 15 1 -10 0 0 10 0 0", "cut 6 1 0 0 0", "smooth 9 1 0 0 0"];
        for field in [field(&[]), field_in(&strokes, 0.0, Affine3A::IDENTITY).unwrap()] {
            assert!(
                points()
                    .all(|p| field.backward(p).source == p && field.backward(p).cut_distance_mm == NO_CUT_DISTANCE_MM && field.forward(p) == Some(p))
            );
        }
    }

    #[test]
    fn strokes_are_in_the_world() {
        let world_from_local = Affine3A::from_translation(Vec3::new(100.0, 20.0, -5.0)) * Affine3A::from_rotation_z(0.7);
        let field = field_in(&["cut 6 1 110 25 0", "push 10 1 95 20 -5 90 20 -5"], 1.0, world_from_local).unwrap();
        let local = |x, y, z| world_from_local.inverse().transform_point3(Vec3::new(x, y, z));
        assert!(field.backward(local(110.0, 25.0, 0.0)).cut_distance_mm < -4.0);
        let at_end = world_from_local.transform_point3(field.backward(local(90.0, 20.0, -5.0)).source);
        assert!(at_end.distance(Vec3::new(95.0, 20.0, -5.0)) < 1.0, "{at_end}");
    }

    #[test]
    fn odd_strokes_give_finite_values() {
        let field = field(&[
            "push 0.001 1 0 0 0 9 9 9",
            "push 200 1 -100000 0 0 100000 5 5",
            "push 5 1 3 3 3 3 3 3",
            "smooth 1000 1 99999 99999 99999",
            "smooth 1000 1 1 2 3",
            "cut 0.0001 1 1 1 1",
            "cut 3 1 100000 0 0 -100000 0 0",
            "restore 1000 0 900 0 0",
            "lasso-cut 0.5 0 0 0 1 0 0 0 1 0 -10 -10 10 -10 10 10 -10 10",
            "lasso-cut 10 0 0 0 5 0 0 1 5 0 0 0 20 20 20 0 0 20",
            "lasso-restore 0 0 0 0 1 0 0 0 0 1 7 7 7 7 7 7",
        ]);
        for p in points() {
            let b = field.backward(p);
            assert!(b.source.is_finite() && b.cut_distance_mm.is_finite(), "{p}: {b:?}");
        }
    }

    #[test]
    fn refusals_name_the_stroke() {
        let refusal = |strokes: &[&str]| field_in(strokes, 1.0, Affine3A::IDENTITY).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(refusal(&["cut 5 1 0 0 0", "ctu 5 1 0 0 0"]).contains("stroke 2: \"ctu\" is not a tool; did you mean \"cut\"?"));
        assert!(refusal(&["cut 5 1 0 0 0"; MAX_STROKES + 1]).contains("at most 4096"));
        let long = format!("cut 5 1{}", " 1 2 3".repeat(MAX_POINTS / 2));
        assert!(refusal(&[&long, &long, "cut 5 1 0 0 0"]).contains("at most 200000"));
    }
}
