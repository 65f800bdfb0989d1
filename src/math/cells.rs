//! Trilinear interpolation of texels with four components, at eight points at once.
//!
//! *Theory*: two neighbouring texels of a row fill one register. A cell is four such rows. They are
//! interpolated along the second and third axis as they are loaded and along the first at the end,
//! all four components together; only then are the results of the eight points transposed into
//! lanes. Gathering corner by corner would take as many loads for one component as this takes for
//! four.

use super::lanes::*;
use glam::{Vec3, Vec4};

/// The cells that contain eight points.
#[derive(Clone, Copy)]
pub struct Cells<S: Simd> {
    /// Flat index of each cell's lowest corner.
    pub base: [usize; LANES],
    /// Position within the cell.
    pub f: Vec3x8<S>,
}

/// Cells along an axis and positions within them, at least `margin` cells away from the ends.
#[inline(always)]
fn along<S: Simd>(x: f32x8<S>, points: usize, margin: i32) -> (i32x8<S>, f32x8<S>) {
    let x = x.max(0.0).min((points - 1) as f32);
    // x is not negative: truncation equals floor. A NaN coordinate must not leave the grid either.
    let cell = x.to_int::<i32x8<S>>().max(margin).min(points as i32 - 2 - margin);
    (cell, x - cell.to_float::<f32x8<S>>())
}

impl<S: Simd> Cells<S> {
    /// The cells of points of a grid of at least 2 + 2 `margin` points along every axis, at least
    /// `margin` cells away from its faces; points outside the grid are clamped to it.
    #[inline(always)]
    pub fn of(p: Vec3x8<S>, [nx, ny, nz]: [usize; 3], margin: i32) -> Self {
        let ((i, x), (j, y), (k, z)) = (
            along(p.x, nx, margin),
            along(p.y, ny, margin),
            along(p.z, nz, margin),
        );
        Self {
            base: flat(i, j, k, [nx, ny, nz]),
            f: Vec3x8 { x, y, z },
        }
    }
}

/// Steps from a point of a grid to the next one along its second and third axis, in points.
#[derive(Clone, Copy, Debug)]
pub struct Strides {
    /// Along the second axis.
    pub up: usize,
    /// Along the third axis.
    pub on: usize,
}

impl Strides {
    /// Larger than the number of points in a slice of any grid.
    const MAX_POINTS_PER_SLICE: usize = usize::MAX >> 4;

    /// The strides of a grid of at least two points along every axis, x fastest. The mask changes
    /// nothing, and one stride is computed as the sum of the other and the rest, so that the
    /// compiler knows that their sums do not overflow and which one is larger: one bounds check of
    /// a cell then covers all its rows.
    #[inline(always)]
    pub fn of([nx, ny, _]: [usize; 3]) -> Self {
        let up = nx & Self::MAX_POINTS_PER_SLICE;
        Self {
            up,
            on: up + ((nx * (ny - 1)) & Self::MAX_POINTS_PER_SLICE),
        }
    }

    /// The points of a grid around a cell, from the one before its lowest corner along every axis
    /// to the one after its highest.
    #[inline(always)]
    pub fn around<T>(self, points: &[T], base: usize) -> &[T] {
        let Self { up, on } = self;
        &points[base.saturating_sub(on + up + 1)..][..3 * on + 2 * up + 3]
    }

    /// Starts of the rows in [`Self::around`]: the four rows of the cell, from the point before it;
    /// along the second axis those below and above the near face, and the far face, from the cell
    /// on; along the third axis the low and the high one in front of the cell, and behind it, from
    /// the cell on.
    #[inline(always)]
    pub fn rows_around(self) -> [[usize; 4]; 3] {
        let Self { up, on } = self;
        [
            [on + up, on + 2 * up, 2 * on + up, 2 * on + 2 * up],
            [on + 1, on + 3 * up + 1, 2 * on + 1, 2 * on + 3 * up + 1],
            [up + 1, 2 * up + 1, 3 * on + up + 1, 3 * on + 2 * up + 1],
        ]
    }

    /// The points of a grid that span a cell, from its lowest corner to its highest.
    #[inline(always)]
    pub fn cell<T>(self, points: &[T], base: usize) -> &[T] {
        &points[base..][..self.on + self.up + 2]
    }
}

