//! Blinn-Phong under one directional light and an even sky (Blinn 1977), for one sample and for
//! eight at once.
//!
//! `shaders/lib/light.wgsl` computes the same.

use super::lanes::*;
use glam::Vec3;

/// Coefficients of a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlinnPhong {
    /// Ambient weights of red, green and blue.
    pub ambient: [f32; 3],
    /// Diffuse weights of the directional light.
    pub diffuse: [f32; 3],
    /// Strength of the highlight.
    pub specular: f32,
    /// Exponent of the highlight.
    pub shininess: f32,
    /// Colour of the highlight.
    pub highlight_color: [f32; 3],
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
    /// The factors on red, green and blue of a surface's colour, and the strength of the highlight
    /// added to it. `facing` is the cosine between the normal and the light, `cosine` that between
    /// the normal and the half vector.
    #[inline(always)]
    pub fn shine<N: LightNumber>(&self, facing: N, cosine: N) -> ([N; 3], N) {
        let [r, g, b] = self.ambient;
        (
            [
                facing.positive_times_plus(self.diffuse[0], r),
                facing.positive_times_plus(self.diffuse[1], g),
                facing.positive_times_plus(self.diffuse[2], b),
            ],
            N::highlight(facing, cosine, self.specular, self.shininess),
        )
    }

    /// The colour of a surface under the light, not clamped; the cosines as for [`Self::shine`].
    pub fn lit(&self, color: Vec3, facing: f32, cosine: f32) -> Vec3 {
        let (factors, highlight) = self.shine(facing, cosine);
        color * Vec3::from(factors) + Vec3::from(self.highlight_color) * highlight
    }

    /// Factors on a colour with a share of the directional light, independent of a normal.
    #[inline(always)]
    pub fn even(&self, share: f32) -> [f32; 3] {
        std::array::from_fn(|c| self.ambient[c] + share * self.diffuse[c])
    }
}
