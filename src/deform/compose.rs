//! A stack, or a transform from a file, as one displacement map. Where that is exact enough, a sample costs the same however many maps there are.
//!
//! *Theory*: the composite is a map like any other, D(p') = source(p') - p' on a grid over every cube of the stack (\[DDM06\] section 6
//! names both ways). Interpolating it makes an error that shrinks with the square of the texel where the stack is smooth, with the texel where it
//! has a kink, and not at all where it tears matter. The resolution is not guessed: a coarse map is made, compared with the exact walk, and refined
//! until the worst error where matter is lies within the bound. Stacks tear more often than not, at the faces of boxes that matter enters: so the map
//! that stands for a stack in pictures ([`precompose`]) marks the cells in which it is not exact enough, and there the maps themselves are walked.
//!
//! *The error* at a point is the distance between the two sources where both show matter, and the distance to the cut where one shows matter and the
//! other does not. Points whose source lies beyond the scene show nothing and do not count.

use super::transform::{Transform, TransformStep};
use super::{DisplacementMap, PlacedMap, Placement, PrecomposedMap, Stack, Storage, TexelSample};
use crate::math::flat;
use crate::math::{Bounds, to_f32};
use crate::volume::GridGeometry;
use crate::{Result, Watch};
use glam::{Affine3A, DVec3, Mat3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Most texels of a composed map: 256³, 128 MiB in half precision.
pub const MAX_TEXELS: usize = 1 << 24;
/// Texels along the longest axis that the search begins with.
const FIRST_RESOLUTION: usize = 32;

/// Texels that a map is refined to while it is looked for how far a stack can be composed.
const MAX_SEARCH_TEXELS: usize = 1 << 23;
/// Points at which a composed map is compared with what it was made from, while it is refined and at last.
const PROBES: usize = 100_000;
const LAST_PROBES: usize = 600_000;
/// Share of the bound that the points that are compared may take: between them it may be more.
const OF_BOUND: f32 = 0.6;
/// Texels along the longest axis of the maps that stand for a stack, the next one tried where too much is marked in one.
const PRECOMPOSED_TEXELS: [usize; 4] = [48, 80, 128, 192];
/// Points compared in the cells of one of them.
const CELL_PROBES: usize = 1_000_000;
/// Share of the space that may be marked: a finer map is not worth it below.
const FEW_MARKED: f32 = 0.12;
/// Share of the maps' work that a precomposed map must save, and of the space that may be marked however many maps there are.
const MIN_SAVED: f32 = 0.2;
const MAX_MARKED: f32 = 0.6;
/// Of the points of a cell, those at which Jacobians are compared, and how far their components may be apart: normals turn by about as much, radians.
const SLOPE_PROBES: usize = 2;
const MAX_SLOPE_ERROR: f32 = 0.05;
/// Points by which a map is given up that is too coarse by far.
const SOME_CELLS: usize = 10_000;
/// Times that points found at last are marked.
const LAST_ROUNDS: usize = 4;
/// A map twice as fine that is not this much better will never be good enough: the stack tears there.
const MIN_GAIN: f32 = 0.8;

/// A composed map and how well it stands for what it was made from.
pub struct ComposedMap {
    /// The map in its place.
    pub placed: PlacedMap,
    /// Largest error found where matter is, mm.
    pub worst_mm: f32,
    /// 99th percentile of the error, mm.
    pub p99_mm: f32,
    /// Whether that is within the bound.
    pub within: bool,
}

/// How finely to compose.
#[derive(Clone, Copy, Debug)]
pub enum Resolution {
    /// Texels along the longest axis.
    Fixed(usize),
    /// As many as it takes for the worst error where matter is, mm.
    Within(f32),
}

/// How exact a precomposed map is.
#[derive(Clone, Copy, Debug)]
pub struct PrecomposeError {
    /// Largest error found where matter is, mm.
    pub worst_mm: f32,
    /// 99th percentile of the error, mm.
    pub p99_mm: f32,
    /// Share of the space with matter in it where the maps themselves are walked.
    pub fallback_share: f32,
}

/// The axis-aligned box of every cube of a stack; none if it is empty.
fn cubes(stack: &Stack) -> Option<Bounds> {
    stack.maps().iter().map(PlacedMap::bounds_in_world).reduce(|a, b| a.union(&b))
}

/// Source and smallest mask of each of many points.
pub type SourcesAndAlphas = Vec<(Vec3, f32)>;

/// Evaluates a stack at many points. The CPU's own, or a device's.
pub type Evaluate<'a> = &'a dyn Fn(&Stack, &[Vec3]) -> Result<SourcesAndAlphas>;

/// The stack at many points, on all cores.
///
/// # Errors
/// None.
pub fn evaluate(stack: &Stack, points: &[Vec3]) -> Result<SourcesAndAlphas> {
    Ok(points.par_iter().map(|p| stack.source_and_alpha_unclipped(*p)).collect())
}

/// What is sampled: source and mask of a deformed point, and the box beyond which there is no matter.
struct BackwardMap<'a> {
    source_and_alpha: &'a (dyn Fn(Vec3) -> (Vec3, f32) + Sync),
    /// The same for all points of a grid at once.
    many: &'a dyn Fn(&[Vec3]) -> Result<SourcesAndAlphas>,
    scene_box: Bounds,
}

