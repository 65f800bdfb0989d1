//! Reading volumes and vector images. One file per format.
//!
//! The reader is chosen by the file's extension if it is known, else by its first bytes. A file
//! whose first bytes contradict its extension is rejected, and the message names the actual format.

mod dicom;
mod image;
mod metaimage;
mod nifti;
mod npy;
mod nrrd;
mod planes;
mod raw;
mod read_options;
mod scalar_type;
mod slices;
mod source;
mod text;
mod tiff;
mod vti;
mod vtk;
mod zarr;

pub use dicom::{Origin, OriginInstance, SeriesInfo};
pub use image::{Channel, Image, Layout, Meaning};
pub use read_options::{RawLayout, ReadOptions};
pub use scalar_type::ScalarType;

use super::{StoredValues, Volume, Voxels, phantom};
use crate::panic_guard::catch_panic;
use crate::{Error, Result, Watch};
use std::io::BufReader;
use std::path::Path;

/// Extensions of readable files, for messages.
pub const FORMATS: &str = "DICOM (a file, a folder or a .zip), NIfTI (.nii, .nii.gz, .hdr/.img), NRRD (.nrrd, .nhdr), MetaImage (.mha, .mhd), \
VTK (.vti, .vtk), TIFF, PNG, JPEG (one, or a folder of slices), NumPy (.npy, .npz), OME-Zarr (a folder or a .zip) and raw data (.raw)";
/// Number of bytes by which a format is recognised.
const START: u64 = 1024;

/// The formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FileFormat {
    Dicom,
    Nifti,
    Nrrd,
    MetaImage,
    Vti,
    Vtk,
    Tiff,
    Picture,
    Npy,
    Npz,
    Zip,
    Raw,
}

impl FileFormat {
    /// Its name, and the expected extension.
    fn called(self) -> &'static str {
        match self {
            Self::Dicom => "DICOM (.dcm)",
            Self::Nifti => "NIfTI (.nii, .nii.gz or .hdr)",
            Self::Nrrd => "NRRD (.nrrd)",
            Self::MetaImage => "MetaImage (.mha)",
            Self::Vti => "VTK XML (.vti)",
            Self::Vtk => "legacy VTK (.vtk)",
            Self::Tiff => "TIFF (.tif)",
            Self::Picture => "a picture (.png or .jpg)",
            Self::Npy => "NumPy (.npy)",
            Self::Npz => "NumPy arrays (.npz)",
            Self::Zip => "a zip (.zip)",
            Self::Raw => "raw data (.raw)",
        }
    }

    /// By file name.
    fn of_name(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        let ends = |endings: &[&str]| endings.iter().any(|e| name.ends_with(e));
        Some(match () {
            () if ends(&[".nii", ".nii.gz", ".hdr", ".hdr.gz", ".img", ".img.gz"]) => Self::Nifti,
            () if ends(&[".nrrd", ".nhdr"]) => Self::Nrrd,
            () if ends(&[".mha", ".mhd"]) => Self::MetaImage,
            () if ends(&[".vti"]) => Self::Vti,
            () if ends(&[".vtk"]) => Self::Vtk,
            () if ends(&[".tif", ".tiff"]) => Self::Tiff,
            () if ends(&[".png", ".jpg", ".jpeg"]) => Self::Picture,
            () if ends(&[".npy"]) => Self::Npy,
            () if ends(&[".npz"]) => Self::Npz,
            () if ends(&[".dcm", ".dicom", ".ima"]) => Self::Dicom,
            () if ends(&[".zip"]) => Self::Zip,
            () if ends(&[".raw", ".raw.gz"]) => Self::Raw,
            () => return None,
        })
    }

    /// By the first bytes of a file, uncompressed; none if they are ambiguous.
    fn of_start(start: &[u8]) -> Option<Self> {
        let header = |at: usize| {
            start
                .get(at..at + 4)
                .map(|b| i32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        };
        let xml = String::from_utf8_lossy(&start[..start.len().min(512)]).into_owned();
        Some(match () {
            () if dicom::is_dicom(start) => Self::Dicom,
            () if start.starts_with(b"NRRD000") => Self::Nrrd,
            () if start.starts_with(b"ObjectType") || start.starts_with(b"NDims") => Self::MetaImage,
            () if xml.trim_start().starts_with('<') && xml.contains("<VTKFile") => Self::Vti,
            () if start.starts_with(b"# vtk DataFile") => Self::Vtk,
            () if start.starts_with(b"II*\0")
                || start.starts_with(b"MM\0*")
                || start.starts_with(b"II+\0")
                || start.starts_with(b"MM\0+") =>
            {
                Self::Tiff
            }
            () if start.starts_with(b"\x89PNG") || start.starts_with(&[0xff, 0xd8, 0xff]) => Self::Picture,
            () if start.starts_with(b"\x93NUMPY") => Self::Npy,
            () if start.starts_with(b"PK\x03\x04") => Self::Zip,
            () if header(0)
                .is_some_and(|n| [348, 540].contains(&n) || [348, 540].contains(&n.swap_bytes()))
                && start.len() >= 348 =>
            {
                Self::Nifti
            }
            () => return None,
        })
    }
}

