//! The header of a NIfTI or Analyze file: its byte order, its fields, and what they say about the
//! values.

use super::super::super::Rescale;
use super::super::ScalarType;
use super::super::image::Meaning;
use super::super::source::read_error;
use crate::{Error, Result};
use std::io::Read;
use std::path::Path;

/// NIfTI's intent code of label maps.
const INTENT_LABEL: i16 = 1002;
/// Intents of colours.
const INTENT_RGB: [i16; 2] = [2003, 2004];
/// Intents of vectors.
const INTENT_VECTOR: [i16; 2] = [1006, 1007];
/// Header lengths of the two versions, bytes.
const HEADER_BYTES: [usize; 2] = [348, 540];

/// The header bytes with their byte order and version.
pub(super) struct Header {
    pub bytes: Vec<u8>,
    pub swap: bool,
    pub version: Version,
    /// Whether the voxels are in another file.
    pub paired: bool,
    /// Irregularities, one sentence each.
    pub warnings: Vec<String>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Version {
    Analyze,
    One,
    Two,
}

/// How a voxel is stored.
#[derive(Clone, Copy)]
pub(super) struct Stored {
    pub scalar: ScalarType,
    /// Values per element: 3 or 4 for colours, else 1.
    pub colors: usize,
    /// Whether eight values share a byte.
    pub bits: bool,
}

/// The extents of an image.
pub(super) struct Extents {
    pub size: [usize; 3],
    pub components: usize,
    pub frames: usize,
}

impl Header {
    pub fn read(path: &Path, reader: &mut impl Read) -> Result<Self> {
        let mut bytes = vec![0u8; HEADER_BYTES[0]];
        reader.read_exact(&mut bytes).map_err(|e| read_error(path, e))?;
        let mut warnings = Vec::new();
        let size = i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let (two, swap) = match (size, size.swap_bytes()) {
            (348, _) => (false, false),
            (_, 348) => (false, true),
            (540, _) => (true, false),
            (_, 540) => (true, true),
            // Some writers leave the size out; the number of dimensions then shows the byte order.
            _ if matches!(&bytes[344..348], b"n+1\0" | b"ni1\0") => {
                warnings.push(format!(
                    "states a header size of {size} instead of 348; it is read as NIfTI-1"
                ));
                (
                    false,
                    !(1..=7).contains(&i16::from_le_bytes([bytes[40], bytes[41]])),
                )
            }
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
        let pair_name = path.file_name().is_some_and(|n| {
            let name = n.to_string_lossy().to_ascii_lowercase();
            name.contains(".hdr") || name.contains(".img")
        });
        let (version, paired) = match magic {
            b"n+1\0" | b"n+2\0" => (version, false),
            b"ni1\0" | b"ni2\0" => (version, true),
            // Analyze has no magic number; it has a minimum there, mostly 0.
            _ if !two && (pair_name || bytes[344..348].iter().all(|b| *b == 0)) => (Version::Analyze, true),
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
            warnings,
        })
    }

    pub fn field<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes = [0u8; N];
        bytes.copy_from_slice(&self.bytes[at..at + N]);
        if self.swap {
            bytes.reverse();
        }
        bytes
    }

    /// An integer of NIfTI-1 (16 bits) or NIfTI-2 (64 or 32 bits).
    pub fn integer(&self, one: usize, two: usize, two_bytes: usize) -> i64 {
        match (self.version, two_bytes) {
            (Version::Two, 8) => i64::from_le_bytes(self.field(two)),
            (Version::Two, 4) => i64::from(i32::from_le_bytes(self.field(two))),
            (Version::Two, _) => i64::from(i16::from_le_bytes(self.field(two))),
            _ => i64::from(i16::from_le_bytes(self.field(one))),
        }
    }

    /// A number of NIfTI-1 (single precision) or NIfTI-2 (double precision), the n-th from an
    /// offset.
    pub fn number(&self, one: usize, two: usize, n: usize) -> f64 {
        match self.version {
            Version::Two => f64::from_le_bytes(self.field(two + 8 * n)),
            _ => f64::from(f32::from_le_bytes(self.field(one + 4 * n))),
        }
    }

    pub fn pixdim(&self, n: usize) -> f64 {
        self.number(76, 104, n)
    }

    pub fn intent(&self) -> i16 {
        if self.version == Version::Analyze {
            0
        } else {
            self.integer(68, 504, 4) as i16
        }
    }

    /// The name of the intent.
    pub fn intent_name(&self) -> String {
        let bytes: &[u8] = match self.version {
            Version::Analyze => &[],
            Version::One => &self.bytes[328..344],
            Version::Two => &self.bytes[508..524],
        };
        let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
        String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
    }

    /// Whether this is an FSL warp or direction map.
    fn is_fsl(&self) -> bool {
        (2006..=2009).contains(&self.intent())
    }

