//! Slices against rays: two renderers that share what a sample is and nothing else.

use crate::closed_forms::picture;
use crate::metrics::{STEP, difference};
use crate::scenes::{assets, load};
use incise::prepare::{Assets, Prepared};
use incise::scene::surface::Steps;
use incise::scene::{Antialias, BlendFormat, Mode, Projection, Scene, SliceOrder};

/// Scenes with maps, cuts, holes and both kinds of volumes.
const SCENES: [&str; 6] = [
    "head-peel",
    "head-quadrant",
    "head-lift",
    "head-slabs",
    "teddy-seam",
    "tomato-slices-2",
];

/// A scene without the end at opaque pixels, which only rays have.
fn without_early_end(name: &str) -> (Scene, Assets) {
    let mut scene = load(name);
    scene.render.size = [160, 160];
    scene.render.antialias = Antialias::OFF;
    scene.render.early_termination = false;
    let assets = assets(&scene);
    (scene, assets)
}

/// In an orthographic view slices and rays take the same samples: their pictures agree to rounding
/// at every step.
pub fn slices_equal_rays_in_orthographic_views() {
    for name in SCENES {
        let (mut scene, assets) = without_early_end(name);
        scene.camera.projection = Projection::Orthographic;
        for step in [2.0, 1.0, 0.5] {
            scene.render.step = step;
            let [slices, rays] = [Mode::Slice, Mode::Raycast].map(|mode| {
                scene.render.mode = mode;
                picture(&Prepared::new(&scene, &assets).unwrap())
            });
            let d = difference(&slices, &rays).unwrap();
            println!("{name}, step {step}: mean {:.5}/255", d.mean / STEP);
            assert!(d.mean <= 0.05 * STEP, "{name}, step {step}: {d:?}");
        }
    }
}

/// In perspective slices and rays take different samples of the same integral: their difference
/// falls by at least 1.7 with every halving of the step, until it is below 0.05/255.
pub fn slices_approach_rays() {
    for name in SCENES {
        let (mut scene, assets) = without_early_end(name);
        assert_eq!(scene.camera.projection, Projection::Perspective);
        let means = [1.0, 0.5, 0.25, 0.125].map(|step| {
            scene.render.step = step;
            let [slices, rays] = [Mode::Slice, Mode::Raycast].map(|mode| {
                scene.render.mode = mode;
                picture(&Prepared::new(&scene, &assets).unwrap())
            });
            difference(&slices, &rays).unwrap().mean / STEP
        });
        println!("{name}: slices against rays at steps 1, 1/2, 1/4, 1/8: {means:.4?}/255");
        assert!(means[0] > 0.05, "{name}: the scene is no test");
        for pair in means.windows(2).filter(|pair| pair[0] > 0.05) {
            assert!(pair[1] <= 0.05 || pair[0] >= 1.7 * pair[1], "{name}: {means:.4?}");
        }
        assert!(means[3] <= 0.05, "{name}: {means:.4?}");
    }
}

/// Slices sample surfaces as objects of the scene: distance fields of meshes, formulas and labels,
/// hollow, thick or solid, alone or in a volume. In an orthographic view that is what rays find with
/// even steps.
pub fn slices_show_surfaces() {
    for name in [
        "gyroid",
        "bunny-twist",
        "apple-hollow",
        "apple-thick",
        "apple-solid",
        "head-with-nuclei",
    ] {
        let (mut scene, assets) = without_early_end(name);
        scene.camera.projection = Projection::Orthographic;
        scene.surface.steps = Steps::Uniform;
        let has_volume = scene.volume.is_some() && scene.render.mode != Mode::Surface;
        let others = if has_volume { Mode::Raycast } else { Mode::Surface };
        if !has_volume {
            // A surface of the volume is not shown in the volume's own modes.
            scene.volume = None;
        }
        let [slices, rays] = [Mode::Slice, others].map(|mode| {
            scene.render.mode = mode;
            let prepared = Prepared::new(&scene, &assets).unwrap();
            assert_eq!(
                prepared.sliced_surfaces().count() > 0,
                mode == Mode::Slice,
                "{name}"
            );
            picture(&prepared)
        });
        let d = difference(&slices, &rays).unwrap();
        println!(
            "{name}: slices against rays mean {:.4}/255, max {:.2}/255",
            d.mean / STEP,
            d.max / STEP
        );
        assert!(d.mean <= 0.05 * STEP && d.within_4 >= 0.999, "{name}: {d:?}");
    }
}

