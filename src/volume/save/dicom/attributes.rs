//! The attributes of derived objects: who and what they show, and what they are derived from.

use super::numbers::decimals;
use super::uid::{ContentDigest, UidRole, placeholders};
use crate::volume::load::Origin;
use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::InMemDicomObject;
use dicom_object::meta::FileMetaTableBuilder;

/// This program as a writer of files: a UUID made once, in decimal form.
const IMPLEMENTATION_CLASS_UID: &str = "2.25.18136725231955935183245094479408657599";
/// Longest description of a series (VR LO) and of a derivation (VR ST), characters.
const MAX_SERIES_DESCRIPTION: usize = 64;
const MAX_DERIVATION_DESCRIPTION: usize = 1024;
/// The number of a series that is derived from series n is this plus n.
const DERIVED_SERIES: i64 = 1000;

/// Patient and study, copied on request. The dates are those of the study.
const PATIENT_AND_STUDY: &[Tag] = &[
    tags::PATIENT_NAME,
    tags::PATIENT_ID,
    tags::ISSUER_OF_PATIENT_ID,
    tags::PATIENT_BIRTH_DATE,
    tags::PATIENT_SEX,
    tags::PATIENT_AGE,
    tags::PATIENT_SIZE,
    tags::PATIENT_WEIGHT,
    tags::STUDY_INSTANCE_UID,
    tags::STUDY_DATE,
    tags::STUDY_TIME,
    tags::STUDY_ID,
    tags::STUDY_DESCRIPTION,
    tags::ACCESSION_NUMBER,
    tags::REFERRING_PHYSICIAN_NAME,
];
/// Attributes of patient and study that an object must have, be it empty (type 2).
const PATIENT_AND_STUDY_PRESENT: &[(Tag, VR)] = &[
    (tags::PATIENT_NAME, VR::PN),
    (tags::PATIENT_ID, VR::LO),
    (tags::PATIENT_BIRTH_DATE, VR::DA),
    (tags::PATIENT_SEX, VR::CS),
    (tags::STUDY_DATE, VR::DA),
    (tags::STUDY_TIME, VR::TM),
    (tags::STUDY_ID, VR::SH),
    (tags::ACCESSION_NUMBER, VR::SH),
    (tags::REFERRING_PHYSICIAN_NAME, VR::PN),
];
/// What a scan shows and how it was made, without anything about the patient.
const ANATOMY: &[Tag] = &[tags::BODY_PART_EXAMINED, tags::LATERALITY, tags::PATIENT_POSITION];
const CT: &[Tag] = &[
    tags::KVP,
    tags::X_RAY_TUBE_CURRENT,
    tags::EXPOSURE_TIME,
    tags::FILTER_TYPE,
    tags::CONVOLUTION_KERNEL,
    tags::SCAN_OPTIONS,
    tags::DATA_COLLECTION_DIAMETER,
    tags::RECONSTRUCTION_DIAMETER,
    tags::RESCALE_TYPE,
    tags::ACQUISITION_NUMBER,
];
const MR: &[Tag] = &[
    tags::SCANNING_SEQUENCE,
    tags::SEQUENCE_VARIANT,
    tags::SCAN_OPTIONS,
    tags::MR_ACQUISITION_TYPE,
    tags::REPETITION_TIME,
    tags::ECHO_TIME,
    tags::ECHO_TRAIN_LENGTH,
    tags::INVERSION_TIME,
    tags::FLIP_ANGLE,
    tags::MAGNETIC_FIELD_STRENGTH,
    tags::IMAGING_FREQUENCY,
    tags::IMAGED_NUCLEUS,
    tags::NUMBER_OF_AVERAGES,
    tags::ACQUISITION_NUMBER,
];
const PET: &[Tag] = &[
    tags::UNITS,
    tags::SUV_TYPE,
    tags::COUNTS_SOURCE,
    tags::SERIES_TYPE,
    tags::DECAY_CORRECTION,
    tags::COLLIMATOR_TYPE,
    tags::CORRECTED_IMAGE,
    tags::REPROJECTION_METHOD,
    tags::ATTENUATION_CORRECTION_METHOD,
    tags::RECONSTRUCTION_METHOD,
    tags::SCATTER_CORRECTION_METHOD,
    tags::RANDOMS_CORRECTION_METHOD,
    tags::FRAME_REFERENCE_TIME,
    tags::ACTUAL_FRAME_DURATION,
    tags::DECAY_FACTOR,
    tags::DOSE_CALIBRATION_FACTOR,
    tags::PATIENT_ORIENTATION_CODE_SEQUENCE,
    tags::PATIENT_GANTRY_RELATIONSHIP_CODE_SEQUENCE,
];
/// The tracer, without the times of its injection.
const TRACER: &[Tag] = &[
    tags::RADIOPHARMACEUTICAL,
    tags::RADIONUCLIDE_TOTAL_DOSE,
    tags::RADIONUCLIDE_HALF_LIFE,
    tags::RADIONUCLIDE_POSITRON_FRACTION,
    tags::RADIONUCLIDE_CODE_SEQUENCE,
];

