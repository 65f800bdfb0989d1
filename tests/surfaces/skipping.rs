//! Skipping empty space loses no surface.

use super::{ball_scene, render, silhouette};
use crate::metrics::{STEP, difference};
use crate::scenes;
use incise::prepare::Prepared;
use incise::scene::surface::{MeshSource, ShapeSource, Steps};
use incise::scene::{Deformation, Scene};

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
        scene.render.antialias = 1;
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
        scene.render.size = [200, 200];
        scene.render.antialias = 1;
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
