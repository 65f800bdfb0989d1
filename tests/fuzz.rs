//! Random scenes over all keys, kinds and extreme values, generated from the schema of the format
//! and rendered in process at 64 x 64. The result must be a picture or one line that names the
//! error: never a panic, never more than 20 seconds, never an empty picture without a notice; and
//! the GPU's picture must match the CPU's.
//!
//! `INCISE_FUZZ_SCENES` sets the number of scenes (120 by default), `INCISE_FUZZ_FIRST` the first:
//! a scene is determined by its number. `INCISE_FUZZ_KEEP` names a folder in which all scenes are
//! saved.

use files::Files;
use incise::deform::file_kinds::FILE_KINDS;
use incise::deform::kinds::{self, Kind};
use incise::math::Bounds;
use incise::scene::{file, surface};
use incise::transfer;
use incise::volume::phantom::is_procedural;
use outcome::{Outcome, complaint, on_a_gpu, run};
use serde_json::Value as Schema;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use toml::Value;

mod files;
mod outcome;

/// Time limit of a scene of this size.
const MAX_SECONDS: f64 = 20.0;
/// A scene that takes this long is considered hung.
const HANGS: Duration = Duration::from_secs(300);
/// One in this many scenes is rendered on a GPU as well.
const ON_GPU: u64 = 5;

/// Random numbers seeded by the scene's number: splitmix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
    fn chance(&mut self, share: f64) -> bool {
        self.share() < share
    }
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.share()
    }
    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }
    fn one_of<'a, T: ?Sized>(&mut self, all: &[&'a T]) -> &'a T {
        all[self.below(all.len())]
    }
}

/// Values outside normal use.
const EXTREMES: [f64; 18] = [
    0.0,
    -0.0,
    -1.0,
    1.0,
    1e-30,
    -1e-30,
    1e30,
    -1e30,
    1e7,
    -1e7,
    9.9e6,
    1e-3,
    3.4e38,
    1e308,
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    2147483648.0,
];

const WORDS: [&str; 8] = [
    "",
    "x",
    "a name",
    "Größe π 脳",
    "\u{1b}[2J\u{7}",
    "../../etc/passwd",
    "nul\0inside",
    "a very long name indeed, longer than any that a person gives",
];

/// Keys added after the first ones of their section: drawn apart, so that all else of a scene of some
/// number stays what it was.
const LATER_KEYS: [&str; 5] = [
    "light.radius",
    "light.shadow",
    "light.occlusion",
    "light.occlusion_mm",
    "light.quality",
];

/// Generates scenes.
struct Maker<'a> {
    schema: &'a Schema,
    files: &'a Files,
    random: Random,
    /// The choices about keys of [`LATER_KEYS`].
    later: Random,
    /// Probability that a key is stated, and that a value is extreme.
    stated: f64,
    extreme: f64,
}

