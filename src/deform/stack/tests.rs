//! Walks through stacks: bounds, lines, eight points at once, and order.

use super::super::{Storage, TexelSample};
use super::lanes::TexelLine;
use super::*;
use crate::math::lanes::*;
use proptest::prelude::*;

fn placed(center: Vec3, size: f32, rotate: Vec3, f: impl Fn(Vec3) -> TexelSample + Sync) -> PlacedMap {
    let placement = Placement::new(center, Vec3::splat(size), rotate).unwrap_or_else(|e| panic!("{e}"));
    PlacedMap::new(
        Arc::new(DisplacementMap::from_fn([17, 19, 15], Storage::F16, f)),
        placement,
    )
}

fn bump(x: Vec3) -> f32 {
    (x * (Vec3::ONE - x) * 4.0).element_product()
}

/// Two rotated maps, the upper one of which cuts.
pub(in crate::deform) fn stack() -> Stack {
    let swirl = placed(
        Vec3::new(3.0, 0.0, 0.0),
        60.0,
        Vec3::new(20.0, 40.0, -10.0),
        |x| TexelSample {
            displacement: 0.2 * bump(x) * Vec3::new((9.0 * x.y).sin(), x.z, -1.0),
            alpha: (0.5 + 4.0 * (x.x - 0.4).abs()).min(1.0)
                - if x.x > 0.35 && x.x < 0.45 { 0.3 } else { 0.0 },
        },
    );
    let push = placed(Vec3::new(-10.0, 5.0, 8.0), 45.0, Vec3::new(0.0, 0.0, 30.0), |x| {
        TexelSample {
            displacement: 0.3 * bump(x) * Vec3::new(1.0, (5.0 * x.x).cos(), 0.2),
            alpha: 1.0,
        }
    });
    Stack::new(vec![swirl, push])
}

