//! The texels of displacement maps: their content and formats.

use glam::Vec3;
use half::f16;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The mask of marked texels, and the smallest mask of a sample that interpolates one.
/// Representable in half precision.
pub(super) const MARKED_ALPHA: f32 = 60_000.0;
pub(super) const MIN_MARKED_ALPHA: f32 = 2.0;
/// A mask that changes by this much over a map belongs to marked texels.
pub(super) const MIN_MARKED_SLOPE: f32 = 4096.0;

/// Texel format of a displacement map. Eight bits show jagged edges (\[DDM06\] section 8).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Storage {
    /// Four half-precision floats.
    #[default]
    F16,
    /// Four 16-bit signed normalised integers.
    Snorm16,
    /// Four 8-bit signed normalised integers.
    Snorm8,
    /// Four single-precision floats, for fields that need full precision.
    F32,
}

impl Storage {
    /// Bytes of one texel.
    pub fn bytes(self) -> usize {
        match self {
            Self::F16 | Self::Snorm16 => 8,
            Self::Snorm8 => 4,
            Self::F32 => 16,
        }
    }

    /// The nearest value that the format can represent.
    pub(super) fn quantise(self, v: f32) -> f32 {
        match self {
            Self::F16 => f16::from_f32(v).to_f32(),
            Self::Snorm16 => (v.clamp(-1.0, 1.0) * 32767.0).round() / 32767.0,
            Self::Snorm8 => (v.clamp(-1.0, 1.0) * 127.0).round() / 127.0,
            Self::F32 => v,
        }
    }
}

/// D (map units) and alpha at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexelSample {
    /// Inverse displacement, in units of the map's cube.
    pub displacement: Vec3,
    /// 1 where the volume is retained, 0 where it is removed; 1/2 on a cut.
    pub alpha: f32,
}
