//! Walks eight points through a stack at once.

use super::{PlacedMap, PrecomposedMap, Stack};
use crate::deform::DisplacementMap;
use crate::deform::texel::{MIN_MARKED_ALPHA, MIN_MARKED_SLOPE};
use crate::math::lanes::*;
use glam::{Mat3, Vec3, Vec4};

/// Texels of a map along a line of points, interpolated across it once for all of them.
pub struct TexelLine {
    texels: Vec<Vec4>,
}

/// Eight points carried back through a stack.
#[derive(Clone, Copy)]
pub struct SourceLanes<S: Simd> {
    /// Source points, mm.
    pub source: Vec3x8<S>,
    /// Smallest masks along the way.
    pub alpha: f32x8<S>,
    /// Whether the point met any map's cube.
    pub inside: mask32x8<S>,
}

/// The deformation at eight points, as needed for shading.
#[derive(Clone, Copy)]
pub struct JetLanes<S: Simd> {
    /// Columns of d source / d deformed.
    pub columns: [Vec3x8<S>; 3],
    /// Signed distances to the nearest cuts, mm, to first order.
    pub cut_distance_mm: f32x8<S>,
}

impl PlacedMap {
    /// Which of eight points, in map coordinates, lie in the cube or within its reach.
    #[inline(always)]
    fn holds_lanes<S: Simd>(&self, x: Vec3x8<S>) -> mask32x8<S> {
        let reach = self.reach;
        within(x.x, -reach.x, 1.0 + reach.x)
            & within(x.y, -reach.y, 1.0 + reach.y)
            & within(x.z, -reach.z, 1.0 + reach.z)
    }
}

impl PlacedMap {
    /// Displacements, mm, and masks at eight points of the cube.
    #[inline(always)]
    fn displacement_lanes<S: Simd>(
        &self,
        simd: S,
        x: Vec3x8<S>,
        lanes: mask32x8<S>,
        line: Option<&TexelLine>,
    ) -> (Vec3x8<S>, f32x8<S>) {
        if self.cylinder.is_some() {
            return self.displacement_by_lane(simd, &x, lanes.to_bitmask());
        }
        let (stored, alpha) = match line {
            Some(line) => DisplacementMap::fetch_line(simd, &line.texels, x.x),
            None => self.filter.fetch_lanes(simd, &self.map, x),
        };
        (stored.mapped(&self.world_from_stored), alpha)
    }

    /// The same for a map wrapped around an axis, one point after the other.
    #[inline(never)]
    fn displacement_by_lane<S: Simd>(&self, simd: S, x: &Vec3x8<S>, lanes: u64) -> (Vec3x8<S>, f32x8<S>) {
        let (mut moved, mut alphas) = ([Vec3::ZERO; LANES], [1.0; LANES]);
        for n in lanes_of(lanes) {
            let cylinder = self.cylinder.as_ref();
            if let Some((cylinder, (d, alpha))) =
                cylinder.and_then(|c| Some((c, c.displacement(&self.map, &self.filter, x.lane(n))?)))
            {
                (moved[n], alphas[n]) = (cylinder.world_from_local * d, alpha);
            }
        }
        (Vec3x8::from_lanes(simd, &moved), f32x8::load_array(simd, alphas))
    }
}

impl Stack {
    /// The first map on the walk, for points `first` + t `step` of the deformed scene, if these lie
    /// along its x axis.
    pub fn line(&self, first: Vec3, step: Vec3) -> Option<TexelLine> {
        let map = self.precomposed.as_ref().map(|s| &s.map).or(self.maps.last())?;
        if map.cylinder.is_some() || map.filter.has_short_weights {
            return None;
        }
        let across = map.placement.map_from_world.matrix3.x_axis;
        // Exactly, so that interpolating across the line once gives the same result as for each
        // point.
        if [step.y, step.z, across.y, across.z] != [0.0; 4] {
            return None;
        }
        let x = map.placement.map_from_world.transform_point3(first);
        Some(TexelLine {
            texels: map.map.line(x.y, x.z)?,
        })
    }

    /// [`Self::source_and_alpha`] for eight points, of which only those in `lanes` are needed. Only
    /// points inside a map's cube cost a fetch.
    #[inline(always)]
    pub fn source_and_alpha_lanes<S: Simd>(
        &self,
        simd: S,
        deformed: Vec3x8<S>,
        lanes: mask32x8<S>,
    ) -> SourceLanes<S> {
        self.source_and_alpha_on_line(simd, deformed, lanes, None)
    }

