//! NIfTI-1 and NIfTI-2, in one file (`.nii`) or a pair (`.hdr` and `.img`), plain or gzipped, in
//! either byte order; and Analyze 7.5 pairs, the predecessor of NIfTI-1.
//!
//! Our own code instead of the `nifti` crate: voxels must keep their stored type (it converts
//! before scaling), headers are untrusted (its qform code panics on invalid ones), NIfTI-2 must be
//! supported (it lacks it), and a size in a header must allocate nothing before the file is known
//! to contain it.
//!
//! *Geometry*: sform if its code is positive and it is invertible, else qform, else the plain
//! spacing. NIfTI's world is RAS+, ours is LPS, hence x and y change sign. Source: nifti1.h and
//! nifti2.h (Cox et al. 2004, 2011), "METHOD 2" and "METHOD 3".

use super::super::Rescale;
use super::ReadOptions;
use super::ScalarType;
use super::image::{Image, Layout, Meaning};
use super::source::{ValueReader, check_end, check_held, count, open, read_error, skip};
use crate::{Error, Result, Watch};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use serde_json::json;
use std::io::Read;
use std::path::{Path, PathBuf};

/// NIfTI's intent code of label maps.
const INTENT_LABEL: i16 = 1002;
/// Intents of colours.
const INTENT_RGB: [i16; 2] = [2003, 2004];
/// Intents of vectors.
const INTENT_VECTOR: [i16; 2] = [1006, 1007];
/// Header lengths of the two versions, bytes.
const HEADER_BYTES: [usize; 2] = [348, 540];

/// Reads an image with all its components, or one volume of a time series.
pub fn read(path: &Path, choice: &ReadOptions, watch: &Watch) -> Result<Image> {
    let name = path
        .file_name()
        .map(|n| n.to_string_lossy().into_owned())
        .unwrap_or_default();
    let (header_path, data_path) = match name.to_ascii_lowercase().as_str() {
        n if n.ends_with(".img") || n.ends_with(".img.gz") => {
            (partner(path, &name, "img", "hdr")?, Some(path.to_owned()))
        }
        n if n.ends_with(".hdr") || n.ends_with(".hdr.gz") => {
            (path.to_owned(), Some(partner(path, &name, "hdr", "img")?))
        }
        _ => (path.to_owned(), None),
    };
    let (mut reader, max_bytes) = open(&header_path)?;
    let header = Header::read(&header_path, &mut reader)?;
    match (data_path, header.paired) {
        (Some(data), true) => {
            let (reader, max_bytes) = open(&data)?;
            header.image(&data, reader, max_bytes, 0, choice, watch)
        }
        (None, true) => Err(Error::file(
            path,
            "is the header of a .hdr/.img pair under another name; rename it to .hdr, in the same folder as its .img",
        )),
        // A single file with one of the pair's names.
        (_, false) => header.image(
            &header_path,
            reader,
            max_bytes,
            header.bytes.len() as u64,
            choice,
            watch,
        ),
    }
}

/// The other file of a pair: the same name with the other extension in either case, gzipped or not.
fn partner(path: &Path, name: &str, own: &str, other: &str) -> Result<PathBuf> {
    let at = name.to_ascii_lowercase().rfind(own).unwrap_or(name.len());
    let other_case = if name
        .get(at..at + own.len())
        .is_some_and(|e| e.chars().all(|c| c.is_ascii_uppercase()))
    {
        other.to_ascii_uppercase()
    } else {
        other.to_owned()
    };
    let stem = name.get(..at).unwrap_or(name);
    let candidates = [format!("{stem}{other_case}"), format!("{stem}{other_case}.gz")];
    let there = candidates.iter().find(|name| path.with_file_name(name).exists());
    let missing = || {
        Error::file(
            path,
            format!("needs the file {stem}{other_case} in the same folder, which is missing"),
        )
    };
    super::source::sibling_file(path, there.ok_or_else(missing)?)
}

