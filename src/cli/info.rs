//! `incise info`: the contents of a file. `incise list`: the available presets, kinds and phantoms.

use super::arguments::VolumeArguments;
use super::progress::TerminalProgress;
use crate::deform::file_kinds::FILE_KINDS;
use crate::deform::kinds::{self, DefaultSize, Kind, Unit};
use crate::files::path_text::{path_of, text_of};
use crate::scene::surface::{DEFORMERS, LOOKS};
use crate::scene::{LIGHT_PRESETS, Scene};
use crate::transfer;
use crate::volume::function::FUNCTIONS;
use crate::volume::load::{self, ReadOptions, SeriesInfo};
use crate::volume::{Volume, phantom};
use crate::{Result, Watch, mesh};
use clap::Args;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Options as typed.
#[derive(Args)]
pub struct InfoArguments {
    /// A volume (file, folder or zip), a mesh, a scene or phantom:NAME.
    file: PathBuf,
    #[command(flatten)]
    volume: VolumeArguments,
    /// With the patient's name and identity, where a file states them.
    #[arg(long)]
    patient: bool,
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
}

/// A volume whose k axis deviates by more than this from the normal of its slices, degrees, is
/// reported as tilted.
const TILTED: f64 = 0.05;

/// Prints the contents of a file.
pub fn run(arguments: &InfoArguments) -> Result<()> {
    let path = &arguments.file;
    let report = match path
        .extension()
        .and_then(|e| e.to_str())
        .map(str::to_ascii_lowercase)
        .as_deref()
    {
        Some("toml") => scene_report(path)?,
        _ if mesh::load::is_mesh(path) => mesh_report(&mesh::load::mesh(path)?),
        _ => {
            let bar = TerminalProgress::new(arguments.json);
            let reading = |share: f32| bar.set("reading", share);
            let watch = Watch::reporting(&reading);
            let series = load::series(path, arguments.patient, &Watch::NONE)?;
            let volume = load::volume(path, &arguments.volume.over(&ReadOptions::default()), &watch);
            bar.finish();
            match (volume, series) {
                (Ok(volume), series) => {
                    let scene = Scene::of_volume(text_of(path));
                    file_report(&volume, &scene, series.as_deref())
                }
                // Only one of several series is unreadable.
                (Err(error), Some(series)) if series.len() > 1 => {
                    let report = json!({ "kind": "volume", "format": "DICOM", "all_series": series });
                    super::print(&if arguments.json {
                        format!("{report:#}")
                    } else {
                        as_text(&report)
                    })?;
                    return Err(error);
                }
                (Err(error), _) => return Err(error),
            }
        }
    };
    super::print(&if arguments.json {
        format!("{report:#}")
    } else {
        as_text(&report)
    })
}

/// The report on a volume, with all series of its file.
fn file_report(volume: &Volume, scene: &Scene, series: Option<&[SeriesInfo]>) -> Value {
    let mut report = volume_report(volume, scene);
    if let (Some(series), Some(entries)) = (series, report.as_object_mut()) {
        entries.insert("all_series".into(), json!(series));
    }
    report
}

