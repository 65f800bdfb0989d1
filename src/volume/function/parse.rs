//! Functions from text, e.g. `cover(60 - length(x, y, z), 2)`.
//!
//! Arithmetic by `+ - * / ^`, comparisons `<` and `>` with the value 1 or 0, parentheses, numbers,
//! `x`, `y`, `z` (world mm), `pi`, and the functions of [`FUNCTIONS`].

use super::expression::{Expression, Graph, Point, Value};
use super::solids;
use crate::error::suggestion;
use glam::Vec3;

/// Maximum depth of parentheses and signs.
const MAX_DEPTH: usize = 100;
/// Largest exponent of a whole power; beyond it every number is even.
const LARGEST_WHOLE_POWER: f32 = 16_777_216.0;
/// Maximum number of operations.
const MAX_OPERATIONS: usize = 4000;

/// The functions: name, parameters, description.
pub const FUNCTIONS: [(&str, &[&str], &str); 25] = [
    ("abs", &["a"], "the absolute value"),
    ("sqrt", &["a"], "the square root; 0 of a negative number"),
    ("sin", &["a"], "the sine of an angle in radians"),
    ("cos", &["a"], "the cosine of an angle in radians"),
    ("exp", &["a"], "the exponential"),
    ("log", &["a"], "the natural logarithm"),
    ("floor", &["a"], "the largest integer not above a"),
    ("round", &["a"], "the closest integer"),
    ("min", &["a", "b"], "the smaller number"),
    ("max", &["a", "b"], "the larger number"),
    ("mod", &["a", "b"], "the remainder of a / b, from 0 to b"),
    ("atan2", &["y", "x"], "the angle of the point (x, y), in radians"),
    (
        "clamp",
        &["a", "low", "high"],
        "a limited to the range from low to high",
    ),
    ("mix", &["a", "b", "t"], "from a to b as t goes from 0 to 1"),
    ("if", &["c", "a", "b"], "a if c is above 0.5, else b"),
    (
        "smoothstep",
        &["low", "high", "a"],
        "from 0 to 1, smoothly, as a goes from low to high",
    ),
    ("length", &["a", "b", "c"], "the length of a vector"),
    (
        "noise",
        &["a", "b", "c"],
        "smooth noise from -1 to 1 with one value per unit",
    ),
    (
        "cover",
        &["d", "w"],
        "from 0 to 1 as the signed distance d goes from -w to w",
    ),
    (
        "sphere",
        &["cx", "cy", "cz", "r"],
        "signed distance of a ball, positive inside",
    ),
    (
        "ellipsoid",
        &["cx", "cy", "cz", "rx", "ry", "rz"],
        "that of an ellipsoid, exact on its surface",
    ),
    (
        "capsule",
        &["ax", "ay", "az", "bx", "by", "bz", "r"],
        "that of a ball swept from a to b",
    ),
    (
        "box",
        &["cx", "cy", "cz", "hx", "hy", "hz"],
        "that of a box with half-edge lengths h",
    ),
    (
        "disc",
        &["cx", "cy", "cz", "ax", "ay", "az", "r", "h"],
        "that of a cylinder around the direction a, with half-height h",
    ),
    (
        "gyroid",
        &["period"],
        "sin x cos y + sin y cos z + sin z cos x, of x · 2π / period",
    ),
];

/// The function that a text states.
///
/// # Errors
/// A message that names the place and what is wrong there.
pub fn parse(text: &str) -> Result<Expression, String> {
    let graph = Graph::default();
    let mut parser = Parser {
        text,
        at: 0,
        depth: 0,
        graph: &graph,
        point: graph.point(),
    };
    let value = parser.comparison()?;
    if let Some(rest) = parser.rest() {
        return Err(format!("\"{rest}\" follows a complete expression"));
    }
    Ok(graph.finish(value))
}

struct Parser<'t, 'g> {
    text: &'t str,
    /// The next byte.
    at: usize,
    depth: usize,
    graph: &'g Graph,
    point: Point<'g>,
}

