//! The labels of a segmentation in one or several objects. Numbers of segments are unique within an
//! object only: those of another object that name something else get new numbers.
//!
//! Source: DICOM PS3.3 C.8.20.2.

use super::frame::Frame;
use super::object::Object;
use crate::volume::Label;
use std::collections::{BTreeSet, HashMap};

/// The labels of all segments.
pub struct SegmentLabels {
    pub labels: Vec<Label>,
    /// New numbers, by object and segment.
    numbers: HashMap<(usize, u16), u16>,
}

impl SegmentLabels {
    /// The labels of the segments of the frames' objects.
    pub fn of(objects: &[Object], frames: &[Frame]) -> Self {
        let used: BTreeSet<usize> = frames.iter().map(|f| f.object).collect();
        let segments = || {
            used.iter()
                .flat_map(|o| objects[*o].segments.iter().map(move |s| (*o, s)))
        };
        let mut next = segments().map(|(_, s)| s.value).max().unwrap_or(0) + 1;
        let (mut labels, mut numbers): (Vec<Label>, _) = (Vec::new(), HashMap::new());
        for (object, segment) in segments() {
            let same_name = labels.iter().find(|l| l.name == segment.name);
            let value = match labels.iter().find(|l| l.value == segment.value) {
                Some(taken) if taken.name != segment.name => {
                    let known = same_name.map(|l| l.value);
                    known.unwrap_or_else(|| {
                        next += 1;
                        next - 1
                    })
                }
                _ => segment.value,
            };
            if labels.iter().all(|l| l.value != value) {
                labels.push(Label {
                    value,
                    ..segment.clone()
                });
            }
            if value != segment.value
                && let (Ok(old), Ok(new)) = (u16::try_from(segment.value), u16::try_from(value))
            {
                numbers.insert((object, old), new);
            }
        }
        Self { labels, numbers }
    }

    /// The label of a segment of an object.
    pub fn number(&self, object: usize, segment: u16) -> u16 {
        self.numbers.get(&(object, segment)).copied().unwrap_or(segment)
    }

    /// The warning about new numbers.
    pub fn warning(&self) -> Option<String> {
        (!self.numbers.is_empty()).then(|| {
            format!(
                "its files use the same segment numbers for different segments; {} of these segments get new numbers",
                self.numbers.len()
            )
        })
    }
}
