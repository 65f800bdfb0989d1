//! The cost of renderers at equal error: their curves of error and time over the steps of a sweep,
//! interpolated at a common error.
//!
//! The time of each renderer is interpolated at the common error on logarithmic axes, where such
//! curves are nearly straight. The common error is the smallest that all renderers reach: as close
//! to a usable picture as the measurements allow. A measured step with no greater error and a lower
//! cost is used instead. Nothing is extrapolated.

use super::run::{Run, ViewKey};
use crate::scene::Mode;

/// RMS errors below this, of 255, are rounding and not sampling: curves do not show them, and no
/// cost is interpolated there.
pub const MIN_ERROR: f64 = 1e-3;

/// All distinct views of the runs, in order.
pub fn views(runs: &[Run]) -> Vec<ViewKey> {
    let mut views: Vec<ViewKey> = Vec::new();
    for run in runs {
        if !views.contains(&run.shown) {
            views.push(run.shown.clone());
        }
    }
    views
}

/// One point of a renderer's curve over the steps of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Voxels.
    pub step: f64,
    /// RMS error against the reference, of 255; not a number if there is no reference.
    pub error: f64,
    /// Rendering time, the median.
    pub milliseconds: f64,
    /// Least and greatest time, milliseconds.
    pub spread: [f64; 2],
}

/// One renderer over the steps of a sweep, at one size and camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Rendering mode.
    pub mode: Mode,
    /// Backend.
    pub backend: String,
    /// Options of slices that are not the default.
    pub variant: String,
    /// In order of step, the coarsest first.
    pub points: Vec<CurvePoint>,
}

/// The curves of all renderers of one view, in the order of their runs.
pub fn curves(runs: &[Run], shown: &ViewKey) -> Vec<Curve> {
    let mut curves: Vec<Curve> = Vec::new();
    for run in runs.iter().filter(|run| run.shown == *shown && !run.is_reference) {
        let point = CurvePoint {
            step: f64::from(run.step),
            error: run.error.map_or(f64::NAN, |d| d.rms()),
            milliseconds: run.rendering.median,
            spread: [run.rendering.min, run.rendering.max],
        };
        match curves
            .iter_mut()
            .find(|c| (c.mode, c.backend.as_str(), c.variant.as_str()) == run.renderer())
        {
            Some(curve) => curve.points.push(point),
            None => curves.push(Curve {
                mode: run.mode,
                backend: run.backend.clone(),
                variant: run.method.variant.clone(),
                points: vec![point],
            }),
        }
    }
    for curve in &mut curves {
        curve.points.sort_by(|a, b| b.step.total_cmp(&a.step));
    }
    curves
}

/// The cost of a renderer at the common error.
#[derive(Clone, Debug, PartialEq)]
pub struct RendererCost {
    /// Rendering mode.
    pub mode: Mode,
    /// Backend.
    pub backend: String,
    /// Options of slices that are not the default.
    pub variant: String,
    /// The point at which its curve reaches the common error; none if even its coarsest step has a
    /// smaller error.
    pub at: Option<CurvePoint>,
    /// Its coarsest step.
    pub coarsest: Option<CurvePoint>,
}

/// Renderers at equal error.
#[derive(Clone, Debug, PartialEq)]
pub struct EqualError {
    /// The view.
    pub shown: ViewKey,
    /// The common error, RMS of 255.
    pub error: f64,
    /// Every renderer whose error is known at two or more steps.
    pub entries: Vec<RendererCost>,
}

/// For every view of the runs: the costs of its renderers at their common error, if two or more
/// reach one.
pub fn equal_errors(runs: &[Run]) -> Vec<EqualError> {
    let at_one = |shown: ViewKey| -> Option<EqualError> {
        let curves: Vec<Curve> = curves(runs, &shown)
            .into_iter()
            .filter(|c| usable(&c.points).count() > 1)
            .collect();
        let error = common_error(&curves)?;
        let entry = |c: Curve| RendererCost {
            at: at_error(&c.points, error),
            coarsest: usable(&c.points).next(),
            mode: c.mode,
            backend: c.backend,
            variant: c.variant,
        };
        let entries: Vec<RendererCost> = curves.into_iter().map(entry).collect();
        // Curves that do not overlap have no common error.
        (entries.iter().filter(|e| e.at.is_some()).count() > 1).then_some(EqualError {
            shown,
            error,
            entries,
        })
    };
    views(runs).into_iter().filter_map(at_one).collect()
}

