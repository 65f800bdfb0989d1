//! Gives the nodes next to surfaces the light in front of these.
//!
//! A point in front of a tilted surface lies between nodes at different distances from it. Those
//! nearest to it, or inside, see the surface itself: its light would show the grid. As the texels of
//! a texture atlas are padded beyond the edges of their triangles, these nodes take the light at a
//! point farther out, along the gradient of what the grid holds.

use super::sweep::DepthGrid;
use crate::math::cells::{Cells, mix_texels};
use crate::math::lanes::*;
use rayon::prelude::*;

/// How far out the light of such a node is taken if it is empty, cells; one more if it is opaque.
const DISTANCE: f32 = 0.75;
/// Changes of opacity from cell to cell at which a node counts as one next to a surface: not at all,
/// and fully.
const SURFACE: [f32; 2] = [0.1, 0.3];

/// The texels of a grid, with those next to surfaces replaced.
pub(super) fn padded(grid: &DepthGrid, texels: &[[i16; 4]]) -> Vec<[i16; 4]> {
    let [nx, ny, nz] = grid.size;
    let opacity: Vec<f32> = grid.depth.par_iter().map(|d| 1.0 - (-d).exp2()).collect();
    let mut padded = texels.to_vec();
    padded.par_chunks_mut(nx * ny).enumerate().for_each(|(k, slice)| {
        // The outermost nodes are empty, and so is what lies beyond them.
        if k == 0 || k == nz - 1 {
            return;
        }
        with_simd(Slice {
            size: grid.size,
            opacity: &opacity,
            texels,
            k,
            slice,
        });
    });
    padded
}

struct Slice<'a> {
    size: [usize; 3],
    opacity: &'a [f32],
    texels: &'a [[i16; 4]],
    k: usize,
    slice: &'a mut [[i16; 4]],
}

impl SimdKernel for Slice<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self {
            size,
            opacity,
            texels,
            k,
            slice,
        } = self;
        let [nx, ny, _] = size;
        let layer = nx * ny;
        // Across the ends of rows, where every node is empty, as along them.
        let last = layer.saturating_sub(nx + LANES);
        for first in (nx..last).step_by(LANES) {
            let n = k * layer + first;
            let at = |n: usize| f32x8::from_slice(simd, &opacity[n..n + LANES]);
            let inward = Vec3x8 {
                x: at(n + 1) - at(n - 1),
                y: at(n + nx) - at(n - nx),
                z: at(n + layer) - at(n - layer),
            } * f32x8::splat(simd, 0.5);
            let share = smoothstep(SURFACE[0], SURFACE[1], inward.length());
            let wanted = share.simd_gt(0.0).to_bitmask();
            if wanted == 0 {
                continue;
            }
            let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
            for lane in 0..LANES {
                (x[lane], y[lane]) = (((first + lane) % nx) as f32, ((first + lane) / nx) as f32);
            }
            let node = Vec3x8 {
                x: f32x8::load_array(simd, x),
                y: f32x8::load_array(simd, y),
                z: f32x8::splat(simd, k as f32),
            };
            let outside = node - inward.normalized() * (share * (at(n) + DISTANCE));
            let [shadow, open, _, _] = mix_texels(simd, texels, size, &Cells::of(outside, size, 0));
            for lane in lanes_of(wanted) {
                slice[first + lane] = [shadow[lane] as i16, open[lane] as i16, 0, 0];
            }
        }
    }
}
