//! The CPU renderer against closed forms.

use crate::contract::points;
use crate::metrics::{STEP, difference};
use glam::{Affine3A, EulerRot, Mat3, Quat, Vec3};
use incise::cpu::{self, shading};
use incise::deform::{DisplacementMap, Jet, PlacedMap, Placement, Storage, TexelSample};
use incise::picture::Picture;
use incise::prepare::{Assets, PrepareOptions, Prepared};
use incise::scene::{Deformation, Mode, Normals, Projection, Scene, Size};
use incise::transfer::{Blend, ControlPoint};
use incise::volume::phantom::{self, BALL_RADIUS_MM};
use incise::volume::{Rescale, Volume, VolumeSampler, VoxelGrid, Voxels};
use std::sync::Arc;

pub fn assets(volume: Volume) -> Assets {
    Assets::of_volume(volume)
}

pub fn picture(prepared: &Prepared) -> Picture {
    cpu::render(prepared).picture
}

fn ball(size: usize) -> Assets {
    assets(phantom::generate("ball", [size; 3], Vec3::splat(160.0 / size as f32)).unwrap())
}

fn curve(points: &[(f64, f32)]) -> Vec<ControlPoint> {
    points
        .iter()
        .map(|&(value, opacity)| ControlPoint {
            value,
            color: [0.8, 0.7, 0.5],
            opacity,
        })
        .collect()
}

fn scene(points: &[(f64, f32)]) -> Scene {
    let mut scene = Scene::of_volume("phantom:ball");
    scene.transfer.points = curve(points);
    scene.render.size = [160, 160];
    scene
}

fn deformation(kind: &str, center: [f32; 3], size: [f32; 3], rotate: [f32; 3]) -> Deformation {
    Deformation {
        center: Some(center),
        size: Some(Size::Box(size)),
        rotate: Some(rotate),
        ..Deformation::new(kind)
    }
}

fn placed(map: DisplacementMap, placement: Placement) -> PlacedMap {
    PlacedMap::new(Arc::new(map), placement)
}

fn angle_deg(a: Vec3, b: Vec3) -> f32 {
    a.normalize()
        .dot(b.normalize())
        .clamp(-1.0, 1.0)
        .acos()
        .to_degrees()
}

/// With opacity a per voxel, a chord of length c voxels has the transmittance (1 - a)^c.
pub fn transmittance_of_a_uniform_ball() {
    let assets = ball(160);
    let opacity = 0.02f64;
    for mode in [Mode::Raycast, Mode::Slice] {
        for projection in [Projection::Orthographic, Projection::Perspective] {
            for step in [1.0, 0.5] {
                let mut s = scene(&[(0.0, 0.0), (1.0, opacity as f32)]);
                s.render.mode = mode;
                s.render.step = step;
                s.camera.projection = projection;
                s.camera.view = "30,20".parse().unwrap();
                let prepared = Prepared::new(&s, &assets).unwrap();
                let p = picture(&prepared);
                let mut worst = 0.0f64;
                for (n, pixel) in p.pixels.iter().enumerate() {
                    let u = (n % 160) as f32 / 80.0 + 1.0 / 160.0 - 1.0;
                    let v = 1.0 - (n / 160) as f32 / 80.0 - 1.0 / 160.0;
                    let (origin, direction) = prepared.frame.view.ray(u, v);
                    let miss = (-origin).reject_from(direction).length();
                    if miss > 0.92 * BALL_RADIUS_MM {
                        continue;
                    }
                    let chord = 2.0 * f64::from((BALL_RADIUS_MM.powi(2) - miss * miss).sqrt());
                    let want = (1.0 - opacity).powf(chord);
                    worst = worst.max(((1.0 - f64::from(pixel[3])) / want - 1.0).abs());
                }
                println!(
                    "transmittance of the ball, {mode:?} {projection:?} step {step}: off by at most {:.3} %",
                    100.0 * worst
                );
                assert!(
                    worst > 0.0 && worst < 0.005,
                    "{mode:?} {projection:?} step {step}: {worst}"
                );
            }
        }
    }
}

