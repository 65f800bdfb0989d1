//! Adaptive antialiasing: what it gains, what it costs, and that all renderers have it.

use crate::scenes;
use incise::picture::{Picture, Rendered};
use incise::prepare::Prepared;
use incise::scene::{Antialias, Mode, Scene};

fn rendered(scene: &Scene, antialias: Antialias) -> Rendered {
    let mut scene = scene.clone();
    scene.render.antialias = antialias;
    let assets = scenes::assets(&scene);
    incise::cpu::render(&Prepared::new(&scene, &assets).unwrap())
}

/// The mean difference of two pictures over a background, of 255, and the share of their pixels that
/// differ by more than 24.
fn apart(a: &Picture, b: &Picture, background: [f32; 4]) -> [f64; 2] {
    let (a, b) = (a.over(background), b.over(background));
    let all: Vec<u8> = a.iter().zip(&b).map(|(x, y)| x.abs_diff(*y)).collect();
    let mean = all.iter().map(|d| f64::from(*d)).sum::<f64>() / all.len() as f64;
    let far = all.chunks_exact(4).filter(|p| p.iter().any(|d| *d > 24)).count();
    [mean, 4.0 * far as f64 / all.len() as f64]
}

/// Against the average of 16 samples in every pixel: the error falls, hardly a pixel is visibly
/// off, and few more samples are taken.
pub fn adaptive_pictures_approach_the_average() {
    let mut ratios = Vec::new();
    for (name, mode) in [
        ("head-quadrant", Mode::Raycast),
        ("piggy-bank-4", Mode::Raycast),
        ("teddy-seam", Mode::Slice),
        ("bunny-twist", Mode::Surface),
    ] {
        let mut scene = scenes::load(name);
        scene.render.mode = mode;
        scene.render.size = [512, 512];
        let plain = rendered(&scene, Antialias::OFF);
        let adaptive = rendered(&scene, Antialias::Adaptive);
        let average = rendered(&scene, Antialias::Grid(4)).picture;
        let [[before, far_before], [after, far]] =
            [&plain, &adaptive].map(|r| apart(&r.picture, &average, scene.render.background));
        let samples = |r: &Rendered| r.stats.unwrap().samples_taken as f64;
        let ratio = samples(&adaptive) / samples(&plain);
        println!(
            "{name} {mode:?}: mean {before:.3} to {after:.3}/255, beyond 24/255 {:.3} to {:.3} %, {ratio:.2} times the samples",
            100.0 * far_before,
            100.0 * far
        );
        assert!(after < 0.9 * before, "{name}: {before} to {after}");
        assert!(
            far <= 0.0005 && far <= 0.2 * far_before,
            "{name}: {far_before} to {far}"
        );
        assert!(ratio > 1.0 && ratio < 2.2, "{name}: {ratio}");
        ratios.push(ratio);
    }
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    assert!(mean < 1.6, "{ratios:?}");
}

/// A picture does not depend on the number of threads, with antialiasing either.
pub fn adaptive_pictures_are_the_same_on_any_number_of_threads() {
    let mut scene = scenes::load("head-quadrant");
    scene.render.size = [160, 160];
    let with_threads = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| rendered(&scene, Antialias::Adaptive).picture)
    };
    assert!(with_threads(1) == with_threads(3));
}