/// Flat indices of points of a grid, x fastest.
#[inline(always)]
pub fn flat<S: Simd>(i: i32x8<S>, j: i32x8<S>, k: i32x8<S>, [nx, ny, nz]: [usize; 3]) -> [usize; LANES] {
    let mut all = [0; LANES];
    if nx * ny * nz <= i32::MAX as usize {
        let index = (k * ny as i32 + j) * nx as i32 + i;
        for n in 0..LANES {
            all[n] = index[n] as usize;
        }
    } else {
        for n in 0..LANES {
            all[n] = (k[n] as usize * ny + j[n] as usize) * nx + i[n] as usize;
        }
    }
    all
}

/// `a` at 0, `b` at 1.
#[inline(always)]
pub fn mix<S: Simd>(a: f32x8<S>, b: f32x8<S>, t: f32x8<S>) -> f32x8<S> {
    (b - a).mul_add(t, a)
}

/// Interpolates the rows of a cell (near low, near high, far low, far high) in the order of
/// [`mix_texels`]: the second axis, the third, the first.
#[inline(always)]
pub fn mix_rows<S: Simd>([a, b, c, d]: [[f32x8<S>; 2]; 4], f: Vec3x8<S>) -> f32x8<S> {
    let low = mix(mix(a[0], b[0], f.y), mix(c[0], d[0], f.y), f.z);
    let high = mix(mix(a[1], b[1], f.y), mix(c[1], d[1], f.y), f.z);
    mix(low, high, f.x)
}

/// Four numbers at eight points.
pub type Vec4x8<S> = [f32x8<S>; 4];

/// Texels of four components.
pub trait Texel: Copy {
    /// Two texels as numbers.
    fn pair<S: Simd>(simd: S, texels: [Self; 2]) -> f32x8<S>;

    /// A texel and the next one as numbers.
    #[inline(always)]
    fn pair_at<S: Simd>(simd: S, texels: &[Self], at: usize) -> f32x8<S> {
        // One bounds check, and one load for both.
        let pair = &texels[at..at + 2];
        Self::pair(simd, [pair[0], pair[1]])
    }
}

impl Texel for [i16; 4] {
    #[inline(always)]
    fn pair<S: Simd>(simd: S, [[a, b, c, d], [e, f, g, h]]: [Self; 2]) -> f32x8<S> {
        let eight = i16x8::load_array(simd, [a, b, c, d, e, f, g, h]);
        // Widening sixteen and taking half costs one instruction; widening eight costs three.
        simd.widen_i16x16(simd.combine_i16x8(eight, eight)).0.to_float()
    }
}

impl Texel for Vec3 {
    #[inline(always)]
    fn pair<S: Simd>(simd: S, [a, b]: [Self; 2]) -> f32x8<S> {
        f32x8::load_array(simd, [a.x, a.y, a.z, 0.0, b.x, b.y, b.z, 0.0])
    }
}

impl Texel for Vec4 {
    #[inline(always)]
    fn pair<S: Simd>(simd: S, [low, high]: [Self; 2]) -> f32x8<S> {
        simd.combine_f32x4(
            f32x4::load_array(simd, low.to_array()),
            f32x4::load_array(simd, high.to_array()),
        )
    }
}

/// The four components in eight cells of a grid of texels, x fastest.
#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "lanes have numbers")]
pub fn mix_texels<S: Simd, T: Texel>(simd: S, texels: &[T], size: [usize; 3], cells: &Cells<S>) -> Vec4x8<S> {
    let strides = Strides::of(size);
    let Strides { up, on } = strides;
    let mut mixed = [[0.0; 4]; LANES];
    for n in 0..LANES {
        let cell = strides.cell(texels, cells.base[n]);
        let (y, z) = (f32x8::splat(simd, cells.f.y[n]), f32x8::splat(simd, cells.f.z[n]));
        let near = mix(T::pair_at(simd, cell, 0), T::pair_at(simd, cell, up), y);
        let far = mix(T::pair_at(simd, cell, on), T::pair_at(simd, cell, on + up), y);
        let (low, high) = simd.split_f32x8(mix(near, far, z));
        mixed[n] = *((high - low).mul_add(f32x4::splat(simd, cells.f.x[n]), low));
    }
    columns(simd, &mixed)
}

/// As [`mix_texels`], from texels already interpolated along the second and third axis
/// ([`across`]), at eight points along the first.
#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "lanes have numbers")]
pub fn mix_line<S: Simd>(simd: S, line: &[Vec4], x: f32x8<S>) -> Vec4x8<S> {
    let (cell, x) = along(x, line.len(), 0);
    let mut mixed = [[0.0; 4]; LANES];
    for n in 0..LANES {
        let (low, high) = simd.split_f32x8(Vec4::pair_at(simd, line, cell[n] as usize));
        mixed[n] = *((high - low).mul_add(f32x4::splat(simd, x[n]), low));
    }
    columns(simd, &mixed)
}

