//! SIMD lanes of eight: vectors whose components are SIMD registers, and functions that registers
//! lack: powers and logarithms.
//!
//! *Theory*: neighbouring rays apply the same operations to different numbers. `Vec3x8` holds the x
//! of eight points in one register, their y in a second and their z in a third; code written for
//! one point works on eight. Points and vectors are transformed by the same operations as in scalar
//! code, bit for bit. Interpolation and polynomials use fused multiply-add (`mul_add`) where the
//! machine has it: their last bit differs from scalar code, and between machines with and without
//! it.
//!
//! *How to call it*: [`with_simd`] runs a function compiled for the best registers of the machine
//! (AVX2, else the target's baseline). Everything it calls must be `#[inline(always)]`, closures
//! included, and registers must not pass through functions that are not (`map` of an array):
//! otherwise that code is compiled for the baseline, and every operation becomes a call, which is
//! many times slower.

pub use fearless_simd::prelude::{Bytes, ExtractToken, Select, Simd, SimdBase, SimdFloat, SimdInt, SimdMask};
pub use fearless_simd::{f32x4, f32x8, i16x8, i32x4, i32x8, mask32x8};

use fearless_simd::Level;
use glam::{Affine3A, Mat3, Vec3};
use std::ops::{Add, Mul, Neg, Sub};

/// Lanes of a register.
pub const LANES: usize = 8;

/// A function generic over registers.
pub trait SimdKernel {
    /// Its result.
    type Output;
    /// Runs it; must be `#[inline(always)]`.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// Runs a function on the best registers of this machine.
pub fn with_simd<F: SimdKernel>(f: F) -> F::Output {
    let level = Level::new();
    // Two levels, not the six that `dispatch!` knows: each is a copy of the renderer for each voxel
    // type. AVX-512 is slower than AVX2 for vectors of eight.
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = level.as_avx2() {
        return simd.vectorize(
            #[inline(always)]
            || f.run(simd),
        );
    }
    #[cfg(target_arch = "x86_64")]
    match level.as_sse2() {
        Some(simd) => simd.vectorize(
            #[inline(always)]
            || f.run(simd),
        ),
        None => unreachable!("every x86-64 has SSE2"),
    }
    #[cfg(not(target_arch = "x86_64"))]
    fearless_simd::dispatch!(level, simd => f.run(simd))
}

/// The lanes set in a bit mask.
#[inline(always)]
pub fn lanes_of(bits: u64) -> LaneIndices {
    LaneIndices(bits)
}

/// See [`lanes_of`].
#[derive(Clone, Copy, Debug)]
pub struct LaneIndices(u64);

impl Iterator for LaneIndices {
    type Item = usize;

    #[inline(always)]
    fn next(&mut self) -> Option<usize> {
        if self.0 == 0 {
            return None;
        }
        let lane = self.0.trailing_zeros() as usize;
        self.0 &= self.0 - 1;
        Some(lane & (LANES - 1))
    }
}

/// Eight vectors.
#[derive(Clone, Copy, Debug)]
pub struct Vec3x8<S: Simd> {
    /// First components.
    pub x: f32x8<S>,
    /// Second components.
    pub y: f32x8<S>,
    /// Third components.
    pub z: f32x8<S>,
}

impl<S: Simd> Vec3x8<S> {
    /// One vector in all lanes.
    #[inline(always)]
    pub fn splat(simd: S, v: Vec3) -> Self {
        Self {
            x: f32x8::splat(simd, v.x),
            y: f32x8::splat(simd, v.y),
            z: f32x8::splat(simd, v.z),
        }
    }

    /// A vector for every lane.
    #[inline(always)]
    pub fn from_lanes(simd: S, v: &[Vec3; LANES]) -> Self {
        let mut all = [[0.0; LANES]; 3];
        for (n, v) in v.iter().enumerate() {
            (all[0][n], all[1][n], all[2][n]) = (v.x, v.y, v.z);
        }
        Self {
            x: f32x8::load_array(simd, all[0]),
            y: f32x8::load_array(simd, all[1]),
            z: f32x8::load_array(simd, all[2]),
        }
    }

    /// The vector of a lane.
    #[inline(always)]
    pub fn lane(&self, n: usize) -> Vec3 {
        Vec3::new(self.x[n], self.y[n], self.z[n])
    }

    /// Writes the vector of a lane.
    #[inline(always)]
    pub fn set(&mut self, n: usize, v: Vec3) {
        (self.x[n], self.y[n], self.z[n]) = (v.x, v.y, v.z);
    }

