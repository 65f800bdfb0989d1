//! Empty space found by the device.

use super::{PREPARE, agree, with_strategy};
use crate::metrics::{STEP, difference};
use crate::scenes;
use glam::Vec3;
use incise::Watch;
use incise::prepare::{PrepareOptions, Prepared};
use incise::scene::{Antialias, Deformation, Scene};
use incise::transfer::Blend;
use incise::volume::VolumeSampler;

/// Points of cells marked empty are transparent; at points of cells marked clear no mask has an
/// effect.
fn empty_is_empty(name: &str, prepared: &Prepared) {
    let cells = &prepared.volume().macrocells;
    let grid = prepared.volume().grid;
    // Cells are marked clear with respect to the maps' masks only.
    let maps = incise::deform::Stack::new(prepared.stack.maps().to_vec());
    let depth_at = |p: Vec3| -> f32 {
        let (source, alpha) = prepared.stack.source_and_alpha(p);
        let at = prepared.volume().voxel_from_world.transform_point3(source);
        let top = Vec3::from(grid.size.map(|n| n as f32)) - 0.5;
        if alpha < 0.5
            || prepared.cuts.signed_distance_mm(p) < 0.0
            || at.cmplt(Vec3::splat(-0.5)).any()
            || at.cmpgt(top).any()
        {
            return 0.0;
        }
        let value = VolumeSampler::new(grid).sample(at);
        match prepared.volume().iso {
            _ if prepared.volume().blend != Blend::Composite => 1.0,
            Some(iso) => f32::from(u8::from(value >= iso)),
            None => prepared.volume().table.lookup(value)[3],
        }
    };
    for n in 0..cells.distance.len() {
        let b = cells.cell_box(n);
        for corner in 0..9 {
            let share = if corner == 8 {
                Vec3::splat(0.5)
            } else {
                Vec3::new(
                    (corner & 1) as f32,
                    (corner >> 1 & 1) as f32,
                    (corner >> 2) as f32,
                )
            };
            let p = b.min + b.size() * share;
            if !cells.is_occupied(n) {
                assert!(
                    depth_at(p) < 1e-5,
                    "{name}: something shows at {p}, in an empty cell: {}",
                    depth_at(p)
                );
            } else if cells.distance[n] == 255 {
                let jet = maps.jet(p);
                assert!(
                    jet.alpha == 1.0 && jet.cut.distance_mm == f32::INFINITY,
                    "{name}: a cut at {p}, in a clear cell: {:?}",
                    jet.cut
                );
            }
        }
    }
}

/// Scenes with their names: maps that the device samples and maps that it does not, every kind of
/// shape, and all settings that determine visibility.
fn scenes_with_empty_space() -> Vec<(String, Scene)> {
    let small = |name: &str, change: &dyn Fn(&mut Scene)| {
        let mut scene = scenes::load(name);
        (scene.render.size, scene.render.antialias) = ([128, 128], Antialias::OFF);
        change(&mut scene);
        (name.to_owned(), scene)
    };
    let mut many = Scene::of_volume("phantom:tomato:size=64");
    for (n, kind) in ["wave", "twist", "pull", "seam", "slab", "peel"]
        .into_iter()
        .enumerate()
    {
        let d = Deformation {
            progress: Some(0.4),
            resolution: Some(32),
            add: n == 2,
            rotate: Some([15.0 * n as f32, 5.0, 0.0]),
            ..Deformation::new(kind)
        };
        many.deformation.push(d);
    }
    let mut composed = Scene::of_volume("phantom:tomato:size=64");
    for (n, kind) in ["wave", "twist", "bulge", "spline-pull", "wave"]
        .into_iter()
        .enumerate()
    {
        let d = Deformation {
            progress: Some(0.25),
            rotate: Some([15.0 * n as f32, 25.0, 0.0]),
            ..Deformation::new(kind)
        };
        composed.deformation.push(d);
    }
    composed.render.precompose = Some(4.0);
    let mut shapes = Scene::of_volume("phantom:head-ct:size=64");
    shapes.deformation = ["twist", "sphere", "box", "wedge", "cylinder"]
        .map(Deformation::new)
        .to_vec();
    shapes.deformation[1].center = Some([40.0, -50.0, 10.0]);
    let mut round = Scene::of_volume("phantom:tomato:size=64");
    round.deformation = ["slab", "pull"].map(Deformation::new).to_vec();
    for d in &mut round.deformation {
        d.parameters.insert("mapping", "cylindrical");
        d.rotate = Some([30.0, 20.0, 0.0]);
    }
    vec![
        ("round an axis".to_owned(), round),
        small("head-peel", &|_| ()),
        small("head-slabs", &|_| ()),
        small("head-grey-cuts", &|_| ()),
        small("head-surface-peel", &|_| ()),
        small("head-iso", &|_| ()),
        small("tomato-peel-then-wave", &|s| {
            s.transfer.preset = Some("ct-mip".into())
        }),
        small("teddy-seam", &|s| s.render.preintegrated = Some(true)),
        small("brain-labels", &|_| ()),
        ("six maps".to_owned(), many),
        ("composed".to_owned(), composed),
        ("shapes".to_owned(), shapes),
    ]
}

