//! Fields fully described by numbers: a formula and its numbers, which a device evaluates by
//! `shaders/lib/kinds.wgsl`.

/// The formula. `src/render/constants.rs` passes these numbers to `backward_of` in
/// `shaders/lib/kinds.wgsl`; the functions there keep this order.
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

/// Maximum number of numbers in a formula.
pub const MAX_FORMULA_NUMBERS: usize = 16;

/// A field fully described by numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Formula {
    /// The formula.
    pub kind: FormulaKind,
    /// Its numbers in the order of the shader; the rest are zero.
    pub numbers: [f32; MAX_FORMULA_NUMBERS],
}

impl Formula {
    /// A formula of at most [`MAX_FORMULA_NUMBERS`] numbers.
    pub fn new(kind: FormulaKind, given: &[f32]) -> Self {
        assert!(
            given.len() <= MAX_FORMULA_NUMBERS,
            "a formula has at most {MAX_FORMULA_NUMBERS} numbers"
        );
        let mut numbers = [0.0; MAX_FORMULA_NUMBERS];
        numbers.iter_mut().zip(given).for_each(|(to, from)| *to = *from);
        Self { kind, numbers }
    }
}
