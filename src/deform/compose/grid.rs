//! Grids over the cubes of maps, and mappings sampled at their points.

use crate::Result;
use crate::deform::transform::VectorField;
use crate::deform::{DisplacementMap, PlacedMap, Placement, Stack, Storage, TexelSample};
use crate::math::{Bounds, flat, to_f32};
use crate::volume::GridGeometry;
use glam::{Affine3A, DVec3, Mat3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Maximum number of texels of a map during the search for a sufficient resolution.
pub(super) const MAX_SEARCH_TEXELS: usize = 1 << 23;

/// The axis-aligned box around all cubes of a stack; none if the stack is empty.
pub(super) fn cubes(stack: &Stack) -> Option<Bounds> {
    stack
        .maps()
        .iter()
        .map(PlacedMap::bounds_in_world)
        .reduce(|a, b| a.union(&b))
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
    Ok(points
        .par_iter()
        .map(|p| stack.source_and_alpha_unclipped(*p))
        .collect())
}

/// Grid points of a box with `texels` of them along its longest axis.
pub(super) fn grid_for(size_mm: Vec3, texels: usize) -> [usize; 3] {
    let edge = size_mm.max_element() / (texels.max(2) - 1) as f32;
    size_mm
        .to_array()
        .map(|s| ((s / edge).round() as usize + 1).max(2))
}

/// The largest number of texels along the longest axis for which the grid has at most `most` in
/// all.
pub(super) fn finest(size_mm: Vec3, most: usize) -> usize {
    (2..=4096)
        .rev()
        .find(|&n| grid_for(size_mm, n).iter().product::<usize>() <= most)
        .unwrap_or(2)
}

/// The texels of a map in map coordinates, from the values of `many` at its grid points.
pub(super) fn grid_samples(
    placement: &Placement,
    size: [usize; 3],
    many: &dyn Fn(&[Vec3]) -> Result<SourcesAndAlphas>,
) -> Result<Vec<TexelSample>> {
    let map_from_world = Mat3::from(placement.map_from_world.matrix3);
    let points: Vec<Vec3> = (0..size.iter().product::<usize>())
        .into_par_iter()
        .map(|n| {
            placement
                .world_from_map
                .transform_point3(DisplacementMap::grid_point(size, n))
        })
        .collect();
    let texel = |((source, alpha), p): ((Vec3, f32), &Vec3)| TexelSample {
        displacement: map_from_world * (source - *p),
        alpha,
    };
    Ok(many(&points)?.into_par_iter().zip(&points).map(texel).collect())
}

/// The placement whose unit cube spans the centres of a grid's outermost voxels.
///
/// # Errors
/// Singular axes.
pub fn placement_of(grid: &GridGeometry) -> Result<Placement> {
    // An axis of one voxel does not vary; its cube is one voxel thick.
    let extent = DVec3::from_array(grid.size.map(|n| n.saturating_sub(1).max(1) as f64));
    let first = DVec3::from_array(grid.size.map(|n| if n == 1 { -0.5 } else { 0.0 }));
    let world_from_map =
        grid.world_from_voxel * glam::DAffine3::from_translation(first) * glam::DAffine3::from_scale(extent);
    Placement::from_affine(to_f32(&world_from_map))
}

/// The grid whose outermost points lie on the faces of a placement's cube.
pub fn grid_of(placement: &Placement, size: [usize; 3]) -> GridGeometry {
    let step = Vec3::from(size.map(|n| 1.0 / n.saturating_sub(1).max(1) as f32));
    let first = Vec3::from(size.map(|n| if n == 1 { 0.5 } else { 0.0 }));
    let world_from_voxel =
        placement.world_from_map * Affine3A::from_translation(first) * Affine3A::from_scale(step);
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
    field: &VectorField,
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
