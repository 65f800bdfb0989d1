// The bindings shared by the programs that read a scene, and the functions that read them. The
// files in lib/ call these functions; in lib/, only implicit.wgsl and count.wgsl declare bindings
// of their own.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> maps: array<PlacedMap, 65>;
@group(0) @binding(2) var volume: texture_3d<f32>;
@group(0) @binding(3) var linear_clamp: sampler;
@group(0) @binding(4) var table: texture_2d<f32>;
@group(0) @binding(5) var cells: texture_3d<u32>;
// The maps' texels in half and in single precision; see src/render/atlas.rs.
@group(0) @binding(6) var maps_half: texture_3d<f32>;
@group(0) @binding(7) var maps_single: texture_3d<f32>;

@group(0) @binding(14) var<uniform> cuts: array<CutShape, 8>;

// Surfaces drawn earlier: their colour, and their distance along each pixel's ray, mm.
@group(0) @binding(15) var behind: texture_2d<f32>;
@group(0) @binding(16) var behind_t: texture_2d<f32>;

// The voxels' own colours, multiplied by their weights.
@group(0) @binding(17) var colors: texture_3d<f32>;

// Colour and optical depth of segments: front values along y, back values along x.
@group(0) @binding(18) var preintegrated: texture_2d<f32>;

// The volume's central differences; see src/volume/gradient.rs.
@group(0) @binding(19) var gradients: texture_3d<f32>;

// Positions of listed samples on the picture, pixels.
@group(0) @binding(20) var sample_positions: texture_2d<f32>;

// S and V_raw over the deformed scene (src/prepare/light_volume/mod.rs).
@group(0) @binding(21) var light_volume: texture_3d<f32>;

// Distance of a pixel without a surface.
const FAR_AWAY: f32 = 1e30;

// Whether the voxels have colours of their own, and which one a sample has between them.
override COLORS: u32 = COLORS_NONE;
// 1: there are surfaces behind the volume.
override BEHIND: u32 = 0u;
// 1: light casts shadows or is dimmed in hollows, as the light volume says.
override LIGHT_VOLUME: u32 = 0u;
// 1: what is drawn is not a picture but a list of samples of one, row by row.
override LISTED: u32 = 0u;
// Number of analytic cut shapes.
override CUTS: u32 = 8u;
// 1: cut faces are painted grey.
override GREY_FACES: u32 = 0u;
// ISO_NONE shows the volume; any other value shows its surface at frame.iso and selects how that is
// lit.
override ISO: u32 = ISO_NONE;
// Number of maps in the stack.
override MAPS: u32 = 64u;
// 1: the map after the last one is the precomposed map; it replaces the stack wherever its texels
// are not marked.
override PRECOMPOSED: u32 = 0u;
override NORMALS: u32 = NORMALS_BLENDED;
override BLEND: u32 = BLEND_COMPOSITE;
override FILTER: u32 = FILTER_LINEAR;
override GRADIENT: u32 = GRADIENT_CENTRAL;
// 1: colour and opacity are those of the segments between samples.
override PREINTEGRATED: u32 = 0u;
// Slices in a slab; 1 for slices of a mesh.
override SLAB: u32 = 1u;
// 1: texels of volumes are interpolated in the shader, with 24-bit weights. Hardware filters round
// their weights to 8 bits: labels and holes bleed into their neighbours.
override EXACT: u32 = 0u;
// The same for maps. In a coarse map 8 bits shift points by tenths of a millimetre.
override EXACT_MAPS: u32 = 0u;

// Trilinear interpolation of the eight texels around a position in texels; clamped to the outermost
// texels.
fn mixed(t: texture_3d<f32>, p: vec3<f32>) -> vec4<f32> {
    return mixed_within(t, p, vec3<i32>(0), vec3<i32>(textureDimensions(t)) - 1);
}

// As above, clamped to the texels from `first` to `last`.
fn mixed_within(t: texture_3d<f32>, p: vec3<f32>, first: vec3<i32>, last: vec3<i32>) -> vec4<f32> {
    let cell = floor(p);
    let f = p - cell;
    let a = clamp(vec3<i32>(cell), first, last);
    let b = clamp(vec3<i32>(cell) + 1, first, last);
    let near = mix(
        mix(textureLoad(t, a, 0), textureLoad(t, vec3<i32>(b.x, a.yz), 0), f.x),
        mix(textureLoad(t, vec3<i32>(a.x, b.y, a.z), 0), textureLoad(t, vec3<i32>(b.xy, a.z), 0), f.x),
        f.y,
    );
    let far = mix(
        mix(textureLoad(t, vec3<i32>(a.xy, b.z), 0), textureLoad(t, vec3<i32>(b.x, a.y, b.z), 0), f.x),
        mix(textureLoad(t, vec3<i32>(a.x, b.yz), 0), textureLoad(t, b, 0), f.x),
        f.y,
    );
    return mix(near, far, f.z);
}

