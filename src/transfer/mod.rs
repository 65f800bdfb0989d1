//! Transfer functions: colour and opacity by value, optionally opacity by gradient magnitude, and
//! the blend mode along a ray.
//!
//! Control points are in data units (Hounsfield units for CT). Opacity is stated for one reference
//! length, Δ₀ = the smallest voxel spacing. The table holds it as optical depth, τ = -log₂(1 -
//! opacity), so that a sample that represents a length ℓ has the opacity 1 - 2^(-τ ℓ/Δ₀): the
//! opacity correction of [`crate::model`], "Opacity and compositing", with one exponential.

mod preintegrated;
mod presets;
mod step_error;
mod suitable;
mod table;

pub use preintegrated::{PREINTEGRATED_SIZE, Preintegrated};
pub use presets::{OWN_COLORS, Preset, Scale, list, preset};
pub use step_error::single_value_error;
pub use suitable::{SuitablePreset, suitable_preset};
pub use table::{GRADIENT_ENTRIES, TABLE_ENTRIES, TransferTable};

use crate::volume::Volume;
use crate::{Error, Result, error::suggestion};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How the samples along a ray are combined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Blend {
    /// Compositing with emission and absorption.
    #[default]
    Composite,
    /// Maximum intensity projection, coloured by the transfer function.
    Mip,
    /// Minimum intensity projection inside the volume, coloured by the transfer function.
    Minip,
    /// Average intensity projection inside the volume, coloured by the transfer function.
    Average,
}

/// Colour and opacity at one data value; linear between points, constant beyond the outermost.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ControlPoint {
    /// Data value.
    pub value: f64,
    /// Red, green, blue in 0..1.
    pub color: [f32; 3],
    /// Opacity of one voxel's length, 0..1.
    pub opacity: f32,
}

/// Opacity factor at one gradient magnitude.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GradientPoint {
    /// Gradient magnitude, data units per millimetre.
    pub magnitude: f64,
    /// Factor on the optical depth, 0..1.
    pub factor: f32,
}

/// What the values of presets without an absolute scale are fractions of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum RelativeTo {
    /// The object's values: the background is found and left out.
    #[default]
    Object,
    /// All values, from the lowest one to the 99.8th percentile.
    Range,
}

/// The `[transfer]` section of a scene: a preset, changes to it, or a curve of its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TransferSettings {
    /// Name of a preset; without one, chosen for the volume.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<String>,
    /// What the values of presets without an absolute scale (mr-default and others) are fractions
    /// of.
    #[serde(skip_serializing_if = "is_default")]
    pub relative_to: RelativeTo,
    /// Window width: the range of values that the curve spans, data units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub window: Option<f64>,
    /// Window level: the centre of that range, data units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub level: Option<f64>,
    /// Density: factor on the optical depth of the control points (1 = unchanged).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub density: Option<f64>,
    /// Control points of a custom curve, instead of the preset's.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<ControlPoint>,
    /// Opacity by gradient magnitude.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub gradient_opacity: Vec<GradientPoint>,
    /// Whether RGB voxels show their own colour; by default if no preset is named, or the preset is
    /// "color".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub own_colors: Option<bool>,
    /// Blend mode instead of the preset's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub blend: Option<Blend>,
}

fn is_default(relative_to: &RelativeTo) -> bool {
    *relative_to == RelativeTo::default()
}

/// A resolved transfer function, in data units.
#[derive(Clone, Debug, PartialEq)]
pub struct TransferFunction {
    /// Control points by ascending value; at least one.
    pub points: Vec<ControlPoint>,
    /// By ascending magnitude; empty if unused.
    pub gradient_opacity: Vec<GradientPoint>,
    /// How samples blend.
    pub blend: Blend,
}

