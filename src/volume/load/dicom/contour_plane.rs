//! The closed contours of one structure in one plane: the pixels inside them, and the distance of
//! pixels from them.
//!
//! Inside is what an odd number of contours encloses, at the centre of a pixel: an inner ring is a
//! hole, and the two sides of a keyhole's channel cancel. A contour that passes through centres
//! encloses those at its lower end of each axis, so that touching contours share no pixel and a
//! polygon between centres has as many pixels as its area.
//!
//! Distances are those to the polygon itself, not to pixels. The closest edge of every pixel
//! is propagated in two passes over the rows (Danielsson, Euclidean distance mapping, 1980; with
//! edges instead of points), which takes a time that does not depend on the number of edges.

use glam::{DMat2, DVec2};
use std::ops::Range;

/// Coordinates are rounded to this fraction of a pixel, so that a conversion from millimetres
/// returns centres exactly.
const STEPS_PER_PIXEL: f64 = 1e6;
/// Maximum number of pixels that are filled at a time.
const MAX_BAND: usize = 1 << 22;
/// Longest stride along a ring, in edges, in search of a closer edge; and their number.
const MAX_STRIDE: u32 = 1 << 16;
const MAX_STRIDES: usize = 8;
/// A pixel without a closest edge.
const NO_EDGE: u32 = u32::MAX;

/// An edge of a contour, from its end with the smaller y.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Edge {
    from: DVec2,
    to: DVec2,
}

/// Pixels of a grid: columns and rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    pub columns: Range<usize>,
    pub rows: Range<usize>,
}

impl Window {
    /// The pixels of a grid within bounds, and one more on each side.
    pub fn around(low: DVec2, high: DVec2, size: [usize; 2]) -> Self {
        let range = |low: f64, high: f64, n: usize| {
            let start = (low.floor() - 1.0).clamp(0.0, n as f64) as usize;
            start..((high.ceil() + 2.0).clamp(0.0, n as f64) as usize).max(start)
        };
        Self {
            columns: range(low.x, high.x, size[0]),
            rows: range(low.y, high.y, size[1]),
        }
    }

    /// Number of its pixels.
    pub fn pixels(&self) -> usize {
        self.columns.len().saturating_mul(self.rows.len())
    }

    /// Index of the pixel nearest to a point.
    fn nearest(&self, p: DVec2) -> usize {
        let near = |v: f64, range: &Range<usize>| {
            (v.round() - range.start as f64).clamp(0.0, range.len() as f64 - 1.0) as usize
        };
        near(p.y, &self.rows) * self.columns.len() + near(p.x, &self.columns)
    }
}

/// Pixels in sequence along a row.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    pub row: usize,
    pub columns: Range<usize>,
}

/// The contours of one plane, in pixels.
#[derive(Clone, Debug)]
pub struct ContourPlane {
    edges: Vec<Edge>,
    /// Smallest and largest coordinates.
    pub low: DVec2,
    pub high: DVec2,
}

