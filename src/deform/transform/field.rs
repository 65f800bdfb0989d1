//! A displacement on a grid of points in the world: the output of registration, and the data of
//! baking and inversion.

use super::{TransformContext, fsl_from_voxel, world_from_fsl};
use crate::math::arrays::{flat, shaped, size};
use crate::math::trilinear;
use crate::volume::GridGeometry;
use crate::volume::load::Image;
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use ndarray::{Array3, Zip};
use rayon::prelude::*;
use std::path::Path;

/// NIfTI intents.
const DISPLACEMENT_RAS: i16 = 1006;
const VECTOR_LPS: i16 = 1007;
const FSL_DISPLACEMENT: i16 = 2006;
/// Name of the intent of SPM's deformations (`y_*.nii`), whose vectors are positions.
const SPM_MAPPING: &str = "Mapping";

const LPS_FROM_RAS: DMat3 = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));

/// Displacement vectors, source minus deformed point, LPS mm.
#[derive(Clone)]
pub struct VectorField {
    /// Positions of the vectors.
    pub grid: GridGeometry,
    /// Vectors, of shape (k, j, i).
    pub vectors: Array3<Vec3>,
    voxel_from_world: DAffine3,
}

impl VectorField {
    /// A field on a grid; one vector per voxel, i fastest.
    pub fn new(grid: GridGeometry, vectors: Vec<Vec3>) -> Self {
        Self::of_array(grid.world_from_voxel, shaped(grid.size, vectors))
    }

    fn of_array(world_from_voxel: DAffine3, vectors: Array3<Vec3>) -> Self {
        let grid = GridGeometry {
            size: size(&vectors),
            world_from_voxel,
        };
        Self {
            grid,
            vectors,
            voxel_from_world: grid.world_from_voxel.inverse(),
        }
    }

    /// Samples a transform, given as source from deformed point, on a grid.
    pub fn sampled(grid: GridGeometry, source_from_deformed: impl Fn(DVec3) -> DVec3 + Sync) -> Self {
        let [ni, nj, nk] = grid.size;
        let mut vectors = Array3::default((nk, nj, ni));
        Zip::indexed(&mut vectors).par_for_each(|(k, j, i), to| {
            let p = grid
                .world_from_voxel
                .transform_point3(DVec3::new(i as f64, j as f64, k as f64));
            *to = (source_from_deformed(p) - p).as_vec3();
        });
        Self::of_array(grid.world_from_voxel, vectors)
    }

