//! Values of an expression at many points at once, and bounds on its values over boxes.
//!
//! Bounds follow by interval arithmetic (Moore 1966): each operation maps intervals of its operands
//! to an interval that holds every result. They are conservative, not tight.

use super::expression::{Binary, Expression, LARGEST, Operation, Ternary, Unary, limited};
use crate::math::Bounds;
use glam::Vec3;
use std::cell::RefCell;
use std::f32::consts::{PI, TAU};

/// A range of numbers, both ends included.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Interval {
    /// Smallest.
    pub low: f32,
    /// Largest.
    pub high: f32,
}

thread_local! {
    static NUMBERS: RefCell<Vec<Vec<f32>>> = const { RefCell::new(Vec::new()) };
}

impl Expression {
    /// Values at points given by their components, world mm.
    pub fn evaluate(&self, point: [&[f32]; 3], values: &mut [f32]) {
        NUMBERS.with_borrow_mut(|registers| {
            self.run(
                registers,
                values.len(),
                |axis, n| point[axis][n],
                |v| v,
                &PointArithmetic,
            );
            if let Some(last) = self.operations().len().checked_sub(1) {
                let result = &registers[self.register(last)];
                for (value, result) in values.iter_mut().zip(result) {
                    *value = limited(*result);
                }
            }
        });
    }

    /// The value at a point, world mm.
    pub fn value(&self, point: Vec3) -> f32 {
        let mut value = [0.0];
        self.evaluate([&[point.x], &[point.y], &[point.z]], &mut value);
        value[0]
    }

    /// Bounds on the values in boxes, world mm.
    pub fn bounds(&self, boxes: &[Bounds]) -> Vec<Interval> {
        let mut registers = Vec::new();
        let component = |axis: usize, n: usize| Interval {
            low: boxes[n].min[axis],
            high: boxes[n].max[axis],
        };
        let constant = |low| Interval { low, high: low };
        self.run(
            &mut registers,
            boxes.len(),
            component,
            constant,
            &IntervalArithmetic,
        );
        let Some(last) = self.operations().len().checked_sub(1) else {
            return Vec::new();
        };
        registers[self.register(last)]
            .iter()
            .take(boxes.len())
            .map(|i| i.limited())
            .collect()
    }

    /// Performs every operation for `count` points, or boxes, before the next operation.
    fn run<T: Copy + Default, A: Arithmetic<T>>(
        &self,
        registers: &mut Vec<Vec<T>>,
        count: usize,
        component: impl Fn(usize, usize) -> T,
        constant: impl Fn(f32) -> T,
        arithmetic: &A,
    ) {
        if registers.len() < self.register_count() {
            registers.resize_with(self.register_count(), Vec::new);
        }
        for (n, operation) in self.operations().iter().enumerate() {
            let mut to = std::mem::take(&mut registers[self.register(n)]);
            to.resize(count, T::default());
            let of = |operand: usize| &registers[self.register(operand)][..count];
            match *operation {
                Operation::Constant(number) => to.fill(constant(number)),
                Operation::Component(axis) => {
                    to.iter_mut()
                        .enumerate()
                        .for_each(|(n, to)| *to = component(axis, n));
                }
                Operation::Unary(f, a) => arithmetic.unary(f, of(a), &mut to),
                Operation::Binary(f, [a, b]) => arithmetic.binary(f, of(a), of(b), a == b, &mut to),
                Operation::Ternary(f, [a, b, c]) => arithmetic.ternary(f, of(a), of(b), of(c), &mut to),
            }
            registers[self.register(n)] = to;
        }
    }
}

/// What the operations do to numbers, or to intervals.
trait Arithmetic<T> {
    fn unary(&self, f: Unary, a: &[T], to: &mut [T]);

    /// `same`: both operands are one.
    fn binary(&self, f: Binary, a: &[T], b: &[T], same: bool, to: &mut [T]);

    fn ternary(&self, f: Ternary, a: &[T], b: &[T], c: &[T], to: &mut [T]);
}

fn each<T: Copy>(a: &[T], to: &mut [T], f: impl Fn(T) -> T) {
    for (to, &a) in to.iter_mut().zip(a) {
        *to = f(a);
    }
}

fn each_pair<T: Copy>(a: &[T], b: &[T], to: &mut [T], f: impl Fn(T, T) -> T) {
    for ((to, &a), &b) in to.iter_mut().zip(a).zip(b) {
        *to = f(a, b);
    }
}

struct PointArithmetic;

