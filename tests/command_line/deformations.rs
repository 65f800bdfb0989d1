//! Deformations, maps and bakes on the command line.

use super::{incise, render, stderr};
use std::path::Path;
use std::process::Output;

/// Writes the volume, fields and transforms that the deformations refer to, most of them unusable.
fn write_inputs(folder: &Path) {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/itk");
    for name in ["volume.nii.gz", "field.nrrd", "affine.tfm", "composite.tfm"] {
        std::fs::copy(fixtures.join(name), folder.join(name)).unwrap();
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
        std::fs::write(folder.join(name), text).unwrap();
    };
    field("nan.nrrd", &|n| {
        if n == 100 {
            [f32::NAN, 0.0, 0.0]
        } else {
            [1.0, 0.0, 0.0]
        }
    });
    field("folded.nrrd", &|n| {
        [-2.0 * ((n % 9) as f32 * 10.0 - 40.0), 0.0, 0.0]
    });
    std::fs::write(
        folder.join("short.nrrd"),
        &std::fs::read(folder.join("folded.nrrd")).unwrap()[..400],
    )
    .unwrap();
    std::fs::write(
        folder.join("huge.nrrd"),
        "NRRD0004\ntype: float\ndimension: 3\nsizes: 90000 90000 90000\nendian: little\nencoding: raw\n\nx",
    )
    .unwrap();
    std::fs::write(folder.join("words.txt"), "this is no transform").unwrap();
    std::fs::write(
        folder.join("other.tfm"),
        "#Insight Transform File V1.0\nTransform: ThinPlateSplineKernelTransform_double_3_3\nParameters: 1\nFixedParameters: 1\n",
    )
    .unwrap();
    std::fs::write(
        folder.join("flat.tfm"),
        "#Insight Transform File V1.0\nTransform: AffineTransform_double_3_3\nParameters: 1 2\nFixedParameters: 0 0 0\n",
    )
    .unwrap();
    let itk = |name: &str, kind: &str, parameters: usize, fixed: &str| {
        let text = format!(
            "#Insight Transform File V1.0\nTransform: {kind}_double_3_3\nParameters: {}\nFixedParameters: {fixed}\n",
            "0 ".repeat(parameters)
        );
        std::fs::write(folder.join(name), text).unwrap();
    };
    itk("zero.tfm", "AffineTransform", 12, "0 0 0");
    itk(
        "coarse.tfm",
        "BSplineTransform",
        81,
        "3 3 3 0 0 0 9 9 9 1 0 0 0 1 0 0 0 1",
    );
    std::fs::write(folder.join("singular.1D"), "1 0 0 0 1 0 0 0 0 0 1 0").unwrap();
    std::fs::write(folder.join("bad.csv"), "1,2,3,4,5\n").unwrap();
    std::fs::write(folder.join("bad.mrk.json"), "{\"markups\": 3}").unwrap();
}

/// Deformations that are refused, each with a part of its message.
const BAD_DEFORMATIONS: &[(&str, &str)] = &[
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
    ("field:path=affine.tfm,fade=-1", "fade"),
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
    (
        "explode-labels:label=77,labels=phantom:octants:size=16",
        "1, 2, 3",
    ),
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
    (
        "brush:strokes=cut 5 1 0 0 0,psuh 5 1 0 0 0 9 9 9",
        "stroke 2: \"psuh\" is not a tool; did you mean \"push\"?",
    ),
    ("brush:strokes=push 5 1 0 0 0", "needs at least 2"),
    ("peel:depth=deep", "deep"),
    ("wave:spare=words", "numbers"),
];

/// Invalid deformations are reported by name, without a panic or a file. Valid but unusual ones are
/// rendered with a notice.
pub fn bad_deformations_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    write_inputs(f);
    let before = std::fs::read_dir(f).unwrap().count();
    for (deformation, culprit) in BAD_DEFORMATIONS {
        let output = render(f, &["volume.nii.gz", "--deform", deformation]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{deformation}: {message}");
        assert!(
            message.contains(culprit) && !message.contains("panicked"),
            "{deformation}: {message}"
        );
        assert_eq!(
            std::fs::read_dir(f).unwrap().count(),
            before,
            "{deformation} left a file"
        );
    }
    // Cuts in groups must come last.
    let output = render(
        f,
        &["volume.nii.gz", "--deform", "sphere:group=a", "--deform", "twist"],
    );
    assert!(stderr(&output).contains("to the end") && output.status.code() == Some(1));
    // Too few points, and a field that folds everywhere: rendered, with a notice.
    let odd: &[(&str, &str)] = &[
        (
            "points:pairs=0,0,20,5,5,25,-10,0,0,-10,2,0",
            "2 points are too few",
        ),
        ("field:path=folded.nrrd,invert=true", "have no source"),
    ];
    for (deformation, expected) in odd {
        let output = render(f, &["volume.nii.gz", "--deform", deformation]);
        assert!(
            output.status.success() && stderr(&output).contains(expected),
            "{deformation}: {}",
            stderr(&output)
        );
    }
    check_folded_field(f);
    check_refused_commands(f);
}

/// Checks the report, the picture and the table of a field that folds everywhere.
fn check_folded_field(folder: &Path) {
    let check = incise(
        folder,
        &[
            "map",
            "check",
            "folded.nrrd",
            "--json",
            "--picture",
            "folds.png",
            "--csv",
            "folds.csv",
        ],
    );
    let report: serde_json::Value = serde_json::from_slice(&check.stdout).unwrap();
    assert_eq!(report["health"]["folds_percent"], 100.0);
    assert!(
        std::fs::read(folder.join("folds.png"))
            .unwrap()
            .starts_with(b"\x89PNG")
    );
    assert_eq!(
        std::fs::read_to_string(folder.join("folds.csv"))
            .unwrap()
            .lines()
            .count(),
        730
    );
}