    /// As [`Self::source_and_alpha_lanes`] for points on a line, if one is given.
    #[inline(always)]
    pub fn source_and_alpha_on_line<S: Simd>(
        &self,
        simd: S,
        deformed: Vec3x8<S>,
        lanes: mask32x8<S>,
        line: Option<&TexelLine>,
    ) -> SourceLanes<S> {
        let nothing = mask32x8::splat(simd, false);
        let mut walk = SourceLanes {
            source: deformed,
            alpha: f32x8::splat(simd, 1.0),
            inside: nothing,
        };
        let mut at = deformed;
        let mut live = lanes;
        let mut line = line;
        if let Some(PrecomposedMap { map, .. }) = &self.precomposed {
            let x = at.transformed(&map.placement.map_from_world);
            let inside = live & map.holds_lanes(x);
            if !inside.any_true() {
                return walk;
            }
            let (stored, alpha) = match line.take() {
                Some(line) => DisplacementMap::fetch_line(simd, &line.texels, x.x),
                None => map.filter.fetch_lanes(simd, &map.map, x),
            };
            let direct = inside & alpha.simd_lt(MIN_MARKED_ALPHA);
            walk.alpha = direct.select(alpha, walk.alpha);
            walk.inside = direct;
            walk.source = Vec3x8::select(
                direct,
                walk.source + stored.mapped(&map.world_from_stored),
                walk.source,
            );
            live = inside & !direct;
            if !live.any_true() {
                return walk;
            }
            at = deformed;
        }
        for map in self.maps.iter().rev() {
            let x = at.transformed(&map.placement.map_from_world);
            let inside = live & map.holds_lanes(x);
            // Only the first map is evaluated at undisplaced points.
            let line = line.take();
            if inside.any_true() {
                let (displacement, alpha) = map.displacement_lanes(simd, x, inside, line);
                let alpha = inside.select(alpha, f32x8::splat(simd, 1.0));
                walk.alpha = walk.alpha.min(alpha);
                walk.inside |= inside;
                live &= !alpha.simd_lt(0.5);
                let moved = walk.source + displacement;
                walk.source = Vec3x8::select(live & inside, moved, walk.source);
            }
            if !map.added {
                at = walk.source;
            }
        }
        walk
    }

    /// [`Self::source_and_alpha`] for many points: source points and smallest masks.
    pub fn sources_and_alphas(&self, deformed: &[Vec3]) -> Vec<(Vec3, f32)> {
        let mut found = Vec::with_capacity(deformed.len());
        with_simd(SourcesKernel {
            stack: self,
            deformed,
            found: &mut found,
        });
        found
    }

    /// [`Self::jet`] at eight points, of which only those in `lanes` are needed.
    #[inline(always)]
    pub fn jets_lanes<S: Simd>(&self, simd: S, deformed: Vec3x8<S>, lanes: mask32x8<S>) -> JetLanes<S> {
        let Some(PrecomposedMap { map, .. }) = &self.precomposed else {
            return self.jets_by_maps(simd, deformed, lanes);
        };
        let x = deformed.transformed(&map.placement.map_from_world);
        let inside = lanes & map.holds_lanes(x);
        let unmoved = [
            Vec3x8::splat(simd, Vec3::X),
            Vec3x8::splat(simd, Vec3::Y),
            Vec3x8::splat(simd, Vec3::Z),
        ];
        let mut jets = JetLanes {
            columns: unmoved,
            cut_distance_mm: f32x8::splat(simd, f32::INFINITY),
        };
        if !inside.any_true() {
            return jets;
        }
        let ([.., alpha], [dx, dy, dz]) = map.filter.derivatives_lanes(simd, &map.map, x, inside);
        let marked_slope = dx[3]
            .abs()
            .max(dy[3].abs())
            .max(dz[3].abs())
            .simd_ge(MIN_MARKED_SLOPE);
        let direct = inside & alpha.simd_lt(MIN_MARKED_ALPHA) & !marked_slope;
        let d = [
            of_displacement(dx, map),
            of_displacement(dy, map),
            of_displacement(dz, map),
        ];
        let slope = Vec3x8 {
            x: dx[3],
            y: dy[3],
            z: dz[3],
        };
        let map_from_world = Mat3::from(map.placement.map_from_world.matrix3);
        let across = unmoved.map(|axis| axis.mapped(&map_from_world));
        let gradient = Vec3x8 {
            x: slope.dot(across[0]),
            y: slope.dot(across[1]),
            z: slope.dot(across[2]),
        }
        .length();
        jets.cut_distance_mm =
            (direct & gradient.simd_ge(1e-12)).select((alpha - 0.5) / gradient, jets.cut_distance_mm);
        for (column, across) in jets.columns.iter_mut().zip(across) {
            *column = Vec3x8::select(direct, *column + along(d, across), *column);
        }
        let rest = inside & !direct;
        if rest.any_true() {
            let by_maps = self.jets_by_maps(simd, deformed, rest);
            for (column, exact) in jets.columns.iter_mut().zip(by_maps.columns) {
                *column = Vec3x8::select(rest, exact, *column);
            }
            jets.cut_distance_mm = rest.select(by_maps.cut_distance_mm, jets.cut_distance_mm);
        }
        jets
    }

