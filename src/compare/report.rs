//! A comparison as a folder: pictures, differences, numbers for people (a page) and for programs (JSON and CSV).

use super::lab::{EqualError, equal_errors};
use super::metrics::{Difference, difference, difference_picture};
use super::{Memory, Times};
use crate::export::png;
use crate::files::Output;
use crate::picture::{Picture, RenderStats};
use crate::scene::{Mode, Scene};
use crate::{Error, Result};
use serde_json::{Value, json};
use std::collections::HashSet;
use std::path::Path;

/// The version of the program.
pub(super) const VERSION: &str = env!("CARGO_PKG_VERSION");
/// Longest part of a file's name that comes from a run's name, characters.
const LONGEST_NAME: usize = 60;
/// Differences are shown this many times as large: 1/8 of the range is as bright as it gets.
const AMPLIFY: f32 = 8.0;

/// What a picture shows, and how large: only pictures that agree in it can be compared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shown {
    /// The direction of view, as it is written in a scene file.
    pub camera: String,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Surfaces alone, which are something else than the volume.
    pub surface: bool,
}

impl Shown {
    /// What a scene's picture shows.
    pub fn of(scene: &Scene) -> Self {
        Self { camera: scene.camera.view.into(), size: scene.render.size, surface: scene.render.mode == Mode::Surface }
    }
}

impl std::fmt::Display for Shown {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let what = if self.surface { "surfaces" } else { "volume" };
        write!(f, "{what}, view {}, {} × {} pixels", self.camera, self.size[0], self.size[1])
    }
}

/// One renderer's picture of the scene and what it cost.
#[derive(Clone, Debug)]
pub struct Run {
    /// What it is called in the report, e.g. `slice cpu`; no two runs of a report have the same name.
    pub name: String,
    /// The picture, premultiplied, without background.
    pub picture: Picture,
    /// What it shows.
    pub shown: Shown,
    /// How the scene was sampled.
    pub mode: Mode,
    /// What rendered it: `cpu` or `gpu`.
    pub backend: String,
    /// Distance between samples in voxels (of the smallest spacing).
    pub step: f32,
    /// From the loaded scene to the picture.
    pub milliseconds: Times,
    /// The part of it after the scene was prepared: what differs between renderers.
    pub rendering: Times,
    /// How often it was timed.
    pub repetitions: usize,
    /// How long an untimed first picture took, milliseconds, if there was one.
    pub warm_up: Option<f64>,
    /// Parts of the median time by name, milliseconds, in order.
    pub stages: Vec<(String, f64)>,
    /// Samples, if they were counted.
    pub stats: Option<RenderStats>,
    /// What it needed.
    pub memory: Memory,
    /// How far it is from its reference, if there is one.
    pub error: Option<Difference>,
    /// Whether it is what others are measured against.
    pub is_reference: bool,
    /// What a user should know of it, one sentence each.
    pub notices: Vec<String>,
}

/// Two runs and how their pictures differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Index of the first run.
    pub a: usize,
    /// Index of the second run.
    pub b: usize,
    /// How they differ.
    pub difference: Difference,
}

/// How the runs of a report were made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Protocol {
    /// The processor, for people.
    pub cpu: String,
    /// The graphics adapter, for people, if one was used.
    pub gpu: Option<String>,
    /// How often each run was timed.
    pub repeat: usize,
    /// Step of the references, voxels, if there are any.
    pub reference_step: Option<f32>,
    /// Stages of preparing the scene for the first time, as for the picture after loading, and their milliseconds. Runs find kept what any second
    /// picture finds.
    pub first_preparation: Vec<(String, f64)>,
    /// What a reader should know, one sentence each.
    pub notices: Vec<String>,
}

