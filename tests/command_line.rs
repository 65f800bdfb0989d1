//! End-to-end tests of the program: exit codes, messages, files.

use crate::nifti::{File, small};
use std::path::Path;
use std::process::{Command, Output};

mod deformations;
mod meshes;

pub use deformations::*;
pub use meshes::*;

fn incise(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_incise"))
        .current_dir(folder)
        .args(arguments)
        .env_remove("DISPLAY")
        .output()
        .unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

const CPU: [&str; 4] = ["--backend", "cpu", "--size", "48x40"];

fn render(folder: &Path, arguments: &[&str]) -> Output {
    incise(
        folder,
        &[&["render"], arguments, &["-o", "out.png"], &CPU[..2]].concat(),
    )
}

/// Writes damaged or invalid scans and scenes, and `good.nii`.
fn write_bad_input(folder: &Path) {
    let scene = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    small().write(folder, "good.nii");
    let whole = {
        let mut file = File::new([24, 24, 24], 4, 16, false);
        file.voxels((0..24 * 24 * 24u32).map(|v| ((v * 7919) as i16).to_be_bytes()));
        std::fs::read(file.write(folder, "cut.nii.gz")).unwrap()
    };
    std::fs::write(folder.join("cut.nii.gz"), &whole[..whole.len() / 2]).unwrap();
    let mut overflow = small();
    for n in 0..3 {
        overflow.i16(42 + 2 * n, 32767);
    }
    overflow.write(folder, "overflow.nii");
    scene("empty.toml", "");
    scene(
        "key.toml",
        "incise = 1\n[volume]\npath = \"good.nii\"\n[camera]\nzom = 1.0\n",
    );
    scene("syntax.toml", "incise = = 1");
    scene(
        "range.toml",
        "incise = 1\n[volume]\npath = \"good.nii\"\n[[deformation]]\nkind = \"twist\"\nangle = 99999.0\n",
    );
    scene(
        "matrix.toml",
        "incise = 1\n[volume]\npath = \"good.nii\"\n[[deformation]]\nkind = \"twist\"\nmatrix = [[1,0,0,0],[1,0,0,0],[0,0,1,0]]\n",
    );
    scene("missing.toml", "incise = 1\n[volume]\npath = \"nowhere.nii\"\n");
    std::fs::write(folder.join("text.nii"), "this is no scan").unwrap();
}

/// Checks that NaN and infinite voxels are rendered as holes, and that their number is reported.
fn check_holes(folder: &Path) {
    let mut file = File::new([6, 6, 6], 16, 32, false);
    file.voxels(
        (0..216)
            .map(|n| {
                if n % 5 == 0 {
                    f32::NAN
                } else if n % 7 == 0 {
                    f32::INFINITY
                } else {
                    n as f32
                }
            })
            .map(f32::to_be_bytes),
    );
    file.write(folder, "nan.nii");
    assert!(render(folder, &["nan.nii"]).status.success());
    let mut file = File::new([4, 4, 4], 16, 32, false);
    file.voxels((0..64).map(|_| f32::NAN.to_be_bytes()));
    file.write(folder, "all-nan.nii");
    assert!(render(folder, &["all-nan.nii"]).status.success());
    let info = incise(folder, &["info", "--json", "all-nan.nii"]);
    assert!(String::from_utf8_lossy(&info.stdout).contains("\"non_finite\": 64"));
}

/// Each of these fails with code 1 or 2 and one line that names the cause, without a picture or a
/// panic.
pub fn bad_input_is_named_and_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    write_bad_input(f);
    let cases: &[(&[&str], &str)] = &[
        (&["nowhere.nii"], "nowhere.nii"),
        (&["cut.nii.gz"], "cut.nii.gz"),
        (&["overflow.nii"], "overflow.nii"),
        (&["text.nii"], "text.nii"),
        (&["empty.toml"], "empty"),
        (&["key.toml"], "zoom"),
        (&["syntax.toml"], "syntax.toml"),
        (&["range.toml"], "angle"),
        (&["matrix.toml"], "singular"),
        (&["missing.toml"], "nowhere.nii"),
        (&["picture.jpg"], "picture.jpg"),
        (&["phantom:pigy-bank"], "piggy-bank"),
        (&["phantom:ball:size=100000"], "1024"),
        (&["good.nii", "--deform", "peal"], "peel"),
        (&["good.nii", "--deform", "peel:deph=3"], "depth"),
        (&["good.nii", "--deform", "peel:progress=1.5"], "progress"),
        (&["good.nii", "--deform", "twist:angle=1e9"], "angle"),
        (&["good.nii", "--deform", "pull:size=0"], "singular"),
        (&["good.nii", "--deform", "pull:size=1,2"], "size"),
        (&["good.nii", "--deform", "field:path=x.nii"], "x.nii"),
        (&["good.nii", "--size", "0x0"], "0 x 0"),
        (&["good.nii", "--size", "100000x100000"], "100000"),
        (&["good.nii", "--size", "wide"], "wide"),
        (&["good.nii", "--step", "0"], "step"),
        (&["good.nii", "--step", "nan"], "step"),
        (&["good.nii", "--zoom=-1"], "zoom"),
        (&["good.nii", "--camera", "above"], "above"),
        (&["good.nii", "--preset", "ct-bonne"], "ct-bone"),
        (&["good.nii", "--window", "0"], "window"),
        (&["good.nii", "--background", "reddish"], "reddish"),
        (&["good.nii", "--mode", "surface", "--look", "skinn"], "skin"),
        (&["good.nii", "--inside", "nowhere.stl"], "nowhere.stl"),
        (&["good.nii", "--threads", "0"], "threads"),
        (&["mesh.stl"], "mesh.stl"),
        (&["good.nii", "--stats", "good.nii"], "input"),
        (&["good.nii", "--stats", "out.png"], "same file"),
        (&["good.nii", "--deform", "half-space:size=3"], "no size"),
        (&["good.nii", "--deform", "twist:resolution=512"], "resolution"),
    ];
    let before = std::fs::read_dir(f).unwrap().count();
    for (arguments, culprit) in cases {
        let output = render(f, arguments);
        let message = stderr(&output);
        assert!(
            matches!(output.status.code(), Some(1 | 2)),
            "{arguments:?}: {:?} {message}",
            output.status
        );
        assert!(message.contains(culprit), "{arguments:?}: {message}");
        assert!(!message.contains("panicked"), "{arguments:?}: {message}");
        assert_eq!(
            std::fs::read_dir(f).unwrap().count(),
            before,
            "{arguments:?} left a file"
        );
    }
    for (place, culprit) in [
        (
            "no/such/folder/out.png",
            "the folder no/such/folder does not exist",
        ),
        (".", "."),
        ("out.jpg", "png"),
        ("/proc/out.png", "/proc/out.png"),
    ] {
        let output = incise(f, &["render", "good.nii", "-o", place, "--backend", "cpu"]);
        assert_eq!(output.status.code(), Some(1), "{place}");
        assert!(
            stderr(&output).contains(culprit) && stderr(&output).trim().lines().count() == 1,
            "{place}: {}",
            stderr(&output)
        );
    }
    check_holes(f);
}

