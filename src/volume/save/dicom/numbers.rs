//! Numbers as decimal strings (VR DS): at most 16 characters (PS3.5 6.2).

/// Longest decimal string, characters.
const MAX_CHARACTERS: usize = 16;

/// The decimal string nearest to a number; 0 for one that is not finite.
pub fn decimal(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return "0".into();
    }
    let shortest = [format!("{value}"), format!("{value:e}")];
    if let Some(exact) = shortest.into_iter().find(|t| t.len() <= MAX_CHARACTERS) {
        return exact;
    }
    let digits = (0..MAX_CHARACTERS).rev();
    let fixed = digits.clone().map(|d| format!("{value:.d$}"));
    let scientific = digits.map(|d| format!("{value:.d$e}"));
    // The largest numbers must not be rounded to infinity.
    let fits = |t: &String| t.len() <= MAX_CHARACTERS && t.parse().is_ok_and(f64::is_finite);
    let first_that_fits = |mut texts: Box<dyn Iterator<Item = String>>| texts.find(fits);
    let candidates = [
        first_that_fits(Box::new(fixed)),
        first_that_fits(Box::new(scientific)),
    ];
    let off = |text: &String| text.parse::<f64>().map_or(f64::INFINITY, |v| (v - value).abs());
    let best = candidates
        .into_iter()
        .flatten()
        .min_by(|a, b| off(a).total_cmp(&off(b)))
        .unwrap_or_else(|| "0".into());
    // No zeros at the end of a fraction.
    if best.contains('.') && !best.contains('e') {
        best.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        best
    }
}

/// Several decimal strings as one value.
pub fn decimals(values: &[f64]) -> String {
    values.iter().map(|v| decimal(*v)).collect::<Vec<_>>().join("\\")
}

/// The number that a reader gets for a number.
pub fn as_written(value: f64) -> f64 {
    decimal(value).parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_are_short_and_near() {
        for value in [
            0.0,
            -0.0,
            1.0,
            -1.0,
            0.1,
            1.0 / 3.0,
            -2.0 / 3.0,
            1e-17,
            -1.234_567_890_123_456_7e-9,
            123_456.789_012_345_67,
            -987_654_321.123_456_7,
            1e300,
            -1e-300,
            f64::MAX,
            0.488_281_249_999_999_94,
        ] {
            let text = decimal(value);
            assert!(text.len() <= 16, "{text}");
            let read: f64 = text.parse().unwrap_or(f64::NAN);
            assert!((read - value).abs() <= 1e-8 * value.abs(), "{value}: {text}");
            if value.abs() < 1000.0 {
                assert!((read - value).abs() < 1e-11, "{value}: {text}");
            }
        }
        assert_eq!(decimal(0.488_281_249_999_999_94), "0.48828125");
        assert_eq!(decimal(f64::NAN), "0");
        assert_eq!(decimals(&[1.0, -0.5]), "1\\-0.5");
    }
}
