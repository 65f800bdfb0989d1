//! ITK's types of transforms, from their parameters and fixed parameters. Source: the documentation
//! and `SetParameters` of each class in ITK 5.

use super::super::{BSplineGrid, TransformStep, VectorField};
use crate::volume::GridGeometry;
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use std::path::Path;

/// How much a versor's length may exceed 1 by rounding; ITK's number.
const VERSOR_TOLERANCE: f64 = 1e-10;

/// One transform of a file: type, parameters, fixed parameters.
pub(in crate::deform::transform) struct ItkTransform {
    pub kind: String,
    pub parameters: Vec<f64>,
    pub fixed: Vec<f64>,
}

impl ItkTransform {
    /// The name of the type, and its precision and dimensions.
    fn name_and_dimensions(&self) -> (&str, &str) {
        self.kind.split_once('_').unwrap_or((&self.kind, ""))
    }

    /// Whether this is a B-spline of order 0. ITK takes every point as outside of its grid, and
    /// moves nothing.
    pub fn is_spline_of_order_0(&self) -> bool {
        let (name, dimensions) = self.name_and_dimensions();
        name == "BSplineTransform" && dimensions.ends_with("_3_3_0")
    }

    /// A notice about a versor that is too long for a rotation.
    pub fn versor_notice(&self) -> Option<String> {
        let (name, _) = self.name_and_dimensions();
        let of_versor = matches!(
            name,
            "VersorRigid3DTransform"
                | "Similarity3DTransform"
                | "ScaleVersor3DTransform"
                | "ScaleSkewVersor3DTransform"
                | "ComposeScaleSkewVersor3DTransform"
        );
        let length = vec3(self.parameters.get(..3).filter(|_| of_versor)?).length();
        (length > 1.0 + 1e-6).then(|| {
            format!(
                "has a versor of length {length:.4}, which is not a rotation; it is normalised, as in ITK"
            )
        })
    }

    /// Fails unless there are exactly `n` parameters and at least `fixed` fixed parameters.
    fn require(&self, path: &Path, n: usize, fixed: usize) -> Result<()> {
        let (p, f) = (&self.parameters, &self.fixed);
        if p.len() == n && f.len() >= fixed {
            Ok(())
        } else {
            let (name, _) = self.name_and_dimensions();
            Err(Error::file(
                path,
                format!(
                    "has a {name} with {} parameters and {} fixed ones; it needs {n} and {fixed}",
                    p.len(),
                    f.len()
                ),
            ))
        }
    }
}

fn vec3(v: &[f64]) -> DVec3 {
    DVec3::new(v[0], v[1], v[2])
}

/// A matrix given row by row.
fn rows(v: &[f64]) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(v[0], v[3], v[6]),
        DVec3::new(v[1], v[4], v[7]),
        DVec3::new(v[2], v[5], v[8]),
    )
}

/// x -> m (x - center) + translation + center.
fn about(m: DMat3, center: DVec3, translation: DVec3) -> DAffine3 {
    DAffine3 {
        matrix3: m,
        translation: translation + center - m * center,
    }
}

/// Size, origin, spacing and direction from ITK's fixed parameters of grids.
fn grid(path: &Path, fixed: &[f64]) -> Result<GridGeometry> {
    let bad = || {
        Error::file(
            path,
            "has a grid whose fixed parameters cannot be used; it is damaged",
        )
    };
    if fixed.len() < 18 || fixed.iter().any(|v| !v.is_finite()) {
        return Err(bad());
    }
    let size = [fixed[0], fixed[1], fixed[2]];
    if size
        .iter()
        .any(|&n| !(1.0..=4096.0).contains(&n) || n.fract() != 0.0)
    {
        return Err(bad());
    }
    let matrix3 = rows(&fixed[9..18]) * DMat3::from_diagonal(vec3(&fixed[6..9]));
    if matrix3.determinant().abs() < 1e-12 {
        return Err(bad());
    }
    Ok(GridGeometry {
        size: size.map(|n| n as usize),
        world_from_voxel: DAffine3 {
            matrix3,
            translation: vec3(&fixed[3..6]),
        },
    })
}

