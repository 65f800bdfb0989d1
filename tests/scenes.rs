//! The scenes in volumes/, and properties of all scenes.

use crate::closed_forms::picture;
use crate::metrics::{STEP, difference};
use incise::prepare::{Assets, Prepared};
use incise::scene::{Antialias, FORMAT_VERSION, Mode, Normals, Scene, SliceOrder, VolumeFilter};
use incise::transfer::RelativeTo;
use std::path::PathBuf;

/// The scene files, by name.
pub fn files() -> Vec<PathBuf> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("volumes");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .flatten()
        .map(|e| e.path())
        .filter(|p| p.extension().is_some_and(|e| e == "toml"))
        .collect();
    files.sort();
    assert!(files.len() >= 20, "{files:?}");
    files
}

/// A scene of volumes/ with the defaults of version 1: one sample a pixel and linear interpolation.
/// What is asserted about samples then does not depend on what is interpolated between them.
pub fn load(name: &str) -> Scene {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("volumes");
    let text = std::fs::read_to_string(folder.join(format!("{name}.toml"))).unwrap();
    let first = text.replace("incise = 2\n", "incise = 1\n");
    assert_ne!(first, text, "{name} is of version 2");
    let mut scene = Scene::from_toml(&first).unwrap();
    scene.folder = folder;
    scene
}

pub fn assets(scene: &Scene) -> Assets {
    Assets::load(scene).unwrap()
}

pub fn every_scene_loads_and_comes_back() {
    for file in files() {
        let scene = Scene::load(&file).unwrap_or_else(|e| panic!("{e}"));
        let mut again = Scene::from_toml(&scene.to_toml().unwrap()).unwrap();
        again.folder.clone_from(&scene.folder);
        assert_eq!(again, scene, "{}", file.display());
        assert!(
            incise::volume::phantom::is_procedural(scene.volume_name())
                || scene.volume_path().is_none_or(|p| p.is_file())
        );
    }
}

/// A scene of version 1 gets that version's defaults, and is written as what it then is: version 2
/// with these settings stated.
pub fn every_version_is_read() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/scenes");
    let load = |n: u32| Scene::load(&folder.join(format!("version-{n}.toml"))).unwrap();
    let [first, second] = [load(1), load(2)];
    assert_eq!((first.incise, second.incise), (FORMAT_VERSION, FORMAT_VERSION));
    assert_eq!(
        (first.render.antialias, second.render.antialias),
        (Antialias::OFF, Antialias::Adaptive)
    );
    assert_eq!(
        (first.transfer.relative_to, second.transfer.relative_to),
        (RelativeTo::Range, RelativeTo::Object)
    );
    assert_eq!(
        (first.render.filter, second.render.filter),
        (VolumeFilter::Linear, VolumeFilter::Cubic)
    );
    let written = Scene::from_toml(&first.to_toml().unwrap()).unwrap();
    assert_eq!(written.to_toml().unwrap(), first.to_toml().unwrap());
    // Nothing else differs.
    let mut same = second.clone();
    (same.render.antialias, same.transfer.relative_to) = (Antialias::OFF, RelativeTo::Range);
    (same.render.filter, same.render.preintegrated) = (VolumeFilter::Linear, Some(false));
    assert_eq!(same, first);
    // What a scene states is left as it is.
    let text = "incise = 1\n[volume]\npath = \"phantom:ball\"\n[render]\nantialias = 3\n[transfer]\npreset = \"checker\"\n";
    let stated = Scene::from_toml(text).unwrap();
    assert_eq!(stated.render.antialias, Antialias::Grid(3));
    assert_eq!(stated.transfer.relative_to, RelativeTo::Object);
    let text = "incise = 1\n[volume]\npath = \"ct.nii\"\n[transfer]\npreset = \"ct-bone\"\n";
    let unshifted = Scene::from_toml(text).unwrap();
    assert_eq!(unshifted.transfer.relative_to, RelativeTo::Range);
    for unknown in ["0", "3", "-1"] {
        let text = format!("incise = {unknown}\n[volume]\npath = \"phantom:ball\"\n");
        assert!(Scene::from_toml(&text).unwrap_err().contains("versions 1 to 2"));
    }
}

