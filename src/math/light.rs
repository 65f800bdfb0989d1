//! Blinn-Phong under one directional light (Blinn 1977), for one sample and for eight at once.
//!
//! `shaders/lib/light.wgsl` says the same.

use super::lanes::*;

/// Strengths of a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlinnPhong {
    /// Light from everywhere.
    pub ambient: f32,
    /// Share of the directional light.
    pub diffuse: f32,
    /// Strength of the highlight.
    pub specular: f32,
    /// Exponent of the highlight.
    pub shininess: f32,
}

/// The numbers that light is computed in: one, or eight.
pub trait LightNumber: Copy {
    /// `self · factor + summand` where `self` is positive, else the summand.
    fn positive_times_plus(self, factor: f32, summand: f32) -> Self;

    /// `strength · cosine ^ exponent` where the light shines on the surface (`facing` is positive) and the cosine is, else 0.
    fn highlight(facing: Self, cosine: Self, strength: f32, exponent: f32) -> Self;
}

impl LightNumber for f32 {
    #[inline(always)]
    fn positive_times_plus(self, factor: f32, summand: f32) -> Self {
        summand + factor * self.max(0.0)
    }

    #[inline(always)]
    fn highlight(facing: Self, cosine: Self, strength: f32, exponent: f32) -> Self {
        if facing > 0.0 { strength * cosine.max(0.0).powf(exponent) } else { 0.0 }
    }
}

impl<S: Simd> LightNumber for f32x8<S> {
    #[inline(always)]
    fn positive_times_plus(self, factor: f32, summand: f32) -> Self {
        self.max(0.0).mul_add(factor, summand)
    }

    #[inline(always)]
    fn highlight(facing: Self, cosine: Self, strength: f32, exponent: f32) -> Self {
        let zero = Self::splat(facing.token(), 0.0);
        if strength <= 0.0 {
            return zero;
        }
        let shines = facing.simd_gt(0.0) & cosine.simd_gt(1e-6);
        if shines.all_false() {
            return zero;
        }
        let power = match whole(exponent) {
            Some(n) => powi(cosine, n),
            None => exp2(log2(cosine.max(1e-6)) * exponent),
        };
        shines.select(power * strength, zero)
    }
}

/// The exponent of a highlight as a whole number, if it is one.
#[inline(always)]
fn whole(exponent: f32) -> Option<u32> {
    (exponent.fract() == 0.0 && (0.0..=1024.0).contains(&exponent)).then_some(exponent as u32)
}

impl BlinnPhong {
    /// The factor on a surface's colour, and the highlight that is added to it. `facing` is the cosine of normal and light, `cosine` that of normal
    /// and half vector.
    #[inline(always)]
    pub fn shine<N: LightNumber>(&self, facing: N, cosine: N) -> (N, N) {
        (facing.positive_times_plus(self.diffuse, self.ambient), N::highlight(facing, cosine, self.specular, self.shininess))
    }
}
