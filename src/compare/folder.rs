//! A comparison as a folder: pictures, differences, and the numbers as a page and as JSON and CSV.

use super::curves::{EqualError, RendererCost, equal_errors};
use super::explanation::explanation;
use super::metrics::difference_picture;
use super::report::{Encoded, Report, RunPair, VERSION};
use super::run::{Run, mode_name, samples, stage_milliseconds};
use crate::files::OutputFile;
use crate::{Error, Result};
use serde_json::{Value, json};
use std::collections::HashSet;
use std::path::Path;

/// Longest part of a file's name that comes from a run's name, characters.
const MAX_NAME: usize = 60;

impl Report {
    /// Writes `NAME.png` for every run, `difference-A-B.png` for every pair, `report.json`,
    /// `runs.csv`, `pairs.csv` and `index.html` into a folder, which is created if it does not
    /// exist. Files of these names are replaced, others stay.
    ///
    /// # Errors
    /// A folder that cannot be created or written, an amplification that is not positive.
    pub fn write(&self, folder: &Path) -> Result<()> {
        write_files(folder, &self.files()?)
    }

    /// The files of the report by name, in the order in which they are to be written. The page is
    /// last, so that all files it refers to exist before it does.
    ///
    /// # Errors
    /// An amplification that is not positive.
    pub fn files(&self) -> Result<Vec<(String, Vec<u8>)>> {
        let mut taken = HashSet::new();
        let mut pictures = Vec::new();
        for run in &self.runs {
            pictures.push(Encoded {
                file: file_name(&plain(&run.name), &mut taken),
                png: run.picture.png(self.background)?,
            });
        }
        let mut differences = Vec::new();
        for pair in &self.pairs {
            let [a, b] = [pair.a, pair.b].map(|n| &self.runs[n]);
            let file = file_name(
                &format!("difference-{}-{}", plain(&a.name), plain(&b.name)),
                &mut taken,
            );
            let shown = difference_picture(&a.picture, &b.picture, self.amplify)?;
            differences.push(Encoded {
                file,
                png: shown.png([0.0, 0.0, 0.0, 1.0])?,
            });
        }
        let equal = equal_errors(&self.runs);
        let json = format!("{:#}\n", self.json(&pictures, &differences, &equal));
        let page = self.page(&pictures, &differences, &equal);
        let texts = [
            ("report.json", json),
            ("runs.csv", self.runs_csv(&pictures)),
            ("pairs.csv", self.pairs_csv(&differences)),
            ("index.html", page),
        ];
        let pictures = pictures.into_iter().chain(differences).map(|e| (e.file, e.png));
        Ok(pictures
            .chain(texts.map(|(file, text)| (file.to_owned(), text.into_bytes())))
            .collect())
    }

