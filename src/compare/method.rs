//! How a picture was made: what a reader must know to tell where a difference between two pictures
//! comes from.

use crate::prepare::Prepared;
use crate::scene::{BlendFormat, Mode, Normals, Projection, Scene, SliceOrder};
use serde::Serialize;

/// The options of slices that a comparison varies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SliceOptions {
    /// Slices composited inside one fragment.
    pub slab: u32,
    /// The order of drawing.
    pub order: SliceOrder,
    /// The number format of blending.
    pub format: BlendFormat,
}

impl SliceOptions {
    /// Those of a scene.
    pub fn of(scene: &Scene) -> Self {
        Self {
            slab: scene.render.slab,
            order: scene.render.slice_order,
            format: scene.render.blend_format,
        }
    }

    /// Sets them in a scene.
    pub(super) fn apply(self, scene: &mut Scene) {
        (
            scene.render.slab,
            scene.render.slice_order,
            scene.render.blend_format,
        ) = (self.slab, self.order, self.format);
    }

    /// The options that differ from the defaults, for names; empty if none does.
    pub(super) fn label(self) -> String {
        let mut parts = Vec::new();
        if self.slab != 1 {
            parts.push(format!("slab {}", self.slab));
        }
        if self.order == SliceOrder::FrontToBack {
            parts.push("front to back".to_owned());
        }
        if self.format == BlendFormat::Float16 {
            parts.push("16 bits".to_owned());
        }
        parts.join(" ")
    }
}

/// How a picture was made.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Method {
    /// Where samples lie.
    pub samples: &'static str,
    /// How they are composited, and in which order.
    pub order: &'static str,
    /// Slices composited inside one fragment; none for rays.
    pub slab: Option<u32>,
    /// The number format in which samples are blended.
    pub blend_format: &'static str,
    /// How voxels are interpolated.
    pub filter: &'static str,
    /// How samples are shaded.
    pub light: &'static str,
    /// Where a pixel ends early.
    pub early_stop: &'static str,
    /// The options of slices, for names; empty for rays and for the defaults.
    #[serde(skip)]
    pub variant: String,
    /// Whether the picture is in perspective.
    #[serde(skip)]
    pub is_perspective: bool,
}

impl Method {
    /// Of a prepared scene; `filter` is that of the device.
    pub fn of(scene: &Scene, prepared: &Prepared, filter: &'static str) -> Self {
        let settings = &prepared.settings;
        let composite = prepared.is_composite();
        let is_slice = settings.mode == Mode::Slice;
        Self {
            samples: match settings.mode {
                Mode::Slice => "on planes across the view direction, at depths (i + 1/2) Δ from the eye",
                Mode::Raycast => "along each ray, at distances (i + 1/2) Δ from the eye",
                Mode::Surface => {
                    "along each ray, until a surface is crossed, which is then found by bisection"
                }
            },
            order: match (settings.mode, prepared.slice_order(), composite) {
                (Mode::Surface, ..) => "the nearest surface is shown",
                (_, _, false) => "any: maximum, minimum or mean",
                (Mode::Raycast, ..) => "front to back, in registers",
                (Mode::Slice, SliceOrder::BackToFront, _) => "back to front, by the blend unit",
                (Mode::Slice, SliceOrder::FrontToBack, _) => "front to back, by the blend unit",
            },
            slab: is_slice.then(|| prepared.slices_per_slab()),
            blend_format: if is_slice && composite && settings.blend_format == BlendFormat::Float16 {
                "16-bit floats"
            } else {
                "32-bit floats"
            },
            filter,
            light: match (settings.mode, prepared.is_lit(), settings.normals) {
                (Mode::Surface, ..) => "Blinn-Phong, normals of the distance field through the Jacobian",
                (_, false, _) => "none",
                (_, _, Normals::Source) => "Blinn-Phong, gradients of the source",
                (_, _, Normals::Transformed) => "Blinn-Phong, gradients through the Jacobian",
                _ => "Blinn-Phong, gradients through the Jacobian, blended into the normals of cuts",
            },
            early_stop: if settings.mode != Mode::Surface && composite && prepared.ends_early() {
                "where less than 1/512 of the light passes"
            } else {
                "none"
            },
            variant: if is_slice {
                SliceOptions::of(scene).label()
            } else {
                String::new()
            },
            is_perspective: prepared.frame.view.projection == Projection::Perspective,
        }
    }
}
