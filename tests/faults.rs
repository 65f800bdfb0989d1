//! Files of the kinds that people complain about elsewhere, with what must come out of each: the
//! values, geometry, times, labels and notices that a peer program or a standard states.
//!
//! `faults/listed` holds files of public reports. The packs beside it hold those that
//! `faults/make_*.py` make, as `faults/pack.py` packs them; `faults/check.py` does the same checks
//! on any build of the program.

use crate::readers::read;
use bzip2::read::BzDecoder;
use glam::DVec3;
use incise::Watch;
use incise::deform::transform::{Transform, TransformContext};
use incise::mesh::{Mesh, TriangleBvh};
use incise::volume::Volume;
use incise::volume::load::{self, ReadOptions};
use rayon::prelude::*;
use serde_json::Value;
use std::fmt::Debug;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults")
}

pub fn listed_files() {
    check(&folder().join("listed"));
}

pub fn dicom_files() {
    check_pack("dicom");
}

pub fn contours() {
    check_pack("contours");
}

pub fn arrays() {
    check_pack("arrays");
}

pub fn headers_meshes_and_transforms() {
    check_pack("headers");
}

/// Unpacks the cases of an area.
fn unpacked(area: &str) -> tempfile::TempDir {
    let packed = std::fs::read(folder().join(format!("{area}.zip.bz2"))).unwrap();
    let mut bytes = Vec::new();
    BzDecoder::new(&packed[..]).read_to_end(&mut bytes).unwrap();
    let place = tempfile::tempdir().unwrap();
    zip::ZipArchive::new(Cursor::new(bytes))
        .unwrap()
        .extract(place.path())
        .unwrap();
    place
}

fn check_pack(area: &str) {
    check(unpacked(area).path());
}

/// Checks all cases of a folder.
fn check(folder: &Path) {
    let cases: Vec<Value> =
        serde_json::from_slice(&std::fs::read(folder.join("cases.json")).unwrap()).unwrap();
    assert!(!cases.is_empty());
    let wrong: Vec<String> = cases
        .par_iter()
        .flat_map(|case| {
            let name = format!("{}: {}", text(&case["kind"]), text(&case["name"]));
            let problems = problems_of_case(folder, case);
            problems
                .into_iter()
                .map(move |p| format!("{name}: {p}"))
                .collect::<Vec<_>>()
        })
        .collect();
    assert!(
        wrong.is_empty(),
        "{} of {} cases:\n{}",
        wrong.len(),
        cases.len(),
        wrong.join("\n")
    );
    println!("{} files are read, or refused, as they should be", cases.len());
}

/// What is wrong with a case; of several expectations one must hold.
fn problems_of_case(folder: &Path, case: &Value) -> Vec<String> {
    let Some(forms) = case["either"].as_array() else {
        return problems(folder, case);
    };
    let mut all: Vec<Vec<String>> = Vec::new();
    for form in forms {
        let mut whole = case.clone();
        whole
            .as_object_mut()
            .unwrap()
            .extend(form.as_object().unwrap().clone());
        all.push(problems(folder, &whole));
    }
    all.into_iter().min_by_key(Vec::len).unwrap()
}

fn problems(folder: &Path, case: &Value) -> Vec<String> {
    let path = folder.join(text(&case["path"]));
    let mut found = Problems {
        case,
        list: Vec::new(),
    };
    if case.get("points").is_some() || case["kind"].as_str().is_some_and(|k| k.contains("transform")) {
        found.of_transform(folder, &path);
    } else if incise::mesh::load::is_mesh(&path) {
        found.of_mesh(&path);
    } else {
        found.of_volume(&path);
    }
    found.list
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or("")
}

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(all) => all.iter().flat_map(numbers).collect(),
        other => vec![other.as_f64().unwrap_or(f64::NAN)],
    }
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// Whether a text holds a fragment, or one of several, in any case.
fn holds(whole: &str, fragment: &Value) -> bool {
    let holds = |f: &Value| whole.to_lowercase().contains(&text(f).to_lowercase());
    fragment
        .as_array()
        .map_or_else(|| holds(fragment), |forms| forms.iter().any(holds))
}

fn options(case: &Value, channel: Option<usize>) -> ReadOptions {
    let given = &case["options"];
    let whole = |name: &str| given[name].as_u64().map(|n| n as usize);
    ReadOptions {
        series: given["series"].as_str().map(str::to_owned),
        time: whole("time"),
        channel: channel.or(whole("channel")),
        level: whole("level"),
        resample: given["resample"] == true,
        ..ReadOptions::default()
    }
}