/// The header bytes with their byte order and version.
struct Header {
    bytes: Vec<u8>,
    swap: bool,
    version: Version,
    /// Whether the voxels are in another file.
    paired: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Version {
    Analyze,
    One,
    Two,
}

impl Header {
    fn read(path: &Path, reader: &mut impl Read) -> Result<Self> {
        let mut bytes = vec![0u8; HEADER_BYTES[0]];
        reader.read_exact(&mut bytes).map_err(|e| read_error(path, e))?;
        let size = i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let (two, swap) = match (size, size.swap_bytes()) {
            (348, _) => (false, false),
            (_, 348) => (false, true),
            (540, _) => (true, false),
            (_, 540) => (true, true),
            _ => {
                return Err(Error::file(
                    path,
                    format!("is not a NIfTI file (header size {size} instead of 348 or 540)"),
                ));
            }
        };
        let version = if two {
            let mut rest = vec![0u8; HEADER_BYTES[1] - HEADER_BYTES[0]];
            reader.read_exact(&mut rest).map_err(|e| read_error(path, e))?;
            bytes.extend(rest);
            Version::Two
        } else {
            Version::One
        };
        let magic: &[u8] = if two { &bytes[4..8] } else { &bytes[344..348] };
        let (version, paired) = match magic {
            b"n+1\0" | b"n+2\0" => (version, false),
            b"ni1\0" | b"ni2\0" => (version, true),
            // Analyze has no magic number; it has an unused field there.
            _ if !two && bytes[344..348].iter().all(|b| *b == 0) => (Version::Analyze, true),
            other => {
                return Err(Error::file(
                    path,
                    format!("is not a NIfTI file (magic {:?})", String::from_utf8_lossy(other)),
                ));
            }
        };
        Ok(Self {
            bytes,
            swap,
            version,
            paired,
        })
    }

    fn field<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes = [0u8; N];
        bytes.copy_from_slice(&self.bytes[at..at + N]);
        if self.swap {
            bytes.reverse();
        }
        bytes
    }

    /// An integer of NIfTI-1 (16 bits) or NIfTI-2 (64 or 32 bits).
    fn integer(&self, one: usize, two: usize, two_bytes: usize) -> i64 {
        match (self.version, two_bytes) {
            (Version::Two, 8) => i64::from_le_bytes(self.field(two)),
            (Version::Two, 4) => i64::from(i32::from_le_bytes(self.field(two))),
            (Version::Two, _) => i64::from(i16::from_le_bytes(self.field(two))),
            _ => i64::from(i16::from_le_bytes(self.field(one))),
        }
    }

    /// A number of NIfTI-1 (single precision) or NIfTI-2 (double precision), the n-th from an
    /// offset.
    fn number(&self, one: usize, two: usize, n: usize) -> f64 {
        match self.version {
            Version::Two => f64::from_le_bytes(self.field(two + 8 * n)),
            _ => f64::from(f32::from_le_bytes(self.field(one + 4 * n))),
        }
    }

    fn pixdim(&self, n: usize) -> f64 {
        self.number(76, 104, n)
    }

    fn intent(&self) -> i16 {
        if self.version == Version::Analyze {
            0
        } else {
            self.integer(68, 504, 4) as i16
        }
    }

    /// The image whose values `reader` continues with, after `passed` bytes of their file.
    fn image(
        &self,
        path: &Path,
        mut reader: impl Read,
        max_bytes: u64,
        passed: u64,
        choice: &ReadOptions,
        watch: &Watch,
    ) -> Result<Image> {
        let fail = |problem: String| Error::file(path, problem);
        let mut warnings = Vec::new();
        let dim = self.dimensions().map_err(&fail)?;
        let size = [dim[0], dim[1], dim[2]];
        let (components, frames) = self.components_and_frames(&dim).map_err(&fail)?;
        let time = choice.time_of(frames)?;
        if frames > 1 && choice.time.is_none() {
            warnings.push(format!(
                "holds {frames} volumes; the first is used (--time chooses another)"
            ));
        }
        let (scalar, colors) = self.value_type().map_err(&fail)?;
        if colors > 1 && components > 1 {
            return Err(fail(format!(
                "holds {components} colours per voxel; a single one is needed"
            )));
        }
        let total = count(path, &[size[0], size[1], size[2], components, colors], scalar)?;
        let bytes = (total * scalar.bytes()) as u64;
        let offset = self.data_offset(passed);
        let ahead = offset.saturating_add(bytes.saturating_mul(time as u64));
        check_held(path, bytes.saturating_add(ahead), max_bytes)?;
        skip(path, &mut reader, ahead - passed)?;
        let mut source = ValueReader {
            path,
            reader,
            swap: self.swap != cfg!(target_endian = "big"),
            count: total,
            watch,
        };
        let voxels = source.read_as(scalar)?;
        if time + 1 == frames {
            check_end(path, source.reader)?;
        }
        let (rescale, world_from_voxel) = (self.rescale(&mut warnings), self.geometry(&mut warnings));
        let mut image = Image::new(self.format_name(), voxels, size, world_from_voxel);
        (image.components, image.rescale, image.intent) = (components * colors, rescale, self.intent());
        image.meaning = if colors > 1 {
            Meaning::Color
        } else {
            self.meaning(components, scalar)
        };
        image.layout = if colors > 1 {
            Layout::Interleaved
        } else {
            Layout::Planar
        };
        image.warnings = warnings;
        if frames > 1 {
            image.details.push(("time_points", json!(frames)));
        }
        Ok(image)
    }

