//! incise renders CT and MRI volumes that are cut, peeled, pulled and opened **at render time**:
//! the volume is never resampled. A displacement map (a small 3D grid) gives, for every point of
//! the deformed scene, the corresponding source point in the volume and whether the point is cut
//! away; slicing and ray casting look it up at every sample.
//!
//! Load a scan, peel it, render a picture:
//!
//! ```
//! use incise::{Engine, Scene, kinds::Peel, scene::View};
//! # fn main() -> incise::Result<()> {
//! let mut scene = Scene::of_volume("volumes/colin27-head-t1.nii.gz");
//! scene.camera.view = View { azimuth_deg: 40.0, elevation_deg: 20.0 };
//! scene.deformation.push(Peel::new().center([0.0, -30.0, 60.0]).size([150.0, 120.0, 90.0]).progress(0.7).into());
//! let rendered = Engine::auto().render_scene(&scene)?;
//! let file = std::env::temp_dir().join("head.png");
//! rendered.picture.save_png(&file, scene.render.background)?;
//! # assert!(std::fs::read(&file).is_ok_and(|png| png.starts_with(b"\x89PNG")) && !rendered.picture.is_blank());
//! # std::fs::remove_file(&file).map_err(|e| incise::Error::io(&file, "removing", e))
//! # }
//! ```
//!
//! Render your own data, an [`Array3`](ndarray::Array3) of shape (k, j, i):
//!
//! ```
//! use incise::{Assets, Engine, RenderRequest, Scene, Volume, kinds::Peel, volume::Rescale};
//! use incise::{glam, ndarray};
//! # fn main() -> incise::Result<()> {
//! let ball = ndarray::Array3::from_shape_fn((48, 48, 48), |(k, j, i)| {
//!     let from_center = glam::Vec3::new(i as f32, j as f32, k as f32) - 23.5;
//!     (20.0 - from_center.length()).clamp(0.0, 1.0)
//! });
//! let volume = Volume::new(ball, Rescale::NONE, glam::DAffine3::IDENTITY);
//! let assets = Assets::of_volume(volume);
//! // Messages call the volume by this name; no file is opened. `render_scene` would open the file.
//! let mut scene = Scene::of_volume("ball");
//! scene.deformation.push(Peel::new().progress(0.6).into());
//! let shown = Engine::cpu().picture(&scene, &assets, &RenderRequest::default())?;
//! let file = std::env::temp_dir().join("ball.png");
//! shown.rendered.picture.save_png(&file, scene.render.background)?;
//! # assert!(std::fs::read(&file).is_ok_and(|png| png.starts_with(b"\x89PNG")) && !shown.rendered.picture.is_blank());
//! # std::fs::remove_file(&file).map_err(|e| incise::Error::io(&file, "removing", e))
//! # }
//! ```
//!
//! Apply a registration's displacement field to a volume and write the result as a new volume, as
//! registration programs do:
//!
//! ```
//! use incise::export::bake::{self, BakeOptions};
//! use incise::prepare::Deformed;
//! use incise::volume::save::Format;
//! use incise::{Assets, Scene, Watch, kinds::ExternalField};
//! # fn main() -> incise::Result<()> {
//! # let field = std::env::temp_dir().join(format!("incise-doc-{}.txt", std::process::id()));
//! # std::fs::write(&field, "#Insight Transform File V1.0\n#Transform 0\nTransform: TranslationTransform_double_3_3\nParameters: 5 0 0\nFixedParameters:\n")
//! #     .map_err(|e| incise::Error::io(&field, "writing", e))?;
//! let mut scene = Scene::of_volume("phantom:head-ct:size=32");
//! scene.deformation.push(ExternalField::new().path(field.to_string_lossy().as_ref()).into());
//! let assets = Assets::load(&scene)?;
//! let exact = Deformed::exact(&scene, &assets, true, &Watch::NONE)?;
//! let mut nifti = Vec::new();
//! let grid = assets.volume.geometry();
//! bake::volume(&assets.volume, &exact.stack_and_cuts(), &grid, Format::Nifti, &mut nifti, &BakeOptions::default())?;
//! # assert!(nifti.len() > 2 * 32 * 32 * 32);
//! # let _removed = std::fs::remove_file(&field);
//! # Ok(())
//! # }
//! ```
//!
//! Convert a mesh to a signed distance field:
//!
//! ```
//! use incise::mesh::{field::{FieldSettings, MeshField}, load};
//! # fn main() -> incise::Result<()> {
//! let mesh = load::mesh(std::path::Path::new("volumes/bunny.obj"))?;
//! let settings = FieldSettings { resolution: 32, ..FieldSettings::default() };
//! let field = MeshField::new(&mesh, &settings, &incise::Watch::NONE).map_err(|problem| incise::Error::value("mesh", problem))?;
//! let (points, center_mm) = (field.grid.distance_mm.dim(), field.grid.sample(mesh.bounds().center()));
//! # assert!(points.0.max(points.1).max(points.2) >= 32 && center_mm > 0.0);
//! # Ok(())
//! # }
//! ```
//!
//! A [`Scene`] is plain data, the same data that a scene file states ([`Scene::load`]). An
//! [`Engine`] renders it on a GPU or on the CPU. To render many pictures of one scene, keep its
//! [`Assets`] ([`engine::AssetCache`]) and pass a [`RenderRequest`] for each picture; a request can
//! be cancelled ([`Watch`]).
//!
//! ```text
//!   file, phantom ── volume ──┐
//!   file ──────────── mesh ───┤
//!   preset, curve ── transfer ┤                                ┌── cpu ─────┐
//!   kind, parameters ─ deform ┼── scene ── prepare ── engine ──┤            ├── Picture ── export
//!   camera, light ────────────┘                                └── render ──┘
//! ```
//!
//! [`cpu`] is the reference and always available; [`render`] computes slices, rays and surfaces on
//! a GPU, on top of [`gpu`].
//!
//! Modules, each depending only on those before it (a test enforces this): [`files`] ← [`math`] ←
//! [`volume`] ← [`picture`], [`mesh`], [`transfer`], [`deform`] ← [`scene`] ← [`prepare`] ←
//! [`cpu`], ([`gpu`] ← [`render`]) ← [`engine`] ← [`export`] ← [`compare`] ← [`cli`], [`gui`] (the
//! workstation). The last two do not depend on each other.
//!
//! *Theory*: backward displacement maps with a discontinuity mask, \[DDM06\] = Correa, Silver,
//! Chen, "Discontinuous Displacement Mapping for Volume Graphics", Volume Graphics 2006; \[DS07\] =
//! Correa, Silver, "Programmable Shaders for Deformation Rendering", Graphics Hardware 2007;
//! \[GG42\] = d'Eon, "Deformers", GPU Gems chapter 42, 2004; \[RVD01\] = Westermann, Rezk-Salama,
//! "Real-Time Volume Deformations", Eurographics 2001. The formulas are in [`model`]. Where a
//! module differs from the papers, its header states the difference.
//!
//! *Spaces*: voxel (indices, centres at integers), world (millimetres, patient LPS), map (the unit
//! cube of one displacement map), view. Transforms are named `target_from_source`.

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
pub mod model;
mod panic_guard;
pub mod picture;
pub mod prepare;
#[cfg(feature = "gpu")]
pub mod render;
pub mod scene;
pub mod transfer;
pub mod volume;
mod watch;

pub use engine::{Backend, Engine, RenderRequest};
pub use error::{Error, Result};
pub use mesh::Mesh;
pub use picture::{Picture, Rendered};
pub use prepare::{Assets, Prepared};
pub use scene::{Deformation, Scene, kinds};
pub use volume::Volume;
pub use watch::{ByteProgress, Watch};

// Vector and array types of the public interface.
pub use {glam, ndarray};
