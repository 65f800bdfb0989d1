//! A baked volume as a DICOM series.

use super::slabs::slabs;
use super::{BakeOptions, StoredInterpolator, VolumeRows};
use crate::Result;
use crate::deform::StackAndCuts;
use crate::files::OutputFolder;
use crate::volume::load::ScalarType;
use crate::volume::save::dicom::{Derivation, PixelEncoding, SeriesWriter};
use crate::volume::{GridGeometry, Volume};

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
