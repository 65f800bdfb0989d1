//! Comparison of renderers on one scene: pictures, differences, errors and times in one report.
//!
//! *Theory*: the protocol of Meissner, Huang, Bartz, Mueller, Crawfis, "A Practical Evaluation of
//! Popular Volume Rendering Algorithms", Volume Visualization 2000: algorithms are comparable only
//! with the same optical model, the same view and the same transfer function, and their pictures
//! are shown side by side with their cost. Here all runs of a report show one scene; they differ in
//! mode, backend, step, size or camera. Their opacities are corrected to the same length, so that a
//! different step shows the sampling error alone (above one voxel the blend of normals at cuts
//! widens with the step, too). Beyond the paper's pictures and times there are difference metrics
//! for pictures ([`Difference`]), errors against a reference with a much finer step, and the cost
//! of renderers at equal error ([`lab`]).
//!
//! *How to call it*: [`lab::Plan`] and [`lab::run`] for a whole comparison; or a [`Run`] for every
//! renderer ([`run`]) and [`Report::new`]. Then [`Report::write`].

mod curves;
mod explanation;
mod folder;
pub mod lab;
mod method;
mod metrics;
mod page;
mod plan;
pub mod plot;
mod report;
mod run;

pub use curves::{Curve, EqualError, MIN_ERROR, RendererCost, at_error, common_error, curves, equal_errors};
pub use folder::write_files;
pub use method::{Method, RendererOptions};
pub use metrics::{Difference, difference, difference_picture};
pub use report::{Protocol, Report, RunPair};
pub use run::{Memory, Run, Times, ViewKey, run};
