//! Where rays may hit a surface: empty space around each object, in deformed space, and bounds on
//! the rate of deformation there.
//!
//! Neither depends on the camera: cells are cached until the deformation, a cut or the object
//! changes. Computing them for every picture would take most of a frame. Slopes are bounded eight
//! cells at once.

use super::macrocells::{BoxVisibility, CellGrid, Macrocells};
use crate::deform::Stack;
use crate::deform::cut::CutShapes;
use crate::deform::lipschitz::LipschitzBounds;
use crate::math::{Bounds, DistanceGrid};
use crate::mesh::Implicit;
use crate::mesh::depth_map::DepthMaps;
use crate::mesh::formula::Formula;
use crate::scene::surface::CutModel;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

/// Cells along an object's longest edge.
const CELLS: f32 = 64.0;
/// Maximum number of cached cell grids, and of their deformations: each one retains its maps.
const MAX_CACHED_CELLS: usize = 64;
const MAX_CACHED_STACKS: usize = 4;

/// Empty space around an object, and the rate of deformation, per cell.
pub struct SurfaceCells {
    /// The grid.
    pub grid: Macrocells,
    /// A bound on |J v| in each cell.
    pub slope: Vec<f32>,
}

/// The inputs that decide where a ray can hit an object.
pub(super) struct SurfaceCellsInputs<'a> {
    pub implicit: Option<Implicit>,
    /// Bounds of the undeformed object.
    pub bounds: Bounds,
    /// None for an object to which deformations do not apply.
    pub stack: Option<&'a Stack>,
    pub cuts: &'a CutShapes,
    pub model: CutModel,
    pub thickness_mm: f32,
    pub skip_cuts: bool,
    pub boxes_only: bool,
    pub cell_mm: f32,
    /// Whether empty space is skipped at all.
    pub skipping: bool,
}

/// The identity of a solid, without keeping its field in memory: the weak reference keeps its
/// address from being reused.
pub enum SolidIdentity {
    /// Exactly this field.
    Grid(Weak<DistanceGrid>),
    /// Equal solids.
    Formula(Formula),
    /// Exactly these depth maps.
    Depth(Weak<DepthMaps>),
}

impl From<&Implicit> for SolidIdentity {
    fn from(implicit: &Implicit) -> Self {
        match implicit {
            Implicit::Grid(g) => Self::Grid(Arc::downgrade(g)),
            Implicit::Formula(f) => Self::Formula(f.clone()),
            Implicit::Depth(d) => Self::Depth(Arc::downgrade(d)),
        }
    }
}

impl PartialEq for SolidIdentity {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Grid(a), Self::Grid(b)) => a.ptr_eq(b),
            (Self::Formula(a), Self::Formula(b)) => a == b,
            (Self::Depth(a), Self::Depth(b)) => a.ptr_eq(b),
            _ => false,
        }
    }
}

/// An owned [`SurfaceCellsInputs`]: equal keys have equal cells.
#[derive(PartialEq)]
struct SurfaceCellsKey {
    solid: Option<SolidIdentity>,
    bounds: Bounds,
    stack: Option<Stack>,
    cuts: CutShapes,
    model: CutModel,
    thickness_mm: f32,
    skip_cuts: bool,
    boxes_only: bool,
    cell_mm: f32,
    skipping: bool,
}

/// Cells of objects, the most recently used last.
#[derive(Default)]
pub(super) struct SurfaceCellsCache(Mutex<Vec<(SurfaceCellsKey, Arc<SurfaceCells>)>>);

impl SurfaceCellsCache {
    /// The cells of an object. `slopes` are those of the scene's stack, computed on first use.
    pub fn of<'a>(
        &self,
        cells_inputs: &SurfaceCellsInputs<'a>,
        slopes: &OnceLock<LipschitzBounds<'a>>,
    ) -> Arc<SurfaceCells> {
        let inputs = cells_inputs.inputs();
        // Entries are only added as a whole.
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut entries = lock();
        if let Some(at) = entries.iter().position(|(of, _)| *of == inputs) {
            entries[at..].rotate_left(1);
            return entries[entries.len() - 1].1.clone();
        }
        drop(entries);
        let cells = Arc::new(cells_inputs.cells(slopes));
        let mut entries = lock();
        if entries.len() == MAX_CACHED_CELLS {
            entries.remove(0);
        }
        entries.push((inputs, cells.clone()));
        let mut recent: Vec<Option<Stack>> = Vec::with_capacity(MAX_CACHED_STACKS);
        for (of, _) in entries.iter().rev() {
            if recent.len() < MAX_CACHED_STACKS && !recent.contains(&of.stack) {
                recent.push(of.stack.clone());
            }
        }
        entries.retain(|(of, _)| recent.contains(&of.stack));
        cells
    }
}

impl<'a> SurfaceCellsInputs<'a> {
    fn inputs(&self) -> SurfaceCellsKey {
        let Self {
            bounds,
            stack,
            cuts,
            model,
            thickness_mm,
            skip_cuts,
            boxes_only,
            cell_mm,
            skipping,
            ..
        } = *self;
        let solid = self.implicit.as_ref().map(SolidIdentity::from);
        // Without rays nothing else affects the cells.
        let (stack, cuts) = if solid.is_some() {
            (stack.cloned(), cuts.clone())
        } else {
            Default::default()
        };
        SurfaceCellsKey {
            solid,
            bounds,
            stack,
            cuts,
            model,
            thickness_mm,
            skip_cuts,
            boxes_only,
            cell_mm,
            skipping,
        }
    }

