//! Eight trilinear samples, or eight gradients, at once.
//!
//! *Theory*: the cost of a sample is its loads. The two voxels of a row are adjacent and are loaded
//! as one word. A gradient needs 32 of the 64 voxels around a point, not the 48 of six samples: the
//! differences on both sides are interpolated with the point's fraction. Where differences are
//! stored ([`GradientVolume`](super::GradientVolume)) it needs 8 texels. Each lane checks once that
//! its cell lies in the volume, not for each of its rows ([`Strides`]).
//!
//! *How to call it*: as [`VolumeSampler::sample`] and [`VolumeSampler::gradient`], whose values
//! these equal up to rounding.

use super::function::VolumeFunction;
use super::grid::Neighborhood;
use super::sampler::{VoxelSlice, with_voxels};
use super::{GradientFilter, VolumeSampler, Voxel};
use crate::math::cells::{Cells, Strides, mix_rows, mix_texels};
use crate::math::lanes::*;
use prefetch_index::prefetch_index;

impl VolumeSampler<'_> {
    /// Whether every axis has at least `n` voxels.
    #[inline(always)]
    fn is_at_least(&self, n: usize) -> bool {
        self.size.iter().all(|&m| m >= n)
    }

    /// Normalised values at eight positions in voxels.
    #[inline(always)]
    pub fn sample_lanes<S: Simd>(&self, simd: S, p: Vec3x8<S>) -> f32x8<S> {
        if let Some(function) = self.function {
            let points: [glam::Vec3; LANES] = std::array::from_fn(|n| p.lane(n));
            return f32x8::load_array(simd, function.values(&points));
        }
        if !self.is_at_least(2) {
            let mut values = [0.0; LANES];
            for (n, value) in values.iter_mut().enumerate() {
                *value = self.sample(p.lane(n));
            }
            return f32x8::load_array(simd, values);
        }
        let Cells { base, f } = Cells::of(p, self.size, 0);
        let strides = Strides::of(self.size);
        let rows = with_voxels!(self.voxels, v => Voxel::cells(simd, v, &base, strides));
        mix_rows(rows, f).mul_add(self.scale, self.offset)
    }

    /// Normalised values at eight positions in voxels, and the differences f(+1) - f(-1) of stored
    /// values if those are stored: the input of [`Self::gradient_of`].
    #[inline(always)]
    pub fn sample_with_differences<S: Simd>(&self, simd: S, p: Vec3x8<S>) -> (f32x8<S>, Vec3x8<S>) {
        match self.texels {
            Some(texels) if self.is_at_least(2) => {
                let [value, x, y, z] = mix_texels(simd, texels, self.size, &Cells::of(p, self.size, 0));
                (value.mul_add(self.scale, self.offset), Vec3x8 { x, y, z })
            }
            _ => (self.sample_lanes(simd, p), Vec3x8::splat(simd, glam::Vec3::ZERO)),
        }
    }

    /// Prefetches the texels that [`Self::sample_with_differences`] will read at eight neighbouring
    /// positions, four in each of two rows: those around the positions at the corners, between
    /// which little else lies.
    #[inline(always)]
    pub fn prefetch<S: Simd>(&self, p: Vec3x8<S>) {
        if let Some(texels) = self.texels
            && self.is_at_least(2)
        {
            let Strides { up, on } = Strides::of(self.size);
            let base = Cells::of(p, self.size, 0).base;
            for n in [0, 3, 4, 7] {
                for row in [0, up, on, on + up] {
                    prefetch_index(texels, base[n] + row);
                }
            }
        }
    }

    /// Gradients of the normalised value per voxel along i, j, k at eight positions in voxels; only
    /// those in `lanes` (a bit each) are needed.
    #[inline(always)]
    pub fn gradient_lanes<S: Simd>(
        &self,
        simd: S,
        p: Vec3x8<S>,
        filter: GradientFilter,
        lanes: u64,
    ) -> Vec3x8<S> {
        if let Some(function) = self.function
            && filter == GradientFilter::Central
        {
            return function.differences(simd, p);
        }
        if filter == GradientFilter::Central && self.is_at_least(4) {
            return self.gradient_of(
                simd,
                p,
                self.differences_between(simd, &Cells::of(p, self.size, 1)),
                lanes,
            );
        }
        let mut all = Vec3x8::splat(simd, glam::Vec3::ZERO);
        for n in lanes_of(lanes) {
            all.set(n, self.gradient(p.lane(n), filter));
        }
        all
    }

    /// Gradients by central differences, as [`Self::gradient_lanes`], from the result of
    /// [`Self::sample_with_differences`].
    #[inline(always)]
    pub fn gradient_of<S: Simd>(
        &self,
        simd: S,
        p: Vec3x8<S>,
        differences: Vec3x8<S>,
        lanes: u64,
    ) -> Vec3x8<S> {
        let mut all = differences * f32x8::splat(simd, 0.5 * self.scale);
        // Near the grid's faces a difference is taken at the face, as with a clamped texture.
        let (x, y, z) = (
            beyond(p.x, self.top.x),
            beyond(p.y, self.top.y),
            beyond(p.z, self.top.z),
        );
        for n in lanes_of(lanes & (x | y | z).to_bitmask()) {
            all.set(n, self.gradient(p.lane(n), GradientFilter::Central));
        }
        all
    }

    /// Differences f(+1) - f(-1) of stored values in cells with a voxel on every side. They are
    /// computed at the corners, where those of integers are exact, and then interpolated by the
    /// same operations as stored differences.
    #[inline(always)]
    fn differences_between<S: Simd>(&self, simd: S, cells: &Cells<S>) -> Vec3x8<S> {
        let Neighborhood {
            rows: [a, b, c, d],
            neighbors_y,
            neighbors_z,
        } = with_voxels!(self.voxels, v => Voxel::around(simd, v, &cells.base, Strides::of(self.size)));
        let x = mix_rows([across(a), across(b), across(c), across(d)], cells.f);
        let [below, above, below_on, above_on] = neighbors_y;
        let y = mix_rows(
            [
                between(below, [b[1], b[2]]),
                between([a[1], a[2]], above),
                between(below_on, [d[1], d[2]]),
                between([c[1], c[2]], above_on),
            ],
            cells.f,
        );
        let [front, front_up, behind, behind_up] = neighbors_z;
        let z = mix_rows(
            [
                between(front, [c[1], c[2]]),
                between(front_up, [d[1], d[2]]),
                between([a[1], a[2]], behind),
                between([b[1], b[2]], behind_up),
            ],
            cells.f,
        );
        Vec3x8 { x, y, z }
    }
}

