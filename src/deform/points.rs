//! Scattered control points: displacements given at points and interpolated everywhere.
//!
//! Pairs are *forward*: `from` moves to `to`. Backward warping needs the displacement at `to`,
//! hence from - to is interpolated at the points `to`: the map then carries every `to` exactly to
//! its `from` (\[DS07\] section 4 after Ruprecht and Müller 1995).
//!
//! | method | |
//! |---|---|
//! | `tps` | thin-plate spline: in three dimensions the kernel r with an affine part (Bookstein 1989, Duchon 1977); needs 4 points that span space |
//! | `rbf` | Gaussian radial basis functions: local, no affine part |
//! | `idw` | inverse-distance weights, 1/r²: flat at the points, no system to solve |

use crate::{Error, Result};
use glam::{DMat3, DVec3};
use serde_json::Value;
use std::path::Path;

/// A pair of points, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointPair {
    /// Original position.
    pub from: DVec3,
    /// Deformed position.
    pub to: DVec3,
}

/// The interpolation method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Thin-plate spline.
    ThinPlate,
    /// Gaussian radial basis functions.
    Gaussian,
    /// Inverse-distance weights.
    InverseDistance,
}

/// An interpolated displacement, source minus deformed point.
pub struct Interpolant {
    points: Vec<DVec3>,
    /// Displacements (inverse distance) or kernel weights.
    weights: Vec<DVec3>,
    /// Affine part: linear, constant.
    affine: (DMat3, DVec3),
    method: Method,
    /// Width of the Gaussian, or the unit of length of the thin-plate spline, mm.
    scale: f64,
}

/// Points closer than this are identical, mm.
const MIN_POINT_DISTANCE_MM: f64 = 1e-3;
/// Maximum number of pairs: the systems are dense.
const MAX_PAIRS: usize = 4000;

impl Interpolant {
    /// Interpolates pairs. The second value describes a fallback, if one was needed.
    ///
    /// # Errors
    /// No pairs, or two that contradict each other at one point.
    pub fn new(pairs: &[PointPair], method: Method, width_mm: Option<f64>) -> Result<(Self, Option<String>)> {
        let scattered = ScatteredDisplacements::of(&distinct(pairs)?);
        let wanted = width_mm.unwrap_or(1.2 * scattered.spacing());
        match method {
            Method::InverseDistance => Ok((scattered.inverse_distance(), None)),
            Method::Gaussian => match scattered.gaussians(wanted) {
                Some(i) => Ok((i, None)),
                None => Ok((
                    scattered.inverse_distance(),
                    Some("the Gaussians are too wide for points this close together; inverse distance weighting is used instead".into()),
                )),
            },
            Method::ThinPlate => {
                if let Some(i) = scattered.thin_plate() {
                    return Ok((i, None));
                }
                let n = scattered.points.len();
                let why = match n {
                    1 => "1 point is too few".into(),
                    2 | 3 => format!("{n} points are too few"),
                    _ => "the points are too close to coplanar".into(),
                };
                let notice = format!("{why} for a thin-plate spline; Gaussians {wanted:.0} mm wide are used");
                match scattered.gaussians(wanted) {
                    Some(i) => Ok((i, Some(notice))),
                    None => {
                        Ok((scattered.inverse_distance(), Some(format!("{why} for a thin-plate spline; inverse distance weighting is used instead"))))
                    }
                }
            }
        }
    }

    /// Source minus deformed point.
    pub fn displacement(&self, p: DVec3) -> DVec3 {
        let mut sum = DVec3::ZERO;
        match self.method {
            Method::InverseDistance => {
                let mut total = 0.0;
                for (c, v) in self.points.iter().zip(&self.weights) {
                    let d = p.distance_squared(*c);
                    if d < 1e-12 {
                        return *v;
                    }
                    total += 1.0 / d;
                    sum += *v / d;
                }
                sum / total
            }
            Method::Gaussian => {
                for (c, w) in self.points.iter().zip(&self.weights) {
                    sum += *w * (-(p.distance_squared(*c) / (self.scale * self.scale))).exp();
                }
                sum
            }
            Method::ThinPlate => {
                for (c, w) in self.points.iter().zip(&self.weights) {
                    sum += *w * (p.distance(*c) / self.scale);
                }
                sum + self.affine.0 * p + self.affine.1
            }
        }
    }
}

