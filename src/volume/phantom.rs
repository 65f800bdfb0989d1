//! Procedural volumes: closed-form test bodies, the objects of \[DDM06\]'s figures, and a head in
//! Hounsfield units.
//!
//! Every phantom is a function of a point in millimetres, evaluated at the voxel centres of a grid
//! centred on the world's origin with its axes along L, P, S. Surfaces are smooth ramps of the
//! signed distance, two voxels wide, as in a scan. Materials that touch are neighbours on the value
//! scale, so that the ramp between them does not pass through a third one's values (hence the
//! tomato's air is 255 and the piggy bank's 128).

use super::{Rescale, StoredValues, Volume, Voxels};
use crate::{Error, Result, error::suggestion};
use glam::{DAffine3, DMat3, Quat, Vec2, Vec3, Vec3Swizzles};
use rayon::prelude::*;

/// The definition of a phantom.
struct Phantom {
    name: &'static str,
    about: &'static str,
    /// Edge of the default grid, voxels.
    size: usize,
    /// Name of the matching transfer function preset.
    preset: &'static str,
    kind: PhantomKind,
}

enum PhantomKind {
    Bytes(fn(Vec3, f32) -> f32),
    Hounsfield(fn(Vec3, f32) -> f32),
    Float(fn(Vec3, f32) -> f32),
    Labels(fn(Vec3) -> u8),
}

/// Edge of the cube that a phantom fills, mm.
const EXTENT_MM: f32 = 160.0;

const PHANTOMS: &[Phantom] = &[
    Phantom {
        name: "ball",
        about: "a uniform ball of radius 60 mm",
        size: 128,
        preset: "phantom-solid",
        kind: PhantomKind::Float(ball),
    },
    Phantom {
        name: "shell",
        about: "a hollow ball, radius 60 mm, wall 8 mm",
        size: 128,
        preset: "phantom-solid",
        kind: PhantomKind::Float(shell),
    },
    Phantom {
        name: "checker",
        about: "16 mm checkerboard with two values, filling the volume",
        size: 128,
        preset: "checker",
        kind: PhantomKind::Bytes(checker),
    },
    Phantom {
        name: "piggy-bank",
        about: "a thick-walled piggy bank with coins inside",
        size: 192,
        preset: "piggy-bank",
        kind: PhantomKind::Bytes(piggy_bank),
    },
    Phantom {
        name: "tomato",
        about: "a tomato: skin, flesh, seeds in chambers",
        size: 192,
        preset: "tomato",
        kind: PhantomKind::Bytes(tomato),
    },
    Phantom {
        name: "teddy",
        about: "a teddy bear: cloth, stuffing, a seam",
        size: 192,
        preset: "teddy",
        kind: PhantomKind::Bytes(teddy),
    },
    Phantom {
        name: "octants",
        about: "a ball of radius 60 mm in eight labels, one per octant",
        size: 128,
        preset: "octants",
        kind: PhantomKind::Labels(octants),
    },
    Phantom {
        name: "head-ct",
        about: "a head in Hounsfield units: skin, skull, brain, air",
        size: 192,
        preset: "ct-bone",
        kind: PhantomKind::Hounsfield(head_ct),
    },
];

/// Names and descriptions of all phantoms.
pub fn list() -> impl Iterator<Item = (&'static str, &'static str)> {
    PHANTOMS.iter().map(|p| (p.name, p.about))
}

fn find(name: &str) -> Result<&'static Phantom> {
    PHANTOMS.iter().find(|p| p.name == name).ok_or_else(|| {
        Error::value(
            format!("phantom:{name}"),
            format!(
                "there is no such phantom; {}",
                suggestion(name, PHANTOMS.iter().map(|p| p.name))
            ),
        )
    })
}

/// The preset that suits a phantom best, for `NAME[:...]`.
pub fn preset(spec: &str) -> Option<&'static str> {
    find(spec.split(':').next()?).ok().map(|p| p.preset)
}

