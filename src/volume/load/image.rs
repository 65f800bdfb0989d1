//! An image as stored in a file: typed values, one or several per voxel, and geometry. All readers
//! return it; it is then converted to a volume that can be shown.

use super::super::colors::{self, Colors, Label};
use super::super::{Rescale, SliceDisplacement, StoredValues, TypedArray, Volume, Voxels};
use super::ReadOptions;
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DVec3};
use ndarray::{Array3, Axis, Ix4};
use serde_json::Value;
use std::path::Path;

/// Order of a voxel's components in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// One whole grid per component.
    Planar,
    /// All components of a voxel together.
    Interleaved,
}

/// The meaning of the values, as far as the file states it.
#[derive(Clone, Debug, PartialEq)]
pub enum Meaning {
    /// Not stated.
    Unstated,
    /// Labels, some with names or colours.
    Labels(Vec<Label>),
    /// Red, green, blue and optionally opacity, over the full range of their type.
    Color,
    /// Vectors.
    Vectors,
    /// Channels, as of a microscope.
    Channels(Vec<Channel>),
}

/// The display of one channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Red, green, blue at full brightness.
    pub color: [u8; 3],
    /// Values shown as black and at full brightness; those of the data by default.
    pub window: Option<[f64; 2]>,
}

/// An image of one or several components.
pub struct Image {
    /// Name of the format.
    pub format: &'static str,
    /// Stored values.
    pub voxels: StoredValues,
    /// Voxels along i, j, k.
    pub size: [usize; 3],
    /// Values per voxel.
    pub components: usize,
    /// Their order.
    pub layout: Layout,
    /// Their meaning.
    pub meaning: Meaning,
    /// Value = slope · stored + intercept.
    pub rescale: Rescale,
    /// Smallest and largest stored value that mean "no value" (DICOM's pixel padding).
    pub padding: Option<[f64; 2]>,
    /// Whether high values are dark (DICOM's MONOCHROME1).
    pub inverted: bool,
    /// Voxel indices to world millimetres, LPS.
    pub world_from_voxel: DAffine3,
    /// NIfTI's intent code; 0 for other formats.
    pub intent: i16,
    /// NIfTI's name of the intent; empty for other formats.
    pub intent_name: String,
    /// World (LPS) from the axes of the vectors, if the format states them.
    pub frame: Option<DMat3>,
    /// Whether the file declares itself a displacement map of this program: four components, the
    /// last one being the mask.
    pub displacement: bool,
    /// Whether the reader has read only the selected channel.
    pub channel_taken: bool,
    /// The displacement of slices from the even grid on which they are shown.
    pub misplaced: Option<SliceDisplacement>,
    /// Further information from the file, for `info`.
    pub details: Vec<(&'static str, Value)>,
    /// Irregularities, one sentence each.
    pub warnings: Vec<String>,
}

impl Image {
    /// A scalar image without further information.
    pub fn new(
        format: &'static str,
        voxels: StoredValues,
        size: [usize; 3],
        world_from_voxel: DAffine3,
    ) -> Self {
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
            intent_name: String::new(),
            frame: None,
            displacement: false,
            channel_taken: false,
            misplaced: None,
            details: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// The image as a volume that can be shown: scalars unchanged, colours as colours, a few
    /// channels as one colour, vectors by their direction; or one channel alone.
    ///
    /// # Errors
    /// More components than can be shown together, a channel that does not exist, or a range that
    /// cannot be represented.
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
        let mut volume = Volume::with_padding(
            Voxels::new(self.size, self.voxels),
            self.rescale,
            self.world_from_voxel,
            self.padding,
        );
        if !(volume.range[1] - volume.range[0]).is_finite() {
            return Err(Error::file(
                path,
                "holds values whose range cannot be represented; rescale it",
            ));
        }
        volume.colors = colors;
        volume.components = components;
        volume.source_type = source_type;
        volume.format = self.format;
        volume.inverted = self.inverted;
        volume.misplaced = self.misplaced;
        volume.details = self.details;
        // Text quoted from a file may contain control characters.
        volume.warnings = self
            .warnings
            .into_iter()
            .map(|w| w.replace(char::is_control, " "))
            .collect();
        if volume.non_finite > 0 {
            volume.warnings.push(format!(
                "{} voxels are NaN or infinite and are rendered as empty",
                volume.non_finite
            ));
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

    /// The values with an axis for components, and its position: (component, k, j, i) or (k, j, i,
    /// component).
    fn with_component_axis(&self) -> (TypedArray<Ix4>, Axis) {
        let ([i, j, k], c) = (self.size, self.components);
        match self.layout {
            Layout::Planar => (self.voxels.clone().reshaped((c, k, j, i)), Axis(0)),
            Layout::Interleaved => (self.voxels.clone().reshaped((k, j, i, c)), Axis(3)),
        }
    }

    /// Component `c` of every voxel, as data values.
    pub fn component(&self, c: usize) -> Array3<f32> {
        let Rescale { slope, intercept } = self.rescale;
        Voxels::new(self.size, self.one_component(c)).map(|stored| (stored * slope + intercept) as f32)
    }

    /// Component `c` of every voxel, as stored.
    pub(super) fn one_component(&self, c: usize) -> StoredValues {
        let (values, axis) = self.with_component_axis();
        let voxels = self.size.iter().product::<usize>();
        values.at_index(axis, c).reshaped(voxels)
    }

    /// Applies `make` to the components of each voxel.
    fn of_each_voxel<T: Send>(&self, make: impl Fn([f64; 4]) -> T + Sync + Send) -> Vec<T> {
        let (values, axis) = self.with_component_axis();
        values.map_lanes(axis, make)
    }

    /// One value and one colour for every voxel of a multi-component image.
    fn colored(&mut self, path: &Path) -> Result<(StoredValues, Colors)> {
        let c = self.components;
        let bytes = matches!(self.voxels, StoredValues::U8(_));
        if matches!(self.meaning, Meaning::Unstated) {
            self.meaning = match c {
                3 | 4 if bytes => Meaning::Color,
                3 if !self.voxels.is_integer() => Meaning::Vectors,
                _ => Meaning::Channels(Vec::new()),
            };
        }
        match std::mem::replace(&mut self.meaning, Meaning::Unstated) {
            Meaning::Color if c == 3 || c == 4 => Ok(colors::of_interleaved(self.color_bytes(bytes), c)),
            Meaning::Vectors if c == 3 => {
                self.warnings.push("holds vectors; their direction is shown as colour (x red, y green, z blue) and their length as value".into());
                let lengths = self.of_each_voxel(|[x, y, z, _]| DVec3::new(x, y, z).abs().length() as f32);
                let directions = self.of_each_voxel(|[x, y, z, _]| {
                    let direction = DVec3::new(x, y, z).abs().normalize_or_zero();
                    direction
                        .to_array()
                        .map(|d| if d.is_finite() { (d * 255.0 + 0.5) as u8 } else { 0 })
                });
                Ok((lengths.into(), Colors::rgb(directions.into_flattened())))
            }
            Meaning::Channels(channel_styles) if c <= 4 => {
                self.warnings.push(format!("contains {c} channels, shown together in colour; use --channel (1 to {c}) to see the values of one"));
                Ok(self.mixed_channels(&channel_styles))
            }
            _ => Err(Error::file(
                path,
                format!(
                    "has {c} values per voxel, which cannot be shown together; choose one with --channel (1 to {c})"
                ),
            )),
        }
    }

    /// Interleaved colour bytes, taken from the image.
    fn color_bytes(&mut self, bytes: bool) -> Vec<u8> {
        if bytes && self.layout == Layout::Interleaved {
            let taken = std::mem::replace(&mut self.voxels, Vec::<u8>::new().into());
            if let StoredValues::U8(values) = taken {
                return values.into_owned().into_raw_vec_and_offset().0;
            }
        }
        let (top, c) = (self.voxels.top(), self.components);
        let byte = |v: f64| (v / top * 255.0 + 0.5).clamp(0.0, 255.0) as u8;
        if c == 3 {
            self.of_each_voxel(|[r, g, b, _]| [r, g, b].map(byte))
                .into_flattened()
        } else {
            self.of_each_voxel(|rgba| rgba.map(byte)).into_flattened()
        }
    }

    /// Channels combined into one colour, each in its own colour over its own window; the value is
    /// the brightest channel.
    fn mixed_channels(&self, styles: &[Channel]) -> (StoredValues, Colors) {
        let c = self.components;
        let channels: Vec<Channel> = (0..c)
            .map(|k| {
                styles.get(k).cloned().unwrap_or(Channel {
                    color: colors::CHANNELS[k],
                    window: None,
                })
            })
            .collect();
        let windows: Vec<[f64; 2]> = (0..c)
            .map(|k| channels[k].window.unwrap_or_else(|| self.range_of(k)))
            .collect();
        let shares = |values: [f64; 4]| -> [f64; 4] {
            std::array::from_fn(|k| {
                let Some([low, high]) = windows.get(k) else {
                    return 0.0;
                };
                let share = (values[k] - low) / (high - low).max(f64::MIN_POSITIVE);
                if share.is_finite() {
                    share.clamp(0.0, 1.0)
                } else {
                    0.0
                }
            })
        };
        let brightest =
            self.of_each_voxel(|values| (shares(values).into_iter().fold(0.0, f64::max) * 255.0 + 0.5) as u8);
        let mixed = self.of_each_voxel(|values| {
            let share = shares(values);
            std::array::from_fn::<u8, 3, _>(|b| {
                channels
                    .iter()
                    .zip(share)
                    .map(|(channel, s)| s * f64::from(channel.color[b]))
                    .sum::<f64>()
                    .min(255.0)
                    .round() as u8
            })
        });
        (brightest.into(), Colors::rgb(mixed.into_flattened()))
    }

    /// Smallest and largest finite value of a component; 0 to 1 if these are not distinct.
    fn range_of(&self, c: usize) -> [f64; 2] {
        match self.one_component(c).finite_range(None).0 {
            Some([low, high]) if low < high => [low, high],
            _ => [0.0, 1.0],
        }
    }
}