pub fn identity_map_changes_nothing() {
    let assets = assets(phantom::generate("tomato", [96; 3], Vec3::splat(160.0 / 96.0)).unwrap());
    for mode in [Mode::Raycast, Mode::Slice] {
        let mut s = Scene::of_volume("phantom:tomato");
        s.render.size = [200, 200];
        s.render.mode = mode;
        s.camera.view = "30,20".parse().unwrap();
        let placement = Placement::new(
            Vec3::new(10.0, 20.0, 0.0),
            Vec3::new(120.0, 150.0, 200.0),
            Vec3::new(20.0, 30.0, 40.0),
        )
        .unwrap();
        let with = Prepared::with(
            &s,
            &assets,
            &PrepareOptions::with_maps(&[placed(DisplacementMap::identity([9, 8, 7]), placement)]),
        )
        .unwrap();
        let d = difference(&picture(&Prepared::new(&s, &assets).unwrap()), &picture(&with)).unwrap();
        println!("identity map, {mode:?}: max {:.4}/255", d.max / STEP);
        assert!(d.max <= STEP, "{mode:?} {d:?}");
    }
}

pub fn translation_as_a_map_is_a_translation() {
    let shift = Vec3::new(7.3, -4.6, 3.2);
    let volume = phantom::generate("teddy", [96; 3], Vec3::splat(160.0 / 96.0)).unwrap();
    let mut moved = volume.clone();
    moved.world_from_voxel.translation += shift.as_dvec3();
    let mut s = Scene::of_volume("phantom:teddy");
    s.render.size = [256, 256];
    s.camera.view = "30,20".parse().unwrap();
    s.camera.target = Some([0.0; 3]);
    let edge = 400.0;
    let map = DisplacementMap::from_fn([4, 4, 4], Storage::F16, |_| TexelSample {
        displacement: -shift / edge,
        alpha: 1.0,
    });
    let map = placed(
        map,
        Placement::new(Vec3::ZERO, Vec3::splat(edge), Vec3::ZERO).unwrap(),
    );
    let (still, moved) = (assets(volume), assets(moved));
    let by_map = picture(&Prepared::with(&s, &still, &PrepareOptions::with_maps(&[map])).unwrap());
    let by_volume = picture(&Prepared::new(&s, &moved).unwrap());
    let unmoved = picture(&Prepared::new(&s, &still).unwrap());
    let d = difference(&by_map, &by_volume).unwrap();
    println!("translation as a map: PSNR {:.1} dB", d.psnr);
    assert!(d.psnr >= 45.0, "{d:?}");
    assert!(
        difference(&by_map, &unmoved).unwrap().psnr < 30.0,
        "the map moved nothing"
    );
}

/// The renderer's normal at a point of the deformed scene; none where the point is cut away.
fn normal_at(prepared: &Prepared, grid: &VoxelGrid, deformed: Vec3, with_cut: bool) -> Option<Vec3> {
    let jet = prepared.stack.jet(deformed);
    if jet.alpha < 0.5 {
        return None;
    }
    let in_voxel = prepared.volume().voxel_from_world.transform_point3(jet.source);
    let gradient = VolumeSampler::new(grid).gradient(in_voxel, prepared.gradient_filter());
    let gradient = shading::world_from_voxel_covector(prepared, gradient);
    let cut = if with_cut {
        shading::nearer_cut_shape(prepared, shading::nearest_cut(prepared, &jet, in_voxel), deformed)
    } else {
        incise::deform::NearestCut::NONE
    };
    Some(shading::shaded_normal(prepared, &jet.d_source_d_deformed, gradient, &cut, Vec3::ZERO).normal)
}

/// A volume of a closed-form field, sampled at 128³ points 1.25 mm apart around the origin. The
/// fields are smooth, so that the test covers the transformation of normals and not the gradient
/// stencil.
fn field_volume(f: impl Fn(Vec3) -> f32) -> Assets {
    let n = 128;
    let at = |i: usize| (i as f32 - 63.5) * 1.25;
    let voxels: Vec<f32> = (0..n * n * n)
        .map(|i| f(Vec3::new(at(i % n), at(i / n % n), at(i / n / n))))
        .collect();
    let world_from_voxel = glam::DAffine3 {
        matrix3: glam::DMat3::from_diagonal(glam::DVec3::splat(1.25)),
        translation: glam::DVec3::splat(-63.5 * 1.25),
    };
    assets(Volume::new(
        Voxels::new([n; 3], voxels),
        Rescale::NONE,
        world_from_voxel,
    ))
}

