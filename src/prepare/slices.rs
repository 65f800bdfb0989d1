//! Proxy geometry: the polygons in which view-aligned planes cut the box of the deformed scene
//! (\[DDM06\] section 4) or a closed mesh (\[RVD01\] section 2.4).
//!
//! *Method*: planes lie at depths (i + 1/2) Δ from the eye, hence they do not move when the box
//! changes. The section of a box is a convex polygon of three to six corners. For a slab of several
//! slices it is the outline of the part of the box between the slab's first and last slice, drawn
//! at their mean depth. The box is grown by a small part of a pixel and of a step: whether a sample
//! at the box's face belongs to the volume is then decided by the sample, never by how the polygon
//! happens to be rasterised.

use super::objects::SurfaceObject;
use super::{Frame, Macrocells, Prepared};
use crate::math::Bounds;
use crate::mesh::Mesh;
use crate::mesh::contour::{Planes, sections};
use crate::scene::{Mode, Projection, SliceOrder};
use crate::transfer::Blend;
use glam::{Vec2, Vec3};
use std::ops::Range;

/// Fractions of a pixel and of a step by which the box is grown.
const GROWTH: [f32; 2] = [0.02, 1e-3];

/// Slices composited together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Slab {
    /// Index of its nearest slice, which lies at depth (first + 1/2) Δ.
    pub first: i64,
    /// Its polygons, as a range of [`SlicePolygons::polygons`].
    pub polygons: Range<u32>,
}

/// The polygons of all slices that can show anything.
#[derive(Clone, Debug, Default)]
pub struct SlicePolygons {
    /// Corners, world mm.
    pub corners: Vec<Vec3>,
    /// Convex polygons, each a range of `corners`.
    pub polygons: Vec<Range<u32>>,
    /// Slabs, front to back.
    pub slabs: Vec<Slab>,
    /// Slices in a slab.
    pub slices_per_slab: u32,
}

impl SlicePolygons {
    /// The polygons of the slices of a proxy geometry that can show anything; slabs of `slab` slices
    /// start at multiples of it. A slab is omitted if none of its slices meets an occupied cell of
    /// the volume or the box of another object. `shift` is the largest distance by which samples are
    /// moved along their rays, in steps.
    pub fn of(frame: &Frame, proxy: &Proxy, slab: u32, shift: f32) -> Self {
        let mut all = Self {
            slices_per_slab: slab,
            ..Self::default()
        };
        let all_boxes = proxy
            .others
            .iter()
            .fold(frame.proxy, |all, other| all.union(other));
        if all_boxes.is_empty() {
            return all;
        }
        let box_of_slices = grown(frame, &all_boxes, shift);
        let corners = box_of_slices.corners();
        let (near, far) = depths(frame, &corners);
        let step = frame.spacing.step_mm;
        let first = (near / step - 0.5).ceil().max(0.0) as i64;
        let last = (far / step - 0.5).floor() as i64;
        let shown = shown_slices(frame, proxy, first);
        // Moved samples may belong to the cells of the neighbouring slices.
        let is_shown = |i: i64| shown.is_empty() || shown.get((i - first) as usize).copied().unwrap_or(true);
        let slab_slices = i64::from(slab);
        let slabs = (first.div_euclid(slab_slices)..=last.div_euclid(slab_slices)).filter_map(|n| {
            let start = n * slab_slices;
            let (low, high) = (start.max(first), (start + slab_slices - 1).min(last));
            ((low - 1).max(first)..=high + 1)
                .any(is_shown)
                .then_some((start, low, high))
        });
        let depth = |i: i64| (i as f32 + 0.5) * step;
        // A section of a mesh is that of one plane only, and it holds nothing but the volume; its mask
        // bounds slabs.
        if let Some(mesh) = proxy.mesh.filter(|_| slab == 1 && proxy.others.is_empty()) {
            let planes = Planes::across(frame.view.forward);
            let slabs: Vec<(i64, i64, i64)> = slabs.collect();
            let offsets: Vec<f32> = slabs
                .iter()
                .map(|(start, ..)| depth(*start) + frame.view.eye.dot(frame.view.forward))
                .collect();
            for ((start, ..), section) in slabs.iter().zip(sections(mesh, &planes, &offsets)) {
                all.push(*start, section);
            }
            return all;
        }
        for (start, low, high) in slabs {
            all.push(start, [outline(frame, &corners, [depth(low), depth(high)])]);
        }
        all
    }