/// The step that an entry of a file describes.
pub(in crate::deform::transform) fn step(path: &Path, entry: &ItkTransform) -> Result<TransformStep> {
    let (name, dimensions) = entry.name_and_dimensions();
    let three = |d: &str| d.split('_').filter(|w| *w == "3").count() >= 2 || d == "3" || !d.contains('_');
    if !three(dimensions) {
        return Err(Error::file(
            path,
            format!("holds a {}, which is not three-dimensional", entry.kind),
        ));
    }
    match name {
        _ if entry.is_spline_of_order_0() => Ok(TransformStep::Affine(DAffine3::IDENTITY)),
        "BSplineTransform" | "BSplineDeformableTransform" => bspline(path, entry).map(TransformStep::BSpline),
        "DisplacementFieldTransform"
        | "GaussianSmoothingOnUpdateDisplacementFieldTransform"
        | "BSplineSmoothingOnUpdateDisplacementFieldTransform" => {
            displacement_field(path, entry).map(TransformStep::Field)
        }
        _ => affine(path, entry).map(TransformStep::Affine),
    }
}

/// A rotation by Euler angles, in the order ZYX or ZXY.
fn euler(angles: &[f64], zyx: bool) -> DMat3 {
    let [x, y, z] = [
        DMat3::from_rotation_x(angles[0]),
        DMat3::from_rotation_y(angles[1]),
        DMat3::from_rotation_z(angles[2]),
    ];
    if zyx { z * y * x } else { z * x * y }
}

/// The rotation of a versor, of which the vector part is given; one that is too long is shortened,
/// as in itk::VersorRigid3DTransform and the classes derived from it.
fn versor(v: &[f64]) -> DMat3 {
    let (v, length) = (vec3(v), vec3(v).length());
    if length >= 1.0 - VERSOR_TOLERANCE {
        rotation(v / (length * (1.0 + VERSOR_TOLERANCE)))
    } else {
        rotation(v)
    }
}

/// The rotation of a versor's vector part of at most the length 1.
fn rotation(v: DVec3) -> DMat3 {
    DMat3::from_quat(DQuat::from_xyzw(
        v.x,
        v.y,
        v.z,
        (1.0 - v.length_squared()).max(0.0).sqrt(),
    ))
}

/// The number of parameters, and of fixed ones, that an affine type needs; none for other types.
fn affine_numbers(name: &str) -> Option<(usize, usize)> {
    Some(match name {
        "IdentityTransform" => (0, 0),
        "AffineTransform"
        | "MatrixOffsetTransformBase"
        | "FixedCenterOfRotationAffineTransform"
        | "ScalableAffineTransform"
        | "Rigid3DTransform" => (12, 3),
        "CenteredAffineTransform" => (15, 0),
        "TranslationTransform" => (3, 0),
        "ScaleTransform" | "ScaleLogarithmicTransform" | "VersorTransform" => (3, 3),
        "Euler3DTransform" | "VersorRigid3DTransform" => (6, 3),
        "CenteredEuler3DTransform" => (9, 0),
        "QuaternionRigidTransform" | "Similarity3DTransform" => (7, 3),
        "ScaleVersor3DTransform" => (9, 3),
        "ScaleSkewVersor3DTransform" => (15, 3),
        "ComposeScaleSkewVersor3DTransform" => (12, 3),
        _ => return None,
    })
}

/// The affine transform of an entry of any affine ITK type.
fn affine(path: &Path, entry: &ItkTransform) -> Result<DAffine3> {
    let (p, f) = (&entry.parameters, &entry.fixed);
    let (name, _) = entry.name_and_dimensions();
    let (parameters, fixed) = affine_numbers(name).ok_or_else(|| unsupported(path, name, &entry.kind))?;
    if name != "IdentityTransform" {
        entry.require(path, parameters, fixed)?;
    }
    let affine = match name {
        "IdentityTransform" => DAffine3::IDENTITY,
        "TranslationTransform" => DAffine3::from_translation(vec3(p)),
        "ScaleTransform" => about(DMat3::from_diagonal(vec3(p)), vec3(f), DVec3::ZERO),
        "ScaleLogarithmicTransform" => about(DMat3::from_diagonal(vec3(p).exp()), vec3(f), DVec3::ZERO),
        "CenteredAffineTransform" => about(rows(p), vec3(&p[9..]), vec3(&p[12..])),
        // The fourth fixed parameter selects the order ZYX instead of ZXY.
        "Euler3DTransform" => {
            let zyx = f.get(3).is_some_and(|&v| v != 0.0);
            about(euler(p, zyx), vec3(f), vec3(&p[3..]))
        }
        "CenteredEuler3DTransform" => {
            let zyx = f.get(3).is_some_and(|&v| v != 0.0);
            about(euler(p, zyx), vec3(&p[3..]), vec3(&p[6..]))
        }
        "VersorTransform" => {
            if vec3(p).length() > 1.0 + VERSOR_TOLERANCE {
                return Err(Error::file(
                    path,
                    "has a VersorTransform whose versor is longer than 1, which ITK refuses; normalise it",
                ));
            }
            about(rotation(vec3(p)), vec3(f), DVec3::ZERO)
        }
        "VersorRigid3DTransform" => about(versor(p), vec3(f), vec3(&p[3..])),
        "Similarity3DTransform" => about(versor(p) * p[6], vec3(f), vec3(&p[3..])),
        "QuaternionRigidTransform" => about(quaternion(p), vec3(f), vec3(&p[4..])),
        // Scale and skew are added to the rotation, not multiplied with it.
        "ScaleVersor3DTransform" => {
            let scale = DMat3::from_diagonal(vec3(&p[6..]) - 1.0);
            about(versor(p) + scale, vec3(f), vec3(&p[3..]))
        }
        "ScaleSkewVersor3DTransform" => {
            let (s, k) = (vec3(&p[6..]) - 1.0, &p[9..15]);
            let added = rows(&[s.x, k[0], k[1], k[2], s.y, k[3], k[4], k[5], s.z]);
            about(versor(p) + added, vec3(f), vec3(&p[3..]))
        }
        "ComposeScaleSkewVersor3DTransform" => {
            let skew = rows(&[1.0, p[9], p[10], 0.0, 1.0, p[11], 0.0, 0.0, 1.0]);
            let scale = DMat3::from_diagonal(vec3(&p[6..]));
            about(versor(p) * scale * skew, vec3(f), vec3(&p[3..]))
        }
        _ => about(rows(p), vec3(f), vec3(&p[9..])),
    };
    if !(affine.is_finite() && affine.matrix3.determinant().abs() > 1e-9) {
        return Err(Error::file(
            path,
            format!("holds a {name} with a singular matrix"),
        ));
    }
    Ok(affine)
}

