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
use super::contour_plane::{Run, Window, runs_of};
use super::contour_stack::{Raster, Section, Spacing, Stack};
use super::structures::Structure;
use crate::{ByteProgress, Result, Watch};
use glam::{DAffine3, DMat2, DMat3, DVec2, DVec3, Vec3Swizzles};
use rayon::prelude::*;
use std::path::Path;

/// Contours within this range of slices are parallel to the slices.
const MAX_SPREAD: f64 = 0.25;
/// Cosine of the largest angle between the normals of contours of one stack (3 degrees).
const SAME_NORMAL: f64 = 0.998_6;
/// Maximum number of directions in which one structure's contours are drawn.
const MAX_STACKS: usize = 8;
/// Maximum number of pixels for which distances are held at a time.
const MAX_DISTANCES: usize = 1 << 24;
/// Maximum number of coarser rasters that are tried.
const MAX_ATTEMPTS: usize = 16;
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
    /// Structures with slices between contours, on which they are interpolated.
    pub interpolated: Vec<usize>,
    /// Structures with contours that are left out, as they are drawn in too many directions.
    pub left_out: Vec<usize>,
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
        // Contours in voxels, and their normals times twice their areas, mm².
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
        // The axes may be sheared: x along the columns, y perpendicular to it.
        let x = m.x_axis.normalize_or(DVec3::X);
        let y = (m.y_axis - x * m.y_axis.dot(x)).length();
        Stack::new(
            contours.into_iter().map(|(c, _)| c).collect(),
            DAffine3::IDENTITY,
            DMat2::from_cols_array(&[m.x_axis.length(), 0.0, m.y_axis.dot(x), y]),
            self.slice_mm(),
        )
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
        let of_pixel = |pixel: f64| {
            let world_from_frame = DAffine3 {
                matrix3: DMat3::from_cols(u * pixel, v * pixel, normal * step),
                translation: origin,
            };
            let frame_from_voxel = world_from_frame.inverse() * *self.world_from_voxel;
            let in_frame = |c: &[DVec3]| c.iter().map(|p| frame_from_voxel.transform_point3(*p)).collect();
            Stack::new(
                contours.iter().map(|(c, _)| in_frame(c)).collect(),
                frame_from_voxel,
                DMat2::from_diagonal(DVec2::splat(pixel)),
                step,
            )
        };
        let mut stack = of_pixel(pixel);
        // Coarser pixels where the planes are too large to be held together.
        for _ in 0..MAX_ATTEMPTS {
            let excess = stack.distances() as f64 / MAX_DISTANCES as f64;
            if excess <= 1.0 {
                break;
            }
            pixel *= 1.1 * excess.sqrt();
            stack = of_pixel(pixel);
        }
        stack
    }

    /// The runs of a stack's voxels; a row's number is that of the row in the whole grid.
    fn runs(&self, stack: &Stack, spacing: Spacing, watch: &Watch) -> Result<Vec<Run>> {
        if stack.is_aligned() {
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
                let [a, b] = [plane, next].map(|p| p.runs(&window));
                let mut found = Vec::new();
                if !is_between || a == b || window.pixels() > MAX_DISTANCES {
                    for &(k, section) in part {
                        let is_closer_to_next = matches!(section, Section::Between(_, t) if t >= 0.5);
                        let closer = if is_closer_to_next { &b } else { &a };
                        found.extend(closer.iter().map(|r| in_slice(r, k, rows)));
                    }
                    return Ok(found);
                }
                let [a, b] = [plane, next].map(|p| p.signed_distance(&window, stack.mm_from_pixel));
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
fn in_slice(run: &Run, slice: usize, rows: usize) -> Run {
    Run {
        row: slice * rows + run.row,
        columns: run.columns.clone(),
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
        interpolated: Vec::new(),
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
            if stack.skips_slices(spacing) && map.interpolated.last() != Some(&n) {
                map.interpolated.push(n);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Voxels;

    const SIZE: [usize; 3] = [40, 36, 16];

    fn circle(centre: [f64; 2], radius: f64, z: f64) -> Vec<DVec3> {
        (0..1440)
            .map(|n| {
                let angle = n as f64 / 1440.0 * std::f64::consts::TAU;
                (DVec2::from_array(centre) + radius * DVec2::from_angle(angle)).extend(z)
            })
            .collect()
    }

    /// A structure of contours in voxels of a grid.
    fn structure(number: u32, grid: &DAffine3, contours: Vec<Vec<DVec3>>) -> Structure {
        let contours = contours
            .iter()
            .map(|c| c.iter().map(|p| grid.transform_point3(*p)).collect())
            .collect();
        Structure {
            number,
            contours,
            ..Structure::default()
        }
    }

    fn map(structures: &[Structure], grid: &DAffine3) -> LabelMap {
        label_map(Path::new("rs.dcm"), structures, SIZE, grid, &Watch::NONE).unwrap_or_else(|e| panic!("{e}"))
    }

    /// Compares every voxel with what a function of its indices says.
    fn check(map: &LabelMap, expected: impl Fn(DVec3) -> u32) {
        let voxels = Voxels::new(SIZE, map.values.clone());
        for k in 0..SIZE[2] {
            for j in 0..SIZE[1] {
                for i in 0..SIZE[0] {
                    let (found, p) = (voxels.at([i, j, k]), DVec3::new(i as f64, j as f64, k as f64));
                    assert_eq!(found, f64::from(expected(p)), "{i} {j} {k}");
                }
            }
        }
    }

    /// A rotated grid with voxels of 2, 3 and 4 mm, far from the origin.
    fn turned() -> DAffine3 {
        DAffine3 {
            matrix3: DMat3::from_euler(glam::EulerRot::XYZ, 0.3, -0.5, 0.8)
                * DMat3::from_diagonal(DVec3::new(2.0, 3.0, 4.0)),
            translation: DVec3::new(-310.0, 120.5, 900.25),
        }
    }

    #[test]
    fn slices_hold_the_centres_inside() {
        let centre = [18.3, 16.7];
        for grid in [DAffine3::IDENTITY, turned()] {
            let contours = (3..9).flat_map(|k| {
                [
                    circle(centre, 12.4, f64::from(k)),
                    circle(centre, 5.2, f64::from(k)),
                ]
            });
            let found = map(&[structure(2, &grid, contours.collect())], &grid);
            let distance = |p: DVec3| p.xy().distance(centre.into());
            check(&found, |p| {
                2 * u32::from((3.0..9.0).contains(&p.z) && distance(p) < 12.4 && distance(p) > 5.2)
            });
            assert!(found.gaps.is_empty() && found.overlaps == 0);
        }
    }

    #[test]
    fn slices_between_contours_are_interpolated() {
        let centre = [18.3, 16.7];
        let grid = DAffine3::from_scale(DVec3::new(1.5, 1.5, 3.0));
        // A cone drawn on every third slice; its ends extend by one and a half slices.
        let radius = |z: f64| 4.13 + 0.8 * (z.clamp(2.0, 11.0) - 2.0);
        let cone = |at: &[f64]| at.iter().map(|z| circle(centre, radius(*z), *z)).collect();
        let found = map(&[structure(1, &grid, cone(&[2.0, 5.0, 8.0, 11.0]))], &grid);
        check(&found, |p| {
            u32::from((1.0..13.0).contains(&p.z) && p.xy().distance(centre.into()) < radius(p.z))
        });
        // Planes in the middle between slices, and planes closer than slices.
        let half: Vec<f64> = (2..9).map(|n| f64::from(n) + 0.5).collect();
        let fine: Vec<f64> = (0..25).map(|n| 2.1 + 0.25 * f64::from(n)).collect();
        for (at, slices) in [(half, 2.0..9.0), (fine, 2.0..8.2)] {
            let prism = at.iter().map(|z| circle(centre, 7.3, *z)).collect();
            let found = map(&[structure(1, &grid, prism)], &grid);
            check(&found, |p| {
                u32::from(slices.contains(&p.z) && p.xy().distance(centre.into()) < 7.3)
            });
        }
        // A structure drawn on every slice has a gap where it has none.
        let parts: Vec<Vec<DVec3>> = [2.0, 3.0, 4.0, 7.0, 8.0].map(|z| circle(centre, 7.3, z)).into();
        let found = map(&[structure(1, &grid, parts)], &grid);
        assert_eq!(
            (found.gaps.as_slice(), found.voxels[0][0] % 5),
            ([0].as_slice(), 0)
        );
        check(&found, |p| {
            let is_drawn = (2.0..5.0).contains(&p.z) || (7.0..9.0).contains(&p.z);
            u32::from(is_drawn && p.xy().distance(centre.into()) < 7.3)
        });
    }

    #[test]
    fn contours_across_the_slices_fill_a_box() {
        // Planes of constant x, 2 voxels apart: a box from one voxel before the first plane to one
        // after the last one.
        for grid in [DAffine3::from_scale(DVec3::new(1.5, 2.0, 3.0)), turned()] {
            let planes = (0..8).map(|n| {
                let x = 6.4 + 2.0 * f64::from(n);
                [[5.3, 2.4], [25.6, 2.4], [25.6, 12.7], [5.3, 12.7]]
                    .map(|[y, z]| DVec3::new(x, y, z))
                    .to_vec()
            });
            let found = map(&[structure(1, &grid, planes.collect())], &grid);
            check(&found, |p| {
                let low = DVec3::new(5.4, 5.3, 2.4);
                let high = DVec3::new(21.4, 25.6, 12.7);
                u32::from(p.cmpgt(low).all() && p.cmplt(high).all())
            });
        }
    }

    #[test]
    fn smaller_structures_are_in_front() {
        let grid = DAffine3::IDENTITY;
        let disc = |number: u32, radius: f64| {
            let contours = (3..9).map(|k| circle([18.3, 16.7], radius, f64::from(k)));
            structure(number, &grid, contours.collect())
        };
        let found = map(&[disc(1, 4.2), disc(2, 12.3), disc(300, 8.1)], &grid);
        check(&found, |p| {
            let d = p.xy().distance(DVec2::new(18.3, 16.7));
            let is_inside = (3.0..9.0).contains(&p.z) && d < 12.3;
            u32::from(is_inside)
                * if d < 4.2 {
                    1
                } else if d < 8.1 {
                    300
                } else {
                    2
                }
        });
        assert_eq!(found.overlaps, found.voxels[2][0]);
        assert_eq!(found.voxels[0][0], found.voxels[0][1]);
        assert_eq!(found.values.type_name(), "u16");
        // Of equal ones, the later one.
        let found = map(&[disc(1, 4.2), disc(2, 4.2)], &grid);
        assert_eq!((found.voxels[0][1], found.voxels[1][1]), (0, found.overlaps));
    }

    #[test]
    fn odd_contours_are_harmless() {
        let grid = turned();
        let far = |v: f64| vec![DVec3::splat(-v), DVec3::new(v, -v, 3.0), DVec3::new(v, v, -v)];
        let point = vec![DVec3::ONE; 3];
        let line = vec![
            DVec3::ZERO,
            DVec3::X * 5.0,
            DVec3::X * 9.0,
            DVec3::new(0.0, 0.0, 9.0),
        ];
        let in_many_directions = (0..40).map(|n| {
            let turn = DMat3::from_rotation_x(f64::from(n) * 0.1);
            circle([0.0, 0.0], 5.0, 0.0)
                .iter()
                .map(|p| turn * *p + 8.0)
                .collect()
        });
        let many = structure(3, &grid, in_many_directions.collect());
        let found = map(
            &[
                structure(1, &grid, vec![far(1e5), far(1e6), point]),
                structure(2, &grid, vec![line]),
                many,
            ],
            &grid,
        );
        assert_eq!(found.left_out, [2]);
        let empty = map(&[structure(1, &grid, Vec::new())], &grid);
        assert_eq!(empty.voxels, [[0, 0]]);
    }
}
