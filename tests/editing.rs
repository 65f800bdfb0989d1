//! The cost of scene edits on the GPU renderer: after a small change, only what changed is rebuilt
//! and uploaded.

use crate::metrics::{STEP, difference};
use crate::parity::with_renderer;
use crate::scenes;
use glam::Vec3;
use incise::Watch;
use incise::gpu::{AdapterPreference, Device};
use incise::picture::Picture;
use incise::prepare::{Assets, PrepareOptions, Prepared};
use incise::render::{Renderer, Strategy, Work};
use incise::scene::surface::{MeshSource, Representation, ShapeSource};
use incise::scene::{Antialias, DefaultPlacement, Deformation, Mode, Projection, Scene, VolumeFilter};

/// Two displacement maps over a small head.
fn scene(mode: Mode) -> Scene {
    let mut scene = Scene::of_volume("phantom:head-ct:size=48");
    (scene.render.size, scene.render.antialias) = ([64, 64], Antialias::OFF);
    scene.render.mode = mode;
    // Linear interpolation stores gradients.
    scene.render.filter = VolumeFilter::Linear;
    // Another shader, which an edit of the colours would select.
    scene.render.preintegrated = Some(false);
    for kind in ["twist", "peel"] {
        let mut deformation = Deformation::new(kind);
        (deformation.resolution, deformation.center) = (Some(16), Some([0.0, 0.0, 20.0]));
        // An edit of the colours would place them again.
        deformation.placement = DefaultPlacement::Volume;
        scene.deformation.push(deformation);
    }
    scene
}

fn work_of(renderer: &mut Renderer, scene: &Scene, assets: &Assets) -> Work {
    let prepared = Prepared::new(scene, assets).unwrap();
    let before = renderer.work();
    renderer.render(&prepared, false, &Watch::NONE).unwrap();
    renderer.work().since(&before)
}

