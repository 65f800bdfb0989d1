//! GPU against CPU: first values (the shaders' functions at thousands of points), then every scene
//! in both modes.
//!
//! Without an adapter these are reported as ignored; with INCISE_REQUIRE_ADAPTER set, a missing
//! adapter fails.

use crate::contract::points;
use crate::metrics::{STEP, difference};
use crate::scenes;
use incise::Watch;
use incise::cpu;
use incise::gpu::{AdapterPreference, Device};
use incise::prepare::{PrepareOptions, Prepared};
use incise::render::{Renderer, Strategy};
use incise::scene::{Antialias, CutFaces, Deformation, IsoLight, Mode, Scene, SliceOrder, VolumeFilter};
use incise::transfer::{Blend, GradientPoint};
use incise::volume::GradientFilter;
use libtest_mimic::Trial;
use numbers::numbers_agree;
use space::empty_space_agrees;
use std::sync::{LazyLock, Mutex};
use surfaces::{one_deformation_on_the_gpu, surface_depths_agree, surface_options_agree};
use volumes::{larger_than_the_device_is_reduced, own_colors_agree, voxel_types_agree};

mod numbers;
mod space;
mod surfaces;
mod volumes;

static RENDERER: LazyLock<Mutex<Result<Renderer, String>>> = LazyLock::new(|| {
    Mutex::new(
        Device::open(AdapterPreference::Any)
            .map(Renderer::new)
            .map_err(|e| e.to_string()),
    )
});

pub fn with_renderer<T>(work: impl FnOnce(&mut Renderer) -> T) -> T {
    // The renderer stays usable after another test has failed.
    let mut guard = RENDERER.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    work(guard.as_mut().unwrap())
}

/// Whether there is an adapter.
pub fn has_renderer() -> bool {
    RENDERER
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
        .is_ok()
}

pub fn trials() -> Vec<Trial> {
    let required = std::env::var_os("INCISE_REQUIRE_ADAPTER").is_some();
    let missing = RENDERER.lock().unwrap().as_ref().err().cloned();
    let mut all = vec![];
    if required {
        let missing = missing.clone();
        all.push(crate::trial("parity::an_adapter_is_present", move || {
            missing.map_or(Ok(()), |e| Err(e.into()))
        }));
    }
    let gpu = |name: String, test: Box<dyn FnOnce() + Send>| {
        crate::trial(name, move || {
            test();
            Ok(())
        })
        .with_ignored_flag(missing.is_some())
    };
    for file in scenes::files() {
        let name = file.file_stem().unwrap().to_string_lossy().into_owned();
        let own = Scene::load(&file).map_or(Mode::Raycast, |s| s.render.mode);
        let modes: &[Mode] = if own == Mode::Surface {
            &[Mode::Surface, Mode::Slice]
        } else {
            &[Mode::Slice, Mode::Raycast]
        };
        for &mode in modes {
            let scene = name.clone();
            all.push(gpu(
                format!("parity::{name}::{mode:?}").to_lowercase(),
                Box::new(move || scene_agrees(&scene, mode)),
            ));
        }
    }
    for kind in incise::deform::kinds::list() {
        all.push(gpu(
            format!("parity::numbers::{}", kind.name),
            Box::new(move || numbers_agree(kind.name)),
        ));
    }
    all.push(gpu("parity::options_agree".into(), Box::new(options_agree)));
    all.push(gpu("parity::shadows_agree".into(), Box::new(shadows_agree)));
    all.push(gpu(
        "parity::antialiasing_agrees".into(),
        Box::new(antialiasing_agrees),
    ));
    all.push(gpu(
        "filters::filters_agree".into(),
        Box::new(crate::filters::filters_agree),
    ));
    all.push(gpu(
        "functions::functions_agree".into(),
        Box::new(crate::functions::functions_agree),
    ));
    all.push(gpu(
        "parity::surface_depths_agree".into(),
        Box::new(surface_depths_agree),
    ));
    all.push(gpu(
        "parity::surface_options_agree".into(),
        Box::new(surface_options_agree),
    ));
    all.push(gpu(
        "parity::one_deformation_on_the_gpu".into(),
        Box::new(one_deformation_on_the_gpu),
    ));
    all.push(gpu("parity::counts_agree".into(), Box::new(counts_agree)));
    all.push(gpu(
        "editing::edits_upload_what_changed".into(),
        Box::new(crate::editing::edits_upload_what_changed),
    ));
    all.push(gpu(
        "editing::edits_of_surfaces_upload_what_changed".into(),
        Box::new(crate::editing::edits_of_surfaces_upload_what_changed),
    ));
    all.push(gpu(
        "editing::edits_prepare_what_changed".into(),
        Box::new(crate::editing::edits_prepare_what_changed),
    ));
    all.push(gpu(
        "editing::segments_and_shifts_agree_between_modes".into(),
        Box::new(crate::editing::segments_and_shifts_agree_between_modes),
    ));
    all.push(gpu(
        "slices::crossing_surfaces_agree".into(),
        Box::new(crate::slices::crossing_surfaces_agree),
    ));
    all.push(gpu(
        "slices::options_of_slices_agree".into(),
        Box::new(crate::slices::options_of_slices_agree),
    ));
    all.push(gpu("parity::eight_maps_agree".into(), Box::new(eight_maps_agree)));
    all.push(gpu(
        "parity::composition_agrees".into(),
        Box::new(composition_agrees),
    ));
    all.push(gpu(
        "composition::many_maps_agree".into(),
        Box::new(crate::composition::many_maps_agree),
    ));
    all.push(gpu("parity::strategies_agree".into(), Box::new(strategies_agree)));
    all.push(gpu(
        "parity::empty_space_agrees".into(),
        Box::new(empty_space_agrees),
    ));
    all.push(gpu(
        "parity::voxel_types_agree".into(),
        Box::new(voxel_types_agree),
    ));
    all.push(gpu("parity::own_colors_agree".into(), Box::new(own_colors_agree)));
    all.push(gpu(
        "parity::larger_than_the_device_is_reduced".into(),
        Box::new(larger_than_the_device_is_reduced),
    ));
    all
}

