//! A label map as a segmentation (PS3.3 A.51, C.8.20): one file, one bit for each voxel of a segment.
//!
//! Binary segmentations are read by every program that reads segmentations; the newer label maps
//! (storage class ...66.7) are not. Segments are numbered from 1 without gaps, as the standard
//! demands. Slices without a segment are omitted, except for the first segment: its frames state
//! the whole grid.

use super::attributes::{Attributes, Derivation, derived};
use super::planes::{SlicePlanes, frame_of_reference};
use super::uid::UidRole;
use crate::volume::{GridGeometry, Label, Volume};
use dicom_core::value::PrimitiveValue;
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use glam::{DMat3, DVec3};
use std::collections::BTreeSet;

/// Most segments: their numbers have 16 bits.
const MAX_SEGMENTS: usize = 65_535;
/// Longest pixel data: an even length of 32 bits that is not "undefined".
const MAX_PIXEL_BYTES: usize = 0xffff_fffe;
/// Most frames, as readers accept them.
const MAX_FRAMES: usize = 1 << 20;

/// A plane of bits: its segment and slice.
struct SegmentFrame {
    segment: u16,
    slice: usize,
}

/// A segmentation being made: labels are appended in voxel order.
pub struct SegmentationWriter {
    planes: SlicePlanes,
    /// Labels in ascending order: label n is segment n + 1.
    labels: Vec<u32>,
    set: Attributes,
    frames: Vec<SegmentFrame>,
    /// Bits of all frames, without padding between them, the lowest bit first.
    bits: Vec<u8>,
    bit_count: usize,
    /// Labels of the slice that is not yet complete, and the number of complete ones.
    slice: Vec<u32>,
    slices: usize,
}

impl SegmentationWriter {
    /// Begins a segmentation of the labels of a volume, on `grid`.
    ///
    /// # Errors
    /// A grid that slices cannot represent; no label, or more than 65,535.
    pub fn new(volume: &Volume, grid: &GridGeometry, derivation: &Derivation) -> Result<Self, String> {
        let planes = SlicePlanes::new(grid)?;
        let labels: Vec<u32> = labels_of(volume).into_iter().collect();
        match labels.len() {
            0 => return Err("the label map has no label other than 0; there is nothing to segment".into()),
            n if n > MAX_SEGMENTS => {
                return Err(format!(
                    "the label map has {n} labels, but a DICOM segmentation has at most {MAX_SEGMENTS} segments; write .nii.gz or .nrrd instead"
                ));
            }
            _ => {}
        }
        let mut set = derived(uids::SEGMENTATION_STORAGE, "SEG", derivation);
        frame_of_reference(&mut set, derivation.identified());
        general(&mut set, derivation);
        planes.extent(&mut set);
        let segments = labels
            .iter()
            .zip(1..)
            .map(|(label, number)| segment(number, *label, &volume.label_table));
        set.sequence(tags::SEGMENT_SEQUENCE, segments);
        set.sequence(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, [shared(&planes)]);
        dimensions(&mut set);
        refer(&mut set, derivation);
        Ok(Self {
            planes,
            labels,
            set,
            frames: Vec::new(),
            bits: Vec::new(),
            bit_count: 0,
            slice: Vec::new(),
            slices: 0,
        })
    }

    /// What a user should know about the numbers of segments; none if they are the labels.
    pub fn notice(&self) -> Option<String> {
        let renumbered = self.labels.iter().zip(1..).any(|(label, n)| *label != n);
        renumbered.then(|| {
            format!(
                "DICOM numbers segments from 1 without gaps: the {} labels become 1 to {}, in their order",
                self.labels.len(),
                self.labels.len()
            )
        })
    }

    /// Appends labels: 32 bits each, least significant byte first, whole voxels.
    ///
    /// # Errors
    /// More pixels than a file can hold.
    pub fn push(&mut self, bytes: &[u8]) -> Result<(), String> {
        let [columns, rows, _] = self.planes.grid.size;
        for voxel in bytes.as_chunks::<4>().0 {
            self.slice.push(u32::from_le_bytes(*voxel));
            if self.slice.len() == columns * rows {
                self.add_slice()?;
            }
        }
        Ok(())
    }

    /// Adds the frames of the complete slice.
    fn add_slice(&mut self) -> Result<(), String> {
        let slice = std::mem::take(&mut self.slice);
        let mut present: BTreeSet<u32> = slice.iter().copied().filter(|v| *v != 0).collect();
        // Frames of the first segment are there in every slice.
        present.extend(self.labels.first());
        // Labels of this slice, each with the first bit of its frame.
        let mut starts: Vec<(u32, usize)> = Vec::with_capacity(present.len());
        for label in present {
            let Ok(n) = self.labels.binary_search(&label) else {
                continue;
            };
            starts.push((label, self.bit_count));
            self.bit_count += slice.len();
            self.frames.push(SegmentFrame {
                segment: (n + 1) as u16,
                slice: self.slices,
            });
        }
        let end = self.bit_count.div_ceil(8);
        if end > MAX_PIXEL_BYTES || self.frames.len() > MAX_FRAMES {
            return Err(
                "the segmentation is larger than a DICOM file can be; write .nii.gz or .nrrd instead".into(),
            );
        }
        self.bits.resize(end, 0);
        for (n, label) in slice.iter().enumerate() {
            if let Ok(found) = starts.binary_search_by_key(label, |s| s.0) {
                let bit = starts[found].1 + n;
                self.bits[bit / 8] |= 1 << (bit % 8);
            }
        }
        self.slices += 1;
        Ok(())
    }

