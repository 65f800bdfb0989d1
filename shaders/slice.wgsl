// What a fragment of a slice shows ([DDM06] section 4). Counterpart of src/cpu/slices.rs, whose
// rasteriser and blending are the GPU's own here.
//
// A slice is one polygon. For a slab of SLAB slices the polygon lies at their mean depth, and the
// fragment composites their samples before the blend unit composites the slabs.

// A sample of a slice.
struct SliceSample {
    // Premultiplied.
    color: vec4<f32>,
    // For projections.
    value: f32,
    present: bool,
    // Whether it was taken or lies in an empty cell.
    taken: bool,
}

// Samples a slice at a point: a thin layer in front of it, and its sample. `step` is the path
// between slices along the pixel's ray. `hidden`: something opaque lies in front of the next slice.
fn fragment_sample(
    p: vec3<f32>, hidden: bool, direction: vec3<f32>, half: vec3<f32>, step: f32
) -> SliceSample {
    var sample = SliceSample(vec4<f32>(0.0), 0.0, false, false);
    let state = cell_block(vec3<i32>(cell_of(p)));
    if state > 0u && state < CUT_FREE_FLAG {
        return sample;
    }
    sample.taken = true;
    let at = sample_scene(p);
    sample.value = at.value;
    sample.present = at.present;
    if BLEND != BLEND_COMPOSITE {
        return sample;
    }
    // No sample of another slice is known here.
    var previous = UNKNOWN_NEIGHBOUR;
    if PREINTEGRATED != 0u {
        previous = as_neighbour(sample_scene(p - direction * step));
    }
    let own = as_neighbour(at);
    let s = found_sample(at, p, previous);
    var layered = own.depth < frame.thin_depth || ISO != ISO_NONE;
    if PREINTEGRATED != 0u {
        layered = may_hide_a_layer(own, previous);
    }
    layered = layered && near_edge(at, p, step);
    let cut_free = state >= CUT_FREE_FLAG;
    var found = FoundSample(s, at.present, at.alpha, layered, cut_free, hidden && !layered, previous, UNKNOWN_NEIGHBOUR);
    let to_shade = to_be_shaded(at, s.depth, p, step);
    // Both share one copy of the shading code.
    for (var n = select(1, 0, layered); n < select(1, 2, to_shade); n += 1) {
        let shaded = shaded_sample(found, direction, half, step, step / frame.reference_mm);
        sample.color += shaded.color * (1.0 - sample.color.a);
        found.thin = false;
        found.hidden = hidden;
    }
    return sample;
}

@fragment
fn fragment(slice: Slice) -> @location(0) vec4<f32> {
    let direction = pixel_ray(slice.position.xy).direction;
    let cosine = dot(direction, frame.forward);
    let step = frame.step_mm / cosine;
    let half = half_vector(direction);
    let shift = pixel_shift(vec2<u32>(slice.position.xy)) * step;
    var until = FAR_AWAY;
    if BEHIND != 0u {
        until = textureLoad(behind_t, vec2<i32>(slice.position.xy), 0).r - shift;
    }
    let polygon_depth = dot(slice.deformed - frame.eye, frame.forward);
    var color = vec4<f32>(0.0);
    var projected = select(0.0, select(-1e30, 1e30, BLEND == BLEND_MINIP), BLEND != BLEND_AVERAGE);
    var present_count = 0.0;
    var counted = vec3<u32>(0u);
    for (var n = 0; n < i32(SLAB); n += 1) {
        let depth = (f32(slice.first + n) + 0.5) * frame.step_mm;
        if depth >= until * cosine {
            break;
        }
        var p = slice.deformed + direction * shift;
        if SLAB > 1u {
            p += direction * ((depth - polygon_depth) / cosine);
        }
        let hidden = depth + frame.step_mm >= until * cosine;
        let sample = fragment_sample(p, hidden, direction, half, step);
        counted += select(vec3<u32>(0u, 1u, 0u), vec3<u32>(1u, 0u, 0u), sample.taken);
        if sample.present && BLEND != BLEND_COMPOSITE {
            present_count += 1.0;
            projected = insert_value(projected, sample.value);
        }
        color += sample.color * (1.0 - color.a);
        if frame.early_termination != 0u && 1.0 - color.a < MIN_TRANSMITTANCE {
            counted.z += SLAB - 1u - u32(n);
            break;
        }
    }
    count(slice.position.xy, counted);
    if BLEND == BLEND_COMPOSITE {
        return color;
    }
    // Red: the value (negated for the minimum), for the blend unit's maximum or sum; green: whether
    // a value is present, or how many are.
    let value = select(-1e4, select(projected, -projected, BLEND == BLEND_MINIP), present_count > 0.0);
    return vec4<f32>(
        select(value, projected, BLEND == BLEND_AVERAGE),
        select(min(present_count, 1.0), present_count, BLEND == BLEND_AVERAGE),
        0.0,
        0.0,
    );
}
