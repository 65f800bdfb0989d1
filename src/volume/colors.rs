//! Voxels with their own colours: RGB(A) images, several channels as one picture, label maps with a
//! colour table.
//!
//! In addition to its colour a voxel has one value, from which opacity is looked up as in any
//! scalar volume (\[DDM06\] section 4: O may be a colour volume): luminance, or opacity if the
//! image has it. Colours are interpolated weighted by this value, so that absent voxels contribute
//! no colour.

use super::smooth_labels::label_margins;
use super::{StoredValues, Voxels};
use glam::{Vec3, Vec4};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Default colours of channels.
pub const CHANNELS: [[u8; 3]; 4] = [[0, 255, 0], [255, 0, 255], [0, 128, 255], [255, 160, 0]];
/// Number of labels in a colour table.
const MAX_TABLE: usize = 1 << 16;
/// Fraction of the hue circle from one label to the next: by the golden section, labels with close
/// numbers differ in hue.
const HUE_STEP: f32 = 0.618_034;

/// A file's description of one label.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// Its value.
    pub value: u32,
    /// Its name; may be empty.
    pub name: String,
    /// Red, green, blue.
    pub color: Option<[u8; 3]>,
}

/// The colours of a grid of voxels, i fastest.
#[derive(Clone, Debug)]
pub enum Colors {
    /// Three bytes each.
    Rgb(Arc<Vec<u8>>),
    /// Four bytes each, the first three multiplied by the fourth.
    Rgba(Arc<Vec<u8>>),
    /// By label; labels beyond the table have no entry.
    Labels {
        /// Labels.
        labels: Voxels,
        /// Red, green, blue, and 0 for absent labels.
        table: Arc<Vec<[u8; 4]>>,
        /// The margin of each voxel's label over others. With it a sample has the colour of one
        /// label, the one with the largest sum of margins; without, the colours of the voxels
        /// around it are mixed.
        margins: Option<Arc<Vec<u8>>>,
    },
}

impl Colors {
    /// Three bytes each.
    pub fn rgb(values: Vec<u8>) -> Self {
        Self::Rgb(Arc::new(values))
    }

    /// Their size in memory, bytes.
    pub fn size_in_bytes(&self) -> usize {
        match self {
            Self::Rgb(values) | Self::Rgba(values) => values.len(),
            Self::Labels {
                labels,
                table,
                margins,
            } => {
                labels.len() * labels.bytes_per_voxel()
                    + table.len() * 4
                    + margins.as_ref().map_or(0, |m| m.len())
            }
        }
    }

    /// The colours of labels 1 to `highest`: the stated ones, else one that differs from those of
    /// neighbouring labels. Stated colours are used only for the first 65,536 labels.
    pub fn of_labels(labels: Voxels, highest: usize, stated: &[Label]) -> Self {
        let mut table: Vec<[u8; 4]> = (0..=highest.min(MAX_TABLE - 1))
            .map(|n| if n == 0 { [0; 4] } else { label_color(n) })
            .collect();
        for label in stated {
            if let (Some([r, g, b]), Some(entry)) = (
                label.color,
                table.get_mut(label.value as usize).filter(|_| label.value > 0),
            ) {
                *entry = [r, g, b, 255];
            }
        }
        Self::Labels {
            labels,
            table: Arc::new(table),
            margins: None,
        }
    }

    /// With smooth boundaries between labels; other colours are unchanged.
    #[must_use]
    pub fn with_smooth_boundaries(mut self) -> Self {
        if let Self::Labels { labels, margins, .. } = &mut self {
            *margins = Some(Arc::new(label_margins(labels)));
        }
        self
    }

    /// Whether a sample has the colour of the voxels with the largest sum of weighted margins,
    /// which are then the fourth component of [`Self::rgba8`]; otherwise colours are mixed.
    pub fn has_margins(&self) -> bool {
        matches!(self, Self::Labels { margins: Some(_), .. })
    }

    /// The colour of a label; none without a table, or if the table does not contain it.
    pub fn of_label(&self, label: u32) -> Option<[u8; 3]> {
        let Self::Labels { table, .. } = self else {
            return None;
        };
        let [r, g, b, a] = color_in(table, label as usize);
        (a > 0).then_some([r, g, b])
    }

    /// Colour of a voxel by its flat index, 0..1, as in [`Self::rgba8`].
    #[inline(always)]
    fn texel(&self, index: usize) -> Vec4 {
        let bytes = self.bytes(index);
        Vec4::from(bytes.map(f32::from)) / 255.0
    }

    #[inline(always)]
    fn bytes(&self, index: usize) -> [u8; 4] {
        match self {
            Self::Rgb(v) => [v[3 * index], v[3 * index + 1], v[3 * index + 2], 255],
            Self::Rgba(v) => [v[4 * index], v[4 * index + 1], v[4 * index + 2], v[4 * index + 3]],
            Self::Labels {
                labels,
                table,
                margins,
            } => {
                let label = labels.get(index);
                if label < 1.0 {
                    return [0; 4];
                }
                let [r, g, b, a] = color_in(table, label as usize);
                [r, g, b, margins.as_ref().map_or(a, |m| m[index].min(a))]
            }
        }
    }

