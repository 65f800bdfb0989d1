//! Meshes, their distance fields, and ray-traced surfaces: closed forms and properties.

use crate::metrics::{STEP, difference};
use crate::scenes;
use glam::{Affine3A, Mat3, Vec3};
use incise::Watch;
use incise::cpu::surface::{HitSide, normal, trace};
use incise::deform::{DisplacementMap, PlacedMap, Placement, Storage, TexelSample};
use incise::math::Bounds;
use incise::mesh::field::{FieldSettings, MeshField};
use incise::mesh::{Mesh, load, shapes};
use incise::picture::Picture;
use incise::prepare::{Assets, PrepareOptions, Prepared};
use incise::scene::surface::{CutModel, MeshSource, ShapeSource, Steps};
use incise::scene::{Deformation, Mode, Projection, Scene};
use incise::transfer::{Blend, ControlPoint};
use std::path::{Path, PathBuf};

fn field(mesh: &Mesh, settings: FieldSettings) -> MeshField {
    MeshField::new(mesh, &settings, &Watch::NONE).unwrap_or_else(|e| panic!("{e}"))
}

fn grid_points(f: &MeshField) -> impl Iterator<Item = (Vec3, f32)> {
    let [nx, ny, _] = f.grid.size;
    let place = f.grid.world_from_grid;
    f.grid
        .distance_mm
        .iter()
        .enumerate()
        .map(move |(n, d)| (place.transform_point3(Vec3::new((n % nx) as f32, (n / nx % ny) as f32, (n / (nx * ny)) as f32)), *d))
}

/// The meshes approximate the shapes to within a hundredth of a cell; boxes are exact.
pub fn distances_of_closed_forms() {
    let torus = |p: Vec3| 3.0 - ((p.truncate().length() - 10.0).powi(2) + p.z * p.z).sqrt();
    let half = Vec3::new(9.0, 6.0, 4.0);
    let cuboid = |p: Vec3| {
        let d = p.abs() - half;
        -(d.max(Vec3::ZERO).length() + d.max_element().min(0.0))
    };
    type SettingFormat<'a> = (&'a str, Mesh, &'a dyn Fn(Vec3) -> f32);
    let forms: [SettingFormat; 3] = [
        ("sphere", shapes::sphere(10.0, 250), &|p: Vec3| 10.0 - p.length()),
        ("torus", shapes::torus(10.0, 3.0, 250), &torus),
        ("box", shapes::cuboid(half), &cuboid),
    ];
    for (name, mesh, want) in forms {
        let turn = Affine3A::from_rotation_x(0.3) * Affine3A::from_rotation_z(0.5);
        let back = turn.inverse();
        let f = field(&mesh.transformed(&turn), FieldSettings { resolution: 64, ..FieldSettings::default() });
        let cell = f.grid.spacing_mm();
        let (mut band, mut beyond, mut wrong) = (0.0f32, 0.0f32, 0);
        for (p, d) in grid_points(&f) {
            let want = want(back.transform_point3(p));
            let error = (d - want).abs() / cell;
            // Slightly inside the band's edge, where the mesh's own error determines which points
            // belong to it.
            if want.abs() < 2.45 * cell {
                band = band.max(error)
            } else {
                beyond = beyond.max(error)
            }
            wrong += usize::from((d > 0.0) != (want > 0.0) && want.abs() > 0.02 * cell);
        }
        println!("{name}: largest error {band:.4} cells in the band, {beyond:.3} beyond; {wrong} wrong signs; residual {:?}", f.eikonal);
        assert!(band <= 0.05 && beyond < 0.5 && wrong == 0, "{name}");
    }
    let exact = field(&shapes::sphere(10.0, 200), FieldSettings { resolution: 40, exact: true, ..FieldSettings::default() });
    let worst = grid_points(&exact).map(|(p, d)| (d - (10.0 - p.length())).abs()).fold(0.0, f32::max) / exact.grid.spacing_mm();
    assert!(worst <= 0.05, "exact everywhere: {worst}");
}

/// Meshes with holes, unwelded soups and inconsistently oriented triangles have the correct inside,
/// and nothing leaks to the grid's faces.
pub fn broken_meshes_keep_their_inside() {
    let ball = || shapes::sphere(10.0, 60);
    let mut holes = ball();
    let mut n = 0;
    holes.triangles.retain(|_| {
        n += 1;
        n % 12 != 0
    });
    let mut soup = Mesh::default();
    let whole = ball();
    for (t, triangle) in whole.triangles.iter().enumerate() {
        let first = soup.positions.len() as u32;
        let p = triangle.map(|v| whole.positions[v as usize]);
        soup.positions.extend(p.map(|q| q * (1.0 + 1e-3 * (t % 3) as f32)));
        soup.triangles.push([first, first + 1, first + 2]);
    }
    let mut turned = ball();
    turned.triangles.iter_mut().enumerate().filter(|(n, _)| n % 5 < 2).for_each(|(_, t)| t.swap(0, 1));
    let mut inward = ball();
    inward.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    for (name, mesh) in [("holes", holes), ("soup", soup), ("contradicting", turned), ("inward", inward)] {
        let f = field(&mesh, FieldSettings { resolution: 48, ..FieldSettings::default() });
        let cell = f.grid.spacing_mm();
        let (mut wrong, mut all) = (0, 0);
        for (p, d) in grid_points(&f) {
            let want = 10.0 - p.length();
            if want.abs() > 0.5 * cell {
                all += 1;
                wrong += usize::from((d > 0.0) != (want > 0.0));
            }
            let at = f.grid.grid_from_world.transform_point3(p).round();
            let top = Vec3::from(f.grid.size.map(|n| (n - 1) as f32));
            assert!(d < 0.0 || !(at.cmple(Vec3::ZERO).any() || at.cmpge(top).any()), "{name} leaks");
        }
        println!("{name}: {wrong} of {all} signs wrong, doubtful {:.3}", f.doubtful);
        assert!(wrong * 200 < all, "{name}: {wrong} of {all}");
    }
}

