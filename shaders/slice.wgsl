// View-aligned slices: polygons of plane and proxy box, drawn back to front and blended by the hardware ([DDM06] section 4).
//
// A fragment takes its position from its pixel's ray and its slice's depth rather than from interpolated vertices: the same arithmetic
// as a ray's sample, so that the renderers agree on where they look.

struct Slice {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) depth_mm: f32,
}

@vertex
fn vertex(@location(0) corner: vec4<f32>) -> Slice {
    return Slice(frame.clip_from_world * vec4<f32>(corner.xyz, 1.0), corner.w);
}

@fragment
fn fragment(slice: Slice) -> @location(0) vec4<f32> {
    let ray = pixel_ray(slice.position.xy);
    let slant = dot(ray.direction, frame.forward);
    let step = frame.step_mm / slant;
    // The near end of what this slice stands for decides, as a ray's last sample does.
    if BEHIND != 0u && first_sample_after(textureLoad(behind_t, vec2<i32>(slice.position.xy), 0).r, step) <= i32(floor(slice.depth_mm / frame.step_mm)) {
        discard;
    }
    let deformed = ray.origin + ray.direction * (slice.depth_mm / slant);
    if empty_until(deformed, ray.origin, 1.0 / ray.direction) >= 0.0 {
        count(slice.position.xy, vec3<u32>(0u, 1u, 0u));
        discard;
    }
    let part = kept_part(ray.origin, ray.direction, slice.depth_mm / slant, step);
    count(slice.position.xy, vec3<u32>(1u, 0u, 0u));
    if part.share <= 0.0 {
        discard;
    }
    let sampled = ray.origin + ray.direction * part.t;
    let at = look(sampled);
    if BLEND != 0u {
        if !at.present {
            discard;
        }
        // Red: the value (negated for the minimum), for the blend unit's maximum or sum; green: whether, or how often.
        return vec4<f32>(select(at.value, -at.value, BLEND == 2u), 1.0, 0.0, 0.0);
    }
    if ISO != 0u && at.present && at.value >= frame.iso && !enters_iso(sampled, ray.direction, step) {
        // The surface in front of it hides it, unless it is the face of a cut.
        discard;
    }
    let face = opaque_face(at, sampled, ray.direction, step);
    if face.a > 0.0 {
        return face;
    }
    if ISO != 0u {
        discard;
    }
    let s = visible(at, sampled);
    if s.depth <= 0.0 && !near_a_cut(at) {
        discard;
    }
    return shaded_sample(at, s, ray.direction, step, step / frame.reference_mm * part.share);
}
