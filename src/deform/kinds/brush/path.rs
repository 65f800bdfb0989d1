//! Brush strokes as polylines: positions of the brush along them, and distances to them.

use glam::Vec3;

/// One position of a brush along its path, and the step that led to it.
#[derive(Clone, Copy)]
pub(super) struct Dab {
    pub(super) place: Vec3,
    pub(super) step: Vec3,
}

/// Distance to a segment, which may be a point.
pub(super) fn to_segment(p: Vec3, a: Vec3, b: Vec3) -> f32 {
    let (ab, ap) = (b - a, p - a);
    let length_squared = ab.length_squared();
    let t = if length_squared > 0.0 {
        (ap.dot(ab) / length_squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    ap.distance(ab * t)
}

/// A line without points closer together than `least`; its end points remain.
pub(super) fn thinned(line: &[Vec3], least: f32) -> Vec<Vec3> {
    let mut decimated = line.to_vec();
    decimated.dedup_by(|next, before| next.distance(*before) < least);
    if let (Some(last), Some(end)) = (decimated.last().copied(), line.last().copied())
        && last != end
    {
        decimated.push(end);
    }
    decimated
}

/// A brush's positions along a line: its first point, then steps of at most `longest`, limited to
/// ±`room`.
pub(super) fn dabs(line: &[Vec3], longest: f32, room: Vec3) -> impl Iterator<Item = Dab> {
    let first = line.first().map(|p| Dab {
        place: *p,
        step: Vec3::ZERO,
    });
    let further = line.windows(2).flat_map(move |w| {
        let (a, b) = (w[0], w[1]);
        let count = (a.distance(b) / longest).ceil().max(1.0);
        let step = (b - a) / count;
        let (enters, leaves) = share_within(a, b, room);
        ((enters * count) as u32..(leaves * count).ceil() as u32).map(move |n| Dab {
            place: a + step * (n + 1) as f32,
            step,
        })
    });
    first.into_iter().chain(further)
}

/// The fractions of the segment from a to b at which it enters and leaves ±`room`; both 0 if it
/// misses.
fn share_within(a: Vec3, b: Vec3, room: Vec3) -> (f32, f32) {
    let (mut enters, mut leaves) = (0.0f32, 1.0f32);
    for axis in 0..3 {
        let (from, way, end) = (a[axis], b[axis] - a[axis], room[axis]);
        if way != 0.0 {
            let (t, u) = ((-end - from) / way, (end - from) / way);
            (enters, leaves) = (enters.max(t.min(u)), leaves.min(t.max(u)));
        } else if from.abs() > end {
            return (0.0, 0.0);
        }
    }
    if enters <= leaves {
        (enters, leaves)
    } else {
        (0.0, 0.0)
    }
}