/// The field of a region equals that region of the whole field.
pub fn a_part_is_part_of_the_whole() {
    let mesh = shapes::torus(10.0, 3.0, 100);
    let whole = field(&mesh, FieldSettings { resolution: 96, ..FieldSettings::default() });
    let region = Bounds::new(Vec3::new(4.0, -6.0, -4.0), Vec3::new(14.0, 6.0, 4.0));
    let part = field(&mesh, FieldSettings { resolution: 96, region: Some(region), ..FieldSettings::default() });
    assert!(part.grid.distance_mm.len() * 3 < whole.grid.distance_mm.len());
    for (p, d) in grid_points(&part) {
        assert!((d - whole.grid.sample(p)).abs() < 0.06 * part.grid.spacing_mm() || d.abs() > 2.0 * part.grid.spacing_mm(), "{p}: {d}");
    }
}

fn with_shape(kind: &str, radius: f32) -> MeshSource {
    let shape = ShapeSource {
        kind: kind.into(),
        join: None,
        center: None,
        rotate: None,
        size: None,
        radius: Some(radius),
        tube: None,
        length: None,
        period: None,
        wall: None,
    };
    MeshSource { shape: vec![shape], ..MeshSource::default() }
}

/// A flat sheet can be rendered and deformed; an open mesh that faces inwards is reoriented
/// wherever it lies.
pub fn thin_flat_and_far_things() {
    let mut half = shapes::sphere(10.0, 40);
    half.triangles.retain(|t| t.iter().all(|v| half.positions[*v as usize].z > -0.1));
    half.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    for z in [0.0, -100.0] {
        let moved = half.clone().transformed(&Affine3A::from_translation(Vec3::Z * z));
        let f = field(&moved, FieldSettings { resolution: 40, ..FieldSettings::default() });
        assert!(f.grid.sample(Vec3::new(0.0, 0.0, z + 6.0)) > 0.0 && f.inside > 0.1, "{z}: {}", f.inside);
    }
    // A region far from every surface still has correct distances.
    let part = FieldSettings { cell_mm: Some(0.5), region: Some(Bounds::new(Vec3::splat(-1.0), Vec3::splat(1.0))), ..FieldSettings::default() };
    let f = field(&shapes::sphere(10.0, 60), part);
    assert!(grid_points(&f).all(|(p, d)| (d - (10.0 - p.length())).abs() < 0.05));
    let folder = tempfile::tempdir().unwrap();
    let sheet = write_off(
        folder.path(),
        "sheet.off",
        &Mesh::new(vec![Vec3::ZERO, Vec3::X * 50.0, Vec3::new(50.0, 50.0, 0.0), Vec3::Y * 50.0], vec![[0, 1, 2], [0, 2, 3]], vec![]),
    );
    let mut scene = Scene::of_mesh(sheet.to_str().unwrap());
    scene.mesh[0].tessellate = Some(0.2);
    scene.mesh[0].deformer = vec![incise::scene::surface::DeformerSource {
        kind: "wave".into(),
        center: None,
        size: None,
        rotate: None,
        progress: None,
        points: vec![],
        numbers: std::collections::BTreeMap::new(),
    }];
    scene.render.size = [64, 64];
    scene.camera.view = "20,40".parse().unwrap();
    assert!(silhouette(&render(&scene)).iter().filter(|p| **p).count() > 300);
}

/// A scene of a solid ball of 50 mm.
fn ball_scene() -> Scene {
    let mut scene = Scene::of_mesh("");
    scene.mesh = vec![with_shape("sphere", 50.0)];
    scene.camera.projection = Projection::Orthographic;
    scene.render.size = [160, 160];
    scene
}

/// The map of p = L p' (about the origin), linear over a box of 300 mm.
fn linear(l: Mat3) -> PlacedMap {
    let size = 300.0;
    let map = DisplacementMap::from_fn([17; 3], Storage::F32, |x| TexelSample { displacement: (l - Mat3::IDENTITY) * (x - 0.5), alpha: 1.0 });
    PlacedMap::new(std::sync::Arc::new(map), Placement::new(Vec3::ZERO, Vec3::splat(size), Vec3::ZERO).unwrap())
}

