//! Distances to a lasso's outline, sampled on a grid.

use crate::deform::kinds::outline::Outline;
use crate::math::trilinear;
use glam::Vec2;
use rayon::prelude::*;

/// Maximum number of points of a silhouette along an axis.
const MAX_OUTLINE_POINTS: usize = 512;

/// The bounding rectangle of points, enlarged by `margin`.
pub(super) fn box_of(points: impl Iterator<Item = Vec2>, margin: f32) -> (Vec2, Vec2) {
    let (low, high) = points.fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(low, high), p| {
        (low.min(p), high.max(p))
    });
    (low - margin, high + margin)
}

/// Distances to an outline on a grid of its plane: the outline may have thousands of points, and
/// the box millions.
pub(super) struct Silhouette {
    low: Vec2,
    step: f32,
    size: [usize; 2],
    /// Positive outside.
    pub(super) values: Vec<f32>,
}

impl Silhouette {
    pub(super) fn new(outline: &[Vec2], low: Vec2, high: Vec2, step: f32) -> Self {
        let extent = high - low;
        let step = step.max(extent.max_element() / (MAX_OUTLINE_POINTS - 1) as f32);
        let size = extent.to_array().map(|e| (e / step).ceil() as usize + 1);
        let place = |n: usize| low + Vec2::new((n % size[0]) as f32, (n / size[0]) as f32) * step;
        let outline = Outline::new(outline.to_vec());
        let values = (0..size[0] * size[1])
            .into_par_iter()
            .with_min_len(64)
            .map(|n| outline.signed_distance(place(n)))
            .collect();
        Self {
            low,
            step,
            size,
            values,
        }
    }

    /// The distance at a point; none outside the grid.
    pub(super) fn sample(&self, at: Vec2) -> Option<f32> {
        let p = (at - self.low) / self.step;
        let top = Vec2::new((self.size[0] - 1) as f32, (self.size[1] - 1) as f32);
        let inside = p.cmpge(Vec2::ZERO).all() && p.cmple(top).all();
        inside.then(|| trilinear(&self.values, [self.size[0], self.size[1], 1], p.extend(0.0)))
    }
}