    fn push<P: IntoIterator<Item = Vec3>>(&mut self, first: i64, polygons: impl IntoIterator<Item = P>) {
        let start = self.polygons.len() as u32;
        for polygon in polygons {
            let from = self.corners.len() as u32;
            self.corners.extend(polygon);
            let to = self.corners.len() as u32;
            if to - from >= 3 {
                self.polygons.push(from..to);
            } else {
                self.corners.truncate(from as usize);
            }
        }
        let end = self.polygons.len() as u32;
        if end > start {
            self.slabs.push(Slab {
                first,
                polygons: start..end,
            });
        }
    }
}

/// The geometry that slices are cut from, besides the box of the volume's occupied cells.
pub struct Proxy<'a> {
    /// The volume's empty space.
    pub cells: &'a Macrocells,
    /// The mesh that encloses the volume, if slices may be cut from it.
    pub mesh: Option<&'a Mesh>,
    /// The boxes of other objects, mm.
    pub others: Vec<Bounds>,
}

/// The box of what is visible, grown.
fn grown(frame: &Frame, proxy: &Bounds, shift: f32) -> Bounds {
    let view = &frame.view;
    let (_, far) = depths(frame, &proxy.corners());
    let pixel = (2.0 * view.right.length() / frame.size[0] as f32)
        .max(2.0 * view.up.length() / frame.size[1] as f32)
        * if view.projection == Projection::Perspective {
            far.max(0.0)
        } else {
            1.0
        };
    let step = frame.spacing.step_mm;
    proxy.grown(GROWTH[0] * pixel + GROWTH[1] * step + shift * step * view.longest_slant())
}

/// The least and the greatest depth of some points.
fn depths(frame: &Frame, points: &[Vec3]) -> (f32, f32) {
    let view = &frame.view;
    points
        .iter()
        .map(|p| (*p - view.eye).dot(view.forward))
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(near, far), d| {
            (near.min(d), far.max(d))
        })
}

/// The outline of the part of a box between two depths (of its section, if they are equal), as
/// seen from the eye: a convex polygon at the mean depth.
fn outline(frame: &Frame, corners: &[Vec3; 8], depths: [f32; 2]) -> Vec<Vec3> {
    let view = &frame.view;
    let depth = |p: Vec3| (p - view.eye).dot(view.forward);
    let mut points: Vec<Vec3> = corners
        .iter()
        .copied()
        .filter(|&c| (depths[0]..=depths[1]).contains(&depth(c)))
        .collect();
    for at in depths {
        points.extend(crossings(corners, &corners.map(|c| depth(c) - at)));
    }
    let (right, up) = (view.right.normalize_or_zero(), view.up.normalize_or_zero());
    let middle = (depths[0] + depths[1]) / 2.0;
    let scale = |p: Vec3| {
        if view.projection == Projection::Perspective && depths[0] < depths[1] {
            middle / depth(p).max(1e-6 * middle)
        } else {
            1.0
        }
    };
    let flat = points
        .iter()
        .map(|&p| Vec2::new((p - view.eye).dot(right), (p - view.eye).dot(up)) * scale(p))
        .collect();
    convex_hull(flat)
        .into_iter()
        .map(|p| view.eye + view.forward * middle + right * p.x + up * p.y)
        .collect()
}

/// Corners of the convex hull in order (Andrew's monotone chain).
fn convex_hull(mut points: Vec<Vec2>) -> Vec<Vec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let chain = |points: &mut dyn Iterator<Item = Vec2>| {
        let mut chain: Vec<Vec2> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..] {
                if (b - a).perp_dot(p - a) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}