/// A sphere under a linear map is an ellipsoid: silhouette and depth within half a step, normals
/// within a degree, with all step methods.
pub fn deformed_sphere_is_the_ellipsoid() {
    let mesh = shapes::sphere(50.0, 300);
    for steps in [Steps::Uniform, Steps::Threshold, Steps::Jacobian, Steps::Sphere] {
        let mut scene = ball_scene();
        scene.surface.steps = steps;
        let assets = scenes::assets(&scene);
        let l = Mat3::from_cols(Vec3::new(1.4, 0.2, 0.0), Vec3::new(-0.1, 0.8, 0.3), Vec3::new(0.1, 0.0, 1.1));
        let mut prepared = Prepared::with(&scene, &assets, &PrepareOptions::with_maps(&[linear(l)])).unwrap();
        for sampled in [false, true] {
            if sampled {
                // The same ball as a mesh's distance field.
                let f = field(&mesh, FieldSettings { resolution: 96, ..FieldSettings::default() });
                prepared.surfaces.objects[0].implicit = Some(incise::mesh::Implicit::Grid(std::sync::Arc::new(f.grid)));
            }
            let object = &prepared.surfaces.objects[0];
            let (mut worst_t, mut worst_angle, mut hits, mut silhouette) = (0.0f32, 0.0f32, 0, 0);
            for y in 0..160 {
                for x in 0..160 {
                    let (o, d) = prepared.frame.view.ray((x as f32 + 0.5) / 80.0 - 1.0, 1.0 - (y as f32 + 0.5) / 80.0);
                    let got = trace(&prepared, object, o, d, &mut 0);
                    // |L (o + t d)| = 50.
                    let (a, b, c) = ((l * d).length_squared(), (l * o).dot(l * d), (l * o).length_squared() - 2500.0);
                    let root = b * b - a * c;
                    let want = (root >= 0.0).then(|| (-b - root.max(0.0).sqrt()) / a);
                    // Depth inside the silhouette, as a depth in the undeformed ball, mm.
                    let inside = 50.0 - (l * (o - d * (b / a))).length();
                    match (got, want) {
                        (Some((t, side)), Some(want)) => {
                            hits += 1;
                            assert_eq!(side, HitSide::Outside);
                            // A grazing ray is nearly tangent to the surface, so the error is
                            // measured along the normal.
                            let p = o + d * t;
                            let n = (l.transpose() * (l * p)).normalize();
                            worst_t = worst_t.max(((t - want) * n.dot(d)).abs());
                            let exact = (l.transpose() * (l * (o + d * want))).normalize();
                            if inside > 1.0 {
                                worst_angle = worst_angle.max(normal(&prepared, object, p, side).angle_between(exact).to_degrees());
                            }
                        }
                        (None, None) => {}
                        _ => {
                            silhouette += 1;
                            assert!(inside.abs() < 0.5 * object.step_mm, "{steps:?} at {x}, {y}: {got:?}, {want:?}, {inside} mm inside");
                        }
                    }
                }
            }
            println!(
                "{steps:?}, {}: {hits} hits, {silhouette} pixels differ at the silhouette, surface off by at most {worst_t:.4} mm (step {:.2}), normals by {worst_angle:.2} degrees",
                if sampled { "field" } else { "formula" },
                object.step_mm
            );
            assert!(hits > 3000 && worst_t < 0.5 * object.step_mm && worst_angle < 1.0, "{steps:?}");
        }
    }
}

/// [DS07] figure 3: a narrow pull out of a ball. Uniform and threshold steps miss pixels of it;
/// Jacobian steps miss none.
pub fn narrow_pull_is_found_by_jacobian_steps() {
    let scene_with = |steps: Steps, step: f32| {
        let mut scene = ball_scene();
        scene.render.size = [200, 200];
        scene.render.step = step;
        scene.camera.zoom = 0.55;
        scene.surface.steps = steps;
        scene.surface.threshold = 8.0;
        scene.render.empty_space_skipping = false;
        scene
    };
    // D = (0, 0, -z exp(-r²/σ²)) ([DDM06] eq 8) over a box above the ball: a spike a few
    // millimetres wide.
    let pull = || {
        let map = DisplacementMap::from_fn([161, 161, 33], Storage::F32, |x| {
            let r2 = (x.x - 0.5).powi(2) + (x.y - 0.5).powi(2);
            let ends = (4.0 * x.z * (1.0 - x.z)).clamp(0.0, 1.0);
            TexelSample { displacement: Vec3::new(0.0, 0.0, -0.55 * ends * (-r2 / 0.018f32.powi(2)).exp()), alpha: 1.0 }
        });
        PlacedMap::new(std::sync::Arc::new(map), Placement::new(Vec3::new(0.0, 0.0, 75.0), Vec3::new(100.0, 100.0, 90.0), Vec3::ZERO).unwrap())
    };
    let hits = |steps, step: f32| -> Vec<bool> {
        let scene = scene_with(steps, step);
        let assets = scenes::assets(&scene);
        let prepared = Prepared::with(&scene, &assets, &PrepareOptions::with_maps(&[pull()])).unwrap();
        incise::cpu::render(&prepared).picture.pixels.iter().map(|p| p[3] > 0.5).collect()
    };
    let coarse = 6.0;
    let reference = hits(Steps::Uniform, coarse / 16.0);
    let missed = |steps| hits(steps, coarse).iter().zip(&reference).filter(|(got, want)| !**got && **want).count();
    let [uniform, threshold, jacobian, sphere] = [Steps::Uniform, Steps::Threshold, Steps::Jacobian, Steps::Sphere].map(missed);
    println!(
        "pixels missed of {}: uniform {uniform}, threshold {threshold}, Jacobian {jacobian}, sphere {sphere}",
        reference.iter().filter(|r| **r).count()
    );
    assert!(uniform > 20 && threshold > 5, "the scene is no test: {uniform}, {threshold}");
    assert_eq!((jacobian, sphere), (0, 0));
}

