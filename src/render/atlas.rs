//! Texture atlases for the maps of a stack: a shader binds few textures (16 on WebGL and OpenGL),
//! but a scene may have many deformations. Each map occupies one box of texels; shaders never read
//! outside it, hence neighbouring maps need no padding.
//!
//! There are two atlases: one in half precision, and one in single precision for all other maps,
//! that is, displacement fields from files, and steps of 8 or 16 bits, which half precision cannot
//! represent. A map stays in its atlas until another one of its size needs its place or a larger
//! texture is made. Maps also have textures of their own, from which they are copied: switching
//! back and forth between two states uploads nothing.

use super::target::RenderTexture;
use crate::deform::DisplacementMap;
use std::sync::Arc;

/// The location of a map, texels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct AtlasSlot {
    pub origin: [u32; 3],
    /// That of its stored slopes, if it has any.
    pub slopes_origin: [u32; 3],
    /// Whether it is in the single-precision atlas.
    pub single: bool,
}

/// A box of texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TexelBox {
    pub(super) origin: [u32; 3],
    pub(super) size: [u32; 3],
}

impl TexelBox {
    fn texels(&self) -> u64 {
        self.size.iter().map(|n| u64::from(*n)).product()
    }

    fn holds(&self, size: [u32; 3]) -> bool {
        (0..3).all(|a| size[a] <= self.size[a])
    }

    /// The rest of the box without a box of `size` at its origin: up to three boxes.
    fn rest(&self, size: [u32; 3]) -> impl Iterator<Item = Self> + use<> {
        let whole = *self;
        (0..3).map(move |axis| {
            let mut part = whole;
            // Up to this axis limited to the extent of the removed box, beyond it the whole extent.
            part.size = std::array::from_fn(|a| if a < axis { size[a] } else { whole.size[a] });
            part.origin[axis] += size[axis];
            part.size[axis] = whole.size[axis] - size[axis];
            part
        })
    }
}

/// Packing of boxes into a growing box.
#[derive(Default)]
pub(super) struct AtlasPacking {
    pub(super) size: [u32; 3],
    free: Vec<TexelBox>,
}

impl AtlasPacking {
    /// Takes the free place with the best fit.
    fn take(&mut self, size: [u32; 3]) -> Option<[u32; 3]> {
        let best = self
            .free
            .iter()
            .enumerate()
            .filter(|(_, r)| r.holds(size))
            .min_by_key(|(_, r)| r.texels())
            .map(|(n, _)| n)?;
        let region = self.free.swap_remove(best);
        self.free.extend(region.rest(size).filter(|r| r.texels() > 0));
        Some(region.origin)
    }

    /// Grows along the cheapest axis until a box of `size` is free; false if an edge would exceed
    /// `most`.
    fn grow_for(&mut self, size: [u32; 3], most: u32) -> bool {
        let grown = |axis: usize| -> [u32; 3] {
            std::array::from_fn(|a| {
                if a == axis {
                    self.size[a] + size[a]
                } else {
                    self.size[a].max(size[a])
                }
            })
        };
        let volume = |s: [u32; 3]| s.iter().map(|n| u64::from(*n)).product::<u64>();
        let fits = |axis: &usize| grown(*axis).iter().all(|n| *n <= most);
        let Some(along) = (0..3).filter(fits).min_by_key(|axis| volume(grown(*axis))) else {
            return false;
        };
        let to = grown(along);
        // The new space is added as one slab per axis. The slab that holds the box is the last one
        // and spans all the others.
        for axis in [(along + 1) % 3, (along + 2) % 3, along] {
            let slab = TexelBox {
                origin: std::array::from_fn(|a| if a == axis { self.size[a] } else { 0 }),
                size: std::array::from_fn(|a| {
                    if a == axis {
                        to[a] - self.size[a]
                    } else {
                        self.size[a]
                    }
                }),
            };
            if slab.texels() > 0 {
                self.free.push(slab);
            }
            self.size[axis] = to[axis];
        }
        true
    }
}

