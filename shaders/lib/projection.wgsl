// Counterpart of IntensityProjection::color in src/cpu/mod.rs.

fn projection_color(projected: f32, present_count: f32) -> vec4<f32> {
    if present_count < 0.5 {
        return vec4<f32>(0.0);
    }
    let t = lookup(select(projected, projected / present_count, BLEND == BLEND_AVERAGE));
    let alpha = 1.0 - exp2(-t.a);
    return vec4<f32>(t.rgb * alpha, alpha);
}
