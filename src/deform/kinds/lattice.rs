//! Free-form deformation by a lattice of control points (Sederberg and Parry 1986; \[GG42\]):
//! moving a point drags its surroundings.
//!
//! With the *Bernstein* basis the lattice spans the box and every point influences the whole box; a
//! face stays in place if its own control points do. With cubic *B-splines* a point's influence
//! ends two spacings away; the lattice lies far enough inside the box that the displacement and its
//! first two derivatives vanish on all faces. Both are forward maps; the inverse is found
//! numerically (`deform::invert`) for every texel, and folds are cut away.

use super::{
    Backward, DefaultSize, Field, FieldBuilder, FieldContext, FieldInputs, Kind, NO_CUT_DISTANCE_MM, Setting,
    SettingFormat,
};
use crate::deform::{Argument, invert};
use crate::math::Bounds;
use crate::{Error, Result};
use glam::{DVec3, Vec3};

/// Maximum number of control points along an axis: Bernstein polynomials of a higher degree lose
/// precision.
const MAX_SIZE: [usize; 2] = [16, 64];

pub(super) const KIND: Kind = Kind {
    name: "lattice",
    about: "free-form deformation by a lattice of control points",
    parameters: &[],
    size: DefaultSize::Share([0.9; 3]),
    cube_scale: 1.0,
    varies: [true; 3],
    resolution: 56,
    nonzero_faces: [false; 6],
    locked_to_view: false,
    shape: None,
    build: FieldBuilder::Sourced {
        settings: &[
            Setting {
                name: "lattice",
                form: SettingFormat::Whole,
                about: "control points along x, y, z; 4,4,4 by default",
            },
            Setting {
                name: "basis",
                form: SettingFormat::Choice(&["bernstein", "b-spline"]),
                about: "bernstein or b-spline",
            },
            Setting {
                name: "offsets",
                form: SettingFormat::RowsOrFile(6),
                about: "i,j,k,dx,dy,dz for each moved point (indices from 0, offsets in mm); or a .csv file with six columns",
            },
        ],
        example,
        build,
    },
};

/// Draws the upper inner points of a 4 x 4 x 4 lattice up and aside.
fn example(bounds: &Bounds) -> Vec<(&'static str, Argument)> {
    let size = bounds.size();
    let offsets = [[1.0, 1.0], [2.0, 1.0], [1.0, 2.0], [2.0, 2.0]]
        .iter()
        .flat_map(|[i, j]| [*i, *j, 2.0, 0.12 * size.x, 0.0, 0.2 * size.z])
        .collect::<Vec<f32>>();
    vec![("offsets", Argument::Numbers(offsets))]
}

fn build(c: &FieldContext, inputs: &FieldInputs) -> Result<Box<dyn Field>> {
    let settings = inputs.settings;
    let bernstein = settings.choice("basis", &["bernstein", "b-spline"])? == "bernstein";
    let counts = settings.whole("lattice")?.unwrap_or_else(|| vec![4; 3]);
    let most = MAX_SIZE[usize::from(!bernstein)];
    let size: [usize; 3] = counts[..].try_into().map_err(|_| {
        Error::value(
            "lattice",
            format!("has {} numbers; three are needed", counts.len()),
        )
    })?;
    if size.iter().any(|n| !(2..=most).contains(n)) {
        return Err(Error::value(
            "lattice",
            format!("{size:?} cannot be used; 2 to {most} control points along each axis are needed"),
        ));
    }
    let numbers = match settings.0.get("offsets") {
        Some(Argument::Text(path)) => {
            let pairs = crate::deform::points::read_pairs(&inputs.library.path(path))?;
            pairs
                .iter()
                .flat_map(|p| [p.from.to_array(), p.to.to_array()].concat())
                .map(|v| v as f32)
                .collect()
        }
        _ => settings.numbers("offsets")?.ok_or_else(|| {
            Error::value(
                "offsets",
                "are missing; say which control points move, and by how much",
            )
        })?,
    };
    if numbers.is_empty() || numbers.len() % 6 != 0 {
        return Err(Error::value(
            "offsets",
            format!(
                "has {} numbers; each control point needs six: i,j,k,dx,dy,dz",
                numbers.len()
            ),
        ));
    }
    let mut offsets = vec![DVec3::ZERO; size.iter().product()];
    for row in numbers.chunks_exact(6) {
        let index: [usize; 3] = std::array::from_fn(|a| row[a] as usize);
        if (0..3).any(|a| row[a] < 0.0 || row[a].fract() != 0.0 || index[a] >= size[a]) {
            return Err(Error::value(
                "offsets",
                format!(
                    "the lattice of {size:?} has no control point {},{},{}",
                    row[0], row[1], row[2]
                ),
            ));
        }
        offsets[(index[2] * size[1] + index[1]) * size[0] + index[0]] =
            DVec3::new(f64::from(row[3]), f64::from(row[4]), f64::from(row[5])) * f64::from(c.progress);
    }
    let h = f64::from(c.texel_mm) * 0.25;
    Ok(Box::new(LatticeField {
        size,
        offsets,
        box_mm: c.size_mm.as_dvec3(),
        bernstein,
        moves: c.progress > 0.0,
        h,
    }))
}

