//! A stack, or a transform from a file, as one displacement map: the cost of a sample no longer depends on how many there are.
//!
//! *Theory*: the composite is a map like any other, D(p') = source(p') - p' on a grid over every cube of the stack (\[DDM06\] section 6
//! names both ways). Interpolating it makes an error that shrinks with the square of the texel. The resolution is not guessed: a coarse map
//! is made, compared with the exact walk in the middles of its cells, and refined until the error is within the bound.
//!
//! Where the stack cuts, D only has to be continuous; cells that a cut crosses are left out of the comparison, because what is seen there
//! is decided by the mask. So are points whose source lies beyond the scene: a map that does not vanish on its faces tears there, in empty space.

use super::transform::{Step, Transform};
use super::{DisplacementMap, PlacedMap, Placement, Stack, Storage, TexelSample};
use crate::Result;
use crate::math::{Bounds, to_f32};
use crate::volume::GridGeometry;
use glam::{Affine3A, DVec3, Mat3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Most texels of a composed map: 256³, 128 MiB in half precision.
pub const MOST_TEXELS: usize = 1 << 24;
/// Texels along the longest axis that the search begins with.
const FIRST_RESOLUTION: usize = 32;

/// A composed map and how well it stands for what it was made from.
pub struct Composed {
    /// The map in its place.
    pub placed: PlacedMap,
    /// Largest error found in the middles of uncut cells, mm.
    pub worst_mm: f32,
    /// 99th percentile of the error, mm.
    pub p99_mm: f32,
}

/// How finely to compose.
#[derive(Clone, Copy, Debug)]
pub enum Resolution {
    /// Texels along the longest axis.
    Fixed(usize),
    /// As many as it takes for 99 % of the space to be this exact, mm.
    Within(f32),
}

/// The axis-aligned box of every cube of a stack; none if it is empty.
fn cubes(stack: &Stack) -> Option<Bounds> {
    stack.maps().iter().map(PlacedMap::bounds_in_world).reduce(|a, b| a.union(&b))
}

/// Source and smallest mask of each of many points.
pub type Sources = Vec<(Vec3, f32)>;

/// Evaluates a stack at many points. The CPU's own, or a device's.
pub type Evaluate<'a> = &'a dyn Fn(&Stack, &[Vec3]) -> Result<Sources>;

/// The stack at many points, on all cores.
///
/// # Errors
/// None.
pub fn evaluate(stack: &Stack, points: &[Vec3]) -> Result<Sources> {
    Ok(points.par_iter().map(|p| stack.walk_through(*p)).collect())
}

/// What is sampled: source and mask of a deformed point, and the box beyond which there is no matter.
struct Mapping<'a> {
    source_and_alpha: &'a (dyn Fn(Vec3) -> (Vec3, f32) + Sync),
    /// The same for all points of a grid at once.
    many: &'a dyn Fn(&[Vec3]) -> Result<Sources>,
    scene_box: Bounds,
}

/// Composes a stack into one map, exact where the source lies in `scene_box`; none if the stack is empty.
///
/// # Errors
/// A placement that cannot be used.
pub fn stack(stack: &Stack, scene_box: &Bounds, resolution: Resolution, storage: Storage, evaluate: Evaluate) -> Result<Option<Composed>> {
    let Some(bounds) = cubes(stack) else { return Ok(None) };
    let placement = Placement::new(bounds.center(), bounds.size(), Vec3::ZERO)?;
    let f = |p: Vec3| stack.walk_through(p);
    let many = |points: &[Vec3]| evaluate(stack, points);
    search(&Mapping { source_and_alpha: &f, many: &many, scene_box: *scene_box }, &placement, resolution, storage).map(Some)
}

/// Grid points for a box whose longest axis gets `texels`.
fn grid_for(size_mm: Vec3, texels: usize) -> [usize; 3] {
    let edge = size_mm.max_element() / (texels.max(2) - 1) as f32;
    size_mm.to_array().map(|s| ((s / edge).round() as usize + 1).max(2))
}