/// p = p' + A (S - I) A⁻¹ (p' - c): the ball becomes an ellipsoid whose normal, transformed by SᵀS,
/// has a closed form.
pub fn normals_under_linear_maps() {
    // A ball whose edge is six voxels wide.
    let assets = field_volume(|p| (0.5 + (BALL_RADIUS_MM - p.length()) / 7.5).clamp(0.0, 1.0));
    let cases = [
        (
            "rotation",
            Mat3::from_rotation_z(0.5) * Mat3::from_rotation_x(0.3),
        ),
        ("scale", Mat3::from_diagonal(Vec3::new(1.4, 0.8, 1.1))),
        (
            "shear",
            Mat3::from_cols(Vec3::X, Vec3::new(0.4, 1.0, 0.0), Vec3::new(0.0, -0.3, 1.0)),
        ),
    ];
    let rotation = Mat3::from_quat(Quat::from_euler(EulerRot::XYZ, 0.5, -0.8, 0.3));
    let linear = rotation * Mat3::from_diagonal(Vec3::new(300.0, 220.0, 260.0));
    let center = Vec3::new(4.0, -3.0, 2.0);
    let placement = Placement::from_affine(Affine3A::from_mat3_translation(
        linear,
        center - linear * Vec3::splat(0.5),
    ))
    .unwrap();
    for (name, in_map) in cases {
        // D(x) = (L - I)(x - 1/2) in map space; its Jacobian in the world is S = A L A⁻¹.
        let map = DisplacementMap::from_fn([33; 3], Storage::F16, |x| TexelSample {
            displacement: (in_map - Mat3::IDENTITY) * (x - 0.5),
            alpha: 1.0,
        });
        let prepared = Prepared::with(
            &scene(&[(0.0, 0.0), (1.0, 0.9)]),
            &assets,
            &PrepareOptions::with_maps(&[placed(map, placement)]),
        )
        .unwrap();
        let s = linear * in_map * linear.inverse();
        let backward = |p: Vec3| center + s * (p - center);
        let (mut seen, mut worst) = (0, 0.0f32);
        for x in points(1500) {
            let on_sphere = (x - 0.5).normalize_or(Vec3::X) * BALL_RADIUS_MM;
            let deformed = center + s.inverse() * (on_sphere - center);
            assert!(backward(deformed).distance(on_sphere) < 1e-2);
            if (placement.map_from_world.transform_point3(deformed) - 0.5)
                .abs()
                .max_element()
                > 0.49
            {
                continue;
            }
            seen += 1;
            let want = s.transpose() * on_sphere;
            let got = normal_at(&prepared, assets.grid(), deformed, false).unwrap();
            let off = angle_deg(got, want);
            worst = worst.max(off);
            assert!(off <= 2.0, "{name}: {off} degrees at {deformed}");
        }
        println!("normals under a {name}: off by at most {worst:.2} degrees");
        assert!(seen > 1000, "{name}: {seen}");
    }
}

pub fn normals_under_a_twist() {
    // Structures about 30 mm across.
    let assets =
        field_volume(|p| 0.5 + (p.x * 0.11).sin() * (p.y * 0.09 + 0.4).sin() * (p.z * 0.1 + 0.9).cos() * 0.5);
    let mut s = scene(&[(0.0, 0.0), (1.0, 0.9)]);
    s.light.two_sided = false;
    s.deformation.push(Deformation {
        parameters: [("angle", 80.0.into())].into(),
        ..deformation("twist", [0.0; 3], [260.0, 260.0, 170.0], [10.0, 0.0, 0.0])
    });
    let prepared = Prepared::new(&s, &assets).unwrap();
    let sampler = VolumeSampler::new(assets.grid());
    let field = |p: Vec3| {
        let source = prepared.stack.source_from_deformed(p).unwrap();
        sampler.sample(prepared.volume().voxel_from_world.transform_point3(source))
    };
    let (mut seen, mut close) = (0, 0);
    for x in points(20_000) {
        let p = (x - 0.5) * 130.0;
        let h = 1.25;
        let central = Vec3::new(
            field(p + Vec3::X * h) - field(p - Vec3::X * h),
            field(p + Vec3::Y * h) - field(p - Vec3::Y * h),
            field(p + Vec3::Z * h) - field(p - Vec3::Z * h),
        );
        // Only where the normal is well defined; the steepest slopes are 0.13 over these distances.
        if central.length() < 0.02 || prepared.stack.jet(p).source.abs().max_element() > 76.0 {
            continue;
        }
        seen += 1;
        close +=
            usize::from(angle_deg(normal_at(&prepared, assets.grid(), p, false).unwrap(), -central) <= 3.0);
    }
    println!(
        "normals under a twist: {:.2} % within 3 degrees",
        100.0 * close as f64 / seen as f64
    );
    assert!(
        seen > 5000 && close as f64 >= 0.95 * seen as f64,
        "{close} of {seen}"
    );
}

