//! The time of a picture against the size of the volume and of the picture, and the upper limit:
//! the number of trilinear samples that this machine can fetch.
//!
//! `cargo bench --bench growth [-- FOLDER]` prints a table and writes `growth.html` (plots) and
//! `growth.csv` (to `target/growth` without a folder). Volumes of 64^3 to 512^3 at 512 x 512
//! pixels, pictures of 256^2 to 2048^2 of a volume of 256^3; medians of five with the least and the
//! greatest.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a benchmark that cannot set up should stop"
)]

use glam::Vec3;
use incise::compare::plot::{Dot, PlotAxis, PlotSeries, STYLE, curves};
use incise::cpu;
use incise::math::lanes::*;
use incise::prepare::{Assets, Prepared};
use incise::scene::{Deformation, Mode, Scene};
use incise::volume::VolumeSampler;
use rayon::prelude::*;
use std::fmt::Write as _;
use std::time::Instant;

/// Samples per task of the fetch limit.
const SAMPLES: usize = 1 << 20;

fn milliseconds(mut work: impl FnMut()) -> [f64; 3] {
    work();
    let mut times: Vec<f64> = (0..5)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    [times[0], times[2], times[4]]
}

/// Fetches samples along lines through the volume, one voxel apart, as rays do, and nothing else.
struct Fetch<'a>(&'a VolumeSampler<'a>, usize);

impl SimdKernel for Fetch<'_> {
    type Output = f32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f32 {
        let n = self.1 as f32;
        let mut sum = f32x8::splat(simd, 0.0);
        for i in 0..SAMPLES / LANES {
            let along = (i % 200) as f32 + 10.0;
            let across = (i / 200 % 200) as f32 + 10.0;
            let mut points = [Vec3::ZERO; LANES];
            for (lane, p) in points.iter_mut().enumerate() {
                *p = Vec3::new(
                    across + (lane % 4) as f32 * 0.7,
                    along * 0.6 + (lane / 4) as f32 * 0.7 + n,
                    along,
                );
            }
            sum += self.0.sample_lanes(simd, Vec3x8::from_lanes(simd, &points));
        }
        sum.as_slice().iter().sum()
    }
}

fn ceiling(assets: &Assets) {
    let sampler = VolumeSampler::new(assets.grid());
    let tasks = 8 * rayon::current_num_threads();
    let [_, ms, _] = milliseconds(|| {
        let sum: f32 = (0..tasks)
            .into_par_iter()
            .map(|n| with_simd(Fetch(&sampler, n % 8)))
            .sum();
        assert!(sum.is_finite());
    });
    println!(
        "ceiling: {:.0} million trilinear samples a second on {} threads",
        (tasks * SAMPLES) as f64 / ms / 1e3,
        rayon::current_num_threads()
    );
}

fn scene(volume: usize, picture: u32, name: &str) -> Scene {
    let mut scene = Scene::of_volume(format!("phantom:head-ct:size={volume}"));
    scene.render.size = [picture; 2];
    scene.camera.view = "40,20".parse().expect("a view");
    scene.render.mode = if name == "slices" {
        Mode::Slice
    } else {
        Mode::Raycast
    };
    if name == "rays, twisted" {
        scene.deformation.push(Deformation::new("twist"));
    }
    scene
}

fn main() {
    let folder = std::env::args()
        .skip(1)
        .find(|a| !a.starts_with('-'))
        .map_or_else(|| "target/growth".into(), std::path::PathBuf::from);
    std::fs::create_dir_all(&folder).expect("a folder");
    let names = ["rays", "slices", "rays, twisted"];
    let mut csv =
        String::from("what,volume,picture,least_ms,median_ms,greatest_ms,million_samples_per_second\n");
    let mut page =
        format!("<!doctype html><meta charset=\"utf-8\"><title>Growth</title><style>{STYLE}</style>");
    let by_volume: Vec<(usize, u32)> = [64, 128, 256, 512].map(|n| (n, 512)).into();
    let by_picture: Vec<(usize, u32)> = [256, 512, 1024, 2048].map(|n| (256, n)).into();
    for (title, label, cases) in [
        (
            "Time by volume, 512 x 512 pixels",
            "voxels along an edge",
            by_volume,
        ),
        (
            "Time by picture, 256^3 voxels",
            "pixels along an edge",
            by_picture,
        ),
    ] {
        let mut series: Vec<PlotSeries> = names
            .iter()
            .enumerate()
            .map(|(color, n)| PlotSeries {
                name: (*n).into(),
                color,
                dashed: false,
                dots: Vec::new(),
            })
            .collect();
        for &(volume, picture) in &cases {
            let assets = Assets::load(&scene(volume, picture, "rays")).expect("a phantom");
            if volume == 256 && picture == 512 {
                ceiling(&assets);
            }
            for (name, series) in names.iter().zip(&mut series) {
                let prepared = Prepared::new(&scene(volume, picture, name), &assets).expect("a scene");
                let mut taken = 0;
                let [least, median, greatest] =
                    milliseconds(|| taken = cpu::render(&prepared).stats.map_or(0, |s| s.samples_taken));
                let rate = taken as f64 / median / 1e3;
                println!(
                    "{name}, {volume}^3, {picture} x {picture}: {median:.1} ms ({least:.1} to {greatest:.1}), {rate:.0} million samples a second"
                );
                writeln!(
                    csv,
                    "\"{name}\",{volume},{picture},{least:.2},{median:.2},{greatest:.2},{rate:.1}"
                )
                .expect("text");
                let x = if label.starts_with("voxels") {
                    volume as f64
                } else {
                    f64::from(picture)
                };
                series.dots.push(Dot {
                    x,
                    y: median,
                    spread: Some([least, greatest]),
                });
            }
        }
        let ticks = series[0].dots.iter().map(|d| d.x).collect();
        page.push_str(&curves(
            title,
            &PlotAxis {
                label: label.into(),
                ticks,
            },
            &PlotAxis {
                label: "milliseconds".into(),
                ticks: Vec::new(),
            },
            &series,
            None,
        ));
    }
    std::fs::write(folder.join("growth.csv"), csv).expect("a file");
    std::fs::write(folder.join("growth.html"), page).expect("a file");
}
