//! Displacement maps and their kinds.
//!
//! A [`DisplacementMap`] is a small 3D grid over the unit cube: the inverse displacement D and the
//! mask alpha (\[DDM06\] section 4). It is sampled from a *kind* ([`kinds`]), a formula with named
//! parameters in millimetres and degrees; some kinds also read points, labels or files. A
//! [`Placement`] puts the map into the world. A renderer walks an ordered [`Stack`] of placed maps
//! at every sample, or evaluates one precomposed map instead ([`compose`]). Removals after the last
//! map that moves anything are not maps but shapes ([`cut`]).
//!
//! *Differences from the paper*:
//! - The mask is not a blurred binary image but a ramp of the signed distance to the cut, alpha =
//!   1/2 + d/2w. A blur moves the 1/2 iso-line wherever a cut bends; the ramp keeps it exact and
//!   has the same gradient for shading.
//! - Grid points lie on the cube's faces (x = i/(n-1)), so that a displacement that vanishes on a
//!   face does so exactly.
//! - The masks of a stack combine like binary ones: a point is cut if *any* mask is below 1/2
//!   there. The product of the smoothed masks would erode the corner where two cuts meet.

mod argument;
mod bounds;
pub mod compose;
pub mod cut;
pub mod distance;
pub mod elastic;
mod field;
pub mod file_kinds;
mod filter;
mod formula;
pub mod invert;
pub mod kinds;
mod library;
pub mod lipschitz;
mod map;
pub mod mapping;
mod placement;
pub mod points;
pub mod quality;
pub mod saved;
mod stack;
pub mod stroke;
mod texel;
pub mod transform;
mod whole;

pub use argument::{Argument, Arguments};
pub use field::MapDefinition;
pub use filter::MapFilter;
pub use formula::{Formula, FormulaKind, MAX_FORMULA_NUMBERS};
pub use library::Library;
pub use map::{DisplacementMap, TexelRange};
pub use placement::Placement;
pub use stack::{Jet, MAX_MAPS, NearestCut, PlacedMap, PrecomposedMap, Stack, TexelLine};
pub use texel::{Storage, TexelSample};
pub use whole::StackAndCuts;