/// In a uniform solid, only the cut has a normal.
pub fn normals_on_cut_faces() {
    let uniform = Volume::new(
        Voxels::new([64; 3], vec![1.0f32; 64 * 64 * 64]),
        Rescale::NONE,
        glam::DAffine3::from_translation(glam::DVec3::splat(-31.5)),
    );
    let assets = assets(uniform);
    for exact in [false, true] {
        faces(&assets, exact);
    }
}

/// With cuts as masks or as exact shapes.
fn faces(assets: &Assets, exact: bool) {
    let rotate = [25.0, -40.0, 15.0];
    let turned = Mat3::from_quat(Quat::from_euler(
        EulerRot::ZYX,
        15f32.to_radians(),
        (-40f32).to_radians(),
        25f32.to_radians(),
    ));
    let face = |kind: &str, size: f32, surface: &dyn Fn(Vec3) -> Option<(Vec3, Vec3)>| {
        let mut s = scene(&[(0.0, 0.9), (1.0, 0.9)]);
        let sized = deformation(kind, [3.0, -2.0, 1.0], [size; 3], rotate);
        s.deformation.push(Deformation {
            size: sized.size.filter(|_| kind != "half-space"),
            ..sized
        });
        s.render.exact_cuts = exact;
        let prepared = Prepared::new(&s, assets).unwrap();
        assert_eq!(prepared.cuts.is_empty(), !exact || kind == "slab");
        let (mut seen, mut worst) = (0, 0.0f32);
        for x in points(3000) {
            // A point half a voxel behind the cut's face, and the normal out of the retained part,
            // in the box's local coordinates.
            let Some((on, out)) = surface(x - 0.5) else {
                continue;
            };
            let deformed = turned * (on - out * 0.5) + Vec3::new(3.0, -2.0, 1.0);
            if deformed.abs().max_element() > 27.0 {
                continue;
            }
            seen += 1;
            let got = normal_at(&prepared, assets.grid(), deformed, true)
                .unwrap_or_else(|| panic!("{kind}: cut at {deformed}"));
            let off = angle_deg(got, turned * out);
            worst = worst.max(off);
            assert!(off <= 3.0, "{kind}: {off} degrees at {deformed}");
        }
        println!("normals on the face of a {kind} (shape: {exact}): off by at most {worst:.2} degrees");
        assert!(seen > 300, "{kind}: {seen}");
    };
    face("half-space", 200.0, &|x| {
        Some((Vec3::new(60.0 * x.x, 60.0 * x.y, 0.0), Vec3::Z))
    });
    face("box", 30.0, &|x| {
        Some((Vec3::new(15.0, 24.0 * x.y, 24.0 * x.z), Vec3::NEG_X))
    });
    face("sphere", 36.0, &|x| {
        let n = x.normalize_or(Vec3::X);
        Some((18.0 * n, -n))
    });
    face("cylinder", 36.0, &|x| {
        let n = Vec3::new(x.x, x.y, 0.0).normalize_or(Vec3::X);
        Some((18.0 * n + Vec3::Z * 28.0 * x.z, -n))
    });
    face("slab", 120.0, &|x| {
        Some((Vec3::new(50.0 * x.x, 50.0 * x.y, 7.2), Vec3::Z))
    });
}

/// Half the width and height of the region with opacity above 1/2, mm, and the pixel's size.
fn silhouette(prepared: &Prepared) -> (f32, f32, f32) {
    let p = picture(prepared);
    let inside = |x: u32, y: u32| p.pixels[(y * p.width + x) as usize][3] > 0.5;
    let columns = (0..p.width)
        .filter(|&x| (0..p.height).any(|y| inside(x, y)))
        .count();
    let rows = (0..p.height)
        .filter(|&y| (0..p.width).any(|x| inside(x, y)))
        .count();
    let pixel = 2.0 * prepared.frame.view.right.length() / p.width as f32;
    (columns as f32 * pixel / 2.0, rows as f32 * pixel / 2.0, pixel)
}