/// Empty space found by the device matches the CPU's: no visible cell is skipped, and few empty
/// ones are kept; for maps sampled on the device and others, every kind of shape, and all settings
/// that determine visibility.
pub(super) fn empty_space_agrees() {
    for (name, mut scene) in scenes_with_empty_space() {
        scene.render.size = [128, 128];
        let assets = scenes::assets(&scene);
        let by_cpu = Prepared::new(&scene, &assets).unwrap();
        let again = scenes::assets(&scene);
        let by_device = with_strategy(PREPARE, |r| {
            Prepared::with(&scene, &again, &PrepareOptions::on(r)).unwrap()
        });
        let (a, b) = (&by_cpu.volume().macrocells, &by_device.volume().macrocells);
        assert_eq!(a.size, b.size, "{name}");
        let clear = |d: u8| d == 255;
        let (mut both, mut more, mut lost, mut clear_in_both, mut also_clear) = (0, 0, 0, 0, 0);
        for (n, (&c, &d)) in a.distance.iter().zip(&b.distance).enumerate() {
            let (shown, occupied) = (a.is_occupied(n), b.is_occupied(n));
            both += usize::from(shown && occupied);
            more += usize::from(!shown && occupied);
            lost += usize::from(shown && !occupied);
            clear_in_both += usize::from(clear(c) && clear(d));
            also_clear += usize::from(clear(d) && shown && !clear(c));
        }
        let clear_in_cpus = a.distance.iter().filter(|d| clear(**d)).count();
        println!(
            "{name}: {both} cells in both, {more} more, {lost} lost; clear {clear_in_both} of {clear_in_cpus}, {also_clear} more"
        );
        // CPU and device merge boxes of texels differently, and split boxes at the faces of a cube
        // differently; the difference is largest for six maps.
        assert!(
            both > 500 && lost * 50 <= both && more * 4 <= both,
            "{name}: {both} {more} {lost}"
        );
        assert!(
            also_clear * 20 <= both && clear_in_both * 10 >= clear_in_cpus * 9,
            "{name}: {clear_in_both} of {clear_in_cpus}, {also_clear}"
        );
        empty_is_empty(&name, &by_device);
        agree(&format!("{name}, prepared by the device"), &by_device);
        // Skipped cells would have been transparent.
        let picture = |prepared: &Prepared| {
            with_strategy(PREPARE, |r| r.render(prepared, false, &Watch::NONE).unwrap()).picture
        };
        let skipping = picture(&by_device);
        scene.render.empty_space_skipping = false;
        let whole = with_strategy(PREPARE, |r| {
            Prepared::with(&scene, &again, &PrepareOptions::on(r)).unwrap()
        });
        let d = difference(&skipping, &picture(&whole)).unwrap();
        println!(
            "{name}: skipping changes mean {:.5}/255, max {:.3}/255",
            d.mean / STEP,
            d.max / STEP
        );
        assert!(
            d.max <= 0.51 * STEP,
            "{name}: skipping changes the picture by {}/255",
            d.max / STEP
        );
    }
}
