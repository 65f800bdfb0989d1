//! Benchmarks of the stages of a picture on the CPU: building a map, classifying empty space,
//! rendering undeformed and deformed.
#![allow(missing_docs, reason = "criterion's macros")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a benchmark that cannot set up should stop"
)]

use criterion::{Criterion, criterion_group, criterion_main};
use incise::cpu;
use incise::prepare::{Assets, Prepared};
use incise::scene::{Deformation, Mode, Scene};

fn scene(deformation: Option<&str>) -> Scene {
    let mut scene = Scene::of_volume("phantom:head-ct:size=128");
    scene.render.size = [256, 256];
    scene.camera.view = "40,20".parse().expect("a view");
    scene.deformation = deformation.map(Deformation::new).into_iter().collect();
    scene
}

fn stages(c: &mut Criterion) {
    let assets = Assets::load(&scene(None)).expect("a phantom");
    for (name, deformation) in [
        ("undeformed", None),
        ("twist", Some("twist")),
        ("peel", Some("peel")),
    ] {
        for mode in [Mode::Raycast, Mode::Slice] {
            let mut scene = scene(deformation);
            scene.render.mode = mode;
            let prepared = Prepared::new(&scene, &assets).expect("a scene");
            c.bench_function(&format!("render/{name}/{mode:?}").to_lowercase(), |b| {
                b.iter(|| cpu::render(&prepared))
            });
        }
        c.bench_function(&format!("prepare/{name}"), |b| {
            b.iter(|| Prepared::new(&scene(deformation), &assets).map(|p| p.volume().macrocells.size))
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10);
    targets = stages
}
criterion_main!(benches);
