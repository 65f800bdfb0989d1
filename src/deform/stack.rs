//! An ordered stack of placed maps: positions, Jacobians and cuts, on the fly at every sample
//! (\[DDM06\] section 6).
//!
//! Rendering walks from the last applied map to the first: p_n = p', p_(k-1) = G_k(p_k), where
//! G_k(p) = p + A_k D_k(M_k⁻¹ p) inside map k's cube and p elsewhere. The Jacobian dp_0/dp' =
//! J_1(p_1) ··· J_n(p_n) is accumulated on the same walk, hence normals (its transpose times the
//! source gradient, \[DDM06\] eq 10) and mask gradients need no second walk.
//! `shaders/lib/stack.wgsl` computes the same.
//!
//! A stack may have a [`PrecomposedMap`]: one map that replaces all of it wherever it is accurate
//! enough, and marks where it is not.
//!
//! A map may be *added* to the previous one (\[DS07\] section 4: detail): both are evaluated at the
//! same point and their displacements summed, G(p) = p + A_1 D_1(M_1⁻¹ p) + A_2 D_2(M_2⁻¹ p).

use super::texel::{MIN_MARKED_ALPHA, MIN_MARKED_SLOPE};
use super::{DisplacementMap, Placement};
use crate::math::Bounds;
use crate::math::lanes::*;
use glam::{Mat3, Vec3, Vec4, Vec4Swizzles};
use std::sync::Arc;

/// Maximum number of maps in one GPU pass, in addition to a precomposed one: their placements are
/// in a uniform buffer of 16 KiB, the minimum that every device supports. The CPU takes any number.
pub const MAX_MAPS: usize = 64;

/// A map with its placement.
#[derive(Clone)]
pub struct PlacedMap {
    /// The map.
    pub map: Arc<DisplacementMap>,
    /// Its placement.
    pub placement: Placement,
    /// Whether its displacement is added to that of the previous map, instead of applied after it.
    pub added: bool,
    /// How far the outermost texels extend beyond the cube's faces, map units: half a voxel for a
    /// registration's field, whose outermost vectors apply to the whole of their voxels.
    pub reach: Vec3,
    /// `world_from_map`'s linear part times the map's scale: from stored displacement to mm.
    pub(super) world_from_stored: Mat3,
}

impl PartialEq for PlacedMap {
    /// Identity of the map, not equality of its content: the same map with the same placement.
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.map, &other.map) && (self.placement, self.added, self.reach) == (other.placement, other.added, other.reach)
    }
}

/// Maps in order of application.
#[derive(Clone, Default, PartialEq)]
pub struct Stack {
    maps: Vec<PlacedMap>,
    precomposed: Option<PrecomposedMap>,
}

/// One map that replaces a whole stack within an error bound ([`super::compose::precompose`]).
/// Where it cannot, at tears and cuts, its texels hold a mask above every valid one. This marks
/// each sample that interpolates any of them, and there the maps themselves are evaluated.
#[derive(Clone, PartialEq)]
pub struct PrecomposedMap {
    /// The map, over the cubes of all maps.
    pub map: PlacedMap,
    /// Largest distance of its sources from those of the stack, mm.
    pub bound_mm: f32,
}

/// The nearest cut to a point of the deformed scene, to first order of the masks.
#[derive(Clone, Copy, Debug)]
pub struct NearestCut {
    /// Signed distance to the cut, mm, positive where the volume is retained; infinite where no
    /// mask varies.
    pub distance_mm: f32,
    /// Unit normal of the cut in the deformed scene, pointing out of the retained part; zero where
    /// there is no cut.
    pub normal: Vec3,
}

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

/// The deformation at a point, as needed for shading.
#[derive(Clone, Copy, Debug)]
pub struct Jet {
    /// The source point, mm.
    pub source: Vec3,
    /// d source / d deformed.
    pub d_source_d_deformed: Mat3,
    /// The nearest cut.
    pub cut: NearestCut,
    /// Smallest mask along the way.
    pub alpha: f32,
}

impl NearestCut {
    /// No cut nearby.
    pub const NONE: Self = Self { distance_mm: f32::INFINITY, normal: Vec3::ZERO };

