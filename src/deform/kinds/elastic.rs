//! Elastic: regions are grabbed and dragged, and their surroundings follow (`deform::elastic`);
//! incisions open.
//!
//! The simulation gives a forward displacement on a coarse lattice. Its inverse is found
//! numerically per texel. Across an incision the lattice's interpolation stretches one cell over
//! the gap; there the cell is split again into two rigid halves and the gap between them, which is
//! cut away.

use super::{
    Backward, DefaultSize, Field, FieldBuilder, FieldContext, FieldInputs, Kind, NO_CUT_DISTANCE_MM,
    Parameter, Setting, SettingFormat, forward_numerically,
};
use crate::deform::elastic::{Grab, Incision, Setup, Solver};
use crate::deform::invert;
use crate::deform::{Argument, Arguments};
use crate::math::Bounds;
use crate::volume::Volume;
use crate::{Error, Result};
use glam::{Affine3A, DAffine3, DVec3, Mat3, Vec3};
use std::sync::Arc;

/// Maximum number of steps of the simulation.
const MAX_STEPS: usize = 500;
/// The simulation has converged when the unbalanced forces are this fraction of those at the start.
const RESIDUAL: f64 = 1e-5;

pub(super) const KIND: Kind = Kind {
    name: "elastic",
    about: "drags points of an elastic lattice, with incisions; plausible, not a biomechanical simulation",
    parameters: &[Parameter::number(
        "nodes",
        20.0,
        [5.0, 40.0],
        "lattice nodes along the box's longest axis (whole number)",
    )],
    size: DefaultSize::Share([0.9; 3]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 64,
    nonzero_faces: [false; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Sourced {
        settings: &[
            Setting {
                name: "grab",
                form: SettingFormat::Rows(7),
                about: "x,y,z,radius,dx,dy,dz in mm: a sphere to drag and its displacement; repeat for more",
            },
            Setting {
                name: "fixed",
                form: SettingFormat::Rows(4),
                about: "x,y,z,radius: a sphere held in place, in addition to the box's faces",
            },
            Setting {
                name: "incision",
                form: SettingFormat::Rows(7),
                about: "x,y,z,nx,ny,nz,radius: centre, normal and radius of a disc-shaped cut",
            },
            Setting {
                name: "stiffness",
                form: SettingFormat::Rows(2),
                about: "label,stiffness: stiffness relative to 1 for each label of the label map (`labels`)",
            },
        ],
        example,
        build,
    },
};

/// Draws one side of a cut aside and up.
fn example(bounds: &Bounds) -> Vec<(&'static str, Argument)> {
    let (c, s) = (bounds.center(), bounds.size());
    let grab = c + s * Vec3::new(0.13, 0.0, 0.12);
    vec![
        (
            "grab",
            Argument::Numbers(vec![
                grab.x,
                grab.y,
                grab.z,
                0.09 * s.x,
                0.07 * s.x,
                0.0,
                0.05 * s.z,
            ]),
        ),
        (
            "incision",
            Argument::Numbers(vec![c.x, c.y, c.z + 0.15 * s.z, 1.0, 0.0, 0.0, 0.32 * s.z]),
        ),
    ]
}

fn build(c: &FieldContext, inputs: &FieldInputs) -> Result<Box<dyn Field>> {
    let Regions {
        grabs,
        fixed,
        incisions,
    } = Regions::read(c, inputs)?;
    let labels = LabelStiffness::read(inputs)?;
    let stiffness = |p: Vec3| labels.at(p);
    let longest = c.size_mm.max_element();
    let count = c.value("nodes").round();
    let nodes = c
        .size_mm
        .to_array()
        .map(|s| ((s / longest * count).round() as usize).max(4));
    let mut solver = Solver::new(&Setup {
        size_mm: c.size_mm,
        nodes,
        grabs: &grabs,
        fixed: &fixed,
        incisions: &incisions,
        stiffness: &stiffness,
    });
    if let Some(n) = solver.caught().iter().position(|c| *c == 0) {
        let problem = format!(
            "grab {} contains no lattice node; use a larger radius, or a point inside the box",
            n + 1
        );
        return Err(Error::value("grab", problem));
    }
    if c.progress > 0.0 {
        let steps = solver.settle(MAX_STEPS, RESIDUAL);
        inputs.library.notice(format!(
            "elastic: {} nodes converged after {steps} iterations; relative residual force {:.1e}, energy {:.3e}",
            nodes.iter().product::<usize>(),
            solver.residual(),
            solver.energy()
        ));
    }
    Ok(Box::new(Elastic {
        solver,
        h: 0.25 * f64::from(c.texel_mm),
        texel: c.texel_mm,
        acts: c.progress > 0.0,
        half: c.half(),
    }))
}

/// The numbers of a setting in rows of `n`; `what` names the columns.
fn rows(settings: &Arguments, name: &str, n: usize, what: &str) -> Result<Vec<Vec<f32>>> {
    let numbers = settings.numbers(name)?.unwrap_or_default();
    if numbers.len() % n != 0 {
        return Err(Error::value(
            name,
            format!(
                "has {} numbers, which is not a multiple of {n} ({what})",
                numbers.len()
            ),
        ));
    }
    Ok(numbers.chunks_exact(n).map(<[f32]>::to_vec).collect())
}

/// The regions that are dragged, held or cut, in the box's local millimetres.
struct Regions {
    grabs: Vec<Grab>,
    /// Centres and radii of the regions that are held.
    fixed: Vec<(Vec3, f32)>,
    incisions: Vec<Incision>,
}

impl Regions {
    /// Reads the regions from the settings. The progress scales the offsets of the grabs.
    fn read(c: &FieldContext, inputs: &FieldInputs) -> Result<Self> {
        let settings = inputs.settings;
        let local_from_world = inputs.world_from_local.inverse();
        let place = |v: &[f32]| local_from_world.transform_point3(Vec3::new(v[0], v[1], v[2]));
        let way = |v: &[f32]| Mat3::from(local_from_world.matrix3) * Vec3::new(v[0], v[1], v[2]);
        let grabs: Vec<Grab> = rows(settings, "grab", 7, "x,y,z,radius,dx,dy,dz")?
            .iter()
            .map(|v| Grab {
                center: place(v),
                radius: v[3],
                offset: way(&v[4..]) * c.progress,
            })
            .collect();
        if grabs.is_empty() {
            return Err(Error::value(
                "grab",
                "is missing; specify what to drag and how far",
            ));
        }
        let fixed: Vec<(Vec3, f32)> = rows(settings, "fixed", 4, "x,y,z,radius")?
            .iter()
            .map(|v| (place(v), v[3]))
            .collect();
        let incisions = rows(settings, "incision", 7, "x,y,z,nx,ny,nz,radius")?
            .iter()
            .map(|v| {
                let normal = way(&v[3..6])
                    .try_normalize()
                    .ok_or_else(|| Error::value("incision", "has a zero-length normal"))?;
                Ok(Incision {
                    center: place(v),
                    normal,
                    radius: v[6],
                })
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(Self {
            grabs,
            fixed,
            incisions,
        })
    }
}

/// The stiffness of the labels of a label map.
struct LabelStiffness {
    /// One row per label: the label and its stiffness.
    by_label: Vec<Vec<f32>>,
    /// The label map and its transform from world millimetres to voxel indices; none if no label is
    /// given.
    label_map: Option<(Arc<Volume>, DAffine3)>,
    world_from_local: Affine3A,
}

impl LabelStiffness {
    /// Reads the stiffness of each label, and the label map if any label is given.
    fn read(inputs: &FieldInputs) -> Result<Self> {
        let by_label = rows(inputs.settings, "stiffness", 2, "label,stiffness")?;
        let labels = if by_label.is_empty() {
            None
        } else {
            Some(inputs.library.labels(inputs.settings)?)
        };
        let label_map = labels.map(|volume| {
            let voxel_from_world = volume.world_from_voxel.inverse();
            (volume, voxel_from_world)
        });
        Ok(Self {
            by_label,
            label_map,
            world_from_local: inputs.world_from_local,
        })
    }

    /// The stiffness at a point of the box, relative to 1.
    fn at(&self, p: Vec3) -> f32 {
        let Some((volume, voxel_from_world)) = &self.label_map else {
            return 1.0;
        };
        let v = voxel_from_world
            .transform_point3(self.world_from_local.transform_point3(p).as_dvec3())
            .round();
        let size = volume.size;
        if (0..3).any(|a| v[a] < 0.0 || v[a] >= size[a] as f64) {
            return 1.0;
        }
        let label = volume.value(v.x as usize, v.y as usize, v.z as usize);
        self.by_label
            .iter()
            .find(|r| f64::from(r[0]) == label)
            .map_or(1.0, |r| r[1])
    }
}

struct Elastic {
    solver: Solver,
    /// Step of differences, mm.
    h: f64,
    texel: f32,
    acts: bool,
    half: Vec3,
}

impl Field for Elastic {
    fn backward(&self, q: Vec3) -> Backward {
        if !self.acts || (q.abs() - self.half).max_element() >= 0.0 {
            return Backward {
                source: q,
                cut_distance_mm: NO_CUT_DISTANCE_MM,
            };
        }
        let y = q.as_dvec3();
        let forward = |x: DVec3| x + self.solver.displacement(x);
        let s = invert::point(&forward, y, y - self.solver.displacement(y), self.h, 1e-3);
        if !s.residual.is_finite() {
            return Backward {
                source: q,
                cut_distance_mm: -NO_CUT_DISTANCE_MM,
            };
        }
        let mut source = s.source.as_vec3();
        // Where the lattice folds, no single source exists.
        let mut cut_distance_mm = if s.residual < 0.05 && s.determinant > 0.0 {
            NO_CUT_DISTANCE_MM
        } else {
            -NO_CUT_DISTANCE_MM
        };
        for i in self.solver.incisions() {
            let off = source - i.center;
            let offset = off.dot(i.normal);
            let cell = self.solver.spacing_along(i.normal);
            let radial = (off - i.normal * offset).length();
            if radial > i.radius + cell {
                continue;
            }
            // Opening of the cut at this point.
            let on_cut = (source - i.normal * offset).as_dvec3();
            let side = (i.normal * (0.5 * cell)).as_dvec3();
            let parted = (self.solver.displacement(on_cut + side) - self.solver.displacement(on_cut - side))
                .as_vec3()
                .dot(i.normal);
            let gap = parted.max(0.0) * ((i.radius + 0.5 * cell - radial) / cell).clamp(0.0, 1.0);
            if gap < 0.5 * self.texel {
                continue;
            }
            // Within the stretched cell: its two original halves, and the gap.
            let across = offset * (cell + gap) / cell;
            let source_offset = if offset.abs() >= 0.5 * cell {
                offset
            } else {
                across.signum() * (across.abs() - 0.5 * gap).max(0.0)
            };
            let cut = if offset.abs() >= 0.5 * cell {
                offset.abs()
            } else {
                across.abs() - 0.5 * gap
            };
            source += i.normal * (source_offset - offset);
            cut_distance_mm = cut_distance_mm.min(cut);
        }
        Backward {
            source,
            cut_distance_mm,
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        if self.acts {
            forward_numerically(self, q)
        } else {
            Some(q)
        }
    }
}