    /// RGBA bytes of a run of voxels: colours multiplied by the fourth component or, of labels with
    /// smooth boundaries, colours as they are and the margin.
    pub fn rgba8(&self, range: Range<usize>) -> Vec<[u8; 4]> {
        range.into_par_iter().map(|n| self.bytes(n)).collect()
    }

    /// As [`Self::rgba8`], for averaged blocks of voxels: the blocks of `range`.
    pub fn reduced(&self, size: [usize; 3], factors: [usize; 3], range: Range<usize>) -> Vec<[u8; 4]> {
        let elected = |index: usize| {
            let voxels: Vec<[u8; 4]> = block(size, factors, index).map(|at| self.bytes(at)).collect();
            let all = voxels.iter().map(|c| (*c, f32::from(c[3])));
            let (color, votes) = elect(all);
            let [r, g, b] = color;
            [r, g, b, (votes / voxels.len() as f32 + 0.5) as u8]
        };
        let mean = |index: usize| {
            let (sum, count) = block(size, factors, index).fold(([0u32; 4], 0u32), |(sum, n), at| {
                let c = self.bytes(at);
                (std::array::from_fn(|k| sum[k] + u32::from(c[k])), n + 1)
            });
            sum.map(|s| ((s + count / 2) / count.max(1)) as u8)
        };
        if self.has_margins() {
            return range.into_par_iter().map(elected).collect();
        }
        range.into_par_iter().map(mean).collect()
    }

    /// The colour at a position in voxels, clamped to the outermost voxel centres: trilinear, or
    /// that of the label with the largest interpolated margin. Counterpart: `elected_color` in
    /// `shaders/lib/shading.wgsl`.
    pub fn sample(&self, size: [usize; 3], point_in_voxel: Vec3) -> Vec3 {
        let [nx, ny, nz] = size;
        let p = point_in_voxel.clamp(
            Vec3::ZERO,
            Vec3::new((nx - 1) as f32, (ny - 1) as f32, (nz - 1) as f32),
        );
        let (i, j, k) = (p.x as usize, p.y as usize, p.z as usize);
        let f = p - Vec3::new(i as f32, j as f32, k as f32);
        let corner = |corner: usize| {
            let (a, b, c) = (corner & 1, corner >> 1 & 1, corner >> 2);
            let weight = if a == 1 { f.x } else { 1.0 - f.x }
                * if b == 1 { f.y } else { 1.0 - f.y }
                * if c == 1 { f.z } else { 1.0 - f.z };
            let index = ((k + c).min(nz - 1) * ny + (j + b).min(ny - 1)) * nx + (i + a).min(nx - 1);
            (index, weight)
        };
        if self.has_margins() {
            let votes: [_; 8] = std::array::from_fn(|n| {
                let (index, weight) = corner(n);
                let bytes = self.bytes(index);
                (bytes, f32::from(bytes[3]) / 255.0 * weight)
            });
            let (elected, votes) = elect(votes.iter().copied());
            let color = if votes > 0.0 {
                elected
            } else {
                self.nearest_label(size, p)
            };
            return Vec3::from(color.map(f32::from)) / 255.0;
        }
        let mut sum = Vec4::ZERO;
        for (index, weight) in (0..8).map(corner).filter(|(_, weight)| *weight > 0.0) {
            sum += self.texel(index) * weight;
        }
        straight(sum)
    }

    /// The colour of the labelled voxel nearest to a position, the first of several, among the 64
    /// around it: a sample found just outside a surface may have no labelled voxel beside it.
    fn nearest_label(&self, size: [usize; 3], p: Vec3) -> [u8; 3] {
        let base = p.floor();
        let mut nearest = ([0; 3], f32::INFINITY);
        for n in 0..64i32 {
            let voxel = base.as_ivec3() + glam::IVec3::new(n & 3, n >> 2 & 3, n >> 4) - 1;
            let [i, j, k] = std::array::from_fn(|a| voxel[a].clamp(0, size[a] as i32 - 1) as usize);
            let [r, g, b, margin] = self.bytes((k * size[1] + j) * size[0] + i);
            let distance = (voxel.as_vec3() - p).length_squared();
            if margin > 0 && distance < nearest.1 {
                nearest = ([r, g, b], distance);
            }
        }
        nearest.0
    }
}

