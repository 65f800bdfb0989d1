//! An image as a file stores it: typed values, one or several per voxel, and geometry. What the readers of all formats return, and
//! how it becomes a volume that can be shown.

use super::super::colors::{self, Colors, Label};
use super::super::{Rescale, SliceDisplacement, Volume, Voxels};
use super::ReadOptions;
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;
use serde_json::Value;
use std::path::Path;

/// How the components of a voxel lie in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// One whole grid per component.
    Planar,
    /// All components of a voxel together.
    Interleaved,
}

/// What values are, as far as the file says.
#[derive(Clone, Debug, PartialEq)]
pub enum Meaning {
    /// Nothing is said.
    Unstated,
    /// Labels, of which these have names or colours.
    Labels(Vec<Label>),
    /// Red, green, blue and perhaps opacity, over the whole range of their type.
    Color,
    /// Vectors.
    Vectors,
    /// Channels of a microscope and the like.
    Channels(Vec<Channel>),
}

/// How one channel is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Red, green, blue at its brightest.
    pub color: [u8; 3],
    /// Values that are black and brightest; those of the data by default.
    pub window: Option<[f64; 2]>,
}

/// An image of one or several components.
pub struct Image {
    /// Name of the format.
    pub format: &'static str,
    /// Stored values.
    pub voxels: Voxels,
    /// Voxels along i, j, k.
    pub size: [usize; 3],
    /// Values per voxel.
    pub components: usize,
    /// How they lie.
    pub layout: Layout,
    /// What they are.
    pub meaning: Meaning,
    /// Value = slope · stored + intercept.
    pub rescale: Rescale,
    /// Lowest and highest stored value that stand for nothing at all (DICOM's pixel padding).
    pub padding: Option<[f64; 2]>,
    /// High values are dark (DICOM's MONOCHROME1).
    pub inverted: bool,
    /// Voxel indices to world millimetres, LPS.
    pub world_from_voxel: DAffine3,
    /// NIfTI's intent code; 0 for other formats.
    pub intent: i16,
    /// World (LPS) from the axes that vectors are stated in, if the format says.
    pub frame: Option<DMat3>,
    /// The file says that it is a displacement map of this program: four components, the last being the mask.
    pub displacement: bool,
    /// The reader has read the channel that was chosen, and no other.
    pub channel_taken: bool,
    /// Slices that lie elsewhere than on the even grid that they are shown on.
    pub misplaced: Option<SliceDisplacement>,
    /// What else the file says of itself, for `info`.
    pub details: Vec<(&'static str, Value)>,
    /// What was odd, one sentence each.
    pub warnings: Vec<String>,
}

impl Image {
    /// A scalar image of which nothing more is known.
    pub fn new(format: &'static str, voxels: Voxels, size: [usize; 3], world_from_voxel: DAffine3) -> Self {
        Self {
            format,
            voxels,
            size,
            components: 1,
            layout: Layout::Interleaved,
            meaning: Meaning::Unstated,
            rescale: Rescale::NONE,
            padding: None,
            inverted: false,
            world_from_voxel,
            intent: 0,
            frame: None,
            displacement: false,
            channel_taken: false,
            misplaced: None,
            details: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// The image as a volume that can be shown: scalars as they are, colours as colours, a few channels as one colour, vectors by their
    /// direction; or one channel alone.
    ///
    /// # Errors
    /// More components than can be shown together, a channel that does not exist, a range that cannot be represented.
    pub fn into_volume(mut self, path: &Path, choice: &ReadOptions) -> Result<Volume> {
        let source_type = self.voxels.type_name();
        let components = self.components;
        let wanted = choice.channel.filter(|_| !self.channel_taken);
        if let Some(channel) = ReadOptions::index("channel", wanted, components)? {
            self.voxels = self.one_component(channel);
            self.components = 1;
            if !matches!(self.meaning, Meaning::Labels(_)) {
                self.meaning = Meaning::Unstated;
            }
        }
        let mut colors = None;
        if self.components > 1 {
            let (voxels, rgb) = self.colored(path)?;
            (self.voxels, colors) = (voxels, Some(rgb));
            (self.rescale, self.padding) = (Rescale::NONE, None);
        }
        let mut volume = Volume::with_padding(self.voxels, self.size, self.rescale, self.world_from_voxel, self.padding);
        if !(volume.range[1] - volume.range[0]).is_finite() {
            return Err(Error::file(path, "holds values whose range cannot be represented; rescale it"));
        }
        volume.colors = colors;
        volume.components = components;
        volume.source_type = source_type;
        volume.format = self.format;
        volume.inverted = self.inverted;
        volume.misplaced = self.misplaced;
        volume.details = self.details;
        // What is quoted of a file may hold anything.
        volume.warnings = self.warnings.into_iter().map(|w| w.replace(char::is_control, " ")).collect();
        if volume.non_finite > 0 {
            volume.warnings.push(format!("{} voxels are NaN or infinite and are rendered as empty", volume.non_finite));
        }
        if let Meaning::Labels(table) = self.meaning {
            volume.declared_labels = true;
            volume.label_table = table;
        }
        if let Some(spacing) = choice.spacing {
            volume.set_spacing(spacing)?;
        }
        Ok(volume)
    }

    /// Index of component `c` of voxel `v`.
    #[inline(always)]
    fn index(&self, c: usize, v: usize, voxels: usize) -> usize {
        if self.layout == Layout::Planar { c * voxels + v } else { v * self.components + c }
    }

    /// Component `c` of every voxel, as data values.
    pub fn component(&self, c: usize) -> Vec<f32> {
        let n = self.size.iter().product::<usize>();
        let Rescale { slope, intercept } = self.rescale;
        (0..n).into_par_iter().map(|v| (self.voxels.get(self.index(c, v, n)) * slope + intercept) as f32).collect()
    }

    /// Component `c` of every voxel, as it is stored.
    fn one_component(&self, c: usize) -> Voxels {
        let n = self.size.iter().product::<usize>();
        self.voxels.gathered(n, |v| self.index(c, v, n))
    }

    /// One value and one colour for every voxel of several components.
    fn colored(&mut self, path: &Path) -> Result<(Voxels, Colors)> {
        let (n, c) = (self.size.iter().product::<usize>(), self.components);
        let bytes = matches!(self.voxels, Voxels::U8(_));
        if matches!(self.meaning, Meaning::Unstated) {
            self.meaning = match c {
                3 | 4 if bytes => Meaning::Color,
                3 if !self.voxels.is_integer() => Meaning::Vectors,
                _ => Meaning::Channels(Vec::new()),
            };
        }
        let from = |voxels: &Voxels, index: usize| voxels.get(index);
        match std::mem::replace(&mut self.meaning, Meaning::Unstated) {
            Meaning::Color if c == 3 || c == 4 => {
                if bytes && self.layout == Layout::Interleaved {
                    let taken = std::mem::replace(&mut self.voxels, Vec::<u8>::new().into());
                    if let Voxels::U8(values) = taken {
                        return Ok(colors::of_interleaved(std::sync::Arc::unwrap_or_clone(values), c));
                    }
                }
                let top = self.voxels.top();
                let rgb = (0..n * c)
                    .into_par_iter()
                    .map(|at| (from(&self.voxels, self.index(at % c, at / c, n)) / top * 255.0 + 0.5).clamp(0.0, 255.0) as u8)
                    .collect();
                Ok(colors::of_interleaved(rgb, c))
            }
            Meaning::Vectors if c == 3 => {
                self.warnings.push("holds vectors; their direction is shown as colour (x red, y green, z blue) and their length as value".into());
                let length = |v: usize| DVec3::from_array(std::array::from_fn(|k| from(&self.voxels, self.index(k, v, n)))).abs();
                let values: Vec<f32> = (0..n).into_par_iter().map(|v| length(v).length() as f32).collect();
                let rgb = (0..n)
                    .into_par_iter()
                    .flat_map_iter(|v| {
                        let d = length(v).normalize_or_zero();
                        d.to_array().map(|x| if x.is_finite() { (x * 255.0 + 0.5) as u8 } else { 0 })
                    })
                    .collect();
                Ok((values.into(), Colors::rgb(rgb)))
            }
            Meaning::Channels(channel_styles) if c <= 4 => {
                self.warnings.push(format!("contains {c} channels, shown together in colour; use --channel (1 to {c}) to see the values of one"));
                let planes: Vec<Channel> =
                    (0..c).map(|k| channel_styles.get(k).cloned().unwrap_or(Channel { color: colors::CHANNELS[k], window: None })).collect();
                let windows: Vec<[f64; 2]> = (0..c).map(|k| planes[k].window.unwrap_or_else(|| self.range_of(k, n))).collect();
                let shares = |v: usize| -> [f64; 4] {
                    std::array::from_fn(|k| {
                        if k >= c {
                            return 0.0;
                        }
                        let [low, high] = windows[k];
                        let share = (from(&self.voxels, self.index(k, v, n)) - low) / (high - low).max(f64::MIN_POSITIVE);
                        if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 }
                    })
                };
                let values: Vec<u8> = (0..n).into_par_iter().map(|v| (shares(v).into_iter().fold(0.0, f64::max) * 255.0 + 0.5) as u8).collect();
                let rgb = (0..n)
                    .into_par_iter()
                    .flat_map_iter(|v| {
                        let share = shares(v);
                        std::array::from_fn::<u8, 3, _>(|b| {
                            (0..c).map(|k| share[k] * f64::from(planes[k].color[b])).sum::<f64>().min(255.0).round() as u8
                        })
                    })
                    .collect();
                Ok((values.into(), Colors::rgb(rgb)))
            }
            _ => Err(Error::file(path, format!("has {c} values per voxel, which cannot be shown together; choose one with --channel (1 to {c})"))),
        }
    }

    /// Lowest and highest finite value of a component.
    fn range_of(&self, c: usize, n: usize) -> [f64; 2] {
        let (low, high) = (0..n)
            .into_par_iter()
            .map(|v| self.voxels.get(self.index(c, v, n)))
            .filter(|v| v.is_finite())
            .map(|v| (v, v))
            .reduce(|| (f64::INFINITY, f64::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        if low < high { [low, high] } else { [0.0, 1.0] }
    }
}
