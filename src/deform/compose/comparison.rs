//! The error of one mapping relative to another, and the limits on it.

use crate::math::Bounds;
use glam::Vec3;
use rayon::prelude::*;

/// Points at which a composed map is compared with its original during refinement.
pub(super) const PROBES: usize = 100_000;
/// Points of the final comparison.
pub(super) const LAST_PROBES: usize = 600_000;
/// Fraction of the bound that the error at the compared points may use: between them it may be
/// larger.
pub(super) const OF_BOUND: f32 = 0.6;
/// If a map twice as fine is not this much better, no map will be good enough: the stack tears
/// there.
pub(super) const MIN_GAIN: f32 = 0.8;

/// Points spread over the unit cube: multiples of the powers of the plastic number, to avoid
/// hitting the cells of a map's grid at the same position repeatedly.
pub(super) fn spread(n: usize) -> Vec3 {
    Vec3::from(
        [
            0.819_172_513_396_164_4,
            0.671_043_606_703_789_3,
            0.549_700_477_901_970_2f64,
        ]
        .map(|a| (0.5 + a * n as f64).fract() as f32),
    )
}

/// The largest error and the 99th percentile; zeros if there are no errors.
pub(super) fn worst_and_p99(mut errors: Vec<f32>) -> (f32, f32) {
    if errors.is_empty() {
        return (0.0, 0.0);
    }
    let rank = (errors.len() * 99 / 100).min(errors.len() - 1);
    let (_, p99, above) = errors.select_nth_unstable_by(rank, f32::total_cmp);
    let p99 = *p99;
    (above.iter().fold(p99, |a, b| a.max(*b)), p99)
}

/// A mapping. It takes a reference: where two closures take the same point by value, Rust 1.95
/// passes to the second one the value as modified by the first (rust-lang/rust#155241).
type Map<'a> = dyn Fn(&Vec3) -> (Vec3, f32) + Sync + 'a;

/// Compares the sources and masks of one mapping with those of another.
pub(super) struct Comparison<'a> {
    pub(super) exact: &'a Map<'a>,
    pub(super) scene_box: &'a Bounds,
}

impl Comparison<'_> {
    /// The error of a mapping at a point, mm; none where both are empty. The mask's slope is
    /// measured over `h` mm.
    pub(super) fn error(&self, composed: &Map, p: Vec3, h: f32) -> Option<f32> {
        let holds = |p: Vec3| self.scene_box.contains(&Bounds::new(p, p));
        let ((source, alpha), (found, found_alpha)) = ((self.exact)(&p), composed(&p));
        let (shows, found_shows) = (alpha >= 0.5 && holds(source), found_alpha >= 0.5 && holds(found));
        match (alpha >= 0.5, found_alpha >= 0.5) {
            _ if !shows && !found_shows => None,
            (true, true) => Some(source.distance(found)),
            // Distance to the cut that only one of them has.
            _ => {
                let mask = |p: Vec3| (self.exact)(&p).1;
                let slope =
                    Vec3::from(Vec3::AXES.map(|e| mask(p + e * h) - mask(p - e * h))).length() / (2.0 * h);
                Some((alpha - 0.5).abs() / slope.max(1e-6))
            }
        }
    }

    /// The errors at points spread over a box, and those points.
    pub(super) fn errors(&self, composed: &Map, over: &Bounds, probes: usize, h: f32) -> Vec<(f32, Vec3)> {
        let of_point = |n: usize| {
            let p = over.min + spread(n) * over.size();
            self.error(composed, p, h).map(|e| (e, p))
        };
        (0..probes)
            .into_par_iter()
            .with_min_len(1024)
            .filter_map(of_point)
            .collect()
    }
}