/// A scene of text, seen along -y without perspective.
fn orthographic(text: &str) -> (Scene, Assets) {
    let mut scene = Scene::from_toml(&format!("incise = 1\n{text}")).unwrap();
    scene.camera.projection = Projection::Orthographic;
    scene.render.early_termination = false;
    let assets = Assets::load(&scene).unwrap();
    (scene, assets)
}

/// Slices show surfaces where the volume is empty, and their far walls.
pub fn slices_show_whole_surfaces() {
    let beside = "[volume]\npath = 'phantom:ball:size=64'\n\
        [[mesh]]\nshape = [{ kind = 'sphere', radius = 5.0, center = [50.0, -70.0, 50.0] }]\n\
        [render]\nsize = [512, 512]\n";
    let opened = "[[mesh]]\nshape = [{ kind = 'sphere', radius = 20.0 }]\nmodel = 'hollow'\n\
        [[deformation]]\nkind = 'box'\ncenter = [0.0, -20.0, 0.0]\nsize = [20.0, 20.0, 20.0]\n\
        [render]\nsize = [200, 200]\n";
    // Rays find the ball at steps of its own, finer than the slices': the rims differ.
    for (name, text, others, rims) in [
        ("a ball beside a volume", beside, Mode::Raycast, 60),
        ("an opened shell", opened, Mode::Surface, 0),
    ] {
        let (mut scene, assets) = orthographic(text);
        scene.surface.steps = Steps::Uniform;
        let steps: &[f32] = if rims > 0 { &[0.5, 1.0] } else { &[1.0, 2.0, 8.0] };
        for &step in steps {
            scene.render.step = step;
            let [slices, rays] = [Mode::Slice, others].map(|mode| {
                scene.render.mode = mode;
                picture(&Prepared::new(&scene, &assets).unwrap())
            });
            let hidden = |a: &[f32; 4], b: &[f32; 4]| (a[3] > 0.5) != (b[3] > 0.5);
            let apart = slices
                .pixels
                .iter()
                .zip(&rays.pixels)
                .filter(|(a, b)| hidden(a, b));
            assert!(apart.count() <= rims, "{name}, step {step}");
            let d = difference(&slices, &rays).unwrap();
            println!("{name}, step {step}: mean {:.4}/255", d.mean / STEP);
            assert!(d.mean <= 0.05 * STEP || rims > 0, "{name}, step {step}: {d:?}");
        }
    }
}

/// Nothing behind the eye is shown, by slices or by rays.
pub fn nothing_is_seen_behind_the_eye() {
    let mut scene = Scene::from_toml(
        "incise = 1\n[[mesh]]\nshape = [{ kind = 'sphere', radius = 20.0 }]\nmodel = 'hollow'\n\
         [camera]\nview = 'anterior'\n[render]\nsize = [33, 33]\nstep = 4.0\n",
    )
    .unwrap();
    let assets = Assets::load(&scene).unwrap();
    // The eye moves through the far wall, a quarter of a step at a time.
    let eye = |scene: &Scene| Prepared::new(scene, &assets).unwrap().frame.view.eye.y;
    let offset = eye(&scene);
    let mut seen = 0;
    for n in 0..80 {
        let y = 16.0 + 0.1 * n as f32;
        scene.camera.target = Some([0.0, y - offset, 0.0]);
        for (mode, steps) in [
            (Mode::Surface, Steps::Uniform),
            (Mode::Surface, Steps::Jacobian),
            (Mode::Surface, Steps::Sphere),
            (Mode::Slice, Steps::Uniform),
        ] {
            scene.render.mode = mode;
            scene.surface.steps = steps;
            let prepared = Prepared::new(&scene, &assets).unwrap();
            let at = prepared.frame.view.eye.y;
            let shown = picture(&prepared).pixels[16 * 33 + 16][3] > 0.5;
            seen += usize::from(shown);
            assert!(
                (at - 20.0).abs() < 0.02 || shown == (at < 20.0),
                "{mode:?} {steps:?}, eye at {at}"
            );
        }
    }
    assert!((20..300).contains(&seen), "{seen}");
}

