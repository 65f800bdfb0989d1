//! `incise gallery`: every kind of deformation on a volume and on the checker phantom, as pictures and one page.

use super::progress::Progress;
use crate::deform::kinds::{self, Kind, Unit};
use crate::export::{Output, png};
use crate::math::Bounds;
use crate::scene::{Assets, Deformation, Prepared, Scene, Size};
use crate::{Error, Result, cpu};
use clap::Args;
use glam::Vec3;
use std::path::PathBuf;

/// Options as typed.
#[derive(Args)]
pub struct Arguments {
    /// The folder to write; made if it does not exist.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// The volume that is shown beside the checker phantom.
    #[arg(long, default_value = "phantom:head-ct")]
    volume: PathBuf,
    /// Edge of a picture, pixels.
    #[arg(long, default_value_t = 320)]
    edge: u32,
    /// Only these kinds.
    #[arg(long)]
    kind: Vec<String>,
    /// No progress.
    #[arg(short, long)]
    quiet: bool,
}

/// Where a kind shows best: centre and size in shares of the volume's extent from its middle; rotation in degrees.
type Place = ([f32; 3], [f32; 3], [f32; 3]);

/// On top, somewhat to the front and left, where the camera looks.
const ON_TOP: Place = ([0.05, -0.05, 0.38], [0.75, 0.6, 0.5], [0.0, 0.0, 0.0]);
const CORNER: Place = ([0.25, -0.28, 0.28], [0.5, 0.5, 0.5], [0.0, 0.0, 0.0]);

fn place(kind: &str) -> Option<Place> {
    Some(match kind {
        "pull" | "spline-pull" => ([0.0, 0.0, 0.25], [0.7, 0.7, 0.7], [0.0; 3]),
        "peel" => ON_TOP,
        "knife" | "retractor" => ([0.12, -0.12, 0.18], [0.75, 0.6, 0.5], [10.0, 20.0, 30.0]),
        "seam" => ([0.0, 0.0, 0.12], [1.2, 0.8, 0.8], [0.0, 0.0, 30.0]),
        "bulge" => CORNER,
        "box" | "sphere" | "view-sphere" => CORNER,
        "cylinder" => ([0.2, -0.2, 0.1], [0.4, 0.4, 1.2], [0.0; 3]),
        "wedge" => ([0.0, 0.0, 0.3], [1.3, 1.3, 0.8], [0.0, 0.0, -55.0]),
        "elastic" => ([0.1, -0.1, 0.2], [0.8, 0.8, 0.8], [0.0; 3]),
        "lattice" => ([0.0, 0.0, 0.25], [1.1, 1.1, 1.1], [0.0; 3]),
        "strip" => ([0.2, -0.2, 0.25], [0.8, 0.8, 0.7], [0.0; 3]),
        _ => return None,
    })
}

/// The scene that shows a kind: its defaults, at full strength, where the camera sees it.
fn scene_of(kind: &Kind, volume: &str, edge: u32, assets: &Assets) -> Scene {
    let mut scene = Scene::of_volume(volume);
    scene.render.size = [edge, edge];
    scene.camera.view = crate::scene::View { azimuth_deg: 35.0, elevation_deg: 30.0 };
    let mut deformation = Deformation::new(kind.name);
    let bounds = assets.volume.bounds_in_world();
    let (mut center, mut size) = (bounds.center(), kind.default_size(&bounds));
    if let Some((at, extent, rotate)) = place(kind.name) {
        center += bounds.size() * Vec3::from(at);
        size = bounds.size() * Vec3::from(extent);
        deformation.center = Some(center.into());
        deformation.size = Some(Size::Box(size.into()));
        deformation.rotate = Some(rotate);
    }
    deformation.parameters = kind.example(&Bounds::new(center - size / 2.0, center + size / 2.0));
    scene.deformation.push(deformation);
    if kind.name == "lift" {
        // What is lifted off hides what it was lifted from.
        let mut wedge = Deformation::new("wedge");
        wedge.size = Some(Size::Box((bounds.size() * 2.0).into()));
        wedge.rotate = Some([0.0, 0.0, -55.0]);
        scene.deformation.push(wedge);
    }
    scene
}