/// Points that have logarithms; errors below `MIN_ERROR` (rounding) are raised to it.
fn usable(points: &[CurvePoint]) -> impl Iterator<Item = CurvePoint> {
    let positive = |v: f64| v.is_finite() && v > 0.0;
    let usable = points
        .iter()
        .copied()
        .filter(move |p| positive(p.step) && p.error.is_finite() && positive(p.milliseconds));
    usable.map(|p| CurvePoint {
        error: p.error.max(MIN_ERROR),
        ..p
    })
}

/// The smallest error that all curves reach; none for fewer than two curves, or if one has no
/// usable point.
pub fn common_error(curves: &[Curve]) -> Option<f64> {
    if curves.len() < 2 {
        return None;
    }
    let best = |c: &Curve| usable(&c.points).map(|p| p.error).reduce(f64::min);
    curves
        .iter()
        .map(best)
        .try_fold(0.0f64, |worst, best| Some(worst.max(best?)))
}

/// The point of a curve at an error: step and milliseconds interpolated between the two measured
/// points around it, all three by their logarithms, or a measured point with no greater error,
/// whichever is cheapest. None if the error is outside the measured range, as it is if the coarsest
/// step has a smaller error.
pub fn at_error(points: &[CurvePoint], error: f64) -> Option<CurvePoint> {
    let points: Vec<CurvePoint> = usable(points).collect();
    if points.len() < 2 || points[0].error < error {
        return None;
    }
    let between = |[a, b]: [CurvePoint; 2]| {
        if !(a.error.min(b.error)..=a.error.max(b.error)).contains(&error) {
            return None;
        }
        let span = (b.error / a.error).ln();
        let share = if span == 0.0 {
            0.0
        } else {
            ((error / a.error).ln() / span).clamp(0.0, 1.0)
        };
        let mix = |a: f64, b: f64| (a.ln() + share * (b / a).ln()).exp();
        let milliseconds = mix(a.milliseconds, b.milliseconds);
        Some(CurvePoint {
            step: mix(a.step, b.step),
            error,
            milliseconds,
            spread: [milliseconds; 2],
        })
    };
    let found = points.windows(2).filter_map(|w| between([w[0], w[1]]));
    found
        .chain(points.iter().copied().filter(|p| p.error <= error))
        .min_by(|a, b| a.milliseconds.total_cmp(&b.milliseconds))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::run::tests::run;

    /// error = c · step^p, milliseconds = k / step: straight lines on logarithmic axes.
    fn power(mode: Mode, c: f64, p: f64, k: f64, steps: &[f64]) -> Curve {
        let point = |&step: &f64| CurvePoint {
            step,
            error: c * step.powf(p),
            milliseconds: k / step,
            spread: [k / step; 2],
        };
        Curve {
            mode,
            backend: "cpu".to_owned(),
            variant: String::new(),
            points: steps.iter().map(point).collect(),
        }
    }

    #[test]
    fn powers_are_interpolated_exactly() {
        let steps = [4.0, 1.0, 0.5];
        let curve = power(Mode::Slice, 3.0, 1.5, 20.0, &steps);
        for error in [3.0 * 8.0, 10.0, 3.0, 1.7, 3.0 * 0.5f64.powf(1.5)] {
            let at = at_error(&curve.points, error).unwrap();
            let step = (error / 3.0).powf(1.0 / 1.5);
            assert!(
                (at.step - step).abs() < 1e-9
                    && (at.milliseconds - 20.0 / step).abs() < 1e-9
                    && at.error == error,
                "{error}: {at:?}"
            );
        }
        for beyond in [24.01, 1.06, 0.0, f64::NAN, f64::INFINITY] {
            assert_eq!(at_error(&curve.points, beyond), None, "{beyond} was not measured");
        }
        assert_eq!(at_error(&curve.points[..1], 24.0), None);
        // Rounding is not a sampling error: it is below any common error.
        let rounding = power(Mode::Slice, 1e-4, 1.0, 20.0, &steps);
        let common = common_error(&[curve, rounding.clone()]).unwrap();
        assert!(
            (common - 3.0 * 0.5f64.powf(1.5)).abs() < 1e-12 && at_error(&rounding.points, common).is_none()
        );
        assert_eq!(common_error(&[rounding.clone(), rounding]), Some(MIN_ERROR));
    }

    #[test]
    fn the_common_error_is_the_least_that_all_reach() {
        let steps = [2.0, 1.0, 0.5];
        let [good, bad] = [
            power(Mode::Raycast, 1.0, 2.0, 30.0, &steps),
            power(Mode::Slice, 2.0, 2.0, 10.0, &steps),
        ];
        let common = common_error(&[good.clone(), bad.clone()]).unwrap();
        assert!((common - 0.5).abs() < 1e-12);
        // The good curve reaches it at a step of √½, the bad one at its finest step.
        let [good_at, bad_at] = [&good, &bad].map(|c| at_error(&c.points, common).unwrap());
        assert!(
            (good_at.milliseconds - 30.0 / 0.5f64.sqrt()).abs() < 1e-9
                && (bad_at.milliseconds - 20.0).abs() < 1e-9
        );
        let nothing = Curve {
            points: vec![CurvePoint {
                step: 1.0,
                error: f64::NAN,
                milliseconds: 1.0,
                spread: [1.0; 2],
            }],
            ..good.clone()
        };
        assert_eq!(
            (
                common_error(std::slice::from_ref(&good)),
                common_error(&[good.clone(), nothing])
            ),
            (None, None)
        );
        // A curve that is exact at its finest step still has an error that the other one also
        // reaches.
        let exact = Curve {
            points: vec![
                CurvePoint {
                    error: 5.0,
                    ..good.points[0]
                },
                CurvePoint {
                    error: 5.0,
                    ..good.points[1]
                },
                CurvePoint {
                    error: 0.0,
                    ..good.points[2]
                },
            ],
            ..good
        };
        let common = common_error(&[exact.clone(), bad]).unwrap();
        let at = at_error(&exact.points, common).unwrap();
        assert!(
            (common - 0.5).abs() < 1e-12 && (0.5..1.0).contains(&at.step) && at.error == common,
            "{at:?}"
        );
    }

    #[test]
    fn an_error_that_rises_again_is_met_where_it_is_cheapest() {
        let point = |step: f64, error: f64| CurvePoint {
            step,
            error,
            milliseconds: 8.0 / step,
            spread: [0.0; 2],
        };
        let points = [
            point(2.0, 8.0),
            point(1.0, 2.0),
            point(0.5, 2.0),
            point(0.25, 8.0),
            point(0.1, 0.0),
        ];
        let at = at_error(&points, 4.0).unwrap();
        assert!((at.step - 2f64.sqrt()).abs() < 1e-9, "{at:?}");
        assert!((at_error(&points, 2.0).unwrap().step - 1.0).abs() < 1e-9);
        // A measured step with a smaller error and a lower cost than the interpolated point.
        let points = [
            CurvePoint {
                milliseconds: 3.0,
                ..point(2.0, 4.1)
            },
            point(1.0, 8.0),
            CurvePoint {
                milliseconds: 2.0,
                ..point(0.5, 3.9)
            },
        ];
        assert_eq!(
            at_error(&points, 4.0).map(|p| (p.step, p.milliseconds)),
            Some((0.5, 2.0))
        );
    }

    #[test]
    fn renderers_are_told_apart_where_they_overlap() {
        let mut runs = Vec::new();
        for (mode, backend, c) in [
            (Mode::Slice, "cpu", 2.0),
            (Mode::Raycast, "cpu", 1.0),
            (Mode::Raycast, "gpu", 0.01),
            (Mode::Surface, "cpu", 1.0),
        ] {
            for step in [0.5f32, 1.0, 2.0] {
                let name = format!("{mode:?} {backend} {step}");
                runs.push(run(
                    &name,
                    mode,
                    backend,
                    step,
                    c * f64::from(step),
                    10.0 / f64::from(step),
                ));
            }
        }
        runs.push(run("reference", Mode::Raycast, "cpu", 0.0625, 0.0, 100.0));
        let curves = curves(&runs, &runs[0].shown);
        assert_eq!(curves.len(), 3);
        assert!(
            curves
                .iter()
                .all(|c| c.points.iter().map(|p| p.step).eq([2.0, 1.0, 0.5]))
        );
        let equal = equal_errors(&runs);
        assert!(
            equal.len() == 1 && (equal[0].error - 1.0).abs() < 1e-9,
            "{equal:?}"
        );
        let at = |n: usize| equal[0].entries[n].at.map(|p| p.milliseconds);
        assert!((at(0).unwrap() - 20.0).abs() < 1e-6 && (at(1).unwrap() - 10.0).abs() < 1e-6);
        assert!(
            at(2).is_none() && equal[0].entries[2].coarsest.is_some_and(|p| p.step == 2.0),
            "better at every step"
        );
        let one_step: Vec<Run> = runs.iter().filter(|r| r.step == 1.0).cloned().collect();
        assert!(equal_errors(&one_step).is_empty());
    }
}