    /// The bytes of the file.
    ///
    /// # Errors
    /// Fewer labels than the grid has voxels.
    pub fn finish(mut self) -> Result<Vec<u8>, String> {
        if self.slices != self.planes.grid.size[2] {
            return Err("was not written completely".into());
        }
        let groups: Vec<Attributes> = self.frames.iter().map(|frame| self.groups(frame)).collect();
        self.set
            .text(tags::NUMBER_OF_FRAMES, VR::IS, self.frames.len().to_string());
        self.set
            .sequence(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, groups);
        let pixel_bytes = self.bits.len();
        self.set.bytes(tags::PIXEL_DATA, VR::OB, self.bits);
        self.set.single_file(pixel_bytes)
    }

    /// The functional groups of a frame.
    fn groups(&self, frame: &SegmentFrame) -> Attributes {
        let mut content = Attributes::new();
        content.0.put(DataElement::new(
            tags::DIMENSION_INDEX_VALUES,
            VR::UL,
            PrimitiveValue::U32(
                [u32::from(frame.segment), self.planes.number(frame.slice) as u32]
                    .into_iter()
                    .collect(),
            ),
        ));
        let mut position = Attributes::new();
        position.decimals(
            tags::IMAGE_POSITION_PATIENT,
            &self.planes.position(frame.slice).to_array(),
        );
        let mut segment = Attributes::new();
        segment.whole(tags::REFERENCED_SEGMENT_NUMBER, frame.segment);
        let mut groups = Attributes::new();
        groups.sequence(tags::FRAME_CONTENT_SEQUENCE, [content]);
        groups.sequence(tags::PLANE_POSITION_SEQUENCE, [position]);
        groups.sequence(tags::SEGMENT_IDENTIFICATION_SEQUENCE, [segment]);
        groups
    }
}

/// The labels that occur in a volume, without 0.
fn labels_of(volume: &Volume) -> BTreeSet<u32> {
    let mut labels = volume.voxels.fold(
        BTreeSet::new,
        |mut found, v| {
            if v >= 0.5 {
                found.insert(v as u32);
            }
            found
        },
        |mut a, b| {
            a.extend(b);
            a
        },
    );
    labels.remove(&0);
    labels
}

