//! A comparison as a folder: pictures, differences, numbers for people (a page) and for programs (JSON and CSV).
//!
//! The page holds its pictures itself and asks for nothing else, so that it can be mailed, archived, and opened without a network.

use super::metrics::{Difference, difference, difference_picture};
use crate::export::{Output, png};
use crate::scene::{Picture, RenderStats};
use crate::{Error, Result};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use std::collections::HashSet;
use std::path::Path;

/// The version of the program.
const VERSION: &str = env!("CARGO_PKG_VERSION");
/// Longest part of a file's name that comes from a run's name, characters.
const LONGEST_NAME: usize = 60;
/// Differences are shown this many times as large: 1/8 of the range is as bright as it gets.
const AMPLIFY: f32 = 8.0;

/// One renderer's picture of the scene and what it cost.
#[derive(Clone, Debug)]
pub struct Run {
    /// What it is called in the report, e.g. `slice`; no two runs of a report have the same name.
    pub name: String,
    /// The picture, premultiplied, without background.
    pub picture: Picture,
    /// Time from the loaded scene to the picture, milliseconds.
    pub milliseconds: f64,
    /// Parts of that time by name, milliseconds, in order.
    pub stages: Vec<(String, f64)>,
    /// Samples, if they were counted.
    pub stats: Option<RenderStats>,
    /// What rendered it, e.g. `cpu` or the name of a graphics adapter.
    pub backend: String,
    /// Distance between samples in voxels (of the smallest spacing).
    pub step: f32,
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

/// Runs of one scene, every one compared with every other.
#[derive(Clone, Debug)]
pub struct Report {
    /// Heading of the page.
    pub title: String,
    /// The scene that all runs show, as its file's text.
    pub scene_toml: String,
    /// The runs.
    pub runs: Vec<Run>,
    /// All pairs of runs, in order.
    pub pairs: Vec<Pair>,
    /// Behind the pictures: red, green, blue, alpha in 0..1, not premultiplied. The numbers do not depend on it.
    pub background: [f32; 4],
    /// Difference pictures show differences this many times as large.
    pub amplify: f32,
}

/// What `report.json` says.
#[derive(Serialize)]
struct Summary<'a> {
    /// The version of the program.
    incise: &'static str,
    title: &'a str,
    size: [u32; 2],
    background: [f32; 4],
    amplify: f32,
    scene: &'a str,
    runs: Vec<RunRow<'a>>,
    pairs: Vec<PairRow<'a>>,
}

#[derive(Serialize)]
struct RunRow<'a> {
    name: &'a str,
    backend: &'a str,
    step_voxels: f32,
    milliseconds: f64,
    stages: Vec<StageRow<'a>>,
    samples: Option<SamplesRow>,
    picture: &'a str,
}

#[derive(Serialize)]
struct StageRow<'a> {
    name: &'a str,
    milliseconds: f64,
}

#[derive(Serialize)]
struct SamplesRow {
    taken: u64,
    skipped: u64,
    terminated: u64,
}

#[derive(Serialize)]
struct PairRow<'a> {
    a: &'a str,
    b: &'a str,
    #[serde(flatten)]
    difference: Difference,
    picture: &'a str,
}

/// A picture as it is written.
struct Encoded {
    file: String,
    png: Vec<u8>,
}

impl Report {
    /// Compares every run with every other.
    ///
    /// # Errors
    /// No runs, two of one name, pictures of different sizes or with values that are not numbers.
    pub fn new(title: impl Into<String>, scene_toml: impl Into<String>, background: [f32; 4], runs: Vec<Run>) -> Result<Self> {
        if runs.is_empty() {
            return Err(Error::value("runs", "there are none; a comparison needs at least one picture"));
        }
        let mut pairs = Vec::new();
        for (a, first) in runs.iter().enumerate() {
            for (b, second) in runs.iter().enumerate().skip(a + 1) {
                if first.name == second.name {
                    return Err(Error::value("runs", format!("two are called \"{}\"; give each a name of its own", first.name)));
                }
                pairs.push(Pair { a, b, difference: difference(&first.picture, &second.picture)? });
            }
        }
        Ok(Self { title: title.into(), scene_toml: scene_toml.into(), runs, pairs, background, amplify: AMPLIFY })
    }

