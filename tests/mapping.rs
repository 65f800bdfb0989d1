//! Maps wrapped around an axis, against closed forms: whatever made the map.

use crate::fields::stack_of;
use glam::{DAffine3, DVec3, Mat3, Vec3};
use incise::deform::mapping::Cylinder;
use incise::deform::{Arguments, Stack, saved};
use incise::prepare::Assets;
use incise::scene::{Deformation, Scene, Size};
use incise::volume::GridGeometry;
use incise::volume::save::{self, Content, Format};
use std::path::Path;

const BOX_MM: f32 = 100.0;
const RADIUS_MM: f32 = 50.0;
/// Along the map's z, which is twice the radius here.
const THICKNESS_MM: f32 = 20.0;
const GAP_MM: f32 = 8.0;

/// Where a shell at a radius comes from, the radius per radius there, and the distance to the nearest
/// gap, negative inside one; mm.
fn shell(radius_mm: f32) -> (f32, f32, f32) {
    let period = THICKNESS_MM + GAP_MM;
    let height = 2.0 * radius_mm + THICKNESS_MM / 2.0;
    let within = height.rem_euclid(period);
    let source = (height / period).floor() * THICKNESS_MM + within.min(THICKNESS_MM) - THICKNESS_MM / 2.0;
    let to_gap = if within <= THICKNESS_MM {
        within.min(THICKNESS_MM - within)
    } else {
        -(within - THICKNESS_MM).min(period - within)
    };
    let slope = if within <= THICKNESS_MM { 1.0 } else { 0.0 };
    (source / 2.0, slope, to_gap / 2.0)
}

/// A deformation about the origin in an oblique box.
fn placed(kind: &str, parameters: Arguments) -> Deformation {
    Deformation {
        center: Some([0.0; 3]),
        size: Some(Size::Cube(BOX_MM)),
        rotate: Some([30.0, -20.0, 50.0]),
        parameters,
        ..Deformation::new(kind)
    }
}

fn slab(mapping: &str) -> Deformation {
    let numbers = [("thickness", THICKNESS_MM), ("gap", GAP_MM), ("anchor", 0.0)];
    let mut parameters = Arguments::default();
    numbers
        .into_iter()
        .for_each(|(name, value)| parameters.insert(name, value));
    if !mapping.is_empty() {
        parameters.insert("mapping", mapping);
    }
    placed("slab", parameters)
}

fn of_file(kind: &str, path: &Path) -> Deformation {
    let mut parameters = Arguments::default();
    parameters.insert("path", path.to_str().unwrap());
    parameters.insert("mapping", "cylindrical");
    placed(kind, parameters)
}

fn stack(deformation: Deformation) -> Stack {
    let mut scene = Scene::of_volume("phantom:ball:size=32");
    scene.deformation = vec![deformation];
    let assets = Assets::load(&scene).unwrap();
    stack_of(&scene, &assets, None).0
}

/// Points over the cylinder, as radius, angle and height.
fn points() -> impl Iterator<Item = (f32, f32, f32)> {
    (0..2000).map(|n| {
        let [a, b, c] = [0.618_034, 0.754_877_7, 0.569_840_3].map(|s| (n as f32 * s).fract());
        (
            1.0 + a * (RADIUS_MM - 2.0),
            b * std::f32::consts::TAU,
            (c - 0.5) * 90.0,
        )
    })
}

