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

mod lanes;

pub use lanes::TexelLine;

use super::mapping::Cylinder;
use super::texel::{MIN_MARKED_ALPHA, MIN_MARKED_SLOPE};
use super::{DisplacementMap, MapFilter, Placement, TexelSample};
use crate::math::Bounds;
use glam::{Mat3, Vec3, Vec4Swizzles};
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
    /// The coordinate mapping that wraps the map around an axis, if there is one.
    pub cylinder: Option<Cylinder>,
    /// `world_from_map`'s linear part times the map's scale: from stored displacement to mm.
    pub(super) world_from_stored: Mat3,
    /// How it is interpolated and differentiated.
    pub filter: MapFilter,
}

impl PartialEq for PlacedMap {
    /// Identity of the map, not equality of its content: the same map with the same placement.
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.map, &other.map)
            && (self.placement, self.added, self.reach, self.cylinder)
                == (other.placement, other.added, other.reach, other.cylinder)
            && self.filter == other.filter
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
    pub const NONE: Self = Self {
        distance_mm: f32::INFINITY,
        normal: Vec3::ZERO,
    };

    /// The nearer of this cut and the surface where `value` (positive inside) falls to zero with
    /// the given gradient in the deformed scene: to first order, the distance is value /
    /// |gradient|.
    #[inline(always)]
    pub fn nearer_of(self, value: f32, gradient: Vec3) -> Self {
        let slope = gradient.length();
        if slope < 1e-12 || value >= self.distance_mm * slope {
            return self;
        }
        Self {
            distance_mm: value / slope,
            normal: gradient / -slope,
        }
    }
}

impl PlacedMap {
    /// Puts a map into the world.
    pub fn new(map: Arc<DisplacementMap>, placement: Placement) -> Self {
        let world_from_stored = Mat3::from(placement.world_from_map.matrix3) * map.scale;
        Self {
            map,
            placement,
            added: false,
            reach: Vec3::ZERO,
            cylinder: None,
            world_from_stored,
            filter: MapFilter::default(),
        }
    }

    /// The same map wrapped around the z axis of its box.
    pub fn mapped_cylindrically(mut self) -> Self {
        self.reach = Vec3::ZERO;
        self.cylinder = Some(Cylinder::new(&self.placement, self.map.size[2]));
        self
    }

    /// The same map, interpolated with weights of 8 bits as by filtering hardware if `short_weights`,
    /// and differentiated by slopes stored for each texel if `stored_slopes`.
    pub fn filtered(mut self, short_weights: bool, stored_slopes: bool) -> Self {
        self.filter = MapFilter {
            has_short_weights: short_weights,
            slopes: stored_slopes.then(|| self.map.slopes(self.cylinder.is_some())),
        };
        self
    }

    /// A map wrapped around an axis, resampled onto a regular grid of its box, for files that state no
    /// mapping; any other map as it is.
    pub fn on_regular_grid(&self) -> Self {
        let Some(cylinder) = &self.cylinder else {
            return self.clone();
        };
        let [_, along, away] = self.map.size;
        // As fine across the axis as away from it.
        let across = (2 * away).clamp(2, 256);
        let map = DisplacementMap::from_fn([across, across, along], self.map.storage, |x| {
            match cylinder.displacement(&self.map, &self.filter, x) {
                Some((local_mm, alpha)) => TexelSample {
                    displacement: local_mm / cylinder.box_mm,
                    alpha,
                },
                None => TexelSample {
                    displacement: Vec3::ZERO,
                    alpha: 1.0,
                },
            }
        });
        Self {
            added: self.added,
            reach: self.reach,
            ..Self::new(Arc::new(map), self.placement)
        }
    }

