//! Deformations without numbers: every kind shows on every object from every side, and takes at
//! most a part of it. What cannot be placed says why.

use crate::defaults;
use glam::Vec3;
use incise::deform::file_kinds::FILE_KINDS;
use incise::deform::kinds;
use incise::picture::{Picture, Rendered};
use incise::prepare::placement::{placed, visible_object};
use incise::prepare::{Assets, Prepared, unseen_deformations};
use incise::scene::{Antialias, DefaultPlacement, Deformation, Mode, Scene, Size};
use incise::{Result, cpu};
use std::path::{Path, PathBuf};

const CAMERAS: [&str; 3] = ["anterior", "35,30", "left"];

/// Kinds that need more than numbers, and words of what is said about each.
const NEED_MORE: &[(&str, &str)] = &[
    ("points", "pairs"),
    ("lasso", "points"),
    ("brush", "neither moves nor cuts"),
    ("lattice", "offsets"),
    ("elastic", "grab"),
    ("explode-labels", "label"),
    ("field", "path"),
    ("map", "path"),
];
/// Kinds that follow a volume's surface, which a mesh does not have.
const FOLLOW_A_VOLUME: [&str; 4] = ["strip", "lift", "offset", "surface-peel"];

/// An object to deform: its name, scene and assets.
fn objects() -> Vec<(&'static str, Scene, Assets)> {
    let volumes = Path::new(env!("CARGO_MANIFEST_DIR")).join("volumes");
    let in_folder = |mut scene: Scene| {
        scene.folder.clone_from(&volumes);
        let assets = Assets::load(&scene).unwrap();
        (scene, assets)
    };
    let (head, head_assets) = in_folder(Scene::of_volume("phantom:head-ct:size=96"));
    let mut bunny = Scene::of_mesh("bunny.obj");
    bunny.mesh[0].place.rotate = Some([90.0, 0.0, 0.0]);
    let (bunny, bunny_assets) = in_folder(bunny);
    let brain = Assets::of_volume(defaults::bare_brain());
    let mut all = vec![
        ("head", head, head_assets),
        ("brain", Scene::of_volume("brain"), brain),
        ("bunny", bunny, bunny_assets),
    ];
    let thorax = "../shared/data/ct/ts_thorax_aorta_stent_ct.nii.gz";
    let path: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join(thorax);
    if path.exists() {
        let scene = Scene::of_volume(path.to_string_lossy());
        let assets = Assets::load(&scene).unwrap();
        all.push(("thorax", scene, assets));
    } else {
        println!("{thorax} is not here: it was not checked");
    }
    all
}

/// A scene from a camera, small.
fn seen_from(scene: &Scene, camera: &str) -> Scene {
    let mut scene = scene.clone();
    scene.camera.view = camera.parse().unwrap();
    // Seen along a diagonal, the box of a volume leaves a wide margin around its object.
    scene.camera.zoom = if camera == "35,30" { 1.3 } else { 1.0 };
    scene.render.size = [96, 96];
    scene.render.antialias = Antialias::OFF;
    scene
}

fn rendered(scene: &Scene, assets: &Assets) -> Result<(Rendered, Vec<String>)> {
    let prepared = Prepared::new(scene, assets)?;
    let unseen = unseen_deformations(&*placed(scene, assets)?, assets, &prepared)?;
    Ok((cpu::render(&prepared), unseen))
}

/// The mean difference of two pictures over black, in steps of 255.
fn mean(a: &Picture, b: &Picture) -> f64 {
    let of_pixel =
        |(p, q): (&[f32; 4], &[f32; 4])| (0..3).map(|c| f64::from((p[c] - q[c]).abs())).sum::<f64>();
    let sum: f64 = a.pixels.iter().zip(&b.pixels).map(of_pixel).sum();
    255.0 * sum / (3.0 * a.pixels.len() as f64)
}

/// The share of a picture's covered pixels that another does not cover.
fn gone(before: &Picture, after: &Picture) -> f64 {
    let covered = |p: &[f32; 4]| p[3] > 0.1;
    let all = before.pixels.iter().filter(|p| covered(p)).count();
    let pairs = before.pixels.iter().zip(&after.pixels);
    pairs.filter(|(b, a)| covered(b) && !covered(a)).count() as f64 / all as f64
}

