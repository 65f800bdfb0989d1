//! Spatial transforms as written by registration programs: affine matrices, displacement fields,
//! B-spline grids, and chains of them.
//!
//! A registration's transform maps a point of the *fixed* image (the output) to the point of the
//! *moving* image shown there, that is, a deformed point to its source. Everything is converted to
//! patient LPS millimetres on reading; vectors are rotated with the axes.
//!
//! | format | direction in the file | space | read as |
//! |---|---|---|---|
//! | ITK `.tfm`, `.txt`, `.mat` (MATLAB 4, as ANTs writes), `.h5` | fixed to moving | LPS | unchanged |
//! | elastix `TransformParameters.N.txt` | fixed to moving | LPS | unchanged |
//! | AFNI `.1D`, `.aff12.1D`, `.afni` | base to source | LPS ("DICOM order") | unchanged |
//! | FreeSurfer `.lta` | `src` to `dst`, `src` being the moving image | RAS, or voxels | inverted |
//! | FreeSurfer `register.dat` | target to moving | tkregister's | needs both grids |
//! | FSL `.mat`, `.fsl`, decimal or hexadecimal | moving to reference | millimetres from the first voxel, x flipped where the axes are right-handed | inverted; needs both grids |
//! | MRtrix `.txt` (a comment names it); others with `convention=ras` | fixed to moving | RAS | unchanged |
//! | MNI `.xfm` | source to target | RAS | inverted; if written by ITK: LPS, unchanged |
//! | NIfTI vectors, intent 1007 (ITK, ANTs) / 1006 | fixed to moving | LPS / RAS | unchanged |
//! | NIfTI vectors named "Mapping" (SPM `y_*.nii`) | fixed to moving, positions | RAS | minus their voxels' positions |
//! | NIfTI, intent 2006 (FSL) | reference to moving, relative or absolute | as FSL's matrices | vectors along the grid's axes, or exactly with the moving grid |
//! | NRRD, MetaImage vectors | fixed to moving | the file's | unchanged |

mod affine_files;
mod bspline;
mod elastix;
mod field;
mod itk;
mod numbers;

pub use bspline::BSplineGrid;
pub(crate) use bspline::cubic_weights;
pub use field::VectorField;

use crate::files::input;
use crate::volume::GridGeometry;
use crate::volume::load::{self, ReadOptions};
use crate::{Error, Result, Watch};
use glam::{DAffine3, DMat3, DVec3};
use std::path::Path;

/// What can be read, for messages.
const SUPPORTED: &str = "ITK (.tfm, .txt, .mat, .h5), elastix, FSL, FreeSurfer (.lta, .dat), AFNI (.1D), MRtrix, MNI (.xfm) and vector images";
/// First bytes of HDF5 files.
#[cfg(feature = "hdf5")]
const HDF5_START: &[u8] = b"\x89HDF\r\n\x1a\n";

/// One step of a chain.
pub enum TransformStep {
    /// The same everywhere.
    Affine(DAffine3),
    /// A displacement on a grid; nothing moves outside it.
    Field(VectorField),
    /// B-splines on a coarse grid.
    BSpline(BSplineGrid),
}

/// Steps that carry a deformed point to its source, in order.
pub struct Transform {
    /// The steps.
    pub steps: Vec<TransformStep>,
    /// Irregularities of the files, one sentence each.
    pub warnings: Vec<String>,
}

/// Information that a file lacks.
#[derive(Clone, Copy, Debug, Default)]
pub struct TransformContext<'a> {
    /// The deformed image: FSL's moving image.
    pub moving: Option<GridGeometry>,
    /// The grid of the output: FSL's reference image.
    pub reference: Option<GridGeometry>,
    /// The convention of the vectors, where the file does not state it or states it wrongly: `lps`,
    /// `ras`, `fsl`, `fsl-absolute`.
    pub convention: Option<&'a str>,
}

/// FSL's millimetres from voxels: spacing, with x measured from the other end where the voxel axes
/// are right-handed.
fn fsl_from_voxel(grid: &GridGeometry) -> DAffine3 {
    let m = grid.world_from_voxel.matrix3;
    let spacing = DVec3::new(m.x_axis.length(), m.y_axis.length(), m.z_axis.length());
    // LPS and RAS differ by a rotation: the handedness is the same.
    if m.determinant() > 0.0 {
        let top = (grid.size[0] - 1) as f64 * spacing.x;
        DAffine3 {
            matrix3: DMat3::from_diagonal(DVec3::new(-spacing.x, spacing.y, spacing.z)),
            translation: DVec3::new(top, 0.0, 0.0),
        }
    } else {
        DAffine3::from_scale(spacing)
    }
}

/// World from FSL's millimetres.
fn world_from_fsl(grid: &GridGeometry) -> DAffine3 {
    grid.world_from_voxel * fsl_from_voxel(grid).inverse()
}

