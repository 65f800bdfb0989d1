//! The WGSL of a volume given by a function: its operations as statements.

use super::context::{Context, lock};
use crate::volume::VoxelGrid;
use crate::volume::function::{Binary, Operation, Ternary, Unary, VolumeFunction};
use std::fmt::Write;
use std::hash::{DefaultHasher, Hash, Hasher};

impl Context {
    /// The number by which pipelines name a grid's function, if it has one.
    pub(super) fn function(&self, grid: &VoxelGrid) -> Option<u64> {
        let text = wgsl(grid.function.as_ref()?);
        let mut hasher = DefaultHasher::new();
        text.hash(&mut hasher);
        let number = hasher.finish();
        lock(&self.functions).entry(number).or_insert_with(|| text.into());
        Some(number)
    }
}

/// The text of `sample_volume`, which replaces `shaders/lib/voxels.wgsl`.
pub fn wgsl(function: &VolumeFunction) -> String {
    let m = &function.world_from_voxel;
    let columns = [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis].map(|c| c.to_array());
    let [x, y, z] = columns;
    let vector = |v: [f32; 3]| format!("vec3<f32>({:?}, {:?}, {:?})", v[0], v[1], v[2]);
    let mut text = String::from("fn sample_volume(p: vec3<f32>) -> f32 {\n");
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "    let q = {} * p.x + {} * p.y + {} * p.z + {};",
        vector(x),
        vector(y),
        vector(z),
        vector(m.translation.to_array())
    );
    for (n, operation) in function.expression.operations().iter().enumerate() {
        let _ = writeln!(text, "    let v{n} = {};", statement(operation));
    }
    let last = function.expression.operations().len().saturating_sub(1);
    let _ = writeln!(
        text,
        "    return clamp(v{last}, -1e30, 1e30) * {:?} + {:?};\n}}",
        function.scale, function.offset
    );
    text
}

/// A number limited to what values can be.
fn limited(number: &str) -> String {
    format!("clamp({number}, -1e30, 1e30)")
}

/// The right-hand side of an operation; operand n is the variable `vn`.
fn statement(operation: &Operation) -> String {
    match *operation {
        // Not folded: 1 / 0 would be an error of the shader.
        Operation::Constant(number) => format!("f32({number:?})"),
        Operation::Component(axis) => format!("q.{}", ["x", "y", "z"][axis]),
        Operation::Unary(f, a) => match f {
            Unary::Negate => format!("-v{a}"),
            Unary::Absolute => format!("abs(v{a})"),
            Unary::SquareRoot => format!("sqrt(max(v{a}, 0.0))"),
            Unary::Sine => format!("sin(v{a})"),
            Unary::Cosine => format!("cos(v{a})"),
            Unary::Exponential => format!("exp(min(v{a}, 69.0))"),
            Unary::Logarithm => format!("log(max(v{a}, 1e-30))"),
            Unary::Floor => format!("floor(v{a})"),
            Unary::SmoothStep => format!("smoothstep(0.0, 1.0, v{a})"),
        },
        Operation::Binary(f, [a, b]) => match f {
            Binary::Add => format!("v{a} + v{b}"),
            Binary::Subtract => format!("v{a} - v{b}"),
            Binary::Multiply => limited(&format!("v{a} * v{b}")),
            Binary::Divide => format!("select({}, 0.0, v{b} == 0.0)", limited(&format!("v{a} / v{b}"))),
            Binary::Minimum => format!("min(v{a}, v{b})"),
            Binary::Maximum => format!("max(v{a}, v{b})"),
            Binary::Remainder => {
                format!("select(0.0, clamp(v{a} - v{b} * floor(v{a} / v{b}), 0.0, v{b}), v{b} > 0.0)")
            }
            Binary::Arctangent => {
                format!("select(atan2(v{a}, v{b}), 0.0, v{a} == 0.0 && v{b} == 0.0)")
            }
            Binary::Less => format!("select(0.0, 1.0, v{a} < v{b})"),
        },
        Operation::Ternary(f, [a, b, c]) => match f {
            Ternary::Mix => limited(&format!("v{a} + (v{b} - v{a}) * clamp(v{c}, 0.0, 1.0)")),
            Ternary::Select => format!("select(v{c}, v{b}, v{a} > 0.5)"),
            Ternary::Noise => format!("noise(vec3<f32>(v{a}, v{b}, v{c}))"),
        },
    }
}
