//! A volume as a series of slices, one file each.

use super::attributes::{Attributes, Derivation, StorageClass, image};
use super::pixels::PixelEncoding;
use super::planes::{SlicePlanes, frame_of_reference};
use super::uid::{ContentDigest, UidRole, placeholders};
use crate::files::OutputFolder;
use crate::volume::load::Origin;
use crate::volume::{GridGeometry, Rescale, Volume};
use crate::{Error, Result};
use dicom_core::VR;
use dicom_dictionary_std::tags;
use glam::DVec3;

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
        planes.measures(&mut template);
        planes.orientation(&mut template);
        planes.extent(&mut template);
        template.present(&[(tags::PATIENT_ORIENTATION, VR::CS)]);
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
