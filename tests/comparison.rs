//! End-to-end tests of `incise compare`: all files are written, errors decrease with the step, and
//! invalid input gives one message.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn compare(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_incise"))
        .current_dir(folder)
        .arg("compare")
        .args(arguments)
        .env_remove("DISPLAY")
        .output()
        .unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn read(folder: &Path, file: &str) -> String {
    std::fs::read_to_string(folder.join(file)).unwrap_or_else(|e| panic!("{file}: {e}"))
}

fn report(folder: &Path) -> Value {
    serde_json::from_str(&read(folder, "report.json")).unwrap()
}

/// Checks that a report's pictures, tables and page agree; returns the report.
fn whole(folder: &Path) -> Value {
    let report = report(folder);
    let rows = |key: &str| report[key].as_array().unwrap().clone();
    let (runs, references, pairs) = (rows("runs"), rows("references"), rows("pairs"));
    assert_eq!(
        read(folder, "runs.csv").lines().count(),
        1 + runs.len() + references.len()
    );
    assert_eq!(read(folder, "pairs.csv").lines().count(), 1 + pairs.len());
    let mut pictures = std::collections::HashSet::new();
    for row in runs.iter().chain(&references).chain(&pairs) {
        let file = row["picture"].as_str().unwrap();
        assert!(pictures.insert(file.to_owned()), "{file} twice");
        assert!(
            std::fs::read(folder.join(file)).unwrap().starts_with(b"\x89PNG"),
            "{file}"
        );
    }
    for run in runs.iter().chain(&references) {
        let decoded = image::open(folder.join(run["picture"].as_str().unwrap())).unwrap();
        assert_eq!(
            run["size"],
            serde_json::json!([decoded.width(), decoded.height()])
        );
        let number = |key: &str| run[key].as_f64().unwrap_or_else(|| panic!("{key} of {run:#}"));
        assert!(0.0 < number("milliseconds_min") && number("milliseconds_min") <= number("milliseconds"));
        assert!(
            number("milliseconds") <= number("milliseconds_max")
                && number("rendering_milliseconds") <= number("milliseconds_max")
        );
        let stages: f64 = run["stages"]
            .as_array()
            .unwrap()
            .iter()
            .map(|s| s["milliseconds"].as_f64().unwrap())
            .sum();
        assert!(
            stages > 0.0 && stages <= number("milliseconds") * 1.01,
            "stages of {run:#}"
        );
        // The arguments appear in both.
        let step = run["step_voxels"].to_string();
        assert!(
            step.len() < 7
                && read(folder, "runs.csv").contains(&format!(
                    ",{},,{},",
                    run["backend"].as_str().unwrap(),
                    step.trim_end_matches(".0")
                ))
        );
        let memory = |key: &str| {
            run["memory"][key]
                .as_u64()
                .unwrap_or_else(|| panic!("{key} of {run:#}"))
        };
        assert!(memory("volume_bytes") > 0 && memory("gradient_bytes") % 8 == 0);
        assert!(run["samples"]["taken"].as_u64().is_some_and(|n| n > 0), "{run:#}");
        assert!(
            !cfg!(target_os = "linux") || run["memory"]["peak_bytes"].as_u64().is_some_and(|n| n > 1 << 20)
        );
    }
    let page = read(folder, "index.html");
    assert!(page.ends_with("</html>\n") && page.matches("data:image/png;base64,").count() == pictures.len());
    assert_eq!(page.matches("<svg").count(), page.matches("</svg>").count());
    // Embedded pictures are removed before the checks below.
    let words: String = page
        .split("data:image/png;base64,")
        .enumerate()
        .map(|(n, p)| if n == 0 { p } else { p.split_once('"').unwrap().1 })
        .collect();
    for beyond in [
        "http:", "https:", "//www", "src=\"/", "url(", "@import", "<link", "<iframe", "NaN",
    ] {
        assert!(!words.contains(beyond), "the page holds {beyond}");
    }
    report
}

