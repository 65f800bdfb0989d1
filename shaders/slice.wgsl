// Slabs of view-aligned slices, front to back ([DDM06] section 4): a fragment composites the
// samples of SLAB slices, and the blend unit composites the slabs.
//
// A fragment computes its positions from its pixel's ray and its slices' depths rather than from
// interpolated vertices. This is the same arithmetic as for a ray's samples, hence both renderers
// sample the same points. A slab's polygon covers more than its slices; the fragment tests which
// slices its ray meets inside the box.

struct Slab {
    @builtin(position) position: vec4<f32>,
    // Index of the nearest slice, which lies at depth (first + 1/2) step.
    @location(0) @interpolate(flat) first: i32,
}

@vertex
fn vertex(@location(0) corner: vec4<f32>) -> Slab {
    let clip = frame.clip_from_world * vec4<f32>(corner.xyz, 1.0);
    // Behind the mask of opaque pixels at depth 0, in front of everything else.
    return Slab(vec4<f32>(clip.xy, 0.5 * clip.w, clip.w), i32(corner.w));
}

@fragment
fn fragment(slab: Slab) -> @location(0) vec4<f32> {
    var ray = pixel_ray(slab.position.xy);
    let step = frame.step_mm / dot(ray.direction, frame.forward);
    // As for rays; a shifted slice is at most a whole step away from its polygon.
    let shift = pixel_shift(vec2<u32>(slab.position.xy)) * step;
    ray.origin += ray.direction * shift;
    var first = slab.first;
    var end = slab.first + i32(SLAB);
    if SLAB > 1u {
        let range = proxy_range(ray.origin, 1.0 / ray.direction);
        first = max(first, first_sample_after(range.x, step));
        end = select(first, min(end, first_sample_after(range.y, step)), range.x <= range.y);
    }
    if BEHIND != 0u {
        end = min(
            end, first_sample_after(textureLoad(behind_t, vec2<i32>(slab.position.xy), 0).r - shift, step)
        );
    }
    let all = composite(slab.position.xy, ray, first, end, step);
    if BLEND == BLEND_COMPOSITE {
        return all.color;
    }
    // Red: the value (negated for the minimum), for the blend unit's maximum or sum; green: whether
    // a value is present, or how many are.
    let value = select(
        -1e4, select(all.projected, -all.projected, BLEND == BLEND_MINIP), all.present_count > 0.0
    );
    return vec4<f32>(
        select(value, all.projected, BLEND == BLEND_AVERAGE),
        select(min(all.present_count, 1.0), all.present_count, BLEND == BLEND_AVERAGE),
        0.0,
        0.0,
    );
}
