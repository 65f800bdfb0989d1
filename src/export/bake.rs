//! Baking: resamples the deformed scene into a volume, or the composed displacement into a field
//! (\[RVD01\] section 5), slab by slab, so that only the source and a few slabs are in memory.

mod series;
mod slabs;

pub use series::{dicom_segmentation, dicom_series};

use super::rows::{BakeRow, BakeRows};
use crate::deform::{Stack, StackAndCuts};
use crate::math::Bounds;
use crate::math::flat;
use crate::math::lanes::*;
use crate::volume::load::ScalarType;
use crate::volume::save::{Content, Format, Writer};
use crate::volume::{GridGeometry, Rescale, Volume, Voxels};
use crate::{Error, Result};
use glam::{DAffine3, DVec3, Vec3};
use slabs::slabs;
use std::io::Write;

/// Interpolation between voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// Nearest neighbour: for labels.
    Nearest,
    /// Trilinear.
    Linear,
    /// Cubic convolution with a = -1/2 (Keys 1981): third order, interpolating.
    Cubic,
}

/// How a volume is baked.
#[derive(Clone, Copy, Default)]
pub struct BakeOptions<'a> {
    /// By default nearest neighbour for label maps, otherwise trilinear.
    pub interpolation: Option<Interpolation>,
    /// The value outside the volume and in cuts, in data units; by default the volume's lowest.
    pub fill: Option<f64>,
    /// Receives the fraction of work done.
    pub progress: Option<&'a dyn Fn(f32)>,
}

impl BakeOptions<'_> {
    fn interpolation_of(&self, volume: &Volume) -> Interpolation {
        self.interpolation.unwrap_or_else(|| {
            if volume.labels().is_some() {
                Interpolation::Nearest
            } else {
                Interpolation::Linear
            }
        })
    }
}

/// The grid of a volume, enlarged by whole voxels until it contains the deformed scene.
pub fn enlarged(volume: &Volume, stack: &Stack) -> GridGeometry {
    let grid = volume.geometry();
    let deformed = stack.deformed_bounds(&volume.bounds_in_world());
    let voxel_from_world = crate::math::to_f32(&grid.world_from_voxel.inverse());
    let own = Bounds::new(Vec3::splat(-0.5), Vec3::from(grid.size.map(|n| n as f32)) - 0.5);
    let all = deformed.transformed(&voxel_from_world).union(&own);
    let before = (own.min - all.min).max(Vec3::ZERO).ceil();
    let after = (all.max - own.max).max(Vec3::ZERO).ceil();
    GridGeometry {
        size: std::array::from_fn(|a| grid.size[a] + before[a] as usize + after[a] as usize),
        world_from_voxel: grid.world_from_voxel * DAffine3::from_translation(-before.as_dvec3()),
    }
}

fn scalar_of(voxels: &Voxels) -> ScalarType {
    match voxels {
        Voxels::U8(_) => ScalarType::U8,
        Voxels::I8(_) => ScalarType::I8,
        Voxels::U16(_) => ScalarType::U16,
        Voxels::I16(_) => ScalarType::I16,
        Voxels::U32(_) => ScalarType::U32,
        Voxels::I32(_) => ScalarType::I32,
        Voxels::U64(_) => ScalarType::U64,
        Voxels::I64(_) => ScalarType::I64,
        Voxels::F32(_) => ScalarType::F32,
        Voxels::F64(_) => ScalarType::F64,
    }
}

/// Appends a value in the bytes of a type, rounded and clamped to its range.
fn put(out: &mut Vec<u8>, scalar: ScalarType, v: f64) {
    // `as` truncates, saturates, and maps NaN to 0.
    let whole = v + 0.5f64.copysign(v);
    match scalar {
        ScalarType::U8 => out.push(whole as u8),
        ScalarType::I8 => out.extend((whole as i8).to_le_bytes()),
        ScalarType::U16 => out.extend((whole as u16).to_le_bytes()),
        ScalarType::I16 => out.extend((whole as i16).to_le_bytes()),
        ScalarType::U32 => out.extend((whole as u32).to_le_bytes()),
        ScalarType::I32 => out.extend((whole as i32).to_le_bytes()),
        ScalarType::U64 => out.extend((v.round() as u64).to_le_bytes()),
        ScalarType::I64 => out.extend((v.round() as i64).to_le_bytes()),
        ScalarType::F32 => out.extend((v as f32).to_le_bytes()),
        ScalarType::F64 => out.extend(v.to_le_bytes()),
    }
}

