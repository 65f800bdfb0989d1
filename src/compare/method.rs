//! How a run was made: what a reader must know to tell where a difference between two pictures
//! comes from.

use super::run::Run;
use crate::prepare::Prepared;
use crate::scene::{BlendFormat, Mode, Normals, Projection, Scene, SliceOrder};
use crate::transfer::Blend;
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
        let composite = prepared.volume().blend == Blend::Composite;
        let is_slice = settings.mode == Mode::Slice;
        Self {
            samples: match settings.mode {
                Mode::Slice => "on planes across the view direction, at depths (i + 1/2) Δ from the eye",
                Mode::Raycast => "along each ray, at distances (i + 1/2) Δ from the eye",
                Mode::Surface => {
                    "along each ray, until a surface is crossed, which is then found by bisection"
                }
            },
            order: match (settings.mode, settings.slice_order, composite) {
                (Mode::Surface, ..) => "the nearest surface is shown",
                (_, _, false) => "any: maximum, minimum or mean",
                (Mode::Raycast, ..) => "front to back, in registers",
                (Mode::Slice, SliceOrder::BackToFront, _) => "back to front, by the blend unit",
                (Mode::Slice, SliceOrder::FrontToBack, _) => "front to back, by the blend unit",
            },
            slab: is_slice.then_some(settings.slab),
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

/// Why the pictures of the runs differ, one sentence each.
pub(super) fn explanation(runs: &[Run]) -> Vec<String> {
    let shown: Vec<&Run> = runs.iter().filter(|run| !run.is_reference).collect();
    let differ = |of: fn(&Run) -> &'static str| shown.windows(2).any(|w| of(w[0]) != of(w[1]));
    let has = |mode: Mode| shown.iter().any(|run| run.mode == mode);
    let mut sentences = Vec::new();
    if has(Mode::Slice) && has(Mode::Raycast) {
        if shown.iter().any(|run| run.method.is_perspective) {
            sentences.push(
                "In perspective, slices and rays sample different points: a slice lies at one depth, hence its samples are Δ / cos θ apart along a ray at the angle θ to the view direction; a ray's samples are Δ apart everywhere. Both approximate the same integral, and their difference falls with the step."
                    .to_owned(),
            );
        } else {
            sentences.push(
                "In an orthographic view slices and rays take the same samples: what differs is rounding, and what the points below add."
                    .to_owned(),
            );
        }
    }
    if differ(|run| run.method.early_stop) {
        sentences.push(
            "Rays, and slices drawn front to back, end where less than 1/512 of the light passes; slices drawn back to front composite everything. What is left out is at most half of an 8-bit step."
                .to_owned(),
        );
    }
    if shown.iter().any(|run| run.method.blend_format.starts_with("16")) {
        sentences.push(
            "In 16 bits the picture is rounded to 11 significant bits after every slice. Over hundreds of thin slices this adds up to a few 8-bit steps where a picture is nearly opaque; slabs round less often."
                .to_owned(),
        );
    }
    if shown.iter().any(|run| run.method.slab.is_some_and(|n| n > 1)) {
        sentences.push(
            "A slab composites several slices inside one fragment before it is blended: the same samples, fewer roundings, less memory traffic."
                .to_owned(),
        );
    }
    if differ(|run| run.method.filter) {
        sentences.push(
            "The renderers interpolate voxels with different precision; hardware filters have weights of 8 bits."
                .to_owned(),
        );
    }
    sentences
}
