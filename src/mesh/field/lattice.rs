//! The settings of a mesh's field, and the lattice on which it is sampled.

use crate::math::Bounds;
use glam::{Affine3A, Vec3};

/// Half width of the narrow band of exact distances, cells.
pub(super) const BAND: f32 = 2.5;
/// Cells left free around the mesh on every side.
pub const MARGIN: f32 = 3.0;
/// Maximum number of points of a field.
pub const MAX_POINTS: usize = 1 << 29;

/// The settings of a mesh's field.
#[derive(Clone, Copy, Debug)]
pub struct FieldSettings {
    /// Points along the longest axis; `cell_mm` takes precedence.
    pub resolution: usize,
    /// Distance between points, mm.
    pub cell_mm: Option<f32>,
    /// Restricts the field to this region (\[DS07\] section 3), mm.
    pub region: Option<Bounds>,
    /// Exact distances everywhere, not only in the band.
    pub exact: bool,
    /// Inside is where a line has crossed the mesh an odd number of times: for closed meshes of
    /// nested walls.
    pub parity: bool,
}

impl Default for FieldSettings {
    fn default() -> Self {
        Self {
            resolution: 128,
            cell_mm: None,
            region: None,
            exact: false,
            parity: false,
        }
    }
}

/// Distance between the points of a mesh's field at a given resolution, mm.
pub fn cell_of(bounds: &Bounds, resolution: usize) -> f32 {
    bounds.size().max_element() / (resolution.max(8) as f32 - 1.0 - 2.0 * MARGIN).max(1.0)
}

/// The lattice of a field over a box.
pub(super) struct FieldLattice {
    pub size: [usize; 3],
    pub origin: Vec3,
    pub cell: f32,
}

impl FieldLattice {
    pub fn over(bounds: &Bounds, settings: &FieldSettings) -> Result<Self, String> {
        let cell = match settings.cell_mm {
            Some(cell) if cell.is_finite() && cell > 0.0 => cell,
            Some(cell) => return Err(format!("a cell of {cell} mm cannot be used")),
            None => cell_of(bounds, settings.resolution),
        };
        let part = match settings.region {
            Some(region) => bounds.grown(MARGIN * cell).intersection(&region),
            None => bounds.grown(MARGIN * cell),
        };
        if part.is_empty() {
            return Err("no part of the mesh lies in the box".into());
        }
        let size = (part.size() / cell - 1e-3)
            .ceil()
            .max(Vec3::ONE)
            .to_array()
            .map(|n| (n as usize).saturating_add(1));
        let points = size
            .iter()
            .try_fold(1usize, |p, &n| p.checked_mul(n))
            .unwrap_or(usize::MAX);
        if points > MAX_POINTS {
            return Err(format!(
                "a field of {} x {} x {} points is too large; make its cells larger",
                size[0], size[1], size[2]
            ));
        }
        // The extent added by rounding is split between both sides.
        let more = Vec3::from(size.map(|n| (n - 1) as f32)) * cell - part.size();
        Ok(Self {
            size,
            origin: part.min - more * 0.5,
            cell,
        })
    }

    pub fn point(&self, i: usize, j: usize, k: usize) -> Vec3 {
        self.origin + Vec3::new(i as f32, j as f32, k as f32) * self.cell
    }

    pub fn len(&self) -> usize {
        self.size.iter().product()
    }

    pub fn world_from_grid(&self) -> Affine3A {
        Affine3A::from_translation(self.origin) * Affine3A::from_scale(Vec3::splat(self.cell))
    }
}