/// The phantom given by `NAME[:size=N][:spacing=AxBxC]`: N voxels along each edge of a 160 mm cube,
/// or as many as result from the spacing in millimetres.
///
/// # Errors
/// An unknown name or option, a size outside 2 to 1024, or a spacing that results in fewer than 2
/// or more than 1024 voxels.
pub fn from_spec(spec: &str) -> Result<Volume> {
    let mut parts = spec.split(':');
    let phantom = find(parts.next().unwrap_or_default())?;
    let mut size = [phantom.size; 3];
    let mut spacing = Vec3::splat(EXTENT_MM / phantom.size as f32);
    for option in parts {
        let bad = |problem: &str| Error::value(format!("phantom:{spec}"), format!("{option}: {problem}"));
        match option.split_once('=') {
            Some(("size", n)) => {
                let n: usize = n.parse().map_err(|_| bad("the size is a number of voxels"))?;
                size = [n; 3];
                spacing = Vec3::splat(EXTENT_MM / n as f32);
            }
            Some(("spacing", s)) => {
                let parts: Vec<f32> = s
                    .split('x')
                    .map_while(|v| v.parse().ok())
                    .filter(|v: &f32| v.is_finite() && *v > 0.0)
                    .collect();
                let [x, y, z] = parts[..] else {
                    return Err(bad("the spacing is three lengths in mm, e.g. spacing=1x1x5"));
                };
                spacing = Vec3::new(x, y, z);
                size = [x, y, z].map(|s| (EXTENT_MM / s).round() as usize);
            }
            _ => return Err(bad("known options are size=N and spacing=AxBxC")),
        }
        if size.iter().any(|n| !(2..=1024).contains(n)) {
            return Err(bad("that makes a grid outside 2 to 1024 voxels along an axis"));
        }
    }
    generate(phantom.name, size, spacing)
}

/// A phantom sampled on a grid of any size and spacing (mm), centred on the origin.
///
/// # Errors
/// An unknown name.
pub fn generate(name: &str, size: [usize; 3], spacing_mm: Vec3) -> Result<Volume> {
    let phantom = find(name)?;
    let origin = -0.5 * spacing_mm * (Vec3::from(size.map(|n| n as f32)) - 1.0);
    let voxel = spacing_mm.min_element();
    let sample = |f: fn(Vec3, f32) -> f32| -> Vec<f32> {
        (0..size[1] * size[2])
            .into_par_iter()
            .flat_map_iter(|row| {
                (0..size[0]).map(move |i| {
                    f(
                        origin
                            + spacing_mm
                                * Vec3::new(i as f32, (row % size[1]) as f32, (row / size[1]) as f32),
                        voxel,
                    )
                })
            })
            .collect()
    };
    let values: StoredValues = match phantom.kind {
        PhantomKind::Float(f) => sample(f).into(),
        PhantomKind::Bytes(f) => sample(f)
            .into_iter()
            .map(|v| v.round().clamp(0.0, 255.0) as u8)
            .collect::<Vec<_>>()
            .into(),
        PhantomKind::Hounsfield(f) => sample(f)
            .into_iter()
            .map(|v| v.round() as i16)
            .collect::<Vec<_>>()
            .into(),
        PhantomKind::Labels(f) => {
            let at = |n: usize| {
                Vec3::new(
                    (n % size[0]) as f32,
                    (n / size[0] % size[1]) as f32,
                    (n / (size[0] * size[1])) as f32,
                )
            };
            (0..size.iter().product::<usize>())
                .map(|n| f(origin + spacing_mm * at(n)))
                .collect::<Vec<_>>()
                .into()
        }
    };
    let world_from_voxel = DAffine3 {
        matrix3: DMat3::from_diagonal(spacing_mm.as_dvec3()),
        translation: origin.as_dvec3(),
    };
    let mut volume = Volume::new(Voxels::new(size, values), Rescale::NONE, world_from_voxel);
    volume.declared_labels = matches!(phantom.kind, PhantomKind::Labels(_));
    Ok(volume)
}