/// Whole numbers in the range of a type of 8 or 16 bits, to be appended in its bytes; `fill`,
/// clamped to that range, replaces NaN.
struct Whole<'a> {
    out: &'a mut Vec<u8>,
    scalar: ScalarType,
    values: &'a [f32],
    fill: f32,
}

impl SimdKernel for Whole<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let fill = match self.scalar {
            ScalarType::U8 => f32::from(self.fill as u8),
            ScalarType::U16 => f32::from(self.fill as u16),
            _ => f32::from(self.fill as i16),
        };
        let fill = f32x8::splat(simd, fill);
        for values in self.values.chunks(LANES) {
            let mut eight = [0.0; LANES];
            eight[..values.len()].copy_from_slice(values);
            let v = f32x8::load_array(simd, eight);
            let whole = v.simd_eq(v).select(v, fill).to_int::<i32x8<S>>();
            if self.scalar == ScalarType::U8 {
                let mut bytes = [0; LANES];
                for n in 0..LANES {
                    bytes[n] = whole[n] as u8;
                }
                self.out.extend_from_slice(&bytes[..values.len()]);
            } else {
                let mut bytes = [[0; 2]; LANES];
                for n in 0..LANES {
                    bytes[n] = (whole[n] as u16).to_le_bytes();
                }
                self.out.extend_from_slice(bytes[..values.len()].as_flattened());
            }
        }
    }
}

/// Interpolates the stored values of a volume, or evaluates its function; the outermost voxels extend
/// half a voxel outwards.
struct StoredInterpolator<'a> {
    volume: &'a Volume,
    interpolation: Interpolation,
}

impl StoredInterpolator<'_> {
    fn at(&self, c: [i64; 3]) -> f64 {
        let [nx, ny, nz] = self.volume.size;
        let clamp = |v: i64, n: usize| v.clamp(0, n as i64 - 1) as usize;
        self.volume
            .voxels
            .at([clamp(c[0], nx), clamp(c[1], ny), clamp(c[2], nz)])
    }

    /// None outside the volume.
    fn sample(&self, p: DVec3) -> Option<f64> {
        let size = DVec3::from_array(self.volume.size.map(|n| n as f64));
        if p.cmplt(DVec3::splat(-0.5)).any() || p.cmpgt(size - 0.5).any() {
            return None;
        }
        if let Some(function) = &self.volume.function {
            let value = function.value(self.volume.world_from_voxel.transform_point3(p).as_vec3());
            let Rescale { slope, intercept } = self.volume.rescale;
            return Some((f64::from(value) - intercept) / slope);
        }
        let base = p.floor();
        let (c, f) = ([base.x as i64, base.y as i64, base.z as i64], p - base);
        if self.interpolation == Interpolation::Linear
            && self.volume.voxels.is_integer()
            && (0..3).all(|a| c[a] >= 0 && c[a] + 1 < self.volume.size[a] as i64)
        {
            return Some(self.volume.voxels.trilinear(c.map(|c| c as usize), f));
        }
        Some(match self.interpolation {
            Interpolation::Nearest => self.at([p.x.round() as i64, p.y.round() as i64, p.z.round() as i64]),
            Interpolation::Linear => {
                self.weighted(c, 0, &[[1.0 - f.x, f.x], [1.0 - f.y, f.y], [1.0 - f.z, f.z]])
            }
            Interpolation::Cubic => self.weighted(
                c,
                -1,
                &[
                    cubic_convolution_weights(f.x),
                    cubic_convolution_weights(f.y),
                    cubic_convolution_weights(f.z),
                ],
            ),
        })
    }

    /// Stored values, rounded if `whole`, of a row of the deformed scene, with NaN outside the
    /// volume and in cuts; `None` if [`Self::sample`] has to be used instead. `m` is world to
    /// voxels of the source; the row starts at `first` and advances by `step`, mm.
    fn row(
        &self,
        deformation: &StackAndCuts,
        m: &DAffine3,
        [first, step]: [DVec3; 2],
        count: usize,
        whole: bool,
    ) -> Option<Vec<f32>> {
        let size = self.volume.size;
        let is_linear = self.interpolation == Interpolation::Linear && self.volume.function.is_none();
        if !is_linear || size.iter().any(|&n| n < 2) {
            return None;
        }
        let rows = BakeRows {
            size,
            deformation: *deformation,
            voxel_from_world: m,
            first,
            step,
            count,
            whole,
        };
        match &self.volume.voxels {
            Voxels::U8(v) => Some(with_simd(BakeRow {
                voxels: flat(v),
                rows,
            })),
            Voxels::U16(v) => Some(with_simd(BakeRow {
                voxels: flat(v),
                rows,
            })),
            Voxels::I16(v) => Some(with_simd(BakeRow {
                voxels: flat(v),
                rows,
            })),
            _ => None,
        }
    }

    fn weighted<const N: usize>(&self, c: [i64; 3], first: i64, w: &[[f64; N]; 3]) -> f64 {
        // A voxel with negligible weight must not spread its NaN.
        const NOTHING: f64 = 1e-9;
        let mut sum = 0.0;
        for (k, wz) in w[2].iter().enumerate() {
            for (j, wy) in w[1].iter().enumerate() {
                if wz.abs() < NOTHING || wy.abs() < NOTHING {
                    continue;
                }
                let mut row = 0.0;
                for (i, wx) in w[0].iter().enumerate() {
                    if wx.abs() >= NOTHING {
                        row += wx
                            * self.at([
                                c[0] + first + i as i64,
                                c[1] + first + j as i64,
                                c[2] + first + k as i64,
                            ]);
                    }
                }
                sum += wz * wy * row;
            }
        }
        sum
    }
}