/// What a derived object states of its content and its source.
pub struct Derivation<'a> {
    /// What was done to the source.
    pub description: String,
    /// Description of the new series.
    pub series_description: String,
    /// The series that the content is derived from, if it is known.
    pub origin: Option<&'a Origin>,
    /// Whether patient, study and references to the source are copied from it.
    pub patient: bool,
}

impl<'a> Derivation<'a> {
    /// The source, if its patient and study are to be copied.
    pub(super) fn identified(&self) -> Option<&'a Origin> {
        self.origin.filter(|_| self.patient)
    }
}

/// The storage classes of written images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StorageClass {
    Ct,
    Mr,
    Pet,
    SecondaryCapture,
}

impl StorageClass {
    /// The class for a volume from a series: CT, MR and PET keep theirs, as single slices.
    pub fn of(origin: Option<&Origin>) -> Self {
        match origin.map_or("", |o| o.class.as_str()) {
            uids::CT_IMAGE_STORAGE
            | uids::ENHANCED_CT_IMAGE_STORAGE
            | uids::LEGACY_CONVERTED_ENHANCED_CT_IMAGE_STORAGE => Self::Ct,
            uids::MR_IMAGE_STORAGE
            | uids::ENHANCED_MR_IMAGE_STORAGE
            | uids::LEGACY_CONVERTED_ENHANCED_MR_IMAGE_STORAGE => Self::Mr,
            uids::POSITRON_EMISSION_TOMOGRAPHY_IMAGE_STORAGE
            | uids::ENHANCED_PET_IMAGE_STORAGE
            | uids::LEGACY_CONVERTED_ENHANCED_PET_IMAGE_STORAGE => Self::Pet,
            _ => Self::SecondaryCapture,
        }
    }

    fn uid(self) -> &'static str {
        match self {
            Self::Ct => uids::CT_IMAGE_STORAGE,
            Self::Mr => uids::MR_IMAGE_STORAGE,
            Self::Pet => uids::POSITRON_EMISSION_TOMOGRAPHY_IMAGE_STORAGE,
            Self::SecondaryCapture => uids::SECONDARY_CAPTURE_IMAGE_STORAGE,
        }
    }
}

/// The data set of an object being written.
#[derive(Clone)]
pub(super) struct Attributes(pub InMemDicomObject);

impl Attributes {
    pub fn new() -> Self {
        Self(InMemDicomObject::new_empty())
    }

    pub fn text(&mut self, tag: Tag, vr: VR, value: impl Into<String>) {
        self.0
            .put(DataElement::new(tag, vr, PrimitiveValue::from(value.into())));
    }

    pub fn whole(&mut self, tag: Tag, value: u16) {
        self.0
            .put(DataElement::new(tag, VR::US, PrimitiveValue::from(value)));
    }

    /// A pixel value, in the sign of the pixels.
    pub fn pixel(&mut self, tag: Tag, value: f64, signed: bool) {
        let (vr, value) = if signed {
            (VR::SS, PrimitiveValue::from(value as i16))
        } else {
            (VR::US, PrimitiveValue::from(value as u16))
        };
        self.0.put(DataElement::new(tag, vr, value));
    }

    pub fn decimals(&mut self, tag: Tag, values: &[f64]) {
        self.text(tag, VR::DS, decimals(values));
    }

    pub fn bytes(&mut self, tag: Tag, vr: VR, mut bytes: Vec<u8>) {
        if bytes.len() % 2 == 1 {
            bytes.push(0);
        }
        self.0.put(DataElement::new(tag, vr, PrimitiveValue::from(bytes)));
    }

    pub fn sequence(&mut self, tag: Tag, items: impl IntoIterator<Item = Self>) {
        let items: Vec<InMemDicomObject> = items.into_iter().map(|i| i.0).collect();
        self.0
            .put(DataElement::new(tag, VR::SQ, DataSetSequence::from(items)));
    }

    /// A sequence of one coded concept.
    pub fn code(&mut self, tag: Tag, value: &str, scheme: &str, meaning: &str) {
        let mut item = Self::new();
        item.text(tags::CODE_VALUE, VR::SH, value);
        item.text(tags::CODING_SCHEME_DESIGNATOR, VR::SH, scheme);
        item.text(tags::CODE_MEANING, VR::LO, meaning);
        self.sequence(tag, [item]);
    }

