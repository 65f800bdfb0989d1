//! Every setting of a scene acts: changing it changes a picture, or (where a picture must not change)
//! the number of samples. Where it cannot act, a notice names it.

use incise::cpu;
use incise::picture::Rendered;
use incise::prepare::{Assets, Prepared};
use incise::scene::Scene;
use incise::scene::file::schema;
use toml::{Table, Value};

const VOLUME: &str = r#"
incise = 1
[volume]
path = "phantom:head-ct:size=48"
[[deformation]]
kind = "knife"
[[deformation]]
kind = "twist"
progress = 0.3
[camera]
view = "40,20"
[render]
size = [64, 64]
"#;
const RELATIVE: &str = r#"
incise = 2
[volume]
path = "phantom:head-ct:size=48"
[transfer]
preset = "mr-default"
[render]
size = [64, 64]
"#;
const SLICES: &str = r#"
incise = 1
[volume]
path = "phantom:head-ct:size=48"
[transfer]
preset = "ct-bones-and-muscle"
[camera]
view = "40,20"
[render]
mode = "slice"
size = [64, 64]
slice_order = "front-to-back"
"#;
const POINTS: &str = r#"
incise = 2
[volume]
path = "phantom:head-ct:size=48"
[transfer]
points = [{ value = 0.0, color = [1.0, 0.0, 0.0], opacity = 0.0 }, { value = 300.0, color = [0.0, 1.0, 0.0], opacity = 0.9 }]
[render]
size = [64, 64]
"#;
const COLORS: &str = r#"
incise = 1
[volume]
path = "COLORED"
[render]
size = [64, 64]
"#;
const SHADOWS: &str = r#"
incise = 1
[volume]
path = "phantom:head-ct:size=48"
[[deformation]]
kind = "half-space"
[camera]
view = "40,20"
[light]
shadow = true
occlusion = true
[render]
size = [64, 64]
"#;
const ISO: &str = r#"
incise = 1
[volume]
path = "phantom:head-ct:size=48"
[camera]
view = "40,20"
[render]
size = [64, 64]
iso = 200.0
"#;
const REMOVAL: &str = r#"
incise = 1
[volume]
path = "phantom:head-ct:size=48"
[[deformation]]
kind = "wedge"
[render]
size = [64, 64]
"#;
const SURFACE: &str = r#"
incise = 1
[[mesh]]
shape = [{ kind = "sphere", radius = 40.0 }]
[[deformation]]
kind = "half-space"
[[deformation]]
kind = "twist"
[camera]
view = "40,55"
[surface]
steps = "threshold"
[render]
mode = "surface"
size = [64, 64]
"#;
const BUNNY: &str = r#"
incise = 1
[[mesh]]
path = "bunny.obj"
size = 100.0
[[deformation]]
kind = "twist"
size = 60.0
[surface]
two_stage = true
[render]
mode = "surface"
size = [64, 64]
"#;
const VALUE: &str = r#"
incise = 1
[volume]
path = "phantom:head-ct:size=32"
[render]
mode = "surface"
size = [64, 64]
"#;