fn octants(p: Vec3) -> u8 {
    if p.length() > 60.0 {
        0
    } else {
        1 + u8::from(p.x > 0.0) + 2 * u8::from(p.y > 0.0) + 4 * u8::from(p.z > 0.0)
    }
}

/// Coverage at signed distance `d` (positive inside): a smooth ramp two voxels wide, similar to the
/// edge response of a scanner, and wide enough for gradients to point straight outwards.
fn cover(d: f32, voxel: f32) -> f32 {
    crate::math::smoothstep(-voxel, voxel, d)
}

/// Blends a material over the existing value.
fn paint(value: &mut f32, material: f32, share: f32) {
    *value += (material - *value) * share;
}

// Signed distances, positive inside, mm.

fn sphere(p: Vec3, center: Vec3, radius: f32) -> f32 {
    radius - p.distance(center)
}

/// First-order distance of an ellipsoid: exact on the surface.
fn ellipsoid(p: Vec3, center: Vec3, radii: Vec3) -> f32 {
    let q = (p - center) / radii;
    let k0 = q.length();
    let k1 = (q / radii).length();
    if k1 < 1e-9 {
        radii.min_element()
    } else {
        k0 * (1.0 - k0) / k1
    }
}

fn capsule(p: Vec3, a: Vec3, b: Vec3, radius: f32) -> f32 {
    let (pa, ba) = (p - a, b - a);
    let t = (pa.dot(ba) / ba.length_squared()).clamp(0.0, 1.0);
    radius - (pa - ba * t).length()
}

/// A coin or a button: a flat cylinder with its axis along `axis`.
fn disc(p: Vec3, center: Vec3, axis: Vec3, radius: f32, half_height: f32) -> f32 {
    let q = p - center;
    let along = q.dot(axis);
    let d = Vec2::new((q - axis * along).length() - radius, along.abs() - half_height);
    -(d.max_element().min(0.0) + d.max(Vec2::ZERO).length())
}

fn cuboid(p: Vec3, center: Vec3, half: Vec3) -> f32 {
    let d = (p - center).abs() - half;
    -(d.max_element().min(0.0) + d.max(Vec3::ZERO).length())
}

/// Smooth value noise in [-1, 1].
fn noise(p: Vec3) -> f32 {
    let cell = p.floor();
    let f = p - cell;
    let f = f * f * (3.0 - 2.0 * f);
    let hash = |x: i32, y: i32, z: i32| {
        let mut h = (x as u32).wrapping_mul(0x8da6_b343)
            ^ (y as u32).wrapping_mul(0xd816_3841)
            ^ (z as u32).wrapping_mul(0xcb1a_b31f);
        h = (h ^ (h >> 13)).wrapping_mul(0x5bd1_e995);
        ((h ^ (h >> 15)) & 0xffff) as f32 / 32767.5 - 1.0
    };
    let (x, y, z) = (cell.x as i32, cell.y as i32, cell.z as i32);
    let edge = |dy: i32, dz: i32| {
        let a = hash(x, y + dy, z + dz);
        a + (hash(x + 1, y + dy, z + dz) - a) * f.x
    };
    let (a, b) = (
        edge(0, 0) + (edge(1, 0) - edge(0, 0)) * f.y,
        edge(0, 1) + (edge(1, 1) - edge(0, 1)) * f.y,
    );
    a + (b - a) * f.z
}

/// Radius of `ball` and outer radius of `shell`, mm.
pub const BALL_RADIUS_MM: f32 = 60.0;

fn ball(p: Vec3, voxel: f32) -> f32 {
    cover(BALL_RADIUS_MM - p.length(), voxel)
}

