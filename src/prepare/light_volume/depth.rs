//! Samples the optical depth of the deformed scene: its volume, its surfaces and its triangles.

use super::casters::{Casters, SurfaceCaster, VolumeCaster};
use super::sweep::DepthGrid;
use crate::deform::TexelLine;
use crate::math::Bounds;
use crate::math::lanes::*;
use crate::scene::surface::CutModel;
use crate::volume::{GradientFilter, VolumeSampler};
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// The greatest optical depth of a cell (powers of 1/2). Depths are interpolated: a larger number
/// would widen every shadow.
const OPAQUE: f32 = 3.0;
/// The most samples of a cell along an axis.
const MAX_SAMPLES: usize = 3;
/// Cells around what is visible: the outermost nodes are empty, and samples read in front of it.
const MARGIN: f32 = 3.0;

/// Samples what casts shadows, with `cells` along the longest edge of its box.
pub(super) fn sampled(casters: &Casters, bounds: &Bounds, cells: f32) -> DepthGrid {
    let mut cell_mm = bounds.size().max_element() / cells;
    if casters.volume.is_some() {
        // Between voxels there is nothing to be found.
        cell_mm = cell_mm.max(casters.reference_mm);
    }
    let bounds = bounds.grown(MARGIN * cell_mm);
    let size = ((bounds.size() / cell_mm).ceil().as_uvec3() + 1)
        .to_array()
        .map(|n| n as usize);
    let mut grid = DepthGrid {
        size,
        origin: bounds.min,
        cell_mm,
        depth: vec![0.0; size.iter().product()],
        read: Vec::new(),
    };
    casters.stack.fetch_texels();
    if let Some(volume) = &casters.volume {
        add_volume(casters, volume, &mut grid);
    }
    for surface in &casters.surfaces {
        add_solid(casters, surface, &mut grid);
        add_triangles(surface, &mut grid);
    }
    empty_faces(&mut grid);
    grid.read = DepthGrid::read_nodes(size, &grid.depth, 0.9 * OPAQUE);
    grid
}

/// Empties the outermost nodes, as rays of the light begin outside.
fn empty_faces(grid: &mut DepthGrid) {
    let [nx, ny, nz] = grid.size;
    for (n, row) in grid.depth.chunks_mut(nx).enumerate() {
        let (j, k) = (n % ny, n / ny);
        if j == 0 || j == ny - 1 || k == 0 || k == nz - 1 {
            row.fill(0.0);
        }
        (row[0], row[nx - 1]) = (0.0, 0.0);
    }
}

/// Optical depths of the volume along rows of nodes.
struct VolumeDepths<'a> {
    casters: &'a Casters<'a>,
    volume: &'a VolumeCaster<'a>,
    sampler: VolumeSampler<'a>,
    cell_mm: f32,
    /// Samples of a cell along each axis.
    samples: usize,
    world_from_covector: Mat3,
}

fn add_volume(casters: &Casters, volume: &VolumeCaster, grid: &mut DepthGrid) {
    let voxel_mm = casters.reference_mm;
    let depths = VolumeDepths {
        casters,
        volume,
        sampler: VolumeSampler::new(volume.grid),
        cell_mm: grid.cell_mm,
        // What voxels hold is interpolated over two of them: nothing falls between such samples.
        samples: ((grid.cell_mm / (2.0 * voxel_mm)).ceil() as usize).clamp(1, MAX_SAMPLES),
        world_from_covector: Mat3::from(volume.voxel_from_world.matrix3).transpose(),
    };
    let [nx, ny, _] = grid.size;
    let (origin, cell_mm) = (grid.origin, grid.cell_mm);
    grid.depth.par_chunks_mut(nx).enumerate().for_each(|(n, row)| {
        let first = origin + Vec3::new(0.0, (n % ny) as f32, (n / ny) as f32) * cell_mm;
        with_simd(VolumeRow {
            depths: &depths,
            first,
            row,
        });
    });
}

/// The nodes of one row.
struct VolumeRow<'a> {
    depths: &'a VolumeDepths<'a>,
    /// The first node, mm.
    first: Vec3,
    row: &'a mut [f32],
}

impl SimdKernel for VolumeRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { depths, first, row } = self;
        let samples = depths.samples;
        let macrocells = &depths.volume.macrocells;
        let part = |n: usize| ((n as f32 + 0.5) / samples as f32 - 0.5) * depths.cell_mm;
        let number = f32x8::load_array(simd, std::array::from_fn(|n| n as f32));
        let weight = (samples.pow(3) as f32).recip();
        for across in 0..samples * samples {
            let start = first + Vec3::new(0.0, part(across % samples), part(across / samples));
            // A whole row of cells can be empty; most are.
            let end = start + Vec3::X * (depths.cell_mm * (row.len() - 1) as f32);
            let half = Vec3::new(0.5 * depths.cell_mm, 0.0, 0.0);
            if macrocells.is_empty_block(&Bounds::new(start - half, end + half)) {
                continue;
            }
            let line = depths.casters.stack.line(start, Vec3::X * depths.cell_mm);
            for along in 0..samples {
                let start = start + Vec3::X * part(along);
                for (n, to) in row.chunks_mut(LANES).enumerate() {
                    let x = (number + (n * LANES) as f32) * depths.cell_mm + start.x;
                    let p = Vec3x8 {
                        x,
                        y: f32x8::splat(simd, start.y),
                        z: f32x8::splat(simd, start.z),
                    };
                    let wanted = !macrocells.states_lanes(simd, p).0;
                    if wanted.all_false() {
                        continue;
                    }
                    let depth = depths.at(simd, p, wanted, line.as_ref()) * weight;
                    for (lane, to) in to.iter_mut().enumerate() {
                        *to += depth[lane];
                    }
                }
            }
        }
    }
}