/// Runs of one scene, and how they differ.
#[derive(Clone, Debug)]
pub struct Report {
    /// Heading of the page.
    pub title: String,
    /// The scene that all runs show, as its file's text.
    pub scene_toml: String,
    /// The runs.
    pub runs: Vec<Run>,
    /// Pairs of runs, in order.
    pub pairs: Vec<Pair>,
    /// Behind the pictures: red, green, blue, alpha in 0..1, not premultiplied. The numbers do not depend on it.
    pub background: [f32; 4],
    /// Difference pictures show differences this many times as large.
    pub amplify: f32,
    /// How the runs were made, if all by one rule.
    pub protocol: Option<Protocol>,
}

/// A picture as it is written.
pub(super) struct Encoded {
    pub(super) file: String,
    pub(super) png: Vec<u8>,
}

impl Report {
    /// Compares every run with every other.
    ///
    /// # Errors
    /// No runs, two of one name, pictures of different sizes or with values that are not numbers.
    pub fn new(title: impl Into<String>, scene_toml: impl Into<String>, background: [f32; 4], runs: Vec<Run>) -> Result<Self> {
        let all = (0..runs.len()).flat_map(|a| (a + 1..runs.len()).map(move |b| [a, b])).collect();
        Self::of_pairs(title, scene_toml, background, runs, all)
    }

    /// Compares runs by pairs of their indices.
    ///
    /// # Errors
    /// As [`Self::new`]; a pair of runs that are not there.
    pub fn of_pairs(
        title: impl Into<String>,
        scene_toml: impl Into<String>,
        background: [f32; 4],
        runs: Vec<Run>,
        pairs: Vec<[usize; 2]>,
    ) -> Result<Self> {
        if runs.is_empty() {
            return Err(Error::value("runs", "there are none; a comparison needs at least one picture"));
        }
        let mut names = HashSet::new();
        if let Some(twice) = runs.iter().find(|run| !names.insert(&run.name)) {
            return Err(Error::value("runs", format!("two are called \"{}\"; give each a name of its own", twice.name)));
        }
        let compared = |[a, b]: [usize; 2]| match (runs.get(a), runs.get(b)) {
            (Some(first), Some(second)) => Ok(Pair { a, b, difference: difference(&first.picture, &second.picture)? }),
            _ => Err(Error::value("pairs", format!("runs {a} and {b} are not both among the {} there are", runs.len()))),
        };
        let pairs = pairs.into_iter().map(compared).collect::<Result<_>>()?;
        Ok(Self { title: title.into(), scene_toml: scene_toml.into(), runs, pairs, background, amplify: AMPLIFY, protocol: None })
    }

    /// Writes `NAME.png` for every run, `difference-A-B.png` for every pair, `report.json`, `runs.csv`, `pairs.csv` and `index.html` into a
    /// folder, which is made if it does not exist. Files of these names are replaced, others stay.
    ///
    /// # Errors
    /// A folder that cannot be made or written, an amplification that is not positive.
    pub fn write(&self, folder: &Path) -> Result<()> {
        write_files(folder, &self.files()?)
    }

    /// The files of the report by name, in the order in which they are to be written: the page is last, so that where there is a page, all
    /// that it speaks of is there.
    ///
    /// # Errors
    /// An amplification that is not positive.
    pub fn files(&self) -> Result<Vec<(String, Vec<u8>)>> {
        let mut taken = HashSet::new();
        let mut pictures = Vec::new();
        for run in &self.runs {
            pictures.push(Encoded { file: file_name(&plain(&run.name), &mut taken), png: png(&run.picture, self.background)? });
        }
        let mut differences = Vec::new();
        for pair in &self.pairs {
            let [a, b] = [pair.a, pair.b].map(|n| &self.runs[n]);
            let file = file_name(&format!("difference-{}-{}", plain(&a.name), plain(&b.name)), &mut taken);
            let shown = difference_picture(&a.picture, &b.picture, self.amplify)?;
            differences.push(Encoded { file, png: png(&shown, [0.0, 0.0, 0.0, 1.0])? });
        }
        let equal = equal_errors(&self.runs);
        let json = format!("{:#}\n", self.json(&pictures, &differences, &equal));
        let page = self.page(&pictures, &differences, &equal);
        let texts =
            [("report.json", json), ("runs.csv", self.runs_csv(&pictures)), ("pairs.csv", self.pairs_csv(&differences)), ("index.html", page)];
        let pictures = pictures.into_iter().chain(differences).map(|e| (e.file, e.png));
        Ok(pictures.chain(texts.map(|(file, text)| (file.to_owned(), text.into_bytes()))).collect())
    }

