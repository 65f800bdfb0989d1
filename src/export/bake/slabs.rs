//! Slabs of a baked grid, computed in parallel while others are written.

use crate::Result;
use crate::volume::GridGeometry;
use rayon::prelude::*;
use std::sync::mpsc;
use std::thread;

/// Size of a slab: about 4 MiB, so that a slab is still in the cache when it is written.
const SLAB_BYTES: usize = 1 << 22;

/// Rows of voxels in slabs, each handed to `write` in order.
pub(super) fn slabs(
    grid: &GridGeometry,
    bytes_per_voxel: usize,
    row: impl Fn(usize, usize, &mut Vec<u8>) + Sync,
    mut write: impl FnMut(&[u8]) -> Result<()>,
    progress: &dyn Fn(f32),
) -> Result<()> {
    let [nx, ny, nz] = grid.size;
    let layers = (SLAB_BYTES / (nx * ny * bytes_per_voxel).max(1)).clamp(1, nz);
    let row = &row;
    // The next slab is computed while one is written.
    let (made, slabs) = mpsc::sync_channel(1);
    thread::scope(|scope| {
        scope.spawn(move || {
            for first in (0..nz).step_by(layers) {
                let last = (first + layers).min(nz);
                let rows: Vec<Vec<u8>> = (first * ny..last * ny)
                    .into_par_iter()
                    .map(|n| {
                        let mut bytes = Vec::with_capacity(nx * bytes_per_voxel);
                        row(n % ny, n / ny, &mut bytes);
                        bytes
                    })
                    .collect();
                if made.send((last, rows)).is_err() {
                    // Writing has failed.
                    break;
                }
            }
        });
        for (last, rows) in slabs {
            rows.iter().try_for_each(|r| write(r))?;
            progress(last as f32 / nz as f32);
        }
        Ok(())
    })
}