/// Deformed and cut scenes, both modes: skipping and early ray termination change no pixel by more
/// than one 8-bit step.
pub fn skipping_and_termination_change_nothing() {
    for name in [
        "head-peel",
        "head-quadrant",
        "head-slabs",
        "piggy-bank-4",
        "tomato-wave-then-peel",
        "teddy-seam",
        "pull",
    ] {
        let mut scene = load(name);
        let assets = assets(&scene);
        scene.render.size = [96, 96];
        for mode in [Mode::Raycast, Mode::Slice] {
            scene.render.mode = mode;
            // Slices end early only in this order.
            scene.render.slice_order = SliceOrder::FrontToBack;
            let render = |skipping: bool, termination: bool| {
                let mut s = scene.clone();
                s.render.empty_space_skipping = skipping;
                s.render.early_termination = termination;
                let prepared = Prepared::new(&s, &assets).unwrap();
                incise::cpu::render(&prepared)
            };
            let neither = render(false, false);
            let stats = neither.stats.unwrap();
            assert_eq!((stats.samples_skipped, stats.samples_terminated), (0, 0));
            for (skipping, termination) in [(true, false), (false, true), (true, true)] {
                let r = render(skipping, termination);
                let d = difference(&neither.picture, &r.picture).unwrap();
                println!(
                    "{name} {mode:?}: skipping {skipping}, termination {termination}: max {:.3}/255",
                    d.max / STEP
                );
                assert!(
                    d.max <= STEP,
                    "{name} {mode:?} skipping {skipping}, termination {termination}: {d:?}"
                );
                let (with, without) = (r.stats.unwrap(), stats);
                assert!(
                    with.samples_taken < without.samples_taken * 9 / 10,
                    "{name}: {with:?} against {without:?}"
                );
                if skipping && !termination {
                    assert!(
                        d.max == 0.0,
                        "{name} {mode:?}: skipping changed a sample that shows: {d:?}"
                    );
                }
            }
        }
    }
}

pub fn halving_the_step_changes_little() {
    for name in ["head-peel", "piggy-bank-3", "tomato-slices-2", "teddy-seam"] {
        let mut scene = load(name);
        let assets = assets(&scene);
        scene.render.size = [192, 192];
        for mode in [Mode::Raycast, Mode::Slice] {
            scene.render.mode = mode;
            let mut at = |step: f32| {
                scene.render.step = step;
                picture(&Prepared::new(&scene, &assets).unwrap())
            };
            let d = difference(&at(1.0), &at(0.5)).unwrap();
            println!(
                "{name} {mode:?}: step halved, mean change {:.3}/255",
                d.mean / STEP
            );
            assert!(
                d.mean > 0.0 && d.mean < 2.0 * STEP,
                "{name} {mode:?}: {}/255",
                d.mean / STEP
            );
        }
    }
}

/// The data derived from a mesh around a volume is cached independently of the camera, and rebuilt
/// if the mesh changes.
pub fn what_holds_a_volume_is_kept() {
    let mut scene = load("head-in-bent-hull");
    let assets = assets(&scene);
    let stack = |scene: &Scene| Prepared::new(scene, &assets).unwrap().stack;
    let first = stack(&scene);
    assert_eq!(first.maps().len(), 2, "the mask and the deformers' inverse");
    scene.camera.view = "35,15".parse().unwrap();
    // Stacks are equal if they hold the same map objects. A map at a coarser step does not evict
    // the full one.
    assert!(stack(&scene) == first);
    scene.render.step = 2.0;
    assert!(stack(&scene) != first && stack(&scene) == stack(&scene));
    scene.render.step = 1.0;
    assert!(stack(&scene) == first);
    scene.volume.as_mut().unwrap().inside.as_mut().unwrap().invert = true;
    assert!(stack(&scene) != first);
}