/// A sweep: every file exists, every run has its error and time, and a finer step has a smaller
/// error.
pub fn a_sweep_is_whole_and_converges() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let sweep = [
        "phantom:head-ct:size=40",
        "-o",
        "made/here",
        "--steps",
        "0.5,1,2",
        "--filter",
        "linear",
        "--size",
        "48x40",
        "--backend",
        "cpu",
        "--reference",
        "0.125",
    ];
    let output = compare(
        f,
        &[&sweep[..], &["--deform", "peel", "--repeat", "2", "--json"]].concat(),
    );
    assert!(
        output.status.success() && output.stderr.is_empty(),
        "{}",
        stderr(&output)
    );
    let f = f.join("made/here");
    let report = whole(&f);
    assert_eq!(serde_json::from_slice::<Value>(&output.stdout).unwrap(), report);
    let runs = report["runs"].as_array().unwrap();
    let names: Vec<&str> = runs.iter().map(|r| r["name"].as_str().unwrap()).collect();
    let modes = ["slice", "raycast"].map(|m| ["0.5", "1", "2"].map(|s| format!("{m} cpu step {s}")));
    assert_eq!(names, modes.concat());
    assert_eq!(report["references"].as_array().unwrap().len(), 1);
    for curve in runs.chunks(3) {
        let of = |key: &str| -> Vec<f64> {
            curve
                .iter()
                .map(|r| {
                    r["error"][key]
                        .as_f64()
                        .unwrap_or_else(|| panic!("{key} of {r:#}"))
                })
                .collect()
        };
        assert!(
            of("rms").is_sorted() && of("mean").is_sorted() && of("rms")[0] > 0.0,
            "{curve:#?}"
        );
        assert!(
            of("psnr_db").iter().rev().is_sorted()
                && of("ssim").iter().rev().is_sorted()
                && of("ssim")[0] < 1.0,
            "{curve:#?}"
        );
        assert!(curve.iter().all(|r| r["repetitions"] == 2
            && r["reference"] == "raycast reference"
            && r["warm_up_milliseconds"].is_null()));
    }
    // Two renderers at three steps, and six runs with the reference.
    assert_eq!(report["pairs"].as_array().unwrap().len(), 3 + 6);
    let equal = report["equal_error"].as_array().unwrap();
    assert_eq!(equal.len(), 1, "{equal:#?}");
    let finest = [0, 3].map(|n| runs[n]["error"]["rms"].as_f64().unwrap());
    assert!((equal[0]["rms"].as_f64().unwrap() - finest[0].max(finest[1])).abs() < 1e-9);
    for renderer in equal[0]["renderers"].as_array().unwrap() {
        let step = renderer["step_voxels"].as_f64().unwrap();
        assert!(
            (0.5 - 1e-9..=2.0).contains(&step) && renderer["rendering_milliseconds"].as_f64().unwrap() > 0.0,
            "{renderer:#}"
        );
    }
    // Gradients of 40^3 voxels, cached for all runs; the first preparation is reported separately.
    assert!(
        runs.iter()
            .all(|r| r["memory"]["gradient_bytes"].as_u64() == Some(40 * 40 * 40 * 8))
    );
    let first = report["protocol"]["first_preparation"].as_array().unwrap();
    assert!(
        first
            .iter()
            .any(|s| s["name"] == "maps" && s["milliseconds"].as_f64().unwrap() > 0.0),
        "{first:?}"
    );
    let page = read(&f, "index.html");
    assert!(page.contains("Preparing the scene for the first time took"));
    for plot in [
        "Time by step",
        "Error by step",
        "Time against error",
        "Time by stage",
    ] {
        assert!(
            page.contains(&format!("aria-label=\"{plot}")),
            "no plot \"{plot}\""
        );
    }
    assert!(
        page.matches("<svg").count() == 4
            && page.contains("Speed at equal error")
            && page.contains("median of 2")
    );
}