    fn json(&self, pictures: &[Encoded], differences: &[Encoded], equal: &[EqualError]) -> Value {
        let row = |(run, picture): (&Run, &Encoded)| {
            let samples = run.stats.map(|s| json!({ "taken": s.samples_taken, "skipped": s.samples_skipped, "terminated": s.samples_terminated }));
            let reference = run.error.and_then(|_| self.runs.iter().find(|r| r.is_reference && r.shown == run.shown)).map(|r| &r.name);
            json!({
                "name": run.name,
                "mode": run.mode,
                "backend": run.backend,
                "step_voxels": as_written(run.step),
                "size": run.shown.size,
                "camera": run.shown.camera,
                "milliseconds": run.milliseconds.median,
                "milliseconds_min": run.milliseconds.min,
                "milliseconds_max": run.milliseconds.max,
                "rendering_milliseconds": run.rendering.median,
                "rendering_milliseconds_min": run.rendering.min,
                "rendering_milliseconds_max": run.rendering.max,
                "repetitions": run.repetitions,
                "warm_up_milliseconds": run.warm_up,
                "stages": stage_list(&run.stages),
                "samples": samples,
                "memory": {
                    "volume_bytes": run.memory.volume_bytes,
                    "gradient_bytes": run.memory.gradient_bytes,
                    "map_bytes": run.memory.map_bytes,
                    "surface_bytes": run.memory.surface_bytes,
                    "peak_bytes": run.memory.peak_bytes,
                },
                "reference": reference,
                "error": run.error.map(|d| json!({ "mean": d.mean, "max": d.max, "rms": d.rms(), "psnr_db": finite(d.psnr_db), "ssim": d.ssim })),
                "picture": picture.file,
            })
        };
        let rows = |references: bool| -> Vec<Value> { self.runs.iter().zip(pictures).filter(|r| r.0.is_reference == references).map(row).collect() };
        let pair = |(pair, picture): (&Pair, &Encoded)| {
            let d = pair.difference;
            json!({
                "a": self.runs[pair.a].name, "b": self.runs[pair.b].name,
                "mean": d.mean, "max": d.max, "rms": d.rms(), "psnr_db": finite(d.psnr_db), "ssim": d.ssim,
                "picture": picture.file,
            })
        };
        let at_equal_error = |e: &EqualError| {
            let entry = |entry: &super::lab::Entry| {
                json!({
                    "mode": entry.mode, "backend": entry.backend,
                    "rendering_milliseconds": entry.at.map(|p| p.milliseconds), "step_voxels": entry.at.map(|p| p.step),
                })
            };
            json!({
                "camera": e.shown.camera, "size": e.shown.size, "surface": e.shown.surface, "rms": e.error,
                "renderers": e.entries.iter().map(entry).collect::<Vec<_>>(),
            })
        };
        let protocol = self.protocol.as_ref().map(|p| {
            json!({
                "cpu": p.cpu, "gpu": p.gpu, "repeat": p.repeat, "reference_step_voxels": p.reference_step.map(as_written),
                "first_preparation": stage_list(&p.first_preparation), "notices": p.notices,
            })
        });
        json!({
            "incise": VERSION,
            "title": self.title,
            "size": self.size(),
            "background": self.background,
            "amplify": self.amplify,
            "scene": self.scene_toml,
            "protocol": protocol,
            "runs": rows(false),
            "references": rows(true),
            "pairs": self.pairs.iter().zip(differences).map(pair).collect::<Vec<_>>(),
            "equal_error": equal.iter().map(at_equal_error).collect::<Vec<_>>(),
        })
    }

