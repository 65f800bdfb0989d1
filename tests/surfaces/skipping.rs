//! Skipping empty space loses no surface.

use super::{ball_scene, render, silhouette};
use crate::metrics::{STEP, difference};
use crate::scenes;
use incise::prepare::Prepared;
use incise::scene::surface::{MeshSource, ShapeSource, Steps};
use incise::scene::{Antialias, Deformation, Scene};

/// Skipping space emptied by cuts, or any other space, changes no pixel by more than a step.
pub fn skipping_changes_no_surface() {
    for name in [
        "apple-hollow",
        "apple-thick",
        "apple-solid",
        "bunny-knife",
        "head-skin-peel",
    ] {
        let mut scene = scenes::load(name);
        scene.render.size = [96, 96];
        scene.render.antialias = Antialias::OFF;
        let with = render(&scene);
        scene.surface.cut_skipping = false;
        let without_cuts = render(&scene);
        scene.render.empty_space_skipping = false;
        let without = render(&scene);
        for (what, other) in [("cuts", &without_cuts), ("everything", &without)] {
            let d = difference(&with, other).unwrap();
            let off = with
                .pixels
                .iter()
                .zip(&other.pixels)
                .filter(|(a, b)| (0..4).any(|c| f64::from((a[c] - b[c]).abs()) > STEP))
                .count();
            println!(
                "{name}, skipping {what}: max {:.3}/255, {off} pixels beyond 1/255",
                d.max / STEP
            );
            assert!(off == 0, "{name} {what}: {off} pixels, max {}", d.max / STEP);
        }
    }
}

/// Whatever the way of stepping and the length of the steps, skipping empty space loses no hit:
/// balls, thin plates, something with fingers, and a bunny have the same pixels with and without it.
pub fn skipping_loses_no_hit() {
    let solid = |kind: &str, center: [f32; 3], size: [f32; 3], radius: Option<f32>, length: Option<f32>| {
        ShapeSource {
            kind: kind.into(),
            join: Some("union".into()),
            center: Some(center),
            rotate: None,
            size: (kind == "box").then_some(incise::scene::Size::Box(size)),
            radius,
            tube: None,
            length,
            period: None,
            wall: None,
        }
    };
    let fingers = (0..5).map(|n| {
        let x = -36.0 + 18.0 * n as f32;
        solid(
            "cylinder",
            [x, 2.0 * n as f32, 40.0],
            [0.0; 3],
            Some(4.0 + n as f32),
            Some(60.0),
        )
    });
    let palm = solid("box", [0.0, 0.0, -10.0], [90.0, 22.0, 50.0], None, None);
    let plate = solid("box", [0.0; 3], [100.0, 0.8, 100.0], None, None);
    let of = |shape: Vec<ShapeSource>| MeshSource {
        shape,
        ..MeshSource::default()
    };
    let bunny = scenes::load("bunny-twist");
    let cases: [(&str, Scene); 4] = [
        ("ball", ball_scene()),
        (
            "plate",
            Scene {
                mesh: vec![of(vec![plate])],
                ..ball_scene()
            },
        ),
        (
            "hand",
            Scene {
                mesh: vec![of(std::iter::once(palm).chain(fingers).collect())],
                ..ball_scene()
            },
        ),
        ("bunny", bunny),
    ];
    for (name, mut scene) in cases {
        scene.render.size = [128, 128];
        scene.render.antialias = Antialias::OFF;
        if name != "bunny" {
            scene.camera.view = "30,20".parse().unwrap();
            let mut twist = Deformation::new("twist");
            twist.size = Some(incise::scene::Size::Cube(110.0));
            scene.deformation = vec![twist];
        }
        let assets = scenes::assets(&scene);
        for steps in [
            Steps::Uniform,
            Steps::Threshold,
            Steps::Jacobian,
            Steps::JacobianBound,
            Steps::Sphere,
        ] {
            let mut counts = Vec::new();
            for step in [0.5, 1.0, 2.0, 4.0] {
                scene.surface.steps = steps;
                scene.render.step = step;
                let [with, without] = [true, false].map(|skip| {
                    scene.render.empty_space_skipping = skip;
                    let prepared = Prepared::new(&scene, &assets).unwrap();
                    silhouette(&incise::cpu::render(&prepared).picture)
                });
                let apart = with.iter().zip(&without).filter(|(a, b)| a != b).count();
                assert_eq!(apart, 0, "{name}, {steps:?} steps of {step}");
                counts.push(with.iter().filter(|hit| **hit).count());
            }
            println!("{name}, {steps:?}: hits at steps of 1/2, 1, 2, 4: {counts:?}");
            if steps == Steps::Sphere {
                // Nor does a longer step.
                assert!(
                    counts.iter().all(|n| n.abs_diff(counts[0]) <= 2),
                    "{name}: {counts:?}"
                );
            }
        }
    }
}

/// Rays that run in the plane of a face between cells: none stops there, and none takes many more
/// samples than its neighbours.
pub fn rays_along_the_faces_of_cells() {
    // At these sizes no ray grazes the sides of the box, along which the distance stays near 0.
    let mut scene = Scene::from_toml(
        "incise = 1\n[[mesh]]\nshape = [{ kind = 'box', size = [10.22, 80.0, 10.22], center = [0.0, -60.0, 0.0] }, \
         { kind = 'sphere', radius = 15.0 }]\n[surface]\nsteps = 'sphere'\n\
         [camera]\nview = 'anterior'\nprojection = 'orthographic'\n[render]\nmode = 'surface'\n",
    )
    .unwrap();
    let samples = |edge: u32, scene: &mut Scene| {
        scene.render.size = [edge; 2];
        let assets = scenes::assets(scene);
        let done = incise::cpu::render(&Prepared::new(scene, &assets).unwrap());
        let middle = edge / 2;
        let shown = |x: u32, y: u32| done.picture.pixels[(y * edge + x) as usize][3] > 0.5;
        for at in 0..edge {
            for across in [(middle, at), (at, middle)] {
                let beside = if across.0 == middle {
                    (across.0 - 1, at)
                } else {
                    (at, across.1 - 1)
                };
                assert_eq!(
                    shown(across.0, across.1),
                    shown(beside.0, beside.1),
                    "pixel {across:?}"
                );
            }
        }
        done.stats.unwrap().samples_taken as f64 / f64::from(edge * edge)
    };
    let (even, odd) = (samples(128, &mut scene), samples(129, &mut scene));
    println!("samples per ray: {even:.2} beside the faces, {odd:.2} with some in them");
    assert!(odd < 1.2 * even, "{odd} {even}");
}