/// The strategy of a hardware GPU.
const PREPARE: Strategy = Strategy {
    exact_filter: true,
    compute_rays: true,
    prepare: true,
};

/// Runs the renderer with a strategy other than its own.
fn with_strategy<T>(strategy: Strategy, work: impl FnOnce(&mut Renderer) -> T) -> T {
    with_renderer(|r| {
        let own = r.set_strategy(strategy);
        let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| work(r)));
        r.set_strategy(own);
        done.unwrap_or_else(|e| std::panic::resume_unwind(e))
    })
}

pub fn agree(what: &str, prepared: &Prepared) {
    agree_by(what, prepared, |r| r.render(prepared, false, &Watch::NONE));
}

fn agree_by(
    what: &str,
    prepared: &Prepared,
    render: impl FnOnce(&mut Renderer) -> incise::Result<incise::picture::Rendered>,
) {
    let by_cpu = cpu::render(prepared).picture;
    let by_gpu = with_renderer(|r| render(r).unwrap_or_else(|e| panic!("{what}: {e}"))).picture;
    let d = difference(&by_cpu, &by_gpu).unwrap_or_else(|e| panic!("{what}: {e}"));
    println!(
        "{what}: mean {:.4}/255, max {:.2}/255, within 4/255: {:.4} %",
        d.mean / STEP,
        d.max / STEP,
        100.0 * d.within_4
    );
    assert!(
        d.mean <= 0.5 * STEP && d.within_4 >= 0.999,
        "{what}: mean {}/255, {} % within 4/255",
        d.mean / STEP,
        100.0 * d.within_4
    );
}

fn scene_agrees(name: &str, mode: Mode) {
    let mut scene = scenes::load(name);
    scene.render.mode = mode;
    scene.render.size = [192, 192];
    scene.render.antialias = Antialias::OFF;
    let assets = scenes::assets(&scene);
    agree(
        &format!("{name} {mode:?}"),
        &Prepared::new(&scene, &assets).unwrap(),
    );
}