impl VolumeFunction {
    /// Gradients of the normalised value per voxel along i, j, k by central differences, at eight
    /// positions in voxels.
    fn differences<S: Simd>(&self, simd: S, p: Vec3x8<S>) -> Vec3x8<S> {
        const AXES: [glam::Vec3; 3] = glam::Vec3::AXES;
        let mut points = [glam::Vec3::ZERO; 6 * LANES];
        for n in 0..LANES {
            for (axis, step) in AXES.into_iter().enumerate() {
                points[2 * axis * LANES + n] = p.lane(n) + step;
                points[(2 * axis + 1) * LANES + n] = p.lane(n) - step;
            }
        }
        let values = self.values(&points);
        let along = |axis: usize| {
            let from = 2 * axis * LANES;
            f32x8::load_array(
                simd,
                std::array::from_fn(|n| 0.5 * (values[from + n] - values[from + LANES + n])),
            )
        };
        Vec3x8 {
            x: along(0),
            y: along(1),
            z: along(2),
        }
    }
}

/// The differences at the two middle ones of four neighbours along a row.
#[inline(always)]
fn across<S: Simd>(row: [f32x8<S>; 4]) -> [f32x8<S>; 2] {
    [row[2] - row[0], row[3] - row[1]]
}

/// Differences between two rows.
#[inline(always)]
fn between<S: Simd>(before: [f32x8<S>; 2], after: [f32x8<S>; 2]) -> [f32x8<S>; 2] {
    [after[0] - before[0], after[1] - before[1]]
}

/// Whether one of the voxels on both sides of a coordinate's cell lies outside the grid.
#[inline(always)]
fn beyond<S: Simd>(x: f32x8<S>, top: f32) -> mask32x8<S> {
    x.simd_lt(1.0) | x.simd_ge(top - 1.0)
}

/// The two halves of a word as 16-bit integers, the lower one first.
#[inline(always)]
fn halves<S: Simd>(words: i32x8<S>, signed: bool) -> [f32x8<S>; 2] {
    let low = if signed {
        (words << 16) >> 16
    } else {
        words & 0xffff
    };
    let high = if signed {
        words >> 16
    } else {
        (words >> 16) & 0xffff
    };
    [low.to_float(), high.to_float()]
}

/// Integers of which two neighbours form one word.
trait I16Pairs: Voxel {
    /// Two neighbours.
    fn word(pair: [Self; 2]) -> i32;