/// The shading of cuts and of the volume's own faces varies with the step no more than that of
/// surfaces: the effect of a cut on nearby normals must not depend on the number of samples in
/// front of the cut.
pub fn cuts_are_lit_alike_at_every_step() {
    let camera = "[camera]\nview = \"30,30\"\nzoom = 1.6\n[[deformation]]\nkind = \"box\"\n";
    for (volume, rest) in [
        ("phantom:ball:size=64", camera),
        (
            "volumes/colin27-head-t1.nii.gz",
            "[camera]\nview = \"anterior\"\n",
        ),
    ] {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(volume);
        let path = if volume.starts_with("phantom") {
            volume
        } else {
            path.to_str().unwrap()
        };
        let mut scene = Scene::from_toml(&format!("incise = 1\n[volume]\npath = '{path}'\n{rest}")).unwrap();
        scene.render.size = [128, 128];
        let assets = assets(&scene);
        let change = [Normals::Blended, Normals::Transformed].map(|normals| {
            scene.render.normals = normals;
            let mut at = |step: f32| {
                scene.render.step = step;
                picture(&Prepared::new(&scene, &assets).unwrap())
            };
            incise::compare::difference(&at(1.0), &at(0.125)).unwrap().rms()
        });
        println!(
            "{volume}: step 1 against 1/8, RMS {:.2} of 255; without the normals of cuts {:.2}",
            change[0], change[1]
        );
        assert!(
            change[1] > 0.5 && change[0] < 1.15 * change[1],
            "{volume}: {change:?}"
        );
    }
}

pub fn order_of_deformations_matters() {
    let (mut a, mut b) = (load("tomato-wave-then-peel"), load("tomato-peel-then-wave"));
    a.deformation.reverse();
    assert_eq!(a.deformation, b.deformation, "the same two, in two orders");
    a.deformation.reverse();
    (a.render.size, b.render.size) = ([128, 128], [128, 128]);
    let assets = assets(&a);
    let d = difference(
        &picture(&Prepared::new(&a, &assets).unwrap()),
        &picture(&Prepared::new(&b, &assets).unwrap()),
    )
    .unwrap();
    assert!(d.mean > 2.0 * STEP, "{d:?}");
}

/// The atlas of the bundled head names its regions: 1 is Precentral_L, 2 is Precentral_R. Patient
/// left is +x, and on the right of an anterior picture.
pub fn left_is_left() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("volumes/colin27-aal-labels.nii.gz");
    let mut scene = Scene::of_volume(path.to_str().unwrap());
    let assets = assets(&scene);
    let volume = &assets.volume;
    let mean_x = |label: f64| {
        let (mut sum, mut count) = (0.0, 0usize);
        for n in (0..volume.voxels.len()).filter(|&n| volume.voxels.get(n) == label) {
            let [nx, ny, _] = volume.size;
            let p = glam::DVec3::new((n % nx) as f64, (n / nx % ny) as f64, (n / nx / ny) as f64);
            sum += volume.world_from_voxel.transform_point3(p).x;
            count += 1;
        }
        assert!(count > 1000);
        sum / count as f64
    };
    let (left, right) = (mean_x(1.0), mean_x(2.0));
    assert!(left > 20.0 && right < -20.0, "{left} {right}");
    // Only label 1 opaque.
    scene.transfer.points = [(0.4, 0.0), (0.6, 0.9), (1.4, 0.9), (1.6, 0.0)]
        .map(|(value, opacity)| incise::transfer::ControlPoint {
            value,
            color: [1.0; 3],
            opacity,
        })
        .to_vec();
    scene.deformation.clear();
    scene.render.size = [128, 128];
    let p = picture(&Prepared::new(&scene, &assets).unwrap());
    // The edges of all labels pass through label 1's value: weight by opacity.
    let (mut on_left, mut on_right) = (0.0, 0.0);
    for (n, pixel) in p.pixels.iter().enumerate() {
        if n % 128 < 64 {
            on_left += pixel[3]
        } else {
            on_right += pixel[3]
        }
    }
    assert!(
        on_right > 1.1 * on_left,
        "label Precentral_L shows {on_left} on the left half, {on_right} on the right"
    );
}

