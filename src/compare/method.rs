//! How a picture was made: what a reader must know to tell where a difference between two pictures
//! comes from.

use crate::prepare::Prepared;
use crate::scene::{BlendFormat, JacobianSource, MapFiltering, Mode, Normals, Projection, Scene, SliceOrder};
use serde::Serialize;

/// The options of a renderer that a comparison varies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RendererOptions {
    /// Slices composited inside one fragment.
    pub slab: u32,
    /// The order of drawing.
    pub order: SliceOrder,
    /// The number format of blending.
    pub format: BlendFormat,
    /// How the Jacobians of maps are found.
    pub jacobian: JacobianSource,
    /// How maps are interpolated; the device's own way if it is not stated.
    pub map_filter: Option<MapFiltering>,
}

impl RendererOptions {
    /// Those of a scene.
    pub fn of(scene: &Scene) -> Self {
        Self {
            slab: scene.render.slab,
            order: scene.render.slice_order,
            format: scene.render.blend_format,
            jacobian: scene.render.jacobian,
            map_filter: scene.render.map_filter,
        }
    }

    /// Those of these that act in a scene's mode; the others are the scene's own.
    pub(super) fn acting(self, scene: &Scene) -> Self {
        if scene.render.mode == Mode::Slice {
            return self;
        }
        Self {
            jacobian: self.jacobian,
            map_filter: self.map_filter,
            ..Self::of(scene)
        }
    }

    /// Sets them in a scene.
    pub(super) fn apply(self, scene: &mut Scene) {
        let render = &mut scene.render;
        (render.slab, render.slice_order, render.blend_format) = (self.slab, self.order, self.format);
        (render.jacobian, render.map_filter) = (self.jacobian, self.map_filter);
    }

    /// The options that act in a mode and differ from the defaults, for names; empty if none does.
    pub(super) fn label(self, mode: Mode) -> String {
        let mut parts = Vec::new();
        let is_slice = mode == Mode::Slice;
        if is_slice && self.slab != 1 {
            parts.push(format!("slab {}", self.slab));
        }
        if is_slice && self.order == SliceOrder::FrontToBack {
            parts.push("front to back".to_owned());
        }
        if is_slice && self.format == BlendFormat::Float16 {
            parts.push("16 bits".to_owned());
        }
        if self.jacobian == JacobianSource::Stored {
            parts.push("stored Jacobian".to_owned());
        }
        match self.map_filter {
            Some(MapFiltering::Shader) => parts.push("maps by the shader".to_owned()),
            Some(MapFiltering::Hardware) => parts.push("maps by hardware".to_owned()),
            None => {}
        }
        parts.join(", ")
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
    /// How displacement maps are interpolated.
    pub map_filter: &'static str,
    /// How the Jacobians of displacement maps are found.
    pub jacobian: &'static str,
    /// How samples are shaded.
    pub light: &'static str,
    /// Where a pixel ends early.
    pub early_stop: &'static str,
    /// The options that differ from the defaults, for names.
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
                (Mode::Slice, SliceOrder::BackToFront, _) => "back to front, blended polygon by polygon",
                (Mode::Slice, SliceOrder::FrontToBack, _) => "front to back, blended polygon by polygon",
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
            map_filter: match settings.map_filter {
                Some(MapFiltering::Shader) => "in the shader, 24-bit weights or more",
                Some(MapFiltering::Hardware) => "by the hardware, 8-bit weights",
                None => "same as for voxels",
            },
            jacobian: match settings.jacobian {
                JacobianSource::Differences => "central differences",
                JacobianSource::Stored => "stored for each texel",
            },
            variant: RendererOptions::of(scene).label(settings.mode),
            is_perspective: prepared.frame.view.projection == Projection::Perspective,
        }
    }
}
