//! Blinn-Phong under one directional light and an even sky (Blinn 1977), for one sample and for
//! eight at once.
//!
//! `shaders/lib/light.wgsl` computes the same.

use super::lanes::*;
use glam::Vec3;
use std::ops::Mul;

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

/// The shares of the lights that reach a point, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightShares<N> {
    /// Of the directional light.
    pub key: N,
    /// Of the sky.
    pub sky: N,
}

impl LightShares<f32> {
    /// All light, where nothing casts shadows.
    pub const ALL: Self = Self { key: 1.0, sky: 1.0 };
}

/// The number types of the lighting code: one number, or eight.
pub trait LightNumber: Copy + Mul<Output = Self> + Mul<f32, Output = Self> {
    /// `self · factor + summand` where `self` is positive, else `summand`.
    fn positive_times_plus(self, factor: f32, summand: Self) -> Self;

    /// `strength · cosine ^ exponent` where the surface faces the light (`facing` is positive) and
    /// the cosine is positive, else 0.
    fn highlight(facing: Self, cosine: Self, strength: f32, exponent: f32) -> Self;
}

impl LightNumber for f32 {
    #[inline(always)]
    fn positive_times_plus(self, factor: f32, summand: Self) -> Self {
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
    fn positive_times_plus(self, factor: f32, summand: Self) -> Self {
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
    pub fn shine<N: LightNumber>(&self, facing: N, cosine: N, shares: LightShares<N>) -> ([N; 3], N) {
        let [r, g, b] = self.ambient;
        let lit = facing * shares.key;
        (
            [
                lit.positive_times_plus(self.diffuse[0], shares.sky * r),
                lit.positive_times_plus(self.diffuse[1], shares.sky * g),
                lit.positive_times_plus(self.diffuse[2], shares.sky * b),
            ],
            N::highlight(facing, cosine, self.specular, self.shininess) * shares.key,
        )
    }

    /// The colour of a surface under the light, not clamped; the cosines as for [`Self::shine`].
    pub fn lit(&self, color: Vec3, facing: f32, cosine: f32, shares: LightShares<f32>) -> Vec3 {
        let (factors, highlight) = self.shine(facing, cosine, shares);
        color * Vec3::from(factors) + Vec3::from(self.highlight_color) * highlight
    }

    /// Factors on a colour with a part of the directional light, independent of a normal.
    #[inline(always)]
    pub fn even<N: LightNumber>(&self, part: f32, shares: LightShares<N>) -> [N; 3] {
        let [r, g, b] = self.ambient;
        let [x, y, z] = self.diffuse;
        [
            shares.key.positive_times_plus(part * x, shares.sky * r),
            shares.key.positive_times_plus(part * y, shares.sky * g),
            shares.key.positive_times_plus(part * z, shares.sky * b),
        ]
    }
}