fn silhouette(picture: &Picture) -> Vec<bool> {
    picture.pixels.iter().map(|p| p[3] > 0.5).collect()
}

/// Pixels set in one picture without a pixel set in the other within a distance of one pixel.
fn beyond_a_pixel(a: &[bool], b: &[bool], width: usize) -> usize {
    let near = |x: usize, y: usize, of: &[bool], value: bool| {
        (y.saturating_sub(1)..=(y + 1).min(of.len() / width - 1))
            .any(|j| (x.saturating_sub(1)..=(x + 1).min(width - 1)).any(|i| of[j * width + i] == value))
    };
    (0..a.len()).filter(|&n| a[n] != b[n] && !near(n % width, n / width, b, a[n])).count()
}

/// One deformation texture in slicing, volume ray casting and surface ray casting: the silhouettes
/// of a solid ball agree to within a pixel.
pub fn three_modes_share_one_deformation() {
    three_silhouettes(&|prepared| incise::cpu::render(prepared).picture);
}

/// The same for any renderer.
pub fn three_silhouettes(draw: &dyn Fn(&Prepared) -> Picture) {
    let mut scene = Scene::of_volume("phantom:ball:size=128");
    scene.render.size = [160, 160];
    scene.transfer.preset = None;
    let assets = scenes::assets(&scene);
    let [low, high] = assets.volume.range;
    let middle = 0.5 * (low + high);
    let point = |value: f64, opacity: f32| ControlPoint { value, color: [1.0; 3], opacity };
    scene.transfer.points = vec![point(low, 0.0), point(middle - 1e-3 * (high - low), 0.0), point(middle, 1.0), point(high, 1.0)];
    scene.transfer.blend = Some(Blend::Composite);
    scene.surface.iso = Some(middle);
    let mut twist = Deformation::new("bend");
    twist.parameters.insert("angle", 60.0);
    scene.deformation = vec![twist, Deformation::new("peel")];
    let render = |mode: Mode| {
        let mut s = scene.clone();
        s.render.mode = mode;
        let assets = scenes::assets(&s);
        let prepared = Prepared::new(&s, &assets).unwrap();
        silhouette(&draw(&prepared))
    };
    let [slice, rays, surface] = [Mode::Slice, Mode::Raycast, Mode::Surface].map(render);
    let set = |s: &[bool]| s.iter().filter(|p| **p).count();
    println!("pixels: slices {}, rays {}, surface {}", set(&slice), set(&rays), set(&surface));
    assert!(set(&surface) > 3000);
    for (name, a, b) in [("slices and rays", &slice, &rays), ("rays and surface", &rays, &surface), ("slices and surface", &slice, &surface)] {
        let off = beyond_a_pixel(a, b, 160) + beyond_a_pixel(b, a, 160);
        assert_eq!(off, 0, "{name}: {off} pixels");
    }
}

fn render(scene: &Scene) -> Picture {
    let assets = scenes::assets(scene);
    let prepared = Prepared::new(scene, &assets).unwrap();
    incise::cpu::render(&prepared).picture
}

/// Two stages or one: the same picture, without a visible seam.
pub fn two_stages_are_one_picture() {
    let folder = tempfile::tempdir().unwrap();
    let smooth = write_off(folder.path(), "sphere.off", &shapes::sphere(50.0, 160));
    let mut ball = scenes::load("bunny-two-stage");
    ball.mesh[0] = MeshSource::of_file(smooth.to_str().unwrap());
    for (name, mut scene, smooth) in [("the bunny", scenes::load("bunny-two-stage"), false), ("a ball", ball, true)] {
        scene.render.size = [256, 256];
        scene.render.antialias = 1;
        let two = render(&scene);
        scene.surface.two_stage = false;
        let one = render(&scene);
        let d = difference(&two, &one).unwrap();
        // A seam is brighter or darker than both its sides, in one picture and not in the other.
        // The bunny's own facets have the same appearance: triangles are shaded smoothly, the field
        // is not.
        let luma = |p: &Picture, x: usize, y: usize| p.pixels[y * 256 + x][..3].iter().sum::<f32>() / 3.0;
        let ridge =
            |p: &Picture, x: usize, y: usize| luma(p, x, y) - 0.25 * (luma(p, x - 2, y) + luma(p, x + 2, y) + luma(p, x, y - 2) + luma(p, x, y + 2));
        let inner = |p: &Picture, x: usize, y: usize| (y - 3..=y + 3).all(|j| (x - 3..=x + 3).all(|i| p.pixels[j * 256 + i][3] > 0.99));
        let places = (3..253).flat_map(|y| (3..253).map(move |x| (x, y))).filter(|&(x, y)| inner(&two, x, y) && inner(&one, x, y));
        let worst = places.map(|(x, y)| f64::from((ridge(&two, x, y) - ridge(&one, x, y)).abs())).fold(0.0, f64::max);
        println!("{name}: mean {:.3}/255, lines differ by {:.3}/255 at most", d.mean / STEP, worst / STEP);
        assert!(d.mean <= 2.0 * STEP && d.mean > 0.0 && (!smooth || worst < 2.0 * STEP), "{name}");
    }
}

