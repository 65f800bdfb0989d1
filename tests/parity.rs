//! GPU against CPU: first values (the shaders' functions at thousands of points), then every scene
//! in both modes.
//!
//! Without an adapter these are reported as ignored; with INCISE_REQUIRE_ADAPTER set, a missing
//! adapter fails.

use crate::contract::points;
use crate::metrics::{STEP, difference};
use crate::scenes;
use glam::Vec3;
use incise::Watch;
use incise::cpu;
use incise::gpu::{AdapterPreference, Device};
use incise::math::Bounds;
use incise::prepare::{PrepareOptions, Prepared};
use incise::render::{Renderer, Strategy};
use incise::scene::{CutFaces, Deformation, IsoLight, Mode, Scene};
use incise::transfer::{Blend, GradientPoint};
use incise::volume::{GradientFilter, VolumeSampler, VoxelGrid, VoxelGridValues};
use libtest_mimic::Trial;
use std::sync::{LazyLock, Mutex};

static RENDERER: LazyLock<Mutex<Result<Renderer, String>>> =
    LazyLock::new(|| Mutex::new(Device::open(AdapterPreference::Any).map(Renderer::new).map_err(|e| e.to_string())));

pub fn with_renderer<T>(work: impl FnOnce(&mut Renderer) -> T) -> T {
    // The renderer stays usable after another test has failed.
    let mut guard = RENDERER.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    work(guard.as_mut().unwrap())
}

/// Whether there is an adapter.
pub fn has_renderer() -> bool {
    RENDERER.lock().unwrap_or_else(std::sync::PoisonError::into_inner).is_ok()
}

pub fn trials() -> Vec<Trial> {
    let required = std::env::var_os("INCISE_REQUIRE_ADAPTER").is_some();
    let missing = RENDERER.lock().unwrap().as_ref().err().cloned();
    let mut all = vec![];
    if required {
        let missing = missing.clone();
        all.push(Trial::test("parity::an_adapter_is_present", move || missing.map_or(Ok(()), |e| Err(e.into()))));
    }
    let gpu = |name: String, test: Box<dyn FnOnce() + Send>| {
        Trial::test(name, move || {
            test();
            Ok(())
        })
        .with_ignored_flag(missing.is_some())
    };
    for file in scenes::files() {
        let name = file.file_stem().unwrap().to_string_lossy().into_owned();
        let own = Scene::load(&file).map_or(Mode::Raycast, |s| s.render.mode);
        let modes: &[Mode] = if own == Mode::Surface { &[Mode::Surface] } else { &[Mode::Slice, Mode::Raycast] };
        for &mode in modes {
            let scene = name.clone();
            all.push(gpu(format!("parity::{name}::{mode:?}").to_lowercase(), Box::new(move || scene_agrees(&scene, mode))));
        }
    }
    for kind in incise::deform::kinds::list() {
        all.push(gpu(format!("parity::numbers::{}", kind.name), Box::new(move || numbers_agree(kind.name))));
    }
    all.push(gpu("parity::options_agree".into(), Box::new(options_agree)));
    all.push(gpu("parity::surface_depths_agree".into(), Box::new(surface_depths_agree)));
    all.push(gpu("parity::surface_options_agree".into(), Box::new(surface_options_agree)));
    all.push(gpu("parity::one_deformation_on_the_gpu".into(), Box::new(one_deformation_on_the_gpu)));
    all.push(gpu("parity::counts_agree".into(), Box::new(counts_agree)));
    all.push(gpu("editing::edits_upload_what_changed".into(), Box::new(crate::editing::edits_upload_what_changed)));
    all.push(gpu("editing::edits_of_surfaces_upload_what_changed".into(), Box::new(crate::editing::edits_of_surfaces_upload_what_changed)));
    all.push(gpu("editing::edits_prepare_what_changed".into(), Box::new(crate::editing::edits_prepare_what_changed)));
    all.push(gpu("editing::segments_and_shifts_agree_between_modes".into(), Box::new(crate::editing::segments_and_shifts_agree_between_modes)));
    all.push(gpu("parity::eight_maps_agree".into(), Box::new(eight_maps_agree)));
    all.push(gpu("parity::composition_agrees".into(), Box::new(composition_agrees)));
    all.push(gpu("composition::many_maps_agree".into(), Box::new(crate::composition::many_maps_agree)));
    all.push(gpu("parity::strategies_agree".into(), Box::new(strategies_agree)));
    all.push(gpu("parity::empty_space_agrees".into(), Box::new(empty_space_agrees)));
    all.push(gpu("parity::voxel_types_agree".into(), Box::new(voxel_types_agree)));
    all.push(gpu("parity::own_colors_agree".into(), Box::new(own_colors_agree)));
    all.push(gpu("parity::larger_than_the_device_is_reduced".into(), Box::new(larger_than_the_device_is_reduced)));
    all
}