/// A scene, a setting and its other value; and whether that changes the picture (else the samples).
const ACTS: &[(&str, &str, &str, bool)] = &[
    (VOLUME, "render.mode", "\"slice\"", true),
    (VOLUME, "render.size", "[32, 48]", true),
    (VOLUME, "render.step", "0.5", true),
    (VOLUME, "render.antialias", "2", true),
    (VOLUME, "render.normals", "\"source\"", true),
    (VOLUME, "render.filter", "\"cubic\"", true),
    (VOLUME, "render.gradient", "\"sobel\"", true),
    (VOLUME, "render.empty_space_skipping", "false", false),
    (VOLUME, "render.early_termination", "false", false),
    (SLICES, "render.early_termination", "false", false),
    (REMOVAL, "render.exact_cuts", "false", true),
    (VOLUME, "render.cut_faces", "\"grey\"", true),
    (VOLUME, "render.iso", "150.0", true),
    (ISO, "render.iso_light", "\"derivative\"", true),
    (SLICES, "render.preintegrated", "true", true),
    (VOLUME, "render.preintegrated", "true", true),
    (VOLUME, "render.jitter", "true", true),
    (SLICES, "render.jitter", "true", true),
    (SLICES, "render.slab", "8", true),
    (SLICES, "render.slice_order", "\"back-to-front\"", true),
    (SLICES, "render.blend_format", "\"float16\"", true),
    (VOLUME, "render.precompose", "0.5", true),
    (VOLUME, "render.jacobian", "\"stored\"", true),
    (VOLUME, "render.map_filter", "\"hardware\"", true),
    (VOLUME, "light.ambient", "0.9", true),
    (VOLUME, "light.diffuse", "0.1", true),
    (VOLUME, "light.specular", "0.9", true),
    (VOLUME, "light.shininess", "2.0", true),
    (VOLUME, "light.direction", "[1.0, 0.0, 0.2]", true),
    (VOLUME, "light.azimuth", "70.0", true),
    (VOLUME, "light.elevation", "60.0", true),
    (VOLUME, "light.key_color", "[1.0, 0.5, 0.2]", true),
    (VOLUME, "light.sky_color", "[0.2, 0.5, 1.0]", true),
    (VOLUME, "light.follows_camera", "false", true),
    (VOLUME, "light.two_sided", "false", true),
    (VOLUME, "light.shadow", "true", true),
    (VOLUME, "light.occlusion", "true", true),
    (SHADOWS, "light.radius", "20.0", true),
    (SHADOWS, "light.occlusion_mm", "5.0", true),
    (SHADOWS, "light.quality", "\"reference\"", true),
    (SURFACE, "light.shadow", "true", true),
    (SURFACE, "light.direction", "[1.0, 0.0, 0.2]", true),
    (SURFACE, "light.azimuth", "70.0", true),
    (SURFACE, "light.key_color", "[1.0, 0.5, 0.2]", true),
    (SURFACE, "light.sky_color", "[0.2, 0.5, 1.0]", true),
    (SURFACE, "light.follows_camera", "false", true),
    (VALUE, "surface.iso", "500.0", true),
    (SURFACE, "surface.look", "\"gold\"", true),
    (SURFACE, "surface.color", "[1.0, 0.0, 0.0]", true),
    (SURFACE, "surface.inside_color", "[1.0, 0.0, 0.0]", false),
    (SURFACE, "surface.cut_color", "[1.0, 0.0, 0.0]", true),
    (SURFACE, "surface.model", "\"hollow\"", true),
    (SURFACE, "surface.thickness", "9.0", false),
    (SURFACE, "surface.steps", "\"uniform\"", false),
    (SURFACE, "surface.threshold", "0.5", false),
    (SURFACE, "surface.cut_skipping", "false", false),
    (BUNNY, "surface.two_stage", "false", true),
    (BUNNY, "surface.seam", "6.0", true),
    (BUNNY, "surface.resolution", "40", true),
    (VOLUME, "camera.view", "\"left\"", true),
    (VOLUME, "camera.zoom", "1.5", true),
    (VOLUME, "camera.projection", "\"orthographic\"", true),
    (VOLUME, "camera.field_of_view", "60.0", true),
    (VOLUME, "camera.roll", "20.0", true),
    (VOLUME, "camera.target", "[20.0, 0.0, 0.0]", true),
    (VOLUME, "transfer.preset", "\"ct-bones-and-muscle\"", true),
    (RELATIVE, "transfer.relative_to", "\"range\"", true),
    (RELATIVE, "render.antialias", "1", true),
    (VOLUME, "transfer.window", "300.0", true),
    (VOLUME, "transfer.level", "300.0", true),
    (SLICES, "transfer.density", "0.2", true),
    (
        VOLUME,
        "transfer.points",
        "[{ value = 0.0, color = [1.0, 0.0, 0.0], opacity = 0.0 }, { value = 300.0, color = [0.0, 1.0, 0.0], opacity = 0.9 }]",
        true,
    ),
    (
        VOLUME,
        "transfer.gradient_opacity",
        "[{ magnitude = 0.0, factor = 0.0 }, { magnitude = 300.0, factor = 1.0 }]",
        true,
    ),
    (COLORS, "transfer.own_colors", "false", true),
    (VOLUME, "transfer.blend", "\"mip\"", true),
];

