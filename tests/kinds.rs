//! Properties of every kind of deformation.

use glam::Vec3;
use incise::Watch;
use incise::deform::kinds;
use incise::math::Bounds;
use incise::prepare::{Assets, Deformed};
use incise::scene::{Deformation, Scene};

/// Kinds that follow a distance field: it bends on its medial axis, where they have no derivative.
const FOLLOW_A_FIELD: [&str; 3] = ["lift", "offset", "surface-peel"];

/// The largest distance, mm, between the displacements of neighbouring texels of which one is
/// retained, at some number of texels.
fn largest_jump(kind: &str, resolution: usize) -> Option<f32> {
    let mut scene = Scene::of_volume("phantom:head-ct:size=48");
    let mut deformation = Deformation::new(kind);
    deformation.resolution = Some(resolution);
    deformation.parameters = kinds::kind(kind)
        .unwrap()
        .example(&Bounds::new(Vec3::splat(-60.0), Vec3::splat(60.0)));
    scene.deformation.push(deformation);
    let assets = Assets::load(&scene).unwrap();
    let stack = Deformed::exact(&scene, &assets, false, &Watch::NONE)
        .unwrap()
        .stack;
    let placed = stack.maps().first()?;
    let [nx, ny, nz] = placed.map.size;
    let linear = placed.placement.world_from_map.matrix3;
    let top = Vec3::from(placed.map.size.map(|n| n.saturating_sub(1).max(1) as f32));
    let at = |i: usize, j: usize, k: usize| placed.map.sample(Vec3::new(i as f32, j as f32, k as f32) / top);
    let mut largest = 0.0f32;
    for (i, j, k) in (0..nz).flat_map(|k| (0..ny).flat_map(move |j| (0..nx).map(move |i| (i, j, k)))) {
        let here = at(i, j, k);
        for (i, j, k) in [(i + 1, j, k), (i, j + 1, k), (i, j, k + 1)] {
            if i < nx && j < ny && k < nz {
                let next = at(i, j, k);
                if here.alpha >= 0.5 || next.alpha >= 0.5 {
                    largest = largest
                        .max((linear * glam::Vec3A::from(next.displacement - here.displacement)).length());
                }
            }
        }
    }
    Some(largest)
}

/// Wherever a sample can be retained, a map's displacement is continuous: between neighbouring texels
/// of which one is retained it changes half as much when there are twice as many texels.
pub fn displacement_is_continuous_where_it_shows() {
    let mut tested = 0;
    for kind in kinds::list().filter(|kind| !FOLLOW_A_FIELD.contains(&kind.name)) {
        let [coarse, fine] = [32, 64].map(|n| largest_jump(kind.name, n));
        let (Some(coarse), Some(fine)) = (coarse, fine) else {
            continue;
        };
        println!(
            "{}: {coarse:.3} mm, {fine:.3} mm with twice the texels",
            kind.name
        );
        tested += usize::from(coarse > 0.1);
        assert!(
            fine <= 0.75 * coarse + 0.05,
            "{}: {coarse} mm, {fine} mm",
            kind.name
        );
    }
    assert!(tested >= 14, "{tested} kinds move anything");
}
