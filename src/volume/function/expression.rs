//! The list of operations of a function, and how it is recorded.

use std::cell::RefCell;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// Largest magnitude of a value. Products, quotients and the result are limited to it, and sums have
/// too few terms to leave the range of numbers.
pub(super) const LARGEST: f32 = 1e30;

/// A number limited to what values can be.
pub(super) fn limited(number: f32) -> f32 {
    if number.is_nan() {
        0.0
    } else {
        number.clamp(-LARGEST, LARGEST)
    }
}

/// An operation on one number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the variants are the operations' usual names")]
pub enum Unary {
    Negate,
    Absolute,
    /// The square root; 0 of a negative number.
    SquareRoot,
    Sine,
    Cosine,
    /// The exponential of a number up to 69.
    Exponential,
    /// The natural logarithm of a number not below 1e-30.
    Logarithm,
    Floor,
    /// 3 t² - 2 t³ with t clamped to 0 to 1.
    SmoothStep,
}

/// An operation on two numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the variants are the operations' usual names")]
pub enum Binary {
    Add,
    Subtract,
    Multiply,
    /// The quotient; 0 if the second number is 0.
    Divide,
    Minimum,
    Maximum,
    /// The remainder of division by a positive number, not negative; 0 by any other number.
    Remainder,
    /// The angle of the point (second, first); 0 at the origin.
    Arctangent,
    /// 1 if the first number is below the second, else 0.
    Less,
}

/// An operation on three numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ternary {
    /// From the first number to the second one by the third, which is clamped to 0 to 1.
    Mix,
    /// The second number if the first one is above 0.5, else the third.
    Select,
    /// Smooth value noise in [-1, 1] at a point.
    Noise,
}

/// An operation, with the numbers of the operations whose results it takes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs, reason = "the variants are named after their operands")]
pub enum Operation {
    Constant(f32),
    /// The point's component along an axis, mm.
    Component(usize),
    Unary(Unary, usize),
    Binary(Binary, [usize; 2]),
    Ternary(Ternary, [usize; 3]),
}

impl Operation {
    /// The operations whose results it takes.
    pub fn operands(&self) -> &[usize] {
        match self {
            Self::Constant(_) | Self::Component(_) => &[],
            Self::Unary(_, a) => std::slice::from_ref(a),
            Self::Binary(_, operands) => operands,
            Self::Ternary(_, operands) => operands,
        }
    }
}

/// A function as a list of operations, each after its operands. The last one is the result.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expression {
    operations: Vec<Operation>,
    /// Where each operation's result is kept while it is needed.
    registers: Vec<usize>,
    /// Number of these places.
    register_count: usize,
}

impl Expression {
    /// The operations that `result` of a list needs.
    fn of(all: &[Operation], result: usize) -> Self {
        let mut needed = vec![false; all.len()];
        needed[result] = true;
        // From the last operation to the first, because an operand precedes its use.
        for n in (0..=result).rev() {
            if needed[n] {
                all[n].operands().iter().for_each(|&a| needed[a] = true);
            }
        }
        let mut place = vec![0; all.len()];
        let mut operations = Vec::new();
        for n in (0..=result).filter(|&n| needed[n]) {
            place[n] = operations.len();
            operations.push(match all[n] {
                Operation::Unary(f, a) => Operation::Unary(f, place[a]),
                Operation::Binary(f, o) => Operation::Binary(f, o.map(|a| place[a])),
                Operation::Ternary(f, o) => Operation::Ternary(f, o.map(|a| place[a])),
                other => other,
            });
        }
        let mut last_use: Vec<usize> = (0..operations.len()).collect();
        for (n, operation) in operations.iter().enumerate() {
            operation.operands().iter().for_each(|&a| last_use[a] = n);
        }
        let (mut free, mut registers, mut register_count) = (Vec::new(), Vec::new(), 0);
        for (n, operation) in operations.iter().enumerate() {
            // The result never shares a place with an operand.
            registers.push(free.pop().unwrap_or_else(|| {
                register_count += 1;
                register_count - 1
            }));
            let mut ended: Vec<usize> = operation.operands().to_vec();
            ended.sort_unstable();
            ended.dedup();
            free.extend(
                ended
                    .into_iter()
                    .filter(|&a| last_use[a] == n)
                    .map(|a| registers[a]),
            );
        }
        Self {
            operations,
            registers,
            register_count,
        }
    }

    /// The operations, each after its operands; the last one is the result.
    pub fn operations(&self) -> &[Operation] {
        &self.operations
    }

    /// The place of an operation's result, below [`Self::register_count`].
    pub(super) fn register(&self, operation: usize) -> usize {
        self.registers[operation]
    }

