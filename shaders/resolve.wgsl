// Applies the transfer function to a projection accumulated by the blend unit from slices.

@group(1) @binding(1) var projection_values: texture_2d<f32>;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.5, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let g = textureLoad(projection_values, vec2<i32>(position.xy), 0);
    let color = projection_color(select(g.r, -g.r, BLEND == BLEND_MINIP), g.g);
    if BEHIND == 0u {
        return color;
    }
    return color + textureLoad(behind, vec2<i32>(position.xy), 0) * (1.0 - color.a);
}