impl Stack {
    /// The maps repeated.
    pub(in crate::deform) fn repeated(&self, times: usize) -> Stack {
        Stack::new(
            std::iter::repeat_n(&self.maps, times)
                .flatten()
                .cloned()
                .collect(),
        )
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
            let walk = self.0.source_and_alpha_on_line(
                simd,
                Vec3x8::from_lanes(simd, &self.1),
                mask32x8::splat(simd, true),
                self.2,
            );
            std::array::from_fn(|n| (walk.source.lane(n), walk.alpha[n]))
        }
    }
    let mut s = stack();
    let straight = Placement::new(Vec3::new(2.0, 1.0, 0.0), Vec3::splat(50.0), Vec3::ZERO)
        .unwrap_or_else(|e| panic!("{e}"));
    s.maps[1] = PlacedMap::new(s.maps[1].map.clone(), straight);
    assert!(s.line(Vec3::ZERO, Vec3::Y).is_none() && stack().line(Vec3::ZERO, Vec3::X).is_none());
    let mut moved = 0;
    for row in 0..200 {
        let first = Vec3::new(
            -31.0,
            (row % 20) as f32 * 3.3 - 30.0,
            (row / 20) as f32 * 6.1 - 30.0,
        );
        let line = s.line(first, Vec3::X * 1.3);
        assert!(line.is_some());
        for eight in 0..6 {
            let points: [Vec3; LANES] =
                std::array::from_fn(|n| first + Vec3::X * (1.3 * (eight * LANES + n) as f32));
            let got = with_simd(LineKernel(&s, points, line.as_ref()));
            assert_eq!(got, with_simd(LineKernel(&s, points, None)));
            moved += got
                .iter()
                .zip(points)
                .filter(|(w, p)| w.0.distance(*p) > 1.0)
                .count();
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
        let points: Vec<Vec3> = (0..5003)
            .map(|n| Vec3::new((n % 23) as f32, (n / 23 % 19) as f32, (n / 437) as f32) * 4.3 - 45.0)
            .collect();
        let many = s.sources_and_alphas(&points);
        assert!(many.len() == points.len() && many.iter().any(|w| w.1 < 0.5));
        for (p, got) in points.iter().zip(many) {
            assert_eq!(s.sources_and_alphas(&[*p]), [got], "{p}");
            let want = s.source_and_alpha(*p);
            assert!(
                got.0.abs_diff_eq(want.0, 2e-5) && (got.1 - want.1).abs() < 1e-6,
                "{p}: {got:?} for {want:?}"
            );
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
            let jets = self.0.jets_lanes(
                simd,
                Vec3x8::from_lanes(simd, &self.1),
                mask32x8::splat(simd, true),
            );
            let [x, y, z] = jets.columns;
            std::array::from_fn(|n| {
                (
                    Mat3::from_cols(x.lane(n), y.lane(n), z.lane(n)),
                    jets.cut_distance_mm[n],
                )
            })
        }
    }
    let (mut added, mut few) = (stack(), stack());
    added.maps[1].added = true;
    let wave = |x: Vec3| TexelSample {
        displacement: 0.2 * Vec3::new(x.y, (7.0 * x.x).sin(), x.z * x.x),
        alpha: (0.2 + x.x + 0.3 * x.z).min(1.0),
    };
    for (map, size) in few.maps.iter_mut().zip([[3, 2, 9], [1, 6, 6]]) {
        *map = PlacedMap::new(
            Arc::new(DisplacementMap::from_fn(size, Storage::F32, wave)),
            map.placement,
        );
    }
    for s in [stack(), added, few] {
        let points: Vec<Vec3> = (0..5000)
            .map(|n| Vec3::new((n % 23) as f32, (n / 23 % 19) as f32, (n / 437) as f32) * 4.3 - 45.0)
            .collect();
        let (mut beside, mut turned, mut near) = (0, 0, 0);
        for eight in points.as_chunks::<LANES>().0 {
            for (p, (j, cut_distance_mm)) in eight.iter().zip(with_simd(JetsKernel(&s, *eight))) {
                let want = s.jet(*p);
                assert!(
                    j.abs_diff_eq(want.d_source_d_deformed, 2e-4),
                    "{p}: {j} for {}",
                    want.d_source_d_deformed
                );
                let same = cut_distance_mm == want.cut.distance_mm
                    || (cut_distance_mm - want.cut.distance_mm).abs()
                        < 1e-3 * (1.0 + want.cut.distance_mm.abs());
                assert!(same, "{p}: {cut_distance_mm} mm for {}", want.cut.distance_mm);
                let x = s.maps[1].placement.map_from_world.transform_point3(*p);
                beside += u32::from(
                    x.min_element() > 0.0
                        && x.max_element() < 1.0
                        && x.min_element().min(1.0 - x.max_element()) < 1.0 / 18.0,
                );
                turned += u32::from(!j.abs_diff_eq(Mat3::IDENTITY, 1e-3));
                near += u32::from(cut_distance_mm.abs() < 5.0);
            }
        }
        assert!(
            beside > 50 && turned > 300 && near > 20,
            "{beside} {turned} {near}"
        );
    }
}

#[test]
fn added_maps_sum_and_their_jacobians_too() {
    let mut s = stack();
    s.maps[1].added = true;
    for p in [Vec3::new(-4.0, 3.0, 6.0), Vec3::new(8.0, -5.0, 2.0)] {
        let sum = s.maps()[0].backward(p).0 + s.maps()[1].backward(p).0 - p;
        let jet = s.jet(p);
        assert!(
            jet.source.abs_diff_eq(sum, 1e-4) && s.source_and_alpha(p).0.abs_diff_eq(sum, 1e-4)
                || jet.alpha < 0.5
        );
        let parts = s
            .maps()
            .iter()
            .filter_map(|m| m.derivatives(p))
            .map(|(j, _)| j - Mat3::IDENTITY);
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