impl Arithmetic<f32> for PointArithmetic {
    fn unary(&self, f: Unary, a: &[f32], to: &mut [f32]) {
        match f {
            Unary::Negate => each(a, to, |a| -a),
            Unary::Absolute => each(a, to, f32::abs),
            Unary::SquareRoot => each(a, to, |a| a.max(0.0).sqrt()),
            Unary::Sine => each(a, to, f32::sin),
            Unary::Cosine => each(a, to, f32::cos),
            Unary::Exponential => each(a, to, |a| a.min(69.0).exp()),
            Unary::Logarithm => each(a, to, |a| a.max(1e-30).ln()),
            Unary::Floor => each(a, to, f32::floor),
            Unary::SmoothStep => each(a, to, |a| crate::math::smoothstep(0.0, 1.0, a)),
        }
    }

    fn binary(&self, f: Binary, a: &[f32], b: &[f32], _: bool, to: &mut [f32]) {
        match f {
            Binary::Add => each_pair(a, b, to, |a, b| a + b),
            Binary::Subtract => each_pair(a, b, to, |a, b| a - b),
            Binary::Multiply => each_pair(a, b, to, |a, b| limited(a * b)),
            Binary::Divide => each_pair(a, b, to, |a, b| if b == 0.0 { 0.0 } else { limited(a / b) }),
            Binary::Minimum => each_pair(a, b, to, f32::min),
            Binary::Maximum => each_pair(a, b, to, f32::max),
            Binary::Remainder => each_pair(a, b, to, remainder),
            Binary::Arctangent => each_pair(a, b, to, f32::atan2),
            Binary::Less => each_pair(a, b, to, |a, b| f32::from(u8::from(a < b))),
        }
    }

    fn ternary(&self, f: Ternary, a: &[f32], b: &[f32], c: &[f32], to: &mut [f32]) {
        for (n, to) in to.iter_mut().enumerate() {
            let (a, b, c) = (a[n], b[n], c[n]);
            *to = match f {
                Ternary::Mix => limited(a + (b - a) * c.clamp(0.0, 1.0)),
                Ternary::Select => {
                    if a > 0.5 {
                        b
                    } else {
                        c
                    }
                }
                Ternary::Noise => noise(a, b, c),
            };
        }
    }
}

fn remainder(a: f32, b: f32) -> f32 {
    if b > 0.0 {
        // Rounding can leave the range by a little.
        (a - b * (a / b).floor()).max(0.0).min(b)
    } else {
        0.0
    }
}

/// Smooth value noise in [-1, 1]. `shaders/lib/noise.wgsl` computes the same.
fn noise(x: f32, y: f32, z: f32) -> f32 {
    let p = glam::Vec3::new(x, y, z);
    let cell = p.floor();
    let f = p - cell;
    let f = f * f * (3.0 - 2.0 * f);
    let hash = |x: i32, y: i32, z: i32| {
        let mut h = (x as u32).wrapping_mul(0x8da6_b343)
            ^ (y as u32).wrapping_mul(0xd816_3841)
            ^ (z as u32).wrapping_mul(0xcb1a_b31f);
        h = (h ^ (h >> 13)).wrapping_mul(0x5bd1_e995);
        ((h ^ (h >> 15)) & 0xffff) as f32 / 32767.5 - 1.0
    };
    let (x, y, z) = (cell.x as i32, cell.y as i32, cell.z as i32);
    let next = |n: i32, by: i32| n.wrapping_add(by);
    let edge = |dy: i32, dz: i32| {
        let a = hash(x, next(y, dy), next(z, dz));
        a + (hash(next(x, 1), next(y, dy), next(z, dz)) - a) * f.x
    };
    let (a, b) = (
        edge(0, 0) + (edge(1, 0) - edge(0, 0)) * f.y,
        edge(0, 1) + (edge(1, 1) - edge(0, 1)) * f.y,
    );
    a + (b - a) * f.z
}

impl Interval {
    /// Everything.
    const ALL: Self = Self {
        low: f32::NEG_INFINITY,
        high: f32::INFINITY,
    };

    fn new(low: f32, high: f32) -> Self {
        Self { low, high }
    }

    /// The smallest interval that holds some numbers; everything if one is not a number.
    fn hull(numbers: &[f32]) -> Self {
        if numbers.iter().any(|n| n.is_nan()) {
            return Self::ALL;
        }
        numbers
            .iter()
            .fold(Self::new(f32::INFINITY, f32::NEG_INFINITY), |i, &n| {
                Self::new(i.low.min(n), i.high.max(n))
            })
    }

    fn increasing(self, f: impl Fn(f32) -> f32) -> Self {
        Self::hull(&[f(self.low), f(self.high)])
    }

