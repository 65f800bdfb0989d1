//! Volumes given by a function: evaluated at every sample, in every mode, on both backends.

use crate::closed_forms::picture;
use crate::metrics::{STEP, difference};
use crate::scenes::assets;
use incise::prepare::Prepared;
use incise::scene::{Antialias, DefaultPlacement, Deformation, Mode, Projection, Scene, VolumeFilter};
use incise::transfer::ControlPoint;
use incise::volume::phantom;

/// A scene of a volume with a twist and a cut.
fn deformed(volume: &str) -> Scene {
    let mut scene = Scene::of_volume(volume);
    scene.render.size = [96, 96];
    scene.deformation = ["twist", "box"].map(Deformation::new).to_vec();
    for d in &mut scene.deformation {
        // What is seen of voxels and of their function differs a little.
        d.placement = DefaultPlacement::Volume;
    }
    scene
}

/// Two bodies with soft edges, wide enough for a coarse grid.
const BODIES: &str = "cover(ellipsoid(0, 0, 0, 60, 50, 40), 12) + cover(sphere(20, -30, 40, 22), 12)";

fn bodies(options: &str) -> Scene {
    let mut scene = deformed(&format!("function:{BODIES}:{options}"));
    let point = |value, opacity, color| ControlPoint {
        value,
        color,
        opacity,
    };
    scene.transfer.points = vec![
        point(0.2, 0.0, [1.0, 0.9, 0.8]),
        point(1.0, 0.3, [1.0, 0.9, 0.8]),
        point(2.0, 0.9, [0.7, 0.1, 0.1]),
    ];
    scene
}

/// Voxels approach their function as they become smaller: the difference falls by four with every
/// halving of their size, as that of linear interpolation does.
pub fn voxels_approach_their_function() {
    let render = |options: String, size: f32| {
        let mut scene = bodies(&options);
        // Samples 2 mm apart for all sizes of voxels.
        scene.render.step = 2.0 * size / 160.0;
        scene.render.normals = incise::scene::Normals::None;
        scene.render.filter = VolumeFilter::Linear;
        picture(&Prepared::new(&scene, &assets(&scene)).unwrap())
    };
    let differences = [16, 32, 64].map(|size| {
        let [voxels, function] = ["voxels", "function"]
            .map(|sampling| render(format!("size={size}:sampling={sampling}"), size as f32));
        difference(&voxels, &function).unwrap().mean / STEP
    });
    println!("16, 32, 64 voxels against their function: {differences:.3?}/255");
    assert!(differences[0] > 0.5 && differences[2] < 0.3, "{differences:?}");
    for pair in differences.windows(2) {
        assert!(pair[0] > 2.5 * pair[1], "{differences:?}");
    }
}

/// At the voxels' centres a phantom's function is its voxels, up to the rounding of those.
pub fn phantoms_are_their_functions() {
    for (name, _) in phantom::list().filter(|(name, _)| *name != "octants") {
        let volume = phantom::from_spec(&format!("{name}:size=24:sampling=function")).unwrap();
        let function = volume.function.as_ref().unwrap();
        for n in (0..volume.voxels.len()).step_by(7) {
            let at = [n % 24, n / 24 % 24, n / 576];
            let p = volume
                .world_from_voxel
                .transform_point3(glam::DVec3::from(at.map(|i| i as f64)))
                .as_vec3();
            let mut value = [0.0];
            function.evaluate([&[p.x], &[p.y], &[p.z]], &mut value);
            let stored = volume.value(at[0], at[1], at[2]);
            assert!(
                (f64::from(value[0]) - stored).abs() <= 0.51,
                "{name} at {at:?}: {} for {stored}",
                value[0]
            );
        }
    }
}

/// Bounds by interval arithmetic skip nothing that shows, and slices and rays take the same samples
/// in an orthographic view.
pub fn functions_are_skipped_and_sliced() {
    for name in [
        "phantom:tomato:sampling=function:size=96",
        "phantom:head-ct:size=96:sampling=function",
    ] {
        let mut scene = deformed(name);
        scene.camera.projection = Projection::Orthographic;
        scene.render.early_termination = false;
        let assets = assets(&scene);
        let mut render = |mode, skipping| {
            (scene.render.mode, scene.render.empty_space_skipping) = (mode, skipping);
            let prepared = Prepared::new(&scene, &assets).unwrap();
            if skipping {
                let cells = &prepared.volume().macrocells;
                let count = cells.size.element_product() as usize;
                let occupied = (0..count).filter(|&n| cells.is_occupied(n)).count();
                let share = occupied as f32 / count as f32;
                println!("{name}: {share:.3} of the cells are occupied");
                assert!(share < 0.9, "{name}: bounds find nothing empty");
            }
            picture(&prepared)
        };
        let rays = render(Mode::Raycast, true);
        assert!(rays.pixels.iter().any(|p| p[3] > 0.5), "{name}");
        let whole = render(Mode::Raycast, false);
        let slices = render(Mode::Slice, true);
        let skipped = difference(&rays, &whole).unwrap();
        let sliced = difference(&rays, &slices).unwrap();
        println!(
            "{name}: skipping {:.5}/255, slices {:.5}/255",
            skipped.mean / STEP,
            sliced.mean / STEP
        );
        assert!(skipped.max <= 0.01 * STEP, "{name}: {skipped:?}");
        assert!(sliced.mean <= 0.05 * STEP, "{name}: {sliced:?}");
    }
}

pub fn mistakes_in_functions_are_named() {
    for (path, part) in [
        ("function:sine(x)", "there is no \"sine\""),
        ("function:x +", "it ends where"),
        ("function:x:size=1", "2 to 1024 voxels"),
        ("function:x:sampling=points", "voxels or function"),
        ("phantom:octants:sampling=function", "label map"),
    ] {
        let error = phantom::from_path(path).unwrap_err().to_string();
        assert!(
            error.contains(part) && error.contains(path.split(':').next().unwrap()),
            "{error}"
        );
    }
    assert!(phantom::from_path("head.nii").unwrap().is_none());
}

/// The device's pictures of functions are the CPU's.
#[cfg(feature = "gpu")]
pub fn functions_agree() {
    for name in [
        format!("function:{BODIES}"),
        "phantom:piggy-bank:sampling=function:size=64".into(),
        "phantom:tomato:sampling=function:size=64".into(),
        "phantom:teddy:sampling=function:size=64".into(),
        "phantom:head-ct:sampling=function:size=64".into(),
        "phantom:checker:sampling=function:size=64".into(),
        "function:gyroid(40) + 0.5 * noise(0.1*x, 0.1*y, 0.1*z) + mod(x, 30) / 60".into(),
    ] {
        let mut scene = deformed(&name);
        // Where a function jumps, rounding decides which pixels are sampled again.
        scene.render.antialias = Antialias::OFF;
        let assets = assets(&scene);
        for mode in [Mode::Raycast, Mode::Slice] {
            scene.render.mode = mode;
            crate::parity::agree(
                &format!("{name}, {mode:?}"),
                &Prepared::new(&scene, &assets).unwrap(),
            );
        }
    }
}