/// Samples `source_and_alpha` over a placement, finely enough.
fn search(mapping: &Mapping, placement: &Placement, resolution: Resolution, storage: Storage) -> Result<Composed> {
    let size_mm = placement.size_mm();
    let (mut texels, bound) = match resolution {
        Resolution::Fixed(n) => (n, f32::INFINITY),
        Resolution::Within(mm) => (FIRST_RESOLUTION, mm),
    };
    let fits = |texels: usize| grid_for(size_mm, texels).iter().product::<usize>() <= MOST_TEXELS;
    let finest = (2..=4096).rev().find(|&n| fits(n)).unwrap_or(2);
    texels = texels.min(finest);
    loop {
        let composed = sampled(mapping, placement, grid_for(size_mm, texels), storage)?;
        if composed.p99_mm <= bound || texels == finest {
            return Ok(composed);
        }
        // The error falls with the square of the texel, but not below what the storage rounds to.
        let needed = (texels as f32 * (composed.p99_mm / bound).sqrt() * 1.05) as usize;
        texels = needed.clamp(texels * 5 / 4, texels * 2).min(finest);
    }
}

/// The map of a mapping, with its error.
fn sampled(mapping: &Mapping, placement: &Placement, size: [usize; 3], storage: Storage) -> Result<Composed> {
    let map_from_world = Mat3::from(placement.map_from_world.matrix3);
    let points: Vec<Vec3> = (0..size.iter().product::<usize>())
        .into_par_iter()
        .map(|n| placement.world_from_map.transform_point3(DisplacementMap::grid_point(size, n)))
        .collect();
    let samples = (mapping.many)(&points)?
        .into_par_iter()
        .zip(&points)
        .map(|((source, alpha), p)| TexelSample { displacement: map_from_world * (source - *p), alpha })
        .collect();
    let map = DisplacementMap::from_samples(size, storage, samples);
    let placed = PlacedMap::new(Arc::new(map), *placement);
    let (worst_mm, p99_mm) = error(mapping, &placed);
    Ok(Composed { placed, worst_mm, p99_mm })
}

/// Largest error and 99th percentile in the middles of cells that no cut crosses, mm.
fn error(mapping: &Mapping, placed: &PlacedMap) -> (f32, f32) {
    let size = placed.map.size;
    let cells = size.map(|n| n.saturating_sub(1).max(1));
    let count = cells[0] * cells[1] * cells[2];
    // A quarter of a million cells tell as much as all.
    let stride = (count / 250_000).max(1) | 1;
    let cell = Vec3::from(cells.map(|n| 1.0 / n as f32));
    // `many` may hold a device, which is not shared between threads.
    let (source_and_alpha, scene_box) = (mapping.source_and_alpha, mapping.scene_box);
    let mut errors: Vec<f32> = (0..count)
        .into_par_iter()
        .step_by(stride)
        .filter_map(|n| {
            let at = Vec3::new((n % cells[0]) as f32, (n / cells[0] % cells[1]) as f32, (n / (cells[0] * cells[1])) as f32);
            let low = at * cell;
            let whole = placed.map.bounds(low, low + cell * 0.999);
            if whole.min[3] < 0.5 {
                return None;
            }
            let p = placed.placement.world_from_map.transform_point3(low + cell * 0.5);
            let (source, alpha) = source_and_alpha(p);
            let seen = alpha >= 0.5 && scene_box.contains(&Bounds::new(source, source));
            seen.then(|| placed.backward(p).0.distance(source))
        })
        .collect();
    if errors.is_empty() {
        return (0.0, 0.0);
    }
    let rank = (errors.len() * 99 / 100).min(errors.len() - 1);
    let (_, p99, above) = errors.select_nth_unstable_by(rank, f32::total_cmp);
    let p99 = *p99;
    (above.iter().fold(p99, |a, b| a.max(*b)), p99)
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
    let fits = |g: &GridGeometry| g.size.iter().product::<usize>() <= MOST_TEXELS;
    let all_fit = transform.steps.iter().all(|s| match s {
        Step::Affine(_) => true,
        Step::Field(f) => fits(&f.grid),
        Step::BSpline(b) => fits(&b.fine_grid()),
    });
    if resolution.is_some() || !(single || strength == 1.0) || !all_fit {
        return Ok(vec![self::transform(transform, scene_box, strength, resolution, storage)?.placed]);
    }
    // Each step's map reaches over all that the steps after it leave of the scene.
    let mut bounds = *scene_box;
    let mut maps = Vec::with_capacity(transform.steps.len());
    for step in transform.steps.iter().rev() {
        maps.push(match step {
            Step::Field(f) => {
                let placement = placement_of(&f.grid)?;
                let mut placed = sampled_grid(f, None, &placement, storage, strength);
                placed.reach = Vec3::from(f.grid.size.map(|n| if n > 1 { 0.5 / (n - 1) as f32 } else { 0.0 }));
                placed
            }
            Step::BSpline(b) => {
                let grid = b.fine_grid();
                let sampled = super::transform::VectorField::sampled(grid, |p| b.source_from_deformed(p));
                sampled_grid(&sampled, None, &placement_of(&grid)?, storage, strength)
            }
            Step::Affine(m) => self::transform(&Transform::affine(*m), &bounds, strength, None, storage)?.placed,
        });
        bounds = bounds.union(&before(step, &bounds, strength));
    }
    Ok(maps)
}