    /// The size that all pictures have; none if they differ in it.
    pub(super) fn size(&self) -> Option<[u32; 2]> {
        let size = |run: &Run| [run.picture.width, run.picture.height];
        let first = size(self.runs.first()?);
        self.runs.iter().all(|run| size(run) == first).then_some(first)
    }

    /// Names of all stages of any run, in order of appearance.
    pub(super) fn stage_names(&self) -> Vec<&str> {
        let mut seen = HashSet::new();
        self.runs.iter().flat_map(|run| &run.stages).map(|(name, _)| name.as_str()).filter(|name| seen.insert(*name)).collect()
    }

    fn runs_csv(&self, pictures: &[Encoded]) -> String {
        let stages = self.stage_names();
        let columns = "name,mode,backend,step_voxels,width,height,camera,milliseconds,milliseconds_min,milliseconds_max,rendering_milliseconds,\
                       rendering_milliseconds_min,rendering_milliseconds_max,repetitions,warm_up_milliseconds,samples_taken,samples_skipped,\
                       samples_terminated,volume_bytes,gradient_bytes,map_bytes,surface_bytes,peak_bytes,\
                       error_mean,error_max,error_rms,error_psnr_db,error_ssim,reference,picture";
        let mut header: Vec<String> = columns.split(',').map(String::from).collect();
        header.extend(stages.iter().map(|stage| format!("milliseconds {stage}")));
        let mut text = csv_line(&header);
        for (run, picture) in self.runs.iter().zip(pictures) {
            let mut line = vec![run.name.clone(), mode_name(run.mode).to_owned(), run.backend.clone(), run.step.to_string()];
            line.extend(run.shown.size.map(|n| n.to_string()));
            line.push(run.shown.camera.clone());
            line.extend([run.milliseconds, run.rendering].iter().flat_map(|t| [t.median, t.min, t.max]).map(|ms| ms.to_string()));
            line.extend([run.repetitions.to_string(), optional(run.warm_up)]);
            line.extend(samples(run).map(optional));
            let memory = run.memory;
            line.extend([memory.volume_bytes, memory.gradient_bytes, memory.map_bytes, memory.surface_bytes].map(|n| n.to_string()));
            line.push(optional(run.memory.peak_bytes));
            line.extend(run.error.map_or([None; 5], |d| [d.mean, d.max, d.rms(), d.psnr_db, d.ssim].map(Some)).map(optional));
            line.extend([run.is_reference.to_string(), picture.file.clone()]);
            line.extend(stages.iter().map(|stage| optional(stage_milliseconds(run, stage))));
            text.push_str(&csv_line(&line));
        }
        text
    }

    fn pairs_csv(&self, differences: &[Encoded]) -> String {
        let mut text = csv_line(&["a", "b", "mean", "max", "psnr_db", "ssim", "rms", "picture"].map(String::from));
        for (pair, picture) in self.pairs.iter().zip(differences) {
            let d = pair.difference;
            let [a, b] = [pair.a, pair.b].map(|n| self.runs[n].name.clone());
            // An infinite PSNR is `inf`, which programs that read CSV take for what it is.
            let [mean, max, psnr_db, ssim, rms] = [d.mean, d.max, d.psnr_db, d.ssim, d.rms()].map(|v| v.to_string());
            text.push_str(&csv_line(&[a, b, mean, max, psnr_db, ssim, rms, picture.file.clone()]));
        }
        text
    }
}

/// Writes files into a folder, which is made if it does not exist, in their order.
///
/// # Errors
/// A folder that cannot be made or written, or holds what cannot be replaced; then nothing is written.
pub fn write_files(folder: &Path, files: &[(String, Vec<u8>)]) -> Result<()> {
    if let Some(path) = files.iter().map(|(file, _)| folder.join(file)).find(|path| path.is_dir()) {
        return Err(Error::file(&path, "is a folder where a file is to be written; remove it, or choose another folder"));
    }
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "making", e))?;
    let outputs = files.iter().map(|(file, _)| Output::create(&folder.join(file))).collect::<Result<Vec<_>>>()?;
    outputs.into_iter().zip(files).try_for_each(|(output, (_, content))| output.finish(content))
}