type Edit = (&'static str, fn(&mut Scene), Work);

/// For each edit: the work allowed for the next picture. Textures and bind groups are created only
/// where a texture changes size.
pub fn edits_upload_what_changed() {
    // A separate renderer: other tests render other scenes concurrently.
    let mut renderer = Renderer::new(Device::open(AdapterPreference::Any).unwrap());
    let nothing = Work::default();
    let edits: [Edit; 7] = [
        ("nothing", |_| (), nothing),
        (
            "the camera",
            |s| s.camera.view = "35,15".parse().unwrap(),
            nothing,
        ),
        (
            "the light",
            |s| s.light.direction = Vec3::new(0.3, -0.5, 0.8).to_array(),
            nothing,
        ),
        (
            "a placement moved",
            |s| s.deformation[1].center = Some([0.0, 0.0, 21.0]),
            Work {
                cell_uploads: 1,
                ..nothing
            },
        ),
        (
            "a placement turned",
            |s| s.deformation[1].rotate = Some([0.0, 0.0, 10.0]),
            Work {
                cell_uploads: 1,
                ..nothing
            },
        ),
        (
            "a parameter of a map",
            |s| s.deformation[0].progress = Some(0.7),
            Work {
                cell_uploads: 1,
                map_uploads: 1,
                textures_created: 1,
                ..nothing
            },
        ),
        (
            "the transfer function",
            |s| s.transfer.preset = Some("ct-bones-and-muscle".into()),
            Work {
                cell_uploads: 1,
                table_uploads: 1,
                ..nothing
            },
        ),
    ];
    for mode in [Mode::Raycast, Mode::Slice] {
        let mut scene = scene(mode);
        let assets = scenes::assets(&scene);
        work_of(&mut renderer, &scene, &assets);
        // The second picture of a volume uploads its gradients, which requires new bind groups: for
        // the scene, and for rays by compute invocations.
        let work = work_of(&mut renderer, &scene, &assets);
        let bind_groups_created = if mode == Mode::Raycast && renderer.strategy().compute_rays {
            2
        } else {
            1
        };
        assert_eq!(
            work,
            Work {
                volume_uploads: 1,
                textures_created: 1,
                bind_groups_created,
                ..nothing
            },
            "{mode:?}"
        );
        for (name, edit, allowed) in &edits {
            edit(&mut scene);
            let mut work = work_of(&mut renderer, &scene, &assets);
            // The macrocell grid follows the deformed box: a different size needs a new texture.
            let mut allowed = *allowed;
            if allowed.cell_uploads == 1 && work.textures_created == allowed.textures_created + 1 {
                (work.textures_created, work.bind_groups_created) =
                    (allowed.textures_created, work.bind_groups_created.min(1));
                allowed.bind_groups_created = 1;
            }
            // Another view may produce more polygon corners than the buffer holds.
            work.buffers_created = work
                .buffers_created
                .saturating_sub(u32::from(mode == Mode::Slice && *name == "the camera"));
            println!("{mode:?}, {name}: {work:?}");
            assert!(
                work.cell_uploads <= 1 && work.pipelines_compiled == 0,
                "{mode:?}, {name}: {work:?}"
            );
            allowed.cell_uploads = work.cell_uploads.min(allowed.cell_uploads);
            assert_eq!(work, allowed, "{mode:?}, {name}");
        }
        // The pre-integrated shader is compiled once, and afterwards an edit of the colours selects it.
        for (value, pipelines) in [(true, 1), (false, 0), (true, 0)] {
            scene.render.preintegrated = Some(value);
            let work = work_of(&mut renderer, &scene, &assets);
            assert_eq!(work.pipelines_compiled, pipelines, "{mode:?}, {value}: {work:?}");
            assert!(
                work.table_uploads <= 1 && (work.volume_uploads, work.map_uploads) == (0, 0),
                "{mode:?}, {value}: {work:?}"
            );
        }
        scene.render.preintegrated = Some(false);
        work_of(&mut renderer, &scene, &assets);
        // Another volume of the same kind: its texture, and data that depends on its content.
        scene.volume = Scene::of_volume("phantom:head-ct:size=40").volume;
        let other = scenes::assets(&scene);
        let work = work_of(&mut renderer, &scene, &other);
        assert_eq!(
            (work.volume_uploads, work.pipelines_compiled),
            (1, 0),
            "{mode:?}: {work:?}"
        );
        assert!(
            work.buffers_created <= 1 && work.map_uploads <= 2,
            "{mode:?}: {work:?}"
        );
        // Alternating between two sizes, as in a live view, creates nothing after the first time.
        work_of(&mut renderer, &scene, &other);
        for n in 0..4 {
            scene.render.size = if n % 2 == 0 { [32, 32] } else { [64, 64] };
            let work = work_of(&mut renderer, &scene, &other);
            assert!(
                n < 2 || (work.textures_created, work.bind_groups_created) == (0, 0),
                "{mode:?}, size {n}: {work:?}"
            );
        }
    }
}

/// For each edit: the work of a device that prepares scenes, for the next picture. It repeats
/// nothing that is cached.
pub fn edits_prepare_what_changed() {
    let mut renderer = Renderer::new(Device::open(AdapterPreference::Any).unwrap());
    renderer.set_strategy(Strategy {
        exact_filter: true,
        compute_rays: true,
        prepare: true,
    });
    let mut scene = scene(Mode::Raycast);
    let assets = scenes::assets(&scene);
    let mut work = |scene: &Scene| {
        let before = renderer.work();
        let prepared = Prepared::with(scene, &assets, &PrepareOptions::on(&renderer)).unwrap();
        renderer.render(&prepared, false, &Watch::NONE).unwrap();
        renderer.work().since(&before)
    };
    assert_eq!(work(&scene).map_uploads, 2);
    work(&scene);
    type Edit = (&'static str, fn(&mut Scene), u32);
    let edits: [Edit; 5] = [
        ("the camera", |s| s.camera.view = "35,15".parse().unwrap(), 0),
        (
            "the light",
            |s| s.light.direction = Vec3::new(0.3, -0.5, 0.8).to_array(),
            0,
        ),
        (
            "a placement",
            |s| s.deformation[1].center = Some([0.0, 0.0, 21.0]),
            0,
        ),
        ("a parameter", |s| s.deformation[0].progress = Some(0.7), 1),
        (
            "both maps",
            |s| s.deformation.iter_mut().for_each(|d| d.progress = Some(0.6)),
            2,
        ),
    ];
    for (name, edit, maps) in edits {
        edit(&mut scene);
        let done = work(&scene);
        println!("{name}: {done:?}");
        assert_eq!(
            (
                done.map_uploads,
                done.pipelines_compiled,
                done.volume_uploads,
                done.table_uploads
            ),
            (maps, 0, 0, 0),
            "{name}"
        );
        // One buffer per map for its bounds; buffers written for every edit are reused.
        assert!(
            done.buffers_created == maps && done.cell_uploads <= 1,
            "{name}: {done:?}"
        );
        if matches!(name, "the camera" | "the light") {
            assert_eq!(done, Work::default(), "{name}");
        }
    }
    // A long drag does not fill the device's memory.
    for n in 0..40 {
        scene.deformation[0].progress = Some(0.2 + 0.01 * n as f32);
        let prepared = Prepared::with(&scene, &assets, &PrepareOptions::on(&renderer)).unwrap();
        renderer.render(&prepared, false, &Watch::NONE).unwrap();
    }
    assert!(
        renderer.cached_map_count() <= 32,
        "{} maps",
        renderer.cached_map_count()
    );
    // None of it was computed on the CPU.
    let prepared = Prepared::with(&scene, &assets, &PrepareOptions::on(&renderer)).unwrap();
    assert!(prepared.stack.maps().iter().all(|m| m.map.definition().is_some()));
}

/// For each edit: the work allowed for a picture of surfaces, from a field, a formula and
/// triangles. Cached data gives the same picture as rebuilt data.
pub fn edits_of_surfaces_upload_what_changed() {
    let mut renderer = Renderer::new(Device::open(AdapterPreference::Any).unwrap());
    let mut scene = scene(Mode::Surface);
    let bunny = concat!(env!("CARGO_MANIFEST_DIR"), "/volumes/bunny.obj");
    scene.mesh = vec![
        MeshSource {
            iso: Some(300.0),
            ..MeshSource::default()
        },
        MeshSource {
            shape: vec![ShapeSource {
                kind: "sphere".into(),
                join: None,
                center: Some([60.0, 0.0, 0.0]),
                rotate: None,
                size: None,
                radius: Some(20.0),
                tube: None,
                length: None,
                period: None,
                wall: None,
            }],
            ..MeshSource::default()
        },
        MeshSource {
            representation: Some(Representation::Triangles),
            ..MeshSource::of_file(bunny)
        },
    ];
    scene.mesh[2].place.size = Some(60.0);
    let assets = scenes::assets(&scene);
    let first = work_of(&mut renderer, &scene, &assets);
    assert!(
        first.field_uploads == 1 && first.cell_uploads >= 2 && first.map_uploads >= 2,
        "{first:?}"
    );
    let nothing = Work::default();
    let edits: [Edit; 9] = [
        ("nothing", |_| (), nothing),
        (
            "the camera",
            |s| s.camera.view = "35,15".parse().unwrap(),
            nothing,
        ),
        (
            "the light",
            |s| s.light.direction = Vec3::new(0.3, -0.5, 0.8).to_array(),
            nothing,
        ),
        (
            "a colour",
            |s| s.mesh[0].appearance.color = Some([0.2, 0.5, 0.9]),
            nothing,
        ),
        (
            "the solid's place",
            |s| s.mesh[1].shape[0].center = Some([58.0, 0.0, 0.0]),
            Work {
                cell_uploads: 1,
                ..nothing
            },
        ),
        (
            "a placement turned",
            |s| s.deformation[1].rotate = Some([0.0, 0.0, 10.0]),
            Work {
                cell_uploads: 2,
                ..nothing
            },
        ),
        (
            "a parameter of a map",
            |s| s.deformation[0].progress = Some(0.7),
            Work {
                cell_uploads: 2,
                map_uploads: 1,
                textures_created: 1,
                ..nothing
            },
        ),
        (
            "the surface's value",
            |s| s.mesh[0].iso = Some(600.0),
            Work {
                cell_uploads: 1,
                field_uploads: 1,
                textures_created: 1,
                bind_groups_created: 1,
                ..nothing
            },
        ),
        ("an object less", |s| drop(s.mesh.pop()), nothing),
    ];
    for (name, edit, allowed) in edits {
        edit(&mut scene);
        let mut work = work_of(&mut renderer, &scene, &assets);
        println!("{name}: {work:?}");
        // Cell grids follow the deformed boxes: a different size needs a new texture with its bind
        // group.
        let grids = work
            .textures_created
            .saturating_sub(allowed.textures_created)
            .min(work.cell_uploads);
        work.textures_created -= grids;
        work.bind_groups_created -= grids.min(
            work.bind_groups_created
                .saturating_sub(allowed.bind_groups_created),
        );
        assert_eq!(
            work,
            Work {
                cell_uploads: work.cell_uploads.min(allowed.cell_uploads),
                ..allowed
            },
            "{name}"
        );
        let prepared = Prepared::new(&scene, &assets).unwrap();
        let cached = renderer.render(&prepared, false, &Watch::NONE).unwrap().picture;
        let anew = Renderer::new(Device::open(AdapterPreference::Any).unwrap()).render(
            &Prepared::new(&scene, &scenes::assets(&scene)).unwrap(),
            false,
            &Watch::NONE,
        );
        assert!(
            cached == anew.unwrap().picture,
            "{name}: what is cached shows something else"
        );
        assert!(
            cached.pixels.iter().any(|p| p[3] > 0.0),
            "{name}: an empty picture"
        );
    }
}

/// Pre-integration and jitter: rays and slabs agree, as they use the same sample positions without
/// perspective; and with a fine step both settings converge to the plain picture.
pub fn segments_and_shifts_agree_between_modes() {
    let mut scene = Scene::of_volume("phantom:head-ct:size=64");
    scene.render.size = [96, 96];
    scene.camera.view = "40,20".parse().unwrap();
    scene.camera.projection = Projection::Orthographic;
    scene.deformation.push(Deformation::new("peel"));
    scene.transfer.preset = Some("ct-bones-and-muscle".into());
    let assets = scenes::assets(&scene);
    let picture = |preintegrated: bool, jitter: bool, mode: Mode, step: f32| -> Picture {
        let mut s = scene.clone();
        (
            s.render.preintegrated,
            s.render.jitter,
            s.render.mode,
            s.render.step,
        ) = (Some(preintegrated), jitter, mode, step);
        let prepared = Prepared::new(&s, &assets).unwrap();
        with_renderer(|r| r.render(&prepared, false, &Watch::NONE).unwrap()).picture
    };
    for (preintegrated, jitter) in [(true, false), (false, true), (true, true)] {
        let d = difference(
            &picture(preintegrated, jitter, Mode::Raycast, 1.0),
            &picture(preintegrated, jitter, Mode::Slice, 1.0),
        )
        .unwrap();
        println!(
            "segments {preintegrated}, shifted {jitter}: rays against slabs mean {:.3}/255, within 4/255 {:.3} %",
            d.mean / STEP,
            100.0 * d.within_4
        );
        assert!(
            d.mean <= 0.5 * STEP && d.within_4 >= 0.999,
            "{preintegrated} {jitter}: {}",
            d.mean / STEP
        );
        let plain = picture(false, false, Mode::Raycast, 1.0);
        let other = picture(preintegrated, jitter, Mode::Raycast, 1.0);
        assert!(plain != other, "the setting does nothing");
        let (fine, finer) = (
            picture(false, false, Mode::Raycast, 0.1),
            picture(preintegrated, jitter, Mode::Raycast, 0.1),
        );
        let d = difference(&fine, &finer).unwrap();
        println!(
            "segments {preintegrated}, shifted {jitter}: at a tenth of a voxel mean {:.3}/255 from single values",
            d.mean / STEP
        );
        assert!(
            d.mean <= 1.5 * STEP,
            "{preintegrated} {jitter}: {}",
            d.mean / STEP
        );
    }
}
