//! The measurements of a scene: distances, angles, points, labels. Points are stored in source
//! coordinates, so that they move with the deformation; [`crate::prepare::measure`] evaluates the
//! measurements.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum MeasureKind {
    /// The length between two points, mm.
    Distance,
    /// The angle at the second of three points, degrees.
    Angle,
    /// The value at a point.
    Probe,
    /// Volume and surface area of a label.
    Label,
}

/// One `[[measure]]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Measure {
    /// What is measured.
    pub kind: MeasureKind,
    /// A user-defined name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Its points in the undeformed volume, mm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<[f32; 3]>,
    /// The label, of a label map.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<u32>,
    /// Made before the volume's slices were resampled: its points may no longer mark the same
    /// anatomy.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub before_resampling: bool,
}

impl MeasureKind {
    /// Number of points that the kind takes.
    pub fn points(self) -> usize {
        match self {
            Self::Distance => 2,
            Self::Angle => 3,
            Self::Probe => 1,
            Self::Label => 0,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Distance => "Distance",
            Self::Angle => "Angle",
            Self::Probe => "Probe",
            Self::Label => "Label",
        }
    }
}
