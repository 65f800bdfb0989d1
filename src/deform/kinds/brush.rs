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

mod path;
mod silhouette;

use super::{
    Backward, DefaultSize, Field, FieldBuilder, FieldContext, FieldInputs, GapResolution, Kind,
    NO_CUT_DISTANCE_MM, Setting, SettingFormat, forward_numerically, lasso,
};
use crate::deform::{Argument, Arguments};
use crate::math::{Bounds, redistance, smoothstep, trilinear};
use crate::{Error, Result};
use glam::{Affine3A, Vec3, Vec3Swizzles, Vec4};
use path::{dabs, thinned, to_segment};
use rayon::prelude::*;
use silhouette::{Silhouette, box_of};
use std::ops::Range;

pub use crate::deform::stroke::{Lasso, Stroke, StrokeTool, parse};

const MAX_STROKES: usize = 4096;
const MAX_POINTS: usize = 200_000;
/// Longest step of a push, as a fraction of the brush's radius.
const STEP: f32 = 0.25;
/// Number of grid points that justify a thread.
const WORTH_A_THREAD: usize = 8192;

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
        let points = points
            .iter()
            .map(|p| center + size * Vec3::from_array(*p))
            .collect();
        Stroke::Line {
            tool,
            radius_mm: radius * thickness,
            strength,
            points,
        }
        .to_string()
    };
    let strokes = vec![
        line(
            StrokeTool::Push,
            0.22,
            1.0,
            &[[0.0, -0.16, 0.12], [0.02, -0.24, 0.18], [0.06, -0.3, 0.24]],
        ),
        line(
            StrokeTool::Cut,
            0.08,
            1.0,
            &[[0.22, -0.28, -0.1], [0.3, -0.2, 0.08], [0.26, -0.1, 0.24]],
        ),
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
    Ok(Box::new(Brush {
        painting: Some(painting),
    }))
}