    /// Scalar products.
    #[inline(always)]
    pub fn dot(self, v: Self) -> f32x8<S> {
        self.x * v.x + self.y * v.y + self.z * v.z
    }

    /// Vector products.
    #[inline(always)]
    pub fn cross(self, v: Self) -> Self {
        Self {
            x: self.y * v.z - self.z * v.y,
            y: self.z * v.x - self.x * v.z,
            z: self.x * v.y - self.y * v.x,
        }
    }

    /// Lengths.
    #[inline(always)]
    pub fn length(self) -> f32x8<S> {
        self.dot(self).sqrt()
    }

    /// `v / |v|`, or zero where `v` has no direction.
    #[inline(always)]
    pub fn normalized(self) -> Self {
        let squared = self.dot(self);
        let usable = squared.simd_gt(1e-30) & squared.simd_lt(f32::INFINITY);
        let zero = f32x8::splat(squared.token(), 0.0);
        let factor = usable.select(f32x8::splat(squared.token(), 1.0) / squared.sqrt(), zero);
        Self {
            x: usable.select(self.x, zero),
            y: usable.select(self.y, zero),
            z: usable.select(self.z, zero),
        } * factor
    }

    /// The first where the mask is set, else the second.
    #[inline(always)]
    pub fn select(mask: mask32x8<S>, yes: Self, no: Self) -> Self {
        Self {
            x: mask.select(yes.x, no.x),
            y: mask.select(yes.y, no.y),
            z: mask.select(yes.z, no.z),
        }
    }

    /// Points under one transform, by the order of operations of glam's `transform_point3`.
    #[inline(always)]
    pub fn transformed(self, m: &Affine3A) -> Self {
        let [x, y, z, t] = [
            Vec3::from(m.matrix3.x_axis),
            m.matrix3.y_axis.into(),
            m.matrix3.z_axis.into(),
            m.translation.into(),
        ];
        Self {
            x: self.x * x.x + self.y * y.x + self.z * z.x + t.x,
            y: self.x * x.y + self.y * y.y + self.z * z.y + t.y,
            z: self.x * x.z + self.y * y.z + self.z * z.z + t.z,
        }
    }

    /// Vectors under one linear map.
    #[inline(always)]
    pub fn mapped(self, m: &Mat3) -> Self {
        let (x, y, z) = (m.x_axis, m.y_axis, m.z_axis);
        Self {
            x: self.x * x.x + self.y * y.x + self.z * z.x,
            y: self.x * x.y + self.y * y.y + self.z * z.y,
            z: self.x * x.z + self.y * y.z + self.z * z.z,
        }
    }
}

impl<S: Simd> Add for Vec3x8<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, v: Self) -> Self {
        Self {
            x: self.x + v.x,
            y: self.y + v.y,
            z: self.z + v.z,
        }
    }
}

impl<S: Simd> Sub for Vec3x8<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, v: Self) -> Self {
        Self {
            x: self.x - v.x,
            y: self.y - v.y,
            z: self.z - v.z,
        }
    }
}

impl<S: Simd> Mul<f32x8<S>> for Vec3x8<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, f: f32x8<S>) -> Self {
        Self {
            x: self.x * f,
            y: self.y * f,
            z: self.z * f,
        }
    }
}

impl<S: Simd> Neg for Vec3x8<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self {
            x: -self.x,
            y: -self.y,
            z: -self.z,
        }
    }
}

/// 2^x with a relative error of 2e-7, for x from -126 to 126; clamped outside.
#[inline(always)]
pub fn exp2<S: Simd>(x: f32x8<S>) -> f32x8<S> {
    let x = x.max(-126.0).min(126.0);
    let whole = x.round_ties_even();
    let f = x - whole;
    // The series of e^(f ln 2) for |f| <= 1/2; the next term is below 6e-9.
    let mut p = f * 1.525_273_4e-5 + 1.540_353e-4;
    for c in [
        1.333_355_8e-3,
        9.618_129e-3,
        5.550_411e-2,
        2.402_265e-1,
        6.931_472e-1,
        1.0,
    ] {
        p = p.mul_add(f, c);
    }
    let exponent: i32x8<S> = (whole.to_int::<i32x8<S>>() + 127) << 23;
    p * exponent.bitcast::<f32x8<S>>()
}