    /// The lower and the higher integer of each of eight words.
    fn halves<S: Simd>(words: i32x8<S>) -> [f32x8<S>; 2];
}

/// A voxel and the next one.
#[inline(always)]
fn word_at<T: I16Pairs>(voxels: &[T], at: usize) -> i32 {
    // One bounds check, and one load for both.
    let pair = &voxels[at..at + 2];
    T::word([pair[0], pair[1]])
}

/// [`Voxel::around`].
#[inline(always)]
fn around_of_words<S: Simd, T: I16Pairs>(
    simd: S,
    voxels: &[T],
    base: &[usize; LANES],
    strides: Strides,
) -> Neighborhood<S> {
    let [own, along_y, along_z] = strides.rows_around();
    let (mut front, mut back) = ([[0; LANES]; 4], [[0; LANES]; 4]);
    let (mut neighbors_y, mut neighbors_z) = ([[0; LANES]; 4], [[0; LANES]; 4]);
    for n in 0..LANES {
        let v = strides.around(voxels, base[n]);
        for (row, at) in own.into_iter().enumerate() {
            let four = &v[at..at + 4];
            front[row][n] = T::word([four[0], four[1]]);
            back[row][n] = T::word([four[2], four[3]]);
        }
        for (row, at) in along_y.into_iter().enumerate() {
            neighbors_y[row][n] = word_at(v, at);
        }
        for (row, at) in along_z.into_iter().enumerate() {
            neighbors_z[row][n] = word_at(v, at);
        }
    }
    Neighborhood {
        rows: [
            quads::<S, T>(simd, front[0], back[0]),
            quads::<S, T>(simd, front[1], back[1]),
            quads::<S, T>(simd, front[2], back[2]),
            quads::<S, T>(simd, front[3], back[3]),
        ],
        neighbors_y: four_pairs::<S, T>(simd, neighbors_y),
        neighbors_z: four_pairs::<S, T>(simd, neighbors_z),
    }
}

#[inline(always)]
fn quads<S: Simd, T: I16Pairs>(simd: S, front: [i32; LANES], back: [i32; LANES]) -> [f32x8<S>; 4] {
    let ([a, b], [c, d]) = (
        T::halves(i32x8::load_array(simd, front)),
        T::halves(i32x8::load_array(simd, back)),
    );
    [a, b, c, d]
}

#[inline(always)]
fn four_pairs<S: Simd, T: I16Pairs>(simd: S, [a, b, c, d]: [[i32; LANES]; 4]) -> [[f32x8<S>; 2]; 4] {
    [
        T::halves(i32x8::load_array(simd, a)),
        T::halves(i32x8::load_array(simd, b)),
        T::halves(i32x8::load_array(simd, c)),
        T::halves(i32x8::load_array(simd, d)),
    ]
}

/// [`Voxel::cells`].
#[inline(always)]
fn cells_of_words<S: Simd, T: I16Pairs>(
    simd: S,
    voxels: &[T],
    base: &[usize; LANES],
    strides: Strides,
) -> [[f32x8<S>; 2]; 4] {
    let Strides { up, on } = strides;
    let mut words = [[0; LANES]; 4];
    for n in 0..LANES {
        let cell = strides.cell(voxels, base[n]);
        words[0][n] = word_at(cell, 0);
        words[1][n] = word_at(cell, up);
        words[2][n] = word_at(cell, on);
        words[3][n] = word_at(cell, on + up);
    }
    four_pairs::<S, T>(simd, words)
}

impl I16Pairs for u8 {
    #[inline(always)]
    fn word(pair: [Self; 2]) -> i32 {
        i32::from(u16::from_le_bytes(pair))
    }

    #[inline(always)]
    fn halves<S: Simd>(words: i32x8<S>) -> [f32x8<S>; 2] {
        [(words & 255).to_float(), (words >> 8).to_float()]
    }
}

impl Voxel for u8 {
    #[inline(always)]
    fn to_f32(self) -> f32 {
        f32::from(self)
    }

    #[inline(always)]
    fn cells<S: Simd>(
        simd: S,
        voxels: &[Self],
        base: &[usize; LANES],
        strides: Strides,
    ) -> [[f32x8<S>; 2]; 4] {
        cells_of_words(simd, voxels, base, strides)
    }

    #[inline(always)]
    fn around<S: Simd>(simd: S, voxels: &[Self], base: &[usize; LANES], strides: Strides) -> Neighborhood<S> {
        around_of_words(simd, voxels, base, strides)
    }
}

