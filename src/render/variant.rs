//! The settings that distinguish pipelines.

use super::constants::{self, OwnColors};
use crate::gpu::shaders::Program;
use crate::scene::{IsoLight, Normals, SliceOrder};
use crate::transfer::Blend;
use crate::volume::GradientFilter;

/// The settings that distinguish pipelines.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Variant {
    pub(super) program: Program,
    pub(super) counting: bool,
    pub(super) maps: usize,
    pub(super) precomposed: bool,
    pub(super) normals: Normals,
    pub(super) blend: Blend,
    pub(super) gradient: GradientFilter,
    pub(super) cubic: bool,
    pub(super) slab: u32,
    pub(super) order: SliceOrder,
    pub(super) format: wgpu::TextureFormat,
    pub(super) preintegrated: bool,
    pub(super) cuts: usize,
    pub(super) grey_faces: bool,
    pub(super) iso: Option<IsoLight>,
    pub(super) behind: bool,
    /// Whether shares of the light are read from the light volume.
    pub(super) light_volume: bool,
    /// Samples are listed by position, instead of one per pixel.
    pub(super) listed: bool,
    /// Pixels that are not sampled again are masked.
    pub(super) masked: bool,
    pub(super) colors: OwnColors,
    pub(super) exact: bool,
    pub(super) exact_maps: bool,
    /// The volume's function, by its number.
    pub(super) function: Option<u64>,
}

/// Values of the shaders' `override` constants.
pub(super) fn overrides(variant: &Variant) -> [(&'static str, f64); 17] {
    [
        ("MAPS", variant.maps as f64),
        ("PRECOMPOSED", f64::from(u8::from(variant.precomposed))),
        ("NORMALS", f64::from(variant.normals as u32)),
        ("BLEND", f64::from(variant.blend as u32)),
        ("FILTER", f64::from(u8::from(variant.cubic))),
        ("GRADIENT", f64::from(variant.gradient as u32)),
        ("SLAB", f64::from(variant.slab)),
        ("PREINTEGRATED", f64::from(u8::from(variant.preintegrated))),
        ("CUTS", variant.cuts as f64),
        ("GREY_FACES", f64::from(u8::from(variant.grey_faces))),
        ("ISO", f64::from(constants::iso(variant.iso))),
        ("COLORS", f64::from(variant.colors as u32)),
        ("BEHIND", f64::from(u8::from(variant.behind))),
        ("LIGHT_VOLUME", f64::from(u8::from(variant.light_volume))),
        ("LISTED", f64::from(u8::from(variant.listed))),
        ("EXACT", f64::from(u8::from(variant.exact))),
        ("EXACT_MAPS", f64::from(u8::from(variant.exact_maps))),
    ]
}
