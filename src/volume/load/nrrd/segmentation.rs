//! Segmentations of 3D Slicer (`.seg.nrrd`): a label map whose keys `Segment0_Name`,
//! `Segment0_LabelValue` and so on name its segments. Segments that overlap are stored in several
//! layers, components of an axis of the kind "list", and a value may mean one segment in one layer
//! and another in the next (`Segment0_Layer`). Source: Slicer's vtkMRMLSegmentationStorageNode.
//!
//! The layers are combined into one label map. A segment keeps its value if no segment of a layer
//! before uses it; else it gets the next value that is free in all layers. Where segments overlap,
//! the one of the last layer is shown, and a notice says in how many voxels. `--channel` selects
//! one layer with the values as stored.

use super::super::ReadOptions;
use super::super::image::{Image, Meaning};
use super::header::Header;
use crate::volume::colors::Label;
use crate::{Error, Result};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Maximum number of unnamed values that a notice lists.
const MAX_UNNAMED: usize = 8;

/// A segment as its keys describe it.
pub(super) struct Segment {
    layer: Option<usize>,
    value: Option<u32>,
    name: String,
    color: Option<[u8; 3]>,
}

/// The segments in the order of their numbers; none if this is no segmentation.
pub(super) fn segments(header: &Header) -> Vec<Segment> {
    let numbers: BTreeSet<u32> = header
        .keys
        .keys()
        .filter_map(|key| {
            let (number, rest) = key.strip_prefix("segment")?.split_once('_')?;
            matches!(rest, "id" | "name" | "labelvalue" | "layer" | "color")
                .then(|| number.parse().ok())
                .flatten()
        })
        .collect();
    numbers
        .into_iter()
        .map(|n| {
            let get = |key: &str| header.keys.get(&format!("segment{n}_{key}"));
            let shares: Vec<f32> = get("color").map_or(Vec::new(), |c| {
                c.split_whitespace().map_while(|w| w.parse().ok()).collect()
            });
            let name = get("name").filter(|n| !n.trim().is_empty()).or(get("id"));
            Segment {
                layer: get("layer").and_then(|t| t.trim().parse().ok()),
                value: get("labelvalue").and_then(|t| t.trim().parse().ok()),
                name: name.map_or(String::new(), |n| n.trim().replace(char::is_control, " ")),
                color: <[f32; 3]>::try_from(shares)
                    .ok()
                    .map(|c| c.map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8)),
            }
        })
        .collect()
}

/// The segments by layer and value. Slicer's older files have one layer for every segment and do
/// not state values: a segment without a layer lies in the layer of its own number, and one without
/// a value has the value 1; in a single layer the values then follow the order of the segments.
fn placed(segments: Vec<Segment>, layers: usize, warnings: &mut Vec<String>) -> Vec<(usize, Label)> {
    let mut assumed = 0;
    let placed = segments
        .into_iter()
        .enumerate()
        .map(|(n, segment)| {
            let layer = match segment.layer {
                Some(layer) => layer,
                None if layers > 1 && segment.value.is_none() => n,
                None => 0,
            };
            let value = segment.value.unwrap_or_else(|| {
                assumed += usize::from(layers == 1);
                if layers > 1 { 1 } else { n as u32 + 1 }
            });
            let label = Label {
                value,
                name: segment.name,
                color: segment.color,
            };
            (layer, label)
        })
        .collect();
    if assumed > 0 {
        warnings.push(format!(
            "has {assumed} segments without a label value; they are numbered in the order of the segments"
        ));
    }
    placed
}

/// Turns the layers of a segmentation into one label map, or into the chosen layer.
pub(super) fn apply(
    path: &Path,
    image: &mut Image,
    segments: Vec<Segment>,
    choice: &ReadOptions,
) -> Result<()> {
    let layers = image.components;
    let placed = placed(segments, layers, &mut image.warnings);
    let missing = placed.iter().filter(|(layer, _)| *layer >= layers).count();
    if missing > 0 {
        image.warnings.push(format!(
            "names {missing} segments in layers that it does not hold; they were left out"
        ));
    }
    let chosen = ReadOptions::index("channel", choice.channel, layers)?;
    if layers > 1 {
        image.details.push(("layers", json!(layers)));
    }
    if layers == 1 || chosen.is_some() {
        let layer = chosen.unwrap_or(0);
        let mut labels: Vec<Label> = placed
            .into_iter()
            .filter(|(of, _)| *of == layer)
            .map(|(_, label)| label)
            .collect();
        labels.sort_by_key(|label| label.value);
        image.meaning = Meaning::Labels(labels);
        return Ok(());
    }
    if !image.voxels.is_integer() {
        return Err(Error::file(
            path,
            format!(
                "is a segmentation in {layers} layers whose values are not whole numbers; choose one with --channel (1 to {layers})"
            ),
        ));
    }
    combine(path, image, placed)
}

