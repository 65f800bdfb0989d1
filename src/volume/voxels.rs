//! Arrays in the type in which a file stores them.

use crate::math::flat;
use ndarray::{ArcArray, Array, ArrayView, Axis, Dimension, IntoDimension, Ix1, Ix3, Zip};
use rayon::prelude::*;

/// An array of one of the ten scalar types of image files, in standard layout (the last axis is
/// fastest). Clones share the values.
#[derive(Clone, Debug)]
#[allow(missing_docs, reason = "the variants are the Rust types")]
pub enum TypedArray<D: Dimension> {
    U8(ArcArray<u8, D>),
    I8(ArcArray<i8, D>),
    U16(ArcArray<u16, D>),
    I16(ArcArray<i16, D>),
    U32(ArcArray<u32, D>),
    I32(ArcArray<i32, D>),
    U64(ArcArray<u64, D>),
    I64(ArcArray<i64, D>),
    F32(ArcArray<f32, D>),
    F64(ArcArray<f64, D>),
}

/// The voxels of a volume, of shape (k, j, i).
pub type Voxels = TypedArray<Ix3>;

/// Values in the order of a file.
pub type StoredValues = TypedArray<Ix1>;

/// One expression for the array of each type.
macro_rules! with_values {
    ($values:expr, $v:ident => $body:expr) => {
        match $values {
            TypedArray::U8($v) => $body,
            TypedArray::I8($v) => $body,
            TypedArray::U16($v) => $body,
            TypedArray::I16($v) => $body,
            TypedArray::U32($v) => $body,
            TypedArray::I32($v) => $body,
            TypedArray::U64($v) => $body,
            TypedArray::I64($v) => $body,
            TypedArray::F32($v) => $body,
            TypedArray::F64($v) => $body,
        }
    };
}

pub(super) use with_values;

/// As `with_values`, with a result array of the same type.
macro_rules! of_same_type {
    ($values:expr, $v:ident => $body:expr) => {
        match $values {
            TypedArray::U8($v) => TypedArray::U8($body),
            TypedArray::I8($v) => TypedArray::I8($body),
            TypedArray::U16($v) => TypedArray::U16($body),
            TypedArray::I16($v) => TypedArray::I16($body),
            TypedArray::U32($v) => TypedArray::U32($body),
            TypedArray::I32($v) => TypedArray::I32($body),
            TypedArray::U64($v) => TypedArray::U64($body),
            TypedArray::I64($v) => TypedArray::I64($body),
            TypedArray::F32($v) => TypedArray::F32($body),
            TypedArray::F64($v) => TypedArray::F64($body),
        }
    };
}

macro_rules! from_arrays {
    ($($variant:ident $t:ty),*) => {
        $(impl<D: Dimension> From<Array<$t, D>> for TypedArray<D> {
            fn from(values: Array<$t, D>) -> Self {
                Self::$variant(if values.is_standard_layout() { values.into_shared() } else { standard(values.view()) })
            }
        }
        impl<D: Dimension> From<ArcArray<$t, D>> for TypedArray<D> {
            fn from(values: ArcArray<$t, D>) -> Self {
                Self::$variant(if values.is_standard_layout() { values } else { standard(values.view()) })
            }
        }
        impl From<Vec<$t>> for StoredValues {
            fn from(values: Vec<$t>) -> Self {
                Array::from_vec(values).into()
            }
        })*
    };
}
from_arrays!(U8 u8, I8 i8, U16 u16, I16 i16, U32 u32, I32 i32, U64 u64, I64 i64, F32 f32, F64 f64);

/// A copy in standard layout.
pub(super) fn standard<T: Copy + Default + Send + Sync, D: Dimension>(
    view: ArrayView<T, D>,
) -> ArcArray<T, D> {
    let mut copy = Array::default(view.raw_dim());
    Zip::from(&mut copy)
        .and(&view)
        .par_for_each(|to, &value| *to = value);
    copy.into_shared()
}

/// Number of voxels per task of a parallel pass.
const CHUNK: usize = 1 << 16;

impl Voxels {
    /// Voxels of a size along i, j, k from their values, i fastest.
    ///
    /// # Panics
    /// If the number of values differs from the number of voxels.
    pub fn new(size: [usize; 3], values: impl Into<StoredValues>) -> Self {
        let [i, j, k] = size;
        values.into().reshaped((k, j, i))
    }

    /// Voxels along i, j, k.
    pub fn size(&self) -> [usize; 3] {
        let (k, j, i) = with_values!(self, v => v.dim());
        [i, j, k]
    }

    /// The stored value of a voxel.
    #[allow(clippy::unnecessary_cast, reason = "one of the ten types is f64 already")]
    pub fn at(&self, [i, j, k]: [usize; 3]) -> f64 {
        with_values!(self, v => v[[k, j, i]] as f64)
    }

