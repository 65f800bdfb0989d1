//! Stacks of many maps are composed within the requested bound, or else walked unchanged with a
//! notice; the picture is the same.
//!
//! `INCISE_STACKS` sets the number of random stacks (6 by default), `INCISE_STACKS_KEEP` a folder
//! in which failing ones are saved.

use crate::contract::points;
use crate::metrics::{STEP, difference};
use glam::Vec3;
use incise::Watch;
use incise::cpu;
use incise::deform::kinds;
use incise::math::Bounds;
use incise::picture::Picture;
use incise::prepare::{Assets, Prepared};
use incise::scene::{Deformation, Scene, Size};

/// A pseudo-random number generator.
struct Random(u64);

impl Random {
    fn share(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }
    fn below(&mut self, n: usize) -> usize {
        (self.share() * n as f32) as usize
    }
}

/// A scene of 2 to 20 deformations of random kinds and placements.
fn scene(n: u64) -> Scene {
    let mut r = Random(n.wrapping_mul(0x9e37_79b9_7f4a_7c15) + 7);
    for _ in 0..4 {
        r.share();
    }
    let all: Vec<_> = kinds::list().collect();
    let smooth = [
        "twist",
        "wave",
        "planar-wave",
        "bulge",
        "pull",
        "spline-pull",
        "bend",
        "taper",
        "shear",
    ];
    let mut scene = Scene::of_volume("phantom:tomato:size=48");
    scene.render.size = [64, 64];
    scene.camera.view = "40,25".parse().unwrap();
    // Some stacks contain only smooth kinds, so that they can be composed.
    let only_smooth = n.is_multiple_of(2);
    let count = 2 + r.below(if n.is_multiple_of(3) { 19 } else { 4 });
    while scene.deformation.len() < count {
        let kind = if only_smooth {
            kinds::kind(smooth[r.below(smooth.len())]).unwrap()
        } else {
            all[r.below(all.len())]
        };
        let bounds = Bounds::new(Vec3::splat(-50.0), Vec3::splat(50.0));
        let mut d = Deformation::new(kind.name);
        d.parameters = kind.example(&bounds);
        // Kinds that need a surface or labels do not apply to this volume.
        if matches!(
            kind.name,
            "strip" | "lift" | "offset" | "surface-peel" | "explode-labels" | "elastic" | "brush"
        ) && r.share() < 0.7
        {
            continue;
        }
        let mut spread = |to: f32| (r.share() - 0.5) * 2.0 * to;
        d.center = Some([spread(30.0), spread(30.0), spread(30.0)]);
        d.rotate = Some([spread(180.0), spread(90.0), spread(180.0)]);
        d.progress = Some(0.2 + 0.8 * r.share());
        d.resolution = Some(16 + r.below(24));
        if !matches!(kind.size, kinds::DefaultSize::Across(_)) {
            d.size = Some(Size::Box([
                60.0 + 90.0 * r.share(),
                60.0 + 90.0 * r.share(),
                60.0 + 90.0 * r.share(),
            ]));
        }
        d.add = !scene.deformation.is_empty() && r.share() < 0.1;
        scene.deformation.push(d);
    }
    scene
}

fn picture(prepared: &Prepared) -> Picture {
    cpu::render(prepared).picture
}

/// Fraction of pixels in which every channel differs by at most 8/255.
fn within_8(a: &Picture, b: &Picture) -> f64 {
    let alike = |(a, b): (&[f32; 4], &[f32; 4])| {
        a.iter()
            .zip(b)
            .all(|(x, y)| f64::from((x - y).abs()) <= 8.0 * STEP)
    };
    a.pixels.iter().zip(&b.pixels).filter(|p| alike(*p)).count() as f64 / a.pixels.len() as f64
}

pub fn random_stacks_keep_their_bound() {
    let count: u64 = std::env::var("INCISE_STACKS").map_or(6, |v| v.parse().unwrap());
    let (mut made, mut whole, mut as_they_are, mut fallback_share) = (0, 0, 0, 0.0);
    let mut complaints = Vec::new();
    for n in 0..count {
        let mut scene = scene(n);
        let assets = Assets::load(&scene).unwrap();
        // Kinds that conflict, or do not apply to this volume, are tested elsewhere.
        scene.render.exact_cuts = false;
        let Ok(exact) = Prepared::new(&scene, &assets) else {
            continue;
        };
        let bound = [0.25, 1.0][n as usize % 2];
        scene.render.precompose = Some(bound);
        let composed = Prepared::new(&scene, &assets).unwrap();
        let Some(c) = composed.composition else { continue };
        made += 1;
        if c.composed {
            whole += 1;
            fallback_share += c.fallback_share;
        } else {
            as_they_are += 1;
        }
        let mut complain = |what: String| complaints.push(format!("{n} ({c:?}): {what}"));
        if !c.composed && composed.notices.is_empty() {
            complain("not composed, and nothing is said".into());
        }
        let scene_box = assets.scene_box();
        let seen = |source: Vec3| scene_box.contains(&Bounds::new(source, source));
        let worst = points(100_000)
            .filter_map(|x| {
                // Points other than those that the program checks itself.
                let p = scene_box.center() + (Vec3::new(x.y, x.z, x.x) - 0.5) * scene_box.size() * 1.6;
                let ((a, alpha), (b, beta)) = (
                    exact.stack.source_and_alpha(p),
                    composed.stack.source_and_alpha(p),
                );
                (alpha >= 0.5 && beta >= 0.5 && (seen(a) || seen(b))).then(|| a.distance(b))
            })
            .fold(0.0, f32::max);
        if worst > bound {
            complain(format!("{worst} mm off"));
        }
        let (a, b) = (picture(&exact), picture(&composed));
        if let Ok(d) = difference(&a, &b) {
            let within = within_8(&a, &b);
            // Shifting an edge by a bound of half a voxel changes the pixels along it.
            if d.mean > STEP || within < if bound < 0.5 { 0.999 } else { 0.97 } {
                if let Some(folder) = std::env::var_os("INCISE_STACKS_KEEP") {
                    std::fs::write(
                        std::path::Path::new(&folder).join(format!("{n}.toml")),
                        scene.to_toml().unwrap(),
                    )
                    .unwrap();
                }
                complain(format!(
                    "mean {:.3}/255, {:.3} % within 8/255",
                    d.mean / STEP,
                    100.0 * within
                ));
            }
        }
    }
    let share = 100.0 * fallback_share / whole.max(1) as f32;
    println!(
        "{made} stacks: one map stands for {whole}, but for {share:.1} % of the space; {as_they_are} stayed as they were"
    );
    assert!(complaints.is_empty(), "{}", complaints.join("\n"));
    assert!(
        made * 2 >= count && whole > made / 3,
        "{made} {whole} {as_they_are}"
    );
}