    /// The nearer of this cut and the surface where `value` (positive inside) falls to zero with
    /// the given gradient in the deformed scene: to first order, the distance is value /
    /// |gradient|.
    #[inline(always)]
    pub fn nearer_of(self, value: f32, gradient: Vec3) -> Self {
        let slope = gradient.length();
        if slope < 1e-12 || value >= self.distance_mm * slope {
            return self;
        }
        Self { distance_mm: value / slope, normal: gradient / -slope }
    }
}

impl PlacedMap {
    /// Puts a map into the world.
    pub fn new(map: Arc<DisplacementMap>, placement: Placement) -> Self {
        let world_from_stored = Mat3::from(placement.world_from_map.matrix3) * map.scale;
        Self { map, placement, added: false, reach: Vec3::ZERO, world_from_stored }
    }

    /// One step of the walk: the point before this map was applied, and the mask.
    #[inline(always)]
    pub fn backward(&self, p: Vec3) -> (Vec3, f32) {
        let (d, alpha) = self.displacement(p);
        (p + d, alpha)
    }

    #[inline(always)]
    fn is_outside(&self, x: Vec3) -> bool {
        x.cmplt(-self.reach).any() || x.cmpgt(Vec3::ONE + self.reach).any()
    }

    /// Where the map applies, in map units.
    pub(super) fn domain(&self) -> Bounds {
        Bounds::new(-self.reach, Vec3::ONE + self.reach)
    }

    /// Which of eight points, in map coordinates, lie in the cube or within its reach.
    #[inline(always)]
    fn holds_lanes<S: Simd>(&self, x: Vec3x8<S>) -> mask32x8<S> {
        let reach = self.reach;
        within(x.x, -reach.x, 1.0 + reach.x) & within(x.y, -reach.y, 1.0 + reach.y) & within(x.z, -reach.z, 1.0 + reach.z)
    }

    /// Displacement, mm, and mask at a point.
    #[inline(always)]
    fn displacement(&self, p: Vec3) -> (Vec3, f32) {
        let x = self.placement.map_from_world.transform_point3(p);
        if self.is_outside(x) {
            return (Vec3::ZERO, 1.0);
        }
        let t = self.map.fetch(x);
        (self.world_from_stored * t.xyz(), t.w)
    }

    /// J_G and the mask's gradient per mm at a point, or none outside the cube. J_G = I + A J_D
    /// A⁻¹.
    pub fn derivatives(&self, p: Vec3) -> Option<(Mat3, Vec3)> {
        let x = self.placement.map_from_world.transform_point3(p);
        if self.is_outside(x) {
            return None;
        }
        let (j, slope) = self.map.derivatives(x);
        let inverse = Mat3::from(self.placement.map_from_world.matrix3);
        let linear = Mat3::from(self.placement.world_from_map.matrix3);
        Some((Mat3::IDENTITY + linear * j * inverse, inverse.transpose() * slope))
    }

    /// The cube in the world.
    pub fn bounds_in_world(&self) -> Bounds {
        self.domain().transformed(&self.placement.world_from_map)
    }
}

impl PrecomposedMap {
    /// The jet at a point; none where the maps themselves must be walked.
    fn jet(&self, deformed: Vec3) -> Option<Jet> {
        let (d, alpha) = self.map.displacement(deformed);
        let unmoved = Jet { source: deformed, d_source_d_deformed: Mat3::IDENTITY, cut: NearestCut::NONE, alpha: 1.0 };
        let x = self.map.placement.map_from_world.transform_point3(deformed);
        if self.map.is_outside(x) {
            return Some(unmoved);
        }
        let (_, slope_in_map) = self.map.map.derivatives(x);
        if alpha >= MIN_MARKED_ALPHA || slope_in_map.abs().max_element() >= MIN_MARKED_SLOPE {
            return None;
        }
        let (j, slope) = self.map.derivatives(deformed)?;
        Some(Jet { source: deformed + d, d_source_d_deformed: j, cut: NearestCut::NONE.nearer_of(alpha - 0.5, slope), alpha })
    }
}