/// Several sizes and cameras, and surfaces in addition to volumes: only runs of the same content
/// are compared.
pub fn only_like_is_compared_with_like() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let scene = "incise = 1\n[volume]\npath = \"phantom:ball:size=24\"\n[[mesh]]\nshape = [{ kind = \"sphere\", radius = 40.0 }]\n";
    std::fs::write(f.join("scene.toml"), scene).unwrap();
    let output = compare(
        f,
        &[
            "scene.toml",
            "-o",
            "lab",
            "--backend",
            "cpu",
            "--sizes",
            "24x20,32x24",
            "--cameras",
            "left;-40,20",
            "--repeat",
            "1",
            "--reference",
            "0.5",
        ],
    );
    assert!(output.status.success(), "{}", stderr(&output));
    let f = f.join("lab");
    let report = whole(&f);
    let runs = report["runs"].as_array().unwrap();
    assert_eq!(
        (runs.len(), report["references"].as_array().unwrap().len()),
        (3 * 4, 2 * 4)
    );
    let name = "surface cpu 24x20 -40,20";
    let surface = runs
        .iter()
        .find(|r| r["name"] == name)
        .unwrap_or_else(|| panic!("no {name} in {runs:#?}"));
    assert_eq!(
        (&surface["camera"], &surface["reference"]),
        (&"-40,20".into(), &"surface reference 24x20 -40,20".into())
    );
    // In each of four views: slice with raycast, and three runs with their references.
    let pairs = report["pairs"].as_array().unwrap();
    assert_eq!(pairs.len(), 4 * 4);
    let tail = |name: &Value| {
        name.as_str()
            .unwrap()
            .split_once(' ')
            .unwrap()
            .1
            .replace("reference ", "")
            .replace("cpu ", "")
    };
    assert!(pairs.iter().all(|p| tail(&p["a"]) == tail(&p["b"])), "{pairs:#?}");
    assert!(report["equal_error"].as_array().unwrap().is_empty() && report["size"].is_null());
    let page = read(&f, "index.html");
    assert!(page.contains("errors at two or more steps are needed") && page.contains("--steps 0.5,1,2"));
    // Once more without references, with the mode set by its own option.
    let output = compare(
        folder.path(),
        &[
            "scene.toml",
            "-o",
            "lab",
            "--backend",
            "cpu",
            "--mode",
            "surface",
            "--size",
            "16x16",
            "--no-reference",
        ],
    );
    assert!(output.status.success(), "{}", stderr(&output));
    let report = whole(&f);
    assert!(
        report["runs"][0]["error"].is_null()
            && report["references"].as_array().unwrap().is_empty()
            && report["runs"][0]["name"] == "surface cpu"
    );
}

