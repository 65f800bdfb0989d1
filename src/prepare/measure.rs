//! Evaluates a scene's measurements: a length in the patient and in the picture.

use super::{Assets, Deformed};
use crate::deform::distance::{RegionSource, of_region};
use crate::scene::measure::{Measure, MeasureKind};
use crate::volume::Volume;
use crate::{Error, Result};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// One number of a measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity {
    /// What is measured.
    pub what: &'static str,
    /// Its value; none where a point is not visible in the deformed scene.
    pub value: Option<f64>,
    /// Its unit; empty for data values.
    pub unit: &'static str,
}

/// Length or angle of points; none if there are too few.
fn of_points(kind: MeasureKind, points: &[Vec3]) -> Option<f64> {
    let p = |n: usize| points.get(n).map(|v| v.as_dvec3());
    match kind {
        MeasureKind::Distance => Some((p(1)? - p(0)?).length()),
        MeasureKind::Angle => {
            let (a, b) = (p(0)? - p(1)?, p(2)? - p(1)?);
            let cross: DVec3 = a.cross(b);
            Some(cross.length().atan2(a.dot(b)).to_degrees())
        }
        MeasureKind::Probe | MeasureKind::Label => None,
    }
}

impl Measure {
    /// The value of the volume at the nearest voxel; none outside it.
    fn probed(&self, volume: &Volume) -> Option<f64> {
        let p = Vec3::from(*self.points.first()?).as_dvec3();
        value_at(volume, p)
    }

    /// The quantities of a measurement: in the patient, and in the deformed scene where that
    /// differs.
    ///
    /// # Errors
    /// A label that no voxel has, or labels that cannot be read.
    pub fn quantities(&self, assets: &Assets, deformed: &Deformed) -> Result<Vec<Quantity>> {
        let source: Vec<Vec3> = self.points.iter().map(|p| Vec3::from(*p)).collect();
        let unit = if self.kind == MeasureKind::Angle {
            "°"
        } else {
            "mm"
        };
        Ok(match self.kind {
            MeasureKind::Distance | MeasureKind::Angle => {
                let mut all = vec![Quantity {
                    what: self.kind.name(),
                    value: of_points(self.kind, &source),
                    unit,
                }];
                if !deformed.stack_and_cuts().is_empty() {
                    let seen: Option<Vec<Vec3>> = source.iter().map(|p| deformed.forward(*p)).collect();
                    all.push(Quantity {
                        what: "after deformation",
                        value: seen.and_then(|p| of_points(self.kind, &p)),
                        unit,
                    });
                }
                all
            }
            MeasureKind::Probe => vec![Quantity {
                what: "Value",
                value: self.probed(&assets.volume),
                unit: "",
            }],
            MeasureKind::Label => {
                let label = self
                    .label
                    .ok_or_else(|| Error::value("measure.label", "is missing; name a label"))?;
                label_quantities(assets.label_map()?, label, deformed)?
            }
        })
    }
}

/// The value at a world point, data units: the function's, or that of the nearest voxel.
pub fn value_at(volume: &Volume, world: DVec3) -> Option<f64> {
    let v = volume.world_from_voxel.inverse().transform_point3(world).round();
    let inside =
        v.is_finite() && v.cmpge(DVec3::ZERO).all() && (0..3).all(|a| (v[a] as usize) < volume.size[a]);
    inside.then(|| match &volume.function {
        Some(function) => f64::from(function.value(world.as_vec3())),
        None => volume.value(v.x as usize, v.y as usize, v.z as usize),
    })
}

