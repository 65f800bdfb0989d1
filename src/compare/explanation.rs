//! Where the differences between the runs of a report come from, in words.

use super::run::Run;
use crate::scene::Mode;

/// Why the pictures of the runs differ, one sentence each.
pub(super) fn explanation(runs: &[Run]) -> Vec<String> {
    let shown: Vec<&Run> = runs.iter().filter(|run| !run.is_reference).collect();
    let differ = |of: fn(&Run) -> &'static str| shown.windows(2).any(|w| of(w[0]) != of(w[1]));
    let has = |mode: Mode| shown.iter().any(|run| run.mode == mode);
    let mut sentences = Vec::new();
    if has(Mode::Slice) && has(Mode::Raycast) {
        if shown.iter().any(|run| run.method.is_perspective) {
            sentences.push(
                "In perspective, slices and rays sample different points: a slice lies at one depth, hence its samples are Δ / cos θ apart along a ray at the angle θ to the view direction; a ray's samples are Δ apart everywhere. Both approximate the same integral, and their difference shrinks as the step gets smaller."
                    .to_owned(),
            );
        } else {
            sentences.push(
                "In an orthographic view slices and rays take the same samples: they differ only by rounding and by the points listed below."
                    .to_owned(),
            );
        }
    }
    if differ(|run| run.method.early_stop) {
        sentences.push(
            "Rays, and slices drawn front to back, end where less than 1/512 of the light passes; slices drawn back to front composite everything. What is left out is at most half a grey level (of 256)."
                .to_owned(),
        );
    }
    if shown.iter().any(|run| run.method.blend_format.starts_with("16")) {
        sentences.push(
            "In 16 bits the picture is rounded to 11 significant bits after every slice. Over hundreds of thin slices this adds up to a few grey levels (of 256) where a picture is nearly opaque; slabs round less often."
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
    if differ(|run| run.method.map_filter) {
        sentences.push(
            "Displacement maps are interpolated with weights of different precision: with 8 bits a sample moves by up to 1/512 texel of the map, which shows at edges in coarse maps."
                .to_owned(),
        );
    }
    if differ(|run| run.method.jacobian) {
        sentences.push(
            "Stored Jacobians are central differences at the texels, rounded to the map's format and interpolated between them; they differ from differences at the sample by that rounding, and in the outermost texels."
                .to_owned(),
        );
    }
    sentences
}