/// The pairs without duplicates.
///
/// # Errors
/// No pairs, too many, one that is not finite, or two with the same target but different sources.
fn distinct(pairs: &[PointPair]) -> Result<Vec<PointPair>> {
    let mut distinct: Vec<PointPair> = Vec::with_capacity(pairs.len());
    for (n, p) in pairs.iter().enumerate() {
        if !(p.from.is_finite() && p.to.is_finite()) {
            return Err(Error::value("pairs", format!("pair {} is not finite", n + 1)));
        }
        match distinct
            .iter()
            .find(|k| k.to.distance(p.to) < MIN_POINT_DISTANCE_MM)
        {
            Some(k) if k.from.distance(p.from) < MIN_POINT_DISTANCE_MM => {}
            Some(k) => {
                return Err(Error::value(
                    "pairs",
                    format!(
                        "pair {} has the same target {} as another pair, but their sources {} and {} differ; remove one",
                        n + 1,
                        p.to,
                        k.from,
                        p.from
                    ),
                ));
            }
            None if distinct.len() == MAX_PAIRS => {
                return Err(Error::value(
                    "pairs",
                    format!("are more than {MAX_PAIRS}, the most that can be interpolated"),
                ));
            }
            None => distinct.push(*p),
        }
    }
    if distinct.is_empty() {
        return Err(Error::value(
            "pairs",
            "are missing; give at least one pair of points",
        ));
    }
    Ok(distinct)
}

/// Displacements given at points, to be interpolated.
struct ScatteredDisplacements {
    points: Vec<DVec3>,
    values: Vec<DVec3>,
}

impl ScatteredDisplacements {
    /// The displacement of each pair, from its target to its source, given at its target.
    fn of(pairs: &[PointPair]) -> Self {
        Self {
            points: pairs.iter().map(|p| p.to).collect(),
            values: pairs.iter().map(|p| p.from - p.to).collect(),
        }
    }

    /// Typical distance between neighbouring points, at least 1 mm.
    fn spacing(&self) -> f64 {
        let points = &self.points;
        let extent = points.iter().copied().reduce(DVec3::max).unwrap_or_default()
            - points.iter().copied().reduce(DVec3::min).unwrap_or_default();
        (extent.length() / (points.len() as f64).cbrt()).max(1.0)
    }

    /// An interpolant without an affine part.
    fn without_affine(&self, method: Method, scale: f64, weights: Vec<DVec3>) -> Interpolant {
        Interpolant {
            points: self.points.clone(),
            weights,
            affine: (DMat3::ZERO, DVec3::ZERO),
            method,
            scale,
        }
    }

    /// Interpolates with inverse-distance weights.
    fn inverse_distance(&self) -> Interpolant {
        self.without_affine(Method::InverseDistance, 1.0, self.values.clone())
    }

    /// Interpolates with Gaussians of width `scale`, mm; none if their linear system is singular.
    fn gaussians(&self, scale: f64) -> Option<Interpolant> {
        let points = &self.points;
        let n = points.len();
        let mut system = vec![vec![0.0; n]; n];
        for (i, row) in system.iter_mut().enumerate() {
            for (j, v) in row.iter_mut().enumerate() {
                *v = (-(points[i].distance_squared(points[j]) / (scale * scale))).exp();
            }
        }
        solve(system, self.values.clone())
            .map(|weights| self.without_affine(Method::Gaussian, scale, weights))
    }

