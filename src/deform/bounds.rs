//! Bounds on the effect of a stack on boxes, carried backwards map by map ([`crate::model`], "Empty
//! space"), for empty-space skipping.
//!
//! Two bounds on a map's displacements are known. One is a box, from the smallest and largest
//! texels. The other bounds how far they deviate from the displacement of the box's centre, from
//! the smallest and largest differences of neighbouring texels. The second, the mean value form of
//! interval arithmetic (Moore 1966), does not turn a rotation into growth along all axes. Both
//! hold, hence so does their intersection.

use super::lipschitz::spectral_norm;
use super::{PlacedMap, Stack};
use crate::math::Bounds;
use glam::{Affine3A, Mat3, Vec3, Vec3A, Vec4Swizzles};

/// Where displacements differ by less than this fraction of a box, a bound by slopes is no tighter
/// than a box of displacements.
const FLAT_DISPLACEMENT: f32 = 0.25;

/// A box that lies partly in a map's cube is split into two parts, at most this many times; after
/// that it continues as one box around both. The work then grows linearly with the number of maps,
/// not exponentially.
const MAX_SPLITS: u32 = 4;

impl PlacedMap {
    /// A box around the displacements of the points of a box.
    pub(super) fn displacement_bounds(&self, b: &Bounds) -> Bounds {
        let zero = Bounds::new(Vec3::ZERO, Vec3::ZERO);
        self.displacement_range(b)
            .map_or(zero, |m| if m.outside { m.all.union(&zero) } else { m.all })
    }

    /// The displacements and masks of the points of a box that lie in this map's cube, if any do.
    fn displacement_range(&self, b: &Bounds) -> Option<DisplacementRange> {
        let in_map = b.transformed(&self.placement.map_from_world);
        if let Some(cylinder) = &self.cylinder {
            let texel = Vec3::splat(0.01) / Vec3::from(self.map.size.map(|n| n.max(2) as f32));
            let range = cylinder.range(&in_map, self.map.size, 0.01)?;
            let texels = self.map.bounds(range.in_map.min, range.in_map.max);
            let [low, high] = [texels.min, texels.max].map(|v| Vec3::from_slice(&v[..3]) * self.map.scale);
            let all = cylinder
                .displacement_box(&range, low, high)
                .transformed(&Affine3A::from_mat3(cylinder.world_from_local));
            return Some(DisplacementRange {
                all,
                mask: [texels.min[3], texels.max[3]],
                in_map,
                texel,
                outside: range.outside || !self.domain().contains(&in_map),
            });
        }
        // Transforming a sample rounds, and GPUs place samples to 1/256 of a texel; a hundredth of
        // a texel covers both.
        let texel = 0.01 / Vec3::from(self.map.size.map(|n| n.max(2) as f32));
        let in_map = Bounds::new(in_map.min - texel, in_map.max + texel);
        let inside = in_map.intersection(&self.domain());
        if inside.is_empty() {
            return None;
        }
        let range = self.map.bounds(inside.min, inside.max);
        let [low, high] = [range.min, range.max].map(|v| Vec3::from_slice(&v[..3]));
        let all = Bounds::new(low, high).transformed(&Affine3A::from_mat3(self.world_from_stored));
        Some(DisplacementRange {
            all,
            mask: [range.min[3], range.max[3]],
            in_map,
            texel,
            outside: !self.domain().contains(&in_map),
        })
    }

    /// Bounds on the effect of this map on the points of a box that lie in its cube, if any do
    /// ([`crate::model`], "Empty space"), and whether some lie outside.
    fn affine_enclosure(&self, b: &Bounds) -> (Option<AffineEnclosure>, bool) {
        let Some(DisplacementRange {
            all,
            mask,
            in_map,
            texel,
            outside,
        }) = self.displacement_range(b)
        else {
            return (None, true);
        };
        // A bound by slopes is not known round an axis.
        let is_flat = all.size().max_element() < FLAT_DISPLACEMENT * b.size().max_element();
        if self.cylinder.is_some() || is_flat {
            let affine_enclosure = AffineEnclosure {
                all,
                mask,
                at_center: all.center(),
                slope: Mat3::ZERO,
                spread: Mat3::ZERO,
                remainder: all.size() * 0.5,
            };
            return (Some(affine_enclosure), outside);
        }
        // Of the map as extended by its outermost texels, to avoid a jump within the box.
        let at_center = self.world_from_stored
            * self
                .map
                .fetch(self.placement.map_from_world.transform_point3(b.center()))
                .xyz();
        let [slope, spread] = self.slopes_within(&in_map);
        let texel_mm = self.placement.world_from_map.matrix3.abs() * Vec3A::from(texel);
        (
            Some(AffineEnclosure {
                all,
                mask,
                at_center,
                slope,
                spread,
                remainder: (slope.abs() + spread) * Vec3::from(texel_mm),
            }),
            outside,
        )
    }