    fn cells(&self, slopes: &OnceLock<LipschitzBounds<'a>>) -> SurfaceCells {
        let deformed = self
            .stack
            .map_or(self.bounds, |s| s.deformed_bounds(&self.bounds))
            .grown(0.5 * self.cell_mm);
        if deformed.is_empty() || self.implicit.is_none() {
            return SurfaceCells {
                grid: Macrocells::solid(Bounds::EMPTY),
                slope: vec![1.0],
            };
        }
        let edge = (deformed.size().max_element() / CELLS).max(self.cell_mm);
        // Without skipping every cell counts as occupied; its slope is needed nevertheless.
        let visibility = |b: &Bounds| {
            // Fields have no bound that guarantees a surface everywhere.
            if !self.skipping {
                BoxVisibility::VisibleEverywhere
            } else if self.visible(b) {
                BoxVisibility::MaybeVisible
            } else {
                BoxVisibility::Invisible
            }
        };
        let grid = Macrocells::classified(CellGrid::new(deformed, edge), visibility, |_| true);
        let slopes = self
            .stack
            .map(|stack| slopes.get_or_init(|| LipschitzBounds::new(stack)));
        let slope = (0..grid.distance.len())
            .into_par_iter()
            .map(|n| match slopes {
                Some(slopes) if grid.is_occupied(n) => slopes.bound(&grid.cell_box(n)),
                _ => 1.0,
            })
            .collect();
        SurfaceCells { grid, slope }
    }

    /// Whether a ray can hit the surface in a box of the deformed scene.
    fn visible(&self, deformed: &Bounds) -> bool {
        let Some(implicit) = &self.implicit else {
            return false;
        };
        let Some(stack) = self.stack else {
            return self.visible_in_source(implicit, deformed, true);
        };
        let [min_distance, max_distance] = self.cuts.bounds(deformed);
        if self.skip_cuts && max_distance < 0.0 {
            return false;
        }
        if self.boxes_only
            && self.cuts.is_empty()
            && !stack
                .maps()
                .iter()
                .any(|m| !m.bounds_in_world().intersection(deformed).is_empty())
        {
            return false;
        }
        let mut visible = false;
        stack.source_parts(deformed, &mut |source, [least, most]| {
            let gone = self.skip_cuts && most < 0.5;
            visible |= !gone && self.visible_in_source(implicit, source, min_distance >= 0.0 && least >= 0.5);
        });
        visible
    }

    /// Whether a ray can hit it in the image of a source box; `whole` if nothing of the box is cut
    /// away.
    fn visible_in_source(&self, implicit: &Implicit, source: &Bounds, mut whole: bool) -> bool {
        if source.intersection(&implicit.bounds()).is_empty() {
            return false;
        }
        if !implicit.is_distance() {
            return true;
        }
        // Interpolation between the points of a field deviates by less than a cell.
        let (f, r) = (
            implicit.value(source.center()),
            source.size().length() * 0.5 + self.cell_mm,
        );
        if f + r < 0.0 {
            return false;
        }
        // A thin shell has no inside, whatever cuts it.
        whole |= self.model == CutModel::Hollow;
        match self.model {
            CutModel::Thick => {
                !(f - r > self.thickness_mm || (whole && f - r > 0.0 && f + r < self.thickness_mm))
            }
            _ => !(whole && f - r > 0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::{DisplacementMap, PlacedMap, Placement};
    use glam::Vec3;

    /// Equal inputs get the same cells; another deformation or thickness gets others. The cells of
    /// a few deformations stay cached, with their maps.
    #[test]
    fn cells_are_kept_while_nothing_changes() {
        let maps: Vec<Arc<DisplacementMap>> = (0..10)
            .map(|_| Arc::new(DisplacementMap::identity([4; 3])))
            .collect();
        let stack = |n: usize, x: f32| {
            let placement =
                Placement::new(Vec3::X * x, Vec3::splat(30.0), Vec3::ZERO).unwrap_or_else(|e| panic!("{e}"));
            Stack::new(vec![PlacedMap::new(maps[n].clone(), placement)])
        };
        let (entries, cuts) = (SurfaceCellsCache::default(), CutShapes::default());
        let cells_of = |stack: &Stack, thickness_mm: f32| {
            let cells_inputs = SurfaceCellsInputs {
                implicit: Some(Implicit::Formula(Formula::default())),
                bounds: Bounds::new(Vec3::ZERO, Vec3::splat(20.0)),
                stack: Some(stack),
                cuts: &cuts,
                model: CutModel::Thick,
                thickness_mm,
                skip_cuts: true,
                boxes_only: false,
                cell_mm: 1.0,
                skipping: true,
            };
            entries.of(&cells_inputs, &OnceLock::new())
        };
        let first = cells_of(&stack(0, 0.0), 1.0);
        assert!(Arc::ptr_eq(&first, &cells_of(&stack(0, 0.0), 1.0)));
        assert!(
            !Arc::ptr_eq(&first, &cells_of(&stack(0, 1.0), 1.0))
                && !Arc::ptr_eq(&first, &cells_of(&stack(0, 0.0), 2.0))
        );
        assert!(Arc::ptr_eq(&first, &cells_of(&stack(0, 0.0), 1.0)));
        (1..10).for_each(|n| drop(cells_of(&stack(n, 0.0), 1.0)));
        let counts: Vec<usize> = maps.iter().map(Arc::strong_count).collect();
        assert_eq!(counts, [1, 1, 1, 1, 1, 1, 2, 2, 2, 2]);
        assert!(!Arc::ptr_eq(&first, &cells_of(&stack(0, 0.0), 1.0)));
    }
}
