//! Tears: where a map still displaces something visible at a face of its box. Beyond the face nothing
//! is displaced, hence what is visible there is torn ([`crate::model`], "Displacement maps").
//!
//! A kind's displacement does not vanish on every face (a bend moves the upper end of its box); such
//! a face should lie in empty space. Every face is tested at a grid of points, on both sides. In a map
//! wrapped around an axis the same holds for the seam and for the axis itself: there points of the
//! map meet that may come from different places.

use super::deformed::Deformed;
use super::stack_inputs::INSIDE;
use crate::deform::PlacedMap;
use crate::math::Bounds;
use glam::Vec3;
use serde::Serialize;

/// Points along an edge of a face.
const POINTS: usize = 17;
/// The places of a box, in the order -x, +x, -y, +y, -z, +z; and those of a cylinder.
const FACES: [&str; 6] = ["-x face", "+x face", "-y face", "+y face", "-z face", "+z face"];
const CYLINDER_FACES: [&str; 6] = ["seam", "", "lower end", "upper end", "axis", "outer face"];

/// Visible material that is torn at a face of a deformation's box.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Tear {
    /// The deformation, by its name or kind.
    pub deformation: String,
    /// The face, along the box's own axes.
    pub face: &'static str,
    /// How far the two sides are torn apart, at most, mm.
    pub amount_mm: f32,
    /// The width of a fade (`fade`) that mends it, mm; none where no fade reaches.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fade_mm: Option<f32>,
}

/// Notices for the user, one for every deformation that tears.
pub(super) fn notices(tears: &[Tear]) -> Vec<String> {
    let of_one = |tears: &[Tear]| {
        let faces: Vec<String> = tears
            .iter()
            .map(|tear| format!("{} (by up to {:.1} mm)", tear.face, tear.amount_mm))
            .collect();
        let fade_mm = tears.iter().filter_map(|tear| tear.fade_mm).reduce(f32::max);
        let fade = fade_mm.map_or(String::new(), |mm| {
            format!(", or set fade = {mm} to reduce the displacement to zero at the faces")
        });
        format!(
            "{}: visible material is torn at the {} of its box; enlarge or move the box so that nothing is visible there{fade}",
            tears[0].deformation,
            faces.join(" and "),
        )
    };
    tears
        .chunk_by(|a, b| a.deformation == b.deformation)
        .map(of_one)
        .collect()
}

/// The tears of a deformation. `is_visible_source` states whether a point of the undeformed scene
/// shows anything, `can_fade` whether a deformation has the setting `fade`; displacements up to
/// `tolerance_mm` are too small to see.
pub(super) fn tears(
    deformed: &Deformed,
    scene_box: &Bounds,
    tolerance_mm: f32,
    is_visible_source: impl Fn(Vec3) -> bool,
    can_fade: impl Fn(&str) -> bool,
) -> Vec<Tear> {
    let maps = deformed.stack.maps();
    let scene = scene_box.grown(-2.0 * tolerance_mm);
    let mut found: Vec<Tear> = Vec::new();
    for (n, map) in maps.iter().enumerate() {
        // Outside the mesh that holds the volume nothing is seen.
        let moves = map.map.has_displacement() && deformed.names[n] != INSIDE;
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
        let is_visible = |p: Vec3| {
            let (source, alpha) = deformed.stack.source_before(n, p);
            alpha >= 0.5 && is_visible_source(source)
        };
        // Cuts remove points where they are shown: known unless later maps move them.
        let is_last = n + 1 == maps.len();
        let is_cut =
            |p: Vec3| is_last && !deformed.cuts.is_empty() && deformed.cuts.signed_distance_mm(p) < 0.0;
        let names = if map.cylinder.is_some() {
            CYLINDER_FACES
        } else {
            FACES
        };
        for (face, name) in names.into_iter().enumerate().filter(|(_, name)| !name.is_empty()) {
            let amount_mm = amount_on(map, face, tolerance_mm, &|at: &FacePoint| {
                // Where the scene itself ends, nothing is torn off.
                let is_within = at.point.cmpgt(scene.min).all() && at.point.cmplt(scene.max).all();
                let [outside, inside] = at.sources;
                !is_cut(at.point)
                    && (at.alphas[0] >= 0.5 && is_visible(outside)
                        || at.alphas[1] >= 0.5 && is_within && is_visible(inside))
            });
            if amount_mm > tolerance_mm {
                let deformation = deformed.names[n].clone();
                let widest = 0.5 * map.placement.size_mm().max_element();
                let fades = !["seam", "axis"].contains(&name) && can_fade(&deformation);
                found.push(Tear {
                    face: name,
                    amount_mm,
                    fade_mm: fades.then(|| amount_mm.ceil().max(1.0).min(widest)),
                    deformation,
                });
            }
        }
    }
    found
}

/// A point of a face, and where the two sides of it come from: outside and inside, before the map.
struct FacePoint {
    point: Vec3,
    sources: [Vec3; 2],
    /// The masks of the two sides.
    alphas: [f32; 2],
}

/// The largest distance, mm, between what the two sides of a face show, where it separates something
/// visible.
fn amount_on(map: &PlacedMap, face: usize, tolerance_mm: f32, separates: &dyn Fn(&FacePoint) -> bool) -> f32 {
    let axis = face / 2;
    let mut largest = 0.0f32;
    for n in 0..POINTS * POINTS {
        let [u, v] = [n % POINTS, n / POINTS].map(|i| i as f32 / (POINTS - 1) as f32);
        let mut x = Vec3::ZERO;
        x[axis] = (face % 2) as f32;
        (x[(axis + 1) % 3], x[(axis + 2) % 3]) = (u, v);
        let at = at_face(map, x, face);
        let amount_mm = at.sources[0].distance(at.sources[1]);
        if amount_mm > tolerance_mm.max(largest) && separates(&at) {
            largest = amount_mm;
        }
    }
    largest
}

/// The point of a face at map coordinates x.
fn at_face(map: &PlacedMap, x: Vec3, face: usize) -> FacePoint {
    let world = |cube: Vec3| map.placement.world_from_map.transform_point3(cube);
    let Some(cylinder) = &map.cylinder else {
        let (displacement_mm, alpha) = map.displacement_at(x);
        let point = world(x);
        return FacePoint {
            point,
            sources: [point, point + displacement_mm],
            alphas: [1.0, alpha],
        };
    };
    let point = world(cylinder.cube_from_map(x));
    let side = |u: Vec3| {
        let sample = map.map.sample_lazily(u);
        let displacement = cylinder.world_from_local * cylinder.displaced(u, sample.displacement);
        (point + displacement, sample.alpha)
    };
    let other = match face {
        // Both ends of the map meet at the seam, and opposite angles at the axis.
        0 => side(Vec3::new(1.0, x.y, x.z)),
        4 => side(Vec3::new((x.x + 0.5).fract(), x.y, 0.0)),
        _ => (point, 1.0),
    };
    let own = side(x);
    FacePoint {
        point,
        sources: [other.0, own.0],
        alphas: [other.1, own.1],
    }
}