    /// The extents: three axes, values per voxel and time points.
    pub fn extents(&self) -> Result<Extents, String> {
        let dim = self.dimensions()?;
        // Vectors are stored along the fifth axis; those of FSL's warps and directions along the
        // fourth.
        let colors_by_axis = INTENT_RGB.contains(&self.intent()) && (3..=4).contains(&dim[3]);
        let along_fourth = (self.is_fsl() || colors_by_axis) && dim[4] == 1;
        let (components, frames) = if along_fourth {
            (dim[3], dim[5] * dim[6])
        } else if dim[4] > 1 && dim[5] * dim[6] > 1 {
            return Err(format!(
                "has {} dimensions, {dim:?}; images of up to three, with time and several values per voxel, can be read; split it",
                self.integer(40, 16, 8)
            ));
        } else {
            (dim[4], dim[3] * dim[5] * dim[6])
        };
        Ok(Extents {
            size: [dim[0], dim[1], dim[2]],
            components,
            frames,
        })
    }

    /// The stored type.
    pub fn stored(&mut self) -> Result<Stored, String> {
        let code = self.integer(70, 12, 2) as i16;
        let (scalar, colors) = match code {
            1 => (ScalarType::U8, 1),
            128 => (ScalarType::U8, 3),
            2304 => (ScalarType::U8, 4),
            code => match scalar_type(code) {
                Some(scalar) => (scalar, 1),
                None => {
                    return Err(format!(
                        "stores {}, which cannot be rendered; convert it to a real scalar type",
                        datatype_name(code)
                    ));
                }
            },
        };
        let bits = code == 1;
        if bits {
            self.warnings.push(
                "stores one bit per voxel; the lowest bit of each byte is taken as the first voxel".into(),
            );
        }
        let stated = self.integer(72, 14, 2);
        let expected = if bits {
            1
        } else {
            (8 * scalar.bytes() * colors) as i64
        };
        if stated != expected && stated != 0 {
            self.warnings.push(format!(
                "states {stated} bits per voxel, but its data type has {expected}; the data type is used"
            ));
        }
        Ok(Stored { scalar, colors, bits })
    }

    /// The meaning of the values, from the intent code.
    pub fn meaning(&self, components: usize, scalar: ScalarType) -> Meaning {
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
    pub fn format_name(&self) -> &'static str {
        match (self.version, self.paired) {
            (Version::Analyze, _) => "Analyze 7.5",
            (Version::One, false) => "NIfTI-1",
            (Version::One, true) => "NIfTI-1 pair",
            (Version::Two, false) => "NIfTI-2",
            (Version::Two, true) => "NIfTI-2 pair",
        }
    }

    /// Offset of the voxels in their file, after `passed` bytes of header or none.
    pub fn data_offset(&mut self, passed: u64) -> u64 {
        let least = if self.paired { 0 } else { passed + 4 };
        let stated = if self.version == Version::Two {
            self.integer(0, 168, 8) as f64
        } else {
            self.number(108, 168, 0)
        };
        if stated.is_finite() && (least as f64..1e15).contains(&stated) {
            return stated as u64;
        }
        if stated != 0.0 {
            self.warnings.push(format!(
                "states that its voxels begin at byte {stated}, which is not possible; byte {least} is used"
            ));
        }
        least
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
    /// and is treated the same. In Analyze files the fields are those of SPM.
    pub fn rescale(&mut self) -> Rescale {
        if matches!(self.integer(70, 12, 2), 128 | 2304) {
            return Rescale::NONE;
        }
        let (slope, intercept) = (self.number(112, 176, 0), self.number(116, 184, 0));
        if self.version == Version::Analyze {
            return self.analyze_rescale(slope, intercept);
        }
        if slope == 0.0 {
            return Rescale::NONE;
        }
        if !slope.is_finite() || !intercept.is_finite() {
            self.warnings.push(format!(
                "its rescale slope {slope} and intercept {intercept} are not finite; stored values are used"
            ));
            return Rescale::NONE;
        }
        Rescale { slope, intercept }
    }

    /// SPM's scaling of Analyze files: a slope (SPM99) and an intercept (SPM2) in fields that
    /// Analyze does not use, else the ranges of stored and calibrated values (SPM's spm_vol_ana.m).
    fn analyze_rescale(&mut self, slope: f64, intercept: f64) -> Rescale {
        let rescale = if slope.is_finite() && slope != 0.0 {
            Rescale {
                slope,
                intercept: if intercept.is_finite() { intercept } else { 0.0 },
            }
        } else {
            let whole = |at: usize| f64::from(i32::from_le_bytes(self.field(at)));
            let (stored, calibrated) = (
                [whole(144), whole(140)],
                [self.number(128, 0, 0), self.number(124, 0, 0)],
            );
            let slope = (calibrated[1] - calibrated[0]) / (stored[1] - stored[0]);
            if slope == 0.0 || !slope.is_finite() {
                return Rescale::NONE;
            }
            Rescale {
                slope,
                intercept: calibrated[0] - slope * stored[0],
            }
        };
        if rescale != Rescale::NONE {
            self.warnings.push(format!(
                "is scaled as SPM defines it for Analyze files: slope {}, intercept {}",
                rescale.slope, rescale.intercept
            ));
        }
        rescale
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
        32 | 1792 | 2048 => "complex numbers".into(),
        1536 => "128-bit floating point".into(),
        _ => format!("the unknown type {code}"),
    }
}
