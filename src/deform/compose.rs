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

mod comparison;
mod grid;
mod marked;

pub use grid::{Evaluate, SourcesAndAlphas, evaluate, grid_of, placement_of, sampled_grid};
pub use marked::{PrecomposeError, precompose};

use super::transform::{Transform, TransformStep};
use super::{DisplacementMap, PlacedMap, Placement, Stack, Storage};
use crate::Result;
use crate::math::{Bounds, to_f32};
use crate::volume::GridGeometry;
use comparison::{Comparison, LAST_PROBES, MIN_GAIN, OF_BOUND, PROBES, worst_and_p99};
use glam::Vec3;
use grid::{MAX_SEARCH_TEXELS, cubes, finest, grid_for, grid_samples};
use rayon::prelude::*;
use std::sync::Arc;

/// Maximum number of texels of a composed map: 256³, 128 MiB in half precision.
pub const MAX_TEXELS: usize = 1 << 24;
/// Texels along the longest axis at the start of the search.
const FIRST_RESOLUTION: usize = 32;

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
pub fn stack(
    stack: &Stack,
    scene_box: &Bounds,
    resolution: Resolution,
    storage: Storage,
    evaluate: Evaluate,
) -> Result<Option<ComposedMap>> {
    let Some(bounds) = cubes(stack) else {
        return Ok(None);
    };
    let placement = Placement::new(bounds.center(), bounds.size(), Vec3::ZERO)?;
    let f = |p: Vec3| stack.source_and_alpha_unclipped(p);
    let many = |points: &[Vec3]| evaluate(stack, points);
    search(
        &BackwardMap {
            source_and_alpha: &f,
            many: &many,
            scene_box: *scene_box,
        },
        &placement,
        resolution,
        storage,
    )
    .map(Some)
}

/// Samples a mapping over a placement at a sufficient resolution.
fn search(
    mapping: &BackwardMap,
    placement: &Placement,
    resolution: Resolution,
    storage: Storage,
) -> Result<ComposedMap> {
    let size_mm = placement.size_mm();
    let bound = match resolution {
        Resolution::Fixed(n) => {
            let finest = finest(size_mm, MAX_TEXELS);
            let mut composed = sampled(
                mapping,
                placement,
                grid_for(size_mm, n.min(finest)),
                storage,
                LAST_PROBES,
            )?;
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
                return Ok(ComposedMap {
                    within: true,
                    ..composed
                });
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
        in_vain = if composed.worst_mm > expected {
            in_vain + 1
        } else {
            0
        };
    }
}

/// The map of a mapping, with its error at `probes` points.
fn sampled(
    mapping: &BackwardMap,
    placement: &Placement,
    size: [usize; 3],
    storage: Storage,
    probes: usize,
) -> Result<ComposedMap> {
    let map = DisplacementMap::from_samples(size, storage, grid_samples(placement, size, mapping.many)?);
    let placed = PlacedMap::new(Arc::new(map), *placement);
    let (worst_mm, p99_mm) = error(mapping, &placed, probes);
    Ok(ComposedMap {
        placed,
        worst_mm,
        p99_mm,
        within: false,
    })
}

/// Largest error and 99th percentile of a map inside the volume, mm.
fn error(mapping: &BackwardMap, placed: &PlacedMap, probes: usize) -> (f32, f32) {
    let (exact, composed) = (
        |p: &Vec3| (mapping.source_and_alpha)(*p),
        |p: &Vec3| placed.backward(*p),
    );
    let size = placed.map.size;
    let texel = (placed.placement.size_mm() / Vec3::from(size.map(|n| n.max(2) as f32 - 1.0))).max_element();
    let comparison = Comparison {
        exact: &exact,
        scene_box: &mapping.scene_box,
    };
    let errors = comparison.errors(&composed, &placed.bounds_in_world(), probes, 0.25 * texel);
    worst_and_p99(errors.into_iter().map(|(e, _)| e).collect())
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
        return Ok(vec![
            self::transform(transform, scene_box, strength, resolution, storage)?.placed,
        ]);
    }
    // Each step's map covers everything that the remaining steps carry into the scene.
    let mut bounds = *scene_box;
    let mut maps = Vec::with_capacity(transform.steps.len());
    for step in transform.steps.iter().rev() {
        maps.push(match step {
            TransformStep::Field(f) => {
                let placement = placement_of(&f.grid)?;
                let mut placed = sampled_grid(f, None, &placement, storage, strength);
                placed.reach = Vec3::from(
                    f.grid
                        .size
                        .map(|n| if n > 1 { 0.5 / (n - 1) as f32 } else { 0.0 }),
                );
                placed
            }
            TransformStep::BSpline(b) => {
                let grid = b.fine_grid();
                let sampled = super::transform::VectorField::sampled(grid, |p| b.source_from_deformed(p));
                sampled_grid(&sampled, None, &placement_of(&grid)?, storage, strength)
            }
            TransformStep::Affine(m) => {
                self::transform(&Transform::affine(*m), &bounds, strength, None, storage)?.placed
            }
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
            let part = glam::DAffine3 {
                matrix3: glam::DMat3::IDENTITY * (1.0 - t) + m.matrix3 * t,
                translation: m.translation * t,
            };
            bounds.transformed(&to_f32(&part.inverse()))
        }
        TransformStep::Field(v) => {
            bounds.grown(v.vectors.par_iter().map(|d| d.length()).reduce(|| 0.0, f32::max))
        }
        TransformStep::BSpline(b) => {
            bounds.grown(b.coefficients.iter().map(|d| d.length()).fold(0.0, f32::max))
        }
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
pub fn transform(
    transform: &Transform,
    scene_box: &Bounds,
    strength: f32,
    resolution: Option<usize>,
    storage: Storage,
) -> Result<ComposedMap> {
    let f = |p: Vec3| {
        let d = transform.source_from_deformed(p.as_dvec3()) - p.as_dvec3();
        (p + d.as_vec3() * strength, 1.0)
    };
    let many = |points: &[Vec3]| Ok(points.par_iter().map(|p| f(*p)).collect());
    let mapping = BackwardMap {
        source_and_alpha: &f,
        many: &many,
        scene_box: *scene_box,
    };
    // Backwards through the chain: where the scene's contents can appear.
    let mut bounds = *scene_box;
    for step in transform.steps.iter().rev() {
        bounds = before(step, &bounds, strength);
    }
    if !(bounds.min.is_finite() && bounds.max.is_finite()) {
        return Err(crate::Error::value(
            "progress",
            format!(
                "{strength} of the way to this transform everything falls into a plane; choose another strength"
            ),
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
    search(
        &mapping,
        &placement,
        Resolution::Fixed(texels.clamp(8, 1024)),
        storage,
    )
}
