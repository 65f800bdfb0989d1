//! Parameter files of elastix (`TransformParameters.0.txt`): lines of `(Name value ...)`. A
//! transform maps a point of the fixed image to the moving image, in LPS; its numbers are those of
//! ITK's classes. `InitialTransformParametersFileName` names the transform that is applied before
//! it. Source: elastix manual, and `WriteToFile` of its transforms.

use super::Transform;
use super::itk::{ItkTransform, step};
use crate::files::input;
use crate::files::reference::sibling_file;
use crate::{Error, Result};
use std::collections::HashMap;
use std::path::Path;

/// Maximum number of files in a chain.
const MAX_FILES: usize = 16;
/// Largest parameter file, bytes.
const MAX_BYTES: u64 = 1 << 30;

/// Whether a text is such a file.
pub(super) fn is_elastix(text: &str) -> bool {
    text.lines().any(|l| {
        l.trim_start().starts_with("(Transform ") || l.trim_start().starts_with("(TransformParameters ")
    })
}

/// Reads a file and those that it names.
pub(super) fn read(path: &Path, text: &str) -> Result<Transform> {
    let mut steps = Vec::new();
    let (mut path, mut text) = (path.to_owned(), text.to_owned());
    for _ in 0..MAX_FILES {
        let fields = Fields::of(&text);
        steps.push(step(&path, &fields.entry(&path)?)?);
        let Some(before) = fields.initial() else {
            steps.reverse();
            return Ok(Transform {
                steps,
                warnings: Vec::new(),
            });
        };
        if fields
            .word("HowToCombineTransforms")
            .is_some_and(|how| how == "Add")
        {
            return Err(Error::file(
                &path,
                "adds its transform to the initial one; only composed transforms can be read (HowToCombineTransforms \"Compose\")",
            ));
        }
        // Files are often moved: their folders at the time of writing do not matter.
        let name = before.rsplit(['/', '\\']).next().unwrap_or(&before);
        let next = sibling_file(&path, name)?;
        text = input::text(&next, MAX_BYTES, "transform")?;
        path = next;
    }
    Err(Error::file(
        &path,
        format!(
            "continues a chain of more than {MAX_FILES} transforms; check whether the files name each other in a loop"
        ),
    ))
}

/// The values by their names.
struct Fields(HashMap<String, Vec<String>>);

impl Fields {
    fn of(text: &str) -> Self {
        let lines = text
            .lines()
            .filter_map(|l| l.trim().strip_prefix('(')?.split(')').next());
        let field = |line: &str| {
            let (name, values) = line.split_once(char::is_whitespace)?;
            let values = if values.contains('"') {
                values.split('"').skip(1).step_by(2).map(str::to_owned).collect()
            } else {
                values.split_whitespace().map(str::to_owned).collect()
            };
            Some((name.to_owned(), values))
        };
        Self(lines.filter_map(field).collect())
    }

    /// The first value.
    fn word(&self, name: &str) -> Option<&str> {
        self.0.get(name)?.first().map(String::as_str)
    }

    /// The file of the transform before this one.
    fn initial(&self) -> Option<String> {
        let names = [
            "InitialTransformParameterFileName",
            "InitialTransformParametersFileName",
        ];
        let name = names.iter().find_map(|n| self.word(n))?;
        (name != "NoInitialTransform").then(|| name.to_owned())
    }

    /// The numbers of a field; empty without it.
    fn numbers(&self, path: &Path, name: &str) -> Result<Vec<f64>> {
        let words = self.0.get(name).map_or(&[][..], Vec::as_slice);
        let numbers: Option<Vec<f64>> = words
            .iter()
            .map(|w| w.parse::<f64>().ok().filter(|v| v.is_finite()))
            .collect();
        numbers.ok_or_else(|| Error::file(path, format!("has {name} with values that are not numbers")))
    }

    /// The transform as ITK describes it.
    fn entry(&self, path: &Path) -> Result<ItkTransform> {
        let fail = |problem: String| Error::file(path, problem);
        let dimension = self.word("FixedImageDimension").unwrap_or("3");
        if dimension != "3" {
            return Err(fail(format!(
                "holds a transform of {dimension} dimensions; three are needed"
            )));
        }
        let name = self
            .word("Transform")
            .ok_or_else(|| fail("names no transform; it is damaged".into()))?;
        let mut fixed = self.numbers(path, "CenterOfRotationPoint")?;
        let kind = match name {
            "EulerTransform" => {
                let zyx = self.word("ComputeZYX").is_some_and(|w| w == "true");
                fixed.push(f64::from(u8::from(zyx)));
                "Euler3DTransform"
            }
            "AffineTransform" => "AffineTransform",
            "SimilarityTransform" => "Similarity3DTransform",
            "TranslationTransform" => "TranslationTransform",
            "BSplineTransform" | "RecursiveBSplineTransform" => {
                fixed = self.grid(path)?;
                "BSplineTransform"
            }
            other => {
                return Err(fail(format!(
                    "holds an elastix {other}, which cannot be read; write its deformation field with transformix -def all"
                )));
            }
        };
        let order = self.word("BSplineTransformSplineOrder").unwrap_or("3");
        Ok(ItkTransform {
            kind: format!("{kind}_double_3_3_{order}"),
            parameters: self.numbers(path, "TransformParameters")?,
            fixed,
        })
    }

    /// Size, origin, spacing and direction of the grid of B-splines. elastix writes the direction
    /// by columns.
    fn grid(&self, path: &Path) -> Result<Vec<f64>> {
        let get = |name: &str, n: usize, otherwise: &[f64]| {
            let numbers = self.numbers(path, name)?;
            match numbers.len() {
                0 if !otherwise.is_empty() => Ok(otherwise.to_vec()),
                m if m == n => Ok(numbers),
                m => Err(Error::file(
                    path,
                    format!("has {name} with {m} numbers instead of {n}"),
                )),
            }
        };
        let (size, spacing) = (get("GridSize", 3, &[])?, get("GridSpacing", 3, &[])?);
        let (mut origin, index) = (get("GridOrigin", 3, &[])?, get("GridIndex", 3, &[0.0; 3])?);
        let d = get("GridDirection", 9, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])?;
        let rows = [d[0], d[3], d[6], d[1], d[4], d[7], d[2], d[5], d[8]];
        for (row, first) in origin.iter_mut().enumerate() {
            *first += (0..3)
                .map(|axis| rows[3 * row + axis] * spacing[axis] * index[axis])
                .sum::<f64>();
        }
        Ok([&size[..], &origin, &spacing, &rows].concat())
    }
}