pub fn same_bytes_for_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let mut pictures = Vec::new();
    for (n, threads) in ["1", "2", "2", "5"].into_iter().enumerate() {
        let out = format!("{n}.png");
        for mode in ["raycast", "slice"] {
            let o = incise(
                f,
                &[
                    "render",
                    "phantom:tomato:size=64",
                    "--deform",
                    "peel",
                    "--deform",
                    "wave",
                    "-o",
                    &out,
                    "--threads",
                    threads,
                    "--backend",
                    "cpu",
                    "--size",
                    "96x96",
                    "--mode",
                    mode,
                ],
            );
            assert!(o.status.success(), "{}", stderr(&o));
            pictures.push((mode, std::fs::read(f.join(&out)).unwrap()));
        }
    }
    assert!(pictures[0].1.len() > 1000);
    for p in &pictures {
        assert_eq!(p.1, pictures[usize::from(p.0 == "slice")].1, "{}", p.0);
    }
}

/// Without a driver, a display, or a writable home folder: a picture and one line.
pub fn cpu_is_used_without_a_driver() {
    let folder = tempfile::tempdir().unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_incise"))
        .current_dir(folder.path())
        .args([
            "render",
            "phantom:ball:size=32",
            "-o",
            "ball.png",
            "--size",
            "32x32",
        ])
        .env_clear()
        .env("HOME", "/nonexistent")
        .env("VK_DRIVER_FILES", "/nonexistent")
        .env("VK_ICD_FILENAMES", "/nonexistent")
        .env("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent")
        .env("LIBGL_DRIVERS_PATH", "/nonexistent")
        .output()
        .unwrap();
    let message = stderr(&output);
    assert!(output.status.success(), "{message}");
    let notices: Vec<&str> = message.lines().filter(|l| l.starts_with("incise")).collect();
    assert!(
        cfg!(not(feature = "gpu")) || (notices.len() == 1 && notices[0].contains("CPU")),
        "{message}"
    );
    assert!(
        std::fs::read(folder.path().join("ball.png"))
            .unwrap()
            .starts_with(b"\x89PNG")
    );
}