/// Skipping space emptied by cuts, or any other space, changes no pixel by more than a step.
pub fn skipping_changes_no_surface() {
    for name in ["apple-hollow", "apple-thick", "apple-solid", "bunny-knife", "head-skin-peel"] {
        let mut scene = scenes::load(name);
        scene.render.size = [96, 96];
        scene.render.antialias = 1;
        let with = render(&scene);
        scene.surface.cut_skipping = false;
        let without_cuts = render(&scene);
        scene.render.empty_space_skipping = false;
        let without = render(&scene);
        for (what, other) in [("cuts", &without_cuts), ("everything", &without)] {
            let d = difference(&with, other).unwrap();
            let off = with.pixels.iter().zip(&other.pixels).filter(|(a, b)| (0..4).any(|c| f64::from((a[c] - b[c]).abs()) > STEP)).count();
            println!("{name}, skipping {what}: max {:.3}/255, {off} pixels beyond 1/255", d.max / STEP);
            assert!(off == 0, "{name} {what}: {off} pixels, max {}", d.max / STEP);
        }
    }
}

/// The three models of a cut ball give the expected hits along known rays.
pub fn cut_models_are_what_they_say() {
    let mut scene = ball_scene();
    let mut cut = Deformation::new("half-space");
    cut.center = Some([0.0, 0.0, 0.0]);
    scene.camera.view = "superior".parse().unwrap();
    scene.deformation.push(cut);
    // Looking down on a ball without its upper half.
    for (model, middle) in [
        (CutModel::Solid, Some((0.0, HitSide::Cut))),
        (CutModel::Hollow, Some((-50.0, HitSide::Inside))),
        (CutModel::Thick, Some((-40.0, HitSide::Inside))),
    ] {
        scene.mesh[0].appearance.model = Some(model);
        scene.mesh[0].appearance.thickness = Some(10.0);
        for exact in [true, false] {
            scene.render.exact_cuts = exact;
            let assets = scenes::assets(&scene);
            let prepared = Prepared::new(&scene, &assets).unwrap();
            let object = &prepared.surfaces.objects[0];
            let look = |x: f32| {
                let o = Vec3::new(x, 0.3, 200.0);
                trace(&prepared, object, o, Vec3::NEG_Z, &mut 0).map(|(t, side)| (200.0 - t, side, normal(&prepared, object, o - Vec3::Z * t, side)))
            };
            let (z, side, n) = look(0.4).unwrap();
            let (want_z, want_side) = middle.unwrap();
            assert!((z - want_z).abs() < 0.3 && side == want_side, "{model:?} exact {exact}: {z} {side:?}");
            assert!(n.z > 0.99, "{model:?}: {n}");
            // The rim of a thick shell shows the cut's face.
            let (z, side, _) = look(45.0).unwrap();
            let rim = if model == CutModel::Hollow { (-(50.0f32.powi(2) - 45.0f32.powi(2)).sqrt(), HitSide::Inside) } else { (0.0, HitSide::Cut) };
            assert!((z - rim.0).abs() < 0.5 && side == rim.1, "{model:?} exact {exact} rim: {z} {side:?}");
            assert!(look(52.0).is_none());
        }
    }
}

/// A surface in front of, inside and behind a volume is occluded exactly by the part of the volume
/// in front of it.
pub fn surfaces_and_volumes_share_depth() {
    let mut scene = Scene::of_volume("phantom:ball:size=64");
    scene.render.size = [64, 64];
    scene.render.normals = incise::scene::Normals::None;
    let picture = |scene: &Scene, z: Option<f32>, mode: Mode| {
        let mut s = scene.clone();
        s.render.mode = mode;
        if let Some(y) = z {
            let mut ball = with_shape("sphere", 5.0);
            ball.shape[0].center = Some([0.0, y, 0.0]);
            ball.appearance.color = Some([0.0, 1.0, 0.0]);
            s.mesh.push(ball);
        }
        render(&s).pixels[32 * 64 + 32]
    };
    for mode in [Mode::Raycast, Mode::Slice] {
        let alone = picture(&scene, None, mode);
        let [front, within, behind] = [-80.0, 0.0, 80.0].map(|y| picture(&scene, Some(y), mode));
        assert!(front[1] > 0.5 && front[3] > 0.99, "{front:?}");
        assert!(within[3] > 0.99 && behind[3] > 0.99);
        // The ball behind the volume is attenuated by the volume's transmittance.
        let green = front[1] - front[0];
        assert!((behind[1] - (alone[1] + (1.0 - alone[3]) * front[1])).abs() < 0.1 || alone[3] > 0.99, "{alone:?} {behind:?}");
        assert!(green > 0.3 && within[1] - within[0] <= green + 1e-3);
    }
}