/// Checks that maps and bakes without usable input or output are refused.
fn check_refused_commands(folder: &Path) {
    for (arguments, culprit) in [
        (&["bake", "volume.nii.gz", "-o", "out.tiff"][..], ".nrrd"),
        (&["bake", "volume.nii.gz", "-o", "volume.nii.gz"], "input"),
        (
            &["bake", "volume.nii.gz", "-o", "out.nii", "--fill", "nan"],
            "fill",
        ),
        (&["map", "peal", "-o", "out.nrrd"], "peel"),
        (&["map", "field.nrrd", "-o", "field.nrrd"], "input"),
        (&["map", "check", "words.txt"], "words.txt"),
        (
            &["map", "peel", "--volume", "volume.nii.gz", "-o", "volume.nii.gz"],
            "input",
        ),
        (&["map", "check", "field.nrrd", "--csv", "field.nrrd"], "input"),
        (
            &[
                "bake",
                "volume.nii.gz",
                "--deform",
                "field:path=field.nrrd",
                "-o",
                "field.nrrd",
            ],
            "input",
        ),
        (&["map", "check", "volume.nii.gz"], "1 values"),
        (&["gallery", "-o", "gallery", "--kind", "peal"], "peel"),
    ] {
        let output = incise(folder, arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(
            stderr(&output).contains(culprit),
            "{arguments:?}: {}",
            stderr(&output)
        );
    }
}

/// Runs the program and checks that it succeeds.
fn succeed(folder: &Path, arguments: &[&str]) -> Output {
    let output = incise(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    output
}

/// A map is made, used, converted, inverted and checked on the command line; a bake preserves type
/// and geometry.
pub fn maps_and_bakes_by_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let run = |arguments: &[&str]| succeed(f, arguments);
    let volume = "phantom:tomato:size=40";
    run(&[
        "map",
        "twist:angle=50,resolution=24",
        "--volume",
        volume,
        "-o",
        "twist.nrrd",
    ]);
    let picture = |deform: &[&str], out: &str| {
        run(&[
            &[
                "render",
                volume,
                "-o",
                out,
                "--size",
                "64x64",
                "--backend",
                "cpu",
                "-q",
            ],
            deform,
        ]
        .concat());
        std::fs::read(f.join(out)).unwrap()
    };
    let plain = picture(&[], "plain.png");
    let kind = picture(&["--deform", "twist:angle=50,resolution=24"], "kind.png");
    let map = picture(&["--deform", "map:path=twist.nrrd"], "map.png");
    assert!(plain != kind);
    // The file holds the displacement in mm, which is rounded to f16 on loading: a few pixels
    // differ by a small step.
    let decoded = |bytes: &[u8]| image::load_from_memory(bytes).unwrap().to_rgb8().into_raw();
    let far = decoded(&kind)
        .iter()
        .zip(decoded(&map))
        .filter(|(a, b)| a.abs_diff(*b) > 2)
        .count();
    assert!(far < 20, "{far}");
    // A field that vanishes on every face, so that nothing tears there.
    run(&[
        "map",
        "bulge:resolution=32",
        "--volume",
        volume,
        "-o",
        "bulge.nrrd",
    ]);
    run(&["map", "bulge.nrrd", "-o", "field.nii.gz"]);
    run(&["map", "field.nii.gz", "--invert", "-o", "back.mha"]);
    // A field followed by its inverse is close to zero displacement.
    run(&[
        "bake",
        volume,
        "--field",
        "-o",
        "none.mha",
        "--deform",
        "field:path=field.nii.gz",
        "--deform",
        "field:path=back.mha",
    ]);
    let health = |file: &str| -> serde_json::Value {
        serde_json::from_slice::<serde_json::Value>(
            &run(&["map", "check", file, "--json", "--no-inverse"]).stdout,
        )
        .unwrap()["health"]
            .clone()
    };
    let (there, nothing) = (
        health("field.nii.gz")["largest_mm"].as_f64().unwrap(),
        health("none.mha")["mean_mm"].as_f64().unwrap(),
    );
    assert!(there > 5.0 && nothing < 0.02, "{there} {nothing}");
    check_bakes(f);
    run(&[
        "gallery",
        "-o",
        "gallery",
        "--kind",
        "peel",
        "--kind",
        "lift",
        "--edge",
        "48",
        "--volume",
        "phantom:head-ct:size=48",
        "-q",
    ]);
    let page = std::fs::read_to_string(f.join("gallery/index.html")).unwrap();
    assert!(page.contains("peel-volume.png") && f.join("gallery/peel-checker.png").exists());
}

/// Checks that bakes have the type, the orientation and the labels of their volume.
fn check_bakes(folder: &Path) {
    let run = |arguments: &[&str]| succeed(folder, arguments);
    run(&[
        "bake",
        "phantom:tomato:size=40",
        "-o",
        "baked.nii.gz",
        "--deform",
        "slab:placement=volume",
        "--enlarge",
        "-q",
    ]);
    let info: serde_json::Value =
        serde_json::from_slice(&run(&["info", "--json", "baked.nii.gz"]).stdout).unwrap();
    assert_eq!(
        (info["type"].as_str(), info["orientation"].as_str()),
        (Some("u8"), Some("LPS"))
    );
    assert!(info["size"][2].as_u64().unwrap() > 50);
    // A label map keeps its labels.
    run(&[
        "bake",
        "phantom:octants:size=32",
        "-o",
        "labels.nrrd",
        "--deform",
        "wave",
    ]);
    let info: serde_json::Value =
        serde_json::from_slice(&run(&["info", "--json", "labels.nrrd"]).stdout).unwrap();
    assert_eq!(info["labels"], 8);
}
