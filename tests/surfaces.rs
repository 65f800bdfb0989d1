//! Meshes, their distance fields, and ray-traced surfaces: closed forms and properties.

use crate::metrics::{STEP, difference};
use crate::scenes;
use glam::{Mat3, Vec3};
use incise::Watch;
use incise::cpu::surface::{HitSide, normal, trace};
use incise::deform::{DisplacementMap, PlacedMap, Placement, Storage, TexelSample};
use incise::mesh::field::{FieldSettings, MeshField};
use incise::mesh::{Mesh, shapes};
use incise::picture::Picture;
use incise::prepare::{Assets, PrepareOptions, Prepared};
use incise::scene::surface::{CutModel, MeshSource, ShapeSource, Steps};
use incise::scene::{Antialias, Deformation, Mode, Projection, Scene};
use incise::transfer::{Blend, ControlPoint};
use std::path::{Path, PathBuf};

mod fields;
mod formats;
mod skipping;

pub use fields::*;
pub use formats::*;
pub use skipping::*;

fn field(mesh: &Mesh, settings: FieldSettings) -> MeshField {
    MeshField::new(mesh, &settings, &Watch::NONE).unwrap_or_else(|e| panic!("{e}"))
}

fn grid_points(f: &MeshField) -> impl Iterator<Item = (Vec3, f32)> {
    let [nx, ny, _] = f.grid.size;
    let place = f.grid.world_from_grid;
    f.grid.distance_mm.iter().enumerate().map(move |(n, d)| {
        (
            place.transform_point3(Vec3::new(
                (n % nx) as f32,
                (n / nx % ny) as f32,
                (n / (nx * ny)) as f32,
            )),
            *d,
        )
    })
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
    MeshSource {
        shape: vec![shape],
        ..MeshSource::default()
    }
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
    let map = DisplacementMap::from_fn([17; 3], Storage::F32, |x| TexelSample {
        displacement: (l - Mat3::IDENTITY) * (x - 0.5),
        alpha: 1.0,
    });
    PlacedMap::new(
        std::sync::Arc::new(map),
        Placement::new(Vec3::ZERO, Vec3::splat(size), Vec3::ZERO).unwrap(),
    )
}