fn cubic_convolution_weights(t: f64) -> [f64; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        -0.5 * t + t2 - 0.5 * t3,
        1.0 - 2.5 * t2 + 1.5 * t3,
        0.5 * t + 2.0 * t2 - 1.5 * t3,
        -0.5 * t2 + 0.5 * t3,
    ]
}

/// The type for a volume's data values if the format cannot state the rescale: integers if the
/// rescale is integral, else floating point.
fn data_type(volume: &Volume, stored: ScalarType) -> (ScalarType, Rescale) {
    let Rescale { slope, intercept } = volume.rescale;
    if volume.rescale == Rescale::NONE {
        return (stored, Rescale::NONE);
    }
    let whole = volume.voxels.is_integer() && slope.fract() == 0.0 && intercept.fract() == 0.0;
    let [low, high] = volume.range;
    // Padding and holes lie outside the range.
    let (low, high) = volume.padding.map_or((low, high), |p| {
        p.iter()
            .map(|v| v * slope + intercept)
            .fold((low, high), |(a, b), v| (a.min(v), b.max(v)))
    });
    let scalar = match stored {
        _ if whole && low >= f64::from(i16::MIN) && high <= f64::from(i16::MAX) => ScalarType::I16,
        _ if whole && low >= f64::from(i32::MIN) && high <= f64::from(i32::MAX) => ScalarType::I32,
        ScalarType::U8 | ScalarType::I8 | ScalarType::U16 | ScalarType::I16 | ScalarType::F32 => {
            ScalarType::F32
        }
        _ => ScalarType::F64,
    };
    (scalar, Rescale::NONE)
}

/// Computes the rows of a baked volume.
struct VolumeRows<'a> {
    stored: StoredInterpolator<'a>,
    deformation: &'a StackAndCuts<'a>,
    grid: &'a GridGeometry,
    /// World to voxels of the source.
    voxel_from_world: DAffine3,
    /// The type of the written values.
    scalar: ScalarType,
    /// Rescale from interpolated to written values.
    in_data: Rescale,
    /// The stored value outside the volume and in cuts.
    fill: f64,
    /// Lowest and highest written value: cubic interpolation overshoots. They do not apply to
    /// `fill`.
    limits: Option<[f64; 2]>,
}

impl VolumeRows<'_> {
    /// Appends the bytes of the grid's row at `j` and `k`.
    fn append(&self, j: usize, k: usize, bytes: &mut Vec<u8>) {
        let Self {
            stored,
            voxel_from_world,
            ..
        } = self;
        let Self {
            deformation,
            grid,
            scalar,
            in_data,
            fill,
            limits,
            ..
        } = *self;
        let is_float = matches!(scalar, ScalarType::F32 | ScalarType::F64);
        let limited = |v: f64| limits.map_or(v, |[low, high]| v.clamp(low, high));
        let at = |i: usize| {
            grid.world_from_voxel
                .transform_point3(DVec3::new(i as f64, j as f64, k as f64))
        };
        let [first, step] = [at(0), grid.world_from_voxel.matrix3.x_axis];
        let as_stored = in_data == Rescale::NONE && scalar == scalar_of(&stored.volume.voxels);
        if let Some(values) = stored.row(
            deformation,
            voxel_from_world,
            [first, step],
            grid.size[0],
            as_stored,
        ) {
            if as_stored {
                with_simd(Whole {
                    out: bytes,
                    scalar,
                    values: &values,
                    fill: fill.round() as f32,
                });
            } else {
                for v in values {
                    // Linear interpolation stays within the limits.
                    let v = if v.is_nan() { fill } else { f64::from(v) };
                    put(bytes, scalar, v * in_data.slope + in_data.intercept);
                }
            }
            return;
        }
        let deformed: Vec<Vec3> = (0..grid.size[0]).map(|i| at(i).as_vec3()).collect();
        for (i, (source, alpha)) in deformation
            .stack
            .sources_and_alphas(&deformed)
            .into_iter()
            .enumerate()
        {
            let seen = alpha >= 0.5 && deformation.cuts.signed_distance_mm(deformed[i]) >= 0.0;
            let value = seen.then(|| {
                // The walk gives the displacement in single precision; the point itself stays in
                // double precision.
                let exact = at(i) + (source - deformed[i]).as_dvec3();
                stored.sample(voxel_from_world.transform_point3(exact))
            });
            // An integer cannot say that a voxel is not a number.
            let value = value.flatten().filter(|v| is_float || v.is_finite());
            let written = |v: f64| v * in_data.slope + in_data.intercept;
            put(
                bytes,
                scalar,
                value.map_or_else(|| written(fill), |v| limited(written(v))),
            );
        }
    }
}

