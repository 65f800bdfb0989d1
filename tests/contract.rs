//! The contract of every kind of deformation (see src/deform/kinds/mod.rs), on the CPU;
//! tests/parity.rs covers the shaders.

use glam::{Affine3A, Mat3, Quat, Vec3};
use incise::deform::kinds::{self, Field, FieldInputs, Kind, Sampling};
use incise::deform::{Arguments, DisplacementMap, Library, PlacedMap, Placement, Storage};
use incise::math::Bounds;
use incise::volume::phantom;
use libtest_mimic::Trial;
use std::path::PathBuf;
use std::sync::{Arc, LazyLock};

pub const SIZE: Vec3 = Vec3::new(80.0, 64.0, 72.0);
pub const SAMPLING: Sampling = Sampling {
    resolution: None,
    storage: Storage::F16,
    min_ramp_mm: 3.0,
};

type Check = (&'static str, fn(&'static Kind));

pub fn trials() -> Vec<Trial> {
    let checks: [Check; 6] = [
        ("no_strength_is_the_identity", no_strength_is_the_identity),
        ("jacobian_is_the_derivative", jacobian_is_the_derivative),
        ("backward_undoes_forward", backward_undoes_forward),
        ("vanishes_on_the_faces_it_says", vanishes_on_the_faces_it_says),
        ("odd_input_gives_finite_values", odd_input_gives_finite_values),
        ("displacement_is_continuous", displacement_is_continuous),
    ];
    kinds::list()
        .flat_map(|kind| {
            checks.into_iter().map(move |(name, check)| {
                crate::trial(format!("contract::{}::{name}", kind.name), move || {
                    check(kind);
                    Ok(())
                })
            })
        })
        .collect()
}

/// The volume for kinds that follow a surface or labels: a head, centred on the box.
static LIBRARY: LazyLock<Library> = LazyLock::new(|| {
    Library::new(
        Arc::new(phantom::from_spec("head-ct:size=48").unwrap()),
        PathBuf::new(),
    )
});

/// The settings of a kind for a box of this size around the origin.
fn settings(kind: &Kind, size: Vec3) -> Arguments {
    kind.example(&Bounds::new(-size / 2.0, size / 2.0))
}

fn field(kind: &Kind, values: &[f32], progress: f32) -> Box<dyn Field> {
    let settings = settings(kind, SIZE);
    kind.field(
        values,
        progress,
        SIZE,
        &SAMPLING,
        &FieldInputs {
            settings: &settings,
            world_from_local: Affine3A::IDENTITY,
            cylinder: None,
            library: &LIBRARY,
        },
    )
    .unwrap()
}

fn map(kind: &Kind, values: &[f32], progress: f32, size: Vec3) -> DisplacementMap {
    let settings = settings(kind, size);
    kind.map(
        values,
        progress,
        size,
        &SAMPLING,
        &FieldInputs {
            settings: &settings,
            world_from_local: Affine3A::IDENTITY,
            cylinder: None,
            library: &LIBRARY,
        },
    )
    .unwrap()
}

fn defaults(kind: &Kind) -> Vec<f32> {
    kind.values([], SIZE).unwrap()
}

/// Points spread evenly over the box (a low-discrepancy sequence: the plastic number's powers).
pub fn points(n: usize) -> impl Iterator<Item = Vec3> {
    (0..n).map(|i| {
        let i = i as f64;
        let p = [
            0.819_172_513_396_164_4,
            0.671_043_606_703_789_3,
            0.549_700_477_901_970_2,
        ]
        .map(|a| ((0.5 + a * i).fract()) as f32);
        Vec3::from(p)
    })
}

fn no_strength_is_the_identity(kind: &'static Kind) {
    let map = map(kind, &defaults(kind), 0.0, SIZE);
    for x in points(2000) {
        let s = map.sample(x);
        assert!(
            s.displacement.abs().max_element() <= 1e-6,
            "{}: {:?} at {x}",
            kind.name,
            s
        );
        assert_eq!(s.alpha, 1.0, "{} at {x}", kind.name);
    }
}

/// In a rotated, anisotropic placement, away from cuts and from the kinks of the trilinear map.
fn jacobian_is_the_derivative(kind: &'static Kind) {
    let map = Arc::new(map(kind, &defaults(kind), 0.8, SIZE));
    let rotation = Mat3::from_quat(Quat::from_euler(glam::EulerRot::XYZ, 0.4, -0.7, 1.1));
    let linear = rotation * Mat3::from_diagonal(SIZE * kind.cube_scale);
    let placement = Placement::from_affine(Affine3A::from_mat3_translation(
        linear,
        Vec3::new(5.0, -3.0, 11.0),
    ))
    .unwrap();
    let placed = PlacedMap::new(map.clone(), placement);
    let texel_mm = (0..3)
        .filter(|&a| map.size[a] > 1)
        .map(|a| SIZE[a] / (map.size[a] - 1) as f32)
        .fold(0.0, f32::max);
    let (mut compared, mut close) = (0, 0);
    for x in points(4000) {
        if map.sample(x).alpha < 1.0 || x.min_element() < 0.05 || x.max_element() > 0.95 {
            continue;
        }
        let p = placement.world_from_map.transform_point3(x);
        let (j, _) = placed.derivatives(p).unwrap();
        let h = texel_mm;
        let numeric =
            Mat3::from_cols_array_2d(&[Vec3::X, Vec3::Y, Vec3::Z].map(|e| {
                ((placed.backward(p + e * h).0 - placed.backward(p - e * h).0) / (2.0 * h)).to_array()
            }));
        compared += 1;
        let error = (0..3)
            .map(|c| (j.col(c) - numeric.col(c)).length())
            .fold(0.0, f32::max);
        close += usize::from(error < 0.08);
    }
    assert!(compared > 100, "{}: only {compared} points", kind.name);
    assert!(
        close as f32 >= 0.95 * compared as f32,
        "{}: {close} of {compared}",
        kind.name
    );
}

