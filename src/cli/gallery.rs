//! `incise gallery`: every kind of deformation on a volume and on the checker phantom, as pictures
//! and one page.

use super::progress::TerminalProgress;
use crate::deform::kinds::{self, Kind, Unit};
use crate::engine::{Engine, RenderRequest};
use crate::export::protect;
use crate::files::OutputFile;
use crate::files::path_text::text_of;
use crate::prepare::Assets;
use crate::scene::{Scene, example};
use crate::{Error, Result};
use clap::Args;
use std::path::PathBuf;

/// Options as typed.
#[derive(Args)]
pub struct GalleryArguments {
    /// The folder to write; made if it does not exist.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// The volume to show next to the checker phantom.
    #[arg(long, default_value = "phantom:head-ct")]
    volume: PathBuf,
    /// Edge length of each picture, in pixels.
    #[arg(long, default_value_t = 320)]
    edge: u32,
    /// Render only these kinds of deformation.
    #[arg(long)]
    kind: Vec<String>,
    /// No progress.
    #[arg(short, long)]
    quiet: bool,
}

/// Renders all pictures.
pub fn run(arguments: &GalleryArguments) -> Result<()> {
    let wanted: Vec<&Kind> = if arguments.kind.is_empty() {
        kinds::list().collect()
    } else {
        arguments
            .kind
            .iter()
            .map(|name| kinds::kind(name))
            .collect::<Result<_>>()?
    };
    if !(16..=2048).contains(&arguments.edge) {
        return Err(Error::value(
            "--edge",
            format!("{} is outside 16 to 2048 pixels", arguments.edge),
        ));
    }
    // One name stands for all pictures: none may end up among the slices of an input folder.
    protect(
        "--output",
        &arguments.output.join("picture.png"),
        [arguments.volume.as_path()],
    )?;
    std::fs::create_dir_all(&arguments.output).map_err(|e| Error::io(&arguments.output, "making", e))?;
    let own = text_of(&arguments.volume);
    let bar = TerminalProgress::new(arguments.quiet);
    let volumes = [("volume", own.as_str()), ("checker", "phantom:checker")];
    let loaded = volumes.map(|(_, path)| Assets::load(&Scene::of_volume(path)));
    let [a, b] = loaded;
    let assets = [a?, b?];
    let mut engine = Engine::cpu();
    let mut rows = String::new();
    let all = wanted.len() * volumes.len();
    let mut notes = Vec::new();
    for (n, kind) in wanted.iter().enumerate() {
        let mut cells = String::new();
        for (m, (label, path)) in volumes.iter().enumerate() {
            bar.set("rendering", (n * volumes.len() + m) as f32 / all as f32);
            let scene = example::of_kind(kind, path, arguments.edge, &assets[m].volume.bounds_in_world());
            let picture = engine
                .picture(&scene, &assets[m], &RenderRequest::default())
                .map(|p| p.rendered.picture);
            match picture {
                Ok(picture) => {
                    let file = format!("{}-{label}.png", kind.name);
                    OutputFile::create(&arguments.output.join(&file))?
                        .finish(&picture.png(scene.render.background)?)?;
                    cells.push_str(&format!(
                        "<td><img src=\"{file}\" alt=\"{} on the {label}\"></td>",
                        kind.name
                    ));
                }
                // Some kinds need a surface or labels, which a volume may lack.
                Err(e) => {
                    notes.push(format!("{} on {path}: {e}", kind.name));
                    cells.push_str("<td>not available for this volume</td>");
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
            about.push_str(&format!(
                "<dt>{}</dt><dd>{}{unit}; default {}, from {} to {}</dd>",
                p.name, p.about, p.default, p.min, p.max
            ));
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
    OutputFile::create(&arguments.output.join("index.html"))?.finish(page.as_bytes())?;
    bar.finish();
    if !arguments.quiet {
        for note in notes {
            super::print_to_stderr(note);
        }
    }
    Ok(())
}