/// A scene in which a setting has no effect, the setting, and its other value.
const IDLE: &[(&str, &str, &str)] = &[
    (SURFACE, "render.normals", "\"source\""),
    (SURFACE, "render.gradient", "\"sobel\""),
    (SURFACE, "render.cut_faces", "\"grey\""),
    (SURFACE, "render.preintegrated", "true"),
    (SURFACE, "render.jitter", "true"),
    (SURFACE, "render.iso_light", "\"derivative\""),
    (SURFACE, "render.slab", "8"),
    (SURFACE, "render.slice_order", "\"front-to-back\""),
    (SURFACE, "render.blend_format", "\"float16\""),
    (SURFACE, "render.early_termination", "false"),
    (SURFACE, "light.two_sided", "false"),
    (SURFACE, "light.quality", "\"reference\""),
    (SHADOWS, "light.two_sided", "false"),
    (VOLUME, "light.radius", "5.0"),
    (VOLUME, "light.occlusion_mm", "5.0"),
    (VOLUME, "light.quality", "\"reference\""),
    (SURFACE, "surface.seam", "6.0"),
    (SURFACE, "surface.two_stage", "true"),
    (VOLUME, "render.slab", "8"),
    (POINTS, "transfer.relative_to", "\"range\""),
    (VOLUME, "render.slice_order", "\"front-to-back\""),
    (VOLUME, "render.blend_format", "\"float16\""),
    (VOLUME, "render.iso_light", "\"derivative\""),
    (VOLUME, "surface.steps", "\"uniform\""),
    (VOLUME, "surface.cut_skipping", "false"),
    (VOLUME, "surface.two_stage", "true"),
    (VOLUME, "surface.model", "\"hollow\""),
    (VOLUME, "transfer.own_colors", "false"),
    (SLICES, "render.cut_faces", "\"grey\""),
    (SLICES, "render.precompose", "0.5"),
    (SLICES, "render.exact_cuts", "false"),
    (SLICES, "render.jacobian", "\"stored\""),
    (SLICES, "render.map_filter", "\"hardware\""),
    (ISO, "render.preintegrated", "true"),
    (BUNNY, "surface.threshold", "0.5"),
];

fn with(scene: &str, change: Option<(&str, &str)>) -> Scene {
    let mut table: Table = scene.parse().unwrap();
    if let Some((key, value)) = change {
        let (section, name) = key.split_once('.').unwrap();
        let value: Table = format!("value = {value}").parse().unwrap();
        table
            .entry(section)
            .or_insert_with(|| Value::Table(Table::new()))
            .as_table_mut()
            .unwrap()
            .insert(name.to_owned(), value["value"].clone());
    }
    let mut scene = Scene::from_toml(&table.to_string()).unwrap_or_else(|e| panic!("{change:?}: {e}"));
    scene.folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("volumes");
    scene
}

/// A volume of 8^3 voxels with colours of their own.
fn colored(path: &std::path::Path) {
    let mut file = b"NRRD0004\ntype: unsigned char\ndimension: 4\nsizes: 3 8 8 8\nkinds: RGB-color domain domain domain\n\
        space: left-posterior-superior\nspace directions: none (2,0,0) (0,2,0) (0,0,2)\nencoding: raw\n\n"
        .to_vec();
    for n in 0..512usize {
        file.extend([n % 8 * 30, n / 8 % 8 * 30, 40 + n / 64 * 25].map(|v| v as u8));
    }
    std::fs::write(path, file).unwrap();
}

