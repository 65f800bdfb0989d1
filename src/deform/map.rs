//! One displacement map: a grid of (D, alpha) over the unit cube, in one of four storage formats.

mod derivatives;

use super::field::MapDefinition;
use super::texel::{MARKED_ALPHA, Storage, TexelSample};
use crate::math::arrays::{flat, shaped};
use crate::math::cells::{Cells, Vec4x8, across, columns, mix_line, mix_texels};
use crate::math::lanes::*;
use crate::math::pyramid::ChannelRange;
use crate::math::{MinMaxPyramid, trilinear};
use crate::{ByteProgress, Result, Watch};
use glam::{Vec3, Vec4, Vec4Swizzles};
use half::f16;
use ndarray::Array3;
use rayon::prelude::*;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, OnceLock};

/// A grid of inverse displacement and mask over the unit cube.
pub struct DisplacementMap {
    /// Grid points along x, y, z; an axis of 1 does not vary.
    pub size: [usize; 3],
    /// Storage format; the texels are already rounded to it.
    pub storage: Storage,
    /// Map units per stored unit of D: the largest component of D, so that stored values lie in
    /// [-1, 1].
    pub scale: f32,
    whole: TexelRange,
    /// Empty until first used if a device made the texels; then sampled again on the CPU.
    detail: OnceLock<TexelPyramids>,
    definition: Option<MapDefinition>,
    /// J_D and the mask's gradient for each texel, once they are needed: plain, and of a map whose
    /// last grid plane along x is the first one.
    pub(super) slopes: [OnceLock<Arc<Self>>; 2],
}

/// Number of points between checks for cancellation.
const AT_ONCE: usize = 2048;

/// Range of the texels of a whole map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexelRange {
    /// Of (D / scale, alpha).
    pub texels: ChannelRange<4>,
    /// Of the differences of stored D from a grid point to the next one along x, along y and along
    /// z, per map unit.
    pub slopes: ChannelRange<9>,
}

/// The texels, with bounds on boxes of them.
struct TexelPyramids {
    /// (D / scale, alpha), of shape (z, y, x).
    texels: Array3<Vec4>,
    pyramid: MinMaxPyramid<4>,
    /// At each grid point, the differences of stored D to the next one along x, along y and along
    /// z, per map unit.
    slopes: MinMaxPyramid<9>,
}

impl TexelPyramids {
    /// For the texels of a grid.
    fn of(size: [usize; 3], texels: Vec<Vec4>) -> Self {
        let pyramid = MinMaxPyramid::from_runs(size, 1, |first, last, j, k| {
            let row = (k * size[1] + j) * size[0];
            let (low, high) = extremes(&texels[row + first..=row + last]);
            ChannelRange {
                min: low.to_array(),
                max: high.to_array(),
            }
        });
        // Slopes vary less than the texels and only tighten a bound, hence a coarser pyramid
        // suffices.
        let slopes = MinMaxPyramid::from_runs(size, 2, |first, last, j, k| {
            slopes_of(&texels, size, [first, last], [j, k])
        });
        Self {
            texels: shaped(size, texels),
            pyramid,
            slopes,
        }
    }
}

/// Replaces a sample that is not finite by no displacement and mask 0.
fn finite(s: TexelSample) -> Vec4 {
    if s.displacement.is_finite() && s.alpha.is_finite() {
        s.displacement.extend(s.alpha.clamp(0.0, 1.0))
    } else {
        Vec4::ZERO
    }
}

/// Samples in the storage format.
fn stored(samples: &[Vec4], scale: f32, storage: Storage) -> Vec<Vec4> {
    samples
        .par_iter()
        .map(|s| {
            Vec4::from_array(
                (s.xyz() / scale)
                    .extend(s.w)
                    .to_array()
                    .map(|v| storage.quantise(v)),
            )
        })
        .collect()
}

