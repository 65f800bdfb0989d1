//! Structures as a label map on a grid: every structure's contours are sorted into parallel planes,
//! and the planes filled and interpolated to the grid's slices.
//!
//! Contours parallel to the slices are filled on the grid's own pixels. Where a slice lies between
//! two planes, the structure is interpolated by shape (Raya and Udupa, Shape-based interpolation of
//! multidimensional objects, 1990): inside is where the signed distances from the contours of both
//! planes, weighted by the distances of the planes, are positive. The outermost planes extend by
//! half the distance of planes, so that a structure has as much volume as its planes times their
//! distance. Contours at an angle to the slices are interpolated in the same way in their own
//! frame, at every voxel.
//!
//! Programs differ about slices without contours: plastimatch and dcmrtstruct2nii leave them empty,
//! Slicer connects the contours. Here, a structure drawn on every slice is as it was drawn, and may
//! have gaps; one drawn on every second or third slice is interpolated.

use super::super::StoredValues;
use super::super::source::zeroed;
use super::contour_plane::{ContourPlane, Run, Window, runs_of};
use super::structures::Structure;
use crate::{ByteProgress, Result, Watch};
use glam::{DAffine3, DMat2, DMat3, DVec2, DVec3, Vec3Swizzles};
use rayon::prelude::*;
use std::path::Path;

/// Contours within this range of slices are parallel to the slices.
const MAX_SPREAD: f64 = 0.25;
/// Contours closer than this are in the same plane, in slices; or in millimetres, if that is more.
const SAME_PLANE: f64 = 0.02;
const SAME_PLANE_MM: f64 = 0.01;
/// Cosine of the largest angle between the normals of contours of one stack (3 degrees).
const SAME_NORMAL: f64 = 0.998_6;
/// Maximum number of directions in which one structure's contours are drawn.
const MAX_STACKS: usize = 8;
/// Maximum number of pixels for which distances are held at a time.
const MAX_DISTANCES: usize = 1 << 24;
/// Maximum number of coarser rasters that are tried.
const MAX_ATTEMPTS: usize = 16;
/// A slice this close to a plane of contours is in it; and the extent of planes includes its lower
/// end, but not its upper one, up to rounding.
const IN_PLANE: f64 = 0.01;
const ROUNDING: f64 = 1e-6;
/// Marks voxels of several structures.
const OVERLAP: u16 = 1 << 15;

/// Structures as a label map.
pub struct LabelMap {
    /// The labels, i fastest.
    pub values: StoredValues,
    /// Number of voxels in more than one structure.
    pub overlaps: usize,
    /// Number of voxels within each structure, and how many of them have its label.
    pub voxels: Vec<[usize; 2]>,
    /// Structures with gaps between their contours that are left open.
    pub gaps: Vec<usize>,
    /// Structures with contours that are left out, as they are drawn in too many directions.
    pub left_out: Vec<usize>,
}

/// Contours in parallel planes.
struct Stack {
    /// From voxels to the stack's frame: pixels in its planes, and planes in slices along z.
    frame_from_voxel: DAffine3,
    /// Millimetres from pixels, within a plane.
    mm_from_pixel: DMat2,
    /// Whether the frame is that of the voxels.
    is_aligned: bool,
    /// Positions of the planes, sorted, and their contours.
    at: Vec<f64>,
    planes: Vec<ContourPlane>,
}

/// Which planes determine a slice.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Section {
    /// One plane.
    In(usize),
    /// A plane and the next one, and the position between them.
    Between(usize, f64),
    /// None.
    Outside,
}

/// The distance of planes, in slices, and how large a gap between two of them is bridged.
#[derive(Clone, Copy)]
struct Spacing {
    usual: f64,
    bridge: f64,
}

impl Stack {
    /// The lower median of the distances between planes.
    fn median_gap(&self) -> Option<f64> {
        let mut gaps: Vec<f64> = self.at.windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        gaps.get(gaps.len().saturating_sub(1) / 2).copied()
    }