/// One cell of the table: what a kind without numbers does to a view; an error is what is wrong.
fn cell(kind: &str, scene: &Scene, assets: &Assets, before: &Picture) -> Result<String, String> {
    let mut scene = scene.clone();
    scene.deformation.push(Deformation::new(kind));
    let needs = NEED_MORE.iter().find(|(name, _)| *name == kind).map(|n| n.1);
    let on_mesh = !assets.has_volume && FOLLOW_A_VOLUME.contains(&kind);
    let reason = match rendered(&scene, assets) {
        Ok((after, unseen)) => {
            let (mean, gone) = (mean(before, &after.picture), gone(before, &after.picture));
            match unseen.first() {
                Some(notice) if mean < 0.02 => notice.clone(),
                notice => {
                    let text = format!("{mean:.1}, {:.0} %", 100.0 * gone);
                    let is_good = mean >= 1.0 && gone <= 0.5 && notice.is_none();
                    let is_expected = needs.is_none() && !on_mesh;
                    return if is_good && is_expected {
                        Ok(text)
                    } else {
                        Err(text)
                    };
                }
            }
        }
        Err(error) => error.to_string(),
    };
    match needs {
        Some(word) if reason.contains(word) => Ok("says why".into()),
        _ if on_mesh => Ok("says why".into()),
        _ => Err(reason),
    }
}

/// Every kind without any number, on every object, from three cameras each: the picture changes by
/// at least one step of 255 on average, and at most half of the object is gone; or a line says why
/// not.
pub fn every_kind_shows_without_numbers() {
    let mut wrong = Vec::new();
    let names: Vec<&str> = kinds::list()
        .map(|k| k.name)
        .chain(FILE_KINDS.iter().map(|k| k.name))
        .collect();
    println!("mean difference in steps of 255, and the share of the object's pixels that is gone");
    for (object, scene, assets) in objects() {
        let views = CAMERAS.map(|camera| {
            let scene = seen_from(&scene, camera);
            let before = cpu::render(&Prepared::new(&scene, &assets).unwrap()).picture;
            (scene, before)
        });
        println!("\n| {object} | {} |\n|---|---|---|---|", CAMERAS.join(" | "));
        for kind in &names {
            let cells = views.iter().zip(CAMERAS).map(|((scene, before), camera)| {
                cell(kind, scene, &assets, before).unwrap_or_else(|problem| {
                    wrong.push(format!("{kind} on the {object}, {camera}: {problem}"));
                    format!("**{problem}**")
                })
            });
            println!("| {kind} | {} |", cells.collect::<Vec<_>>().join(" | "));
        }
    }
    assert!(wrong.is_empty(), "{} of them:\n{}", wrong.len(), wrong.join("\n"));
}

/// Where a deformation lies does not depend on how pictures are sampled.
pub fn sampling_moves_nothing() {
    let scene = Scene::of_volume("phantom:head-ct:size=48");
    let assets = Assets::load(&scene).unwrap();
    let mut own = seen_from(&scene, "35,30");
    own.deformation.push(Deformation::new("peel"));
    let first = placed(&own, &assets).unwrap().into_owned();
    let mut other = own.clone();
    (other.render.mode, other.render.step) = (Mode::Slice, 2.0);
    (other.render.empty_space_skipping, other.render.size) = (false, [300, 300]);
    (other.render.antialias, other.render.preintegrated) = (Antialias::Grid(2), Some(true));
    assert_eq!(placed(&other, &assets).unwrap().deformation, first.deformation);
}

/// A placed scene stays as it is when its camera turns, also across a file; and a number that is
/// stated is kept.
pub fn placed_numbers_stay() {
    let scene = Scene::of_volume("phantom:head-ct:size=48");
    let assets = Assets::load(&scene).unwrap();
    for kind in ["peel", "box", "wedge", "half-space", "twist", "view-cone"] {
        let mut own = seen_from(&scene, "35,30");
        own.deformation.push(Deformation::new(kind));
        let first = placed(&own, &assets).unwrap().into_owned();
        assert!(first.deformation[0].center.is_some(), "{kind}");
        let mut turned = Scene::from_toml(&first.to_toml().unwrap()).unwrap();
        turned.camera.view = "posterior".parse().unwrap();
        turned.camera.zoom = 3.0;
        let again = placed(&turned, &assets).unwrap();
        assert_eq!(again.deformation, first.deformation, "{kind}");
        // Another camera would have chosen other numbers.
        own.camera.view = "posterior".parse().unwrap();
        let other = placed(&own, &assets).unwrap();
        assert_eq!(other.deformation == first.deformation, kind == "twist", "{kind}");
    }
    let mut own = seen_from(&scene, "anterior");
    let mut stated = Deformation::new("peel");
    (stated.center, stated.progress) = (Some([1.0, 2.0, 3.0]), Some(0.4));
    own.deformation.push(stated);
    let mut stated = Deformation::new("knife");
    (stated.size, stated.rotate) = (Some(Size::Cube(40.0)), Some([0.0, 0.0, 30.0]));
    own.deformation.push(stated);
    let result = placed(&own, &assets).unwrap();
    let [peel, knife] = &result.deformation[..] else {
        panic!("two deformations")
    };
    assert_eq!((peel.center, peel.progress), (Some([1.0, 2.0, 3.0]), Some(0.4)));
    assert_eq!(
        (knife.size, knife.rotate),
        (Some(Size::Cube(40.0)), Some([0.0, 0.0, 30.0]))
    );
    assert!(peel.size.is_some() && knife.center.is_some());
}