/// The data value of a voxel; none outside.
fn at(volume: &Volume, place: &[f64]) -> Option<f64> {
    let index: [usize; 3] = std::array::from_fn(|a| place[a] as usize);
    let inside = (0..3).all(|a| index[a] < volume.size[a]);
    inside.then(|| volume.value(index[0], index[1], index[2]))
}

fn near(found: f64, expected: f64, relative: f64, absolute: f64) -> bool {
    expected.is_nan() && found.is_nan() || (found - expected).abs() <= absolute + relative * expected.abs()
}

struct Problems<'a> {
    case: &'a Value,
    list: Vec<String>,
}

impl Problems<'_> {
    fn tolerance(&self, usual: f64) -> f64 {
        self.case["tolerance"].as_f64().unwrap_or(usual)
    }

    fn note(&mut self, problem: String) {
        self.list.push(problem);
    }

    fn equal<T: PartialEq + Debug>(&mut self, name: &str, found: T, expected: Option<T>) {
        if let Some(expected) = expected
            && found != expected
        {
            self.note(format!("{name} is {found:?}, not {expected:?}"));
        }
    }

    fn all_near(&mut self, name: &str, found: &[f64], [relative, absolute]: [f64; 2]) {
        let Some(expected) = self.case.get(name).map(numbers) else {
            return;
        };
        let pairs = found.iter().zip(&expected);
        if found.len() != expected.len() || !pairs.clone().all(|(f, e)| near(*f, *e, relative, absolute)) {
            self.note(format!("{name} is {found:?}, not {expected:?}"));
        }
    }

    fn count(&self, name: &str) -> Option<usize> {
        self.case[name].as_u64().map(|n| n as usize)
    }

    /// The result, if the file is to be read and was.
    fn accepted<T>(&mut self, result: incise::Result<T>) -> Option<T> {
        match (result, self.case.get("error")) {
            (Ok(read), None) => return Some(read),
            (Ok(_), Some(expected)) => self.note(format!("was read, not refused with {expected}")),
            (Err(error), None) => self.note(format!("refused: {error}")),
            (Err(error), Some(expected)) => {
                if !list(expected).iter().all(|e| holds(&error.to_string(), e)) {
                    self.note(format!("refused with \"{error}\", not with {expected}"));
                }
            }
        }
        None
    }

    fn notices(&mut self, warnings: &[String]) {
        let case = self.case;
        for fragment in list(&case["warns"]) {
            if !warnings.iter().any(|w| holds(w, fragment)) {
                self.note(format!("no notice says {fragment}: {warnings:?}"));
            }
        }
        for fragment in list(&case["not_warns"]) {
            if let Some(w) = warnings.iter().find(|w| holds(w, fragment)) {
                self.note(format!("a notice says {fragment}: {w}"));
            }
        }
    }

    fn of_volume(&mut self, path: &Path) {
        let case = self.case;
        let Some(volume) = self.accepted(read(path, &options(case, None))) else {
            return;
        };
        if case.get("size").is_some() {
            let expected = numbers(&case["size"]).iter().map(|n| *n as usize).collect();
            self.equal("size", volume.size.to_vec(), Some(expected));
        }
        self.equal("components", volume.components, self.count("components"));
        self.equal("inverted", volume.inverted, case["inverted"].as_bool());
        self.all_near("spacing_mm", &volume.spacing_mm().to_array(), [1e-4, 1e-12]);
        self.all_near(
            "origin_mm",
            &volume.world_from_voxel.translation.to_array(),
            [1e-6, 2e-4],
        );
        let rows = volume.direction().transpose().to_cols_array();
        self.all_near("direction", &rows, [1e-6, 2e-4]);
        let detail = |name: &str| {
            volume
                .details
                .iter()
                .find(|(n, _)| *n == name)
                .map(|(_, v)| v.clone())
        };
        let times = detail("time_points").and_then(|n| n.as_u64()).unwrap_or(1);
        self.equal("time points", times, case["time_points"].as_u64());
        self.equal(
            "modality",
            detail("modality"),
            case.get("modality").map(|m| Some(m.clone())),
        );
        let series = detail("series").unwrap_or(Value::Null);
        self.equal("description", &series["description"], case.get("description"));
        if let Some(count) = self.count("series") {
            let all = load::series(path, false, &Watch::NONE)
                .unwrap()
                .unwrap_or_default();
            self.equal("number of series", all.len().max(1), Some(count));
        }
        for (value, name) in case["labels"].as_object().into_iter().flatten() {
            let label = volume.label_table.iter().find(|l| l.value.to_string() == *value);
            self.equal(
                &format!("label {value}"),
                label.map(|l| l.name.as_str()),
                Some(name.as_str()),
            );
        }
        for (value, count) in case["count"].as_object().into_iter().flatten() {
            let label: f64 = value.parse().unwrap();
            let found = (0..volume.voxels.len())
                .filter(|n| volume.voxels.get(*n) == label)
                .count();
            self.equal(&format!("voxels of label {value}"), found as u64, count.as_u64());
        }
        self.notices(&volume.warnings);
        let tolerance = self.tolerance(1e-3);
        for expected in list(&case["values"]) {
            let expected = numbers(expected);
            let found = at(&volume, &expected);
            if !found.is_some_and(|f| near(f, expected[3], 1e-5, tolerance)) {
                self.note(format!(
                    "value at {:?} is {found:?}, not {}",
                    &expected[..3],
                    expected[3]
                ));
            }
        }
        self.colors(path);
    }

    fn colors(&mut self, path: &Path) {
        let (case, tolerance) = (self.case, self.tolerance(0.5));
        if list(&case["colors"]).is_empty() {
            return;
        }
        let channels: Vec<Volume> = (1..=3)
            .map(|c| read(path, &options(case, Some(c))).unwrap())
            .collect();
        for expected in list(&case["colors"]) {
            let expected = numbers(expected);
            let found: Vec<f64> = channels
                .iter()
                .map(|c| at(c, &expected).unwrap_or(f64::NAN))
                .collect();
            if !found
                .iter()
                .zip(&expected[3..])
                .all(|(f, e)| near(*f, *e, 0.0, tolerance))
            {
                self.note(format!(
                    "colour at {:?} is {found:?}, not {:?}",
                    &expected[..3],
                    &expected[3..]
                ));
            }
        }
    }

    fn of_mesh(&mut self, path: &Path) {
        let Some(mesh) = self.accepted(incise::mesh::load::mesh(path)) else {
            return;
        };
        self.equal("triangles", mesh.triangles.len(), self.count("triangles"));
        self.equal("vertices", mesh.positions.len(), self.count("vertices"));
        self.all_near("volume_mm3", &[mesh.topology().volume], [1e-4, 1e-6]);
        self.notices(&mesh.warnings);
        self.distances(mesh);
    }

    /// Signed distances, positive inside.
    fn distances(&mut self, mesh: Mesh) {
        let tolerance = self.tolerance(2e-3);
        let topology = mesh.topology();
        let turned = topology.flipped_edges > 0 || topology.volume < 0.0;
        let mesh = if turned { mesh.oriented().0 } else { mesh };
        let tree = TriangleBvh::new(&mesh);
        for expected in list(&self.case["sdf"]) {
            let expected = numbers(expected);
            let p = DVec3::from_slice(&expected).as_vec3();
            let distance = (tree.nearest(p, f32::MAX).unwrap().point - p).length();
            let sign = if tree.winding(p).abs() > 0.5 { 1.0 } else { -1.0 };
            let found = f64::from(sign * distance);
            if !near(found, expected[3], 1e-3, tolerance) {
                self.note(format!("signed distance at {p} is {found}, not {}", expected[3]));
            }
        }
    }

    fn of_transform(&mut self, folder: &Path, path: &Path) {
        let given = &self.case["options"];
        let grid = |name: &str| {
            let volume = folder.join(given[name].as_str()?);
            Some(read(&volume, &ReadOptions::default()).unwrap().geometry())
        };
        let context = TransformContext {
            moving: grid("volume"),
            reference: grid("reference").or_else(|| grid("volume")),
            convention: given["convention"].as_str(),
        };
        let Some(transform) = self.accepted(Transform::load(path, &context)) else {
            return;
        };
        self.notices(&transform.warnings);
        let tolerance = self.tolerance(5e-3);
        for expected in list(&self.case["points"]) {
            let expected = numbers(expected);
            let found = transform.source_from_deformed(DVec3::from_slice(&expected));
            let source = DVec3::from_slice(&expected[3..]);
            if !(found - source)
                .abs()
                .to_array()
                .iter()
                .all(|d| *d <= tolerance + 1e-4 * source.length())
            {
                self.note(format!("{:?} comes from {found}, not {source}", &expected[..3]));
            }
        }
    }
}
