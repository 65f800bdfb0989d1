// Encodes samples as texels: D / scale and alpha in half precision.

@group(0) @binding(0) var<uniform> size: vec3<u32>;
@group(0) @binding(1) var<storage, read> samples: array<vec4<f32>>;
// Bits of the largest component of D.
@group(0) @binding(2) var<storage, read> largest: u32;
@group(0) @binding(3) var texels: texture_storage_3d<rgba16float, write>;

// Rounds numbers up to 1 to half precision, because the rounding of a store is not specified: ten
// bits after the leading one, ties to even, and below 2^-14 multiples of 2^-24.
fn nearest_half(v: vec4<f32>) -> vec4<f32> {
    let bits = bitcast<vec4<u32>>(v);
    let rounded = bitcast<vec4<f32>>(
        (bits + vec4<u32>(0xFFFu) + ((bits >> vec4<u32>(13u)) & vec4<u32>(1u))) & vec4<u32>(0xFFFFE000u)
    );
    return select(rounded, round(v * 16777216.0) / 16777216.0, abs(v) < vec4<f32>(1.0 / 16384.0));
}

@compute @workgroup_size(4, 4, 4)
fn encode(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id >= size) {
        return;
    }
    let s = samples[(id.z * size.y + id.y) * size.x + id.x];
    let t = vec4<f32>(s.xyz / select(1.0, bitcast<f32>(largest), largest != 0u), s.w);
    textureStore(texels, id, nearest_half(t));
}
