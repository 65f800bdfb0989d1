//! Meshes, their distance fields and surfaces on the command line.

use super::{incise, render, stderr};
use ::incise::Watch;
use ::incise::volume::load::{self, ReadOptions};
use std::path::Path;

/// Meshes, their distance fields and surfaces on the command line: written files can be read back,
/// errors name the cause.
pub fn meshes_and_fields_by_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let write = |name: &str, text: &str| std::fs::write(f.join(name), text).unwrap();
    // A tetrahedron with legs of 60 mm, and the same with a missing face.
    let points = "v 0 0 0\nv 60 0 0\nv 0 60 0\nv 0 0 60\n";
    write(
        "tet.obj",
        &format!("{points}f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"),
    );
    write("open.obj", &format!("{points}f 1 3 2\nf 1 2 4\nf 1 4 3\n"));
    write("wrong.obj", &format!("{points}f 1 2 9\n"));
    let output = incise(f, &["info", "tet.obj", "--json"]);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        (
            &report["kind"],
            &report["triangles"],
            &report["watertight"],
            &report["components"]
        ),
        (&"mesh".into(), &4.into(), &true.into(), &1.into())
    );
    assert_eq!(
        report["bounds_mm"],
        serde_json::json!([[0.0, 0.0, 0.0], [60.0, 60.0, 60.0]])
    );
    for name in ["tet.nii.gz", "tet.nrrd", "tet.mha"] {
        let output = incise(f, &["sdf", "tet.obj", "-o", name, "--resolution", "32", "--json"]);
        assert!(output.status.success(), "{}", stderr(&output));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(
            (&report["open_edges"], &report["turned_triangles"]),
            (&0.into(), &0.into())
        );
        // The centre of the inscribed ball lies at depth r = 60 / (3 + √3); the field is positive
        // there and greatest.
        let volume = load::volume(&f.join(name), &ReadOptions::default(), &Watch::NONE).unwrap();
        let r = 60.0 / (3.0 + 3.0f64.sqrt());
        assert!(
            volume.range[1] <= r + 0.01 && volume.range[1] > r - 1.5,
            "{name}: {:?} for {r}",
            volume.range
        );
    }
    let part = incise(
        f,
        &[
            "sdf",
            "tet.obj",
            "-o",
            "part.nrrd",
            "--box=-5,-5,-5,20,20,20",
            "--cell",
            "1",
            "--exact",
        ],
    );
    assert!(part.status.success(), "{}", stderr(&part));
    let volume = load::volume(&f.join("part.nrrd"), &ReadOptions::default(), &Watch::NONE).unwrap();
    assert!(
        volume.size.iter().all(|n| (23..=27).contains(n)),
        "{:?}",
        volume.size
    );
    let open = incise(f, &["sdf", "open.obj", "-o", "open.nrrd", "--resolution", "32"]);
    assert!(
        open.status.success() && stderr(&open).contains("3 open edges"),
        "{}",
        stderr(&open)
    );
    for name in ["tet.obj", "open.obj"] {
        let output = render(f, &[name]);
        assert!(
            output.status.success() && f.join("out.png").is_file(),
            "{}",
            stderr(&output)
        );
        std::fs::remove_file(f.join("out.png")).unwrap();
    }
    check_refused_commands(f);
    check_refused_scenes(f);
}

/// Checks that distance fields and bakes without usable input or output are refused.
fn check_refused_commands(folder: &Path) {
    for (arguments, culprit) in [
        (&["sdf", "wrong.obj", "-o", "x.nrrd"][..], "wrong.obj"),
        (&["sdf", "nowhere.obj", "-o", "x.nrrd"], "nowhere.obj"),
        (&["sdf", "tet.txt", "-o", "x.nrrd"], "tet.txt"),
        (&["sdf", "tet.obj", "-o", "x.stl"], "x.stl"),
        (
            &["sdf", "tet.obj", "-o", "x.nrrd", "--resolution", "0"],
            "--resolution",
        ),
        (&["sdf", "tet.obj", "-o", "x.nrrd", "--cell", "-1"], "cell"),
        (
            &["sdf", "tet.obj", "-o", "x.nrrd", "--cell", "0.001"],
            "too large",
        ),
        (&["sdf", "tet.obj", "-o", "x.nrrd", "--box", "1,2,3"], "--box"),
        (
            &[
                "sdf",
                "tet.obj",
                "-o",
                "x.nrrd",
                "--box",
                "100,100,100,200,200,200",
            ],
            "tet.obj",
        ),
        (&["bake", "tet.obj", "-o", "x.nrrd"], "no volume"),
    ] {
        let output = incise(folder, arguments);
        assert!(matches!(output.status.code(), Some(1 | 2)), "{arguments:?}");
        assert!(
            stderr(&output).contains(culprit) && !stderr(&output).contains("panicked"),
            "{arguments:?}: {}",
            stderr(&output)
        );
        assert!(!folder.join("x.nrrd").exists());
    }
}

/// Checks that scenes with invalid meshes or surfaces are refused with a message that names the
/// fault.
fn check_refused_scenes(folder: &Path) {
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
        (
            &format!("{mesh}matrix = [[1,0,0,0],[1,0,0,0],[0,0,1,0]]\n"),
            "singular",
        ),
        (
            &format!("{mesh}representation = \"depth-map\"\nface = \"up\"\n"),
            "face",
        ),
        (&format!("{mesh}[[mesh.deformer]]\nkind = \"twits\"\n"), "twist"),
        (
            &format!("{mesh}[[mesh.deformer]]\nkind = \"twist\"\nangel = 3.0\n"),
            "angle",
        ),
        (
            &format!("{mesh}[[mesh.deformer]]\nkind = \"taper\"\nfactor = -1.0\n"),
            "factor",
        ),
        (
            &format!("{mesh}[[mesh.deformer]]\nkind = \"lattice\"\npoints = [[9, 0, 0, 1, 1, 1]]\n"),
            "lattice",
        ),
        (&format!("{mesh}[surface]\nstep = \"sphere\"\n"), "steps"),
        (&format!("{mesh}[surface]\nseam = 0.0\n"), "seam"),
        ("incise = 1\n[[mesh]]\nshape = [{ kind = \"cube\" }]\n", "cube"),
        (
            "incise = 1\n[[mesh]]\nshape = [{ kind = \"sphere\", radius = -1.0 }]\n",
            "radius",
        ),
        (
            "incise = 1\n[[mesh]]\nshape = [{ kind = \"sphere\", join = \"minus\" }]\n",
            "join",
        ),
        ("incise = 1\n[[mesh]]\niso = 3.0\n", "volume"),
        (
            "incise = 1\n[volume]\npath = \"phantom:ball\"\n[[mesh]]\nlabel = [77]\n",
            "label",
        ),
    ] {
        std::fs::write(folder.join("scene.toml"), text).unwrap();
        let output = render(folder, &["scene.toml"]);
        assert!(matches!(output.status.code(), Some(1 | 2)), "{text}");
        let message = stderr(&output);
        assert!(
            message.contains(culprit) && !message.contains("panicked"),
            "{text}: {message}"
        );
        assert!(!folder.join("out.png").exists(), "{text}");
    }
}
