//! Paints a section as a picture: grey values by window and level, with overlays of labels, a grid,
//! masks, or det J.

use crate::cpu::section::Section;
use crate::prepare::Assets;
use crate::volume::Colors;
use eframe::egui::{Color32, ColorImage};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// The overlay on the grey values of a slice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Overlay {
    /// Nothing.
    #[default]
    None,
    /// Regions of the label map, in their colours.
    Labels,
    /// A grid that is straight in the source.
    Grid,
    /// Arrows from source to deformed positions.
    Glyphs,
    /// The regions that the masks cut away.
    Mask,
    /// det J of the backward map: folds, compression, stretching.
    Jacobian,
}

/// How a slice is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SliceStyle {
    /// Data values shown as black and as white.
    pub window: [f64; 2],
    /// The overlay.
    pub overlay: Overlay,
    /// Show the source instead of the deformed scene.
    pub source: bool,
}

/// Spacing of the grid's lines in the source, mm.
const GRID_MM: f32 = 10.0;

/// Paints a section.
pub fn paint(section: &Section, assets: &Assets, style: SliceStyle) -> ColorImage {
    let [width, height] = section.plane.size.map(|n| n as usize);
    let [low, high] = style.window.map(|v| v as f32);
    let span = (high - low).max(f32::MIN_POSITIVE);
    let inverted = assets.volume.inverted;
    let labels = Regions::new(assets);
    // Grey values are meaningless for a volume of labels.
    let own_labels = assets.separate_labels.is_none() && labels.is_some();
    let grey = |n: usize| -> Color32 {
        let value = section.values[n];
        if value.is_nan() {
            return crate::gui::theme::CANVAS;
        }
        if own_labels {
            return labels
                .as_ref()
                .and_then(|l| l.color(section.sources[n]))
                .map_or(Color32::BLACK, |[r, g, b]| Color32::from_rgb(r, g, b));
        }
        let share = ((value - low) / span).clamp(0.0, 1.0);
        let share = if inverted { 1.0 - share } else { share };
        Color32::from_gray((share * 255.0 + 0.5) as u8)
    };
    let mm = section.plane.mm_per_pixel;
    let pixel = |n: usize| -> Color32 {
        let base = grey(n);
        match style.overlay {
            Overlay::None | Overlay::Glyphs => base,
            Overlay::Labels => match labels
                .as_ref()
                .filter(|_| !own_labels && !section.values[n].is_nan())
                .and_then(|l| l.color(section.sources[n]))
            {
                Some([r, g, b]) => mix(base, Color32::from_rgb(r, g, b), 0.45),
                None => base,
            },
            Overlay::Grid => {
                let (x, y) = (n % width, n / width);
                let line = [
                    (x + 1 < width).then(|| n + 1),
                    (y + 1 < height).then(|| n + width),
                ]
                .into_iter()
                .flatten()
                .any(|m| crosses(section.sources[n], section.sources[m]));
                if line && section.mask[n] >= 0.5 {
                    mix(
                        base,
                        Color32::from_rgb(110, 190, 245),
                        (0.75 * (2.0 / mm).min(1.0)).max(0.4),
                    )
                } else {
                    base
                }
            }
            Overlay::Mask => {
                let cut = ((1.0 - section.mask[n]) * 1.2).clamp(0.0, 1.0);
                mix(base, Color32::from_rgb(240, 140, 60), 0.65 * cut)
            }
            Overlay::Jacobian => match section.determinants.get(n) {
                Some(det) if section.mask[n] >= 0.5 => {
                    let (color, share) = determinant_color(*det);
                    mix(base, color, share)
                }
                _ => base,
            },
        }
    };
    let pixels = (0..width * height).into_par_iter().map(pixel).collect();
    ColorImage::new([width, height], pixels)
}

/// Whether a line of the source grid passes between two source points.
fn crosses(a: Vec3, b: Vec3) -> bool {
    let (i, j) = ((a / GRID_MM).floor(), (b / GRID_MM).floor());
    // A jump (a cut) is not a line.
    i != j && (a - b).length_squared() < GRID_MM * GRID_MM
}

/// Colour and strength for det d source / d deformed: above 1 the volume is compressed (blue),
/// below 1 stretched (yellow), and where it is not positive the field folds (magenta). The three
/// are distinguishable with any colour vision.
pub fn determinant_color(det: f32) -> (Color32, f32) {
    if det <= 0.0 {
        return (Color32::from_rgb(255, 40, 220), 0.85);
    }
    let log = det.log2().clamp(-2.0, 2.0);
    let color = if log > 0.0 {
        Color32::from_rgb(70, 130, 255)
    } else {
        Color32::from_rgb(250, 215, 60)
    };
    (color, 0.7 * (log.abs() / 1.2).min(1.0))
}

fn mix(a: Color32, b: Color32, share: f32) -> Color32 {
    a.lerp_to_gamma(b, share)
}

/// The label map of the assets and its colours.
pub struct Regions<'a> {
    map: &'a crate::volume::Volume,
    voxel_from_world: glam::DAffine3,
    colors: Colors,
}

impl<'a> Regions<'a> {
    /// The regions of the assets, if they have a label map.
    pub fn new(assets: &'a Assets) -> Option<Self> {
        let map = assets.label_map().ok()?;
        let colors = Colors::of_labels(map.voxels.clone(), map.range[1] as usize, &map.label_table);
        Some(Self {
            map,
            voxel_from_world: map.world_from_voxel.inverse(),
            colors,
        })
    }

    /// The label of the voxel nearest to a world point; none outside.
    pub fn label(&self, world: Vec3) -> Option<u32> {
        let v = self.voxel_from_world.transform_point3(world.as_dvec3()).round();
        let inside =
            v.is_finite() && v.cmpge(DVec3::ZERO).all() && (0..3).all(|a| (v[a] as usize) < self.map.size[a]);
        inside.then(|| self.map.value(v.x as usize, v.y as usize, v.z as usize) as u32)
    }

    /// The colour at a world point; none outside all labels.
    pub fn color(&self, world: Vec3) -> Option<[u8; 3]> {
        let label = self.label(world).filter(|l| *l > 0)?;
        self.colors.of_label(label)
    }

    /// A label's name, or its number.
    pub fn name(&self, label: u32) -> String {
        let named = self
            .map
            .label_table
            .iter()
            .find(|l| l.value == label && !l.name.is_empty());
        named.map_or_else(|| format!("label {label}"), |l| l.name.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folds_are_told_from_squeezes_and_stretches() {
        let [fold, squeezed, stretched, still] = [-0.1, 3.0, 0.3, 1.0].map(determinant_color);
        assert!(fold.0 != squeezed.0 && squeezed.0 != stretched.0 && fold.1 > 0.8);
        assert!(squeezed.1 > 0.3 && stretched.1 > 0.3 && still.1 < 1e-3);
    }
}
