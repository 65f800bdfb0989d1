//! Brush strokes as text: an editor writes them into a scene and reads them back, and people can
//! type them.
//!
//! A stroke is words and numbers separated by blanks, without commas, which separate strokes on the
//! command line. Lengths and positions are in world millimetres (LPS).
//!
//! ```text
//!   push    RADIUS STRENGTH x y z x y z ...        drags the volume along the line
//!   smooth  RADIUS STRENGTH x y z ...              smooths the displacements
//!   cut     RADIUS STRENGTH x y z ...              removes a tube around the line
//!   restore RADIUS STRENGTH x y z ...              restores such a tube
//!   lasso-cut     EYE ox oy oz rx ry rz ux uy uz px py px py px py ...
//!   lasso-restore EYE ox oy oz rx ry rz ux uy uz px py px py px py ...
//! ```
//!
//! STRENGTH is 0 to 1; cut and restore ignore it. An outline lies in the plane through o, its x
//! along r and its y along u; the viewer is on the side of r × u, EYE mm from the plane, or at
//! infinity if EYE is 0. It may cross itself: points enclosed by an odd number of turns are inside.

use crate::error::suggestion;
use glam::{Affine3A, Mat3, Vec2, Vec3};
use std::fmt;

/// Largest coordinate and eye distance, mm.
const LARGEST_MM: f32 = 1e5;
/// Largest radius, mm.
const LARGEST_RADIUS_MM: f32 = 1000.0;

const LASSO_CUT: &str = "lasso-cut";
const LASSO_RESTORE: &str = "lasso-restore";
const NAMES: [&str; 6] = ["push", "smooth", "cut", "restore", LASSO_CUT, LASSO_RESTORE];

/// The effect of a stroke along its line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StrokeTool {
    /// Drags the volume along.
    Push,
    /// Smooths the displacements.
    Smooth,
    /// Removes a tube.
    Cut,
    /// Restores a tube.
    Restore,
}

impl StrokeTool {
    /// All tools.
    pub const ALL: [Self; 4] = [Self::Push, Self::Smooth, Self::Cut, Self::Restore];

    /// The first word of its strokes.
    pub fn name(self) -> &'static str {
        match self {
            Self::Push => NAMES[0],
            Self::Smooth => NAMES[1],
            Self::Cut => NAMES[2],
            Self::Restore => NAMES[3],
        }
    }

    /// The smallest number of points it needs.
    fn min_points(self) -> usize {
        if self == Self::Push { 2 } else { 1 }
    }
}

/// One stroke.
#[derive(Clone, Debug, PartialEq)]
pub enum Stroke {
    /// Along a line.
    Line {
        /// Its tool.
        tool: StrokeTool,
        /// Distance from the line within which it acts, mm.
        radius_mm: f32,
        /// 0 to 1.
        strength: f32,
        /// The line's points, mm, world.
        points: Vec<Vec3>,
    },
    /// Everything behind and in front of an outline.
    Lasso(Lasso),
}

/// A closed outline, seen from one side.
#[derive(Clone, Debug, PartialEq)]
pub struct Lasso {
    /// Restores instead of removing.
    pub restores: bool,
    /// Distance of the viewer's eye from the outline's plane, mm; 0 for a parallel view.
    pub eye_mm: f32,
    /// The origin of the outline's coordinates in its plane, mm, world; with an eye, the foot of
    /// the perpendicular from it.
    pub origin: Vec3,
    /// Direction of the outline's x.
    pub right: Vec3,
    /// Direction of the outline's y.
    pub up: Vec3,
    /// Its points, mm.
    pub outline: Vec<Vec2>,
}

impl Lasso {
    /// The outline's axes: right, up, and towards the viewer. Directions that are not perpendicular
    /// are orthogonalised.
    pub fn world_from_outline(&self) -> Affine3A {
        let right = self.right.try_normalize().unwrap_or(Vec3::X);
        let towards = right
            .cross(self.up)
            .try_normalize()
            .unwrap_or_else(|| right.any_orthonormal_vector());
        Affine3A::from_mat3_translation(Mat3::from_cols(right, towards.cross(right), towards), self.origin)
    }
}

impl Stroke {
    /// The number of its points.
    pub fn points(&self) -> usize {
        match self {
            Self::Line { points, .. } => points.len(),
            Self::Lasso(lasso) => lasso.outline.len(),
        }
    }
}

