//! Axes of plots: their ranges, ticks and numbers.

/// Margin between the data and the frame of a logarithmic axis, as a fraction of the data's extent.
const MARGIN: f64 = 0.08;

/// Whether a logarithmic axis can show a value.
pub(super) fn is_shown(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

/// The range of a logarithmic axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Span {
    pub low: f64,
    pub high: f64,
}

impl Span {
    /// Around positive values, with a margin; for a single value or none, a factor of two to either
    /// side.
    pub fn around(values: impl Iterator<Item = f64>) -> Self {
        let [low, high] = values.fold([f64::INFINITY, 0.0f64], |[low, high], v| {
            [low.min(v), high.max(v)]
        });
        if low > high {
            return Self { low: 0.5, high: 2.0 };
        }
        let more = (high / low)
            .powf(MARGIN)
            .max(if high / low < 1.5 { 1.5 } else { 1.0 });
        Self {
            low: low / more,
            high: high * more,
        }
    }

    /// Position of a value, 0 at the low end and 1 at the high end.
    pub fn share(&self, value: f64) -> f64 {
        (value / self.low).ln() / (self.high / self.low).ln()
    }
}

/// Round numbers within `low..high` on a logarithmic axis: about three to nine of them, rounder for
/// a wider range.
pub fn ticks(low: f64, high: f64) -> Vec<f64> {
    if !(low.is_finite() && high.is_finite() && low > 0.0 && high > low) {
        return Vec::new();
    }
    let decades = |mantissas: &[f64], every: i32| -> Vec<f64> {
        let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
        let powers = (first..=last).filter(|p| p.rem_euclid(every) == 0);
        powers
            .flat_map(|p| mantissas.iter().map(move |m| m * 10f64.powi(p)))
            .filter(|v| *v >= low && *v <= high)
            .collect()
    };
    let span = (high / low).log10();
    if span > 9.0 {
        return decades(&[1.0], (span / 5.0).ceil() as i32);
    }
    let choices: [&[f64]; 5] = [
        &[1.0],
        &[1.0, 3.0],
        &[1.0, 2.0, 5.0],
        &[1.0, 1.5, 2.0, 3.0, 5.0, 7.0],
        &[
            1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 7.0, 8.0, 9.0,
        ],
    ];
    let found = choices.into_iter().map(|m| decades(m, 1)).find(|t| t.len() >= 4);
    found.unwrap_or_else(|| {
        // Within a few percent no mantissa is round: linear steps.
        let step = round_step((high - low) / 4.0);
        let first = (low / step).ceil() as i64;
        (0..8)
            .map(|n| (first + n) as f64 * step)
            .filter(|v| *v >= low && *v <= high)
            .collect()
    })
}

/// Round numbers from 0 to `longest` on a linear axis.
pub(super) fn linear_ticks(longest: f64) -> Vec<f64> {
    let step = round_step(longest / 5.0);
    (0..=10)
        .map(|n| f64::from(n) * step)
        .filter(|v| *v <= longest * 1.05)
        .collect()
}

/// The least of 1, 2 and 5 times a power of ten that is at least `step`.
fn round_step(step: f64) -> f64 {
    if !(step.is_finite() && step > 0.0) {
        return 1.0;
    }
    let power = 10f64.powf(step.log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|m| m * power)
        .find(|v| *v >= step * (1.0 - 1e-9))
        .unwrap_or(10.0 * power)
}

/// A tick's number: only as many digits as needed, thousands as k and millions as M.
pub fn tick_label(value: f64) -> String {
    let magnitude = value.abs();
    let (scaled, unit) = if magnitude >= 1e6 {
        (value / 1e6, "M")
    } else if magnitude >= 1e4 {
        (value / 1e3, "k")
    } else {
        (value, "")
    };
    if scaled != 0.0 && scaled.abs() < 1e-4 {
        return format!("{scaled:.0e}");
    }
    let text = format!("{:.*}", if scaled.abs() < 0.1 { 5 } else { 3 }, scaled);
    let text = if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.')
    } else {
        &text
    };
    format!("{text}{unit}")
}

/// A measured number with three significant digits.
pub fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 {
            "0".to_owned()
        } else {
            "–".to_owned()
        };
    }
    let digits = 2 - value.abs().log10().floor() as i32;
    if digits > 7 {
        format!("{value:.2e}")
    } else {
        format!("{value:.*}", digits.max(0) as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        assert_eq!(ticks(0.9, 1100.0), [1.0, 10.0, 100.0, 1000.0]);
        assert_eq!(ticks(0.9, 60.0), [1.0, 3.0, 10.0, 30.0]);
        assert_eq!(ticks(9.0, 52.0), [10.0, 15.0, 20.0, 30.0, 50.0]);
        for (low, high) in [
            (0.4, 2.3),
            (1e-9, 1e12),
            (99.0, 101.0),
            (3.0, 3.6),
            (1e-3, 2e-3),
            (17.0, 5e4),
        ] {
            let t = ticks(low, high);
            assert!((2..=12).contains(&t.len()), "{low} to {high}: {t:?}");
            assert!(
                t.iter().all(|v| *v >= low && *v <= high) && t.windows(2).all(|w| w[0] < w[1]),
                "{low} to {high}: {t:?}"
            );
        }
        for (low, high) in [
            (0.0, 1.0),
            (-1.0, 1.0),
            (2.0, 1.0),
            (f64::NAN, 1.0),
            (1.0, f64::INFINITY),
        ] {
            assert!(ticks(low, high).is_empty());
        }
        assert_eq!(linear_ticks(47.0), [0.0, 10.0, 20.0, 30.0, 40.0]);
        assert!(linear_ticks(f64::MIN_POSITIVE).len() < 12);
    }

    #[test]
    fn numbers_are_short() {
        let labels = [
            0.0,
            0.5,
            1.0,
            0.0625,
            150.0,
            2000.0,
            20_000.0,
            3e6,
            0.3 - 0.1,
            2e-6,
        ]
        .map(tick_label);
        assert_eq!(
            labels,
            [
                "0", "0.5", "1", "0.0625", "150", "2000", "20k", "3M", "0.2", "2e-6"
            ]
        );
        assert_eq!(
            [1234.5, 12.345, 0.012_345, 0.0].map(number),
            ["1234", "12.3", "0.0123", "0"]
        );
    }
}