/// Checks shells of a stack: sources within half a voxel of 1 mm, masks on the right side, normals of
/// gradients and of cuts within 3 degrees.
fn check_shells(stack: &Stack, what: &str, has_mask: bool) {
    let turn = Mat3::from(stack.maps()[0].placement.world_from_map.matrix3) / BOX_MM;
    let (mut worst, mut worst_degrees, mut cuts) = (0.0f32, 0.0f32, 0);
    for (radius, angle, height) in points() {
        let away = Vec3::new(angle.sin(), angle.cos(), 0.0);
        let p = turn * (away * radius + Vec3::Z * height);
        let (source_radius, slope, to_gap) = shell(radius);
        let want = turn * (away * source_radius + Vec3::Z * height);
        let (source, alpha) = stack.source_and_alpha_unclipped(p);
        worst = worst.max(source.distance(want));
        if has_mask && to_gap.abs() > 0.1 {
            assert_eq!(alpha >= 0.5, to_gap > 0.0, "{what}: radius {radius}: {alpha}");
        }
        // Derivatives reach over a texel to each side.
        if to_gap.abs() < 0.4 {
            continue;
        }
        let jet = stack.jet(p);
        let around = away.cross(Vec3::Z);
        let gradient = (turn * Vec3::new(0.3, 0.5, 0.8)).normalize();
        let local = turn.transpose() * gradient;
        let exact = turn
            * (away * (slope * local.dot(away))
                + around * (source_radius / radius * local.dot(around))
                + Vec3::Z * local.z);
        let got = jet.d_source_d_deformed.transpose() * gradient;
        worst_degrees = worst_degrees.max(got.angle_between(exact).to_degrees());
        if has_mask && jet.cut.distance_mm.abs() < 2.0 {
            let normal = turn.transpose() * jet.cut.normal;
            let off = normal
                .angle_between(away * normal.dot(away).signum())
                .to_degrees();
            assert!(off < 3.0, "{what}: normal of a cut off by {off} degrees");
            cuts += 1;
        }
    }
    println!(
        "{what}: source within {worst:.4} mm, normals within {worst_degrees:.3} degrees, {cuts} at cuts"
    );
    assert!(
        worst < 0.5 && worst_degrees < 3.0,
        "{what}: {worst} mm, {worst_degrees} degrees"
    );
    assert!(!has_mask || cuts > 200, "{what}: {cuts}");
    // Across the seam nothing jumps.
    for (radius, _, height) in points().take(200) {
        let at = |angle: f32| {
            let p = turn * Vec3::new(radius * angle.sin(), radius * angle.cos(), height);
            (p, stack.source_and_alpha_unclipped(p).0)
        };
        let ((p, a), (q, b)) = (at(-1e-4), at(1e-4));
        assert!(
            a.distance(b) <= 2.0 * p.distance(q) + 1e-3,
            "{what}: the seam tears at {radius}"
        );
    }
}

/// A slab mapped round its axis becomes concentric shells.
pub fn slabs_become_shells() {
    check_shells(&stack(slab("cylindrical")), "slab", true);
}

/// A saved map, and a field from a file, mapped round.
pub fn files_are_mapped_round() {
    let folder = tempfile::tempdir().unwrap();
    let flat = stack(slab(""));
    let map = folder.path().join("slab.nrrd");
    std::fs::write(&map, saved::encode(&flat.maps()[0]).unwrap()).unwrap();
    check_shells(&stack(of_file("map", &map)), "saved map", true);
    // The same displacement as another program would write it: a field over its own grid.
    let size = [2, 2, 401];
    let spacing = DVec3::new(100.0, 100.0, 0.25);
    let grid = GridGeometry {
        size,
        world_from_voxel: DAffine3::from_scale_rotation_translation(
            spacing,
            glam::DQuat::IDENTITY,
            DVec3::new(-50.0, -50.0, -50.0),
        ),
    };
    let mut values = Vec::new();
    for n in 0..size.iter().product::<usize>() {
        let height = (n / (size[0] * size[1])) as f32 * 0.25;
        let (source, ..) = shell(height / 2.0);
        values.extend([0.0, 0.0, 2.0 * source - height]);
    }
    let field = folder.path().join("field.nii.gz");
    std::fs::write(
        &field,
        save::encode(Format::NiftiGz, &grid, Content::Field, &values).unwrap(),
    )
    .unwrap();
    check_shells(&stack(of_file("field", &field)), "external field", false);
}

/// Bounds on boxes hold for the points of maps wrapped around an axis.
pub fn bounds_hold_round_an_axis() {
    let mut twisted = slab("cylindrical");
    twisted.name = Some("shells".into());
    let mut scene = Scene::of_volume("phantom:ball:size=32");
    let mut pull = placed("pull", Arguments::default());
    pull.parameters.insert("mapping", "cylindrical");
    scene.deformation = vec![twisted, pull];
    let assets = Assets::load(&scene).unwrap();
    let stack = stack_of(&scene, &assets, None).0;
    assert!(stack.maps().iter().all(|m| m.cylinder.is_some()));
    let slopes = incise::deform::lipschitz::LipschitzBounds::new(&stack);
    let (mut tight, mut tested) = (0.0f32, 0);
    for (n, (radius, angle, height)) in points().enumerate() {
        let low = Vec3::new(radius * angle.sin(), radius * angle.cos(), height);
        let edge = 0.5 + (n % 7) as f32;
        let b = incise::math::Bounds::new(low, low + edge);
        let (bounds, alpha) = stack.source_bounds(&b);
        let bound = slopes.bound(&b);
        let corners = b.corners();
        for (m, p) in corners.into_iter().chain([b.center()]).enumerate() {
            let (source, own) = stack.source_and_alpha_unclipped(p);
            assert!(
                bounds
                    .grown(1e-3)
                    .contains(&incise::math::Bounds::new(source, source)),
                "{p}: {source} {bounds:?}"
            );
            assert!(
                own >= alpha[0] - 1e-4 && own <= alpha[1] + 1e-4,
                "{p}: {own} {alpha:?}"
            );
            // The outer face tears.
            let holds = |p: Vec3| {
                stack.maps().iter().all(|map| {
                    let x = map.placement.map_from_world.transform_point3(p);
                    map.cylinder.is_some_and(|c| Cylinder::holds(c.map_from_cube(x)))
                })
            };
            if !corners.iter().all(|p| holds(*p)) {
                continue;
            }
            tested += 1;
            let q = corners[(m + 3) % 8];
            let apart = source.distance(stack.source_and_alpha_unclipped(q).0);
            assert!(
                apart <= bound * p.distance(q) * 1.001 + 1e-3,
                "{apart} apart, {bound} x {}",
                p.distance(q)
            );
        }
        tight = tight.max(edge / bounds.size().max_element());
    }
    assert!(tight > 0.2 && tested > 4000, "{tight} {tested}");
}