/// Reads a volume from a file or folder, or makes the one given by `phantom:NAME[:size=N]` or
/// `function:EXPRESSION` ([`phantom`]).
///
/// # Errors
/// A missing or unreadable file, an unknown format, a damaged file; the message states the remedy.
/// [`Error::Cancelled`].
pub fn volume(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Volume> {
    if let Some(volume) = path.to_str().map(phantom::from_path).transpose()?.flatten() {
        return match choice.stated() {
            Some(name) => Err(Error::value(
                name,
                format!("applies to files, and {} is not read from one", path.display()),
            )),
            None => Ok(volume),
        };
    }
    let volume = image(path, choice, watch)?.into_volume(path, choice)?;
    watch.check()?;
    Ok(volume)
}

/// Reads an image of one or several components.
///
/// # Errors
/// As [`volume`].
pub fn image(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    by_kind(path, choice, watch).map_err(Error::printable)
}

fn by_kind(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let image = by_format(path, choice, watch)?;
    let only = |name: &str, of: &str| {
        Err(Error::value(
            name,
            format!("applies to {of}, but {} is {}", path.display(), image.format),
        ))
    };
    match () {
        () if image.format == "DICOM" => {}
        () if choice.series.is_some() => return only("series", "DICOM"),
        () if choice.resample => return only("resample", "DICOM series"),
        () if choice.level.is_some() && !image.format.starts_with("OME-Zarr") => {
            return only("level", "OME-Zarr");
        }
        () => {}
    }
    Ok(image)
}

fn by_format(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, "opening", e))?;
    if metadata.is_dir() {
        return folder(path, choice, watch);
    }
    if matches!(
        path.file_name().and_then(|n| n.to_str()),
        Some(".zattrs" | ".zgroup" | ".zarray" | "zarr.json")
    ) {
        return zarr::read(path.parent().unwrap_or(Path::new("")), choice, watch);
    }
    if path
        .file_name()
        .is_some_and(|n| n.eq_ignore_ascii_case("DICOMDIR"))
    {
        // The folder contains the files that the DICOMDIR lists.
        let folder = path
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        return dicom::read(folder, choice, watch);
    }
    if metadata.is_file() && metadata.len() == 0 {
        return Err(Error::file(path, "is empty; copy or download it again"));
    }
    match format_of(path, choice)? {
        FileFormat::Zip if zarr::is_zipped(path) => zarr::read(path, choice, watch),
        FileFormat::Zip => dicom::read(path, choice, watch).map_err(|e| match e {
            Error::Cancelled => e,
            e => foreign_zip(path).unwrap_or(e),
        }),
        FileFormat::Dicom => dicom::read(path, choice, watch),
        FileFormat::Nifti => nifti::read(path, choice, watch),
        FileFormat::Nrrd => nrrd::read(path, choice, watch),
        FileFormat::MetaImage => metaimage::read(path, choice, watch),
        FileFormat::Vti => vti::read(path, choice, watch),
        FileFormat::Vtk => vtk::read(path, choice, watch),
        FileFormat::Tiff => tiff::read(path, choice, watch),
        FileFormat::Picture => slices::read(path, choice, watch),
        FileFormat::Npy => npy::read(path, choice, watch),
        FileFormat::Npz => npy::read_archive(path, choice, watch),
        FileFormat::Raw => raw::read(path, choice, watch),
    }
}