    /// Writes `NAME.png` for every run, `difference-A-B.png` for every pair, `report.json`, `runs.csv`, `pairs.csv` and `index.html` into a
    /// folder, which is made if it does not exist. Files of these names are replaced, others stay.
    ///
    /// # Errors
    /// A folder that cannot be made or written, an amplification that is not positive.
    pub fn write(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "making", e))?;
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
        let write = |file: &str, content: &[u8]| Output::create(&folder.join(file))?.finish(content);
        for picture in pictures.iter().chain(&differences) {
            write(&picture.file, &picture.png)?;
        }
        write("report.json", &self.json(&pictures, &differences)?)?;
        write("runs.csv", self.runs_csv(&pictures).as_bytes())?;
        write("pairs.csv", self.pairs_csv(&differences).as_bytes())?;
        // Last: where there is a page, all that it speaks of is there.
        write("index.html", self.page(&pictures, &differences).as_bytes())
    }

    fn size(&self) -> [u32; 2] {
        self.runs.first().map_or([0, 0], |run| [run.picture.width, run.picture.height])
    }

    fn json(&self, pictures: &[Encoded], differences: &[Encoded]) -> Result<Vec<u8>> {
        let runs: Vec<RunRow> = self
            .runs
            .iter()
            .zip(pictures)
            .map(|(run, picture)| RunRow {
                name: &run.name,
                backend: &run.backend,
                step_voxels: run.step,
                milliseconds: run.milliseconds,
                stages: run.stages.iter().map(|(name, ms)| StageRow { name, milliseconds: *ms }).collect(),
                samples: run.stats.map(|s| SamplesRow { taken: s.samples_taken, skipped: s.samples_skipped, terminated: s.samples_terminated }),
                picture: &picture.file,
            })
            .collect();
        let pairs: Vec<PairRow> = self
            .pairs
            .iter()
            .zip(differences)
            .map(|(pair, picture)| PairRow {
                a: &self.runs[pair.a].name,
                b: &self.runs[pair.b].name,
                difference: pair.difference,
                picture: &picture.file,
            })
            .collect();
        let summary = Summary {
            incise: VERSION,
            title: &self.title,
            size: self.size(),
            background: self.background,
            amplify: self.amplify,
            scene: &self.scene_toml,
            runs,
            pairs,
        };
        serde_json::to_vec_pretty(&summary).map_err(|e| Error::value("report", format!("could not be written as JSON: {e}")))
    }

    /// Names of all stages of any run, in order of appearance.
    fn stage_names(&self) -> Vec<&str> {
        let mut seen = HashSet::new();
        self.runs.iter().flat_map(|run| &run.stages).map(|(name, _)| name.as_str()).filter(|name| seen.insert(*name)).collect()
    }

    fn runs_csv(&self, pictures: &[Encoded]) -> String {
        let stages = self.stage_names();
        let mut header: Vec<String> =
            ["name", "backend", "step_voxels", "milliseconds", "samples_taken", "samples_skipped", "samples_terminated", "picture"]
                .map(String::from)
                .into();
        header.extend(stages.iter().map(|stage| format!("milliseconds {stage}")));
        let mut text = csv_line(&header);
        for (run, picture) in self.runs.iter().zip(pictures) {
            let mut line = vec![run.name.clone(), run.backend.clone(), run.step.to_string(), run.milliseconds.to_string()];
            line.extend(samples(run).map(|count| count.map_or_else(String::new, |n| n.to_string())));
            line.push(picture.file.clone());
            line.extend(stages.iter().map(|stage| stage_milliseconds(run, stage).map_or_else(String::new, |ms| ms.to_string())));
            text.push_str(&csv_line(&line));
        }
        text
    }

    fn pairs_csv(&self, differences: &[Encoded]) -> String {
        let mut text = csv_line(&["a", "b", "mean", "max", "psnr_db", "ssim", "picture"].map(String::from));
        for (pair, picture) in self.pairs.iter().zip(differences) {
            let d = pair.difference;
            let [a, b] = [pair.a, pair.b].map(|n| self.runs[n].name.clone());
            // An infinite PSNR is `inf`, which programs that read CSV take for what it is.
            let [mean, max, psnr_db, ssim] = [d.mean, d.max, d.psnr_db, d.ssim].map(|v| v.to_string());
            text.push_str(&csv_line(&[a, b, mean, max, psnr_db, ssim, picture.file.clone()]));
        }
        text
    }

    fn page(&self, pictures: &[Encoded], differences: &[Encoded]) -> String {
        let [width, height] = self.size();
        let title = escaped(&self.title);
        let mut page = format!(
            "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n\
             <title>{title}</title>\n<style>{STYLE}</style>\n<h1>{title}</h1>\n\
             <p>One scene, {width} × {height} pixels: the same volume, view, transfer function and light in every picture. incise {VERSION}.</p>\n"
        );
        let captions: Vec<String> = self
            .runs
            .iter()
            .map(|run| run.name.clone())
            .chain(self.pairs.iter().map(|pair| format!("difference of {} and {}", self.runs[pair.a].name, self.runs[pair.b].name)))
            .map(|caption| escaped(&caption))
            .collect();
        if captions.len() > 1 {
            let option = |(n, caption): (usize, &String)| format!("<option value=\"picture-{n}\">{caption}</option>");
            let options: String = captions.iter().enumerate().map(option).collect();
            page.push_str(&format!(
                "<section id=\"wipe\" hidden>\n<h2>Side by side</h2>\n<p><label>Left <select id=\"left\">{options}</select></label> \
                 <label>Right <select id=\"right\">{options}</select></label></p>\n\
                 <div id=\"stack\"><img id=\"left-picture\" alt=\"\" draggable=\"false\"><img id=\"right-picture\" alt=\"\" draggable=\"false\">\
                 <div id=\"edge\"></div></div>\n\
                 <p><input id=\"at\" type=\"range\" min=\"0\" max=\"100\" step=\"0.1\" value=\"50\" \
                 aria-label=\"Where the left picture ends, percent\"></p>\n\
                 </section>\n"
            ));
        }
        page.push_str(&self.run_table());
        if !self.pairs.is_empty() {
            page.push_str(&self.pair_table());
        }
        page.push_str("<h2>Pictures</h2>\n<div class=\"pictures\">\n");
        for (n, (encoded, caption)) in pictures.iter().chain(differences).zip(&captions).enumerate() {
            page.push_str(&format!(
                "<figure><img id=\"picture-{n}\" alt=\"{caption}\" src=\"data:image/png;base64,{}\"><figcaption>{caption}</figcaption></figure>\n",
                STANDARD.encode(&encoded.png)
            ));
        }
        page.push_str("</div>\n");
        if !self.scene_toml.trim().is_empty() {
            page.push_str(&format!("<details><summary>The scene</summary><pre>{}</pre></details>\n", escaped(&self.scene_toml)));
        }
        page.push_str(&format!("<script>{SCRIPT}</script>\n</html>\n"));
        page
    }

    fn run_table(&self) -> String {
        let stages = self.stage_names();
        let mut table = String::from(
            "<h2>Cost</h2>\n<div class=\"wide\"><table>\n<tr><th>Run</th><th>Backend</th><th>Step, voxels</th><th>Time, ms</th>\
             <th>Samples taken</th><th>skipped</th><th>terminated</th>",
        );
        for stage in &stages {
            table.push_str(&format!("<th>{}, ms</th>", escaped(stage)));
        }
        table.push_str("</tr>\n");
        let cell = |text: Option<String>| format!("<td>{}</td>", text.unwrap_or_else(|| "–".to_owned()));
        for run in &self.runs {
            table.push_str(&format!("<tr><th>{}</th><td class=\"text\">{}</td>", escaped(&run.name), escaped(&run.backend)));
            table.push_str(&cell(Some(run.step.to_string())));
            table.push_str(&cell(Some(format!("{:.1}", run.milliseconds))));
            for count in samples(run) {
                table.push_str(&cell(count.map(grouped)));
            }
            for stage in &stages {
                table.push_str(&cell(stage_milliseconds(run, stage).map(|ms| format!("{ms:.1}"))));
            }
            table.push_str("</tr>\n");
        }
        table.push_str(
            "</table></div>\n<p class=\"note\">Skipped samples lie in cells that show nothing, terminated ones behind what is opaque. A dash: not \
             counted, or no such stage.</p>\n",
        );
        table
    }

    fn pair_table(&self) -> String {
        let mut table = String::from(
            "<h2>Differences</h2>\n<div class=\"wide\"><table>\n<tr><th>Run</th><th>Run</th><th>Mean, of 255</th><th>Largest, of 255</th>\
             <th>PSNR, dB</th><th>SSIM</th></tr>\n",
        );
        for pair in &self.pairs {
            let d = pair.difference;
            let psnr = if d.psnr_db.is_finite() { format!("{:.2}", d.psnr_db) } else { "∞".to_owned() };
            table.push_str(&format!(
                "<tr><th>{}</th><th>{}</th><td>{:.3}</td><td>{:.1}</td><td>{psnr}</td><td>{:.5}</td></tr>\n",
                escaped(&self.runs[pair.a].name),
                escaped(&self.runs[pair.b].name),
                d.mean,
                d.max,
                d.ssim
            ));
        }
        table.push_str(&format!(
            "</table></div>\n<p class=\"note\">Mean, largest and PSNR over red, green, blue and alpha, premultiplied, without the background. SSIM: \
             Wang et al. 2004, 11 × 11 Gaussian window, luminance over black. Difference pictures show the largest difference of any channel, \
             {} times as large: black is none, then violet, orange, pale yellow.</p>\n",
            self.amplify
        ));
        table
    }
}

