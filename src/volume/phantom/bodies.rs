//! The functions of the phantoms: a value at a point in millimetres, given the width of a voxel.

use super::BALL_RADIUS_MM;
use crate::volume::function::{Point, Value, capsule, cover, cuboid, disc, ellipsoid, sphere};
use glam::{Quat, Vec3};
use std::f32::consts::TAU;

/// The point mirrored to positive x.
fn mirrored(p: Point<'_>) -> Point<'_> {
    Point::new(p.x.abs(), p.y, p.z)
}

/// The length of a vector of the plane.
fn plane_length<'g>(a: Value<'g>, b: Value<'g>) -> Value<'g> {
    (a.squared() + b.squared()).sqrt()
}

/// 1 where a value is above a number, else 0.
fn above(value: Value<'_>, number: f32) -> Value<'_> {
    value.constant(number).less(value)
}

pub(super) fn octants(p: Point<'_>, _: f32) -> Value<'_> {
    let label = 1.0 + above(p.x, 0.0) + 2.0 * above(p.y, 0.0) + 4.0 * above(p.z, 0.0);
    above(p.length(), BALL_RADIUS_MM).select(0.0, label)
}

pub(super) fn ball(p: Point<'_>, voxel: f32) -> Value<'_> {
    cover(BALL_RADIUS_MM - p.length(), voxel)
}

pub(super) fn shell(p: Point<'_>, voxel: f32) -> Value<'_> {
    cover(4.0 - (p.length() - (BALL_RADIUS_MM - 4.0)).abs(), voxel)
}

pub(super) fn checker<'g>(p: Point<'g>, voxel: f32) -> Value<'g> {
    // The product of three square waves, each with a smooth edge; the cube of checks fills the
    // whole grid.
    let wave = |x: Value<'g>| {
        let phase = (x / 16.0).remainder(2.0);
        let to_edge = 16.0
            * phase
                .less(1.0)
                .select(phase.min(1.0 - phase), -(phase - 1.0).min(2.0 - phase));
        2.0 * cover(to_edge, voxel) - 1.0
    };
    150.0 + 70.0 * wave(p.x) * wave(p.y) * wave(p.z)
}

pub(super) fn piggy_bank(p: Point<'_>, voxel: f32) -> Value<'_> {
    const AIR: f32 = 128.0;
    const CERAMIC: f32 = 255.0;
    const COIN: f32 = 0.0;
    // The snout faces anterior (-y), the back is up (+z).
    let m = mirrored(p);
    let body = ellipsoid(p, [0.0; 3], [46.0, 62.0, 46.0]);
    let hollow = ellipsoid(p, [0.0; 3], [39.0, 55.0, 39.0]);
    let snout = disc(p, [0.0, -62.0, -2.0], [0.0, 1.0, 0.0], 14.0, 10.0);
    let nostril = capsule(m, [5.0, -80.0, -2.0], [5.0, -68.0, -2.0], 2.6);
    let leg = |y: f32| capsule(m, [23.0, y, -28.0], [25.0, y, -58.0], 11.0);
    let floor = p.z + 62.0;
    let ear = ellipsoid(m, [24.0, -36.0, 38.0], [10.0, 5.0, 15.0]);
    let eye = sphere(m, [16.0, -54.0, 16.0], 4.0);
    let q = p.minus([0.0, 64.0, 14.0]);
    let tail = 3.0 - plane_length(plane_length(q.y, q.z) - 9.0, q.x);
    let solid = body
        .max(snout.min(6.0))
        .max(leg(-26.0).max(leg(28.0)).min(floor))
        .max(ear)
        .max(eye)
        .max(tail);
    let slot = cuboid(p, [0.0, 2.0, 46.0], [2.5, 18.0, 14.0]);
    let mut value =
        p.x.constant(AIR)
            .mix(CERAMIC, cover(solid.min(-hollow).min(-slot).min(-nostril), voxel));
    for n in 0..26u32 {
        // A heap of coins: golden-angle spiral, layer by layer, tilted in different directions.
        let layer = n / 9;
        let turn = n as f32 * 2.399_963;
        let reach = [25.0, 18.0, 11.0][layer as usize % 3] * ((n % 9) as f32 / 8.0).sqrt();
        let center = [
            reach * turn.cos(),
            1.3 * reach * turn.sin(),
            -27.0 + 9.5 * layer as f32 + 0.25 * reach,
        ];
        let axis = Quat::from_rotation_z(turn) * Quat::from_rotation_x(0.25 + 0.3 * (n % 4) as f32) * Vec3::Z;
        let coin = disc(p, center, axis.to_array(), 9.5, 1.6).min(hollow - 1.2 * voxel);
        value = value.mix(COIN, cover(coin, voxel));
    }
    value
}

pub(super) fn tomato(p: Point<'_>, voxel: f32) -> Value<'_> {
    const AIR: f32 = 255.0;
    const SKIN: f32 = 205.0;
    const FLESH: f32 = 150.0;
    const SEED: f32 = 95.0;
    const GEL: f32 = 50.0;
    let radial = plane_length(p.x, p.y);
    let angle = p.y.atan2(p.x);
    // Five lobes; the stem's dimple on top.
    let lobes = 1.0 + 0.035 * (5.0 * angle).cos() * (radial / 60.0).min(1.0);
    let dimple = 9.0 * (-(radial / 15.0).squared()).exp() * above(p.z, 0.0).select(1.0, 0.45);
    // As an ellipsoid of radii 64, 64, 54 in space that the lobes shrink.
    let q = Point::new(p.x / (64.0 * lobes), p.y / (64.0 * lobes), p.z / 54.0);
    let k0 = q.length();
    let k1 = Point::new(q.x / (64.0 * lobes), q.y / (64.0 * lobes), q.z / 54.0).length();
    let outer = k1.less(1e-9).select(54.0, k0 * (1.0 - k0) / k1) - dimple;
    let mut value =
        p.x.constant(AIR)
            .mix(SKIN, cover(outer, voxel))
            .mix(FLESH, cover(outer - 2.2, voxel));
    // Five chambers between the core and the wall, walls between them.
    let turns = angle * (5.0 / TAU);
    let sector = turns.remainder(1.0) - 0.5;
    let to_septum = (0.5 - sector.abs()) * (TAU / 5.0) * radial - 3.5;
    let chamber = (outer - 11.0).min(radial - 15.0).min(to_septum);
    value = value.mix(GEL, cover(chamber, voxel));
    // The seeds of the sector's own chamber, in a frame in which its middle lies along x.
    let turned = (turns.floor() + 0.5) * (TAU / 5.0);
    let (sine, cosine) = (turned.sin(), turned.cos());
    let own = Point::new(p.x * cosine + p.y * sine, p.y * cosine - p.x * sine, p.z);
    for n in 0..16 {
        let (row, column) = ((n / 4) as f32, (n % 4) as f32);
        let z = -24.0 + 16.0 * row + 3.0 * ((n * 7 % 5) as f32 / 5.0);
        let bend = (1.0 - (z / 50.0).powi(2)).max(0.1).sqrt();
        let a = (column - 1.5) * 0.19 * TAU / 5.0;
        let r = (24.0 + 13.0 * ((n * 5 % 4) as f32 / 3.0)) * bend;
        let seed = ellipsoid(own, [r * a.cos(), r * a.sin(), z], [3.4, 3.4, 4.6]).min(chamber - 1.0);
        value = value.mix(SEED, cover(seed, voxel));
    }
    value
}

pub(super) fn teddy(p: Point<'_>, voxel: f32) -> Value<'_> {
    const CLOTH: f32 = 95.0;
    const STUFFING: f32 = 185.0;
    const BUTTON: f32 = 44.0;
    const THREAD: f32 = 30.0;
    // The bear faces anterior (-y) and sits upright (+z).
    let m = mirrored(p);
    let body = ellipsoid(p, [0.0, 0.0, -22.0], [37.0, 31.0, 42.0]);
    let head = ellipsoid(p, [0.0, -4.0, 40.0], [33.0, 29.0, 29.0]);
    let muzzle = ellipsoid(p, [0.0, -31.0, 33.0], [14.0, 11.0, 11.0]);
    let ear = ellipsoid(m, [26.0, 0.0, 64.0], [12.0, 6.0, 12.0]);
    let arm = capsule(m, [32.0, -6.0, 2.0], [58.0, -18.0, -20.0], 11.5);
    let leg = capsule(m, [22.0, -10.0, -52.0], [36.0, -46.0, -60.0], 14.0);
    let solid = body.max(head).max(muzzle).max(ear).max(arm).max(leg);
    let fuzz = 0.5 * p.times([0.9; 3]).noise();
    // The seam: a shallow groove down the belly, with stitches across it.
    let on_belly = body.max(-4.0).min(4.0);
    let front = p.y.less(0.0);
    let groove = (1.4 - p.x.abs())
        .min(2.2 - on_belly.abs())
        .min((front * p.z.less(12.0) * above(p.z, -58.0)).select(2.0, -2.0));
    let stitch_z = (p.z / 7.0).round() * 7.0;
    let stitch = (0.9 - (p.z - stitch_z).abs())
        .min(4.5 - p.x.abs())
        .min(1.6 - (body + 0.4).abs())
        .min((front * stitch_z.abs().less(52.0)).select(1.0, -1.0));
    let strands = p.times([0.35, 0.35, 0.12]).noise() + 0.6 * p.times([0.5; 3]).noise();
    let eye = sphere(m, [12.0, -29.0, 48.0], 4.2);
    let nose = ellipsoid(p, [0.0, -41.0, 37.0], [5.5, 3.5, 4.0]);
    p.x.constant(0.0)
        .mix(CLOTH, cover(solid + fuzz, voxel))
        .mix(THREAD, cover(groove, voxel))
        .mix(THREAD + 25.0, cover(stitch, voxel))
        .mix(STUFFING + 30.0 * strands, cover(solid - 3.2, voxel))
        .mix(BUTTON, cover(eye.max(nose), voxel))
}

pub(super) fn head_ct(p: Point<'_>, voxel: f32) -> Value<'_> {
    // Hounsfield units of air, skin and muscle, bone, marrow, brain, fluid, lens.
    let m = mirrored(p);
    let cranium = [0.0, 6.0, 22.0];
    let skin = ellipsoid(p, cranium, [58.0, 70.0, 55.0])
        .max(ellipsoid(p, [0.0, -16.0, -14.0], [48.0, 46.0, 58.0]))
        .max(ellipsoid(p, [0.0, -66.0, -4.0], [8.0, 10.0, 16.0]))
        .max(ellipsoid(m, [58.0, 8.0, -4.0], [6.0, 11.0, 17.0]))
        .max(capsule(p, [0.0, 14.0, -40.0], [0.0, 16.0, -100.0], 36.0));
    let skull = ellipsoid(p, cranium, [52.0, 64.0, 49.0]);
    let brain = ellipsoid(p, cranium, [46.0, 58.0, 43.0]);
    let face = ellipsoid(p, [0.0, -34.0, -18.0], [36.0, 24.0, 30.0]);
    let jaw_curve = plane_length(p.x / 34.0, (p.y + 4.0) / 46.0);
    let jaw = (5.0 - (jaw_curve - 1.0).abs() * 38.0)
        .min(9.0 - (p.z + 50.0).abs())
        .min(4.0 - p.y);
    let teeth = (4.0 - (jaw_curve - 1.0).abs() * 38.0)
        .min(7.0 - (p.z + 36.0).abs())
        .min(-18.0 - p.y)
        .min(1.6 - ((p.x / 5.5).remainder(1.0) - 0.5).abs() * 0.6);
    let vertebra = (p.z / 16.0).remainder(1.0) * 16.0 - 8.0;
    let spine = disc(
        Point::new(p.x, p.y, vertebra),
        [0.0, 18.0, 0.0],
        [0.0, 0.0, 1.0],
        12.0,
        6.5,
    )
    .min(-38.0 - p.z);
    let orbit = ellipsoid(m, [21.0, -54.0, 4.0], [14.0, 18.0, 12.0]);
    let eye = sphere(m, [21.0, -56.0, 4.0], 10.5);
    let lens = sphere(m, [21.0, -64.5, 4.0], 3.2);
    let sinus = ellipsoid(m, [15.0, -38.0, -20.0], [8.0, 12.0, 12.0]).max(ellipsoid(
        m,
        [8.0, -57.0, 24.0],
        [7.0, 4.0, 7.0],
    ));
    let airway = capsule(p, [0.0, -60.0, -14.0], [0.0, -10.0, -16.0], 5.0).max(capsule(
        p,
        [0.0, -10.0, -16.0],
        [0.0, -6.0, -100.0],
        6.0,
    ));
    let ventricle = ellipsoid(m, [9.0, 2.0, 28.0], [5.0, 24.0, 8.0]);
    let folds = 6.0 * (p.times([0.22; 3]).noise() + 0.5 * p.times([0.45; 3]).noise());
    let cortex = brain - 2.5 - 2.0 * p.times([0.2; 3]).noise().abs();
    p.x.constant(-1000.0)
        .mix(40.0, cover(skin, voxel))
        .mix(-80.0, cover((skin - 2.0).min(4.0 - skin).min(p.z + 20.0), voxel))
        .mix(700.0, cover(face.min(skin - 5.0), voxel))
        .mix(1100.0, cover(skull.min(skin - 2.0), voxel))
        .mix(
            400.0,
            cover((skull - 2.0).min(-brain - 2.0).min(skin - 5.0), voxel),
        )
        .mix(1200.0, cover(jaw.min(skin - 3.0).max(spine), voxel))
        .mix(1900.0, cover(teeth, voxel))
        .mix(-90.0, cover(orbit.min(skin - 2.0), voxel))
        .mix(15.0, cover(eye, voxel))
        .mix(90.0, cover(lens, voxel))
        .mix(-1000.0, cover(sinus.max(airway), voxel))
        .mix(5.0, cover(brain, voxel))
        .mix(35.0 + folds, cover(cortex, voxel))
        .mix(5.0, cover(ventricle, voxel))
}
