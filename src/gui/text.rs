//! Formatting of words and numbers in the window.

/// A number with suitable precision, and its unit.
pub fn number(value: f64, unit: &str) -> String {
    let digits = match value.abs() {
        v if v >= 1000.0 => 0,
        v if v >= 10.0 => 1,
        _ => 2,
    };
    let text = format!("{value:.digits$}");
    match unit {
        "" => text,
        "°" => format!("{text}°"),
        unit => format!("{text} {unit}"),
    }
}

/// A text broken into lines of at most `most` characters, at spaces where possible.
pub fn wrapped(text: &str, most: usize) -> String {
    let mut out = String::new();
    let mut length = 0;
    for word in text.split(' ') {
        let n = word.chars().count();
        if length > 0 && length + n + 1 > most {
            out.push('\n');
            length = 0;
        } else if length > 0 {
            out.push(' ');
            length += 1;
        }
        let mut rest: Vec<char> = word.chars().collect();
        while rest.len() > most {
            let tail = rest.split_off(most);
            out.extend(rest);
            out.push('\n');
            rest = tail;
        }
        length += rest.len();
        out.extend(rest);
    }
    out
}

/// The text with an initial capital.
pub(in crate::gui) fn capital(text: &str) -> String {
    let mut text = text.to_owned();
    if let Some(first) = text.get_mut(0..1) {
        first.make_ascii_uppercase();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_wrapping() {
        assert_eq!(number(12.345, "mm"), "12.3 mm");
        assert_eq!(number(-0.5, "°"), "-0.50°");
        assert_eq!(number(4321.0, ""), "4321");
        let lines = wrapped("one two three four abcdefghijklmnop", 9);
        assert!(lines.lines().all(|l| l.chars().count() <= 9), "{lines}");
        assert_eq!(lines.replace(['\n', ' '], ""), "onetwothreefourabcdefghijklmnop");
    }
}
