//! Distance fields of meshes.

use super::{field, grid_points, render, silhouette, write_off};
use glam::{Affine3A, Vec3};
use incise::math::Bounds;
use incise::mesh::field::FieldSettings;
use incise::mesh::{Mesh, shapes};
use incise::scene::Scene;
use incise::scene::surface::DeformerSource;

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
        let f = field(
            &mesh.transformed(&turn),
            FieldSettings {
                resolution: 64,
                ..FieldSettings::default()
            },
        );
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
        println!(
            "{name}: largest error {band:.4} cells in the band, {beyond:.3} beyond; {wrong} wrong signs; residual {:?}",
            f.eikonal
        );
        assert!(band <= 0.05 && beyond < 0.5 && wrong == 0, "{name}");
    }
    let exact = field(
        &shapes::sphere(10.0, 200),
        FieldSettings {
            resolution: 40,
            exact: true,
            ..FieldSettings::default()
        },
    );
    let worst = grid_points(&exact)
        .map(|(p, d)| (d - (10.0 - p.length())).abs())
        .fold(0.0, f32::max)
        / exact.grid.spacing_mm();
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
        soup.positions
            .extend(p.map(|q| q * (1.0 + 1e-3 * (t % 3) as f32)));
        soup.triangles.push([first, first + 1, first + 2]);
    }
    let mut turned = ball();
    turned
        .triangles
        .iter_mut()
        .enumerate()
        .filter(|(n, _)| n % 5 < 2)
        .for_each(|(_, t)| t.swap(0, 1));
    let mut inward = ball();
    inward.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    for (name, mesh) in [
        ("holes", holes),
        ("soup", soup),
        ("contradicting", turned),
        ("inward", inward),
    ] {
        let f = field(
            &mesh,
            FieldSettings {
                resolution: 48,
                ..FieldSettings::default()
            },
        );
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
            assert!(
                d < 0.0 || !(at.cmple(Vec3::ZERO).any() || at.cmpge(top).any()),
                "{name} leaks"
            );
        }
        println!("{name}: {wrong} of {all} signs wrong, doubtful {:.3}", f.doubtful);
        assert!(wrong * 200 < all, "{name}: {wrong} of {all}");
    }
}

/// The field of a region equals that region of the whole field.
pub fn a_part_is_part_of_the_whole() {
    let mesh = shapes::torus(10.0, 3.0, 100);
    let whole = field(
        &mesh,
        FieldSettings {
            resolution: 96,
            ..FieldSettings::default()
        },
    );
    let region = Bounds::new(Vec3::new(4.0, -6.0, -4.0), Vec3::new(14.0, 6.0, 4.0));
    let part = field(
        &mesh,
        FieldSettings {
            resolution: 96,
            region: Some(region),
            ..FieldSettings::default()
        },
    );
    assert!(part.grid.distance_mm.len() * 3 < whole.grid.distance_mm.len());
    for (p, d) in grid_points(&part) {
        assert!(
            (d - whole.grid.sample(p)).abs() < 0.06 * part.grid.spacing_mm()
                || d.abs() > 2.0 * part.grid.spacing_mm(),
            "{p}: {d}"
        );
    }
}

/// A flat sheet can be rendered and deformed; an open mesh that faces inwards is reoriented
/// wherever it lies.
pub fn thin_flat_and_far_things() {
    let mut half = shapes::sphere(10.0, 40);
    half.triangles
        .retain(|t| t.iter().all(|v| half.positions[*v as usize].z > -0.1));
    half.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    for z in [0.0, -100.0] {
        let moved = half.clone().transformed(&Affine3A::from_translation(Vec3::Z * z));
        let f = field(
            &moved,
            FieldSettings {
                resolution: 40,
                ..FieldSettings::default()
            },
        );
        assert!(
            f.grid.sample(Vec3::new(0.0, 0.0, z + 6.0)) > 0.0 && f.inside > 0.1,
            "{z}: {}",
            f.inside
        );
    }
    // A region far from every surface still has correct distances.
    let part = FieldSettings {
        cell_mm: Some(0.5),
        region: Some(Bounds::new(Vec3::splat(-1.0), Vec3::splat(1.0))),
        ..FieldSettings::default()
    };
    let f = field(&shapes::sphere(10.0, 60), part);
    assert!(grid_points(&f).all(|(p, d)| (d - (10.0 - p.length())).abs() < 0.05));
    let folder = tempfile::tempdir().unwrap();
    let sheet = write_off(
        folder.path(),
        "sheet.off",
        &Mesh::new(
            vec![
                Vec3::ZERO,
                Vec3::X * 50.0,
                Vec3::new(50.0, 50.0, 0.0),
                Vec3::Y * 50.0,
            ],
            vec![[0, 1, 2], [0, 2, 3]],
            vec![],
        ),
    );
    let mut scene = Scene::of_mesh(sheet.to_str().unwrap());
    scene.mesh[0].tessellate = Some(0.2);
    scene.mesh[0].deformer = vec![DeformerSource {
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