/// Composes a stack into one map; none if the stack is empty.
///
/// # Errors
/// A placement that cannot be used.
pub fn stack(stack: &Stack, scene_box: &Bounds, resolution: Resolution, storage: Storage, evaluate: Evaluate) -> Result<Option<ComposedMap>> {
    let Some(bounds) = cubes(stack) else { return Ok(None) };
    let placement = Placement::new(bounds.center(), bounds.size(), Vec3::ZERO)?;
    let f = |p: Vec3| stack.source_and_alpha_unclipped(p);
    let many = |points: &[Vec3]| evaluate(stack, points);
    search(&BackwardMap { source_and_alpha: &f, many: &many, scene_box: *scene_box }, &placement, resolution, storage).map(Some)
}

/// One map that stands for a stack within `bound_mm` wherever matter is, with marks where it cannot: cells that a tear or a cut runs through, or
/// that bend more than the grid resolves. None, with the share that would have to be marked, where that saves too little.
///
/// # Errors
/// A placement that cannot be used; whatever the device reports; [`crate::Error::Cancelled`].
pub fn precompose(
    stack: &Stack,
    scene_box: &Bounds,
    bound_mm: f32,
    evaluate: Evaluate,
    watch: &Watch,
) -> Result<(Option<PrecomposedMap>, PrecomposeError)> {
    let mut precompose_error = PrecomposeError { worst_mm: 0.0, p99_mm: 0.0, fallback_share: 1.0 };
    let Some(bounds) = cubes(stack) else { return Ok((None, precompose_error)) };
    let placement = Placement::new(bounds.center(), bounds.size(), Vec3::ZERO)?;
    let size_mm = placement.size_mm();
    let finest = finest(size_mm, MAX_SEARCH_TEXELS);
    let exact = |p: &Vec3| stack.source_and_alpha_unclipped(*p);
    let comparison = Comparison { exact: &exact, scene_box };
    // Every sample costs one map, those that are marked all others as well.
    let max_marked = (1.0 - MIN_SAVED - 1.0 / stack.maps().len() as f32).min(MAX_MARKED);
    let mut best: Option<MarkedGrid> = None;
    for texels in PRECOMPOSED_TEXELS.map(|n| n.min(finest)) {
        watch.check()?;
        if best.as_ref().is_some_and(|b| b.size == grid_for(size_mm, texels)) {
            break;
        }
        let mut grid = MarkedGrid::new(stack, &placement, grid_for(size_mm, texels), bound_mm, evaluate)?;
        // Too coarse by far: not worth a look at every cell.
        let about = grid.bad_share_of_some(&comparison, bound_mm);
        if about > max_marked {
            precompose_error.fallback_share = precompose_error.fallback_share.min(about);
            continue;
        }
        grid.find_bad_cells(&comparison, stack, bound_mm, watch)?;
        let gained = best.as_ref().is_none_or(|b| grid.share() < MIN_GAIN * b.share());
        if gained {
            best = Some(grid);
        }
        let share = best.as_ref().map_or(1.0, MarkedGrid::share);
        if share <= FEW_MARKED || !gained && share <= max_marked {
            break;
        }
    }
    let Some(mut grid) = best else { return Ok((None, precompose_error)) };
    // Many points at last, elsewhere than those that were asked: what they find is marked as well.
    for _ in 0..LAST_ROUNDS {
        watch.check()?;
        precompose_error.fallback_share = grid.share();
        if precompose_error.fallback_share > max_marked {
            return Ok((None, precompose_error));
        }
        let precomposed = PrecomposedMap { map: grid.marked_map(), bound_mm };
        let with = Stack::new(stack.maps().to_vec()).with_precomposed(precomposed.clone());
        let h = 0.25 * grid.texel_mm();
        let errors = comparison.errors(&|p| with.source_and_alpha(*p), &bounds, LAST_PROBES, h);
        let beyond: Vec<Vec3> = errors.iter().filter(|(e, _)| *e > bound_mm).map(|(_, p)| *p).collect();
        if beyond.is_empty() {
            (precompose_error.worst_mm, precompose_error.p99_mm) = worst_and_p99(errors.into_iter().map(|(e, _)| e).collect());
            return Ok((Some(precomposed), precompose_error));
        }
        grid.mark_around(&beyond);
    }
    Ok((None, precompose_error))
}