fn write_off(folder: &Path, name: &str, mesh: &Mesh) -> PathBuf {
    let mut text = format!("OFF\n{} {} 0\n", mesh.positions.len(), mesh.triangles.len());
    mesh.positions.iter().for_each(|p| text.push_str(&format!("{} {} {}\n", p.x, p.y, p.z)));
    mesh.triangles.iter().for_each(|t| text.push_str(&format!("3 {} {} {}\n", t[0], t[1], t[2])));
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

/// A volume inside a mesh: the mask, and slices clipped to the mesh, select the mesh's interior; if
/// the mesh is deformed, the interior moves with it.
pub fn volumes_inside_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, mesh: &Mesh| write_off(folder.path(), name, mesh);
    // A shell within a shell, both facing outwards: by the even-odd rule, not by orientation, the
    // middle is empty.
    let mut nested = shapes::sphere(40.0, 48);
    let inner = shapes::sphere(25.0, 48);
    let first = nested.positions.len() as u32;
    nested.positions.extend(&inner.positions);
    nested.triangles.extend(inner.triangles.iter().map(|t| t.map(|v| v + first)));
    let torus = shapes::torus(30.0, 10.0, 64);
    for (name, mesh, inside) in [
        ("torus.off", &torus, &(|p: Vec3| 10.0 - ((p.truncate().length() - 30.0).powi(2) + p.z * p.z).sqrt()) as &dyn Fn(Vec3) -> f32),
        ("nested.off", &nested, &|p: Vec3| (40.0 - p.length()).min(p.length() - 25.0)),
    ] {
        let path = write(name, mesh);
        let mut scene = Scene::of_volume("phantom:ball:size=64");
        scene.volume.as_mut().unwrap().inside = Some(incise::scene::InsideMesh { path: path.to_str().unwrap().into(), ..Default::default() });
        let assets = scenes::assets(&scene);
        let prepared = Prepared::new(&scene, &assets).unwrap();
        assert!(prepared.proxy_mesh.is_some());
        let mut wrong = 0;
        for x in crate::contract::points(4000) {
            let p = (x - 0.5) * 90.0;
            let d = inside(p);
            wrong += usize::from(d.abs() > 0.6 && (prepared.stack.source_and_alpha(p).1 >= 0.5) != (d > 0.0));
        }
        assert_eq!(wrong, 0, "{name}");
    }
    // With a twist by a right angle over the height, the source of a point at +x at the top is a
    // quarter turn away.
    let path = write("ball.off", &shapes::sphere(40.0, 48));
    let twist = incise::scene::surface::DeformerSource {
        kind: "twist".into(),
        center: None,
        size: None,
        rotate: None,
        progress: None,
        points: vec![],
        numbers: [("angle".to_owned(), 90.0f32)].into(),
    };
    let mut scene = Scene::of_volume("phantom:ball:size=64");
    scene.volume.as_mut().unwrap().inside =
        Some(incise::scene::InsideMesh { path: path.to_str().unwrap().into(), deformer: vec![twist], ..Default::default() });
    let assets = scenes::assets(&scene);
    let prepared = Prepared::new(&scene, &assets).unwrap();
    let p = Vec3::new(20.0, 0.0, 20.0);
    let angle = std::f32::consts::FRAC_PI_2 * 20.0 / 80.0;
    let want = Vec3::new(20.0 * angle.cos(), -20.0 * angle.sin(), 20.0);
    let (source, alpha) = prepared.stack.source_and_alpha(p);
    assert!(source.distance(want) < 0.1 && alpha >= 0.5, "{source} for {want}");
    let mut open = shapes::sphere(40.0, 12);
    open.triangles.pop();
    let path = write("open.off", &open);
    scene.volume.as_mut().unwrap().inside = Some(incise::scene::InsideMesh { path: path.to_str().unwrap().into(), ..Default::default() });
    let error = Prepared::new(&scene, &assets).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("open.off") && error.contains("not closed"), "{error}");
}

