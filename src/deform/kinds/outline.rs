//! A closed outline in the plane: the distance to it, and whether its edges cross. A hierarchy of
//! boxes over runs of consecutive edges (a segment tree) finds the nearest edge in logarithmic
//! time: a hand-drawn outline may have ten thousand edges and is evaluated at millions of points.

use glam::Vec2;

/// Number of edges of a leaf.
const LEAF: usize = 8;

/// A closed outline.
pub(super) struct Outline {
    points: Vec<Vec2>,
    nodes: Vec<OutlineNode>,
}

/// The box of a run of edges.
#[derive(Clone, Copy)]
struct OutlineNode {
    low: Vec2,
    high: Vec2,
    first: usize,
    end: usize,
    /// Its halves, unless it is a leaf.
    halves: Option<[usize; 2]>,
}

impl OutlineNode {
    fn distance_squared(&self, p: Vec2) -> f32 {
        p.distance_squared(p.clamp(self.low, self.high))
    }
}

impl Outline {
    /// The closed outline through at least three points.
    pub fn new(points: Vec<Vec2>) -> Self {
        let mut outline = Self {
            nodes: Vec::with_capacity(points.len() / 2 + 1),
            points,
        };
        outline.node(0, outline.points.len());
        outline
    }

    fn edge(&self, n: usize) -> (Vec2, Vec2) {
        (
            self.points[n],
            self.points[if n + 1 == self.points.len() { 0 } else { n + 1 }],
        )
    }

    /// Adds the node of edges `first` to `end`, and those below it.
    fn node(&mut self, first: usize, end: usize) -> usize {
        let at = self.nodes.len();
        let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        for n in first..end {
            let (a, b) = self.edge(n);
            (low, high) = (low.min(a).min(b), high.max(a).max(b));
        }
        self.nodes.push(OutlineNode {
            low,
            high,
            first,
            end,
            halves: None,
        });
        if end - first > LEAF {
            let middle = first.midpoint(end);
            self.nodes[at].halves = Some([self.node(first, middle), self.node(middle, end)]);
        }
        at
    }

    /// Distance to the outline, positive outside by the even-odd rule.
    pub fn signed_distance(&self, p: Vec2) -> f32 {
        let nearest = self.nearest_squared(0, p, f32::INFINITY).sqrt();
        if self.crossings_are_odd(0, p) {
            -nearest
        } else {
            nearest
        }
    }

    fn nearest_squared(&self, node: usize, p: Vec2, best: f32) -> f32 {
        let OutlineNode {
            first, end, halves, ..
        } = self.nodes[node];
        let Some([a, b]) = halves else {
            return (first..end).fold(best, |best, n| {
                let (a, b) = self.edge(n);
                let (ab, ap) = (b - a, p - a);
                let t = (ap.dot(ab) / ab.length_squared()).clamp(0.0, 1.0);
                best.min(ap.distance_squared(ab * t))
            });
        };
        let (to_a, to_b) = (
            self.nodes[a].distance_squared(p),
            self.nodes[b].distance_squared(p),
        );
        let order = if to_a <= to_b {
            [(a, to_a), (b, to_b)]
        } else {
            [(b, to_b), (a, to_a)]
        };
        order.into_iter().fold(best, |best, (half, distance)| {
            if distance < best {
                self.nearest_squared(half, p, best)
            } else {
                best
            }
        })
    }

    /// Whether a ray from `p` along x crosses an odd number of edges of a node.
    fn crossings_are_odd(&self, node: usize, p: Vec2) -> bool {
        let OutlineNode {
            low,
            high,
            first,
            end,
            halves,
        } = self.nodes[node];
        if high.x < p.x || high.y < p.y || low.y > p.y {
            return false;
        }
        if low.x > p.x {
            // The whole run lies on the ray's side: only its start and end count.
            return (self.points[first].y > p.y) != (self.edge(end - 1).1.y > p.y);
        }
        match halves {
            Some([a, b]) => self.crossings_are_odd(a, p) != self.crossings_are_odd(b, p),
            None => (first..end).fold(false, |odd, n| {
                let (a, b) = self.edge(n);
                odd != ((a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x))
            }),
        }
    }

    /// Two edges that are not neighbours and cross: the first such pair.
    pub fn crossing(&self) -> Option<(usize, usize)> {
        (0..self.points.len()).find_map(|n| self.crossed(0, n).map(|m| (n, m)))
    }

    /// The first edge after edge `n` and its neighbour that crosses it.
    fn crossed(&self, node: usize, n: usize) -> Option<usize> {
        let OutlineNode {
            low,
            high,
            first,
            end,
            halves,
        } = self.nodes[node];
        let (a, b) = self.edge(n);
        if end <= n + 2 || a.max(b).cmplt(low).any() || a.min(b).cmpgt(high).any() {
            return None;
        }
        if let Some(halves) = halves {
            return halves.into_iter().find_map(|half| self.crossed(half, n));
        }
        let side = |a: Vec2, b: Vec2, p: Vec2| (b - a).perp_dot(p - a);
        (first.max(n + 2)..end).find(|m| {
            let neighbours = n == 0 && m + 1 == self.points.len();
            let (c, d) = self.edge(*m);
            !neighbours && side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// By definition: evaluates every edge.
    fn plain(points: &[Vec2], p: Vec2) -> f32 {
        let (mut nearest, mut inside) = (f32::INFINITY, false);
        for n in 0..points.len() {
            let (a, b) = (points[n], points[(n + 1) % points.len()]);
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            nearest = nearest.min(p.distance(a + (b - a) * t));
            inside ^= (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x);
        }
        if inside { -nearest } else { nearest }
    }

    fn star(count: usize, depth: f32) -> Vec<Vec2> {
        (0..count)
            .map(|n| {
                let angle = n as f32 * std::f32::consts::TAU / count as f32;
                Vec2::from_angle(angle)
                    * (40.0 + depth * (7.0 * angle).sin() + 0.3 * depth * (31.0 * angle).cos())
            })
            .collect()
    }

    proptest! {
        #[test]
        fn distances_are_those_of_all_edges(count in 3usize..300, depth in 0.0f32..35.0, at in prop::array::uniform2(-80.0f32..80.0)) {
            let points = star(count, depth);
            let (got, want) = (Outline::new(points.clone()).signed_distance(at.into()), plain(&points, at.into()));
            prop_assert!((got - want).abs() < 1e-4 * (1.0 + want.abs()), "{got} for {want}");
        }
    }

    #[test]
    fn crossings_are_found_and_neighbours_do_not_cross() {
        let mut points = star(500, 20.0);
        assert_eq!(Outline::new(points.clone()).crossing(), None);
        points.swap(100, 103);
        assert!(
            Outline::new(points)
                .crossing()
                .is_some_and(|(a, b)| (98..=104).contains(&a) && b > a + 1)
        );
        let bow = [Vec2::ZERO, Vec2::ONE, Vec2::X, Vec2::Y].to_vec();
        assert_eq!(Outline::new(bow).crossing(), Some((0, 2)));
    }

    #[test]
    fn an_outline_of_ten_thousand_points_is_asked_at_once() {
        let outline = Outline::new(star(10_000, 25.0));
        let start = std::time::Instant::now();
        assert_eq!(outline.crossing(), None);
        let sum: f32 = (0..200_000)
            .map(|n| outline.signed_distance(Vec2::new((n % 447) as f32, (n / 447) as f32) * 0.3 - 67.0))
            .sum();
        // A search of all edges takes minutes for these.
        assert!(
            sum.is_finite() && start.elapsed().as_secs_f32() < 10.0,
            "{:?}",
            start.elapsed()
        );
    }
}