    /// Number of results that are needed at the same time.
    pub(super) fn register_count(&self) -> usize {
        self.register_count
    }
}

/// Records operations.
#[derive(Debug, Default)]
pub struct Graph(RefCell<Vec<Operation>>);

/// The result of a recorded operation; arithmetic on it is recorded as well.
#[derive(Clone, Copy, Debug)]
pub struct Value<'g> {
    graph: &'g Graph,
    operation: usize,
}

/// A point of recorded values, mm.
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs, reason = "the fields are the components' usual names")]
pub struct Point<'g> {
    pub x: Value<'g>,
    pub y: Value<'g>,
    pub z: Value<'g>,
}

impl Graph {
    /// The point at which the function is evaluated.
    pub fn point(&self) -> Point<'_> {
        let [x, y, z] = [0, 1, 2].map(|axis| self.record(Operation::Component(axis)));
        Point { x, y, z }
    }

    /// A number, limited to what values can be.
    pub fn constant(&self, number: f32) -> Value<'_> {
        self.record(Operation::Constant(limited(number)))
    }

    /// Number of recorded operations.
    pub fn len(&self) -> usize {
        self.0.borrow().len()
    }

    /// Whether nothing is recorded.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The function whose value is `result`.
    pub fn finish(&self, result: Value<'_>) -> Expression {
        Expression::of(&self.0.borrow(), result.operation)
    }

    fn record(&self, operation: Operation) -> Value<'_> {
        let mut all = self.0.borrow_mut();
        let constant = |&a: &usize| matches!(all[a], Operation::Constant(_));
        // What depends on numbers alone is computed once.
        let folded = if !operation.operands().is_empty() && operation.operands().iter().all(constant) {
            let mut list: Vec<Operation> = operation.operands().iter().map(|&a| all[a]).collect();
            list.push(match operation {
                Operation::Unary(f, _) => Operation::Unary(f, 0),
                Operation::Binary(f, _) => Operation::Binary(f, [0, 1]),
                Operation::Ternary(f, _) => Operation::Ternary(f, [0, 1, 2]),
                other => other,
            });
            let expression = Expression::of(&list, list.len() - 1);
            let mut value = [0.0];
            expression.evaluate([&[0.0]; 3], &mut value);
            Operation::Constant(value[0])
        } else {
            operation
        };
        let operation = all.iter().position(|known| *known == folded).unwrap_or_else(|| {
            all.push(folded);
            all.len() - 1
        });
        Value {
            graph: self,
            operation,
        }
    }
}

impl<'g> Value<'g> {
    fn unary(self, f: Unary) -> Self {
        self.graph.record(Operation::Unary(f, self.operation))
    }

    fn binary(self, f: Binary, other: Self) -> Self {
        self.graph
            .record(Operation::Binary(f, [self.operation, other.operation]))
    }

    fn ternary(self, f: Ternary, b: Self, c: Self) -> Self {
        self.graph
            .record(Operation::Ternary(f, [self.operation, b.operation, c.operation]))
    }

    /// The number that this value is everywhere, if it is recorded as one.
    pub fn number(self) -> Option<f32> {
        match self.graph.0.borrow()[self.operation] {
            Operation::Constant(number) => Some(number),
            _ => None,
        }
    }

    /// A number beside this value.
    pub fn constant(self, number: f32) -> Self {
        self.graph.constant(number)
    }

    /// See [`Unary::Absolute`].
    pub fn abs(self) -> Self {
        self.unary(Unary::Absolute)
    }

    /// See [`Unary::SquareRoot`].
    pub fn sqrt(self) -> Self {
        self.unary(Unary::SquareRoot)
    }

    /// See [`Unary::Sine`].
    pub fn sin(self) -> Self {
        self.unary(Unary::Sine)
    }

    /// See [`Unary::Cosine`].
    pub fn cos(self) -> Self {
        self.unary(Unary::Cosine)
    }

    /// See [`Unary::Exponential`].
    pub fn exp(self) -> Self {
        self.unary(Unary::Exponential)
    }

    /// See [`Unary::Logarithm`].
    pub fn ln(self) -> Self {
        self.unary(Unary::Logarithm)
    }

    /// See [`Unary::Floor`].
    pub fn floor(self) -> Self {
        self.unary(Unary::Floor)
    }

    /// The closest integer; the higher one halfway between two.
    pub fn round(self) -> Self {
        (self + 0.5).floor()
    }

    /// See [`Unary::SmoothStep`].
    pub fn smooth_step(self) -> Self {
        self.unary(Unary::SmoothStep)
    }

    /// The product with itself.
    pub fn squared(self) -> Self {
        self * self
    }