// Samples a texture that spans `size` voxels at a position in voxels. A separate uniform for 1 /
// size avoids a division per sample.
fn sample_texture(t: texture_3d<f32>, p: vec3<f32>, size: vec3<f32>, per_size: vec3<f32>) -> vec4<f32> {
    if EXACT == 0u {
        return textureSampleLevel(t, linear_clamp, (p + 0.5) * per_size, 0.0);
    }
    let texels = vec3<f32>(textureDimensions(t));
    return mixed(t, select((p + 0.5) * texels / size - 0.5, p, texels == size));
}

// f(+1) - f(-1) along i, j, k of the stored values, as fractions of 32767, and the normalised
// value.
fn sample_gradients(p: vec3<f32>) -> vec4<f32> {
    let t = sample_texture(gradients, p, frame.texture_size, frame.per_texture_size);
    return vec4<f32>(t.gba, t.r * (2.0 * frame.gradient_scale) + frame.stored_offset);
}

fn sample_colors(p: vec3<f32>) -> vec4<f32> {
    return sample_texture(colors, p, frame.texture_size, frame.per_texture_size);
}

// S and V_raw at a point of the deformed scene.
fn sample_light(p: vec3<f32>) -> vec2<f32> {
    let at = (p - frame.light_origin) * frame.light_per_size;
    return textureSampleLevel(light_volume, linear_clamp, at, 0.0).rg;
}

// Samples a block of the size of map k in an atlas at a position in its texels.
fn sample_atlas(atlas: texture_3d<f32>, k: u32, origin: vec3<f32>, p: vec3<f32>) -> vec4<f32> {
    let q = p + origin;
    if EXACT_MAPS != 0u {
        let first = vec3<i32>(origin);
        return mixed_within(atlas, q, first, first + vec3<i32>(maps[k].size) - 1);
    }
    return textureSampleLevel(atlas, linear_clamp, (q + 0.5) * maps[k].per_atlas, 0.0);
}

// The stored (D / scale, alpha) of map k; x lies in the unit cube, whose faces hold the outermost
// grid points, or within its reach.
fn fetch(k: u32, x: vec3<f32>) -> vec4<f32> {
    let p = clamp(x, vec3<f32>(0.0), vec3<f32>(1.0)) * (maps[k].size - 1.0);
    if maps[k].single != 0.0 {
        return sample_atlas(maps_single, k, maps[k].origin, p);
    }
    return sample_atlas(maps_half, k, maps[k].origin, p);
}

// The stored slopes of map k along an axis: the derivatives of (D / scale, alpha) per map unit.
fn fetch_slopes(k: u32, x: vec3<f32>, axis: f32) -> vec4<f32> {
    let p = clamp(x, vec3<f32>(0.0), vec3<f32>(1.0)) * (maps[k].size - 1.0);
    let origin = maps[k].slopes_origin + vec3<f32>(0.0, 0.0, axis * maps[k].size.z);
    var slopes: vec4<f32>;
    if maps[k].single != 0.0 {
        slopes = sample_atlas(maps_single, k, origin, p);
    } else {
        slopes = sample_atlas(maps_half, k, origin, p);
    }
    return vec4<f32>(slopes.xyz * maps[k].slopes_scale, slopes.w);
}

// Where on the picture the sample of a pixel lies.
fn sample_position(pixel: vec2<f32>) -> vec2<f32> {
    if LISTED == 0u {
        return pixel;
    }
    return textureLoad(sample_positions, vec2<i32>(pixel), 0).rg;
}

fn table_entry(i: i32, row: i32) -> vec4<f32> {
    return textureLoad(table, vec2<i32>(i, row), 0);
}

// Indexed by the table coordinates of the segment's two ends.
fn preintegrated_entry(front: f32, back: f32) -> vec4<f32> {
    let size = vec2<f32>(textureDimensions(preintegrated));
    return textureSampleLevel(
        preintegrated,
        linear_clamp,
        (clamp(vec2<f32>(back, front), vec2<f32>(0.0), vec2<f32>(1.0)) * (size - 1.0) + 0.5) / size,
        0.0,
    );
}

fn cell_block(cell: vec3<i32>) -> u32 {
    return textureLoad(cells, cell, 0).r;
}