impl fmt::Display for Stroke {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Line {
                tool,
                radius_mm,
                strength,
                points,
            } => {
                write!(f, "{} {radius_mm} {strength}", tool.name())?;
                points
                    .iter()
                    .try_for_each(|p| write!(f, " {} {} {}", p.x, p.y, p.z))
            }
            Self::Lasso(l) => {
                write!(
                    f,
                    "{} {}",
                    if l.restores { LASSO_RESTORE } else { LASSO_CUT },
                    l.eye_mm
                )?;
                [l.origin, l.right, l.up]
                    .iter()
                    .try_for_each(|v| write!(f, " {} {} {}", v.x, v.y, v.z))?;
                l.outline.iter().try_for_each(|p| write!(f, " {} {}", p.x, p.y))
            }
        }
    }
}

/// Parses one stroke.
///
/// # Errors
/// The problem and its remedy, worded to follow the stroke's number: an unknown tool (the message
/// names the closest one), a word that is not a number or is out of range, too few numbers.
pub fn parse(text: &str) -> Result<Stroke, String> {
    let mut words = text.split_whitespace();
    let name = words
        .next()
        .ok_or_else(|| format!("is empty; begin with one of {}", NAMES.join(", ")))?;
    if !NAMES.contains(&name) {
        return Err(format!("\"{name}\" is not a tool; {}", suggestion(name, NAMES)));
    }
    let numbers = words
        .map(|word| number(word, name))
        .collect::<Result<Vec<f32>, String>>()?;
    match StrokeTool::ALL.into_iter().find(|t| t.name() == name) {
        Some(tool) => line(tool, &numbers),
        None => lasso(name, &numbers),
    }
}

fn number(word: &str, name: &str) -> Result<f32, String> {
    let v: f32 = word
        .parse()
        .map_err(|_| format!("{name}: \"{word}\" is not a number; separate numbers with spaces"))?;
    // Also rejects NaN.
    if v.abs() <= LARGEST_MM {
        Ok(v)
    } else {
        Err(format!("{name}: {word} is outside -{LARGEST_MM} to {LARGEST_MM}"))
    }
}

fn line(tool: StrokeTool, numbers: &[f32]) -> Result<Stroke, String> {
    let name = tool.name();
    let [radius_mm, strength, coordinates @ ..] = numbers else {
        return Err(format!(
            "{name} has {} numbers; it needs a radius, a strength and the points' x y z",
            numbers.len()
        ));
    };
    if !(*radius_mm > 0.0 && *radius_mm <= LARGEST_RADIUS_MM) {
        return Err(format!(
            "{name}: the radius {radius_mm} is outside 0 to {LARGEST_RADIUS_MM} mm; it must be above 0"
        ));
    }
    if !(0.0..=1.0).contains(strength) {
        return Err(format!("{name}: the strength {strength} is outside 0 to 1"));
    }
    let (points, rest) = coordinates.as_chunks::<3>();
    if !rest.is_empty() {
        return Err(format!(
            "{name} has {} coordinates after radius and strength; each point needs three: x y z",
            coordinates.len()
        ));
    }
    if points.len() < tool.min_points() {
        return Err(format!(
            "{name} has {} points; it needs at least {}",
            points.len(),
            tool.min_points()
        ));
    }
    Ok(Stroke::Line {
        tool,
        radius_mm: *radius_mm,
        strength: *strength,
        points: points.iter().map(|p| Vec3::from_array(*p)).collect(),
    })
}

