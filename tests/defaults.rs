//! What a newcomer sees first: the transfer function that is chosen for a scan.

use crate::scenes;
use glam::{DAffine3, DVec3, Vec3};
use incise::prepare::{Assets, Prepared};
use incise::scene::{Antialias, Projection, Scene};
use incise::transfer::RelativeTo;
use incise::volume::{Colors, Rescale, Volume, Voxels, phantom};
use serde_json::json;

const EDGE: usize = 72;

/// Noise of a standard deviation of about 1, by position.
fn noise(n: usize) -> f32 {
    let mut h = (n as u32).wrapping_mul(0x9E37_79B1) ^ 0x5bd1_e995;
    let mut sum = 0.0;
    for _ in 0..4 {
        h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
        sum += (h >> 8) as f32 / (1 << 24) as f32 - 0.5;
    }
    sum * 1.73
}

/// A volume of 1 mm voxels by a function of the position from its centre, with noise.
fn volume_of(of: impl Fn(Vec3) -> f32, sigma: f32) -> Vec<f32> {
    let middle = Vec3::splat((EDGE - 1) as f32 / 2.0);
    (0..EDGE * EDGE * EDGE)
        .map(|n| {
            let p = Vec3::new(
                (n % EDGE) as f32,
                (n / EDGE % EDGE) as f32,
                (n / EDGE / EDGE) as f32,
            );
            of(p - middle) + sigma * noise(n)
        })
        .collect()
}

fn bytes(values: Vec<f32>) -> Volume {
    let stored: Vec<u8> = values
        .into_iter()
        .map(|v| v.round().clamp(0.0, 255.0) as u8)
        .collect();
    volume(stored)
}

fn volume(values: impl Into<incise::volume::StoredValues>) -> Volume {
    Volume::new(
        Voxels::new([EDGE; 3], values),
        Rescale::NONE,
        DAffine3::from_translation(DVec3::splat(-((EDGE - 1) as f64) / 2.0)),
    )
}

fn in_ellipsoid(p: Vec3, half: Vec3) -> bool {
    (p / half).length_squared() < 1.0
}

/// A tooth in a holder: air around a cylinder of putty with the tooth in it.
fn tooth(p: Vec3) -> f32 {
    let across = p.truncate().length();
    match across {
        r if r < 14.0 - 0.08 * p.z.abs() && (-26.0..10.0).contains(&p.z) => 170.0,
        r if r < 14.0 && (10.0..26.0).contains(&p.z) => 235.0,
        r if r < 34.0 => 60.0,
        _ => 14.0,
    }
}

/// A tree in an opaque jar.
fn bonsai(p: Vec3) -> f32 {
    let across = p.truncate().length();
    let branch = (0..5).any(|n| {
        let turn = n as f32 * 1.256;
        let along = Vec3::new(turn.cos(), turn.sin(), 0.6).normalize();
        let from = Vec3::new(0.0, 0.0, -6.0 + 4.0 * n as f32);
        let t = (p - from).dot(along).clamp(0.0, 16.0);
        (p - from - along * t).length() < 2.5
    });
    match across {
        r if r < 4.0 && (-24.0..16.0).contains(&p.z) || branch => 150.0,
        r if r < 33.0 && p.z > -34.0 => 70.0,
        _ => 10.0,
    }
}

/// A head without a skull: grey and white matter, and nothing around them.
fn brain(p: Vec3) -> f32 {
    let folds = 2.0 * (0.5 * p.x).sin() * (0.45 * p.y).cos() * (0.5 * p.z).sin();
    match (p / Vec3::new(26.0, 31.0, 24.0)).length() {
        r if r < 0.75 + 0.02 * folds => 180.0,
        r if r < 1.0 + 0.02 * folds => 120.0,
        _ => 0.0,
    }
}

/// The volume of [`brain`].
pub fn bare_brain() -> Volume {
    bytes(volume_of(brain, 0.0))
}

/// A cell on the bright field of a microscope.
fn cell(p: Vec3) -> f32 {
    match p {
        p if in_ellipsoid(p - Vec3::new(4.0, 0.0, 2.0), Vec3::splat(8.0)) => 40.0,
        p if in_ellipsoid(p, Vec3::new(26.0, 20.0, 18.0)) => 120.0,
        _ => 222.0,
    }
}

/// Hounsfield units of a limb.
fn limb(p: Vec3) -> f32 {
    match p.truncate().length() {
        r if r < 4.0 => 300.0,
        r if r < 8.0 => 1200.0,
        r if r < 24.0 => 50.0,
        r if r < 27.0 => -90.0,
        _ => -1000.0,
    }
}

fn hot_spots(p: Vec3) -> f32 {
    let spot = |at: Vec3, r: f32| 1.0 / (1.0 + ((p - at).length() / r).powi(4));
    400.0 * spot(Vec3::ZERO, 12.0) + 900.0 * spot(Vec3::new(12.0, -6.0, 14.0), 5.0)
}