impl Maker<'_> {
    fn scene(&mut self) -> toml::Table {
        let mut scene = self.table(self.schema, "");
        scene.insert("incise".into(), Value::Integer(1 + self.random.below(2) as i64));
        // Most scenes show a volume, some a mesh, a few neither.
        if !self.random.chance(0.8) && scene.contains_key("mesh") {
            scene.remove("volume");
        } else if !scene.contains_key("volume") && self.random.chance(0.97) {
            scene.insert("volume".into(), self.section("VolumeSource", "volume"));
        }
        let render = scene
            .entry("render")
            .or_insert_with(|| Value::Table(toml::Table::new()));
        if let Some(render) = render.as_table_mut() {
            let size = if self.random.chance(0.05) {
                [1, 64]
            } else {
                [64, 64]
            };
            render.insert("size".into(), Value::Array(size.map(Value::Integer).to_vec()));
        }
        scene
    }

    fn section(&mut self, name: &str, path: &str) -> Value {
        Value::Table(self.table(&self.schema["$defs"][name].clone(), path))
    }

    fn resolved(&self, schema: &Schema) -> Schema {
        match schema.get("$ref").and_then(Schema::as_str) {
            Some(reference) => self.resolved(self.schema.pointer(reference.trim_start_matches('#')).unwrap()),
            None => schema.clone(),
        }
    }

    fn table(&mut self, schema: &Schema, path: &str) -> toml::Table {
        let schema = self.resolved(schema);
        let required: Vec<&str> = schema["required"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(Schema::as_str)
            .collect();
        let mut table = toml::Table::new();
        for (key, of_key) in schema["properties"].as_object().into_iter().flatten() {
            let wanted = match (path, key.as_str()) {
                _ if required.contains(&key.as_str()) => 1.0,
                ("", "deformation") => 0.8,
                ("", "mesh") => 0.25,
                ("", "measure") => 0.05,
                ("", _) => 0.5,
                // Reader options that a file lacks are errors, so they are rare.
                ("volume", _) => 0.04,
                ("mesh", _) => 0.15,
                _ => self.stated,
            };
            let within = if path.is_empty() {
                key.clone()
            } else {
                format!("{path}.{key}")
            };
            let is_later = LATER_KEYS.contains(&within.as_str());
            if is_later {
                std::mem::swap(&mut self.random, &mut self.later);
            }
            if self.random.chance(wanted)
                && let Some(value) = self.value(of_key, key, &within)
            {
                table.insert(key.clone(), value);
            }
            if is_later {
                std::mem::swap(&mut self.random, &mut self.later);
            }
        }
        match path {
            "mesh" => self.made_of_something(&mut table),
            // Rays for each sample take seconds.
            "light" if self.later.chance(0.95) => table.retain(|key, _| key != "quality"),
            // What is computed has no options of files.
            "volume"
                if table
                    .get("path")
                    .and_then(Value::as_str)
                    .is_some_and(is_procedural)
                    && self.random.chance(0.95) =>
            {
                let of_files = ["series", "time", "channel", "level", "spacing", "resample", "raw"];
                table.retain(|key, _| !of_files.contains(&key));
            }
            "deformation" => self.parameters(&mut table),
            "mesh.deformer" | "volume.inside.deformer" => {
                let name = self.random.one_of(&[
                    "angle",
                    "factor",
                    "amount",
                    "width",
                    "amplitude",
                    "length",
                    "phase",
                ]);
                let value = self.number(name);
                table.insert(name.into(), Value::Float(value));
            }
            _ => {}
        }
        table
    }

    /// A mesh has exactly one source.
    fn made_of_something(&mut self, mesh: &mut toml::Table) {
        for key in ["path", "iso", "label", "shape", "volume"] {
            mesh.remove(key);
        }
        let (key, value) = match self.random.below(10) {
            0..4 => ("path", Value::String(self.of_files(|f| &f.meshes))),
            4..7 => (
                "shape",
                self.list(
                    &self.schema["$defs"]["MeshSource"]["properties"]["shape"].clone(),
                    "shape",
                    "mesh.shape",
                ),
            ),
            7 => ("iso", Value::Float(self.number("iso"))),
            _ => (
                "label",
                Value::Array(vec![Value::Integer(self.random.below(6) as i64)]),
            ),
        };
        if matches!(key, "iso" | "label") && self.random.chance(0.6) {
            let volume = self.of_files(|f| if key == "label" { &f.labels } else { &f.volumes });
            mesh.insert("volume".into(), Value::String(volume));
        }
        mesh.insert(key.into(), value);
    }

    fn of_files(&mut self, list: impl for<'f> Fn(&'f Files) -> &'f Vec<String>) -> String {
        let all = list(self.files);
        if self.random.chance(0.02) {
            "nowhere.at.all".into()
        } else {
            all[self.random.below(all.len())].clone()
        }
    }

    /// A kind's own parameters and settings.
    fn parameters(&mut self, deformation: &mut toml::Table) {
        let name = deformation["kind"].as_str().unwrap_or_default().to_owned();
        // Large maps are slow.
        if let Some(n) = deformation.get_mut("resolution") {
            *n = Value::Integer(8 + self.random.below(40) as i64);
        } else if name != "map" {
            deformation.insert(
                "resolution".into(),
                Value::Integer(8 + self.random.below(24) as i64),
            );
        }
        let Ok(kind) = kinds::kind(&name) else {
            let path = if name == "map" {
                self.of_files(|f| &f.maps)
            } else {
                self.of_files(|f| &f.fields)
            };
            deformation.insert("path".into(), Value::String(path));
            if name == "field" {
                for key in ["center", "size", "rotate", "matrix"] {
                    if self.random.chance(0.95) {
                        deformation.remove(key);
                    }
                }
                if self.random.chance(0.3) {
                    deformation.insert("invert".into(), Value::Boolean(true));
                }
            }
            return;
        };
        self.numbers_of(kind, deformation);
        let bounds = Bounds::new(glam::Vec3::splat(-40.0), glam::Vec3::splat(40.0));
        for (key, value) in kind.example(&bounds).0 {
            if self.random.chance(0.95) {
                deformation.insert(key, Value::try_from(value).unwrap());
            }
        }
        for setting in kind.settings() {
            if self.random.chance(0.08) {
                let value = match setting.name {
                    "spare" | "label" => Value::Array(vec![Value::Integer(self.random.below(5) as i64)]),
                    "labels" => Value::String(self.of_files(|f| &f.labels)),
                    "mask" => Value::String(self.of_files(|f| &f.volumes)),
                    "pairs" | "from" | "to" => Value::String(self.of_files(|f| &f.points)),
                    "mapping" => {
                        Value::String(self.random.one_of(&["cylindrical", "none", "conical"]).into())
                    }
                    "invert" => Value::Boolean(self.random.chance(0.7)),
                    "group" => Value::String(self.random.one_of(&["a", "b"]).into()),
                    "combine" => Value::String(self.random.one_of(&["and", "or"]).into()),
                    "iso" => Value::Float(self.number("iso")),
                    _ => match self.random.below(4) {
                        0 => Value::Boolean(true),
                        1 => Value::Float(self.number(setting.name)),
                        2 => Value::Array(
                            (0..self.random.below(30))
                                .map(|_| Value::Float(self.number("points")))
                                .collect(),
                        ),
                        _ => Value::String(self.random.one_of(&WORDS).into()),
                    },
                };
                deformation.insert(setting.name.into(), value);
            }
        }
        // A label map alone does nothing.
        let names_labels = ["spare", "label", "stiffness"]
            .iter()
            .any(|key| deformation.contains_key(*key));
        if !names_labels && self.random.chance(0.95) {
            deformation.remove("labels");
        }
        // Spared labels need a label map.
        if deformation.contains_key("spare") && self.random.chance(0.9) {
            deformation.insert("labels".into(), Value::String(self.files.labels[0].clone()));
        }
    }

    fn numbers_of(&mut self, kind: &Kind, deformation: &mut toml::Table) {
        let size = deformation.get("size").and_then(|s| {
            s.as_float()
                .map(|s| [s; 3])
                .or_else(|| s.clone().try_into::<[f64; 3]>().ok())
        });
        let size = glam::Vec3::from(size.unwrap_or([80.0; 3]).map(|s| s as f32));
        for p in kind.parameters {
            if self.random.chance(0.4) {
                let (low, high) = (f64::from(p.min.resolve(size)), f64::from(p.max.resolve(size)));
                let value = match self.random.below(20) {
                    0 => EXTREMES[self.random.below(EXTREMES.len())],
                    1 => low,
                    2 => high,
                    _ => self.random.between(low, high),
                };
                deformation.insert(p.name.into(), Value::Float(value));
            }
        }
    }

    fn list(&mut self, schema: &Schema, key: &str, path: &str) -> Value {
        let schema = self.resolved(schema);
        let [least, most] = ["minItems", "maxItems"].map(|n| schema[n].as_u64());
        let count = match (least, most) {
            (Some(n), _) | (None, Some(n)) => n as usize,
            _ if key == "deformation" => [1, 1, 1, 2, 2, 3, 4, 6, 9, 12][self.random.below(10)],
            _ => 1 + self.random.below(3),
        };
        let items = schema["items"].clone();
        let mut values: Vec<Value> = (0..count).filter_map(|_| self.value(&items, key, path)).collect();
        if key == "points" && path.starts_with("transfer") {
            values.sort_by(|a, b| {
                a["value"]
                    .as_float()
                    .unwrap_or(0.0)
                    .total_cmp(&b["value"].as_float().unwrap_or(0.0))
            });
        }
        Value::Array(values)
    }

    fn value(&mut self, schema: &Schema, key: &str, path: &str) -> Option<Value> {
        let schema = self.resolved(schema);
        if let Some(all) = schema["anyOf"].as_array() {
            let all: Vec<&Schema> = all.iter().filter(|s| s["type"] != "null").collect();
            let n = self.random.below(all.len());
            return self.value(&all[n].clone(), key, path);
        }
        if let Some(all) = schema["oneOf"].as_array() {
            let n = self.random.below(all.len());
            return all[n]["const"].as_str().map(|s| Value::String(s.into()));
        }
        let of_type = match &schema["type"] {
            Schema::String(t) => t.clone(),
            Schema::Array(all) => all[0].as_str().unwrap_or_default().to_owned(),
            _ => return None,
        };
        Some(match of_type.as_str() {
            "object" => Value::Table(self.table(&schema, path)),
            "array" => self.list(&schema, key, path),
            "boolean" => Value::Boolean(self.random.chance(0.6)),
            "integer" => Value::Integer(self.integer(key, path)),
            "number" => Value::Float(self.number(key)),
            _ => Value::String(self.text(key, path)),
        })
    }

    fn integer(&mut self, key: &str, path: &str) -> i64 {
        if self.random.chance(self.extreme) {
            return [0, 1, -1, i64::MAX, 1 << 31, 4096][self.random.below(6)];
        }
        match key {
            "antialias" => [1, 1, 1, 2][self.random.below(4)],
            // The cost of distance fields grows with the third power.
            "resolution" if path.starts_with("mesh") || path.starts_with("surface") => {
                16 + self.random.below(32) as i64
            }
            "time" | "channel" => 1,
            "slab" => [1, 1, 4, 32][self.random.below(4)],
            _ => self.random.below(6) as i64,
        }
    }

    fn number(&mut self, key: &str) -> f64 {
        if self.random.chance(self.extreme) {
            return EXTREMES[self.random.below(EXTREMES.len())];
        }
        match key {
            "center" | "target" | "points" => self.random.between(-60.0, 60.0),
            "size" => 10f64.powf(self.random.between(0.7, 2.4)),
            "rotate" | "roll" | "phase" | "angle" => self.random.between(-180.0, 180.0),
            "matrix" => self.random.between(-90.0, 90.0),
            "progress" => [0.0, 0.3, 0.7, 1.0][self.random.below(4)],
            "color" | "key_color" | "sky_color" | "inside_color" | "cut_color" | "background" | "opacity"
            | "factor" | "ambient" | "diffuse" | "specular" => self.random.share(),
            "direction" => self.random.between(-1.0, 1.0),
            "azimuth" => self.random.between(-360.0, 360.0),
            "elevation" => self.random.between(-90.0, 90.0),
            "shininess" => self.random.between(1.0, 100.0),
            "step" => [0.4, 0.7, 1.0, 1.0, 2.0, 5.0][self.random.below(6)],
            "zoom" => 10f64.powf(self.random.between(-0.4, 0.8)),
            "field_of_view" => self.random.between(5.0, 90.0),
            "density" => 10f64.powf(self.random.between(-1.5, 1.0)),
            "window" => [0.5, 1.0, 200.0, 1500.0][self.random.below(4)],
            "level" | "iso" | "value" => {
                [0.3, 0.5, 0.9, 60.0, 150.0, 300.0, -300.0, -1000.0][self.random.below(8)]
            }
            "magnitude" => self.random.between(0.0, 100.0),
            "precompose" => [0.05, 0.2, 1.0, 5.0][self.random.below(4)],
            "spacing" => self.random.between(0.5, 5.0),
            _ => 10f64.powf(self.random.between(-0.5, 1.6)),
        }
    }

    fn text(&mut self, key: &str, path: &str) -> String {
        if self.random.chance(self.extreme) {
            return self.random.one_of(&WORDS).into();
        }
        let owned = |s: &str| s.to_owned();
        match (path, key) {
            ("volume.path", _) => match self.random.below(6) {
                0..4 => {
                    let name = self.random.one_of(&[
                        "ball",
                        "shell",
                        "checker",
                        "piggy-bank",
                        "tomato",
                        "teddy",
                        "octants",
                        "head-ct",
                    ]);
                    format!(
                        "phantom:{name}:size={}",
                        [4, 16, 24, 32, 48, 64][self.random.below(6)]
                    )
                }
                4 => self.of_files(|f| &f.volumes),
                _ => self.of_files(|f| &f.labels),
            },
            ("render.antialias", _) => owned("adaptive"),
            ("volume.labels", _) => self.of_files(|f| &f.labels),
            ("volume.inside.path", _) => self.of_files(|f| &f.meshes),
            ("deformation.kind", _) => {
                let all: Vec<&str> = kinds::list()
                    .map(|k| k.name)
                    .chain(FILE_KINDS.iter().map(|k| k.name))
                    .collect();
                all[self.random.below(all.len())].into()
            }
            (_, "kind") if path.contains("shape") => owned(
                self.random
                    .one_of(&["sphere", "box", "torus", "cylinder", "gyroid"]),
            ),
            (_, "kind") if path.contains("deformer") => owned(
                self.random
                    .one_of(&["twist", "bend", "taper", "shear", "bulge", "wave", "lattice"]),
            ),
            (_, "join") => owned(self.random.one_of(&["union", "intersect", "subtract"])),
            (_, "face") => owned(self.random.one_of(&["-x", "+x", "-y", "+y", "-z", "+z"])),
            (_, "look") => {
                let all: Vec<&str> = surface::look_names().collect();
                all[self.random.below(all.len())].into()
            }
            (_, "preset") => {
                let all: Vec<&str> = transfer::list().map(|p| p.name).collect();
                all[self.random.below(all.len())].into()
            }
            (_, "view") => match self.random.below(3) {
                0 => owned(self.random.one_of(&[
                    "anterior",
                    "posterior",
                    "left",
                    "right",
                    "superior",
                    "inferior",
                ])),
                _ => format!(
                    "{:.1},{:.1}",
                    self.random.between(-180.0, 180.0),
                    self.random.between(-90.0, 90.0)
                ),
            },
            _ => owned(self.random.one_of(&WORDS)),
        }
    }
}