/// Whether two Jacobians would light matter differently.
fn differs(a: &Mat3, b: &Mat3) -> bool {
    (*a - *b).to_cols_array().iter().any(|v| v.abs() > MAX_SLOPE_ERROR)
}

/// A composite in the making: samples, and the cells between them that are not exact enough.
struct MarkedGrid {
    size: [usize; 3],
    placement: Placement,
    storage: Storage,
    samples: Vec<TexelSample>,
    bad: Vec<bool>,
    /// Cells with any matter in them.
    occupied: Vec<bool>,
}

impl MarkedGrid {
    fn new(stack: &Stack, placement: &Placement, size: [usize; 3], bound_mm: f32, evaluate: Evaluate) -> Result<Self> {
        let samples = grid_samples(placement, size, &|points| evaluate(stack, points))?;
        // What half precision rounds to must not matter.
        let largest = samples.par_iter().map(|s| s.displacement.abs().max_element()).reduce(|| 0.0, f32::max);
        let rounding = largest * placement.size_mm().max_element() / 2048.0;
        let storage = if rounding > 0.2 * bound_mm { Storage::F32 } else { Storage::F16 };
        let cells = Self::cells_of(size).iter().product();
        Ok(Self { size, placement: *placement, storage, samples, bad: vec![false; cells], occupied: vec![false; cells] })
    }

    fn cells_of(size: [usize; 3]) -> [usize; 3] {
        size.map(|n| n.saturating_sub(1).max(1))
    }

    fn texel_mm(&self) -> f32 {
        (self.placement.size_mm() / Vec3::from(Self::cells_of(self.size).map(|n| n as f32))).max_element()
    }

    /// Share of the cells with matter that are bad.
    fn share(&self) -> f32 {
        let (bad, occupied) = self
            .bad
            .iter()
            .zip(&self.occupied)
            .fold((0usize, 0usize), |(bad, occupied), (b, s)| (bad + usize::from(*b && *s), occupied + usize::from(*s)));
        bad as f32 / occupied.max(1) as f32
    }

    fn placed(&self) -> PlacedMap {
        let map = DisplacementMap::from_samples(self.size, self.storage, self.samples.clone());
        PlacedMap::new(Arc::new(map), self.placement)
    }

