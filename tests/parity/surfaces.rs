//! Surfaces: depths, options, silhouettes.

use super::{agree, with_renderer};
use crate::scenes;
use incise::mesh::deformer::NormalMethod;
use incise::prepare::Prepared;
use incise::scene::surface::{DEFORMERS, DeformerSource, Representation, Steps};
use incise::scene::{Antialias, Mode, Scene};
use incise::transfer::Blend;
use incise::{Watch, cpu};

/// Surface depths: within a thousandth of the box of the CPU's where both hit.
pub(super) fn surface_depths_agree() {
    for name in [
        "bunny-twist",
        "bunny-two-stage",
        "bunny-deformers",
        "apple-hollow",
        "apple-thick",
        "apple-solid",
        "gyroid",
        "head-skin-peel",
    ] {
        let mut scene = scenes::load(name);
        scene.render.size = [192, 192];
        scene.render.antialias = Antialias::OFF;
        let assets = scenes::assets(&scene);
        let prepared = Prepared::new(&scene, &assets).unwrap();
        let by_gpu = with_renderer(|r| {
            r.surface_distances(&prepared)
                .unwrap_or_else(|e| panic!("{name}: {e}"))
        });
        let bound = 1e-3 * assets.scene_box().size().length();
        let (mut off, mut seen, mut worst) = (0, 0, 0.0f32);
        for (n, &t) in by_gpu.iter().enumerate() {
            let (u, v) = (
                ((n % 192) as f32 + 0.5) / 96.0 - 1.0,
                1.0 - ((n / 192) as f32 + 0.5) / 96.0,
            );
            let (o, d) = prepared.frame.view.ray(u, v);
            let want = cpu::surface_shading::nearest(&prepared, o, d, &mut 0).map_or(f32::INFINITY, |h| h.t);
            seen += usize::from(want.is_finite());
            if (t - want).abs() > bound || t.is_finite() != want.is_finite() {
                off += 1;
            } else if t.is_finite() {
                worst = worst.max((t - want).abs());
            }
        }
        println!(
            "{name}: {seen} pixels, {off} beyond {bound:.3} mm (silhouettes and edges), the others within {worst:.4} mm"
        );
        // A ray that grazes an edge may hit on one backend and miss on the other.
        assert!(seen > 2000 && off * 500 < seen, "{name}: {off} of {seen}");
    }
}

/// All step methods, solids, deformers, and projections; slices in front of surfaces.
pub(super) fn surface_options_agree() {
    let small = |name: &str| {
        let mut scene = scenes::load(name);
        scene.render.size = [128, 128];
        scene.render.antialias = Antialias::OFF;
        scene
    };
    let check = |what: &str, scene: &Scene| {
        let assets = scenes::assets(scene);
        agree(what, &Prepared::new(scene, &assets).unwrap());
    };
    for steps in [
        Steps::Uniform,
        Steps::Threshold,
        Steps::Jacobian,
        Steps::JacobianBound,
        Steps::Sphere,
    ] {
        let mut scene = small("bunny-twist");
        scene.surface.steps = steps;
        check(&format!("{steps:?} steps"), &scene);
    }
    for name in ["bunny-twist", "bunny-deformers"] {
        let mut scene = small(name);
        scene.light.apply("raking,elevation=40").unwrap();
        (scene.light.key_color, scene.light.sky_color) = ([1.0, 0.7, 0.4], [0.5, 0.8, 1.0]);
        check(&format!("{name} under a coloured light"), &scene);
    }
    let mut averaged = small("gyroid");
    averaged.render.antialias = Antialias::Grid(3);
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
    for (kind, _, _) in DEFORMERS {
        for normals in [
            NormalMethod::InverseTranspose,
            NormalMethod::Tangent,
            NormalMethod::Numeric,
        ] {
            let mut scene = small("bunny-deformers");
            scene.mesh[0].normals = normals;
            scene.mesh[0].deformer = vec![DeformerSource {
                kind: kind.into(),
                center: None,
                size: None,
                rotate: Some([0.0, 30.0, 10.0]),
                progress: Some(0.9),
                points: if kind == "lattice" {
                    vec![[1.0, 1.0, 3.0, 10.0, 5.0, 30.0], [3.0, 2.0, 0.0, -5.0, 20.0, 0.0]]
                } else {
                    vec![]
                },
                numbers: numbers(kind)
                    .into_iter()
                    .map(|(n, v)| (n.to_owned(), v))
                    .collect(),
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
pub(super) fn one_deformation_on_the_gpu() {
    crate::surfaces::three_silhouettes(&|prepared| {
        with_renderer(|r| r.render(prepared, false, &Watch::NONE).unwrap()).picture
    });
}
