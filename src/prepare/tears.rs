//! Tears: where a map still displaces matter on a face of its box. Beyond the face nothing is
//! displaced, hence what is visible there is torn ([`crate::model`], "Displacement maps").
//!
//! A kind's displacement does not vanish on every face (a bend moves the upper end of its box); such
//! a face belongs into empty space. Every face is tested at a grid of points, on both sides.

use super::deformed::Deformed;
use crate::deform::PlacedMap;
use crate::math::Bounds;
use glam::Vec3;
use serde::Serialize;

/// Points along an edge of a face.
const POINTS: usize = 17;
/// The faces of a box, in the order -x, +x, -y, +y, -z, +z; and those of a cylinder.
const FACES: [&str; 6] = ["-x face", "+x face", "-y face", "+y face", "-z face", "+z face"];
const CYLINDER_FACES: [&str; 6] = ["seam", "", "lower end", "upper end", "", "outer face"];

/// Visible matter that is torn at a face of a deformation's box.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Tear {
    /// The deformation, by its name or kind.
    pub deformation: String,
    /// The face, along the box's own axes.
    pub face: &'static str,
    /// How far the two sides are torn apart, at most, mm.
    pub amount_mm: f32,
}

/// Notices for the user, one for every deformation that tears.
pub(super) fn notices(tears: &[Tear]) -> Vec<String> {
    let of_one = |tears: &[Tear]| {
        let faces: Vec<String> = tears
            .iter()
            .map(|tear| format!("{} ({:.1} mm)", tear.face, tear.amount_mm))
            .collect();
        let widest = tears.iter().map(|tear| tear.amount_mm).fold(1.0, f32::max);
        format!(
            "{}: tears what it moves at the {} of its box; enlarge the box, move these faces into empty space, or fade the deformation towards them (fade = {:.0})",
            tears[0].deformation,
            faces.join(", "),
            widest.ceil()
        )
    };
    tears
        .chunk_by(|a, b| a.deformation == b.deformation)
        .map(of_one)
        .collect()
}

/// The tears of a deformation. `is_matter` tells whether a point of the undeformed scene shows
/// anything; displacements up to `tolerance_mm` are not seen.
pub(super) fn tears(
    deformed: &Deformed,
    scene_box: &Bounds,
    tolerance_mm: f32,
    is_matter: impl Fn(Vec3) -> bool,
) -> Vec<Tear> {
    let maps = deformed.stack.maps();
    let scene = scene_box.grown(-2.0 * tolerance_mm);
    let mut found: Vec<Tear> = Vec::new();
    for (n, map) in maps.iter().enumerate() {
        let moves = map.map.has_displacement();
        if !moves
            || deformed
                .stack
                .deformed_bounds(scene_box)
                .intersection(&map.bounds_in_world())
                .is_empty()
        {
            continue;
        }
        // A group of added maps moves points together; its members are tested one by one.
        let source = |p: Vec3| deformed.stack.source_before(n, p);
        let names = if map.cylinder.is_some() {
            CYLINDER_FACES
        } else {
            FACES
        };
        for (face, name) in names.into_iter().enumerate().filter(|(_, name)| !name.is_empty()) {
            let amount_mm = amount_on(map, face, tolerance_mm, &|outside, inside| {
                // Where the scene itself ends, nothing is torn off.
                let is_within = outside.cmpgt(scene.min).all() && outside.cmplt(scene.max).all();
                is_matter(source(outside)) || is_within && is_matter(source(inside))
            });
            if amount_mm > tolerance_mm {
                found.push(Tear {
                    deformation: deformed.names[n].clone(),
                    face: name,
                    amount_mm,
                });
            }
        }
    }
    found
}

/// The largest displacement on a face, mm, where it separates matter; `separates` takes the points
/// that appear outside and inside of the face.
fn amount_on(map: &PlacedMap, face: usize, tolerance_mm: f32, separates: &dyn Fn(Vec3, Vec3) -> bool) -> f32 {
    let axis = face / 2;
    let mut largest = 0.0f32;
    for n in 0..POINTS * POINTS {
        let [u, v] = [n % POINTS, n / POINTS].map(|i| i as f32 / (POINTS - 1) as f32);
        let mut x = Vec3::ZERO;
        x[axis] = (face % 2) as f32;
        (x[(axis + 1) % 3], x[(axis + 2) % 3]) = (u, v);
        let (p, displacement_mm, alpha) = at_face(map, x, face == 0);
        let amount_mm = displacement_mm.length();
        if alpha < 0.5 || amount_mm <= tolerance_mm.max(largest) {
            continue;
        }
        if separates(p, p + displacement_mm) {
            largest = amount_mm;
        }
    }
    largest
}

/// A point of a face, how far the matter on its two sides is torn apart, mm, and the mask there.
fn at_face(map: &PlacedMap, x: Vec3, is_seam: bool) -> (Vec3, Vec3, f32) {
    let world = |cube: Vec3| map.placement.world_from_map.transform_point3(cube);
    let Some(cylinder) = &map.cylinder else {
        let (displacement_mm, alpha) = map.displacement_at(x);
        return (world(x), displacement_mm, alpha);
    };
    let sample = map.map.sample_lazily(x);
    let mut displacement_mm = cylinder.displaced(x, sample.displacement);
    if is_seam {
        // The seam, where both ends of the map meet.
        let other = map.map.sample_lazily(Vec3::new(1.0, x.y, x.z));
        displacement_mm = cylinder.displaced(x, other.displacement) - displacement_mm;
    }
    let linear = cylinder.world_from_local;
    (
        world(cylinder.cube_from_map(x)),
        linear * displacement_mm,
        sample.alpha,
    )
}
