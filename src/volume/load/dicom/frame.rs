//! A frame: a plane of pixels with its geometry, and the storage of its pixels.

use crate::volume::Rescale;
use crate::volume::load::slices::natural;
use dicom_core::Tag;
use glam::DVec3;
use serde_json::{Value, json};
use std::cmp::Ordering;
use std::sync::Arc;

/// The storage of pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PixelFormat {
    pub rows: u16,
    pub columns: u16,
    pub samples: u16,
    pub allocated: u16,
    pub stored: u16,
    pub high_bit: u16,
    pub signed: bool,
    /// Floating-point pixels of 32 or 64 bits.
    pub float: bool,
    pub photometric: String,
    pub planar: bool,
}

impl PixelFormat {
    /// Number of values in a picture.
    pub fn values(&self) -> usize {
        usize::from(self.rows) * usize::from(self.columns) * usize::from(self.samples)
    }

    /// Bytes of an uncompressed picture; for 1-bit pixels, rounded up.
    pub fn frame_bytes(&self) -> usize {
        if self.allocated == 1 {
            self.values().div_ceil(8)
        } else {
            self.values() * usize::from(self.allocated / 8)
        }
    }
}

/// A plane of pixels.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Its object, and the index of its picture in the object.
    pub object: usize,
    pub number: usize,
    /// Column and row of its first pixel in the picture, if the picture consists of several frames.
    pub tile: Option<[usize; 2]>,
    /// Centre of the first pixel, mm; none if the object does not state it.
    pub position: Option<DVec3>,
    /// Whether the object states the frame's position, and its orientation.
    pub stated: [bool; 2],
    /// Whether the frame's place among the others of its object is stated, too.
    pub placed: bool,
    /// Position along the normal as the object states it for display, mm; for frames without
    /// positions.
    pub location: Option<f64>,
    /// Directions of increasing column and row.
    pub along: [DVec3; 2],
    /// Distance between columns and between rows, mm.
    pub spacing: [f64; 2],
    /// Distance between rows relative to that between columns, where only this is stated.
    pub aspect: f64,
    /// Whether this is the spacing in the plane of the detector.
    pub at_detector: bool,
    pub rescale: Rescale,
    /// Segment of a frame in a segmentation.
    pub segment: u16,
    /// What tells it from other frames at the same position.
    pub keys: Vec<(u8, KeyValue)>,
    /// Digests of all other attributes of its object, and of its own.
    pub others: Arc<[(Tag, Digest)]>,
    pub own_others: Vec<(Tag, Digest)>,
    /// Instance number.
    pub instance: Option<f64>,
}

/// What is compared of a value: a hash, and a number for its order.
#[derive(Clone, Copy, Debug)]
pub struct Digest {
    pub hash: u64,
    pub order: f64,
}

impl Frame {
    /// The digest of an attribute of the frame.
    pub fn other(&self, tag: Tag) -> Option<Digest> {
        let all = self.own_others.iter().chain(&*self.others);
        all.into_iter()
            .find(|(t, _)| *t == tag)
            .map(|(_, digest)| *digest)
    }
}

/// The value of an attribute that tells frames apart.
#[derive(Clone, Debug, PartialEq)]
pub enum KeyValue {
    Number(f64),
    Text(String),
    /// Several numbers, such as a dimension index.
    Numbers(Vec<f64>),
}

impl KeyValue {
    /// A total order: numbers by size, texts by letters and the numbers in them.
    pub fn order(&self, other: &Self) -> Ordering {
        match (self, other) {
            (Self::Number(a), Self::Number(b)) => a.total_cmp(b),
            (Self::Text(a), Self::Text(b)) => natural(a, b),
            (Self::Numbers(a), Self::Numbers(b)) => a
                .iter()
                .zip(b)
                .map(|(a, b)| a.total_cmp(b))
                .find(|o| o.is_ne())
                .unwrap_or_else(|| a.len().cmp(&b.len())),
            _ => self.rank().cmp(&other.rank()),
        }
    }

    fn rank(&self) -> u8 {
        match self {
            Self::Number(_) => 0,
            Self::Numbers(_) => 1,
            Self::Text(_) => 2,
        }
    }

    /// For `info`.
    pub fn json(&self) -> Value {
        match self {
            Self::Number(n) => json!(n),
            Self::Numbers(n) => json!(n),
            Self::Text(t) => json!(t),
        }
    }
}

impl std::fmt::Display for KeyValue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(n) => write!(f, "{n}"),
            Self::Text(t) => f.write_str(t),
            Self::Numbers(n) => {
                let words: Vec<String> = n.iter().map(f64::to_string).collect();
                f.write_str(&words.join("/"))
            }
        }
    }
}