/// One mesh in every format is read as the same mesh.
pub fn every_format_is_one_mesh() {
    let mesh = shapes::torus(10.0, 3.0, 12);
    let (v, f) = (&mesh.positions, &mesh.triangles);
    let face = |t: &[u32; 3], base: u32| format!("{} {} {}", t[0] + base, t[1] + base, t[2] + base);
    let lines = |items: Vec<String>| items.join("\n") + "\n";
    let point = |p: &Vec3| format!("{} {} {}", p.x, p.y, p.z);
    let floats = |p: &[Vec3]| p.iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
    let indices = f.iter().flatten().flat_map(|i| i.to_le_bytes()).collect::<Vec<u8>>();
    let mut binary_stl = b"solid, but binary".to_vec();
    binary_stl.resize(80, b' ');
    binary_stl.extend((f.len() as u32).to_le_bytes());
    for t in f {
        binary_stl.extend([0u8; 12]);
        binary_stl.extend(floats(&t.map(|i| v[i as usize])));
        binary_stl.extend([0u8; 2]);
    }
    let text_stl = f.iter().map(|t| {
        let corners = t.map(|i| format!("vertex {}", point(&v[i as usize]))).join("\n");
        format!("facet normal 0 0 0\nouter loop\n{corners}\nendloop\nendfacet")
    });
    let text_stl = format!("solid torus\n{}endsolid torus\n", lines(text_stl.collect()));
    let obj = lines(v.iter().map(|p| format!("v {}", point(p))).chain(f.iter().map(|t| format!("f {}", face(t, 1)))).collect());
    let off = format!(
        "OFF\n# a torus\n{} {} 0\n{}{}",
        v.len(),
        f.len(),
        lines(v.iter().map(&point).collect()),
        lines(f.iter().map(|t| format!("3 {}", face(t, 0))).collect())
    );
    let ply_head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
            v.len(),
            f.len()
        )
    };
    let text_ply = ply_head("ascii") + &lines(v.iter().map(&point).collect()) + &lines(f.iter().map(|t| format!("3 {}", face(t, 0))).collect());
    let mut binary_ply = ply_head("binary_little_endian").into_bytes();
    binary_ply.extend(floats(v));
    for t in f {
        binary_ply.push(3);
        binary_ply.extend(t.iter().flat_map(|i| i.to_le_bytes()));
    }
    use base64::Engine;
    let encode = |b: &[u8]| base64::engine::general_purpose::STANDARD.encode(b);
    // Transformed by a node, as is common: half the size, then doubled.
    let halved: Vec<Vec3> = v.iter().map(|p| *p * 0.5).collect();
    let buffer = [floats(&halved), indices.clone()].concat();
    let gltf = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"children":[1],"scale":[2,2,2]}},{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":{},"type":"VEC3","min":[-6.5,-6.5,-1.5],"max":[6.5,6.5,1.5]}},{{"bufferView":1,"componentType":5125,"count":{},"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":{}}},{{"buffer":0,"byteOffset":{},"byteLength":{}}}],"buffers":[{{"byteLength":{},"uri":"data:application/octet-stream;base64,{}"}}]}}"#,
        v.len(),
        3 * f.len(),
        12 * v.len(),
        12 * v.len(),
        indices.len(),
        buffer.len(),
        encode(&buffer)
    );
    // RAS: x and y change sign.
    let ras: Vec<Vec3> = v.iter().map(|p| *p * Vec3::new(-1.0, -1.0, 1.0)).collect();
    let gifti = |compress: bool| {
        let pack = |b: &[u8]| {
            if !compress {
                return encode(b);
            }
            let mut z = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
            std::io::Write::write_all(&mut z, b).unwrap();
            encode(&z.finish().unwrap())
        };
        let array = |intent: &str, kind: &str, rows: usize, bytes: &[u8]| {
            format!(
                r#"<DataArray Intent="{intent}" DataType="{kind}" ArrayIndexingOrder="RowMajorOrder" Dimensionality="2" Dim0="{rows}" Dim1="3" Encoding="{}" Endian="LittleEndian"><Data>{}</Data></DataArray>"#,
                if compress { "GZipBase64Binary" } else { "Base64Binary" },
                pack(bytes)
            )
        };
        format!(
            "<?xml version=\"1.0\"?>\n<GIFTI Version=\"1.0\" NumberOfDataArrays=\"2\">{}{}</GIFTI>",
            array("NIFTI_INTENT_POINTSET", "NIFTI_TYPE_FLOAT32", ras.len(), &floats(&ras)),
            array("NIFTI_INTENT_TRIANGLE", "NIFTI_TYPE_INT32", f.len(), &indices)
        )
    };
    let files: [(&str, &str, Vec<u8>); 9] = [
        ("binary STL", "stl", binary_stl),
        ("text STL", "stl", text_stl.into_bytes()),
        ("OBJ", "obj", obj.into_bytes()),
        ("OFF", "off", off.into_bytes()),
        ("text PLY", "ply", text_ply.into_bytes()),
        ("binary PLY", "ply", binary_ply),
        ("glTF", "gltf", gltf.into_bytes()),
        ("GIfTI", "gii", gifti(false).into_bytes()),
        ("GIfTI, compressed", "gii", gifti(true).into_bytes()),
    ];
    for (name, ending, bytes) in &files {
        let read = load::parse(bytes, ending, None).unwrap_or_else(|e| panic!("{name} {e}"));
        let (a, b) = (read.topology(), mesh.topology());
        assert!(a.watertight && a.orientation() == "outward" && a.components == 1, "{name}: {a:?}");
        assert_eq!((read.triangles.len(), read.positions.len()), (f.len(), v.len()), "{name}");
        assert!((a.volume / b.volume - 1.0).abs() < 1e-5, "{name}");
        let (got, want) = (read.bounds(), mesh.bounds());
        assert!(got.min.abs_diff_eq(want.min, 1e-4) && got.max.abs_diff_eq(want.max, 1e-4), "{name}: {got:?}");
    }
    // A file truncated anywhere, or with a byte changed, is read with a warning or refused.
    let mut refused = 0;
    for (_, ending, bytes) in &files {
        for n in 0..60 {
            let mut broken = bytes[..bytes.len() * n / 60].to_vec();
            refused += usize::from(load::parse(&broken, ending, None).is_err());
            broken = bytes.clone();
            let at = n * 7919 % broken.len();
            broken[at] = broken[at].wrapping_add(1 + n as u8);
            let _read = load::parse(&broken, ending, None);
        }
    }
    assert!(refused > 200, "{refused}");
    let head = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],"#;
    let data = r#""bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36,"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;
    let nodes: Vec<String> = (0..60).map(|n| format!(r#"{{"children":[{},{}]}}"#, n + 1, n + 1)).collect();
    for (what, text) in [
        (
            "not there",
            format!(
                r#"{head}"meshes":[{{"primitives":[{{"attributes":{{"POSITION":99}}}}]}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}}],{data}"#
            ),
        ),
        (
            "unsigned",
            format!(
                r#"{head}"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":0}}]}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}}],{data}"#
            ),
        ),
        (
            "more elements",
            format!(
                r#"{head}"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],"accessors":[{{"componentType":5126,"count":10000000000,"type":"VEC3"}}],{data}"#
            ),
        ),
        (
            "percent-encoded",
            r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[]}],"buffers":[{"byteLength":3,"uri":"%FF.bin"}]}"#.to_owned(),
        ),
        ("too often", format!(r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{},{{}}]}}"#, nodes.join(","))),
    ] {
        let error = load::parse(text.as_bytes(), "gltf", Some(Path::new("."))).unwrap_err();
        assert!(error.contains(what), "{what}: {error}");
    }
    // Files that other programs accept: an upper-case STL, a name in Latin-1, a cube whose face
    // diagonals lie on the grid's lines.
    let upper = "SOLID x\nFACET NORMAL 0 0 1\nOUTER LOOP\nVERTEX 0 0 0\nVERTEX 1 0 0\nVERTEX 0 1 0\nENDLOOP\nENDFACET\nENDSOLID x\n";
    assert_eq!(load::parse(upper.as_bytes(), "stl", None).unwrap().triangles.len(), 1);
    let latin = b"g K\xf6rper\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    assert_eq!(load::parse(latin, "obj", None).unwrap().triangles.len(), 1);
    let cube = field(&shapes::cuboid(Vec3::splat(10.0)), FieldSettings { resolution: 64, parity: true, ..FieldSettings::default() });
    for (p, d) in grid_points(&cube) {
        let want = 10.0 - p.abs().max_element();
        assert!(want.abs() < 0.1 || (d > 0.0) == (want > 0.0), "{p}: {d}");
    }
    let huge = load::parse(b"OFF\n353535235358 6 0\n0 0 0\n", "off", None).unwrap_err();
    assert!(huge.contains("353535235358"), "{huge}");
    let huge = load::parse(b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n0\n", "ply", None).unwrap_err();
    assert!(huge.contains("99999999999"), "{huge}");
}