fn opaque_ball_scene(view: &str) -> Scene {
    let mut s = scene(&[(0.45, 0.0), (0.55, 0.999)]);
    s.render.size = [640, 640];
    s.camera.projection = Projection::Orthographic;
    s.camera.view = view.parse().unwrap();
    s
}

pub fn anisotropic_ball_is_round() {
    let assets = assets(phantom::generate("ball", [160, 160, 33], Vec3::new(1.0, 1.0, 5.0)).unwrap());
    for view in ["anterior", "left", "superior", "30,20"] {
        let (x, y, pixel) = silhouette(&Prepared::new(&opaque_ball_scene(view), &assets).unwrap());
        println!(
            "anisotropic ball, {view}: half width {x:.2} mm, half height {y:.2} mm, for {BALL_RADIUS_MM} mm"
        );
        assert!((x - BALL_RADIUS_MM).abs() <= 0.5 + pixel / 2.0, "{view}: {x}");
        // Along z a voxel is 5 mm; seen from above, 1 mm.
        let half_voxel = if view == "superior" { 0.5 } else { 2.5 };
        assert!(
            (y - BALL_RADIUS_MM).abs() <= half_voxel + pixel / 2.0,
            "{view}: {y}"
        );
    }
}

/// Rotating the grid under the ball changes neither its outline nor its shading.
pub fn oblique_ball_is_round_and_lit_alike() {
    let straight = phantom::generate("ball", [96, 96, 48], Vec3::new(1.6, 1.6, 3.2)).unwrap();
    let mut turned = straight.clone();
    let rotation = glam::DMat3::from_euler(EulerRot::XYZ, 0.4, 0.9, -0.5);
    turned.world_from_voxel = glam::DAffine3::from_mat3(rotation) * turned.world_from_voxel;
    let (straight, turned) = (assets(straight), assets(turned));
    let mut s = opaque_ball_scene("30,20");
    s.render.size = [256, 256];
    s.camera.target = Some([0.0; 3]);
    let frame = Prepared::new(&s, &straight).unwrap().frame.view;
    let render = |assets: &Assets| {
        let mut prepared = Prepared::new(&s, assets).unwrap();
        // The same camera, although the boxes differ.
        prepared.frame.view = frame;
        picture(&prepared)
    };
    let d = difference(&render(&straight), &render(&turned)).unwrap();
    assert!(d.psnr > 28.0 && d.mean < 3.0 * STEP, "{d:?}");
}

/// Between two cuts the path length is exact wherever the samples fall: no rings on cut faces.
pub fn path_through_a_cut_slab_is_exact() {
    let n = 48;
    let uniform = Volume::new(
        Voxels::new([n; 3], vec![1.0f32; n * n * n]),
        Rescale::NONE,
        glam::DAffine3::from_translation(glam::DVec3::splat(-23.5)),
    );
    let assets = assets(uniform);
    for step in [1.0, 2.0] {
        let mut s = scene(&[(0.0, 0.05), (1.0, 0.05)]);
        s.render.step = step;
        s.render.size = [96, 96];
        s.camera.projection = Projection::Orthographic;
        s.camera.view = "superior".parse().unwrap();
        // Everything above the plane through (0, 0, 3.3), tilted by 20 degrees, is removed.
        s.deformation.push(Deformation {
            size: None,
            ..deformation("half-space", [0.0, 0.0, 3.3], [1.0; 3], [20.0, 0.0, 0.0])
        });
        let prepared = Prepared::new(&s, &assets).unwrap();
        let p = picture(&prepared);
        let slope = 20f32.to_radians().tan();
        let mut worst = 0.0f32;
        for (i, pixel) in p.pixels.iter().enumerate() {
            let u = (i % 96) as f32 / 48.0 + 1.0 / 96.0 - 1.0;
            let v = 1.0 - (i / 96) as f32 / 48.0 - 1.0 / 96.0;
            let (origin, _) = prepared.frame.view.ray(u, v);
            let top = 3.3 + origin.y * slope;
            if origin.x.abs() > 20.0 || origin.y.abs() > 20.0 {
                continue;
            }
            let want = 1.0 - 0.95f32.powf(top + 24.0);
            worst = worst.max((pixel[3] - want).abs());
        }
        println!("path through a cut slab, step {step}: opacity off by at most {worst:.5}");
        assert!(worst > 0.0 && worst < 0.004, "step {step}: {worst}");
    }
}