/// The strategy of a hardware GPU.
const PREPARE: Strategy = Strategy { exact_filter: true, compute_rays: true, prepare: true };

/// Runs the renderer with a strategy other than its own.
fn with_strategy<T>(strategy: Strategy, work: impl FnOnce(&mut Renderer) -> T) -> T {
    with_renderer(|r| {
        let own = r.set_strategy(strategy);
        let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| work(r)));
        r.set_strategy(own);
        done.unwrap_or_else(|e| std::panic::resume_unwind(e))
    })
}

fn agree(what: &str, prepared: &Prepared) {
    agree_by(what, prepared, |r| r.render(prepared, false, &Watch::NONE));
}

fn agree_by(what: &str, prepared: &Prepared, render: impl FnOnce(&mut Renderer) -> incise::Result<incise::picture::Rendered>) {
    let by_cpu = cpu::render(prepared).picture;
    let by_gpu = with_renderer(|r| render(r).unwrap_or_else(|e| panic!("{what}: {e}"))).picture;
    let d = difference(&by_cpu, &by_gpu).unwrap_or_else(|e| panic!("{what}: {e}"));
    println!("{what}: mean {:.4}/255, max {:.2}/255, within 4/255: {:.4} %", d.mean / STEP, d.max / STEP, 100.0 * d.within_4);
    assert!(d.mean <= 0.5 * STEP && d.within_4 >= 0.999, "{what}: mean {}/255, {} % within 4/255", d.mean / STEP, 100.0 * d.within_4);
}

fn scene_agrees(name: &str, mode: Mode) {
    let mut scene = scenes::load(name);
    scene.render.mode = mode;
    scene.render.size = [192, 192];
    scene.render.antialias = 1;
    let assets = scenes::assets(&scene);
    agree(&format!("{name} {mode:?}"), &Prepared::new(&scene, &assets).unwrap());
}

/// Source point, mask, Jacobian, cut, value, opacity and gradient computed by the shaders equal the
/// CPU's, in a rotated, anisotropic placement.
fn numbers_agree(kind: &str) {
    let mut scene = Scene::of_volume("phantom:head-ct:size=48");
    let mut deformation = Deformation::new(kind);
    deformation.rotate = Some([20.0, -30.0, 40.0]);
    deformation.center = Some([4.0, 6.0, -8.0]);
    deformation.parameters = incise::deform::kinds::kind(kind).unwrap().example(&Bounds::new(Vec3::splat(-60.0), Vec3::splat(60.0)));
    scene.deformation.push(deformation);
    scene.render.exact_cuts = false;
    let assets = scenes::assets(&scene);
    let prepared = Prepared::new(&scene, &assets).unwrap();
    numbers_of(kind, &prepared, &assets);
    // Again with the map sampled on the device: its texels against those sampled on the CPU.
    let by_cpu = prepared.stack.maps()[0].map.extent();
    let again = scenes::assets(&scene);
    let prepared = with_strategy(PREPARE, |r| Prepared::with(&scene, &again, &PrepareOptions::on(r)).unwrap());
    let map = &prepared.stack.maps()[0].map;
    let formula = matches!(incise::deform::kinds::kind(kind).unwrap().build, incise::deform::kinds::FieldBuilder::Formula(_));
    assert_eq!(map.definition().is_some(), formula, "{kind}");
    let by_device = map.extent();
    let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 2e-3 * (1.0 + a.abs()));
    assert!(near(&by_cpu.texels.min, &by_device.texels.min) && near(&by_cpu.texels.max, &by_device.texels.max), "{kind}: {by_cpu:?} {by_device:?}");
    // Slopes amplify the rounding of a texel by the number of texels.
    let steep = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 0.02 * (1.0 + a.abs()) + 0.1);
    assert!(steep(&by_cpu.slopes.min, &by_device.slopes.min) && steep(&by_cpu.slopes.max, &by_device.slopes.max), "{kind}: {by_cpu:?} {by_device:?}");
    numbers_of(kind, &prepared, &again);
}