    fn absolute(self) -> Self {
        if self.low <= 0.0 && self.high >= 0.0 {
            Self::new(0.0, self.high.max(-self.low))
        } else {
            self.increasing(f32::abs)
        }
    }

    /// The range of the sine; of the cosine with `quarter` = π/2.
    fn sine(self, quarter: f32) -> Self {
        let width = self.high - self.low;
        if width.is_nan() || width >= TAU {
            return Self::new(-1.0, 1.0);
        }
        // Rounding of an angle, which grows with it.
        let slack = 1e-5 + 4.0 * f32::EPSILON * self.low.abs().max(self.high.abs());
        // Whether an angle of the interval, or one nearly in it, is `angle` + k · 2π.
        let holds = |angle: f32| {
            let (a, b) = (
                (self.low - angle - slack) / TAU,
                (self.high - angle + slack) / TAU,
            );
            a.ceil() <= b
        };
        let ends = Self::new(self.low + quarter, self.high + quarter).increasing(f32::sin);
        Self::new(
            if holds(-0.5 * PI - quarter) {
                -1.0
            } else {
                (ends.low - slack).max(-1.0)
            },
            if holds(0.5 * PI - quarter) {
                1.0
            } else {
                (ends.high + slack).min(1.0)
            },
        )
    }

    /// What values are limited to; everything if an end is not a number.
    fn limited(self) -> Self {
        if self.low.is_nan() || self.high.is_nan() {
            return Self::new(-LARGEST, LARGEST);
        }
        Self::new(
            self.low.clamp(-LARGEST, LARGEST),
            self.high.clamp(-LARGEST, LARGEST),
        )
    }

    fn product(self, other: Self) -> Self {
        Self::hull(&[
            self.low * other.low,
            self.low * other.high,
            self.high * other.low,
            self.high * other.high,
        ])
        .limited()
    }

    fn quotient(self, other: Self) -> Self {
        if other.low <= 0.0 && other.high >= 0.0 {
            return Self::new(-LARGEST, LARGEST);
        }
        Self::hull(&[
            self.low / other.low,
            self.low / other.high,
            self.high / other.low,
            self.high / other.high,
        ])
        .limited()
    }

    fn remainder(self, by: Self) -> Self {
        let (first, last) = ((self.low / by.low).floor(), (self.high / by.low).floor());
        if by.low == by.high && by.low > 0.0 && first == last {
            let at = |a: f32, turns: f32| (a - by.low * turns).max(0.0).min(by.low);
            Self::hull(&[at(self.low, first), at(self.high, last)])
        } else {
            Self::new(0.0, by.high.max(0.0))
        }
    }

    /// The angles of the points of a box.
    fn arctangent(self, x: Self) -> Self {
        // Across the negative half of the axis the angle jumps.
        if x.low <= 0.0 && self.low <= 0.0 && self.high >= 0.0 {
            return Self::new(-PI, PI);
        }
        Self::hull(&[
            self.low.atan2(x.low),
            self.low.atan2(x.high),
            self.high.atan2(x.low),
            self.high.atan2(x.high),
        ])
    }
}

struct IntervalArithmetic;

impl Arithmetic<Interval> for IntervalArithmetic {
    fn unary(&self, f: Unary, a: &[Interval], to: &mut [Interval]) {
        let point = |f: fn(f32) -> f32| move |a: Interval| a.increasing(f);
        match f {
            Unary::Negate => each(a, to, point(|a| -a)),
            Unary::Absolute => each(a, to, Interval::absolute),
            Unary::SquareRoot => each(a, to, point(|a| a.max(0.0).sqrt())),
            Unary::Sine => each(a, to, |a| a.sine(0.0)),
            Unary::Cosine => each(a, to, |a| a.sine(0.5 * PI)),
            Unary::Exponential => each(a, to, point(|a| a.min(69.0).exp())),
            Unary::Logarithm => each(a, to, point(|a| a.max(1e-30).ln())),
            Unary::Floor => each(a, to, point(f32::floor)),
            Unary::SmoothStep => each(a, to, point(|a| crate::math::smoothstep(0.0, 1.0, a))),
        }
    }