pub fn stats_are_complete() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let o = incise(
        f,
        &[
            "render",
            "phantom:tomato:size=48",
            "-o",
            "t.png",
            "--deform",
            "slab",
            "--stats",
            "s.json",
            "--json",
            "--backend",
            "cpu",
            "--size",
            "64x48",
        ],
    );
    assert!(o.status.success(), "{}", stderr(&o));
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(f.join("s.json")).unwrap()).unwrap();
    for pointer in [
        "/samples/taken",
        "/samples/skipped",
        "/milliseconds/load",
        "/milliseconds/render",
        "/total_milliseconds",
    ] {
        assert!(
            report
                .pointer(pointer)
                .and_then(serde_json::Value::as_f64)
                .is_some_and(|v| v > 0.0),
            "{pointer} in {report:#}"
        );
    }
    assert_eq!(report["backend"], "cpu");
    assert_eq!(report["jacobian"], "differences");
    for key in ["filter", "map_filter"] {
        assert!(
            report[key]
                .as_str()
                .is_some_and(|text| text.contains("trilinear")),
            "{report:#}"
        );
    }
    assert_eq!(report["size"], serde_json::json!([64, 48]));
    assert!(!cfg!(target_os = "linux") || report["peak_memory_bytes"].as_u64().is_some_and(|b| b > 1 << 20));
}

pub fn an_existing_file_is_replaced_whole() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    std::fs::write(f.join("out.png"), "precious").unwrap();
    assert!(!render(f, &["nowhere.nii"]).status.success());
    assert_eq!(std::fs::read(f.join("out.png")).unwrap(), b"precious");
    assert!(
        render(f, &["phantom:ball:size=16", "--size", "16x16"])
            .status
            .success()
    );
    assert!(std::fs::read(f.join("out.png")).unwrap().starts_with(b"\x89PNG"));
    assert_eq!(std::fs::read_dir(f).unwrap().count(), 1);
}

pub fn info_tells_what_is_needed() {
    let folder = tempfile::tempdir().unwrap();
    small().write(folder.path(), "a.nii");
    let o = incise(folder.path(), &["info", "--json", "a.nii"]);
    let report: serde_json::Value = serde_json::from_slice(&o.stdout).unwrap();
    for key in [
        "kind",
        "size",
        "type",
        "range",
        "spacing_mm",
        "origin_mm",
        "direction",
        "orientation",
        "components",
        "warnings",
    ] {
        assert!(!report[key].is_null(), "{key}");
    }
    assert_eq!(report["size"], serde_json::json!([2, 3, 4]));
    assert_eq!(report["orientation"], "RAS");
    let schema = incise(folder.path(), &["schema"]);
    let schema: serde_json::Value = serde_json::from_slice(&schema.stdout).unwrap();
    assert!(schema["properties"]["deformation"].is_object());
    let list = incise(folder.path(), &["list"]);
    let text = String::from_utf8_lossy(&list.stdout).into_owned();
    assert!(["ct-bone", "peel", "piggy-bank"].iter().all(|w| text.contains(w)));
}

pub fn usage_errors_exit_with_2() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [
        &["rendr"][..],
        &["render"],
        &["render", "x.nii"],
        &["render", "x.nii", "-o", "a.png", "--nonsense"],
    ] {
        let o = incise(folder.path(), arguments);
        assert_eq!(o.status.code(), Some(2), "{arguments:?}");
    }
    assert!(incise(folder.path(), &["--help"]).status.success());
}

/// Without a display no window opens, and one message reports it.
#[cfg(all(feature = "gui", target_os = "linux"))]
pub fn no_display_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_incise"));
    for name in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"] {
        command.env_remove(name);
    }
    let o = command.env("INCISE_HOME", folder.path()).output().unwrap();
    let stderr_text = String::from_utf8_lossy(&o.stderr).into_owned();
    assert_eq!(o.status.code(), Some(1), "{stderr_text}");
    assert!(
        stderr_text.lines().count() == 1
            && stderr_text.contains("no window")
            && stderr_text.contains("incise render"),
        "{stderr_text}"
    );
}
