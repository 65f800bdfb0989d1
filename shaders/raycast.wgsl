// One fragment, one ray, front to back. Counterpart of march in src/cpu/packet.rs.

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    // One triangle over the whole picture.
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.5, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    var ray = pixel_ray(position.xy);
    // Samples are shifted by moving where rays are measured from.
    let shift = pixel_shift(vec2<u32>(position.xy)) * frame.step_mm;
    ray.origin += ray.direction * shift;
    var range = proxy_range(ray.origin, 1.0 / ray.direction);
    var surface = vec4<f32>(0.0);
    if BEHIND != 0u {
        range.y = min(range.y, textureLoad(behind_t, vec2<i32>(position.xy), 0).r - shift);
        surface = textureLoad(behind, vec2<i32>(position.xy), 0);
    }
    if range.x > range.y {
        return surface;
    }
    let step = frame.step_mm;
    let all = composite(position.xy, ray, first_sample_after(range.x, step), first_sample_after(range.y, step), step);
    var color = all.color;
    if BLEND != 0u {
        color = projection_color(all.projected, all.matter);
    }
    return color + surface * (1.0 - color.a);
}