    /// The spacing of the planes. `of_all` is that of all structures, for the few planes of one
    /// that has no usual distance of its own.
    fn spacing(&self, of_all: Option<f64>) -> Spacing {
        let usual = match (self.median_gap(), of_all) {
            (Some(own), Some(all)) if self.at.len() == 2 && own > 3.0 * all => all,
            (Some(own), _) => own,
            (None, all) => all.unwrap_or(1.0),
        };
        // A structure drawn on every slice has no contours where it has a gap.
        let bridge = if usual <= 1.5 {
            1.5 * usual.max(1.0)
        } else {
            3.0 * usual
        };
        Spacing { usual, bridge }
    }

    fn section(&self, at: f64, spacing: Spacing) -> Section {
        let above = self.at.partition_point(|p| *p <= at);
        let before = above.checked_sub(1).map(|n| (n, at - self.at[n]));
        let after = self.at.get(above).map(|p| (above, p - at));
        let half = 0.5 * spacing.usual;
        match (before, after) {
            (Some((n, d)), _) if d < IN_PLANE => Section::In(n),
            (_, Some((n, d))) if d < IN_PLANE => Section::In(n),
            (Some((n, a)), Some((_, b))) if a + b <= spacing.bridge => Section::Between(n, a / (a + b)),
            (Some((n, d)), _) if d < half - ROUNDING => Section::In(n),
            (_, Some((n, d))) if d <= half + ROUNDING => Section::In(n),
            _ => Section::Outside,
        }
    }

    /// Whether there is a gap that is not bridged.
    fn has_gap(&self, spacing: Spacing) -> bool {
        self.at.windows(2).any(|w| w[1] - w[0] > spacing.bridge)
    }

    /// The stack's extent in its frame, with the ends of the outermost planes.
    fn bounds(&self, spacing: Spacing) -> [DVec3; 2] {
        let ends = |plane: &ContourPlane| [plane.low, plane.high];
        let (mut low, mut high) = (DVec2::splat(f64::INFINITY), DVec2::splat(f64::NEG_INFINITY));
        for [a, b] in self.planes.iter().map(ends) {
            (low, high) = (low.min(a), high.max(b));
        }
        let half = 0.5 * spacing.usual + IN_PLANE;
        let (first, last) = (self.at.first().unwrap_or(&0.0), self.at.last().unwrap_or(&0.0));
        [low.extend(first - half), high.extend(last + half)]
    }
}

/// A grid, and the conversions between its voxels and the world.
struct Grid<'a> {
    size: [usize; 3],
    world_from_voxel: &'a DAffine3,
    voxel_from_world: DAffine3,
}