impl ContourPlane {
    /// The plane of some rings, which need not repeat their first corner at their end.
    pub fn new<'a>(rings: impl Iterator<Item = &'a [DVec2]>) -> Self {
        // Adding zero makes a negative zero positive.
        let rounded = |p: DVec2| (p * STEPS_PER_PIXEL).round() / STEPS_PER_PIXEL + DVec2::ZERO;
        let (mut edges, mut low, mut high) = (
            Vec::new(),
            DVec2::splat(f64::INFINITY),
            DVec2::splat(f64::NEG_INFINITY),
        );
        for ring in rings {
            for (n, &corner) in ring.iter().enumerate() {
                let (a, b) = (rounded(corner), rounded(ring[(n + 1) % ring.len()]));
                (low, high) = (low.min(a), high.max(a));
                // The order of the ends makes an edge and its reverse the same, to the last bit.
                let (from, to) = if (a.y, a.x) <= (b.y, b.x) { (a, b) } else { (b, a) };
                // Edges are in the order of their rings: see `refine`.
                if from != to {
                    edges.push(Edge { from, to });
                }
            }
        }
        // Two equal edges bound nothing: the channel of a keyhole.
        let key = |n: usize| {
            let Edge { from, to } = edges[n];
            [from.y, from.x, to.y, to.x].map(|v| v.to_bits())
        };
        let mut order: Vec<usize> = (0..edges.len()).collect();
        order.sort_unstable_by_key(|n| key(*n));
        let mut is_boundary = vec![false; edges.len()];
        for equal in order.chunk_by(|a, b| edges[*a] == edges[*b]) {
            is_boundary[equal[0]] = equal.len() % 2 == 1;
        }
        let mut is_boundary = is_boundary.into_iter();
        edges.retain(|_| is_boundary.next() == Some(true));
        Self { edges, low, high }
    }

    /// The plane moved by some pixels.
    pub fn moved(&self, by: DVec2) -> Self {
        let moved = |e: &Edge| Edge {
            from: e.from + by,
            to: e.to + by,
        };
        Self {
            edges: self.edges.iter().map(moved).collect(),
            low: self.low + by,
            high: self.high + by,
        }
    }

    /// Whether the pixels of some rows are inside, row by row.
    fn filled(&self, columns: &Range<usize>, rows: &Range<usize>) -> Vec<bool> {
        let width = columns.len();
        let mut inside = vec![false; width * rows.len()];
        if inside.is_empty() {
            return inside;
        }
        for edge in &self.edges {
            // Rows with from.y <= row < to.y.
            let row = |y: f64| y.ceil().clamp(rows.start as f64, rows.end as f64) as usize;
            let slope = (edge.to.x - edge.from.x) / (edge.to.y - edge.from.y);
            for j in row(edge.from.y)..row(edge.to.y) {
                let x = edge.from.x + (j as f64 - edge.from.y) * slope;
                let first = (x - 0.5 / STEPS_PER_PIXEL).ceil() - columns.start as f64;
                if first < width as f64 {
                    inside[(j - rows.start) * width + first.max(0.0) as usize] ^= true;
                }
            }
        }
        for row in inside.chunks_exact_mut(width) {
            let mut odd = false;
            for pixel in row {
                odd ^= *pixel;
                *pixel = odd;
            }
        }
        inside
    }

    /// The pixels of a window that are inside.
    pub fn runs(&self, window: &Window) -> Vec<Run> {
        let mut found = Vec::new();
        let width = window.columns.len();
        let step = (MAX_BAND / width.max(1)).max(1);
        for start in window.rows.clone().step_by(step) {
            let rows = start..(start + step).min(window.rows.end);
            let inside = self.filled(&window.columns, &rows);
            for (j, row) in rows.zip(inside.chunks_exact(width.max(1))) {
                runs_of(row, j, window.columns.start, &mut found);
            }
        }
        found
    }

    /// Distances of the pixels of a window from the contours, positive inside. `mm_from_pixel`
    /// converts differences of coordinates. The window is small enough to be held.
    pub fn signed_distance(&self, window: &Window, mm_from_pixel: DMat2) -> Vec<f32> {
        let mut field = DistanceField::new(self, window, mm_from_pixel);
        field.seed();
        field.propagate();
        field.refine();
        let inside = self.filled(&window.columns, &window.rows);
        field
            .squared
            .iter()
            .zip(inside)
            .map(|(d, inside)| if inside { d.sqrt() } else { -d.sqrt() })
            .collect()
    }
}

/// Appends the runs of a row's pixels that are inside.
pub fn runs_of(inside: &[bool], row: usize, first_column: usize, runs: &mut Vec<Run>) {
    let mut start = None;
    for (i, is_inside) in inside.iter().copied().chain([false]).enumerate() {
        match (start, is_inside) {
            (None, true) => start = Some(i),
            (Some(from), false) => {
                runs.push(Run {
                    row,
                    columns: first_column + from..first_column + i,
                });
                start = None;
            }
            _ => {}
        }
    }
}

/// The closest edge of every pixel of a window, and its squared distance.
struct DistanceField<'a> {
    window: &'a Window,
    edges: &'a [Edge],
    /// Ends of the edges in millimetres.
    ends_mm: Vec<[DVec2; 2]>,
    mm_from_pixel: DMat2,
    closest: Vec<u32>,
    squared: Vec<f32>,
}

impl<'a> DistanceField<'a> {
    fn new(plane: &'a ContourPlane, window: &'a Window, mm_from_pixel: DMat2) -> Self {
        let pixels = window.pixels();
        let edges = &plane.edges;
        Self {
            window,
            edges,
            ends_mm: edges
                .iter()
                .map(|e| [e.from, e.to].map(|p| mm_from_pixel * p))
                .collect(),
            mm_from_pixel,
            closest: vec![NO_EDGE; pixels],
            squared: vec![f32::INFINITY; pixels],
        }
    }

