//! A volume as a series of slices, one file each.

use super::attributes::{Attributes, Derivation, StorageClass, image};
use super::pixels::PixelEncoding;
use super::uid::{ContentDigest, UidRole, placeholders};
use crate::files::OutputFolder;
use crate::volume::load::Origin;
use crate::volume::{GridGeometry, Rescale, Volume};
use crate::{Error, Result};
use dicom_core::VR;
use dicom_dictionary_std::tags;
use glam::DVec3;

/// Largest cosine of the angle between rows and columns that counts as a right angle.
const RIGHT_ANGLE: f64 = 1e-4;
/// Smallest part of the distance between slices that lies along their normal: a tilt of 87 degrees.
const MIN_NORMAL_SHARE: f64 = 0.05;

/// The planes of a grid.
struct SlicePlanes {
    grid: GridGeometry,
    /// Unit vectors of increasing column and row, and their normal.
    along: [DVec3; 2],
    normal: DVec3,
    /// Distance between columns, rows and, along the normal, slices, mm.
    spacing_mm: [f64; 3],
    /// Whether slices advance against the normal: readers sort along it, so they are numbered in
    /// reverse.
    reversed: bool,
}

impl SlicePlanes {
    fn new(grid: &GridGeometry) -> Result<Self, String> {
        let m = grid.world_from_voxel.matrix3;
        let along = [m.x_axis.normalize_or_zero(), m.y_axis.normalize_or_zero()];
        let angle = along[0].dot(along[1]);
        if angle.abs() > RIGHT_ANGLE {
            return Err(format!(
                "rows and columns of the volume are at an angle of {:.2} degrees; DICOM needs a right angle; write .nii.gz or .nrrd instead",
                angle.clamp(-1.0, 1.0).acos().to_degrees()
            ));
        }
        let normal = along[0].cross(along[1]).normalize_or_zero();
        let step = m.z_axis.dot(normal);
        if step.abs() < MIN_NORMAL_SHARE * m.z_axis.length() || step == 0.0 {
            return Err(
                "the slices of the volume are almost parallel to the direction in which they follow each other; write .nii.gz or .nrrd instead"
                    .into(),
            );
        }
        if grid.size[..2].iter().any(|n| *n > usize::from(u16::MAX)) {
            return Err(format!(
                "a DICOM slice has at most 65535 pixels along an edge, not {} x {}",
                grid.size[0], grid.size[1]
            ));
        }
        Ok(Self {
            grid: *grid,
            along,
            normal,
            spacing_mm: [m.x_axis.length(), m.y_axis.length(), step.abs()],
            reversed: step < 0.0,
        })
    }

    /// Centre of the first pixel of a slice, mm.
    fn position(&self, k: usize) -> DVec3 {
        self.grid
            .world_from_voxel
            .transform_point3(DVec3::new(0.0, 0.0, k as f64))
    }

    /// The number of a slice, from 1, ascending along the normal.
    fn number(&self, k: usize) -> usize {
        if self.reversed {
            self.grid.size[2] - k
        } else {
            k + 1
        }
    }
}

/// A slice that has been written, without its UIDs.
struct WrittenSlice {
    name: String,
    number: usize,
    placeholders: Vec<(usize, UidRole)>,
}

/// A series being written: pixels are appended in voxel order.
pub struct SeriesWriter<'a> {
    folder: OutputFolder,
    planes: SlicePlanes,
    class: StorageClass,
    /// The attributes that all slices share.
    template: Attributes,
    /// The source, if it is to be referred to.
    source: Option<&'a Origin>,
    digest: ContentDigest,
    written: Vec<WrittenSlice>,
    /// Pixels of the slice that is not yet complete.
    pixels: Vec<u8>,
}

