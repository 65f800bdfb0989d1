//! The cost of what a sample is made of, each way beside the others in one run: Jacobians of maps by
//! differences or stored for each texel, maps filtered in the shader or by hardware, values of voxels
//! or of a function; slices one by one, in slabs, and front to back.
//!
//! `cargo bench --bench sampling [-- --gpu]` prints million samples a second (medians of five) and
//! the mean difference to the first line of each group. Rays and slices at 512 x 512 pixels.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a benchmark that cannot set up should stop"
)]

use incise::compare::difference;
use incise::engine::{Backend, Engine, EngineOptions, RenderRequest};
use incise::picture::Picture;
use incise::prepare::{Assets, Prepared};
use incise::scene::{Deformation, JacobianSource, MapFiltering, Mode, Scene, SliceOrder};
use std::path::Path;
use std::time::Instant;

/// Changes a scene to one of the ways of a group.
type Way = (&'static str, fn(&mut Scene));

const JACOBIANS: &[Way] = &[
    ("differences, maps in the shader", |s| {
        s.render.map_filter = Some(MapFiltering::Shader);
    }),
    ("stored, maps in the shader", |s| {
        s.render.map_filter = Some(MapFiltering::Shader);
        s.render.jacobian = JacobianSource::Stored;
    }),
    ("differences, maps by hardware", |s| {
        s.render.map_filter = Some(MapFiltering::Hardware);
    }),
    ("stored, maps by hardware", |s| {
        s.render.map_filter = Some(MapFiltering::Hardware);
        s.render.jacobian = JacobianSource::Stored;
    }),
];

const SLICES: &[Way] = &[
    ("slices", |s| s.render.mode = Mode::Slice),
    ("slabs of 8", |s| {
        (s.render.mode, s.render.slab) = (Mode::Slice, 8);
    }),
    ("slabs of 32", |s| {
        (s.render.mode, s.render.slab) = (Mode::Slice, 32);
    }),
    ("front to back", |s| {
        (s.render.mode, s.render.slice_order) = (Mode::Slice, SliceOrder::FrontToBack);
    }),
    ("slabs of 32, front to back", |s| {
        (s.render.mode, s.render.slab) = (Mode::Slice, 32);
        s.render.slice_order = SliceOrder::FrontToBack;
    }),
    ("rays", |_| {}),
];

const PROCEDURAL: &[Way] = &[
    ("by voxels", |_| {}),
    ("by the function", |s| {
        if let Some(volume) = &mut s.volume {
            volume.path += ":sampling=function";
        }
    }),
];

fn scene(name: &str) -> Scene {
    let mut scene = match name.strip_prefix("phantom:") {
        Some(_) => {
            let mut scene = Scene::of_volume(name);
            scene.deformation = vec![Deformation::new("twist")];
            scene
        }
        None => {
            Scene::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("volumes").join(name)).expect("a scene")
        }
    };
    scene.render.size = [512, 512];
    scene.render.antialias = incise::scene::Antialias::OFF;
    scene.render.mode = Mode::Raycast;
    scene
}

fn measure(engine: &mut Engine, scene: &Scene, first: &mut Option<Picture>, name: &str) {
    let assets = Assets::load(scene).expect("assets");
    let prepared = Prepared::new(scene, &assets).expect("a scene");
    prepared.make_gradients();
    let counting = RenderRequest {
        count_samples: true,
        ..RenderRequest::default()
    };
    let (counted, _) = engine.render(&prepared, &counting).expect("a picture");
    let samples = counted.stats.expect("counts").samples_taken;
    let mut times: Vec<f64> = (0..5)
        .map(|_| {
            let start = Instant::now();
            engine
                .render(&prepared, &RenderRequest::default())
                .expect("a picture");
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let median = times[2];
    let plain = first.get_or_insert_with(|| counted.picture.clone());
    let apart = difference(plain, &counted.picture).expect("pictures of one size");
    println!(
        "  {name:<34} {median:8.1} ms  {:7.1} million samples a second  mean {:.4}/255, max {:.2}/255",
        samples as f64 / median / 1e3,
        255.0 * apart.mean,
        255.0 * apart.max
    );
}

fn main() {
    let mut engines = vec![("CPU", Engine::cpu())];
    if std::env::args().any(|a| a == "--gpu") {
        let options = EngineOptions {
            backend: Backend::Gpu,
            strict: true,
            ..EngineOptions::default()
        };
        engines.push(("GPU", Engine::open(options).expect("a GPU")));
    }
    for (device, engine) in &mut engines {
        for (name, ways) in [
            ("head-peel.toml", JACOBIANS),
            ("head-slabs.toml", JACOBIANS),
            ("head-peel.toml", SLICES),
            ("phantom:tomato", PROCEDURAL),
            ("phantom:piggy-bank", PROCEDURAL),
        ] {
            println!("{device}, {name}");
            let mut first = None;
            for (way, change) in ways {
                let mut scene = scene(name);
                change(&mut scene);
                measure(engine, &scene, &mut first, way);
            }
        }
    }
}