/// The box in which matter of a box can be seen before a step of a chain.
fn before(step: &Step, bounds: &Bounds, strength: f32) -> Bounds {
    match step {
        Step::Affine(m) => {
            // Part of the way to an affine is one of its own, whose inverse may reach further than the whole's.
            let t = f64::from(strength);
            let part = glam::DAffine3 { matrix3: glam::DMat3::IDENTITY * (1.0 - t) + m.matrix3 * t, translation: m.translation * t };
            bounds.transformed(&to_f32(&part.inverse()))
        }
        Step::Field(v) => bounds.grown(v.vectors.par_iter().map(|d| d.length()).reduce(|| 0.0, f32::max)),
        Step::BSpline(b) => bounds.grown(b.coefficients.iter().map(|d| d.length()).fold(0.0, f32::max)),
    }
}

/// A transform as one map over a scene, sampled as finely as its finest grid; an affine needs eight texels.
///
/// The map reaches over `scene_box`, the undeformed volume's box, as well, so that what has left its place is gone from there.
///
/// # Errors
/// A placement that cannot be used: a singular matrix.
pub fn transform(transform: &Transform, scene_box: &Bounds, strength: f32, resolution: Option<usize>, storage: Storage) -> Result<Composed> {
    let f = |p: Vec3| {
        let d = transform.source_from_deformed(p.as_dvec3()) - p.as_dvec3();
        (p + d.as_vec3() * strength, 1.0)
    };
    let many = |points: &[Vec3]| Ok(points.par_iter().map(|p| f(*p)).collect());
    let mapping = Mapping { source_and_alpha: &f, many: &many, scene_box: *scene_box };
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
        return sampled(&mapping, &placement, [2; 3], storage);
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

/// A vector field on its own grid as a map, its mask 0 where `seen` is false.
pub fn sampled_grid(
    field: &super::transform::VectorField,
    seen: Option<&[bool]>,
    placement: &Placement,
    storage: Storage,
    strength: f32,
) -> PlacedMap {
    let size = field.grid.size;
    let map_from_world = Mat3::from(placement.map_from_world.matrix3);
    let sample = |n: usize| TexelSample {
        displacement: map_from_world * field.vectors[n] * strength,
        alpha: if seen.is_none_or(|s| s[n]) { 1.0 } else { 0.0 },
    };
    let map = DisplacementMap::from_samples(size, storage, (0..field.vectors.len()).map(sample).collect());
    PlacedMap::new(Arc::new(map), *placement)
}