    /// Whether some texel within one texel of a box has a mask below 1.
    fn mask_varies(&self, b: &Bounds) -> bool {
        if !self.map.has_cuts() {
            return false;
        }
        let in_map = b.transformed(&self.placement.map_from_world);
        if let Some(cylinder) = &self.cylinder {
            return cylinder
                .range(&in_map, self.map.size, 1.01)
                .is_some_and(|r| self.map.bounds(r.in_map.min, r.in_map.max).min[3] < 1.0);
        }
        let texel = 1.01 / Vec3::from(self.map.size.map(|n| (n.max(2) - 1) as f32));
        let around = Bounds::new(in_map.min - texel, in_map.max + texel).intersection(&self.domain());
        !around.is_empty() && self.map.bounds(around.min, around.max).min[3] < 1.0
    }

    /// A bound on |J_G| over a box of the unit cube, for a map wrapped around an axis; at least 1.
    pub(super) fn cylinder_slope_bound(&self, b: &Bounds) -> f32 {
        let Some(cylinder) = &self.cylinder else {
            return 1.0;
        };
        let Some(range) = cylinder.range(b, self.map.size, 1.01) else {
            return 1.0;
        };
        let texels = self.map.bounds(range.in_map.min, range.in_map.max);
        let [low, high] = [texels.min, texels.max].map(|v| Vec3::from_slice(&v[..3]) * self.map.scale);
        let columns = self
            .map
            .slope_bounds(range.in_map.min, range.in_map.max)
            .map(|(low, high)| (low * self.map.scale, high * self.map.scale));
        let skewed = spectral_norm(cylinder.world_from_local) * spectral_norm(cylinder.local_from_world);
        // A box without skew turns; it stretches nothing.
        skewed.max(1.0) * cylinder.slope_bound(&range, low, high, columns).max(1.0)
    }

    /// Centre and half-width of the bounds on J_G - I over a box in map coordinates.
    fn slopes_within(&self, inside: &Bounds) -> [Mat3; 2] {
        let columns = self.map.slope_bounds(inside.min, inside.max);
        let [middle, spread] = [
            |(low, high): (Vec3, Vec3)| (low + high) * 0.5,
            |(low, high): (Vec3, Vec3)| (high - low) * 0.5,
        ]
        .map(|of| Mat3::from_cols(of(columns[0]), of(columns[1]), of(columns[2])));
        let map_from_world = Mat3::from(self.placement.map_from_world.matrix3);
        [
            self.world_from_stored * middle * map_from_world,
            self.world_from_stored.abs() * spread * map_from_world.abs(),
        ]
    }
}

/// Bounds on the displacements (mm) and masks of the points of a box in a map's cube; the box in
/// map coordinates with a margin of `texel`, and whether part of it lies outside.
struct DisplacementRange {
    all: Bounds,
    mask: [f32; 2],
    in_map: Bounds,
    texel: Vec3,
    outside: bool,
}

/// Bounds on the effect of a map, or of several maps added to each other, on the points p of a box
/// with centre c: their displacements lie in `all`, and also in `at_center` + (`slope` ± `spread`)
/// (p - c) ± `remainder`.
struct AffineEnclosure {
    /// mm.
    all: Bounds,
    /// Smallest and largest mask.
    mask: [f32; 2],
    /// The displacement of the centre, mm.
    at_center: Vec3,
    /// Centre of the bounds on the Jacobians.
    slope: Mat3,
    /// Half-width of those bounds.
    spread: Mat3,
    /// mm.
    remainder: Vec3,
}

impl AffineEnclosure {
    /// For points outside every cube.
    const NONE: Self = Self {
        all: Bounds {
            min: Vec3::ZERO,
            max: Vec3::ZERO,
        },
        mask: [1.0; 2],
        at_center: Vec3::ZERO,
        slope: Mat3::ZERO,
        spread: Mat3::ZERO,
        remainder: Vec3::ZERO,
    };

    /// For points of which some lie inside the cube and some outside.
    fn including_zero(&self) -> Self {
        let all = self.all.union(&Self::NONE.all);
        let mask = [self.mask[0].min(1.0), self.mask[1].max(1.0)];
        Self {
            all,
            mask,
            at_center: all.center(),
            remainder: all.size() * 0.5,
            ..Self::NONE
        }
    }