/// Renders all.
pub fn run(arguments: &Arguments) -> Result<()> {
    let wanted: Vec<&Kind> = if arguments.kind.is_empty() {
        kinds::list().collect()
    } else {
        arguments.kind.iter().map(|name| kinds::kind(name)).collect::<Result<_>>()?
    };
    if !(16..=2048).contains(&arguments.edge) {
        return Err(Error::value("--edge", format!("{} is outside 16 to 2048 pixels", arguments.edge)));
    }
    std::fs::create_dir_all(&arguments.output).map_err(|e| Error::io(&arguments.output, "making", e))?;
    let own = arguments.volume.to_str().ok_or_else(|| Error::file(&arguments.volume, "has a name that is not valid Unicode; rename it"))?;
    let bar = Progress::new(arguments.quiet);
    let volumes = [("volume", own), ("checker", "phantom:checker")];
    let loaded = volumes.map(|(_, path)| Assets::load(&Scene::of_volume(path), &|_, _| ()));
    let [a, b] = loaded;
    let assets = [a?, b?];
    let mut rows = String::new();
    let all = wanted.len() * volumes.len();
    let mut notes = Vec::new();
    for (n, kind) in wanted.iter().enumerate() {
        let mut cells = String::new();
        for (m, (label, path)) in volumes.iter().enumerate() {
            bar.set("rendering", (n * volumes.len() + m) as f32 / all as f32);
            let scene = scene_of(kind, path, arguments.edge, &assets[m]);
            let picture = Prepared::new(&scene, &assets[m]).map(|p| cpu::render(&p, &|_| ()).picture);
            match picture {
                Ok(picture) => {
                    let file = format!("{}-{label}.png", kind.name);
                    Output::create(&arguments.output.join(&file))?.finish(&png(&picture, scene.render.background)?)?;
                    cells.push_str(&format!("<td><img src=\"{file}\" alt=\"{} on the {label}\"></td>", kind.name));
                }
                // Some kinds follow what a volume need not have: a surface, labels.
                Err(e) => {
                    notes.push(format!("{} on {path}: {e}", kind.name));
                    cells.push_str("<td>needs what this volume does not have</td>");
                }
            }
        }
        let mut about = format!("<h2>{}</h2><p>{}</p><dl>", kind.name, kind.about);
        for p in kind.parameters {
            let unit = match p.unit {
                Unit::Mm => ", mm",
                Unit::Degrees => ", degrees",
                Unit::None => "",
            };
            about.push_str(&format!("<dt>{}</dt><dd>{}{unit}; default {}, from {} to {}</dd>", p.name, p.about, p.default, p.min, p.max));
        }
        for s in kind.own_settings() {
            about.push_str(&format!("<dt>{}</dt><dd>{}</dd>", s.name, s.about));
        }
        rows.push_str(&format!("<tr><td>{about}</dl></td>{cells}</tr>\n"));
    }
    let page = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Deformations</title><style>body{{font:15px/1.4 sans-serif;margin:2em;background:#16171a;color:#ddd}}\
         td{{vertical-align:top;padding:.5em 1em .5em 0}}h2{{margin:.2em 0}}dt{{font-weight:bold}}dd{{margin:0 0 .2em 1em}}td:first-child{{max-width:28em}}</style>\
         <h1>Deformations</h1><table>{rows}</table></html>\n"
    );
    Output::create(&arguments.output.join("index.html"))?.finish(page.as_bytes())?;
    bar.finish();
    if !arguments.quiet {
        for note in notes {
            eprintln!("incise: {note}");
        }
    }
    Ok(())
}