/// Volume and surface of a label in the patient, and its volume in the deformed scene.
fn label_quantities(labels: &Volume, label: u32, deformed: &Deformed) -> Result<Vec<Quantity>> {
    let count: usize = labels.voxels.fold(
        || 0,
        |count, v| count + usize::from(v == f64::from(label)),
        |a, b| a + b,
    );
    let voxel_mm3 = labels.world_from_voxel.matrix3.determinant().abs();
    if count == 0 {
        return Err(Error::value(
            "measure.label",
            format!("no voxel has the label {label}"),
        ));
    }
    let ml = |mm3: f64| mm3 / 1000.0;
    let mut all = vec![
        Quantity {
            what: "Volume",
            value: Some(ml(count as f64 * voxel_mm3)),
            unit: "ml",
        },
        Quantity {
            what: "Surface area",
            value: surface_mm2(labels, label).map(|mm2| mm2 / 100.0),
            unit: "cm²",
        },
    ];
    let deformation = deformed.stack_and_cuts();
    if !deformation.is_empty() {
        let bounds = deformed.stack.deformed_bounds(&labels.bounds_in_world());
        let step = labels.spacing_mm().min_element() as f32;
        let n = (bounds.size() / step).ceil().as_uvec3().max(glam::UVec3::ONE);
        let seen: usize = (0..n.z)
            .into_par_iter()
            .map(|k| {
                let mut seen = 0;
                for j in 0..n.y {
                    for i in 0..n.x {
                        let p = bounds.min + (glam::UVec3::new(i, j, k).as_vec3() + 0.5) * step;
                        let source = deformation.source(p);
                        if source.and_then(|s| value_at(labels, s.as_dvec3())) == Some(f64::from(label)) {
                            seen += 1;
                        }
                    }
                }
                seen
            })
            .sum();
        all.push(Quantity {
            what: "after deformation",
            value: Some(ml(seen as f64 * f64::from(step).powi(3))),
            unit: "ml",
        });
    }
    Ok(all)
}

/// The area of a label's smoothed surface: the integral of |∇f| δ(f) with a cosine for δ, two
/// voxels wide (coarea formula).
fn surface_mm2(labels: &Volume, label: u32) -> Option<f64> {
    let field = of_region(labels, &RegionSource::Labels(&[label as usize]), true)?;
    let [nx, ny, nz] = labels.size;
    let spacing = labels.spacing_mm();
    let width = 2.0 * spacing.max_element();
    let cell = labels.world_from_voxel.matrix3.determinant().abs();
    let step = spacing.min_element() as f32;
    let area: f64 = (0..nz)
        .into_par_iter()
        .map(|k| {
            let mut sum = 0.0;
            for j in 0..ny {
                for i in 0..nx {
                    let p = labels
                        .world_from_voxel
                        .transform_point3(DVec3::new(i as f64, j as f64, k as f64))
                        .as_vec3();
                    let f = f64::from(field.sample(p));
                    if f.abs() < width {
                        let delta = (1.0 + (std::f64::consts::PI * f / width).cos()) / (2.0 * width);
                        sum += delta * f64::from(field.gradient(p, step).length());
                    }
                }
            }
            sum
        })
        .sum();
    Some(area * cell)
}