/// The texels of a line along the first axis of a grid, x fastest, at coordinates along the other
/// two: the values that [`mix_texels`] interpolates along the first axis at the end, bit for bit.
pub fn across(texels: &[Vec4], [nx, ny, nz]: [usize; 3], y: f32, z: f32) -> Vec<Vec4> {
    let cell = |x: f32, points: usize| {
        let x = x.max(0.0).min((points - 1) as f32);
        let cell = (x as usize).min(points - 2);
        (cell, x - cell as f32)
    };
    let ((j, y), (k, z)) = (cell(y, ny), cell(z, nz));
    let row = |j: usize, k: usize| &texels[(k * ny + j) * nx..][..nx];
    let rows = [row(j, k), row(j + 1, k), row(j, k + 1), row(j + 1, k + 1)];
    let mut line = vec![Vec4::ZERO; nx];
    with_simd(Across {
        rows,
        y,
        z,
        line: &mut line,
    });
    line
}

/// Four rows of texels, their weights along y and z, and the interpolated row.
struct Across<'a> {
    rows: [&'a [Vec4]; 4],
    y: f32,
    z: f32,
    line: &'a mut [Vec4],
}

impl SimdKernel for Across<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let [a, b, c, d] = self.rows;
        let (y, z) = (f32x4::splat(simd, self.y), f32x4::splat(simd, self.z));
        for (to, (((a, b), c), d)) in self.line.iter_mut().zip(a.iter().zip(b).zip(c).zip(d)) {
            let (a, b) = (
                f32x4::load_array(simd, a.to_array()),
                f32x4::load_array(simd, b.to_array()),
            );
            let (c, d) = (
                f32x4::load_array(simd, c.to_array()),
                f32x4::load_array(simd, d.to_array()),
            );
            let (near, far) = ((b - a).mul_add(y, a), (d - c).mul_add(y, c));
            *to = (far - near).mul_add(z, near).to_array().into();
        }
    }
}

/// The first three components of [`mix_texels`] as vectors, and their derivatives along the three
/// axes, per cell.
#[inline(always)]
pub fn mix_with_slopes<S: Simd, T: Texel>(
    simd: S,
    texels: &[T],
    size: [usize; 3],
    cells: &Cells<S>,
) -> (Vec3x8<S>, [Vec3x8<S>; 3]) {
    let strides = Strides::of(size);
    let Strides { up, on } = strides;
    let mut value = [[0.0; 4]; LANES];
    let (mut dx, mut dy, mut dz) = (value, value, value);
    for n in 0..LANES {
        let cell = strides.cell(texels, cells.base[n]);
        let (y, z) = (f32x8::splat(simd, cells.f.y[n]), f32x8::splat(simd, cells.f.z[n]));
        let x = f32x4::splat(simd, cells.f.x[n]);
        let near = T::pair_at(simd, cell, 0);
        let near_slope = T::pair_at(simd, cell, up) - near;
        let far = T::pair_at(simd, cell, on);
        let far_slope = T::pair_at(simd, cell, on + up) - far;
        let near = near_slope.mul_add(y, near);
        let along_z = far_slope.mul_add(y, far) - near;
        let (low, high) = simd.split_f32x8(along_z.mul_add(z, near));
        value[n] = *((high - low).mul_add(x, low));
        dx[n] = *(high - low);
        let (low, high) = simd.split_f32x8(mix(near_slope, far_slope, z));
        dy[n] = *((high - low).mul_add(x, low));
        let (low, high) = simd.split_f32x8(along_z);
        dz[n] = *((high - low).mul_add(x, low));
    }
    (
        vectors(simd, &value),
        [vectors(simd, &dx), vectors(simd, &dy), vectors(simd, &dz)],
    )
}