/// Writes the deformed volume on `grid`, in the source's type and scale.
///
/// # Errors
/// Errors from the destination; a grid or scale that the format cannot state.
pub fn volume(
    volume: &Volume,
    deformation: &StackAndCuts,
    grid: &GridGeometry,
    format: Format,
    out: &mut dyn Write,
    options: &BakeOptions,
) -> Result<()> {
    let fail = |e: String| Error::value("output", e);
    let interpolation = options.interpolation_of(volume);
    let fill = options.fill.unwrap_or(volume.range[0]);
    let progress = options.progress.unwrap_or(&|_| ());
    let scalar = scalar_of(&volume.voxels);
    // A format without slope and intercept gets the data values themselves.
    let (scalar, written) = if format.states_rescale() {
        (scalar, volume.rescale)
    } else {
        data_type(volume, scalar)
    };
    let content = if volume.declared_labels && written == Rescale::NONE {
        Content::Labels(scalar)
    } else {
        Content::Scalar(scalar, written)
    };
    let in_data = if written == volume.rescale {
        Rescale::NONE
    } else {
        volume.rescale
    };
    let mut writer = Writer::new(out, format, grid, content).map_err(fail)?;
    let rows = VolumeRows {
        stored: StoredInterpolator {
            volume,
            interpolation,
        },
        deformation,
        grid,
        voxel_from_world: volume.world_from_voxel.inverse(),
        scalar,
        in_data,
        fill: (fill - volume.rescale.intercept) / volume.rescale.slope,
        limits: None,
    };
    let row = |j: usize, k: usize, bytes: &mut Vec<u8>| rows.append(j, k, bytes);
    slabs(
        grid,
        scalar.bytes(),
        row,
        |b| writer.push(b).map_err(|e| fail(e.to_string())),
        progress,
    )?;
    writer.finish().map(drop).map_err(|e| fail(e.to_string()))
}

