// Copies surfaces drawn in all pixels (bound as the layer behind) to the listed samples.

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.5, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> Drawn {
    let pixel = vec2<i32>(sample_position(position.xy));
    let t = textureLoad(behind_t, pixel, 0).r;
    if t >= FAR_AWAY {
        discard;
    }
    return Drawn(textureLoad(behind, pixel, 0), t, depth_of(t));
}