impl DisplacementMap {
    /// Samples a function of map coordinates at the grid points.
    ///
    /// A value that is not finite becomes no displacement and mask 0.
    pub fn from_fn(size: [usize; 3], storage: Storage, f: impl Fn(Vec3) -> TexelSample + Sync) -> Self {
        let samples = (0..size.iter().product::<usize>())
            .into_par_iter()
            .map(|n| f(Self::grid_point(size, n)))
            .collect();
        Self::from_samples(size, storage, samples)
    }

    /// As [`Self::from_fn`], but can be cancelled.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn from_fn_until(
        size: [usize; 3],
        storage: Storage,
        f: impl Fn(Vec3) -> TexelSample + Sync,
        watch: &Watch,
    ) -> Result<Self> {
        let mut samples = vec![
            TexelSample {
                displacement: Vec3::ZERO,
                alpha: 1.0
            };
            size.iter().product()
        ];
        let meter = ByteProgress::new(watch, samples.len() as u64);
        samples
            .par_chunks_mut(AT_ONCE)
            .enumerate()
            .try_for_each(|(chunk, samples)| {
                samples
                    .iter_mut()
                    .enumerate()
                    .for_each(|(n, sample)| *sample = f(Self::grid_point(size, chunk * AT_ONCE + n)));
                meter.add(samples.len() as u64)
            })?;
        Ok(Self::from_samples(size, storage, samples))
    }

    /// Samples a definition.
    pub fn of(definition: &MapDefinition) -> Self {
        Self::from_fn(definition.size, definition.storage, |x| definition.sample(x))
    }

    /// As [`Self::of`], for a caller that may cancel.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn of_watched(definition: &MapDefinition, watch: &Watch) -> Result<Self> {
        Self::from_fn_until(
            definition.size,
            definition.storage,
            |x| definition.sample(x),
            watch,
        )
    }

    /// Map coordinates of the grid point with a flat index.
    pub fn grid_point(size: [usize; 3], n: usize) -> Vec3 {
        let coordinate = |i: usize, n: usize| if n > 1 { i as f32 / (n - 1) as f32 } else { 0.5 };
        Vec3::new(
            coordinate(n % size[0], size[0]),
            coordinate(n / size[0] % size[1], size[1]),
            coordinate(n / (size[0] * size[1]), size[2]),
        )
    }

    /// A map of given samples, x fastest.
    ///
    /// A value that is not finite becomes no displacement and mask 0.
    pub fn from_samples(size: [usize; 3], storage: Storage, samples: Vec<TexelSample>) -> Self {
        Self::from_marked_samples(size, storage, samples, &[])
    }

    /// A map of given samples, some of which are marked ([`super::PrecomposedMap`]); `marked` may
    /// be empty.
    pub(super) fn from_marked_samples(
        size: [usize; 3],
        storage: Storage,
        samples: Vec<TexelSample>,
        marked: &[bool],
    ) -> Self {
        Self::from_values(
            size,
            storage,
            samples.into_par_iter().map(finite).collect(),
            marked,
        )
    }

    /// A map of values of any range: displacements and, as the fourth component, what is stored in
    /// place of the mask.
    pub(super) fn from_values(
        size: [usize; 3],
        storage: Storage,
        samples: Vec<Vec4>,
        marked: &[bool],
    ) -> Self {
        assert!(
            size.iter().all(|&n| n >= 1) && samples.len() == size.iter().product::<usize>(),
            "sample count and size disagree"
        );
        let largest = samples
            .par_iter()
            .map(|s| s.xyz().abs().max_element())
            .reduce(|| 0.0, f32::max);
        let scale = if largest > 0.0 { largest } else { 1.0 };
        let mut texels = stored(&samples, scale, storage);
        texels
            .par_iter_mut()
            .zip(marked)
            .filter(|(_, marked)| **marked)
            .for_each(|(texel, _)| texel.w = MARKED_ALPHA);
        let detail = TexelPyramids::of(size, texels);
        let whole = TexelRange {
            texels: detail.pyramid.whole(),
            slopes: detail.slopes.whole(),
        };
        Self {
            size,
            storage,
            scale,
            whole,
            detail: detail.into(),
            definition: None,
            slopes: Default::default(),
        }
    }

    /// A map whose texels a device has made from a definition, with their range.
    pub fn from_device(definition: MapDefinition, scale: f32, whole: TexelRange) -> Self {
        Self {
            size: definition.size,
            storage: definition.storage,
            scale,
            whole,
            detail: OnceLock::new(),
            definition: Some(definition),
            slopes: Default::default(),
        }
    }

    /// The range of all texels.
    pub fn extent(&self) -> TexelRange {
        self.whole
    }

    /// The definition from which a device made the texels, if one did.
    pub fn definition(&self) -> Option<&MapDefinition> {
        self.definition.as_ref()
    }

    /// The texels, and bounds on boxes of them.
    #[inline(always)]
    fn detail(&self) -> &TexelPyramids {
        match self.detail.get() {
            Some(detail) => detail,
            None => self.sampled_now(),
        }
    }

    /// Samples outside the lock: the parallel sampling may run another task on this thread that
    /// needs the same texels.
    #[cold]
    fn sampled_now(&self) -> &TexelPyramids {
        let point = |n| {
            self.definition
                .as_ref()
                .map_or(Vec4::ZERO, |r| finite(r.sample(Self::grid_point(self.size, n))))
        };
        let samples: Vec<Vec4> = (0..self.size.iter().product::<usize>())
            .into_par_iter()
            .map(point)
            .collect();
        let detail = TexelPyramids::of(self.size, stored(&samples, self.scale, self.storage));
        self.detail.get_or_init(|| detail)
    }

    /// Samples texels that only a device has, once, before many threads need them.
    pub fn fetch_texels(&self) {
        self.detail();
    }

    #[inline(always)]
    pub(super) fn texels(&self) -> &[Vec4] {
        flat(&self.detail().texels)
    }

    /// The stored (D / scale, alpha) of a grid point.
    pub fn texel(&self, [i, j, k]: [usize; 3]) -> Vec4 {
        self.detail().texels[[k, j, i]]
    }

    /// D and alpha at map coordinates; from the definition where only a device has the texels.
    pub fn sample_lazily(&self, x: Vec3) -> TexelSample {
        match (self.detail.get(), &self.definition) {
            (None, Some(definition)) => definition.sample(x),
            _ => {
                let t = self.fetch(x);
                TexelSample {
                    displacement: t.xyz() * self.scale,
                    alpha: t.w,
                }
            }
        }
    }

    /// The identity.
    pub fn identity(size: [usize; 3]) -> Self {
        Self::from_fn(size, Storage::F16, |_| TexelSample {
            displacement: Vec3::ZERO,
            alpha: 1.0,
        })
    }

    /// Bounds of (D / scale, alpha) over a box in map coordinates.
    pub fn bounds(&self, low: Vec3, high: Vec3) -> ChannelRange<4> {
        if is_all(low, high) {
            return self.whole.texels;
        }
        let top = Vec3::from(self.size.map(|n| (n - 1) as f32));
        self.detail().pyramid.query(low * top, high * top)
    }

    /// Bounds of the columns of stored D's Jacobian, d (D / scale) / d x, over a box in map
    /// coordinates; a face between cells belongs to both.
    ///
    /// Within a cell each column is a weighted mean of the differences along four of its edges,
    /// hence these bound it.
    pub fn slope_bounds(&self, low: Vec3, high: Vec3) -> [(Vec3, Vec3); 3] {
        let top = Vec3::from(self.size.map(|n| (n - 1) as f32));
        let range = if is_all(low, high) {
            self.whole.slopes
        } else {
            self.detail().slopes.query(low * top, high * top)
        };
        let flat = low.cmplt(Vec3::ZERO).any() || high.cmpgt(Vec3::ONE).any();
        std::array::from_fn(|axis| {
            let of = |v: &[f32; 9]| Vec3::from_slice(&v[3 * axis..3 * axis + 3]);
            let (low, high) = (of(&range.min), of(&range.max));
            // Beyond the cube the outermost texels are clamped.
            if flat {
                (low.min(Vec3::ZERO), high.max(Vec3::ZERO))
            } else {
                (low, high)
            }
        })
    }

    /// A number that maps of another size, with other texels or another scale have, too, only by
    /// chance.
    pub fn digest(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.size.hash(&mut hasher);
        self.scale.to_bits().hash(&mut hasher);
        for texel in self.texels() {
            texel.to_array().map(f32::to_bits).hash(&mut hasher);
        }
        hasher.finish()
    }

    /// Whether D is non-zero anywhere; a map that only cuts moves nothing.
    pub fn has_displacement(&self) -> bool {
        let range = self.whole.texels;
        (0..3).any(|c| range.min[c] != 0.0 || range.max[c] != 0.0)
    }

    /// Whether the mask removes anything.
    pub fn has_cuts(&self) -> bool {
        self.whole.texels.min[3] < 1.0
    }

    /// The texels for upload to the GPU: in the map's own format, or in another one if a device
    /// lacks it.
    pub fn encode_as(&self, storage: Storage) -> Vec<u8> {
        let mut bytes = vec![0; self.texels().len() * storage.bytes()];
        let rows = bytes
            .par_chunks_mut(storage.bytes() << 12)
            .zip(self.texels().par_chunks(1 << 12));
        match storage {
            Storage::F16 => rows.for_each(|(to, from)| encode(to, from, |v| f16::from_f32(v).to_le_bytes())),
            Storage::Snorm16 => {
                rows.for_each(|(to, from)| encode(to, from, |v| ((v * 32767.0).round() as i16).to_le_bytes()))
            }
            Storage::Snorm8 => {
                rows.for_each(|(to, from)| encode(to, from, |v| [(v * 127.0).round() as i8 as u8]))
            }
            Storage::F32 => rows.for_each(|(to, from)| encode(to, from, f32::to_le_bytes)),
        }
        bytes
    }

    /// Stored (D / scale, alpha) at map coordinates inside the unit cube, trilinear.
    #[inline(always)]
    pub fn fetch(&self, x: Vec3) -> Vec4 {
        trilinear(self.texels(), self.size, x * self.top())
    }

    /// [`Self::fetch`] at eight points.
    #[inline(always)]
    pub fn fetch_lanes<S: Simd>(&self, simd: S, x: Vec3x8<S>) -> (Vec3x8<S>, f32x8<S>) {
        let [x, y, z, alpha] = self.fetch_fours(simd, x);
        (Vec3x8 { x, y, z }, alpha)
    }

    #[inline(always)]
    fn fetch_fours<S: Simd>(&self, simd: S, x: Vec3x8<S>) -> Vec4x8<S> {
        let [nx, ny, nz] = self.size;
        if nx < 2 || ny < 2 || nz < 2 {
            let mut texels = [[0.0; 4]; LANES];
            for (n, texel) in texels.iter_mut().enumerate() {
                *texel = self.fetch(x.lane(n)).to_array();
            }
            return columns(simd, &texels);
        }
        let p = Vec3x8 {
            x: x.x * (nx - 1) as f32,
            y: x.y * (ny - 1) as f32,
            z: x.z * (nz - 1) as f32,
        };
        mix_texels(simd, self.texels(), self.size, &Cells::of(p, self.size, 0))
    }

    /// The last texel along each axis.
    #[inline(always)]
    fn top(&self) -> Vec3 {
        Vec3::new(
            (self.size[0] - 1) as f32,
            (self.size[1] - 1) as f32,
            (self.size[2] - 1) as f32,
        )
    }

    /// The texels of a line along the map's x axis at given map coordinates across it, for
    /// [`Self::fetch_line`]; none if the map is flat.
    pub(super) fn line(&self, y: f32, z: f32) -> Option<Vec<Vec4>> {
        let [_, ny, nz] = self.size.map(|n| (n - 1) as f32);
        self.size
            .iter()
            .all(|&n| n > 1)
            .then(|| across(self.texels(), self.size, y * ny, z * nz))
    }

    /// [`Self::fetch_lanes`] at eight points of a line, bit for bit.
    #[inline(always)]
    pub(super) fn fetch_line<S: Simd>(simd: S, line: &[Vec4], x: f32x8<S>) -> (Vec3x8<S>, f32x8<S>) {
        let [x, y, z, alpha] = mix_line(simd, line, x * (line.len() - 1) as f32);
        (Vec3x8 { x, y, z }, alpha)
    }

    /// D and alpha at map coordinates inside the unit cube.
    #[inline(always)]
    pub fn sample(&self, x: Vec3) -> TexelSample {
        let t = self.fetch(x);
        TexelSample {
            displacement: t.xyz() * self.scale,
            alpha: t.w,
        }
    }

    /// Bytes of the texels in the map's own storage.
    pub fn stored_bytes(&self) -> usize {
        self.size.iter().product::<usize>() * self.storage.bytes()
    }
}