/// Shadows and occlusion by rays, slices, surfaces, triangles, iso-surfaces and on grey cut faces.
fn shadows_agree() {
    let check = |what: &str, name: &str, change: &dyn Fn(&mut Scene)| {
        let mut scene = scenes::load(name);
        scene.render.size = [160, 150];
        scene.render.antialias = Antialias::OFF;
        change(&mut scene);
        let assets = scenes::assets(&scene);
        let plain = cpu::render(&Prepared::new(&scene, &assets).unwrap()).picture;
        (scene.light.shadow, scene.light.occlusion, scene.light.radius) = (true, true, 4.0);
        let prepared = Prepared::new(&scene, &assets).unwrap();
        let lit = cpu::render(&prepared).picture;
        let d = difference(&plain, &lit).unwrap();
        assert!(d.mean > 0.2 * STEP, "{what}: {}/255 by shadows", d.mean / STEP);
        agree(&format!("{what} with shadows"), &prepared);
    };
    check("rays", "head-peel", &|_| ());
    check("slices", "head-peel", &|s| s.render.mode = Mode::Slice);
    check("labels", "brain-labels", &|_| ());
    check("one-sided light", "tomato-wave-then-peel", &|s| {
        s.light.two_sided = false
    });
    check("an iso-surface", "head-iso", &|_| ());
    check("an iso-surface by derivatives", "head-iso", &|s| {
        s.render.iso_light = IsoLight::Derivative
    });
    check("grey cut faces", "head-quadrant", &|s| {
        s.render.cut_faces = CutFaces::Grey
    });
    check("surfaces", "apple-thick", &|_| ());
    check("sliced surfaces", "apple-thick", &|s| s.render.mode = Mode::Slice);
    check("triangles", "bunny-deformers", &|_| ());
    check("triangles and rays", "bunny-two-stage", &|_| ());
    check("a volume with surfaces", "head-with-nuclei", &|_| ());
}

/// Adaptive antialiasing by rays (fragments and compute), slices and their projections, triangles,
/// and triangles joined with rays.
fn antialiasing_agrees() {
    let check = |what: &str, name: &str, strategy: Option<Strategy>, change: &dyn Fn(&mut Scene)| {
        let mut scene = scenes::load(name);
        scene.render.size = [150, 130];
        scene.render.antialias = Antialias::Adaptive;
        change(&mut scene);
        let assets = scenes::assets(&scene);
        let prepared = Prepared::new(&scene, &assets).unwrap();
        let plain = {
            let mut plain = scene.clone();
            plain.render.antialias = Antialias::OFF;
            cpu::render(&Prepared::new(&plain, &assets).unwrap()).picture
        };
        let refined = cpu::render(&prepared).picture;
        let changed = plain
            .pixels
            .iter()
            .zip(&refined.pixels)
            .filter(|(a, b)| a != b)
            .count();
        assert!(changed > 100, "{what}: {changed} pixels refined");
        match strategy {
            Some(strategy) => {
                let by_gpu =
                    with_strategy(strategy, |r| r.render(&prepared, false, &Watch::NONE).unwrap()).picture;
                let d = difference(&refined, &by_gpu).unwrap();
                assert!(
                    d.mean <= 0.5 * STEP && d.within_4 >= 0.999,
                    "{what}: {}",
                    d.mean / STEP
                );
            }
            None => agree(what, &prepared),
        }
    };
    check("rays", "head-quadrant", None, &|_| ());
    check("computed rays", "head-quadrant", Some(PREPARE), &|_| ());
    check("slices", "head-quadrant", None, &|s| s.render.mode = Mode::Slice);
    check("slices, front to back", "head-quadrant", None, &|s| {
        s.render.mode = Mode::Slice;
        s.render.slice_order = SliceOrder::FrontToBack;
    });
    check("maximum by slices", "head-quadrant", None, &|s| {
        s.render.mode = Mode::Slice;
        s.transfer.blend = Some(Blend::Mip);
    });
    check("triangles", "bunny-deformers", None, &|_| ());
    check("triangles and rays", "bunny-two-stage", None, &|_| ());
    check("surfaces in a volume", "head-with-nuclei", None, &|_| ());
}