    /// Size of its texels, with stored slopes if it has them.
    pub fn stored_bytes(&self) -> usize {
        self.map.stored_bytes() + self.filter.slopes.as_ref().map_or(0, |s| s.stored_bytes())
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

    /// Displacement, mm, and mask at a point.
    #[inline(always)]
    fn displacement(&self, p: Vec3) -> (Vec3, f32) {
        let x = self.placement.map_from_world.transform_point3(p);
        if self.is_outside(x) {
            return (Vec3::ZERO, 1.0);
        }
        if let Some(cylinder) = &self.cylinder {
            return cylinder
                .displacement(&self.map, &self.filter, x)
                .map_or((Vec3::ZERO, 1.0), |(d, alpha)| {
                    (cylinder.world_from_local * d, alpha)
                });
        }
        let t = self.filter.fetch(&self.map, x);
        (self.world_from_stored * t.xyz(), t.w)
    }

    /// Displacement, mm, and mask at a point of the unit cube; needs no texels.
    pub fn displacement_at(&self, x: Vec3) -> (Vec3, f32) {
        if self.cylinder.is_some() {
            return self.displacement(self.placement.world_from_map.transform_point3(x));
        }
        let sample = self.map.sample_lazily(x);
        let linear = Mat3::from(self.placement.world_from_map.matrix3);
        (linear * sample.displacement, sample.alpha)
    }

    /// J_G and the mask's gradient per mm at a point, or none outside the cube. J_G = I + A J_D
    /// A⁻¹.
    pub fn derivatives(&self, p: Vec3) -> Option<(Mat3, Vec3)> {
        let x = self.placement.map_from_world.transform_point3(p);
        if self.is_outside(x) {
            return None;
        }
        if let Some(cylinder) = &self.cylinder {
            let (j, slope) = cylinder.derivatives(&self.map, &self.filter, x)?;
            let (to, from) = (cylinder.world_from_local, cylinder.local_from_world);
            return Some((to * j * from, from.transpose() * slope));
        }
        let (j, slope) = self.filter.derivatives(&self.map, x);
        let inverse = Mat3::from(self.placement.map_from_world.matrix3);
        let linear = Mat3::from(self.placement.world_from_map.matrix3);
        Some((Mat3::IDENTITY + linear * j * inverse, inverse.transpose() * slope))
    }

    /// The cube in the world.
    pub fn bounds_in_world(&self) -> Bounds {
        self.domain().transformed(&self.placement.world_from_map)
    }
}

impl Stack {
    /// The source of a point that map `n` has yet to be applied to, through all maps before it, and
    /// the smallest mask on the way; needs no texels.
    pub fn source_before(&self, n: usize, p: Vec3) -> (Vec3, f32) {
        let (mut p, mut here, mut alpha) = (p, p, 1.0f32);
        for map in self.maps[..n].iter().rev() {
            let x = map.placement.map_from_world.transform_point3(here);
            if !map.is_outside(x) {
                let (displacement, own) = map.displacement_at(x.clamp(Vec3::ZERO, Vec3::ONE));
                p += displacement;
                alpha = alpha.min(own);
            }
            if !map.added {
                here = p;
            }
        }
        (p, alpha)
    }
}

impl PrecomposedMap {
    /// The jet at a point; none where the maps themselves must be walked.
    fn jet(&self, deformed: Vec3) -> Option<Jet> {
        let (d, alpha) = self.map.displacement(deformed);
        let unmoved = Jet {
            source: deformed,
            d_source_d_deformed: Mat3::IDENTITY,
            cut: NearestCut::NONE,
            alpha: 1.0,
        };
        let x = self.map.placement.map_from_world.transform_point3(deformed);
        if self.map.is_outside(x) {
            return Some(unmoved);
        }
        let (_, slope_in_map) = self.map.map.derivatives(x);
        if alpha >= MIN_MARKED_ALPHA || slope_in_map.abs().max_element() >= MIN_MARKED_SLOPE {
            return None;
        }
        let (j, slope) = self.map.derivatives(deformed)?;
        Some(Jet {
            source: deformed + d,
            d_source_d_deformed: j,
            cut: NearestCut::NONE.nearer_of(alpha - 0.5, slope),
            alpha,
        })
    }
}

impl Stack {
    /// Ensures that all texels are sampled before many threads need them.
    pub fn fetch_texels(&self) {
        self.all_maps().for_each(|m| m.map.fetch_texels());
    }

    /// The same stack with every map as [`PlacedMap::filtered`]. A precomposed map keeps its
    /// differences, which find its marked texels.
    pub fn filtered(mut self, short_weights: bool, stored_slopes: bool) -> Self {
        let filtered = |map: PlacedMap| map.filtered(short_weights, stored_slopes);
        self.maps = self.maps.into_iter().map(filtered).collect();
        self.precomposed = self.precomposed.map(|mut precomposed| {
            precomposed.map = precomposed.map.filtered(short_weights, false);
            precomposed
        });
        self
    }

    /// A stack of maps in order of application.
    pub fn new(mut maps: Vec<PlacedMap>) -> Self {
        // The first map has no predecessor to be added to.
        if let Some(first) = maps.first_mut() {
            first.added = false;
        }
        Self {
            maps,
            precomposed: None,
        }
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
        let mut jet = Jet {
            source: deformed,
            d_source_d_deformed: Mat3::IDENTITY,
            cut: NearestCut::NONE,
            alpha: 1.0,
        };
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
}

#[cfg(test)]
pub(super) mod tests;
