//! Scene files: TOML in, TOML out, unknown keys named with the closest known one.

use super::{FORMAT_VERSION, Scene, deformations};
use crate::deform::kinds;
use crate::error::suggestion;
use crate::files::input;
use crate::{Error, Result};
use serde_json::Value;
use std::path::Path;

impl Scene {
    /// Reads a scene file.
    ///
    /// # Errors
    /// A file that cannot be read, is not TOML, has an unknown key (named, with the closest known one) or a value of the wrong type.
    pub fn load(path: &Path) -> Result<Self> {
        let text = input::text(path, input::MAX_SCENE_BYTES, "scene")?;
        let mut scene = Self::from_toml(&text).map_err(|problem| Error::file(path, problem))?;
        scene.folder = path.parent().map(Path::to_owned).unwrap_or_default();
        Ok(scene)
    }

    /// Parses scene text; the error is one sentence without a file name.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        if text.trim().is_empty() {
            return Err("is empty; a scene needs at least `incise = 1` and a [volume] with a path".into());
        }
        let table: toml::Table = text.parse().map_err(|e: toml::de::Error| format!("is not valid TOML: {}", e.to_string().trim_end()))?;
        let value = serde_json::to_value(&table).map_err(|e| e.to_string())?;
        unknown_keys(&schema(), &schema(), &value, "")?;
        let scene: Self = toml::from_str(text).map_err(|e| e.to_string().trim_end().to_owned())?;
        if scene.incise != FORMAT_VERSION {
            return Err(format!("is of format version {}; this program reads version {FORMAT_VERSION}", scene.incise));
        }
        if scene.volume.is_none() && scene.mesh.is_empty() {
            return Err("shows nothing; it needs a [volume] with a path or a [[mesh]]".into());
        }
        Ok(scene)
    }

    /// The scene as a file's text.
    ///
    /// # Errors
    /// None that a scene can cause; the serialiser's own.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string_pretty(self).map_err(|e| Error::value("scene", e.to_string()))
    }
}

/// The JSON schema of the format.
pub fn schema() -> Value {
    schemars::schema_for!(Scene).to_value()
}

/// Names of a kind's parameters and settings; none if there is no such kind.
fn parameters(kind: &str) -> Option<Vec<&'static str>> {
    if let Some(file) = deformations::FILE_KINDS.iter().find(|k| k.name == kind) {
        return Some(file.settings.iter().map(|s| s.name).collect());
    }
    let kind = kinds::kind(kind).ok()?;
    Some(kind.parameters.iter().map(|p| p.name).chain(kind.settings().map(|s| s.name)).collect())
}

/// Compares the keys of a value with a schema's.
fn unknown_keys(root: &Value, schema: &Value, value: &Value, path: &str) -> Result<(), String> {
    let schema = resolve(root, schema);
    match value {
        Value::Array(items) => {
            if let Some(of_items) = schema.get("items") {
                for item in items {
                    unknown_keys(root, of_items, item, path)?;
                }
            }
        }
        Value::Object(entries) => {
            let Some(properties) = schema.get("properties").and_then(Value::as_object) else { return Ok(()) };
            for (key, entry) in entries {
                let full = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                if let Some(of_key) = properties.get(key) {
                    unknown_keys(root, of_key, entry, &full)?;
                    continue;
                }
                let mut known: Vec<&str> = properties.keys().map(String::as_str).collect();
                if path.ends_with(".deformer") && entry.is_number() {
                    // Numbers of a deformer are checked by its kind when it is made.
                    continue;
                }
                if path == "deformation" {
                    // A deformation's further keys are its kind's parameters.
                    let Some(own) = entries.get("kind").and_then(Value::as_str).and_then(parameters) else { continue };
                    if own.contains(&key.as_str()) {
                        continue;
                    }
                    known.extend(own);
                }
                return Err(format!("has the unknown key \"{full}\"; {}", suggestion(key, known)));
            }
        }
        _ => {}
    }
    Ok(())
}

/// Follows `$ref`, and the object among the alternatives of an optional section.
fn resolve<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    if let Some(reference) = schema.get("$ref").and_then(Value::as_str) {
        return root.pointer(reference.trim_start_matches('#')).map_or(schema, |s| resolve(root, s));
    }
    if let Some(section) = schema.get("anyOf").and_then(Value::as_array).and_then(|a| a.iter().find(|s| s.get("$ref").is_some())) {
        return resolve(root, section);
    }
    schema
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Deformation, Size};

    fn error(text: &str) -> String {
        Scene::from_toml(text).err().unwrap_or_else(|| panic!("accepted: {text}"))
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
        assert_eq!(Scene::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}")), scene);
    }

    #[test]
    fn unknown_keys_are_named_with_the_closest_known_one() {
        let head = "incise = 1\n[volume]\npath = \"phantom:ball\"\n";
        for (extra, key, close) in [
            ("[camera]\nzom = 2.0\n", "camera.zom", "zoom"),
            ("[[deformation]]\nkind = \"peel\"\ndeph = 3.0\n", "deformation.deph", "depth"),
            ("[lihgt]\n", "lihgt", "light"),
            ("[volume.inside]\npth = \"x\"\n", "volume.inside.pth", "path"),
            ("[[mesh]]\npath = \"x\"\n[[mesh.deformer]]\nkind = \"twist\"\ncentre = [0, 0, 0]\n", "mesh.deformer.centre", "center"),
            ("[[transfer.points]]\nvalue = 1.0\ncolour = [0,0,0]\nopacity = 1.0", "transfer.points.colour", "color"),
        ] {
            let message = error(&format!("{head}{extra}"));
            assert!(message.contains(&format!("\"{key}\"")) && message.contains(close), "{message}");
        }
    }

    #[test]
    fn empty_and_broken_scenes_say_so() {
        assert!(error("").contains("empty"));
        assert!(error("incise = 1").contains("volume"));
        assert!(error("incise = 2\n[volume]\npath=\"x\"").contains("version 2"));
        assert!(error("incise = ").contains("TOML"));
    }
}