fn number_from(variable: &str, otherwise: u64) -> u64 {
    std::env::var(variable)
        .ok()
        .map_or(otherwise, |v| v.parse().unwrap())
}

/// Watches the number of the current scene, `u64::MAX` if there is none. Reports a hung scene and
/// exits.
fn exit_if_a_scene_hangs(current_scene: &'static AtomicU64) {
    std::thread::spawn(move || {
        let (mut last, mut since) = (u64::MAX, Instant::now());
        loop {
            std::thread::sleep(Duration::from_secs(1));
            let current = current_scene.load(Ordering::Relaxed);
            if current != last {
                (last, since) = (current, Instant::now());
            } else if current != u64::MAX && since.elapsed() > HANGS {
                eprintln!(
                    "scene {current} does not end; run it again with INCISE_FUZZ_FIRST={current} INCISE_FUZZ_SCENES=1"
                );
                std::process::exit(101);
            }
        }
    });
}

pub fn random_scenes_do_no_harm() {
    let (count, first) = (
        number_from("INCISE_FUZZ_SCENES", 120),
        number_from("INCISE_FUZZ_FIRST", 0),
    );
    let files = Files::new();
    let schema = file::schema();
    let (mut pictures, mut blank, mut compared, mut slowest) = (0u64, 0u64, 0u64, (0.0f64, 0u64));
    let mut complaints: Vec<String> = Vec::new();
    let mut refusals = std::collections::BTreeMap::<String, u64>::new();
    static CURRENT: AtomicU64 = AtomicU64::new(u64::MAX);
    exit_if_a_scene_hangs(&CURRENT);
    let keep: Option<PathBuf> = std::env::var_os("INCISE_FUZZ_KEEP").map(PathBuf::from);
    for n in first..first + count {
        let mut random = Random(n.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ 0x1234_5678);
        let (stated, extreme) = (
            [0.05, 0.15, 0.4][random.below(3)],
            [0.0, 0.0, 0.005, 0.03][random.below(4)],
        );
        let mut maker = Maker {
            schema: &schema,
            files: &files,
            later: Random(random.0 ^ 0x5851_f42d_4c95_7f2d),
            random,
            stated,
            extreme,
        };
        let text = toml::to_string(&maker.scene()).unwrap();
        if let Some(folder) = &keep {
            std::fs::write(folder.join(format!("{n}.toml")), &text).unwrap();
        }
        CURRENT.store(n, Ordering::Relaxed);
        let start = Instant::now();
        let outcome = catch_unwind(AssertUnwindSafe(|| run(&text, files.path())));
        let seconds = start.elapsed().as_secs_f64();
        slowest = if seconds > slowest.0 {
            (seconds, n)
        } else {
            slowest
        };
        let mut complain = |problem: String| {
            eprintln!("scene {n}: {problem}\n{text}");
            complaints.push(format!("{n}: {}", problem.lines().next().unwrap_or_default()));
        };
        if seconds > MAX_SECONDS {
            complain(format!("took {seconds:.1} s"));
        }
        let Ok(outcome) = outcome else {
            complain("panicked".into());
            continue;
        };
        if let Some(problem) = complaint(&outcome) {
            complain(problem);
        }
        if let Outcome::Refused(message) = &outcome {
            let plain: String = message.chars().filter(|c| !c.is_ascii_digit()).take(60).collect();
            *refusals.entry(plain).or_default() += 1;
        }
        if let Outcome::Picture {
            assets,
            scene,
            rendered,
        } = &outcome
        {
            pictures += 1;
            blank += u64::from(rendered.picture.is_blank());
            if pictures % ON_GPU == 0 {
                match catch_unwind(AssertUnwindSafe(|| on_a_gpu(scene, assets, &rendered.picture))) {
                    Ok(None) => {}
                    Ok(Some(Ok(()))) => compared += 1,
                    Ok(Some(Err(problem))) => complain(problem),
                    Err(_) => complain("panicked on the GPU".into()),
                }
            }
        }
    }
    CURRENT.store(u64::MAX, Ordering::Relaxed);
    println!(
        "{count} scenes: {pictures} pictures, {blank} empty with a word, {compared} compared with a GPU's; the slowest took {:.1} s (scene {})",
        slowest.0, slowest.1
    );
    let mut refusals: Vec<_> = refusals.into_iter().collect();
    refusals.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
    refusals
        .iter()
        .take(15)
        .for_each(|(message, n)| println!("{n:6} {message}"));
    assert!(
        complaints.is_empty(),
        "{} of {count}:\n{}",
        complaints.len(),
        complaints.join("\n")
    );
    // If nearly all scenes were rejected, the test would be meaningless.
    assert!(
        count < 100 || pictures * 3 >= count,
        "only {pictures} of {count} scenes became pictures"
    );
}
