//! Composes a stack, or a transform from a file, into one displacement map. Where the composite is
//! accurate enough, a sample costs the same however many maps there are.
//!
//! *Theory*: the composite is a map like any other, D(p') = source(p') - p' on a grid over all
//! cubes of the stack (\[DDM06\] section 6 names both ways). Its interpolation error shrinks with
//! the square of the texel size where the stack is smooth, linearly with it where the stack has a
//! kink, and not at all where the stack tears. The resolution is found by refinement: a coarse map
//! is made, compared with the exact walk, and refined until the worst error inside the volume is
//! within the bound. Most stacks tear, at the faces of boxes that material enters. Hence the
//! precomposed map used for pictures ([`precompose`]) marks the cells in which it is not accurate
//! enough, and there the maps themselves are walked.
//!
//! *The error* at a point is the distance between the two sources where both are present, and the
//! distance to the cut where only one is. Points whose source lies outside the scene do not count.

use super::transform::{Transform, TransformStep};
use super::{DisplacementMap, PlacedMap, Placement, PrecomposedMap, Stack, Storage, TexelSample};
use crate::math::flat;
use crate::math::{Bounds, to_f32};
use crate::volume::GridGeometry;
use crate::{Result, Watch};
use glam::{Affine3A, DVec3, Mat3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Maximum number of texels of a composed map: 256³, 128 MiB in half precision.
pub const MAX_TEXELS: usize = 1 << 24;
/// Texels along the longest axis at the start of the search.
const FIRST_RESOLUTION: usize = 32;

/// Maximum number of texels of a map during the search for a sufficient resolution.
const MAX_SEARCH_TEXELS: usize = 1 << 23;
/// Points at which a composed map is compared with its original, during refinement and at the end.
const PROBES: usize = 100_000;
const LAST_PROBES: usize = 600_000;
/// Fraction of the bound that the error at the compared points may use: between them it may be
/// larger.
const OF_BOUND: f32 = 0.6;
/// Texels along the longest axis of a precomposed map; the next size is tried where one marks too
/// many cells.
const PRECOMPOSED_TEXELS: [usize; 4] = [48, 80, 128, 192];
/// Points compared in the cells of one such map.
const CELL_PROBES: usize = 1_000_000;
/// Fraction of the space that may be marked: below it a finer map does not pay.
const FEW_MARKED: f32 = 0.12;
/// Fraction of the maps' work that a precomposed map must save, and fraction of the space that may
/// be marked however many maps there are.
const MIN_SAVED: f32 = 0.2;
const MAX_MARKED: f32 = 0.6;
/// Number of points per cell at which Jacobians are compared, and the largest allowed difference of
/// their components: normals turn by about as much, radians.
const SLOPE_PROBES: usize = 2;
const MAX_SLOPE_ERROR: f32 = 0.05;
/// Points after which a map that is far too coarse is rejected.
const SOME_CELLS: usize = 10_000;
/// Rounds of the final comparison, each of which marks the points it finds.
const LAST_ROUNDS: usize = 4;
/// If a map twice as fine is not this much better, no map will be good enough: the stack tears
/// there.
const MIN_GAIN: f32 = 0.8;

/// A composed map and its accuracy.
pub struct ComposedMap {
    /// The map with its placement.
    pub placed: PlacedMap,
    /// Largest error found inside the volume, mm.
    pub worst_mm: f32,
    /// 99th percentile of the error, mm.
    pub p99_mm: f32,
    /// Whether the worst error is within the bound.
    pub within: bool,
}

/// The resolution of a composed map.
#[derive(Clone, Copy, Debug)]
pub enum Resolution {
    /// Texels along the longest axis.
    Fixed(usize),
    /// As many as needed for this worst error inside the volume, mm.
    Within(f32),
}

/// The accuracy of a precomposed map.
#[derive(Clone, Copy, Debug)]
pub struct PrecomposeError {
    /// Largest error found inside the volume, mm.
    pub worst_mm: f32,
    /// 99th percentile of the error, mm.
    pub p99_mm: f32,
    /// Fraction of the occupied space in which the maps themselves are walked.
    pub fallback_share: f32,
}

/// The axis-aligned box around all cubes of a stack; none if the stack is empty.
fn cubes(stack: &Stack) -> Option<Bounds> {
    stack.maps().iter().map(PlacedMap::bounds_in_world).reduce(|a, b| a.union(&b))
}

/// Source and smallest mask of each of many points.
pub type SourcesAndAlphas = Vec<(Vec3, f32)>;

/// Evaluates a stack at many points, on the CPU or on a device.
pub type Evaluate<'a> = &'a dyn Fn(&Stack, &[Vec3]) -> Result<SourcesAndAlphas>;

/// Evaluates a stack at many points, on all cores.
///
/// # Errors
/// None.
pub fn evaluate(stack: &Stack, points: &[Vec3]) -> Result<SourcesAndAlphas> {
    Ok(points.par_iter().map(|p| stack.source_and_alpha_unclipped(*p)).collect())
}

/// The mapping to sample: source and mask of a deformed point, and the box outside which the scene
/// is empty.
struct BackwardMap<'a> {
    source_and_alpha: &'a (dyn Fn(Vec3) -> (Vec3, f32) + Sync),
    /// The same for all points of a grid at once.
    many: &'a dyn Fn(&[Vec3]) -> Result<SourcesAndAlphas>,
    scene_box: Bounds,
}