/// A scene of version 1 has its boxes about the middle of the volume, as it did.
pub fn version_1_keeps_the_volumes_box() {
    let text = "incise = 1\n[volume]\npath = \"phantom:head-ct:size=32\"\n[[deformation]]\nkind = \"peel\"\n\
        [[deformation]]\nkind = \"twist\"\ncenter = [0.0, 0.0, 0.0]\nsize = 120.0\n";
    let scene = Scene::from_toml(text).unwrap();
    let rules: Vec<_> = scene.deformation.iter().map(|d| d.placement).collect();
    assert_eq!(rules, [DefaultPlacement::Volume, DefaultPlacement::Visible]);
    let assets = Assets::load(&scene).unwrap();
    assert_eq!(*placed(&scene, &assets).unwrap(), scene);
    let middle = assets.volume.bounds_in_world().center();
    let mut stated = scene.clone();
    stated.deformation[0].center = Some(middle.into());
    stated.deformation[0].size = Some(Size::Box(
        (assets.volume.bounds_in_world().size() * Vec3::new(0.8, 0.6, 0.5)).into(),
    ));
    let picture = |scene: &Scene| cpu::render(&Prepared::new(scene, &assets).unwrap()).picture;
    assert!(picture(&scene) == picture(&stated));
    let text = text.replace("incise = 1", "incise = 2");
    let visible = Scene::from_toml(&text).unwrap();
    assert!(picture(&visible) != picture(&scene));
}

/// The visible object of a ball is the ball, from any side.
pub fn what_is_visible_is_found() {
    let scene = Scene::of_volume("phantom:ball:size=64");
    let assets = Assets::load(&scene).unwrap();
    for camera in ["anterior", "superior", "35,30", "-120,-45"] {
        let object = visible_object(&seen_from(&scene, camera), &assets)
            .unwrap()
            .unwrap();
        let normal = object.normal(20.0);
        println!(
            "{camera}: {:?} {} {:.1}",
            object.bounds,
            object.point,
            object.extent_mm()
        );
        assert!(object.bounds.min.abs_diff_eq(Vec3::splat(-60.0), 4.0), "{camera}");
        assert!(object.bounds.max.abs_diff_eq(Vec3::splat(60.0), 4.0), "{camera}");
        assert!(
            (object.point.length() - 60.0).abs() < 3.0,
            "{camera}: {}",
            object.point
        );
        assert!(object.point.normalize().dot(normal) > 0.99, "{camera}: {normal}");
        assert!(object.point.normalize().dot(object.viewer) > 0.99, "{camera}");
        assert!((95.0..125.0).contains(&object.extent_mm()), "{camera}");
    }
}

/// A deformation that changes no pixel is named with the remedy; one that does is not.
pub fn what_is_not_seen_is_named() {
    let scene = Scene::of_volume("phantom:ball:size=64");
    let assets = Assets::load(&scene).unwrap();
    let notices = |change: &dyn Fn(&mut Deformation)| {
        let mut scene = seen_from(&scene, "anterior");
        let mut deformation = Deformation::new("box");
        (deformation.center, deformation.size) = (Some([0.0, -60.0, 0.0]), Some(Size::Cube(30.0)));
        change(&mut deformation);
        scene.deformation.push(deformation);
        let prepared = Prepared::new(&scene, &assets).unwrap();
        unseen_deformations(&scene, &assets, &prepared).unwrap()
    };
    assert_eq!(notices(&|_| ()), Vec::<String>::new());
    let inside = notices(&|d| d.center = Some([0.0; 3]));
    assert!(
        inside.len() == 1 && inside[0].contains("deformation 1 (box)") && inside[0].contains("behind"),
        "{inside:?}"
    );
    let beside = notices(&|d| d.center = Some([75.0, 75.0, 75.0]));
    assert!(beside.len() == 1 && beside[0].contains("neither"), "{beside:?}");
    let closed = notices(&|d| d.progress = Some(0.0));
    assert!(closed.len() == 1 && closed[0].contains("progress"), "{closed:?}");
    // A slit of two pixels is seen.
    let slit = notices(&|d| d.size = Some(Size::Box([80.0, 40.0, 3.0])));
    assert_eq!(slit, Vec::<String>::new());
}