fn numbers_of(kind: &str, prepared: &Prepared, assets: &incise::prepare::Assets) {
    let at: Vec<[f32; 3]> = points(10_000).map(|x| ((x - 0.5) * 150.0).to_array()).collect();
    let probes = with_strategy(PREPARE, |r| r.probe(prepared, &at).unwrap());
    assert_eq!(probes.len(), at.len());
    let VoxelGridValues::I16(voxels) = &assets.grid().voxels else { panic!() };
    let sampler = VolumeSampler::new(assets.grid(), voxels);
    let (mut worst, mut moved) = ([0.0f32; 5], 0);
    for (p, probe) in at.iter().zip(&probes) {
        let p = Vec3::from(*p);
        let jet = prepared.stack.jet(p);
        let in_voxel = prepared.volume().voxel_from_world.transform_point3(jet.source);
        let value = sampler.sample(in_voxel);
        let gradient = sampler.gradient(in_voxel, GradientFilter::Central);
        let v = |n: usize| Vec3::new(probe[n], probe[n + 1], probe[n + 2]);
        moved += usize::from(jet.source.distance(p) > 1.0 || jet.alpha < 1.0);
        let j = jet.d_source_d_deformed;
        let jacobian = [(4, j.x_axis), (8, j.y_axis), (12, j.z_axis)].map(|(n, c)| (v(n) - c).length()).into_iter().fold(0.0, f32::max);
        if v(0).distance(jet.source) > 0.05 {
            println!("{kind} at {p}: off by {} mm, mask {}, displaced by {} mm, J {j}", v(0).distance(jet.source), jet.alpha, jet.source.distance(p));
        }
        let steep = 1.0 + j.x_axis.length().max(j.y_axis.length()).max(j.z_axis.length());
        for (w, e) in worst.iter_mut().zip([
            v(0).distance(jet.source),
            (probe[3] - jet.alpha).abs(),
            jacobian / steep,
            (probe[11] - value).abs(),
            (v(19) - gradient).length(),
        ]) {
            *w = w.max(e);
        }
    }
    assert!(moved > 100, "{kind} touched only {moved} points");
    let bound = [0.05, 0.01, 0.02, 0.01, 0.02];
    assert!(worst.iter().zip(bound).all(|(w, b)| *w <= b), "{kind}: {worst:?} against {bound:?}");
}