    /// Copies elements as they are; those of unknown form are left out.
    pub fn copy(&mut self, from: &InMemDicomObject, wanted: &[Tag]) {
        let elements = wanted.iter().filter_map(|tag| from.get(*tag));
        for element in elements.filter(|e| e.vr() != VR::UN) {
            self.0.put(element.clone());
        }
    }

    /// Adds empty elements where there are none.
    pub fn present(&mut self, wanted: &[(Tag, VR)]) {
        for (tag, vr) in wanted {
            if self.0.get(*tag).is_some() {
                continue;
            }
            if *vr == VR::SQ {
                self.sequence(*tag, []);
            } else {
                self.0.put(DataElement::new(*tag, *vr, PrimitiveValue::Empty));
            }
        }
    }

    /// Adds a text where there is none, or an empty one.
    pub fn text_if_missing(&mut self, tag: Tag, vr: VR, value: &str) {
        let text = self.0.get(tag).and_then(|e| e.to_str().ok());
        if text.is_none_or(|t| t.trim().is_empty()) {
            self.text(tag, vr, value);
        }
    }

    /// The bytes of a file.
    pub fn file(self) -> Result<Vec<u8>, String> {
        let version = format!("INCISE_{}", env!("CARGO_PKG_VERSION"));
        let meta = FileMetaTableBuilder::new()
            .transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN)
            .implementation_class_uid(IMPLEMENTATION_CLASS_UID)
            .implementation_version_name(version.chars().take(16).collect::<String>());
        let mut bytes = Vec::new();
        self.0
            .with_meta(meta)
            .map_err(|e| e.to_string())?
            .write_all(&mut bytes)
            .map_err(|e| e.to_string())?;
        Ok(bytes)
    }

    /// The bytes of a file that is the only one of its series, with its UIDs; it ends with this
    /// number of bytes of pixels.
    pub fn single_file(self, pixel_bytes: usize) -> Result<Vec<u8>, String> {
        let mut bytes = self.file()?;
        let mut digest = ContentDigest::default();
        digest.add(&bytes);
        let uids = digest.uids();
        let header = bytes.len().saturating_sub(pixel_bytes);
        for (at, role) in placeholders(&bytes[..header]) {
            let uid = uids.of(role, 1);
            bytes[at..at + uid.len()].copy_from_slice(uid.as_bytes());
        }
        Ok(bytes)
    }
}

/// The attributes that every derived object has: identity, patient, study, series, equipment and
/// derivation. UIDs of this object and its series are placeholders.
pub(super) fn derived(class: &str, modality: &str, derivation: &Derivation) -> Attributes {
    let mut set = Attributes::new();
    set.text(tags::SPECIFIC_CHARACTER_SET, VR::CS, "ISO_IR 192");
    set.text(tags::SOP_CLASS_UID, VR::UI, class);
    set.text(tags::SOP_INSTANCE_UID, VR::UI, UidRole::Instance.placeholder());
    set.text(tags::SERIES_INSTANCE_UID, VR::UI, UidRole::Series.placeholder());
    let mut name = derivation.series_description.clone();
    let mut number = 1;
    if let Some(origin) = derivation.identified() {
        set.copy(&origin.header, PATIENT_AND_STUDY);
        let own = origin.text(tags::SERIES_DESCRIPTION);
        if !own.is_empty() {
            name = format!("{name}: {own}");
        }
        let source = origin.text(tags::SERIES_NUMBER).parse::<i32>().unwrap_or(0);
        number = DERIVED_SERIES + i64::from(source);
    }
    set.present(PATIENT_AND_STUDY_PRESENT);
    set.text_if_missing(tags::STUDY_INSTANCE_UID, VR::UI, &UidRole::Study.placeholder());
    set.text(tags::MODALITY, VR::CS, modality);
    set.text(tags::SERIES_NUMBER, VR::IS, number.to_string());
    set.text(
        tags::SERIES_DESCRIPTION,
        VR::LO,
        shortened(&name.replace('\\', "/"), MAX_SERIES_DESCRIPTION),
    );
    set.text(tags::MANUFACTURER, VR::LO, "incise");
    set.text(tags::MANUFACTURER_MODEL_NAME, VR::LO, "incise");
    set.text(tags::SOFTWARE_VERSIONS, VR::LO, env!("CARGO_PKG_VERSION"));
    set.text(
        tags::DERIVATION_DESCRIPTION,
        VR::ST,
        shortened(&derivation.description, MAX_DERIVATION_DESCRIPTION),
    );
    set
}