    /// Share of bad cells among some of those with matter.
    fn bad_share_of_some(&self, comparison: &Comparison, bound_mm: f32) -> f32 {
        let placed = self.placed();
        let errors = comparison.errors(&|p| placed.backward(*p), &placed.bounds_in_world(), SOME_CELLS, 0.25 * self.texel_mm());
        errors.iter().filter(|(e, _)| *e > OF_BOUND * bound_mm).count() as f32 / errors.len().max(1) as f32
    }

    /// Finds the cells in which the composite is not exact enough, and those beside them: a tear may graze a cell without meeting a point that is asked.
    fn find_bad_cells(&mut self, comparison: &Comparison, stack: &Stack, bound_mm: f32, watch: &Watch) -> Result<()> {
        let placed = self.placed();
        let cells = Self::cells_of(self.size);
        let edge = Vec3::from(cells.map(|n| 1.0 / n as f32));
        let each = (CELL_PROBES / self.bad.len()).clamp(2, 12);
        let h = 0.25 * self.texel_mm();
        let of_cell = |n: usize| -> (bool, bool) {
            let low = Vec3::new((n % cells[0]) as f32, (n / cells[0] % cells[1]) as f32, (n / (cells[0] * cells[1])) as f32);
            let (mut bad, mut occupied) = (false, false);
            for k in 0..each {
                let p = self.placement.world_from_map.transform_point3((low + spread(n * each + k)) * edge);
                if let Some(error) = comparison.error(&|p| placed.backward(*p), p, h) {
                    occupied = true;
                    bad |= error > OF_BOUND * bound_mm;
                    // What a kink does to light is seen long before what it does to places.
                    bad = bad || k < SLOPE_PROBES && placed.derivatives(p).is_some_and(|(j, _)| differs(&j, &stack.jet(p).d_source_d_deformed));
                }
            }
            (bad, occupied)
        };
        let found: Vec<(bool, bool)> =
            (0..self.bad.len()).into_par_iter().with_min_len(256).map(|n| if watch.is_cancelled() { (false, false) } else { of_cell(n) }).collect();
        watch.check()?;
        self.occupied = found.iter().map(|f| f.1).collect();
        self.bad = self.grown(&found.iter().map(|f| f.0).collect::<Vec<_>>());
        Ok(())
    }

    /// Cells and their neighbours.
    fn grown(&self, of: &[bool]) -> Vec<bool> {
        let cells = Self::cells_of(self.size);
        let strides = [1, cells[0], cells[0] * cells[1]];
        let mut grown = of.to_vec();
        for axis in 0..3 {
            let before = grown.clone();
            grown.par_iter_mut().enumerate().for_each(|(n, bad)| {
                let at = n / strides[axis] % cells[axis];
                *bad |= at > 0 && before[n - strides[axis]] || at + 1 < cells[axis] && before[n + strides[axis]];
            });
        }
        grown
    }

    fn mark_around(&mut self, points: &[Vec3]) {
        let cells = Self::cells_of(self.size);
        let mut found = vec![false; self.bad.len()];
        for p in points {
            let x = self.placement.map_from_world.transform_point3(*p);
            let at: [usize; 3] = std::array::from_fn(|a| ((x[a] * cells[a] as f32) as usize).min(cells[a] - 1));
            found[(at[2] * cells[1] + at[1]) * cells[0] + at[0]] = true;
        }
        let grown = self.grown(&found);
        self.bad.iter_mut().zip(grown).for_each(|(bad, more)| *bad |= more);
    }