impl Grid<'_> {
    /// Distance of slices along their normal, mm.
    fn slice_mm(&self) -> f64 {
        let m = self.world_from_voxel.matrix3;
        m.z_axis.dot(m.x_axis.cross(m.y_axis).normalize_or_zero()).abs()
    }

    /// The stacks of a structure's contours, and whether contours are left out.
    fn stacks(&self, structure: &Structure) -> (Vec<Stack>, bool) {
        // Contours of a structure in voxels and with their normals, times twice their areas, in mm².
        let mut rest: Vec<(Vec<DVec3>, DVec3)> = structure
            .contours
            .iter()
            .map(|c| {
                let voxels = c
                    .iter()
                    .map(|p| self.voxel_from_world.transform_point3(*p))
                    .collect();
                (voxels, doubled_area(c))
            })
            .collect();
        let mut stacks = Vec::new();
        while stacks.len() < MAX_STACKS && !rest.is_empty() {
            let largest = rest
                .iter()
                .filter(|(c, _)| spread(c) > MAX_SPREAD)
                .map(|(_, area)| *area)
                .max_by(|a, b| a.length().total_cmp(&b.length()));
            let Some(normal) = largest.and_then(DVec3::try_normalize) else {
                // Points on a line have no normal, and no inside.
                rest.retain(|(c, _)| spread(c) <= MAX_SPREAD);
                stacks.push(self.aligned(rest));
                return (stacks, false);
            };
            let (own, others) = rest
                .into_iter()
                .partition(|(_, area)| area.dot(normal).abs() >= SAME_NORMAL * area.length());
            rest = others;
            stacks.push(self.oblique(own, normal));
        }
        (stacks, !rest.is_empty())
    }

    /// The stack of contours parallel to the slices.
    fn aligned(&self, contours: Vec<(Vec<DVec3>, DVec3)>) -> Stack {
        let m = self.world_from_voxel.matrix3;
        let same = SAME_PLANE.max(SAME_PLANE_MM / self.slice_mm()).min(MAX_SPREAD);
        let (at, planes) = planes(contours.into_iter().map(|(c, _)| c).collect(), same);
        // The axes may be sheared: x along the columns, y perpendicular to it.
        let x = m.x_axis.normalize_or(DVec3::X);
        let y = (m.y_axis - x * m.y_axis.dot(x)).length();
        Stack {
            frame_from_voxel: DAffine3::IDENTITY,
            mm_from_pixel: DMat2::from_cols_array(&[m.x_axis.length(), 0.0, m.y_axis.dot(x), y]),
            is_aligned: true,
            at,
            planes,
        }
    }

    /// The stack of contours with a common normal.
    fn oblique(&self, contours: Vec<(Vec<DVec3>, DVec3)>, normal: DVec3) -> Stack {
        let m = self.world_from_voxel.matrix3;
        let axes = [m.x_axis, m.y_axis, m.z_axis];
        let step = axes.map(|a| a.dot(normal).abs()).into_iter().fold(0.0, f64::max);
        let mut pixel = axes.map(|a| a.length()).into_iter().fold(f64::INFINITY, f64::min);
        let (u, v) = normal.any_orthonormal_pair();
        let origin = contours
            .first()
            .and_then(|(c, _)| c.first())
            .map_or(DVec3::ZERO, |p| self.world_from_voxel.transform_point3(*p));
        let frame = |pixel: f64| {
            let world_from_frame = DAffine3 {
                matrix3: DMat3::from_cols(u * pixel, v * pixel, normal * step),
                translation: origin,
            };
            world_from_frame.inverse() * *self.world_from_voxel
        };
        let same = SAME_PLANE.max(SAME_PLANE_MM / step).min(MAX_SPREAD);
        let make = |pixel: f64| {
            let frame_from_voxel = frame(pixel);
            let moved = contours
                .iter()
                .map(|(c, _)| c.iter().map(|p| frame_from_voxel.transform_point3(*p)).collect())
                .collect();
            let (at, planes) = planes(moved, same);
            Stack {
                frame_from_voxel,
                mm_from_pixel: DMat2::from_diagonal(DVec2::splat(pixel)),
                is_aligned: false,
                at,
                planes,
            }
        };
        let mut stack = make(pixel);
        // Coarser pixels where the planes are too large to be held together.
        for _ in 0..MAX_ATTEMPTS {
            let excess = stack.distances() as f64 / MAX_DISTANCES as f64;
            if excess <= 1.0 {
                break;
            }
            pixel *= 1.1 * excess.sqrt();
            stack = make(pixel);
        }
        stack
    }

    /// The runs of a stack's voxels; a row's number is that of the row in the whole grid.
    fn runs(&self, stack: &Stack, spacing: Spacing, watch: &Watch) -> Result<Vec<Run>> {
        if stack.is_aligned {
            self.runs_of_slices(stack, spacing, watch)
        } else {
            self.runs_across(stack, spacing, watch)
        }
    }

    /// The runs of a stack parallel to the slices.
    fn runs_of_slices(&self, stack: &Stack, spacing: Spacing, watch: &Watch) -> Result<Vec<Run>> {
        let [columns, rows, depth] = self.size;
        let [low, high] = stack.bounds(spacing);
        let slices = within(low.z, high.z, depth);
        let sections: Vec<(usize, Section)> = slices
            .map(|k| (k, stack.section(k as f64, spacing)))
            .filter(|(_, s)| *s != Section::Outside)
            .collect();
        // The slices of one plane, or of the same two planes, share their work.
        let planes_of = |s: &Section| match *s {
            Section::In(n) => (n, false),
            Section::Between(n, _) => (n, true),
            Section::Outside => (usize::MAX, false),
        };
        let parts: Vec<&[(usize, Section)]> = sections
            .chunk_by(|a, b| planes_of(&a.1) == planes_of(&b.1))
            .collect();
        let runs: Vec<Vec<Run>> = parts
            .into_par_iter()
            .map(|part| -> Result<Vec<Run>> {
                watch.check()?;
                let (n, is_between) = planes_of(&part[0].1);
                let plane = &stack.planes[n];
                let next = &stack.planes[(n + 1).min(stack.planes.len() - 1)];
                let (low, high) = if is_between {
                    (plane.low.min(next.low), plane.high.max(next.high))
                } else {
                    (plane.low, plane.high)
                };
                let window = Window::around(low, high, [columns, rows]);
                if !is_between || window.pixels() > MAX_DISTANCES {
                    let mut found = Vec::new();
                    for &(k, section) in part {
                        let is_closer_to_next = matches!(section, Section::Between(_, t) if t >= 0.5);
                        let plane = if is_closer_to_next { next } else { plane };
                        found.extend(plane.runs(&window).into_iter().map(|r| in_slice(r, k, rows)));
                    }
                    return Ok(found);
                }
                let [a, b] = [plane, next].map(|p| p.signed_distance(&window, stack.mm_from_pixel));
                let mut found = Vec::new();
                for &(k, section) in part {
                    watch.check()?;
                    let t = if let Section::Between(_, t) = section {
                        t as f32
                    } else {
                        0.0
                    };
                    let inside: Vec<bool> = a.iter().zip(&b).map(|(a, b)| a + (b - a) * t > 0.0).collect();
                    for (j, row) in window
                        .rows
                        .clone()
                        .zip(inside.chunks_exact(window.columns.len().max(1)))
                    {
                        runs_of(row, k * rows + j, window.columns.start, &mut found);
                    }
                }
                Ok(found)
            })
            .collect::<Result<_>>()?;
        Ok(runs.into_iter().flatten().collect())
    }

    /// The runs of a stack at an angle to the slices.
    fn runs_across(&self, stack: &Stack, spacing: Spacing, watch: &Watch) -> Result<Vec<Run>> {
        let [columns, rows, depth] = self.size;
        let bounds = stack.bounds(spacing);
        let raster = Raster::new(stack);
        let voxel_from_frame = stack.frame_from_voxel.inverse();
        let corners = (0..8).map(|n| {
            let end = |axis: usize| bounds[n >> axis & 1][axis];
            voxel_from_frame.transform_point3(DVec3::new(end(0), end(1), end(2)))
        });
        let (low, high) = corners.fold(
            (DVec3::splat(f64::INFINITY), DVec3::splat(f64::NEG_INFINITY)),
            |(low, high), c| (low.min(c), high.max(c)),
        );
        let [is, js, ks] = [
            within(low.x, high.x, columns),
            within(low.y, high.y, rows),
            within(low.z, high.z, depth),
        ];
        let runs: Vec<Vec<Run>> = ks
            .into_par_iter()
            .map(|k| -> Result<Vec<Run>> {
                watch.check()?;
                let (mut found, mut inside) = (Vec::new(), vec![false; is.len()]);
                for j in js.clone() {
                    for (i, inside) in is.clone().zip(&mut inside) {
                        let voxel = DVec3::new(i as f64, j as f64, k as f64);
                        let p = stack.frame_from_voxel.transform_point3(voxel);
                        *inside = raster.contains(p.xy(), stack.section(p.z, spacing));
                    }
                    runs_of(&inside, k * rows + j, is.start, &mut found);
                }
                Ok(found)
            })
            .collect::<Result<_>>()?;
        Ok(runs.into_iter().flatten().collect())
    }
}

