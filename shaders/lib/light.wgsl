// Counterpart of src/math/light.rs and of src/cpu/light.rs.

// The optical depth per reference length of something opaque.
const SOLID_DEPTH: f32 = 16.0;

// The shares of the lights that reach a point, 0 to 1.
struct LightShares {
    key: f32,
    sky: f32,
}

// The factors on a surface's colour and, in w, the strength of the highlight added to it. facing:
// cosine between the normal and the light; cosine: between the normal and the half vector.
fn shine(facing: f32, cosine: f32, specular: f32, shininess: f32, shares: LightShares) -> vec4<f32> {
    var highlight = 0.0;
    if facing > 0.0 {
        highlight = specular * pow(max(cosine, 0.0), shininess) * shares.key;
    }
    return vec4<f32>(even_light(max(facing, 0.0), shares), highlight);
}

// A colour under the light, not clamped.
fn lit(
    color: vec3<f32>, facing: f32, cosine: f32, specular: f32, shininess: f32, shares: LightShares
) -> vec3<f32> {
    let shone = shine(facing, cosine, specular, shininess, shares);
    return color * shone.xyz + frame.key_color * shone.w;
}

// Factors on a colour with a part of the key light, independent of a normal.
fn even_light(part: f32, shares: LightShares) -> vec3<f32> {
    return frame.ambient * frame.sky_color * shares.sky
        + part * (frame.diffuse * frame.key_color) * shares.key;
}

// The normal on the side that the eye sees, where light casts shadows.
fn facing_the_eye(normal: vec3<f32>, direction: vec3<f32>) -> vec3<f32> {
    if LIGHT_VOLUME != 0u && dot(normal, direction) > 0.0 {
        return -normal;
    }
    return normal;
}

// The shares of the light that reach a sample. `depth` is its optical depth per reference length: what
// is opaque up to where its light is read is a surface, even if the gradient does not show it.
fn light_shares(
    normal: vec3<f32>, confidence: f32, depth: f32, at: vec3<f32>, direction: vec3<f32>
) -> LightShares {
    if LIGHT_VOLUME == 0u {
        return LightShares(1.0, 1.0);
    }
    let out = normalize_or(normal * confidence - direction * (1.0 - confidence), -direction);
    let shares = sample_light(at + out * frame.light_offset_mm);
    let of_surface = max(confidence, 1.0 - exp2(-depth * frame.light_offset_mm / frame.reference_mm));
    return LightShares(shares.x, min(shares.y * (1.0 + of_surface), 1.0));
}

// Half vector between the light and the eye.
fn half_vector(direction: vec3<f32>) -> vec3<f32> {
    return normalize_or(frame.to_light - direction, frame.to_light);
}