/// Whether a box in map coordinates contains the whole cube.
fn is_all(low: Vec3, high: Vec3) -> bool {
    low.cmple(Vec3::ZERO).all() && high.cmpge(Vec3::ONE).all()
}

/// Channels of texels, `N` bytes each.
fn encode<const N: usize>(to: &mut [u8], from: &[Vec4], channel: impl Fn(f32) -> [u8; N]) {
    for (to, from) in to.chunks_exact_mut(4 * N).zip(from) {
        for (to, v) in to.chunks_exact_mut(N).zip(from.to_array()) {
            to.copy_from_slice(&channel(v));
        }
    }
}

/// The smallest and the largest value of each component.
#[inline(always)]
fn extremes(texels: &[Vec4]) -> (Vec4, Vec4) {
    texels
        .iter()
        .fold((Vec4::INFINITY, Vec4::NEG_INFINITY), |(low, high), t| {
            (low.min(*t), high.max(*t))
        })
}

/// The range of the differences of stored D per map unit from the points of a run along x to the
/// next ones along each axis; for the last point of an axis, of the difference to the point before
/// it.
fn slopes_of(
    texels: &[Vec4],
    [nx, ny, nz]: [usize; 3],
    [first, last]: [usize; 2],
    [j, k]: [usize; 2],
) -> ChannelRange<9> {
    let row = |first: usize, last: usize, j: usize, k: usize| &texels[(k * ny + j) * nx..][first..=last];
    let between = |low: &[Vec4], high: &[Vec4], points: usize| {
        let scale = (points - 1) as f32;
        let changes = low.iter().zip(high).map(|(a, b)| (*b - *a) * scale);
        changes.fold((Vec4::INFINITY, Vec4::NEG_INFINITY), |(low, high), d| {
            (low.min(d), high.max(d))
        })
    };
    let mut range = ChannelRange {
        min: [0.0; 9],
        max: [0.0; 9],
    };
    let mut put = |axis: usize, (low, high): (Vec4, Vec4)| {
        range.min[3 * axis..3 * axis + 3].copy_from_slice(&low.to_array()[..3]);
        range.max[3 * axis..3 * axis + 3].copy_from_slice(&high.to_array()[..3]);
    };
    if nx > 1 {
        let (first, last) = (first.min(nx - 2), last.min(nx - 2));
        put(
            0,
            between(row(first, last, j, k), row(first + 1, last + 1, j, k), nx),
        );
    }
    if ny > 1 {
        let j = j.min(ny - 2);
        put(1, between(row(first, last, j, k), row(first, last, j + 1, k), ny));
    }
    if nz > 1 {
        let k = k.min(nz - 2);
        put(2, between(row(first, last, j, k), row(first, last, j, k + 1), nz));
    }
    range
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Mat3;

    fn linear() -> impl Fn(Vec3) -> TexelSample {
        |x| TexelSample {
            displacement: Mat3::from_cols_array(&[0.1, 0.2, -0.1, 0.0, 0.3, 0.1, -0.2, 0.0, 0.25]) * x,
            alpha: x.x,
        }
    }

    #[test]
    fn linear_maps_and_their_jacobians_are_exact_within_the_format() {
        for (storage, tolerance) in [
            (Storage::F16, 5e-4),
            (Storage::Snorm16, 5e-5),
            (Storage::Snorm8, 8e-3),
            (Storage::F32, 2e-6),
        ] {
            let map = DisplacementMap::from_fn([9, 7, 8], storage, linear());
            let x = Vec3::new(0.31, 0.77, 0.05);
            let want = linear()(x);
            let got = map.sample(x);
            assert!(
                got.displacement.abs_diff_eq(want.displacement, tolerance)
                    && (got.alpha - want.alpha).abs() < tolerance,
                "{storage:?}"
            );
            let (j, slope) = map.derivatives(x);
            assert!(
                (j * Vec3::X).abs_diff_eq(Vec3::new(0.1, 0.2, -0.1), 16.0 * tolerance),
                "{storage:?} {j}"
            );
            assert!(slope.abs_diff_eq(Vec3::X, 16.0 * tolerance));
        }
    }

    #[test]
    fn encoding_has_the_size_it_says_and_keeps_the_values() {
        for storage in [Storage::F16, Storage::Snorm16, Storage::Snorm8, Storage::F32] {
            let map = DisplacementMap::from_fn([3, 4, 5], storage, linear());
            assert_eq!(map.encode_as(storage).len(), map.stored_bytes());
        }
        let map = DisplacementMap::from_fn([2, 2, 2], Storage::Snorm8, linear());
        assert_eq!(
            map.encode_as(Storage::Snorm8)[7] as i8,
            127,
            "alpha of the second texel is 1"
        );
    }

    #[test]
    fn values_that_are_not_finite_become_empty() {
        let map = DisplacementMap::from_fn([2, 2, 2], Storage::F16, |_| TexelSample {
            displacement: Vec3::NAN,
            alpha: 1.0,
        });
        assert_eq!(
            map.sample(Vec3::splat(0.5)),
            TexelSample {
                displacement: Vec3::ZERO,
                alpha: 0.0
            }
        );
    }

    /// The derivatives from 32 texels equal those from six samples, everywhere in the cube.
    #[test]
    fn derivatives_are_differences_of_samples() {
        let map = DisplacementMap::from_fn([7, 4, 6], Storage::F32, |x| TexelSample {
            displacement: Vec3::new((7.0 * x.y).sin(), x.x * x.z, (5.0 * x.x + x.z).cos()) * 0.1,
            alpha: x.x * x.y,
        });
        for n in 0..1000usize {
            let x = Vec3::new((n % 10) as f32, (n / 10 % 10) as f32, (n / 100) as f32) / 9.0;
            let (jacobian, slope) = map.derivatives(x);
            for axis in 0..3 {
                let step = 1.0 / (map.size[axis] - 1) as f32;
                let (mut low, mut high) = (x, x);
                low[axis] = (x[axis] - step).clamp(0.0, 1.0 - step);
                high[axis] = (x[axis] + step).clamp(step, 1.0);
                let d = (map.fetch(high) - map.fetch(low)) / (high[axis] - low[axis]);
                assert!(
                    jacobian.col(axis).abs_diff_eq(d.xyz() * map.scale, 2e-5)
                        && (slope[axis] - d.w).abs() < 2e-5,
                    "{x} along {axis}"
                );
            }
        }
    }
}