/// An empty picture comes with the reason in one line.
pub fn empty_pictures_say_why() {
    let volume = "[volume]\npath = \"phantom:head-ct:size=16\"\n";
    let solid = |join: &str, center: [f32; 3], radius: f32| {
        format!(
            "[[mesh]]\n[[mesh.shape]]\nkind = \"sphere\"\nradius = 10.0\n[[mesh.shape]]\njoin = \"{join}\"\nkind = \"sphere\"\nradius = {radius:?}\ncenter = {center:?}\n"
        )
    };
    for (text, words) in [
        (
            format!("{volume}[[deformation]]\nkind = \"box\"\ncenter = [0, 0, 0]\nsize = 2000.0"),
            "everything is cut away",
        ),
        (
            format!(
                "{volume}[[deformation]]\nkind = \"knife\"\n[[deformation]]\nkind = \"box\"\ncenter = [0, 0, 0]\nsize = 2000.0"
            ),
            "is cut away",
        ),
        (
            format!("{volume}[camera]\ntarget = [5000.0, 0.0, 0.0]"),
            "reset camera.target",
        ),
        (format!("{volume}[render]\niso = 9000.0"), "no surface at 9000"),
        (
            format!("{volume}[render]\nmode = \"surface\"\n[surface]\niso = 9000.0"),
            "no surface at 9000",
        ),
        (
            format!("{volume}[render]\nmode = \"surface\"\n[[mesh]]\niso = 9000.0"),
            "no surface at 9000",
        ),
        (format!("{volume}[render]\nstep = 100.0"), "reduce render.step"),
        (
            format!("{volume}[transfer]\ndensity = 0.0"),
            "transfer.density is 0",
        ),
        (
            format!("{volume}[transfer]\nwindow = 1.0\nlevel = 1e6"),
            "transparent",
        ),
        (
            format!("{volume}[transfer]\nblend = \"mip\"\nwindow = 1.0\nlevel = 1e6"),
            "transparent",
        ),
        (
            format!(
                "{volume}[[transfer.gradient_opacity]]\nmagnitude = 0.0\nfactor = 0.0\n[[transfer.gradient_opacity]]\nmagnitude = 1e9\nfactor = 0.0"
            ),
            "transfer.gradient_opacity",
        ),
        (solid("subtract", [0.0; 3], 20.0), "has no interior"),
        (solid("intersect", [90.0, 0.0, 0.0], 10.0), "has no interior"),
    ] {
        let mut scene =
            Scene::from_toml(&format!("incise = 1\n{text}")).unwrap_or_else(|e| panic!("{e}\n{text}"));
        scene.render.size = [32, 32];
        if scene.volume.is_none() {
            scene.render.mode = Mode::Surface;
        }
        let assets = assets(&scene);
        let prepared = Prepared::new(&scene, &assets).unwrap_or_else(|e| panic!("{e}\n{text}"));
        let rendered = incise::cpu::render(&prepared);
        let warnings: Vec<String> = rendered
            .notices
            .into_iter()
            .chain(assets.library.notices())
            .collect();
        assert!(rendered.picture.is_blank(), "{text}");
        assert!(
            warnings.iter().any(|line| line.contains(words)),
            "{text}\n{warnings:?}"
        );
    }
    // A picture that is not empty has no such notice.
    let scene = Scene::of_volume("phantom:head-ct:size=16");
    let assets = assets(&scene);
    assert!(
        incise::cpu::render(&Prepared::new(&scene, &assets).unwrap())
            .notices
            .is_empty()
    );
}
