//! Fields and transforms from files, inversion, composition and baking: compared with SimpleITK
//! (tests/fixtures/itk, which includes the generating script), with closed forms, and between all
//! axis orientations.

use crate::closed_forms::picture;
use crate::contract::points;
use crate::metrics::difference;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use incise::Watch;
use incise::deform::transform::{Transform, TransformContext, TransformStep, VectorField};
use incise::deform::{Arguments, Stack, StackAndCuts, Storage, invert};
use incise::export::bake::{self, Interpolation};
use incise::prepare::{Assets, Prepared};
use incise::prepare::{StackInputs, stack};
use incise::scene::{DefaultPlacement, Deformation, Scene};
use incise::volume::save::{self, Content, Format};
use incise::volume::{GridGeometry, Rescale, Volume, load};
use std::path::{Path, PathBuf};

mod stacks;

pub use stacks::*;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/itk")
        .join(name)
}

/// Real data outside the repository, if available.
fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../shared/data")
        .join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {name} is not there");
    None
}

fn field(path: &Path) -> Deformation {
    Deformation {
        parameters: Arguments::from([("path", path.to_str().unwrap().into())]),
        ..Deformation::new("field")
    }
}

pub fn stack_of(
    scene: &Scene,
    assets: &Assets,
    storage: Option<Storage>,
) -> (Stack, incise::deform::cut::CutShapes) {
    let scene_box = assets.volume.bounds_in_world();
    let view = scene.camera.frame(&scene_box, scene.render.size).unwrap();
    let inputs = StackInputs {
        library: &assets.library,
        scene_box,
        min_ramp_mm: 1.5,
        view: &view,
        storage,
        exact_cuts: true,
        accelerator: &incise::prepare::CpuOnly,
        watch: &Watch::NONE,
    };
    let placed = stack::stack(&scene.deformation, &inputs, Vec::new(), Vec::new()).unwrap();
    (placed.stack, placed.cuts)
}

fn assets(scene: &Scene) -> Assets {
    Assets::load(scene).unwrap()
}

/// Bakes a scene and reads the result back.
fn baked(scene: &Scene, fill: f64, interpolation: Interpolation) -> Volume {
    let assets = assets(scene);
    let (stack, cuts) = stack_of(scene, &assets, Some(Storage::F32));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("baked.nii.gz");
    let mut file = std::fs::File::create(&path).unwrap();
    let volume = &assets.volume;
    let what = StackAndCuts {
        stack: &stack,
        cuts: &cuts,
    };
    let options = bake::BakeOptions {
        interpolation: Some(interpolation),
        fill: Some(fill),
        progress: None,
    };
    bake::volume(
        volume,
        &what,
        &volume.geometry(),
        Format::NiftiGz,
        &mut file,
        &options,
    )
    .unwrap();
    drop(file);
    load::volume(&path, &load::ReadOptions::default(), &Watch::NONE).unwrap()
}