/// Names of stages with their milliseconds.
fn stage_list(stages: &[(String, f64)]) -> Vec<Value> {
    stages.iter().map(|(name, ms)| json!({ "name": name, "milliseconds": ms })).collect()
}

/// A number of single precision as people write it: the nearest double has digits that nobody typed.
fn as_written(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

/// JSON has no infinity.
fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// The word for a mode that people type.
pub(super) fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Slice => "slice",
        Mode::Raycast => "raycast",
        Mode::Surface => "surface",
    }
}

/// A field of CSV; empty if there is no value.
fn optional<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(String::new, |v| v.to_string())
}

/// Samples taken, skipped and terminated, if they were counted.
pub(super) fn samples(run: &Run) -> [Option<u64>; 3] {
    run.stats.map_or([None; 3], |s| [s.samples_taken, s.samples_skipped, s.samples_terminated].map(Some))
}

/// Time that all stages of a name took together; none if there is no such stage.
pub(super) fn stage_milliseconds(run: &Run, stage: &str) -> Option<f64> {
    let mut times = run.stages.iter().filter(|(name, _)| name == stage).map(|(_, ms)| ms).peekable();
    times.peek()?;
    Some(times.sum())
}

/// A name that any file system takes, without its ending: letters, digits, hyphens and underscores.
fn plain(name: &str) -> String {
    let kept = name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' });
    let plain: String = kept.take(LONGEST_NAME).collect();
    let plain = plain.trim_matches('-');
    if plain.is_empty() { "run".to_owned() } else { plain.to_owned() }
}

/// The file of a picture of a plain name, different from all `taken` ones also where upper and lower case are the same.
fn file_name(plain: &str, taken: &mut HashSet<String>) -> String {
    let mut file = format!("{plain}.png");
    let mut more = 1;
    while !taken.insert(file.to_lowercase()) {
        more += 1;
        file = format!("{plain}-{more}.png");
    }
    file
}