/// All options that change the shaders.
fn options_agree() {
    let mut base = Scene::of_volume("phantom:head-ct:size=64");
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
    add("orthographic", &|s| s.camera.projection = incise::scene::Projection::Orthographic);
    add("sobel", &|s| s.render.gradient = GradientFilter::Sobel);
    add("one-sided", &|s| s.light.two_sided = false);
    add("normals none", &|s| s.render.normals = incise::scene::Normals::None);
    add("normals source", &|s| s.render.normals = incise::scene::Normals::Source);
    add("normals transformed", &|s| s.render.normals = incise::scene::Normals::Transformed);
    add("soft", &|s| s.transfer.preset = Some("ct-bones-and-muscle".into()));
    add("gradient opacity", &|s| {
        s.transfer.gradient_opacity = vec![GradientPoint { magnitude: 0.0, factor: 0.0 }, GradientPoint { magnitude: 300.0, factor: 1.0 }];
    });
    add("mip", &|s| s.transfer.preset = Some("ct-mip".into()));
    add("minip", &|s| s.transfer.preset = Some("ct-minip".into()));
    add("average", &|s| s.transfer.preset = Some("ct-xray".into()));
    add("step 0.5", &|s| s.render.step = 0.5);
    add("jitter", &|s| s.render.jitter = true);
    add("preintegrated", &|s| {
        s.render.preintegrated = true;
        s.transfer.preset = Some("ct-bones-and-muscle".into());
    });
    add("preintegrated, step 2, jitter", &|s| {
        (s.render.preintegrated, s.render.jitter, s.render.step) = (true, true, 2.0);
    });
    let cut = |kind: &str, center: [f32; 3], settings: &[(&str, &str)]| {
        let mut d = Deformation::new(kind);
        d.center = Some(center);
        settings.iter().for_each(|(name, value)| d.parameters.insert(*name, *value));
        d
    };
    // Every shape, a group and an inversion, after a displacing map.
    let cuts = [
        cut("half-space", [0.0, 0.0, 30.0], &[("group", "a"), ("combine", "and")]),
        Deformation { rotate: Some([0.0, 70.0, 0.0]), ..cut("half-space", [10.0, 0.0, 0.0], &[("group", "a")]) },
        cut("sphere", [40.0, -50.0, 10.0], &[]),
        cut("box", [-40.0, -50.0, -10.0], &[]),
        cut("wedge", [0.0, 40.0, 0.0], &[]),
        cut("cylinder", [0.0, -60.0, 0.0], &[("invert", "false")]),
        cut("view-cone", [0.0, -20.0, 20.0], &[]),
        Deformation { size: Some(incise::scene::Size::Cube(170.0)), ..cut("sphere", [0.0; 3], &[("invert", "true")]) },
    ];
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
    let by_gpu = with_renderer(|r| r.render(&prepared, true, &Watch::NONE).unwrap()).stats.unwrap();
    let close = |a: u64, b: u64| a > 0 && (a as f64 - b as f64).abs() <= 0.005 * a as f64;
    assert!(close(by_cpu.samples_taken, by_gpu.samples_taken), "{by_cpu:?} {by_gpu:?}");
    assert!(close(by_cpu.samples_skipped, by_gpu.samples_skipped), "{by_cpu:?} {by_gpu:?}");
    assert!(close(by_cpu.samples_terminated, by_gpu.samples_terminated), "{by_cpu:?} {by_gpu:?}");
    // With compute invocations each pixel is counted once as well, also if a band extends beyond
    // the picture.
    scene.render.size = [700, 397];
    let prepared = Prepared::new(&scene, &assets).unwrap();
    let fragments = with_strategy(Strategy { compute_rays: false, ..PREPARE }, |r| r.render(&prepared, true, &Watch::NONE).unwrap()).stats.unwrap();
    let invocations = with_strategy(PREPARE, |r| r.render(&prepared, true, &Watch::NONE).unwrap()).stats.unwrap();
    let same = |a: u64, b: u64| a > 0 && (a as f64 - b as f64).abs() <= 1e-4 * a as f64;
    assert!(same(fragments.samples_taken, invocations.samples_taken), "{fragments:?} {invocations:?}");
    assert!(same(fragments.samples_skipped, invocations.samples_skipped), "{fragments:?} {invocations:?}");
}

/// A stack composed on the device equals the one composed on the CPU: eleven maps, some of them
/// added, in two passes.
fn composition_agrees() {
    let mut scene = Scene::of_volume("phantom:tomato:size=64");
    for n in 0..11 {
        let mut d = Deformation::new(["wave", "twist", "bulge", "spline-pull", "wave"][n % 5]);
        (d.progress, d.resolution, d.rotate) = (Some(0.25), Some(40), Some([15.0 * n as f32, 25.0, 5.0 * n as f32]));
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
        agree(&format!("composed, {mode:?}"), &Prepared::new(&scene, &assets).unwrap());
    }
}

fn eight_maps_agree() {
    let mut scene = Scene::of_volume("phantom:tomato:size=64");
    scene.render.size = [96, 96];
    scene.camera.view = "30,30".parse().unwrap();
    for kind in ["wave", "twist", "pull", "seam", "knife", "slab", "peel", "book"] {
        scene.deformation.push(Deformation { progress: Some(0.4), resolution: Some(32), ..Deformation::new(kind) });
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
        (scene.render.mode, scene.render.size, scene.render.antialias) = (mode, [128, 128], 1);
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
                let own = r.set_strategy(Strategy { exact_filter: true, compute_rays, prepare: false });
                let rendered = r.render(&prepared, false, &Watch::NONE);
                r.set_strategy(own);
                rendered
            });
        }
    }
}

