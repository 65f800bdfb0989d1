//! Explode: the box is cut into equal pieces along its axes (two along each: octants), which move
//! apart.
//!
//! The axes are independent. With n pieces and a gap g, the box holds n pieces of (L - (n-1) g) / n
//! and the gaps between them, hence its whole content is visible. A piece keeps its shape; in a gap
//! D continues from the end of one piece, which is the start of the next.

use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, Formula, FormulaKind, GapResolution, Kind,
    Parameter,
};
use glam::Vec3;

const fn pieces(name: &'static str, about: &'static str) -> Parameter {
    Parameter::number(name, 2.0, [1.0, 16.0], about)
}

pub(super) const KIND: Kind = Kind {
    name: "explode",
    about: "cuts the box into pieces along its axes and moves them apart",
    parameters: &[
        Parameter::mm(
            "gap",
            BoxLength::OfRadius(0.25),
            [BoxLength::Fixed(0.0), BoxLength::OfRadius(0.9)],
            "distance between two pieces",
        ),
        pieces("pieces-x", "pieces along x (whole number)"),
        pieces("pieces-y", "pieces along y"),
        pieces("pieces-z", "pieces along z"),
    ],
    size: DefaultSize::Share([1.4; 3]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 128,
    nonzero_faces: [true; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Formula(|c| {
        let axis = |a: usize| {
            let count = c.value(["pieces-x", "pieces-y", "pieces-z"][a]).round().max(1.0);
            // Gaps take at most two thirds of the box.
            let most = if count > 1.0 {
                c.size_mm[a] * 0.66 / (count - 1.0)
            } else {
                0.0
            };
            let gap = (c.value("gap") * c.progress).min(most);
            ExplodeAxis {
                count,
                gap,
                piece: (c.size_mm[a] - gap * (count - 1.0)) / count,
            }
        };
        Box::new(Explode {
            axes: [axis(0), axis(1), axis(2)],
            gaps: c.gaps(),
        })
    }),
};

struct ExplodeAxis {
    count: f32,
    gap: f32,
    /// Length of a piece.
    piece: f32,
}

struct Explode {
    axes: [ExplodeAxis; 3],
    gaps: GapResolution,
}

impl ExplodeAxis {
    /// Source coordinate and distance to the nearest gap, positive in a piece.
    fn backward(&self, x: f32) -> (f32, f32) {
        let pitch = self.piece + self.gap;
        let from_low = x + 0.5 * (pitch * self.count - self.gap);
        let n = (from_low / pitch).floor().clamp(0.0, self.count - 1.0);
        let within = from_low - n * pitch;
        let (first, last) = (n == 0.0, n == self.count - 1.0);
        let source = n * self.piece + if last { within } else { within.min(self.piece) }
            - 0.5 * self.piece * self.count;
        let below = if first { f32::INFINITY } else { within };
        let above = if last { f32::INFINITY } else { self.piece - within };
        // In the gap above the piece, the nearer end determines the distance.
        let cut = if above < 0.0 {
            -(-above).min(self.gap + above)
        } else {
            below.min(above)
        };
        (source, cut)
    }

    fn forward(&self, x: f32) -> f32 {
        let n = ((x + 0.5 * self.piece * self.count) / self.piece)
            .floor()
            .clamp(0.0, self.count - 1.0);
        x + self.gap * (n - 0.5 * (self.count - 1.0))
    }
}

impl Field for Explode {
    fn backward(&self, q: Vec3) -> Backward {
        let mut source = q;
        let mut cut_distance_mm = f32::INFINITY;
        for (a, axis) in self.axes.iter().enumerate() {
            let (s, cut) = axis.backward(q[a]);
            source[a] = s;
            if axis.count > 1.0 {
                cut_distance_mm = cut_distance_mm.min(self.gaps.distance(cut, axis.gap / 2.0));
            }
        }
        Backward {
            source,
            cut_distance_mm: cut_distance_mm.min(super::NO_CUT_DISTANCE_MM),
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        Some(Vec3::from_array(std::array::from_fn(|a| {
            self.axes[a].forward(q[a])
        })))
    }

    fn formula(&self) -> Option<Formula> {
        let [x, y, z] = &self.axes;
        Some(Formula::new(
            FormulaKind::Explode,
            &[
                self.gaps.ramp_mm,
                self.gaps.texel_mm,
                x.count,
                x.gap,
                x.piece,
                y.count,
                y.gap,
                y.piece,
                z.count,
                z.gap,
                z.piece,
            ],
        ))
    }
}