/// The attributes of an image of a storage class.
pub(super) fn image(class: StorageClass, derivation: &Derivation) -> Attributes {
    let modality = match class {
        StorageClass::Ct => "CT",
        StorageClass::Mr => "MR",
        StorageClass::Pet => "PT",
        StorageClass::SecondaryCapture => "OT",
    };
    let mut set = derived(class.uid(), modality, derivation);
    // CT and MR have a third value (PS3.3 C.8.2.1.1.1, C.8.3.1.1.1).
    let kind = match class {
        StorageClass::Ct => "DERIVED\\SECONDARY\\AXIAL",
        StorageClass::Mr => "DERIVED\\SECONDARY\\OTHER",
        _ => "DERIVED\\SECONDARY",
    };
    set.text(tags::IMAGE_TYPE, VR::CS, kind);
    if let Some(origin) = derivation
        .origin
        .filter(|_| class != StorageClass::SecondaryCapture)
    {
        set.copy(&origin.header, ANATOMY);
        set.present(&[(tags::PATIENT_POSITION, VR::CS)]);
        match class {
            StorageClass::Ct => set.copy(&origin.header, CT),
            StorageClass::Mr => set.copy(&origin.header, MR),
            _ => copy_pet(&mut set, origin, derivation.patient),
        }
    }
    match class {
        StorageClass::Ct => set.present(&[(tags::KVP, VR::DS), (tags::ACQUISITION_NUMBER, VR::IS)]),
        StorageClass::Mr => {
            set.text_if_missing(tags::SCANNING_SEQUENCE, VR::CS, "RM");
            set.text_if_missing(tags::SEQUENCE_VARIANT, VR::CS, "NONE");
            set.present(&[
                (tags::SCAN_OPTIONS, VR::CS),
                (tags::MR_ACQUISITION_TYPE, VR::CS),
                (tags::REPETITION_TIME, VR::DS),
                (tags::ECHO_TIME, VR::DS),
                (tags::ECHO_TRAIN_LENGTH, VR::IS),
            ]);
        }
        StorageClass::Pet => {}
        StorageClass::SecondaryCapture => set.text(tags::CONVERSION_TYPE, VR::CS, "WSD"),
    }
    set
}

/// The attributes of PET series and images (PS3.3 C.8.9). Their dates and times are required; where
/// they must not be stated, they are those of no scan.
fn copy_pet(set: &mut Attributes, origin: &Origin, patient: bool) {
    set.copy(&origin.header, PET);
    let mut tracer = Attributes::new();
    let item = origin
        .header
        .get(tags::RADIOPHARMACEUTICAL_INFORMATION_SEQUENCE)
        .and_then(|e| e.items()?.first());
    if let Some(item) = item {
        tracer.copy(item, TRACER);
        if patient {
            tracer.copy(
                item,
                &[
                    tags::RADIOPHARMACEUTICAL_START_TIME,
                    tags::RADIOPHARMACEUTICAL_START_DATE_TIME,
                ],
            );
        }
    }
    tracer.present(&[(tags::RADIONUCLIDE_CODE_SEQUENCE, VR::SQ)]);
    set.sequence(tags::RADIOPHARMACEUTICAL_INFORMATION_SEQUENCE, [tracer]);
    if patient {
        set.copy(
            &origin.header,
            &[
                tags::SERIES_DATE,
                tags::SERIES_TIME,
                tags::ACQUISITION_DATE,
                tags::ACQUISITION_TIME,
            ],
        );
    }
    for (tag, vr, value) in [
        (tags::SERIES_DATE, VR::DA, "19000101"),
        (tags::SERIES_TIME, VR::TM, "000000"),
        (tags::UNITS, VR::CS, "NONE"),
        (tags::COUNTS_SOURCE, VR::CS, "EMISSION"),
        (tags::SERIES_TYPE, VR::CS, "STATIC\\IMAGE"),
        (tags::DECAY_CORRECTION, VR::CS, "NONE"),
        (tags::FRAME_REFERENCE_TIME, VR::DS, "0"),
        (tags::ACTUAL_FRAME_DURATION, VR::IS, "0"),
    ] {
        set.text_if_missing(tag, vr, value);
    }
    set.present(&[
        (tags::COLLIMATOR_TYPE, VR::CS),
        (tags::CORRECTED_IMAGE, VR::CS),
        (tags::ACQUISITION_DATE, VR::DA),
        (tags::ACQUISITION_TIME, VR::TM),
        (tags::PATIENT_ORIENTATION_CODE_SEQUENCE, VR::SQ),
        (tags::PATIENT_GANTRY_RELATIONSHIP_CODE_SEQUENCE, VR::SQ),
    ]);
}

/// A text of at most `most` characters.
fn shortened(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most - 3).chain("...".chars()).collect()
}