impl<'a> SeriesWriter<'a> {
    /// Begins a series in a folder: a volume on `grid`, with pixels in `encoding`.
    ///
    /// # Errors
    /// A grid that slices cannot represent: rows and columns that are not perpendicular, or more
    /// than 65,535 of them.
    pub fn new(
        folder: OutputFolder,
        volume: &Volume,
        grid: &GridGeometry,
        encoding: &PixelEncoding,
        derivation: &Derivation<'a>,
    ) -> Result<Self> {
        let planes = SlicePlanes::new(grid).map_err(|e| Error::file(folder.path(), e))?;
        let class = StorageClass::of(derivation.origin);
        let mut template = image(class, derivation);
        let source = derivation.identified();
        frame_of_reference(&mut template, source);
        template.code(
            tags::DERIVATION_CODE_SEQUENCE,
            "113085",
            "DCM",
            "Spatial resampling",
        );
        plane(&mut template, &planes);
        values(&mut template, volume, encoding, class);
        if class == StorageClass::Pet {
            let slices = grid.size[2].min(usize::from(u16::MAX)) as u16;
            template.whole(tags::NUMBER_OF_SLICES, slices);
        }
        Ok(Self {
            folder,
            planes,
            class,
            template,
            source,
            digest: ContentDigest::default(),
            written: Vec::new(),
            pixels: Vec::new(),
        })
    }

    /// Whether PET is written, whose values need an intercept of 0.
    pub fn is_pet(derivation: &Derivation) -> bool {
        StorageClass::of(derivation.origin) == StorageClass::Pet
    }

    /// Appends pixels: 16 bits each, least significant byte first.
    ///
    /// # Errors
    /// A full disk.
    pub fn push(&mut self, mut bytes: &[u8]) -> Result<()> {
        let [columns, rows, _] = self.planes.grid.size;
        let whole = 2 * columns * rows;
        while !bytes.is_empty() {
            let (now, later) = bytes.split_at(bytes.len().min(whole - self.pixels.len()));
            self.pixels.extend_from_slice(now);
            bytes = later;
            if self.pixels.len() == whole {
                self.write_slice()?;
            }
        }
        Ok(())
    }

    /// Writes the complete slice.
    fn write_slice(&mut self) -> Result<()> {
        let k = self.written.len();
        let number = self.planes.number(k);
        let position = self.planes.position(k);
        let mut slice = self.template.clone();
        slice.text(tags::INSTANCE_NUMBER, VR::IS, number.to_string());
        slice.decimals(tags::IMAGE_POSITION_PATIENT, &position.to_array());
        slice.decimals(tags::SLICE_LOCATION, &[position.dot(self.planes.normal)]);
        if self.class == StorageClass::Pet {
            slice.whole(tags::IMAGE_INDEX, number.min(usize::from(u16::MAX)) as u16);
        }
        if let Some(source) = self.source {
            refer(&mut slice, source, position, self.planes.normal);
        }
        slice.bytes(tags::PIXEL_DATA, VR::OW, std::mem::take(&mut self.pixels));
        let bytes = slice.file().map_err(|e| Error::file(self.folder.path(), e))?;
        self.digest.add(&bytes);
        let header = bytes.len() - self.planes.grid.size[..2].iter().product::<usize>() * 2;
        let digits = self.planes.grid.size[2].to_string().len().max(4);
        let name = format!("slice-{number:0digits$}.dcm");
        self.folder.write(&name, &bytes)?;
        self.written.push(WrittenSlice {
            name,
            number,
            placeholders: placeholders(&bytes[..header]),
        });
        Ok(())
    }

    /// Writes the UIDs and moves the folder into place.
    ///
    /// # Errors
    /// A full disk; fewer pixels than the grid has.
    pub fn finish(self) -> Result<()> {
        if self.written.len() != self.planes.grid.size[2] {
            return Err(Error::file(self.folder.path(), "was not written completely"));
        }
        let uids = self.digest.uids();
        for slice in &self.written {
            let named: Vec<(u64, String)> = slice
                .placeholders
                .iter()
                .map(|(at, role)| (*at as u64, uids.of(*role, slice.number)))
                .collect();
            self.folder
                .replace_bytes(&slice.name, named.iter().map(|(at, uid)| (*at, uid.as_bytes())))?;
        }
        self.folder.finish()
    }
}

/// The frame of reference: the source's if the source may be referred to, since positions stay
/// those of the patient.
fn frame_of_reference(set: &mut Attributes, source: Option<&Origin>) {
    if let Some(source) = source {
        set.copy(
            &source.header,
            &[tags::FRAME_OF_REFERENCE_UID, tags::POSITION_REFERENCE_INDICATOR],
        );
    }
    set.text_if_missing(
        tags::FRAME_OF_REFERENCE_UID,
        VR::UI,
        &UidRole::FrameOfReference.placeholder(),
    );
    set.present(&[(tags::POSITION_REFERENCE_INDICATOR, VR::LO)]);
}