/// The indices of a grid's axis within bounds.
fn within(low: f64, high: f64, count: usize) -> std::ops::Range<usize> {
    let index = |v: f64| v.clamp(0.0, count as f64) as usize;
    let start = index(low.ceil());
    start..index(high.floor() + 1.0).max(start)
}

/// A run of a slice in the grid.
fn in_slice(run: Run, slice: usize, rows: usize) -> Run {
    Run {
        row: slice * rows + run.row,
        ..run
    }
}

/// The range of a contour along z.
fn spread(contour: &[DVec3]) -> f64 {
    let (low, high) = contour
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| {
            (low.min(p.z), high.max(p.z))
        });
    high - low
}

/// Twice a polygon's area, along its normal (Newell).
pub fn doubled_area(corners: &[DVec3]) -> DVec3 {
    let Some(&first) = corners.first() else {
        return DVec3::ZERO;
    };
    corners
        .windows(2)
        .map(|w| (w[0] - first).cross(w[1] - first))
        .sum()
}

/// Contours sorted into planes by their mean position along z; a plane starts at its first contour.
fn planes(contours: Vec<Vec<DVec3>>, same_plane: f64) -> (Vec<f64>, Vec<ContourPlane>) {
    let mean = |c: &[DVec3]| c.iter().map(|p| p.z).sum::<f64>() / c.len().max(1) as f64;
    let mut sorted: Vec<(f64, Vec<DVec2>)> = contours
        .into_iter()
        .map(|c| (mean(&c), c.iter().map(|p| p.xy()).collect()))
        .collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut at, mut planes) = (Vec::new(), Vec::new());
    let mut rest = sorted.as_slice();
    while let Some((first, _)) = rest.first() {
        let count = rest.partition_point(|(z, _)| z - first <= same_plane).max(1);
        let (own, others) = rest.split_at(count);
        at.push(own.iter().map(|(z, _)| z).sum::<f64>() / count as f64);
        planes.push(ContourPlane::new(own.iter().map(|(_, c)| c.as_slice())));
        rest = others;
    }
    (at, planes)
}