    /// Whether this is an FSL warp or direction map.
    fn is_fsl(&self) -> bool {
        (2006..=2009).contains(&self.intent())
    }

    /// The number of values per voxel and the number of time points.
    fn components_and_frames(&self, dim: &[usize; 7]) -> Result<(usize, usize), String> {
        // Vectors are stored along the fifth axis; those of FSL's warps and directions along the
        // fourth.
        let colors_by_axis = INTENT_RGB.contains(&self.intent()) && (3..=4).contains(&dim[3]);
        let along_fourth = (self.is_fsl() || colors_by_axis) && dim[4] == 1;
        let (components, frames) = if along_fourth {
            (dim[3], 1)
        } else {
            (dim[4], dim[3] * dim[5] * dim[6])
        };
        if frames > 1 && components > 1 {
            return Err(format!(
                "has {components} values per voxel at {frames} time points; only one time point is supported; split it by time"
            ));
        }
        Ok((components, frames))
    }

    /// The stored type, and the number of its values per element: 3 or 4 for colours, else 1.
    fn value_type(&self) -> Result<(ScalarType, usize), String> {
        match self.integer(70, 12, 2) as i16 {
            128 => Ok((ScalarType::U8, 3)),
            2304 => Ok((ScalarType::U8, 4)),
            code => match scalar_type(code) {
                Some(scalar) => Ok((scalar, 1)),
                None => Err(format!(
                    "stores {}, which cannot be rendered; convert it to a real scalar type",
                    datatype_name(code)
                )),
            },
        }
    }

    /// The meaning of the values, from the intent code.
    fn meaning(&self, components: usize, scalar: ScalarType) -> Meaning {
        match self.intent() {
            // Floating-point colours are directions.
            i if INTENT_RGB.contains(&i)
                && components == 3
                && matches!(scalar, ScalarType::F32 | ScalarType::F64) =>
            {
                Meaning::Vectors
            }
            i if INTENT_RGB.contains(&i) && (3..=4).contains(&components) => Meaning::Color,
            INTENT_LABEL => Meaning::Labels(Vec::new()),
            i if INTENT_VECTOR.contains(&i) || self.is_fsl() => Meaning::Vectors,
            _ => Meaning::Unstated,
        }
    }

