//! Implicit functions for surface rays: positive inside a solid, in millimetres, whatever their
//! source.

use super::depth_map::DepthMaps;
use super::formula::Formula;
use crate::math::{Bounds, DistanceGrid};
use glam::Vec3;
use std::sync::Arc;

/// An implicit solid.
#[derive(Clone, Debug)]
pub enum Implicit {
    /// A distance field on a grid.
    Grid(Arc<DistanceGrid>),
    /// Solids given by formulas.
    Formula(Formula),
    /// A depth map or a cube of six.
    Depth(Arc<DepthMaps>),
}

impl Implicit {
    /// f at a world point, mm.
    #[inline]
    pub fn value(&self, world: Vec3) -> f32 {
        match self {
            Self::Grid(g) => g.sample(world),
            Self::Formula(f) => f.distance(world),
            Self::Depth(d) => d.value(world),
        }
    }

    /// Gradient of f by central differences over `step_mm`.
    pub fn gradient(&self, world: Vec3, step_mm: f32) -> Vec3 {
        Vec3::from(Vec3::AXES.map(|e| self.value(world + e * step_mm) - self.value(world - e * step_mm)))
            / (2.0 * step_mm)
    }

    /// The bounding box of the solid, mm.
    pub fn bounds(&self) -> Bounds {
        match self {
            Self::Grid(g) => Bounds::new(Vec3::ZERO, Vec3::from(g.size.map(|n| (n - 1) as f32)))
                .transformed(&g.world_from_grid),
            Self::Formula(f) => f.bounds(),
            Self::Depth(d) => d.bounds,
        }
    }

    /// The resolution of f, mm, in which a ray's step is stated.
    pub fn cell_mm(&self) -> f32 {
        match self {
            Self::Grid(g) => g.spacing_mm(),
            Self::Formula(f) => {
                let feature =
                    f.0.iter()
                        .map(|s| s.solid.feature())
                        .fold(f32::INFINITY, f32::min);
                (f.bounds().size().max_element() / 128.0).min(feature / 4.0)
            }
            Self::Depth(d) => d.bounds.size().max_element() / d.size as f32,
        }
    }

    /// Whether |f| exceeds the distance to the surface by no more than the interpolation error, and
    /// can be used for skipping.
    pub fn is_distance(&self) -> bool {
        !matches!(self, Self::Depth(_))
    }

    /// Bytes on a GPU.
    pub fn gpu_bytes(&self) -> usize {
        match self {
            Self::Grid(g) => 2 * g.distance_mm.len(),
            Self::Formula(f) => 96 * f.0.len(),
            Self::Depth(d) => d.bytes(),
        }
    }
}
