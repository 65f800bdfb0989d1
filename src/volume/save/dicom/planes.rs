//! The planes of a grid as DICOM states them.

use super::attributes::Attributes;
use super::uid::UidRole;
use crate::volume::GridGeometry;
use crate::volume::load::Origin;
use dicom_core::VR;
use dicom_dictionary_std::tags;
use glam::DVec3;

/// Largest cosine of the angle between rows and columns that counts as a right angle.
const RIGHT_ANGLE: f64 = 1e-4;
/// Smallest part of the distance between slices that lies along their normal: a tilt of 87 degrees.
const MIN_NORMAL_SHARE: f64 = 0.05;

/// The planes of a grid.
pub struct SlicePlanes {
    pub grid: GridGeometry,
    /// Unit vectors of increasing column and row, and their normal.
    pub along: [DVec3; 2],
    pub normal: DVec3,
    /// Distance between columns, rows and, along the normal, slices, mm.
    pub spacing_mm: [f64; 3],
    /// Whether slices advance against the normal: readers sort along it, so they are numbered in
    /// reverse.
    reversed: bool,
}

impl SlicePlanes {
    pub fn new(grid: &GridGeometry) -> Result<Self, String> {
        let m = grid.world_from_voxel.matrix3;
        let along = [m.x_axis.normalize_or_zero(), m.y_axis.normalize_or_zero()];
        let angle = along[0].dot(along[1]);
        if angle.abs() > RIGHT_ANGLE {
            return Err(format!(
                "rows and columns of the volume are at an angle of {:.2} degrees; DICOM needs a right angle; write .nii.gz or .nrrd instead",
                angle.clamp(-1.0, 1.0).acos().to_degrees()
            ));
        }
        let normal = along[0].cross(along[1]).normalize_or_zero();
        let step = m.z_axis.dot(normal);
        if step.abs() < MIN_NORMAL_SHARE * m.z_axis.length() || step == 0.0 {
            return Err(
                "the direction in which the slices are stacked is almost parallel to the slices; write .nii.gz or .nrrd instead"
                    .into(),
            );
        }
        if grid.size[..2].iter().any(|n| *n > usize::from(u16::MAX)) {
            return Err(format!(
                "a DICOM slice has at most 65535 pixels along an edge, not {} x {}",
                grid.size[0], grid.size[1]
            ));
        }
        Ok(Self {
            grid: *grid,
            along,
            normal,
            spacing_mm: [m.x_axis.length(), m.y_axis.length(), step.abs()],
            reversed: step < 0.0,
        })
    }

    /// Centre of the first pixel of a slice, mm.
    pub fn position(&self, k: usize) -> DVec3 {
        self.grid
            .world_from_voxel
            .transform_point3(DVec3::new(0.0, 0.0, k as f64))
    }

    /// The number of a slice, from 1, ascending along the normal.
    pub fn number(&self, k: usize) -> usize {
        if self.reversed {
            self.grid.size[2] - k
        } else {
            k + 1
        }
    }

    /// Distances between pixels and between slices (PS3.3 C.7.6.2, C.7.6.16.2.1).
    pub fn measures(&self, set: &mut Attributes) {
        let [columns, rows, slices] = self.spacing_mm;
        // Distance between rows, then between columns.
        set.decimals(tags::PIXEL_SPACING, &[rows, columns]);
        set.decimals(tags::SLICE_THICKNESS, &[slices]);
        set.decimals(tags::SPACING_BETWEEN_SLICES, &[slices]);
    }

    /// Directions of rows and columns.
    pub fn orientation(&self, set: &mut Attributes) {
        let [along, down] = self.along;
        set.decimals(
            tags::IMAGE_ORIENTATION_PATIENT,
            &[along.to_array(), down.to_array()].concat(),
        );
    }

    /// Number of pixels along the edges.
    pub fn extent(&self, set: &mut Attributes) {
        // Both are at most 65,535.
        set.whole(tags::COLUMNS, self.grid.size[0] as u16);
        set.whole(tags::ROWS, self.grid.size[1] as u16);
    }
}

/// The frame of reference: the source's if the source may be referred to, since positions stay
/// those of the patient.
pub fn frame_of_reference(set: &mut Attributes, source: Option<&Origin>) {
    if let Some(source) = source {
        set.copy(
            &source.header,
            &[tags::FRAME_OF_REFERENCE_UID, tags::POSITION_REFERENCE_INDICATOR],
        );
    }
    set.text_if_missing(
        tags::FRAME_OF_REFERENCE_UID,
        VR::UI,
        &UidRole::FrameOfReference.placeholder(),
    );
    set.present(&[(tags::POSITION_REFERENCE_INDICATOR, VR::LO)]);
}
