//! Writing DICOM: a volume as a series of slices, a label map as a segmentation, a picture as a
//! secondary capture. Explicit VR, little endian, uncompressed.
//!
//! A volume from a CT, MR or PET series keeps its storage class, so that viewers treat it as they
//! treat the original. Any other volume is a secondary capture whose slices state their position:
//! the class has no plane of its own, but ITK, GDCM, dcm2niix and 3D Slicer read positions in every
//! class, and CT or MR would claim a modality that is not known.
//!
//! Nothing about a patient is written unless requested: neither name nor dates nor the UIDs of the
//! source, which identify it in an archive. UIDs are derived from the content (`uid.rs`), hence the
//! same content has the same UIDs.
//!
//! Source: DICOM PS3.3 (information objects), PS3.5 (encoding), PS3.10 (files).

mod attributes;
mod numbers;
mod picture;
mod pixels;
mod planes;
mod segmentation;
mod series;
mod uid;

pub use attributes::Derivation;
pub use picture::secondary_capture;
pub use pixels::PixelEncoding;
pub use segmentation::SegmentationWriter;
pub use series::SeriesWriter;