/// [`mix_texels`], and the central differences f(+1) - f(-1) along the three axes: those at the
/// cells' corners, interpolated as the values are. Every cell must have a texel on every side.
#[inline(always)]
pub fn mix_with_differences<S: Simd, T: Texel>(
    simd: S,
    texels: &[T],
    size: [usize; 3],
    cells: &Cells<S>,
) -> [Vec4x8<S>; 4] {
    let strides = Strides::of(size);
    let Strides { up, on } = strides;
    let a = on + up + 1;
    let (b, c, d) = (a + up, a + on, a + on + up);
    let (mut value, mut dx) = ([[0.0; 4]; LANES], [[0.0; 4]; LANES]);
    let (mut dy, mut dz) = (value, value);
    for n in 0..LANES {
        let texels = strides.around(texels, cells.base[n]);
        let (y, z) = (f32x8::splat(simd, cells.f.y[n]), f32x8::splat(simd, cells.f.z[n]));
        let x = f32x4::splat(simd, cells.f.x[n]);
        let corners = [
            T::pair_at(simd, texels, a),
            T::pair_at(simd, texels, b),
            T::pair_at(simd, texels, c),
            T::pair_at(simd, texels, d),
        ];
        value[n] = mix_cell(simd, corners, x, y, z);
        let across = [
            T::pair_at(simd, texels, a + 1) - T::pair_at(simd, texels, on + up),
            T::pair_at(simd, texels, b + 1) - T::pair_at(simd, texels, on + 2 * up),
            T::pair_at(simd, texels, c + 1) - T::pair_at(simd, texels, 2 * on + up),
            T::pair_at(simd, texels, d + 1) - T::pair_at(simd, texels, 2 * on + 2 * up),
        ];
        dx[n] = mix_cell(simd, across, x, y, z);
        let upwards = [
            corners[1] - T::pair_at(simd, texels, on + 1),
            T::pair_at(simd, texels, b + up) - corners[0],
            corners[3] - T::pair_at(simd, texels, 2 * on + 1),
            T::pair_at(simd, texels, d + up) - corners[2],
        ];
        dy[n] = mix_cell(simd, upwards, x, y, z);
        let onwards = [
            corners[2] - T::pair_at(simd, texels, up + 1),
            corners[3] - T::pair_at(simd, texels, 2 * up + 1),
            T::pair_at(simd, texels, c + on) - corners[0],
            T::pair_at(simd, texels, d + on) - corners[1],
        ];
        dz[n] = mix_cell(simd, onwards, x, y, z);
    }
    [
        columns(simd, &value),
        columns(simd, &dx),
        columns(simd, &dy),
        columns(simd, &dz),
    ]
}

/// Interpolates one cell, whose corners fill registers in pairs.
#[inline(always)]
fn mix_cell<S: Simd>(
    simd: S,
    [a, b, c, d]: [f32x8<S>; 4],
    x: f32x4<S>,
    y: f32x8<S>,
    z: f32x8<S>,
) -> [f32; 4] {
    let (low, high) = simd.split_f32x8(mix(mix(a, b, y), mix(c, d, y), z));
    *((high - low).mul_add(x, low))
}

/// The first three columns of a matrix of eight rows.
#[inline(always)]
fn vectors<S: Simd>(simd: S, rows: &[[f32; 4]; LANES]) -> Vec3x8<S> {
    let [x, y, z, _] = columns(simd, rows);
    Vec3x8 { x, y, z }
}

/// The columns of a matrix of eight rows.
#[inline(always)]
pub fn columns<S: Simd>(simd: S, rows: &[[f32; 4]; LANES]) -> [f32x8<S>; 4] {
    let [a0, a1, a2, a3] = columns_of_four(simd, [rows[0], rows[1], rows[2], rows[3]]);
    let [b0, b1, b2, b3] = columns_of_four(simd, [rows[4], rows[5], rows[6], rows[7]]);
    [
        simd.combine_f32x4(a0, b0),
        simd.combine_f32x4(a1, b1),
        simd.combine_f32x4(a2, b2),
        simd.combine_f32x4(a3, b3),
    ]
}

/// The columns of a matrix of four rows.
#[inline(always)]
fn columns_of_four<S: Simd>(simd: S, [a, b, c, d]: [[f32; 4]; 4]) -> [f32x4<S>; 4] {
    let (a, b, c, d) = (
        f32x4::load_array(simd, a),
        f32x4::load_array(simd, b),
        f32x4::load_array(simd, c),
        f32x4::load_array(simd, d),
    );
    let (ac, ac_high) = (simd.zip_low_f32x4(a, c), simd.zip_high_f32x4(a, c));
    let (bd, bd_high) = (simd.zip_low_f32x4(b, d), simd.zip_high_f32x4(b, d));
    [
        simd.zip_low_f32x4(ac, bd),
        simd.zip_high_f32x4(ac, bd),
        simd.zip_low_f32x4(ac_high, bd_high),
        simd.zip_high_f32x4(ac_high, bd_high),
    ]
}