    /// The map, its texels marked at the corners of bad cells.
    fn marked_map(&self) -> PlacedMap {
        let cells = Self::cells_of(self.size);
        let mut marked = vec![false; self.samples.len()];
        for (n, _) in self.bad.iter().enumerate().filter(|(_, bad)| **bad) {
            let at = [n % cells[0], n / cells[0] % cells[1], n / (cells[0] * cells[1])];
            for corner in 0..8usize {
                let c: [usize; 3] = std::array::from_fn(|a| (at[a] + (corner >> a & 1)).min(self.size[a] - 1));
                marked[(c[2] * self.size[1] + c[1]) * self.size[0] + c[0]] = true;
            }
        }
        let map = DisplacementMap::from_marked_samples(self.size, self.storage, self.samples.clone(), &marked);
        PlacedMap::new(Arc::new(map), self.placement)
    }
}

/// Grid points for a box whose longest axis gets `texels`.
fn grid_for(size_mm: Vec3, texels: usize) -> [usize; 3] {
    let edge = size_mm.max_element() / (texels.max(2) - 1) as f32;
    size_mm.to_array().map(|s| ((s / edge).round() as usize + 1).max(2))
}

/// Samples a mapping over a placement, finely enough.
fn search(mapping: &BackwardMap, placement: &Placement, resolution: Resolution, storage: Storage) -> Result<ComposedMap> {
    let size_mm = placement.size_mm();
    let bound = match resolution {
        Resolution::Fixed(n) => {
            let finest = finest(size_mm, MAX_TEXELS);
            let mut composed = sampled(mapping, placement, grid_for(size_mm, n.min(finest)), storage, LAST_PROBES)?;
            composed.within = true;
            return Ok(composed);
        }
        Resolution::Within(mm) => mm,
    };
    let finest = finest(size_mm, MAX_SEARCH_TEXELS);
    let mut texels = FIRST_RESOLUTION.min(finest);
    let mut composed = sampled(mapping, placement, grid_for(size_mm, texels), storage, PROBES)?;
    let mut storage = storage;
    let mut in_vain = 0;
    loop {
        if composed.worst_mm <= OF_BOUND * bound {
            // Points may have missed the worst place: many more are asked at last.
            let (worst_mm, p99_mm) = error(mapping, &composed.placed, LAST_PROBES);
            (composed.worst_mm, composed.p99_mm) = (composed.worst_mm.max(worst_mm), p99_mm);
            if composed.worst_mm <= bound {
                return Ok(ComposedMap { within: true, ..composed });
            }
        }
        // What half precision rounds to is no finer for a finer grid.
        let rounding = composed.placed.map.scale * size_mm.max_element() / 2048.0;
        if storage == Storage::F16 && rounding > 0.5 * OF_BOUND * bound {
            storage = Storage::F32;
            composed = sampled(mapping, placement, grid_for(size_mm, texels), storage, PROBES)?;
            continue;
        }
        if texels == finest || in_vain == 2 {
            return Ok(composed);
        }
        let before = (composed.worst_mm, texels);
        // At the error's square root, if all is smooth.
        let needed = (texels as f32 * (composed.worst_mm / (OF_BOUND * bound)).sqrt() * 1.1) as usize;
        texels = needed.clamp(texels * 5 / 4, texels * 2).min(finest);
        composed = sampled(mapping, placement, grid_for(size_mm, texels), storage, PROBES)?;
        let finer = texels as f32 / before.1 as f32;
        let expected = before.0 * MIN_GAIN.powf(finer.log2());
        in_vain = if composed.worst_mm > expected { in_vain + 1 } else { 0 };
    }
}

/// The most texels along the longest axis of which there are at most `most` in all.
fn finest(size_mm: Vec3, most: usize) -> usize {
    (2..=4096).rev().find(|&n| grid_for(size_mm, n).iter().product::<usize>() <= most).unwrap_or(2)
}

/// The texels of a map: what `many` says of its grid points, in map coordinates.
fn grid_samples(placement: &Placement, size: [usize; 3], many: &dyn Fn(&[Vec3]) -> Result<SourcesAndAlphas>) -> Result<Vec<TexelSample>> {
    let map_from_world = Mat3::from(placement.map_from_world.matrix3);
    let points: Vec<Vec3> = (0..size.iter().product::<usize>())
        .into_par_iter()
        .map(|n| placement.world_from_map.transform_point3(DisplacementMap::grid_point(size, n)))
        .collect();
    let texel = |((source, alpha), p): ((Vec3, f32), &Vec3)| TexelSample { displacement: map_from_world * (source - *p), alpha };
    Ok(many(&points)?.into_par_iter().zip(&points).map(texel).collect())
}

