//! `incise sdf`: the signed distance field of a mesh, into a file.

use super::progress::TerminalProgress;
use crate::Watch;
use crate::export::protect;
use crate::files::OutputFile;
use crate::math::Bounds;
use crate::math::flat;
use crate::mesh::field::{FieldSettings, MeshField};
use crate::mesh::{Mesh, load};
use crate::volume::load::ScalarType;
use crate::volume::save::{Content, Format, Writer};
use crate::volume::{GridGeometry, Rescale};
use crate::{Error, Result};
use clap::Args;
use glam::{DAffine3, DMat3, Vec3};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::Instant;

/// Options as typed.
#[derive(Args)]
pub struct SdfArguments {
    /// A mesh: .stl, .obj, .ply, .off, .gltf, .glb, .gii
    mesh: PathBuf,
    /// The field to write: .nii.gz, .nii, .nrrd, .mha or .vti; mm, positive inside
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Points along the longest axis.
    #[arg(long, default_value = "128")]
    resolution: usize,
    /// Grid spacing in mm, instead of a resolution.
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    cell: Option<f32>,
    /// Only this part: two corners, x,y,z,x,y,z (mm).
    #[arg(long = "box", value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true)]
    part: Option<String>,
    /// Compute exact distances everywhere, not only in the narrow band around the surface.
    #[arg(long)]
    exact: bool,
    /// A report on standard output.
    #[arg(long)]
    json: bool,
    /// No notices, no progress.
    #[arg(short, long)]
    quiet: bool,
}

/// Computes and writes the field.
pub fn run(arguments: &SdfArguments) -> Result<()> {
    let format = Format::of(&arguments.output)?;
    protect("--output", &arguments.output, [arguments.mesh.as_path()])?;
    if !(8..=4096).contains(&arguments.resolution) {
        return Err(Error::value(
            "--resolution",
            format!("{} is outside 8 to 4096 points", arguments.resolution),
        ));
    }
    if arguments.cell.is_some_and(|c| !(c.is_finite() && c > 0.0)) {
        return Err(Error::value("--cell", "must be a positive number of millimetres"));
    }
    let region = arguments.part.as_deref().map(corners).transpose()?;
    let output = OutputFile::create(&arguments.output)?;
    let start = Instant::now();
    let mesh = load::mesh(&arguments.mesh)?;
    output.check()?;
    let read_ms = start.elapsed().as_secs_f64() * 1e3;
    if !arguments.quiet {
        for warning in &mesh.warnings {
            super::print_to_stderr(format_args!("{}: {warning}", arguments.mesh.display()));
        }
    }
    let bar = TerminalProgress::new(arguments.quiet);
    let settings = FieldSettings {
        resolution: arguments.resolution,
        cell_mm: arguments.cell,
        region,
        exact: arguments.exact,
        parity: false,
    };
    let progress = |share| bar.set("computing", share);
    let watch = Watch::reporting(&progress);
    let start = Instant::now();
    let field =
        MeshField::new(&mesh, &settings, &watch).map_err(|problem| Error::file(&arguments.mesh, problem))?;
    let field_ms = start.elapsed().as_secs_f64() * 1e3;
    bar.finish();
    write_field(&field, format, arguments, output)?;
    if !arguments.quiet {
        print_orientation_notices(&field, arguments);
    }
    if arguments.json {
        let report = report(&mesh, &field, arguments.exact, [read_ms, field_ms]);
        super::print(&format!("{report:#}"))?;
    }
    Ok(())
}

/// Writes the distances, mm, with the geometry of their grid.
fn write_field(
    field: &MeshField,
    format: Format,
    arguments: &SdfArguments,
    output: OutputFile,
) -> Result<()> {
    let m = field.grid.world_from_grid;
    let linear = DMat3::from_cols(
        m.matrix3.x_axis.as_dvec3(),
        m.matrix3.y_axis.as_dvec3(),
        m.matrix3.z_axis.as_dvec3(),
    );
    let geometry = GridGeometry {
        size: field.grid.size,
        world_from_voxel: DAffine3::from_mat3_translation(linear, m.translation.as_dvec3()),
    };
    output.finish_with(|file| {
        let problem = |e: String| Error::file(&arguments.output, e);
        let mut writer = Writer::new(
            file,
            format,
            &geometry,
            Content::Scalar(ScalarType::F32, Rescale::NONE),
        )
        .map_err(problem)?;
        writer
            .push(bytemuck::cast_slice(flat(&field.grid.distance_mm)))
            .map_err(|e| Error::io(&arguments.output, "writing", e))?;
        writer
            .finish()
            .map_err(|e| Error::io(&arguments.output, "writing", e))?;
        Ok(())
    })
}

/// Prints a notice if the mesh is not watertight, and another if triangles were flipped.
fn print_orientation_notices(field: &MeshField, arguments: &SdfArguments) {
    let t = &field.topology;
    if !t.watertight {
        super::print_to_stderr(format_args!(
            "{}: not watertight ({} open edges, {} with more than two triangles); the inside is where the winding number is above 1/2, doubtful at {:.1} % of the points near the surface",
            arguments.mesh.display(),
            t.open_edges,
            t.non_manifold_edges,
            100.0 * field.doubtful
        ));
    }
    if field.turned > 0 {
        super::print_to_stderr(format_args!(
            "{}: {} triangles were flipped to make the orientation consistent",
            arguments.mesh.display(),
            field.turned
        ));
    }
}

/// The report: size, topology and accuracy of the field, and the time to read the mesh and to
/// compute the field, ms.
fn report(mesh: &Mesh, field: &MeshField, exact: bool, [read_ms, field_ms]: [f64; 2]) -> Value {
    let t = &field.topology;
    json!({
        "size": field.grid.size,
        "cell_mm": field.grid.spacing_mm(),
        "triangles": mesh.triangles.len(),
        "open_edges": t.open_edges,
        "non_manifold_edges": t.non_manifold_edges,
        "turned_triangles": field.turned,
        "inside_fraction": field.inside,
        "eikonal_residual": { "mean": field.eikonal[0], "p99": field.eikonal[1] },
        "winding_numbers": field.windings,
        "doubtful_sign_fraction": field.doubtful,
        "exact_everywhere": exact,
        "milliseconds": { "read": read_ms, "field": field_ms },
    })
}

fn corners(text: &str) -> Result<Bounds> {
    let v: Vec<f32> = text.split(',').map_while(|p| p.trim().parse().ok()).collect();
    let b = match v[..] {
        [a, b, c, d, e, f] if text.split(',').count() == 6 => Bounds::new(
            Vec3::new(a, b, c).min(Vec3::new(d, e, f)),
            Vec3::new(a, b, c).max(Vec3::new(d, e, f)),
        ),
        _ => {
            return Err(Error::value(
                format!("--box {text}"),
                "needs two corners: six numbers, x,y,z,x,y,z",
            ));
        }
    };
    if b.size().min_element() > 0.0 && b.size().is_finite() {
        Ok(b)
    } else {
        Err(Error::value(
            format!("--box {text}"),
            "is empty; the corners must differ along every axis",
        ))
    }
}