struct LatticeField {
    size: [usize; 3],
    offsets: Vec<DVec3>,
    box_mm: DVec3,
    bernstein: bool,
    moves: bool,
    /// Step of differences, mm.
    h: f64,
}

impl LatticeField {
    /// Weights of the control points along an axis at `x` in 0..1, and the index of the first
    /// non-zero one.
    fn weights(&self, x: f64, n: usize, out: &mut [f64; MAX_SIZE[0]]) -> (usize, usize) {
        if self.bernstein {
            // Bernstein polynomials by de Casteljau's recurrence.
            out[0] = 1.0;
            for degree in 1..n {
                out[degree] = x * out[degree - 1];
                for i in (1..degree).rev() {
                    out[i] = (1.0 - x) * out[i] + x * out[i - 1];
                }
                out[0] *= 1.0 - x;
            }
            return (0, n);
        }
        // Control point i lies at u = i; the supports, two spacings to each side, exactly fill the
        // box.
        let u = x * (n + 3) as f64 - 2.0;
        let cell = u.floor();
        let w = crate::deform::transform::cubic_weights(u - cell);
        let first = cell as i64 - 1;
        let (low, high) = (first.max(0), (first + 4).min(n as i64));
        for i in low..high.max(low) {
            out[(i - low) as usize] = w[(i - first) as usize];
        }
        (low as usize, (high - low).max(0) as usize)
    }

    fn moved(&self, q: DVec3) -> DVec3 {
        let x = (q / self.box_mm + 0.5).clamp(DVec3::ZERO, DVec3::ONE);
        let mut w = [[0.0; MAX_SIZE[0]]; 3];
        let mut span = [(0, 0); 3];
        for a in 0..3 {
            span[a] = self.weights(x[a], self.size[a], &mut w[a]);
        }
        let mut sum = DVec3::ZERO;
        for k in 0..span[2].1 {
            for j in 0..span[1].1 {
                let row = ((span[2].0 + k) * self.size[1] + span[1].0 + j) * self.size[0] + span[0].0;
                let wkj = w[2][k] * w[1][j];
                for (offset, wi) in self.offsets[row..row + span[0].1].iter().zip(&w[0]) {
                    sum += *offset * (wkj * wi);
                }
            }
        }
        q + sum
    }
}

impl Field for LatticeField {
    fn backward(&self, q: Vec3) -> Backward {
        if !self.moves {
            return Backward {
                source: q,
                cut_distance_mm: NO_CUT_DISTANCE_MM,
            };
        }
        let y = q.as_dvec3();
        let s = invert::point(&|p| self.moved(p), y, y, self.h, 1e-4);
        let source = if s.residual.is_finite() {
            s.source.as_vec3()
        } else {
            q
        };
        Backward {
            source,
            cut_distance_mm: if s.found || s.residual < 0.02 && s.determinant > 0.0 {
                NO_CUT_DISTANCE_MM
            } else {
                -NO_CUT_DISTANCE_MM
            },
        }
    }

    fn forward(&self, q: Vec3) -> Option<Vec3> {
        Some(self.moved(q.as_dvec3()).as_vec3())
    }
}