macro_rules! of_16_bits {
    ($t:ty, $signed:literal) => {
        impl I16Pairs for $t {
            #[inline(always)]
            fn word([low, high]: [Self; 2]) -> i32 {
                let ([a, b], [c, d]) = (low.to_le_bytes(), high.to_le_bytes());
                i32::from_le_bytes([a, b, c, d])
            }

            #[inline(always)]
            fn halves<S: Simd>(words: i32x8<S>) -> [f32x8<S>; 2] {
                halves(words, $signed)
            }
        }

        impl Voxel for $t {
            #[inline(always)]
            fn to_f32(self) -> f32 {
                f32::from(self)
            }

            #[inline(always)]
            fn cells<S: Simd>(
                simd: S,
                voxels: &[Self],
                base: &[usize; LANES],
                strides: Strides,
            ) -> [[f32x8<S>; 2]; 4] {
                cells_of_words(simd, voxels, base, strides)
            }

            #[inline(always)]
            fn around<S: Simd>(
                simd: S,
                voxels: &[Self],
                base: &[usize; LANES],
                strides: Strides,
            ) -> Neighborhood<S> {
                around_of_words(simd, voxels, base, strides)
            }
        }
    };
}
of_16_bits!(u16, false);
of_16_bits!(i16, true);

impl Voxel for f32 {
    #[inline(always)]
    fn to_f32(self) -> f32 {
        self
    }

    #[inline(always)]
    fn cells<S: Simd>(
        simd: S,
        voxels: &[Self],
        base: &[usize; LANES],
        strides: Strides,
    ) -> [[f32x8<S>; 2]; 4] {
        let Strides { up, on } = strides;
        let (mut low, mut high) = ([[0.0; LANES]; 4], [[0.0; LANES]; 4]);
        for n in 0..LANES {
            let cell = strides.cell(voxels, base[n]);
            (low[0][n], high[0][n]) = (cell[0], cell[1]);
            (low[1][n], high[1][n]) = (cell[up], cell[up + 1]);
            (low[2][n], high[2][n]) = (cell[on], cell[on + 1]);
            (low[3][n], high[3][n]) = (cell[on + up], cell[on + up + 1]);
        }
        let ([a, b, c, d], [e, f, g, h]) = (low, high);
        [
            [f32x8::load_array(simd, a), f32x8::load_array(simd, e)],
            [f32x8::load_array(simd, b), f32x8::load_array(simd, f)],
            [f32x8::load_array(simd, c), f32x8::load_array(simd, g)],
            [f32x8::load_array(simd, d), f32x8::load_array(simd, h)],
        ]
    }

    #[inline(always)]
    fn around<S: Simd>(simd: S, voxels: &[Self], base: &[usize; LANES], strides: Strides) -> Neighborhood<S> {
        let [own, along_y, along_z] = strides.rows_around();
        let (mut rows, mut neighbors_y, mut neighbors_z) = (
            [[[0.0; LANES]; 4]; 4],
            [[[0.0; LANES]; 2]; 4],
            [[[0.0; LANES]; 2]; 4],
        );
        for n in 0..LANES {
            let v = strides.around(voxels, base[n]);
            for (row, at) in own.into_iter().enumerate() {
                let four = &v[at..at + 4];
                (0..4).for_each(|i| rows[row][i][n] = four[i]);
            }
            for (row, at) in along_y.into_iter().enumerate() {
                let two = &v[at..at + 2];
                (0..2).for_each(|i| neighbors_y[row][i][n] = two[i]);
            }
            for (row, at) in along_z.into_iter().enumerate() {
                let two = &v[at..at + 2];
                (0..2).for_each(|i| neighbors_z[row][i][n] = two[i]);
            }
        }
        let ([a, b, c, d], y, z) = (rows, neighbors_y, neighbors_z);
        Neighborhood {
            rows: [loaded(simd, a), loaded(simd, b), loaded(simd, c), loaded(simd, d)],
            neighbors_y: [
                loaded(simd, y[0]),
                loaded(simd, y[1]),
                loaded(simd, y[2]),
                loaded(simd, y[3]),
            ],
            neighbors_z: [
                loaded(simd, z[0]),
                loaded(simd, z[1]),
                loaded(simd, z[2]),
                loaded(simd, z[3]),
            ],
        }
    }
}

#[inline(always)]
fn loaded<S: Simd, const N: usize>(simd: S, numbers: [[f32; LANES]; N]) -> [f32x8<S>; N] {
    let mut all = [f32x8::splat(simd, 0.0); N];
    for (all, numbers) in all.iter_mut().zip(numbers) {
        *all = f32x8::load_array(simd, numbers);
    }
    all
}