    /// The trilinear interpolation, at fractions `f` along i, j, k, of the voxel `[i, j, k]` and
    /// the next ones along each axis.
    #[inline]
    #[allow(clippy::unnecessary_cast, reason = "one of the ten types is f64 already")]
    pub fn trilinear(&self, [i, j, k]: [usize; 3], f: glam::DVec3) -> f64 {
        let [row, layer] = [self.size()[0], self.size()[0] * self.size()[1]];
        let base = k * layer + j * row + i;
        with_values!(self, v => {
            let v = flat(v);
            let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
            let along = |at: usize| {
                let two = &v[at..at + 2];
                mix(two[0] as f64, two[1] as f64, f.x)
            };
            mix(mix(along(base), along(base + row), f.y), mix(along(base + layer), along(base + layer + row), f.y), f.z)
        })
    }

    /// Interpolates each layer between one and the next, `(lower, fraction of the upper)`; uses the
    /// nearer one where `takes_nearest` returns true for their values. Integers are rounded.
    #[allow(clippy::unnecessary_cast, reason = "one of the ten types is f64 already")]
    pub(super) fn interpolated_layers(
        &self,
        between: &[(usize, f64)],
        takes_nearest: impl Fn(f64, f64) -> bool + Sync,
    ) -> Self {
        let round = self.is_integer();
        of_same_type!(self, v => {
            let (_, nj, ni) = v.dim();
            let mut layers = Array::default((between.len(), nj, ni));
            Zip::from(layers.outer_iter_mut()).and(between).par_for_each(|layer, &(lower, share)| {
                let [below, above] = [lower, lower + 1].map(|k| v.index_axis(Axis(0), k));
                Zip::from(layer).and(below).and(above).for_each(|to, &a, &b| {
                    let (first, second) = (a as f64, b as f64);
                    let share = if takes_nearest(first, second) { share.round() } else { share };
                    let value = first + (second - first) * share;
                    *to = if share <= 0.0 { a } else { (if round { value.round() } else { value }) as _ };
                });
            });
            layers.into_shared()
        })
    }

    /// Folds over the rows along i in parallel; each row is passed with its values.
    #[allow(clippy::unnecessary_cast, reason = "one of the ten types is f64 already")]
    pub(super) fn fold_rows<A: Copy + Send + Sync>(
        &self,
        start: A,
        fold: impl Fn(A, &mut dyn Iterator<Item = f64>) -> A + Sync + Send,
        join: impl Fn(A, A) -> A + Sync + Send,
    ) -> A {
        let length = self.size()[0].max(1);
        with_values!(self, v => flat(v)
            .par_chunks(length)
            .fold(|| start, |a, row| fold(a, &mut row.iter().map(|&x| x as f64)))
            .reduce(|| start, &join))
    }
}

impl StoredValues {
    /// Reserves memory for more values.
    pub(super) fn reserve(&mut self, more: usize) {
        // Without reserved memory the values move when appended.
        let _moves = with_values!(self, v => {
            let mut owned = std::mem::take(v).into_owned();
            let room = owned.reserve(Axis(0), more);
            *v = owned.into_shared();
            room
        });
    }

    /// Appends values of the same type; false if the types differ.
    pub(super) fn append(&mut self, more: &Self) -> bool {
        macro_rules! same {
            ($($variant:ident),*) => {
                match (self, more) {
                    $((Self::$variant(all), Self::$variant(more)) => {
                        let mut owned = std::mem::take(all).into_owned();
                        let fits = owned.append(Axis(0), more.view()).is_ok();
                        *all = owned.into_shared();
                        fits
                    })*
                    _ => false,
                }
            };
        }
        same!(U8, I8, U16, I16, U32, I32, U64, I64, F32, F64)
    }
}