/// All measurements as a table: kind, name, quantity, value, unit, the points in the patient (mm),
/// and remarks.
pub fn csv(measures: &[(Measure, Vec<Quantity>)]) -> String {
    let quoted = |text: &str| {
        if text.contains([',', '"', '\n', '\r']) {
            format!("\"{}\"", text.replace('"', "\"\""))
        } else {
            text.to_owned()
        }
    };
    let mut out = String::from("kind,name,quantity,value,unit,points_lps_mm,note\n");
    for (measure, quantities) in measures {
        let points: Vec<String> = measure
            .points
            .iter()
            .map(|p| format!("{} {} {}", p[0], p[1], p[2]))
            .collect();
        for q in quantities {
            let value = q.value.map_or_else(String::new, |v| format!("{v}"));
            let name = quoted(measure.name.as_deref().unwrap_or_default());
            let note = if measure.before_resampling {
                "made before resampling"
            } else {
                ""
            };
            out.push_str(&format!(
                "{},{name},{},{value},{},{},{note}\n",
                measure.kind.name(),
                q.what,
                q.unit,
                points.join("; ")
            ));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use crate::volume::{Rescale, Voxels};
    use glam::{DAffine3, DMat3};

    fn measure(kind: MeasureKind, points: &[[f32; 3]]) -> Measure {
        Measure {
            kind,
            name: None,
            points: points.to_vec(),
            label: None,
            before_resampling: false,
        }
    }

    #[test]
    fn lengths_and_angles() {
        let scene = Scene::of_volume("phantom:ball:size=16");
        let assets = Assets::load(&scene).unwrap();
        let deformed = Deformed::new(&scene, &assets).unwrap();
        let of = |m: Measure| m.quantities(&assets, &deformed).unwrap()[0].value.unwrap();
        assert!(
            (of(measure(
                MeasureKind::Distance,
                &[[0.0, 0.0, 0.0], [3.0, 4.0, 12.0]]
            )) - 13.0)
                .abs()
                < 1e-6
        );
        assert!(
            (of(measure(
                MeasureKind::Angle,
                &[[5.0, 0.0, 0.0], [0.0; 3], [1.0, 1.0, 0.0]]
            )) - 45.0)
                .abs()
                < 1e-5
        );
    }

    /// A slab that opens moves one end of a distance by the gap; the length in the patient stays
    /// the same.
    #[test]
    fn lengths_in_the_picture_are_those_of_the_deformed_points() {
        let mut scene = Scene::of_volume("phantom:ball:size=32");
        let mut twist = crate::scene::Deformation::new("twist");
        twist.parameters.insert("angle", 60.0);
        scene.deformation.push(twist);
        let assets = Assets::load(&scene).unwrap();
        let deformed = Deformed::new(&scene, &assets).unwrap();
        let b = assets.volume.bounds_in_world();
        let (p, q) = (
            b.center() + b.size() * Vec3::new(0.1, 0.0, -0.3),
            b.center() + b.size() * Vec3::new(0.1, 0.0, 0.3),
        );
        let found = measure(MeasureKind::Distance, &[p.into(), q.into()])
            .quantities(&assets, &deformed)
            .unwrap();
        let seen = (deformed.forward(q).unwrap() - deformed.forward(p).unwrap()).length();
        assert!((deformed.stack.source_and_alpha(deformed.forward(q).unwrap()).0 - q).length() < 0.01);
        assert!((found[0].value.unwrap() - f64::from((q - p).length())).abs() < 1e-3);
        assert!(
            (found[1].value.unwrap() - f64::from(seen)).abs() < 1e-3
                && f64::from(seen) > found[0].value.unwrap() + 0.1
        );
    }

    /// A ball of labels has the volume and surface of its closed form.
    #[test]
    fn a_labelled_ball_has_its_volume_and_surface() {
        let (n, radius, spacing) = (48usize, 18.0f64, 0.5f64);
        let inside = |i: usize| {
            let p =
                DVec3::new((i % n) as f64, (i / n % n) as f64, (i / n / n) as f64) - (n as f64 - 1.0) / 2.0;
            u8::from(p.length() <= radius) * 3
        };
        let voxels: Vec<u8> = (0..n * n * n).map(inside).collect();
        let mut volume = Volume::new(
            Voxels::new([n; 3], voxels),
            Rescale::NONE,
            DAffine3::from_mat3(DMat3::from_diagonal(DVec3::splat(spacing))),
        );
        volume.declared_labels = true;
        let scene = Scene::of_volume("phantom:ball");
        let assets = Assets::of_volume(volume);
        let deformed = Deformed::new(&scene, &assets).unwrap();
        let found = Measure {
            kind: MeasureKind::Label,
            name: None,
            points: Vec::new(),
            label: Some(3),
            before_resampling: false,
        }
        .quantities(&assets, &deformed)
        .unwrap();
        let r = radius * spacing;
        let (volume, surface) = (
            4.0 / 3.0 * std::f64::consts::PI * r.powi(3) / 1000.0,
            4.0 * std::f64::consts::PI * r * r / 100.0,
        );
        assert!(
            (found[0].value.unwrap() / volume - 1.0).abs() < 0.01,
            "{found:?} {volume}"
        );
        assert!(
            (found[1].value.unwrap() / surface - 1.0).abs() < 0.03,
            "{found:?} {surface}"
        );
    }

    #[test]
    fn tables_quote_names() {
        let mut m = measure(MeasureKind::Probe, &[[1.0, 2.0, 3.0]]);
        m.name = Some("a, \"b\"".into());
        let text = csv(&[(
            m,
            vec![Quantity {
                what: "Value",
                value: Some(7.5),
                unit: "",
            }],
        )]);
        assert_eq!(
            text.lines().nth(1),
            Some("Probe,\"a, \"\"b\"\"\",Value,7.5,,1 2 3,")
        );
    }
}