/// Cuts of every shape, with a group and an inversion.
fn every_cut() -> [Deformation; 8] {
    let cut = |kind: &str, center: [f32; 3], settings: &[(&str, &str)]| {
        let mut d = Deformation::new(kind);
        d.center = Some(center);
        settings
            .iter()
            .for_each(|(name, value)| d.parameters.insert(*name, *value));
        d
    };
    [
        cut(
            "half-space",
            [0.0, 0.0, 30.0],
            &[("group", "a"), ("combine", "and")],
        ),
        Deformation {
            rotate: Some([0.0, 70.0, 0.0]),
            ..cut("half-space", [10.0, 0.0, 0.0], &[("group", "a")])
        },
        cut("sphere", [40.0, -50.0, 10.0], &[]),
        cut("box", [-40.0, -50.0, -10.0], &[]),
        cut("wedge", [0.0, 40.0, 0.0], &[]),
        cut("cylinder", [0.0, -60.0, 0.0], &[("invert", "false")]),
        cut("view-cone", [0.0, -20.0, 20.0], &[]),
        Deformation {
            size: Some(incise::scene::Size::Cube(170.0)),
            ..cut("sphere", [0.0; 3], &[("invert", "true")])
        },
    ]
}

/// All options that change the shaders.
fn options_agree() {
    let mut base = Scene::of_volume("phantom:head-ct:size=64");
    base.render.filter = VolumeFilter::Linear;
    base.render.size = [128, 128];
    base.camera.view = "40,20".parse().unwrap();
    base.deformation.push(Deformation::new("knife"));
    let assets = scenes::assets(&base);
    let mut variants: Vec<(&str, Scene)> = Vec::new();
    let mut add = |name, change: &dyn Fn(&mut Scene)| {
        let mut s = base.clone();
        change(&mut s);
        variants.push((name, s));
    };
    add("orthographic", &|s| {
        s.camera.projection = incise::scene::Projection::Orthographic
    });
    add("cubic", &|s| s.render.filter = VolumeFilter::Cubic);
    add("cubic, preintegrated, gradient opacity", &|s| {
        (s.render.filter, s.render.preintegrated) = (VolumeFilter::Cubic, Some(true));
        s.transfer.gradient_opacity = vec![
            GradientPoint {
                magnitude: 0.0,
                factor: 0.2,
            },
            GradientPoint {
                magnitude: 60.0,
                factor: 1.0,
            },
        ];
    });
    add("sobel", &|s| s.render.gradient = GradientFilter::Sobel);
    add("one-sided", &|s| s.light.two_sided = false);
    add("normals none", &|s| {
        s.render.normals = incise::scene::Normals::None
    });
    add("normals source", &|s| {
        s.render.normals = incise::scene::Normals::Source
    });
    add("normals transformed", &|s| {
        s.render.normals = incise::scene::Normals::Transformed
    });
    add("soft", &|s| {
        s.transfer.preset = Some("ct-bones-and-muscle".into())
    });
    add("gradient opacity", &|s| {
        s.transfer.gradient_opacity = vec![
            GradientPoint {
                magnitude: 0.0,
                factor: 0.0,
            },
            GradientPoint {
                magnitude: 300.0,
                factor: 1.0,
            },
        ];
    });
    add("mip", &|s| s.transfer.preset = Some("ct-mip".into()));
    add("minip", &|s| s.transfer.preset = Some("ct-minip".into()));
    add("average", &|s| s.transfer.preset = Some("ct-xray".into()));
    add("step 0.5", &|s| s.render.step = 0.5);
    add("jitter", &|s| s.render.jitter = true);
    add("preintegrated", &|s| {
        s.render.preintegrated = Some(true);
        s.transfer.preset = Some("ct-bones-and-muscle".into());
    });
    add("preintegrated, step 2, jitter", &|s| {
        (s.render.preintegrated, s.render.jitter, s.render.step) = (Some(true), true, 2.0);
    });
    add("round an axis", &|s| {
        let mut shells = Deformation::new("slab");
        shells.placement = incise::scene::DefaultPlacement::Volume;
        shells.parameters.insert("mapping", "cylindrical");
        s.deformation.push(shells);
    });
    // These follow a displacing map.
    let cuts = every_cut();
    add("exact cuts", &|s| s.deformation.extend(cuts.clone()));
    add("grey faces", &|s| {
        s.deformation.extend(cuts.clone());
        s.render.cut_faces = CutFaces::Grey;
    });
    add("grey faces of masks", &|s| s.render.cut_faces = CutFaces::Grey);
    add("iso-surface", &|s| {
        s.deformation.push(cuts[0].clone());
        s.render.iso = Some(200.0);
    });
    add("iso-surface by derivative", &|s| {
        s.render.iso = Some(-100.0);
        s.render.iso_light = IsoLight::Derivative;
        s.light.key_color = [1.0, 0.7, 0.4];
        s.light.sky_color = [0.5, 0.8, 1.0];
    });
    add("coloured light", &|s| {
        s.light.apply("raking,sky=0.4").unwrap();
        s.light.key_color = [1.0, 0.7, 0.4];
        s.light.sky_color = [0.5, 0.8, 1.0];
    });
    for (name, scene) in variants {
        for mode in [Mode::Slice, Mode::Raycast] {
            let mut s = scene.clone();
            s.render.mode = mode;
            let prepared = Prepared::new(&s, &assets).unwrap();
            assert!(name != "mip" || prepared.volume().blend == Blend::Mip);
            agree(&format!("{name} {mode:?}"), &prepared);
        }
    }
}