fn shell(p: Vec3, voxel: f32) -> f32 {
    cover((4.0 - (p.length() - BALL_RADIUS_MM + 4.0).abs()).min(8.0), voxel)
}

fn checker(p: Vec3, voxel: f32) -> f32 {
    // The product of three square waves, each with a smooth edge; the cube of checks fills the
    // whole grid.
    let wave = |x: f32| {
        let phase = (x / 16.0).rem_euclid(2.0);
        let to_edge = 16.0
            * if phase < 1.0 {
                phase.min(1.0 - phase)
            } else {
                -(phase - 1.0).min(2.0 - phase)
            };
        2.0 * cover(to_edge, voxel) - 1.0
    };
    150.0 + 70.0 * wave(p.x) * wave(p.y) * wave(p.z)
}

fn piggy_bank(p: Vec3, voxel: f32) -> f32 {
    const AIR: f32 = 128.0;
    const CERAMIC: f32 = 255.0;
    const COIN: f32 = 0.0;
    // The snout faces anterior (-y), the back is up (+z).
    let mirrored = Vec3::new(p.x.abs(), p.y, p.z);
    let body = ellipsoid(p, Vec3::ZERO, Vec3::new(46.0, 62.0, 46.0));
    let hollow = ellipsoid(p, Vec3::ZERO, Vec3::new(39.0, 55.0, 39.0));
    let snout = disc(p, Vec3::new(0.0, -62.0, -2.0), Vec3::Y, 14.0, 10.0);
    let nostril = capsule(
        mirrored,
        Vec3::new(5.0, -80.0, -2.0),
        Vec3::new(5.0, -68.0, -2.0),
        2.6,
    );
    let leg = |y: f32| {
        capsule(
            mirrored,
            Vec3::new(23.0, y, -28.0),
            Vec3::new(25.0, y, -58.0),
            11.0,
        )
    };
    let floor = p.z + 62.0;
    let ear = ellipsoid(mirrored, Vec3::new(24.0, -36.0, 38.0), Vec3::new(10.0, 5.0, 15.0));
    let eye = sphere(mirrored, Vec3::new(16.0, -54.0, 16.0), 4.0);
    let q = p - Vec3::new(0.0, 64.0, 14.0);
    let tail = 3.0 - Vec2::new(q.yz().length() - 9.0, q.x).length();
    if body < -70.0 {
        return AIR;
    }
    let solid = body
        .max(snout.min(6.0))
        .max(leg(-26.0).max(leg(28.0)).min(floor))
        .max(ear)
        .max(eye)
        .max(tail);
    let slot = cuboid(p, Vec3::new(0.0, 2.0, 46.0), Vec3::new(2.5, 18.0, 14.0));
    let mut value = AIR;
    paint(
        &mut value,
        CERAMIC,
        cover(solid.min(-hollow).min(-slot).min(-nostril), voxel),
    );
    if hollow < 0.0 {
        return value;
    }
    for n in 0..26u32 {
        // A heap of coins: golden-angle spiral, layer by layer, tilted in different directions.
        let layer = n / 9;
        let turn = n as f32 * 2.399_963;
        let reach = [25.0, 18.0, 11.0][layer as usize % 3] * ((n % 9) as f32 / 8.0).sqrt();
        let center = Vec3::new(
            reach * turn.cos(),
            1.3 * reach * turn.sin(),
            -27.0 + 9.5 * layer as f32 + 0.25 * reach,
        );
        let axis = Quat::from_rotation_z(turn) * Quat::from_rotation_x(0.25 + 0.3 * (n % 4) as f32) * Vec3::Z;
        let coin = disc(p, center, axis, 9.5, 1.6).min(hollow - 1.2 * voxel);
        paint(&mut value, COIN, cover(coin, voxel));
    }
    value
}

