//! End-to-end tests of the program: exit codes, messages, files.

use crate::nifti::{File, small};
use std::path::Path;
use std::process::{Command, Output};

fn incise(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_incise")).current_dir(folder).args(arguments).env_remove("DISPLAY").output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

const CPU: [&str; 4] = ["--backend", "cpu", "--size", "48x40"];

fn render(folder: &Path, arguments: &[&str]) -> Output {
    incise(folder, &[&["render"], arguments, &["-o", "out.png"], &CPU[..2]].concat())
}

/// Each of these fails with code 1 or 2 and one line that names the cause, without a picture or a
/// panic.
pub fn bad_input_is_named_and_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let scene = |name: &str, text: &str| std::fs::write(f.join(name), text).unwrap();
    small().write(f, "good.nii");
    let whole = {
        let mut file = File::new([24, 24, 24], 4, 16, false);
        file.voxels((0..24 * 24 * 24u32).map(|v| ((v * 7919) as i16).to_be_bytes()));
        std::fs::read(file.write(f, "cut.nii.gz")).unwrap()
    };
    std::fs::write(f.join("cut.nii.gz"), &whole[..whole.len() / 2]).unwrap();
    let mut overflow = small();
    for n in 0..3 {
        overflow.i16(42 + 2 * n, 32767);
    }
    overflow.write(f, "overflow.nii");
    scene("empty.toml", "");
    scene("key.toml", "incise = 1\n[volume]\npath = \"good.nii\"\n[camera]\nzom = 1.0\n");
    scene("syntax.toml", "incise = = 1");
    scene("range.toml", "incise = 1\n[volume]\npath = \"good.nii\"\n[[deformation]]\nkind = \"twist\"\nangle = 99999.0\n");
    scene("matrix.toml", "incise = 1\n[volume]\npath = \"good.nii\"\n[[deformation]]\nkind = \"twist\"\nmatrix = [[1,0,0,0],[1,0,0,0],[0,0,1,0]]\n");
    scene("missing.toml", "incise = 1\n[volume]\npath = \"nowhere.nii\"\n");
    std::fs::write(f.join("text.nii"), "this is no scan").unwrap();
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
        assert!(matches!(output.status.code(), Some(1 | 2)), "{arguments:?}: {:?} {message}", output.status);
        assert!(message.contains(culprit), "{arguments:?}: {message}");
        assert!(!message.contains("panicked"), "{arguments:?}: {message}");
        assert_eq!(std::fs::read_dir(f).unwrap().count(), before, "{arguments:?} left a file");
    }
    for (place, culprit) in
        [("no/such/folder/out.png", "the folder no/such/folder does not exist"), (".", "."), ("out.jpg", "png"), ("/proc/out.png", "/proc/out.png")]
    {
        let output = incise(f, &["render", "good.nii", "-o", place, "--backend", "cpu"]);
        assert_eq!(output.status.code(), Some(1), "{place}");
        assert!(stderr(&output).contains(culprit) && stderr(&output).trim().lines().count() == 1, "{place}: {}", stderr(&output));
    }
    // NaN and infinite voxels are rendered as holes, and their number is reported.
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
    file.write(f, "nan.nii");
    assert!(render(f, &["nan.nii"]).status.success());
    let mut file = File::new([4, 4, 4], 16, 32, false);
    file.voxels((0..64).map(|_| f32::NAN.to_be_bytes()));
    file.write(f, "all-nan.nii");
    assert!(render(f, &["all-nan.nii"]).status.success());
    let info = incise(f, &["info", "--json", "all-nan.nii"]);
    assert!(String::from_utf8_lossy(&info.stdout).contains("\"non_finite\": 64"));
}

