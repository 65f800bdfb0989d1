//! Which part of a file to read, and information that the file lacks.

use super::ScalarType;
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What to read from a file, and information that it lacks. By default all of it, or the first or
/// largest part.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ReadOptions {
    /// DICOM series to load: its number in `incise info` (from 1), its UID, part of its
    /// description, or its modality. The largest by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub series: Option<String>,
    /// Time point to load, counted from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time: Option<usize>,
    /// Channel to load as a scalar volume, counted from 1. All channels, in colour, by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub channel: Option<usize>,
    /// Resolution level of a multiscale image (OME-Zarr); 0, full resolution, by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub level: Option<usize>,
    /// Voxel spacing along i, j, k in mm, instead of the file's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spacing: Option<[f64; 3]>,
    /// Interpolate unevenly spaced slices onto an even grid.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub resample: bool,
    /// Layout of a raw file without a header.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub raw: Option<RawLayout>,
}

impl ReadOptions {
    /// The name of an option that is stated, if any is.
    pub(super) fn stated(&self) -> Option<&'static str> {
        [
            (self.series.is_some(), "series"),
            (self.time.is_some(), "time"),
            (self.channel.is_some(), "channel"),
            (self.level.is_some(), "level"),
            (self.spacing.is_some(), "spacing"),
            (self.resample, "resample"),
            (self.raw.is_some(), "raw"),
        ]
        .into_iter()
        .find_map(|(stated, name)| stated.then_some(name))
    }
}

/// Layout of a raw file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawLayout {
    /// Voxels along i, j, k.
    pub size: [usize; 3],
    /// Type of a value: u8, i16, f32 and so on.
    #[serde(rename = "type")]
    pub scalar: ScalarType,
    /// Values per voxel.
    #[serde(default = "one")]
    pub components: usize,
    /// Whether the most significant byte comes first.
    #[serde(default)]
    pub big_endian: bool,
    /// Bytes before the first value.
    #[serde(default)]
    pub skip: u64,
    /// Voxel spacing along i, j, k, mm; 1 mm, with a notice, if it is not stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spacing_mm: Option<[f64; 3]>,
    /// World position of the first voxel's centre, mm, LPS.
    #[serde(default)]
    pub origin_mm: [f64; 3],
    /// Directions of the axes: rows of a matrix whose columns are the unit vectors of i, j, k.
    #[serde(default = "identity")]
    pub direction: [[f64; 3]; 3],
}

fn one() -> usize {
    1
}

fn identity() -> [[f64; 3]; 3] {
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
}

impl ReadOptions {
    /// Whether nothing is selected.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Index of the selected time point among `count`.
    ///
    /// # Errors
    /// There is no such time point.
    pub(super) fn time_of(&self, count: usize) -> Result<usize> {
        Self::index("time", self.time, count).map(|t| t.unwrap_or(0))
    }

    /// A notice about the axes along which a file does not state its spacing; none if all are
    /// stated, or given instead of the file's.
    pub(super) fn spacing_notice(&self, stated: [bool; 3]) -> Option<String> {
        if self.spacing.is_some() {
            return None;
        }
        let missing: Vec<&str> = ["i", "j", "k"]
            .into_iter()
            .zip(stated)
            .filter_map(|(name, stated)| (!stated).then_some(name))
            .collect();
        let what = match missing[..] {
            [] => return None,
            [_, _, _] => "its voxel spacing".to_owned(),
            _ => format!("its spacing along {}", missing.join(" and ")),
        };
        Some(format!(
            "does not state {what}; 1 mm is assumed (use --spacing to set it)"
        ))
    }

    /// Index of one of `count` items by its number from 1.
    pub(super) fn index(what: &str, number: Option<usize>, count: usize) -> Result<Option<usize>> {
        match number {
            None => Ok(None),
            Some(n) if (1..=count).contains(&n) => Ok(Some(n - 1)),
            Some(n) => Err(Error::value(
                what,
                format!("{n} is out of range; the file has {count}, counted from 1"),
            )),
        }
    }
}

impl RawLayout {
    /// Parses a layout as typed: `256x256x128:u8[:be][:skip=N][:components=N]`.
    ///
    /// # Errors
    /// The problem with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let usage = || {
            format!(
                "\"{text}\" is not a layout; write WxHxD:TYPE[:be][:skip=BYTES][:components=N], e.g. 256x256x128:u16:be"
            )
        };
        let mut parts = text.split(':');
        let size: Vec<usize> = parts
            .next()
            .unwrap_or("")
            .split('x')
            .map_while(|n| n.trim().parse().ok())
            .collect();
        let size: [usize; 3] = size.try_into().map_err(|_| usage())?;
        let scalar = parts.next().and_then(ScalarType::named).ok_or_else(usage)?;
        let mut layout = Self::new(size, scalar);
        for part in parts {
            match part.split_once('=') {
                None if part == "be" => layout.big_endian = true,
                None if part == "le" => layout.big_endian = false,
                Some(("skip", n)) => layout.skip = n.parse().map_err(|_| usage())?,
                Some(("components", n)) => layout.components = n.parse().map_err(|_| usage())?,
                _ => return Err(usage()),
            }
        }
        Ok(layout)
    }

    /// Little-endian scalars from the start of the file, without a stated spacing.
    pub fn new(size: [usize; 3], scalar: ScalarType) -> Self {
        Self {
            size,
            scalar,
            components: 1,
            big_endian: false,
            skip: 0,
            spacing_mm: None,
            origin_mm: [0.0; 3],
            direction: identity(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spacings_that_are_made_up_are_named() {
        let options = ReadOptions::default();
        let notice = |stated| options.spacing_notice(stated).unwrap_or_default();
        assert!(notice([false; 3]).contains("its voxel spacing; 1 mm"));
        assert!(notice([true, false, false]).contains("along j and k"));
        assert_eq!(options.spacing_notice([true; 3]), None);
        let given = ReadOptions {
            spacing: Some([2.0; 3]),
            ..ReadOptions::default()
        };
        assert_eq!(given.spacing_notice([false; 3]), None);
    }

    #[test]
    fn layouts_as_typed() {
        let layout = RawLayout::parse("4x5x6:u16:be:skip=12:components=3").unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(
            (
                layout.size,
                layout.scalar,
                layout.big_endian,
                layout.skip,
                layout.components
            ),
            ([4, 5, 6], ScalarType::U16, true, 12, 3)
        );
        for bad in [
            "",
            "4x5",
            "4x5x6",
            "4x5x6:u7",
            "4x5x6:u8:xe",
            "4x5x6:u8:skip=a",
            "4x5x6x7:u8",
        ] {
            assert!(RawLayout::parse(bad).is_err(), "{bad}");
        }
    }
}
