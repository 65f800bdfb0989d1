// Counterpart of src/math/light.rs.

// The factor on a surface's colour and the highlight added to it. facing: cosine between the normal
// and the light; cosine: between the normal and the half vector.
fn shine(facing: f32, cosine: f32, specular: f32, shininess: f32) -> vec2<f32> {
    var highlight = 0.0;
    if facing > 0.0 {
        highlight = specular * pow(max(cosine, 0.0), shininess);
    }
    return vec2<f32>(frame.ambient + frame.diffuse * max(facing, 0.0), highlight);
}

// Half vector between the light and the eye.
fn half_vector(direction: vec3<f32>) -> vec3<f32> {
    return normalize_or(frame.to_light - direction, frame.to_light);
}