fn strokes(settings: &Arguments) -> Result<Vec<Stroke>> {
    let texts = settings.texts("strokes")?.unwrap_or_default();
    if texts.len() > MAX_STROKES {
        return Err(Error::value(
            "strokes",
            format!(
                "are {}; at most {MAX_STROKES} can be given: divide them among several brushes",
                texts.len()
            ),
        ));
    }
    let read = |(n, text): (usize, &String)| {
        parse(text).map_err(|problem| Error::value("strokes", format!("stroke {}: {problem}", n + 1)))
    };
    let strokes = texts.iter().enumerate().map(read).collect::<Result<Vec<_>>>()?;
    let points: usize = strokes.iter().map(Stroke::points).sum();
    if points > MAX_POINTS {
        return Err(Error::value(
            "strokes",
            format!(
                "have {points} points; at most {MAX_POINTS} can be given: divide them among several brushes"
            ),
        ));
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

impl Painting {
    fn new(c: &FieldContext, world_from_local: Affine3A) -> Self {
        let spacing = c.size_mm / Vec3::from(c.grid.map(|n| n.max(2) as f32 - 1.0));
        let far = c.ramp_mm + 2.0 * c.texel_mm;
        Self {
            grid: BrushGrid {
                size: c.grid,
                half: c.half(),
                spacing,
            },
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
            Stroke::Line {
                tool,
                radius_mm,
                strength,
                points,
            } => {
                let line: Vec<Vec3> = points
                    .iter()
                    .map(|p| self.local_from_world.transform_point3(*p))
                    .collect();
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
        trilinear(
            &self.texels,
            self.grid.size,
            (p + self.grid.half) / self.grid.spacing,
        )
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
        for dab in
            dabs(&thinned(line, 0.5 * longest), longest, half + radius).filter(|d| d.step != Vec3::ZERO)
        {
            let way = dab.step * strength;
            self.repaint(dab.place, radius, |painting, _, p, weight| {
                let window: f32 = (0..3)
                    .map(|a| smoothstep(0.0, fade[a], half[a] - p[a].abs()))
                    .product();
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
                    sum += painting.texels
                        [grid.index([at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1])]
                    .truncate();
                }
                own.truncate().lerp(sum / 27.0, strength * weight).extend(own.w)
            });
        }
    }

    /// Updates the grid points around a position; each new value may depend on all the old ones.
    /// The weight falls from 1 at the position to 0 at `radius`.
    fn repaint(
        &mut self,
        place: Vec3,
        radius: f32,
        fresh: impl Fn(&Self, [usize; 3], Vec3, f32) -> Vec4 + Sync,
    ) {
        let [xs, ys, zs] = self.grid.around(place, place, radius);
        let painting = &*self;
        let plane = |k: usize| {
            let mut changed = Vec::new();
            for j in ys.clone() {
                for i in xs.clone() {
                    let p = painting.grid.position([i, j, k]);
                    let inside = 1.0 - p.distance_squared(place) / (radius * radius);
                    if inside > 0.0 {
                        changed.push((
                            painting.grid.index([i, j, k]),
                            fresh(painting, [i, j, k], p, inside * inside),
                        ));
                    }
                }
            }
            changed
        };
        let least = WORTH_A_THREAD / (xs.len() * ys.len()).max(1) + 1;
        let planes: Vec<Vec<(usize, Vec4)>> = if zs.len() <= least {
            zs.map(plane).collect()
        } else {
            zs.into_par_iter().with_min_len(least).map(plane).collect()
        };
        for (n, texel) in planes.into_iter().flatten() {
            self.texels[n] = texel;
        }
    }

    /// Cuts away, or restores, everything within `radius` of a line.
    fn tube(&mut self, line: &[Vec3], radius: f32, restores: bool) {
        let line = thinned(line, 0.25 * self.texel_mm);
        let ends: Vec<(Vec3, Vec3)> = if let [p] = line[..] {
            vec![(p, p)]
        } else {
            line.windows(2).map(|w| (w[0], w[1])).collect()
        };
        let (grid, gaps, far) = (self.grid, self.gaps, self.far);
        let segments: Vec<(Vec3, Vec3, [Range<usize>; 3])> = ends
            .into_iter()
            .map(|(a, b)| (a, b, grid.around(a, b, radius + far)))
            .filter(|(_, _, range)| range.iter().all(|r| !r.is_empty()))
            .collect();
        self.texels
            .par_chunks_mut(grid.size[0] * grid.size[1])
            .enumerate()
            .for_each(|(k, plane)| {
                for (a, b, [xs, ys, _]) in segments.iter().filter(|s| s.2[2].contains(&k)) {
                    for j in ys.clone() {
                        for i in xs.clone() {
                            let outside = to_segment(grid.position([i, j, k]), *a, *b) - radius;
                            let outside = if restores {
                                outside
                            } else {
                                gaps.distance(outside, radius)
                            };
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
        self.texels
            .par_chunks_mut(grid.size[0] * grid.size[1])
            .enumerate()
            .for_each(|(k, plane)| {
                for (n, texel) in plane.iter_mut().enumerate() {
                    let (at, widening) = seen(grid.position([n % grid.size[0], n / grid.size[0], k]));
                    let Some(outside) = silhouette.sample(at) else {
                        continue;
                    };
                    let outside = if lasso.restores {
                        outside * widening
                    } else {
                        gaps.distance(
                            (outside + depth * (1.0 - progress)) * widening,
                            depth * progress * widening,
                        )
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
    let c = if restores {
        texel.w.max(-outside)
    } else {
        texel.w.min(outside)
    };
    texel.w = c.clamp(-far, far);
}

struct Brush {
    /// None while nothing is painted.
    painting: Option<Painting>,
}

impl Field for Brush {
    fn backward(&self, q: Vec3) -> Backward {
        let Some(painting) = &self.painting else {
            return Backward {
                source: q,
                cut_distance_mm: NO_CUT_DISTANCE_MM,
            };
        };
        let t = painting.sample(q);
        Backward {
            source: q + t.truncate(),
            cut_distance_mm: if t.w < 0.999 * painting.far {
                t.w
            } else {
                NO_CUT_DISTANCE_MM
            },
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        if self.painting.is_some() {
            forward_numerically(self, q)
        } else {
            Some(q)
        }
    }
}

#[cfg(test)]
mod tests;
