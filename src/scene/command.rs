//! A scene, and a deformation, as an equivalent command line.

use super::{DefaultPlacement, Deformation, Mode, Projection, Scene, Size};
use crate::deform::{Argument, Storage};
use std::path::Path;

/// `incise render FILE -o picture.png ...`: the scene file, with the camera and the render settings
/// as options that override it.
///
/// Everything else (deformations, transfer function, meshes) comes from the file, which must hold
/// this scene unchanged.
pub fn render_command(scene: &Scene, file: &Path, output: &str) -> String {
    let camera = &scene.camera;
    let [width, height] = scene.render.size;
    let mode = match scene.render.mode {
        Mode::Slice => "slice",
        Mode::Raycast => "raycast",
        Mode::Surface => "surface",
    };
    let projection = match camera.projection {
        Projection::Perspective => "perspective",
        Projection::Orthographic => "orthographic",
    };
    let mut words = vec![
        "incise".to_owned(),
        "render".into(),
        quoted(&file.to_string_lossy()),
        "-o".into(),
        quoted(output),
    ];
    let mut option = |name: &str, value: String| words.extend([name.to_owned(), value]);
    option("--mode", mode.into());
    option("--size", format!("{width}x{height}"));
    option("--step", scene.render.step.to_string());
    // A pan or roll of the camera exists only in the file, and the option would reset it.
    if camera.target.is_none() && camera.roll == 0.0 {
        option("--camera", quoted(&String::from(camera.view)));
        option("--zoom", camera.zoom.to_string());
        option("--projection", projection.into());
    }
    words.join(" ")
}

/// The value of `--deform` that states a deformation: `KIND:name=value,...`, quoted for a shell.
pub fn deform_argument(deformation: &Deformation) -> String {
    fn list<T: std::fmt::Display>(items: impl IntoIterator<Item = T>) -> String {
        let words: Vec<String> = items.into_iter().map(|v| v.to_string()).collect();
        words.join(",")
    }
    let Deformation {
        kind,
        name: _,
        enabled: _,
        placement,
        center,
        size,
        rotate,
        matrix: _,
        progress,
        add,
        storage,
        resolution,
        parameters,
    } = deformation;
    let storage = storage.map(|storage| match storage {
        Storage::F16 => "f16",
        Storage::Snorm16 => "snorm16",
        Storage::Snorm8 => "snorm8",
        Storage::F32 => "f32",
    });
    let common = [
        (
            "placement",
            (*placement == DefaultPlacement::Volume).then(|| "volume".to_owned()),
        ),
        ("center", center.map(list)),
        (
            "size",
            size.map(|size| match size {
                Size::Cube(mm) => mm.to_string(),
                Size::Box(mm) => list(mm),
            }),
        ),
        ("rotate", rotate.map(list)),
        ("progress", progress.map(|v| v.to_string())),
        ("add", add.then(|| "true".to_owned())),
        ("storage", storage.map(str::to_owned)),
        ("resolution", resolution.map(|n| n.to_string())),
    ];
    let own = parameters.0.iter().map(|(name, value)| {
        let text = match value {
            Argument::Flag(v) => v.to_string(),
            Argument::Number(v) => v.to_string(),
            Argument::Text(text) => text.clone(),
            Argument::Numbers(v) => list(v),
            Argument::Texts(texts) => list(texts),
            Argument::Rows(rows) => list(rows.concat()),
        };
        format!("{name}={text}")
    });
    let stated = common
        .into_iter()
        .filter_map(|(name, value)| Some(format!("{name}={}", value?)));
    let entries: Vec<String> = stated.chain(own).collect();
    quoted(&match &entries[..] {
        [] => kind.clone(),
        entries => format!("{kind}:{}", entries.join(",")),
    })
}

/// A word quoted for a shell.
fn quoted(word: &str) -> String {
    let plain = !word.is_empty()
        && word
            .chars()
            .all(|c| c.is_alphanumeric() || "/._-:,=+".contains(c));
    if plain {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_survive_a_shell() {
        let scene = Scene::of_volume("phantom:ball");
        let line = render_command(&scene, Path::new("it's here.toml"), "a.png");
        assert!(
            line.starts_with("incise render 'it'\\''s here.toml' -o a.png --mode raycast --size 512x512 --step 1 --camera anterior --zoom 1 "),
            "{line}"
        );
    }
}