/// One label map of all layers.
fn combine(path: &Path, image: &mut Image, placed: Vec<(usize, Label)>) -> Result<()> {
    let layers = image.components;
    let stored: Vec<_> = (0..layers).map(|layer| image.one_component(layer)).collect();
    let count = image.size.iter().product::<usize>();
    // The values that occur, by layer, and those that the header names.
    let mut used: BTreeSet<(usize, u32)> = placed
        .iter()
        .filter(|(layer, _)| *layer < layers)
        .map(|(layer, label)| (*layer, label.value))
        .collect();
    for (layer, values) in stored.iter().enumerate() {
        let mut last = None;
        for n in 0..count {
            let value = label_of(path, values.get(n))?;
            if last != Some(value) && value > 0 {
                used.insert((layer, value));
            }
            last = Some(value);
        }
    }
    let renumbered = unique_labels(&used).ok_or_else(|| {
        Error::file(
            path,
            format!("has too many labels for one label map; choose a layer with --channel (1 to {layers})"),
        )
    })?;
    let mut combined: Vec<u32> = super::super::source::reserved(path, count)?;
    let mut overlapping = 0usize;
    // Neighbouring voxels mostly have the same label.
    let mut last = vec![(0, 0); layers];
    for n in 0..count {
        let (mut label, mut hits) = (0, 0);
        for (layer, values) in stored.iter().enumerate() {
            let value = label_of(path, values.get(n))?;
            if value > 0 {
                if last[layer].0 != value {
                    last[layer] = (value, renumbered.get(&(layer, value)).copied().unwrap_or(value));
                }
                label = last[layer].1;
                hits += 1;
            }
        }
        overlapping += usize::from(hits > 1);
        combined.push(label);
    }
    describe(image, placed, &renumbered, overlapping);
    let highest = renumbered.values().copied().max().unwrap_or(0);
    image.voxels = match highest {
        0..=255 => combined.iter().map(|&v| v as u8).collect::<Vec<_>>().into(),
        256..=65_535 => combined.iter().map(|&v| v as u16).collect::<Vec<_>>().into(),
        _ => combined.into(),
    };
    (image.components, image.channel_taken) = (1, true);
    Ok(())
}

/// A stored value as a label.
fn label_of(path: &Path, value: f64) -> Result<u32> {
    if (0.0..=f64::from(u32::MAX)).contains(&value) {
        Ok(value as u32)
    } else {
        Err(Error::file(
            path,
            format!("is a segmentation with the value {value}, which is not a label; correct it in Slicer"),
        ))
    }
}

/// A label of its own for every value of every layer; none if there are too many. Earlier layers
/// keep their values.
fn unique_labels(used: &BTreeSet<(usize, u32)>) -> Option<BTreeMap<(usize, u32), u32>> {
    let mut next = used.iter().map(|(_, value)| *value).max().unwrap_or(0);
    let mut taken = BTreeSet::new();
    let mut labels = BTreeMap::new();
    for &(layer, value) in used {
        let label = if taken.insert(value) {
            value
        } else {
            next = next.checked_add(1)?;
            next
        };
        labels.insert((layer, value), label);
    }
    Some(labels)
}

/// Names and colours of the combined labels, and the notices about them.
fn describe(
    image: &mut Image,
    placed: Vec<(usize, Label)>,
    renumbered: &BTreeMap<(usize, u32), u32>,
    overlapping: usize,
) {
    let layers = image.components;
    let mut changed = Vec::new();
    let mut labels = BTreeMap::new();
    let named: BTreeSet<(usize, u32)> = placed.iter().map(|(layer, l)| (*layer, l.value)).collect();
    for (layer, label) in placed {
        let Some(&value) = renumbered.get(&(layer, label.value)) else {
            continue;
        };
        if value != label.value {
            changed.push(format!(
                "{} (layer {}) from {} to {value}",
                label.name,
                layer + 1,
                label.value
            ));
        }
        labels.entry(value).or_insert(Label { value, ..label });
    }
    let unnamed: Vec<String> = renumbered
        .iter()
        .filter(|(key, to)| key.1 != **to && !named.contains(key))
        .map(|((layer, from), to)| format!("an unnamed one (layer {}) from {from} to {to}", layer + 1))
        .collect();
    changed.extend(unnamed.iter().take(MAX_UNNAMED).cloned());
    if unnamed.len() > MAX_UNNAMED {
        changed.push(format!("{} further unnamed ones", unnamed.len() - MAX_UNNAMED));
    }
    image.warnings.push(format!(
        "is a segmentation in {layers} layers, combined into one label map; use --channel (1 to {layers}) to see one layer as stored"
    ));
    if !changed.is_empty() {
        image.warnings.push(format!(
            "uses the same values in several layers; these labels were renumbered: {}",
            changed.join(", ")
        ));
    }
    if overlapping > 0 {
        image.warnings.push(format!(
            "has segments that overlap in {overlapping} voxels; there the segment of the last layer is shown"
        ));
    }
    image.meaning = Meaning::Labels(labels.into_values().collect());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_of_every_layer_has_a_label_of_its_own() {
        let used = BTreeSet::from([(0, 1), (0, 2), (1, 1), (1, 7), (2, 7), (2, 1)]);
        let labels = unique_labels(&used).unwrap_or_default();
        let unique: BTreeSet<u32> = labels.values().copied().collect();
        assert_eq!(unique.len(), used.len());
        assert_eq!(labels.get(&(0, 1)), Some(&1));
        assert_eq!(labels.get(&(1, 7)), Some(&7));
        assert_eq!(labels.get(&(1, 1)), Some(&8));
        assert!(unique_labels(&BTreeSet::from([(0, u32::MAX), (1, u32::MAX)])).is_none());
    }
}
