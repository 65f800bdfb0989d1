//! Forward deformers of meshes: functions that move vertices, with their Jacobians in closed form
//! (\[GG42\]).
//!
//! *Theory*: a deformer f moves a vertex p to f(p). A normal is transformed by the inverse
//! transpose of J = df/dp, or as the cross product of J t and J b for a tangent t and binormal b;
//! both give the same direction (J t × J b = det J · J⁻ᵀ (t × b)). The third method deforms two
//! points near the vertex; it needs no Jacobian and has the error of a finite difference.
//!
//! *Differences from the chapter*: every deformer acts in its own box, in millimetres and degrees,
//! between two heights beyond which it continues rigidly, as in modelling programs; deformers are
//! applied one after the other. On the GPU they run in the vertex shader
//! (`shaders/lib/deformer.wgsl`, the same functions), where changing a parameter only updates a few
//! uniforms.
//!
//! Local coordinates: millimetres from the box's centre along its axes; z is the axis of a twist,
//! bend, taper or bulge.

use crate::math::normalize_or;
use glam::{Affine3A, Mat3, Vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Maximum number of deformers of one mesh.
pub const MAX_DEFORMERS: usize = 4;
/// Maximum number of control points of a lattice along each axis.
pub const LATTICE: usize = 4;
/// Distance of the neighbouring points from the vertex, as a fraction of the box's size.
const NUMERIC_STEP: f32 = 1e-3;

/// The kind of a deformer.
#[derive(Clone, Debug, PartialEq)]
pub enum DeformerKind {
    /// Rotates about z by this many radians per mm of height.
    Twist(f32),
    /// Bends the z axis towards x by this many radians per mm (Barr 1984, with the length of the
    /// centre line preserved).
    Bend(f32),
    /// Scales x and y by 1 at the lower height and this at the upper one.
    Taper(f32),
    /// Moves x by this fraction of z.
    Shear(f32),
    /// Scales x and y by 1 + amount · exp(-(z/width)²).
    Bulge(f32, f32),
    /// Moves z by amplitude · sin(frequency · √(x² + y²) + phase): the chapter's wave, frequency in
    /// radians per mm.
    Wave(f32, f32, f32),
    /// Free-form deformation (Sederberg and Parry 1986): offsets of the control points of a box,
    /// mm, x fastest, [`LATTICE`] along each axis.
    Lattice(Box<[Vec3; LATTICE * LATTICE * LATTICE]>),
}

/// A deformer with its placement.
#[derive(Clone, Debug, PartialEq)]
pub struct Deformer {
    /// Its kind.
    pub deform: DeformerKind,
    /// World to local; rigid.
    pub local_from_world: Affine3A,
    /// Half the box, mm: heights end at half.z, and a lattice spans the whole box.
    pub half: Vec3,
}

/// How normals are transformed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum NormalMethod {
    /// By the inverse transpose of the Jacobian.
    #[default]
    InverseTranspose,
    /// As the cross product of the deformed tangent and binormal.
    Tangent,
    /// Numerically, from two deformed points near the vertex.
    Numeric,
}

/// Bernstein polynomials of degree 3 and their derivatives.
fn bernstein(t: f32) -> ([f32; 4], [f32; 4]) {
    let s = 1.0 - t;
    (
        [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t],
        [
            -3.0 * s * s,
            3.0 * s * s - 6.0 * s * t,
            6.0 * s * t - 3.0 * t * t,
            3.0 * t * t,
        ],
    )
}

