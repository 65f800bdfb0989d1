//! Decides by interval arithmetic whether a box of the deformed scene may show any of a volume.

use crate::deform::Stack;
use crate::deform::cut::CutShapes;
use crate::math::{Bounds, MinMaxPyramid};
use crate::transfer::{Blend, TransferTable};
use glam::Affine3A;

/// The inputs that decide whether a cell shows anything.
pub struct VisibilityCriteria<'a> {
    /// The deformation.
    pub stack: &'a Stack,
    /// The cuts after it.
    pub cuts: &'a CutShapes,
    /// Normalised value of the iso-surface shown instead of the volume.
    pub iso: Option<f32>,
    /// Whether cut faces show everything they cut.
    pub grey_faces: bool,
    /// How far from every sample what it shows may lie, mm.
    pub lookback_mm: f32,
    /// The same near a cut or a face of the volume.
    pub cut_lookback_mm: f32,
    /// Distance within which a shape affects a sample, mm.
    pub cut_margin_mm: f32,
    /// World to voxel.
    pub voxel_from_world: &'a Affine3A,
    /// Extent of the volume in voxels: its box is -1/2 .. n - 1/2.
    pub voxel_box: Bounds,
    /// Normalised values.
    pub value_pyramid: &'a MinMaxPyramid<1>,
    /// Opacity by value.
    pub table: &'a TransferTable,
    /// Composite pictures need opacity; projections show every present sample.
    pub blend: Blend,
}

/// The inputs of a grid's classification. Voxels are not part of it: one key is stored with each
/// grid of voxels.
#[derive(PartialEq)]
pub struct MacrocellKey {
    bounds: Bounds,
    voxel_mm: f32,
    lookback_mm: f32,
    cut_lookback_mm: f32,
    cut_margin_mm: f32,
    stack: Stack,
    cuts: CutShapes,
    iso: Option<f32>,
    grey_faces: bool,
    blend: Blend,
    depths: Vec<f32>,
    table_mapping: [f32; 2],
}

impl MacrocellKey {
    /// The key for a call of [`Macrocells::new`](super::Macrocells::new).
    pub fn of(bounds: Bounds, voxel_mm: f32, contents: &VisibilityCriteria) -> Self {
        let VisibilityCriteria {
            stack,
            cuts,
            iso,
            grey_faces,
            lookback_mm,
            cut_lookback_mm,
            cut_margin_mm,
            table,
            blend,
            ..
        } = *contents;
        let (stack, cuts) = (stack.clone(), cuts.clone());
        let (depths, table_mapping) = (
            table.entries.iter().map(|e| e[3]).collect(),
            [table.scale, table.offset],
        );
        Self {
            bounds,
            voxel_mm,
            lookback_mm,
            cut_lookback_mm,
            cut_margin_mm,
            stack,
            cuts,
            iso,
            grey_faces,
            blend,
            depths,
            table_mapping,
        }
    }
}

/// What a box of the deformed scene shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoxVisibility {
    /// Nothing in it is visible.
    Invisible,
    /// Something may be visible.
    MaybeVisible,
    /// Something is visible in every part of it, as far as these bounds can tell.
    VisibleEverywhere,
}

impl VisibilityCriteria<'_> {
    /// How far outside a box the content shown by its samples may lie, mm.
    pub fn reach_mm(&self) -> f32 {
        self.cut_lookback_mm.max(self.lookback_mm)
    }

    /// The visibility of a box of the deformed scene, including what its samples read around it.
    pub(super) fn visibility(&self, deformed: &Bounds) -> BoxVisibility {
        let (visibility, is_near_cut) = self.box_visibility(&deformed.grown(self.lookback_mm));
        if visibility == BoxVisibility::Invisible && self.cut_lookback_mm > self.lookback_mm {
            let reached = deformed.grown(self.cut_lookback_mm);
            if is_near_cut || self.stack.mask_varies(&reached) || self.is_near_cut_shape(deformed) {
                return self.box_visibility(&reached).0;
            }
        }
        visibility
    }

    /// Whether a cut shape is within the reach of samples in a box.
    fn is_near_cut_shape(&self, deformed: &Bounds) -> bool {
        !self.cuts.is_empty() && {
            let [least, most] = self.cuts.bounds(&deformed.grown(self.cut_lookback_mm));
            least < 0.0 && most >= 0.0
        }
    }

    /// Whether masks or shapes can affect samples in a box or their surface entries, at most a step
    /// in front of them.
    pub(super) fn near_cuts(&self, deformed: &Bounds) -> bool {
        let reached = deformed.grown(self.cut_lookback_mm);
        self.stack.mask_varies(&reached)
            || (!self.cuts.is_empty() && self.cuts.bounds(&reached)[0] < self.cut_margin_mm)
    }

    /// The visibility of a box of the deformed scene itself, and whether a mask varies or a face of
    /// the volume lies there.
    fn box_visibility(&self, deformed: &Bounds) -> (BoxVisibility, bool) {
        let [min_distance, max_distance] = self.cuts.bounds(deformed);
        if max_distance < 0.0 {
            return (BoxVisibility::Invisible, false);
        }
        let (mut nothing, mut throughout, mut is_near_cut) = (true, true, false);
        self.stack
            .source_parts(deformed, &mut |source, [min_alpha, max_alpha]| {
                let visibility =
                    self.source_visibility(source, min_distance >= 0.0 && min_alpha >= 0.5, max_alpha);
                nothing &= visibility == BoxVisibility::Invisible;
                throughout &= visibility == BoxVisibility::VisibleEverywhere;
                is_near_cut |= min_alpha < 1.0 || !self.voxel_box.contains(&self.in_voxel(source));
            });
        let visibility = match (nothing, throughout) {
            (true, _) => BoxVisibility::Invisible,
            (_, true) => BoxVisibility::VisibleEverywhere,
            _ => BoxVisibility::MaybeVisible,
        };
        (visibility, is_near_cut)
    }

    /// A box of the source in voxels, a little larger.
    fn in_voxel(&self, source: &Bounds) -> Bounds {
        source.transformed(self.voxel_from_world).grown(0.01)
    }

    /// The visibility of a box of the source; `whole` if nothing of it is cut away.
    fn source_visibility(&self, source: &Bounds, whole: bool, max_alpha: f32) -> BoxVisibility {
        if max_alpha < 0.5 {
            return BoxVisibility::Invisible;
        }
        let in_voxel = self.in_voxel(source);
        let inside = in_voxel.intersection(&self.voxel_box);
        if inside.is_empty() {
            return BoxVisibility::Invisible;
        }
        let throughout = |all: bool| {
            if all && whole && self.voxel_box.contains(&in_voxel) {
                BoxVisibility::VisibleEverywhere
            } else {
                BoxVisibility::MaybeVisible
            }
        };
        if self.blend != Blend::Composite {
            return throughout(true);
        }
        if self.grey_faces && !whole {
            return BoxVisibility::MaybeVisible;
        }
        let values = self.value_pyramid.query(inside.min, inside.max);
        let ([low], [high]) = (values.min, values.max);
        if let Some(iso) = self.iso {
            return if high < iso {
                BoxVisibility::Invisible
            } else {
                throughout(low >= iso)
            };
        }
        if self.table.max_depth(low, high) <= 0.0 {
            BoxVisibility::Invisible
        } else {
            throughout(self.table.is_visible_throughout(low, high))
        }
    }
}