fn lasso(name: &str, numbers: &[f32]) -> Result<Stroke, String> {
    let [eye_mm, ox, oy, oz, rx, ry, rz, ux, uy, uz, coordinates @ ..] = numbers else {
        return Err(format!(
            "{name} has {} numbers; it needs the eye's distance, a point, two directions, and the outline's x y",
            numbers.len()
        ));
    };
    if *eye_mm < 0.0 {
        return Err(format!(
            "{name}: the eye distance {eye_mm} is negative; use 0 for an orthographic view"
        ));
    }
    let (origin, right, up) = (
        Vec3::new(*ox, *oy, *oz),
        Vec3::new(*rx, *ry, *rz),
        Vec3::new(*ux, *uy, *uz),
    );
    let (Some(x), Some(y)) = (right.try_normalize(), up.try_normalize()) else {
        return Err(format!(
            "{name}: a direction has zero length; give the outline's x and y axes as unit vectors"
        ));
    };
    if x.cross(y).length() < 1e-3 {
        return Err(format!(
            "{name}: the outline's two directions are parallel; they must be perpendicular"
        ));
    }
    let (points, rest) = coordinates.as_chunks::<2>();
    if !rest.is_empty() {
        return Err(format!(
            "{name} has {} outline coordinates; each point needs two: x y",
            coordinates.len()
        ));
    }
    if points.len() < 3 {
        return Err(format!(
            "{name}: an outline of {} points encloses nothing; it needs 3",
            points.len()
        ));
    }
    let outline = points.iter().map(|p| Vec2::from_array(*p)).collect();
    Ok(Stroke::Lasso(Lasso {
        restores: name == LASSO_RESTORE,
        eye_mm: *eye_mm,
        origin,
        right,
        up,
        outline,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_written_is_read(tool in 0usize..4, radius_mm in 1e-3f32..1e3, strength in 0.0f32..=1.0,
                                   points in prop::collection::vec(prop::array::uniform3(-1e5f32..1e5), 2..9)) {
            let stroke = Stroke::Line { tool: StrokeTool::ALL[tool], radius_mm, strength, points: points.into_iter().map(Vec3::from).collect() };
            prop_assert_eq!(parse(&stroke.to_string()), Ok(stroke));
        }

        #[test]
        fn outlines_as_well(restores: bool, eye_mm in 0.0f32..1e5, origin in prop::array::uniform3(-1e5f32..1e5),
                            outline in prop::collection::vec(prop::array::uniform2(-1e4f32..1e4), 3..9)) {
            let (right, up) = (Vec3::new(0.6, 0.0, 0.8), Vec3::NEG_Y);
            let outline = outline.into_iter().map(Vec2::from).collect();
            let stroke = Stroke::Lasso(Lasso { restores, eye_mm, origin: origin.into(), right, up, outline });
            prop_assert_eq!(parse(&stroke.to_string()), Ok(stroke));
        }

        /// Any text is either parsed or rejected.
        #[test]
        fn nothing_panics(text in "[a-z0-9 .eE+-]{0,60}", name in 0usize..6) {
            let _ = parse(&text);
            let _ = parse(&format!("{} {text}", NAMES[name]));
        }
    }

    #[test]
    fn blanks_do_not_matter() {
        let stroke = parse("  cut 5\t1   1 2 3\n").unwrap();
        assert_eq!(
            stroke,
            Stroke::Line {
                tool: StrokeTool::Cut,
                radius_mm: 5.0,
                strength: 1.0,
                points: vec![Vec3::new(1.0, 2.0, 3.0)]
            }
        );
        assert_eq!(stroke.to_string(), "cut 5 1 1 2 3");
    }

    #[test]
    fn refusals_say_what_to_do() {
        for (text, expected) in [
            ("", "is empty; begin with one of push"),
            ("psuh 5 1 0 0 0 1 1 1", "did you mean \"push\"?"),
            ("push", "needs a radius"),
            ("push 5 1 0 0 0 1 1", "each point needs three"),
            ("push 5 1 0 0 0", "needs at least 2"),
            ("cut 5 1", "needs at least 1"),
            ("cut 0 1 0 0 0", "must be above 0"),
            ("cut -3 1 0 0 0", "must be above 0"),
            ("cut 1e5 1 0 0 0", "outside 0 to 1000 mm"),
            ("smooth 5 1.5 0 0 0", "outside 0 to 1"),
            ("cut 5 1 0 nan 0", "nan is outside"),
            ("cut 5 1 0 inf 0", "inf is outside"),
            ("cut 5 1 0 1e9 0", "1e9 is outside"),
            ("cut 5 1 0,0,0", "separate numbers with spaces"),
            ("lasso-cut 0 0 0 0 1 0 0", "two directions"),
            ("lasso-cut -1 0 0 0 1 0 0 0 1 0 0 0 5 0 5 5", "is negative"),
            ("lasso-cut 0 0 0 0 0 0 0 0 1 0 0 0 5 0 5 5", "zero length"),
            ("lasso-cut 0 0 0 0 1 0 0 -2 0 0 0 0 5 0 5 5", "parallel"),
            (
                "lasso-restore 0 0 0 0 1 0 0 0 1 0 0 0 5 0 5",
                "each point needs two",
            ),
            ("lasso-restore 0 0 0 0 1 0 0 0 1 0 0 0 5 0", "needs 3"),
        ] {
            let problem = parse(text).unwrap_err();
            assert!(problem.contains(expected), "{text}: {problem}");
        }
    }

    #[test]
    fn axes_are_at_right_angles() {
        let Stroke::Lasso(lasso) = parse("lasso-cut 0 1 2 3 2 0 0 1 3 0 0 0 5 0 5 5").unwrap() else {
            panic!()
        };
        let axes = lasso.world_from_outline();
        assert!(
            axes.transform_vector3(Vec3::X).abs_diff_eq(Vec3::X, 1e-6)
                && axes.transform_vector3(Vec3::Y).abs_diff_eq(Vec3::Y, 1e-6)
        );
        assert!(
            axes.transform_point3(Vec3::Z)
                .abs_diff_eq(Vec3::new(1.0, 2.0, 4.0), 1e-6),
            "the viewer is on the side of r x u"
        );
    }
}