/// Composes a stack into one map; none if the stack is empty.
///
/// # Errors
/// A placement that is not invertible.
pub fn stack(stack: &Stack, scene_box: &Bounds, resolution: Resolution, storage: Storage, evaluate: Evaluate) -> Result<Option<ComposedMap>> {
    let Some(bounds) = cubes(stack) else { return Ok(None) };
    let placement = Placement::new(bounds.center(), bounds.size(), Vec3::ZERO)?;
    let f = |p: Vec3| stack.source_and_alpha_unclipped(p);
    let many = |points: &[Vec3]| evaluate(stack, points);
    search(&BackwardMap { source_and_alpha: &f, many: &many, scene_box: *scene_box }, &placement, resolution, storage).map(Some)
}

/// One map that replaces a stack within `bound_mm` everywhere inside the volume, and marks where it
/// cannot: cells that a tear or a cut runs through, or in which the stack bends more than the grid
/// resolves. None, with the fraction that would have to be marked, where that saves too little.
///
/// # Errors
/// A placement that is not invertible; any error of the device; [`crate::Error::Cancelled`].
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
    // Every sample costs one map; a sample in a marked cell also costs all the others.
    let max_marked = (1.0 - MIN_SAVED - 1.0 / stack.maps().len() as f32).min(MAX_MARKED);
    let mut best: Option<MarkedGrid> = None;
    for texels in PRECOMPOSED_TEXELS.map(|n| n.min(finest)) {
        watch.check()?;
        if best.as_ref().is_some_and(|b| b.size == grid_for(size_mm, texels)) {
            break;
        }
        let mut grid = MarkedGrid::new(stack, &placement, grid_for(size_mm, texels), bound_mm, evaluate)?;
        // Far too coarse: not worth testing every cell.
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
    // A final comparison at many other points; the cells of those with too large an error are
    // marked as well.
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

/// Whether two Jacobians lead to visibly different lighting.
fn differs(a: &Mat3, b: &Mat3) -> bool {
    (*a - *b).to_cols_array().iter().any(|v| v.abs() > MAX_SLOPE_ERROR)
}

/// A composite under construction: samples, and the cells between them that are not accurate
/// enough.
struct MarkedGrid {
    size: [usize; 3],
    placement: Placement,
    storage: Storage,
    samples: Vec<TexelSample>,
    bad: Vec<bool>,
    /// Cells in which some point is present.
    occupied: Vec<bool>,
}

impl MarkedGrid {
    fn new(stack: &Stack, placement: &Placement, size: [usize; 3], bound_mm: f32, evaluate: Evaluate) -> Result<Self> {
        let samples = grid_samples(placement, size, &|points| evaluate(stack, points))?;
        // The rounding of half precision must be negligible.
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

    /// Fraction of the occupied cells that are bad.
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

    /// Fraction of bad cells, estimated from some of the occupied ones.
    fn bad_share_of_some(&self, comparison: &Comparison, bound_mm: f32) -> f32 {
        let placed = self.placed();
        let errors = comparison.errors(&|p| placed.backward(*p), &placed.bounds_in_world(), SOME_CELLS, 0.25 * self.texel_mm());
        errors.iter().filter(|(e, _)| *e > OF_BOUND * bound_mm).count() as f32 / errors.len().max(1) as f32
    }

    /// Finds the cells in which the composite is not accurate enough, and their neighbours: a tear
    /// may graze a cell without meeting a point that is compared.
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
                    // A kink affects lighting long before it visibly affects positions.
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

    /// The cells and their neighbours.
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

    /// The map with the texels at the corners of bad cells marked.
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

/// Grid points of a box with `texels` of them along its longest axis.
fn grid_for(size_mm: Vec3, texels: usize) -> [usize; 3] {
    let edge = size_mm.max_element() / (texels.max(2) - 1) as f32;
    size_mm.to_array().map(|s| ((s / edge).round() as usize + 1).max(2))
}

/// Samples a mapping over a placement at a sufficient resolution.
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
            // The points may have missed the worst position: many more are compared at the end.
            let (worst_mm, p99_mm) = error(mapping, &composed.placed, LAST_PROBES);
            (composed.worst_mm, composed.p99_mm) = (composed.worst_mm.max(worst_mm), p99_mm);
            if composed.worst_mm <= bound {
                return Ok(ComposedMap { within: true, ..composed });
            }
        }
        // A finer grid does not reduce the rounding of half precision.
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
        // Proportional to the square root of the error, if everything is smooth.
        let needed = (texels as f32 * (composed.worst_mm / (OF_BOUND * bound)).sqrt() * 1.1) as usize;
        texels = needed.clamp(texels * 5 / 4, texels * 2).min(finest);
        composed = sampled(mapping, placement, grid_for(size_mm, texels), storage, PROBES)?;
        let finer = texels as f32 / before.1 as f32;
        let expected = before.0 * MIN_GAIN.powf(finer.log2());
        in_vain = if composed.worst_mm > expected { in_vain + 1 } else { 0 };
    }
}

