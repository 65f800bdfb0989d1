//! A series written slice by slice, in random order.

use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::tags;
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
use glam::DVec3;
use incise::volume::GridGeometry;
use std::path::Path;

pub fn write(folder: &Path, grid: &GridGeometry, values: &[i16]) {
    std::fs::create_dir_all(folder).unwrap();
    let m = grid.world_from_voxel.matrix3;
    let [nx, ny, nz] = grid.size;
    for k in 0..nz {
        let texts = |v: &[f64]| {
            v.iter()
                .map(|x| {
                    format!("{x:.10}")
                        .trim_end_matches('0')
                        .trim_end_matches('.')
                        .to_owned()
                })
                .collect::<Vec<_>>()
                .join("\\")
        };
        let (x, y) = (m.x_axis.normalize(), m.y_axis.normalize());
        let position = grid
            .world_from_voxel
            .transform_point3(DVec3::new(0.0, 0.0, k as f64));
        let text = |tag: Tag, vr: VR, value: &str| DataElement::new(tag, vr, PrimitiveValue::from(value));
        let short = |tag: Tag, value: u16| DataElement::new(tag, VR::US, PrimitiveValue::from(value));
        let plane = &values[k * nx * ny..(k + 1) * nx * ny];
        // An icon has pixel data of its own, before that of the picture.
        let icon = InMemDicomObject::from_element_iter([
            short(tags::ROWS, 1),
            short(tags::COLUMNS, 2),
            DataElement::new(tags::PIXEL_DATA, VR::OB, PrimitiveValue::U8(vec![7u8, 9].into())),
        ]);
        let set = InMemDicomObject::from_element_iter([
            DataElement::new(
                tags::ICON_IMAGE_SEQUENCE,
                VR::SQ,
                DataSetSequence::from(vec![icon]),
            ),
            text(tags::SOP_CLASS_UID, VR::UI, "1.2.840.10008.5.1.4.1.1.2"),
            text(tags::SOP_INSTANCE_UID, VR::UI, &format!("1.2.3.{k}")),
            text(tags::MODALITY, VR::CS, "CT"),
            text(tags::SERIES_INSTANCE_UID, VR::UI, "1.2.3"),
            text(tags::INSTANCE_NUMBER, VR::IS, &format!("{}", (k * 3) % nz)),
            text(tags::IMAGE_POSITION_PATIENT, VR::DS, &texts(&position.to_array())),
            text(
                tags::IMAGE_ORIENTATION_PATIENT,
                VR::DS,
                &texts(&[x.x, x.y, x.z, y.x, y.y, y.z]),
            ),
            short(tags::SAMPLES_PER_PIXEL, 1),
            text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
            short(tags::ROWS, ny as u16),
            short(tags::COLUMNS, nx as u16),
            text(
                tags::PIXEL_SPACING,
                VR::DS,
                &texts(&[m.y_axis.length(), m.x_axis.length()]),
            ),
            short(tags::BITS_ALLOCATED, 16),
            short(tags::BITS_STORED, 16),
            short(tags::HIGH_BIT, 15),
            short(tags::PIXEL_REPRESENTATION, 1),
            DataElement::new(
                tags::PIXEL_DATA,
                VR::OW,
                PrimitiveValue::U16(plane.iter().map(|v| *v as u16).collect()),
            ),
        ]);
        let meta = FileMetaTableBuilder::new().transfer_syntax("1.2.840.10008.1.2.1");
        set.with_meta(meta)
            .unwrap()
            .write_to_file(folder.join(format!("{}.dcm", nz - k)))
            .unwrap();
    }
}