/// The matrix of a quaternion (x, y, z, w) of any length, as VNL computes it: without
/// normalisation.
fn quaternion(q: &[f64]) -> DMat3 {
    let (x, y, z, w) = (q[0], q[1], q[2], q[3]);
    rows(&[
        w * w + x * x - y * y - z * z,
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        w * w - x * x + y * y - z * z,
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        w * w - x * x - y * y + z * z,
    ])
}

/// The error for a type that cannot be read.
fn unsupported(path: &Path, name: &str, kind: &str) -> Error {
    let what = match name {
        _ if name.ends_with("KernelTransform") => ", splines through landmarks",
        "AzimuthElevationToCartesianTransform" => ", which is not a transform between images",
        _ if name.contains("Velocity") || name.contains("Exponential") => ", a velocity field",
        "CompositeTransform" => " within another one",
        _ => "",
    };
    Error::file(
        path,
        format!("holds a {kind}{what}, which cannot be read; save it as an affine or a displacement field"),
    )
}

/// A grid of B-splines; their order follows the dimensions in the name of the type, if it is not 3.
fn bspline(path: &Path, entry: &ItkTransform) -> Result<BSplineGrid> {
    let p = &entry.parameters;
    let (_, dimensions) = entry.name_and_dimensions();
    let order = match dimensions.split('_').collect::<Vec<_>>()[..] {
        [_, "3", "3", order] => order.parse::<usize>().ok().filter(|n| (1..=3).contains(n)),
        _ => Some(3),
    };
    let order = order.ok_or_else(|| {
        Error::file(
            path,
            format!(
                "holds a {}; B-splines of the orders 1 to 3 can be read",
                entry.kind
            ),
        )
    })?;
    let grid = grid(path, &entry.fixed)?;
    if grid.size.iter().any(|&n| n <= order) {
        return Err(Error::file(
            path,
            format!(
                "has a B-spline grid of {:?} points; splines of order {order} need {} along each axis",
                grid.size,
                order + 1
            ),
        ));
    }
    let n = grid.size.iter().product::<usize>();
    entry.require(path, 3 * n, 18)?;
    // All x, then all y, then all z.
    let coefficients = (0..n)
        .map(|i| Vec3::new(p[i] as f32, p[n + i] as f32, p[2 * n + i] as f32))
        .collect();
    Ok(BSplineGrid::new(grid, coefficients, order))
}

/// A displacement field.
fn displacement_field(path: &Path, entry: &ItkTransform) -> Result<VectorField> {
    let grid = grid(path, &entry.fixed)?;
    entry.require(path, 3 * grid.size.iter().product::<usize>(), 18)?;
    let vectors: Vec<Vec3> = entry
        .parameters
        .chunks_exact(3)
        .map(|v| vec3(v).as_vec3())
        .collect();
    if vectors.iter().any(|v| !v.is_finite()) {
        return Err(Error::file(path, "holds vectors that are NaN or infinite"));
    }
    Ok(VectorField::new(grid, vectors))
}
