//! Scene files: reading and writing TOML; unknown keys are reported with the closest known one.

use super::{FORMAT_VERSION, Scene, keys, migrate};
use crate::files::input;
use crate::{Error, Result};
use serde_json::Value;
use std::path::Path;

impl Scene {
    /// Reads a scene file.
    ///
    /// # Errors
    /// A file that cannot be read, is not TOML, or has an unknown key (reported with the closest
    /// known one) or a value of the wrong type.
    pub fn load(path: &Path) -> Result<Self> {
        let text = input::text(path, input::MAX_SCENE_BYTES, "scene")?;
        let mut scene = Self::from_toml(&text).map_err(|problem| Error::file(path, problem))?;
        scene.folder = path.parent().map(Path::to_owned).unwrap_or_default();
        Ok(scene)
    }

    /// Parses scene text; the error is one sentence without a file name.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        if text.trim().is_empty() {
            return Err("is empty; a scene needs at least `incise = 2` and a [volume] with a path".into());
        }
        let wrong = |e: &toml::de::Error| match e.span() {
            Some(span) => format!(
                "line {}: {}",
                1 + text.bytes().take(span.start).filter(|b| *b == b'\n').count(),
                e.message()
            ),
            None => e.message().to_owned(),
        };
        let mut table: toml::Table = text
            .parse()
            .map_err(|e: toml::de::Error| format!("is not valid TOML ({})", wrong(&e)))?;
        // Another version has other keys, so the version is checked first.
        let version = table.get("incise").and_then(toml::Value::as_integer);
        let known = i64::from(migrate::OLDEST_VERSION)..=i64::from(FORMAT_VERSION);
        if let Some(version) = version.filter(|v| !known.contains(v)) {
            return Err(format!(
                "has format version {version}; this program reads versions {} to {}",
                known.start(),
                known.end()
            ));
        }
        keys::check(&schema(), &table)?;
        // From the text, for line numbers in messages.
        let mut scene: Self = toml::from_str(text).map_err(|e| format!("cannot be used ({})", wrong(&e)))?;
        if version == Some(1) {
            migrate::from_version_1(&mut table);
            scene = table
                .try_into()
                .map_err(|e: toml::de::Error| format!("cannot be used ({})", e.message()))?;
        }
        if scene.volume.is_none() && scene.mesh.is_empty() {
            return Err("shows nothing; it needs a [volume] with a path or a [[mesh]]".into());
        }
        Ok(scene)
    }

    /// The scene as the text of a scene file.
    ///
    /// # Errors
    /// Only errors of the serialiser; no scene causes one.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string_pretty(self).map_err(|e| Error::value("scene", e.to_string()))
    }
}

/// The JSON schema of the format.
pub fn schema() -> Value {
    schemars::schema_for!(Scene).to_value()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Deformation, Size};

    fn error(text: &str) -> String {
        Scene::from_toml(text)
            .err()
            .unwrap_or_else(|| panic!("accepted: {text}"))
    }

    #[test]
    fn a_scene_comes_back_as_it_was() {
        let mut scene = Scene::of_volume("phantom:tomato");
        let mut peel = Deformation::new("peel");
        peel.size = Some(Size::Box([10.0, 20.0, 30.0]));
        peel.parameters.insert("depth", 5.0);
        scene.deformation = vec![peel, Deformation::new("pull")];
        scene.transfer.preset = Some("tomato".into());
        let text = scene.to_toml().unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(
            Scene::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}")),
            scene
        );
    }

    #[test]
    fn unknown_keys_are_named_with_the_closest_known_one() {
        let head = "incise = 1\n[volume]\npath = \"phantom:ball\"\n";
        for (extra, key, close) in [
            ("[camera]\nzom = 2.0\n", "camera.zom", "zoom"),
            (
                "[[deformation]]\nkind = \"peel\"\ndeph = 3.0\n",
                "deformation.deph",
                "depth",
            ),
            ("[lihgt]\n", "lihgt", "light"),
            ("[volume.inside]\npth = \"x\"\n", "volume.inside.pth", "path"),
            (
                "[[mesh]]\npath = \"x\"\n[[mesh.deformer]]\nkind = \"twist\"\ncentre = [0, 0, 0]\n",
                "mesh.deformer.centre",
                "center",
            ),
            (
                "[[transfer.points]]\nvalue = 1.0\ncolour = [0,0,0]\nopacity = 1.0",
                "transfer.points.colour",
                "color",
            ),
        ] {
            let message = error(&format!("{head}{extra}"));
            assert!(
                message.contains(&format!("\"{key}\"")) && message.contains(close),
                "{message}"
            );
        }
    }

    #[test]
    fn values_of_a_wrong_type_are_named() {
        let head = "incise = 1\n[volume]\npath = \"phantom:ball\"\n";
        for (extra, words) in [
            (
                "[[mesh]]\niso = \"high\"",
                "has the string \"high\" for \"mesh.iso\", which must be a number",
            ),
            (
                "[[mesh]]\n[[mesh]]\nlabel = 3",
                "has 3 for \"mesh 2.label\", which must be a list of numbers",
            ),
            (
                "[[mesh]]\nlabel = [1.5]",
                "has 1.5 for \"mesh.label\", which must be a whole number",
            ),
            (
                "[surface]\nthreshold = true",
                "has true for \"surface.threshold\", which must be a number",
            ),
            (
                "[surface]\nsteps = \"long\"",
                "must be one of \"uniform\", \"threshold\"",
            ),
            (
                "[volume.inside]\npath = \"x\"\nsize = [1, 2]",
                "has a list of length 2 for \"volume.inside.size\", which must be a number",
            ),
            (
                "[render]\nsize = [512]",
                "has a list of length 1 for \"render.size\", which must be a list of 2 numbers",
            ),
            (
                "[render]\nsize = [512, -1]",
                "has -1 for \"render.size\", which must be a whole number, 0 or more",
            ),
            (
                "[render]\nantialias = 2.0",
                "for \"render.antialias\", which must be \"adaptive\" or a whole number from 1 to 4",
            ),
            (
                "[camera]\nview = 3",
                "has 3 for \"camera.view\", which must be a string in quotes",
            ),
            (
                "[[deformation]]\nkind = \"peel\"\nsize = \"big\"",
                "for \"deformation.size\", which must be a number or a list of 3 numbers",
            ),
            (
                "[[deformation]]\nkind = \"peel\"\ndepth = [1, \"a\"]",
                "for \"deformation.depth\", which must be a number, a string",
            ),
            (
                "[[deformation]]\ncenter = [1, 2, 3]",
                "lacks the key \"kind\" in \"deformation\"",
            ),
            (
                "[[mesh]]\npath = \"x\"\n[[mesh.deformer]]\nkind = \"twist\"\nangle = \"far\"",
                "for \"mesh.deformer.angle\", which must be a number",
            ),
            ("[camera]\nview = \"above\"", "line 5: \"above\" is not a view"),
            ("[camera]\nzoom = 1\nzoom = 2", "line 6"),
        ] {
            let message = error(&format!("{head}{extra}"));
            assert!(
                message.contains(words) && !message.contains('\n'),
                "{extra}: {message}"
            );
        }
    }

    #[test]
    fn empty_and_broken_scenes_say_so() {
        assert!(error("").contains("empty"));
        assert!(error("incise = 1").contains("volume"));
        assert!(error("incise = 3\n[volume]\npath=\"x\"").contains("version 3"));
        assert!(error("incise = ").contains("TOML"));
    }
}
