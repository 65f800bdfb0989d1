//! Stacks of maps composed into one map, and groups of cuts.

use super::{assets, stack_of};
use crate::closed_forms::picture;
use crate::contract::points;
use crate::metrics::difference;
use glam::Vec3;
use incise::deform::Storage;
use incise::deform::compose::{self, Resolution};
use incise::prepare::Prepared;
use incise::scene::{Deformation, Scene};

/// With a bound, one map replaces eleven, and the picture is the same.
pub fn long_stacks_are_composed() {
    let mut scene = Scene::of_volume("phantom:tomato:size=96");
    scene.render.size = [160, 160];
    scene.camera.view = "30,30".parse().unwrap();
    for n in 0..11 {
        let mut d = Deformation::new(["wave", "twist", "bulge", "spline-pull", "planar-wave"][n % 5]);
        d.progress = Some(0.25);
        d.rotate = Some([15.0 * n as f32, 25.0, 5.0 * n as f32]);
        scene.deformation.push(d);
    }
    let assets = assets(&scene);
    let all = Prepared::new(&scene, &assets).unwrap();
    assert_eq!(all.stack.maps().len(), 11);
    assert!(all.composition.is_none());
    scene.render.precompose = Some(0.3);
    let composed = Prepared::new(&scene, &assets).unwrap();
    let c = composed.composition.unwrap();
    let d = difference(&picture(&composed), &picture(&all)).unwrap();
    println!(
        "11 maps: {c:?}; mean {:.3}/255, PSNR {:.1} dB",
        d.mean * 255.0,
        d.psnr
    );
    assert!(
        c.composed && c.worst_mm <= 0.3 && composed.stack.precomposed().is_some(),
        "{c:?}"
    );
    assert!(d.mean < 0.5 / 255.0, "{d:?}");
}

/// A composed stack is within the requested error, with more texels for a smaller bound.
pub fn composition_keeps_its_bound() {
    let mut scene = Scene::of_volume("phantom:ball:size=64");
    // All of these vanish on the faces of their boxes: one map can replace them everywhere.
    scene.deformation = vec![
        Deformation::new("bulge"),
        Deformation {
            rotate: Some([20.0, 40.0, 0.0]),
            ..Deformation::new("spline-pull")
        },
    ];
    let assets = assets(&scene);
    let (stack, _) = stack_of(&scene, &assets, None);
    let (mut last, mut first) = (0, usize::MAX);
    for bound in [2.0, 0.3, 0.1] {
        let composed = compose::stack(
            &stack,
            &assets.volume.bounds_in_world(),
            Resolution::Within(bound),
            Storage::F32,
            &compose::evaluate,
        )
        .unwrap()
        .unwrap();
        let texels = composed.placed.map.size.iter().product::<usize>();
        let worst = composed.worst_mm;
        assert!(
            composed.within && worst <= bound && texels >= last,
            "{worst} mm for {bound} with {texels} texels"
        );
        println!(
            "composed within {bound} mm: {:?} texels, worst {worst:.3} mm, 99 % {:.3} mm",
            composed.placed.map.size, composed.p99_mm
        );
        (last, first) = (texels, first.min(texels));
        // The error at independent points, away from cuts.
        let errors = points(4000)
            .map(|x| (x - 0.5) * 150.0)
            .filter(|p| {
                let (source, alpha) = stack.source_and_alpha_unclipped(*p);
                alpha == 1.0 && source.abs().max_element() < 80.0
            })
            .map(|p| {
                composed
                    .placed
                    .backward(p)
                    .0
                    .distance(stack.source_and_alpha_unclipped(p).0)
            });
        let worst = errors.fold(0.0, f32::max);
        assert!(worst <= bound, "{worst} for {bound}");
    }
    assert!(last > first);
}

/// The cost of a composed stack does not depend on its length: samples, and maps per sample, are
/// those of one map.
pub fn composed_stacks_are_one_map() {
    let mut scene = Scene::of_volume("phantom:tomato:size=64");
    for kind in [
        "wave",
        "twist",
        "bulge",
        "spline-pull",
        "planar-wave",
        "taper",
        "shear",
        "lattice",
    ] {
        let mut d = Deformation {
            progress: Some(0.3),
            ..Deformation::new(kind)
        };
        if kind == "lattice" {
            d.parameters = incise::deform::kinds::kind(kind)
                .unwrap()
                .example(&incise::math::Bounds::new(Vec3::splat(-80.0), Vec3::splat(80.0)));
        }
        scene.deformation.push(d);
    }
    scene.render.precompose = Some(0.5);
    let assets = assets(&scene);
    let prepared = Prepared::new(&scene, &assets).unwrap();
    let c = prepared.composition.unwrap();
    println!("eight maps: {c:?}");
    assert!(
        prepared.stack.precomposed().is_some() && c.maps == 8 && c.composed && c.worst_mm <= 0.5,
        "{c:?}"
    );
}

/// An intersection with a cut of progress 0 removes nothing; a union with it removes the rest.
pub fn groups_with_a_vanished_member() {
    let mut scene = Scene::of_volume("phantom:ball:size=32");
    let cut = |kind: &str, combine: &str, progress: f32| {
        let mut d = Deformation {
            progress: Some(progress),
            ..Deformation::new(kind)
        };
        d.parameters.insert("group", "g");
        d.parameters.insert("combine", combine);
        d
    };
    for (combine, progress, removed) in [("and", 0.0, false), ("or", 0.0, true), ("and", 1.0, true)] {
        scene.deformation = vec![cut("box", combine, 1.0), cut("sphere", "or", progress)];
        let assets = assets(&scene);
        let (_, cuts) = stack_of(&scene, &assets, None);
        assert_eq!(
            cuts.signed_distance_mm(Vec3::new(3.0, 2.0, 1.0)) < 0.0,
            removed,
            "{combine} {progress}"
        );
    }
}