impl VolumeDepths<'_> {
    /// Optical depths of a cell's length at eight points; `line`: the points lie on it.
    #[inline(always)]
    fn at<S: Simd>(&self, simd: S, p: Vec3x8<S>, wanted: mask32x8<S>, line: Option<&TexelLine>) -> f32x8<S> {
        let zero = f32x8::splat(simd, 0.0);
        let mut lanes = wanted;
        if !self.casters.cuts.is_empty() {
            for n in lanes_of(wanted.to_bitmask()) {
                lanes.set(n, self.casters.cuts.signed_distance_mm(p.lane(n)) >= 0.0);
            }
        }
        let walk = self.casters.stack.source_and_alpha_on_line(simd, p, lanes, line);
        let in_voxel = walk.source.transformed(self.volume.voxel_from_world);
        let top = self.volume.grid_size - 0.5;
        let mut present = lanes
            & walk.alpha.simd_ge(0.5)
            & within(in_voxel.x, -0.5, top.x)
            & within(in_voxel.y, -0.5, top.y)
            & within(in_voxel.z, -0.5, top.z);
        if present.all_false() {
            return zero;
        }
        let value = self.sampler.sample_lanes(simd, in_voxel);
        if self.volume.grid.has_holes {
            present &= value.simd_ge(-1e-4);
        }
        if let Some(iso) = self.volume.iso {
            return (present & value.simd_ge(iso)).select(f32x8::splat(simd, OPAQUE), zero);
        }
        let table = self.volume.table;
        let mut depth = table.depth_lanes(simd, value);
        if !table.gradient.is_empty() {
            let visible = (present & depth.simd_gt(0.0)).to_bitmask();
            let per_voxel = self
                .sampler
                .gradient_lanes(simd, in_voxel, GradientFilter::Central, visible);
            let magnitude = per_voxel.mapped(&self.world_from_covector).length();
            for n in lanes_of(visible) {
                depth[n] *= table.gradient_factor(magnitude[n]);
            }
        }
        let per_cell = self.cell_mm / self.casters.reference_mm;
        present.select((depth * per_cell).min(OPAQUE), zero)
    }
}

/// Adds the inside of a surface, or the wall of a hollow one.
fn add_solid(casters: &Casters, surface: &SurfaceCaster, grid: &mut DepthGrid) {
    let Some(implicit) = surface.implicit else {
        return;
    };
    let [nx, ny, _] = grid.size;
    let (origin, cell_mm) = (grid.origin, grid.cell_mm);
    let depth_at = |p: Vec3| -> f32 {
        if !surface.rigid && casters.cuts.signed_distance_mm(p) < 0.0 {
            return 0.0;
        }
        let (source, alpha) = if surface.rigid {
            (p, 1.0)
        } else {
            casters.stack.source_and_alpha(p)
        };
        if alpha < 0.5 {
            return 0.0;
        }
        let f = implicit.value(source);
        let inside = match surface.model {
            CutModel::Hollow => 0.5 * cell_mm - f.abs(),
            _ if surface.thickness_mm > 0.0 => f.min(surface.thickness_mm - f),
            _ => f,
        };
        OPAQUE * (inside / cell_mm + 0.5).clamp(0.0, 1.0)
    };
    grid.depth.par_chunks_mut(nx).enumerate().for_each(|(n, row)| {
        let first = origin + Vec3::new(0.0, (n % ny) as f32, (n / ny) as f32) * cell_mm;
        let end = first + Vec3::X * (cell_mm * (nx - 1) as f32);
        if surface
            .cells
            .grid
            .is_empty_block(&Bounds::new(first, end).grown(cell_mm))
            && !is_filled(surface)
        {
            return;
        }
        for (i, to) in row.iter_mut().enumerate() {
            *to = to.max(depth_at(first + Vec3::X * (i as f32 * cell_mm)));
        }
    });
}

/// Whether a surface is opaque inside: there its cells are empty as well.
fn is_filled(surface: &SurfaceCaster) -> bool {
    surface.model != CutModel::Hollow && surface.thickness_mm <= 0.0
}

/// Adds the nodes next to triangles.
fn add_triangles(surface: &SurfaceCaster, grid: &mut DepthGrid) {
    let Some(triangles) = surface.triangles else {
        return;
    };
    let [nx, ny, nz] = grid.size;
    let last = Vec3::new((nx - 1) as f32, (ny - 1) as f32, (nz - 1) as f32);
    for triangle in 0..triangles.mesh.triangles.len() {
        let [a, b, c] = triangles
            .mesh
            .corners(triangle)
            .map(|p| (p - grid.origin) / grid.cell_mm);
        let longest = (b - a).length().max((c - a).length()).max((c - b).length());
        // Points at most half a cell apart.
        let steps = (2.0 * longest).ceil().clamp(1.0, 4096.0) as usize;
        for i in 0..=steps {
            for j in 0..=steps - i {
                let [u, v] = [i, j].map(|n| n as f32 / steps as f32);
                let p = (a + (b - a) * u + (c - a) * v + 0.5).floor();
                if p.cmpge(Vec3::ZERO).all() && p.cmple(last).all() {
                    let [x, y, z] = p.to_array().map(|n| n as usize);
                    grid.depth[(z * ny + y) * nx + x] = OPAQUE;
                }
            }
        }
    }
}
