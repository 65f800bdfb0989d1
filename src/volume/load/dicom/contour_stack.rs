//! Contours of one structure in parallel planes: which planes determine a slice between them, and
//! the interpolation at any point.

use super::contour_plane::{ContourPlane, Window};
use glam::{DAffine3, DMat2, DVec2, DVec3, Vec3Swizzles};
use rayon::prelude::*;

/// Contours closer than this are in the same plane, in slices; or in millimetres, if that is more.
const SAME_PLANE: f64 = 0.02;
const SAME_PLANE_MM: f64 = 0.01;
/// Largest distance of contours in the same plane, in slices.
const MAX_SAME_PLANE: f64 = 0.25;
/// A slice this close to a plane of contours is in it; and the extent of planes includes its lower
/// end, but not its upper one, up to rounding.
const IN_PLANE: f64 = 0.01;
const ROUNDING: f64 = 1e-6;

/// Contours in parallel planes.
pub struct Stack {
    /// From voxels to the stack's frame: pixels in its planes, and planes in slices along z.
    pub frame_from_voxel: DAffine3,
    /// Millimetres from pixels, within a plane.
    pub mm_from_pixel: DMat2,
    /// Positions of the planes, sorted, and their contours.
    pub at: Vec<f64>,
    pub planes: Vec<ContourPlane>,
}

/// Which planes determine a slice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Section {
    /// One plane.
    In(usize),
    /// A plane and the next one, and the position between them.
    Between(usize, f64),
    /// None.
    Outside,
}

/// The distance of planes, in slices, and how large a gap between two of them is bridged.
#[derive(Clone, Copy)]
pub struct Spacing {
    usual: f64,
    bridge: f64,
}

impl Stack {
    /// Sorts contours, given in the stack's frame, into planes by their mean position along z; a
    /// plane starts at its first contour. `slice_mm` is the length of z.
    pub fn new(
        contours: Vec<Vec<DVec3>>,
        frame_from_voxel: DAffine3,
        mm_from_pixel: DMat2,
        slice_mm: f64,
    ) -> Self {
        let same_plane = SAME_PLANE.max(SAME_PLANE_MM / slice_mm).min(MAX_SAME_PLANE);
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
        Self {
            frame_from_voxel,
            mm_from_pixel,
            at,
            planes,
        }
    }

    /// Whether the frame is that of the voxels.
    pub fn is_aligned(&self) -> bool {
        self.frame_from_voxel == DAffine3::IDENTITY
    }

    /// The lower median of the distances between planes.
    pub fn median_gap(&self) -> Option<f64> {
        let mut gaps: Vec<f64> = self.at.windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        gaps.get(gaps.len().saturating_sub(1) / 2).copied()
    }

    /// The spacing of the planes. `of_all` is that of all structures, for the few planes of one
    /// that has no usual distance of its own.
    pub fn spacing(&self, of_all: Option<f64>) -> Spacing {
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

    pub fn section(&self, at: f64, spacing: Spacing) -> Section {
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
    pub fn has_gap(&self, spacing: Spacing) -> bool {
        self.at.windows(2).any(|w| w[1] - w[0] > spacing.bridge)
    }

    /// Whether slices between contours are interpolated from them.
    pub fn skips_slices(&self, spacing: Spacing) -> bool {
        let bridged = |gap: f64| gap > 1.5 && gap <= spacing.bridge;
        self.is_aligned() && self.at.windows(2).any(|w| bridged(w[1] - w[0]))
    }

    /// The stack's extent in its frame, with the ends of the outermost planes.
    pub fn bounds(&self, spacing: Spacing) -> [DVec3; 2] {
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

/// The signed distances of all planes of an oblique stack, on a raster of its own.
pub struct Raster {
    origin: DVec2,
    width: usize,
    height: usize,
    distances: Vec<Vec<f32>>,
}

impl Stack {
    /// Number of pixels of all planes, with a margin.
    pub fn distances(&self) -> usize {
        let [low, high] = self.bounds(Spacing {
            usual: 0.0,
            bridge: 0.0,
        });
        let extent = (high - low).xy().ceil() + 4.0;
        (extent.x * extent.y * self.planes.len() as f64).min(usize::MAX as f64) as usize
    }
}

impl Raster {
    pub fn new(stack: &Stack) -> Self {
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

    pub fn contains(&self, p: DVec2, section: Section) -> bool {
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
