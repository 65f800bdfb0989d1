//! Settings of kinds that are not sliders: their format, and their validation.

use crate::deform::Argument;
use crate::deform::argument::whole;

/// A named non-numeric setting of a kind.
pub struct Setting {
    /// Name as typed.
    pub name: &'static str,
    /// Its format.
    pub form: SettingFormat,
    /// Its meaning and default, one line for lists.
    pub about: &'static str,
}

/// The format of a setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SettingFormat {
    /// `true` or `false`; the default is `false`.
    Flag,
    /// One of these words; the first is the default.
    Choice(&'static [&'static str]),
    /// One of these words, or nothing.
    OneOf(&'static [&'static str]),
    /// One number.
    Number,
    /// Non-negative integers.
    Whole,
    /// Rows of this many numbers.
    Rows(usize),
    /// The same, or a `.csv` file of them.
    RowsOrFile(usize),
    /// A file.
    File,
    /// A file, or several.
    Files,
    /// Any text.
    Words,
}

impl Setting {
    /// Parses a typed text; none for an empty one, which means the default.
    ///
    /// # Errors
    /// The problem with the text and what to write instead, in one line.
    pub fn parse(&self, text: &str) -> Result<Option<Argument>, String> {
        let text = text.trim();
        if text.is_empty() {
            return Ok(None);
        }
        let words: Vec<&str> = text
            .split([',', ';'])
            .map(str::trim)
            .filter(|w| !w.is_empty())
            .collect();
        if words.is_empty() {
            return Err(format!("\"{text}\" names nothing"));
        }
        let number = |w: &&str| w.parse::<f32>().ok().filter(|v| v.is_finite());
        let numbers: Option<Vec<f32>> = words.iter().map(number).collect();
        let is_file = |w: &str| w.contains(['.', '/', '\\', ':']) && number(&w).is_none();
        let argument = match self.form {
            SettingFormat::Flag => match text {
                "true" => Argument::Flag(true),
                "false" => Argument::Flag(false),
                _ => return Err(format!("\"{text}\" is neither true nor false")),
            },
            SettingFormat::Choice(all) | SettingFormat::OneOf(all) if all.contains(&text) => {
                Argument::Text(text.to_owned())
            }
            SettingFormat::Choice(all) | SettingFormat::OneOf(all) => {
                return Err(format!("\"{text}\" is not one of: {}", all.join(", ")));
            }
            SettingFormat::Number => match numbers.as_deref() {
                Some([v]) => Argument::Number(*v),
                _ => return Err(format!("\"{text}\" is not a number")),
            },
            SettingFormat::Whole => match numbers {
                Some(v) if v.iter().all(|v| *v >= 0.0 && v.fract() == 0.0) => {
                    v.iter().try_for_each(|v| whole(*v).map(drop))?;
                    one_or_more(v)
                }
                _ if words.iter().any(|w| is_file(w)) => {
                    return Err(format!(
                        "\"{text}\" looks like a file name; enter whole numbers, such as 3 or 1, 4"
                    ));
                }
                _ => {
                    return Err(format!(
                        "\"{text}\" is not a list of whole numbers; enter numbers such as 3 or 1, 4"
                    ));
                }
            },
            SettingFormat::RowsOrFile(_) if words.len() == 1 && is_file(words[0]) => {
                Argument::Text(text.to_owned())
            }
            SettingFormat::Rows(each) | SettingFormat::RowsOrFile(each) => match numbers {
                Some(v) if v.len() % each == 0 => Argument::Numbers(v),
                Some(v) => {
                    return Err(format!(
                        "{} numbers do not fill complete rows of {each}; add or remove numbers",
                        v.len()
                    ));
                }
                None => {
                    return Err(format!(
                        "\"{text}\" is not a list of numbers; enter rows of {each} numbers, separated by commas"
                    ));
                }
            },
            SettingFormat::Files if words.len() > 1 => {
                Argument::Texts(words.iter().map(|w| (*w).to_owned()).collect())
            }
            SettingFormat::File | SettingFormat::Files | SettingFormat::Words => {
                Argument::Text(text.to_owned())
            }
        };
        Ok(Some(argument))
    }

    /// The files named by a value.
    pub fn files<'a>(&self, argument: &'a Argument) -> Vec<&'a str> {
        match (self.form, argument) {
            (
                SettingFormat::File | SettingFormat::Files | SettingFormat::RowsOrFile(_),
                Argument::Text(file),
            ) => vec![file],
            (SettingFormat::Files, Argument::Texts(files)) => files.iter().map(String::as_str).collect(),
            _ => Vec::new(),
        }
    }
}

fn one_or_more(v: Vec<f32>) -> Argument {
    match v[..] {
        [one] => Argument::Number(one),
        _ => Argument::Numbers(v),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_a_setting_is_refused() {
        let of = |form| Setting {
            name: "x",
            form,
            about: "",
        };
        let whole = of(SettingFormat::Whole);
        assert_eq!(whole.parse(" 3 "), Ok(Some(Argument::Number(3.0))));
        assert_eq!(whole.parse("1, 4"), Ok(Some(Argument::Numbers(vec![1.0, 4.0]))));
        assert_eq!(whole.parse("  "), Ok(None));
        for (text, word) in [
            ("labels.nii.gz", "file name"),
            ("1.5", "whole"),
            ("-1", "whole"),
            ("brain", "whole"),
            ("1, inf", "whole"),
        ] {
            assert!(
                whole.parse(text).is_err_and(|e| e.contains(word)),
                "{text}: {:?}",
                whole.parse(text)
            );
        }
        assert!(
            of(SettingFormat::Flag).parse("yes").is_err() && of(SettingFormat::Number).parse("1, 2").is_err()
        );
        assert!(
            of(SettingFormat::Choice(&["or", "and"]))
                .parse("xor")
                .is_err_and(|e| e.contains("or, and"))
        );
        let rows = of(SettingFormat::RowsOrFile(6));
        assert!(
            rows.parse("1,2,3").is_err()
                && rows.parse("p.csv").is_ok()
                && rows.parse("0,0,0,1,2,3; 4,5,6,7,8,9").is_ok()
        );
        assert!(of(SettingFormat::Rows(6)).parse("p.csv").is_err());
        let files = of(SettingFormat::Files).parse("a.mat, b.nii").unwrap().unwrap();
        assert_eq!(of(SettingFormat::Files).files(&files), ["a.mat", "b.nii"]);
    }

    /// Every word that a kind offers is accepted by it.
    #[test]
    fn every_choice_is_taken() {
        for kind in crate::deform::kinds::list() {
            for setting in kind.settings() {
                if let SettingFormat::Choice(all) = setting.form {
                    assert!(
                        all.iter().all(|w| setting.parse(w).is_ok()),
                        "{}: {}",
                        kind.name,
                        setting.name
                    );
                }
            }
        }
    }
}
