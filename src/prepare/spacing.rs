//! The lengths by which a picture is sampled.

/// Within one sample of a cut (at least one voxel) only the cut's normal is used; after this many
/// samples it has faded out.
const BLEND_SAMPLES: f32 = 2.5;

/// Distance from a cut beyond which it does not affect a sample, mm; `slant` is the longest path of
/// a sample, in steps.
pub(super) fn cut_margin_mm(blend_mm: [f32; 2], step_mm: f32, slant: f32) -> f32 {
    blend_mm[1] + 2.2 * step_mm * slant
}

/// Distance from a cut up to which its normal is used alone, and distance beyond which it has no
/// effect, mm.
pub(super) fn blend_mm(step: f32, reference_mm: f32) -> [f32; 2] {
    let sample_mm = (step * reference_mm).max(reference_mm);
    [sample_mm, BLEND_SAMPLES * sample_mm]
}

/// Sampling lengths of a picture, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleSpacing {
    /// Distance between slices, or between samples along a ray.
    pub step_mm: f32,
    /// Δ₀, the length for which opacities are stated: the smallest voxel spacing.
    pub reference_mm: f32,
    /// Distance from a cut up to which its normal is used alone, and distance beyond which it has
    /// no effect.
    pub blend_mm: [f32; 2],
}