/// The map of a mapping, with its error at some points.
fn sampled(mapping: &BackwardMap, placement: &Placement, size: [usize; 3], storage: Storage, probes: usize) -> Result<ComposedMap> {
    let map = DisplacementMap::from_samples(size, storage, grid_samples(placement, size, mapping.many)?);
    let placed = PlacedMap::new(Arc::new(map), *placement);
    let (worst_mm, p99_mm) = error(mapping, &placed, probes);
    Ok(ComposedMap { placed, worst_mm, p99_mm, within: false })
}

/// Largest error and 99th percentile of a map where matter is, mm.
fn error(mapping: &BackwardMap, placed: &PlacedMap, probes: usize) -> (f32, f32) {
    let (exact, composed) = (|p: &Vec3| (mapping.source_and_alpha)(*p), |p: &Vec3| placed.backward(*p));
    let size = placed.map.size;
    let texel = (placed.placement.size_mm() / Vec3::from(size.map(|n| n.max(2) as f32 - 1.0))).max_element();
    let comparison = Comparison { exact: &exact, scene_box: &mapping.scene_box };
    let errors = comparison.errors(&composed, &placed.bounds_in_world(), probes, 0.25 * texel);
    worst_and_p99(errors.into_iter().map(|(e, _)| e).collect())
}

/// Places spread over the unit cube: the powers of the plastic number, so that no grid of a map is met again and again at the same place of its cells.
fn spread(n: usize) -> Vec3 {
    Vec3::from([0.819_172_513_396_164_4, 0.671_043_606_703_789_3, 0.549_700_477_901_970_2f64].map(|a| (0.5 + a * n as f64).fract() as f32))
}

fn worst_and_p99(mut errors: Vec<f32>) -> (f32, f32) {
    if errors.is_empty() {
        return (0.0, 0.0);
    }
    let rank = (errors.len() * 99 / 100).min(errors.len() - 1);
    let (_, p99, above) = errors.select_nth_unstable_by(rank, f32::total_cmp);
    let p99 = *p99;
    (above.iter().fold(p99, |a, b| a.max(*b)), p99)
}

/// A mapping. It is given a reference: where two closures are given the same point by value, Rust 1.95 gives the second one what the first has made of
/// it (rust-lang/rust#155241).
type Map<'a> = dyn Fn(&Vec3) -> (Vec3, f32) + Sync + 'a;

/// Sources and masks of one mapping held against another's.
struct Comparison<'a> {
    exact: &'a Map<'a>,
    scene_box: &'a Bounds,
}

impl Comparison<'_> {
    /// How far a mapping is off at a point, mm; none where neither shows anything. The mask's slope is found over `h` mm.
    fn error(&self, composed: &Map, p: Vec3, h: f32) -> Option<f32> {
        let holds = |p: Vec3| self.scene_box.contains(&Bounds::new(p, p));
        let ((source, alpha), (found, found_alpha)) = ((self.exact)(&p), composed(&p));
        let (shows, found_shows) = (alpha >= 0.5 && holds(source), found_alpha >= 0.5 && holds(found));
        match (alpha >= 0.5, found_alpha >= 0.5) {
            _ if !shows && !found_shows => None,
            (true, true) => Some(source.distance(found)),
            // How far the cut is that only one of them has.
            _ => {
                let mask = |p: Vec3| (self.exact)(&p).1;
                let slope = Vec3::from(Vec3::AXES.map(|e| mask(p + e * h) - mask(p - e * h))).length() / (2.0 * h);
                Some((alpha - 0.5).abs() / slope.max(1e-6))
            }
        }
    }

    /// The errors at points spread over a box, and where they are.
    fn errors(&self, composed: &Map, over: &Bounds, probes: usize, h: f32) -> Vec<(f32, Vec3)> {
        let of_point = |n: usize| {
            let p = over.min + spread(n) * over.size();
            self.error(composed, p, h).map(|e| (e, p))
        };
        (0..probes).into_par_iter().with_min_len(1024).filter_map(of_point).collect()
    }
}