    /// Name of the format.
    fn format_name(&self) -> &'static str {
        match (self.version, self.paired) {
            (Version::Analyze, _) => "Analyze 7.5",
            (Version::One, false) => "NIfTI-1",
            (Version::One, true) => "NIfTI-1 pair",
            (Version::Two, false) => "NIfTI-2",
            (Version::Two, true) => "NIfTI-2 pair",
        }
    }

    /// Offset of the voxels in their file, after `passed` bytes of header or none.
    fn data_offset(&self, passed: u64) -> u64 {
        let least = if self.paired { 0 } else { passed + 4 };
        let stated = if self.version == Version::Two {
            self.integer(0, 168, 8) as f64
        } else {
            self.number(108, 168, 0)
        };
        if stated.is_finite() && (least as f64..1e15).contains(&stated) {
            stated as u64
        } else {
            least
        }
    }

    /// The seven extents; undeclared ones are 1.
    fn dimensions(&self) -> Result<[usize; 7], String> {
        let rank = self.integer(40, 16, 8);
        if !(1..=7).contains(&rank) {
            return Err(format!(
                "declares {rank} dimensions; NIfTI allows 1 to 7, so its header is damaged"
            ));
        }
        let mut dim = [1usize; 7];
        for (n, d) in dim.iter_mut().enumerate().take(rank as usize) {
            let value = self.integer(42 + 2 * n, 24 + 8 * n, 8);
            // Writers set axes beyond the third to 0.
            *d = match usize::try_from(value) {
                Ok(0) if n >= 3 => 1,
                Ok(v) if v > 0 => v,
                _ => {
                    return Err(format!(
                        "declares {value} voxels along axis {}; its header is damaged",
                        n + 1
                    ));
                }
            };
        }
        dim[3..]
            .iter()
            .try_fold(1usize, |n, &d| n.checked_mul(d))
            .ok_or("declares an impossible number of volumes; its header is damaged")?;
        Ok(dim)
    }

    /// By the standard, slope 0 means "no scaling"; a NaN or infinite slope is a writer's mistake
    /// and is treated the same.
    fn rescale(&self, warnings: &mut Vec<String>) -> Rescale {
        if self.version == Version::Analyze || matches!(self.integer(70, 12, 2), 128 | 2304) {
            return Rescale::NONE;
        }
        let (slope, intercept) = (self.number(112, 176, 0), self.number(116, 184, 0));
        if !slope.is_finite() || !intercept.is_finite() {
            warnings.push(format!(
                "its rescale slope {slope} and intercept {intercept} are not finite; stored values are used"
            ));
            return Rescale::NONE;
        }
        if slope == 0.0 {
            Rescale::NONE
        } else {
            Rescale { slope, intercept }
        }
    }

    fn geometry(&self, warnings: &mut Vec<String>) -> DAffine3 {
        let units = if self.version == Version::Two {
            self.field::<4>(500)[0]
        } else {
            self.bytes[123]
        };
        let mm = match units & 7 {
            1 => 1000.0,
            3 => 0.001,
            _ => 1.0,
        };
        let mut spacing = DVec3::ONE;
        for axis in 0..3 {
            let s = self.pixdim(axis + 1);
            if s.is_finite() && s != 0.0 {
                spacing[axis] = s.abs();
            } else {
                warnings.push(format!(
                    "its spacing along axis {} is {s}; 1 mm is used",
                    axis + 1
                ));
            }
        }
        let lps_from_ras = DAffine3::from_scale(DVec3::new(-1.0, -1.0, 1.0) * mm);
        if self.version == Version::Analyze {
            warnings.push("is in Analyze format, which does not state left and right; its first axis is assumed to run from right to left".into());
            return lps_from_ras * DAffine3::from_scale(spacing * DVec3::new(-1.0, 1.0, 1.0));
        }
        let usable =
            |t: &DAffine3| t.is_finite() && t.matrix3.determinant().abs() > 1e-12 * spacing.element_product();
        let sform = (self.integer(254, 348, 4) > 0).then(|| {
            let row = |n: usize| [0, 1, 2, 3].map(|c| self.number(280, 400, 4 * n + c));
            let r = [row(0), row(1), row(2)];
            let column = |c: usize| DVec3::new(r[0][c], r[1][c], r[2][c]);
            DAffine3 {
                matrix3: DMat3::from_cols(column(0), column(1), column(2)),
                translation: column(3),
            }
        });
        let qform = (self.integer(252, 344, 4) > 0).then(|| {
            let quaternion = |n: usize| self.number(256, 352, n);
            let (b, c, d) = (quaternion(0), quaternion(1), quaternion(2));
            let a = (1.0 - (b * b + c * c + d * d)).max(0.0).sqrt();
            let rotation = DMat3::from_quat(DQuat::from_xyzw(b, c, d, a).normalize());
            let handedness = if self.pixdim(0) < 0.0 { -1.0 } else { 1.0 };
            DAffine3 {
                matrix3: rotation * DMat3::from_diagonal(spacing * DVec3::new(1.0, 1.0, handedness)),
                translation: DVec3::new(quaternion(3), quaternion(4), quaternion(5)),
            }
        });
        let stated = sform.is_some() || qform.is_some();
        let ras_from_voxel = sform.filter(&usable).or_else(|| {
            if sform.is_some() {
                warnings.push("its sform is singular or not finite and is ignored".into());
            }
            qform.filter(&usable)
        });
        let ras_from_voxel = ras_from_voxel.unwrap_or_else(|| {
            let why = if stated {
                "no usable orientation"
            } else {
                "no orientation"
            };
            warnings.push(format!("has {why}: right, anterior, superior axes are assumed"));
            DAffine3::from_scale(spacing)
        });
        let world_from_voxel = lps_from_ras * ras_from_voxel;
        if super::source::usable(&world_from_voxel) {
            return world_from_voxel;
        }
        warnings
            .push("has an unusable geometry; 1 mm voxels along right, anterior, superior are assumed".into());
        DAffine3::from_scale(DVec3::new(-1.0, -1.0, 1.0))
    }
}

fn scalar_type(datatype: i16) -> Option<ScalarType> {
    Some(match datatype {
        2 => ScalarType::U8,
        256 => ScalarType::I8,
        4 => ScalarType::I16,
        512 => ScalarType::U16,
        8 => ScalarType::I32,
        768 => ScalarType::U32,
        16 => ScalarType::F32,
        1024 => ScalarType::I64,
        1280 => ScalarType::U64,
        64 => ScalarType::F64,
        _ => return None,
    })
}

fn datatype_name(code: i16) -> String {
    match code {
        1 => "1-bit values".into(),
        32 | 1792 | 2048 => "complex numbers".into(),
        1536 => "128-bit floating point".into(),
        _ => format!("the unknown type {code}"),
    }
}
