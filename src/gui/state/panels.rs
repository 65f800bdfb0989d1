//! State of the panels that persists between frames.

use super::worker::JobTarget;
use crate::transfer::TransferSettings;
use crate::volume::Volume;
use eframe::egui::{self, ColorImage, Context, TextureHandle};
use std::collections::HashMap;

/// The brush that paints maps.
#[derive(Clone, Copy, PartialEq)]
pub struct Brush {
    /// Radius, mm.
    pub radius: f32,
    /// Share of the full effect, 0..1.
    pub strength: f32,
}

/// The map editor.
#[derive(Default)]
pub struct MapEditor;

impl Default for Brush {
    fn default() -> Self {
        Self {
            radius: 15.0,
            strength: 0.8,
        }
    }
}

/// The tree of the scene.
#[derive(Default)]
pub struct ScenePanel;

/// The measurements.
pub struct MeasurePanel {
    /// The label to measure.
    pub label: u32,
}

impl Default for MeasurePanel {
    fn default() -> Self {
        Self { label: 1 }
    }
}

/// Bars of the histogram.
pub const BINS: usize = 256;

/// State of the transfer function panel.
#[derive(Default)]
pub struct TransferPanel {
    pub(in crate::gui) histogram: Option<Vec<f32>>,
    /// The point being dragged, or last dragged.
    pub(in crate::gui) point: Option<usize>,
    pub(in crate::gui) dragging: bool,
}

impl TransferPanel {
    /// Resets the state for another volume.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Selects a preset and resets all other settings.
    pub fn choose(&mut self, settings: &mut TransferSettings, name: &str) {
        *settings = TransferSettings {
            preset: Some(name.to_owned()),
            ..TransferSettings::default()
        };
        self.point = None;
    }

    /// Heights of the histogram bars, 0..1, logarithmic.
    pub(in crate::gui) fn heights(&mut self, volume: &Volume) -> &[f32] {
        self.histogram.get_or_insert_with(|| {
            let histogram = volume.histogram(BINS);
            let counts = &histogram.counts;
            let top = counts.iter().copied().max().unwrap_or(1).max(2) as f32;
            counts
                .iter()
                .map(|c| (1.0 + *c as f32).ln() / (1.0 + top).ln())
                .collect()
        })
    }
}

/// State of the inspector.
#[derive(Default)]
pub struct Inspector {
    /// The last report on the quality of a field.
    pub health: Option<String>,
}

/// State of the command palette.
#[derive(Default)]
pub struct Palette {
    pub(in crate::gui) query: String,
    pub(in crate::gui) row: usize,
    /// It has been shown at least once.
    pub(in crate::gui) shown: bool,
}

/// A gallery of thumbnails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gallery {
    /// Presets of the transfer function.
    Presets,
    /// Kinds of deformations.
    Kinds,
}

/// State of the list of keys.
#[derive(Default)]
pub struct KeyList {
    /// Label of the action that waits for its new key; empty if none does.
    pub waiting: String,
}

/// Thumbnails of presets and kinds.
#[derive(Default)]
pub struct Thumbnails {
    pub(in crate::gui) presets: HashMap<usize, TextureHandle>,
    pub(in crate::gui) kinds: HashMap<usize, TextureHandle>,
    pub(in crate::gui) requested_key: Option<(usize, String)>,
    /// The gallery of presets is being shown.
    pub shows_presets: bool,
    /// The gallery of kinds is being shown.
    pub shows_kinds: bool,
    pub(in crate::gui) open: Vec<JobTarget>,
}

impl Thumbnails {
    /// Discards all thumbnails.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Stores a preset's thumbnail.
    pub fn preset_arrived(&mut self, ctx: &Context, n: usize, image: ColorImage) {
        self.presets.insert(
            n,
            ctx.load_texture(format!("preset {n}"), image, egui::TextureOptions::LINEAR),
        );
    }

    /// Stores a kind's thumbnail.
    pub fn kind_arrived(&mut self, ctx: &Context, n: usize, image: ColorImage) {
        self.kinds.insert(
            n,
            ctx.load_texture(format!("kind {n}"), image, egui::TextureOptions::LINEAR),
        );
    }

    /// A preset's thumbnail.
    pub fn preset(&self, n: usize) -> Option<&TextureHandle> {
        self.presets.get(&n)
    }

    /// A kind's thumbnail.
    pub fn kind(&self, n: usize) -> Option<&TextureHandle> {
        self.kinds.get(&n)
    }
}