/// Rays sample at the same positions as the CPU's: the counts agree except for rounding.
fn counts_agree() {
    let mut scene = scenes::load("tomato-wave-then-peel");
    scene.render.size = [128, 128];
    let assets = scenes::assets(&scene);
    let prepared = Prepared::new(&scene, &assets).unwrap();
    let by_cpu = cpu::render(&prepared).stats.unwrap();
    let by_gpu = with_renderer(|r| r.render(&prepared, true, &Watch::NONE).unwrap())
        .stats
        .unwrap();
    let close = |a: u64, b: u64| a > 0 && (a as f64 - b as f64).abs() <= 0.005 * a as f64;
    assert!(
        close(by_cpu.samples_taken, by_gpu.samples_taken),
        "{by_cpu:?} {by_gpu:?}"
    );
    assert!(
        close(by_cpu.samples_skipped, by_gpu.samples_skipped),
        "{by_cpu:?} {by_gpu:?}"
    );
    assert!(
        close(by_cpu.samples_terminated, by_gpu.samples_terminated),
        "{by_cpu:?} {by_gpu:?}"
    );
    // With compute invocations each pixel is counted once as well, also if a band extends beyond
    // the picture.
    scene.render.size = [700, 397];
    let prepared = Prepared::new(&scene, &assets).unwrap();
    let fragments = with_strategy(
        Strategy {
            compute_rays: false,
            ..PREPARE
        },
        |r| r.render(&prepared, true, &Watch::NONE).unwrap(),
    )
    .stats
    .unwrap();
    let invocations = with_strategy(PREPARE, |r| r.render(&prepared, true, &Watch::NONE).unwrap())
        .stats
        .unwrap();
    let same = |a: u64, b: u64| a > 0 && (a as f64 - b as f64).abs() <= 1e-4 * a as f64;
    assert!(
        same(fragments.samples_taken, invocations.samples_taken),
        "{fragments:?} {invocations:?}"
    );
    assert!(
        same(fragments.samples_skipped, invocations.samples_skipped),
        "{fragments:?} {invocations:?}"
    );
}