/// Each of these fails with one message that names the cause, and leaves no files.
pub fn what_cannot_be_compared_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    std::fs::write(f.join("file"), "precious").unwrap();
    std::fs::write(
        f.join("tet.obj"),
        "v 0 0 0\nv 60 0 0\nv 0 60 0\nv 0 0 60\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n",
    )
    .unwrap();
    std::fs::create_dir(f.join("slices")).unwrap();
    std::fs::create_dir_all(f.join("taken/runs.csv")).unwrap();
    for n in 0..3 {
        image::GrayImage::from_pixel(4, 4, image::Luma([n * 40]))
            .save(f.join(format!("slices/{n}.png")))
            .unwrap();
    }
    std::fs::create_dir(f.join("protected")).unwrap();
    std::fs::write(f.join("protected/runs.csv"), "precious").unwrap();
    let mut permissions = std::fs::metadata(f.join("protected/runs.csv"))
        .unwrap()
        .permissions();
    permissions.set_readonly(true);
    std::fs::set_permissions(f.join("protected/runs.csv"), permissions).unwrap();
    let cases: &[(i32, &[&str], &str)] = &[
        (2, &["--steps", "fine"], "--steps"),
        (2, &["--steps", "1", "--step", "2"], "--step"),
        (2, &["--sizes", "wide"], "--sizes"),
        (2, &["--cameras", "above"], "--cameras"),
        (2, &["--cameras", "40"], "--cameras"),
        (2, &["--modes", "rays"], "--modes"),
        (2, &["--repeat", "often"], "--repeat"),
        (2, &["--backend", "tpu"], "--backend"),
        (2, &["--reference", "0.1", "--no-reference"], "--no-reference"),
        (1, &["--steps", "0"], "--steps"),
        (1, &["--steps", "1,nan"], "--steps"),
        (1, &["--sizes", "0x4"], "--sizes"),
        (1, &["--sizes", "16000x16000"], "--sizes"),
        (1, &["--repeat", "0"], "--repeat"),
        (1, &["--reference", "0.9"], "--reference"),
        (1, &["--steps", "0.05"], "--reference"),
        (1, &["--threads", "0"], "--threads"),
        (1, &["--deform", "peal"], "peel"),
        (1, &["--antialias", "9"], "antialias"),
        (1, &["--antialias", "adaptive"], "from 1 to 4"),
        (1, &["--antialias", "4", "--sizes", "8000x4000"], "--antialias"),
        (1, &["--stats", "no/such/s.json"], "no/such/s.json"),
        (1, &["--stats", "lab/index.html"], "lab/index.html"),
    ];
    let before = || -> usize { walkdir(f) };
    let files = before();
    let common = ["--size", "16x16", "--backend", "cpu"];
    for (code, arguments, culprit) in cases {
        let own = |option: &str| arguments.iter().any(|a| a.trim_end_matches('s') == option);
        let common: Vec<&str> = common
            .chunks(2)
            .filter(|c| !own(c[0]))
            .flatten()
            .copied()
            .collect();
        let output = compare(
            f,
            &[&["phantom:ball:size=12", "-o", "lab"], *arguments, &common].concat(),
        );
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(*code), "{arguments:?}: {message}");
        assert!(
            message.contains(culprit) && !message.contains("panicked"),
            "{arguments:?}: {message}"
        );
        assert!(
            *code == 2 || message.trim().lines().count() == 1,
            "{arguments:?}: {message}"
        );
        assert_eq!(before(), files, "{arguments:?} left something");
    }
    for (arguments, culprit) in [
        (&["nowhere.nii", "-o", "lab"][..], "nowhere.nii"),
        (&["phantom:ball:size=12", "-o", "file"], "file"),
        (&["phantom:ball:size=12", "-o", "file/lab"], "file"),
        (&["tet.obj", "-o", "lab", "--modes", "raycast"], "--modes raycast"),
        (&["slices", "-o", "slices"], "slices"),
        (&["phantom:ball:size=12", "-o", "taken"], "runs.csv"),
        (&["phantom:ball:size=12", "-o", "protected"], "runs.csv"),
    ] {
        let output = compare(f, &[arguments, &common].concat());
        assert_eq!(
            output.status.code(),
            Some(1),
            "{arguments:?}: {}",
            stderr(&output)
        );
        assert!(
            stderr(&output).contains(culprit) && stderr(&output).trim().lines().count() == 1,
            "{arguments:?}: {}",
            stderr(&output)
        );
        assert_eq!(before(), files, "{arguments:?} left something");
    }
    // A gallery is not written into the folder of slices that it shows.
    let gallery = [
        "gallery",
        "--volume",
        "slices",
        "-o",
        "slices",
        "--kind",
        "half-space",
        "--edge",
        "16",
        "-q",
    ];
    let output = Command::new(env!("CARGO_BIN_EXE_incise"))
        .current_dir(f)
        .args(gallery)
        .output()
        .unwrap();
    assert!(
        output.status.code() == Some(1) && stderr(&output).contains("input folder"),
        "{}",
        stderr(&output)
    );
    assert_eq!(before(), files);
    assert_eq!(std::fs::read(f.join("file")).unwrap(), b"precious");
    // An empty picture is explained here as well.
    let output = compare(
        f,
        &[
            &[
                "phantom:ball:size=12",
                "-o",
                "lab",
                "--no-reference",
                "--deform",
                "box:center=0,0,0,size=900",
            ][..],
            &common,
        ]
        .concat(),
    );
    assert!(
        output.status.success() && stderr(&output).contains("everything is cut away"),
        "{}",
        stderr(&output)
    );
    assert_eq!(
        compare(f, &["phantom:ball"]).status.code(),
        Some(2),
        "no --output"
    );
    let help = compare(f, &["--help"]);
    let text = String::from_utf8_lossy(&help.stdout).into_owned();
    assert!(
        help.status.success()
            && [
                "--steps",
                "--sizes",
                "--cameras",
                "--reference",
                "--repeat",
                "1/16"
            ]
            .iter()
            .all(|w| text.contains(w))
    );
}

/// Number of files and folders below a folder.
fn walkdir(folder: &Path) -> usize {
    std::fs::read_dir(folder)
        .unwrap()
        .flatten()
        .map(|e| 1 + if e.path().is_dir() { walkdir(&e.path()) } else { 0 })
        .sum()
}

