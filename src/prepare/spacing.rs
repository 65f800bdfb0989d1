//! The lengths that a picture is sampled by.

/// A cut's normal takes over within one sample of the cut (of at least one voxel) and has faded out after this many.
const BLEND_SAMPLES: f32 = 2.5;

/// Distance from a cut beyond which it changes nothing about a sample, mm; `slant` is how many times its step a sample's path may be.
pub(super) fn cut_margin_mm(blend_mm: [f32; 2], step_mm: f32, slant: f32) -> f32 {
    blend_mm[1] + 2.2 * step_mm * slant
}

/// Distances from a cut at which its normal stops to rule alone, and to matter at all, mm.
pub(super) fn blend_mm(step: f32, reference_mm: f32) -> [f32; 2] {
    let sample_mm = (step * reference_mm).max(reference_mm);
    [sample_mm, BLEND_SAMPLES * sample_mm]
}

/// Lengths that a picture is sampled by, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleSpacing {
    /// Distance between slices, or between samples along a ray.
    pub step_mm: f32,
    /// Δ₀, the length that opacities are stated for: the smallest voxel spacing.
    pub reference_mm: f32,
    /// Distances from a cut at which its normal stops to rule alone, and to matter at all.
    pub blend_mm: [f32; 2],
}