/// The attributes of a segmentation as a whole.
fn general(set: &mut Attributes, derivation: &Derivation) {
    for (tag, vr, value) in [
        (tags::IMAGE_TYPE, VR::CS, "DERIVED\\PRIMARY"),
        (tags::INSTANCE_NUMBER, VR::IS, "1"),
        (tags::CONTENT_LABEL, VR::CS, "SEGMENTATION"),
        (tags::CONTENT_DESCRIPTION, VR::LO, "Deformed label map"),
        (tags::CONTENT_CREATOR_NAME, VR::PN, ""),
        // Required; there is none.
        (tags::DEVICE_SERIAL_NUMBER, VR::LO, "none"),
        (tags::LOSSY_IMAGE_COMPRESSION, VR::CS, "00"),
        (tags::SEGMENTATION_TYPE, VR::CS, "BINARY"),
        (tags::SEGMENTS_OVERLAP, VR::CS, "NO"),
        (tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
    ] {
        set.text(tag, vr, value);
    }
    // Required: those of the study, or of none.
    if let Some(origin) = derivation.identified() {
        for (tag, vr, source) in [
            (tags::CONTENT_DATE, VR::DA, tags::STUDY_DATE),
            (tags::CONTENT_TIME, VR::TM, tags::STUDY_TIME),
        ] {
            set.text(tag, vr, origin.text(source));
        }
    }
    set.text_if_missing(tags::CONTENT_DATE, VR::DA, "19000101");
    set.text_if_missing(tags::CONTENT_TIME, VR::TM, "000000");
    for (tag, value) in [
        (tags::SAMPLES_PER_PIXEL, 1),
        (tags::BITS_ALLOCATED, 1),
        (tags::BITS_STORED, 1),
        (tags::HIGH_BIT, 0),
        (tags::PIXEL_REPRESENTATION, 0),
    ] {
        set.whole(tag, value);
    }
}

/// The description of a segment.
fn segment(number: u16, label: u32, table: &[Label]) -> Attributes {
    let described = table.iter().find(|l| l.value == label);
    let name = described.map_or("", |l| l.name.trim());
    let name = if name.is_empty() {
        format!("Label {label}")
    } else {
        name.replace('\\', "/").chars().take(64).collect()
    };
    let mut item = Attributes::new();
    item.whole(tags::SEGMENT_NUMBER, number);
    item.text(tags::SEGMENT_LABEL, VR::LO, name);
    item.text(tags::SEGMENT_DESCRIPTION, VR::ST, format!("Label {label}"));
    item.text(tags::SEGMENT_ALGORITHM_TYPE, VR::CS, "SEMIAUTOMATIC");
    item.text(
        tags::SEGMENT_ALGORITHM_NAME,
        VR::LO,
        "Label map deformed by incise",
    );
    for tag in [
        tags::SEGMENTED_PROPERTY_CATEGORY_CODE_SEQUENCE,
        tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE,
    ] {
        item.code(tag, "85756007", "SCT", "Tissue");
    }
    if let Some(color) = described.and_then(|l| l.color) {
        item.0.put(DataElement::new(
            tags::RECOMMENDED_DISPLAY_CIE_LAB_VALUE,
            VR::US,
            PrimitiveValue::U16(lab_of_rgb(color).into_iter().collect()),
        ));
    }
    item
}

/// The functional groups that all frames share.
fn shared(planes: &SlicePlanes) -> Attributes {
    let (mut measures, mut orientation) = (Attributes::new(), Attributes::new());
    planes.measures(&mut measures);
    planes.orientation(&mut orientation);
    let mut groups = Attributes::new();
    groups.sequence(tags::PIXEL_MEASURES_SEQUENCE, [measures]);
    groups.sequence(tags::PLANE_ORIENTATION_SEQUENCE, [orientation]);
    groups
}

/// The dimensions of the frames: segment, and position.
fn dimensions(set: &mut Attributes) {
    let uid = UidRole::DimensionOrganization.placeholder();
    let mut organization = Attributes::new();
    organization.text(tags::DIMENSION_ORGANIZATION_UID, VR::UI, &uid);
    set.sequence(tags::DIMENSION_ORGANIZATION_SEQUENCE, [organization]);
    let index = |pointer: Tag, group: Tag, label: &str| {
        let mut item = Attributes::new();
        for (tag, to) in [
            (tags::DIMENSION_INDEX_POINTER, pointer),
            (tags::FUNCTIONAL_GROUP_POINTER, group),
        ] {
            item.0
                .put(DataElement::new(tag, VR::AT, PrimitiveValue::from(to)));
        }
        item.text(tags::DIMENSION_ORGANIZATION_UID, VR::UI, &uid);
        item.text(tags::DIMENSION_DESCRIPTION_LABEL, VR::LO, label);
        item
    };
    set.sequence(
        tags::DIMENSION_INDEX_SEQUENCE,
        [
            index(
                tags::REFERENCED_SEGMENT_NUMBER,
                tags::SEGMENT_IDENTIFICATION_SEQUENCE,
                "Segment",
            ),
            index(
                tags::IMAGE_POSITION_PATIENT,
                tags::PLANE_POSITION_SEQUENCE,
                "Position",
            ),
        ],
    );
}

/// Refers to the objects of the source series (PS3.3 C.12.2).
fn refer(set: &mut Attributes, derivation: &Derivation) {
    let Some(source) = derivation.identified() else {
        return;
    };
    let instances = source.instances.iter().map(|i| {
        let mut item = Attributes::new();
        item.text(tags::REFERENCED_SOP_CLASS_UID, VR::UI, &source.class);
        item.text(tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, &i.uid);
        item
    });
    let mut series = Attributes::new();
    series.sequence(tags::REFERENCED_INSTANCE_SEQUENCE, instances);
    series.text(tags::SERIES_INSTANCE_UID, VR::UI, &source.series);
    set.sequence(tags::REFERENCED_SERIES_SEQUENCE, [series]);
}

/// A colour in DICOM's 16-bit CIELab (white point D50). Source: DICOM PS3.3 C.10.7.1.1.
fn lab_of_rgb(rgb: [u8; 3]) -> [u16; 3] {
    let linear = rgb.map(|v| {
        let v = f64::from(v) / 255.0;
        if v <= 0.040_45 {
            v / 12.92
        } else {
            ((v + 0.055) / 1.055).powf(2.4)
        }
    });
    // Linear sRGB to D50 (Bradford).
    let xyz_from_rgb = DMat3::from_cols(
        DVec3::new(0.436_075, 0.222_504, 0.013_932),
        DVec3::new(0.385_065, 0.716_879, 0.097_105),
        DVec3::new(0.143_080, 0.060_617, 0.714_173),
    );
    let xyz = xyz_from_rgb * DVec3::from_array(linear) / DVec3::new(0.9642, 1.0, 0.8249);
    let [x, y, z] = xyz.to_array().map(|t| {
        let edge = 6.0f64 / 29.0;
        if t > edge.powi(3) {
            t.cbrt()
        } else {
            t / (3.0 * edge * edge) + 4.0 / 29.0
        }
    });
    let (l, a, b) = (116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z));
    let coded = |v: f64| (v * 65_535.0 + 0.5).clamp(0.0, 65_535.0) as u16;
    [
        coded(l / 100.0),
        coded((a + 128.0) / 255.0),
        coded((b + 128.0) / 255.0),
    ]
}