    #[inline(always)]
    fn jets_by_maps<S: Simd>(&self, simd: S, deformed: Vec3x8<S>, lanes: mask32x8<S>) -> JetLanes<S> {
        let [x, y, z] = [
            Vec3x8::splat(simd, Vec3::X),
            Vec3x8::splat(simd, Vec3::Y),
            Vec3x8::splat(simd, Vec3::Z),
        ];
        let (mut jx, mut jy, mut jz) = (x, y, z);
        let (mut source, mut at) = (deformed, deformed);
        let (mut at_x, mut at_y, mut at_z) = (x, y, z);
        let mut cut_distance_mm = f32x8::splat(simd, f32::INFINITY);
        for map in self.maps.iter().rev() {
            let x = at.transformed(&map.placement.map_from_world);
            let inside = lanes & map.holds_lanes(x);
            if map.cylinder.is_some() && inside.any_true() {
                for n in lanes_of(inside.to_bitmask()) {
                    let p = at.lane(n);
                    let Some((j, slope)) = map.derivatives(p) else {
                        continue;
                    };
                    let (moved, alpha) = map.backward(p);
                    let d_at = Mat3::from_cols(at_x.lane(n), at_y.lane(n), at_z.lane(n));
                    let gradient = (d_at.transpose() * slope).length();
                    if gradient >= 1e-12 && alpha - 0.5 < cut_distance_mm[n] * gradient {
                        cut_distance_mm[n] = (alpha - 0.5) / gradient;
                    }
                    let more = (j - Mat3::IDENTITY) * d_at;
                    jx.set(n, jx.lane(n) + more.x_axis);
                    jy.set(n, jy.lane(n) + more.y_axis);
                    jz.set(n, jz.lane(n) + more.z_axis);
                    source.set(n, source.lane(n) + (moved - p));
                }
            } else if inside.any_true() {
                let ([sx, sy, sz, alpha], [dx, dy, dz]) =
                    map.filter.derivatives_lanes(simd, &map.map, x, inside);
                let stored = Vec3x8 { x: sx, y: sy, z: sz }.mapped(&map.world_from_stored);
                let d = [
                    of_displacement(dx, map),
                    of_displacement(dy, map),
                    of_displacement(dz, map),
                ];
                let slope = Vec3x8 {
                    x: dx[3],
                    y: dy[3],
                    z: dz[3],
                };
                let map_from_world = Mat3::from(map.placement.map_from_world.matrix3);
                let (mx, my, mz) = (
                    at_x.mapped(&map_from_world),
                    at_y.mapped(&map_from_world),
                    at_z.mapped(&map_from_world),
                );
                let gradient = Vec3x8 {
                    x: slope.dot(mx),
                    y: slope.dot(my),
                    z: slope.dot(mz),
                }
                .length();
                let nearer =
                    inside & gradient.simd_ge(1e-12) & (alpha - 0.5).simd_lt(cut_distance_mm * gradient);
                cut_distance_mm = nearer.select((alpha - 0.5) / gradient, cut_distance_mm);
                jx = Vec3x8::select(inside, jx + along(d, mx), jx);
                jy = Vec3x8::select(inside, jy + along(d, my), jy);
                jz = Vec3x8::select(inside, jz + along(d, mz), jz);
                source = Vec3x8::select(inside, source + stored, source);
            }
            if !map.added {
                (at, at_x, at_y, at_z) = (source, jx, jy, jz);
            }
        }
        JetLanes {
            columns: [jx, jy, jz],
            cut_distance_mm,
        }
    }
}

/// The displacement part of a texel derivative along one of a map's axes, mm.
#[inline(always)]
fn of_displacement<S: Simd>([x, y, z, _]: [f32x8<S>; 4], map: &PlacedMap) -> Vec3x8<S> {
    Vec3x8 { x, y, z }.mapped(&map.world_from_stored)
}

/// Matrix columns times a vector.
#[inline(always)]
fn along<S: Simd>([x, y, z]: [Vec3x8<S>; 3], v: Vec3x8<S>) -> Vec3x8<S> {
    Vec3x8 {
        x: z.x.mul_add(v.z, y.x.mul_add(v.y, x.x * v.x)),
        y: z.y.mul_add(v.z, y.y.mul_add(v.y, x.y * v.x)),
        z: z.z.mul_add(v.z, y.z.mul_add(v.y, x.z * v.x)),
    }
}

struct SourcesKernel<'a> {
    stack: &'a Stack,
    deformed: &'a [Vec3],
    found: &'a mut Vec<(Vec3, f32)>,
}

impl SimdKernel for SourcesKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let everyone = mask32x8::splat(simd, true);
        for eight in self.deformed.chunks(LANES) {
            let mut points = [Vec3::ZERO; LANES];
            points[..eight.len()].copy_from_slice(eight);
            let walk = self
                .stack
                .source_and_alpha_lanes(simd, Vec3x8::from_lanes(simd, &points), everyone);
            for n in 0..eight.len() {
                self.found.push((walk.source.lane(n), walk.alpha[n]));
            }
        }
    }
}
