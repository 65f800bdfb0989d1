//! The description of a TIFF's pages, whatever states it, and units of length.

use super::super::image::{Channel, Meaning};
use crate::volume::Rescale;

/// A run of planes, as an element TiffData states it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct PlaneBlock {
    /// Page of the first plane.
    pub page: usize,
    /// Slice, channel and time of the first plane.
    pub first: [usize; 3],
    /// Number of planes; all pages if it is not stated.
    pub count: Option<usize>,
    /// Name and UUID of the file that holds them.
    pub file: Option<String>,
    pub uuid: Option<String>,
}

/// Where a description comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum DescriptionKind {
    #[default]
    Plain,
    Ome,
    ImageJ,
    /// tifffile's JSON.
    Shaped,
    Lsm,
    Stk,
}

/// A description of the pages.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Description {
    pub kind: DescriptionKind,
    /// Slices, channels, times.
    pub extents: Option<[usize; 3]>,
    /// Which of slices (0), channels (1) and times (2) varies fastest, then next.
    pub order: [usize; 3],
    /// mm, along x, y, z.
    pub spacing: [Option<f64>; 3],
    pub colors: Vec<Option<[u8; 3]>>,
    pub channel_names: Vec<String>,
    /// Value = slope · stored + intercept.
    pub rescale: Option<Rescale>,
    /// UUID of the file, and the places of its planes; empty if they are in order.
    pub uuid: Option<String>,
    pub planes: Vec<PlaneBlock>,
    /// Whether another TIFF holds the description.
    pub is_of_other_file: bool,
    pub notices: Vec<String>,
    /// The resolution that is not used, as a sentence.
    pub unused_resolution: Option<String>,
}

impl Description {
    pub fn new(kind: DescriptionKind) -> Self {
        Self {
            kind,
            order: [0, 1, 2],
            ..Self::default()
        }
    }

    /// Slices, channels and times of `total` pages with `samples` values per pixel: the declared
    /// ones if they fit, else slices only.
    pub fn extents_of(&mut self, total: usize, samples: usize) -> [usize; 3] {
        let Some(mut e) = self.extents else {
            return [total, 1, 1];
        };
        let planes = |e: [usize; 3]| e.iter().try_fold(1usize, |n, &d| n.checked_mul(d));
        // OME-XML may count the samples of a pixel as channels without saying so.
        if self.kind == DescriptionKind::Ome && planes(e) != Some(total) && e[1].is_multiple_of(samples) {
            let merged = [e[0], e[1] / samples, e[2]];
            if planes(merged) == Some(total) {
                e = merged;
            }
        }
        let declared = planes(e);
        let is_placed = self.planes.iter().any(|b| b.count.is_some() || b.file.is_some());
        if declared == Some(total) || total == 1 && self.may_be_contiguous() || is_placed {
            return e;
        }
        if self.kind != DescriptionKind::Shaped {
            self.notices.push(format!(
                "contains {total} pages, not the {} x {} x {} it declares; they are read as slices",
                e[0], e[1], e[2]
            ));
        }
        self.planes.clear();
        [total, 1, 1]
    }

    /// Whether a single directory may be followed by the pixels of further planes.
    pub fn may_be_contiguous(&self) -> bool {
        matches!(
            self.kind,
            DescriptionKind::ImageJ | DescriptionKind::Shaped | DescriptionKind::Stk
        )
    }

    /// Name of the format.
    pub fn format(&self) -> &'static str {
        match self.kind {
            DescriptionKind::Ome => "OME-TIFF",
            DescriptionKind::ImageJ => "ImageJ TIFF",
            DescriptionKind::Lsm => "LSM",
            DescriptionKind::Stk => "MetaMorph STK",
            DescriptionKind::Plain | DescriptionKind::Shaped => "TIFF",
        }
    }

    /// The meaning of the values with these channels and components.
    pub fn meaning(&self, channels: usize, components: usize, is_color: bool) -> Meaning {
        if is_color && channels == 1 {
            return Meaning::Color;
        }
        if components == 1 {
            return Meaning::Unstated;
        }
        let color = |c: usize| {
            let stated = self.colors.get(c).copied().flatten();
            stated.unwrap_or(super::super::super::colors::CHANNELS[c % 4])
        };
        Meaning::Channels(
            (0..components)
                .map(|c| Channel {
                    color: color(c),
                    window: None,
                })
                .collect(),
        )
    }
}

/// Millimetres per unit of length.
pub(in crate::volume::load) fn mm_of(unit: &str) -> Option<f64> {
    Some(match unit.trim().to_lowercase().as_str() {
        "km" | "kilometer" | "kilometre" => 1e6,
        "m" | "meter" | "metre" => 1000.0,
        "dm" | "decimeter" | "decimetre" => 100.0,
        "cm" | "centimeter" | "centimetre" => 10.0,
        "mm" | "millimeter" | "millimetre" | "millimeters" | "millimetres" => 1.0,
        "um" | "µm" | "μm" | "micron" | "microns" | "micrometer" | "micrometre" | "micrometers"
        | "micrometres" => 1e-3,
        "nm" | "nanometer" | "nanometre" | "nanometers" | "nanometres" => 1e-6,
        "angstrom" | "å" => 1e-7,
        "pm" | "picometer" | "picometre" => 1e-9,
        "inch" | "in" => 25.4,
        "foot" | "ft" => 304.8,
        "yard" | "yd" => 914.4,
        _ => return None,
    })
}
