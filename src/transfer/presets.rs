//! Presets under commonly used names. The tables are our own.
//!
//! CT presets are in Hounsfield units. MR and other modalities have no absolute scale: their
//! presets are fractions of the object's values, from the background's median (0) to the 99.8th
//! percentile of the object (1), so that a few bright voxels (a vessel, an artefact) do not darken
//! everything else. A curve that would begin in the background begins where the object does
//! ([`Foreground`]).

use super::{Blend, ControlPoint, GradientPoint, RelativeTo, TransferFunction};
use crate::volume::{Foreground, Volume};

/// The scale of a preset's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Data units as they are.
    Absolute,
    /// 0 = the background, 1 = the object's robust maximum.
    Relative,
}

/// A named transfer function.
pub struct Preset {
    /// The name that users type.
    pub name: &'static str,
    /// One line for lists.
    pub about: &'static str,
    /// The scale of the values.
    pub scale: Scale,
    /// How samples blend.
    pub blend: Blend,
    /// Value, colour (0..255), opacity.
    points: &'static [(f64, [u8; 3], f32)],
    /// Gradient magnitude (same scale, per mm) and factor.
    gradient: &'static [(f64, f32)],
}

use Blend::{Average, Composite, Minip, Mip};
use Scale::{Absolute, Relative};

const BONE: [u8; 3] = [240, 228, 202];
const BONE_DARK: [u8; 3] = [196, 160, 118];
const SKIN: [u8; 3] = [222, 176, 150];
const MUSCLE: [u8; 3] = [176, 76, 66];
const FAT: [u8; 3] = [232, 206, 140];
const VESSEL: [u8; 3] = [208, 42, 36];
const BLACK: [u8; 3] = [0, 0, 0];
const WHITE: [u8; 3] = [255, 255, 255];

macro_rules! preset {
    ($name:literal, $about:literal, $scale:ident, $blend:ident, [$($p:expr),* $(,)?]) => { preset!($name, $about, $scale, $blend, [$($p),*], []) };
    ($name:literal, $about:literal, $scale:ident, $blend:ident, [$($p:expr),* $(,)?], [$($g:expr),*]) => {
        Preset { name: $name, about: $about, scale: $scale, blend: $blend, points: &[$($p),*], gradient: &[$($g),*] }
    };
}

/// The preset of volumes whose voxels have colours of their own.
pub const OWN_COLORS: &str = "color";
/// The preset of label maps.
const LABELS: &str = "labels";