/// Slabs and drawing from front to back change a picture by rounding, and by what an early end
/// leaves out; blending in 16 bits by its rounding.
pub fn options_of_slices_are_bounded() {
    let (scene, assets) = without_early_end("head-peel");
    let with = |change: &dyn Fn(&mut Scene)| {
        let mut scene = scene.clone();
        scene.render.mode = Mode::Slice;
        change(&mut scene);
        picture(&Prepared::new(&scene, &assets).unwrap())
    };
    let plain = with(&|_| ());
    let case = |name: &str, bound: f64, change: &dyn Fn(&mut Scene)| {
        let other = with(change);
        let d = difference(&plain, &other).unwrap();
        println!(
            "{name}: mean {:.5}/255, max {:.3}/255",
            d.mean / STEP,
            d.max / STEP
        );
        assert!(d.max > 0.0, "{name} changes nothing");
        assert!(d.mean <= bound * STEP, "{name}: {d:?}");
    };
    case("slab 8", 1e-3, &|s| s.render.slab = 8);
    case("slab 32", 1e-3, &|s| s.render.slab = 32);
    case("front to back", 1e-3, &|s| {
        s.render.slice_order = SliceOrder::FrontToBack
    });
    case("front to back, early end", 0.5, &|s| {
        s.render.slice_order = SliceOrder::FrontToBack;
        s.render.early_termination = true;
    });
    case("16 bits", 0.5, &|s| s.render.blend_format = BlendFormat::Float16);
}

/// The same options on the GPU.
#[cfg(feature = "gpu")]
pub fn options_of_slices_agree() {
    use crate::parity::with_renderer;
    use incise::Watch;
    let (mut scene, assets) = without_early_end("head-peel");
    scene.render.mode = Mode::Slice;
    scene.transfer.preset = Some("mr-default".into());
    for slab in [1, 8, 32] {
        for order in [SliceOrder::BackToFront, SliceOrder::FrontToBack] {
            for format in [BlendFormat::Float32, BlendFormat::Float16] {
                for early in [false, true] {
                    scene.render.slab = slab;
                    (scene.render.slice_order, scene.render.blend_format) = (order, format);
                    scene.render.early_termination = early;
                    let prepared = Prepared::new(&scene, &assets).unwrap();
                    let by_cpu = picture(&prepared);
                    let by_gpu = with_renderer(|r| r.render(&prepared, false, &Watch::NONE).unwrap()).picture;
                    let d = difference(&by_cpu, &by_gpu).unwrap();
                    let bound = if format == BlendFormat::Float16 { 0.5 } else { 0.1 };
                    let what = format!("slab {slab}, {order:?}, {format:?}, early end {early}");
                    println!(
                        "{what}: mean {:.4}/255, max {:.2}/255",
                        d.mean / STEP,
                        d.max / STEP
                    );
                    // In 16 bits the last layers in front of an opaque one are lost in the rounding of
                    // 1 - alpha, which devices round differently.
                    let stalls = format == BlendFormat::Float16 && order == SliceOrder::FrontToBack;
                    let within = if stalls { 0.99 } else { 0.999 };
                    assert!(d.mean <= bound * STEP && d.within_4 >= within, "{what}: {d:?}");
                }
            }
        }
    }
}

/// Several surfaces that cross inside a slice: the nearest shows, whatever order is stated.
#[cfg(feature = "gpu")]
pub fn crossing_surfaces_agree() {
    let (mut scene, assets) = orthographic(
        "[[mesh]]\nshape = [{ kind = 'sphere', radius = 20.0, center = [5.0, 0.0, 0.0] }]\ncolor = [0.8, 0.25, 0.25]\n\
         [[mesh]]\nshape = [{ kind = 'sphere', radius = 20.0, center = [-5.0, 0.0, 0.0] }]\ncolor = [0.25, 0.25, 0.8]\n\
         [render]\nsize = [160, 160]\nmode = 'slice'\n",
    );
    for order in [SliceOrder::BackToFront, SliceOrder::FrontToBack] {
        for step in [1.0, 8.0] {
            (scene.render.slice_order, scene.render.step) = (order, step);
            let prepared = Prepared::new(&scene, &assets).unwrap();
            let named = prepared.notices.iter().any(|n| n.contains("render.slice_order"));
            assert_eq!(named, order == SliceOrder::FrontToBack);
            crate::parity::agree(&format!("crossing surfaces, {order:?}, step {step}"), &prepared);
        }
    }
}
