//! Limits on the numbers of a scene, checked in one place before the scene is used: every number
//! must be finite and small enough for single-precision arithmetic. Further constraints (a progress
//! is 0 to 1, an angle of a kind has its range) are checked where the number is used, by name.

use super::Scene;
use crate::{Error, Result};
use toml::Value;

/// Largest length or coordinate, mm: ten kilometres. Its fourth power, which occurs in
/// control-point weights, is still far from overflow.
const MAX_LENGTH_MM: f64 = 1e7;
/// Largest angle, degrees: a thousand turns.
const MAX_ANGLE_DEG: f64 = 3.6e5;
/// Largest data value.
const MAX_VALUE: f64 = 1e30;
/// Most entries of a list of the scene.
const MAX_ENTRIES: usize = 100_000;
/// Longest text, bytes.
const MAX_TEXT: usize = 1 << 24;

/// Keys whose numbers are data values.
const DATA_VALUES: [&str; 6] = ["value", "iso", "window", "level", "magnitude", "density"];
/// Keys whose numbers are degrees.
const ANGLES: [&str; 5] = ["rotate", "angle", "phase", "roll", "field_of_view"];

impl Scene {
    /// Checks that every number, list and text of the scene is within the limits.
    ///
    /// # Errors
    /// The first one that is not, by its key.
    pub fn check_limits(&self) -> Result<()> {
        let table = toml::Table::try_from(self).map_err(|e| Error::value("scene", e.to_string()))?;
        for value in [self.camera.view.azimuth_deg, self.camera.view.elevation_deg] {
            number("camera.view", "angle", f64::from(value))?;
        }
        walk("", "", &Value::Table(table))
    }
}

/// `name` is the key of the value, `path` the full key path to it.
fn walk(path: &str, name: &str, value: &Value) -> Result<()> {
    match value {
        Value::Table(table) => table.iter().try_for_each(|(key, value)| {
            let path = if path.is_empty() {
                key.clone()
            } else {
                format!("{path}.{key}")
            };
            walk(&path, key, value)
        }),
        Value::Array(items) => {
            if items.len() > MAX_ENTRIES {
                return Err(Error::value(
                    path,
                    format!("has {} entries; at most {MAX_ENTRIES} can be used", items.len()),
                ));
            }
            let tables = items.first().is_some_and(Value::is_table);
            items.iter().enumerate().try_for_each(|(n, item)| {
                // List entries are counted from 1 in messages.
                let path = if tables {
                    format!("{path} {}", n + 1)
                } else {
                    path.to_owned()
                };
                walk(&path, name, item)
            })
        }
        Value::Float(v) => number(path, name, *v),
        Value::Integer(v) => number(path, name, *v as f64),
        Value::String(text) if text.len() > MAX_TEXT => Err(Error::value(
            path,
            format!(
                "is a string of {} bytes; at most {MAX_TEXT} are allowed",
                text.len()
            ),
        )),
        Value::String(text) if text.contains('\0') => Err(Error::value(
            path,
            "contains a NUL character, which is not allowed; remove it",
        )),
        _ => Ok(()),
    }
}

fn number(path: &str, name: &str, value: f64) -> Result<()> {
    let (most, unit) = match name {
        n if DATA_VALUES.contains(&n) => (MAX_VALUE, ""),
        n if ANGLES.contains(&n) => (MAX_ANGLE_DEG, " degrees"),
        "label" => (f64::from(u32::MAX), ""),
        _ => (MAX_LENGTH_MM, ""),
    };
    if !value.is_finite() {
        return Err(Error::value(path, format!("{value} is not a finite number")));
    }
    if value.abs() > most {
        return Err(Error::value(
            path,
            format!("{value:?} is out of range; use a value from -{most} to {most}{unit}"),
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::Deformation;
    use super::*;

    fn problem(change: impl FnOnce(&mut Scene)) -> String {
        let mut scene = Scene::of_volume("phantom:ball");
        scene.deformation = vec![Deformation::new("twist"), Deformation::new("surface-peel")];
        change(&mut scene);
        scene
            .check_limits()
            .err()
            .map(|e| e.to_string())
            .unwrap_or_default()
    }

    #[test]
    fn numbers_beyond_use_are_named() {
        assert_eq!(problem(|_| ()), "");
        assert!(
            problem(|s| s.deformation[1].center = Some([0.0, 1e30, 0.0]))
                .starts_with("deformation 2.center: 1")
        );
        assert!(
            problem(|s| s.deformation[0].rotate = Some([f32::NAN; 3]))
                .starts_with("deformation 1.rotate: NaN")
        );
        assert!(
            problem(|s| s.deformation[0].parameters.insert("angle", 1e9)).starts_with("deformation 1.angle")
        );
        assert!(problem(|s| s.camera.view.azimuth_deg = 1e30).starts_with("camera.view"));
        assert!(problem(|s| s.camera.target = Some([f32::INFINITY; 3])).starts_with("camera.target: inf"));
        assert!(
            problem(|s| s.render.iso = Some(1e20)).is_empty()
                && problem(|s| s.render.iso = Some(1e31)).starts_with("render.iso")
        );
        assert!(problem(|s| s.deformation[0].parameters.insert("path", "a\0b")).contains("NUL"));
    }
}
