//! Explode by label: given labels of a label map move apart, each keeping its shape.
//!
//! A label moves along the line from the centre of all the labels to its own centre. At a deformed
//! point the distance field of every label is evaluated at the point's position before that label
//! moved. The label that contains it is visible; the space in between takes the displacement of the
//! nearest label. There displacements are blended by distance, so that D stays continuous.

use super::{
    Backward, BoxLength, DefaultSize, Field, FieldBuilder, FieldContext, FieldInputs, Kind,
    NO_CUT_DISTANCE_MM, Parameter, Setting, SettingFormat,
};
use crate::deform::Argument;
use crate::math::DistanceGrid;
use crate::math::{Bounds, normalize_or};
use crate::volume::Volume;
use crate::{Error, Result};
use glam::{Affine3A, DVec3, Mat3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Every label needs a distance field of the whole volume.
const MAX_LABELS: usize = 24;

pub(super) const KIND: Kind = Kind {
    name: "explode-labels",
    about: "moves labelled regions apart; everything else is hidden or kept",
    parameters: &[Parameter::mm(
        "gap",
        BoxLength::OfRadius(0.35),
        [BoxLength::Fixed(0.0), BoxLength::OfRadius(2.0)],
        "displacement of the outermost label",
    )],
    size: DefaultSize::Share([1.6; 3]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 128,
    nonzero_faces: [true; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Sourced {
        settings: &[
            Setting {
                name: "label",
                form: SettingFormat::Whole,
                about: "labels to move apart",
            },
            Setting {
                name: "rest",
                form: SettingFormat::Choice(&["hide", "keep"]),
                about: "hide or keep everything outside these labels",
            },
        ],
        example,
        build,
    },
};

/// The eight octants of a ball, from that phantom's label map.
fn example(_: &Bounds) -> Vec<(&'static str, Argument)> {
    vec![
        ("label", Argument::Numbers((1..=8).map(|l| l as f32).collect())),
        ("labels", Argument::Text("phantom:octants:size=64".into())),
    ]
}

fn build(c: &FieldContext, inputs: &FieldInputs) -> Result<Box<dyn Field>> {
    let settings = inputs.settings;
    let labels = settings
        .whole("label")?
        .filter(|l| !l.is_empty())
        .ok_or_else(|| Error::value("label", "is missing; name the labels that move apart"))?;
    if labels.len() > MAX_LABELS {
        return Err(Error::value(
            "label",
            format!(
                "{} labels are too many; at most {MAX_LABELS} can be moved apart",
                labels.len()
            ),
        ));
    }
    let keeps_unlabeled = settings.choice("rest", &["hide", "keep"])? == "keep";
    let volume = inputs.library.labels(settings)?;
    let fields = labels
        .iter()
        .map(|l| inputs.library.label_distance(settings, "label", &[*l]))
        .collect::<Result<Vec<_>>>()?;
    let middles = middles(&volume, &labels);
    let center = middles.iter().sum::<DVec3>() / middles.len() as f64;
    let farthest = middles.iter().map(|m| m.distance(center)).fold(1e-6, f64::max);
    let local_from_world = Mat3::from(inputs.world_from_local.matrix3).inverse();
    let pieces = fields
        .into_iter()
        .zip(&middles)
        .map(|(distance, m)| {
            let way = ((*m - center) / farthest).as_vec3() * (c.value("gap") * c.progress);
            LabelPiece {
                distance,
                way: local_from_world * way,
            }
        })
        .collect();
    let acts = c.value("gap") * c.progress > 0.0;
    Ok(Box::new(ExplodeLabels {
        pieces,
        keeps_unlabeled,
        world_from_local: inputs.world_from_local,
        acts,
        margin: 2.0 * c.texel_mm,
    }))
}

/// Centres of the voxels of each label, mm.
fn middles(volume: &Volume, labels: &[usize]) -> Vec<DVec3> {
    let [nx, ny, nz] = volume.size;
    let none = || vec![(DVec3::ZERO, 0.0f64); labels.len()];
    let of_slice = |k: usize| {
        let mut sums = none();
        for (i, j) in (0..ny).flat_map(|j| (0..nx).map(move |i| (i, j))) {
            let value = volume.value(i, j, k);
            if let Some(n) = labels.iter().position(|l| *l as f64 == value) {
                sums[n].0 += DVec3::new(i as f64, j as f64, k as f64);
                sums[n].1 += 1.0;
            }
        }
        sums
    };
    let slices: Vec<_> = (0..nz).into_par_iter().map(of_slice).collect();
    // In order, so that the sums do not depend on the number of threads.
    let sums = slices.into_iter().fold(none(), |mut sums, slice| {
        sums.iter_mut()
            .zip(slice)
            .for_each(|(sum, s)| *sum = (sum.0 + s.0, sum.1 + s.1));
        sums
    });
    sums.into_iter()
        .map(|(sum, count)| volume.world_from_voxel.transform_point3(sum / count.max(1.0)))
        .collect()
}

struct LabelPiece {
    distance: Arc<DistanceGrid>,
    /// In the box's local millimetres.
    way: Vec3,
}

struct ExplodeLabels {
    pieces: Vec<LabelPiece>,
    keeps_unlabeled: bool,
    world_from_local: Affine3A,
    acts: bool,
    /// Width around a piece in which only its displacement applies.
    margin: f32,
}

impl ExplodeLabels {
    fn inside(&self, piece: &LabelPiece, p: Vec3) -> f32 {
        piece.distance.sample(self.world_from_local.transform_point3(p))
    }
}

impl Field for ExplodeLabels {
    fn backward(&self, q: Vec3) -> Backward {
        if !self.acts {
            return Backward {
                source: q,
                cut_distance_mm: NO_CUT_DISTANCE_MM,
            };
        }
        let (mut total, mut sum) = (0.0, Vec3::ZERO);
        let mut deepest = f32::NEG_INFINITY;
        for piece in &self.pieces {
            let depth = self.inside(piece, q - piece.way);
            deepest = deepest.max(depth);
            let w = 1.0 / (0.05 * self.margin + (-depth - self.margin).max(0.0)).powi(4);
            total += w;
            sum -= piece.way * w;
        }
        let mut source = q + sum / total;
        let mut cut_distance_mm = deepest;
        if self.keeps_unlabeled {
            // The original positions of the pieces are empty; elsewhere everything unlabelled
            // remains.
            let left = self
                .pieces
                .iter()
                .map(|p| self.inside(p, q))
                .fold(f32::NEG_INFINITY, f32::max);
            let rest = (-left).min(-deepest - 2.0 * self.margin);
            if rest > 0.0 {
                source = q;
            } else if deepest < 0.0 {
                let share = (rest / self.margin + 1.0).clamp(0.0, 1.0);
                source = source.lerp(q, share);
            }
            cut_distance_mm = cut_distance_mm.max(rest);
        }
        Backward {
            source,
            cut_distance_mm,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        if !self.acts {
            return Some(q);
        }
        let own = self
            .pieces
            .iter()
            .map(|p| (self.inside(p, q), p))
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .filter(|(depth, _)| *depth > 0.0)?;
        let to = q + normalize_or(own.1.way, Vec3::ZERO) * own.1.way.length();
        (self.backward(to).source.distance_squared(q) < 1e-6).then_some(to)
    }
}