/// Invalid deformations are reported by name, without a panic or a file. Valid but unusual ones are
/// rendered with a notice.
pub fn bad_deformations_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/itk");
    for name in ["volume.nii.gz", "field.nrrd", "affine.tfm", "composite.tfm"] {
        std::fs::copy(fixtures.join(name), f.join(name)).unwrap();
    }
    // A field of NaN, one of infinite vectors, and a folded one: x mirrored everywhere.
    let field = |name: &str, vector: &dyn Fn(usize) -> [f32; 3]| {
        let mut text = String::from(
            "NRRD0004\ntype: float\ndimension: 4\nspace: left-posterior-superior\nsizes: 3 9 9 9\nspace directions: none (10,0,0) (0,10,0) (0,0,10)\nkinds: vector domain domain domain\nendian: little\nencoding: ascii\nspace origin: (-40,-40,-40)\n\n",
        );
        for n in 0..729 {
            let [x, y, z] = vector(n);
            text.push_str(&format!("{x} {y} {z}\n"));
        }
        std::fs::write(f.join(name), text).unwrap();
    };
    field("nan.nrrd", &|n| if n == 100 { [f32::NAN, 0.0, 0.0] } else { [1.0, 0.0, 0.0] });
    field("folded.nrrd", &|n| [-2.0 * ((n % 9) as f32 * 10.0 - 40.0), 0.0, 0.0]);
    std::fs::write(f.join("short.nrrd"), &std::fs::read(f.join("folded.nrrd")).unwrap()[..400]).unwrap();
    std::fs::write(f.join("huge.nrrd"), "NRRD0004\ntype: float\ndimension: 3\nsizes: 90000 90000 90000\nendian: little\nencoding: raw\n\nx").unwrap();
    std::fs::write(f.join("words.txt"), "this is no transform").unwrap();
    std::fs::write(
        f.join("other.tfm"),
        "#Insight Transform File V1.0\nTransform: ThinPlateSplineKernelTransform_double_3_3\nParameters: 1\nFixedParameters: 1\n",
    )
    .unwrap();
    std::fs::write(
        f.join("flat.tfm"),
        "#Insight Transform File V1.0\nTransform: AffineTransform_double_3_3\nParameters: 1 2\nFixedParameters: 0 0 0\n",
    )
    .unwrap();
    let itk = |name: &str, kind: &str, parameters: usize, fixed: &str| {
        let text = format!(
            "#Insight Transform File V1.0\nTransform: {kind}_double_3_3\nParameters: {}\nFixedParameters: {fixed}\n",
            "0 ".repeat(parameters)
        );
        std::fs::write(f.join(name), text).unwrap();
    };
    itk("zero.tfm", "AffineTransform", 12, "0 0 0");
    itk("coarse.tfm", "BSplineTransform", 81, "3 3 3 0 0 0 9 9 9 1 0 0 0 1 0 0 0 1");
    std::fs::write(f.join("singular.1D"), "1 0 0 0 1 0 0 0 0 0 1 0").unwrap();
    std::fs::write(f.join("bad.csv"), "1,2,3,4,5\n").unwrap();
    std::fs::write(f.join("bad.mrk.json"), "{\"markups\": 3}").unwrap();
    let cases: &[(&str, &str)] = &[
        ("field:path=volume.nii.gz", "1 values per voxel"),
        ("field:path=nan.nrrd", "1 vectors that are NaN"),
        ("field:path=short.nrrd", "short.nrrd"),
        ("field:path=huge.nrrd", "huge.nrrd"),
        ("field:path=words.txt", "words.txt"),
        ("field:path=other.tfm", "ThinPlateSpline"),
        ("field:path=flat.tfm", "2 parameters"),
        ("field:path=singular.1D", "singular"),
        ("field:path=zero.tfm", "singular"),
        ("field:path=coarse.tfm", "4 along each axis"),
        ("field:path=nowhere.nii.gz", "nowhere.nii.gz"),
        ("field", "path"),
        ("field:pth=affine.tfm", "path"),
        ("field:path=affine.tfm,center=1,2,3", "center"),
        ("map:path=field.nrrd", "field:path"),
        ("map:path=words.txt", "words.txt"),
        ("points", "pairs"),
        ("points:pairs=1,2,3,4", "six"),
        ("points:pairs=bad.csv", "line 1"),
        ("points:pairs=0,0,0,5,5,5,9,9,9,5,5,5", "pair 2"),
        ("points:from=bad.mrk.json,to=bad.mrk.json", "markups"),
        ("points:pairs=0,0,0,5,5,5,method=spline", "tps"),
        ("lattice:lattice=1,1,1,offsets=0,0,0,1,1,1", "lattice"),
        ("lattice:lattice=4,4,offsets=0,0,0,1,1,1", "three"),
        ("lattice:offsets=9,0,0,1,1,1", "no control point"),
        ("lattice:basis=nurbs,offsets=0,0,0,1,1,1", "b-spline"),
        ("lasso:points=0,0,10,10", "2 points"),
        ("lasso:points=0,0,30,30,30,0,0,30", "crosses itself"),
        ("lasso:points=0,0,30", "two"),
        ("explode-labels:label=77,labels=phantom:octants:size=16", "1, 2, 3"),
        ("explode-labels", "label"),
        ("strip:label=999,labels=phantom:octants:size=16", "999"),
        ("strip:iso=1e9", "no surface"),
        ("strip:iso=5,label=3", "only one of them"),
        ("strip:label=1.5", "1.5"),
        ("sphere:spare=12,labels=phantom:octants:size=16", "12"),
        ("sphere:mapping=polar", "cylindrical"),
        ("elastic", "grab"),
        ("elastic:grab=1,2,3", "7"),
        ("elastic:grab=500,0,0,1,1,0,0", "no lattice node"),
        ("elastic:grab=0,0,0,5,1,0,0,incision=0,0,0,0,0,0,5", "normal"),
        ("brush:strokes=cut 5 1 0 0 0,psuh 5 1 0 0 0 9 9 9", "stroke 2: \"psuh\" is not a tool; did you mean \"push\"?"),
        ("brush:strokes=push 5 1 0 0 0", "needs at least 2"),
        ("peel:depth=deep", "deep"),
        ("wave:spare=words", "numbers"),
    ];
    let before = std::fs::read_dir(f).unwrap().count();
    for (deformation, culprit) in cases {
        let output = render(f, &["volume.nii.gz", "--deform", deformation]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{deformation}: {message}");
        assert!(message.contains(culprit) && !message.contains("panicked"), "{deformation}: {message}");
        assert_eq!(std::fs::read_dir(f).unwrap().count(), before, "{deformation} left a file");
    }
    // Cuts in groups must come last.
    let output = render(f, &["volume.nii.gz", "--deform", "sphere:group=a", "--deform", "twist"]);
    assert!(stderr(&output).contains("to the end") && output.status.code() == Some(1));
    // Too few points, and a field that folds everywhere: rendered, with a notice.
    let odd: &[(&str, &str)] =
        &[("points:pairs=0,0,20,5,5,25,-10,0,0,-10,2,0", "2 points are too few"), ("field:path=folded.nrrd,invert=true", "have no source")];
    for (deformation, expected) in odd {
        let output = render(f, &["volume.nii.gz", "--deform", deformation]);
        assert!(output.status.success() && stderr(&output).contains(expected), "{deformation}: {}", stderr(&output));
    }
    let check = incise(f, &["map", "check", "folded.nrrd", "--json", "--picture", "folds.png", "--csv", "folds.csv"]);
    let report: serde_json::Value = serde_json::from_slice(&check.stdout).unwrap();
    assert_eq!(report["health"]["folds_percent"], 100.0);
    assert!(std::fs::read(f.join("folds.png")).unwrap().starts_with(b"\x89PNG"));
    assert_eq!(std::fs::read_to_string(f.join("folds.csv")).unwrap().lines().count(), 730);
    for (arguments, culprit) in [
        (&["bake", "volume.nii.gz", "-o", "out.tiff"][..], ".nrrd"),
        (&["bake", "volume.nii.gz", "-o", "volume.nii.gz"], "input"),
        (&["bake", "volume.nii.gz", "-o", "out.nii", "--fill", "nan"], "fill"),
        (&["map", "peal", "-o", "out.nrrd"], "peel"),
        (&["map", "field.nrrd", "-o", "field.nrrd"], "input"),
        (&["map", "check", "words.txt"], "words.txt"),
        (&["map", "peel", "--volume", "volume.nii.gz", "-o", "volume.nii.gz"], "input"),
        (&["map", "check", "field.nrrd", "--csv", "field.nrrd"], "input"),
        (&["bake", "volume.nii.gz", "--deform", "field:path=field.nrrd", "-o", "field.nrrd"], "input"),
        (&["map", "check", "volume.nii.gz"], "1 values"),
        (&["gallery", "-o", "gallery", "--kind", "peal"], "peel"),
    ] {
        let output = incise(f, arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(stderr(&output).contains(culprit), "{arguments:?}: {}", stderr(&output));
    }
}

/// A map is made, used, converted, inverted and checked on the command line; a bake preserves type
/// and geometry.
pub fn maps_and_bakes_by_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let run = |arguments: &[&str]| {
        let output = incise(f, arguments);
        assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
        output
    };
    let volume = "phantom:tomato:size=40";
    run(&["map", "twist:angle=50,resolution=24", "--volume", volume, "-o", "twist.nrrd"]);
    let picture = |deform: &[&str], out: &str| {
        run(&[&["render", volume, "-o", out, "--size", "64x64", "--backend", "cpu", "-q"], deform].concat());
        std::fs::read(f.join(out)).unwrap()
    };
    let plain = picture(&[], "plain.png");
    let kind = picture(&["--deform", "twist:angle=50,resolution=24"], "kind.png");
    let map = picture(&["--deform", "map:path=twist.nrrd"], "map.png");
    assert!(plain != kind);
    // The file holds the displacement in mm, which is rounded to f16 on loading: a few pixels
    // differ by a small step.
    let decoded = |bytes: &[u8]| image::load_from_memory(bytes).unwrap().to_rgb8().into_raw();
    let far = decoded(&kind).iter().zip(decoded(&map)).filter(|(a, b)| a.abs_diff(*b) > 2).count();
    assert!(far < 20, "{far}");
    // A field that vanishes on every face, so that nothing tears there.
    run(&["map", "bulge:resolution=32", "--volume", volume, "-o", "bulge.nrrd"]);
    run(&["map", "bulge.nrrd", "-o", "field.nii.gz"]);
    run(&["map", "field.nii.gz", "--invert", "-o", "back.mha"]);
    // A field followed by its inverse is close to zero displacement.
    run(&["bake", volume, "--field", "-o", "none.mha", "--deform", "field:path=field.nii.gz", "--deform", "field:path=back.mha"]);
    let health = |file: &str| -> serde_json::Value {
        serde_json::from_slice::<serde_json::Value>(&run(&["map", "check", file, "--json", "--no-inverse"]).stdout).unwrap()["health"].clone()
    };
    let (there, nothing) = (health("field.nii.gz")["largest_mm"].as_f64().unwrap(), health("none.mha")["mean_mm"].as_f64().unwrap());
    assert!(there > 5.0 && nothing < 0.02, "{there} {nothing}");
    run(&["bake", volume, "-o", "baked.nii.gz", "--deform", "slab", "--enlarge", "-q"]);
    let info: serde_json::Value = serde_json::from_slice(&run(&["info", "--json", "baked.nii.gz"]).stdout).unwrap();
    assert_eq!((info["type"].as_str(), info["orientation"].as_str()), (Some("u8"), Some("LPS")));
    assert!(info["size"][2].as_u64().unwrap() > 50);
    // A label map keeps its labels.
    run(&["bake", "phantom:octants:size=32", "-o", "labels.nrrd", "--deform", "wave"]);
    let info: serde_json::Value = serde_json::from_slice(&run(&["info", "--json", "labels.nrrd"]).stdout).unwrap();
    assert_eq!(info["labels"], 8);
    run(&["gallery", "-o", "gallery", "--kind", "peel", "--kind", "lift", "--edge", "48", "--volume", "phantom:head-ct:size=48", "-q"]);
    let page = std::fs::read_to_string(f.join("gallery/index.html")).unwrap();
    assert!(page.contains("peel-volume.png") && f.join("gallery/peel-checker.png").exists());
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
        .args(["render", "phantom:ball:size=32", "-o", "ball.png", "--size", "32x32"])
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
    assert!(cfg!(not(feature = "gpu")) || (notices.len() == 1 && notices[0].contains("CPU")), "{message}");
    assert!(std::fs::read(folder.path().join("ball.png")).unwrap().starts_with(b"\x89PNG"));
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
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(f.join("s.json")).unwrap()).unwrap();
    for pointer in ["/samples/taken", "/samples/skipped", "/milliseconds/load", "/milliseconds/render", "/total_milliseconds"] {
        assert!(report.pointer(pointer).and_then(serde_json::Value::as_f64).is_some_and(|v| v > 0.0), "{pointer} in {report:#}");
    }
    assert_eq!(report["backend"], "cpu");
    assert_eq!(report["size"], serde_json::json!([64, 48]));
    assert!(!cfg!(target_os = "linux") || report["peak_memory_bytes"].as_u64().is_some_and(|b| b > 1 << 20));
}

