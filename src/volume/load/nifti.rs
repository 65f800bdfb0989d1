//! NIfTI-1 in one file, `.nii` or `.nii.gz`, of either byte order and every real scalar type.
//!
//! Own code instead of the `nifti` crate, because voxels must stay as they are stored (it converts before it scales), headers must
//! not be trusted (its qform code panics on bad ones) and a header's size must allocate nothing before the file is known to hold it.
//!
//! *Geometry*: sform if its code is positive and it is invertible, else qform, else the bare spacing; NIfTI's world is RAS+, ours
//! is LPS, so x and y change sign. Source: nifti1.h, the NIfTI-1 data format (Cox et al. 2004), "METHOD 2" and "METHOD 3".

use super::super::Rescale;
use super::image::{DEFLATE_LIMIT, Image, Layout, ScalarType, Source, open, read_error};
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use std::io::{ErrorKind, Read};
use std::path::Path;

const HEADER_BYTES: usize = 348;

/// Reads an image with all its components, or a volume (of a series in time, the first).
pub fn read(path: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<Image> {
    let (reader, file_bytes, gzipped) = open(path)?;
    parse(path, reader, if gzipped { file_bytes.saturating_mul(DEFLATE_LIMIT) } else { file_bytes }, progress)
}

/// The 348 header bytes with their byte order.
struct Header {
    bytes: [u8; HEADER_BYTES],
    swap: bool,
}

impl Header {
    fn field<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes = [0u8; N];
        bytes.copy_from_slice(&self.bytes[at..at + N]);
        if self.swap {
            bytes.reverse();
        }
        bytes
    }
    fn i16(&self, at: usize) -> i16 {
        i16::from_le_bytes(self.field(at))
    }
    fn f32(&self, at: usize) -> f64 {
        f64::from(f32::from_le_bytes(self.field(at)))
    }
}

fn parse(path: &Path, mut reader: impl Read, most_bytes: u64, progress: &mut dyn FnMut(u64, u64)) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    let mut bytes = [0u8; HEADER_BYTES];
    reader.read_exact(&mut bytes).map_err(|e| read_error(path, e))?;
    let header_size = i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let swap = match header_size {
        348 => false,
        s if s.swap_bytes() == 348 => true,
        s if s == 540 || s.swap_bytes() == 540 => {
            return Err(fail("is NIfTI-2, which cannot be read yet; convert it to NIfTI-1".into()));
        }
        s => return Err(fail(format!("is not a NIfTI-1 file (header size {s} instead of 348)"))),
    };
    let h = Header { bytes, swap };
    match &bytes[344..348] {
        b"n+1\0" => {}
        b"ni1\0" => return Err(fail("is the header of a .hdr/.img pair; convert it to a single .nii file".into())),
        other => return Err(fail(format!("is not a NIfTI-1 file (magic {:?})", String::from_utf8_lossy(other)))),
    }
    let mut warnings = Vec::new();
    let dim = dimensions(&h).map_err(&fail)?;
    let size = [dim[0], dim[1], dim[2]];
    let intent = h.i16(68);
    // Vectors lie along the fifth axis; FSL's warps have theirs along the fourth.
    let fsl = (2006..=2009).contains(&intent);
    let (components, frames) = if fsl && dim[4] == 1 { (dim[3], 1) } else { (dim[4], dim[3] * dim[5] * dim[6]) };
    if frames > 1 && components > 1 {
        return Err(fail(format!("holds {components} values per voxel at {frames} times; a single time is needed")));
    }
    if frames > 1 {
        warnings.push(format!("holds {frames} volumes; the first is used"));
    }
    let count = size.iter().chain([&components]).try_fold(1usize, |n, &d| n.checked_mul(d));
    let datatype = h.i16(70);
    let scalar = scalar_type(datatype)
        .ok_or_else(|| fail(format!("stores {}, which cannot be rendered; convert it to a real scalar type", datatype_name(datatype))))?;
    let bytes_per_voxel = scalar.bytes();
    let voxel_bytes = count.and_then(|n| n.checked_mul(bytes_per_voxel)).filter(|&b| b < isize::MAX as usize);
    let (Some(count), Some(voxel_bytes)) = (count, voxel_bytes) else {
        return Err(fail(format!(
            "declares {} x {} x {} voxels, which is more than can be addressed; its header is damaged",
            size[0], size[1], size[2]
        )));
    };
    let offset = h.f32(108);
    let offset = if offset.is_finite() && (352.0..1e15).contains(&offset) { offset as u64 } else { 352 };
    if (voxel_bytes as u64).saturating_add(offset) > most_bytes {
        return Err(fail(format!(
            "declares {} x {} x {} voxels of {bytes_per_voxel} bytes, more than the file can hold: it is truncated or its header is damaged; copy or download it again",
            size[0], size[1], size[2]
        )));
    }
    // Extensions lie between the header and the voxels.
    let mut skip = (&mut reader).take(offset - HEADER_BYTES as u64);
    std::io::copy(&mut skip, &mut std::io::sink()).map_err(|e| read_error(path, e))?;

    let mut source = Source { path, reader, swap: swap != cfg!(target_endian = "big"), count, progress };
    let voxels = source.read_as(scalar)?;
    if frames == 1 {
        check_end(path, source.reader)?;
    }
    let rescale = rescale(&h, &mut warnings);
    let world_from_voxel = geometry(&h, &mut warnings);
    Ok(Image { voxels, size, components, layout: Layout::Planar, rescale, world_from_voxel, intent, frame: None, displacement: false, warnings })
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

