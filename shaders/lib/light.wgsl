// Counterpart of src/math/light.rs.

// The factors on a surface's colour and, in w, the strength of the highlight added to it. facing:
// cosine between the normal and the light; cosine: between the normal and the half vector.
fn shine(facing: f32, cosine: f32, specular: f32, shininess: f32) -> vec4<f32> {
    var highlight = 0.0;
    if facing > 0.0 {
        highlight = specular * pow(max(cosine, 0.0), shininess);
    }
    return vec4<f32>(even_light(max(facing, 0.0)), highlight);
}

// A colour under the light, not clamped.
fn lit(color: vec3<f32>, facing: f32, cosine: f32, specular: f32, shininess: f32) -> vec3<f32> {
    let shone = shine(facing, cosine, specular, shininess);
    return color * shone.xyz + frame.key_color * shone.w;
}

// Factors on a colour with a share of the key light, independent of a normal.
fn even_light(share: f32) -> vec3<f32> {
    return frame.ambient * frame.sky_color + share * (frame.diffuse * frame.key_color);
}

// Half vector between the light and the eye.
fn half_vector(direction: vec3<f32>) -> vec3<f32> {
    return normalize_or(frame.to_light - direction, frame.to_light);
}