    /// The displacement field in an image of three components.
    ///
    /// # Errors
    /// Another number of components, vectors that are not finite, or a convention that the file
    /// does not state.
    pub fn of_image(path: &Path, image: &Image, context: &TransformContext) -> Result<Self> {
        let fail = |problem: String| Error::file(path, problem);
        if image.components != 3 {
            return Err(fail(format!(
                "holds {} values per voxel; a displacement field has 3",
                image.components
            )));
        }
        let grid = GridGeometry {
            size: image.size,
            world_from_voxel: image.world_from_voxel,
        };
        let [x, y, z] = [image.component(0), image.component(1), image.component(2)];
        let convention = match (context.convention, image.frame, image.intent) {
            (Some(c), _, _) => c,
            (None, Some(_), _) => "frame",
            (None, None, _) if image.intent_name.starts_with("Velocit") => {
                return Err(fail(
                    "holds velocities, not displacements; integrate them first (SPM: Deformations, Dartel flow)".into(),
                ));
            }
            (None, None, VECTOR_LPS) if image.intent_name == SPM_MAPPING => "ras-absolute",
            (None, None, VECTOR_LPS) => "lps",
            (None, None, DISPLACEMENT_RAS) => "ras",
            (None, None, FSL_DISPLACEMENT) => "fsl",
            (None, None, intent @ 2007..=2009) => {
                let what = ["cubic spline", "discrete cosine", "quadratic spline"][intent as usize - 2007];
                return Err(fail(format!(
                    "holds {what} coefficients of FSL's fnirt; turn it into a field with fnirtfileutils --in=... --out=... first"
                )));
            }
            (None, None, intent) => {
                return Err(fail(format!(
                    "does not state its vector convention (intent {intent}; 1006, 1007 and 2006 do); set convention=lps, ras, fsl or fsl-absolute"
                )));
            }
        };
        let mut stated = Array3::default(x.raw_dim());
        Zip::from(&mut stated)
            .and(&x)
            .and(&y)
            .and(&z)
            .par_for_each(|to, x, y, z| *to = Vec3::new(*x, *y, *z));
        let bad = flat(&stated).par_iter().filter(|v| !v.is_finite()).count();
        if bad > 0 {
            return Err(fail(format!(
                "holds {bad} vectors that are NaN or infinite; mask or replace them"
            )));
        }
        let turned = |m: DMat3| Zip::from(&stated).par_map_collect(|v| (m * v.as_dvec3()).as_vec3());
        let vectors = match convention {
            "lps" => turned(DMat3::IDENTITY),
            "frame" => turned(image.frame.unwrap_or(DMat3::IDENTITY)),
            "ras" => turned(LPS_FROM_RAS),
            "ras-absolute" => Zip::indexed(&stated).par_map_collect(|(k, j, i), v| {
                let voxel = DVec3::new(i as f64, j as f64, k as f64);
                (LPS_FROM_RAS * v.as_dvec3() - grid.world_from_voxel.transform_point3(voxel)).as_vec3()
            }),
            "fsl" | "fsl-absolute" => {
                let own = world_from_fsl(&grid);
                if convention == "fsl" && context.moving.is_none() {
                    turned(own.matrix3)
                } else {
                    // The vectors lead from the reference's millimetres to those of the moving
                    // image.
                    let moving = world_from_fsl(context.moving.as_ref().unwrap_or(&grid));
                    let fsl_from_voxel = fsl_from_voxel(&grid);
                    Zip::indexed(&stated).par_map_collect(|(k, j, i), v| {
                        let voxel = DVec3::new(i as f64, j as f64, k as f64);
                        let from = if convention == "fsl" {
                            fsl_from_voxel.transform_point3(voxel)
                        } else {
                            DVec3::ZERO
                        };
                        (moving.transform_point3(from + v.as_dvec3())
                            - grid.world_from_voxel.transform_point3(voxel))
                        .as_vec3()
                    })
                }
            }
            other => {
                return Err(Error::value(
                    "convention",
                    format!("\"{other}\" is not known; lps, ras, fsl or fsl-absolute"),
                ));
            }
        };
        Ok(Self::of_array(grid.world_from_voxel, vectors))
    }

    /// Grid coordinates of a world point.
    pub fn voxel_from_world(&self, p: DVec3) -> DVec3 {
        self.voxel_from_world.transform_point3(p)
    }

    /// The displacement at grid coordinates, clamped to the grid.
    pub fn at_voxel(&self, voxel: DVec3) -> Vec3 {
        trilinear(flat(&self.vectors), self.grid.size, voxel.as_vec3())
    }

    /// The displacement at a world point. As in ITK, the outermost vectors apply up to the faces of
    /// their voxels, and nothing moves outside.
    pub fn displacement(&self, p: DVec3) -> Vec3 {
        let v = self.voxel_from_world(p);
        let top = DVec3::from_array(self.grid.size.map(|n| n as f64 - 0.5));
        if v.cmplt(DVec3::splat(-0.5)).any() || v.cmpgt(top).any() {
            return Vec3::ZERO;
        }
        self.at_voxel(v)
    }

    /// The source of a deformed point.
    pub fn source_from_deformed(&self, p: DVec3) -> DVec3 {
        p + self.displacement(p).as_dvec3()
    }

    /// d source / d deformed at a voxel, by central differences of the grid (one-sided at its
    /// faces).
    pub fn jacobian(&self, i: usize, j: usize, k: usize) -> DMat3 {
        let [nx, ny, nz] = self.grid.size;
        let at = |c: [usize; 3]| self.vectors[[c[2], c[1], c[0]]].as_dvec3();
        let mut per_voxel = DMat3::ZERO;
        for (axis, n) in [nx, ny, nz].into_iter().enumerate() {
            let c = [i, j, k];
            let (mut low, mut high) = (c, c);
            low[axis] = c[axis].saturating_sub(1);
            high[axis] = (c[axis] + 1).min(n - 1);
            if high[axis] > low[axis] {
                *per_voxel.col_mut(axis) = (at(high) - at(low)) / (high[axis] - low[axis]) as f64;
            }
        }
        DMat3::IDENTITY + per_voxel * self.voxel_from_world.matrix3
    }
}
