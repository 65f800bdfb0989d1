//! Voxel types, volumes with their own colours, and volumes too large for the device.

use super::{agree, with_renderer};
use crate::metrics::{STEP, difference};
use crate::scenes;
use glam::Vec3;
use incise::prepare::{Assets, Prepared};
use incise::scene::{Deformation, Mode, Scene};
use incise::volume::{Colors, Rescale, StoredValues, Volume, VoxelGrid, Voxels, phantom};
use incise::{Watch, cpu};

pub(super) fn voxel_types_agree() {
    let phantom = phantom::generate("tomato", [48; 3], Vec3::splat(160.0 / 48.0)).unwrap();
    let values: Vec<f64> = (0..phantom.voxels.len()).map(|n| phantom.voxels.get(n)).collect();
    let types: [StoredValues; 5] = [
        values.iter().map(|v| *v as u8).collect::<Vec<_>>().into(),
        values
            .iter()
            .map(|v| (*v * 100.0) as u16)
            .collect::<Vec<_>>()
            .into(),
        values
            .iter()
            .map(|v| (*v * 100.0 - 9000.0) as i16)
            .collect::<Vec<_>>()
            .into(),
        values
            .iter()
            .map(|v| if *v == 254.0 { f32::NAN } else { *v as f32 })
            .collect::<Vec<_>>()
            .into(),
        values.clone().into(),
    ];
    for voxels in types {
        let name = voxels.type_name();
        let volume = Volume::new(
            Voxels::new(phantom.size, voxels),
            Rescale::NONE,
            phantom.world_from_voxel,
        );
        let mut scene = Scene::of_volume("phantom:tomato");
        scene.render.size = [96, 96];
        let factor = (volume.range[1] - volume.range[0]) / 205.0;
        scene.transfer.window = Some(200.0 * factor);
        scene.transfer.level = Some(140.0 * factor + volume.range[0] - 50.0 * factor);
        let assets = Assets::of_volume(volume);
        assert!(VoxelGrid::new(&assets.volume).size == [48; 3]);
        agree(name, &Prepared::new(&scene, &assets).unwrap());
    }
}

/// Voxels with their own colours, opaque and not, undeformed and twisted, by rays and by slices;
/// and with the transfer function's colours if requested.
pub(super) fn own_colors_agree() {
    let phantom = phantom::generate("tomato", [48; 3], Vec3::splat(160.0 / 48.0)).unwrap();
    let count = phantom.voxels.len();
    let color = |n: usize| {
        [
            (n % 48 * 5) as u8,
            (n / 48 % 48 * 5) as u8,
            255 - (n / 2304 * 5) as u8,
        ]
    };
    let rgb: Vec<u8> = (0..count).flat_map(color).collect();
    let weight = |n: usize| if n.is_multiple_of(5) { 0 } else { 200u8 };
    let premultiplied = |n: usize| color(n).map(|c| (u32::from(c) * u32::from(weight(n)) / 255) as u8);
    let rgba: Vec<u8> = (0..count)
        .flat_map(|n| {
            [
                premultiplied(n)[0],
                premultiplied(n)[1],
                premultiplied(n)[2],
                weight(n),
            ]
        })
        .collect();
    for (name, colors) in [("RGB", Colors::rgb(rgb)), ("RGBA", Colors::Rgba(rgba.into()))] {
        let mut volume = phantom.clone();
        volume.colors = Some(colors);
        let assets = Assets::of_volume(volume);
        let mut scene = Scene::of_volume("phantom:tomato");
        scene.render.size = [96, 96];
        scene.deformation.push(Deformation::new("twist"));
        for mode in [Mode::Raycast, Mode::Slice] {
            scene.render.mode = mode;
            agree(
                &format!("{name} {mode:?}"),
                &Prepared::new(&scene, &assets).unwrap(),
            );
        }
        let own = cpu::render(&Prepared::new(&scene, &assets).unwrap()).picture;
        scene.transfer.own_colors = Some(false);
        let table = cpu::render(&Prepared::new(&scene, &assets).unwrap()).picture;
        assert!(
            difference(&own, &table).unwrap().mean > 5.0 * STEP,
            "{name}: colours show"
        );
    }
}

/// A volume too large for the device is shown reduced, with a notice: never black, never refused.
pub(super) fn larger_than_the_device_is_reduced() {
    let most = with_renderer(|r| r.device().device.limits().max_texture_dimension_3d) as usize;
    let volume = Volume::new(
        Voxels::new([most + 1, 900, 1], vec![200u8; (most + 1) * 900]),
        Rescale::NONE,
        glam::DAffine3::IDENTITY,
    );
    let assets = Assets::of_volume(volume);
    let mut scene = Scene::of_volume("phantom:ball");
    scene.render.size = [64, 64];
    scene.camera.view = "superior".parse().unwrap();
    scene.transfer.points = vec![incise::transfer::ControlPoint {
        value: 0.0,
        color: [1.0; 3],
        opacity: 1.0,
    }];
    let done =
        with_renderer(|r| r.render(&Prepared::new(&scene, &assets).unwrap(), false, &Watch::NONE)).unwrap();
    assert!(
        done.notices[0].contains("exceeds this GPU")
            && done.notices[0].contains(&format!("{} x 900 x 1", (most + 1).div_ceil(2))),
        "{:?}",
        done.notices
    );
    assert!(done.picture.pixels.iter().any(|p| p[3] > 0.5));
    // Coloured labels and a scan, with a cut: the reduced picture is close to the full one.
    for (spec, bound) in [
        ("phantom:head-ct:size=64", 4.0),
        ("volumes/colin27-aal-labels.nii.gz", 9.0),
    ] {
        let mut scene = Scene::of_volume(spec);
        scene.folder = env!("CARGO_MANIFEST_DIR").into();
        scene.render.size = [128, 128];
        scene.deformation.push(Deformation::new("box"));
        let assets = scenes::assets(&scene);
        let prepared = Prepared::new(&scene, &assets).unwrap();
        let whole = with_renderer(|r| r.render(&prepared, false, &Watch::NONE)).unwrap();
        let reduced = with_renderer(|r| {
            r.limit_volume(if spec.starts_with("phantom") { 40 } else { 110 }, u64::MAX);
            let done = r.render(&prepared, false, &Watch::NONE);
            r.limit_volume(usize::MAX, u64::MAX);
            done.unwrap()
        });
        assert!(whole.notices.is_empty() && reduced.notices.len() == 1, "{spec}");
        let d = difference(&whole.picture, &reduced.picture).unwrap();
        println!("{spec} by half the voxels: mean {:.2}/255", d.mean / STEP);
        assert!(
            d.mean < bound * STEP && d.mean > 0.01 * STEP,
            "{spec}: {}",
            d.mean / STEP
        );
    }
}