/// The walk through a stack equals [DDM06] eq 9, written out, at 10,000 points; the reverse order
/// gives a different map.
pub fn composition_is_the_formula() {
    let assets = ball(32);
    let mut s = scene(&[(0.0, 0.0), (1.0, 0.9)]);
    s.deformation.push(deformation(
        "wave",
        [5.0, 0.0, 0.0],
        [170.0, 160.0, 150.0],
        [10.0, 20.0, 0.0],
    ));
    s.deformation.push(deformation(
        "peel",
        [0.0, 5.0, 40.0],
        [150.0, 120.0, 80.0],
        [0.0, 0.0, 30.0],
    ));
    let prepared = Prepared::new(&s, &assets).unwrap();
    s.deformation.reverse();
    let reversed = Prepared::new(&s, &assets).unwrap();
    let g = |m: &PlacedMap, p: Vec3| {
        let x = m.placement.map_from_world.transform_point3(p);
        if x.min_element() < 0.0 || x.max_element() > 1.0 {
            return (p, 1.0);
        }
        let t = m.map.sample(x);
        (
            p + m.placement.world_from_map.transform_vector3(t.displacement),
            t.alpha,
        )
    };
    let [wave, peel] = prepared.stack.maps() else {
        panic!()
    };
    let mut differ = 0;
    for x in points(10_000) {
        let p = (x - 0.5) * 180.0;
        let (q, alpha_2) = g(peel, p);
        let (source, alpha_1) = g(wave, q);
        let jet: Jet = prepared.stack.jet(p);
        assert!(
            jet.source.distance(source) < 1e-3 && (jet.alpha - alpha_1.min(alpha_2)).abs() < 1e-5,
            "at {p}"
        );
        assert_eq!(
            prepared.stack.source_from_deformed(p).is_some(),
            alpha_1 >= 0.5 && alpha_2 >= 0.5
        );
        differ += usize::from(reversed.stack.jet(p).source.distance(source) > 0.5);
    }
    assert!(differ > 300, "{differ}");
}

/// MIP, MinIP and average of a volume whose value rises along the ray.
pub fn depth_of_projections() {
    let n = 32;
    let voxels: Vec<f32> = (0..n * n * n).map(|i| (i / n % n) as f32).collect();
    let assets = assets(Volume::new(
        Voxels::new([n; 3], voxels),
        Rescale::NONE,
        glam::DAffine3::IDENTITY,
    ));
    for mode in [Mode::Raycast, Mode::Slice] {
        for (blend, want) in [(Blend::Mip, 31.0), (Blend::Minip, 0.0), (Blend::Average, 15.5)] {
            let mut s = scene(&[(0.0, 0.0), (31.0, 0.8)]);
            s.transfer.blend = Some(blend);
            s.render.mode = mode;
            s.render.size = [33, 33];
            s.camera.projection = Projection::Orthographic;
            s.render.step = 0.1;
            let p = picture(&Prepared::new(&s, &assets).unwrap());
            let got = p.pixels[16 * 33 + 16][3];
            assert!(
                (got - 0.8 * want / 31.0).abs() < 0.005,
                "{mode:?} {blend:?}: {got}"
            );
        }
    }
}

/// A NaN block in a constant volume is a hole, whatever the transfer function.
pub fn holes_are_empty() {
    let n = 24;
    let inside = |i: usize| (8..16).contains(&(i % n)) && (8..16).contains(&(i / n / n));
    let voxels: Vec<f32> = (0..n * n * n)
        .map(|i| {
            if inside(i) {
                if i % 2 == 0 { f32::NAN } else { f32::INFINITY }
            } else {
                7.0
            }
        })
        .collect();
    let volume = Volume::new(
        Voxels::new([n; 3], voxels),
        Rescale::NONE,
        glam::DAffine3::IDENTITY,
    );
    assert_eq!(volume.non_finite, 8 * 8 * n);
    let assets = assets(volume);
    let mut s = scene(&[(0.0, 0.9), (10.0, 0.9)]);
    s.camera.projection = Projection::Orthographic;
    s.render.size = [65, 65];
    s.render.normals = Normals::None;
    for blend in [Blend::Composite, Blend::Mip, Blend::Minip] {
        s.transfer.blend = Some(blend);
        let p = picture(&Prepared::new(&s, &assets).unwrap());
        assert_eq!(p.pixels[32 * 65 + 32], [0.0; 4], "{blend:?}: the hole shows");
        assert!(p.pixels[6 * 65 + 6][3] > 0.8, "{blend:?}: the rest does not");
    }
}