    fn binary(&self, f: Binary, a: &[Interval], b: &[Interval], same: bool, to: &mut [Interval]) {
        match f {
            Binary::Add => each_pair(a, b, to, |a, b| Interval::new(a.low + b.low, a.high + b.high)),
            Binary::Subtract => each_pair(a, b, to, |a, b| Interval::new(a.low - b.high, a.high - b.low)),
            Binary::Multiply if same => each(a, to, |a| a.absolute().increasing(|a| a * a).limited()),
            Binary::Multiply => each_pair(a, b, to, Interval::product),
            Binary::Divide => each_pair(a, b, to, Interval::quotient),
            Binary::Minimum => each_pair(a, b, to, |a, b| {
                Interval::new(a.low.min(b.low), a.high.min(b.high))
            }),
            Binary::Maximum => each_pair(a, b, to, |a, b| {
                Interval::new(a.low.max(b.low), a.high.max(b.high))
            }),
            Binary::Remainder => each_pair(a, b, to, Interval::remainder),
            Binary::Arctangent => each_pair(a, b, to, Interval::arctangent),
            Binary::Less => each_pair(a, b, to, |a, b| {
                Interval::new(
                    f32::from(u8::from(a.high < b.low)),
                    f32::from(u8::from(a.low < b.high)),
                )
            }),
        }
    }

    fn ternary(&self, f: Ternary, a: &[Interval], b: &[Interval], c: &[Interval], to: &mut [Interval]) {
        for (n, to) in to.iter_mut().enumerate() {
            let (a, b, c) = (a[n], b[n], c[n]);
            *to = match f {
                // Between the two for every share; linear in the share.
                Ternary::Mix => {
                    let at = |a: f32, b: f32, share: f32| a + (b - a) * share.clamp(0.0, 1.0);
                    let lows = [at(a.low, b.low, c.low), at(a.low, b.low, c.high)];
                    let highs = [at(a.high, b.high, c.low), at(a.high, b.high, c.high)];
                    Interval::new(Interval::hull(&lows).low, Interval::hull(&highs).high).limited()
                }
                Ternary::Select if a.low > 0.5 => b,
                Ternary::Select if a.high <= 0.5 => c,
                Ternary::Select => Interval::hull(&[b.low, b.high, c.low, c.high]),
                Ternary::Noise => Interval::new(-1.0, 1.0),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::parse;
    use super::*;
    use proptest::prelude::*;

    const TEXTS: [&str; 14] = [
        "x * y - z / (1 + x^2)",
        "sqrt(abs(x) - 3) + floor(y / 4) * mod(z, 5)",
        "sin(0.3 * x) * cos(0.2 * y) + exp(-z^2 / 50)",
        "atan2(y, x) + log(1 + z^2)",
        "if(x < y, min(x, z), max(y, -z))",
        "mix(x, y, smoothstep(-3, 8, z))",
        "noise(0.3 * x, 0.3 * y, 0.3 * z) * length(x, y, z)",
        "ellipsoid(1, 2, 3, 9, 5, 7) + capsule(-4, 0, 0, 5, 2, 1, 3)",
        "box(0, 1, 0, 5, 6, 7) - disc(0, 0, 1, 0, 0, 1, 6, 2)",
        "cos(400 * x) + sin(300 * y + z)",
        "x^-2 + (y / 7)^-1",
        "(x * y)^16 - (x * z)^16",
        "exp(x * y) / exp(z * 9) * 1e-9",
        "mod(x, y / 3) + floor(x / 41) + smoothstep(5, 5, z)",
    ];

    proptest! {
        /// The value at any point of a box lies within the bounds over the box.
        #[test]
        fn bounds_hold(text in 0..TEXTS.len(), low in prop::array::uniform3(-20.0f32..20.0),
                       extent in prop::array::uniform3(0.0f32..9.0), at in prop::array::uniform3(0.0f32..1.0)) {
            let expression = parse(TEXTS[text]).unwrap();
            let low = Vec3::from(low);
            let b = Bounds::new(low, low + Vec3::from(extent));
            let p = b.min + (b.max - b.min) * Vec3::from(at);
            let value = expression.value(p);
            let bounds = expression.bounds(&[b])[0];
            let slack = 1e-4 * (1.0 + value.abs());
            prop_assert!(bounds.low - slack <= value && value <= bounds.high + slack,
                         "{}: {value} outside {bounds:?}", TEXTS[text]);
        }
    }

    #[test]
    fn bounds_are_close_on_small_boxes() {
        // The others are steep there.
        for text in &TEXTS[..9] {
            let expression = parse(text).unwrap();
            let b = Bounds::new(Vec3::new(6.1, -3.2, 1.3), Vec3::new(6.11, -3.19, 1.31));
            let bounds = expression.bounds(&[b])[0];
            let width = if text.contains("noise") { 15.0 } else { 0.5 };
            assert!(bounds.high - bounds.low < width, "{text}: {bounds:?}");
        }
    }
}
