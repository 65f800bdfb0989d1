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
//!
//! *Analyze*: the fields that SPM puts into places that Analyze does not use are read: the origin,
//! and the scaling of the values. Without an origin the centre of the image lies at the world's
//! origin, as in SPM and nibabel (ITK: the first voxel).

mod geometry;
mod header;

use super::super::StoredValues;
use super::ReadOptions;
use super::image::{Image, Layout, Meaning};
use super::source::{ValueReader, check_end, check_held, count, open, read_error, reserved, skip};
use crate::{Error, Result, Watch};
use geometry::geometry;
use header::{Header, Stored, Version};
use serde_json::json;
use std::io::Read;
use std::path::{Path, PathBuf};

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
    let mut header = Header::read(&header_path, &mut reader)?;
    match (data_path, header.paired) {
        (Some(data), true) => {
            let (reader, max_bytes) = open(&data)?;
            header.warnings.extend(matrix_beside(&header, &header_path));
            image(&mut header, &data, reader, max_bytes, 0, choice, watch)
        }
        (None, true) => Err(Error::file(
            path,
            "is the header of a .hdr/.img pair under another name; rename it to .hdr, in the same folder as its .img",
        )),
        // A single file with one of the pair's names.
        (_, false) => {
            let passed = header.bytes.len() as u64;
            image(
                &mut header,
                &header_path,
                reader,
                max_bytes,
                passed,
                choice,
                watch,
            )
        }
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

/// A notice if SPM's matrix lies beside an Analyze file: a file in MATLAB's format that replaces
/// the orientation.
fn matrix_beside(header: &Header, path: &Path) -> Option<String> {
    let name = path.file_name()?.to_string_lossy().into_owned();
    let stem = &name[..name.to_ascii_lowercase().rfind(".hdr")?];
    let matrix = format!("{stem}.mat");
    (header.version == Version::Analyze && path.with_file_name(&matrix).exists()).then(|| {
        format!(
            "has the file {matrix} beside it, in which SPM states its orientation; it is not read: convert the image to NIfTI with SPM to keep it"
        )
    })
}

/// The image whose values `reader` continues with, after `passed` bytes of their file.
fn image(
    header: &mut Header,
    path: &Path,
    mut reader: impl Read,
    max_bytes: u64,
    passed: u64,
    choice: &ReadOptions,
    watch: &Watch,
) -> Result<Image> {
    let fail = |problem: String| Error::file(path, problem);
    let extents = header.extents().map_err(&fail)?;
    let (size, components, frames) = (extents.size, extents.components, extents.frames);
    let time = choice.time_of(frames)?;
    if frames > 1 && choice.time.is_none() {
        header.warnings.push(format!(
            "holds {frames} volumes; the first is used (--time chooses another)"
        ));
    }
    let stored = header.stored().map_err(&fail)?;
    if stored.colors > 1 && components > 1 {
        return Err(fail(format!(
            "holds {components} colours per voxel; a single one is needed"
        )));
    }
    // Times of one component follow each other, then come those of the next component.
    let values = VoxelValues {
        path,
        stored,
        one: count(path, &[size[0], size[1], size[2], stored.colors], stored.scalar)?,
        components,
        frames,
        time,
        swap: header.swap != cfg!(target_endian = "big"),
        watch,
    };
    count(path, &[values.one, components, frames], stored.scalar)?;
    let offset = header.data_offset(passed);
    check_held(path, values.end().saturating_add(offset), max_bytes)?;
    skip(path, &mut reader, offset - passed)?;
    let voxels = values.read(reader)?;
    let (rescale, world_from_voxel) = (header.rescale(), geometry(header, size, choice));
    let mut image = Image::new(header.format_name(), voxels, size, world_from_voxel);
    (image.components, image.rescale) = (components * stored.colors, rescale);
    (image.intent, image.intent_name) = (header.intent(), header.intent_name());
    (image.meaning, image.layout) = if stored.colors > 1 {
        (Meaning::Color, Layout::Interleaved)
    } else {
        (header.meaning(components, stored.scalar), Layout::Planar)
    };
    image.warnings = std::mem::take(&mut header.warnings);
    if frames > 1 {
        image.details.push(("time_points", json!(frames)));
    }
    Ok(image)
}

/// Which values of a file to read.
struct VoxelValues<'a> {
    path: &'a Path,
    stored: Stored,
    /// Values of one component at one time.
    one: usize,
    components: usize,
    frames: usize,
    time: usize,
    swap: bool,
    watch: &'a Watch<'a>,
}

impl VoxelValues<'_> {
    /// The bytes of a number of values.
    fn bytes(&self, values: usize) -> u64 {
        if self.stored.bits {
            values.div_ceil(8) as u64
        } else {
            (values * self.stored.scalar.bytes()) as u64
        }
    }

    /// The byte after the last value to read, from the first value.
    fn end(&self) -> u64 {
        self.bytes(((self.components - 1) * self.frames + self.time + 1) * self.one)
    }

    /// Reads the values of all components at the chosen time.
    fn read(&self, mut reader: impl Read) -> Result<StoredValues> {
        if self.stored.bits {
            return self.read_bits(reader);
        }
        if self.frames > 1 && self.components > 1 {
            let mut all: Option<StoredValues> = None;
            for component in 0..self.components {
                let between = if component == 0 {
                    self.time
                } else {
                    self.frames - 1
                };
                skip(self.path, &mut reader, self.bytes(between * self.one))?;
                let (values, rest) = self.read_values(reader, self.one)?;
                reader = rest;
                match &mut all {
                    None => all = Some(values),
                    Some(all) => {
                        all.append(&values);
                    }
                }
            }
            return all.ok_or_else(|| Error::file(self.path, "has no component"));
        }
        skip(self.path, &mut reader, self.bytes(self.time * self.one))?;
        let (values, rest) = self.read_values(reader, self.one * self.components)?;
        if self.time + 1 == self.frames {
            check_end(self.path, rest)?;
        }
        Ok(values)
    }

    fn read_values<R: Read>(&self, reader: R, count: usize) -> Result<(StoredValues, R)> {
        let mut source = ValueReader {
            path: self.path,
            reader,
            swap: self.swap,
            count,
            watch: self.watch,
        };
        let values = source.read_as(self.stored.scalar)?;
        Ok((values, source.reader))
    }

    /// Values of one bit, the lowest bit of a byte first.
    fn read_bits(&self, mut reader: impl Read) -> Result<StoredValues> {
        let (one, total) = (self.one, self.one * self.components);
        let mut bytes: Vec<u8> = reserved(self.path, self.end() as usize)?;
        reader
            .by_ref()
            .take(self.end())
            .read_to_end(&mut bytes)
            .map_err(|e| read_error(self.path, e))?;
        let mut values: Vec<u8> = reserved(self.path, total)?;
        for n in 0..total {
            let at = (n / one * self.frames + self.time) * one + n % one;
            let byte = bytes
                .get(at / 8)
                .ok_or_else(|| read_error(self.path, std::io::ErrorKind::UnexpectedEof.into()))?;
            values.push(byte >> (at % 8) & 1);
        }
        Ok(values.into())
    }
}