fn tomato(p: Vec3, voxel: f32) -> f32 {
    const AIR: f32 = 255.0;
    const SKIN: f32 = 205.0;
    const FLESH: f32 = 150.0;
    const SEED: f32 = 95.0;
    const GEL: f32 = 50.0;
    let radial = p.xy().length();
    let angle = p.y.atan2(p.x);
    // Five lobes; the stem's dimple on top.
    let lobes = 1.0 + 0.035 * (5.0 * angle).cos() * (radial / 60.0).min(1.0);
    let dimple = 9.0 * (-(radial / 15.0).powi(2)).exp() * (if p.z > 0.0 { 1.0 } else { 0.45 });
    let outer = ellipsoid(p, Vec3::ZERO, Vec3::new(64.0 * lobes, 64.0 * lobes, 54.0)) - dimple;
    let mut value = AIR;
    paint(&mut value, SKIN, cover(outer, voxel));
    paint(&mut value, FLESH, cover(outer - 2.2, voxel));
    // Five chambers between the core and the wall, walls between them.
    let sector = (angle / std::f32::consts::TAU * 5.0).rem_euclid(1.0) - 0.5;
    let to_septum = (0.5 - sector.abs()) * std::f32::consts::TAU / 5.0 * radial - 3.5;
    let chamber = (outer - 11.0).min(radial - 15.0).min(to_septum);
    paint(&mut value, GEL, cover(chamber, voxel));
    let middle = (angle / std::f32::consts::TAU * 5.0).floor();
    for n in 0..16 {
        let (row, column) = ((n / 4) as f32, (n % 4) as f32);
        let z = -24.0 + 16.0 * row + 3.0 * ((n * 7 % 5) as f32 / 5.0);
        let bend = (1.0 - (z / 50.0).powi(2)).max(0.1).sqrt();
        let a = (middle + 0.5 + (column - 1.5) * 0.19) * std::f32::consts::TAU / 5.0;
        let r = (24.0 + 13.0 * ((n * 5 % 4) as f32 / 3.0)) * bend;
        let seed = ellipsoid(
            p,
            Vec3::new(r * a.cos(), r * a.sin(), z),
            Vec3::new(3.4, 3.4, 4.6),
        )
        .min(chamber - 1.0);
        paint(&mut value, SEED, cover(seed, voxel));
    }
    value
}

fn teddy(p: Vec3, voxel: f32) -> f32 {
    const CLOTH: f32 = 95.0;
    const STUFFING: f32 = 185.0;
    const BUTTON: f32 = 44.0;
    const THREAD: f32 = 30.0;
    // The bear faces anterior (-y) and sits upright (+z).
    let m = Vec3::new(p.x.abs(), p.y, p.z);
    let limb = |a: Vec3, b: Vec3, r: f32| capsule(m, a, b, r);
    let body = ellipsoid(p, Vec3::new(0.0, 0.0, -22.0), Vec3::new(37.0, 31.0, 42.0));
    let head = ellipsoid(p, Vec3::new(0.0, -4.0, 40.0), Vec3::new(33.0, 29.0, 29.0));
    let muzzle = ellipsoid(p, Vec3::new(0.0, -31.0, 33.0), Vec3::new(14.0, 11.0, 11.0));
    let ear = ellipsoid(m, Vec3::new(26.0, 0.0, 64.0), Vec3::new(12.0, 6.0, 12.0));
    let arm = limb(Vec3::new(32.0, -6.0, 2.0), Vec3::new(58.0, -18.0, -20.0), 11.5);
    let leg = limb(Vec3::new(22.0, -10.0, -52.0), Vec3::new(36.0, -46.0, -60.0), 14.0);
    let solid = body.max(head).max(muzzle).max(ear).max(arm).max(leg);
    let fuzz = 0.5 * noise(p * 0.9);
    let mut value = 0.0;
    paint(&mut value, CLOTH, cover(solid + fuzz, voxel));
    // The seam: a shallow groove down the belly, with stitches across it.
    let on_belly = body.clamp(-4.0, 4.0);
    let groove = (1.4 - p.x.abs())
        .min(2.2 - on_belly.abs())
        .min(if p.y < 0.0 && p.z < 12.0 && p.z > -58.0 {
            2.0
        } else {
            -2.0
        });
    paint(&mut value, THREAD, cover(groove, voxel));
    let stitch_z = (p.z / 7.0).round() * 7.0;
    let stitch = (0.9 - (p.z - stitch_z).abs())
        .min(4.5 - p.x.abs())
        .min(1.6 - (body + 0.4).abs())
        .min(if p.y < 0.0 && stitch_z.abs() < 52.0 {
            1.0
        } else {
            -1.0
        });
    paint(&mut value, THREAD + 25.0, cover(stitch, voxel));
    if solid < -8.0 {
        return value;
    }
    let strands = noise(Vec3::new(p.x * 0.35, p.y * 0.35, p.z * 0.12)) + 0.6 * noise(p * 0.5);
    paint(&mut value, STUFFING + 30.0 * strands, cover(solid - 3.2, voxel));
    let eye = sphere(m, Vec3::new(12.0, -29.0, 48.0), 4.2);
    let nose = ellipsoid(p, Vec3::new(0.0, -41.0, 37.0), Vec3::new(5.5, 3.5, 4.0));
    paint(&mut value, BUTTON, cover(eye.max(nose), voxel));
    value
}