/// The largest number of texels along the longest axis for which the grid has at most `most` in
/// all.
fn finest(size_mm: Vec3, most: usize) -> usize {
    (2..=4096).rev().find(|&n| grid_for(size_mm, n).iter().product::<usize>() <= most).unwrap_or(2)
}

/// The texels of a map in map coordinates, from the values of `many` at its grid points.
fn grid_samples(placement: &Placement, size: [usize; 3], many: &dyn Fn(&[Vec3]) -> Result<SourcesAndAlphas>) -> Result<Vec<TexelSample>> {
    let map_from_world = Mat3::from(placement.map_from_world.matrix3);
    let points: Vec<Vec3> = (0..size.iter().product::<usize>())
        .into_par_iter()
        .map(|n| placement.world_from_map.transform_point3(DisplacementMap::grid_point(size, n)))
        .collect();
    let texel = |((source, alpha), p): ((Vec3, f32), &Vec3)| TexelSample { displacement: map_from_world * (source - *p), alpha };
    Ok(many(&points)?.into_par_iter().zip(&points).map(texel).collect())
}

/// The map of a mapping, with its error at `probes` points.
fn sampled(mapping: &BackwardMap, placement: &Placement, size: [usize; 3], storage: Storage, probes: usize) -> Result<ComposedMap> {
    let map = DisplacementMap::from_samples(size, storage, grid_samples(placement, size, mapping.many)?);
    let placed = PlacedMap::new(Arc::new(map), *placement);
    let (worst_mm, p99_mm) = error(mapping, &placed, probes);
    Ok(ComposedMap { placed, worst_mm, p99_mm, within: false })
}

/// Largest error and 99th percentile of a map inside the volume, mm.
fn error(mapping: &BackwardMap, placed: &PlacedMap, probes: usize) -> (f32, f32) {
    let (exact, composed) = (|p: &Vec3| (mapping.source_and_alpha)(*p), |p: &Vec3| placed.backward(*p));
    let size = placed.map.size;
    let texel = (placed.placement.size_mm() / Vec3::from(size.map(|n| n.max(2) as f32 - 1.0))).max_element();
    let comparison = Comparison { exact: &exact, scene_box: &mapping.scene_box };
    let errors = comparison.errors(&composed, &placed.bounds_in_world(), probes, 0.25 * texel);
    worst_and_p99(errors.into_iter().map(|(e, _)| e).collect())
}

/// Points spread over the unit cube: multiples of the powers of the plastic number, to avoid
/// hitting the cells of a map's grid at the same position repeatedly.
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