/// A sphere under a linear map is an ellipsoid: silhouette and depth within half a step, normals
/// within a degree, with all step methods.
pub fn deformed_sphere_is_the_ellipsoid() {
    let mesh = shapes::sphere(50.0, 300);
    for steps in [
        Steps::Uniform,
        Steps::Threshold,
        Steps::Jacobian,
        Steps::JacobianBound,
        Steps::Sphere,
    ] {
        let mut scene = ball_scene();
        scene.surface.steps = steps;
        let assets = scenes::assets(&scene);
        let l = Mat3::from_cols(
            Vec3::new(1.4, 0.2, 0.0),
            Vec3::new(-0.1, 0.8, 0.3),
            Vec3::new(0.1, 0.0, 1.1),
        );
        let mut prepared = Prepared::with(&scene, &assets, &PrepareOptions::with_maps(&[linear(l)])).unwrap();
        for sampled in [false, true] {
            if sampled {
                // The same ball as a mesh's distance field.
                let f = field(
                    &mesh,
                    FieldSettings {
                        resolution: 96,
                        ..FieldSettings::default()
                    },
                );
                prepared.surfaces.objects[0].implicit =
                    Some(incise::mesh::Implicit::Grid(std::sync::Arc::new(f.grid)));
            }
            let object = &prepared.surfaces.objects[0];
            let (mut worst_t, mut worst_angle, mut hits, mut silhouette) = (0.0f32, 0.0f32, 0, 0);
            for y in 0..160 {
                for x in 0..160 {
                    let (o, d) = prepared
                        .frame
                        .view
                        .ray((x as f32 + 0.5) / 80.0 - 1.0, 1.0 - (y as f32 + 0.5) / 80.0);
                    let got = trace(&prepared, object, o, d, &mut 0);
                    // |L (o + t d)| = 50.
                    let (a, b, c) = (
                        (l * d).length_squared(),
                        (l * o).dot(l * d),
                        (l * o).length_squared() - 2500.0,
                    );
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
                                worst_angle = worst_angle.max(
                                    normal(&prepared, object, p, side)
                                        .angle_between(exact)
                                        .to_degrees(),
                                );
                            }
                        }
                        (None, None) => {}
                        _ => {
                            silhouette += 1;
                            assert!(
                                inside.abs() < 0.5 * object.step_mm,
                                "{steps:?} at {x}, {y}: {got:?}, {want:?}, {inside} mm inside"
                            );
                        }
                    }
                }
            }
            println!(
                "{steps:?}, {}: {hits} hits, {silhouette} pixels differ at the silhouette, surface off by at most {worst_t:.4} mm (step {:.2}), normals by {worst_angle:.2} degrees",
                if sampled { "field" } else { "formula" },
                object.step_mm
            );
            assert!(
                hits > 3000 && worst_t < 0.5 * object.step_mm && worst_angle < 1.0,
                "{steps:?}"
            );
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
        // The spike lies between two samples of even steps.
        scene.camera.target = Some([0.0, 2.34, 0.0]);
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
            TexelSample {
                displacement: Vec3::new(0.0, 0.0, -0.55 * ends * (-r2 / 0.018f32.powi(2)).exp()),
                alpha: 1.0,
            }
        });
        PlacedMap::new(
            std::sync::Arc::new(map),
            Placement::new(
                Vec3::new(0.0, 0.0, 75.0),
                Vec3::new(100.0, 100.0, 90.0),
                Vec3::ZERO,
            )
            .unwrap(),
        )
    };
    let hits = |steps, step: f32| -> Vec<bool> {
        let scene = scene_with(steps, step);
        let assets = scenes::assets(&scene);
        let prepared = Prepared::with(&scene, &assets, &PrepareOptions::with_maps(&[pull()])).unwrap();
        incise::cpu::render(&prepared)
            .picture
            .pixels
            .iter()
            .map(|p| p[3] > 0.5)
            .collect()
    };
    let coarse = 6.0;
    let reference = hits(Steps::Uniform, coarse / 16.0);
    let missed = |steps| {
        hits(steps, coarse)
            .iter()
            .zip(&reference)
            .filter(|(got, want)| !**got && **want)
            .count()
    };
    let [uniform, threshold, jacobian, bound, sphere] = [
        Steps::Uniform,
        Steps::Threshold,
        Steps::Jacobian,
        Steps::JacobianBound,
        Steps::Sphere,
    ]
    .map(missed);
    println!(
        "pixels missed of {}: uniform {uniform}, threshold {threshold}, Jacobian {jacobian}, Jacobian by a bound {bound}, sphere {sphere}",
        reference.iter().filter(|r| **r).count()
    );
    assert!(
        uniform > 20 && threshold > 5,
        "the scene is no test: {uniform}, {threshold}"
    );
    // The rate at a sample tells little of a pull between two samples.
    assert!(2 * jacobian < uniform);
    assert_eq!((bound, sphere), (0, 0));
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
    (0..a.len())
        .filter(|&n| a[n] != b[n] && !near(n % width, n / width, b, a[n]))
        .count()
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
    let point = |value: f64, opacity: f32| ControlPoint {
        value,
        color: [1.0; 3],
        opacity,
    };
    scene.transfer.points = vec![
        point(low, 0.0),
        point(middle - 1e-3 * (high - low), 0.0),
        point(middle, 1.0),
        point(high, 1.0),
    ];
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
    println!(
        "pixels: slices {}, rays {}, surface {}",
        set(&slice),
        set(&rays),
        set(&surface)
    );
    assert!(set(&surface) > 3000);
    for (name, a, b) in [
        ("slices and rays", &slice, &rays),
        ("rays and surface", &rays, &surface),
        ("slices and surface", &slice, &surface),
    ] {
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
    for (name, mut scene, smooth) in [
        ("the bunny", scenes::load("bunny-two-stage"), false),
        ("a ball", ball, true),
    ] {
        scene.render.size = [256, 256];
        scene.render.antialias = Antialias::OFF;
        let two = render(&scene);
        scene.surface.two_stage = false;
        let one = render(&scene);
        let d = difference(&two, &one).unwrap();
        // A seam is brighter or darker than both its sides, in one picture and not in the other.
        // The bunny's own facets have the same appearance: triangles are shaded smoothly, the field
        // is not.
        let luma = |p: &Picture, x: usize, y: usize| p.pixels[y * 256 + x][..3].iter().sum::<f32>() / 3.0;
        let ridge = |p: &Picture, x: usize, y: usize| {
            luma(p, x, y)
                - 0.25 * (luma(p, x - 2, y) + luma(p, x + 2, y) + luma(p, x, y - 2) + luma(p, x, y + 2))
        };
        let inner = |p: &Picture, x: usize, y: usize| {
            (y - 3..=y + 3).all(|j| (x - 3..=x + 3).all(|i| p.pixels[j * 256 + i][3] > 0.99))
        };
        let places = (3..253)
            .flat_map(|y| (3..253).map(move |x| (x, y)))
            .filter(|&(x, y)| inner(&two, x, y) && inner(&one, x, y));
        let worst = places
            .map(|(x, y)| f64::from((ridge(&two, x, y) - ridge(&one, x, y)).abs()))
            .fold(0.0, f64::max);
        println!(
            "{name}: mean {:.3}/255, lines differ by {:.3}/255 at most",
            d.mean / STEP,
            worst / STEP
        );
        assert!(
            d.mean <= 2.0 * STEP && d.mean > 0.0 && (!smooth || worst < 2.0 * STEP),
            "{name}"
        );
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
                trace(&prepared, object, o, Vec3::NEG_Z, &mut 0)
                    .map(|(t, side)| (200.0 - t, side, normal(&prepared, object, o - Vec3::Z * t, side)))
            };
            let (z, side, n) = look(0.4).unwrap();
            let (want_z, want_side) = middle.unwrap();
            assert!(
                (z - want_z).abs() < 0.3 && side == want_side,
                "{model:?} exact {exact}: {z} {side:?}"
            );
            assert!(n.z > 0.99, "{model:?}: {n}");
            // The rim of a thick shell shows the cut's face.
            let (z, side, _) = look(45.0).unwrap();
            let rim = if model == CutModel::Hollow {
                (-(50.0f32.powi(2) - 45.0f32.powi(2)).sqrt(), HitSide::Inside)
            } else {
                (0.0, HitSide::Cut)
            };
            assert!(
                (z - rim.0).abs() < 0.5 && side == rim.1,
                "{model:?} exact {exact} rim: {z} {side:?}"
            );
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
        assert!(
            (behind[1] - (alone[1] + (1.0 - alone[3]) * front[1])).abs() < 0.1 || alone[3] > 0.99,
            "{alone:?} {behind:?}"
        );
        assert!(green > 0.3 && within[1] - within[0] <= green + 1e-3);
    }
}

