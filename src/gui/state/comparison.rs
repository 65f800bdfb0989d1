//! The comparison of two renderers.

use super::shown::OutdatedNotice;
use crate::compare::Difference;
use crate::picture::{Picture, RenderStats};
use crate::prepare::Assets;
use crate::scene::{Antialias, Mode, Scene};
use eframe::egui::{Rect, TextureHandle};
use std::sync::Arc;
use std::time::Instant;

/// Pictures are requested after this time without a change, seconds.
pub const REST: f64 = 0.2;

/// Amplification of the displayed difference.
pub const AMPLIFY: f32 = 8.0;

/// One side of the comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComparisonSide {
    /// The renderer.
    pub mode: Mode,
    /// Its sampling distance, voxels.
    pub step: f32,
}

impl ComparisonSide {
    /// The scene as this side renders it.
    pub fn scene(&self, scene: &Scene) -> Scene {
        let mut scene = scene.clone();
        scene.render.mode = self.mode;
        scene.render.step = self.step;
        scene.render.antialias = Antialias::OFF;
        scene
    }

    /// Its label.
    pub fn words(&self) -> String {
        format!("{} step {}", word(self.mode), (self.step * 100.0).round() / 100.0)
    }
}

pub(in crate::gui) fn word(mode: Mode) -> &'static str {
    match mode {
        Mode::Slice => "slicing",
        Mode::Raycast => "raycast",
        Mode::Surface => "SDF",
    }
}

/// How the two sides are arranged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Arrangement {
    /// Side by side.
    #[default]
    Split,
    /// One over the other, divided by a movable line.
    Swipe,
    /// The difference of the two pictures.
    Difference,
}

#[derive(Default)]
pub(in crate::gui) struct PaneResult {
    pub(in crate::gui) texture: Option<TextureHandle>,
    /// The side that was rendered.
    pub(in crate::gui) side: Option<ComparisonSide>,
    pub(in crate::gui) delay: OutdatedNotice,
    pub(in crate::gui) picture: Option<Arc<Picture>>,
    pub(in crate::gui) stats: Option<RenderStats>,
    pub(in crate::gui) ms: f64,
    pub(in crate::gui) backend: String,
    pub(in crate::gui) serial: u64,
}

/// State of the comparison panel.
pub struct ComparePanel {
    /// The two sides.
    pub sides: [ComparisonSide; 2],
    /// Their arrangement.
    pub arrangement: Arrangement,
    pub(in crate::gui) swipe: f32,
    pub(in crate::gui) results: [PaneResult; 2],
    pub(in crate::gui) requested: [Option<Arc<Scene>>; 2],
    pub(in crate::gui) requested_sides: [Option<ComparisonSide>; 2],
    pub(in crate::gui) assets: Option<Arc<Assets>>,
    /// The scene has changed since the pair was requested.
    pub(in crate::gui) behind: bool,
    pub(in crate::gui) changed_at: Instant,
    pub(in crate::gui) serials: [u64; 2],
    /// Difference of the current pair.
    pub difference: Option<Difference>,
    pub(in crate::gui) difference_of: (u64, u64),
    pub(in crate::gui) difference_open: bool,
    pub(in crate::gui) difference_texture: Option<TextureHandle>,
    pub(in crate::gui) rect: Rect,
    pub(in crate::gui) pane: [u32; 2],
    pub(in crate::gui) was_drawn: bool,
    pub(in crate::gui) wiping: bool,
}

impl Default for ComparePanel {
    fn default() -> Self {
        Self {
            sides: [
                ComparisonSide {
                    mode: Mode::Slice,
                    step: 1.0,
                },
                ComparisonSide {
                    mode: Mode::Raycast,
                    step: 1.0,
                },
            ],
            arrangement: Arrangement::Split,
            swipe: 0.5,
            results: Default::default(),
            requested: [None, None],
            requested_sides: [None; 2],
            assets: None,
            behind: false,
            changed_at: Instant::now(),
            serials: [0; 2],
            difference: None,
            difference_of: (0, 0),
            difference_open: false,
            difference_texture: None,
            rect: Rect::ZERO,
            pane: [0; 2],
            was_drawn: false,
            wiping: false,
        }
    }
}

impl ComparePanel {
    /// Discards all results, so that they are requested again.
    pub fn forget(&mut self) {
        *self = Self {
            sides: self.sides,
            arrangement: self.arrangement,
            swipe: self.swipe,
            ..Self::default()
        };
    }

    /// Handles a side that could not be rendered.
    pub fn failed(&mut self, side: usize, serial: u64, problem: &str) {
        if self.serials.get(side) == Some(&serial) {
            self.results[side].delay.failure = Some(problem.to_owned());
        }
    }

    pub(in crate::gui) fn is_current(&self, side: usize) -> bool {
        !self.behind && self.serials[side] > 0 && self.results[side].serial == self.serials[side]
    }

    /// Whether both pictures and their difference are up to date.
    pub fn is_done(&self) -> bool {
        self.difference.is_some() && !self.difference_open && (0..2).all(|n| self.is_current(n))
    }
}