/// The report on a scene's volume.
fn volume_report(volume: &Volume, scene: &Scene) -> Value {
    let transfer = &scene.transfer;
    let (preset, reason) = match &transfer.preset {
        Some(name) => (json!(name), "the scene names it".to_owned()),
        None if !transfer.points.is_empty() => (Value::Null, "the scene states a curve of its own".into()),
        None => {
            let suitable = scene.suitable_preset(volume);
            (json!(suitable.name), suitable.reason)
        }
    };
    let direction = volume.direction();
    let rows: Vec<[f64; 3]> = (0..3).map(|r| direction.row(r).to_array()).collect();
    let voxels = volume.voxels.len();
    let stored = voxels * volume.voxels.bytes_per_voxel();
    // Types that renderers cannot sample are converted (i8 to i16, others to f32) in addition to
    // the stored voxels.
    let converted = match volume.voxels.type_name() {
        "u8" | "u16" | "i16" => 0,
        "f32" if volume.non_finite == 0 => 0,
        "i8" => 2 * voxels,
        _ => 4 * voxels,
    };
    let colors = if volume.colors.is_some() {
        volume.components.max(3) * voxels
    } else {
        0
    };
    let determinant = volume.world_from_voxel.matrix3.determinant();
    let spacing = volume.spacing_mm();
    let mut report = json!({
        "kind": "volume",
        "format": volume.format,
        "size": volume.size,
        "type": volume.source_type,
        "range": volume.range,
        "spacing_mm": spacing.to_array(),
        "extent_mm": (0..3).map(|a| spacing[a] * volume.size[a] as f64).collect::<Vec<_>>(),
        "origin_mm": volume.world_from_voxel.translation.to_array(),
        "direction": rows,
        "orientation": volume.orientation(),
        "determinant": determinant,
        "handedness": if determinant < 0.0 { "left" } else { "right" },
        "components": volume.components,
        "voxels": voxels,
        "non_finite": volume.non_finite,
        "rescale": { "slope": volume.rescale.slope, "intercept": volume.rescale.intercept },
        "stored_bytes": stored,
        "memory_bytes": stored + converted + colors,
        "transfer": { "preset": preset, "reason": reason },
        "warnings": volume.warnings_with_options(),
    });
    if let (Some(labels), Some(entries)) = (volume.labels(), report.as_object_mut()) {
        entries.insert("labels".into(), json!(labels));
        if !volume.label_table.is_empty() {
            let names: serde_json::Map<String, Value> = volume
                .label_table
                .iter()
                .map(|l| (l.value.to_string(), json!(l.name)))
                .collect();
            entries.insert("label_names".into(), json!(names));
        }
    }
    if let Some(entries) = report.as_object_mut() {
        if volume.padded > 0 {
            entries.insert("padded".into(), json!(volume.padded));
        }
        if volume.inverted {
            entries.insert("inverted".into(), json!(true));
        }
        if volume.tilt_degrees() > TILTED {
            entries.insert("tilt_degrees".into(), json!(volume.tilt_degrees()));
        }
        for (name, value) in &volume.details {
            entries.insert((*name).into(), value.clone());
        }
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
    let volume = match (scene.volume_path(), &scene.volume) {
        (Some(path), Some(source)) => Some(load::volume(&path, &source.choice, &Watch::NONE)?),
        _ => None,
    };
    let meshes = scene
        .mesh
        .iter()
        .filter_map(|m| m.path.as_ref())
        .map(|p| -> Result<Value> { Ok(json!({ "path": p, "report": mesh_report(&mesh::load::mesh(&scene.folder.join(path_of(p)))?) })) });
    Ok(json!({
        "kind": "scene",
        "volume": volume.map(|v| json!({ "path": scene.volume_name(), "report": volume_report(&v, &scene) })),
        "meshes": meshes.collect::<Result<Vec<_>>>()?,
        "deformations": scene.deformation.iter().map(|d| d.kind.as_str()).collect::<Vec<_>>(),
        "picture": scene.render.size,
        "warnings": [],
    }))
}

/// `name: value` lines.
fn as_text(report: &Value) -> String {
    fn lines(value: &Value, indent: usize, out: &mut String) {
        let Some(entries) = value.as_object() else { return };
        for (name, value) in entries {
            let text = match value {
                Value::Object(_) => {
                    out.push_str(&format!("{:indent$}{name}:\n", ""));
                    lines(value, indent + 2, out);
                    continue;
                }
                Value::Array(items) if items.iter().any(Value::is_object) => {
                    out.push_str(&format!("{:indent$}{name}:\n", ""));
                    for item in items {
                        lines(item, indent + 2, out);
                        out.push('\n');
                    }
                    continue;
                }
                Value::String(s) => s.clone(),
                Value::Array(a) if a.is_empty() => "none".into(),
                Value::Array(a) if a.iter().all(Value::is_string) => {
                    a.iter().filter_map(Value::as_str).collect::<Vec<_>>().join("; ")
                }
                other => other.to_string(),
            };
            out.push_str(&format!("{:indent$}{name:<14} {text}\n", ""));
        }
    }
    let mut out = String::new();
    lines(report, 0, &mut out);
    // Text of a file must not move a terminal's cursor.
    out.trim_end().replace(|c: char| c.is_control() && c != '\n', " ")
}

/// Deviations of a kind from the common parameters.
fn notes(kind: &Kind) -> &'static str {
    match kind.size {
        DefaultSize::Across(_) => "; progress=0..1; no size: it affects the whole scene",
        _ => "; progress=0..1",
    }
}

/// Presets, kinds, looks, lights, mesh deformers and phantoms as text.
pub fn catalogue() -> String {
    let mut out = String::from("Presets (--preset)\n");
    for p in transfer::list() {
        out.push_str(&format!("  {:<22} {}\n", p.name, p.about));
    }
    out.push_str(
        "\nDeformations (--deform KIND:name=value,...); every kind accepts center, size (not where\n\
         noted), rotate, storage, add, spare, labels, mapping and fade; every kind except map also resolution;\n\
         without center and size a kind lies on the visible surface, or about the volume's centre with\n\
         placement=volume\n",
    );
    for k in kinds::list() {
        out.push_str(&format!("  {:<22} {}{}\n", k.name, k.about, notes(k)));
        for p in k.parameters {
            let unit = match p.unit {
                Unit::Mm => ", mm",
                Unit::Degrees => ", degrees",
                Unit::None => "",
            };
            out.push_str(&format!(
                "    {:<20} {}{unit}; default {}, from {} to {}\n",
                p.name, p.about, p.default, p.min, p.max
            ));
        }
        for s in k.own_settings() {
            out.push_str(&format!("    {:<20} {}\n", s.name, s.about));
        }
    }
    for k in FILE_KINDS {
        out.push_str(&format!("  {:<22} {}\n", k.name, k.about));
        for s in k.own_settings {
            out.push_str(&format!("    {:<20} {}\n", s.name, s.about));
        }
    }
    out.push_str("\nSurface looks (--look)\n");
    for (name, about, _) in LOOKS {
        out.push_str(&format!("  {name:<22} {about}\n"));
    }
    out.push_str("\nLights (--light PRESET,key=value,...)\n");
    for p in LIGHT_PRESETS {
        out.push_str(&format!("  {:<22} {}\n", p.name, p.about));
    }
    out.push_str("\nForward deformers of meshes ([[mesh.deformer]] in scenes)\n");
    for (name, about, parameters) in DEFORMERS {
        out.push_str(&format!("  {name:<22} {about}: {parameters}\n"));
    }
    out.push_str("\nPhantoms (phantom:NAME[:size=N][:spacing=AxBxC][:sampling=function])\n");
    for (name, about) in phantom::list() {
        out.push_str(&format!("  {name:<22} {about}\n"));
    }
    out.push_str(
        "\nFunctions of x, y and z in mm, as volumes in a 160 mm cube (function:EXPRESSION[:size=N][:spacing=AxBxC]):\n\
         arithmetic, ^, <, >, numbers, pi and\n",
    );
    for (name, parameters, about) in FUNCTIONS {
        out.push_str(&format!(
            "  {:<22} {about}\n",
            format!("{name}({})", parameters.join(","))
        ));
    }
    out.trim_end().to_owned()
}