/// Reads what follows the voxels, so that a gzip stream is checked to its checksum. Other bytes after the stream are nobody's harm.
fn check_end(path: &Path, mut reader: impl Read) -> Result<()> {
    match std::io::copy(&mut reader, &mut std::io::sink()) {
        Err(e) if e.kind() == ErrorKind::UnexpectedEof || e.to_string().contains("checksum") => Err(read_error(path, e)),
        _ => Ok(()),
    }
}

/// The seven extents; those that are not declared are 1.
fn dimensions(h: &Header) -> Result<[usize; 7], String> {
    let rank = h.i16(40);
    if !(1..=7).contains(&rank) {
        return Err(format!("declares {rank} dimensions; NIfTI allows 1 to 7, so its header is damaged"));
    }
    let mut dim = [1usize; 7];
    for (n, d) in dim.iter_mut().enumerate().take(rank as usize) {
        let value = h.i16(42 + 2 * n);
        if value < 1 {
            return Err(format!("declares {value} voxels along axis {}; its header is damaged", n + 1));
        }
        *d = value as usize;
    }
    dim[3..].iter().try_fold(1usize, |n, &d| n.checked_mul(d)).ok_or("declares more volumes than can be counted; its header is damaged")?;
    Ok(dim)
}

fn datatype_name(code: i16) -> String {
    match code {
        1 => "1-bit values".into(),
        32 | 1792 | 2048 => "complex numbers".into(),
        128 | 2304 => "RGB colours".into(),
        1536 => "128-bit floating point".into(),
        _ => format!("the unknown type {code}"),
    }
}

/// slope 0 means "no scaling" by the standard; a NaN or infinite one is a writer's mistake and means the same.
fn rescale(h: &Header, warnings: &mut Vec<String>) -> Rescale {
    let (slope, intercept) = (h.f32(112), h.f32(116));
    if !slope.is_finite() || !intercept.is_finite() {
        warnings.push(format!("its rescale slope {slope} and intercept {intercept} are not numbers; values are taken as stored"));
        return Rescale::NONE;
    }
    if slope == 0.0 { Rescale::NONE } else { Rescale { slope, intercept } }
}

fn geometry(h: &Header, warnings: &mut Vec<String>) -> DAffine3 {
    let mm = match h.bytes[123] & 7 {
        1 => 1000.0,
        3 => 0.001,
        _ => 1.0,
    };
    let mut spacing = DVec3::ONE;
    for axis in 0..3 {
        let s = h.f32(80 + 4 * axis);
        if s.is_finite() && s != 0.0 {
            spacing[axis] = s.abs();
        } else {
            warnings.push(format!("its spacing along axis {} is {s}; 1 mm is used", axis + 1));
        }
    }
    let usable = |t: &DAffine3| t.is_finite() && t.matrix3.determinant().abs() > 1e-12 * spacing.element_product();
    let sform = (h.i16(254) > 0).then(|| {
        let row = |n: usize| [0, 4, 8, 12].map(|c| h.f32(280 + 16 * n + c));
        let r = [row(0), row(1), row(2)];
        let column = |c: usize| DVec3::new(r[0][c], r[1][c], r[2][c]);
        DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) }
    });
    let qform = (h.i16(252) > 0).then(|| {
        let (b, c, d) = (h.f32(256), h.f32(260), h.f32(264));
        let a = (1.0 - (b * b + c * c + d * d)).max(0.0).sqrt();
        let rotation = DMat3::from_quat(DQuat::from_xyzw(b, c, d, a).normalize());
        let handedness = if h.f32(76) < 0.0 { -1.0 } else { 1.0 };
        DAffine3 {
            matrix3: rotation * DMat3::from_diagonal(spacing * DVec3::new(1.0, 1.0, handedness)),
            translation: DVec3::new(h.f32(268), h.f32(272), h.f32(276)),
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
        let why = if stated { "no usable orientation" } else { "no orientation" };
        warnings.push(format!("has {why}: axes are taken as right, anterior, superior"));
        DAffine3::from_scale(spacing)
    });
    let lps_from_ras = DAffine3::from_scale(DVec3::new(-1.0, -1.0, 1.0) * mm);
    lps_from_ras * ras_from_voxel
}