impl Deformer {
    /// The deformed position of a point in local space, and the Jacobian there.
    pub fn local(&self, p: Vec3) -> (Vec3, Mat3) {
        let top = self.half.z;
        let h = p.z.clamp(-top, top);
        // Derivative of the clamped height.
        let dh = if p.z.abs() <= top { 1.0 } else { 0.0 };
        match &self.deform {
            DeformerKind::Twist(rate) => {
                let (s, c) = (rate * h).sin_cos();
                let (x, y) = (c * p.x - s * p.y, s * p.x + c * p.y);
                let j = Mat3::from_cols(
                    Vec3::new(c, s, 0.0),
                    Vec3::new(-s, c, 0.0),
                    Vec3::new(-y * rate * dh, x * rate * dh, 1.0),
                );
                (Vec3::new(x, y, p.z), j)
            }
            DeformerKind::Bend(rate) => {
                if rate.abs() < 1e-9 {
                    return (p, Mat3::IDENTITY);
                }
                let (s, c) = (rate * h).sin_cos();
                let beyond = p.z - h;
                // The centre line is an arc of radius 1/rate about (1/rate, 0); beyond the ends it
                // continues straight.
                let r = 1.0 / rate - p.x;
                let q = Vec3::new(1.0 / rate - r * c + beyond * s, p.y, r * s + beyond * c);
                let along = Vec3::new(
                    r * rate * s * dh + s * (1.0 - dh),
                    0.0,
                    r * rate * c * dh + c * (1.0 - dh),
                );
                (q, Mat3::from_cols(Vec3::new(c, 0.0, -s), Vec3::Y, along))
            }
            DeformerKind::Taper(factor) => {
                let slope = (factor - 1.0) / (2.0 * top);
                let k = 1.0 + slope * (h + top);
                (
                    Vec3::new(k * p.x, k * p.y, p.z),
                    Mat3::from_cols(
                        Vec3::X * k,
                        Vec3::Y * k,
                        Vec3::new(slope * dh * p.x, slope * dh * p.y, 1.0),
                    ),
                )
            }
            DeformerKind::Shear(share) => (
                Vec3::new(p.x + share * h, p.y, p.z),
                Mat3::from_cols(Vec3::X, Vec3::Y, Vec3::new(share * dh, 0.0, 1.0)),
            ),
            DeformerKind::Bulge(amount, width) => {
                let g = amount * (-(p.z / width).powi(2)).exp();
                let (k, dk) = (1.0 + g, -2.0 * p.z / (width * width) * g);
                (
                    Vec3::new(k * p.x, k * p.y, p.z),
                    Mat3::from_cols(Vec3::X * k, Vec3::Y * k, Vec3::new(dk * p.x, dk * p.y, 1.0)),
                )
            }
            DeformerKind::Wave(amplitude, frequency, phase) => {
                let r = p.truncate().length();
                let (s, c) = (frequency * r + phase).sin_cos();
                let k = if r > 1e-12 {
                    amplitude * frequency * c / r
                } else {
                    0.0
                };
                (
                    Vec3::new(p.x, p.y, p.z + amplitude * s),
                    Mat3::from_cols(
                        Vec3::new(1.0, 0.0, k * p.x),
                        Vec3::new(0.0, 1.0, k * p.y),
                        Vec3::Z,
                    ),
                )
            }
            DeformerKind::Lattice(offsets) => {
                let t = ((p / self.half + 1.0) * 0.5).clamp(Vec3::ZERO, Vec3::ONE);
                let inside = p.abs().cmple(self.half);
                let ((bx, dx), (by, dy), (bz, dz)) = (bernstein(t.x), bernstein(t.y), bernstein(t.z));
                let (mut moved, mut j) = (Vec3::ZERO, [Vec3::ZERO; 3]);
                for (n, o) in offsets.iter().enumerate() {
                    let (a, b, c) = (n % LATTICE, n / LATTICE % LATTICE, n / (LATTICE * LATTICE));
                    moved += *o * (bx[a] * by[b] * bz[c]);
                    j[0] += *o * (dx[a] * by[b] * bz[c]);
                    j[1] += *o * (bx[a] * dy[b] * bz[c]);
                    j[2] += *o * (bx[a] * by[b] * dz[c]);
                }
                let scale = |n: usize| if inside.test(n) { 0.5 / self.half[n] } else { 0.0 };
                (
                    p + moved,
                    Mat3::IDENTITY + Mat3::from_cols(j[0] * scale(0), j[1] * scale(1), j[2] * scale(2)),
                )
            }
        }
    }

    /// The deformed position of a world point, and the Jacobian there.
    pub fn apply(&self, world: Vec3) -> (Vec3, Mat3) {
        let (q, j) = self.local(self.local_from_world.transform_point3(world));
        let linear = Mat3::from(self.local_from_world.matrix3);
        // The transform is rigid, hence the inverse of its linear part is its transpose.
        let back = linear.transpose();
        (
            back * (q - Vec3::from(self.local_from_world.translation)),
            back * j * linear,
        )
    }
}

/// The deformed position of a world point under a chain of deformers, and its Jacobian.
pub fn apply_all(chain: &[Deformer], world: Vec3) -> (Vec3, Mat3) {
    chain.iter().fold((world, Mat3::IDENTITY), |(p, j), d| {
        let (q, own) = d.apply(p);
        (q, own * j)
    })
}

/// A tangent and binormal of a unit normal (\[GG42\] 42.2.3: the longer of two cross products),
/// with t × b = n.
pub fn tangents(normal: Vec3) -> (Vec3, Vec3) {
    let (a, b) = (normal.cross(Vec3::Z), normal.cross(Vec3::Y));
    let t = normalize_or(
        if a.length_squared() >= b.length_squared() {
            a
        } else {
            b
        },
        Vec3::X,
    );
    (t, normal.cross(t))
}

/// Distance of the neighbouring points from a vertex for [`NormalMethod::Numeric`], mm.
pub fn vertex_offset_mm(chain: &[Deformer]) -> f32 {
    NUMERIC_STEP
        * chain
            .iter()
            .map(|d| d.half.max_element())
            .fold(f32::INFINITY, f32::min)
            .min(1e6)
}