/// For each slice from `first` on: whether any occupied cell or other object reaches it.
fn shown_slices(frame: &Frame, proxy: &Proxy, first: i64) -> Vec<bool> {
    let view = &frame.view;
    let cells = proxy.cells;
    let depth = |p: Vec3| (p - view.eye).dot(view.forward);
    let mut shown = Vec::new();
    let mut show = |low_mm: f32, high_mm: f32| {
        let step = frame.spacing.step_mm;
        let low = ((low_mm / step - 0.5).floor() as i64 - first).max(0) as usize;
        let high = ((high_mm / step - 0.5).ceil() as i64 - first).max(0) as usize;
        if shown.len() <= high {
            shown.resize(high + 1, false);
        }
        shown[low..=high].fill(true);
    };
    for other in proxy.others.iter().filter(|b| !b.is_empty()) {
        let (near, far) = depths(frame, &other.corners());
        show(near, far);
    }
    if frame.proxy.is_empty() {
        return shown;
    }
    let reach = cells.cell_mm.dot(view.forward.abs()) / 2.0;
    for index in (0..cells.distance.len()).filter(|n| cells.is_occupied(*n)) {
        let index = index as u32;
        let cell = Vec3::new(
            (index % cells.size.x) as f32,
            (index / cells.size.x % cells.size.y) as f32,
            (index / cells.size.x / cells.size.y) as f32,
        );
        let middle = depth(cells.origin + (cell + 0.5) * cells.cell_mm);
        show(middle - reach, middle + reach);
    }
    shown
}

/// Where the plane of signed distances `side` crosses the edges of the box of `corners`.
fn crossings(corners: &[Vec3; 8], side: &[f32; 8]) -> Vec<Vec3> {
    let mut points = Vec::with_capacity(6);
    for a in 0..8usize {
        for axis in 0..3 {
            let b = a | (1 << axis);
            if a == b || (side[a] < 0.0) == (side[b] < 0.0) {
                continue;
            }
            let t = side[a] / (side[a] - side[b]);
            points.push(corners[a] + (corners[b] - corners[a]) * t);
        }
    }
    points
}

