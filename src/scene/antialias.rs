//! How many samples a pixel gets.

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

/// Antialiasing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Antialias {
    /// One sample per pixel; up to 16 where a pixel differs from its neighbours.
    #[default]
    Adaptive,
    /// A fixed number of samples along each edge of a pixel; 1 is off.
    Grid(u32),
}

impl Antialias {
    /// One sample per pixel.
    pub const OFF: Self = Self::Grid(1);

    /// Most samples along an edge of a pixel.
    pub const MAX_GRID: u32 = 4;

    /// Samples along each edge of every pixel.
    pub fn grid(self) -> u32 {
        match self {
            Self::Adaptive => 1,
            Self::Grid(n) => n,
        }
    }
}

const ADAPTIVE: &str = "adaptive";

impl fmt::Display for Antialias {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Adaptive => f.write_str(ADAPTIVE),
            Self::Grid(n) => write!(f, "{n}"),
        }
    }
}

impl FromStr for Antialias {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == ADAPTIVE {
            return Ok(Self::Adaptive);
        }
        let grid = text.parse().map(Self::Grid);
        grid.map_err(|_| {
            format!(
                "\"{text}\" is neither \"{ADAPTIVE}\" nor a whole number from 1 to {}",
                Self::MAX_GRID
            )
        })
    }
}

impl Serialize for Antialias {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Adaptive => serializer.serialize_str(ADAPTIVE),
            Self::Grid(n) => serializer.serialize_u32(*n),
        }
    }
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Stated {
    Number(u32),
    Text(String),
}

impl<'de> Deserialize<'de> for Antialias {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match Stated::deserialize(deserializer)? {
            Stated::Number(n) => Ok(Self::Grid(n)),
            Stated::Text(text) => text.parse().map_err(serde::de::Error::custom),
        }
    }
}

impl JsonSchema for Antialias {
    fn schema_name() -> Cow<'static, str> {
        "Antialias".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "\"adaptive\", or samples along each edge of a pixel.",
            "anyOf": [
                { "type": "string", "enum": [ADAPTIVE] },
                { "type": "integer", "minimum": 1, "maximum": Self::MAX_GRID },
            ],
        })
    }
}