/// A stack composed on the device equals the one composed on the CPU: eleven maps, some of them
/// added, in two passes.
fn composition_agrees() {
    let mut scene = Scene::of_volume("phantom:tomato:size=64");
    for n in 0..11 {
        let mut d = Deformation::new(["wave", "twist", "bulge", "spline-pull", "wave"][n % 5]);
        (d.progress, d.resolution, d.rotate) = (
            Some(0.25),
            Some(40),
            Some([15.0 * n as f32, 25.0, 5.0 * n as f32]),
        );
        d.add = n == 2 || n == 3;
        scene.deformation.push(d);
    }
    scene.render.precompose = Some(0.4);
    let assets = scenes::assets(&scene);
    let by_cpu = Prepared::new(&scene, &assets).unwrap();
    let by_gpu = with_renderer(|r| Prepared::with(&scene, &assets, &PrepareOptions::on(r)).unwrap());
    let (a, b) = (&by_cpu.stack, &by_gpu.stack);
    let [of_a, of_b] = [a, b].map(|s| s.precomposed().unwrap().map.map.size);
    assert!(of_a == of_b && a.maps().len() == 11, "{of_a:?} {of_b:?}");
    let (mut far, mut moved) = (0, 0);
    for p in points(5000) {
        let p = (p - 0.5) * 170.0;
        let ((at_cpu, alpha), (at_gpu, beta)) = (a.source_and_alpha(p), b.source_and_alpha(p));
        moved += usize::from(at_cpu.distance(p) > 0.5);
        far += usize::from(at_cpu.distance(at_gpu) > 0.05 || (alpha - beta).abs() > 0.02);
    }
    println!("composed on the device: {far} of 5000 points differ by more than 0.05 mm; {moved} are moved");
    // A point exactly on the face of a map's cube may count as inside or outside.
    assert!(far <= 5 && moved > 1000, "{far} {moved}");
    scene.render.size = [96, 96];
    scene.camera.view = "30,30".parse().unwrap();
    for mode in [Mode::Raycast, Mode::Slice] {
        scene.render.mode = mode;
        agree(
            &format!("composed, {mode:?}"),
            &Prepared::new(&scene, &assets).unwrap(),
        );
    }
}

fn eight_maps_agree() {
    let mut scene = Scene::of_volume("phantom:tomato:size=64");
    scene.render.size = [96, 96];
    scene.camera.view = "30,30".parse().unwrap();
    for kind in ["wave", "twist", "pull", "seam", "knife", "slab", "peel", "book"] {
        scene.deformation.push(Deformation {
            progress: Some(0.4),
            resolution: Some(32),
            ..Deformation::new(kind)
        });
    }
    let assets = scenes::assets(&scene);
    let prepared = Prepared::new(&scene, &assets).unwrap();
    assert_eq!(prepared.stack.maps().len(), 8);
    agree("eight maps", &prepared);
}

/// Strategies other than the device's default give the same picture: also for labels and holes,
/// with both kinds of rays, slices and surfaces.
fn strategies_agree() {
    use incise::scene::surface::Representation;
    let scene = |name: &str, mode: Mode| {
        let mut scene = scenes::load(name);
        (scene.render.mode, scene.render.size, scene.render.antialias) = (mode, [128, 128], Antialias::OFF);
        scene
    };
    let mut in_front = scene("head-with-nuclei", Mode::Raycast);
    in_front.render.jitter = true;
    let mut depth_maps = scene("bunny-twist", Mode::Surface);
    depth_maps.mesh[0].representation = Some(Representation::DepthMapCube);
    let mut wide = scene("head-peel", Mode::Raycast);
    // More than one band of rays, none of them a multiple of the workgroup size.
    wide.render.size = [700, 397];
    let scenes = [
        ("labels", scene("brain-labels", Mode::Raycast)),
        ("labels, slices", scene("brain-labels", Mode::Slice)),
        ("bands", wide),
        ("surfaces behind", in_front),
        ("depth maps", depth_maps),
    ];
    for (name, scene) in scenes {
        let assets = scenes::assets(&scene);
        let prepared = Prepared::new(&scene, &assets).unwrap();
        // Compute first, since results of the fragment path would otherwise remain in the target.
        for compute_rays in [true, false] {
            agree_by(&format!("{name}, compute_rays {compute_rays}"), &prepared, |r| {
                let own = r.set_strategy(Strategy {
                    exact_filter: true,
                    compute_rays,
                    prepare: false,
                });
                let rendered = r.render(&prepared, false, &Watch::NONE);
                r.set_strategy(own);
                rendered
            });
        }
    }
}