/// A map in an atlas.
pub(super) struct AtlasEntry {
    /// Retained, so that its address is not reused.
    pub(super) map: Arc<DisplacementMap>,
    pub(super) region: TexelBox,
}

/// One texture of maps.
#[derive(Default)]
pub(super) struct Atlas {
    pub(super) target: Option<RenderTexture>,
    pub(super) packing: AtlasPacking,
    /// The most recently used last.
    pub(super) entries: Vec<AtlasEntry>,
}

fn texels_of(map: &DisplacementMap) -> [u32; 3] {
    map.size.map(|n| n as u32)
}

impl Atlas {
    pub(super) fn find(&self, map: &Arc<DisplacementMap>) -> Option<usize> {
        self.entries.iter().position(|e| Arc::ptr_eq(&e.map, map))
    }

    /// A place for a map without growing, if there is one: free space, or the place of an unused
    /// map of the same size.
    pub(super) fn place(
        &mut self,
        map: &Arc<DisplacementMap>,
        in_use: &[Arc<DisplacementMap>],
    ) -> Option<TexelBox> {
        let size = texels_of(map);
        let unused = |e: &AtlasEntry| e.region.size == size && !in_use.iter().any(|m| Arc::ptr_eq(m, &e.map));
        if let Some(n) = self.entries.iter().position(unused) {
            return Some(self.entries.remove(n).region);
        }
        self.packing.take(size).map(|origin| TexelBox { origin, size })
    }

    /// A packing of these maps alone, and their places in order.
    pub(super) fn packed(maps: &[Arc<DisplacementMap>], most: u32) -> Option<(AtlasPacking, Vec<TexelBox>)> {
        let mut packing = AtlasPacking::default();
        let mut order: Vec<usize> = (0..maps.len()).collect();
        order.sort_by_key(|n| std::cmp::Reverse(maps[*n].size.iter().product::<usize>()));
        let mut regions = vec![
            TexelBox {
                origin: [0; 3],
                size: [0; 3]
            };
            maps.len()
        ];
        for n in order {
            let size = texels_of(&maps[n]);
            let origin = match packing.take(size) {
                Some(origin) => origin,
                None if packing.grow_for(size, most) => packing.take(size)?,
                None => return None,
            };
            regions[n] = TexelBox { origin, size };
        }
        Some((packing, regions))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn overlap(a: &TexelBox, b: &TexelBox) -> bool {
        (0..3).all(|n| a.origin[n] < b.origin[n] + b.size[n] && b.origin[n] < a.origin[n] + a.size[n])
    }

    /// Boxes never overlap nor exceed the bounds, whatever their sizes, and little space is wasted
    /// for equal boxes.
    #[test]
    fn boxes_are_packed_without_touching() {
        let mut random = 12345u32;
        let mut next = move |most: u32| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            1 + (random >> 16) % most
        };
        for round in 0..200 {
            let mut packing = AtlasPacking::default();
            let mut taken: Vec<TexelBox> = Vec::new();
            for _ in 0..1 + round % 40 {
                let size = if round % 3 == 0 {
                    [64; 3]
                } else {
                    [next(200), next(200), if round % 5 == 0 { 1 } else { next(200) }]
                };
                let origin = packing
                    .take(size)
                    .or_else(|| packing.grow_for(size, 2048).then(|| packing.take(size))?);
                let Some(origin) = origin else {
                    panic!("no place for {size:?} in {:?}", packing.size)
                };
                let region = TexelBox { origin, size };
                assert!(taken.iter().all(|t| !overlap(t, &region)), "{region:?}");
                assert!((0..3).all(|a| origin[a] + size[a] <= packing.size[a]));
                taken.push(region);
            }
            let used: u64 = taken.iter().map(TexelBox::texels).sum();
            let all: u64 = packing.size.iter().map(|n| u64::from(*n)).product();
            assert!(
                used <= all && (round % 3 != 0 || all <= 2 * used),
                "{used} of {all}"
            );
            let free: u64 = packing.free.iter().map(TexelBox::texels).sum();
            assert_eq!(used + free, all);
        }
        assert!(!AtlasPacking::default().grow_for([3000, 1, 1], 2048));
    }
}