const PRESETS: &[Preset] = &[
    preset!(
        "color",
        "RGB voxels in their own colours; opacity from brightness, or from alpha if present",
        Absolute,
        Composite,
        [
            (0.0, WHITE, 0.0),
            (0.06, WHITE, 0.0),
            (0.3, WHITE, 0.35),
            (0.7, WHITE, 0.8),
            (1.0, WHITE, 0.95)
        ]
    ),
    preset!(
        "ct-bone",
        "bone, opaque, marrow darker than cortex",
        Absolute,
        Composite,
        [
            (150.0, BONE_DARK, 0.0),
            (220.0, BONE_DARK, 0.25),
            (450.0, BONE, 0.75),
            (1200.0, [252, 248, 238], 0.95),
            (3000.0, WHITE, 0.95)
        ]
    ),
    preset!(
        "ct-bones-and-muscle",
        "bone inside translucent muscle",
        Absolute,
        Composite,
        [
            (-20.0, MUSCLE, 0.0),
            (40.0, MUSCLE, 0.06),
            (130.0, [186, 92, 70], 0.08),
            (220.0, BONE_DARK, 0.35),
            (600.0, BONE, 0.85),
            (2500.0, WHITE, 0.95)
        ]
    ),
    preset!(
        "ct-skin",
        "skin surface",
        Absolute,
        Composite,
        [
            (-400.0, SKIN, 0.0),
            (-180.0, SKIN, 0.55),
            (60.0, [236, 196, 170], 0.9),
            (1500.0, BONE, 0.95)
        ]
    ),
    preset!(
        "ct-soft-tissue",
        "fat, muscle and organs, opaque",
        Absolute,
        Composite,
        [
            (-160.0, FAT, 0.0),
            (-90.0, FAT, 0.25),
            (-20.0, [206, 130, 96], 0.45),
            (50.0, MUSCLE, 0.7),
            (140.0, [214, 120, 96], 0.8),
            (300.0, BONE, 0.9),
            (1500.0, WHITE, 0.95)
        ]
    ),
    preset!(
        "ct-muscle",
        "muscle without fat",
        Absolute,
        Composite,
        [
            (-10.0, MUSCLE, 0.0),
            (25.0, MUSCLE, 0.45),
            (70.0, [196, 88, 74], 0.75),
            (180.0, [220, 150, 120], 0.7),
            (350.0, BONE, 0.9)
        ]
    ),
    preset!(
        "ct-fat",
        "subcutaneous and visceral fat",
        Absolute,
        Composite,
        [
            (-190.0, FAT, 0.0),
            (-120.0, FAT, 0.35),
            (-70.0, FAT, 0.35),
            (-30.0, FAT, 0.0)
        ]
    ),
    preset!(
        "ct-lung",
        "airways and lung parenchyma",
        Absolute,
        Composite,
        [
            (-980.0, [94, 128, 170], 0.0),
            (-900.0, [120, 160, 200], 0.015),
            (-700.0, [206, 170, 160], 0.05),
            (-450.0, [220, 150, 130], 0.12),
            (-200.0, [210, 120, 110], 0.0),
            (150.0, BONE_DARK, 0.0),
            (400.0, BONE, 0.3)
        ]
    ),
    preset!(
        "ct-airways",
        "tracheobronchial tree",
        Absolute,
        Composite,
        [
            (-1000.0, [70, 190, 220], 0.0),
            (-960.0, [90, 200, 226], 0.12),
            (-900.0, [150, 220, 236], 0.10),
            (-820.0, [150, 220, 236], 0.0)
        ]
    ),
    preset!(
        "ct-vessels",
        "contrast-enhanced vessels and bone",
        Absolute,
        Composite,
        [
            (110.0, VESSEL, 0.0),
            (170.0, VESSEL, 0.35),
            (280.0, [224, 88, 60], 0.7),
            (420.0, BONE, 0.8),
            (1200.0, WHITE, 0.95)
        ]
    ),
    preset!(
        "ct-angio",
        "vessels without soft tissue",
        Absolute,
        Composite,
        [
            (140.0, [150, 20, 24], 0.0),
            (220.0, VESSEL, 0.5),
            (340.0, [240, 150, 110], 0.75),
            (600.0, [250, 226, 196], 0.85)
        ]
    ),
    preset!(
        "ct-aorta-stent",
        "contrast, calcium and metal in separate colours",
        Absolute,
        Composite,
        [
            (130.0, VESSEL, 0.0),
            (200.0, VESSEL, 0.2),
            (420.0, [220, 100, 80], 0.35),
            (650.0, BONE, 0.7),
            (1400.0, [170, 196, 220], 0.95),
            (3000.0, [220, 234, 250], 0.98)
        ]
    ),
    preset!(
        "ct-liver",
        "liver parenchyma in the portal venous phase",
        Absolute,
        Composite,
        [
            (20.0, [140, 70, 56], 0.0),
            (70.0, [150, 74, 60], 0.25),
            (130.0, [196, 104, 80], 0.5),
            (220.0, [232, 170, 130], 0.6),
            (400.0, BONE, 0.8)
        ]
    ),
    preset!(
        "ct-teeth",
        "enamel and dense bone",
        Absolute,
        Composite,
        [
            (900.0, BONE_DARK, 0.0),
            (1300.0, BONE, 0.6),
            (2000.0, WHITE, 0.95)
        ]
    ),
    preset!(
        "ct-metal",
        "implants, wires, clips",
        Absolute,
        Composite,
        [
            (1600.0, [130, 150, 176], 0.0),
            (2200.0, [168, 190, 214], 0.8),
            (3000.0, [226, 236, 248], 0.98)
        ]
    ),
    preset!(
        "ct-mip",
        "maximum intensity projection",
        Absolute,
        Mip,
        [
            (-100.0, BLACK, 0.0),
            (100.0, [64, 64, 64], 0.9),
            (800.0, WHITE, 1.0)
        ]
    ),
    preset!(
        "ct-minip",
        "minimum intensity projection, for airways",
        Absolute,
        Minip,
        [(-1000.0, BLACK, 1.0), (-400.0, WHITE, 1.0)]
    ),
    preset!(
        "ct-xray",
        "average intensity projection, like a radiograph",
        Absolute,
        Average,
        [
            (-900.0, BLACK, 0.0),
            (-300.0, [120, 120, 120], 0.8),
            (300.0, WHITE, 1.0)
        ]
    ),
    preset!(
        "mr-default",
        "skin to brain, opaque",
        Relative,
        Composite,
        [
            (0.12, [210, 150, 124], 0.0),
            (0.22, [210, 150, 124], 0.8),
            (0.40, [204, 142, 122], 0.95),
            (0.55, [226, 194, 176], 0.97),
            (0.75, [246, 236, 224], 0.98),
            (1.0, [255, 252, 246], 0.98)
        ]
    ),
    preset!(
        "mr-brain",
        "grey and white matter of a skull-stripped brain",
        Relative,
        Composite,
        [
            (0.22, [150, 90, 82], 0.0),
            (0.36, [196, 138, 124], 0.5),
            (0.62, [222, 186, 168], 0.85),
            (0.85, [246, 236, 222], 0.95)
        ]
    ),
    preset!(
        "mr-t2-brain",
        "bright fluid, translucent tissue",
        Relative,
        Composite,
        [
            (0.18, [90, 70, 80], 0.0),
            (0.35, [170, 130, 120], 0.05),
            (0.6, [200, 180, 180], 0.12),
            (0.85, [120, 170, 230], 0.6),
            (1.0, [190, 220, 255], 0.9)
        ]
    ),
    preset!(
        "mr-angio",
        "bright-blood vessels (time-of-flight MRA)",
        Relative,
        Composite,
        [
            (0.38, [140, 20, 20], 0.0),
            (0.55, VESSEL, 0.35),
            (0.8, [240, 130, 96], 0.8),
            (1.0, [255, 226, 200], 0.95)
        ]
    ),
    preset!(
        "mr-skin",
        "skin surface of the head",
        Relative,
        Composite,
        [(0.06, SKIN, 0.0), (0.14, SKIN, 0.6), (0.3, [236, 196, 170], 0.95)]
    ),
    preset!(
        "mr-translucent",
        "edges only: opacity by gradient",
        Relative,
        Composite,
        [
            (0.08, [110, 130, 170], 0.0),
            (0.25, [180, 160, 150], 0.15),
            (0.6, [230, 210, 190], 0.3),
            (1.0, WHITE, 0.4)
        ],
        [(0.0, 0.0), (0.02, 0.05), (0.10, 1.0)]
    ),
    preset!(
        "mr-mip",
        "maximum intensity projection",
        Relative,
        Mip,
        [(0.05, BLACK, 0.0), (0.4, [90, 90, 90], 0.9), (1.0, WHITE, 1.0)]
    ),
    preset!(
        "pet-hot",
        "tracer uptake on a hot-metal colour scale",
        Relative,
        Composite,
        [
            (0.12, BLACK, 0.0),
            (0.3, [120, 10, 0], 0.05),
            (0.55, [230, 90, 0], 0.25),
            (0.8, [255, 200, 40], 0.6),
            (1.0, WHITE, 0.9)
        ]
    ),
    preset!(
        "grey",
        "linear greyscale ramp",
        Relative,
        Composite,
        [(0.0, BLACK, 0.0), (0.5, [128, 128, 128], 0.25), (1.0, WHITE, 0.5)]
    ),
    preset!(
        "labels",
        "label map, coloured by fractions of its value range",
        Relative,
        Composite,
        [
            (0.0, [200, 120, 100], 0.0),
            (0.002, [226, 126, 98], 0.85),
            (0.2, [232, 186, 92], 0.85),
            (0.4, [120, 176, 110], 0.85),
            (0.6, [88, 164, 190], 0.85),
            (0.8, [120, 118, 196], 0.85),
            (1.0, [196, 112, 168], 0.85)
        ]
    ),
    preset!(
        "checker",
        "the checker phantom's two values",
        Absolute,
        Composite,
        [
            (0.0, [60, 92, 140], 0.97),
            (135.0, [60, 92, 140], 0.97),
            (165.0, [238, 222, 190], 0.97),
            (255.0, [238, 222, 190], 0.97)
        ]
    ),
    preset!(
        "octants",
        "labels 1 to 8, each its own colour",
        Absolute,
        Composite,
        [
            (0.0, [230, 120, 90], 0.0),
            (0.5, [230, 120, 90], 0.0),
            (0.55, [230, 120, 90], 0.97),
            (1.45, [230, 120, 90], 0.97),
            (1.55, [240, 190, 90], 0.97),
            (2.45, [240, 190, 90], 0.97),
            (2.55, [150, 190, 90], 0.97),
            (3.45, [150, 190, 90], 0.97),
            (3.55, [90, 170, 150], 0.97),
            (4.45, [90, 170, 150], 0.97),
            (4.55, [90, 150, 210], 0.97),
            (5.45, [90, 150, 210], 0.97),
            (5.55, [140, 120, 200], 0.97),
            (6.45, [140, 120, 200], 0.97),
            (6.55, [210, 120, 170], 0.97),
            (7.45, [210, 120, 170], 0.97),
            (7.55, [200, 170, 140], 0.97),
            (8.45, [200, 170, 140], 0.97),
        ]
    ),
    preset!(
        "piggy-bank",
        "the piggy bank phantom: ceramic and coins",
        Absolute,
        Composite,
        [
            (0.0, [226, 176, 64], 0.98),
            (60.0, [226, 176, 64], 0.9),
            (95.0, [226, 176, 64], 0.0),
            (158.0, [226, 132, 138], 0.0),
            (190.0, [228, 136, 142], 0.9),
            (255.0, [236, 146, 152], 0.98)
        ]
    ),
    preset!(
        "tomato",
        "the tomato phantom: gel, seeds, flesh, skin",
        Absolute,
        Composite,
        [
            (40.0, [176, 148, 40], 0.25),
            (65.0, [190, 158, 48], 0.3),
            (85.0, [240, 222, 150], 0.95),
            (108.0, [240, 222, 150], 0.95),
            (135.0, [232, 104, 70], 0.9),
            (165.0, [222, 72, 48], 0.95),
            (192.0, [196, 24, 18], 0.97),
            (225.0, [204, 28, 22], 0.9),
            (240.0, [204, 28, 22], 0.0)
        ]
    ),
    preset!(
        "teddy",
        "the teddy phantom: cloth, stuffing, buttons",
        Absolute,
        Composite,
        [
            (22.0, [70, 40, 26], 0.0),
            (34.0, [84, 50, 32], 0.75),
            (60.0, [96, 58, 36], 0.9),
            (80.0, [158, 104, 60], 0.95),
            (125.0, [168, 112, 66], 0.95),
            (140.0, [196, 170, 128], 0.92),
            (175.0, [226, 208, 172], 0.94),
            (215.0, [252, 246, 232], 0.95)
        ]
    ),
    preset!(
        "phantom-solid",
        "opacity rising with values from 0 to 1",
        Absolute,
        Composite,
        [
            (0.25, [200, 170, 130], 0.0),
            (0.75, [226, 206, 172], 0.95),
            (1.0, [226, 206, 172], 0.95)
        ]
    ),
];

