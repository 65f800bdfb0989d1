//! Blinn-Phong under one directional light (Blinn 1977), for one sample and for eight at once.
//!
//! `shaders/lib/light.wgsl` computes the same.

use super::lanes::*;

/// Coefficients of a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlinnPhong {
    /// Ambient weight.
    pub ambient: f32,
    /// Diffuse weight of the directional light.
    pub diffuse: f32,
    /// Strength of the highlight.
    pub specular: f32,
    /// Exponent of the highlight.
    pub shininess: f32,
}

/// The number types of the lighting code: one number, or eight.
pub trait LightNumber: Copy {
    /// `self · factor + summand` where `self` is positive, else `summand`.
    fn positive_times_plus(self, factor: f32, summand: f32) -> Self;

    /// `strength · cosine ^ exponent` where the surface faces the light (`facing` is positive) and
    /// the cosine is positive, else 0.
    fn highlight(facing: Self, cosine: Self, strength: f32, exponent: f32) -> Self;
}

impl LightNumber for f32 {
    #[inline(always)]
    fn positive_times_plus(self, factor: f32, summand: f32) -> Self {
        summand + factor * self.max(0.0)
    }

    #[inline(always)]
    fn highlight(facing: Self, cosine: Self, strength: f32, exponent: f32) -> Self {
        if facing > 0.0 {
            strength * cosine.max(0.0).powf(exponent)
        } else {
            0.0
        }
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

/// The exponent of a highlight as an integer, if it is one.
#[inline(always)]
fn whole(exponent: f32) -> Option<u32> {
    (exponent.fract() == 0.0 && (0.0..=1024.0).contains(&exponent)).then_some(exponent as u32)
}

impl BlinnPhong {
    /// The factor on a surface's colour, and the highlight added to it. `facing` is the cosine
    /// between the normal and the light, `cosine` that between the normal and the half vector.
    #[inline(always)]
    pub fn shine<N: LightNumber>(&self, facing: N, cosine: N) -> (N, N) {
        (
            facing.positive_times_plus(self.diffuse, self.ambient),
            N::highlight(facing, cosine, self.specular, self.shininess),
        )
    }
}