/// A transform as the maps of a stack, first applied first: a field keeps its own grid, an affine needs eight texels, B-splines are sampled at
/// least four times per control point. (A stack's last map is the first that a deformed point goes through.)
///
/// Where that cannot be done (a field of too many points, a strength other than 1 of several steps, a resolution that is asked for) the whole is
/// sampled into one map ([`transform`]).
///
/// # Errors
/// A placement that cannot be used: a singular matrix.
pub fn transform_maps(
    transform: &Transform,
    scene_box: &Bounds,
    strength: f32,
    resolution: Option<usize>,
    storage: Storage,
) -> Result<Vec<PlacedMap>> {
    let single = transform.steps.len() == 1;
    let fits = |g: &GridGeometry| g.size.iter().product::<usize>() <= MAX_TEXELS;
    let all_fit = transform.steps.iter().all(|s| match s {
        TransformStep::Affine(_) => true,
        TransformStep::Field(f) => fits(&f.grid),
        TransformStep::BSpline(b) => fits(&b.fine_grid()),
    });
    if resolution.is_some() || !(single || strength == 1.0) || !all_fit {
        return Ok(vec![self::transform(transform, scene_box, strength, resolution, storage)?.placed]);
    }
    // Each step's map reaches over all that the steps after it leave of the scene.
    let mut bounds = *scene_box;
    let mut maps = Vec::with_capacity(transform.steps.len());
    for step in transform.steps.iter().rev() {
        maps.push(match step {
            TransformStep::Field(f) => {
                let placement = placement_of(&f.grid)?;
                let mut placed = sampled_grid(f, None, &placement, storage, strength);
                placed.reach = Vec3::from(f.grid.size.map(|n| if n > 1 { 0.5 / (n - 1) as f32 } else { 0.0 }));
                placed
            }
            TransformStep::BSpline(b) => {
                let grid = b.fine_grid();
                let sampled = super::transform::VectorField::sampled(grid, |p| b.source_from_deformed(p));
                sampled_grid(&sampled, None, &placement_of(&grid)?, storage, strength)
            }
            TransformStep::Affine(m) => self::transform(&Transform::affine(*m), &bounds, strength, None, storage)?.placed,
        });
        bounds = bounds.union(&before(step, &bounds, strength));
    }
    Ok(maps)
}

/// The box in which matter of a box can be seen before a step of a chain.
fn before(step: &TransformStep, bounds: &Bounds, strength: f32) -> Bounds {
    match step {
        TransformStep::Affine(m) => {
            // Part of the way to an affine is one of its own, whose inverse may reach further than the whole's.
            let t = f64::from(strength);
            let part = glam::DAffine3 { matrix3: glam::DMat3::IDENTITY * (1.0 - t) + m.matrix3 * t, translation: m.translation * t };
            bounds.transformed(&to_f32(&part.inverse()))
        }
        TransformStep::Field(v) => bounds.grown(v.vectors.par_iter().map(|d| d.length()).reduce(|| 0.0, f32::max)),
        TransformStep::BSpline(b) => bounds.grown(b.coefficients.iter().map(|d| d.length()).fold(0.0, f32::max)),
    }
}