/// All presets.
pub fn list() -> impl Iterator<Item = &'static Preset> {
    PRESETS.iter()
}

/// The preset with a name.
pub fn preset(name: &str) -> Option<&'static Preset> {
    PRESETS.iter().find(|p| p.name == name)
}

impl Preset {
    /// Whether the curve follows the volume: by fractions of its values, or by Hounsfield units,
    /// which may be shifted.
    pub fn depends_on_volume(&self) -> bool {
        self.scale == Scale::Relative || self.is_ct()
    }

    fn is_ct(&self) -> bool {
        self.name.starts_with("ct-")
    }

    /// The curve in a volume's data units.
    pub fn adapted_to(&self, volume: &Volume, relative_to: RelativeTo) -> TransferFunction {
        let [low, span] = self.scale_for(volume, relative_to);
        let mut points: Vec<ControlPoint> = self
            .points
            .iter()
            .map(|&(value, color, opacity)| ControlPoint {
                value: low + value * span,
                color: color.map(|c| f32::from(c) / 255.0),
                opacity,
            })
            .collect();
        if self.scale == Scale::Relative
            && self.name != LABELS
            && relative_to == RelativeTo::Object
            && let Some(object) = volume.foreground()
        {
            start_at_object(&mut points, &object);
        }
        if span < 0.0 {
            points.reverse();
        }
        let gradient_opacity = self
            .gradient
            .iter()
            .map(|&(m, factor)| GradientPoint {
                magnitude: m * span.abs(),
                factor,
            })
            .collect();
        TransferFunction {
            points,
            gradient_opacity,
            blend: self.blend,
        }
    }