fn head_ct(p: Vec3, voxel: f32) -> f32 {
    // Hounsfield units of air, skin and muscle, bone, marrow, brain, fluid, lens.
    let m = Vec3::new(p.x.abs(), p.y, p.z);
    let cranium = Vec3::new(0.0, 6.0, 22.0);
    let skin = ellipsoid(p, cranium, Vec3::new(58.0, 70.0, 55.0))
        .max(ellipsoid(
            p,
            Vec3::new(0.0, -16.0, -14.0),
            Vec3::new(48.0, 46.0, 58.0),
        ))
        .max(ellipsoid(
            p,
            Vec3::new(0.0, -66.0, -4.0),
            Vec3::new(8.0, 10.0, 16.0),
        ))
        .max(ellipsoid(
            m,
            Vec3::new(58.0, 8.0, -4.0),
            Vec3::new(6.0, 11.0, 17.0),
        ))
        .max(capsule(
            p,
            Vec3::new(0.0, 14.0, -40.0),
            Vec3::new(0.0, 16.0, -100.0),
            36.0,
        ));
    let skull = ellipsoid(p, cranium, Vec3::new(52.0, 64.0, 49.0));
    let brain = ellipsoid(p, cranium, Vec3::new(46.0, 58.0, 43.0));
    let face = ellipsoid(p, Vec3::new(0.0, -34.0, -18.0), Vec3::new(36.0, 24.0, 30.0));
    let jaw_curve = Vec2::new(p.x / 34.0, (p.y + 4.0) / 46.0).length();
    let jaw = (5.0 - (jaw_curve - 1.0).abs() * 38.0)
        .min(9.0 - (p.z + 50.0).abs())
        .min(4.0 - p.y);
    let teeth = (4.0 - (jaw_curve - 1.0).abs() * 38.0)
        .min(7.0 - (p.z + 36.0).abs())
        .min(-18.0 - p.y)
        .min(1.6 - ((p.x / 5.5).rem_euclid(1.0) - 0.5).abs() * 0.6);
    let vertebra = (p.z / 16.0).rem_euclid(1.0) * 16.0 - 8.0;
    let spine = disc(
        Vec3::new(p.x, p.y, vertebra),
        Vec3::new(0.0, 18.0, 0.0),
        Vec3::Z,
        12.0,
        6.5,
    )
    .min(-38.0 - p.z);
    let orbit = ellipsoid(m, Vec3::new(21.0, -54.0, 4.0), Vec3::new(14.0, 18.0, 12.0));
    let eye = sphere(m, Vec3::new(21.0, -56.0, 4.0), 10.5);
    let lens = sphere(m, Vec3::new(21.0, -64.5, 4.0), 3.2);
    let sinus = ellipsoid(m, Vec3::new(15.0, -38.0, -20.0), Vec3::new(8.0, 12.0, 12.0)).max(ellipsoid(
        m,
        Vec3::new(8.0, -57.0, 24.0),
        Vec3::new(7.0, 4.0, 7.0),
    ));
    let airway = capsule(p, Vec3::new(0.0, -60.0, -14.0), Vec3::new(0.0, -10.0, -16.0), 5.0).max(capsule(
        p,
        Vec3::new(0.0, -10.0, -16.0),
        Vec3::new(0.0, -6.0, -100.0),
        6.0,
    ));
    let ventricle = ellipsoid(m, Vec3::new(9.0, 2.0, 28.0), Vec3::new(5.0, 24.0, 8.0));
    let mut value = -1000.0;
    paint(&mut value, 40.0, cover(skin, voxel));
    paint(
        &mut value,
        -80.0,
        cover((skin - 2.0).min(4.0 - skin).min(p.z + 20.0), voxel),
    );
    paint(&mut value, 700.0, cover(face.min(skin - 5.0), voxel));
    paint(&mut value, 1100.0, cover(skull.min(skin - 2.0), voxel));
    paint(
        &mut value,
        400.0,
        cover((skull - 2.0).min(-brain - 2.0).min(skin - 5.0), voxel),
    );
    paint(&mut value, 1200.0, cover(jaw.min(skin - 3.0).max(spine), voxel));
    paint(&mut value, 1900.0, cover(teeth, voxel));
    paint(&mut value, -90.0, cover(orbit.min(skin - 2.0), voxel));
    paint(&mut value, 15.0, cover(eye, voxel));
    paint(&mut value, 90.0, cover(lens, voxel));
    paint(&mut value, -1000.0, cover(sinus.max(airway), voxel));
    let folds = 6.0 * (noise(p * 0.22) + 0.5 * noise(p * 0.45));
    paint(&mut value, 5.0, cover(brain, voxel));
    paint(
        &mut value,
        35.0 + folds,
        cover(brain - 2.5 - 2.0 * (noise(p * 0.2)).abs(), voxel),
    );
    paint(&mut value, 5.0, cover(ventricle, voxel));
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_phantom_has_content_at_any_size() {
        for p in PHANTOMS {
            let v =
                generate(p.name, [24, 20, 28], Vec3::new(6.0, 8.0, 5.5)).unwrap_or_else(|e| panic!("{e}"));
            assert!(
                v.range[1] > v.range[0] && v.non_finite == 0,
                "{} {:?}",
                p.name,
                v.range
            );
        }
    }

    #[test]
    fn ball_has_the_volume_of_a_ball() {
        let v = generate("ball", [80; 3], Vec3::splat(2.0)).unwrap_or_else(|e| panic!("{e}"));
        let sum: f64 = (0..v.voxels.len()).map(|n| v.voxels.get(n)).sum::<f64>() * 8.0;
        let want = 4.0 / 3.0 * std::f64::consts::PI * f64::from(BALL_RADIUS_MM).powi(3);
        assert!((sum / want - 1.0).abs() < 1e-3, "{sum} for {want}");
    }

    #[test]
    fn specifications_are_checked() {
        assert!(from_spec("ball:size=16").is_ok());
        for bad in [
            "bal",
            "ball:size=0",
            "ball:size=x",
            "ball:size=5000",
            "ball:spacing=1x1",
            "ball:spacing=1x1x0",
            "ball:colour=3",
        ] {
            assert!(from_spec(bad).is_err(), "{bad}");
        }
        assert!(from_spec("pigy-bank").is_err_and(|e| e.to_string().contains("piggy-bank")));
    }
}
