//! A scene as an equivalent command line.

use super::{Mode, Projection, Scene};
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