/// The backward map of a forward-mapped point is present there and returns the source point.
fn backward_undoes_forward(kind: &'static Kind) {
    for progress in [0.35, 1.0] {
        let field = field(kind, &defaults(kind), progress);
        let mut seen = 0;
        for x in points(4000) {
            let source = (x - 0.5) * SIZE * kind.cube_scale;
            let Some(deformed) = field.forward(source) else {
                continue;
            };
            let inside = (deformed / (SIZE * kind.cube_scale)).abs().max_element() <= 0.5;
            let back = field.backward(deformed);
            if !inside || back.cut_distance_mm < 0.02 {
                // On the very edge of a cut, or moved out of the box through a face that the kind
                // lists.
                continue;
            }
            seen += 1;
            let error = back.source.distance(source);
            assert!(
                error < 2e-3,
                "{} at progress {progress}: {source} went to {deformed} and came back as {}",
                kind.name,
                back.source
            );
        }
        assert!(seen > 400, "{}: only {seen} points", kind.name);
    }
}

fn vanishes_on_the_faces_it_says(kind: &'static Kind) {
    // Also in a flat and a tall box: the shapes of some kinds follow the box's proportions.
    for size in [SIZE, Vec3::new(163.0, 152.0, 108.0), Vec3::new(60.0, 70.0, 140.0)] {
        vanishes_in_a_box(kind, size);
    }
}

fn vanishes_in_a_box(kind: &'static Kind, size: Vec3) {
    let map = map(kind, &kind.values([], size).unwrap(), 1.0, size);
    for (face, nonzero_faces) in kind.nonzero_faces.into_iter().enumerate() {
        let mut most = 0.0f32;
        for x in points(1500) {
            let mut x = x;
            x[face / 2] = (face % 2) as f32;
            most = most.max(map.sample(x).displacement.abs().max_element());
        }
        // The Gaussian pull has 0.2 % of its height at the sides.
        assert!(
            nonzero_faces || most <= 2.5e-3,
            "{}: {most} of the box on face {face}",
            kind.name
        );
    }
    if kind.varies == [true; 3] && kind.nonzero_faces == [false; 6] {
        // A kind that vanishes on all faces must not cut them either.
        for x in points(500) {
            for face in 0..6 {
                let mut x = x;
                x[face / 2] = (face % 2) as f32;
                assert!(map.sample(x).alpha > 0.5, "{}: cut at {x}", kind.name);
            }
        }
    }
}

fn odd_input_gives_finite_values(kind: &'static Kind) {
    let extremes = [0.0, 1.0].into_iter().flat_map(|progress| {
        kind.parameters.iter().flat_map(move |p| {
            [p.min, p.max]
                .map(|_| progress)
                .into_iter()
                .zip([true, false])
                .map(move |(progress, low)| (p.name, low, progress))
        })
    });
    for (name, low, progress) in extremes {
        let value = {
            // The limits of the range, parsed from the error for a value beyond them.
            let beyond = if low { -1e9 } else { 1e9 };
            let message = kind.values([(name, beyond)], SIZE).unwrap_err().to_string();
            let range = message.split("outside ").nth(1).unwrap();
            let mut ends = range.split(" to ");
            let (a, b) = (ends.next().unwrap(), ends.next().unwrap());
            let end = if low { a } else { b.split(' ').next().unwrap() };
            end.parse::<f32>().unwrap()
        };
        let values = kind.values([(name, value)], SIZE).unwrap();
        let field = field(kind, &values, progress);
        for x in points(300) {
            let b = field.backward((x - 0.5) * SIZE);
            assert!(
                b.source.is_finite() && !b.cut_distance_mm.is_nan(),
                "{} {name}={value} at {x}: {b:?}",
                kind.name
            );
        }
    }
    let field = field(kind, &defaults(kind), 1.0);
    for q in [
        Vec3::ZERO,
        SIZE / 2.0,
        -SIZE / 2.0,
        Vec3::new(0.0, 0.0, -SIZE.z / 2.0),
        Vec3::splat(1e-20),
    ] {
        let b = field.backward(q);
        assert!(
            b.source.is_finite() && !b.cut_distance_mm.is_nan(),
            "{} at {q}: {b:?}",
            kind.name
        );
    }
}

/// D must be continuous wherever alpha is present and within a texel of it; only the mask is
/// discontinuous.
fn displacement_is_continuous(kind: &'static Kind) {
    let field = field(kind, &defaults(kind), 0.8);
    let h = 0.01;
    for x in points(6000) {
        let q = (x - 0.5) * SIZE * 0.98;
        let here = field.backward(q);
        if here.cut_distance_mm < -0.5 {
            continue;
        }
        for e in [Vec3::X, Vec3::Y, Vec3::Z] {
            let there = field.backward(q + e * h);
            let jump = (there.source - here.source - e * h).length();
            assert!(
                jump < 60.0 * h,
                "{}: D jumps by {jump} mm at {q} (cut {})",
                kind.name,
                here.cut_distance_mm
            );
        }
    }
}
