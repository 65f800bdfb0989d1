//! Names, units, scale and translation of the axes of a Zarr array.
//!
//! Source: OME-NGFF 0.4 and 0.5, "axes" and "coordinateTransformations"; `_ARRAY_DIMENSIONS` of
//! xarray; `dimension_names` of Zarr 3. In OME-NGFF 0.1 and 0.2 axes are always t, c, z, y, x.

use super::super::tiff::mm_of;
use glam::DVec3;
use serde_json::Value;

/// An axis.
struct ZarrAxis {
    name: String,
    /// Unit as stated.
    unit: Option<String>,
    mm: f64,
}

impl ZarrAxis {
    fn named(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            unit: None,
            mm: 1.0,
        }
    }
}

/// The positions of the axes of an array.
pub(super) struct AxisPositions {
    all: Vec<ZarrAxis>,
    x: usize,
    y: usize,
    pub z: Option<usize>,
    pub channel: Option<usize>,
    pub time: Option<usize>,
}

impl AxisPositions {
    /// Finds the axes of an array of this rank by their names in the metadata of the image, else of
    /// the array, else by their order.
    pub fn of(
        multiscale: &Value,
        dimension_names: Option<Vec<String>>,
        rank: usize,
        warnings: &mut Vec<String>,
    ) -> Result<Self, String> {
        let stated = stated_axes(multiscale, rank)?;
        let is_stated = stated.is_some();
        let all = stated.or_else(|| {
            let names = dimension_names.filter(|names| names.len() == rank)?;
            let all: Vec<ZarrAxis> = names.iter().map(|n| ZarrAxis::named(usual_name(n))).collect();
            let has = |name: &str| all.iter().filter(|a| a.name == name).count() == 1;
            (has("x") && has("y")).then_some(all)
        });
        let all = all.unwrap_or_else(|| {
            let names = &["t", "c", "z", "y", "x"][5 - rank.min(5)..];
            if !multiscale.is_null() && rank < 5 {
                warnings.push(format!(
                    "does not name its axes; they are read as {}",
                    names.join(", ")
                ));
            }
            names.iter().map(|n| ZarrAxis::named(n)).collect()
        });
        let find = |name: &str| all.iter().position(|a| a.name == name);
        let (Some(x), Some(y)) = (find("x"), find("y")) else {
            return Err("has no axes x and y; a volume is needed".into());
        };
        let positions = Self {
            x,
            y,
            z: find("z"),
            channel: find("c"),
            time: find("t"),
            all,
        };
        if is_stated {
            warnings.extend(positions.unit_notice());
        }
        Ok(positions)
    }

    /// What is assumed about units that are not stated.
    fn unit_notice(&self) -> Option<String> {
        let units = self.space().into_iter().flatten().map(|a| &self.all[a].unit);
        let missing = units.clone().any(Option::is_none);
        let unknown = units.flatten().find(|u| mm_of(u).is_none());
        match (unknown, missing) {
            (Some(unit), _) => Some(format!(
                "states its spacing in \"{unit}\", which is not a length; mm is assumed"
            )),
            (None, true) => Some("states its spacing without a unit; mm is assumed".into()),
            (None, false) => None,
        }
    }

    /// Axes x, y, z.
    pub fn space(&self) -> [Option<usize>; 3] {
        [Some(self.x), Some(self.y), self.z]
    }

    /// The axes of space in the order in which they are stored, slowest first, each with its place
    /// among z (0), y (1) and x (2).
    pub fn stored_order(&self) -> Vec<(usize, usize)> {
        let mut axes: Vec<(usize, usize)> = self
            .space()
            .into_iter()
            .enumerate()
            .filter_map(|(n, axis)| Some((axis?, 2 - n)))
            .collect();
        axes.sort_unstable();
        axes
    }

    /// Names of the axes that are neither space, channel nor time.
    pub fn other_axes(&self) -> impl Iterator<Item = (usize, &str)> {
        let used = [Some(self.x), Some(self.y), self.z, self.channel, self.time];
        self.all
            .iter()
            .enumerate()
            .filter(move |(n, _)| !used.contains(&Some(*n)))
            .map(|(n, axis)| (n, axis.name.as_str()))
    }

    /// From values for every axis, those along x, y, z in mm; `missing` for an axis that does not
    /// exist.
    pub fn in_mm(&self, values: &[f64], missing: f64) -> DVec3 {
        DVec3::from_array(
            self.space()
                .map(|axis| axis.map_or(missing, |a| values[a] * self.all[a].mm)),
        )
    }
}

