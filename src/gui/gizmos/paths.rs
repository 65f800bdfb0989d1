//! Handle paths of the parameters of each kind, in the box's own space.

use crate::deform::kinds::{Kind, Unit};
use glam::{Quat, Vec3};

/// The path of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HandlePath {
    /// A length: from a point (offset from the centre as fractions of the box's extents) along a
    /// direction, in mm, times `gain`.
    Line {
        /// The point of value 0.
        from: [f32; 3],
        /// Unit direction.
        direction: [f32; 3],
        /// mm along the path per mm of the parameter.
        gain: f32,
    },
    /// An angle: about an axis through a point, from a direction, times `gain`.
    Arc {
        /// Centre, as fractions of the extents.
        center: [f32; 3],
        /// Axis.
        axis: [f32; 3],
        /// Direction of 0.
        from: [f32; 3],
        /// Degrees along the path per degree of the parameter.
        gain: f32,
    },
    /// A dimensionless parameter: from its minimum at one point to its maximum at another, as
    /// fractions of the extents.
    Span {
        /// The point of the minimum.
        low: [f32; 3],
        /// The point of the maximum.
        high: [f32; 3],
    },
}

impl HandlePath {
    /// The point of a value in the box's local millimetres.
    pub fn at(&self, value: f32, [min, max]: [f32; 2], size: Vec3) -> Vec3 {
        match *self {
            Self::Line {
                from,
                direction,
                gain,
            } => Vec3::from(from) * size + Vec3::from(direction) * (value * gain),
            Self::Arc {
                center,
                axis,
                from,
                gain,
            } => {
                let turn = Quat::from_axis_angle(Vec3::from(axis), (value * gain).to_radians());
                Vec3::from(center) * size + turn * Vec3::from(from) * (0.42 * size.min_element())
            }
            Self::Span { low, high } => {
                let share = if max > min {
                    ((value - min) / (max - min)).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                Vec3::from(low).lerp(Vec3::from(high), share) * size
            }
        }
    }
}

const X: [f32; 3] = [1.0, 0.0, 0.0];
const Y: [f32; 3] = [0.0, 1.0, 0.0];
const Z: [f32; 3] = [0.0, 0.0, 1.0];
const DOWN: [f32; 3] = [0.0, 0.0, -1.0];
const TOP: [f32; 3] = [0.0, 0.0, 0.5];
const MIDDLE: [f32; 3] = [0.0; 3];

/// The path of a kind's progress from none to full.
pub fn progress_path(kind: &str) -> HandlePath {
    let (low, high) = match kind {
        // The flap's free end, from its initial position towards the hinge.
        "peel" | "surface-peel" | "strip" => ([0.44, 0.0, -0.12], [-0.36, 0.0, 0.42]),
        // Away from the surface.
        "pull" | "spline-pull" | "lift" => ([0.0, 0.25, 0.5], [0.0, 0.25, 1.0]),
        // The lips move apart.
        "knife" | "seam" | "book" => ([0.02, -0.45, 0.5], [0.5, -0.45, 0.5]),
        "retractor" => ([-0.45, 0.02, 0.5], [-0.45, 0.5, 0.5]),
        "slab" | "explode" => ([-0.5, -0.5, 0.0], [-0.5, -0.5, 0.6]),
        _ => ([-0.5, -0.5, -0.5], [-0.5, -0.5, 0.5]),
    };
    HandlePath::Span { low, high }
}

/// The path of a kind's parameter.
pub fn path_of(kind: &Kind, n: usize) -> HandlePath {
    let p = &kind.parameters[n];
    let line = |from, direction, gain| HandlePath::Line {
        from,
        direction,
        gain,
    };
    let arc = |axis, from, gain| HandlePath::Arc {
        center: TOP,
        axis,
        from,
        gain,
    };
    match (kind.name, p.name) {
        ("peel" | "surface-peel" | "strip", "depth") => line([0.3, 0.2, -0.4], Z, 1.0),
        ("peel" | "surface-peel" | "strip", "radius") => line([-0.3, -0.3, -0.4], Z, 1.0),
        (_, "amount" | "height") if p.unit == Unit::Mm => line(TOP, Z, 1.0),
        ("pull" | "spline-pull", "sigma") => line(TOP, X, 1.0),
        ("slab", "thickness") => line([0.5, 0.0, -0.5], Z, 1.0),
        ("slab", "gap") => line([0.5, 0.25, -0.5], Z, 1.0),
        (_, "gap") => line([0.5, 0.0, 0.0], X, 1.0),
        ("knife", "length") => line(TOP, Y, 0.5),
        ("knife", "opening") => line(TOP, X, 0.5),
        ("retractor", "length") => line(TOP, X, 0.5),
        ("retractor", "opening") => line(TOP, Y, 0.5),
        ("knife" | "retractor", "depth") => line(TOP, DOWN, 1.0),
        ("wedge", "angle") => HandlePath::Arc {
            center: MIDDLE,
            axis: Z,
            from: X,
            gain: 0.5,
        },
        ("twist", "angle") => arc(Z, X, 1.0),
        ("bend" | "seam" | "book" | "shear", "angle") => HandlePath::Arc {
            center: MIDDLE,
            axis: Y,
            from: Z,
            gain: 1.0,
        },
        ("shear", "angle-y") => HandlePath::Arc {
            center: MIDDLE,
            axis: [-1.0, 0.0, 0.0],
            from: Z,
            gain: 1.0,
        },
        ("wave" | "planar-wave", "amplitude") => line(MIDDLE, Z, 1.0),
        ("wave" | "planar-wave", "wavelength") => line([-0.5, 0.0, 0.0], X, 1.0),
        _ => {
            // Side by side along one upper edge.
            let y = -0.5 + 0.2 * n as f32;
            match p.unit {
                Unit::Mm => line([0.5, y, -0.5], Z, 1.0),
                Unit::Degrees => HandlePath::Arc {
                    center: [0.0, y, 0.0],
                    axis: Z,
                    from: X,
                    gain: 1.0,
                },
                Unit::None => HandlePath::Span {
                    low: [-0.5, y, 0.5],
                    high: [0.5, y, 0.5],
                },
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::kinds;

    /// A handle identifies a value only if different values lie at different points.
    #[test]
    fn paths_tell_values_apart() {
        let size = Vec3::new(60.0, 80.0, 50.0);
        for kind in kinds::list() {
            for (n, p) in kind.parameters.iter().enumerate() {
                let [min, max] = [p.min, p.max].map(|a| a.resolve(size));
                let path = path_of(kind, n);
                let points: Vec<Vec3> = (0..=8)
                    .map(|i| path.at(min + (max - min) * i as f32 / 8.0, [min, max], size))
                    .collect();
                // A full circle may meet itself at its ends.
                for w in points.windows(2) {
                    assert!(w[0].distance(w[1]) > 1e-3, "{} {}", kind.name, p.name);
                }
                assert!(points.iter().all(|q| q.is_finite()));
            }
        }
    }
}