/// Baking with each of ITK's transforms agrees with SimpleITK's Resample to within one grey level
/// everywhere.
pub fn baking_is_itk_resampling() {
    let cases = [
        ("field.nrrd", "resampled-field.nii.gz"),
        ("field.mha", "resampled-field.nii.gz"),
        ("field.nii.gz", "resampled-field.nii.gz"),
        ("euler.tfm", "resampled-euler.nii.gz"),
        ("similarity.tfm", "resampled-similarity.nii.gz"),
        ("bspline.tfm", "resampled-bspline.nii.gz"),
        ("composite.tfm", "resampled-affine-then-field.nii.gz"),
        #[cfg(feature = "hdf5")]
        ("composite.h5", "resampled-affine-then-field.nii.gz"),
    ];
    let mut scene = Scene::of_volume(fixture("volume.nii.gz").to_str().unwrap());
    for (transform, expected) in cases {
        scene.deformation = vec![field(&fixture(transform))];
        let (got, want) = (
            baked(&scene, -1000.0, Interpolation::Linear),
            load::volume(&fixture(expected), &load::ReadOptions::default(), &Watch::NONE).unwrap(),
        );
        let worst = (0..got.voxels.len())
            .map(|n| (got.voxels.get(n) - want.voxels.get(n)).abs())
            .fold(0.0, f64::max);
        println!("{transform}: largest difference {worst} grey levels");
        assert!(worst <= 1.0, "{transform}: {worst}");
        let moved = (0..got.voxels.len())
            .filter(|&n| got.voxels.get(n) != -1000.0)
            .count();
        assert!(moved > 4000);
    }
    // The same chain from two files: the affine is applied to the deformed point first.
    let paths = ["affine.tfm", "field.nrrd"].map(|n| fixture(n).to_str().unwrap().to_owned());
    let chain = Deformation {
        parameters: Arguments::from([("path", incise::deform::Argument::Texts(paths.to_vec()))]),
        ..Deformation::new("field")
    };
    scene.deformation = vec![chain];
    let (got, want) = (
        baked(&scene, -1000.0, Interpolation::Linear),
        load::volume(
            &fixture("resampled-affine-then-field.nii.gz"),
            &load::ReadOptions::default(),
            &Watch::NONE,
        )
        .unwrap(),
    );
    assert!((0..got.voxels.len()).all(|n| (got.voxels.get(n) - want.voxels.get(n)).abs() <= 1.0));
}

/// One affine written by ITK, AFNI, FSL and FreeSurfer, for four orientations of its image, is one
/// transform.
pub fn affine_conventions_agree() {
    let Some(folder) = shared("transforms") else {
        return;
    };
    let itk = Transform::load(&folder.join("affine-LPS.itk.tfm"), &TransformContext::default())
        .unwrap()
        .as_affine()
        .unwrap();
    let close = |a: &DAffine3, what: &str, tolerance: f64| {
        for p in points(50) {
            let p = (p.as_dvec3() - 0.5) * 160.0;
            let d = a.transform_point3(p).distance(itk.transform_point3(p));
            assert!(d < tolerance, "{what}: {d} mm at {p}");
        }
    };
    for orientation in ["LPS", "RAS", "LAS", "oblique"] {
        let load = |ending: &str, context: &TransformContext| {
            Transform::load(&folder.join(format!("affine-{orientation}.{ending}")), context)
                .unwrap()
                .as_affine()
                .unwrap()
        };
        close(&load("itk.tfm", &TransformContext::default()), "itk", 1e-9);
        close(&load("afni", &TransformContext::default()), "afni", 2e-3);
        // The fixture's matrix maps src to dst as FreeSurfer defines it, and is the inverse of the
        // others: the program that wrote it omitted the inversion that the format requires.
        close(
            &load("fs.lta", &TransformContext::default()).inverse(),
            "lta",
            2e-3,
        );
        // The grid to which FSL's millimetres refer is described in the .lta file next to it.
        let text = std::fs::read_to_string(folder.join(format!("affine-{orientation}.fs.lta"))).unwrap();
        let numbers = |name: &str| -> DVec3 {
            let line = text
                .lines()
                .find(|l| l.trim_start().starts_with(name) && l.contains('='))
                .unwrap();
            let v: Vec<f64> = line
                .split('=')
                .nth(1)
                .unwrap()
                .split_whitespace()
                .map(|w| w.parse().unwrap())
                .collect();
            DVec3::new(v[0], v[1], v[2])
        };
        let (size, spacing) = (numbers("volume"), numbers("voxelsize"));
        let linear = DMat3::from_cols(
            numbers("xras") * spacing.x,
            numbers("yras") * spacing.y,
            numbers("zras") * spacing.z,
        );
        let ras = DAffine3 {
            matrix3: linear,
            translation: numbers("cras") - linear * (size / 2.0),
        };
        let grid = GridGeometry {
            size: [size.x as usize, size.y as usize, size.z as usize],
            world_from_voxel: DAffine3::from_scale(DVec3::new(-1.0, -1.0, 1.0)) * ras,
        };
        close(
            &load(
                "fsl",
                &TransformContext {
                    moving: Some(grid),
                    reference: Some(grid),
                    convention: None,
                },
            ),
            "fsl",
            2e-3,
        );
    }
    let v2v = Transform::load(
        &folder.join("affine-RAS.fs.v2v.lta"),
        &TransformContext::default(),
    )
    .unwrap()
    .as_affine()
    .unwrap();
    close(&v2v.inverse(), "lta, voxel to voxel", 2e-3);
}