    fn json(&self, pictures: &[Encoded], differences: &[Encoded], equal: &[EqualError]) -> Value {
        let row = |(run, picture): (&Run, &Encoded)| {
            let samples = run.stats.map(|s| json!({ "taken": s.samples_taken, "skipped": s.samples_skipped, "terminated": s.samples_terminated }));
            let reference = run
                .error
                .and_then(|_| self.runs.iter().find(|r| r.is_reference && r.shown == run.shown))
                .map(|r| &r.name);
            json!({
                "name": run.name,
                "mode": run.mode,
                "backend": run.backend,
                "method": run.method,
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
        let rows = |references: bool| -> Vec<Value> {
            self.runs
                .iter()
                .zip(pictures)
                .filter(|r| r.0.is_reference == references)
                .map(row)
                .collect()
        };
        let pair = |(pair, picture): (&RunPair, &Encoded)| {
            let d = pair.difference;
            json!({
                "a": self.runs[pair.a].name, "b": self.runs[pair.b].name,
                "mean": d.mean, "max": d.max, "rms": d.rms(), "psnr_db": finite(d.psnr_db), "ssim": d.ssim,
                "picture": picture.file,
            })
        };
        let at_equal_error = |e: &EqualError| {
            let entry = |entry: &RendererCost| {
                json!({
                    "mode": entry.mode, "backend": entry.backend, "variant": entry.variant,
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
            "explanation": explanation(&self.runs),
            "equal_error": equal.iter().map(at_equal_error).collect::<Vec<_>>(),
        })
    }

    fn runs_csv(&self, pictures: &[Encoded]) -> String {
        let stages = self.stage_names();
        let columns = "name,mode,backend,variant,step_voxels,width,height,camera,milliseconds,milliseconds_min,milliseconds_max,rendering_milliseconds,\
                       rendering_milliseconds_min,rendering_milliseconds_max,repetitions,warm_up_milliseconds,samples_taken,samples_skipped,\
                       samples_terminated,volume_bytes,gradient_bytes,map_bytes,surface_bytes,peak_bytes,\
                       error_mean,error_max,error_rms,error_psnr_db,error_ssim,reference,picture";
        let mut header: Vec<String> = columns.split(',').map(String::from).collect();
        header.extend(stages.iter().map(|stage| format!("milliseconds {stage}")));
        let mut text = csv_line(&header);
        for (run, picture) in self.runs.iter().zip(pictures) {
            let mut line = vec![
                run.name.clone(),
                mode_name(run.mode).to_owned(),
                run.backend.clone(),
                run.method.variant.clone(),
                run.step.to_string(),
            ];
            line.extend(run.shown.size.map(|n| n.to_string()));
            line.push(run.shown.camera.clone());
            line.extend(
                [run.milliseconds, run.rendering]
                    .iter()
                    .flat_map(|t| [t.median, t.min, t.max])
                    .map(|ms| ms.to_string()),
            );
            line.extend([run.repetitions.to_string(), optional(run.warm_up)]);
            line.extend(samples(run).map(optional));
            let memory = run.memory;
            line.extend(
                [
                    memory.volume_bytes,
                    memory.gradient_bytes,
                    memory.map_bytes,
                    memory.surface_bytes,
                ]
                .map(|n| n.to_string()),
            );
            line.push(optional(run.memory.peak_bytes));
            line.extend(
                run.error
                    .map_or([None; 5], |d| {
                        [d.mean, d.max, d.rms(), d.psnr_db, d.ssim].map(Some)
                    })
                    .map(optional),
            );
            line.extend([run.is_reference.to_string(), picture.file.clone()]);
            line.extend(
                stages
                    .iter()
                    .map(|stage| optional(stage_milliseconds(run, stage))),
            );
            text.push_str(&csv_line(&line));
        }
        text
    }

    fn pairs_csv(&self, differences: &[Encoded]) -> String {
        let mut text =
            csv_line(&["a", "b", "mean", "max", "psnr_db", "ssim", "rms", "picture"].map(String::from));
        for (pair, picture) in self.pairs.iter().zip(differences) {
            let d = pair.difference;
            let [a, b] = [pair.a, pair.b].map(|n| self.runs[n].name.clone());
            // An infinite PSNR is written as `inf`, which CSV readers parse as infinity.
            let [mean, max, psnr_db, ssim, rms] =
                [d.mean, d.max, d.psnr_db, d.ssim, d.rms()].map(|v| v.to_string());
            text.push_str(&csv_line(&[
                a,
                b,
                mean,
                max,
                psnr_db,
                ssim,
                rms,
                picture.file.clone(),
            ]));
        }
        text
    }
}

/// Writes files into a folder, which is created if it does not exist, in their order.
///
/// # Errors
/// A folder that cannot be created or written, or that holds an entry that cannot be replaced; then
/// nothing is written.
pub fn write_files(folder: &Path, files: &[(String, Vec<u8>)]) -> Result<()> {
    if let Some(path) = files
        .iter()
        .map(|(file, _)| folder.join(file))
        .find(|path| path.is_dir())
    {
        return Err(Error::file(
            &path,
            "is a folder where a file is to be written; remove it, or choose another folder",
        ));
    }
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "making", e))?;
    let outputs = files
        .iter()
        .map(|(file, _)| OutputFile::create(&folder.join(file)))
        .collect::<Result<Vec<_>>>()?;
    outputs
        .into_iter()
        .zip(files)
        .try_for_each(|(output, (_, content))| output.finish(content))
}

/// Stage names with their milliseconds.
fn stage_list(stages: &[(String, f64)]) -> Vec<Value> {
    stages
        .iter()
        .map(|(name, ms)| json!({ "name": name, "milliseconds": ms }))
        .collect()
}

/// A single-precision number with its shortest decimal form: converted directly to double it would
/// gain digits.
fn as_written(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

/// `None` for infinity, which JSON lacks.
fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// A field of CSV; empty if there is no value.
fn optional<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(String::new, |v| v.to_string())
}

/// A name that is valid on any file system, without an extension: letters, digits, hyphens and
/// underscores.
fn plain(name: &str) -> String {
    let safe = name.chars().map(|c| {
        if c.is_ascii_alphanumeric() || c == '_' {
            c
        } else {
            '-'
        }
    });
    let plain: String = safe.take(MAX_NAME).collect();
    let plain = plain.trim_matches('-');
    if plain.is_empty() {
        "run".to_owned()
    } else {
        plain.to_owned()
    }
}

/// The picture file for a plain name, distinct from all `taken` names even without regard to case.
fn file_name(plain: &str, taken: &mut HashSet<String>) -> String {
    let mut file = format!("{plain}.png");
    let mut more = 1;
    while !taken.insert(file.to_lowercase()) {
        more += 1;
        file = format!("{plain}-{more}.png");
    }
    file
}

/// One line of CSV (RFC 4180, except for the line end).
fn csv_line(fields: &[String]) -> String {
    let quoted = |field: &String| {
        if field.contains([',', '"', '\n', '\r']) {
            format!("\"{}\"", field.replace('"', "\"\""))
        } else {
            field.clone()
        }
    };
    let mut line = fields.iter().map(quoted).collect::<Vec<_>>().join(",");
    line.push('\n');
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::report::tests::run;

    fn report(names: [&str; 2]) -> Report {
        let runs = vec![
            run(names[0], [0.2, 0.2, 0.2, 1.0]),
            run(names[1], [0.3, 0.2, 0.2, 1.0]),
        ];
        Report::new(
            "Slices & rays",
            "incise = 1\n[volume]\npath = \"<ball>\"\n",
            [0.0, 0.0, 0.0, 1.0],
            runs,
        )
        .unwrap()
    }

    #[test]
    fn a_report_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("made/here");
        report(["slice", "ray, 1/2"]).write(&folder).unwrap();
        let mut files: Vec<String> = std::fs::read_dir(&folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        files.sort();
        let expected = [
            "difference-slice-ray--1-2.png",
            "index.html",
            "pairs.csv",
            "ray--1-2.png",
            "report.json",
            "runs.csv",
            "slice.png",
        ];
        assert_eq!(files, expected);
        let read = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
        let json: Value = serde_json::from_str(&read("report.json")).unwrap();
        assert_eq!(json["incise"], VERSION);
        assert_eq!(json["size"], json!([4, 3]));
        assert_eq!(
            json["runs"][0]["samples"],
            json!({ "taken": 1_234_567, "skipped": 2, "terminated": 3 })
        );
        assert_eq!(
            json["runs"][1]["stages"][1],
            json!({ "name": "render", "milliseconds": 10.0 })
        );
        assert_eq!(
            (&json["pairs"][0]["a"], &json["pairs"][0]["b"]),
            (&json!("slice"), &json!("ray, 1/2"))
        );
        assert!((json["pairs"][0]["max"].as_f64().unwrap() - 25.5).abs() < 1e-3);
        assert_eq!(json["pairs"][0]["picture"], "difference-slice-ray--1-2.png");
        let runs = read("runs.csv");
        assert!(
            runs.lines().count() == 3
                && runs
                    .contains("\n\"ray, 1/2\",slice,cpu,,0.5,4,3,anterior,12.5,12,14,10,9,11,3,,1234567,2,3,64,0,0,0,,,,,,,false,ray--1-2.png,2,10\n"),
            "{runs}"
        );
        assert!(
            read("pairs.csv")
                .lines()
                .nth(1)
                .is_some_and(|line| line.starts_with("slice,\"ray, 1/2\","))
        );
        let html = read("index.html");
        assert!(
            !html.contains("http")
                && !html.contains("<ball>")
                && html.contains("&lt;ball&gt;")
                && html.contains("Slices &amp; rays")
        );
        assert_eq!(html.matches("data:image/png;base64,").count(), 3);
        let decoded = image::load_from_memory(&std::fs::read(folder.join("slice.png")).unwrap()).unwrap();
        assert_eq!((decoded.width(), decoded.height()), (4, 3));
    }

    #[test]
    fn equal_pictures_have_no_psnr_in_json() {
        let folder = tempfile::tempdir().unwrap();
        let runs = vec![run("a", [0.5; 4]), run("b", [0.5; 4])];
        Report::new("", "", [0.0; 4], runs)
            .unwrap()
            .write(folder.path())
            .unwrap();
        let json: Value =
            serde_json::from_slice(&std::fs::read(folder.path().join("report.json")).unwrap()).unwrap();
        assert!(
            json["pairs"][0]["psnr_db"].is_null() && json["pairs"][0]["ssim"] == 1.0,
            "{json}"
        );
        assert!(
            std::fs::read_to_string(folder.path().join("pairs.csv"))
                .unwrap()
                .contains(",inf,")
        );
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
        for (name, expected) in [
            ("...", "run"),
            ("", "run"),
            ("difference-../x", "difference----x"),
            ("näher", "n-her"),
            ("a\\b:c", "a-b-c"),
        ] {
            assert_eq!(plain(name), expected);
        }
        assert!(plain(&"long ".repeat(100)).len() <= MAX_NAME);
    }
}