    /// For two maps that are added to each other.
    fn sum(&self, other: &Self) -> Self {
        Self {
            all: Bounds::new(self.all.min + other.all.min, self.all.max + other.all.max),
            mask: [self.mask[0].min(other.mask[0]), self.mask[1].min(other.mask[1])],
            at_center: self.at_center + other.at_center,
            slope: self.slope + other.slope,
            spread: self.spread + other.spread,
            remainder: self.remainder + other.remainder,
        }
    }

    /// A box around the source points of `b`: the intersection of both bounds.
    fn source(&self, b: &Bounds) -> Bounds {
        let (center, half) = (b.center() + self.at_center, b.size() * 0.5);
        let half = ((Mat3::IDENTITY + self.slope).abs() + self.spread) * half + self.remainder;
        Bounds::new(b.min + self.all.min, b.max + self.all.max)
            .intersection(&Bounds::new(center - half, center + half))
    }
}

impl Stack {
    /// Carries a box of deformed points back to the source. Returns a box around all their source
    /// points, and the smallest and largest value that the smallest mask can have (at or above 1/2:
    /// nothing in the box is cut away; below: everything).
    pub fn source_bounds(&self, deformed: &Bounds) -> (Bounds, [f32; 2]) {
        let (mut all, mut alpha) = (Bounds::EMPTY, [1.0f32, 0.0]);
        self.source_parts(deformed, &mut |part, [low, high]| {
            all = all.union(part);
            alpha = [alpha[0].min(low), alpha[1].max(high)];
        });
        (all, alpha)
    }

    /// As [`Self::source_bounds`], in parts: the sources of points inside and outside a map's cube
    /// may be far apart.
    pub fn source_parts(&self, deformed: &Bounds, found: &mut dyn FnMut(&Bounds, [f32; 2])) {
        let mut grown =
            |part: &Bounds, alpha: [f32; 2]| found(&part.grown(self.precompose_error_mm()), alpha);
        self.parts_of(
            self.maps().len(),
            MAX_SPLITS,
            deformed,
            &AffineEnclosure::NONE,
            [1.0; 2],
            &mut grown,
        );
    }

    /// Largest distance between these sources and those of the maps, mm: the error bound of the
    /// precomposed map.
    pub fn precompose_error_mm(&self) -> f32 {
        self.precomposed().map_or(0.0, |s| s.bound_mm)
    }

    /// Through the first `count` maps, with `splits_left` splits left; `together` is the effect of
    /// the maps already passed that are added to the next one.
    fn parts_of(
        &self,
        count: usize,
        splits_left: u32,
        at: &Bounds,
        together: &AffineEnclosure,
        alpha: [f32; 2],
        found: &mut dyn FnMut(&Bounds, [f32; 2]),
    ) {
        let Some(map) = count.checked_sub(1).map(|n| &self.maps()[n]) else {
            return found(at, alpha);
        };
        let mut go_on = |affine_enclosure: &AffineEnclosure, splits_left: u32| {
            let alpha = [
                alpha[0].min(affine_enclosure.mask[0]),
                alpha[1].min(affine_enclosure.mask[1]),
            ];
            let together = together.sum(affine_enclosure);
            if map.added {
                self.parts_of(count - 1, splits_left, at, &together, alpha, found);
            } else {
                self.parts_of(
                    count - 1,
                    splits_left,
                    &together.source(at),
                    &AffineEnclosure::NONE,
                    alpha,
                    found,
                );
            }
        };
        match map.affine_enclosure(at) {
            (None, _) => go_on(&AffineEnclosure::NONE, splits_left),
            (Some(inside), false) => go_on(&inside, splits_left),
            (Some(inside), true) if splits_left == 0 => go_on(&inside.including_zero(), 0),
            (Some(inside), true) => {
                go_on(&inside, splits_left - 1);
                go_on(&AffineEnclosure::NONE, splits_left - 1);
            }
        }
    }

    /// Whether any mask's value or derivative ([`super::DisplacementMap::derivatives`]) may differ
    /// from those of an uncut region, anywhere in a box of deformed points.
    pub fn mask_varies(&self, deformed: &Bounds) -> bool {
        if !self.has_cuts() {
            return false;
        }
        let (mut b, mut at) = (*deformed, *deformed);
        for map in self.maps().iter().rev() {
            if map.mask_varies(&at) {
                return true;
            }
            let moved = map.displacement_bounds(&at);
            b = Bounds::new(b.min + moved.min, b.max + moved.max);
            if !map.added {
                at = b;
            }
        }
        false
    }

    /// Whether any mask removes anything.
    pub fn has_cuts(&self) -> bool {
        self.maps().iter().any(|m| m.map.has_cuts())
    }