/// A vector field stored in another frame is the same field in the world.
pub fn vectors_turn_with_their_axes() {
    let image = load::image(
        &fixture("field.nrrd"),
        &load::ReadOptions::default(),
        &Watch::NONE,
    )
    .unwrap();
    let lps = VectorField::of_image(Path::new("x"), &image, &TransformContext::default()).unwrap();
    // Built by hand: the same vectors with RAS components in a file that declares RAS.
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, intent: i16, flip: Vec3| {
        let values: Vec<f32> = lps.vectors.iter().flat_map(|v| (*v * flip).to_array()).collect();
        let mut bytes = save::encode(Format::Nifti, &lps.grid, Content::Field, &values).unwrap();
        bytes[68..70].copy_from_slice(&intent.to_le_bytes());
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let ras = write("ras.nii", 1006, Vec3::new(-1.0, -1.0, 1.0));
    let fsl_axes = {
        // FSL's x runs against the first voxel axis of a right-handed grid; its vectors are along
        // the grid's axes.
        let m = lps.grid.world_from_voxel.matrix3;
        let axes = DMat3::from_cols(-m.x_axis.normalize(), m.y_axis.normalize(), m.z_axis.normalize());
        assert!(m.determinant() > 0.0);
        let values: Vec<f32> = lps
            .vectors
            .iter()
            .flat_map(|v| (axes.inverse() * v.as_dvec3()).as_vec3().to_array())
            .collect();
        let mut bytes = save::encode(Format::Nifti, &lps.grid, Content::Field, &values).unwrap();
        bytes[68..70].copy_from_slice(&2006i16.to_le_bytes());
        let path = folder.path().join("fsl.nii");
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let nrrd_ras = {
        let text = std::fs::read(fixture("field.nrrd")).unwrap();
        assert!(text.windows(23).any(|w| w == b"left-posterior-superior"));
        let values: Vec<f32> = lps.vectors.iter().flat_map(|v| [-v.x, -v.y, v.z]).collect();
        let flip = DAffine3::from_scale(DVec3::new(-1.0, -1.0, 1.0));
        let grid = GridGeometry {
            size: lps.grid.size,
            world_from_voxel: flip * lps.grid.world_from_voxel,
        };
        let bytes = save::encode(Format::Nrrd, &grid, Content::Field, &values).unwrap();
        let at = bytes
            .windows(23)
            .position(|w| w == b"left-posterior-superior")
            .unwrap();
        let path = folder.path().join("ras.nrrd");
        std::fs::write(
            &path,
            [&bytes[..at], b"right-anterior-superior", &bytes[at + 23..]].concat(),
        )
        .unwrap();
        path
    };
    for path in [ras, fsl_axes, nrrd_ras] {
        let t = Transform::load(&path, &TransformContext::default()).unwrap();
        for p in points(200) {
            let p = lps.grid.world_from_voxel.transform_point3(p.as_dvec3() * 11.0);
            let d = t.source_from_deformed(p).distance(lps.source_from_deformed(p));
            assert!(d < 1e-3, "{}: {d}", path.display());
        }
    }
    let unknown = write("unknown.nii", 0, Vec3::ONE);
    let message = Transform::load(&unknown, &TransformContext::default())
        .err()
        .unwrap()
        .to_string();
    assert!(message.contains("convention"), "{message}");
}

/// A grid with its axes permuted and some of them flipped, and a function from its voxel indices to
/// the voxels of `grid`.
fn permuted(
    grid: &GridGeometry,
    order: [usize; 3],
    flips: usize,
) -> (GridGeometry, impl Fn(usize) -> DVec3 + use<>) {
    let size = order.map(|a| grid.size[a]);
    let flipped = |a: usize| flips >> a & 1 == 1;
    let mut m = DMat3::ZERO;
    let mut first = DVec3::ZERO;
    for (a, &o) in order.iter().enumerate() {
        *m.col_mut(a) = DVec3::AXES[o] * if flipped(a) { -1.0 } else { 1.0 };
        if flipped(a) {
            first[o] = (grid.size[o] - 1) as f64;
        }
    }
    let grid_from_permuted = DAffine3 {
        matrix3: m,
        translation: first,
    };
    let at = move |n: usize| {
        let c = DVec3::new(
            (n % size[0]) as f64,
            (n / size[0] % size[1]) as f64,
            (n / size[0] / size[1]) as f64,
        );
        grid_from_permuted.transform_point3(c).round()
    };
    (
        GridGeometry {
            size,
            world_from_voxel: grid.world_from_voxel * grid_from_permuted,
        },
        at,
    )
}

/// Volume and field stored in each of the 48 orders and directions of their axes: the same world
/// values, the same picture.
pub fn all_orientations_agree() {
    let base = load::volume(
        &fixture("volume.nii.gz"),
        &load::ReadOptions::default(),
        &Watch::NONE,
    )
    .unwrap();
    let warp = {
        let image = load::image(
            &fixture("field.nrrd"),
            &load::ReadOptions::default(),
            &Watch::NONE,
        )
        .unwrap();
        VectorField::of_image(Path::new("x"), &image, &TransformContext::default()).unwrap()
    };
    let folder = tempfile::tempdir().unwrap();
    let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let index = |size: [usize; 3], c: DVec3| (c.z as usize * size[1] + c.y as usize) * size[0] + c.x as usize;
    let mut reference: Option<(Vec<f64>, incise::picture::Picture)> = None;
    let (mut worst_value, mut worst_picture) = (0.0f64, 0.0f64);
    for order in orders {
        for flips in 0..8 {
            let (grid, at) = permuted(&base.geometry(), order, flips);
            let values: Vec<f32> = (0..base.voxels.len())
                .map(|n| base.voxels.get(index(base.size, at(n))) as f32)
                .collect();
            let content = Content::Scalar(load::ScalarType::F32, Rescale::NONE);
            let volume = folder.path().join("volume.nii");
            std::fs::write(
                &volume,
                save::encode(Format::Nifti, &grid, content, &values).unwrap(),
            )
            .unwrap();
            let (field_grid, field_at) = permuted(&warp.grid, order, 7 - flips);
            let vectors: Vec<f32> = (0..warp.vectors.len())
                .flat_map(|n| {
                    incise::math::flat(&warp.vectors)[index(warp.grid.size, field_at(n))].to_array()
                })
                .collect();
            let (name, format) = [
                ("field.nii", Format::Nifti),
                ("field.nrrd", Format::Nrrd),
                ("field.mha", Format::Mha),
            ][flips % 3];
            let path = folder.path().join(name);
            std::fs::write(
                &path,
                save::encode(format, &field_grid, Content::Field, &vectors).unwrap(),
            )
            .unwrap();
            let mut scene = Scene::of_volume(volume.to_str().unwrap());
            scene.deformation = vec![field(&path)];
            scene.render.size = [48, 48];
            scene.camera.view = "30,20".parse().unwrap();
            let out = baked(&scene, -1000.0, Interpolation::Linear);
            let mut in_base = vec![0.0; base.voxels.len()];
            (0..in_base.len()).for_each(|n| in_base[index(base.size, at(n))] = out.voxels.get(n));
            let assets = assets(&scene);
            let shown = picture(&Prepared::new(&scene, &assets).unwrap());
            let (values, first) = reference.get_or_insert_with(|| (in_base.clone(), shown.clone()));
            worst_value = worst_value.max(
                values
                    .iter()
                    .zip(&in_base)
                    .map(|(a, b)| (a - b).abs())
                    .fold(0.0, f64::max),
            );
            worst_picture = worst_picture.max(difference(first, &shown).unwrap().mean);
        }
    }
    println!(
        "48 orientations: baked values within {worst_value:.4} grey levels, pictures within a mean of {:.4}/255",
        worst_picture * 255.0
    );
    // Points exactly on the volume's faces may round to either side; grey values reach 600.
    assert!(worst_value < 0.05 && worst_picture < 0.3 / 255.0);
}

/// The baked volume looks like the volume deformed at render time, except for the blur of
/// resampling.
pub fn live_is_the_baked_picture() {
    let head = Path::new(env!("CARGO_MANIFEST_DIR")).join("volumes/colin27-head-t1.nii.gz");
    let mut scene = Scene::of_volume(head.to_str().unwrap());
    scene.transfer.preset = Some("mr-default".into());
    scene.render.size = [256, 256];
    scene.camera.view = "40,24".parse().unwrap();
    // In the middle of the volume, so that nothing is pushed out of its grid.
    let in_middle = |kind: &str, parameters: Arguments| Deformation {
        placement: DefaultPlacement::Volume,
        parameters,
        ..Deformation::new(kind)
    };
    let angle = Arguments::from([("angle", 40.0.into())]);
    scene.deformation = vec![
        in_middle("twist", angle),
        in_middle("spline-pull", Arguments::default()),
    ];
    let own = assets(&scene);
    let live = picture(&Prepared::new(&scene, &own).unwrap());
    for (interpolation, least) in [(Interpolation::Linear, 35.0), (Interpolation::Cubic, 35.0)] {
        let volume = baked(&scene, 0.0, interpolation);
        let mut still = scene.clone();
        still.deformation.clear();
        let assets = Assets::of_volume(volume);
        let d = difference(&live, &picture(&Prepared::new(&still, &assets).unwrap())).unwrap();
        println!(
            "live against baked ({interpolation:?}): PSNR {:.1} dB, mean {:.3}/255",
            d.psnr,
            d.mean * 255.0
        );
        assert!(d.psnr >= least, "{interpolation:?}: {d:?}");
    }
}

/// Inverting the FSL warp: the residual is below a fiftieth of a voxel except near folds, measured
/// between grid points.
pub fn fsl_warp_is_inverted() {
    let Some(path) = shared("transforms/oasis_to_t1_fsl_warp_4mm_downsampled.nii.gz") else {
        return;
    };
    let t = Transform::load(&path, &TransformContext::default()).unwrap();
    let [TransformStep::Field(warp)] = &t.steps[..] else {
        panic!()
    };
    let inverse = invert::field(warp);
    println!("FSL warp: {:?}", inverse.report);
    assert!(inverse.report.p99_mm <= 0.02 * 4.0 && inverse.report.not_found == 0);
    let s = warp.vectors.iter().map(|v| v.length()).fold(0.0, f32::max);
    assert!(s > 11.0 && s < 12.0, "largest displacement {s} mm");
}

/// A radial field with a closed-form inverse: r' = r (1 + a (1 - r²)²) within a ball.
pub fn radial_field_is_inverted() {
    let radius = 40.0;
    let forward = |p: DVec3| {
        let r2 = (p.length_squared() / (radius * radius)).min(1.0);
        p * (1.0 + 0.5 * (1.0 - r2).powi(2))
    };
    let n = 49;
    let grid = GridGeometry {
        size: [n; 3],
        world_from_voxel: DAffine3 {
            matrix3: DMat3::from_diagonal(DVec3::splat(96.0 / (n - 1) as f64)),
            translation: DVec3::splat(-48.0),
        },
    };
    let inverse = invert::function(&forward, &grid);
    assert_eq!(inverse.report.not_found, 0);
    assert!(inverse.report.p99_mm <= 0.02 * 2.0, "{:?}", inverse.report);
    for p in points(3000) {
        let x = (p.as_dvec3() - 0.5) * 70.0;
        // Between grid points the inverse has an interpolation error: h²/8 times the second
        // derivative, about 0.1 / mm, on each axis.
        let back = inverse.field.source_from_deformed(forward(x));
        assert!(
            back.distance(x) < 3f64.sqrt() * 4.0 / 8.0 * 0.1,
            "{x} came back as {back}"
        );
    }
}

/// Maps, fields and volumes written in each format are read back with the same values and geometry.
pub fn written_files_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let base = load::volume(
        &fixture("volume.nii.gz"),
        &load::ReadOptions::default(),
        &Watch::NONE,
    )
    .unwrap();
    let grid = base.geometry();
    let values: Vec<f32> = (0..base.voxels.len())
        .map(|n| base.voxels.get(n) as f32)
        .collect();
    for name in ["a.nii", "a.nii.gz", "a.nrrd", "a.mha"] {
        let path = folder.path().join(name);
        let format = Format::of(&path).unwrap();
        std::fs::write(
            &path,
            save::encode(
                format,
                &grid,
                Content::Scalar(load::ScalarType::F32, Rescale::NONE),
                &values,
            )
            .unwrap(),
        )
        .unwrap();
        let v = load::volume(&path, &load::ReadOptions::default(), &Watch::NONE).unwrap();
        assert_eq!(v.size, base.size);
        assert!(
            (0..values.len()).all(|n| v.voxels.get(n) == f64::from(values[n])),
            "{name}"
        );
        let (a, b) = (v.world_from_voxel, base.world_from_voxel);
        assert!(
            a.matrix3.abs_diff_eq(b.matrix3, 1e-6) && a.translation.abs_diff_eq(b.translation, 1e-5),
            "{name}: {a:?} {b:?}"
        );
        assert_eq!(v.warnings, Vec::<String>::new(), "{name}");
    }
    // A peel with its mask.
    let mut scene = Scene::of_volume("phantom:head-ct:size=48");
    scene.deformation = vec![Deformation {
        rotate: Some([10.0, 20.0, 30.0]),
        resolution: Some(32),
        ..Deformation::new("peel")
    }];
    let assets = assets(&scene);
    let (stack, _) = stack_of(&scene, &assets, Some(Storage::F32));
    let path = folder.path().join("peel.nrrd");
    std::fs::write(&path, incise::deform::saved::encode(&stack.maps()[0]).unwrap()).unwrap();
    let back = incise::deform::saved::read(&path, Storage::F32, 1.0).unwrap();
    for p in points(3000) {
        let p = (p - 0.5) * 160.0;
        let ((a, alpha), (b, beta)) = (stack.maps()[0].backward(p), back.backward(p));
        assert!(
            a.distance(b) < 2e-3 && (alpha - beta).abs() < 1e-3,
            "{p}: {a} {b}"
        );
    }
}

/// A NaN voxel does not spread to its neighbours.
pub fn baking_keeps_nan_in_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let grid = GridGeometry {
        size: [5; 3],
        world_from_voxel: DAffine3::from_rotation_z(0.3),
    };
    let values: Vec<f32> = (0..125)
        .map(|n| if n == 62 { f32::NAN } else { n as f32 })
        .collect();
    let path = folder.path().join("nan.nii");
    let content = Content::Scalar(load::ScalarType::F32, Rescale::NONE);
    std::fs::write(
        &path,
        save::encode(Format::Nifti, &grid, content, &values).unwrap(),
    )
    .unwrap();
    for interpolation in [Interpolation::Linear, Interpolation::Cubic] {
        let out = baked(&Scene::of_volume(path.to_str().unwrap()), 0.0, interpolation);
        let bad: Vec<usize> = (0..125).filter(|n| out.voxels.get(*n).is_nan()).collect();
        assert_eq!(bad, [62], "{interpolation:?}");
    }
}