/// The signed distances of all planes of an oblique stack, on a raster of its own.
struct Raster {
    origin: DVec2,
    width: usize,
    height: usize,
    distances: Vec<Vec<f32>>,
}

impl Stack {
    /// Number of pixels of all planes, with a margin.
    fn distances(&self) -> usize {
        let [low, high] = self.bounds(Spacing {
            usual: 0.0,
            bridge: 0.0,
        });
        let extent = (high - low).xy().ceil() + 4.0;
        (extent.x * extent.y * self.planes.len() as f64).min(usize::MAX as f64) as usize
    }
}

impl Raster {
    fn new(stack: &Stack) -> Self {
        let [low, high] = stack.bounds(Spacing {
            usual: 0.0,
            bridge: 0.0,
        });
        let origin = low.xy().floor() - 1.0;
        let extent = (high.xy() - origin).ceil() + 2.0;
        let window = Window {
            columns: 0..extent.x.max(1.0) as usize,
            rows: 0..extent.y.max(1.0) as usize,
        };
        let distances = stack
            .planes
            .par_iter()
            .map(|plane| plane.moved(-origin).signed_distance(&window, stack.mm_from_pixel))
            .collect();
        Self {
            origin,
            width: window.columns.len(),
            height: window.rows.len(),
            distances,
        }
    }

    /// Bilinear interpolation of a plane's signed distance; negative outside of the raster.
    fn distance(&self, plane: usize, p: DVec2) -> f64 {
        let p = p - self.origin;
        let inside =
            p.x >= 0.0 && p.y >= 0.0 && p.x < self.width as f64 - 1.0 && p.y < self.height as f64 - 1.0;
        let Some(values) = self.distances.get(plane).filter(|_| inside) else {
            return f64::NEG_INFINITY;
        };
        let (corner, f) = (p.floor(), p.fract());
        let first = corner.y as usize * self.width + corner.x as usize;
        let at = |n: usize| f64::from(values[first + n]);
        let along = |n: usize| at(n) + (at(n + 1) - at(n)) * f.x;
        along(0) + (along(self.width) - along(0)) * f.y
    }

    fn contains(&self, p: DVec2, section: Section) -> bool {
        match section {
            Section::In(n) => self.distance(n, p) > 0.0,
            Section::Between(n, t) => {
                let [a, b] = [n, n + 1].map(|n| self.distance(n, p));
                a.is_finite() && a + (b - a) * t > 0.0
            }
            Section::Outside => false,
        }
    }
}

