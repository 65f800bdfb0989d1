//! Voxels in the type they were stored in.

use rayon::prelude::*;
use std::sync::Arc;

/// A flat array of one scalar type, i fastest. Shared, never changed after loading.
#[derive(Clone, Debug)]
#[allow(missing_docs, reason = "the variants are the Rust types")]
pub enum Voxels {
    U8(Arc<Vec<u8>>),
    I8(Arc<Vec<i8>>),
    U16(Arc<Vec<u16>>),
    I16(Arc<Vec<i16>>),
    U32(Arc<Vec<u32>>),
    I32(Arc<Vec<i32>>),
    U64(Arc<Vec<u64>>),
    I64(Arc<Vec<i64>>),
    F32(Arc<Vec<f32>>),
    F64(Arc<Vec<f64>>),
}

macro_rules! with_voxels {
    ($voxels:expr, $v:ident => $body:expr) => {
        match $voxels {
            Voxels::U8($v) => $body,
            Voxels::I8($v) => $body,
            Voxels::U16($v) => $body,
            Voxels::I16($v) => $body,
            Voxels::U32($v) => $body,
            Voxels::I32($v) => $body,
            Voxels::U64($v) => $body,
            Voxels::I64($v) => $body,
            Voxels::F32($v) => $body,
            Voxels::F64($v) => $body,
        }
    };
}

macro_rules! from_vec {
    ($($variant:ident $t:ty),*) => {
        $(impl From<Vec<$t>> for Voxels {
            fn from(values: Vec<$t>) -> Self {
                Self::$variant(Arc::new(values))
            }
        })*
    };
}
from_vec!(U8 u8, I8 i8, U16 u16, I16 i16, U32 u32, I32 i32, U64 u64, I64 i64, F32 f32, F64 f64);

/// Voxels handled at once by one task of a parallel pass.
const CHUNK: usize = 1 << 16;

#[allow(clippy::unnecessary_cast, reason = "one of the ten types is f64 already")]
impl Voxels {
    /// Number of voxels.
    pub fn len(&self) -> usize {
        with_voxels!(self, v => v.len())
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The stored value at a flat index.
    pub fn get(&self, index: usize) -> f64 {
        with_voxels!(self, v => v[index] as f64)
    }

    /// The trilinear mix, at shares `f` along i, j, k, of a stored value and those after it along each axis of a grid whose rows and layers are
    /// `row` and `layer` values apart.
    #[inline]
    pub fn trilinear(&self, base: usize, [row, layer]: [usize; 2], f: glam::DVec3) -> f64 {
        with_voxels!(self, v => {
            let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
            let along = |at: usize| {
                let two = &v[at..at + 2];
                mix(two[0] as f64, two[1] as f64, f.x)
            };
            mix(mix(along(base), along(base + row), f.y), mix(along(base + layer), along(base + layer + row), f.y), f.z)
        })
    }

    /// The name of the type, as `info` prints it.
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
        with_voxels!(self, v => size_of_val(&v[..]) / v.len().max(1))
    }

    /// Makes room for more values.
    pub(super) fn reserve(&mut self, more: usize) {
        // Without room the values move when they are appended.
        let _moves = with_voxels!(self, v => Arc::make_mut(v).try_reserve_exact(more));
    }

    /// Appends values of the same type; false if they are of another.
    pub(super) fn append(&mut self, more: &Self) -> bool {
        macro_rules! same {
            ($($variant:ident),*) => {
                match (self, more) {
                    $((Self::$variant(all), Self::$variant(more)) => Arc::make_mut(all).extend_from_slice(more),)*
                    _ => return false,
                }
            };
        }
        same!(U8, I8, U16, I16, U32, I32, U64, I64, F32, F64);
        true
    }

    /// The highest value of an integer type; 1 of the others.
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

    /// `count` values of the same type, the n-th being the one at `index(n)`.
    pub(super) fn gathered(&self, count: usize, index: impl Fn(usize) -> usize + Sync + Send) -> Self {
        with_voxels!(self, v => (0..count).into_par_iter().map(|n| v[index(n)]).collect::<Vec<_>>().into())
    }

    /// `count` values of the same type, the n-th being the mix of two by a share of the second: `(first, second, share)`. Integers are rounded.
    pub(super) fn mixed(&self, count: usize, of: impl Fn(usize) -> (usize, usize, f64) + Sync + Send) -> Self {
        let round = self.is_integer();
        with_voxels!(self, v => (0..count)
            .into_par_iter()
            .map(|n| {
                let (a, b, share) = of(n);
                if share <= 0.0 {
                    return v[a];
                }
                let value = v[a] as f64 + (v[b] as f64 - v[a] as f64) * share;
                (if round { value.round() } else { value }) as _
            })
            .collect::<Vec<_>>()
            .into())
    }

    /// Folds over all stored values in parallel.
    pub fn fold<A: Send>(
        &self,
        start: impl Fn() -> A + Sync + Send,
        fold: impl Fn(A, f64) -> A + Sync + Send,
        join: impl Fn(A, A) -> A + Sync + Send,
    ) -> A {
        with_voxels!(self, v => v
            .par_chunks(CHUNK)
            .map(|chunk| chunk.iter().fold(start(), |a, &x| fold(a, x as f64)))
            .reduce(&start, &join))
    }

    /// Lowest and highest value that is finite and no padding (none if there is none), how many are not finite, and how many are padding.
    pub fn finite_range(&self, padding: Option<[f64; 2]>) -> (Option<[f64; 2]>, [usize; 2]) {
        let Some([from, to]) = padding else {
            let (low, high, bad) = self.fold(
                || (f64::INFINITY, f64::NEG_INFINITY, 0usize),
                |(low, high, bad), x| if x.is_finite() { (low.min(x), high.max(x), bad) } else { (low, high, bad + 1) },
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

    /// All values through `convert`, in parallel.
    pub(super) fn map<T: Send>(&self, convert: impl Fn(f64) -> T + Sync + Send) -> Vec<T> {
        with_voxels!(self, v => v.par_iter().map(|&x| convert(x as f64)).collect())
    }
}
