// The ray of one pixel, front to back.

// Premultiplied, composited over the surfaces behind; takes the position of the pixel's centre.
fn ray_color(pixel: vec2<f32>) -> vec4<f32> {
    let position = sample_position(pixel);
    var ray = pixel_ray(position);
    // Samples are shifted by moving the origin of the ray.
    let shift = pixel_shift(vec2<u32>(position)) * frame.step_mm;
    ray.origin += ray.direction * shift;
    var range = proxy_range(ray.origin, reciprocals(ray.direction));
    var surface = vec4<f32>(0.0);
    var until = FAR_AWAY;
    if BEHIND != 0u {
        until = textureLoad(behind_t, vec2<i32>(pixel), 0).r - shift;
        range.y = min(range.y, until);
        surface = textureLoad(behind, vec2<i32>(pixel), 0);
    }
    if range.x > range.y {
        return surface;
    }
    let step = frame.step_mm;
    let end = first_sample_after(range.y, step);
    let hidden = until <= (f32(end) + 0.5) * step;
    let all = composite(pixel, ray, first_sample_after(range.x, step), end, step, hidden);
    var color = all.color;
    if BLEND != BLEND_COMPOSITE {
        color = projection_color(all.projected, all.present_count);
    }
    return color + surface * (1.0 - color.a);
}