fn rendered(scene: &Scene) -> Rendered {
    let mut scene = scene.clone();
    let folder = tempfile::tempdir().unwrap();
    if let Some(volume) = scene.volume.as_mut().filter(|v| v.path == "COLORED") {
        let path = folder.path().join("colored.nrrd");
        colored(&path);
        volume.path = path.to_string_lossy().into_owned();
    }
    let scene = &scene;
    let assets = Assets::load(scene).unwrap_or_else(|e| panic!("{e}"));
    cpu::render(&Prepared::new(scene, &assets).unwrap_or_else(|e| panic!("{e}")))
}

pub fn every_setting_acts() {
    for (scene, key, value, on_picture) in ACTS {
        // The thickness and the inside of a surface need a model that has them.
        let model = match *key {
            "surface.inside_color" => Some("\"hollow\""),
            "surface.thickness" => Some("\"thick\""),
            _ => None,
        };
        let text = match model {
            Some(model) => scene.replace("[surface]", &format!("[surface]\nmodel = {model}")),
            None => (*scene).to_owned(),
        };
        let [before, after] = [None, Some((*key, *value))].map(|change| rendered(&with(&text, change)));
        let same = before.picture == after.picture;
        if *on_picture || model.is_some() {
            assert!(!same, "{key} = {value} changes no pixel");
        } else {
            let [a, b] = [&before, &after].map(|r| r.stats.unwrap());
            assert!(
                (a.samples_taken, a.samples_skipped, a.samples_terminated)
                    != (b.samples_taken, b.samples_skipped, b.samples_terminated),
                "{key} = {value} changes no sample: {a:?}"
            );
        }
        let idle = after
            .notices
            .iter()
            .find(|n| n.contains("has no effect here") && n.starts_with(key));
        assert_eq!(idle, None, "{key} = {value} acts");
    }
}

pub fn settings_without_effect_are_named() {
    for (scene, key, value) in IDLE {
        let [before, after] = [None, Some((*key, *value))].map(|change| rendered(&with(scene, change)));
        let named = |r: &Rendered| {
            r.notices
                .iter()
                .any(|n| n.starts_with(&format!("{key} has no effect here")))
        };
        assert!(named(&after), "{key} = {value}: {:?}", after.notices);
        assert!(!named(&before), "{key} is not stated");
        assert!(before.picture == after.picture, "{key} = {value} has an effect");
    }
}

/// Every switch, choice and list of the format is in the tables.
pub fn every_setting_is_tested() {
    let schema = schema();
    let definitions = &schema["$defs"];
    let is_choice = |property: &serde_json::Value| {
        let of = |p: &serde_json::Value| {
            p["$ref"].as_str().is_some_and(|r| {
                let target = &definitions[r.rsplit('/').next().unwrap()];
                target.get("enum").is_some() || target.get("oneOf").is_some()
            })
        };
        let types = property["type"].to_string();
        of(property)
            || property["anyOf"].as_array().is_some_and(|all| all.iter().any(of))
            || types.contains("boolean")
            || types.contains("array")
    };
    for (section, definition) in [
        ("render", "RenderSettings"),
        ("light", "Light"),
        ("surface", "SurfaceSettings"),
        ("camera", "Camera"),
        ("transfer", "TransferSettings"),
    ] {
        let properties = definitions[definition]["properties"].as_object().unwrap();
        assert!(properties.len() > 5, "{definition}");
        for (name, property) in properties {
            let key = format!("{section}.{name}");
            assert!(
                !is_choice(property) || key == "render.background" || ACTS.iter().any(|(_, k, ..)| *k == key),
                "{key} is not tested"
            );
        }
    }
}