/// Points of cells marked empty are transparent; at points of cells marked clear no mask has an
/// effect.
fn empty_is_empty(name: &str, prepared: &Prepared) {
    let cells = &prepared.volume().macrocells;
    let grid = prepared.volume().grid;
    // Cells are marked clear with respect to the maps' masks only.
    let maps = incise::deform::Stack::new(prepared.stack.maps().to_vec());
    let depth_at = |p: Vec3| -> f32 {
        let (source, alpha) = prepared.stack.source_and_alpha(p);
        let at = prepared.volume().voxel_from_world.transform_point3(source);
        let top = Vec3::from(grid.size.map(|n| n as f32)) - 0.5;
        if alpha < 0.5 || prepared.cuts.signed_distance_mm(p) < 0.0 || at.cmplt(Vec3::splat(-0.5)).any() || at.cmpgt(top).any() {
            return 0.0;
        }
        let value = match &grid.voxels {
            VoxelGridValues::U8(v) => VolumeSampler::new(grid, v).sample(at),
            VoxelGridValues::U16(v) => VolumeSampler::new(grid, v).sample(at),
            VoxelGridValues::I16(v) => VolumeSampler::new(grid, v).sample(at),
            VoxelGridValues::F32(v) => VolumeSampler::new(grid, v).sample(at),
        };
        match prepared.volume().iso {
            _ if prepared.volume().blend != Blend::Composite => 1.0,
            Some(iso) => f32::from(u8::from(value >= iso)),
            None => prepared.volume().table.lookup(value)[3],
        }
    };
    for n in 0..cells.distance.len() {
        let b = cells.cell_box(n);
        for corner in 0..9 {
            let share = if corner == 8 { Vec3::splat(0.5) } else { Vec3::new((corner & 1) as f32, (corner >> 1 & 1) as f32, (corner >> 2) as f32) };
            let p = b.min + b.size() * share;
            if !cells.is_occupied(n) {
                assert!(depth_at(p) < 1e-5, "{name}: something shows at {p}, in an empty cell: {}", depth_at(p));
            } else if cells.distance[n] == 255 {
                let jet = maps.jet(p);
                assert!(jet.alpha == 1.0 && jet.cut.distance_mm == f32::INFINITY, "{name}: a cut at {p}, in a clear cell: {:?}", jet.cut);
            }
        }
    }
}

/// Empty space found by the device matches the CPU's: no visible cell is skipped, and few empty
/// ones are kept; for maps sampled on the device and others, every kind of shape, and all settings
/// that determine visibility.
fn empty_space_agrees() {
    let small = |name: &str, change: &dyn Fn(&mut Scene)| {
        let mut scene = scenes::load(name);
        (scene.render.size, scene.render.antialias) = ([128, 128], 1);
        change(&mut scene);
        (name.to_owned(), scene)
    };
    let mut many = Scene::of_volume("phantom:tomato:size=64");
    for (n, kind) in ["wave", "twist", "pull", "seam", "slab", "peel"].into_iter().enumerate() {
        let d = Deformation {
            progress: Some(0.4),
            resolution: Some(32),
            add: n == 2,
            rotate: Some([15.0 * n as f32, 5.0, 0.0]),
            ..Deformation::new(kind)
        };
        many.deformation.push(d);
    }
    let mut composed = Scene::of_volume("phantom:tomato:size=64");
    for (n, kind) in ["wave", "twist", "bulge", "spline-pull", "wave"].into_iter().enumerate() {
        let d = Deformation { progress: Some(0.25), rotate: Some([15.0 * n as f32, 25.0, 0.0]), ..Deformation::new(kind) };
        composed.deformation.push(d);
    }
    composed.render.precompose = Some(4.0);
    let mut shapes = Scene::of_volume("phantom:head-ct:size=64");
    shapes.deformation = ["twist", "sphere", "box", "wedge", "cylinder"].map(Deformation::new).to_vec();
    shapes.deformation[1].center = Some([40.0, -50.0, 10.0]);
    let mut scenes = vec![
        small("head-peel", &|_| ()),
        small("head-slabs", &|_| ()),
        small("head-grey-cuts", &|_| ()),
        small("head-surface-peel", &|_| ()),
        small("head-iso", &|_| ()),
        small("tomato-peel-then-wave", &|s| s.transfer.preset = Some("ct-mip".into())),
        small("teddy-seam", &|s| s.render.preintegrated = true),
        small("brain-labels", &|_| ()),
        ("six maps".to_owned(), many),
        ("composed".to_owned(), composed),
        ("shapes".to_owned(), shapes),
    ];
    for (name, scene) in &mut scenes {
        scene.render.size = [128, 128];
        let assets = scenes::assets(scene);
        let by_cpu = Prepared::new(scene, &assets).unwrap();
        let again = scenes::assets(scene);
        let by_device = with_strategy(PREPARE, |r| Prepared::with(scene, &again, &PrepareOptions::on(r)).unwrap());
        let (a, b) = (&by_cpu.volume().macrocells, &by_device.volume().macrocells);
        assert_eq!(a.size, b.size, "{name}");
        let clear = |d: u8| d == 255;
        let (mut both, mut more, mut lost, mut clear_in_both, mut also_clear) = (0, 0, 0, 0, 0);
        for (n, (&c, &d)) in a.distance.iter().zip(&b.distance).enumerate() {
            let (shown, kept) = (a.is_occupied(n), b.is_occupied(n));
            both += usize::from(shown && kept);
            more += usize::from(!shown && kept);
            lost += usize::from(shown && !kept);
            clear_in_both += usize::from(clear(c) && clear(d));
            also_clear += usize::from(clear(d) && shown && !clear(c));
        }
        let clear_in_cpus = a.distance.iter().filter(|d| clear(**d)).count();
        println!("{name}: {both} cells in both, {more} more, {lost} lost; clear {clear_in_both} of {clear_in_cpus}, {also_clear} more");
        // CPU and device merge boxes of texels differently, and split boxes at the faces of a cube
        // differently; the difference is largest for six maps.
        assert!(both > 500 && lost * 50 <= both && more * 4 <= both, "{name}: {both} {more} {lost}");
        assert!(also_clear * 20 <= both && clear_in_both * 10 >= clear_in_cpus * 9, "{name}: {clear_in_both} of {clear_in_cpus}, {also_clear}");
        empty_is_empty(name, &by_device);
        agree(&format!("{name}, prepared by the device"), &by_device);
        // Skipped cells would have been transparent.
        let picture = |prepared: &Prepared| with_strategy(PREPARE, |r| r.render(prepared, false, &Watch::NONE).unwrap()).picture;
        let skipping = picture(&by_device);
        scene.render.empty_space_skipping = false;
        let whole = with_strategy(PREPARE, |r| Prepared::with(scene, &again, &PrepareOptions::on(r)).unwrap());
        let d = difference(&skipping, &picture(&whole)).unwrap();
        println!("{name}: skipping changes mean {:.5}/255, max {:.3}/255", d.mean / STEP, d.max / STEP);
        assert!(d.max <= 0.51 * STEP, "{name}: skipping changes the picture by {}/255", d.max / STEP);
    }
}