    /// Interpolates with a thin-plate spline; none if the points lie in one plane.
    fn thin_plate(&self) -> Option<Interpolant> {
        let points = &self.points;
        let n = points.len();
        if n < 4 {
            return None;
        }
        let center = points.iter().sum::<DVec3>() / n as f64;
        let scale = points
            .iter()
            .map(|p| p.distance(center))
            .fold(0.0, f64::max)
            .max(1.0);
        let at = |p: DVec3| (p - center) / scale;
        let mut system = vec![vec![0.0; n + 4]; n + 4];
        for i in 0..n {
            for j in 0..n {
                system[i][j] = at(points[i]).distance(at(points[j]));
            }
            for (c, v) in [1.0, at(points[i]).x, at(points[i]).y, at(points[i]).z]
                .into_iter()
                .enumerate()
            {
                system[i][n + c] = v;
                system[n + c][i] = v;
            }
        }
        let mut right = self.values.clone();
        right.resize(n + 4, DVec3::ZERO);
        let w = solve(system, right)?;
        // Σ in normalised coordinates; the affine part in world coordinates.
        let linear = DMat3::from_cols(w[n + 1], w[n + 2], w[n + 3]) * (1.0 / scale);
        let affine = (linear, w[n] - linear * center);
        Some(Interpolant {
            points: points.clone(),
            weights: w[..n].to_vec(),
            affine,
            method: Method::ThinPlate,
            scale,
        })
    }
}

/// Gaussian elimination with partial pivoting for three right sides; none if the system is singular
/// to working precision.
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<DVec3>) -> Option<Vec<DVec3>> {
    let n = b.len();
    for c in 0..n {
        let pivot = (c..n).max_by(|&i, &j| a[i][c].abs().total_cmp(&a[j][c].abs()))?;
        if a[pivot][c].abs() < 1e-10 {
            return None;
        }
        a.swap(c, pivot);
        b.swap(c, pivot);
        let (top, below) = a.split_at_mut(c + 1);
        let lead = &top[c];
        for (r, row) in below.iter_mut().enumerate() {
            let f = row[c] / lead[c];
            if f != 0.0 {
                row[c..].iter_mut().zip(&lead[c..]).for_each(|(v, l)| *v -= f * l);
                let top = b[c];
                b[c + 1 + r] -= top * f;
            }
        }
    }
    for c in (0..n).rev() {
        let mut v = b[c];
        for k in c + 1..n {
            v -= b[k] * a[c][k];
        }
        b[c] = v / a[c][c];
    }
    Some(b)
}

/// Pairs from a table of six numbers per line (from x, y, z, to x, y, z; mm, LPS), separated by
/// commas, semicolons, tabs or spaces; a header line is skipped.
///
/// # Errors
/// A file that cannot be read, or a line without six numbers.
pub fn read_pairs(path: &Path) -> Result<Vec<PointPair>> {
    let rows = table(path)?;
    rows.into_iter()
        .map(|(line, v)| match v[..] {
            [a, b, c, d, e, f] => Ok(PointPair {
                from: DVec3::new(a, b, c),
                to: DVec3::new(d, e, f),
            }),
            _ => Err(Error::file(
                path,
                format!(
                    "line {line} has {} numbers; a pair needs six: source x,y,z and target x,y,z",
                    v.len()
                ),
            )),
        })
        .collect()
}

fn text_of(path: &Path) -> Result<String> {
    crate::files::input::text(path, 64 << 20, "list of points (.csv, .mrk.json or .fcsv)")
}

/// Lines of numbers with their line numbers.
fn table(path: &Path) -> Result<Vec<(usize, Vec<f64>)>> {
    let text = text_of(path)?;
    let mut rows = Vec::new();
    for (n, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let words: Vec<&str> = line
            .split([',', ';', '\t', ' '])
            .filter(|w| !w.trim().is_empty())
            .collect();
        let numbers: Vec<f64> = words.iter().map_while(|w| w.trim().parse().ok()).collect();
        if numbers.len() != words.len() {
            if rows.is_empty() && numbers.is_empty() {
                // The names of the columns.
                continue;
            }
            return Err(Error::file(
                path,
                format!(
                    "line {} contains \"{}\", which is not a number",
                    n + 1,
                    words[numbers.len()]
                ),
            ));
        }
        rows.push((n + 1, numbers));
    }
    Ok(rows)
}