/// A vertex and its unit normal under a chain of deformers. Where a deformer folds or flattens
/// space the normal is undefined and stays unchanged.
pub fn deform_vertex(chain: &[Deformer], world: Vec3, normal: Vec3, method: NormalMethod) -> (Vec3, Vec3) {
    let (p, j) = apply_all(chain, world);
    let (t, b) = tangents(normal);
    let turned = match method {
        // The cofactors of J are det J · J⁻ᵀ and need no division.
        NormalMethod::InverseTranspose => {
            Mat3::from_cols(
                j.y_axis.cross(j.z_axis),
                j.z_axis.cross(j.x_axis),
                j.x_axis.cross(j.y_axis),
            ) * normal
        }
        NormalMethod::Tangent => (j * t).cross(j * b),
        NormalMethod::Numeric => {
            let beside = vertex_offset_mm(chain);
            (apply_all(chain, world + t * beside).0 - p).cross(apply_all(chain, world + b * beside).0 - p)
        }
    };
    (p, normalize_or(turned, normal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The chapter's wave displaces y by the radius in x and z: z here is its y.
    fn wave() -> Deformer {
        let local_from_world = Affine3A::from_mat3(Mat3::from_cols(Vec3::X, Vec3::Z, Vec3::NEG_Y));
        Deformer {
            deform: DeformerKind::Wave(1.0, 2.0, 0.0),
            local_from_world,
            half: Vec3::splat(10.0),
        }
    }

    /// \[GG42\] 42.5, and [`crate::model`], "Normals".
    #[test]
    fn the_chapters_worked_example() {
        let p = Vec3::new(3.0, 0.0, 4.0);
        let (q, j) = wave().apply(p);
        assert!((q - Vec3::new(3.0, (10.0f32).sin(), 4.0)).length() < 1e-5);
        let cross = (j * Vec3::new(-1.0, 0.0, 1.0)).cross(j * Vec3::new(1.0, 0.0, 1.0));
        assert!(
            (cross - Vec3::new(2.013_772, 2.0, 2.685_029)).abs().max_element() < 1e-5,
            "{cross}"
        );
        let want = Vec3::new(0.515_426, 0.511_902, 0.687_235);
        for method in [NormalMethod::InverseTranspose, NormalMethod::Tangent] {
            let (_, n) = deform_vertex(&[wave()], p, Vec3::Y, method);
            assert!((n - want).abs().max_element() < 1e-5, "{method:?}: {n}");
        }
        // The third method has the error of a finite difference.
        let (_, n) = deform_vertex(&[wave()], p, Vec3::Y, NormalMethod::Numeric);
        assert!((n - want).abs().max_element() < 0.02, "{n}");
    }

    fn all() -> Vec<Deformer> {
        let offsets = std::array::from_fn(|n| {
            Vec3::new((n as f32).sin(), (n as f32 * 1.7).cos(), (n as f32 * 0.6).sin()) * 2.0
        });
        let kinds = [
            DeformerKind::Twist(0.05),
            DeformerKind::Bend(0.04),
            DeformerKind::Taper(0.4),
            DeformerKind::Shear(0.3),
            DeformerKind::Bulge(0.5, 6.0),
            DeformerKind::Wave(1.0, 0.5, 0.4),
            DeformerKind::Lattice(Box::new(offsets)),
        ];
        let local_from_world = Affine3A::from_rotation_x(0.4)
            * Affine3A::from_rotation_z(1.1)
            * Affine3A::from_translation(Vec3::new(1.0, 2.0, -3.0));
        kinds
            .map(|deform| Deformer {
                deform,
                local_from_world,
                half: Vec3::new(9.0, 8.0, 10.0),
            })
            .to_vec()
    }

    proptest! {
        #[test]
        fn jacobians_are_central_differences(p in prop::array::uniform3(-6.0f32..6.0)) {
            let p = Vec3::from(p) + Vec3::new(-1.0, -2.0, 3.0);
            for d in all() {
                // A wave has a cone on its axis, and a lattice ends at its faces: neither is
                // differentiable there.
                let local = d.local_from_world.transform_point3(p);
                let on_axis = matches!(d.deform, DeformerKind::Wave(..)) && local.truncate().length() < 0.3;
                let on_face = matches!(d.deform, DeformerKind::Lattice(_)) && (local.abs() - d.half).abs().min_element() < 0.05;
                if on_axis || on_face {
                    continue;
                }
                let (_, j) = d.apply(p);
                for axis in Vec3::AXES {
                    let h = 0.01;
                    let difference = (d.apply(p + axis * h).0 - d.apply(p - axis * h).0) / (2.0 * h);
                    prop_assert!((j * axis - difference).length() < 5e-3, "{:?}: {} for {}", d.deform, j * axis, difference);
                }
            }
        }

        /// Both exact methods give the same direction.
        #[test]
        fn normal_methods_agree(p in prop::array::uniform3(-8.0f32..8.0), n in prop::array::uniform3(-1.0f32..1.0)) {
            let n = normalize_or(Vec3::from(n), Vec3::X);
            let chain = &all()[..4];
            let a = deform_vertex(chain, Vec3::from(p), n, NormalMethod::InverseTranspose);
            let b = deform_vertex(chain, Vec3::from(p), n, NormalMethod::Tangent);
            prop_assert!(a.1.dot(b.1) > 0.9999);
        }
    }
}