/// Writes the composed displacement on `grid`. In cut regions the displacement is continued, since
/// a field has no mask. Returns the number of points in cuts.
///
/// # Errors
/// As [`volume`].
pub fn field(
    deformation: &StackAndCuts,
    grid: &GridGeometry,
    format: Format,
    out: &mut dyn Write,
    progress: &dyn Fn(f32),
) -> Result<usize> {
    let fail = |e: String| Error::value("output", e);
    let mut writer = Writer::new(out, format, grid, Content::Field).map_err(fail)?;
    let cut = std::sync::atomic::AtomicUsize::new(0);
    let displacement = |i: usize, j: usize, k: usize| {
        let p = grid
            .world_from_voxel
            .transform_point3(DVec3::new(i as f64, j as f64, k as f64))
            .as_vec3();
        let (source, alpha) = deformation.stack.source_and_alpha_unclipped(p);
        (
            source - p,
            alpha >= 0.5 && deformation.cuts.signed_distance_mm(p) >= 0.0,
        )
    };
    // NIfTI stores the components one after the other: the walk is repeated for each instead of
    // storing its results.
    let passes: &[Option<usize>] = if format.planar() {
        &[Some(0), Some(1), Some(2)]
    } else {
        &[None]
    };
    for (n, pass) in passes.iter().enumerate() {
        let row = |j: usize, k: usize, bytes: &mut Vec<u8>| {
            for i in 0..grid.size[0] {
                let (d, seen) = displacement(i, j, k);
                match pass {
                    Some(c) => bytes.extend(d[*c].to_le_bytes()),
                    None => d.to_array().iter().for_each(|v| bytes.extend(v.to_le_bytes())),
                }
                if n == 0 && !seen {
                    cut.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                }
            }
        };
        let whole = passes.len() as f32;
        slabs(
            grid,
            if pass.is_some() { 4 } else { 12 },
            row,
            |b| writer.push(b).map_err(|e| fail(e.to_string())),
            &|s| progress((n as f32 + s) / whole),
        )?;
    }
    writer.finish().map(drop).map_err(|e| fail(e.to_string()))?;
    Ok(cut.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values are truncated to bytes as by `as`, and NaN becomes the fill value, clamped to the
    /// type's range.
    #[test]
    fn whole_values_become_bytes() {
        let values: Vec<f32> = (0..21)
            .map(|n| if n % 5 == 3 { f32::NAN } else { (n * 12) as f32 })
            .collect();
        for fill in [-7.0, 3.0, 300.0, 70_000.0] {
            for (scalar, bytes) in [
                (
                    ScalarType::U8,
                    values
                        .iter()
                        .map(|v| if v.is_nan() { fill as u8 } else { *v as u8 })
                        .collect::<Vec<u8>>(),
                ),
                (
                    ScalarType::U16,
                    values
                        .iter()
                        .flat_map(|v| (if v.is_nan() { fill as u16 } else { *v as u16 }).to_le_bytes())
                        .collect(),
                ),
                (
                    ScalarType::I16,
                    values
                        .iter()
                        .flat_map(|v| (if v.is_nan() { fill as i16 } else { -*v as i16 }).to_le_bytes())
                        .collect(),
                ),
            ] {
                let values: Vec<f32> = if scalar == ScalarType::I16 {
                    values.iter().map(|v| -v).collect()
                } else {
                    values.clone()
                };
                let mut out = vec![9];
                with_simd(Whole {
                    out: &mut out,
                    scalar,
                    values: &values,
                    fill,
                });
                assert_eq!(out[1..], bytes, "{scalar:?} {fill}");
            }
        }
    }

    /// A full destination ends the bake with its error, in whichever slab it occurs.
    #[test]
    fn a_full_disk_is_told() {
        struct Full(usize);
        impl Write for Full {
            fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
                self.0 = self
                    .0
                    .checked_sub(bytes.len())
                    .ok_or_else(|| std::io::Error::other("no space left"))?;
                Ok(bytes.len())
            }
            fn flush(&mut self) -> std::io::Result<()> {
                Ok(())
            }
        }
        let size = [256, 256, 100];
        let v = Volume::new(
            Voxels::new(size, vec![1i16; 256 * 256 * 100]),
            Rescale::NONE,
            DAffine3::IDENTITY,
        );
        let (stack, cuts) = (Stack::default(), crate::deform::cut::CutShapes::default());
        let deformation = StackAndCuts {
            stack: &stack,
            cuts: &cuts,
        };
        let bake = |room: usize| {
            volume(
                &v,
                &deformation,
                &v.geometry(),
                Format::Nifti,
                &mut Full(room),
                &BakeOptions::default(),
            )
        };
        let bytes = 352 + 2 * 256 * 256 * 100;
        for room in [1000, bytes / 2, bytes - 1] {
            let result = bake(room).map_err(|e| e.to_string());
            assert!(
                result.as_ref().is_err_and(|e| e.contains("no space left")),
                "{room}: {result:?}"
            );
        }
        assert!(bake(bytes).is_ok());
    }

    #[test]
    fn cubic_weights_reproduce_parabolas_and_voxels() {
        let voxels: Vec<f64> = (0..7 * 7 * 7)
            .map(|n| {
                let (x, y) = ((n % 7) as f64, (n / 7 % 7) as f64);
                x * x - 2.0 * y
            })
            .collect();
        let v = Volume::new(Voxels::new([7; 3], voxels), Rescale::NONE, DAffine3::IDENTITY);
        let s = StoredInterpolator {
            volume: &v,
            interpolation: Interpolation::Cubic,
        };
        let p = DVec3::new(2.3, 3.7, 3.1);
        assert!((s.sample(p).unwrap_or(f64::NAN) - (p.x * p.x - 2.0 * p.y)).abs() < 1e-9);
        assert_eq!(s.sample(DVec3::new(4.0, 2.0, 1.0)), Some(12.0));
        assert_eq!(s.sample(DVec3::new(-0.6, 0.0, 0.0)), None);
        let linear = StoredInterpolator {
            volume: &v,
            interpolation: Interpolation::Linear,
        };
        assert!((linear.sample(DVec3::new(2.5, 1.0, 0.0)).unwrap_or(f64::NAN) - 4.5).abs() < 1e-12);
    }
}
