//! Control points of deformations: their positions, and how a drag moves them.

use super::placement::BoxPlacement;
use crate::deform::Argument;
use crate::gui::state::tool::tidy;
use crate::scene::Deformation;
use glam::Vec3;

/// Most control points of a lattice that are shown.
const MAX_POINTS: usize = 216;

/// Positions of the draggable control points, mm.
pub fn control_points(d: &Deformation, place: &BoxPlacement) -> Vec<Vec3> {
    let numbers = |name: &str| d.parameters.numbers(name).ok().flatten().unwrap_or_default();
    match d.kind.as_str() {
        "points" => numbers("pairs")
            .chunks_exact(6)
            .map(|p| Vec3::new(p[3], p[4], p[5]))
            .collect(),
        "elastic" => numbers("grab")
            .chunks_exact(7)
            .map(|g| Vec3::new(g[0] + g[4], g[1] + g[5], g[2] + g[6]))
            .collect(),
        "lattice" => {
            let counts = lattice_size(d);
            let moved = numbers("offsets");
            let count: usize = counts.iter().product();
            if count > MAX_POINTS {
                return Vec::new();
            }
            (0..count)
                .map(|n| {
                    let index = lattice_index(counts, n);
                    let at = Vec3::from(std::array::from_fn(|a| {
                        index[a] as f32 / (counts[a] - 1).max(1) as f32 - 0.5
                    }));
                    let row = moved
                        .chunks_exact(6)
                        .find(|r| (0..3).all(|a| r[a] == index[a] as f32));
                    let offset = row.map_or(Vec3::ZERO, |r| Vec3::new(r[3], r[4], r[5]));
                    place.world(at * place.size + offset)
                })
                .collect()
        }
        _ => Vec::new(),
    }
}

fn lattice_size(d: &Deformation) -> [usize; 3] {
    let stated = d.parameters.whole("lattice").ok().flatten().unwrap_or_default();
    <[usize; 3]>::try_from(stated)
        .ok()
        .filter(|c| c.iter().all(|n| (2..=8).contains(n)))
        .unwrap_or([4; 3])
}

fn lattice_index(counts: [usize; 3], n: usize) -> [usize; 3] {
    [
        n % counts[0],
        n / counts[0] % counts[1],
        n / counts[0] / counts[1],
    ]
}

/// Position of a control point before any drag, mm.
pub(super) fn origin_of(d: &Deformation, n: usize) -> Option<Vec3> {
    let numbers = |name: &str| d.parameters.numbers(name).ok().flatten().unwrap_or_default();
    match d.kind.as_str() {
        "points" => numbers("pairs")
            .chunks_exact(6)
            .nth(n)
            .map(|p| Vec3::new(p[0], p[1], p[2])),
        "elastic" => numbers("grab")
            .chunks_exact(7)
            .nth(n)
            .map(|g| Vec3::new(g[0], g[1], g[2])),
        _ => None,
    }
}

/// Moves a control point.
pub fn set_point(d: &mut Deformation, place: &BoxPlacement, n: usize, to: Vec3) {
    let numbers = |d: &Deformation, name: &str| d.parameters.numbers(name).ok().flatten().unwrap_or_default();
    match d.kind.as_str() {
        "points" => {
            let mut pairs = numbers(d, "pairs");
            if let Some(pair) = pairs.chunks_exact_mut(6).nth(n) {
                pair[3..].copy_from_slice(&tidy(to));
                d.parameters.insert("pairs", Argument::Numbers(pairs));
            }
        }
        "elastic" => {
            let mut grabs = numbers(d, "grab");
            if let Some(grab) = grabs.chunks_exact_mut(7).nth(n) {
                let moved = tidy(to - Vec3::new(grab[0], grab[1], grab[2]));
                grab[4..].copy_from_slice(&moved);
                d.parameters.insert("grab", Argument::Numbers(grabs));
            }
        }
        "lattice" => {
            let counts = lattice_size(d);
            let index = lattice_index(counts, n);
            let at = Vec3::from(std::array::from_fn(|a| {
                index[a] as f32 / (counts[a] - 1).max(1) as f32 - 0.5
            }));
            let offset = tidy(place.local(to) - at * place.size);
            let mut rows = numbers(d, "offsets");
            match rows
                .chunks_exact_mut(6)
                .find(|r| (0..3).all(|a| r[a] == index[a] as f32))
            {
                Some(row) => row[3..].copy_from_slice(&offset),
                None => {
                    rows.extend(index.map(|i| i as f32));
                    rows.extend(offset);
                }
            }
            d.parameters.insert("offsets", Argument::Numbers(rows));
        }
        _ => {}
    }
}
