// Marks the pixels that are not sampled again with depth 0, as opaque.wgsl does with opaque ones.

@group(1) @binding(1) var sampled_again: texture_2d<f32>;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) {
    if textureLoad(sampled_again, vec2<i32>(position.xy), 0).r > 0.0 {
        discard;
    }
}