fn write_off(folder: &Path, name: &str, mesh: &Mesh) -> PathBuf {
    let mut text = format!("OFF\n{} {} 0\n", mesh.positions.len(), mesh.triangles.len());
    mesh.positions
        .iter()
        .for_each(|p| text.push_str(&format!("{} {} {}\n", p.x, p.y, p.z)));
    mesh.triangles
        .iter()
        .for_each(|t| text.push_str(&format!("3 {} {} {}\n", t[0], t[1], t[2])));
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
    nested
        .triangles
        .extend(inner.triangles.iter().map(|t| t.map(|v| v + first)));
    let torus = shapes::torus(30.0, 10.0, 64);
    for (name, mesh, inside) in [
        (
            "torus.off",
            &torus,
            &(|p: Vec3| 10.0 - ((p.truncate().length() - 30.0).powi(2) + p.z * p.z).sqrt())
                as &dyn Fn(Vec3) -> f32,
        ),
        ("nested.off", &nested, &|p: Vec3| {
            (40.0 - p.length()).min(p.length() - 25.0)
        }),
    ] {
        let path = write(name, mesh);
        let mut scene = Scene::of_volume("phantom:ball:size=64");
        scene.volume.as_mut().unwrap().inside = Some(incise::scene::InsideMesh {
            path: path.to_str().unwrap().into(),
            ..Default::default()
        });
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
    scene.volume.as_mut().unwrap().inside = Some(incise::scene::InsideMesh {
        path: path.to_str().unwrap().into(),
        deformer: vec![twist],
        ..Default::default()
    });
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
    scene.volume.as_mut().unwrap().inside = Some(incise::scene::InsideMesh {
        path: path.to_str().unwrap().into(),
        ..Default::default()
    });
    // A missing triangle changes little: the inside is where the winding number is above 1/2.
    let prepared = Prepared::new(&scene, &assets).unwrap();
    let notices = assets.library.notices();
    assert!(
        notices
            .iter()
            .any(|n| n.contains("open.off") && n.contains("not closed")),
        "{notices:?}"
    );
    for (radius, inside) in [(20.0, true), (36.0, true), (44.0, false), (48.0, false)] {
        for direction in [Vec3::X, Vec3::NEG_Y, Vec3::Z, Vec3::ONE.normalize()] {
            let alpha = prepared.stack.source_and_alpha(direction * radius).1;
            assert_eq!(alpha >= 0.5, inside, "{direction} at {radius}: {alpha}");
        }
    }
    // A sheet encloses nothing.
    open.triangles.truncate(4);
    write("open.off", &open);
    let assets = scenes::assets(&scene);
    let error = Prepared::new(&scene, &assets)
        .err()
        .map(|e| e.to_string())
        .unwrap_or_default();
    assert!(
        error.contains("open.off") && error.contains("encloses nothing"),
        "{error}"
    );
}

/// A depth-map cube of a convex solid matches the solid, with a fraction of the memory.
pub fn depth_map_cube_shows_the_field() {
    let mut scene = scenes::load("bunny-twist");
    scene.deformation.clear();
    scene.render.size = [128, 128];
    scene.render.antialias = Antialias::OFF;
    let by_field = render(&scene);
    scene.mesh[0].representation = Some(incise::scene::surface::Representation::DepthMapCube);
    let assets: Assets = scenes::assets(&scene);
    let prepared = Prepared::new(&scene, &assets).unwrap();
    let bytes = prepared.surfaces.objects[0]
        .implicit
        .as_ref()
        .unwrap()
        .gpu_bytes();
    assert_eq!(bytes, 6 * 128 * 128 * 4);
    assert!(
        assets
            .library
            .notices()
            .iter()
            .any(|n| n.contains(&bytes.to_string()) && n.contains(&(2 * 128usize.pow(3)).to_string()))
    );
    let by_cube = incise::cpu::render(&prepared).picture;
    let (a, b) = (silhouette(&by_field), silhouette(&by_cube));
    let off = a.iter().zip(&b).filter(|(a, b)| a != b).count();
    assert!(off * 25 < a.iter().filter(|p| **p).count(), "{off} pixels");
}