fn voxel_types_agree() {
    use incise::volume::{Rescale, StoredValues, Volume, Voxels, phantom};
    let phantom = phantom::generate("tomato", [48; 3], Vec3::splat(160.0 / 48.0)).unwrap();
    let values: Vec<f64> = (0..phantom.voxels.len()).map(|n| phantom.voxels.get(n)).collect();
    let types: [StoredValues; 5] = [
        values.iter().map(|v| *v as u8).collect::<Vec<_>>().into(),
        values.iter().map(|v| (*v * 100.0) as u16).collect::<Vec<_>>().into(),
        values.iter().map(|v| (*v * 100.0 - 9000.0) as i16).collect::<Vec<_>>().into(),
        values.iter().map(|v| if *v == 254.0 { f32::NAN } else { *v as f32 }).collect::<Vec<_>>().into(),
        values.clone().into(),
    ];
    for voxels in types {
        let name = voxels.type_name();
        let volume = Volume::new(Voxels::new(phantom.size, voxels), Rescale::NONE, phantom.world_from_voxel);
        let mut scene = Scene::of_volume("phantom:tomato");
        scene.render.size = [96, 96];
        let factor = (volume.range[1] - volume.range[0]) / 205.0;
        scene.transfer.window = Some(200.0 * factor);
        scene.transfer.level = Some(140.0 * factor + volume.range[0] - 50.0 * factor);
        let assets = incise::prepare::Assets::of_volume(volume);
        assert!(VoxelGrid::new(&assets.volume).size == [48; 3]);
        agree(name, &Prepared::new(&scene, &assets).unwrap());
    }
}