    /// Takes an edge for a pixel if it is closer than the one before.
    #[inline]
    fn propose(&mut self, pixel: usize, edge: u32) {
        if edge == NO_EDGE || self.closest[pixel] == edge {
            return;
        }
        let width = self.window.columns.len();
        let centre = DVec2::new(
            (self.window.columns.start + pixel % width) as f64,
            (self.window.rows.start + pixel / width) as f64,
        );
        let [a, b] = self.ends_mm[edge as usize];
        let (along, from) = (b - a, self.mm_from_pixel * centre - a);
        let t = (from.dot(along) / along.length_squared()).clamp(0.0, 1.0);
        let squared = (from - along * t).length_squared() as f32;
        if squared < self.squared[pixel] {
            self.squared[pixel] = squared;
            self.closest[pixel] = edge;
        }
    }

    /// Gives every edge to the pixels along it; an edge outside of the window to those nearest to
    /// its ends.
    fn seed(&mut self) {
        let window = self.window;
        if window.pixels() == 0 {
            return;
        }
        let low = DVec2::new(window.columns.start as f64, window.rows.start as f64) - 1.0;
        let high = DVec2::new(window.columns.end as f64, window.rows.end as f64);
        for n in 0..self.edges.len().min(NO_EDGE as usize) {
            let Edge { from, to } = self.edges[n];
            let along = to - from;
            let mut part = [0.0f64, 1.0];
            for axis in 0..2 {
                if along[axis] != 0.0 {
                    let [a, b] = [low, high].map(|l| (l[axis] - from[axis]) / along[axis]);
                    part = [part[0].max(a.min(b)), part[1].min(a.max(b))];
                } else if !(low[axis]..=high[axis]).contains(&from[axis]) {
                    part = [1.0, 0.0];
                }
            }
            self.propose(window.nearest(from), n as u32);
            self.propose(window.nearest(to), n as u32);
            let steps = ((part[1] - part[0]) * along.abs().max_element()).ceil();
            if steps > 0.0 {
                for step in 0..=steps as usize {
                    let t = part[0] + (part[1] - part[0]) * step as f64 / steps;
                    self.propose(window.nearest(from + along * t), n as u32);
                }
            }
        }
    }

    /// Moves along the rings from the closest edge to an even closer one, by strides of as many
    /// edges as there are in a pixel, and then by shorter ones: of many edges within one pixel,
    /// only one is passed on.
    fn refine(&mut self) {
        let length: f64 = self.edges.iter().map(|e| e.from.distance(e.to)).sum();
        let per_pixel = self.edges.len() as f64 / length.max(1.0);
        let longest = (per_pixel.ceil() as u32).clamp(1, MAX_STRIDE).next_power_of_two();
        for pixel in 0..self.closest.len() {
            let mut stride = longest;
            while stride > 0 {
                for ahead in [true, false] {
                    for _ in 0..MAX_STRIDES {
                        let from = self.closest[pixel];
                        let next = if ahead {
                            from.checked_add(stride)
                        } else {
                            from.checked_sub(stride)
                        };
                        let Some(next) = next.filter(|n| (*n as usize) < self.edges.len()) else {
                            break;
                        };
                        self.propose(pixel, next);
                        if self.closest[pixel] == from {
                            break;
                        }
                    }
                }
                stride /= 4;
            }
        }
    }

