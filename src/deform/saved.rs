//! Displacement maps as files: NRRD with four components, the displacement (source minus deformed
//! point, LPS mm) and the mask, on the map's grid.
//!
//! Stored in millimetres rather than in map units, so that any program that reads vector NRRD can
//! show the field; the placement is restored from the geometry.

use super::compose::{grid_of, placement_of};
use super::{DisplacementMap, PlacedMap, Storage, TexelSample};
use crate::math::flat;
use crate::volume::GridGeometry;
use crate::volume::load::{self, ReadOptions};
use crate::volume::save::{self, Content, Format};
use crate::{Error, Result, Watch};
use glam::{Mat3, Vec3};
use std::path::Path;
use std::sync::Arc;

/// Reads a map, its displacement scaled by `strength`.
///
/// # Errors
/// A file that cannot be read or is not a displacement map.
pub fn read(path: &Path, storage: Storage, strength: f32) -> Result<PlacedMap> {
    let image = load::image(path, &ReadOptions::default(), &Watch::NONE)?;
    if !image.displacement || image.components != 4 {
        let problem = format!(
            "is not an incise displacement map (it has {} values per voxel); load another program's displacement field with --deform field:path=...",
            image.components
        );
        return Err(Error::file(path, problem));
    }
    let grid = GridGeometry {
        size: image.size,
        world_from_voxel: image.world_from_voxel,
    };
    if image.size.iter().product::<usize>() > super::compose::MAX_TEXELS {
        return Err(Error::file(
            path,
            format!(
                "has more than {} texels; make it with a lower resolution",
                super::compose::MAX_TEXELS
            ),
        ));
    }
    let placement = placement_of(&grid)?;
    let map_from_world = Mat3::from(placement.map_from_world.matrix3);
    let channels: [_; 4] = std::array::from_fn(|c| image.component(c));
    let [x, y, z, alpha] = std::array::from_fn(|c| flat(&channels[c]));
    let sample = |n: usize| TexelSample {
        displacement: map_from_world * Vec3::new(x[n], y[n], z[n]) * strength,
        // At strength 0 nothing is cut either.
        alpha: if strength > 0.0 { alpha[n] } else { 1.0 },
    };
    let map = DisplacementMap::from_samples(image.size, storage, (0..x.len()).map(sample).collect());
    Ok(PlacedMap::new(Arc::new(map), placement))
}

/// A map as the bytes of its file; one wrapped around an axis on a regular grid.
///
/// # Errors
/// Errors of the encoder.
pub fn encode(placed: &PlacedMap) -> Result<Vec<u8>> {
    let placed = &placed.on_regular_grid();
    let size = placed.map.size;
    let linear = Mat3::from(placed.placement.world_from_map.matrix3);
    let step = Vec3::from(size.map(|n| 1.0 / n.saturating_sub(1).max(1) as f32));
    let mut values = Vec::with_capacity(4 * size.iter().product::<usize>());
    for k in 0..size[2] {
        for j in 0..size[1] {
            for i in 0..size[0] {
                let t = placed.map.sample(Vec3::new(i as f32, j as f32, k as f32) * step);
                let world = linear * t.displacement;
                values.extend([world.x, world.y, world.z, t.alpha]);
            }
        }
    }
    save::encode(
        Format::Nrrd,
        &grid_of(&placed.placement, size),
        Content::Map,
        &values,
    )
}