/// Voxels with their own colours, opaque and not, undeformed and twisted, by rays and by slices;
/// and with the transfer function's colours if requested.
fn own_colors_agree() {
    use incise::volume::{Colors, phantom};
    let phantom = phantom::generate("tomato", [48; 3], Vec3::splat(160.0 / 48.0)).unwrap();
    let count = phantom.voxels.len();
    let color = |n: usize| [(n % 48 * 5) as u8, (n / 48 % 48 * 5) as u8, 255 - (n / 2304 * 5) as u8];
    let rgb: Vec<u8> = (0..count).flat_map(color).collect();
    let weight = |n: usize| if n.is_multiple_of(5) { 0 } else { 200u8 };
    let premultiplied = |n: usize| color(n).map(|c| (u32::from(c) * u32::from(weight(n)) / 255) as u8);
    let rgba: Vec<u8> = (0..count).flat_map(|n| [premultiplied(n)[0], premultiplied(n)[1], premultiplied(n)[2], weight(n)]).collect();
    for (name, colors) in [("RGB", Colors::rgb(rgb)), ("RGBA", Colors::Rgba(rgba.into()))] {
        let mut volume = phantom.clone();
        volume.colors = Some(colors);
        let assets = incise::prepare::Assets::of_volume(volume);
        let mut scene = Scene::of_volume("phantom:tomato");
        scene.render.size = [96, 96];
        scene.deformation.push(Deformation::new("twist"));
        for mode in [Mode::Raycast, Mode::Slice] {
            scene.render.mode = mode;
            agree(&format!("{name} {mode:?}"), &Prepared::new(&scene, &assets).unwrap());
        }
        let own = cpu::render(&Prepared::new(&scene, &assets).unwrap()).picture;
        scene.transfer.own_colors = Some(false);
        let table = cpu::render(&Prepared::new(&scene, &assets).unwrap()).picture;
        assert!(difference(&own, &table).unwrap().mean > 5.0 * STEP, "{name}: colours show");
    }
}

/// A volume too large for the device is shown reduced, with a notice: never black, never refused.
fn larger_than_the_device_is_reduced() {
    use incise::volume::{Rescale, Volume, Voxels};
    let most = with_renderer(|r| r.device().device.limits().max_texture_dimension_3d) as usize;
    let volume = Volume::new(Voxels::new([most + 1, 900, 1], vec![200u8; (most + 1) * 900]), Rescale::NONE, glam::DAffine3::IDENTITY);
    let assets = incise::prepare::Assets::of_volume(volume);
    let mut scene = Scene::of_volume("phantom:ball");
    scene.render.size = [64, 64];
    scene.camera.view = "superior".parse().unwrap();
    scene.transfer.points = vec![incise::transfer::ControlPoint { value: 0.0, color: [1.0; 3], opacity: 1.0 }];
    let done = with_renderer(|r| r.render(&Prepared::new(&scene, &assets).unwrap(), false, &Watch::NONE)).unwrap();
    assert!(
        done.notices[0].contains("exceeds this GPU") && done.notices[0].contains(&format!("{} x 900 x 1", (most + 1).div_ceil(2))),
        "{:?}",
        done.notices
    );
    assert!(done.picture.pixels.iter().any(|p| p[3] > 0.5));
    // Coloured labels and a scan, with a cut: the reduced picture is close to the full one.
    for (spec, bound) in [("phantom:head-ct:size=64", 4.0), ("volumes/colin27-aal-labels.nii.gz", 9.0)] {
        let mut scene = Scene::of_volume(spec);
        scene.folder = env!("CARGO_MANIFEST_DIR").into();
        scene.render.size = [128, 128];
        scene.deformation.push(Deformation::new("box"));
        let assets = scenes::assets(&scene);
        let prepared = Prepared::new(&scene, &assets).unwrap();
        let whole = with_renderer(|r| r.render(&prepared, false, &Watch::NONE)).unwrap();
        let reduced = with_renderer(|r| {
            r.limit_volume(if spec.starts_with("phantom") { 40 } else { 110 }, u64::MAX);
            let done = r.render(&prepared, false, &Watch::NONE);
            r.limit_volume(usize::MAX, u64::MAX);
            done.unwrap()
        });
        assert!(whole.notices.is_empty() && reduced.notices.len() == 1, "{spec}");
        let d = difference(&whole.picture, &reduced.picture).unwrap();
        println!("{spec} by half the voxels: mean {:.2}/255", d.mean / STEP);
        assert!(d.mean < bound * STEP && d.mean > 0.01 * STEP, "{spec}: {}", d.mean / STEP);
    }
}

