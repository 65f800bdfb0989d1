//! Values of a deformation's parameters and settings, as given in scene files and options.

use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The largest integer up to which single precision represents every integer.
const MAX_WHOLE: f32 = 16_777_216.0;

/// Converts a number to an integer.
pub(super) fn whole(v: f32) -> Result<usize, String> {
    match v {
        v if v < 0.0 || v.fract() != 0.0 => Err(format!("{v} is not a whole number from 0 on")),
        v if v > MAX_WHOLE => Err(format!(
            "{v} is too large; whole numbers up to {MAX_WHOLE} can be used here"
        )),
        v => Ok(v as usize),
    }
}

/// One value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Argument {
    /// true or false.
    Flag(bool),
    /// A number.
    Number(f32),
    /// A word or a path.
    Text(String),
    /// Several numbers.
    Numbers(Vec<f32>),
    /// Several words.
    Texts(Vec<String>),
    /// Rows of numbers.
    Rows(Vec<Vec<f32>>),
}

/// As typed, shortened if long.
impl std::fmt::Display for Argument {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        const SHOWN: usize = 8;
        fn list<T: std::fmt::Display>(items: &[T]) -> String {
            let more = if items.len() > SHOWN { ",..." } else { "" };
            items
                .iter()
                .take(SHOWN)
                .map(T::to_string)
                .collect::<Vec<_>>()
                .join(",")
                + more
        }
        match self {
            Self::Flag(v) => write!(f, "{v}"),
            Self::Number(v) => write!(f, "{v}"),
            Self::Text(t) => write!(f, "\"{t}\""),
            Self::Numbers(v) => f.write_str(&list(v)),
            Self::Texts(t) => write!(f, "\"{}\"", list(t)),
            Self::Rows(rows) => f.write_str(&list(&rows.concat())),
        }
    }
}

impl From<f32> for Argument {
    fn from(v: f32) -> Self {
        Self::Number(v)
    }
}

impl From<&str> for Argument {
    fn from(v: &str) -> Self {
        Self::Text(v.to_owned())
    }
}

impl From<Vec<f32>> for Argument {
    fn from(v: Vec<f32>) -> Self {
        Self::Numbers(v)
    }
}

/// Values by name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct Arguments(pub BTreeMap<String, Argument>);

impl<const N: usize> From<[(&str, Argument); N]> for Arguments {
    fn from(entries: [(&str, Argument); N]) -> Self {
        Self(
            entries
                .into_iter()
                .map(|(name, value)| (name.to_owned(), value))
                .collect(),
        )
    }
}

impl Arguments {
    /// Sets a value.
    pub fn insert(&mut self, name: impl Into<String>, value: impl Into<Argument>) {
        self.0.insert(name.into(), value.into());
    }

    /// A word or a path.
    ///
    /// # Errors
    /// The value has another type.
    pub fn text(&self, name: &str) -> Result<Option<&str>> {
        match self.0.get(name) {
            None => Ok(None),
            Some(Argument::Text(t)) => Ok(Some(t)),
            Some(other) => Err(Error::value(name, format!("{other} is not one word or path"))),
        }
    }

    /// One or several words or paths.
    ///
    /// # Errors
    /// The value has another type.
    pub fn texts(&self, name: &str) -> Result<Option<Vec<String>>> {
        match self.0.get(name) {
            Some(Argument::Texts(all)) => Ok(Some(all.clone())),
            // An empty list is parsed as a list of numbers.
            Some(Argument::Numbers(none)) if none.is_empty() => Ok(Some(Vec::new())),
            _ => Ok(self.text(name)?.map(|t| vec![t.to_owned()])),
        }
    }

    /// One of the given words; the first if none is given.
    ///
    /// # Errors
    /// Any other word (the message names the closest known one).
    pub fn choice<'a>(&self, name: &str, valid_names: &[&'a str]) -> Result<&'a str> {
        let Some(given) = self.text(name)? else {
            return Ok(valid_names[0]);
        };
        valid_names.iter().copied().find(|k| *k == given).ok_or_else(|| {
            Error::value(
                name,
                format!(
                    "\"{given}\" is not known; {}",
                    crate::error::suggestion(given, valid_names.iter().copied())
                ),
            )
        })
    }

    /// Numbers; rows are concatenated.
    ///
    /// # Errors
    /// The value has another type, or a number is not finite.
    pub fn numbers(&self, name: &str) -> Result<Option<Vec<f32>>> {
        let numbers = match self.0.get(name) {
            None => return Ok(None),
            Some(Argument::Number(v)) => vec![*v],
            Some(Argument::Numbers(v)) => v.clone(),
            Some(Argument::Rows(rows)) => rows.concat(),
            Some(other) => {
                return Err(Error::value(
                    name,
                    format!("{other} is not a list of numbers; write numbers with commas between them"),
                ));
            }
        };
        if numbers.iter().any(|v| !v.is_finite()) {
            return Err(Error::value(name, "holds a number that is not finite"));
        }
        Ok(Some(numbers))
    }

    /// One number.
    ///
    /// # Errors
    /// The value has another type.
    pub fn number(&self, name: &str) -> Result<Option<f32>> {
        match self.numbers(name)?.as_deref() {
            None => Ok(None),
            Some([v]) => Ok(Some(*v)),
            Some(_) => Err(Error::value(name, "must be a single number")),
        }
    }

    /// Non-negative integers: labels, counts.
    ///
    /// # Errors
    /// The value has another type.
    pub fn whole(&self, name: &str) -> Result<Option<Vec<usize>>> {
        let Some(numbers) = self.numbers(name)? else {
            return Ok(None);
        };
        numbers
            .into_iter()
            .map(whole)
            .collect::<Result<_, _>>()
            .map(Some)
            .map_err(|problem| Error::value(name, problem))
    }

    /// true or false; false if not given.
    ///
    /// # Errors
    /// The value has another type.
    pub fn flag(&self, name: &str) -> Result<bool> {
        match self.0.get(name) {
            None => Ok(false),
            Some(Argument::Flag(v)) => Ok(*v),
            Some(Argument::Text(t)) if t == "true" || t == "false" => Ok(t == "true"),
            Some(other) => Err(Error::value(name, format!("{other} is neither true nor false"))),
        }
    }
}