/// Files from other sources, if available.
pub fn shared_meshes_load_or_say_why() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/meshes");
    if !folder.is_dir() {
        println!("no shared meshes here: nothing was checked");
        return;
    }
    let mut open: Vec<PathBuf> = vec![folder];
    let (mut read, mut refused) = (0, Vec::new());
    while let Some(path) = open.pop() {
        if path.is_dir() {
            open.extend(std::fs::read_dir(&path).unwrap().flatten().map(|e| e.path()));
        } else {
            match load::mesh(&path) {
                Ok(mesh) => {
                    assert!(!mesh.triangles.is_empty());
                    read += 1;
                }
                Err(e) => {
                    let text = e.to_string();
                    let name = path.file_name().unwrap().to_string_lossy().into_owned();
                    assert!(text.contains(&name), "{text}");
                    refused.push(name);
                }
            }
        }
    }
    refused.sort();
    println!("{read} read; refused: {refused:?}");
    assert_eq!(refused, ["OutOfMemory.off", "empty.obj", "empty.off", "empty.ply", "empty.stl", "invalid.off", "malformed.obj", "malformed2.obj"]);
}

/// A depth-map cube of a convex solid matches the solid, with a fraction of the memory.
pub fn depth_map_cube_shows_the_field() {
    let mut scene = scenes::load("bunny-twist");
    scene.deformation.clear();
    scene.render.size = [128, 128];
    scene.render.antialias = 1;
    let by_field = render(&scene);
    scene.mesh[0].representation = Some(incise::scene::surface::Representation::DepthMapCube);
    let assets: Assets = scenes::assets(&scene);
    let prepared = Prepared::new(&scene, &assets).unwrap();
    let bytes = prepared.surfaces.objects[0].implicit.as_ref().unwrap().gpu_bytes();
    assert_eq!(bytes, 6 * 128 * 128 * 4);
    assert!(assets.library.notices().iter().any(|n| n.contains(&bytes.to_string()) && n.contains(&(2 * 128usize.pow(3)).to_string())));
    let by_cube = incise::cpu::render(&prepared).picture;
    let (a, b) = (silhouette(&by_field), silhouette(&by_cube));
    let off = a.iter().zip(&b).filter(|(a, b)| a != b).count();
    assert!(off * 25 < a.iter().filter(|p| **p).count(), "{off} pixels");
}