/// The error about a zip of files of other formats; none for one without such files.
fn foreign_zip(path: &Path) -> Option<Error> {
    let names = catch_panic(|| -> Option<Vec<String>> {
        let (file, _) = source::open_file(path).ok()?;
        let archive = zip::ZipArchive::new(BufReader::new(file)).ok()?;
        let names = archive.file_names().flatten().map(|n| n.into_owned());
        Some(names.collect())
    })??;
    let others = [FileFormat::Dicom, FileFormat::Zip];
    let is_foreign =
        |name: &&String| FileFormat::of_name(Path::new(name)).is_some_and(|f| !others.contains(&f));
    let name = names.iter().find(is_foreign)?;
    // DICOM often has no extension.
    let may_be_dicom = |name: &String| {
        let path = Path::new(name);
        let is_folder = name.ends_with('/');
        !is_folder && path.extension().is_none() || FileFormat::of_name(path) == Some(FileFormat::Dicom)
    };
    (!names.iter().any(may_be_dicom)).then(|| {
        Error::file(
            path,
            format!("holds {name}, but no DICOM and no OME-Zarr, which are read from a zip; unpack it and name that file"),
        )
    })
}

/// The format of a file.
fn format_of(path: &Path, choice: &ReadOptions) -> Result<FileFormat> {
    if choice.raw.is_some() {
        return Ok(FileFormat::Raw);
    }
    let start = source::first_bytes(path, START)?;
    let (by_name, by_start) = (FileFormat::of_name(path), FileFormat::of_start(&start));
    match (by_name, by_start) {
        // Raw values may resemble any format; the second file of a pair contains only values.
        (Some(FileFormat::Raw), _) => Ok(FileFormat::Raw),
        (Some(FileFormat::Npz), Some(FileFormat::Zip)) => Ok(FileFormat::Npz),
        (Some(FileFormat::Nifti), Some(_))
            if path.to_string_lossy().to_ascii_lowercase().contains(".img") =>
        {
            Ok(FileFormat::Nifti)
        }
        (Some(name), Some(start)) if name != start => Err(Error::file(
            path,
            format!(
                "does not match its extension; its content is {}; rename it",
                start.called()
            ),
        )),
        (Some(name), _) => Ok(name),
        (None, Some(start)) => Ok(start),
        (None, None) if String::from_utf8_lossy(&start).contains("<OME ") => Err(Error::file(
            path,
            "is OME-XML without pixels; name one of the TIFFs that it describes",
        )),
        (None, None) => Err(Error::file(
            path,
            format!("has an unsupported format; supported: {FORMATS}"),
        )),
    }
}

/// A folder: OME-Zarr, DICOM in it or its subfolders, or image slices.
fn folder(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    if zarr::is_zarr(path) {
        return zarr::read(path, choice, watch);
    }
    let pictures = slices::pictures(path)?;
    if pictures.is_empty() || dicom::any(path, watch)? {
        return dicom::read(path, choice, watch);
    }
    slices::read_folder(path, &pictures, choice, watch)
}

/// Whether a file, existing or not, would be read as part of its folder.
pub fn is_part_of(folder: &Path, file: &Path) -> bool {
    let direct = file
        .parent()
        .is_some_and(|p| p.canonicalize().ok() == folder.canonicalize().ok());
    let dicom = source::first_bytes(file, START).is_ok_and(|start| dicom::is_dicom(&start));
    dicom
        || direct
            && slices::is_picture(file)
            && slices::pictures(folder).is_ok_and(|p| p.iter().any(|p| p.file_name() != file.file_name()))
}

/// The DICOM series in a file, folder or zip, the largest first; none if it is not DICOM.
/// `patient`: with the patient's name and ID.
///
/// # Errors
/// A file that cannot be read.
pub fn series(path: &Path, patient: bool, watch: &Watch) -> Result<Option<Vec<SeriesInfo>>> {
    let is_procedural = path.to_str().is_some_and(phantom::is_procedural);
    if is_procedural || path.is_dir() && zarr::is_zarr(path) {
        return Ok(None);
    }
    // If it cannot be opened, the reader will report that.
    let holds = path.is_dir()
        || source::first_bytes(path, START).is_ok_and(|start| {
            matches!(
                FileFormat::of_start(&start),
                Some(FileFormat::Dicom | FileFormat::Zip)
            )
        });
    match holds.then(|| dicom::list(path, patient, watch)) {
        Some(Ok(list)) => Ok(Some(list)),
        Some(Err(Error::Cancelled)) => Err(Error::Cancelled),
        _ => Ok(None),
    }
}