/// The structures as labels on a grid. Where structures overlap, the one with fewer voxels is used,
/// so that an outline of the body does not cover its organs; among equals, the later one.
///
/// # Errors
/// Not enough memory; the error names `path`. [`crate::Error::Cancelled`].
pub fn label_map(
    path: &Path,
    structures: &[Structure],
    size: [usize; 3],
    world_from_voxel: &DAffine3,
    watch: &Watch,
) -> Result<LabelMap> {
    let grid = Grid {
        size,
        world_from_voxel,
        voxel_from_world: world_from_voxel.inverse(),
    };
    let mut map = LabelMap {
        values: Vec::<u8>::new().into(),
        overlaps: 0,
        voxels: Vec::with_capacity(structures.len()),
        gaps: Vec::new(),
        left_out: Vec::new(),
    };
    let mut stacks = Vec::with_capacity(structures.len());
    for (n, structure) in structures.iter().enumerate() {
        watch.check()?;
        let (own, is_incomplete) = grid.stacks(structure);
        map.left_out.extend(is_incomplete.then_some(n));
        stacks.push(own);
    }
    let mut usual: Vec<f64> = stacks
        .iter()
        .flatten()
        .filter(|s| s.at.len() > 2)
        .filter_map(Stack::median_gap)
        .collect();
    usual.sort_by(f64::total_cmp);
    let usual = usual.get(usual.len() / 2).copied();
    let mut labels: Vec<u16> = zeroed(path, size.iter().product())?;
    let meter = ByteProgress::new(watch, structures.len() as u64);
    for (n, stacks) in stacks.iter().enumerate() {
        let mut runs = Vec::new();
        for stack in stacks {
            let spacing = stack.spacing(usual);
            if stack.has_gap(spacing) && map.gaps.last() != Some(&n) {
                map.gaps.push(n);
            }
            runs.extend(grid.runs(stack, spacing, watch)?);
        }
        if stacks.len() > 1 {
            runs = united(runs);
        }
        map.voxels.push([runs.iter().map(|r| r.columns.len()).sum(), 0]);
        paint(&mut labels, &runs, size[0], &map.voxels);
        meter.add(1)?;
    }
    for label in &mut labels {
        if let Some(n) = (*label & !OVERLAP).checked_sub(1) {
            map.overlaps += usize::from(*label & OVERLAP != 0);
            map.voxels[usize::from(n)][1] += 1;
            *label = structures[usize::from(n)].number as u16;
        }
    }
    map.values = if structures.iter().all(|s| s.number < 256) {
        labels.into_iter().map(|l| l as u8).collect::<Vec<u8>>().into()
    } else {
        labels.into()
    };
    Ok(map)
}

/// Runs of several stacks without overlaps.
fn united(mut runs: Vec<Run>) -> Vec<Run> {
    runs.sort_by_key(|r| (r.row, r.columns.start));
    let mut merged: Vec<Run> = Vec::with_capacity(runs.len());
    for run in runs {
        match merged.last_mut() {
            Some(last) if last.row == run.row && run.columns.start <= last.columns.end => {
                last.columns.end = last.columns.end.max(run.columns.end);
            }
            _ => merged.push(run),
        }
    }
    merged
}

/// Gives the last of the structures its voxels, except those of smaller ones. Labels are structures
/// counted from 1.
fn paint(labels: &mut [u16], runs: &[Run], columns: usize, voxels: &[[usize; 2]]) {
    let own = voxels.len() as u16;
    let count = voxels.last().map_or(0, |v| v[0]);
    for run in runs {
        let row = run.row * columns;
        for label in &mut labels[row + run.columns.start..row + run.columns.end] {
            *label = match (*label & !OVERLAP).checked_sub(1) {
                None => own,
                Some(other) if count <= voxels[usize::from(other)][0] => own | OVERLAP,
                Some(_) => *label | OVERLAP,
            };
        }
    }
}
