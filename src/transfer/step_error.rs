//! How far a picture deviates where a step is represented by the values at its ends instead of by
//! the whole segment between them: the measure by which pre-integration is chosen.

use super::TransferTable;
use super::preintegrated::{Integrals, segment};
use rayon::prelude::*;

/// Number of visible steps of which the error is taken.
const MAX_STEPS: usize = 1024;
/// Bisections of a step.
const CROSSING_STEPS: usize = 5;

/// The mean error of colour and opacity, 0..1, over the steps that show anything: each is given by
/// the normalised values at its ends and `length`, in reference lengths. A step by single values
/// has the colour and opacity of its front up to where the density crosses the mean of both (found
/// as an edge is), then those of its back.
pub fn single_value_error(table: &TransferTable, steps: impl Iterator<Item = [f32; 2]>, length: f32) -> f32 {
    let is_visible = |[a, b]: &[f32; 2]| table.max_depth(a.min(*b), a.max(*b)) > 0.0;
    let visible: Vec<[f32; 2]> = steps.filter(is_visible).take(MAX_STEPS).collect();
    if visible.is_empty() {
        return 0.0;
    }
    let integrals = Integrals::new(table);
    let error = |&[a, b]: &[f32; 2]| {
        let ends = [table.lookup(a), table.lookup(b)];
        let crossing = crossing(table, [a, b], [ends[0][3], ends[1][3]]);
        let front = seen(ends[0], crossing * length);
        let back = seen(ends[1], (1.0 - crossing) * length);
        let single: [f32; 4] = std::array::from_fn(|n| front[n] + (1.0 - front[3]) * back[n]);
        let [from, to] = [a, b].map(|v| f64::from(table.position(v)));
        let whole = seen(segment(&integrals, from, to, f64::from(length)), length);
        (0..4).map(|n| (single[n] - whole[n]).abs()).fold(0.0, f32::max)
    };
    visible.par_iter().map(error).sum::<f32>() / visible.len() as f32
}

/// Where in a step the density crosses the mean of those at its ends, 0..1.
fn crossing(table: &TransferTable, [a, b]: [f32; 2], [first, last]: [f32; 2]) -> f32 {
    let (mut from, mut to) = (0.0f32, 1.0f32);
    for _ in 0..CROSSING_STEPS {
        let middle = 0.5 * (from + to);
        let depth = table.lookup(a + (b - a) * middle)[3];
        if (depth < 0.5 * (first + last)) == (first < last) {
            from = middle;
        } else {
            to = middle;
        }
    }
    0.5 * (from + to)
}

/// Premultiplied colour and opacity of a length with a colour and an optical depth.
fn seen([r, g, b, depth]: [f32; 4], length: f32) -> [f32; 4] {
    let opacity = 1.0 - (-depth * length).exp2();
    [r * opacity, g * opacity, b * opacity, opacity]
}

#[cfg(test)]
mod tests {
    use super::super::{Blend, ControlPoint, TransferFunction};
    use super::*;

    fn table(points: &[(f64, f32, f32)]) -> TransferTable {
        let points = points
            .iter()
            .map(|&(value, grey, opacity)| ControlPoint {
                value,
                color: [grey; 3],
                opacity,
            })
            .collect();
        let function = TransferFunction {
            points,
            gradient_opacity: Vec::new(),
            blend: Blend::Composite,
        };
        TransferTable::new(&function, [0.0, 1.0])
    }

    fn error(table: &TransferTable, change: f32) -> f32 {
        let steps = (0..1000).map(|n| n as f32 / 1000.0).map(|v| [v, v + change]);
        single_value_error(table, steps, 1.0)
    }

    #[test]
    fn a_curve_without_features_has_no_error() {
        let uniform = table(&[(0.0, 0.5, 0.4), (1.0, 0.5, 0.4)]);
        assert!(error(&uniform, 0.1) < 1e-5);
        // A gentle ramp, which two values describe well.
        let ramp = table(&[(0.0, 0.5, 0.0), (1.0, 0.5, 0.4)]);
        assert!(error(&ramp, 0.02) < 1e-3, "{}", error(&ramp, 0.02));
        let nothing = table(&[(0.0, 0.5, 0.0), (1.0, 0.5, 0.0)]);
        assert_eq!(error(&nothing, 0.1), 0.0);
    }

    /// Of a band narrower than a step, single values see nothing or too much.
    #[test]
    fn a_band_narrower_than_a_step_has_its_opacity_as_error() {
        let band = table(&[
            (0.490, 1.0, 0.0),
            (0.491, 1.0, 0.9),
            (0.509, 1.0, 0.9),
            (0.510, 1.0, 0.0),
        ]);
        let (narrow, wide) = (error(&band, 0.002), error(&band, 0.08));
        assert!(narrow < 0.05 && wide > 0.3, "{narrow} {wide}");
    }
}