/// Surface depths: within a thousandth of the box of the CPU's where both hit.
fn surface_depths_agree() {
    for name in ["bunny-twist", "bunny-two-stage", "bunny-deformers", "apple-hollow", "apple-thick", "apple-solid", "gyroid", "head-skin-peel"] {
        let mut scene = scenes::load(name);
        scene.render.size = [192, 192];
        scene.render.antialias = 1;
        let assets = scenes::assets(&scene);
        let prepared = Prepared::new(&scene, &assets).unwrap();
        let by_gpu = with_renderer(|r| r.surface_distances(&prepared).unwrap_or_else(|e| panic!("{name}: {e}")));
        let bound = 1e-3 * assets.scene_box().size().length();
        let (mut off, mut seen, mut worst) = (0, 0, 0.0f32);
        for (n, &t) in by_gpu.iter().enumerate() {
            let (u, v) = (((n % 192) as f32 + 0.5) / 96.0 - 1.0, 1.0 - ((n / 192) as f32 + 0.5) / 96.0);
            let (o, d) = prepared.frame.view.ray(u, v);
            let want = cpu::surface::nearest(&prepared, o, d, &mut 0).map_or(f32::INFINITY, |h| h.t);
            seen += usize::from(want.is_finite());
            if (t - want).abs() > bound || t.is_finite() != want.is_finite() {
                off += 1;
            } else if t.is_finite() {
                worst = worst.max((t - want).abs());
            }
        }
        println!("{name}: {seen} pixels, {off} beyond {bound:.3} mm (silhouettes and edges), the others within {worst:.4} mm");
        // A ray that grazes an edge may hit on one backend and miss on the other.
        assert!(seen > 2000 && off * 500 < seen, "{name}: {off} of {seen}");
    }
}

/// All step methods, solids, deformers, and projections; slices in front of surfaces.
fn surface_options_agree() {
    use incise::mesh::deformer::NormalMethod;
    use incise::scene::surface::{DeformerSource, Representation, Steps};
    let small = |name: &str| {
        let mut scene = scenes::load(name);
        scene.render.size = [128, 128];
        scene.render.antialias = 1;
        scene
    };
    let check = |what: &str, scene: &Scene| {
        let assets = scenes::assets(scene);
        agree(what, &Prepared::new(scene, &assets).unwrap());
    };
    for steps in [Steps::Uniform, Steps::Threshold, Steps::Jacobian, Steps::Sphere] {
        let mut scene = small("bunny-twist");
        scene.surface.steps = steps;
        check(&format!("{steps:?} steps"), &scene);
    }
    let mut averaged = small("gyroid");
    averaged.render.antialias = 3;
    check("averaged pixels", &averaged);
    for representation in [Representation::DepthMap, Representation::DepthMapCube] {
        let mut scene = small("bunny-twist");
        scene.mesh[0].representation = Some(representation);
        scene.mesh[0].face = Some("-y".into());
        check(&format!("{representation:?}"), &scene);
    }
    let numbers = |kind: &str| -> Vec<(&str, f32)> {
        match kind {
            "twist" | "bend" => vec![("angle", 50.0)],
            "taper" => vec![("factor", 0.5)],
            "shear" => vec![("amount", 0.4)],
            "bulge" => vec![("amount", 0.4), ("width", 20.0)],
            "wave" => vec![("amplitude", 4.0), ("length", 25.0), ("phase", 30.0)],
            _ => vec![],
        }
    };
    for (kind, _, _) in incise::scene::surface::DEFORMERS {
        for normals in [NormalMethod::InverseTranspose, NormalMethod::Tangent, NormalMethod::Numeric] {
            let mut scene = small("bunny-deformers");
            scene.mesh[0].normals = normals;
            scene.mesh[0].deformer = vec![DeformerSource {
                kind: kind.into(),
                center: None,
                size: None,
                rotate: Some([0.0, 30.0, 10.0]),
                progress: Some(0.9),
                points: if kind == "lattice" { vec![[1.0, 1.0, 3.0, 10.0, 5.0, 30.0], [3.0, 2.0, 0.0, -5.0, 20.0, 0.0]] } else { vec![] },
                numbers: numbers(kind).into_iter().map(|(n, v)| (n.to_owned(), v)).collect(),
            }];
            check(&format!("{kind}, normals {normals:?}"), &scene);
        }
    }
    for blend in [Blend::Mip, Blend::Average] {
        for mode in [Mode::Slice, Mode::Raycast] {
            let mut scene = small("head-with-nuclei");
            scene.transfer.blend = Some(blend);
            scene.render.mode = mode;
            check(&format!("{blend:?} before surfaces, {mode:?}"), &scene);
        }
    }
}

/// Slices, rays and surface rays on the device: the silhouettes of a solid ball under one
/// deformation agree with the CPU's surface to within a pixel.
fn one_deformation_on_the_gpu() {
    crate::surfaces::three_silhouettes(&|prepared| with_renderer(|r| r.render(prepared, false, &Watch::NONE).unwrap()).picture);
}