/// What a file is that another program writes and that cannot be read, and what to do; none for
/// other files.
fn foreign(name: &str, bytes: &[u8]) -> Option<&'static str> {
    let ends = |endings: &[&str]| endings.iter().any(|e| name.ends_with(e));
    Some(match () {
        () if bytes.starts_with(b"MATLAB 5.0 MAT-file") || bytes.starts_with(b"MATLAB 7.3 MAT-file") => {
            "is a MATLAB file of version 5 or later, as SPM writes (_sn.mat, _seg8.mat); write the deformation as an image instead (SPM: y_*.nii)"
        }
        () if ends(&[".m3z", ".m3d"]) => {
            "is a FreeSurfer morph (.m3z), which cannot be read; convert it with mri_warp_convert --inm3z FILE --outitk warp.nii.gz"
        }
        () if ends(&[".mgz", ".mgh"]) => {
            "is a FreeSurfer image (.mgz), which cannot be read; convert it with mri_warp_convert or mri_convert to .nii.gz"
        }
        () if ends(&[".x5"]) => {
            "is in the X5 format, which cannot be read; save it as .tfm or as a displacement field"
        }
        () if bytes.starts_with(&[0x1f, 0x8b]) => "is compressed; decompress it with gunzip",
        () => return None,
    })
}

impl Transform {
    /// An affine transform.
    pub fn affine(source_from_deformed: DAffine3) -> Self {
        Self {
            steps: vec![TransformStep::Affine(source_from_deformed)],
            warnings: Vec::new(),
        }
    }

    /// Reads a transform in any of the formats above.
    ///
    /// # Errors
    /// A file that cannot be read, has another format, or lacks required information; the message
    /// states the remedy.
    pub fn load(path: &Path, context: &TransformContext) -> Result<Self> {
        let name = path
            .file_name()
            .map(|n| n.to_string_lossy().to_ascii_lowercase())
            .unwrap_or_default();
        let ends = |endings: &[&str]| endings.iter().any(|e| name.ends_with(e));
        if ends(&[".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd"]) {
            let image = load::image(path, &ReadOptions::default(), &Watch::NONE)?;
            let warnings = image.warnings.clone();
            return Ok(Self {
                steps: vec![TransformStep::Field(VectorField::of_image(
                    path, &image, context,
                )?)],
                warnings,
            });
        }
        if ends(&[".h5", ".hdf5"]) {
            #[cfg(feature = "hdf5")]
            return itk::read_hdf5(path);
            #[cfg(not(feature = "hdf5"))]
            return Err(Error::file(
                path,
                "is an HDF5 transform; build with the feature `hdf5` to read it, or save it as .tfm",
            ));
        }
        let bytes = input::bytes(path, 1 << 30, "transform of a known format")?;
        #[cfg(feature = "hdf5")]
        if bytes.starts_with(HDF5_START) {
            return itk::read_hdf5(path);
        }
        if let Some(problem) = foreign(&name, &bytes) {
            return Err(Error::file(path, problem));
        }
        if let Some(transform) = itk::read_matlab(path, &bytes)? {
            return Ok(transform);
        }
        let unreadable = || {
            Error::file(
                path,
                format!("is not a readable transform; supported: {SUPPORTED}"),
            )
        };
        let text = std::str::from_utf8(&bytes).map_err(|_| unreadable())?;
        let text = text.trim_start_matches('\u{feff}').trim_start();
        if text.starts_with("#Insight Transform File") {
            return itk::read_text(path, text);
        }
        if elastix::is_elastix(text) {
            return elastix::read(path, text);
        }
        affine_files::read(path, &name, text, context)
    }

    /// The source of a deformed point, LPS mm.
    pub fn source_from_deformed(&self, deformed: DVec3) -> DVec3 {
        self.steps.iter().fold(deformed, |p, step| match step {
            TransformStep::Affine(m) => m.transform_point3(p),
            TransformStep::Field(f) => f.source_from_deformed(p),
            TransformStep::BSpline(b) => b.source_from_deformed(p),
        })
    }

    /// The transform that applies `self` first and then `next`.
    pub fn then(mut self, next: Self) -> Self {
        self.steps.extend(next.steps);
        self.warnings.extend(next.warnings);
        self
    }

    /// The inverse, if every step is affine.
    pub fn affine_inverse(&self) -> Option<Self> {
        let steps = self.steps.iter().rev().map(|s| match s {
            TransformStep::Affine(m) => Some(TransformStep::Affine(m.inverse())),
            _ => None,
        });
        Some(Self {
            steps: steps.collect::<Option<_>>()?,
            warnings: self.warnings.clone(),
        })
    }

    /// The finest grid among the steps, if any has one.
    pub fn grid(&self) -> Option<GridGeometry> {
        let grids = self.steps.iter().filter_map(|s| match s {
            TransformStep::Affine(_) => None,
            TransformStep::Field(f) => Some(f.grid),
            TransformStep::BSpline(b) => Some(b.fine_grid()),
        });
        grids.max_by_key(|g| g.size.iter().product::<usize>())
    }

    /// The whole transform as one affine, if every step is affine.
    pub fn as_affine(&self) -> Option<DAffine3> {
        self.steps.iter().try_fold(DAffine3::IDENTITY, |all, s| match s {
            TransformStep::Affine(m) => Some(*m * all),
            _ => None,
        })
    }
}