impl TransferSettings {
    /// Resolves preset, window and curve for a volume. `fallback` is the preset used if none is
    /// named.
    ///
    /// # Errors
    /// An unknown preset; a window that is not positive; points that are not finite, not ascending
    /// or outside 0..1.
    pub fn resolve(&self, volume: &Volume, fallback: &str) -> Result<TransferFunction> {
        let name = self.preset.as_deref().unwrap_or(fallback);
        let preset = preset(name).ok_or_else(|| {
            Error::value(
                "preset",
                format!(
                    "there is no preset \"{name}\"; {}",
                    suggestion(name, list().map(|p| p.name))
                ),
            )
        })?;
        let mut function = if self.points.is_empty() {
            preset.adapted_to(volume, self.relative_to)
        } else {
            TransferFunction {
                points: self.points.clone(),
                gradient_opacity: Vec::new(),
                blend: preset.blend,
            }
        };
        if !self.gradient_opacity.is_empty() {
            function.gradient_opacity.clone_from(&self.gradient_opacity);
        }
        if let Some(blend) = self.blend {
            function.blend = blend;
        }
        check(&function)?;
        if let Some(density) = self.density {
            if !(0.0..=1000.0).contains(&density) {
                return Err(Error::value(
                    "transfer.density",
                    format!("{density} is outside 0 to 1000"),
                ));
            }
            for p in &mut function.points {
                p.opacity = 1.0 - (1.0 - p.opacity).powf(density as f32);
            }
        }
        function.set_window(self.window, self.level)?;
        Ok(function)
    }
}

fn check(function: &TransferFunction) -> Result<()> {
    let unit = |x: f32| (0.0..=1.0).contains(&x);
    let p = &function.points;
    for (n, point) in p.iter().enumerate() {
        if !point.value.is_finite() || !unit(point.opacity) || !point.color.iter().all(|&c| unit(c)) {
            return Err(Error::value(
                format!("transfer.points[{n}]"),
                "values must be finite, colour and opacity within 0..1",
            ));
        }
        if n > 0 && p[n - 1].value > point.value {
            return Err(Error::value(
                format!("transfer.points[{n}]"),
                format!(
                    "value {} is lower than the one before it; sort the points by value",
                    point.value
                ),
            ));
        }
    }
    let g = &function.gradient_opacity;
    for (n, point) in g.iter().enumerate() {
        if !(point.magnitude.is_finite() && point.magnitude >= 0.0 && unit(point.factor)) {
            return Err(Error::value(
                format!("transfer.gradient_opacity[{n}]"),
                "the magnitude must be finite and not negative, the factor within 0..1",
            ));
        }
        if n > 0 && g[n - 1].magnitude > point.magnitude {
            return Err(Error::value(
                format!("transfer.gradient_opacity[{n}]"),
                "sort the points by magnitude",
            ));
        }
    }
    Ok(())
}

impl TransferFunction {
    /// Lowest and highest control value, data units.
    pub fn domain(&self) -> [f64; 2] {
        let first = self.points.first().map_or(0.0, |p| p.value);
        let last = self.points.last().map_or(1.0, |p| p.value);
        [first, last]
    }

    /// The transfer function for the presence (0 to 1) of labels in a label map: transparent below
    /// one half, this function's highest opacity above. `smooth`: presence is continuous.
    pub fn of_presence(&self, smooth: bool) -> Self {
        let [none, one] = if smooth { SMOOTH_PRESENCE } else { PRESENCE };
        let opacity = self.points.iter().map(|p| p.opacity).fold(0.0, f32::max);
        let point = |value, opacity| ControlPoint {
            value,
            color: [1.0; 3],
            opacity,
        };
        Self {
            points: vec![point(none, 0.0), point(one, opacity)],
            gradient_opacity: Vec::new(),
            blend: self.blend,
        }
    }

    /// Maps the curve's domain onto `level ± window/2`; a missing window or level keeps its value.
    fn set_window(&mut self, window: Option<f64>, level: Option<f64>) -> Result<()> {
        if window.is_none() && level.is_none() {
            return Ok(());
        }
        let [low, high] = self.domain();
        let width = window.unwrap_or(high - low);
        let middle = level.unwrap_or((low + high) / 2.0);
        if !(width.is_finite() && width > 0.0) {
            return Err(Error::value(
                "window",
                format!("{width} is not a positive window width in data units"),
            ));
        }
        if !middle.is_finite() {
            return Err(Error::value("level", "must be a finite data value"));
        }
        let span = if high > low { high - low } else { 1.0 };
        for p in &mut self.points {
            p.value = middle - width / 2.0 + (p.value - low) / span * width;
        }
        Ok(())
    }
}

/// Range of presence over which a label becomes visible: narrow around one half, so that surfaces
/// lie between voxels.
const PRESENCE: [f64; 2] = [0.4, 0.6];
/// The same where it is continuous: no voxel without a label exceeds 126/254.
const SMOOTH_PRESENCE: [f64; 2] = [0.498, 0.502];