/// A mapping. It takes a reference: where two closures take the same point by value, Rust 1.95
/// passes to the second one the value as modified by the first (rust-lang/rust#155241).
type Map<'a> = dyn Fn(&Vec3) -> (Vec3, f32) + Sync + 'a;

/// Compares the sources and masks of one mapping with those of another.
struct Comparison<'a> {
    exact: &'a Map<'a>,
    scene_box: &'a Bounds,
}

impl Comparison<'_> {
    /// The error of a mapping at a point, mm; none where both are empty. The mask's slope is
    /// measured over `h` mm.
    fn error(&self, composed: &Map, p: Vec3, h: f32) -> Option<f32> {
        let holds = |p: Vec3| self.scene_box.contains(&Bounds::new(p, p));
        let ((source, alpha), (found, found_alpha)) = ((self.exact)(&p), composed(&p));
        let (shows, found_shows) = (alpha >= 0.5 && holds(source), found_alpha >= 0.5 && holds(found));
        match (alpha >= 0.5, found_alpha >= 0.5) {
            _ if !shows && !found_shows => None,
            (true, true) => Some(source.distance(found)),
            // Distance to the cut that only one of them has.
            _ => {
                let mask = |p: Vec3| (self.exact)(&p).1;
                let slope = Vec3::from(Vec3::AXES.map(|e| mask(p + e * h) - mask(p - e * h))).length() / (2.0 * h);
                Some((alpha - 0.5).abs() / slope.max(1e-6))
            }
        }
    }

    /// The errors at points spread over a box, and those points.
    fn errors(&self, composed: &Map, over: &Bounds, probes: usize, h: f32) -> Vec<(f32, Vec3)> {
        let of_point = |n: usize| {
            let p = over.min + spread(n) * over.size();
            self.error(composed, p, h).map(|e| (e, p))
        };
        (0..probes).into_par_iter().with_min_len(1024).filter_map(of_point).collect()
    }
}

/// A transform as the maps of a stack, in order of application: a field keeps its own grid, an
/// affine needs eight texels, B-splines are sampled at least four times per control point. (A
/// deformed point passes a stack's last map first.)
///
/// Where that is not possible (a field with too many points, a progress other than 1 of several
/// steps, an explicit resolution) the whole is sampled into one map ([`transform`]).
///
/// # Errors
/// A placement that is not invertible: a singular matrix.
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
    // Each step's map covers everything that the remaining steps carry into the scene.
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

/// The box, before a step of a chain, in which the contents of a box can appear.
fn before(step: &TransformStep, bounds: &Bounds, strength: f32) -> Bounds {
    match step {
        TransformStep::Affine(m) => {
            // A partial step towards an affine is itself an affine, whose inverse may reach further
            // than that of the full step.
            let t = f64::from(strength);
            let part = glam::DAffine3 { matrix3: glam::DMat3::IDENTITY * (1.0 - t) + m.matrix3 * t, translation: m.translation * t };
            bounds.transformed(&to_f32(&part.inverse()))
        }
        TransformStep::Field(v) => bounds.grown(v.vectors.par_iter().map(|d| d.length()).reduce(|| 0.0, f32::max)),
        TransformStep::BSpline(b) => bounds.grown(b.coefficients.iter().map(|d| d.length()).fold(0.0, f32::max)),
    }
}

/// A transform as one map over a scene, sampled at the spacing of its finest grid; an affine needs
/// eight texels.
///
/// The map also covers `scene_box`, the undeformed volume's box, so that displaced material does
/// not remain at its original position.
///
/// # Errors
/// A placement that is not invertible: a singular matrix.
pub fn transform(transform: &Transform, scene_box: &Bounds, strength: f32, resolution: Option<usize>, storage: Storage) -> Result<ComposedMap> {
    let f = |p: Vec3| {
        let d = transform.source_from_deformed(p.as_dvec3()) - p.as_dvec3();
        (p + d.as_vec3() * strength, 1.0)
    };
    let many = |points: &[Vec3]| Ok(points.par_iter().map(|p| f(*p)).collect());
    let mapping = BackwardMap { source_and_alpha: &f, many: &many, scene_box: *scene_box };
    // Backwards through the chain: where the scene's contents can appear.
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

/// A vector field on its own grid as a map; its mask is 0 where `occupied` is false.
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