/// One letter for a name that programs use.
fn usual_name(name: &str) -> &str {
    match name.to_ascii_lowercase().as_str() {
        "x" | "width" | "col" | "column" | "columns" | "lon" | "longitude" => "x",
        "y" | "height" | "row" | "rows" | "lat" | "latitude" => "y",
        "z" | "depth" | "plane" | "slice" => "z",
        "c" | "channel" | "channels" | "band" | "bands" => "c",
        "t" | "time" | "frame" => "t",
        _ => name,
    }
}

/// The axes that the metadata of an image state.
fn stated_axes(multiscale: &Value, rank: usize) -> Result<Option<Vec<ZarrAxis>>, String> {
    let Some(stated) = multiscale["axes"].as_array() else {
        return Ok(None);
    };
    if stated.len() != rank {
        return Err(format!(
            "names {} axes of an array of {rank}; its metadata are damaged",
            stated.len()
        ));
    }
    let axis = |a: &Value| {
        let name = a.as_str().or(a["name"].as_str()).unwrap_or("");
        let unit = a["unit"].as_str().map(str::to_owned);
        ZarrAxis {
            name: name.to_ascii_lowercase(),
            mm: unit.as_deref().and_then(mm_of).unwrap_or(1.0),
            unit,
        }
    };
    let mut axes: Vec<ZarrAxis> = stated.iter().map(axis).collect();
    if !["x", "y"].iter().all(|name| axes.iter().any(|a| a.name == *name)) {
        name_by_type(&mut axes, stated);
    }
    Ok(Some(axes))
}

/// Names axes by their type, since their names are free: the last axes of space are z, y, x.
fn name_by_type(axes: &mut [ZarrAxis], stated: &[Value]) {
    let mut space = ["x", "y", "z"].iter();
    for (axis, stated) in axes.iter_mut().zip(stated).rev() {
        let name = match stated["type"].as_str() {
            Some("space") => space.next().copied(),
            Some("time") => Some("t"),
            Some("channel") => Some("c"),
            _ => None,
        };
        if let Some(name) = name {
            name.clone_into(&mut axis.name);
        }
    }
}

/// Scale and translation per axis: those of the resolution, then those of the whole image.
#[allow(clippy::type_complexity, reason = "two optional lists")]
pub(super) fn placement(
    multiscale: &Value,
    dataset: &Value,
    rank: usize,
) -> Result<(Option<Vec<f64>>, Option<Vec<f64>>), String> {
    let (mut scale, mut translation): (Option<Vec<f64>>, Option<Vec<f64>>) = (None, None);
    for list in [
        &dataset["coordinateTransformations"],
        &multiscale["coordinateTransformations"],
    ] {
        for step in list.as_array().map_or(&[][..], Vec::as_slice) {
            let kind = step["type"].as_str().unwrap_or("");
            let values: Option<Vec<f64>> = step[kind]
                .as_array()
                .map(|a| a.iter().map(|v| v.as_f64().unwrap_or(f64::NAN)).collect());
            let Some(values) = values.filter(|v| v.len() == rank) else {
                if kind == "identity" {
                    continue;
                }
                return Err(format!(
                    "has a transformation \"{kind}\" that is not a list of {rank} numbers and cannot be used"
                ));
            };
            match kind {
                "scale" => {
                    let times =
                        |old: &Vec<f64>| old.iter().zip(&values).map(|(a, b)| a * b).collect::<Vec<f64>>();
                    (scale, translation) = (
                        Some(scale.as_ref().map_or(values.clone(), times)),
                        translation.as_ref().map(times),
                    );
                }
                "translation" => {
                    translation = Some(translation.map_or(values.clone(), |old| {
                        old.iter().zip(&values).map(|(a, b)| a + b).collect()
                    }));
                }
                _ => return Err(format!("has a transformation \"{kind}\", which cannot be used")),
            }
        }
    }
    Ok((scale, translation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn axes_are_found_by_name() {
        let mut warnings = Vec::new();
        let multiscale = json!({"axes": [
            {"name": "x", "unit": "micrometer"}, {"name": "y", "unit": "micrometer"}, {"name": "z", "unit": "micrometer"}, {"name": "c"}
        ]});
        let axes = AxisPositions::of(&multiscale, None, 4, &mut warnings);
        let Ok(axes) = axes else { panic!("no axes") };
        assert_eq!(axes.stored_order(), [(0, 2), (1, 1), (2, 0)]);
        assert_eq!((axes.channel, axes.time), (Some(3), None));
        assert!(warnings.is_empty());
        let names = ["time", "lat", "lon"].map(str::to_owned).to_vec();
        let axes = AxisPositions::of(&Value::Null, Some(names), 3, &mut warnings);
        let Ok(axes) = axes else { panic!("no axes") };
        assert_eq!((axes.time, axes.z), (Some(0), None));
        assert!(AxisPositions::of(&json!({"axes": ["y", "x"]}), None, 3, &mut warnings).is_err());
    }
}