/// The colour with the largest sum of votes, the first of several, and that sum.
fn elect(votes: impl Iterator<Item = ([u8; 4], f32)> + Clone) -> ([u8; 3], f32) {
    let same = |a: [u8; 4], b: [u8; 4]| a[..3] == b[..3];
    let mut elected = ([0; 3], 0.0);
    for (color, _) in votes.clone().filter(|(_, vote)| *vote > 0.0) {
        let sum: f32 = votes
            .clone()
            .filter(|(c, _)| same(*c, color))
            .map(|(_, v)| v)
            .sum();
        if sum > elected.1 {
            elected = ([color[0], color[1], color[2]], sum);
        }
    }
    elected
}

/// Flat indices of the voxels in a block of a grid.
fn block(size: [usize; 3], factors: [usize; 3], index: usize) -> impl Iterator<Item = usize> {
    let blocks: [usize; 3] = std::array::from_fn(|a| size[a].div_ceil(factors[a]));
    let at = [
        index % blocks[0],
        index / blocks[0] % blocks[1],
        index / blocks[0] / blocks[1],
    ];
    let range = move |a: usize| at[a] * factors[a]..((at[a] + 1) * factors[a]).min(size[a]);
    range(2)
        .flat_map(move |k| range(1).flat_map(move |j| range(0).map(move |i| (k * size[1] + j) * size[0] + i)))
}

/// The colour of a premultiplied one.
pub fn straight(premultiplied: Vec4) -> Vec3 {
    (premultiplied.truncate() / premultiplied.w.max(1.0 / 1024.0)).clamp(Vec3::ZERO, Vec3::ONE)
}

/// Values and colours of interleaved RGB or RGBA. The value is the opacity if there is any; else
/// the luminance (Rec. 709).
pub fn of_interleaved(mut rgb: Vec<u8>, components: usize) -> (StoredValues, Colors) {
    let luminance =
        |v: &[u8]| ((54 * u32::from(v[0]) + 183 * u32::from(v[1]) + 19 * u32::from(v[2])) >> 8) as u8;
    if components == 3 {
        let values: Vec<u8> = rgb.par_chunks_exact(3).map(luminance).collect();
        return (values.into(), Colors::rgb(rgb));
    }
    let opaque = rgb.par_chunks_exact(4).all(|v| v[3] == 255);
    let values: Vec<u8> = rgb
        .par_chunks_exact(4)
        .map(|v| if opaque { luminance(v) } else { v[3] })
        .collect();
    rgb.par_chunks_exact_mut(4).for_each(|v| {
        for c in 0..3 {
            v[c] = ((u16::from(v[c]) * u16::from(v[3]) + 127) / 255) as u8;
        }
    });
    (values.into(), Colors::Rgba(Arc::new(rgb)))
}

/// The colour of a label: that of the table, or a generated one beyond its end.
#[inline(always)]
fn color_in(table: &[[u8; 4]], label: usize) -> [u8; 4] {
    match table.get(label) {
        Some(color) => *color,
        None if table.len() == MAX_TABLE => label_color(label),
        None => [0; 4],
    }
}

/// A generated colour for a label: hues by the golden section, two brightnesses.
fn label_color(label: usize) -> [u8; 4] {
    // Beyond the table's end single precision would lose too many digits.
    let label = label % (MAX_TABLE - 1);
    let hue = (label as f32 * HUE_STEP).fract() * 6.0;
    let (saturation, value) = if label.is_multiple_of(2) {
        (0.5, 0.92)
    } else {
        (0.68, 0.82)
    };
    let channel = |shift: f32| {
        let k = (shift + hue) % 6.0;
        let v = value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0);
        (v * 255.0 + 0.5) as u8
    };
    [channel(5.0), channel(3.0), channel(1.0), 255]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_next_to_each_other_look_different() {
        for n in 1..300usize {
            for m in 1..6usize {
                let (a, b) = (label_color(n), label_color(n + m));
                let far: i32 = (0..3).map(|c| (i32::from(a[c]) - i32::from(b[c])).abs()).sum();
                assert!(far > 40, "{n} {a:?} and {} {b:?}", n + m);
            }
        }
    }

    #[test]
    fn nothing_lends_no_colour() {
        let stated = [Label {
            value: 1,
            name: String::new(),
            color: Some([200, 100, 50]),
        }];
        let colors = Colors::of_labels(Voxels::new([2, 1, 1], vec![0u8, 1]), 1, &stated);
        let half = colors.sample([2, 1, 1], Vec3::new(0.5, 0.0, 0.0));
        assert!((half - Vec3::new(200.0, 100.0, 50.0) / 255.0).abs().max_element() < 1e-6);
    }

    #[test]
    fn opacity_is_the_value_where_there_is_any() {
        let (values, _) = of_interleaved(vec![255, 0, 0, 128, 0, 0, 255, 0], 4);
        assert_eq!((values.get(0), values.get(1)), (128.0, 0.0));
        let (values, colors) = of_interleaved(vec![255, 255, 255, 255, 0, 0, 0, 255], 4);
        assert_eq!((values.get(0), values.get(1)), (255.0, 0.0));
        assert_eq!(colors.rgba8(0..1), [[255; 4]]);
    }
}
