// One fragment, one ray, front to back. Counterpart of march in src/cpu/mod.rs.

const OPAQUE: f32 = 1.0 / 512.0;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    // One triangle over the whole picture.
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.5, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let ray = pixel_ray(position.xy);
    let inverse_direction = 1.0 / ray.direction;
    let a = (frame.proxy_min - ray.origin) * inverse_direction;
    let b = (frame.proxy_max - ray.origin) * inverse_direction;
    let nears = min(a, b);
    let fars = max(a, b);
    let near = max(nears.x, max(nears.y, nears.z));
    var far = min(fars.x, min(fars.y, fars.z));
    var surface = vec4<f32>(0.0);
    if BEHIND != 0u {
        far = min(far, textureLoad(behind_t, vec2<i32>(position.xy), 0).r);
        surface = textureLoad(behind, vec2<i32>(position.xy), 0);
    }
    if near > far {
        return surface;
    }
    let step = frame.step_mm;
    var i = first_sample_after(near, step);
    let end = first_sample_after(far, step);
    let length = step / frame.reference_mm;
    var color = vec4<f32>(0.0);
    var projected = select(0.0, select(-1e30, 1e30, BLEND == 2u), BLEND != 3u);
    var matter = 0.0;
    var taken = 0u;
    var skipped = 0u;
    var terminated = 0u;
    while i < end {
        // Two loops instead of a branch: neighbouring rays run in lockstep, and shading costs far more than looking. This way the rays of a
        // group look until each has something to shade, then shade together.
        var stop = false;
        var found: Sample;
        var at: Look;
        var share = 1.0;
        while i < end && !stop {
            let deformed = ray.origin + ray.direction * ((f32(i) + 0.5) * step);
            let t = empty_until(deformed, ray.origin, inverse_direction);
            if t >= 0.0 {
                let next = min(max(first_sample_after(t, step), i + 1), end);
                skipped += u32(next - i);
                i = next;
                continue;
            }
            let part = kept_part(ray.origin, ray.direction, (f32(i) + 0.5) * step, step);
            i += 1;
            taken += 1u;
            if part.share <= 0.0 {
                continue;
            }
            share = part.share;
            let sampled = ray.origin + ray.direction * part.t;
            at = look(sampled);
            if BLEND != 0u {
                if at.present {
                    matter += 1.0;
                    switch BLEND {
                        case 1u: { projected = max(projected, at.value); }
                        case 2u: { projected = min(projected, at.value); }
                        default: { projected += at.value; }
                    }
                }
                continue;
            }
            found = visible(at, sampled);
            if ISO != 0u {
                stop = (at.present && at.value >= frame.iso) || (GREY_FACES != 0u && at.present && near_a_face(at, sampled, step));
            } else {
                stop = found.depth > 0.0 || near_a_cut(at) || (GREY_FACES != 0u && at.present && near_a_face(at, sampled, step));
            }
        }
        if stop {
            let face = opaque_face(at, found.deformed, ray.direction, step);
            if face.a > 0.0 {
                color += face * (1.0 - color.a);
                terminated += u32(max(end - i, 0));
                break;
            }
            if ISO != 0u {
                continue;
            }
            color += shaded_sample(at, found, ray.direction, step, length * share) * (1.0 - color.a);
            if 1.0 - color.a < OPAQUE && frame.early_termination != 0u {
                terminated += u32(max(end - i, 0));
                break;
            }
        }
    }
    count(position.xy, vec3<u32>(taken, skipped, terminated));
    if BLEND != 0u {
        color = projection_color(projected, matter);
    }
    return color + surface * (1.0 - color.a);
}
