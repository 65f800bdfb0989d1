//! Divides the frames of a series into volumes of one time, echo, phase and so on: by the attributes
//! that differ, never by the names of files.
//!
//! First come the attributes that standards and scanners use for this ([`KEYS`]), then any other
//! attribute that divides the frames into whole volumes, then their order in time, and last instance
//! numbers, which are a guess.

use super::divider::Divider;
use super::frame::{Frame, KeyValue};
use super::time_keys::KEYS;
use dicom_core::Tag;
use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry};
use dicom_dictionary_std::StandardDataDictionary;
use serde_json::{Value, json};
use std::collections::HashSet;

/// Smallest number of slices of a volume, as a fraction of those of the largest one; fewer are
/// repeated slices.
const SMALLEST_VOLUME: f64 = 0.5;

/// How volumes at one place are told apart.
#[derive(Clone, Debug, Default)]
pub struct TimePoints {
    /// The attributes that differ.
    names: Vec<String>,
    /// Their values, for each volume.
    values: Vec<Vec<KeyValue>>,
}

impl TimePoints {
    /// For messages: the attributes and their values.
    pub fn described(&self) -> Option<String> {
        const MOST: usize = 6;
        if self.names.is_empty() {
            return None;
        }
        if self.values.iter().all(Vec::is_empty) {
            return Some(self.names.join(" and "));
        }
        let of_each: Vec<String> = self
            .values
            .iter()
            .take(MOST)
            .map(|values| {
                values
                    .iter()
                    .map(KeyValue::to_string)
                    .collect::<Vec<_>>()
                    .join(" and ")
            })
            .collect();
        let more = if self.values.len() > MOST { ", ..." } else { "" };
        Some(format!(
            "{}: {}{more}",
            self.names.join(" and "),
            of_each.join(", ")
        ))
    }

    /// For `info`: the attributes and values of each volume.
    pub fn json(&self) -> Option<Value> {
        let entry = |values: &Vec<KeyValue>| {
            let pairs = self.names.iter().zip(values);
            Value::Object(pairs.map(|(n, v)| ((*n).to_owned(), v.json())).collect())
        };
        (!self.names.is_empty()).then(|| json!(self.values.iter().map(entry).collect::<Vec<_>>()))
    }
}

/// Frames divided into volumes.
pub struct Division {
    /// Indices of the frames of each volume.
    pub volumes: Vec<Vec<usize>>,
    pub by: TimePoints,
    /// Frames at the same position as another one of their volume, or of too small a volume.
    pub duplicates: Vec<usize>,
    /// How far frames could be told apart.
    pub certainty: Certainty,
}

/// How far frames at one position could be told apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Certainty {
    /// By their attributes.
    Certain,
    /// By instance numbers alone.
    ByInstance,
    /// By nothing but their order.
    Ambiguous,
}

/// Divides frames, given the stack of each and its position along the normal, into volumes that
/// have at most one frame of each stack.
pub fn divide(frames: &[Frame], stack: &[usize], at: &[f64]) -> Division {
    let mut divider = Divider::new(frames, stack, at);
    let mut keys: Vec<usize> = (0..KEYS.len())
        .filter(|k| KEYS[*k].parts_volumes && divider.divide_overlapping(*k))
        .collect();
    for key in 0..KEYS.len() {
        if divider.is_done() {
            break;
        }
        if divider.divide_by_values(key) {
            keys.push(key);
        }
    }
    let mut others = Vec::new();
    let mut certainty = Certainty::Certain;
    if !divider.is_done() {
        others = divider.divide_by_any();
    }
    if !divider.is_done() {
        let by_order = (0..KEYS.len())
            .filter(|k| KEYS[*k].runs_on)
            .find(|k| divider.divide_by_order(*k));
        match by_order {
            Some(key) => {
                keys.push(key);
                if KEYS[key].is_guess {
                    certainty = Certainty::ByInstance;
                }
            }
            None => {
                divider.divide_arbitrarily();
                certainty = Certainty::Ambiguous;
            }
        }
    }
    volumes(&divider, &keys, &others, certainty)
}

/// The name of an attribute.
fn attribute_name(tag: Tag) -> String {
    match StandardDataDictionary.by_tag(tag) {
        Some(entry) => entry.alias().to_owned(),
        None => format!("the private attribute {tag}"),
    }
}

/// The volumes of a finished division.
fn volumes(divider: &Divider, keys: &[usize], others: &[Tag], certainty: Certainty) -> Division {
    let groups = divider.groups();
    let largest = groups.iter().map(Vec::len).max().unwrap_or(0);
    let is_parted = keys.iter().any(|k| KEYS[*k].parts_volumes);
    let enough =
        |g: &Vec<usize>| g.len() as f64 >= SMALLEST_VOLUME * largest as f64 || is_parted && g.len() > 1;
    let (mut volumes, few): (Vec<Vec<usize>>, Vec<Vec<usize>>) = groups.into_iter().partition(enough);
    let mut duplicates = few.concat();
    if let [only] = &mut volumes[..] {
        // Positions that only the other frames have belong to the one volume.
        let mut there: HashSet<usize> = only.iter().map(|n| divider.stack[*n]).collect();
        duplicates.retain(|n| {
            let new = there.insert(divider.stack[*n]);
            if new {
                only.push(*n);
            }
            !new
        });
        only.sort_unstable();
    }
    let mut by = TimePoints::default();
    if volumes.len() > 1 {
        by.names = keys.iter().map(|k| KEYS[*k].name.to_owned()).collect();
        by.names.extend(others.iter().copied().map(attribute_name));
        by.values = volumes
            .iter()
            .map(|v| {
                let of = |k: &usize| divider.value(v[0], *k).cloned();
                keys.iter()
                    .map(|k| of(k).unwrap_or_else(|| KeyValue::Text("not stated".into())))
                    .collect()
            })
            .collect();
        for (n, _) in keys.iter().enumerate().filter(|(_, k)| KEYS[**k].relative) {
            from_first(&mut by.values, n);
        }
    }
    Division {
        volumes,
        by,
        duplicates,
        certainty,
    }
}

/// Makes the numbers of the n-th attribute count from the first volume's.
fn from_first(values: &mut [Vec<KeyValue>], n: usize) {
    let Some(KeyValue::Number(first)) = values.first().map(|v| v[n].clone()) else {
        return;
    };
    for volume in values {
        if let KeyValue::Number(number) = &mut volume[n] {
            // Times are stated to the microsecond.
            *number = ((*number - first) * 1e6).round() / 1e6;
        }
    }
}
