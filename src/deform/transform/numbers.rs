//! Numbers in text files of registration programs.

/// The number that a word is: decimal, or hexadecimal as printed by `%a` (0x1.8p+3), as FSL before
/// 5.0.9 writes its matrices.
pub(super) fn number(word: &str) -> Option<f64> {
    word.parse().ok().or_else(|| hexadecimal(word))
}

/// The numbers of a text, separated by white space, commas, semicolons or brackets; lines that
/// begin with `#` or `%` are comments. None if any other word occurs, or more than `most` numbers.
pub(super) fn numbers(text: &str, most: usize) -> Option<Vec<f64>> {
    let words = text
        .lines()
        .filter(|l| !l.trim_start().starts_with(['#', '%']))
        .flat_map(|l| l.split(|c: char| c.is_whitespace() || ",;()[]".contains(c)))
        // AFNI's form of a matrix on the command line.
        .filter(|w| !w.is_empty() && *w != "MATRIX");
    let all: Option<Vec<f64>> = words
        .take(most + 1)
        .map(|w| number(w).filter(|v| v.is_finite()))
        .collect();
    all.filter(|v| v.len() <= most)
}

/// `[-]0xH.HHp[+-]D`: hexadecimal digits and a decimal exponent of 2.
fn hexadecimal(word: &str) -> Option<f64> {
    let (sign, rest) = match word.strip_prefix('-') {
        Some(rest) => (-1.0, rest),
        None => (1.0, word.strip_prefix('+').unwrap_or(word)),
    };
    let rest = rest.strip_prefix("0x").or_else(|| rest.strip_prefix("0X"))?;
    let (digits, exponent) = match rest.split_once(['p', 'P']) {
        Some((digits, exponent)) => (digits, exponent.parse::<i32>().ok()?),
        None => (rest, 0),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    if whole.is_empty() && fraction.is_empty() || digits.len() > 64 || exponent.abs() > 2000 {
        return None;
    }
    let mut value = 0.0;
    for c in whole.chars().chain(fraction.chars()) {
        value = value * 16.0 + f64::from(c.to_digit(16)?);
    }
    // In two steps, so that neither factor leaves the range of the type.
    let shift = exponent - 4 * fraction.len() as i32;
    let half = shift / 2;
    Some(sign * value * 2f64.powi(half) * 2f64.powi(shift - half))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hexadecimal_and_decimal() {
        for (word, value) in [
            ("0x1.8p+3", 12.0),
            ("-0x1.0000000000000p+0", -1.0),
            ("0x0.0p+0", 0.0),
            ("0X.8P1", 1.0),
            ("0x1p-1074", 5e-324),
            ("0x1.fffffffffffffp+1023", f64::MAX),
            ("1e3", 1000.0),
            ("+2", 2.0),
        ] {
            assert_eq!(number(word), Some(value), "{word}");
        }
        for bad in ["", "x", "0x", "0x1.g", "0x1p", "0x1pq", "1,5"] {
            assert_eq!(number(bad), None, "{bad}");
        }
        assert_eq!(numbers("# a\n1, 2;3 [4]\n", 9), Some(vec![1.0, 2.0, 3.0, 4.0]));
        assert_eq!(numbers("1 2 3", 2), None);
    }
}