impl<'t, 'g> Parser<'t, 'g> {
    /// The text after white space; none at the end.
    fn rest(&mut self) -> Option<&'t str> {
        let rest = &self.text[self.at..];
        let trimmed = rest.trim_start();
        self.at += rest.len() - trimmed.len();
        (!trimmed.is_empty()).then_some(trimmed)
    }

    /// The next character, if it is one of some.
    fn take(&mut self, any: &str) -> Option<char> {
        let next = self.rest()?.chars().next().filter(|c| any.contains(*c))?;
        self.at += next.len_utf8();
        Some(next)
    }

    fn expect(&mut self, character: char) -> Result<(), String> {
        if self.take(&character.to_string()).is_some() {
            return Ok(());
        }
        Err(match self.rest() {
            Some(rest) => format!("expected \"{character}\" at \"{rest}\""),
            None => format!("\"{character}\" is missing at the end"),
        })
    }

    /// Counts one more level of nesting.
    fn deeper(&mut self) -> Result<(), String> {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(format!("it is nested more than {MAX_DEPTH} deep"));
        }
        Ok(())
    }

    fn comparison(&mut self) -> Result<Value<'g>, String> {
        self.deeper()?;
        let a = self.sum()?;
        let compared = match self.take("<>") {
            Some('<') => a.less(self.sum()?),
            Some(_) => self.sum()?.less(a),
            None => a,
        };
        self.depth -= 1;
        Ok(compared)
    }

    fn sum(&mut self) -> Result<Value<'g>, String> {
        let mut a = self.product()?;
        while let Some(sign) = self.take("+-") {
            let b = self.product()?;
            a = if sign == '+' { a + b } else { a - b };
        }
        Ok(a)
    }

    fn product(&mut self) -> Result<Value<'g>, String> {
        let mut a = self.signed()?;
        while let Some(sign) = self.take("*/") {
            let b = self.signed()?;
            a = if sign == '*' { a * b } else { a / b };
        }
        Ok(a)
    }

    fn signed(&mut self) -> Result<Value<'g>, String> {
        if self.take("-").is_none() {
            return self.power();
        }
        self.deeper()?;
        let a = self.signed()?;
        self.depth -= 1;
        Ok(-a)
    }

    fn power(&mut self) -> Result<Value<'g>, String> {
        let base = self.atom()?;
        if self.take("^").is_none() {
            return Ok(base);
        }
        self.deeper()?;
        let exponent = self.signed()?;
        self.depth -= 1;
        Ok(match exponent.number() {
            Some(n) if n.fract() == 0.0 && n.abs() <= LARGEST_WHOLE_POWER => base.powi(n as i32),
            _ => (exponent * base.ln()).exp(),
        })
    }

    fn atom(&mut self) -> Result<Value<'g>, String> {
        if self.graph.len() > MAX_OPERATIONS {
            return Err(format!("it needs more than {MAX_OPERATIONS} operations"));
        }
        let Some(rest) = self.rest() else {
            return Err("it ends where a number, a name or \"(\" is expected".into());
        };
        if self.take("(").is_some() {
            let value = self.comparison()?;
            self.expect(')')?;
            return Ok(value);
        }
        let name = rest
            .find(|c: char| !c.is_ascii_alphanumeric())
            .map_or(rest, |end| &rest[..end]);
        if name.starts_with(|c: char| c.is_ascii_alphabetic()) {
            self.at += name.len();
            return self.named(name);
        }
        let length = number_length(rest);
        let number: f32 = rest[..length]
            .parse()
            .ok()
            .filter(|n: &f32| n.is_finite())
            .ok_or_else(|| format!("expected a number, a name or \"(\" at \"{rest}\""))?;
        self.at += length;
        Ok(self.graph.constant(number))
    }

    fn named(&mut self, name: &str) -> Result<Value<'g>, String> {
        let Point { x, y, z } = self.point;
        match name {
            "x" => return Ok(x),
            "y" => return Ok(y),
            "z" => return Ok(z),
            "pi" => return Ok(self.graph.constant(std::f32::consts::PI)),
            _ => {}
        }
        let Some((_, parameters, _)) = FUNCTIONS.iter().find(|f| f.0 == name) else {
            let known = FUNCTIONS.iter().map(|f| f.0).chain(["x", "y", "z", "pi"]);
            return Err(format!("there is no \"{name}\"; {}", suggestion(name, known)));
        };
        self.expect('(')?;
        let mut arguments = vec![self.comparison()?];
        while self.take(",").is_some() {
            arguments.push(self.comparison()?);
        }
        self.expect(')')?;
        if arguments.len() != parameters.len() {
            return Err(format!(
                "{name}({}) takes {} and is given {}",
                parameters.join(", "),
                count(parameters.len()),
                count(arguments.len())
            ));
        }
        self.call(name, &arguments)
    }

    fn call(&self, name: &str, a: &[Value<'g>]) -> Result<Value<'g>, String> {
        let numbers = || -> Result<Vec<f32>, String> {
            a.iter()
                .map(|a| {
                    a.number()
                        .ok_or_else(|| format!("{name}() takes constants, not functions of x, y and z"))
                })
                .collect()
        };
        let three = |n: &[f32]| [n[0], n[1], n[2]];
        let p = self.point;
        Ok(match name {
            "abs" => a[0].abs(),
            "sqrt" => a[0].sqrt(),
            "sin" => a[0].sin(),
            "cos" => a[0].cos(),
            "exp" => a[0].exp(),
            "log" => a[0].ln(),
            "floor" => a[0].floor(),
            "round" => a[0].round(),
            "min" => a[0].min(a[1]),
            "max" => a[0].max(a[1]),
            "mod" => a[0].remainder(a[1]),
            "atan2" => a[0].atan2(a[1]),
            "clamp" => a[0].max(a[1]).min(a[2]),
            "mix" => a[0].mix(a[1], a[2]),
            "if" => a[0].select(a[1], a[2]),
            "smoothstep" if (a[1] - a[0]).number() == Some(0.0) => a[0].less(a[2]),
            "smoothstep" => ((a[2] - a[0]) / (a[1] - a[0])).smooth_step(),
            "length" => Point::new(a[0], a[1], a[2]).length(),
            "noise" => Point::new(a[0], a[1], a[2]).noise(),
            "cover" if a[1].number() == Some(0.0) => self.graph.constant(0.0).less(a[0]),
            "cover" => ((a[0] + a[1]) / (2.0 * a[1])).smooth_step(),
            "sphere" => {
                let n = numbers()?;
                solids::sphere(p, three(&n), n[3])
            }
            "ellipsoid" => {
                let n = numbers()?;
                if n[3..].iter().any(|r| *r <= 0.0) {
                    return Err("ellipsoid() takes radii above 0".into());
                }
                solids::ellipsoid(p, three(&n), three(&n[3..]))
            }
            "capsule" => {
                let n = numbers()?;
                solids::capsule(p, three(&n), three(&n[3..]), n[6])
            }
            "box" => {
                let n = numbers()?;
                solids::cuboid(p, three(&n), three(&n[3..]))
            }
            "disc" => {
                let n = numbers()?;
                let axis = Vec3::from_slice(&n[3..6])
                    .try_normalize()
                    .ok_or_else(|| "disc() takes an axis that is not 0".to_owned())?;
                solids::disc(p, three(&n), axis.to_array(), n[6], n[7])
            }
            _ => {
                let k = 2.0 * std::f32::consts::PI / a[0];
                let (x, y, z) = (p.x * k, p.y * k, p.z * k);
                x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()
            }
        })
    }
}

fn count(n: usize) -> String {
    match n {
        1 => "1 number".into(),
        n => format!("{n} numbers"),
    }
}

/// The length of the number at the start of a text: digits, a point, an exponent.
fn number_length(text: &str) -> usize {
    let digits = |from: usize| {
        text[from..]
            .find(|c: char| !(c.is_ascii_digit() || c == '.'))
            .map_or(text.len(), |n| from + n)
    };
    let mantissa = digits(0);
    let exponent = text[mantissa..].strip_prefix(['e', 'E']);
    let sign = exponent.map(|e| usize::from(e.starts_with(['+', '-'])));
    match sign {
        Some(sign) if digits(mantissa + 1 + sign) > mantissa + 1 + sign => digits(mantissa + 1 + sign),
        _ => mantissa,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &str, p: [f32; 3]) -> f32 {
        let mut value = [0.0];
        parse(text)
            .unwrap_or_else(|e| panic!("{text}: {e}"))
            .evaluate([&[p[0]], &[p[1]], &[p[2]]], &mut value);
        value[0]
    }

    #[test]
    fn arithmetic_has_its_usual_order() {
        let p = [2.0, 3.0, 5.0];
        for (text, value) in [
            ("x + y * z", 17.0),
            ("(x + y) * z", 25.0),
            ("-x^2", -4.0),
            ("z - y - x", 0.0),
            ("z / y / 5", 1.0 / 3.0),
            ("2^-1", 0.5),
            ("x < y", 1.0),
            ("x > y", 0.0),
            ("1.5e1 + .5", 15.5),
            ("mod(-1, 4)", 3.0),
            ("length(x, y, z)", 38.0f32.sqrt()),
            ("if(x < 1, y, z)", 5.0),
            ("1 / 0", 0.0),
            ("sqrt(-4)", 0.0),
            ("sphere(2, 3, 1, 5)", 1.0),
            ("box(2, 3, 5, 1, 2, 3)", 1.0),
        ] {
            assert!((at(text, p) - value).abs() < 1e-5, "{text}: {}", at(text, p));
        }
    }

    #[test]
    fn every_function_can_be_called() {
        for (name, parameters, _) in FUNCTIONS {
            let numbers: Vec<String> = (0..parameters.len()).map(|n| format!("{}", n + 1)).collect();
            assert!(parse(&format!("{name}({})", numbers.join(","))).is_ok(), "{name}");
        }
    }

    #[test]
    fn mistakes_are_named() {
        for (text, part) in [
            ("", "it ends"),
            ("x +", "it ends"),
            ("(x", "\")\" is missing"),
            ("x y", "\"y\" follows"),
            ("sine(x)", "sin"),
            ("min(x)", "min(a, b) takes 2 numbers and is given 1 number"),
            ("sphere(x, 0, 0, 1)", "takes constants"),
            ("ellipsoid(0, 0, 0, 0, 5, 5)", "radii above 0"),
            ("disc(0, 0, 0, 0, 0, 0, 5, 5)", "an axis that is not 0"),
            ("1e999", "expected a number"),
            ("x # y", "follows"),
            ("é", "expected a number"),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.contains(part), "{text}: {message}");
        }
        assert!(parse(&"(".repeat(100_000)).is_err());
        assert!(parse(&"-".repeat(100_000)).is_err());
        assert!(parse(&"2^".repeat(100_000)).is_err());
    }
}
