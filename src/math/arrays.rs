//! Arrays over the points of a grid: shape (k, j, i) in standard layout, with i fastest.

use ndarray::{Array3, ArrayBase, Data, Dimension};

/// The values of an array as a flat slice.
///
/// # Panics
/// If it is not in standard layout; every array of a grid is.
#[inline(always)]
#[allow(
    clippy::expect_used,
    reason = "arrays are brought into standard layout when they are made"
)]
pub fn flat<S: Data, D: Dimension>(array: &ArrayBase<S, D>) -> &[S::Elem] {
    array.as_slice().expect("arrays are in standard layout")
}

/// An array of a size along i, j, k from its values, i fastest.
///
/// # Panics
/// If the number of values differs from the number of points.
#[allow(clippy::expect_used, reason = "the caller has counted the values")]
pub fn shaped<T>([i, j, k]: [usize; 3], values: Vec<T>) -> Array3<T> {
    Array3::from_shape_vec((k, j, i), values).expect("there is one value for each point")
}

/// Points along i, j, k.
#[inline(always)]
pub fn size<S: Data>(array: &ArrayBase<S, ndarray::Ix3>) -> [usize; 3] {
    let (k, j, i) = array.dim();
    [i, j, k]
}