    /// The data value of the preset's 0, and data units per unit of the preset.
    fn scale_for(&self, volume: &Volume, relative_to: RelativeTo) -> [f64; 2] {
        let [lowest, highest] = volume.range;
        match self.scale {
            // Luminance or opacity over the whole range of its type, even if only part of it is
            // used.
            _ if self.name == OWN_COLORS && volume.colors.is_some() && highest > 1.5 => [0.0, 255.0],
            Scale::Relative if self.name == LABELS => [lowest, highest - lowest],
            Scale::Absolute if relative_to == RelativeTo::Object && self.is_ct() => {
                [volume.hounsfield_zero().unwrap_or(0.0), 1.0]
            }
            Scale::Absolute => [0.0, 1.0],
            Scale::Relative => match volume.foreground().filter(|_| relative_to == RelativeTo::Object) {
                Some(object) => [object.background, object.extreme - object.background],
                // Inverted DICOM images (MONOCHROME1) are bright where values are low.
                None if volume.inverted => {
                    let top = volume.histogram(1024).percentile(0.002, true);
                    [highest, top - highest]
                }
                None => [lowest, volume.histogram(1024).percentile(0.998, true) - lowest],
            },
        }
    }
}

/// Moves the start of a curve to where the object begins, if it lies before it: what is noise or a
/// holder stays transparent. The points beyond move in proportion.
fn start_at_object(points: &mut [ControlPoint], object: &Foreground) {
    let Some(start) = points
        .windows(2)
        .find(|pair| pair[1].opacity > 0.0)
        .map(|pair| pair[0].value)
    else {
        return;
    };
    let depth = |value: f64| (value - object.background) / (object.extreme - object.background);
    let (from, to) = (depth(start), depth(object.threshold));
    if !(from < to && from < 1.0) {
        return;
    }
    for p in points {
        let x = depth(p.value);
        let moved = if x <= from {
            to - (from - x)
        } else {
            to + (x - from) * (1.0 - to) / (1.0 - from)
        };
        p.value = object.background + moved * (object.extreme - object.background);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn names_are_unique_and_curves_sorted() {
        let names: HashSet<_> = list().map(|p| p.name).collect();
        assert_eq!(names.len(), PRESETS.len());
        assert!(PRESETS.len() >= 20);
        for p in PRESETS {
            assert!(p.points.windows(2).all(|w| w[0].0 <= w[1].0), "{}", p.name);
            assert!(p.points.iter().all(|q| (0.0..=1.0).contains(&q.2)), "{}", p.name);
        }
    }
}
