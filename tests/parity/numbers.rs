//! The shaders' functions compared with the CPU's at thousands of points.

use super::{PREPARE, with_strategy};
use crate::contract::points;
use crate::scenes;
use glam::Vec3;
use incise::math::Bounds;
use incise::prepare::{Assets, PrepareOptions, Prepared};
use incise::scene::{Deformation, Scene};
use incise::volume::{GradientFilter, VolumeSampler};

/// Source point, mask, Jacobian, cut, value, opacity and gradient computed by the shaders equal the
/// CPU's, in a rotated, anisotropic placement.
pub(super) fn numbers_agree(kind: &str) {
    let mut scene = Scene::of_volume("phantom:head-ct:size=48");
    let mut deformation = Deformation::new(kind);
    deformation.rotate = Some([20.0, -30.0, 40.0]);
    deformation.center = Some([4.0, 6.0, -8.0]);
    deformation.parameters = incise::deform::kinds::kind(kind)
        .unwrap()
        .example(&Bounds::new(Vec3::splat(-60.0), Vec3::splat(60.0)));
    scene.deformation.push(deformation);
    scene.render.exact_cuts = false;
    let assets = scenes::assets(&scene);
    let prepared = Prepared::new(&scene, &assets).unwrap();
    numbers_of(kind, &prepared, &assets);
    // The same with the map sampled on the device: its texels against those sampled on the CPU.
    let by_cpu = prepared.stack.maps()[0].map.extent();
    let again = scenes::assets(&scene);
    let prepared = with_strategy(PREPARE, |r| {
        Prepared::with(&scene, &again, &PrepareOptions::on(r)).unwrap()
    });
    let map = &prepared.stack.maps()[0].map;
    let formula = matches!(
        incise::deform::kinds::kind(kind).unwrap().build,
        incise::deform::kinds::FieldBuilder::Formula(_)
    );
    assert_eq!(map.definition().is_some(), formula, "{kind}");
    let by_device = map.extent();
    let near = |a: &[f32], b: &[f32]| {
        a.iter()
            .zip(b)
            .all(|(a, b)| (a - b).abs() <= 2e-3 * (1.0 + a.abs()))
    };
    assert!(
        near(&by_cpu.texels.min, &by_device.texels.min) && near(&by_cpu.texels.max, &by_device.texels.max),
        "{kind}: {by_cpu:?} {by_device:?}"
    );
    // Slopes amplify the rounding of a texel by the number of texels.
    let steep = |a: &[f32], b: &[f32]| {
        a.iter()
            .zip(b)
            .all(|(a, b)| (a - b).abs() <= 0.02 * (1.0 + a.abs()) + 0.1)
    };
    assert!(
        steep(&by_cpu.slopes.min, &by_device.slopes.min) && steep(&by_cpu.slopes.max, &by_device.slopes.max),
        "{kind}: {by_cpu:?} {by_device:?}"
    );
    numbers_of(kind, &prepared, &again);
}

fn numbers_of(kind: &str, prepared: &Prepared, assets: &Assets) {
    let at: Vec<[f32; 3]> = points(10_000).map(|x| ((x - 0.5) * 150.0).to_array()).collect();
    let probes = with_strategy(PREPARE, |r| r.probe(prepared, &at).unwrap());
    assert_eq!(probes.len(), at.len());
    let sampler = VolumeSampler::new(assets.grid());
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
        let jacobian = [(4, j.x_axis), (8, j.y_axis), (12, j.z_axis)]
            .map(|(n, c)| (v(n) - c).length())
            .into_iter()
            .fold(0.0, f32::max);
        if v(0).distance(jet.source) > 0.05 {
            println!(
                "{kind} at {p}: off by {} mm, mask {}, displaced by {} mm, J {j}",
                v(0).distance(jet.source),
                jet.alpha,
                jet.source.distance(p)
            );
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
    assert!(
        worst.iter().zip(bound).all(|(w, b)| *w <= b),
        "{kind}: {worst:?} against {bound:?}"
    );
}