    /// A whole power: 1 for exponent 0; of 0, 0 for a negative one.
    pub fn powi(self, exponent: i32) -> Self {
        let (mut power, mut square) = (self.constant(1.0), self);
        let mut left = exponent.unsigned_abs();
        while left > 0 {
            if left % 2 == 1 {
                power = if power.number() == Some(1.0) {
                    square
                } else {
                    power * square
                };
            }
            left /= 2;
            if left > 0 {
                square = square.squared();
            }
        }
        if exponent < 0 { 1.0 / power } else { power }
    }

    /// The smaller of two values.
    pub fn min(self, other: impl Operand<'g>) -> Self {
        self.binary(Binary::Minimum, other.beside(self))
    }

    /// The larger of two values.
    pub fn max(self, other: impl Operand<'g>) -> Self {
        self.binary(Binary::Maximum, other.beside(self))
    }

    /// See [`Binary::Remainder`].
    pub fn remainder(self, other: impl Operand<'g>) -> Self {
        self.binary(Binary::Remainder, other.beside(self))
    }

    /// See [`Binary::Arctangent`].
    pub fn atan2(self, x: Self) -> Self {
        self.binary(Binary::Arctangent, x)
    }

    /// See [`Binary::Less`].
    pub fn less(self, other: impl Operand<'g>) -> Self {
        self.binary(Binary::Less, other.beside(self))
    }

    /// See [`Ternary::Select`]; this value is the condition.
    pub fn select(self, yes: impl Operand<'g>, no: impl Operand<'g>) -> Self {
        self.ternary(Ternary::Select, yes.beside(self), no.beside(self))
    }

    /// See [`Ternary::Mix`].
    pub fn mix(self, to: impl Operand<'g>, share: Self) -> Self {
        self.ternary(Ternary::Mix, to.beside(self), share)
    }
}

impl<'g> Point<'g> {
    /// The point from its components.
    pub fn new(x: Value<'g>, y: Value<'g>, z: Value<'g>) -> Self {
        Self { x, y, z }
    }

    /// The length.
    pub fn length(self) -> Value<'g> {
        (self.x.squared() + self.y.squared() + self.z.squared()).sqrt()
    }

    /// The difference to a fixed point.
    pub fn minus(self, other: [f32; 3]) -> Self {
        Self::new(self.x - other[0], self.y - other[1], self.z - other[2])
    }

    /// The components times those of a fixed vector.
    pub fn times(self, other: [f32; 3]) -> Self {
        Self::new(self.x * other[0], self.y * other[1], self.z * other[2])
    }

    /// The scalar product with a fixed vector.
    pub fn dot(self, other: [f32; 3]) -> Value<'g> {
        self.x * other[0] + self.y * other[1] + self.z * other[2]
    }

    /// See [`Ternary::Noise`].
    pub fn noise(self) -> Value<'g> {
        self.x.ternary(Ternary::Noise, self.y, self.z)
    }
}

/// A value, or a number beside one.
pub trait Operand<'g> {
    /// The value, in the graph of `other`.
    fn beside(self, other: Value<'g>) -> Value<'g>;
}

impl<'g> Operand<'g> for Value<'g> {
    fn beside(self, _: Value<'g>) -> Value<'g> {
        self
    }
}

impl<'g> Operand<'g> for f32 {
    fn beside(self, other: Value<'g>) -> Value<'g> {
        other.constant(self)
    }
}

macro_rules! arithmetic {
    ($($operator:ident $method:ident $operation:ident),*) => {
        $(
            impl<'g, T: Operand<'g>> $operator<T> for Value<'g> {
                type Output = Value<'g>;
                fn $method(self, other: T) -> Value<'g> {
                    self.binary(Binary::$operation, other.beside(self))
                }
            }

            impl<'g> $operator<Value<'g>> for f32 {
                type Output = Value<'g>;
                fn $method(self, other: Value<'g>) -> Value<'g> {
                    self.beside(other).binary(Binary::$operation, other)
                }
            }
        )*
    };
}
arithmetic!(Add add Add, Sub sub Subtract, Mul mul Multiply, Div div Divide);

impl<'g> Neg for Value<'g> {
    type Output = Value<'g>;
    fn neg(self) -> Value<'g> {
        self.unary(Unary::Negate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_and_unused_operations_are_recorded_once_and_not_at_all() {
        let graph = Graph::default();
        let p = graph.point();
        let _unused = p.z.sin();
        let sum = (p.x + p.y) * (p.x + p.y) + (graph.constant(2.0) + 3.0);
        let expression = graph.finish(sum);
        // x, y, x + y, its square, 5, the sum.
        assert_eq!(expression.operations().len(), 6, "{expression:?}");
        assert!(expression.register_count() <= 3);
    }
}