/// Without a driver only the CPU is compared, with a notice; if the GPU is required, it is an
/// error.
pub fn a_missing_gpu_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let run = |backend: &str| {
        Command::new(env!("CARGO_BIN_EXE_incise"))
            .current_dir(folder.path())
            .args([
                "compare",
                "phantom:ball:size=12",
                "-o",
                "lab",
                "--size",
                "16x16",
                "--repeat",
                "1",
                "--reference",
                "0.5",
                "--backend",
                backend,
            ])
            .env_clear()
            .env("HOME", "/nonexistent")
            .env("VK_DRIVER_FILES", "/nonexistent")
            .env("VK_ICD_FILENAMES", "/nonexistent")
            .env("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent")
            .env("LIBGL_DRIVERS_PATH", "/nonexistent")
            .output()
            .unwrap()
    };
    let gpu_messages = |output: &Output| {
        stderr(output)
            .lines()
            .filter(|l| l.starts_with("incise: GPU"))
            .count()
    };
    let output = run("gpu");
    assert_eq!(
        (output.status.code(), gpu_messages(&output)),
        (Some(1), 1),
        "{}",
        stderr(&output)
    );
    assert!(!folder.path().join("lab").exists());
    let output = run("auto");
    assert!(
        output.status.success() && gpu_messages(&output) == 1,
        "{}",
        stderr(&output)
    );
    let report = whole(&folder.path().join("lab"));
    assert!(
        report["protocol"]["gpu"].is_null()
            && report["runs"]
                .as_array()
                .unwrap()
                .iter()
                .all(|r| r["backend"] == "cpu")
    );
}

/// Tests that need an adapter: reported as ignored if there is none.
#[cfg(feature = "gpu")]
pub fn on_a_gpu() -> Vec<libtest_mimic::Trial> {
    let missing = incise::gpu::Device::open(incise::gpu::AdapterPreference::Any).is_err();
    let test = crate::trial("comparison::a_gpu_is_compared_with_the_cpu", || {
        a_gpu_is_compared_with_the_cpu();
        Ok(())
    });
    vec![test.with_ignored_flag(missing)]
}

/// With an adapter both backends are compared: pictures equal within a few levels, samples counted,
/// the device named.
#[cfg(feature = "gpu")]
fn a_gpu_is_compared_with_the_cpu() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = [
        "phantom:tomato:size=32",
        "-o",
        "lab",
        "--size",
        "48x48",
        "--repeat",
        "2",
        "--reference",
        "0.25",
        "--deform",
        "twist",
    ];
    let output = compare(folder.path(), &arguments);
    assert!(output.status.success(), "{}", stderr(&output));
    let report = whole(&folder.path().join("lab"));
    let runs = report["runs"].as_array().unwrap();
    let names: Vec<&str> = runs.iter().map(|r| r["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["slice cpu", "slice gpu", "raycast cpu", "raycast gpu"]);
    assert!(report["protocol"]["gpu"].as_str().is_some_and(|n| !n.is_empty()));
    assert!(
        runs.iter()
            .all(|r| (r["backend"] == "gpu") == r["warm_up_milliseconds"].is_f64()),
        "{runs:#?}"
    );
    // Storage differs by device: software adapters store 8-bit voxels as 16 bits.
    let bytes = |n: usize| runs[n]["memory"]["volume_bytes"].as_u64().unwrap();
    assert!(
        bytes(1) >= bytes(0) && bytes(1) <= 2 * bytes(0),
        "{} {}",
        bytes(0),
        bytes(1)
    );
    // If the device has timestamps, most of the drawing time falls between them.
    let device = incise::gpu::Device::open(incise::gpu::AdapterPreference::Any).unwrap();
    let has_clock = device.device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
    for run in runs.iter().filter(|r| r["backend"] == "gpu") {
        let stages = run["stages"].as_array().unwrap();
        let of = |name: &str| {
            stages
                .iter()
                .find(|s| s["name"] == name)
                .map(|s| s["milliseconds"].as_f64().unwrap())
        };
        assert_eq!(
            of("draw (GPU time)").is_some_and(|ms| ms > 0.0),
            has_clock,
            "{run:#}"
        );
        assert!(
            !(has_clock && device.is_software()) || of("draw (GPU time)") > of("draw"),
            "{run:#}"
        );
    }
    // Six pairs of renderers, and four with the reference.
    let pairs = report["pairs"].as_array().unwrap();
    assert_eq!(pairs.len(), 6 + 4);
    let rays = pairs
        .iter()
        .find(|p| p["a"] == "raycast cpu" && p["b"] == "raycast gpu")
        .unwrap();
    assert!(rays["mean"].as_f64().unwrap() < 0.5, "{rays:#}");
}