#[allow(clippy::unnecessary_cast, reason = "one of the ten types is f64 already")]
impl<D: Dimension> TypedArray<D> {
    /// Number of values.
    pub fn len(&self) -> usize {
        with_values!(self, v => v.len())
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The value at a flat index.
    pub fn get(&self, index: usize) -> f64 {
        with_values!(self, v => flat(v)[index] as f64)
    }

    /// The same values in another shape.
    ///
    /// # Panics
    /// If the new shape has another number of values.
    #[allow(clippy::expect_used, reason = "the caller has counted the values")]
    pub fn reshaped<S: IntoDimension>(self, shape: S) -> TypedArray<S::Dim> {
        let dimension = shape.into_dimension();
        of_same_type!(self, v => v.into_shape_with_order(dimension).expect("the shape has as many places as there are values"))
    }

    /// The same values with permuted axes.
    pub(super) fn permuted(self, axes: D) -> Self {
        of_same_type!(self, v => standard(v.permuted_axes(axes).view()))
    }

    /// Applies `make` to the first four values of every lane along an axis, with 0 for missing
    /// ones, in the order of the other axes.
    pub(super) fn map_lanes<T: Send>(&self, axis: Axis, make: impl Fn([f64; 4]) -> T + Sync + Send) -> Vec<T>
    where
        D: ndarray::RemoveAxis,
    {
        with_values!(self, v => {
            let lane = |lane: ndarray::ArrayView1<_>| make(std::array::from_fn(|n| lane.get(n).map_or(0.0, |&x| x as f64)));
            Zip::from(v.lanes(axis)).par_map_collect(lane).into_raw_vec_and_offset().0
        })
    }

    /// The part at one index of an axis.
    pub(super) fn at_index(&self, axis: Axis, index: usize) -> TypedArray<D::Smaller>
    where
        D: ndarray::RemoveAxis,
    {
        of_same_type!(self, v => standard(v.index_axis(axis, index)))
    }

    /// The first `count` indices of an axis.
    pub(super) fn first_of(&self, axis: Axis, count: usize) -> Self {
        of_same_type!(self, v => standard(v.slice_axis(axis, ndarray::Slice::from(..count))))
    }

    /// The name of the type, as printed by `info`.
    pub fn type_name(&self) -> &'static str {
        match self {
            Self::U8(_) => "u8",
            Self::I8(_) => "i8",
            Self::U16(_) => "u16",
            Self::I16(_) => "i16",
            Self::U32(_) => "u32",
            Self::I32(_) => "i32",
            Self::U64(_) => "u64",
            Self::I64(_) => "i64",
            Self::F32(_) => "f32",
            Self::F64(_) => "f64",
        }
    }

    /// Whether values are integers.
    pub fn is_integer(&self) -> bool {
        !matches!(self, Self::F32(_) | Self::F64(_))
    }

    /// Bytes of one voxel.
    pub fn bytes_per_voxel(&self) -> usize {
        with_values!(self, v => size_of_val(flat(v)) / v.len().max(1))
    }

    /// The largest value of an integer type; 1 for the others.
    pub(super) fn top(&self) -> f64 {
        match self {
            Self::U8(_) => f64::from(u8::MAX),
            Self::I8(_) => f64::from(i8::MAX),
            Self::U16(_) => f64::from(u16::MAX),
            Self::I16(_) => f64::from(i16::MAX),
            Self::U32(_) => f64::from(u32::MAX),
            Self::I32(_) => f64::from(i32::MAX),
            Self::U64(_) => u64::MAX as f64,
            Self::I64(_) => i64::MAX as f64,
            Self::F32(_) | Self::F64(_) => 1.0,
        }
    }

    /// Folds over all stored values in parallel.
    pub fn fold<A: Send>(
        &self,
        start: impl Fn() -> A + Sync + Send,
        fold: impl Fn(A, f64) -> A + Sync + Send,
        join: impl Fn(A, A) -> A + Sync + Send,
    ) -> A {
        with_values!(self, v => flat(v)
            .par_chunks(CHUNK)
            .map(|chunk| chunk.iter().fold(start(), |a, &x| fold(a, x as f64)))
            .reduce(&start, &join))
    }

    /// Smallest and largest value that is finite and not padding (none if there is none), the
    /// number of non-finite values, and the number of padding values.
    pub fn finite_range(&self, padding: Option<[f64; 2]>) -> (Option<[f64; 2]>, [usize; 2]) {
        let Some([from, to]) = padding else {
            let (low, high, bad) = self.fold(
                || (f64::INFINITY, f64::NEG_INFINITY, 0usize),
                |(low, high, bad), x| {
                    if x.is_finite() {
                        (low.min(x), high.max(x), bad)
                    } else {
                        (low, high, bad + 1)
                    }
                },
                |a, b| (a.0.min(b.0), a.1.max(b.1), a.2 + b.2),
            );
            return ((low <= high).then_some([low, high]), [bad, 0]);
        };
        let (low, high, bad, padded) = self.fold(
            || (f64::INFINITY, f64::NEG_INFINITY, 0usize, 0usize),
            |(low, high, bad, padded), x| {
                if !x.is_finite() {
                    (low, high, bad + 1, padded)
                } else if (from..=to).contains(&x) {
                    (low, high, bad, padded + 1)
                } else {
                    (low.min(x), high.max(x), bad, padded)
                }
            },
            |a, b| (a.0.min(b.0), a.1.max(b.1), a.2 + b.2, a.3 + b.3),
        );
        ((low <= high).then_some([low, high]), [bad, padded])
    }

    /// Converts all values with `convert`, in parallel.
    pub(super) fn map<T: Send>(&self, convert: impl Fn(f64) -> T + Sync + Send) -> Array<T, D> {
        with_values!(self, v => Zip::from(v).par_map_collect(|&x| convert(x as f64)))
    }
}
