//! Signed distance fields of a label, a mask or an iso-value of a scan. Feature-aligned
//! deformations follow them, and spared labels are tested with them. Millimetres, positive inside
//! ([`crate::model`], "Surfaces").
//!
//! The distance is exact to the voxels' boxes; one pass of a 1-2-1 filter removes their staircase.
//! Near the surface of labels it is that to their smoothed surface ([`smooth_mask`]).

use crate::math::arrays::shaped;
use crate::math::distance::{connected, largest_part, squared_distance};
use crate::math::{DistanceGrid, flat, redistance, smoothstep, to_f32};
use crate::volume::{Volume, smooth_mask};
use glam::{Affine3A, Vec3};
use ndarray::{Array3, Axis, Zip};

/// Openings of a body that are narrower than twice this are closed, mm.
const CLOSING_MM: f32 = 6.0;
/// Maximum number of voxels of a field; larger volumes are subsampled at every second voxel, or
/// every fourth.
const MAX_VOXELS: usize = 1 << 25;

/// Which voxels are inside.
pub enum RegionSource<'a> {
    /// Voxels with one of these values.
    Labels(&'a [usize]),
    /// Voxels above zero.
    Mask,
    /// The largest connected part at or above a value, with its cavities filled: a body, not its
    /// pores.
    Body(f64),
}

/// The distance field of a region; none if the region is empty or fills the volume. `smooth`
/// removes the staircase of the voxels.
pub fn of_region(volume: &Volume, region: &RegionSource, smooth: bool) -> Option<DistanceGrid> {
    let mut stride = 1;
    while volume.size.iter().map(|n| n.div_ceil(stride)).product::<usize>() > MAX_VOXELS {
        stride *= 2;
    }
    let size = volume.size.map(|n| n.div_ceil(stride));
    // A list of thousands of labels is indexed, not searched, for each of millions of voxels.
    let wanted = match region {
        RegionSource::Labels(labels) => LabelSet::new(labels),
        _ => LabelSet::default(),
    };
    let inside = |value: f64| match region {
        RegionSource::Labels(_) => wanted.holds(value),
        RegionSource::Mask => value > 0.0,
        RegionSource::Body(iso) => value >= *iso,
    };
    let mut mask = Array3::default((size[2], size[1], size[0]));
    Zip::indexed(&mut mask)
        .par_for_each(|(k, j, i), m| *m = inside(volume.value(i * stride, j * stride, k * stride)));
    let spacing = (volume.spacing_mm() * stride as f64).as_vec3();
    if matches!(region, RegionSource::Body(_)) {
        mask = body(largest_part(&mask), spacing);
    }
    let count = mask.iter().filter(|m| **m).count();
    if count == 0 || count == mask.len() {
        return None;
    }
    let near = match region {
        RegionSource::Labels(_) if smooth => Some(near_surface(&mask, size, spacing)),
        _ => None,
    };
    let to_inside = squared_distance(&mask, spacing.into());
    mask.par_mapv_inplace(|m| !m);
    let to_outside = squared_distance(&mask, spacing.into());
    let signed = Zip::from(&to_outside)
        .and(&to_inside)
        .par_map_collect(|o, i| o.sqrt() - i.sqrt());
    let world_from_grid = to_f32(&volume.world_from_voxel) * Affine3A::from_scale(Vec3::splat(stride as f32));
    Some(DistanceGrid::new(
        match near {
            Some(near) => joined(near, &signed, spacing.max_element()),
            None if smooth => keeping_sides(smoothed(signed.clone()), &signed),
            None => signed,
        },
        world_from_grid,
    ))
}

/// Small labels as a bit table; larger ones as a set.
#[derive(Default)]
struct LabelSet {
    bits: Vec<u64>,
    large: std::collections::HashSet<usize>,
}

impl LabelSet {
    /// Number of labels in the table: 128 KiB.
    const SMALL: usize = 1 << 20;

    fn new(labels: &[usize]) -> Self {
        let (small, large): (Vec<usize>, Vec<usize>) = labels.iter().partition(|l| **l < Self::SMALL);
        let mut bits = vec![0u64; small.iter().max().map_or(0, |l| l / 64 + 1)];
        small.iter().for_each(|l| bits[l / 64] |= 1 << (l % 64));
        Self {
            bits,
            large: large.into_iter().collect(),
        }
    }

    #[inline(always)]
    fn holds(&self, value: f64) -> bool {
        let label = value as usize;
        let listed = |bits: &u64| bits >> (label % 64) & 1 == 1;
        label as f64 == value
            && (self.bits.get(label / 64).is_some_and(listed)
                || !self.large.is_empty() && self.large.contains(&label))
    }
}

/// Voxels from the surface of labels within which distances are those to their smoothed surface,
/// and beyond which they are those to the voxels' boxes.
const NEAR_VOXELS: [f32; 2] = [2.0, 4.0];

/// Distances to the smoothed surface of a mask, near it.
fn near_surface(mask: &Array3<bool>, size: [usize; 3], spacing: Vec3) -> Array3<f32> {
    let mut values: Vec<f32> = smooth_mask(flat(mask), size).into_iter().map(f32::from).collect();
    redistance(
        &mut values,
        size,
        spacing.into(),
        (NEAR_VOXELS[1] + 1.0) * spacing.max_element(),
    );
    shaped(size, values)
}