impl Prepared<'_> {
    /// The surfaces that slices sample as objects beside the volume: those with a distance field. In
    /// other modes there are none; nor in front of a projection, which has no order.
    pub fn sliced_surfaces(&self) -> impl Iterator<Item = &SurfaceObject> {
        self.surfaces
            .objects
            .iter()
            .filter(|object| self.is_sliced(object))
    }

    /// Whether slices sample a surface.
    pub fn is_sliced(&self, object: &SurfaceObject) -> bool {
        self.settings.mode == Mode::Slice
            && self.volume().blend == Blend::Composite
            && object.implicit.is_some()
    }

    /// Whether there are surfaces that are drawn before the volume, as opaque pixels behind it.
    pub fn has_surfaces_behind(&self) -> bool {
        self.sliced_surfaces().count() < self.surfaces.objects.len()
    }

    /// Whether slices have anything to sample.
    pub fn has_slices(&self) -> bool {
        self.settings.mode == Mode::Slice
            && (self.shows_volume() && !self.frame.proxy.is_empty()
                || self.sliced_surfaces().next().is_some())
    }

    /// The polygons of the slices that can show anything. Slices with surfaces are drawn one by one.
    pub fn slice_polygons(&self) -> SlicePolygons {
        // A slice finds surfaces between it and the one in front of it: the last hits are found by a
        // slice behind the object.
        let behind_mm = self.frame.spacing.step_mm * self.frame.view.longest_slant();
        let proxy = Proxy {
            cells: &self.volume().macrocells,
            mesh: self.proxy_mesh.as_deref(),
            others: self
                .sliced_surfaces()
                .map(|object| object.cells.grid.occupied)
                .filter(|occupied| !occupied.is_empty())
                .map(|occupied| occupied.grown(behind_mm))
                .collect(),
        };
        let shift = if self.settings.jitter { 0.5 } else { 0.0 };
        SlicePolygons::of(&self.frame, &proxy, self.slices_per_slab(), shift)
    }

    /// The order in which slices are drawn: several surfaces always from back to front, where a
    /// depth test orders the hits of one slice.
    pub fn slice_order(&self) -> SliceOrder {
        if self.sliced_surfaces().nth(1).is_some() {
            SliceOrder::BackToFront
        } else {
            self.settings.slice_order
        }
    }

    /// Slices composited inside one fragment.
    pub fn slices_per_slab(&self) -> u32 {
        if self.sliced_surfaces().next().is_some() {
            1
        } else {
            self.settings.slab
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Camera;

    fn frame(view: &str, projection: Projection, bounds: Bounds) -> Frame {
        let camera = Camera {
            view: view.parse().unwrap_or_else(|e| panic!("{e}")),
            projection,
            ..Camera::default()
        };
        Frame {
            view: camera.frame(&bounds, [64, 64]).unwrap_or_else(|e| panic!("{e}")),
            size: [64, 64],
            spacing: crate::prepare::SampleSpacing {
                step_mm: 0.25,
                reference_mm: 1.0,
                blend_mm: [1.0, 2.5],
            },
            proxy: bounds,
            to_light: Vec3::X,
        }
    }

    fn proxy<'a>(cells: &'a Macrocells, mesh: Option<&'a Mesh>) -> Proxy<'a> {
        Proxy {
            cells,
            mesh,
            others: Vec::new(),
        }
    }

    /// Every ray that meets a slice inside the box passes through its slab's polygon, and polygons
    /// are only slightly larger.
    #[test]
    fn polygons_cover_the_box() {
        let bounds = Bounds::new(Vec3::new(-30.0, -20.0, -25.0), Vec3::new(30.0, 25.0, 40.0));
        for (view, projection, slab) in [
            ("anterior", Projection::Perspective, 1),
            ("30,20", Projection::Perspective, 1),
            ("30,20", Projection::Perspective, 32),
            ("130,-65", Projection::Orthographic, 1),
            ("130,-65", Projection::Orthographic, 8),
        ] {
            let frame = frame(view, projection, bounds);
            let slices = SlicePolygons::of(&frame, &proxy(&Macrocells::solid(bounds), None), slab, 0.0);
            assert!(
                slices.slabs.windows(2).all(|w| w[0].first < w[1].first),
                "front to back"
            );
            let (mut met, mut missed, mut covered) = (0, 0, 0);
            for slab in &slices.slabs {
                assert_eq!(slab.polygons.len(), 1);
                let range = &slices.polygons[slab.polygons.start as usize];
                let outline = &slices.corners[range.start as usize..range.end as usize];
                assert!(slices.slices_per_slab > 1 || (3..=6).contains(&outline.len()));
                for pixel in 0..64 * 64 {
                    let (u, v) = (
                        (pixel % 64) as f32 / 32.0 - 63.0 / 64.0,
                        (pixel / 64) as f32 / 32.0 - 63.0 / 64.0,
                    );
                    let (origin, direction) = frame.view.ray(u, v);
                    let slant = direction.dot(frame.view.forward);
                    let p =
                        origin + direction * ((outline[0] - frame.view.eye).dot(frame.view.forward) / slant);
                    let across = |n: usize| {
                        (outline[(n + 1) % outline.len()] - outline[n])
                            .cross(p - outline[n])
                            .dot(frame.view.forward)
                    };
                    let sides: Vec<bool> = (0..outline.len())
                        .map(across)
                        .filter(|a| a.abs() > 1e-4)
                        .map(|a| a > 0.0)
                        .collect();
                    let inside = sides.windows(2).all(|w| w[0] == w[1]);
                    let meets = (0..i64::from(slices.slices_per_slab)).any(|i| {
                        let t = ((slab.first + i) as f32 + 0.5) * frame.spacing.step_mm / slant;
                        let q = origin + direction * t;
                        q.cmpge(bounds.min).all() && q.cmple(bounds.max).all()
                    });
                    met += usize::from(meets);
                    covered += usize::from(inside);
                    missed += usize::from(meets && !inside);
                }
            }
            assert!(
                met > 10_000 && missed == 0 && covered as f32 <= 1.1 * met as f32,
                "{view}: {met} met, {missed} missed, {covered} covered"
            );
        }
    }

    /// The slices of a ball, times their distance, have the volume of the ball.
    #[test]
    fn polygons_fill_a_mesh() {
        let bounds = Bounds::new(Vec3::new(-30.0, -20.0, -25.0), Vec3::new(30.0, 25.0, 40.0));
        for view in ["anterior", "30,20", "130,-65"] {
            let frame = frame(view, Projection::Perspective, bounds);
            let ball = crate::mesh::shapes::sphere(20.0, 64);
            let of_mesh = SlicePolygons::of(&frame, &proxy(&Macrocells::solid(bounds), Some(&ball)), 1, 0.0);
            let area: f32 = of_mesh
                .polygons
                .iter()
                .map(|range| {
                    let p = |n: u32| of_mesh.corners[(range.start + n) as usize];
                    (p(1) - p(0)).cross(p(2) - p(0)).length() / 2.0
                })
                .sum();
            assert!(
                of_mesh.slabs.windows(2).all(|w| w[0].first < w[1].first),
                "front to back"
            );
            let ball = 4.0 / 3.0 * std::f32::consts::PI * 8000.0;
            assert!((area * 0.25 / ball - 1.0).abs() < 5e-3, "{view}");
        }
    }
}