    /// A bound on the norm of d source / d deformed anywhere, at least 1.
    pub fn lipschitz_bound(&self) -> f32 {
        let (mut all, mut together) = (1.0f32, 1.0f32);
        for map in self.maps().iter().rev() {
            together += match &map.cylinder {
                Some(_) => map.cylinder_slope_bound(&Bounds::UNIT) - 1.0,
                None => {
                    let [middle, half] = map.slopes_within(&map.domain());
                    spectral_norm(middle) + half.to_cols_array().iter().map(|v| v * v).sum::<f32>().sqrt()
                }
            };
            if !map.added {
                all *= together;
                together = 1.0;
            }
        }
        // With hundreds of maps the product may overflow.
        all.min(f32::MAX)
    }

    /// A box around the deformed scene: the source's box and every cube into which a map can move
    /// part of it.
    pub fn deformed_bounds(&self, source: &Bounds) -> Bounds {
        let mut all = source.grown(self.precompose_error_mm());
        for map in self.maps().iter().filter(|m| m.map.has_displacement()) {
            let cube = map.bounds_in_world();
            let moved = map.displacement_bounds(&cube);
            let reach = Bounds::new(cube.min + moved.min, cube.max + moved.max);
            if !reach.intersection(&all).is_empty() {
                all = all.union(&cube);
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DisplacementMap, Placement, Storage, TexelSample};
    use super::*;
    use std::sync::Arc;

    /// A rotation takes a box to a rotated box: its bounds are those of the rotated box, not the
    /// sum of the displacements of its parts.
    #[test]
    fn bounds_of_a_rotation_are_those_of_the_rotated_box() {
        let turn = Mat3::from_rotation_z(0.8);
        let f = |x: Vec3| TexelSample {
            displacement: turn * (x - 0.5) - (x - 0.5),
            alpha: 1.0,
        };
        let placement = Placement::new(Vec3::ZERO, Vec3::splat(60.0), Vec3::new(20.0, 40.0, -10.0))
            .unwrap_or_else(|e| panic!("{e}"));
        let linear = Mat3::from(placement.world_from_map.matrix3)
            * turn
            * Mat3::from(placement.map_from_world.matrix3);
        let map = PlacedMap::new(
            Arc::new(DisplacementMap::from_fn([17, 19, 15], Storage::F32, f)),
            placement,
        );
        let b = Bounds::new(Vec3::new(-8.0, 2.0, 1.0), Vec3::new(-4.0, 5.0, 6.0));
        let (got, _) = Stack::new(vec![map]).source_bounds(&b);
        let want = b.transformed(&Affine3A::from_mat3(linear));
        assert!(
            got.grown(1e-3).contains(&want) && want.grown(0.1).contains(&got),
            "{got:?} for {want:?}"
        );
    }

    /// The work grows linearly with the number of maps, although a box may lie partly in the cube
    /// of each.
    #[test]
    fn a_box_goes_on_as_few_parts() {
        let mut parts = 0;
        super::super::stack::tests::stack().repeated(100).source_parts(
            &Bounds::new(Vec3::splat(-200.0), Vec3::splat(200.0)),
            &mut |_, _| parts += 1,
        );
        assert_eq!(parts, 1 << MAX_SPLITS);
    }

    /// Where no mask is reported to vary there is neither a cut nor a slope of one; no Jacobian
    /// exceeds the bound.
    #[test]
    fn what_is_said_of_boxes_holds_for_their_points() {
        let (mut clear, mut steepest) = (0, 0.0f32);
        for added in [false, true] {
            let mut maps = super::super::stack::tests::stack().maps().to_vec();
            maps[1].added = added;
            let s = Stack::new(maps);
            for n in 0..4000 {
                let p = Vec3::new((n % 20) as f32, (n / 20 % 20) as f32, (n / 400) as f32 * 2.0) * 4.1 - 40.0;
                let jet = s.jet(p);
                if !s.mask_varies(&Bounds::new(p - 1.5, p + 0.5)) {
                    assert!(
                        jet.alpha == 1.0 && jet.cut.distance_mm == f32::INFINITY,
                        "{p}: {:?}",
                        jet.cut
                    );
                    clear += 1;
                }
                let own = spectral_norm(jet.d_source_d_deformed);
                assert!(
                    own <= s.lipschitz_bound() * 1.0001,
                    "{p}: {own} of {}",
                    s.lipschitz_bound()
                );
                steepest = steepest.max(own / s.lipschitz_bound());
            }
        }
        assert!(
            clear > 4000 && clear < 7900 && steepest > 0.1,
            "{clear} {steepest}"
        );
    }
}