/// Distances that change from those near the surface to those far from it.
fn joined(mut near: Array3<f32>, far: &Array3<f32>, voxel_mm: f32) -> Array3<f32> {
    let [from, to] = NEAR_VOXELS;
    Zip::from(&mut near).and(far).par_for_each(|near, far| {
        let share = smoothstep(from, to, far.abs() / voxel_mm);
        *near += (far - *near) * share;
    });
    near
}

/// Smoothing must not lose structures one voxel thick: every point stays on its side.
fn keeping_sides(mut smooth: Array3<f32>, signed: &Array3<f32>) -> Array3<f32> {
    Zip::from(&mut smooth).and(signed).par_for_each(|s, d| {
        *s = if *d > 0.0 {
            s.max(0.25 * d)
        } else {
            s.min(0.25 * d)
        }
    });
    smooth
}

/// A body without its openings and cavities: closed by [`CLOSING_MM`] (so that a nostril or an ear
/// does not connect its inside to the outside), then filled.
fn body(mask: Array3<bool>, spacing: Vec3) -> Array3<bool> {
    let beyond =
        |set: &Array3<bool>| squared_distance(set, spacing.into()).mapv(|d| d > CLOSING_MM * CLOSING_MM);
    let open = beyond(&mask);
    let (nk, nj, ni) = mask.dim();
    let is_at_face = |&(k, j, i): &(usize, usize, usize)| {
        [(k, nk), (j, nj), (i, ni)]
            .iter()
            .any(|(c, n)| *c == 0 || c + 1 == *n)
    };
    let shell = ndarray::indices((nk, nj, ni))
        .into_iter()
        .filter(is_at_face)
        .map(|(k, j, i)| [i, j, k]);
    let outside = connected(&open, shell);
    // The growth is taken back, but no voxel of the body itself.
    beyond(&outside) | mask
}

/// A 1-2-1 filter along each axis.
fn smoothed(mut values: Array3<f32>) -> Array3<f32> {
    for axis in [Axis(2), Axis(1), Axis(0)] {
        let mut filtered = values.clone();
        Zip::from(filtered.lanes_mut(axis))
            .and(values.lanes(axis))
            .par_for_each(|mut to, from| {
                let last = from.len() - 1;
                for c in 0..=last {
                    let (before, after) = (from[c.saturating_sub(1)], from[(c + 1).min(last)]);
                    to[c] = 0.25 * before + 0.5 * from[c] + 0.25 * after;
                }
            });
        values = filtered;
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{Rescale, Volume};
    use glam::{DAffine3, DVec3};

    /// A ball of 20 mm on an anisotropic, oblique grid.
    fn ball() -> Volume {
        let world_from_voxel =
            DAffine3::from_rotation_z(0.4) * DAffine3::from_scale(DVec3::new(1.0, 1.5, 2.0));
        let size = [61, 41, 31];
        let center = world_from_voxel.transform_point3(DVec3::new(30.0, 20.0, 15.0));
        let voxels: Vec<u8> = (0..size[0] * size[1] * size[2])
            .map(|n| {
                let p = world_from_voxel.transform_point3(DVec3::new(
                    (n % 61) as f64,
                    (n / 61 % 41) as f64,
                    (n / 2501) as f64,
                ));
                let r = p.distance(center);
                // A cavity in the middle.
                if r < 20.0 && r > 4.0 { 100 } else { 0 }
            })
            .collect();
        Volume::new(
            crate::volume::Voxels::new(size, voxels),
            Rescale::NONE,
            world_from_voxel,
        )
    }

    #[test]
    fn labels_are_looked_up() {
        let set = LabelSet::new(&[0, 3, 64, 1_000_000, 614_454_277]);
        for (value, held) in [
            (614_454_277.0, true),
            (614_454_276.0, false),
            (0.0, true),
            (3.0, true),
            (3.5, false),
            (4.0, false),
            (64.0, true),
            (1e6, true),
            (-1.0, false),
            (1e18, false),
            (f64::NAN, false),
        ] {
            assert_eq!(set.holds(value), held, "{value}");
        }
        assert!(!LabelSet::default().holds(0.0));
    }

    #[test]
    fn a_ball_has_its_distance_and_its_cavity_counts_only_for_a_mask() {
        let volume = ball();
        let center = volume
            .world_from_voxel
            .transform_point3(DVec3::new(30.0, 20.0, 15.0))
            .as_vec3();
        let body = of_region(&volume, &RegionSource::Body(50.0), true).unwrap_or_else(|| panic!());
        for (direction, r) in [
            (Vec3::X, 5.0),
            (Vec3::Y, 12.0),
            (Vec3::new(0.6, 0.0, 0.8), 18.0),
            (Vec3::Z, 24.0),
        ] {
            let d = body.sample(center + direction * r);
            assert!((d - (20.0 - r)).abs() < 1.2, "{d} at {r} mm");
        }
        // Outside the grid the value never exceeds the true distance.
        assert!((-40.5..=-30.0).contains(&body.sample(center + Vec3::NEG_Y * 60.0)));
        let g = body.gradient(center + Vec3::X * 15.0, 1.0);
        assert!((g - Vec3::NEG_X).length() < 0.15, "{g}");
        let mask = of_region(&volume, &RegionSource::Mask, true).unwrap_or_else(|| panic!());
        assert!(mask.sample(center) < 0.0 && body.sample(center) > 15.0);
        assert!(of_region(&volume, &RegionSource::Labels(&[7]), true).is_none());
        assert!(
            of_region(&volume, &RegionSource::Labels(&[100]), true).is_some_and(|f| f.sample(center) < 0.0)
        );
    }
}