impl Stack {
    /// Ensures that all texels are sampled before many threads need them.
    pub fn fetch_texels(&self) {
        self.all_maps().for_each(|m| m.map.fetch_texels());
    }

    /// A stack of maps in order of application.
    pub fn new(mut maps: Vec<PlacedMap>) -> Self {
        // The first map has no predecessor to be added to.
        if let Some(first) = maps.first_mut() {
            first.added = false;
        }
        Self { maps, precomposed: None }
    }

    /// The same stack with a precomposed map.
    pub fn with_precomposed(mut self, precomposed: PrecomposedMap) -> Self {
        self.precomposed = Some(precomposed);
        self
    }

    /// The precomposed map, if there is one.
    pub fn precomposed(&self) -> Option<&PrecomposedMap> {
        self.precomposed.as_ref()
    }

    /// The maps in order of application, followed by the precomposed map if there is one.
    pub fn all_maps(&self) -> impl Iterator<Item = &PlacedMap> {
        self.maps.iter().chain(self.precomposed.as_ref().map(|s| &s.map))
    }

    /// The maps in order of application.
    pub fn maps(&self) -> &[PlacedMap] {
        &self.maps
    }

    /// Whether nothing is deformed.
    pub fn is_empty(&self) -> bool {
        self.maps.is_empty()
    }

    /// The source point of a deformed point, or none where it is cut away.
    #[inline(always)]
    pub fn source_from_deformed(&self, deformed: Vec3) -> Option<Vec3> {
        let (source, alpha) = self.source_and_alpha(deformed);
        (alpha >= 0.5).then_some(source)
    }

    /// The source of a deformed point and the smallest mask along the way; the walk ends where a
    /// mask cuts (below 1/2).
    #[inline(always)]
    pub fn source_and_alpha(&self, deformed: Vec3) -> (Vec3, f32) {
        if let Some(precomposed) = &self.precomposed {
            let (d, alpha) = precomposed.map.displacement(deformed);
            if alpha < MIN_MARKED_ALPHA {
                return (deformed + d, alpha);
            }
        }
        let mut p = deformed;
        // The point at which maps that are added to each other are all evaluated.
        let mut at = deformed;
        let mut smallest = 1.0f32;
        for map in self.maps.iter().rev() {
            let (d, alpha) = map.displacement(at);
            smallest = smallest.min(alpha);
            if alpha < 0.5 {
                break;
            }
            p += d;
            if !map.added {
                at = p;
            }
        }
        (p, smallest)
    }

    /// The first map on the walk, for points `first` + t `step` of the deformed scene, if these lie
    /// along its x axis.
    pub fn line(&self, first: Vec3, step: Vec3) -> Option<TexelLine> {
        let map = self.precomposed.as_ref().map(|s| &s.map).or(self.maps.last())?;
        let across = map.placement.map_from_world.matrix3.x_axis;
        // Exactly, so that interpolating across the line once gives the same result as for each
        // point.
        if [step.y, step.z, across.y, across.z] != [0.0; 4] {
            return None;
        }
        let x = map.placement.map_from_world.transform_point3(first);
        Some(TexelLine { texels: map.map.line(x.y, x.z)? })
    }

    /// [`Self::source_and_alpha`] for eight points, of which only those in `lanes` are needed. Only
    /// points inside a map's cube cost a fetch.
    #[inline(always)]
    pub fn source_and_alpha_lanes<S: Simd>(&self, simd: S, deformed: Vec3x8<S>, lanes: mask32x8<S>) -> SourceLanes<S> {
        self.source_and_alpha_on_line(simd, deformed, lanes, None)
    }