/// A transform as one map over a scene, sampled as finely as its finest grid; an affine needs eight texels.
///
/// The map reaches over `scene_box`, the undeformed volume's box, as well, so that what has left its place is gone from there.
///
/// # Errors
/// A placement that cannot be used: a singular matrix.
pub fn transform(transform: &Transform, scene_box: &Bounds, strength: f32, resolution: Option<usize>, storage: Storage) -> Result<ComposedMap> {
    let f = |p: Vec3| {
        let d = transform.source_from_deformed(p.as_dvec3()) - p.as_dvec3();
        (p + d.as_vec3() * strength, 1.0)
    };
    let many = |points: &[Vec3]| Ok(points.par_iter().map(|p| f(*p)).collect());
    let mapping = BackwardMap { source_and_alpha: &f, many: &many, scene_box: *scene_box };
    // Backwards through the chain: where the scene's matter can be seen.
    let mut bounds = *scene_box;
    for step in transform.steps.iter().rev() {
        bounds = before(step, &bounds, strength);
    }
    if !(bounds.min.is_finite() && bounds.max.is_finite()) {
        return Err(crate::Error::value(
            "progress",
            format!("{strength} of the way to this transform everything falls into a plane; choose another strength"),
        ));
    }
    let bounds = bounds.union(scene_box);
    let bounds = bounds.grown(0.01 * bounds.size().max_element());
    let placement = Placement::new(bounds.center(), bounds.size(), Vec3::ZERO)?;
    if transform.as_affine().is_some() {
        return sampled(&mapping, &placement, [2; 3], storage, PROBES);
    }
    let texels = resolution.unwrap_or_else(|| {
        let spacing = transform.grid().map_or(1.0, |g| {
            let m = g.world_from_voxel.matrix3;
            m.x_axis.length().min(m.y_axis.length()).min(m.z_axis.length())
        });
        (bounds.size().max_element() / spacing as f32).ceil() as usize + 1
    });
    search(&mapping, &placement, Resolution::Fixed(texels.clamp(8, 1024)), storage)
}

/// The placement whose unit cube spans the centres of a grid's outermost voxels.
///
/// # Errors
/// Singular axes.
pub fn placement_of(grid: &GridGeometry) -> Result<Placement> {
    // An axis of one voxel does not vary; its cube is one voxel thick.
    let extent = DVec3::from_array(grid.size.map(|n| n.saturating_sub(1).max(1) as f64));
    let first = DVec3::from_array(grid.size.map(|n| if n == 1 { -0.5 } else { 0.0 }));
    let world_from_map = grid.world_from_voxel * glam::DAffine3::from_translation(first) * glam::DAffine3::from_scale(extent);
    Placement::from_affine(to_f32(&world_from_map))
}

/// The grid whose outermost points lie on the faces of a placement's cube.
pub fn grid_of(placement: &Placement, size: [usize; 3]) -> GridGeometry {
    let step = Vec3::from(size.map(|n| 1.0 / n.saturating_sub(1).max(1) as f32));
    let first = Vec3::from(size.map(|n| if n == 1 { 0.5 } else { 0.0 }));
    let world_from_voxel = placement.world_from_map * Affine3A::from_translation(first) * Affine3A::from_scale(step);
    GridGeometry {
        size,
        world_from_voxel: glam::DAffine3 {
            matrix3: Mat3::from(world_from_voxel.matrix3).as_dmat3(),
            translation: Vec3::from(world_from_voxel.translation).as_dvec3(),
        },
    }
}

/// A vector field on its own grid as a map, its mask 0 where `occupied` is false.
pub fn sampled_grid(
    field: &super::transform::VectorField,
    occupied: Option<&[bool]>,
    placement: &Placement,
    storage: Storage,
    strength: f32,
) -> PlacedMap {
    let size = field.grid.size;
    let map_from_world = Mat3::from(placement.map_from_world.matrix3);
    let sample = |n: usize| TexelSample {
        displacement: map_from_world * flat(&field.vectors)[n] * strength,
        alpha: if occupied.is_none_or(|s| s[n]) { 1.0 } else { 0.0 },
    };
    let map = DisplacementMap::from_samples(size, storage, (0..field.vectors.len()).map(sample).collect());
    PlacedMap::new(Arc::new(map), *placement)
}
