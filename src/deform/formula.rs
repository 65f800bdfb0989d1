//! What maps are sampled from: a field with its cube, and, where the field is a formula of numbers alone, the formula by number, which a device samples
//! by `shaders/lib/kinds.wgsl`.

use super::kinds::Field;
use super::{DisplacementMap, Storage, TexelSample};
use crate::{Result, Watch};
use glam::Vec3;

/// Which formula, as `backward_of` in `shaders/lib/kinds.wgsl` numbers them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
#[allow(missing_docs, reason = "the kinds' names")]
pub enum FormulaKind {
    Pull = 0,
    SplinePull = 1,
    Wave = 2,
    Twist = 3,
    Bend = 4,
    Taper = 5,
    Shear = 6,
    Bulge = 7,
    Peel = 8,
    Slab = 9,
    Explode = 10,
    Seam = 11,
    Book = 12,
    Knife = 13,
    Retractor = 14,
    Removal = 15,
}

/// Numbers of a formula.
pub const FORMULA_NUMBERS: usize = 16;

/// A field that is said by numbers alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Formula {
    /// Which.
    pub kind: FormulaKind,
    /// Its numbers, in the order that the shader takes them; the rest is zero.
    pub numbers: [f32; FORMULA_NUMBERS],
}

impl Formula {
    /// A formula of at most [`FORMULA_NUMBERS`] numbers.
    pub fn new(kind: FormulaKind, given: &[f32]) -> Self {
        let mut numbers = [0.0; FORMULA_NUMBERS];
        numbers.iter_mut().zip(given).for_each(|(to, from)| *to = *from);
        Self { kind, numbers }
    }
}

/// What a map is sampled from.
pub struct MapDefinition {
    /// Grid points along x, y, z.
    pub size: [usize; 3],
    /// Texel format.
    pub storage: Storage,
    /// Extent of the map's cube, mm.
    pub cube_mm: Vec3,
    /// Half width of the mask's ramp, mm.
    pub ramp_mm: f32,
    /// The field in the cube's own millimetres from its centre.
    pub field: Box<dyn Field>,
}

impl MapDefinition {
    /// D and alpha at map coordinates.
    pub fn sample(&self, x: Vec3) -> TexelSample {
        let local = (x - 0.5) * self.cube_mm;
        let b = self.field.backward(local);
        TexelSample { displacement: (b.source - local) / self.cube_mm, alpha: (0.5 + 0.5 * b.cut_distance_mm / self.ramp_mm).clamp(0.0, 1.0) }
    }

    /// The map, sampled now.
    pub fn map(&self) -> DisplacementMap {
        DisplacementMap::from_fn(self.size, self.storage, |x| self.sample(x))
    }

    /// As [`Self::map`], until it is told to stop.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn map_until(&self, watch: &Watch) -> Result<DisplacementMap> {
        DisplacementMap::from_fn_until(self.size, self.storage, |x| self.sample(x), watch)
    }

    /// The formula, if the field is one.
    pub fn formula(&self) -> Option<Formula> {
        self.field.formula()
    }
}
