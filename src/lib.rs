//! incise renders CT and MRI volumes that are cut, peeled, pulled and opened **at render time**: the volume is never resampled.
//! A displacement map (a small 3D grid) says, for every point of the deformed scene, which point of the volume it shows and
//! whether anything is there at all; slicing and ray casting look it up at every sample.
//!
//! ```text
//!   file, phantom ── volume ──┐
//!   file ──────────── mesh ───┤
//!   preset, curve ── transfer ┤                      ┌── cpu    (the reference; always there)
//!   kind, parameters ─ deform ┼── scene ── Prepared ─┤                                        ── Picture ── export
//!   camera, light ────────────┘                      └── render (slices and rays on a GPU, on top of gpu)
//! ```
//!
//! Modules, each knowing only those before it: [`files`] ← [`math`] ← [`volume`], [`mesh`] ← [`transfer`], [`deform`] ← [`scene`] ← [`cpu`],
//! ([`gpu`] ← [`render`]) ← [`export`] ← [`compare`] ← [`cli`], [`gui`] (the workstation), which do not know each other.
//!
//! *Theory*: backward displacement maps with a discontinuity mask, \[DDM06\] = Correa, Silver, Chen, "Discontinuous Displacement
//! Mapping for Volume Graphics", Volume Graphics 2006; \[DS07\] = Correa, Silver, "Programmable Shaders for Deformation Rendering",
//! Graphics Hardware 2007; \[GG42\] = d'Eon, "Deformers", GPU Gems chapter 42, 2004; \[RVD01\] = Westermann, Rezk-Salama, "Real-Time Volume
//! Deformations", Eurographics 2001. Where we differ from them, the module that differs says so in its first lines.
//!
//! *Spaces*: voxel (indices, centres at integers), world (millimetres, patient LPS), map (the unit cube of one displacement
//! map), view. Transforms are named `target_from_source`.
//!
//! *How to call it*: [`scene::Scene`] is plain data, [`scene::Prepared::new`] loads what it names, [`cpu::render`] and
//! [`render::Renderer::render`] turn it into a [`scene::Picture`].

pub mod cli;
pub mod compare;
pub mod cpu;
pub mod deform;
pub mod engine;
mod error;
pub mod export;
pub mod files;
#[cfg(feature = "gpu")]
pub mod gpu;
#[cfg(feature = "gui")]
pub mod gui;
pub mod math;
pub mod mesh;
mod panic_guard;
pub mod picture;
pub mod prepare;
#[cfg(feature = "gpu")]
pub mod render;
pub mod scene;
pub mod transfer;
pub mod volume;
mod watch;

pub use engine::Engine;
pub use error::{Error, Result};
pub use picture::Picture;
pub use scene::Scene;
pub use watch::{ByteProgress, Watch};