/// Scans of many kinds: name, voxels, and the preset they must get.
fn scans() -> Vec<(&'static str, Volume, &'static str)> {
    let words = |values: Vec<f32>, shift: f32| -> Vec<u16> {
        values
            .into_iter()
            .map(|v| (v + shift).round().max(0.0) as u16)
            .collect()
    };
    let mut inverted = bytes(volume_of(|p| 255.0 - brain(p), 3.0));
    inverted.inverted = true;
    let holes: Vec<f32> = volume_of(|p| 40.0 + brain(p), 2.0)
        .into_iter()
        .enumerate()
        .map(|(n, v)| if n % EDGE < 8 { f32::NAN } else { v })
        .collect();
    let mut pet = volume(volume_of(hot_spots, 6.0));
    pet.details.push(("modality", json!("PT")));
    let mut labels = volume(
        volume_of(brain, 0.0)
            .into_iter()
            .map(|v| (v / 60.0) as u8)
            .collect::<Vec<_>>(),
    );
    labels.declared_labels = true;
    // A stained section: brown on a nearly black background.
    let stain = volume_of(brain, 3.0);
    let mut colored = bytes(stain.iter().map(|v| 0.6 * v).collect());
    let channels = |v: &f32| [1.0, 0.5, 0.3].map(|c| (c * v).clamp(0.0, 255.0) as u8);
    colored.colors = Some(Colors::rgb(stain.iter().flat_map(channels).collect()));
    let shell = |p: Vec3| {
        if (22.0..25.0).contains(&p.length()) {
            900.0
        } else {
            200.0
        }
    };
    vec![
        ("tooth", bytes(volume_of(tooth, 5.0)), "mr-default"),
        ("bonsai", bytes(volume_of(bonsai, 5.0)), "mr-default"),
        (
            "brain",
            bytes(
                volume_of(brain, 0.0)
                    .iter()
                    .enumerate()
                    .map(|(n, v)| v + if *v > 0.0 { 6.0 * noise(n) } else { 0.0 })
                    .collect(),
            ),
            "mr-default",
        ),
        (
            "noisy brain",
            bytes(volume_of(|p| 20.0 + brain(p), 8.0)),
            "mr-default",
        ),
        ("cell", bytes(volume_of(cell, 5.0)), "mr-default"),
        ("limb", volume(volume_of(limb, 20.0)), "ct-bone"),
        (
            "shifted limb",
            volume(words(volume_of(limb, 12.0), 1024.0)),
            "ct-bone",
        ),
        (
            "raised floor",
            volume(volume_of(|p| 1000.0 + 3.0 * brain(p), 12.0)),
            "mr-default",
        ),
        ("inverted brain", inverted, "mr-default"),
        ("holes", volume(holes), "mr-default"),
        ("shell", volume(volume_of(shell, 20.0)), "mr-default"),
        ("uptake", pet, "pet-hot"),
        ("labels", labels, "labels"),
        ("colours", colored, "color"),
    ]
}

/// The share of a volume's silhouette, seen from the front without perspective, that its picture
/// covers; and how many of the four corners are covered.
fn covered(scene: &mut Scene, assets: &Assets) -> (f64, usize) {
    scene.camera.projection = Projection::Orthographic;
    scene.render.size = [200, 200];
    scene.render.antialias = Antialias::OFF;
    let prepared = Prepared::new(scene, assets).unwrap();
    let picture = incise::cpu::render(&prepared).picture;
    let bounds = assets.volume.bounds_in_world();
    let [[left, right], [top, bottom]] = prepared.frame.view.pixels_of(&bounds, [200, 200]);
    // The range has two pixels more on each side.
    let (left, right, top, bottom) = (left + 3, right - 4, top + 3, bottom - 4);
    let shown = |x: usize, y: usize| picture.pixels[y * 200 + x][3] > 0.1;
    let all = (top..=bottom).flat_map(|y| (left..=right).map(move |x| (x, y)));
    let count = all.clone().filter(|&(x, y)| shown(x, y)).count();
    let corners = [(left, top), (right, top), (left, bottom), (right, bottom)];
    (
        count as f64 / all.count() as f64,
        corners.into_iter().filter(|&(x, y)| shown(x, y)).count(),
    )
}

/// The first picture of any scan shows its object: neither nothing nor a box.
pub fn the_first_picture_shows_the_object() {
    let mut all = scans();
    let head = scenes::load("head-peel");
    let loaded = Assets::load(&head).unwrap();
    all.push(("head", (*loaded.volume).clone(), "mr-default"));
    for (name, volume, preset) in all {
        let mut scene = Scene::of_volume(name);
        let suitable = scene.suitable_preset(&volume);
        let assets = Assets::of_volume(volume);
        let (share, corners) = covered(&mut scene, &assets);
        println!(
            "{name}: {} ({}); {:.0} % of the silhouette, {corners} corners",
            suitable.name,
            suitable.reason,
            100.0 * share
        );
        assert_eq!(suitable.name, preset, "{name}");
        // The head is cropped: its neck reaches the lower corners.
        let [most, cropped] = if name == "head" { [0.9, 2.0] } else { [0.8, 0.0] };
        assert!(corners as f64 <= cropped, "{name}: a corner of its box is shown");
        assert!((0.05..=most).contains(&share), "{name}: {share}");
    }
}

/// Values relative to the whole range, as scenes of version 1 have them, show the block of air.
pub fn the_range_alone_shows_a_box() {
    for (name, of) in [("tooth", tooth as fn(Vec3) -> f32), ("bonsai", bonsai)] {
        let assets = Assets::of_volume(bytes(volume_of(of, 5.0)));
        let mut scene = Scene::of_volume(name);
        scene.transfer.relative_to = RelativeTo::Range;
        let (share, _) = covered(&mut scene, &assets);
        assert!(share > 0.8, "{name}: {share}");
    }
}

/// Hounsfield units are recognised where they were shifted to be positive, and nowhere else.
pub fn shifted_hounsfield_units_are_recognised() {
    let zero = |name: &str| {
        let found = scans().into_iter().find(|(n, ..)| *n == name).unwrap();
        found.1.hounsfield_zero()
    };
    assert_eq!(zero("limb"), Some(0.0));
    assert_eq!(zero("shifted limb"), Some(1024.0));
    for other in ["tooth", "brain", "raised floor", "shell", "uptake", "cell"] {
        assert_eq!(zero(other), None, "{other}");
    }
    let ct = phantom::from_path("phantom:head-ct:size=32").unwrap().unwrap();
    assert_eq!(ct.hounsfield_zero(), Some(0.0));
}
