//! How maps are interpolated and differentiated: each way against the plain one, and on both backends.

use crate::closed_forms::picture;
use crate::metrics::{STEP, difference};
use crate::scenes::{assets, load};
use incise::prepare::Prepared;
use incise::scene::{Antialias, Deformation, JacobianSource, MapFiltering, Mode, Scene};

/// Scenes with maps of every kind: formulas, cuts, features of a surface, round an axis; volumes and
/// surfaces.
fn scenes() -> Vec<(String, Scene)> {
    let mut all: Vec<(String, Scene)> = ["head-peel", "head-lift", "teddy-seam", "bunny-twist"]
        .into_iter()
        .map(|name| (name.to_owned(), load(name)))
        .collect();
    let mut round = Deformation::new("slab");
    round.placement = incise::scene::DefaultPlacement::Volume;
    round.parameters.insert("mapping", "cylindrical");
    let mut scene = Scene::of_volume("phantom:head-ct:size=64");
    scene.deformation = vec![round];
    all.push(("a slab round an axis".into(), scene));
    for (_, scene) in &mut all {
        scene.render.size = [128, 128];
        scene.render.antialias = Antialias::OFF;
    }
    all
}

/// Stored Jacobians are the differences, up to the rounding of what is stored and to the outermost
/// texels; weights of 8 bits move samples by less than a pixel shows.
pub fn filters_change_little() {
    for (name, mut scene) in scenes() {
        let assets = assets(&scene);
        let plain = picture(&Prepared::new(&scene, &assets).unwrap());
        scene.render.jacobian = JacobianSource::Stored;
        let stored = picture(&Prepared::new(&scene, &assets).unwrap());
        scene.render.jacobian = JacobianSource::Differences;
        scene.render.map_filter = Some(MapFiltering::Hardware);
        let short = picture(&Prepared::new(&scene, &assets).unwrap());
        scene.render.map_filter = Some(MapFiltering::Shader);
        assert_eq!(picture(&Prepared::new(&scene, &assets).unwrap()), plain, "{name}");
        for (what, other, bound) in [("stored", &stored, 0.1), ("8 bits", &short, 0.5)] {
            let d = difference(&plain, other).unwrap();
            println!(
                "{name}, {what}: mean {:.4}/255, max {:.2}/255",
                d.mean / STEP,
                d.max / STEP
            );
            assert!(d.max > 0.0, "{name}, {what}: nothing changes");
            assert!(
                d.mean <= bound * STEP && d.within_4 >= 0.98,
                "{name}, {what}: {d:?}"
            );
        }
    }
}

/// The same on the GPU.
#[cfg(feature = "gpu")]
pub fn filters_agree() {
    for (name, mut scene) in scenes() {
        let assets = assets(&scene);
        for (jacobian, map_filter) in [
            (JacobianSource::Stored, None),
            (JacobianSource::Differences, Some(MapFiltering::Shader)),
        ] {
            (scene.render.jacobian, scene.render.map_filter) = (jacobian, map_filter);
            let modes: &[Mode] = if scene.render.mode == Mode::Surface {
                &[Mode::Surface]
            } else {
                &[Mode::Slice, Mode::Raycast]
            };
            for &mode in modes {
                let mut scene = scene.clone();
                scene.render.mode = mode;
                crate::parity::agree(
                    &format!("{name}, {mode:?}, {jacobian:?}, {map_filter:?}"),
                    &Prepared::new(&scene, &assets).unwrap(),
                );
            }
        }
    }
}
