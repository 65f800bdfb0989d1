//! A baked volume as a DICOM series, or a label map as a DICOM segmentation.

use super::slabs::slabs;
use super::{BakeOptions, Interpolation, StoredInterpolator, VolumeRows};
use crate::deform::StackAndCuts;
use crate::files::OutputFolder;
use crate::volume::load::ScalarType;
use crate::volume::save::dicom::{Derivation, PixelEncoding, SegmentationWriter, SeriesWriter};
use crate::volume::{GridGeometry, Rescale, Volume};
use crate::{Error, Result};

/// Writes the deformed volume on `grid` as a DICOM series, one file a slice. Without a fill value
/// voxels outside the volume and in cuts are pixel padding. Returns notices about the values.
///
/// # Errors
/// Errors from the destination; a grid that slices cannot represent.
pub fn dicom_series(
    volume: &Volume,
    deformation: &StackAndCuts,
    grid: &GridGeometry,
    folder: OutputFolder,
    derivation: &Derivation,
    options: &BakeOptions,
) -> Result<Vec<String>> {
    let encoding = PixelEncoding::of(volume, options.fill, SeriesWriter::is_pet(derivation));
    let mut writer = SeriesWriter::new(folder, volume, grid, &encoding, derivation)?;
    let scalar = if encoding.signed {
        ScalarType::I16
    } else {
        ScalarType::U16
    };
    let in_data = encoding.pixel_from_stored;
    let rows = VolumeRows {
        stored: StoredInterpolator {
            volume,
            interpolation: options.interpolation_of(volume),
        },
        deformation,
        grid,
        voxel_from_world: volume.world_from_voxel.inverse(),
        scalar,
        in_data,
        fill: (encoding.fill - in_data.intercept) / in_data.slope,
        // Padding is a value, too.
        limits: Some(encoding.limits).filter(|_| volume.padding.is_none()),
    };
    slabs(
        grid,
        scalar.bytes(),
        |j, k, bytes| rows.append(j, k, bytes),
        |bytes| writer.push(bytes),
        options.progress.unwrap_or(&|_| ()),
    )?;
    writer.finish()?;
    Ok(encoding.notice().into_iter().collect())
}

/// Makes a DICOM segmentation of the deformed label map on `grid`: the bytes of its file, and
/// notices.
///
/// # Errors
/// A volume that is no label map or has no label; a grid that slices cannot represent; more than a
/// file can hold.
pub fn dicom_segmentation(
    volume: &Volume,
    deformation: &StackAndCuts,
    grid: &GridGeometry,
    derivation: &Derivation,
    progress: &dyn Fn(f32),
) -> Result<(Vec<u8>, Vec<String>)> {
    let fail = |e: String| Error::value("output", e);
    if volume.labels().is_none() {
        return Err(fail(
            "is a DICOM segmentation, but the volume is not a label map; name a new folder for a series of slices"
                .into(),
        ));
    }
    let mut writer = SegmentationWriter::new(volume, grid, derivation).map_err(fail)?;
    let rows = VolumeRows {
        stored: StoredInterpolator {
            volume,
            interpolation: Interpolation::Nearest,
        },
        deformation,
        grid,
        voxel_from_world: volume.world_from_voxel.inverse(),
        scalar: ScalarType::U32,
        in_data: Rescale::NONE,
        fill: 0.0,
        limits: None,
    };
    slabs(
        grid,
        ScalarType::U32.bytes(),
        |j, k, bytes| rows.append(j, k, bytes),
        |bytes| writer.push(bytes).map_err(fail),
        progress,
    )?;
    let notices = writer.notice().into_iter().collect();
    Ok((writer.finish().map_err(fail)?, notices))
}
