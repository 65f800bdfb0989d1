// Marks opaque pixels with depth 0, which the early depth test finds nearer than any slab (Krueger
// and Westermann 2003, early ray termination by the depth test).

@group(1) @binding(1) var projection_values: texture_2d<f32>;

const OPAQUE_ALPHA: f32 = 1.0 - 1.0 / 512.0;

@vertex
fn vertex(@location(0) corner: vec4<f32>) -> @builtin(position) vec4<f32> {
    let clip = frame.clip_from_world * vec4<f32>(corner.xyz, 1.0);
    return vec4<f32>(clip.xy, 0.0, clip.w);
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) {
    if textureLoad(projection_values, vec2<i32>(position.xy), 0).a <= OPAQUE_ALPHA {
        discard;
    }
}