/// Samples taken, skipped and terminated, if they were counted.
fn samples(run: &Run) -> [Option<u64>; 3] {
    run.stats.map_or([None; 3], |s| [s.samples_taken, s.samples_skipped, s.samples_terminated].map(Some))
}

/// Time that all stages of a name took together; none if there is no such stage.
fn stage_milliseconds(run: &Run, stage: &str) -> Option<f64> {
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

/// Text as HTML, in an element or a quoted attribute.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            _ => out.push(c),
        }
    }
    out
}

/// A count in groups of three digits, kept apart by spaces that do not break.
fn grouped(count: u64) -> String {
    let digits = count.to_string();
    let mut out = String::new();
    for (n, digit) in digits.chars().enumerate() {
        if n > 0 && (digits.len() - n).is_multiple_of(3) {
            out.push('\u{a0}');
        }
        out.push(digit);
    }
    out
}

/// Greys only: the pictures are the colours of the page. Text has a contrast of at least 7 to 1 on either background.
const STYLE: &str = "
:root{color-scheme:light dark;--page:#fff;--text:#1b1b1b;--quiet:#505050;--line:#c4c4c4}
@media (prefers-color-scheme:dark){:root{--page:#171717;--text:#e4e4e4;--quiet:#b4b4b4;--line:#484848}}
body{margin:2em;font:15px/1.45 system-ui,sans-serif;color:var(--text);background:var(--page)}
h1{font-size:1.5em;font-weight:600}h2{font-size:1.15em;font-weight:600;margin:1.8em 0 .5em}
.note,figcaption{color:var(--quiet);max-width:60em}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:.25em .8em;border-bottom:1px solid var(--line);text-align:right;white-space:nowrap}
th,td.text{text-align:left;font-weight:600}td.text{font-weight:400}
img{display:block;max-width:100%;height:auto;background:repeating-conic-gradient(#777 0 25%,#999 0 50%) 0 0/16px 16px}
.pictures{display:flex;flex-wrap:wrap;gap:1.5em}
figure{margin:0;max-width:100%}figcaption{margin-top:.3em}
#stack{position:relative;width:fit-content;max-width:100%;touch-action:pan-y;cursor:ew-resize;user-select:none}
#right-picture{position:absolute;inset:0;width:100%;height:100%}
#edge{position:absolute;top:0;bottom:0;width:2px;margin-left:-1px;background:#fff;outline:1px solid #000;pointer-events:none}
#at{width:100%;max-width:40em}
select{font:inherit;color:inherit;background:var(--page);border:1px solid var(--quiet);padding:.15em}
pre{overflow-x:auto;padding:1em;border:1px solid var(--line)}summary{margin-top:1.8em;cursor:pointer}
";

/// The pictures of the wipe are those of the page, by their ids, so that the page holds each once.
const SCRIPT: &str = "
(() => {
  const byId = id => document.getElementById(id);
  const wipe = byId('wipe');
  if (!wipe) return;
  const stack = byId('stack'), at = byId('at');
  const sides = ['left', 'right'].map(side => ({ select: byId(side), picture: byId(side + '-picture') }));
  const choose = () => sides.forEach(({ select, picture }) => {
    const from = byId(select.value);
    picture.src = from.src;
    picture.alt = from.alt;
  });
  const move = () => {
    const x = Number(at.value);
    sides[0].picture.style.clipPath = 'inset(0 ' + (100 - x) + '% 0 0)';
    sides[1].picture.style.clipPath = 'inset(0 0 0 ' + x + '%)';
    byId('edge').style.left = x + '%';
  };
  const drag = event => {
    if (!(event.buttons & 1)) return;
    const box = stack.getBoundingClientRect();
    at.value = 100 * (event.clientX - box.left) / box.width;
    move();
  };
  sides[1].select.selectedIndex = 1;
  sides.forEach(({ select }) => select.addEventListener('change', choose));
  at.addEventListener('input', move);
  stack.addEventListener('pointerdown', event => { stack.setPointerCapture(event.pointerId); drag(event); });
  stack.addEventListener('pointermove', drag);
  choose();
  move();
  wipe.hidden = false;
})();
";

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn run(name: &str, color: [f32; 4]) -> Run {
        Run {
            name: name.to_owned(),
            picture: Picture { width: 4, height: 3, pixels: vec![color; 12] },
            milliseconds: 12.5,
            stages: vec![("maps".to_owned(), 2.0), ("render".to_owned(), 10.0)],
            stats: Some(RenderStats { samples_taken: 1_234_567, samples_skipped: 2, samples_terminated: 3 }),
            backend: "cpu".to_owned(),
            step: 0.5,
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
        assert!(runs.lines().count() == 3 && runs.contains("\n\"ray, 1/2\",cpu,0.5,12.5,1234567,2,3,ray--1-2.png,2,10\n"), "{runs}");
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

    #[test]
    fn counts_are_grouped() {
        assert_eq!([7, 1_000, 1_234_567].map(grouped), ["7", "1\u{a0}000", "1\u{a0}234\u{a0}567"]);
    }
}