    /// As [`Self::source_and_alpha_lanes`] for points on a line, if one is given.
    #[inline(always)]
    pub fn source_and_alpha_on_line<S: Simd>(&self, simd: S, deformed: Vec3x8<S>, lanes: mask32x8<S>, line: Option<&TexelLine>) -> SourceLanes<S> {
        let nothing = mask32x8::splat(simd, false);
        let mut walk = SourceLanes { source: deformed, alpha: f32x8::splat(simd, 1.0), inside: nothing };
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
                None => map.map.fetch_lanes(simd, x),
            };
            let direct = inside & alpha.simd_lt(MIN_MARKED_ALPHA);
            walk.alpha = direct.select(alpha, walk.alpha);
            walk.inside = direct;
            walk.source = Vec3x8::select(direct, walk.source + stored.mapped(&map.world_from_stored), walk.source);
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
                let (stored, alpha) = match line {
                    Some(line) => DisplacementMap::fetch_line(simd, &line.texels, x.x),
                    None => map.map.fetch_lanes(simd, x),
                };
                let alpha = inside.select(alpha, f32x8::splat(simd, 1.0));
                walk.alpha = walk.alpha.min(alpha);
                walk.inside |= inside;
                live &= !alpha.simd_lt(0.5);
                let moved = walk.source + stored.mapped(&map.world_from_stored);
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
        with_simd(SourcesKernel { stack: self, deformed, found: &mut found });
        found
    }

    /// As [`Self::source_and_alpha`], but through every map whatever the masks are: the
    /// pseudo-inverse, continuous across cuts.
    pub fn source_and_alpha_unclipped(&self, deformed: Vec3) -> (Vec3, f32) {
        let (mut p, mut at, mut smallest) = (deformed, deformed, 1.0f32);
        for map in self.maps.iter().rev() {
            let (d, alpha) = map.displacement(at);
            smallest = smallest.min(alpha);
            p += d;
            if !map.added {
                at = p;
            }
        }
        (p, smallest)
    }

    /// The source point with its Jacobian and the nearest cut. Also defined for cut points (see
    /// `alpha`).
    pub fn jet(&self, deformed: Vec3) -> Jet {
        if let Some(jet) = self.precomposed.as_ref().and_then(|s| s.jet(deformed)) {
            return jet;
        }
        let mut jet = Jet { source: deformed, d_source_d_deformed: Mat3::IDENTITY, cut: NearestCut::NONE, alpha: 1.0 };
        let (mut at, mut d_at) = (deformed, Mat3::IDENTITY);
        for map in self.maps.iter().rev() {
            let (d, alpha) = map.displacement(at);
            if let Some((j, slope)) = map.derivatives(at) {
                jet.cut = jet.cut.nearer_of(alpha - 0.5, d_at.transpose() * slope);
                jet.d_source_d_deformed += (j - Mat3::IDENTITY) * d_at;
            }
            jet.alpha = jet.alpha.min(alpha);
            jet.source += d;
            if !map.added {
                (at, d_at) = (jet.source, jet.d_source_d_deformed);
            }
        }
        jet
    }

    /// [`Self::jet`] at eight points, of which only those in `lanes` are needed.
    #[inline(always)]
    pub fn jets_lanes<S: Simd>(&self, simd: S, deformed: Vec3x8<S>, lanes: mask32x8<S>) -> JetLanes<S> {
        let Some(PrecomposedMap { map, .. }) = &self.precomposed else { return self.jets_by_maps(simd, deformed, lanes) };
        let x = deformed.transformed(&map.placement.map_from_world);
        let inside = lanes & map.holds_lanes(x);
        let unmoved = [Vec3x8::splat(simd, Vec3::X), Vec3x8::splat(simd, Vec3::Y), Vec3x8::splat(simd, Vec3::Z)];
        let mut jets = JetLanes { columns: unmoved, cut_distance_mm: f32x8::splat(simd, f32::INFINITY) };
        if !inside.any_true() {
            return jets;
        }
        let ([.., alpha], [dx, dy, dz]) = map.map.derivatives_lanes(simd, x, inside);
        let marked_slope = dx[3].abs().max(dy[3].abs()).max(dz[3].abs()).simd_ge(MIN_MARKED_SLOPE);
        let direct = inside & alpha.simd_lt(MIN_MARKED_ALPHA) & !marked_slope;
        let d = [of_displacement(dx, map), of_displacement(dy, map), of_displacement(dz, map)];
        let slope = Vec3x8 { x: dx[3], y: dy[3], z: dz[3] };
        let map_from_world = Mat3::from(map.placement.map_from_world.matrix3);
        let across = unmoved.map(|axis| axis.mapped(&map_from_world));
        let gradient = Vec3x8 { x: slope.dot(across[0]), y: slope.dot(across[1]), z: slope.dot(across[2]) }.length();
        jets.cut_distance_mm = (direct & gradient.simd_ge(1e-12)).select((alpha - 0.5) / gradient, jets.cut_distance_mm);
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
        let [x, y, z] = [Vec3x8::splat(simd, Vec3::X), Vec3x8::splat(simd, Vec3::Y), Vec3x8::splat(simd, Vec3::Z)];
        let (mut jx, mut jy, mut jz) = (x, y, z);
        let (mut source, mut at) = (deformed, deformed);
        let (mut at_x, mut at_y, mut at_z) = (x, y, z);
        let mut cut_distance_mm = f32x8::splat(simd, f32::INFINITY);
        for map in self.maps.iter().rev() {
            let x = at.transformed(&map.placement.map_from_world);
            let inside = lanes & map.holds_lanes(x);
            if inside.any_true() {
                let ([sx, sy, sz, alpha], [dx, dy, dz]) = map.map.derivatives_lanes(simd, x, inside);
                let stored = Vec3x8 { x: sx, y: sy, z: sz }.mapped(&map.world_from_stored);
                let d = [of_displacement(dx, map), of_displacement(dy, map), of_displacement(dz, map)];
                let slope = Vec3x8 { x: dx[3], y: dy[3], z: dz[3] };
                let map_from_world = Mat3::from(map.placement.map_from_world.matrix3);
                let (mx, my, mz) = (at_x.mapped(&map_from_world), at_y.mapped(&map_from_world), at_z.mapped(&map_from_world));
                let gradient = Vec3x8 { x: slope.dot(mx), y: slope.dot(my), z: slope.dot(mz) }.length();
                let nearer = inside & gradient.simd_ge(1e-12) & (alpha - 0.5).simd_lt(cut_distance_mm * gradient);
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
        JetLanes { columns: [jx, jy, jz], cut_distance_mm }
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
            let walk = self.stack.source_and_alpha_lanes(simd, Vec3x8::from_lanes(simd, &points), everyone);
            for n in 0..eight.len() {
                self.found.push((walk.source.lane(n), walk.alpha[n]));
            }
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::{Storage, TexelSample};
    use super::*;
    use proptest::prelude::*;

    fn placed(center: Vec3, size: f32, rotate: Vec3, f: impl Fn(Vec3) -> TexelSample + Sync) -> PlacedMap {
        let placement = Placement::new(center, Vec3::splat(size), rotate).unwrap_or_else(|e| panic!("{e}"));
        PlacedMap::new(Arc::new(DisplacementMap::from_fn([17, 19, 15], Storage::F16, f)), placement)
    }

    fn bump(x: Vec3) -> f32 {
        (x * (Vec3::ONE - x) * 4.0).element_product()
    }

    /// Two rotated maps, the upper one of which cuts.
    pub(in crate::deform) fn stack() -> Stack {
        let swirl = placed(Vec3::new(3.0, 0.0, 0.0), 60.0, Vec3::new(20.0, 40.0, -10.0), |x| TexelSample {
            displacement: 0.2 * bump(x) * Vec3::new((9.0 * x.y).sin(), x.z, -1.0),
            alpha: (0.5 + 4.0 * (x.x - 0.4).abs()).min(1.0) - if x.x > 0.35 && x.x < 0.45 { 0.3 } else { 0.0 },
        });
        let push = placed(Vec3::new(-10.0, 5.0, 8.0), 45.0, Vec3::new(0.0, 0.0, 30.0), |x| TexelSample {
            displacement: 0.3 * bump(x) * Vec3::new(1.0, (5.0 * x.x).cos(), 0.2),
            alpha: 1.0,
        });
        Stack::new(vec![swirl, push])
    }

    impl Stack {
        /// The maps repeated.
        pub(in crate::deform) fn repeated(&self, times: usize) -> Stack {
            Stack::new(std::iter::repeat_n(&self.maps, times).flatten().cloned().collect())
        }
    }

    proptest! {
        /// The box walk is conservative: every source point of a box lies in the box's image, and
        /// no mask exceeds the bound.
        #[test]
        fn source_bounds_hold(corner in prop::array::uniform3(-50.0f32..50.0), edge in 0.5f32..20.0, at in prop::array::uniform3(0.0f32..1.0),
                              added: bool, times in 1usize..5) {
            let mut s = stack();
            s.maps[1].added = added;
            s = s.repeated(times);
            let low = Vec3::from(corner);
            let p = low + Vec3::from(at) * edge;
            let (b, [least, most]) = s.source_bounds(&Bounds::new(low, low + edge));
            let jet = s.jet(p);
            prop_assert!(b.grown(1e-3).contains(&Bounds::new(jet.source, jet.source)));
            prop_assert!(least - 1e-5 <= jet.alpha && jet.alpha <= most + 1e-5);
        }
    }

    /// Points on a line give the same results as single points, bit for bit; lines across the map's
    /// axes give none.
    #[test]
    fn lines_are_walked_as_points_are() {
        struct LineKernel<'a>(&'a Stack, [Vec3; LANES], Option<&'a TexelLine>);
        impl SimdKernel for LineKernel<'_> {
            type Output = [(Vec3, f32); LANES];
            #[inline(always)]
            fn run<S: Simd>(self, simd: S) -> Self::Output {
                let walk = self.0.source_and_alpha_on_line(simd, Vec3x8::from_lanes(simd, &self.1), mask32x8::splat(simd, true), self.2);
                std::array::from_fn(|n| (walk.source.lane(n), walk.alpha[n]))
            }
        }
        let mut s = stack();
        let straight = Placement::new(Vec3::new(2.0, 1.0, 0.0), Vec3::splat(50.0), Vec3::ZERO).unwrap_or_else(|e| panic!("{e}"));
        s.maps[1] = PlacedMap::new(s.maps[1].map.clone(), straight);
        assert!(s.line(Vec3::ZERO, Vec3::Y).is_none() && stack().line(Vec3::ZERO, Vec3::X).is_none());
        let mut moved = 0;
        for row in 0..200 {
            let first = Vec3::new(-31.0, (row % 20) as f32 * 3.3 - 30.0, (row / 20) as f32 * 6.1 - 30.0);
            let line = s.line(first, Vec3::X * 1.3);
            assert!(line.is_some());
            for eight in 0..6 {
                let points: [Vec3; LANES] = std::array::from_fn(|n| first + Vec3::X * (1.3 * (eight * LANES + n) as f32));
                let got = with_simd(LineKernel(&s, points, line.as_ref()));
                assert_eq!(got, with_simd(LineKernel(&s, points, None)));
                moved += got.iter().zip(points).filter(|(w, p)| w.0.distance(*p) > 1.0).count();
            }
        }
        assert!(moved > 1000, "{moved}");
    }

    /// Batched walks equal single walks: bit for bit between lanes, and up to rounding against
    /// scalar code, including cut points and added maps.
    #[test]
    fn many_walks_are_single_walks() {
        let mut s = stack();
        for added in [false, true] {
            s.maps[1].added = added;
            let points: Vec<Vec3> = (0..5003).map(|n| Vec3::new((n % 23) as f32, (n / 23 % 19) as f32, (n / 437) as f32) * 4.3 - 45.0).collect();
            let many = s.sources_and_alphas(&points);
            assert!(many.len() == points.len() && many.iter().any(|w| w.1 < 0.5));
            for (p, got) in points.iter().zip(many) {
                assert_eq!(s.sources_and_alphas(&[*p]), [got], "{p}");
                let want = s.source_and_alpha(*p);
                assert!(got.0.abs_diff_eq(want.0, 2e-5) && (got.1 - want.1).abs() < 1e-6, "{p}: {got:?} for {want:?}");
            }
        }
    }

    /// Jacobians and cut distances of eight points at once equal those of single points, also near
    /// the faces of maps and in maps of few texels.
    #[test]
    fn eight_jets_are_single_jets() {
        struct JetsKernel<'a>(&'a Stack, [Vec3; LANES]);
        impl SimdKernel for JetsKernel<'_> {
            type Output = [(Mat3, f32); LANES];
            #[inline(always)]
            fn run<S: Simd>(self, simd: S) -> Self::Output {
                let jets = self.0.jets_lanes(simd, Vec3x8::from_lanes(simd, &self.1), mask32x8::splat(simd, true));
                let [x, y, z] = jets.columns;
                std::array::from_fn(|n| (Mat3::from_cols(x.lane(n), y.lane(n), z.lane(n)), jets.cut_distance_mm[n]))
            }
        }
        let (mut added, mut few) = (stack(), stack());
        added.maps[1].added = true;
        let wave =
            |x: Vec3| TexelSample { displacement: 0.2 * Vec3::new(x.y, (7.0 * x.x).sin(), x.z * x.x), alpha: (0.2 + x.x + 0.3 * x.z).min(1.0) };
        for (map, size) in few.maps.iter_mut().zip([[3, 2, 9], [1, 6, 6]]) {
            *map = PlacedMap::new(Arc::new(DisplacementMap::from_fn(size, Storage::F32, wave)), map.placement);
        }
        for s in [stack(), added, few] {
            let points: Vec<Vec3> = (0..5000).map(|n| Vec3::new((n % 23) as f32, (n / 23 % 19) as f32, (n / 437) as f32) * 4.3 - 45.0).collect();
            let (mut beside, mut turned, mut near) = (0, 0, 0);
            for eight in points.as_chunks::<LANES>().0 {
                for (p, (j, cut_distance_mm)) in eight.iter().zip(with_simd(JetsKernel(&s, *eight))) {
                    let want = s.jet(*p);
                    assert!(j.abs_diff_eq(want.d_source_d_deformed, 2e-4), "{p}: {j} for {}", want.d_source_d_deformed);
                    let same = cut_distance_mm == want.cut.distance_mm
                        || (cut_distance_mm - want.cut.distance_mm).abs() < 1e-3 * (1.0 + want.cut.distance_mm.abs());
                    assert!(same, "{p}: {cut_distance_mm} mm for {}", want.cut.distance_mm);
                    let x = s.maps[1].placement.map_from_world.transform_point3(*p);
                    beside += u32::from(x.min_element() > 0.0 && x.max_element() < 1.0 && x.min_element().min(1.0 - x.max_element()) < 1.0 / 18.0);
                    turned += u32::from(!j.abs_diff_eq(Mat3::IDENTITY, 1e-3));
                    near += u32::from(cut_distance_mm.abs() < 5.0);
                }
            }
            assert!(beside > 50 && turned > 300 && near > 20, "{beside} {turned} {near}");
        }
    }

    #[test]
    fn added_maps_sum_and_their_jacobians_too() {
        let mut s = stack();
        s.maps[1].added = true;
        for p in [Vec3::new(-4.0, 3.0, 6.0), Vec3::new(8.0, -5.0, 2.0)] {
            let sum = s.maps()[0].backward(p).0 + s.maps()[1].backward(p).0 - p;
            let jet = s.jet(p);
            assert!(jet.source.abs_diff_eq(sum, 1e-4) && s.source_and_alpha(p).0.abs_diff_eq(sum, 1e-4) || jet.alpha < 0.5);
            let parts = s.maps().iter().filter_map(|m| m.derivatives(p)).map(|(j, _)| j - Mat3::IDENTITY);
            let want = parts.fold(Mat3::IDENTITY, |a, b| a + b);
            assert!(jet.d_source_d_deformed.abs_diff_eq(want, 1e-5));
        }
    }

    #[test]
    fn order_matters_and_the_walk_is_the_composition() {
        let s = stack();
        let other = Stack::new(s.maps().iter().rev().cloned().collect());
        let p = Vec3::new(-4.0, 3.0, 6.0);
        let (after_push, _) = s.maps()[1].backward(p);
        let (both, _) = s.maps()[0].backward(after_push);
        assert_eq!(s.jet(p).source, both);
        assert!(s.jet(p).source.distance(other.jet(p).source) > 0.5);
    }
}
