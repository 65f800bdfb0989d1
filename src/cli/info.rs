//! `incise info`: what a file holds. `incise list`: what there is to choose from.

use crate::deform::kinds::{self, Unit};
use crate::scene::Scene;
use crate::scene::deformations::FILE_KINDS;
use crate::scene::surface::{DEFORMERS, LOOKS};
use crate::transfer;
use crate::volume::{Volume, load, phantom};
use crate::{Result, mesh};
use clap::Args;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Options as typed.
#[derive(Args)]
pub struct Arguments {
    /// A volume, a mesh, a scene or phantom:NAME.
    file: PathBuf,
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
}

/// Prints what the file holds.
pub fn run(arguments: &Arguments) -> Result<()> {
    let path = &arguments.file;
    let report = match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("toml") => scene_report(path)?,
        _ if mesh::load::is_mesh(path) => mesh_report(&mesh::load::mesh(path)?),
        _ => volume_report(&load::volume(path, &mut |_, _| ())?),
    };
    super::print(&if arguments.json { format!("{report:#}") } else { plain(&report) });
    Ok(())
}

fn volume_report(volume: &Volume) -> Value {
    let direction = volume.direction();
    let rows: Vec<[f64; 3]> = (0..3).map(|r| direction.row(r).to_array()).collect();
    let voxels = volume.voxels.len();
    let stored = voxels * volume.voxels.bytes_per_voxel();
    // Types that renderers cannot sample are converted to f32 beside the stored ones.
    let converted = match volume.voxels.type_name() {
        "u8" | "u16" | "i16" => 0,
        "f32" if volume.non_finite == 0 => 0,
        "i8" => 2 * voxels,
        _ => 4 * voxels,
    };
    let spacing = volume.spacing_mm();
    let mut report = json!({
        "kind": "volume",
        "size": volume.size,
        "type": volume.voxels.type_name(),
        "range": volume.range,
        "spacing_mm": spacing.to_array(),
        "extent_mm": (0..3).map(|a| spacing[a] * volume.size[a] as f64).collect::<Vec<_>>(),
        "origin_mm": volume.world_from_voxel.translation.to_array(),
        "direction": rows,
        "orientation": volume.orientation(),
        "determinant": volume.world_from_voxel.matrix3.determinant(),
        "components": 1,
        "voxels": voxels,
        "non_finite": volume.non_finite,
        "rescale": { "slope": volume.rescale.slope, "intercept": volume.rescale.intercept },
        "stored_bytes": stored,
        "memory_bytes": stored + converted,
        "warnings": volume.warnings,
    });
    if let (Some(labels), Some(entries)) = (volume.labels(), report.as_object_mut()) {
        entries.insert("labels".into(), json!(labels));
    }
    report
}

fn mesh_report(mesh: &mesh::Mesh) -> Value {
    let (t, bounds) = (mesh.topology(), mesh.bounds());
    json!({
        "kind": "mesh",
        "triangles": mesh.triangles.len(),
        "vertices": mesh.positions.len(),
        "bounds_mm": [bounds.min.to_array(), bounds.max.to_array()],
        "extent_mm": bounds.size().to_array(),
        "watertight": t.watertight,
        "orientation": t.orientation(),
        "components": t.components,
        "open_edges": t.open_edges,
        "non_manifold_edges": t.non_manifold_edges,
        "flipped_edges": t.flipped_edges,
        "volume_mm3": t.watertight.then_some(t.volume),
        "welded_vertices": mesh.welded,
        "degenerate_triangles": mesh.degenerate,
        "memory_bytes": mesh.positions.len() * 12 + mesh.triangles.len() * 12,
        "warnings": mesh.warnings,
    })
}

fn scene_report(path: &Path) -> Result<Value> {
    let scene = Scene::load(path)?;
    let volume = scene.volume_path().map(|p| load::volume(&p, &mut |_, _| ())).transpose()?;
    let meshes = scene
        .mesh
        .iter()
        .filter_map(|m| m.path.as_ref())
        .map(|p| -> Result<Value> { Ok(json!({ "path": p, "report": mesh_report(&mesh::load::mesh(&scene.folder.join(p))?) })) });
    Ok(json!({
        "kind": "scene",
        "volume": volume.map(|v| json!({ "path": scene.volume_name(), "report": volume_report(&v) })),
        "meshes": meshes.collect::<Result<Vec<_>>>()?,
        "deformations": scene.deformation.iter().map(|d| d.kind.as_str()).collect::<Vec<_>>(),
        "picture": scene.render.size,
        "warnings": [],
    }))
}

/// `name: value` lines.
fn plain(report: &Value) -> String {
    fn lines(value: &Value, indent: usize, out: &mut String) {
        let Some(entries) = value.as_object() else { return };
        for (name, value) in entries {
            let text = match value {
                Value::Object(_) => {
                    out.push_str(&format!("{:indent$}{name}:\n", ""));
                    lines(value, indent + 2, out);
                    continue;
                }
                Value::String(s) => s.clone(),
                Value::Array(a) if a.is_empty() => "none".into(),
                Value::Array(a) if a.iter().all(Value::is_string) => a.iter().filter_map(Value::as_str).collect::<Vec<_>>().join("; "),
                other => other.to_string(),
            };
            out.push_str(&format!("{:indent$}{name:<14} {text}\n", ""));
        }
    }
    let mut out = String::new();
    lines(report, 0, &mut out);
    out.trim_end().to_owned()
}

/// Presets, kinds and phantoms as text.
pub fn catalogue() -> String {
    let mut out = String::from("Presets (--preset)\n");
    for p in transfer::list() {
        out.push_str(&format!("  {:<22} {}\n", p.name, p.about));
    }
    out.push_str(
        "\nDeformations (--deform KIND:name=value,...); every kind takes center, size, rotate, storage, resolution, add, spare, labels, mapping\n",
    );
    for k in kinds::list() {
        out.push_str(&format!("  {:<22} {}{}\n", k.name, k.about, if k.progressive { "; progress=0..1" } else { "" }));
        for p in k.parameters {
            let unit = match p.unit {
                Unit::Mm => ", mm",
                Unit::Degrees => ", degrees",
                Unit::None => "",
            };
            out.push_str(&format!("    {:<20} {}{unit}; default {}, from {} to {}\n", p.name, p.about, p.default, p.min, p.max));
        }
        for s in k.own_settings() {
            out.push_str(&format!("    {:<20} {}\n", s.name, s.about));
        }
    }
    for k in FILE_KINDS {
        out.push_str(&format!("  {:<22} {}\n", k.name, k.about));
        for s in k.settings {
            out.push_str(&format!("    {:<20} {}\n", s.name, s.about));
        }
    }
    out.push_str("\nLooks of surfaces (--look)\n");
    for (name, about, _) in LOOKS {
        out.push_str(&format!("  {name:<22} {about}\n"));
    }
    out.push_str("\nForward deformers of meshes ([[mesh.deformer]] in scenes)\n");
    for (name, about, parameters) in DEFORMERS {
        out.push_str(&format!("  {name:<22} {about}: {parameters}\n"));
    }
    out.push_str("\nPhantoms (phantom:NAME[:size=N][:spacing=AxBxC])\n");
    for (name, about) in phantom::list() {
        out.push_str(&format!("  {name:<22} {about}\n"));
    }
    out.trim_end().to_owned()
}