pub fn an_existing_file_is_replaced_whole() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    std::fs::write(f.join("out.png"), "precious").unwrap();
    assert!(!render(f, &["nowhere.nii"]).status.success());
    assert_eq!(std::fs::read(f.join("out.png")).unwrap(), b"precious");
    assert!(render(f, &["phantom:ball:size=16", "--size", "16x16"]).status.success());
    assert!(std::fs::read(f.join("out.png")).unwrap().starts_with(b"\x89PNG"));
    assert_eq!(std::fs::read_dir(f).unwrap().count(), 1);
}

pub fn info_tells_what_is_needed() {
    let folder = tempfile::tempdir().unwrap();
    small().write(folder.path(), "a.nii");
    let o = incise(folder.path(), &["info", "--json", "a.nii"]);
    let report: serde_json::Value = serde_json::from_slice(&o.stdout).unwrap();
    for key in ["kind", "size", "type", "range", "spacing_mm", "origin_mm", "direction", "orientation", "components", "warnings"] {
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
    for arguments in [&["rendr"][..], &["render"], &["render", "x.nii"], &["render", "x.nii", "-o", "a.png", "--nonsense"]] {
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
    assert!(stderr_text.lines().count() == 1 && stderr_text.contains("no window") && stderr_text.contains("incise render"), "{stderr_text}");
}

/// Meshes, their distance fields and surfaces on the command line: written files can be read back,
/// errors name the cause.
pub fn meshes_and_fields_by_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let write = |name: &str, text: &str| std::fs::write(f.join(name), text).unwrap();
    // A tetrahedron with legs of 60 mm, and the same with a missing face.
    let points = "v 0 0 0\nv 60 0 0\nv 0 60 0\nv 0 0 60\n";
    write("tet.obj", &format!("{points}f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"));
    write("open.obj", &format!("{points}f 1 3 2\nf 1 2 4\nf 1 4 3\n"));
    write("wrong.obj", &format!("{points}f 1 2 9\n"));
    let output = incise(f, &["info", "tet.obj", "--json"]);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        (&report["kind"], &report["triangles"], &report["watertight"], &report["components"]),
        (&"mesh".into(), &4.into(), &true.into(), &1.into())
    );
    assert_eq!(report["bounds_mm"], serde_json::json!([[0.0, 0.0, 0.0], [60.0, 60.0, 60.0]]));
    for name in ["tet.nii.gz", "tet.nrrd", "tet.mha"] {
        let output = incise(f, &["sdf", "tet.obj", "-o", name, "--resolution", "32", "--json"]);
        assert!(output.status.success(), "{}", stderr(&output));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!((&report["open_edges"], &report["turned_triangles"]), (&0.into(), &0.into()));
        // The centre of the inscribed ball lies at depth r = 60 / (3 + √3); the field is positive
        // there and greatest.
        let volume = incise::volume::load::volume(&f.join(name), &incise::volume::load::ReadOptions::default(), &incise::Watch::NONE).unwrap();
        let r = 60.0 / (3.0 + 3.0f64.sqrt());
        assert!(volume.range[1] <= r + 0.01 && volume.range[1] > r - 1.5, "{name}: {:?} for {r}", volume.range);
    }
    let part = incise(f, &["sdf", "tet.obj", "-o", "part.nrrd", "--box=-5,-5,-5,20,20,20", "--cell", "1", "--exact"]);
    assert!(part.status.success(), "{}", stderr(&part));
    let volume = incise::volume::load::volume(&f.join("part.nrrd"), &incise::volume::load::ReadOptions::default(), &incise::Watch::NONE).unwrap();
    assert!(volume.size.iter().all(|n| (23..=27).contains(n)), "{:?}", volume.size);
    let open = incise(f, &["sdf", "open.obj", "-o", "open.nrrd", "--resolution", "32"]);
    assert!(open.status.success() && stderr(&open).contains("3 open edges"), "{}", stderr(&open));
    for name in ["tet.obj", "open.obj"] {
        let output = render(f, &[name]);
        assert!(output.status.success() && f.join("out.png").is_file(), "{}", stderr(&output));
        std::fs::remove_file(f.join("out.png")).unwrap();
    }
    for (arguments, culprit) in [
        (&["sdf", "wrong.obj", "-o", "x.nrrd"][..], "wrong.obj"),
        (&["sdf", "nowhere.obj", "-o", "x.nrrd"], "nowhere.obj"),
        (&["sdf", "tet.txt", "-o", "x.nrrd"], "tet.txt"),
        (&["sdf", "tet.obj", "-o", "x.stl"], "x.stl"),
        (&["sdf", "tet.obj", "-o", "x.nrrd", "--resolution", "0"], "--resolution"),
        (&["sdf", "tet.obj", "-o", "x.nrrd", "--cell", "-1"], "cell"),
        (&["sdf", "tet.obj", "-o", "x.nrrd", "--cell", "0.001"], "too large"),
        (&["sdf", "tet.obj", "-o", "x.nrrd", "--box", "1,2,3"], "--box"),
        (&["sdf", "tet.obj", "-o", "x.nrrd", "--box", "100,100,100,200,200,200"], "tet.obj"),
        (&["bake", "tet.obj", "-o", "x.nrrd"], "no volume"),
    ] {
        let output = incise(f, arguments);
        assert!(matches!(output.status.code(), Some(1 | 2)), "{arguments:?}");
        assert!(stderr(&output).contains(culprit) && !stderr(&output).contains("panicked"), "{arguments:?}: {}", stderr(&output));
        assert!(!f.join("x.nrrd").exists());
    }
    let mesh = "incise = 1\n[[mesh]]\npath = \"tet.obj\"\n";
    for (text, culprit) in [
        ("incise = 1\n", "shows nothing"),
        ("incise = 1\n[[mesh]]\n", "exactly one"),
        (&format!("{mesh}iso = 3.0\n"), "exactly one"),
        (&format!("{mesh}lok = \"skin\"\n"), "look"),
        (&format!("{mesh}look = \"skinn\"\n"), "skin"),
        (&format!("{mesh}thickness = -1.0\n"), "thickness"),
        (&format!("{mesh}color = [2.0, 0.0, 0.0]\n"), "color"),
        (&format!("{mesh}size = 0.0\n"), "size"),
        (&format!("{mesh}resolution = 3\n"), "resolution"),
        (&format!("{mesh}matrix = [[1,0,0,0],[1,0,0,0],[0,0,1,0]]\n"), "singular"),
        (&format!("{mesh}representation = \"depth-map\"\nface = \"up\"\n"), "face"),
        (&format!("{mesh}[[mesh.deformer]]\nkind = \"twits\"\n"), "twist"),
        (&format!("{mesh}[[mesh.deformer]]\nkind = \"twist\"\nangel = 3.0\n"), "angle"),
        (&format!("{mesh}[[mesh.deformer]]\nkind = \"taper\"\nfactor = -1.0\n"), "factor"),
        (&format!("{mesh}[[mesh.deformer]]\nkind = \"lattice\"\npoints = [[9, 0, 0, 1, 1, 1]]\n"), "lattice"),
        (&format!("{mesh}[surface]\nstep = \"sphere\"\n"), "steps"),
        (&format!("{mesh}[surface]\nseam = 0.0\n"), "seam"),
        ("incise = 1\n[[mesh]]\nshape = [{ kind = \"cube\" }]\n", "cube"),
        ("incise = 1\n[[mesh]]\nshape = [{ kind = \"sphere\", radius = -1.0 }]\n", "radius"),
        ("incise = 1\n[[mesh]]\nshape = [{ kind = \"sphere\", join = \"minus\" }]\n", "join"),
        ("incise = 1\n[[mesh]]\niso = 3.0\n", "volume"),
        ("incise = 1\n[volume]\npath = \"phantom:ball\"\n[volume.inside]\npath = \"open.obj\"\n", "not closed"),
        ("incise = 1\n[volume]\npath = \"phantom:ball\"\n[[mesh]]\nlabel = [77]\n", "label"),
    ] {
        write("scene.toml", text);
        let output = render(f, &["scene.toml"]);
        assert!(matches!(output.status.code(), Some(1 | 2)), "{text}");
        let message = stderr(&output);
        assert!(message.contains(culprit) && !message.contains("panicked"), "{text}: {message}");
        assert!(!f.join("out.png").exists(), "{text}");
    }
}