/// Three rotated explosions must not be composed across their tears: that would exceed the bound of
/// a quarter of a millimetre without a notice.
pub fn tears_are_walked() {
    let mut scene = Scene::of_volume("phantom:tomato:size=64");
    for rotate in [[0.0, 0.0, 0.0], [20.0, 30.0, 0.0], [0.0, 40.0, 25.0]] {
        scene.deformation.push(Deformation {
            rotate: Some(rotate),
            ..Deformation::new("explode")
        });
    }
    scene.render.size = [96, 96];
    scene.render.precompose = Some(0.25);
    let assets = Assets::load(&scene).unwrap();
    let composed = Prepared::new(&scene, &assets).unwrap();
    let c = composed.composition.unwrap();
    println!("three turned explosions: {c:?}");
    assert!(
        if c.composed {
            c.worst_mm <= 0.25 && c.fallback_share > 0.02
        } else {
            composed.notices[0].contains("not precomposed")
        },
        "{c:?}"
    );
    scene.render.precompose = None;
    let exact = Prepared::new(&scene, &assets).unwrap();
    let d = difference(&picture(&composed), &picture(&exact)).unwrap();
    println!(
        "mean {:.4}/255, within 8/255: {:.3} %",
        d.mean / STEP,
        100.0 * within_8(&picture(&composed), &picture(&exact))
    );
    assert!(
        d.mean <= STEP && within_8(&picture(&composed), &picture(&exact)) >= 0.999,
        "{d:?}"
    );
}

/// Many maps, evaluated on the fly: the GPU's picture equals the CPU's, by slices and rays.
#[cfg(feature = "gpu")]
pub fn many_maps_agree() {
    use incise::scene::Mode;
    let mut scene = Scene::of_volume("phantom:tomato:size=64");
    scene.render.size = [128, 128];
    let kinds = [
        "wave",
        "twist",
        "pull",
        "seam",
        "knife",
        "slab",
        "peel",
        "book",
        "bulge",
        "planar-wave",
        "explode",
    ];
    for n in 0..25 {
        let mut d = Deformation::new(kinds[n % kinds.len()]);
        (d.progress, d.resolution) = (Some(0.15), Some(12 + 3 * (n % 9)));
        d.rotate = Some([13.0 * n as f32, 7.0 * n as f32, 29.0 * n as f32]);
        d.storage = [
            None,
            Some(incise::deform::Storage::F32),
            Some(incise::deform::Storage::Snorm16),
            Some(incise::deform::Storage::Snorm8),
        ][n % 4];
        scene.deformation.push(d);
    }
    let assets = Assets::load(&scene).unwrap();
    let little = Deformation {
        resolution: Some(8),
        progress: Some(0.02),
        ..Deformation::new("wave")
    };
    // Including the most that one pass supports.
    for (mode, count) in [(Mode::Raycast, 25), (Mode::Slice, 25), (Mode::Raycast, 64)] {
        scene.render.mode = mode;
        scene.deformation.resize(count, little.clone());
        let prepared = Prepared::new(&scene, &assets).unwrap();
        assert_eq!(
            (prepared.stack.maps().len(), prepared.composition.is_none()),
            (count, true)
        );
        let by_gpu =
            crate::parity::with_renderer(|r| r.render(&prepared, false, &Watch::NONE).unwrap()).picture;
        let d = difference(&picture(&prepared), &by_gpu).unwrap();
        println!(
            "{count} maps, {mode:?}: mean {:.4}/255, within 4/255: {:.3} %",
            d.mean / STEP,
            100.0 * d.within_4
        );
        assert!(d.mean <= 0.5 * STEP && d.within_4 >= 0.995, "{mode:?}: {d:?}");
    }
    // More than one pass supports is refused with one line, and the CPU renders it.
    scene.deformation.resize(70, little);
    let prepared = Prepared::new(&scene, &assets).unwrap();
    let refusal = crate::parity::with_renderer(|r| r.render(&prepared, false, &Watch::NONE).err())
        .map(|e| e.to_string())
        .unwrap_or_default();
    assert!(
        refusal.contains("70 deformations") && refusal.contains("at most 64"),
        "{refusal}"
    );
    assert!(!picture(&prepared).is_blank());
}