/// A list of points, LPS mm: 3D Slicer's `.mrk.json` and `.fcsv`, or a table of three numbers per
/// line.
///
/// # Errors
/// A file that cannot be read or has another format.
pub fn read_points(path: &Path) -> Result<Vec<DVec3>> {
    let name = path
        .file_name()
        .map(|n| n.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default();
    if name.ends_with(".json") {
        return read_markups(path);
    }
    if name.ends_with(".fcsv") {
        let text = text_of(path)?;
        let system = text
            .lines()
            .find_map(|l| l.strip_prefix("# CoordinateSystem ="))
            .map_or("RAS", str::trim);
        let flip = match system {
            "0" | "RAS" => DVec3::new(-1.0, -1.0, 1.0),
            "1" | "LPS" => DVec3::ONE,
            other => {
                return Err(Error::file(
                    path,
                    format!("states its points in \"{other}\"; RAS and LPS can be read"),
                ));
            }
        };
        return text
            .lines()
            .enumerate()
            .filter(|(_, l)| !l.trim().is_empty() && !l.starts_with('#'))
            .map(|(n, l)| {
                let v: Vec<f64> = l
                    .split(',')
                    .skip(1)
                    .take(3)
                    .map_while(|w| w.trim().parse().ok())
                    .collect();
                match v[..] {
                    [x, y, z] => Ok(DVec3::new(x, y, z) * flip),
                    _ => Err(Error::file(
                        path,
                        format!("line {} has no three coordinates after its label", n + 1),
                    )),
                }
            })
            .collect();
    }
    table(path)?
        .into_iter()
        .map(|(line, v)| match v[..] {
            [x, y, z] => Ok(DVec3::new(x, y, z)),
            _ => Err(Error::file(
                path,
                format!("line {line} has {} numbers; a point has three", v.len()),
            )),
        })
        .collect()
}

fn read_markups(path: &Path) -> Result<Vec<DVec3>> {
    let value: Value = serde_json::from_str(&text_of(path)?)
        .map_err(|e| Error::file(path, format!("is not valid JSON: {e}")))?;
    let markup = value
        .pointer("/markups/0")
        .ok_or_else(|| Error::file(path, "contains no markups; it is not a 3D Slicer point list"))?;
    let flip = match markup
        .get("coordinateSystem")
        .and_then(Value::as_str)
        .unwrap_or("LPS")
    {
        "LPS" => DVec3::ONE,
        "RAS" => DVec3::new(-1.0, -1.0, 1.0),
        other => {
            return Err(Error::file(
                path,
                format!("states its points in \"{other}\"; RAS and LPS can be read"),
            ));
        }
    };
    let points = markup
        .get("controlPoints")
        .and_then(Value::as_array)
        .ok_or_else(|| Error::file(path, "holds a markup without control points"))?;
    points
        .iter()
        .enumerate()
        .map(|(n, p)| {
            let v: Vec<f64> = p
                .get("position")
                .and_then(Value::as_array)
                .map_or(Vec::new(), |a| a.iter().filter_map(Value::as_f64).collect());
            match v[..] {
                [x, y, z] => Ok(DVec3::new(x, y, z) * flip),
                _ => Err(Error::file(
                    path,
                    format!("control point {} has no position of three numbers", n + 1),
                )),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs() -> Vec<PointPair> {
        [
            [0.0, 0.0, 0.0],
            [50.0, 0.0, 5.0],
            [0.0, 40.0, -8.0],
            [10.0, 20.0, 60.0],
            [-30.0, 5.0, 20.0],
            [25.0, 25.0, 25.0],
        ]
        .into_iter()
        .enumerate()
        .map(|(n, p)| {
            let to = DVec3::from(p);
            PointPair {
                from: to + DVec3::new((n as f64).sin() * 6.0, n as f64 - 2.0, 3.0),
                to,
            }
        })
        .collect()
    }

    #[test]
    fn every_method_meets_its_points() {
        for method in [Method::ThinPlate, Method::Gaussian, Method::InverseDistance] {
            let (i, notice) = Interpolant::new(&pairs(), method, None).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(notice, None);
            for p in pairs() {
                assert!(
                    (p.to + i.displacement(p.to)).distance(p.from) < 1e-6,
                    "{method:?}"
                );
            }
        }
    }

    #[test]
    fn a_thin_plate_spline_reproduces_affine_maps() {
        let m = DMat3::from_cols(
            DVec3::new(1.1, 0.1, 0.0),
            DVec3::new(-0.2, 0.9, 0.05),
            DVec3::new(0.0, 0.3, 1.2),
        );
        let affine: Vec<PointPair> = pairs()
            .into_iter()
            .map(|p| PointPair {
                from: m * p.to + DVec3::new(3.0, -4.0, 5.0),
                to: p.to,
            })
            .collect();
        let (i, _) = Interpolant::new(&affine, Method::ThinPlate, None).unwrap_or_else(|e| panic!("{e}"));
        let p = DVec3::new(70.0, -20.0, 33.0);
        assert!((p + i.displacement(p)).distance(m * p + DVec3::new(3.0, -4.0, 5.0)) < 1e-6);
    }

    #[test]
    fn too_few_flat_and_coinciding_points() {
        let few = &pairs()[..3];
        let (i, notice) = Interpolant::new(few, Method::ThinPlate, None).unwrap_or_else(|e| panic!("{e}"));
        assert!(notice.is_some_and(|n| n.contains("3 points are too few")));
        assert!((few[1].to + i.displacement(few[1].to)).distance(few[1].from) < 1e-6);
        let flat: Vec<PointPair> = pairs()
            .into_iter()
            .map(|p| PointPair {
                to: p.to * DVec3::new(1.0, 1.0, 0.0),
                ..p
            })
            .collect();
        assert!(
            Interpolant::new(&flat, Method::ThinPlate, None)
                .is_ok_and(|(_, n)| n.is_some_and(|n| n.contains("coplanar")))
        );
        let mut twice = pairs();
        twice.push(PointPair {
            from: DVec3::ONE * 9.0,
            to: twice[0].to,
        });
        assert!(
            Interpolant::new(&twice, Method::Gaussian, None).is_err_and(|e| e.to_string().contains("pair 7"))
        );
        twice[6] = twice[0];
        assert!(Interpolant::new(&twice, Method::ThinPlate, None).is_ok());
        assert!(Interpolant::new(&[], Method::ThinPlate, None).is_err());
    }

    #[test]
    fn files_of_points() {
        let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap_or_else(|e| panic!("{e}"));
            path
        };
        let csv = write(
            "a.csv",
            "from_x,from_y,from_z,to_x,to_y,to_z\n1,2,3,4,5,6\n# note\n7;8;9;10;11;12\n",
        );
        let read = read_pairs(&csv).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(
            read[1],
            PointPair {
                from: DVec3::new(7.0, 8.0, 9.0),
                to: DVec3::new(10.0, 11.0, 12.0)
            }
        );
        assert!(read_pairs(&write("b.csv", "1,2,3\n")).is_err_and(|e| e.to_string().contains("line 1")));
        assert!(
            read_pairs(&write("c.csv", "1,2,3,4,5,6\n1,2,x,4,5,6"))
                .is_err_and(|e| e.to_string().contains("\"x\""))
        );
        let json = r#"{"markups":[{"type":"Fiducial","coordinateSystem":"RAS","controlPoints":[{"position":[1.0,2.0,3.0]}]}]}"#;
        assert_eq!(
            read_points(&write("a.mrk.json", json)).ok(),
            Some(vec![DVec3::new(-1.0, -2.0, 3.0)])
        );
        let fcsv = "# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n# columns = id,x,y,z\nF-1,1.5,2,3,0,0,0,1,1,1,0,F-1,,\n";
        assert_eq!(
            read_points(&write("a.fcsv", fcsv)).ok(),
            Some(vec![DVec3::new(1.5, 2.0, 3.0)])
        );
        assert!(read_points(&write("b.mrk.json", "{}")).is_err());
    }
}