/// One line of CSV (RFC 4180, but for its end).
fn csv_line(fields: &[String]) -> String {
    let quoted = |field: &String| {
        if field.contains([',', '"', '\n', '\r']) { format!("\"{}\"", field.replace('"', "\"\"")) } else { field.clone() }
    };
    let mut line = fields.iter().map(quoted).collect::<Vec<_>>().join(",");
    line.push('\n');
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(name: &str, color: [f32; 4]) -> Run {
        Run {
            name: name.to_owned(),
            picture: Picture { width: 4, height: 3, pixels: vec![color; 12] },
            milliseconds: Times { median: 12.5, min: 12.0, max: 14.0 },
            rendering: Times { median: 10.0, min: 9.0, max: 11.0 },
            repetitions: 3,
            warm_up: None,
            shown: Shown { camera: "anterior".to_owned(), size: [4, 3], surface: false },
            mode: Mode::Slice,
            memory: Memory { volume_bytes: 64, gradient_bytes: 0, map_bytes: 0, surface_bytes: 0, peak_bytes: None },
            error: None,
            is_reference: false,
            stages: vec![("maps".to_owned(), 2.0), ("render".to_owned(), 10.0)],
            stats: Some(RenderStats { samples_taken: 1_234_567, samples_skipped: 2, samples_terminated: 3 }),
            backend: "cpu".to_owned(),
            step: 0.5,
            notices: Vec::new(),
        }
    }

    fn report(names: [&str; 2]) -> Report {
        let runs = vec![run(names[0], [0.2, 0.2, 0.2, 1.0]), run(names[1], [0.3, 0.2, 0.2, 1.0])];
        Report::new("Slices & rays", "incise = 1\n[volume]\npath = \"<ball>\"\n", [0.0, 0.0, 0.0, 1.0], runs).unwrap()
    }

    #[test]
    fn a_report_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("made/here");
        report(["slice", "ray, 1/2"]).write(&folder).unwrap();
        let mut files: Vec<String> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        files.sort();
        let expected = ["difference-slice-ray--1-2.png", "index.html", "pairs.csv", "ray--1-2.png", "report.json", "runs.csv", "slice.png"];
        assert_eq!(files, expected);
        let read = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
        let json: Value = serde_json::from_str(&read("report.json")).unwrap();
        assert_eq!(json["incise"], VERSION);
        assert_eq!(json["size"], json!([4, 3]));
        assert_eq!(json["runs"][0]["samples"], json!({ "taken": 1_234_567, "skipped": 2, "terminated": 3 }));
        assert_eq!(json["runs"][1]["stages"][1], json!({ "name": "render", "milliseconds": 10.0 }));
        assert_eq!((&json["pairs"][0]["a"], &json["pairs"][0]["b"]), (&json!("slice"), &json!("ray, 1/2")));
        assert!((json["pairs"][0]["max"].as_f64().unwrap() - 25.5).abs() < 1e-3);
        assert_eq!(json["pairs"][0]["picture"], "difference-slice-ray--1-2.png");
        let runs = read("runs.csv");
        assert!(
            runs.lines().count() == 3
                && runs
                    .contains("\n\"ray, 1/2\",slice,cpu,0.5,4,3,anterior,12.5,12,14,10,9,11,3,,1234567,2,3,64,0,0,0,,,,,,,false,ray--1-2.png,2,10\n"),
            "{runs}"
        );
        assert!(read("pairs.csv").lines().nth(1).is_some_and(|line| line.starts_with("slice,\"ray, 1/2\",")));
        let html = read("index.html");
        assert!(!html.contains("http") && !html.contains("<ball>") && html.contains("&lt;ball&gt;") && html.contains("Slices &amp; rays"));
        assert_eq!(html.matches("data:image/png;base64,").count(), 3);
        let decoded = image::load_from_memory(&std::fs::read(folder.join("slice.png")).unwrap()).unwrap();
        assert_eq!((decoded.width(), decoded.height()), (4, 3));
    }

    #[test]
    fn equal_pictures_have_no_psnr_in_json() {
        let folder = tempfile::tempdir().unwrap();
        let runs = vec![run("a", [0.5; 4]), run("b", [0.5; 4])];
        Report::new("", "", [0.0; 4], runs).unwrap().write(folder.path()).unwrap();
        let json: Value = serde_json::from_slice(&std::fs::read(folder.path().join("report.json")).unwrap()).unwrap();
        assert!(json["pairs"][0]["psnr_db"].is_null() && json["pairs"][0]["ssim"] == 1.0, "{json}");
        assert!(std::fs::read_to_string(folder.path().join("pairs.csv")).unwrap().contains(",inf,"));
    }

    #[test]
    fn files_have_safe_names_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        report(["../../Up", "Up"]).write(folder.path()).unwrap();
        for file in ["Up.png", "Up-2.png", "difference-Up-Up.png"] {
            assert!(folder.path().join(file).is_file(), "{file}");
        }
        let mut taken = HashSet::new();
        assert_eq!(file_name("A", &mut taken), "A.png");
        assert_eq!(file_name("a", &mut taken), "a-2.png");
        for (name, expected) in [("...", "run"), ("", "run"), ("difference-../x", "difference----x"), ("näher", "n-her"), ("a\\b:c", "a-b-c")] {
            assert_eq!(plain(name), expected);
        }
        assert!(plain(&"long ".repeat(100)).len() <= LONGEST_NAME);
    }

    #[test]
    fn what_is_no_comparison_is_an_error() {
        assert!(Report::new("", "", [0.0; 4], Vec::new()).is_err());
        assert!(Report::new("", "", [0.0; 4], vec![run("a", [0.0; 4]), run("a", [0.0; 4])]).is_err());
        let mut larger = run("b", [0.0; 4]);
        larger.picture = Picture { width: 4, height: 4, pixels: vec![[0.0; 4]; 16] };
        assert!(Report::new("", "", [0.0; 4], vec![run("a", [0.0; 4]), larger]).is_err());
    }
}