/// A displacement of more than half a turn: empty space loses nothing that shows.
pub fn more_than_half_a_turn_is_found() {
    let mut shear = Deformation::new("shear");
    shear.parameters.insert("angle", 60.0f32);
    shear.parameters.insert("mapping", "cylindrical");
    shear.size = Some(Size::Cube(130.0));
    let mut scene = Scene::of_volume("phantom:octants:size=48");
    scene.render.size = [100, 100];
    scene.deformation = vec![shear];
    let assets = Assets::load(&scene).unwrap();
    let stack = stack_of(&scene, &assets, None).0;
    let mut turned = 0;
    for (n, (radius, angle, height)) in points().enumerate() {
        let low = Vec3::new(radius * angle.sin(), radius * angle.cos(), height);
        let b = incise::math::Bounds::new(low, low + 1.0 + (n % 5) as f32);
        let bounds = stack.source_bounds(&b).0.grown(1e-2);
        for p in b.corners().into_iter().chain([b.center()]) {
            let source = stack.source_and_alpha_unclipped(p).0;
            turned += usize::from(source.distance(p) > 1.5 * p.truncate().length());
            assert!(
                bounds.contains(&incise::math::Bounds::new(source, source)),
                "{p}: {source} outside {bounds:?}"
            );
        }
    }
    assert!(turned > 100, "{turned} points turn far");
}

/// A map wrapped around an axis is saved as what it does, on a regular grid.
pub fn exports_keep_the_mapping() {
    let round = stack(slab("cylindrical"));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("round.nrrd");
    std::fs::write(&path, saved::encode(&round.maps()[0]).unwrap()).unwrap();
    let mut plain = of_file("map", &path);
    plain.parameters.0.remove("mapping");
    (plain.center, plain.size, plain.rotate) = (None, None, None);
    let read = stack(plain);
    assert!(read.maps()[0].cylinder.is_none());
    let mut errors: Vec<f32> = points()
        .map(|(radius, angle, height)| {
            let p = Vec3::new(radius * angle.sin(), radius * angle.cos(), height);
            let [a, b] = [&round, &read].map(|s| s.source_and_alpha_unclipped(p).0);
            a.distance(b)
        })
        .collect();
    errors.sort_by(f32::total_cmp);
    let [median, most] = [errors[errors.len() / 2], errors[errors.len() * 99 / 100]];
    println!("a saved round map: median {median:.3} mm, 99 % within {most:.3} mm");
    assert!(median < 0.1 && most < 1.0, "{median} {most}");
}

/// One file twice, at different stages and with a fade: two different maps.
pub fn one_file_at_two_stages() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("slab.nrrd");
    std::fs::write(&path, saved::encode(&stack(slab("")).maps()[0]).unwrap()).unwrap();
    let at = |progress: f32| {
        let mut d = of_file("map", &path);
        d.parameters.0.remove("mapping");
        d.parameters.insert("fade", 10.0f32);
        d.progress = Some(progress);
        d
    };
    let mut scene = Scene::of_volume("phantom:ball:size=32");
    scene.deformation = vec![at(1.0), at(0.3)];
    let assets = Assets::load(&scene).unwrap();
    let stack = stack_of(&scene, &assets, None).0;
    let [a, b] = [0, 1].map(|n| stack.maps()[n].map.scale);
    assert!((b / a - 0.3).abs() < 0.02, "{a} {b}");
}