/// The plane of every slice (PS3.3 C.7.6.2), except its position.
fn plane(set: &mut Attributes, planes: &SlicePlanes) {
    let [columns, rows, slices] = planes.spacing_mm;
    let [along, down] = planes.along;
    // Distance between rows, then between columns.
    set.decimals(tags::PIXEL_SPACING, &[rows, columns]);
    set.decimals(
        tags::IMAGE_ORIENTATION_PATIENT,
        &[along.to_array(), down.to_array()].concat(),
    );
    set.decimals(tags::SLICE_THICKNESS, &[slices]);
    set.decimals(tags::SPACING_BETWEEN_SLICES, &[slices]);
    // Both are at most 65,535.
    set.whole(tags::COLUMNS, planes.grid.size[0] as u16);
    set.whole(tags::ROWS, planes.grid.size[1] as u16);
    set.present(&[(tags::PATIENT_ORIENTATION, VR::CS)]);
}

/// How pixels are stored, and what they mean.
fn values(set: &mut Attributes, volume: &Volume, encoding: &PixelEncoding, class: StorageClass) {
    set.whole(tags::SAMPLES_PER_PIXEL, 1);
    let photometric = if volume.inverted {
        "MONOCHROME1"
    } else {
        "MONOCHROME2"
    };
    set.text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, photometric);
    set.whole(tags::BITS_ALLOCATED, 16);
    set.whole(tags::BITS_STORED, 16);
    set.whole(tags::HIGH_BIT, 15);
    set.whole(tags::PIXEL_REPRESENTATION, u16::from(encoding.signed));
    if let Some([low, high]) = encoding.padding {
        set.pixel(tags::PIXEL_PADDING_VALUE, low, encoding.signed);
        if high != low {
            set.pixel(tags::PIXEL_PADDING_RANGE_LIMIT, high, encoding.signed);
        }
    }
    // Required in CT and PET; no part of MR unless it says something.
    let stated = matches!(class, StorageClass::Ct | StorageClass::Pet);
    if stated || encoding.rescale != Rescale::NONE {
        set.decimals(tags::RESCALE_INTERCEPT, &[encoding.rescale.intercept]);
        set.decimals(tags::RESCALE_SLOPE, &[encoding.rescale.slope]);
        match class {
            StorageClass::Ct => set.text_if_missing(tags::RESCALE_TYPE, VR::LO, "HU"),
            StorageClass::Pet => {}
            _ => set.text(tags::RESCALE_TYPE, VR::LO, "US"),
        }
    }
    let [low, high] = volume.window(None, None);
    if high > low && (high - low).is_finite() {
        set.decimals(tags::WINDOW_CENTER, &[0.5 * (low + high)]);
        set.decimals(tags::WINDOW_WIDTH, &[high - low]);
        if high - low < 1.0 {
            // The usual function needs a width of at least 1 (PS3.3 C.11.2.1.2).
            set.text(tags::VOILUT_FUNCTION, VR::CS, "LINEAR_EXACT");
        }
    }
}

/// Refers to the slice of the source that is nearest to a slice (PS3.3 C.7.6.1.1.4, C.12.2).
fn refer(set: &mut Attributes, source: &Origin, position: DVec3, normal: DVec3) {
    let off = |p: Option<DVec3>| p.map_or(0.0, |p| (p - position).dot(normal).abs());
    let Some(nearest) = source
        .instances
        .iter()
        .min_by(|a, b| off(a.position).total_cmp(&off(b.position)))
    else {
        return;
    };
    let mut reference = Attributes::new();
    reference.text(tags::REFERENCED_SOP_CLASS_UID, VR::UI, &source.class);
    reference.text(tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, &nearest.uid);
    let mut series = Attributes::new();
    series.text(tags::SERIES_INSTANCE_UID, VR::UI, &source.series);
    series.sequence(tags::REFERENCED_INSTANCE_SEQUENCE, [reference.clone()]);
    reference.code(
        tags::PURPOSE_OF_REFERENCE_CODE_SEQUENCE,
        "121322",
        "DCM",
        "Source image for image processing operation",
    );
    set.sequence(tags::SOURCE_IMAGE_SEQUENCE, [reference]);
    set.sequence(tags::REFERENCED_SERIES_SEQUENCE, [series]);
}