/// log2 of positive normal numbers, with a relative error of 2e-7; near 1, relative to the distance
/// from 1.
#[inline(always)]
pub fn log2<S: Simd>(x: f32x8<S>) -> f32x8<S> {
    let bits = x.bitcast::<i32x8<S>>();
    // Mantissas from √(1/2) to √2.
    let exponent = (bits - 0x3f35_04f3) >> 23;
    let m = (bits - (exponent << 23)).bitcast::<f32x8<S>>();
    let z = (m - 1.0) / (m + 1.0);
    let zz = z * z;
    // 2 artanh(z) / ln 2 = log2 m; |z| < 0.172, the next term is below 3e-9.
    let mut p = zz * (2.0 / 9.0) + 2.0 / 7.0;
    for c in [2.0 / 5.0, 2.0 / 3.0, 2.0] {
        p = p.mul_add(zz, c);
    }
    exponent.to_float::<f32x8<S>>() + p * z * std::f32::consts::LOG2_E
}

/// x^n by squaring.
#[inline(always)]
pub fn powi<S: Simd>(x: f32x8<S>, n: u32) -> f32x8<S> {
    let (mut square, mut left) = (x, n);
    let mut power = f32x8::splat(x.token(), 1.0);
    while left > 0 {
        if left & 1 == 1 {
            power *= square;
        }
        square = square * square;
        left >>= 1;
    }
    power
}

/// Which numbers lie between two bounds, inclusive.
#[inline(always)]
pub fn within<S: Simd>(x: f32x8<S>, low: f32, high: f32) -> mask32x8<S> {
    x.simd_ge(low) & x.simd_le(high)
}

/// Hermite interpolation between two edges, as in WGSL.
#[inline(always)]
pub fn smoothstep<S: Simd>(edge0: f32, edge1: f32, x: f32x8<S>) -> f32x8<S> {
    let t = ((x - edge0) / (edge1 - edge0)).max(0.0).min(1.0);
    t * t * (-(t * 2.0) + 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Functions([f32; LANES]);

    impl SimdKernel for Functions {
        type Output = ([f32; LANES], [f32; LANES]);
        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> Self::Output {
            let x = f32x8::load_array(simd, self.0);
            (*exp2(x), *log2(x.abs()))
        }
    }

    #[test]
    fn powers_and_logarithms() {
        for n in 0..4000 {
            let x: [f32; LANES] =
                std::array::from_fn(|lane| (n as f32 - 2000.0) * 0.031 + lane as f32 * 0.003 + 1e-4);
            let (powers, logarithms) = with_simd(Functions(x));
            for lane in 0..LANES {
                let (want, x) = (f64::from(x[lane]).exp2(), x[lane]);
                assert!(
                    (f64::from(powers[lane]) / want - 1.0).abs() < 3e-7,
                    "2^{x} is {want}, not {}",
                    powers[lane]
                );
                let want = f64::from(x.abs()).log2();
                assert!(
                    (f64::from(logarithms[lane]) - want).abs() <= 2.5e-7 * want.abs(),
                    "log2 of {x} is {want}, not {}",
                    logarithms[lane]
                );
            }
        }
        struct Powers([f32; LANES], u32);
        impl SimdKernel for Powers {
            type Output = [f32; LANES];
            #[inline(always)]
            fn run<S: Simd>(self, simd: S) -> Self::Output {
                *powi(f32x8::load_array(simd, self.0), self.1)
            }
        }
        let cosines: [f32; LANES] = std::array::from_fn(|lane| 1.0 - 0.13 * lane as f32);
        for n in [0u32, 1, 2, 3, 20, 24, 63, 64, 1023] {
            for (x, got) in cosines.into_iter().zip(with_simd(Powers(cosines, n))) {
                let want = f64::from(x).powi(n as i32);
                assert!(
                    (f64::from(got) - want).abs() <= 1e-6 * f64::from(n.max(1)) * want + 1e-37,
                    "{x}^{n} is {want}, not {got}"
                );
            }
        }
        let near_one = std::array::from_fn(|lane| 1.0 - 1e-4 * (lane + 1) as f32);
        let (_, logarithms) = with_simd(Functions(near_one));
        assert!(
            (0..LANES).all(|n| (f64::from(logarithms[n]) / f64::from(near_one[n]).log2() - 1.0).abs() < 3e-7)
        );
        let (powers, _) = with_simd(Functions([
            f32::INFINITY,
            f32::NEG_INFINITY,
            300.0,
            -300.0,
            0.0,
            1.0,
            -1.0,
            10.0,
        ]));
        assert!(
            powers[0] == 126f32.exp2()
                && powers[1] == (-126f32).exp2()
                && powers[4..] == [1.0, 2.0, 0.5, 1024.0]
        );
    }
}
