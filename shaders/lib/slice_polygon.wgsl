// The polygon of a slice or a slab.

struct Slice {
    @builtin(position) position: vec4<f32>,
    // World mm, interpolated over the polygon.
    @location(0) deformed: vec3<f32>,
    // Index of the slab's nearest slice, which lies at depth (first + 1/2) step.
    @location(1) @interpolate(flat) first: i32,
}

@vertex
fn vertex(@location(0) corner: vec4<f32>) -> Slice {
    let clip = frame.clip_from_world * vec4<f32>(corner.xyz, 1.0);
    // Behind the mask of opaque pixels at depth 0, in front of everything else.
    return Slice(vec4<f32>(clip.xy, 0.5 * clip.w, clip.w), corner.xyz, i32(corner.w));
}