    /// Passes the closest edges on to neighbours: downwards and upwards through the rows, in each
    /// row in both directions.
    fn propagate(&mut self) {
        let (width, height) = (self.window.columns.len(), self.window.rows.len());
        for n in 0..2 * height {
            let (row, previous) = if n < height {
                (n, n.checked_sub(1))
            } else {
                let row = 2 * height - 1 - n;
                (row, (row + 1 < height).then_some(row + 1))
            };
            for i in 0..width {
                let pixel = row * width + i;
                if let Some(previous) = previous {
                    for near in i.saturating_sub(1)..(i + 2).min(width) {
                        self.propose(pixel, self.closest[previous * width + near]);
                    }
                }
                if i > 0 {
                    self.propose(pixel, self.closest[pixel - 1]);
                }
            }
            for i in (0..width.saturating_sub(1)).rev() {
                let pixel = row * width + i;
                self.propose(pixel, self.closest[pixel + 1]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(centre: [f64; 2], radius: f64, corners: usize) -> Vec<DVec2> {
        (0..corners)
            .map(|n| {
                let angle = n as f64 / corners as f64 * std::f64::consts::TAU;
                DVec2::from_array(centre) + radius * DVec2::from_angle(angle)
            })
            .collect()
    }

    fn plane(rings: &[Vec<DVec2>]) -> ContourPlane {
        ContourPlane::new(rings.iter().map(Vec::as_slice))
    }

    fn window() -> Window {
        Window {
            columns: 0..64,
            rows: 0..48,
        }
    }

    fn pixels(plane: &ContourPlane) -> Vec<[usize; 2]> {
        let runs = plane.runs(&window());
        runs.iter()
            .flat_map(|r| r.columns.clone().map(|i| [i, r.row]))
            .collect()
    }

    #[test]
    fn a_window_without_columns_holds_nothing() {
        let window = Window {
            columns: 0..0,
            rows: 0..48,
        };
        assert!(plane(&[ring([-20.0, 20.0], 10.0, 40)]).runs(&window).is_empty());
    }

    #[test]
    fn a_ring_holds_the_centres_inside() {
        let centre = [30.3, 20.7];
        let distance = |i: usize, j: usize| DVec2::new(i as f64, j as f64).distance(centre.into());
        let count = |inside: &dyn Fn(f64) -> bool| {
            (0..48usize)
                .flat_map(|j| (0..64usize).map(move |i| (i, j)))
                .filter(|(i, j)| inside(distance(*i, *j)))
                .count()
        };
        let outer = plane(&[ring(centre, 15.0, 7200)]);
        assert_eq!(pixels(&outer).len(), count(&|d| d < 15.0));
        let hole = plane(&[ring(centre, 15.0, 7200), ring(centre, 6.0, 7200)]);
        assert_eq!(pixels(&hole).len(), count(&|d| d < 15.0 && d > 6.0));
        // As one ring, with a channel from the outer to the inner one.
        let mut keyhole = ring(centre, 15.0, 7200);
        keyhole.push(keyhole[0]);
        let mut inner = ring(centre, 6.0, 7200);
        inner.push(inner[0]);
        keyhole.extend(inner.into_iter().rev());
        let keyhole = plane(&[keyhole]);
        assert_eq!(pixels(&keyhole), pixels(&hole));
        let field = hole.signed_distance(&window(), DMat2::IDENTITY);
        assert_eq!(field, keyhole.signed_distance(&window(), DMat2::IDENTITY));
        for (n, found) in field.iter().enumerate() {
            let r = distance(n % 64, n / 64);
            let expected = (15.0 - r).min(r - 6.0);
            assert!(
                (f64::from(*found) - expected).abs() < 1e-3,
                "{n}: {found}, {expected}"
            );
        }
    }

    #[test]
    fn a_contour_through_centres_has_its_area() {
        let corners = |points: &[[f64; 2]]| points.iter().map(|p| DVec2::from_array(*p)).collect::<Vec<_>>();
        let square = corners(&[[10.0, 10.0], [20.0, 10.0], [20.0, 20.0], [10.0, 20.0]]);
        let found = pixels(&plane(std::slice::from_ref(&square)));
        assert_eq!((found.len(), found[0], found[99]), (100, [10, 10], [19, 19]));
        let next = corners(&[[20.0, 10.0], [24.0, 10.0], [24.0, 20.0], [20.0, 20.0]]);
        assert_eq!(pixels(&plane(std::slice::from_ref(&next))).len(), 40);
        assert_eq!(pixels(&plane(&[square.clone(), next])).len(), 140);
        assert_eq!(pixels(&plane(&[square.clone(), square])).len(), 0);
        // A bow tie, which crosses itself.
        let bow = corners(&[[1.5, 1.5], [9.5, 9.5], [9.5, 1.5], [1.5, 9.5]]);
        assert!(!pixels(&plane(&[bow])).contains(&[5, 2]));
        // Beyond the window on every side, and nothing at all.
        let around = corners(&[[-1e6, -1e6], [1e6, -1e6], [1e6, 1e6], [-1e6, 1e6]]);
        let around = plane(&[around]);
        assert_eq!(pixels(&around).len(), 64 * 48);
        assert!(
            around
                .signed_distance(&window(), DMat2::IDENTITY)
                .iter()
                .all(|d| *d > 9e5)
        );
        assert!(pixels(&plane(&[corners(&[[5.0, 5.0]; 3])])).is_empty());
    }
}
